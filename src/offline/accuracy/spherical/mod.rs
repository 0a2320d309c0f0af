//! `skyline accuracy spherical`: what a spherical index leaves out, what that saves, and what is wrong about it (P3).
//!
//! A detailed mesh in one, four and eight windows of two sizes, all of it in view or cut by the frustum in P3's three
//! ways, as it is timed in P3's tables; drawn whole, by the default at some sizes of chunks and of bins, as published, and
//! by meshlets with normal cones (meshoptimizer's). Two figures of what is drawn: the share of the mesh's triangles,
//! and `false_cull_px`: pixels, in hundreds of views besides, that are not as when all is drawn.

mod cones;
mod report;
mod stage;

use std::path::{Path, PathBuf};

use bevy::{math::UVec2, platform::time::Instant};
use indicatif::ProgressBar;
use serde::Serialize;

use self::stage::{Case, Stage};
use super::{AccuracyError, Found, Report, Summary, Timing};
use crate::{
    offline::{scenes::compare::differing_px, spinner},
    spherical::{Bins, SphericalIndex, SphericalMode},
};

/// What to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Triangle mesh (`.obj`), else one made by code.
    pub model: Option<PathBuf>,
    /// Triangles of that one.
    pub triangles: u32,
    /// How many windows there are, and how large each is; with the first every way is timed, with the others only the
    /// default, the paper's and cones. units: px
    pub windows: Vec<(u32, UVec2)>,
    /// Frames that each way is timed for in a round.
    pub frames: u32,
    /// How often each way has its turn, at least 1.
    pub rounds: usize,
    /// Views that are compared pixel by pixel, of each way.
    pub views: u32,
    /// Size of these. units: px
    pub view_size: UVec2,
    /// Only the default, the paper's mode and cones.
    pub few_ways: bool,
}

impl Plan {
    /// P3's windows, and more views than can be counted on.
    pub fn full() -> Self {
        let [small, large] = [UVec2::new(320, 240), UVec2::new(640, 480)];
        Self {
            model: None,
            triangles: 150_000,
            windows: vec![(1, small), (4, small), (8, small), (1, large), (4, large)],
            frames: 8,
            rounds: 2,
            views: 520,
            view_size: UVec2::new(320, 240),
            few_ways: false,
        }
    }

    /// A minute or two.
    pub fn quick() -> Self {
        Self {
            triangles: 60_000,
            windows: vec![(1, UVec2::new(160, 120)), (4, UVec2::new(160, 120))],
            frames: 4,
            rounds: 1,
            views: 40,
            view_size: UVec2::new(160, 120),
            few_ways: true,
            ..Self::full()
        }
    }

    /// Drawn whole first.
    fn ways(few: bool) -> Vec<Way> {
        let of = |mode, bins: (u16, u16), chunk_triangles| {
            Way::Index(SphericalIndex {
                mode,
                bins: Bins {
                    theta: bins.0,
                    phi: bins.1,
                },
                chunk_triangles,
                // The paper's way is always gone.
                chunk_cost: match mode {
                    SphericalMode::Conservative => SphericalIndex::default().chunk_cost,
                    SphericalMode::Paper => 0,
                },
            })
        };
        let default = SphericalIndex::default().chunk_triangles;
        let finest = (Bins::default().theta, Bins::default().phi);
        let mut ways = vec![Way::None, of(SphericalMode::Conservative, finest, default)];
        if !few {
            for size in [64, 128, 256, 512, 1024, 2048] {
                if size != default {
                    ways.push(of(SphericalMode::Conservative, finest, size));
                }
            }
            for bins in [(45, 90), (90, 180)] {
                ways.push(of(SphericalMode::Conservative, bins, default));
                ways.push(of(SphericalMode::Paper, bins, 64));
            }
        }
        ways.push(of(SphericalMode::Paper, finest, 64));
        ways.push(Way::Cones);
        ways
    }
}

/// What is left out.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Way {
    /// Nothing.
    None,
    /// Meshlets whose normal cone says so.
    Cones,
    /// What the index says.
    Index(SphericalIndex),
}

impl Way {
    /// The same, never drawn whole because that costs less.
    fn by_chunks(self) -> Self {
        match self {
            Self::Index(settings) => Self::Index(SphericalIndex {
                chunk_cost: 0,
                ..settings
            }),
            other => other,
        }
    }

