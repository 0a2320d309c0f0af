//! All paths, clocks, targets and policies.

use image::RgbImage;
use indicatif::ProgressBar;

use super::{
    super::{AccuracyError, Timing, difference::flip_mean},
    BudgetError, BudgetLine, Plan, SettingLine,
};
use crate::offline::{
    OfflineError,
    workload::{BASELINES, Census, Clock, Policy, Run, WorkloadPath, WorkloadStage, drive, learn},
};

/// Everything that was measured.
pub(super) struct Measured {
    pub lines: Vec<BudgetLine>,
    /// The frames of each run that is drawn as a plot: those of the middle target.
    pub shown: Vec<Shown>,
    /// The budget's worst frame at each middle target: what it is, the unculled picture, and its own.
    pub worst: Vec<(String, RgbImage, RgbImage)>,
    /// How far the counted cost is from what it was learned from.
    pub misfit: f64,
}

/// The runs of one path and clock at one target.
pub(super) struct Shown {
    pub scene: String,
    pub path: WorkloadPath,
    pub clock: Clock,
    pub target_ms: f64,
    pub runs: Vec<Run>,
}

/// One run, and how far its pictures are from the unculled ones.
struct Seen {
    run: Run,
    flip_mean: f64,
    /// The frame that is farthest off: how far, which, and its picture.
    worst: Option<(f64, usize, RgbImage)>,
}

fn pictures_of(
    stage: &mut WorkloadStage,
    policy: &Policy,
    way: (WorkloadPath, u32),
    goal: (f64, Clock),
) -> Result<(Run, Vec<RgbImage>), OfflineError> {
    let mut pictures = Vec::new();
    let run = drive(stage, policy, way, goal, |stage| {
        pictures.push(stage.picture()?);
        Ok::<(), OfflineError>(())
    })?;
    Ok((run, pictures))
}

/// What a run is along, held to, and compared with.
struct Along<'a> {
    way: (WorkloadPath, u32),
    goal: (f64, Clock),
    /// The unculled pictures.
    whole: &'a [RgbImage],
    progress: &'a ProgressBar,
}

fn see(stage: &mut WorkloadStage, policy: &Policy, along: &Along) -> Result<Seen, AccuracyError> {
    let (run, pictures) = pictures_of(stage, policy, along.way, along.goal)?;
    along.progress.inc(1);
    // After the run: nothing of it falls into the frames' times.
    let whole = along.whole;
    let flips: Vec<f64> = whole
        .iter()
        .zip(&pictures)
        .map(|(a, b)| flip_mean(a, b))
        .collect();
    let worst = flips
        .iter()
        .copied()
        .zip(0..)
        .zip(pictures)
        .max_by(|((a, _), _), ((b, _), _)| a.total_cmp(b))
        .map(|((flip, frame), picture)| (flip, frame, picture));
    Ok(Seen {
        run,
        flip_mean: flips.iter().sum::<f64>() / whole.len().max(1) as f64,
        worst,
    })
}

pub(super) fn measure_all(
    stage: &mut WorkloadStage,
    plan: &Plan,
    progress: &ProgressBar,
) -> Result<Measured, AccuracyError> {
    let misfit = learn(stage, WorkloadPath::Rotate, None, plan.quick, progress)?;
    let mut measured = Measured {
        lines: Vec::new(),
        shown: Vec::new(),
        worst: Vec::new(),
        misfit: misfit.unwrap_or(0.0),
    };
    let mut lightest_ms = Vec::new();
    for &occludes in &plan.occludes {
        stage.set_occludes(occludes);
        let turn = Census::take(stage, WorkloadPath::Rotate, plan.path_frames);
        lightest_ms.push(turn.least_ms(&stage.cost));
    }
    for &path in &plan.paths {
        let (none, whole) = pictures_of(
            stage,
            &Policy::None,
            (path, plan.path_frames),
            (0.0, Clock::Time),
        )?;
        progress.inc(1);
        let none = Seen {
            run: none,
            flip_mean: 0.0,
            worst: None,
        };
        for (&occludes, &lightest_ms) in plan.occludes.iter().zip(&lightest_ms) {
            stage.set_occludes(occludes);
            let unculled = (&none, whole.as_slice());
            measure_path(
                stage,
                plan,
                (path, occludes),
                lightest_ms,
                unculled,
                progress,
                &mut measured,
            )?;
        }
    }
    Ok(measured)
}

