//! The measured lines as plots, tables, pictures and highlights.

use serde_json::json;

use super::{
    super::report::{Report, Table, optional, short},
    AccuracyError, InteriorLine, Looked, Plan, Scene,
};
use crate::offline::plot::{Axis, LinePlot, Series};

/// P5a's table: model, grid, nodes, removed nodes, field and propagation. units: s
const P5A: [(&str, u32, usize, usize, f64, f64); 4] = [
    ("car, 3 M triangles", 128, 247, 175, 3.42, 0.05),
    ("car, 3 M triangles", 256, 247, 170, 6.59, 0.10),
    ("engine, 0.27 M triangles", 64, 7177, 5915, 1.85, 0.05),
    ("engine, 0.27 M triangles", 128, 7177, 4611, 4.26, 0.40),
];

fn scenes(lines: &[InteriorLine]) -> Vec<&str> {
    let mut scenes: Vec<&str> = lines.iter().map(|line| &*line.scene).collect();
    scenes.dedup();
    scenes
}

fn of<'a>(lines: &'a [InteriorLine], scene: &str) -> Vec<&'a InteriorLine> {
    lines.iter().filter(|line| line.scene == scene).collect()
}

pub(super) fn draw(report: &mut Report, lines: &[InteriorLine]) -> Result<(), AccuracyError> {
    type Value = fn(&InteriorLine) -> f64;
    let values: [(&str, &str, Value); 3] = [
        (
            "kept_hidden",
            "share of what stays that nobody sees",
            |line| line.error.kept_hidden,
        ),
        (
            "false_culls",
            "share of pixels that lack something",
            |line| line.error.false_cull_px as f64 / line.error.pixels.max(1) as f64,
        ),
        ("removed", "share of triangles that go", |line| {
            line.removed_triangles as f64 / line.triangles.max(1) as f64
        }),
    ];
    for scene in scenes(lines) {
        let lines = of(lines, scene);
        for (stem, label, value) in values {
            let series = super::Way::ALL.map(|way| Series {
                name: way.name().to_owned(),
                points: lines
                    .iter()
                    .filter(|line| line.setting.mode == way.name())
                    .map(|line| (line.time_ms.median, value(line)))
                    .collect(),
                quoted: false,
            });
            let plot = LinePlot {
                title: format!("{scene}: {label}"),
                x: Axis::log("time, ms (grids from coarse to fine)"),
                y: Axis::linear(label),
                series: series.into(),
            };
            let what = format!("{scene}: {label}, by time");
            plot.write(&report.file(&format!("{scene}_{stem}.png"), &what))?;
        }
    }
    Ok(())
}

