// Whether a volume is hidden behind a reduced depth buffer: `occlusion/verdict.rs`, operation by operation. What may
// be off by how much is counted there.
//
// Clip space is reverse-Z: z = w on the near plane, z = 0 infinitely far away. Comparisons of what may not be a
// number are made with its bits.
#define_import_path bevy_skyline::occludee

#import bevy_skyline::clip::{
    CLIP_ERROR, CLIP_TINY, ClipFrame, PIXEL_ERROR, Quotients, clip_frame, clip_magnitude, clip_point, clip_way,
    is_calculable, no_quotients, with_corner,
}

/// Mirrors `GpuOcclusionView`.
struct OcclusionView {
    clip_from_world: mat4x4<f32>,
    /// units: px
    viewport: vec2<f32>,
    /// Pixels that a texel of level 0 stands for.
    block: vec2<u32>,
    /// 1: a texel is its block's top left pixel alone.
    strided: u32,
    /// 0: everything is visible.
    level_count: u32,
    /// Top left pixel of the viewport in the depth texture. units: px
    origin: vec2<u32>,
    /// First texel, columns, rows, 0.
    level: array<vec4<u32>, 16>,
};

@group(0) @binding(0) var<storage, read> occlusion_view: OcclusionView;
/// All levels, level 0 first, row by row from the top left. The farthest (smallest) depth of what each covers.
@group(0) @binding(1) var<storage, read> reduced_depth: array<f32>;
/// Three corners a triangle; the first's w is the radius.
@group(0) @binding(2) var<storage, read> swept_triangles: array<vec4<f32>>;

const VERDICT_VISIBLE: u32 = 0u;
const VERDICT_HIDDEN: u32 = 1u;
const VERDICT_OUTSIDE: u32 = 2u;

/// As in `occlusion/verdict.rs`.
/// units: px
const SNAP_PX: f32 = 0.015625;
const DEPTH_GUARD: f32 = 1.0000019073486328125;
const MOST_STEPS: u32 = 32768u;
const SMALLEST_NORMAL: f32 = 1.1754943508222875e-38;

/// What pixels a volume may cover, and how near.
struct Footprint {
    kind: u32,
    first: vec2<u32>,
    last: vec2<u32>,
    nearest: f32,
};

const FOOTPRINT_NOTHING: u32 = 0u;
/// It may touch the near plane.
const FOOTPRINT_NEAR: u32 = 1u;
const FOOTPRINT_PIXELS: u32 = 2u;

/// `rows` are those of the affine matrix, as Bevy's `Mesh` has them.
fn occludee_frame(rows: mat3x4<f32>) -> ClipFrame {
    return clip_frame(occlusion_view.clip_from_world, rows);
}

fn footprint(quotients: Quotients, slack: vec4<f32>) -> Footprint {
    var out: Footprint;
    out.kind = FOOTPRINT_NEAR;
    if quotients.w_min <= 2.0 * slack.w {
        return out;
    }
    let per_w = 1.0 / (quotients.w_min - slack.w);
    let grow = (max(abs(quotients.lo), abs(quotients.hi)) * slack.w + slack) * per_w;
    let nearest = (quotients.hi.z + grow.z) * DEPTH_GUARD;
    if nearest >= 1.0 {
        return out;
    }
    let lo = clamp(quotients.lo - grow, vec4(-2.0), vec4(2.0));
    let hi = clamp(quotients.hi + grow, vec4(-2.0), vec4(2.0));
    let half_size = occlusion_view.viewport * 0.5;
    let margin = occlusion_view.viewport * PIXEL_ERROR + vec2(SNAP_PX);
    let low = vec2(1.0 + lo.x, 1.0 - hi.y) * half_size - margin;
    let high = vec2(1.0 + hi.x, 1.0 - lo.y) * half_size + margin;
    if nearest < 0.0 || any(high < vec2(0.0)) || any(low >= occlusion_view.viewport) {
        out.kind = FOOTPRINT_NOTHING;
        return out;
    }
    out.kind = FOOTPRINT_PIXELS;
    out.first = vec2<u32>(max(low, vec2(0.0)));
    out.last = vec2<u32>(min(high, occlusion_view.viewport - 1.0));
    out.nearest = max(nearest, SMALLEST_NORMAL);
    return out;
}

