// Divides the terrain's bounding box breadth-first, once a frame and view: one dispatch a level, each of as
// many workgroups as the level before it left nodes for.
//
// In:  `nodes_in`, the nodes of this level. Out: `nodes_out`, the children worth looking at; `boxes`, the
// nodes that are small enough. A child the next list has no room for becomes a box at once: a larger box is
// still a bound. Boxes beyond the list's end are counted but not kept; the passes that follow see the count
// and do without boxes.
// P1 section 3.2: a node is divided while it is larger than a box, in view, and covers enough pixels.

#import bevy_skyline::boxes::{BASEMENT, BOX_COUNT, Box, box_bounds, box_node}
#import bevy_skyline::height_field::level_size
#import bevy_skyline::types::{FLAG_BASEMENT, T_NEVER}
#import bevy_skyline::view_rays::view

struct Pass {
    index: u32,
    node_capacity: u32,
};

@group(1) @binding(0) var<uniform> pass_info: Pass;
@group(1) @binding(1) var<storage, read> nodes_in: array<Box>;
@group(1) @binding(2) var<storage, read_write> nodes_out: array<Box>;
@group(1) @binding(3) var<storage, read_write> boxes: array<Box>;
@group(1) @binding(4) var<storage, read_write> counts: array<atomic<u32>>;

fn add_box(box: Box) {
    let at = atomicAdd(&counts[BOX_COUNT], 1u);
    if at < view.box_capacity {
        boxes[at] = box;
    }
}

/// Conservative: a box is out of view only if it lies wholly behind one plane by more than rounding.
fn in_view(low: vec3<f32>, high: vec3<f32>) -> bool {
    for (var i = 0; i < 5; i++) {
        let plane = view.frustum[i];
        let farthest = select(low, high, plane.xyz >= vec3(0.0));
        let terms = plane.xyz * farthest;
        let slack = 1e-6 * (abs(terms.x) + abs(terms.y) + abs(terms.z) + abs(plane.w));
        if terms.x + terms.y + terms.z + plane.w < -slack {
            return false;
        }
    }
    return true;
}

/// Area that a rectangle at height y covers on the screen; `T_NEVER` if it reaches behind the camera.
fn projected_area(low: vec2<f32>, high: vec2<f32>, y: f32) -> f32 {
    let corners = array(low, vec2(high.x, low.y), high, vec2(low.x, high.y));
    var px = array(vec2(0.0), vec2(0.0), vec2(0.0), vec2(0.0));
    for (var i = 0; i < 4; i++) {
        let clip = view.clip_from_grid * vec4(corners[i].x, y, corners[i].y, 1.0);
        if clip.w <= 1e-12 {
            return T_NEVER;
        }
        px[i] = clip.xy / clip.w * 0.5 * vec2<f32>(view.size_px);
    }
    let p = px[2] - px[0];
    let q = px[3] - px[1];
    return 0.5 * abs(p.x * q.y - p.y * q.x);
}

@compute @workgroup_size(64, 1, 1)
fn subdivide(@builtin(global_invocation_id) id: vec3<u32>) {
    let count = min(atomicLoad(&counts[4u * pass_info.index + 3u]), pass_info.node_capacity);
    if id.x >= count {
        return;
    }
    let node = nodes_in[id.x];
    if pass_info.index == 0u && (view.flags & FLAG_BASEMENT) != 0u {
        add_box(Box(0u, BASEMENT));
    }
    let bounds = box_bounds(node);
    if !in_view(bounds.low, bounds.high) {
        return;
    }
    if node.level <= view.box_level
        || projected_area(bounds.low.xz, bounds.high.xz, bounds.low.y) < view.box_area_px {
        add_box(node);
        return;
    }
    let size = level_size(node.level - 1u);
    let first = box_node(node) * 2;
    for (var child = 0; child < 4; child++) {
        let at = first + vec2(child & 1, child >> 1u);
        if any(at >= size) {
            continue;
        }
        let box = Box(u32(at.x) | (u32(at.y) << 16u), node.level - 1u);
        let slot = atomicAdd(&counts[4u * pass_info.index + 7u], 1u);
        if slot < pass_info.node_capacity {
            nodes_out[slot] = box;
            atomicMax(&counts[4u * pass_info.index + 4u], slot / 64u + 1u);
        } else {
            add_box(box);
        }
    }
}
