//! glTF 2.0: the meshes of the scene, placed by their nodes, with base colours and their textures.
//!
//! The document is checked by the `gltf` crate. Bytes are read here, each range checked against the
//! file that it is in.

use super::coarse::flat_normal;
use super::{MOST_TRIANGLES, Material, Mesh, ModelError, Texture, Triangle, Vertex};
use base64::Engine;
use glam::{Mat4, Vec3};
use gltf::accessor::{DataType, Dimensions};
use gltf::mesh::Mode;
use gltf::{Accessor, Gltf, Node, Primitive, Semantic};
use std::path::{Path, PathBuf};
use terravision_common::bug::contained;
use terravision_common::files::read_bounded;

/// Most bytes of a file that a model is made of.
const MOST_MODEL_BYTES: u64 = 256 << 20;
/// Most nodes within each other, and in all, counted as often as they are in the scene.
const MOST_DEPTH: usize = 64;
const MOST_NODES: usize = 100_000;

/// A model as it is in its file.
pub(super) struct Raw {
    pub(super) mesh: Mesh,
    pub(super) materials: Vec<Material>,
    pub(super) textures: Vec<Texture>,
}

/// Reads a model.
pub(super) fn read(path: &Path) -> Result<Raw, ModelError> {
    let malformed = |reason: String| ModelError::Malformed { path: path.to_owned(), reason };
    let bytes = read_bounded(path, MOST_MODEL_BYTES);
    let bytes = bytes.map_err(|source| ModelError::Read { path: path.to_owned(), file: path.to_owned(), source })?;
    let parsed = contained(|| Gltf::from_slice(&bytes)).map_err(|panic| malformed(panic.to_string()))?;
    let Gltf { document, blob } = parsed.map_err(|error| malformed(error.to_string()))?;
    if let Some(extension) = document.extensions_required().next() {
        return Err(ModelError::Unsupported { path: path.to_owned(), what: format!("the extension {extension}") });
    }
    let mut reader = Reader { path, buffers: Vec::new(), mesh: Mesh::default(), nodes: 0 };
    let mut blob = blob;
    for buffer in document.buffers() {
        let bytes = match buffer.source() {
            gltf::buffer::Source::Bin => blob.take().ok_or_else(|| malformed("it has no binary part".into()))?,
            gltf::buffer::Source::Uri(uri) => reader.referred(uri)?,
        };
        reader.buffers.push(bytes);
    }
    let materials = document.materials().map(|material| material_of(&material));
    // The last one is that of what has none.
    let plain = Material { rgb: [1.0; 3], texture: None, is_double_sided: false };
    let materials: Vec<Material> = materials.chain([plain]).collect();
    let textures = document.images().map(|image| reader.texture(&image)).collect::<Result<_, _>>()?;
    let scene = document.default_scene().or_else(|| document.scenes().next());
    for node in scene.into_iter().flat_map(|scene| scene.nodes()) {
        reader.node(&node, Mat4::IDENTITY, materials.len() as u32 - 1, MOST_DEPTH)?;
    }
    Ok(Raw { mesh: reader.mesh, materials, textures })
}

fn material_of(material: &gltf::Material<'_>) -> Material {
    let base = material.pbr_metallic_roughness();
    let [r, g, b, _] = base.base_color_factor();
    let texture = base.base_color_texture().map(|texture| texture.texture().source().index());
    Material { rgb: [r, g, b].map(stored), texture, is_double_sided: material.double_sided() }
}

/// A linear factor as pictures store it (IEC 61966-2-1): textures are multiplied as they are
/// stored.
fn stored(linear: f32) -> f32 {
    let linear = linear.clamp(0.0, 1.0);
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

struct Reader<'a> {
    path: &'a Path,
    buffers: Vec<Vec<u8>>,
    mesh: Mesh,
    nodes: usize,
}

