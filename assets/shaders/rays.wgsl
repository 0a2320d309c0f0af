// Rays through the grid, and where they meet the surface.
//
// Every traversal visits cells in the same order and asks each of them the same question with the same
// numbers, so that all of them give the same picture, bit for bit. The order is fixed by `border_t`, the t
// of a cell border as `f32` arithmetic gives it: all traversals compare those values and nothing else.
#define_import_path bevy_skyline::rays

#import bevy_skyline::types::{T_NEVER, UNIT_ROUNDOFF}
#import bevy_skyline::height_field::field

/// In grid space, relative to its anchor.
struct Ray {
    origin: vec3<f32>,
    direction: vec3<f32>,
    /// 1 / direction along x and z; 0 where the ray doesn't move.
    inverse: vec2<f32>,
    /// Whether the ray moves along x and z at all.
    moves: vec2<bool>,
    /// 1 where it moves toward larger x and z, else 0.
    ahead: vec2<i32>,
    anchor: vec2<i32>,
    /// Height of the anchor, not relative to anything.
    anchor_y: f32,
    /// Highest sample, relative to the anchor.
    y_max: f32,
    /// Largest magnitude of a sample's height, relative to the anchor; scales the guard bands.
    y_magnitude: f32,
};

/// A ray as the functions below want it.
fn ray_along(origin: vec3<f32>, direction: vec3<f32>) -> Ray {
    var ray: Ray;
    ray.origin = origin;
    ray.direction = direction;
    ray.moves = abs(direction.xz) > vec2(1e-15);
    ray.inverse = 1.0 / select(vec2(1.0), direction.xz, ray.moves);
    ray.ahead = select(vec2(0), vec2(1), direction.xz >= vec2(0.0));
    return ray;
}

fn height_of(ray: Ray, t: f32) -> f32 {
    return ray.origin.y + t * ray.direction.y;
}

/// When the ray meets the grid lines x = at.x and z = at.y (whole cells).
fn border_t(ray: Ray, at: vec2<i32>) -> vec2<f32> {
    let t = (vec2<f32>(at - ray.anchor) - ray.origin.xz) * ray.inverse;
    return select(vec2(T_NEVER), min(t, vec2(T_NEVER)), ray.moves);
}

/// When the ray comes into the footprint (x), by the border it enters last, and leaves it (y). The first is
/// negative if it starts within; both are `T_NEVER` if it passes by.
fn footprint_t(ray: Ray) -> vec2<f32> {
    let enter = select(border_t(ray, select(field.cells, vec2(0), ray.ahead == vec2(1))), vec2(-1.0), !ray.moves);
    let leave = border_t(ray, select(vec2(0), field.cells, ray.ahead == vec2(1)));
    let start = ray.origin.xz + vec2<f32>(ray.anchor);
    let beside = any(!ray.moves & ((start < vec2(0.0)) | (start > vec2<f32>(field.cells))));
    let t = vec2(max(enter.x, enter.y), min(leave.x, leave.y));
    return select(t, vec2(T_NEVER), beside || t.x > t.y || t.y < 0.0);
}

/// The cell at t along one axis: the one that was entered at or before t and is left after t.
fn cell_at(ray: Ray, t: f32) -> vec2<i32> {
    let guess = vec2<i32>(floor(ray.origin.xz + t * ray.direction.xz)) + ray.anchor;
    var cell = clamp(guess, vec2(0), field.cells - 1);
    let entered = border_t(ray, cell + 1 - ray.ahead);
    let left = border_t(ray, cell + ray.ahead);
    let way = 2 * ray.ahead - 1;
    cell += select(vec2(0), way, ray.moves & (left <= vec2(t)));
    cell -= select(vec2(0), way, ray.moves & (entered > vec2(t)));
    return clamp(cell, vec2(0), field.cells - 1);
}

/// The cell after the ray has left, at time `t`, the node of level `k` that holds `cell`, where `leave`
/// are the times of the node's far borders. Ties cross x first, as stepping cell by cell does.
fn next_cell(ray: Ray, cell: vec2<i32>, k: u32, leave: vec2<f32>) -> vec2<i32> {
    let low = (cell >> vec2(k)) << vec2(k);
    let high = low + vec2(i32(1u << k) - 1);
    let beyond = select(low - 1, high + 1, ray.ahead == vec2(1));
    let crosses_x = leave.x <= leave.y;
    // Where it is then on the other axis: one path for both, as invocations run in step.
    var other = select(cell.x, cell.y, crosses_x);
    if k > 0u && select(ray.moves.x, ray.moves.y, crosses_x) {
        let t = min(leave.x, leave.y);
        let origin = select(ray.origin.x, ray.origin.z, crosses_x);
        let inverse = select(ray.inverse.x, ray.inverse.y, crosses_x);
        let anchor = select(ray.anchor.x, ray.anchor.y, crosses_x);
        let ahead = select(ray.ahead.x, ray.ahead.y, crosses_x);
        let least = select(low.x, low.y, crosses_x);
        let most = select(high.x, high.y, crosses_x);
        let direction = select(ray.direction.x, ray.direction.z, crosses_x);
        other = clamp(i32(floor(origin + t * direction)) + anchor, least, most);
        // As `border_t` has them.
        let entered = min((f32(other + 1 - ahead - anchor) - origin) * inverse, T_NEVER);
        let left = min((f32(other + ahead - anchor) - origin) * inverse, T_NEVER);
        let leaves = select(left <= t, left < t, crosses_x);
        let enters = select(entered > t, entered >= t, crosses_x);
        let way = 2 * ahead - 1;
        other = clamp(other + select(0, way, leaves) - select(0, way, enters), least, most);
    }
    return select(vec2(other, beyond.y), vec2(beyond.x, other), crosses_x);
}

