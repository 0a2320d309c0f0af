//! Tells the main world which meshes that were made for [`InteriorCulling`](crate::interior::InteriorCulling) and
//! [`SphericalIndex`](crate::spherical::SphericalIndex) have come to the GPU: an entity that is given a mesh before is not
//! drawn until then.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bevy::{
    platform::collections::HashSet,
    prelude::*,
    render::{
        Render, RenderApp, RenderSystems,
        mesh::RenderMesh,
        render_asset::{RenderAssets, prepare_assets},
        renderer::RenderDevice,
    },
};

/// Shared by the main and the render world.
#[derive(Resource, Clone, Default)]
pub struct MeshUploads(Arc<Mutex<Uploads>>);

#[derive(Default)]
struct Uploads {
    /// Somebody answers.
    has_renderer: bool,
    /// By who asked.
    asked: [HashSet<AssetId<Mesh>>; 2],
}

/// Who asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Asker {
    Interior,
    Spherical,
}

impl MeshUploads {
    fn lock(&self) -> MutexGuard<'_, Uploads> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Asks whether a mesh has come. `false`: nothing is drawn, so there is nothing to wait for.
    pub(crate) fn ask(&self, asker: Asker, mesh: AssetId<Mesh>) -> bool {
        let mut uploads = self.lock();
        if uploads.has_renderer {
            uploads.asked[asker as usize].insert(mesh);
        }
        uploads.has_renderer
    }

    /// Keeps of these meshes those that have not come.
    pub(crate) fn retain_waiting(&self, meshes: &mut Vec<AssetId<Mesh>>) {
        let uploads = self.lock();
        meshes.retain(|mesh| uploads.asked.iter().any(|asked| asked.contains(mesh)));
    }

    /// One of them waits for nothing any more.
    pub(crate) fn clear(&self, asker: Asker) {
        self.lock().asked[asker as usize] = HashSet::default();
    }
}

/// Adds [`note_uploads`] to the render app, if there is one; once. Returns what is shared with it.
pub(crate) fn add(app: &mut App) -> MeshUploads {
    let uploads = app
        .world_mut()
        .get_resource_or_init::<MeshUploads>()
        .clone();
    if let Some(render_app) = app.get_sub_app_mut(RenderApp)
        && !core::mem::replace(&mut uploads.lock().has_renderer, true)
    {
        render_app.insert_resource(uploads.clone()).add_systems(
            Render,
            note_uploads
                // What it looks for comes there.
                .after(prepare_assets::<RenderMesh>)
                .in_set(RenderSystems::PrepareAssets)
                .run_if(is_asked),
        );
        app.add_systems(
            First,
            say_again.run_if(resource_exists_and_changed::<RenderDevice>),
        );
    }
    uploads
}

/// Tells a device that came for one that was lost what was said while there was none: Bevy extracts in these frames, too,
/// but keeps nothing of it. Meshes that are waited for would never come, and what was spawned or shown again, chunks and
/// what interior culling restored, would not be drawn.
fn say_again(
    uploads: Res<MeshUploads>,
    meshes: Option<ResMut<Assets<Mesh>>>,
    mut drawn: Query<&mut ViewVisibility, With<Mesh3d>>,
) {
    if let Some(mut meshes) = meshes {
        for mesh in uploads.lock().asked.iter().flatten() {
            if let Some(mesh) = meshes.get_mut(*mesh) {
                mesh.into_inner();
            }
        }
    }
    for mut visible in &mut drawn {
        visible.set_changed();
    }
}

/// Whether anybody waits.
fn is_asked(uploads: Res<MeshUploads>) -> bool {
    uploads.lock().asked.iter().any(|asked| !asked.is_empty())
}

/// Strikes out what has come.
pub fn note_uploads(uploads: Res<MeshUploads>, meshes: Res<RenderAssets<RenderMesh>>) {
    let mut uploads = uploads.lock();
    for asked in &mut uploads.asked {
        if !asked.is_empty() {
            asked.retain(|mesh| meshes.get(*mesh).is_none());
        }
    }
}
