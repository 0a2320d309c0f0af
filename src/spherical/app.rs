//! What a spherical index is inside an app: what users see of it, and its registration.

use bevy::{prelude::*, render::render_resource::Face};

use super::settings::{SphericalIndex, SphericalMode};
use crate::{
    culling,
    systems::spherical::{self as systems, follow, spawn},
};

/// What is drawn of a mesh that has a spherical index; on its entity beside [`SphericalIndex`]. All 0 while it is drawn
/// whole because it has no index, or is in no camera's view.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct SphericalCounts {
    /// Chunks that the mesh is cut into.
    pub chunks: u32,
    /// Triangles of the mesh.
    pub triangles: u32,
    /// Cameras that have it in view.
    pub views: u32,
    /// Of these, those that draw chunks; the others draw it whole, as that costs them less.
    pub views_by_chunks: u32,
    /// Chunks handed on to be drawn, over all cameras; occlusion culling may take more of them out.
    pub drawn_chunks: u32,
    /// Triangles handed on to be drawn, over all cameras.
    pub drawn_triangles: u64,
}

/// What an app can tell spherical indices.
pub trait SphericalAppExt {
    /// Lets [`SphericalIndex`] work for meshes with a material of another kind than `StandardMaterial`. The material's
    /// shaders may not move vertices. `cull_mode`: which side of a material's triangles is not drawn; `None` takes
    /// nothing away that is only seen from behind. Has to be called after [`SphericalPlugin`](crate::plugin::SphericalPlugin)
    /// is added.
    fn register_spherical_material<M: Material>(
        &mut self,
        cull_mode: fn(&M) -> Option<Face>,
    ) -> &mut Self;
}

impl SphericalAppExt for App {
    fn register_spherical_material<M: Material>(
        &mut self,
        cull_mode: fn(&M) -> Option<Face>,
    ) -> &mut Self {
        self.insert_resource(follow::Announced::<M>(cull_mode))
            .add_systems(
                PostUpdate,
                follow::follow_material::<M>
                    .run_if(systems::is_asked_for)
                    .run_if(resource_exists::<Messages<AssetEvent<M>>>)
                    // Which goes by what it finds.
                    .before(follow::follow_indexed)
                    .in_set(systems::SphericalSteps::Follow),
            );
        spawn::paint_with::<MeshMaterial3d<M>>(self);
        self
    }
}

/// Registers types, resources and main-world systems.
pub(crate) fn register(app: &mut App) {
    culling::register(app);
    app.register_type::<SphericalIndex>()
        .register_type::<SphericalMode>()
        .register_type::<SphericalCounts>();
    systems::register(app);
    spawn::paint_with_bevys(app);
    app.register_spherical_material::<StandardMaterial>(|material| material.cull_mode);
}
