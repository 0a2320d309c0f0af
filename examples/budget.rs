//! A city that is heavier to one side than to the other, and one frame time wherever the camera looks.
//!
//! ```sh
//! cargo run --all-features --example budget
//! cargo run --all-features --example budget -- city.glb --target-ms 16.7
//! cargo run --all-features --example budget -- --headless --frames 60 --out pictures
//! ```
//!
//! In the window the camera turns on the spot until Space stops it; B switches the budget on and off, + and − change
//! what a frame may take; W, A, S, D, E and Q fly, the right mouse button looks around. Without a window there are a
//! picture with the budget and one without, and a plot of the frame times of both turns.

#[path = "common/city.rs"]
mod city;
#[path = "common/stage.rs"]
mod stage;

use core::f32::consts::TAU;
use std::path::PathBuf;

use bevy::prelude::*;
use bevy_skyline::{
    budget::GivenFrameTimes,
    offline::{
        plot::{Axis, LinePlot, Series},
        scenes::city::{CitySize, furnished, furnished_from_file},
        workload::Steadiness,
    },
    prelude::*,
};
use stage::{Film, Stage, StageError, Status};

/// How fast the camera turns in the window. units: rad/s
const TURN: f32 = 0.3;
/// What is filmed of a turn, of the city made by code from where little is in view to where much is. units: turns
const FILMED: [f32; 2] = [0.3, 0.05];
/// Frames from which a budget learns what work costs here, before the turn.
const LEAD_FRAMES: u32 = 40;

/// Holds a frame time while the camera turns, in a window or as a plot with and without.
#[derive(clap::Args)]
struct Options {
    /// glTF binary with one node and mesh a building, which is furnished; else a city made by code.
    file: Option<PathBuf>,
    /// What a frame may take, in ms [default: 16.7 in a window; else what it takes on average without a budget].
    #[arg(long, value_name = "MS")]
    target_ms: Option<f32>,
}

/// Whether the camera turns by itself, and what a frame may take. units: ms
#[derive(Resource)]
struct Turn {
    runs: bool,
    target_ms: f32,
}

fn main() -> AppExit {
    stage::start(run)
}

fn run(stage: Stage, options: Options) -> Result<AppExit, StageError> {
    if options
        .target_ms
        .is_some_and(|ms| !(ms.is_finite() && ms > 0.0))
    {
        return Err(StageError::input("--target-ms: give a number above 0"));
    }
    let size = if stage.options.small {
        CitySize::Small
    } else {
        CitySize::Medium
    };
    let scene = city::read_or_make(options.file.as_deref(), furnished_from_file, || {
        furnished(size)
    })?;
    let turn = Turn {
        runs: !stage.is_headless(),
        target_ms: options.target_ms.unwrap_or(16.7),
    };
    let stage = Stage {
        keys: "Space stops the camera, B the budget on and off, + and - change what a frame may take",
        effects: &[Effect::FrameBudget],
        ..stage
    };
    // What the budget moves: it takes out no more than it has to.
    let culling = ContributionCulling {
        threshold_px2: 0.0,
        ..default()
    };
    let budget = FrameBudget::from_ms(turn.target_ms);
    stage.show(
        |app| {
            app.insert_resource(turn)
                .add_systems(Update, (choose, go).chain())
                .add_systems(Last, describe);
        },
        |world| {
            city::populate(world, &scene, "over", (culling, budget));
        },
        |film| plot(film, options.target_ms),
    )
}

/// Both turns as pictures and as a plot.
fn plot(film: &mut Film, target_ms: Option<f32>) -> Result<(), StageError> {
    let off = turn(film, "budget off", None)?;
    let mean = Steadiness::of(off.iter().copied(), f64::MAX).mean;
    let target_ms = target_ms.map_or(mean, f64::from);
    let on = turn(film, "budget on", Some(target_ms as f32))?;
    let turned = f64::from((FILMED[1] - FILMED[0]).abs());
    let degrees = |i: usize| 360.0 * turned * i as f64 / off.len() as f64;
    let series = |name: &str, times_ms: &[f64]| {
        let times = Steadiness::of(times_ms.iter().copied(), target_ms);
        println!(
            "{name}: mean {:.1} ms, standard deviation {:.1} ms, {:.0} % above {target_ms:.1} ms",
            times.mean,
            times.std,
            100.0 * times.over_budget_fraction
        );
        Series {
            name: name.into(),
            points: times_ms
                .iter()
                .enumerate()
                .map(|(i, ms)| (degrees(i), *ms))
                .collect(),
            quoted: false,
        }
    };
    let target = Series {
        name: "target".into(),
        points: vec![(0.0, target_ms), (degrees(off.len() - 1), target_ms)],
        quoted: true,
    };
    let plot = LinePlot {
        title: "Frame time while the camera turns".into(),
        x: Axis::linear("turned by (degrees)"),
        y: Axis::linear("frame time (ms)"),
        series: vec![series("budget off", &off), series("budget on", &on), target],
    };
    plot.write(&film.path("times")).map_err(StageError::input)?;
    film.wrote("times");
    Ok(())
}

