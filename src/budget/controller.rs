//! Chooses where the knobs stand, from what frames did and took. Plain data: it knows no app and no clock.
//!
//! Each frame it is told what is in view ([`DemandProfile`]) and, for a frame some frames ago, what it took. It then
//! 1. **learns** what work costs ([`CostModel`]) and by how much that is off just now (`Trim`);
//! 2. **aims** below the target by as much as frames scatter, so that one in a hundred exceeds it;
//! 3. **picks** the lowest demand on contribution culling whose predicted time meets the aim;
//! 4. **moves** another knob a step, if for some time that has lost less of the picture (`Ladder`).
//!
//! # Guarantees
//! - Times that are missing, zero, negative, not finite, above [`LONGEST_MS`], or far above all others and alone,
//!   change nothing. Without a time that can be believed for [`PATIENCE`] frames all knobs stay where they are, and it
//!   says so.
//! - Nothing accumulates while the target is out of reach: what is remembered are prediction errors, never how
//!   far the target is.
//! - A frame's time is only compared with what was predicted for that frame, whatever the delay.
//! - It allocates nothing.

use super::{
    knob::{Knob, KnobCost},
    ladder::{Ladder, Move, Situation},
    model::CostModel,
    trim::{FIRST_SCATTER, Found, Trim},
    workload::{DemandProfile, Workload},
};
use crate::culling::NEVER_GOES;

/// A time above this is no frame's: the app was stopped. units: ms
pub const LONGEST_MS: f32 = 10_000.0;
/// Frames without a time that can be believed, after which it is said that there is none.
pub const PATIENCE: u32 = 60;
/// A time so many times the last one and the target is taken for an interruption,
const FAR_ABOVE: f64 = 20.0;
/// unless it is said so often on end.
const INSISTS: u32 = 8;
/// Frames whose times may still be on their way.
const IN_FLIGHT: usize = 16;
/// Standard deviations between the aim and the target: one frame in 70 would exceed it if the
/// scatter were all noise; some of it is what the model has wrong, which it is told of. Normal distribution.
const DEVIATIONS: f64 = 2.25;
/// The least and the most that is aimed below the target. Relative.
const LEAST_MARGIN: f64 = 0.0075;
const MOST_MARGIN: f64 = 0.1;
/// The demand stays where its prediction is within so much of the aim: relative, the same below it, where bins leave
/// gaps, and in deviations.
const STAYS: f64 = 0.002;
const STAYS_BELOW: f64 = 0.006;
const STAYS_DEVIATIONS: f64 = 0.2;
/// Samples below which nothing is said to have changed.
const YOUNG: f64 = 8.0;
/// Work has jumped when a term is so many times what it was, or as much less; what is told of the machine in so many
/// frames after it may be due to that.
const JUMP: f64 = 1.25;
const JUMP_LASTS: u32 = 6;
/// How far the demand may go for a time to be so many times what it was, all terms of the work being known to
/// change no faster than the steepest of them: a power of that factor, and not more than so much beyond it.
const REACH: f64 = 1.2;
const REACH_BEYOND: f64 = 0.1;
/// The same for what has come into view since, of which nothing was measured.
const REACH_AHEAD: f64 = 3.0;
/// Farther than these where the model has been right, but for so much, of frames whose views differed by as much as that in
/// all; each frame counts for less than the one after it.
const AS_PREDICTED: f64 = 0.02;
const TRUST_LASTS: f64 = 0.97;
/// No frame shows more than this. Logarithm.
const MOST_TURNED: f64 = 0.5;
/// What is left of the model's memory when the machine has changed by more than this. Logarithm.
const LEAP: f64 = 0.3;
const AFTER_CHANGE: f64 = 0.7;

/// What a frame took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Which frame.
    pub frame: u64,
    /// Its time. units: ms
    pub ms: f32,
}

/// What [`Controller::step`] is told.
#[derive(Clone, Copy, Debug)]
pub struct Input<'a> {
    /// Number of this frame; they rise by one.
    pub frame: u64,
    /// What a frame may take. units: ms
    pub target_ms: f32,
    /// What a past frame took, if that has become known since the last step.
    pub measured: Option<Measured>,
    /// What is in view, summed up.
    pub profile: &'a DemandProfile,
    /// Whether there is contribution culling, and it is not in the user's hand.
    pub contribution: Contribution,
    /// Times come in multiples of this, as they do where a display is waited for. units: ms
    pub quantum_ms: Option<f32>,
}

