// One ray per pixel, from the safe start its traversal knows to the surface or to the depth already drawn.
//
// In:  `tile_start` (t and level a tile of rays may start at), `box_entry` (t of the nearest box, negative
//      for none), `drawn_depth` (NDC depth of the meshes drawn so far).
// Out: `hit_depth`, R32Float, NDC depth, 0 = no terrain; `hit_surface`, R32Uint, low 8 bits the terrain's
//      index from 1, the rest the nodes and cells read.
// P1 section 3; for the maximum mipmap Tevs, Ihrke and Seidel 2008.

#import bevy_skyline::types::{
    FLAG_FIRST, FLAG_STARTS_IN_AIR, T_NEVER, TRAVERSAL_BOXES, TRAVERSAL_HYBRID, TRAVERSAL_MAX_MIP,
}
#import bevy_skyline::height_field::{cell_corners, field}
#import bevy_skyline::rays::{above_cell, cell_at, footprint_t}
#import bevy_skyline::boxes::BOX_COUNT
#import bevy_skyline::traverse::{Levels, cast_ray, emerge, pixel_level}
#import bevy_skyline::view_rays::{ndc_depth, ray_at, t_of_depth, view}

/// Side of the tiles that the finer beams stand for. units: px
const BEAM_PX: u32 = 4u;

struct TileStart {
    /// No ray of the tile meets the surface before this t; negative if none does at all.
    t: f32,
    /// Low 8 bits: level of the nodes that stopped the beam.
    level_reads: u32,
};

@group(1) @binding(0) var hit_depth: texture_storage_2d<r32float, read_write>;
@group(1) @binding(1) var hit_surface: texture_storage_2d<r32uint, read_write>;
@group(1) @binding(2) var<storage, read> tile_start: array<TileStart>;
@group(1) @binding(3) var box_entry: texture_2d<f32>;
@group(1) @binding(4) var<storage, read> box_counts: array<u32>;
#ifdef STOP_AT_DEPTH
@group(1) @binding(5) var drawn_depth: texture_depth_2d;
#endif

@compute @workgroup_size(8, 8, 1)
fn ray_cast(@builtin(local_invocation_index) local: u32, @builtin(workgroup_id) tile: vec3<u32>) {
    // Invocations that run in step (8 and more) take a compact block of pixels: their rays go the same way.
    let in_tile = vec2(((local >> 3u) & 1u) * 4u + (local & 3u), (local >> 4u) * 2u + ((local >> 2u) & 1u));
    let id = tile.xy * 8u + in_tile;
    if any(id.xy >= view.size_px) {
        return;
    }
    let first = (view.flags & FLAG_FIRST) != 0u;
    var depth = 0.0;
    var surface = 0u;
    if !first {
        depth = textureLoad(hit_depth, id.xy).x;
        surface = textureLoad(hit_surface, id.xy).x;
    }
    var nearest = depth;
#ifdef STOP_AT_DEPTH
    nearest = max(nearest, textureLoad(drawn_depth, id.xy + view.viewport_px, 0));
#endif
    let ray = ray_at(vec2<f32>(id.xy) + 0.5);
    let t_footprint = footprint_t(ray);
    let t_stop = min(min(view.t_far, t_footprint.y), t_of_depth(nearest));
    var t_start = max(t_footprint.x, 0.0);
    var levels = Levels(0u, 0u, false, false);
    var starts = true;
    if view.traversal == TRAVERSAL_HYBRID {
        let tiles_x = (view.size_px.x + BEAM_PX - 1u) / BEAM_PX;
        let start = tile_start[(id.y / BEAM_PX) * tiles_x + id.x / BEAM_PX];
        starts = starts && start.t >= 0.0;
        levels = Levels(max(start.level_reads & 0xffu, 2u) - 1u, field.levels, false, false);
        t_start = max(t_start, start.t);
    } else if view.traversal == TRAVERSAL_MAX_MIP {
        levels = Levels(field.levels, field.levels, false, false);
    } else if view.traversal == TRAVERSAL_BOXES && (view.flags & FLAG_STARTS_IN_AIR) != 0u && box_counts[BOX_COUNT] <= view.box_capacity {
        let entry = textureLoad(box_entry, id.xy, 0).x;
        starts = starts && entry >= 0.0;
        t_start = max(t_start, entry);
        if view.lod_a + view.lod_b * t_start > 0.0 {
            let level = pixel_level(t_start);
            levels = Levels(level, level, true, false);
        }
    }

    var hit_t = T_NEVER;
    var reads = surface >> 8u;
    surface &= 0xffu;
    if starts && t_start < t_stop {
        var inside = false;
        if (view.flags & FLAG_STARTS_IN_AIR) == 0u && t_footprint.x < 0.0 {
            let cell = cell_at(ray, 0.0);
            reads += 1u;
            inside = above_cell(ray, cell, cell_corners(cell, view.anchor_y)).c <= 0.0;
        }
        if inside {
            let air = emerge(ray, t_stop);
            reads += air.reads;
            hit_t = air.falls_t;
            t_start = air.t;
            levels.exact = true;
        }
        if hit_t == T_NEVER && t_start < t_stop {
            let hit = cast_ray(ray, t_start, t_stop, levels);
            hit_t = hit.t;
            reads += hit.reads;
        }
    }
    if hit_t < T_NEVER && hit_t <= t_stop {
        depth = ndc_depth(hit_t);
        surface = view.terrain_id;
    }
    textureStore(hit_depth, id.xy, vec4(depth, 0.0, 0.0, 0.0));
    textureStore(hit_surface, id.xy, vec4(surface | (min(reads, 0xffffffu) << 8u), 0u, 0u, 0u));
}
