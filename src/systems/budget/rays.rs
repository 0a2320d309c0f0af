//! The rays that terrain is cast with.

use bevy::{ecs::system::SystemParam, prelude::*};

use crate::{budget::workload::Workload, render_graph::stats::TerrainStats};

/// What tells whether terrain is cast.
#[derive(SystemParam)]
pub struct Rays<'w>(Option<Res<'w, TerrainStats>>);

impl Rays<'_> {
    /// One for each pixel, if any terrain is cast. units: px²
    pub(super) fn of(&self, picture_px2: f64) -> Workload {
        let is_cast = (self.0.as_deref()).is_some_and(|stats| stats.lock().views_drawn > 0);
        Workload {
            rays: if is_cast { picture_px2 } else { 0.0 },
            ..default()
        }
    }
}
