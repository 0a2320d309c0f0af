//! `skyline accuracy occlusion`: what culling hidden objects saves and what it costs, against no culling, frustum
//! culling alone and Bevy's own occlusion culling (P2, Figs. 16 and 17, Table 1).

pub mod cost;
mod exact;
mod highlights;
mod measure;
mod report;
pub mod rest;
mod setting;

use std::path::{Path, PathBuf};

use bevy::math::{UVec2, UVec3};
use serde::Serialize;

use super::{AccuracyError, Found, Report, Summary, Timing};
use crate::{
    occlusion::{DepthSampling, OccludeeVolume, Recheck, ZBufferOcclusion},
    offline::{
        scenes::{
            CameraPath, Scene,
            bunnies::{self, Block},
            city::{self, CitySize},
            compare::Difference,
            paths::PATHS,
            seabed::seabed,
            stage::Culling,
        },
        spinner,
    },
};

pub use cost::CostLine;
pub use rest::RestLine;
pub use setting::Setting;

/// Frames of a path from which on only the defaults are measured on it.
const LONG_PATH: u32 = 100;

/// What scenes to measure on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SceneKind {
    /// A dense city.
    City,
    /// Blocks of 9, 100 and 1,000 models.
    Bunnies,
    /// Ground in 256 blocks.
    Seabed,
}

/// Every kind and its name as a flag's value.
pub const SCENES: [(SceneKind, &str); 3] = [
    (SceneKind::City, "city"),
    (SceneKind::Bunnies, "bunnies"),
    (SceneKind::Seabed, "seabed"),
];

/// What to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Size of the pictures. units: px
    pub size: UVec2,
    /// Small scenes, few settings and few rounds.
    pub quick: bool,
    /// On what.
    pub scenes: Vec<SceneKind>,
    /// An OBJ file, else a shape made by code.
    pub model: Option<PathBuf>,
    /// A glTF binary with a node and mesh a building, else a city made by code.
    pub city: Option<PathBuf>,
    /// Frames of each path, at least 1. From 100 on only the defaults are measured on paths, beside the unculled
    /// reference.
    pub path_frames: u32,
    /// How often each setting has its turn to be timed, at least 1.
    pub rounds: usize,
    /// Whether some view is measured with settings that change several things at once.
    pub every_setting: bool,
}

impl Plan {
    /// Every scene and every setting.
    pub fn full() -> Self {
        Self {
            size: UVec2::new(1280, 720),
            quick: false,
            scenes: SCENES.map(|(kind, _)| kind).to_vec(),
            model: None,
            city: None,
            path_frames: 40,
            rounds: 3,
            every_setting: true,
        }
    }

    /// Seconds rather than an hour.
    pub fn quick() -> Self {
        Self {
            size: UVec2::new(320, 180),
            quick: true,
            path_frames: 6,
            rounds: 1,
            every_setting: false,
            ..Self::full()
        }
    }

    fn paths(&self) -> impl Iterator<Item = CameraPath> {
        let few = self.quick && self.path_frames < LONG_PATH;
        let kept = move |path: &CameraPath| {
            !few || matches!(path, CameraPath::Walk | CameraPath::Teleport)
        };
        PATHS.into_iter().map(|(path, _)| path).filter(kept)
    }

    /// How many boxes the main-world cost is measured with.
    fn candidates(&self) -> &'static [usize] {
        if self.quick {
            &[1_000]
        } else {
            &[10_000, 100_000]
        }
    }

    /// The scenes of a kind.
    fn make(&self, kind: SceneKind) -> Result<Vec<Scene>, AccuracyError> {
        Ok(match kind {
            SceneKind::City => vec![match &self.city {
                Some(path) => city::from_file(path)?,
                None if self.quick => city::generated(CitySize::Small),
                None => city::generated(CitySize::Full),
            }],
            SceneKind::Bunnies => {
                let blocks = if self.quick {
                    vec![Block::of(UVec3::new(3, 1, 3), 1_000)]
                } else {
                    vec![Block::NINE, Block::HUNDRED, Block::THOUSAND]
                };
                let scene = |block| match &self.model {
                    Some(path) => bunnies::from_file(path, block),
                    None => Ok(bunnies::generated(block)),
                };
                blocks.into_iter().map(scene).collect::<Result<_, _>>()?
            }
            SceneKind::Seabed => vec![seabed(self.quick)],
        })
    }

    /// The settings that a view is measured with: all there are, or those that change one thing.
    fn settings(&self, every: bool) -> Vec<Culling> {
        let mut settings = vec![
            Culling::None,
            Culling::Frustum,
            Culling::Bevy,
            Culling::ZBufferAfterPrepass(ZBufferOcclusion {
                rests: false,
                ..ZBufferOcclusion::default()
            }),
        ];
        let all = every && self.every_setting;
        let volumes = [
            OccludeeVolume::Aabb,
            OccludeeVolume::Obb,
            OccludeeVolume::Proxy { triangles: 100 },
        ];
        let samplings = [0, 2, 4, 8, 16]
            .map(|block| DepthSampling::Conservative { block })
            .into_iter()
            .chain([DepthSampling::Strided { x: 5, y: 4 }]);
        for sampling in samplings {
            for volume in volumes {
                for recheck in [Recheck::SameFrame, Recheck::Never] {
                    let usual = [
                        sampling == DepthSampling::default(),
                        volume == OccludeeVolume::default(),
                        recheck == Recheck::default(),
                    ];
                    // Elsewhere one thing is changed at a time, and not to what lies in between.
                    let between = matches!(sampling, DepthSampling::Conservative { block: 2 | 8 });
                    let changed = usual.iter().filter(|usual| !**usual).count();
                    if all || (changed <= 1 && !between) {
                        settings.push(Culling::ZBuffer(ZBufferOcclusion {
                            volume,
                            sampling,
                            recheck,
                            // What is measured is culling, not when to leave it.
                            rests: false,
                            ..ZBufferOcclusion::default()
                        }));
                    }
                }
            }
        }
        settings
    }

    /// Every setting that a path is measured with, the unculled reference first.
    fn path_settings(&self) -> Vec<Culling> {
        let mut settings = self.settings(false);
        if self.path_frames >= LONG_PATH {
            settings
                .retain(|culling| *culling == Culling::None || Setting::of(culling).is_default());
        }
        settings
    }
}

