//! What an object, a triangle, a pixel, a ray cost on this machine, learned from what frames drew and took.
//!
//! The time of a frame is `t = c₀ + c·x` with every cost at least 0. The costs are the most likely ones: each sample
//! has a relative error of known spread, older samples count less, and before any sample objects and triangles are
//! expected to cost alike, and what is fixed, pixels and rays nothing, give or take as much. That expectation decides
//! between terms that move together, for which samples alone have no answer; it is worth one sample's error, so that
//! it yields where there is one. It errs toward the terms that a threshold changes most, so that what is not known
//! makes the threshold move too little, and feedback make up for it, rather than too far.
//!
//! Samples are forgotten as others come that tell something else: while the camera stands, what its last turn taught
//! is kept.
//!
//! Guarantees: costs are finite and not negative, so that a prediction never falls when there is more to do. A
//! sample that is far off has the weight of one that is off by as much as is believed and no more (Huber).

use super::workload::{TERMS, Workload};

/// How much a sample loses in a frame that differs by [`NEW`] in some term, and at least.
const FORGETS: f64 = 0.015;
const FORGETS_LEAST: f64 = 0.0015;
const NEW: f64 = 0.01;
/// Times and terms that can be calculated with. units: ms
const BELIEVED_MS: core::ops::RangeInclusive<f64> = 1e-6..=1e9;
const MOST: f64 = 1e18;
/// Relative error from which a sample counts less, at least.
const FAR_OFF: f64 = 0.1;
/// Samples from which on others can be told to be far off.
const ENOUGH: f64 = 4.0;
/// The least relative error that is assumed of samples, which drift and err together.
const LEAST_NOISE: f64 = 0.02;

/// See the [module](self).
#[derive(Clone, Debug, Default)]
pub struct CostModel {
    /// The largest that each term has been: costs are of a term this large.
    scale: [f64; TERMS],
    /// Sums over the samples, in terms over their scale and in shares of their times.
    products: [[f64; TERMS]; TERMS],
    sums: [f64; TERMS],
    last: Workload,
    /// Weight of all samples.
    weight: f64,
    /// Mean time of the samples. units: ms
    mean_ms: f64,
    /// Cost of each term at its scale. units: ms
    cost: [f64; TERMS],
}

impl CostModel {
    /// Whether anything has been learned.
    pub fn is_known(&self) -> bool {
        self.weight > 0.0
    }

    /// How many samples count, the older ones less.
    pub fn samples(&self) -> f64 {
        self.weight
    }

    /// Time of a frame with so much work. units: ms
    pub fn predict(&self, work: &Workload) -> f64 {
        let terms = work.terms();
        (0..TERMS)
            .filter(|i| self.scale[*i] > 0.0)
            .map(|i| self.cost[i] * terms[i] / self.scale[i])
            .sum()
    }

    /// What each term costs: the fixed one, an object, a triangle, a square pixel, a ray. 0 for what has not been
    /// met. units: ms
    pub fn costs(&self) -> [f64; TERMS] {
        core::array::from_fn(|i| {
            if self.scale[i] > 0.0 {
                self.cost[i] / self.scale[i]
            } else {
                0.0
            }
        })
    }

    /// Takes in that a frame with so much work took so long, `noise` being the relative error of such samples. One
    /// that is far off counts less, unless it `is_new` what was drawn: then it is the model that is off. What cannot
    /// be calculated with changes nothing.
    pub fn learn(&mut self, work: &Workload, ms: f64, noise: f64, is_new: bool) {
        let terms = work.terms();
        if !(BELIEVED_MS.contains(&ms) && terms.iter().all(|x| (0.0..=MOST).contains(x))) {
            return;
        }
        for (i, term) in terms.into_iter().enumerate() {
            self.grow(i, term);
        }
        let off = (self.predict(work) / ms).ln().abs();
        let believed = FAR_OFF.max(3.0 * noise);
        let weight = if !is_new && self.weight >= ENOUGH && off > believed {
            believed / off
        } else {
            1.0
        };
        // In shares of the longer of the two, so that a time far too short does not count for more than one too long.
        let whole = ms.max(self.predict(work));
        let z: [f64; TERMS] = core::array::from_fn(|i| {
            if self.scale[i] > 0.0 {
                terms[i] / self.scale[i] / whole
            } else {
                0.0
            }
        });
        let moved = terms
            .iter()
            .zip(self.last.terms())
            .fold(0.0, |most: f64, (a, b)| {
                // From nothing, or to nothing, is a whole difference.
                most.max((a - b).abs() / a.max(b).max(f64::MIN_POSITIVE))
            });
        self.last = *work;
        self.fade(1.0 - FORGETS_LEAST.max(FORGETS * (moved / NEW).min(1.0)));
        for i in 0..TERMS {
            for j in 0..TERMS {
                self.products[i][j] += weight * z[i] * z[j];
            }
            self.sums[i] += weight * z[i] * ms / whole;
        }
        self.weight += weight;
        self.mean_ms += (ms - self.mean_ms) * weight / self.weight;
        self.solve(noise.max(LEAST_NOISE));
    }

