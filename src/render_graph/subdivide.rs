//! `subdivide`: the terrain's bounding box divided on the GPU into tight boxes, once a frame and view.
//!
//! # Inputs / outputs
//! Two node lists that take turns, the list of boxes, and their counts. Each level is one indirect dispatch
//! of as many workgroups as the level before left nodes for.
//!
//! # Limits
//! A child that finds the next list full becomes a box at once (larger, still a bound). Boxes beyond the
//! list's end are counted; the passes after see the count and do without boxes for that frame, and the list
//! grows for the next.
//!
//! # Reference
//! P1 section 3.2.

use bevy::render::render_resource::*;

/// Passes a subdivision can take. As in `boxes.wgsl`.
pub const MAX_PASSES: u32 = 20;
/// Words of the counts: four a pass, then the draw's.
const COUNT_WORDS: usize = 4 * MAX_PASSES as usize + 4;
/// Where in the counts the draw's arguments begin. units: bytes
pub const DRAW_OFFSET: u64 = 4 * 4 * MAX_PASSES as u64;
/// Word of the counts that holds the number of boxes.
pub const BOX_COUNT_WORD: u64 = 4 * MAX_PASSES as u64 + 1;
/// Size of the counts. units: bytes
pub const COUNT_BYTES: u64 = 4 * COUNT_WORDS as u64;

/// What one dispatch of `subdivide` is told. Mirrors `Pass` in `subdivide.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug)]
pub struct GpuSubdividePass {
    pub index: u32,
    pub node_capacity: u32,
}

/// The counts as they are before the first pass: one root, nothing else, and 36 vertices a box.
pub fn initial_counts() -> [u32; COUNT_WORDS] {
    let mut counts = [0; COUNT_WORDS];
    for pass in 0..MAX_PASSES as usize {
        counts[4 * pass + 1] = 1;
        counts[4 * pass + 2] = 1;
    }
    counts[0] = 1;
    counts[3] = 1;
    counts[4 * MAX_PASSES as usize] = 36;
    counts
}
