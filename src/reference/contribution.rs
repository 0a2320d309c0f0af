//! `f64` twin of [`contribution::area`](crate::contribution::area) and of `contribution_area.wgsl`: the exact area of
//! a box's projection.
//!
//! # Three areas
//! | | its meaning |
//! |---|---|
//! | hull | of the convex hull of the projection: what the box covers |
//! | rectangle | of the smallest rectangle around it: no `f32` measure may be below |
//! | most | of that rectangle, grown as far as an `f32` measure may grow it: none may be above |
//!
//! All are clipped at the near plane and to the viewport. u, Q and S are those of
//! [`contribution::area`](crate::contribution::area). What is measured has its slack of 64u Q, up to 32u Q for the
//! roundings of its own corners and crossings, and these two multiplied: below 128u Q/w as long as w > 256u Q; nearer
//! than that the whole viewport may count. Its near plane is moved by 128u S, and its corners' and crossings' d are off
//! by up to 48u S: 256u S. Pixels: the 32u of the viewport's side it adds, and half as much for rounding. The product:
//! 16u, and as much again.

use bevy::{
    math::{Affine3A, DMat4, DVec2, DVec3, DVec4},
    prelude::*,
};

use crate::{
    culling::{
        clip::{CLIP_HUGE, CLIP_TINY},
        volume::LocalBox,
    },
    precision::UNIT_ROUNDOFF,
};

/// Areas of one box. units: px²
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Areas {
    /// Of its projection's convex hull.
    pub hull: f64,
    /// Of the smallest rectangle around that.
    pub rectangle: f64,
    /// The most that an `f32` measure may come to.
    pub most: f64,
}

impl Areas {
    /// Of what is no number: a measure must be infinite.
    const UNKNOWN: Self = Self {
        hull: f64::INFINITY,
        rectangle: f64::INFINITY,
        most: f64::INFINITY,
    };

    /// Whether a measure may come to this.
    pub fn allows(&self, area_px2: f32) -> bool {
        let area = f64::from(area_px2);
        self.rectangle <= area && area <= self.most
    }
}

/// Measures boxes in one view.
#[derive(Clone, Copy, Debug)]
pub struct AreaTwin {
    clip_from_world: DMat4,
    viewport: DVec2,
}

impl AreaTwin {
    /// Of a camera and the size of its viewport. units: px
    pub fn new(clip_from_world: Mat4, viewport: Vec2) -> Self {
        Self {
            clip_from_world: clip_from_world.as_dmat4(),
            viewport: viewport.as_dvec2(),
        }
    }

    /// The areas of a box.
    pub fn areas(&self, world_from_local: &Affine3A, volume: &LocalBox) -> Areas {
        let linear = world_from_local.matrix3;
        let column = |v: bevy::math::Vec3A, w: f64| Vec3::from(v).as_dvec3().extend(w);
        let world = DMat4::from_cols(
            column(linear.x_axis, 0.0),
            column(linear.y_axis, 0.0),
            column(linear.z_axis, 0.0),
            column(world_from_local.translation, 1.0),
        );
        let centre = volume.centre.as_dvec3();
        let axes = volume.axes.map(|axis| axis.as_dvec3());
        let magnitude = axes.iter().fold(centre.abs(), |sum, axis| sum + axis.abs());
        let known = world.is_finite()
            && self.clip_from_world.is_finite()
            && magnitude.is_finite()
            && self.viewport.is_finite()
            && self.viewport.min_element() >= 0.0;
        if !known {
            return Areas::UNKNOWN;
        }
        let clip = self.clip_from_world * world;
        let corners: [DVec4; 8] = core::array::from_fn(|k| {
            let sign = |bit: usize| if k >> bit & 1 == 0 { -1.0 } else { 1.0 };
            clip * (centre + sign(0) * axes[0] + sign(1) * axes[1] + sign(2) * axes[2]).extend(1.0)
        });
        let abs = |m: DMat4| DMat4::from_cols_array(&m.to_cols_array().map(f64::abs));
        let q = abs(self.clip_from_world) * (abs(world) * magnitude.extend(1.0));
        let points = in_front(&corners, 0.0);
        Areas {
            hull: self.hull(&points),
            rectangle: self.rectangle(&points),
            most: self.most(&corners, q),
        }
    }

    fn whole(&self) -> f64 {
        self.viewport.x * self.viewport.y
    }

    /// Pixel coordinates of quotients.
    fn px(&self, ndc: DVec2) -> DVec2 {
        0.5 * DVec2::new(1.0 + ndc.x, 1.0 - ndc.y) * self.viewport
    }

    fn rectangle(&self, points: &[DVec4]) -> f64 {
        if points.iter().any(|p| p.w <= 0.0) {
            return self.whole();
        }
        let (mut min, mut max) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for p in points {
            let px = self.px(p.truncate().truncate() / p.w);
            (min, max) = (min.min(px), max.max(px));
        }
        if points.is_empty() {
            return 0.0;
        }
        let sides = max.clamp(DVec2::ZERO, self.viewport) - min.clamp(DVec2::ZERO, self.viewport);
        sides.x * sides.y
    }

