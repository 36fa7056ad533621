//! Commands that fly nothing. `fly` and `still` are in [`crate::plan`] and [`crate::flight`].

pub mod doctor;
pub mod exec;
pub mod export;
pub mod info;
pub mod places;
