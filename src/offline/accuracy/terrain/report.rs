//! The measured lines as plots, heat maps and tables.

use super::*;

/// P1's name of a traversal.
pub(super) fn letter(traversal: Traversal) -> &'static str {
    match traversal {
        Traversal::PerTexel => "B per-texel",
        Traversal::MaxMip => "C max-mip",
        Traversal::Boxes => "A boxes",
        Traversal::Hybrid => "hybrid",
    }
}

pub(super) fn words(setting: &Setting) -> String {
    match setting.box_texels {
        Some(texels) => format!(
            "{} {texels}, {} px",
            setting.traversal, setting.max_error_px
        ),
        None => format!("{}, {} px", setting.traversal, setting.max_error_px),
    }
}

/// Ratios of one box size: A:B, A:C, hybrid:B, hybrid:C; how many times the first is cheaper.
struct Ratios {
    texels: u32,
    by_time: [Option<f64>; 4],
    by_reads: [Option<f64>; 4],
}

fn find<'a>(
    lines: &[&'a TerrainLine],
    traversal: Traversal,
    texels: Option<u32>,
    error: Option<f32>,
) -> Option<&'a TerrainLine> {
    lines.iter().copied().find(|line| {
        line.casting.traversal == traversal
            && texels.is_none_or(|texels| line.casting.box_texels == texels)
            && error.is_none_or(|error| line.casting.max_error_px == error)
    })
}

fn ratios(lines: &[&TerrainLine]) -> Vec<Ratios> {
    let b = find(lines, Traversal::PerTexel, None, None);
    let c = find(lines, Traversal::MaxMip, None, Some(MAX_ERROR_PX));
    let mut texels: Vec<u32> = lines
        .iter()
        .filter_map(|line| line.setting.box_texels)
        .collect();
    texels.sort_unstable();
    texels.dedup();
    texels
        .into_iter()
        .map(|texels| {
            let of = |value: fn(&TerrainLine) -> f64| {
                let ratio = |slow: Option<&TerrainLine>, quick: Traversal| {
                    let quick = value(find(lines, quick, Some(texels), Some(MAX_ERROR_PX))?);
                    (quick > 0.0).then_some(value(slow?) / quick)
                };
                [
                    ratio(b, Traversal::Boxes),
                    ratio(c, Traversal::Boxes),
                    ratio(b, Traversal::Hybrid),
                    ratio(c, Traversal::Hybrid),
                ]
            };
            Ratios {
                texels,
                by_time: of(|line| line.time_ms.median),
                by_reads: of(|line| line.reads.mean),
            }
        })
        .collect()
}

const RATIO_NAMES: [&str; 4] = ["A:B", "A:C", "hybrid:B", "hybrid:C"];

