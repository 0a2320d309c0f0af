//! Contribution culling in a headless app: what is too small is missing, and nothing else.

use core::any::TypeId;

use bevy::{
    camera::visibility::{NoCpuCulling, VisibilityRange, VisibleEntities},
    ecs::system::{IntoSystem, System},
    prelude::*,
};
use bevy_skyline::{
    contribution::{ContributionCamera, fade},
    culling::{candidates::Candidates, volume::LocalBox},
    offline::{Offline, scenes::compare::differing_px},
    prelude::*,
    reference::contribution::AreaTwin,
    render_graph::contribution::ContributionStats,
    systems::contribution::{cull_small, measure_areas},
};

use crate::allocations;

const SIZE: UVec2 = UVec2::new(160, 120);

/// A field of boxes of very different sizes that two cameras see from the same place: one culls, the other does not.
struct Field {
    offline: Offline,
    culling: Entity,
    plain: Entity,
    pictures: [Handle<Image>; 2],
    boxes: Vec<Entity>,
}

fn eye(x: f32) -> Transform {
    Transform::from_xyz(x, 6.0, 20.0).looking_at(Vec3::new(x, 0.0, -20.0), Vec3::Y)
}

impl Field {
    fn new<B: Bundle>(settings: ContributionCulling, camera: impl Fn() -> B) -> Option<Self> {
        let mut offline = crate::device()?;
        let pictures = [offline.target(SIZE), offline.target(SIZE)];
        let culling = offline.camera(&pictures[0], (eye(0.0), Msaa::Off, camera(), settings));
        let plain = offline.camera(&pictures[1], (eye(0.0), Msaa::Off, camera()));
        let world = offline.app.world_mut();
        let cube = world
            .resource_mut::<Assets<Mesh>>()
            .add(Cuboid::from_length(1.0));
        world.spawn((
            DirectionalLight::default(),
            Transform::default().looking_to(Vec3::new(-1.0, -2.0, -1.5), Vec3::Y),
        ));
        let mut boxes = Vec::new();
        for row in 0..20 {
            for column in 0..21 {
                let i = row * 21 + column;
                let hue = (i * 47 % 360) as f32;
                let material = world
                    .resource_mut::<Assets<StandardMaterial>>()
                    .add(Color::hsl(hue, 0.9, 0.5));
                // Sizes from 0.1 to 1.6 m.
                let size = 0.1 * 2f32.powf((i * 7 % 9) as f32 * 0.5);
                let place = Vec3::new(
                    2.0 * (column as f32 - 10.0),
                    0.5 * (i * 3 % 4) as f32,
                    15.0 - 4.0 * row as f32,
                );
                let turn = Quat::from_rotation_y(i as f32);
                let transform = Transform {
                    translation: place,
                    rotation: turn,
                    scale: Vec3::splat(size),
                };
                let mesh = Mesh3d(cube.clone());
                let one = world.spawn((mesh, MeshMaterial3d(material), transform));
                boxes.push(one.id());
            }
        }
        Some(Self {
            offline,
            culling,
            plain,
            pictures,
            boxes,
        })
    }

    fn world(&self) -> &World {
        self.offline.app.world()
    }

    fn world_mut(&mut self) -> &mut World {
        self.offline.app.world_mut()
    }

    fn look(&mut self, place: Transform) {
        for camera in [self.culling, self.plain] {
            self.world_mut().entity_mut(camera).insert(place);
        }
    }

    fn step(&mut self) -> ContributionCounts {
        self.offline.step();
        let counts = self.world().get::<ContributionCounts>(self.culling);
        counts.copied().unwrap_or_default()
    }

    fn settle(&mut self) -> ContributionCounts {
        for _ in 0..7 {
            self.step();
        }
        self.step()
    }

    fn seen_by(&self, camera: Entity) -> Vec<Entity> {
        let visible = self
            .world()
            .get::<VisibleEntities>(camera)
            .expect("it is one");
        visible.get(TypeId::of::<Mesh3d>()).to_vec()
    }

    fn small(&self) -> Vec<Entity> {
        let culled = self.world().get::<CulledEntities>(self.culling);
        culled.map_or_else(Vec::new, |culled| {
            let small = culled
                .iter()
                .filter(|(_, why)| *why == CullReason::Contribution);
            small.map(|(entity, _)| entity).collect()
        })
    }

