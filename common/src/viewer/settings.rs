//! How a flight draws for the page: settings that people change while they look.

use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// How far one may see through haze, metres.
const HAZE_M: RangeInclusive<f64> = 1.0..=1e9;

/// The left eye's picture beside the right one's.
pub const SIDE_BY_SIDE: &str = "side-by-side";

/// How the flight draws, where it is not left to TerraVision.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct StreamSettings {
    /// `--facet-px`.
    pub facet_px: Option<f64>,
    /// `--texel-px`.
    pub texel_px: Option<f64>,
    /// `--fps`.
    pub fps: Option<f64>,
    /// `--technique`; "auto" or `None` for the usual one.
    pub technique: Option<String>,
    /// `--exaggeration`.
    pub exaggeration: Option<f64>,
    /// `--overlay`; "none" or `None` for none.
    pub overlay: Option<String>,
    /// `--sun`; "off" or `None` for colours as they are stored.
    pub sun: Option<String>,
    /// `--shadows`, where there is a sun.
    pub shadows: Option<bool>,
    /// `--haze`, metres; 0 or `None` for clear air.
    pub haze: Option<f64>,
    /// `--stereo`; "off" or `None` for one eye.
    pub stereo: Option<String>,
    /// `--eye-separation`, metres; `None` for the usual share of the convergence.
    pub eye_separation: Option<f64>,
    /// `--convergence`, metres; needed for two eyes.
    pub convergence: Option<f64>,
}

impl StreamSettings {
    /// What is wrong with them, in a sentence; `None` where a flight can be started with them.
    #[must_use]
    pub fn fault(&self) -> Option<String> {
        let numbers = [
            ("facet_px", self.facet_px, [0.5, 100.0]),
            ("texel_px", self.texel_px, [0.25, 32.0]),
            ("fps", self.fps, [1.0, 60.0]),
            ("exaggeration", self.exaggeration, [0.0, 100.0]),
            ("convergence", self.convergence, [0.01, 1e6]),
            ("eye_separation", self.eye_separation, [0.0, self.convergence.unwrap_or(1e6)]),
        ];
        let number = numbers.into_iter().find_map(|(name, value, [low, high])| {
            let found = value.filter(|value| !(low..=high).contains(value))?;
            Some(format!("{name}: expected a number from {low} to {high}, found {found}"))
        });
        let words = [
            ("technique", &self.technique, &["auto", "mesh", "rays"][..]),
            ("overlay", &self.overlay, &["none", "tree"][..]),
            ("stereo", &self.stereo, &["off", SIDE_BY_SIDE, "anaglyph"][..]),
        ];
        let word = words.into_iter().find_map(|(name, value, known)| {
            let found = value.as_ref().filter(|value| !known.contains(&value.as_str()))?;
            Some(format!("{name}: expected one of {}, found {found:?}", known.join(", ")))
        });
        number.or(word).or_else(|| self.light_fault())
    }

    fn light_fault(&self) -> Option<String> {
        if let Some(found) = self.haze.filter(|haze| *haze != 0.0 && !HAZE_M.contains(haze)) {
            let (low, high) = (HAZE_M.start(), HAZE_M.end());
            return Some(format!(
                "haze: expected 0 for none, or a number of metres from {low} to {high}, found {found}"
            ));
        }
        let found = self.sun.as_ref().filter(|sun| !is_sun(sun))?;
        Some(format!(
            "sun: expected auto, off, an azimuth and an altitude in degrees, e.g. 120,8, or a date and time, \
             e.g. 2026-06-21T12:45Z, found {found:?}"
        ))
    }

    /// Their flags of the command line: with `fps`, those of a flight.
    #[must_use]
    pub fn flags(&self) -> Vec<String> {
        let mut flags = self.picture_flags();
        let finest = [("--facet-px", self.facet_px), ("--texel-px", self.texel_px), ("--fps", self.fps)];
        for (flag, value) in finest {
            flags.extend(value.into_iter().flat_map(|value| [flag.to_owned(), value.to_string()]));
        }
        flags
    }

    /// The flags of what the finest picture shows, too.
    #[must_use]
    pub fn picture_flags(&self) -> Vec<String> {
        let technique = self.technique.clone().filter(|technique| technique != "auto");
        let overlay = self.overlay.clone().filter(|overlay| overlay != "none");
        let exaggeration = self.exaggeration.map(|factor| factor.to_string());
        let haze = self.haze.filter(|haze| *haze > 0.0).map(|metres| metres.to_string());
        let sun = self.sun().map(str::to_owned);
        let all = [
            ("--technique", technique),
            ("--exaggeration", exaggeration),
            ("--overlay", overlay),
            ("--sun", sun.clone()),
            ("--haze", haze),
        ];
        let flag = |(flag, value): (&str, Option<String>)| value.map(|value| [flag.to_owned(), value]);
        let mut flags: Vec<String> = all.into_iter().chain(self.stereo_flags()).flat_map(flag).flatten().collect();
        if sun.is_some() && self.shadows == Some(true) {
            flags.push("--shadows".to_owned());
        }
        flags
    }