/// Who has contribution culling's demand in hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Contribution {
    /// Nobody: there is none.
    Absent,
    /// The budget.
    Budget,
    /// The user, with this demand. units: px²
    Manual(f32),
}

/// What [`Controller::step`] chose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Decision {
    /// How it stands.
    pub status: Status,
    /// What is demanded of contribution culling (see [`rank`](crate::contribution::rank)). units: px²
    pub demanded_px2: f32,
    /// What this frame is predicted to take. units: ms
    pub predicted_ms: Option<f32>,
    /// What it aims at: below the target by as much as frames scatter. units: ms
    pub aim_ms: f32,
    /// Share of the picture's pixels that contribution culling takes more than the user's own threshold does.
    pub loss: f32,
    /// The knob that moves before the next frame.
    pub moved: Option<Move>,
}

/// See [`BudgetStatus`](super::BudgetStatus).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Status {
    /// No time that can be believed.
    #[default]
    NoMeasurement,
    /// All knobs at their best.
    Ample,
    /// Knobs moved.
    Held,
    /// All knobs at their cheapest, and it is too little.
    Short,
}

/// What is remembered of a frame until its time is known.
#[derive(Clone, Copy, Debug, Default)]
struct Frame {
    number: u64,
    is_used: bool,
    /// Where the demand stood.
    bin: usize,
    /// What it was expected to draw, and what it did; in work scaled by the knobs.
    expected: Workload,
    drawn: Workload,
    scaling: Workload,
    /// Share of its time that measured knobs left.
    left: f64,
    predicted_ms: Option<f64>,
    /// By how much its view differed from the one before, at the same demand: that of the term that differed most.
    /// Logarithm.
    turned: f64,
}

/// See the [module](self).
#[derive(Clone, Debug, Default)]
pub struct Controller {
    model: CostModel,
    trim: Trim,
    ladder: Ladder,
    frames: [Frame; IN_FLIGHT],
    /// Frames since a time that could be believed.
    without: u32,
    /// Times on end that were far above.
    far_above: u32,
    last_ms: Option<f64>,
    /// What the last frame heard of drew, and frames since that was much more or less than the one before.
    last_drawn: Workload,
    last_expected: Workload,
    last_bin: usize,
    since_jump: u32,
    /// How far the demand may go as the model has been right about so many views. Only views count: what a change of
    /// the demand did looks the same as what a change of the machine did that the demand answered. Logarithm.
    trusted: f64,
    /// What the last frame's demand left of its view.
    kept: Workload,
    kept_bin: usize,
    /// Bin that the demand stands at.
    bin: usize,
    /// Level of the trim when a knob last moved. Logarithm.
    level_before_move: f64,
    decision: Decision,
}

impl Controller {
    /// What has been learned.
    pub fn model(&self) -> &CostModel {
        &self.model
    }

    /// What feedback does to it.
    pub fn trim(&self) -> &Trim {
        &self.trim
    }

    /// The last decision.
    pub fn decision(&self) -> &Decision {
        &self.decision
    }

    /// The last knob that moved.
    pub fn last_move(&self) -> Option<Move> {
        self.ladder.last()
    }

    /// The newest time that was believed. units: ms
    pub fn measured_ms(&self) -> Option<f32> {
        self.last_ms.map(|ms| ms as f32)
    }

    /// Says what a frame drew in the end, if that is not what was expected: other effects removed some of it. In work
    /// as the profile counts it.
    pub fn drew(&mut self, frame: u64, work: Workload) {
        let slot = &mut self.frames[frame as usize % IN_FLIGHT];
        if slot.is_used && slot.number == frame {
            slot.drawn = work.scaled(&slot.scaling);
        }
    }

    /// Takes in what became known, and decides on this frame and, for other knobs, the next. `knobs` are those in the
    /// scene.
    pub fn step(&mut self, input: &Input, knobs: &mut [Knob]) -> Decision {
        let heard = input
            .measured
            .is_some_and(|measured| self.hear(measured, input));
        self.without = if heard {
            0
        } else {
            self.without.saturating_add(1)
        };
        self.settle(input.frame, knobs);
        let scaling = knobs.iter().fold(Workload::UNSCALED, |all, knob| {
            all.scaled(&knob.scaling(knob.stands_at()))
        });
        let left = knobs
            .iter()
            .filter(|knob| knob.cost.is_measured())
            .map(|knob| knob.share_left(knob.stands_at()))
            .product::<f64>();
        let target = f64::from(input.target_ms);
        let is_silent = !self.model.is_known() || self.without >= PATIENCE;
        if is_silent || !(target.is_finite() && target > 0.0) {
            return self.hold(input, scaling, left);
        }
        self.aim_and_move(input, knobs, scaling, left)
    }

