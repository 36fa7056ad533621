// Where the posts of a leaf lie, on a plane. `Tile` and `frame` are those of the mesh.

struct Placed {
    from_eye: vec3<f32>,
    // In the colour tile, without its border: 0 to 1, east and north.
    texel: vec2<f32>,
}

// The one name of a post.
fn canonical(tile: Tile, post: vec2<u32>) -> vec2<u32> {
    return post;
}

fn placed(tile: Tile, at: vec2<u32>, height_m: f32) -> Placed {
    let lattice = min(tile.origin_from_cell + vec2<i32>(at << vec2(tile.level_and_snap & 0xffu)), frame.extent_from_cell);
    let from_eye = vertex_from_eye(lattice, height_m, frame.unit_m, frame.eye_in_cell_m);
    return Placed(from_eye, vec2<f32>(lattice - tile.color_origin_from_cell) * tile.color_scale);
}

