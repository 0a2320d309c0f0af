//! What nobody sees, and why: for a game that wants to skip animating or simulating it.

use core::any::TypeId;

use bevy::{
    camera::visibility::{RenderLayers, VisibleEntities},
    ecs::system::SystemParam,
    prelude::*,
};

use super::{
    culled::{CullReason, CulledEntities},
    part::{ChunkOf, PartOf},
};

/// Which meshes are seen by which camera, and why the others are not. Ask in systems that run after
/// [`CullSystems`](super::CullSystems), or anywhere for the answer of the frame before.
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_skyline::prelude::*;
/// # #[derive(Component)] struct Pedestrian;
/// fn walk(culling: Culling, mut people: Query<(Entity, &mut Transform), With<Pedestrian>>) {
///     for (person, mut place) in &mut people {
///         if culling.is_seen(person) {
///             place.translation.x += 0.1;
///         }
///     }
/// }
/// ```
#[derive(SystemParam)]
pub struct Culling<'w, 's> {
    cameras: Query<
        'w,
        's,
        (
            &'static Camera,
            &'static VisibleEntities,
            Option<&'static CulledEntities>,
            Option<&'static RenderLayers>,
        ),
    >,
    entities: Query<'w, 's, Seen>,
    chunks: Query<'w, 's, (), With<ChunkOf>>,
    children: Query<'w, 's, &'static Children>,
}

/// What is looked at of each mesh.
type Seen = (
    Option<&'static InheritedVisibility>,
    Option<&'static RenderLayers>,
    Option<&'static PartOf>,
    Has<ChunkOf>,
);

impl Culling<'_, '_> {
    /// Whether an active camera has a mesh among its visible entities, or any of the chunks that are drawn in its place.
    pub fn is_seen(&self, mesh: Entity) -> bool {
        self.cameras.iter().any(|(camera, visible, culled, _)| {
            camera.is_active
                && self.is_visible(visible, mesh)
                // What the GPU leaves out stays in the list.
                && culled.is_none_or(|culled| culled.reason(mesh).is_none())
        })
    }

    /// Why a camera does not see a mesh; `None` if it does, if it is no camera, or if the entity is gone.
    pub fn reason(&self, camera: Entity, mesh: Entity) -> Option<CullReason> {
        let (_, visible, culled, layers) = self.cameras.get(camera).ok()?;
        let (inherited, own_layers, part, is_chunk) = self.entities.get(mesh).ok()?;
        if let Some(reason) = culled.and_then(|culled| culled.reason(mesh)) {
            return Some(reason);
        }
        if self.is_visible(visible, mesh) {
            return None;
        }
        if is_chunk {
            return Some(CullReason::Chunk);
        }
        let children = self.children.get(mesh).into_iter().flatten();
        let of_chunks = children.filter(|child| self.chunks.contains(**child));
        if let Some(reason) =
            culled.and_then(|culled| of_chunks.filter_map(|c| culled.reason(*c)).next())
        {
            return Some(reason);
        }
        if part.is_some_and(PartOf::is_hidden) {
            return Some(CullReason::Interior);
        }
        if inherited.is_none_or(|inherited| !inherited.get()) {
            return Some(CullReason::Hidden);
        }
        let [layers, own_layers] = [layers, own_layers].map(|l| l.cloned().unwrap_or_default());
        Some(if layers.intersects(&own_layers) {
            CullReason::Frustum
        } else {
            CullReason::Layers
        })
    }

    fn is_visible(&self, visible: &VisibleEntities, mesh: Entity) -> bool {
        is_listed(visible, mesh)
            || self.children.get(mesh).is_ok_and(|children| {
                let mut children = children.iter();
                children.any(|child| self.chunks.contains(child) && is_listed(visible, child))
            })
    }
}

/// Bevy keeps its lists sorted.
fn is_listed(visible: &VisibleEntities, mesh: Entity) -> bool {
    visible
        .get(TypeId::of::<Mesh3d>())
        .binary_search(&mesh)
        .is_ok()
}
