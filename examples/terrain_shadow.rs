//! A day over mountains: the sun goes its way, and the mountains shade each other, the valleys and what stands there.
//!
//! ```sh
//! cargo run --all-features --example terrain_shadow
//! cargo run --all-features --example terrain_shadow -- heights.png
//! cargo run --all-features --example terrain_shadow -- --headless --out pictures
//! ```
//!
//! In the window: W, A, S, D, E and Q fly, the right mouse button looks around; Space stops the sun, the arrows set the
//! hour; 1 to 3 choose how shadows are found: a ray a sample, rays that skip, sweeps; + and − how long that may take in
//! one frame; P hard shadows, penumbrae from one ray, or from 8.

#[path = "common/landscape.rs"]
mod landscape;
#[path = "common/scene.rs"]
mod scene;
#[path = "common/stage.rs"]
mod stage;

use core::f32::consts::PI;
use std::path::PathBuf;

use bevy::prelude::*;
use bevy_skyline::prelude::*;
use scene::Viewpoint;
use stage::{Stage, StageError, Status};

const METHODS: [ShadowMethod; 3] = [
    ShadowMethod::PerTexel,
    ShadowMethod::MaxMip,
    ShadowMethod::Sweep,
];
const STRIPS: [u32; 3] = [0, 1, 8];
/// Pictures are taken at these. units: h
const HOURS: [f32; 3] = [7.0, 12.0, 17.0];
/// The sun is up from 6 to 18; it is not followed to the very horizon. units: h
const DAY: (f32, f32) = (6.3, 17.7);
/// units: rad
const CLOSE_FOV: f32 = 0.16;
/// How fast it goes by itself, and with the arrows. units: h/s
const PACE: [f32; 2] = [0.25, 2.0];

/// Shows the shadows of a terrain in a window, or makes pictures of them from morning to evening.
#[derive(clap::Args)]
struct Options {
    /// Elevation file; else mountains made by code.
    file: Option<PathBuf>,
}

/// The time of day. units: h
#[derive(Resource)]
struct Clock {
    hour: f32,
    runs: bool,
}

/// Where meshes stand. units: m
#[derive(Resource, Clone, Copy)]
struct Meshes(Vec3);

fn main() -> AppExit {
    stage::start(run)
}

fn run(stage: Stage, options: Options) -> Result<AppExit, StageError> {
    let field = landscape::read_or_make(options.file.as_deref(), stage.options.small)?;
    let viewpoint = Viewpoint::over(&field);
    let runs = !stage.is_headless();
    let stage = Stage {
        keys: "Space stops the sun, the arrows set the hour; 1 per texel, 2 max mip, 3 sweep; + and - time a frame; P penumbrae",
        effects: &[Effect::TerrainShadow],
        ..stage
    };
    stage.show(
        |app| {
            app.insert_resource(Clock {
                hour: HOURS[0],
                runs,
            })
            .add_systems(Update, (choose, go, describe).chain());
        },
        |world| {
            let meshes = scene::populate(world, field, viewpoint, ());
            world.insert_resource(Meshes(meshes));
        },
        |film| {
            for hour in HOURS {
                film.world().resource_mut::<Clock>().hour = hour;
                scene::settle(film)?;
                film.time(&format!("{hour} h"), |_, _| {});
                film.picture(&format!("{hour:02}h"))?;
            }
            look_closer(film.world());
            scene::settle(film)?;
            film.picture("close")
        },
    )
}

/// A long lens: penumbrae, and meshes that stand half in them.
fn look_closer(world: &mut World) {
    let Meshes(meshes) = *world.resource::<Meshes>();
    let mut cameras = world.query_filtered::<(&mut Transform, &mut Projection), With<Camera3d>>();
    for (mut place, mut projection) in cameras.iter_mut(world) {
        place.look_at(meshes, Vec3::Y);
        if let Projection::Perspective(lens) = &mut *projection {
            lens.fov = CLOSE_FOV;
        }
    }
}

/// The sun, from where it rises to where it sets.
fn go(
    time: Res<Time>,
    mut clock: ResMut<Clock>,
    mut suns: Query<(&mut Transform, &mut DirectionalLight)>,
) {
    if clock.runs {
        clock.hour += PACE[0] * time.delta_secs();
        if clock.hour > DAY.1 {
            clock.hour = DAY.0;
        }
    }
    if !clock.is_changed() {
        return;
    }
    let (sin, cos) = (PI * (clock.hour - 6.0) / 12.0).sin_cos();
    let to_sun = Vec3::new(cos, 0.8 * sin, -0.6 * sin);
    for (mut place, mut light) in &mut suns {
        *place = Transform::default().looking_to(-to_sun, Vec3::Y);
        light.color = Color::srgb(1.0, 0.6 + 0.35 * sin, 0.3 + 0.6 * sin);
    }
}

fn choose(world: &mut World) {
    let (method, step) = (stage::digit(world), stage::sign(world));
    let [stop, penumbra] = stage::pressed(world, [KeyCode::Space, KeyCode::KeyP]);
    let keys = world.resource::<ButtonInput<KeyCode>>();
    let held = |key| f32::from(u8::from(keys.pressed(key)));
    let turn = held(KeyCode::ArrowRight) - held(KeyCode::ArrowLeft);
    let hours = turn * PACE[1] * world.resource::<Time>().delta_secs();
    if stop || hours != 0.0 {
        let mut clock = world.resource_mut::<Clock>();
        clock.runs ^= stop;
        clock.hour = (clock.hour + hours).clamp(DAY.0, DAY.1);
    }
    let mut shadows = world.query::<&mut TerrainShadow>();
    if method.is_none() && step == 0 && !penumbra {
        return;
    }
    for mut shadow in shadows.iter_mut(world) {
        if let Some(method) = method.and_then(|index| METHODS.get(index)) {
            shadow.method = *method;
        }
        if penumbra {
            shadow.penumbra_strips = stage::after(&STRIPS, shadow.penumbra_strips);
        }
        shadow.slice_ms = (shadow.slice_ms * 2f32.powi(step)).clamp(0.25, 64.0);
    }
}

fn describe(clock: Res<Clock>, shadows: Query<&TerrainShadow>, mut status: ResMut<Status>) {
    for shadow in &shadows {
        status.0 = format!(
            "{:.1} h, {:?}, {} strips, {} ms a frame",
            clock.hour, shadow.method, shadow.penumbra_strips, shadow.slice_ms
        );
    }
}
