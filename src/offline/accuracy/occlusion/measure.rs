//! One scene: its views, standing still, and the paths of its camera.

use bevy::{math::UVec2, platform::time::Instant};
use indicatif::ProgressBar;

use super::{
    AccuracyError, Objects, OcclusionError, OcclusionLine, Plan, Report, RestLine, Setting, Timing,
    exact, rest,
};
use crate::offline::scenes::{
    CameraPath, Look, Scene, View,
    compare::{Frame, PackedFrame},
    stage::{Culling, SceneStage},
};

/// Beyond this, a setting is timed once. units: s
const SLOW_S: f64 = 4.0;
/// Frames before and in each timing.
const WARM_FRAMES: usize = 5;
const TIMED_FRAMES: usize = 3;

/// Measures a scene, its first view with every setting there is if `every` says so; returns the GPU's name.
pub(super) fn measure_scene(
    scene: Scene,
    every: bool,
    plan: &Plan,
    progress: &ProgressBar,
    report: &mut Report,
    lines: &mut Vec<OcclusionLine>,
    rests: &mut Vec<RestLine>,
) -> Result<String, AccuracyError> {
    let seen = seen_objects(&scene, plan.size)?;
    let mut stage = SceneStage::new(scene, plan.size, Look::Shaded)?;
    let views = stage.scene.views.clone();
    for (index, (view, seen)) in views.iter().zip(seen).enumerate() {
        let settings = plan.settings(every && index == 0);
        let looked = measure_view(&mut stage, view, seen, &settings, plan, progress, lines)?;
        let name = format!("{}_{}", stage.scene.name, view.name);
        let (file, what) = (
            format!("{name}.png"),
            format!("{}, {}: {seen} objects show", stage.scene.name, view.name),
        );
        let whole = rgb(looked.whole);
        if let Some((lost_px, by, picture)) = looked.worst {
            let what = format!("{what}; {by} loses {lost_px} px, the most of all settings");
            report.compare(&file, &what, &whole, &rgb(picture))?;
        } else {
            let path = report.file(&file, &what);
            report.save(&path, &whole)?;
        }
    }
    // From there next to nothing is hidden.
    for view in views.iter().filter(|view| view.name == "above") {
        rests.push(rest::measure_rest(&mut stage, view, plan.rounds, progress)?);
    }
    for path in plan.paths() {
        measure_path(&mut stage, path, plan, progress, lines)?;
    }
    Ok(stage.offline.adapter())
}

/// How many objects show at each view, from a picture of their numbers.
fn seen_objects(scene: &Scene, size: UVec2) -> Result<Vec<usize>, AccuracyError> {
    let mut truth = SceneStage::new(scene.clone(), size, Look::Ids)?;
    let views = scene.views.iter().map(|view| {
        truth.look(view.transform);
        truth.cull(&Culling::Frustum);
        Ok(truth.seen()?.iter().filter(|px| **px > 0).count())
    });
    views.collect()
}

/// Pictures of a view.
#[derive(Default)]
struct Looked {
    /// The unculled one.
    whole: image::RgbaImage,
    /// Of the setting that loses most, if any loses a pixel: how many, its name, its picture.
    worst: Option<(u64, String, image::RgbaImage)>,
}

fn rgb(picture: image::RgbaImage) -> image::RgbImage {
    image::DynamicImage::ImageRgba8(picture).into_rgb8()
}

