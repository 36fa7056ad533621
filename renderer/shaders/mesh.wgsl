// One block of an elevation array per instance, drawn without vertex attributes: the vertex index says which post of
// the array, the instance index which tile. Every check of what came through shared memory was made before.

struct Frame {
    // Rows of the matrix that takes a position relative to the eye to clip coordinates (z is the constant `near`).
    clip_x: vec3<f32>,
    // Of a body: the eye's height above the ellipsoid.
    unit_m: f32,
    clip_y: vec3<f32>,
    near_m: f32,
    clip_w: vec3<f32>,
    posts_reciprocal: f32,
    // Eye within its lattice cell, metres; of a body, sine and cosine of the eye's latitude.
    eye_in_cell_m: vec2<f32>,
    // The world's last lattice point, from the eye's cell.
    extent_from_cell: vec2<i32>,
    posts: u32,
    color_border: f32,
    // Steps of the rasterizer's grid of vertices from the picture's centre to its edges.
    grid: vec2<f32>,
    // What the elevations are above, metres above the eye.
    datum_m: f32,
}

struct Tile {
    // Lower left corner of the elevation leaf, lattice units from the eye's cell; of a body, where the terms of its columns
    // and its rows begin.
    origin_from_cell: vec2<i32>,
    // Lower left corner of the node whose colour tile is used, likewise; of a body, in posts of the leaf from its corner.
    color_origin_from_cell: vec2<i32>,
    // First value of the elevation array.
    array_start: u32,
    // Bits 0-7: level of the elevation leaf; then four bits each: snap of the west, east, south, north edge. Of a body also
    // where the ground ends (`canonical`).
    level_and_snap: u32,
    // Texture coordinates per lattice unit; of a body, per post, east.
    color_scale: f32,
    color_layer: u32,
    // First and last column (low half) and row (high half) of the block.
    block_start: u32,
    block_end: u32,
    // Colour of the block's outline, RGBA8.
    outline: u32,
    // Of a body: texture coordinates per post, north.
    color_scale_north: f32,
}

var<immediate> frame: Frame;
@group(0) @binding(0) var<storage, read> elevations: array<f32>;
@group(0) @binding(1) var<storage, read> tiles: array<Tile>;
@group(1) @binding(0) var colors: texture_2d_array<f32>;
@group(1) @binding(1) var color_sampler: sampler;

struct Vertex {
    position: vec4<f32>,
    color_at: vec2<f32>,
    layer: u32,
}

fn post_of(vertex: u32) -> vec2<u32> {
    // Exact: a vertex index is below 2^17, and half a post keeps the quotient away from whole numbers.
    let row = u32((f32(vertex) + 0.5) * frame.posts_reciprocal);
    return vec2(vertex - row * frame.posts, row);
}

// The post that is drawn in a post's place.
fn snapped(tile: Tile, any_post: vec2<u32>) -> vec2<u32> {
    let post = canonical(tile, any_post);
    var at = post;
    let last = frame.posts - 1u;
    let snap = tile.level_and_snap;
    // An edge with a coarser neighbour has no other vertices than the neighbour has.
    if extractBits(snap, 8u, 16u) != 0u {
        if post.x == 0u { at.y &= ~0u << extractBits(snap, 8u, 4u); }
        if post.x == last { at.y &= ~0u << extractBits(snap, 12u, 4u); }
        if post.y == 0u { at.x &= ~0u << extractBits(snap, 16u, 4u); }
        if post.y == last { at.x &= ~0u << extractBits(snap, 20u, 4u); }
    }
    return at;
}

// A vertex where the rasterizer will take it to, so that it cannot turn a facet round that is seen nearly edge on. lavapipe
// culls by places that were not rounded and covers pixels by rounded ones: without this a pixel on a crest stayed open now
// and then (two of 786 million), and facets reached metres beyond their edges along such a ray.
fn on_grid(clip: vec4<f32>) -> vec4<f32> {
    if clip.w <= frame.near_m { return clip; }
    return vec4(round(clip.xy / clip.w * frame.grid) / frame.grid * clip.w, clip.zw);
}

fn vertex_of(tile: Tile, at: vec2<u32>) -> Vertex {
    let height_m = elevations[tile.array_start + at.y * frame.posts + at.x] + frame.datum_m;
    let at_post = placed(tile, at, height_m);
    let from_eye = at_post.from_eye;
    let texel = at_post.texel + frame.color_border;
    var out: Vertex;
    out.position = on_grid(vec4(dot(frame.clip_x, from_eye), dot(frame.clip_y, from_eye), frame.near_m, dot(frame.clip_w, from_eye)));
    out.color_at = vec2(texel.x, 1.0 - texel.y);
    out.layer = tile.color_layer;
    return out;
}

struct Varyings {
    @invariant @builtin(position) position: vec4<f32>,
    @location(0) color_at: vec2<f32>,
    @location(1) @interpolate(flat) layer: u32,
}

@vertex
fn vertex(@builtin(vertex_index) vertex: u32, @builtin(instance_index) instance: u32) -> Varyings {
    let tile = tiles[instance];
    let made = vertex_of(tile, snapped(tile, post_of(vertex)));
    return Varyings(made.position, made.color_at, made.layer);
}

