// Colour and depth of what rays have met. Sky is left as it was.

// A facet that is seen more nearly edge on than this counts as seen so.
const LEAST_FACING: f32 = 1e-3;

@group(0) @binding(4) var<storage, read> hits: array<Hit>;
@group(1) @binding(0) var colors: texture_2d_array<f32>;
@group(1) @binding(1) var color_sampler: sampler;

// One triangle over the picture.
@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

// The lowest bit of alpha is cleared where the ground was made up.
fn marked(color: vec4<f32>, hit: Hit) -> vec4<f32> {
    if (hit.tile & MADE_UP) == 0u { return color; }
    return vec4(color.rgb, 254.0 / 255.0);
}

struct Pixel {
    @location(0) color: vec4<f32>,
    @builtin(frag_depth) depth: f32,
}

struct Seen {
    hit: Hit,
    tile: Tile,
    // Metres east and north of the eye, and their change per column and row.
    point: vec2<f32>,
    per_column: vec2<f32>,
    per_row: vec2<f32>,
}

fn seen(position: vec4<f32>) -> Seen {
    let pixel = vec2<u32>(position.xy);
    var out: Seen;
    out.hit = hits[pixel.y * picture_size().x + pixel.x];
    if out.hit.depth == 0.0 { return out; }
    out.tile = tiles[out.hit.tile & ~MADE_UP];
    let direction = direction_of(pixel);
    out.point = direction.xy * out.hit.depth;
    let normal = vec3(-out.hit.slope, 1.0);
    // Rays come from above, or, beside the world, from below.
    let toward = dot(normal, direction);
    let facing = select(-1.0, 1.0, toward > 0.0) * max(abs(toward), LEAST_FACING);
    let column = frame.per_column - direction * (dot(normal, frame.per_column) / facing);
    let row = frame.per_row - direction * (dot(normal, frame.per_row) / facing);
    out.per_column = column.xy * out.hit.depth;
    out.per_row = row.xy * out.hit.depth;
    return out;
}

fn texel(seen: Seen) -> vec4<f32> {
    let at = (seen.point - seen.tile.color_corner) * seen.tile.color_per_m;
    let down = vec2(seen.tile.color_per_m, -seen.tile.color_per_m);
    return textureSampleGrad(
        colors, color_sampler, vec2(at.x, 1.0 - at.y), seen.tile.color_layer, seen.per_column * down, seen.per_row * down,
    );
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> Pixel {
    let seen = seen(position);
    if seen.hit.depth == 0.0 { discard; }
    return Pixel(marked(texel(seen), seen.hit), frame.near_m / seen.hit.depth);
}

// The same with the outlines of the colour leaves, as the mesh draws them.
@fragment
fn fragment_overlay(@builtin(position) position: vec4<f32>) -> Pixel {
    let seen = seen(position);
    if seen.hit.depth == 0.0 { discard; }
    let cells = vec2<f32>(seen.tile.cells);
    let at = (seen.point - seen.tile.corner) * seen.tile.cells_per_m;
    let slope = (abs(seen.per_column) + abs(seen.per_row)) * seen.tile.cells_per_m;
    let from_edge = min(at, cells - at) / max(slope, vec2(1e-9));
    let cover = clamp(2.0 - min(from_edge.x, from_edge.y), 0.0, 1.0);
    let color = mix(texel(seen), unpack4x8unorm(seen.tile.outline), 0.85 * cover);
    return Pixel(marked(color, seen.hit), frame.near_m / seen.hit.depth);
}
