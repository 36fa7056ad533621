//! The window: shows every frame, and waits for nobody. Pictures that a device has drawn stay on it;
//! others, and those that the processor has drawn over, are uploaded.

use super::{FrameSink, Picture, SinkError};
use crate::gpu::{DevicePicture, GpuError, Presenter, ShowOptions, ShowTarget, Shown, WindowFaults};
use crate::pixels::PixelPlaces;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use terravision_common::event::monotonic_nanos;
use terravision_window::desktop::{Desktop, DesktopWindow};

/// Losses of the device in a row, after which showing is given up.
const MOST_LOSSES: u32 = 3;
/// Tests say by this variable of the environment what the window answers.
const WINDOW_FAULTS: &str = "TERRAVISION_TEST_WINDOW_FAULTS";

/// Shows frames in a window.
pub struct WindowSink {
    // In the order in which they go: the window outlives what is shown in it.
    presenter: Option<Presenter>,
    target: Arc<dyn ShowTarget>,
    /// Whether the device that draws shows nothing in this window, while another one does.
    is_read_back: bool,
    losses: u32,
    options: ShowOptions,
    /// When the camera of the frame that was shown last was made.
    newest_nanos: u64,
    desktop: Desktop,
}

impl fmt::Debug for WindowSink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WindowSink").field("presenter", &self.presenter).finish_non_exhaustive()
    }
}

impl ShowTarget for DesktopWindow {
    fn size_px(&self) -> [u32; 2] {
        self.wishes().size_px()
    }
}

impl WindowSink {
    /// In a window that was opened.
    #[must_use]
    pub fn new(desktop: Desktop, has_vsync: bool, has_validation: bool) -> Self {
        let window = Arc::clone(desktop.window());
        let target: Arc<dyn ShowTarget> = window;
        let faults = std::env::var(WINDOW_FAULTS).ok().and_then(|text| WindowFaults::parse(&text));
        let options = ShowOptions { has_vsync, has_validation, faults: Arc::new(faults.unwrap_or_default()) };
        Self { presenter: None, target, is_read_back: false, losses: 0, options, newest_nanos: 0, desktop }
    }

    fn show(&mut self, picture: &Picture<'_>) -> Result<bool, GpuError> {
        let Some(on_device) = picture.on_device else {
            return self.any_presenter()?.show(Shown::InMemory(picture.rgba, picture.size));
        };
        if !self.is_read_back {
            match self.presenter_of(on_device) {
                Err(error @ GpuError::Unshowable { .. }) => {
                    tracing::info!(%error, "pictures are read back, and shown by another device");
                    self.is_read_back = true;
                }
                presenter => return presenter?.show(Shown::OnDevice(on_device)),
            }
        }
        let rgba = on_device.read()?;
        self.any_presenter()?.show(Shown::InMemory(&rgba, picture.size))
    }

    /// The presenter that there is, or one with a device of its own.
    fn any_presenter(&mut self) -> Result<&mut Presenter, GpuError> {
        let presenter = match self.presenter.take() {
            Some(presenter) => presenter,
            None => Presenter::of_its_own(&self.target, &self.options)?,
        };
        Ok(self.presenter.insert(presenter))
    }

    /// A presenter with the device that a picture is on.
    fn presenter_of(&mut self, picture: &DevicePicture) -> Result<&mut Presenter, GpuError> {
        let device = picture.device();
        // A window has one swapchain: that of another device goes first.
        let presenter = match self.presenter.take().filter(|presenter| Arc::ptr_eq(presenter.device(), device)) {
            Some(presenter) => presenter,
            None => Presenter::with_device(device, &self.target, &self.options)?,
        };
        Ok(self.presenter.insert(presenter))
    }
}

impl FrameSink for WindowSink {
    fn needs(&self) -> PixelPlaces {
        PixelPlaces::EITHER
    }

    fn tree_overlay(&self) -> Option<Arc<AtomicBool>> {
        Some(Arc::clone(self.desktop.window().wishes().overlay()))
    }

    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        let shown = match self.show(picture) {
            Ok(shown) => shown,
            Err(error) if error.is_device_lost() && self.losses < MOST_LOSSES => {
                // Who draws notices it by itself.
                tracing::warn!(%error, "a picture was not shown");
                self.presenter = None;
                self.losses += 1;
                return Ok(());
            }
            Err(error) => return Err(error.into()),
        };
        self.losses = 0;
        let made_nanos = picture.camera().timestamp_nanos();
        if shown && made_nanos > self.newest_nanos {
            self.newest_nanos = made_nanos;
            let latency_ms = monotonic_nanos().saturating_sub(made_nanos) as f64 / 1e6;
            tracing::debug!(frame = picture.frame.get(), latency_ms, size = ?picture.size, "a new camera's picture is shown");
        }
        if self.options.has_validation
            && let Some(presenter) = &self.presenter
        {
            presenter.device().instance().check_validation()?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        self.presenter = None;
        Ok(())
    }
}
