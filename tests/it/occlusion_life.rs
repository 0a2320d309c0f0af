//! Occlusion culling in the life of an app: settings, hierarchy, what comes and goes, what a game sees of it, and when
//! it rests.

use bevy::{
    camera::{
        RenderTarget, Viewport,
        visibility::{NoAutoAabb, NoFrustumCulling, RenderLayers},
    },
    core_pipeline::prepass::DepthPrepass,
    ecs::system::SystemState,
    mesh::skinning::SkinnedMesh,
    prelude::*,
    render::{RenderApp, occlusion_culling::OcclusionCulling},
};
use bevy_skyline::{
    culling::candidates::Candidates,
    occlusion::OcclusionCamera,
    prelude::*,
    render_graph::occlusion::{
        OcclusionStats,
        buffers::{GpuOccludees, OcclusionViews},
        late_view::LateViews,
    },
};

use crate::occlusion_app::{Scene, always, eye};

fn settle(scene: &mut Scene) -> OcclusionCounts {
    for _ in 0..7 {
        scene.step();
    }
    scene.step()
}

fn culled(scene: &Scene, camera: Entity) -> Vec<Entity> {
    let culled = scene.offline.app.world().get::<CulledEntities>(camera);
    culled.map_or_else(Vec::new, |culled| culled.iter().map(|(e, _)| e).collect())
}

fn forward(settings: ZBufferOcclusion) -> Option<Scene> {
    Scene::new(settings, || Msaa::Off)
}

fn same_picture(scene: &Scene) {
    let (differing, shown) = scene.differing();
    assert!(shown > 0, "the picture shows nothing");
    assert_eq!(differing, 0, "pixels differ");
}

#[test]
fn the_gpus_verdicts_are_the_cpus() {
    let Some(mut scene) = forward(always()) else {
        return;
    };
    // The camera that did not cull now does, on the GPU.
    let other = scene.plain;
    scene
        .offline
        .app
        .world_mut()
        .entity_mut(other)
        .insert(ZBufferOcclusion {
            gpu_from: 0,
            ..always()
        });
    let mut compared = 0;
    for place in [
        eye(Vec3::new(0.0, 2.0, 20.0), Vec3::new(0.0, 2.0, 0.0)),
        eye(Vec3::new(9.0, 4.0, 18.0), Vec3::new(0.0, 2.0, -9.0)),
        eye(Vec3::new(-14.0, 7.0, 9.0), Vec3::new(0.0, 0.0, -20.0)),
    ] {
        scene.look(place);
        let on_cpu = settle(&mut scene);
        let on_gpu = *scene
            .offline
            .app
            .world()
            .get::<OcclusionCounts>(other)
            .expect("it culls");
        assert!(on_gpu.on_gpu && !on_cpu.on_gpu);
        assert_eq!(on_gpu.tested, 0, "the CPU has nothing to test");
        let verdicts = culled(&scene, other);
        assert_eq!(verdicts, culled(&scene, scene.culling));
        compared += verdicts.len();
        same_picture(&scene);
    }
    assert!(compared > 200, "only {compared} removed in all");
}

#[test]
fn a_hidden_group_is_not_descended_into() {
    let Some(mut scene) = forward(always()) else {
        return;
    };
    let mut most_spared = 0;
    for _ in 0..8 {
        most_spared = most_spared.max(scene.step().spared);
    }
    println!("{most_spared} tests spared by groups");
    // Six groups of fifteen stand behind the wall.
    assert!(most_spared >= 75, "{most_spared}");

    // A group's bound follows its children: one of a hidden group's boxes moves before the wall.
    let moved = scene.boxes[2 * 15 + 7];
    let world = scene.offline.app.world_mut();
    if let Some(mut place) = world.get_mut::<Transform>(moved) {
        place.translation = Vec3::new(0.0, 2.0, 6.0 + 13.0);
    }
    scene.step();
    same_picture(&scene);
    settle(&mut scene);
    assert!(!culled(&scene, scene.culling).contains(&moved));
    same_picture(&scene);
}

