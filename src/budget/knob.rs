//! One knob: its steps, what they lose, and what is known of what they save.

use super::workload::Workload;

/// A setting that trades the picture for time.
#[derive(Clone, Debug)]
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
    /// The value it has where that lies between steps.
    pub live: Option<f32>,
    /// How what it saves is known.
    pub cost: KnobCost,
    /// The cheapest step that changes nothing, because what the user set is as cheap.
    pub(crate) idle_up_to: usize,
    /// Of each step, the share of the frame's time that it saves over the one before; `None` before it was tried.
    pub(crate) saved: Vec<Option<f32>>,
    /// How many times as long as at first it is waited before a step is given back.
    pub(crate) patience: u32,
    /// Moves made when it last was given back.
    pub(crate) given_back: Option<u64>,
    /// Whether what it moves is in the scene.
    pub(crate) is_present: bool,
    /// When it was registered, among the others.
    pub(crate) order: usize,
    /// Whether the budget's fine work is done with it.
    pub(crate) is_continuous: bool,
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

/// How it is known what a knob saves.
#[derive(Clone, Copy, Debug, Default)]
pub enum KnobCost {
    /// By comparing frames before and after each step.
    #[default]
    Measured,
    /// Each value makes a frame's work so many times what it is at the best step.
    Scales(fn(f32) -> Workload),
}

impl KnobCost {
    /// Whether it is [`Measured`](Self::Measured).
    pub fn is_measured(&self) -> bool {
        matches!(self, Self::Measured)
    }
}

/// Share of a frame's time that a step not tried yet is taken to save.
const UNTRIED: f32 = 0.05;
/// A step that was found to save less than this share of a frame's time is not worth its place.
pub(crate) const NOTHING: f32 = 0.002;

/// Why a knob cannot be registered.
#[derive(thiserror::Error, Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum KnobError {
    /// It has no steps.
    #[error("the knob `{0}` has no steps: give it at least one, the best")]
    NoSteps(&'static str),
    /// A value or a loss is not finite, or losses fall.
    #[error(
        "step {step} of the knob `{name}` is out of order: values must be finite and all rise or all fall, losses \
         must start at 0 and never fall"
    )]
    Steps {
        /// Of the knob.
        name: &'static str,
        /// Its index.
        step: usize,
    },
    /// There is one of that name.
    #[error("there is a knob `{0}` already: choose another name")]
    Known(&'static str),
}

impl Knob {
    /// A knob at its best step. `steps` are (value, loss), from the best to the cheapest.
    ///
    /// # Errors
    /// [`KnobError::NoSteps`]; [`KnobError::Steps`] unless values are finite and go one way, and losses start at 0
    /// and never fall.
    pub fn new(
        name: &'static str,
        unit: &'static str,
        steps: &[(f32, f32)],
        cost: KnobCost,
    ) -> Result<Self, KnobError> {
        let (first, last) = match steps {
            [] => return Err(KnobError::NoSteps(name)),
            [.., last] => (steps[0], *last),
        };
        for (step, (value, loss)) in steps.iter().copied().enumerate() {
            let before = steps[step.saturating_sub(1)];
            let goes_on = if first.0 <= last.0 {
                value >= before.0
            } else {
                value <= before.0
            };
            let starts = step > 0 || loss == 0.0;
            if !(value.is_finite() && loss.is_finite() && loss >= before.1 && goes_on && starts) {
                return Err(KnobError::Steps { name, step });
            }
        }
        Ok(Self {
            name,
            unit,
            steps: steps
                .iter()
                .map(|(value, loss)| KnobStep {
                    value: *value,
                    loss: *loss,
                })
                .collect(),
            at: 0,
            manual: None,
            saves_ms: None,
            live: None,
            cost,
            idle_up_to: 0,
            saved: vec![None; steps.len()],
            patience: 1,
            given_back: None,
            is_present: false,
            order: 0,
            is_continuous: false,
        })
    }

    /// The value it stands at.
    pub fn value(&self) -> Option<f32> {
        self.live
            .or_else(|| self.steps.get(self.stands_at()).map(|step| step.value))
    }

