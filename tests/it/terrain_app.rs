//! A headless Bevy app with terrain in it, frame by frame: what it costs, how it lives with meshes and cameras,
//! and what happens when things change.

use bevy::{
    camera::{Hdr, RenderTarget, ScalingMode, Viewport},
    core_pipeline::prepass::{DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass},
    pbr::DistanceFog,
    prelude::*,
    render::occlusion_culling::OcclusionCulling,
};
use bevy_skyline::{
    offline::{HitImage, Offline},
    prelude::*,
    render_graph::stats::TerrainStats,
    terrain::{PyramidNodes, view_rays::T_NEVER},
};

const SIZE: UVec2 = UVec2::new(96, 64);

/// Rolling hills, 400 m a side, 0 to 40 m high.
fn hills() -> HeightField {
    HeightField::from_fn(UVec2::new(101, 101), 4.0, (0.0, 60.0), |x, z| {
        let (x, z) = (x as f32 * 0.13, z as f32 * 0.17);
        20.0 + 10.0 * x.sin() + 10.0 * z.cos()
    })
    .unwrap()
}

fn flat(height_m: f32) -> HeightField {
    HeightField::from_fn(UVec2::new(33, 33), 10.0, (0.0, 100.0), |_, _| height_m).unwrap()
}

fn eye() -> Transform {
    Transform::from_xyz(200.0, 90.0, 380.0).looking_at(Vec3::new(200.0, 10.0, 150.0), Vec3::Y)
}

/// An app with one terrain and a sun.
fn with_terrain(field: HeightField) -> Option<(Offline, Entity)> {
    let mut offline = crate::device()?;
    let terrain = add_terrain(&mut offline, field, Transform::IDENTITY);
    offline.app.world_mut().spawn((
        DirectionalLight {
            illuminance: 10_000.0,
            ..default()
        },
        Transform::from_xyz(1.0, 2.0, 0.5).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    Some((offline, terrain))
}

fn add_terrain(offline: &mut Offline, field: HeightField, transform: Transform) -> Entity {
    let world = offline.app.world_mut();
    let handle = world.resource_mut::<Assets<HeightField>>().add(field);
    world
        .spawn((
            Terrain::new(handle).with_look(TerrainLook {
                colour: TerrainColour::Uniform(Color::srgb(0.1, 0.8, 0.1)),
                ..default()
            }),
            transform,
        ))
        .id()
}

fn add_box(offline: &mut Offline, at: Vec3, size: f32) -> Entity {
    let world = offline.app.world_mut();
    let mesh = world
        .resource_mut::<Assets<Mesh>>()
        .add(Cuboid::from_length(size));
    let material = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            base_color: Color::srgb(0.9, 0.05, 0.05),
            unlit: true,
            ..default()
        });
    world
        .spawn((
            Mesh3d(mesh),
            MeshMaterial3d(material),
            Transform::from_translation(at),
        ))
        .id()
}

/// A camera and what it draws to.
fn add_camera(offline: &mut Offline, bundle: impl Bundle) -> (Entity, Handle<Image>) {
    let target = offline.target(SIZE);
    (offline.camera(&target, bundle), target)
}

fn hits(offline: &mut Offline, camera: Entity) -> HitImage {
    offline.settle(camera, 10).unwrap();
    offline.hits(camera).unwrap().unwrap()
}

/// Of the boxes: brighter in red than in green by far, whatever the tonemapping does to so bright a colour.
fn is_red(pixel: &image::Rgba<u8>) -> bool {
    i32::from(pixel[0]) > i32::from(pixel[1]) + 60
}

fn is_green(pixel: &image::Rgba<u8>) -> bool {
    let [red, green, blue] = [0, 1, 2].map(|i| i32::from(pixel[i]));
    green > red + 20 && green > blue + 20
}

fn count(picture: &image::RgbaImage, what: fn(&image::Rgba<u8>) -> bool) -> usize {
    picture.pixels().filter(|pixel| what(pixel)).count()
}

fn stats(offline: &Offline) -> bevy_skyline::render_graph::stats::TerrainCounts {
    offline
        .app
        .world()
        .resource::<TerrainStats>()
        .lock()
        .clone()
}