    /// All knobs stay where they are.
    fn hold(&mut self, input: &Input, scaling: Workload, left: f64) -> Decision {
        self.remember(input, scaling, left, None);
        self.decision = Decision {
            status: Status::NoMeasurement,
            predicted_ms: None,
            moved: None,
            demanded_px2: match input.contribution {
                Contribution::Manual(px2) => px2,
                _ => self.decision.demanded_px2,
            },
            ..self.decision
        };
        self.decision
    }

    fn aim_and_move(
        &mut self,
        input: &Input,
        knobs: &mut [Knob],
        scaling: Workload,
        left: f64,
    ) -> Decision {
        // Rounding hides it.
        let scatter = match input.quantum_ms {
            Some(_) => self.trim.scatter().max(FIRST_SCATTER),
            None => self.trim.scatter(),
        };
        let target = whole_quanta(f64::from(input.target_ms), input.quantum_ms);
        let margin = (DEVIATIONS * scatter).clamp(LEAST_MARGIN, MOST_MARGIN);
        let aim = target * (1.0 - margin);
        let profile = input.profile;
        let factor = self.trim.factor();
        let model = &self.model;
        // Where times are rounded up, one that is too short cannot be told from one that is right.
        let reach = if input.quantum_ms.is_some() {
            1.0
        } else {
            REACH
        };
        // What demands there are to choose from: in the user's hand, one.
        let (least, limit) = match input.contribution {
            Contribution::Budget => {
                let most = profile.picture_px2() * f64::from(NEVER_GOES);
                (0, DemandProfile::bin(most as f32))
            }
            Contribution::Manual(px2) => (DemandProfile::bin(px2), DemandProfile::bin(px2)),
            Contribution::Absent => (0, 0),
        };
        let time = |bin: usize, scaling: &Workload, left: f64| {
            left * factor * model.predict(&profile.kept(bin).scaled(scaling))
        };
        // The lowest bin that is predicted to take at most so long; times fall as bins rise.
        let lowest = |ms: f64, scaling: &Workload, left: f64| {
            let (mut low, mut high) = (least, limit);
            while low < high {
                let middle = (low + high) / 2;
                if time(middle, scaling, left) <= ms {
                    high = middle;
                } else {
                    low = middle + 1;
                }
            }
            low
        };
        self.bin = match input.contribution {
            Contribution::Absent | Contribution::Manual(_) => least,
            Contribution::Budget => {
                let stays = STAYS.max(STAYS_DEVIATIONS * scatter) * target;
                let wanted = lowest(aim, &scaling, left);
                let heard = factor * left * model.predict(&self.last_expected);
                let from = self.last_bin.min(limit);
                let back = (aim / heard).ln().abs();
                let ahead = (heard / time(from, &scaling, left)).ln().abs();
                let allowed = (back * reach).min(back + REACH_BEYOND) + ahead * REACH_AHEAD;
                let allowed = allowed.max(self.trusted);
                let is_near = |bin| steepest(&profile.kept(from), &profile.kept(bin)) <= allowed;
                let wanted = within_reach(from, wanted, is_near);
                let kept = self.bin.min(limit);
                let off = time(kept, &scaling, left) - aim;
                let is_close = off <= stays && -off <= stays.max(STAYS_BELOW * target);
                // Not held up for the sake of calm when nothing need be taken away at all.
                if is_close && wanted != 0 {
                    kept
                } else {
                    wanted
                }
            }
        };
        let bin = self.bin;
        let predicted = time(bin, &scaling, left);
        let loss_for = |ms: f64| {
            let bin = lowest(ms, &scaling, left);
            if time(bin, &scaling, left) <= ms {
                profile.loss(least, bin)
            } else {
                f64::INFINITY
            }
        };
        let with_step = |knob: &Knob, to: usize| match knob.cost {
            KnobCost::Measured => {
                let cheaper = to.max(knob.at);
                let left = 1.0 - knob.expected_share(cheaper);
                if to > knob.at {
                    predicted * left
                } else {
                    predicted / left.max(0.05)
                }
            }
            KnobCost::Scales(_) => {
                let (here, there) = (knob.scaling(knob.at), knob.scaling(to));
                let change = |here: f64, there: f64| if here > 0.0 { there / here } else { 1.0 };
                let change = Workload {
                    objects: change(here.objects, there.objects),
                    triangles: change(here.triangles, there.triangles),
                    pixels: change(here.pixels, there.pixels),
                    rays: change(here.rays, there.rays),
                };
                time(bin, &scaling.scaled(&change), left)
            }
        };
        let situation = Situation {
            frame: input.frame,
            predicted_ms: predicted,
            target_ms: aim,
            loss_for: &loss_for,
            with_step: &with_step,
        };
        let missed = loss_for(target).is_infinite();
        note_savings(knobs, &with_step, predicted);
        let can_move = knobs.iter().any(|knob| {
            knob.manual.is_none()
                && !knob.is_continuous
                && knob
                    .cheaper_step()
                    .is_some_and(|to| !knob.saves_nothing(to))
        });
        let is_best = knobs
            .iter()
            .all(|knob| knob.is_continuous || knob.stands_at() <= knob.idle_up_to);
        let moved = self.ladder.step(knobs, &situation);
        if moved.is_some() {
            self.level_before_move = self.trim.level();
        }
        self.remember(input, scaling, left, Some(predicted));
        self.decision = Decision {
            status: match (missed, bin == least && is_best) {
                (true, _) if !can_move => Status::Short,
                (_, true) if predicted <= target => Status::Ample,
                _ => Status::Held,
            },
            demanded_px2: match input.contribution {
                Contribution::Budget if bin > 0 => DemandProfile::edge(bin),
                Contribution::Manual(px2) => px2,
                _ => 0.0,
            },
            predicted_ms: Some(predicted as f32),
            aim_ms: aim as f32,
            loss: profile.loss(least, bin) as f32,
            moved,
        };
        self.decision
    }

