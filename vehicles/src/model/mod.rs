//! Models: triangles in the vehicle's axes (x ahead, y left, z up, metres), with materials, and the
//! same model in fewer triangles.

mod coarse;
mod error;
mod read;
mod texture;

pub use error::ModelError;
pub use texture::Texture;

use glam::Vec3;
use std::path::Path;

/// Most triangles of a model.
pub const MOST_TRIANGLES: usize = 1_000_000;

/// A corner of triangles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vertex {
    /// In the vehicle's axes.
    pub position: Vec3,
    /// Of length 1.
    pub normal: Vec3,
    /// Place in the texture: 0 to 1 from its upper left corner.
    pub uv: [f32; 2],
}

/// A triangle, counter-clockwise from its front.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Triangle {
    /// Its vertices.
    pub vertices: [u32; 3],
    /// Its material.
    pub material: u32,
}

/// What a surface looks like.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Factor on the texture's colour, or the colour: 0 to 1, as pictures store it.
    pub rgb: [f32; 3],
    /// Which texture.
    pub texture: Option<usize>,
    /// Whether its back is drawn, too.
    pub is_double_sided: bool,
}

/// Triangles.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// All corners.
    pub vertices: Vec<Vertex>,
    /// Of them.
    pub triangles: Vec<Triangle>,
}

/// A model.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// From all triangles to the fewest.
    pub levels: Vec<Mesh>,
    /// What they are made of.
    pub materials: Vec<Material>,
    /// Their textures.
    pub textures: Vec<Texture>,
    /// The middle of the box that holds it.
    pub middle: Vec3,
    /// All of it is this near to the middle.
    pub radius_m: f32,
    /// How long it is, along its x axis: the base that a vehicle on the ground stands on.
    pub length_m: f32,
}

/// Cells along the longest side of the grids that coarser levels are made on.
const COARSE_CELLS: [u32; 2] = [48, 12];
/// A coarser level has at most this share of the triangles before it, or it is not worth having.
const WORTH: f64 = 0.7;

impl Model {
    /// Reads a file of glTF 2.0 (`.gltf` with what it refers to, or `.glb`).
    ///
    /// # Errors
    /// [`ModelError`], a sentence with the file in it.
    pub fn read(path: &Path) -> Result<Self, ModelError> {
        let raw = read::read(path)?;
        Self::new(raw).ok_or_else(|| ModelError::Empty { path: path.to_owned() })
    }

    /// `None` without triangles.
    fn new(raw: read::Raw) -> Option<Self> {
        let read::Raw { mesh, mut materials, textures } = raw;
        let used = || mesh.triangles.iter().flat_map(|triangle| triangle.vertices);
        let places = || used().map(|vertex| mesh.vertices[vertex as usize].position);
        let (low, high) =
            places().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), place| (low.min(place), high.max(place)));
        if !low.is_finite() || !high.is_finite() {
            return None;
        }
        let middle = 0.5 * (low + high);
        let radius_m = places().map(|place| place.distance(middle)).fold(0.0, f32::max).max(1e-3);
        let mut levels = vec![mesh];
        // Coarser levels have one colour a material: texels are smaller than pixels there.
        let first_plain = materials.len() as u32;
        let plain: Vec<Material> = materials
            .iter()
            .map(|material| {
                let mean = material.texture.and_then(|texture| textures.get(texture)).map_or([1.0; 3], Texture::mean);
                let rgb = std::array::from_fn(|channel| material.rgb[channel] * mean[channel]);
                Material { rgb, texture: None, is_double_sided: material.is_double_sided }
            })
            .collect();
        materials.extend(plain);
        for cells in COARSE_CELLS {
            let side = (high - low).max_element() / cells as f32;
            let coarse = coarse::clustered(&levels[0], low, side, first_plain);
            let before = levels.last().map_or(0, |mesh| mesh.triangles.len());
            if !coarse.triangles.is_empty() && (coarse.triangles.len() as f64) < WORTH * before as f64 {
                levels.push(coarse);
            }
        }
        Some(Self { levels, materials, textures, middle, radius_m, length_m: high.x - low.x })
    }
}

#[cfg(test)]
mod tests;