#[test]
fn without_a_terrain_nothing_runs_and_nothing_is_held() {
    let Some(mut offline) = crate::device() else {
        return;
    };
    let (_, _) = add_camera(&mut offline, (Msaa::Off, eye()));
    add_box(&mut offline, Vec3::ZERO, 10.0);
    for _ in 0..8 {
        offline.step();
    }
    let counts = stats(&offline);
    assert_eq!(counts.total_runs(), 0, "{counts:?}");
    assert_eq!(
        (counts.field_bytes, counts.view_bytes, counts.pipelines),
        (0, 0, 0)
    );
    assert_eq!(
        *offline.app.world().resource::<Effects>().terrain(),
        EffectState::Dormant
    );
}

#[test]
fn removing_the_component_frees_everything_and_putting_it_back_draws_the_same() {
    let Some((mut offline, terrain)) = with_terrain(hills()) else {
        return;
    };
    let (camera, _) = add_camera(&mut offline, (Msaa::Off, eye()));
    let before = hits(&mut offline, camera);
    assert!(matches!(
        offline.app.world().resource::<Effects>().terrain(),
        EffectState::Active(activity) if activity.bytes > 0
    ));
    let component = offline
        .app
        .world_mut()
        .entity_mut(terrain)
        .take::<Terrain>()
        .unwrap();
    offline.step();
    offline.step();
    let counts = stats(&offline);
    assert_eq!((counts.field_bytes, counts.view_bytes), (0, 0));
    let runs = counts.total_runs();
    offline.step();
    assert_eq!(stats(&offline).total_runs(), runs, "passes still run");
    assert_eq!(
        *offline.app.world().resource::<Effects>().terrain(),
        EffectState::Dormant
    );

    offline
        .app
        .world_mut()
        .entity_mut(terrain)
        .insert(component);
    assert_eq!(hits(&mut offline, camera).ndc_depth, before.ndc_depth);
}

#[test]
fn out_of_view_or_hidden_it_idles() {
    let Some((mut offline, terrain)) = with_terrain(hills()) else {
        return;
    };
    let (camera, _) = add_camera(&mut offline, (Msaa::Off, eye()));
    hits(&mut offline, camera);
    let cast = |offline: &Offline| {
        stats(offline)
            .passes
            .get("ray_cast")
            .copied()
            .unwrap_or_default()
            .runs
    };
    *offline
        .app
        .world_mut()
        .get_mut::<Transform>(camera)
        .unwrap() = Transform::from_xyz(200.0, 90.0, 900.0).looking_to(Vec3::Z, Vec3::Y);
    offline.step();
    let runs = cast(&offline);
    offline.step();
    assert_eq!(
        cast(&offline),
        runs,
        "rays are cast with the back to the terrain"
    );
    assert!(matches!(
        offline.app.world().resource::<Effects>().terrain(),
        EffectState::Idle(_)
    ));

    *offline
        .app
        .world_mut()
        .get_mut::<Transform>(camera)
        .unwrap() = eye();
    *offline
        .app
        .world_mut()
        .get_mut::<Visibility>(terrain)
        .unwrap() = Visibility::Hidden;
    offline.step();
    let runs = cast(&offline);
    offline.step();
    assert_eq!(cast(&offline), runs, "rays are cast at a hidden terrain");
}

#[test]
fn in_steady_state_the_main_world_allocates_nothing_and_queries_neither() {
    let Some((mut offline, _)) = with_terrain(hills()) else {
        return;
    };
    let (camera, _) = add_camera(&mut offline, (Msaa::Off, eye()));
    hits(&mut offline, camera);
    let world = offline.app.world_mut();
    let report = world.register_system(bevy_skyline::systems::terrain::report_terrain);
    world.run_system(report).unwrap();
    let allocations = crate::allocations::count(|| {
        for _ in 0..10 {
            world.run_system(report).unwrap();
        }
    });
    assert_eq!(allocations, 0, "report_terrain");

    let field = hills();
    let allocations = crate::allocations::count(|| {
        for i in 0..100 {
            let x = i as f32 * 4.0;
            std::hint::black_box(field.height_at(Vec2::new(x, 200.0)));
            std::hint::black_box(field.normal_at(Vec2::new(x, 200.0)));
            std::hint::black_box(field.ray_cast(
                Vec3::new(x, 90.0, 380.0),
                Vec3::new(0.1, -0.4, -1.0),
                1e4,
            ));
        }
    });
    assert_eq!(allocations, 0, "queries");
}

