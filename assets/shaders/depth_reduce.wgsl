// Reduces a camera's depth to a pyramid of farthest depths (P2, section 4.2-4.3).
//
// Reverse-Z: 1 is the near plane, 0 infinitely far, so that farthest is the minimum. Level 0 has a texel for every
// block of BLOCK_X x BLOCK_Y pixels of the viewport: the farthest of them, or with STRIDED the one pixel at the
// block's top left. Each further level holds the farthest of up to four texels, down to one. All levels lie one
// after the other in `reduced`, rows from the top left.
//
// `depth_reduce` makes levels 0 to 3, eight texels square a workgroup; `depth_reduce_rest` the others, in one.

#import bevy_skyline::occludee::OcclusionView

/// Farther than nothing: the neutral element of `min` among depths.
const NONE: f32 = 2.0;

@group(0) @binding(0) var<storage, read> occlusion_view: OcclusionView;
@group(0) @binding(1) var<storage, read_write> reduced: array<f32>;
#ifdef MULTISAMPLED
@group(0) @binding(2) var depth: texture_depth_multisampled_2d;
#else
@group(0) @binding(2) var depth: texture_depth_2d;
#endif

/// Farthest of a pixel's samples.
fn farthest_sample(pixel: vec2<u32>) -> f32 {
#ifdef MULTISAMPLED
    var farthest = NONE;
    for (var sample = 0u; sample < #{SAMPLES}u; sample += 1u) {
        farthest = min(farthest, textureLoad(depth, pixel, sample));
    }
    return farthest;
#else
    return textureLoad(depth, pixel, 0);
#endif
}

/// A texel of level 0. `texel` is in the level.
fn farthest_of_block(texel: vec2<u32>) -> f32 {
    let size = vec2<u32>(occlusion_view.viewport);
    let first = texel * vec2(#{BLOCK_X}u, #{BLOCK_Y}u);
#ifdef STRIDED
    return farthest_sample(occlusion_view.origin + first);
#else
    var farthest = NONE;
    for (var y = 0u; y < #{BLOCK_Y}u; y += 1u) {
        for (var x = 0u; x < #{BLOCK_X}u; x += 1u) {
            // Beyond the border: the border's pixel once more.
            let pixel = min(first + vec2(x, y), size - 1u);
            farthest = min(farthest, farthest_sample(occlusion_view.origin + pixel));
        }
    }
    return farthest;
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
    let size = occlusion_view.level[0].yz;
    var farthest = NONE;
    if all(id.xy < size) {
        farthest = farthest_of_block(id.xy);
        store(0u, id.xy, farthest);
    }
    let place = local.y * 8u + local.x;
    tile[place] = farthest;
    for (var level = 1u; level < 4u; level += 1u) {
        workgroupBarrier();
        let half = 1u << (level - 1u);
        if all((local.xy & vec2((half << 1u) - 1u)) == vec2(0u)) {
            farthest = min(
                min(tile[place], tile[place + half]),
                min(tile[place + 8u * half], tile[place + 8u * half + half]),
            );
            store(level, id.xy >> vec2(level), farthest);
            tile[place] = farthest;
        }
    }
}

@compute @workgroup_size(256)
fn depth_reduce_rest(@builtin(local_invocation_index) index: u32) {
    for (var level = 4u; level < occlusion_view.level_count; level += 1u) {
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
