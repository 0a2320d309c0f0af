//! Frame times of the last few seconds, and what they come to.

/// How many frames are kept.
pub const FRAMES: usize = 240;

/// The last [`FRAMES`] frame times, in a ring. Takes no memory but its own.
#[derive(Clone, Debug)]
pub struct FrameTimes {
    ring: [f32; FRAMES],
    /// Where the next one goes.
    next: usize,
    len: usize,
}

impl Default for FrameTimes {
    fn default() -> Self {
        Self {
            ring: [0.0; FRAMES],
            next: 0,
            len: 0,
        }
    }
}

impl FrameTimes {
    /// Keeps a frame time and lets the oldest go. A time that is negative or not finite is not kept. units: ms
    pub fn push(&mut self, ms: f32) {
        if !ms.is_finite() || ms < 0.0 {
            return;
        }
        self.ring[self.next] = ms;
        self.next = (self.next + 1) % FRAMES;
        self.len = (self.len + 1).min(FRAMES);
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// From the oldest to the newest. units: ms
    pub fn iter(&self) -> impl ExactSizeIterator<Item = f32> + '_ {
        let oldest = self.next + FRAMES - self.len;
        (0..self.len).map(move |i| self.ring[(oldest + i) % FRAMES])
    }

    /// How many are kept. range: 0..=[`FRAMES`]
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether none is kept.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// What they come to; `None` where there is none.
    pub fn stats(&self, target_ms: Option<f32>) -> Option<FrameStats> {
        if self.is_empty() {
            return None;
        }
        let n = self.len as f64;
        let mean = self.iter().map(f64::from).sum::<f64>() / n;
        // About the mean that is already known: a sum of squares would cancel.
        let variance = self
            .iter()
            .map(|ms| (f64::from(ms) - mean).powi(2))
            .sum::<f64>()
            / n;
        let mut sorted = self.ring;
        let kept = &mut sorted[..self.len];
        for (to, from) in kept.iter_mut().zip(self.iter()) {
            *to = from;
        }
        let rank = (0.99 * n).ceil() as usize - 1;
        let (_, p99, _) = kept.select_nth_unstable_by(rank, f32::total_cmp);
        let p99_ms = *p99;
        Some(FrameStats {
            mean_ms: mean as f32,
            p99_ms,
            std_ms: variance.sqrt() as f32,
            max_ms: self.iter().fold(0.0, f32::max),
            over_budget: target_ms.map(|target| {
                let over = self.iter().filter(|ms| *ms > target).count();
                over as f32 / self.len as f32
            }),
        })
    }
}

/// What frame times come to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameStats {
    /// units: ms
    pub mean_ms: f32,
    /// The least time that at least 99 % of the frames do not exceed. units: ms
    pub p99_ms: f32,
    /// Standard deviation of these frames, not an estimate for others. units: ms
    pub std_ms: f32,
    /// units: ms
    pub max_ms: f32,
    /// Share of the frames that took longer than the target, where there is one. range: 0..=1
    pub over_budget: Option<f32>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(times: impl IntoIterator<Item = f32>) -> FrameTimes {
        let mut frames = FrameTimes::default();
        times.into_iter().for_each(|ms| frames.push(ms));
        frames
    }

    #[test]
    fn the_oldest_goes_first() {
        let frames = of((0..FRAMES + 10).map(|i| i as f32));
        assert_eq!(frames.len(), FRAMES);
        assert_eq!(frames.iter().next(), Some(10.0));
        assert_eq!(frames.iter().last(), Some((FRAMES + 9) as f32));
        assert!(
            frames
                .iter()
                .zip(frames.iter().skip(1))
                .all(|(a, b)| b - a == 1.0)
        );
    }

    #[test]
    fn statistics_are_those_of_the_textbook() {
        let stats = of([2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0])
            .stats(Some(4.5))
            .unwrap();
        assert_eq!(stats.mean_ms, 5.0);
        assert_eq!(stats.std_ms, 2.0);
        assert_eq!(stats.p99_ms, 9.0);
        assert_eq!(stats.max_ms, 9.0);
        assert_eq!(stats.over_budget, Some(0.5));
    }

    #[test]
    fn the_99th_percentile_leaves_out_one_frame_in_a_hundred() {
        // Shuffled, for it must not depend on the order.
        let stats = of((0..200).map(|i| ((i * 77) % 200) as f32 + 1.0))
            .stats(None)
            .unwrap();
        assert_eq!(stats.p99_ms, 198.0);
        assert_eq!(stats.over_budget, None);
        // The ring has gone round, and one frame of 240 is beyond.
        let spike = of((0..500).map(|i| if i == 400 { 90.0 } else { 16.0 }))
            .stats(Some(16.0))
            .unwrap();
        assert_eq!(spike.p99_ms, 16.0);
        assert_eq!(spike.max_ms, 90.0);
        assert_eq!(spike.over_budget, Some(1.0 / FRAMES as f32));
    }

    #[test]
    fn what_is_no_time_is_not_kept() {
        let frames = of([f32::NAN, f32::INFINITY, -1.0, 0.0, 3.0]);
        assert_eq!(frames.iter().collect::<Vec<_>>(), [0.0, 3.0]);
        assert_eq!(of([]).stats(Some(1.0)), None);
        let mut cleared = frames;
        cleared.clear();
        assert_eq!(cleared.stats(None), None);
    }
}
