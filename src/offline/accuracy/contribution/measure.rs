//! One view, standing still or trembling, with every setting.

use std::collections::HashSet;

use bevy::prelude::*;
use image::RgbImage;
use indicatif::ProgressBar;

use super::{
    super::{AccuracyError, Report, Timing, difference::flip_mean, scene::lattice},
    ContributionError, ContributionLine, Depth, Plan, Setting,
};
use crate::{
    culling::{CullReason, CulledEntities},
    occlusion::ZBufferOcclusion,
    offline::{
        scenes::View,
        workload::{Drawn, Measured, Pose, WorkloadStage},
    },
};

/// Frames before a picture is taken: read-back depth has arrived by then.
const WARM_FRAMES: usize = 8;
/// Frames of each timing.
const TIMED_FRAMES: usize = 3;
/// How far a trembling camera is from its place, at most, along each axis. units: m
const TREMBLE_M: f32 = 0.3;

fn begin(stage: &mut WorkloadStage, setting: &Setting) {
    let contribution = setting.contribution();
    if setting.depth == Depth::Off {
        stage.begin_with(contribution);
    } else {
        let occlusion = ZBufferOcclusion {
            // What is measured is culling, not when to leave it.
            rests: false,
            ..default()
        };
        stage.begin_with((contribution, occlusion));
    }
}

/// Whether each pixel is of another colour.
fn changed(a: &RgbImage, b: &RgbImage) -> Vec<bool> {
    a.pixels().zip(b.pixels()).map(|(a, b)| a != b).collect()
}

fn share(of: &[bool]) -> f64 {
    of.iter().filter(|is| **is).count() as f64 / of.len().max(1) as f64
}

fn line(stage: &WorkloadStage, scene: String, setting: &Setting, plan: &Plan) -> ContributionLine {
    ContributionLine {
        effect: "contribution",
        scene,
        setting: setting.named(),
        time_ms: Timing::default(),
        drawn: Drawn::default(),
        error: ContributionError::default(),
        frames: 1,
        size_px: plan.size.to_array(),
        adapter: stage.offline.adapter(),
    }
}

/// Measures one view that stands still.
pub(super) fn measure_view(
    stage: &mut WorkloadStage,
    view: &View,
    plan: &Plan,
    progress: &ProgressBar,
    report: &mut Report,
    lines: &mut Vec<ContributionLine>,
) -> Result<(), AccuracyError> {
    let pose = Pose {
        transform: view.transform,
        fov: stage.scene.projection().fov,
    };
    let scene = format!("{}/{}", stage.scene.name, view.name);
    let settings = plan.view_settings();
    let first = lines.len();
    let mut whole: Option<RgbImage> = None;
    let mut times = vec![Vec::new(); settings.len()];
    // Settings alternate, so that whatever else the machine does meets all of them alike.
    for round in 0..plan.rounds {
        for (setting, times) in settings.iter().zip(&mut times) {
            begin(stage, setting);
            stage.look(pose, 0);
            for _ in 0..WARM_FRAMES {
                stage.step();
            }
            let frames: Vec<Measured> = (0..TIMED_FRAMES).map(|_| stage.step()).collect();
            times.extend(frames.iter().map(|frame| frame.frame_ms));
            progress.inc(1);
            let (0, Some(last)) = (round, frames.last()) else {
                continue;
            };
            let picture = stage.picture()?;
            let whole = whole.get_or_insert_with(|| picture.clone());
            lines.push(ContributionLine {
                drawn: last.drawn,
                error: ContributionError {
                    flip_mean: flip_mean(whole, &picture),
                    threshold_px2: last.threshold_px2,
                    changed_fraction: share(&changed(whole, &picture)),
                    flicker_objects: None,
                    flicker_fraction: None,
                },
                ..line(stage, scene.clone(), setting, plan)
            });
            let shown =
                setting.depth == Depth::Off && [16.0, 256.0].contains(&setting.threshold_px2);
            if shown {
                let file = format!("{}_{}.png", scene.replace('/', "_"), setting.threshold_px2);
                let what = format!("{scene}, threshold {} px²", setting.threshold_px2);
                report.compare(&file, &what, whole, &picture)?;
            }
        }
    }
    for (line, times) in lines[first..].iter_mut().zip(times) {
        line.time_ms = Timing::of(times);
    }
    Ok(())
}

