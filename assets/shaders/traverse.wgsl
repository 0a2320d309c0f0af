// One loop for all four traversals. They differ in where it starts and in how far up the pyramid it may go:
//
//   per texel   from the footprint's border,  cells only
//   max mip     from the footprint's border,  starts at the root, any level
//   boxes       from the nearest box,         cells only (or the level a pixel spans, where an error is allowed)
//   hybrid      from the beam's safe start,   starts at the beam's level, any level
#define_import_path bevy_skyline::traverse

#import bevy_skyline::types::{T_NEVER, UNIT_ROUNDOFF, TRAVERSAL_PER_TEXEL}
#import bevy_skyline::height_field::{view, node_range, cell_corners}
#import bevy_skyline::rays::{
    Ray, above_cell, border_t, cell_at, clears_cell, first_fall, first_rise, height_guard, height_of, next_cell,
}

struct Hit {
    /// `T_NEVER` for none.
    t: f32,
    /// Nodes and cells read on the way.
    reads: u32,
};

/// Which levels a ray may use.
struct Levels {
    start: u32,
    highest: u32,
    /// Follow the level whose cells span a pixel at t, no higher.
    follow_pixel: bool,
};

/// The level whose nodes span about `max_error_px` pixels at t.
fn pixel_level(t: f32) -> u32 {
    let texels = view.max_error_px * (view.pixel_a + view.pixel_b * t);
    return u32(clamp(floor(log2(max(texels, 1.0))), 0.0, f32(view.levels)));
}

/// Where the ray next comes from the air to the surface, or enters the footprint below it, at or after
/// `t_start`, where it is in the air or at the footprint's border. Nothing at or beyond `t_stop` is looked
/// for. The ray must be within the footprint from `t_start` to `t_stop`.
fn cast_ray(ray: Ray, t_start: f32, t_stop: f32, levels: Levels) -> Hit {
    var hit = Hit(T_NEVER, 0u);
    var cell = cell_at(ray, t_start);
    var t = t_start;
    var k = levels.start;
    let ahead = ray.ahead;
    loop {
        let node = cell >> vec2(k);
        let border = (node + ahead) << vec2(k);
        let leave = border_t(ray, border);
        let t_leave = min(leave.x, leave.y);
        var passed = true;
        if k > 0u {
            hit.reads += 1u;
            let range = node_range(k, node);
            let low = min(height_of(ray, t), height_of(ray, t_leave));
            if low <= range.x + height_guard(ray, min(t_leave, t_stop)) {
                // Near enough to its surface to matter. May its middle height stand for it?
                if range.x - range.y <= 2.0 * (view.lod_a + view.lod_b * t) && view.lod_a + view.lod_b * t > 0.0 {
                    let middle = 0.5 * (range.x + range.y);
                    if height_of(ray, t) <= middle {
                        hit.t = t;
                    } else if height_of(ray, t_leave) <= middle {
                        hit.t = clamp((middle - ray.origin.y) / ray.direction.y, t, t_leave);
                    }
                } else {
                    passed = false;
                }
            }
        } else {
            hit.reads += 1u;
            let corners = cell_corners(cell);
            let above = above_cell(ray, cell, corners);
            if !clears_cell(ray, above, corners) {
                var s = 0.0;
                if above.c > 0.0 {
                    s = first_fall(above.c, above.b, above.a);
                }
                if s <= above.s_max {
                    hit.t = above.t_in + s;
                }
            }
        }
        if hit.t < T_NEVER {
            break;
        }
        if !passed {
            k -= 1u;
            continue;
        }
        // On to the next node.
        t = max(t, t_leave);
        if t >= t_stop || (ray.direction.y >= 0.0 && height_of(ray, t) > view.y_max + height_guard(ray, t)) {
            break;
        }
        let x_first = leave.x <= leave.y;
        cell = next_cell(ray, cell, k, leave);
        if any(cell < vec2(0)) || any(cell >= view.cells) {
            break;
        }
        // Up while the border just crossed bounds larger nodes too.
        var highest = levels.highest;
        if levels.follow_pixel {
            highest = pixel_level(t);
        }
        let crossed = u32(select(border.y, border.x, x_first));
        if k < highest && ((crossed >> k) & 1u) == 0u {
            k += 1u;
        }
        k = min(k, highest);
    }
    return hit;
}

/// For a ray that starts inside the ground: when it first comes out into the air.
struct Emergence {
    /// `T_NEVER` if it never does.
    t: f32,
    /// Whether the same cell's surface takes it in again, and when.
    falls_t: f32,
    reads: u32,
};

fn emerge(ray: Ray, t_stop: f32) -> Emergence {
    var out = Emergence(T_NEVER, T_NEVER, 0u);
    var cell = cell_at(ray, 0.0);
    var t = 0.0;
    var k = select(view.levels, 0u, view.traversal == TRAVERSAL_PER_TEXEL);
    let highest = k;
    loop {
        let node = cell >> vec2(k);
        let border = (node + ray.ahead) << vec2(k);
        let leave = border_t(ray, border);
        let t_leave = min(leave.x, leave.y);
        out.reads += 1u;
        if k > 0u {
            let high = max(height_of(ray, t), height_of(ray, t_leave));
            if high >= node_range(k, node).y - height_guard(ray, min(t_leave, t_stop)) {
                k -= 1u;
                continue;
            }
        } else {
            let above = above_cell(ray, cell, cell_corners(cell));
            var s = 0.0;
            if above.c <= 0.0 {
                s = first_rise(above.c, above.b, above.a);
            }
            if s <= above.s_max {
                out.t = above.t_in + s;
                // From the rise the polynomial is b' r + a r^2, with b' >= 0 and nothing left over.
                let b = max(above.b + 2.0 * above.a * s, 0.0);
                let again = select(T_NEVER, b / -above.a, above.a < -1e-30);
                if above.c > 0.0 {
                    let fall = first_fall(above.c, above.b, above.a);
                    out.falls_t = select(T_NEVER, above.t_in + fall, fall <= above.s_max);
                } else if s + again <= above.s_max {
                    out.falls_t = out.t + again;
                }
                if out.falls_t == T_NEVER {
                    // Nothing more in this cell: the air begins at its far border.
                    out.t = t_leave;
                }
                return out;
            }
        }
        t = max(t, t_leave);
        if t >= t_stop {
            return out;
        }
        let x_first = leave.x <= leave.y;
        cell = next_cell(ray, cell, k, leave);
        if any(cell < vec2(0)) || any(cell >= view.cells) {
            return out;
        }
        let crossed = u32(select(border.y, border.x, x_first));
        if k < highest && ((crossed >> k) & 1u) == 0u {
            k += 1u;
        }
    }
    return out;
}
