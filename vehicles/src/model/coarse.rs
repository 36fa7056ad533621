//! A model in fewer triangles: vertices of one cell of a grid become one. It is looked at from so
//! far that a cell is a pixel or less.

use super::{Mesh, Triangle, Vertex};
use glam::Vec3;
use std::collections::{HashMap, HashSet};

/// A mesh whose vertices lie one in each cell of a grid from `low`; cells have this side. Materials
/// are `first_material` further on.
pub(super) fn clustered(mesh: &Mesh, low: Vec3, side: f32, first_material: u32) -> Mesh {
    let cell = |vertex: u32| {
        let place = (mesh.vertices[vertex as usize].position - low) / side.max(f32::MIN_POSITIVE);
        place.to_array().map(|v| v.floor() as i32)
    };
    // Numbers of cells by their first vertex: the order of a hash map has no part in what comes
    // out.
    let mut numbers: HashMap<[i32; 3], u32> = HashMap::new();
    let mut sums: Vec<(Vec3, f32)> = Vec::new();
    let mut number_of = |vertex: u32| {
        let number = *numbers.entry(cell(vertex)).or_insert_with(|| {
            sums.push((Vec3::ZERO, 0.0));
            sums.len() as u32 - 1
        });
        let sum = &mut sums[number as usize];
        *sum = (sum.0 + mesh.vertices[vertex as usize].position, sum.1 + 1.0);
        number
    };
    let mut seen = HashSet::new();
    let mut kept = Vec::new();
    for triangle in &mesh.triangles {
        let corners = triangle.vertices.map(&mut number_of);
        let [a, b, c] = corners;
        if a == b || b == c || c == a {
            continue;
        }
        // The same corners in the same turn.
        let first = (0..3).min_by_key(|i| corners[*i]).unwrap_or(0);
        if seen.insert([0, 1, 2].map(|i| corners[(first + i) % 3])) {
            kept.push((corners, triangle.material));
        }
    }
    let places: Vec<Vec3> = sums.iter().map(|(sum, count)| *sum / *count).collect();
    let mut coarse = Mesh::default();
    for (corners, material) in kept {
        let corners = corners.map(|corner| places[corner as usize]);
        let Some(normal) = flat_normal(corners) else { continue };
        let first = coarse.vertices.len() as u32;
        coarse.vertices.extend(corners.map(|position| Vertex { position, normal, uv: [0.0; 2] }));
        let vertices = [first, first + 1, first + 2];
        coarse.triangles.push(Triangle { vertices, material: material + first_material });
    }
    coarse
}

/// The direction that a triangle faces; `None` where it has no area.
pub(super) fn flat_normal([a, b, c]: [Vec3; 3]) -> Option<Vec3> {
    (b - a).cross(c - a).try_normalize()
}
