//! One exact ray per pixel, over the facets that the mesh draws.

pub(crate) mod facets;
pub(crate) mod mipmap;
pub(crate) mod projected;
pub(crate) mod strip;
pub(crate) mod trace;
