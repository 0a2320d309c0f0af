//! The measured lines as plots, tables and highlights.

use serde_json::json;

use super::{
    super::report::{Report, Table, optional, short},
    AccuracyError, ContributionLine,
};
use crate::offline::plot::{Axis, LinePlot, Series};

/// Where a threshold of zero stands on an axis of powers of two. units: px²
const ZERO_PX2: f64 = 0.5;

fn is_tremble(line: &ContributionLine) -> bool {
    line.error.flicker_objects.is_some()
}

/// How depth was used, in words.
fn depth(line: &ContributionLine) -> &'static str {
    match (line.setting.occlusion, line.setting.weigh_by_visibility) {
        (false, _) => "no occlusion culling",
        (true, false) => "occlusion culling",
        (true, true) => "weighed by depth",
    }
}

/// Hysteresis, exit and depth, in words.
fn way(line: &ContributionLine) -> String {
    let setting = &line.setting;
    let words = format!("{} hysteresis {}", setting.exit, setting.hysteresis);
    match depth(line) {
        "no occlusion culling" => words,
        depth => format!("{words}, {depth}"),
    }
}

/// Values in the order of their first appearance.
fn distinct(values: impl Iterator<Item = String>) -> Vec<String> {
    let mut found = Vec::new();
    for value in values {
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}

fn scenes(lines: &[ContributionLine]) -> Vec<String> {
    distinct(lines.iter().map(|line| line.scene.clone()))
}

fn of<'a>(lines: &'a [ContributionLine], scene: &str) -> Vec<&'a ContributionLine> {
    lines.iter().filter(|line| line.scene == scene).collect()
}

pub(super) fn draw(report: &mut Report, lines: &[ContributionLine]) -> Result<(), AccuracyError> {
    for scene in scenes(lines) {
        let lines = of(lines, &scene);
        type Value = fn(&ContributionLine) -> f64;
        let views: [(&str, &str, Value); 4] = [
            ("ms", "time of a frame, ms", |line| line.time_ms.median),
            ("objects", "objects drawn", |line| line.drawn.objects),
            ("triangles", "triangles drawn", |line| line.drawn.triangles),
            ("flip", "mean FLIP error", |line| line.error.flip_mean),
        ];
        let trembles: [(&str, &str, Value); 2] = [
            (
                "flicker_objects",
                "objects that come or go, a frame",
                |line| line.error.flicker_objects.unwrap_or(0.0),
            ),
            (
                "flicker_px",
                "pixels that change sides, share a frame",
                |line| line.error.flicker_fraction.unwrap_or(0.0),
            ),
        ];
        let is_tremble = lines.iter().any(|line| is_tremble(line));
        let plots: &[_] = if is_tremble { &trembles } else { &views };
        for (stem, label, value) in plots {
            let name = |line: &ContributionLine| {
                if is_tremble {
                    way(line)
                } else {
                    depth(line).to_owned()
                }
            };
            // As many as can be told apart.
            let few = |line: &&&ContributionLine| !is_tremble || !line.setting.occlusion;
            let series = distinct(lines.iter().filter(few).map(|line| name(line)))
                .into_iter()
                .map(|series| Series {
                    points: lines
                        .iter()
                        .filter(|line| name(line) == series)
                        .map(|line| {
                            let threshold = f64::from(line.setting.threshold_px2);
                            (threshold.max(ZERO_PX2), value(line))
                        })
                        .collect(),
                    name: series,
                    quoted: false,
                })
                .collect();
            let plot = LinePlot {
                title: format!("{scene}: {label}"),
                x: Axis::log("threshold, px² (0 at 0.5)"),
                y: Axis::linear(*label),
                series,
            };
            let file = format!("{}_{stem}.png", scene.replace('/', "_"));
            plot.write(&report.file(&file, &format!("{scene}: {label}, by threshold")))?;
        }
    }
    Ok(())
}

