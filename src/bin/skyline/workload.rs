//! `skyline workload`.

use std::path::PathBuf;

use bevy::math::UVec2;
use bevy_skyline::offline::workload::{self, Clock, Cost, Policies, WorkloadPath};
use clap::{Args, ValueEnum};

use crate::{
    error::{CliError, check_writable},
    parse::{clock, policies, positive, size},
    print_json,
};

/// Scenes that workloads are measured on.
#[derive(ValueEnum, Clone, Copy)]
pub(crate) enum WorkloadScene {
    /// A furnished city.
    City,
}

#[derive(Args)]
pub(crate) struct WorkloadArgs {
    /// What is shown.
    #[arg(long, value_enum, default_value_t = WorkloadScene::City)]
    scene: WorkloadScene,
    /// City (.glb, a node and mesh a building); else one made by code. Either is furnished to at least 1.3 million
    /// triangles.
    #[arg(long, value_name = "F.glb")]
    city: Option<PathBuf>,
    /// A small city made by code: seconds rather than minutes.
    #[arg(long)]
    quick: bool,
    /// How the camera moves: rotate (a full turn on the spot), zoom or walk.
    #[arg(long)]
    path: WorkloadPath,
    /// What a frame may take, in milliseconds.
    #[arg(long, value_name = "T", value_parser = positive, allow_hyphen_values = true)]
    target_ms: f32,
    /// What decides what is drawn: none, frustum, polygons:N (the nearest, until N triangles), distance:M (metres),
    /// threshold:A (square pixels), budget, or all of them, the baselines at the budget's mean.
    #[arg(long, value_parser = policies)]
    policy: Policies,
    /// Frames of the path [default: 180, with --quick 36].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    frames: Option<u32>,
    /// Pixels of the picture.
    #[arg(long, value_name = "WxH", default_value = "320x180", value_parser = size, allow_hyphen_values = true)]
    size: UVec2,
    /// Which time the budget holds: time (the wall clock) or counted (what was drawn).
    #[arg(long, default_value = "time", value_parser = clock)]
    clock: Clock,
    /// What is counted for an object, a triangle, a square pixel of bounds and a frame, in milliseconds; else it is
    /// learned from measured frames.
    #[arg(long, value_name = "A,B,C,D", allow_hyphen_values = true)]
    cost: Option<Cost>,
    /// Leave out what is hidden, too, whatever the policy but none: with ZBufferOcclusion on the camera.
    #[arg(long)]
    occlusion: bool,
    /// The table to write; with --policy all the plot goes beside it, as a .png.
    #[arg(long, value_name = "F.csv")]
    out: PathBuf,
}

pub(crate) fn run(args: &WorkloadArgs) -> Result<(), CliError> {
    let usage = |text: &str| Err(CliError::Usage(text.into()));
    if args.quick && args.city.is_some() {
        return usage("--quick takes a small city made by code: leave out --city, or --quick");
    }
    if args.size.min_element() == 0 {
        return usage("--size must be at least one pixel a side");
    }
    check_writable(&args.out)?;
    if args.policy == Policies::All {
        let plot = args.out.with_extension("png");
        if plot == args.out {
            return usage(
                "--out is the table, and with --policy all its .png is the plot: name it .csv",
            );
        }
        check_writable(&plot)?;
    }
    let WorkloadScene::City = args.scene;
    let plan = workload::Plan {
        path: args.path,
        frames: args.frames.unwrap_or(if args.quick { 36 } else { 180 }),
        target_ms: f64::from(args.target_ms),
        policies: args.policy,
        clock: args.clock,
        cost: args.cost,
        size: args.size,
        city: args.city.clone(),
        occludes: args.occlusion,
        quick: args.quick,
    };
    print_json(&workload::measure(&plan, &args.out)?);
    Ok(())
}
