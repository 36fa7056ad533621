// One exact ray per pixel through pyramids of maxima, to the same surface as the mesh's: each cell of a block is two facets, cut
// from south west to north east. `model` makes the maxima of every block, `cast_ray` finds what each pixel sees. Every check of what
// came through shared memory was made before.

struct Node {
    // South west, south east, north west, north east: EMPTY, a tile's index with IS_TILE, or a node's.
    children: vec4<u32>,
    // Where the children meet, metres from the eye.
    middle: vec2<f32>,
    reserved: vec2<u32>,
}

const EMPTY: u32 = 0xffffffffu;
const IS_TILE: u32 = 0x80000000u;
// Maxima up to this level are made from posts.
const FINE_LEVELS: u32 = 3u;
// No ray takes more steps; a bound that no rounding can keep from being reached.
const MOST_STEPS: u32 = 65536u;
// A ray lies under the ground when it is lower by this many metres, and by this share of the distance: less is rounding.
const LEAST_BELOW_M: f32 = 1e-3;
const LEAST_BELOW: f32 = 1e-5;
@group(0) @binding(0) var<storage, read> elevations: array<f32>;
@group(0) @binding(2) var<storage, read> nodes: array<Node>;
@group(0) @binding(3) var<storage, read_write> maxima: array<f32>;
@group(0) @binding(4) var<storage, read_write> hits: array<Hit>;

// A number of an array: a height becomes metres above the eye.
fn stored(tile: Tile, at: vec2<u32>) -> f32 {
    return elevations[tile.array_start + at.y * tile.strides.y + at.x * tile.strides.x] + frame.datum_m;
}

// A post at the latitude of stored ones: past the border it continues the slope that leads there.
fn stretched_east(tile: Tile, at: vec2<u32>) -> f32 {
    let height = stored(tile, at);
    if tile.stretch.x == 1.0 || at.x != tile.cells.x { return height; }
    let before = stored(tile, vec2(at.x - 1u, at.y));
    return before + (height - before) * tile.stretch.x;
}

// Height of a post, metres from the eye.
fn post(tile: Tile, at: vec2<u32>) -> f32 {
    let height = stretched_east(tile, at);
    if tile.stretch.y == 1.0 || at.y != tile.cells.y { return height; }
    let before = stretched_east(tile, vec2(at.x, at.y - 1u));
    return before + (height - before) * tile.stretch.y;
}

// log2 of the cells along a side of the square that a tile's maxima are made for.
fn log_side(tile: Tile) -> u32 {
    return firstLeadingBit(max(2u * max(tile.cells.x, tile.cells.y) - 1u, 1u));
}

// Where the maxima of blocks of `2^level` cells begin, and of which number in a row.
fn level_start(tile: Tile, log: u32, level: u32) -> u32 {
    let finer = 1u << (log - level + 1u);
    let all = 1u << log;
    return tile.maxima_start + (all * all - finer * finer) / 3u;
}

fn maximum(tile: Tile, log: u32, level: u32, at: vec2<u32>) -> f32 {
    return maxima[level_start(tile, log, level) + (at.y << (log - level)) + at.x];
}

@compute @workgroup_size(64)
fn model(@builtin(global_invocation_id) id: vec3<u32>) {
    let tile = tiles[id.y];
    let log = log_side(tile);
    var level = 1u;
    var index = id.x;
    loop {
        if level > log { return; }
        let count = 1u << (2u * (log - level));
        if index < count { break; }
        index -= count;
        level += 1u;
    }
    if (level > FINE_LEVELS) != (frame.turn == 1u) { return; }
    let row_length = log - level;
    let at = vec2(index & ((1u << row_length) - 1u), index >> row_length);
    let out = level_start(tile, log, level) + index;
    // Blocks beyond the cells are never asked for.
    if any((at << vec2(level)) >= tile.cells) { return; }
    var highest = -3.4e38;
    if level <= FINE_LEVELS {
        let low = at << vec2(level);
        let high = min((at + 1u) << vec2(level), tile.cells);
        for (var j = low.y; j <= high.y; j++) {
            for (var i = low.x; i <= high.x; i++) {
                highest = max(highest, post(tile, vec2(i, j)));
            }
        }
    } else {
        let by = vec2(level - FINE_LEVELS);
        let low = at << by;
        let high = min((at + 1u) << by, (tile.cells + ((1u << FINE_LEVELS) - 1u)) >> vec2(FINE_LEVELS));
        for (var j = low.y; j < high.y; j++) {
            for (var i = low.x; i < high.x; i++) {
                highest = max(highest, maximum(tile, log, FINE_LEVELS, vec2(i, j)));
            }
        }
    }
    maxima[out] = highest;
}

// A little further: a point on a border belongs to what lies behind it.
fn past(s: f32) -> f32 {
    return s + abs(s) * 2e-6 + 1e-6;
}

