//! Many frames with all effects, a camera that moves, things that come and go: memory, entities, assets and what effects
//! hold stay as they are.
//!
//! The suite runs [`FRAMES`]; `SKYLINE_SOAK_FRAMES=20000 scripts/test.sh robust_soak` runs as many as it is told. It runs
//! in a process of its own, as other tests' memory is not its concern.

use std::process::Command;

use bevy::{
    pbr::BinUnpackingBindGroups,
    prelude::*,
    render::{Render, RenderApp, RenderSystems, view::ExtractedView},
};
use bevy_skyline::{
    budget::{BudgetClock, GivenFrameTimes},
    prelude::*,
};

use crate::{
    allocations::live,
    fuzz::Lot,
    life_stage::{Stage, culling, front, hills, index, interior, shadow},
};

/// A way to leak.
type Leak = fn(&mut Round, i64);

/// What is held at the end of a round, by what it is of, on the heap, and resident; both in bytes.
type Round = (Held, i64, Option<i64>);

/// Where nothing else is asked for.
const FRAMES: u32 = 640;
/// After so many frames everything has come and gone, and is as it was.
const ROUND: u32 = 160;
/// The heap may grow by so much from one round to another: what allocators and hash maps keep varies. Bytes.
const HEAP_SLACK: i64 = 256 << 10;
/// What an effect holds on the GPU: buffers have room for the most that was ever asked for. Bytes.
const EFFECT_SLACK: u64 = 4096;
/// The whole process by so much more: drivers and allocators keep pages.
const RSS_SLACK: i64 = 4 << 20;

/// Resident memory of this process; `None` where there is no `/proc`. Bytes.
fn resident() -> Option<i64> {
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: i64 = text.split_whitespace().nth(1)?.parse().ok()?;
    // The page size of every machine that these tests are run on is at least this; growth is told in pages.
    Some(pages * 4096)
}

/// What is held at the end of a round.
#[derive(Clone, Debug, PartialEq)]
struct Held {
    counts: crate::life_stage::Counts,
    render_entities: u32,
    bytes: Vec<(String, u64)>,
}

fn held(stage: &Stage) -> Held {
    let mut bytes: Vec<(String, u64)> = stage
        .effects()
        .iter()
        .map(|(effect, state)| {
            let held = match state {
                EffectState::Active(activity) => activity.bytes,
                _ => 0,
            };
            (format!("{effect:?}"), held)
        })
        .collect();
    bytes.sort();
    let render = stage.offline.app.get_sub_app(bevy::render::RenderApp);
    Held {
        counts: stage.count(),
        render_entities: render.map_or(0, |render| render.world().entities().count_spawned()),
        bytes,
    }
}

/// One frame of a round: what happens depends on its number alone.
fn frame(stage: &mut Stage, number: u32) {
    let mut lot = Lot::of("soak", u64::from(number));
    let turn =
        Quat::from_rotation_y(0.5 * (number as f32 * core::f32::consts::TAU / ROUND as f32).sin());
    let mut place = front();
    place.rotate_around(Vec3::new(32.0, 4.0, 36.0), turn);
    let camera = stage.camera;
    // It may be gone.
    if let Ok(mut camera) = stage.world().get_entity_mut(camera) {
        camera.insert(place);
    }
    // A machine of ever the same time, now and then of another.
    let last_ms = Some(if number.is_multiple_of(50) {
        40.0
    } else {
        12.0 + 5.0 * lot.unit() as f32
    });
    stage.world().insert_resource(GivenFrameTimes { last_ms });
    if number.is_multiple_of(4) {
        let at = Vec3::new(
            40.0 * lot.unit() as f32 + 12.0,
            5.0,
            40.0 * lot.unit() as f32,
        );
        stage.spawn_box(Transform::from_translation(at));
    }
    if number % 4 == 2
        && let Some(gone) = stage.boxes.pop()
    {
        stage.world().despawn(gone);
    }
    if number.is_multiple_of(9) {
        let field = stage.field.clone();
        let mut fields = stage.world().resource_mut::<Assets<HeightField>>();
        let mut field = fields.get_mut(&field).expect("a field");
        let corner = UVec2::new(lot.below(50) as u32, lot.below(50) as u32);
        let rect = URect::from_corners(corner, corner + 9);
        field
            .edit(rect, |_, _, old| 0.9 * old + 0.2)
            .expect("it is within the field");
    }
    match number {
        17 => stage.spawn_ball(),
        37 => stage.spawn_model(),
        52 => stage.spawn_terrain(),
        63 => stage.spawn_sun(),
        71 => spawn_camera(stage),
        116 => {
            let mesh = stage.meshes.core.clone();
            let mut meshes = stage.world().resource_mut::<Assets<Mesh>>();
            let made = meshes.insert(&mesh, Sphere::new(1.0).mesh().uv(24, 12));
            made.expect("the handle is its own");
        }
        _ => come_and_go(stage, number),
    }
    stage.step();
}

