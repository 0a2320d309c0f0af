//! Whether a volume is hidden behind a reduced depth buffer.
//!
//! `occludee.wgsl` is the same, operation by operation; [`reference::occlusion`](crate::reference::occlusion) is its
//! `f64` twin.
//!
//! # Arithmetic
//! u = 2⁻²⁴ is half the distance from 1 to the next `f32`. As in [`reference::guard`](crate::reference::guard), on a
//! GPU a sum, a product or a conversion may be off by 2u of its result, a quotient by 5u, a square root by 9u.
//!
//! # How far clip coordinates may be off
//! Of every clip coordinate, Q = |C|·|M|·(|p|, 1) sums the magnitudes of all terms, with C `clip_from_world`, M
//! `world_from_local` and |p| the largest local coordinates that occur. Each term goes through as many roundings as
//! products and sums follow it:
//!
//! | step | box | swept triangle |
//! |---|---|---|
//! | here: C·M, a product and three sums | 8u Q | 8u Q |
//! | its product with a point | 8u Q | 8u Q |
//! | a corner from the centre and three half axes | 6u Q | – |
//! | norms of C·M's rows, times the radius | – | 16u Q |
//! | where Bevy draws: M·p, then C times that | 16u Q | 16u Q |
//! | where the rasteriser clips a triangle at the viewport's sides | 8u Q | 8u Q |
//! | all | 46u Q | 56u Q |
//!
//! rounded up to a power of two: **slack = 64u Q**, and 10⁻¹⁸ for products that are too small for an `f32`. A
//! swept triangle's slack has also the extent of its ball, radius × norm of the row of C·M.
//! With the slack e, the drawn object lies among the corners' convex hull, grown by ±e per clip coordinate, and its
//! quotients within max |q| of the corners' own: **(e + |q| e_w) / (w − e_w)** farther, w being the smallest.
//!
//! # How far pixels may be off
//! A pixel is (1 + q) s/2, s being the viewport's side and |q| at most 2: beyond that it is cut off. The quotient is
//! off by 7u of 2; sum, product and margin by 2u each of 3: 16u s. The driver's own divide and viewport transform
//! count as much again. **32u s**, and **1/64 px** for the grid of 1/256 px that rasterisers move corners to.
//!
//! # How far depths may be off
//! The quotient here 7u and its product 2u, the driver's 7u, its viewport transform 4u, the interpolation between
//! three corners of non-degenerate triangles 12u: **32u** of the nearest depth.
//!
//! # Reference
//! P2, sections 3.2 and 4.3.

use bevy::{
    math::{Affine3A, Vec3A},
    prelude::*,
};

use super::depth::{DepthLevel, ReducedDepth};
use crate::culling::{
    clip::{ClipFrame, ClipView, PIXEL_ERROR, Quotients, is_calculable, point},
    volume::{LocalBox, Proxy, SweptTriangle},
};

/// A rasteriser's grid, and more. units: px
pub const SNAP_PX: f32 = 1.0 / 64.0;
/// What depths are multiplied by: 1 + 32u.
pub const DEPTH_GUARD: f32 = 1.0 + 1.0 / (1 << 19) as f32;
/// Most texels that a test of one rectangle reads; one that would need more is [`Verdict::Visible`].
pub const MOST_STEPS: u32 = 32_768;
/// Most texels along a side that [`DepthTest::visible_share`] looks at.
const SHARE_TEXELS: u32 = 9;

/// What a test comes to.
#[derive(Reflect, Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum Verdict {
    /// Some of it may show. Also the verdict on all that cannot be calculated with.
    Visible = 0,
    /// It lies strictly behind the depth at every pixel it could cover.
    Hidden = 1,
    /// It covers no pixel: it lies beside the view, behind the camera, or beyond a far plane.
    Outside = 2,
}

impl Verdict {
    /// The verdict that a GPU wrote; any other number is [`Verdict::Visible`].
    pub fn from_gpu(word: u32) -> Self {
        match word {
            1 => Self::Hidden,
            2 => Self::Outside,
            _ => Self::Visible,
        }
    }
}

