//! The frame budget in an app: what it holds by the counted cost of what was drawn, what it gives back, and that it
//! costs nothing where nobody asks for it.

use core::{any::TypeId, f32::consts::TAU};

use bevy::{camera::visibility::VisibleEntities, prelude::*};
use bevy_skyline::{
    budget::{
        AppKnobs, Budget, BudgetStatus, GivenFrameTimes, Knob, KnobCost, KnobOn, Knobs,
        WorkloadPolicy,
    },
    occlusion::OccludeeVolume,
    offline::Offline,
    prelude::*,
    systems::budget as systems,
};

const SIZE: UVec2 = UVec2::new(160, 90);
const TARGET: f32 = 4.0;

/// What a frame is said to have cost. units: ms
const FIXED: f32 = 0.5;
const AN_OBJECT: f32 = 0.01;
const A_TRIANGLE: f32 = 2.0e-5;

/// A camera in the middle of many things of all sizes, most of them on one side.
struct Scene {
    offline: Offline,
    camera: Entity,
}

impl Scene {
    fn new(bundle: impl Bundle) -> Option<Self> {
        let mut offline = crate::device()?;
        let picture = offline.target(SIZE);
        let camera = offline.camera(&picture, (Msaa::Off, bundle));
        let world = offline.app.world_mut();
        let mut meshes = world.resource_mut::<Assets<Mesh>>();
        let shapes = [
            meshes.add(Cuboid::from_length(1.0)),
            meshes.add(
                Sphere::new(0.5)
                    .mesh()
                    .ico(2)
                    .unwrap_or_else(|_| Cuboid::default().into()),
            ),
            meshes.add(Sphere::new(0.5).mesh().uv(24, 16)),
        ];
        let material = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial::default());
        let mut dice = crate::budget_controller::Dice::new(3);
        for i in 0..1_600 {
            let angle = TAU * dice.roll().powi(2) as f32;
            let distance = 6.0 + 90.0 * dice.roll().sqrt() as f32;
            let size = 0.2 * 12.0_f32.powf((dice.roll() * dice.roll()) as f32);
            let place = Quat::from_rotation_y(angle) * Vec3::NEG_Z * distance;
            world.spawn((
                Mesh3d(shapes[i % 3].clone()),
                MeshMaterial3d(material.clone()),
                Transform::from_translation(place).with_scale(Vec3::splat(size)),
            ));
        }
        Some(Self { offline, camera })
    }

    fn world(&mut self) -> &mut World {
        self.offline.app.world_mut()
    }

    fn get<C: Component>(&self) -> &C {
        self.offline
            .app
            .world()
            .get::<C>(self.camera)
            .expect("the camera has it")
    }

    /// Objects and triangles that the camera draws, counted by other means than the budget's own.
    fn drawn(&self) -> (usize, usize) {
        let world = self.offline.app.world();
        let meshes = world.resource::<Assets<Mesh>>();
        let list = self.get::<VisibleEntities>().get(TypeId::of::<Mesh3d>());
        let triangles = list
            .iter()
            .filter_map(|entity| meshes.get(world.get::<Mesh3d>(*entity)?))
            .map(|mesh| mesh.indices().map_or(0, |indices| indices.len() / 3))
            .sum();
        (list.len(), triangles)
    }

    /// One frame, looking along an angle; its counted cost, which it is told.
    fn step(&mut self, angle: f32) -> f32 {
        let camera = self.camera;
        self.world()
            .entity_mut(camera)
            .insert(Transform::from_rotation(Quat::from_rotation_y(angle)));
        self.offline.step();
        let (objects, triangles) = self.drawn();
        let ms = FIXED + AN_OBJECT * objects as f32 + A_TRIANGLE * triangles as f32;
        self.world().resource_mut::<GivenFrameTimes>().last_ms = Some(ms);
        ms
    }
}

fn budget() -> FrameBudget {
    FrameBudget {
        clock: BudgetClock::Given,
        ..FrameBudget::from_ms(TARGET)
    }
}

fn culling() -> ContributionCulling {
    ContributionCulling {
        threshold_px2: 0.0,
        ..default()
    }
}

