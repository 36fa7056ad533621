//! What light and air come to: where the sun stands.

use crate::cli::labels::LabelArgs;
use crate::cli::light::{LightArgs, SunArg, Visibility};
use crate::failure::Failure;
use crate::sun::sun_over;
use anyhow::anyhow;
use glam::DVec2;
use terravision_common::database::Manifest;
use terravision_common::light::{AirConfig, LightConfig, Sun};
use terravision_common::lonlat::{Projection, lonlat_of_body, without_datum};
use terravision_common::run::LabelsConfig;

/// How far north a place is compared to find grid north, degrees.
const NORTH_DEG: f64 = 0.01;

/// Light and air of a flight.
#[derive(Debug, Default)]
pub(super) struct LightPlan {
    pub(super) light: Option<LightConfig>,
    pub(super) air: Option<AirConfig>,
    /// What is good to know, a sentence each.
    pub(super) notes: Vec<String>,
}

impl LightPlan {
    /// What is asked for.
    ///
    /// # Errors
    /// Bad input: the sun's place at a time cannot be known, or shadows without light.
    pub(super) fn new(args: &LightArgs, manifest: &Manifest) -> Result<Self, Failure> {
        let mut notes = Vec::new();
        let sun = match args.sun {
            None | Some(SunArg::Off) => None,
            Some(SunArg::Auto) => Some(Sun::AUTO),
            Some(SunArg::Angles([azimuth_deg, altitude_deg])) => Some(Sun { azimuth_deg, altitude_deg }),
            Some(SunArg::At(time)) => {
                let sun = sun_at(time, manifest)?;
                notes.push(format!(
                    "the sun stands at an azimuth of {:.1} and an altitude of {:.1} degrees",
                    sun.azimuth_deg, sun.altitude_deg
                ));
                Some(sun)
            }
        };
        if let Some(fault) = args.fault() {
            return Err(Failure::bad_input(anyhow!(fault)));
        }
        if let Some(sun) = sun.filter(|sun| sun.strength() <= 0.0) {
            let below = -sun.altitude_deg;
            notes.push(format!(
                "it is night: the sun is {below:.1} degrees below the horizon, so the ground has the light of the sky alone"
            ));
        }
        let color = &manifest.fields().color;
        if sun.is_some() && color.sources.is_empty() && color.tint.is_none() {
            notes.push(
                "the colours of this world were shaded when it was ingested, by a version that left no record of it: the \
                 light of --sun falls on that; ingest again for ground that is lit once"
                    .to_owned(),
            );
        }
        // Flat land gets the relief that its tint was shaded with; a sun that is asked for is that of the land as it is.
        let relief = color.tint.filter(|_| args.sun == Some(SunArg::Auto)).map_or(1.0, |tint| f64::from(tint.relief));
        let visibility_m = args.haze.map(|Visibility(metres)| metres);
        let has_air = sun.is_some() || visibility_m.is_some();
        Ok(Self {
            light: sun.map(|sun| LightConfig { sun, has_shadows: args.shadows, relief, tint: color.tint }),
            air: has_air.then_some(AirConfig { sun, visibility_m }),
            notes,
        })
    }
}

/// The labels that are asked for.
pub(super) fn labels(args: &LabelArgs) -> Option<LabelsConfig> {
    args.is_any().then(|| LabelsConfig {
        text: args.label.clone(),
        has_scale_bar: args.scale_bar,
        has_north_arrow: args.north_arrow,
        has_clock: args.clock,
    })
}

/// Where the sun stands at a time over the middle of a world.
fn sun_at(time: f64, manifest: &Manifest) -> Result<Sun, Failure> {
    let fields = manifest.fields();
    let refuse = |why: String| {
        Failure::bad_input(anyhow!(
            "--sun: {why}, so the sun's place at a time is not known; expected its azimuth and altitude, e.g. --sun 120,8"
        ))
    };
    if !matches!(fields.body.name.as_str(), "Earth" | "unknown") {
        return Err(refuse(format!("this world is on {}", fields.body.name)));
    }
    let unknown = || refuse(format!("the world's CRS, {}, does not say where on Earth it is", fields.crs.name));
    let (plane, lonlat) = match (fields.lonlat.as_ref().filter(|table| table.is_valid()), &fields.crs.proj4) {
        (Some(table), _) => (table.plane.clone(), table.lonlat.clone()),
        (None, Some(text)) => (without_datum(text), lonlat_of_body(text)),
        (None, None) => return Err(unknown()),
    };
    let parse = |text: &str| Projection::parse(text).map_err(|_error| unknown());
    let (plane, lonlat) = (parse(&plane)?, parse(&lonlat)?);
    // What datums differ by is far less than what the formula is off.
    let middle = manifest.world().crs_middle();
    let place = plane.to(&lonlat, middle.to_array()).map_err(|_error| unknown())?;
    let towards = [place[0], place[1] + if place[1] > 0.0 { -NORTH_DEG } else { NORTH_DEG }];
    let beside = lonlat.to(&plane, towards).map_err(|_error| unknown())?;
    let north = (DVec2::from_array(beside) - middle) * if place[1] > 0.0 { -1.0 } else { 1.0 };
    let [azimuth_deg, altitude_deg] = sun_over(place, time);
    Ok(Sun { azimuth_deg: (azimuth_deg + north.x.atan2(north.y).to_degrees()).rem_euclid(360.0), altitude_deg })
}
