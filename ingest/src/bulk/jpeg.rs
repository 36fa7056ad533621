//! Assembles JPEG pictures from pre-encoded blocks: two uses of a block differ only in its mean, so
//! a picture costs a few copied words per block (ITU-T T.81, annex F; sequential, Huffman, three
//! components, no subsampling).

use crate::archive;
use std::io;
use terravision_common::database::seal_color_tile;

/// Coefficients of a block, and the texels along its side.
const COEFFICIENTS: usize = 64;
pub(super) const BLOCK: u32 = 8;
/// Markers: Huffman tables, quantisation tables, start of the scan, end of the picture.
const DHT: u8 = 0xc4;
const DQT: u8 = 0xdb;
const SOS: u8 = 0xda;
const END: [u8; 2] = [0xff, 0xd9];
/// Symbols for sixteen zeros, and for nothing but zeros to the end.
const SIXTEEN_ZEROS: u8 = 0xf0;
const NO_MORE: u8 = 0;

/// The code of each symbol, and its length.
type Codes = Vec<(u32, u32)>;

/// The bits of a block without its mean: words of up to 32 bits, with their lengths.
pub(super) type Packed = Vec<(u32, u32)>;

/// The beginning of pictures of one size, and their codes.
#[derive(Debug, Clone)]
pub(super) struct Frame {
    head: Vec<u8>,
    side: u32,
    /// For brightness, and for both colour differences.
    means: [Codes; 2],
    details: [Codes; 2],
    /// The quantization step of the mean, in brightness times 8.
    mean_steps: [i32; 2],
}

/// Bits to bytes. A byte 0xff is followed by a zero.
#[derive(Debug, Default)]
struct Bits {
    bytes: Vec<u8>,
    waiting: u64,
    count: u32,
}

impl Bits {
    /// Up to 32 bits.
    fn push(&mut self, bits: u32, count: u32) {
        self.waiting = self.waiting << count | u64::from(bits);
        self.count += count;
        while self.count >= 8 {
            self.count -= 8;
            let byte = (self.waiting >> self.count) as u8;
            self.bytes.push(byte);
            if byte == 0xff {
                self.bytes.push(0);
            }
        }
    }
}

/// How many bits a number takes, and these bits (F.1.2.1).
fn magnitude(value: i32) -> (u32, u32) {
    let size = 32 - value.unsigned_abs().leading_zeros();
    let bits = if value < 0 { value - 1 } else { value };
    (size, bits.cast_unsigned() & ((1 << size) - 1))
}

impl Frame {
    /// A frame for pictures of `side`² texels, with the tables of the encoder of other tiles.
    pub(super) fn new(side: u32, quality: u8) -> io::Result<Self> {
        let model = archive::encode_color_tile(&vec![[0; 3]; (side * side) as usize], side as u16, quality)?;
        let strange = || io::Error::other("the JPEG encoder writes something unexpected");
        let mut codes: [[Option<Codes>; 2]; 2] = Default::default();
        let mut mean_steps = [1; 2];
        let mut at = 2;
        loop {
            let &[0xff, marker, high, low] = model.get(at..at + 4).ok_or_else(strange)? else { return Err(strange()) };
            let end = at + 2 + usize::from(u16::from_be_bytes([high, low]));
            let mut content = model.get(at + 4..end).ok_or_else(strange)?;
            at = end;
            match marker {
                SOS => break,
                DHT => {
                    while let Some((&[class], rest)) = content.split_first_chunk() {
                        let (counts, rest) = rest.split_at_checked(16).ok_or_else(strange)?;
                        let many = counts.iter().map(|count| usize::from(*count)).sum();
                        let (symbols, rest) = rest.split_at_checked(many).ok_or_else(strange)?;
                        let place = codes.get_mut(usize::from(class >> 4)).ok_or_else(strange)?;
                        *place.get_mut(usize::from(class & 15)).ok_or_else(strange)? = Some(canonical(counts, symbols));
                        content = rest;
                    }
                }
                DQT => {
                    while let Some((&[number, first], rest)) = content.split_first_chunk() {
                        // Bytes, not words.
                        *mean_steps.get_mut(usize::from(number)).ok_or_else(strange)? = i32::from(first);
                        content = rest.get(COEFFICIENTS - 1..).ok_or_else(strange)?;
                    }
                }
                _ => {}
            }
        }
        match codes {
            [[Some(means), Some(means_of_colors)], [Some(details), Some(details_of_colors)]] => Ok(Self {
                head: model[..at].to_vec(),
                side,
                means: [means, means_of_colors],
                details: [details, details_of_colors],
                mean_steps,
            }),
            _ => Err(strange()),
        }
    }

