//! Tags of Flash Video (Adobe, *Video File Format Specification* 10.1, annex E), as far as ffmpeg
//! writes them for H.264 alone.

use std::io::{self, ErrorKind};
use tokio::io::{AsyncRead, AsyncReadExt};

/// Longest tag that is read: a picture is smaller by far.
const MOST_TAG_BYTES: usize = 16 << 20;
/// The tag's type.
const VIDEO: u8 = 9;
/// The codec's number.
const H264: u8 = 7;

/// A tag.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Tag {
    /// The decoder's configuration (`AVCDecoderConfigurationRecord`).
    Config(Vec<u8>),
    /// An access unit; its parts have their lengths before them.
    Unit {
        /// Nothing before it is needed.
        is_key: bool,
        /// The unit.
        bytes: Vec<u8>,
    },
    /// Metadata, the end of the stream.
    Other,
}

/// Reads what stands before the first tag.
pub(super) async fn read_header(reader: &mut (impl AsyncRead + Unpin)) -> io::Result<()> {
    let mut header = [0; 13];
    reader.read_exact(&mut header).await?;
    if header.starts_with(b"FLV\x01") { Ok(()) } else { Err(ErrorKind::InvalidData.into()) }
}

/// Reads a tag.
pub(super) async fn read_tag(reader: &mut (impl AsyncRead + Unpin)) -> io::Result<Tag> {
    let mut head = [0; 11];
    reader.read_exact(&mut head).await?;
    let length = u32::from_be_bytes([0, head[1], head[2], head[3]]) as usize;
    if length > MOST_TAG_BYTES {
        return Err(ErrorKind::InvalidData.into());
    }
    // Behind it stands its length once more.
    let mut data = vec![0; length + 4];
    reader.read_exact(&mut data).await?;
    data.truncate(length);
    if head[0] & 0x1F != VIDEO || length < 5 || data[0] & 0xF != H264 {
        return Ok(Tag::Other);
    }
    let (is_key, kind) = (data[0] >> 4 == 1, data[1]);
    data.drain(..5);
    Ok(match kind {
        0 => Tag::Config(data),
        1 => Tag::Unit { is_key, bytes: data },
        _ => Tag::Other,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tag(kind: u8, data: &[u8]) -> Vec<u8> {
        let length = (data.len() as u32).to_be_bytes();
        let mut bytes = vec![kind, length[1], length[2], length[3], 0, 0, 0, 0, 0, 0, 0];
        bytes.extend_from_slice(data);
        bytes.extend_from_slice(&(data.len() as u32 + 11).to_be_bytes());
        bytes
    }

    #[tokio::test]
    async fn tags_are_read_and_other_bytes_refused() {
        let stream = [
            b"FLV\x01\x01\0\0\0\x09\0\0\0\0".to_vec(),
            tag(18, b"metadata"),
            tag(9, &[0x17, 0, 0, 0, 0, 1, 66, 192, 30]),
            tag(9, &[0x17, 1, 0, 0, 0, 5, 6]),
            tag(9, &[0x27, 1, 0, 0, 0, 7]),
        ];
        let stream = stream.concat();
        let mut reader = &stream[..];
        read_header(&mut reader).await.unwrap();
        assert_eq!(read_tag(&mut reader).await.unwrap(), Tag::Other);
        assert_eq!(read_tag(&mut reader).await.unwrap(), Tag::Config(vec![1, 66, 192, 30]));
        assert_eq!(read_tag(&mut reader).await.unwrap(), Tag::Unit { is_key: true, bytes: vec![5, 6] });
        assert_eq!(read_tag(&mut reader).await.unwrap(), Tag::Unit { is_key: false, bytes: vec![7] });
        assert_eq!(read_tag(&mut reader).await.unwrap_err().kind(), ErrorKind::UnexpectedEof);
        assert!(read_header(&mut &b"RIFF........."[..]).await.is_err());
        assert!(read_tag(&mut &[9, 255, 255, 255, 0, 0, 0, 0, 0, 0, 0][..]).await.is_err());
    }
}
