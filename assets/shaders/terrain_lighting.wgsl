// The direct light that the terrain keeps from its own ground.
//
// Bevy's lighting loop knows nothing of our maps, so what it has added for a light of which only a share is seen
// is taken back: the same terms, diffuse and specular, times what isn't seen. Ambient and environment light stay.
// Lights are told by their direction or position, which Bevy's shader and our table have from the same component.
#define_import_path bevy_skyline::terrain_lighting

#import bevy_pbr::{
    clustered_forward as clustering,
    lighting,
    lighting::LAYER_BASE,
    mesh_view_bindings as view_bindings,
    mesh_view_types,
    pbr_functions,
    pbr_types,
    shadows,
}
#import bevy_skyline::visibility::{light_maps, map_of, visibility_at}

/// As `apply_pbr_lighting` sets it up for a material without coats, anisotropy or transmission.
fn lighting_input(in: pbr_types::PbrInput) -> lighting::LightingInput {
    let base = in.material.base_color.rgb;
    let roughness = in.material.perceptual_roughness;
    let NdotV = max(dot(in.N, in.V), 0.0001);
    var input: lighting::LightingInput;
    input.layers[LAYER_BASE].NdotV = NdotV;
    input.layers[LAYER_BASE].N = in.N;
    input.layers[LAYER_BASE].R = reflect(-in.V, in.N);
    input.layers[LAYER_BASE].perceptual_roughness = roughness;
    input.layers[LAYER_BASE].roughness = lighting::perceptualRoughnessToRoughness(roughness);
    input.P = in.world_position.xyz;
    input.V = in.V;
    input.diffuse_color = pbr_functions::calculate_diffuse_color(base, in.material.metallic, 0.0, 0.0);
    input.metallic = in.material.metallic;
    input.F0_dielectric = pbr_functions::calculate_F0_dielectric(in.material.reflectance);
    input.F0_metallic = base;
    input.F_ab = lighting::F_AB(roughness, NdotV);
    return input;
}

/// How much of a light Bevy's contact shadows leave.
fn contact(in: pbr_types::PbrInput, to_light: vec3<f32>, enabled: bool) -> f32 {
#ifdef CONTACT_SHADOWS
#ifdef DEPTH_PREPASS
    let steps = view_bindings::contact_shadows_settings.linear_steps;
    if enabled && steps > 0u {
        return pbr_functions::calculate_contact_shadow(in.world_position.xyz, in.frag_coord.xy, to_light, steps);
    }
#endif
#endif
    return 1.0;
}

/// `at` in cells, `width` the samples a pixel spans.
fn blocked_light(in: pbr_types::PbrInput, at: vec2<f32>, width: f32) -> vec3<f32> {
    var blocked = vec3(0.0);
    if light_maps.count == 0u {
        return blocked;
    }
    var input = lighting_input(in);
    let view_z = (view_bindings::view.view_from_world * in.world_position).z;
    for (var i = 0u; i < view_bindings::lights.n_directional_lights; i++) {
        let flags = view_bindings::lights.directional_lights[i].flags;
        let to_light = view_bindings::lights.directional_lights[i].direction_to_light;
        let map = map_of(vec4(to_light, 0.0), 0.0);
        if map == light_maps.count {
            continue;
        }
        let hidden = 1.0 - visibility_at(map, at, width);
        if hidden <= 0.0 {
            continue;
        }
        var light = hidden;
        if (flags & mesh_view_types::DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) != 0u {
            light *= shadows::fetch_directional_shadow(i, in.world_position, in.world_normal, view_z, in.frag_coord.xy);
        }
        if light > 0.0 {
            light *= contact(in, to_light, (flags & mesh_view_types::DIRECTIONAL_LIGHT_FLAGS_CONTACT_SHADOWS_ENABLED_BIT) != 0u);
            blocked += light * lighting::directional_light(i, &input, true);
        }
    }
    let cluster = clustering::view_fragment_cluster_index(in.frag_coord.xy, view_z, in.is_orthographic);
    let ranges = clustering::unpack_clusterable_object_index_ranges(cluster);
    for (var i = ranges.first_point_light_index_offset; i < ranges.first_reflection_probe_index_offset; i++) {
        let is_point = i < ranges.first_spot_light_index_offset;
        let id = clustering::get_clusterable_object_id(i);
        let place = view_bindings::clustered_lights.data[id].position_radius.xyz;
        let flags = view_bindings::clustered_lights.data[id].flags;
        let map = map_of(vec4(place, 1.0), view_bindings::clustered_lights.data[id].range);
        if map == light_maps.count {
            continue;
        }
        let hidden = 1.0 - visibility_at(map, at, width);
        if hidden <= 0.0 {
            continue;
        }
        var light = hidden;
        if (flags & mesh_view_types::POINT_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) != 0u {
            if is_point {
                light *= shadows::fetch_point_shadow(id, in.world_position, in.world_normal, in.frag_coord.xy);
            } else {
                let near_z = view_bindings::clustered_lights.data[id].shadow_map_near_z;
                light *= shadows::fetch_spot_shadow(id, in.world_position, in.world_normal, near_z, in.frag_coord.xy);
            }
        }
        if light > 0.0 {
            let to_light = normalize(place - in.world_position.xyz);
            light *= contact(in, to_light, (flags & mesh_view_types::POINT_LIGHT_FLAGS_CONTACT_SHADOWS_ENABLED_BIT) != 0u);
            if is_point {
                blocked += light * lighting::point_light(id, &input, true, true);
            } else {
                blocked += light * lighting::spot_light(id, &input, true);
            }
        }
    }
    return view_bindings::view.exposure * blocked;
}
