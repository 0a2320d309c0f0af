use bevy::prelude::*;
use bevy_skyline::{offline::*, prelude::*};
#[test]
fn pictures() {
    let mut off = Offline::new().unwrap();
    let field = crate::data::elevation_model("taiwan_central_range_1024").unwrap();
    let e = field.extent_m();
    let h = off
        .app
        .world_mut()
        .resource_mut::<Assets<HeightField>>()
        .add(field);
    let t = off
        .app
        .world_mut()
        .spawn((Terrain::new(h), TerrainShadow::default()))
        .id();
    let sun = off
        .app
        .world_mut()
        .spawn((
            DirectionalLight {
                shadow_maps_enabled: true,
                illuminance: 10_000.0,
                ..default()
            },
            Transform::default(),
        ))
        .id();
    off.app.world_mut().insert_resource(GlobalAmbientLight {
        brightness: 300.0,
        ..default()
    });
    let target = off.target(UVec2::new(960, 540));
    let cam = off.camera(
        &target,
        (
            Msaa::Off,
            Transform::from_xyz(0.45 * e.x, 5000.0, 0.7 * e.y)
                .looking_at(Vec3::new(0.5 * e.x, 1500.0, 0.35 * e.y), Vec3::Y),
        ),
    );
    for (n, el, eye, at) in [
        (
            0,
            12.0f32,
            Vec3::new(0.45 * e.x, 5000.0, 0.7 * e.y),
            Vec3::new(0.5 * e.x, 1500.0, 0.35 * e.y),
        ),
        (
            1,
            30.0,
            Vec3::new(0.45 * e.x, 5000.0, 0.7 * e.y),
            Vec3::new(0.5 * e.x, 1500.0, 0.35 * e.y),
        ),
        (
            2,
            12.0,
            Vec3::new(0.45 * e.x, 3600.0, 0.45 * e.y),
            Vec3::new(0.5 * e.x, 1800.0, 0.42 * e.y),
        ),
    ] {
        let el = el.to_radians();
        *off.app.world_mut().get_mut::<Transform>(sun).unwrap() = Transform::default().looking_to(
            -Vec3::new(-0.8 * el.cos(), el.sin(), 0.6 * el.cos()),
            Vec3::Y,
        );
        *off.app.world_mut().get_mut::<Transform>(cam).unwrap() =
            Transform::from_translation(eye).looking_at(at, Vec3::Y);
        off.settle(cam, 20).unwrap();
        for k in 0..400 {
            off.step();
            let c = off.counts().shadows;
            if k > 3 && !c.waiting {
                println!("{n}: {k} frames, {} ns", c.ns_per_ray);
                break;
            }
        }
        off.step();
        off.picture(&target)
            .unwrap()
            .save(format!("/tmp/pic{n}.png"))
            .unwrap();
    }
    off.app.world_mut().entity_mut(t).remove::<TerrainShadow>();
    off.step();
    off.step();
    off.picture(&target).unwrap().save("/tmp/pic3.png").unwrap();
}
#[test]
fn debug() {
    let mut off = Offline::new().unwrap();
    let field = crate::data::elevation_model("taiwan_central_range_1024").unwrap();
    let e = field.extent_m();
    let h = off
        .app
        .world_mut()
        .resource_mut::<Assets<HeightField>>()
        .add(field);
    off.app.world_mut().spawn((
        Terrain::new(h),
        TerrainShadow {
            lights: ShadowedLights::All,
            ..default()
        },
    ));
    off.app.world_mut().spawn((
        DirectionalLight {
            illuminance: 10_000.0,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(1.0, -0.3, 0.2), Vec3::Y),
    ));
    let target = off.target(UVec2::new(64, 36));
    let cam = off.camera(
        &target,
        (
            Msaa::Off,
            Transform::from_xyz(0.45 * e.x, 5000.0, 0.7 * e.y)
                .looking_at(Vec3::new(0.5 * e.x, 1500.0, 0.35 * e.y), Vec3::Y),
        ),
    );
    off.settle(cam, 20).unwrap();
    for k in 0..400 {
        let t = std::time::Instant::now();
        off.step();
        let c = off.counts();
        if k % 10 == 0 {
            println!(
                "{k} {:?} {:?} {:.1} ms",
                c.shadows,
                c.passes.get("terrain_shadow"),
                t.elapsed().as_secs_f64() * 1e3
            );
        }
        if !c.shadows.waiting {
            break;
        }
    }
}
