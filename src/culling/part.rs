//! What an entity is to one effect, for the others to know: each of them may be built without the rest.

use bevy::prelude::*;

/// On every entity of a model with [`InteriorCulling`](crate::interior::InteriorCulling): changes of these are what is
/// listened to.
///
/// A clone of the entity is none of the model's parts until the model is looked at again.
#[derive(Component, Clone, Copy, Debug)]
#[component(clone_behavior = Ignore)]
pub struct PartOf {
    pub(crate) root: Entity,
    /// Taken out of view, whatever its `Visibility`.
    pub(crate) is_hidden: bool,
}

impl PartOf {
    /// Whether interior culling has hidden the entity.
    pub fn is_hidden(&self) -> bool {
        self.is_hidden
    }
}

/// On a chunk of a mesh with a [`SphericalIndex`](crate::spherical::SphericalIndex): the entity that it is a part of.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkOf {
    pub(crate) root: Entity,
}

impl ChunkOf {
    /// The entity that the user spawned.
    pub fn entity(&self) -> Entity {
        self.root
    }
}
