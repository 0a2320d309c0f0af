//! What a frame costs by what was drawn in it: a clock that other work on the machine does not touch.

use core::{iter::Sum, str::FromStr};

use serde::Serialize;

/// What was drawn in a frame.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct Drawn {
    /// How many objects.
    pub objects: f64,
    /// Triangles of their meshes.
    pub triangles: f64,
    /// Areas of the smallest rectangles around the projections of their bounds, in the viewport. units: px²
    pub pixels: f64,
}

impl Sum for Drawn {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |a, b| Self {
            objects: a.objects + b.objects,
            triangles: a.triangles + b.triangles,
            pixels: a.pixels + b.pixels,
        })
    }
}

/// Time by what is drawn: `object_ms · objects + triangle_ms · triangles + pixel_ms · pixels + frame_ms`.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// Of each object. units: ms
    pub object_ms: f64,
    /// Of each triangle. units: ms
    pub triangle_ms: f64,
    /// Of each square pixel of [`Drawn::pixels`]. units: ms/px²
    pub pixel_ms: f64,
    /// Of a frame with nothing in it. units: ms
    pub frame_ms: f64,
}

/// Terms of a cost.
const TERMS: usize = 4;

impl Cost {
    /// Time that a frame with this in it is counted as. units: ms
    pub fn of(&self, drawn: Drawn) -> f64 {
        let terms = terms(drawn);
        let coefficients = self.coefficients();
        terms.iter().zip(coefficients).map(|(x, c)| x * c).sum()
    }

    fn coefficients(&self) -> [f64; TERMS] {
        [
            self.object_ms,
            self.triangle_ms,
            self.pixel_ms,
            self.frame_ms,
        ]
    }

    fn from_coefficients(of: [f64; TERMS]) -> Self {
        Self {
            object_ms: of[0],
            triangle_ms: of[1],
            pixel_ms: of[2],
            frame_ms: of[3],
        }
    }

    /// The cost, none of its coefficients negative, that comes nearest to what frames took, each by its share: least
    /// squares of `counted / measured − 1`. `None` without a frame that took a positive time.
    ///
    /// With four coefficients there are 15 ways to choose which are not zero; the best of those whose solution has
    /// none below zero is the constrained optimum.
    pub fn fit(frames: &[(Drawn, f64)]) -> Option<Self> {
        let rows: Vec<[f64; TERMS]> = frames
            .iter()
            .filter(|(_, ms)| *ms > 0.0 && ms.is_finite())
            .map(|(drawn, ms)| terms(*drawn).map(|x| x / ms))
            .collect();
        if rows.is_empty() {
            return None;
        }
        // Columns of one size, or the equations could not be solved in f64.
        let mut scales = [0.0f64; TERMS];
        for row in &rows {
            for (scale, x) in scales.iter_mut().zip(row) {
                *scale = scale.max(x.abs());
            }
        }
        let (mut gram, mut right) = ([[0.0; TERMS]; TERMS], [0.0; TERMS]);
        for row in &rows {
            for i in (0..TERMS).filter(|i| scales[*i] > 0.0) {
                right[i] += row[i] / scales[i];
                for j in (0..TERMS).filter(|j| scales[*j] > 0.0) {
                    gram[i][j] += row[i] / scales[i] * row[j] / scales[j];
                }
            }
        }
        (1u32..1 << TERMS)
            .filter_map(|some| {
                let free: Vec<usize> = (0..TERMS)
                    .filter(|i| some & (1 << i) != 0 && scales[*i] > 0.0)
                    .collect();
                let solution = solve(&gram, &right, &free)?;
                if solution.iter().any(|c| *c < 0.0) {
                    return None;
                }
                let mut coefficients = [0.0; TERMS];
                for (i, c) in free.iter().zip(solution) {
                    coefficients[*i] = c / scales[*i];
                }
                let error: f64 = rows
                    .iter()
                    .map(|row| {
                        let of: f64 = row.iter().zip(coefficients).map(|(x, c)| x * c).sum();
                        (of - 1.0).powi(2)
                    })
                    .sum();
                Some((error, coefficients))
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, coefficients)| Self::from_coefficients(coefficients))
    }

    /// Root of the mean square of `counted / measured − 1`.
    pub fn misfit(&self, frames: &[(Drawn, f64)]) -> f64 {
        let errors = frames
            .iter()
            .filter(|(_, ms)| *ms > 0.0)
            .map(|(drawn, ms)| (self.of(*drawn) / ms - 1.0).powi(2));
        let (sum, count) = errors.fold((0.0, 0u32), |(sum, count), e| (sum + e, count + 1));
        (sum / f64::from(count.max(1))).sqrt()
    }
}

impl FromStr for Cost {
    type Err = String;

    /// `a,b,c,d`: of an object, a triangle, a square pixel and a frame. units: ms
    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
        let parts: [f64; TERMS] = parts
            .ok()
            .and_then(|parts| parts.try_into().ok())
            .ok_or("expected 4 numbers with commas between them")?;
        if parts.iter().any(|part| !part.is_finite() || *part < 0.0) {
            return Err("the numbers must be finite and not negative".into());
        }
        if parts.iter().all(|part| *part == 0.0) {
            return Err("one of the numbers must be positive".into());
        }
        Ok(Self::from_coefficients(parts))
    }
}

