//! Conversion of longitudes and latitudes to a database's CRS, for programs without PROJ.
//!
//! PROJ is the reference, as for sources: with its datum shifts, its grids, and its choice of
//! operations. The difference between PROJ and `proj4rs`, if there is any, is tabulated over the
//! world ([`LonLatTable`]).

use crate::source::TargetCrs;
use crate::source::raster::traditional;
use gdal::spatial_ref::{CoordTransform, SpatialRef};
use terravision_common::lonlat::{LonLatTable, MAX_SIDE, Projection, WGS84_LONLAT, lonlat_of_body, without_datum};
use terravision_common::world::World;

/// If `proj4rs` alone is closer to PROJ than this, metres, no table is needed.
const TOLERANCE_M: f64 = 0.1;
/// A table is refined until its error is below this, metres, or it has the maximum number of nodes.
const WANTED_ERROR_M: f64 = 0.01;
/// A table with a larger error, metres, is taken only if no other plane gives a better one.
const FAIR_ERROR_M: f64 = 1.0;
/// Margin of the table around the world, as a share of its longer side, because cameras fly outside
/// too.
const MARGIN: f64 = 0.25;
/// Points along each side of the world at which places are compared.
const CHECKS: usize = 9;

/// PROJ's transformation from longitude and latitude to the database's CRS.
struct Truth(CoordTransform);

impl Truth {
    fn at(&self, places: &[[f64; 2]]) -> Vec<Option<[f64; 2]>> {
        transformed(&self.0, places)
    }
}

/// Transformed places; `None` for those that cannot be transformed.
fn transformed(transform: &CoordTransform, places: &[[f64; 2]]) -> Vec<Option<[f64; 2]>> {
    let (mut x, mut y): (Vec<f64>, Vec<f64>) = places.iter().map(|[x, y]| (*x, *y)).unzip();
    // Points that cannot be transformed come back infinite.
    transform.transform_coords(&mut x, &mut y, &mut []).ok();
    x.into_iter().zip(y).map(|(x, y)| (x.is_finite() && y.is_finite()).then_some([x, y])).collect()
}

/// Points over a rectangle, `n` along each side, rows from the first.
fn grid(low: [f64; 2], high: [f64; 2], n: usize) -> Vec<[f64; 2]> {
    let at = |axis: usize, k: usize| low[axis] + (high[axis] - low[axis]) * k as f64 / (n - 1) as f64;
    (0..n * n).map(|k| [at(0, k % n), at(1, k / n)]).collect()
}

/// The largest distance between places and the reference; `None` without places, or if one of them
/// cannot be transformed.
fn largest_distance(places: impl Iterator<Item = Option<[f64; 2]>>, truth: &[Option<[f64; 2]>]) -> Option<f64> {
    let mut largest: Option<f64> = None;
    for (place, truth) in places.zip(truth) {
        let Some(truth) = truth else { continue };
        let place = place?;
        let distance = (place[0] - truth[0]).hypot(place[1] - truth[1]);
        largest = Some(largest.map_or(distance, |l| l.max(distance)));
    }
    largest
}

/// The table that a world needs; `None` when `proj4rs` agrees with PROJ, or PROJ cannot transform.
#[must_use]
pub fn table(target: &TargetCrs, world: &World) -> Option<LonLatTable> {
    let srs = target.srs().ok()?;
    let proj4 = target.crs().proj4.as_deref().unwrap_or_default();
    let lonlat = lonlat_of_body(proj4);
    let geographic = if lonlat == WGS84_LONLAT { SpatialRef::from_epsg(4326).ok()? } else { srs.geog_cs().ok()? };
    let geographic = traditional(geographic);
    let truth = Truth(CoordTransform::new(&geographic, &srs).ok()?);
    let back = CoordTransform::new(&srs, &geographic).ok()?;
    let [low, high] = world.crs_bounds().map(|corner| corner.to_array());
    let found = transformed(&back, &grid(low, high, CHECKS));
    let checks: Vec<[f64; 2]> = found.into_iter().flatten().filter(|[_, lat]| lat.abs() <= 90.0).collect();
    let places = truth.at(&checks);
    let from = Projection::parse(&lonlat).ok()?;

    let plain = match target.crs().proj4.as_deref() {
        Some(text) => Projection::parse(text).ok(),
        None => target.crs().epsg.and_then(Projection::of_epsg),
    };
    let off = |plane: &Projection| largest_distance(checks.iter().map(|check| from.to(plane, *check).ok()), &places);
    let shift_m = plain.as_ref().and_then(off);
    if shift_m.is_some_and(|shift| shift <= TOLERANCE_M) {
        return None;
    }
    // With the world's own projection the table has only the datum shift. If `proj4rs` does not
    // know the projection, or mistakes it for another, a plane around the world's middle is used.
    let middle = checks.get(checks.len() / 2)?;
    let nearby = lonlat.replacen(
        "+proj=longlat",
        &format!("+proj=laea +lat_0={:.6} +lon_0={:.6} +x_0=0 +y_0=0", middle[1], middle[0]),
        1,
    );
    let own = without_datum(proj4);
    let shift_m = shift_m.or_else(|| off(&Projection::parse(&own).ok()?)).unwrap_or(0.0);
    let mut best: Option<LonLatTable> = None;
    for plane in [own, nearby] {
        let Some(table) = tabulated(&lonlat, plane, &truth, &checks, &places, shift_m) else { continue };
        if best.as_ref().is_none_or(|best| table.error_m < best.error_m) {
            best = Some(table);
        }
        if best.as_ref().is_some_and(|best| best.error_m <= FAIR_ERROR_M) {
            break;
        }
    }
    best
}

