//! All sources of a layer for one thread: open files, and samples beyond the edge of a file.

use super::kernel::Kernel;
use super::mapper::Mapper;
use super::neighbors::{Neighbor, common, neighbors};
use super::{MAX_WINDOW_PIXELS, Sampled, Sampler};
use crate::IngestError;
use crate::plan::{Bounds, Lattice};
use crate::source::readers::Reader;
use crate::source::window::Window;
use crate::source::{Raster, TargetCrs};
use crate::store::Rect;
use std::collections::VecDeque;

/// Maximum number of open files per thread.
const MAX_OPEN: usize = 24;

/// A cache of values by number, made when first needed; the oldest is dropped when there are too
/// many.
#[derive(Debug)]
struct Kept<T> {
    items: Vec<Option<T>>,
    order: VecDeque<usize>,
}

impl<T> Kept<T> {
    fn new(count: usize) -> Self {
        Self { items: (0..count).map(|_| None).collect(), order: VecDeque::new() }
    }

    fn get(&mut self, index: usize, make: impl FnOnce() -> Result<T, IngestError>) -> Result<&mut T, IngestError> {
        if self.items[index].is_none() {
            if self.order.len() == MAX_OPEN {
                self.order.pop_front().into_iter().for_each(|oldest| self.items[oldest] = None);
            }
            self.items[index] = Some(make()?);
            self.order.push_back(index);
        }
        // It was just made, if it was missing.
        self.items[index].as_mut().ok_or_else(|| IngestError::usage("a source was not opened"))
    }
}

/// How a file is opened.
type Open<'a, V, R> = fn(&'a Raster, &'a V) -> Result<R, IngestError>;

/// All sources of a layer, for one thread: opened when a block first meets them, closed when others
/// are needed more. (A world may have more files than a process may have open.)
pub struct SourceSet<'a, V, R> {
    sources: &'a [(Raster, V)],
    bounds: &'a [Bounds],
    target: &'a TargetCrs,
    lattice: Lattice,
    open: Open<'a, V, R>,
    kernel: fn([f64; 2]) -> Kernel,
    samplers: Kept<Sampler>,
    readers: Kept<R>,
    range: [f32; 2],
}

impl<'a, V, R> SourceSet<'a, V, R> {
    /// The sources, with their bounds, for samples on a lattice; `kernel` makes the kernel for a
    /// number of source pixels per sample.
    pub fn new(
        sources: &'a [(Raster, V)],
        bounds: &'a [Bounds],
        target: &'a TargetCrs,
        lattice: Lattice,
        open: Open<'a, V, R>,
        kernel: fn([f64; 2]) -> Kernel,
    ) -> Self {
        let count = sources.len();
        let (samplers, readers) = (Kept::new(count), Kept::new(count));
        Self { sources, bounds, target, lattice, open, kernel, samplers, readers, range: [f32::MAX, f32::MIN] }
    }

    /// Smallest and largest sample of the sources so far, where they have data and are on top.
    #[must_use]
    pub fn range(&self) -> [f32; 2] {
        self.range
    }

    /// Samples a block: at each place the value of the first source that has data.
    ///
    /// # Errors
    /// [`IngestError::Source`] when a source cannot be read.
    pub fn sample<const C: usize>(&mut self, block: Rect) -> Result<Vec<Sampled<C>>, IngestError>
    where
        R: Reader<C>,
    {
        self.sample_where(block, |_| true, |_| false)
    }

    /// Samples a block from the `wanted` sources, except where it is `left_out`.
    ///
    /// # Errors
    /// [`IngestError::Source`] when a source cannot be read.
    pub fn sample_where<const C: usize>(
        &mut self,
        block: Rect,
        is_wanted: impl Fn(u32) -> bool,
        is_left_out: impl Fn(usize) -> bool,
    ) -> Result<Vec<Sampled<C>>, IngestError>
    where
        R: Reader<C>,
    {
        let mut values = vec![Sampled::Outside; block.area()];
        for source in (0u32..).take(self.sources.len()).filter(|source| is_wanted(*source)) {
            if !self.bounds[source as usize].meets(&self.lattice, block) {
                continue;
            }
            if (0..block.area()).all(|at| matches!(values[at], Sampled::Value(..)) || is_left_out(at)) {
                break;
            }
            self.sample_one(source, block, &is_left_out, &mut values)?;
        }
        Ok(values)
    }

