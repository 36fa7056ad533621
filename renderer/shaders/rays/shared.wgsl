// Exact rays, what all their shaders know: the view, tiles, and what a pixel sees. `cast.wgsl` finds that, `color.wgsl` colours it.

struct Frame {
    // Direction of depth 1 through the centre of the upper left pixel, and its change per column and row.
    first: vec3<f32>,
    near_m: f32,
    per_column: vec3<f32>,
    // The tree's root, as the children of nodes are written.
    root: u32,
    per_row: vec3<f32>,
    // Columns (low half) and rows of the picture.
    size: u32,
    // South west and north east corner of all ground, metres from the eye.
    bounds_low: vec2<f32>,
    bounds_high: vec2<f32>,
    // South west corner of the tree's root, metres from the eye, and its side.
    root_low: vec2<f32>,
    root_side: f32,
    // Of `model`: 0 makes the finer maxima from posts, 1 the coarser ones from those.
    turn: u32,
    // Whether facets are seen from below, 0 or 1.
    has_undersides: u32,
    // Values of an elevation array's plane; 0 where there is no plane but the heights.
    plane: u32,
    // What the elevations are above, metres above the eye.
    datum_m: f32,
}

struct Tile {
    // South west corner, metres from the eye.
    corner: vec2<f32>,
    cells_per_m: f32,
    // First post in the elevations.
    array_start: u32,
    cells: vec2<u32>,
    // Values from post to post east, and north.
    strides: vec2<u32>,
    // By how much the last cells east and north reach over the world's border: the height that is stored past it lies on it.
    stretch: vec2<f32>,
    // First maximum.
    maxima_start: u32,
    color_layer: u32,
    // Where the texture begins in the south west, metres from the eye, and texture coordinates per metre.
    color_corner: vec2<f32>,
    color_per_m: f32,
    // Colour of the outline, RGBA8.
    outline: u32,
}

struct Hit {
    // Metres along the view axis; 0 where only sky is.
    depth: f32,
    // With MADE_UP where the ground was not measured.
    tile: u32,
    // Of the facet, metres up per metre east and north.
    slope: vec2<f32>,
}

const MADE_UP: u32 = 0x80000000u;

var<immediate> frame: Frame;
@group(0) @binding(1) var<storage, read> tiles: array<Tile>;

fn picture_size() -> vec2<u32> {
    return vec2(frame.size & 0xffffu, frame.size >> 16u);
}

fn direction_of(pixel: vec2<u32>) -> vec3<f32> {
    return frame.first + frame.per_column * f32(pixel.x) + frame.per_row * f32(pixel.y);
}