/// A table over a plane, as fine as it needs to be.
fn tabulated(
    lonlat: &str,
    plane: String,
    truth: &Truth,
    checks: &[[f64; 2]],
    places: &[Option<[f64; 2]>],
    shift_m: f64,
) -> Option<LonLatTable> {
    let (from, to) = (Projection::parse(lonlat).ok()?, Projection::parse(&plane).ok()?);
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for check in checks {
        let place = from.to(&to, *check).ok()?;
        low = [0, 1].map(|axis| low[axis].min(place[axis]));
        high = [0, 1].map(|axis| high[axis].max(place[axis]));
    }
    let margin = MARGIN * (high[0] - low[0]).max(high[1] - low[1]);
    let (low, high) = (low.map(|v| v - margin), high.map(|v| v + margin));
    let mut side = 2;
    loop {
        let step = [0, 1].map(|axis| (high[axis] - low[axis]) / (side - 1) as f64);
        let lonlats: Vec<Option<[f64; 2]>> =
            grid(low, high, side).into_iter().map(|node| to.to(&from, node).ok()).collect();
        let mut table = LonLatTable {
            lonlat: lonlat.to_owned(),
            plane: plane.clone(),
            first: low,
            step,
            size: [side; 2],
            offsets_m: Vec::new(),
            shift_m: rounded(shift_m),
            error_m: 0.0,
        };
        let known: Vec<[f64; 2]> = lonlats.iter().map(|place| place.unwrap_or([f64::NAN; 2])).collect();
        let mut offsets: Vec<Option<[f64; 2]>> = truth.at(&known);
        for (k, offset) in offsets.iter_mut().enumerate() {
            let node = table.node(k % side, k / side);
            *offset = offset.filter(|_| lonlats[k].is_some()).map(|place| [place[0] - node[0], place[1] - node[1]]);
        }
        fill(&mut offsets, side)?;
        table.offsets_m = offsets.into_iter().flatten().flatten().map(rounded).collect();
        let error = table_error(&table, &from, &to, truth, checks, places)?;
        if !table.is_valid() {
            return None;
        }
        if error <= WANTED_ERROR_M || side == MAX_SIDE {
            table.error_m = rounded(error);
            return Some(table);
        }
        side = 2 * side - 1;
    }
}

/// The largest error of a table: at the checks over the world, and in the middle of its cells.
fn table_error(
    table: &LonLatTable,
    from: &Projection,
    to: &Projection,
    truth: &Truth,
    checks: &[[f64; 2]],
    places: &[Option<[f64; 2]>],
) -> Option<f64> {
    let found = |check: &[f64; 2]| from.to(to, *check).ok().map(|place| table.world_from_plane(place));
    let over_the_world = largest_distance(checks.iter().map(found), places)?;
    let middles = (0..(table.size[0] - 1) * (table.size[1] - 1)).filter_map(|k| {
        let (i, j) = (k % (table.size[0] - 1), k / (table.size[0] - 1));
        let node = table.node(i, j);
        to.to(from, [0, 1].map(|axis| node[axis] + 0.5 * table.step[axis])).ok()
    });
    let middles: Vec<[f64; 2]> = middles.collect();
    let in_cells = largest_distance(middles.iter().map(found), &truth.at(&middles)).unwrap_or(0.0);
    Some(over_the_world.max(in_cells))
}

/// Gives nodes without an offset (outside of the projection's domain) that of a neighbour; `None`
/// when no node has one.
fn fill(offsets: &mut [Option<[f64; 2]>], side: usize) -> Option<()> {
    while offsets.iter().any(Option::is_none) {
        let before = offsets.to_vec();
        for (k, offset) in offsets.iter_mut().enumerate().filter(|(_, offset)| offset.is_none()) {
            let (i, j) = (k % side, k / side);
            let beside = [(i.wrapping_sub(1), j), (i + 1, j), (i, j.wrapping_sub(1)), (i, j + 1)];
            let known = beside.iter().filter(|(i, j)| *i < side && *j < side).find_map(|(i, j)| before[j * side + i]);
            *offset = known;
        }
        if before.iter().all(Option::is_none) {
            return None;
        }
    }
    Some(())
}

