//! `skyline accuracy contribution`: what leaving small things out saves, and what is lost of the picture (P4).
//!
//! Two kinds of measurement. **Views** stand still: time, what was drawn, and how far the picture is from the unculled
//! one, for each threshold; without occlusion culling, with it, and with areas weighed by what its depth shows.
//! **Trembles** are views whose camera shakes by some decimetres from frame to frame: how many objects and how many
//! pixels come and go, for each threshold, hysteresis and way to leave.

mod measure;
mod report;

use std::path::{Path, PathBuf};

use bevy::math::UVec2;
use serde::Serialize;

use super::{AccuracyError, Found, Report, Summary, Timing};
use crate::{
    contribution::{ContributionCulling, ContributionExit},
    offline::{
        scenes::city,
        spinner,
        workload::{Drawn, WorkloadStage},
    },
};

/// Thresholds that are compared. units: px²
pub const THRESHOLDS_PX2: [f32; 10] = [0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0];

/// What to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Size of the pictures. units: px
    pub size: UVec2,
    /// A small city, few views and few settings of trembles.
    pub quick: bool,
    /// A glTF binary with a node and mesh a building, else a city made by code.
    pub city: Option<PathBuf>,
    /// Frames of each tremble, at least 2.
    pub path_frames: u32,
    /// How often each setting has its turn to be timed, at least 1.
    pub rounds: usize,
}

impl Plan {
    /// Every view and every setting.
    pub fn full() -> Self {
        Self {
            size: UVec2::new(640, 360),
            quick: false,
            city: None,
            path_frames: 30,
            rounds: 3,
        }
    }

    /// A minute or two on a machine without a GPU.
    pub fn quick() -> Self {
        Self {
            size: UVec2::new(320, 180),
            quick: true,
            city: None,
            path_frames: 12,
            rounds: 1,
        }
    }

    /// Views that are measured; all for `None`.
    fn views(&self) -> Option<&'static [&'static str]> {
        self.quick.then_some(&["street", "middle"])
    }

    /// Settings of views: the unculled one first, without a threshold.
    fn view_settings(&self) -> Vec<Setting> {
        let visibilities = [Depth::Off, Depth::Tested, Depth::Weighed];
        visibilities
            .into_iter()
            .flat_map(|depth| {
                THRESHOLDS_PX2.map(|threshold_px2| Setting {
                    threshold_px2,
                    depth,
                    ..Setting::default()
                })
            })
            .collect()
    }

    /// Settings of trembles: the unculled one first.
    fn tremble_settings(&self) -> Vec<Setting> {
        let thresholds: &[f32] = if self.quick {
            &[4.0, 64.0]
        } else {
            &THRESHOLDS_PX2[1..]
        };
        let depths: &[Depth] = if self.quick {
            &[Depth::Off]
        } else {
            &[Depth::Off, Depth::Tested, Depth::Weighed]
        };
        let mut settings = vec![Setting {
            threshold_px2: 0.0,
            ..Setting::default()
        }];
        for &depth in depths {
            for exit in [
                ContributionExit::Cut,
                ContributionExit::Dithered { seconds: 0.25 },
            ] {
                for hysteresis in [1.0, 1.25, 2.0] {
                    settings.extend(thresholds.iter().map(|&threshold_px2| Setting {
                        threshold_px2,
                        hysteresis,
                        exit,
                        depth,
                    }));
                }
            }
        }
        settings
    }
}

/// What is done with what the depth buffer shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Depth {
    /// Nothing: occlusion culling is off.
    Off,
    /// What is hidden is not drawn.
    Tested,
    /// That, and areas count as far as they show.
    Weighed,
}

/// One way to cull.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Setting {
    threshold_px2: f32,
    hysteresis: f32,
    exit: ContributionExit,
    depth: Depth,
}

impl Default for Setting {
    fn default() -> Self {
        let default = ContributionCulling::default();
        Self {
            threshold_px2: default.threshold_px2,
            hysteresis: default.hysteresis,
            exit: ContributionExit::Cut,
            depth: Depth::Off,
        }
    }
}

impl Setting {
    fn contribution(&self) -> ContributionCulling {
        ContributionCulling {
            threshold_px2: self.threshold_px2,
            hysteresis: self.hysteresis,
            exit: self.exit,
            weigh_by_visibility: self.depth == Depth::Weighed,
            // What the GPU leaves out could not be counted in the same frame.
            gpu_from: usize::MAX,
        }
    }

    fn named(&self) -> SettingLine {
        SettingLine {
            threshold_px2: self.threshold_px2,
            hysteresis: self.hysteresis,
            exit: match self.exit {
                ContributionExit::Cut => "cut",
                ContributionExit::Dithered { .. } => "dithered",
            },
            occlusion: self.depth != Depth::Off,
            weigh_by_visibility: self.depth == Depth::Weighed,
        }
    }
}

