//! The plugins: what runs, when, and why. Each works alone; [`SkylinePlugins`] is all of them that are built.
//!
//! | Plugin | Components | Main world | Render world |
//! |---|---|---|---|
//! | [`EffectsPlugin`] | – | the [`Effects`] resource | – |
//! | [`TerrainPlugin`] | [`Terrain`](crate::terrain::Terrain), [`TerrainRayCasting`](crate::terrain::TerrainRayCasting) | `report_terrain` in `Last` | see [`render_graph`](crate::render_graph) |
//! | the same | [`TerrainShadow`](crate::terrain_shadow::TerrainShadow), [`ExactLight`](crate::terrain_shadow::ExactLight) | `report_terrain_shadow` in `Last` | see [`render_graph::terrain_shadow`](mod@crate::render_graph::terrain_shadow) |
//! | [`ContributionPlugin`] | [`ContributionCulling`](crate::contribution::ContributionCulling), [`NoContributionCulling`](crate::contribution::NoContributionCulling) | `measure_areas`, `cull_small`, `fade_small`, `forget_small` in `PostUpdate`, in [`CullSteps::Contribution`](crate::culling::CullSteps); `report_contribution` in `Last` | see [`render_graph::contribution`](mod@crate::render_graph::contribution) |
//! | [`OcclusionPlugin`] | [`ZBufferOcclusion`](crate::occlusion::ZBufferOcclusion), [`NoOcclusionCulling`](crate::occlusion::NoOcclusionCulling) | `cull_occluded`, `forget_occluded` in `PostUpdate`, in [`CullSteps::Occlusion`](crate::culling::CullSteps); `report_occlusion` in `Last` | see [`render_graph::occlusion`](crate::render_graph::occlusion) |
//! | both | – | `build_mesh_volumes`, `update_candidates` in `PostUpdate`, in [`CullSteps::Candidates`](crate::culling::CullSteps) after `CheckVisibility` | – |
//! | [`InteriorPlugin`] | [`InteriorCulling`](crate::interior::InteriorCulling), [`NoInteriorCulling`](crate::interior::NoInteriorCulling) | `follow_device`, `follow_models`, `watch_parts`, `restore_parts`, `advance_models`, `hide_parts` in `PostUpdate`, in [`InteriorSystems`](crate::systems::interior::InteriorSystems), then `keep_hidden` before `CheckVisibility`; `report_interior` in `Last` | `note_uploads`, see [`render_graph`](crate::render_graph) |
//! | [`SphericalPlugin`] | [`SphericalIndex`](crate::spherical::SphericalIndex) | `follow_material`, `follow_paint`, `follow_indexed`, `advance_indices`, `spawn_chunks` in `PostUpdate`, in [`SphericalSteps`](crate::systems::spherical::SphericalSteps), then `select_chunks` in [`CullSteps::Selection`](crate::culling::CullSteps); `report_spherical` in `Last` | `note_uploads`, see [`render_graph`](crate::render_graph) |
//! | [`ResolutionPlugin`] | [`ResolutionScale`](crate::resolution::ResolutionScale) | – | see [`render_graph::upscale`](mod@crate::render_graph::upscale) |
//! | [`BudgetPlugin`] | [`FrameBudget`](crate::budget::FrameBudget), [`WorkloadPolicy`](crate::budget::WorkloadPolicy) | `wake` each frame; where asked for: `begin` and the knobs in `First`, `choose` in [`BudgetSystems::Choose`](crate::budget::BudgetSystems), `follow_policy` after it (with the feature `culling`), `note_drawn` after [`CullSystems`](crate::culling::CullSystems), `end` in `Last`; `report_budget` in `Last` | its time, see `budget::measure` |
//! | `PanelPlugin` (feature `panel`; not in the group) | – | while the panel is open: `draw_panel` in `PostUpdate`, `gather` in `Last` | `bevy_egui`'s pass |
//!
//! An effect whose component is nowhere in the scene costs the question whether it is, and nothing else: its systems are
//! not run, and there is no pipeline, no GPU memory, no pass.

#[cfg(feature = "budget")]
mod budget;
#[cfg(feature = "culling")]
mod culling;
#[cfg(feature = "interior")]
mod interior;
#[cfg(feature = "spherical")]
mod spherical;
#[cfg(feature = "terrain")]
mod terrain;
#[cfg(test)]
mod tests;

use bevy::{app::PluginGroupBuilder, prelude::*};

#[cfg(feature = "budget")]
pub use budget::{BudgetPlugin, ResolutionPlugin};
#[cfg(feature = "culling")]
pub use culling::{ContributionPlugin, OcclusionPlugin};
#[cfg(feature = "interior")]
pub use interior::InteriorPlugin;
#[cfg(feature = "spherical")]
pub use spherical::SphericalPlugin;
#[cfg(feature = "terrain")]
pub use terrain::TerrainPlugin;

use crate::effects::{Effects, note_changes};

/// Every effect of the suite that is built.
///
/// | Plugin | What it adds | With the feature |
/// |---|---|---|
/// | [`EffectsPlugin`] | [`Effects`]: which effects the scene calls for, in words | – |
/// | [`TerrainPlugin`] | ray-cast terrain and its shadows | `terrain` |
/// | [`ContributionPlugin`] | what covers too little of the picture is not drawn | `culling` |
/// | [`OcclusionPlugin`] | what the depth buffer hides is not drawn | `culling` |
/// | [`InteriorPlugin`] | what of a model cannot be seen from outside is not drawn | `interior` |
/// | [`SphericalPlugin`] | what of a mesh a camera cannot see it does not draw | `spherical` |
/// | [`ResolutionPlugin`] | the main passes draw fewer pixels | `budget` |
/// | [`BudgetPlugin`] | frame time is held by moving the others' knobs | `budget` |
pub struct SkylinePlugins;

impl PluginGroup for SkylinePlugins {
    fn build(self) -> PluginGroupBuilder {
        let group = PluginGroupBuilder::start::<Self>().add(EffectsPlugin);
        #[cfg(feature = "terrain")]
        let group = group.add(TerrainPlugin);
        #[cfg(feature = "culling")]
        let group = group.add(ContributionPlugin).add(OcclusionPlugin);
        #[cfg(feature = "interior")]
        let group = group.add(InteriorPlugin);
        #[cfg(feature = "spherical")]
        let group = group.add(SphericalPlugin);
        #[cfg(feature = "budget")]
        let group = group.add(ResolutionPlugin).add(BudgetPlugin);
        group
    }
}

/// The [`Effects`] resource. Added by every feature plugin that finds it missing.
pub struct EffectsPlugin;

impl Plugin for EffectsPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Effects>()
            .register_type::<Effects>()
            .add_systems(Last, note_changes.after(ReportSystems));
    }
}

/// What reports to [`Effects`]; in `Last`, when the frame's scene is settled.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ReportSystems;
