//! What the processes of TerraVision share.
//!
//! * [`node`]: the id of a quad tree node. [`world`]: how nodes, elevation posts and colour texels lie in the plane.
//! * [`camera`]: pose, projection, view frustum. [`level`]: how fine to sample at a point (design §4).
//! * [`tree`], [`slot`], [`event`]: what travels through shared memory from process to process, byte for byte.
//! * [`shm`]: the shared-memory segments themselves. [`database`]: reading a terrain database.
//! * [`run`]: what the launcher tells each stage about the run that it is part of.

pub mod camera;
pub mod event;
pub mod level;
pub mod node;
pub mod run;
pub mod slot;
pub mod tree;
pub mod world;
