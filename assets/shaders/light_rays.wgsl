// Rays from samples of the height field to a light.
//
// Each ray is anchored at its own sample: (0, 0, 0) is the sample, whole numbers of cells away from it are
// exact, heights are relative to its own. It moves at unit speed along the axis on which it is faster. The
// sample lies on the surface, so over the first cell the ray's height above it is b s + a s^2 with nothing left
// over: no bias is needed against acne, and none is there to detach a shadow.
//
// P5b; `reference/terrain_shadow` bounds what rounding may do here.
#define_import_path bevy_skyline::light_rays

#import bevy_skyline::types::T_NEVER
#import bevy_skyline::shadow_tiles::{TILE, tile_byte}
#import bevy_skyline::height_field::{cell_corners, field, node_range, sample_height}
#import bevy_skyline::rays::{
    Above, Place, Ray, above_cell, border_t, clears_cell, exit_of, height_guard, height_of, move_on, ray_along,
}

/// Mirrors `GpuShadowLight`.
struct Light {
    /// Way to a directional light, the larger of |x| and |z| being 1. units: grid
    direction: vec3<f32>,
    /// `LIGHT_*`
    kind: u32,
    /// A point light's position is high + low. units: grid
    position_high: vec3<f32>,
    /// Of a directional light the tangent of its angular radius, else its radius. units: m
    radius: f32,
    position_low: vec3<f32>,
    /// Strips the light's disc is cut into, where there are penumbrae.
    strips: u32,
    /// The linear part. units: m
    world_from_grid: mat3x3<f32>,
    grid_from_world: mat3x3<f32>,
    /// 1 / direction along x and z, 0 where it doesn't move.
    inverse: vec2<f32>,
    /// Highest sample, and the range from the lowest. units: grid
    y_max: f32,
    y_magnitude: f32,
    /// First tile of the map, and how many there are.
    first_tile: vec2<u32>,
    tiles: vec2<u32>,
    /// Tiles this dispatch is for.
    listed: u32,
};

const LIGHT_DIRECTIONAL: u32 = 0u;
const LIGHT_POINT: u32 = 1u;

@group(1) @binding(0) var<uniform> light: Light;

struct LightRay {
    ray: Ray,
    /// When it reaches the light.
    t_end: f32,
    /// It goes straight up or down, and there is nothing to walk.
    upright: bool,
};

/// Way from a sample to the light. units: grid
fn way_to_light(at: vec2<i32>, height: f32) -> vec3<f32> {
    if light.kind == LIGHT_DIRECTIONAL {
        return light.direction;
    }
    return (light.position_high - vec3(f32(at.x), height, f32(at.y))) + light.position_low;
}

/// A ray along `way`, which ends at the light where that is a point.
fn ray_toward(at: vec2<i32>, height: f32, way: vec3<f32>) -> LightRay {
    let speed = max(abs(way.x), abs(way.z));
    var out: LightRay;
    out.upright = speed <= 1e-15 * abs(way.y);
    let safe = select(speed, 1.0, out.upright);
    out.ray = ray_along(vec3(0.0), way / safe);
    out.ray.inverse = safe / select(vec2(1.0), way.xz, out.ray.moves);
    out.ray.anchor = at;
    out.ray.anchor_y = height;
    out.ray.y_max = light.y_max - height;
    out.ray.y_magnitude = light.y_magnitude;
    out.t_end = select(T_NEVER, speed, light.kind == LIGHT_POINT);
    return out;
}

/// The ray to the middle of the light.
fn ray_to_light(at: vec2<i32>, height: f32) -> LightRay {
    if light.kind == LIGHT_POINT {
        return ray_toward(at, height, way_to_light(at, height));
    }
    // As it was composed in double precision.
    var out: LightRay;
    out.t_end = T_NEVER;
    out.upright = all(light.direction.xz == vec2(0.0));
    out.ray.direction = light.direction;
    out.ray.inverse = light.inverse;
    out.ray.moves = light.inverse != vec2(0.0);
    out.ray.ahead = select(vec2(0), vec2(1), light.direction.xz >= vec2(0.0));
    out.ray.anchor = at;
    out.ray.anchor_y = height;
    out.ray.y_max = light.y_max - height;
    out.ray.y_magnitude = light.y_magnitude;
    return out;
}

/// Where a ray begins: in the cell it first enters from its sample. `going` is false if it leaves the footprint at
/// once.
fn first_place(ray: Ray, going: ptr<function, bool>) -> Place {
    var cell = ray.anchor - 1 + ray.ahead;
    cell = select(min(cell, field.cells - 1), cell, ray.moves);
    *going = all(cell >= vec2(0)) && all(cell < field.cells);
    return Place(cell, 0u, 0.0);
}

