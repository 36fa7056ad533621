// What the device can do at best: a flat grid over the whole picture, textured and depth-tested, nothing else.

struct Grid {
    columns: u32,
    rows: u32,
    column_reciprocal: f32,
    layer: u32,
}

var<immediate> grid: Grid;
@group(1) @binding(0) var colors: texture_2d_array<f32>;
@group(1) @binding(1) var color_sampler: sampler;

struct Varyings {
    @builtin(position) position: vec4<f32>,
    @location(0) color_at: vec2<f32>,
    @location(1) @interpolate(flat) layer: u32,
}

@vertex
fn vertex(@builtin(vertex_index) vertex: u32) -> Varyings {
    let row = u32((f32(vertex) + 0.5) * grid.column_reciprocal);
    let column = vertex - row * (grid.columns + 1u);
    let at = vec2(f32(column) / f32(grid.columns), f32(row) / f32(grid.rows));
    // Depth falls from bottom to top as over ground, so that the perspective division has something to do.
    let depth = 100.0 * (1.0 + at.y);
    return Varyings(vec4((at * 2.0 - 1.0) * depth, 0.5, depth), at, grid.layer);
}

@fragment
fn fragment(in: Varyings) -> @location(0) vec4<f32> {
    return textureSample(colors, color_sampler, in.color_at, in.layer);
}
