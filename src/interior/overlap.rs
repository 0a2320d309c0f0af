//! Whether a triangle and a box along the axes have a point in common, in integers.
//!
//! By the separating axes of Akenine-Möller (*Fast 3D triangle–box overlap testing*, 2001): the three of the box, the
//! triangle's normal, and the products of the box's axes with the triangle's edges. Both are closed: what touches,
//! overlaps. Exact, and right for triangles that are segments or points too, as a normal or an edge of no length
//! separates nothing, and what is left are all the axes that a segment or point needs.

use core::ops::{ControlFlow, RangeInclusive};

use super::lattice::UNITS;

/// A triangle in units of the lattice, with what is asked of it over and over.
#[derive(Clone, Copy, Debug)]
pub struct Snapped {
    /// Its corners. units: units, below 2²⁰
    pub corners: [[i32; 3]; 3],
    /// Least coordinates.
    pub least: [i32; 3],
    /// Greatest coordinates.
    pub greatest: [i32; 3],
    /// Twice its area vector; towards the front. Below 2⁴¹, so that its product with a difference of places is below
    /// 2⁶³.
    pub normal: [i64; 3],
}

/// From an axis, the next two.
const NEXT: [[usize; 2]; 3] = [[1, 2], [2, 0], [0, 1]];

impl Snapped {
    /// Of three snapped corners, counter-clockwise from the front.
    pub fn new(corners: [[i32; 3]; 3]) -> Self {
        let [a, b, c] = corners;
        let along = |from: [i32; 3], to: [i32; 3]| -> [i64; 3] {
            core::array::from_fn(|i| i64::from(to[i] - from[i]))
        };
        let (u, v) = (along(a, b), along(a, c));
        let normal = NEXT.map(|[j, k]| u[j] * v[k] - u[k] * v[j]);
        Self {
            corners,
            least: core::array::from_fn(|i| a[i].min(b[i]).min(c[i])),
            greatest: core::array::from_fn(|i| a[i].max(b[i]).max(c[i])),
            normal,
        }
    }

    /// Whether it overlaps the box with this centre and these half sides. units: units
    pub fn overlaps(&self, centre: [i32; 3], half: [i32; 3]) -> bool {
        (0..3).all(|axis| {
            self.least[axis] <= centre[axis] + half[axis]
                && self.greatest[axis] >= centre[axis] - half[axis]
        }) && self.plane_overlaps(centre, half)
            && (0..3).all(|axis| {
                let [j, k] = NEXT[axis];
                Slab::of_edges(&self.corners, axis, [half[j], half[k]])
                    .iter()
                    .all(|slab| slab.contains(centre[j], centre[k]))
            })
    }

    fn plane_overlaps(&self, centre: [i32; 3], half: [i32; 3]) -> bool {
        let on = &self.corners[0];
        let at: i64 = (0..3)
            .map(|i| self.normal[i] * i64::from(centre[i] - on[i]))
            .sum();
        let reach: i64 = (0..3)
            .map(|i| self.normal[i].abs() * i64::from(half[i]))
            .sum();
        at.abs() <= reach
    }
}

/// Where, in the plane across an axis, the centre of a box may lie without being separated from a triangle by the
/// normal of one of its edges in that plane.
#[derive(Clone, Copy, Debug)]
struct Slab {
    across: [i64; 2],
    least: i64,
    greatest: i64,
}

impl Slab {
    /// Those of the three edges, in the plane of the axes that follow `axis`, for a box with these half sides.
    #[inline]
    fn of_edges(corners: &[[i32; 3]; 3], axis: usize, half: [i32; 2]) -> [Self; 3] {
        let [j, k] = NEXT[axis];
        core::array::from_fn(|edge| {
            let (from, to) = (corners[edge], corners[(edge + 1) % 3]);
            let other = corners[(edge + 2) % 3];
            let across = [i64::from(from[k] - to[k]), i64::from(to[j] - from[j])];
            let place = |corner: [i32; 3]| {
                across[0] * i64::from(corner[j]) + across[1] * i64::from(corner[k])
            };
            let (a, b) = (place(from), place(other));
            let reach = across[0].abs() * i64::from(half[0]) + across[1].abs() * i64::from(half[1]);
            Self {
                across,
                least: a.min(b) - reach,
                greatest: a.max(b) + reach,
            }
        })
    }

    /// Whether it does not separate a box centred there.
    #[inline]
    fn contains(&self, j: i32, k: i32) -> bool {
        let place = self.across[0] * i64::from(j) + self.across[1] * i64::from(k);
        (self.least..=self.greatest).contains(&place)
    }
}

/// Boxes of one kind around the points of a lattice: long along an axis, square across it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Boxes {
    /// The axis that they are long in.
    pub axis: usize,
    /// From a point to its box's centre, along the axis. units: units
    pub shift: i32,
    /// Half sides along the axis and across it. units: units
    pub half_along: i32,
    pub half_across: i32,
}

