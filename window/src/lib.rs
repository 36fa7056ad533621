//! A native window in which a person flies: `terravision view` (docs/window.md). The renderer links
//! it where it is built with the feature `window`, and shows pictures in it; nothing here draws.
//!
//! ```text
//!                 events                poses (shared memory)
//! desktop (winit) ─────▶ hands ──────────────────────────────▶ launcher
//!     │ window            │  ▲
//!     ▼          question ▼  │ answer
//! renderer's sink         ground (a thread: tiles of the database)
//! ```
//!
//! * [`hands`]: pure functions from what hands do to poses. [`ground`]: what they hold.
//! * [`desktop`]: the window, its keys and its thread; winit is named nowhere else. `path_file`: the
//!   path that is played.

pub mod desktop;
mod error;
pub mod ground;
pub mod hands;
mod path_file;

pub use error::WindowError;