    fn named(&self) -> SettingLine {
        match self {
            Self::None => SettingLine::of("none"),
            Self::Cones => SettingLine::of("cones"),
            Self::Index(settings) => SettingLine {
                mode: match settings.mode {
                    SphericalMode::Conservative => "conservative",
                    SphericalMode::Paper => "paper",
                },
                bins: Some([settings.bins.theta, settings.bins.phi]),
                chunk_triangles: Some(settings.chunk_triangles),
            },
        }
    }
}

/// A setting, by its component's fields.
#[derive(Serialize, Clone, Debug, PartialEq)]
pub struct SettingLine {
    /// `none`, `conservative`, `paper`, or `cones`.
    pub mode: &'static str,
    /// Of θ and φ.
    pub bins: Option<[u16; 2]>,
    /// About how many triangles a chunk has.
    pub chunk_triangles: Option<u32>,
}

impl SettingLine {
    fn of(mode: &'static str) -> Self {
        Self {
            mode,
            bins: None,
            chunk_triangles: None,
        }
    }
}

/// The default, as lines name it.
pub(super) fn default_setting() -> serde_json::Value {
    serde_json::json!(Way::Index(SphericalIndex::default()).named())
}

/// One line of `results.jsonl`.
#[derive(Serialize, Clone, Debug)]
pub struct SphericalLine {
    /// Always `spherical`.
    pub effect: &'static str,
    /// The mesh, then how it is looked at.
    pub scene: String,
    /// How it was drawn.
    pub setting: SettingLine,
    /// How many windows, and how large each is. units: px
    pub windows: u32,
    /// See `windows`.
    pub size_px: [u32; 2],
    /// Whole frames, selection included, from their start until the GPU was done. units: ms
    pub time_ms: Timing,
    /// How many times as fast as when all is drawn, by medians.
    pub faster: f64,
    /// Triangles drawn a window, mean of all frames; and their share of the mesh's.
    pub triangles: f64,
    /// See `triangles`.
    pub share: f64,
    /// Objects that they are drawn in, a window.
    pub objects: f64,
    /// What is wrong, in views of all kinds; the same in every line of a setting.
    pub error: SphericalErrors,
    /// Name of the GPU.
    pub adapter: String,
}

/// What is wrong.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct SphericalErrors {
    /// Pixels that are not as when all is drawn.
    pub false_cull_px: u64,
    /// Of so many.
    pub pixels: u64,
    /// Views with such pixels.
    pub views_with_false_culls: u32,
    /// Of so many.
    pub views: u32,
}

/// Measures spherical indices and writes everything to a directory.
///
/// # Errors
/// [`AccuracyError`].
pub fn measure(plan: &Plan, out: &Path) -> Result<Summary, AccuracyError> {
    let mut report = Report::new(out, "spherical")?;
    let progress = spinner();
    progress.set_message("reading the mesh");
    let mut stage = Stage::new(plan.model.as_deref(), plan.triangles)?;
    let (ways, few) = (Plan::ways(plan.few_ways), Plan::ways(true));
    let errors = look(plan, &ways, &mut stage, &progress, &mut report)?;
    let of_all: Vec<_> = ways.into_iter().zip(errors).collect();
    let of_few: Vec<_> = of_all
        .iter()
        .filter(|(way, _)| few.contains(way))
        .copied()
        .collect();
    let mut lines = Vec::new();
    for (at, (count, size)) in plan.windows.iter().enumerate() {
        let ways = if at == 0 { &of_all } else { &of_few };
        stage.windows(*count, *size);
        for case in Case::TIMED {
            progress.set_message(format!("{count} windows of {size}, {}", case.name()));
            time(
                plan,
                ways,
                case,
                (*count, *size),
                &mut stage,
                &progress,
                &mut lines,
            )?;
        }
    }
    progress.finish_and_clear();
    report::draw(&mut report, &lines)?;
    report.results(&lines)?;
    report.csv(&report::csv(&lines))?;
    let tables = report::tables(&lines);
    let adapter = stage.offline.adapter();
    let head = format!(
        "{}: {} triangles; {adapter}; times are medians of whole frames until the GPU was done, selection included; wrong pixels in {} views of {}×{} px.",
        stage.name, stage.triangles, plan.views, plan.view_size.x, plan.view_size.y,
    );
    report.finish(Found {
        title: "What accuracy costs: spherical index",
        head: &head,
        tables: &tables,
        clock: "the wall clock, from a frame's start until the GPU was done",
        adapter,
        results: lines.len(),
        highlights: report::highlights(&lines),
    })
}

