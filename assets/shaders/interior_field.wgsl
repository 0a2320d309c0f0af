// The directed distance field of interior culling, one bit a step: the same bits as `src/interior/field.rs` sets, from
// the same integers (`src/interior/overlap.rs`), in whatever order pieces come.
//
// An invocation takes one *piece*: a triangle and a box of at most 256 of the lattice's points. Of each point it asks
// whether the triangle overlaps the box around the step up each axis; the host takes large triangles apart, so that no
// invocation runs long.
//
// Imports nothing: the host hands it to the device as it is, from whatever thread culls.
//
// # Symbols
// - A *unit* is 1/256 of the lattice's spacing; points lie at multiples of 256 units. Coordinates are below 2²⁰.
// - *Wide* numbers are integers modulo 2⁶⁴, two's complement, in pairs of u32. No intermediate value that is compared
//   leaves −2⁶³…2⁶³, as in the host's i64.
// - Vectors over the edges of a triangle: edge 0 from its corner 0 to 1, 1 from 1 to 2, 2 from 2 to 0.
// - "Across" an axis: in the plane of the next two, in the order x, y, z, x, y.

/// Of points, in units.
const SPACING: i32 = 256;
/// log₂ of [`SPACING`].
const SPACING_BITS: u32 = 8u;
/// What a step is wider than a line, to all sides. units: units
const SEAL: i32 = 16;
/// Half a step's length, with the seal at its end. units: units
const HALF_ALONG: i32 = 144;
/// From a point to the middle of a step up. units: units
const HALF_STEP: i32 = 128;
/// Beyond what a sum over a piece's points can be.
const FAR: i32 = 0x40000000;

struct Slab {
    /// 32-bit words in a row of points along x.
    words_in_row: u32,
    /// Rows in a layer of points across z.
    rows_in_layer: u32,
    /// The slab's first layer.
    first_layer: u32,
    /// Words in the bits of one direction.
    words_in_direction: u32,
    /// Whether steps down have bits of their own.
    has_down: u32,
}

struct Piece {
    /// x, y, z of three corners, counter-clockwise from the front. units: units
    corners: array<i32, 9>,
    /// The box: its least and its greatest point. At most 256 points, all of the slab.
    first: array<i32, 3>,
    last: array<i32, 3>,
    is_two_sided: u32,
}

@group(0) @binding(0) var<uniform> slab: Slab;
@group(0) @binding(1) var<storage, read> pieces: array<Piece>;
/// Steps up x, y, z, then, if they have bits of their own, down.
@group(0) @binding(2) var<storage, read_write> bits: array<atomic<u32>>;

// Wide numbers, three at a time.

struct Wide3 {
    low: vec3<u32>,
    high: vec3<u32>,
}

fn wide(a: vec3<i32>) -> Wide3 {
    return Wide3(bitcast<vec3<u32>>(a), bitcast<vec3<u32>>(a >> vec3(31u)));
}

fn wide_sum(a: Wide3, b: Wide3) -> Wide3 {
    let low = a.low + b.low;
    return Wide3(low, a.high + b.high + select(vec3(0u), vec3(1u), low < a.low));
}

fn wide_difference(a: Wide3, b: Wide3) -> Wide3 {
    return Wide3(a.low - b.low, a.high - b.high - select(vec3(0u), vec3(1u), a.low < b.low));
}

/// Of unsigned factors.
fn unsigned_product(a: vec3<u32>, b: vec3<u32>) -> Wide3 {
    let low = vec3(0xffffu);
    let half = vec3(16u);
    let a_low = a & low;
    let a_high = a >> half;
    let b_low = b & low;
    let b_high = b >> half;
    // None of these sums reaches 2³²: (2¹⁶ − 1)² + 2 · (2¹⁶ − 1) = 2³² − 1.
    let bottom = a_low * b_low;
    let middle = a_high * b_low + (bottom >> half);
    let other = a_low * b_high + (middle & low);
    return Wide3((other << half) | (bottom & low), a_high * b_high + (middle >> half) + (other >> half));
}

/// Of factors of 32 bits, in full.
fn wide_product(a: vec3<i32>, b: vec3<i32>) -> Wide3 {
    let left = bitcast<vec3<u32>>(a);
    let right = bitcast<vec3<u32>>(b);
    // A negative factor is 2³² more when taken as unsigned.
    let product = unsigned_product(left, right);
    let over = select(vec3(0u), right, a < vec3(0)) + select(vec3(0u), left, b < vec3(0));
    return Wide3(product.low, product.high - over);
}

/// Of a wide factor and one of 32 bits, modulo 2⁶⁴.
fn wide_multiple(a: Wide3, b: vec3<i32>) -> Wide3 {
    let right = bitcast<vec3<u32>>(b);
    let product = unsigned_product(a.low, right);
    let over = select(vec3(0u), a.low, b < vec3(0));
    return Wide3(product.low, product.high + a.high * right - over);
}

fn is_negative(a: Wide3) -> vec3<bool> {
    return bitcast<vec3<i32>>(a.high) < vec3(0);
}

