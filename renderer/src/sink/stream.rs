//! Pictures to the launcher, which makes a film or Y4M of them ([`terravision_common::film`]). A
//! stream has an order and cannot be mended: so its end is kept by the process that outlives a
//! renderer. Frames are made where the launcher reads them, in the stream ring.

use super::{FrameSink, Picture, SinkError, check_size, yuv};
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::AsFd;
use std::sync::Arc;
use terravision_common::film::{FrameEncoding, Packet, even};
use terravision_common::shm::{Control, RunId, StreamWriter};
use terravision_common::simd::Instructions;

/// Writes frames into the ring, and packets that tell of them.
#[derive(Debug)]
pub struct StreamSink<W> {
    packets: W,
    ring: StreamWriter,
    control: Arc<Control>,
    encoding: FrameEncoding,
    size: [u32; 2],
    frames: u64,
    /// By which pictures are converted.
    instructions: Instructions,
}

impl StreamSink<File> {
    /// Pictures of this size into a run's ring; packets to standard output, which is the launcher's
    /// pipe.
    ///
    /// # Errors
    /// Standard output cannot be duplicated or written, or there is no ring of such frames.
    pub fn open(
        run: &RunId,
        control: &Arc<Control>,
        encoding: FrameEncoding,
        size: [u32; 2],
    ) -> Result<Self, SinkError> {
        // As a file: the buffer of `std::io::Stdout` would look for the ends of lines in packets.
        let own = io::stdout().as_fd().try_clone_to_owned().map_err(|source| SinkError::Stdout { source })?;
        let ring = StreamWriter::open(run)?;
        Self::new(File::from(own), ring, Arc::clone(control), encoding, size)
    }
}

impl<W: Write + Send> StreamSink<W> {
    /// Pictures of this size into `ring`, packets to `packets`.
    ///
    /// # Errors
    /// `packets` cannot be written, or frames of the ring have another size.
    pub fn new(
        packets: W,
        ring: StreamWriter,
        control: Arc<Control>,
        encoding: FrameEncoding,
        size: [u32; 2],
    ) -> Result<Self, SinkError> {
        let (found, expected) = (ring.array_len(), encoding.frame_bytes(size));
        if found != expected {
            return Err(SinkError::RingSize { found, expected });
        }
        let begin = Packet { frame: Packet::BEGIN, position: ring.next_position() };
        let instructions = Instructions::widest();
        let mut sink = Self { packets, ring, control, encoding, size, frames: 0, instructions };
        sink.tell(begin)?;
        Ok(sink)
    }

    fn tell(&mut self, packet: Packet) -> Result<(), SinkError> {
        self.packets.write_all(&packet.to_bytes()).map_err(|source| match source.kind() {
            io::ErrorKind::BrokenPipe => SinkError::ReaderGone { frames: self.frames },
            _ => SinkError::Stdout { source },
        })
    }
}

impl<W: Write + Send> FrameSink for StreamSink<W> {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        check_size("a film or a stream", picture, self.size)?;
        let mut frame = self.ring.begin(&self.control)?;
        match self.encoding {
            FrameEncoding::Raw => pad(picture, &mut frame),
            FrameEncoding::Yuv420 => yuv::planar_420(self.instructions, picture.size, picture.rgba, &mut frame),
            FrameEncoding::Y4m => yuv::y4m_frame(self.instructions, picture.size, picture.rgba, &mut frame),
        }
        let position = frame.publish();
        self.tell(Packet { frame: picture.frame.get(), position })?;
        self.frames += 1;
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}

