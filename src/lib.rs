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
//! | Where | What | Built |
//! |---|---|---|
//! | [`plugin`] | the plugins: what runs, when and why | always |
//! | [`effects`] | [`Effects`](effects::Effects): what the scene calls for and what it costs | always |
//! | [`terrain`] | the height field, its component, its loaders and its CPU queries | with `terrain` |
//! | [`terrain_shadow`] | the shadows it casts: component, lights, what is done when | with `terrain` |
//! | [`culling`] | in which order cullings take things out of view, and what a game sees of that | always |
//! | | what the next two share: the table of candidates | with `culling` |
//! | [`contribution`] | contribution culling: component, screen areas, which objects go first | with `culling` |
//! | [`occlusion`] | Z-buffer occlusion culling: component, volumes, verdicts, what a game sees of it | with `culling` |
//! | [`budget`] | the frame budget: measuring, model, controller, knobs | with `budget` |
//! | [`resolution`] | resolution scale: the main passes draw fewer pixels | with `budget` |
//! | [`interior`] | interior culling: what of a model is seen from outside; its component | with `interior` |
//! | [`spherical`] | spherical index: the part of a mesh that a camera can see; its component | with `spherical` |
//! | `panel` | a panel over the picture: frame times, effects, knobs, what accuracy costs | with `panel` |
//! | `offline` | what the `skyline` command does: pictures, maps, models, scenes, measurements | with `cli` |
//! | [`systems`] | main-world systems | each with its effect |
//! | [`render_graph`] | the passes and their order | each with its effect |
//! | [`mod@reference`] | `f64` twins that GPU results are compared with | each with its effect |
//! | [`precision`] | what effects that calculate in `f64` have in common | always |
//! | `assets/shaders/` | one WGSL file a pass; `types.wgsl` first | each with its effect |
//!
//! # Features
//! A game pays for what it uses: an effect whose feature is off is not compiled, with its shaders, its passes and the
//! crates that only it needs. [`SkylinePlugins`](plugin::SkylinePlugins) has the plugins of those that are on, and
//! [`Effects`](effects::Effects) names the feature that another one lacks.
//!
//! | Feature | Default | What it builds |
//! |---|---|---|
//! | `terrain` | yes | ray-cast terrain, its shadows, its file formats, its CPU queries |
//! | `culling` | yes | contribution culling and Z-buffer occlusion culling |
//! | `budget` | yes | the frame budget, the workload policies it is compared with (these need `culling`), resolution scale |
//! | `interior` | yes | interior culling |
//! | `spherical` | yes | the spherical index |
//! | `panel` | no | the panel, by `bevy_egui`; it shows what of the above is built |
//! | `cli` | no | the `skyline` command line; all effects with it |
//! | `window` | no | a real window and a flying camera, for the examples |
//!
//! # What games build on
//! The [`prelude`], what it takes from the modules of the effects, and [`plugin`]. The rest is open for tests, tools and the
//! curious: [`systems`], [`render_graph`], [`mod@reference`], [`precision`], `offline` and the modules inside an effect's may
//! change in any version.
//!
//! # The papers
//! P1 *Subdivided-bounding-box terrain ray casting* (GPU quadtree); P2 occlusion culling with the Z-buffer and
//! simplified models; P3 rendering by spherical-coordinate representation; P4 region-based contribution culling
//! for uniform rendering workload; P5 Min Hye-jung 2008, global visibility culling (P5a) and terrain shadow
//! maps (P5b). Docs cite them by these numbers. This version has all of them.

// On docs.rs, every item names the feature that it needs.
#![cfg_attr(docsrs, feature(doc_cfg))]
// The renderer's own types are nested more deeply than 128.
#![recursion_limit = "256"]
// Each effect uses some of what all share. What none uses is found where all are built.
#![cfg_attr(
    not(all(
        feature = "terrain",
        feature = "culling",
        feature = "budget",
        feature = "interior",
        feature = "spherical"
    )),
    allow(dead_code)
)]

