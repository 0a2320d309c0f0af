//! The twin of `upscale.wgsl`: Catmull-Rom, held between the smallest and the largest of the four nearest pixels.
//!
//! Keys 1981, *Cubic convolution interpolation for digital image processing*, eq. 8 with a = −1/2.

use bevy::math::{DVec4, UVec2};

/// Pixels of linear light, row by row from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearPicture {
    /// units: px
    pub size: UVec2,
    /// `size.x * size.y` pixels: red, green, blue, alpha.
    pub pixels: Vec<DVec4>,
}

impl LinearPicture {
    /// The pixel at (x, y), the nearest one beyond the border.
    fn at(&self, x: i64, y: i64) -> DVec4 {
        let [x, y] = [(x, self.size.x), (y, self.size.y)]
            .map(|(i, n)| i.clamp(0, i64::from(n) - 1) as usize);
        self.pixels[y * self.size.x as usize + x]
    }
}

/// Keys' kernel at a distance in pixels.
fn kernel(distance: f64) -> f64 {
    let d = distance.abs();
    if d < 1.0 {
        (1.5 * d - 2.5) * d * d + 1.0
    } else if d < 2.0 {
        ((-0.5 * d + 2.5) * d - 4.0) * d + 2.0
    } else {
        0.0
    }
}

/// Stretches a picture to another size. An empty picture becomes black.
pub fn stretch(picture: &LinearPicture, size: UVec2) -> LinearPicture {
    gather(picture, size, |pixel, taps| {
        let sum: DVec4 = taps.iter().map(|(weight, value)| *weight * *value).sum();
        let (low, high) = pixel.iter().fold(
            (DVec4::INFINITY, DVec4::NEG_INFINITY),
            |(low, high), value| (low.min(*value), high.max(*value)),
        );
        sum.clamp(low, high)
    })
}

/// How far [`stretch`] can be off where each pixel of the picture is off by at most `error`: the weighted sum by the
/// weights' magnitudes, and the bounds it is held between by the largest of the four errors.
pub fn stretch_error(error: &LinearPicture, size: UVec2) -> LinearPicture {
    gather(error, size, |pixel, taps| {
        let sum: DVec4 = taps
            .iter()
            .map(|(weight, value)| weight.abs() * *value)
            .sum();
        pixel.iter().fold(sum, |most, value| most.max(*value))
    })
}

/// Asks `combine` for every pixel of the stretched picture: the four nearest pixels, then the 16 with their weights.
fn gather(
    picture: &LinearPicture,
    size: UVec2,
    combine: impl Fn(&[DVec4; 4], &[(f64, DVec4); 16]) -> DVec4,
) -> LinearPicture {
    if picture.pixels.is_empty() {
        let count = size.x as usize * size.y as usize;
        let pixels = vec![DVec4::ZERO; count];
        return LinearPicture { size, pixels };
    }
    let ratio = picture.size.as_dvec2() / size.as_dvec2();
    let pixel = |x: u32, y: u32| {
        let at_x = (f64::from(x) + 0.5) * ratio.x - 0.5;
        let at_y = (f64::from(y) + 0.5) * ratio.y - 0.5;
        let (left, above) = (at_x.floor() as i64, at_y.floor() as i64);
        let nearest =
            [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| picture.at(left + i, above + j));
        let taps = core::array::from_fn(|tap| {
            let (column, row) = (left - 1 + tap as i64 % 4, above - 1 + tap as i64 / 4);
            let weight = kernel(at_x - column as f64) * kernel(at_y - row as f64);
            (weight, picture.at(column, row))
        });
        combine(&nearest, &taps)
    };
    LinearPicture {
        size,
        pixels: (0..size.y)
            .flat_map(|y| (0..size.x).map(move |x| (x, y)))
            .map(|(x, y)| pixel(x, y))
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(size: UVec2, colour: impl Fn(f64, f64) -> f64) -> LinearPicture {
        let pixels = (0..size.y)
            .flat_map(|y| (0..size.x).map(move |x| (x, y)))
            .map(|(x, y)| DVec4::splat(colour(f64::from(x) + 0.5, f64::from(y) + 0.5)))
            .collect();
        LinearPicture { size, pixels }
    }

    #[test]
    fn a_slope_stays_the_same_slope_away_from_the_border() {
        let (small, large) = (UVec2::new(20, 12), UVec2::new(53, 30));
        let slope = |x: f64, y: f64| 0.3 * x - 0.7 * y;
        let stretched = stretch(&picture(small, slope), large);
        let ratio = small.as_dvec2() / large.as_dvec2();
        let mut compared = 0;
        for y in 0..large.y {
            for x in 0..large.x {
                let at = (UVec2::new(x, y).as_dvec2() + 0.5) * ratio;
                if at.min_element() > 2.0 && (small.as_dvec2() - at).min_element() > 2.0 {
                    let got = stretched.at(i64::from(x), i64::from(y)).x;
                    assert!((got - slope(at.x, at.y)).abs() < 1e-12, "{x} {y}");
                    compared += 1;
                }
            }
        }
        assert!(compared > 500);
    }

    #[test]
    fn nothing_leaves_the_range_of_its_neighbours() {
        let step = picture(UVec2::new(8, 8), |x, _| if x < 4.0 { 0.0 } else { 1e4 });
        for pixel in stretch(&step, UVec2::new(31, 31)).pixels {
            assert!((0.0..=1e4).contains(&pixel.x));
        }
    }

    #[test]
    fn the_same_size_is_the_same_picture() {
        let size = UVec2::new(9, 7);
        let any = picture(size, |x, y| (x * 12.9 + y * 78.2).sin());
        assert_eq!(stretch(&any, size), any);
    }

    #[test]
    fn errors_stay_within_their_bound() {
        let (small, large) = (UVec2::new(9, 7), UVec2::new(22, 19));
        let any = picture(small, |x, y| (x * 12.9 + y * 78.2).sin());
        let error = picture(small, |x, y| 0.01 * (1.0 + (x * 3.3 - y).cos().abs()));
        let mut off = any.clone();
        for (i, (pixel, error)) in off.pixels.iter_mut().zip(&error.pixels).enumerate() {
            *pixel += *error * if i % 3 == 0 { 1.0 } else { -1.0 };
        }
        let bound = stretch_error(&error, large);
        for ((a, b), bound) in (stretch(&any, large).pixels.iter())
            .zip(&stretch(&off, large).pixels)
            .zip(&bound.pixels)
        {
            assert!((*a - *b).abs().cmple(*bound + 1e-12).all());
        }
    }
}