/// By the bits, which are in the order of the numbers from 0 to 1; all others hide nothing.
fn hides(level: u32, x: u32, y: u32, nearest: u32) -> bool {
    let place = occlusion_view.level[level];
    let texel = bitcast<u32>(reduced_depth[place.x + y * place.y + x]);
    return nearest < texel && texel <= bitcast<u32>(1.0f);
}

/// Whether `nearest` lies strictly behind all texels of level 0 from `first` to `last`.
fn is_behind(first: vec2<u32>, last: vec2<u32>, nearest: u32) -> bool {
    let span = max(last.x - first.x, last.y - first.y);
    // Where the rectangle spans at most two cells each way.
    var top = 0u;
    if span > 1u {
        top = 32u - countLeadingZeros(span - 1u);
    }
    // Beyond the last column and row there is nothing.
    let edge = occlusion_view.level[0].yz - 1u;
    let open = select(last, vec2(0xffffffffu), last == edge);
    var level = top;
    var x = first.x >> top;
    var y = first.y >> top;
    for (var step = 0u; step < MOST_STEPS; step++) {
        let low = first >> vec2(level);
        let high = last >> vec2(level);
        let within = x >= low.x && x <= high.x && y >= low.y && y <= high.y;
        if within && !hides(level, x, y, nearest) {
            let begin = vec2(x, y) << vec2(level);
            let end = ((vec2(x, y) + 1u) << vec2(level)) - 1u;
            if all(begin >= first) && all(end <= open) {
                return false;
            }
            level -= 1u;
            x *= 2u;
            y *= 2u;
            continue;
        }
        // Up from the last of four children: one level for each pair of trailing ones.
        let up = min(countTrailingZeros(~(x & y)), top - level);
        level += up;
        x >>= up;
        y >>= up;
        if level < top {
            y += x & 1u;
            x ^= 1u;
        } else if x < (last.x >> top) {
            x += 1u;
        } else if y < (last.y >> top) {
            x = first.x >> top;
            y += 1u;
        } else {
            return true;
        }
    }
    return false;
}

/// Of something that covers at most these pixels, nowhere nearer than its depth.
fn rect_verdict(pixels: Footprint) -> u32 {
    let block = occlusion_view.block;
    let past = pixels.last / block;
    var start = pixels.first / block;
    if occlusion_view.strided != 0u {
        start = (pixels.first + block - 1u) / block;
        if any(start > past) {
            return VERDICT_HIDDEN;
        }
    }
    return select(VERDICT_VISIBLE, VERDICT_HIDDEN, is_behind(start, past, bitcast<u32>(pixels.nearest)));
}

/// Half the viewport's size, and that and the margin around it. units: px
fn sides() -> vec4<f32> {
    let half_size = occlusion_view.viewport * 0.5;
    return vec4(half_size, half_size + (occlusion_view.viewport * PIXEL_ERROR + vec2(SNAP_PX)));
}

/// By how much the corner lies within the planes x = -w, y = -w, widened by the margin and in pixels times w, and z = 0.
fn within_low(corner: vec4<f32>) -> vec3<f32> {
    let sides = sides();
    return vec3(corner.xy * sides.xy + sides.zw * corner.w, corner.z);
}

/// The same of the planes x = w, y = w, and z = w.
fn within_high(corner: vec4<f32>) -> vec3<f32> {
    let sides = sides();
    return vec3(sides.zw * corner.w - corner.xy * sides.xy, corner.w - corner.z);
}

/// Whether all corners lie on the outer side of one plane, by more than the slack; from the most of each.
fn is_off(most_low: vec3<f32>, most_high: vec3<f32>, slack: vec4<f32>) -> bool {
    let sides = sides();
    let reach = vec3(slack.xy * sides.xy, slack.z);
    let side = sides.zw * slack.w;
    let low = most_low + (reach + vec3(side, 0.0));
    let high = most_high + (reach + vec3(side, slack.w));
    return any(low < vec3(0.0)) || any(high < vec3(0.0));
}

