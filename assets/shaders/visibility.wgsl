// Reading the shadow maps of a terrain: how much of a light a point of the ground sees.
#define_import_path bevy_skyline::visibility

#import bevy_skyline::height_field::field

/// Mirrors `GpuLightMap`.
struct LightMap {
    /// The direction to the light (w = 0) or its position (w = 1), as Bevy has it.
    place: vec4<f32>,
    /// The tiles the map is of, and where they begin.
    first_tile: vec2<u32>,
    tiles: vec2<u32>,
    first_word: u32,
};

/// Mirrors `GpuLightMaps`.
struct LightMaps {
    count: u32,
    maps: array<LightMap, 16>,
};

/// Side of a tile. units: samples
const TILE: u32 = 64u;

@group(3) @binding(6) var<uniform> light_maps: LightMaps;
@group(3) @binding(7) var<storage, read> visibility: array<u32>;

/// A sample's byte; all of the light beyond the map.
fn sample_visibility(map: u32, at: vec2<u32>) -> f32 {
    let tile = at / TILE - light_maps.maps[map].first_tile;
    if any(at / TILE < light_maps.maps[map].first_tile) || any(tile >= light_maps.maps[map].tiles) {
        return 1.0;
    }
    let inside = at % TILE;
    let byte = (tile.y * light_maps.maps[map].tiles.x + tile.x) * TILE * TILE + inside.y * TILE + inside.x;
    let word = visibility[light_maps.maps[map].first_word + byte / 4u];
    return f32((word >> (8u * (byte % 4u))) & 0xffu) / 255.0;
}

/// The map of the light at a place, or `light_maps.count`.
fn map_of(place: vec4<f32>) -> u32 {
    for (var i = 0u; i < light_maps.count; i++) {
        if all(light_maps.maps[i].place == place) {
            return i;
        }
    }
    return light_maps.count;
}

/// Share of a light that is seen from a point of the ground, blended between the samples around it. Where a pixel
/// spans several samples, those as far apart as it is wide are taken, as for the slope.
fn visibility_at(map: u32, at: vec2<f32>, stride: u32) -> f32 {
    let low = (vec2<u32>(at) / stride) * stride;
    let high = min(low + stride, vec2<u32>(field.cells));
    let weight = clamp((at - vec2<f32>(low)) / max(vec2<f32>(high - low), vec2(1.0)), vec2(0.0), vec2(1.0));
    return mix(
        mix(sample_visibility(map, low), sample_visibility(map, vec2(high.x, low.y)), weight.x),
        mix(sample_visibility(map, vec2(low.x, high.y)), sample_visibility(map, high), weight.x),
        weight.y,
    );
}
