//! The plugins: what runs, when, and why. Each works alone; [`SkylinePlugins`] is all of them.
//!
//! | Plugin | Components | Main world | Render world |
//! |---|---|---|---|
//! | [`EffectsPlugin`] | – | the [`Effects`] resource | – |
//! | [`TerrainPlugin`] | [`Terrain`](crate::terrain::Terrain), [`TerrainRayCasting`](crate::terrain::TerrainRayCasting) | `report_terrain` in `Last` | see [`render_graph`] |
//! | the same | [`TerrainShadow`](crate::terrain_shadow::TerrainShadow), [`ExactLight`](crate::terrain_shadow::ExactLight) | `report_terrain_shadow` in `Last` | see [`render_graph::terrain_shadow`] |
//! | [`ContributionPlugin`] | [`ContributionCulling`], [`NoContributionCulling`](crate::contribution::NoContributionCulling) | `measure_areas`, `cull_small`, `fade_small`, `forget_small` in `PostUpdate`, in [`CullSteps::Contribution`](crate::culling::CullSteps); `report_contribution` in `Last` | see [`render_graph::contribution`] |
//! | [`OcclusionPlugin`] | [`ZBufferOcclusion`], [`NoOcclusionCulling`](crate::occlusion::NoOcclusionCulling) | `cull_occluded`, `forget_occluded` in `PostUpdate`, in [`CullSteps::Occlusion`](crate::culling::CullSteps); `report_occlusion` in `Last` | see [`render_graph::occlusion`] |
//! | both | – | `build_mesh_volumes`, `update_candidates` in `PostUpdate`, in [`CullSteps::Candidates`](crate::culling::CullSteps) after `CheckVisibility` | – |
//! | [`InteriorPlugin`] | [`InteriorCulling`], [`NoInteriorCulling`](crate::interior::NoInteriorCulling) | `follow_roots`, `watch_parts`, `restore_parts`, `advance_models`, `hide_parts` in `PostUpdate`, in [`InteriorSystems`](systems::interior::InteriorSystems), then `keep_hidden` before `CheckVisibility`; `report_interior` in `Last` | `note_uploads`, see [`render_graph`] |
//! | [`SphericalPlugin`] | [`SphericalIndex`] | `follow_material`, `follow_roots`, `advance_indices`, `spawn_chunks` in `PostUpdate`, in [`SphericalSteps`](systems::spherical::SphericalSteps), then `select_chunks` in [`CullSteps::Selection`](crate::culling::CullSteps); `report_spherical` in `Last` | `note_uploads`, see [`render_graph`] |
//! | [`ResolutionPlugin`] | [`ResolutionScale`](crate::resolution::ResolutionScale) | – | see [`render_graph::upscale`](mod@crate::render_graph::upscale) |
//! | [`BudgetPlugin`] | [`FrameBudget`](crate::budget::FrameBudget), [`WorkloadPolicy`](crate::budget::WorkloadPolicy) | `wake` each frame; where asked for: `begin` and the knobs in `First`, `choose` or `follow_policy` in [`ContributionSteps::Choose`](crate::contribution::ContributionSteps), `note_drawn` after [`CullSystems`](crate::culling::CullSystems), `end` in `Last`; `report_budget` in `Last` | its time, see [`budget::measure`] |
//! | `PanelPlugin` (feature `panel`; not in the group) | – | while the panel is open: `draw_panel` in `PostUpdate`, `gather` in `Last` | `bevy_egui`'s pass |
//!
//! A feature whose component is nowhere in the scene costs the question whether it is, and nothing else: its systems are
//! not run, and there is no pipeline, no GPU memory, no pass.

use bevy::{app::PluginGroupBuilder, prelude::*};

use crate::{
    budget,
    contribution::{self, ContributionCulling},
    effects::{Effect, Effects, is_called_for},
    interior::{self, InteriorCulling},
    occlusion::{self, ZBufferOcclusion},
    render_graph::{
        self, contribution::ContributionStats, occlusion::OcclusionStats, stats::TerrainStats,
    },
    resolution,
    spherical::{self, SphericalIndex},
    systems, terrain, terrain_shadow,
};

/// Every feature of the suite.
///
/// | Plugin | What it adds |
/// |---|---|
/// | [`EffectsPlugin`] | [`Effects`]: which effects the scene calls for, in words |
/// | [`TerrainPlugin`] | ray-cast terrain and its shadows |
/// | [`ContributionPlugin`] | what covers too little of the picture is not drawn |
/// | [`OcclusionPlugin`] | what the depth buffer hides is not drawn |
/// | [`InteriorPlugin`] | what of a model cannot be seen from outside is not drawn |
/// | [`SphericalPlugin`] | what of a mesh a camera cannot see it does not draw |
/// | [`ResolutionPlugin`] | the main passes draw fewer pixels |
/// | [`BudgetPlugin`] | frame time is held by moving the others' knobs |
pub struct SkylinePlugins;

