//! What the panel shows: plain values, gathered while it is open.
//!
//! Frame times are taken every frame, everything else a few times a second ([`REFRESH`]): figures that change faster
//! cannot be read, and a look at every mesh is not for every frame. Drawing works from [`PanelData`] alone.

use core::{any::TypeId, time::Duration};
use std::path::PathBuf;

use bevy::{
    camera::visibility::{NoCpuCulling, RenderLayers, VisibleEntities},
    ecs::system::SystemParam,
    platform::time::Instant,
    prelude::*,
    time::Real,
    window::FileDragAndDrop,
};

use super::{
    PanelCamera, SkylinePanel,
    budget::{BudgetSource, KnobHand},
    counts::{MeshState, ReasonCounts},
    results::{Results, ResultsError},
    stats::FrameTimes,
};
#[cfg(feature = "culling")]
use crate::{contribution::ContributionCounts, occlusion::OcclusionCounts};
use crate::{
    culling::{CullReason, CulledEntities},
    effects::{Effect, EffectState, Effects},
};
#[cfg(not(feature = "culling"))]
use not_built::{ContributionCounts, OcclusionCounts};

/// On no camera where the cullings are not built.
#[cfg(not(feature = "culling"))]
mod not_built {
    use bevy::prelude::*;

    #[derive(Component)]
    pub struct ContributionCounts {
        pub on_gpu: bool,
        pub triangles: u64,
        pub triangles_drawn: u64,
    }

    #[derive(Component)]
    pub struct OcclusionCounts {
        pub rescued: u32,
    }
}

/// Time between two looks at everything but frame times.
pub const REFRESH: Duration = Duration::from_millis(250);

/// Everything that the panel shows. There is none while it is closed.
#[derive(Resource, Default)]
pub struct PanelData {
    /// The last frames.
    pub frames: FrameTimes,
    /// What [`frames`](Self::frames) are.
    pub time_of: TimeOf,
    /// The strictest budget of an active camera.
    pub budget: Option<BudgetRow>,
    /// Every effect, in a fixed order.
    pub effects: Vec<EffectRow>,
    /// Every knob, in the order of registration.
    pub knobs: Vec<KnobRow>,
    /// Every active camera that sees meshes.
    pub cameras: Vec<CameraRow>,
    /// The file of results, with its path as it was asked for.
    pub results: Option<(PathBuf, Result<Results, ResultsError>)>,
    /// What the panel itself costs.
    pub own: OwnCost,
    /// When all was looked at last. units: since the app's start
    refreshed: Option<Duration>,
}

/// Which time a frame time is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimeOf {
    /// From one frame's start to the next one's.
    #[default]
    Interval,
    /// What a frame budget finds that the app worked on a frame.
    Work,
    /// What a frame budget is given.
    Given,
}

impl TimeOf {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Interval => "from frame to frame",
            Self::Work => "work, without waiting for the display",
            Self::Given => "as given to the frame budget",
        }
    }
}

/// A time, and which it is; no time if the newest frame's is not known yet. units: ms
pub(super) type Measured = (TimeOf, Option<f32>);

/// A frame budget and how it stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BudgetRow {
    /// units: ms
    pub target_ms: f32,
    /// units: ms
    pub predicted_ms: Option<f32>,
    /// units: px²
    pub demanded_px2: f32,
    /// Whether the target is met; `None` while that is not known.
    pub is_met: Option<bool>,
    /// In short.
    pub words: &'static str,
}

/// An effect and its state.
#[derive(Clone, Debug, PartialEq)]
pub struct EffectRow {
    /// Which.
    pub effect: Effect,
    /// As it was at the last look.
    pub state: EffectState,
}

/// Every effect, in the panel's order.
const EFFECTS: [Effect; Effect::ALL.len()] = [
    Effect::FrameBudget,
    Effect::ResolutionScale,
    Effect::ContributionCulling,
    Effect::ZBufferOcclusion,
    Effect::InteriorCulling,
    Effect::SphericalIndex,
    Effect::Terrain,
    Effect::TerrainShadow,
];

