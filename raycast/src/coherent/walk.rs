//! The samples of one ray: from plane to plane, skipping blocks and nodes that lie wholly below it.

use super::planes::Planes;
use super::surface::Sample;
use super::voxels::Current;
use crate::counts::Counts;
use crate::model::{LOG_BLOCK, THRESHOLD, Tile};
use crate::scene::{Place, Scene};
use crate::view::Ray;
use glam::Vec3;

/// Rays through the voxels of a frame.
#[derive(Debug)]
pub(crate) struct VoxelRays<'a> {
    pub(crate) scene: &'a Scene<'a>,
    pub(crate) planes: &'a Planes,
    /// How fast densities may fall along a ray that leaves the ground, per voxel; minus infinity
    /// when rays do not look between samples.
    pub(crate) fall: f32,
}

/// How a walk along a ray ended.
#[derive(Debug, Clone, Copy)]
pub(super) enum End {
    /// A sample is in the ground.
    Hit(Sample),
    /// All samples before this plane are in the air, and there is no ground after it.
    Left(u32),
}

impl VoxelRays<'_> {
    /// A tile, ready to be sampled.
    pub(super) fn enter(&self, index: u32) -> Option<Current<'_>> {
        let ground = self.scene.ground;
        let tile: &Tile = ground.tiles().get(index as usize)?;
        let placed = self.scene.placed.get(index as usize)?;
        Some(Current {
            index,
            spans: ground.spans(tile),
            heights: ground.heights(tile),
            densities: ground.densities(tile),
            blocks: ground.blocks(tile),
            cells: tile.cells,
            layers: tile.voxels.layers as usize,
            is_accurate: tile.voxels.is_accurate,
            per_m: placed.per_m,
            at_0: -placed.corner * placed.per_m,
            datum: (-self.scene.eye_height - placed.corner.z) * placed.per_m,
        })
    }

    /// Takes the samples of a ray from plane `from` up to `end`. `current` is the tile to begin in,
    /// and afterwards the tile where the walk ended. With `SKIPS` it skips blocks and nodes that
    /// lie wholly below the ray.
    #[inline(always)]
    pub(super) fn walk<'f, const APPROXIMATE: bool, const SKIPS: bool>(
        &'f self,
        ray: &Ray,
        from: u32,
        end: u32,
        current: &mut Current<'f>,
        counts: &mut Counts,
    ) -> End {
        let planes = &self.planes.s()[..(end as usize).min(self.planes.s().len())];
        let mut k = from as usize;
        let mut is_found = false;
        // Density at the plane before, if it was sampled.
        let mut outside = None;
        // There is no plane before the first one.
        let mut looked_at = usize::MAX - 1;
        let hit = |k: usize, inside, outside| End::Hit(Sample { plane: k as u32, inside, outside, crossing: None });
        loop {
            // A copy, to keep it in registers.
            let tile = *current;
            let per_s = ray.direction * tile.per_m;
            let has_voxels = !APPROXIMATE && tile.is_accurate;
            let fall_per_s = self.fall * per_s.length();
            let mut looked_at_block = u32::MAX;
            loop {
                let Some(&s) = planes.get(k) else { return End::Left(end) };
                let mut at = tile.at(per_s, s);
                let Some(([i, j], low)) = tile.cell_at(&mut at, is_found) else { break };
                is_found = false;
                let span = tile.span(i, j);
                counts.samples += 1;
                let is_next = looked_at + 1 == k;
                looked_at = k;
                if at.z >= f32::from(span.highest) + 1.0 {
                    if let Some(before) = outside
                        && is_next
                        && let Some(sample) =
                            self.between::<APPROXIMATE>(ray, k, [Some(before), None], fall_per_s, current, counts)
                    {
                        return End::Hit(sample);
                    }
                    k += 1;
                    if SKIPS {
                        let block = tile.block_of(i, j);
                        if block != looked_at_block {
                            looked_at_block = block;
                            k = self.skip(&tile, per_s, [i, j], at.z, block, k);
                        }
                    }
                    outside = None;
                    continue;
                }
                if at.z < f32::from(span.lowest) {
                    return hit(k, None, outside);
                }
                counts.densities += u64::from(has_voxels);
                let density = tile.density_in([i, j], low, at, has_voxels);
                if density > THRESHOLD {
                    return hit(k, Some(density), outside);
                }
                if is_next
                    && let Some(sample) =
                        self.between::<APPROXIMATE>(ray, k, [outside, Some(density)], fall_per_s, current, counts)
                {
                    return End::Hit(sample);
                }
                outside = Some(density);
                k += 1;
            }
            let before = k;
            (*current, k) = match self.next_tile::<SKIPS>(ray, planes, k) {
                Ok(next) => next,
                Err(None) => return End::Left(end),
                Err(Some(plane)) => return End::Left(plane),
            };
            outside = outside.filter(|_| k == before);
            is_found = true;
        }
    }

    /// The first plane from `k` on that may be in the ground, and the tile there; or the plane from
    /// which on there is no ground, `None` for the last one.
    #[inline(always)]
    fn next_tile<const SKIPS: bool>(
        &self,
        ray: &Ray,
        planes: &[f32],
        mut k: usize,
    ) -> Result<(Current<'_>, usize), Option<u32>> {
        loop {
            let Some(&s) = planes.get(k) else { return Err(None) };
            let exit = match self.scene.find(ray, s) {
                Place::Tile(tile) => match SKIPS.then(|| self.scene.skip_nodes(ray, s)).flatten() {
                    Some(exit) => exit,
                    None => return self.enter(tile).map(|next| (next, k)).ok_or(Some(k as u32)),
                },
                Place::HoleUntil(exit) => exit,
                Place::Left => return Err(Some(k as u32)),
            };
            k = (k + 1).max(self.planes.at_or_after(exit) as usize);
        }
    }

    /// The first plane from `k` on at which a ray may no longer be above all boundary cells of a
    /// block.
    fn skip(&self, current: &Current<'_>, per_s: Vec3, cell: [u32; 2], height: f32, block: u32, k: usize) -> usize {
        let Some(highest) = current.blocks.get(block as usize) else { return k };
        let top = f32::from(*highest) + 1.0;
        if height < top {
            return k;
        }
        let mut s = f32::INFINITY;
        for (axis, cell) in cell.into_iter().enumerate() {
            let low = (cell >> LOG_BLOCK) << LOG_BLOCK;
            let high = (low + (1 << LOG_BLOCK)).min(current.cells[axis]);
            let (per_s, at_0) = (per_s[axis], current.at_0[axis]);
            if per_s > 0.0 {
                s = s.min((high as f32 - at_0) / per_s);
            } else if per_s < 0.0 {
                s = s.min((low as f32 - at_0) / per_s);
            }
        }
        if per_s.z < 0.0 {
            s = s.min((top - current.at_0.z) / per_s.z);
        }
        // One plane earlier, for rounding.
        k.max(self.planes.at_or_after(s).saturating_sub(1) as usize)
    }
}
