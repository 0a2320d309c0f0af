//! The frames as a table and as a plot.

use std::{fmt::Write, path::Path};

use super::{Clock, Plan, Row, Run, WorkloadError};
use crate::offline::plot::{Axis, LinePlot, PlotError, Series, write_stacked};

/// Makes sure that a file can be written, without leaving one where there was none.
pub(super) fn check(path: &Path) -> Result<(), WorkloadError> {
    let is_new = !path.exists();
    std::fs::OpenOptions::new()
        .append(true)
        .create(true)
        .open(path)
        .map_err(|error| WorkloadError::Write {
            path: path.to_owned(),
            reason: error.to_string(),
        })?;
    if is_new {
        // What could be made can be made again.
        let _ = std::fs::remove_file(path);
    }
    Ok(())
}

/// Writes a file.
pub(super) fn write(path: &Path, text: &str) -> Result<(), WorkloadError> {
    std::fs::write(path, text).map_err(|error| WorkloadError::Write {
        path: path.to_owned(),
        reason: error.to_string(),
    })
}

/// One row a frame, under a row of heads.
pub(super) fn csv(runs: &[Run]) -> String {
    let mut text = String::from(
        "policy,frame,parameter,polygons,objects,pixels,frame_ms,counted_ms,threshold_px2,knobs\n",
    );
    for run in runs {
        for row in &run.rows {
            let Row {
                frame,
                parameter,
                measured,
                counted_ms,
            } = row;
            let drawn = measured.drawn;
            let _ = writeln!(
                text,
                "{},{frame},{parameter},{},{},{:.0},{:.4},{counted_ms:.4},{},{}",
                run.policy,
                drawn.triangles,
                drawn.objects,
                drawn.pixels,
                measured.frame_ms,
                measured.threshold_px2,
                measured.knobs,
            );
        }
    }
    text
}

/// Polygons, measured and counted time along the path, a line each for every policy.
pub(super) fn draw(path: &Path, scene: &str, plan: &Plan, runs: &[Run]) -> Result<(), PlotError> {
    write_stacked(path, &plots(scene, plan, runs))
}

fn plots(scene: &str, plan: &Plan, runs: &[Run]) -> [LinePlot; 3] {
    let x = || Axis::linear(plan.path.parameter_name().replace('_', " "));
    let lines = |value: &dyn Fn(&Row) -> f64| -> Vec<Series> {
        runs.iter()
            .map(|run| Series {
                name: run.policy.to_string(),
                points: run
                    .rows
                    .iter()
                    .map(|row| (row.parameter, value(row)))
                    .collect(),
                quoted: false,
            })
            .collect()
    };
    let timed = |mut series: Vec<Series>, clock: Clock| {
        let ends = runs.first().map(|run| (run.rows.first(), run.rows.last()));
        if let Some((Some(first), Some(last))) = ends {
            let held = if clock == plan.clock { ", held" } else { "" };
            series.push(Series {
                name: format!("target{held}"),
                points: [first, last]
                    .map(|row| (row.parameter, plan.target_ms))
                    .to_vec(),
                quoted: true,
            });
        }
        series
    };
    [
        LinePlot {
            title: format!("{scene}, {}: triangles drawn", plan.path.name()),
            x: x(),
            // Some policy may draw nothing at all.
            y: Axis::log("triangles"),
            series: lines(&|row| row.measured.drawn.triangles.max(1.0)),
        },
        LinePlot {
            title: "time of a frame, measured".into(),
            x: x(),
            y: Axis::log("ms"),
            series: timed(lines(&|row| row.measured.frame_ms), Clock::Time),
        },
        LinePlot {
            title: "time of a frame, counted by what was drawn".into(),
            x: x(),
            y: Axis::log("ms"),
            series: timed(lines(&|row| row.counted_ms), Clock::Counted),
        },
    ]
}

#[cfg(test)]
mod tests {
    use bevy::math::UVec2;

    use super::*;
    use crate::offline::workload::{Drawn, Measured, Policies, Policy, WorkloadPath};

    fn run(policy: Policy, frames: u32) -> Run {
        let row = |frame| Row {
            frame,
            parameter: 2.5 * f64::from(frame),
            measured: Measured {
                frame_ms: 7.0,
                drawn: Drawn {
                    objects: 3.0,
                    triangles: 1_234.0,
                    pixels: 99.6,
                },
                threshold_px2: 1.5,
                knobs: "a=1;b=2".into(),
            },
            counted_ms: 6.5,
        };
        Run {
            policy,
            rows: (0..frames).map(row).collect(),
        }
    }

    #[test]
    fn every_frame_has_a_row_with_as_many_cells_as_heads() {
        let text = csv(&[run(Policy::Frustum, 3), run(Policy::Polygons(9), 2)]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 1 + 5);
        for line in &lines {
            assert_eq!(line.split(',').count(), 10, "{line}");
        }
        assert_eq!(
            lines[5],
            "polygons:9,1,2.5,1234,3,100,7.0000,6.5000,1.5,a=1;b=2"
        );
    }

    #[test]
    fn all_policies_and_the_target_are_in_the_plots() {
        let plan = Plan {
            path: WorkloadPath::Rotate,
            frames: 4,
            target_ms: 8.0,
            policies: Policies::All,
            clock: Clock::Counted,
            cost: None,
            size: UVec2::new(8, 8),
            city: None,
            occludes: false,
            quick: true,
        };
        let runs = [run(Policy::None, 4), run(Policy::Budget, 4)];
        let [polygons, time, counted] = plots("city", &plan, &runs);
        assert_eq!(polygons.series.len(), 2);
        assert_eq!((time.series.len(), counted.series.len()), (3, 3));
        assert_eq!(time.series[2].name, "target");
        assert_eq!(counted.series[2].name, "target, held");
        assert_eq!(counted.series[2].points, [(0.0, 8.0), (7.5, 8.0)]);
    }
}
