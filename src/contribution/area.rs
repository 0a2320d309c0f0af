//! How much of the picture a bound covers, at most.
//!
//! `contribution_area.wgsl` is the same, operation by operation;
//! [`reference::contribution`](crate::reference::contribution) is its `f64` twin.
//!
//! # The near plane
//! A corner is in front of it if d = w − z is not negative; so it is with reverse-Z, finite and infinite far planes
//! and orthographic cameras alike. What of a box is in front is the convex hull of its corners in front and of the
//! points where its twelve edges cross the plane, so these are projected and the others are not.
//!
//! # Why it is never too small
//! Corners are off by up to the slack e of `culling::clip`, d by e_z + e_w = 64u S, with
//! S = Q_z + Q_w. All is cut at a plane that lies **128u S** nearer to the eye:
//!
//! | what may put a point of the box in front of the plane behind the one it is cut at | |
//! |---|---|
//! | the corners at its edge's ends, drawn and here | 46u S |
//! | d, a difference and a sum, in the numerator and at both ends: 4u each | 12u S |
//! | the difference of the ends, up to 2S: 2u | 4u S |
//! | the quotient that says where on the edge the crossing is: 5u of 2S | 10u S |
//! | all | 72u S |
//!
//! A crossing is off by what corners are, and by its own difference, product and sum: 46u + 10u of Q, within the 64u of
//! the slack. Quotients are grown by the slack as in [`occlusion::verdict`](crate::occlusion::verdict), pixels by its
//! 32u of the viewport's side. Where a w may be almost nothing the quotients have no bound, and the whole viewport
//! counts as covered. The area itself is a difference and two products: **1 + 16u**.
//!
//! # Reference
//! P4, steps 3 and 4.

use bevy::{math::Affine3A, prelude::*};

use crate::culling::{
    clip::{ClipView, PIXEL_ERROR, Quotients},
    volume::LocalBox,
};

/// What areas are multiplied by: 1 + 16u.
pub const AREA_GUARD: f32 = 1.0 + 1.0 / (1 << 20) as f32;
/// How many times the slack of d the near plane is moved towards the eye.
pub const NEAR_GUARD: f32 = 2.0;
/// Viewports with a longer side are not calculated with. units: px
pub const MOST_SIDE_PX: f32 = 1e9;

/// A view that areas are measured in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AreaView {
    clip: ClipView,
    half_size: Vec2,
    margin: Vec2,
    viewport: Vec2,
    clip_from_world: Mat4,
    is_calculable: bool,
}

impl AreaView {
    /// Prepares a view for many measures.
    ///
    /// # Inputs
    /// `clip_from_world`: any projection to reverse-Z clip space. `viewport`: its size, units: px, range: 0..=10⁹; where
    /// it is outside that range every area is infinite.
    pub fn new(clip_from_world: Mat4, viewport: Vec2) -> Self {
        Self {
            clip: ClipView::new(clip_from_world),
            half_size: viewport * 0.5,
            margin: viewport * PIXEL_ERROR,
            viewport,
            clip_from_world,
            // By the bits, as on the GPU: those of what is negative or no number are larger.
            is_calculable: viewport
                .to_array()
                .iter()
                .all(|side| side.to_bits() <= MOST_SIDE_PX.to_bits()),
        }
    }

    /// Clip space from world space.
    pub fn clip_from_world(&self) -> Mat4 {
        self.clip_from_world
    }

    /// Size of the viewport. units: px
    pub fn viewport(&self) -> Vec2 {
        self.viewport
    }

    /// Area of the smallest rectangle around the projection of what of a box is in front of the near plane, clipped to
    /// the viewport; 0 where nothing is, infinite where it cannot be calculated with. Never below the exact one.
    /// units: px²
    #[inline]
    pub fn area_px2(&self, world_from_local: &Affine3A, volume: &LocalBox) -> f32 {
        let frame = self.clip.frame(world_from_local);
        let (true, Some((corners, slack))) = (self.is_calculable, frame.corners(volume)) else {
            return f32::INFINITY;
        };
        let guard = NEAR_GUARD * (slack.z + slack.w);
        let depth = |corner: Vec4| corner.w - corner.z + guard;
        let nearest = corners.iter().map(|c| depth(*c)).fold(f32::MAX, f32::min);
        let quotients = if nearest >= 0.0 {
            Quotients::of(&corners)
        } else {
            clipped(&corners, guard)
        };
        self.covered(&quotients, slack)
    }

    /// Of points that may be off by the slack.
    #[inline]
    fn covered(&self, quotients: &Quotients, slack: Vec4) -> f32 {
        // Of no points.
        if quotients.w_min == f32::MAX {
            return 0.0;
        }
        let Some((lo, hi)) = quotients.grown(slack) else {
            return self.viewport.x * self.viewport.y * AREA_GUARD;
        };
        let lo = lo.clamp(Vec4::splat(-2.0), Vec4::splat(2.0));
        let hi = hi.clamp(Vec4::splat(-2.0), Vec4::splat(2.0));
        let min = Vec2::new(1.0 + lo.x, 1.0 - hi.y) * self.half_size - self.margin;
        let max = Vec2::new(1.0 + hi.x, 1.0 - lo.y) * self.half_size + self.margin;
        let sides = max.clamp(Vec2::ZERO, self.viewport) - min.clamp(Vec2::ZERO, self.viewport);
        sides.x * sides.y * AREA_GUARD
    }
}

/// The corners in front of the near plane, moved by `guard` towards the eye, and the points where edges cross it.
#[cold]
fn clipped(corners: &[Vec4; 8], guard: f32) -> Quotients {
    let mut all = Quotients::NONE;
    for (i, &from) in corners.iter().enumerate() {
        let d = from.w - from.z + guard;
        if d >= 0.0 {
            all.add(from);
        }
        for axis in [1, 2, 4] {
            if i & axis != 0 {
                continue;
            }
            let to = corners[i | axis];
            let other = to.w - to.z + guard;
            if (d >= 0.0) != (other >= 0.0) {
                // From the end behind the plane, which the crossing must not be put too far from.
                let (behind, front, n, f) = if d < 0.0 {
                    (from, to, d, other)
                } else {
                    (to, from, other, d)
                };
                all.add(behind + (front - behind) * (n / (n - f)));
            }
        }
    }
    all
}
