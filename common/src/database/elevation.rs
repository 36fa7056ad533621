//! The elevation tile codec: lossless for heights in steps of 1/128 m.
//!
//! ```text
//! "TVe1"  crc32 of all that follows  posts u16  planes u8  0 u8  zstd frame          (little endian)
//! ```
//!
//! Heights become integers (steps), each is predicted from its west, south and south west
//! neighbours on the plane through them, the error is zigzagged (small numbers of either sign
//! become small), and the bytes are split into planes, lowest first: the high ones are nearly all
//! zero. Only the planes that are needed are stored.
//!
//! A tile with posts that were not measured ([`crate::validity`]) also contains their shares:
//!
//! ```text
//! "TVe2"  crc32 of all that follows  posts u16  planes u8  0 u8  bytes of the first zstd frame u32  zstd frame  zstd frame
//! ```
//!
//! The second frame has two bytes of each post, 0 to 255: first all shares of ground, then all
//! shares that were measured.

use super::TileScratch;
use crate::validity;
use crate::world::World;

/// Steps of height in a metre. A power of two, so that heights and dyadic means of them are exact
/// in floating point.
pub const HEIGHT_STEPS_PER_M: f32 = 128.0;

const MAGIC: &[u8; 4] = b"TVe1";
/// Of a tile with validity.
const VALID_MAGIC: &[u8; 4] = b"TVe2";
const HEADER_BYTES: usize = 12;

/// Why bytes are not an elevation tile.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ElevationCodecError {
    /// They do not begin like an elevation tile.
    #[error("it is not an elevation tile ({found} bytes)")]
    NotATile {
        /// How many there are.
        found: usize,
    },
    /// They have changed since they were written.
    #[error("its checksum is {found:08x}, expected {expected:08x}")]
    Checksum {
        /// What the tile says.
        expected: u32,
        /// What its bytes give.
        found: u32,
    },
    /// It is of another size.
    #[error("it has {found} posts a side, expected {expected}")]
    Posts {
        /// What the world has.
        expected: u32,
        /// What the tile has.
        found: u16,
    },
    /// The compressed part is damaged.
    #[error("its compressed part is damaged")]
    Compressed,
    /// It has validity, in a world without validity.
    #[error("it says where no data were, which the manifest does not know of")]
    UnexpectedValidity,
}

/// Upper bound of the bytes of a tile of this world.
pub(crate) fn max_payload_bytes(world: &World) -> usize {
    let posts = world.elevation_posts() as usize;
    let validity = if world.has_validity() { 4 + zstd::zstd_safe::compress_bound(posts * posts * 2) } else { 0 };
    HEADER_BYTES + zstd::zstd_safe::compress_bound(posts * posts * 4) + validity
}

fn prediction(steps: &[i32], posts: usize, row: usize, column: usize) -> i32 {
    let at = row * posts + column;
    match (row, column) {
        (0, 0) => 0,
        (0, _) => steps[at - 1],
        (_, 0) => steps[at - posts],
        _ => steps[at - 1].wrapping_add(steps[at - posts]).wrapping_sub(steps[at - posts - 1]),
    }
}

/// Encodes a tile of `posts`² heights in metres; they are rounded to whole steps.
///
/// # Panics
/// When `heights` does not have `posts`² values or a height is not finite: ingest has filled all
/// voids before.
#[must_use]
pub fn encode_elevation_tile(heights: &[f32], posts: u32) -> Vec<u8> {
    let (plane_count, packed) = pack_heights(heights, posts);
    sealed(MAGIC, posts, plane_count, &[&packed])
}

/// Encodes a tile with the shares of its posts: of each `[ground, measured]`, 255ths. Where all is
/// measured ground, the tile is that of [`encode_elevation_tile`].
///
/// # Panics
/// As [`encode_elevation_tile`]; or when there are not `posts`² shares.
#[must_use]
pub fn encode_elevation_tile_with_validity(heights: &[f32], shares: &[[u8; 2]], posts: u32) -> Vec<u8> {
    assert_eq!(heights.len(), shares.len(), "every post has shares");
    if shares.iter().all(|share| *share == [255; 2]) {
        return encode_elevation_tile(heights, posts);
    }
    let (plane_count, packed) = pack_heights(heights, posts);
    let planes: Vec<u8> = (0..2).flat_map(|plane| shares.iter().map(move |share| share[plane])).collect();
    sealed(VALID_MAGIC, posts, plane_count, &[&(packed.len() as u32).to_le_bytes(), &packed, &compressed(&planes)])
}

