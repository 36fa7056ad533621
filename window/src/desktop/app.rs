//! What becomes of the desktop's events: hands move the camera, and its poses go to the flight.

use super::keys::{self, Meaning};
use super::poses::{Poses, now_s, picture_size};
use super::{DesktopWindow, Opened, Wake, WindowSetup, Wishes};
use crate::WindowError;
use crate::ground;
use crate::hands::{Grip, Hands, HeldKey, Input, Question, World};
use crate::path_file;
use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};
use terravision_common::run::WindowConfig;
use winit::application::ApplicationHandler;
use winit::dpi::{LogicalPosition, LogicalSize, PhysicalSize};
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy, OwnedDisplayHandle};
use winit::window::{Fullscreen, Window, WindowId};

/// Between two steps of a camera that moves by itself.
const STEP: Duration = Duration::from_millis(8);
/// Between two looks at what the title bar says.
const TITLE_EVERY: Duration = Duration::from_millis(250);
/// How long the title bar says each line of what keys do.
const HELP_LINE: Duration = Duration::from_secs(4);
/// Pixels of a page that scrolls, for a notch of the wheel.
const NOTCH_PX: f64 = 100.0;

/// The window's state.
pub(super) struct App {
    setup: WindowSetup,
    wishes: Arc<Wishes>,
    hands: Hands,
    poses: Poses,
    ask: SyncSender<Question>,
    opened: SyncSender<Opened>,
    proxy: EventLoopProxy<Wake>,
    display: OwnedDisplayHandle,
    window: Option<Arc<Window>>,
    is_ctrl: bool,
    next_step: Instant,
    title: String,
    title_due: Instant,
    /// When the title bar began to say what keys do.
    help_since: Option<Instant>,
    has_ended: bool,
}

impl App {
    pub(super) fn new(
        setup: WindowSetup,
        events: &EventLoop<Wake>,
        opened: SyncSender<Opened>,
    ) -> Result<Self, WindowError> {
        let WindowConfig { name, start, size, .. } = &setup.config;
        let poses = Poses::open(name)?;
        let [low, high] = setup.world.crs_bounds();
        let world = World {
            side_m: (high - low).max_element(),
            middle_m: 0.5 * (setup.heights_m[0] + setup.heights_m[1]),
            start: *start,
        };
        let mut hands = Hands::new(world, poses.left().unwrap_or(*start), size.map(f64::from));
        if let Some(path) = &setup.config.path {
            hands = hands.with_path(path_file::read(path)?, path.fps);
        }
        let proxy = events.create_proxy();
        let answers = proxy.clone();
        let tell = move |answer| drop(answers.send_event(Wake::Answer(answer)));
        let ask = ground::start(setup.database.clone(), setup.exaggeration, tell)?;
        let now = Instant::now();
        Ok(Self {
            hands,
            poses,
            ask,
            opened,
            proxy,
            display: events.owned_display_handle(),
            window: None,
            is_ctrl: false,
            next_step: now,
            title: String::new(),
            title_due: now,
            help_since: None,
            has_ended: false,
            wishes: Arc::new(Wishes::new(setup.has_overlay)),
            setup,
        })
    }

    /// The flight ends: who flies it has gone.
    pub(super) fn end_flight(&mut self) {
        if !std::mem::replace(&mut self.has_ended, true) {
            self.poses.end(self.hands.pose());
        }
    }

    fn open(&self, events: &ActiveEventLoop) -> Result<Arc<Window>, WindowError> {
        let WindowConfig { title, size: [width, height], is_full_screen, .. } = &self.setup.config;
        let attributes = Window::default_attributes()
            .with_title(title)
            .with_inner_size(LogicalSize::new(*width, *height))
            .with_fullscreen(is_full_screen.then_some(Fullscreen::Borderless(None)));
        let window = events.create_window(attributes);
        window.map(Arc::new).map_err(|error| WindowError::Refused { reason: super::sentence(&error.to_string()) })
    }

    fn input(&mut self, input: Input) {
        self.hands.input(now_s(), input);
        self.after_hands();
    }

    /// Asks the ground what hands want to know, and tells the flight where the camera is.
    fn after_hands(&mut self) {
        for question in self.hands.take_questions() {
            if self.ask.try_send(question).is_err() {
                self.hands.answer(now_s(), ground::sky(&question));
            }
        }
        if self.window.is_some() && !self.has_ended {
            let WindowConfig { scale, has_sizes, .. } = self.setup.config;
            let size = match has_sizes {
                true => picture_size(self.wishes.size_px(), scale, self.setup.most_px),
                false => [0; 2],
            };
            self.poses.send(self.hands.pose(), size);
        }
    }

    fn resized(&mut self, size: PhysicalSize<u32>) {
        // One that is minimized on some desktops.
        if size.width == 0 || size.height == 0 {
            return;
        }
        self.wishes.set_size_px([size.width, size.height]);
        let scale = self.window.as_ref().map_or(1.0, |window| window.scale_factor());
        let LogicalSize { width, height } = size.to_logical::<f64>(scale);
        self.input(Input::Resize([width, height]));
    }

    fn key(&mut self, meaning: Meaning, events: &ActiveEventLoop) {
        match meaning {
            Meaning::Hands(input) => self.input(input),
            Meaning::LetGoZoom => {
                self.input(Input::LetGo(HeldKey::ZoomIn));
                self.input(Input::LetGo(HeldKey::ZoomOut));
            }
            Meaning::Overlay => self.wishes.toggle_overlay(),
            Meaning::FullScreen => self.set_full_screen(None),
            Meaning::Help => {
                let now = Instant::now();
                self.help_since = if self.help_since.is_some() { None } else { Some(now) };
                self.title_due = now;
            }
            Meaning::Escape if self.hands.is_moving() => self.input(Input::Stop),
            Meaning::Escape => self.set_full_screen(Some(false)),
            Meaning::Close => self.end_flight(),
            Meaning::Nothing => {}
        }
        self.schedule(events);
    }

