//! The engine of a Vulkan device: its pools, and the frames in flight.

use super::cost::{DrawCost, DrawCosts};
use super::finished::InFlight;
use super::parts::{DrawList, MOST_PARTS, Parts};
use super::{Described, Engine, EngineError, EngineOptions, Finished, Submitted};
use crate::frame::{Frame, FrameError, TileFault};
use crate::gpu::{
    ColorPool, Device, DeviceKind, DevicePicture, Elevation, Filtering, FrameRecording, FrameSlot, GpuError, Instance,
    Needs, Outputs, Readback, Target,
};
use crate::pixels::Pixels;
use crate::source::{FrameSource, Pools, SourceShape};
use crate::technique::{ArrayPlaces, ComputeRays, LOD_BIAS, MAX_ANISOTROPY, MeshTechnique, Technique};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use terravision_common::event::monotonic_nanos;
use terravision_common::rig::PictureLayout;
use terravision_common::run::TechniqueChoice;
use terravision_common::world::World;

/// Frames in flight for a device when `asked` for this many, 0 for as many as suit it. A device
/// that is the processor itself gains nothing from a second frame, and then finishes both at the
/// same time: with lavapipe every other frame took twice as long and the ones between nothing, at
/// the same rate.
fn frames_in_flight(asked: usize, kind: DeviceKind) -> usize {
    match (asked, kind) {
        (0, DeviceKind::Cpu) => 1,
        (0, _) => 2,
        (asked, _) => asked,
    }
}

/// Draws frames with Vulkan.
pub struct DeviceEngine {
    // Slots first: fields are dropped in order, and a slot's objects wait for its submit.
    slots: Vec<FrameSlot>,
    /// Each with the frame slot that it was recorded in.
    in_flight: VecDeque<(usize, InFlight)>,
    next_slot: usize,
    techniques: Vec<Box<dyn Technique>>,
    parts: Parts,
    /// Index of each part's technique.
    of_part: Vec<usize>,
    draws: DrawList,
    elevation: Elevation,
    colors: ColorPool,
    target: Target,
    starts: Vec<u32>,
    array_values: usize,
    most_draws: usize,
    world: World,
    options: EngineOptions,
    device: Arc<Device>,
}

impl std::fmt::Debug for DeviceEngine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("DeviceEngine")
            .field("device", &self.device)
            .field("options", &self.options)
            .finish_non_exhaustive()
    }
}

impl DeviceEngine {
    /// Opens the device and makes all that frames of this source need.
    ///
    /// # Errors
    /// No device, or it lacks something.
    pub fn new(options: EngineOptions, source: &dyn FrameSource) -> Result<Self, EngineError> {
        let technique = if options.is_compute() { TechniqueChoice::Rays } else { TechniqueChoice::Mesh };
        Self::of_parts(options, source, Parts::whole(technique))
    }

    /// Likewise; several techniques share each picture and its depth.
    ///
    /// # Errors
    /// No device, or it lacks something, or rays are asked for what they cannot do.
    pub fn of_parts(options: EngineOptions, source: &dyn FrameSource, parts: Parts) -> Result<Self, EngineError> {
        let distinct = parts.distinct();
        if distinct.contains(&TechniqueChoice::Rays) && options.samples != 1 {
            return Err(EngineError::MeshOnly { what: "several samples per pixel" });
        }
        let (found, limit) = (parts.techniques.len() as u64, MOST_PARTS as u64);
        if found > limit {
            return Err(GpuError::TooMany { what: "parts of a view", found, limit }.into());
        }
        let shape = source.shape();
        let world = shape.world;
        let views = options.view_bounds();
        let needs = Needs {
            size: views.size,
            samples: options.samples,
            color_layers: shape.color_slots,
            color_tile_side: world.color_stored(),
            texels: shape.texels,
        };
        let shows = options.pixels.either;
        let instance =
            if shows { Instance::for_windows(options.has_validation) } else { Instance::new(options.has_validation) }?;
        let device = Device::new(&instance, &options.device, &needs)?;
        if let Some(at) = options.lose_device_at {
            device.lose_at(at);
        }
        let slot_count = frames_in_flight(options.frames_in_flight, device.capabilities().kind);
        let target = Target::new(&device, views.size, options.samples, options.has_depth)?;
        let filtering = Filtering { lod_bias: LOD_BIAS, max_anisotropy: MAX_ANISOTROPY };
        let shared = source.color_memory().filter(|_| options.can_import_colors);
        let tiles = [world.color_stored(), shape.color_slots];
        let colors = ColorPool::new(&device, tiles, shape.texels, filtering, shared.as_ref(), slot_count)?;
        let shared = source.elevation_memory();
        let elevation = Elevation::new(&device, options.elevation_path, shared.as_ref(), slot_count)?;
        let most_draws = views.count * parts.techniques.len();
        let of_techniques = Ingredients { world: &world, colors: &colors, target: &target };
        let techniques = of_techniques.all(&distinct, options.has_tree_overlay, [slot_count, most_draws])?;
        let of_part = |part: &TechniqueChoice| distinct.iter().position(|technique| technique == part);
        let of_part = parts.techniques.iter().filter_map(of_part).collect();
        let slots = (0..slot_count).map(|index| FrameSlot::new(&device, index)).collect::<Result<_, _>>()?;
        Ok(Self {
            slots,
            in_flight: VecDeque::with_capacity(slot_count),
            next_slot: 0,
            techniques,
            parts,
            of_part,
            draws: DrawList::default(),
            elevation,
            colors,
            target,
            starts: Vec::with_capacity(starts_capacity(&shape)),
            array_values: world.elevation_values(),
            most_draws,
            world,
            options,
            device,
        })
    }