fn compressed(bytes: &[u8]) -> Vec<u8> {
    zstd::bulk::compress(bytes, 9).expect("compressing into a fresh buffer of sufficient size succeeds")
}

/// Header and parts of a tile.
fn sealed(magic: &[u8; 4], posts: u32, plane_count: u8, parts: &[&[u8]]) -> Vec<u8> {
    let mut out = Vec::with_capacity(HEADER_BYTES + parts.iter().map(|part| part.len()).sum::<usize>());
    out.extend(magic);
    out.extend([0; 4]);
    out.extend((posts as u16).to_le_bytes());
    out.extend([plane_count, 0]);
    parts.iter().for_each(|part| out.extend(*part));
    let checksum = crc32fast::hash(&out[8..]);
    out[4..8].copy_from_slice(&checksum.to_le_bytes());
    out
}

/// Heights as planes of bytes, compressed, and how many planes they are.
fn pack_heights(heights: &[f32], posts: u32) -> (u8, Vec<u8>) {
    let side = posts as usize;
    assert_eq!(heights.len(), side * side, "a tile has posts² heights");
    assert!(heights.iter().all(|h| h.is_finite()), "a height in a tile is not finite");
    let steps: Vec<i32> = heights.iter().map(|h| (h * HEIGHT_STEPS_PER_M).round() as i32).collect();
    let mut errors = Vec::with_capacity(steps.len());
    for row in 0..side {
        for column in 0..side {
            let error = steps[row * side + column].wrapping_sub(prediction(&steps, side, row, column));
            errors.push(((error << 1) ^ (error >> 31)).cast_unsigned());
        }
    }
    let all = errors.iter().fold(0, |all, e| all | e);
    let plane_count = (32 - all.leading_zeros()).div_ceil(8).max(1);
    let mut planes = Vec::with_capacity(errors.len() * plane_count as usize);
    for plane in 0..plane_count {
        planes.extend(errors.iter().map(|e| (e >> (8 * plane)) as u8));
    }
    (plane_count as u8, compressed(&planes))
}

/// Checks that bytes are a tile as it was written.
///
/// # Errors
/// [`ElevationCodecError`].
pub(crate) fn check_elevation_tile(bytes: &[u8]) -> Result<(), ElevationCodecError> {
    if bytes.len() < HEADER_BYTES || (&bytes[..4] != MAGIC && &bytes[..4] != VALID_MAGIC) {
        return Err(ElevationCodecError::NotATile { found: bytes.len() });
    }
    let expected = u32::from_le_bytes([bytes[4], bytes[5], bytes[6], bytes[7]]);
    let found = crc32fast::hash(&bytes[8..]);
    if found != expected {
        return Err(ElevationCodecError::Checksum { expected, found });
    }
    Ok(())
}

/// Decodes a tile of a world into `out`, [`World::elevation_values`] numbers: heights in metres,
/// row 0 in the south, and the planes of validity where the world has them.
///
/// # Errors
/// [`ElevationCodecError`].
///
/// # Panics
/// When `out` is shorter.
pub fn decode_elevation_planes(
    world: &World,
    bytes: &[u8],
    out: &mut [f32],
    scratch: &mut TileScratch,
) -> Result<(), ElevationCodecError> {
    let posts = world.elevation_posts();
    let (heights, shares) = out[..world.elevation_values()].split_at_mut((posts * posts) as usize);
    check_elevation_tile(bytes)?;
    let has_shares = &bytes[..4] == VALID_MAGIC;
    if has_shares && !world.has_validity() {
        return Err(ElevationCodecError::UnexpectedValidity);
    }
    if !has_shares {
        shares.fill(1.0);
        return decode_heights(bytes, &bytes[HEADER_BYTES..], posts, heights, scratch);
    }
    let length = bytes.get(HEADER_BYTES..HEADER_BYTES + 4).ok_or(ElevationCodecError::Compressed)?;
    let length = u32::from_le_bytes([length[0], length[1], length[2], length[3]]) as usize;
    let packed = &bytes[HEADER_BYTES + 4..];
    let (packed_heights, packed_shares) = packed.split_at_checked(length).ok_or(ElevationCodecError::Compressed)?;
    decode_heights(bytes, packed_heights, posts, heights, scratch)?;
    let planes = &mut scratch.planes[..shares.len()];
    match scratch.zstd.decompress_to_buffer(packed_shares, planes) {
        Ok(length) if length == planes.len() => {}
        _ => return Err(ElevationCodecError::Compressed),
    }
    shares.iter_mut().zip(planes).for_each(|(share, byte)| *share = f32::from(*byte) / 255.0);
    Ok(())
}

