// Draws the boxes' back faces; the nearest entry wins and is kept per pixel, or per tile of pixels.
//
// A fragment stands for a whole tile, so each box is first grown by what the tile's rays can stray from the
// one through its middle: whenever some ray of the tile is inside the box at t, the middle ray is inside the
// grown box at t. The entry kept is therefore never later than any ray's own. Entry is computed from
// the box's planes, not read off its front faces, so a camera inside a box is right too.
//
// Out: R32Float, t of the nearest entry; cleared to -1 = no box.
// P1 section 3.3.

#import bevy_skyline::boxes::{BASEMENT, Box, Bounds, box_bounds}
#import bevy_skyline::types::{FLAG_MIRRORED, T_NEVER}
#import bevy_skyline::view_rays::{ray_at, view}

@group(1) @binding(0) var<storage, read> boxes: array<Box>;

struct Vertex {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) low: vec3<f32>,
    @location(1) @interpolate(flat) high: vec3<f32>,
};

/// Corners of the twelve triangles, bit 0 = x, bit 1 = y, bit 2 = z; counter-clockwise seen from outside.
const CORNERS = array<u32, 36>(
    0u, 4u, 6u, 0u, 6u, 2u,
    1u, 3u, 7u, 1u, 7u, 5u,
    0u, 1u, 5u, 0u, 5u, 4u,
    2u, 6u, 7u, 2u, 7u, 3u,
    0u, 2u, 3u, 0u, 3u, 1u,
    4u, 5u, 7u, 4u, 7u, 6u,
);

/// What the rays of a fragment's tile can lie beside its middle one at t. units: grid
fn beam(t: f32) -> vec3<f32> {
    let width = f32(view.tile_px);
    return width * (view.beam_a + view.beam_b * t) + view.beam_slack;
}

@vertex
fn vertex(@builtin(vertex_index) vertex: u32, @builtin(instance_index) instance: u32) -> Vertex {
    var out: Vertex;
    if instance >= view.box_capacity {
        return out;
    }
    let box = boxes[instance];
    var bounds = box_bounds(box);
    let endless = box.level == BASEMENT;
    let half_extent = 0.5 * (bounds.high - bounds.low);
    let middle = bounds.low + half_extent;
    var t_farthest = dot(view.depth_from_grid.xyz, middle) + view.depth_from_grid.w
        + dot(abs(view.depth_from_grid.xyz), half_extent);
    let grow = beam(clamp(t_farthest, 0.0, view.t_far));
    bounds.low -= grow;
    bounds.high += grow;
    out.low = bounds.low;
    out.high = bounds.high;

    var corner_index = vertex;
    if (view.flags & FLAG_MIRRORED) != 0u {
        corner_index = vertex - vertex % 3u + (3u - vertex % 3u) % 3u;
    }
    var corners = CORNERS;
    let corner = corners[corner_index];
    let upper = vec3((corner & 1u) != 0u, (corner & 2u) != 0u, (corner & 4u) != 0u);
    var at = vec4(select(bounds.low, bounds.high, upper), 1.0);
    if endless && !upper.y {
        // Straight down, infinitely far.
        at = vec4(0.0, -1.0, 0.0, 0.0);
    }
    out.position = view.clip_from_grid * at;
    // Whole tiles reach past the viewport's right and lower edges.
    let tiles = (view.size_px + view.tile_px - 1u) / view.tile_px;
    let scale = vec2<f32>(view.size_px) / vec2<f32>(tiles * view.tile_px);
    out.position.x = (out.position.x + out.position.w) * scale.x - out.position.w;
    out.position.y = out.position.w - (out.position.w - out.position.y) * scale.y;
    // Only what is behind the camera may be clipped: the far plane must not open a box.
    out.position.z = 0.5 * out.position.w;
    return out;
}

struct Entry {
    @location(0) t: f32,
    @builtin(frag_depth) depth: f32,
};

@fragment
fn fragment(in: Vertex) -> Entry {
    let ray = ray_at(f32(view.tile_px) * in.position.xy);
    let moves = abs(ray.direction) > vec3(1e-15);
    let inverse = 1.0 / select(vec3(1.0), ray.direction, moves);
    let a = (in.low - ray.origin) * inverse;
    let b = (in.high - ray.origin) * inverse;
    let enter = select(vec3(0.0), min(a, b), moves);
    let t = max(max(enter.x, enter.y), max(enter.z, 0.0));
    var out: Entry;
    out.t = t;
    // Any falling function of t will do to keep the nearest.
    out.depth = 1.0 / (1.0 + t);
    return out;
}
