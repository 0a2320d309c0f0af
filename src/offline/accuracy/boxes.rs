//! Many small boxes on a plane: what the main world does about objects is measured on them.

use bevy::{camera::ScalingMode, prelude::*};

use crate::offline::Offline;

/// From one box to the next. units: m
const PITCH_M: f32 = 2.0;

/// So many boxes, seen from straight above by one camera that is moved aside by a share of what it sees: as many of them are
/// out of view.
pub fn boxes(offline: &mut Offline, count: usize, aside: f32, camera: impl Bundle) {
    let target = offline.target(UVec2::new(64, 64));
    let side = (count as f32).sqrt().ceil().max(1.0);
    let whole = side * PITCH_M;
    let lens = OrthographicProjection {
        scaling_mode: ScalingMode::Fixed {
            width: whole,
            height: whole,
        },
        ..OrthographicProjection::default_3d()
    };
    offline.camera(
        &target,
        (
            Projection::Orthographic(lens),
            Transform::from_xyz(aside * whole, 10.0, 0.0).looking_to(Vec3::NEG_Y, Vec3::NEG_Z),
            Msaa::Off,
            camera,
        ),
    );
    let world = offline.app.world_mut();
    let mesh = world
        .resource_mut::<Assets<Mesh>>()
        .add(Cuboid::from_length(0.5 * PITCH_M));
    let material = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial::default());
    world.spawn_batch((0..count).map(move |index| {
        let (column, row) = (index % side as usize, index / side as usize);
        let at = (Vec2::new(column as f32, row as f32) + 0.5) * PITCH_M - 0.5 * whole;
        (
            Mesh3d(mesh.clone()),
            MeshMaterial3d(material.clone()),
            Transform::from_xyz(at.x, 0.0, at.y),
        )
    }));
}
