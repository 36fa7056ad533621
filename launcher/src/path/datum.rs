//! What a PROJ string tells of its datum, and what EPSG codes add to that.

use terravision_common::lonlat::{proj_value, without_datum};

/// What a PROJ string tells of its datum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Datum {
    /// It lies to WGS 84 as the string says, or as good as on it, or is a sphere's or another
    /// body's.
    Known,
    /// NAD27, whose shift is in grids that are not here.
    Nad27,
    /// Nothing.
    Unknown,
}

pub(super) fn datum_of(text: &str) -> Datum {
    if proj_value(text, "towgs84").is_some() || proj_value(text, "nadgrids") == Some("@null") {
        return Datum::Known;
    }
    match proj_value(text, "datum") {
        Some(name) if name.eq_ignore_ascii_case("NAD27") => return Datum::Nad27,
        Some(_) => return Datum::Known,
        None => {}
    }
    if proj_value(text, "nadgrids").is_some() {
        return Datum::Unknown;
    }
    let ellipsoid = proj_value(text, "ellps").map(str::to_ascii_lowercase);
    let number = |key: &str| proj_value(text, key).and_then(|v| v.parse::<f64>().ok());
    let radius = number("R").or_else(|| number("a"));
    let is_sphere = proj_value(text, "R").is_some() || (number("a").is_some() && number("a") == number("b"));
    let is_elsewhere = radius.is_some_and(|radius| !(6.3e6..6.4e6).contains(&radius));
    // The ellipsoids of WGS 84 and GRS 80: systems on them are within 2 m of each other, with few
    // exceptions.
    let is_modern = ellipsoid.as_deref().is_some_and(|e| matches!(e, "wgs84" | "grs80" | "sphere"))
        || (ellipsoid.is_none() && radius.is_none_or(|radius| (radius - 6_378_137.0).abs() < 0.5));
    if is_sphere || is_elsewhere || is_modern { Datum::Known } else { Datum::Unknown }
}

/// Whether a PROJ string's datum is WGS 84 or as good as that.
pub(super) fn is_on_wgs84(text: &str) -> bool {
    let is_zero = |shift: &str| shift.split(',').all(|v| v.trim().parse() == Ok(0.0));
    let name = proj_value(text, "datum").map(str::to_ascii_lowercase);
    let is_named = name.is_none_or(|name| matches!(name.as_str(), "wgs84" | "nad83"));
    datum_of(text) == Datum::Known && is_named && proj_value(text, "towgs84").is_none_or(is_zero)
}

/// How many words [`datum_words`] has when a string tells of the ellipsoid alone.
pub(super) const ELLIPSOID_WORDS: usize = 1;

/// What tells one datum from another in a PROJ string: its name, or its ellipsoid and its shift.
pub(super) fn datum_words(text: &str) -> Vec<String> {
    if let Some(name) = proj_value(text, "datum") {
        return vec!["datum".into(), name.to_ascii_lowercase()];
    }
    let shape: Vec<String> = ["ellps", "a", "b", "rf", "R"]
        .iter()
        .filter_map(|key| Some(format!("{key}={}", proj_value(text, key)?.to_ascii_lowercase())))
        .collect();
    let shift = ["towgs84", "nadgrids"].iter().filter_map(|key| Some(format!("{key}={}", proj_value(text, key)?)));
    std::iter::once(shape.join(" ")).chain(shift).collect()
}

/// The PROJ string of an EPSG code.
pub(super) fn definition(epsg: u32) -> Option<&'static str> {
    crs_definitions::from_code(u16::try_from(epsg).ok()?).map(|definition| definition.proj4)
}

/// Parameters of a datum that a definition names, as `proj4rs` has them.
pub(super) fn shift_of_named_datum(text: &str) -> Option<&'static str> {
    match proj_value(text, "datum")?.to_ascii_lowercase().as_str() {
        "osgb36" => Some("446.448,-125.157,542.06,0.1502,0.247,0.8421,-20.4894"),
        "potsdam" => Some("598.1,73.7,418.2,0.202,0.045,-2.455,6.7"),
        "ire65" => Some("482.53,-130.596,564.557,-1.042,-0.214,-0.631,8.15"),
        "nzgd49" => Some("59.47,-5.04,187.44,0.47,-0.1,1.024,-4.5993"),
        "carthage" => Some("-263,6,431"),
        "hermannskogel" => Some("577.326,90.129,463.919,5.137,1.474,5.297,2.4232"),
        "ggrs87" => Some("-199.87,74.79,246.62"),
        _ => None,
    }
}

/// NAD27 by the mean shift of the contiguous United States (EPSG:1173) in place of its grids.
pub(super) fn with_nad27_shift(text: &str) -> String {
    format!("{} +towgs84=-8,160,176", without_datum(text))
}
