//! A fleet out of its files, with what is wrong with it.

use super::{Fleet, Member, USUAL_LENGTH_M};
use crate::cli::database::DatabaseArgs;
use crate::cli::vehicles::VehicleArgs;
use crate::failure::Failure;
use crate::ground::WorldGround;
use crate::path::crs::Georeference;
use crate::path::times::seconds_from_iso8601;
use crate::path::vehicles::{self, HeightReference, Vehicle};
use crate::path::{Ground, PathError, Remarks};
use crate::world::open_world;
use anyhow::anyhow;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use terravision_common::vehicle::{MOST_VEHICLES, VehicleLook};
use terravision_store::Store;
use terravision_vehicles::model::Model;
use terravision_vehicles::painter::USUAL_POINT_PX;

/// Colour of points that have none: that of vests on roads.
const USUAL_RGB: [u8; 3] = [255, 220, 0];
/// A vehicle is looked for below the ground at this many of its moments at most.
const MOST_LOOKS: usize = 64;

/// A fleet, and how it goes through a flight.
#[derive(Debug)]
pub struct FleetPlan {
    /// The vehicles.
    pub fleet: Fleet,
    /// The world, for the ground below them: they are driven by a thread of their own.
    pub database: Store,
    /// Factor on its heights.
    pub exaggeration: f64,
    /// Time of frame 0, seconds.
    start: f64,
}

impl FleetPlan {
    /// The fleet that is asked for; what is to be said about it goes into `remarks`.
    ///
    /// # Errors
    /// Bad input, in one sentence.
    pub fn load(
        args: &VehicleArgs,
        (world, database): (&Path, &DatabaseArgs),
        georeference: &Georeference,
        exaggeration: f64,
        remarks: &mut Remarks,
    ) -> Result<Option<Self>, Failure> {
        if args.vehicles.is_empty() {
            return Ok(None);
        }
        let mut loading = Loading::default();
        for file in &args.vehicles {
            let vehicles = vehicles::load(file, georeference, remarks).map_err(unusable)?;
            vehicles.into_iter().try_for_each(|vehicle| loading.add(file, vehicle))?;
        }
        remarks.warnings.extend(georeference.take_doubts());
        let fleet = Fleet { vehicles: loading.vehicles, models: loading.models };
        if fleet.len() > MOST_VEHICLES {
            let found = fleet.len();
            return Err(Failure::bad_input(anyhow!(
                "--vehicles: the files have {found} vehicles together: expected at most {MOST_VEHICLES}"
            )));
        }
        let start = start_of(args.vehicles_start.as_deref(), fleet.start().unwrap_or(0.0))?;
        let database = open_world(world, database)?;
        if database.world().globe().is_some() {
            return Err(Failure::bad_input(anyhow!(
                "--vehicles: vehicles are not drawn over a whole body yet: expected a world in a projected CRS"
            )));
        }
        let plan = Self { fleet, database, exaggeration, start };
        plan.look_below_ground(remarks);
        Ok(Some(plan))
    }

    /// The vehicles' time of a frame, at `fps` frames a second, seconds.
    #[must_use]
    pub fn time(&self, frame: u64, fps: f64) -> f64 {
        self.start + frame as f64 / fps
    }

    /// Aircraft that fly through the ground are drawn as they are, which the ground hides.
    fn look_below_ground(&self, remarks: &mut Remarks) {
        let ground = WorldGround::finest(&self.database, self.database.world(), self.exaggeration);
        let ground = ground.bounded(self.database.ranges());
        let is_below = |position: glam::DVec3| {
            let glam::DVec3 { x, y, z } = position;
            ground.bound_m(x, y).is_none_or(|bound| z < bound) && ground.height_m(x, y).is_some_and(|height| z < height)
        };
        for member in &self.fleet.vehicles {
            if member.vehicle.height != HeightReference::Datum {
                continue;
            }
            let moments = || member.vehicle.ways.iter().flat_map(|way| way.moments());
            let step = moments().count().div_ceil(MOST_LOOKS).max(1);
            let looked: Vec<bool> = moments().step_by(step).map(|moment| is_below(moment.position)).collect();
            let below = looked.iter().filter(|is_below| **is_below).count();
            if below > 0 {
                remarks.warnings.push(format!(
                    "the vehicle of {} is below the ground at {below} of {} moments of its way that were looked at: it is drawn \
                     where its file has it, and the ground hides it (\"heightReference\": \"CLAMP_TO_GROUND\" puts it on the ground)",
                    member.vehicle.place,
                    looked.len()
                ));
            }
        }
    }
}

/// A file of vehicles is not a camera path, which the reader's own sentences speak of.
fn unusable(error: PathError) -> Failure {
    Failure::bad_input(match error {
        PathError::Read { path, source } => anyhow!("--vehicles {}: it cannot be read: {source}", path.display()),
        PathError::NotAFile { path, kind } => anyhow!("--vehicles {}: expected a file, found {kind}", path.display()),
        other => anyhow!(other),
    })
}

/// The time of frame 0, by what was typed.
fn start_of(text: Option<&str>, first: f64) -> Result<f64, Failure> {
    let Some(text) = text else { return Ok(first) };
    let seconds =
        text.trim().parse::<f64>().ok().filter(|seconds| seconds.abs() <= 1e10).map(|seconds| first + seconds);
    seconds.or_else(|| seconds_from_iso8601(text)).ok_or_else(|| {
        Failure::bad_input(anyhow!(
            "--vehicles-start {text}: expected a date and time, e.g. 2026-06-21T12:45Z, or seconds after the first moment of the \
             vehicles, e.g. 30"
        ))
    })
}

/// Vehicles with their models, each read once.
#[derive(Default)]
struct Loading {
    vehicles: Vec<Member>,
    models: Vec<PathBuf>,
    lengths: Vec<f64>,
    known: HashMap<PathBuf, usize>,
}

impl Loading {
    fn add(&mut self, file: &Path, vehicle: Vehicle) -> Result<(), Failure> {
        let look = &vehicle.appearance;
        let model = look.model.as_deref().map(|model| self.model(file, &vehicle.place, model)).transpose()?;
        let scale = look.scale.unwrap_or(1.0);
        let length_m = model.map_or(USUAL_LENGTH_M, |model| (self.lengths[model] * scale).max(0.1));
        let look = VehicleLook {
            model: model.map(|model| model as u32),
            scale: scale as f32,
            point_px: look.point_px.map_or(USUAL_POINT_PX, |px| px.clamp(1.0, 64.0) as f32),
            rgb: look.rgb.unwrap_or(USUAL_RGB),
        };
        self.vehicles.push(Member { vehicle, look, length_m });
        Ok(())
    }

    fn model(&mut self, file: &Path, place: &str, path: &Path) -> Result<usize, Failure> {
        // The renderer may run in another folder.
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        if let Some(known) = self.known.get(&path) {
            return Ok(*known);
        }
        let model = Model::read(&path);
        let model = model.map_err(|error| Failure::bad_input(anyhow!("{}: {place}: {error}", file.display())))?;
        self.models.push(path.clone());
        self.lengths.push(f64::from(model.length_m));
        self.known.insert(path, self.models.len() - 1);
        Ok(self.models.len() - 1)
    }
}
