//! Which bins of directions a triangle covers, seen from the centre: the paper's line scanning, made conservative.
//!
//! Seen from the centre a triangle is bounded by arcs of great circles. Each is gone along in steps of at most a
//! quarter of a bin; around the middle of a step there is a cap that holds the step, and around the cap a box in (θ,
//! φ). In each row, everything between the least and the greatest φ of the boxes is covered:
//!
//! - **No pole inside.** All of the triangle is then on one side of a plane through the poles, less than π wide in φ.
//!   In a row the extreme φ are on the boundary, so that what lies between them holds the triangle.
//! - **A pole inside.** From any point of the triangle, going away from that pole, one comes to the boundary. So every
//!   box counts for its own rows and for all between it and the pole.
//! - **Both, or the centre too near to tell**: everything is covered.
//!
//! It errs towards covering: by at most a quarter of a bin at each side for triangles without a pole inside.

use core::f64::consts::{FRAC_PI_2, PI, TAU};

use bevy::math::DVec3;

use super::bins::{Bins, angles};

/// Added to every angle. Directions are off by some 2⁻⁵¹ by rounding; where an arc's ends are nearly opposite, its
/// points by up to 2⁻⁵⁰ / [`OPPOSITE`] < 10⁻⁹. units: rad
const SLACK: f64 = 2e-9;
/// An arc whose ends are nearer to being opposite passes too near the centre to tell on which side. units: rad
const OPPOSITE: f64 = 1e-6;
/// Products of three unit vectors that differ from 0 by less have no sign that can be relied on: rounding makes some
/// 10 · 2⁻⁵³.
const FLAT: f64 = 1e-12;

/// What of a row is covered.
#[derive(Clone, Copy)]
struct Span {
    least: f64,
    greatest: f64,
}

impl Span {
    const EMPTY: Self = Self {
        least: f64::INFINITY,
        greatest: f64::NEG_INFINITY,
    };
}

/// Finds the bins that triangles cover; keeps its memory between them.
pub struct Cover {
    bins: Bins,
    spans: Vec<Span>,
}

impl Cover {
    /// For these bins.
    pub fn new(bins: Bins) -> Self {
        Self {
            bins,
            spans: vec![Span::EMPTY; usize::from(bins.theta)],
        }
    }

    /// Calls with each bin that a triangle covers, once. Corners are relative to the centre.
    pub fn each(&mut self, corners: [DVec3; 3], mut found: impl FnMut(usize)) {
        let columns = usize::from(self.bins.phi);
        let Some(rows) = self.scan(corners) else {
            (0..self.bins.count()).for_each(found);
            return;
        };
        for row in rows {
            let Span { least, greatest } = core::mem::replace(&mut self.spans[row], Span::EMPTY);
            let first_bin = row * columns;
            if greatest - least >= TAU {
                (first_bin..first_bin + columns).for_each(&mut found);
            } else if least <= greatest {
                let step = self.bins.phi_step();
                let (first, last) = ((least / step).floor(), (greatest / step).floor());
                let first_column = first.rem_euclid(columns as f64) as usize;
                for next in 0..((last - first) as usize + 1).min(columns) {
                    found(first_bin + (first_column + next) % columns);
                }
            }
        }
    }

    /// Fills the rows' spans and says which rows; `None` if everything is covered.
    fn scan(&mut self, corners: [DVec3; 3]) -> Option<core::ops::RangeInclusive<usize>> {
        // What has a corner at the centre is seen as the arc between the other two.
        let mut seen = [DVec3::ZERO; 3];
        let mut count = 0;
        for corner in corners {
            if let Some(direction) = unit(corner) {
                seen[count] = direction;
                count += 1;
            }
        }
        let seen = &seen[..count];
        if count == 0 {
            return None;
        }
        let pole = match seen {
            &[a, b, c] => match (holds([a, b, c], DVec3::Y), holds([a, b, c], DVec3::NEG_Y)) {
                (true, true) => return None,
                (true, false) => Some(0),
                (false, true) => Some(usize::from(self.bins.theta) - 1),
                (false, false) => None,
            },
            _ => None,
        };
        let mut rows = (usize::MAX, 0);
        let mut phi = angles(seen[0]).1;
        let edges = if count == 3 { 3 } else { 1 };
        for edge in 0..edges {
            let (from, to) = (seen[edge], seen[(edge + 1) % count]);
            let whole = from.cross(to).length().atan2(from.dot(to));
            if whole > PI - OPPOSITE {
                self.spans.fill(Span::EMPTY);
                return None;
            }
            let longest = self.bins.theta_step().min(self.bins.phi_step()).min(1.0) / 4.0;
            let steps = (whole / longest).ceil().max(1.0);
            let radius = whole / steps / 2.0 + SLACK;
            for step in 0..steps as usize {
                let at = whole * (step as f64 + 0.5) / steps;
                // Of any length: only its angles count.
                let middle = if whole > OPPOSITE {
                    from * (whole - at).sin() + to * at.sin()
                } else {
                    from + to
                };
                self.add(middle, radius, pole, &mut phi, &mut rows);
            }
        }
        Some(rows.0..=rows.1)
    }

    /// Adds a cap to the spans.
    fn add(
        &mut self,
        middle: DVec3,
        radius: f64,
        pole: Option<usize>,
        phi: &mut f64,
        rows: &mut (usize, usize),
    ) {
        let (theta, turned) = angles(middle);
        // The azimuth nearest to the last one.
        *phi += (turned - *phi + PI).rem_euclid(TAU) - PI;
        let to_pole = theta.min(PI - theta);
        let half = if radius >= to_pole.min(FRAC_PI_2) {
            PI
        } else {
            (radius.sin() / to_pole.sin()).min(1.0).asin() + SLACK
        };
        let (mut first, mut last) = (
            self.bins.row(theta - radius - SLACK),
            self.bins.row(theta + radius + SLACK),
        );
        if let Some(pole) = pole {
            first = first.min(pole);
            last = last.max(pole);
        }
        *rows = (rows.0.min(first), rows.1.max(last));
        for span in &mut self.spans[first..=last] {
            span.least = span.least.min(*phi - half);
            span.greatest = span.greatest.max(*phi + half);
        }
    }
}

/// Whether a direction may be inside a spherical triangle or within rounding of its border.
pub(super) fn holds([a, b, c]: [DVec3; 3], direction: DVec3) -> bool {
    let sides = [(a, b), (b, c), (c, a)].map(|(from, to)| from.cross(to).dot(direction));
    let turn = a.cross(b).dot(c);
    (turn >= -FLAT && sides.iter().all(|side| *side >= -FLAT))
        || (turn <= FLAT && sides.iter().all(|side| *side <= FLAT))
}

/// The direction of a vector; `None` of no length. Scaled first, so that no square is lost.
fn unit(vector: DVec3) -> Option<DVec3> {
    let largest = vector.abs().max_element();
    (largest > 0.0).then(|| (vector / largest).normalize())
}
