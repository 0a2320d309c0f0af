//! A terrain to fly over: an elevation file, or mountains made by code. Rays draw it, to within an error that is set.
//!
//! ```sh
//! cargo run --all-features --example terrain
//! cargo run --all-features --example terrain -- heights.png
//! cargo run --all-features --example terrain -- --headless --out pictures
//! ```
//!
//! In the window: W, A, S, D, E and Q fly, Shift flies faster, the right mouse button looks around, the wheel
//! sets the speed; 1 to 4 choose how rays skip empty space, + and − how far the picture may be from the exact
//! surface.

#[path = "common/landscape.rs"]
mod landscape;
#[path = "common/scene.rs"]
mod scene;
#[path = "common/stage.rs"]
mod stage;

use std::path::PathBuf;

use bevy::prelude::*;
use bevy_skyline::{
    offline::{TRAVERSALS, traversal_name},
    prelude::*,
};
use scene::Viewpoint;
use stage::{Stage, StageError, Status};

/// Errors that + and − step through. units: px
const ERRORS_PX: [f32; 6] = [0.0, 0.5, 1.0, 2.0, 4.0, 8.0];

/// Shows a terrain in a window, or makes a picture of it.
#[derive(clap::Args)]
struct Options {
    /// Elevation file: 16-bit PNG or TIFF, float TIFF, SRTM .hgt, raw 16-bit; else mountains made by code.
    file: Option<PathBuf>,
    /// How far the picture may be from the exact surface, in pixels; 0 is exact.
    #[arg(long, value_name = "E", default_value_t = TerrainRayCasting::default().max_error_px)]
    max_error_px: f32,
}

fn main() -> AppExit {
    stage::start(run)
}

fn run(stage: Stage, options: Options) -> Result<AppExit, StageError> {
    let field = landscape::read_or_make(options.file.as_deref(), stage.options.small)?;
    let viewpoint = Viewpoint::over(&field);
    let casting = TerrainRayCasting {
        max_error_px: options.max_error_px.max(0.0),
        ..default()
    };
    let stage = Stage {
        keys: "1 per texel, 2 max mip, 3 boxes, 4 hybrid; + and - change the error allowed",
        effects: &[Effect::Terrain, Effect::TerrainShadow],
        ..stage
    };
    stage.show(
        |app| {
            app.add_systems(Update, (choose, describe).chain());
        },
        |world| {
            scene::populate(world, field, viewpoint, casting);
        },
        |film| {
            scene::settle(film)?;
            film.time("frame times", |_, _| {});
            film.picture("")
        },
    )
}

fn choose(world: &mut World) {
    let (traversal, step) = (stage::digit(world), stage::sign(world));
    let mut cameras = world.query::<&mut TerrainRayCasting>();
    if traversal.is_none() && step == 0 {
        return;
    }
    for mut casting in cameras.iter_mut(world) {
        if let Some(index) = traversal {
            casting.traversal = TRAVERSALS[index].0;
        }
        let at = ERRORS_PX
            .iter()
            .rposition(|error| *error <= casting.max_error_px)
            .unwrap_or(0);
        let last = ERRORS_PX.len() as i32 - 1;
        casting.max_error_px = ERRORS_PX[(at as i32 + step).clamp(0, last) as usize];
    }
}

fn describe(cameras: Query<&TerrainRayCasting>, mut status: ResMut<Status>) {
    for casting in &cameras {
        status.0 = format!(
            "{}, at most {} px off",
            traversal_name(casting.traversal),
            casting.max_error_px
        );
    }
}
