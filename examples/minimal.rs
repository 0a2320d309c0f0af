//! The smallest app with a terrain and its shadows: hills made by code, a camera and a sun.

#[path = "common/headless.rs"]
mod headless;

use bevy::prelude::*;
use bevy_skyline::prelude::*;

fn main() -> AppExit {
    App::new()
        // In your app just `DefaultPlugins`; this one also draws without a window: `--headless --out DIR`.
        .add_plugins((headless::window_or_picture(DefaultPlugins), SkylinePlugins))
        .add_systems(Startup, setup)
        .run()
}

fn setup(mut commands: Commands, mut height_fields: ResMut<Assets<HeightField>>) -> Result {
    // 1025×1025 samples, 4 m apart: six layers of ridges, each half as wide and as high as the one before.
    let hills = HeightField::from_fn(UVec2::splat(1025), 4.0, (0.0, 800.0), |column, row| {
        let ridges = |layer| {
            let at = Vec2::new(column as f32, row as f32) * 0.006 * 2f32.powi(layer);
            let at = Vec2::from_angle(layer as f32).rotate(at);
            400.0 * (1.0 - (at.x.sin() * at.y.cos()).abs()) / 2f32.powi(layer)
        };
        (0..6).map(ridges).sum()
    })?;
    let terrain = Terrain::new(height_fields.add(hills));
    commands.spawn((terrain, TerrainShadow::default()));
    let eye = Transform::from_xyz(600.0, 900.0, 600.0);
    let eye = eye.looking_at(Vec3::new(2500.0, 300.0, 2500.0), Vec3::Y);
    commands.spawn((Camera3d::default(), eye));
    commands.spawn((
        DirectionalLight {
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-1.0, -0.6, 0.4), Vec3::Y),
    ));
    Ok(())
}
