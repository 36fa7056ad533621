//! The frame ring: pictures for other programs, in shared memory (docs/frame-ring.md). Waits for
//! none of them.

use super::tiff::{GroundView, depth_m};
use super::{FrameSink, Picture, SinkError, check_room};
use glam::DVec3;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::event::monotonic_nanos;
use terravision_common::rig::Views;
use terravision_common::run::{MadeUp, ShareConfig};
use terravision_common::shm::{FrameInfo, FrameRingWriter, FrameShape, SharedName};
use terravision_common::world::World;

/// Writes the frame ring.
#[derive(Debug)]
pub struct SharedSink {
    ring: FrameRingWriter,
    shape: FrameShape,
    name: String,
    world: World,
    exaggeration: f64,
    made_up: MadeUp,
}

impl SharedSink {
    /// Into the ring that the launcher has made. `world`: whose places are
    /// told.
    ///
    /// # Errors
    /// There is no such ring, or it is of other pictures.
    pub fn open(share: &ShareConfig, size: [u32; 2], world: World, exaggeration: f64) -> Result<Self, SinkError> {
        let shape = FrameShape { size, has_depth: share.has_depth, has_ground: share.has_ground };
        let ring = FrameRingWriter::open(&SharedName::parse(&share.name)?, shape)?;
        Ok(Self { ring, shape, name: share.name.clone(), world, exaggeration, made_up: MadeUp::default() })
    }

    /// What depth and ground say where the ground was made up; colours tell it in any case.
    #[must_use]
    pub fn with_made_up(self, made_up: MadeUp) -> Self {
        Self { made_up, ..self }
    }
}

/// The camera of a frame: of two eyes one between them, which is the pose that carries them.
fn in_the_middle(views: &Views) -> Camera {
    let first = views.first().map(|view| view.camera).unwrap_or_default();
    if views.len() < 2 {
        return first;
    }
    let sum: DVec3 = views.cameras().map(Camera::eye).sum();
    let eye_in_world = (sum / views.len() as f64).to_array();
    Camera::new(CameraFields { eye_in_world, ..*first.fields() }).unwrap_or(first)
}

impl FrameSink for SharedSink {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        check_room("the ring of shared frames", picture, self.shape.size)?;
        let reversed = match picture.reversed_depth {
            Some(reversed) => reversed,
            None if self.shape.has_depth || self.shape.has_ground => {
                return Err(SinkError::NoDepth { path: format!("shared:{}", self.name).into() });
            }
            None => &[],
        };
        let width = picture.size[0] as usize;
        let is_told = || picture.made_up().map(|is_made_up| is_made_up && self.made_up == MadeUp::Nan);
        let depth = reversed.iter().map(|&depth| depth_m(depth) as f32).zip(is_told());
        let depth = depth.map(|(depth, is_nan)| if is_nan { f32::NAN } else { depth });
        let view = GroundView::new(picture.camera(), &self.world, self.exaggeration);
        let ground = view.positions(reversed, width).zip(is_told());
        let ground = ground.map(|(at, is_nan)| if is_nan { [f64::NAN; 3] } else { at });
        let Picture { frame, is_settled, .. } = picture;
        let camera = &in_the_middle(&picture.views);
        let info = FrameInfo::new(frame.get(), camera, self.world.crs_frame().origin(), *is_settled, monotonic_nanos());
        // Of two eyes side by side the whole.
        let info = FrameInfo { size: picture.size, ..info };
        self.ring.write(&info, picture.rgba, depth, ground)?;
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}