/// A path under all clocks, targets and policies, what is hidden being left out, too, or not.
fn measure_path(
    stage: &mut WorkloadStage,
    plan: &Plan,
    (path, occludes): (WorkloadPath, bool),
    lightest_ms: f64,
    (none, whole): (&Seen, &[RgbImage]),
    progress: &ProgressBar,
    measured: &mut Measured,
) -> Result<(), AccuracyError> {
    let empty_ms = stage.cost.frame_ms;
    let occlusion = if occludes { "_occlusion" } else { "" };
    let name = format!("{}/{}{occlusion}", stage.scene.name, path.name());
    progress.set_message(name.clone());
    let way = (path, plan.path_frames);
    let census = Census::take(stage, path, plan.path_frames);
    let along = |goal| Along {
        way,
        goal,
        whole,
        progress,
    };
    let frustum = see(stage, &Policy::Frustum, &along((0.0, Clock::Time)))?;
    for &clock in &plan.clocks {
        for (index, share) in plan.targets.iter().enumerate() {
            let target_ms = empty_ms + share * (lightest_ms - empty_ms);
            let goal = (target_ms, clock);
            progress.set_message(format!("{name}, {target_ms:.2} ms, {}", clock.name()));
            let along = along(goal);
            let budget = see(stage, &Policy::Budget, &along)?;
            let mean_ms = budget.run.counted(target_ms).mean;
            let mut seen = vec![budget];
            for baseline in BASELINES {
                let tuned = census.run_tuned(stage, baseline, mean_ms, |stage, policy| {
                    let seen = see(stage, policy, &along)?;
                    Ok::<_, AccuracyError>((seen.run.counted(target_ms).mean, seen))
                });
                seen.push(tuned?);
            }
            for of in seen.iter().chain([&frustum, none]) {
                measured.lines.push(line(stage, &name, of, goal, plan));
            }
            if index == plan.targets.len() / 2 {
                if let Some((flip, frame, picture)) = seen[0].worst.take() {
                    let what = format!(
                        "{name}, the budget at {target_ms:.2} ms ({}): frame {frame}, the worst, FLIP {flip:.4}",
                        clock.name()
                    );
                    measured.worst.push((what, whole[frame].clone(), picture));
                }
                let mut runs: Vec<Run> = vec![frustum.run.clone()];
                runs.extend(seen.into_iter().rev().map(|of| of.run));
                measured.shown.push(Shown {
                    scene: name.clone(),
                    path,
                    clock,
                    target_ms,
                    runs,
                });
            }
        }
    }
    Ok(())
}

fn line(
    stage: &WorkloadStage,
    scene: &str,
    seen: &Seen,
    (target_ms, clock): (f64, Clock),
    plan: &Plan,
) -> BudgetLine {
    let run = &seen.run;
    let (measured, counted) = (run.time(target_ms), run.counted(target_ms));
    let held = match clock {
        Clock::Time => measured,
        Clock::Counted => counted,
    };
    BudgetLine {
        effect: "budget",
        scene: scene.to_owned(),
        setting: SettingLine {
            policy: run.policy.kind(),
            parameter: run.policy.parameter(),
            target_ms,
            clock: clock.name(),
        },
        time_ms: Timing::of(run.rows.iter().map(|row| row.measured.frame_ms).collect()),
        measured,
        counted,
        drawn: run.mean_drawn(),
        error: BudgetError {
            frame_ms_mean: held.mean,
            frame_ms_std: held.std,
            over_budget_fraction: held.over_budget_fraction,
            flip_mean: seen.flip_mean,
        },
        frames: plan.path_frames,
        size_px: plan.size.to_array(),
        adapter: stage.offline.adapter(),
    }
}
