//! Front propagation: which points of the lattice can be come to from outside.
//!
//! P5a takes points off the front one by one, as fast marching does; the result is what is connected with the outermost
//! points by steps that nothing blocks, in whatever order. Here a row along x is taken at a time, 64 points a word.

use super::{
    error::InteriorError,
    field::{Field, Words, is_set},
    lattice::Lattice,
    progress::Progress,
};

/// The points that are outside.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outside {
    pub(super) words: Words,
}

impl Outside {
    /// Whether a point is.
    pub fn contains(&self, lattice: &Lattice, point: [u32; 3]) -> bool {
        is_set(&self.words, lattice, point)
    }

    /// How many points are.
    pub fn count(&self) -> u64 {
        self.words
            .iter()
            .map(|word| u64::from(word.count_ones()))
            .sum()
    }
}

/// Moves the front in from the outermost points, until nothing is left to come to.
///
/// # Errors
/// Stopped.
pub fn propagate(
    lattice: &Lattice,
    field: &Field,
    progress: &Progress,
) -> Result<Outside, InteriorError> {
    let [size_x, size_y, size_z] = lattice.size;
    let in_row = lattice.words;
    let mut outside = vec![0u64; lattice.rows() * in_row];
    let mut front = Front::new(lattice);
    // Steps that leave the lattice are in no bit; the last word of a row has bits beyond it.
    let row_mask: Vec<u64> = (0..in_row)
        .map(|word| {
            let left = size_x as usize - word * 64;
            if left >= 64 {
                u64::MAX
            } else {
                (1 << left) - 1
            }
        })
        .collect();
    let (first, last) = (1u64, 1u64 << ((size_x - 1) % 64));
    for z in 0..size_z {
        for y in 0..size_y {
            let row = lattice.row(y, z);
            if y == 0 || z == 0 || y == size_y - 1 || z == size_z - 1 {
                outside[row..row + in_row].copy_from_slice(&row_mask);
            } else {
                outside[row] |= first;
                outside[row + in_row - 1] |= last;
            }
            front.join(lattice, [y, z]);
        }
    }
    let (up, down) = (&field.up, field.down());
    let mut taken = 0;
    while let Some([y, z]) = front.take(lattice) {
        taken += 1;
        if taken % 4096 == 0 {
            progress.advance(4096);
            if progress.is_cancelled() {
                return Err(InteriorError::Cancelled);
            }
        }
        let row = lattice.row(y, z);
        let span = row..row + in_row;
        spread(
            &mut outside[span.clone()],
            &up[0][span.clone()],
            &down[0][span.clone()],
            &row_mask,
        );
        // Up the axis the step's bit is in this row, down it in the row that it leads to.
        let steps = [
            (y + 1 < size_y).then(|| ([y + 1, z], &up[1][span.clone()])),
            (y > 0).then(|| ([y - 1, z], &down[1][beside(lattice, y - 1, z)])),
            (z + 1 < size_z).then(|| ([y, z + 1], &up[2][span.clone()])),
            (z > 0).then(|| ([y, z - 1], &down[2][beside(lattice, y, z - 1)])),
        ];
        for (to, blocked) in steps.into_iter().flatten() {
            let start = lattice.row(to[0], to[1]);
            let mut is_new = 0;
            for word in 0..in_row {
                let new = outside[row + word] & !blocked[word] & !outside[start + word];
                outside[start + word] |= new;
                is_new |= new;
            }
            if is_new != 0 {
                front.join(lattice, to);
            }
        }
    }
    Ok(Outside { words: outside })
}

fn beside(lattice: &Lattice, y: u32, z: u32) -> core::ops::Range<usize> {
    let row = lattice.row(y, z);
    row..row + lattice.words
}

/// Takes a front along its row, both ways, until it is blocked. One pass each way does: what a step back comes to lies
/// between points that the first pass had.
fn spread(outside: &mut [u64], blocked_up: &[u64], blocked_down: &[u64], mask: &[u64]) {
    let mut carry = 0;
    for ((outside, blocked), mask) in outside.iter_mut().zip(blocked_up).zip(mask) {
        // Bit i of `free`: from point i − 1 to i. The step into the first comes with the carry.
        let free = !blocked << 1;
        let mut points = *outside | carry;
        let mut passes = free;
        for by in [1, 2, 4, 8, 16, 32] {
            points |= passes & (points << by);
            passes &= passes << by;
        }
        points &= mask;
        *outside = points;
        carry = (points & !blocked) >> 63;
    }
    let mut carry = 0;
    for (outside, blocked) in outside.iter_mut().zip(blocked_down).rev() {
        // Bit i of `free`: from point i + 1 to i. The step into the last, from the next word's first, is in its bit 63.
        let free = !blocked;
        let mut points = *outside | (carry << 63 & free);
        let mut passes = free & (u64::MAX >> 1);
        for by in [1, 2, 4, 8, 16, 32] {
            points |= passes & (points >> by);
            passes &= passes >> by;
        }
        *outside = points;
        carry = points & 1;
    }
}

/// Rows that have points of the front, each at most once; first in, first out.
struct Front {
    queue: std::collections::VecDeque<[u32; 2]>,
    is_in: Vec<bool>,
}

impl Front {
    fn new(lattice: &Lattice) -> Self {
        Self {
            queue: std::collections::VecDeque::with_capacity(lattice.rows()),
            is_in: vec![false; lattice.rows()],
        }
    }

    fn join(&mut self, lattice: &Lattice, row: [u32; 2]) {
        let number = row[1] as usize * lattice.size[1] as usize + row[0] as usize;
        if !core::mem::replace(&mut self.is_in[number], true) {
            self.queue.push_back(row);
        }
    }

    fn take(&mut self, lattice: &Lattice) -> Option<[u32; 2]> {
        let row = self.queue.pop_front()?;
        self.is_in[row[1] as usize * lattice.size[1] as usize + row[0] as usize] = false;
        Some(row)
    }
}
