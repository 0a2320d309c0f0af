// Draws the terrain's casters into one of Bevy's shadow cascades.
//
// In:  `caster_depth` as `terrain_cascade_erode.wgsl` leaves it, over a square of its own in the light's plane.
// Out: depth of the cascade, reverse-Z, the nearer wins. What lies between the light and the cascade's near
//      plane is drawn on that plane, as Bevy does with meshes.
//
// Four stored values are blended. Where they lie too far apart to be one surface, they are two, the nearer and
// the farther ones, and whichever has more of the weight is blended alone: the line between them runs smoothly
// across the coarse texels, whatever the depth of who looks. No blend is nearer to the light than the nearest of
// the four, which is all that the derivation in `terrain_cascade_erode.wgsl` asks of it.

#import bevy_skyline::fullscreen::fullscreen_corner

struct Cascade {
    /// Texel of `caster_depth` = framebuffer position * scale + offset.
    offset: vec2<f32>,
    scale: f32,
    /// Depth of the cascade = stored depth * depth_scale + depth_offset.
    depth_scale: f32,
    depth_offset: f32,
    /// What differs by more is not one surface. units: stored depth
    edge: f32,
};

@group(0) @binding(0) var<uniform> cascade: Cascade;
@group(0) @binding(1) var caster_depth: texture_2d<f32>;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return fullscreen_corner(index);
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> @builtin(frag_depth) f32 {
    let at = position.xy * cascade.scale + cascade.offset - 0.5;
    let low = floor(at);
    let weight = at - low;
    let texel = vec2<i32>(low);
    let values = vec4(
        textureLoad(caster_depth, texel, 0).x,
        textureLoad(caster_depth, texel + vec2(1, 0), 0).x,
        textureLoad(caster_depth, texel + vec2(0, 1), 0).x,
        textureLoad(caster_depth, texel + vec2(1, 1), 0).x,
    );
    let across = vec2(1.0 - weight.x, weight.x);
    var weights = vec4(across * (1.0 - weight.y), across * weight.y);
    let nearest = max(max(values.x, values.y), max(values.z, values.w));
    let farthest = min(min(values.x, values.y), min(values.z, values.w));
    if nearest - farthest > cascade.edge {
        let near = select(vec4(0.0), weights, values >= vec4(0.5 * (nearest + farthest)));
        let share = dot(near, vec4(1.0));
        weights = select((weights - near) / (1.0 - share), near / share, share > 0.5);
    }
    let depth = dot(values, weights);
    return select(0.0, saturate(depth * cascade.depth_scale + cascade.depth_offset), depth > 0.0);
}
