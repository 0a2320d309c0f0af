//! Whether culling pays: works while it saves more than it costs, rests while it does not, and probes again later.
//!
//! A pure state machine: it is told what each frame took and did, and says what the next one is to do.

/// What one frame took and did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Frame {
    /// Time of the whole frame. units: ms
    pub frame_ms: f32,
    /// Time that culling itself took, CPU and, where it is known, GPU. units: ms
    pub own_ms: f32,
    /// Objects in view, removed ones included.
    pub in_view: usize,
    /// Objects removed and not drawn late; while probing, objects that would have been removed.
    pub removed: usize,
    /// Whether a verdict came back for this frame: without one it says nothing about what culling saves.
    pub judged: bool,
}

/// What the next frame is to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Plan {
    /// Cull.
    #[default]
    Work,
    /// Look what culling would remove, and remove nothing.
    Probe,
    /// Nothing.
    Rest,
}

/// Frames whose medians are compared, and frames that culling must have failed to pay before it rests.
const WINDOW: usize = 16;
/// Frames rested at first; doubled each time that probing finds no reason to work.
const FIRST_REST: u32 = 60;
/// Most frames rested. At 60 frames a second, half a minute.
const LONGEST_REST: u32 = 1920;
/// Frames a probe waits for its verdict before it is given up.
const PROBE_PATIENCE: u32 = 16;
/// How many times its cost culling must promise to save before it is taken up again: so that it does not go back
/// and forth where the two are alike.
const TAKE_UP: f32 = 2.0;
/// How much faster frames must have been with culling, measured, to take it up again against the estimate.
const FASTER: f32 = 0.98;
/// Frames for which a measurement outweighs the estimate.
const TRUST: u32 = 1920;

/// Decides. See [`Frame`] and [`Plan`].
#[derive(Clone, Debug, Default)]
pub struct Pace {
    plan: Plan,
    /// Frames in the present plan.
    frames: u32,
    rest: u32,
    /// Of the last frames: how long they took.
    recent: Ring,
    /// Of the last frames worked: what culling took.
    own: Ring,
    unpaid: usize,
    /// Objects in view when it began to rest.
    resting_with: usize,
    /// Median of frames while it worked, to be compared with those while it rests.
    worked_ms: Option<f32>,
    /// Frames for which the estimate is not asked, because measuring contradicted it.
    trusted: u32,
    saved_ms: f32,
}

impl Pace {
    /// What the present frame does.
    pub fn plan(&self) -> Plan {
        self.plan
    }

    /// What culling was last estimated to save a frame. units: ms
    pub fn saved_ms(&self) -> f32 {
        self.saved_ms
    }

    /// What culling takes a frame, at the median. units: ms
    pub fn own_ms(&self) -> f32 {
        self.own.median().unwrap_or(0.0)
    }

    /// Frames until the next probe, while it rests.
    pub fn frames_to_probe(&self) -> u32 {
        self.rest.saturating_sub(self.frames)
    }

    /// Takes in what the present frame took and did, and plans the next.
    pub fn step(&mut self, frame: &Frame) -> Plan {
        self.frames = self.frames.saturating_add(1);
        self.trusted = self.trusted.saturating_sub(1);
        if frame.frame_ms.is_finite() && frame.frame_ms > 0.0 {
            self.recent.push(frame.frame_ms);
        }
        let next = match self.plan {
            Plan::Work => self.worked(frame),
            Plan::Rest => self.rested(frame),
            Plan::Probe => self.probed(frame),
        };
        if next != self.plan {
            self.resting_with = frame.in_view;
            self.plan = next;
            self.frames = 0;
        }
        next
    }

    fn worked(&mut self, frame: &Frame) -> Plan {
        if !frame.judged {
            return Plan::Work;
        }
        self.own.push(frame.own_ms.max(0.0));
        self.saved_ms = self.estimate(frame);
        if self.saved_ms >= self.own_ms() {
            self.unpaid = 0;
            return Plan::Work;
        }
        self.unpaid += 1;
        if self.unpaid < WINDOW || self.trusted > 0 {
            return Plan::Work;
        }
        self.unpaid = 0;
        self.worked_ms = self.recent.median();
        self.recent.clear();
        self.rest = (self.rest * 2).clamp(FIRST_REST, LONGEST_REST);
        Plan::Rest
    }

    fn rested(&mut self, frame: &Frame) -> Plan {
        // Measured: was it faster with culling after all?
        if self.frames as usize >= WINDOW
            && let (Some(worked), Some(resting)) = (self.worked_ms, self.recent.median())
        {
            self.worked_ms = None;
            if worked < resting * FASTER {
                self.trusted = TRUST;
                self.rest = 0;
                return Plan::Work;
            }
        }
        // Another scene may be worth another look.
        let (was, is) = (self.resting_with, frame.in_view);
        let another = is.abs_diff(was) * 4 > was.max(64);
        if another && self.frames as usize >= WINDOW {
            self.rest = 0;
            return Plan::Probe;
        }
        if self.frames < self.rest {
            Plan::Rest
        } else {
            Plan::Probe
        }
    }

