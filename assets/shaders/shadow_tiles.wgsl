// How a shadow map lies in memory: tile after tile, each its samples, then their averages over 2 x 2, 4 x 4 ... 64 x 64.
#define_import_path bevy_skyline::shadow_tiles

/// Side of a tile. units: samples
const TILE: u32 = 64u;
/// Bytes of a tile, padding included.
const TILE_BYTES: u32 = 5464u;
/// The level at which a tile is one average.
const COARSEST: u32 = 6u;

/// Where in a tile a level of averages begins: 4096 + 1024 + ... before it.
fn mip_offset(level: u32) -> u32 {
    return (4u * TILE * TILE - ((4u * TILE * TILE) >> (2u * level))) / 3u;
}

/// The byte of a sample, or of an average of `level`, at `inside` of a tile of a map that is `tiles_x` tiles wide.
fn tile_byte(tile: vec2<u32>, tiles_x: u32, level: u32, inside: vec2<u32>) -> u32 {
    let side = TILE >> level;
    return (tile.y * tiles_x + tile.x) * TILE_BYTES + mip_offset(level) + inside.y * side + inside.x;
}
