// Where ground lies on a body: what `common/src/surface/globe/eye.rs` is for all other code. Columns and rows of posts have
// terms, made for the eye.

struct Placed {
    from_eye: vec3<f32>,
    // In the colour tile, without its border: 0 to 1, east and north.
    texel: vec2<f32>,
}

// Of each column u, v and its place in its leaf, in posts; of each row c, a north, a up, k, s, w and its place.
@group(0) @binding(2) var<storage, read> terms: array<f32>;
const COLUMN_TERMS: u32 = 3u;
const ROW_TERMS: u32 = 7u;

// The one name of a post: those beyond an edge of the ground lie on it, and are the edge's own. The column of the east edge is in
// the lowest byte; in the highest one is the row of the edge at the middle of the body, 128 more if it is the southern one.
fn canonical(tile: Tile, post: vec2<u32>) -> vec2<u32> {
    let last = frame.posts - 1u;
    let middle = extractBits(tile.level_and_snap, 24u, 7u);
    let is_southern = (tile.level_and_snap >> 31u) != 0u;
    let column = select(post.x, last, post.x >= (tile.level_and_snap & 0xffu));
    let beyond_south = is_southern && post.y <= middle;
    let beyond_north = !is_southern && post.y >= middle;
    return vec2(column, select(select(post.y, last, beyond_north), 0u, beyond_south));
}

fn placed(tile: Tile, at: vec2<u32>, height_m: f32) -> Placed {
    let column = u32(tile.origin_from_cell.x) + at.x * COLUMN_TERMS;
    let row = u32(tile.origin_from_cell.y) + at.y * ROW_TERMS;
    let u = terms[column];
    let v = terms[column + 1u];
    let k = terms[row + 3u];
    // The eye's latitude and its height above the ellipsoid.
    let sin_eye = frame.eye_in_cell_m.x;
    let cos_eye = frame.eye_in_cell_m.y;
    let h = height_m + frame.unit_m;
    let around = terms[row] * v;
    let leans = k * v;
    let from_eye = vec3(
        terms[row] * u + h * (k * u),
        terms[row + 1u] + sin_eye * around + h * (terms[row + 4u] + sin_eye * leans),
        (terms[row + 2u] - cos_eye * around) + height_m - h * (terms[row + 5u] + cos_eye * leans),
    );
    let in_leaf = vec2(terms[column + 2u], terms[row + 6u]);
    let texel = (in_leaf - vec2<f32>(tile.color_origin_from_cell)) * vec2(tile.color_scale, tile.color_scale_north);
    return Placed(from_eye, texel);
}

