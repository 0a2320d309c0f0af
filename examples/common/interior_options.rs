//! What the interior example is started with, and why there may be nothing to see.

use std::path::PathBuf;

use bevy::prelude::*;
use bevy_skyline::offline::OfflineError;
use clap::Parser;

use crate::{command_line::size, glb_model::ModelError};

/// Shows what interior culling takes out of a model, in a window or in pictures.
#[derive(Parser)]
#[command(name = "interior")]
pub struct Options {
    /// glTF binary; else a carriage house beside this checkout, else a cabinet made by code.
    pub file: Option<PathBuf>,
    /// Open no window: write pictures and print frame times.
    #[arg(long)]
    pub headless: bool,
    /// Folder to write the pictures to; implies --headless [default: .].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Pixels of the pictures or the window.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size)]
    pub size: UVec2,
    /// Frames to time before and after.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    pub frames: u32,
    /// Cells on the model's longest side.
    #[arg(long, value_name = "N", default_value_t = 256)]
    pub resolution: u32,
    /// Show a cabinet made by code with about so many triangles.
    #[arg(long, value_name = "N", conflicts_with = "file")]
    pub cabinet: Option<usize>,
    /// Draw no pictures: time the frames of a small scene before, while and after the model, out of view, is culled.
    #[arg(long)]
    pub frame_times: bool,
}

/// Why there is nothing to see; says itself in one line.
#[derive(thiserror::Error, Debug)]
pub enum InteriorExampleError {
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error("there is no display to open a window on: use --headless")]
    NoDisplay,
    #[error("a picture of {0}x{1} pixels is larger than this GPU can draw: at most {2} a side")]
    TooLarge(u32, u32, u32),
    #[error(transparent)]
    Offline(#[from] OfflineError),
    #[error("nothing was culled: {0}")]
    NotCulled(String),
    #[error("cannot write {0}: {1}")]
    Write(String, String),
}
