//! Main-world side of the baselines that a frame budget is compared with.

use core::any::TypeId;

use bevy::{camera::visibility::VisibleEntities, prelude::*};

use crate::{
    budget::{
        FrameBudget, WorkloadPolicy,
        policy::{InView, distance_m, nearest_within},
    },
    contribution::ContributionCamera,
    culling::candidates::Candidates,
};

/// Areas of what goes and what stays, below and above any threshold. units: px²
const GOES: f32 = -1.0;
const STAYS: f32 = f32::INFINITY;

/// Lets cameras without a budget remove what their policy says.
pub fn follow_policy(
    table: Option<Res<Candidates>>,
    mut in_view: Local<Vec<InView>>,
    mut cameras: Query<
        (
            &WorkloadPolicy,
            &GlobalTransform,
            &VisibleEntities,
            &mut ContributionCamera,
        ),
        Without<FrameBudget>,
    >,
) {
    let Some(table) = table else {
        return;
    };
    for (policy, place, visible, mut camera) in &mut cameras {
        let list = visible.get(TypeId::of::<Mesh3d>());
        let eye = place.translation();
        in_view.clear();
        // What may not be removed is none of it.
        in_view.extend(list.iter().zip(0..).filter_map(|(entity, at)| {
            let of = table.get(table.weighable(*entity)?)?;
            Some(InView {
                at,
                distance_m: distance_m(eye, &of.world_from_local, &of.volume),
                triangles: of.triangles,
            })
        }));
        camera.areas.fill(STAYS);
        let goes = match *policy {
            WorkloadPolicy::Distance(most) => {
                in_view.retain(|of| of.distance_m > most);
                &in_view[..]
            }
            WorkloadPolicy::Polygons(triangles) => {
                let stays = nearest_within(&mut in_view, triangles);
                &in_view[stays..]
            }
        };
        for of in goes {
            if let Some(area) = camera.areas.get_mut(of.at as usize) {
                *area = GOES;
            }
        }
    }
}
