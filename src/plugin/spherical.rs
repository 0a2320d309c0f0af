//! Spherical index.

use bevy::prelude::*;

use super::{EffectsPlugin, ReportSystems};
use crate::{
    effects::{Effect, is_called_for},
    spherical::{self, SphericalIndex},
    systems,
};

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
