//! Contribution culling (P4): what covers too little of the picture is not drawn.
//!
//! # Guarantee
//! An object's area is that of the smallest rectangle around its projected bound, in pixels, cut to the viewport and
//! at the near plane ([`area`]). It is never below what the object covers; what cannot be calculated with is infinite
//! and stays. An object leaves when its area falls below the threshold and comes back when it reaches the threshold
//! times the hysteresis, so that nothing flickers. Nothing but the camera's own picture changes: shadows stay, other
//! cameras keep what they see, and what is left keeps its order.
//!
//! A [`FrameBudget`](crate::budget::FrameBudget) on the same camera takes more, and first what costs much for what it
//! covers ([`rank`]).
//!
//! # What the depth buffer shows of it
//! Where [`ZBufferOcclusion`](crate::occlusion::ZBufferOcclusion) works on the same camera, an area counts only as far
//! as it lies open in the newest depth that has come back from the GPU: the share of the rectangle, seen from the camera
//! that drew that depth, where nothing nearer was drawn. That depth is some frames old. What comes out from behind
//! something is therefore weighed by less than it shows for as many frames; it counts with at least 1/16 of its area, so
//! that whatever covers 16 times your threshold is not left out for it. So the weighed threshold bounds what is seen of an object
//! that is left out only where camera and scene are at rest; the bound that always holds is 16 times the threshold.
//! Without [`weigh_by_visibility`](ContributionCulling::weigh_by_visibility) it is the threshold itself.
//!
//! # On the GPU
//! From [`gpu_from`](ContributionCulling::gpu_from) entities in view on, a pass measures the same areas by the same
//! arithmetic and takes what is too small out of the camera's draws in the same frame
//! ([`render_graph::contribution`](crate::render_graph::contribution)). A driver may round otherwise than the CPU, within
//! what is allowed for: areas are not below the exact one there either, and verdicts differ only within that of the
//! threshold. The entities stay in `VisibleEntities`;
//! [`CulledEntities`] and the counts say some frames late which were left out. The CPU measures all the same where the
//! camera has a [`FrameBudget`](crate::budget::FrameBudget), a
//! [`WorkloadPolicy`](crate::budget::WorkloadPolicy), [`ZBufferOcclusion`](crate::occlusion::ZBufferOcclusion),
//! Bevy's `OcclusionCulling`, `NoIndirectDrawing` or [`ContributionExit::Dithered`], where anything in the scene has `NoCpuCulling`,
//! and where the GPU cannot draw indirectly.

pub mod area;
pub mod fade;
pub mod rank;

use bevy::{diagnostic::RegisterDiagnostic, prelude::*};

use rank::Standard;

use crate::{
    culling::{CullSteps, CulledEntities, bits::Bits},
    effects::{Effect, is_called_for},
    occlusion::camera::Mailbox,
    systems::{
        candidates, contribution as systems,
        contribution_fade::{fade_small, take_ranges_back},
    },
};
use area::AreaView;
use fade::Fades;

/// On a camera: what covers fewer square pixels than this is not drawn.
///
/// Candidates are entities with `Mesh3d`; see [`NoContributionCulling`] for how to leave one out. A
/// [`FrameBudget`](crate::budget::FrameBudget) on the same camera takes as much more as time demands ([`rank`]), and
/// never less than the one set here.
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// # let target = headless::target();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let world = app.world_mut();
/// # let cube = world.resource_mut::<Assets<Mesh>>().add(Cuboid::from_length(1.0));
/// let camera = world.spawn((Camera3d::default(), target, ContributionCulling::default())).id();
/// // A cube of a metre, 10 m and 1 km ahead.
/// let near = world.spawn((Mesh3d(cube.clone()), Transform::from_xyz(0.0, 0.0, -10.0))).id();
/// let far = world.spawn((Mesh3d(cube), Transform::from_xyz(0.0, 0.0, -1000.0))).id();
/// # app.update();
/// # app.update();
///
/// let culled = app.world().get::<CulledEntities>(camera).expect("required by the culling");
/// assert_eq!(culled.reason(near), None);
/// assert_eq!(culled.reason(far), Some(CullReason::Contribution));
/// ```
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
#[require(ContributionCamera, CulledEntities, ContributionCounts)]
pub struct ContributionCulling {
    /// What covers less is not drawn. 0, and what is no number, draws all. units: px², range: 0.., default: 16
    pub threshold_px2: f32,
    /// How many times the threshold it takes to come back; what is out of range counts as 1. range: 1.., default: 1.25
    pub hysteresis: f32,
    /// How an object leaves and comes back.
    pub exit: ContributionExit,
    /// Whether an object's area counts only as far as the depth buffer shows it, where
    /// [`ZBufferOcclusion`](crate::occlusion::ZBufferOcclusion) works on the same camera. default: true
    pub weigh_by_visibility: bool,
    /// From so many meshes in view on, areas are compared by the GPU. The verdicts are the same, but for
    /// rounding. default: 50,000
    pub gpu_from: usize,
}

impl Default for ContributionCulling {
    fn default() -> Self {
        Self {
            threshold_px2: 16.0,
            hysteresis: 1.25,
            exit: ContributionExit::default(),
            weigh_by_visibility: true,
            gpu_from: 50_000,
        }
    }
}