    /// The device.
    #[must_use]
    pub fn device(&self) -> &Arc<Device> {
        &self.device
    }

    /// Whether elevations, and whether colours, are read from shared memory in place.
    #[must_use]
    pub fn imports(&self) -> [bool; 2] {
        [self.elevation.is_imported(), self.colors.is_imported()]
    }

    /// Of the draws that were recorded last, without their times.
    fn costs(&self) -> DrawCosts {
        let mut costs = DrawCosts::default();
        for draw in self.draws.draws() {
            costs.push(DrawCost {
                technique: self.techniques[draw.technique].choice(),
                view: draw.view,
                tiles: draw.tiles.len() as u32,
                triangles: self.techniques[draw.technique].triangles(draw.of_technique),
                nanos: None,
            });
        }
        costs
    }

    fn new_outputs(&self) -> Result<Outputs, EngineError> {
        let EngineOptions { size, has_depth, pixels, .. } = self.options;
        let readback = || Readback::new(&self.device, size, has_depth);
        let picture = |size| DevicePicture::new(&self.device, PictureLayout::whole(size));
        let has_choice = pixels.has_choice() && self.device.can_show();
        Ok(Outputs::new(
            if pixels.may_be_host() { Some(readback()?) } else { None },
            match pixels.device {
                true => Some(picture(size)?),
                // As large as its first frame when that comes.
                false if has_choice => Some(picture([1; 2])?),
                false => None,
            },
        ))
    }
}

impl Engine for DeviceEngine {
    fn describe(&self) -> Described {
        let found = self.device.capabilities();
        let driver = match self.options.is_compute() {
            true => format!("{}; compute: one exact ray a pixel", found.driver),
            false => found.driver.clone(),
        };
        let technique = self.techniques.first().map_or("", |technique| technique.choice().name());
        Described { technique, reason: self.options.reason.clone(), device: found.name.clone(), driver }
    }

    fn frames_in_flight(&self) -> usize {
        self.slots.len()
    }

    fn new_pixels(&self) -> Result<Pixels, EngineError> {
        Ok(Pixels::Device(self.new_outputs()?))
    }

    fn has_room(&self) -> bool {
        self.in_flight.len() < self.slots.len()
    }

    fn is_busy(&self) -> bool {
        !self.in_flight.is_empty()
    }

    /// Records a frame and hands it to the device.
    fn submit(&mut self, frame: &Frame, pools: &mut dyn Pools, pixels: Pixels) -> Result<Submitted, EngineError> {
        let started_nanos = monotonic_nanos();
        let mut outputs = match pixels {
            Pixels::Device(outputs) => outputs,
            Pixels::Memory(_) => self.new_outputs()?,
        };
        outputs.lay_out(&self.device, frame.layout())?;
        let index = self.next_slot;
        self.draws.plan(frame, self.parts.part_of, &self.of_part, &self.techniques);
        let Self { slots, techniques, draws, elevation, colors, target, starts, options, .. } = self;
        let mut recording = slots[index].begin()?;
        find_elevations(elevation, self.array_values, &recording, frame, pools, starts)?;
        let upload_started_nanos = monotonic_nanos();
        upload_colors(colors, &recording, frame, pools)?;
        let uploads = colors.record_uploads(&mut recording);
        let upload_nanos = monotonic_nanos() - upload_started_nanos;
        let places = ArrayPlaces { starts };
        for (index, technique) in techniques.iter_mut().enumerate() {
            technique.prepare(&mut recording, frame, &mut draws.of_technique(index), elevation, places)?;
        }
        let draw_view = |recording: &mut FrameRecording<'_>, view: usize, is_depth_only: bool| {
            for (number, draw) in draws.draws().iter().enumerate().filter(|(_, draw)| draw.view == view) {
                techniques[draw.technique].draw(draw.of_technique, recording, colors, is_depth_only);
                recording.end_piece(number);
            }
        };
        for (index, view) in frame.views.iter().enumerate() {
            recording.begin_pieces();
            target.begin_picture(&mut recording, view.size(), options.sky_rgba());
            draw_view(&mut recording, index, false);
            target.end(&mut recording);
            if target.has_depth_pass() {
                recording.begin_pieces();
                target.begin_depth(&mut recording, view.size());
                draw_view(&mut recording, index, true);
                target.end(&mut recording);
            }
            recording.copy_view(target, &outputs, view.size(), view.at);
        }
        recording.put_out(outputs);
        recording.submit()?;
        let in_flight = InFlight::new(frame, self.costs(), started_nanos, monotonic_nanos());
        self.in_flight.push_back((index, in_flight));
        self.next_slot = (index + 1) % self.slots.len();
        Ok(Submitted { uploads, upload_started_nanos, upload_nanos, decided: None })
    }

    fn poll(&mut self, timeout: Duration) -> Result<Option<Finished>, EngineError> {
        let Some(&(slot, in_flight)) = self.in_flight.front() else { return Ok(None) };
        if !self.slots[slot].wait(timeout)? {
            return Ok(None);
        }
        let taken = self.slots[slot].take()?;
        self.in_flight.pop_front();
        let Some((outputs, times)) = taken else { return Ok(None) };
        if self.options.has_validation {
            self.check_validation()?;
        }
        Ok(Some(in_flight.finish_on_device(&times, Pixels::Device(outputs))))
    }

    fn set_tree_overlay(&mut self, has_overlay: bool) -> Result<(), EngineError> {
        if self.options.has_tree_overlay == has_overlay {
            return Ok(());
        }
        self.options.has_tree_overlay = has_overlay;
        let Self { world, colors, target, .. } = self;
        let slots_and_draws = [self.slots.len(), self.most_draws];
        let ingredients = Ingredients { world, colors, target };
        // What frames in flight use waits for them before it goes.
        self.techniques = ingredients.all(&self.parts.distinct(), has_overlay, slots_and_draws)?;
        Ok(())
    }

    fn check_validation(&self) -> Result<(), EngineError> {
        Ok(self.device.instance().check_validation()?)
    }
}

