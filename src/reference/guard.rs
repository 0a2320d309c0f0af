//! How far the `f32` ray casting of the GPU may be from the `f64` one: a bound from its operation count.
//!
//! # Arithmetic
//! u = 2⁻²⁴ is half the distance from 1 to the next `f32`. WGSL calls sums, products and conversions
//! "correctly rounded" but leaves the direction open, so each may be off by 2u of its result; a quotient by
//! 2.5 ulp = 5u; a square root is `1 / inverseSqrt`, 2 ulp + 2.5 ulp = 9u. Fused and reassociated forms are
//! allowed only where they are at least as accurate. Whole numbers below 2²⁴ (cells, pixels, differences of
//! 16-bit codes) are exact.
//!
//! # Where the ray is
//! With O = |o| + |qₓ o_dx| + |q_y o_dy| and D likewise of the direction, all per axis (`rays.wgsl`, `ray_at`,
//! `above_cell`):
//!
//! | step | error |
//! |---|---|
//! | origin: two products, two sums | 6u O |
//! | direction: the same | 6u D |
//! | t·d: one product | (6 + 2)u tD |
//! | o + t·d: one sum | 8u O + 10u tD |
//! | minus the whole number of the cell | 2u of at most 1 |
//! | the border's t, which decides the cell and where it is entered: difference, quotient, product | 9u tD |
//! | t_in + s: one sum | 2u tD |
//!
//! That is 8u O + 21u tD + 2u; rounded up to a power of two for all, **ε(t) = 32u (O + tD + 1)**. Directions
//! below 10⁻¹⁵ count as standing still, which adds 10⁻¹⁵ t.
//!
//! # How high it is above the surface
//! The cell's polynomial c + b s + a s² is that of a patch with corners P = max |∂h/∂x|, Q = max |∂h/∂z|,
//! R = |r| ≤ 2P and H = max |h − anchor|. Its roundings, relative to the magnitudes of their terms: of c at most
//! 20u (height of the ray 10u, corners 2u, products and sums 8u), of b 18u (direction 6u, r 4u, products and sums
//! 8u), of a 20u. The root is the exact one of a polynomial whose c is off by 4u more (products of the
//! discriminant), then wrong by 18u of s itself (last rounding of the discriminant and square root 11u, sum 2u,
//! quotient 5u), that is by 18u s (|b| + 2 |a| s) of height. Together at most 24u of c, 36u of b, 56u of a;
//! rounded up to a power of two for all,
//!
//! **E(t) = 64u [O_y + tD_y + H + P + Q + R + s (D_y + P Dₓ + Q D_z + R (Dₓ + D_z)) + s² R Dₓ D_z]**
//!
//! with s no longer than t and than the crossing of a cell.
//!
//! The GPU may also use a cell up to ε beside the right one, continued past its border, or clamp the entry to
//! its own: twice ε along each axis, times the steepest slope near. The vertical **guard is**
//! **g(t) = E(t) + 2 (P εₓ(t) + Q ε_z(t))**, with P, Q, H taken over the 3×3 cells around, as long as ε < ½.
//! It is a polynomial of s, so that raising or lowering the surface by it keeps the problem a quadratic one.

use bevy::math::{DVec3, Vec2};

use super::cell::Quadratic;
use crate::{precision::UNIT_ROUNDOFF, terrain::view_rays::ViewRays};

/// Relative error of a position: the count above, rounded up to a power of two.
pub const POSITION_ERROR: f64 = 32.0 * UNIT_ROUNDOFF;

/// Relative error of a height above a cell's surface: the same of E.
pub const EVALUATION_ERROR: f64 = 64.0 * UNIT_ROUNDOFF;

/// Directions below this count as standing still in `rays.wgsl`.
const STILL: f64 = 1e-15;