/// The ray's height above its first cell, cut off at the light. It begins at a corner, with nothing.
fn above_first(ray: Ray, corners: vec4<f32>, t_end: f32) -> Above {
    let d = ray.direction;
    // Where it doesn't move it may be in either of two cells, of which `first_place` takes one.
    let at = select(vec2(1.0), vec2(0.0), ray.ahead == vec2(1) & (ray.moves | ray.anchor < field.cells));
    let p = corners.y - corners.x;
    let q = corners.z - corners.x;
    let r = (corners.w - corners.z) - p;
    let left = border_t(ray, ray.anchor - 1 + 2 * ray.ahead);
    var above: Above;
    above.s_max = min(min(left.x, left.y), t_end);
    above.b = d.y - p * d.x - q * d.z - r * (at.x * d.z + at.y * d.x);
    above.a = -r * d.x * d.z;
    return above;
}

/// The ray's height above another cell, cut off at the light.
fn above_until(ray: Ray, cell: vec2<i32>, corners: vec4<f32>, t_end: f32) -> Above {
    var above = above_cell(ray, cell, corners);
    above.s_max = min(above.s_max, max(t_end - above.t_in, 0.0));
    return above;
}

/// Whether c + b s + a s^2 goes below zero for 0 <= s <= s_max. Touching is not below.
fn dips(above: Above) -> bool {
    let end = above.c + above.s_max * (above.b + above.s_max * above.a);
    let turns = above.a > 0.0 && above.b < 0.0 && -above.b < 2.0 * above.a * above.s_max;
    return above.c < 0.0 || end < 0.0 || (turns && above.b * above.b > 4.0 * above.a * above.c);
}

/// What a walk over nodes comes to.
const WAY_FREE: u32 = 0u;
const WAY_TO_CELL: u32 = 1u;
const WAY_BLOCKED: u32 = 2u;

/// Walks on over nodes that the ray stays clear of, down to the next cell that it may not be clear of. A ray that
/// enters a node below its lowest sample is blocked.
fn walk(ray: Ray, place: ptr<function, Place>, t_end: f32, highest: u32) -> u32 {
    var going = move_on(ray, place, exit_of(ray, *place), t_end, highest);
    // A ray that rises leaves cells behind soon: asking a node of 4 x 4 first costs less than a cell.
    (*place).k = max((*place).k, min(highest, 2u));
    while going && (*place).k > 0u {
        let exit = exit_of(ray, *place);
        let t_leave = min(exit.t.x, exit.t.y);
        let range = node_range((*place).k, (*place).cell >> vec2((*place).k), ray.anchor_y);
        let entry = height_of(ray, (*place).t);
        let guard = height_guard(ray, min(t_leave, t_end));
        if entry < range.y - guard {
            return WAY_BLOCKED;
        }
        if min(entry, height_of(ray, t_leave)) > range.x + guard {
            going = move_on(ray, place, exit, t_end, highest);
        } else {
            (*place).k -= 1u;
        }
    }
    return select(WAY_FREE, WAY_TO_CELL, going);
}

/// Whether nothing of the ray lies below the surface. `highest` level 0 tests every cell on the way.
fn is_lit(to_light: LightRay, highest: u32) -> bool {
    let ray = to_light.ray;
    if to_light.upright {
        return ray.direction.y >= 0.0;
    }
    var going = false;
    var place = first_place(ray, &going);
    if !going {
        return true;
    }
    if dips(above_first(ray, cell_corners(place.cell, ray.anchor_y), to_light.t_end)) {
        return false;
    }
    loop {
        let way = walk(ray, &place, to_light.t_end, highest);
        if way != WAY_TO_CELL {
            return way == WAY_FREE;
        }
        let corners = cell_corners(place.cell, ray.anchor_y);
        let above = above_until(ray, place.cell, corners, to_light.t_end);
        if !clears_cell(ray, above, corners) && dips(above) {
            return false;
        }
    }
    return true;
}

/// Area of a unit disc's strip a <= alpha <= b above beta = `level` >= 0.
fn cap_area(level: f32, a: f32, b: f32) -> f32 {
    let half = sqrt(max(1.0 - level * level, 0.0));
    let ends = clamp(vec2(a, b), vec2(-half), vec2(half));
    let primitive = 0.5 * (ends * sqrt(max(1.0 - ends * ends, vec2(0.0))) + asin(clamp(ends, vec2(-1.0), vec2(1.0)))) - level * ends;
    return primitive.y - primitive.x;
}

#ifndef PENUMBRA
/// All or nothing of the light, by its middle.
fn visible_share(at: vec2<i32>, height: f32, highest: u32) -> f32 {
    return select(0.0, 1.0, is_lit(ray_to_light(at, height), highest));
}
#else
/// The largest slope at which the sample sees the surface of a cell, along the ray's azimuth.
fn slope_in_cell(ray: Ray, above: Above) -> f32 {
    // The surface along the ray: h0 + h1 s + h2 s^2, seen at (h0 + h1 s + h2 s^2) / (t_in + s).
    let h0 = above.t_in * ray.direction.y - above.c;
    let h1 = ray.direction.y - above.b;
    let h2 = -above.a;
    if above.t_in == 0.0 {
        return max(h1, h1 + h2 * above.s_max);
    }
    let t_out = above.t_in + above.s_max;
    var slope = max(h0 / above.t_in, (h0 + above.s_max * (h1 + above.s_max * h2)) / t_out);
    // As a function of t it is p / t + q + h2 t, with a maximum inside only if both ends are negative.
    let p = h0 - above.t_in * (h1 - above.t_in * h2);
    if p < 0.0 && h2 < -1e-30 {
        let s = clamp(sqrt(p / h2) - above.t_in, 0.0, above.s_max);
        slope = max(slope, (h0 + s * (h1 + s * h2)) / (above.t_in + s));
    }
    return slope;
}

