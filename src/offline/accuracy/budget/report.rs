//! The measured lines as plots, tables and highlights.

use serde_json::json;

use super::{
    super::report::{Report, Table, optional, short},
    AccuracyError, BudgetLine,
    measure::{Measured, Shown},
};
use crate::offline::{
    plot::{Axis, LinePlot, Series},
    workload::{Clock, Cost, Row},
};

/// Policies in the plots' order.
const POLICIES: [&str; 4] = ["budget", "polygons", "distance", "threshold"];

/// Lines of one path and clock.
type Group<'a> = (String, &'static str, Vec<&'a BudgetLine>);

fn groups(lines: &[BudgetLine]) -> Vec<Group<'_>> {
    let mut groups: Vec<Group> = Vec::new();
    for line in lines {
        let clock = line.setting.clock;
        match groups
            .iter_mut()
            .find(|group| group.0 == line.scene && group.1 == clock)
        {
            Some(group) => group.2.push(line),
            None => groups.push((line.scene.clone(), clock, vec![line])),
        }
    }
    groups
}

pub(super) fn draw(report: &mut Report, measured: &Measured) -> Result<(), AccuracyError> {
    for shown in &measured.shown {
        draw_frames(report, shown)?;
    }
    for (scene, clock, lines) in groups(&measured.lines) {
        type Value = fn(&BudgetLine) -> f64;
        let plots: [(&str, &str, Value); 2] = [
            ("std", "standard deviation of the frame time, ms", |line| {
                line.error.frame_ms_std
            }),
            ("flip", "mean FLIP error", |line| line.error.flip_mean),
        ];
        for (stem, label, value) in plots {
            let series = POLICIES.map(|policy| Series {
                name: policy.to_owned(),
                points: lines
                    .iter()
                    .filter(|line| line.setting.policy == policy)
                    .map(|line| (line.error.frame_ms_mean, value(line)))
                    .collect(),
                quoted: false,
            });
            let plot = LinePlot {
                title: format!("{scene}, {clock}: {label}"),
                x: Axis::linear("mean time of a frame, ms"),
                y: Axis::linear(label),
                series: series.to_vec(),
            };
            let file = format!("{}_{clock}_{stem}.png", scene.replace('/', "_"));
            let what = format!("{scene}, by the clock {clock}: {label}, over the mean");
            plot.write(&report.file(&file, &what))?;
        }
    }
    Ok(())
}

/// The time of each frame along the path, a line for each policy.
fn draw_frames(report: &mut Report, shown: &Shown) -> Result<(), AccuracyError> {
    let value = |row: &Row| match shown.clock {
        Clock::Time => row.measured.frame_ms,
        Clock::Counted => row.counted_ms,
    };
    let mut series: Vec<Series> = shown
        .runs
        .iter()
        .map(|run| Series {
            name: run.policy.to_string(),
            points: run
                .rows
                .iter()
                .map(|row| (row.parameter, value(row)))
                .collect(),
            quoted: false,
        })
        .collect();
    let ends = series
        .first()
        .and_then(|of| Some([of.points.first()?.0, of.points.last()?.0]));
    series.push(Series {
        name: "target".into(),
        points: ends
            .into_iter()
            .flatten()
            .map(|x| (x, shown.target_ms))
            .collect(),
        quoted: true,
    });
    let clock = shown.clock.name();
    let plot = LinePlot {
        title: format!("{}: time of a frame, {clock}", shown.scene),
        x: Axis::linear(shown.path.parameter_name().replace('_', " ")),
        y: Axis::linear("ms"),
        series,
    };
    let file = format!("{}_{clock}_frames.png", shown.scene.replace('/', "_"));
    let what = format!(
        "{}: time of each frame by the clock {clock}, target {} ms (P4, Fig. 6)",
        shown.scene,
        short(shown.target_ms)
    );
    plot.write(&report.file(&file, &what))?;
    Ok(())
}

