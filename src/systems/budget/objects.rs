//! What a budget sees of what cameras have in view where no culling is built: how many objects, none of which it can
//! demand. It moves the other knobs.

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
    culling::CullSystems,
};

/// What is in view is counted before anything is removed of it.
pub(crate) fn order(app: &mut App) {
    app.configure_sets(PostUpdate, BudgetSystems::Choose.before(CullSystems));
}

/// Nothing was demanded.
pub(crate) fn give_back(_: &mut DeferredWorld, _: Entity) {}

/// A camera with a budget.
#[derive(QueryData)]
#[query_data(mutable)]
pub struct BudgetCamera {
    pub(super) camera: &'static Camera,
    pub(super) state: &'static mut BudgetState,
    visible: Option<&'static VisibleEntities>,
}

impl BudgetCameraItem<'_, '_> {
    /// There is nothing to demand it of.
    pub(super) fn demand(&mut self, _px2: f32) {}
}

impl BudgetCameraReadOnlyItem<'_, '_> {
    /// Adds what is in view, and says that nothing of it can be demanded.
    pub(super) fn add_to(
        &self,
        profile: &mut DemandProfile,
        _areas: &mut [f32],
        _table: &Table,
        _viewport: f32,
    ) -> bool {
        if let Some(visible) = self.visible {
            profile.add_fixed(Workload::objects(visible));
        }
        false
    }
}

/// No table of candidates.
#[derive(SystemParam)]
pub struct Table;

impl Table {
    /// How many slots areas are kept of.
    pub(super) fn slots(&self) -> usize {
        0
    }

    /// What a camera draws of what is in view in the end.
    pub(super) fn drawn(
        &self,
        visible: &VisibleEntities,
        _areas: &[f32],
        _viewport: f32,
    ) -> Workload {
        Workload::objects(visible)
    }
}
