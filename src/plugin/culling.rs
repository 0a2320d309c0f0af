//! The two cullings that compare with the picture.

use bevy::prelude::*;

use super::{EffectsPlugin, ReportSystems};
use crate::{
    contribution::{self, ContributionCulling},
    effects::{Effect, is_called_for},
    occlusion::{self, ZBufferOcclusion},
    render_graph::{self, contribution::ContributionStats, occlusion::OcclusionStats},
    systems,
};

/// Contribution culling (P4).
pub struct ContributionPlugin;

impl Plugin for ContributionPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EffectsPlugin>() {
            app.add_plugins(EffectsPlugin);
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

/// Z-buffer occlusion culling (P2).
pub struct OcclusionPlugin;

impl Plugin for OcclusionPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EffectsPlugin>() {
            app.add_plugins(EffectsPlugin);
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
