//! Files of views (`--views`), and stereo pairs (`--stereo`): the cameras that a pose carries, and how their pictures are put
//! together. docs/views.md explains the format.

mod error;

pub use error::RigError;

use serde::Deserialize;
use std::path::{Path, PathBuf};
use terravision_common::camera::MAX_SIDE_PX;
use terravision_common::files::read_bounded;
use terravision_common::rig::{self, MAX_VIEWS, Rig, RigView};

/// Most bytes of a file of views.
pub const MAX_VIEWS_BYTES: u64 = 64 << 10;
/// Longest name of a view, bytes: it is part of file names.
const LONGEST_NAME: usize = 64;
/// Most pixels of a picture that holds all views.
const MOST_PIXELS: u64 = 1 << 28;
/// Farthest that a camera may be from the pose that carries it, metres.
const FARTHEST_M: f64 = 1e6;

/// How the pictures of views are put together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pictures {
    /// One picture of all views.
    #[default]
    SideBySide,
    /// A picture of each.
    Separate,
    /// Two views as one picture for glasses, red at the left eye and cyan at the right one.
    Anaglyph,
}

/// A view, as it is written.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct ViewEntry {
    name: String,
    #[serde(default)]
    right_m: f64,
    #[serde(default)]
    ahead_m: f64,
    #[serde(default)]
    up_m: f64,
    #[serde(default)]
    yaw_deg: f64,
    #[serde(default)]
    pitch_deg: f64,
    #[serde(default)]
    roll_deg: f64,
    vfov_deg: Option<f64>,
    convergence_m: Option<f64>,
    width: Option<u32>,
    height: Option<u32>,
    x: Option<u32>,
    y: Option<u32>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    #[serde(default)]
    pictures: Pictures,
    views: Vec<ViewEntry>,
}

/// Views that were asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct RigFile {
    /// The flag that asked for it.
    asked: String,
    /// How the pictures are put together.
    pub pictures: Pictures,
    views: Vec<ViewEntry>,
}

impl RigFile {
    /// Reads and checks a file of views.
    ///
    /// # Errors
    /// [`RigError`].
    pub fn read(path: &Path) -> Result<Self, RigError> {
        let asked = || asked_by(path);
        let bytes = read_bounded(path, MAX_VIEWS_BYTES).map_err(|source| RigError::Read { asked: asked(), source })?;
        Self::parse(path, &bytes)
    }

    fn parse(path: &Path, bytes: &[u8]) -> Result<Self, RigError> {
        let asked = || asked_by(path);
        let written: Written =
            serde_json::from_slice(bytes).map_err(|source| RigError::Json { asked: asked(), source })?;
        let file = Self { asked: asked(), pictures: written.pictures, views: written.views };
        if !(1..=MAX_VIEWS).contains(&file.views.len()) {
            let source = rig::RigError::Count { found: file.views.len() };
            return Err(RigError::Rig { asked: asked(), source });
        }
        for (index, view) in file.views.iter().enumerate() {
            file.check(index, view)?;
        }
        let placed = file.views.iter().filter(|view| view.x.is_some() || view.y.is_some()).count();
        if placed > 0 && !file.views.iter().all(|view| view.x.is_some() && view.y.is_some()) {
            return Err(RigError::HalfPlaced { asked: asked() });
        }
        if placed > 0 && file.pictures == Pictures::Separate {
            return Err(RigError::PlacedApart { asked: asked() });
        }
        Ok(file)
    }

