//! App: terrain shadows in a headless Bevy app, frame by frame.

use bevy::{light::SunDisk, math::DVec3, prelude::*};
use bevy_skyline::{
    effects::EffectState,
    offline::{Offline, shadow::ShadowImage},
    prelude::*,
    render_graph::stats::TerrainCounts,
    terrain::HeightField,
    terrain_shadow::light::GridLight,
};

const SIZE: UVec2 = UVec2::new(160, 120);

/// Hills of 300 × 260 samples, 1.2 × 1 km.
fn hills() -> HeightField {
    HeightField::from_fn(UVec2::new(300, 260), 4.0, (0.0, 200.0), |i, j| {
        let (x, z) = (i as f32 * 0.06, j as f32 * 0.05);
        90.0 + 50.0 * x.sin() * z.cos() + 12.0 * (3.1 * x + z).sin()
    })
    .unwrap()
}

struct Scene {
    offline: Offline,
    terrain: Entity,
    sun: Entity,
    camera: Entity,
    target: Handle<Image>,
    field: Handle<HeightField>,
}

fn sun_at(elevation: f32) -> Transform {
    Transform::default().looking_to(
        -Vec3::new(elevation.cos(), elevation.sin(), 0.3 * elevation.cos()),
        Vec3::Y,
    )
}

/// From above, all of the terrain in view.
fn above() -> Transform {
    Transform::from_xyz(600.0, 1500.0, 520.0).looking_to(Vec3::NEG_Y, Vec3::NEG_Z)
}

impl Scene {
    fn new(shadow: impl Bundle, eye: Transform) -> Option<Self> {
        let mut offline = crate::device()?;
        let world = offline.app.world_mut();
        world.insert_resource(GlobalAmbientLight {
            brightness: 100.0,
            ..default()
        });
        let field = world.resource_mut::<Assets<HeightField>>().add(hills());
        let terrain = world.spawn((Terrain::new(field.clone()), shadow)).id();
        let sun = world
            .spawn((
                DirectionalLight {
                    shadow_maps_enabled: true,
                    ..default()
                },
                sun_at(0.25),
            ))
            .id();
        let target = offline.target(SIZE);
        let camera = offline.camera(&target, (Msaa::Off, eye));
        Some(Self {
            offline,
            terrain,
            sun,
            camera,
            target,
            field,
        })
    }

    fn counts(&self) -> TerrainCounts {
        self.offline.counts()
    }

    /// Shadow dispatches so far.
    fn runs(&self) -> u64 {
        ["terrain_shadow", "shadow_sweep"]
            .iter()
            .filter_map(|pass| self.counts().passes.get(pass).map(|count| count.runs))
            .sum()
    }

    fn work(&self) -> u64 {
        let counts = self.counts();
        counts
            .passes
            .get("terrain_shadow")
            .map_or(0, |count| count.work)
    }

    fn state(&self) -> EffectState {
        self.offline
            .app
            .world()
            .resource::<Effects>()
            .terrain_shadow()
            .clone()
    }

    /// Frames until nothing is left to do.
    fn settle(&mut self) {
        self.offline.settle(self.camera, 10).unwrap();
        // A frame for what has just changed to be noticed.
        self.offline.step();
        self.offline.settle_shadows(2000).unwrap();
        assert!(self.counts().shadows.maps > 0, "{}", self.state());
    }

    fn map(&self) -> ShadowImage {
        self.offline
            .shadow_map(self.terrain, self.sun)
            .unwrap()
            .expect("no map shows")
    }

    /// What the map should be by now.
    fn fresh(&mut self) -> ShadowImage {
        let world = self.offline.app.world();
        let to_light = world.get::<GlobalTransform>(self.sun).unwrap().back();
        let field = world
            .resource::<Assets<HeightField>>()
            .get(&self.field)
            .unwrap();
        let grid = field.local_from_grid();
        let light = GridLight::directional(Vec3::from(to_light).as_dvec3(), 0.0, grid);
        self.offline
            .cast_shadow(self.field.id(), &light, ShadowMethod::MaxMip, 0, 1)
            .unwrap()
            .0
    }

    fn turn_sun(&mut self, elevation: f32) {
        *self
            .offline
            .app
            .world_mut()
            .get_mut::<Transform>(self.sun)
            .unwrap() = sun_at(elevation);
    }

