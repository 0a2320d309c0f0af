//! What a frame budget is compared with: the ways to bound a workload that P4 and others use (P4's experiments).
//!
//! | P4's baseline | On the camera |
//! |---|---|
//! | no culling | nothing, and Bevy's `NoFrustumCulling` on every object |
//! | frustum alone | nothing |
//! | a fixed number of polygons | [`WorkloadPolicy::Polygons`] |
//! | a fixed view distance | [`WorkloadPolicy::Distance`] |
//! | a fixed threshold | [`ContributionCulling`] by itself, P4's own method |

use bevy::{math::Affine3A, prelude::*};

use super::BudgetSystems;
use crate::{
    contribution::{ContributionCulling, ContributionSteps},
    culling::volume::LocalBox,
    systems::workload_policy::follow_policy,
};

/// On a camera: bounds what it draws by something other than time. For comparison; a
/// [`FrameBudget`](super::FrameBudget) on the same camera overrides it.
///
/// It takes entities out the way contribution culling does, in place of the areas that it compares, and so needs
/// [`ContributionPlugin`](crate::plugin::ContributionPlugin) and [`BudgetPlugin`](crate::plugin::BudgetPlugin). Where the
/// camera has no [`ContributionCulling`] it gets one that cuts; the threshold of one that it has does not hold meanwhile.
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// # let target = headless::target();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let world = app.world_mut();
/// # let cube = world.resource_mut::<Assets<Mesh>>().add(Cuboid::from_length(1.0));
/// let camera = world.spawn((Camera3d::default(), target, WorkloadPolicy::Distance(50.0))).id();
/// let [near, far] = [40.0, 60.0].map(|distance| {
///     world.spawn((Mesh3d(cube.clone()), Transform::from_xyz(0.0, 0.0, -distance))).id()
/// });
/// # app.update();
/// # app.update();
///
/// let culled = app.world().get::<CulledEntities>(camera).expect("required by the policy");
/// assert_eq!(culled.reason(near), None);
/// assert_eq!(culled.reason(far), Some(CullReason::Contribution));
/// ```
#[derive(Component, Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Component, Clone, Debug, PartialEq)]
#[require(ContributionCulling = removes_nothing())]
pub enum WorkloadPolicy {
    /// The nearest objects in view, as many as have together no more than so many triangles (P4, its first baseline).
    Polygons(u64),
    /// What in view is, with the nearest point of its bound, no farther than this. units: m
    Distance(f32),
}

fn removes_nothing() -> ContributionCulling {
    ContributionCulling {
        threshold_px2: 0.0,
        hysteresis: 1.0,
        weigh_by_visibility: false,
        ..default()
    }
}

/// Registers type and system.
pub(crate) fn register(app: &mut App) {
    app.register_type::<WorkloadPolicy>().add_systems(
        PostUpdate,
        follow_policy
            .run_if(is_followed)
            .in_set(ContributionSteps::Choose)
            // A budget overrides it.
            .after(BudgetSystems::Choose),
    );
}

/// Whether a camera follows a policy.
fn is_followed(cameras: Query<(), With<WorkloadPolicy>>) -> bool {
    !cameras.is_empty()
}

/// How far the nearest point of a bound is from an eye, if the object is turned, moved and scaled evenly; of an object
/// that is scaled to nothing, how far its place is. units: m
pub fn distance_m(eye: Vec3, world_from_local: &Affine3A, bound: &LocalBox) -> f32 {
    let local = world_from_local.inverse().transform_point3(eye);
    let nearest = if local.is_finite() {
        bound.nearest(local)
    } else {
        Vec3::ZERO
    };
    world_from_local.transform_point3(nearest).distance(eye)
}

/// One object in view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InView {
    /// Its place among them all.
    pub at: u32,
    /// See [`distance_m`].
    pub distance_m: f32,
    /// Triangles of its mesh.
    pub triangles: u32,
}

/// Sorts objects, the nearest first, those at the same distance by their place; returns how many of them are together
/// within a number of triangles. Beyond the first that is not, nothing is, however small.
pub fn nearest_within(objects: &mut [InView], triangles: u64) -> usize {
    objects.sort_unstable_by(|a, b| a.distance_m.total_cmp(&b.distance_m).then(a.at.cmp(&b.at)));
    let mut sum = 0;
    objects
        .iter()
        .take_while(|object| {
            sum += u64::from(object.triangles);
            sum <= triangles
        })
        .count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_stay_until_the_triangles_are_used_up() {
        let objects = [
            (5.0, 10),
            (1.0, 20),
            (3.0, 30),
            (2.0, 40),
            (9.0, 0),
            (3.0, 1),
        ];
        let mut at = 0..;
        let mut objects = objects.map(|(distance_m, triangles)| InView {
            at: at.next().unwrap_or(0),
            distance_m,
            triangles,
        });
        assert_eq!(nearest_within(&mut objects, 91), 4);
        assert_eq!(objects.map(|of| of.at), [1, 3, 2, 5, 0, 4]);
        assert_eq!(nearest_within(&mut objects, 89), 2);
        assert_eq!(nearest_within(&mut objects, 19), 0);
        assert_eq!(nearest_within(&mut objects, 101), 6);
        assert_eq!(nearest_within(&mut [], 100), 0);
    }

    #[test]
    fn distance_is_to_the_nearest_point() {
        let bound = LocalBox {
            centre: Vec3::ZERO,
            axes: [Vec3::X, Vec3::Y, Vec3::Z],
        };
        let at = |transform: Transform| transform.compute_affine();
        let turned = at(Transform::from_xyz(10.0, 0.0, 0.0)
            .with_rotation(Quat::from_rotation_z(0.5))
            .with_scale(Vec3::splat(2.0)));
        // A few roundings of numbers up to 20.
        let inside = distance_m(Vec3::new(10.5, 0.0, 0.0), &turned, &bound);
        assert!(inside < 16.0 * 20.0 * f32::EPSILON, "{inside}");
        let unturned = at(Transform::from_xyz(10.0, 0.0, 0.0).with_scale(Vec3::splat(2.0)));
        assert_eq!(distance_m(Vec3::ZERO, &unturned, &bound), 8.0);
        let above = Vec3::new(15.0, 6.0, 0.0);
        assert_eq!(distance_m(above, &unturned, &bound), 5.0);
        let gone = at(Transform::from_xyz(10.0, 0.0, 0.0).with_scale(Vec3::ZERO));
        assert_eq!(distance_m(Vec3::ZERO, &gone, &bound), 10.0);
    }
}
