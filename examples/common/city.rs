//! A city with a camera in it.

use std::path::Path;

use bevy::{
    camera::ClearColorConfig, camera_controller::free_camera::FreeCamera, light::AmbientLight,
    prelude::*,
};
use bevy_skyline::offline::scenes::{Look, Scene, SceneError};

use crate::stage::StageError;

/// The city of a file, else one made by code. Says what it has.
pub fn read_or_make(
    file: Option<&Path>,
    read: impl FnOnce(&Path) -> Result<Scene, SceneError>,
    make: impl FnOnce() -> Scene,
) -> Result<Scene, StageError> {
    let scene = file.map_or_else(|| Ok(make()), read);
    let scene = scene.map_err(StageError::input)?;
    println!(
        "{}: {} objects, {} triangles",
        scene.name,
        scene.objects.len(),
        scene.triangles()
    );
    Ok(scene)
}

/// Fills an empty world. Returns the entities of the scene's objects, and a camera that looks as the scene's view of
/// that name and has more components.
pub fn populate(
    world: &mut World,
    scene: &Scene,
    view: &str,
    on_camera: impl Bundle,
) -> (Vec<Entity>, Entity) {
    let entities = scene.spawn(world, Look::Shaded);
    let haze = Color::linear_rgb(0.55, 0.68, 0.85);
    let camera = (
        Camera3d::default(),
        Camera {
            clear_color: ClearColorConfig::Custom(haze),
            ..default()
        },
        Projection::Perspective(scene.projection()),
        Msaa::Off,
        scene.view(view),
        AmbientLight {
            brightness: 900.0,
            ..default()
        },
        FreeCamera {
            walk_speed: 20.0,
            run_speed: 150.0,
            friction: 8.0,
            ..default()
        },
    );
    let camera = world.spawn((camera, on_camera)).id();
    (entities, camera)
}
