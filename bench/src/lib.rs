//! TerraVision's benches: each stage alone, the queues between them, the whole, and ingest; as
//! ratios of things that were measured in one run, because times of a shared machine say little.

#![forbid(unsafe_code)]

pub mod cli;
pub mod findings;
pub mod flat;
pub mod flight;
pub mod launch;
pub mod link;
pub mod long_run;
pub mod machine;
pub mod measurement;
pub mod plot;
pub mod quality;
pub mod query;
pub mod queues;
pub mod rays;
pub mod realtime;
pub mod recording;
pub mod run;
pub mod session;
pub mod stages;
pub mod techniques;
pub mod vehicles;
pub mod world;
