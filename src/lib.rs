//! Bevy plugins that hold a steady frame time in scenes with a large terrain, a city on it and complex models
//! in it.
//!
//! ```no_run
//! use bevy::prelude::*;
//! use bevy_skyline::prelude::*;
//!
//! fn main() -> AppExit {
//!     App::new()
//!         .add_plugins((DefaultPlugins, SkylinePlugins))
//!         .add_systems(Startup, |mut commands: Commands, assets: Res<AssetServer>| {
//!             commands.spawn((
//!                 Camera3d::default(),
//!                 Msaa::Off,
//!                 Transform::from_xyz(0.0, 2000.0, 0.0),
//!                 FrameBudget::from_hz(60.0),     // steady frame time
//!                 ContributionCulling::default(), // drop what covers too few pixels
//!                 ZBufferOcclusion::default(),    // drop what is hidden
//!             ));
//!             commands.spawn((Terrain::new(assets.load("alps.png")), TerrainShadow::default()));
//!             commands.spawn(DirectionalLight { shadow_maps_enabled: true, ..default() });
//!         })
//!         .run()
//! }
//! ```
//!
//! # The house
//! | Where | What |
//! |---|---|
//! | [`plugin`] | the plugins: what runs, when and why |
//! | [`effects`] | [`Effects`](effects::Effects): what the scene calls for and what it costs |
//! | [`terrain`] | the height field, its component, its loaders and its CPU queries |
//! | [`terrain_shadow`] | the shadows it casts: component, lights, what is done when |
//! | [`culling`] | what the cullings share: the table of candidates, and what a game sees of what was removed |
//! | [`contribution`] | contribution culling: component, screen areas, which objects go first |
//! | [`budget`] | the frame budget: measuring, model, controller, knobs |
//! | [`occlusion`] | Z-buffer occlusion culling: component, volumes, verdicts, what a game sees of it |
//! | [`interior`] | interior culling: what of a model is seen from outside; its component |
//! | [`spherical`] | spherical index: the part of a mesh that a camera can see; its component |
//! | [`resolution`] | resolution scale: the main passes draw fewer pixels |
//! | `panel` | a panel over the picture: frame times, effects, knobs, what accuracy costs (feature `panel`) |
//! | `offline` | what the `skyline` command does: pictures, maps, models, scenes, measurements (feature `cli`) |
//! | [`systems`] | main-world systems |
//! | [`render_graph`] | the passes and their order |
//! | [`mod@reference`] | `f64` twins that GPU results are compared with |
//! | `assets/shaders/` | one WGSL file a pass; `types.wgsl` first |
//!
//! # The papers
//! P1 *Subdivided-bounding-box terrain ray casting* (GPU quadtree); P2 occlusion culling with the Z-buffer and
//! simplified models; P3 rendering by spherical-coordinate representation; P4 region-based contribution culling
//! for uniform rendering workload; P5 Min Hye-jung 2008, global visibility culling (P5a) and terrain shadow
//! maps (P5b). Docs cite them by these numbers. This version has all of them.

// The renderer's own types are nested more deeply than 128.
#![recursion_limit = "256"]

pub mod budget;
pub mod contribution;
pub mod culling;
pub mod effects;
pub mod interior;
pub mod occlusion;
#[cfg(feature = "cli")]
pub mod offline;
mod one_line;
#[cfg(feature = "panel")]
pub mod panel;
pub mod plugin;
pub mod reference;
pub mod render_graph;
pub mod resolution;
pub mod spherical;
pub mod systems;
pub mod terrain;
pub mod terrain_shadow;

/// What an app usually needs.
pub mod prelude {
    pub use crate::{
        budget::{
            AppKnobs, BudgetClock, BudgetState, BudgetStatus, FrameBudget, Knobs, WorkloadPolicy,
        },
        contribution::{ContributionCounts, ContributionCulling, Exit, NoContributionCulling},
        culling::{CullReason, CullSystems, CulledEntities, Culling},
        effects::{Activity, Effect, EffectState, Effects},
        interior::{
            Faces, Grid, InteriorCounts, InteriorCulling, Level, Mode, NoInteriorCulling,
            Transparent,
        },
        occlusion::{
            NoOcclusionCulling, OccludeeVolume, OcclusionCounts, Recheck, Sampling,
            ZBufferOcclusion,
        },
        plugin::{
            BudgetPlugin, ContributionPlugin, EffectsPlugin, InteriorPlugin, OcclusionPlugin,
            ResolutionPlugin, SkylinePlugins, SphericalPlugin, TerrainPlugin,
        },
        resolution::ResolutionScale,
        spherical::{SphericalAppExt, SphericalCounts, SphericalIndex, SphericalMode},
        terrain::{
            HeightField, HeightFieldPlugin, HeightFieldSettings, Terrain, TerrainColour,
            TerrainHit, TerrainLook, TerrainQuery, TerrainRayCasting, Traversal,
        },
        terrain_shadow::{ExactLight, ShadowMethod, ShadowedLights, TerrainShadow},
    };
}