    /// Packs a block's coefficients but the first, in zigzag order, as multiples of their steps.
    /// `kind`: 0 brightness, 1 colour difference.
    pub(super) fn pack(&self, kind: usize, details: &[i32]) -> Packed {
        let codes = &self.details[kind];
        let mut packed = Packed::new();
        let mut put = |symbol: u8, extra: (u32, u32)| {
            let (code, length) = codes[usize::from(symbol)];
            packed.push((code << extra.0 | extra.1, length + extra.0));
        };
        let mut zeros = 0u8;
        for value in details {
            if *value == 0 {
                zeros += 1;
                continue;
            }
            while zeros >= 16 {
                put(SIXTEEN_ZEROS, (0, 0));
                zeros -= 16;
            }
            let extra = magnitude(*value);
            put(zeros << 4 | extra.0 as u8, extra);
            zeros = 0;
        }
        if details.len() < COEFFICIENTS - 1 || zeros > 0 {
            put(NO_MORE, (0, 0));
        }
        // A few long words are faster to copy than many short ones.
        let mut words = Packed::new();
        for (bits, count) in packed {
            match words.last_mut() {
                Some((last, length)) if *length + count <= 32 => {
                    *last = *last << count | bits;
                    *length += count;
                }
                _ => words.push((bits, count)),
            }
        }
        words
    }

    /// A tile. `block` says for each block, by column and row from the north west, the means of
    /// brightness and colour differences, from -128 to 127, and the rest of it.
    pub(super) fn tile<'a>(&self, mut block: impl FnMut(u32, u32) -> ([i32; 3], [&'a Packed; 3])) -> Vec<u8> {
        let mut bits = Bits { bytes: self.head.clone(), ..Bits::default() };
        let mut before = [0; 3];
        let blocks = self.side / BLOCK;
        for row in 0..blocks {
            for column in 0..blocks {
                let (means, details) = block(column, row);
                for (component, (mean, details)) in means.iter().zip(details).enumerate() {
                    let kind = component.min(1);
                    let mean = mean * BLOCK as i32 / self.mean_steps[kind];
                    let (size, extra) = magnitude(mean - before[component]);
                    before[component] = mean;
                    let (code, length) = self.means[kind][size as usize];
                    bits.push(code << size | extra, length + size);
                    details.iter().for_each(|(word, count)| bits.push(*word, *count));
                }
            }
        }
        // The last byte is filled with ones.
        bits.push(0x7f, 7);
        let mut bytes = bits.bytes;
        bytes.extend(END);
        seal_color_tile(&mut bytes);
        bytes
    }
}

/// Codes from how many there are of each length, shortest first (annex C).
fn canonical(counts: &[u8], symbols: &[u8]) -> Codes {
    let mut codes = vec![(0, 0); 256];
    let (mut code, mut symbols) = (0, symbols.iter());
    for (length, count) in (1..).zip(counts) {
        for symbol in symbols.by_ref().take(usize::from(*count)) {
            codes[usize::from(*symbol)] = (code, length);
            code += 1;
        }
        code <<= 1;
    }
    codes
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::database::decode_color_tile;

    #[test]
    fn a_picture_of_blocks_is_what_the_blocks_say() {
        let side = 24;
        let frame = Frame::new(side, 90).unwrap();
        let mut stripes = [0; COEFFICIENTS - 1];
        // One wave along a row, and one high frequency behind many zeros.
        stripes[0] = 20;
        let mut fine = [0; COEFFICIENTS - 1];
        fine[COEFFICIENTS - 2] = -3;
        let packed = [frame.pack(0, &[]), frame.pack(0, &stripes), frame.pack(0, &fine)];
        let flat = frame.pack(1, &[]);
        let tile = frame.tile(|column, row| {
            let means = [column as i32 * 40 - 60, if row == 2 { 30 } else { 0 }, 0];
            (means, [&packed[row as usize], &flat, &flat])
        });
        let mut out = vec![0; (side * side * 4 * 2) as usize];
        decode_color_tile(&tile, side, &mut out).unwrap();
        let texel = |x: u32, y: u32| -> [u8; 4] {
            let at = ((y * side + x) * 4) as usize;
            out[at..at + 4].try_into().unwrap()
        };
        for column in 0..3 {
            let [r, g, b, a] = texel(column * 8 + 4, 3);
            let expected = 128 - 60 + column as u8 * 40;
            assert!([r, g, b].iter().all(|v| v.abs_diff(expected) <= 2) && a == 255, "{r} {g} {b}, not {expected}");
        }
        // Brighter on one side of a block than on the other; a chequered one with a colour of its
        // own.
        assert!(texel(0, 11)[1] > texel(7, 11)[1] + 10);
        assert!(texel(3, 20)[1].abs_diff(texel(4, 20)[1]) > 2);
        assert!(texel(3, 20)[2] > texel(3, 20)[1] + 20);
    }
}
