//! What is done to a shadow map in one frame: pure bookkeeping, no GPU.
//!
//! A map is worked on where it does not show, and shown by copying. What shows is at every moment the work of one
//! light in one place, over the whole map:
//!
//! - When the light or the method changes, all tiles are made: first every tile coarsely, one ray for 4×4 samples,
//!   then exactly those in some camera's view, then the rest. As soon as none in view is left, all of it shows;
//!   what is still coarse follows tile by tile. A light that has moved on by then starts over from there.
//! - When heights change, the tiles whose rays can cross the edit are made anew, and show together.
//! - A sweep goes through all its lines, and then shows.

use core::ops::Range;

use super::{
    ShadowMethod,
    light::GridLight,
    tiles::{TILE, TileGrid, TileSet},
};

/// Rays of a tile made exactly, and coarsely.
const TILE_RAYS: u64 = (TILE * TILE) as u64;
const COARSE_RAYS: u64 = TILE_RAYS / 16;

/// What a map is made for; anything else makes it anew.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MadeFor {
    /// The light.
    pub light: GridLight,
    /// How.
    pub method: ShadowMethod,
    /// Strips of the light's disc; 0 = hard.
    pub strips: u32,
    /// Counts how often all heights were replaced.
    pub heights: u64,
}

impl MadeFor {
    /// Settles what of the settings a light can have: lights without a size have no strips, and those that cannot
    /// be swept away from are seen along rays.
    pub fn new(light: &GridLight, method: ShadowMethod, strips: u32, heights: u64) -> Self {
        let method = match method {
            ShadowMethod::Sweep if !light.can_sweep() => ShadowMethod::MaxMip,
            method => method,
        };
        let hard = light.radius == 0.0 || strips == 0;
        Self {
            light: *light,
            method,
            strips: match method {
                _ if hard => 0,
                ShadowMethod::Sweep => 1,
                _ => strips,
            },
            heights,
        }
    }
}

/// What to compute in a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Work {
    /// Nothing.
    #[default]
    None,
    /// The tiles listed in [`MapPlan::list`], one ray for 4×4 samples.
    Coarse,
    /// The tiles listed in [`MapPlan::list`], one ray a sample.
    Exact,
    /// Lines of a sweep.
    Lines {
        /// Which.
        lines: Range<i32>,
        /// Whether the map has to be cleared before.
        first: bool,
    },
}

/// What to show after the frame's work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Publish {
    /// Nothing new.
    #[default]
    None,
    /// The whole map.
    All,
    /// The tiles in [`MapPlan::list`].
    Listed,
    /// The tiles in [`MapPlan::edited`].
    Edited,
}

/// One frame of a map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Step {
    /// To compute.
    pub work: Work,
    /// To show afterwards.
    pub publish: Publish,
    /// Rays, or samples swept over, that the work amounts to.
    pub rays: u64,
}

#[derive(Debug)]
struct Job {
    made_for: MadeFor,
    /// All tiles, or only edited ones.
    whole: bool,
    /// The next tile to make coarsely; all are when it is the number of tiles.
    coarse_next: u32,
    /// Whether every tile has been made, if only coarsely, so that the whole may show.
    complete: bool,
    /// Lines still to sweep.
    lines: Range<i32>,
    swept: bool,
    published: bool,
}

/// What is known of one map, and what is still to do.
#[derive(Debug, Default)]
pub struct MapPlan {
    grid: TileGrid,
    shown: Option<MadeFor>,
    job: Option<Job>,
    /// Tiles of the job not made exactly yet.
    left: TileSet,
    /// Tiles that edits of the heights have made stale since the job began.
    stale: TileSet,
    /// Tiles of an edit's job.
    edited: TileSet,
    list: Vec<u32>,
}

/// Lines of a sweep: which, and the samples on each.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepLines {
    /// Numbers of the lines.
    pub lines: Range<i32>,
    /// Samples a line goes over.
    pub columns: u32,
}

