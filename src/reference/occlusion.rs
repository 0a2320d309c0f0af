//! `f64` twin of [`occlusion::verdict`](crate::occlusion::verdict) and of `occludee.wgsl`: exact projections, and
//! every texel of level 0 looked at.
//!
//! # Three verdicts
//! The twin grows the volume's projection by three amounts:
//!
//! | | clip coordinate | pixel | depth | its meaning |
//! |---|---|---|---|---|
//! | exact | 0 | 0 | 0 | what the volume itself comes to |
//! | drawn | ± 16u Q | ± 1/512 px | + 4u | what is drawn of it may lie so far off: no test may remove more |
//! | tested | ± 128u Q + 2·10⁻¹⁸ | ± (1/64 px + 48u s) | + 48u | what an `f32` test may take it for: none may remove less |
//!
//! u, Q and s are those of [`occlusion::verdict`](crate::occlusion::verdict), which counts 16u Q for Bevy's vertex
//! transform and half of 1/256 px for the rasteriser's grid. What is tested has its slack of 64u Q, 24u Q for the
//! roundings of its own corners, and these two multiplied: its quotients are within
//! (24 + 64)uQ/w · (1 + 64uQ/(w − 88uQ)), below 128uQ/w as long as w > 256uQ. Nearer than that the test may take
//! it for touching the near plane. Pixels and depths likewise: what the test adds, and half as much for what its own
//! roundings come to.
//!
//! Swept triangles are drawn as they are exactly: their balls' projections are ellipses, found by their quadratics.

use bevy::{
    math::{Affine3A, DMat4, DVec2, DVec3, DVec4},
    prelude::*,
};

use super::outcome::outcome;
use crate::{
    culling::{
        clip::{CLIP_HUGE, CLIP_TINY},
        volume::{LocalBox, Proxy, SweptTriangle},
    },
    occlusion::{
        depth::ReducedDepth,
        verdict::{SNAP_PX, Verdict},
    },
    precision::UNIT_ROUNDOFF,
};

/// How much a projection is grown.
#[derive(Clone, Copy, Debug)]
struct Growth {
    /// Times Q.
    clip: f64,
    clip_tiny: f64,
    px: f64,
    /// Times the viewport's side.
    px_relative: f64,
    depth: f64,
}

const EXACT: Growth = Growth {
    clip: 0.0,
    clip_tiny: 0.0,
    px: 0.0,
    px_relative: 0.0,
    depth: 0.0,
};
const DRAWN: Growth = Growth {
    clip: 16.0 * UNIT_ROUNDOFF,
    px: 1.0 / 512.0,
    depth: 4.0 * UNIT_ROUNDOFF,
    ..EXACT
};
const TESTED: Growth = Growth {
    clip: 128.0 * UNIT_ROUNDOFF,
    clip_tiny: 2.0 * CLIP_TINY as f64,
    px: SNAP_PX as f64,
    px_relative: 48.0 * UNIT_ROUNDOFF,
    depth: 48.0 * UNIT_ROUNDOFF,
};

/// What a test may answer: verdicts in the order visible, hidden, outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Judgement {
    /// In exact arithmetic. [`Verdict::Visible`]: definitely visible.
    pub exact: Verdict,
    /// The most that may be removed.
    pub drawn: Verdict,
    /// The least that must be removed. Other than [`Verdict::Visible`]: definitely not visible.
    pub tested: Verdict,
}

impl Judgement {
    const VISIBLE: Self = Self {
        exact: Verdict::Visible,
        drawn: Verdict::Visible,
        tested: Verdict::Visible,
    };

    /// Whether a test may come to this.
    pub fn allows(&self, verdict: Verdict) -> bool {
        self.tested <= verdict && verdict <= self.drawn
    }

    /// Whether rounding has a say.
    pub fn is_in_band(&self) -> bool {
        self.tested != self.exact
    }

    /// Of a volume that is followed by another of the same object where it is visible.
    fn then(self, next: Self) -> Self {
        let exact = match self.exact {
            Verdict::Visible => next.exact,
            removed => removed,
        };
        if self.tested != Verdict::Visible {
            return Self { exact, ..self };
        }
        Self {
            exact,
            drawn: self.drawn.max(next.drawn),
            tested: match self.drawn {
                Verdict::Visible => next.tested,
                _ => next.tested.min(Verdict::Hidden),
            },
        }
    }
}

/// Bounds of a projection.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    /// Of x/w, y/w, z/w.
    lo: DVec3,
    hi: DVec3,
}

impl Bounds {
    const EMPTY: Self = Self {
        lo: DVec3::INFINITY,
        hi: DVec3::NEG_INFINITY,
    };

    fn with(self, lo: DVec3, hi: DVec3) -> Self {
        Self {
            lo: self.lo.min(lo),
            hi: self.hi.max(hi),
        }
    }
}

