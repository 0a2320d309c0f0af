//! In which order objects go when a [`FrameBudget`](crate::budget::FrameBudget) demands that some do.
//!
//! P4 leaves out what covers least. Where time is what is short, an object with many triangles has to be worth more of
//! the picture than one with few: for the same time, several of the latter stay. So the budget compares an object's
//! area divided by the root of what its triangles weigh. What it is divided by lies midway, by ratio, between nothing
//! (P4's order, right where every object costs the same) and the triangles themselves (right where nothing else
//! costs): which of them a machine is nearer to need not be known, and the order does not change while that is learned.
//! The threshold that users set on [`ContributionCulling`](super::ContributionCulling) is of the area alone, as in P4.

/// So many triangles weigh as much as being an object does.
const AN_OBJECT: f32 = 64.0;

/// Share of the picture from which on nothing goes, however much it costs: a quarter of each side.
pub const NEVER_GOES: f32 = 1.0 / 16.0;

fn weight(triangles: u32) -> f32 {
    (1.0 + triangles as f32 / AN_OBJECT).sqrt()
}

/// Below which area an object goes when so much is demanded; `never_px2` is the area from which on nothing does.
/// units: px²
pub fn goes_below_px2(demanded_px2: f32, triangles: u32, never_px2: f32) -> f32 {
    (demanded_px2 * weight(triangles)).min(never_px2)
}

/// Up to which demand an object stays: more, and it goes. Infinite for what never does. units: px²
pub fn stays_up_to_px2(area_px2: f32, triangles: u32, never_px2: f32) -> f32 {
    if area_px2 >= never_px2 {
        f32::INFINITY
    } else {
        area_px2 / weight(triangles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stays_up_to_a_demand_goes_above_it() {
        let never = 1_000.0;
        for triangles in [0, 1, 12, 736, 1_000_000, u32::MAX] {
            for area in [0.0, 0.01, 3.0, 64.0, 999.0] {
                let most = stays_up_to_px2(area, triangles, never);
                // Two roundings there and two back.
                let (less, more) = (most * 0.999_999, most * 1.000_001);
                assert!(area >= goes_below_px2(less, triangles, never));
                assert!(area == 0.0 || area < goes_below_px2(more, triangles, never));
            }
        }
    }

    #[test]
    fn what_is_large_never_goes() {
        for area in [1_000.0, 1e9, f32::INFINITY] {
            assert_eq!(stays_up_to_px2(area, u32::MAX, 1_000.0), f32::INFINITY);
            assert!(area >= goes_below_px2(f32::MAX, u32::MAX, 1_000.0));
        }
    }

    #[test]
    fn of_two_as_large_the_dearer_goes_first() {
        let of = |triangles| stays_up_to_px2(20.0, triangles, 1_000.0);
        assert_eq!(of(0), 20.0);
        assert_eq!(of(192), 10.0);
        assert!(of(12) > of(700));
    }
}