    /// Whether it stands elsewhere than at its best.
    pub fn is_moved(&self) -> bool {
        self.stands_at() > self.idle_up_to
    }

    /// The step in force: the user's, else the budget's.
    pub fn stands_at(&self) -> usize {
        self.manual.unwrap_or(self.at)
    }

    /// Back to its best, for there is nothing to move.
    pub(crate) fn rest(&mut self) {
        self.at = 0;
        self.saves_ms = None;
        self.live = None;
        self.idle_up_to = 0;
    }

    /// Whether cheaper values are the larger ones.
    pub(crate) fn rises(&self) -> bool {
        match self.steps.as_slice() {
            [first, .., last] => first.value <= last.value,
            _ => true,
        }
    }

    /// The cheaper of two values.
    pub(crate) fn cheaper_of(&self, a: f32, b: f32) -> f32 {
        if self.rises() { a.max(b) } else { a.min(b) }
    }

    /// Where its entities stand when the user left one at `found` and the budget has it at a step.
    pub(crate) fn value_for(&self, found: f32) -> f32 {
        let step = |i: usize| self.steps.get(i).map(|step| step.value);
        match (self.manual.and_then(step), self.at) {
            (Some(chosen), _) => chosen,
            (None, 0) => found,
            (None, at) => step(at).map_or(found, |value| self.cheaper_of(found, value)),
        }
    }

    /// The next step that saves anything.
    pub(crate) fn cheaper_step(&self) -> Option<usize> {
        let next = self.at.max(self.idle_up_to) + 1;
        (next < self.steps.len()).then_some(next)
    }

    /// The next step back.
    pub(crate) fn better_step(&self) -> Option<usize> {
        let back = self.at.checked_sub(1)?;
        Some(if back <= self.idle_up_to { 0 } else { back })
    }

    /// What is lost at a step. What the user set himself is no loss.
    pub(crate) fn loss_at(&self, step: usize) -> f64 {
        let loss = |i: usize| self.steps.get(i).map_or(0.0, |step| f64::from(step.loss));
        if step <= self.idle_up_to {
            0.0
        } else {
            loss(step) - loss(self.idle_up_to)
        }
    }

    /// Share of a frame's time that it saves at a step, of what it takes at the best; for [`KnobCost::Measured`].
    pub(crate) fn share_left(&self, step: usize) -> f64 {
        (self.idle_up_to + 1..=step.min(self.steps.len() - 1))
            .map(|i| 1.0 - f64::from(self.saved[i].unwrap_or(0.0)))
            .product()
    }

    /// Share of the present frame's time that going from a step to the next cheaper one is expected to save.
    pub(crate) fn expected_share(&self, cheaper: usize) -> f64 {
        f64::from(
            self.saved
                .get(cheaper)
                .copied()
                .flatten()
                .unwrap_or(UNTRIED),
        )
    }

    /// Whether a step was tried and found to save nothing.
    pub(crate) fn saves_nothing(&self, step: usize) -> bool {
        self.cost.is_measured()
            && self
                .saved
                .get(step)
                .copied()
                .flatten()
                .is_some_and(|share| share < NOTHING)
    }

    /// How the work of a frame is scaled where it stands, of what the user's own setting makes it.
    pub(crate) fn scaling(&self, step: usize) -> Workload {
        let KnobCost::Scales(by) = self.cost else {
            return Workload::UNSCALED;
        };
        let of = |step: usize| by(self.steps[step.min(self.steps.len() - 1)].value);
        let (best, here) = (of(self.idle_up_to), of(step.max(self.idle_up_to)));
        let ratio = |here: f64, best: f64| {
            let ratio = here / best;
            if ratio.is_finite() && ratio >= 0.0 {
                ratio
            } else {
                1.0
            }
        };
        Workload {
            objects: ratio(here.objects, best.objects),
            triangles: ratio(here.triangles, best.triangles),
            pixels: ratio(here.pixels, best.pixels),
            rays: ratio(here.rays, best.rays),
        }
    }
}
