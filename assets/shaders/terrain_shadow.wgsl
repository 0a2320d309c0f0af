// How much of a light each sample of a tile sees, by a ray from the sample to the light (P5b).
//
// One invocation a sample; four neighbours' bytes make one word of the map. `COARSE` casts one ray for 4 x 4 samples
// instead.
//
// In:  `tiles`, which tiles of the map to make. Out: `visibility`, a byte a sample, 255 = all of the light.

#import bevy_skyline::height_field::{field, sample_height}
#import bevy_skyline::light_rays::{light, listed_tile, map_byte, visible_share}
#import bevy_skyline::shadow_tiles::TILE

@group(1) @binding(1) var<storage, read> tiles: array<u32>;
@group(1) @binding(2) var<storage, read_write> visibility: array<u32>;

#ifndef COARSE
var<workgroup> shares: array<u32, 64>;
#endif

fn share_at(at: vec2<u32>) -> u32 {
    let sample = min(vec2<i32>(at), field.cells);
#ifdef PER_TEXEL
    let highest = 0u;
#else
    let highest = field.levels;
#endif
    return u32(round(255.0 * visible_share(sample, sample_height(sample, 0.0), highest)));
}

@compute @workgroup_size(64, 1, 1)
fn terrain_shadow(@builtin(local_invocation_index) local: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let n = listed_tile(group);
    if n >= light.listed {
        return;
    }
    let index = tiles[n];
    let tile = light.first_tile + vec2(index % light.tiles.x, index / light.tiles.x);
#ifdef COARSE
    // A workgroup takes 32 x 32 samples, a tile four of them.
    let at = tile * TILE + vec2(group.x & 1u, group.x >> 1u) * 32u + vec2(local & 7u, local >> 3u) * 4u;
    if any(at > vec2<u32>(field.cells)) {
        return;
    }
    let word = share_at(at + 2u) * 0x01010101u;
    for (var row = 0u; row < 4u; row++) {
        visibility[map_byte(at + vec2(0u, row)) / 4u] = word;
    }
#else
    // A workgroup takes 8 x 8 samples. Invocations that run in step (8 and more) take a compact block of them: their
    // rays go the same way.
    let first = tile * TILE + vec2(group.x & 7u, group.x >> 3u) * 8u;
    let in_group = vec2(((local >> 3u) & 1u) * 4u + (local & 3u), (local >> 4u) * 2u + ((local >> 2u) & 1u));
    let at = first + in_group;
    var share = 0u;
    if all(at <= vec2<u32>(field.cells)) {
        share = share_at(at);
    }
    shares[in_group.y * 8u + in_group.x] = share;
    workgroupBarrier();
    if local < 16u {
        let word = local * 4u;
        let byte = map_byte(first + vec2(word & 7u, word >> 3u));
        visibility[byte / 4u] = shares[word] | (shares[word + 1u] << 8u) | (shares[word + 2u] << 16u)
            | (shares[word + 3u] << 24u);
    }
#endif
}
