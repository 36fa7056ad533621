//! The window on the desktop, with a thread of its own for its events.
//!
//! * [`app`]: what becomes of events. [`keys`]: what keys mean. [`poses`]: poses and sizes on their
//!   way to the flight.

mod app;
mod keys;
mod poses;

use crate::WindowError;
use app::App;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use terravision_common::run::{DatabaseConfig, WindowConfig};
use terravision_common::terminal::complain;
use terravision_common::world::World;
use winit::event_loop::{EventLoop, EventLoopProxy, OwnedDisplayHandle};
use winit::platform::wayland::EventLoopBuilderExtWayland;
use winit::platform::x11::EventLoopBuilderExtX11;
use winit::raw_window_handle::{DisplayHandle, HandleError, HasDisplayHandle, HasWindowHandle, WindowHandle};
use winit::window::Window;

/// What a window is opened with.
#[derive(Debug, Clone)]
pub struct WindowSetup {
    /// As the launcher wants it.
    pub config: WindowConfig,
    /// The world.
    pub world: World,
    /// Its lowest and highest ground, exaggerated, metres.
    pub heights_m: [f64; 2],
    /// Its tiles.
    pub database: DatabaseConfig,
    /// Factor on its heights.
    pub exaggeration: f64,
    /// Largest picture, pixels.
    pub most_px: [u32; 2],
    /// Whether the tree is drawn over the picture at first.
    pub has_overlay: bool,
}

/// What the window's thread and the renderer tell each other.
#[derive(Debug)]
pub struct Wishes {
    has_overlay: Arc<AtomicBool>,
    size_px: AtomicU64,
}

impl Wishes {
    fn new(has_overlay: bool) -> Self {
        Self { has_overlay: Arc::new(has_overlay.into()), size_px: AtomicU64::new(0) }
    }

    /// Whether the leaves of the tree are to be drawn over the picture.
    #[must_use]
    pub fn overlay(&self) -> &Arc<AtomicBool> {
        &self.has_overlay
    }

    /// The other way than it is.
    fn toggle_overlay(&self) {
        // Relaxed: one value, from which nothing follows.
        self.has_overlay.fetch_xor(true, Ordering::Relaxed);
    }

    /// Width and height of the window, the screen's pixels.
    #[must_use]
    pub fn size_px(&self) -> [u32; 2] {
        // Relaxed: one word.
        let word = self.size_px.load(Ordering::Relaxed);
        [word as u32, (word >> 32) as u32]
    }

    fn set_size_px(&self, [width, height]: [u32; 2]) {
        self.size_px.store(u64::from(width) | u64::from(height) << 32, Ordering::Relaxed);
    }
}

/// The window, for what is shown in it: its handles, and the connection that they are of, are valid
/// as long as this value lives.
pub struct DesktopWindow {
    window: Arc<Window>,
    wishes: Arc<Wishes>,
    display: OwnedDisplayHandle,
}

impl DesktopWindow {
    /// What it and the renderer tell each other.
    #[must_use]
    pub fn wishes(&self) -> &Wishes {
        &self.wishes
    }
}

impl fmt::Debug for DesktopWindow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DesktopWindow").field("wishes", &self.wishes).finish_non_exhaustive()
    }
}

impl HasWindowHandle for DesktopWindow {
    fn window_handle(&self) -> Result<WindowHandle<'_>, HandleError> {
        self.window.window_handle()
    }
}

impl HasDisplayHandle for DesktopWindow {
    fn display_handle(&self) -> Result<DisplayHandle<'_>, HandleError> {
        self.display.display_handle()
    }
}

/// What wakes the window's thread.
#[derive(Debug)]
enum Wake {
    /// The ground has answered.
    Answer(crate::hands::Answer),
    /// The flight is over.
    End,
}

/// A window, open as long as this value lives.
#[derive(Debug)]
pub struct Desktop {
    window: Arc<DesktopWindow>,
    proxy: EventLoopProxy<Wake>,
    thread: Option<JoinHandle<()>>,
}

/// What a thread has opened, or why not.
type Opened = Result<(DesktopWindow, EventLoopProxy<Wake>), WindowError>;

impl Desktop {
    /// Opens the window; waits until it is there.
    ///
    /// # Errors
    /// No display, or the desktop refuses.
    pub fn open(setup: WindowSetup) -> Result<Self, WindowError> {
        let (tell, opened) = sync_channel(1);
        let thread = std::thread::Builder::new().name("window".into()).spawn(move || run(setup, &tell))?;
        let ended = || WindowError::Refused { reason: "its thread ended".into() };
        let (window, proxy) = opened.recv().map_err(|_ended| ended())??;
        Ok(Self { window: Arc::new(window), proxy, thread: Some(thread) })
    }

    /// The window.
    #[must_use]
    pub fn window(&self) -> &Arc<DesktopWindow> {
        &self.window
    }
}

impl Drop for Desktop {
    fn drop(&mut self) {
        // A thread that has ended is not woken.
        self.proxy.send_event(Wake::End).ok();
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

/// Whether a window could be opened here.
///
/// # Errors
/// No display.
pub fn check() -> Result<(), WindowError> {
    event_loop().map(drop)
}

fn event_loop() -> Result<EventLoop<Wake>, WindowError> {
    let mut builder = EventLoop::<Wake>::with_user_event();
    // The main thread draws.
    EventLoopBuilderExtX11::with_any_thread(&mut builder, true);
    EventLoopBuilderExtWayland::with_any_thread(&mut builder, true);
    builder.build().map_err(|error| {
        let mut reason = sentence(&error.to_string());
        let is_set = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
        // Wayland comes first, also where its variable is left over from another session.
        if is_set("WAYLAND_DISPLAY") && is_set("DISPLAY") {
            reason.push_str("; WAYLAND_DISPLAY is set: without it DISPLAY is used");
        }
        WindowError::NoDisplay { reason }
    })
}

/// A message of the desktop's library without what is for its developers: the file, the line.
fn sentence(message: &str) -> String {
    let message =
        message.strip_prefix("os error at ").and_then(|rest| rest.split_once(": ")).map_or(message, |at| at.1);
    message.trim().trim_end_matches('.').to_owned()
}

/// The window's thread.
fn run(setup: WindowSetup, opened: &SyncSender<Opened>) {
    let begun = event_loop().and_then(|events| {
        let app = App::new(setup, &events, opened.clone())?;
        Ok((events, app))
    });
    match begun {
        Ok((events, mut app)) => {
            if events.run_app(&mut app).is_err() {
                complain("the desktop has gone, and the window with it: the flight ends");
            }
            // Without a window nobody flies.
            app.end_flight();
        }
        // Who opens it is there: it waits for this.
        Err(error) => drop(opened.send(Err(error))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_of_the_library_are_told_without_its_file_names() {
        let message =
            "os error at /root/.cargo/registry/winit/src/mod.rs:765: neither WAYLAND_DISPLAY nor DISPLAY is set.";
        assert_eq!(sentence(message), "neither WAYLAND_DISPLAY nor DISPLAY is set");
        assert_eq!(sentence("no"), "no");
    }

    #[test]
    fn wishes_are_words() {
        let wishes = Wishes::new(false);
        wishes.set_size_px([1280, 720]);
        wishes.toggle_overlay();
        assert_eq!((wishes.size_px(), wishes.overlay().load(Ordering::Relaxed)), ([1280, 720], true));
    }
}
