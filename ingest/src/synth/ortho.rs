//! Colours of the synthetic world, as an aerial photograph would show them: sunlit from the north
//! west.

use super::noise::{direction, hash, noise, octaves, smoothstep, unit};
use super::terrain::{LAKE_M, Terrain};

type Color = [f32; 3];

const WATER_DEEP: Color = [22.0, 58.0, 92.0];
const WATER_SHALLOW: Color = [62.0, 118.0, 130.0];
const SAND: Color = [186.0, 174.0, 138.0];
const MEADOW: Color = [98.0, 117.0, 64.0];
const ALPINE: Color = [122.0, 118.0, 82.0];
const FOREST: Color = [40.0, 66.0, 38.0];
const ROCK: Color = [126.0, 118.0, 110.0];
const ROCK_DARK: Color = [86.0, 80.0, 76.0];
const SCREE: Color = [158.0, 150.0, 140.0];
const SNOW: Color = [240.0, 244.0, 250.0];
const ROAD: Color = [168.0, 164.0, 156.0];
/// What grows on fields.
const CROPS: [Color; 8] = [
    [122.0, 134.0, 72.0],
    [98.0, 120.0, 60.0],
    [172.0, 160.0, 104.0],
    [148.0, 132.0, 94.0],
    [88.0, 108.0, 58.0],
    [184.0, 174.0, 116.0],
    [124.0, 106.0, 82.0],
    [128.0, 144.0, 82.0],
];
const ROOFS: [Color; 4] = [[156.0, 82.0, 62.0], [132.0, 70.0, 56.0], [120.0, 116.0, 114.0], [178.0, 164.0, 150.0]];

fn mix(a: Color, b: Color, t: f32) -> Color {
    [0, 1, 2].map(|c| a[c] + t * (b[c] - a[c]))
}

fn scaled(a: Color, by: f32) -> Color {
    a.map(|v| v * by)
}

/// What is known of the ground at a point.
#[derive(Debug, Clone, Copy)]
pub struct Ground {
    /// East and north, metres.
    pub at: [f64; 2],
    /// Height, metres.
    pub height: f32,
    /// Rise per metre to the east and the north.
    pub slope: [f32; 2],
}

/// A settled region: what is around one of the scattered sites, whose borders are roads.
struct Parish {
    /// Hash of the site.
    hash: u32,
    /// From the site to the point, metres.
    from_site: [f32; 2],
    /// Distance to the border with the next parish, metres.
    to_border: f32,
}

/// Paints the ground.
#[derive(Debug, Clone, Copy)]
pub struct Painter {
    terrain: Terrain,
    pixel_m: f32,
}

/// Distance of parishes' sites, metres.
const PARISH_M: f64 = 1700.0;

impl Painter {
    /// A painter for pixels of a size.
    #[must_use]
    pub fn new(terrain: Terrain, pixel_m: f64) -> Self {
        Self { terrain, pixel_m: pixel_m as f32 }
    }

