//! `skyline accuracy budget`: how steady a frame budget holds the frame time, and what is lost of the picture for it,
//! against P4's baselines at the same mean.
//!
//! For each path, clock and target the budget runs first. Each baseline's number is then chosen so that its mean
//! counted time along the path is the budget's, and it runs too: at equal cost, what differs is how steady it is and
//! what it leaves out. Targets are shares of what the lightest frame of the turn costs with everything in view drawn,
//! so that every frame of it can be brought up to them.

mod measure;
mod report;

use std::path::{Path, PathBuf};

use bevy::math::UVec2;
use serde::Serialize;

use super::{AccuracyError, Found, Report, Summary, Timing};
use crate::offline::{
    scenes::city,
    spinner,
    workload::{Clock, Cost, Drawn, Steadiness, WorkloadPath, WorkloadStage},
};

/// What to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Size of the pictures. units: px
    pub size: UVec2,
    /// A small city.
    pub quick: bool,
    /// A glTF binary with a node and mesh a building, else a city made by code.
    pub city: Option<PathBuf>,
    /// Ways of the camera.
    pub paths: Vec<WorkloadPath>,
    /// Frames of each, at least 1.
    pub path_frames: u32,
    /// Which times are held.
    pub clocks: Vec<Clock>,
    /// Whether what is hidden is left out, too, under every policy but `none`.
    pub occludes: Vec<bool>,
    /// Targets, as shares of what the lightest frame of a turn costs beyond an empty one.
    pub targets: Vec<f64>,
}

impl Plan {
    /// Every path, clock and target.
    pub fn full() -> Self {
        Self {
            size: UVec2::new(320, 180),
            quick: false,
            city: None,
            paths: vec![WorkloadPath::Rotate, WorkloadPath::Zoom],
            path_frames: 180,
            clocks: vec![Clock::Counted, Clock::Time],
            occludes: vec![false, true],
            targets: vec![0.5, 0.7, 0.9],
        }
    }

    /// A minute or two on a machine without a GPU.
    pub fn quick() -> Self {
        Self {
            quick: true,
            path_frames: 36,
            occludes: vec![false],
            targets: vec![0.5],
            ..Self::full()
        }
    }
}

/// A policy, a target and a clock, by their flags.
#[derive(Serialize, Clone, Debug, PartialEq)]
pub struct SettingLine {
    /// `budget`, `polygons`, `distance`, `threshold`, `frustum` or `none`.
    pub policy: &'static str,
    /// Its number: triangles, metres or square pixels.
    pub parameter: Option<f64>,
    /// units: ms
    pub target_ms: f64,
    /// Which time the budget held, and the errors are of.
    pub clock: &'static str,
}

/// One line of `results.jsonl`.
#[derive(Serialize, Clone, Debug)]
pub struct BudgetLine {
    /// Always `budget`.
    pub effect: &'static str,
    /// Scene and path.
    pub scene: String,
    /// What decided what was drawn.
    pub setting: SettingLine,
    /// Whole frames by the wall clock, from their start until the GPU was done. units: ms
    pub time_ms: Timing,
    /// By the wall clock. units: ms
    pub measured: Steadiness,
    /// By what was drawn. units: ms
    pub counted: Steadiness,
    /// Mean of all frames.
    pub drawn: Drawn,
    /// On the clock of the setting.
    pub error: BudgetError,
    /// Frames looked at.
    pub frames: u32,
    /// units: px
    pub size_px: [u32; 2],
    /// Name of the GPU.
    pub adapter: String,
}

/// How far from one steady frame time, and from the unculled picture.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct BudgetError {
    /// units: ms
    pub frame_ms_mean: f64,
    /// Standard deviation. units: ms
    pub frame_ms_std: f64,
    /// Share of the frames that took longer than the target.
    pub over_budget_fraction: f64,
    /// Mean over the frames of the mean FLIP error against the unculled picture (Andersson et al. 2020).
    pub flip_mean: f64,
}

/// Measures the budget and the baselines and writes everything to a directory.
///
/// # Errors
/// [`AccuracyError`].
pub fn measure(plan: &Plan, out: &Path) -> Result<Summary, AccuracyError> {
    let mut report = Report::new(out, "budget")?;
    let progress = spinner();
    progress.set_message("making the scene");
    let scene = city::furnished_for(plan.city.as_deref(), plan.quick)?;
    let mut stage = WorkloadStage::new(scene, plan.size)?;
    let measured = measure::measure_all(&mut stage, plan, &progress)?;
    progress.finish_and_clear();

    report::draw(&mut report, &measured)?;
    for (at, (what, whole, picture)) in measured.worst.iter().enumerate() {
        report.compare(&format!("worst_{at}.png"), what, whole, picture)?;
    }
    report.results(&measured.lines)?;
    report.csv(&report::csv(&measured.lines))?;
    let tables = report::tables(&measured.lines);
    let adapter = stage.offline.adapter();
    let Cost {
        object_ms,
        triangle_ms,
        pixel_ms,
        frame_ms,
    } = stage.cost;
    let head = format!(
        "{}: {} objects, {} triangles; {}×{} px; {adapter}. Counted time: {:.3} µs an object, {:.1} ns a triangle, \
         {:.2} ns a square pixel of bounds, {frame_ms:.2} ms a frame; root-mean-square misfit of the frames it was \
         learned from {:.1} %.",
        stage.scene.name,
        stage.scene.objects.len(),
        stage.scene.triangles(),
        plan.size.x,
        plan.size.y,
        1e3 * object_ms,
        1e6 * triangle_ms,
        1e6 * pixel_ms,
        100.0 * measured.misfit,
    );
    report.finish(Found {
        title: "What accuracy costs: the frame budget",
        head: &head,
        tables: &tables,
        clock: "the wall clock, from a frame's start until the GPU was done; and what was drawn, counted",
        adapter,
        results: measured.lines.len(),
        highlights: report::highlights(&measured.lines, stage.cost, measured.misfit),
    })
}