impl MapPlan {
    /// A map of these tiles, of which nothing is made.
    pub fn new(grid: TileGrid) -> Self {
        let mut plan = Self {
            grid,
            ..Self::default()
        };
        plan.stale.reset(grid.len());
        plan
    }

    /// Its tiles.
    pub fn grid(&self) -> TileGrid {
        self.grid
    }

    /// What the map that shows was made for; `None` before the first.
    pub fn shown(&self) -> Option<&MadeFor> {
        self.shown.as_ref()
    }

    /// Whether there is nothing to do for `wanted`.
    pub fn is_done(&self, wanted: &MadeFor) -> bool {
        self.job.is_none() && self.stale.is_empty() && self.shown.as_ref() == Some(wanted)
    }

    /// Whether it is being made and does not show yet, so that what is made of it so far must be kept.
    pub fn is_half_made(&self) -> bool {
        self.job.as_ref().is_some_and(|job| !job.published)
    }

    /// What the frame's work is for.
    pub fn working_on(&self) -> Option<&MadeFor> {
        self.job
            .as_ref()
            .map(|job| &job.made_for)
            .or(self.shown.as_ref())
    }

    /// Tiles that this frame completes, coarsely or exactly.
    pub fn list(&self) -> &[u32] {
        &self.list
    }

    /// Tiles of the edit that shows after this frame.
    pub fn edited(&self) -> &TileSet {
        &self.edited
    }

    /// An edit of the heights has made a tile stale.
    pub fn touch(&mut self, tile: u32) {
        self.stale.insert(tile);
    }

    /// The next frame's work: at most `budget` rays, but never nothing while something is left. `sweep` are the
    /// lines of `wanted` if its method goes by lines.
    pub fn step(
        &mut self,
        wanted: &MadeFor,
        sweep: Option<SweepLines>,
        budget: u64,
        visible: impl Fn(u32) -> bool,
    ) -> Step {
        self.list.clear();
        let tiles = self.grid.len();
        if self.is_done(wanted) || tiles == 0 {
            return Step::default();
        }
        let abandoned = self.job.as_ref().is_some_and(|job| {
            // A map of heights that are no more is not worth completing.
            let replaced = job.made_for.heights != wanted.heights;
            job.made_for != *wanted && (job.published || !job.whole || replaced)
        });
        if self.job.is_none() || abandoned {
            self.begin(wanted, sweep.as_ref(), budget);
        }
        let Some(job) = &mut self.job else {
            return Step::default();
        };
        let mut step = Step::default();
        let strips = u64::from(job.made_for.strips.max(1));
        if job.swept {
            // The lines of the job's own light, which may not be those wanted by now.
            let columns =
                u64::from(sweep.map_or(self.grid.count.max_element() * TILE, |s| s.columns));
            let count = (budget / columns.max(1)).clamp(64, i32::MAX as u64) as i32;
            let end = job.lines.start.saturating_add(count).min(job.lines.end);
            step.work = Work::Lines {
                lines: job.lines.start..end,
                first: job.coarse_next == 0,
            };
            step.rays = (end - job.lines.start) as u64 * columns;
            job.coarse_next = 1;
            job.lines.start = end;
            if job.lines.is_empty() {
                step.publish = Publish::All;
                self.list.extend(0..tiles);
                self.finish();
            }
            return step;
        }
        if job.whole && job.coarse_next < tiles {
            let count = (budget / (COARSE_RAYS * strips)).clamp(1, u64::from(tiles)) as u32;
            let end = (job.coarse_next + count).min(tiles);
            self.list.extend(job.coarse_next..end);
            step.work = Work::Coarse;
            step.rays = u64::from(end - job.coarse_next) * COARSE_RAYS * strips;
            job.coarse_next = end;
            job.complete = end == tiles;
        } else {
            let count = (budget / (TILE_RAYS * strips)).clamp(1, u64::from(tiles)) as usize;
            if count < self.left.len() as usize {
                let in_view = self.left.iter().filter(|tile| visible(*tile));
                self.list.extend(in_view.take(count));
            }
            if self.list.is_empty() {
                self.list.extend(self.left.iter().take(count));
            }
            for tile in &self.list {
                self.left.remove(*tile);
            }
            step.work = Work::Exact;
            step.rays = self.list.len() as u64 * TILE_RAYS * strips;
        }
        if job.published {
            step.publish = Publish::Listed;
        } else if !job.whole {
            if self.left.is_empty() {
                step.publish = Publish::Edited;
            }
        } else if self.left.is_empty() || (job.complete && !self.left.iter().any(&visible)) {
            step.publish = Publish::All;
            job.published = true;
            self.shown = Some(job.made_for);
        }
        if self.left.is_empty() {
            self.finish();
        }
        step
    }