#[test]
fn gpu_memory_stays_below_four_bytes_a_sample() {
    let Some(mut offline) = crate::device() else {
        return;
    };
    let size = UVec2::new(1025, 771);
    let field = HeightField::from_fn(size, 1.0, (0.0, 10.0), |x, z| (x ^ z) as f32 % 10.0).unwrap();
    add_terrain(&mut offline, field, Transform::IDENTITY);
    let (camera, _) = add_camera(
        &mut offline,
        (
            Msaa::Off,
            Transform::from_xyz(500.0, 200.0, 900.0)
                .looking_at(Vec3::new(500.0, 0.0, 0.0), Vec3::Y),
        ),
    );
    hits(&mut offline, camera);
    let bytes = stats(&offline).field_bytes as f64 / f64::from(size.x * size.y);
    assert!(bytes <= 4.0 && bytes > 3.0, "{bytes} bytes a sample");
}

#[test]
fn terrain_and_meshes_hide_each_other() {
    let Some((mut offline, _)) = with_terrain(flat(20.0)) else {
        return;
    };
    let (camera, target) = add_camera(
        &mut offline,
        (
            Msaa::Off,
            Transform::from_xyz(160.0, 60.0, 300.0)
                .looking_at(Vec3::new(160.0, 20.0, 160.0), Vec3::Y),
        ),
    );
    let standing = add_box(&mut offline, Vec3::new(160.0, 30.0, 160.0), 20.0);
    hits(&mut offline, camera);
    offline.step();
    let above = count(&offline.picture(&target).unwrap(), is_red);
    assert!(above > 20, "a box on the ground covers {above} pixels");
    // Sunk wholly below the surface it is hidden; halfway, half of it is.
    offline
        .app
        .world_mut()
        .get_mut::<Transform>(standing)
        .unwrap()
        .translation
        .y = 5.0;
    offline.step();
    offline.step();
    assert_eq!(count(&offline.picture(&target).unwrap(), is_red), 0);
    offline
        .app
        .world_mut()
        .get_mut::<Transform>(standing)
        .unwrap()
        .translation
        .y = 20.0;
    offline.step();
    offline.step();
    let half = count(&offline.picture(&target).unwrap(), is_red);
    assert!(half > 5 && half < above, "{half} of {above}");
    assert!(count(&offline.picture(&target).unwrap(), is_green) > 500);
}

/// Every kind of camera: the terrain is there, the box before it is, the one behind the ground isn't.
#[test]
fn every_kind_of_camera_shows_the_same_scene() {
    let Some((mut offline, _)) = with_terrain(flat(20.0)) else {
        return;
    };
    add_box(&mut offline, Vec3::new(160.0, 30.0, 160.0), 20.0);
    let place =
        Transform::from_xyz(160.0, 60.0, 300.0).looking_at(Vec3::new(160.0, 20.0, 160.0), Vec3::Y);
    let mut reference: Option<(usize, usize)> = None;
    let mut check = |offline: &mut Offline, name: &str, camera: Entity, target: Handle<Image>| {
        hits(offline, camera);
        offline.step();
        let picture = offline.picture(&target).unwrap();
        let (red, green) = (count(&picture, is_red), count(&picture, is_green));
        let (all_red, all_green) = *reference.get_or_insert((red, green));
        let near = |a: usize, b: usize| a.abs_diff(b) * 20 <= b;
        assert!(
            red > 20 && green > 500 && near(red, all_red) && near(green, all_green),
            "{name}: {red} red of {all_red}, {green} green of {all_green}"
        );
        offline.app.world_mut().despawn(camera);
        offline.step();
    };
    let (camera, target) = add_camera(&mut offline, (Msaa::Off, place));
    check(&mut offline, "plain", camera, target);
    let (camera, target) = add_camera(&mut offline, (Msaa::Sample4, place));
    check(&mut offline, "multisampled", camera, target);
    let (camera, target) = add_camera(&mut offline, (Msaa::Off, Hdr, place));
    check(&mut offline, "HDR", camera, target);
    let (camera, target) = add_camera(&mut offline, (Msaa::Off, DepthPrepass, place));
    check(&mut offline, "depth prepass", camera, target);
    let (camera, target) = add_camera(
        &mut offline,
        (
            Msaa::Off,
            DepthPrepass,
            NormalPrepass,
            MotionVectorPrepass,
            place,
        ),
    );
    check(&mut offline, "every prepass", camera, target);
    let (camera, target) = add_camera(
        &mut offline,
        (Msaa::Sample4, DepthPrepass, NormalPrepass, place),
    );
    check(&mut offline, "multisampled prepass", camera, target);
    let (camera, target) = add_camera(
        &mut offline,
        (Msaa::Off, DepthPrepass, DeferredPrepass, place),
    );
    check(&mut offline, "deferred", camera, target);
    let (camera, target) = add_camera(
        &mut offline,
        (Msaa::Off, DepthPrepass, OcclusionCulling, place),
    );
    check(&mut offline, "occlusion culling", camera, target);
}