/// The horizon's slope along a ray's azimuth, as far as it matters: no less than `lowest`, and if it is above
/// `most` something above that.
fn horizon(to_light: LightRay, lowest: f32, most: f32, highest: u32) -> f32 {
    var ray = to_light.ray;
    ray.direction.y = lowest;
    var going = false;
    var place = first_place(ray, &going);
    if !going {
        return lowest;
    }
    var above = above_first(ray, cell_corners(place.cell, ray.anchor_y), to_light.t_end);
    var near = true;
    loop {
        if near && dips(above) {
            ray.direction.y = max(ray.direction.y, slope_in_cell(ray, above));
            if ray.direction.y >= most {
                break;
            }
        }
        let way = walk(ray, &place, to_light.t_end, highest);
        if way == WAY_FREE {
            break;
        }
        // However high it rises, the surface has to be found cell by cell.
        place.k = 0u;
        let corners = cell_corners(place.cell, ray.anchor_y);
        above = above_until(ray, place.cell, corners, to_light.t_end);
        near = !clears_cell(ray, above, corners);
    }
    return ray.direction.y;
}

/// The share of the light's disc that a sample sees. Each strip of it is cut off by the horizon along its own
/// middle.
fn visible_share(at: vec2<i32>, height: f32, highest: u32) -> f32 {
    let middle = ray_to_light(at, height);
    if middle.upright {
        return select(0.0, 1.0, is_lit(middle, highest));
    }
    let centre = way_to_light(at, height);
    let world = light.world_from_grid * centre;
    let distance = length(world);
    let radius = select(light.radius, distance * light.radius, light.kind == LIGHT_DIRECTIONAL);
    let to_light = world / distance;
    let sideways = cross(to_light, light.world_from_grid[1]);
    if dot(sideways, sideways) < 1e-12 * dot(light.world_from_grid[1], light.world_from_grid[1]) {
        return select(0.0, 1.0, is_lit(middle, highest));
    }
    let right = light.grid_from_world * (radius * normalize(sideways));
    let up = light.grid_from_world * (radius * cross(normalize(sideways), to_light));
    var seen = 0.0;
    for (var i = 0u; i < light.strips; i++) {
        let a = -1.0 + 2.0 * f32(i) / f32(light.strips);
        let b = -1.0 + 2.0 * f32(i + 1u) / f32(light.strips);
        let alpha = 0.5 * (a + b);
        let way = centre + alpha * right;
        var along_way: LightRay = ray_toward(at, height, way);
        if light.strips == 1u {
            along_way = middle;
        }
        let along_x = abs(way.x) >= abs(way.z);
        let forward = select(way.z, way.x, along_x);
        let m = abs(forward);
        let up_m = select(up.z, up.x, along_x) * sign(forward);
        let area = 2.0 * cap_area(0.0, a, b);
        if along_way.upright || m - abs(up_m) <= 1e-6 * m {
            // The zenith lies within the disc: it has no horizon to speak of.
            seen += select(0.0, area, is_lit(middle, highest));
            continue;
        }
        // The slope at which beta is seen: (way.y + beta up.y) / (m + beta up_m).
        let lowest = (way.y - up.y) / (m - up_m);
        let most = (way.y + up.y) / (m + up_m);
        if most - lowest <= 1e-6 * (abs(most) + abs(lowest)) {
            // Too small a disc to be told from a point.
            seen += select(0.0, area, is_lit(middle, highest));
            continue;
        }
        let slope = horizon(along_way, lowest, most, highest);
        if slope <= lowest {
            seen += area;
        } else if slope < most {
            let level = clamp((slope * m - way.y) / (up.y - slope * up_m), -1.0, 1.0);
            let part = cap_area(abs(level), a, b);
            seen += select(area - part, part, level >= 0.0);
        }
    }
    return clamp(seen / 3.14159265, 0.0, 1.0);
}
#endif

/// Workgroups along one dimension of a dispatch, at most.
const MOST_GROUPS: u32 = 65535u;

/// Which of the listed tiles a workgroup is for; they are dealt out over y and z.
fn listed_tile(group: vec3<u32>) -> u32 {
    return group.y + group.z * MOST_GROUPS;
}

/// The byte of a sample in the map.
fn map_byte(at: vec2<u32>) -> u32 {
    return tile_byte(at / TILE - light.first_tile, light.tiles.x, 0u, at % TILE);
}