#[test]
fn the_counted_cost_of_a_turn_is_held() {
    let Some(mut plain) = Scene::new(()) else {
        return;
    };
    let frames = 240;
    let angle = |frame: usize| TAU * frame as f32 / frames as f32;
    let free: Vec<f32> = (0..frames)
        .step_by(8)
        .map(|frame| plain.step(angle(frame)))
        .collect();
    let low = free.iter().copied().fold(f32::MAX, f32::min);
    let high = free.iter().copied().fold(0.0, f32::max);
    println!("without: {low:.2} to {high:.2} ms");
    assert!(high > 1.5 * TARGET, "there is nothing to hold: {high}");

    let Some(mut scene) = Scene::new((budget(), culling())) else {
        return;
    };
    for _ in 0..30 {
        scene.step(0.0);
    }
    let mut held = Vec::new();
    for frame in 0..2 * frames {
        let ms = scene.step(angle(frame));
        let state = scene.get::<BudgetState>();
        match state.status {
            // Where there is less to draw than the target allows, all of it is drawn.
            BudgetStatus::Ample => assert_eq!(state.demanded_px2, 0.0),
            BudgetStatus::Held => held.push(ms / TARGET),
            other => panic!("{other:?} in frame {frame}"),
        }
    }
    let mean = held.iter().sum::<f32>() / held.len() as f32;
    let deviation =
        (held.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / held.len() as f32).sqrt();
    let over = held.iter().filter(|x| **x > 1.0).count() as f32 / held.len() as f32;
    println!(
        "{} frames held: mean {mean:.4}, std {deviation:.4}, over {over:.4}",
        held.len()
    );
    assert!(held.len() > frames, "only {} frames were held", held.len());
    assert!((0.95..=1.0).contains(&mean), "{mean}");
    assert!(deviation <= 0.05 && over <= 0.01, "{deviation} {over}");
}

#[test]
fn without_the_component_nothing_runs() {
    let Some(mut scene) = Scene::new(culling()) else {
        return;
    };
    for _ in 0..5 {
        scene.step(0.0);
    }
    let world = scene.offline.app.world();
    let state = world.resource::<Budget>();
    assert_eq!(state.chosen(), 0);
    assert!(state.controller().is_none(), "nothing is kept");
    assert_eq!(
        *world.resource::<Effects>().frame_budget(),
        EffectState::Dormant
    );
    assert_eq!(world.resource::<Knobs>().iter().len(), 0);
    assert!(
        world.resource::<GivenFrameTimes>().last_ms.is_some(),
        "nobody reads them"
    );
}

#[test]
fn everything_is_given_back() {
    let casting = TerrainRayCasting {
        max_error_px: 0.75,
        ..default()
    };
    let occlusion = ZBufferOcclusion {
        volume: OccludeeVolume::Proxy { triangles: 77 },
        rests: false,
        ..default()
    };
    let Some(mut scene) = Scene::new((budget(), culling(), casting, occlusion.clone())) else {
        return;
    };
    // Out of reach, so that every knob moves.
    for _ in 0..300 {
        scene.step(0.3);
        scene.world().resource_mut::<GivenFrameTimes>().last_ms = Some(40.0 * TARGET);
    }
    let moved = *scene.get::<TerrainRayCasting>();
    assert!(moved.max_error_px > 0.75, "{moved:?}");
    assert_eq!(scene.get::<BudgetState>().status, BudgetStatus::Short);
    let names: Vec<_> = scene
        .world()
        .resource::<Knobs>()
        .iter()
        .map(|knob| knob.name)
        .collect();
    assert_eq!(
        names,
        ["contribution_area", "terrain_error", "occlusion_volume"]
    );
    let removed = scene.get::<ContributionCounts>().removed;
    assert!(removed > 0);

    // What the user edits meanwhile is his.
    let camera = scene.camera;
    scene.world().entity_mut(camera).insert(TerrainRayCasting {
        max_error_px: 1.25,
        ..casting
    });
    scene.step(0.3);
    scene.step(0.3);
    scene.world().entity_mut(camera).remove::<FrameBudget>();
    scene.step(0.3);
    scene.step(0.3);
    assert_eq!(scene.get::<TerrainRayCasting>().max_error_px, 1.25);
    assert_eq!(*scene.get::<ZBufferOcclusion>(), occlusion);
    assert_eq!(scene.get::<ContributionCounts>().demanded_px2, 0.0);
    let world = scene.offline.app.world();
    assert!(world.resource::<Budget>().controller().is_none());
    assert_eq!(world.resource::<Knobs>().iter().len(), 0);
    assert_eq!(
        *world.resource::<Effects>().frame_budget(),
        EffectState::Dormant
    );
    let chosen = world.resource::<Budget>().chosen();
    scene.step(0.3);
    assert_eq!(scene.world().resource::<Budget>().chosen(), chosen);
}

