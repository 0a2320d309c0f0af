//! Terrain and its shadows.

use bevy::prelude::*;

use super::{EffectsPlugin, ReportSystems};
use crate::{
    render_graph::{self, stats::TerrainStats},
    systems, terrain, terrain_shadow,
};

/// Terrain ray cast through subdivided bounding boxes (P1), and the shadows it casts (P5b).
pub struct TerrainPlugin;

impl Plugin for TerrainPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EffectsPlugin>() {
            app.add_plugins(EffectsPlugin);
        }
        terrain::register(app);
        terrain_shadow::register(app);
        render_graph::shaders::terrain::embed(app);
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
        render_graph::terrain_passes::add_terrain_passes(app);
    }
}
