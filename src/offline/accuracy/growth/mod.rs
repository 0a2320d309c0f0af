//! `skyline accuracy growth`: by which power of a scene's size each effect's cost grows.
//!
//! Each effect is measured over at least a factor of 64 in what it has to do with: samples of ground, objects,
//! triangles, cells, lights, views. Everything else stays as it is. The power is that of a least-squares line through
//! logarithms ([`Fit`]), of all sizes and of the larger half of them, where what is constant weighs least.

mod fit;
mod ground;
mod meshes;
mod objects;

use std::path::Path;

use indicatif::ProgressBar;
use serde::Serialize;
use serde_json::json;

use super::{AccuracyError, Found, Report, Summary, Table, Timing, report::short};
use crate::offline::{
    plot::{Axis, LinePlot, Series},
    spinner,
};

pub use fit::Fit;

/// What to measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Smaller sizes and fewer rounds.
    pub quick: bool,
}

impl Plan {
    /// Sizes that scenes have.
    pub fn full() -> Self {
        Self { quick: false }
    }

    /// A minute or two on two cores without a GPU.
    pub fn quick() -> Self {
        Self { quick: true }
    }

    fn rounds(self) -> usize {
        if self.quick { 3 } else { 9 }
    }
}

/// One line of `results.jsonl`.
#[derive(Serialize, Clone, Debug)]
pub struct GrowthLine {
    /// Always `growth`.
    pub effect: &'static str,
    /// The effect and what there is more and more of.
    pub scene: String,
    /// The way it works.
    pub setting: Way,
    /// How many.
    pub size: f64,
    /// What it took. units: ms
    pub time_ms: Timing,
    /// What did it.
    pub adapter: String,
}

/// A way to work.
#[derive(Serialize, Clone, Debug, PartialEq)]
pub struct Way {
    /// In words.
    pub way: String,
}

/// The cost of one effect against one size.
struct Curve {
    effect: &'static str,
    /// What there is more and more of.
    of: &'static str,
    /// What is timed, or how it is done.
    way: String,
    /// Sizes, ascending, and what each took.
    points: Vec<(f64, Timing)>,
    adapter: String,
}

impl Curve {
    fn medians(&self) -> Vec<(f64, f64)> {
        self.points
            .iter()
            .map(|(size, ms)| (*size, ms.median))
            .collect()
    }

    fn scene(&self) -> String {
        format!("{}, {}", self.effect, self.of)
    }

    fn row(&self) -> Vec<String> {
        let medians = self.medians();
        let power =
            |fit: Option<Fit>| fit.map_or_else(String::new, |fit| format!("{:.2}", fit.exponent));
        let end = |end: Option<&(f64, f64)>| end.copied().unwrap_or_default();
        let ((from, least), (to, most)) = (end(medians.first()), end(medians.last()));
        vec![
            self.effect.to_owned(),
            self.way.clone(),
            self.of.to_owned(),
            format!("{} … {}", short(from), short(to)),
            short(least),
            short(most),
            power(Fit::of(&medians)),
            power(Fit::of_larger(&medians)),
        ]
    }
}

const HEADS: [&str; 8] = [
    "effect",
    "what",
    "of",
    "sizes",
    "ms of the least",
    "ms of the most",
    "power",
    "of the larger half",
];

/// Measures every effect at its sizes and writes everything to a directory.
///
/// # Errors
/// [`AccuracyError`].
pub fn measure(plan: &Plan, out: &Path) -> Result<Summary, AccuracyError> {
    let mut report = Report::new(out, "growth")?;
    let progress = spinner();
    let mut curves = Vec::new();
    type Measure = fn(Plan, &ProgressBar, &mut Vec<Curve>) -> Result<(), AccuracyError>;
    let all: [Measure; 7] = [
        ground::terrain,
        ground::shadow,
        objects::occlusion,
        objects::contribution,
        objects::budget,
        meshes::interior,
        meshes::spherical,
    ];
    for measure in all {
        measure(*plan, &progress, &mut curves)?;
    }
    progress.finish_and_clear();
    draw(&mut report, &curves)?;
    let lines: Vec<GrowthLine> = curves
        .iter()
        .flat_map(|curve| {
            curve.points.iter().map(|(size, time_ms)| GrowthLine {
                effect: "growth",
                scene: curve.scene(),
                setting: Way {
                    way: curve.way.clone(),
                },
                size: *size,
                time_ms: *time_ms,
                adapter: curve.adapter.clone(),
            })
        })
        .collect();
    report.results(&lines)?;
    let table: Table = (
        "By which power of its size each effect's cost grows".to_owned(),
        HEADS.map(str::to_owned).into(),
        curves.iter().map(Curve::row).collect(),
    );
    let sizes: Table = (
        "results".to_owned(),
        [
            "scene",
            "way",
            "size",
            "time_ms_median",
            "time_ms_min",
            "time_ms_max",
            "runs",
            "adapter",
        ]
        .map(str::to_owned)
        .into(),
        lines
            .iter()
            .map(|line| {
                let ms = line.time_ms;
                vec![
                    line.scene.clone(),
                    line.setting.way.clone(),
                    line.size.to_string(),
                    ms.median.to_string(),
                    ms.min.to_string(),
                    ms.max.to_string(),
                    ms.runs.to_string(),
                    line.adapter.clone(),
                ]
            })
            .collect(),
    );
    report.csv(&sizes)?;
    let adapter = curves
        .first()
        .map_or_else(String::new, |curve| curve.adapter.clone());
    let head = format!(
        "{adapter}; medians of {} rounds; a power of 0 is constant, 1 linear in size.",
        plan.rounds()
    );
    report.finish(Found {
        title: "How cost grows with size",
        head: &head,
        tables: &[table],
        clock: "the wall clock, of the pass or the system",
        adapter,
        results: lines.len(),
        highlights: curves
            .iter()
            .map(|curve| {
                let medians = curve.medians();
                json!({
                    "scene": curve.scene(),
                    "way": curve.way,
                    "fit": Fit::of(&medians),
                    "of_larger_half": Fit::of_larger(&medians),
                })
            })
            .collect(),
    })
}

/// A plot for each effect and size.
fn draw(report: &mut Report, curves: &[Curve]) -> Result<(), AccuracyError> {
    let mut scenes: Vec<String> = curves.iter().map(Curve::scene).collect();
    scenes.dedup();
    for scene in scenes {
        let of_scene = || curves.iter().filter(|curve| curve.scene() == scene);
        let Some(first) = of_scene().next() else {
            continue;
        };
        let series = of_scene().map(|curve| {
            let medians = curve.medians();
            let power = Fit::of(&medians)
                .map_or_else(String::new, |fit| format!(": power {:.2}", fit.exponent));
            Series {
                name: format!("{}{power}", curve.way),
                points: medians,
                quoted: false,
            }
        });
        let plot = LinePlot {
            title: format!("Cost against size: {scene}"),
            x: Axis::log(first.of),
            y: Axis::log("ms"),
            series: series.collect(),
        };
        let file = format!("{}.png", scene.replace([' ', ','], "_"));
        plot.write(&report.file(&file, &format!("Time against size: {scene}")))?;
    }
    Ok(())
}
