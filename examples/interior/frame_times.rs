//! Whether culling in the background is felt: frames of a small scene, while a model that is out of view is culled.

use std::time::Instant;

use bevy::prelude::*;
use bevy_skyline::prelude::*;

use crate::{
    model::ModelData,
    stage::{Film, StageError},
    until_culled,
};

/// On the model's root.
#[derive(Component)]
struct FarOff;

/// Cubes on a square, and the model far off.
pub fn populate(world: &mut World, model: ModelData) {
    world.spawn((
        Camera3d::default(),
        Msaa::Off,
        Transform::from_xyz(0.0, 6.0, 18.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    world.spawn((
        DirectionalLight::default(),
        Transform::default().looking_to(Vec3::new(-1.0, -2.0, -1.5), Vec3::Y),
    ));
    let mut meshes = world.resource_mut::<Assets<Mesh>>();
    let cube = meshes.add(Cuboid::from_length(1.0));
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    let paint = materials.add(StandardMaterial::default());
    for i in 0..100 {
        let place = Vec3::new((i % 10) as f32 - 4.5, 0.0, (i / 10) as f32 - 4.5) * 1.6;
        world.spawn((
            Mesh3d(cube.clone()),
            MeshMaterial3d(paint.clone()),
            Transform::from_translation(place),
        ));
    }
    let (root, _) = model.spawn(world);
    let far_off = Transform::from_xyz(0.0, 0.0, 10_000.0);
    world.entity_mut(root).insert((far_off, FarOff));
}

/// Times frames before, while and after the model is culled, and the one in which that is undone.
pub fn measure(film: &mut Film, settings: InteriorCulling) -> Result<(), StageError> {
    let world = film.world();
    let mut roots = world.query_filtered::<Entity, With<FarOff>>();
    let root = roots.single(world).map_err(StageError::input)?;
    for _ in 0..20 {
        film.step();
    }
    let some = |film: &mut Film| (0..film.options.frames).map(|_| film.step()).collect();
    tell("before", some(film));
    film.world().entity_mut(root).insert(settings);
    let start = Instant::now();
    let stages = until_culled(film)?;
    println!("culled after {:.1} s", start.elapsed().as_secs_f64());
    for (stage, times_ms) in &stages {
        tell(&format!("  while {stage}"), times_ms.clone());
    }
    let all = stages.into_iter().flat_map(|(_, times_ms)| times_ms);
    tell("while", all.collect());
    tell("after", some(film));
    println!("{}", film.world().resource::<Effects>().interior());
    film.world().entity_mut(root).remove::<InteriorCulling>();
    let undone = film.step();
    tell("the frame of its removal", vec![undone]);
    Ok(())
}

/// Prints what frames took. units: ms
fn tell(what: &str, mut times_ms: Vec<f64>) {
    times_ms.sort_by(f64::total_cmp);
    let last = times_ms.len().saturating_sub(1) as f64;
    let [median, p99, max] = [0.5, 0.99, 1.0].map(|part| {
        let at = times_ms.get((part * last).round() as usize);
        at.copied().unwrap_or(f64::NAN)
    });
    println!(
        "{what}: median {median:.2} ms, 99th percentile {p99:.2} ms, max {max:.2} ms, {} frames",
        times_ms.len()
    );
}
