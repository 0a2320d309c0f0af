//! The max/min pyramid over the cells of a [`HeightField`](super::HeightField).

use bevy::{
    math::{URect, UVec2},
    reflect::Reflect,
};

use super::height_field::HeightSamples;

/// Upper and lower bounds of the surface over squares of 2ᵏ×2ᵏ cells, for every k from 1 up to
/// the single node that covers the whole field.
///
/// Level k's node (i, j) covers the cells `[i·2ᵏ, (i+1)·2ᵏ) × [j·2ᵏ, (j+1)·2ᵏ)`, clipped to the
/// field, that is the samples `[i·2ᵏ ..= (i+1)·2ᵏ]` of both axes: its max and min **include the
/// samples shared with the neighbours to the right and below**. A bilinear patch lies between the
/// extremes of its four corners, so a node bounds the surface over its square exactly, borders
/// included. The bounds are attained, not merely safe: nothing is rounded.
///
/// Level 0, the cells themselves, is not stored: it follows from the samples.
///
/// # Inputs / outputs
/// Level k has ⌈cells / 2ᵏ⌉ nodes an axis. All levels lie in one buffer, level 1 first, each
/// row-major without padding. The GPU buffer that the `height_mips` pass fills is the same, node
/// for node, which is what lets the two be compared as integers.
///
/// # Limits
/// A 16-bit field costs 4 bytes a node, that is 1⅓ bytes a sample on top of the sample's 2.
///
/// # Reference
/// Tevs, Ihrke and Seidel 2008, *Maximum Mipmaps for Fast, Accurate, and Scalable Dynamic Height
/// Field Rendering*; the paper stores sample maxima, here they are cell maxima.
#[derive(Reflect, Clone, PartialEq)]
#[reflect(opaque)]
#[reflect(Clone, Debug, PartialEq)]
pub struct MinMaxPyramid {
    cells: UVec2,
    /// `(offset, size)` of level k at k − 1.
    levels: Vec<(usize, UVec2)>,
    nodes: PyramidNodes,
}

/// The nodes of a [`MinMaxPyramid`], in the layout that the GPU reads.
#[derive(Reflect, Clone, Debug, PartialEq)]
pub enum PyramidNodes {
    /// Height codes: the maximum in the high half, the minimum in the low half.
    U16(Vec<u32>),
    /// Metres: `[max, min]`.
    F32(Vec<[f32; 2]>),
}

impl core::fmt::Debug for MinMaxPyramid {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("MinMaxPyramid")
            .field("cells", &self.cells)
            .field("levels", &self.levels())
            .field("top", &self.top())
            .finish_non_exhaustive()
    }
}

impl MinMaxPyramid {
    /// Builds every level. `size` is in samples, at least 2×2, and matches `samples`.
    pub(super) fn build(size: UVec2, samples: &HeightSamples) -> Self {
        let cells = size - UVec2::ONE;
        let (levels, node_count) = layout(cells);
        let mut pyramid = Self {
            cells,
            levels,
            nodes: match samples {
                HeightSamples::U16(_) => PyramidNodes::U16(vec![0; node_count]),
                HeightSamples::F32(_) => PyramidNodes::F32(vec![[0.0; 2]; node_count]),
            },
        };
        pyramid.update(
            samples,
            URect {
                min: UVec2::ZERO,
                max: size,
            },
        );
        pyramid
    }

    /// Recomputes the nodes above the samples in `rect` (maximum exclusive), and no others.
    ///
    /// `rect` lies inside the field; an empty one changes nothing.
    pub(super) fn update(&mut self, samples: &HeightSamples, rect: URect) {
        if rect.is_empty() {
            return;
        }
        let width = self.cells.x as usize + 1;
        for level in 1..=self.levels() {
            let affected = self.affected_nodes(level, rect);
            let (offset, size) = self.levels[level as usize - 1];
            match (&mut self.nodes, samples) {
                (PyramidNodes::U16(nodes), HeightSamples::U16(samples)) => {
                    if level == 1 {
                        reduce_samples(samples, width, nodes, size.x as usize, affected);
                    } else {
                        let (below, below_size) = self.levels[level as usize - 2];
                        reduce_nodes(nodes, below, below_size, offset, size, affected);
                    }
                }
                (PyramidNodes::F32(nodes), HeightSamples::F32(samples)) => {
                    if level == 1 {
                        reduce_samples(samples, width, nodes, size.x as usize, affected);
                    } else {
                        let (below, below_size) = self.levels[level as usize - 2];
                        reduce_nodes(nodes, below, below_size, offset, size, affected);
                    }
                }
                // A height field never changes its kind of samples.
                _ => unreachable!("the pyramid and the samples are of one kind"),
            }
        }
    }