/// The default, as lines name it.
pub(super) fn default_setting() -> serde_json::Value {
    serde_json::json!(Setting::of(&Culling::ZBuffer(ZBufferOcclusion::default())))
}

/// One line of `results.jsonl`.
#[derive(Serialize, Clone, Debug)]
pub struct OcclusionLine {
    /// Always `occlusion`.
    pub effect: &'static str,
    /// Scene and view, or scene and path.
    pub scene: String,
    /// What culled.
    pub setting: Setting,
    /// Whole frames, from their start until the GPU was done. units: ms
    pub time_ms: Timing,
    /// How many objects.
    pub objects: Objects,
    /// Against the unculled picture of the same frame.
    pub error: OcclusionError,
    /// Frames looked at.
    pub frames: u32,
    /// units: px
    pub size_px: [u32; 2],
    /// Name of the GPU.
    pub adapter: String,
}

/// Numbers of objects.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct Objects {
    /// In the scene.
    pub all: usize,
    /// Drawn; the mean of all frames of a path.
    pub drawn: f64,
    /// That show a pixel; of views only.
    pub seen: Option<usize>,
}

/// What was wrong.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct OcclusionError {
    /// Pixels that show another surface than the unculled picture of the same frame, in all frames together.
    pub false_cull_px: u64,
    /// Frames with such pixels.
    pub false_cull_frames: u32,
    /// Pixels of another colour at the very same depth: surfaces in one plane, drawn in another order.
    pub tied_px: u64,
    /// Share of the objects drawn that show no pixel; of views only.
    pub missed_culls: Option<f64>,
    /// Share removed of what an exact test of the same volume against every pixel's depth would remove; where that
    /// is nothing, there is none.
    pub of_exact: Option<f64>,
}

impl OcclusionError {
    /// Of one frame.
    fn of(difference: Difference) -> Self {
        let mut error = Self::default();
        error.add(difference);
        error
    }

    /// One more frame.
    fn add(&mut self, difference: Difference) {
        self.false_cull_px += difference.lost_px;
        self.false_cull_frames += u32::from(difference.lost_px > 0);
        self.tied_px += difference.tied_px;
    }
}

/// Measures occlusion culling and writes everything to a directory.
///
/// # Errors
/// [`AccuracyError`].
pub fn measure(plan: &Plan, out: &Path) -> Result<Summary, AccuracyError> {
    let mut report = Report::new(out, "occlusion")?;
    let progress = spinner();
    let (mut lines, mut rests) = (Vec::new(), Vec::new());
    let mut adapter = String::new();
    for &kind in &plan.scenes {
        for scene in plan.make(kind)? {
            progress.set_message(scene.name.clone());
            // One scene is enough for what comes of changing several things at once.
            let every = kind == SceneKind::City || plan.scenes.len() == 1;
            adapter = measure::measure_scene(
                scene,
                every,
                plan,
                &progress,
                &mut report,
                &mut lines,
                &mut rests,
            )?;
        }
    }
    let mut costs = Vec::new();
    for &candidates in plan.candidates() {
        for out_of_view in [false, true] {
            progress.set_message(format!("{candidates} candidates"));
            costs.push(cost::measure_cost(candidates, out_of_view, plan.quick)?);
        }
    }
    progress.finish_and_clear();

    report::draw(&mut report, &lines)?;
    report.results(&lines)?;
    report.csv(&report::csv(&lines))?;
    let highlights = highlights::of(&lines, rests, costs);
    let mut tables = highlights.tables();
    tables.extend(report::tables(&lines));
    let head = format!(
        "{}×{} px; {adapter}; times are medians of whole frames until the GPU was done, {} alternating rounds.",
        plan.size.x, plan.size.y, plan.rounds,
    );
    report.finish(Found {
        title: "What accuracy costs: occlusion culling",
        head: &head,
        tables: &tables,
        clock: "the wall clock, from a frame's start until the GPU was done",
        adapter,
        results: lines.len(),
        highlights: highlights.json(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_setting_is_measured_once_and_every_one_at_first_views() {
        for (plan, count) in [(Plan::full(), 40), (Plan::quick(), 11)] {
            let settings = plan.settings(true);
            assert_eq!(settings.len(), count);
            let names: std::collections::BTreeSet<_> =
                settings.iter().map(|s| Setting::of(s).words()).collect();
            assert_eq!(names.len(), count, "{names:?}");
            let default = ZBufferOcclusion {
                rests: false,
                ..ZBufferOcclusion::default()
            };
            let long = Plan {
                path_frames: 500,
                ..plan.clone()
            };
            for settings in [plan.path_settings(), long.path_settings()] {
                assert_eq!(settings[0], Culling::None);
                for culling in [Culling::ZBuffer, Culling::ZBufferAfterPrepass] {
                    assert!(settings.contains(&culling(default.clone())));
                }
            }
            assert_eq!(long.path_settings().len(), 3);
            for first in [true, false] {
                assert!(
                    plan.settings(first)
                        .contains(&Culling::ZBuffer(default.clone()))
                );
            }
        }
    }
}