    /// The machine has become so many times as slow.
    pub fn rescale(&mut self, by: f64) {
        if !(by.is_finite() && by > 0.0) {
            return;
        }
        for i in 0..TERMS {
            for j in 0..TERMS {
                self.products[i][j] /= by * by;
            }
            self.sums[i] /= by;
            self.cost[i] *= by;
        }
        self.mean_ms *= by;
    }

    /// What is known counts for less, in favour of what comes.
    pub fn fade(&mut self, to: f64) {
        for i in 0..TERMS {
            for j in 0..TERMS {
                self.products[i][j] *= to;
            }
            self.sums[i] *= to;
        }
        self.weight *= to;
    }

    /// A term is larger than ever: what is known is put in terms of the new scale.
    fn grow(&mut self, i: usize, term: f64) {
        if term <= self.scale[i] {
            return;
        }
        let by = self.scale[i] / term;
        for j in 0..TERMS {
            self.products[i][j] *= by;
            self.products[j][i] *= by;
        }
        self.sums[i] *= by;
        if by > 0.0 {
            self.cost[i] /= by;
        }
        self.scale[i] = term;
    }

    /// The most likely costs: least squares with the expectation of each as one more sample, and none below 0.
    fn solve(&mut self, noise: f64) {
        // The cost, the same for each term, that fits best.
        let (mut of, mut over) = (0.0, 0.0);
        for i in 1..TERMS {
            of += self.sums[i];
            over += self.products[i][1..].iter().sum::<f64>();
        }
        let fair = if over > 0.0 { of / over } else { self.mean_ms };
        let mut products = self.products;
        let mut sums = self.sums;
        for i in 0..TERMS {
            let (expected, give) = match i {
                0 => (0.0, 0.5 * self.mean_ms),
                1 | 2 => (fair, fair),
                _ => (0.0, 0.5 * fair),
            };
            let precision = (noise / give.max(f64::MIN_POSITIVE)).powi(2).min(1e100);
            products[i][i] += precision;
            sums[i] += precision * expected;
        }
        let mut cost = [0.0; TERMS];
        let mut free = [true; TERMS];
        for _ in 0..TERMS {
            cost = solve_free(&products, &sums, &free);
            let lowest = (0..TERMS)
                .filter(|i| cost[*i] < 0.0)
                .min_by(|a, b| cost[*a].total_cmp(&cost[*b]));
            match lowest {
                Some(i) => free[i] = false,
                None => break,
            }
        }
        // Terms that were held at 0 for the sake of others may be wanted after all: each sweep only betters the fit.
        for _ in 0..4 {
            for i in 0..TERMS {
                let others: f64 = (0..TERMS)
                    .filter(|j| *j != i)
                    .map(|j| products[i][j] * cost[j])
                    .sum();
                if products[i][i] > 0.0 {
                    cost[i] = ((sums[i] - others) / products[i][i]).max(0.0);
                }
            }
        }
        if cost.iter().all(|cost| cost.is_finite()) {
            self.cost = cost;
        }
    }
}

/// Solves a symmetric positive definite system by Cholesky's decomposition, for the free unknowns; the others are 0.
fn solve_free(
    products: &[[f64; TERMS]; TERMS],
    sums: &[f64; TERMS],
    free: &[bool; TERMS],
) -> [f64; TERMS] {
    let mut lower = [[0.0; TERMS]; TERMS];
    let mut y = [0.0; TERMS];
    for i in 0..TERMS {
        if !free[i] {
            continue;
        }
        for j in (0..=i).filter(|j| free[*j]) {
            let known: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
            let rest = products[i][j] - known;
            if i == j {
                // Rounding may leave nothing of a pivot that is all but 0.
                lower[i][i] = rest.max(products[i][i] * f64::EPSILON).sqrt();
            } else {
                lower[i][j] = rest / lower[j][j];
            }
        }
        let known: f64 = (0..i).map(|k| lower[i][k] * y[k]).sum();
        y[i] = (sums[i] - known) / lower[i][i];
    }
    let mut x = [0.0; TERMS];
    for i in (0..TERMS).rev().filter(|i| free[*i]) {
        let known: f64 = (i + 1..TERMS).map(|k| lower[k][i] * x[k]).sum();
        x[i] = (y[i] - known) / lower[i][i];
    }
    x
}
