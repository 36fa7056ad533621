//! The command line of `terravision-ingest`, as typed and as checked.

use crate::body::BodyChoice;
use crate::error::IngestError;
use crate::job::{ColorQuality, Job};
use crate::plan::PlanOptions;
use crate::source::values::{NodataChoice, meters_in};
use crate::source::{Access, Region};
use crate::synth::SynthOptions;
use crate::synth::body::{BodyModel, SynthBodyOptions};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{ArgAction, Args, Parser, Subcommand};
use std::path::PathBuf;
use terravision_common::database::Voids;

/// Rasters to terrain databases, and a synthetic world.
#[derive(Debug, Parser)]
#[command(name = "terravision-ingest", version, propagate_version = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
    /// Log what is done to standard error: error, warn, info, debug, trace, or a filter [default:
    /// TERRAVISION_LOG]
    #[arg(long, global = true, value_name = "LEVEL|FILTER")]
    pub log: Option<String>,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Make a terrain database from elevation and colour rasters.
    ///
    /// Any raster that GDAL reads, one or many per layer. Where several have data the first one
    /// named is on top. Elevation that is in a projected system in metres keeps its own posts; all
    /// else is resampled. Without --color the ground shows a hypsometric tint with hill-shading.
    /// Nothing looks finished before it is: the manifest is written last, and an interrupted ingest
    /// can simply be run again.
    #[command(after_help = "Examples:\n  terravision ingest --elevation dem.tif --color ortho.tif -o valley.tv\n  \
        terravision ingest --elevation N46W122.hgt.zip N46W123.hgt.zip -o cascades.tv --crs EPSG:32610\n  \
        terravision ingest --elevation dem.tif --color landsat.tif --bands 3,2,1 -o scene.tv\n  \
        terravision ingest --elevation globe.tif --bounds 6.6,35.5,18.6,47.1 -o italy.tv")]
    Ingest(Box<IngestArgs>),
    /// Make a believable mountain world: dem.tif (float32) and ortho.tif (RGB, twice as fine), in
    /// UTM.
    ///
    /// Ridges, valleys, lakes, forest and snow lines, fields and roads. The same size, spacing and
    /// seed give the same files on every machine; any size that fits on disk is made in tiles, in
    /// little memory. With --body, a whole body over longitude and latitude.
    #[command(
        after_help = "Examples:\n  terravision synth -o w && terravision ingest --elevation w/dem.tif --color w/ortho.tif -o w.tv\n  \
        terravision synth --body moon:2880 -o m && terravision ingest --elevation m/dem.tif --color m/ortho.tif -o moon.tv"
    )]
    Synth(SynthArgs),
    /// Make a world for tests: a detailed square in a plain of any size, or (--bulk) gigabytes.
    #[command(hide = true)]
    Sparse(SparseArgs),
}

/// Arguments of `sparse`.
#[derive(Debug, Args)]
pub struct SparseArgs {
    /// Folder of the database
    #[arg(short, long, value_name = "WORLD")]
    pub output: PathBuf,
    /// Level 0 nodes along a side of the detailed square, a power of two
    #[arg(long, default_value_t = 32, value_name = "N")]
    pub detailed_nodes: u32,
    /// How often the side is doubled: 2 is 16 times the area, 4 is 256 times
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=10))]
    pub doublings: u8,
    /// Every colour tile has the one colour that names its node
    #[arg(long)]
    pub named: bool,
    /// For load tests, in place of the square: everywhere terrain and colours that take many bytes
    /// and little time, and no tile equal to another. They are made to be read, not to be looked at
    #[arg(long, conflicts_with = "named")]
    pub bulk: bool,
    /// Texels along the distance of two posts, a power of two
    #[arg(long, default_value_t = 2, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=16))]
    pub texels_per_post: u32,
}

