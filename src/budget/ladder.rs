//! Which knob moves: steps are taken where that loses less of the picture than contribution culling would have to
//! take for the same time, the least loss first, and given back in reverse.
//!
//! Contribution does the fine work of each frame; what is here is slow. A step is taken when it has been the better
//! choice for some frames on end, and one at a time, so that what it saved can be measured before the next; it is
//! given back after longer, and longer still each time that this turned out to be too soon. Between taking and
//! giving back lies a factor, so that where both are alike nothing moves.

use super::knob::Knob;

/// How many times the loss of one choice the other's must be.
const FACTOR: f64 = 1.5;
/// A loss not worth a move. Share of the picture.
const NO_LOSS: f64 = 1e-4;
/// Frames for which a step must be the better choice: when the target is missed without it, when it merely loses
/// less, and before it is given back.
const FORCED: u32 = 4;
const WANTED: u32 = 8;
const RETURNED: u32 = 30;
/// How much more than it saved must be there before a step is given back, in shares of it and of the target.
const RESERVE: f64 = 0.05;
const RESERVE_OF_TARGET: f64 = 0.02;
/// Frames after a move in which what it saved is measured, and nothing else moves. Longer than a frame's time takes to
/// come back, by as many frames as it takes to tell a few per cent from noise.
pub(crate) const MEASURED_FOR: u64 = 16;
/// Frames within which a step taken again was given back too soon.
const TOO_SOON: u64 = 240;
/// Frames after which a step that saved nothing is tried again: there may be something to save by then. Longer each
/// time.
const FORGOTTEN: u64 = 1_800;
/// The longest that giving back or trying again waits, in times of what it does at first.
const LONGEST: u32 = 64;

/// How the frame stands.
pub struct Situation<'a> {
    /// Which frame it is.
    pub frame: u64,
    /// Predicted time where all knobs stand. units: ms
    pub predicted_ms: f64,
    /// What it may take. units: ms
    pub target_ms: f64,
    /// What contribution culling must take of the picture for a frame to be predicted so long, all other knobs as
    /// they are; infinite where it cannot.
    pub loss_for: &'a dyn Fn(f64) -> f64,
    /// What the present frame would take with a knob at another step, contribution culling as it is. units: ms
    pub with_step: &'a dyn Fn(&Knob, usize) -> f64,
}

/// A step taken or given back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Move {
    /// Which knob.
    pub knob: &'static str,
    /// From this step.
    pub from: usize,
    /// To that one.
    pub to: usize,
}

/// See the [module](self).
#[derive(Clone, Debug, Default)]
pub struct Ladder {
    /// What has been the better choice, and for how many frames.
    wanted: Option<(&'static str, usize, u32)>,
    /// The last move, until what it saved is known.
    measuring: Option<(Move, u64)>,
    /// The last move of all.
    last: Option<Move>,
}

/// A move that may be made.
struct Choice {
    knob: usize,
    to: usize,
    patience: u32,
    /// Larger is better.
    rank: f64,
}

impl Ladder {
    /// Whether what a move saved is being measured: the model must not learn it away.
    pub fn is_measuring(&self) -> bool {
        self.measuring.is_some()
    }

    /// The last move that was made.
    pub fn last(&self) -> Option<Move> {
        self.last
    }

    /// Moves a knob, if one is to be moved. `knobs` are those in the scene.
    pub fn step(&mut self, knobs: &mut [Knob], now: &Situation) -> Option<Move> {
        if self.measuring.is_some() {
            return None;
        }
        let Some(choice) = choose(knobs, now) else {
            self.wanted = None;
            return None;
        };
        let knob = &mut knobs[choice.knob];
        let so_far = match self.wanted {
            Some((name, to, frames)) if name == knob.name && to == choice.to => frames,
            _ => 0,
        };
        self.wanted = Some((knob.name, choice.to, so_far + 1));
        if so_far + 1 < choice.patience {
            return None;
        }
        self.wanted = None;
        let made = Move {
            knob: knob.name,
            from: knob.at,
            to: choice.to,
        };
        if made.to > made.from {
            if knob
                .given_back
                .is_some_and(|at| now.frame.saturating_sub(at) < TOO_SOON)
            {
                knob.patience = (2 * knob.patience).min(LONGEST);
            }
        } else {
            if knob.saves_nothing(made.from) {
                knob.patience = (2 * knob.patience).min(LONGEST);
            }
            knob.given_back = Some(now.frame);
        }
        knob.at = made.to;
        if knob.cost.is_measured() {
            self.measuring = Some((made, now.frame));
        }
        self.last = Some(made);
        Some(made)
    }

