// The verdicts on a list of occludees: one invocation each.
//
// In: `occlusion_view`, `reduced_depth`, `swept_triangles` of the import; `occludees`, as many as the binding holds.
// Out: `verdicts`, one `VERDICT_*` each; with SELECTED, of those whose bit in `to_test` is set, a bit in `hidden` for
// those that are, and nothing for the others.
//
// P2, sections 3.2 and 4.3.

#import bevy_skyline::occludee::{VERDICT_HIDDEN, VERDICT_VISIBLE, box_verdict, occludee_frame, proxy_verdict}

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
#ifdef SELECTED
@group(0) @binding(4) var<storage, read_write> hidden: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read> to_test: array<u32>;
#else
@group(0) @binding(4) var<storage, read_write> verdicts: array<u32>;
#endif

@compute @workgroup_size(64, 1, 1)
fn occludee_verdicts(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&occludees) {
        return;
    }
#ifdef SELECTED
    let word = id.x >> 5u;
    let bit = 1u << (id.x & 31u);
    if word >= arrayLength(&to_test) || (to_test[word] & bit) == 0u {
        return;
    }
#endif
    let occludee = occludees[id.x];
    let frame = occludee_frame(occludee.world_from_local);
    var verdict = box_verdict(frame, occludee.centre, occludee.axis_0, occludee.axis_1, occludee.axis_2);
    if verdict == VERDICT_VISIBLE && occludee.triangle_count > 0u {
        verdict = proxy_verdict(frame, occludee.first_triangle, occludee.triangle_count);
    }
#ifdef SELECTED
    if verdict == VERDICT_HIDDEN {
        atomicOr(&hidden[word], bit);
    }
#else
    verdicts[id.x] = verdict;
#endif
}
