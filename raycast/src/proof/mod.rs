//! Which part of a ray another ray proves to be in the air.
//!
//! A higher ray hits a height field farther away, so a ray may start where the ray below it hit.
//! That holds when its samples lie above those of the lower ray, by more than the ground can rise
//! over the horizontal distance between the two samples. Sample `s` of ray i is `eye + s·D_i`, so
//! that its distance from that of ray j is `s·(D_i − D_j)`, and
//!
//! ```text
//! D_i.z − D_j.z  >=  slope · |D_i.xy − D_j.xy|      ⇒      in the air at j  ⇒  in the air at i,  for every s
//! ```
//!
//! where no ground between the two is steeper than `slope`. Forward-only methods assume this. But
//! beside the middle of a pitched picture, planes of rays are not vertical, and pixels of a rolled
//! line are not above each other: then a ray may hit a cliff that the ray below it passed by. So it
//! is tested here, for each ray against earlier rays of its line, its possible *witnesses*, by the
//! slopes of the ground between them ([`steepness`]). Only where the ground is steeper than the two
//! rays allow, the ray is sampled: these are the *unproven intervals*.

mod recent;
pub(crate) mod steepness;
mod unproven;
mod witness;

pub(crate) use recent::Recent;
pub use steepness::Steepness;
pub use unproven::Unproven;

use crate::view::Ray;

/// Chooses the ray below from which a ray of a line takes its start.
///
/// [`Steepness`] is the rule for pictures: it proves the start. Other rules are for comparisons
/// ([`crate::Caster::draw_by`]).
pub trait StartRule: Sync {
    /// Whether rays rely on each other at all. If so, a ray without a witness skips blocks of
    /// ground that lie wholly below it, and exact rays try the facet that the ray below hit.
    const RELIES: bool;
    /// Whether a ray without a witness starts where it falls below the highest ground, instead of
    /// where it enters the ground's bounds.
    const STARTS_BELOW_TOP: bool;

    /// Of the candidates, nearest first, the one from which a ray takes its start, and the
    /// intervals before that start that it does not prove. `of`: a candidate's ray, and the
    /// parameter up to which it is in the air.
    fn find_witness<K>(
        &self,
        ray: &Ray,
        below: impl Iterator<Item = K>,
        of: impl Fn(&K) -> (&Ray, f32),
    ) -> Option<(K, Unproven)>;

    /// The slopes of the ground, if they are known: then exact rays follow it from facet to facet.
    fn slopes(&self) -> Option<&Steepness>;
}
