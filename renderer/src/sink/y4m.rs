//! Pictures as frames of Y4M: uncompressed film for other programs, 4:4:4, 8 bits, limited range.
//! Which matrix makes their colours stands with [`Matrix`].

use terravision_common::film::{Matrix, Y4M_FRAME};

/// One frame of Y4M from RGBA, into `out`. In integers: the same bytes everywhere.
pub(super) fn frame(size: [u32; 2], rgba: &[u8], out: &mut Vec<u8>) {
    let count = rgba.len() / 4;
    out.clear();
    out.extend_from_slice(Y4M_FRAME);
    out.resize(Y4M_FRAME.len() + 3 * count, 0);
    let (y_plane, rest) = out[Y4M_FRAME.len()..].split_at_mut(count);
    let (cb_plane, cr_plane) = rest.split_at_mut(count);
    let [kr, kg, kb] = weights(Matrix::for_size(size));
    // Y = 16 + 219/255 * luma; Cb = 128 + 224/255 * (B - luma) / (2 (1 - Kb)): 2^16 fixed point,
    // luma in 2^16ths.
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

/// Kr, Kg and Kb of the standard, in 65536ths.
fn weights(matrix: Matrix) -> [i32; 3] {
    match matrix {
        Matrix::Bt601 => [19595, 38470, 7471],
        Matrix::Bt709 => [13933, 46871, 4732],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn planes(size: [u32; 2], rgb: [u8; 3]) -> [u8; 3] {
        let mut out = Vec::new();
        frame(size, &[rgb[0], rgb[1], rgb[2], 255], &mut out);
        assert!(out.starts_with(b"FRAME\n") && out.len() == 9);
        [out[6], out[7], out[8]]
    }

    #[test]
    fn colours_have_the_values_of_the_standards() {
        let [small, large] = [[320, 180], [1280, 720]];
        for size in [small, large] {
            assert_eq!(planes(size, [0, 0, 0]), [16, 128, 128]);
            assert_eq!(planes(size, [255, 255, 255]), [235, 128, 128]);
        }
        // Reference values: 601 red (81, 90, 240), 709 green (173, 42, 26), 709 blue (32, 240,
        // 118).
        assert_eq!(planes(small, [255, 0, 0]), [81, 90, 240]);
        assert_eq!(planes(large, [0, 255, 0]), [173, 42, 26]);
        assert_eq!(planes(large, [0, 0, 255]), [32, 240, 118]);
    }
}