/// Arguments of `ingest`, as typed.
#[derive(Debug, Args)]
pub struct IngestArgs {
    /// Elevation rasters; the first that has data at a place gives its height
    ///
    /// Files, folders and archives (zip, tar) of tiles, https:// and s3:// addresses, and every
    /// other name that GDAL opens, such as NETCDF:"a.nc":height.
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    elevation: Vec<PathBuf>,
    /// Colour rasters (grey, palette, RGB, with alpha or not); without them a tint is made from the
    /// elevation
    #[arg(long, num_args = 1.., value_name = "FILE")]
    color: Vec<PathBuf>,
    /// Folder of the database to make, by custom NAME.tv
    #[arg(short, long, value_name = "WORLD")]
    output: PathBuf,
    /// CRS of the database, projected and in metres: EPSG:N, WKT or a PROJ string. Default: that of
    /// the first elevation file if it is such, else the UTM zone of the data, else (large areas,
    /// other bodies) a plane around them
    #[arg(long, value_name = "CRS")]
    crs: Option<String>,
    /// CRS of files that have none
    #[arg(long, value_name = "CRS")]
    source_crs: Option<String>,
    /// Make a world of this part of the data alone: west, south, east, north, in degrees unless
    /// --bounds-crs tells. Across the date line west is the greater one: 170,-20,-170,-10
    #[arg(long, value_name = "W,S,E,N", allow_hyphen_values = true, value_parser = parse_bounds)]
    bounds: Option<Bounds>,
    /// CRS of --bounds: EPSG:N, WKT or a PROJ string
    #[arg(long, value_name = "CRS", requires = "bounds")]
    bounds_crs: Option<String>,
    /// Let files lead anywhere: sources of a VRT beyond its folder, and files that are lists of
    /// other files or descriptions of services though their names do not say so. Only for files
    /// whose origin you know
    #[arg(long)]
    trust_vrt: bool,
    /// Print what was made as JSON on standard output: the database, its layers, their sizes, notes
    /// and warnings
    #[arg(long)]
    pub json: bool,
    /// Most memory to use: larger caches read badly laid out files faster
    #[arg(long, default_value = "2GiB", value_name = "SIZE", value_parser = parse_size)]
    memory: u64,
    /// Replace a finished database
    #[arg(long)]
    overwrite: bool,
    /// Elevation value that means "no data", beside what files declare; "none": only what files
    /// declare, and values that look like undeclared "no data" are heights
    #[arg(long, value_name = "V", allow_hyphen_values = true, value_parser = parse_nodata)]
    nodata: Option<NodataChoice>,
    /// Unit of elevation when files do not say, or say it wrongly: m, ft, us-ft, …
    #[arg(long, value_name = "UNIT", value_parser = parse_unit)]
    elevation_unit: Option<f64>,
    /// Bands that show red, green and blue, counted from 1 (Landsat 7: 3,2,1)
    #[arg(long, value_name = "R,G,B", value_parser = parse_bands)]
    bands: Option<Bands>,
    /// Ground without data. fill: all of it is filled from around it. keep: it stays without
    /// ground, a hole. clip: what lies beyond all files, or is joined to an outer corner of one
    /// (the rim of a warped or rotated raster), has no ground; gaps within files are filled. Depth
    /// and ground pictures tell what was made up from what was measured
    #[arg(long, default_value = Voids::default().name(), value_name = "HOW", value_parser = voids_parser())]
    voids: Voids,
    /// Whether the crests of coarser levels are raised ('on') or filtered as all ground ('off').
    /// Filtered crests are lower, so that sky is seen where distant ridges should be. The finest
    /// level has the heights of the files in any case
    #[arg(long, action = ArgAction::Set, default_value = "on", value_name = "on|off", value_parser = on_parser())]
    crests: bool,
    /// How true colours are kept. 'best' takes half as many bytes again for colour, and slower loading,
    /// for flights and stills whose pictures are truer by 1 dB at '--quality best', by 0.4 dB by
    /// default. Heights are exact in any case
    #[arg(long, default_value = "default", value_name = "default|best", value_parser = quality_parser())]
    quality: ColorQuality,
    /// Quality of colour tiles (JPEG), 1 to 100, in place of that of --quality (90, or 95 for 'best'):
    /// higher is larger and slower to load
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=100))]
    color_quality: Option<u8>,
    /// Distance of elevation posts, metres. Default: that of the finest elevation file
    #[arg(long, value_name = "METRES", value_parser = parse_positive)]
    spacing: Option<f64>,
    /// Make a whole body of rasters over longitude and latitude, whose samples stay where they are:
    /// earth, mars, moon, mercury, venus, titan, or semi-major axis (metres) and flattening. Without it
    /// the CRS of the elevation names the body, when it goes all around and from pole to pole
    #[arg(long, value_name = "BODY|A,F", value_parser = BodyChoice::parse, conflicts_with_all = ["geographic", "plane"])]
    body: Option<BodyChoice>,
    /// Make a whole body, of the ellipsoid that the CRS of the elevation names
    #[arg(long, conflicts_with = "plane")]
    geographic: bool,
    /// Make a plane, also of elevation that covers a whole body
    #[arg(long)]
    plane: bool,
    /// Threads. Default: all cores. The result is the same for any number
    #[arg(long, value_name = "N", value_parser = parse_threads)]
    threads: Option<usize>,
    /// Intervals along an elevation tile's side, a power of two
    #[arg(long, default_value_t = PlanOptions::default().elevation_tile, value_name = "N", hide = true)]
    elevation_tile: u32,
    /// Texels along a colour tile's side, a power of two
    #[arg(long, default_value_t = PlanOptions::default().color_tile, value_name = "N", hide = true)]
    color_tile: u32,
}

