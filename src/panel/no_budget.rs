//! There is no frame budget for the panel to ask.

use bevy::ecs::system::SystemParam;

use super::data::{BudgetRow, KnobRow, Measured};

/// No budget, no knob.
#[derive(SystemParam)]
pub struct BudgetSource;

/// No knob to be taken.
#[derive(SystemParam)]
pub struct KnobHand;

impl BudgetSource {
    /// None.
    pub(super) fn strictest(&self) -> Option<(BudgetRow, Option<Measured>)> {
        None
    }

    /// None.
    pub(super) fn knobs(&self) -> impl Iterator<Item = KnobRow> {
        core::iter::empty()
    }
}

impl KnobHand {
    /// Changes nothing.
    pub(super) fn set_manual(&mut self, _knob: &str, _step: Option<usize>) {}
}
