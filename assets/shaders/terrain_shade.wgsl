// Lights the terrain with Bevy's own PBR: every light, shadow, fog and tonemapping a StandardMaterial gets.
//
// Drawn over the viewport at the depth `terrain_depth` wrote and compared `Equal` with what is there, so its
// order against opaque meshes doesn't matter.

#import bevy_pbr::{
    mesh_types::MESH_FLAGS_SHADOW_RECEIVER_BIT,
    pbr_functions::{apply_pbr_lighting, calculate_view, main_pass_post_lighting_processing},
    pbr_types::{STANDARD_MATERIAL_FLAGS_FOG_ENABLED_BIT, pbr_input_new},
}
#ifdef SCREEN_SPACE_AMBIENT_OCCLUSION
#import bevy_pbr::mesh_view_bindings::screen_space_ambient_occlusion_texture
#import bevy_pbr::ssao_utils::ssao_multibounce
#endif
#import bevy_skyline::height_field::field
#ifdef TERRAIN_SHADOW
#import bevy_skyline::terrain_lighting::blocked_light
#endif
#import bevy_skyline::fullscreen::fullscreen_corner
#import bevy_skyline::surface::{facing, surface_at}
#import bevy_skyline::placement::Placement
#import bevy_skyline::view_rays::view

/// Mirrors `GpuTerrainLook`.
struct Look {
    /// Linear colours from the lowest band to the highest.
    colours: array<vec4<f32>, 4>,
    /// Where each band ends, and over what height it blends into the next. units: grid, not anchored
    edges: vec4<f32>,
    perceptual_roughness: f32,
    metallic: f32,
    reflectance: f32,
    /// 1: the albedo texture times the first colour, else colours by height.
    textured: u32,
};

@group(3) @binding(0) var hit_depth: texture_2d<f32>;
@group(3) @binding(1) var hit_surface: texture_2d<u32>;
@group(3) @binding(2) var<uniform> placement: Placement;
@group(3) @binding(3) var<uniform> look: Look;
@group(3) @binding(4) var albedo: texture_2d<f32>;
@group(3) @binding(5) var albedo_sampler: sampler;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return fullscreen_corner(index);
}

struct Out {
    @location(0) colour: vec4<f32>,
    @builtin(frag_depth) depth: f32,
};

/// Colour by height, blended over `edges.w` about each edge.
fn band_colour(height: f32) -> vec4<f32> {
    var colour = look.colours[0];
    let blend = max(look.edges.w, 1e-6);
    for (var i = 0; i < 3; i++) {
        colour = mix(colour, look.colours[i + 1], smoothstep(-0.5, 0.5, (height - look.edges[i]) / blend));
    }
    return colour;
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> Out {
    let pixel = vec2<i32>(floor(position.xy - placement.viewport_px));
    let depth = textureLoad(hit_depth, pixel, 0).x;
    if (textureLoad(hit_surface, pixel, 0).x & 0xffu) != view.terrain_id {
        discard;
    }
    let surface = surface_at(vec2<f32>(pixel) + 0.5, depth);
    let normal = normalize(placement.normal_from_grid * facing(surface));
    let world = placement.world_from_grid * vec4(surface.position, 1.0);

    var input = pbr_input_new();
    input.frag_coord = vec4(position.xy, depth, 1.0);
    input.world_position = world;
    input.world_normal = normal;
    input.N = normal;
    input.is_orthographic = view.depth.w == 0.0;
    input.V = calculate_view(world, input.is_orthographic);
    input.flags = MESH_FLAGS_SHADOW_RECEIVER_BIT;
    input.material.flags |= STANDARD_MATERIAL_FLAGS_FOG_ENABLED_BIT;
    input.material.perceptual_roughness = look.perceptual_roughness;
    input.material.metallic = look.metallic;
    input.material.reflectance = vec3(look.reflectance);
    if look.textured == 1u {
        let uv = (surface.position.xz + vec2<f32>(view.anchor)) / vec2<f32>(field.cells);
        let width = view.pixel_a + view.pixel_b * max((depth * view.depth.z - view.depth.x) / (view.depth.y - depth * view.depth.w), 0.0);
        let texels = width * vec2<f32>(textureDimensions(albedo)) / vec2<f32>(field.cells);
        input.material.base_color = look.colours[0]
            * textureSampleLevel(albedo, albedo_sampler, uv, log2(max(max(texels.x, texels.y), 1.0)));
    } else {
        input.material.base_color = band_colour(surface.position.y + view.anchor_y);
    }
#ifdef SCREEN_SPACE_AMBIENT_OCCLUSION
    let ssao = textureLoad(screen_space_ambient_occlusion_texture, vec2<i32>(position.xy), 0i).r;
    input.diffuse_occlusion = min(input.diffuse_occlusion, ssao_multibounce(ssao, input.material.base_color.rgb));
#endif
    var out: Out;
    out.depth = depth;
    var colour = apply_pbr_lighting(input);
#ifdef TERRAIN_SHADOW
    let at = clamp(surface.position.xz + vec2<f32>(view.anchor), vec2(0.0), vec2<f32>(field.cells));
    colour = vec4(max(colour.rgb - blocked_light(input, at, surface.width), vec3(0.0)), colour.a);
#endif
    out.colour = main_pass_post_lighting_processing(input, colour);
    return out;
}
