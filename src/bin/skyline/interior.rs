//! `skyline interior`.

use std::{num::NonZero, path::PathBuf};

use bevy_skyline::{
    interior::{
        InteriorCulling, InteriorFaces, InteriorGrid, InteriorLevel, InteriorMode,
        InteriorTransparent,
    },
    offline::interior::{TrimFigures, trim},
};
use clap::{Args, ValueEnum};
use serde::Serialize;

use crate::{
    error::{CliError, check_writable},
    parse::positive,
    print_json,
};

/// More would only wait for each other.
const MOST_THREADS: u32 = 256;

#[derive(Args)]
pub(crate) struct InteriorArgs {
    /// The model: a .glb, or a .gltf with its files beside it.
    #[arg(value_name = "IN.glb")]
    model: PathBuf,
    /// Cells on the model's longest side: 1 to 3500 [default: 256].
    #[arg(
        long,
        value_name = "N",
        conflicts_with = "gap",
        allow_hyphen_values = true
    )]
    resolution: Option<u32>,
    /// What is seen through openings this wide stays; in the model's units.
    #[arg(long, value_name = "M", value_parser = positive, allow_hyphen_values = true)]
    gap: Option<f32>,
    /// What is taken out.
    #[arg(long, value_enum, default_value_t = LevelFlag::Triangle)]
    level: LevelFlag,
    /// Which surfaces count as seen.
    #[arg(long, value_enum, default_value_t = ModeFlag::Conservative)]
    mode: ModeFlag,
    /// Whether what is behind transparent materials is seen.
    #[arg(long, value_enum, default_value_t = TransparentFlag::Open)]
    transparent: TransparentFlag,
    /// Whether one-sided materials are seen through from behind.
    #[arg(long, value_enum, default_value_t = FacesFlag::AsDrawn)]
    faces: FacesFlag,
    /// How much memory the grid may take, and again how much the model's vertices.
    #[arg(long, value_name = "M", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..))]
    memory_mib: u32,
    /// Threads to work with [default: as many as there are processors].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_THREADS)))]
    threads: Option<u32>,
    /// The model to write: a .glb, or a .gltf with a .bin beside it. May be the one that is read.
    #[arg(long, value_name = "OUT.glb")]
    out: PathBuf,
}

#[derive(ValueEnum, Clone, Copy)]
pub(crate) enum LevelFlag {
    /// Nodes of which no triangle is seen.
    Node,
    /// Triangles that are not seen, and nodes of which none is.
    Triangle,
}

#[derive(ValueEnum, Clone, Copy)]
pub(crate) enum ModeFlag {
    /// What is met first from outside (P5a): with a coarse grid much that is seen is missed.
    Sampled,
    /// Everything near what is outside.
    Conservative,
}

#[derive(ValueEnum, Clone, Copy)]
pub(crate) enum TransparentFlag {
    /// It is.
    Open,
    /// They hide like all others (P5a).
    Closed,
}

#[derive(ValueEnum, Clone, Copy)]
pub(crate) enum FacesFlag {
    /// They are, as they are not drawn.
    AsDrawn,
    /// They hide from both sides (P5a).
    TwoSided,
}

impl InteriorArgs {
    fn settings(&self) -> InteriorCulling {
        let base = InteriorCulling::default();
        InteriorCulling {
            grid: match (self.resolution, self.gap) {
                (Some(resolution), _) => InteriorGrid::Resolution(resolution),
                (None, Some(gap)) => InteriorGrid::Gap(gap),
                (None, None) => base.grid,
            },
            level: match self.level {
                LevelFlag::Node => InteriorLevel::Node,
                LevelFlag::Triangle => InteriorLevel::Triangle,
            },
            mode: match self.mode {
                ModeFlag::Sampled => InteriorMode::Sampled,
                ModeFlag::Conservative => InteriorMode::Conservative,
            },
            transparent: match self.transparent {
                TransparentFlag::Open => InteriorTransparent::Open,
                TransparentFlag::Closed => InteriorTransparent::Closed,
            },
            faces: match self.faces {
                FacesFlag::AsDrawn => InteriorFaces::AsDrawn,
                FacesFlag::TwoSided => InteriorFaces::TwoSided,
            },
            memory_mib: self.memory_mib,
            ..InteriorCulling::default()
        }
    }

    fn threads(&self) -> NonZero<usize> {
        let asked = self
            .threads
            .and_then(|threads| NonZero::new(threads as usize));
        asked
            .or_else(|| std::thread::available_parallelism().ok())
            .unwrap_or(NonZero::<usize>::MIN)
    }
}

/// What `skyline interior` prints.
#[derive(Serialize)]
struct InteriorOutput {
    out: PathBuf,
    #[serde(flatten)]
    figures: TrimFigures,
}

pub(crate) fn run(args: &InteriorArgs) -> Result<(), CliError> {
    check_writable(&args.out)?;
    let trimmed = trim(&args.model, &args.out, &args.settings(), args.threads())?;
    for note in &trimmed.notes {
        eprintln!("skyline: {}: {note}", args.model.display());
    }
    print_json(&InteriorOutput {
        out: args.out.clone(),
        figures: trimmed.figures,
    });
    Ok(())
}