/// Measures one view with every setting.
fn measure_view(
    stage: &mut SceneStage,
    view: &View,
    seen: usize,
    settings: &[Culling],
    plan: &Plan,
    progress: &ProgressBar,
    lines: &mut Vec<OcclusionLine>,
) -> Result<Looked, AccuracyError> {
    let mut looked = Looked::default();
    stage.look(view.transform);
    let first = lines.len();
    let mut whole: Option<Frame> = None;
    for culling in settings {
        stage.cull(culling);
        let drawn = stage.drawn()?;
        let frame = stage.frame()?;
        let difference = frame.difference(whole.get_or_insert_with(|| frame.clone()));
        let most = looked.worst.as_ref().map_or(0, |(lost_px, ..)| *lost_px);
        if difference.lost_px > most {
            let name = Setting::of(culling).words();
            looked.worst = Some((difference.lost_px, name, frame.colour.clone()));
        }
        lines.push(OcclusionLine {
            objects: Objects {
                all: stage.scene.objects.len(),
                drawn: drawn as f64,
                seen: Some(seen),
            },
            error: OcclusionError {
                missed_culls: Some(drawn.saturating_sub(seen) as f64 / drawn.max(1) as f64),
                of_exact: exact::removable(stage, culling)?.and_then(exact::Removable::share),
                ..OcclusionError::of(difference)
            },
            frames: 1,
            ..line(stage, view.name, culling, plan)
        });
        progress.inc(1);
    }
    // Settings alternate, so that whatever else the machine does meets all of them alike.
    let mut times = vec![Vec::new(); settings.len()];
    let mut slow = vec![false; settings.len()];
    for _ in 0..plan.rounds {
        for (index, culling) in settings.iter().enumerate() {
            if slow[index] {
                continue;
            }
            stage.set_culling(culling);
            for _ in 0..WARM_FRAMES {
                stage.offline.step();
            }
            for _ in 0..TIMED_FRAMES {
                let start = Instant::now();
                stage.offline.step();
                let time_s = start.elapsed().as_secs_f64();
                times[index].push(1e3 * time_s);
                slow[index] |= time_s > SLOW_S;
                if slow[index] {
                    break;
                }
            }
            progress.inc(1);
        }
    }
    for (line, times) in lines[first..].iter_mut().zip(times) {
        line.time_ms = Timing::of(times);
    }
    looked.whole = whole.map(|frame| frame.colour).unwrap_or_default();
    Ok(looked)
}

/// Follows a path with every setting; the unculled frames are the reference.
fn measure_path(
    stage: &mut SceneStage,
    path: CameraPath,
    plan: &Plan,
    progress: &ProgressBar,
    lines: &mut Vec<OcclusionLine>,
) -> Result<(), AccuracyError> {
    // A long path's frames would fill the memory.
    let mut whole: Vec<PackedFrame> = Vec::new();
    for culling in plan.path_settings() {
        stage.set_frame(path, 0);
        stage.cull(&culling);
        let mut times = Vec::new();
        let mut drawn = 0;
        let mut error = OcclusionError::default();
        for frame in 0..plan.path_frames {
            stage.set_frame(path, frame);
            let start = Instant::now();
            stage.offline.step();
            times.push(1e3 * start.elapsed().as_secs_f64());
            drawn += stage.drawn()?;
            let drawn_now = stage.frame()?;
            match whole.get(frame as usize) {
                Some(whole) => error.add(drawn_now.difference(&whole.unpacked()?)),
                None => whole.push(drawn_now.packed()?),
            }
        }
        lines.push(OcclusionLine {
            time_ms: Timing::of(times),
            objects: Objects {
                all: stage.scene.objects.len(),
                drawn: drawn as f64 / f64::from(plan.path_frames),
                seen: None,
            },
            error,
            frames: plan.path_frames,
            ..line(stage, path.name(), &culling, plan)
        });
        progress.inc(1);
    }
    Ok(())
}

fn line(stage: &SceneStage, what: &str, culling: &Culling, plan: &Plan) -> OcclusionLine {
    OcclusionLine {
        effect: "occlusion",
        scene: format!("{}/{what}", stage.scene.name),
        setting: Setting::of(culling),
        time_ms: Timing::default(),
        objects: Objects::default(),
        error: OcclusionError::default(),
        frames: 0,
        size_px: plan.size.to_array(),
        adapter: stage.offline.adapter(),
    }
}