#[test]
fn what_has_no_safe_bound_is_left_in() {
    let Some(mut scene) = forward(always()) else {
        return;
    };
    // So that each has its `Aabb`.
    scene.step();
    let [out, unbounded, skinned, own, plain] = [7, 22, 37, 52, 67].map(|i| scene.boxes[i]);
    let world = scene.offline.app.world_mut();
    world.entity_mut(out).insert(NoOcclusionCulling);
    world.entity_mut(unbounded).insert(NoFrustumCulling);
    // Its mesh has no joints, so it is not shown.
    world
        .entity_mut(skinned)
        .insert((SkinnedMesh::default(), Visibility::Hidden));
    world.entity_mut(own).insert(NoAutoAabb);
    settle(&mut scene);
    let table = scene.offline.app.world().resource::<Candidates>();
    for (entity, is_in) in [
        (out, false),
        (unbounded, false),
        (skinned, false),
        (own, true),
        (plain, true),
    ] {
        assert_eq!(table.slot(entity).is_some(), is_in, "{entity}");
    }
    let removed = culled(&scene, scene.culling);
    assert!(!removed.contains(&out) && removed.contains(&own) && removed.contains(&plain));

    // Let in again.
    let world = scene.offline.app.world_mut();
    world.entity_mut(out).remove::<NoOcclusionCulling>();
    world
        .entity_mut(skinned)
        .remove::<SkinnedMesh>()
        .insert(Visibility::Inherited);
    settle(&mut scene);
    let removed = culled(&scene, scene.culling);
    assert!(removed.contains(&out) && removed.contains(&skinned));
}

#[test]
fn what_blends_or_is_biased_is_drawn_whatever_was_predicted() {
    let Some(mut scene) = forward(always()) else {
        return;
    };
    settle(&mut scene);
    let world = scene.offline.app.world_mut();
    let [blended, biased, plain] = [0, 1, 2].map(|i| {
        world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial {
                base_color: Color::srgba(0.2, 1.0, 0.2, if i == 0 { 0.5 } else { 1.0 }),
                alpha_mode: if i == 0 {
                    AlphaMode::Blend
                } else {
                    AlphaMode::Opaque
                },
                // Drawn through the wall.
                depth_bias: if i == 1 { 1e9 } else { 0.0 },
                ..default()
            })
    });
    let boxes = scene.boxes.clone();
    for (i, entity) in boxes.iter().enumerate() {
        let material = [&blended, &biased, &plain][i % 3].clone();
        scene
            .offline
            .app
            .world_mut()
            .entity_mut(*entity)
            .insert(MeshMaterial3d(material));
    }
    for frame in 0..40 {
        let x = 10.0 * (frame as f32 * 0.3).sin();
        scene.look(eye(Vec3::new(x, 3.0, 20.0), Vec3::new(0.0, 2.0, 0.0)));
        scene.step();
        assert_eq!(scene.differing().0, 0, "frame {frame}");
    }
    // A material that begins to blend while its mesh is removed.
    settle(&mut scene);
    let world = scene.offline.app.world_mut();
    if let Some(mut material) = world
        .resource_mut::<Assets<StandardMaterial>>()
        .get_mut(&plain)
    {
        material.alpha_mode = AlphaMode::Blend;
    }
    for frame in 0..12 {
        let x = 10.0 * (frame as f32 * 0.7).cos();
        scene.look(eye(Vec3::new(x, 3.0, 20.0), Vec3::new(0.0, 2.0, 0.0)));
        scene.step();
        assert_eq!(scene.differing().0, 0, "frame {frame} after the change");
    }
}

#[test]
fn without_a_recheck_what_is_at_rest_is_right_and_the_rest_comes_late() {
    let Some(mut scene) = forward(ZBufferOcclusion {
        recheck: Recheck::Never,
        ..always()
    }) else {
        return;
    };
    let counts = settle(&mut scene);
    assert!(counts.removed > 100 && counts.rescued == 0, "{counts:?}");
    same_picture(&scene);
    // The wall goes: the boxes behind it are missing at first, and there some frames later.
    let wall = scene.wall;
    scene
        .offline
        .app
        .world_mut()
        .entity_mut(wall)
        .insert(Transform::from_xyz(0.0, 500.0, 0.0));
    scene.step();
    assert!(scene.differing().0 > 0, "this mode was to be late");
    for _ in 0..4 {
        scene.step();
    }
    same_picture(&scene);
}

