//! Terrain among the casters of Bevy's shadow cascades: what stands in its shadow, what doesn't, and what it
//! costs when nothing changes.

use core::f32::consts::FRAC_PI_2;

use bevy::{
    camera::visibility::RenderLayers,
    light::{CascadeShadowConfigBuilder, DirectionalLightShadowMap, ShadowFilteringMethod},
    math::URect,
    prelude::*,
    render::RenderApp,
};
use bevy_skyline::{
    offline::Offline,
    prelude::*,
    render_graph::{
        cascades::prepare_terrain_cascades,
        stats::{TerrainCounts, TerrainStats},
    },
    terrain_shadow::TerrainShadow,
};

const SIZE: UVec2 = UVec2::new(160, 120);

/// One terrain, one sun, one camera, and maps small enough to be quick.
struct Scene {
    offline: Offline,
    terrain: Entity,
    sun: Entity,
    camera: Entity,
    picture: Handle<Image>,
}

fn shadow() -> TerrainShadow {
    TerrainShadow::default()
}

/// A sun whose light comes from `azimuth_deg` (0 = from +X, 90 = from +Z) at an elevation.
fn sun_at(azimuth_deg: f32, elevation_deg: f32) -> Transform {
    let (azimuth, elevation) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
    let to_light = Vec3::new(
        azimuth.cos() * elevation.cos(),
        elevation.sin(),
        azimuth.sin() * elevation.cos(),
    );
    let up = if elevation.abs() > FRAC_PI_2 - 1e-3 {
        Vec3::X
    } else {
        Vec3::Y
    };
    Transform::default().looking_to(-to_light, up)
}

impl Scene {
    fn new(field: HeightField, eye: Transform, far_m: f32, sun: Transform) -> Option<Self> {
        let mut offline = crate::device()?;
        let picture = offline.target(SIZE);
        let camera = offline.camera(&picture, (Msaa::Off, eye));
        let world = offline.app.world_mut();
        world.insert_resource(DirectionalLightShadowMap { size: 512 });
        world.insert_resource(GlobalAmbientLight {
            brightness: 100.0,
            ..default()
        });
        let handle = world.resource_mut::<Assets<HeightField>>().add(field);
        let terrain = world
            .spawn(Terrain::new(handle).with_look(TerrainLook {
                colour: TerrainColour::Uniform(Color::srgb(0.5, 0.5, 0.5)),
                ..default()
            }))
            .id();
        let sun = world
            .spawn((
                DirectionalLight {
                    illuminance: 8_000.0,
                    shadow_maps_enabled: true,
                    ..default()
                },
                CascadeShadowConfigBuilder {
                    num_cascades: 3,
                    maximum_distance: far_m,
                    first_cascade_far_bound: 0.1 * far_m,
                    ..default()
                }
                .build(),
                sun,
            ))
            .id();
        Some(Self {
            offline,
            terrain,
            sun,
            camera,
            picture,
        })
    }

    fn world(&mut self) -> &mut World {
        self.offline.app.world_mut()
    }