/// A reduced depth, prepared for many tests.
#[derive(Clone, Debug)]
pub struct DepthTest<'a> {
    clip: ClipView,
    half_size: Vec2,
    margin: Vec2,
    viewport: Vec2,
    block: UVec2,
    strided: bool,
    levels: &'a [DepthLevel],
    texels: &'a [f32],
}

/// What pixels a volume may cover, and how near.
enum Footprint {
    /// None.
    Nothing,
    /// It may touch the near plane.
    Near,
    Pixels {
        first: UVec2,
        last: UVec2,
        nearest: f32,
    },
}

/// How far clip coordinates reach within one unit around a local point.
fn reach(frame: &ClipFrame) -> Vec4 {
    let [a, b, c, _] = frame.columns;
    let squares = a * a + b * b + c * c + Vec4::splat(1e-36);
    Vec4::from_array(squares.to_array().map(f32::sqrt))
}

/// Whether all corners lie on the outer side of one of the clip volume's planes, by more than the slack, and at the
/// viewport's sides by more than the margin. `half_size` is the viewport's, `wide` that and the margin. units: px
#[cold]
fn is_off(corners: &[Vec4], slack: Vec4, half_size: Vec2, wide: Vec2) -> bool {
    let scale = half_size.extend(1.0);
    let mut low = Vec3::MIN;
    let mut high = Vec3::MIN;
    for corner in corners {
        let (p, w) = (corner.truncate() * scale, corner.w);
        let side = wide * w;
        low = low.max(Vec3::new(p.x + side.x, p.y + side.y, p.z));
        high = high.max(side.extend(w) - p);
    }
    let reach = slack.truncate() * scale;
    let side = wide * slack.w;
    low += reach + side.extend(0.0);
    high += reach + side.extend(slack.w);
    low.min_element() < 0.0 || high.min_element() < 0.0
}

impl<'a> DepthTest<'a> {
    /// Prepares. Depth whose sizes do not [fit together](ReducedDepth::is_consistent) hides nothing.
    pub fn new(depth: &'a ReducedDepth) -> Self {
        let levels: &[DepthLevel] = if depth.is_consistent() {
            &depth.levels
        } else {
            &[]
        };
        Self {
            clip: ClipView::new(depth.clip_from_world),
            half_size: depth.viewport * 0.5,
            margin: depth.viewport * PIXEL_ERROR + Vec2::splat(SNAP_PX),
            viewport: depth.viewport,
            block: depth.block,
            strided: depth.strided,
            levels,
            texels: &depth.texels,
        }
    }

    /// Tests a box and, where that is visible, the proxy.
    ///
    /// [`Verdict::Hidden`] and [`Verdict::Outside`] are given only if no pixel of what the volume encloses could pass
    /// the depth test against the pixels that were reduced, however Bevy's and the rasteriser's rounding falls. With
    /// [`DepthSampling::Strided`](super::DepthSampling::Strided) that holds of the pixels read; what lies between them is
    /// `Hidden` (P2's own error). Equal depth is visible. A proxy without triangles counts as none.
    ///
    /// # Inputs
    /// Box and proxy in local space, each enclosing the object. Anything that is not finite, or larger than
    /// `CLIP_HUGE` in clip space, is `Visible`; so is what touches the near plane.
    ///
    /// # Limits
    /// A triangle so thin that the driver's depth interpolation leaves the range of its corners by more than 12u is
    /// not allowed for.
    pub fn verdict(
        &self,
        world_from_local: &Affine3A,
        volume: &LocalBox,
        turned: Option<&LocalBox>,
        proxy: Option<&Proxy>,
    ) -> Verdict {
        if self.levels.is_empty() {
            return Verdict::Visible;
        }
        let frame = self.clip.frame(world_from_local);
        let mut verdict = self.box_verdict(&frame, volume);
        if verdict == Verdict::Visible
            && let Some(turned) = turned
        {
            verdict = self.box_verdict(&frame, turned);
        }
        match proxy {
            Some(proxy) if verdict == Verdict::Visible && !proxy.triangles.is_empty() => {
                self.proxy_verdict(&frame, &proxy.triangles)
            }
            _ => verdict,
        }
    }