const _: () = assert!(validity::PLANES == 3 && validity::GROUND_PLANE == 1 && validity::MEASURED_PLANE == 2);

/// Decodes a tile of a world without validity into `out`, `posts`² heights in metres, row 0 in the
/// south.
///
/// # Errors
/// [`ElevationCodecError`].
///
/// # Panics
/// When `out` is shorter than `posts`².
pub fn decode_elevation_tile(
    bytes: &[u8],
    posts: u32,
    out: &mut [f32],
    scratch: &mut TileScratch,
) -> Result<(), ElevationCodecError> {
    let side = posts as usize;
    let out = &mut out[..side * side];
    check_elevation_tile(bytes)?;
    if &bytes[..4] == VALID_MAGIC {
        return Err(ElevationCodecError::UnexpectedValidity);
    }
    decode_heights(bytes, &bytes[HEADER_BYTES..], posts, out, scratch)
}

/// Heights from their compressed part, which is `packed`.
fn decode_heights(
    bytes: &[u8],
    packed: &[u8],
    posts: u32,
    out: &mut [f32],
    scratch: &mut TileScratch,
) -> Result<(), ElevationCodecError> {
    let side = posts as usize;
    let found = u16::from_le_bytes([bytes[8], bytes[9]]);
    if u32::from(found) != posts {
        return Err(ElevationCodecError::Posts { expected: posts, found });
    }
    let plane_count = usize::from(bytes[10]);
    if !(1..=4).contains(&plane_count) {
        return Err(ElevationCodecError::Compressed);
    }
    let samples = side * side;
    scratch.planes.resize(4 * samples, 0);
    let planes = &mut scratch.planes[..plane_count * samples];
    match scratch.zstd.decompress_to_buffer(packed, planes) {
        Ok(length) if length == planes.len() => {}
        _ => return Err(ElevationCodecError::Compressed),
    }
    let step_m = 1.0 / HEIGHT_STEPS_PER_M;
    let [mut south, mut south_west] = [0i32; 2];
    // The predictor needs the row to the south as integers. Heights are whole steps, so they are
    // recovered exactly.
    for at in 0..samples {
        let mut zigzag = 0u32;
        for plane in 0..plane_count {
            zigzag |= u32::from(planes[plane * samples + at]) << (8 * plane);
        }
        let error = (zigzag >> 1).cast_signed() ^ -(zigzag & 1).cast_signed();
        let steps = |at: usize| (out[at] * HEIGHT_STEPS_PER_M) as i32;
        let (row, column) = (at / side, at % side);
        if row > 0 {
            south_west = south;
            south = steps(at - side);
        }
        let predicted = match (row, column) {
            (0, 0) => 0,
            (0, _) => steps(at - 1),
            (_, 0) => south,
            _ => steps(at - 1).wrapping_add(south).wrapping_sub(south_west),
        };
        out[at] = predicted.wrapping_add(error) as f32 * step_m;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn heights(side: usize, seed: u32, relief: f32) -> Vec<f32> {
        (0..side * side)
            .map(|i| {
                let noise = (i as u32).wrapping_mul(2_654_435_761).wrapping_add(seed) >> 20;
                ((noise as f32 - 2048.0) * relief).round() / HEIGHT_STEPS_PER_M
            })
            .collect()
    }

    fn world(posts: u32) -> World {
        let fields = crate::world::WorldFields {
            origin: [0.0; 2],
            lattice_unit_m: 1.0,
            extent: [posts - 1; 2],
            elevation_tile: posts - 1,
            color_tile: 16,
            levels: 1,
            finest_elevation_level: 0,
            finest_color_level: 0,
            body: None,
        };
        World::new(fields).unwrap().with_validity(true)
    }

    fn shares(count: usize, seed: u32) -> Vec<[u8; 2]> {
        let byte = |i: usize| ((i as u32).wrapping_mul(2_654_435_761).wrapping_add(seed) >> 24) as u8;
        (0..count).map(|i| [byte(i), byte(2 * i)]).collect()
    }

    #[test]
    fn tiles_of_measured_ground_are_as_they_always_were() {
        let heights = heights(9, 1, 50.0);
        let plain = encode_elevation_tile(&heights, 9);
        assert_eq!(encode_elevation_tile_with_validity(&heights, &[[255; 2]; 81], 9), plain);
        let mut out = vec![0.0; 3 * 81];
        decode_elevation_planes(&world(9), &plain, &mut out, &mut TileScratch::default()).unwrap();
        assert!(out[..81] == heights[..] && out[81..].iter().all(|share| *share == 1.0));
    }

    #[test]
    fn validity_in_a_world_without_is_damage() {
        let tile = encode_elevation_tile_with_validity(&heights(9, 1, 50.0), &shares(81, 3), 9);
        let mut out = vec![0.0; 81];
        let error = decode_elevation_tile(&tile, 9, &mut out, &mut TileScratch::default()).unwrap_err();
        assert!(matches!(error, ElevationCodecError::UnexpectedValidity));
    }

    proptest! {
        #[test]
        fn validity_is_kept_and_changes_of_it_are_noticed(
            log_side in 1u32..6, seed: u32, at: prop::sample::Index, bit in 0u8..8, cut: prop::sample::Index,
            body in prop::collection::vec(any::<u8>(), 0..99), length in 0u32..120,
        ) {
            let posts = (1 << log_side) + 1;
            let (world, count) = (world(posts), (posts * posts) as usize);
            let (heights, shares) = (heights(posts as usize, seed, 100.0), shares(count, seed));
            let tile = encode_elevation_tile_with_validity(&heights, &shares, posts);
            prop_assert!(tile.len() <= max_payload_bytes(&world));
            let mut out = vec![0.0; 3 * count];
            let mut scratch = TileScratch::default();
            decode_elevation_planes(&world, &tile, &mut out, &mut scratch).unwrap();
            prop_assert_eq!(&out[..count], &heights[..]);
            let bytes = |plane: usize| out[plane * count..(plane + 1) * count].iter().map(|v| (v * 255.0).round() as u8);
            let found: Vec<[u8; 2]> = bytes(1).zip(bytes(2)).map(|(ground, measured)| [ground, measured]).collect();
            prop_assert_eq!(found, shares);
            let mut changed = tile.clone();
            changed[at.index(tile.len())] ^= 1 << bit;
            prop_assert!(decode_elevation_planes(&world, &changed, &mut out, &mut scratch).is_err());
            prop_assert!(decode_elevation_planes(&world, &tile[..cut.index(tile.len())], &mut out, &mut scratch).is_err());
            // With a good checksum: whatever comes of it, no panic.
            let mut forged = tile[..HEADER_BYTES].to_vec();
            forged.extend(length.to_le_bytes());
            forged.extend(&body);
            let checksum = crc32fast::hash(&forged[8..]);
            forged[4..8].copy_from_slice(&checksum.to_le_bytes());
            prop_assert!(decode_elevation_planes(&world, &forged, &mut out, &mut scratch).is_err());
        }

        #[test]
        fn what_was_encoded_is_decoded_bit_for_bit(side in 3usize..40, seed: u32, relief in 0f32..2000.0) {
            let heights = heights(side, seed, relief);
            let tile = encode_elevation_tile(&heights, side as u32);
            let mut out = vec![0.0; side * side];
            decode_elevation_tile(&tile, side as u32, &mut out, &mut TileScratch::default()).unwrap();
            prop_assert_eq!(heights, out);
        }

        #[test]
        fn a_changed_or_cut_tile_is_refused(seed: u32, at: prop::sample::Index, bit in 0u8..8, cut: prop::sample::Index) {
            let tile = encode_elevation_tile(&heights(9, seed, 100.0), 9);
            let mut out = vec![0.0; 81];
            let mut scratch = TileScratch::default();
            let mut changed = tile.clone();
            changed[at.index(tile.len())] ^= 1 << bit;
            prop_assert!(decode_elevation_tile(&changed, 9, &mut out, &mut scratch).is_err());
            prop_assert!(decode_elevation_tile(&tile[..cut.index(tile.len())], 9, &mut out, &mut scratch).is_err());
        }

        #[test]
        fn any_bytes_with_a_good_checksum_are_a_tile_or_an_error(body in prop::collection::vec(any::<u8>(), 0..300)) {
            let mut tile = [MAGIC.as_slice(), &crc32fast::hash(&body).to_le_bytes()].concat();
            tile.extend(body);
            let mut out = vec![0.0; 81];
            // Whatever comes of it: no panic.
            prop_assert!(decode_elevation_tile(&tile, 9, &mut out, &mut TileScratch::default()).is_ok() || tile.len() > 7);
        }
    }
}
