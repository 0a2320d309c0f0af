//! There is no terrain to be cast.

use bevy::ecs::system::SystemParam;

use crate::budget::workload::Workload;

/// None.
#[derive(SystemParam)]
pub struct Rays;

impl Rays {
    /// No work.
    pub(super) fn of(&self, _picture_px2: f64) -> Workload {
        Workload::default()
    }
}
