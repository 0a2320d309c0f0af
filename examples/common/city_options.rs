//! What the city is started with, and why there may be nothing to see.

use std::path::PathBuf;

use bevy::prelude::*;
use bevy_skyline::offline::{OfflineError, scenes::SceneError};
use clap::Parser;

use crate::command_line::size;

/// Flies through a city in a window, or makes a picture of it.
#[derive(Parser)]
#[command(name = "city")]
pub struct Options {
    /// glTF binary with one node and mesh a building; else a city made by code.
    pub file: Option<PathBuf>,
    /// Open no window: walk a few steps in each way to cull, write a picture and print frame times.
    #[arg(long)]
    pub headless: bool,
    /// The picture to write; implies --headless [default: city.png].
    #[arg(long, value_name = "P.png")]
    pub out: Option<PathBuf>,
    /// Pixels of the picture or the window.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size)]
    pub size: UVec2,
    /// Frames to time in each way to cull.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    pub frames: u32,
}

/// Why there is nothing to see; says itself in one line.
#[derive(thiserror::Error, Debug)]
pub enum CityError {
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error("there is no display to open a window on: use --headless")]
    NoDisplay,
    #[error("a picture of {0}x{1} pixels is larger than this GPU can draw: at most {2} a side")]
    TooLarge(u32, u32, u32),
    #[error(transparent)]
    Offline(#[from] OfflineError),
    #[error("cannot write {}: {source}", path.display())]
    Write {
        path: PathBuf,
        source: image::ImageError,
    },
}
