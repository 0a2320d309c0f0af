//! The `skyline` command: parses, calls the library, prints. JSON on stdout, messages on stderr; exit status 0
//! only on success, 2 on bad input.

use std::{
    io::Write,
    path::{Path, PathBuf},
    process::ExitCode,
};

use bevy::math::{DVec3, UVec2};
use bevy_skyline::{
    offline::{
        TRAVERSALS,
        accuracy::{
            AccuracyError, budget, contribution, occlusion, scene::mountains, shadow, terrain,
        },
        render::{Figures, RenderError, Shot, Sun, render},
        shadow::METHODS,
        shadow_map::{self, MapError, MapFigures, MapLight, MapShot},
        workload::{self, Clock, Cost, Policies, WorkloadError, WorkloadPath},
    },
    terrain::{
        HeightField, HeightFieldLoadError, HeightFieldNote, HeightFieldSettings, TerrainRayCasting,
        Traversal, read_height_field,
    },
    terrain_shadow::{MOST_STRIPS, ShadowMethod},
};
use clap::{Args, Parser, Subcommand, ValueEnum, error::ErrorKind};
use serde::Serialize;

/// Ray-cast terrain, culling and frame times: pictures, depth, shadow maps, workloads and what accuracy costs.
#[derive(Parser)]
#[command(name = "skyline", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Draw a height map to a PNG, and its depth to a file if asked.
    Render(RenderArgs),
    /// Write the shadow map of a height map: one pixel a sample, 255 = lit.
    Shadow(ShadowArgs),
    /// Measure what accuracy costs: time and error of every setting, with plots and a page that shows them.
    Accuracy(AccuracyArgs),
    /// Measure the frame times of a city along a path of the camera: a row a frame, and a plot of all policies.
    Workload(WorkloadArgs),
}

/// Scenes that workloads are measured on.
#[derive(ValueEnum, Clone, Copy)]
enum WorkloadScene {
    /// A furnished city.
    City,
}

#[derive(Args)]
struct WorkloadArgs {
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
    /// The table to write; with --policy all the plot goes beside it, as a .png.
    #[arg(long, value_name = "F.csv")]
    out: PathBuf,
}

#[derive(Args)]
struct AccuracyArgs {
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
    /// Triangle mesh (.obj) that occlusion is measured with; else a shape made by code.
    #[arg(long, value_name = "F.obj")]
    model: Option<PathBuf>,
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
enum AccuracyEffect {
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
}

#[derive(Args)]
struct HeightMapArgs {
    /// Metres between samples; else from the file's .json sidecar or format.
    #[arg(long, value_name = "M", value_parser = positive, allow_hyphen_values = true)]
    spacing: Option<f32>,
    /// Heights of the lowest and the highest code, in metres; else from the sidecar or format.
    #[arg(long, value_name = "MIN,MAX", value_parser = range, allow_hyphen_values = true)]
    height_range: Option<(f32, f32)>,
}

#[derive(Args)]
struct RenderArgs {
    /// 16-bit PNG or TIFF, float TIFF, SRTM .hgt or raw 16-bit.
    #[arg(long, value_name = "F")]
    heightmap: PathBuf,
    #[command(flatten)]
    scale: HeightMapArgs,
    /// Where the camera is, in metres; Y is up, sample (0,0) at the origin, columns +X, rows +Z.
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    eye: DVec3,
    /// What it looks at, in metres.
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    target: DVec3,
    /// Pixels of the picture.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size, allow_hyphen_values = true)]
    size: UVec2,
    /// Vertical field of view in degrees.
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = 45.0,
        allow_hyphen_values = true
    )]
    fov: f64,
    /// Direction to the sun in degrees: azimuth from +Z toward +X, elevation above the horizon.
    #[arg(long, value_name = "AZ,EL", value_parser = sun, allow_hyphen_values = true)]
    sun: Option<Sun>,
    /// How rays skip empty space: per-texel, max-mip, boxes or hybrid. All give the same picture.
    #[arg(long, default_value = "hybrid", value_parser = traversal)]
    traversal: Traversal,
    /// Side of the smallest box in cells, from 4.
    #[arg(long, value_name = "N", default_value_t = TerrainRayCasting::default().box_texels, allow_hyphen_values = true)]
    box_texels: u32,
    /// How far the picture may be from the exact surface, in pixels; 0 is exact.
    // A picture made once can take its time: exact, unless less is asked for.
    #[arg(
        long,
        value_name = "E",
        default_value_t = 0.0,
        allow_hyphen_values = true
    )]
    max_error_px: f32,
    /// The picture to write.
    #[arg(long, value_name = "P.png")]
    out: PathBuf,
    /// View-space distances along -Z to write: little-endian f32 in metres, rows from the top left, +inf for sky.
    #[arg(long, value_name = "D.f32")]
    depth: Option<PathBuf>,
}

