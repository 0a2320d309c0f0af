//! A frame's depth, reduced to one depth a block of pixels and to a pyramid above them.
//!
//! Depth is reverse-Z, NDC z/w: 1 on the near plane, 0 infinitely far away and where nothing was drawn. Farthest is
//! the minimum.

use bevy::prelude::*;
use bytemuck::{Pod, Zeroable};

use super::DepthSampling;

/// Most pixels along a side of a viewport. What the tests allow for rounding holds up to here.
pub const MOST_SIDE_PX: u32 = 16_384;

/// Most levels of a pyramid: enough for [`MOST_SIDE_PX`] in blocks of one pixel.
pub const MOST_LEVELS: usize = 16;
/// Side of the largest block. units: px
pub const MOST_BLOCK: u32 = 64;
/// Blocks that `Conservative { block: 0 }` reads back at most: 4 MB, and a third more for the levels above.
const MOST_FINE_BLOCKS: u64 = 1_000_000;

/// One level of a pyramid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DepthLevel {
    /// Columns and rows of texels.
    pub size: UVec2,
    /// Index of its first texel; the others follow row by row from the top left.
    pub first: u32,
}

/// The depth of one view, reduced, and the camera that made it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReducedDepth {
    /// Of the camera, at that frame. Any projection to reverse-Z clip space.
    pub clip_from_world: Mat4,
    /// Size of the viewport, whole. units: px, range: 1..=[`MOST_SIDE_PX`]
    pub viewport: Vec2,
    /// Size of the block of pixels that a texel of level 0 stands for. units: px
    pub block: UVec2,
    /// Whether a texel of level 0 is its block's top left pixel alone ([`DepthSampling::Strided`]) instead of the
    /// farthest of them all.
    pub strided: bool,
    /// As [`layout`] has them.
    pub levels: Vec<DepthLevel>,
    /// All levels' texels, level 0 first. Those outside 0..=1 count as infinitely far away.
    pub texels: Vec<f32>,
}

/// Why no depth could be reduced.
#[derive(thiserror::Error, Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum DepthError {
    /// The viewport is empty or too large.
    #[error("a viewport of {0} pixels cannot be reduced: use 1 to {MOST_SIDE_PX} a side")]
    Viewport(UVec2),
    /// There is not one depth a pixel.
    #[error("a viewport of {viewport} pixels needs as many depths, and {count} were given")]
    Pixels {
        /// Size of the viewport.
        viewport: UVec2,
        /// How many there are.
        count: usize,
    },
}

/// The levels of the pyramid over a viewport: level 0 has a texel a block, blocks at the right and bottom being cut;
/// every other level has half the columns and rows of the one before, rounded up; the last has one texel.
pub fn layout(viewport: UVec2, block: UVec2) -> Vec<DepthLevel> {
    let mut levels = Vec::with_capacity(MOST_LEVELS);
    let mut size = UVec2::new(
        viewport.x.div_ceil(block.x.max(1)),
        viewport.y.div_ceil(block.y.max(1)),
    )
    .max(UVec2::ONE);
    let mut first = 0u32;
    loop {
        levels.push(DepthLevel { size, first });
        if size == UVec2::ONE {
            return levels;
        }
        first = first.saturating_add(size.x.saturating_mul(size.y));
        size = UVec2::new(size.x.div_ceil(2), size.y.div_ceil(2));
    }
}

/// How many texels [`layout`] has, without making it.
pub fn room_for(viewport: UVec2, block: UVec2) -> usize {
    let halved = |size: UVec2| size.map(|side| side.div_ceil(2));
    let first = UVec2::new(
        viewport.x.div_ceil(block.x.max(1)),
        viewport.y.div_ceil(block.y.max(1)),
    )
    .max(UVec2::ONE);
    core::iter::successors(Some(first), |size| {
        (*size != UVec2::ONE).then(|| halved(*size))
    })
    .map(|size| size.x as usize * size.y as usize)
    .sum()
}

