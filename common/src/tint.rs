//! Colours by height, of a world that has no picture.

use serde::{Deserialize, Serialize};

type Stop = (f32, [f32; 3]);

/// Land on Earth: meadow, field, heath, rock.
const EARTH: [Stop; 6] = [
    (0.0, [88.0, 128.0, 82.0]),
    (0.18, [126.0, 156.0, 94.0]),
    (0.38, [184.0, 182.0, 124.0]),
    (0.58, [176.0, 150.0, 108.0]),
    (0.78, [148.0, 126.0, 110.0]),
    (1.0, [186.0, 180.0, 176.0]),
];
/// Mars: dust.
const MARS: [Stop; 5] = [
    (0.0, [96.0, 62.0, 48.0]),
    (0.3, [152.0, 96.0, 64.0]),
    (0.6, [194.0, 134.0, 92.0]),
    (0.85, [220.0, 178.0, 138.0]),
    (1.0, [242.0, 226.0, 208.0]),
];
/// Bodies without air: regolith.
const GREY: [Stop; 3] = [(0.0, [74.0, 72.0, 72.0]), (0.6, [150.0, 146.0, 142.0]), (1.0, [226.0, 224.0, 220.0])];
/// Below the sea, by share of the greatest depth.
const SEA: [Stop; 3] = [(0.0, [18.0, 44.0, 84.0]), (0.7, [50.0, 104.0, 150.0]), (1.0, [136.0, 184.0, 204.0])];
const SNOW: [f32; 3] = [244.0, 246.0, 248.0];
/// Snow begins so far below the line, in hollows, and is whole so far above it, metres.
const SNOW_BAND_M: [f32; 2] = [-600.0, 200.0];
/// Snow lies in the upper part of the terrain's range alone, or a plateau above the line would be
/// blank: it begins and is whole at these shares of the range.
const SNOW_SHARE: [f32; 2] = [0.35, 0.65];
/// Half a step of stored heights, metres: a height of exactly 0 is not more.
pub const AT_ZERO_M: f32 = 1.0 / 256.0;

/// The colours of land.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Palette {
    /// Meadows to rock.
    Earth,
    /// Dust.
    Mars,
    /// Regolith.
    Grey,
}

impl Palette {
    const fn stops(self) -> &'static [Stop] {
        match self {
            Self::Earth => &EARTH,
            Self::Mars => &MARS,
            Self::Grey => &GREY,
        }
    }
}

/// Colours by height.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeightColors {
    /// Colours of land.
    pub palette: Palette,
    /// Height of its first colour, metres.
    pub low_m: f32,
    /// Height of its last one.
    pub high_m: f32,
    /// Heights below 0 are depths.
    pub has_sea: bool,
    /// Heights of exactly 0 are water.
    pub has_flat_sea: bool,
    /// Where it snows, metres; `None`: nowhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub snow_line_m: Option<f32>,
    /// Factor on slopes with which the relief was shaded: flat land gets relief, too.
    pub relief: f32,
}

/// 0 below the first bound, 1 above the second, smooth between.
fn smooth([from, to]: [f32; 2], v: f32) -> f32 {
    let t = ((v - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn ramp(stops: &[Stop], t: f32) -> [f32; 3] {
    let t = t.clamp(0.0, 1.0);
    let after = stops.iter().position(|(at, _)| *at >= t).unwrap_or(stops.len() - 1).max(1);
    let ((from, a), (to, b)) = (stops[after - 1], stops[after]);
    let s = ((t - from) / (to - from)).clamp(0.0, 1.0);
    [0, 1, 2].map(|c| a[c] + s * (b[c] - a[c]))
}

impl HeightColors {
    /// The colour of level ground at a height, 0 to 255.
    #[must_use]
    pub fn color(&self, height_m: f32) -> [f32; 3] {
        if self.has_sea && height_m < 0.0 {
            return ramp(&SEA, 1.0 + height_m / 6000.0);
        }
        if self.has_flat_sea && height_m.abs() <= AT_ZERO_M {
            return ramp(&SEA, 0.85);
        }
        let share = (height_m - self.low_m) / (self.high_m - self.low_m);
        let land = ramp(self.palette.stops(), share);
        let snow = self
            .snow_line_m
            .map_or(0.0, |line| smooth(SNOW_BAND_M.map(|v| line + v), height_m) * smooth(SNOW_SHARE, share));
        [0, 1, 2].map(|c| land[c] + snow * (SNOW[c] - land[c]))
    }
}