    fn edit(&mut self, rect: URect, height_m: f32) {
        let mut fields = self
            .offline
            .app
            .world_mut()
            .resource_mut::<Assets<HeightField>>();
        let mut field = fields.get_mut(&self.field).unwrap();
        field.edit(rect, |_, _, _| height_m).unwrap();
    }

    fn brightness(&mut self) -> f64 {
        let picture = self.offline.picture(&self.target).unwrap();
        let sum: u64 = picture
            .pixels()
            .map(|p| u64::from(p[0]) + u64::from(p[1]) + u64::from(p[2]))
            .sum();
        sum as f64 / f64::from(SIZE.x * SIZE.y)
    }
}

#[test]
fn without_the_component_nothing_runs_and_nothing_is_held() {
    let Some(mut scene) = Scene::new((), above()) else {
        return;
    };
    scene.offline.settle(scene.camera, 10).unwrap();
    for _ in 0..5 {
        scene.offline.step();
    }
    assert_eq!(scene.state(), EffectState::Dormant);
    assert_eq!(scene.counts().shadows, default());
    assert_eq!(scene.runs(), 0);
}

#[test]
fn it_settles_to_the_exact_map_and_then_stands_still() {
    let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
        return;
    };
    scene.settle();
    assert!(scene.map() == scene.fresh());
    let before = scene.counts();
    for _ in 0..10 {
        scene.offline.step();
    }
    let after = scene.counts();
    for pass in [
        "terrain_shadow",
        "shadow_sweep",
        "shadow_mips",
        "height_mips",
    ] {
        assert_eq!(before.passes.get(pass), after.passes.get(pass), "{pass}");
    }
    assert!(
        matches!(scene.state(), EffectState::Idle(why) if why.starts_with("up to date: 1 maps")),
        "{}",
        scene.state()
    );
    // The buffer that maps are made in is given back after a rest.
    for _ in 0..60 {
        scene.offline.step();
    }
    // 300 × 260 samples are 5 × 5 tiles of 4096 bytes and a third of that for averages. The table that shading looks
    // lights up in has 48 bytes for each of 16, and 16 for their number.
    assert_eq!(scene.counts().shadows.bytes, 25 * 5464 + 16 * 48 + 16);
}

#[test]
fn every_tile_ends_with_its_averages() {
    let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
        return;
    };
    scene.settle();
    let (grid, bytes) = scene
        .offline
        .shadow_tiles(scene.terrain, scene.sun)
        .unwrap()
        .unwrap();
    let size = hills().size();
    let (mut compared, mut between) = (0, 0);
    for tile in 0..grid.len() {
        let samples = grid.samples(tile, size);
        let start = grid.byte(samples.min);
        let mut finer: Vec<u8> = bytes[start..start + 4096].to_vec();
        let mut last = samples.size() - 1;
        let mut offset = start + 4096;
        for level in 1..=6 {
            let side = 64usize >> level;
            let coarser: Vec<u8> = (0..side * side)
                .map(|n| {
                    let at = |x: usize, y: usize| {
                        let (x, y) = (x.min(last.x as usize), y.min(last.y as usize));
                        u32::from(finer[y * 2 * side + x])
                    };
                    let (x, y) = (n % side * 2, n / side * 2);
                    let (x, y) = (x.min(last.x as usize), y.min(last.y as usize));
                    let sum = at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1);
                    ((sum + 2) / 4) as u8
                })
                .collect();
            let made = &bytes[offset..offset + side * side];
            assert_eq!(made, coarser, "tile {tile}, level {level}");
            compared += coarser.len();
            between += coarser.iter().filter(|v| (1..255).contains(*v)).count();
            offset += side * side;
            last /= 2;
            finer = coarser;
        }
    }
    assert!(compared > 30_000 && between > 1000, "{compared} {between}");
}

#[test]
fn a_moved_sun_and_an_edit_are_followed() {
    let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
        return;
    };
    scene.settle();
    let first = scene.map();
    scene.turn_sun(0.8);
    scene.settle();
    let second = scene.map();
    assert!(second == scene.fresh() && first != second);

    let work = scene.work();
    // A tower in the middle casts a shadow over few tiles under so high a sun.
    scene.edit(URect::new(150, 130, 153, 133), 200.0);
    scene.settle();
    let tiles = (scene.work() - work) / 4096;
    assert!(
        (1..=6).contains(&tiles),
        "{tiles} of 25 tiles were made anew"
    );
    let third = scene.map();
    assert!(
        third == scene.fresh(),
        "an edit's shadow is not the fresh one"
    );
    assert!(third != second, "the tower casts no shadow");

    // And gone again.
    scene.edit(URect::new(150, 130, 153, 133), 90.0);
    scene.settle();
    assert!(scene.map() == scene.fresh());
}

