//! Which settings no other beats: Pareto fronts over time and errors.

use super::super::Timing;

/// A setting as it was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// What it took. units: ms
    pub ms: Timing,
    /// How far off it was, by each measure; less is better.
    pub errors: Vec<f64>,
}

/// Where a setting is among others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// None is better in something and worse in nothing.
    OnFront,
    /// One is, by time alone, and this one was as quick at times.
    Scatter {
        /// The quickest such.
        by: usize,
    },
    /// One is, beyond scatter.
    Behind {
        /// The quickest such.
        by: usize,
    },
}

impl Point {
    fn is_no_worse(&self, other: &Self) -> bool {
        let errors = self.errors.iter().zip(&other.errors);
        self.ms.median <= other.ms.median && errors.clone().all(|(a, b)| a <= b)
    }

    fn beats(&self, other: &Self) -> bool {
        self.is_no_worse(other) && !other.is_no_worse(self)
    }
}

/// Whether each is on the front: beaten by none in time and all errors together.
pub fn front(points: &[Point]) -> Vec<bool> {
    points
        .iter()
        .map(|point| !points.iter().any(|other| other.beats(point)))
        .collect()
}

/// Where the setting at an index is.
pub fn standing(points: &[Point], at: usize) -> Standing {
    let point = &points[at];
    let quickest = points
        .iter()
        .enumerate()
        .filter(|(_, other)| other.beats(point))
        .min_by(|(_, a), (_, b)| a.ms.median.total_cmp(&b.ms.median));
    let Some((by, other)) = quickest else {
        return Standing::OnFront;
    };
    // What is as quick and only less wrong cannot be put down to the clock.
    let is_same_error = other.errors == point.errors;
    let apart = other.ms.median < point.ms.min;
    if is_same_error && !apart {
        Standing::Scatter { by }
    } else {
        Standing::Behind { by }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(ms: [f64; 3], errors: &[f64]) -> Point {
        Point {
            ms: Timing::of(ms.to_vec()),
            errors: errors.to_vec(),
        }
    }

    #[test]
    fn a_front_is_what_nothing_beats() {
        let points = [
            point([10.0; 3], &[0.0, 5.0]),
            point([5.0; 3], &[1.0, 5.0]),
            // Slower than the one before, and no less wrong.
            point([6.0; 3], &[1.0, 5.0]),
            // Less wrong by another measure.
            point([7.0; 3], &[1.0, 4.0]),
        ];
        assert_eq!(front(&points), [true, true, false, true]);
        assert_eq!(standing(&points, 0), Standing::OnFront);
        assert_eq!(standing(&points, 2), Standing::Behind { by: 1 });
    }

    #[test]
    fn equals_are_both_on_the_front() {
        let points = [point([3.0; 3], &[1.0]), point([3.0; 3], &[1.0])];
        assert_eq!(front(&points), [true, true]);
    }

    #[test]
    fn what_the_clock_cannot_tell_apart_is_scatter_and_errors_never_are() {
        let same = [point([9.0, 10.0, 11.0], &[0.0]), point([9.5; 3], &[0.0])];
        assert_eq!(standing(&same, 0), Standing::Scatter { by: 1 });
        let apart = [point([9.0, 10.0, 11.0], &[0.0]), point([8.0; 3], &[0.0])];
        assert_eq!(standing(&apart, 0), Standing::Behind { by: 1 });
        let wrong = [point([9.0, 10.0, 11.0], &[1.0]), point([9.5; 3], &[0.0])];
        assert_eq!(standing(&wrong, 0), Standing::Behind { by: 1 });
    }
}
