//! Where a database lies on its body, and where its highest and its lowest ground is.

use std::cmp::Ordering;
use terravision_common::database::{TileScratch, TileSource};
use terravision_common::lonlat::{LonLatTable, Projection, lonlat_of_body};
use terravision_common::node::NodeId;
use terravision_common::validity::{HALF, MEASURED_PLANE};
use terravision_store::Store;

/// Tiles that are read for one of the two. The ranges of nodes tell which ones can have it: a few
/// around a summit.
const MOST_TILES: usize = 256;
/// Heights in tiles are this exact, metres.
const STEP_M: f64 = 1.0 / 128.0;

/// Places along a side of a world whose longitudes and latitudes bound it.
const BORDER: usize = 21;

/// The highest or the lowest post of a world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extreme {
    /// Height, metres.
    pub height_m: f64,
    /// Easting and northing.
    pub place: [f64; 2],
    /// Longitude and latitude, degrees, where they can be told.
    pub lon_lat: Option<[f64; 2]>,
}

/// What is worked out from a database, beside what its manifest says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Places {
    /// West, south, east, north, degrees; west is the greater one across the date line.
    pub lon_lat: Option<[f64; 4]>,
    /// Highest and lowest post of the finest level, where they can be found by reading few tiles.
    /// Not looked for on servers: it would cost requests.
    pub extremes: [Option<Extreme>; 2],
}

impl Places {
    /// Works them out. Blocks on storage.
    #[must_use]
    pub fn of(database: &Store) -> Self {
        let (manifest, world) = (database.manifest().fields(), database.world());
        if world.globe().is_some() {
            return Self { lon_lat: Some([-180.0, -90.0, 180.0, 90.0]), extremes: [None; 2] };
        }
        let way = Way::of(manifest.crs.proj4.as_deref(), manifest.crs.epsg, manifest.lonlat.as_ref());
        let is_here = database.location().as_path().is_some();
        let [low, high] = manifest.elevation.range_m;
        let find = |height_m, sign| if is_here { find(database, height_m, sign) } else { None };
        let ([x, y], [width, height]) = (world.fields().origin, world.extent_m());
        let along = |k: usize| k as f64 / (BORDER - 1) as f64;
        let place = |k: usize| [x + width * along(k % BORDER), y + height * along(k / BORDER)];
        let lon_lat_at = |place: [f64; 2]| way.as_ref().and_then(|way| way.lon_lat_at(place));
        let with_lon_lat = |found: Extreme| Extreme { lon_lat: lon_lat_at(found.place), ..found };
        Self {
            lon_lat: bounds_of((0..BORDER * BORDER).filter_map(|k| lon_lat_at(place(k)))),
            extremes: [find(high, 1.0), find(low, -1.0)].map(|found| found.map(with_lon_lat)),
        }
    }
}

/// From a world's CRS to longitude and latitude.
struct Way<'a> {
    plane: Projection,
    lon_lat: Projection,
    table: Option<&'a LonLatTable>,
}

impl<'a> Way<'a> {
    fn of(proj4: Option<&str>, epsg: Option<u32>, table: Option<&'a LonLatTable>) -> Option<Self> {
        let table = table.filter(|table| table.is_valid());
        let (plane, lon_lat) = match table {
            Some(table) => (Projection::parse(&table.plane).ok()?, table.lonlat.clone()),
            None => {
                let plane = proj4.map_or_else(|| Projection::of_epsg(epsg?), |text| Projection::parse(text).ok())?;
                (plane, lonlat_of_body(proj4.unwrap_or_default()))
            }
        };
        Some(Self { plane, lon_lat: Projection::parse(&lon_lat).ok()?, table })
    }

    fn lon_lat_at(&self, place: [f64; 2]) -> Option<[f64; 2]> {
        let mut in_plane = place;
        if let Some(table) = self.table {
            // Offsets hardly change over their own length: a few steps find where the table leads
            // to the place.
            for _ in 0..4 {
                let found = table.world_from_plane(in_plane);
                in_plane = [0, 1].map(|axis| in_plane[axis] + place[axis] - found[axis]);
            }
        }
        self.plane.to(&self.lon_lat, in_plane).ok()
    }
}