    #[inline]
    fn box_verdict(&self, frame: &ClipFrame, volume: &LocalBox) -> Verdict {
        match frame.corners(volume) {
            Some((corners, slack)) => self.hull_verdict(&corners, slack),
            None => Verdict::Visible,
        }
    }

    /// Which share of the rectangle that a box projects to is not nearer in this depth than the box's nearest point; 1
    /// where that cannot be told: outside the view, at the near plane, or where the box cannot be calculated with.
    ///
    /// Looked up in the finest level where the rectangle has at most 9 × 9 texels. A texel is open if the farthest of
    /// what it stands for is not nearer, so that the share is too large rather than too small.
    /// range: 0..=1
    pub fn visible_share(&self, world_from_local: &Affine3A, volume: &LocalBox) -> f32 {
        let frame = self.clip.frame(world_from_local);
        let (false, Some((corners, slack))) = (self.levels.is_empty(), frame.corners(volume))
        else {
            return 1.0;
        };
        let Footprint::Pixels {
            first,
            last,
            nearest,
        } = self.footprint(&Quotients::of(&corners), slack)
        else {
            return 1.0;
        };
        let (mut first, mut last) = (first / self.block, last / self.block);
        let mut level = 0;
        while (last - first).max_element() >= SHARE_TEXELS {
            (first, last, level) = (first / 2, last / 2, level + 1);
        }
        let mut open = 0;
        for y in first.y..=last.y {
            for x in first.x..=last.x {
                open += u32::from(!self.hides(level, x, y, nearest));
            }
        }
        let all = (last - first + 1).element_product();
        open as f32 / all as f32
    }

    /// `Outside` if all triangles are, `Visible` if any is.
    fn proxy_verdict(&self, frame: &ClipFrame, triangles: &[SweptTriangle]) -> Verdict {
        let reach = reach(frame);
        let mut all = Verdict::Outside;
        for triangle in triangles {
            let [a, b, c] = triangle.corners.map(Vec3A::from);
            let radius = triangle.radius.abs();
            let magnitude = a.abs() + (b - a).abs() + (c - a).abs() + Vec3A::splat(radius);
            let Some(slack) = frame.slack(magnitude) else {
                return Verdict::Visible;
            };
            let slack = slack + reach * radius;
            if !is_calculable(slack) {
                return Verdict::Visible;
            }
            let corners = [a, b, c].map(|corner| point(&frame.columns, corner));
            match self.hull_verdict(&corners, slack) {
                Verdict::Visible => return Verdict::Visible,
                Verdict::Hidden => all = Verdict::Hidden,
                Verdict::Outside => {}
            }
        }
        all
    }

    /// Of the corners' convex hull, grown by the slack along every clip coordinate.
    #[inline]
    fn hull_verdict(&self, corners: &[Vec4], slack: Vec4) -> Verdict {
        match self.footprint(&Quotients::of(corners), slack) {
            Footprint::Nothing => Verdict::Outside,
            Footprint::Near
                if is_off(corners, slack, self.half_size, self.half_size + self.margin) =>
            {
                Verdict::Outside
            }
            Footprint::Near => Verdict::Visible,
            Footprint::Pixels {
                first,
                last,
                nearest,
            } => self.rect_verdict(first, last, nearest),
        }
    }