    fn check(&self, index: usize, view: &ViewEntry) -> Result<(), RigError> {
        let bad = |key, found: String, expected| {
            let view = if view.name.is_empty() { format!("number {}", index + 1) } else { view.name.clone() };
            Err(RigError::Value { asked: self.asked.clone(), view, key, found, expected })
        };
        let is_name = |name: &str| {
            let is_letter = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
            (1..=LONGEST_NAME).contains(&name.len()) && name.chars().all(is_letter)
        };
        if !is_name(&view.name) {
            let expected = "1 to 64 letters, digits, - or _, because it is part of file names";
            return bad("name", format!("{:?}", view.name), expected);
        }
        if self.views[..index].iter().any(|before| before.name == view.name) {
            return bad("name", format!("{:?}", view.name), "another name than that of the views before it");
        }
        for (key, value) in [("right_m", view.right_m), ("ahead_m", view.ahead_m), ("up_m", view.up_m)] {
            if value.is_nan() || value.abs() > FARTHEST_M {
                return bad(key, value.to_string(), "metres from -1000000 to 1000000");
            }
        }
        for (key, value) in [("yaw_deg", view.yaw_deg), ("pitch_deg", view.pitch_deg), ("roll_deg", view.roll_deg)] {
            if value.is_nan() || value.abs() > 360.0 {
                return bad(key, value.to_string(), "degrees from -360 to 360");
            }
        }
        if let Some(vfov) = view.vfov_deg.filter(|vfov| !(1.0..=170.0).contains(vfov)) {
            return bad("vfov_deg", vfov.to_string(), "degrees from 1 to 170");
        }
        if let Some(ahead_m) = view.convergence_m {
            if !(ahead_m > 0.0 && ahead_m <= FARTHEST_M) {
                return bad("convergence_m", ahead_m.to_string(), "metres above 0, up to 1000000");
            }
            if [view.ahead_m, view.yaw_deg, view.pitch_deg, view.roll_deg] != [0.0; 4] {
                let expected = "none, as the view is turned or moved ahead: only parallel views in one plane converge";
                return bad("convergence_m", ahead_m.to_string(), expected);
            }
            if view.right_m.abs() > ahead_m {
                let expected =
                    "at least as many metres as its right_m, or views meet at an angle of more than 45 degrees";
                return bad("convergence_m", ahead_m.to_string(), expected);
            }
        }
        for (key, side) in [("width", view.width), ("height", view.height)] {
            if let Some(side) = side.filter(|side| !(1..=MAX_SIDE_PX).contains(side)) {
                return bad(key, side.to_string(), "pixels from 1 to 65536");
            }
        }
        Ok(())
    }

    /// A left and a right eye, this far apart, whose pictures meet `convergence_m` ahead.
    #[must_use]
    pub fn stereo(pictures: Pictures, separation_m: f64, convergence_m: f64) -> Self {
        let eye = |name: &str, right_m| ViewEntry {
            name: name.to_owned(),
            right_m,
            convergence_m: Some(convergence_m),
            ..ViewEntry::default()
        };
        let views = vec![eye("left", -0.5 * separation_m), eye("right", 0.5 * separation_m)];
        Self { asked: "--stereo".to_owned(), pictures, views }
    }

    /// The flag that asked for it, for messages.
    #[must_use]
    pub fn asked(&self) -> &str {
        &self.asked
    }

