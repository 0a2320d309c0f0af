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
#[path = "common/command_line.rs"]
mod command_line;
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
#[path = "flyover/texture.rs"]
mod texture;
#[path = "flyover/town.rs"]
mod town;
#[path = "flyover/window.rs"]
mod window;
#[path = "flyover/world.rs"]
mod world;

use std::path::{Path, PathBuf};

use bevy::prelude::*;
use bevy_skyline::{
    offline::{OfflineError, plot::PlotError},
    prelude::*,
    terrain::{HeightFieldError, HeightFieldLoadError, read_height_field},
};
use clap::Parser;
use command_line::{exit_with, has_display, size};

/// Flies over a city on a coast, in a window or in pictures.
#[derive(Parser)]
#[command(name = "flyover")]
pub struct Options {
    /// Elevation file: 16-bit PNG or TIFF, float TIFF, SRTM .hgt, raw 16-bit; else an island made by code.
    file: Option<PathBuf>,
    /// Open no window: fly the script, write its pictures, a contact sheet and a plot of frame times.
    #[arg(long)]
    headless: bool,
    /// Folder to write to; implies --headless [default: flyover].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Pixels of the pictures or the window.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size)]
    size: UVec2,
    /// Frames of the flight.
    #[arg(long, value_name = "N", default_value_t = 48, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Only pictures at these shares of the flight, 0 to 1, and no timing.
    #[arg(long, value_name = "SHARE", value_delimiter = ',')]
    at: Vec<f32>,
    /// Buildings of the city, if there is room for them.
    #[arg(long, value_name = "N", default_value_t = 10_200)]
    buildings: usize,
    /// What a frame may take, in ms [default: 16.7 in a window; else what three frames in four do not exceed without a budget].
    #[arg(long, value_name = "T")]
    target_ms: Option<f32>,
}

/// Why there is nothing to see; says itself in one line.
#[derive(thiserror::Error, Debug)]
pub enum FlyoverError {
    #[error(transparent)]
    Unreadable(HeightFieldLoadError),
    #[error("{}: {source}", path.display())]
    File {
        path: PathBuf,
        source: HeightFieldLoadError,
    },
    #[error(transparent)]
    Landscape(#[from] HeightFieldError),
    #[error("there is no display to open a window on: use --headless")]
    NoDisplay,
    #[error("a picture of {0}x{1} pixels is larger than this GPU can draw: at most {2} a side")]
    TooLarge(u32, u32, u32),
    #[error("a frame cannot take {0} ms: give --target-ms a number above 0")]
    Target(f32),
    #[error(transparent)]
    Offline(#[from] OfflineError),
    #[error(transparent)]
    Plot(#[from] PlotError),
    #[error("cannot write {}: {reason}", path.display())]
    Write { path: PathBuf, reason: String },
}

fn main() -> AppExit {
    let options = Options::parse();
    run(&options).unwrap_or_else(|error| {
        exit_with("flyover", &error, matches!(error, FlyoverError::Offline(_)))
    })
}

fn run(options: &Options) -> Result<AppExit, FlyoverError> {
    if let Some(target) = options
        .target_ms
        .filter(|ms| !(ms.is_finite() && *ms > 0.0))
    {
        return Err(FlyoverError::Target(target));
    }
    let headless = options.headless || options.out.is_some();
    if !headless && !has_display() {
        return Err(FlyoverError::NoDisplay);
    }
    let field = match &options.file {
        Some(path) => read(path)?,
        None => coast::island()?,
    };
    if headless {
        film::make(options, field)?;
        return Ok(AppExit::Success);
    }
    Ok(window::fly(
        options.size,
        field,
        options.buildings,
        options.target_ms,
    ))
}

fn read(path: &Path) -> Result<HeightField, FlyoverError> {
    let settings = HeightFieldSettings::default();
    let (field, notes) = read_height_field(path, &settings).map_err(|source| match source {
        // This one names the file itself.
        HeightFieldLoadError::Read { .. } => FlyoverError::Unreadable(source),
        _ => FlyoverError::File {
            path: path.into(),
            source,
        },
    })?;
    for note in notes {
        eprintln!("flyover: {}: {note}", path.display());
    }
    Ok(field)
}