    /// A red cube that is lit.
    fn add_cube(&mut self, at: Vec3, size: f32) -> Entity {
        let world = self.world();
        let mesh = world
            .resource_mut::<Assets<Mesh>>()
            .add(Cuboid::from_length(size));
        let material = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial {
                base_color: Color::srgb(0.9, 0.0, 0.0),
                perceptual_roughness: 1.0,
                reflectance: 0.0,
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

    fn set_sun(&mut self, sun: Transform) {
        let entity = self.sun;
        *self.world().get_mut::<Transform>(entity).unwrap() = sun;
    }

    fn cast_shadows(&mut self, shadow: Option<TerrainShadow>) {
        let terrain = self.terrain;
        let mut terrain = self.world().entity_mut(terrain);
        match shadow {
            Some(shadow) => terrain.insert(shadow),
            None => terrain.remove::<TerrainShadow>(),
        };
    }

    fn counts(&self) -> TerrainCounts {
        self.offline
            .app
            .world()
            .resource::<TerrainStats>()
            .lock()
            .clone()
    }

    fn runs(&self, pass: &str) -> u64 {
        self.counts().passes.get(pass).map_or(0, |count| count.runs)
    }

    fn steps(&mut self, count: u32) {
        for _ in 0..count {
            self.offline.step();
        }
    }

    /// A picture of the scene as it is now, kept in the directory that SKYLINE_PICTURES names, if it is set.
    fn picture(&mut self, name: &str) -> image::RgbaImage {
        self.offline.settle(self.camera, 10).unwrap();
        self.steps(2);
        let picture = self.offline.picture(&self.picture).unwrap();
        if let Some(directory) = std::env::var_os("SKYLINE_PICTURES") {
            let path = std::path::Path::new(&directory).join(format!("cascade_{name}.png"));
            picture.save(path).unwrap();
        }
        picture
    }
}

/// Mean red of the pixels that are red.
fn cube_brightness(picture: &image::RgbaImage, least_px: usize) -> f64 {
    let red: Vec<f64> = picture
        .pixels()
        .filter(|pixel| {
            let [r, g, b] = [0, 1, 2].map(|i| i32::from(pixel[i]));
            r > 2 * g + 8 && r > 2 * b + 8
        })
        .map(|pixel| f64::from(pixel[0]))
        .collect();
    assert!(red.len() >= least_px, "{} pixels of the cube", red.len());
    red.iter().sum::<f64>() / red.len() as f64
}

/// A plain at 10 m with a ridge along Z in the middle of it, 50 m high.
fn ridge() -> HeightField {
    HeightField::from_fn(UVec2::new(129, 129), 2.0, (0.0, 100.0), |x, _| {
        let from_ridge = (x as f32 - 64.0).abs() / 12.0;
        10.0 + 50.0 * (1.0 - from_ridge).max(0.0)
    })
    .unwrap()
}

/// Looks at the plain on the -X side of the ridge.
fn ridge_scene() -> Option<Scene> {
    let eye =
        Transform::from_xyz(40.0, 40.0, 180.0).looking_at(Vec3::new(80.0, 16.0, 128.0), Vec3::Y);
    Scene::new(ridge(), eye, 200.0, sun_at(0.0, 20.0))
}

#[test]
fn a_mesh_behind_a_hill_stands_in_its_shadow() {
    let Some(mut scene) = ridge_scene() else {
        return;
    };
    scene.add_cube(Vec3::new(80.0, 18.0, 128.0), 14.0);
    let without = cube_brightness(&scene.picture("without"), 100);
    scene.cast_shadows(Some(shadow()));
    let with = cube_brightness(&scene.picture("with"), 100);
    assert!(scene.runs("terrain_cascade") > 0);
    scene.set_sun(sun_at(180.0, 20.0));
    let other_side = cube_brightness(&scene.picture("other_side"), 100);
    scene.cast_shadows(None);
    let other_side_without = cube_brightness(&scene.picture("other_side_without"), 100);
    println!("{without} {with} {other_side} {other_side_without}");
    assert!(with < 0.75 * without, "in shadow {with}, lit {without}");
    assert!(
        (other_side - other_side_without).abs() < 1.0,
        "on the sunny side {other_side}, without terrain {other_side_without}"
    );
}

/// How much darker any pixel that isn't the cube's gets by terrain being a caster.
fn most_darkened(before: &image::RgbaImage, after: &image::RgbaImage) -> i32 {
    let mut most = 0;
    for (a, b) in before.pixels().zip(after.pixels()) {
        let [r, g, _] = [0, 1, 2].map(|i| i32::from(a[i]));
        if r <= 2 * g + 8 {
            most = most.max(
                (0..3)
                    .map(|i| i32::from(a[i]) - i32::from(b[i]))
                    .max()
                    .unwrap_or(0),
            );
        }
    }
    most
}

/// A plane through 130 m in its middle, with the given slopes.
fn plane(slope: Vec2) -> HeightField {
    HeightField::from_fn(UVec2::new(129, 129), 4.0, (0.0, 260.0), |x, z| {
        let from_middle = UVec2::new(x, z).as_vec2() * 4.0 - 256.0;
        130.0 + slope.dot(from_middle)
    })
    .unwrap()
}

/// A valley whose floor lies along Z, curved or with a sharp floor.
fn valley(slope: f32, sharp: bool) -> HeightField {
    HeightField::from_fn(UVec2::new(129, 129), 4.0, (0.0, 260.0), |x, _| {
        let x = ((x as f32 - 64.0) / 64.0).abs();
        130.0 + 256.0 * slope * if sharp { x } else { 0.5 * x * x }
    })
    .unwrap()
}

#[test]
fn sunlit_ground_is_not_darkened_by_itself() {
    // Slope along x, seen from every side by suns at +X, +Z and between.
    let fields = [
        ("flat", plane(Vec2::ZERO), [Vec2::ZERO; 2]),
        (
            "gentle",
            plane(Vec2::new(-0.06, 0.0)),
            [Vec2::new(-0.06, 0.0); 2],
        ),
        (
            "steep",
            plane(Vec2::new(0.4, 0.1)),
            [Vec2::new(0.4, 0.1); 2],
        ),
        (
            "valley",
            valley(0.3, false),
            [Vec2::new(-0.3, 0.0), Vec2::new(0.3, 0.0)],
        ),
        (
            "sharp_valley",
            valley(0.3, true),
            [Vec2::new(-0.3, 0.0), Vec2::new(0.3, 0.0)],
        ),
    ];
    let mut compared = 0;
    for (name, field, slopes) in fields {
        let middle = Vec3::new(256.0, 130.0, 256.0);
        let eye = Transform::from_translation(middle + Vec3::new(-40.0, 35.0, 90.0))
            .looking_at(middle, Vec3::Y);
        let Some(mut scene) = Scene::new(field, eye, 300.0, sun_at(0.0, 45.0)) else {
            return;
        };
        // In view, small, and far away.
        scene.add_cube(middle + Vec3::new(30.0, 45.0, -70.0), 3.0);
        for elevation in [89.0, 45.0, 20.0, 5.0] {
            for azimuth in [180.0, 90.0, 30.0] {
                let sun = sun_at(azimuth, elevation);
                // Slopes that face away from the sun are truly in shadow.
                let lit = |slope: &Vec2| sun.back().dot(Vec3::new(-slope.x, 1.0, -slope.y)) > 0.01;
                if !slopes.iter().all(lit) {
                    continue;
                }
                compared += 1;
                scene.set_sun(sun);
                for bias in [true, false] {
                    let sun = scene.sun;
                    let mut light = scene.world().get_mut::<DirectionalLight>(sun).unwrap();
                    let kept = (light.shadow_depth_bias, light.shadow_normal_bias);
                    if !bias {
                        (light.shadow_depth_bias, light.shadow_normal_bias) = (0.0, 0.0);
                    }
                    scene.cast_shadows(None);
                    let before = scene.picture(&format!("{name}_{elevation}_{azimuth}_before"));
                    scene.cast_shadows(Some(shadow()));
                    let runs = scene.runs("terrain_cascade");
                    let after =
                        scene.picture(&format!("{name}_{elevation}_{azimuth}_after_{bias}"));
                    assert!(scene.runs("terrain_cascade") > runs, "nothing was drawn");
                    let most = most_darkened(&before, &after);
                    println!("{name}, sun {azimuth} {elevation}, bias {bias}: darker by {most}");
                    assert!(
                        most <= 1,
                        "{name}, sun {azimuth} {elevation}, bias {bias}: darker by {most}"
                    );
                    let mut light = scene.world().get_mut::<DirectionalLight>(sun).unwrap();
                    (light.shadow_depth_bias, light.shadow_normal_bias) = kept;
                }
            }
        }
    }
    assert!(compared > 40, "{compared} scenes");
}

#[test]
fn shaded_ground_is_told_from_sunlit_ground() {
    let Some(mut scene) = ridge_scene() else {
        return;
    };
    scene.add_cube(Vec3::new(80.0, 18.0, 128.0), 4.0);
    let before = scene.picture("ridge_before");
    scene.cast_shadows(Some(shadow()));
    let after = scene.picture("ridge_after");
    assert!(most_darkened(&before, &after) > 20);
}

#[test]
fn standing_still_casts_nothing_and_allocates_nothing() {
    let Some(mut scene) = ridge_scene() else {
        return;
    };
    scene.add_cube(Vec3::new(80.0, 18.0, 128.0), 4.0);
    scene.cast_shadows(Some(shadow()));
    scene.picture("standing");
    let before = (
        scene.runs("terrain_cascade_cast"),
        scene.runs("terrain_cascade"),
    );
    assert_eq!(before.0, 3, "a cast for each cascade");
    scene.steps(5);
    assert_eq!(scene.runs("terrain_cascade_cast"), before.0);
    assert_eq!(scene.runs("terrain_cascade"), before.1 + 5 * 3);

    let world = scene.offline.app.sub_app_mut(RenderApp).world_mut();
    let prepare = world.register_system(prepare_terrain_cascades);
    world.run_system(prepare).unwrap();
    let allocations = crate::allocations::count(|| {
        for _ in 0..10 {
            world.run_system(prepare).unwrap();
        }
    });
    assert_eq!(allocations, 0);

    // A step to the side stays within what was cast for the larger cascades.
    let camera = scene.camera;
    scene
        .world()
        .get_mut::<Transform>(camera)
        .unwrap()
        .translation
        .x += 0.5;
    scene.steps(1);
    assert_eq!(scene.runs("terrain_cascade_cast"), before.0);
    scene
        .world()
        .get_mut::<Transform>(camera)
        .unwrap()
        .translation
        .x += 30.0;
    scene.steps(1);
    let moved = scene.runs("terrain_cascade_cast");
    assert!(moved > before.0);

    scene.set_sun(sun_at(3.0, 20.0));
    scene.steps(1);
    let turned = scene.runs("terrain_cascade_cast");
    assert_eq!(turned, moved + 3);
    scene.steps(3);
    assert_eq!(scene.runs("terrain_cascade_cast"), turned);

    let terrain = scene.terrain;
    let handle = scene
        .world()
        .get::<Terrain>(terrain)
        .unwrap()
        .height_field
        .clone();
    scene
        .world()
        .resource_mut::<Assets<HeightField>>()
        .get_mut(&handle)
        .unwrap()
        .edit(URect::new(10, 10, 12, 12), |_, _, _| 5.0)
        .unwrap();
    scene.steps(2);
    let edited = scene.runs("terrain_cascade_cast");
    assert_eq!(edited, turned + 3);
    scene
        .world()
        .get_mut::<Transform>(terrain)
        .unwrap()
        .translation
        .y += 1.0;
    scene.steps(1);
    assert_eq!(scene.runs("terrain_cascade_cast"), edited + 3);
}

#[test]
fn nothing_runs_where_nothing_could_be_seen() {
    fn check(what: &str, cube: bool, change: impl FnOnce(&mut Scene)) {
        let Some(mut scene) = ridge_scene() else {
            return;
        };
        if cube {
            scene.add_cube(Vec3::new(80.0, 18.0, 128.0), 4.0);
        }
        change(&mut scene);
        scene.steps(4);
        let counts = scene.counts();
        let runs = counts
            .passes
            .iter()
            .filter(|(name, _)| name.starts_with("terrain_cascade"))
            .count();
        assert_eq!((runs, counts.cascade_bytes), (0, 0), "{what}: {counts:?}");
    }
    check("no shadow", true, |_| {});
    check("not on meshes", true, |scene| {
        scene.cast_shadows(Some(TerrainShadow {
            on_meshes: false,
            ..shadow()
        }));
    });
    check("no mesh in view", false, |scene| {
        scene.cast_shadows(Some(shadow()))
    });
    check("no shadow maps", true, |scene| {
        scene.cast_shadows(Some(shadow()));
        let sun = scene.sun;
        scene
            .world()
            .get_mut::<DirectionalLight>(sun)
            .unwrap()
            .shadow_maps_enabled = false;
    });
    check("hidden", true, |scene| {
        scene.cast_shadows(Some(shadow()));
        let terrain = scene.terrain;
        scene.world().entity_mut(terrain).insert(Visibility::Hidden);
    });
    check("layers of no light", true, |scene| {
        scene.cast_shadows(Some(shadow()));
        let terrain = scene.terrain;
        scene
            .world()
            .entity_mut(terrain)
            .insert(RenderLayers::layer(3));
    });
}

#[test]
fn what_is_gone_leaves_nothing_behind() {
    fn check(what: &str, remove: impl FnOnce(&mut Scene)) {
        let Some(mut scene) = ridge_scene() else {
            return;
        };
        scene.add_cube(Vec3::new(80.0, 18.0, 128.0), 4.0);
        scene.cast_shadows(Some(shadow()));
        scene.steps(4);
        assert!(scene.counts().cascade_bytes > 0);
        remove(&mut scene);
        scene.steps(3);
        let counts = scene.counts();
        assert_eq!(counts.cascade_bytes, 0, "{what}");
        scene.steps(2);
        assert_eq!(
            scene.counts().passes.get("terrain_cascade"),
            counts.passes.get("terrain_cascade")
        );
    }
    check("terrain", |scene| {
        let terrain = scene.terrain;
        scene.world().despawn(terrain);
    });
    check("light", |scene| {
        let sun = scene.sun;
        scene.world().despawn(sun);
    });
    check("camera", |scene| {
        let camera = scene.camera;
        scene.world().despawn(camera);
    });
}

#[test]
fn every_filter_and_several_cameras_and_terrains_work_together() {
    for filter in [
        ShadowFilteringMethod::Hardware2x2,
        ShadowFilteringMethod::Gaussian,
        ShadowFilteringMethod::Temporal,
    ] {
        let Some(mut scene) = ridge_scene() else {
            return;
        };
        let camera = scene.camera;
        scene.world().entity_mut(camera).insert(filter);
        let eye = *scene.world().get::<Transform>(camera).unwrap();
        let other_target = scene.offline.target(SIZE);
        scene.offline.camera(&other_target, (eye, filter));
        let world = scene.world();
        let handle = world
            .resource_mut::<Assets<HeightField>>()
            .add(plane(Vec2::ZERO));
        world.spawn((
            Terrain::new(handle),
            shadow(),
            Transform::from_xyz(256.0, -120.0, -256.0),
        ));
        scene.add_cube(Vec3::new(80.0, 18.0, 128.0), 14.0);
        scene.picture("warm");
        let lit = cube_brightness(&scene.picture("filter_without"), 100);
        scene.cast_shadows(Some(shadow()));
        let dark = cube_brightness(&scene.picture("filter_with"), 100);
        assert!(dark < 0.75 * lit, "{filter:?}: {dark} of {lit}");
        assert!(scene.runs("terrain_cascade_cast") >= 6);
    }
}

#[test]
fn far_from_the_origin_it_still_runs() {
    let Some(mut scene) = ridge_scene() else {
        return;
    };
    let offset = Vec3::new(1e7, 0.0, -1e7);
    let cube = scene.add_cube(Vec3::new(80.0, 18.0, 128.0), 14.0);
    let (terrain, camera) = (scene.terrain, scene.camera);
    for entity in [cube, terrain, camera] {
        scene
            .world()
            .get_mut::<Transform>(entity)
            .unwrap()
            .translation += offset;
    }
    scene.cast_shadows(Some(shadow()));
    scene.picture("far");
    assert!(scene.runs("terrain_cascade") > 0);
}
