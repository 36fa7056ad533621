//! How the picture is made, as typed.

use super::light::LightArgs;
use super::planes::PLANES_HEADING;
use super::stereo::StereoArgs;
use super::technique::{CompressionArg, MadeUpArg, MeasureChoice, RaysArg, TechniqueArg};
use super::values::{self, PictureSize, Rgb};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Heading of the flags about how fine the ground is drawn, and by what.
const DETAIL_HEADING: &str = "Quality and technique (docs/techniques.md)";

/// How the picture is made; shared by `fly` and `still`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Picture")]
pub struct PictureArgs {
    /// Width and height of the picture, pixels [default: the path's own, else 1280x720]
    #[arg(long, value_name = "WxH")]
    pub size: Option<PictureSize>,
    /// Draw several cameras that the pose carries, as this file says: a stereo pair, a cube, the
    /// cameras of a drone
    ///
    /// All of them are drawn from one tree, into one picture or into a picture each. --size and
    /// --vfov, or the path, are for views that have none of their own. The format, with examples:
    /// docs/views.md.
    #[arg(long, value_name = "FILE.json")]
    pub views: Option<PathBuf>,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub stereo: StereoArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub light: LightArgs,
    /// Vertical field of view, degrees [default: the path's own, else 60, which is 91.5 across at
    /// 16:9]
    #[arg(long, value_name = "DEGREES", conflicts_with = "hfov")]
    pub vfov: Option<f64>,
    /// Horizontal field of view, degrees, in place of --vfov
    #[arg(long, value_name = "DEGREES")]
    pub hfov: Option<f64>,
    /// Colour of the sky, three numbers from 0 to 255 or #RRGGBB [default: the path's own, else the
    /// body's: 150,190,235 on Earth, butterscotch on Mars, black on the Moon]
    #[arg(long, value_name = "R,G,B")]
    pub sky: Option<Rgb>,
    /// Factor on all heights of the terrain: 2 draws mountains twice as high
    ///
    /// The height of the camera does not change.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, allow_negative_numbers = true)]
    pub exaggeration: f64,
    /// What is drawn where the world ends, for an eye beside it
    #[arg(long, value_enum, value_name = "HOW", default_value_t = Edge::Skirt)]
    pub edge: Edge,
    /// Draw the leaves of the quad tree over the picture
    #[arg(long, value_enum, value_name = "WHAT")]
    pub overlay: Option<Overlay>,
    /// A preset of --facet-px and --samples [default: default; still: finest]
    ///
    /// 'default' draws facets of 10 pixels, or of 3 by a sweep (7 by '--rays coherent'), with one
    /// sample per pixel. 'best' draws facets of 3 pixels, or of 1.4 by a sweep, with four samples:
    /// nearer to the true picture, at several times the cost. 'finest' draws facets of 1 pixel
    /// (larger ones above 1920x1080, where there would be too many) with four samples: what a pixel
    /// shows is right to the pixel. Rays have one sample. --facet-px and --samples win over the
    /// preset.
    #[arg(long, help_heading = DETAIL_HEADING, value_enum, overrides_with = "quality")]
    pub quality: Option<Quality>,
    /// How the ground is drawn [default: mesh where there is a GPU, else rays]
    ///
    /// 'mesh' draws triangles with a Vulkan device, also one in software. 'rays' casts one ray per
    /// pixel, on the processor and without a device, or with '--rays compute' on the device. All of
    /// them draw the same surface (docs/techniques.md). 'terravision doctor' says what is taken
    /// here. --samples 4, --texture-compression on and --validation take the mesh.
    #[arg(long, help_heading = DETAIL_HEADING, value_enum, value_name = "WHICH")]
    pub technique: Option<TechniqueArg>,
    /// How rays are cast [default: sweep]
    ///
    /// --rays implies '--technique rays'. 'auto' uses 'compute' in real time where there is a GPU.
    /// Without one it begins with 'mipmap', tries 'coherent' on one of the first frames without
    /// showing it, goes on with the faster of the two, and says which. In exact mode 'auto' is
    /// always 'mipmap', so that pictures do not depend on the speed of the machine.
    #[arg(long, help_heading = DETAIL_HEADING, value_enum, value_name = "HOW")]
    pub rays: Option<RaysArg>,
    /// Wanted size of the terrain's facets on screen, pixels [default: 10, of a sweep 3; best: 3, of
    /// a sweep 1.4; finest, which still has: 1]
    ///
    /// It is the side of a square with a facet's area, where the ground faces the camera. Smaller
    /// facets show finer relief and cost more: half the size takes the mesh four times as long, a
    /// sweep at most twice as long.
    #[arg(long, help_heading = DETAIL_HEADING, value_name = "PIXELS")]
    pub facet_px: Option<f64>,
    /// Wanted size of the colour texels on screen, pixels [default: 1]
    ///
    /// Smaller texels are sharper, as far as the source is, and need more tiles; larger ones blur
    /// and load less.
    #[arg(long, help_heading = DETAIL_HEADING, value_name = "PIXELS")]
    pub texel_px: Option<f64>,
    /// Samples per pixel: 1, or 4 for smooth edges, by the mesh [default: 1; best, finest: 4]
    #[arg(long, help_heading = DETAIL_HEADING, value_name = "1|4", value_parser = values::parse_samples)]
    pub samples: Option<u32>,
    /// How the size of a facet or texel on screen is measured where the ground is seen at a
    /// glancing angle
    #[arg(long, help_heading = DETAIL_HEADING, value_enum, default_value_t = MeasureChoice::Max)]
    pub measure: MeasureChoice,
    /// Whether colour tiles are compressed in memory
    ///
    /// A compressed tile (BC1) takes an eighth of the memory, here and on the device, so that
    /// --memory holds more of them. The picture loses a little (docs/quality.md), and loading a
    /// tile takes longer. The database does not change. A software device (lavapipe) is slower with
    /// compressed tiles, so 'auto' does not compress there. 'on' is an error where no device can do
    /// it. Frames are the same on every run either way.
    #[arg(long, help_heading = DETAIL_HEADING, value_enum, value_name = "WHEN", default_value_t = CompressionArg::Auto)]
    pub texture_compression: CompressionArg,
    /// What --depth and --ground have where the sources had no data, so that the ground was made up
    /// from its surroundings
    ///
    /// 'nan' writes NaN, as for sky. 'mark' writes the values that are drawn, and adds a band to
    /// files: 1 where the ground was measured, 0 where it was made up. Shared frames have such a
    /// mark either way (docs/frame-ring.md).
    #[arg(long, help_heading = PLANES_HEADING, display_order = 999, value_enum, value_name = "HOW", default_value_t = MadeUpArg::Nan)]
    pub made_up: MadeUpArg,
}

/// A preset of how fine the picture is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Quality {
    /// Facets of 10 pixels, or of 3 by a sweep, one sample a pixel
    Default,
    /// Facets of 3 pixels, or of 1.4 by a sweep, four samples a pixel
    Best,
    /// Facets of 1 pixel, four samples a pixel
    Finest,
}

/// What is drawn where the world ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Edge {
    /// Plain walls down to the world's lowest height, and a floor there
    Skirt,
    /// Nothing: the ground is a sheet
    None,
}

/// What is drawn over the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Overlay {
    /// The leaves of the quad tree
    Tree,
}