#[test]
fn fog_and_cascaded_shadows_reach_the_terrain() {
    let Some(mut offline) = crate::device() else {
        return;
    };
    add_terrain(&mut offline, flat(20.0), Transform::IDENTITY);
    let sun = offline
        .app
        .world_mut()
        .spawn((
            DirectionalLight {
                illuminance: 10_000.0,
                shadow_maps_enabled: true,
                ..default()
            },
            Transform::from_xyz(0.3, 1.0, 0.3).looking_at(Vec3::ZERO, Vec3::Y),
        ))
        .id();
    let place =
        Transform::from_xyz(160.0, 80.0, 230.0).looking_at(Vec3::new(160.0, 20.0, 160.0), Vec3::Y);
    let (camera, target) = add_camera(&mut offline, (Msaa::Off, place));
    add_box(&mut offline, Vec3::new(160.0, 50.0, 160.0), 25.0);
    hits(&mut offline, camera);
    offline.step();
    let brightness = |picture: &image::RgbaImage| {
        picture
            .pixels()
            .filter(|p| !is_red(p))
            .map(|p| u64::from(p[1]))
            .sum::<u64>()
    };
    let shadowed = brightness(&offline.picture(&target).unwrap());
    offline
        .app
        .world_mut()
        .get_mut::<DirectionalLight>(sun)
        .unwrap()
        .shadow_maps_enabled = false;
    offline.step();
    offline.step();
    let plain = brightness(&offline.picture(&target).unwrap());
    assert!(
        shadowed * 101 < plain * 100,
        "no shadow falls on the terrain: {shadowed} of {plain}"
    );

    offline
        .app
        .world_mut()
        .entity_mut(camera)
        .insert(DistanceFog {
            color: Color::srgb(0.0, 0.0, 1.0),
            falloff: FogFalloff::Linear {
                start: 10.0,
                end: 100.0,
            },
            ..default()
        });
    offline.step();
    offline.step();
    let picture = offline.picture(&target).unwrap();
    assert!(
        picture.get_pixel(5, 60)[2] > 100,
        "no fog: {:?}",
        picture.get_pixel(5, 60)
    );
}

/// The limit of a view is not one of the world.
#[test]
fn terrains_out_of_view_take_nobodys_place() {
    let Some(mut offline) = crate::device() else {
        return;
    };
    let world = offline.app.world_mut();
    let field = world.resource_mut::<Assets<HeightField>>().add(flat(20.0));
    let look = TerrainLook {
        colour: TerrainColour::Uniform(Color::srgb(0.1, 0.8, 0.1)),
        ..default()
    };
    let terrain = || Terrain::new(field.clone()).with_look(look.clone());
    for i in 0..300 {
        world.spawn((
            terrain(),
            Transform::from_xyz(0.0, 0.0, 1_000.0 + 400.0 * i as f32),
        ));
    }
    world.spawn((terrain(), Transform::IDENTITY));
    world.spawn((
        DirectionalLight::default(),
        Transform::default().looking_to(Vec3::new(-0.5, -1.0, -0.3), Vec3::Y),
    ));
    let place =
        Transform::from_xyz(160.0, 60.0, 300.0).looking_at(Vec3::new(160.0, 20.0, 160.0), Vec3::Y);
    let (camera, target) = add_camera(&mut offline, (Msaa::Off, place));
    for _ in 0..6 {
        offline.step();
    }
    let drawn = offline.hits(camera).unwrap();
    assert!(drawn.is_some_and(|hits| hits.terrain_px() > 500));
    let green = count(&offline.picture(&target).unwrap(), is_green);
    assert!(green > 500, "{green} pixels of ground");
}

