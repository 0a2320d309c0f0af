//! The furnished city, the policies that decide what is drawn of it, and what their frames are counted as.

use std::collections::BTreeSet;

use bevy::{
    camera::primitives::Aabb,
    camera::visibility::VisibleEntities,
    mesh::{Mesh3d, VertexAttributeValues},
    prelude::*,
};
use bevy_skyline::offline::{
    OfflineError,
    scenes::{
        Scene, SceneObject,
        city::{self, CitySize},
    },
    workload::{BASELINES, Census, Clock, Cost, Policy, Run, WorkloadPath, WorkloadStage, drive},
};

use crate::data::shared;

const SIZE: UVec2 = UVec2::new(320, 180);
const FRAMES: u32 = 12;

fn stage() -> Option<WorkloadStage> {
    match WorkloadStage::new(city::furnished(CitySize::Small), SIZE) {
        Ok(stage) => Some(stage),
        Err(reason) => {
            println!("skipped: {reason}");
            None
        }
    }
}

/// The largest side of each mesh's bound. units: m
fn sizes(scene: &Scene) -> Vec<f32> {
    let of = |mesh: &Mesh| {
        let Some(VertexAttributeValues::Float32x3(positions)) =
            mesh.attribute(Mesh::ATTRIBUTE_POSITION)
        else {
            panic!("a mesh has positions");
        };
        let (low, high) = positions
            .iter()
            .map(|at| Vec3::from(*at))
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), at| {
                (low.min(at), high.max(at))
            });
        (high - low).max_element()
    };
    scene.meshes.iter().map(of).collect()
}

/// What the measurements promise of their city.
fn check_large(scene: &Scene) {
    let triangles = scene.triangles();
    println!(
        "{}: {} objects, {triangles} triangles",
        scene.name,
        scene.objects.len()
    );
    assert!(triangles >= 1_300_000, "{triangles}");
    assert!(scene.objects.len() >= 10_000, "{}", scene.objects.len());
    let (sizes, counts) = (sizes(scene), scene.triangles_of_meshes());
    let of = |object: &bevy_skyline::offline::scenes::Object| {
        sizes[object.mesh] * object.transform.scale.x
    };
    let in_small: usize = scene
        .objects
        .iter()
        .filter(|object| of(object) < 15.0)
        .map(|object| counts[object.mesh])
        .sum();
    assert!(2 * in_small > triangles, "{in_small} of {triangles}");
    let (least, most) = scene
        .objects
        .iter()
        .map(of)
        .fold((f32::INFINITY, 0.0f32), |(a, b), s| (a.min(s), b.max(s)));
    assert!(most > 500.0 * least, "from {least} to {most} m");
    for object in &scene.objects {
        assert!(object.mesh < scene.meshes.len() && object.paint < scene.paints.len());
        assert!(object.transform.is_finite());
    }
    assert!(scene.views.iter().any(|view| view.name == "middle"));
}

#[test]
fn the_furnished_city_is_large_most_of_it_in_small_things_and_always_the_same() {
    let scene = city::furnished(CitySize::Medium);
    check_large(&scene);
    let again = city::furnished(CitySize::Medium);
    assert_eq!(scene.objects, again.objects);
    assert_eq!(scene.views, again.views);
    for (a, b) in scene.meshes.iter().zip(&again.meshes) {
        let positions = |mesh: &Mesh| {
            mesh.attribute(Mesh::ATTRIBUTE_POSITION)
                .map(|values| values.get_bytes().to_vec())
        };
        assert_eq!(positions(a), positions(b));
    }
}

#[test]
fn the_real_city_is_furnished_likewise() {
    let Some(path) = shared("city/manhattan_midtown.glb") else {
        return;
    };
    check_large(&city::furnished_from_file(&path).expect("the city can be read"));
}

fn run(stage: &mut WorkloadStage, policy: &Policy, path: WorkloadPath) -> Run {
    let goal = (10.0, Clock::Counted);
    let never = |_: &WorkloadStage| Ok::<(), OfflineError>(());
    drive(stage, policy, (path, FRAMES), goal, never).expect("nothing fails")
}

/// Entities of the scene that the last frame drew.
fn drawn(stage: &WorkloadStage) -> Vec<Entity> {
    let world = stage.offline.app.world();
    let visible = world
        .get::<VisibleEntities>(stage.camera())
        .expect("a camera has a list");
    let list = visible.get(core::any::TypeId::of::<Mesh3d>());
    assert!(list.is_sorted(), "the order is kept");
    list.iter()
        .copied()
        .filter(|entity| world.get::<SceneObject>(*entity).is_some())
        .collect()
}

