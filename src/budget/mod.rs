//! The frame budget: one frame time, wherever the camera looks (P4, and what it lacks).
//!
//! Each frame: **measure** what the last frames took, **learn** what an object, a triangle, a pixel and a terrain ray
//! cost on this machine, **predict** this frame, and **choose** the knobs' settings with the least visible loss whose
//! predicted time meets the target. Feedback trims what the model gets wrong.
//!
//! | Where | What |
//! |---|---|
//! | `measure` | what a frame took |
//! | [`workload`] | what it had to do, and what any demand leaves of it |
//! | [`model`] | what that costs here, learned |
//! | `trim` | by how much the model is off just now, and how far frames scatter |
//! | [`controller`] | the choice of each frame; plain data, no app |
//! | `ladder` | which other knob moves, and when |
//! | [`knobs`], `built_in` | the registry, and the knobs of this suite |
//! | [`policy`] | what it is compared with: a fixed number of polygons, a fixed view distance (with the feature `culling`) |
//!
//! # A frame
//! | When | What |
//! |---|---|
//! | `First` | [`BudgetSystems::Begin`]: the clock starts, times of past frames are taken in; [`BudgetSystems::ApplyKnobs`]: knobs that moved are applied |
//! | `PostUpdate`, [`BudgetSystems::Choose`]; with the feature `culling` that is in [`ContributionSteps::Choose`](crate::contribution::ContributionSteps) | areas are summed up, the demand of this frame is chosen, other knobs are moved for the next |
//! | `PostUpdate`, after [`CullSystems`] | what is drawn in the end is noted, to be learned from |
//! | `Last` | the clock stops; [`Effects`](crate::effects::Effects) and diagnostics are written |
//!
//! Without a [`FrameBudget`] in the scene one empty query runs a frame, and nothing is kept.

pub(crate) mod built_in;
pub mod controller;
mod knob;
pub mod knobs;
pub(crate) mod ladder;
pub(crate) mod measure;
pub mod model;
#[cfg(feature = "culling")]
pub mod policy;
pub(crate) mod trim;
pub mod workload;

use bevy::{
    camera::visibility::VisibilitySystems,
    diagnostic::{Diagnostic, RegisterDiagnostic},
    ecs::{lifecycle::HookContext, world::DeferredWorld},
    prelude::*,
};

pub use knobs::{AppKnobs, Knob, KnobCost, KnobError, KnobOn, KnobStep, Knobs};
#[cfg(feature = "culling")]
pub use policy::WorkloadPolicy;

use crate::{
    culling::CullSystems,
    effects::{Effect, is_called_for},
    plugin::ReportSystems,
    systems::budget as systems,
};
use controller::Controller;
use measure::{FrameTimes, RenderClock};
use workload::DemandProfile;

/// On a camera: holds the app's frame time to a target by moving other effects' knobs, those with the least visible
/// loss first, and gives them back in reverse.
///
/// Frame time is the app's, not a camera's: where several active cameras have a budget, the strictest target holds, by
/// its own clock, and the same is demanded of all of them. A target that is not finite and above 0 asks for nothing.
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// # let target = headless::target();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let world = app.world_mut();
/// let camera = world
///     .spawn((
///         Camera3d::default(),
///         target,
///         FrameBudget::from_hz(60.0),
///         // What it may move: each effect on the camera is a knob.
///         ContributionCulling::default(),
///         TerrainRayCasting::default(),
///     ))
///     .id();
/// # app.update();
///
/// let budget = app.world().get::<BudgetState>(camera).expect("required by the budget");
/// // No frame has been measured yet, so that no knob is moved.
/// assert_eq!(budget.status, BudgetStatus::NoMeasurement);
/// let knobs = app.world().resource::<Knobs>();
/// assert!(knobs.get("terrain_error").is_some());
/// ```
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
#[require(BudgetState)]
#[component(on_remove = give_back)]
pub struct FrameBudget {
    /// What a frame may take; zero, negative and non-finite times ask for nothing. default: 16.7, units: ms
    pub target_ms: f32,
    /// Which time is held.
    pub clock: BudgetClock,
}

/// 60 frames a second.
impl Default for FrameBudget {
    fn default() -> Self {
        Self::from_hz(60.0)
    }
}

impl FrameBudget {
    /// So many frames a second.
    pub fn from_hz(hz: f32) -> Self {
        Self::from_ms(1_000.0 / hz)
    }

    /// So many milliseconds a frame.
    pub fn from_ms(target_ms: f32) -> Self {
        Self {
            target_ms,
            clock: BudgetClock::default(),
        }
    }
}

/// Nothing is demanded of the camera any more.
fn give_back(mut world: DeferredWorld, context: HookContext) {
    systems::give_back(&mut world, context.entity);
    // The camera may be on its way out.
    if let Ok(mut camera) = world.commands().get_entity(context.entity) {
        camera.try_remove::<BudgetState>();
    }
}

/// Which time a [`FrameBudget`] holds.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum BudgetClock {
    /// The longest of what the main world, the render world and the GPU worked on a frame; waiting for the display is
    /// not work.
    #[default]
    Work,
    /// From one frame's start to the next one's, waiting included.
    Interval,
    /// What is put into [`GivenFrameTimes`].
    Given,
}

/// Frame times for [`BudgetClock::Given`].
#[derive(Resource, Clone, Debug, Default)]
pub struct GivenFrameTimes {
    /// What the last frame took, until it is read. Zero, negative and non-finite times count as missing. units: ms
    pub last_ms: Option<f32>,
}