/// West, south, east, north.
#[derive(Debug, Clone, Copy)]
struct Bounds([f64; 4]);

/// Three bands.
#[derive(Debug, Clone, Copy)]
struct Bands([usize; 3]);

impl IngestArgs {
    /// Checks what belongs together.
    ///
    /// # Errors
    /// [`IngestError::Usage`].
    pub fn validate(self) -> Result<Job, IngestError> {
        let sizes = [("--elevation-tile", self.elevation_tile, 2..=256), ("--color-tile", self.color_tile, 16..=1024)];
        for (flag, size, range) in sizes {
            if !size.is_power_of_two() || !range.contains(&size) {
                let (first, last) = (range.start(), range.end());
                return Err(IngestError::usage(format!(
                    "{flag} is {size}, expected a power of two from {first} to {last}"
                )));
            }
        }
        let region = self.bounds.map(|b| Region::new(b.0, self.bounds_crs.as_deref())).transpose()?;
        let job = Job::new(self.elevation, self.color, self.output);
        Ok(Job {
            region,
            access: Access { trusts_links: self.trust_vrt },
            crs: self.crs,
            source_crs: self.source_crs,
            memory_bytes: self.memory,
            may_overwrite: self.overwrite,
            nodata: self.nodata.unwrap_or(NodataChoice::FromFiles),
            elevation_unit_m: self.elevation_unit,
            bands: self.bands.map(|b| b.0),
            color_quality: self.color_quality.unwrap_or(self.quality.jpeg()),
            threads: self.threads.unwrap_or(job.threads),
            plan: PlanOptions {
                elevation_tile: self.elevation_tile,
                color_tile: self.color_tile,
                spacing_m: self.spacing,
            },
            voids: self.voids,
            raises_crests: self.crests,
            body: match (self.body, self.geographic, self.plane) {
                (Some(body), ..) => body,
                (None, true, _) => BodyChoice::Geographic,
                (None, false, true) => BodyChoice::Plane,
                (None, false, false) => BodyChoice::Auto,
            },
            ..job
        })
    }
}