    /// Colour of the ground at a point, 0 to 255.
    #[must_use]
    pub fn color(&self, ground: &Ground) -> Color {
        let [x, y] = ground.at;
        let steep = (ground.slope[0] * ground.slope[0] + ground.slope[1] * ground.slope[1]).sqrt();
        if ground.height <= LAKE_M {
            return self.water(x, y);
        }
        let grain = noise(x / 11.0, y / 11.0, self.terrain.seed(20));
        let blotch = octaves(x / 160.0, y / 160.0, self.terrain.seed(21), 3);
        let wide = octaves(x / 2200.0, y / 2200.0, self.terrain.seed(22), 2);
        // Warm slopes (south east) carry trees higher and less snow.
        let warm = -ground.slope[1] * 0.7 + ground.slope[0] * 0.3;
        let above_lake = ground.height - LAKE_M;

        let mut color = mix(MEADOW, ALPINE, smoothstep(900.0, 1900.0, ground.height + 120.0 * blotch));
        color = scaled(color, 1.0 + 0.10 * blotch + 0.05 * grain);
        let gentle = 1.0 - smoothstep(0.10, 0.17, steep);
        let settled = gentle * (1.0 - smoothstep(850.0, 1000.0, ground.height + 80.0 * wide));
        let wooded = smoothstep(-0.02, 0.10, wide + 0.55 * blotch + 0.9 * steep - 0.16 - 0.60 * settled);
        if settled > 0.5 && wooded < 0.5 && above_lake > 2.5 {
            color = self.settlement(x, y, steep, blotch, grain);
        }
        let tree_line = 1720.0 + 260.0 * blotch + 180.0 * wide + 420.0 * warm;
        let trees = wooded
            * (1.0 - smoothstep(tree_line - 90.0, tree_line + 60.0, ground.height))
            * (1.0 - smoothstep(0.85, 1.15, steep + 0.25 * blotch));
        color = mix(color, self.forest(x, y, grain, blotch), smoothstep(0.35, 0.65, trees + 0.16 * grain));

        let strata = noise(f64::from(ground.height) / 34.0 + 0.8 * f64::from(blotch), x / 900.0, self.terrain.seed(23));
        let bare = smoothstep(0.62, 0.95, steep + 0.22 * blotch + 0.12 * grain + 0.00022 * (ground.height - 1700.0));
        let rock = mix(ROCK, ROCK_DARK, smoothstep(-0.2, 0.5, strata + 0.5 * grain));
        let stones = smoothstep(2050.0, 2350.0, ground.height + 260.0 * blotch);
        color = mix(color, scaled(SCREE, 1.0 + 0.12 * grain), stones * (1.0 - bare) * 0.85);
        color = mix(color, scaled(rock, 1.0 + 0.14 * grain), bare);

        let snow_line = 2420.0 + 240.0 * blotch + 130.0 * wide + 620.0 * warm;
        let snow = smoothstep(snow_line - 110.0, snow_line + 90.0, ground.height)
            * (1.0 - smoothstep(0.85, 1.35, steep + 0.2 * grain));
        color = mix(color, scaled(SNOW, 1.0 + 0.02 * grain), snow);
        color = mix(SAND, color, smoothstep(0.4, 2.6, above_lake + grain));
        self.lit(color, ground.slope, snow)
    }

    /// Sunlight: a little of it is in every aerial photograph, and it is what shows relief.
    fn lit(&self, color: Color, slope: [f32; 2], snow: f32) -> Color {
        // To the sun: north west, 50 degrees high (as relief maps have it; real photographs north
        // of the tropics have it in the south, which the eye inverts).
        let [east, north, up] = [-0.4545f32, 0.4545, 0.766];
        let cosine =
            (up - east * slope[0] - north * slope[1]) / (1.0 + slope[0] * slope[0] + slope[1] * slope[1]).sqrt();
        let light = cosine.max(0.0) / up;
        let shade = (0.36 + 0.64 * light).min(1.22);
        // Shadows are lit by the sky: bluer, on snow most of all.
        let blue = (1.0 - light.min(1.0)) * (0.07 + 0.10 * snow);
        [color[0] * (shade - 0.5 * blue), color[1] * shade, color[2] * (shade + blue)].map(|v| v.clamp(0.0, 255.0))
    }

    fn water(&self, x: f64, y: f64) -> Color {
        let depth = 0.5 + 0.8 * octaves(x / 900.0, y / 900.0, self.terrain.seed(24), 2);
        let ripple = noise(x / 23.0, y / 31.0, self.terrain.seed(25));
        scaled(mix(WATER_SHALLOW, WATER_DEEP, smoothstep(-0.2, 0.7, depth)), 1.0 + 0.03 * ripple)
    }

    /// Crowns, lit on one side.
    fn forest(&self, x: f64, y: f64, grain: f32, blotch: f32) -> Color {
        let crowns = noise(x / 7.0, y / 7.0, self.terrain.seed(26))
            - noise((x + 4.0) / 7.0, (y - 4.0) / 7.0, self.terrain.seed(26));
        let kind = smoothstep(-0.25, 0.45, blotch + 0.4 * grain);
        scaled(mix(FOREST, [66.0, 88.0, 44.0], 0.55 * kind), 1.0 + 0.32 * crowns)
    }