#[derive(Args)]
struct ShadowArgs {
    /// 16-bit PNG or TIFF, float TIFF, SRTM .hgt or raw 16-bit.
    #[arg(long, value_name = "F")]
    heightmap: PathBuf,
    #[command(flatten)]
    scale: HeightMapArgs,
    /// Direction to the sun in degrees: azimuth from +Z (rows) toward +X (columns), elevation above the horizon.
    #[arg(long, value_name = "AZ,EL", value_parser = sun, allow_hyphen_values = true)]
    sun: Option<Sun>,
    /// Position of a point light in metres; Y is up, sample (0,0) at the origin, columns +X, rows +Z.
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    light: Option<DVec3>,
    /// How visibility is found: per-texel, max-mip or sweep (suns only).
    #[arg(long, default_value = "max-mip", value_parser = method)]
    method: ShadowMethod,
    /// Diameter of the sun in degrees, as 0.53; 0 = hard shadows.
    #[arg(long, value_name = "DEG", value_parser = number, allow_hyphen_values = true)]
    angular_size: Option<f64>,
    /// Radius of the light in metres; 0 = hard shadows.
    #[arg(long, value_name = "M", value_parser = number, allow_hyphen_values = true)]
    radius: Option<f64>,
    /// Upright strips that the disc of a light with a size is cut into, each with a ray of its own: 1 to 16.
    // A map made once can take its time.
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    strips: Option<u32>,
    /// The map to write: an 8-bit grey PNG.
    #[arg(long, value_name = "P.png")]
    out: PathBuf,
}

impl ShadowArgs {
    fn shot(&self) -> Result<MapShot, CliError> {
        let usage = |text: &str| Err(CliError::Usage(text.into()));
        let light = match (self.sun, self.light) {
            (Some(_), Some(_)) => {
                return usage(
                    "--sun and --light are two lights, and a map has one: give one of them",
                );
            }
            (None, None) => {
                return usage("where the light is must be said: give --sun AZ,EL or --light X,Y,Z");
            }
            (Some(_), None) if self.radius.is_some() => {
                return usage("--radius is a --light's, in metres: a sun has an --angular-size");
            }
            (None, Some(_)) if self.angular_size.is_some() => {
                return usage("--angular-size is a sun's, in degrees: a --light has a --radius");
            }
            (Some(sun), None) => MapLight::Sun {
                sun,
                angular_size_deg: self.angular_size.unwrap_or(0.0),
            },
            (None, Some(position_m)) => MapLight::Point {
                position_m,
                radius_m: self.radius.unwrap_or(0.0),
            },
        };
        let shot = MapShot {
            light,
            method: self.method,
            strips: self.strips.unwrap_or(MOST_STRIPS),
        };
        shot.check()?;
        if self.strips.is_some() && light.is_hard() {
            return usage(
                "--strips cut the disc of a light that has a size, and this has none: give --angular-size to a \
                 --sun, --radius to a --light",
            );
        }
        Ok(shot)
    }
}