/// The views that are compared: each case in turn, from inside as well.
fn views(count: u32) -> impl Iterator<Item = (Case, f32)> {
    let cases = [
        Case::Whole,
        Case::Run,
        Case::Clump,
        Case::Split,
        Case::Inside,
    ];
    (0..count).map(move |i| {
        let case = cases[i as usize % cases.len()];
        (case, i as f32 / count as f32)
    })
}

/// What is wrong with each way, and a picture of the worst view of the paper's.
fn look(
    plan: &Plan,
    ways: &[Way],
    stage: &mut Stage,
    progress: &ProgressBar,
    report: &mut Report,
) -> Result<Vec<SphericalErrors>, AccuracyError> {
    stage.windows(1, plan.view_size);
    let mut whole = Vec::new();
    let mut all = Vec::new();
    for way in ways {
        let name = way.named();
        progress.set_message(format!("looking at {} {:?}", name.mode, name.bins));
        stage.set(&way.by_chunks())?;
        let mut errors = SphericalErrors {
            views: plan.views,
            ..Default::default()
        };
        let mut worst: Option<(u64, usize, image::RgbaImage)> = None;
        for (at, (case, turn)) in views(plan.views).enumerate() {
            progress.inc(1);
            stage.look(case, turn);
            stage.offline.step();
            let picture = stage.picture()?;
            if *way == Way::None {
                whole.push(picture);
                continue;
            }
            let wrong = differing_px(&whole[at], &picture);
            errors.false_cull_px += wrong;
            errors.pixels += u64::from(picture.width() * picture.height());
            errors.views_with_false_culls += u32::from(wrong > 0);
            if case == Case::Whole && wrong > worst.as_ref().map_or(0, |(most, ..)| *most) {
                worst = Some((wrong, at, picture));
            }
        }
        if let Some((wrong, at, picture)) = worst {
            report::picture(report, &name, wrong, &whole[at], &picture)?;
        }
        all.push(errors);
    }
    Ok(all)
}

fn time(
    plan: &Plan,
    ways: &[(Way, SphericalErrors)],
    case: Case,
    (count, size): (u32, UVec2),
    stage: &mut Stage,
    progress: &ProgressBar,
    lines: &mut Vec<SphericalLine>,
) -> Result<(), AccuracyError> {
    let mut times = vec![Vec::new(); ways.len()];
    let mut drawn = vec![(0, 0); ways.len()];
    for _ in 0..plan.rounds {
        for (at, (way, _)) in ways.iter().enumerate() {
            progress.inc(1);
            stage.look(case, 0.0);
            stage.set(way)?;
            for frame in 0..plan.frames {
                stage.look(case, frame as f32 / plan.frames as f32);
                let began = Instant::now();
                stage.offline.step();
                times[at].push(began.elapsed().as_secs_f64() * 1e3);
                let (triangles, objects) = stage.drawn(way);
                drawn[at].0 += triangles;
                drawn[at].1 += objects;
            }
        }
    }
    let looks = f64::from(count) * f64::from(plan.frames) * plan.rounds as f64;
    let times: Vec<Timing> = times.into_iter().map(Timing::of).collect();
    for (at, (way, error)) in ways.iter().enumerate() {
        let triangles = drawn[at].0 as f64 / looks;
        lines.push(SphericalLine {
            effect: "spherical",
            scene: format!("{}/{}", stage.name, case.name()),
            setting: way.named(),
            windows: count,
            size_px: size.to_array(),
            time_ms: times[at],
            faster: times[0].median / times[at].median,
            triangles,
            share: triangles / stage.triangles as f64,
            objects: drawn[at].1 as f64 / looks,
            error: *error,
            adapter: stage.offline.adapter(),
        });
    }
    Ok(())
}