/// How many texels all levels have together.
pub fn texel_count(levels: &[DepthLevel]) -> usize {
    let texels = |level: &DepthLevel| level.size.x as usize * level.size.y as usize;
    levels.iter().map(texels).sum()
}

impl DepthSampling {
    /// The block of pixels that a texel stands for in a viewport, settings outside their range drawn into it. units: px
    pub fn block(self, viewport: UVec2) -> UVec2 {
        match self {
            Self::Conservative { block: 0 } => (1..=MOST_BLOCK)
                .map(UVec2::splat)
                .find(|block| {
                    let [x, y] = [0, 1].map(|axis| viewport[axis].div_ceil(block[axis]));
                    u64::from(x) * u64::from(y) <= MOST_FINE_BLOCKS
                })
                .unwrap_or(UVec2::splat(MOST_BLOCK)),
            Self::Conservative { block } => UVec2::splat(block),
            Self::Strided { x, y } => UVec2::new(x, y),
        }
        .clamp(UVec2::ONE, UVec2::splat(MOST_BLOCK))
    }

    /// The same with the block chosen that a viewport asks for, so that it stays when less of the viewport is drawn.
    pub fn for_viewport(self, viewport: UVec2) -> Self {
        match self {
            Self::Conservative { block: 0 } => Self::Conservative {
                block: self.block(viewport).x,
            },
            chosen => chosen,
        }
    }

    /// What is wrong with it, in words, and what is done instead; `None` if nothing is.
    pub fn complaint(self) -> Option<String> {
        let (least, sides) = match self {
            Self::Conservative { block } => (0, [block, block]),
            Self::Strided { x, y } => (1, [x, y]),
        };
        let wrong = sides
            .into_iter()
            .find(|side| !(least..=MOST_BLOCK).contains(side))?;
        let used = wrong.clamp(1, MOST_BLOCK);
        Some(format!(
            "the sampling's {wrong} px is not within {least}..={MOST_BLOCK}: {used} px is used"
        ))
    }

    /// Whether one pixel of a block is read instead of all.
    pub fn is_strided(self) -> bool {
        matches!(self, Self::Strided { .. })
    }
}

impl ReducedDepth {
    /// Reduces a whole depth buffer, row by row from the top left, as the GPU does. Depths outside 0..=1 and NaN
    /// count as infinitely far away.
    ///
    /// # Errors
    /// [`DepthError`].
    pub fn from_pixels(
        clip_from_world: Mat4,
        viewport: UVec2,
        sampling: DepthSampling,
        pixels: &[f32],
    ) -> Result<Self, DepthError> {
        if viewport.min_element() == 0 || viewport.max_element() > MOST_SIDE_PX {
            return Err(DepthError::Viewport(viewport));
        }
        if pixels.len() != viewport.x as usize * viewport.y as usize {
            return Err(DepthError::Pixels {
                viewport,
                count: pixels.len(),
            });
        }
        let block = sampling.block(viewport);
        let strided = sampling.is_strided();
        let levels = layout(viewport, block);
        let mut texels = Vec::with_capacity(texel_count(&levels));
        let read = if strided { UVec2::ONE } else { block };
        let base = levels[0].size;
        for j in 0..base.y {
            for i in 0..base.x {
                let corner = UVec2::new(i, j) * block;
                let end = (corner + read).min(viewport);
                let mut farthest = 1.0f32;
                for y in corner.y..end.y {
                    let row = y as usize * viewport.x as usize;
                    for &depth in &pixels[row + corner.x as usize..row + end.x as usize] {
                        let valid = (0.0..=1.0).contains(&depth);
                        farthest = farthest.min(if valid { depth } else { 0.0 });
                    }
                }
                texels.push(farthest);
            }
        }
        for pair in levels.windows(2) {
            let (below, above) = (pair[0], pair[1]);
            for j in 0..above.size.y {
                for i in 0..above.size.x {
                    let low = UVec2::new(i, j) * 2;
                    let high = (low + 1).min(below.size - 1);
                    let at = |x: u32, y: u32| texels[(below.first + y * below.size.x + x) as usize];
                    let farthest = at(low.x, low.y)
                        .min(at(high.x, low.y))
                        .min(at(low.x, high.y))
                        .min(at(high.x, high.y));
                    texels.push(farthest);
                }
            }
        }
        Ok(Self {
            clip_from_world,
            viewport: viewport.as_vec2(),
            block,
            strided,
            levels,
            texels,
        })
    }

