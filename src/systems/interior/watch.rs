//! Notices what changes in the models, so that nothing that could uncover something stays unanswered for a frame.

use bevy::{
    camera::visibility::{RenderLayers, VisibilityRange},
    ecs::{
        entity::EntityIndexMap, lifecycle::RemovedComponents, query::QueryData, system::SystemParam,
    },
    mesh::{morph::MeshMorphWeights, skinning::SkinnedMesh},
    prelude::*,
};

use super::{
    models::{InteriorModels, Job, PartOf, Step},
    node::{Judge, Kind, Look, NodeQuery, NodeQueryItem},
};
use crate::interior::{InteriorCulling, NoInteriorCulling};

/// What is looked at of each root.
#[derive(QueryData)]
pub struct RootQuery {
    root: Entity,
    settings: Ref<'static, InteriorCulling>,
    place: Option<Ref<'static, GlobalTransform>>,
    layers: Option<&'static RenderLayers>,
}

/// What is looked at of what is above.
#[derive(QueryData)]
pub struct AboveQuery {
    child_of: Option<&'static ChildOf>,
    part: Option<&'static PartOf>,
    visibility: Option<&'static Visibility>,
}

/// Whether a root is shown in this frame; its `InheritedVisibility` is still of the last.
pub(super) fn is_shown(root: Entity, above: &Query<AboveQuery>) -> bool {
    let mut entity = root;
    while let Ok(item) = above.get(entity) {
        match (item.visibility, item.child_of) {
            (Some(Visibility::Hidden), _) => return false,
            (Some(Visibility::Inherited), Some(child_of)) => entity = child_of.parent(),
            _ => break,
        }
    }
    true
}

/// Takes up the models that begin to ask for it or ask for something else, and lets go of those that don't any more.
pub fn follow_models(
    mut models: ResMut<InteriorModels>,
    roots: Query<RootQuery>,
    mut removed: RemovedComponents<InteriorCulling>,
    above: Query<AboveQuery>,
    mut commands: Commands,
) {
    let models = &mut *models;
    models.frame = models.frame.wrapping_add(1);
    for root in removed.read() {
        // Given back in the same frame, it is another one.
        if let Some(job) = models.jobs.shift_remove(&root) {
            models.leaving.push(job);
            disturb_above(root, models, &above);
        }
    }
    for RootQueryItem {
        root,
        settings,
        place,
        layers,
    } in &roots
    {
        let Some(job) = models.jobs.get_mut(&root) else {
            let mut job = Job::new(root, (*settings).clone(), models.frame);
            job.is_mirrored = place.is_some_and(|place| is_mirrored(&place));
            job.layers = layers.cloned().unwrap_or_default();
            models.jobs.insert(root, job);
            commands.entity(root).try_insert(PartOf {
                root,
                is_hidden: false,
            });
            disturb_above(root, models, &above);
            continue;
        };
        if settings.is_changed() && *settings != job.settings {
            job.settings = (*settings).clone();
            job.is_disturbed = true;
            job.is_anew = true;
        }
        if let Some(place) = place
            && place.is_changed()
            && is_mirrored(&place) != job.is_mirrored
        {
            job.is_mirrored = !job.is_mirrored;
            job.is_disturbed = true;
        }
        let layers = layers.cloned().unwrap_or_default();
        if layers != job.layers {
            job.layers = layers;
            job.is_disturbed = true;
        }
        if let Some(was_shown) = &mut job.depends_on_root {
            let is_shown = is_shown(root, &above);
            job.is_disturbed |= core::mem::replace(was_shown, is_shown) != is_shown;
        }
    }
}

/// A model inside another's hierarchy came or went.
fn disturb_above(root: Entity, models: &mut InteriorModels, above: &Query<AboveQuery>) {
    let mut entity = root;
    while let Ok(item) = above.get(entity) {
        if let Some(part) = item.part.filter(|part| part.root != root) {
            if let Some(job) = models.job_of(part) {
                job.is_disturbed = true;
            }
            break;
        }
        let Some(child_of) = item.child_of else {
            break;
        };
        entity = child_of.parent();
    }
}

