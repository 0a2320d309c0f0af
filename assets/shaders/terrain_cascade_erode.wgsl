// Turns what a light's coarse rays hit into a caster that never shadows the surface it was cast from.
//
// Three steps: `DIPS` pushes each hit by what the surface may dip beside it, `ROWS` takes the farthest along x,
// and without either the farthest along y.
// In:  `depth_in`, R32Float, n x n: linear depth along the light, 1 nearest to it, 0 = no terrain.
// Out: `depth_out`, the same, pushed away from the light.
//
// Why nothing of it lies before a sunlit point of the terrain
//   Lengths are in coarse texels, of k shadow texels each. `terrain_cascade.wgsl` gives shadow texel p the
//   bilinear blend of the four stored values around it, which is never more than the largest of them. So it
//   is enough that each stored value is no nearer to the light than every sunlit point q whose shadow is
//   looked up at p. The shadow filter takes p up to its radius r away from q, along each axis; the stored
//   texel lies less than 1 from p; and q lies within 1 of each of the four hits around itself. A stored texel
//   and any hit around q are therefore less than 2 + r apart, so, as both are whole, at most
//   `reach` = ceil(2 + r) - 1. Storing the farthest of the hits within `reach` makes the stored value at
//   least as far away as the farthest hit around q; and q, on a surface through its four hits that is
//   bilinear as the light sees it, is no farther than that.
//   On a plane at the angle a to the light this is the push that derivations for shadow maps arrive at,
//   footprint times tan a, with the footprint `reach` (and at most one more from the blend), whatever a is:
//   no slope is estimated and none is capped. Where the hits end or jump, at a silhouette, the caster ends up
//   to `reach` + 1 inside it. Casters only ever shrink.
//
//   What the surface does between its hits: it can dip below them (away from the light) where it is concave.
//   A dip with one kink between two hits is at most half the second difference at the nearer one (for slopes
//   g either side of a kink x from it, the dip is g x and the second difference 2 g (1 - x), with x <= 1/2).
//   That much is pushed in addition, for both axes, up to `max_push`, so that a jump in depth, which is no
//   dip, costs no more than that. Roughness finer than a coarse texel escapes; what is left of it is up to
//   the receiver's normal bias, 1.8 sqrt(2) shadow texels by default.
//   `slack` is what `f32` matrices and depths can be off by, and how far below its exact surface the camera,
//   which may be allowed an error, can have drawn q; as that moves the lookup too, `r` has it as well.

struct Erosion {
    /// Side of the cast. units: coarse texels
    size: i32,
    /// units: coarse texels
    reach: i32,
    /// units: depth
    max_push: f32,
    slack: f32,
};

@group(0) @binding(0) var<uniform> erosion: Erosion;
@group(0) @binding(1) var depth_in: texture_2d<f32>;
@group(0) @binding(2) var depth_out: texture_storage_2d<r32float, write>;

fn depth_at(at: vec2<i32>) -> f32 {
    return textureLoad(depth_in, clamp(at, vec2(0), vec2(erosion.size - 1)), 0).x;
}

/// How far the surface can dip between a hit and its neighbours along one axis. Beside nothing there is no dip.
fn dip(before: f32, at: f32, after: f32) -> f32 {
    return select(0.0, max(0.5 * (before + after) - at, 0.0), before > 0.0 && after > 0.0);
}

@compute @workgroup_size(8, 8, 1)
fn terrain_cascade_erode(@builtin(global_invocation_id) id: vec3<u32>) {
    let at = vec2<i32>(id.xy);
    if any(at >= vec2(erosion.size)) {
        return;
    }
#ifdef DIPS
    let hit = depth_at(at);
    let push = dip(depth_at(at - vec2(1, 0)), hit, depth_at(at + vec2(1, 0)))
        + dip(depth_at(at - vec2(0, 1)), hit, depth_at(at + vec2(0, 1)));
    let depth = max(hit - min(push, erosion.max_push) - erosion.slack, 0.0);
#else
    var depth = 1.0;
    for (var i = -erosion.reach; i <= erosion.reach; i++) {
#ifdef ROWS
        depth = min(depth, depth_at(at + vec2(i, 0)));
#else
        depth = min(depth, depth_at(at + vec2(0, i)));
#endif
    }
#endif
    textureStore(depth_out, at, vec4(depth, 0.0, 0.0, 0.0));
}
