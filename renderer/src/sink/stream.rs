//! Pictures as packets to the launcher, which makes a film or Y4M of them
//! ([`terravision_common::film`]). A stream has an order and cannot be mended: so its end is kept
//! by the process that outlives a renderer.

use super::{FrameSink, Picture, SinkError, check_size, yuv};
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::AsFd;
use terravision_common::film::{FrameEncoding, PacketHeader, even};
use terravision_common::simd::Instructions;

/// Writes packets.
#[derive(Debug)]
pub struct StreamSink<W> {
    out: W,
    encoding: FrameEncoding,
    size: [u32; 2],
    frames: u64,
    /// By which pictures are converted.
    instructions: Instructions,
    encoded: Vec<u8>,
}

impl StreamSink<File> {
    /// Pictures of this size to standard output, which is the launcher's pipe.
    ///
    /// # Errors
    /// It cannot be duplicated.
    pub fn stdout(encoding: FrameEncoding, size: [u32; 2]) -> Result<Self, SinkError> {
        // As a file: the buffer of `std::io::Stdout` would look for the ends of lines in every
        // picture.
        let own = io::stdout().as_fd().try_clone_to_owned().map_err(|source| SinkError::Stdout { source })?;
        Ok(Self::new(File::from(own), encoding, size))
    }
}

impl<W: Write + Send> StreamSink<W> {
    /// Pictures of this size to `out`.
    pub fn new(out: W, encoding: FrameEncoding, size: [u32; 2]) -> Self {
        Self { out, encoding, size, frames: 0, instructions: Instructions::widest(), encoded: Vec::new() }
    }
}

impl<W: Write + Send> FrameSink for StreamSink<W> {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        check_size("a film or a stream", picture, self.size)?;
        let bytes = match self.encoding {
            FrameEncoding::Raw if even(picture.size) == picture.size => picture.rgba,
            FrameEncoding::Raw => {
                pad(picture, &mut self.encoded);
                &self.encoded
            }
            FrameEncoding::Yuv420 => {
                yuv::planar_420(self.instructions, picture.size, picture.rgba, &mut self.encoded);
                &self.encoded
            }
            FrameEncoding::Y4m => {
                yuv::y4m_frame(self.instructions, picture.size, picture.rgba, &mut self.encoded);
                &self.encoded
            }
        };
        let header = PacketHeader { frame: picture.frame.get(), bytes: bytes.len() as u64 };
        let written = self.out.write_all(&header.to_bytes()).and_then(|()| self.out.write_all(bytes));
        written.map_err(|source| match source.kind() {
            io::ErrorKind::BrokenPipe => SinkError::ReaderGone { frames: self.frames },
            _ => SinkError::Stdout { source },
        })?;
        self.frames += 1;
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

/// A picture with even sides.
fn pad(picture: &Picture<'_>, out: &mut Vec<u8>) {
    let [width, height] = picture.size.map(|side| side as usize);
    let [padded_width, padded_height] = even(picture.size).map(|side| side as usize);
    out.clear();
    for row in 0..padded_height {
        let start = row.min(height - 1) * width * 4;
        let pixels = &picture.rgba[start..start + width * 4];
        out.extend_from_slice(pixels);
        if padded_width > width {
            out.extend_from_slice(&pixels[width * 4 - 4..]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::camera::Camera;
    use terravision_common::ids::FrameNumber;
    use terravision_common::rig::Views;

    fn picture(frame: u64, size: [u32; 2], rgba: &[u8]) -> Picture<'_> {
        let views = Views::single(&Camera::default());
        let frame = FrameNumber::new(frame);
        Picture { frame, view: None, size, rgba, reversed_depth: None, on_device: None, views, is_settled: true }
    }

    #[test]
    fn packets_have_a_header_and_a_frame_each() {
        for encoding in [FrameEncoding::Raw, FrameEncoding::Yuv420, FrameEncoding::Y4m] {
            let (size, rgba) = ([3, 1], [9u8; 12]);
            let mut bytes = Vec::new();
            let mut sink = StreamSink::new(&mut bytes, encoding, size);
            for frame in [4, 6] {
                sink.write(&picture(frame, size, &rgba)).unwrap();
            }
            sink.finish().unwrap();
            drop(sink);
            let length = encoding.frame_bytes(size) as usize;
            assert_eq!(bytes.len(), 2 * (PacketHeader::SIZE + length));
            let (first, second) = bytes.split_at(PacketHeader::SIZE + length);
            assert_eq!(first[..PacketHeader::SIZE], PacketHeader { frame: 4, bytes: length as u64 }.to_bytes());
            assert_eq!(second[..PacketHeader::SIZE], PacketHeader { frame: 6, bytes: length as u64 }.to_bytes());
            assert_eq!(first[PacketHeader::SIZE..], second[PacketHeader::SIZE..]);
        }
    }

    #[test]
    fn a_stream_takes_pictures_of_one_size() {
        let mut bytes = Vec::new();
        let mut sink = StreamSink::new(&mut bytes, FrameEncoding::Raw, [2, 2]);
        sink.write(&picture(6, [2, 2], &[0; 16])).unwrap();
        let error = sink.write(&picture(7, [4, 2], &[0; 32])).unwrap_err().to_string();
        assert!(
            error.starts_with("frame 7 is a picture of 4x2 pixels, but a film or a stream takes 2x2 only"),
            "{error}"
        );
        drop(sink);
        assert_eq!(bytes.len(), PacketHeader::SIZE + 16, "nothing of the other picture");
    }

    #[test]
    fn an_odd_side_is_made_even_by_what_is_beside_it() {
        let rgba: Vec<u8> = (0..9).flat_map(|n| [n, n, n, 255]).collect();
        let mut out = Vec::new();
        pad(&picture(0, [3, 3], &rgba), &mut out);
        let reds: Vec<u8> = out.iter().step_by(4).copied().collect();
        assert_eq!(reds, [0, 1, 2, 2, 3, 4, 5, 5, 6, 7, 8, 8, 6, 7, 8, 8]);
    }

    #[test]
    fn a_launcher_that_goes_is_told_of() {
        struct Gone;
        impl Write for Gone {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(io::ErrorKind::BrokenPipe.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let error = StreamSink::new(Gone, FrameEncoding::Raw, [2, 2]).write(&picture(0, [2, 2], &[0; 16])).unwrap_err();
        assert!(matches!(error, SinkError::ReaderGone { frames: 0 }));
    }
}