    fn remember(&mut self, input: &Input, scaling: Workload, left: f64, predicted: Option<f64>) {
        let turned = steepest(&self.kept, &input.profile.kept(self.kept_bin));
        (self.kept, self.kept_bin) = (input.profile.kept(self.bin), self.bin);
        let expected = input.profile.kept(self.bin).scaled(&scaling);
        self.frames[input.frame as usize % IN_FLIGHT] = Frame {
            number: input.frame,
            is_used: true,
            bin: self.bin,
            expected,
            drawn: expected,
            scaling,
            left,
            predicted_ms: predicted,
            turned,
        };
    }

    /// Learns from a time. Says whether it could be believed.
    fn hear(&mut self, measured: Measured, input: &Input) -> bool {
        let slot = measured.frame as usize % IN_FLIGHT;
        let frame = self.frames[slot];
        if !self.believes(measured.ms, input.target_ms)
            || !frame.is_used
            || frame.number != measured.frame
        {
            return false;
        }
        self.frames[slot].is_used = false;
        let ms = f64::from(measured.ms);
        self.last_ms = Some(ms);
        let expected_ms = self
            .model
            .is_known()
            .then(|| frame.left * self.trim.factor() * self.model.predict(&frame.expected));
        let ms = most_likely(ms, expected_ms, input.quantum_ms);
        let full_ms = ms / frame.left.max(0.05);
        self.since_jump = if is_jump(&self.last_drawn, &frame.drawn) {
            0
        } else {
            self.since_jump.saturating_add(1)
        };
        self.last_drawn = frame.drawn;
        self.last_expected = frame.expected;
        self.last_bin = frame.bin;
        if self.model.is_known() {
            let error = match frame.predicted_ms {
                Some(predicted) => (ms / predicted).ln(),
                None => 0.0,
            };
            // A time that was rounded up agrees with whatever is not far off.
            self.trusted = if error.abs() <= AS_PREDICTED && input.quantum_ms.is_none() {
                TRUST_LASTS * self.trusted + frame.turned.min(MOST_TURNED)
            } else {
                0.0
            };
            let found = self
                .trim
                .push(&self.model, frame.number, frame.expected, full_ms, error);
            // Where the work has changed as well, it is the model that is wrong about it, not the machine.
            if let Found::Changed(by) = found
                && self.model.samples() > YOUNG
                && self.since_jump > JUMP_LASTS
                && !self.ladder.is_measuring()
            {
                self.model.rescale(by);
                if by.ln().abs() > LEAP {
                    self.model.fade(AFTER_CHANGE);
                }
            }
        }
        if !self.ladder.is_measuring() {
            let noise = self.trim.scatter();
            let is_new = self.since_jump <= JUMP_LASTS;
            self.model.learn(&frame.drawn, full_ms, noise, is_new);
        }
        self.trim.refresh(&self.model);
        true
    }

