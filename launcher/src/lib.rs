//! TerraVision's launcher: the program `terravision`.
//!
//! * [`cli`]: the command line as typed; [`plan`]: the validated plan that is made of it.
//! * [`path`]: camera paths, from files or built in.
//! * [`flight`]: runs the three stages: starts them, flies the camera, watches, collects, cleans up.
//! * [`report`], [`trace`]: what a run says about itself afterwards.
//! * [`doctor`], [`info`]: what the machine and a database have.

pub mod cli;
pub mod failure;
pub mod ground;
pub mod output;
pub mod path;
pub mod plan;
