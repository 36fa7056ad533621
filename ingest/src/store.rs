//! Levels on disk: raw rasters in unnamed temporary files, so that memory does not grow with the
//! world.
//!
//! Row 0 is the southernmost. Files are unlinked at once, so that nothing is left, however the
//! process ends.

use bytemuck::Pod;
use std::fs::{self, File, OpenOptions};
use std::io;
use std::marker::PhantomData;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// A rectangle of samples, `size` `[columns, rows]` from the south west corner `origin`, which may
/// lie outside a level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rect {
    /// Its first column and row.
    pub origin: [i64; 2],
    /// Columns and rows.
    pub size: [usize; 2],
}

impl Rect {
    /// A rectangle.
    #[must_use]
    pub fn new(origin: [i64; 2], size: [usize; 2]) -> Self {
        Self { origin, size }
    }

    /// Number of samples.
    #[must_use]
    pub fn area(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// The rectangle, extended by `by` on each side.
    #[must_use]
    pub fn grown(&self, by: usize) -> Self {
        let origin = self.origin.map(|v| v - by as i64);
        Self { origin, size: self.size.map(|v| v + 2 * by) }
    }
}

/// One level of a pyramid.
#[derive(Debug)]
pub struct Level<T> {
    file: File,
    size: [u64; 2],
    samples: PhantomData<T>,
}

impl<T: Pod> Level<T> {
    /// A level of `[columns, rows]` in a folder.
    ///
    /// # Errors
    /// What the file system says.
    pub fn create(folder: &Path, size: [u64; 2]) -> io::Result<Self> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        // Relaxed: the number only has to differ from others of this process.
        let name = format!(".level-{}-{}.tmp", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let path = folder.join(name);
        let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path)?;
        fs::remove_file(&path)?;
        file.set_len(size[0] * size[1] * size_of::<T>() as u64)?;
        Ok(Self { file, size, samples: PhantomData })
    }

    /// Columns and rows.
    #[must_use]
    pub fn size(&self) -> [u64; 2] {
        self.size
    }

    /// Rectangles of at most `side`² that cover it, row by row from the south.
    #[must_use]
    pub fn blocks(&self, side: usize) -> Blocks {
        Blocks::new(self.size, side)
    }

    /// Reads a rectangle; outside the level the nearest sample inside is repeated.
    ///
    /// # Errors
    /// What the file system says.
    pub fn read(&self, rect: Rect) -> io::Result<Vec<T>> {
        let mut out = vec![T::zeroed(); rect.area()];
        let [columns, rows] = self.size.map(|v| v as i64);
        let clamp = |v: i64, count: i64| v.clamp(0, count - 1);
        let [x0, y0] = rect.origin;
        let (first, last) = (clamp(x0, columns), clamp(x0 + rect.size[0] as i64 - 1, columns));
        let inside = (last - first + 1) as usize;
        // Columns of `out` left of the first one inside.
        let west = (first - x0).clamp(0, rect.size[0] as i64 - inside as i64) as usize;
        let mut row_before = None;
        for j in 0..rect.size[1] {
            let row = clamp(y0 + j as i64, rows);
            let (before, line) = out.split_at_mut(j * rect.size[0]);
            let line = &mut line[..rect.size[0]];
            if row_before == Some(row) {
                line.copy_from_slice(&before[(j - 1) * rect.size[0]..]);
                continue;
            }
            row_before = Some(row);
            let at = (row * columns + first) as u64 * size_of::<T>() as u64;
            let middle = &mut line[west..west + inside];
            self.file.read_exact_at(bytemuck::cast_slice_mut(middle), at)?;
            let (left, right) = (line[west], line[west + inside - 1]);
            line[..west].fill(left);
            line[west + inside..].fill(right);
        }
        Ok(out)
    }

    /// Writes a rectangle that lies inside the level.
    ///
    /// # Errors
    /// What the file system says.
    pub fn write(&self, rect: Rect, samples: &[T]) -> io::Result<()> {
        debug_assert_eq!(samples.len(), rect.area());
        for (j, line) in samples.chunks_exact(rect.size[0]).enumerate() {
            let at = (rect.origin[1] as u64 + j as u64) * self.size[0] + rect.origin[0] as u64;
            self.file.write_all_at(bytemuck::cast_slice(line), at * size_of::<T>() as u64)?;
        }
        Ok(())
    }
}

/// The blocks of a level, by number.
#[derive(Debug, Clone, Copy)]
pub struct Blocks {
    size: [u64; 2],
    side: usize,
    columns: usize,
    rows: usize,
}

impl Blocks {
    /// Blocks of at most `side`² that cover `[columns, rows]` samples.
    #[must_use]
    pub fn new(size: [u64; 2], side: usize) -> Self {
        let [columns, rows] = size.map(|v| v.div_ceil(side as u64) as usize);
        Self { size, side, columns, rows }
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.columns * self.rows
    }

    /// Block number `index`.
    #[must_use]
    pub fn rect(&self, index: usize) -> Rect {
        let at = [index % self.columns * self.side, index / self.columns * self.side];
        let size = [0, 1].map(|axis| (self.size[axis] - at[axis] as u64).min(self.side as u64) as usize);
        Rect::new(at.map(|v| v as i64), size)
    }
}

/// One colour sample, 8 bit.
pub type Rgb = [u8; 3];

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn reading_repeats_the_border(x in -9i64..14, y in -9i64..12, w in 1usize..20, h in 1usize..20) {
            let level = Level::<f32>::create(&std::env::temp_dir(), [5, 4]).unwrap();
            let all: Vec<f32> = (0..20).map(|v| v as f32).collect();
            level.write(Rect::new([0, 0], [5, 4]), &all).unwrap();
            let read = level.read(Rect::new([x, y], [w, h])).unwrap();
            for j in 0..h {
                for i in 0..w {
                    let at = (y + j as i64).clamp(0, 3) * 5 + (x + i as i64).clamp(0, 4);
                    prop_assert_eq!(read[j * w + i], all[at as usize]);
                }
            }
        }

        #[test]
        fn blocks_cover_every_sample_once(w in 1u64..50, h in 1u64..50, side in 1usize..20) {
            let blocks = Blocks::new([w, h], side);
            let mut seen = vec![0; (w * h) as usize];
            for rect in (0..blocks.count()).map(|i| blocks.rect(i)) {
                for j in 0..rect.size[1] {
                    for i in 0..rect.size[0] {
                        seen[(rect.origin[1] as usize + j) * w as usize + rect.origin[0] as usize + i] += 1;
                    }
                }
            }
            prop_assert!(seen.iter().all(|&n| n == 1));
        }
    }
}