pub(super) fn tables(lines: &[BudgetLine]) -> Vec<Table> {
    groups(lines)
        .into_iter()
        .map(|(scene, clock, lines)| {
            let heads = [
                "target, ms",
                "policy",
                "number",
                "mean, ms",
                "std, ms",
                "std, % of target",
                "over budget, %",
                "FLIP",
                "objects",
                "triangles",
                "measured median, ms",
            ];
            let rows = lines.into_iter().map(|line| {
                let (setting, error) = (&line.setting, &line.error);
                vec![
                    short(setting.target_ms),
                    setting.policy.to_owned(),
                    optional(setting.parameter.map(short)),
                    short(error.frame_ms_mean),
                    short(error.frame_ms_std),
                    short(100.0 * error.frame_ms_std / setting.target_ms),
                    short(100.0 * error.over_budget_fraction),
                    short(error.flip_mean),
                    short(line.drawn.objects),
                    short(line.drawn.triangles),
                    short(line.time_ms.median),
                ]
            });
            (
                format!("{scene}, by the clock `{clock}`"),
                heads.map(str::to_owned).to_vec(),
                rows.collect(),
            )
        })
        .collect()
}

pub(super) fn csv(lines: &[BudgetLine]) -> Table {
    let heads = [
        "effect",
        "scene",
        "policy",
        "parameter",
        "target_ms",
        "clock",
        "frame_ms_mean",
        "frame_ms_std",
        "over_budget_fraction",
        "flip_mean",
        "measured_ms_mean",
        "measured_ms_std",
        "measured_over_budget_fraction",
        "counted_ms_mean",
        "counted_ms_std",
        "counted_over_budget_fraction",
        "time_ms_median",
        "time_ms_min",
        "time_ms_max",
        "time_ms_runs",
        "objects",
        "triangles",
        "pixels",
        "frames",
        "width",
        "height",
        "adapter",
    ];
    let rows = lines.iter().map(|line| {
        let (setting, error) = (&line.setting, &line.error);
        let (measured, counted) = (&line.measured, &line.counted);
        vec![
            line.effect.to_owned(),
            line.scene.clone(),
            setting.policy.to_owned(),
            optional(setting.parameter),
            setting.target_ms.to_string(),
            setting.clock.to_owned(),
            error.frame_ms_mean.to_string(),
            error.frame_ms_std.to_string(),
            error.over_budget_fraction.to_string(),
            error.flip_mean.to_string(),
            measured.mean.to_string(),
            measured.std.to_string(),
            measured.over_budget_fraction.to_string(),
            counted.mean.to_string(),
            counted.std.to_string(),
            counted.over_budget_fraction.to_string(),
            line.time_ms.median.to_string(),
            line.time_ms.min.to_string(),
            line.time_ms.max.to_string(),
            line.time_ms.runs.to_string(),
            line.drawn.objects.to_string(),
            line.drawn.triangles.to_string(),
            line.drawn.pixels.to_string(),
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

/// For each path, clock and target: how the budget did, and its ratio to each baseline of the same mean counted time.
pub(super) fn highlights(lines: &[BudgetLine], cost: Cost, misfit: f64) -> serde_json::Value {
    let budgets = lines.iter().filter(|line| line.setting.policy == "budget");
    let held: Vec<_> = budgets
        .map(|budget| {
            let same = |line: &&BudgetLine| {
                line.scene == budget.scene
                    && line.setting.clock == budget.setting.clock
                    && line.setting.target_ms == budget.setting.target_ms
            };
            let against: serde_json::Map<_, _> = lines
                .iter()
                .filter(same)
                .filter(|line| line.setting.policy != "budget")
                .map(|line| {
                    let ratio = |of: f64, to: f64| (to > 0.0).then(|| of / to);
                    let ratios = json!({
                        "mean_ratio": ratio(budget.error.frame_ms_mean, line.error.frame_ms_mean),
                        "std_ratio": ratio(budget.error.frame_ms_std, line.error.frame_ms_std),
                        "flip_ratio": ratio(budget.error.flip_mean, line.error.flip_mean),
                    });
                    (line.setting.policy.to_owned(), ratios)
                })
                .collect();
            let (error, target_ms) = (&budget.error, budget.setting.target_ms);
            json!({
                "scene": budget.scene,
                "clock": budget.setting.clock,
                "target_ms": target_ms,
                "mean_of_target": error.frame_ms_mean / target_ms,
                "std_of_target": error.frame_ms_std / target_ms,
                "over_budget_fraction": error.over_budget_fraction,
                "flip_mean": error.flip_mean,
                "budget_to": against,
            })
        })
        .collect();
    json!({ "held": held, "cost": cost, "cost_misfit": misfit })
}