#[test]
fn what_goes_and_comes_is_there_when_it_shows() {
    let Some(mut scene) = forward(always()) else {
        return;
    };
    settle(&mut scene);
    let world = scene.offline.app.world_mut();
    let cube = world
        .get::<Mesh3d>(scene.boxes[0])
        .cloned()
        .expect("a mesh");
    let red = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial::from_color(Color::srgb(1.0, 0.0, 0.0)));
    let ball = world
        .resource_mut::<Assets<Mesh>>()
        .add(Sphere::new(0.8).mesh());
    for frame in 0..45 {
        let world = scene.offline.app.world_mut();
        match frame % 5 {
            // Removed ones are despawned; their slots and mesh inputs go to what is spawned before the wall.
            0 => {
                for _ in 0..3 {
                    if let Some(gone) = scene.boxes.pop() {
                        world.despawn(gone);
                    }
                }
            }
            1 => {
                for i in 0..3 {
                    let place = Vec3::new(3.0 * i as f32 - 3.0, 2.0 + 0.1 * frame as f32, 13.0);
                    let new = world.spawn((
                        cube.clone(),
                        MeshMaterial3d(red.clone()),
                        Transform::from_translation(place),
                    ));
                    scene.boxes.insert(0, new.id());
                }
            }
            // A removed one gets another mesh and jumps into view in the same frame.
            2 => {
                let i = 10 + frame % 20;
                if let Some(entity) = scene.boxes.get(i) {
                    world.entity_mut(*entity).insert((
                        Mesh3d(ball.clone()),
                        Transform::from_xyz(0.2 * i as f32 - 4.0, 5.0, 14.0),
                    ));
                    world.entity_mut(*entity).remove::<ChildOf>();
                }
            }
            // The wall hides all again.
            3 => {
                for entity in scene.boxes.iter().take(3) {
                    world
                        .entity_mut(*entity)
                        .insert(Transform::from_xyz(0.0, 1.0, -5.0));
                }
            }
            _ => {
                let wall = scene.wall;
                let away = if frame % 2 == 0 { 400.0 } else { 0.0 };
                world.entity_mut(wall).insert(
                    Transform::from_xyz(away, 2.0, 10.0).with_scale(Vec3::new(14.0, 12.0, 0.3)),
                );
            }
        }
        scene.step();
        assert_eq!(scene.differing().0, 0, "frame {frame}");
    }
}

#[test]
fn a_changed_viewport_sampling_or_multisampling_shows_nothing_wrong() {
    let Some(mut scene) = forward(always()) else {
        return;
    };
    settle(&mut scene);
    let mut most = 0;
    for frame in 0..48u32 {
        let world = scene.offline.app.world_mut();
        for camera in [scene.culling, scene.plain] {
            let viewport = (frame % 4 != 0).then(|| Viewport {
                physical_position: UVec2::new(frame % 9, 3),
                physical_size: UVec2::new(60 + 2 * (frame % 13), 50 + frame % 31),
                ..default()
            });
            if let Some(mut of) = world.get_mut::<Camera>(camera) {
                of.viewport = viewport;
            }
            if frame % 12 == 0 {
                let msaa = [Msaa::Off, Msaa::Sample4][frame as usize / 12 % 2];
                world.entity_mut(camera).insert(msaa);
            }
            if let Some(mut lens) = world.get_mut::<Projection>(camera)
                && let Projection::Perspective(lens) = &mut *lens
            {
                lens.fov = 0.5 + 0.02 * frame as f32;
            }
        }
        if let Some(mut settings) = world.get_mut::<ZBufferOcclusion>(scene.culling) {
            settings.sampling = match frame / 6 % 3 {
                0 => DepthSampling::default(),
                1 => DepthSampling::Conservative { block: 3 },
                _ => DepthSampling::Conservative { block: 8 },
            };
            settings.volume = match frame / 5 % 3 {
                0 => OccludeeVolume::Aabb,
                1 => OccludeeVolume::Obb,
                _ => OccludeeVolume::Proxy { triangles: 12 },
            };
        }
        most = most.max(scene.step().removed);
        assert_eq!(scene.differing().0, 0, "frame {frame}");
    }
    assert!(most > 100, "{most}");
}

#[test]
fn taking_the_component_away_frees_everything() {
    let Some(mut scene) = forward(always()) else {
        return;
    };
    assert!(settle(&mut scene).removed > 100);
    let stats = scene
        .offline
        .app
        .world()
        .resource::<OcclusionStats>()
        .clone();
    assert!(stats.lock().bytes > 0);
    let camera = scene.culling;
    scene
        .offline
        .app
        .world_mut()
        .entity_mut(camera)
        .remove::<ZBufferOcclusion>();
    scene.offline.step();
    same_picture(&scene);
    scene.offline.step();
    scene.offline.step();
    let before = stats.lock().clone();
    scene.offline.step();
    same_picture(&scene);
    let world = scene.offline.app.world();
    assert!(world.get::<OcclusionCamera>(camera).is_none());
    assert!(world.get::<CulledEntities>(camera).is_none());
    assert!(world.resource::<Candidates>().is_empty());
    assert_eq!(
        *world.resource::<Effects>().occlusion(),
        EffectState::Dormant
    );
    let after = stats.lock().clone();
    assert_eq!((after.bytes, after.reduced), (0, before.reduced));
    let render = scene
        .offline
        .app
        .get_sub_app(RenderApp)
        .expect("it renders")
        .world();
    assert!(render.resource::<GpuOccludees>().is_empty());
    assert!(render.resource::<OcclusionViews>().0.is_empty());
    assert!(render.resource::<LateViews>().is_empty());
}

