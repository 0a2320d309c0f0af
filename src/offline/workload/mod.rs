//! `skyline workload`: the frame times of a city along a path of the camera, under one policy or all of them (P4,
//! Fig. 6: polygons and frame time against the camera's angle).
//!
//! Two clocks run side by side. `time` is the wall clock, from a frame's start until the GPU was done; on a shared
//! machine it is noisy. `counted` is [`Cost`]: what was really drawn in the frame (objects, triangles, square pixels),
//! each at a price that is learned once at the start from measured frames, or given. The budget is held on one of
//! them; both are reported.
//!
//! With all policies, each baseline's number is chosen so that its mean counted time along the path is the budget's, or near it:
//! then they differ in how steady they are and in what they leave out, not in how much they draw.

mod census;
mod cost;
mod path;
mod policy;
mod report;
mod stage;

use std::path::{Path, PathBuf};

use bevy::{math::UVec2, platform::time::Instant};
use indicatif::ProgressBar;
use serde::Serialize;

use super::{
    OfflineError,
    plot::PlotError,
    scenes::{Scene, SceneError, city},
    spinner,
};

pub use census::{BASELINES, Baseline, Census};
pub use cost::{Cost, Drawn};
pub use path::{Pose, WORKLOAD_PATHS, WorkloadPath};
pub use policy::Policy;
pub use stage::{Clock, Measured, WorkloadStage};

/// Frames that lead up to the first one that is measured: a new camera's first frames cost more than others.
const LEAD_FRAMES: i64 = 6;
/// The same for a budget, which has to learn what things cost.
const BUDGET_LEAD_FRAMES: i64 = 40;
/// Places that costs are learned at.
const CALIBRATION_PLACES: u32 = 12;

/// Why a workload could not be measured.
#[derive(thiserror::Error, Debug)]
#[non_exhaustive]
pub enum WorkloadError {
    /// Nothing could be drawn.
    #[error(transparent)]
    Offline(#[from] OfflineError),
    /// The GPU has no such pictures.
    #[error("a picture of {}x{} pixels cannot be drawn here: from 1 to {limit} a side", size.x, size.y)]
    Size {
        /// What was asked for. units: px
        size: UVec2,
        /// The longest side there may be. units: px
        limit: u32,
    },
    /// The scene could not be made.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The plot could not be drawn.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// A file could not be written.
    #[error("cannot write {}: {reason}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What is in the way.
        reason: String,
    },
    /// No frame's time could be believed.
    #[error("what a frame costs could not be learned: no frame took a time above 0; give --cost")]
    NoCost,
}

impl WorkloadError {
    /// Whether other input would have helped, rather than another machine.
    pub fn is_input(&self) -> bool {
        !matches!(self, Self::Offline(_))
    }
}

/// Which policies are measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Policies {
    /// One.
    One(Policy),
    /// All, the baselines at the budget's mean.
    All,
}

/// What to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// How the camera moves.
    pub path: WorkloadPath,
    /// Frames of the path, at least 1.
    pub frames: u32,
    /// What a frame may take, above 0. units: ms
    pub target_ms: f64,
    /// What decides what is drawn.
    pub policies: Policies,
    /// Which time the budget is held on.
    pub clock: Clock,
    /// What everything is counted as; else it is learned.
    pub cost: Option<Cost>,
    /// Size of the pictures. units: px
    pub size: UVec2,
    /// A glTF binary with a node and mesh a building, else a city made by code.
    pub city: Option<PathBuf>,
    /// Whether what is hidden is left out, too, under every policy but [`Policy::None`].
    pub occludes: bool,
    /// A small city.
    pub quick: bool,
}

impl Plan {
    /// The scene.
    ///
    /// # Errors
    /// [`SceneError`] of the city's file.
    pub fn scene(&self) -> Result<Scene, SceneError> {
        city::furnished_for(self.city.as_deref(), self.quick)
    }
}

/// One frame of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Its number, from 0.
    pub frame: u32,
    /// Where on the path: angle, focal length or way.
    pub parameter: f64,
    /// What was drawn and how long it took.
    pub measured: Measured,
    /// What was drawn, counted. units: ms
    pub counted_ms: f64,
}

/// The frames of a path under one policy.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// What decided what was drawn.
    pub policy: Policy,
    /// Frame by frame.
    pub rows: Vec<Row>,
}

