// The verdicts on a list of occludees: one invocation each.
//
// In: `occlusion_view`, `reduced_depth`, `swept_triangles` of the import; `occludees`, as many as the binding holds.
// Out: `verdicts`, one `VERDICT_*` each.
//
// P2, sections 3.2 and 4.3.

#import bevy_skyline::occludee::{VERDICT_VISIBLE, box_verdict, clip_frame, proxy_verdict}

/// Mirrors `GpuOccludee`.
struct Occludee {
    /// Rows of the affine matrix.
    world_from_local: mat3x4<f32>,
    centre: vec3<f32>,
    /// Of its proxy.
    first_triangle: u32,
    axis_0: vec3<f32>,
    /// 0: it has no proxy.
    triangle_count: u32,
    axis_1: vec3<f32>,
    axis_2: vec3<f32>,
};

@group(0) @binding(3) var<storage, read> occludees: array<Occludee>;
@group(0) @binding(4) var<storage, read_write> verdicts: array<u32>;

@compute @workgroup_size(64, 1, 1)
fn occludee_verdicts(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&occludees) {
        return;
    }
    let occludee = occludees[id.x];
    let frame = clip_frame(occludee.world_from_local);
    var verdict = box_verdict(frame, occludee.centre, occludee.axis_0, occludee.axis_1, occludee.axis_2);
    if verdict == VERDICT_VISIBLE && occludee.triangle_count > 0u {
        verdict = proxy_verdict(frame, occludee.first_triangle, occludee.triangle_count);
    }
    verdicts[id.x] = verdict;
}
