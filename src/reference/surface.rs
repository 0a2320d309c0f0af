//! The bilinear surface of a height field, in `f64` and as stored: what all twins of terrain passes look at.

use bevy::math::UVec2;

use super::{cell::Patch, guard::Steepness};
use crate::terrain::HeightSamples;

/// The samples of a height field, cell by cell.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    samples: &'a HeightSamples,
    width: usize,
    /// Columns and rows of cells: one less than of samples.
    pub cells: UVec2,
}

impl<'a> Surface<'a> {
    /// `size` is in samples, at least 2×2, and `samples` has as many.
    pub fn new(samples: &'a HeightSamples, size: UVec2) -> Self {
        Self {
            samples,
            width: size.x as usize,
            cells: size - 1,
        }
    }

    /// Height of a sample.
    pub fn height(&self, i: usize, j: usize) -> f64 {
        let index = j * self.width + i;
        match self.samples {
            HeightSamples::U16(samples) => f64::from(samples[index]),
            HeightSamples::F32(samples) => f64::from(samples[index]),
        }
    }

    /// The surface over one cell, heights relative to `anchor_y`.
    pub fn patch(&self, cell: UVec2, anchor_y: f64) -> Patch {
        let (i, j) = (cell.x as usize, cell.y as usize);
        let corners = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)];
        Patch {
            corners: corners.map(|(i, j)| self.height(i, j) - anchor_y),
        }
    }

    /// Steepest slopes of the 3×3 cells around one, and largest height relative to `anchor_y`.
    pub fn steepness(&self, cell: UVec2, anchor_y: f64) -> Steepness {
        let low = cell.saturating_sub(UVec2::ONE);
        let high = (cell + 2).min(self.cells);
        let mut near = Steepness::default();
        for j in low.y as usize..=high.y as usize {
            for i in low.x as usize..=high.x as usize {
                let height = self.height(i, j);
                near.height = near.height.max((height - anchor_y).abs());
                if i < high.x as usize {
                    near.x = near.x.max((self.height(i + 1, j) - height).abs());
                }
                if j < high.y as usize {
                    near.z = near.z.max((self.height(i, j + 1) - height).abs());
                }
            }
        }
        near
    }

    /// Steepest slopes of all cells; its height is 0.
    pub fn steepest(&self) -> Steepness {
        match self.samples {
            HeightSamples::U16(samples) => steepest(samples, self.width),
            HeightSamples::F32(samples) => steepest(samples, self.width),
        }
    }

    /// Lowest and highest sample.
    pub fn range(&self) -> (f64, f64) {
        match self.samples {
            HeightSamples::U16(samples) => range(samples),
            HeightSamples::F32(samples) => range(samples),
        }
    }
}

/// Largest differences between neighbouring samples.
fn steepest<T: Copy + Into<f64>>(samples: &[T], width: usize) -> Steepness {
    let mut steepest = Steepness::default();
    let mut previous: Option<&[T]> = None;
    for row in samples.chunks_exact(width) {
        for pair in row.windows(2) {
            steepest.x = steepest.x.max((pair[1].into() - pair[0].into()).abs());
        }
        if let Some(previous) = previous {
            for (&a, &b) in previous.iter().zip(row) {
                steepest.z = steepest.z.max((b.into() - a.into()).abs());
            }
        }
        previous = Some(row);
    }
    steepest
}

fn range<T: Copy + Into<f64>>(samples: &[T]) -> (f64, f64) {
    samples.iter().fold(
        (f64::INFINITY, f64::NEG_INFINITY),
        |(low, high), &height| (low.min(height.into()), high.max(height.into())),
    )
}
