//! Contribution culling (P4): what covers too little of the picture is not drawn.
//!
//! An object's area is that of the smallest rectangle around its projected bound, in pixels, cut to the viewport and
//! at the near plane ([`area`]). It is never below what the object covers; what cannot be calculated with is infinite
//! and stays. An object leaves when its area falls below the threshold and comes back when it exceeds the threshold
//! by the hysteresis, so that nothing flickers. Nothing but the camera's own picture changes: shadows stay, other
//! cameras keep what they see.

pub mod area;

use bevy::{diagnostic::RegisterDiagnostic, prelude::*};

use crate::{
    culling::{self, CullSteps, CulledEntities, bits::Bits},
    systems::contribution as systems,
};

/// On a camera: what covers fewer square pixels than this is not drawn.
///
/// Candidates are entities with `Mesh3d`; see [`NoContributionCulling`] for how to leave one out. A
/// [`FrameBudget`](crate::budget::FrameBudget) on the same camera raises the threshold as far as time demands, never
/// below the one set here.
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
#[require(ContributionCamera, CulledEntities, ContributionCounts)]
pub struct ContributionCulling {
    /// What covers less is not drawn. 0 draws all. units: px², default: 16
    pub threshold_px2: f32,
    /// How many times the threshold it takes to come back. range: 1.., default: 1.25
    pub hysteresis: f32,
    /// How an object leaves and comes back.
    pub exit: Exit,
    /// Whether an object's area counts only as far as the depth buffer shows it, where
    /// [`ZBufferOcclusion`](crate::occlusion::ZBufferOcclusion) works on the same camera.
    pub weigh_by_visibility: bool,
    /// From so many candidates in view on, areas are compared by the GPU. The verdicts are the same. default: 50,000
    pub gpu_from: usize,
}

impl Default for ContributionCulling {
    fn default() -> Self {
        Self {
            threshold_px2: 16.0,
            hysteresis: 1.25,
            exit: Exit::default(),
            weigh_by_visibility: true,
            gpu_from: 50_000,
        }
    }
}

/// How an object leaves the picture and comes back.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub enum Exit {
    /// From one frame to the next.
    #[default]
    Cut,
    /// Dithered, pixel by pixel.
    Dithered {
        /// How long it takes. units: s
        seconds: f32,
    },
}

/// On an entity with a mesh: it is never removed by [`ContributionCulling`].
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
    /// See [`triangles`](Self::triangles).
    pub triangles_drawn: u64,
    /// The threshold that held this frame. units: px²
    pub threshold_px2: f32,
    /// Whether the GPU compared.
    pub on_gpu: bool,
    /// Time of measuring areas and removing. units: ms
    pub cpu_ms: f32,
}

/// What a camera with [`ContributionCulling`] keeps from frame to frame. By slots of
/// [`Candidates`](crate::culling::candidates::Candidates).
#[derive(Component, Default)]
pub struct ContributionCamera {
    /// Removed in the last frame.
    pub(crate) removed: Bits,
    /// Area of each entity in `VisibleEntities`, in its order; infinite for what is no candidate. units: px²
    pub(crate) areas: Vec<f32>,
    /// What a [`FrameBudget`](crate::budget::FrameBudget) demands. units: px²
    pub(crate) demanded_px2: f32,
}

/// Registers types and main-world systems.
pub(crate) fn register(app: &mut App) {
    culling::register(app);
    app.register_type::<ContributionCulling>()
        .register_type::<NoContributionCulling>()
        .register_type::<ContributionCounts>()
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
        .add_systems(
            PostUpdate,
            (
                systems::measure_areas.in_set(ContributionSteps::Measure),
                (systems::cull_small, systems::forget_small)
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
    /// A frame budget chooses the threshold.
    Choose,
    /// What is below the threshold is removed.
    Remove,
}