/// Verdict on all points `centre + u axis_0 + v axis_1 + w axis_2` with u, v, w in -1..=1.
fn box_verdict(frame: ClipFrame, centre: vec3<f32>, axis_0: vec3<f32>, axis_1: vec3<f32>, axis_2: vec3<f32>) -> u32 {
    if occlusion_view.level_count == 0u {
        return VERDICT_VISIBLE;
    }
    let magnitude = clip_magnitude(frame, abs(centre) + abs(axis_0) + abs(axis_1) + abs(axis_2));
    if !is_calculable(magnitude) {
        return VERDICT_VISIBLE;
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
    var quotients = with_corner(with_corner(with_corner(with_corner(no_quotients(), p0), p1), p2), p3);
    quotients = with_corner(with_corner(with_corner(with_corner(quotients, p4), p5), p6), p7);
    let pixels = footprint(quotients, slack);
    if pixels.kind == FOOTPRINT_PIXELS {
        return rect_verdict(pixels);
    }
    if pixels.kind == FOOTPRINT_NOTHING {
        return VERDICT_OUTSIDE;
    }
    let low = max(
        max(max(within_low(p0), within_low(p1)), max(within_low(p2), within_low(p3))),
        max(max(within_low(p4), within_low(p5)), max(within_low(p6), within_low(p7))),
    );
    let high = max(
        max(max(within_high(p0), within_high(p1)), max(within_high(p2), within_high(p3))),
        max(max(within_high(p4), within_high(p5)), max(within_high(p6), within_high(p7))),
    );
    return select(VERDICT_VISIBLE, VERDICT_OUTSIDE, is_off(low, high, slack));
}

/// Verdict on the swept triangle at `index`; `reach` is how far clip coordinates reach within one unit around a
/// local point.
fn triangle_verdict(frame: ClipFrame, reach: vec4<f32>, index: u32) -> u32 {
    let first = swept_triangles[3u * index];
    let radius = abs(first.w);
    let a = first.xyz;
    let b = swept_triangles[3u * index + 1u].xyz;
    let c = swept_triangles[3u * index + 2u].xyz;
    let magnitude = clip_magnitude(frame, abs(a) + abs(b - a) + abs(c - a) + vec3(radius));
    let slack = magnitude * CLIP_ERROR + vec4(CLIP_TINY) + reach * radius;
    if !is_calculable(magnitude) || !is_calculable(slack) {
        return VERDICT_VISIBLE;
    }
    let p0 = clip_point(frame, a);
    let p1 = clip_point(frame, b);
    let p2 = clip_point(frame, c);
    let pixels = footprint(with_corner(with_corner(with_corner(no_quotients(), p0), p1), p2), slack);
    if pixels.kind == FOOTPRINT_PIXELS {
        return rect_verdict(pixels);
    }
    if pixels.kind == FOOTPRINT_NOTHING {
        return VERDICT_OUTSIDE;
    }
    let low = max(max(within_low(p0), within_low(p1)), within_low(p2));
    let high = max(max(within_high(p0), within_high(p1)), within_high(p2));
    return select(VERDICT_VISIBLE, VERDICT_OUTSIDE, is_off(low, high, slack));
}

/// Verdict on `count` swept triangles from the one at `first` on: `VERDICT_OUTSIDE` if all are, `VERDICT_VISIBLE` if
/// any is.
///
/// # Limits
/// More than 32,768 triangles are visible.
fn proxy_verdict(frame: ClipFrame, first: u32, count: u32) -> u32 {
    if occlusion_view.level_count == 0u || count > MOST_STEPS {
        return VERDICT_VISIBLE;
    }
    let reach = sqrt(frame.x * frame.x + frame.y * frame.y + frame.z * frame.z + vec4(1e-36));
    var verdict = VERDICT_OUTSIDE;
    for (var i = 0u; i < count; i++) {
        let one = triangle_verdict(frame, reach, first + i);
        if one == VERDICT_VISIBLE {
            return VERDICT_VISIBLE;
        }
        verdict = min(verdict, one);
    }
    return verdict;
}