#[cfg(feature = "budget")]
pub mod budget;
#[cfg(feature = "culling")]
pub mod contribution;
pub mod culling;
mod device_errors;
pub mod effects;
#[cfg(feature = "interior")]
pub mod interior;
#[cfg(feature = "culling")]
pub mod occlusion;
#[cfg(feature = "cli")]
pub mod offline;
#[cfg(feature = "terrain")]
mod one_line;
#[cfg(feature = "panel")]
pub mod panel;
pub mod plugin;
pub mod precision;
pub mod reference;
pub mod render_graph;
#[cfg(feature = "budget")]
pub mod resolution;
#[cfg(feature = "spherical")]
pub mod spherical;
pub mod systems;
#[cfg(feature = "terrain")]
pub mod terrain;
#[cfg(feature = "terrain")]
pub mod terrain_shadow;

/// What an app usually needs, of what is built.
pub mod prelude {
    #[cfg(all(feature = "budget", feature = "culling"))]
    pub use crate::budget::WorkloadPolicy;
    #[cfg(feature = "panel")]
    pub use crate::panel::{PanelPlugin, SkylinePanel};
    #[cfg(feature = "budget")]
    pub use crate::{
        budget::{
            AppKnobs, BudgetClock, BudgetState, BudgetStatus, BudgetSystems, FrameBudget,
            GivenFrameTimes, Knob, KnobCost, KnobOn, KnobStep, Knobs,
        },
        plugin::{BudgetPlugin, ResolutionPlugin},
        resolution::ResolutionScale,
    };
    #[cfg(feature = "culling")]
    pub use crate::{
        contribution::{
            ContributionCounts, ContributionCulling, ContributionExit, NoContributionCulling,
        },
        occlusion::{
            DepthSampling, NoOcclusionCulling, OccludeeVolume, OcclusionCounts, Recheck,
            ZBufferOcclusion,
        },
        plugin::{ContributionPlugin, OcclusionPlugin},
    };
    pub use crate::{
        culling::{CullReason, CullSystems, CulledEntities, Culling},
        effects::{Activity, Effect, EffectState, Effects},
        plugin::{EffectsPlugin, SkylinePlugins},
    };
    #[cfg(feature = "interior")]
    pub use crate::{
        interior::{
            FieldBy, InteriorCounts, InteriorCulling, InteriorFaces, InteriorGrid, InteriorLevel,
            InteriorMode, InteriorTransparent, NoInteriorCulling,
        },
        plugin::InteriorPlugin,
    };
    #[cfg(feature = "spherical")]
    pub use crate::{
        plugin::SphericalPlugin,
        spherical::{
            Bins, ChunkOf, SphericalAppExt, SphericalCounts, SphericalIndex, SphericalMode,
        },
    };
    #[cfg(feature = "terrain")]
    pub use crate::{
        plugin::TerrainPlugin,
        terrain::{
            HeightField, HeightFieldPlugin, HeightFieldSettings, HitSide, Terrain, TerrainColour,
            TerrainHit, TerrainLook, TerrainQuery, TerrainRayCasting, Traversal, VoidHandling,
        },
        terrain_shadow::{ExactLight, ShadowMethod, ShadowedLights, TerrainShadow},
    };
}

/// Every Rust block of the documents is compiled, and run unless it opens a window.
#[cfg(doctest)]
mod documents {
    macro_rules! documents {
        ($($name:ident: $path:literal,)*) => {
            $(#[doc = include_str!($path)] mod $name {})*
        };
    }
    documents! {
        readme: "../README.md",
        accuracy: "../docs/accuracy.md",
        architecture: "../docs/architecture.md",
        frame_budget: "../docs/frame_budget.md",
        hard_cases: "../docs/hard_cases.md",
        interior_culling: "../docs/interior_culling.md",
        occlusion: "../docs/occlusion.md",
        spherical_index: "../docs/spherical_index.md",
        terrain: "../docs/terrain.md",
        terrain_shadow: "../docs/terrain_shadow.md",
    }
}
