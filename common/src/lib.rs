//! What the processes of TerraVision share.
//!
//! * [`node`]: the id of a quad tree node. [`world`]: what a database holds. [`surface`]: where its
//!   ground lies in space, the one home of geometry.
//! * [`camera`]: pose, projection, view frustum. [`rig`]: several cameras that one pose carries.
//!   [`level`]: how fine to sample at a point (design §4).
//! * [`tree`], [`slot`], [`outcome`], [`event`]: what travels through shared memory from process to
//!   process, byte for byte.
//! * [`shm`]: the shared-memory segments themselves. [`database`]: reading a terrain database.
//! * [`ids`]: numbers that must not be mixed up.
//! * [`lonlat`]: from longitude and latitude to a world's plane. [`validity`]: which ground was
//!   measured. [`traversal`]: the search of the quad tree. [`node_table`]: a map from nodes
//!   that is cleared at once.
//! * [`rate`]: feedback from frame times to screen resolutions (design §8).
//! * [`film`]: what renderer and launcher both know of films. [`texels`]: how the pool holds colour
//!   tiles, block-compressed or not.
//! * [`top_levels`]: what the pools keep for ever. [`synthetic`]: a terrain for tests and benches.
//! * [`files`], [`terminal`], [`bug`]: files that others prepared, text of others on its way to a
//!   terminal, panics as a last resort.
//! * [`log`]: what each process does, for whoever looks for a fault.
//! * [`threads`]: whether the system gives any. [`run`]: what the launcher tells each stage about
//!   the run that it is part of. [`report`]: what it says of the run afterwards.

pub mod bug;
pub mod camera;
pub mod database;
pub mod event;
pub mod files;
pub mod film;
pub mod ids;
pub mod level;
#[cfg(not(loom))]
pub mod log;
pub mod lonlat;
pub mod node;
pub mod node_table;
pub mod outcome;
pub mod rate;
pub mod report;
pub mod rig;
pub mod run;
pub mod shm;
pub mod slot;
#[cfg(not(loom))]
pub mod stage;
pub mod surface;
pub mod sync;
pub mod synthetic;
pub mod terminal;
pub mod texels;
pub mod threads;
pub mod top_levels;
pub mod traversal;
pub mod tree;
pub mod validity;
pub mod world;