pub(super) fn draw(
    report: &mut Report,
    view: &View,
    size: UVec2,
    measured: &Measured,
) -> Result<(), AccuracyError> {
    let lines: Vec<_> = measured.lines.iter().collect();
    let file = format!("picture_{}.png", view.name);
    if let Some((setting, picture)) = &measured.coarsest {
        let what = format!("{}: {setting}", view.what);
        report.compare(&file, &what, &measured.exact, picture)?;
    } else {
        let path = report.file(&file, &format!("The exact picture, {}", view.what));
        report.save(&path, &measured.exact)?;
    }
    let panels: Vec<_> = measured
        .heat
        .iter()
        .map(|(title, values)| HeatPanel {
            title: title.clone(),
            values,
        })
        .collect();
    let path = report.file(
        &format!("reads_{}.png", view.name),
        &format!(
            "Nodes and cells read for each pixel, {} (as P1, Fig. 8); boxes of {BOX_TEXELS} texels, \
             {MAX_ERROR_PX} px allowed, B exact",
            view.what
        ),
    );
    let title = format!("Reads per pixel, {}", view.what);
    write_heat_maps(
        &path,
        &title,
        "reads per pixel, one scale for all",
        size,
        &panels,
    )?;

    for (file, what, by_time) in [
        ("ratio_time", "time", true),
        ("ratio_reads", "reads", false),
    ] {
        let ratios = ratios(&lines);
        let mut series: Vec<Series> = RATIO_NAMES
            .iter()
            .enumerate()
            .map(|(index, name)| Series {
                name: (*name).into(),
                points: ratios
                    .iter()
                    .filter_map(|ratios| {
                        let value = if by_time {
                            ratios.by_time
                        } else {
                            ratios.by_reads
                        }[index]?;
                        Some((f64::from(ratios.texels), value))
                    })
                    .collect(),
                quoted: false,
            })
            .collect();
        if by_time {
            let paper = |name: &str, pick: fn(&(u32, f64, f64)) -> f64| Series {
                name: name.into(),
                points: PAPER
                    .iter()
                    .map(|row| (f64::from(row.0), pick(row)))
                    .collect(),
                quoted: true,
            };
            series.push(paper("A:B in P1", |row| row.1));
            series.push(paper("A:C in P1", |row| row.2));
        }
        let path = report.file(
            &format!("{file}_{}.png", view.name),
            &format!(
                "How many times cheaper by {what}, against box size, {} (as P1, Table 1)",
                view.what
            ),
        );
        LinePlot {
            title: format!("Times cheaper by {what}, {}", view.what),
            x: Axis::log("box size, texels a side"),
            y: Axis::log("ratio"),
            series,
        }
        .write(&path)?;
    }

    let at_error = |traversal: Traversal| {
        let mut points: Vec<(f64, f64)> = lines
            .iter()
            .filter(|line| {
                line.casting.traversal == traversal && line.casting.box_texels == BOX_TEXELS
            })
            .map(|line| (line.error.depth_error_px_p999, line.time_ms.median))
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Series {
            name: letter(traversal).into(),
            points,
            quoted: false,
        }
    };
    let path = report.file(
        &format!("time_error_{}.png", view.name),
        &format!(
            "Time against measured error for every max_error_px, {}",
            view.what
        ),
    );
    LinePlot {
        title: format!("Time against error, {}", view.what),
        x: Axis::linear("distance from the exact surface, 99.9 % of pixels below, px"),
        y: Axis::log("ms"),
        series: vec![
            at_error(Traversal::MaxMip),
            at_error(Traversal::Boxes),
            at_error(Traversal::Hybrid),
        ],
    }
    .write(&path)?;
    Ok(())
}

pub(super) fn view_tables(view: &View, lines: &[&TerrainLine]) -> Vec<Table> {
    let heads = |names: &[&str]| {
        names
            .iter()
            .map(|name| (*name).to_owned())
            .collect::<Vec<_>>()
    };
    let number = |value: Option<f64>| value.map_or_else(|| "–".into(), short);
    let ratio_rows = ratios(lines)
        .into_iter()
        .map(|ratios| {
            let paper = PAPER.iter().find(|row| row.0 == ratios.texels);
            let mut row = vec![format!("{}²", ratios.texels)];
            row.extend(ratios.by_time.map(number));
            row.extend(ratios.by_reads.map(number));
            row.push(number(paper.map(|row| row.1)));
            row.push(number(paper.map(|row| row.2)));
            row
        })
        .collect();
    let setting_rows = lines
        .iter()
        .map(|line| {
            let error = &line.error;
            let pass = |pass: &str| number(line.pass_ms.get(pass).copied());
            let mut row = vec![
                line.setting.traversal.to_owned(),
                line.setting
                    .box_texels
                    .map_or_else(|| "–".into(), |texels| texels.to_string()),
                line.setting.max_error_px.to_string(),
                short(line.time_ms.median),
                format!(
                    "{}…{} ({})",
                    short(line.time_ms.min),
                    short(line.time_ms.max),
                    line.time_ms.runs
                ),
            ];
            row.extend(CAST_PASSES.map(pass));
            row.extend([
                short(line.reads.mean),
                line.reads.p99.to_string(),
                line.reads.max.to_string(),
                line.boxes
                    .map_or_else(|| "–".into(), |boxes| boxes.to_string()),
                error.coverage_errors_px.to_string(),
                short(error.silhouette_px_max),
                short(error.depth_error_px_p999),
                short(error.depth_error_px_max),
                short(error.flip_mean),
            ]);
            row
        })
        .collect();
    vec![
        (
            format!(
                "P1's Table 1, view {}: times cheaper, {MAX_ERROR_PX} px allowed (B exact)",
                view.what
            ),
            heads(&[
                "τ",
                "A:B time",
                "A:C time",
                "hybrid:B time",
                "hybrid:C time",
                "A:B reads",
                "A:C reads",
                "hybrid:B reads",
                "hybrid:C reads",
                "A:B in P1",
                "A:C in P1",
            ]),
            ratio_rows,
        ),
        (
            format!("Every setting, view {}", view.what),
            heads(&[
                "traversal",
                "box_texels",
                "max_error_px",
                "ms",
                "min…max (runs)",
                "subdivide",
                "box_entry",
                "beam",
                "ray_cast",
                "reads",
                "reads p99",
                "reads max",
                "boxes",
                "coverage errors px",
                "silhouette px max",
                "depth error px p99.9",
                "depth error px max",
                "FLIP mean",
            ]),
            setting_rows,
        ),
    ]
}