#[test]
fn terrain_hides_meshes_from_bevys_own_occlusion_culling() {
    // A wall of ground before many boxes: Bevy's GPU culling must drop them all and nothing in front.
    let ridge = HeightField::from_fn(UVec2::new(65, 65), 5.0, (0.0, 200.0), |_, z| {
        if (30..34).contains(&z) { 150.0 } else { 0.0 }
    })
    .unwrap();
    let Some((mut offline, _)) = with_terrain(ridge) else {
        return;
    };
    for i in 0..40 {
        add_box(
            &mut offline,
            Vec3::new(20.0 + 7.0 * i as f32, 10.0, 60.0),
            5.0,
        );
    }
    let shown = add_box(&mut offline, Vec3::new(160.0, 20.0, 250.0), 12.0);
    let (camera, target) = add_camera(
        &mut offline,
        (
            Msaa::Off,
            DepthPrepass,
            OcclusionCulling,
            Transform::from_xyz(160.0, 40.0, 310.0)
                .looking_at(Vec3::new(160.0, 30.0, 0.0), Vec3::Y),
        ),
    );
    hits(&mut offline, camera);
    for _ in 0..4 {
        offline.step();
    }
    let with = offline.picture(&target).unwrap();
    assert!(
        count(&with, is_red) > 10,
        "the box before the ridge is gone"
    );
    offline
        .app
        .world_mut()
        .entity_mut(camera)
        .remove::<OcclusionCulling>();
    for _ in 0..3 {
        offline.step();
    }
    let without = offline.picture(&target).unwrap();
    assert_eq!(count(&with, is_red), count(&without, is_red));
    offline.app.world_mut().despawn(shown);
    for _ in 0..3 {
        offline.step();
    }
    assert_eq!(
        count(&offline.picture(&target).unwrap(), is_red),
        0,
        "boxes show through the ridge"
    );
}

#[test]
fn two_cameras_two_viewports_and_two_terrains_at_once() {
    let Some((mut offline, _)) = with_terrain(hills()) else {
        return;
    };
    let second = add_terrain(
        &mut offline,
        flat(30.0),
        Transform::from_xyz(60.0, 25.0, 60.0).with_scale(Vec3::new(0.5, 1.0, 0.5)),
    );
    let target = offline.target(UVec2::new(128, 64));
    let half = |x| Viewport {
        physical_position: UVec2::new(x, 0),
        physical_size: UVec2::new(64, 64),
        ..default()
    };
    let left = offline.camera(
        &target,
        (
            Msaa::Off,
            eye(),
            Camera {
                viewport: Some(half(0)),
                ..default()
            },
        ),
    );
    let right = offline.camera(
        &target,
        (
            Msaa::Off,
            eye(),
            Camera {
                viewport: Some(half(64)),
                order: 1,
                clear_color: ClearColorConfig::None,
                ..default()
            },
            TerrainRayCasting {
                traversal: Traversal::MaxMip,
                ..default()
            },
        ),
    );
    let a = hits(&mut offline, left);
    let b = hits(&mut offline, right);
    assert_eq!(a.size, UVec2::new(64, 64));
    let differ = a
        .ndc_depth
        .iter()
        .zip(&b.ndc_depth)
        .filter(|(a, b)| (*a - *b).abs() > 1e-4 * *a)
        .count();
    assert!(
        differ * 50 < a.ndc_depth.len(),
        "{differ} pixels differ between the cameras"
    );
    let ids = |image: &HitImage| {
        let mut ids: Vec<_> = image.surface.iter().map(|s| s & 0xff).collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    };
    assert_eq!(ids(&a), [0, 1, 2], "both terrains and the sky");
    offline.step();
    let picture = offline.picture(&target).unwrap();
    let half_green = |from| {
        (from..from + 64)
            .flat_map(|x| (0..64).map(move |y| (x, y)))
            .filter(|(x, y)| is_green(picture.get_pixel(*x, *y)))
            .count()
    };
    assert!(half_green(0) > 500 && half_green(0).abs_diff(half_green(64)) < 40);
    offline.app.world_mut().despawn(second);
    offline.step();
    offline.step();
    assert_eq!(ids(&hits(&mut offline, left)), [0, 1]);
}