/// Entities and components.
fn come_and_go(stage: &mut Stage, number: u32) {
    let (terrain, model, ball, sun) = (stage.terrain, stage.model, stage.ball, stage.sun);
    let camera = stage.camera;
    let world = stage.world();
    let gone = match number {
        13 => Some(ball),
        30 => Some(model),
        50 => Some(terrain),
        60 => Some(sun),
        70 => Some(camera),
        _ => None,
    };
    if let Some(gone) = gone {
        world.despawn(gone);
    }
    match number {
        80 => {
            world.entity_mut(terrain).remove::<TerrainShadow>();
        }
        84 => {
            world.entity_mut(terrain).insert(shadow());
        }
        90 => {
            world.entity_mut(model).remove::<InteriorCulling>();
        }
        94 => {
            world.entity_mut(model).insert(interior());
        }
        100 => {
            world.entity_mut(ball).remove::<SphericalIndex>();
        }
        103 => {
            world.entity_mut(ball).insert(index());
        }
        110 => {
            let mut camera = world.entity_mut(camera);
            camera.remove::<(ZBufferOcclusion, ContributionCulling, FrameBudget)>();
        }
        112 => {
            world.entity_mut(camera).insert((culling(), budget()));
        }
        _ => {}
    }
}

fn budget() -> FrameBudget {
    FrameBudget {
        target_ms: 16.0,
        clock: BudgetClock::Given,
    }
}

fn spawn_camera(stage: &mut Stage) {
    stage.spawn_camera();
    let camera = stage.camera;
    stage
        .world()
        .entity_mut(camera)
        .insert((budget(), ResolutionScale::default()));
}

/// A round, from the same heights each time, and what is held at its end.
fn round(stage: &mut Stage) -> Held {
    let field = stage.field.clone();
    let mut fields = stage.world().resource_mut::<Assets<HeightField>>();
    fields
        .insert(&field, hills())
        .expect("the handle is its own");
    for number in 0..ROUND {
        // Whatever the budget made of it.
        if number == 120 {
            let camera = stage.camera;
            stage.world().despawn(camera);
            spawn_camera(stage);
        }
        frame(stage, number);
    }
    held(stage)
}

/// Bevy 0.19.1 keeps the bind groups that unpack bins, and the buffers in them, of every view that there ever was: 18 kB for a
/// round, which has two cameras and a sun of its own. What is looked at here is what else is kept.
fn forget_views_that_are_gone(
    mut groups: ResMut<BinUnpackingBindGroups>,
    views: Query<&ExtractedView>,
) {
    groups.retain(|key, _| {
        views
            .iter()
            .any(|view| view.retained_view_entity == key.view)
    });
}

fn soak(frames: u32) {
    let Some(mut stage) = Stage::new() else {
        return;
    };
    if let Some(render) = stage.offline.app.get_sub_app_mut(RenderApp) {
        render.add_systems(
            Render,
            forget_views_that_are_gone
                .run_if(resource_exists::<BinUnpackingBindGroups>)
                .in_set(RenderSystems::Cleanup),
        );
    }
    let camera = stage.camera;
    stage.world().despawn(camera);
    spawn_camera(&mut stage);
    let rounds = frames.div_ceil(ROUND).max(3);
    let start = std::time::Instant::now();
    let mut all: Vec<Round> = Vec::new();
    for number in 0..rounds {
        let mut now = round(&mut stage);
        // Work in the background may take a little longer each time; it is waited for, as its results are held.
        let mut waited = 0;
        let is_there = |now: &Held, before: &Held| {
            (now.counts, now.render_entities) == (before.counts, before.render_entities)
        };
        while waited < 100
            && all
                .last()
                .is_some_and(|(before, ..)| !is_there(&now, before))
        {
            stage.step();
            waited += 1;
            now = held(&stage);
        }
        let (heap, rss) = (live(), resident());
        println!("round {number}: {now:?}, heap {heap}, resident {rss:?}, waited {waited}");
        all.push((now, heap, rss));
    }
    assert!(!stage.has_ended());
    println!(
        "{} frames in {:.1} s",
        rounds * ROUND,
        start.elapsed().as_secs_f64()
    );
    check(&all);
}