/// Arguments of `synth`, as typed.
#[derive(Debug, Args)]
pub struct SynthArgs {
    /// Folder for dem.tif and ortho.tif
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Intervals along a side: the DEM has one post more, the orthophoto twice as many pixels
    #[arg(long, default_value_t = 4096, value_name = "N", value_parser = clap::value_parser!(u32).range(16..=1 << 20))]
    size: u32,
    /// Distance of DEM posts, metres
    #[arg(long, default_value_t = 10.0, value_name = "METRES", value_parser = parse_positive)]
    spacing: f64,
    /// Make a whole body: earth, mars or moon, with this many samples around (default: 1440)
    #[arg(long, value_name = "BODY[:COLUMNS]", value_parser = parse_body, conflicts_with_all = ["size", "spacing"])]
    body: Option<SynthBody>,
    /// Another number, another world
    #[arg(long, default_value_t = 1, value_name = "N")]
    seed: u64,
    /// Threads. Default: all cores. The result is the same for any number
    #[arg(long, value_name = "N", value_parser = parse_threads)]
    threads: Option<usize>,
    /// Replace dem.tif and ortho.tif that are there
    #[arg(long)]
    overwrite: bool,
}

/// What `synth` makes.
#[derive(Debug, Clone)]
pub enum SynthJob {
    /// A mountain world on a plane.
    Plane(SynthOptions),
    /// A whole body.
    Body(SynthBodyOptions),
}

/// A body and its number of columns.
#[derive(Debug, Clone, Copy)]
struct SynthBody(BodyModel, u32);

impl SynthArgs {
    /// Checks what belongs together.
    ///
    /// # Errors
    /// [`IngestError::Usage`].
    pub fn validate(self) -> Result<SynthJob, IngestError> {
        let threads = self.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
        if let Some(SynthBody(model, columns)) = self.body {
            return Ok(SynthJob::Body(SynthBodyOptions {
                output: self.output,
                model,
                columns,
                seed: self.seed,
                threads,
                may_overwrite: self.overwrite,
            }));
        }
        let span = f64::from(self.size) * self.spacing;
        if !(self.spacing >= 0.1 && span <= 4.0e7) {
            return Err(IngestError::usage(format!(
                "a world of {span} m at a spacing of {} m cannot be made, expected a spacing of at least 0.1 m and a side \
                 of at most 40000 km",
                self.spacing
            )));
        }
        Ok(SynthJob::Plane(SynthOptions {
            output: self.output,
            size: self.size,
            spacing_m: self.spacing,
            seed: self.seed,
            threads,
            may_overwrite: self.overwrite,
        }))
    }
}

/// Bytes in "2GiB", "512M", "1.5 GB", "1073741824".
///
/// # Errors
/// A sentence.
pub fn parse_size(text: &str) -> Result<u64, String> {
    let text = text.trim();
    let split = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let (number, unit) = text.split_at(split);
    let factor = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kib" => 1024.0,
        "kb" => 1e3,
        "m" | "mib" => 1024.0 * 1024.0,
        "mb" => 1e6,
        "g" | "gib" => 1024.0 * 1024.0 * 1024.0,
        "gb" => 1e9,
        "t" | "tib" => 1024f64.powi(4),
        "tb" => 1e12,
        _ => return Err(format!("{text} is not a size: expected a number with a unit such as 512MiB or 2GiB")),
    };
    match number.parse::<f64>() {
        Ok(number) if number * factor < 1e18 => Ok((number * factor) as u64),
        _ => Err(format!("{text} is not a size: expected a number with a unit such as 512MiB or 2GiB")),
    }
}

fn parse_body(text: &str) -> Result<SynthBody, String> {
    let (name, columns) = text.split_once(':').unwrap_or((text, "1440"));
    let columns = columns.trim().parse::<u32>().ok().filter(|n| (256..=1 << 20).contains(n) && n.is_multiple_of(2));
    match (BodyModel::named(name.trim()), columns) {
        (Some(model), Some(columns)) => Ok(SynthBody(model, columns)),
        (None, _) => Err(format!("{name} is not a body that can be made: expected earth, mars or moon")),
        (_, None) => {
            Err(format!("{text} does not give an even number of columns from 256 to 1048576, such as moon:2880"))
        }
    }
}

