//! The manifest: what a database is, and the checksums of its other files.

use crate::files::read_bounded;
use crate::lonlat::LonLatTable;
use crate::tint::HeightColors;
use crate::world::{World, WorldError, WorldFields};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::io;
use std::path::Path;

/// Version of the format of a database without special features.
pub const FORMAT_VERSION: u32 = 1;
/// Version of the format of a database with features that a reader must know
/// ([`ManifestFields::features`]); the newest version that this build reads.
pub const FEATURES_VERSION: u32 = 2;
/// The feature of a database whose elevation tiles record which posts are ground and which were
/// measured ([`crate::validity`]).
pub const FEATURE_VALIDITY: &str = "validity";
/// The feature of a database whose finest levels exist only where there are data.
pub const FEATURE_SPARSE_LEVELS: &str = "sparse-levels";
/// The feature of a database of a whole body, over longitudes and latitudes
/// ([`crate::world::BodyGrid`]).
pub const FEATURE_BODY: &str = "body";
/// The features that this build knows.
const FEATURES: &[&str] = &[FEATURE_VALIDITY, FEATURE_SPARSE_LEVELS, FEATURE_BODY];
const FORMAT: &str = "terravision-database";
/// Upper bound of the size of a manifest, which lists source files.
pub const MOST_MANIFEST_BYTES: u64 = 16 << 20;

/// Why a manifest cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ManifestError {
    /// It is another kind of file.
    #[error("it is not the manifest of a terrain database")]
    NotAManifest,
    /// It was written by a newer (or a much older) TerraVision.
    #[error(
        "the database has format version {found}, this program reads versions up to {expected}; use the TerraVision that wrote it, or ingest again"
    )]
    Version {
        /// What this build reads.
        expected: u32,
        /// What it has.
        found: u64,
    },
    /// It has a feature that this build does not know.
    #[error(
        "the database has the feature \"{}\", which this program does not know; use a newer TerraVision, or ingest again",
        found.escape_default()
    )]
    Feature {
        /// What.
        found: String,
    },
    /// It has changed since it was written.
    #[error("its checksum is {found:08x}, expected {expected:08x}: it was changed or damaged after ingest")]
    Checksum {
        /// What it says.
        expected: u32,
        /// What its bytes give.
        found: u32,
    },
    /// It lacks a field, or has an invalid one.
    #[error("it does not have the right content ({source})")]
    Content {
        /// What and where.
        #[source]
        source: serde_json::Error,
    },
    /// Its features do not fit its world.
    #[error("its features and its world disagree: {what}")]
    Features {
        /// How.
        what: &'static str,
    },
    /// Its world is not valid.
    #[error("its world is wrong: {source}")]
    World {
        /// What is wrong.
        #[source]
        source: WorldError,
    },
}

/// Coordinate reference system of a database.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Crs {
    /// For people.
    pub name: String,
    /// EPSG code, when it has one.
    pub epsg: Option<u32>,
    /// The full definition, WKT (version 1 or 2).
    pub wkt: String,
    /// PROJ string of it, if there is one: lets programs without GDAL bring other coordinates into
    /// it.
    #[serde(default)]
    pub proj4: Option<String>,
}

/// The body whose terrain it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Its name, as far as the CRS tells: "Earth", "Mars", …
    pub name: String,
    /// Semi-major axis of its ellipsoid, metres.
    pub radius_m: f64,
}

/// One source file of a layer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// File name, without folders.
    pub file: String,
    /// Columns and rows.
    pub size: [usize; 2],
    /// Name of its CRS.
    pub crs: String,
    /// Type of its samples, as GDAL names it.
    pub data_type: String,
    /// The value that means "no data", if there is one (as text, because it may be NaN).
    pub nodata: Option<String>,
    /// Whether its samples were taken on its own lattice, without resampling.
    pub is_exact: bool,
}

/// Length and checksum of a tile archive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArchiveRecord {
    /// Length of the file.
    pub bytes: u64,
    /// crc32 of header, root directory, metadata and leaf directories; tiles carry their own.
    pub index_crc32: u32,
    /// Number of tiles, counting identical ones separately.
    pub tiles: u64,
}

/// Length and checksum of the file of height ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NodesRecord {
    /// Length of the file.
    pub bytes: u64,
    /// crc32 of all of it.
    pub crc32: u32,
}

/// How ground without data was handled.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VoidsRecord {
    /// The requested mode.
    pub mode: Voids,
    /// Area without data that is a hole, square metres; the rest was filled from its surroundings.
    pub hole_area_m2: f64,
}

/// How ground without data is handled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Voids {
    /// All of it is filled from its surroundings.
    Fill,
    /// It becomes a hole.
    Keep,
    /// Areas beyond all files, or connected to an outer corner of a file, become holes; the rest is
    /// filled.
    #[default]
    Clip,
}

