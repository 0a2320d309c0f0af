//! Which objects go: those below the user's own threshold, and in which order others when a
//! [`FrameBudget`](crate::budget::FrameBudget) demands that some do.
//!
//! P4 leaves out what covers least. Where time is what is short, an object with many triangles has to be worth more of
//! the picture than one with few: for the same time, several of the latter stay. So the budget compares an object's
//! area divided by the root of what its triangles weigh. What it is divided by lies midway, by ratio, between nothing
//! (P4's order, right where every object costs the same) and the triangles themselves (right where nothing else
//! costs): which of them a machine is nearer to need not be known, and the order does not change while that is learned.
//! The threshold that users set on [`ContributionCulling`](super::ContributionCulling) is of the area alone, as in P4.

/// So many triangles weigh as much as being an object does.
const AN_OBJECT: f32 = 64.0;

pub use crate::culling::NEVER_GOES;

fn weight(triangles: u32) -> f32 {
    (1.0 + triangles as f32 / AN_OBJECT).sqrt()
}

/// What a camera's objects are held to, apart from what is demanded.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Standard {
    /// What covers less goes. units: px²
    pub own_px2: f32,
    /// How many times the area it takes to come back, at least 1.
    pub hysteresis: f32,
    /// What covers so much does not go by a demand. units: px²
    pub never_px2: f32,
}

impl Standard {
    fn back(&self, was_gone: bool) -> f32 {
        if was_gone { self.hysteresis } else { 1.0 }
    }

    /// What an object has to cover, as far as it shows, so as not to go; `area_px2` is that of all of it. units: px²
    pub fn least_px2(
        &self,
        area_px2: f32,
        triangles: u32,
        demanded_px2: f32,
        was_gone: bool,
    ) -> f32 {
        let back = self.back(was_gone);
        let least = if demanded_px2 > 0.0 && area_px2 < self.never_px2 * back {
            self.own_px2.max(demanded_px2 * weight(triangles))
        } else {
            self.own_px2
        };
        least * back
    }

    /// Up to which demand an object stays: more, and it goes. Infinite for what never goes by one, `None` for what the
    /// user's own threshold takes. units: px²
    pub fn stays_up_to_px2(&self, area_px2: f32, triangles: u32, was_gone: bool) -> Option<f32> {
        let area_px2 = area_px2 / self.back(was_gone);
        if area_px2 < self.own_px2 {
            None
        } else if area_px2 >= self.never_px2 {
            Some(f32::INFINITY)
        } else {
            Some(area_px2 / weight(triangles))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STANDARD: Standard = Standard {
        own_px2: 2.0,
        hysteresis: 1.25,
        never_px2: 1_000.0,
    };

    fn goes(area: f32, triangles: u32, demanded: f32, was_gone: bool) -> bool {
        area < STANDARD.least_px2(area, triangles, demanded, was_gone)
    }

    #[test]
    fn what_stays_up_to_a_demand_goes_above_it() {
        for triangles in [0, 1, 12, 736, 1_000_000, u32::MAX] {
            for area in [3.0, 64.0, 999.0] {
                for was_gone in [false, true] {
                    let most = STANDARD.stays_up_to_px2(area, triangles, was_gone);
                    let most = most.expect("its own threshold keeps it");
                    // A few roundings there and back.
                    assert!(!goes(area, triangles, most * 0.999_999, was_gone));
                    assert!(goes(area, triangles, most * 1.000_001, was_gone));
                }
            }
        }
    }

    #[test]
    fn the_users_own_threshold_is_of_the_area_alone() {
        assert_eq!(STANDARD.stays_up_to_px2(1.9, 0, false), None);
        assert_eq!(STANDARD.stays_up_to_px2(2.4, 0, true), None);
        for demanded in [0.0, 1e-9] {
            assert!(goes(1.9, 0, demanded, false) && goes(2.4, 0, demanded, true));
            assert!(!goes(2.1, u32::MAX, demanded, false) && !goes(2.6, 0, demanded, true));
        }
    }

    #[test]
    fn what_is_large_never_goes_by_a_demand() {
        for area in [1_000.0, 1e9, f32::INFINITY] {
            let most = STANDARD.stays_up_to_px2(area, u32::MAX, false);
            assert_eq!(most, Some(f32::INFINITY));
            // Not even where next to nothing of it shows.
            assert_eq!(STANDARD.least_px2(area, u32::MAX, f32::MAX, false), 2.0);
        }
        assert!(goes(999.0, u32::MAX, 1e6, false));
        assert!(goes(1_249.0, u32::MAX, 1e6, true) && !goes(1_250.0, u32::MAX, 1e6, true));
    }

    #[test]
    fn of_two_as_large_the_dearer_goes_first() {
        let of = |triangles| STANDARD.stays_up_to_px2(20.0, triangles, false);
        assert_eq!(of(0), Some(20.0));
        assert_eq!(of(192), Some(10.0));
        assert!(of(12) > of(700));
    }
}