/// How long frames took, all of them together.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct Steadiness {
    /// Their mean. units: ms
    pub mean: f64,
    /// Their standard deviation. units: ms
    pub std: f64,
    /// The longest. units: ms
    pub max: f64,
    /// Share of them that took longer than the target.
    pub over_budget_fraction: f64,
}

impl Steadiness {
    /// Of any number of times, zero for none.
    pub fn of(times: impl ExactSizeIterator<Item = f64> + Clone, target_ms: f64) -> Self {
        let count = times.len().max(1) as f64;
        let mean = times.clone().sum::<f64>() / count;
        let square = times.clone().map(|ms| (ms - mean).powi(2)).sum::<f64>() / count;
        Self {
            mean,
            std: square.sqrt(),
            max: times.clone().fold(0.0, f64::max),
            over_budget_fraction: times.filter(|ms| *ms > target_ms).count() as f64 / count,
        }
    }
}

impl Run {
    /// Of the measured times.
    pub fn time(&self, target_ms: f64) -> Steadiness {
        Steadiness::of(self.rows.iter().map(|row| row.measured.frame_ms), target_ms)
    }

    /// Of the counted times.
    pub fn counted(&self, target_ms: f64) -> Steadiness {
        Steadiness::of(self.rows.iter().map(|row| row.counted_ms), target_ms)
    }

    /// Mean over the frames of what was drawn.
    pub fn mean_drawn(&self) -> Drawn {
        let sum: Drawn = self.rows.iter().map(|row| row.measured.drawn).sum();
        let count = self.rows.len().max(1) as f64;
        Drawn {
            objects: sum.objects / count,
            triangles: sum.triangles / count,
            pixels: sum.pixels / count,
        }
    }
}

/// Goes along a path under a policy. `after` is called when each frame has been measured.
///
/// # Errors
/// Those of `after`.
pub fn drive<E>(
    stage: &mut WorkloadStage,
    policy: &Policy,
    (path, frames): (WorkloadPath, u32),
    (target_ms, clock): (f64, Clock),
    mut after: impl FnMut(&WorkloadStage) -> Result<(), E>,
) -> Result<Run, E> {
    stage.begin(policy, target_ms, clock);
    let lead = match policy {
        Policy::Budget => BUDGET_LEAD_FRAMES,
        _ => LEAD_FRAMES,
    };
    for frame in -lead..0 {
        stage.frame(path, frame, frames);
    }
    let mut rows = Vec::with_capacity(frames as usize);
    for frame in 0..frames {
        let measured = stage.frame(path, i64::from(frame), frames);
        after(stage)?;
        rows.push(Row {
            frame,
            parameter: path.parameter(&stage.scene, path.part(i64::from(frame), frames)),
            counted_ms: stage.cost.of(measured.drawn),
            measured,
        });
    }
    Ok(Run {
        policy: *policy,
        rows,
    })
}

/// What a run tells on stdout.
#[derive(Serialize, Clone, Debug)]
pub struct Summary {
    /// Name of the scene.
    pub scene: String,
    /// Objects in it.
    pub objects: usize,
    /// Triangles of them all.
    pub triangles: usize,
    /// How the camera moved.
    pub path: &'static str,
    /// What the column `parameter` is.
    pub parameter: &'static str,
    /// Frames measured under each policy.
    pub frames: u32,
    /// units: px
    pub size_px: [u32; 2],
    /// units: ms
    pub target_ms: f64,
    /// Which time the budget was held on.
    pub clock: &'static str,
    /// Whether what is hidden was left out, too.
    pub occlusion: bool,
    /// What everything was counted as.
    pub cost: Cost,
    /// Root of the mean square of `counted / measured − 1` over the frames that it was learned from; `None` where it
    /// was given.
    pub cost_misfit: Option<f64>,
    /// Name of the GPU.
    pub adapter: String,
    /// Each policy.
    pub policies: Vec<PolicySummary>,
    /// Time the whole run took. units: s
    pub seconds: f64,
    /// All files written.
    pub files: Vec<PathBuf>,
}

/// One policy in a [`Summary`].
#[derive(Serialize, Clone, Debug)]
pub struct PolicySummary {
    /// As it would be asked for.
    pub policy: String,
    /// By the wall clock.
    pub frame_ms: Steadiness,
    /// By what was drawn.
    pub counted_ms: Steadiness,
    /// Mean triangles of a frame.
    pub polygons_mean: f64,
    /// Mean objects of a frame.
    pub objects_mean: f64,
}

