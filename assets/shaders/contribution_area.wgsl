// How much of the picture a box covers, at most: `contribution/area.rs`, operation by operation. What may be off by how
// much is counted there.
#define_import_path bevy_skyline::contribution_area

#import bevy_skyline::clip::{
    CLIP_ERROR, CLIP_TINY, ClipFrame, LARGEST, PIXEL_ERROR, Quotients, clip_frame, clip_magnitude, clip_point,
    clip_way, is_calculable, no_quotients, with_corner,
}

/// Mirrors `GpuAreaView`.
struct AreaView {
    clip_from_world: mat4x4<f32>,
    /// units: px
    viewport: vec2<f32>,
    /// What covers less leaves. units: px²
    leaves: f32,
    /// What has left comes back from here on. units: px²
    comes_back: f32,
    /// Whether any slot is another entity's than in the last frame.
    any_fresh: u32,
};

/// As in `contribution/area.rs`.
const AREA_GUARD: f32 = 1.00000095367431640625;
const NEAR_GUARD: f32 = 2.0;
/// units: px
const MOST_SIDE_PX: f32 = 1e9;

/// By how much a corner is in front of the near plane, moved by `guard` towards the eye.
fn in_front(corner: vec4<f32>, guard: f32) -> f32 {
    return corner.w - corner.z + guard;
}

/// Takes in the point where an edge crosses the plane, if it does.
fn with_crossing(all: Quotients, a: vec4<f32>, b: vec4<f32>, guard: f32) -> Quotients {
    let d_a = in_front(a, guard);
    let d_b = in_front(b, guard);
    if (d_a >= 0.0) == (d_b >= 0.0) {
        return all;
    }
    // From the end behind the plane, which the crossing must not be put too far from.
    if d_a < 0.0 {
        return with_corner(all, a + (b - a) * (d_a / (d_a - d_b)));
    }
    return with_corner(all, b + (a - b) * (d_b / (d_b - d_a)));
}

fn with_corner_in_front(all: Quotients, corner: vec4<f32>, guard: f32) -> Quotients {
    if in_front(corner, guard) >= 0.0 {
        return with_corner(all, corner);
    }
    return all;
}

/// Of points that may be off by the slack. units: px²
fn covered(viewport: vec2<f32>, quotients: Quotients, slack: vec4<f32>) -> f32 {
    // Of no points.
    if quotients.w_min == LARGEST {
        return 0.0;
    }
    if quotients.w_min <= 2.0 * slack.w {
        return viewport.x * viewport.y * AREA_GUARD;
    }
    let per_w = 1.0 / (quotients.w_min - slack.w);
    let grow = (max(abs(quotients.lo), abs(quotients.hi)) * slack.w + slack) * per_w;
    let lo = clamp(quotients.lo - grow, vec4(-2.0), vec4(2.0));
    let hi = clamp(quotients.hi + grow, vec4(-2.0), vec4(2.0));
    let half_size = viewport * 0.5;
    let margin = viewport * PIXEL_ERROR;
    let low = vec2(1.0 + lo.x, 1.0 - hi.y) * half_size - margin;
    let high = vec2(1.0 + hi.x, 1.0 - lo.y) * half_size + margin;
    let sides = clamp(high, vec2(0.0), viewport) - clamp(low, vec2(0.0), viewport);
    return sides.x * sides.y * AREA_GUARD;
}

/// Area of the smallest rectangle around the projection of what of a box is in front of the near plane, clipped to the
/// viewport; `LARGEST` where it cannot be calculated with. `rows` are those of the affine matrix. units: px²
fn area_px2(
    clip_from_world: mat4x4<f32>,
    viewport: vec2<f32>,
    rows: mat3x4<f32>,
    centre: vec3<f32>,
    axis_0: vec3<f32>,
    axis_1: vec3<f32>,
    axis_2: vec3<f32>,
) -> f32 {
    let frame = clip_frame(clip_from_world, rows);
    let magnitude = clip_magnitude(frame, abs(centre) + abs(axis_0) + abs(axis_1) + abs(axis_2));
    if any(bitcast<vec2<u32>>(viewport) > vec2(bitcast<u32>(MOST_SIDE_PX))) || !is_calculable(magnitude) {
        return LARGEST;
    }
    let slack = magnitude * CLIP_ERROR + vec4(CLIP_TINY);
    let middle = clip_point(frame, centre);
    let a = clip_way(frame, axis_0);
    let b = clip_way(frame, axis_1);
    let c = clip_way(frame, axis_2);
    let p0 = ((middle - a) - b) - c;
    let p1 = ((middle - a) - b) + c;
    let p2 = ((middle - a) + b) - c;
    let p3 = ((middle - a) + b) + c;
    let p4 = ((middle + a) - b) - c;
    let p5 = ((middle + a) - b) + c;
    let p6 = ((middle + a) + b) - c;
    let p7 = ((middle + a) + b) + c;
    let guard = NEAR_GUARD * (slack.z + slack.w);
    let nearest = min(
        min(min(in_front(p0, guard), in_front(p1, guard)), min(in_front(p2, guard), in_front(p3, guard))),
        min(min(in_front(p4, guard), in_front(p5, guard)), min(in_front(p6, guard), in_front(p7, guard))),
    );
    var all = no_quotients();
    if nearest >= 0.0 {
        all = with_corner(with_corner(with_corner(with_corner(all, p0), p1), p2), p3);
        all = with_corner(with_corner(with_corner(with_corner(all, p4), p5), p6), p7);
        return covered(viewport, all, slack);
    }
    all = with_corner_in_front(all, p0, guard);
    all = with_corner_in_front(all, p1, guard);
    all = with_corner_in_front(all, p2, guard);
    all = with_corner_in_front(all, p3, guard);
    all = with_corner_in_front(all, p4, guard);
    all = with_corner_in_front(all, p5, guard);
    all = with_corner_in_front(all, p6, guard);
    all = with_corner_in_front(all, p7, guard);
    // Edges along axis_2, axis_1, axis_0.
    all = with_crossing(all, p0, p1, guard);
    all = with_crossing(all, p2, p3, guard);
    all = with_crossing(all, p4, p5, guard);
    all = with_crossing(all, p6, p7, guard);
    all = with_crossing(all, p0, p2, guard);
    all = with_crossing(all, p1, p3, guard);
    all = with_crossing(all, p4, p6, guard);
    all = with_crossing(all, p5, p7, guard);
    all = with_crossing(all, p0, p4, guard);
    all = with_crossing(all, p1, p5, guard);
    all = with_crossing(all, p2, p6, guard);
    all = with_crossing(all, p3, p7, guard);
    return covered(viewport, all, slack);
}
