use bevy::prelude::*;
use bevy_skyline::{offline::*, prelude::*};
fn run(off: &mut Offline, cam: Entity) {
    off.settle(cam, 20).unwrap();
    let t = std::time::Instant::now();
    for k in 0..600 {
        off.step();
        let c = off.counts().shadows;
        if k > 3 && !c.waiting {
            println!(
                "{k} frames, {:.0} ns a ray, {:.1} ms a frame",
                c.ns_per_ray,
                t.elapsed().as_secs_f64() * 1e3 / k as f64
            );
            break;
        }
    }
    off.step();
}
#[test]
fn pictures() {
    let mut off = Offline::new().unwrap();
    let field = crate::data::elevation_model("taiwan_central_range_1024").unwrap();
    let e = field.extent_m();
    let ground = field.clone();
    let h = off
        .app
        .world_mut()
        .resource_mut::<Assets<HeightField>>()
        .add(field);
    let t = off
        .app
        .world_mut()
        .spawn((
            Terrain::new(h),
            TerrainShadow {
                slice_ms: 50.0,
                ..default()
            },
        ))
        .id();
    off.app
        .world_mut()
        .insert_resource(bevy::light::DirectionalLightShadowMap { size: 1024 });
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
            bevy::light::CascadeShadowConfigBuilder {
                maximum_distance: 6000.0,
                first_cascade_far_bound: 800.0,
                ..default()
            }
            .build(),
        ))
        .id();
    off.app.world_mut().insert_resource(GlobalAmbientLight {
        brightness: 300.0,
        ..default()
    });
    let size = std::env::var("BIG").map_or(UVec2::new(640, 360), |_| UVec2::new(1280, 720));
    let target = off.target(size);
    let cam = off.camera(&target, (Msaa::Off, Transform::default()));
    let aim = |off: &mut Offline, el: f32, flip: f32, eye: Vec3, at: Vec3| {
        let el = el.to_radians();
        *off.app.world_mut().get_mut::<Transform>(sun).unwrap() = Transform::default().looking_to(
            -Vec3::new(-0.8 * el.cos() * flip, el.sin(), 0.6 * el.cos() * flip),
            Vec3::Y,
        );
        *off.app.world_mut().get_mut::<Transform>(cam).unwrap() =
            Transform::from_translation(eye).looking_at(at, Vec3::Y);
    };
    let far = (
        Vec3::new(0.45 * e.x, 5000.0, 0.7 * e.y),
        Vec3::new(0.5 * e.x, 1500.0, 0.35 * e.y),
    );
    for (n, el) in [(0, 12.0f32), (1, 30.0)] {
        aim(&mut off, el, 1.0, far.0, far.1);
        run(&mut off, cam);
        off.picture(&target)
            .unwrap()
            .save(format!("/tmp/pic{n}.png"))
            .unwrap();
    }
    // Cubes on the ground near the camera.
    let mesh = off
        .app
        .world_mut()
        .resource_mut::<Assets<Mesh>>()
        .add(Cuboid::new(200.0, 500.0, 200.0));
    let material = off
        .app
        .world_mut()
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            base_color: Color::srgb(0.9, 0.5, 0.4),
            ..default()
        });
    let at = Vec2::new(0.5 * e.x, 0.42 * e.y);
    for i in -6..6 {
        for j in -6..6 {
            let p = at + 700.0 * Vec2::new(i as f32, j as f32);
            let y = ground.height_at(p).unwrap();
            off.app.world_mut().spawn((
                Mesh3d(mesh.clone()),
                MeshMaterial3d(material.clone()),
                Transform::from_xyz(p.x, y + 200.0, p.y),
            ));
        }
    }
    let y = ground.height_at(at).unwrap();
    let near = (
        Vec3::new(at.x - 3500.0, y + 2500.0, at.y + 3500.0),
        Vec3::new(at.x, y, at.y),
    );
    for (n, el, flip) in [(2, 20.0f32, 1.0), (3, 20.0, -1.0), (4, 50.0, 1.0)] {
        aim(&mut off, el, flip, near.0, near.1);
        run(&mut off, cam);
        off.picture(&target)
            .unwrap()
            .save(format!("/tmp/pic{n}.png"))
            .unwrap();
    }
    off.app.world_mut().entity_mut(t).remove::<TerrainShadow>();
    off.step();
    off.step();
    off.picture(&target).unwrap().save("/tmp/pic5.png").unwrap();
}