#[test]
fn a_game_can_ask_who_is_seen_and_why_others_are_not() {
    let Some(mut scene) = forward(always()) else {
        return;
    };
    let [hidden, layered, occluded] = [3, 5, 8].map(|i| scene.boxes[i]);
    let (camera, wall) = (scene.culling, scene.wall);
    let plain = scene.plain;
    let world = scene.offline.app.world_mut();
    world.entity_mut(hidden).insert(Visibility::Hidden);
    world.entity_mut(layered).insert(RenderLayers::layer(5));
    let behind = world
        .spawn((
            world.get::<Mesh3d>(wall).cloned().expect("a mesh"),
            Transform::from_xyz(0.0, 0.0, 60.0),
        ))
        .id();
    settle(&mut scene);
    let world = scene.offline.app.world_mut();
    let mut asking = SystemState::<Culling>::new(world);
    let culling = asking.get(world).expect("a system param");
    use CullReason::{Frustum, Hidden, Layers, Occluded};
    for (entity, reason) in [
        (wall, None),
        (hidden, Some(Hidden)),
        (layered, Some(Layers)),
        (behind, Some(Frustum)),
        (occluded, Some(Occluded)),
    ] {
        assert_eq!(culling.reason(camera, entity), reason);
    }
    // The other camera, which removes nothing, has it in view.
    assert!(culling.is_seen(wall) && culling.is_seen(occluded) && !culling.is_seen(behind));
    assert_eq!(culling.reason(plain, occluded), None);
    let words = world.resource::<Effects>().occlusion().to_string();
    assert!(words.contains("candidates removed"), "{words}");
}

#[test]
fn what_is_removed_still_casts_its_shadow() {
    let Some(mut scene) = forward(always()) else {
        return;
    };
    let world = scene.offline.app.world_mut();
    let mut lights = world.query::<&mut DirectionalLight>();
    for mut light in lights.iter_mut(world) {
        light.shadow_maps_enabled = true;
    }
    // Light from behind the wall throws the boxes' shadows over the ground before it.
    let mut suns = world.query_filtered::<&mut Transform, With<DirectionalLight>>();
    for mut sun in suns.iter_mut(world) {
        *sun = Transform::default().looking_to(Vec3::new(0.1, -0.35, 1.0), Vec3::Y);
    }
    let ground = world
        .resource_mut::<Assets<Mesh>>()
        .add(Plane3d::default().mesh().size(200.0, 200.0));
    let white = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial::from_color(Color::WHITE));
    world.spawn((
        Mesh3d(ground),
        MeshMaterial3d(white),
        Transform::from_xyz(0.0, -4.5, 0.0),
    ));
    let wall = scene.wall;
    if let Some(mut place) = world.get_mut::<Transform>(wall) {
        place.scale.y = 9.0;
    }
    assert!(settle(&mut scene).removed > 50);
    same_picture(&scene);
}

/// What goes in the frame in which other settings are asked for leaves nothing in the table.
#[test]
fn what_goes_as_settings_change_is_gone() {
    let Some(mut scene) = forward(always()) else {
        return;
    };
    settle(&mut scene);
    let all = scene.offline.app.world().resource::<Candidates>().len();
    let world = scene.offline.app.world_mut();
    world.despawn(scene.boxes[3]);
    world.entity_mut(scene.boxes[8]).remove::<Mesh3d>();
    world.entity_mut(scene.boxes[21]).remove::<Mesh3d>();
    world.entity_mut(scene.culling).insert(ZBufferOcclusion {
        volume: OccludeeVolume::Obb,
        ..always()
    });
    scene.step();
    let left = scene.offline.app.world().resource::<Candidates>().len();
    assert_eq!(left, all - 3);
}

