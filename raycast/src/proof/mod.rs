//! Which part of a ray's way another ray proves to be in the air.
//!
//! A higher ray meets a height field further off, so a ray may start where the one below it hit.
//! That holds when its samples lie above those of the lower ray, and a little beside them no more
//! than the ground can rise in between: sample `s` of ray i is `eye + s·D_i`, so it is `s·(D_i −
//! D_j)` from that of ray j, and
//!
//! ```text
//! D_i.z − D_j.z  >=  slope · |D_i.xy − D_j.xy|      ⇒      in the air at j  ⇒  in the air at i,  for every s
//! ```
//!
//! where no ground between the two is steeper than `slope`. Forward-only methods take this for
//! granted, but planes of rays are not vertical beside the middle of a pitched picture, and pixels
//! of a rolled line are not above each other: then a ray may run into a cliff that the one below it
//! passed by. Here it is tested for each ray against the rays of its line, its possible
//! *witnesses*, by the slopes of the ground between them ([`steepness`]); where the ground is
//! steeper than the two rays allow, and there alone, the way is looked at: these are the *unproven
//! intervals*.

mod recent;
pub(crate) mod steepness;
mod unproven;
mod witness;

pub(crate) use recent::Recent;
pub use steepness::Steepness;
pub use unproven::Unproven;

use crate::view::Ray;

/// From which of the rays below it a ray of a line takes over its start.
///
/// [`Steepness`] is the rule of pictures: it proves what it takes over. Others are for comparison
/// ([`crate::Caster::draw_by`]).
pub trait StartRule: Sync {
    /// Whether rays rely on each other at all. A ray that has no witness then passes over blocks of
    /// ground that lie below it as a whole, and exact rays try the facet that the one below hit.
    const RELIES: bool;
    /// Whether a ray without a witness starts where it comes below the top of the ground, not where
    /// it comes over the ground.
    const STARTS_BELOW_TOP: bool;

    /// Of rays below, nearest first, the one that a ray takes over its start from, and where on the
    /// way there that proves nothing. `of`: a candidate's ray, and the parameter up to which it is
    /// in the air.
    fn find_witness<K>(
        &self,
        ray: &Ray,
        below: impl Iterator<Item = K>,
        of: impl Fn(&K) -> (&Ray, f32),
    ) -> Option<(K, Unproven)>;

    /// The slopes of the ground, where they are known: then exact rays follow it from facet to
    /// facet.
    fn slopes(&self) -> Option<&Steepness>;
}