/// Height of a ray above one cell's bilinear patch as a polynomial of s = t - t_in.
struct Above {
    t_in: f32,
    s_max: f32,
    /// c + b s + a s^2
    c: f32,
    b: f32,
    a: f32,
};

/// `corners` as `cell_corners` gives them. Depends on the ray and the cell alone, never on how the
/// traversal came here.
fn above_cell(ray: Ray, cell: vec2<i32>, corners: vec4<f32>) -> Above {
    let entered = select(vec2(0.0), border_t(ray, cell + 1 - ray.ahead), ray.moves);
    let left = border_t(ray, cell + ray.ahead);
    let t_in = max(max(entered.x, entered.y), 0.0);
    let at = clamp(ray.origin.xz + t_in * ray.direction.xz - vec2<f32>(cell - ray.anchor), vec2(0.0), vec2(1.0));
    let d = ray.direction;
    // h = h00 + p u + q v + r u v
    let p = corners.y - corners.x;
    let q = corners.z - corners.x;
    let r = (corners.w - corners.z) - p;
    var above: Above;
    above.t_in = t_in;
    above.s_max = max(min(left.x, left.y) - t_in, 0.0);
    above.c = (ray.origin.y - corners.x) + t_in * d.y - (p * at.x + q * at.y + r * at.x * at.y);
    above.b = d.y - p * d.x - q * d.z - r * (at.x * d.z + at.y * d.x);
    above.a = -r * d.x * d.z;
    return above;
}

/// Whether a ray stays above a cell so clearly that the cell need not be asked. The same bound that lets nodes
/// be skipped: a cell that a node's bound would have skipped is skipped by its own too, so what is found
/// doesn't depend on which nodes were asked.
fn clears_cell(ray: Ray, above: Above, corners: vec4<f32>) -> bool {
    let t_out = above.t_in + above.s_max;
    let low = min(height_of(ray, above.t_in), height_of(ray, t_out));
    return low > max(max(corners.x, corners.y), max(corners.z, corners.w)) + height_guard(ray, t_out);
}

/// First s >= 0 at which c + b s + a s^2, positive at 0, comes down to zero; `T_NEVER` if it does not.
/// Both forms add terms of one sign, so nothing cancels, and a = 0 needs no case of its own.
fn first_fall(c: f32, b: f32, a: f32) -> f32 {
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return T_NEVER;
    }
    let root = sqrt(discriminant);
    if b < -1e-30 {
        return 2.0 * c / (root - b);
    }
    if a < -1e-30 {
        return (b + root) / (-2.0 * a);
    }
    return T_NEVER;
}

/// First s >= 0 at which c + b s + a s^2, not positive at 0, comes up through zero; `T_NEVER` if not.
fn first_rise(c: f32, b: f32, a: f32) -> f32 {
    return first_fall(-c, -b, -a);
}

/// How far above a node's highest sample a ray must pass for the node to be left out: what rounding can
/// hide between this test and the cells' own. Each height is a sum of three products (4 roundings), the
/// borders add 3 roundings of t, the cell's polynomial 8 of its terms, none larger than `y_magnitude` or
/// the ray's own height; 32 covers their sum.
fn height_guard(ray: Ray, t: f32) -> f32 {
    return 32.0 * UNIT_ROUNDOFF * (ray.y_magnitude + abs(ray.origin.y) + abs(t * ray.direction.y));
}

/// Where a ray is on its way: in the node of level k that holds `cell`, since t.
struct Place {
    cell: vec2<i32>,
    k: u32,
    t: f32,
};

/// Borders by which a ray leaves its node, and when.
struct Exit {
    border: vec2<i32>,
    t: vec2<f32>,
};

fn exit_of(ray: Ray, place: Place) -> Exit {
    let border = ((place.cell >> vec2(place.k)) + ray.ahead) << vec2(place.k);
    return Exit(border, border_t(ray, border));
}

/// Moves on to the next node, a level up where the border just crossed bounds larger nodes too. Returns
/// whether there is one that matters.
fn move_on(ray: Ray, place: ptr<function, Place>, exit: Exit, t_stop: f32, highest: u32) -> bool {
    let t = max((*place).t, min(exit.t.x, exit.t.y));
    let k = (*place).k;
    let cell = next_cell(ray, (*place).cell, k, exit.t);
    let crossed = u32(select(exit.border.y, exit.border.x, exit.t.x <= exit.t.y));
    (*place).t = t;
    (*place).cell = cell;
    (*place).k = min(k + select(0u, 1u, ((crossed >> k) & 1u) == 0u), highest);
    let past = any(cell < vec2(0)) || any(cell >= field.cells) || t >= t_stop;
    let risen = ray.direction.y >= 0.0 && height_of(ray, t) > ray.y_max + height_guard(ray, t);
    return !(past || risen);
}
