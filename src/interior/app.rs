//! What interior culling is inside an app: what users see of it, and its registration.

use bevy::prelude::*;

use super::settings::{FieldBy, InteriorCulling};
use crate::systems::interior as systems;

/// On an entity below a model's [`InteriorCulling`]: it and all below it are left alone. They are not hidden and not
/// trimmed, and do not count as walls: what only they hide is seen. For doors, lids and wheels, and whatever moves.
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let world = app.world_mut();
/// # let [housing, gear] = [2.0, 1.0].map(|side| {
/// #     let mesh = Mesh3d(world.resource_mut::<Assets<Mesh>>().add(Cuboid::from_length(side)));
/// #     let paint = world.resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial::default());
/// #     (mesh, MeshMaterial3d(paint))
/// # });
/// let culling = InteriorCulling { grid: InteriorGrid::Resolution(16), ..default() };
/// let engine = world.spawn((Transform::default(), Visibility::default(), culling)).id();
/// // The lid opens later: what only it hides has to be there.
/// world.spawn((housing.clone(), ChildOf(engine)));
/// world.spawn((gear.clone(), ChildOf(engine)));
/// world.spawn((gear, ChildOf(engine), NoInteriorCulling));
///
/// while app.world().get::<InteriorCounts>(engine).is_none() {
///     app.update();
/// }
/// let counts = app.world().get::<InteriorCounts>(engine).expect("there by now");
/// assert_eq!((counts.nodes, counts.hidden_nodes), (2, 1));
/// ```
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct NoInteriorCulling;

/// What interior culling has taken out of a model; on its root while something is.
///
/// A node is an entity with a mesh. Those that are left alone are not counted.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct InteriorCounts {
    /// Nodes looked at.
    pub nodes: u32,
    /// Of these, hidden.
    pub hidden_nodes: u32,
    /// Triangles of the nodes looked at.
    pub triangles: u64,
    /// Of these, not drawn: in hidden nodes, or left out of meshes.
    pub hidden_triangles: u64,
    /// What a ball so wide can touch from outside stays. units: of the root's own space, in Bevy m
    pub gap: f32,
    /// Where the distance field was made: what was asked for, or the CPU if the GPU could not.
    pub field: FieldBy,
}

/// Registers types, resources and main-world systems.
pub(crate) fn register(app: &mut App) {
    app.register_type::<InteriorCulling>()
        .register_type::<NoInteriorCulling>()
        .register_type::<InteriorCounts>();
    systems::register(app);
}