/// The boxes of a row of points along an axis that a triangle comes near.
pub(super) struct Run<'a> {
    boxes: &'a Boxes,
    /// The row: the points' coordinates along the next two axes.
    across: [i32; 2],
    /// The points' coordinates along the axis; others' boxes don't overlap.
    pub along: RangeInclusive<i32>,
    slabs: &'a [[Slab; 3]; 2],
}

impl Run<'_> {
    /// The point that is so far along.
    #[inline]
    pub fn point(&self, along: i32) -> [u32; 3] {
        let [j, k] = NEXT[self.boxes.axis];
        let mut point = [0; 3];
        point[self.boxes.axis] = along as u32;
        point[j] = self.across[0] as u32;
        point[k] = self.across[1] as u32;
        point
    }

    /// Whether the box of a point of the run overlaps the triangle.
    #[inline]
    pub fn overlaps(&self, along: i32) -> bool {
        let at = along * UNITS + self.boxes.shift;
        let [j, k] = self.across.map(|across| across * UNITS);
        // Across the next axis come the one after it and ours; across that, ours and the next.
        let [across_j, across_k] = self.slabs;
        across_j.iter().all(|slab| slab.contains(k, at))
            && across_k.iter().all(|slab| slab.contains(at, j))
    }
}

impl Boxes {
    /// Calls for each row in which boxes may overlap a triangle, until told to break. Coordinates may lie beyond a
    /// lattice where a box reaches farther than its margin.
    #[inline]
    pub fn overlapping<B>(
        &self,
        triangle: &Snapped,
        mut found: impl FnMut(Run) -> ControlFlow<B>,
    ) -> ControlFlow<B> {
        let (least, greatest) = (&triangle.least, &triangle.greatest);
        let (axis, [j, k]) = (self.axis, NEXT[self.axis]);
        let (half, thin) = (self.half_along, self.half_across);
        let in_j = points_between(least[j] - thin, greatest[j] + thin);
        let in_k = points_between(least[k] - thin, greatest[k] + thin);
        if in_j.is_empty() || in_k.is_empty() {
            return ControlFlow::Continue(());
        }
        let in_axis = points_between(
            least[axis] - half - self.shift,
            greatest[axis] + half - self.shift,
        );
        let corners = &triangle.corners;
        let across = Slab::of_edges(corners, axis, [thin; 2]);
        let slabs = [
            Slab::of_edges(corners, j, [thin, half]),
            Slab::of_edges(corners, k, [half, thin]),
        ];
        let (normal, on) = (&triangle.normal, &corners[0]);
        let reach = normal[axis].abs() * i64::from(half)
            + (normal[j].abs() + normal[k].abs()) * i64::from(thin);
        for at_k in in_k {
            for at_j in in_j.clone() {
                let (pj, pk) = (at_j * UNITS, at_k * UNITS);
                if !across.iter().all(|slab| slab.contains(pj, pk)) {
                    continue;
                }
                // Where, from the corner, a box's centre may be for the triangle's plane to meet the box.
                let rest = normal[j] * i64::from(on[j] - pj) + normal[k] * i64::from(on[k] - pk);
                let Some((low, high)) = places(normal[axis], rest, reach) else {
                    continue;
                };
                let from = i64::from(on[axis] - self.shift);
                let first = ceil_point(low.saturating_add(from)).max(i64::from(*in_axis.start()));
                let last = floor_point(high.saturating_add(from)).min(i64::from(*in_axis.end()));
                if first > last {
                    continue;
                }
                found(Run {
                    boxes: self,
                    across: [at_j, at_k],
                    along: first as i32..=last as i32,
                    slabs: &slabs,
                })?;
            }
        }
        ControlFlow::Continue(())
    }
}

/// Points between two places along an axis.
#[inline]
fn points_between(least: i32, greatest: i32) -> RangeInclusive<i32> {
    ceil_point(i64::from(least)) as i32..=floor_point(i64::from(greatest)) as i32
}

#[inline]
fn ceil_point(place: i64) -> i64 {
    place
        .saturating_add(i64::from(UNITS - 1))
        .div_euclid(i64::from(UNITS))
}

#[inline]
fn floor_point(place: i64) -> i64 {
    place.div_euclid(i64::from(UNITS))
}

/// The least and the greatest `x` with |`slope` · x − `rest`| ≤ `reach`; `None` if there are none.
#[inline]
fn places(slope: i64, rest: i64, reach: i64) -> Option<(i64, i64)> {
    if slope == 0 {
        return (rest.abs() <= reach).then_some((i64::MIN, i64::MAX));
    }
    let (slope, rest) = if slope < 0 {
        (-slope, -rest)
    } else {
        (slope, rest)
    };
    let low = -(reach - rest).div_euclid(slope);
    let high = (reach + rest).div_euclid(slope);
    (low <= high).then_some((low, high))
}
