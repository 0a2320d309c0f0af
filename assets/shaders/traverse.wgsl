// One loop for all four traversals. They differ in where it starts and in how far up the pyramid it may go:
//
//   per texel   from the footprint's border,  cells only
//   max mip     from the footprint's border,  starts at the root, any level
//   boxes       from the nearest box,         cells only (or the level a pixel spans, where an error is allowed)
//   hybrid      from the beam's safe start,   starts at the beam's level, any level
#define_import_path bevy_skyline::traverse

#import bevy_skyline::types::{T_NEVER, UNIT_ROUNDOFF, TRAVERSAL_PER_TEXEL}
#import bevy_skyline::height_field::{field, node_range, cell_corners}
#import bevy_skyline::rays::{
    Place, Ray, above_cell, cell_at, clears_cell, exit_of, first_fall, first_rise, height_guard, height_of, move_on,
}
#import bevy_skyline::view_rays::view

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
    /// No node may stand for its surface: for rays that have just come out of the ground, where the middle of
    /// a node may still be above them.
    exact: bool,
};

/// The level whose nodes span about `max_error_px` pixels at t.
fn pixel_level(t: f32) -> u32 {
    let texels = view.max_error_px * (view.pixel_a + view.pixel_b * t);
    return u32(clamp(floor(log2(max(texels, 1.0))), 0.0, f32(field.levels)));
}

/// Where the ray next comes from the air to the surface, or enters the footprint below it, at or after
/// `t_start`, where it is in the air or at the footprint's border. Nothing at or beyond `t_stop` is looked
/// for. The ray must be within the footprint from `t_start` to `t_stop`.
///
/// Nodes first, until a cell is reached, then cells: invocations that run in step meet at the cells, which
/// cost the most.
fn cast_ray(ray: Ray, t_start: f32, t_stop: f32, levels: Levels) -> Hit {
    var hit = Hit(T_NEVER, 0u);
    var place = Place(cell_at(ray, t_start), levels.start, t_start);
    var highest = levels.highest;
    var going = true;
    loop {
        while going && place.k > 0u {
            let exit = exit_of(ray, place);
            let t_leave = min(exit.t.x, exit.t.y);
            let range = node_range(place.k, place.cell >> vec2(place.k), ray.anchor_y);
            hit.reads += 1u;
            let low = min(height_of(ray, place.t), height_of(ray, t_leave));
            if low > range.x + height_guard(ray, min(t_leave, t_stop)) {
                if levels.follow_pixel {
                    highest = pixel_level(t_leave);
                }
                going = move_on(ray, &place, exit, t_stop, highest);
                continue;
            }
            // Near enough to its surface to matter. May its middle height stand for it?
            let allowed = select(view.lod_a + view.lod_b * place.t, 0.0, levels.exact);
            if allowed <= 0.0 || range.x - range.y > 2.0 * allowed {
                place.k -= 1u;
                continue;
            }
            let middle = 0.5 * (range.x + range.y);
            if height_of(ray, place.t) <= middle {
                hit.t = place.t;
                return hit;
            }
            if height_of(ray, t_leave) <= middle {
                hit.t = clamp((middle - ray.origin.y) / ray.direction.y, place.t, t_leave);
                return hit;
            }
            going = move_on(ray, &place, exit, t_stop, highest);
        }
        if !going {
            return hit;
        }
        // It is; said so that what follows needs no shifts.
        place.k = 0u;
        let exit = exit_of(ray, place);
        let corners = cell_corners(place.cell, ray.anchor_y);
        hit.reads += 1u;
        let above = above_cell(ray, place.cell, corners);
        if !clears_cell(ray, above, corners) {
            var s = 0.0;
            if above.c > 0.0 {
                s = first_fall(above.c, above.b, above.a);
            }
            if s <= above.s_max {
                hit.t = above.t_in + s;
                return hit;
            }
        }
        if levels.follow_pixel {
            highest = pixel_level(min(exit.t.x, exit.t.y));
        }
        going = move_on(ray, &place, exit, t_stop, highest);
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
    let highest = select(field.levels, 0u, view.traversal == TRAVERSAL_PER_TEXEL);
    var place = Place(cell_at(ray, 0.0), highest, 0.0);
    var going = true;
    while going {
        let exit = exit_of(ray, place);
        let t_leave = min(exit.t.x, exit.t.y);
        out.reads += 1u;
        if place.k > 0u {
            let high = max(height_of(ray, place.t), height_of(ray, t_leave));
            let low = node_range(place.k, place.cell >> vec2(place.k), ray.anchor_y).y;
            if high >= low - height_guard(ray, min(t_leave, t_stop)) {
                place.k -= 1u;
                continue;
            }
        } else {
            let above = above_cell(ray, place.cell, cell_corners(place.cell, ray.anchor_y));
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
        going = move_on(ray, &place, exit, t_stop, highest);
    }
    return out;
}