// Parameter at which a ray from the eye leaves a rectangle.
fn leave(reciprocal: vec2<f32>, low: vec2<f32>, high: vec2<f32>) -> f32 {
    let out = max(low * reciprocal, high * reciprocal);
    return min(out.x, out.y);
}

const SKY = Hit(0.0, 0u, vec2(0.0, 0.0));

fn corners_of(tile: Tile, at: vec2<u32>) -> vec4<f32> {
    return vec4(post(tile, at), post(tile, at + vec2(1u, 0u)), post(tile, at + vec2(0u, 1u)), post(tile, at + 1u));
}

// Where a ray from `start` to `until` meets a cell's facets from above, `side` being 1, or from below, -1.
fn meet_cell(side: f32, tile: Tile, index: u32, corners: vec4<f32>, place: vec2<f32>, per_s: vec2<f32>, rise: f32, start: f32, until: f32) -> Hit {
    let across = place.x - place.y;
    let across_per_s = per_s.x - per_s.y;
    // Where it changes from one half to the other, if it does.
    var change = 3.4e38;
    if across * across_per_s < 0.0 { change = start - across / across_per_s; }
    var is_south_east = across > 0.0 || (across == 0.0 && across_per_s >= 0.0);
    var begin = start;
    for (var half = 0u; half < 2u; half++) {
        let slope = facet_slope(corners, is_south_east);
        var end = until;
        if begin < change { end = min(until, change); }
        // Height over the plane.
        let above_per_s = rise - dot(slope, per_s);
        let above = rise * start - corners.x - dot(slope, place);
        let at_begin = above + above_per_s * (begin - start);
        let at_end = above + above_per_s * (end - start);
        if side * at_begin <= 0.0 { return Hit(begin, index, slope * tile.cells_per_m); }
        if side * at_end <= 0.0 {
            return Hit(clamp(start - above / above_per_s, begin, end), index, slope * tile.cells_per_m);
        }
        if change >= until { break; }
        begin = change;
        is_south_east = !is_south_east;
    }
    return SKY;
}

// Where a ray first meets a tile's ground.
fn cross_tile(index: u32, direction: vec3<f32>, reciprocal: vec2<f32>, start: f32, until: f32) -> Hit {
    let tile = tiles[index];
    let log = log_side(tile);
    let per_s = direction.xy * tile.cells_per_m;
    let s_per_cell = reciprocal / tile.cells_per_m;
    let at_eye = -tile.corner * tile.cells_per_m;
    let is_up = per_s > vec2(0.0);
    var level = log;
    var at = vec2(0u);
    var s = start;
    for (var step = 0u; step < MOST_STEPS; step++) {
        let side = f32(1u << level);
        let low = vec2<f32>(at) * side;
        let leaves = (select(low, low + side, is_up) - at_eye) * s_per_cell;
        let out = max(min(min(leaves.x, leaves.y), until), s);
        let lowest = min(direction.z * s, direction.z * out);
        if level == 0u {
            let corners = corners_of(tile, at);
            if lowest <= max(max(corners.x, corners.y), max(corners.z, corners.w)) {
                let hit = meet_cell(1.0, tile, index, corners, per_s * s + at_eye - low, per_s, direction.z, s, out);
                if hit.depth > 0.0 { return hit; }
            }
        } else if lowest <= maximum(tile, log, level, at) {
            level -= 1u;
            let is_far = per_s * s + at_eye >= low + 0.5 * side;
            at = min(2u * at + select(vec2(0u), vec2(1u), is_far), (tile.cells - 1u) >> vec2(level));
            continue;
        }
        s = out;
        if s >= until { break; }
        let before = at;
        let last = (tile.cells - 1u) >> vec2(level);
        if leaves.y < leaves.x {
            if is_up.y { at.y += 1u; } else { at.y -= 1u; }
        } else {
            if is_up.x { at.x += 1u; } else { at.x -= 1u; }
        }
        // Below 0 it wraps around.
        if any(at > last) { break; }
        if level < log && any((at >> vec2(1u)) != (before >> vec2(1u))) {
            level += 1u;
            at = at >> vec2(1u);
        }
    }
    return SKY;
}

// Whether a ray lies under a tile's ground.
fn is_below(index: u32, direction: vec3<f32>, s: f32) -> bool {
    let tile = tiles[index];
    let place = clamp((direction.xy * s - tile.corner) * tile.cells_per_m, vec2(0.0), vec2<f32>(tile.cells));
    let at = min(vec2<u32>(place), tile.cells - 1u);
    let by = place - vec2<f32>(at);
    let corners = corners_of(tile, at);
    return direction.z * s < facet_linear(corners, by) - LEAST_BELOW * s - LEAST_BELOW_M;
}