/// To a tenth of a millimetre.
fn rounded(metres: f64) -> f64 {
    (metres * 1e4).round() / 1e4
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::crs::parse;
    use terravision_common::world::WorldFields;
    use terravision_testkit::worlds::fields;

    /// A world of 100 intervals along each side around a place, and its CRS.
    fn world(crs: &str, middle: [f64; 2], spacing_m: f64) -> (TargetCrs, World) {
        let world = World::new(WorldFields {
            origin: middle.map(|v| v - 50.0 * spacing_m),
            ..fields([100; 2], spacing_m, [16, 256])
        });
        (TargetCrs::new(&parse("test", crs).unwrap(), crs).unwrap(), world.unwrap())
    }

    #[test]
    fn places_are_those_of_proj_on_every_datum() {
        // From gdaltransform -s_srs EPSG:4326 -t_srs EPSG:N (GDAL 3.6, PROJ 9.1): places in the
        // middle of each world.
        for (crs, lonlat, place, spacing_m) in [
            ("EPSG:27700", [-3.15, 54.45], [325_530.597, 506_676.247], 40.0),
            ("EPSG:26717", [-81.0, 38.0], [499_982.879, 4_205_603.250], 40.0),
            ("EPSG:2039", [35.0, 31.5], [200_033.740, 600_894.611], 1000.0),
        ] {
            let (target, world) = world(crs, place, spacing_m);
            let table = table(&target, &world).unwrap();
            let (from, to) = (Projection::parse(&table.lonlat).unwrap(), Projection::parse(&table.plane).unwrap());
            let [x, y] = table.world_from_plane(from.to(&to, lonlat).unwrap());
            // Which operation PROJ takes depends on its version and its grids, by some metres.
            assert!((x - place[0]).hypot(y - place[1]) < 5.0, "{crs}: {x} {y}");
            assert!(table.shift_m > 10.0 && table.error_m < 0.05, "{crs}: {table:?}");
        }
    }

    #[test]
    fn a_table_is_as_good_as_it_says() {
        // A projection that proj4rs does not know, over 3000 km; and one whose datum shifts by 170
        // m.
        for (crs, middle, spacing_m) in
            [("EPSG:27200", [2_600_000.0, 6_000_000.0], 3000.0), ("EPSG:23030", [500_000.0, 4_500_000.0], 3000.0)]
        {
            let (target, world) = world(crs, middle, spacing_m);
            let table = table(&target, &world).unwrap();
            let (from, to) = (Projection::parse(&table.lonlat).unwrap(), Projection::parse(&table.plane).unwrap());
            let (wgs84, srs) = (traditional(SpatialRef::from_epsg(4326).unwrap()), target.srs().unwrap());
            let [low, high] = world.crs_bounds().map(|corner| corner.to_array());
            let places = grid(low, high, 14);
            let lonlats = transformed(&CoordTransform::new(&srs, &wgs84).unwrap(), &places);
            let mut count = 0;
            for (place, lonlat) in places.iter().zip(lonlats) {
                let Some(lonlat) = lonlat else { continue };
                let [x, y] = table.world_from_plane(from.to(&to, lonlat).unwrap());
                let off = (x - place[0]).hypot(y - place[1]);
                assert!(off < 0.02 + 2.0 * table.error_m, "{crs}: {off} m at {place:?}, {} m told", table.error_m);
                count += 1;
            }
            assert!(count > 100 && table.error_m < FAIR_ERROR_M, "{crs}: {count} {}", table.error_m);
        }
    }

    #[test]
    fn worlds_that_proj4rs_knows_need_no_table() {
        for (crs, middle) in [
            ("EPSG:32610", [560_000.0, 5_110_000.0]),
            ("EPSG:25832", [500_000.0, 5_200_000.0]),
            ("EPSG:2154", [900_000.0, 6_500_000.0]),
            ("EPSG:3031", [0.0, 0.0]),
            ("EPSG:3857", [1_300_000.0, 6_000_000.0]),
            ("+proj=eqc +R=3396190 +lon_0=137 +units=m", [0.0, 0.0]),
            ("+proj=laea +lat_0=50 +lon_0=10 +a=6378137 +b=6356752.3142 +units=m", [0.0, 0.0]),
        ] {
            let (target, world) = world(crs, middle, 100.0);
            assert_eq!(table(&target, &world), None, "{crs}");
        }
    }
}