    /// Pixels that differ between the two pictures, and pixels that show anything at all.
    fn differing(&self) -> (usize, usize) {
        let [culled, plain] = [0, 1].map(|i| {
            let picture = self.offline.picture(&self.pictures[i]);
            picture.expect("the picture can be read")
        });
        let background = *plain.get_pixel(0, 0);
        (
            differing_px(&culled, &plain) as usize,
            plain.pixels().filter(|p| **p != background).count(),
        )
    }

    /// What must be missing by the twin, of what the plain camera sees; `None` where rounding has a say.
    fn expected(&self, threshold_px2: f64) -> Vec<(Entity, Option<bool>)> {
        let world = self.world();
        let camera = world.get::<Camera>(self.culling).expect("it is one");
        let place = world.get::<GlobalTransform>(self.culling).expect("placed");
        let twin = AreaTwin::new(
            camera.clip_from_view() * place.to_matrix().inverse(),
            SIZE.as_vec2(),
        );
        let one = |entity: Entity| {
            let place = world.get::<GlobalTransform>(entity).expect("placed");
            let aabb = world
                .get::<bevy::camera::primitives::Aabb>(entity)
                .expect("bounded");
            let areas = twin.areas(&place.affine(), &LocalBox::from(*aabb));
            let is_small = if areas.most < threshold_px2 {
                Some(true)
            } else if areas.rectangle >= threshold_px2 {
                Some(false)
            } else {
                None
            };
            (entity, is_small)
        };
        self.seen_by(self.plain).into_iter().map(one).collect()
    }

    fn is_well_within_the_picture(&self, entity: Entity) -> bool {
        let world = self.world();
        let camera = world.get::<Camera>(self.culling).expect("it is one");
        let [from, at] = [self.culling, entity]
            .map(|entity| world.get::<GlobalTransform>(entity).expect("placed"));
        camera
            .world_to_viewport(from, at.translation())
            .is_ok_and(|px| {
                let size = SIZE.as_vec2();
                px.cmpge(0.15 * size).all() && px.cmple(0.85 * size).all()
            })
    }

    fn effect(&self) -> String {
        self.world()
            .resource::<Effects>()
            .contribution()
            .to_string()
    }
}

fn culling(threshold_px2: f32) -> ContributionCulling {
    ContributionCulling {
        threshold_px2,
        ..default()
    }
}

/// What is missing is what the twin says, and nothing of the picture but that.
fn misses_what_the_twin_says(field: &mut Field, threshold: f64) {
    let expected = field.expected(threshold);
    let small = field.small();
    let (mut removed, mut kept) = (0, 0);
    for (entity, is_small) in &expected {
        let found = small.binary_search(entity).is_ok();
        if let Some(is_small) = is_small {
            assert_eq!(found, *is_small, "{entity}");
        }
        removed += usize::from(found);
        kept += usize::from(!found);
    }
    assert!(removed > 50 && kept > 20, "{removed} removed, {kept} kept");
    assert_eq!(removed, small.len(), "what is not in view is not removed");
}

#[test]
fn what_is_too_small_is_missing_and_nothing_else() {
    for threshold in [4.0, 40.0] {
        let Some(mut field) = Field::new(culling(threshold), || ()) else {
            return;
        };
        let counts = field.settle();
        misses_what_the_twin_says(&mut field, threshold.into());
        let small = field.small();
        let mut left = field.seen_by(field.plain);
        assert_eq!(counts.candidates as usize, left.len());
        assert_eq!(counts.removed as usize, small.len());
        assert_eq!(counts.triangles, 12 * left.len() as u64);
        left.retain(|entity| small.binary_search(entity).is_err());
        assert_eq!(counts.triangles_drawn, 12 * left.len() as u64);
        assert_eq!(field.seen_by(field.culling), left, "the order is kept");
        assert!(!counts.on_gpu && counts.threshold_px2 == threshold);
        assert!(
            field.effect().contains("candidates removed"),
            "{}",
            field.effect()
        );

        let (differing, _) = field.differing();
        assert!(differing > 0, "nothing visible was removed");
        for entity in small {
            field
                .world_mut()
                .entity_mut(entity)
                .insert(Visibility::Hidden);
        }
        field.settle();
        let (differing, shown) = field.differing();
        assert!(shown > 1000);
        assert_eq!(differing, 0, "something else is missing");
    }
}