    /// What a knob's last move saved is the knob's from now on, not the machine's.
    fn settle(&mut self, frame: u64, knobs: &mut [Knob]) {
        let (model, trim) = (&self.model, &self.trim);
        let error = |after| Some(trim.level_after(model, after)? - self.level_before_move);
        let Some(settled) = self.ladder.settle(knobs, frame, error) else {
            return;
        };
        self.trim.correct_after(settled.after, settled.by);
        for frame in self.frames.iter_mut() {
            if frame.is_used && frame.number > settled.after {
                frame.left /= settled.by;
            }
        }
        self.trim.refresh(&self.model);
    }

    fn believes(&mut self, ms: f32, target_ms: f32) -> bool {
        if !(ms.is_finite() && ms > 0.0 && ms <= LONGEST_MS) {
            return false;
        }
        let usual = self.last_ms.map(|last| last.max(f64::from(target_ms)));
        if usual.is_some_and(|usual| f64::from(ms) > FAR_ABOVE * usual) {
            self.far_above += 1;
            return self.far_above >= INSISTS;
        }
        self.far_above = 0;
        true
    }
}

/// Whether frames did very different work.
fn is_jump(before: &Workload, now: &Workload) -> bool {
    let pairs = before.terms().into_iter().zip(now.terms());
    pairs.into_iter().any(|(a, b)| a.max(b) > JUMP * a.min(b))
}

/// By how much the term of the work that changes most does. Logarithm. A frame's time is a sum of terms with costs that
/// are not negative: it changes by no more. So, whatever the model has wrong about which term costs what, an error that
/// was measured is at most [`REACH`] − 1 times as large in the frame that answers it, and never beyond the aim by more
/// than [`REACH_BEYOND`]: a reach below 2 makes it die away.
fn steepest(before: &Workload, after: &Workload) -> f64 {
    let pairs = before.terms().into_iter().zip(after.terms()).skip(1);
    pairs
        .map(|(a, b)| (b / a).ln().abs())
        // What is not there does not change; what comes from nothing or goes to nothing does so without bound.
        .filter(|change| !change.is_nan())
        .fold(0.0, f64::max)
}

/// The bin nearest to `wanted`, coming from `from`, that is near enough.
fn within_reach(from: usize, wanted: usize, is_near: impl Fn(usize) -> bool) -> usize {
    let (mut near, mut far) = (from, wanted);
    if is_near(far) {
        return far;
    }
    while near.abs_diff(far) > 1 {
        let middle = (near + far) / 2;
        if is_near(middle) {
            near = middle;
        } else {
            far = middle;
        }
    }
    // The first beyond, so that it gets there at all where bins are coarse.
    far
}

/// What each knob would save on its whole way.
fn note_savings(knobs: &mut [Knob], with_step: &dyn Fn(&Knob, usize) -> f64, predicted: f64) {
    for knob in knobs.iter_mut().filter(|knob| !knob.is_continuous) {
        let last = knob.steps.len() - 1;
        knob.saves_ms = match knob.cost {
            KnobCost::Measured => knob.saved.iter().skip(1).any(Option::is_some).then(|| {
                let now = knob.share_left(knob.stands_at()).max(0.05);
                (predicted / now * (1.0 - knob.share_left(last))) as f32
            }),
            KnobCost::Scales(_) => Some((with_step(knob, 0) - with_step(knob, last)) as f32),
        };
    }
}

/// A target of some multiples of the quantum is met by so many whole ones.
fn whole_quanta(target_ms: f64, quantum_ms: Option<f32>) -> f64 {
    match quantum_ms.map(f64::from) {
        Some(quantum) if quantum > 0.0 && quantum.is_finite() => {
            // A display's period and a target meant to be it differ in the last places.
            (target_ms / quantum + 0.02).floor().max(1.0) * quantum
        }
        _ => target_ms,
    }
}

/// The time that a measured one most likely stands for. Where times are rounded up to multiples of a quantum, one
/// that agrees with what was expected says no more than that; else it lies a quarter into what the measured one
/// leaves open, on the side of what was expected: twice that is the most that a next frame is then off by.
fn most_likely(ms: f64, expected: Option<f64>, quantum_ms: Option<f32>) -> f64 {
    let Some(quantum) = quantum_ms
        .map(f64::from)
        .filter(|q| q.is_finite() && *q > 0.0)
    else {
        return ms;
    };
    let high = (ms / quantum).round().max(1.0) * quantum;
    let low = high - quantum;
    match expected {
        Some(expected) if expected > low && expected <= high => expected,
        Some(expected) if expected <= low => low + 0.25 * quantum,
        Some(_) => high - 0.25 * quantum,
        None => high - 0.5 * quantum,
    }
}
