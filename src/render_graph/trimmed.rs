//! Tells the main world which trimmed meshes of [`InteriorCulling`](crate::interior::InteriorCulling) have come to the
//! GPU: an entity that is given a mesh before is not drawn until then.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bevy::{
    platform::collections::HashSet,
    prelude::*,
    render::{
        Render, RenderApp, RenderSystems,
        mesh::RenderMesh,
        render_asset::{RenderAssets, prepare_assets},
    },
};

/// Shared by the main and the render world.
#[derive(Resource, Clone, Default)]
pub struct MeshUploads(Arc<Mutex<Uploads>>);

#[derive(Default)]
struct Uploads {
    /// Somebody answers.
    has_renderer: bool,
    asked: HashSet<AssetId<Mesh>>,
}

impl MeshUploads {
    fn lock(&self) -> MutexGuard<'_, Uploads> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Asks whether a mesh has come. `false`: nothing is drawn, so there is nothing to wait for.
    pub(crate) fn ask(&self, mesh: AssetId<Mesh>) -> bool {
        let mut uploads = self.lock();
        if uploads.has_renderer {
            uploads.asked.insert(mesh);
        }
        uploads.has_renderer
    }

    /// Keeps of these meshes those that have not come.
    pub(crate) fn retain_waiting(&self, meshes: &mut Vec<AssetId<Mesh>>) {
        let uploads = self.lock();
        meshes.retain(|mesh| uploads.asked.contains(mesh));
    }

    /// Nobody waits for anything any more.
    pub(crate) fn clear(&self) {
        self.lock().asked = HashSet::default();
    }
}

/// Adds [`note_uploads`] to the render app, if there is one.
pub(crate) fn add(app: &mut App, uploads: &MeshUploads) {
    if let Some(render_app) = app.get_sub_app_mut(RenderApp) {
        uploads.lock().has_renderer = true;
        render_app.insert_resource(uploads.clone()).add_systems(
            Render,
            note_uploads
                // What it looks for comes there.
                .after(prepare_assets::<RenderMesh>)
                .in_set(RenderSystems::PrepareAssets),
        );
    }
}

/// Strikes out what has come.
pub fn note_uploads(uploads: Res<MeshUploads>, meshes: Res<RenderAssets<RenderMesh>>) {
    let mut uploads = uploads.lock();
    if !uploads.asked.is_empty() {
        uploads.asked.retain(|mesh| meshes.get(*mesh).is_none());
    }
}
