//! `skyline accuracy terrain`: P1's Table 1 and Fig. 8 for the four traversals, and what `max_error_px` buys.

mod report;

use std::{collections::BTreeMap, path::Path};

use bevy::{math::UVec2, platform::time::Instant, prelude::*};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::{
    AccuracyError, Found, Report, Summary, Timing,
    difference::TerrainError,
    percentile,
    report::{Table, short},
    scene::{View, views},
};
use crate::{
    offline::{
        HitImage, OfflineError,
        plot::{Axis, HeatPanel, LinePlot, Series, write_heat_maps},
        render::{CAST_PASSES, Clock, Shot, Stage},
        traversal_name,
    },
    reference::ray_cast::Twin,
    terrain::{HeightField, TerrainRayCasting, Traversal},
};

use report::{csv, draw, highlights, letter, view_tables, words};

/// Side of boxes where the sweep is over something else, and error where the sweep is over boxes.
const BOX_TEXELS: u32 = 16;
const MAX_ERROR_PX: f32 = 0.5;
/// Beyond this, a setting is measured once. units: s
const SLOW_S: f64 = 4.0;
/// Frames until the box list has found its size.
const BOX_FRAMES: usize = 6;

/// What P1 reports for box sizes 4…4096: A:B and A:C (Table 1; Radeon HD 5870, 1600×900, Puget Sound 4096²).
const PAPER: [(u32, f64, f64); 11] = [
    (4, 8.0, 0.89),
    (8, 29.0, 3.22),
    (16, 42.5, 4.72),
    (32, 26.0, 2.89),
    (64, 15.5, 1.72),
    (128, 11.0, 1.22),
    (256, 9.5, 1.07),
    (512, 5.0, 0.55),
    (1024, 3.0, 0.33),
    (2048, 1.5, 0.16),
    (4096, 1.0, 0.11),
];

/// What to measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Size of the pictures. units: px
    pub size: UVec2,
    /// Few settings and few rounds.
    pub quick: bool,
}

impl Plan {
    /// P1's picture size and every setting.
    pub fn full() -> Self {
        Self {
            size: UVec2::new(1600, 900),
            quick: false,
        }
    }

    /// Seconds rather than minutes.
    pub fn quick() -> Self {
        Self {
            size: UVec2::new(320, 180),
            quick: true,
        }
    }

    fn rounds(&self) -> usize {
        if self.quick { 2 } else { 5 }
    }

    fn errors_px(&self) -> &'static [f32] {
        if self.quick {
            &[0.0, MAX_ERROR_PX, 2.0]
        } else {
            &[0.0, MAX_ERROR_PX, 1.0, 2.0, 4.0]
        }
    }

    /// Box sizes up to the one that holds the whole field.
    fn boxes(&self, field: &HeightField) -> Vec<u32> {
        let whole = field.cells().max_element().next_power_of_two().max(4);
        let all = PAPER
            .iter()
            .map(|(texels, ..)| *texels)
            .filter(|texels| *texels <= whole);
        all.filter(|texels| !self.quick || [4, 16, 64].contains(texels))
            .collect()
    }

    /// Every setting to measure, the exact one first.
    fn settings(&self, field: &HeightField) -> Vec<TerrainRayCasting> {
        let cast = |traversal, box_texels, max_error_px| TerrainRayCasting {
            traversal,
            box_texels,
            max_error_px,
        };
        let mut settings = vec![cast(Traversal::MaxMip, BOX_TEXELS, 0.0)];
        settings.push(cast(Traversal::PerTexel, BOX_TEXELS, 0.0));
        for &error in &self.errors_px()[1..] {
            settings.push(cast(Traversal::MaxMip, BOX_TEXELS, error));
        }
        for traversal in [Traversal::Boxes, Traversal::Hybrid] {
            for texels in self.boxes(field) {
                settings.push(cast(traversal, texels, MAX_ERROR_PX));
            }
            for &error in self.errors_px() {
                settings.push(cast(traversal, BOX_TEXELS, error));
            }
        }
        let mut unique: Vec<TerrainRayCasting> = Vec::new();
        for setting in settings {
            if !unique.contains(&setting) {
                unique.push(setting);
            }
        }
        unique
    }
}

/// One line of `results.jsonl`.
#[derive(Serialize, Clone, Debug)]
pub struct TerrainLine {
    /// Always `terrain`.
    pub effect: &'static str,
    /// Field and view.
    pub scene: String,
    /// What was set.
    pub setting: Setting,
    /// All passes that find where rays hit. units: ms
    pub time_ms: Timing,
    /// Median of each. units: ms
    pub pass_ms: BTreeMap<&'static str, f64>,
    /// Nodes and cells read for each pixel.
    pub reads: Reads,
    /// Boxes of the subdivision.
    pub boxes: Option<u64>,
    /// Against the exact picture of this run.
    pub error: TerrainError,
    /// units: px
    pub size_px: [u32; 2],
    /// How times were measured.
    pub time_by: Clock,
    /// Name of the GPU.
    pub adapter: String,
    #[serde(skip)]
    view: &'static str,
    #[serde(skip)]
    casting: TerrainRayCasting,
}

