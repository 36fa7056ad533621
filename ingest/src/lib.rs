//! From rasters to a terrain database, and a synthetic world to begin with.
//!
//! ```text
//! sources ──sample──▶ finest posts ──half-band──▶ elevation levels ──fill──▶ tiles ─▶ elevation.pmtiles
//!                        (void: NaN)                                  └────▶ ranges ─▶ nodes.tvn
//! sources ──sample──▶ finest cells ──half-band──▶ colour levels ───────────▶ tiles ─▶ color.pmtiles
//!             └─ voids: tint from elevation                                          manifest.json last
//! ```
//!
//! * [`job`]: the whole of it. [`source`]: rasters, where they lie, what their samples mean.
//!   [`plan`]: the world's geometry.
//! * [`sample`]: from sources to the finest level. [`pyramid`]: the other levels, voids. [`tint`]:
//!   colour from elevation.
//! * [`store`]: levels as they lie on disk meanwhile, so that memory is bounded. [`work`]: threads,
//!   in order and not.
//! * `nested`: the same for sources of different spacings, whose finest levels are only where the
//!   data are.
//! * [`archive`], [`ranges`], [`lonlat`]: what is left in the end. [`synth`]: a mountain world;
//!   [`sparse`]: worlds for tests.
//!
//! Every block of every level is a pure function of its position: the bytes are the same for any
//! number of threads.

#![forbid(unsafe_code)]

pub mod archive;
mod bulk;
pub mod cli;
pub mod error;
pub mod job;
pub mod lonlat;
mod nested;
pub mod plan;
pub mod pyramid;
pub mod ranges;
pub mod sample;
pub mod source;
pub mod sparse;
pub mod store;
pub mod synth;
pub mod tint;
pub mod work;

pub use error::IngestError;