#[test]
fn a_half_made_map_is_never_shown() {
    // A tile a frame; the camera sees a part of the terrain.
    let shadow = TerrainShadow {
        slice_ms: 0.0,
        ..default()
    };
    let eye = Transform::from_xyz(250.0, 700.0, 250.0).looking_to(Vec3::NEG_Y, Vec3::NEG_Z);
    let Some(mut scene) = Scene::new(shadow, eye) else {
        return;
    };
    assert!(
        scene
            .offline
            .shadow_map(scene.terrain, scene.sun)
            .unwrap()
            .is_none()
    );
    scene.settle();
    let old = scene.map();
    scene.turn_sun(0.9);
    let mut new = None;
    let mut frames = 0;
    let mut changed_at = None;
    // In the camera's view whatever its rounding: 400 m of the ground at its feet.
    let seen = URect::new(20, 20, 100, 100);
    let part = |image: &ShadowImage| -> Vec<u8> {
        (seen.min.y..seen.max.y)
            .flat_map(|j| (seen.min.x..seen.max.x).map(move |i| UVec2::new(i, j)))
            .map(|at| image.at(at))
            .collect()
    };
    while scene.counts().shadows.waiting || frames < 2 {
        scene.offline.step();
        frames += 1;
        assert!(frames < 200);
        let map = scene.map();
        let new = new.get_or_insert_with(|| scene.fresh());
        let (is_old, is_new) = (part(&map) == part(&old), part(&map) == part(new));
        assert!(
            is_old || is_new,
            "frame {frames}: neither the old map nor the new one"
        );
        if is_new && changed_at.is_none() {
            changed_at = Some(frames);
        }
        assert!(
            changed_at.is_none() || is_new,
            "frame {frames}: back to the old map"
        );
    }
    let changed_at = changed_at.expect("it never changed");
    // Coarse tiles come sixteen to the price of one, then those in view; the rest follows.
    assert!(
        changed_at + 5 < frames,
        "in view at {changed_at}, all at {frames}"
    );
    assert!(scene.map() == scene.fresh());
}

#[test]
fn out_of_view_nothing_is_made() {
    let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
        return;
    };
    scene.settle();
    *scene
        .offline
        .app
        .world_mut()
        .get_mut::<Transform>(scene.camera)
        .unwrap() = above().looking_to(Vec3::Y, Vec3::X);
    scene.offline.step();
    let runs = scene.runs();
    scene.turn_sun(0.7);
    for _ in 0..5 {
        scene.offline.step();
    }
    assert_eq!(scene.runs(), runs);
    assert!(
        matches!(scene.state(), EffectState::Idle(why) if why.contains("no camera sees")),
        "{}",
        scene.state()
    );
    *scene
        .offline
        .app
        .world_mut()
        .get_mut::<Transform>(scene.camera)
        .unwrap() = above();
    scene.settle();
    assert!(scene.map() == scene.fresh());
}

#[test]
fn a_map_left_half_made_while_nobody_looks_is_completed_later() {
    let shadow = TerrainShadow {
        slice_ms: 0.0,
        ..default()
    };
    let Some(mut scene) = Scene::new(shadow, above()) else {
        return;
    };
    scene.settle();
    scene.turn_sun(0.8);
    for _ in 0..12 {
        scene.offline.step();
    }
    let look = |scene: &mut Scene, eye| {
        *scene
            .offline
            .app
            .world_mut()
            .get_mut::<Transform>(scene.camera)
            .unwrap() = eye;
    };
    look(&mut scene, above().looking_to(Vec3::Y, Vec3::X));
    for _ in 0..100 {
        scene.offline.step();
    }
    look(&mut scene, above());
    scene.settle();
    assert!(scene.map() == scene.fresh());
}