/// A setting, by the names of its flags.
#[derive(Serialize, Clone, Debug, PartialEq)]
pub struct Setting {
    /// How rays skip empty space.
    pub traversal: &'static str,
    /// Side of the smallest box, where there are boxes. units: cells
    pub box_texels: Option<u32>,
    /// The error allowed. units: px
    pub max_error_px: f32,
}

impl Setting {
    fn of(casting: &TerrainRayCasting) -> Self {
        let boxes = matches!(casting.traversal, Traversal::Boxes | Traversal::Hybrid);
        Self {
            traversal: traversal_name(casting.traversal),
            box_texels: boxes.then_some(casting.box_texels),
            max_error_px: casting.max_error_px,
        }
    }
}

/// The default, as lines name it.
pub(super) fn default_setting() -> serde_json::Value {
    serde_json::json!(Setting::of(&TerrainRayCasting::default()))
}

/// Nodes and cells read for each pixel.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct Reads {
    /// On average.
    pub mean: f64,
    /// 99 % of the pixels read no more.
    pub p99: u32,
    /// The most.
    pub max: u32,
}

impl Reads {
    fn of(hits: &HitImage) -> Self {
        let mut sorted: Vec<u32> = hits.reads().collect();
        sorted.sort_unstable();
        Self {
            mean: hits.mean_reads(),
            p99: percentile(&sorted, 0.99),
            max: percentile(&sorted, 1.0),
        }
    }
}

/// Timings of one setting, round by round.
#[derive(Default)]
struct Rounds {
    total: Vec<f64>,
    passes: BTreeMap<&'static str, Vec<f64>>,
}

impl Rounds {
    fn add(&mut self, times: &BTreeMap<&'static str, f64>) {
        self.total.push(times.values().sum());
        for (pass, ms) in times {
            self.passes.entry(pass).or_default().push(*ms);
        }
    }
}

/// Measures terrain and writes everything to a directory.
///
/// # Errors
/// [`AccuracyError`].
pub fn measure(
    field: HeightField,
    name: &str,
    plan: &Plan,
    out: &Path,
) -> Result<Summary, AccuracyError> {
    let mut report = Report::new(out, "terrain")?;
    let settings = plan.settings(&field);
    let views = views(&field);
    let progress = ProgressBar::new((settings.len() * views.len() * (1 + plan.rounds())) as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:32} {pos}/{len} {elapsed} {msg}") {
        progress.set_style(style);
    }
    let twin_field = field.clone();
    let twin = Twin::new(&twin_field);
    let shots = views.each_ref().map(|view| Shot {
        size: plan.size,
        casting: settings[0],
        ..Shot::new(view.eye, view.target)
    });
    let mut stage = Stage::new(field, &shots[0])?;
    let mut lines = Vec::new();
    for (view, shot) in views.iter().zip(&shots) {
        stage.look(shot);
        let mut measured = measure_view(&mut stage, view, shot, &settings, &twin, plan, &progress)?;
        for line in &mut measured.lines {
            line.scene = format!("{name}/{}", view.name);
        }
        draw(&mut report, view, shot.size, &measured)?;
        lines.extend(measured.lines);
    }
    progress.finish_and_clear();

    report.results(&lines)?;
    report.csv(&csv(&lines))?;
    let adapter = stage.offline.adapter();
    let clock = lines
        .iter()
        .map(|line| line.time_by)
        .find(|by| *by != Clock::None)
        .unwrap_or_default();
    let head = format!(
        "{name}, {}×{} samples {} m apart; {}×{} px; {adapter}; times are the median of up to {} alternating \
         rounds by {}.",
        twin_field.size().x,
        twin_field.size().y,
        twin_field.texel_m(),
        plan.size.x,
        plan.size.y,
        plan.rounds(),
        clock.words(),
    );
    let mut tables = Vec::new();
    for view in &views {
        let of_view: Vec<_> = lines.iter().filter(|line| line.view == view.name).collect();
        tables.extend(view_tables(view, &of_view));
    }
    let highlights = highlights(&views, &lines);
    report.finish(Found {
        title: "What accuracy costs: terrain",
        head: &head,
        tables: &tables,
        clock: clock.words(),
        adapter,
        results: lines.len(),
        highlights,
    })
}

/// Everything of one view.
struct Measured {
    lines: Vec<TerrainLine>,
    /// Reads per pixel of the settings that heat maps show.
    heat: Vec<(String, Vec<u32>)>,
    /// The default traversal with the most error allowed: in words, and its picture.
    coarsest: Option<(String, image::RgbImage)>,
    exact: image::RgbImage,
}