    /// Everything but the texels, of a view whose depth is reduced on the GPU. A viewport that is empty or larger than
    /// [`MOST_SIDE_PX`] has no levels.
    pub fn header(clip_from_world: Mat4, viewport: UVec2, sampling: DepthSampling) -> Self {
        let fits = viewport.min_element() > 0 && viewport.max_element() <= MOST_SIDE_PX;
        Self {
            clip_from_world,
            viewport: viewport.as_vec2(),
            block: sampling.block(viewport),
            strided: sampling.is_strided(),
            levels: if fits {
                layout(viewport, sampling.block(viewport))
            } else {
                Vec::new()
            },
            texels: Vec::new(),
        }
    }

    /// Takes over everything but the texels, which stay, as memory to be filled.
    pub fn clone_header_from(&mut self, header: &Self) {
        let Self {
            clip_from_world,
            viewport,
            block,
            strided,
            levels,
            texels: _,
        } = header;
        (self.clip_from_world, self.viewport) = (*clip_from_world, *viewport);
        (self.block, self.strided) = (*block, *strided);
        self.levels.clone_from(levels);
    }

    /// Whether sizes, levels and texels fit together, so that something can be tested against them.
    pub fn is_consistent(&self) -> bool {
        let viewport = self.viewport.as_uvec2();
        viewport.as_vec2() == self.viewport
            && viewport.min_element() > 0
            && viewport.max_element() <= MOST_SIDE_PX
            && self.block.min_element() > 0
            && self.levels == layout(viewport, self.block)
            && self.texels.len() == texel_count(&self.levels)
    }
}

/// All of a [`ReducedDepth`] but its texels. Mirrors `OcclusionView` in `occludee.wgsl`.
///
/// Bind it as a storage buffer: it bounds loops, and some drivers compile anew for every value of a uniform that does.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct GpuOcclusionView {
    /// Column by column.
    pub clip_from_world: [[f32; 4]; 4],
    /// units: px
    pub viewport: [f32; 2],
    /// units: px
    pub block: [u32; 2],
    /// 1 if strided.
    pub strided: u32,
    /// How many levels there are; with 0 everything is visible.
    pub level_count: u32,
    /// Top left pixel of the viewport in the depth texture; only the reduction looks at it. units: px
    pub origin: [u32; 2],
    /// First texel, columns, rows, 0.
    pub level: [[u32; 4]; MOST_LEVELS],
}

impl GpuOcclusionView {
    /// Of a view whose depth is reduced on the GPU: everything but `header`'s texels is looked at. `origin` is the
    /// viewport's top left pixel in the depth texture.
    pub fn of_header(header: &ReducedDepth, origin: UVec2) -> Self {
        let mut level = [[0; 4]; MOST_LEVELS];
        for (gpu, cpu) in level.iter_mut().zip(&header.levels) {
            *gpu = [cpu.first, cpu.size.x, cpu.size.y, 0];
        }
        Self {
            clip_from_world: header.clip_from_world.to_cols_array_2d(),
            viewport: header.viewport.to_array(),
            block: header.block.max(UVec2::ONE).to_array(),
            strided: u32::from(header.strided),
            level_count: header.levels.len() as u32,
            origin: origin.to_array(),
            level,
        }
    }
}

impl From<&ReducedDepth> for GpuOcclusionView {
    /// Without levels if the depth is not [consistent](ReducedDepth::is_consistent): then all is visible.
    fn from(depth: &ReducedDepth) -> Self {
        let view = Self::of_header(depth, UVec2::ZERO);
        if depth.is_consistent() {
            return view;
        }
        Self {
            level_count: 0,
            level: [[0; 4]; MOST_LEVELS],
            ..view
        }
    }
}