/// A setting, by its components' fields.
#[derive(Serialize, Clone, Debug, PartialEq)]
pub struct SettingLine {
    /// units: px²
    pub threshold_px2: f32,
    /// How many times the threshold it takes to come back.
    pub hysteresis: f32,
    /// `cut` or `dithered`.
    pub exit: &'static str,
    /// Whether what is hidden is not drawn either.
    pub occlusion: bool,
    /// Whether areas count as far as the depth buffer shows them.
    pub weigh_by_visibility: bool,
}

/// The default, as lines name it: without occlusion culling, and with it.
pub(super) fn default_settings() -> Vec<serde_json::Value> {
    let of = |depth| {
        serde_json::json!(
            Setting {
                depth,
                ..Setting::default()
            }
            .named()
        )
    };
    vec![of(Depth::Off), of(Depth::Weighed)]
}

/// One line of `results.jsonl`.
#[derive(Serialize, Clone, Debug)]
pub struct ContributionLine {
    /// Always `contribution`.
    pub effect: &'static str,
    /// Scene and view; of trembles with `/tremble` behind.
    pub scene: String,
    /// How it was culled.
    pub setting: SettingLine,
    /// Whole frames, from their start until the GPU was done. units: ms
    pub time_ms: Timing,
    /// What was drawn; the mean of all frames. Of objects that occlusion culling removed and drew after all in the
    /// same frame it knows nothing.
    pub drawn: Drawn,
    /// Against the unculled picture of the same frame.
    pub error: ContributionError,
    /// Frames looked at.
    pub frames: u32,
    /// units: px
    pub size_px: [u32; 2],
    /// Name of the GPU.
    pub adapter: String,
}

/// What was lost.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct ContributionError {
    /// Mean of the FLIP error (Andersson et al. 2020): 0 same … 1.
    pub flip_mean: f64,
    /// The threshold that held. units: px²
    pub threshold_px2: f64,
    /// Share of the pixels that are of another colour.
    pub changed_fraction: f64,
    /// Objects that came or went for their area from one frame to the next, of those in view in both: their mean
    /// number; of trembles only.
    pub flicker_objects: Option<f64>,
    /// Pixels that became wrong or right again from one frame to the next: their mean share; of trembles only.
    pub flicker_fraction: Option<f64>,
}

/// Measures contribution culling and writes everything to a directory.
///
/// # Errors
/// [`AccuracyError`].
pub fn measure(plan: &Plan, out: &Path) -> Result<Summary, AccuracyError> {
    let mut report = Report::new(out, "contribution")?;
    let progress = spinner();
    progress.set_message("making the scene");
    let scene = city::furnished_for(plan.city.as_deref(), plan.quick)?;
    let mut stage = WorkloadStage::new(scene, plan.size)?;
    let wanted = plan.views();
    let views: Vec<_> = stage
        .scene
        .views
        .iter()
        .filter(|view| wanted.is_none_or(|names| names.contains(&view.name)))
        .cloned()
        .collect();
    let mut lines = Vec::new();
    for view in &views {
        progress.set_message(format!("{}/{}", stage.scene.name, view.name));
        measure::measure_view(&mut stage, view, plan, &progress, &mut report, &mut lines)?;
    }
    for view in views.iter().filter(|view| view.name == "middle") {
        progress.set_message(format!("{}/{}, trembling", stage.scene.name, view.name));
        measure::measure_tremble(&mut stage, view, plan, &progress, &mut lines)?;
    }
    progress.finish_and_clear();

    report::draw(&mut report, &lines)?;
    report.results(&lines)?;
    report.csv(&report::csv(&lines))?;
    let tables = report::tables(&lines);
    let adapter = stage.offline.adapter();
    let head = format!(
        "{}: {} objects, {} triangles; {}×{} px; {adapter}; times are medians of whole frames until the GPU was done.",
        stage.scene.name,
        stage.scene.objects.len(),
        stage.scene.triangles(),
        plan.size.x,
        plan.size.y,
    );
    report.finish(Found {
        title: "What accuracy costs: contribution culling",
        head: &head,
        tables: &tables,
        clock: "the wall clock, from a frame's start until the GPU was done",
        adapter,
        results: lines.len(),
        highlights: report::highlights(&lines),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_setting_is_measured_twice_and_the_unculled_one_comes_first() {
        for plan in [Plan::full(), Plan::quick()] {
            for (settings, count) in [
                (plan.view_settings(), 30),
                (plan.tremble_settings(), if plan.quick { 13 } else { 163 }),
            ] {
                assert_eq!(settings.len(), count);
                assert_eq!(settings[0].threshold_px2, 0.0);
                assert_eq!(settings[0].depth, Depth::Off);
                let names: std::collections::BTreeSet<_> = settings
                    .iter()
                    .map(|setting| format!("{:?}", setting.named()))
                    .collect();
                assert_eq!(names.len(), count);
            }
        }
    }
}
