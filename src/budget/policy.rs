//! What a frame budget is compared with: the ways to bound a workload that P4 and others use (P4's experiments).
//!
//! All of them take entities out the way contribution culling does: they write the areas that it compares.

use bevy::{
    camera::visibility::NoCpuCulling, ecs::lifecycle::HookContext, ecs::world::DeferredWorld,
    prelude::*,
};

use crate::contribution::ContributionCulling;

/// On a camera: bounds what it draws by something other than time. For comparison; a
/// [`FrameBudget`](super::FrameBudget) on the same camera overrides it.
///
/// Needs [`ContributionPlugin`](crate::plugin::ContributionPlugin). Where the camera has no
/// [`ContributionCulling`] it gets one that removes nothing by itself and cuts.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
#[require(ContributionCulling = removes_nothing())]
#[component(on_insert = cull_by_frustum_or_not, on_discard = cull_by_frustum_again)]
pub enum WorkloadPolicy {
    /// Everything, what is out of view included: the camera gets `NoCpuCulling`.
    None,
    /// What is in view.
    #[default]
    Frustum,
    /// The nearest objects in view, as many as have together no more than so many triangles (P4, its first baseline).
    Polygons(u64),
    /// What in view is, with the centre of its bound, no farther than this. units: m
    Distance(f32),
    /// What in view covers no less than this (P4, its method). units: px²
    Threshold(f32),
}

fn removes_nothing() -> ContributionCulling {
    ContributionCulling {
        threshold_px2: 0.0,
        hysteresis: 1.0,
        weigh_by_visibility: false,
        gpu_from: usize::MAX,
        ..default()
    }
}

fn cull_by_frustum_or_not(mut world: DeferredWorld, context: HookContext) {
    if world.get::<WorkloadPolicy>(context.entity) == Some(&WorkloadPolicy::None) {
        world.commands().entity(context.entity).insert(NoCpuCulling);
    }
}

fn cull_by_frustum_again(mut world: DeferredWorld, context: HookContext) {
    if world.get::<WorkloadPolicy>(context.entity) == Some(&WorkloadPolicy::None) {
        // The camera may be on its way out.
        if let Ok(mut camera) = world.commands().get_entity(context.entity) {
            camera.try_remove::<NoCpuCulling>();
        }
    }
}

/// Whether a camera follows a policy.
pub(crate) fn is_followed(cameras: Query<(), With<WorkloadPolicy>>) -> bool {
    !cameras.is_empty()
}

/// Of objects, by distance and triangles, which are within a number of triangles; the nearest first. Objects at the
/// same distance stay in their order. Afterwards `order` holds the indices by distance; returns how many of them stay.
pub fn nearest_within(
    order: &mut Vec<u32>,
    of: impl Fn(u32) -> (f32, u32),
    len: usize,
    triangles: u64,
) -> usize {
    order.clear();
    order.extend(0..len as u32);
    order.sort_unstable_by(|a, b| of(*a).0.total_cmp(&of(*b).0).then(a.cmp(b)));
    let mut left = triangles;
    order
        .iter()
        .take_while(|i| match left.checked_sub(u64::from(of(**i).1)) {
            Some(rest) => {
                left = rest;
                true
            }
            None => false,
        })
        .count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_stay_until_the_triangles_are_used_up() {
        let objects = [(5.0, 10), (1.0, 20), (3.0, 30), (2.0, 40), (9.0, 0)];
        let mut order = Vec::new();
        let of = |i: u32| objects[i as usize];
        assert_eq!(nearest_within(&mut order, of, 5, 90), 3);
        assert_eq!(order[..3], [1, 3, 2]);
        assert_eq!(nearest_within(&mut order, of, 5, 89), 2);
        assert_eq!(nearest_within(&mut order, of, 5, 19), 0);
        assert_eq!(nearest_within(&mut order, of, 5, 100), 5);
        assert_eq!(nearest_within(&mut order, of, 0, 100), 0);
    }
}
