// The rays of one camera through one terrain, and the depth it sees along them.
#define_import_path bevy_skyline::view_rays

#import bevy_skyline::rays::{Ray, ray_along}
#import bevy_skyline::types::{T_NEVER, TerrainView}

@group(#{FIELD_GROUP}) @binding(4) var<uniform> view: TerrainView;

/// The ray through a point of the viewport, in pixels from its top left corner.
fn ray_at(pixel: vec2<f32>) -> Ray {
    let q = pixel - 0.5 * vec2<f32>(view.size_px);
    var ray = ray_along(
        view.origin + q.x * view.origin_dx + q.y * view.origin_dy,
        view.direction + q.x * view.direction_dx + q.y * view.direction_dy,
    );
    ray.anchor = view.anchor;
    ray.anchor_y = view.anchor_y;
    ray.y_max = view.y_max;
    ray.y_magnitude = view.y_magnitude;
    return ray;
}

/// NDC depth at t. 0 is infinitely far.
fn ndc_depth(t: f32) -> f32 {
    return (view.depth.x + view.depth.y * t) / (view.depth.z + view.depth.w * t);
}

/// t of an NDC depth, the inverse of `ndc_depth`; `T_NEVER` for what lies infinitely far.
fn t_of_depth(depth: f32) -> f32 {
    let below = view.depth.y - depth * view.depth.w;
    let above = depth * view.depth.z - view.depth.x;
    if abs(below) * T_NEVER <= abs(above) || depth <= 0.0 {
        return T_NEVER;
    }
    return above / below;
}