@fragment
fn fragment(in: Varyings) -> @location(0) vec4<f32> {
    return textureSample(colors, color_sampler, in.color_at, in.layer);
}

// The same with the outlines of the colour leaves.
struct OverlayVaryings {
    @invariant @builtin(position) position: vec4<f32>,
    @location(0) color_at: vec2<f32>,
    @location(1) @interpolate(flat) layer: u32,
    // 0 to 1 across the block.
    @location(2) block_at: vec2<f32>,
    @location(3) @interpolate(flat) outline: u32,
}

fn block_place(tile: Tile, post: vec2<u32>) -> vec2<f32> {
    let start = vec2(tile.block_start & 0xffffu, tile.block_start >> 16u);
    let end = vec2(tile.block_end & 0xffffu, tile.block_end >> 16u);
    return vec2<f32>(post - start) / vec2<f32>(end - start);
}

@vertex
fn vertex_overlay(@builtin(vertex_index) vertex: u32, @builtin(instance_index) instance: u32) -> OverlayVaryings {
    let tile = tiles[instance];
    let post = snapped(tile, post_of(vertex));
    let made = vertex_of(tile, post);
    let block_at = block_place(tile, post);
    return OverlayVaryings(made.position, made.color_at, made.layer, block_at, tile.outline);
}

// Colour with the block's outline.
fn outlined(color_at: vec2<f32>, layer: u32, block_at: vec2<f32>, outline: u32) -> vec4<f32> {
    let texel = textureSample(colors, color_sampler, color_at, layer);
    // Distance to the block's nearest edge in pixels: a line of about three pixels, half on each side of the edge.
    let slope = max(fwidth(block_at), vec2(1e-9));
    let from_edge = min(block_at, 1.0 - block_at) / slope;
    let cover = clamp(2.0 - min(from_edge.x, from_edge.y), 0.0, 1.0);
    return mix(texel, unpack4x8unorm(outline), 0.85 * cover);
}

@fragment
fn fragment_overlay(in: OverlayVaryings) -> @location(0) vec4<f32> {
    return outlined(in.color_at, in.layer, in.block_at, in.outline);
}

// A world with validity: behind the heights of an array come the shares of its posts that are ground, and that were measured.
// Where less than half is ground there is a hole; where less than half was measured, the lowest bit of alpha is cleared.
const HALF: f32 = 0.5;
const MADE_UP_ALPHA: f32 = 254.0 / 255.0;

fn shares_of(tile: Tile, at: vec2<u32>) -> vec2<f32> {
    let plane = frame.posts * frame.posts;
    let first = tile.array_start + plane + at.y * frame.posts + at.x;
    return vec2(elevations[first], elevations[first + plane]);
}

struct ValidVaryings {
    @invariant @builtin(position) position: vec4<f32>,
    @location(0) color_at: vec2<f32>,
    @location(1) @interpolate(flat) layer: u32,
    // Of ground, and of what was measured.
    @location(2) shares: vec2<f32>,
}

@vertex
fn vertex_valid(@builtin(vertex_index) vertex: u32, @builtin(instance_index) instance: u32) -> ValidVaryings {
    let tile = tiles[instance];
    let post = snapped(tile, post_of(vertex));
    let made = vertex_of(tile, post);
    return ValidVaryings(made.position, made.color_at, made.layer, shares_of(tile, post));
}

fn marked(color: vec4<f32>, shares: vec2<f32>) -> vec4<f32> {
    return vec4(color.rgb, select(1.0, MADE_UP_ALPHA, shares.y < HALF));
}

@fragment
fn fragment_valid(in: ValidVaryings) -> @location(0) vec4<f32> {
    let texel = textureSample(colors, color_sampler, in.color_at, in.layer);
    if in.shares.x < HALF { discard; }
    return marked(texel, in.shares);
}

@fragment
fn fragment_depth_valid(in: ValidVaryings) {
    if in.shares.x < HALF { discard; }
}

struct ValidOverlayVaryings {
    @invariant @builtin(position) position: vec4<f32>,
    @location(0) color_at: vec2<f32>,
    @location(1) @interpolate(flat) layer: u32,
    @location(2) block_at: vec2<f32>,
    @location(3) @interpolate(flat) outline: u32,
    @location(4) shares: vec2<f32>,
}

@vertex
fn vertex_overlay_valid(@builtin(vertex_index) vertex: u32, @builtin(instance_index) instance: u32) -> ValidOverlayVaryings {
    let tile = tiles[instance];
    let post = snapped(tile, post_of(vertex));
    let made = vertex_of(tile, post);
    let block_at = block_place(tile, post);
    return ValidOverlayVaryings(made.position, made.color_at, made.layer, block_at, tile.outline, shares_of(tile, post));
}

@fragment
fn fragment_overlay_valid(in: ValidOverlayVaryings) -> @location(0) vec4<f32> {
    let color = outlined(in.color_at, in.layer, in.block_at, in.outline);
    if in.shares.x < HALF { discard; }
    return marked(color, in.shares);
}
