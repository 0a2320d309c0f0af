//! Main-world side of interior culling: from a hierarchy of loaded meshes to hidden nodes and trimmed meshes, without
//! holding up a frame.
//!
//! | Step | Where | On the main thread |
//! |---|---|---|
//! | the model is looked through until all is loaded and still | `walk`, `node` | in slices |
//! | positions and indices are copied | `gather` | in slices |
//! | it is culled, and what of each mesh stays is worked out | `work` | – |
//! | trimmed meshes are made of what stays | `build`, `submesh` | in slices |
//! | nodes are hidden, trimmed meshes shown | `apply` | in slices |
//! | whatever could uncover something is noticed, and all restored | `watch`, `apply` | in the very frame |
//!
//! A slice is a millisecond a frame, all models together; one model at a time is copied and worked on. Nothing is read
//! out of a mesh in one go, as one of a million triangles takes longer than a frame to copy. What is done in one go, at
//! the end of a walk and of hiding, goes with the nodes and not with the triangles.
//!
//! Each model goes through the steps of `models::Step`:
//!
//! ```text
//!           ┌──────────────── something changed, in any step ────────────────┐
//!           ▼                                                                │
//!  ───► Still ──► Walk ──► Turn ──► Gather ──► Work ──► Build ──► Hide ──► Done
//!                 │  ▲       │                  │                  ▲
//!                 ▼  │       └──── found in the store, with trims ─┘
//!                 Load              Work fails ─► Failed
//!            Walk finds no mesh ─► Nothing
//! ```
//!
//! What is found is kept for models that are the same (`store`) while any model asks for interior culling, and trimmed
//! meshes while they are shown. With the last [`InteriorCulling`] nothing is held.

pub(crate) mod advance;
pub(crate) mod apply;
mod build;
pub mod models;
pub(crate) mod node;
pub(crate) mod report;
mod store;
mod walk;
pub(crate) mod watch;
mod work;

use bevy::{
    asset::AssetEventSystems,
    camera::visibility::VisibilitySystems,
    ecs::system::SystemParam,
    prelude::*,
    render::renderer::{RenderDevice, RenderQueue},
};

use crate::interior::{InteriorCulling, InteriorGpu};
use models::InteriorModels;

/// What follows the models and hides what is hidden in them; in `PostUpdate`. What moves parts or changes meshes comes
/// before it, or is a frame late.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct InteriorSystems;

/// What models are made of.
#[derive(SystemParam)]
pub struct Assetry<'w> {
    meshes: Option<Res<'w, Assets<Mesh>>>,
    materials: Option<Res<'w, Assets<StandardMaterial>>>,
}

impl Assetry<'_> {
    /// Why nothing can be culled in this app.
    pub fn missing(&self) -> Option<&'static str> {
        if self.meshes.is_none() {
            Some("the app has no meshes: add Bevy's MeshPlugin")
        } else if self.materials.is_none() {
            Some(
                "the app has no StandardMaterial to tell walls from windows by: add Bevy's PbrPlugin",
            )
        } else {
            None
        }
    }
}

/// Whether there is anything to do: nothing below is run, looked at or held otherwise.
fn is_asked_for(
    roots: Query<(), With<InteriorCulling>>,
    models: Res<InteriorModels>,
    assets: Assetry,
) -> bool {
    (!roots.is_empty() || !models.is_empty()) && assets.missing().is_none()
}

pub(crate) fn register(app: &mut App) {
    app.init_resource::<InteriorModels>()
        .configure_sets(PostUpdate, InteriorSystems.run_if(is_asked_for))
        .add_systems(
            PostUpdate,
            (
                follow_device,
                watch::follow_models,
                watch::watch_parts,
                apply::restore_parts,
                advance::advance_models,
                apply::hide_parts,
            )
                // What one finds out the next answers. Components that one inserts the others need only later.
                .chain_ignore_deferred()
                .in_set(InteriorSystems)
                // Animation and physics have moved what they move.
                .after(TransformSystems::Propagate)
                // Edits are heard of in the frame in which the renderer hears of them.
                .after(AssetEventSystems)
                // What is restored or trimmed has its bounds and its visibility in this frame.
                .before(VisibilitySystems::CalculateBounds)
                .before(VisibilitySystems::VisibilityPropagate),
        )
        .add_systems(
            PostUpdate,
            apply::keep_hidden
                .run_if(is_asked_for)
                // It has the last word on what is hidden.
                .after(VisibilitySystems::VisibilityPropagate)
                // Which asks it.
                .before(VisibilitySystems::CheckVisibility),
        );
}

/// The render world's side, once it is there.
pub(crate) fn finish(app: &mut App) {
    let world = app.world();
    let device = world.get_resource::<RenderDevice>();
    let gpu = device.zip(world.get_resource::<RenderQueue>());
    let gpu = gpu.map(|(device, queue)| app_gpu(device, queue));
    let Some(mut models) = app.world_mut().get_resource_mut::<InteriorModels>() else {
        return;
    };
    models.gpu = gpu;
    let uploads = crate::render_graph::mesh_uploads::add(app);
    if let Some(mut models) = app.world_mut().get_resource_mut::<InteriorModels>() {
        models.uploads = uploads;
    }
}

/// Takes the device that came for one that was lost. What is being made on that one is made on the CPU.
fn follow_device(
    device: Option<Res<RenderDevice>>,
    queue: Option<Res<RenderQueue>>,
    mut models: ResMut<InteriorModels>,
) {
    if let (Some(device), Some(queue)) = (device, queue)
        && device.is_changed()
    {
        let lost = models.gpu.replace(app_gpu(&device, &queue));
        if let Some(lost) = lost {
            lost.give_up();
        }
    }
}

/// Handles to what the app draws with: they hold nothing of their own.
fn app_gpu(device: &RenderDevice, queue: &RenderQueue) -> InteriorGpu {
    let queue: &wgpu::Queue = queue;
    InteriorGpu::new(device.wgpu_device().clone(), queue.clone())
}