/// As when the component goes: a knob that nobody moves any more is where the user had it.
#[test]
fn without_a_valid_target_everything_is_given_back() {
    let casting = TerrainRayCasting {
        max_error_px: 0.75,
        ..default()
    };
    for invalid in [0.0, -3.0, f32::NAN] {
        let Some(mut scene) = Scene::new((budget(), culling(), casting)) else {
            return;
        };
        // Out of reach, so that every knob moves.
        for _ in 0..300 {
            scene.step(0.3);
            scene.world().resource_mut::<GivenFrameTimes>().last_ms = Some(40.0 * TARGET);
        }
        assert!(scene.get::<TerrainRayCasting>().max_error_px > 0.75);
        let camera = scene.camera;
        let mut budget = scene.world().get_mut::<FrameBudget>(camera).unwrap();
        budget.target_ms = invalid;
        scene.step(0.3);
        scene.step(0.3);
        assert_eq!(*scene.get::<TerrainRayCasting>(), casting, "{invalid}");
        assert_eq!(scene.get::<ContributionCounts>().demanded_px2, 0.0);
    }
}

#[derive(Component)]
struct Grass(f32);

#[test]
fn another_plugins_knob_is_moved_and_held_by_hand() {
    let Some(mut scene) = Scene::new((budget(), culling())) else {
        return;
    };
    let steps = [(400.0, 0.0), (200.0, 1e-6), (100.0, 2e-6)];
    let knob = Knob::new("grass_density", "1/m²", &steps, KnobCost::Measured).unwrap();
    let register = |app: &mut App, knob| {
        app.register_component_knob::<Grass>(
            knob,
            KnobOn::Everything,
            |grass| grass.0,
            |grass, value| grass.0 = value,
        )
    };
    register(&mut scene.offline.app, knob.clone()).unwrap();
    assert!(
        register(&mut scene.offline.app, knob).is_err(),
        "there is one already"
    );
    scene.step(0.3);
    assert!(
        !scene
            .world()
            .resource::<Knobs>()
            .iter()
            .any(|knob| knob.name == "grass_density")
    );
    let meadow = scene.world().spawn(Grass(300.0)).id();
    for _ in 0..200 {
        scene.step(0.3);
        scene.world().resource_mut::<GivenFrameTimes>().last_ms = Some(40.0 * TARGET);
    }
    let grass = |scene: &Scene| scene.offline.app.world().get::<Grass>(meadow).unwrap().0;
    assert!(grass(&scene) < 300.0);
    assert!(
        scene
            .world()
            .resource_mut::<Knobs>()
            .set_manual("grass_density", Some(1))
    );
    scene.step(0.3);
    assert_eq!(grass(&scene), 200.0);
    assert!(
        !scene
            .world()
            .resource_mut::<Knobs>()
            .set_manual("grass_density", Some(3))
    );
    assert!(
        !scene
            .world()
            .resource_mut::<Knobs>()
            .set_manual("no_such_knob", None)
    );
    let camera = scene.camera;
    scene.world().entity_mut(camera).remove::<FrameBudget>();
    scene.step(0.3);
    assert_eq!(grass(&scene), 300.0, "what was found is put back");
}