    /// The field's size in cells.
    pub fn cells(&self) -> UVec2 {
        self.cells
    }

    /// The number of stored levels L, at least 1: level L is one node over everything.
    pub fn levels(&self) -> u32 {
        self.levels.len() as u32
    }

    /// Where level `level` starts in [`nodes`](Self::nodes), in nodes.
    ///
    /// # Panics
    /// If `level` is not in `1..=self.levels()`, as do the other accessors by level.
    pub fn level_offset(&self, level: u32) -> usize {
        self.levels[level as usize - 1].0
    }

    /// Level `level`'s size in nodes: ⌈cells / 2^level⌉.
    pub fn level_size(&self, level: u32) -> UVec2 {
        self.levels[level as usize - 1].1
    }

    /// All nodes, level by level, row-major.
    pub fn nodes(&self) -> &PyramidNodes {
        &self.nodes
    }

    /// The number of nodes of all levels together.
    pub fn node_count(&self) -> usize {
        match &self.nodes {
            PyramidNodes::U16(nodes) => nodes.len(),
            PyramidNodes::F32(nodes) => nodes.len(),
        }
    }

    /// `(max, min)` of the surface over node (i, j) of `level`, in grid heights: codes for 16-bit
    /// `(max, min)` of the surface over node (i, j) of `level`, in grid heights: codes for 16-bit
    /// samples, metres for floats.
    ///
    /// # Panics
    /// If there is no such node.
    pub fn get(&self, level: u32, i: u32, j: u32) -> (f64, f64) {
        let (offset, size) = self.levels[level as usize - 1];
        assert!(i < size.x && j < size.y, "node ({i}, {j}) of {size}");
        let index = offset + j as usize * size.x as usize + i as usize;
        match &self.nodes {
            PyramidNodes::U16(nodes) => {
                let node = nodes[index];
                (f64::from(node >> 16), f64::from(node & 0xffff))
            }
            PyramidNodes::F32(nodes) => {
                let [max, min] = nodes[index];
                (f64::from(max), f64::from(min))
            }
        }
    }

    /// `(max, min)` of the whole surface, in grid heights.
    pub fn top(&self) -> (f64, f64) {
        self.get(self.levels(), 0, 0)
    }

    /// The nodes of `level` whose bounds depend on the samples in `rect` (both maxima exclusive):
    /// what an edit of `rect` makes stale.
    pub fn affected_nodes(&self, level: u32, rect: URect) -> URect {
        let size = self.level_size(level);
        if rect.is_empty() {
            return URect {
                min: UVec2::ZERO,
                max: UVec2::ZERO,
            };
        }
        // Sample x belongs to node i where i·2ᵏ ≤ x ≤ (i+1)·2ᵏ: two nodes where 2ᵏ divides x.
        let first = UVec2::new(
            rect.min.x.saturating_sub(1) >> level,
            rect.min.y.saturating_sub(1) >> level,
        );
        let last = UVec2::new((rect.max.x - 1) >> level, (rect.max.y - 1) >> level);
        URect {
            min: first.min(size - UVec2::ONE),
            max: (last + UVec2::ONE).min(size),
        }
    }
}

/// Offsets and sizes of the levels over `cells`, and the number of nodes of all of them.
fn layout(cells: UVec2) -> (Vec<(usize, UVec2)>, usize) {
    let mut levels = Vec::new();
    let mut offset = 0;
    let mut size = cells;
    loop {
        size = UVec2::new(size.x.div_ceil(2), size.y.div_ceil(2));
        levels.push((offset, size));
        offset += size.x as usize * size.y as usize;
        if size == UVec2::ONE {
            return (levels, offset);
        }
    }
}

/// A stored sample: ordered, free of NaN.
trait Sample: Copy + PartialOrd {
    type Node: Node<Sample = Self>;
}

