//! The frame budget, and the knob that needs a plugin of its own.

use bevy::prelude::*;

use super::{EffectsPlugin, ReportSystems};
use crate::{
    budget,
    effects::{Effect, is_called_for},
    render_graph::{self, upscale::ScaleStats},
    resolution::{self, ResolutionScale},
    systems::resolution::{ScaleDiagnosticPaths, report_scale},
};

/// Resolution scale of the main passes.
pub struct ResolutionPlugin;

impl Plugin for ResolutionPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EffectsPlugin>() {
            app.add_plugins(EffectsPlugin);
        }
        render_graph::shaders::upscale::embed(app);
        resolution::register(app);
        app.init_resource::<ScaleStats>()
            .init_resource::<ScaleDiagnosticPaths>()
            .add_systems(
                Last,
                report_scale
                    .run_if(is_called_for::<ResolutionScale>(Effect::ResolutionScale))
                    .in_set(ReportSystems),
            );
    }

    fn finish(&self, app: &mut App) {
        render_graph::upscale::add_upscale_pass(app);
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