/// Where a trembling camera is in a frame.
fn trembling(view: &View, fov: f32, frame: u32) -> Pose {
    let draw = |salt: u32| lattice(frame as i32, 3, 50 + salt);
    let aside = TREMBLE_M * Vec3::new(draw(0), draw(1), draw(2));
    let mut transform = view.transform;
    transform.translation += transform.rotation * aside;
    Pose { transform, fov }
}

/// One frame of the unculled reference.
struct Whole {
    picture: RgbImage,
    in_view: HashSet<Entity>,
}

/// Measures one view whose camera trembles.
pub(super) fn measure_tremble(
    stage: &mut WorkloadStage,
    view: &View,
    plan: &Plan,
    progress: &ProgressBar,
    lines: &mut Vec<ContributionLine>,
) -> Result<(), AccuracyError> {
    let fov = stage.scene.projection().fov;
    let scene = format!("{}/{}/tremble", stage.scene.name, view.name);
    let mut whole: Vec<Whole> = Vec::new();
    for setting in plan.tremble_settings() {
        begin(stage, &setting);
        stage.look(trembling(view, fov, 0), 0);
        for _ in 0..WARM_FRAMES {
            stage.step();
        }
        let (mut times, mut drawn) = (Vec::new(), Vec::new());
        let mut error = ContributionError::default();
        let (mut came_and_went, mut turned) = (0, 0.0);
        let mut last: Option<(HashSet<Entity>, Vec<bool>)> = None;
        for frame in 0..plan.path_frames {
            stage.look(trembling(view, fov, frame), 0);
            let measured = stage.step();
            times.push(measured.frame_ms);
            drawn.push(measured.drawn);
            error.threshold_px2 = measured.threshold_px2;
            let picture = stage.picture()?;
            let small = small(stage);
            if whole.len() <= frame as usize {
                whole.push(Whole {
                    picture: picture.clone(),
                    in_view: stage.seen().map(|(entity, _)| entity).collect(),
                });
            }
            let of = &whole[frame as usize];
            error.flip_mean += flip_mean(&of.picture, &picture);
            let wrong = changed(&of.picture, &picture);
            error.changed_fraction += share(&wrong);
            if let Some((small_before, wrong_before)) = last {
                let before = &whole[frame as usize - 1].in_view;
                came_and_went += small
                    .symmetric_difference(&small_before)
                    .filter(|entity| before.contains(*entity) && of.in_view.contains(*entity))
                    .count();
                let changes: Vec<bool> = wrong
                    .iter()
                    .zip(&wrong_before)
                    .map(|(now, before)| now != before)
                    .collect();
                turned += share(&changes);
            }
            last = Some((small, wrong));
        }
        let frames = f64::from(plan.path_frames.max(1));
        let steps = f64::from(plan.path_frames.saturating_sub(1).max(1));
        error.flip_mean /= frames;
        error.changed_fraction /= frames;
        error.flicker_objects = Some(came_and_went as f64 / steps);
        error.flicker_fraction = Some(turned / steps);
        let sum: Drawn = drawn.into_iter().sum();
        lines.push(ContributionLine {
            time_ms: Timing::of(times),
            drawn: Drawn {
                objects: sum.objects / frames,
                triangles: sum.triangles / frames,
                pixels: sum.pixels / frames,
            },
            error,
            frames: plan.path_frames,
            ..line(stage, scene.clone(), &setting, plan)
        });
        progress.inc(1);
    }
    Ok(())
}

/// What was removed for covering too little.
fn small(stage: &WorkloadStage) -> HashSet<Entity> {
    let culled = stage
        .offline
        .app
        .world()
        .get::<CulledEntities>(stage.camera());
    culled.map_or_else(HashSet::new, |culled| {
        culled
            .iter()
            .filter(|(_, reason)| *reason == CullReason::Contribution)
            .map(|(entity, _)| entity)
            .collect()
    })
}