impl EffectRow {
    /// In words.
    pub fn name(&self) -> &'static str {
        // Without a wildcard: a new effect has to be put into the panel's order too.
        match self.effect {
            Effect::FrameBudget => "Frame budget",
            Effect::ResolutionScale => "Resolution scale",
            Effect::ContributionCulling => "Contribution culling",
            Effect::ZBufferOcclusion => "Z-buffer occlusion",
            Effect::InteriorCulling => "Interior culling",
            Effect::SphericalIndex => "Spherical index",
            Effect::Terrain => "Terrain ray casting",
            Effect::TerrainShadow => "Terrain shadow",
        }
    }
}

/// A knob of the frame budget as it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct KnobRow {
    /// Its name; what [`PanelRequest::SetManual`] goes by.
    pub name: &'static str,
    /// Unit of its values.
    pub unit: &'static str,
    /// Values from the best step to the cheapest.
    pub values: Vec<f32>,
    /// The step it stands at.
    pub at: usize,
    /// The value it stands at.
    pub value: Option<f32>,
    /// The user's choice, if the user chooses.
    pub manual: Option<usize>,
    /// What the whole way would save, where it is known. units: ms
    pub saves_ms: Option<f32>,
}

/// What a camera shows.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraRow {
    /// Which.
    pub camera: Entity,
    /// Its `Name`, else its entity.
    pub name: String,
    /// Meshes by reason.
    pub counts: ReasonCounts,
    /// Triangles drawn and triangles in view, where [`ContributionCulling`](crate::contribution::ContributionCulling)
    /// counts them.
    pub triangles: Option<(u64, u64)>,
    /// Meshes that the depth buffer brought back in the same frame.
    pub drawn_late: u32,
}

/// What the panel takes on the CPU, on average over about the last second. units: ms
///
/// Time on the GPU is not in it: `bevy_egui` does not measure its pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OwnCost {
    /// Gathering.
    pub gather_ms: f32,
    /// Laying out and tessellating.
    pub draw_ms: f32,
}

impl OwnCost {
    /// Both. units: ms
    pub fn total_ms(&self) -> f32 {
        self.gather_ms + self.draw_ms
    }

    /// Takes a new time into an average.
    pub(super) fn average(average_ms: &mut f32, began: Instant) {
        let ms = began.elapsed().as_secs_f32() * 1e3;
        *average_ms += (ms - *average_ms) / 32.0;
    }
}

/// What a user asks of the panel, by its widgets or by code.
#[derive(Message, Clone, Debug, PartialEq)]
pub enum PanelRequest {
    /// Takes a knob out of the budget's hand, or gives it back with `None`. See `Knobs::set_manual` of the frame budget.
    SetManual {
        /// Its name.
        knob: &'static str,
        /// Index of a step.
        step: Option<usize>,
    },
    /// Shows a file of results, read anew even if it is shown already.
    Load(PathBuf),
}

/// Does what is asked for. Requests that name no knob or step change nothing.
pub fn apply_requests(
    mut requests: MessageReader<PanelRequest>,
    mut panel: ResMut<SkylinePanel>,
    mut knobs: KnobHand,
    mut data: ResMut<PanelData>,
) {
    for request in requests.read() {
        match request {
            PanelRequest::SetManual { knob, step } => knobs.set_manual(knob, *step),
            PanelRequest::Load(path) => {
                panel.results = Some(path.clone());
                data.results = None;
            }
        }
        // What was asked for shows at once.
        data.refreshed = None;
    }
}

/// A file dropped on a window is a file of results.
pub fn take_dropped_files(
    mut dropped: MessageReader<FileDragAndDrop>,
    mut requests: MessageWriter<PanelRequest>,
) {
    for event in dropped.read() {
        if let FileDragAndDrop::DroppedFile { path_buf, .. } = event {
            requests.write(PanelRequest::Load(path_buf.clone()));
        }
    }
}

/// What is looked at.
#[derive(SystemParam)]
pub struct Sources<'w, 's> {
    effects: Option<Res<'w, Effects>>,
    cameras: Query<'w, 's, CameraParts, (With<Camera3d>, Without<PanelCamera>)>,
    meshes: Query<'w, 's, MeshParts, With<Mesh3d>>,
}

