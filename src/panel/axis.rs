//! One axis of a plot: where a value lies on it, and which values are written beside it.

/// Positive values that lie further apart than this are spread by their logarithms.
const WIDE: f64 = 30.0;
/// Share of a logarithmic axis that 0 has to itself.
const ZERO: f32 = 0.1;

/// From the least to the largest value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    least: f64,
    most: f64,
    scale: Scale,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Scale {
    Linear,
    /// 0, which has no logarithm, lies at the axis' beginning, apart from the rest, if it occurs.
    Log {
        zero: bool,
    },
}

impl Axis {
    /// An axis that holds all values; `None` if there are none. Values and their differences must be finite.
    pub fn over(values: impl Iterator<Item = f64> + Clone) -> Option<Self> {
        let least = values.clone().reduce(f64::min)?;
        let most = values.clone().reduce(f64::max)?;
        let positive = values.filter(|value| *value > 0.0).reduce(f64::min);
        if let Some(positive) = positive
            && least >= 0.0
            && most / positive > WIDE
        {
            return Some(Self {
                least: positive,
                most,
                scale: Scale::Log { zero: least == 0.0 },
            });
        }
        // Room for a single value, and a baseline where one is near.
        let least = if least > 0.0 && least < 0.5 * most {
            0.0
        } else {
            least
        };
        let room = if most > least {
            0.04 * (most - least)
        } else {
            0.5 * most.abs().max(1e-12)
        };
        Some(Self {
            least: if least == 0.0 { 0.0 } else { least - room },
            most: most + room,
            scale: Scale::Linear,
        })
    }

    /// Where a value lies. range: 0..=1, clamped
    pub fn place(&self, value: f64) -> f32 {
        let along = match self.scale {
            Scale::Linear => (value - self.least) / (self.most - self.least),
            Scale::Log { .. } if value <= 0.0 => return 0.0,
            Scale::Log { .. } => (value / self.least).ln() / (self.most / self.least).ln(),
        };
        let along = along.clamp(0.0, 1.0) as f32;
        match self.scale {
            Scale::Log { zero: true } => ZERO + (1.0 - ZERO) * along,
            _ => along,
        }
    }

    /// Values to write beside it, from the least: round ones, about `wanted` of them, and at least one.
    pub fn ticks(&self, wanted: usize) -> Vec<f64> {
        let wanted = wanted.max(1);
        let mut ticks = Vec::new();
        match self.scale {
            Scale::Linear => {
                let mut step = round_up((self.most - self.least) / wanted as f64);
                let ends = |step: f64| ((self.least / step).ceil(), (self.most / step).floor());
                // A short axis far from 0 may lie between two round numbers. Of the next smaller step at most two do.
                while ends(step).0 > ends(step).1 {
                    step = round_up(step / 2.5);
                }
                let (first, last) = ends(step);
                // Multiples, not sums: no tick is a hair beside its number.
                ticks.extend((0..=(last - first) as usize).map(|i| (first + i as f64) * step));
            }
            Scale::Log { zero } => {
                if zero {
                    ticks.push(0.0);
                }
                let (first, last) = (self.least.log10().ceil(), self.most.log10().floor());
                let decades = (last - first).max(0.0) as usize + 1;
                let every = decades.div_ceil(wanted);
                ticks.extend(
                    (0..decades)
                        .step_by(every)
                        .map(|i| 10_f64.powi(first as i32 + i as i32)),
                );
            }
        }
        ticks
    }
}

/// The next number up of 1, 2 and 5 times a power of ten.
pub fn round_up(value: f64) -> f64 {
    let power = 10_f64.powf(value.log10().floor());
    if !power.is_finite() || power <= 0.0 {
        return 1.0;
    }
    // A hair of tolerance, that 0.2 stays 0.2.
    let steps = [1.0, 2.0, 5.0, 10.0];
    let least = value / power * (1.0 - 1e-9);
    power
        * steps
            .into_iter()
            .find(|step| *step >= least)
            .unwrap_or(10.0)
}

