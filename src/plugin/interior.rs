//! Interior culling.

use bevy::prelude::*;

use super::{EffectsPlugin, ReportSystems};
use crate::{
    effects::{Effect, is_called_for},
    interior::{self, InteriorCulling},
    systems,
};

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