#[test]
fn a_picked_pixel_and_the_query_agree() {
    let Some((mut offline, terrain)) = with_terrain(hills()) else {
        return;
    };
    *offline
        .app
        .world_mut()
        .get_mut::<Transform>(terrain)
        .unwrap() = Transform::from_xyz(-50.0, 7.0, 20.0)
        .with_rotation(Quat::from_euler(EulerRot::YXZ, 0.4, 0.1, -0.05))
        .with_scale(Vec3::new(1.2, 0.8, 1.0));
    let casting = TerrainRayCasting {
        max_error_px: 0.0,
        ..default()
    };
    for projection in [
        Projection::default(),
        Projection::from(OrthographicProjection {
            scaling_mode: ScalingMode::FixedVertical {
                viewport_height: 150.0,
            },
            ..OrthographicProjection::default_3d()
        }),
    ] {
        let (camera, _) = add_camera(&mut offline, (Msaa::Off, eye(), casting, projection));
        let image = hits(&mut offline, camera);
        let world = offline.app.world_mut();
        let (found, transform) = {
            let mut query = world.query::<(&Camera, &GlobalTransform)>();
            let (found, transform) = query.get(world, camera).unwrap();
            (found.clone(), *transform)
        };
        let clip_from_view = found.clip_from_view();
        let mut compared = 0;
        for y in (3..SIZE.y).step_by(7) {
            for x in (3..SIZE.x).step_by(7) {
                let ray = found
                    .viewport_to_world(&transform, Vec2::new(x as f32, y as f32) + 0.5)
                    .unwrap();
                let hit = world
                    .run_system_cached_with(
                        |ray: In<Ray3d>, terrain: TerrainQuery| terrain.ray_cast(*ray, 1e5),
                        ray,
                    )
                    .unwrap();
                let ndc = image.ndc_depth[(y * SIZE.x + x) as usize];
                assert_eq!(hit.is_some(), ndc > 0.0, "pixel {x},{y}");
                let Some(hit) = hit else { continue };
                let view = transform.affine().inverse().transform_point3(hit.point);
                let clip = clip_from_view * view.extend(1.0);
                let (queried, drawn) = (clip.z / clip.w, ndc);
                assert!(
                    (queried - drawn).abs() <= 1e-3 * drawn.max(1e-3),
                    "pixel {x},{y}: {queried} and {drawn}"
                );
                assert_eq!(hit.entity, terrain);
                compared += 1;
            }
        }
        assert!(compared > 30, "only {compared} pixels hit");
        offline.app.world_mut().despawn(camera);
        offline.step();
    }
}

#[test]
fn an_edit_uploads_and_recomputes_only_its_rectangle_and_the_picture_follows() {
    let Some((mut offline, terrain)) = with_terrain(hills()) else {
        return;
    };
    let (camera, _) = add_camera(
        &mut offline,
        (
            Msaa::Off,
            eye(),
            TerrainRayCasting {
                max_error_px: 0.0,
                ..default()
            },
        ),
    );
    let before = hits(&mut offline, camera);
    let whole = stats(&offline).passes["height_mips"];
    offline.step();
    assert_eq!(
        stats(&offline).passes["height_mips"],
        whole,
        "mips are made without an edit"
    );

    let id = offline
        .app
        .world()
        .get::<Terrain>(terrain)
        .unwrap()
        .height_field
        .id();
    let rect = URect::new(40, 50, 60, 61);
    let edited = {
        let mut fields = offline
            .app
            .world_mut()
            .resource_mut::<Assets<HeightField>>();
        let mut field = fields.get_mut(id).unwrap();
        field
            .edit(rect, |x, z, h| {
                h + if (x + z) % 3 == 0 { 15.0 } else { -3.0 }
            })
            .unwrap();
        field.clone()
    };
    let after = hits(&mut offline, camera);
    let counted = stats(&offline).passes["height_mips"];
    let nodes = counted.work - whole.work;
    assert!(
        nodes > 0 && nodes * 4 < whole.work,
        "{nodes} of {} nodes recomputed",
        whole.work
    );
    assert_ne!(before.ndc_depth, after.ndc_depth);

    // The same picture as a field made so from the start, and the same pyramid.
    let fresh = match edited.samples() {
        bevy_skyline::terrain::HeightSamples::U16(samples) => HeightField::from_u16(
            edited.size(),
            edited.texel_m(),
            edited.height_range_m(),
            samples.clone(),
        )
        .unwrap(),
        bevy_skyline::terrain::HeightSamples::F32(_) => unreachable!("hills() is of u16"),
    };
    let gpu = offline.pyramid(id).unwrap().unwrap();
    match fresh.pyramid().nodes() {
        PyramidNodes::U16(nodes) => assert_eq!(bytemuck::cast_slice::<u32, u8>(nodes), gpu),
        PyramidNodes::F32(_) => unreachable!("hills() is of u16"),
    }
    offline.app.world_mut().despawn(terrain);
    add_terrain(&mut offline, fresh, Transform::IDENTITY);
    assert_eq!(hits(&mut offline, camera).ndc_depth, after.ndc_depth);
}

