// The surface a pixel's ray has hit, from its depth: where, and which way it faces.
#define_import_path bevy_skyline::surface

#import bevy_skyline::height_field::{field, sample_height}
#import bevy_skyline::view_rays::{ray_at, t_of_depth, view}

struct Surface {
    /// units: grid, relative to the anchor
    position: vec3<f32>,
    /// Slope of the surface, dy/dx and dy/dz. units: grid
    slope: vec2<f32>,
    /// Samples that a pixel spans here.
    width: f32,
    /// On a wall: its outward direction along x or z, else zero.
    wall: vec2<f32>,
};

/// Slope at a sample by central differences over `stride` cells either way, one-sided at the border.
fn slope_at(at: vec2<i32>, stride: i32) -> vec2<f32> {
    let low = clamp(at - stride, vec2(0), field.cells);
    let high = clamp(at + stride, vec2(0), field.cells);
    return vec2(
        sample_height(vec2(high.x, at.y), view.anchor_y) - sample_height(vec2(low.x, at.y), view.anchor_y),
        sample_height(vec2(at.x, high.y), view.anchor_y) - sample_height(vec2(at.x, low.y), view.anchor_y),
    ) / vec2<f32>(max(high - low, vec2(1)));
}

/// `viewport_pixel` is the pixel's middle. The slope is blended between samples as far apart as the pixel
/// is wide, so that it is continuous over cells near by and does not shimmer far away.
fn surface_at(viewport_pixel: vec2<f32>, depth: f32) -> Surface {
    let ray = ray_at(viewport_pixel);
    let t = t_of_depth(depth);
    var surface: Surface;
    surface.position = ray.origin + t * ray.direction;
    let cells = vec2<f32>(field.cells);
    let at = clamp(surface.position.xz + vec2<f32>(view.anchor), vec2(0.0), cells);

    let width = view.pixel_a + view.pixel_b * t;
    let k = u32(clamp(round(log2(max(width, 1.0))), 0.0, f32(field.levels)));
    let stride = i32(1u << k);
    surface.width = width;
    let low = (vec2<i32>(at) >> vec2(k)) << vec2(k);
    let high = min(low + stride, field.cells);
    let weight = clamp((at - vec2<f32>(low)) / max(vec2<f32>(high - low), vec2(1.0)), vec2(0.0), vec2(1.0));
    surface.slope = mix(
        mix(slope_at(low, stride), slope_at(vec2(high.x, low.y), stride), weight.x),
        mix(slope_at(vec2(low.x, high.y), stride), slope_at(high, stride), weight.x),
        weight.y,
    );

    // On the footprint's border, below the surface there, and seen from outside: a wall.
    let rim = 4e-6 * (cells + abs(surface.position.xz)) + 1e-4;
    let on_low = at <= rim & (ray.direction.xz > vec2(0.0));
    let on_high = at >= cells - rim & (ray.direction.xz < vec2(0.0));
    if any(on_low | on_high) {
        let cell = clamp(vec2<i32>(at), vec2(0), field.cells - 1);
        let f = at - vec2<f32>(cell);
        let top = mix(
            mix(sample_height(cell, view.anchor_y), sample_height(cell + vec2(1, 0), view.anchor_y), f.x),
            mix(sample_height(cell + vec2(0, 1), view.anchor_y), sample_height(cell + vec2(1, 1), view.anchor_y), f.x),
            f.y,
        );
        let drop = top - surface.position.y;
        if drop > 1e-3 * (abs(surface.slope.x) + abs(surface.slope.y)) + 1e-5 * abs(top) {
            let toward = select(vec2(0.0), vec2(1.0), on_high) - select(vec2(0.0), vec2(1.0), on_low);
            surface.wall = select(vec2(0.0, toward.y), vec2(toward.x, 0.0), toward.x != 0.0);
        }
    }
    return surface;
}

/// The way a surface faces, not of unit length. units: grid
fn facing(surface: Surface) -> vec3<f32> {
    let up = vec3(-surface.slope.x, 1.0, -surface.slope.y);
    return select(up, vec3(surface.wall.x, 0.0, surface.wall.y), any(surface.wall != vec2(0.0)));
}