/// Why the command failed; says itself in one line.
#[derive(thiserror::Error, Debug)]
enum CliError {
    #[error("{0}")]
    Usage(String),
    #[error("{}: {source}", path.display())]
    HeightMap {
        path: PathBuf,
        source: HeightFieldLoadError,
    },
    #[error("cannot write {}: there is no directory {}; create it first", path.display(), parent.display())]
    NoDirectory { path: PathBuf, parent: PathBuf },
    #[error("cannot write {}: it is a directory; name a file in it", .0.display())]
    IsDirectory(PathBuf),
    #[error("cannot write {}: {reason}", path.display())]
    Write { path: PathBuf, reason: String },
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error(transparent)]
    Map(#[from] MapError),
    #[error(transparent)]
    Accuracy(#[from] AccuracyError),
    #[error(transparent)]
    Workload(#[from] WorkloadError),
}

impl CliError {
    /// 2: other input would have helped; 1: another machine would.
    fn exit_code(&self) -> u8 {
        match self {
            Self::Render(error) if !error.is_input() => 1,
            Self::Map(error) if !error.is_input() => 1,
            Self::Accuracy(error) if !error.is_input() => 1,
            Self::Workload(error) if !error.is_input() => 1,
            _ => 2,
        }
    }
}

/// What `skyline render` prints.
#[derive(Serialize)]
struct RenderOutput {
    out: PathBuf,
    depth: Option<PathBuf>,
    #[serde(flatten)]
    figures: Figures,
}

/// What `skyline shadow` prints.
#[derive(Serialize)]
struct ShadowOutput {
    out: PathBuf,
    #[serde(flatten)]
    figures: MapFigures,
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
        Command::Render(args) => run_render(&args),
        Command::Shadow(args) => run_shadow(&args),
        Command::Accuracy(args) => run_accuracy(&args),
        Command::Workload(args) => run_workload(&args),
    }
}

fn run_workload(args: &WorkloadArgs) -> Result<(), CliError> {
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
        quick: args.quick,
    };
    print_json(&workload::measure(&plan, &args.out)?);
    Ok(())
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
    if args.model.is_some() || !args.scenes.is_empty() || args.few_settings {
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
        model: args.model.clone(),
        city: args.city.clone(),
        path_frames: args.path_frames.unwrap_or(base.path_frames),
        rounds: args.rounds.map_or(base.rounds, |rounds| rounds as usize),
        every_setting: base.every_setting && !args.few_settings,
        ..base
    };
    print_json(&occlusion::measure(&plan, &args.out)?);
    Ok(())
}

