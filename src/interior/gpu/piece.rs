//! A triangle taken apart, for the invocations of the pass.

use core::ops::Range;

use super::super::{
    lattice::{SEAL_UNITS, UNITS},
    overlap::Snapped,
};

/// Lattice points of a piece. Sums over as many fit into the 32 bits that the shader has for them.
const MOST_POINTS: i64 = 256;

/// A triangle, and lattice points whose steps it may be in the way of; mirrors the shader's `Piece`.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(super) struct Piece {
    corners: [[i32; 3]; 3],
    first: [i32; 3],
    last: [i32; 3],
    is_two_sided: u32,
}

impl Piece {
    /// Calls for each piece of a triangle that has points in the layers.
    pub(super) fn each(
        triangle: &Snapped,
        is_two_sided: bool,
        layers: &Range<i32>,
        found: &mut impl FnMut(Self),
    ) {
        // The box around a step reaches from its point by the seal downwards, and by that and a spacing upwards. What
        // touches, overlaps.
        let mut first = triangle
            .least
            .map(|least| (least - SEAL_UNITS - UNITS + (UNITS - 1)).div_euclid(UNITS));
        let mut last = triangle
            .greatest
            .map(|greatest| (greatest + SEAL_UNITS).div_euclid(UNITS));
        first[2] = first[2].max(layers.start);
        last[2] = last[2].min(layers.end - 1);
        let whole = Self {
            corners: triangle.corners,
            first,
            last,
            is_two_sided: is_two_sided.into(),
        };
        if (0..3).all(|axis| first[axis] <= last[axis]) {
            whole.divide(triangle, found);
        }
    }

    fn divide(self, triangle: &Snapped, found: &mut impl FnMut(Self)) {
        let size: [i64; 3] =
            core::array::from_fn(|axis| i64::from(self.last[axis] - self.first[axis] + 1));
        if size.iter().product::<i64>() <= MOST_POINTS {
            return found(self);
        }
        let longest = (0..3).max_by_key(|axis| size[*axis]).unwrap_or(0);
        let middle = (self.first[longest] + self.last[longest]).div_euclid(2);
        let (mut low, mut high) = (self, self);
        low.last[longest] = middle;
        high.first[longest] = middle + 1;
        for half in [low, high] {
            if half.is_reached(triangle) {
                half.divide(triangle, found);
            }
        }
    }

    /// Whether the triangle comes near any step of the points.
    fn is_reached(&self, triangle: &Snapped) -> bool {
        let centre =
            core::array::from_fn(|axis| (self.first[axis] + self.last[axis] + 1) * (UNITS / 2));
        let half = core::array::from_fn(|axis| {
            (self.last[axis] - self.first[axis] + 1) * (UNITS / 2) + SEAL_UNITS
        });
        triangle.overlaps(centre, half)
    }
}