pub(super) fn tables(lines: &[ContributionLine]) -> Vec<Table> {
    scenes(lines)
        .into_iter()
        .map(|scene| {
            let heads = [
                "threshold, px²",
                "hysteresis",
                "exit",
                "depth",
                "ms",
                "objects",
                "triangles",
                "FLIP",
                "changed pixels, %",
                "objects that flicker, a frame",
                "pixels that flicker, %",
            ];
            let rows = of(lines, &scene).into_iter().map(|line| {
                let (setting, error) = (&line.setting, &line.error);
                vec![
                    setting.threshold_px2.to_string(),
                    setting.hysteresis.to_string(),
                    setting.exit.to_owned(),
                    depth(line).to_owned(),
                    short(line.time_ms.median),
                    short(line.drawn.objects),
                    short(line.drawn.triangles),
                    short(error.flip_mean),
                    short(100.0 * error.changed_fraction),
                    optional(error.flicker_objects.map(short)),
                    optional(error.flicker_fraction.map(|share| short(100.0 * share))),
                ]
            });
            (
                scene.clone(),
                heads.map(str::to_owned).to_vec(),
                rows.collect(),
            )
        })
        .collect()
}

pub(super) fn csv(lines: &[ContributionLine]) -> Table {
    let heads = [
        "effect",
        "scene",
        "threshold_px2",
        "hysteresis",
        "exit",
        "occlusion",
        "weigh_by_visibility",
        "time_ms_median",
        "time_ms_min",
        "time_ms_max",
        "time_ms_runs",
        "objects",
        "triangles",
        "pixels",
        "flip_mean",
        "changed_fraction",
        "flicker_objects",
        "flicker_fraction",
        "frames",
        "width",
        "height",
        "adapter",
    ];
    let rows = lines.iter().map(|line| {
        let (setting, error) = (&line.setting, &line.error);
        vec![
            line.effect.to_owned(),
            line.scene.clone(),
            setting.threshold_px2.to_string(),
            setting.hysteresis.to_string(),
            setting.exit.to_owned(),
            setting.occlusion.to_string(),
            setting.weigh_by_visibility.to_string(),
            line.time_ms.median.to_string(),
            line.time_ms.min.to_string(),
            line.time_ms.max.to_string(),
            line.time_ms.runs.to_string(),
            line.drawn.objects.to_string(),
            line.drawn.triangles.to_string(),
            line.drawn.pixels.to_string(),
            error.flip_mean.to_string(),
            error.changed_fraction.to_string(),
            optional(error.flicker_objects),
            optional(error.flicker_fraction),
            line.frames.to_string(),
            line.size_px[0].to_string(),
            line.size_px[1].to_string(),
            line.adapter.clone(),
        ]
    });
    (
        String::new(),
        heads.map(str::to_owned).to_vec(),
        rows.collect(),
    )
}

/// Of each view, what a threshold of 16 px² saves and loses against the unculled picture; of each tremble, what its
/// hysteresis does about flicker at the same threshold or the one nearest to it.
pub(super) fn highlights(lines: &[ContributionLine]) -> serde_json::Value {
    let mut views = Vec::new();
    let mut trembles = Vec::new();
    for scene in scenes(lines) {
        let lines = of(lines, &scene);
        let Some(whole) = lines.first() else {
            continue;
        };
        if is_tremble(whole) {
            let nearest = lines
                .iter()
                .map(|line| line.setting.threshold_px2)
                .filter(|threshold| *threshold > 0.0)
                .min_by(|a, b| (a / 16.0).ln().abs().total_cmp(&(b / 16.0).ln().abs()));
            let at = lines
                .iter()
                .filter(|line| Some(line.setting.threshold_px2) == nearest);
            trembles.extend(at.map(|line| {
                json!({
                    "scene": scene,
                    "setting": line.setting,
                    "flicker_objects": line.error.flicker_objects,
                    "flicker_fraction": line.error.flicker_fraction,
                    "flip_mean": line.error.flip_mean,
                })
            }));
            continue;
        }
        let at = lines
            .iter()
            .find(|line| line.setting.threshold_px2 == 16.0 && !line.setting.occlusion);
        views.extend(at.map(|line| {
            let share = |part: f64, of: f64| part / of.max(1e-9);
            json!({
                "scene": scene,
                "threshold_px2": line.setting.threshold_px2,
                "time_share": share(line.time_ms.median, whole.time_ms.median),
                "objects_share": share(line.drawn.objects, whole.drawn.objects),
                "triangles_share": share(line.drawn.triangles, whole.drawn.triangles),
                "flip_mean": line.error.flip_mean,
                "changed_fraction": line.error.changed_fraction,
            })
        }));
    }
    json!({ "views": views, "trembles": trembles })
}