    /// The same without sun and haze.
    #[must_use]
    pub fn unlit(self) -> Self {
        Self { sun: None, shadows: None, haze: None, ..self }
    }

    /// Where the sun stands; `None` where nothing is lit.
    fn sun(&self) -> Option<&str> {
        self.sun.as_deref().filter(|sun| !sun.eq_ignore_ascii_case("off"))
    }

    fn stereo_flags(&self) -> impl Iterator<Item = (&'static str, Option<String>)> {
        let metres = |value: Option<f64>| value.map(|metres| metres.to_string());
        let stereo = self.stereo().map(str::to_owned);
        let flags = [
            ("--convergence", metres(self.convergence)),
            ("--eye-separation", metres(self.eye_separation)),
            ("--stereo", stereo.clone()),
        ];
        flags.into_iter().filter(move |_| stereo.is_some())
    }

    /// How two eyes are shown; `None` for one.
    #[must_use]
    pub fn stereo(&self) -> Option<&str> {
        self.stereo.as_deref().filter(|stereo| *stereo != "off")
    }

    /// Size of one eye's picture, where the whole has this size.
    #[must_use]
    pub fn eye_size(&self, [width, height]: [u32; 2]) -> [u32; 2] {
        if self.stereo() == Some(SIDE_BY_SIDE) { [(width / 2).max(1), height] } else { [width, height] }
    }
}

/// Whether a text is what `--sun` takes. Dates are only looked at: whether one exists, and whether
/// the sun's place over this world can be known then, the flight says.
fn is_sun(text: &str) -> bool {
    if ["auto", "off"].iter().any(|word| text.eq_ignore_ascii_case(word)) {
        return true;
    }
    if let Some((azimuth, altitude)) = text.split_once(',') {
        let is_angle = |text: &str, most: f64| text.trim().parse().is_ok_and(|angle: f64| angle.abs() <= most);
        return is_angle(azimuth, 360.0) && is_angle(altitude, 90.0);
    }
    let is_of_date = |byte: u8| byte.is_ascii_digit() || b"-:TtZz+. ".contains(&byte);
    (12..=35).contains(&text.len())
        && text.bytes().all(is_of_date)
        && text.as_bytes()[..4].iter().all(u8::is_ascii_digit)
        && text.contains(['T', 't', ' '])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_checked_and_become_flags() {
        let settings = StreamSettings { facet_px: Some(4.0), technique: Some("mesh".into()), ..Default::default() };
        assert_eq!(settings.fault(), None);
        assert_eq!(settings.flags(), ["--technique", "mesh", "--facet-px", "4"]);
        assert_eq!(settings.picture_flags(), ["--technique", "mesh"]);
        let pair = StreamSettings { stereo: Some(SIDE_BY_SIDE.into()), convergence: Some(900.0), ..Default::default() };
        assert_eq!(pair.picture_flags(), ["--convergence", "900", "--stereo", "side-by-side"]);
        assert_eq!((pair.eye_size([960, 540]), settings.eye_size([960, 540])), ([480, 540], [960, 540]));
        let off = StreamSettings { stereo: Some("off".into()), ..pair.clone() };
        assert!(off.picture_flags().is_empty() && off.fault().is_none());
        for wrong in [
            StreamSettings { eye_separation: Some(901.0), ..pair.clone() },
            StreamSettings { convergence: Some(0.0), ..pair.clone() },
            StreamSettings { stereo: Some("pair".into()), ..pair },
            StreamSettings { fps: Some(f64::NAN), ..Default::default() },
            StreamSettings { facet_px: Some(0.0), ..Default::default() },
            StreamSettings { technique: Some("--output".into()), ..Default::default() },
            StreamSettings { overlay: Some("x".into()), ..Default::default() },
            StreamSettings { haze: Some(0.5), ..Default::default() },
            StreamSettings { haze: Some(f64::NAN), ..Default::default() },
        ] {
            assert!(wrong.fault().is_some(), "{wrong:?}");
        }
    }
    #[test]
    fn light_is_checked_and_becomes_flags() {
        let lit = |sun: &str| StreamSettings { sun: Some(sun.into()), shadows: Some(true), ..Default::default() };
        assert_eq!(lit("auto").picture_flags(), ["--sun", "auto", "--shadows"]);
        assert!(lit("off").picture_flags().is_empty());
        let hazy = StreamSettings { haze: Some(3e4), shadows: Some(true), ..Default::default() };
        assert_eq!(hazy.picture_flags(), ["--haze", "30000"]);
        assert!(hazy.clone().unlit().picture_flags().is_empty());
        assert!(StreamSettings { haze: Some(0.0), ..hazy }.picture_flags().is_empty());
        for sun in ["auto", "Off", "120,8", "-10, -3.5", "2026-06-21T05:45-07:00", "2026-06-21 12:45Z"] {
            assert_eq!(lit(sun).fault(), None, "{sun}");
        }
        for sun in
            ["", "noon", "1,2,3", "nan,1", "10,91", "400,1", "--output", "--output=2026-06-21", "2026-06-21T05:45\n"]
        {
            assert!(lit(sun).fault().is_some(), "{sun}");
        }
    }
}