#[test]
fn every_light_has_a_map_of_its_own_and_all_is_freed() {
    let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
        return;
    };
    let world = scene.offline.app.world_mut();
    let lamp = world
        .spawn((
            PointLight {
                shadow_maps_enabled: true,
                range: 150.0,
                radius: 0.0,
                ..default()
            },
            Transform::from_xyz(200.0, 160.0, 300.0),
        ))
        .id();
    let spot = world
        .spawn((
            SpotLight {
                shadow_maps_enabled: true,
                range: 200.0,
                ..default()
            },
            Transform::from_xyz(900.0, 200.0, 700.0).looking_to(Vec3::NEG_Y, Vec3::X),
        ))
        .id();
    // Lights without shadow maps are none of ours.
    world.spawn((
        PointLight::default(),
        Transform::from_xyz(300.0, 200.0, 300.0),
    ));
    scene.settle();
    let counts = scene.counts();
    assert_eq!((counts.shadows.maps, counts.shadows.shown), (3, 3));
    let images: Vec<_> = [scene.sun, lamp, spot]
        .map(|light| {
            scene
                .offline
                .shadow_map(scene.terrain, light)
                .unwrap()
                .unwrap()
        })
        .into_iter()
        .collect();
    assert!(images[0] == scene.fresh());
    let field = hills();
    let expected = GridLight::point(
        DVec3::new(200.0, 160.0, 300.0),
        0.0,
        150.0,
        field.local_from_grid(),
    );
    let (fresh, _) = scene
        .offline
        .cast_shadow(scene.field.id(), &expected, ShadowMethod::MaxMip, 0, 1)
        .unwrap();
    assert!(images[1] == fresh);

    scene.offline.app.world_mut().despawn(lamp);
    scene.settle();
    assert_eq!(scene.counts().shadows.maps, 2);
    assert!(
        scene.map() == images[0],
        "the sun's map was lost with the lamp's"
    );
    scene
        .offline
        .app
        .world_mut()
        .entity_mut(scene.terrain)
        .remove::<TerrainShadow>();
    scene.offline.step();
    scene.offline.step();
    assert_eq!(scene.counts().shadows, default());
    assert_eq!(scene.state(), EffectState::Dormant);
}

#[test]
fn a_sun_that_never_rests_leaves_other_lights_their_turn() {
    // A tile a frame; much of the terrain is out of view.
    let shadow = TerrainShadow {
        slice_ms: 0.0,
        ..default()
    };
    let eye = Transform::from_xyz(250.0, 700.0, 250.0).looking_to(Vec3::NEG_Y, Vec3::NEG_Z);
    let Some(mut scene) = Scene::new(shadow, eye) else {
        return;
    };
    scene.settle();
    let lamp = |range: f32| PointLight {
        shadow_maps_enabled: true,
        range,
        radius: 0.0,
        ..default()
    };
    let world = scene.offline.app.world_mut();
    let at = Transform::from_xyz(250.0, 160.0, 250.0);
    let lamp = world.spawn((lamp(80.0), at)).id();
    let mut shown_at = None;
    for frame in 0..150 {
        scene.turn_sun(0.3 + 0.002 * frame as f32);
        scene.offline.step();
        if shown_at.is_none()
            && scene
                .offline
                .shadow_map(scene.terrain, lamp)
                .unwrap()
                .is_some()
        {
            shown_at = Some(frame);
        }
    }
    assert!(shown_at.is_some(), "the lamp never had its turn");
}

#[test]
fn a_lamp_that_keeps_moving_is_followed_though_never_at_rest() {
    let shadow = TerrainShadow {
        slice_ms: 0.0,
        ..default()
    };
    let Some(mut scene) = Scene::new(shadow, above()) else {
        return;
    };
    let light = PointLight {
        shadow_maps_enabled: true,
        range: 250.0,
        radius: 0.0,
        ..default()
    };
    let at = Transform::from_xyz(200.0, 190.0, 500.0);
    let lamp = scene.offline.app.world_mut().spawn((light, at)).id();
    scene.settle();
    let mut maps = Vec::new();
    // A tile of 256 m in 25 frames, and its map takes a dozen tiles.
    for _ in 0..100 {
        scene
            .offline
            .app
            .world_mut()
            .get_mut::<Transform>(lamp)
            .unwrap()
            .translation
            .x += 10.0;
        scene.offline.step();
        let map = scene
            .offline
            .shadow_map(scene.terrain, lamp)
            .unwrap()
            .unwrap();
        if maps.last() != Some(&map) {
            maps.push(map);
        }
    }
    assert!(maps.len() > 4, "it was shown {} times", maps.len());
}

