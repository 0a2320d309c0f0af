//! What is measured when no file is given, and from where any field is looked at.

use bevy::math::{DVec2, DVec3, UVec2, Vec2};

use crate::terrain::{HeightField, HeightFieldError};

/// Heights of the built-in field. units: m
const RANGE_M: (f32, f32) = (0.0, 3_000.0);
/// How far it reaches, whatever the number of samples. units: m
const EXTENT_M: f32 = 30_720.0;

/// A range of mountains over a plain, `samples` a side: the same on every machine.
///
/// # Errors
/// Fewer than two samples.
pub fn mountains(samples: u32) -> Result<HeightField, HeightFieldError> {
    let per_sample = 6.0 / samples.max(2) as f32;
    let texel_m = EXTENT_M / samples.saturating_sub(1).max(1) as f32;
    HeightField::from_fn(UVec2::splat(samples), texel_m, RANGE_M, |column, row| {
        let at = Vec2::new(column as f32, row as f32) * per_sample;
        let lie = 0.5 + 0.5 * fractal(at * 0.5 + 31.7, 3, |n| n);
        let ridges = fractal(at, 9, |n| 1.0 - 2.0 * n.abs());
        let rough = fractal(at * 2.0 + 7.3, 8, |n| n);
        let mountains = (0.55 + 0.45 * ridges).clamp(0.0, 1.0).powi(2);
        RANGE_M.1 * (0.12 * lie + 0.85 * lie * mountains + 0.04 * rough)
    })
}

/// What terrain and shadows are measured on.
pub struct Ground {
    /// The heights.
    pub field: HeightField,
    /// What it is called in results.
    pub name: String,
}

impl Ground {
    /// The [`mountains`] that a run without a file takes.
    ///
    /// # Errors
    /// None that is known.
    pub fn made_by_code(quick: bool, of_shadow: bool) -> Result<Self, HeightFieldError> {
        let samples = match of_shadow {
            _ if quick => 257,
            false => 1025,
            true => 4096,
        };
        Ok(Self {
            field: mountains(samples)?,
            name: "made_by_code".to_owned(),
        })
    }
}

/// Octaves of value noise, each half as large and twice as fine as the one before, within ±1.
pub(in crate::offline) fn fractal(at: Vec2, octaves: u32, shape: impl Fn(f32) -> f32) -> f32 {
    let (mut sum, mut weight, mut scale) = (0.0, 0.5, 1.0);
    for octave in 0..octaves {
        sum += weight * shape(value_noise(at * scale, octave));
        weight *= 0.5;
        scale *= 2.03;
    }
    sum
}

/// Random values at whole points, smoothly joined; within ±1.
fn value_noise(at: Vec2, seed: u32) -> f32 {
    let cell = at.floor();
    let part = at - cell;
    let smooth = part * part * part * (part * (part * 6.0 - 15.0) + 10.0);
    let value = |x: f32, y: f32| lattice((cell.x + x) as i32, (cell.y + y) as i32, seed);
    let near = value(0.0, 0.0) + (value(1.0, 0.0) - value(0.0, 0.0)) * smooth.x;
    let far = value(0.0, 1.0) + (value(1.0, 1.0) - value(0.0, 1.0)) * smooth.x;
    near + (far - near) * smooth.y
}

/// A random number within ±1 for each whole point.
pub(in crate::offline) fn lattice(x: i32, y: i32, seed: u32) -> f32 {
    let mut hash = (x as u32).wrapping_mul(0x9e37_79b1)
        ^ (y as u32).wrapping_mul(0x85eb_ca77)
        ^ seed.wrapping_mul(0xc2b2_ae3d);
    hash = (hash ^ (hash >> 15)).wrapping_mul(0x2c1b_3c6d);
    hash = (hash ^ (hash >> 12)).wrapping_mul(0x297a_2d39);
    hash ^= hash >> 15;
    (hash >> 8) as f32 / (1u32 << 23) as f32 - 1.0
}

/// Where a field is looked at from.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// For file names and tables.
    pub name: &'static str,
    /// In words.
    pub what: &'static str,
    /// units: m
    pub eye: DVec3,
    /// units: m
    pub target: DVec3,
}

/// A low view to the horizon and a high view down, over any field.
pub fn views(field: &HeightField) -> [View; 2] {
    let extent = field.extent_m().as_dvec2();
    let (lowest, highest) = field.data_range_m();
    let range = highest - lowest;
    let ground = |at: DVec2| field.height_at_f64(at).unwrap_or(highest);
    let longer = extent.max_element();
    let low_eye = extent * DVec2::new(0.366, 0.731);
    let low_target = extent * DVec2::new(0.61, 0.244);
    let above = (0.67 * range).max(ground(low_eye) - lowest + 0.08 * range + 0.002 * longer);
    let high_eye = extent * DVec2::new(0.5, 0.61);
    let high_target = extent * DVec2::new(0.5, 0.488);
    let at = |xz: DVec2, y: f64| DVec3::new(xz.x, y, xz.y);
    [
        View {
            name: "low",
            what: "low, to the horizon",
            eye: at(low_eye, lowest + above),
            target: at(
                low_target,
                lowest + above - (0.283 * range).max(0.01 * longer),
            ),
        },
        View {
            name: "high",
            what: "high, down",
            eye: at(high_eye, highest + 0.125 * longer),
            target: at(high_target, lowest),
        },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mountains_fill_their_range_without_being_cut_off() {
        let field = mountains(257).expect("a field can be made");
        let (lowest, highest) = field.data_range_m();
        assert!(lowest > 0.0 && highest < 2_999.0, "{lowest} to {highest}");
        assert!(highest - lowest > 1_200.0, "{lowest} to {highest}");
    }

    #[test]
    fn views_start_above_the_ground_whatever_the_field() {
        for field in [
            mountains(129).expect("a field can be made"),
            HeightField::from_f32(UVec2::new(2, 2), 0.001, vec![5.0; 4])
                .expect("a field can be made"),
            HeightField::from_f32(UVec2::new(3, 200), 10.0, vec![-50.0; 600])
                .expect("a field can be made"),
        ] {
            for view in views(&field) {
                let ground = field.height_at_f64(DVec2::new(view.eye.x, view.eye.z));
                assert!(
                    ground.is_some_and(|ground| view.eye.y > ground),
                    "{field:?} {view:?}"
                );
                assert_ne!(view.eye, view.target);
            }
        }
    }
}