#[test]
fn a_game_can_ask_who_is_too_small() {
    let Some(mut field) = Field::new(culling(40.0), || ()) else {
        return;
    };
    field.settle();
    let (camera, plain, small) = (field.culling, field.plain, field.small());
    let first = small[0];
    let mut state = bevy::ecs::system::SystemState::<Culling>::new(field.world_mut());
    let ask = state.get(field.world()).expect("it is a system's");
    assert_eq!(ask.reason(camera, first), Some(CullReason::Contribution));
    assert_eq!(ask.reason(plain, first), None);
    assert!(ask.is_seen(first), "by the other camera");
    field
        .world_mut()
        .entity_mut(first)
        .insert(NoContributionCulling);
    field.step();
    assert!(field.small().binary_search(&first).is_err());
}

#[test]
fn nothing_flickers_where_a_camera_trembles() {
    let mut changes = [0, 0];
    let Some(mut field) = Field::new(culling(40.0), || ()) else {
        return;
    };
    for (k, hysteresis) in [1.25, 1.0].into_iter().enumerate() {
        for threshold in [10.0, 20.0, 40.0, 80.0] {
            let camera = field.culling;
            field
                .world_mut()
                .entity_mut(camera)
                .insert(ContributionCulling {
                    hysteresis,
                    ..culling(threshold)
                });
            let mut before: Option<(Vec<Entity>, Vec<Entity>)> = None;
            for frame in 0..24 {
                // Areas change by up to an eighth.
                let mut place = eye(0.0);
                place.translation.z += 0.15 * (frame as f32 * 2.4).sin();
                field.look(place);
                field.step();
                let now = (field.small(), field.seen_by(field.plain));
                assert!(now.0.len() > 20);
                // The first trembles settle what lay between. At the picture's border areas are cut, and change by
                // more than the hysteresis.
                if let Some((small, seen)) = before.filter(|_| frame >= 8) {
                    let is_in = |list: &[Entity], e: &Entity| list.binary_search(e).is_ok();
                    let changed = now.1.iter().filter(|e| {
                        is_in(&seen, e)
                            && is_in(&small, e) != is_in(&now.0, e)
                            && field.is_well_within_the_picture(**e)
                    });
                    changes[k] += changed.count();
                }
                before = Some(now);
            }
        }
    }
    println!(
        "changes with hysteresis {}, without {}",
        changes[0], changes[1]
    );
    assert_eq!(changes[0], 0);
    assert!(changes[1] > 0, "nothing lay at the threshold");
}

#[test]
fn a_threshold_that_means_nothing_draws_all_and_says_so() {
    let Some(mut field) = Field::new(culling(40.0), || ()) else {
        return;
    };
    field.settle();
    for wrong in [0.0, -3.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let camera = field.culling;
        field.world_mut().entity_mut(camera).insert(culling(wrong));
        let counts = field.step();
        assert_eq!(
            (counts.removed, counts.triangles),
            (0, counts.triangles_drawn)
        );
        assert!(field.small().is_empty());
        let said = format!("a threshold of {wrong} px² removes nothing");
        assert!(field.effect().contains(&said), "{}", field.effect());
    }
    let camera = field.culling;
    for hysteresis in [0.5, f32::NAN, f32::INFINITY] {
        let settings = ContributionCulling {
            hysteresis,
            ..culling(40.0)
        };
        field.world_mut().entity_mut(camera).insert(settings);
        assert!(field.step().removed > 50);
        assert!(
            field.effect().contains("is taken for 1"),
            "{}",
            field.effect()
        );
        assert_eq!(field.step().removed, field.step().removed);
    }
}

