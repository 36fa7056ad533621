//! TIFF files of what each pixel sees: depth, and ground position. One file, or one for every frame
//! in a folder.

use super::temporary::{failure, write_whole};
use super::{FrameSink, Picture, SinkError};
use crate::technique::NEAR_M;
use glam::DVec3;
use std::fs;
use std::path::Path;
use terravision_common::camera::{Camera, PicturePlane};
use terravision_common::run::{MadeUp, PlaneTarget};
use terravision_common::world::World;
use tiff::encoder::colortype::{ColorType, Gray32Float, RGB64Float};
use tiff::encoder::{TiffEncoder, TiffValue};
use tiff::tags::{PhotometricInterpretation, SampleFormat, Tag};
use tiff::{TiffError, TiffResult};

/// Depth along the view axis, metres, of each pixel's centre; NaN for sky. `[height, width]`
/// float32. With [`MadeUp::Mark`] `[height, width, 2]`: the second band says what was measured.
#[derive(Debug)]
pub struct DepthSink {
    target: PlaneTarget,
    made_up: MadeUp,
}

impl DepthSink {
    /// To this file, or into this folder, which is made if it is missing.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn new(target: &PlaneTarget) -> Result<Self, SinkError> {
        Ok(Self { target: opened(target)?, made_up: MadeUp::default() })
    }

    /// What it says where the ground was made up.
    #[must_use]
    pub fn with_made_up(self, made_up: MadeUp) -> Self {
        Self { made_up, ..self }
    }
}

impl FrameSink for DepthSink {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        let path = self.target.path(picture.frame.get());
        let depths = picture.reversed_depth.ok_or_else(|| SinkError::NoDepth { path: path.clone() })?;
        let pixels = depths.iter().map(|&depth| depth_m(depth) as f32).zip(picture.made_up());
        match self.made_up {
            MadeUp::Nan => write_tiff::<Gray32Float>(
                &path,
                picture.size,
                pixels.map(|(depth, is_made_up)| if is_made_up { f32::NAN } else { depth }),
            ),
            MadeUp::Mark => write_tiff::<DepthAndMark>(
                &path,
                picture.size,
                pixels.flat_map(|(depth, is_made_up)| [depth, mark(f64::from(depth), is_made_up) as f32]),
            ),
        }
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

/// Easting, northing and height of the ground at each pixel's centre; NaN for sky. `[height, width,
/// 3]` float64, in the database's CRS and metres, heights without exaggeration. With
/// [`MadeUp::Mark`] `[height, width, 4]`: the last band says what was measured.
#[derive(Debug)]
pub struct GroundSink {
    target: PlaneTarget,
    made_up: MadeUp,
    world: World,
    exaggeration: f64,
}

impl GroundSink {
    /// To this file, or into this folder, which is made if it is missing. `world`: whose
    /// places are told.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn new(target: &PlaneTarget, world: World, exaggeration: f64) -> Result<Self, SinkError> {
        Ok(Self { target: opened(target)?, made_up: MadeUp::default(), world, exaggeration })
    }

    /// What it says where the ground was made up.
    #[must_use]
    pub fn with_made_up(self, made_up: MadeUp) -> Self {
        Self { made_up, ..self }
    }
}

impl FrameSink for GroundSink {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        let path = self.target.path(picture.frame.get());
        let depths = picture.reversed_depth.ok_or_else(|| SinkError::NoDepth { path: path.clone() })?;
        let width = picture.size[0] as usize;
        let view = GroundView::new(picture.camera(), &self.world, self.exaggeration);
        let pixels = view.positions(depths, width).zip(picture.made_up());
        match self.made_up {
            MadeUp::Nan => {
                let samples = pixels.flat_map(|(at, is_made_up)| if is_made_up { [f64::NAN; 3] } else { at });
                write_tiff::<RGB64Float>(&path, picture.size, samples)
            }
            MadeUp::Mark => {
                let samples = pixels.flat_map(|([x, y, z], is_made_up)| [x, y, z, mark(z, is_made_up)]);
                write_tiff::<GroundAndMark>(&path, picture.size, samples)
            }
        }
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

/// What the band of marks says of a pixel: 1 measured, 0 made up, NaN where its value is NaN, as
/// sky is.
fn mark(value: f64, is_made_up: bool) -> f64 {
    match (value.is_nan(), is_made_up) {
        (true, _) => f64::NAN,
        (false, true) => 0.0,
        (false, false) => 1.0,
    }
}

macro_rules! marked {
    ($name:ident, $of:ty, $bits:expr) => {
        /// A colour type with a band of marks.
        struct $name;

        impl ColorType for $name {
            type Inner = $of;
            const TIFF_VALUE: PhotometricInterpretation = PhotometricInterpretation::BlackIsZero;
            const BITS_PER_SAMPLE: &'static [u16] = &$bits;
            const SAMPLE_FORMAT: &'static [SampleFormat] = &[SampleFormat::IEEEFP; $bits.len()];

            // Without a predictor it is not asked for.
            fn horizontal_predict(row: &[Self::Inner], result: &mut Vec<Self::Inner>) {
                result.extend_from_slice(row);
            }
        }
    };
}

marked!(DepthAndMark, f32, [32, 32]);
marked!(GroundAndMark, f64, [64, 64, 64, 64]);

/// The target, its folder made.
fn opened(target: &PlaneTarget) -> Result<PlaneTarget, SinkError> {
    if let PlaneTarget::Folder(folder) = target {
        fs::create_dir_all(folder).map_err(|source| failure(folder, source))?;
    }
    Ok(target.clone())
}

/// Metres along the view axis from a value of the depth buffer; NaN for sky.
pub(super) fn depth_m(reversed: f32) -> f64 {
    if reversed > 0.0 { NEAR_M / f64::from(reversed) } else { f64::NAN }
}

/// What turns pixels with depth into ground positions; the camera's sines are computed once for all
/// pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct GroundView {
    eye: DVec3,
    axes: [DVec3; 3],
    plane: PicturePlane,
    world: World,
    exaggeration: f64,
}

