// The list of boxes that `subdivide` leaves for `box_entry`, and how a box is named.
#define_import_path bevy_skyline::boxes

#import bevy_skyline::height_field::{field, node_range}
#import bevy_skyline::view_rays::view

/// A node of the pyramid: x = i | j << 16, y = level.
struct Box {
    ij: u32,
    level: u32,
};

/// Level of the box that stands for everything below the lowest sample: endless walls.
const BASEMENT: u32 = 31u;
/// `counts` holds four words a pass, (workgroups, 1, 1, nodes), then the arguments of the boxes' draw:
/// (vertices, boxes, 0, 0).
const MAX_PASSES: u32 = 20u;
const BOX_COUNT: u32 = 4u * MAX_PASSES + 1u;

fn box_node(box: Box) -> vec2<i32> {
    return vec2<i32>(vec2(box.ij & 0xffffu, box.ij >> 16u));
}

struct Bounds {
    low: vec3<f32>,
    high: vec3<f32>,
};

/// Bounds of everything a ray can meet in a node. On the footprint's border that includes the wall.
fn box_bounds(box: Box) -> Bounds {
    var bounds: Bounds;
    if box.level == BASEMENT {
        let low = vec2<f32>(-view.anchor);
        let high = vec2<f32>(field.cells - view.anchor);
        return Bounds(vec3(low.x, -1e12, low.y), vec3(high.x, view.y_min, high.y));
    }
    let node = box_node(box);
    let low = node << vec2(box.level);
    let high = min((node + 1) << vec2(box.level), field.cells);
    let range = node_range(box.level, node, view.anchor_y);
    let at_border = any(low == vec2(0)) || any(high == field.cells);
    let a = vec2<f32>(low - view.anchor);
    let b = vec2<f32>(high - view.anchor);
    return Bounds(
        vec3(a.x, select(range.y, view.y_min, at_border), a.y),
        vec3(b.x, range.x, b.y),
    );
}
