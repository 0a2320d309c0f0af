//! The power by which cost grows: a straight line through logarithms.

/// `cost ≈ factor · size^exponent`.
#[derive(serde::Serialize, Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// 0 is constant, 1 linear.
    pub exponent: f64,
    /// Root of the mean squared distance of logarithms to base 2: 1 is a factor of 2.
    pub misfit: f64,
}

impl Fit {
    /// The least-squares line through the logarithms of sizes and costs; none of fewer than two sizes. Points with
    /// a size or cost that is not positive count for nothing.
    pub fn of(points: &[(f64, f64)]) -> Option<Self> {
        let logs: Vec<(f64, f64)> = points
            .iter()
            .filter(|(size, cost)| *size > 0.0 && *cost > 0.0)
            .map(|(size, cost)| (size.log2(), cost.log2()))
            .collect();
        let count = logs.len() as f64;
        let mean = |value: fn(&(f64, f64)) -> f64| logs.iter().map(value).sum::<f64>() / count;
        let (x, y) = (mean(|log| log.0), mean(|log| log.1));
        let spread: f64 = logs.iter().map(|log| (log.0 - x).powi(2)).sum();
        if logs.len() < 2 || spread <= 0.0 {
            return None;
        }
        let together: f64 = logs.iter().map(|log| (log.0 - x) * (log.1 - y)).sum();
        let exponent = together / spread;
        let off = |log: &(f64, f64)| (log.1 - y - exponent * (log.0 - x)).powi(2);
        Some(Self {
            exponent,
            misfit: (logs.iter().map(off).sum::<f64>() / count).sqrt(),
        })
    }

    /// The same of the larger half of the sizes, where what is constant weighs least.
    pub fn of_larger(points: &[(f64, f64)]) -> Option<Self> {
        Self::of(&points[points.len() / 2..])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_are_found_and_constants_fade() {
        let sizes = || (0..7).map(|i| f64::from(1 << i));
        let square: Vec<_> = sizes().map(|size| (size, 3.0 * size * size)).collect();
        let fit = Fit::of(&square).expect("a fit");
        assert!((fit.exponent - 2.0).abs() < 1e-12 && fit.misfit < 1e-12);
        let with_base: Vec<_> = sizes().map(|size| (size, 8.0 + size)).collect();
        let (all, larger) = (Fit::of(&with_base), Fit::of_larger(&with_base));
        let of = |fit: Option<Fit>| fit.expect("a fit").exponent;
        assert!(of(all) < of(larger) && of(larger) < 1.0);
    }

    #[test]
    fn one_size_has_no_power() {
        assert_eq!(Fit::of(&[(4.0, 1.0), (4.0, 2.0)]), None);
        assert_eq!(Fit::of(&[(4.0, 1.0), (8.0, 0.0)]), None);
        assert_eq!(Fit::of(&[]), None);
    }
}