fn parse_nodata(text: &str) -> Result<NodataChoice, String> {
    if text.eq_ignore_ascii_case("none") {
        return Ok(NodataChoice::OnlyDeclared);
    }
    let value = text.parse::<f64>().map_err(|e| format!("{text} is neither a number nor \"none\" ({e})"))?;
    Ok(NodataChoice::Value(value))
}

fn parse_unit(text: &str) -> Result<f64, String> {
    meters_in(text).ok_or_else(|| format!("{text} is not a known unit of length: expected m, ft, us-ft, km, cm, mm"))
}

fn parse_bands(text: &str) -> Result<Bands, String> {
    let bands: Vec<usize> = text.split(',').filter_map(|b| b.trim().parse().ok()).filter(|b| *b > 0).collect();
    match (bands.as_slice(), text.split(',').count()) {
        ([red, green, blue], 3) => Ok(Bands([*red, *green, *blue])),
        _ => Err(format!("{text} does not name three bands, expected for example 3,2,1")),
    }
}

fn parse_bounds(text: &str) -> Result<Bounds, String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|n| n.trim().parse().ok()).collect();
    match (<[f64; 4]>::try_from(numbers), text.split(',').count()) {
        (Ok(bounds), 4) => Ok(Bounds(bounds)),
        _ => Err(format!("{text} is not four numbers, expected W,S,E,N, for example 6.6,35.5,18.6,47.1")),
    }
}

fn voids_parser() -> impl TypedValueParser<Value = Voids> {
    let all = [Voids::Fill, Voids::Keep, Voids::Clip];
    PossibleValuesParser::new(all.map(Voids::name))
        .map(move |name| all.into_iter().find(|voids| voids.name() == name).unwrap_or_default())
}

fn quality_parser() -> impl TypedValueParser<Value = ColorQuality> {
    PossibleValuesParser::new(["default", "best"])
        .map(|name| if name == "best" { ColorQuality::Best } else { ColorQuality::Default })
}

fn on_parser() -> impl TypedValueParser<Value = bool> {
    PossibleValuesParser::new(["on", "off"]).map(|text| text == "on")
}

fn parse_positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err(format!("{text} is not a positive number")),
    }
}

fn parse_threads(text: &str) -> Result<usize, String> {
    match text.parse::<usize>() {
        Ok(count @ 1..=1024) => Ok(count),
        _ => Err(format!("{text} is not a number of threads from 1 to 1024")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_with_and_without_units() {
        assert_eq!(parse_size("2GiB"), Ok(2 << 30));
        assert_eq!(parse_size("1.5G"), Ok(3 << 29));
        assert_eq!(parse_size("800 MB"), Ok(800_000_000));
        assert_eq!(parse_size("4096"), Ok(4096));
        assert!(parse_size("much").is_err() && parse_size("1e99GiB").is_err() && parse_size("-1M").is_err());
    }

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }

    #[test]
    fn bodies_by_name_and_by_numbers() {
        assert!(matches!(BodyChoice::parse("Mars"), Ok(BodyChoice::Body { name: Some("Mars"), .. })));
        let body = BodyChoice::parse("3396190,0.00589");
        assert!(matches!(body, Ok(BodyChoice::Body { flattening, .. }) if (flattening - 0.00589).abs() < 1e-12));
        for text in ["pluto", "1,2,3", "3396190,0.9", "-5,0", "nan,nan"] {
            assert!(BodyChoice::parse(text).is_err(), "{text}");
        }
        assert!(parse_body("moon:2880").is_ok() && parse_body("earth").is_ok());
        for text in ["moon:7", "moon:257", "venus", "moon:x", "mars:99999999999"] {
            assert!(parse_body(text).is_err(), "{text}");
        }
    }

    #[test]
    fn negative_nodata_is_no_flag() {
        let cli =
            Cli::try_parse_from(["x", "ingest", "--elevation", "a.tif", "-o", "w.tv", "--nodata", "-9999"]).unwrap();
        let Verb::Ingest(args) = cli.verb else { panic!("ingest was asked for") };
        assert_eq!(args.validate().unwrap().nodata, NodataChoice::Value(-9999.0));
    }
}
