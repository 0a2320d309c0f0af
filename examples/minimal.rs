//! The smallest app with a terrain and its shadows: hills made by code, a camera and a sun.

use bevy::prelude::*;
use bevy_skyline::prelude::*;

fn main() -> AppExit {
    App::new()
        .add_plugins((DefaultPlugins, SkylinePlugins))
        .add_systems(Startup, setup)
        .run()
}

fn setup(mut commands: Commands, mut height_fields: ResMut<Assets<HeightField>>) -> Result {
    // 1025×1025 samples, 4 m apart, between 0 and 400 m high.
    let hills = HeightField::from_fn(UVec2::splat(1025), 4.0, (0.0, 400.0), |column, row| {
        let (x, z) = (column as f32 * 0.01, row as f32 * 0.01);
        200.0
            + 110.0 * x.sin() * z.cos()
            + 45.0 * (2.7 * x + z).sin()
            + 20.0 * (6.1 * z - 3.0 * x).cos()
    })?;
    commands.spawn((
        Terrain::new(height_fields.add(hills)),
        TerrainShadow::default(),
    ));
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(600.0, 700.0, 600.0)
            .looking_at(Vec3::new(2500.0, 100.0, 2500.0), Vec3::Y),
    ));
    commands.spawn((
        DirectionalLight {
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-1.0, -0.6, 0.4), Vec3::Y),
    ));
    Ok(())
}
