//! Y4M on standard output (or any writer): uncompressed film for other programs, 4:4:4, 8 bits, limited range.
//!
//! Y4M cannot say which matrix made its colours. Players and encoders guess by size, and so do we choose: BT.709 for
//! pictures at least 1280 wide or more than 576 high, BT.601 for smaller ones. The choice is also written as the comment
//! `XTV_MATRIX=BT709` (or `BT601`), which readers that do not know it skip, and the range as `XCOLORRANGE=LIMITED`.

use super::{FrameSink, Picture, SinkError};
use std::io::{self, Write};

/// Writes Y4M.
#[derive(Debug)]
pub struct Y4mSink<W> {
    out: W,
    fps: [u64; 2],
    frames: u64,
    planes: Vec<u8>,
}

impl Y4mSink<io::Stdout> {
    /// To standard output.
    #[must_use]
    pub fn stdout(fps: f64) -> Self {
        Self::new(io::stdout(), fps)
    }
}

impl<W: Write + Send> Y4mSink<W> {
    /// To `out`, playing at `fps` frames per second.
    pub fn new(out: W, fps: f64) -> Self {
        Self { out, fps: rational_fps(fps), frames: 0, planes: Vec::new() }
    }

    fn put(&mut self, bytes_of: impl FnOnce(&mut W, &[u8]) -> io::Result<()>) -> Result<(), SinkError> {
        bytes_of(&mut self.out, &self.planes).map_err(|source| {
            if source.kind() == io::ErrorKind::BrokenPipe {
                SinkError::ReaderGone { frames: self.frames }
            } else {
                SinkError::Stdout { source }
            }
        })
    }
}

impl<W: Write + Send> FrameSink for Y4mSink<W> {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        let [width, height] = picture.size;
        let matrix = Matrix::for_size(picture.size);
        if self.frames == 0 {
            let ([n, d], name) = (self.fps, matrix.name());
            self.put(|out, _| {
                writeln!(
                    out,
                    "YUV4MPEG2 W{width} H{height} F{n}:{d} Ip A1:1 C444 XCOLORRANGE=LIMITED XTV_MATRIX={name}"
                )
            })?;
        }
        matrix.convert(picture.rgba, &mut self.planes);
        self.put(|out, planes| {
            out.write_all(b"FRAME\n")?;
            out.write_all(planes)?;
            out.flush()
        })?;
        self.frames += 1;
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        self.put(|out, _| out.flush())
    }
}

/// Frames per second as a fraction: whole numbers as they are, the NTSC rates exactly, else in thousandths.
pub(super) fn rational_fps(fps: f64) -> [u64; 2] {
    let whole = fps.round();
    if (fps - whole).abs() < 1e-9 && whole >= 1.0 {
        return [whole as u64, 1];
    }
    let ntsc = (fps * 1.001).round();
    if (ntsc / 1.001 - fps).abs() < 5e-3 && ntsc >= 1.0 {
        return [ntsc as u64 * 1000, 1001];
    }
    [((fps * 1000.0).round() as u64).max(1), 1000]
}

/// A matrix from R'G'B' to Y'CbCr, limited range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Matrix {
    /// ITU-R BT.601-7.
    Bt601,
    /// ITU-R BT.709-6.
    Bt709,
}

