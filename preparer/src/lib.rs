//! The preparer: from a truncated quad tree to what the renderer draws.
pub mod frame;
pub mod frame_tree;
pub mod heights;
pub mod trim;
pub mod truncation;
