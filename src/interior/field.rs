//! The directed distance field: for every step from a point of the lattice to a neighbour, whether a surface is in the
//! way.
//!
//! A triangle is in the way of a step if it comes within [`SEAL`](super::SEAL) spacings of it in every axis; a one-sided
//! one only if the step does not come from behind it. The answer is exact in the lattice's integers: the same from
//! every device, in whatever order triangles come.

use core::{
    ops::ControlFlow,
    sync::atomic::{AtomicU64, Ordering},
};

use super::{
    lattice::{Lattice, SEAL_UNITS, UNITS},
    overlap::{Boxes, Snapped},
};

/// One bit for each point of a lattice, in rows along x that start at a word.
pub(super) type Words = Vec<u64>;

/// See the [module](self). The step between a point and the next one along an axis has its bit at the lower of the two.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Steps up x, y, z.
    pub(super) up: [Words; 3],
    /// Steps down x, y, z, back to the point that has the bit; the same as up where nothing is one-sided.
    pub(super) down: Option<[Words; 3]>,
}

impl Field {
    /// Of triangles, two-sided if their entry says so. `is_one_sided`: whether steps up and down are told apart.
    pub fn of(
        lattice: &Lattice,
        triangles: impl IntoIterator<Item = (Snapped, bool)>,
        is_one_sided: bool,
    ) -> Self {
        let field = SharedField::new(lattice, is_one_sided);
        for (triangle, is_two_sided) in triangles {
            field.block(lattice, &triangle, is_two_sided);
        }
        field.into_field()
    }

    /// Nothing is in the way.
    pub(super) fn empty(lattice: &Lattice, is_one_sided: bool) -> Self {
        let all = || core::array::from_fn(|_| vec![0; lattice.rows() * lattice.words]);
        Self {
            up: all(),
            down: is_one_sided.then(all),
        }
    }

    /// Whether a surface is in the way of the step up `axis` from a point.
    pub fn is_blocked_up(&self, lattice: &Lattice, point: [u32; 3], axis: usize) -> bool {
        is_set(&self.up[axis], lattice, point)
    }

    /// Whether a surface is in the way of the step down `axis` that leads to a point.
    pub fn is_blocked_down(&self, lattice: &Lattice, point: [u32; 3], axis: usize) -> bool {
        is_set(&self.down()[axis], lattice, point)
    }

    pub(super) fn down(&self) -> &[Words; 3] {
        self.down.as_ref().unwrap_or(&self.up)
    }
}

pub(super) fn is_set(words: &[u64], lattice: &Lattice, [x, y, z]: [u32; 3]) -> bool {
    words[lattice.row(y, z) + (x / 64) as usize] >> (x % 64) & 1 == 1
}

/// A field that several threads write to.
#[derive(Debug)]
pub(super) struct SharedField {
    up: [Vec<AtomicU64>; 3],
    down: Option<[Vec<AtomicU64>; 3]>,
}

impl SharedField {
    pub(super) fn new(lattice: &Lattice, one_sided: bool) -> Self {
        let words = lattice.rows() * lattice.words;
        let bits = || (0..words).map(|_| AtomicU64::new(0)).collect();
        let all = || [bits(), bits(), bits()];
        Self {
            up: all(),
            down: one_sided.then(all),
        }
    }

    pub(super) fn into_field(self) -> Field {
        let plain = |all: [Vec<AtomicU64>; 3]| {
            all.map(|bits| bits.into_iter().map(AtomicU64::into_inner).collect())
        };
        Field {
            up: plain(self.up),
            down: self.down.map(plain),
        }
    }

    /// A triangle blocks the steps that it is in the way of.
    pub(super) fn block(&self, lattice: &Lattice, triangle: &Snapped, is_two_sided: bool) {
        for axis in 0..3 {
            // Its front looks up the axis, down it, or along.
            let faces = if is_two_sided {
                0
            } else {
                triangle.normal[axis].signum()
            };
            let up = (faces <= 0).then_some(&self.up[axis]);
            let down = match &self.down {
                Some(down) => (faces >= 0).then_some(&down[axis]),
                None => None,
            };
            for_steps(triangle, axis, |[x, y, z]| {
                let word = lattice.row(y, z) + (x / 64) as usize;
                let bit = 1 << (x % 64);
                for bits in [up, down].into_iter().flatten() {
                    // Most bits that are set are set by more than one triangle.
                    if bits[word].load(Ordering::Relaxed) & bit == 0 {
                        bits[word].fetch_or(bit, Ordering::Relaxed);
                    }
                }
            });
        }
    }
}

/// Calls for each step up `axis` that a triangle is in the way of, with the point it starts from.
#[inline]
pub(super) fn for_steps(triangle: &Snapped, axis: usize, mut found: impl FnMut([u32; 3])) {
    let boxes = Boxes {
        axis,
        shift: UNITS / 2,
        half_along: UNITS / 2 + SEAL_UNITS,
        half_across: SEAL_UNITS,
    };
    let _ = boxes.overlapping(triangle, |run| {
        for at in run.along.clone() {
            if run.overlaps(at) {
                found(run.point(at));
            }
        }
        ControlFlow::<()>::Continue(())
    });
}