/// The first round makes pipelines and takes memory; from then on nothing grows.
fn check(rounds: &[Round]) {
    let quarter = (rounds.len() / 4).max(1);
    let (early, late) = (
        &rounds[quarter..2 * quarter + 1],
        &rounds[rounds.len() - quarter..],
    );
    for (held, ..) in &rounds[quarter..] {
        assert_eq!(held.counts, early[0].0.counts, "what is held changes");
        // A late view is there while something is drawn late, and for a while after.
        let most = early[0].0.render_entities + 2;
        assert!(held.render_entities <= most, "the render world grows");
    }
    for (effect, _) in &early[0].0.bytes {
        let of = |rounds: &[Round]| -> Option<u64> {
            let all = rounds.iter().flat_map(|(held, ..)| &held.bytes);
            all.filter(|(name, _)| name == effect)
                .map(|(_, bytes)| *bytes)
                .max()
        };
        let (before, after) = (of(early).unwrap_or(0), of(late).unwrap_or(0));
        let most = before + EFFECT_SLACK;
        assert!(after <= most, "{effect} holds {before} bytes, then {after}");
    }
    let most = |of: &[Round], which: fn(&Round) -> Option<i64>| of.iter().filter_map(which).max();
    for (name, slack, which) in [
        (
            "heap",
            HEAP_SLACK,
            (|round| Some(round.1)) as fn(&Round) -> _,
        ),
        ("resident memory", RSS_SLACK, |round| round.2),
    ] {
        let (Some(before), Some(after)) = (most(early, which), most(late, which)) else {
            println!("skipped: there is no /proc to read {name} from");
            continue;
        };
        println!("{name}: {before} bytes early, {after} late");
        assert!(
            after - before <= slack,
            "{name} grows: {before} bytes, then {after}"
        );
    }
}

#[test]
fn nothing_grows_over_many_frames() {
    const INSIDE: &str = "SKYLINE_SOAK_INSIDE";
    if std::env::var_os(INSIDE).is_some() {
        let frames = std::env::var("SKYLINE_SOAK_FRAMES");
        soak(frames.map_or(FRAMES, |frames| {
            frames.parse().expect("a whole number of frames")
        }));
        return;
    }
    let program = std::env::current_exe().expect("this program has a path");
    let output = Command::new(program)
        .args([
            "--exact",
            "robust_soak::nothing_grows_over_many_frames",
            "--nocapture",
        ])
        .env(INSIDE, "1")
        .output()
        .expect("it can be run again");
    let [out, error] =
        [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    println!("{out}\n{error}");
    assert!(output.status.success(), "{}", output.status);
    assert!(out.contains("1 passed"), "it ran nothing");
}

/// Sabotage: a leak in any of what is looked at is noticed.
#[test]
fn what_grows_is_noticed() {
    let base = Held {
        counts: crate::life_stage::Counts {
            entities: 9,
            meshes: 8,
            materials: 7,
            images: 6,
            fields: 1,
        },
        render_entities: 20,
        bytes: vec![("Terrain".into(), 1000)],
    };
    let rounds = |grow: Leak| {
        let mut rounds = vec![(base.clone(), 50_000_000, Some(90_000_000)); 40];
        for (number, round) in rounds.iter_mut().enumerate() {
            grow(round, number as i64);
        }
        rounds
    };
    check(&rounds(|round, number| round.1 += number % 7 * 1000));

    let leaks: [Leak; 5] = [
        |round, number| round.0.counts.entities += number as usize,
        |round, number| round.0.render_entities += number as u32,
        |round, number| round.0.bytes[0].1 += 500 * number as u64,
        // A hundred bytes a frame.
        |round, number| round.1 += number * 100 * i64::from(ROUND),
        |round, number| round.2 = round.2.map(|rss| rss + number * 4096 * 100),
    ];
    for (which, leak) in leaks.into_iter().enumerate() {
        let rounds = rounds(leak);
        let told = std::panic::catch_unwind(|| check(&rounds));
        assert!(told.is_err(), "leak {which} goes unnoticed");
    }
}
