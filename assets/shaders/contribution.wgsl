// Which of the candidates in view cover too little of the picture: one invocation a slot of the table.
//
// In: `area_view`; `candidates`, as many as the binding holds; a bit each in `asked`: in view; a bit each in `fresh`:
// another entity's than in the last frame.
// Out: a bit each in `small`, kept from frame to frame: what is not asked for stays as it was. With AREAS, the area of
// every candidate instead.
//
// P4, steps 3 to 5.

#import bevy_skyline::contribution_area::{AreaView, area_px2}

/// Mirrors `GpuOccludee`.
struct Candidate {
    /// Rows of the affine matrix.
    world_from_local: mat3x4<f32>,
    centre: vec3<f32>,
    first_triangle: u32,
    axis_0: vec3<f32>,
    triangle_count: u32,
    axis_1: vec3<f32>,
    axis_2: vec3<f32>,
    /// Of occlusion culling: not used.
    turned: array<vec4<f32>, 4>,
};

@group(0) @binding(0) var<storage, read> area_view: AreaView;
@group(0) @binding(1) var<storage, read> candidates: array<Candidate>;
#ifdef AREAS
@group(0) @binding(2) var<storage, read_write> areas: array<f32>;
#else
@group(0) @binding(2) var<storage, read> asked: array<u32>;
@group(0) @binding(3) var<storage, read> fresh: array<u32>;
@group(0) @binding(4) var<storage, read_write> small: array<atomic<u32>>;
#endif

@compute @workgroup_size(64, 1, 1)
fn contribution(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&candidates) {
        return;
    }
#ifndef AREAS
    let word = id.x >> 5u;
    let bit = 1u << (id.x & 31u);
    if word >= arrayLength(&asked) {
        return;
    }
    if area_view.any_fresh != 0u && (fresh[word] & bit) != 0u {
        atomicAnd(&small[word], ~bit);
    }
    if (asked[word] & bit) == 0u {
        return;
    }
#endif
    let candidate = candidates[id.x];
    let area = area_px2(
        area_view.clip_from_world,
        area_view.viewport,
        candidate.world_from_local,
        candidate.centre,
        candidate.axis_0,
        candidate.axis_1,
        candidate.axis_2,
    );
#ifdef AREAS
    areas[id.x] = area;
#else
    let has_left = (atomicLoad(&small[word]) & bit) != 0u;
    if area < select(area_view.leaves, area_view.comes_back, has_left) {
        atomicOr(&small[word], bit);
    } else {
        atomicAnd(&small[word], ~bit);
    }
#endif
}