#[test]
fn a_threshold_held_by_hand_is_the_users() {
    let Some(mut scene) = Scene::new((budget(), culling())) else {
        return;
    };
    scene
        .world()
        .resource_mut::<Knobs>()
        .set_manual("contribution_area", Some(7));
    for _ in 0..20 {
        scene.step(0.3);
    }
    assert_eq!(scene.get::<BudgetState>().demanded_px2, 64.0);
    assert_eq!(scene.get::<ContributionCounts>().demanded_px2, 64.0);
}

#[test]
fn work_is_measured_in_both_worlds_and_put_down_to_its_frame() {
    let Some(mut scene) = Scene::new((FrameBudget::from_ms(1e-3), culling())) else {
        return;
    };
    for _ in 0..12 {
        scene.step(0.3);
    }
    let measured = scene
        .get::<BudgetState>()
        .measured_ms
        .expect("something was measured");
    assert!(measured > 0.0 && measured < 10_000.0, "{measured}");
    let words = scene
        .world()
        .resource::<Effects>()
        .frame_budget()
        .to_string();
    println!("{words}");
    assert!(words.contains("of 0.00 ms measured"), "{words}");
}

#[test]
fn choosing_and_reporting_allocate_nothing() {
    let Some(mut scene) = Scene::new((budget(), culling())) else {
        return;
    };
    for _ in 0..20 {
        scene.step(0.3);
    }
    let world = scene.offline.app.world_mut();
    let choose = world.register_system(systems::choose);
    let note = world.register_system(systems::note_drawn);
    let report = world.register_system(systems::report_budget);
    for system in [choose, note, report] {
        for _ in 0..3 {
            world.run_system(system).unwrap();
        }
        let allocations = crate::allocations::count(|| {
            for _ in 0..10 {
                world.run_system(system).unwrap();
            }
        });
        assert_eq!(allocations, 0);
    }
}

#[test]
fn policies_remove_what_they_say() {
    let Some(mut scene) = Scene::new(WorkloadPolicy::Distance(f32::INFINITY)) else {
        return;
    };
    for _ in 0..3 {
        scene.step(0.3);
    }
    let camera = scene.camera;
    let (objects, triangles) = scene.drawn();
    let middles = |scene: &Scene| -> Vec<f32> {
        let world = scene.offline.app.world();
        let list = scene.get::<VisibleEntities>().get(TypeId::of::<Mesh3d>());
        list.iter()
            .filter_map(|entity| world.get::<GlobalTransform>(*entity))
            .map(|place| place.translation().length())
            .collect()
    };
    let near = middles(&scene).iter().filter(|m| **m <= 40.0).count();
    let mut with = |policy: WorkloadPolicy| {
        scene.world().entity_mut(camera).insert(policy);
        scene.step(0.3);
        scene.step(0.3);
        let list = scene.get::<VisibleEntities>().get(TypeId::of::<Mesh3d>());
        assert!(list.is_sorted());
        let far = middles(&scene).into_iter().fold(0.0, f32::max);
        (scene.drawn(), far)
    };
    let ((within, _), far) = with(WorkloadPolicy::Distance(40.0));
    // It goes by nearest points; half the diagonal of the largest box is 2.08 m.
    assert!(
        within < objects && within >= near && far > 40.0 && far < 42.1,
        "{within} {near} {far}"
    );
    let half = triangles as u64 / 2;
    let ((_, drawn), _) = with(WorkloadPolicy::Polygons(half));
    // One more would have been too much, and no mesh has more than 736 triangles.
    assert!(
        drawn as u64 <= half && drawn as u64 + 800 > half,
        "{drawn} of {half}"
    );
    let ((all, _), _) = with(WorkloadPolicy::Polygons(u64::MAX));
    assert_eq!(all, objects);
    let ((none, _), _) = with(WorkloadPolicy::Distance(f32::NAN));
    assert_eq!(none, objects, "a distance that is none bounds nothing");
    scene.world().entity_mut(camera).remove::<WorkloadPolicy>();
    scene.step(0.3);
    scene.step(0.3);
    assert_eq!(scene.drawn().0, objects);
}