/// How an object leaves the picture and comes back.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub enum ContributionExit {
    /// From one frame to the next.
    #[default]
    Cut,
    /// Dithered, pixel by pixel, in 16 steps; with Bevy's own dither, so that materials stay as they are. For that the
    /// entity has a `VisibilityRange` for as long as it takes, and its shadow is dithered with it: once the entity has
    /// gone its shadow is whole again. Entities that came into view only this frame, that have a `VisibilityRange` of
    /// their own, or that another active camera sees are cut.
    Dithered {
        /// How long it takes. units: s, range: above 0; else it is a cut
        seconds: f32,
    },
}

/// On an entity with a mesh: it is never removed by [`ContributionCulling`].
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// # let target = headless::target();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let world = app.world_mut();
/// # let cube = world.resource_mut::<Assets<Mesh>>().add(Cuboid::from_length(1.0));
/// let camera = world.spawn((Camera3d::default(), target, ContributionCulling::default())).id();
/// // Both cover less than a pixel; one is what the player looks for.
/// let far = Transform::from_xyz(0.0, 0.0, -1000.0);
/// let stone = world.spawn((Mesh3d(cube.clone()), far)).id();
/// let beacon = world.spawn((Mesh3d(cube), far, NoContributionCulling)).id();
/// # app.update();
/// # app.update();
///
/// let culled = app.world().get::<CulledEntities>(camera).expect("required by the culling");
/// assert_eq!(culled.reason(stone), Some(CullReason::Contribution));
/// assert_eq!(culled.reason(beacon), None);
/// ```
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct NoContributionCulling;

/// What contribution culling did for a camera this frame.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct ContributionCounts {
    /// Candidates in view.
    pub candidates: u32,
    /// Of these, removed.
    pub removed: u32,
    /// Triangles of the candidates in view, and of those that were not removed.
    pub triangles: u64,
    /// Those of [`triangles`](Self::triangles) whose meshes were not removed.
    pub triangles_drawn: u64,
    /// The threshold of the settings. units: px²
    pub threshold_px2: f32,
    /// What a [`FrameBudget`](crate::budget::FrameBudget) demanded beyond that; see [`rank`]. units: px²
    pub demanded_px2: f32,
    /// Whether the GPU compared.
    pub on_gpu: bool,
    /// Time of measuring areas and removing. units: ms
    pub cpu_ms: f32,
}

/// What a camera with [`ContributionCulling`] keeps from frame to frame. By slots of
/// [`Candidates`](crate::culling::candidates::Candidates).
#[derive(Component, Default)]
#[component(on_remove = take_ranges_back)]
pub struct ContributionCamera {
    /// Too small when last looked at.
    pub(crate) removed: Bits,
    /// Area of each entity in `VisibleEntities`, in its order; infinite for what is no candidate, and for all where the
    /// GPU measures. units: px²
    pub(crate) areas: Vec<f32>,
    /// Slot of each entity in `VisibleEntities`, in its order; `NO_SLOT` for what is no candidate.
    pub(crate) slots: Vec<u32>,
    /// What a [`FrameBudget`](crate::budget::FrameBudget) demands, see [`rank`]. units: px²
    pub(crate) demanded_px2: f32,
    /// What objects are held to beside.
    pub(crate) standard: Standard,
    /// Which table slots are of.
    pub(crate) epoch: u32,
    /// In view last frame and this frame, where objects fade.
    pub(crate) in_view: Bits,
    pub(crate) in_view_now: Bits,
    /// What comes and goes.
    pub(crate) fades: Fades,
    /// The view, where the GPU measures this frame.
    pub(crate) gpu: Option<AreaView>,
    /// Slots that it is to measure.
    pub(crate) asked: Bits,
    /// Below which area an object leaves, and from which on it comes back, for the GPU. units: px²
    pub(crate) thresholds: (f32, f32),
    /// Where its verdicts come back.
    pub(crate) mailbox: Mailbox,
}

/// Registers types and main-world systems.
pub(crate) fn register(app: &mut App) {
    candidates::register(app);
    app.register_type::<ContributionCulling>()
        .register_type::<NoContributionCulling>()
        .register_type::<ContributionCounts>()
        .init_resource::<systems::ContributionDiagnosticPaths>()
        .configure_sets(
            PostUpdate,
            (
                ContributionSteps::Measure,
                ContributionSteps::Choose,
                ContributionSteps::Remove,
            )
                .chain()
                .in_set(CullSteps::Contribution),
        )
        .configure_sets(
            PostUpdate,
            (ContributionSteps::Measure, ContributionSteps::Remove).run_if(is_called_for::<
                ContributionCulling,
            >(
                Effect::ContributionCulling,
            )),
        )
        .add_systems(
            PostUpdate,
            (
                systems::measure_areas.in_set(ContributionSteps::Measure),
                (systems::cull_small, fade_small, systems::forget_small)
                    .chain()
                    .in_set(ContributionSteps::Remove),
            ),
        );
    for diagnostic in systems::diagnostics() {
        app.register_diagnostic(diagnostic);
    }
}

/// The steps of [`CullSteps::Contribution`].
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ContributionSteps {
    /// Areas of what is in view are measured.
    Measure,
    /// A frame budget chooses what it demands beyond the threshold.
    Choose,
    /// What is below either is removed.
    Remove,
}