#[test]
fn with_no_component_nothing_runs_and_nothing_is_kept() {
    let Some(mut field) = Field::new(culling(40.0), || ()) else {
        return;
    };
    assert!(field.settle().removed > 50);
    let camera = field.culling;
    field
        .world_mut()
        .get_mut::<Camera>(camera)
        .expect("it is one")
        .is_active = false;
    let counts = field.settle();
    assert_eq!((counts.candidates, field.small().len()), (0, 0));
    assert!(
        field
            .effect()
            .contains("no camera that asks for it is active")
    );
    field
        .world_mut()
        .get_mut::<Camera>(camera)
        .expect("it is one")
        .is_active = true;
    assert!(field.settle().removed > 50);

    field
        .world_mut()
        .entity_mut(camera)
        .remove::<ContributionCulling>();
    field.step();
    let world = field.world();
    assert!(world.get::<ContributionCamera>(camera).is_none());
    assert!(world.get::<ContributionCounts>(camera).is_none());
    assert!(world.get::<CulledEntities>(camera).is_none());
    assert!(world.resource::<Candidates>().is_empty());
    assert_eq!(
        *world.resource::<Effects>().contribution(),
        EffectState::Dormant
    );
    assert_eq!(field.seen_by(camera), field.seen_by(field.plain));
    assert_eq!(field.differing().0, 0);
    let stats = world.resource::<ContributionStats>().lock();
    assert_eq!((stats.measured, stats.wanted, stats.bytes), (0, false, 0));
}

#[test]
fn who_comes_anew_is_not_taken_for_who_has_left() {
    // Between the threshold and its hysteresis: what has left stays away, what is new is drawn.
    let settings = ContributionCulling {
        hysteresis: 1e6,
        ..culling(200.0)
    };
    let Some(mut field) = Field::new(settings, || ()) else {
        return;
    };
    let camera = field.culling;
    field.settle();
    let small = field.small();
    assert!(small.len() > 50);
    field
        .world_mut()
        .entity_mut(camera)
        .insert(ContributionCulling {
            hysteresis: 1e6,
            ..culling(4.0)
        });
    field.settle();
    assert_eq!(field.small(), small, "they stay away");
    for entity in &small {
        let world = field.world_mut();
        let again = {
            let one = world.entity(*entity);
            (
                one.get::<Mesh3d>().expect("meshes").clone(),
                one.get::<MeshMaterial3d<StandardMaterial>>()
                    .expect("coloured")
                    .clone(),
                *one.get::<Transform>().expect("placed"),
            )
        };
        world.despawn(*entity);
        world.spawn(again);
    }
    field.settle();
    // Slots rest for some frames before they are given again.
    for _ in 0..10 {
        field.step();
    }
    misses_what_the_twin_says(&mut field, 4.0);
}

#[test]
fn it_works_beside_occlusion_culling() {
    let occlusion = || ZBufferOcclusion {
        rests: false,
        ..default()
    };
    let settings = ContributionCulling {
        weigh_by_visibility: false,
        ..culling(40.0)
    };
    // The other camera culls by area alone.
    let Some(mut field) = Field::new(settings.clone(), || ()) else {
        return;
    };
    let (camera, other) = (field.culling, field.plain);
    field.world_mut().entity_mut(camera).insert(occlusion());
    field.world_mut().entity_mut(other).insert(settings);
    // A wall before the middle.
    let world = field.world_mut();
    let cube = world
        .resource_mut::<Assets<Mesh>>()
        .add(Cuboid::from_length(1.0));
    let grey = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(Color::WHITE);
    let place = Transform::from_xyz(0.0, 2.0, 16.0).with_scale(Vec3::new(4.0, 9.0, 0.2));
    world.spawn((Mesh3d(cube), MeshMaterial3d(grey), place));
    let mut hidden_in_all = 0;
    for frame in 0..40 {
        let mut place = eye(3.0 * (frame as f32 * 0.3).sin());
        place.rotate_y(0.1 * (frame as f32 * 0.7).sin());
        field.look(place);
        let counts = field.step();
        if frame > 10 {
            assert!(counts.removed > 50);
            let hidden = field
                .world()
                .get::<OcclusionCounts>(camera)
                .expect("it culls")
                .removed;
            hidden_in_all += hidden;
            let (differing, shown) = field.differing();
            assert!(shown > 1000);
            assert_eq!(differing, 0, "frame {frame}");
            let culled = field
                .world()
                .get::<CulledEntities>(other)
                .expect("it culls");
            let small: Vec<Entity> = culled.iter().map(|(entity, _)| entity).collect();
            assert_eq!(field.small(), small);
        }
    }
    assert!(hidden_in_all > 30, "{hidden_in_all} hidden");
    // Each can go without the other.
    field
        .world_mut()
        .entity_mut(camera)
        .remove::<ZBufferOcclusion>();
    field.step();
    assert!(field.step().removed > 50 && !field.small().is_empty());
}

