//! Runs that no launcher has planned, for tests and benches of what is told one.

use terravision_common::level::Measure;
use terravision_common::run::{
    DatabaseConfig, PrefetchConfig, RaysChoice, RenderConfig, RunConfig, SinkConfig, TechniqueChoice,
};
use terravision_common::texels::TexelFormat;

/// An exact run of these frames, the first and one past the last, over a database that is not
/// there: a mesh of 640 x 360 pixels with facets of 10 pixels and texels of 1, drawn for nobody.
///
/// ```
/// use terravision_common::run::RunConfig;
/// use terravision_testkit::runs;
///
/// let coarser = RunConfig { r_z_px: 24.0, ..runs::config([30, 50]) };
/// assert_eq!(coarser.frame_numbers().start.get(), 30);
/// ```
#[must_use]
pub fn config(frames: [u64; 2]) -> RunConfig {
    RunConfig {
        run_id: "tv-1-1".to_owned(),
        world: "/nowhere".into(),
        database: DatabaseConfig::folder("/nowhere".as_ref()),
        width: 640,
        height: 360,
        fps: 30.0,
        frames,
        r_z_px: 10.0,
        r_c_px: 1.0,
        measure: Measure::Area,
        exaggeration: 1.0,
        texels: TexelFormat::Rgba8,
        decoder_threads: 1,
        prefetch: PrefetchConfig::EXACT,
        light: None,
        render: RenderConfig {
            technique: TechniqueChoice::Mesh,
            technique_reason: "asked for".to_owned(),
            rays: RaysChoice::Mipmap,
            sky_rgb: [0; 3],
            air: None,
            samples: 1,
            skirt_low_m: None,
            has_tree_overlay: false,
            has_validation: false,
            frames_in_flight: 2,
            sink: SinkConfig::Null,
            depth: Vec::new(),
            ground: Vec::new(),
            share: None,
            window: None,
            made_up: Default::default(),
            labels: None,
            vehicles: None,
            anaglyph: false,
        },
        realtime: None,
        rig: None,
    }
}
