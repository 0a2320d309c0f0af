//! How far an `f32` shadow ray may be from the `f64` one: a bound from its operation count.
//!
//! # Arithmetic
//! As in [`guard`](crate::reference::guard), u = 2⁻²⁴: sums, products and conversions within 2u of their result,
//! quotients 5u, whole numbers below 2²⁴ exact, and what the CPU rounds from `f64` u. A ray counts from its own
//! sample: nothing is added to where that is, so every error grows from zero. d is the direction, |d| = 1 along
//! the faster axis, |d|·t = |t dₓ|, |t d_y| or |t d_z|.
//!
//! # Where the ray is
//! A **directional light's** d and 1/d come rounded. A **point light's** D = (hi − sample) + lo is off by 4u |D|
//! (two sums) and by 4u² |position|, which hi + lo don't reach; then d = D / m and 1/d = m / D, a quotient each.
//! The error of m itself only counts t differently. So the GPU's ray is the exact one of a *line* a little beside,
//! and its steps are off that line:
//!
//! | | directional | point |
//! |---|---|---|
//! | the line, of \|d\|·t | 0 | 4u, and 4u² \|position\| t / m |
//! | d, of itself | 1u | 5u |
//! | a border's t: whole number times 1/d | 3u | 7u |
//! | entry: product, less the whole number of the cell | 1 + 2 + 2 = 5u | 5 + 2 + 2 = 9u |
//! | the same, clamped to a cell that it is out of by the border's error | 8u | 16u |
//! | the ray is out of the GPU's cell by: border's t, and t_in + s | 5u | 9u |
//! | where the ray ends at the footprint or at the light: border's t | 3u | 7u |
//!
//! A cell's patch continued beside it leaves the surface at no more than twice the steepest slope nearby. Sideways
//! errors so lift or lower the surface by (P|dₓ| + Q|d_z|) t times 8 + d 1 (over s) + 2·5 + 3 = 22u, or
//! 4 + 16 + 5 + 2·9 + 7 = 50u, where d's 5u is in the entry's already: 45u.
//!
//! # How high it is above the surface
//! P = max |∂h/∂x|, Q = max |∂h/∂z|, H = max |h − h_sample| and |r| ≤ R = 2P of the 3×3 cells around, roundings
//! relative to the terms' magnitudes:
//!
//! | term | c | s b | s² a | sign test: of c 4u, s b 6u, s² a 8u | time: end of the ray, t_in + s | together |
//! |---|---|---|---|---|---|---|
//! | t d_y, directional | d 1, product 2, sums 4 | sums 6 | | 4, 6 | 3 + 2 | 14u of t, 15u of s |
//! | t d_y, point | line 4, d 5, product 2, sums 4 | sums 6 | | 4, 6 | 7 + 2 | 26u of t, 21u of s |
//! | corner | corner 2, sums 4 | | | 4 | | 10u H |
//! | p, q | difference 2, product 2, sums 6 | the same 10 | | 4, 6 | 2 of s | 14u (P + Q), 18u s (P\|dₓ\| + Q\|d_z\|) |
//! | r | differences 2 + 2, products 4, sums 4 | 4 + 2 + 2 + 2 + 2 = 12 | 4 + 4 | 4, 6, 8 | | 16u R, 18u s R (\|dₓ\| + \|d_z\|), 16u s² R \|dₓ d_z\| |
//!
//! (c < 0 is exact; c + s(b + s a) has the sums and products of the sign test; b² > 4ac is the same question of a
//! c off by 4u; −b < 2as of an s off by 2u, where the curve is level.) One weight covers all of it:
//!
//! **g(t) = W [t (|d_y| + P|dₓ| + Q|d_z|) + H + P + Q + R
//! + s (|d_y| + P|dₓ| + Q|d_z| + R (|dₓ| + |d_z|)) + s² R |dₓ d_z|]**, **W = 24u for directional, 48u for point lights.**
//!
//! s, the time in the GPU's cell, is at most 1: a cell is crossed along the faster axis by then. Point lights'
//! 4u² |position| / m is had by |d| + u |position| / m for |d|; components below 10⁻¹⁵ that stand still, by
//! 10⁻¹⁵ / W more.
//!
//! **In the first cell**, t = s < 1, nothing is constant: the sample is its corner, c = 0 exactly, and the other
//! corners' roundings, 2u P and 2u Q, come in by s. There g is W [s (2 (|d_y| + P|dₓ| + Q|d_z|) + R (|dₓ| + |d_z|))
//! + s² R |dₓ d_z|]: of P|dₓ| and Q|d_z| that is 2W for 18 + 2 + 22 = 42u or 18 + 2 + 45 = 65u. Which cell is first is known but for the border's t, which is in g as a sideways error.
//!
//! # Skipping
//! What the GPU passes by unasked it has seen to be clear of the highest corner by 32u (y_mag + |t d_y|). The ray's
//! height there is off by 18u |t d_y| at most (line 4, d 5, product 2, border's t 7), and the corner by 2u y_mag,
//! so it *is* clear, but for a cell's error sideways, which g has.