#[test]
fn what_hardly_shows_counts_for_less() {
    for weigh_by_visibility in [true, false] {
        let settings = ContributionCulling {
            weigh_by_visibility,
            ..culling(40.0)
        };
        let Some(mut field) = Field::new(settings, || ZBufferOcclusion {
            rests: false,
            ..default()
        }) else {
            return;
        };
        for entity in core::mem::take(&mut field.boxes) {
            field.world_mut().despawn(entity);
        }
        let world = field.world_mut();
        let cube = world
            .resource_mut::<Assets<Mesh>>()
            .add(Cuboid::from_length(1.0));
        let white = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(Color::WHITE);
        let mut put = |place: Vec3, scale: Vec3| {
            let place = Transform::from_translation(place).with_scale(scale);
            let one = (Mesh3d(cube.clone()), MeshMaterial3d(white.clone()), place);
            world.spawn(one).id()
        };
        // A wall that reaches from the left to the middle; behind it a box that shows an eighth of itself, and one that
        // shows all.
        put(Vec3::new(-10.0, 3.0, 0.0), Vec3::new(20.0, 20.0, 0.1));
        let covered = put(Vec3::new(-0.75, 3.0, -1.0), Vec3::new(2.0, 2.0, 0.1));
        let open = put(Vec3::new(4.0, 3.0, -1.0), Vec3::new(2.0, 2.0, 0.1));
        let large = put(Vec3::new(-3.5, 3.0, -1.0), Vec3::new(8.0, 8.0, 0.1));
        field.look(Transform::from_xyz(0.0, 3.0, 20.0));
        field.settle();
        assert_eq!(
            field.small().contains(&covered),
            weigh_by_visibility,
            "it shows an eighth"
        );
        assert!(!field.small().contains(&open));
        assert!(
            !field.small().contains(&large),
            "16 times the threshold stays"
        );
    }
}

#[test]
fn what_is_removed_still_casts_its_shadow() {
    let Some(mut field) = Field::new(culling(1e9), || ()) else {
        return;
    };
    let (lights, boxes) = {
        let world = field.world_mut();
        let mut lights = world.query_filtered::<Entity, With<DirectionalLight>>();
        (lights.iter(world).collect::<Vec<_>>(), field.boxes.clone())
    };
    let world = field.world_mut();
    for light in lights {
        world.entity_mut(light).insert(DirectionalLight {
            shadow_maps_enabled: true,
            ..default()
        });
    }
    let plane = Plane3d::new(Vec3::Y, Vec2::splat(100.0));
    let plane = world.resource_mut::<Assets<Mesh>>().add(plane);
    let white = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(Color::WHITE);
    world.spawn((
        Mesh3d(plane),
        MeshMaterial3d(white),
        Transform::from_xyz(0.0, -1.0, 0.0),
        NoContributionCulling,
    ));
    let removed = field.settle().removed as usize;
    assert!(removed > 100);
    let with_shadows = field.offline.picture(&field.pictures[0]).expect("read");
    for entity in boxes {
        field
            .world_mut()
            .entity_mut(entity)
            .insert(Visibility::Hidden);
    }
    field.settle();
    let without = field.offline.picture(&field.pictures[0]).expect("read");
    assert!(
        differing_px(&with_shadows, &without) > 100,
        "no shadow was cast"
    );
}