fn is_mirrored(place: &GlobalTransform) -> bool {
    place.affine().matrix3.determinant() < 0.0
}

type Changes = (
    With<PartOf>,
    Or<(
        Changed<Transform>,
        Changed<Visibility>,
        Changed<Children>,
        Changed<ChildOf>,
        Changed<Mesh3d>,
        Changed<MeshMaterial3d<StandardMaterial>>,
        Changed<RenderLayers>,
        Added<VisibilityRange>,
        Added<SkinnedMesh>,
        Added<MeshMorphWeights>,
        Added<NoInteriorCulling>,
    )>,
);

/// What entities have lost.
#[derive(SystemParam)]
pub struct Losses<'w, 's> {
    meshes: RemovedComponents<'w, 's, Mesh3d>,
    materials: RemovedComponents<'w, 's, MeshMaterial3d<StandardMaterial>>,
    above: RemovedComponents<'w, 's, ChildOf>,
    layers: RemovedComponents<'w, 's, RenderLayers>,
    ranges: RemovedComponents<'w, 's, VisibilityRange>,
    skins: RemovedComponents<'w, 's, SkinnedMesh>,
    morphs: RemovedComponents<'w, 's, MeshMorphWeights>,
    opt_outs: RemovedComponents<'w, 's, NoInteriorCulling>,
}

impl Losses<'_, '_> {
    fn read(&mut self) -> impl Iterator<Item = Entity> + '_ {
        let plain = self.meshes.read().chain(self.materials.read());
        let plain = plain.chain(self.above.read()).chain(self.layers.read());
        let plain = plain.chain(self.ranges.read()).chain(self.skins.read());
        plain.chain(self.morphs.read()).chain(self.opt_outs.read())
    }
}

/// Meshes and materials, and what has happened to them.
#[derive(SystemParam)]
pub struct Library<'w, 's> {
    meshes: Res<'w, Assets<Mesh>>,
    materials: Res<'w, Assets<StandardMaterial>>,
    mesh_events: MessageReader<'w, 's, AssetEvent<Mesh>>,
    material_events: MessageReader<'w, 's, AssetEvent<StandardMaterial>>,
}

/// Marks the models in which something has changed that matters: the place of a part or whether it is shown, what it is
/// made of, which parts there are. Asks only what Bevy says was touched; what was touched and is as it was is no change.
pub fn watch_parts(
    mut models: ResMut<InteriorModels>,
    changed: Query<NodeQuery, Changes>,
    nodes: Query<NodeQuery>,
    mut losses: Losses,
    mut library: Library,
    mut commands: Commands,
) {
    let models = &mut *models;
    let Library {
        meshes,
        materials,
        mesh_events,
        material_events,
    } = &mut library;
    for event in mesh_events.read() {
        match *event {
            AssetEvent::Added { id } => loaded(models, |load| load.meshes.remove(&id)),
            AssetEvent::Modified { id } | AssetEvent::Removed { id } => {
                models.store.forget(id);
                let jobs = models.jobs.values_mut();
                for job in jobs.filter(|job| job.mesh_index.contains_key(&id)) {
                    job.is_disturbed = true;
                }
            }
            AssetEvent::Unused { .. } | AssetEvent::LoadedWithDependencies { .. } => {}
        }
    }
    for event in material_events.read() {
        match *event {
            AssetEvent::Added { id } => loaded(models, |load| load.materials.remove(&id)),
            AssetEvent::Modified { id } | AssetEvent::Removed { id } => {
                let now = materials.get(id).map(Look::of);
                for job in models.jobs.values_mut() {
                    let was = job.materials.get(&id).copied();
                    job.is_disturbed |= was.is_some() && was != now;
                }
            }
            AssetEvent::Unused { .. } | AssetEvent::LoadedWithDependencies { .. } => {}
        }
    }
    let mut look_at = |jobs: &mut EntityIndexMap<Job>, item: &NodeQueryItem| {
        if let Some(job) = item.part.and_then(|part| jobs.get_mut(&part.root))
            && !job.is_disturbed
        {
            job.is_disturbed = matters(job, item, &nodes, meshes, materials, &mut commands);
        }
    };
    for item in &changed {
        look_at(&mut models.jobs, &item);
    }
    for entity in losses.read() {
        if let Ok(item) = nodes.get(entity) {
            look_at(&mut models.jobs, &item);
            continue;
        }
        // It is no more, and may have been a wall.
        for job in models.jobs.values_mut() {
            let was = job.node(entity);
            job.is_disturbed |= was.is_some_and(|node| node.carries);
        }
    }
    for job in models.jobs.values_mut().filter(|job| job.is_disturbed) {
        job.begin_again(models.frame);
    }
}

