//! The measured lines as plots and tables.

use bevy::math::UVec2;

use super::{
    super::report::{Table, optional, short},
    AccuracyError, OcclusionLine, Report,
};
use crate::offline::plot::{Axis, LinePlot, Series};

/// P2's Table 1: frames a second for 9, 100 and 1,000 objects, its read-back and OpenGL's (Pentium III 667,
/// GeForce3 Ti200).
const PAPER: [(&str, [f64; 3]); 2] = [
    ("P2", [21.7, 2.32, 0.26]),
    ("P2, OpenGL read-back", [7.8, 0.71, 0.07]),
];

/// The parts of `scene/view`.
pub(super) fn parts(line: &OcclusionLine) -> (&str, &str) {
    line.scene.split_once('/').unwrap_or((&line.scene, ""))
}

/// Values in the order of their first appearance.
pub(super) fn distinct<'a>(values: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut found: Vec<&str> = Vec::new();
    for value in values {
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}

pub(super) fn of<'a>(lines: &'a [OcclusionLine], scene: &str) -> Vec<&'a OcclusionLine> {
    lines.iter().filter(|line| line.scene == scene).collect()
}

/// Side of a block, of conservative samplings.
fn block(line: &OcclusionLine) -> Option<f64> {
    line.setting
        .block_px(UVec2::from_array(line.size_px))
        .map(f64::from)
}

pub(super) fn draw(report: &mut Report, lines: &[OcclusionLine]) -> Result<(), AccuracyError> {
    for scene in distinct(lines.iter().map(|line| line.scene.as_str())) {
        let lines = of(lines, scene);
        let blocks = distinct(lines.iter().filter_map(|l| l.setting.sampling.as_deref()));
        if blocks.len() < 4 {
            continue;
        }
        draw_blocks(report, scene, &lines, "ms", "time of a frame, ms", |line| {
            line.time_ms.median
        })?;
        draw_blocks(report, scene, &lines, "drawn", "objects drawn", |line| {
            line.objects.drawn
        })?;
    }
    draw_counts(report, lines)
}

/// A figure over the side of the blocks: a line for each volume, and one across for each other way to cull.
fn draw_blocks(
    report: &mut Report,
    scene: &str,
    lines: &[&OcclusionLine],
    stem: &str,
    label: &str,
    value: impl Fn(&OcclusionLine) -> f64,
) -> Result<(), AccuracyError> {
    let mut series = Vec::new();
    for volume in distinct(lines.iter().filter_map(|line| line.setting.volume)) {
        let points = lines
            .iter()
            .filter(|line| {
                line.setting.culling == "z-buffer"
                    && line.setting.volume == Some(volume)
                    && line.setting.recheck == Some("same-frame")
            })
            .filter_map(|line| Some((block(line)?, value(line))));
        series.push(Series {
            name: volume.to_owned(),
            points: points.collect(),
            quoted: false,
        });
    }
    let ends = lines.iter().filter_map(|line| block(line));
    let (low, high) = ends.fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
    for line in lines
        .iter()
        .filter(|line| line.setting.culling != "z-buffer")
    {
        series.push(Series {
            name: line.setting.culling.to_owned(),
            points: vec![(low, value(line)), (high, value(line))],
            quoted: true,
        });
    }
    let plot = LinePlot {
        title: format!("{scene}: {label}"),
        x: Axis::log("side of a block, px"),
        y: Axis::log(label),
        series,
    };
    let file = format!("{}_{stem}.png", scene.replace('/', "_"));
    let what =
        format!("{scene}: {label}, by volume and side of the blocks that depth is reduced to");
    plot.write(&report.file(&file, &what))?;
    Ok(())
}

