//! `skyline accuracy idle`: what the plugins cost in a scene that uses none of them.
//!
//! The same scene in three apps of one process: two without the plugins, one with them. A frame of each in turn, in an
//! order that turns too, so that whatever else the machine does meets all alike. How far the two without lie apart is
//! what the clock can tell at all. By count: passes that only the app with the plugins ran, and what its effects hold.

use std::{collections::BTreeSet, path::Path};

use bevy::{diagnostic::DiagnosticsStore, platform::time::Instant, prelude::*};
use serde::Serialize;
use serde_json::json;

use super::{AccuracyError, Found, Report, Summary, Table, Timing, report::short};
use crate::{
    effects::{EffectState, Effects},
    offline::{Offline, OfflineError, spinner},
    plugin::SkylinePlugins,
};

/// What to measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Columns and rows of boxes in each scene.
    pub objects: UVec2,
    /// Frames of each app that are timed.
    pub frames: usize,
}

impl Plan {
    /// Ten thousand boxes.
    pub fn full() -> Self {
        Self {
            objects: UVec2::new(100, 100),
            frames: 600,
        }
    }

    /// Seconds.
    pub fn quick() -> Self {
        Self {
            objects: UVec2::new(50, 40),
            frames: 200,
        }
    }
}

/// One line of `results.jsonl`.
#[derive(Serialize, Clone, Debug)]
pub struct IdleLine {
    /// Always `idle`.
    pub effect: &'static str,
    /// How many objects.
    pub scene: String,
    /// `none`, `none, again`, or `skyline`.
    pub setting: Setting,
    /// Whole frames. units: ms
    pub time_ms: Timing,
    /// Against the first app without the plugins, frame by frame: the median of the ratios.
    pub ratio: f64,
    /// Passes that ran in this app and not in the first.
    pub more_passes: usize,
    /// What effects hold on the GPU. units: bytes
    pub gpu_bytes: u64,
    /// Effects that are not dormant.
    pub awake: Vec<String>,
    /// Name of the GPU.
    pub adapter: String,
}

/// What was added.
#[derive(Serialize, Clone, Debug, PartialEq)]
pub struct Setting {
    /// In words.
    pub plugins: &'static str,
}

/// The three apps, the reference first.
const APPS: [&str; 3] = ["none", "none, again", "skyline"];
/// Frames before any is timed: everything is compiled and uploaded.
const WARM: usize = 30;

/// Measures and writes everything to a directory.
///
/// # Errors
/// [`AccuracyError`].
pub fn measure(plan: &Plan, out: &Path) -> Result<Summary, AccuracyError> {
    let mut report = Report::new(out, "idle")?;
    let progress = spinner();
    progress.set_message("three apps");
    let mut apps = [stage(plan, false)?, stage(plan, false)?, stage(plan, true)?];
    let mut times = [(); APPS.len()].map(|()| Vec::with_capacity(plan.frames));
    for frame in 0..WARM + plan.frames {
        for turn in 0..apps.len() {
            let at = (frame + turn) % apps.len();
            let began = Instant::now();
            apps[at].step();
            if frame >= WARM {
                times[at].push(began.elapsed().as_secs_f64() * 1e3);
            }
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    let passes: Vec<BTreeSet<String>> = apps.iter().map(passes).collect();
    let adapter = apps[0].adapter();
    let reference = times[0].clone();
    let lines: Vec<IdleLine> = APPS
        .iter()
        .enumerate()
        .map(|(at, plugins)| {
            let ratios = times[at].iter().zip(&reference).map(|(own, of)| own / of);
            let (gpu_bytes, awake) = held(&apps[at]);
            IdleLine {
                effect: "idle",
                scene: format!("{} boxes", plan.objects.element_product()),
                setting: Setting { plugins },
                time_ms: Timing::of(times[at].clone()),
                ratio: Timing::of(ratios.collect()).median,
                more_passes: passes[at].difference(&passes[0]).count(),
                gpu_bytes,
                awake,
                adapter: adapter.clone(),
            }
        })
        .collect();
    report.results(&lines)?;
    let rows = lines.iter().map(|line| {
        vec![
            line.setting.plugins.to_owned(),
            short(line.time_ms.median),
            format!("{} … {}", short(line.time_ms.min), short(line.time_ms.max)),
            format!("{:.4}", line.ratio),
            line.more_passes.to_string(),
            line.gpu_bytes.to_string(),
            line.awake.join(", "),
        ]
    });
    let heads = [
        "plugins",
        "ms a frame",
        "least … most",
        "ratio, frame by frame",
        "passes more",
        "GPU bytes",
        "effects awake",
    ];
    let table: Table = (
        format!(
            "{} boxes, {} frames of each app in turn",
            plan.objects.element_product(),
            plan.frames
        ),
        heads.map(str::to_owned).into(),
        rows.collect(),
    );
    report.csv(&table)?;
    let head = format!(
        "{adapter}; {} boxes and no component of ours; {} frames of each app, in turn. The second line is a second app without \
         the plugins: how far it is from 1 is what the clock can't tell.",
        plan.objects.element_product(),
        plan.frames
    );
    report.finish(Found {
        title: "What nothing costs",
        head: &head,
        tables: &[table],
        clock: "the wall clock, from a frame's start until the GPU was done",
        adapter,
        results: lines.len(),
        highlights: json!(lines),
    })
}

/// Boxes, a light, a camera.
fn stage(plan: &Plan, with: bool) -> Result<Offline, OfflineError> {
    let mut offline = Offline::start(|app| {
        if with {
            app.add_plugins(SkylinePlugins);
        }
    })?;
    let target = offline.target(UVec2::new(64, 36));
    offline.camera(
        &target,
        (
            Transform::from_xyz(0.0, 60.0, 120.0).looking_at(Vec3::ZERO, Vec3::Y),
            Msaa::Off,
        ),
    );
    let world = offline.app.world_mut();
    world.spawn((
        DirectionalLight::default(),
        Transform::default().looking_to(Vec3::new(-0.4, -1.0, -0.7), Vec3::Y),
    ));
    let mesh = world
        .resource_mut::<Assets<Mesh>>()
        .add(Cuboid::from_length(1.0));
    let material = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial::default());
    let size = plan.objects;
    world.spawn_batch((0..size.element_product()).map(move |index| {
        let at = UVec2::new(index % size.x, index / size.x).as_vec2() - 0.5 * size.as_vec2();
        (
            Mesh3d(mesh.clone()),
            MeshMaterial3d(material.clone()),
            Transform::from_xyz(2.0 * at.x, 0.0, 2.0 * at.y),
        )
    }));
    Ok(offline)
}

/// Names of the passes that have run.
fn passes(offline: &Offline) -> BTreeSet<String> {
    offline
        .app
        .world()
        .get_resource::<DiagnosticsStore>()
        .into_iter()
        .flat_map(DiagnosticsStore::iter)
        .map(|diagnostic| diagnostic.path().as_str().to_owned())
        .filter(|path| path.starts_with("render/"))
        .collect()
}

/// GPU bytes of all effects, and those that are not dormant, with why.
fn held(offline: &Offline) -> (u64, Vec<String>) {
    let Some(effects) = offline.app.world().get_resource::<Effects>() else {
        return (0, Vec::new());
    };
    let bytes = effects.iter().map(|(effect, _)| effects.bytes(effect));
    let awake = effects
        .iter()
        .filter(|(_, state)| **state != EffectState::Dormant)
        .map(|(effect, state)| format!("{effect:?}: {state}"));
    (bytes.sum(), awake.collect())
}