/// Three significant digits.
pub fn number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let power = value.abs().log10().floor();
    if !(-4.0..6.0).contains(&power) {
        return format!("{value:.1e}");
    }
    let text = format!("{value:.*}", (2.0 - power).clamp(0.0, 9.0) as usize);
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn near_values_are_spread_evenly() {
        let axis = Axis::over([10.0, 20.0, 30.0].into_iter()).unwrap();
        // A baseline is near.
        assert_eq!(axis.place(0.0), 0.0);
        let gap = axis.place(20.0) - axis.place(10.0);
        assert!((axis.place(30.0) - axis.place(20.0) - gap).abs() < 1e-6);
        assert_eq!(axis.ticks(4), [0.0, 10.0, 20.0, 30.0]);
    }

    #[test]
    fn far_values_are_spread_by_their_logarithms_and_zero_stands_apart() {
        let axis = Axis::over([0.0, 0.01, 1.0, 100.0].into_iter()).unwrap();
        assert_eq!(axis.place(0.0), 0.0);
        assert!((axis.place(0.01) - ZERO).abs() < 1e-6);
        let gap = axis.place(1.0) - axis.place(0.01);
        assert!((axis.place(100.0) - axis.place(1.0) - gap).abs() < 1e-6);
        assert_eq!(axis.ticks(9), [0.0, 0.01, 0.1, 1.0, 10.0, 100.0]);
        assert_eq!(axis.ticks(3), [0.0, 0.01, 1.0, 100.0]);
    }

    #[test]
    fn a_single_value_has_room() {
        for value in [0.0, 3.0, -2.0, 1e-9] {
            let axis = Axis::over([value].into_iter()).unwrap();
            assert!((0.0..1.0).contains(&axis.place(value)), "{value}");
            assert!(!axis.ticks(3).is_empty(), "{value}");
        }
        assert_eq!(Axis::over([].into_iter()), None);
    }

    #[test]
    fn between_two_round_numbers_there_are_no_more_ticks_than_wanted() {
        let axis = Axis::over([238_970.8, 375_766.8].into_iter()).unwrap();
        assert_eq!(axis.ticks(1), [300_000.0]);
        let axis = Axis::over([5_300.0, 9_600.0].into_iter()).unwrap();
        assert_eq!(axis.ticks(1), [6_000.0, 8_000.0]);
    }

    #[test]
    fn numbers_are_short() {
        let cases = [
            (0.0, "0"),
            (16.666, "16.7"),
            (0.012_345, "0.0123"),
            (1234.5, "1234"),
            (2.50, "2.5"),
            (-3.0, "-3"),
            (3e-7, "3.0e-7"),
        ];
        for (value, text) in cases {
            assert_eq!(number(value), text);
        }
        assert_eq!([0.2, 0.21, 3.0, 7.0].map(round_up), [0.2, 0.5, 5.0, 10.0]);
    }

    proptest! {
        #[test]
        fn order_is_kept_and_ticks_are_on_the_axis(
            values in prop::collection::vec(prop_oneof![Just(0.0), 1e-6..1e6_f64, 100.0..105.0_f64], 1..20),
            wanted in 1_usize..8,
        ) {
            let axis = Axis::over(values.iter().copied()).unwrap();
            let mut sorted = values;
            sorted.sort_by(f64::total_cmp);
            let places: Vec<f32> = sorted.iter().map(|value| axis.place(*value)).collect();
            prop_assert!(places.is_sorted());
            prop_assert!(places.iter().all(|place| (0.0..=1.0).contains(place)));
            let ticks = axis.ticks(wanted);
            prop_assert!(!ticks.is_empty() && ticks.is_sorted());
            prop_assert!(ticks.len() <= wanted + 1, "{:?}", ticks);
            let on_axis = |tick: &f64| *tick == 0.0 || (axis.least..=axis.most).contains(tick);
            prop_assert!(ticks.iter().all(on_axis), "{:?} {:?}", axis, ticks);
        }
    }
}