impl Voids {
    /// Its name on the command line and in the manifest.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fill => "fill",
            Self::Keep => "keep",
            Self::Clip => "clip",
        }
    }
}

/// The elevation pyramid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElevationLayer {
    /// Its sources, the topmost first.
    pub sources: Vec<Source>,
    /// Spacing of posts on the finest level, metres.
    pub spacing_m: f64,
    /// Lowest and highest height in the finest level, metres.
    pub range_m: [f64; 2],
    /// Lowest and highest sample of the sources over the world, metres; absent when the finest
    /// level has the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source_range_m: Option<[f64; 2]>,
    /// Area without data, square metres. Its heights were interpolated from its surroundings, also
    /// in holes.
    pub void_area_m2: f64,
    /// How that area was handled, if there is any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voids: Option<VoidsRecord>,
    /// How tiles are encoded.
    pub encoding: String,
    /// Its file.
    pub archive: ArchiveRecord,
}

/// The colour pyramid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColorLayer {
    /// Its sources, the topmost first; empty when it is a tint made from elevation.
    pub sources: Vec<Source>,
    /// Spacing of texels on the finest level, metres.
    pub spacing_m: f64,
    /// How such a tint was made; absent beside sources.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tint: Option<HeightColors>,
    /// Area without data that shows the tint, square metres.
    pub void_area_m2: f64,
    /// How tiles are encoded: "jpeg".
    pub encoding: String,
    /// Quality of that encoding, 1 to 100.
    pub quality: u8,
    /// Its file.
    pub archive: ArchiveRecord,
}

/// What a manifest says, unchecked: the file, field by field, in its order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ManifestFields {
    /// Always "terravision-database".
    pub format: String,
    /// Version of the format: [`FEATURES_VERSION`] if there are features, otherwise
    /// [`FORMAT_VERSION`].
    pub format_version: u32,
    /// Features beyond version 1 that a reader must know.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub features: Vec<String>,
    /// The finest level from which on all nodes exist; absent without sparse levels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub complete_level: Option<u8>,
    /// The program that wrote it.
    pub written_by: String,
    /// The database's name: its folder's, without ".tv".
    pub name: String,
    /// Its coordinate reference system: in metres, of a body in degrees.
    pub crs: Crs,
    /// How longitudes and latitudes are converted to it, if its PROJ string alone does not say so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lonlat: Option<LonLatTable>,
    /// The body.
    pub body: Body,
    /// The geometry.
    pub world: WorldFields,
    /// Always "metre".
    pub vertical_unit: String,
    /// Elevation.
    pub elevation: ElevationLayer,
    /// Colour.
    pub color: ColorLayer,
    /// Height ranges of nodes.
    pub nodes: NodesRecord,
    /// crc32, as 8 hexadecimal digits, of the manifest's text with eight zeros in their place.
    pub checksum: String,
}

/// What a terrain database is: a manifest that this build can read, of a world that can be. Valid
/// by construction.
#[derive(Debug, Clone, PartialEq)]
pub struct Manifest {
    fields: ManifestFields,
    world: World,
}

/// The fields that determine which reader a manifest needs.
#[derive(Deserialize)]
struct Head<'a> {
    #[serde(borrow, default)]
    format: Option<Cow<'a, str>>,
    #[serde(default)]
    format_version: Option<u64>,
    #[serde(default)]
    features: FewNames,
}

/// A short list of names: at most as many as there are features.
#[derive(Default)]
struct FewNames(Vec<String>);

impl FewNames {
    const MOST: usize = 16;
}

impl<'de> Deserialize<'de> for FewNames {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Names;
        impl<'de> serde::de::Visitor<'de> for Names {
            type Value = FewNames;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                write!(f, "at most {} names", FewNames::MOST)
            }

            fn visit_seq<A: serde::de::SeqAccess<'de>>(self, mut names: A) -> Result<FewNames, A::Error> {
                let mut all = FewNames::default();
                while let Some(name) = names.next_element()? {
                    if all.0.len() == FewNames::MOST {
                        return Err(serde::de::Error::invalid_length(FewNames::MOST + 1, &self));
                    }
                    all.0.push(name);
                }
                Ok(all)
            }
        }
        deserializer.deserialize_seq(Names)
    }
}

/// The position of the eight digits of the checksum in the text.
fn checksum_place(text: &str) -> Option<std::ops::Range<usize>> {
    let key = "\"checksum\": \"";
    let start = text.rfind(key)? + key.len();
    text.get(start..start + 8)?;
    Some(start..start + 8)
}

fn checksum_of(text: &str, place: &std::ops::Range<usize>) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&text.as_bytes()[..place.start]);
    hasher.update(b"00000000");
    hasher.update(&text.as_bytes()[place.end..]);
    hasher.finalize()
}