    fn begin(&mut self, wanted: &MadeFor, sweep: Option<&SweepLines>, budget: u64) {
        let tiles = self.grid.len();
        let whole = self.shown.as_ref() != Some(wanted) || sweep.is_some();
        let strips = u64::from(wanted.strips.max(1));
        if whole {
            self.left.fill(tiles);
        } else {
            core::mem::swap(&mut self.left, &mut self.stale);
            self.edited.reset(tiles);
            for tile in self.left.iter() {
                self.edited.insert(tile);
            }
        }
        self.stale.reset(tiles);
        let at_once = u64::from(tiles) * TILE_RAYS * strips <= budget;
        self.job = Some(Job {
            made_for: *wanted,
            whole,
            // What fits into one frame needs no stand-in.
            coarse_next: if sweep.is_none() && (at_once || !whole) {
                tiles
            } else {
                0
            },
            complete: false,
            lines: sweep.map_or(0..0, |sweep| sweep.lines.clone()),
            swept: sweep.is_some(),
            published: false,
        });
    }

    fn finish(&mut self) {
        if let Some(job) = self.job.take() {
            self.shown = Some(job.made_for);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::math::{DAffine3, DVec3, URect};

    fn wanted(elevation: f64) -> MadeFor {
        let to_light = DVec3::new(1.0, elevation, 0.0);
        MadeFor {
            light: GridLight::directional(to_light, 0.0, DAffine3::IDENTITY),
            method: ShadowMethod::MaxMip,
            strips: 0,
            heights: 0,
        }
    }

    fn plan() -> MapPlan {
        MapPlan::new(TileGrid::over(URect::new(0, 0, 256, 256)))
    }

    /// Steps until nothing is left; returns the steps.
    fn run(
        plan: &mut MapPlan,
        wanted: &MadeFor,
        budget: u64,
        visible: fn(u32) -> bool,
    ) -> Vec<Step> {
        let mut steps = Vec::new();
        while !plan.is_done(wanted) {
            steps.push(plan.step(wanted, None, budget, visible));
            assert!(steps.len() < 1000, "it never ends");
        }
        assert_eq!(plan.step(wanted, None, budget, visible), Step::default());
        steps
    }

    #[test]
    fn tiles_in_view_come_first_and_show_before_the_rest_is_exact() {
        let mut plan = plan();
        let sun = wanted(0.5);
        let mut made = Vec::new();
        let mut shown_after = None;
        while !plan.is_done(&sun) {
            let step = plan.step(&sun, None, 2 * TILE_RAYS, |tile| tile >= 12);
            if step.work == Work::Exact {
                made.extend_from_slice(plan.list());
            }
            if step.publish == Publish::All {
                shown_after = Some(made.len());
            }
        }
        assert_eq!(&made[..4], [12, 13, 14, 15]);
        assert_eq!(shown_after, Some(4), "as soon as none in view is left");
        made.sort_unstable();
        assert_eq!(made, (0..16).collect::<Vec<_>>(), "each tile once");
    }

    #[test]
    fn what_fits_into_a_frame_is_made_in_one() {
        let steps = run(&mut plan(), &wanted(0.5), 16 * TILE_RAYS, |_| true);
        let whole = Step {
            work: Work::Exact,
            publish: Publish::All,
            rays: 16 * TILE_RAYS,
        };
        assert_eq!(steps, [whole]);
    }

    #[test]
    fn what_was_never_made_is_never_shown_even_if_all_fits_a_frame() {
        let mut plan = plan();
        let step = plan.step(&wanted(0.5), None, 16 * TILE_RAYS, |tile| tile < 4);
        assert_eq!(step.publish, Publish::All);
        assert_eq!(plan.list().len(), 16);
        // The estimate turns out wrong after the first step: no coarse tiles were made, so all must be exact.
        let mut plan = super::tests::plan();
        let sun = wanted(0.5);
        plan.begin(&sun, None, 16 * TILE_RAYS);
        let steps = run(&mut plan, &sun, TILE_RAYS, |tile| tile < 4);
        assert_eq!(steps.len(), 16);
        let early = &steps[..15];
        assert!(early.iter().all(|step| step.publish == Publish::None));
    }

    #[test]
    fn no_step_exceeds_its_budget_by_more_than_a_tile_and_each_gets_on() {
        for budget in [0, 1, TILE_RAYS, 5 * TILE_RAYS] {
            let steps = run(&mut plan(), &wanted(0.5), budget, |tile| tile % 3 == 0);
            assert!(
                steps
                    .iter()
                    .all(|step| step.rays > 0 && step.rays <= budget.max(TILE_RAYS))
            );
        }
    }

    #[test]
    fn a_light_that_keeps_moving_still_shows() {
        let mut plan = plan();
        let mut shown = 0;
        for n in 0..100 {
            let sun = wanted(0.5 + f64::from(n));
            let step = plan.step(&sun, None, TILE_RAYS, |tile| tile < 4);
            shown += u32::from(step.publish == Publish::All);
        }
        // Sixteen coarse tiles fit one frame, four exact ones take four.
        assert_eq!(shown, 20);
    }

    #[test]
    fn an_edit_makes_its_tiles_and_shows_them_together() {
        let mut plan = plan();
        let sun = wanted(0.5);
        run(&mut plan, &sun, u64::MAX, |_| true);
        for tile in [3, 7, 8] {
            plan.touch(tile);
        }
        let steps = run(&mut plan, &sun, TILE_RAYS, |_| true);
        let publishes: Vec<_> = steps.iter().map(|step| step.publish).collect();
        assert_eq!(publishes, [Publish::None, Publish::None, Publish::Edited]);
        assert_eq!(plan.edited().iter().collect::<Vec<_>>(), [3, 7, 8]);
    }

    #[test]
    fn an_edit_while_a_map_is_made_is_not_lost() {
        let mut plan = plan();
        let sun = wanted(0.5);
        plan.step(&sun, None, 20 * TILE_RAYS / 2, |_| true);
        plan.touch(0);
        let steps = run(&mut plan, &sun, u64::MAX, |_| true);
        assert_eq!(steps.last().map(|step| step.publish), Some(Publish::Edited));
    }

    #[test]
    fn a_sweep_goes_through_all_its_lines_once() {
        let mut plan = plan();
        let sun = MadeFor {
            method: ShadowMethod::Sweep,
            ..wanted(0.5)
        };
        let sweep = SweepLines {
            lines: -100..400,
            columns: 256,
        };
        let mut next = -100;
        while !plan.is_done(&sun) {
            let step = plan.step(&sun, Some(sweep.clone()), 200 * 256, |_| true);
            let Work::Lines { lines, first } = step.work else {
                panic!("{step:?}")
            };
            assert_eq!((lines.start, first), (next, next == -100));
            next = lines.end;
            assert_eq!(step.publish == Publish::All, next == 400);
        }
        assert_eq!(next, 400);
    }
}
