//! From rasters to a terrain database, and a synthetic world to begin with.
//!
//! ```text
//! sources ──sample──▶ finest posts ──half-band──▶ elevation levels ──fill, crests──▶ tiles ─▶ elevation.pmtiles
//!                        (void: NaN)                                          └────▶ ranges ─▶ nodes.tvn
//! sources ──sample──▶ finest cells ──half-band──▶ colour levels ───────────────────▶ tiles ─▶ color.pmtiles
//!             └─ voids: tint from elevation                                                  manifest.json last
//! ```
//!
//! * [`job`]: a complete ingest. [`source`]: rasters, their positions, and the meaning of their
//!   samples. [`plan`]: the world's geometry.
//! * [`sample`]: from sources to the finest level. [`pyramid`]: the other levels, voids; `crests`
//!   raises those of coarser levels. [`tint`]: colour from elevation.
//! * [`store`]: levels in temporary files, so that memory is bounded. [`work`]: threads, with and
//!   without order.
//! * [`body`]: databases of whole bodies, over longitude and latitude.
//! * `nested`: the same for sources of different spacings, whose finest levels exist only where
//!   there are data.
//! * [`archive`], [`ranges`], [`lonlat`]: the parts of the resulting database. [`synth`]: a
//!   mountain world; [`sparse`]: worlds for tests.
//!
//! Every block of every level is a pure function of its position: the bytes are the same for any
//! number of threads.

#![forbid(unsafe_code)]

pub mod archive;
pub mod body;
mod bulk;
pub mod cli;
mod crests;
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