    #[inline]
    fn footprint(&self, quotients: &Quotients, slack: Vec4) -> Footprint {
        let Some((lo, hi)) = quotients.grown(slack) else {
            return Footprint::Near;
        };
        let nearest = hi.z * DEPTH_GUARD;
        if nearest >= 1.0 {
            return Footprint::Near;
        }
        let lo = lo.clamp(Vec4::splat(-2.0), Vec4::splat(2.0));
        let hi = hi.clamp(Vec4::splat(-2.0), Vec4::splat(2.0));
        let min = Vec2::new(1.0 + lo.x, 1.0 - hi.y) * self.half_size - self.margin;
        let max = Vec2::new(1.0 + hi.x, 1.0 - lo.y) * self.half_size + self.margin;
        let Vec2 {
            x: width,
            y: height,
        } = self.viewport;
        if nearest < 0.0 || max.x < 0.0 || max.y < 0.0 || min.x >= width || min.y >= height {
            return Footprint::Nothing;
        }
        Footprint::Pixels {
            first: min.max(Vec2::ZERO).as_uvec2(),
            last: max.min(self.viewport - 1.0).as_uvec2(),
            // What underflows on a GPU may not differ.
            nearest: nearest.max(f32::MIN_POSITIVE),
        }
    }

    /// Of something that covers at most these pixels, nowhere nearer than `nearest`.
    #[inline]
    fn rect_verdict(&self, first: UVec2, last: UVec2, nearest: f32) -> Verdict {
        let past = last / self.block;
        let from = if self.strided {
            let from = (first + self.block - 1) / self.block;
            if from.x > past.x || from.y > past.y {
                return Verdict::Hidden;
            }
            from
        } else {
            first / self.block
        };
        if self.is_behind(from, past, nearest) {
            Verdict::Hidden
        } else {
            Verdict::Visible
        }
    }

    /// Whether `nearest` lies strictly behind all texels of level 0 from `first` to `last`.
    ///
    /// Goes down the pyramid in Z-order, only into what is partly within the rectangle: a cell that is wholly within
    /// it and does not hide holds a texel that does not.
    #[inline]
    fn is_behind(&self, first: UVec2, last: UVec2, nearest: f32) -> bool {
        let span = (last.x - first.x).max(last.y - first.y);
        // Where the rectangle spans at most two cells each way.
        let top = if span <= 1 {
            0
        } else {
            32 - (span - 1).leading_zeros()
        };
        let edge = self.levels.first().map_or(UVec2::ZERO, |level| level.size) - 1;
        // Beyond the last column and row there is nothing.
        let open = UVec2::new(
            if last.x == edge.x { u32::MAX } else { last.x },
            if last.y == edge.y { u32::MAX } else { last.y },
        );
        let mut level = top;
        let mut x = first.x >> top;
        let mut y = first.y >> top;
        for _ in 0..MOST_STEPS {
            let within = x >= first.x >> level
                && x <= last.x >> level
                && y >= first.y >> level
                && y <= last.y >> level;
            if within && !self.hides(level, x, y, nearest) {
                let inside = x << level >= first.x
                    && y << level >= first.y
                    && ((x + 1) << level) - 1 <= open.x
                    && ((y + 1) << level) - 1 <= open.y;
                if inside {
                    return false;
                }
                level -= 1;
                x *= 2;
                y *= 2;
                continue;
            }
            // Up from the last of four children: one level for each pair of trailing ones.
            let up = (!(x & y)).trailing_zeros().min(top - level);
            level += up;
            x >>= up;
            y >>= up;
            if level < top {
                y += x & 1;
                x ^= 1;
            } else if x < last.x >> top {
                x += 1;
            } else if y < last.y >> top {
                x = first.x >> top;
                y += 1;
            } else {
                return true;
            }
        }
        false
    }

    /// By the bits, which are in the order of the numbers from 0 to 1; all others hide nothing.
    #[inline]
    fn hides(&self, level: u32, x: u32, y: u32, nearest: f32) -> bool {
        self.levels
            .get(level as usize)
            .and_then(|level| {
                self.texels
                    .get((level.first + y * level.size.x + x) as usize)
            })
            .is_some_and(|texel| {
                let bits = texel.to_bits();
                nearest.to_bits() < bits && bits <= 1.0f32.to_bits()
            })
    }
}