/// What is tested of a volume: clip-space balls (ellipsoids) whose convex hull it is.
struct Balls {
    /// Clip coordinates.
    centres: Vec<DVec4>,
    /// Rows of the linear part times the radius; all zero for points.
    rows: [DVec3; 4],
    /// Q: magnitudes of the terms that clip coordinates are sums of.
    magnitude: DVec4,
}

impl Balls {
    /// How far each clip coordinate reaches.
    fn reach(&self) -> DVec4 {
        DVec4::from_array(self.rows.map(DVec3::length))
    }

    /// The most, over all balls, of a row's combination with w: `sign`·row + `w_share`·w.
    fn most(&self, row: usize, sign: f64, w_share: f64, slack: DVec4) -> f64 {
        let way = sign * self.rows[row] + w_share * self.rows[3];
        self.centres
            .iter()
            .map(|c| sign * c[row] + w_share * c.w)
            .fold(f64::NEG_INFINITY, f64::max)
            + way.length()
            + slack[row]
            + w_share * slack.w
    }

    /// Whether all lies beyond one of the clip volume's planes, those at the viewport's sides moved out: `wide` is 1
    /// where they stay.
    fn is_off(&self, slack: DVec4, wide: DVec2) -> bool {
        let planes = [
            (0, 1.0, wide.x),
            (0, -1.0, wide.x),
            (1, 1.0, wide.y),
            (1, -1.0, wide.y),
            (2, 1.0, 0.0),
            (2, -1.0, 1.0),
        ];
        planes
            .into_iter()
            .any(|(row, sign, w_share)| self.most(row, sign, w_share, slack) < 0.0)
    }

    /// Smallest w.
    fn least_w(&self) -> f64 {
        let least = self
            .centres
            .iter()
            .map(|c| c.w)
            .fold(f64::INFINITY, f64::min);
        least - self.rows[3].length()
    }

    /// Whether some point lies on or before the near plane, or may do so with this slack.
    fn is_near(&self, slack: DVec4) -> bool {
        let before = self
            .centres
            .iter()
            .map(|c| c.z - c.w)
            .fold(f64::NEG_INFINITY, f64::max)
            + (self.rows[2] - self.rows[3]).length();
        self.least_w() - slack.w <= 0.0 || before + slack.z + slack.w >= 0.0
    }

    /// Bounds of the quotients, each point off by up to the slack. All w, less slack, are positive.
    fn bounds(&self, slack: DVec4) -> Bounds {
        let mut all = Bounds::EMPTY;
        for c in &self.centres {
            let mut lo = DVec3::ZERO;
            let mut hi = DVec3::ZERO;
            for row in 0..3 {
                (lo[row], hi[row]) = self.quotient(row, *c);
                // Only points are moved by a slack; their quotients lie furthest out at its corners.
                if slack != DVec4::ZERO {
                    let ends = [c.w - slack.w, c.w + slack.w];
                    for w in ends {
                        lo[row] = lo[row].min((c[row] - slack[row]) / w);
                        hi[row] = hi[row].max((c[row] + slack[row]) / w);
                    }
                }
            }
            all = all.with(lo, hi);
        }
        all
    }

    /// Least and largest quotient q in a ball: where row − q·w touches zero.
    fn quotient(&self, row: usize, c: DVec4) -> (f64, f64) {
        let (x, w) = (self.rows[row], self.rows[3]);
        let (cx, cw) = (c[row], c.w);
        let a = cw * cw - w.length_squared();
        let b = cx * cw - x.dot(w);
        let d = (cw * x - cx * w).length_squared() - x.cross(w).length_squared();
        let root = d.max(0.0).sqrt();
        ((b - root) / a, (b + root) / a)
    }
}

/// Judges tests against one reduced depth.
#[derive(Clone, Debug)]
pub struct OcclusionTwin<'a> {
    depth: &'a ReducedDepth,
    clip_from_world: DMat4,
}

impl<'a> OcclusionTwin<'a> {
    /// Of depth that is [consistent](ReducedDepth::is_consistent).
    pub fn new(depth: &'a ReducedDepth) -> Self {
        Self {
            depth,
            clip_from_world: depth.clip_from_world.as_dmat4(),
        }
    }

