//! What the cullings of this suite share: the table of what can be removed, and what a game sees of the removal.
//!
//! | Where | What |
//! |---|---|
//! | [`candidates`] | one slot for each entity that can be removed, kept up by change |
//! | [`volume`] | the box that encloses it |
//! | [`clip`] | that box in clip space, and how far rounding may put it off |
//! | [`groups`] | boxes around what hangs together by `ChildOf` |
//! | [`culled`] | which entities a camera removed, and why |
//! | [`query`] | the same as a system parameter |
//!
//! Each frame, in [`CullSystems`]: the table follows the scene, then
//! [`ContributionCulling`] takes out what covers too little, then
//! [`SphericalIndex`](crate::spherical::SphericalIndex) the parts of meshes that the camera cannot see, then
//! [`ZBufferOcclusion`] what is hidden. All keep the order of `VisibleEntities`.

pub mod bits;
pub mod candidates;
pub mod clip;
pub mod culled;
pub mod groups;
pub mod query;
pub mod volume;

use bevy::{camera::visibility::VisibilitySystems, prelude::*};

pub use culled::{CullReason, CulledEntities};
pub use query::Culling;

use crate::{
    contribution::ContributionCulling,
    occlusion::{
        ZBufferOcclusion,
        meshes::{OccludeeMeshes, build_mesh_volumes},
    },
    systems::candidates::update_candidates,
};

/// What takes entities out of cameras' visible entities; in `PostUpdate`, after Bevy's `CheckVisibility`. Whatever
/// reads `VisibleEntities` or [`CulledEntities`] runs after it.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CullSystems;

/// What asks for the table of candidates.
type Asking = Or<(With<ZBufferOcclusion>, With<ContributionCulling>)>;

/// Whether a camera asks for it, or it is still there.
fn are_wanted(asking: Query<(), Asking>, table: Res<candidates::Candidates>) -> bool {
    !asking.is_empty() || table.is_kept
}

/// The steps of [`CullSystems`], in their order.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CullSteps {
    /// The table of candidates follows the scene.
    Candidates,
    /// What covers too little is removed.
    Contribution,
    /// Meshes give way to those of their chunks that can be seen.
    Selection,
    /// What is hidden is removed.
    Occlusion,
}

/// Registers what the cullings share, once.
pub(crate) fn register(app: &mut App) {
    if app.world().contains_resource::<candidates::Candidates>() {
        return;
    }
    app.register_type::<CulledEntities>()
        .init_resource::<candidates::Candidates>()
        .init_resource::<OccludeeMeshes>()
        .configure_sets(
            PostUpdate,
            (
                CullSteps::Candidates,
                CullSteps::Contribution,
                CullSteps::Selection,
                CullSteps::Occlusion,
            )
                .chain()
                .in_set(CullSystems)
                // An edited mesh is not tested with its old volumes.
                .after(bevy::asset::AssetEventSystems)
                // Places, bounds and what is in view are this frame's.
                .after(VisibilitySystems::CheckVisibility)
                .after(VisibilitySystems::MarkNewlyHiddenEntitiesInvisible),
        )
        .add_systems(
            PostUpdate,
            (build_mesh_volumes, update_candidates)
                .chain()
                .run_if(are_wanted)
                .in_set(CullSteps::Candidates),
        );
}