/// The view of the whole in which a way misses most, as it is and with what lacks in red; for the default and the paper's way at the
/// coarsest grid.
pub(super) fn pictures(
    report: &mut Report,
    scene: &str,
    model: &Scene,
    looked: &Looked,
    plan: &Plan,
    name: &dyn Fn(usize) -> (&'static str, u32),
) -> Result<(), AccuracyError> {
    for (at, worst) in looked.worst.iter().enumerate() {
        let ((mode, grid), Some((missed, view))) = (name(at), worst) else {
            continue;
        };
        if Some(&grid) != plan.grids.first() || mode == "sampled" {
            continue;
        }
        let mut seen = vec![false; model.shown.len()];
        let picture = view.look(model.shown, model.missing, model.extent, &mut seen);
        let shaded = view.shade(model.shown, &picture, 1 << at);
        let what = format!(
            "{scene}, {mode} at {grid}: {missed} px lack something (red), the most of all views of the whole"
        );
        let path = report.file(&format!("{scene}_{mode}_{grid}.png"), &what);
        report.save(&path, &shaded)?;
    }
    Ok(())
}

const HEADS: [&str; 18] = [
    "mode",
    "grid",
    "ms",
    "snapping",
    "field",
    "front",
    "extraction",
    "nodes",
    "removed nodes",
    "%",
    "triangles",
    "removed triangles",
    "%",
    "false cull px",
    "through the gap",
    "views with",
    "kept hidden, %",
    "lattice, MiB",
];

fn row(line: &InteriorLine) -> Vec<String> {
    let percent = |part: usize, of: usize| short(100.0 * part as f64 / of.max(1) as f64);
    let error = &line.error;
    let mut row = vec![
        line.setting.mode.to_owned(),
        line.setting.resolution.to_string(),
        short(line.time_ms.median),
    ];
    row.extend(line.stages_ms.map(short));
    row.extend([
        line.nodes.to_string(),
        line.removed_nodes.to_string(),
        percent(line.removed_nodes, line.nodes),
        line.triangles.to_string(),
        line.removed_triangles.to_string(),
        percent(line.removed_triangles, line.triangles),
        error.false_cull_px.to_string(),
        optional(error.false_cull_px_in_gap),
        format!("{} of {}", error.views_with_false_culls, error.views),
        short(100.0 * error.kept_hidden),
        short(line.lattice_mib),
    ]);
    row
}

pub(super) fn tables(lines: &[InteriorLine]) -> Vec<Table> {
    let mut tables = vec![in_short(lines), against_p5a()];
    for scene in scenes(lines) {
        let rows = of(lines, scene).into_iter().map(row).collect();
        tables.push((scene.to_owned(), HEADS.map(str::to_owned).into(), rows));
    }
    tables
}

fn defaults(lines: &[InteriorLine]) -> impl Iterator<Item = &InteriorLine> {
    lines
        .iter()
        .filter(|line| line.setting.mode == "conservative")
}

fn in_short(lines: &[InteriorLine]) -> Table {
    let sum = |of: fn(&InteriorLine) -> u64| defaults(lines).map(of).sum::<u64>();
    let views: usize = defaults(lines).map(|line| line.error.views).sum();
    let row = |what: &str, value: String| vec![what.to_owned(), value];
    (
        "In short".to_owned(),
        vec!["what".to_owned(), "measured".to_owned()],
        vec![
            row(
                "Pixels that lack something seen through the gap, all rows of the default",
                format!(
                    "{} of {} in {views} views",
                    sum(|line| line.error.false_cull_px_in_gap.unwrap_or(0)),
                    sum(|line| line.error.pixels)
                ),
            ),
            row(
                "Pixels that lack something seen through anything, there",
                sum(|line| line.error.false_cull_px).to_string(),
            ),
        ],
    )
}

fn against_p5a() -> Table {
    let heads = [
        "P5a",
        "grid",
        "nodes",
        "removed",
        "%",
        "field, s",
        "propagation, s",
    ];
    let rows = P5A
        .iter()
        .map(|(model, grid, nodes, removed, field, front)| {
            vec![
                (*model).to_owned(),
                grid.to_string(),
                nodes.to_string(),
                removed.to_string(),
                short(100.0 * *removed as f64 / *nodes as f64),
                field.to_string(),
                front.to_string(),
            ]
        });
    (
        "P5a's table".to_owned(),
        heads.map(str::to_owned).into(),
        rows.collect(),
    )
}

pub(super) fn csv(lines: &[InteriorLine]) -> Table {
    let heads = [
        "scene",
        "mode",
        "resolution",
        "time_ms_median",
        "time_ms_min",
        "time_ms_max",
        "runs",
        "snapping_ms",
        "field_ms",
        "front_ms",
        "extraction_ms",
        "nodes",
        "removed_nodes",
        "triangles",
        "removed_triangles",
        "gap",
        "lattice_mib",
        "false_cull_px",
        "false_cull_px_in_gap",
        "pixels",
        "views_with_false_culls",
        "views",
        "kept_hidden",
        "kept_hidden_nodes",
        "known_hidden_kept",
        "adapter",
    ];
    let rows = lines.iter().map(|line| {
        let (time, error) = (&line.time_ms, &line.error);
        let mut row = vec![
            line.scene.clone(),
            line.setting.mode.to_owned(),
            line.setting.resolution.to_string(),
            time.median.to_string(),
            time.min.to_string(),
            time.max.to_string(),
            time.runs.to_string(),
        ];
        row.extend(line.stages_ms.map(|ms| ms.to_string()));
        row.extend([
            line.nodes.to_string(),
            line.removed_nodes.to_string(),
            line.triangles.to_string(),
            line.removed_triangles.to_string(),
            line.gap.to_string(),
            line.lattice_mib.to_string(),
            error.false_cull_px.to_string(),
            optional(error.false_cull_px_in_gap),
            error.pixels.to_string(),
            error.views_with_false_culls.to_string(),
            error.views.to_string(),
            error.kept_hidden.to_string(),
            error.kept_hidden_nodes.to_string(),
            optional(error.known_hidden_kept),
            line.adapter.clone(),
        ]);
        row
    });
    (
        "results".to_owned(),
        heads.map(str::to_owned).into(),
        rows.collect(),
    )
}

pub(super) fn highlights(lines: &[InteriorLine]) -> serde_json::Value {
    let of_default: Vec<_> = defaults(lines)
        .map(|line| {
            json!({
                "scene": line.scene,
                "resolution": line.setting.resolution,
                "field_s": line.stages_ms[1] / 1e3,
                "front_s": line.stages_ms[2] / 1e3,
                "removed_nodes": line.removed_nodes,
                "removed_triangles": line.removed_triangles,
                "false_cull_px": line.error.false_cull_px,
                "false_cull_px_in_gap": line.error.false_cull_px_in_gap,
                "kept_hidden": line.error.kept_hidden,
            })
        })
        .collect();
    json!({ "default": of_default })
}