    fn probed(&mut self, frame: &Frame) -> Plan {
        if !frame.judged {
            return if self.frames < PROBE_PATIENCE {
                Plan::Probe
            } else {
                Plan::Rest
            };
        }
        self.saved_ms = self.estimate(frame);
        if self.saved_ms > TAKE_UP * self.own_ms().max(frame.own_ms) {
            self.rest = 0;
            return Plan::Work;
        }
        self.rest = (self.rest * 2).clamp(FIRST_REST, LONGEST_REST);
        Plan::Rest
    }

    /// What the objects removed would have cost, if each cost what each of the drawn ones does.
    fn estimate(&self, frame: &Frame) -> f32 {
        let drawn = frame.in_view.saturating_sub(frame.removed).max(1);
        let present = if self.plan == Plan::Probe {
            // Nothing was removed: the frame as it is has them all.
            return self.recent.median().unwrap_or(0.0) * frame.removed as f32
                / frame.in_view.max(1) as f32;
        } else {
            self.recent.median().unwrap_or(0.0)
        };
        (present - self.own_ms()).max(0.0) * frame.removed as f32 / drawn as f32
    }
}

/// The last few measurements.
#[derive(Clone, Debug, Default)]
struct Ring {
    of: [f32; WINDOW],
    len: usize,
    next: usize,
}

impl Ring {
    fn push(&mut self, value: f32) {
        self.of[self.next] = value;
        self.next = (self.next + 1) % WINDOW;
        self.len = (self.len + 1).min(WINDOW);
    }

    fn clear(&mut self) {
        *self = Self::default();
    }

    fn median(&self) -> Option<f32> {
        let mut sorted = self.of;
        let sorted = &mut sorted[..self.len];
        sorted.sort_unstable_by(f32::total_cmp);
        sorted.get(self.len / 2).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(frame_ms: f32, own_ms: f32, in_view: usize, removed: usize) -> Frame {
        Frame {
            frame_ms,
            own_ms,
            in_view,
            removed,
            judged: true,
        }
    }

    fn run(pace: &mut Pace, frames: usize, mut what: impl FnMut(Plan) -> Frame) -> [usize; 3] {
        let mut counts = [0; 3];
        for _ in 0..frames {
            counts[pace.plan() as usize] += 1;
            pace.step(&what(pace.plan()));
        }
        counts
    }

    #[test]
    fn what_pays_is_kept_up() {
        let mut pace = Pace::default();
        let [work, ..] = run(&mut pace, 1000, |_| frame(10.0, 1.0, 1000, 900));
        assert_eq!(work, 1000);
        assert!(pace.saved_ms() > 50.0);
    }

    #[test]
    fn what_removes_nothing_rests_ever_longer_and_probes() {
        let mut pace = Pace::default();
        let [work, probe, rest] = run(&mut pace, 10_000, |_| frame(10.0, 0.2, 1000, 0));
        assert_eq!(work, WINDOW);
        assert!((4..20).contains(&probe), "{probe} probes");
        assert!(rest > 9_900);
    }

    #[test]
    fn a_probe_that_finds_enough_takes_it_up_again() {
        let mut pace = Pace::default();
        run(&mut pace, 200, |_| frame(10.0, 0.2, 1000, 0));
        assert_eq!(pace.plan(), Plan::Rest);
        let [work, ..] = run(&mut pace, 400, |plan| {
            frame(10.0, 0.2, 1000, if plan == Plan::Rest { 0 } else { 500 })
        });
        assert!(work > 0 && pace.plan() == Plan::Work);
    }

    #[test]
    fn another_scene_is_looked_at_soon() {
        let mut pace = Pace::default();
        run(&mut pace, 3000, |_| frame(10.0, 0.2, 1000, 0));
        assert!(pace.plan() == Plan::Rest && pace.frames_to_probe() > 100);
        let [work, probe, _] = run(&mut pace, 40, |_| frame(10.0, 0.2, 5000, 4000));
        assert!(probe == 1 && work > 0, "{probe} {work}");
    }

    #[test]
    fn measuring_outweighs_the_estimate() {
        // Few objects are removed, but dear ones: frames take twice as long without.
        let mut pace = Pace::default();
        let [work, probe, rest] = run(&mut pace, 1000, |plan| match plan {
            Plan::Work => frame(10.0, 1.0, 1000, 5),
            _ => frame(20.0, 0.0, 1000, 0),
        });
        assert_eq!((probe, rest), (0, WINDOW));
        assert_eq!(work, 1000 - WINDOW);
    }

    #[test]
    fn frames_without_a_verdict_or_a_valid_time_decide_nothing() {
        let mut pace = Pace::default();
        for frame_ms in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e30] {
            let [work, ..] = run(&mut pace, 100, |_| Frame {
                judged: false,
                ..frame(frame_ms, f32::NAN, 0, 0)
            });
            assert_eq!(work, 100);
        }
        run(&mut pace, 100, |_| frame(f32::NAN, f32::NAN, 0, 0));
        assert!(pace.saved_ms().is_finite());
    }

    #[test]
    fn a_probe_that_hears_nothing_gives_up() {
        let mut pace = Pace::default();
        run(&mut pace, WINDOW, |_| frame(10.0, 0.2, 1000, 0));
        let [_, probe, _] = run(&mut pace, 200, |_| Frame {
            judged: false,
            ..frame(10.0, 0.0, 1000, 0)
        });
        assert!(probe >= PROBE_PATIENCE as usize);
        assert_eq!(pace.plan(), Plan::Rest);
    }
}
