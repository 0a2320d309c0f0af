//! Feedback: by how much the cost model is off just now, and how far single frames scatter about it.
//!
//! The level is the median of the last frames' errors: of as many as agree, so that it hardly moves with the noise;
//! when the newest contradict the others by more than the noise explains, of the newest alone, so that it follows a
//! machine that has changed within two frames of hearing of it. One frame that is far off changes nothing. It only
//! ever compares what was measured with what was predicted of the very frame, so that a delay does not make it swing
//! and a target out of reach does not wind it up.

use super::{model::CostModel, workload::Workload};

/// Frames that are looked back on.
const LENGTH: usize = 32;
/// Of these, the newest, which may contradict the others.
const NEWEST: usize = 4;
/// How much the scatter remembers from one frame to the next.
const MEMORY: f64 = 0.99;
/// Scatter that is assumed before there is any, as if so many frames had shown it; and at least. Relative.
pub(super) const FIRST_SCATTER: f64 = 0.03;
const FIRST_FRAMES: f64 = 16.0;
/// Samples of the model below which nothing is said of the scatter.
const YOUNG: f64 = 8.0;
const LEAST_SCATTER: f64 = 0.002;
/// The standard deviation of the mean of the middle two of four, in that of one. Normal distribution.
const OF_NEWEST: f64 = 0.55;
/// What is explained by noise: so many standard deviations.
const EXPLAINED: f64 = 3.5;
/// Dead band: errors of the level up to this are left alone. Relative.
const DEAD_BAND: f64 = 0.01;

/// One frame.
#[derive(Clone, Copy, Debug, Default)]
struct Sample {
    number: u64,
    /// What it was expected to do.
    work: Workload,
    /// The time it would have taken with all measured knobs at their best. units: ms
    ms: f64,
}

/// See the [module](self).
#[derive(Clone, Debug)]
pub struct Trim {
    samples: [Sample; LENGTH],
    next: usize,
    /// Samples of the present machine.
    agreeing: usize,
    /// Samples taken in, up to the length.
    known: usize,
    level: f64,
    variance: f64,
    /// Frames that the variance is of, those assumed included, as far as they are remembered.
    frames: f64,
}

impl Default for Trim {
    fn default() -> Self {
        Self {
            samples: [Sample::default(); LENGTH],
            next: 0,
            agreeing: 0,
            known: 0,
            level: 0.0,
            variance: FIRST_SCATTER * FIRST_SCATTER,
            frames: FIRST_FRAMES,
        }
    }
}

/// What [`Trim::push`] found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Found {
    /// The machine is as it was.
    Same,
    /// It has changed: it takes so many times as long as the model says.
    Changed(f64),
}

impl Trim {
    /// How many times as long frames take as the model says.
    pub fn factor(&self) -> f64 {
        self.level.exp()
    }

    /// Logarithm of [`factor`](Self::factor).
    pub fn level(&self) -> f64 {
        self.level
    }

    /// Standard deviation of a frame's time from its prediction, frames far off aside. Relative.
    pub fn scatter(&self) -> f64 {
        self.variance.sqrt().max(LEAST_SCATTER)
    }

    /// Takes in a frame that was expected to do `work`, and would have taken `ms` with all measured knobs at their
    /// best. `error` is the logarithm of what it took over what was predicted of it.
    pub fn push(
        &mut self,
        model: &CostModel,
        number: u64,
        work: Workload,
        ms: f64,
        error: f64,
    ) -> Found {
        self.samples[self.next] = Sample { number, work, ms };
        self.next = (self.next + 1) % LENGTH;
        self.agreeing = (self.agreeing + 1).min(LENGTH);
        self.known = (self.known + 1).min(LENGTH);
        let scatter = self.scatter();
        let newest = self.median(model, NEWEST.min(self.agreeing));
        let level = self.median(model, self.agreeing);
        let off = (newest - level).abs();
        if off <= (EXPLAINED * OF_NEWEST * scatter).max(DEAD_BAND) {
            self.level = level;
            // A single frame far off says nothing of the others.
            let most = 3.0 * scatter;
            let error = error.clamp(-most, most);
            // What the first frames are off by is what the model has yet to learn.
            if model.samples() > YOUNG {
                self.frames = MEMORY * self.frames + 1.0;
                self.variance += (error * error - self.variance) / self.frames;
            }
            return Found::Same;
        }
        // Of a leap two frames are enough, and older ones are of before; what creeps needs more to be told from noise.
        let leap = off > (6.0 * scatter).max(0.1);
        self.agreeing = if leap { 2 } else { NEWEST }.min(self.known);
        self.level = self.median(model, self.agreeing);
        Found::Changed(self.factor())
    }

    /// After what the model has learned since.
    pub fn refresh(&mut self, model: &CostModel) {
        if self.agreeing > 0 {
            self.level = self.median(model, self.agreeing);
        }
    }

    /// The level of the frames after one; `None` without any of them.
    pub fn level_after(&self, model: &CostModel, number: u64) -> Option<f64> {
        median(self.newest(self.known).filter(|s| s.number > number), model)
    }

    /// The frames after one would have taken `by` times as long with all measured knobs at their best as was thought.
    pub fn correct_after(&mut self, number: u64, by: f64) {
        for sample in self.samples.iter_mut().filter(|s| s.number > number) {
            sample.ms *= by;
        }
    }

    fn median(&self, model: &CostModel, of: usize) -> f64 {
        median(self.newest(of), model).unwrap_or(0.0)
    }

    fn newest(&self, of: usize) -> impl Iterator<Item = &Sample> {
        (1..=of).map(|back| &self.samples[(self.next + LENGTH - back) % LENGTH])
    }
}

/// The mean of the middle two of the samples' errors, or the middle one. Logarithm.
fn median<'a>(samples: impl Iterator<Item = &'a Sample>, model: &CostModel) -> Option<f64> {
    let mut errors = [0.0; LENGTH];
    let mut len = 0;
    for sample in samples.take(LENGTH) {
        let error = (sample.ms / model.predict(&sample.work)).ln();
        if error.is_finite() {
            errors[len] = error;
            len += 1;
        }
    }
    let errors = &mut errors[..len];
    errors.sort_unstable_by(f64::total_cmp);
    let low = errors.get(len.saturating_sub(1) / 2)?;
    Some(0.5 * (low + errors[len / 2]))
}