    /// What a test of this volume may come to.
    pub fn judge(
        &self,
        world_from_local: &Affine3A,
        volume: &LocalBox,
        turned: Option<&LocalBox>,
        proxy: Option<&Proxy>,
    ) -> Judgement {
        let linear = world_from_local.matrix3;
        let column = |v: bevy::math::Vec3A, w: f64| Vec3::from(v).as_dvec3().extend(w);
        let world = DMat4::from_cols(
            column(linear.x_axis, 0.0),
            column(linear.y_axis, 0.0),
            column(linear.z_axis, 0.0),
            column(world_from_local.translation, 1.0),
        );
        if !self.depth.is_consistent() || !world.is_finite() || !self.clip_from_world.is_finite() {
            return Judgement::VISIBLE;
        }
        let mut judgement = self.judge_box(world, volume);
        if let Some(turned) = turned {
            judgement = judgement.then(self.judge_box(world, turned));
        }
        match proxy {
            Some(proxy) if !proxy.triangles.is_empty() => {
                judgement.then(self.judge_proxy(world, proxy))
            }
            _ => judgement,
        }
    }

    /// Q of points with local coordinates up to `magnitude`.
    fn magnitude(&self, world: DMat4, magnitude: DVec3) -> DVec4 {
        let abs = |m: DMat4| DMat4::from_cols_array(&m.to_cols_array().map(f64::abs));
        abs(self.clip_from_world) * (abs(world) * magnitude.extend(1.0))
    }

    fn judge_box(&self, world: DMat4, volume: &LocalBox) -> Judgement {
        let centre = volume.centre.as_dvec3();
        let axes = volume.axes.map(|axis| axis.as_dvec3());
        let magnitude = axes.iter().fold(centre.abs(), |sum, axis| sum + axis.abs());
        if !magnitude.is_finite() {
            return Judgement::VISIBLE;
        }
        let clip = self.clip_from_world * world;
        let corner = |k: usize| {
            let sign = |bit: usize| if k >> bit & 1 == 0 { -1.0 } else { 1.0 };
            clip * (centre + sign(0) * axes[0] + sign(1) * axes[1] + sign(2) * axes[2]).extend(1.0)
        };
        self.judge_balls(&Balls {
            centres: (0..8).map(corner).collect(),
            rows: [DVec3::ZERO; 4],
            magnitude: self.magnitude(world, magnitude),
        })
    }

    fn judge_proxy(&self, world: DMat4, proxy: &Proxy) -> Judgement {
        let every = proxy
            .triangles
            .iter()
            .map(|triangle| self.judge_triangle(world, triangle))
            .collect::<Vec<_>>();
        // One visible triangle is enough; all must be outside.
        let of = |which: fn(&Judgement) -> Verdict| {
            let all = every.iter().map(which);
            all.min().unwrap_or(Verdict::Visible)
        };
        Judgement {
            exact: of(|j| j.exact),
            drawn: of(|j| j.drawn),
            tested: of(|j| j.tested),
        }
    }

    fn judge_triangle(&self, world: DMat4, triangle: &SweptTriangle) -> Judgement {
        let corners = triangle.corners.map(|corner| corner.as_dvec3());
        let radius = f64::from(triangle.radius).abs();
        let [a, b, c] = corners;
        // As the test does it, not the smallest that is a bound.
        let magnitude = a.abs() + (b - a).abs() + (c - a).abs() + DVec3::splat(radius);
        if !magnitude.is_finite() {
            return Judgement::VISIBLE;
        }
        let clip = self.clip_from_world * world;
        let rows = [0, 1, 2, 3].map(|k| radius * clip.row(k).truncate());
        self.judge_balls(&Balls {
            centres: corners.map(|corner| clip * corner.extend(1.0)).to_vec(),
            rows,
            magnitude: self.magnitude(world, magnitude),
        })
    }

    fn judge_balls(&self, balls: &Balls) -> Judgement {
        let is_point = balls.rows == [DVec3::ZERO; 4];
        Judgement {
            exact: self.at(balls, EXACT),
            drawn: if is_point {
                self.at(balls, DRAWN)
            } else {
                let clip = 0.0;
                self.at(balls, Growth { clip, ..DRAWN })
            },
            tested: self.tested(balls),
        }
    }

    /// The verdict on the projection, grown no more than it must be.
    fn at(&self, balls: &Balls, growth: Growth) -> Verdict {
        let slack = growth.clip * balls.magnitude;
        if balls.is_off(slack, self.wide(growth)) {
            return Verdict::Outside;
        }
        if balls.is_near(slack) {
            return Verdict::Visible;
        }
        self.covers(balls.bounds(slack), growth)
    }