/// How far every entity's nearest point is from the camera, by brute force over a fine grid of its bound.
fn distances(stage: &WorkloadStage, entities: &[Entity]) -> Vec<f32> {
    let world = stage.offline.app.world();
    let eye = world
        .get::<GlobalTransform>(stage.camera())
        .expect("a camera is somewhere")
        .translation();
    entities
        .iter()
        .map(|entity| {
            let place = world
                .get::<GlobalTransform>(*entity)
                .expect("it is somewhere");
            let bound = world.get::<Aabb>(*entity).expect("it has a bound");
            let steps = || (0..=8).map(|i| i as f32 / 4.0 - 1.0);
            steps()
                .flat_map(|x| steps().flat_map(move |y| steps().map(move |z| Vec3::new(x, y, z))))
                .map(|at| {
                    let local = Vec3::from(bound.center) + at * Vec3::from(bound.half_extents);
                    place.transform_point(local).distance(eye)
                })
                .fold(f32::INFINITY, f32::min)
        })
        .collect()
}

#[test]
fn each_policy_draws_what_it_says() {
    let Some(mut stage) = stage() else {
        return;
    };
    let rotate = WorkloadPath::Rotate;
    let all = run(&mut stage, &Policy::None, rotate);
    let (objects, triangles) = (stage.scene.objects.len(), stage.scene.triangles());
    for row in &all.rows {
        assert_eq!(row.measured.drawn.objects, objects as f64);
        assert_eq!(row.measured.drawn.triangles, triangles as f64);
    }
    let in_view = run(&mut stage, &Policy::Frustum, rotate);
    let whole: BTreeSet<Entity> = drawn(&stage).into_iter().collect();
    for (row, all) in in_view.rows.iter().zip(&all.rows) {
        assert_eq!(row.parameter, all.parameter);
        assert!(row.measured.drawn.objects < 0.8 * all.measured.drawn.objects);
        assert!(row.measured.drawn.objects > 20.0, "{row:?}");
    }
    // Angles differ in how much there is in view: that is what a budget is for.
    let counts = in_view.rows.iter().map(|row| row.measured.drawn.triangles);
    let (least, most) = counts.fold((f64::MAX, 0.0f64), |(a, b), n| (a.min(n), b.max(n)));
    assert!(most > 1.5 * least, "from {least} to {most}");

    let near = run(&mut stage, &Policy::Distance(120.0), rotate);
    let kept = drawn(&stage);
    assert!(kept.iter().all(|entity| whole.contains(entity)));
    assert!(!kept.is_empty() && kept.len() < whole.len());
    // The grid misses the nearest point by less than half the diagonal of a cell; see below for the other side.
    let gone: Vec<Entity> = whole
        .iter()
        .copied()
        .filter(|entity| !kept.contains(entity))
        .collect();
    assert!(
        distances(&stage, &gone)
            .iter()
            .all(|metres| *metres > 120.0)
    );
    assert!(near.rows.iter().all(|row| row.measured.drawn.objects > 0.0));

    let few = run(&mut stage, &Policy::Polygons(20_000), rotate);
    for (row, all) in few.rows.iter().zip(&in_view.rows) {
        let (triangles, all) = (row.measured.drawn.triangles, all.measured.drawn.triangles);
        assert!(triangles <= 20_000.0, "{triangles}");
        let least = all.min(15_000.0);
        assert!(triangles >= least, "as many as go: {triangles} of {all}");
    }
    let kept = drawn(&stage);
    let gone: Vec<Entity> = whole
        .iter()
        .copied()
        .filter(|entity| !kept.contains(entity))
        .collect();
    // Nearest points to within a cell's half diagonal, of things and of the few buildings that are near.
    let farthest = distances(&stage, &kept).into_iter().fold(0.0, f32::max);
    let nearest = distances(&stage, &gone)
        .into_iter()
        .fold(f32::MAX, f32::min);
    assert!(nearest > farthest - 12.0, "{nearest} and {farthest}");

    // A new policy finds nothing of the old ones.
    let again = run(&mut stage, &Policy::Frustum, rotate);
    for (a, b) in again.rows.iter().zip(&in_view.rows) {
        assert_eq!(a.measured.drawn, b.measured.drawn);
    }
}

#[test]
fn the_census_knows_what_baselines_will_draw() {
    let Some(mut stage) = stage() else {
        return;
    };
    stage.cost = Cost {
        object_ms: 0.01,
        triangle_ms: 1e-4,
        pixel_ms: 0.0,
        frame_ms: 1.0,
    };
    let cost = stage.cost;
    for path in [WorkloadPath::Rotate, WorkloadPath::Zoom, WorkloadPath::Walk] {
        let census = Census::take(&mut stage, path, FRAMES);
        let whole = census.mean_ms(&Policy::Frustum, &cost);
        let wanted = cost.frame_ms + 0.5 * (whole - cost.frame_ms);
        for baseline in BASELINES {
            let policy = census.tuned(baseline, &cost, wanted);
            // Hysteresis is between what comes and what goes: with it a threshold draws a little less.
            let slack = if matches!(policy, Policy::Threshold(_)) {
                0.1 * wanted
            } else {
                1e-9
            };
            let drawn = run(&mut stage, &policy, path).counted(wanted).mean;
            let foreseen = census.mean_ms(&policy, &cost);
            assert!(
                (drawn - foreseen).abs() <= slack,
                "{policy}: {drawn} and {foreseen}"
            );
            assert!(
                (0.8 * wanted..=wanted + slack).contains(&drawn),
                "{policy}: {drawn} for {wanted}"
            );
        }
    }
}

