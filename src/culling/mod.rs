//! What takes meshes out of cameras' view, in which order, and what a game sees of it; and what the two cullings that
//! compare with the picture share: the table of what can be removed.
//!
//! | Where | What | Built |
//! |---|---|---|
//! | `culled` | which entities a camera removed, and why | always |
//! | `query` | the same as a system parameter | always |
//! | `part` | what an entity is to one effect, for the others to know | always |
//! | [`candidates`] | one slot for each entity that can be removed, kept up by change | with `culling` |
//! | [`volume`] | the box that encloses it | with `culling` |
//! | `clip` | that box in clip space, and how far rounding may put it off | with `culling` |
//! | `groups` | boxes around what hangs together by `ChildOf` | with `culling` |
//!
//! Each frame, in [`CullSystems`]: the table follows the scene, then
//! [`ContributionCulling`](crate::contribution::ContributionCulling) takes out what covers too little, then
//! [`SphericalIndex`](crate::spherical::SphericalIndex) the parts of meshes that the camera cannot see, then
//! [`ZBufferOcclusion`](crate::occlusion::ZBufferOcclusion) what is hidden. All keep the order of `VisibleEntities`.

#[cfg(feature = "culling")]
pub(crate) mod bits;
#[cfg(feature = "culling")]
pub mod candidates;
#[cfg(feature = "culling")]
pub(crate) mod clip;
pub(crate) mod culled;
#[cfg(feature = "culling")]
pub(crate) mod groups;
pub(crate) mod part;
pub(crate) mod query;
#[cfg(feature = "culling")]
pub mod volume;

use bevy::{camera::visibility::VisibilitySystems, prelude::*};

pub use culled::{CullReason, CulledEntities};
pub use query::Culling;

/// Share of the picture from which on nothing is left out because a [`FrameBudget`](crate::budget::FrameBudget) demands
/// it, however much it costs and however little of it shows: a quarter of each side.
pub const NEVER_GOES: f32 = 1.0 / 16.0;

/// What takes entities out of cameras' visible entities; in `PostUpdate`, after Bevy's `CheckVisibility`. Whatever
/// reads `VisibleEntities` or [`CulledEntities`] runs after it.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CullSystems;

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

/// Registers what is always built, however often it is called.
pub(crate) fn register(app: &mut App) {
    app.register_type::<CulledEntities>().configure_sets(
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
    );
}
