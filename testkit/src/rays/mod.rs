//! Rays to compare with: the paper's, which prove nothing, and plain ones, which take nothing over.

mod field;
mod pool;

pub use field::{Field, UNIT_M, camera, noise};
pub use pool::PooledField;

use terravision_raycast::view::Ray;
use terravision_raycast::{CastOptions, CastTask, Caster, Counts, Method, StartRule, Steepness, Unproven};

/// A way of casting rays: one of the program's, or one to compare with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AnyMethod {
    /// [`Method::Coherent`].
    Coherent,
    /// The same samples, every ray from where it comes below the top of the ground: plain ray
    /// casting.
    Plain,
    /// The same samples, every ray from where it comes over the ground, however high above it: what
    /// the paper compares with.
    FromEye,
    /// As [`AnyMethod::Coherent`], a ray always taking over the start of the one below it, as
    /// forward-only methods do: misses ground beside cliffs.
    ForwardOnly,
    /// [`Method::Mipmap`].
    Mipmap,
    /// The same, every ray from where it comes below the top of the ground.
    PlainMipmap,
    /// [`Method::Sweep`].
    Sweep,
}

impl AnyMethod {
    /// Draws a picture with [`Caster::draw`], its options but for the method.
    pub fn draw(self, caster: &mut Caster, task: &CastTask<'_>) -> Counts {
        let method = match self {
            Self::Coherent | Self::Plain | Self::FromEye | Self::ForwardOnly => Method::Coherent,
            Self::Mipmap | Self::PlainMipmap => Method::Mipmap,
            Self::Sweep => Method::Sweep,
        };
        let options = CastOptions { method, ..*task.options };
        let task = CastTask { options: &options, ..*task };
        match self {
            Self::Coherent | Self::Mipmap | Self::Sweep => caster.draw(&task),
            Self::Plain | Self::PlainMipmap => caster.draw_by(&Plain::<true>, &task),
            Self::FromEye => caster.draw_by(&Plain::<false>, &task),
            Self::ForwardOnly => caster.draw_by(&ForwardOnly, &task),
        }
    }
}

/// No ray takes anything over from another one: each starts where it comes below the top of the
/// ground, or where it comes over the ground.
#[derive(Debug)]
struct Plain<const STARTS_BELOW_TOP: bool>;

impl<const BELOW_TOP: bool> StartRule for Plain<BELOW_TOP> {
    const RELIES: bool = false;
    const STARTS_BELOW_TOP: bool = BELOW_TOP;

    fn find_witness<K>(
        &self,
        _ray: &Ray,
        _below: impl Iterator<Item = K>,
        _of: impl Fn(&K) -> (&Ray, f32),
    ) -> Option<(K, Unproven)> {
        None
    }

    fn slopes(&self) -> Option<&Steepness> {
        None
    }
}

/// A ray takes over the start of the one below it, whatever the ground between them.
#[derive(Debug)]
struct ForwardOnly;

impl StartRule for ForwardOnly {
    const RELIES: bool = true;
    const STARTS_BELOW_TOP: bool = true;

    fn find_witness<K>(
        &self,
        _ray: &Ray,
        mut below: impl Iterator<Item = K>,
        _of: impl Fn(&K) -> (&Ray, f32),
    ) -> Option<(K, Unproven)> {
        below.next().map(|nearest| (nearest, Unproven::NONE))
    }

    fn slopes(&self) -> Option<&Steepness> {
        None
    }
}