#[test]
fn a_steady_frame_allocates_nothing() {
    let Some(mut field) = Field::new(culling(40.0), || ()) else {
        return;
    };
    assert!(field.settle().removed > 50);
    let (camera, in_view) = (field.culling, field.seen_by(field.plain));
    let world = field.world_mut();
    let mut measure = IntoSystem::into_system(measure_areas);
    let mut cull = IntoSystem::into_system(cull_small);
    measure.initialize(world);
    cull.initialize(world);
    let mut allocated = usize::MAX;
    for _ in 0..4 {
        let mut visible = world.get_mut::<VisibleEntities>(camera).expect("it is one");
        let list = visible.get_mut(TypeId::of::<Mesh3d>());
        list.clear();
        list.extend(&in_view);
        allocated = allocations::count(|| {
            measure.run((), world).expect("it runs");
            cull.run((), world).expect("it runs");
        });
    }
    let counts = world.get::<ContributionCounts>(camera).expect("it culls");
    assert!(counts.candidates as usize == in_view.len() && counts.removed > 50);
    assert_eq!(allocated, 0);
}

#[test]
fn the_gpus_picture_is_the_cpus() {
    let by_gpu = || ContributionCulling {
        gpu_from: 0,
        ..culling(40.0)
    };
    let Some(mut field) = Field::new(by_gpu(), || ()) else {
        return;
    };
    let other = field.plain;
    field.world_mut().entity_mut(other).insert(culling(40.0));
    let counts = field.settle();
    {
        let stats = field.world().resource::<ContributionStats>().lock();
        if let Some(reason) = &stats.unsupported {
            println!("skipped: {reason}");
            return;
        }
        assert!(stats.measured > 0 && stats.rewritten > 0 && stats.bytes > 0);
    }
    assert!(counts.on_gpu && counts.removed > 50, "{counts:?}");
    assert!(field.effect().contains("compared by the GPU"));
    for frame in 0..40 {
        // Forth and back, so that some are between the threshold and its hysteresis.
        let x = (frame as f32 * 0.3).sin();
        field.look(eye(2.0 * x));
        if frame % 10 == 5 {
            // One goes, and another comes in its place.
            let goes = field.boxes.swap_remove(frame * 5);
            let world = field.world_mut();
            let one = world.entity(goes);
            let again = (
                one.get::<Mesh3d>().expect("meshes").clone(),
                one.get::<MeshMaterial3d<StandardMaterial>>()
                    .expect("coloured")
                    .clone(),
                one.get::<Transform>()
                    .expect("placed")
                    .with_scale(Vec3::splat(0.7)),
            );
            world.despawn(goes);
            world.spawn(again);
            let moves = field.boxes[frame * 7];
            let mut place = field
                .world_mut()
                .get_mut::<Transform>(moves)
                .expect("placed");
            place.translation.y += 1.0;
        }
        field.step();
        let (differing, shown) = field.differing();
        assert!(shown > 1000);
        assert_eq!(differing, 0, "frame {frame}");
    }
    let counts = field.settle();
    let on_cpu = field
        .world()
        .get::<ContributionCounts>(other)
        .copied()
        .expect("it culls");
    assert!(counts.on_gpu && !on_cpu.on_gpu);
    assert_eq!(
        (counts.removed, counts.triangles_drawn),
        (on_cpu.removed, on_cpu.triangles_drawn)
    );
    let culled = field
        .world()
        .get::<CulledEntities>(other)
        .expect("it culls");
    let small: Vec<Entity> = culled.iter().map(|(entity, _)| entity).collect();
    assert_eq!(field.small(), small);

    // Where it cannot be done the CPU does it, and memory is given back.
    let camera = field.culling;
    field
        .world_mut()
        .entity_mut(camera)
        .insert(ZBufferOcclusion::default());
    let counts = field.settle();
    assert!(!counts.on_gpu && counts.removed > 50);
    assert_eq!(
        field.world().resource::<ContributionStats>().lock().bytes,
        0
    );
    field
        .world_mut()
        .entity_mut(camera)
        .remove::<ZBufferOcclusion>();
    assert!(field.settle().on_gpu);
    let one = field.boxes[0];
    field.world_mut().entity_mut(one).insert(NoCpuCulling);
    assert!(!field.settle().on_gpu);
}

/// Shares of a picture's pixels that show something.
fn shown(field: &Field) -> usize {
    let picture = field.offline.picture(&field.pictures[0]).expect("read");
    let background = *picture.get_pixel(0, 0);
    picture.pixels().filter(|p| **p != background).count()
}

