//! Objects on their way out of the picture or back into it: Bevy's own dither, driven by time instead of distance.
//!
//! Bevy dithers what has a [`VisibilityRange`] by how far the camera is into the range's margin, in 16 steps. The margins
//! here are so wide that every distance in a scene is the same place in them, so that the step is the one wanted from
//! wherever it is looked at: 15 ranges are all there ever are, and a camera that moves changes none of them.

use bevy::{camera::visibility::VisibilityRange, prelude::*};

/// Steps of Bevy's dither from nothing to all.
pub const STEPS: u8 = 16;

/// How wide the margins are: a scene that is 10⁹ m across is 1/1000 of them. units: m
const WIDE: f32 = 1e12;

/// One object that comes or goes.
#[derive(Clone, Debug)]
pub(crate) struct Fade {
    pub entity: Entity,
    /// Share of its pixels that are drawn. range: 0..=1
    pub coverage: f32,
    /// Whether it goes.
    pub leaves: bool,
    /// Whether it was in view this frame.
    pub seen: bool,
    /// The step that its range stands at; `None` while it has none of ours.
    pub shown: Option<u8>,
    /// It must not be dithered after all: another camera sees it, or it has a range of its own.
    pub cut: bool,
}

/// Everything that comes or goes in one camera.
#[derive(Clone, Debug, Default)]
pub(crate) struct Fades {
    /// Sorted by entity.
    pub list: Vec<Fade>,
    /// New ones, unsorted.
    pub new: Vec<Fade>,
    /// What ended and has a range of ours, which is to be taken from it.
    pub ended: Vec<(Entity, u8)>,
}

/// The range under which an object shows `step` of [`STEPS`] of its pixels at every distance. range: 1..[`STEPS`]
pub fn range(step: u8) -> VisibilityRange {
    let share = f32::from(step.clamp(1, STEPS - 1)) / f32::from(STEPS);
    let (near, far) = (-(1.0 - share) * WIDE, share * WIDE);
    VisibilityRange {
        start_margin: near..near,
        end_margin: near..far,
        use_aabb: false,
    }
}

impl Fade {
    fn new(entity: Entity, leaves: bool) -> Self {
        Self {
            entity,
            coverage: if leaves { 1.0 } else { 0.0 },
            leaves,
            seen: true,
            shown: None,
            cut: false,
        }
    }

    /// The step it is to stand at.
    pub fn step(&self) -> u8 {
        let steps = self.coverage * f32::from(STEPS);
        // Neither all nor nothing while it is on its way.
        (steps.round() as u8).clamp(1, STEPS - 1)
    }

    fn is_over(&self) -> bool {
        self.cut || (self.leaves && self.coverage <= 0.0) || (!self.leaves && self.coverage >= 1.0)
    }
}

impl Fades {
    /// Whether there is nothing to be done.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty() && self.new.is_empty() && self.ended.is_empty()
    }

    /// Begins a frame, `share` of a whole way later than the last.
    pub fn advance(&mut self, share: f32) {
        let ended = &mut self.ended;
        self.list.retain_mut(|fade| {
            let way = if fade.leaves { -share } else { share };
            fade.coverage = (fade.coverage + way).clamp(0.0, 1.0);
            fade.seen = false;
            let over = fade.is_over();
            if over && let Some(step) = fade.shown {
                ended.push((fade.entity, step));
            }
            !over
        });
    }

    /// Notes that an object in view is too small, or is not, and was `known` to be in view last frame with the same or
    /// the other verdict. Says whether it is drawn.
    pub fn is_drawn(&mut self, entity: Entity, small: bool, was_small: bool, known: bool) -> bool {
        if let Ok(i) = self.list.binary_search_by_key(&entity, |fade| fade.entity) {
            let fade = &mut self.list[i];
            fade.leaves = small;
            fade.seen = true;
            return true;
        }
        if known && small != was_small {
            self.new.push(Fade::new(entity, small));
            return true;
        }
        !small
    }

    /// Ends a frame: what was not in view ends, and what is new begins.
    pub fn end_frame(&mut self) {
        let ended = &mut self.ended;
        self.list.retain(|fade| {
            if !fade.seen
                && let Some(step) = fade.shown
            {
                ended.push((fade.entity, step));
            }
            fade.seen
        });
        if !self.new.is_empty() {
            self.list.append(&mut self.new);
            self.list.sort_unstable_by_key(|fade| fade.entity);
        }
    }

    /// Ends all at once.
    pub fn end_all(&mut self) {
        self.new.clear();
        let shown = |fade: Fade| Some((fade.entity, fade.shown?));
        self.ended.extend(self.list.drain(..).filter_map(shown));
    }

    /// Everything that has a range of ours, and its step.
    pub fn with_range(&self) -> impl Iterator<Item = (Entity, u8)> + '_ {
        let shown = |fade: &Fade| Some((fade.entity, fade.shown?));
        self.ended
            .iter()
            .copied()
            .chain(self.list.iter().filter_map(shown))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As `get_visibility_range_dither_level` in Bevy's `mesh_functions.wgsl`.
    fn bevys_level(range: &VisibilityRange, distance: f32) -> i32 {
        let far = distance >= range.end_margin.start;
        let (offset, bounds) = if far {
            (0, &range.end_margin)
        } else {
            (-16, &range.start_margin)
        };
        let level = ((distance - bounds.start) / (bounds.end - bounds.start) * 16.0).round() as i32;
        offset + level.clamp(0, 16)
    }

    #[test]
    fn a_range_shows_its_step_at_every_distance() {
        for step in 1..STEPS {
            for distance in [0.0, 1e-3, 1.0, 1e3, 1e7, 1e9] {
                let range = range(step);
                assert!(range.is_visible_at_all(distance));
                assert_eq!(bevys_level(&range, distance), i32::from(STEPS - step));
            }
        }
    }

    #[test]
    fn a_fade_goes_its_way_turns_and_ends() {
        let entity = Entity::from_raw_u32(7).expect("an index");
        let mut fades = Fades::default();
        let mut frame = |small, was_small, known| {
            fades.advance(0.25);
            let drawn = fades.is_drawn(entity, small, was_small, known);
            fades.end_frame();
            let coverage = fades.list.first().map(|fade| fade.coverage);
            (drawn, coverage)
        };
        assert_eq!(frame(true, false, false), (false, None), "never seen: cut");
        assert_eq!(frame(false, false, true), (true, None));
        assert_eq!(frame(true, false, true), (true, Some(1.0)));
        assert_eq!(frame(true, true, true), (true, Some(0.75)));
        assert_eq!(frame(true, true, true), (true, Some(0.5)));
        assert_eq!(frame(false, true, true), (true, Some(0.25)));
        assert_eq!(frame(false, false, true), (true, Some(0.5)));
        assert_eq!(frame(false, false, true), (true, Some(0.75)));
        assert_eq!(frame(false, false, true), (true, None), "back for good");
        assert_eq!(frame(true, false, true), (true, Some(1.0)));
        for coverage in [0.75, 0.5, 0.25] {
            assert_eq!(frame(true, true, true), (true, Some(coverage)));
        }
        assert_eq!(frame(true, true, true), (false, None), "gone for good");
    }
}