    /// Fields, tracks, roads and villages.
    fn settlement(&self, x: f64, y: f64, steep: f32, blotch: f32, grain: f32) -> Color {
        let parish = self.parish(x, y);
        let road_half_m = f32::max(4.5, 0.8 * self.pixel_m);
        let on_road =
            1.0 - smoothstep(road_half_m - 0.5 * self.pixel_m, road_half_m + 0.5 * self.pixel_m, parish.to_border);
        // Parcels lie along an axis of their parish, in strips of different width.
        let [ax, ay] = direction(parish.hash);
        let [px, py] = parish.from_site;
        let (along, across) = (px * ax + py * ay, py * ax - px * ay);
        let length_m = 170.0 + 160.0 * unit(hash(i64::from(parish.hash), 1, 3));
        let width_m = 60.0 + 70.0 * unit(hash(i64::from(parish.hash), 2, 3));
        let strip = (across / length_m).floor();
        let shift = width_m * unit(hash(strip as i64, i64::from(parish.hash), 5));
        let parcel = ((along + shift) / width_m).floor();
        let inside = |v: f32, size: f32| {
            let t = v - (v / size).floor() * size;
            t.min(size - t)
        };
        let to_hedge = inside(along + shift, width_m).min(inside(across, length_m));
        let id = hash(parcel as i64, strip as i64, parish.hash);
        let crop = CROPS[(id & 7) as usize];
        // Furrows along the parcel, too fine to count but enough to see which way it lies.
        let furrow = noise(f64::from(along) / 6.0, f64::from(across) / 60.0, id);
        let mut color = scaled(crop, 1.0 + 0.07 * furrow + 0.06 * blotch + 0.04 * grain);
        if id >> 29 == 0 {
            color = scaled(MEADOW, 1.0 + 0.1 * blotch + 0.05 * grain);
        }
        let hedge_half_m = f32::max(2.5, 0.55 * self.pixel_m);
        let is_hedged = id >> 30 != 3;
        if is_hedged && to_hedge < hedge_half_m {
            color = mix(color, FOREST, 0.55);
        }
        if let Some(roof) = self.village(&parish, along, across, steep) {
            color = roof;
        }
        mix(color, scaled(ROAD, 1.0 + 0.05 * grain), on_road)
    }

    /// Streets, gardens and roofs around a parish's site.
    fn village(&self, parish: &Parish, along: f32, across: f32, steep: f32) -> Option<Color> {
        let radius_m = 90.0 + 260.0 * unit(hash(i64::from(parish.hash), 7, 11)).powi(2);
        let [px, py] = parish.from_site;
        let edge = 40.0 * noise(f64::from(px) / 90.0, f64::from(py) / 90.0, parish.hash);
        if steep > 0.12 || (px * px + py * py).sqrt() + edge > radius_m {
            return None;
        }
        // Plots of 26 m with a house each, streets between every second row.
        let plot = 26.0;
        let (i, j) = ((along / plot).floor(), (across / plot).floor());
        let (u, v) = (along - i * plot - 0.5 * plot, across - j * plot - 0.5 * plot);
        let id = hash(i as i64, j as i64, parish.hash ^ 0x55);
        if (j as i64).rem_euclid(3) == 0 && v.abs() < 5.0 || (i as i64).rem_euclid(7) == 0 && u.abs() < 4.0 {
            return Some(ROAD);
        }
        let (half_u, half_v) = (5.0 + 4.0 * unit(id), 4.0 + 3.5 * unit(id.rotate_left(9)));
        let is_roof = u.abs() < half_u && v.abs() < half_v && id & 7 != 0;
        let garden = scaled(MEADOW, 0.85 + 0.3 * unit(id.rotate_left(17)));
        let lit = if v > 0.0 { 1.12 } else { 0.86 };
        Some(if is_roof { scaled(ROOFS[(id >> 3 & 3) as usize], lit) } else { garden })
    }

    fn parish(&self, x: f64, y: f64) -> Parish {
        let (cx, cy) = ((x / PARISH_M).floor() as i64, (y / PARISH_M).floor() as i64);
        let seed = self.terrain.seed(30);
        let mut nearest: [(f32, u32, [f32; 2]); 2] = [(f32::MAX, 0, [0.0; 2]); 2];
        for j in cy - 1..=cy + 1 {
            for i in cx - 1..=cx + 1 {
                let id = hash(i, j, seed);
                let place = |cell: i64, part: u32| (cell as f64 + 0.15 + 0.7 * f64::from(unit(part))) * PARISH_M;
                let from =
                    [(x - place(i, id)) as f32, (y - place(j, id.rotate_left(15).wrapping_mul(0x9e37_79b1))) as f32];
                let distance = from[0] * from[0] + from[1] * from[1];
                if distance < nearest[0].0 {
                    nearest = [(distance, id, from), nearest[0]];
                } else if distance < nearest[1].0 {
                    nearest[1] = (distance, id, from);
                }
            }
        }
        let [(_, hash, a), (_, _, b)] = nearest;
        // Distance to the line half way between the two sites.
        let between = [b[0] - a[0], b[1] - a[1]];
        let length = (between[0] * between[0] + between[1] * between[1]).sqrt().max(1.0);
        let to_border = ((a[0] + b[0]) * between[0] + (a[1] + b[1]) * between[1]).abs() * 0.5 / length;
        Parish { hash, from_site: a, to_border }
    }
}
