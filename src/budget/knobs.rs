//! What a frame budget can move.

use bevy::prelude::*;

/// Everything that a [`FrameBudget`](super::FrameBudget) may move, in the order of registration.
#[derive(Resource, Default)]
pub struct Knobs {
    list: Vec<Knob>,
}

/// A setting that trades the picture for time.
pub struct Knob {
    /// `snake_case`, unique.
    pub name: &'static str,
    /// Unit of its values.
    pub unit: &'static str,
    /// From the best to the cheapest; at least one.
    pub steps: Vec<KnobStep>,
    /// Index of the step it stands at.
    pub at: usize,
    /// The user's choice instead of the budget's: an index of a step.
    pub manual: Option<usize>,
    /// What the whole way from the best to the cheapest step would save now, where that is known. units: ms
    pub saves_ms: Option<f32>,
}

/// One setting of a [`Knob`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnobStep {
    /// In the knob's unit.
    pub value: f32,
    /// Visible loss: the share of the picture that it alters, weighted by how much. 0 for the best step, and never
    /// falling from step to step.
    pub loss: f32,
}

impl Knobs {
    /// Every knob.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &Knob> {
        self.list.iter()
    }

    /// Takes a knob out of the budget's hand, or gives it back. Says whether there is such a knob and step.
    pub fn set_manual(&mut self, name: &str, step: Option<usize>) -> bool {
        let knob = self.list.iter_mut().find(|knob| knob.name == name);
        match knob {
            Some(knob) if step.is_none_or(|step| step < knob.steps.len()) => {
                knob.manual = step;
                true
            }
            _ => false,
        }
    }
}

impl Knob {
    /// The value it stands at.
    pub fn value(&self) -> Option<f32> {
        self.steps.get(self.at).map(|step| step.value)
    }
}
