//! What the device can do at best (the *floor*), and what the renderer does with recorded frames,
//! in one process.

use crate::engine::{self, EngineError, EngineOptions};
use crate::frame::FrameReader;
use crate::gpu::{
    ColorPool, Device, Filtering, FloorPass, FrameSlot, GpuError, Instance, Needs, Outputs, Readback, Target,
};
use crate::source::{Completion, FrameSource, RecordedSource, Recording};
use crate::technique::{LOD_BIAS, MAX_ANISOTROPY};
use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;
use std::sync::Arc;
use std::time::{Duration, Instant};
use terravision_common::ids::SlotKey;
use terravision_common::rig::PictureLayout;
use terravision_common::texels::TexelFormat;

/// A frame is waited for no longer than this.
const LONGEST: Duration = Duration::from_secs(60);
/// Frames drawn before measuring.
const WARM_UP: usize = 4;

/// Times of one way of drawing.
#[derive(Debug, Clone, Serialize)]
pub struct Measured {
    /// What was drawn.
    pub name: String,
    /// Triangles per frame, the mean.
    pub triangles: u64,
    /// Time of each frame by the device's own clock, milliseconds; empty when it has none.
    pub gpu_ms: Vec<f64>,
    /// Processor time of the whole process per frame (all threads; on a software device also the
    /// drawing), milliseconds.
    pub cpu_ms_per_frame: f64,
    /// Processor time of the calling thread per frame, milliseconds.
    pub thread_ms_per_frame: f64,
    /// Elapsed time per frame, milliseconds.
    pub wall_ms_per_frame: f64,
}

impl Measured {
    /// Median of the device's times, or the elapsed time where it has no clock.
    #[must_use]
    pub fn median_ms(&self) -> f64 {
        let mut sorted = self.gpu_ms.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(self.wall_ms_per_frame)
    }
}

fn clock_ms(clock: ClockId) -> f64 {
    let now = clock_gettime(clock);
    now.tv_sec as f64 * 1e3 + now.tv_nsec as f64 / 1e6
}

struct Stopwatch {
    cpu: f64,
    thread: f64,
    wall: Instant,
}

impl Stopwatch {
    fn start() -> Self {
        let (cpu, thread) = (clock_ms(ClockId::ProcessCPUTime), clock_ms(ClockId::ThreadCPUTime));
        Self { cpu, thread, wall: Instant::now() }
    }

    fn stop(&self, name: String, triangles: u64, gpu_ms: Vec<f64>, frames: usize) -> Measured {
        let per_frame = 1.0 / frames.max(1) as f64;
        Measured {
            name,
            triangles,
            gpu_ms,
            cpu_ms_per_frame: (clock_ms(ClockId::ProcessCPUTime) - self.cpu) * per_frame,
            thread_ms_per_frame: (clock_ms(ClockId::ThreadCPUTime) - self.thread) * per_frame,
            wall_ms_per_frame: self.wall.elapsed().as_secs_f64() * 1e3 * per_frame,
        }
    }
}

/// The floor: one full-screen grid of `columns` by `rows` cells, textured and depth-tested, read
/// back like a frame. `frames` of them, one after the other.
///
/// # Errors
/// The device failed.
pub fn floor(options: &EngineOptions, columns: u32, rows: u32, frames: usize) -> Result<Measured, GpuError> {
    let side = 264;
    let texels = TexelFormat::Rgba8;
    let needs = Needs { size: options.size, samples: options.samples, color_layers: 1, color_tile_side: side, texels };
    let instance = Instance::new(options.has_validation)?;
    let device = Device::new(&instance, &options.device, &needs)?;
    let mut target = Target::new(&device, options.size, options.samples, false)?;
    let filtering = Filtering { lod_bias: LOD_BIAS, max_anisotropy: MAX_ANISOTROPY };
    let mut colors = ColorPool::new(&device, [side, 1], texels, filtering, None, 1)?;
    let pass = FloorPass::new(&colors, &target, columns, rows)?;
    let mut slot = FrameSlot::new(&device, 0)?;
    let mut spare = Some(Outputs::new(Some(Readback::new(&device, options.size, false)?), None));
    let (mut gpu_ms, mut watch) = (Vec::with_capacity(frames), Stopwatch::start());
    for frame in 0..WARM_UP + frames {
        if frame == WARM_UP {
            gpu_ms.clear();
            watch = Stopwatch::start();
        }
        let Some(mut outputs) = spare.take() else { break };
        outputs.lay_out(&device, PictureLayout::whole(options.size))?;
        let mut recording = slot.begin()?;
        if frame == 0 {
            let room = colors.upload_staged(&recording, SlotKey::new(0, 0))?;
            room.iter_mut().enumerate().for_each(|(i, byte)| *byte = (i * 97 % 251) as u8);
            debug_assert_eq!(room.len() as u64, texels.tile_bytes(side));
        }
        colors.record_uploads(&mut recording);
        target.begin_picture(&mut recording, options.size, options.sky_rgba());
        pass.draw(&mut recording, &colors);
        target.end(&mut recording);
        recording.copy_view(&mut target, &outputs, options.size, [0, 0]);
        recording.put_out(outputs);
        recording.submit()?;
        if let Some((outputs, times)) = slot.take()? {
            spare = Some(outputs);
            gpu_ms.extend(times.whole.map(|nanos| nanos / 1e6));
        }
    }
    instance.check_validation()?;
    Ok(watch.stop(format!("floor {columns}x{rows}"), pass.triangles(), gpu_ms, frames))
}

/// Plays a recording `laps` times through the engine, dropping the pictures; the first lap (which
/// uploads the tiles) is not measured. With `options.frames_in_flight` 1 the times are those of
/// single frames.
///
/// # Errors
/// The device failed, or the recording is damaged.
pub fn replay(options: &EngineOptions, recording: &Arc<Recording>, laps: u64) -> Result<Measured, EngineError> {
    let mut source = RecordedSource::new(Arc::clone(recording), laps + 1);
    let mut reader = FrameReader::new(source.shape(), options.size)?;
    let mut engine = engine::open(options.clone(), &source)?;
    let mut spare = (0..engine.frames_in_flight()).map(|_| engine.new_pixels()).collect::<Result<Vec<_>, _>>()?;
    let lap = recording.frames().len();
    let frames = lap * laps as usize;
    let mut gpu_ms = Vec::with_capacity(frames);
    let (mut triangles, mut watch) = (0, Stopwatch::start());
    for frame in 0..lap + frames {
        while spare.is_empty() || (frame == lap && engine.is_busy()) {
            let Some(finished) = engine.poll(LONGEST)? else { break };
            source.complete(&finished.done())?;
            gpu_ms.extend(finished.gpu_nanos.map(|nanos| nanos / 1e6));
            triangles += finished.costs.triangles();
            spare.push(finished.pixels);
        }
        if frame == lap {
            gpu_ms.clear();
            triangles = 0;
            watch = Stopwatch::start();
        }
        reader.read(&mut source, true)?;
        let Some(pixels) = spare.pop() else { break };
        engine.submit(reader.frame(), &mut source, pixels)?;
    }
    while let Some(finished) = engine.poll(LONGEST)? {
        source.complete(&finished.done())?;
        gpu_ms.extend(finished.gpu_nanos.map(|nanos| nanos / 1e6));
        triangles += finished.costs.triangles();
    }
    Ok(watch.stop("replay".to_owned(), triangles / frames.max(1) as u64, gpu_ms, frames))
}
