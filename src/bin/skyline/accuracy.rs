//! `skyline accuracy`.

use std::path::PathBuf;

use bevy_skyline::offline::accuracy::{
    AccuracyError, all, budget, contribution, growth, idle, interior, occlusion, scene::Ground,
    shadow, spherical, terrain,
};
use bevy_skyline::terrain::HeightFieldNote;
use clap::{Args, ValueEnum};

use crate::{
    error::CliError,
    height_map::{HeightMapArgs, read, tell},
    parse::scene,
    print_json,
};

#[derive(Args)]
pub(crate) struct AccuracyArgs {
    /// What to measure.
    effect: AccuracyEffect,
    /// Few settings and small pictures: seconds rather than minutes.
    #[arg(long)]
    quick: bool,
    /// 16-bit PNG or TIFF, float TIFF, SRTM .hgt or raw 16-bit; else terrain made by code.
    #[arg(long, value_name = "F")]
    heightmap: Option<PathBuf>,
    #[command(flatten)]
    scale: HeightMapArgs,
    /// Triangle mesh (.obj) that occlusion or spherical is measured with, else a shape made by code; models (.glb or .gltf, once for
    /// each) that interior is measured on, besides a machine made by code.
    #[arg(long, value_name = "F")]
    model: Vec<PathBuf>,
    /// City (.glb, a node and mesh a building) that occlusion, contribution and budget are measured in; else one made
    /// by code.
    #[arg(long, value_name = "F.glb")]
    city: Option<PathBuf>,
    /// Scenes that occlusion is measured on: city, bunnies, seabed, with commas between; else all.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = scene)]
    scenes: Vec<occlusion::SceneKind>,
    /// Frames of each camera path [default: occlusion 40, contribution 30, budget 180; with --quick 6, 12, 36].
    /// Occlusion is measured on paths of 100 and more with its default settings only.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    path_frames: Option<u32>,
    /// How often each setting of occlusion or contribution has its turn to be timed.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: Option<u32>,
    /// Measure occlusion only with settings that change one thing, as --quick does.
    #[arg(long)]
    few_settings: bool,
    /// Directory to write to; made if it is not there.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Effects that this version has.
#[derive(ValueEnum, Clone, Copy)]
pub(crate) enum AccuracyEffect {
    /// Terrain ray casting (P1).
    Terrain,
    /// Terrain shadow maps (P5b).
    Shadow,
    /// Occlusion culling (P2).
    Occlusion,
    /// Contribution culling (P4).
    Contribution,
    /// The frame budget, against P4's baselines.
    Budget,
    /// Interior culling (P5a).
    Interior,
    /// Spherical index of a mesh (P3).
    Spherical,
    /// By which power of a scene's size each effect's cost grows.
    Growth,
    /// What the plugins cost in a scene that uses none of them.
    Idle,
    /// All of these and one page; what a run that was cut off has done is not done again.
    All,
}

pub(crate) fn run(args: &AccuracyArgs) -> Result<(), CliError> {
    let of_shadow = match args.effect {
        AccuracyEffect::Occlusion => return run_occlusion(args),
        AccuracyEffect::Contribution => return run_contribution(args),
        AccuracyEffect::Budget => return run_budget(args),
        AccuracyEffect::Interior => return run_interior(args),
        AccuracyEffect::Spherical => return run_spherical(args),
        AccuracyEffect::Growth | AccuracyEffect::Idle => return run_plain(args),
        AccuracyEffect::All => return run_all(args),
        AccuracyEffect::Terrain => false,
        AccuracyEffect::Shadow => true,
    };
    if is_of_scenes(args) {
        return Err(CliError::Usage(
            "--model, --city, --scenes, --path-frames, --rounds and --few-settings are for what is measured in a city: terrain and shadow take a --heightmap"
                .into(),
        ));
    }
    let (Ground { field, name }, notes) = match ground(args)? {
        Some(found) => found,
        None => {
            let made = Ground::made_by_code(args.quick, of_shadow).map_err(AccuracyError::from)?;
            (made, Vec::new())
        }
    };
    let summary = if of_shadow {
        let plan = if args.quick {
            shadow::Plan::quick()
        } else {
            shadow::Plan::full()
        };
        shadow::measure(field, &name, &plan, &args.out)?
    } else {
        let plan = if args.quick {
            terrain::Plan::quick()
        } else {
            terrain::Plan::full()
        };
        terrain::measure(field, &name, &plan, &args.out)?
    };
    if let Some(path) = &args.heightmap {
        tell(path, notes);
    }
    print_json(&summary);
    Ok(())
}

fn run_contribution(args: &AccuracyArgs) -> Result<(), CliError> {
    refuse_field(args, "contribution takes a --city")?;
    refuse_occlusion(args, "contribution")?;
    let base = if args.quick {
        contribution::Plan::quick()
    } else {
        contribution::Plan::full()
    };
    if args.path_frames == Some(1) {
        return Err(CliError::Usage(
            "--path-frames must be at least 2 for contribution: flicker is from frame to frame"
                .into(),
        ));
    }
    let plan = contribution::Plan {
        city: args.city.clone(),
        path_frames: args.path_frames.unwrap_or(base.path_frames),
        rounds: args.rounds.map_or(base.rounds, |rounds| rounds as usize),
        ..base
    };
    print_json(&contribution::measure(&plan, &args.out)?);
    Ok(())
}

fn run_budget(args: &AccuracyArgs) -> Result<(), CliError> {
    refuse_field(args, "budget takes a --city")?;
    refuse_occlusion(args, "budget")?;
    if args.rounds.is_some() {
        return Err(CliError::Usage(
            "--rounds are for occlusion and contribution: budget takes --path-frames".into(),
        ));
    }
    let base = if args.quick {
        budget::Plan::quick()
    } else {
        budget::Plan::full()
    };
    let plan = budget::Plan {
        city: args.city.clone(),
        path_frames: args.path_frames.unwrap_or(base.path_frames),
        ..base
    };
    print_json(&budget::measure(&plan, &args.out)?);
    Ok(())
}

fn run_occlusion(args: &AccuracyArgs) -> Result<(), CliError> {
    refuse_field(args, "occlusion takes --city and --model")?;
    if args.model.len() > 1 {
        return Err(CliError::Usage(
            "occlusion is measured with one --model at a time".into(),
        ));
    }
    let base = if args.quick {
        occlusion::Plan::quick()
    } else {
        occlusion::Plan::full()
    };
    let scenes = if args.scenes.is_empty() {
        base.scenes.clone()
    } else {
        args.scenes.clone()
    };
    let plan = occlusion::Plan {
        scenes,
        model: args.model.first().cloned(),
        city: args.city.clone(),
        path_frames: args.path_frames.unwrap_or(base.path_frames),
        rounds: args.rounds.map_or(base.rounds, |rounds| rounds as usize),
        every_setting: base.every_setting && !args.few_settings,
        ..base
    };
    print_json(&occlusion::measure(&plan, &args.out)?);
    Ok(())
}

fn run_interior(args: &AccuracyArgs) -> Result<(), CliError> {
    refuse_field(args, "interior takes --model")?;
    let of_cities = args.city.is_some()
        || !args.scenes.is_empty()
        || args.path_frames.is_some()
        || args.few_settings;
    if of_cities {
        return Err(CliError::Usage(
            "--city, --scenes, --path-frames and --few-settings are for what is measured in a city: interior takes --model and --rounds"
                .into(),
        ));
    }
    let base = if args.quick {
        interior::Plan::quick()
    } else {
        interior::Plan::full()
    };
    let plan = interior::Plan {
        models: args.model.clone(),
        rounds: args.rounds.map_or(base.rounds, |rounds| rounds as usize),
        ..base
    };
    print_json(&interior::measure(&plan, &args.out)?);
    Ok(())
}

fn run_spherical(args: &AccuracyArgs) -> Result<(), CliError> {
    refuse_field(args, "spherical takes a --model")?;
    if args.city.is_some() || !args.scenes.is_empty() || args.path_frames.is_some() {
        return Err(CliError::Usage(
            "--city, --scenes and --path-frames are for what is measured in a city: spherical takes --model, --rounds and --few-settings"
                .into(),
        ));
    }
    if args.model.len() > 1 {
        return Err(CliError::Usage(
            "spherical is measured with one --model at a time".into(),
        ));
    }
    let base = if args.quick {
        spherical::Plan::quick()
    } else {
        spherical::Plan::full()
    };
    let plan = spherical::Plan {
        model: args.model.first().cloned(),
        rounds: args.rounds.map_or(base.rounds, |rounds| rounds as usize),
        few_ways: base.few_ways || args.few_settings,
        ..base
    };
    print_json(&spherical::measure(&plan, &args.out)?);
    Ok(())
}

/// What takes no scene of the user's.
fn run_plain(args: &AccuracyArgs) -> Result<(), CliError> {
    let is_growth = matches!(args.effect, AccuracyEffect::Growth);
    refuse_field(args, "growth and idle make their own scenes")?;
    if is_of_scenes(args) {
        return Err(CliError::Usage(
            "growth and idle make their own scenes: they take --quick and --out".into(),
        ));
    }
    let summary = match (is_growth, args.quick) {
        (true, true) => growth::measure(&growth::Plan::quick(), &args.out)?,
        (true, false) => growth::measure(&growth::Plan::full(), &args.out)?,
        (false, true) => idle::measure(&idle::Plan::quick(), &args.out)?,
        (false, false) => idle::measure(&idle::Plan::full(), &args.out)?,
    };
    print_json(&summary);
    Ok(())
}

/// Everything, and one page.
fn run_all(args: &AccuracyArgs) -> Result<(), CliError> {
    if !args.scenes.is_empty()
        || args.path_frames.is_some()
        || args.rounds.is_some()
        || args.few_settings
    {
        return Err(CliError::Usage(
            "--scenes, --path-frames, --rounds and --few-settings are for one effect: all takes --heightmap, --model and --city"
                .into(),
        ));
    }
    let is_mesh = |path: &&PathBuf| {
        let extension = path.extension().unwrap_or_default();
        extension.eq_ignore_ascii_case("obj")
    };
    let (meshes, models): (Vec<_>, Vec<_>) = args.model.iter().partition(is_mesh);
    if meshes.len() > 1 {
        return Err(CliError::Usage(
            "occlusion and spherical are measured with one .obj --model at a time".into(),
        ));
    }
    let (field, notes) = match ground(args)? {
        Some((Ground { field, name }, notes)) => (Some((field, name)), notes),
        None => (None, Vec::new()),
    };
    let words: Vec<String> = std::env::args().skip(1).collect();
    let plan = all::Plan {
        quick: args.quick,
        field,
        mesh: meshes.first().map(|path| (*path).clone()),
        models: models.into_iter().cloned().collect(),
        city: args.city.clone(),
        command: format!("skyline {}", words.join(" ")),
    };
    let summary = all::measure(&plan, &args.out, &mut |told| eprintln!("skyline: {told}"))?;
    if let Some(path) = &args.heightmap {
        tell(path, notes);
    }
    print_json(&summary);
    Ok(())
}

/// The height map that was given, if one was, and what had to be assumed about it.
fn ground(args: &AccuracyArgs) -> Result<Option<(Ground, Vec<HeightFieldNote>)>, CliError> {
    let Some(path) = &args.heightmap else {
        if args.scale.spacing.is_some() || args.scale.height_range.is_some() {
            return Err(CliError::Usage(
                "--spacing and --height-range say how to read a --heightmap, and none is given"
                    .into(),
            ));
        }
        return Ok(None);
    };
    let (field, notes) = read(path, &args.scale)?;
    let stem = path.file_stem().unwrap_or(path.as_os_str());
    let name = stem.to_string_lossy().into_owned();
    Ok(Some((Ground { field, name }, notes)))
}

/// Whether any flag says in which scene, or how, culling is measured.
fn is_of_scenes(args: &AccuracyArgs) -> bool {
    !args.model.is_empty()
        || args.city.is_some()
        || !args.scenes.is_empty()
        || args.path_frames.is_some()
        || args.rounds.is_some()
        || args.few_settings
}

/// What has no height field takes none.
fn refuse_field(args: &AccuracyArgs, takes: &str) -> Result<(), CliError> {
    let field = args.heightmap.is_some()
        || args.scale.spacing.is_some()
        || args.scale.height_range.is_some();
    if field {
        return Err(CliError::Usage(format!(
            "--heightmap, --spacing and --height-range are for terrain: {takes}"
        )));
    }
    Ok(())
}

/// What is measured in a furnished city takes no more of occlusion's flags than these.
fn refuse_occlusion(args: &AccuracyArgs, effect: &str) -> Result<(), CliError> {
    if !args.model.is_empty() || !args.scenes.is_empty() || args.few_settings {
        return Err(CliError::Usage(format!(
            "--model, --scenes and --few-settings are for occlusion: {effect} takes a --city"
        )));
    }
    if args.quick && args.city.is_some() {
        return Err(CliError::Usage(
            "--quick takes a small city made by code: leave out --city, or --quick".into(),
        ));
    }
    Ok(())
}