    /// As large as the screen or not; without a wish the other way than it is.
    fn set_full_screen(&self, wish: Option<bool>) {
        let Some(window) = &self.window else { return };
        let is_wanted = wish.unwrap_or(window.fullscreen().is_none());
        window.set_fullscreen(is_wanted.then_some(Fullscreen::Borderless(None)));
    }

    fn button(&mut self, button: MouseButton, state: ElementState) {
        let grip = match button {
            MouseButton::Left if self.is_ctrl => Grip::Turn,
            MouseButton::Left => Grip::Ground,
            MouseButton::Right | MouseButton::Middle => Grip::Turn,
            _ => return,
        };
        self.input(if state == ElementState::Pressed { Input::Press(grip) } else { Input::Release });
    }

    fn wheel(&mut self, delta: MouseScrollDelta) {
        let pixels = match delta {
            MouseScrollDelta::LineDelta(_, lines) => -NOTCH_PX * f64::from(lines),
            MouseScrollDelta::PixelDelta(way) => -way.y,
        };
        self.input(Input::Wheel(pixels));
    }

    /// Steps a camera that moves by itself, when its time has come, and says when it comes next.
    fn schedule(&mut self, events: &ActiveEventLoop) {
        let now = Instant::now();
        if self.hands.is_moving() && now >= self.next_step {
            self.hands.tick(now_s());
            self.after_hands();
            self.next_step = now + STEP;
        }
        if now >= self.title_due {
            self.title_due = now + TITLE_EVERY;
            self.set_title(now);
        }
        // A window at rest has nothing to do but the next line of its help.
        let next = match self.hands.is_moving() {
            true => Some(self.next_step.min(self.title_due)),
            false => self.help_since.map(|_| self.title_due),
        };
        events.set_control_flow(next.map_or(ControlFlow::Wait, ControlFlow::WaitUntil));
    }

    fn set_title(&mut self, now: Instant) {
        let line = self.help_since.and_then(|since| keys::HELP.get(help_line(now.duration_since(since))));
        let title = if let Some(line) = line {
            (*line).to_owned()
        } else {
            self.help_since = None;
            let (height, heading) = (self.hands.clearance_m().round(), self.hands.pose().heading.round() % 360.0);
            let title = &self.setup.config.title;
            let playing =
                self.hands.playing_s().map(|[passed, length]| format!(" · {} of {}", minutes(passed), minutes(length)));
            format!("{title}{} · {height} m above ground · heading {heading}°", playing.unwrap_or_default())
        };
        if title != self.title
            && let Some(window) = &self.window
        {
            window.set_title(&title);
            self.title = title;
        }
    }
}

/// Which line of the help is said so long after its beginning.
fn help_line(passed: Duration) -> usize {
    (passed.as_millis() / HELP_LINE.as_millis()) as usize
}

/// A time as clocks show it: minutes and seconds.
fn minutes(seconds: f64) -> String {
    let seconds = seconds as u64;
    format!("{}:{:02}", seconds / 60, seconds % 60)
}

impl ApplicationHandler<Wake> for App {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.window.is_some() {
            return;
        }
        let opened = self.open(events);
        if let Ok(window) = &opened {
            self.window = Some(Arc::clone(window));
            self.resized(window.inner_size());
        }
        if opened.is_err() {
            events.exit();
        }
        let opened = opened.map(|window| {
            let (wishes, display) = (Arc::clone(&self.wishes), self.display.clone());
            (DesktopWindow { window, wishes, display }, self.proxy.clone())
        });
        // Who opens it waits for this.
        drop(self.opened.send(opened));
    }

    fn user_event(&mut self, events: &ActiveEventLoop, wake: Wake) {
        match wake {
            Wake::Answer(answer) => {
                self.hands.answer(now_s(), answer);
                self.after_hands();
            }
            Wake::End => {
                self.has_ended = true;
                events.exit();
            }
        }
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _window: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested | WindowEvent::Destroyed => self.end_flight(),
            WindowEvent::Resized(size) => self.resized(size),
            WindowEvent::ScaleFactorChanged { .. } => {
                if let Some(size) = self.window.as_ref().map(|window| window.inner_size()) {
                    self.resized(size);
                }
            }
            WindowEvent::Focused(false) => self.input(Input::Blur),
            WindowEvent::ModifiersChanged(modifiers) => {
                self.is_ctrl = modifiers.state().control_key();
                self.input(Input::Shift(modifiers.state().shift_key()));
            }
            WindowEvent::KeyboardInput { event, is_synthetic: false, .. } => {
                let meaning = keys::meaning(&event, self.is_ctrl);
                self.key(meaning, events);
            }
            WindowEvent::CursorMoved { position, .. } => {
                let scale = self.window.as_ref().map_or(1.0, |window| window.scale_factor());
                let LogicalPosition { x, y } = position.to_logical::<f64>(scale);
                self.input(Input::Point([x, y]));
            }
            WindowEvent::MouseInput { state, button, .. } => self.button(button, state),
            WindowEvent::MouseWheel { delta, .. } => self.wheel(delta),
            _ => {}
        }
    }

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        self.schedule(events);
    }
}
