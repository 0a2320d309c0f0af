//! `f64` twin of [interior culling](crate::interior): each step of the lattice and each triangle on its own, point by
//! point; and the ball of [what is guaranteed](crate::interior#what-is-guaranteed).
//!
//! What the integers of [`overlap`](crate::interior::overlap) decide exactly, this decides by another way, by clipping,
//! and in `f64`: within [`BAND`] it says that it cannot tell.

use std::collections::VecDeque;

use bevy::math::DVec3;

use crate::interior::{
    InteriorCulling, InteriorFaces, InteriorTransparent, Model,
    lattice::{Lattice, REACH_UNITS, SEAL_UNITS, UNITS},
};

/// Boxes larger and smaller by so much must agree for an answer. Clipping a triangle with coordinates below 2²⁰ units
/// makes up to six new corners one from the other, each off by some 2²⁰ · 2⁻⁵³ = 2⁻³³ units for the crossing itself and as much
/// for what came before: below 2⁻²⁹. units: units
pub const BAND: f64 = 1e-6;

/// A triangle of a model in a lattice's units, and how it hides.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// Counter-clockwise from the front. units: units
    pub corners: [DVec3; 3],
    /// Number of its part in the model, and its own in the part.
    pub number: (usize, usize),
    /// Lets see what is behind it.
    pub is_open: bool,
    /// Hides from behind too.
    pub is_two_sided: bool,
}

/// All triangles of a model, snapped.
pub fn triangles(model: &Model, settings: &InteriorCulling, lattice: &Lattice) -> Vec<Triangle> {
    let mut all = Vec::new();
    for (part_number, part) in model.parts.iter().enumerate() {
        let is_mirrored = part.model_from_local.matrix3.determinant() < 0.0;
        for (number, triangle) in part.surface.triangles.iter().enumerate() {
            let corners = triangle.map(|index| {
                let position = part.surface.positions[index as usize].map(f64::from);
                let placed = part
                    .model_from_local
                    .transform_point3(DVec3::from_array(position));
                ((placed - lattice.origin) / lattice.spacing * f64::from(UNITS)).round()
            });
            let [a, b, c] = corners;
            all.push(Triangle {
                corners: if is_mirrored { [a, c, b] } else { [a, b, c] },
                number: (part_number, number),
                is_open: part.is_transparent && settings.transparent == InteriorTransparent::Open,
                is_two_sided: part.is_two_sided || settings.faces == InteriorFaces::TwoSided,
            });
        }
    }
    all
}

/// Whether a surface is in the way of a step from a point up or down an axis; `None` if it is too close to tell.
pub fn is_blocked(
    triangles: &[Triangle],
    from: [u32; 3],
    axis: usize,
    is_up: bool,
) -> Option<bool> {
    let mut way = DVec3::ZERO;
    way[axis] = if is_up { 1.0 } else { -1.0 };
    let start = place(from);
    let centre = start + way * f64::from(UNITS) / 2.0;
    let mut half = DVec3::splat(f64::from(SEAL_UNITS));
    half[axis] += f64::from(UNITS) / 2.0;
    any(triangles.iter().map(|triangle| {
        let [a, b, c] = triangle.corners;
        // Differences and their products are integers, below 2⁴¹: exact.
        let leaves_through_its_back = (b - a).cross(c - a).dot(way) > 0.0;
        if triangle.is_open || (leaves_through_its_back && !triangle.is_two_sided) {
            Some(false)
        } else {
            overlaps(triangle, centre, half)
        }
    }))
}

/// Whether a triangle comes near enough to any of the points to be seen; `None` if it is too close to tell.
pub fn is_near(triangle: &Triangle, points: impl Iterator<Item = [u32; 3]>) -> Option<bool> {
    let half = DVec3::splat(f64::from(REACH_UNITS));
    any(points.map(|point| overlaps(triangle, place(point), half)))
}

