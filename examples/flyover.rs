//! A city on a mountain coast at a steady frame time: every effect of the suite in one flight.
//!
//! ```sh
//! cargo run --all-features --example flyover
//! cargo run --all-features --example flyover -- heights.png
//! cargo run --all-features --example flyover -- --headless --frames 48 --out pictures
//! ```
//!
//! In the window the camera follows a script until C gives it to you: W, A, S, D, E and Q fly then, Shift flies faster,
//! the right mouse button looks around. 1 terrain shadow, 2 occlusion culling, 3 contribution culling, 4 interior
//! culling, 5 spherical index, 6 frame budget; 0 all of them on or off; V shows the picture with and without them side
//! by side; X cuts the tower open, which interior culling has emptied; Space stops the time; the arrows turn the sun. With
//! feature `panel`, F3 opens the panel.

#[path = "flyover/buildings.rs"]
mod buildings;
#[path = "flyover/coast.rs"]
mod coast;
#[path = "flyover/film.rs"]
mod film;
#[path = "flyover/ground.rs"]
mod ground;
#[path = "flyover/label.rs"]
mod label;
#[path = "flyover/landmark.rs"]
mod landmark;
#[path = "flyover/path.rs"]
mod path;
#[path = "flyover/rocks.rs"]
mod rocks;
#[path = "flyover/shape.rs"]
mod shape;
#[path = "flyover/site.rs"]
mod site;
#[path = "flyover/sky.rs"]
mod sky;
#[path = "flyover/split.rs"]
mod split;
#[path = "common/stage.rs"]
mod stage;
#[path = "flyover/texture.rs"]
mod texture;
#[path = "flyover/town.rs"]
mod town;
#[path = "flyover/window.rs"]
mod window;
#[path = "flyover/world.rs"]
mod world;

use std::path::PathBuf;

use bevy::prelude::*;
use bevy_skyline::{
    prelude::*,
    terrain::{HeightFieldLoadError, read_height_field},
};
use stage::{Stage, StageError};

/// Buildings that are asked for, of a large city and of a small one.
const BUILDINGS: [usize; 2] = [10_200, 400];

/// Flies over a city on a coast, in a window or in pictures.
#[derive(clap::Args)]
pub struct Options {
    /// Elevation file: 16-bit PNG or TIFF, float TIFF, SRTM .hgt, raw 16-bit; else an island made by code.
    file: Option<PathBuf>,
    /// Without a window: only pictures at these shares of the flight, 0 to 1, and no timing.
    #[arg(
        long,
        value_name = "SHARE",
        value_delimiter = ',',
        requires = "headless"
    )]
    at: Vec<f32>,
    /// What a frame may take, in ms [default: 16.7 in a window; else what three frames in four do not exceed without a
    /// budget].
    #[arg(long, value_name = "T")]
    target_ms: Option<f32>,
}

fn main() -> AppExit {
    stage::start(run)
}

fn run(stage: Stage, options: Options) -> Result<AppExit, StageError> {
    let meant = |ms: &f32| ms.is_finite() && *ms > 0.0;
    if let Some(target) = options.target_ms.filter(|ms| !meant(ms)) {
        return Err(StageError::input(format!(
            "a frame cannot take {target} ms: give --target-ms a number above 0"
        )));
    }
    let field = match &options.file {
        Some(path) => {
            let (field, notes) = read_height_field(path, &HeightFieldSettings::default())
                .map_err(|error| named(path, error))?;
            for note in notes {
                eprintln!("flyover: {}: {note}", path.display());
            }
            field
        }
        None => coast::island().map_err(StageError::input)?,
    };
    let buildings = BUILDINGS[usize::from(stage.options.small)];
    let stage = Stage {
        keys: "C camera: yours or the script's; Space stops the time; the arrows turn the sun; 1 terrain shadow, 2 occlusion, \
               3 contribution, 4 interior, 5 spherical index, 6 frame budget; 0 all; V with and without side by side; \
               X cuts the tower open; F3 the panel",
        effects: &Effect::ALL,
        ..stage
    };
    let target_ms = options.target_ms;
    let headless = stage.is_headless();
    stage.show(
        |app| window::build(app, target_ms, headless),
        |world| {
            let census = world::populate(world, field, buildings);
            println!("{census}");
        },
        |film| film::make(film, &options.at, target_ms),
    )
}

/// An error that names its file.
fn named(path: &std::path::Path, error: HeightFieldLoadError) -> StageError {
    match error {
        // This one names the file itself.
        HeightFieldLoadError::Read { .. } => StageError::input(error),
        _ => StageError::input(format!("{}: {error}", path.display())),
    }
}
