// Where ground lies in space: for shaders what `common/src/surface` is for all other code. A plane.

// A vertex from the eye, metres: of a lattice point from the eye's cell and a height above the eye. `eye_in_cell_m`: the eye's
// place in that cell.
fn vertex_from_eye(lattice: vec2<i32>, height_m: f32, unit_m: f32, eye_in_cell_m: vec2<f32>) -> vec3<f32> {
    let ground = vec2<f32>(lattice) * unit_m - eye_in_cell_m;
    return vec3(ground, height_m);
}

// Each cell is cut into two facets from south west to north east. Corners of cells: south west, south east, north west, north
// east; places in them: 0 to 1, east and north.

// How much height gains per cell east and north on a facet.
fn facet_slope(corners: vec4<f32>, is_south_east: bool) -> vec2<f32> {
    var slope = vec2(corners.w - corners.z, corners.z - corners.x);
    if is_south_east { slope = vec2(corners.y - corners.x, corners.w - corners.y); }
    return slope;
}

// Height at a place of a cell.
fn facet_linear(corners: vec4<f32>, by: vec2<f32>) -> f32 {
    return corners.x + dot(facet_slope(corners, by.x >= by.y), by);
}

