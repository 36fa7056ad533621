//! What TerraVision's tests stand on: processes as values, worlds to fly over, an S3 server, storms,
//! changed inputs, what benches find.

pub mod findings;
pub mod flight;
pub mod folder;
pub mod fuzz;
pub mod geotiff;
pub mod live;
pub mod posed;
pub mod process;
pub mod rays;
pub mod s3;
pub mod shot;
pub mod storm;
pub mod worlds;
