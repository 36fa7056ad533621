//! What pixels show once it is known where their rays meet the ground.

pub(crate) mod outline;
pub(crate) mod paint;
pub(crate) mod shares;