fn terms(drawn: Drawn) -> [f64; TERMS] {
    [drawn.objects, drawn.triangles, drawn.pixels, 1.0]
}

/// Solves the rows and columns `free` of symmetric equations by elimination; `None` where they are singular.
fn solve(gram: &[[f64; TERMS]; TERMS], right: &[f64; TERMS], free: &[usize]) -> Option<Vec<f64>> {
    let n = free.len();
    if n == 0 {
        return None;
    }
    let mut rows: Vec<Vec<f64>> = free
        .iter()
        .map(|&i| {
            let left = free.iter().map(|&j| gram[i][j]);
            left.chain([right[i]]).collect()
        })
        .collect();
    let largest = free.iter().map(|&i| gram[i][i]).fold(0.0, f64::max);
    for step in 0..n {
        let best =
            (step..n).max_by(|a, b| rows[*a][step].abs().total_cmp(&rows[*b][step].abs()))?;
        rows.swap(step, best);
        // Below this a pivot is what rounding left of nothing: n³ roundings of numbers up to the largest.
        if rows[step][step].abs() <= 64.0 * f64::EPSILON * largest {
            return None;
        }
        let pivot = rows[step].clone();
        for row in &mut rows[step + 1..] {
            let times = row[step] / pivot[step];
            for (x, p) in row.iter_mut().zip(&pivot) {
                *x -= times * p;
            }
        }
    }
    let mut solution = vec![0.0; n];
    for step in (0..n).rev() {
        let known: f64 = (step + 1..n).map(|j| rows[step][j] * solution[j]).sum();
        solution[step] = (rows[step][n] - known) / rows[step][step];
    }
    Some(solution)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(cost: Cost, noise: f64) -> Vec<(Drawn, f64)> {
        (0..200u32)
            .map(|i| {
                let draw = |salt: u32| {
                    let hash = (i * 31 + salt * 7_919).wrapping_mul(0x9e37_79b1);
                    f64::from(hash >> 8) / f64::from(1u32 << 24)
                };
                let drawn = Drawn {
                    objects: 5_000.0 * draw(1),
                    triangles: 900_000.0 * draw(2),
                    pixels: 2_000_000.0 * draw(3),
                };
                (drawn, cost.of(drawn) * (1.0 + noise * (draw(4) - 0.5)))
            })
            .collect()
    }

    #[test]
    fn a_known_cost_is_found_again() {
        let cost = Cost {
            object_ms: 0.002,
            triangle_ms: 5e-5,
            pixel_ms: 1e-6,
            frame_ms: 3.0,
        };
        let fitted = Cost::fit(&frames(cost, 0.0)).expect("there are frames");
        for (a, b) in fitted.coefficients().iter().zip(cost.coefficients()) {
            assert!((a - b).abs() < 1e-6 * b, "{fitted:?}");
        }
        let noisy = frames(cost, 0.1);
        let fitted = Cost::fit(&noisy).expect("there are frames");
        assert!(fitted.misfit(&noisy) < 0.05, "{fitted:?}");
        assert!((fitted.triangle_ms / cost.triangle_ms - 1.0).abs() < 0.05);
    }

    #[test]
    fn nothing_is_ever_counted_negative() {
        // What an object seems to save is no saving.
        let wrong = Cost {
            object_ms: -0.001,
            triangle_ms: 5e-5,
            pixel_ms: 0.0,
            frame_ms: 10.0,
        };
        let frames = frames(wrong, 0.0);
        let fitted = Cost::fit(&frames).expect("there are frames");
        assert!(
            fitted.coefficients().iter().all(|c| *c >= 0.0),
            "{fitted:?}"
        );
        assert_eq!(fitted.object_ms, 0.0);
        assert!(fitted.triangle_ms > 3e-5, "{fitted:?}");
    }

    #[test]
    fn what_cannot_be_told_apart_or_is_not_there_does_no_harm() {
        assert_eq!(Cost::fit(&[]), None);
        let nothing = (Drawn::default(), 0.0);
        assert_eq!(Cost::fit(&[nothing, (Drawn::default(), f64::NAN)]), None);
        // Objects and triangles always in one proportion.
        let frames: Vec<_> = (1..50u32)
            .map(|i| {
                let n = f64::from(i);
                let drawn = Drawn {
                    objects: n,
                    triangles: 100.0 * n,
                    pixels: 0.0,
                };
                (drawn, 2.0 + 0.5 * n)
            })
            .collect();
        let fitted = Cost::fit(&frames).expect("there are frames");
        assert!(fitted.misfit(&frames) < 1e-9, "{fitted:?}");
    }

    #[test]
    fn costs_are_read_and_wrong_ones_named() {
        let cost: Cost = "0.5, 1e-3,0,2".parse().expect("it is a cost");
        assert_eq!(cost.coefficients(), [0.5, 1e-3, 0.0, 2.0]);
        for wrong in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "a,0,0,1",
            "-1,0,0,1",
            "nan,0,0,1",
            "0,0,0,0",
        ] {
            assert!(wrong.parse::<Cost>().is_err(), "{wrong}");
        }
    }
}