#[test]
fn ground_that_is_edited_every_frame_keeps_its_shadows_up_to_date() {
    let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
        return;
    };
    scene.settle();
    let first = scene.map();
    for frame in 0..20 {
        let x = 60 + 8 * frame;
        scene.edit(URect::new(x, 130, x + 4, 134), 200.0);
        scene.offline.step();
    }
    assert!(
        scene.map() != first,
        "nothing was made while the ground was edited"
    );
    scene.settle();
    assert!(scene.map() == scene.fresh());
}

#[test]
fn a_lamp_that_moves_over_many_tiles_is_followed() {
    let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
        return;
    };
    let lamp = scene
        .offline
        .app
        .world_mut()
        .spawn((
            PointLight {
                shadow_maps_enabled: true,
                range: 120.0,
                radius: 0.0,
                ..default()
            },
            Transform::from_xyz(150.0, 150.0, 200.0),
        ))
        .id();
    scene.settle();
    for x in [300.0, 600.0, 1300.0, 900.0] {
        scene
            .offline
            .app
            .world_mut()
            .get_mut::<Transform>(lamp)
            .unwrap()
            .translation
            .x = x;
        scene.offline.step();
        scene.settle();
        let light = GridLight::point(
            DVec3::new(f64::from(x), 150.0, 200.0),
            0.0,
            120.0,
            hills().local_from_grid(),
        );
        let (fresh, _) = scene
            .offline
            .cast_shadow(scene.field.id(), &light, ShadowMethod::MaxMip, 0, 1)
            .unwrap();
        let map = scene
            .offline
            .shadow_map(scene.terrain, lamp)
            .unwrap()
            .unwrap();
        assert!(map == fresh, "x = {x}");
    }
}

#[test]
fn shadows_take_direct_light_alone() {
    let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
        return;
    };
    scene.turn_sun(0.15);
    scene.settle();
    let shadowed = scene.brightness();
    let dark = scene.map().visibility.iter().filter(|v| **v == 0).count();
    assert!(dark > 10_000);
    let remove = |scene: &mut Scene| {
        scene
            .offline
            .app
            .world_mut()
            .entity_mut(scene.terrain)
            .remove::<TerrainShadow>();
        scene.offline.step();
        scene.offline.step();
    };
    // Bevy's cascades reach some of it either way: the meshes' there are none.
    remove(&mut scene);
    let lit = scene.brightness();
    assert!(shadowed < 0.95 * lit, "{shadowed} against {lit}");

    // Without the sun there is nothing to take away.
    scene
        .offline
        .app
        .world_mut()
        .get_mut::<DirectionalLight>(scene.sun)
        .unwrap()
        .illuminance = 0.0;
    scene.offline.step();
    scene.offline.step();
    let ambient = scene.offline.picture(&scene.target).unwrap();
    scene
        .offline
        .app
        .world_mut()
        .entity_mut(scene.terrain)
        .insert(TerrainShadow::default());
    scene.settle();
    let shadowed = scene.offline.picture(&scene.target).unwrap();
    let off = ambient
        .pixels()
        .zip(shadowed.pixels())
        .flat_map(|(a, b)| (0..3).map(move |c| a[c].abs_diff(b[c])))
        .max();
    assert!(off <= Some(1), "ambient light was darkened by {off:?}");
}