#[test]
fn the_gpu_pyramid_is_the_cpu_pyramid_for_every_shape_and_type() {
    let Some(mut offline) = crate::device() else {
        return;
    };
    let (camera, _) = add_camera(&mut offline, (Msaa::Off, eye()));
    for (w, h, float) in [
        (2, 2, false),
        (2, 9, false),
        (3, 3, true),
        (17, 33, false),
        (100, 37, true),
        (129, 65, false),
    ] {
        let value = |x: u32, z: u32| ((x * 7919 + z * 104_729) % 997) as f32 / 10.0;
        let field = if float {
            let samples = (0..w * h).map(|i| value(i % w, i / w) - 50.0).collect();
            HeightField::from_f32(UVec2::new(w, h), 400.0 / w as f32, samples).unwrap()
        } else {
            HeightField::from_fn(UVec2::new(w, h), 400.0 / w as f32, (0.0, 100.0), value).unwrap()
        };
        let expected: Vec<u8> = match field.pyramid().nodes() {
            PyramidNodes::U16(nodes) => bytemuck::cast_slice(nodes).to_vec(),
            PyramidNodes::F32(nodes) => bytemuck::cast_slice(nodes).to_vec(),
        };
        let terrain = add_terrain(&mut offline, field, Transform::IDENTITY);
        offline.settle(camera, 10).unwrap();
        let id = offline
            .app
            .world()
            .get::<Terrain>(terrain)
            .unwrap()
            .height_field
            .id();
        assert_eq!(
            offline.pyramid(id).unwrap().unwrap(),
            expected,
            "{w}×{h}, float {float}"
        );
        offline.app.world_mut().despawn(terrain);
        offline.step();
    }
}

#[test]
fn a_resized_target_is_followed() {
    let Some((mut offline, _)) = with_terrain(hills()) else {
        return;
    };
    let (camera, _) = add_camera(&mut offline, (Msaa::Off, eye()));
    assert_eq!(hits(&mut offline, camera).size, SIZE);
    let larger = UVec2::new(131, 77);
    let target = offline.target(larger);
    offline
        .app
        .world_mut()
        .entity_mut(camera)
        .insert(RenderTarget::Image(target.into()));
    offline.step();
    offline.step();
    assert_eq!(hits(&mut offline, camera).size, larger);
}

#[test]
fn the_allowed_error_is_kept() {
    use bevy_skyline::{
        reference::ray_cast::Twin,
        terrain::view_rays::{ViewInputs, ViewRays},
    };
    let Some(mut offline) = crate::device() else {
        return;
    };
    let field = match crate::data::elevation_model("taiwan_central_range_1024") {
        Some(field) => field,
        None => hills(),
    };
    let extent = field.extent_m();
    let place = Transform::from_xyz(extent.x * 0.35, 3_500.0, extent.y * 0.7)
        .looking_at(Vec3::new(extent.x * 0.6, 1_000.0, extent.y * 0.2), Vec3::Y);
    add_terrain(&mut offline, field.clone(), Transform::IDENTITY);
    let size = UVec2::new(320, 180);
    let target = offline.target(size);
    let camera = offline.camera(&target, (Msaa::Off, place, TerrainRayCasting::default()));
    let twin = Twin::new(&field);
    let mut last_reads = f64::INFINITY;
    let exact = cast_with(&mut offline, camera, Traversal::MaxMip, 0.0);
    for error_px in [0.5, 1.0, 2.0, 4.0, 16.0] {
        for traversal in [Traversal::Hybrid, Traversal::MaxMip, Traversal::Boxes] {
            let image = cast_with(&mut offline, camera, traversal, error_px);
            let clip_from_view = offline
                .app
                .world()
                .get::<Camera>(camera)
                .unwrap()
                .clip_from_view();
            let (highest, lowest) = field.pyramid().top();
            let rays = ViewRays::new(&ViewInputs {
                clip_from_view,
                grid_from_view: field.grid_from_local()
                    * bevy::math::DAffine3::from_mat4(place.to_matrix().as_dmat4()),
                size_px: size,
                cells: field.cells(),
                height_range: (lowest, highest),
                whole_heights: true,
                max_error_px: error_px,
            })
            .unwrap();
            let (mut worst, mut compared): (f64, u32) = (0.0, 0);
            let mut silhouette: u32 = 0;
            for y in 0..size.y {
                for x in 0..size.x {
                    let index = (y * size.x + x) as usize;
                    let ndc = image.ndc_depth[index];
                    let pixel = Vec2::new(x as f32, y as f32) + 0.5;
                    if ndc > 0.0 {
                        let t = rays.view_depth(ndc) - f64::from(rays.t_base);
                        assert!(t < f64::from(T_NEVER));
                        worst = worst.max(twin.displacement_px(&rays, pixel, t));
                        compared += 1;
                    }
                    if (ndc > 0.0) != (exact.ndc_depth[index] > 0.0) {
                        silhouette = silhouette.max(nearest_equal(&exact, x, y, ndc > 0.0));
                    }
                }
            }
            println!(
                "{traversal:?} at {error_px} px: {worst:.3} px off at worst, silhouette {silhouette} px, {:.2} reads",
                image.mean_reads()
            );
            assert!(compared > 10_000);
            // A hundredth of a pixel for what rounding adds to the hit itself.
            assert!(
                worst <= f64::from(error_px) + 0.01,
                "{traversal:?}: {worst} px off at {error_px}"
            );
            assert!(
                f64::from(silhouette) <= f64::from(error_px) + 1.5,
                "silhouette {silhouette} px off"
            );
            if traversal == Traversal::MaxMip {
                assert!(image.mean_reads() <= last_reads, "more error, more reads");
                last_reads = image.mean_reads();
            }
        }
    }
    assert!(
        last_reads < exact.mean_reads() * 0.95,
        "an allowed error saves nothing"
    );
}