fn loaded(models: &mut InteriorModels, mut strike: impl FnMut(&mut super::models::Load) -> bool) {
    for job in models.jobs.values_mut() {
        if let Step::Load(load) = &mut job.step {
            strike(load);
        }
    }
}

/// Whether an entity of a model is another than it was when it was looked at.
fn matters(
    job: &mut Job,
    item: &NodeQueryItem,
    nodes: &Query<NodeQuery>,
    meshes: &Assets<Mesh>,
    materials: &Assets<StandardMaterial>,
    commands: &mut Commands,
) -> bool {
    let is_root = item.entity == job.root;
    if let Some(children) = item
        .children
        .as_ref()
        .filter(|children| children.is_changed())
        && !(item.is_out || item.is_root && !is_root)
    {
        for child in children.iter() {
            // Whatever is below a hidden node is dark, a lamp too.
            let is_hidden = item.part.is_some_and(PartOf::is_hidden);
            if has_come(job, child, is_hidden, nodes, commands) {
                return true;
            }
        }
    }
    let Some(node) = job.node(item.entity) else {
        // It came later, without a mesh; or it is still to be come to.
        return item.mesh.is_some() && !matches!(job.step, Step::Walk(_));
    };
    let is_closed = item.is_out || item.is_root && !is_root;
    let kind = if is_closed {
        Kind::Left(super::node::Left::OptedOut)
    } else {
        let mesh = item.mesh.map(|mesh| job.original_of(node, mesh.id()));
        let judge = Judge {
            settings: &job.settings,
            layers: &job.layers,
            meshes,
            materials,
        };
        judge.kind(item, mesh, node.is_mirrored)
    };
    if kind != node.kind {
        // What was loading is not another because it has come.
        return !matches!(
            (node.kind, kind),
            (Kind::Pending(was, _), Kind::Surface { mesh, .. } | Kind::Pending(mesh, _)) if was == mesh
        );
    }
    if !node.carries || is_root {
        return false;
    }
    let above = node.above.and_then(|above| job.nodes.get(above as usize));
    item.place.copied().unwrap_or_default() != node.place
        || item.visibility.copied().unwrap_or(Visibility::Visible) != node.visibility
        || item.above.map(ChildOf::parent) != above.map(|above| above.entity)
}

/// Whether something with a mesh has come below, or below what is hidden anything; what has none is listened to from now
/// on.
fn has_come(
    job: &mut Job,
    entity: Entity,
    is_hidden: bool,
    nodes: &Query<NodeQuery>,
    commands: &mut Commands,
) -> bool {
    let mut open = vec![entity];
    while let Some(entity) = open.pop() {
        let Ok(item) = nodes.get(entity) else {
            continue;
        };
        let is_known = item.part.is_some_and(|part| part.root == job.root);
        if is_known || item.is_root || item.is_chunk {
            continue;
        }
        if item.mesh.is_some() || is_hidden {
            return true;
        }
        if job.extra.len() == job.extra.capacity() {
            // Those that are gone make room.
            job.extra.retain(|entity| nodes.contains(*entity));
        }
        job.extra.push(entity);
        commands.entity(entity).try_insert(PartOf {
            root: job.root,
            is_hidden: false,
        });
        open.extend(item.children.iter().flat_map(|children| children.iter()));
    }
    false
}