#[test]
fn bevys_own_occlusion_culling_keeps_working_beside_it() {
    let Some(mut scene) = Scene::new(always(), || (Msaa::Off, DepthPrepass, OcclusionCulling))
    else {
        return;
    };
    let plain = scene.plain;
    scene
        .offline
        .app
        .world_mut()
        .entity_mut(plain)
        .remove::<OcclusionCulling>();
    // Bevy's is not exact in motion, so the pictures are compared at rest.
    let mut rescued = 0;
    for stop in 0..4 {
        for step in 0..8 {
            let x = 3.0 * stop as f32 + 0.3 * step as f32 - 6.0;
            scene.look(eye(Vec3::new(x, 2.0, 20.0), Vec3::new(0.0, 2.0, 0.0)));
            rescued += scene.step().rescued;
        }
        assert!(settle(&mut scene).removed > 100);
        same_picture(&scene);
    }
    assert!(rescued > 0);
}

#[test]
fn several_cameras_each_have_their_own_verdicts() {
    let Some(mut scene) = forward(always()) else {
        return;
    };
    let second = scene.offline.target(crate::occlusion_app::SIZE);
    let reference = scene.offline.target(crate::occlusion_app::SIZE);
    let place = eye(Vec3::new(0.0, 2.0, -60.0), Vec3::new(0.0, 2.0, 0.0));
    let from_behind = scene.offline.camera(&second, (place, Msaa::Off, always()));
    let plain = scene.offline.camera(&reference, (place, Msaa::Off));
    for frame in 0..30 {
        let t = frame as f32 * 0.3;
        scene.look(eye(
            Vec3::new(7.0 * t.sin(), 2.0, 20.0),
            Vec3::new(0.0, 2.0, 0.0),
        ));
        let place = eye(
            Vec3::new(20.0 * t.cos(), 2.0 + t, -60.0),
            Vec3::new(0.0, 2.0, 0.0),
        );
        let world = scene.offline.app.world_mut();
        world.entity_mut(from_behind).insert(place);
        world.entity_mut(plain).insert(place);
        scene.step();
        assert_eq!(scene.differing().0, 0, "frame {frame}");
        let [a, b] = [&second, &reference].map(|i| scene.offline.picture(i).expect("a picture"));
        assert!(a == b, "the second camera's picture, frame {frame}");
    }
    assert_ne!(culled(&scene, scene.culling), culled(&scene, from_behind));
    // One of them goes, and its target with it.
    let world = scene.offline.app.world_mut();
    world.despawn(from_behind);
    world.entity_mut(plain).remove::<RenderTarget>();
    world.despawn(plain);
    settle(&mut scene);
    same_picture(&scene);
}

#[test]
fn what_removes_nothing_rests_and_looks_again() {
    let Some(mut scene) = forward(ZBufferOcclusion::default()) else {
        return;
    };
    let wall = scene.wall;
    let away = Transform::from_xyz(0.0, 900.0, 0.0);
    let here = Transform::from_xyz(0.0, 2.0, 10.0).with_scale(Vec3::new(14.0, 12.0, 0.3));
    // From above, everything shows.
    let above = eye(Vec3::new(0.0, 60.0, -17.0), Vec3::new(0.0, 0.0, -18.0));
    scene.look(above);
    scene.offline.app.world_mut().entity_mut(wall).insert(away);
    let stats = scene
        .offline
        .app
        .world()
        .resource::<OcclusionStats>()
        .clone();
    for _ in 0..40 {
        scene.step();
    }
    let words = scene
        .offline
        .app
        .world()
        .resource::<Effects>()
        .occlusion()
        .to_string();
    assert!(words.starts_with("idle: it would cost"), "{words}");
    let before = stats.lock().reduced;
    for _ in 0..15 {
        assert_eq!(scene.step().removed, 0);
    }
    assert_eq!(stats.lock().reduced, before, "it rests");
    same_picture(&scene);
    // A wall comes; the next probe finds that it pays, and the picture is right at every step.
    scene.look(eye(Vec3::new(0.0, 2.0, 20.0), Vec3::new(0.0, 2.0, 0.0)));
    scene.offline.app.world_mut().entity_mut(wall).insert(here);
    let mut removed = 0;
    for frame in 0..90 {
        removed = scene.step().removed;
        if frame % 10 == 0 || removed > 0 {
            assert_eq!(scene.differing().0, 0, "frame {frame}");
        }
        if removed > 100 {
            break;
        }
    }
    assert!(removed > 100, "it did not take culling up again");
}

#[test]
fn an_impossible_setting_is_told_and_drawn_within_its_range() {
    let Some(mut scene) = forward(ZBufferOcclusion {
        sampling: DepthSampling::Conservative { block: 1000 },
        ..always()
    }) else {
        return;
    };
    settle(&mut scene);
    same_picture(&scene);
    let words = scene
        .offline
        .app
        .world()
        .resource::<Effects>()
        .occlusion()
        .to_string();
    assert!(words.contains("1000") && words.contains("64"), "{words}");
}
