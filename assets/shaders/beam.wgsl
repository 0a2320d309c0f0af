// One beam for each tile of rays: walks the pyramid until the surface might touch any of the tile's rays, and
// says how far all of them may go blindly. Twice: from the boxes' entry for tiles of 16 x 16 pixels, then from
// where those ended for tiles of 4 x 4 (`FINE`).
//
// At t the rays of a tile lie within `ray of the tile's middle +- beam(t)`, a box that grows linearly. A step
// takes the 2 x 2 nodes around that box; while the lowest ray stays above the highest of them the beam
// moves on to where the box first leaves them. It stops, always on the near side, where the nodes have become
// as small as the beam is wide.
//
// In:  `box_entry`, one texel a coarse tile; `coarse_start`, for the fine ones. Out: `tile_start`, t and level;
//      t < 0 where no ray of the tile can hit.

#import bevy_skyline::boxes::BOX_COUNT
#import bevy_skyline::height_field::{field, level_size, node_range}
#import bevy_skyline::rays::{height_guard, height_of}
#import bevy_skyline::types::{FLAG_STARTS_IN_AIR, T_NEVER, UNIT_ROUNDOFF}
#import bevy_skyline::view_rays::{ray_at, view}

struct TileStart {
    t: f32,
    /// Level in the low 8 bits, nodes read by this beam above.
    level_reads: u32,
};

@group(1) @binding(0) var<storage, read_write> tile_start: array<TileStart>;
@group(1) @binding(1) var box_entry: texture_2d<f32>;
@group(1) @binding(2) var<storage, read> box_counts: array<u32>;
@group(1) @binding(3) var<storage, read> coarse_start: array<TileStart>;

/// Side of a tile. units: px
#ifdef FINE
const TILE_PX: u32 = 4u;
#else
const TILE_PX: u32 = 16u;
#endif
const COARSE_PX: u32 = 16u;

const MAX_STEPS: u32 = 256u;

fn half_width(t: f32) -> vec3<f32> {
    return f32(TILE_PX) * (view.beam_a + view.beam_b * t) + view.beam_slack;
}

/// The smallest level at which 2 x 2 nodes can hold a box of this half width.
fn level_for(half: vec3<f32>) -> u32 {
    let across = 2.0 * max(half.x, half.z);
    return u32(clamp(floor(log2(max(across, 0.5))) + 1.0, 1.0, f32(field.levels)));
}

@compute @workgroup_size(8, 8, 1)
fn beam(@builtin(global_invocation_id) id: vec3<u32>) {
    let tiles = (view.size_px + TILE_PX - 1u) / TILE_PX;
    if any(id.xy >= tiles) {
        return;
    }
    let index = id.y * tiles.x + id.x;
    if (view.flags & FLAG_STARTS_IN_AIR) == 0u {
        tile_start[index] = TileStart(0.0, field.levels);
        return;
    }
    var t = 0.0;
    var k = field.levels;
#ifdef FINE
    let coarse_tiles = (view.size_px + COARSE_PX - 1u) / COARSE_PX;
    let coarse = id.xy * TILE_PX / COARSE_PX;
    let start = coarse_start[coarse.y * coarse_tiles.x + coarse.x];
    t = start.t;
    k = start.level_reads & 0xffu;
#else
    if box_counts[BOX_COUNT] <= view.box_capacity {
        t = textureLoad(box_entry, id.xy, 0).x;
    }
    k = level_for(half_width(max(t, 0.0))) + 2u;
#endif
    if t < 0.0 {
        tile_start[index] = TileStart(-1.0, 0u);
        return;
    }
    k = min(k, field.levels);
    let ray = ray_at(f32(TILE_PX) * (vec2<f32>(id.xy) + 0.5));
    let spread = f32(TILE_PX) * view.beam_b;
    var reads = 0u;
    for (var step = 0u; step < MAX_STEPS; step++) {
        let half = half_width(t);
        let smallest = level_for(half);
        k = max(k, smallest);
        let from_anchor = ray.origin.xz + t * ray.direction.xz;
        let middle = from_anchor + vec2<f32>(view.anchor);
        let unit = f32(1u << k);
        // A border the box has just come to counts as crossed, or the beam would never leave it.
        let rim = half.xz + 1e-4 + 4.0 * UNIT_ROUNDOFF * (abs(middle) + abs(from_anchor));
        let a = vec2<i32>(floor((middle - rim) / unit));
        let b = vec2<i32>(floor((middle + rim) / unit));
        if any(b > a + 1) {
            if k >= field.levels { break; }
            k += 1u;
            continue;
        }
        // When does the growing box leave the nodes a..b ?
        let front = ray.direction.xz + spread.xz;
        let back = ray.direction.xz - spread.xz;
        let to_high = vec2<f32>(b + 1) * unit - (middle + half.xz);
        let to_low = vec2<f32>(a) * unit - (middle - half.xz);
        let high_t = select(vec2(T_NEVER), max(to_high, vec2(0.0)) / max(front, vec2(1e-12)), front > vec2(1e-12));
        let low_t = select(vec2(T_NEVER), min(to_low, vec2(0.0)) / min(back, vec2(-1e-12)), back < vec2(-1e-12));
        let t_leave = min(t + min(min(high_t.x, high_t.y), min(low_t.x, low_t.y)), T_NEVER);
        // Highest of the nodes; those beside the footprint hold nothing.
        let size = level_size(k);
        let outside = any(b < vec2(0)) || any(a >= size);
        var highest = -T_NEVER;
        if !outside {
            let low = clamp(a, vec2(0), size - 1);
            let high = clamp(b, vec2(0), size - 1);
            reads += 4u;
            highest = max(
                max(node_range(k, low, view.anchor_y).x, node_range(k, vec2(high.x, low.y), view.anchor_y).x),
                max(node_range(k, vec2(low.x, high.y), view.anchor_y).x, node_range(k, high, view.anchor_y).x),
            );
        }
        let t_end = min(t_leave, view.t_far);
        let lowest = min(
            height_of(ray, t) - half.y,
            height_of(ray, t_end) - half_width(t_end).y,
        );
        if outside || lowest > highest + height_guard(ray, t_end) {
            if t_leave >= view.t_far {
                t = -1.0;
                break;
            }
            // Over the whole terrain and not coming down, or past it for good.
            let rising = ray.direction.y >= spread.y;
            if rising && height_of(ray, t_leave) - half_width(t_leave).y > view.y_max + height_guard(ray, t_leave) {
                t = -1.0;
                break;
            }
            let gone = select(
                middle - half.xz > vec2<f32>(field.cells) & (back >= vec2(0.0)),
                middle + half.xz < vec2(0.0) & (front <= vec2(0.0)),
                ray.direction.xz < vec2(0.0),
            );
            if outside && any(gone) {
                t = -1.0;
                break;
            }
            t = t_leave;
            k = min(k + 1u, field.levels);
        } else {
            if k <= smallest { break; }
            k -= 1u;
        }
    }
    // What rounding may have added to t on the way.
    tile_start[index] = TileStart(select(t - 4e-6 * t, t, t < 0.0), max(k, 1u) | (reads << 8u));
}
