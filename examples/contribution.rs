//! A city full of small things, most of which cover next to nothing of the picture: those are not drawn.
//!
//! ```sh
//! cargo run --all-features --example contribution
//! cargo run --all-features --example contribution -- city.glb --threshold 64
//! cargo run --all-features --example contribution -- --headless --out pictures
//! ```
//!
//! In the window: W, A, S, D, E and Q fly, Shift flies faster, the right mouse button looks around; + and − change the
//! threshold, 0 draws everything, X lets things fade out rather than vanish. Without a window there are three pictures:
//! everything, what is left, and what was left out in red.

#[path = "common/city.rs"]
mod city;
#[path = "common/stage.rs"]
mod stage;

use std::path::PathBuf;

use bevy::prelude::*;
use bevy_skyline::{
    offline::scenes::city::{CitySize, furnished, furnished_from_file},
    prelude::*,
};
use stage::{Film, Stage, StageError, Status};

/// How long things fade. units: s
const FADE_S: f32 = 0.4;

/// Leaves out what covers too little of the picture, in a window or in pictures with and without.
#[derive(clap::Args)]
struct Options {
    /// glTF binary with one node and mesh a building, which is furnished; else a city made by code.
    file: Option<PathBuf>,
    /// What covers fewer square pixels is not drawn.
    #[arg(long, value_name = "PX2", default_value_t = ContributionCulling::default().threshold_px2)]
    threshold: f32,
}

fn main() -> AppExit {
    stage::start(run)
}

fn run(stage: Stage, options: Options) -> Result<AppExit, StageError> {
    let size = if stage.options.small {
        CitySize::Small
    } else {
        CitySize::Medium
    };
    let scene = city::read_or_make(options.file.as_deref(), furnished_from_file, || {
        furnished(size)
    })?;
    let culling = ContributionCulling {
        threshold_px2: options.threshold.max(0.0),
        ..default()
    };
    let stage = Stage {
        keys: "+ and - change the threshold, 0 draws everything, X fades",
        effects: &[Effect::ContributionCulling],
        ..stage
    };
    stage.show(
        |app| {
            app.add_systems(Update, choose).add_systems(Last, describe);
        },
        |world| {
            city::populate(world, &scene, "over", culling.clone());
        },
        |film| compare(film, &culling),
    )
}

/// Pictures with and without, by how many pixels they differ, and what was left out, in red.
fn compare(film: &mut Film, culling: &ContributionCulling) -> Result<(), StageError> {
    let set = |film: &mut Film, threshold_px2| {
        let world = film.world();
        let mut cameras = world.query::<&mut ContributionCulling>();
        for mut culling in cameras.iter_mut(world) {
            culling.threshold_px2 = threshold_px2;
        }
        film.settle();
    };
    set(film, 0.0);
    film.time("everything", |_, _| {});
    let whole = film.look()?;
    film.write("all", &whole)?;
    set(film, culling.threshold_px2);
    film.time("what contributes", |_, _| {});
    let culled = film.look()?;
    film.write("culled", &culled)?;
    println!(
        "{} of {} pixels differ",
        stage::differing(&whole, &culled),
        whole.pixels().len()
    );
    let world = film.world();
    let red = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            base_color: Color::srgb(1.0, 0.0, 0.0),
            unlit: true,
            ..default()
        });
    let mut cameras = world.query::<&CulledEntities>();
    let removed: Vec<Entity> = cameras
        .iter(world)
        .flat_map(CulledEntities::iter)
        .map(|(entity, _)| entity)
        .collect();
    for entity in removed {
        world.entity_mut(entity).insert(MeshMaterial3d(red.clone()));
    }
    set(film, 0.0);
    film.picture("removed")
}

fn choose(world: &mut World) {
    let step = stage::sign(world);
    let [all, fade] = stage::pressed(world, [KeyCode::Digit0, KeyCode::KeyX]);
    let mut cameras = world.query::<&mut ContributionCulling>();
    if step == 0 && !all && !fade {
        return;
    }
    for mut culling in cameras.iter_mut(world) {
        culling.threshold_px2 = match (all, step) {
            (true, _) => 0.0,
            (_, 0) => culling.threshold_px2,
            _ => (culling.threshold_px2 * 2f32.powi(step)).clamp(1.0, 4096.0),
        };
        if fade {
            let fades = ContributionExit::Dithered { seconds: FADE_S };
            culling.exit = stage::after(&[ContributionExit::Cut, fades], culling.exit);
        }
    }
}

fn describe(cameras: Query<&ContributionCounts>, mut status: ResMut<Status>) {
    for counts in &cameras {
        status.0 = format!(
            "threshold {} px²: {} of {} objects in view left out, {} of {} triangles drawn",
            counts.threshold_px2,
            counts.removed,
            counts.candidates,
            counts.triangles_drawn,
            counts.triangles
        );
    }
}