fn check_features(features: &[String]) -> Result<(), ManifestError> {
    let unknown = features.iter().find(|feature| !FEATURES.contains(&feature.as_str()));
    unknown.map_or(Ok(()), |found| Err(ManifestError::Feature { found: found.clone() }))
}

pub(crate) fn read_text(path: &Path) -> io::Result<String> {
    let text = read_bounded(path, MOST_MANIFEST_BYTES)?;
    String::from_utf8(text).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error.utf8_error()))
}

impl Manifest {
    /// Parses the text of a manifest.
    ///
    /// # Errors
    /// [`ManifestError`]: the version is checked first, to distinguish a newer database from a
    /// damaged one.
    pub fn parse(text: &str) -> Result<Self, ManifestError> {
        // Unknown fields are skipped, not stored: a text of 16 MB must not become a gigabyte of
        // values.
        let head: Head<'_> = match serde_json::from_str(text) {
            Ok(head) => head,
            Err(error) if error.is_data() => return Err(ManifestError::NotAManifest),
            Err(source) => return Err(ManifestError::Content { source }),
        };
        if head.format.as_deref() != Some(FORMAT) {
            return Err(ManifestError::NotAManifest);
        }
        match head.format_version {
            Some(found) if (FORMAT_VERSION.into()..=FEATURES_VERSION.into()).contains(&found) => {}
            Some(found) => return Err(ManifestError::Version { expected: FEATURES_VERSION, found }),
            None => return Err(ManifestError::NotAManifest),
        }
        // Before all other fields, which may be new with a feature.
        check_features(&head.features.0)?;
        let fields: ManifestFields = serde_json::from_str(text).map_err(|source| ManifestError::Content { source })?;
        let place = checksum_place(text).ok_or(ManifestError::NotAManifest)?;
        let found = checksum_of(text, &place);
        let expected = u32::from_str_radix(&fields.checksum, 16).unwrap_or(!found);
        if expected != found {
            return Err(ManifestError::Checksum { expected, found });
        }
        Self::new(fields)
    }

    /// Checks what a manifest says.
    ///
    /// # Errors
    /// [`ManifestError::Feature`], [`ManifestError::Features`] and [`ManifestError::World`].
    pub fn new(fields: ManifestFields) -> Result<Self, ManifestError> {
        check_features(&fields.features)?;
        if fields.has_feature(FEATURE_BODY) != fields.world.body.is_some() {
            return Err(ManifestError::Features { what: "one of them names a body, the other a plane" });
        }
        if fields.world.body.is_some() && fields.is_sparse() {
            return Err(ManifestError::Features { what: "a body has no sparse levels" });
        }
        let world = fields.geometry().map_err(|source| ManifestError::World { source })?;
        Ok(Self { fields, world })
    }

    /// What it says, field by field.
    #[must_use]
    pub fn fields(&self) -> &ManifestFields {
        &self.fields
    }

    /// The geometry of the database, with what its tiles hold and from which level on all nodes
    /// have some.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Whether the finest levels exist only where there are data.
    #[must_use]
    pub fn is_sparse(&self) -> bool {
        self.fields.is_sparse()
    }
}

impl ManifestFields {
    fn is_sparse(&self) -> bool {
        self.has_feature(FEATURE_SPARSE_LEVELS)
    }

    fn geometry(&self) -> Result<World, WorldError> {
        let world = World::new(self.world)?;
        let world = match self.complete_level.filter(|_| self.is_sparse()) {
            Some(level) => world.with_complete_level(level),
            None => world,
        };
        if !self.has_feature(FEATURE_VALIDITY) {
            return Ok(world);
        }
        Ok(world.with_validity(self.elevation.voids.is_none_or(|voids| voids.hole_area_m2 > 0.0)))
    }

    fn has_feature(&self, feature: &str) -> bool {
        self.features.iter().any(|found| found == feature)
    }

    /// The manifest's text, with format, version and checksum set; nothing else is looked at.
    ///
    /// # Errors
    /// When a number in it is not finite.
    pub fn to_text(&self) -> Result<String, serde_json::Error> {
        let mut manifest = self.clone();
        FORMAT.clone_into(&mut manifest.format);
        manifest.format_version = if manifest.features.is_empty() { FORMAT_VERSION } else { FEATURES_VERSION };
        "00000000".clone_into(&mut manifest.checksum);
        let mut text = serde_json::to_string_pretty(&manifest)?;
        text.push('\n');
        if let Some(place) = checksum_place(&text) {
            let checksum = format!("{:08x}", checksum_of(&text, &place));
            text.replace_range(place, &checksum);
        }
        Ok(text)
    }
}