impl GroundView {
    pub(super) fn new(camera: &Camera, world: &World, exaggeration: f64) -> Self {
        let (eye, axes, plane) = (camera.eye(), camera.axes_in_world(), camera.picture_plane());
        Self { eye, axes, plane, world: *world, exaggeration }
    }

    /// Of all pixels, in rows of `width` from the top.
    pub(super) fn positions(&self, reversed: &[f32], width: usize) -> impl Iterator<Item = [f64; 3]> {
        let rows = reversed.chunks(width.max(1)).enumerate();
        rows.flat_map(move |(row, depths)| {
            depths.iter().enumerate().map(move |(column, &depth)| self.at([column, row], depth))
        })
    }

    /// Of a pixel; the ray is that of `Camera::ray_in_world`.
    fn at(&self, [column, row]: [usize; 2], reversed: f32) -> [f64; 3] {
        let [right, up, forward] = self.axes;
        let [x, y] = self.plane.place(column as f64 + 0.5, row as f64 + 0.5);
        let at = self.world.surface().moved(self.eye, (forward + right * x + up * y) * depth_m(reversed));
        let place = self.world.crs_frame().place(at);
        [place.x, place.y, place.z / self.exaggeration]
    }
}

/// Writes a whole file of these samples, rows from the top. A strip of about a megabyte is in
/// memory at a time, so that several of these writers together take little.
fn write_tiff<C: ColorType>(
    path: &Path,
    [width, height]: [u32; 2],
    samples: impl Iterator<Item = C::Inner>,
) -> Result<(), SinkError>
where
    [C::Inner]: TiffValue,
{
    write_whole(path, |out| {
        let write = || -> TiffResult<()> {
            let mut encoder = TiffEncoder::new(out)?;
            let mut image = encoder.new_image::<C>(width, height)?;
            if matches!(C::BITS_PER_SAMPLE.len(), 2 | 4) {
                // With a band of marks. All but the first are more than the picture's kind has, of
                // no meaning that TIFF knows: as a fourth one behind red, green and blue readers
                // would leave it out.
                image.encoder().write_tag(Tag::ExtraSamples, &[0u16; 4][1..C::BITS_PER_SAMPLE.len()])?;
            }
            let (mut samples, mut strip) = (samples, Vec::new());
            while image.next_strip_sample_count() > 0 {
                strip.clear();
                strip.extend(samples.by_ref().take(usize::try_from(image.next_strip_sample_count())?));
                image.write_strip(&strip)?;
            }
            image.finish()
        };
        write().map_err(|error| match error {
            TiffError::IoError(source) => failure(path, source),
            other => SinkError::Encode { reason: other.to_string(), path: path.to_owned() },
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::camera::CameraFields;
    use terravision_common::ids::FrameNumber;
    use terravision_common::rig::Views;

    #[test]
    fn depth_is_metres_and_sky_is_not_a_number() {
        assert_eq!(depth_m(0.5 / 1000.0).round(), 1000.0);
        assert!(depth_m(0.0).is_nan());
    }

    #[test]
    fn every_frame_has_a_file_in_a_folder_and_strips_are_those_of_the_whole_picture() {
        let folder = std::env::temp_dir().join(format!("terravision-planes-{}", std::process::id()));
        // 900 rows of 1.6 kB: more than one strip.
        let size = [400u32, 900];
        let depths: Vec<f32> = (0..400 * 900u32).map(|k| k as f32).collect();
        let rgba = vec![255; 4 * depths.len()];
        let mut sink = DepthSink::new(&PlaneTarget::Folder(folder.clone())).unwrap();
        for frame in [3, 4].map(FrameNumber::new) {
            let (views, reversed_depth) = (Views::single(&Camera::default()), Some(&depths[..]));
            let (rgba, on_device) = (&rgba[..], None);
            let picture = Picture { frame, view: None, size, rgba, reversed_depth, on_device, views, is_settled: true };
            sink.write(&picture).unwrap();
        }
        let mut expected = std::io::Cursor::new(Vec::new());
        let metres: Vec<f32> = depths.iter().map(|&depth| depth_m(depth) as f32).collect();
        TiffEncoder::new(&mut expected).unwrap().write_image::<Gray32Float>(400, 900, &metres).unwrap();
        let mut names: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        names.sort();
        assert_eq!(names, [folder.join("frame-000003.tif"), folder.join("frame-000004.tif")], "nothing else is left");
        for name in names {
            assert!(fs::read(name).unwrap() == *expected.get_ref());
        }
        fs::remove_dir_all(folder).unwrap();
    }

    fn world() -> World {
        let fields = terravision_testkit::worlds::fields([4096; 2], 10.0, [32, 256]);
        World::new(terravision_common::world::WorldFields { origin: [5e5, 4e6], ..fields }).expect("valid")
    }

    #[test]
    fn ground_is_where_the_ray_ends() {
        let camera = Camera::new(CameraFields {
            eye_in_world: [100.0, 200.0, 1000.0],
            pitch_rad: -std::f64::consts::FRAC_PI_2,
            vfov_rad: std::f64::consts::FRAC_PI_2,
            width: 4,
            height: 4,
            ..*Camera::default().fields()
        })
        .expect("valid");
        // Straight down from 1000 m to 200 m: the centre of the uppermost row of pixels is 600 m
        // north of the eye.
        let view = GroundView::new(&camera, &world(), 2.0);
        let at = view.at([2, 0], (NEAR_M / 800.0) as f32);
        let ray = camera.eye() + camera.ray_in_world(2.5, 0.5) * depth_m((NEAR_M / 800.0) as f32);
        assert_eq!(at, [5e5 + ray.x, 4e6 + ray.y, ray.z / 2.0], "the camera's own ray");
        assert!((at[0] - 500_300.0).abs() < 1e-3 && (at[1] - 4_000_800.0).abs() < 1e-3, "{at:?}");
        assert!((at[2] - 100.0).abs() < 1e-3, "{at:?}");
    }

    #[test]
    fn made_up_ground_is_not_a_number_or_has_a_band_of_marks() {
        use tiff::decoder::{Decoder, DecodingResult};
        let camera = Camera::new(CameraFields {
            eye_in_world: [0.0, 0.0, 900.0],
            pitch_rad: -std::f64::consts::FRAC_PI_2,
            vfov_rad: 1.0,
            width: 3,
            height: 1,
            ..*Camera::default().fields()
        })
        .expect("valid");
        // Measured, made up, sky.
        let (rgba, depths) =
            ([9, 9, 9, 255, 9, 9, 9, 254, 9, 9, 9, 255], [(NEAR_M / 800.0) as f32, (NEAR_M / 800.0) as f32, 0.0]);
        let (views, reversed_depth) = (Views::single(&camera), Some(&depths[..]));
        let (frame, size, rgba, on_device) = (FrameNumber::new(0), [3, 1], &rgba[..], None);
        let picture = Picture { frame, view: None, size, rgba, reversed_depth, on_device, views, is_settled: true };
        let folder = std::env::temp_dir().join(format!("terravision-tiff-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let target = PlaneTarget::File(folder.join("a.tif"));
        let read = |mut sink: Box<dyn FrameSink>| -> Vec<f64> {
            sink.write(&picture).unwrap();
            sink.finish().unwrap();
            let file = std::fs::File::open(folder.join("a.tif")).unwrap();
            match Decoder::new(std::io::BufReader::new(file)).unwrap().read_image().unwrap() {
                DecodingResult::F32(values) => values.into_iter().map(f64::from).collect(),
                DecodingResult::F64(values) => values,
                other => panic!("{other:?}"),
            }
        };
        let depth = |made_up| read(Box::new(DepthSink::new(&target).unwrap().with_made_up(made_up)));
        let ground = |made_up| read(Box::new(GroundSink::new(&target, world(), 1.0).unwrap().with_made_up(made_up)));
        let numbers = |values: &[f64]| values.iter().map(|v| !v.is_nan()).collect::<Vec<_>>();
        let plain = depth(MadeUp::Nan);
        assert_eq!((numbers(&plain), plain[0].round()), (vec![true, false, false], 800.0));
        let marked = depth(MadeUp::Mark);
        assert_eq!(numbers(&marked), [true, true, true, true, false, false]);
        assert_eq!((marked[0].round(), marked[1], marked[2].round(), marked[3]), (800.0, 1.0, 800.0, 0.0));
        assert_eq!(numbers(&ground(MadeUp::Nan)), [true, true, true, false, false, false, false, false, false]);
        let marked = ground(MadeUp::Mark);
        assert_eq!(
            (marked.len(), marked[2].round(), marked[3], marked[6].round(), marked[7]),
            (12, 100.0, 1.0, 100.0, 0.0)
        );
        assert!(marked[8..].iter().all(|v| v.is_nan()));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