/// A stored pair of bounds.
trait Node: Copy {
    type Sample: Copy;
    fn new(max: Self::Sample, min: Self::Sample) -> Self;
    fn max(self) -> Self::Sample;
    fn min(self) -> Self::Sample;
}

impl Sample for u16 {
    type Node = u32;
}

impl Sample for f32 {
    type Node = [f32; 2];
}

impl Node for u32 {
    type Sample = u16;
    #[inline(always)]
    fn new(max: u16, min: u16) -> Self {
        (max as u32) << 16 | min as u32
    }
    #[inline(always)]
    fn max(self) -> u16 {
        (self >> 16) as u16
    }
    #[inline(always)]
    fn min(self) -> u16 {
        self as u16
    }
}

impl Node for [f32; 2] {
    type Sample = f32;
    #[inline(always)]
    fn new(max: f32, min: f32) -> Self {
        [max, min]
    }
    #[inline(always)]
    fn max(self) -> f32 {
        self[0]
    }
    #[inline(always)]
    fn min(self) -> f32 {
        self[1]
    }
}

// Not `Ord::max` or `f32::max`: samples hold no NaN, and this is one instruction for both kinds.
#[inline(always)]
fn larger<T: PartialOrd + Copy>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

#[inline(always)]
fn smaller<T: PartialOrd + Copy>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

/// Level 1 from the samples: node (i, j) bounds the samples 2i ..= 2i+2 × 2j ..= 2j+2, clipped.
///
/// Each column's extremes over the three rows are taken once: node i's last column is node i+1's
/// first.
fn reduce_samples<S: Sample>(
    samples: &[S],
    width: usize,
    nodes: &mut [S::Node],
    nodes_width: usize,
    affected: URect,
) {
    let height = samples.len() / width;
    let (first, end) = (affected.min.x as usize, affected.max.x as usize);
    for j in affected.min.y as usize..affected.max.y as usize {
        // Level 1 has ⌈cells / 2⌉ rows, so 2j + 1 is a sample's row; 2j + 2 may be one too many.
        let row0 = &samples[2 * j * width..][..width];
        let row1 = &samples[(2 * j + 1) * width..][..width];
        let row2 = &samples[(2 * j + 2).min(height - 1) * width..][..width];
        let out = &mut nodes[j * nodes_width..][..nodes_width];

        let column_max = |x: usize| larger(larger(row0[x], row1[x]), row2[x]);
        let column_min = |x: usize| smaller(smaller(row0[x], row1[x]), row2[x]);

        let mut max = column_max(2 * first);
        let mut min = column_min(2 * first);
        for (i, node) in out.iter_mut().enumerate().take(end).skip(first) {
            let middle = 2 * i + 1;
            let last = (2 * i + 2).min(width - 1);
            let (last_max, last_min) = (column_max(last), column_min(last));
            *node = S::Node::new(
                larger(larger(max, column_max(middle)), last_max),
                smaller(smaller(min, column_min(middle)), last_min),
            );
            (max, min) = (last_max, last_min);
        }
    }
}

/// A level k ≥ 2 from the level below, whose nodes already hold the shared samples: node (i, j)
/// bounds the nodes 2i, 2i+1 × 2j, 2j+1, clipped.
fn reduce_nodes<N: Node<Sample: PartialOrd>>(
    nodes: &mut [N],
    below: usize,
    below_size: UVec2,
    offset: usize,
    size: UVec2,
    affected: URect,
) {
    let (lower, upper) = nodes.split_at_mut(offset);
    let below_width = below_size.x as usize;
    for j in affected.min.y as usize..affected.max.y as usize {
        let row0 = &lower[below + 2 * j * below_width..][..below_width];
        let row1 = (2 * j + 1).min(below_size.y as usize - 1);
        let row1 = &lower[below + row1 * below_width..][..below_width];
        let out = &mut upper[j * size.x as usize..][..size.x as usize];
        for i in affected.min.x as usize..affected.max.x as usize {
            let right = (2 * i + 1).min(below_width - 1);
            let (a, b, c, d) = (row0[2 * i], row0[right], row1[2 * i], row1[right]);
            out[i] = N::new(
                larger(larger(a.max(), b.max()), larger(c.max(), d.max())),
                smaller(smaller(a.min(), b.min()), smaller(c.min(), d.min())),
            );
        }
    }
}