/// How a [`FrameBudget`] stands.
#[derive(Component, Reflect, Clone, Debug, Default, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct BudgetState {
    /// What the last measured frame took. units: ms
    pub measured_ms: Option<f32>,
    /// What this frame was predicted to take. units: ms
    pub predicted_ms: Option<f32>,
    /// What is demanded of contribution culling: an object without triangles goes below this, others below more (see
    /// [`rank`](crate::contribution::rank)). units: px²
    pub demanded_px2: f32,
    /// In short.
    pub status: BudgetStatus,
}

/// See [`BudgetState`].
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum BudgetStatus {
    /// No frame time that could be believed has come yet, or none for a while: all knobs stay where they are.
    #[default]
    NoMeasurement,
    /// The target is met with every knob at its best.
    Ample,
    /// The target is met by moving knobs.
    Held,
    /// The target cannot be met with every knob at its cheapest.
    Short,
}

impl From<controller::Status> for BudgetStatus {
    fn from(status: controller::Status) -> Self {
        match status {
            controller::Status::NoMeasurement => Self::NoMeasurement,
            controller::Status::Ample => Self::Ample,
            controller::Status::Held => Self::Held,
            controller::Status::Short => Self::Short,
        }
    }
}

/// What the budget keeps from frame to frame; next to nothing while no camera asks for it.
#[derive(Resource, Default)]
pub struct Budget {
    /// Number of this frame, from 1.
    pub(crate) frame: u64,
    /// Whether a camera asked for it when this frame began, or did until then.
    pub(crate) is_awake: bool,
    pub(crate) was_asked: bool,
    /// Frames that something was chosen in.
    pub(crate) chosen: u64,
    /// Everything large.
    pub(crate) work: Option<Box<BudgetWork>>,
}

/// What is only there while a camera asks.
#[derive(Default)]
pub(crate) struct BudgetWork {
    pub(crate) controller: Controller,
    pub(crate) profile: DemandProfile,
    pub(crate) times: FrameTimes,
    /// Area of each candidate in view, by slot. units: px²
    pub(crate) areas: Vec<f32>,
    /// The strictest of the active cameras' wishes.
    pub(crate) asked: Option<FrameBudget>,
    /// What became known in this frame.
    pub(crate) measured: Option<controller::Measured>,
    pub(crate) quantum_ms: Option<f32>,
    /// Time of choosing. units: ms
    pub(crate) cpu_ms: f32,
}

impl Budget {
    /// Frames in which something was chosen, since the app began.
    pub fn chosen(&self) -> u64 {
        self.chosen
    }

    /// The controller, while a camera asks for it.
    pub fn controller(&self) -> Option<&Controller> {
        self.work.as_deref().map(|work| &work.controller)
    }

    /// The frame, if the render world is to time it.
    pub(crate) fn timed_frame(&self) -> Option<u64> {
        let work = self.work.as_deref()?;
        let is_work = work.asked.as_ref()?.clock == BudgetClock::Work;
        is_work.then_some(self.frame)
    }
}

/// The budget's systems, where others may have to run before or after.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BudgetSystems {
    /// In `First`: times of past frames are taken in.
    Begin,
    /// In `First`, after that: values of knobs are put into components.
    ApplyKnobs,
    /// In `PostUpdate`, once it is known what is in view: what is demanded of this frame is chosen.
    Choose,
}

/// Whether a camera asks for a budget, or one just stopped to and is to get its settings back.
pub(crate) fn is_awake(budget: Res<Budget>) -> bool {
    budget.is_awake
}

/// Registers types and main-world systems.
pub(crate) fn register(app: &mut App) {
    app.register_type::<FrameBudget>()
        .register_type::<BudgetState>()
        .init_resource::<GivenFrameTimes>()
        .init_resource::<Knobs>()
        .init_resource::<RenderClock>()
        .init_resource::<Budget>()
        .configure_sets(
            First,
            // What was heard says what is put.
            (BudgetSystems::Begin, BudgetSystems::ApplyKnobs).chain(),
        )
        .add_systems(
            First,
            (systems::wake, systems::begin.run_if(is_awake))
                .chain()
                .in_set(BudgetSystems::Begin)
                // An interval is this frame's.
                .after(bevy::time::TimeSystems),
        )
        .configure_sets(
            PostUpdate,
            BudgetSystems::Choose.after(VisibilitySystems::CheckVisibility),
        )
        .add_systems(
            PostUpdate,
            (
                systems::choose
                    .run_if(is_awake)
                    .in_set(BudgetSystems::Choose),
                // All that is removed has been.
                systems::note_drawn.run_if(is_awake).after(CullSystems),
            ),
        )
        .add_systems(
            Last,
            systems::report_budget
                .run_if(is_called_for::<FrameBudget>(Effect::FrameBudget))
                .in_set(ReportSystems),
        )
        .add_systems(
            Last,
            // The frame's work is done when the others have reported, too.
            systems::end.run_if(is_awake).after(ReportSystems),
        );
    systems::order(app);
    #[cfg(feature = "culling")]
    policy::register(app);
    if let Err(problem) = built_in::register(app) {
        error!("the frame budget lacks knobs: {problem}");
    }
    for diagnostic in [
        Diagnostic::new(systems::MEASURED_MS).with_suffix(" ms"),
        Diagnostic::new(systems::PREDICTED_MS).with_suffix(" ms"),
        Diagnostic::new(systems::DEMANDED_PX2).with_suffix(" px²"),
    ] {
        app.register_diagnostic(diagnostic);
    }
}

/// Registers what times the render world.
pub(crate) fn finish(app: &mut App) {
    measure::add_render_timer(app);
}