    /// Notes what the last move saved, when it is time to. `error` is by how much frames after a given one differ from
    /// what was predicted without knowing the move. Logarithm.
    pub fn settle(
        &mut self,
        knobs: &mut [Knob],
        frame: u64,
        error: impl Fn(u64) -> Option<f64>,
    ) -> Option<Settled> {
        let (made, at) = self.measuring?;
        if frame.saturating_sub(at) < MEASURED_FOR {
            return None;
        }
        self.measuring = None;
        let knob = knobs.iter_mut().find(|knob| knob.name == made.knob)?;
        let saved = knob.saved.get_mut(made.to.max(made.from))?;
        let change = error(at)?;
        let is_taken = made.to > made.from;
        // What is taken for the better and makes things half again as bad, or saves more than six parts of ten that
        // were not expected, is a change of the machine or the scene.
        let for_the_worse = if is_taken { change } else { -change };
        if !(-0.9..=0.4).contains(&for_the_worse) {
            return None;
        }
        let before = 1.0 - f64::from(saved.unwrap_or(0.0));
        let left = (before * for_the_worse.exp()).clamp(0.05, 1.0);
        *saved = Some((1.0 - left) as f32);
        // What was put down to the machine was the knob's: only frames at the cheaper step had it.
        is_taken.then_some(Settled {
            after: at,
            by: before / left,
        })
    }
}

/// What measuring a move means for frames since: with all measured knobs at their best those after `after` would have
/// taken `by` times as long as was thought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settled {
    /// The frame of the move.
    pub after: u64,
    /// The factor.
    pub by: f64,
}

/// The move that betters the frame most, if one does.
fn choose(knobs: &[Knob], now: &Situation) -> Option<Choice> {
    let lost = (now.loss_for)(now.target_ms);
    let mut best: Option<Choice> = None;
    let mut offer = |choice: Choice| {
        if best.as_ref().is_none_or(|best| choice.rank > best.rank) {
            best = Some(choice);
        }
    };
    for (i, knob) in knobs.iter().enumerate() {
        if knob.manual.is_some() || knob.is_continuous {
            continue;
        }
        if let Some(to) = knob.cheaper_step() {
            let loss = knob.loss_at(to) - knob.loss_at(knob.at);
            let saved = now.predicted_ms - (now.with_step)(knob, to);
            let relieved = lost - (now.loss_for)(now.target_ms + saved);
            let is_known_useless = knob.saves_nothing(to)
                && knob.given_back.is_some_and(|at| {
                    now.frame.saturating_sub(at) < FORGOTTEN * u64::from(knob.patience)
                });
            if is_known_useless || saved <= 0.0 {
                // Not this way.
            } else if lost.is_infinite() {
                // Whatever helps, the least loss for the time first.
                offer(Choice {
                    knob: i,
                    to,
                    patience: FORCED,
                    rank: 2.0 + 1.0 / (1.0 + loss / saved),
                });
            } else if relieved > FACTOR * loss + NO_LOSS {
                offer(Choice {
                    knob: i,
                    to,
                    patience: WANTED,
                    rank: 1.0 / (1.0 + loss / relieved),
                });
            }
        }
        if let Some(to) = knob.better_step() {
            let loss = knob.loss_at(knob.at) - knob.loss_at(to);
            let costs = ((now.with_step)(knob, to) - now.predicted_ms).max(0.0);
            let room = now.target_ms - costs * (1.0 + RESERVE) - RESERVE_OF_TARGET * now.target_ms;
            let more = (now.loss_for)(room) - lost;
            let is_useless = knob.saves_nothing(knob.at);
            let is_better = more <= 0.0 || FACTOR * more < loss;
            if lost.is_finite() && (is_useless || is_better) {
                offer(Choice {
                    knob: i,
                    to,
                    patience: if is_useless {
                        1
                    } else {
                        RETURNED * knob.patience
                    },
                    // The greatest loss for the time first.
                    rank: 1.0 + loss / (loss + costs.max(f64::MIN_POSITIVE)),
                });
            }
        }
    }
    best
}