    /// The names of the views, in their order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.views.iter().map(|view| view.name.as_str())
    }

    /// The cameras, where a view that says nothing else has this size and field of view.
    ///
    /// # Errors
    /// [`RigError`]: views overlap, or their picture is too large.
    pub fn rig(&self, size: [u32; 2], vfov_rad: f64) -> Result<Rig, RigError> {
        let mut right = 0u32;
        let mut views = Vec::with_capacity(self.views.len());
        for view in &self.views {
            let size = [view.width.unwrap_or(size[0]), view.height.unwrap_or(size[1])];
            let at = view.x.zip(view.y).map_or([right, 0], |(x, y)| [x, y]);
            right = right.saturating_add(size[0]);
            let vfov_rad = view.vfov_deg.map_or(vfov_rad, f64::to_radians);
            let focal_px = 0.5 * f64::from(size[1]) / (0.5 * vfov_rad).tan();
            views.push(RigView {
                name: view.name.clone(),
                offset_m: [view.right_m, view.ahead_m, view.up_m],
                yaw_rad: view.yaw_deg.to_radians(),
                pitch_rad: view.pitch_deg.to_radians(),
                roll_rad: view.roll_deg.to_radians(),
                vfov_rad,
                lens_shift_px: view.convergence_m.map_or(0.0, |ahead_m| -view.right_m * focal_px / ahead_m),
                size,
                at,
            });
        }
        self.check_places(&views)?;
        self.check_pair(&views)?;
        Rig::new(views).map_err(|source| RigError::Rig { asked: self.asked.clone(), source })
    }

    fn check_pair(&self, views: &[RigView]) -> Result<(), RigError> {
        let found = match views {
            _ if self.pictures != Pictures::Anaglyph => return Ok(()),
            [left, right] if left.size == right.size => return Ok(()),
            [left, right] => {
                let [left, right] = [left.size, right.size].map(|[width, height]| format!("{width}x{height}"));
                format!("sizes {left} and {right}")
            }
            others => format!("{} views", others.len()),
        };
        Err(RigError::NoPair { asked: self.asked.clone(), found })
    }

    fn check_places(&self, views: &[RigView]) -> Result<(), RigError> {
        let end = |view: &RigView, axis: usize| u64::from(view.at[axis]) + u64::from(view.size[axis]);
        let [width, height] = [0, 1].map(|axis| views.iter().map(|view| end(view, axis)).max().unwrap_or(0));
        if width.max(height) > u64::from(MAX_SIDE_PX) || width * height > MOST_PIXELS {
            return Err(RigError::TooLarge { asked: self.asked.clone(), width, height });
        }
        let overlaps = |a: &RigView, b: &RigView| {
            (0..2).all(|axis| u64::from(a.at[axis]) < end(b, axis) && u64::from(b.at[axis]) < end(a, axis))
        };
        for (index, view) in views.iter().enumerate() {
            if let Some(other) = views[..index].iter().find(|other| overlaps(view, other)) {
                let [first, second] = [&other.name, &view.name].map(String::clone);
                return Err(RigError::Overlap { asked: self.asked.clone(), first, second });
            }
        }
        Ok(())
    }
}

fn asked_by(path: &Path) -> String {
    format!("--views {}", path.display())
}

/// The folder of a view's frames, within the folder of a flight's.
#[must_use]
pub fn view_folder(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("view-{name}"))
}