#[test]
fn a_counted_cost_is_learned_from_measured_frames() {
    let Some(mut stage) = stage() else {
        return;
    };
    let frames = stage.calibrate(WorkloadPath::Rotate, 3);
    assert_eq!(frames.len(), 15);
    assert!(frames.iter().all(|(_, ms)| ms.is_finite() && *ms > 0.0));
    let cost = Cost::fit(&frames).expect("frames were measured");
    println!("{cost:?}, misfit {}", cost.misfit(&frames));
    // Whatever the machine does meanwhile, drawing everything is counted as more than drawing a part of it.
    let most = frames.iter().map(|(drawn, _)| cost.of(*drawn));
    let (least, most) = most.fold((f64::MAX, 0.0f64), |(a, b), ms| (a.min(ms), b.max(ms)));
    assert!(least > 0.0 && most > least, "from {least} to {most}");
}

#[test]
fn the_budget_holds_the_counted_time_through_a_turn() {
    let Some(mut stage) = stage() else {
        return;
    };
    stage.cost = Cost {
        object_ms: 0.01,
        triangle_ms: 1e-5,
        pixel_ms: 0.0,
        frame_ms: 1.0,
    };
    let cost = stage.cost;
    let of_meshes = stage.scene.triangles_of_meshes();
    let frames = 60;
    let census = Census::take(&mut stage, WorkloadPath::Rotate, frames);
    // So that every frame can be brought up to it.
    let target_ms = cost.frame_ms + 0.7 * (census.least_ms(&cost) - cost.frame_ms);
    let mut turn = |policy: &Policy| {
        let goal = (target_ms, Clock::Counted);
        let way = (WorkloadPath::Rotate, frames);
        let never = |_: &WorkloadStage| Ok::<(), OfflineError>(());
        drive(&mut stage, policy, way, goal, never).expect("nothing fails")
    };
    let run = turn(&Policy::Budget);
    let held = run.counted(target_ms);
    println!("target {target_ms}: {held:?}");
    assert!(held.std <= 0.05 * target_ms, "{held:?} for {target_ms}");
    // A demand lies between two objects: up to the costlier of them stays unused in a frame, or is too much. There are
    // about 80 in one here.
    let most = of_meshes.iter().copied().max().unwrap_or(0);
    let one_ms = cost.object_ms + cost.triangle_ms * most as f64;
    let over = run.counted(target_ms + one_ms).over_budget_fraction;
    assert!(over <= 0.02, "{over}: {held:?} for {target_ms}");
    assert!(
        held.mean <= target_ms && held.mean >= 0.95 * target_ms - one_ms,
        "{held:?} for {target_ms}"
    );
    assert!(
        run.rows.iter().all(|row| row.measured.threshold_px2 > 0.0
            && row.measured.knobs.contains("contribution_area=")),
        "{:?}",
        run.rows[0]
    );
    for baseline in BASELINES {
        let policy = census.tuned(baseline, &cost, held.mean);
        let of = turn(&policy).counted(target_ms);
        println!("{policy}: {of:?}");
        assert!(
            (of.mean - held.mean).abs() < 0.1 * held.mean,
            "{policy}: {of:?}"
        );
    }
}

#[test]
fn what_is_hidden_can_be_left_out_under_every_policy() {
    let Some(mut stage) = stage() else {
        return;
    };
    let objects = |stage: &mut WorkloadStage, policy| {
        let run = run(stage, &policy, WorkloadPath::Walk);
        run.mean_drawn().objects
    };
    let half = Policy::Distance(100.0);
    let plain = [Policy::Frustum, half, Policy::None].map(|policy| objects(&mut stage, policy));
    stage.set_occludes(true);
    let hidden = [Policy::Frustum, half, Policy::None].map(|policy| objects(&mut stage, policy));
    println!("{plain:?} {hidden:?}");
    assert!(hidden[0] < 0.7 * plain[0] && hidden[1] < plain[1]);
    assert_eq!(
        hidden[2], plain[2],
        "without any culling everything is drawn"
    );
    // A census knows nothing of what comes into sight; the number is corrected by what was drawn.
    stage.cost = Cost {
        object_ms: 0.01,
        triangle_ms: 1e-5,
        pixel_ms: 0.0,
        frame_ms: 1.0,
    };
    let census = Census::take(&mut stage, WorkloadPath::Walk, FRAMES);
    let mean_ms = 1.0 + 0.6 * (census.mean_ms(&Policy::Frustum, &stage.cost) - 1.0);
    let mut runs = 0;
    let tuned = census.run_tuned(&mut stage, BASELINES[1], mean_ms, |stage, policy| {
        runs += 1;
        let run = run(stage, policy, WorkloadPath::Walk);
        let counted_ms = run.counted(10.0).mean;
        Ok::<_, OfflineError>((counted_ms, counted_ms))
    });
    let counted_ms = tuned.expect("nothing fails");
    println!("{counted_ms} for {mean_ms} in {runs} runs");
    assert!((counted_ms / mean_ms - 1.0).abs() < 0.05);
}
