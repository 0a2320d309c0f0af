// Reading the shadow maps of a terrain: how much of a light a point of the ground sees.
#define_import_path bevy_skyline::visibility

#import bevy_skyline::height_field::field
#import bevy_skyline::shadow_tiles::{COARSEST, TILE, tile_byte}

/// Mirrors `GpuLightMap`.
struct LightMap {
    /// The direction to the light (w = 0) or its position (w = 1), as Bevy has it.
    place: vec4<f32>,
    /// The tiles the map is of, and where they begin.
    first_tile: vec2<u32>,
    tiles: vec2<u32>,
    first_word: u32,
    /// Of point and spot lights, which tells those at one place apart. units: m
    range: f32,
};

/// Mirrors `GpuLightMaps`.
struct LightMaps {
    count: u32,
    maps: array<LightMap, 16>,
};

@group(3) @binding(6) var<uniform> light_maps: LightMaps;
@group(3) @binding(7) var<storage, read> visibility: array<u32>;

/// A sample's byte, or that of an average over 2^level of them a side; all of the light beyond the map.
fn block_visibility(map: u32, level: u32, at: vec2<u32>) -> f32 {
    let side = TILE >> level;
    let tile = at / side - light_maps.maps[map].first_tile;
    if any(at / side < light_maps.maps[map].first_tile) || any(tile >= light_maps.maps[map].tiles) {
        return 1.0;
    }
    let byte = tile_byte(tile, light_maps.maps[map].tiles.x, level, at % side);
    let word = visibility[light_maps.maps[map].first_word + byte / 4u];
    return f32((word >> (8u * (byte % 4u))) & 0xffu) / 255.0;
}

/// The map of the light at a place, or `light_maps.count`.
fn map_of(place: vec4<f32>, range: f32) -> u32 {
    for (var i = 0u; i < light_maps.count; i++) {
        if all(light_maps.maps[i].place == place) && light_maps.maps[i].range == range {
            return i;
        }
    }
    return light_maps.count;
}

fn level_visibility(map: u32, level: u32, at: vec2<f32>) -> f32 {
    let size = f32(1u << level);
    let last = field.cells >> vec2(level);
    // A block's average stands for its middle.
    let place = clamp((at - 0.5 * (size - 1.0)) / size, vec2(0.0), vec2<f32>(last));
    let low = vec2<u32>(place);
    let high = min(low + 1u, vec2<u32>(last));
    let weight = place - vec2<f32>(low);
    return mix(
        mix(block_visibility(map, level, low), block_visibility(map, level, vec2(high.x, low.y)), weight.x),
        mix(block_visibility(map, level, vec2(low.x, high.y)), block_visibility(map, level, high), weight.x),
        weight.y,
    );
}

/// Share of a light that is seen from a point of the ground, blended between the samples around it; where a pixel is
/// `width` samples wide, their average.
fn visibility_at(map: u32, at: vec2<f32>, width: f32) -> f32 {
    let level = clamp(log2(max(width, 1.0)), 0.0, f32(COARSEST));
    let fine = u32(level);
    let visibility = level_visibility(map, fine, at);
    if level == f32(fine) {
        return visibility;
    }
    return mix(visibility, level_visibility(map, fine + 1u, at), level - f32(fine));
}