fn bounds_of(points: impl Iterator<Item = [f64; 2]>) -> Option<[f64; 4]> {
    let mut points: Vec<[f64; 2]> = points.collect();
    let has = |is: &dyn Fn(f64) -> bool| points.iter().any(|[lon, _]| is(*lon));
    // Far longitudes on both sides and none between: the world lies across the date line.
    if has(&|lon| lon > 90.0) && has(&|lon| lon < -90.0) && !has(&|lon| lon.abs() <= 90.0) {
        points.iter_mut().filter(|[lon, _]| *lon < 0.0).for_each(|point| point[0] += 360.0);
    }
    let first = points.first()?;
    let start = [first[0], first[1], first[0], first[1]];
    let [w, s, e, n] =
        points.iter().fold(start, |[w, s, e, n], [lon, lat]| [w.min(*lon), s.min(*lat), e.max(*lon), n.max(*lat)]);
    Some([w, s, if e > 180.0 { e - 360.0 } else { e }, n])
}

/// The post of that height, which is the greatest (`sign` 1) or the least (-1).
fn find(database: &Store, height_m: f64, sign: f64) -> Option<Extreme> {
    let world = database.world();
    let q = world.finest_elevation_level();
    let side = if sign > 0.0 { 1 } else { 0 };
    let bound = |node: NodeId| database.ranges().range(node).map(|range| f64::from(range[side]));
    let mut candidates: Vec<(f64, NodeId)> = database
        .ranges()
        .nodes(q)
        .filter_map(|node| bound(node).map(|bound| (bound, node)))
        .filter(|(bound, _)| sign * (bound - height_m) >= -STEP_M)
        .take(1 << 20)
        .collect();
    // The range of a node bounds coarser levels too: the one that is nearest to the height most
    // likely has it.
    candidates.sort_by(|a, b| (a.0 - height_m).abs().partial_cmp(&(b.0 - height_m).abs()).unwrap_or(Ordering::Equal));
    let posts = world.elevation_posts() as usize;
    let (mut values, mut scratch) = (vec![0.0f32; world.elevation_values()], TileScratch::default());
    for (_, node) in candidates.into_iter().take(MOST_TILES) {
        if database.read_elevation(node, &mut values, &mut scratch).is_err() {
            continue;
        }
        let (heights, shares) = values.split_at(posts * posts);
        // Made-up ground is not reported. (A world without voids has no shares.)
        let is_measured = |at: usize| {
            let measured = (MEASURED_PLANE - 1) * posts * posts + at;
            shares.get(measured).is_none_or(|share| *share >= HALF)
        };
        // The border beyond the extent repeats what is within.
        let is_found = |at: &usize| (f64::from(heights[*at]) - height_m).abs() <= STEP_M && is_measured(*at);
        let Some(at) = (0..heights.len()).find(is_found) else { continue };
        let spacing = world.elevation_spacing_m(q);
        let (side_m, [x, y], [width, height]) = (world.node_side_m(q), world.fields().origin, world.extent_m());
        let along =
            |index: u32, post: usize, extent: f64| (f64::from(index) * side_m + post as f64 * spacing).min(extent);
        let place = [x + along(node.m(), at % posts, width), y + along(node.n(), at / posts, height)];
        return Some(Extreme { height_m: f64::from(heights[at]), place, lon_lat: None });
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_go_across_the_date_line() {
        assert_eq!(bounds_of([[179.0, -18.0], [-179.0, -17.0]].into_iter()), Some([179.0, -18.0, -179.0, -17.0]));
        assert_eq!(bounds_of([[-10.0, 1.0], [20.0, 2.0]].into_iter()), Some([-10.0, 1.0, 20.0, 2.0]));
        assert_eq!(bounds_of(std::iter::empty()), None);
    }

    #[test]
    fn a_place_has_its_longitude_and_latitude() {
        // echo -122 45 | proj +proj=utm +zone=10 +datum=WGS84 gives 578815.30 4983436.77
        let text = "+proj=utm +zone=10 +datum=WGS84";
        let [lon, lat] = Way::of(Some(text), None, None).unwrap().lon_lat_at([578_815.30, 4_983_436.77]).unwrap();
        assert!((lon + 122.0).abs() < 1e-6 && (lat - 45.0).abs() < 1e-6, "{lon} {lat}");
        let table = LonLatTable {
            lonlat: "+proj=longlat +datum=WGS84 +no_defs".into(),
            plane: text.into(),
            first: [570_000.0, 4_980_000.0],
            step: [10_000.0, 10_000.0],
            size: [2, 2],
            offsets_m: vec![100.0, -50.0, 102.0, -50.0, 100.0, -51.0, 102.0, -51.0],
            shift_m: 112.0,
            error_m: 0.0,
        };
        let shifted = table.world_from_plane([578_815.30, 4_983_436.77]);
        let [lon, lat] = Way::of(None, None, Some(&table)).unwrap().lon_lat_at(shifted).unwrap();
        assert!((lon + 122.0).abs() < 1e-6 && (lat - 45.0).abs() < 1e-6, "{lon} {lat}");
    }
}
