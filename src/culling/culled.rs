//! Which entities a camera removed, and why.

use bevy::prelude::*;

/// Why an entity is not among a camera's visible entities.
#[derive(Reflect, Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[reflect(Clone, Debug, PartialEq, Hash)]
#[non_exhaustive]
pub enum CullReason {
    /// It, or something above it in the hierarchy, has `Visibility::Hidden`.
    Hidden,
    /// It cannot be seen from anywhere outside the model that it is part of:
    /// [`InteriorCulling`](crate::interior::InteriorCulling).
    Interior,
    /// It shares no render layer with the camera.
    Layers,
    /// It is a chunk of a mesh with a [`SphericalIndex`](crate::spherical::SphericalIndex), and is out of view, shows the
    /// camera nothing but the back of its triangles, or is drawn with the whole mesh.
    Chunk,
    /// It is out of view, or out of its `VisibilityRange`.
    Frustum,
    /// It covers too little of the picture: [`ContributionCulling`](crate::contribution::ContributionCulling).
    Contribution,
    /// The camera's depth buffer hides it: [`ZBufferOcclusion`](crate::occlusion::ZBufferOcclusion).
    Occluded,
}

/// The entities that Skyline took out of a camera's visible entities this frame, and why.
///
/// Meant for a game to skip animating or simulating what nobody sees; see also [`Culling`](super::Culling). An
/// entity that the recheck of [`ZBufferOcclusion`](crate::occlusion::ZBufferOcclusion) found visible after all was
/// drawn in this very frame, and is missing here two or three frames later.
#[derive(Component, Reflect, Clone, Debug, Default)]
#[reflect(Component, Default, Clone, Debug)]
pub struct CulledEntities {
    /// By the depth buffer, sorted.
    pub(crate) occluded: Vec<Entity>,
    /// For covering too little, sorted.
    pub(crate) small: Vec<Entity>,
}

impl CulledEntities {
    /// Every removed entity with its reason; sorted by entity for each reason.
    pub fn iter(&self) -> impl Iterator<Item = (Entity, CullReason)> + '_ {
        let small = self.small.iter();
        let occluded = self.occluded.iter();
        small
            .map(|entity| (*entity, CullReason::Contribution))
            .chain(occluded.map(|entity| (*entity, CullReason::Occluded)))
    }

    /// Why an entity was removed; `None` if it was not.
    pub fn reason(&self, entity: Entity) -> Option<CullReason> {
        let is_in = |list: &[Entity]| list.binary_search(&entity).is_ok();
        if is_in(&self.occluded) {
            Some(CullReason::Occluded)
        } else if is_in(&self.small) {
            Some(CullReason::Contribution)
        } else {
            None
        }
    }

    /// How many were removed.
    pub fn len(&self) -> usize {
        self.occluded.len() + self.small.len()
    }

    /// Whether none was removed.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
