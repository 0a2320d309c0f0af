//! Takes entities up that ask for a spherical index, looks at them when something of them changes, and lets them go.

use core::any::TypeId;

use bevy::{
    camera::visibility::VisibilityRange,
    ecs::{query::QueryData, system::SystemParam},
    mesh::{PrimitiveTopology, morph::MeshMorphWeights, skinning::SkinnedMesh},
    prelude::*,
    render::render_resource::Face,
};

use super::models::{Key, Left, Look, Root, SphericalModels, Step};
use super::spawn::ChunkOf;
use crate::{
    spherical::{SphericalCounts, SphericalIndex},
    systems::gather::{Gather, Unreadable, readable},
};

/// How long a mesh that was edited is left alone before it is indexed again.
const QUIET_FRAMES: u32 = 8;

/// What is looked at of each entity.
#[derive(QueryData)]
pub struct RootQuery {
    entity: Entity,
    settings: &'static SphericalIndex,
    mesh: Option<&'static Mesh3d>,
    is_skinned: Has<SkinnedMesh>,
    is_morphing: Has<MeshMorphWeights>,
    has_range: Has<VisibilityRange>,
}

type Changes = (
    With<SphericalIndex>,
    Or<(
        Changed<SphericalIndex>,
        Changed<Mesh3d>,
        Added<SkinnedMesh>,
        Added<MeshMorphWeights>,
        Added<VisibilityRange>,
    )>,
);

/// What entities have lost.
#[derive(SystemParam)]
pub struct Losses<'w, 's> {
    settings: RemovedComponents<'w, 's, SphericalIndex>,
    meshes: RemovedComponents<'w, 's, Mesh3d>,
    skins: RemovedComponents<'w, 's, SkinnedMesh>,
    morphs: RemovedComponents<'w, 's, MeshMorphWeights>,
    ranges: RemovedComponents<'w, 's, VisibilityRange>,
}

/// What happens to chunks that is not our doing.
#[derive(SystemParam)]
pub struct Chunks<'w, 's> {
    new: Query<'w, 's, Entity, Added<ChunkOf>>,
    gone: RemovedComponents<'w, 's, ChunkOf>,
    detached: RemovedComponents<'w, 's, ChildOf>,
}

impl Losses<'_, '_> {
    fn read(&mut self) -> impl Iterator<Item = Entity> + '_ {
        let first = self.settings.read().chain(self.meshes.read());
        let first = first.chain(self.skins.read()).chain(self.morphs.read());
        first.chain(self.ranges.read())
    }
}

/// See the [module](self).
#[expect(clippy::too_many_arguments, reason = "each is a kind of change")]
pub fn follow_indexed(
    mut models: ResMut<SphericalModels>,
    roots: Query<RootQuery>,
    changed: Query<Entity, Changes>,
    mut losses: Losses,
    mut chunks: Chunks,
    meshes: Res<Assets<Mesh>>,
    mut mesh_events: MessageReader<AssetEvent<Mesh>>,
    mut commands: Commands,
) {
    let models = &mut *models;
    let mut edited = Vec::new();
    for event in mesh_events.read() {
        let (id, is_another) = match *event {
            AssetEvent::Added { id } => (id, false),
            AssetEvent::Modified { id } | AssetEvent::Removed { id } => (id, true),
            AssetEvent::Unused { .. } | AssetEvent::LoadedWithDependencies { .. } => continue,
        };
        if is_another {
            edited.push(id);
            models.indices.retain(|(key, _)| key.mesh != id);
        }
        for root in models.roots.values_mut().filter(|root| root.mesh == id) {
            root.is_stale = true;
            root.is_reset |= is_another;
        }
    }
    for entity in changed.iter().chain(losses.read()) {
        if let Some(root) = models.roots.get_mut(&entity) {
            root.is_stale = true;
        } else if let Ok(item) = roots.get(entity) {
            models.roots.insert(entity, Root::new(*item.settings));
        }
    }
    let Chunks {
        new,
        gone,
        detached,
    } = &mut chunks;
    for entity in gone.read().chain(detached.read()) {
        // All of them are spawned anew.
        if let Some(root) = models.root_of(entity) {
            root.is_stale = true;
            root.is_reset = true;
        }
    }
    for entity in new.iter() {
        // A clone of one: a clone of its entity will have its own.
        if models.root_of(entity).is_none() {
            commands.entity(entity).try_despawn();
        }
    }
    let mut is_changed = false;
    models.roots.retain(|entity, root| {
        if !root.is_stale {
            return true;
        }
        is_changed = true;
        root.is_stale = false;
        let Ok(item) = roots.get(*entity) else {
            root.release(&mut commands);
            if let Ok(mut entity) = commands.get_entity(*entity) {
                entity.try_remove::<SphericalCounts>();
            }
            return false;
        };
        let before = (root.mesh, root.settings);
        root.settings = *item.settings;
        root.mesh = item.mesh.map_or_else(AssetId::default, |mesh| mesh.id());
        root.left = judge(&item, root, &meshes);
        let (key, old) = (
            Key::of(root.mesh, &root.settings),
            Key::of(before.0, &before.1),
        );
        if core::mem::take(&mut root.is_reset) || key != old || root.is_left_for_good() {
            root.release(&mut commands);
        }
        root.is_loading = root.left.is_none() && !meshes.contains(root.mesh);
        if root.left.is_none() && !root.is_loading {
            match models.indices.iter().find(|(of, _)| *of == key) {
                Some((_, Step::Failed(_))) => root.left = Some(Left::Failed),
                Some(_) => {}
                None => {
                    // What is edited in every frame would have a thread begin in each.
                    let first = if edited.contains(&root.mesh) {
                        Step::Still(QUIET_FRAMES)
                    } else {
                        Step::Gather(Gather::default())
                    };
                    models.indices.push((key, first));
                }
            }
        }
        true
    });
    if is_changed {
        models.sweep();
        models.tabulate();
    }
}