#[test]
fn a_fade_thins_out_and_leaves_nothing_behind() {
    let settings = |threshold| ContributionCulling {
        exit: ContributionExit::Dithered { seconds: 0.3 },
        ..culling(threshold)
    };
    let Some(mut field) = Field::new(settings(1.0), || ()) else {
        return;
    };
    let (camera, plain) = (field.culling, field.plain);
    field.world_mut().despawn(plain);
    for entity in field.boxes.split_off(1) {
        field.world_mut().despawn(entity);
    }
    let one = field.boxes[0];
    let place = Transform::from_translation(eye(0.0).translation + 6.0 * *eye(0.0).forward());
    field.world_mut().entity_mut(one).insert(place);
    field.settle();
    let whole = shown(&field);
    assert!(whole > 200 && field.small().is_empty(), "{whole}");
    let has_range = |field: &Field| field.world().get::<VisibilityRange>(one).is_some();

    let pass = |field: &mut Field, threshold: f32| {
        field
            .world_mut()
            .entity_mut(camera)
            .insert(settings(threshold));
        let mut covers = Vec::new();
        for _ in 0..25 {
            field.step();
            covers.push(shown(field));
        }
        covers
    };
    let out = pass(&mut field, 1e6);
    println!("out: {out:?}");
    assert!(out.is_sorted_by(|a, b| a >= b), "coverage rises: {out:?}");
    assert_eq!(*out.last().expect("frames"), 0);
    let between = out.iter().filter(|n| (1..whole).contains(*n));
    assert!(between.count() > 10, "{out:?}");
    assert_eq!(field.small(), [one]);
    assert!(!has_range(&field));

    let back = pass(&mut field, 1.0);
    println!("back: {back:?}");
    assert!(back.is_sorted(), "coverage falls: {back:?}");
    assert_eq!(*back.last().expect("frames"), whole);
    assert!(field.small().is_empty() && !has_range(&field));

    // Half way out, the culling goes.
    let away = |field: &mut Field| {
        field.world_mut().entity_mut(camera).insert(settings(1e6));
        for _ in 0..8 {
            field.step();
        }
        assert!(has_range(field));
        let range = field.world().get::<VisibilityRange>(one);
        assert!((1..fade::STEPS).any(|step| range == Some(&fade::range(step))));
    };
    away(&mut field);
    field
        .world_mut()
        .entity_mut(camera)
        .remove::<ContributionCulling>();
    field.settle();
    assert!(!has_range(&field));
    assert_eq!(shown(&field), whole);

    // What has a range of its own, or is seen by another camera, is cut.
    field.world_mut().entity_mut(camera).insert(settings(1.0));
    field.settle();
    let own = VisibilityRange::abrupt(0.0, 1e3);
    field.world_mut().entity_mut(one).insert(own.clone());
    field.settle();
    field.world_mut().entity_mut(camera).insert(settings(1e6));
    field.step();
    field.step();
    field.step();
    assert_eq!((shown(&field), field.small()), (0, vec![one]));
    assert!(field.world().get::<VisibilityRange>(one) == Some(&own));
    field
        .world_mut()
        .entity_mut(one)
        .remove::<VisibilityRange>();
    field.world_mut().entity_mut(camera).insert(settings(1.0));
    field.settle();
    for _ in 0..25 {
        field.step();
    }
    let target = field.pictures[1].clone();
    field.offline.camera(&target, (eye(0.0), Msaa::Off));
    field.settle();
    field.world_mut().entity_mut(camera).insert(settings(1e6));
    for _ in 0..3 {
        field.step();
        assert!(!has_range(&field));
    }
    assert_eq!(shown(&field), 0);

    // A camera that is despawned gives back what it dithers.
    let world = field.world_mut();
    let others: Vec<Entity> = world
        .query_filtered::<Entity, With<Camera>>()
        .iter(world)
        .collect();
    for other in others.into_iter().filter(|other| *other != camera) {
        field.world_mut().despawn(other);
    }
    field.world_mut().entity_mut(camera).insert(settings(1.0));
    for _ in 0..30 {
        field.step();
    }
    away(&mut field);
    field.world_mut().despawn(camera);
    field.step();
    assert!(!has_range(&field));
}
