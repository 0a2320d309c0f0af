// Averages of a tile's visibility over 2 x 2, 4 x 4 ... 64 x 64 samples, which lie behind it in the map, so that far
// ground does not shimmer. One workgroup a tile, level by level.
//
// In and out: `visibility`; `tiles`, which tiles of the map.

#import bevy_skyline::height_field::field
#import bevy_skyline::light_rays::{light, listed_tile}
#import bevy_skyline::shadow_tiles::{COARSEST, TILE, TILE_BYTES, mip_offset}

@group(1) @binding(1) var<storage, read> tiles: array<u32>;
@group(1) @binding(2) var<storage, read_write> visibility: array<u32>;

fn byte_at(at: u32) -> u32 {
    return (visibility[at / 4u] >> (8u * (at % 4u))) & 0xffu;
}

@compute @workgroup_size(64, 1, 1)
fn shadow_mips(@builtin(local_invocation_index) local: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let n = listed_tile(group);
    if n >= light.listed {
        return;
    }
    let index = tiles[n];
    let first = index * TILE_BYTES;
    let corner = (light.first_tile + vec2(index % light.tiles.x, index / light.tiles.x)) * TILE;
    // The last sample of the field in this tile: what lies beyond was not made.
    let last = min(vec2<u32>(field.cells) - corner, vec2(TILE - 1u));
    for (var level = 1u; level <= COARSEST; level++) {
        let side = TILE >> level;
        let side_in = side * 2u;
        let most = last >> vec2(level - 1u);
        let in = first + mip_offset(level - 1u);
        let out = first + mip_offset(level);
        for (var word = local; word < max(side * side / 4u, 1u); word += 64u) {
            var packed = 0u;
            for (var i = 0u; i < min(side * side, 4u); i++) {
                let texel = word * 4u + i;
                let low = min(vec2(texel % side, texel / side) * 2u, most);
                let high = min(low + 1u, most);
                let sum = byte_at(in + low.y * side_in + low.x) + byte_at(in + low.y * side_in + high.x)
                    + byte_at(in + high.y * side_in + low.x) + byte_at(in + high.y * side_in + high.x);
                packed |= ((sum + 2u) / 4u) << (8u * i);
            }
            visibility[out / 4u + word] = packed;
        }
        storageBarrier();
        workgroupBarrier();
    }
}
