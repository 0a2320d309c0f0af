//! The `skyline` command: parses, calls the library, prints. JSON on stdout, messages on stderr; exit status 0
//! only on success, 2 on bad input. One file a command, and what they share:
//!
//! | File | What |
//! |---|---|
//! | `render.rs`, `shadow.rs`, `interior.rs`, `accuracy.rs`, `workload.rs` | the commands |
//! | `height_map.rs` | reading a height map |
//! | `parse.rs` | values of flags |
//! | `error.rs` | why it fails |

mod accuracy;
mod error;
mod height_map;
mod interior;
mod parse;
mod render;
mod shadow;
mod workload;

use std::{io::Write, process::ExitCode};

use clap::{Parser, Subcommand, error::ErrorKind};
use serde::Serialize;

use crate::error::{CliError, usage_line};

/// Ray-cast terrain, culling and frame times: pictures, depth, shadow maps, models, workloads and what accuracy costs.
#[derive(Parser)]
#[command(name = "skyline", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Draw a height map to a PNG, and its depth to a file if asked.
    Render(render::RenderArgs),
    /// Write the shadow map of a height map: one pixel a sample, 255 = lit.
    Shadow(shadow::ShadowArgs),
    /// Take out of a glTF model what cannot be seen from anywhere outside it.
    Interior(interior::InteriorArgs),
    /// Measure what accuracy costs: time and error of every setting, with plots and a page that shows them.
    Accuracy(accuracy::AccuracyArgs),
    /// Measure the frame times of a city along a path of the camera: a row a frame, and a plot of all policies.
    Workload(workload::WorkloadArgs),
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let line: Vec<_> = error
                .to_string()
                .split_whitespace()
                .map(str::to_owned)
                .collect();
            eprintln!("skyline: {}", line.join(" "));
            ExitCode::from(error.exit_code())
        }
    }
}

fn run() -> Result<(), CliError> {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error)
            if matches!(
                error.kind(),
                ErrorKind::DisplayHelp | ErrorKind::DisplayVersion
            ) =>
        {
            print(&error.to_string());
            return Ok(());
        }
        Err(error) => return Err(CliError::Usage(usage_line(&error))),
    };
    match cli.command {
        Command::Render(args) => render::run(&args),
        Command::Shadow(args) => shadow::run(&args),
        Command::Interior(args) => interior::run(&args),
        Command::Accuracy(args) => accuracy::run(&args),
        Command::Workload(args) => workload::run(&args),
    }
}

fn print_json(value: &impl Serialize) {
    match serde_json::to_string_pretty(value) {
        Ok(text) => print(&format!("{text}\n")),
        Err(error) => eprintln!("skyline: the result could not be written as JSON: {error}"),
    }
}

/// A reader that has gone is no failure of ours.
fn print(text: &str) {
    let _ = std::io::stdout().write_all(text.as_bytes());
}