impl Root {
    /// Its chunks go: it is drawn whole.
    fn release(&mut self, commands: &mut Commands) {
        self.indexed = None;
        for chunk in self.chunks.drain(..) {
            // It may have gone with its entity.
            if let Ok(mut chunk) = commands.get_entity(chunk) {
                chunk.try_despawn();
            }
        }
    }
}

fn judge(item: &RootQueryItem, root: &Root, meshes: &Assets<Mesh>) -> Option<Left> {
    if item.is_skinned || item.is_morphing {
        return Some(Left::Deforms);
    }
    if item.has_range {
        return Some(Left::Ranged);
    }
    match root.look {
        None => return Some(Left::OtherMaterial),
        Some(look) if look.is_sorted => return Some(Left::Sorted),
        Some(_) => {}
    }
    if item.mesh.is_none() {
        return Some(Left::NotTriangles);
    }
    indexable(meshes.get(root.mesh)?, root.settings.chunk_triangles).err()
}

/// Whether a mesh's triangles can be read, and are more than one chunk has.
fn indexable(mesh: &Mesh, chunk_triangles: u32) -> Result<(), Left> {
    let positions = readable(mesh)?;
    if mesh.primitive_topology() != PrimitiveTopology::TriangleList {
        return Err(Left::NotTriangles);
    }
    let indices = mesh
        .try_indices_option()
        .map_err(|_| Left::RenderWorldOnly)?;
    let corners = indices.map_or(positions.len(), |indices| indices.len());
    if corners / 3 <= chunk_triangles.max(1) as usize {
        return Err(Left::Small);
    }
    Ok(())
}

impl From<Unreadable> for Left {
    fn from(why: Unreadable) -> Self {
        match why {
            Unreadable::RenderWorldOnly => Self::RenderWorldOnly,
            Unreadable::Morphs => Self::Deforms,
            Unreadable::NotTriangles => Self::NotTriangles,
        }
    }
}

/// Which side of a material of a kind is not drawn.
#[derive(Resource)]
pub(crate) struct Announced<M: Material>(pub fn(&M) -> Option<Face>);

type Repainted<M> = (
    With<SphericalIndex>,
    Or<(Changed<MeshMaterial3d<M>>, Added<SphericalIndex>)>,
);

/// Keeps how the entities with materials of a kind are drawn.
pub(crate) fn follow_material<M: Material>(
    mut models: ResMut<SphericalModels>,
    announced: Res<Announced<M>>,
    materials: Option<Res<Assets<M>>>,
    mut events: MessageReader<AssetEvent<M>>,
    roots: Query<(Entity, &MeshMaterial3d<M>, Ref<SphericalIndex>)>,
    changed: Query<(Entity, &MeshMaterial3d<M>), Repainted<M>>,
    mut removed: RemovedComponents<MeshMaterial3d<M>>,
) {
    let Some(materials) = materials else {
        return;
    };
    let models = &mut *models;
    for entity in removed.read() {
        if let Some(root) = models.roots.get_mut(&entity)
            && root.look_of == Some(TypeId::of::<M>())
            && roots.get(entity).is_err()
        {
            root.see(None);
            root.look_of = None;
        }
    }
    let look = |id: AssetId<M>| {
        materials.get(id).map(|material| Look {
            cull: announced.0(material),
            is_sorted: !matches!(
                material.alpha_mode(),
                AlphaMode::Opaque | AlphaMode::Mask(_) | AlphaMode::AlphaToCoverage
            ) || material.reads_view_transmission_texture(),
        })
    };
    let mut touched = false;
    for event in events.read() {
        touched |= matches!(
            event,
            AssetEvent::Added { .. } | AssetEvent::Modified { .. } | AssetEvent::Removed { .. }
        );
    }
    let mut see = |entity: Entity, id: AssetId<M>, settings: Option<SphericalIndex>| {
        let root = match (models.roots.get_mut(&entity), settings) {
            (Some(root), _) => root,
            (None, Some(settings)) => models.roots.entry(entity).or_insert(Root::new(settings)),
            (None, None) => return,
        };
        let now = look(id);
        root.look_of = Some(TypeId::of::<M>());
        if root.look != now {
            root.see(now);
        }
    };
    for (entity, material) in &changed {
        let settings = roots.get(entity).ok().map(|(_, _, settings)| *settings);
        see(entity, material.id(), settings);
    }
    if touched {
        for (entity, material, _) in &roots {
            see(entity, material.id(), None);
        }
    }
}

impl Root {
    fn see(&mut self, look: Option<Look>) {
        self.look = look;
        self.is_stale = true;
    }
}
