//! The renderer: draws the ring with Vulkan and hands pictures to a sink.
//!
//! ```text
//! source ──slots──▶ frame ──checked──▶ engine ──pixels──▶ sinks (threads of their own)
//! (shared memory,   (nothing is        (technique,         (png, film, y4m,
//!  or a recording)   trusted)           gpu)                null)
//! ```
//!
//! * [`source`]: where frames come from. [`frame`]: reading and checking them.
//! * [`technique`]: how they are drawn. [`gpu`]: Vulkan, the only place with `unsafe`. [`engine`]:
//!   both put together.
//! * [`skirt`]: the sides of the world, drawn over pictures that are seen from beside it. [`air`]: haze
//!   and sky, laid over pictures. [`vehicles`]: likewise, before the air.
//! * [`stage`]: a run's configuration, [`ports`]: its segments. [`sink`]: where pictures go.
//!   [`run`]: the frame loop. [`mod@bench`]: what the device and the renderer can do.
//!
//! The frame loop allocates nothing in the steady state; encoders run on threads of their own.

/// What a build without windows says to who asks for one.
pub const NO_WINDOW: &str =
    "this build of TerraVision has no window: build it with cargo build --release --features window";

pub mod air;
pub mod bench;
pub mod engine;
pub mod frame;
pub mod gpu;
pub mod pixels;
pub mod ports;
pub mod run;
pub mod sink;
pub mod skirt;
pub mod source;
pub mod stage;
pub mod technique;
pub mod vehicles;
