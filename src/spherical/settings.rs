//! What a user asks of a spherical index.

use bevy::prelude::*;

use super::{Bins, SphericalCounts};

/// On an entity with `Mesh3d`: of its mesh each camera draws only what it can see. See
/// [what is guaranteed](super#what-is-guaranteed).
///
/// The mesh is indexed in the background, once for all entities that have it, and cut into chunks: children of the entity
/// that cameras draw in its place, with its own material. Until then, and wherever that would not pay, the entity is
/// drawn whole. Shadows are always cast by the whole mesh. How it stands is said by
/// [`Effects::spherical`](crate::effects::Effects::spherical), what is drawn by [`SphericalCounts`](super::SphericalCounts).
/// With the component gone everything is as it was, and nothing is held.
///
/// # Which meshes
/// Triangle lists in main memory ([`RenderAssetUsages::MAIN_WORLD`](bevy::asset::RenderAssetUsages)), with opaque or
/// alpha-masked materials; a material that is not a `StandardMaterial` has to be announced by
/// [`register_spherical_material`](super::SphericalAppExt::register_spherical_material), and may not move vertices. Drawn whole,
/// with the reason in [`Effects`](crate::effects::Effects): skins, morph targets, blended and transmitting materials,
/// which are drawn in an order that chunks would change, and a `VisibilityRange`.
///
/// # Limits
/// - Memory for the mesh, the GPU's and the main one, is taken twice and some more: whole, and as chunks, which have no
///   vertices in common.
/// - Chunks are entities: of ray casts and picking the one that is hit may be a chunk, the child of what is meant.
/// - A mesh is worth it from some ten thousand triangles on.
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// # let target = headless::target();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let world = app.world_mut();
/// # let marble = world.resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial::default());
/// # let globe = Sphere::new(1.0).mesh().uv(128, 64);
/// # let globe = world.resource_mut::<Assets<Mesh>>().add(globe);
/// world.spawn((Camera3d::default(), target, Transform::from_xyz(0.0, 0.0, 4.0)));
/// let globe = world
///     .spawn((Mesh3d(globe), MeshMaterial3d(marble), SphericalIndex::default()))
///     .id();
///
/// // Its index is made in the background; until then it is drawn whole.
/// while app.world().get::<SphericalCounts>(globe).is_none_or(|counts| counts.chunks == 0) {
///     app.update();
/// }
/// # for _ in 0..4 {
/// #     app.update();
/// # }
/// let counts = app.world().get::<SphericalCounts>(globe).expect("required by the index");
/// // The side that is turned away is not drawn.
/// assert!(counts.drawn_triangles < counts.triangles.into());
/// ```
#[derive(Component, Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
#[require(SphericalCounts)]
pub struct SphericalIndex {
    /// How finely directions are told apart. default: 180 × 360, the paper's
    pub bins: Bins,
    /// What is taken for unseen.
    pub mode: SphericalMode,
    /// How many triangles a chunk has, at most. Fewer leave out more, and cost more each. range: 1.., default: 128
    pub chunk_triangles: u32,
    /// What drawing a chunk costs beside its triangles: where chunks would cost more than the mesh, it is drawn whole.
    /// 0 always draws chunks. The default is what was measured on a software renderer; on a GPU that draws triangles
    /// quicker it is more. units: triangles, default: 36
    pub chunk_cost: u32,
}

impl Default for SphericalIndex {
    fn default() -> Self {
        Self {
            bins: Bins::default(),
            mode: SphericalMode::default(),
            chunk_triangles: 128,
            chunk_cost: 36,
        }
    }
}

/// What is taken for unseen.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum SphericalMode {
    /// Chunks out of view, and those whose every triangle is seen from behind, where the material is one-sided: nothing
    /// that shows, whatever the mesh and the camera.
    #[default]
    Conservative,
    /// What P3's maps and rings leave out: of meshes that are not star-shaped, and near the edges of the view, some of
    /// what shows.
    Paper,
}
