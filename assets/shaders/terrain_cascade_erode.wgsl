// Turns what a light's coarse rays hit into a caster that never shadows the surface it was cast from.
//
// In:  `hit_depth`, R32Float, n x n: linear depth along the light, 1 nearest to it, 0 = no terrain.
// Out: `caster_depth`, the same, pushed away from the light.
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
    /// units: coarse texels; at most `MAX_REACH`
    reach: i32,
    /// units: depth
    max_push: f32,
    slack: f32,
};

@group(0) @binding(0) var<uniform> erosion: Erosion;
@group(0) @binding(1) var hit_depth: texture_2d<f32>;
@group(0) @binding(2) var caster_depth: texture_storage_2d<r32float, write>;

/// As in `cascades/mod.rs`.
const MAX_REACH: i32 = 6;
const GROUP: i32 = 8;
const PUSHED_SIDE: i32 = GROUP + 2 * MAX_REACH;
const HIT_SIDE: i32 = PUSHED_SIDE + 2;

var<workgroup> hits: array<array<f32, HIT_SIDE>, HIT_SIDE>;
var<workgroup> pushed: array<array<f32, PUSHED_SIDE>, PUSHED_SIDE>;
/// Farthest along x only.
var<workgroup> rows: array<array<f32, GROUP>, PUSHED_SIDE>;

/// How far the surface can dip between a hit and its neighbours along one axis. Beside nothing there is no dip.
fn dip(before: f32, at: f32, after: f32) -> f32 {
    return select(0.0, max(0.5 * (before + after) - at, 0.0), before > 0.0 && after > 0.0);
}

@compute @workgroup_size(8, 8, 1)
fn terrain_cascade_erode(@builtin(local_invocation_id) local_id: vec3<u32>, @builtin(workgroup_id) group: vec3<u32>) {
    let local = vec2<i32>(local_id.xy);
    let at = vec2<i32>(group.xy) * GROUP + local;
    let pushed_side = GROUP + 2 * erosion.reach;
    let first = at - local - erosion.reach - 1;
    for (var y = local.y; y < pushed_side + 2; y += GROUP) {
        for (var x = local.x; x < pushed_side + 2; x += GROUP) {
            hits[y][x] = textureLoad(hit_depth, clamp(first + vec2(x, y), vec2(0), vec2(erosion.size - 1)), 0).x;
        }
    }
    workgroupBarrier();
    for (var y = local.y; y < pushed_side; y += GROUP) {
        for (var x = local.x; x < pushed_side; x += GROUP) {
            let hit = hits[y + 1][x + 1];
            let push = dip(hits[y + 1][x], hit, hits[y + 1][x + 2]) + dip(hits[y][x + 1], hit, hits[y + 2][x + 1]);
            pushed[y][x] = max(hit - min(push, erosion.max_push) - erosion.slack, 0.0);
        }
    }
    workgroupBarrier();
    for (var y = local.y; y < pushed_side; y += GROUP) {
        var farthest = 1.0;
        for (var x = 0; x <= 2 * erosion.reach; x++) {
            farthest = min(farthest, pushed[y][local.x + x]);
        }
        rows[y][local.x] = farthest;
    }
    workgroupBarrier();
    if any(at >= vec2(erosion.size)) {
        return;
    }
    var farthest = 1.0;
    for (var y = 0; y <= 2 * erosion.reach; y++) {
        farthest = min(farthest, rows[local.y + y][local.x]);
    }
    textureStore(caster_depth, at, vec4(farthest, 0.0, 0.0, 0.0));
}