// Where a ray that is under a tile's ground comes out of it.
fn leave_ground(index: u32, direction: vec3<f32>, reciprocal: vec2<f32>, start: f32, until: f32) -> Hit {
    let tile = tiles[index];
    let per_s = direction.xy * tile.cells_per_m;
    let s_per_cell = reciprocal / tile.cells_per_m;
    let at_eye = -tile.corner * tile.cells_per_m;
    let is_up = per_s > vec2(0.0);
    let place = clamp(per_s * start + at_eye, vec2(0.0), vec2<f32>(tile.cells));
    var at = min(vec2<u32>(place), tile.cells - 1u);
    var s = start;
    for (var step = 0u; step < MOST_STEPS; step++) {
        let low = vec2<f32>(at);
        let leaves = (select(low, low + 1.0, is_up) - at_eye) * s_per_cell;
        let out = max(min(min(leaves.x, leaves.y), until), s);
        let corners = corners_of(tile, at);
        if max(direction.z * s, direction.z * out) >= min(min(corners.x, corners.y), min(corners.z, corners.w)) {
            let hit = meet_cell(-1.0, tile, index, corners, per_s * s + at_eye - low, per_s, direction.z, s, out);
            if hit.depth > 0.0 { return hit; }
        }
        s = out;
        if s >= until { break; }
        if leaves.y < leaves.x {
            if is_up.y { at.y += 1u; } else { at.y -= 1u; }
        } else {
            if is_up.x { at.x += 1u; } else { at.x -= 1u; }
        }
        // Below 0 it wraps around.
        if any(at >= tile.cells) { break; }
    }
    return SKY;
}

// Where a ray is: over no tile, so that nothing is known, above the ground, or under it.
const OUTSIDE: u32 = 0u;
const ABOVE: u32 = 1u;
const BELOW: u32 = 2u;

// A smaller share is not ground.
const HALF: f32 = 0.5;

// A plane of a tile's array at a point: 1 the share that is ground, 2 the share that was measured. Linear on facets, as heights.
fn share_at(index: u32, direction: vec3<f32>, s: f32, plane: u32) -> f32 {
    var tile = tiles[index];
    tile.array_start += plane * frame.plane;
    let place = clamp((direction.xy * s - tile.corner) * tile.cells_per_m, vec2(0.0), vec2<f32>(tile.cells));
    let at = min(vec2<u32>(place), tile.cells - 1u);
    let by = place - vec2<f32>(at);
    let corners = corners_of(tile, at);
    // A share is no height.
    return facet_linear(corners, by) - frame.datum_m;
}

fn first_hit(direction_of_pixel: vec3<f32>) -> Hit {
    // No direction is level along an axis: reciprocals are finite.
    let direction = select(direction_of_pixel, vec3(1e-20), abs(direction_of_pixel) < vec3(1e-20));
    let reciprocal = 1.0 / direction.xy;
    let ways = min(frame.bounds_low * reciprocal, frame.bounds_high * reciprocal);
    var s = max(max(ways.x, ways.y), 0.0);
    let far = leave(reciprocal, frame.bounds_low, frame.bounds_high);
    var side = OUTSIDE;
    for (var step = 0u; step < MOST_STEPS; step++) {
        if s >= far { break; }
        let point = direction.xy * s;
        var low = frame.root_low;
        var high = low + frame.root_side;
        var link = frame.root;
        while (link & IS_TILE) == 0u {
            let node = nodes[link];
            let is_far = point >= node.middle;
            low = select(low, node.middle, is_far);
            high = select(node.middle, high, is_far);
            link = node.children[select(0u, 1u, is_far.x) + select(0u, 2u, is_far.y)];
        }
        let out = max(leave(reciprocal, low, high), s);
        if link == EMPTY {
            side = OUTSIDE;
            s = past(out);
            continue;
        }
        let index = link & ~IS_TILE;
        // The ground has no sides where tiles end: a ray that comes over it lower than its edge is under it.
        if side == OUTSIDE { side = select(ABOVE, BELOW, is_below(index, direction, s)); }
        var hit = SKY;
        if side == BELOW {
            hit = leave_ground(index, direction, reciprocal, s, min(out, far));
        } else {
            hit = cross_tile(index, direction, reciprocal, s, min(out, far));
        }
        if hit.depth > 0.0 {
            let is_hole = frame.plane != 0u && share_at(index, direction, hit.depth, 1u) < HALF;
            if !is_hole && (side == ABOVE || frame.has_undersides == 1u) {
                if frame.plane != 0u && share_at(index, direction, hit.depth, 2u) < HALF { hit.tile |= MADE_UP; }
                return hit;
            }
            // Through a hole, or out of the ground unseen.
            side = select(ABOVE, BELOW, side == ABOVE);
            s = past(hit.depth);
            continue;
        }
        s = past(out);
    }
    return SKY;
}

@compute @workgroup_size(8, 8)
fn cast_ray(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = picture_size();
    if any(id.xy >= size) { return; }
    hits[id.y * size.x + id.x] = first_hit(direction_of(id.xy));
}