#[test]
fn from_inside_the_ground_the_picture_is_exact_whatever_error_is_allowed() {
    let Some((mut offline, _)) = with_terrain(hills()) else {
        return;
    };
    let place =
        Transform::from_xyz(200.0, -30.0, 380.0).looking_at(Vec3::new(200.0, 25.0, 200.0), Vec3::Y);
    let (camera, _) = add_camera(&mut offline, (Msaa::Off, place));
    let exact = cast_with(&mut offline, camera, Traversal::PerTexel, 0.0);
    let seen = exact.terrain_px();
    assert!(seen > 50, "only {seen} rays fall again after coming out");
    for traversal in [Traversal::Hybrid, Traversal::MaxMip, Traversal::Boxes] {
        let image = cast_with(&mut offline, camera, traversal, 4.0);
        assert_eq!(image.ndc_depth, exact.ndc_depth, "{traversal:?}");
    }
}

#[test]
fn a_flat_field_is_one_colour() {
    let Some((mut offline, terrain)) = with_terrain(flat(20.0)) else {
        return;
    };
    offline
        .app
        .world_mut()
        .get_mut::<Terrain>(terrain)
        .unwrap()
        .look = TerrainLook::default();
    let (camera, target) = add_camera(
        &mut offline,
        (
            Msaa::Off,
            Transform::from_xyz(160.0, 90.0, 160.0).looking_to(Vec3::NEG_Y, Vec3::NEG_Z),
        ),
    );
    hits(&mut offline, camera);
    offline.step();
    let picture = offline.picture(&target).unwrap();
    let middle = *picture.get_pixel(48, 32);
    let unlike = picture
        .pixels()
        .filter(|pixel| (0..3).any(|i| pixel[i].abs_diff(middle[i]) > 12))
        .count();
    assert_eq!(unlike, 0, "a flat field has more than one colour");
}

fn cast_with(
    offline: &mut Offline,
    camera: Entity,
    traversal: Traversal,
    max_error_px: f32,
) -> HitImage {
    offline
        .app
        .world_mut()
        .entity_mut(camera)
        .insert(TerrainRayCasting {
            traversal,
            max_error_px,
            ..default()
        });
    offline.step();
    offline.step();
    hits(offline, camera)
}

/// Distance to the nearest pixel that is terrain, or sky, as asked. units: px
fn nearest_equal(image: &HitImage, x: u32, y: u32, terrain: bool) -> u32 {
    let (x, y) = (x as i32, y as i32);
    let size = image.size.as_ivec2();
    (0i32..64)
        .find(|r| {
            (-r..=*r).any(|dy| {
                (-r..=*r).any(|dx| {
                    let (px, py) = (x + dx, y + dy);
                    (0..size.x).contains(&px)
                        && (0..size.y).contains(&py)
                        && (image.ndc_depth[(py * size.x + px) as usize] > 0.0) == terrain
                })
            })
        })
        .unwrap_or(64) as u32
}
