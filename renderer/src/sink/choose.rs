//! The sinks of a run: what its configuration comes to.

use super::{
    AllOf, AnaglyphSink, DepthSink, FrameSink, GroundSink, LabelSink, NullSink, PngFileSink, PngFolderSink, RepeatSink,
    SharedSink, SinkError, SplitViewsSink, StreamSink,
};
use std::sync::Arc;
use terravision_common::database::Index;
use terravision_common::run::{PlaneTarget, RunConfig, SinkConfig, WindowConfig};
use terravision_common::shm::{Control, RunId};
use terravision_common::stage::StageRun;
use terravision_common::world::World;

/// Most threads that write pictures into a folder.
const MAX_WORKERS: usize = 4;

/// What sinks are opened with.
#[derive(Clone, Copy)]
struct Given<'a> {
    config: &'a RunConfig,
    run: &'a RunId,
    control: &'a Arc<Control>,
    /// The database's index.
    #[cfg_attr(not(feature = "window"), expect(dead_code, reason = "only a window needs it"))]
    index: &'a Index,
    /// The world, whose places are told.
    world: World,
    /// Frames that were written by renderers before this one.
    written: u64,
}

/// The sinks of a run, one for each worker. This many frames were written by renderers before this
/// one.
///
/// # Errors
/// A file, a folder or a ring cannot be opened.
pub fn sinks_of(
    run: &StageRun,
    control: &Arc<Control>,
    index: &Index,
    written: u64,
) -> Result<Vec<Box<dyn FrameSink>>, SinkError> {
    let config = run.config();
    let world = *index.world();
    let given = Given { config, run: run.id(), control, index, world, written };
    let render = &config.render;
    // Files may be written in any order. A stream and shared frames have one, and so have frames
    // that stand in for those before them.
    let is_in_any_order = render.share.is_none()
        && render.window.is_none()
        && config.realtime.is_none()
        && match &render.sink {
            SinkConfig::PngFolder(_) | SinkConfig::EachView(_) => true,
            SinkConfig::Null => !render.depth.is_empty() || !render.ground.is_empty(),
            SinkConfig::PngFile(_) | SinkConfig::Stream(_) => false,
        };
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(MAX_WORKERS);
    (0..if is_in_any_order { threads } else { 1 }).map(|_worker| sink_of_worker(given)).collect()
}

/// The sinks of one worker.
fn sink_of_worker(given: Given<'_>) -> Result<Box<dyn FrameSink>, SinkError> {
    let Given { config, world, .. } = given;
    let render = &config.render;
    let picture = picture_sink(&render.sink, given)?;
    let picture = if render.anaglyph { Box::new(AnaglyphSink::new(picture)) } else { picture };
    // Over both eyes at one place: in the plane of the screen.
    let labelled = |sink: Box<dyn FrameSink>| -> Result<Box<dyn FrameSink>, SinkError> {
        Ok(match &render.labels {
            Some(labels) => Box::new(LabelSink::new(sink, labels, config.fps)?),
            None => sink,
        })
    };
    let picture = if render.sink == SinkConfig::Null { picture } else { labelled(picture)? };
    let is_shown = render.share.is_some() || render.window.is_some();
    if render.depth.is_empty() && render.ground.is_empty() && !is_shown {
        return Ok(picture);
    }
    let mut all = AllOf(Vec::new());
    if let Some(share) = &render.share {
        // First: who reads it waits for it, files can wait.
        let sink = SharedSink::open(share, config.output_size(), world, config.exaggeration)?;
        let sink = Box::new(sink.with_made_up(render.made_up));
        all.0.push(if render.anaglyph { Box::new(AnaglyphSink::new(sink)) } else { sink });
    }
    if let Some(window) = &render.window {
        let window = window_sink(window, given)?;
        all.0.push(labelled(if render.anaglyph { Box::new(AnaglyphSink::new(window)) } else { window })?);
    }
    let depth = |target: &PlaneTarget| -> Result<Box<dyn FrameSink>, SinkError> {
        Ok(Box::new(DepthSink::new(target)?.with_made_up(render.made_up)))
    };
    let ground = |target: &PlaneTarget| -> Result<Box<dyn FrameSink>, SinkError> {
        Ok(Box::new(GroundSink::new(target, world, config.exaggeration)?.with_made_up(render.made_up)))
    };
    let depths = render.depth.iter().map(depth).collect::<Result<_, _>>()?;
    let grounds = render.ground.iter().map(ground).collect::<Result<_, _>>()?;
    all.0.extend([split_views(config, depths), split_views(config, grounds)].into_iter().flatten());
    // Last: where there is a picture of a frame, there is all of it.
    all.0.push(picture);
    Ok(Box::new(all))
}

/// The window that is to be shown.
#[cfg(feature = "window")]
fn window_sink(window: &WindowConfig, given: Given<'_>) -> Result<Box<dyn FrameSink>, SinkError> {
    use terravision_window::desktop::{Desktop, WindowSetup};
    let Given { config, index, .. } = given;
    let heights = index.ranges().range(index.world().root()).unwrap_or_default();
    let setup = WindowSetup {
        config: window.clone(),
        world: *index.world(),
        heights_m: heights.map(|height| config.exaggeration * f64::from(height)),
        database: config.database.clone(),
        exaggeration: config.exaggeration,
        most_px: [config.width, config.height],
        has_overlay: config.render.has_tree_overlay,
    };
    let desktop = Desktop::open(setup).map_err(|error| SinkError::Window { reason: error.to_string() })?;
    Ok(Box::new(super::WindowSink::new(desktop, window.has_vsync, config.render.has_validation)))
}

/// The same in a build without windows.
#[cfg(not(feature = "window"))]
fn window_sink(_window: &WindowConfig, _given: Given<'_>) -> Result<Box<dyn FrameSink>, SinkError> {
    Err(SinkError::Window { reason: crate::NO_WINDOW.to_owned() })
}

/// The sink of pictures.
fn picture_sink(sink: &SinkConfig, given: Given<'_>) -> Result<Box<dyn FrameSink>, SinkError> {
    let Given { config, run, control, written, .. } = given;
    let made: Box<dyn FrameSink> = match sink {
        SinkConfig::PngFolder(folder) => Box::new(PngFolderSink::new(folder)?),
        SinkConfig::PngFile(path) => Box::new(PngFileSink::new(path)),
        // What is left out of a stream the launcher makes up for.
        SinkConfig::Stream(encoding) => {
            return Ok(Box::new(StreamSink::open(run, control, *encoding, config.output_size())?));
        }
        SinkConfig::Null => Box::new(NullSink),
        SinkConfig::EachView(sinks) => {
            let sinks = sinks.iter().map(|sink| picture_sink(sink, given)).collect::<Result<_, _>>()?;
            return Ok(split_views(config, sinks).unwrap_or_else(|| Box::new(NullSink)));
        }
    };
    // Files of frames that were left out show the frame before.
    Ok(if config.realtime.is_some() { Box::new(RepeatSink::new(made, config.frame_numbers(), written)?) } else { made })
}

/// Sinks of all views, in the order of the rig, as one; `None` without any.
fn split_views(config: &RunConfig, mut sinks: Vec<Box<dyn FrameSink>>) -> Option<Box<dyn FrameSink>> {
    match &config.rig {
        None => sinks.pop(),
        Some(_) if sinks.is_empty() => None,
        Some(rig) => {
            let names = rig.views().iter().map(|view| view.name.clone());
            Some(Box::new(SplitViewsSink::new(names.zip(sinks).collect())))
        }
    }
}
