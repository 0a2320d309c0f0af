//! What every baseline would draw along a path, without drawing it: from one pass with everything in view. With it a
//! baseline's number is found at which it costs what another policy did.

use super::{
    LEAD_FRAMES,
    cost::{Cost, Drawn},
    path::WorkloadPath,
    policy::Policy,
    stage::{Clock, Seen, WorkloadStage},
};

/// How often a baseline runs until its mean is what it is to be, and how near is near enough. Logarithm.
const TUNING_RUNS: usize = 5;
const TUNED_WITHIN: f64 = 0.03;

/// The kinds of policy that have a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Baseline {
    /// [`Policy::Polygons`].
    Polygons,
    /// [`Policy::Distance`].
    Distance,
    /// [`Policy::Threshold`].
    Threshold,
}

/// All of them.
pub const BASELINES: [Baseline; 3] = [Baseline::Polygons, Baseline::Distance, Baseline::Threshold];

/// Everything in view in each frame of a path.
#[derive(Clone, Debug, Default)]
pub struct Census {
    frames: Vec<Frame>,
}

/// One frame: what is drawn of it up to each object, in two orders.
#[derive(Clone, Debug, Default)]
struct Frame {
    /// Nearest first: distance, and all that is drawn up to there.
    near: Vec<(f32, Drawn)>,
    /// Largest first: area, and all that is drawn up to there.
    large: Vec<(f32, Drawn)>,
}

impl Frame {
    fn new(mut seen: Vec<Seen>) -> Self {
        seen.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
        let near = sums(&seen, |seen| seen.distance_m);
        seen.sort_by(|a, b| b.area_px2.total_cmp(&a.area_px2));
        let large = sums(&seen, |seen| seen.area_px2);
        Self { near, large }
    }

    fn drawn(&self, policy: &Policy) -> Drawn {
        let (list, count) = match *policy {
            Policy::Polygons(most) => {
                let few = |of: &(f32, Drawn)| of.1.triangles <= most as f64;
                (&self.near, self.near.partition_point(few))
            }
            Policy::Distance(metres) => {
                let within = |of: &(f32, Drawn)| of.0 <= metres;
                (&self.near, self.near.partition_point(within))
            }
            Policy::Threshold(area) => {
                let large = |of: &(f32, Drawn)| of.0 >= area;
                (&self.large, self.large.partition_point(large))
            }
            Policy::None | Policy::Frustum | Policy::Budget => (&self.near, self.near.len()),
        };
        count
            .checked_sub(1)
            .and_then(|last| list.get(last))
            .map_or_else(Drawn::default, |of| of.1)
    }
}

fn sums(seen: &[Seen], key: impl Fn(&Seen) -> f32) -> Vec<(f32, Drawn)> {
    let mut sum = Drawn::default();
    seen.iter()
        .map(|of| {
            sum = [sum, of.drawn].into_iter().sum();
            (key(of), sum)
        })
        .collect()
}

impl Census {
    /// Goes along a path of so many frames, led up to, under [`Policy::Frustum`]. Leaves the camera so.
    pub fn take(stage: &mut WorkloadStage, path: WorkloadPath, frames: u32) -> Self {
        stage.begin(&Policy::Frustum, 0.0, Clock::Time);
        for frame in -LEAD_FRAMES..0 {
            stage.frame(path, frame, frames);
        }
        let frames = (0..i64::from(frames)).map(|frame| {
            stage.frame(path, frame, frames);
            Frame::new(stage.seen().map(|(_, seen)| seen).collect())
        });
        Self {
            frames: frames.collect(),
        }
    }

    /// Mean over the frames of what a policy with a number, or everything in view, is counted as. units: ms
    pub fn mean_ms(&self, policy: &Policy, cost: &Cost) -> f64 {
        let all = self.frames.iter().map(|frame| cost.of(frame.drawn(policy)));
        all.sum::<f64>() / self.frames.len().max(1) as f64
    }

    /// The least that a frame with everything in view is counted as; 0 without a frame. units: ms
    pub fn least_ms(&self, cost: &Cost) -> f64 {
        let all = self
            .frames
            .iter()
            .map(|frame| cost.of(frame.drawn(&Policy::Frustum)));
        all.min_by(f64::total_cmp).unwrap_or(0.0)
    }