#[test]
fn where_cascades_end_no_seam_shows_on_the_ground() {
    let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
        return;
    };
    scene.turn_sun(0.2);
    let world = scene.offline.app.world_mut();
    // Cascades over the near half of what is seen: what is drawn into them ends in the middle of the picture.
    world.insert_resource(bevy::light::DirectionalLightShadowMap { size: 512 });
    world.entity_mut(scene.sun).insert(
        bevy::light::CascadeShadowConfigBuilder {
            num_cascades: 2,
            first_cascade_far_bound: 300.0,
            maximum_distance: 700.0,
            ..default()
        }
        .build(),
    );
    *world.get_mut::<Transform>(scene.camera).unwrap() = Transform::from_xyz(600.0, 260.0, 1040.0)
        .looking_at(Vec3::new(600.0, 60.0, 300.0), Vec3::Y);
    // A mesh that may receive, or nothing is drawn into cascades at all.
    let mesh = world
        .resource_mut::<Assets<Mesh>>()
        .add(Cuboid::from_length(1.0));
    let material = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial::default());
    world.spawn((
        Mesh3d(mesh),
        MeshMaterial3d(material),
        Transform::from_xyz(600.0, 240.0, 1000.0),
    ));
    scene.settle();
    let drawn = scene
        .counts()
        .passes
        .get("terrain_cascade")
        .map_or(0, |c| c.runs);
    assert!(drawn > 0, "nothing is drawn into cascades");
    let with = scene.offline.picture(&scene.target).unwrap();
    scene
        .offline
        .app
        .world_mut()
        .get_mut::<TerrainShadow>(scene.terrain)
        .unwrap()
        .on_meshes = false;
    scene.offline.step();
    scene.offline.step();
    let without = scene.offline.picture(&scene.target).unwrap();
    let off = with
        .pixels()
        .zip(without.pixels())
        .filter(|(a, b)| (0..3).any(|c| a[c].abs_diff(b[c]) > 8))
        .count();
    let shadowed = scene.map().visibility.iter().filter(|v| **v == 0).count();
    assert!(shadowed > 5_000, "hardly any shadow to see");
    // The cascades' copy of the terrain lies within the map's shadow.
    assert!(
        off < (SIZE.x * SIZE.y) as usize / 500,
        "{off} pixels differ"
    );
}

#[test]
fn every_kind_of_light_is_shadowed_and_only_where_the_map_says() {
    for kind in 0..3 {
        let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
            return;
        };
        let world = scene.offline.app.world_mut();
        world.insert_resource(GlobalAmbientLight {
            brightness: 0.0,
            ..default()
        });
        world
            .entity_mut(scene.terrain)
            .insert(Terrain::new(scene.field.clone()).with_look(TerrainLook {
                colour: TerrainColour::Uniform(Color::WHITE),
                ..default()
            }));
        let at = Transform::from_xyz(600.0, 170.0, 520.0);
        let light = match kind {
            0 => scene.sun,
            1 => {
                world.despawn(scene.sun);
                world
                    .spawn((
                        PointLight {
                            shadow_maps_enabled: true,
                            intensity: 1e10,
                            range: 2000.0,
                            ..default()
                        },
                        at,
                    ))
                    .id()
            }
            _ => {
                world.despawn(scene.sun);
                world
                    .spawn((
                        SpotLight {
                            shadow_maps_enabled: true,
                            intensity: 1e10,
                            range: 2000.0,
                            outer_angle: 1.5,
                            inner_angle: 1.4,
                            ..default()
                        },
                        at.looking_to(Vec3::NEG_Y, Vec3::X),
                    ))
                    .id()
            }
        };
        scene.settle();
        let map = scene
            .offline
            .shadow_map(scene.terrain, light)
            .unwrap()
            .unwrap();
        let picture = scene.offline.picture(&scene.target).unwrap();
        let rays = scene
            .offline
            .view_rays(scene.camera, scene.terrain)
            .unwrap();
        let hits = scene.offline.hits(scene.camera).unwrap().unwrap();
        let (mut dark, mut wrong) = (0, 0);
        for (x, y, pixel) in picture.enumerate_pixels() {
            let depth = hits.ndc_depth[(y * SIZE.x + x) as usize];
            if depth == 0.0 {
                continue;
            }
            let t = rays.view_depth(depth) - f64::from(rays.t_base);
            let (origin, direction) = rays.ray(Vec2::new(x as f32, y as f32) + 0.5);
            let at = origin
                + t * direction
                + DVec3::new(f64::from(rays.anchor.x), 0.0, f64::from(rays.anchor.y));
            let cell = UVec2::new(at.x as u32, at.z as u32);
            let around = |n: u32| (0..=n).flat_map(move |j| (0..=n).map(move |i| UVec2::new(i, j)));
            // Surely in shadow: all samples for some way around.
            // A pixel is three samples wide here, so averages over four a side are blended.
            if cell.min_element() < 8 || (cell + 8).cmpge(map.size).any() {
                continue;
            }
            let all_dark = around(16).all(|d| map.at(cell + d - 8) == 0);
            if all_dark {
                dark += 1;
                wrong += u32::from(pixel[0] > 2);
            }
        }
        assert!(
            dark > 300,
            "light {kind}: only {dark} pixels are surely in shadow"
        );
        assert_eq!(
            wrong, 0,
            "light {kind}: of {dark} pixels in shadow some are lit"
        );
    }
}

