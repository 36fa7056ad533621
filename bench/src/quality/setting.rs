//! What pictures are drawn with: a technique and how fine it draws.

/// How pictures are drawn, and how far nearly all of their land may be from where it should be.
#[derive(Debug, Clone)]
pub(super) struct Setting {
    pub(super) name: &'static str,
    /// Part of the names of files.
    pub(super) file: &'static str,
    pub(super) quality: &'static str,
    /// More arguments of `terravision still` and `fly`.
    pub(super) arguments: &'static [&'static str],
    /// The goal, pixels.
    pub(super) most_px: f64,
}

/// Goals by default and at best, pixels.
const GOALS_PX: [f64; 2] = [2.0, 1.0];

impl Setting {
    const fn by_default(name: &'static str, file: &'static str, arguments: &'static [&'static str]) -> Self {
        Self { name, file, quality: "default", arguments, most_px: GOALS_PX[0] }
    }

    const fn at_best(name: &'static str, file: &'static str, arguments: &'static [&'static str]) -> Self {
        Self { name, file, quality: "best", arguments, most_px: GOALS_PX[1] }
    }
}

/// What `fly` draws with by itself.
pub(super) const USUAL: &[Setting] =
    &[Setting::by_default("default", "default", &[]), Setting::at_best("best", "best", &[])];

const MESH: &[&str] = &["--technique", "mesh"];
const MIPMAP: &[&str] = &["--technique", "rays", "--rays", "mipmap"];
const COHERENT: &[&str] = &["--technique", "rays", "--rays", "coherent"];
const SWEEP: &[&str] = &["--technique", "rays", "--rays", "sweep"];

/// All techniques that draw without a GPU.
pub(super) const TECHNIQUES: &[Setting] = &[
    Setting::by_default("mesh, default", "mesh-default", MESH),
    Setting::at_best("mesh, best", "mesh-best", MESH),
    Setting::by_default("rays mipmap, default", "mipmap-default", MIPMAP),
    Setting::by_default(
        "rays mipmap, --facet-px 5",
        "mipmap-5px",
        &["--technique", "rays", "--rays", "mipmap", "--facet-px", "5"],
    ),
    Setting::at_best("rays mipmap, best", "mipmap-best", MIPMAP),
    Setting::by_default("rays coherent, default", "coherent-default", COHERENT),
    Setting::by_default("sweep, default", "sweep-default", SWEEP),
    Setting::at_best("sweep, best", "sweep-best", SWEEP),
];