/// The file of a view, beside the file that was asked for: `a.png` becomes `a-NAME.png`.
#[must_use]
pub fn view_file(path: &Path, name: &str) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map(|extension| format!(".{}", extension.to_string_lossy())).unwrap_or_default();
    path.with_file_name(format!("{stem}-{name}{extension}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<RigFile, String> {
        RigFile::parse(Path::new("v.json"), text.as_bytes()).map_err(|error| error.to_string())
    }

    #[test]
    fn a_stereo_pair_lies_side_by_side_with_the_size_of_the_picture() {
        let file =
            parse(r#"{"views": [{"name": "left", "right_m": -0.03}, {"name": "right", "right_m": 0.03}]}"#).unwrap();
        let rig = file.rig([640, 480], 1.0).unwrap();
        assert_eq!((rig.views()[0].at, rig.views()[1].at), ([0, 0], [640, 0]));
        assert_eq!((rig.views()[1].offset_m, rig.views()[1].vfov_rad), ([0.03, 0.0, 0.0], 1.0));
        assert_eq!((file.pictures, rig.view_size(), rig.pixels()), (Pictures::SideBySide, [640, 480], 2 * 640 * 480));
    }

    #[test]
    fn eyes_converge_where_their_pictures_show_the_same() {
        let rig = RigFile::stereo(Pictures::Anaglyph, 4.0, 100.0).rig([640, 480], 1.0).unwrap();
        let shifts = [0, 1].map(|eye| rig.views()[eye].lens_shift_px);
        let focal_px = 240.0 / 0.5f64.tan();
        assert_eq!(shifts, [2.0 * focal_px / 100.0, -2.0 * focal_px / 100.0]);
        let text = |entry: &str| format!(r#"{{"pictures": "anaglyph", "views": [{{"name": "a"}}{entry}]}}"#);
        let error = parse(&text("")).unwrap().rig([64, 48], 1.0).unwrap_err().to_string();
        assert!(error.ends_with("found 1 views"), "{error}");
        let error = parse(&text(r#", {"name": "b", "width": 5}"#)).unwrap().rig([64, 48], 1.0).unwrap_err().to_string();
        assert!(error.ends_with("found sizes 64x48 and 5x48"), "{error}");
    }

    #[test]
    fn views_have_places_sizes_and_angles_of_their_own() {
        let file = parse(
            r#"{"pictures": "side-by-side", "views": [
                {"name": "ahead", "x": 0, "y": 0},
                {"name": "down", "pitch_deg": -90, "vfov_deg": 40, "width": 200, "height": 100, "x": 20, "y": 480}]}"#,
        );
        let rig = file.unwrap().rig([640, 480], 1.0).unwrap();
        assert_eq!((rig.views()[1].at, rig.views()[1].size), ([20, 480], [200, 100]));
        assert!((rig.views()[1].pitch_rad + std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert_eq!(rig.views()[1].vfov_rad, 40f64.to_radians());
    }

    #[test]
    fn what_cannot_be_drawn_is_said_in_a_sentence() {
        let seven: Vec<String> = (0..7).map(|n| format!(r#"{{"name": "v{n}"}}"#)).collect();
        let cases = [
            ("nonsense".to_owned(), "--views v.json is not a file of views: expected"),
            (r#"{"views": []}"#.to_owned(), "has 0 views, expected 1 to 6"),
            (format!(r#"{{"views": [{}]}}"#, seven.join(",")), "has 7 views, expected 1 to 6"),
            (r#"{"views": [{"name": "a", "yaw": 90}]}"#.to_owned(), "unknown field `yaw`, expected one of"),
            (
                r#"{"views": [{"name": "../a"}]}"#.to_owned(),
                r#"the name of view ../a is "../a", expected 1 to 64 letters"#,
            ),
            (r#"{"views": [{"name": "a"}, {"name": "a"}]}"#.to_owned(), "expected another name"),
            (
                r#"{"views": [{"name": "a", "vfov_deg": 180}]}"#.to_owned(),
                "the vfov_deg of view a is 180, expected degrees from 1",
            ),
            (r#"{"views": [{"name": "a", "up_m": 1e7}]}"#.to_owned(), "the up_m of view a is 10000000"),
            (r#"{"views": [{"name": "a", "yaw_deg": 361}]}"#.to_owned(), "degrees from -360 to 360"),
            (r#"{"views": [{"name": "a", "convergence_m": 0}]}"#.to_owned(), "is 0, expected metres above 0"),
            (
                r#"{"views": [{"name": "a", "right_m": 9, "convergence_m": 8}]}"#.to_owned(),
                "is 8, expected at least as many metres as its right_m",
            ),
            (
                r#"{"views": [{"name": "a", "yaw_deg": 9, "convergence_m": 8}]}"#.to_owned(),
                "is 8, expected none, as the view is turned",
            ),
            (r#"{"views": [{"name": "a", "width": 0}]}"#.to_owned(), "pixels from 1 to 65536"),
            (
                r#"{"views": [{"name": "a", "x": 0, "y": 0}, {"name": "b"}]}"#.to_owned(),
                "expected x and y for all of them",
            ),
            (
                r#"{"pictures": "separate", "views": [{"name": "a", "x": 0, "y": 0}]}"#.to_owned(),
                "has no place for x and y",
            ),
            (r#"{"pictures": "cube", "views": [{"name": "a"}]}"#.to_owned(), "unknown variant `cube`"),
        ];
        for (text, sentence) in cases {
            let error = parse(&text).unwrap_err();
            assert!(error.contains(sentence), "{error:?} does not say {sentence:?}");
        }
        let overlapping = r#"{"views": [{"name": "a", "x": 0, "y": 0}, {"name": "b", "x": 9, "y": 9}]}"#;
        let error = parse(overlapping).unwrap().rig([10, 10], 1.0).unwrap_err().to_string();
        assert!(error.contains("views a and b overlap"), "{error}");
        let wide = r#"{"views": [{"name": "a", "width": 40000}, {"name": "b", "width": 40000}]}"#;
        let error = parse(wide).unwrap().rig([10, 10], 1.0).unwrap_err().to_string();
        assert!(error.contains("a picture of 80000x10 pixels"), "{error}");
    }

    #[test]
    fn files_and_folders_of_views_have_their_names() {
        assert_eq!(view_file(Path::new("out/a.png"), "left"), Path::new("out/a-left.png"));
        assert_eq!(view_folder(Path::new("out/"), "left"), Path::new("out/view-left"));
    }
}