    /// The baseline whose counted mean comes nearest to `mean_ms` from below; where even drawing everything in view
    /// costs less, that; where drawing nothing costs more, that.
    pub fn tuned(&self, baseline: Baseline, cost: &Cost, mean_ms: f64) -> Policy {
        let ends = |list: fn(&Frame) -> &Vec<(f32, Drawn)>| {
            self.frames
                .iter()
                .flat_map(list)
                .map(|of| of.0)
                .filter(|key| key.is_finite())
                .fold((f32::INFINITY, 0.0f32), |(low, high), key| {
                    (low.min(key), high.max(key))
                })
        };
        let fits = |policy: &Policy| self.mean_ms(policy, cost) <= mean_ms;
        match baseline {
            Baseline::Polygons => {
                let most = self.frames.iter().filter_map(|frame| frame.near.last());
                let most = most.map(|of| of.1.triangles as u64).max().unwrap_or(1);
                // Invariant: `low` fits or is 1.
                let (mut low, mut high) = (1, most.max(1) + 1);
                while high - low > 1 {
                    let middle = low + (high - low) / 2;
                    if fits(&Policy::Polygons(middle)) {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                Policy::Polygons(low)
            }
            Baseline::Distance => {
                let (low, high) = ends(|frame| &frame.near);
                Policy::Distance(largest(low.max(1e-3), high.max(1e-3), |metres| {
                    fits(&Policy::Distance(metres))
                }))
            }
            Baseline::Threshold => {
                let (low, high) = ends(|frame| &frame.large);
                let (low, high) = (low.clamp(1e-3, 1e9), high.clamp(1e-3, 1e9) * 1.01);
                // The least area is the largest of its reciprocals.
                let area = |of: f32| 1.0 / of;
                Policy::Threshold(area(largest(area(high), area(low), |of| {
                    fits(&Policy::Threshold(area(of)))
                })))
            }
        }
    }

    /// Runs a baseline at a mean counted time; `run` says what its frames were counted as, in the mean. A census knows
    /// at which number that is, but for what comes into sight when that which hid it is left out, and what is spent on
    /// what is hidden: where what is hidden is not drawn, the number is corrected by what came of it.
    ///
    /// # Errors
    /// Those of `run`.
    pub fn run_tuned<T, E>(
        &self,
        stage: &mut WorkloadStage,
        baseline: Baseline,
        mean_ms: f64,
        mut run: impl FnMut(&mut WorkloadStage, &Policy) -> Result<(f64, T), E>,
    ) -> Result<T, E> {
        let empty_ms = stage.cost.frame_ms;
        // By what share of what is drawn the mean is off. Logarithm.
        let off = |counted_ms: f64| {
            let drawn = |ms: f64| (ms - empty_ms).max(1e-3 * mean_ms);
            (drawn(counted_ms) / drawn(mean_ms)).ln()
        };
        let mut policy = self.tuned(baseline, &stage.cost, mean_ms);
        let (counted_ms, mut best) = run(stage, &policy)?;
        let mut least = off(counted_ms);
        let mut last: Option<(f64, f64)> = None;
        let mut now = least;
        for _ in 1..TUNING_RUNS {
            let Some(number) = policy.parameter().filter(|_| least.abs() > TUNED_WITHIN) else {
                break;
            };
            // More by this power of the number, until two runs tell.
            let usual = if baseline == Baseline::Threshold {
                -1.0
            } else {
                1.0
            };
            let power = last
                .map(|(number_then, then)| (now - then) / (number.ln() - number_then))
                .filter(|power| power.is_finite() && power * usual > 0.2)
                .unwrap_or(usual);
            last = Some((number.ln(), now));
            policy = policy.with_parameter(number * (-now / power).clamp(-2.0, 2.0).exp());
            let (counted_ms, another) = run(stage, &policy)?;
            now = off(counted_ms);
            if now.abs() < least.abs() {
                (least, best) = (now, another);
            }
        }
        Ok(best)
    }
}

/// The largest of the numbers from `low` to `high` that fits, where all below one that fits do, to within a
/// hundred-thousandth; `low` if none does. Both are positive.
fn largest(low: f32, high: f32, fits: impl Fn(f32) -> bool) -> f32 {
    if fits(high) {
        return high;
    }
    let (mut low, mut high) = (low, high);
    while high > 1.000_01 * low {
        let middle = (low * high).sqrt();
        if !(middle > low && middle < high) {
            break;
        }
        if fits(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    fn census() -> Census {
        let frame = |from: u32| {
            let seen = (1..=400u32).map(|i| {
                let hash = (i + 1_000 * from).wrapping_mul(0x9e37_79b1) >> 16;
                Seen {
                    distance_m: (i + 10 * from) as f32,
                    area_px2: hash as f32 / 64.0,
                    drawn: Drawn {
                        objects: 1.0,
                        triangles: f64::from(10 + hash % 300),
                        pixels: f64::from(hash) / 64.0,
                    },
                }
            });
            Frame::new(seen.collect())
        };
        Census {
            frames: (0..8).map(frame).collect(),
        }
    }

    const COST: Cost = Cost {
        object_ms: 0.01,
        triangle_ms: 1e-4,
        pixel_ms: 1e-5,
        frame_ms: 1.0,
    };

    #[test]
    fn tuned_baselines_cost_what_they_are_asked_to() {
        let census = census();
        let whole = census.mean_ms(&Policy::Frustum, &COST);
        for share in [0.3, 0.5, 0.9] {
            let mean_ms = COST.frame_ms + share * (whole - COST.frame_ms);
            for baseline in BASELINES {
                let policy = census.tuned(baseline, &COST, mean_ms);
                let tuned = census.mean_ms(&policy, &COST);
                // One object more or less in each frame.
                let one = 0.01 + 310e-4 + 1024e-5;
                assert!(
                    tuned <= mean_ms && tuned > mean_ms - one,
                    "{policy}: {tuned} for {mean_ms}"
                );
            }
        }
    }

    #[test]
    fn what_cannot_be_met_is_met_as_nearly_as_it_can_be() {
        let census = census();
        let whole = census.mean_ms(&Policy::Frustum, &COST);
        assert!(census.least_ms(&COST) <= whole && census.least_ms(&COST) > COST.frame_ms);
        for baseline in BASELINES {
            let all = census.tuned(baseline, &COST, 10.0 * whole);
            assert_eq!(census.mean_ms(&all, &COST), whole, "{all}");
            let none = census.tuned(baseline, &COST, 0.0);
            assert!(census.mean_ms(&none, &COST) < 1.3, "{none}");
        }
    }

    #[test]
    fn more_is_drawn_the_more_is_allowed() {
        let census = census();
        let mean = |policy| census.mean_ms(&policy, &COST);
        assert!(mean(Policy::Polygons(1_000)) < mean(Policy::Polygons(9_000)));
        assert!(mean(Policy::Distance(50.0)) < mean(Policy::Distance(200.0)));
        assert!(mean(Policy::Threshold(500.0)) < mean(Policy::Threshold(100.0)));
        assert_eq!(mean(Policy::Threshold(0.0)), mean(Policy::Frustum));
    }
}
