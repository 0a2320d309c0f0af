// Reading a height field: samples from the texture, nodes from the pyramid.
#define_import_path bevy_skyline::height_field

#import bevy_skyline::types::Field

@group(#{FIELD_GROUP}) @binding(0) var<uniform> field: Field;
#ifdef HEIGHT_F32
@group(#{FIELD_GROUP}) @binding(1) var heights: texture_2d<f32>;
@group(#{FIELD_GROUP}) @binding(2) var<storage, read> pyramid: array<vec2<f32>>;
#else
@group(#{FIELD_GROUP}) @binding(1) var heights: texture_2d<u32>;
@group(#{FIELD_GROUP}) @binding(2) var<storage, read> pyramid: array<u32>;
#endif
@group(#{FIELD_GROUP}) @binding(3) var heights_sampler: sampler;

/// Nodes of level k along x and z.
fn level_size(k: u32) -> vec2<i32> {
    return vec2<i32>(field.level[k].yz);
}

/// Highest (x) and lowest (y) sample of a node of level k >= 1, relative to the height `base`.
fn node_range(k: u32, node: vec2<i32>, base: f32) -> vec2<f32> {
    let level = field.level[k];
    let index = level.x + u32(node.y) * level.y + u32(node.x);
#ifdef HEIGHT_F32
    return pyramid[index] - base;
#else
    let packed = pyramid[index];
    return vec2(f32(packed >> 16u), f32(packed & 0xffffu)) - base;
#endif
}

/// Sample (i, j), relative to the height `base`.
fn sample_height(at: vec2<i32>, base: f32) -> f32 {
    return f32(textureLoad(heights, at, 0).x) - base;
}

/// Heights of a cell's corners (i,j), (i+1,j), (i,j+1), (i+1,j+1), relative to `base`. One gather around the
/// point where the four texels meet, half a texel from choosing others.
fn cell_corners(cell: vec2<i32>, base: f32) -> vec4<f32> {
    let at = vec2<f32>(cell + 1) / vec2<f32>(field.cells + 1);
    return vec4<f32>(textureGather(0, heights, heights_sampler, at).wzxy) - base;
}