/// A picture with even sides.
fn pad(picture: &Picture<'_>, out: &mut [u8]) {
    let [width, height] = picture.size.map(|side| side as usize);
    let row_bytes = 4 * even(picture.size)[0] as usize;
    for (row, out) in out.chunks_exact_mut(row_bytes).enumerate() {
        let start = row.min(height - 1) * width * 4;
        let (pixels, rest) = out.split_at_mut(4 * width);
        pixels.copy_from_slice(&picture.rgba[start..start + 4 * width]);
        rest.copy_from_slice(&pixels[4 * width - rest.len()..]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::camera::Camera;
    use terravision_common::ids::FrameNumber;
    use terravision_common::rig::Views;
    use terravision_common::shm::{StreamReader, memory};

    fn picture(frame: u64, size: [u32; 2], rgba: &[u8]) -> Picture<'_> {
        let views = Views::single(&Camera::default());
        let frame = FrameNumber::new(frame);
        Picture { frame, view: None, size, rgba, reversed_depth: None, on_device: None, views, is_settled: true }
    }

    fn sink<W: Write + Send>(packets: W, encoding: FrameEncoding, size: [u32; 2]) -> (StreamSink<W>, StreamReader) {
        let (ring, reader) = memory::stream_ring(2, encoding.frame_bytes(size) as u32).unwrap();
        (StreamSink::new(packets, ring, Arc::new(memory::control().unwrap()), encoding, size).unwrap(), reader)
    }

    fn told(packets: &[u8]) -> Vec<Packet> {
        packets.as_chunks().0.iter().map(|bytes| Packet::from_bytes(*bytes)).collect()
    }

    #[test]
    fn frames_lie_in_the_ring_and_packets_tell_where() {
        let begin = Packet { frame: Packet::BEGIN, position: 0 };
        for encoding in [FrameEncoding::Raw, FrameEncoding::Yuv420, FrameEncoding::Y4m] {
            let (size, rgba) = ([3, 1], [9u8; 12]);
            let mut bytes = Vec::new();
            let (mut sink, mut reader) = sink(&mut bytes, encoding, size);
            for frame in [4, 6] {
                sink.write(&picture(frame, size, &rgba)).unwrap();
            }
            sink.finish().unwrap();
            drop(sink);
            let packets = [begin, Packet { frame: 4, position: 0 }, Packet { frame: 6, position: 1 }];
            assert_eq!(told(&bytes), packets);
            let [first, second] = [0, 1].map(|position| reader.read_array(position).unwrap().unwrap().to_vec());
            assert!(first == second && first.len() as u64 == encoding.frame_bytes(size));
        }
    }

    #[test]
    fn a_stream_takes_pictures_of_one_size() {
        let mut bytes = Vec::new();
        let (mut sink, _reader) = sink(&mut bytes, FrameEncoding::Raw, [2, 2]);
        sink.write(&picture(6, [2, 2], &[0; 16])).unwrap();
        let error = sink.write(&picture(7, [4, 2], &[0; 32])).unwrap_err().to_string();
        assert!(
            error.starts_with("frame 7 is a picture of 4x2 pixels, but a film or a stream takes 2x2 only"),
            "{error}"
        );
        drop(sink);
        assert_eq!(told(&bytes).len(), 2, "nothing of the other picture");
    }

    #[test]
    fn a_ring_of_other_frames_is_refused() {
        let (ring, _reader) = memory::stream_ring(2, 16).unwrap();
        let control = Arc::new(memory::control().unwrap());
        let error = StreamSink::new(io::sink(), ring, control, FrameEncoding::Raw, [4, 2]).unwrap_err();
        assert!(matches!(error, SinkError::RingSize { found: 16, expected: 32 }));
    }

    #[test]
    fn an_odd_side_is_made_even_by_what_is_beside_it() {
        let rgba: Vec<u8> = (0..9).flat_map(|n| [n, n, n, 255]).collect();
        let mut out = [0; 64];
        pad(&picture(0, [3, 3], &rgba), &mut out);
        let reds: Vec<u8> = out.iter().step_by(4).copied().collect();
        assert_eq!(reds, [0, 1, 2, 2, 3, 4, 5, 5, 6, 7, 8, 8, 6, 7, 8, 8]);
    }

    #[test]
    fn a_launcher_that_goes_is_told_of() {
        /// Takes one packet.
        struct Gone(bool);
        impl Write for Gone {
            fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
                if std::mem::replace(&mut self.0, true) {
                    Err(io::ErrorKind::BrokenPipe.into())
                } else {
                    Ok(bytes.len())
                }
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let (mut sink, _reader) = sink(Gone(false), FrameEncoding::Raw, [2, 2]);
        let error = sink.write(&picture(0, [2, 2], &[0; 16])).unwrap_err();
        assert!(matches!(error, SinkError::ReaderGone { frames: 0 }));
    }
}
