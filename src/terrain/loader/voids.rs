//! Samples that a file marks as missing.

use bevy::math::UVec2;

use super::{HeightFieldLoadError, settings::HeightFieldNote};
use crate::terrain::height_field::HeightSamples;

/// How often the filled surface is relaxed after the coarse fill: enough to remove the creases of
/// the coarse levels, which are at most a few samples wide at the finest.
const RELAXATIONS: usize = 24;

/// [`VoidHandling`](super::VoidHandling) in the samples' own unit.
pub(super) enum Handling {
    Fill,
    Value { value: f32, height_m: f32 },
    Refuse,
}

/// Gives heights to the samples marked in `voids`, row-major like the samples, or refuses them.
/// An empty `voids` marks none.
pub(super) fn handle(
    size: UVec2,
    samples: &mut HeightSamples,
    voids: &[bool],
    handling: Handling,
) -> Result<Option<HeightFieldNote>, HeightFieldLoadError> {
    let Some(first) = voids.iter().position(|&v| v) else {
        return Ok(None);
    };
    let count = voids.iter().filter(|&&v| v).count();
    if count == voids.len() {
        return Err(HeightFieldLoadError::AllVoid);
    }
    let height_m = match handling {
        Handling::Refuse => {
            return Err(HeightFieldLoadError::Voids {
                count,
                column: (first % size.x as usize) as u32,
                row: (first / size.x as usize) as u32,
            });
        }
        Handling::Value { value, height_m } => {
            set(samples, voids, |_| value);
            Some(height_m)
        }
        Handling::Fill => {
            let filled = match &*samples {
                HeightSamples::U16(codes) => {
                    fill(size, codes.iter().map(|&c| f32::from(c)).collect(), voids)
                }
                HeightSamples::F32(heights) => fill(size, heights.clone(), voids),
            };
            set(samples, voids, |index| filled[index]);
            None
        }
    };
    Ok(Some(HeightFieldNote::VoidsFilled { count, height_m }))
}

fn set(samples: &mut HeightSamples, voids: &[bool], value: impl Fn(usize) -> f32) {
    let marked = voids.iter().enumerate().filter(|(_, v)| **v);
    match samples {
        // `as` saturates at the ends of the range.
        HeightSamples::U16(codes) => {
            marked.for_each(|(i, _)| codes[i] = value(i).round() as u16);
        }
        HeightSamples::F32(heights) => marked.for_each(|(i, _)| heights[i] = value(i)),
    }
}

/// One level of the push-pull pyramid: averages of what is known.
struct Level {
    width: usize,
    height: usize,
    values: Vec<f32>,
    known: Vec<bool>,
}

/// Fills the marked values from the others, at least one of which is unmarked.
///
/// Push-pull: averages of known values are pushed up a pyramid until nothing is unknown, then each
/// unknown value is pulled from the level above by bilinear interpolation; a few Gauss–Seidel
/// sweeps of Laplace's equation smooth the seams. Every step averages, so that no filled value
/// leaves the range of the known ones, and the order of work is fixed: the same file always gives
/// the same heights.
///
/// # Reference
/// Gortler et al. 1996, *The Lumigraph*, section 3.4.2.
fn fill(size: UVec2, values: Vec<f32>, voids: &[bool]) -> Vec<f32> {
    let mut level = Level {
        width: size.x as usize,
        height: size.y as usize,
        values,
        known: voids.iter().map(|&v| !v).collect(),
    };
    let mut finer = Vec::new();
    while level.known.contains(&false) {
        let coarser = push(&level);
        finer.push(core::mem::replace(&mut level, coarser));
    }
    while let Some(mut fine) = finer.pop() {
        pull(&level, &mut fine);
        level = fine;
    }
    relax(&mut level, voids);
    level.values
}

fn push(fine: &Level) -> Level {
    let (width, height) = (fine.width.div_ceil(2), fine.height.div_ceil(2));
    let mut coarse = Level {
        width,
        height,
        values: vec![0.0; width * height],
        known: vec![false; width * height],
    };
    for z in 0..height {
        for x in 0..width {
            let (mut sum, mut count) = (0.0, 0u32);
            for fine_z in 2 * z..(2 * z + 2).min(fine.height) {
                for fine_x in 2 * x..(2 * x + 2).min(fine.width) {
                    let index = fine_z * fine.width + fine_x;
                    if fine.known[index] {
                        sum += f64::from(fine.values[index]);
                        count += 1;
                    }
                }
            }
            if count > 0 {
                coarse.values[z * width + x] = (sum / f64::from(count)) as f32;
                coarse.known[z * width + x] = true;
            }
        }
    }
    coarse
}

/// Fills what `fine` does not know from `coarse`, which knows everything.
fn pull(coarse: &Level, fine: &mut Level) {
    // A fine sample's centre lies a quarter of a coarse one off its parent's centre.
    let around = |fine: usize, end: usize| {
        let parent = fine / 2;
        let neighbour = if fine.is_multiple_of(2) {
            parent.saturating_sub(1)
        } else {
            (parent + 1).min(end - 1)
        };
        (parent, neighbour)
    };
    for z in 0..fine.height {
        let (z0, z1) = around(z, coarse.height);
        for x in 0..fine.width {
            let index = z * fine.width + x;
            if fine.known[index] {
                continue;
            }
            let (x0, x1) = around(x, coarse.width);
            let at = |x: usize, z: usize| f64::from(coarse.values[z * coarse.width + x]);
            let near = 0.75 * at(x0, z0) + 0.25 * at(x1, z0);
            let far = 0.75 * at(x0, z1) + 0.25 * at(x1, z1);
            fine.values[index] = (0.75 * near + 0.25 * far) as f32;
            fine.known[index] = true;
        }
    }
}

fn relax(level: &mut Level, voids: &[bool]) {
    let (width, height) = (level.width, level.height);
    let marked: Vec<usize> = (0..voids.len()).filter(|&i| voids[i]).collect();
    for _ in 0..RELAXATIONS {
        for &index in &marked {
            let (x, z) = (index % width, index / width);
            let (mut sum, mut count) = (0.0, 0u32);
            let mut add = |neighbour: usize| {
                sum += f64::from(level.values[neighbour]);
                count += 1;
            };
            if x > 0 {
                add(index - 1);
            }
            if x + 1 < width {
                add(index + 1);
            }
            if z > 0 {
                add(index - width);
            }
            if z + 1 < height {
                add(index + width);
            }
            level.values[index] = (sum / f64::from(count)) as f32;
        }
    }
}