use bevy::math::{DVec2, DVec3};

use crate::{
    precision::UNIT_ROUNDOFF,
    reference::{cell::Quadratic, guard::Steepness},
    terrain_shadow::light::{GridLight, LightRay, LightSource, STILL},
};

/// W of a directional light, in roundings.
const DIRECTIONAL: f64 = 24.0;

/// W of a point light, and of `f64` itself.
const POINT: f64 = 48.0;

/// How far one ray's rounded positions and heights may be off.
#[derive(Clone, Copy, Debug)]
pub struct ShadowGuard {
    /// W.
    weight: f64,
    /// Magnitudes of what makes the direction. units: grid per unit of t
    size: DVec3,
}

impl ShadowGuard {
    /// Of `f64` itself: so that a ray along a plane isn't in its shadow because of the last bit.
    pub fn of_f64(ray: &LightRay) -> Self {
        Self {
            weight: POINT * 0.5 * f64::EPSILON,
            size: ray.direction.abs(),
        }
    }

    /// Of the GPU's ray. `from` is the sample's place.
    pub fn of_f32(light: &GridLight, from: DVec3, ray: &LightRay) -> Self {
        let mut size = ray.direction.abs();
        let weight = match light.source {
            LightSource::Directional(_) => DIRECTIONAL * UNIT_ROUNDOFF,
            LightSource::Point(position) => {
                let weight = POINT * UNIT_ROUNDOFF;
                let way = light.to_light(from);
                for axis in 0..3 {
                    // A light exactly above the sample's column or row, or level with it: so it is in f32.
                    if way[axis] == 0.0 {
                        continue;
                    }
                    if axis != 1 && size[axis] < 2.0 * STILL {
                        size[axis] += 2.0 * STILL / weight;
                    }
                    size[axis] += UNIT_ROUNDOFF * position[axis].abs() / ray.t_end;
                }
                weight
            }
        };
        Self { weight, size }
    }

    /// How far the ray may be beside its place at t, per unit of t, along x and z.
    pub fn sideways(&self) -> DVec2 {
        0.5 * self.weight * DVec2::new(self.size.x, self.size.z)
    }

    /// g at t + s as a polynomial of s; the first cell's is that at t = 0.
    pub fn over_cell(&self, near: &Steepness, t: f64) -> Quadratic {
        let Steepness { x: p, z: q, height } = *near;
        let [dx, dy, dz] = self.size.to_array();
        let r = 2.0 * p;
        let slope = dy + p * dx + q * dz;
        let (twist, curve) = (r * (dx + dz), r * dx * dz);
        let guard = if t == 0.0 {
            Quadratic {
                c: 0.0,
                b: 2.0 * slope + twist,
                a: curve,
            }
        } else {
            Quadratic {
                c: t * slope + height + p + q + r + slope + twist + curve,
                b: slope,
                a: 0.0,
            }
        };
        Quadratic::default().plus(self.weight, guard)
    }

    /// g at t or before, wherever the ground is no steeper or higher than `near`, as a polynomial of t.
    pub fn anywhere(&self, near: &Steepness) -> Quadratic {
        // The first cell's is no more: twice the slope times t ≤ 1, where this has (t + 1) times.
        self.over_cell(near, 1.0).from(-1.0)
    }
}