/// The points that can be come to from the outermost ones, one after another.
pub fn outside(lattice: &Lattice, is_blocked: impl Fn([u32; 3], usize, bool) -> bool) -> Vec<bool> {
    let size = lattice.size;
    let number = |[x, y, z]: [u32; 3]| ((z * size[1] + y) * size[0] + x) as usize;
    let mut outside = vec![false; number([0, 0, size[2]])];
    let mut front = VecDeque::new();
    for point in points(lattice) {
        if (0..3).any(|axis| point[axis] == 0 || point[axis] == size[axis] - 1) {
            outside[number(point)] = true;
            front.push_back(point);
        }
    }
    while let Some(point) = front.pop_front() {
        for (axis, is_up) in (0..3).flat_map(|axis| [(axis, true), (axis, false)]) {
            let is_last = point[axis] == if is_up { size[axis] - 1 } else { 0 };
            if is_last || is_blocked(point, axis, is_up) {
                continue;
            }
            let mut next = point;
            next[axis] = if is_up {
                next[axis] + 1
            } else {
                next[axis] - 1
            };
            if !core::mem::replace(&mut outside[number(next)], true) {
                front.push_back(next);
            }
        }
    }
    outside
}

/// All points of a lattice, x fastest.
pub fn points(lattice: &Lattice) -> impl Iterator<Item = [u32; 3]> + use<> {
    let [sx, sy, sz] = lattice.size;
    (0..sz).flat_map(move |z| (0..sy).flat_map(move |y| (0..sx).map(move |x| [x, y, z])))
}

/// From a point to the nearest of a triangle (Ericson, *Real-Time Collision Detection*, 2005, §5.1.5).
pub fn distance(point: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let (ab, ac, ap) = (b - a, c - a, point - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return ap.length();
    }
    let bp = point - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return bp.length();
    }
    let cp = point - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return cp.length();
    }
    let to_edge = |from: DVec3, along: DVec3| {
        let whole = along.length_squared();
        let t = if whole > 0.0 {
            ((point - from).dot(along) / whole).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (point - from - along * t).length()
    };
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    let whole = va + vb + vc;
    if va > 0.0 && vb > 0.0 && vc > 0.0 && whole > 0.0 {
        return (ap - ab * (vb / whole) - ac * (vc / whole)).length();
    }
    to_edge(a, ab).min(to_edge(a, ac)).min(to_edge(b, c - b))
}

fn place(point: [u32; 3]) -> DVec3 {
    DVec3::from_array(point.map(f64::from)) * f64::from(UNITS)
}

/// Whether any is; `None` if none is and some cannot be told.
fn any(all: impl Iterator<Item = Option<bool>>) -> Option<bool> {
    let mut answer = Some(false);
    for one in all {
        match one {
            Some(true) => return Some(true),
            Some(false) => {}
            None => answer = None,
        }
    }
    answer
}

/// Whether a triangle and a box have a point in common, the box a little larger or a little smaller alike.
fn overlaps(triangle: &Triangle, centre: DVec3, half: DVec3) -> Option<bool> {
    let with = |by: f64| is_left_by_clipping(triangle, centre, half + DVec3::splat(by));
    let (larger, smaller) = (with(BAND), with(-BAND));
    (larger == smaller).then_some(larger)
}

/// Whether anything is left of a triangle, clipped by a box's six sides one after the other (Sutherland and Hodgman 1974).
fn is_left_by_clipping(triangle: &Triangle, centre: DVec3, half: DVec3) -> bool {
    let mut polygon = triangle.corners.to_vec();
    let mut clipped = Vec::with_capacity(9);
    for (axis, sign) in (0..3).flat_map(|axis| [(axis, 1.0), (axis, -1.0)]) {
        clipped.clear();
        let inside = |corner: DVec3| half[axis] - sign * (corner - centre)[axis];
        for (at, from) in polygon.iter().copied().enumerate() {
            let to = polygon[(at + 1) % polygon.len()];
            let (a, b) = (inside(from), inside(to));
            if a >= 0.0 {
                clipped.push(from);
            }
            if (a < 0.0) != (b < 0.0) {
                clipped.push(from + (to - from) * (a / (a - b)));
            }
        }
        core::mem::swap(&mut polygon, &mut clipped);
    }
    !polygon.is_empty()
}
