//! Boxes in clip space, and how far rounding may put them from where they are drawn. What tests of occlusion and
//! measures of area share; the WGSL files that use it do the same, operation by operation.
//!
//! Clip space is reverse-Z: z = w on the near plane, z = 0 infinitely far away.
//!
//! # How far clip coordinates may be off
//! u = 2⁻²⁴; see [`occlusion::verdict`](crate::occlusion::verdict), which counts the roundings one by one. A
//! coordinate is off by at most **slack = 64u Q + 10⁻¹⁸**, Q = |C|·|M|·(|p|, 1) being the sum of the magnitudes of all
//! terms, with C `clip_from_world`, M `world_from_local` and |p| the largest local coordinates that occur. Of the 64u,
//! 46u are what a box takes; the other 18u are for what is calculated from its corners.

use bevy::{
    math::{Affine3A, Vec3A},
    prelude::*,
};

use super::volume::LocalBox;

/// Error of a clip coordinate relative to the magnitudes it is the sum of: 64u.
pub const CLIP_ERROR: f32 = 1.0 / (1 << 18) as f32;
/// What is smaller may have been lost to underflow.
pub const CLIP_TINY: f32 = 1e-18;
/// Magnitudes of clip coordinates from here on are not calculated with.
pub const CLIP_HUGE: f32 = 1e18;
/// Error of a pixel coordinate relative to the viewport's side: 32u.
pub const PIXEL_ERROR: f32 = 1.0 / (1 << 19) as f32;

/// Clip space from world space, prepared for many boxes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipView {
    columns: [Vec4; 4],
    magnitudes: [Vec4; 4],
}

/// C·M, and the sums of magnitudes that its elements are made of.
#[derive(Clone, Copy, Debug)]
pub struct ClipFrame {
    /// Columns of C·M.
    pub columns: [Vec4; 4],
    magnitudes: [Vec4; 4],
}

/// `columns` times (`v`, 0).
#[inline]
pub fn way(columns: &[Vec4; 4], v: Vec3A) -> Vec4 {
    columns[0] * v.x + columns[1] * v.y + columns[2] * v.z
}

/// `columns` times (`v`, 1).
#[inline]
pub fn point(columns: &[Vec4; 4], v: Vec3A) -> Vec4 {
    columns[0] * v.x + columns[1] * v.y + columns[2] * v.z + columns[3]
}

/// Whether all are finite, not negative and below [`CLIP_HUGE`]. By their bits, as on the GPU.
#[inline]
pub fn is_calculable(magnitudes: Vec4) -> bool {
    let huge = CLIP_HUGE.to_bits();
    let [x, y, z, w] = magnitudes.to_array().map(f32::to_bits);
    x < huge && y < huge && z < huge && w < huge
}

impl ClipView {
    /// Of a camera.
    pub fn new(clip_from_world: Mat4) -> Self {
        let Mat4 {
            x_axis,
            y_axis,
            z_axis,
            w_axis,
        } = clip_from_world;
        let columns = [x_axis, y_axis, z_axis, w_axis];
        Self {
            columns,
            magnitudes: columns.map(Vec4::abs),
        }
    }

    /// Clip space from an object's local space.
    #[inline]
    pub fn frame(&self, world_from_local: &Affine3A) -> ClipFrame {
        let linear = &world_from_local.matrix3;
        let translation = world_from_local.translation;
        ClipFrame {
            columns: [
                way(&self.columns, linear.x_axis),
                way(&self.columns, linear.y_axis),
                way(&self.columns, linear.z_axis),
                point(&self.columns, translation),
            ],
            magnitudes: [
                way(&self.magnitudes, linear.x_axis.abs()),
                way(&self.magnitudes, linear.y_axis.abs()),
                way(&self.magnitudes, linear.z_axis.abs()),
                point(&self.magnitudes, translation.abs()),
            ],
        }
    }
}

impl ClipFrame {
    /// How far off clip coordinates of points may be whose local coordinates are at most `magnitude`; `None` if they
    /// cannot be calculated with.
    #[inline]
    pub fn slack(&self, magnitude: Vec3A) -> Option<Vec4> {
        let q = point(&self.magnitudes, magnitude);
        is_calculable(q).then(|| q * CLIP_ERROR + Vec4::splat(CLIP_TINY))
    }

    /// A box's corners and how far they may be off; `None` if they cannot be calculated with. Bit k of a corner's
    /// index is set where it lies on the positive side of axis 2 − k.
    #[inline]
    pub fn corners(&self, volume: &LocalBox) -> Option<([Vec4; 8], Vec4)> {
        let centre = Vec3A::from(volume.centre);
        let axes = volume.axes.map(Vec3A::from);
        let slack = self.slack(centre.abs() + axes[0].abs() + axes[1].abs() + axes[2].abs())?;
        let centre = point(&self.columns, centre);
        let [a, b, c] = axes.map(|axis| way(&self.columns, axis));
        let (low, high) = (centre - a, centre + a);
        let (low_low, low_high, high_low, high_high) = (low - b, low + b, high - b, high + b);
        let corners = [
            low_low - c,
            low_low + c,
            low_high - c,
            low_high + c,
            high_low - c,
            high_low + c,
            high_high - c,
            high_high + c,
        ];
        Some((corners, slack))
    }
}

/// Bounds of some points' quotients x/w, y/w, z/w, and their smallest w.
#[derive(Clone, Copy, Debug)]
pub struct Quotients {
    /// The least of each.
    pub lo: Vec4,
    /// The largest of each.
    pub hi: Vec4,
    /// The smallest w.
    pub w_min: f32,
}

impl Quotients {
    /// Of no points.
    pub const NONE: Self = Self {
        lo: Vec4::MAX,
        hi: Vec4::MIN,
        w_min: f32::MAX,
    };

    /// Points with w ≤ 0 make `lo` and `hi` meaningless, though not infinite; `w_min` tells.
    #[inline]
    pub fn of(points: &[Vec4]) -> Self {
        let mut all = Self::NONE;
        for &point in points {
            all.add(point);
        }
        all
    }

    /// Takes in another.
    #[inline]
    pub fn add(&mut self, point: Vec4) {
        let q = point * (1.0 / point.w.max(CLIP_TINY));
        self.lo = self.lo.min(q);
        self.hi = self.hi.max(q);
        self.w_min = self.w_min.min(point.w);
    }

    /// The same bounds, of points each of which may be off by the slack; `None` where a w might then be almost
    /// nothing.
    #[inline]
    pub fn grown(&self, slack: Vec4) -> Option<(Vec4, Vec4)> {
        if self.w_min <= 2.0 * slack.w {
            return None;
        }
        let per_w = 1.0 / (self.w_min - slack.w);
        let grow = (self.lo.abs().max(self.hi.abs()) * slack.w + slack) * per_w;
        Some((self.lo - grow, self.hi + grow))
    }
}