pub(super) fn csv(lines: &[TerrainLine]) -> Table {
    let mut heads: Vec<String> = [
        "effect",
        "scene",
        "traversal",
        "box_texels",
        "max_error_px",
        "time_ms_median",
        "time_ms_min",
        "time_ms_max",
        "time_ms_runs",
    ]
    .map(str::to_owned)
    .to_vec();
    heads.extend(CAST_PASSES.map(|pass| format!("{pass}_ms")));
    heads.extend(
        [
            "reads_mean",
            "reads_p99",
            "reads_max",
            "boxes",
            "coverage_errors_px",
            "silhouette_px_max",
            "depth_error_px_p999",
            "depth_error_px_max",
            "flip_mean",
            "width_px",
            "height_px",
            "adapter",
        ]
        .map(str::to_owned),
    );
    let optional = |value: Option<String>| value.unwrap_or_default();
    let rows = lines.iter().map(|line| {
        let mut row = vec![
            line.effect.to_owned(),
            line.scene.clone(),
            line.setting.traversal.to_owned(),
            optional(line.setting.box_texels.map(|texels| texels.to_string())),
            line.setting.max_error_px.to_string(),
            line.time_ms.median.to_string(),
            line.time_ms.min.to_string(),
            line.time_ms.max.to_string(),
            line.time_ms.runs.to_string(),
        ];
        row.extend(CAST_PASSES.map(|pass| optional(line.pass_ms.get(pass).map(f64::to_string))));
        let error = &line.error;
        row.extend([
            line.reads.mean.to_string(),
            line.reads.p99.to_string(),
            line.reads.max.to_string(),
            optional(line.boxes.map(|boxes| boxes.to_string())),
            error.coverage_errors_px.to_string(),
            error.silhouette_px_max.to_string(),
            error.depth_error_px_p999.to_string(),
            error.depth_error_px_max.to_string(),
            error.flip_mean.to_string(),
            line.size_px[0].to_string(),
            line.size_px[1].to_string(),
            line.adapter.clone(),
        ]);
        row
    });
    (String::new(), heads, rows.collect())
}

pub(super) fn highlights(views: &[View], lines: &[TerrainLine]) -> serde_json::Value {
    let of_view = |view: &View| {
        let lines: Vec<_> = lines.iter().filter(|line| line.view == view.name).collect();
        let best = |index: usize, by_time: bool| {
            ratios(&lines)
                .iter()
                .filter_map(|r| {
                    let value = if by_time { r.by_time } else { r.by_reads }[index]?;
                    Some((r.texels, value))
                })
                .max_by(|a, b| a.1.total_cmp(&b.1))
                .map(|(texels, value)| serde_json::json!({"box_texels": texels, "ratio": value}))
        };
        let named = |by_time| {
            RATIO_NAMES
                .iter()
                .enumerate()
                .map(|(index, name)| ((*name).to_owned(), best(index, by_time).into()))
                .collect::<serde_json::Map<_, _>>()
        };
        serde_json::json!({ "best_by_time": named(true), "best_by_reads": named(false) })
    };
    views
        .iter()
        .map(|view| (view.name.to_owned(), of_view(view)))
        .collect::<serde_json::Map<_, _>>()
        .into()
}