fn measure_view(
    stage: &mut Stage,
    view: &View,
    shot: &Shot,
    settings: &[TerrainRayCasting],
    twin: &Twin,
    plan: &Plan,
    progress: &ProgressBar,
) -> Result<Measured, AccuracyError> {
    let adapter = stage.offline.adapter();
    let mut rounds: Vec<Rounds> = settings.iter().map(|_| Rounds::default()).collect();
    let mut slow = vec![false; settings.len()];
    let mut lines: Vec<TerrainLine> = Vec::new();
    let mut heat = Vec::new();
    let mut coarsest = None;
    let most_px = plan.errors_px().iter().copied().fold(0.0, f32::max);
    let mut exact: Option<(HitImage, image::RgbImage)> = None;
    for (index, casting) in settings.iter().enumerate() {
        let setting = Setting::of(casting);
        progress.set_message(format!("{} {}", view.name, words(&setting)));
        stage.cast(*casting);
        let begin = Instant::now();
        if index == 0 {
            stage.settle()?;
        } else {
            stage.offline.step();
        }
        let first_s = begin.elapsed().as_secs_f64();
        let boxes = setting.box_texels.and_then(|_| settle_boxes(stage));
        let (times, time_by) = stage.gpu_ms();
        slow[index] = first_s > SLOW_S || times.values().sum::<f64>() > SLOW_S * 1e3;
        if slow[index] {
            rounds[index].add(&times);
        }
        let hits = stage.hits(shot.size)?;
        let picture = stage.picture()?;
        let rays = stage
            .offline
            .view_rays(stage.camera, stage.terrain)
            .ok_or_else(|| {
                OfflineError::Unsupported(
                    "the view shows none of it, though it was chosen to".into(),
                )
            })?;
        let (exact_hits, exact_picture) =
            exact.get_or_insert_with(|| (hits.clone(), picture.clone()));
        let error = TerrainError::of(&hits, &picture, (exact_hits, exact_picture), twin, &rays);
        if casting.box_texels == BOX_TEXELS
            && (casting.max_error_px == MAX_ERROR_PX || casting.traversal == Traversal::PerTexel)
        {
            heat.push((
                format!(
                    "{}, mean {:.1}",
                    letter(casting.traversal),
                    hits.mean_reads()
                ),
                hits.reads().collect(),
            ));
        }
        let default = TerrainRayCasting::default();
        if casting.traversal == default.traversal && casting.max_error_px == most_px {
            coarsest = Some((words(&setting), picture));
        }
        lines.push(TerrainLine {
            effect: "terrain",
            scene: String::new(),
            setting,
            time_ms: Timing::default(),
            pass_ms: BTreeMap::new(),
            reads: Reads::of(&hits),
            boxes,
            error,
            size_px: shot.size.to_array(),
            time_by,
            adapter: adapter.clone(),
            view: view.name,
            casting: *casting,
        });
        progress.inc(1);
    }
    // Settings alternate, so that whatever else the machine does meets all of them alike.
    for _ in 0..plan.rounds() {
        for (index, casting) in settings.iter().enumerate() {
            progress.inc(1);
            if slow[index] {
                continue;
            }
            stage.cast(*casting);
            stage.offline.step();
            let (times, _) = stage.gpu_ms();
            rounds[index].add(&times);
        }
    }
    for (line, rounds) in lines.iter_mut().zip(rounds) {
        line.time_ms = Timing::of(rounds.total);
        let medians = rounds
            .passes
            .into_iter()
            .map(|(pass, times)| (pass, Timing::of(times).median));
        line.pass_ms = medians.collect();
    }
    let exact = exact.map(|(_, picture)| picture).unwrap_or_default();
    Ok(Measured {
        lines,
        heat,
        coarsest,
        exact,
    })
}

/// Draws more frames, if it must, until the box list has room for its boxes; returns their number.
fn settle_boxes(stage: &mut Stage) -> Option<u64> {
    for _ in 0..BOX_FRAMES {
        if let Some((boxes, capacity)) = stage.offline.boxes(stage.camera, stage.terrain)
            && (1..=capacity).contains(&boxes)
        {
            return Some(boxes);
        }
        stage.offline.step();
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_begin_with_the_exact_one_and_never_repeat() {
        let field = super::super::scene::mountains(129).expect("a field can be made");
        for plan in [Plan::full(), Plan::quick()] {
            let settings = plan.settings(&field);
            assert_eq!(
                (settings[0].traversal, settings[0].max_error_px),
                (Traversal::MaxMip, 0.0)
            );
            for (index, setting) in settings.iter().enumerate() {
                assert!(!settings[..index].contains(setting), "{setting:?}");
            }
            assert!(settings.iter().all(|s| s.box_texels <= 128));
        }
    }
}