impl Reader<'_> {
    fn malformed(&self, reason: impl Into<String>) -> ModelError {
        ModelError::Malformed { path: self.path.to_owned(), reason: reason.into() }
    }

    fn unsupported(&self, what: impl Into<String>) -> ModelError {
        ModelError::Unsupported { path: self.path.to_owned(), what: what.into() }
    }

    /// What a URI refers to: bytes in it, or a file beside the model.
    fn referred(&self, uri: &str) -> Result<Vec<u8>, ModelError> {
        if let Some(data) = uri.strip_prefix("data:") {
            let (_, text) =
                data.split_once(";base64,").ok_or_else(|| self.unsupported("a data: URI without base64"))?;
            let decoded = base64::engine::general_purpose::STANDARD.decode(text);
            return decoded.map_err(|error| self.malformed(format!("a data: URI: {error}")));
        }
        let name = Path::new(uri);
        let is_beside = name.is_relative() && !uri.contains("://") && !uri.split('/').any(|part| part == "..");
        if !is_beside {
            return Err(self.unsupported(format!("{uri:?}, which is not beside it")));
        }
        let name = PathBuf::from(uri.replace("%20", " "));
        let file = self.path.parent().unwrap_or(Path::new("")).join(name);
        let read = read_bounded(&file, MOST_MODEL_BYTES);
        read.map_err(|source| ModelError::Read { path: self.path.to_owned(), file, source })
    }

    fn texture(&self, image: &gltf::Image<'_>) -> Result<Texture, ModelError> {
        let referred;
        let bytes = match image.source() {
            gltf::image::Source::View { view, .. } => {
                self.range(view.buffer().index(), view.offset(), view.length())?
            }
            gltf::image::Source::Uri { uri, .. } => {
                referred = self.referred(uri)?;
                &referred
            }
        };
        let decoded = contained(|| Texture::decode(bytes)).unwrap_or_else(|panic| Err(panic.to_string()));
        decoded
            .map_err(|reason| self.malformed(format!("its picture {} (PNG or JPEG expected): {reason}", image.index())))
    }

    /// Bytes of a buffer.
    fn range(&self, buffer: usize, offset: usize, length: usize) -> Result<&[u8], ModelError> {
        let bytes = self.buffers.get(buffer).zip(offset.checked_add(length));
        let bytes = bytes.and_then(|(bytes, end)| bytes.get(offset..end));
        bytes.ok_or_else(|| {
            self.malformed(format!("it names bytes {offset} and {length} more of buffer {buffer}, which are not there"))
        })
    }

    /// The items of an accessor, as bytes.
    fn items<'s>(&'s self, accessor: &Accessor<'_>) -> Result<impl Iterator<Item = &'s [u8]> + use<'s>, ModelError> {
        if accessor.sparse().is_some() {
            return Err(self.unsupported("sparse accessors"));
        }
        let view = accessor.view().ok_or_else(|| self.unsupported("accessors without bytes"))?;
        let (size, count) = (accessor.size(), accessor.count());
        let stride = view.stride().unwrap_or(size).max(size).max(1);
        let bytes = self.range(view.buffer().index(), view.offset(), view.length())?;
        let needed = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        let end = needed.and_then(|needed| needed.checked_add(accessor.offset()));
        let bytes = end.and_then(|end| bytes.get(accessor.offset()..end));
        let bytes =
            bytes.ok_or_else(|| self.malformed(format!("accessor {} goes beyond its bytes", accessor.index())))?;
        Ok(bytes.chunks(stride).map(move |item| &item[..size.min(item.len())]))
    }

    fn floats<const N: usize>(
        &self,
        accessor: &Accessor<'_>,
        dimensions: Dimensions,
    ) -> Result<Vec<[f32; N]>, ModelError> {
        if accessor.data_type() != DataType::F32 || accessor.dimensions() != dimensions {
            return Err(self.unsupported(format!("accessor {} of another type than floats", accessor.index())));
        }
        let of = |item: &[u8]| {
            let mut numbers = [0.0; N];
            for (number, bytes) in numbers.iter_mut().zip(item.as_chunks::<4>().0) {
                *number = f32::from_le_bytes(*bytes);
            }
            numbers
        };
        let all: Vec<[f32; N]> = self.items(accessor)?.map(of).collect();
        match all.iter().flatten().find(|number| number.is_nan() || number.abs() > 1e6) {
            Some(number) => {
                Err(self
                    .malformed(format!("accessor {} has {number}, expected numbers up to 1000000", accessor.index())))
            }
            None => Ok(all),
        }
    }

    fn node(&mut self, node: &Node<'_>, parent: Mat4, plain: u32, depth: usize) -> Result<(), ModelError> {
        self.nodes += 1;
        if depth == 0 || self.nodes > MOST_NODES {
            return Err(self.malformed("its nodes go in a circle, or there are more than 100000"));
        }
        let placed = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        for primitive in node.mesh().into_iter().flat_map(|mesh| mesh.primitives()) {
            self.primitive(&primitive, placed, plain)?;
        }
        node.children().try_for_each(|child| self.node(&child, placed, plain, depth - 1))
    }

    fn primitive(&mut self, primitive: &Primitive<'_>, placed: Mat4, plain: u32) -> Result<(), ModelError> {
        if primitive.mode() != Mode::Triangles {
            // Lines and points of a model are not seen from far; strips are rare.
            return match primitive.mode() {
                Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip => Ok(()),
                _ => Err(self.unsupported("strips or fans of triangles")),
            };
        }
        let positions = primitive.get(&Semantic::Positions).ok_or_else(|| self.malformed("a mesh has no positions"))?;
        let positions: Vec<[f32; 3]> = self.floats(&positions, Dimensions::Vec3)?;
        let normals = primitive.get(&Semantic::Normals);
        let normals: Vec<[f32; 3]> = normals.map_or(Ok(Vec::new()), |a| self.floats(&a, Dimensions::Vec3))?;
        let wanted = primitive.material().pbr_metallic_roughness().base_color_texture().map(|info| info.tex_coord());
        let places = wanted.and_then(|set| primitive.get(&Semantic::TexCoords(set)));
        let places: Vec<[f32; 2]> = places.map_or(Ok(Vec::new()), |a| self.floats(&a, Dimensions::Vec2))?;
        let corners = match primitive.indices() {
            Some(indices) => self.indices(&indices)?,
            None => (0..positions.len() as u32).collect(),
        };
        if self.mesh.triangles.len() + corners.len() / 3 > MOST_TRIANGLES {
            return Err(ModelError::TooManyTriangles { path: self.path.to_owned() });
        }
        if let Some(wrong) = corners.iter().find(|corner| **corner as usize >= positions.len()) {
            return Err(self.malformed(format!("a triangle names vertex {wrong} of {}", positions.len())));
        }
        let material = primitive.material().index().map_or(plain, |index| index as u32);
        let placement = Placement::new(placed);
        let place = |corner: u32| placement.point(positions[corner as usize]);
        for triangle in corners.as_chunks::<3>().0 {
            let triangle = if placement.is_mirror { [triangle[0], triangle[2], triangle[1]] } else { *triangle };
            let Some(flat) = flat_normal(triangle.map(place)) else { continue };
            let first = self.mesh.vertices.len() as u32;
            for corner in triangle {
                let own = normals.get(corner as usize).and_then(|normal| placement.normal(*normal));
                let uv = places.get(corner as usize).copied().unwrap_or_default();
                self.mesh.vertices.push(Vertex { position: place(corner), normal: own.unwrap_or(flat), uv });
            }
            self.mesh.triangles.push(Triangle { vertices: [first, first + 1, first + 2], material });
        }
        Ok(())
    }

    fn indices(&self, accessor: &Accessor<'_>) -> Result<Vec<u32>, ModelError> {
        let is_known = matches!(accessor.data_type(), DataType::U8 | DataType::U16 | DataType::U32);
        if !is_known || accessor.dimensions() != Dimensions::Scalar {
            return Err(self.unsupported(format!("accessor {} of indices that are no whole numbers", accessor.index())));
        }
        if accessor.count() > 3 * MOST_TRIANGLES {
            return Err(ModelError::TooManyTriangles { path: self.path.to_owned() });
        }
        let number = |item: &[u8]| item.iter().rev().fold(0, |number, byte| number << 8 | u32::from(*byte));
        Ok(self.items(accessor)?.map(number).collect())
    }
}

/// From a mesh's axes to the vehicle's. In glTF y is up, and z ahead.
struct Placement {
    placed: Mat4,
    normals: glam::Mat3,
    /// Whether it turns the inside out.
    is_mirror: bool,
}

/// From glTF's axes to ahead, left and up.
fn vehicle_axes(of: Vec3) -> Vec3 {
    Vec3::new(of.z, of.x, of.y)
}

impl Placement {
    fn new(placed: Mat4) -> Self {
        let linear = glam::Mat3::from_mat4(placed);
        let determinant = linear.determinant();
        // Normals stay at right angles: by the cofactors, which are there for any matrix.
        let [x, y, z] = [linear.x_axis, linear.y_axis, linear.z_axis];
        let normals = glam::Mat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * determinant.signum();
        Self { placed, normals, is_mirror: determinant < 0.0 }
    }

    fn point(&self, position: [f32; 3]) -> Vec3 {
        vehicle_axes(self.placed.transform_point3(Vec3::from_array(position)))
    }

    fn normal(&self, normal: [f32; 3]) -> Option<Vec3> {
        (self.normals * Vec3::from_array(normal)).try_normalize().map(vehicle_axes)
    }
}