/// What techniques are made of.
struct Ingredients<'a> {
    world: &'a World,
    colors: &'a ColorPool,
    target: &'a Target,
}

impl Ingredients<'_> {
    /// These techniques, with outlines of the tree's leaves or without.
    fn all(
        &self,
        choices: &[TechniqueChoice],
        has_overlay: bool,
        [slots, draws]: [usize; 2],
    ) -> Result<Vec<Box<dyn Technique>>, EngineError> {
        let Self { world, colors, target } = self;
        let technique = |choice: &TechniqueChoice| -> Result<Box<dyn Technique>, EngineError> {
            Ok(match choice {
                TechniqueChoice::Rays => {
                    Box::new(ComputeRays::new(colors, target, world, has_overlay, [slots, draws])?)
                }
                TechniqueChoice::Mesh => Box::new(MeshTechnique::new(colors, target, world, has_overlay, slots)?),
            })
        };
        choices.iter().map(technique).collect()
    }
}

/// Where the frame's elevation arrays begin in the buffer that the device reads; copies them there,
/// unless the device reads shared memory.
fn find_elevations(
    elevation: &mut Elevation,
    array_values: usize,
    recording: &FrameRecording<'_>,
    frame: &Frame,
    pools: &mut dyn Pools,
    starts: &mut Vec<u32>,
) -> Result<(), EngineError> {
    let positions = frame.elevation_start..frame.end.elevation_end;
    starts.clear();
    if elevation.is_imported() {
        let room = elevation.imported_values();
        for position in positions {
            let start = pools.elevation_offset(position)?.map(|offset| offset / 4);
            match start.filter(|start| start + array_values as u64 <= room) {
                Some(start) => starts.push(start as u32),
                None => return Err(missing_array(frame, position)),
            }
        }
        return Ok(());
    }
    let arrays = frame.end.elevation_end.wrapping_sub(frame.elevation_start);
    let staged = elevation.stage(recording, (arrays * array_values as u64).max(1))?;
    for ((index, position), out) in positions.enumerate().zip(staged.chunks_exact_mut(array_values)) {
        if !pools.read_elevation(position, out)? {
            return Err(missing_array(frame, position));
        }
        starts.push((index * array_values) as u32);
    }
    Ok(())
}

/// Brings the colours of a frame's tiles to the device, where it does not have them.
fn upload_colors(
    colors: &mut ColorPool,
    recording: &FrameRecording<'_>,
    frame: &Frame,
    pools: &mut dyn Pools,
) -> Result<(), EngineError> {
    for (index, tile) in frame.tiles.iter().enumerate() {
        let key = tile.color();
        if colors.holds(key) {
            continue;
        }
        let is_there = if colors.is_imported() {
            match pools.color_offset(key) {
                Some(offset) => colors.upload_imported(key, offset).map(|()| true)?,
                None => false,
            }
        } else {
            let room = colors.upload_staged(recording, key)?;
            pools.read_color(key, room)
        };
        if !is_there {
            let fault = TileFault::Stale;
            return Err(FrameError::Tile { frame: frame.number(), index, fault }.into());
        }
    }
    Ok(())
}

fn starts_capacity(shape: &SourceShape) -> usize {
    usize::try_from(shape.elevation_arrays).unwrap_or(4096).min(65536)
}

fn missing_array(frame: &Frame, position: u64) -> EngineError {
    let index = frame.tiles.iter().position(|tile| tile.elevation_position == position).unwrap_or(0);
    FrameError::Tile { frame: frame.number(), index, fault: TileFault::Elevation }.into()
}
