//! Code that the processes of TerraVision share.
//!
//! * [`node`]: the id of a quad tree node. [`world`]: what a database holds. [`surface`]: where its
//!   ground lies in space, the one home of geometry.
//! * [`camera`]: pose, projection, view frustum. [`rig`]: several cameras that one pose carries.
//!   [`level`]: the level of detail that a point needs.
//! * [`tree`], [`slot`], [`outcome`], [`event`]: the records that processes exchange through shared
//!   memory.
//! * [`shm`]: the shared-memory segments themselves. [`database`]: reading a terrain database.
//! * [`ground`]: questions to a world's ground: heights, lines of sight, swept spheres.
//! * [`ids`]: newtypes for numbers that must not be mixed up.
//! * [`lonlat`]: from longitude and latitude to a world's plane. [`validity`]: which ground was
//!   measured. [`traversal`]: the search of the quad tree. [`node_table`]: a map from nodes
//!   that is cleared at once.
//! * [`rate`]: feedback from frame times to screen resolutions.
//! * [`film`]: what renderer and launcher share about films. [`texels`]: formats of colour tiles in
//!   the pool, block-compressed or not.
//! * [`light`]: light and air. [`tint`]: colours by height, of a world without a picture.
//! * [`top_levels`]: tiles that are never evicted. [`synthetic`]: a terrain for tests and benches.
//! * [`files`]: safe handling of files that other users may have prepared. [`terminal`]: foreign
//!   text on a terminal. [`bug`]: reports of panics.
//! * [`log`]: logging of all processes.
//! * [`threads`]: whether threads can be started. [`run`]: the configuration of a run, from the
//!   launcher to each stage. [`report`]: the report of a run. [`viewer`]: what launcher and viewer
//!   tell each other.

pub mod bug;
pub mod camera;
pub mod database;
pub mod event;
pub mod files;
pub mod film;
pub mod ground;
pub mod ids;
pub mod level;
pub mod light;
#[cfg(not(loom))]
pub mod log;
pub mod lonlat;
pub mod node;
mod node_hasher;
pub mod node_table;
pub mod outcome;
pub mod rate;
pub mod report;
pub mod rig;
pub mod run;
pub mod shm;
pub mod simd;
pub mod slot;
#[cfg(not(loom))]
pub mod stage;
pub mod surface;
pub mod sync;
pub mod synthetic;
pub mod technique;
pub mod terminal;
pub mod texels;
pub mod threads;
pub mod tint;
pub mod top_levels;
pub mod traversal;
pub mod tree;
pub mod validity;
pub mod vehicle;
pub mod viewer;
pub mod world;