type CameraParts = (
    Entity,
    &'static Camera,
    &'static VisibleEntities,
    Option<&'static Name>,
    Option<&'static RenderLayers>,
    Option<&'static CulledEntities>,
    Option<&'static ContributionCounts>,
    Option<&'static OcclusionCounts>,
);

type MeshParts = (
    Entity,
    Option<&'static InheritedVisibility>,
    Option<&'static RenderLayers>,
    Has<NoCpuCulling>,
);

/// Fills [`PanelData`].
pub fn gather(
    mut data: ResMut<PanelData>,
    panel: Res<SkylinePanel>,
    time: Res<Time<Real>>,
    sources: Sources,
    budget: BudgetSource,
) {
    let began = Instant::now();
    let data = &mut *data;
    data.take_frame_time(&time, &budget);
    let now = time.elapsed();
    let is_due = data
        .refreshed
        .is_none_or(|last| now.saturating_sub(last) >= REFRESH);
    if is_due {
        data.refreshed = Some(now);
        data.look(&sources);
        data.knobs.clear();
        data.knobs.extend(budget.knobs());
        data.load(panel.results.as_ref());
    }
    OwnCost::average(&mut data.own.gather_ms, began);
}

impl PanelData {
    /// What the strictest budget measures, else the interval: also while a budget has no measurement.
    fn take_frame_time(&mut self, time: &Time<Real>, budget: &BudgetSource) {
        let (row, measured) = budget.strictest().unzip();
        let interval = (TimeOf::Interval, Some(time.delta_secs() * 1e3));
        let (time_of, ms) = measured.flatten().unwrap_or(interval);
        if self.time_of != time_of {
            // Different times have no mean in common.
            self.frames.clear();
            self.time_of = time_of;
        }
        if let Some(ms) = ms {
            self.frames.push(ms);
        }
        self.budget = row;
    }

    fn look(&mut self, sources: &Sources) {
        self.effects.clear();
        if let Some(effects) = &sources.effects {
            let built = EFFECTS.into_iter().filter(|effect| effect.is_built());
            self.effects.extend(built.map(|effect| EffectRow {
                effect,
                state: effects.state(effect).clone(),
            }));
        }
        self.cameras.clear();
        let default_layers = RenderLayers::default();
        for (camera, view, visible, name, layers, culled, contribution, occlusion) in
            &sources.cameras
        {
            if !view.is_active {
                continue;
            }
            let list = visible.get(TypeId::of::<Mesh3d>());
            let (mut small, mut occluded, mut listed) = (0, 0, 0);
            for (entity, why) in culled.into_iter().flat_map(CulledEntities::iter) {
                if !sources.meshes.contains(entity) {
                    continue;
                }
                // What the GPU leaves out stays in the list.
                listed += usize::from(list.binary_search(&entity).is_ok());
                match why {
                    CullReason::Contribution => small += 1,
                    _ => occluded += 1,
                }
            }
            let is_late = contribution.is_some_and(|counts| counts.on_gpu);
            let is_removed =
                |mesh| is_late && culled.is_some_and(|culled| culled.reason(mesh).is_some());
            let meshes = sources.meshes.iter();
            let counts = ReasonCounts::of(
                meshes.map(|(mesh, inherited, layers, no_cpu_culling)| MeshState {
                    inherited_visible: inherited.is_some_and(|inherited| inherited.get()),
                    layers,
                    no_cpu_culling,
                    removed: is_removed(mesh),
                }),
                layers.unwrap_or(&default_layers),
                list.len() - listed,
                small,
                occluded,
            );
            self.cameras.push(CameraRow {
                camera,
                name: name.map_or_else(|| format!("camera {camera}"), ToString::to_string),
                counts,
                triangles: contribution.map(|counts| (counts.triangles_drawn, counts.triangles)),
                drawn_late: occlusion.map_or(0, |counts| counts.rescued),
            });
        }
        self.cameras.sort_by_key(|row| row.camera);
    }

    /// Reads the file that is asked for, unless it was read.
    fn load(&mut self, asked: Option<&PathBuf>) {
        let have = self.results.as_ref().map(|(path, _)| path);
        if have == asked {
            return;
        }
        self.results = asked.map(|path| (path.clone(), Results::load(path)));
    }
}