/// A turn with a budget or without. Returns the time of each frame. units: ms
fn turn(film: &mut Film, name: &str, target_ms: Option<f32>) -> Result<Vec<f64>, StageError> {
    let world = film.world();
    let mut cameras = world.query_filtered::<(Entity, &Transform), With<Camera3d>>();
    let cameras: Vec<_> = cameras
        .iter(world)
        .map(|(camera, place)| (camera, *place))
        .collect();
    for &(camera, _) in &cameras {
        // Nobody waits for a display here: the time given is that of the whole frame, until the GPU was done.
        let budget = target_ms.map(|ms| FrameBudget {
            clock: BudgetClock::Given,
            ..FrameBudget::from_ms(ms)
        });
        let mut camera = world.entity_mut(camera);
        match budget {
            Some(budget) => camera.insert(budget),
            None => camera.remove::<FrameBudget>(),
        };
    }
    film.settle();
    let frames = film.options.frames;
    let lead = target_ms.map_or(0, |_| LEAD_FRAMES.min(10 * frames));
    let mut times_ms = Vec::new();
    for frame in 0..lead + frames {
        let part = frame.saturating_sub(lead) as f32 / frames as f32;
        let part = FILMED[0].lerp(FILMED[1], part);
        for &(camera, place) in &cameras {
            let turned = Quat::from_rotation_y(TAU * part) * place.rotation;
            film.world()
                .entity_mut(camera)
                .insert(place.with_rotation(turned));
        }
        let frame_ms = film.step();
        film.world().resource_mut::<GivenFrameTimes>().last_ms = Some(frame_ms as f32);
        if frame >= lead {
            times_ms.push(frame_ms);
        }
    }
    film.tell(name, times_ms.clone());
    film.picture(if target_ms.is_some() { "on" } else { "off" })?;
    for (camera, place) in cameras {
        film.world().entity_mut(camera).insert(place);
    }
    Ok(times_ms)
}

fn go(time: Res<Time>, turn: Res<Turn>, mut cameras: Query<&mut Transform, With<Camera3d>>) {
    for mut place in cameras.iter_mut().filter(|_| turn.runs) {
        place.rotate_y(TURN * time.delta_secs());
    }
}

fn choose(world: &mut World) {
    let step = stage::sign(world);
    let [stop, switch] = stage::pressed(world, [KeyCode::Space, KeyCode::KeyB]);
    if step == 0 && !stop && !switch {
        return;
    }
    let mut turn = world.resource_mut::<Turn>();
    turn.runs ^= stop;
    turn.target_ms *= 1.25f32.powi(step);
    let budget = FrameBudget::from_ms(turn.target_ms);
    let mut cameras = world.query_filtered::<(Entity, Has<FrameBudget>), With<Camera3d>>();
    for (camera, is_on) in cameras.iter(world).collect::<Vec<_>>() {
        let mut camera = world.entity_mut(camera);
        if is_on != switch {
            camera.insert(budget.clone());
        } else {
            camera.remove::<FrameBudget>();
        }
    }
}

fn describe(cameras: Query<(&ContributionCounts, Has<FrameBudget>)>, mut status: ResMut<Status>) {
    for (counts, is_on) in &cameras {
        status.0 = format!(
            "budget {}: {} of {} objects in view drawn, {} of {} triangles",
            if is_on { "on" } else { "off" },
            counts.candidates.saturating_sub(counts.removed),
            counts.candidates,
            counts.triangles_drawn,
            counts.triangles
        );
    }
}