/// P2's Table 1: frames a second over the number of models.
fn draw_counts(report: &mut Report, lines: &[OcclusionLine]) -> Result<(), AccuracyError> {
    let front: Vec<_> = lines
        .iter()
        .filter(|line| parts(line).1 == "front" && line.time_ms.median > 0.0)
        .collect();
    if distinct(front.iter().map(|line| line.scene.as_str())).len() < 2 {
        return Ok(());
    }
    let mut series: Vec<Series> = Vec::new();
    for line in front {
        let setting = &line.setting;
        if setting.volume.is_some() && !setting.is_default() {
            continue;
        }
        let name = setting.words();
        let point = (line.objects.all as f64, 1e3 / line.time_ms.median);
        match series.iter_mut().find(|series| series.name == name) {
            Some(series) => series.points.push(point),
            None => series.push(Series {
                name,
                points: vec![point],
                quoted: false,
            }),
        }
    }
    for (name, rates) in PAPER {
        series.push(Series {
            name: name.to_owned(),
            points: [9.0, 100.0, 1_000.0].into_iter().zip(rates).collect(),
            quoted: true,
        });
    }
    let plot = LinePlot {
        title: "Frames a second by number of models (P2, Table 1)".into(),
        x: Axis::log("models"),
        y: Axis::log("frames a second"),
        series,
    };
    plot.write(&report.file(
        "models.png",
        "Frames a second by number of models, as P2's Table 1",
    ))?;
    Ok(())
}

/// A table for each scene and view, or scene and path.
pub(super) fn tables(lines: &[OcclusionLine]) -> Vec<Table> {
    let share = |value: Option<f64>| value.map_or_else(|| "–".into(), short);
    let heads = [
        "culling",
        "ms",
        "min…max (runs)",
        "drawn",
        "of",
        "seen",
        "false cull px",
        "frames with",
        "of frames",
        "tied px",
        "missed culls",
        "of exact",
    ];
    let mut tables: Vec<Table> = Vec::new();
    for scene in distinct(lines.iter().map(|line| line.scene.as_str())) {
        let rows = of(lines, scene).into_iter().map(|line| {
            let (time, error) = (&line.time_ms, &line.error);
            vec![
                line.setting.words(),
                short(time.median),
                format!("{}…{} ({})", short(time.min), short(time.max), time.runs),
                short(line.objects.drawn),
                line.objects.all.to_string(),
                line.objects
                    .seen
                    .map_or_else(|| "–".into(), |seen| seen.to_string()),
                error.false_cull_px.to_string(),
                error.false_cull_frames.to_string(),
                line.frames.to_string(),
                error.tied_px.to_string(),
                share(error.missed_culls),
                share(error.of_exact),
            ]
        });
        tables.push((
            scene.to_owned(),
            heads.map(str::to_owned).to_vec(),
            rows.collect(),
        ));
    }
    tables
}

pub(super) fn csv(lines: &[OcclusionLine]) -> Table {
    let heads = [
        "effect",
        "scene",
        "culling",
        "volume",
        "sampling",
        "recheck",
        "time_ms_median",
        "time_ms_min",
        "time_ms_max",
        "time_ms_runs",
        "objects",
        "drawn",
        "seen",
        "false_cull_px",
        "false_cull_frames",
        "frames",
        "tied_px",
        "missed_culls",
        "of_exact",
        "width",
        "height",
        "adapter",
    ];
    let rows = lines.iter().map(|line| {
        let (setting, error) = (&line.setting, &line.error);
        vec![
            line.effect.to_owned(),
            line.scene.clone(),
            setting.culling.to_owned(),
            optional(setting.volume),
            optional(setting.sampling.as_ref()),
            optional(setting.recheck),
            line.time_ms.median.to_string(),
            line.time_ms.min.to_string(),
            line.time_ms.max.to_string(),
            line.time_ms.runs.to_string(),
            line.objects.all.to_string(),
            line.objects.drawn.to_string(),
            optional(line.objects.seen),
            error.false_cull_px.to_string(),
            error.false_cull_frames.to_string(),
            line.frames.to_string(),
            error.tied_px.to_string(),
            optional(error.missed_culls),
            optional(error.of_exact),
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