fn wide_size(a: Wide3) -> Wide3 {
    let negated = wide_difference(Wide3(vec3(0u), vec3(0u)), a);
    let negative = is_negative(a);
    return Wide3(select(a.low, negated.low, negative), select(a.high, negated.high, negative));
}

/// The greatest whole number of spacings that is no greater, no farther from zero than [`FAR`].
fn floor_spacings(a: Wide3) -> vec3<i32> {
    let high = bitcast<vec3<i32>>(a.high) >> vec3(SPACING_BITS);
    let low = (a.high << vec3(32u - SPACING_BITS)) | (a.low >> vec3(SPACING_BITS));
    let number = bitcast<vec3<i32>>(low);
    let limit = select(vec3(FAR), vec3(-FAR), high < vec3(0));
    // It fits into 32 bits if the rest is its sign.
    return select(limit, clamp(number, vec3(-FAR), vec3(FAR)), high == (number >> vec3(31u)));
}

// Wide numbers, one at a time: low, high.

fn sum(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let low = a.x + b.x;
    return vec2(low, a.y + b.y + select(0u, 1u, low < a.x));
}

fn total(a: Wide3) -> vec2<u32> {
    return sum(sum(vec2(a.low.x, a.high.x), vec2(a.low.y, a.high.y)), vec2(a.low.z, a.high.z));
}

/// Taken as unsigned: so, what is negative is not.
fn is_at_most(a: vec2<u32>, b: vec2<u32>) -> bool {
    return a.y < b.y || (a.y == b.y && a.x <= b.x);
}

fn in_spacings(a: vec2<u32>) -> vec2<u32> {
    return vec2(a.x << SPACING_BITS, (a.y << SPACING_BITS) | (a.x >> (32u - SPACING_BITS)));
}

// The triangle.

/// The edges of a triangle across an axis. A point of that plane is (j, k).
struct Edges {
    /// Their normals: for a point, n_j · j + n_k · k is how far it is along them.
    normal_j: vec3<i32>,
    normal_k: vec3<i32>,
    /// How far along them the triangle lies from the piece's first point: from `least` to `greatest`.
    least: Wide3,
    greatest: Wide3,
}

/// From the corners' coordinates in the plane, those of the piece's first point in units, and the normal of the
/// triangle along the axis, thrice: along an edge's normal, that is how far the corner across from the edge is from the edge.
fn edges_across(j: vec3<i32>, k: vec3<i32>, origin: vec2<i32>, normal: Wide3) -> Edges {
    let normal_j = k - k.yzx;
    let normal_k = j.yzx - j;
    let edge = wide_sum(
        wide_product(normal_j, j - vec3(origin.x)),
        wide_product(normal_k, k - vec3(origin.y)),
    );
    let corner = wide_sum(edge, normal);
    let is_below = is_negative(normal);
    return Edges(
        normal_j,
        normal_k,
        Wide3(select(edge.low, corner.low, is_below), select(edge.high, corner.high, is_below)),
        Wide3(select(corner.low, edge.low, is_below), select(corner.high, edge.high, is_below)),
    );
}

/// Where, along the edges' normals, points may be, in spacings from the piece's first, for no edge to separate the
/// triangle from the boxes around their steps.
struct Between {
    least: vec3<i32>,
    greatest: vec3<i32>,
}

/// `half`: the boxes' half sides. `shift`: from a point to its box's middle. units: units
fn between(edges: Edges, half: vec2<i32>, shift: vec2<i32>) -> Between {
    // Below 2²⁰ · (144 + 16 + 128).
    let reach = abs(edges.normal_j) * half.x + abs(edges.normal_k) * half.y;
    let moved = edges.normal_j * shift.x + edges.normal_k * shift.y;
    // What is not a multiple of the spacing on either side decides nothing: the sums over points are.
    return Between(
        floor_spacings(wide_sum(edges.least, wide(vec3(SPACING - 1) - reach - moved))),
        floor_spacings(wide_sum(edges.greatest, wide(reach - moved))),
    );
}

fn is_between(between: Between, sums: vec3<i32>) -> bool {
    return all(sums >= between.least) && all(sums <= between.greatest);
}

struct Triangle {
    /// Least and greatest coordinates.
    least: vec3<i32>,
    greatest: vec3<i32>,
    /// The piece's first point, last point. units: points
    first: vec3<i32>,
    last: vec3<i32>,
    corner: vec3<i32>,
    /// Twice its area vector; towards the front.
    normal: Wide3,
    across_x: Edges,
    across_y: Edges,
    across_z: Edges,
}

fn set_bits(word: u32, mask: u32) {
    // Most bits that are set are set by more than one triangle.
    if (atomicLoad(&bits[word]) & mask) != mask {
        atomicOr(&bits[word], mask);
    }
}

