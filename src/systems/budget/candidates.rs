//! What a budget sees of what cameras have in view, and what it demands: where cullings keep a table of candidates.

use core::any::TypeId;

use bevy::{
    camera::visibility::VisibleEntities,
    ecs::{query::QueryData, system::SystemParam, world::DeferredWorld},
    prelude::*,
};

use crate::{
    budget::{
        BudgetState, BudgetSystems,
        workload::{DemandProfile, Workload},
    },
    contribution::{ContributionCamera, ContributionSteps},
    culling::candidates::Candidates,
    occlusion::{OcclusionCamera, OcclusionCounts},
};

/// Puts choosing between measuring areas and removing what is small.
pub(crate) fn order(app: &mut App) {
    app.configure_sets(
        PostUpdate,
        BudgetSystems::Choose.in_set(ContributionSteps::Choose),
    );
}

/// Nothing is demanded of a camera any more.
pub(crate) fn give_back(world: &mut DeferredWorld, camera: Entity) {
    if let Some(mut camera) = world.get_mut::<ContributionCamera>(camera) {
        camera.demanded_px2 = 0.0;
    }
}

/// A camera with a budget.
#[derive(QueryData)]
#[query_data(mutable)]
pub struct BudgetCamera {
    pub(super) camera: &'static Camera,
    pub(super) state: &'static mut BudgetState,
    visible: Option<&'static VisibleEntities>,
    contribution: Option<&'static mut ContributionCamera>,
    occlusion: Option<(&'static OcclusionCamera, &'static OcclusionCounts)>,
}

impl BudgetCameraItem<'_, '_> {
    /// Demands it of the camera's contribution culling, if it has any.
    pub(super) fn demand(&mut self, px2: f32) {
        if let Some(camera) = &mut self.contribution {
            camera.demanded_px2 = px2;
        }
    }
}

impl BudgetCameraReadOnlyItem<'_, '_> {
    /// Adds what is in view, and says whether contribution culling can take of it. `viewport`: its area. units: px²
    pub(super) fn add_to(
        &self,
        profile: &mut DemandProfile,
        areas: &mut [f32],
        table: &Table,
        viewport: f32,
    ) -> bool {
        match (self.visible, self.contribution, &table.0) {
            (Some(visible), Some(camera), Some(table)) => {
                add_candidates(
                    profile,
                    areas,
                    table,
                    visible,
                    camera,
                    self.occlusion,
                    viewport,
                );
                return true;
            }
            (Some(visible), ..) => profile.add_fixed(Workload::objects(visible)),
            (None, ..) => {}
        }
        false
    }
}

/// The table of candidates, if it is kept.
#[derive(SystemParam)]
pub struct Table<'w>(Option<Res<'w, Candidates>>);

impl Table<'_> {
    /// How many slots areas are kept of.
    pub(super) fn slots(&self) -> usize {
        self.0.as_ref().map_or(0, |table| table.slots())
    }

    /// What a camera draws of what is in view in the end. `areas`: by slot. `viewport`: its area. units: px²
    pub(super) fn drawn(
        &self,
        visible: &VisibleEntities,
        areas: &[f32],
        viewport: f32,
    ) -> Workload {
        let mut drawn = Workload::default();
        for entity in visible.get(TypeId::of::<Mesh3d>()) {
            let slot = self.0.as_ref().and_then(|table| table.weighable(*entity));
            let Some((slot, table)) = slot.zip(self.0.as_ref()) else {
                drawn.objects += 1.0;
                continue;
            };
            let triangles = table.get(slot).map_or(0, |of| of.triangles);
            let area = areas.get(slot as usize).copied().unwrap_or(0.0);
            drawn = drawn + Workload::object(triangles, area, viewport);
        }
        drawn
    }
}

/// Adds what a camera has in view, as its contribution culling will compare it, but for what is known to be hidden.
fn add_candidates(
    profile: &mut DemandProfile,
    areas: &mut [f32],
    table: &Candidates,
    visible: &VisibleEntities,
    camera: &ContributionCamera,
    occlusion: Option<(&OcclusionCamera, &OcclusionCounts)>,
    viewport: f32,
) {
    let hidden = occlusion
        .filter(|(_, counts)| counts.removed > 0)
        .map(|(camera, _)| &camera.hidden);
    let mut others = Workload::default();
    for (i, entity) in visible.get(TypeId::of::<Mesh3d>()).iter().enumerate() {
        let area = camera.areas.get(i).copied().unwrap_or(f32::INFINITY);
        let Some(slot) = table.weighable(*entity) else {
            others.objects += 1.0;
            continue;
        };
        if let Some(known) = areas.get_mut(slot as usize) {
            *known = area;
        }
        if hidden.is_some_and(|hidden| hidden.contains(slot)) {
            continue;
        }
        let triangles = table.get(slot).map_or(0, |of| of.triangles);
        let was_gone = camera.removed.contains(slot);
        // What the camera's own threshold takes is not the budget's to give.
        if let Some(most) = (camera.standard).stays_up_to_px2(area, triangles, was_gone) {
            profile.add(most, Workload::object(triangles, area, viewport));
        }
    }
    profile.add_fixed(others);
}