impl Matrix {
    /// What players take pictures of this size to be.
    pub(super) fn for_size([width, height]: [u32; 2]) -> Self {
        if width >= 1280 || height > 576 { Self::Bt709 } else { Self::Bt601 }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Bt601 => "BT601",
            Self::Bt709 => "BT709",
        }
    }

    /// Kr and Kb of the standard, in 65536ths.
    fn weights(self) -> [i32; 3] {
        match self {
            Self::Bt601 => [19595, 38470, 7471],
            Self::Bt709 => [13933, 46871, 4732],
        }
    }

    /// Three planes Y, Cb, Cr from RGBA, in integers: the same bytes everywhere.
    fn convert(self, rgba: &[u8], planes: &mut Vec<u8>) {
        let count = rgba.len() / 4;
        planes.resize(count * 3, 0);
        let (y_plane, rest) = planes.split_at_mut(count);
        let (cb_plane, cr_plane) = rest.split_at_mut(count);
        let [kr, kg, kb] = self.weights();
        // Y = 16 + 219/255 * luma; Cb = 128 + 224/255 * (B - luma) / (2 (1 - Kb)): 2^16 fixed point, luma in 2^16ths.
        let y_scale = 219 * 65536 / 255;
        let chroma = |k: i32| (224.0 / 255.0 / (2.0 * (1.0 - f64::from(k) / 65536.0)) * 65536.0).round() as i64;
        let (cb_scale, cr_scale) = (chroma(kb), chroma(kr));
        let half = 1i64 << 31;
        let outs = y_plane.iter_mut().zip(cb_plane.iter_mut()).zip(cr_plane.iter_mut());
        for (texel, ((y, cb), cr)) in rgba.chunks_exact(4).zip(outs) {
            let [r, g, b] = [0, 1, 2].map(|channel| i32::from(texel[channel]));
            let luma = i64::from(kr * r + kg * g + kb * b);
            *y = (16 + ((luma * i64::from(y_scale) + half) >> 32)) as u8;
            *cb = (128 + ((((i64::from(b) << 16) - luma) * cb_scale + half) >> 32)) as u8;
            *cr = (128 + ((((i64::from(r) << 16) - luma) * cr_scale + half) >> 32)) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use terravision_common::camera::Camera;

    fn planes(matrix: Matrix, rgb: [u8; 3]) -> [u8; 3] {
        let mut out = Vec::new();
        matrix.convert(&[rgb[0], rgb[1], rgb[2], 255], &mut out);
        [out[0], out[1], out[2]]
    }

    #[test]
    fn colours_have_the_values_of_the_standards() {
        for matrix in [Matrix::Bt601, Matrix::Bt709] {
            assert_eq!(planes(matrix, [0, 0, 0]), [16, 128, 128]);
            assert_eq!(planes(matrix, [255, 255, 255]), [235, 128, 128]);
        }
        // Reference values: 601 red (81, 90, 240), 709 green (173, 42, 26), 709 blue (32, 240, 118).
        assert_eq!(planes(Matrix::Bt601, [255, 0, 0]), [81, 90, 240]);
        assert_eq!(planes(Matrix::Bt709, [0, 255, 0]), [173, 42, 26]);
        assert_eq!(planes(Matrix::Bt709, [0, 0, 255]), [32, 240, 118]);
    }

    #[test]
    fn rates_are_fractions() {
        assert_eq!(rational_fps(30.0), [30, 1]);
        assert_eq!(rational_fps(30000.0 / 1001.0), [30000, 1001]);
        assert_eq!(rational_fps(29.97), [30000, 1001]);
        assert_eq!(rational_fps(12.5), [12500, 1000]);
    }

    #[test]
    fn a_stream_has_a_header_and_frames() {
        let mut bytes = Vec::new();
        let rgba = [9u8; 3 * 4];
        let mut sink = Y4mSink::new(&mut bytes, 25.0);
        let picture = Picture {
            frame: 0,
            size: [3, 1],
            rgba: &rgba,
            reversed_depth: None,
            camera: Camera::zeroed(),
            is_settled: true,
        };
        sink.write(&picture).unwrap();
        sink.write(&picture).unwrap();
        sink.finish().unwrap();
        drop(sink);
        let header = b"YUV4MPEG2 W3 H1 F25:1 Ip A1:1 C444 XCOLORRANGE=LIMITED XTV_MATRIX=BT601\n";
        assert!(bytes.starts_with(header));
        assert_eq!(bytes.len(), header.len() + 2 * (6 + 9));
    }

    #[test]
    fn a_reader_that_goes_is_told_of() {
        struct Gone;
        impl Write for Gone {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(io::ErrorKind::BrokenPipe.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let picture = Picture {
            frame: 0,
            size: [1, 1],
            rgba: &[0; 4],
            reversed_depth: None,
            camera: Camera::zeroed(),
            is_settled: true,
        };
        let error = Y4mSink::new(Gone, 30.0).write(&picture).unwrap_err();
        assert!(matches!(error, SinkError::ReaderGone { frames: 0 }));
    }
}
