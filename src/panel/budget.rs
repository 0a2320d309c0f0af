//! What the panel asks of the frame budget.

use bevy::{ecs::system::SystemParam, prelude::*};

use super::data::{BudgetRow, KnobRow, Measured, TimeOf};
use crate::budget::{BudgetClock, BudgetState, BudgetStatus, FrameBudget, Knob, Knobs};

/// The budgets and the knobs, to be looked at.
#[derive(SystemParam)]
pub struct BudgetSource<'w, 's> {
    knobs: Option<Res<'w, Knobs>>,
    budgets: Query<'w, 's, (&'static Camera, &'static FrameBudget, &'static BudgetState)>,
}

/// The knobs, to be taken by hand.
#[derive(SystemParam)]
pub struct KnobHand<'w>(Option<ResMut<'w, Knobs>>);

impl BudgetSource<'_, '_> {
    /// The strictest budget of an active camera, and what it measures, if it measures anything.
    pub(super) fn strictest(&self) -> Option<(BudgetRow, Option<Measured>)> {
        let active = self.budgets.iter().filter(|(camera, ..)| camera.is_active);
        let (_, budget, state) =
            active.min_by(|(_, a, _), (_, b, _)| a.target_ms.total_cmp(&b.target_ms))?;
        let time_of = match budget.clock {
            BudgetClock::Interval => TimeOf::Interval,
            BudgetClock::Work => TimeOf::Work,
            BudgetClock::Given => TimeOf::Given,
        };
        let is_measured = state.status != BudgetStatus::NoMeasurement;
        let measured = is_measured.then_some((time_of, state.measured_ms));
        Some((BudgetRow::of(budget, state), measured))
    }

    /// Every knob in the scene, in the order of registration.
    pub(super) fn knobs(&self) -> impl Iterator<Item = KnobRow> {
        let knobs = self.knobs.as_deref().into_iter();
        knobs.flat_map(|knobs| knobs.iter().map(KnobRow::of))
    }
}

impl KnobHand<'_> {
    /// See [`Knobs::set_manual`].
    pub(super) fn set_manual(&mut self, knob: &str, step: Option<usize>) {
        if let Some(knobs) = &mut self.0 {
            knobs.set_manual(knob, step);
        }
    }
}

impl BudgetRow {
    /// Of a budget.
    pub fn of(budget: &FrameBudget, state: &BudgetState) -> Self {
        let (is_met, words) = match state.status {
            BudgetStatus::NoMeasurement => (None, "no measurement: knobs stay where they are"),
            BudgetStatus::Ample => (Some(true), "target met with every knob at its best"),
            BudgetStatus::Held => (Some(true), "target met by moving knobs"),
            BudgetStatus::Short => (
                Some(false),
                "target not met with every knob at its cheapest",
            ),
        };
        Self {
            target_ms: budget.target_ms,
            predicted_ms: state.predicted_ms,
            demanded_px2: state.demanded_px2,
            is_met,
            words,
        }
    }
}

impl KnobRow {
    fn of(knob: &Knob) -> Self {
        Self {
            name: knob.name,
            unit: knob.unit,
            values: knob.steps.iter().map(|step| step.value).collect(),
            at: knob.at,
            value: knob.value(),
            manual: knob.manual,
            saves_ms: knob.saves_ms,
        }
    }
}
