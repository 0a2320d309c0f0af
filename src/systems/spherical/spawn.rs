//! Spawns the chunks of the entities whose mesh is indexed, and lets them look as their entity does.

use bevy::{
    camera::visibility::RenderLayers,
    light::{NotShadowCaster, NotShadowReceiver, TransmittedShadowReceiver},
    mesh::MeshTag,
    pbr::{
        Lightmap,
        wireframe::{NoWireframe, Wireframe},
    },
    prelude::*,
    render::batching::NoAutomaticBatching,
};

pub use crate::culling::part::ChunkOf;

use super::models::{Key, SphericalModels, Step};
use crate::spherical::SphericalIndex;
#[cfg(feature = "culling")]
use crate::{contribution::NoContributionCulling, occlusion::NoOcclusionCulling};

/// What cullings are told of a chunk: its entity's area counts.
#[cfg(feature = "culling")]
type Told = NoContributionCulling;
/// There is none to be told.
#[cfg(not(feature = "culling"))]
type Told = ();

/// So many are spawned in a frame.
const BATCH: usize = 512;

/// Gives chunks what their entity has of a component, or takes it from them.
type Paint = fn(&mut World, Entity, &[Entity]);

/// What chunks have of their entity.
#[derive(Resource, Default)]
pub(crate) struct Paints(Vec<Paint>);

/// Chunks have this component whenever their entity has it.
pub(crate) fn paint_with<C: Component + Clone>(app: &mut App) {
    app.init_resource::<Paints>();
    let paint: Paint = paint::<C>;
    let mut paints = app.world_mut().resource_mut::<Paints>();
    paints.0.push(paint);
    app.add_systems(
        PostUpdate,
        follow_paint::<C>
            .run_if(super::is_asked_for)
            .in_set(super::SphericalSteps::Follow),
    );
}

/// Everything that changes how a mesh is drawn and is not a material.
pub(crate) fn paint_with_bevys(app: &mut App) {
    paint_with::<RenderLayers>(app);
    paint_with::<NotShadowReceiver>(app);
    paint_with::<TransmittedShadowReceiver>(app);
    paint_with::<Lightmap>(app);
    paint_with::<MeshTag>(app);
    paint_with::<NoAutomaticBatching>(app);
    paint_with::<Wireframe>(app);
    paint_with::<NoWireframe>(app);
    #[cfg(feature = "culling")]
    paint_with::<NoOcclusionCulling>(app);
}

fn paint<C: Component + Clone>(world: &mut World, root: Entity, chunks: &[Entity]) {
    let value = world.get::<C>(root).cloned();
    for chunk in chunks {
        let Ok(mut chunk) = world.get_entity_mut(*chunk) else {
            continue;
        };
        match &value {
            Some(value) => {
                chunk.insert(value.clone());
            }
            None => {
                chunk.remove::<C>();
            }
        }
    }
}

fn follow_paint<C: Component>(
    mut models: ResMut<SphericalModels>,
    changed: Query<Entity, (With<SphericalIndex>, Changed<C>)>,
    mut removed: RemovedComponents<C>,
) {
    for entity in changed.iter().chain(removed.read()) {
        if let Some(root) = models.roots.get_mut(&entity) {
            root.is_repainted = true;
        }
    }
}

/// Spawns chunks, some of them a frame, and paints them.
pub fn spawn_chunks(mut models: ResMut<SphericalModels>, mut commands: Commands) {
    let models = &mut *models;
    let mut left = BATCH;
    let mut is_new = false;
    for (entity, root) in &mut models.roots {
        if !root.is_left_for_good() && root.indexed.is_none() {
            let key = Key::of(root.mesh, &root.settings);
            let made = models.indices.iter().find(|(of, _)| *of == key);
            if let Some((_, Step::Ready(indexed))) = made {
                root.indexed = Some(indexed.clone());
                root.is_repainted = true;
            }
        }
        let Some(indexed) = &root.indexed else {
            continue;
        };
        while root.chunks.len() < indexed.meshes.len() && left > 0 {
            let chunk = commands.spawn((
                Mesh3d(indexed.meshes[root.chunks.len()].clone()),
                ChunkOf { root: *entity },
                ChildOf(*entity),
                Transform::IDENTITY,
                // The whole mesh casts them.
                NotShadowCaster,
                Told::default(),
            ));
            root.chunks.push(chunk.id());
            left -= 1;
            is_new = true;
        }
        if root.is_repainted && root.chunks.len() == indexed.meshes.len() {
            root.is_repainted = false;
            let (entity, chunks) = (*entity, root.chunks.clone());
            commands.queue(move |world: &mut World| {
                let paints: Vec<Paint> = world
                    .get_resource::<Paints>()
                    .map_or(Vec::new(), |paints| paints.0.clone());
                for paint in paints {
                    paint(world, entity, &chunks);
                }
            });
        }
    }
    if is_new {
        models.tabulate();
    }
}