    /// The verdict on the projection, grown as much as a test may grow it.
    fn tested(&self, balls: &Balls) -> Verdict {
        let reach = balls.reach();
        let slack = TESTED.clip * balls.magnitude + TESTED.clip_tiny + reach;
        let huge = 0.999_99 * f64::from(CLIP_HUGE);
        if balls.magnitude.max_element() >= huge || slack.max_element() >= huge {
            return Verdict::Visible;
        }
        let points = Balls {
            centres: balls.centres.clone(),
            rows: [DVec3::ZERO; 4],
            magnitude: balls.magnitude,
        };
        let surely_near = points.is_near(DVec4::ZERO);
        if surely_near {
            let off = points.is_off(slack, self.wide(TESTED));
            return if off {
                Verdict::Outside
            } else {
                Verdict::Visible
            };
        }
        let w = points.least_w();
        if w <= 2.0 * slack.w {
            return Verdict::Visible;
        }
        let Bounds { lo, hi } = points.bounds(DVec4::ZERO);
        let grow = (slack.truncate() + lo.abs().max(hi.abs()) * slack.w) / (w - slack.w);
        let bounds = Bounds {
            lo: lo - grow,
            hi: hi + grow,
        };
        if bounds.hi.z * (1.0 + TESTED.depth) >= 1.0 {
            return Verdict::Visible;
        }
        self.covers(bounds, TESTED)
    }

    /// How far out the viewport's sides are, in NDC, with the margin around it.
    fn wide(&self, growth: Growth) -> DVec2 {
        let viewport = self.depth.viewport.as_dvec2();
        let margin = DVec2::splat(growth.px) + growth.px_relative * viewport;
        DVec2::ONE + 2.0 * margin / viewport
    }

    /// The verdict on what covers these NDC, wholly beyond the near plane.
    fn covers(&self, Bounds { lo, hi }: Bounds, growth: Growth) -> Verdict {
        let viewport = self.depth.viewport.as_dvec2();
        let margin = DVec2::splat(growth.px) + growth.px_relative * viewport;
        let min = 0.5 * DVec2::new(1.0 + lo.x, 1.0 - hi.y) * viewport - margin;
        let max = 0.5 * DVec2::new(1.0 + hi.x, 1.0 - lo.y) * viewport + margin;
        let nearest = hi.z * (1.0 + growth.depth);
        if nearest < 0.0 || max.cmplt(DVec2::ZERO).any() || min.cmpge(viewport).any() {
            return Verdict::Outside;
        }
        let nearest = nearest.max(f64::from(f32::MIN_POSITIVE));
        let first = min.floor().max(DVec2::ZERO).as_uvec2();
        let last = max.floor().min(viewport - 1.0).as_uvec2();
        let Some(base) = self.depth.levels.first() else {
            return Verdict::Visible;
        };
        for j in 0..base.size.y {
            for i in 0..base.size.x {
                let low = UVec2::new(i, j) * self.depth.block;
                let high = if self.depth.strided {
                    low
                } else {
                    low + self.depth.block - 1
                };
                let touched = high.cmpge(first).all() && low.cmple(last).all();
                let texel = self.depth.texels[(j * base.size.x + i) as usize];
                let hides = (0.0..=1.0).contains(&texel) && nearest < f64::from(texel);
                if touched && !hides {
                    return Verdict::Visible;
                }
            }
        }
        Verdict::Hidden
    }
}

/// A verdict that is not allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrongVerdict {
    /// Which, in the order of comparison.
    pub case: usize,
    /// What it came to.
    pub verdict: Verdict,
    /// What it may come to.
    pub judgement: Judgement,
}

/// Verdicts compared with the twin's judgement.
#[derive(Clone, Debug, Default)]
pub struct OcclusionTally {
    /// Those that are not allowed.
    pub wrong: Vec<WrongVerdict>,
    /// Of these: removed though exactly visible.
    pub removed_visible: usize,
    /// Of these: removed though rounding might show it.
    pub removed_in_band: usize,
    /// Of these: kept, or not known to be outside, though no rounding stands against it.
    pub missed: usize,
    /// Right, and only this verdict was.
    pub decided: [usize; 3],
    /// Right, and rounding had a say.
    pub in_band: usize,
}

impl OcclusionTally {
    /// Compares the next one.
    pub fn add(&mut self, judgement: Judgement, verdict: Verdict) {
        let case = self.wrong.len() + self.in_band + self.decided.iter().sum::<usize>();
        if judgement.allows(verdict) {
            if judgement.is_in_band() {
                self.in_band += 1;
            } else {
                self.decided[verdict as usize] += 1;
            }
            return;
        }
        if verdict < judgement.tested {
            self.missed += 1;
        } else if judgement.exact == Verdict::Visible {
            self.removed_visible += 1;
        } else {
            self.removed_in_band += 1;
        }
        self.wrong.push(WrongVerdict {
            case,
            verdict,
            judgement,
        });
    }

    /// # Errors
    /// In words, if any verdict was wrong, none was decided, or more than this fraction of all was in the guard band.
    pub fn outcome(&self, max_in_band_fraction: f64) -> Result<(), String> {
        let decided = self.decided.iter().sum();
        outcome(
            "verdicts",
            &self.wrong,
            decided,
            self.in_band,
            max_in_band_fraction,
        )
    }
}