fn run_accuracy(args: &AccuracyArgs) -> Result<(), CliError> {
    let of_shadow = match args.effect {
        AccuracyEffect::Occlusion => return run_occlusion(args),
        AccuracyEffect::Contribution => return run_contribution(args),
        AccuracyEffect::Budget => return run_budget(args),
        AccuracyEffect::Terrain => false,
        AccuracyEffect::Shadow => true,
    };
    let of_occlusion = args.model.is_some()
        || args.city.is_some()
        || !args.scenes.is_empty()
        || args.path_frames.is_some()
        || args.rounds.is_some()
        || args.few_settings;
    if of_occlusion {
        return Err(CliError::Usage(
            "--model, --city, --scenes, --path-frames, --rounds and --few-settings are for what is measured in a city: terrain and shadow take a --heightmap"
                .into(),
        ));
    }
    let (field, notes, name) = match &args.heightmap {
        Some(path) => {
            let stem = path.file_stem().unwrap_or(path.as_os_str());
            let (field, notes) = read(path, &args.scale)?;
            (field, notes, stem.to_string_lossy().into_owned())
        }
        None => {
            if args.scale.spacing.is_some() || args.scale.height_range.is_some() {
                return Err(CliError::Usage(
                    "--spacing and --height-range say how to read a --heightmap, and none is given"
                        .into(),
                ));
            }
            let samples = match of_shadow {
                _ if args.quick => 257,
                false => 1025,
                true => 4096,
            };
            let field = mountains(samples).map_err(AccuracyError::from)?;
            (field, Vec::new(), "made_by_code".to_owned())
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

fn run_shadow(args: &ShadowArgs) -> Result<(), CliError> {
    // Everything that can be known to be wrong is said before any work is done.
    let shot = args.shot()?;
    check_writable(&args.out)?;
    let (field, notes) = read(&args.heightmap, &args.scale)?;
    let made = shadow_map::make(field, &shot)?;
    tell(&args.heightmap, notes);
    if shot.method_used() != shot.method {
        let why = match shot.light {
            MapLight::Sun { .. } => "this one stands straight above or below",
            MapLight::Point { .. } => "this light is near by",
        };
        eprintln!(
            "skyline: --method sweep goes away from a sun, and {why}: max-mip was used instead"
        );
    }
    let [width, height] = made.figures.size;
    let picture = image::GrayImage::from_raw(width, height, made.image.visibility);
    let written = picture.map_or_else(
        || Err("the map has the wrong size".to_owned()),
        |picture| {
            picture
                .save_with_format(&args.out, image::ImageFormat::Png)
                .map_err(|error| error.to_string())
        },
    );
    written.map_err(|reason| CliError::Write {
        path: args.out.clone(),
        reason,
    })?;
    print_json(&ShadowOutput {
        out: args.out.clone(),
        figures: made.figures,
    });
    Ok(())
}

fn run_render(args: &RenderArgs) -> Result<(), CliError> {
    let shot = Shot {
        eye: args.eye,
        target: args.target,
        size: args.size,
        fov_deg: args.fov,
        sun: args.sun.unwrap_or_default(),
        casting: TerrainRayCasting {
            traversal: args.traversal,
            box_texels: args.box_texels,
            max_error_px: args.max_error_px,
        },
    };
    // Everything that can be known to be wrong is said before any work is done.
    shot.check()?;
    check_writable(&args.out)?;
    args.depth.as_deref().map_or(Ok(()), check_writable)?;
    let (field, notes) = read(&args.heightmap, &args.scale)?;
    let rendered = render(field, &shot)?;
    tell(&args.heightmap, notes);
    rendered
        .picture
        .save_with_format(&args.out, image::ImageFormat::Png)
        .map_err(|error| CliError::Write {
            path: args.out.clone(),
            reason: error.to_string(),
        })?;
    if let Some(path) = &args.depth {
        let bytes: Vec<u8> = rendered
            .depth_m
            .iter()
            .flat_map(|depth| depth.to_le_bytes())
            .collect();
        std::fs::write(path, bytes).map_err(|error| CliError::Write {
            path: path.clone(),
            reason: error.to_string(),
        })?;
    }
    print_json(&RenderOutput {
        out: args.out.clone(),
        depth: args.depth.clone(),
        figures: rendered.figures,
    });
    Ok(())
}

fn read(
    path: &Path,
    scale: &HeightMapArgs,
) -> Result<(HeightField, Vec<HeightFieldNote>), CliError> {
    let settings = HeightFieldSettings {
        texel_m: scale.spacing,
        height_range_m: scale.height_range,
        ..Default::default()
    };
    read_height_field(path, &settings).map_err(|source| {
        // Its text names the file itself.
        if let HeightFieldLoadError::Read { .. } = source {
            CliError::Usage(source.to_string())
        } else {
            CliError::HeightMap {
                path: path.to_owned(),
                source,
            }
        }
    })
}

/// Says what had to be assumed; after the work, so that an error stands alone.
fn tell(path: &Path, notes: Vec<HeightFieldNote>) {
    for note in notes {
        match note {
            HeightFieldNote::Assumed {
                texel_m,
                height_range_m,
            } => {
                let spacing = texel_m.map(|m| format!("--spacing {m}"));
                let range = height_range_m.map(|(min, max)| format!("--height-range {min},{max}"));
                let flags: Vec<_> = spacing.into_iter().chain(range).collect();
                eprintln!(
                    "skyline: {}: {} assumed: give the flag, or a .json sidecar beside the file",
                    path.display(),
                    flags.join(" and ")
                );
            }
            note => eprintln!("skyline: {}: {note}", path.display()),
        }
    }
}

/// Whether a file can be made there, as far as can be told without making it.
fn check_writable(path: &Path) -> Result<(), CliError> {
    if path.is_dir() {
        return Err(CliError::IsDirectory(path.to_owned()));
    }
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() && !parent.is_dir() => {
            Err(CliError::NoDirectory {
                path: path.to_owned(),
                parent: parent.to_owned(),
            })
        }
        _ => Ok(()),
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

/// The first paragraph of clap's message, without its label.
fn usage_line(error: &clap::Error) -> String {
    let text = error.to_string();
    let first = text.split("\n\n").next().unwrap_or(&text);
    let first = first.strip_prefix("error: ").unwrap_or(first);
    let line: Vec<_> = first.split_whitespace().collect();
    format!("{}; see `skyline --help`", line.join(" "))
}

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let parts: Vec<_> = text
        .split(',')
        .map(|part| part.trim().parse::<f64>())
        .collect();
    let parts: Vec<f64> = parts
        .into_iter()
        .collect::<Result<_, _>>()
        .map_err(|_| format!("expected {N} numbers with commas between them"))?;
    if parts.iter().any(|part| !part.is_finite()) {
        return Err("the numbers must be finite".into());
    }
    parts
        .try_into()
        .map_err(|_| format!("expected {N} numbers with commas between them"))
}

fn vector(text: &str) -> Result<DVec3, String> {
    numbers(text).map(DVec3::from_array)
}

fn range(text: &str) -> Result<(f32, f32), String> {
    numbers(text).map(|[min, max]| (min as f32, max as f32))
}

fn sun(text: &str) -> Result<Sun, String> {
    numbers(text).map(|[azimuth_deg, elevation_deg]| Sun {
        azimuth_deg,
        elevation_deg,
    })
}

fn positive(text: &str) -> Result<f32, String> {
    let [value] = numbers(text)?;
    let value = value as f32;
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        Err("must be positive".into())
    }
}

fn size(text: &str) -> Result<UVec2, String> {
    text.split_once(['x', 'X'])
        .and_then(|(w, h)| Some(UVec2::new(w.trim().parse().ok()?, h.trim().parse().ok()?)))
        .ok_or_else(|| {
            "expected width and height in pixels with an x between them, as 1280x720".into()
        })
}

fn traversal(text: &str) -> Result<Traversal, String> {
    TRAVERSALS
        .iter()
        .find(|(_, name)| *name == text)
        .map(|(traversal, _)| *traversal)
        .ok_or_else(|| "expected per-texel, max-mip, boxes or hybrid".into())
}

fn method(text: &str) -> Result<ShadowMethod, String> {
    METHODS
        .iter()
        .find(|(_, name)| *name == text)
        .map(|(method, _)| *method)
        .ok_or_else(|| "expected per-texel, max-mip or sweep".into())
}

fn scene(text: &str) -> Result<occlusion::SceneKind, String> {
    occlusion::SCENES
        .iter()
        .find(|(_, name)| *name == text)
        .map(|(kind, _)| *kind)
        .ok_or_else(|| "expected city, bunnies or seabed".into())
}

fn policies(text: &str) -> Result<Policies, String> {
    match text {
        "all" => Ok(Policies::All),
        _ => text.parse().map(Policies::One),
    }
}

fn clock(text: &str) -> Result<Clock, String> {
    [Clock::Time, Clock::Counted]
        .into_iter()
        .find(|clock| clock.name() == text)
        .ok_or_else(|| "expected time or counted".into())
}

fn number(text: &str) -> Result<f64, String> {
    numbers(text).map(|[value]| value)
}