#[test]
fn a_suns_size_makes_penumbrae_and_sweeps_work_in_the_app() {
    let shadow = TerrainShadow {
        method: ShadowMethod::Sweep,
        ..default()
    };
    let Some(mut scene) = Scene::new(shadow, above()) else {
        return;
    };
    scene.settle();
    let hard = scene.map();
    assert!(hard.visibility.iter().all(|v| *v == 0 || *v == 255));
    scene
        .offline
        .app
        .world_mut()
        .entity_mut(scene.sun)
        .insert(SunDisk {
            angular_size: 0.06,
            intensity: 1.0,
        });
    scene.settle();
    let soft = scene.map();
    let partly = soft
        .visibility
        .iter()
        .filter(|v| (1..255).contains(*v))
        .count();
    assert!(partly > 1000, "{partly}");
    let swept = scene.counts().passes["shadow_sweep"].runs;
    scene
        .offline
        .app
        .world_mut()
        .get_mut::<TerrainShadow>(scene.terrain)
        .unwrap()
        .method = ShadowMethod::MaxMip;
    scene.settle();
    assert_eq!(scene.counts().passes["shadow_sweep"].runs, swept);
    let rays = scene.map();
    let near = soft
        .visibility
        .iter()
        .zip(&rays.visibility)
        .filter(|(a, b)| a.abs_diff(**b) < 64)
        .count();
    assert!(near as f64 > 0.95 * rays.visibility.len() as f64);
}

#[test]
fn an_exact_light_takes_the_place_of_its_transform() {
    let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
        return;
    };
    let way = DVec3::new(1.0, 0.5, -0.2);
    scene
        .offline
        .app
        .world_mut()
        .entity_mut(scene.sun)
        .insert(ExactLight::Direction(way));
    scene.settle();
    let light = GridLight::directional(way, 0.0, hills().local_from_grid());
    let (fresh, _) = scene
        .offline
        .cast_shadow(scene.field.id(), &light, ShadowMethod::MaxMip, 0, 1)
        .unwrap();
    assert!(scene.map() == fresh);
}

#[test]
fn what_cannot_be_shadowed_is_said_and_the_rest_goes_on() {
    let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
        return;
    };
    scene
        .offline
        .app
        .world_mut()
        .entity_mut(scene.sun)
        .insert(ExactLight::Direction(DVec3::ZERO));
    scene.offline.settle(scene.camera, 10).unwrap();
    for _ in 0..3 {
        scene.offline.step();
    }
    assert!(
        matches!(scene.state(), EffectState::Idle(why) if why.contains("no usable number")),
        "{}",
        scene.state()
    );
    // Twenty suns: sixteen have maps, and the words say so.
    let world = scene.offline.app.world_mut();
    world.entity_mut(scene.sun).remove::<ExactLight>();
    let extra: Vec<_> = (0..20)
        .map(|n| {
            let sun = DirectionalLight {
                illuminance: 10.0,
                ..default()
            };
            world.spawn((sun, sun_at(0.3 + 0.04 * n as f32))).id()
        })
        .collect();
    world
        .get_mut::<TerrainShadow>(scene.terrain)
        .unwrap()
        .lights = ShadowedLights::All;
    scene.settle();
    assert_eq!(scene.counts().shadows.shown, 16);
    assert!(
        matches!(scene.state(), EffectState::Idle(why) if why.contains("at most 16 lights")),
        "{}",
        scene.state()
    );
    for entity in extra {
        scene.offline.app.world_mut().despawn(entity);
    }
    scene.settle();
    assert_eq!(scene.counts().shadows.shown, 1);
    assert!(scene.map() == scene.fresh());
}

#[test]
fn reporting_allocates_nothing_while_nothing_changes() {
    let Some(mut scene) = Scene::new(TerrainShadow::default(), above()) else {
        return;
    };
    scene.settle();
    let world = scene.offline.app.world_mut();
    let report =
        world.register_system(bevy_skyline::systems::terrain_shadow::report_terrain_shadow);
    world.run_system(report).unwrap();
    let allocations = crate::allocations::count(|| {
        for _ in 0..10 {
            world.run_system(report).unwrap();
        }
    });
    assert_eq!(allocations, 0);
}