/// Sets the bits of the steps along one axis that the triangle is in the way of, from the words `up` and `down` on, if
/// they are to be set.
fn block(triangle: Triangle, axis: vec3<i32>, is_up: bool, up: u32, is_down: bool, down: u32) {
    let half = vec3(SEAL) + axis * (HALF_ALONG - SEAL);
    let shift = axis * HALF_STEP;
    let rounding = vec3(SPACING - 1);
    let bits_of = vec3(SPACING_BITS);
    // Rounded up and down to points.
    let first = max(triangle.first, (triangle.least - half - shift + rounding) >> bits_of);
    let last = min(triangle.last, (triangle.greatest + half - shift) >> bits_of);
    if any(first > last) {
        return;
    }
    let across_x = triangle.across_x;
    let across_y = triangle.across_y;
    let across_z = triangle.across_z;
    let between_x = between(across_x, half.yz, shift.yz);
    let between_y = between(across_y, half.zx, shift.zx);
    let between_z = between(across_z, half.xy, shift.xy);
    let normal = triangle.normal;
    // How far, along the normal, boxes' middles are from the plane, plus how far the boxes reach: between 0 and twice
    // that if they meet it.
    let reach = total(wide_multiple(wide_size(normal), half));
    let most = sum(reach, reach);
    let start = first * SPACING + shift - triangle.corner;
    var layer_place = sum(total(wide_multiple(normal, start)), reach);
    let along_x = in_spacings(vec2(normal.low.x, normal.high.x));
    let along_y = in_spacings(vec2(normal.low.y, normal.high.y));
    let along_z = in_spacings(vec2(normal.low.z, normal.high.z));
    for (var z = first.z; z <= last.z; z++) {
        let at_z = z - triangle.first.z;
        var row_place = layer_place;
        layer_place = sum(layer_place, along_z);
        for (var y = first.y; y <= last.y; y++) {
            let at_y = y - triangle.first.y;
            var place = row_place;
            row_place = sum(row_place, along_y);
            if !is_between(between_x, across_x.normal_j * at_y + across_x.normal_k * at_z) {
                continue;
            }
            let at_x = first.x - triangle.first.x;
            var sums_y = across_y.normal_j * at_z + across_y.normal_k * at_x;
            var sums_z = across_z.normal_j * at_x + across_z.normal_k * at_y;
            let row = ((u32(z) - slab.first_layer) * slab.rows_in_layer + u32(y)) * slab.words_in_row;
            var mask = 0u;
            for (var x = first.x; x <= last.x; x++) {
                let is_blocked = is_at_most(place, most) && is_between(between_y, sums_y)
                    && is_between(between_z, sums_z);
                mask |= select(0u, 1u, is_blocked) << (u32(x) & 31u);
                if (x & 31) == 31 || x == last.x {
                    if mask != 0u {
                        let word = row + (u32(x) >> 5u);
                        if is_up {
                            set_bits(up + word, mask);
                        }
                        if is_down {
                            set_bits(down + word, mask);
                        }
                    }
                    mask = 0u;
                }
                place = sum(place, along_x);
                sums_y += across_y.normal_k;
                sums_z += across_z.normal_j;
            }
        }
    }
}

@compute @workgroup_size(64)
fn interior_field(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&pieces) {
        return;
    }
    let corners = pieces[id.x].corners;
    let a = vec3(corners[0], corners[1], corners[2]);
    let b = vec3(corners[3], corners[4], corners[5]);
    let c = vec3(corners[6], corners[7], corners[8]);
    let u = b - a;
    let v = c - a;
    let normal = wide_difference(wide_product(u.yzx, v.zxy), wide_product(u.zxy, v.yzx));
    let first = vec3(pieces[id.x].first[0], pieces[id.x].first[1], pieces[id.x].first[2]);
    let last = vec3(pieces[id.x].last[0], pieces[id.x].last[1], pieces[id.x].last[2]);
    let origin = first * SPACING;
    let x = vec3(a.x, b.x, c.x);
    let y = vec3(a.y, b.y, c.y);
    let z = vec3(a.z, b.z, c.z);
    let triangle = Triangle(
        min(a, min(b, c)),
        max(a, max(b, c)),
        first,
        last,
        a,
        normal,
        edges_across(y, z, origin.yz, Wide3(normal.low.xxx, normal.high.xxx)),
        edges_across(z, x, origin.zx, Wide3(normal.low.yyy, normal.high.yyy)),
        edges_across(x, y, origin.xy, Wide3(normal.low.zzz, normal.high.zzz)),
    );
    // Steps that come from behind a one-sided triangle are free.
    let is_zero = (normal.low | normal.high) == vec3(0u);
    let looks_down = is_negative(normal);
    let is_two_sided = vec3(pieces[id.x].is_two_sided != 0u);
    let is_up = is_two_sided | looks_down | is_zero;
    let is_down = (is_two_sided | !looks_down) & vec3(slab.has_down != 0u);
    let size = slab.words_in_direction;
    for (var axis = 0u; axis < 3u; axis++) {
        if is_up[axis] || is_down[axis] {
            let unit = select(vec3(0), vec3(1), vec3(axis) == vec3(0u, 1u, 2u));
            block(triangle, unit, is_up[axis], axis * size, is_down[axis], (3u + axis) * size);
        }
    }
}
