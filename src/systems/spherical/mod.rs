//! Main-world side of the spherical index: from a mesh to its chunks, and each frame to those that a camera can see.
//!
//! | Step | Where | On the main thread |
//! |---|---|---|
//! | entities that ask for it are taken up, looked at when something of them changes, and let go | `follow` | by change |
//! | positions and indices are copied | `gather` | in slices |
//! | maps and chunks are made | `work` | – |
//! | chunks' meshes are made | `submesh` | in slices |
//! | chunks are spawned, and look as their entity does | [`spawn`] | by change |
//! | of each camera's visible entities, what it cannot see is removed | `select` | every frame |
//!
//! A mesh is indexed once for all entities that have it. With the last [`SphericalIndex`] nothing is held.

pub(crate) mod follow;
pub mod models;
pub(crate) mod report;
mod select;
pub mod spawn;
mod work;

use bevy::{asset::AssetEventSystems, camera::visibility::VisibilitySystems, prelude::*};

use crate::{culling::CullSteps, spherical::SphericalIndex};
use models::SphericalModels;

/// What follows entities with a [`SphericalIndex`] and makes their chunks; in `PostUpdate`. What changes meshes and
/// materials comes before it, or is a frame late.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SphericalSteps {
    /// What changed is noticed.
    Follow,
    /// Indices are made, chunks spawned.
    Make,
}

/// Whether there is anything to do: nothing of it is run, looked at or held otherwise.
pub(crate) fn is_asked_for(
    roots: Query<(), With<SphericalIndex>>,
    models: Res<SphericalModels>,
    meshes: Option<Res<Assets<Mesh>>>,
) -> bool {
    meshes.is_some() && (!roots.is_empty() || !models.is_empty())
}

/// The render world's side, once it is there.
pub(crate) fn finish(app: &mut App) {
    let uploads = crate::render_graph::mesh_uploads::add(app);
    if let Some(mut models) = app.world_mut().get_resource_mut::<SphericalModels>() {
        models.uploads = uploads;
    }
}

pub(crate) fn register(app: &mut App) {
    app.init_resource::<SphericalModels>()
        .configure_sets(
            PostUpdate,
            (SphericalSteps::Follow, SphericalSteps::Make)
                .chain()
                .run_if(is_asked_for)
                // Edits are heard of in the frame in which the renderer hears of them.
                .after(AssetEventSystems)
                // Chunks have their bounds, places and visibility in the frame in which they are spawned.
                .before(TransformSystems::Propagate)
                .before(VisibilitySystems::CalculateBounds)
                .before(VisibilitySystems::VisibilityPropagate),
        )
        .add_systems(
            PostUpdate,
            (
                follow::follow_indexed.in_set(SphericalSteps::Follow),
                (models::advance_indices, spawn::spawn_chunks)
                    .chain()
                    .in_set(SphericalSteps::Make),
                select::select_chunks
                    .run_if(is_asked_for)
                    .in_set(CullSteps::Selection),
            ),
        );
}