    /// Adds what one source has to the values of a block.
    fn sample_one<const C: usize>(
        &mut self,
        source: u32,
        block: Rect,
        is_left_out: &impl Fn(usize) -> bool,
        values: &mut [Sampled<C>],
    ) -> Result<(), IngestError>
    where
        R: Reader<C>,
    {
        let index = source as usize;
        let Self { sources, bounds, target, lattice, open, kernel, samplers, readers, range } = self;
        let (sources, open) = (*sources, *open);
        let sampler = samplers.get(index, || {
            let mapper = Mapper::new(target, &sources[index].0)?;
            let scale = mapper.scale_at(bounds[index].focus, lattice.step);
            // A kernel must not need more than a window has.
            let most = (MAX_WINDOW_PIXELS as f64).sqrt() / 8.0;
            let kernel = kernel(scale.map(|s| s.min(most)));
            let neighbors = neighbors(sources, index, kernel.reach());
            Ok(Sampler::new(mapper, kernel, neighbors))
        })?;
        let mut read = |neighbors: &[Neighbor], rect: Rect| {
            read_window(neighbors, index, rect, &mut |source, part: Rect| {
                let (raster, values) = &sources[source];
                let reader = readers.get(source, || open(raster, values))?;
                reader.read(part.origin.map(|v| v as usize), part.size)
            })
        };
        let mut positions = sampler.positions(lattice, block);
        for (at, position) in positions.iter_mut().enumerate() {
            match values[at] {
                Sampled::Outside | Sampled::Void if position.is_some() && !is_left_out(at) => {
                    values[at] = Sampled::Void
                }
                _ => *position = None,
            }
        }
        let mut put = |at: usize, value| values[at] = Sampled::Value(source, value);
        sampler.sample(&positions, block.size[0], &mut put, &mut read)?;
        let met = sampler.range();
        *range = [range[0].min(met[0]), range[1].max(met[1])];
        Ok(())
    }
}

/// A rectangle of the grid of source `index`, from it and its neighbours: of several that have data
/// at a pixel, the first. Pixels that no file has are those of the nearest border.
fn read_window<const C: usize>(
    neighbors: &[Neighbor],
    index: usize,
    rect: Rect,
    read: &mut dyn FnMut(usize, Rect) -> Result<Window<C>, IngestError>,
) -> Result<Window<C>, IngestError> {
    let met: Vec<(Neighbor, Rect)> = neighbors.iter().filter_map(|n| Some((*n, common(n.place, rect)?))).collect();
    let of = |n: &Neighbor, part: Rect| Rect::new([0, 1].map(|k| part.origin[k] - n.place.origin[k]), part.size);
    if let [(only, part)] = &met[..]
        && *part == rect
    {
        return Ok(read(only.source, of(only, rect))?.moved_to(rect.origin));
    }
    let mut window = Window::placed(rect.origin, rect.size);
    let (mut is_covered, mut has_data) = (vec![false; rect.area()], vec![false; rect.area()]);
    for (neighbor, part) in &met {
        let piece = read(neighbor.source, of(neighbor, *part))?;
        let first = [0, 1].map(|k| (part.origin[k] - rect.origin[k]) as usize);
        for row in 0..part.size[1] {
            for column in 0..part.size[0] {
                let at = (first[1] + row) * rect.size[0] + first[0] + column;
                is_covered[at] = true;
                if let Some(pixel) = piece.known(row * part.size[0] + column).filter(|_| !has_data[at]) {
                    has_data[at] = true;
                    window.pixels[at] = pixel;
                }
            }
        }
    }
    let own = neighbors.iter().find(|n| n.source == index).map_or(rect, |n| Rect::new([0, 0], n.place.size));
    for at in 0..rect.area() {
        let place = [at % rect.size[0], at / rect.size[0]];
        let from = if is_covered[at] { Some(at) } else { nearest_border(rect, own, place, &is_covered) };
        match from.filter(|from| has_data[*from]) {
            Some(from) => window.pixels[at] = window.pixels[from],
            None => window.mask(at),
        }
    }
    Ok(window)
}

/// The pixel that is repeated beyond all files: straight across the own border if it exists,
/// otherwise at the corner.
fn nearest_border(rect: Rect, own: Rect, place: [usize; 2], is_covered: &[bool]) -> Option<usize> {
    let clamped = [0, 1].map(|k| {
        let first = (own.origin[k] - rect.origin[k]).max(0);
        let last = (own.origin[k] + own.size[k] as i64 - 1 - rect.origin[k]).min(rect.size[k] as i64 - 1);
        (place[k] as i64).min(last).max(first) as usize
    });
    [[clamped[0], place[1]], [place[0], clamped[1]], clamped]
        .into_iter()
        .filter(|p| p[0] < rect.size[0] && p[1] < rect.size[1])
        .map(|p| p[1] * rect.size[0] + p[0])
        .find(|at| is_covered[*at])
}

impl<V, R> std::fmt::Debug for SourceSet<'_, V, R> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SourceSet")
            .field("sources", &self.sources.len())
            .field("open", &self.readers.order)
            .finish_non_exhaustive()
    }
}