impl PluginGroup for SkylinePlugins {
    fn build(self) -> PluginGroupBuilder {
        PluginGroupBuilder::start::<Self>()
            .add(EffectsPlugin)
            .add(TerrainPlugin)
            .add(ContributionPlugin)
            .add(OcclusionPlugin)
            .add(InteriorPlugin)
            .add(SphericalPlugin)
            .add(ResolutionPlugin)
            .add(BudgetPlugin)
    }
}

/// The [`Effects`] resource. Added by every feature plugin that finds it missing.
pub struct EffectsPlugin;

impl Plugin for EffectsPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Effects>().register_type::<Effects>();
    }
}

/// What reports to [`Effects`]; in `Last`, when the frame's scene is settled.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ReportSystems;

/// Terrain ray cast through subdivided bounding boxes (P1), and the shadows it casts (P5b).
pub struct TerrainPlugin;

impl Plugin for TerrainPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EffectsPlugin>() {
            app.add_plugins(EffectsPlugin);
        }
        terrain::register(app);
        terrain_shadow::register(app);
        render_graph::embed_shaders(app);
        app.init_resource::<TerrainStats>()
            .init_resource::<systems::terrain::TerrainDiagnosticPaths>()
            .add_systems(
                Last,
                (
                    systems::terrain::report_terrain,
                    systems::terrain_shadow::report_terrain_shadow,
                )
                    .chain()
                    .in_set(ReportSystems),
            );
    }

    fn finish(&self, app: &mut App) {
        render_graph::add_terrain_passes(app);
    }
}

/// Contribution culling (P4).
pub struct ContributionPlugin;

impl Plugin for ContributionPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EffectsPlugin>() {
            app.add_plugins(EffectsPlugin);
        }
        if !app.is_plugin_added::<TerrainPlugin>() && !app.is_plugin_added::<OcclusionPlugin>() {
            render_graph::embed_shaders(app);
        }
        contribution::register(app);
        app.init_resource::<ContributionStats>().add_systems(
            Last,
            systems::contribution::report_contribution
                .run_if(is_called_for::<ContributionCulling>(
                    Effect::ContributionCulling,
                ))
                .in_set(ReportSystems),
        );
    }

    fn finish(&self, app: &mut App) {
        render_graph::contribution::add_contribution_passes(app);
    }
}

/// The frame budget.
pub struct BudgetPlugin;

impl Plugin for BudgetPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EffectsPlugin>() {
            app.add_plugins(EffectsPlugin);
        }
        budget::register(app);
    }

    fn finish(&self, app: &mut App) {
        budget::finish(app);
    }
}

/// Z-buffer occlusion culling (P2).
pub struct OcclusionPlugin;

impl Plugin for OcclusionPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EffectsPlugin>() {
            app.add_plugins(EffectsPlugin);
        }
        if !app.is_plugin_added::<TerrainPlugin>() && !app.is_plugin_added::<ContributionPlugin>() {
            render_graph::embed_shaders(app);
        }
        occlusion::register(app);
        app.init_resource::<OcclusionStats>().add_systems(
            Last,
            systems::occlusion::report_occlusion
                .run_if(is_called_for::<ZBufferOcclusion>(Effect::ZBufferOcclusion))
                .in_set(ReportSystems),
        );
    }

    fn finish(&self, app: &mut App) {
        render_graph::occlusion::add_occlusion_passes(app);
    }
}

/// Interior culling (P5a).
pub struct InteriorPlugin;

impl Plugin for InteriorPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EffectsPlugin>() {
            app.add_plugins(EffectsPlugin);
        }
        interior::register(app);
        app.add_systems(
            Last,
            systems::interior::report::report_interior
                .run_if(is_called_for::<InteriorCulling>(Effect::InteriorCulling))
                .in_set(ReportSystems),
        );
    }

    fn finish(&self, app: &mut App) {
        systems::interior::finish(app);
    }
}

/// Spherical index (P3).
pub struct SphericalPlugin;

impl Plugin for SphericalPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EffectsPlugin>() {
            app.add_plugins(EffectsPlugin);
        }
        spherical::register(app);
        app.add_systems(
            Last,
            systems::spherical::report::report_spherical
                .run_if(is_called_for::<SphericalIndex>(Effect::SphericalIndex))
                .in_set(ReportSystems),
        );
    }

    fn finish(&self, app: &mut App) {
        systems::spherical::finish(app);
    }
}

/// Resolution scale of the main passes.
pub struct ResolutionPlugin;

impl Plugin for ResolutionPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<TerrainPlugin>() && !app.is_plugin_added::<OcclusionPlugin>() {
            render_graph::embed_shaders(app);
        }
        resolution::register(app);
    }

    fn finish(&self, app: &mut App) {
        render_graph::upscale::add_upscale_pass(app);
    }
}
