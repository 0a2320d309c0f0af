// Reduces a camera's depth to a pyramid of farthest depths (P2, section 4.2-4.3).
//
// Reverse-Z: 1 is the near plane, 0 infinitely far, so that farthest is the minimum. Level 0 has a texel for every
// block of BLOCK_X x BLOCK_Y pixels of the viewport: the farthest of them, or with STRIDED the one pixel at the
// block's top left. Each further level holds the farthest of up to four texels, down to one. All levels lie one
// after the other in `reduced`, rows from the top left.
//
// `depth_reduce` makes levels 0 to 4, 16 x 16 texels of level 0 a workgroup, four of them an invocation;
// `depth_reduce_rest` makes the others, in one workgroup.

#import bevy_skyline::occludee::OcclusionView

/// Nearer than anything: the neutral element of `min` among depths.
const NONE: f32 = 2.0;

@group(0) @binding(0) var<storage, read> occlusion_view: OcclusionView;
@group(0) @binding(1) var<storage, read_write> reduced: array<f32>;
#ifdef MULTISAMPLED
@group(0) @binding(2) var depth: texture_depth_multisampled_2d;
#else
@group(0) @binding(2) var depth: texture_depth_2d;
@group(0) @binding(3) var nearest: sampler;
#endif

/// Farthest of the samples of a pixel of the viewport; beyond its border, `NONE`.
fn farthest_sample(pixel: vec2<u32>) -> f32 {
    if any(pixel >= vec2<u32>(occlusion_view.viewport)) {
        return NONE;
    }
#ifdef MULTISAMPLED
    var farthest = NONE;
    for (var sample = 0u; sample < #{SAMPLES}u; sample += 1u) {
        farthest = min(farthest, textureLoad(depth, occlusion_view.origin + pixel, sample));
    }
    return farthest;
#else
    return textureLoad(depth, occlusion_view.origin + pixel, 0);
#endif
}

/// Depths of 2 x 2 pixels, x first; beyond the viewport's border, `NONE`.
fn quad(pixel: vec2<u32>) -> vec4<f32> {
#ifdef MULTISAMPLED
    return vec4(
        farthest_sample(pixel),
        farthest_sample(pixel + vec2(1u, 0u)),
        farthest_sample(pixel + vec2(0u, 1u)),
        farthest_sample(pixel + vec2(1u, 1u)),
    );
#else
    let size = vec2<u32>(occlusion_view.viewport);
    if any(pixel >= size) {
        return vec4(NONE);
    }
    // Around the corner that the four share; half a pixel of rounding would not choose others.
    let corner = vec2<f32>(occlusion_view.origin + pixel + 1u) / vec2<f32>(textureDimensions(depth));
    let four = textureGather(depth, nearest, corner).wzxy;
    let inside = pixel + 1u < size;
    return select(
        vec4(NONE),
        four,
        vec4(true, inside.x, inside.y, inside.x && inside.y),
    );
#endif
}

/// A texel of level 0.
fn farthest_of_block(texel: vec2<u32>) -> f32 {
    let first = texel * vec2(#{BLOCK_X}u, #{BLOCK_Y}u);
#ifdef STRIDED
    return farthest_sample(first);
#else
    var farthest = NONE;
#ifdef EVEN_BLOCK
    for (var y = 0u; y < #{BLOCK_Y}u; y += 2u) {
        for (var x = 0u; x < #{BLOCK_X}u; x += 2u) {
            let four = quad(first + vec2(x, y));
            farthest = min(farthest, min(min(four.x, four.y), min(four.z, four.w)));
        }
    }
#else
    for (var y = 0u; y < #{BLOCK_Y}u; y += 1u) {
        for (var x = 0u; x < #{BLOCK_X}u; x += 1u) {
            farthest = min(farthest, farthest_sample(first + vec2(x, y)));
        }
    }
#endif
    return farthest;
#endif
}

/// 2 x 2 texels of level 0, x first.
fn four_texels(texel: vec2<u32>) -> vec4<f32> {
#ifdef PIXELS
    return quad(texel);
#else
    return vec4(
        farthest_of_block(texel),
        farthest_of_block(texel + vec2(1u, 0u)),
        farthest_of_block(texel + vec2(0u, 1u)),
        farthest_of_block(texel + vec2(1u, 1u)),
    );
#endif
}

fn store(level: u32, texel: vec2<u32>, farthest: f32) {
    let place = occlusion_view.level[level];
    if level < occlusion_view.level_count && all(texel < place.yz) {
        reduced[place.x + texel.y * place.y + texel.x] = farthest;
    }
}

var<workgroup> tile: array<f32, 64>;

@compute @workgroup_size(8, 8)
fn depth_reduce(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
) {
    let texel = id.xy * 2u;
    let four = four_texels(texel);
    store(0u, texel, four.x);
    store(0u, texel + vec2(1u, 0u), four.y);
    store(0u, texel + vec2(0u, 1u), four.z);
    store(0u, texel + vec2(1u, 1u), four.w);
    var farthest = min(min(four.x, four.y), min(four.z, four.w));
    store(1u, id.xy, farthest);
    let place = local.y * 8u + local.x;
    tile[place] = farthest;
    for (var step = 1u; step < 4u; step += 1u) {
        workgroupBarrier();
        let half = 1u << (step - 1u);
        if all((local.xy & vec2((half << 1u) - 1u)) == vec2(0u)) {
            farthest = min(
                min(tile[place], tile[place + half]),
                min(tile[place + 8u * half], tile[place + 8u * half + half]),
            );
            store(step + 1u, id.xy >> vec2(step), farthest);
            tile[place] = farthest;
        }
    }
}

@compute @workgroup_size(256)
fn depth_reduce_rest(@builtin(local_invocation_index) index: u32) {
    for (var level = 5u; level < occlusion_view.level_count; level += 1u) {
        storageBarrier();
        let fine = occlusion_view.level[level - 1u];
        let place = occlusion_view.level[level];
        for (var i = index; i < place.y * place.z; i += 256u) {
            let texel = vec2(i % place.y, i / place.y);
            let first = texel * 2u;
            let last = min(first + 1u, fine.yz - 1u);
            let rows = fine.x + vec2(first.y, last.y) * fine.y;
            reduced[place.x + i] = min(
                min(reduced[rows.x + first.x], reduced[rows.x + last.x]),
                min(reduced[rows.y + first.x], reduced[rows.y + last.x]),
            );
        }
    }
}