    fn hull(&self, points: &[DVec4]) -> f64 {
        // Of what has no bound, at most.
        if points.iter().any(|p| p.w <= 0.0) {
            return self.whole();
        }
        let projected = points
            .iter()
            .map(|p| self.px(p.truncate().truncate() / p.w))
            .collect();
        let mut hull = convex_hull(projected);
        for (axis, limit) in [(0, self.viewport.x), (1, self.viewport.y)] {
            hull = cut(&hull, |p| p[axis]);
            hull = cut(&hull, |p| limit - p[axis]);
        }
        polygon_area(&hull)
    }

    fn most(&self, corners: &[DVec4; 8], q: DVec4) -> f64 {
        if q.max_element() >= 0.999_99 * f64::from(CLIP_HUGE) {
            return f64::INFINITY;
        }
        let slack = 128.0 * UNIT_ROUNDOFF * q + 2.0 * f64::from(CLIP_TINY);
        let points = in_front(corners, 2.0 * (slack.z + slack.w));
        let guard = 1.0 + 32.0 * UNIT_ROUNDOFF;
        let w = points.iter().map(|p| p.w).fold(f64::INFINITY, f64::min);
        if points.is_empty() {
            return 0.0;
        }
        if w <= 2.0 * slack.w {
            return self.whole() * guard;
        }
        let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for p in points {
            let quotient = p.truncate() / p.w;
            (lo, hi) = (lo.min(quotient), hi.max(quotient));
        }
        let grow = (slack.truncate() + lo.abs().max(hi.abs()) * slack.w) / (w - slack.w);
        let (lo, hi) = ((lo - grow).truncate(), (hi + grow).truncate());
        let margin = 48.0 * UNIT_ROUNDOFF * self.viewport;
        let min = self.px(DVec2::new(lo.x, hi.y)) - margin;
        let max = self.px(DVec2::new(hi.x, lo.y)) + margin;
        let sides = max.clamp(DVec2::ZERO, self.viewport) - min.clamp(DVec2::ZERO, self.viewport);
        sides.x * sides.y * guard
    }
}

/// What of a box is not more than `beyond` behind the near plane: corners, and crossings of edges.
fn in_front(corners: &[DVec4; 8], beyond: f64) -> Vec<DVec4> {
    let d = |p: DVec4| p.w - p.z + beyond;
    let mut points = Vec::new();
    for (i, &a) in corners.iter().enumerate() {
        if d(a) >= 0.0 {
            points.push(a);
        }
        for axis in [1, 2, 4] {
            if i & axis != 0 {
                continue;
            }
            let b = corners[i | axis];
            if (d(a) >= 0.0) != (d(b) >= 0.0) {
                points.push(a + (b - a) * (d(a) / (d(a) - d(b))));
            }
        }
    }
    points
}

/// Anticlockwise, by Andrew's monotone chain.
fn convex_hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let chain = |points: &mut dyn Iterator<Item = DVec2>| {
        let mut chain: Vec<DVec2> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..]
                && (b - a).perp_dot(p - b) <= 0.0
            {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut hull = chain(&mut points.iter().copied());
    hull.extend(chain(&mut points.iter().rev().copied()));
    hull
}

/// What of a convex polygon has a distance that is not negative.
fn cut(polygon: &[DVec2], distance: impl Fn(DVec2) -> f64) -> Vec<DVec2> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let (da, db) = (distance(a), distance(b));
        if da >= 0.0 {
            kept.push(a);
        }
        if (da >= 0.0) != (db >= 0.0) {
            kept.push(a + (b - a) * (da / (da - db)));
        }
    }
    kept
}

fn polygon_area(polygon: &[DVec2]) -> f64 {
    let Some(&origin) = polygon.first() else {
        return 0.0;
    };
    let twice: f64 = polygon
        .windows(2)
        .map(|pair| (pair[0] - origin).perp_dot(pair[1] - origin))
        .sum();
    0.5 * twice.abs()
}

/// A measure that is not allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrongArea {
    /// Which, in the order of comparison.
    pub case: usize,
    /// What it came to. units: px²
    pub area_px2: f32,
    /// What it may come to.
    pub areas: Areas,
}

/// Measures compared with the twin's.
#[derive(Clone, Debug, Default)]
pub struct AreaTally {
    /// Those that are not allowed.
    pub wrong: Vec<WrongArea>,
    /// Of these, below the exact rectangle.
    pub too_small: usize,
    /// Right, and within a thousandth and a square pixel's hundredth of the exact rectangle.
    pub tight: usize,
    /// Right, and wider: near the eye or far from the origin.
    pub wide: usize,
    /// Right, and infinite.
    pub unknown: usize,
}

impl AreaTally {
    /// Compares the next one.
    pub fn add(&mut self, areas: Areas, area_px2: f32) {
        let case = self.wrong.len() + self.tight + self.wide + self.unknown;
        let area = f64::from(area_px2);
        if !areas.allows(area_px2) {
            self.too_small += usize::from(area.is_nan() || area < areas.rectangle);
            self.wrong.push(WrongArea {
                case,
                area_px2,
                areas,
            });
        } else if area.is_infinite() {
            self.unknown += 1;
        } else if area <= areas.rectangle * 1.001 + 0.01 {
            self.tight += 1;
        } else {
            self.wide += 1;
        }
    }

    /// # Errors
    /// In words, if any measure was wrong, none was tight, or more than this fraction of all was wide.
    pub fn outcome(&self, max_wide_fraction: f64) -> Result<(), String> {
        super::outcome::outcome(
            "areas",
            &self.wrong,
            self.tight,
            self.wide,
            max_wide_fraction,
        )
    }
}