impl PolicySummary {
    fn of(run: &Run, target_ms: f64) -> Self {
        let drawn = run.mean_drawn();
        Self {
            policy: run.policy.to_string(),
            frame_ms: run.time(target_ms),
            counted_ms: run.counted(target_ms),
            polygons_mean: drawn.triangles,
            objects_mean: drawn.objects,
        }
    }
}

/// Measures, and writes a table of all frames; with all policies also a plot beside it, as a PNG of the same stem.
///
/// # Errors
/// [`WorkloadError`].
pub fn measure(plan: &Plan, out: &Path) -> Result<Summary, WorkloadError> {
    let start = Instant::now();
    // Found out now rather than after minutes of measuring.
    report::check(out)?;
    let progress = spinner();
    progress.set_message("making the scene");
    let mut stage = WorkloadStage::new(plan.scene()?, plan.size)?;
    let learned = learn(&mut stage, plan.path, plan.cost, plan.quick, &progress)?;
    stage.set_occludes(plan.occludes);
    let way = (plan.path, plan.frames);
    let goal = (plan.target_ms, plan.clock);
    let run = |stage: &mut WorkloadStage, policy: &Policy| {
        progress.set_message(policy.to_string());
        drive(stage, policy, way, goal, |_| {
            progress.inc(1);
            Ok::<(), WorkloadError>(())
        })
    };
    let runs = match plan.policies {
        Policies::One(policy) => vec![run(&mut stage, &policy)?],
        Policies::All => {
            let census = Census::take(&mut stage, plan.path, plan.frames);
            let budget = run(&mut stage, &Policy::Budget)?;
            let mean_ms = budget.counted(plan.target_ms).mean;
            let mut runs = vec![
                run(&mut stage, &Policy::None)?,
                run(&mut stage, &Policy::Frustum)?,
            ];
            for baseline in BASELINES {
                let tuned = census.run_tuned(&mut stage, baseline, mean_ms, |stage, policy| {
                    let run = run(stage, policy)?;
                    Ok::<_, WorkloadError>((run.counted(plan.target_ms).mean, run))
                });
                runs.push(tuned?);
            }
            runs.push(budget);
            runs
        }
    };
    progress.finish_and_clear();
    report::write(out, &report::csv(&runs))?;
    let mut files = vec![out.to_owned()];
    if plan.policies == Policies::All {
        let plot = out.with_extension("png");
        report::draw(&plot, &stage.scene.name, plan, &runs)?;
        files.push(plot);
    }
    Ok(Summary {
        objects: stage.scene.objects.len(),
        triangles: stage.scene.triangles(),
        scene: stage.scene.name.clone(),
        path: plan.path.name(),
        parameter: plan.path.parameter_name(),
        frames: plan.frames,
        size_px: plan.size.to_array(),
        target_ms: plan.target_ms,
        clock: plan.clock.name(),
        occlusion: plan.occludes,
        cost: stage.cost,
        cost_misfit: learned,
        adapter: stage.offline.adapter(),
        policies: runs
            .iter()
            .map(|run| PolicySummary::of(run, plan.target_ms))
            .collect(),
        seconds: start.elapsed().as_secs_f64(),
        files,
    })
}

/// Sets what everything is counted as, learned on a path or given; returns how far what was learned is off.
pub(in crate::offline) fn learn(
    stage: &mut WorkloadStage,
    path: WorkloadPath,
    given: Option<Cost>,
    quick: bool,
    progress: &ProgressBar,
) -> Result<Option<f64>, WorkloadError> {
    if let Some(cost) = given {
        stage.cost = cost;
        return Ok(None);
    }
    progress.set_message("learning what a frame costs");
    let places = CALIBRATION_PLACES / if quick { 2 } else { 1 };
    let frames = stage.calibrate(path, places);
    stage.cost = Cost::fit(&frames).ok_or(WorkloadError::NoCost)?;
    Ok(Some(stage.cost.misfit(&frames)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steadiness_is_that_of_the_times() {
        let times = [10.0, 14.0, 12.0, 20.0];
        let of = Steadiness::of(times.into_iter(), 12.0);
        assert_eq!((of.mean, of.max), (14.0, 20.0));
        assert!((of.std - 14f64.sqrt()).abs() < 1e-12, "{of:?}");
        assert_eq!(
            of.over_budget_fraction, 0.5,
            "12 ms is no longer than 12 ms"
        );
        assert_eq!(Steadiness::of([].into_iter(), 1.0), Steadiness::default());
    }
}