/// Magnitudes of the terms that make one pixel's ray.
#[derive(Clone, Copy, Debug)]
pub struct RayMagnitude {
    /// O, per axis. units: grid
    pub origin: DVec3,
    /// D, per axis. units: grid per metre of view depth
    pub direction: DVec3,
    /// Longest that a cell's crossing takes; may be infinite. units: m
    pub crossing: f64,
}

/// Slopes and heights near a cell that errors are multiplied by.
#[derive(Clone, Copy, Debug, Default)]
pub struct Steepness {
    /// P: largest |∂h/∂x|.
    pub x: f64,
    /// Q: largest |∂h/∂z|.
    pub z: f64,
    /// H: largest height, relative to the anchor.
    pub height: f64,
}

impl RayMagnitude {
    /// Of the ray through `pixel` (from the viewport's top left corner).
    pub fn new(rays: &ViewRays, pixel: Vec2) -> Self {
        let q = (pixel - 0.5 * rays.size_px.as_vec2()).as_dvec2().abs();
        let size = |v: bevy::math::Vec3, dx: bevy::math::Vec3, dy: bevy::math::Vec3| {
            v.as_dvec3().abs() + q.x * dx.as_dvec3().abs() + q.y * dy.as_dvec3().abs()
        };
        let (_, d) = rays.ray(pixel);
        Self {
            origin: size(rays.origin, rays.origin_dx, rays.origin_dy),
            direction: size(rays.direction, rays.direction_dx, rays.direction_dy),
            crossing: 1.0 / d.x.abs().max(d.z.abs()),
        }
    }

    /// ε(t) = `(.0)[axis] + (.1)[axis] t`.
    pub fn position_error(&self) -> (DVec3, DVec3) {
        (
            POSITION_ERROR * (self.origin + DVec3::ONE),
            POSITION_ERROR * self.direction + DVec3::splat(STILL),
        )
    }

    /// g at t + s as a polynomial of s, over at most `span`.
    pub fn guard(&self, near: &Steepness, t: f64, span: f64) -> Quadratic {
        let Steepness { x: p, z: q, height } = *near;
        let (fixed, growing) = self.position_error();
        let d = self.direction;
        let r = 2.0 * p;
        let twist = p * d.x + q * d.z + r * (d.x + d.z);
        let slope = EVALUATION_ERROR * (d.y + twist);
        let curve = EVALUATION_ERROR * r * d.x * d.z;
        let at = fixed + growing * t;
        let base = Quadratic {
            c: EVALUATION_ERROR * (self.origin.y + t * d.y + height + p + q + r)
                + 2.0 * (p * at.x + q * at.z),
            b: EVALUATION_ERROR * d.y + 2.0 * (p * growing.x + q * growing.z),
            a: 0.0,
        };
        // How long since the GPU's cell began: no longer than a crossing, nor than since t = 0.
        let inside = if self.crossing < t + span {
            let s = self.crossing;
            Quadratic {
                c: s * (slope + s * curve),
                b: 0.0,
                a: 0.0,
            }
        } else {
            Quadratic {
                c: slope * t + curve * t * t,
                b: slope + 2.0 * curve * t,
                a: curve,
            }
        };
        base.plus(1.0, inside)
    }
}

/// How far a depth read back may be from the t it was made of, and whether that t is surely told from the sky.
///
/// NDC depth is (x + y t) / (z + w t): a product and a sum each, 4u of their terms, and a quotient, 5u;
/// all taken as 8u.
pub fn depth_error(rays: &ViewRays, t: f64) -> (f64, bool) {
    let [x, y, z, w] = rays.depth.as_dvec4().to_array();
    let (above, below) = (x + y * t, z + w * t);
    let ndc = above / below;
    let error = 8.0
        * UNIT_ROUNDOFF
        * ((x.abs() + (y * t).abs()) / below.abs()
            + ndc.abs() * (z.abs() + (w * t).abs()) / below.abs()
            + ndc.abs());
    let change = ((y * below - w * above) / (below * below)).abs();
    (error / change, ndc > error)
}
