// Puts the terrain's depth among the meshes', and its normals and motion where the camera keeps them.
//
// In:  `hit_depth`, `hit_surface`. Out: depth (nearer wins), normal (Bevy's prepass encoding), motion (NDC
// units as Bevy's mesh prepass writes them). One sample stands for all of a multisampled pixel.

#import bevy_skyline::fullscreen::fullscreen_corner
#import bevy_skyline::placement::Placement
#import bevy_skyline::surface::{facing, surface_at}
#import bevy_skyline::view_rays::view

@group(1) @binding(0) var hit_depth: texture_2d<f32>;
@group(1) @binding(1) var hit_surface: texture_2d<u32>;
@group(1) @binding(2) var<uniform> placement: Placement;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return fullscreen_corner(index);
}

struct Out {
    @builtin(frag_depth) depth: f32,
#ifdef NORMAL_PREPASS
    @location(0) normal: vec4<f32>,
#endif
#ifdef MOTION_VECTOR_PREPASS
    @location(1) motion: vec2<f32>,
#endif
};

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> Out {
    let pixel = vec2<i32>(floor(position.xy - placement.viewport_px));
    let depth = textureLoad(hit_depth, pixel, 0).x;
    if (textureLoad(hit_surface, pixel, 0).x & 0xffu) != view.terrain_id {
        discard;
    }
    var out: Out;
    out.depth = depth;
#ifdef NORMAL_PREPASS
    let normal = placement.normal_from_grid * facing(surface_at(vec2<f32>(pixel) + 0.5, depth));
    out.normal = vec4(normalize(normal) * 0.5 + vec3(0.5), 1.0);
#endif
#ifdef MOTION_VECTOR_PREPASS
    let at = vec4(surface_at(vec2<f32>(pixel) + 0.5, depth).position, 1.0);
    let now = placement.clip_from_grid * at;
    let before = placement.previous_clip_from_grid * at;
    out.motion = (now.xy / max(now.w, 1e-12) - before.xy / max(before.w, 1e-12)) * vec2(0.5, -0.5);
#endif
    return out;
}
