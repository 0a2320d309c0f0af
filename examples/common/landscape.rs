//! The ground of an elevation file, or mountains made of noise, the same on every machine.

use std::{path::Path, thread};

use bevy::prelude::*;
use bevy_skyline::terrain::{
    HeightField, HeightFieldError, HeightFieldLoadError, HeightFieldSettings, read_height_field,
};
use fastnoise_lite::{DomainWarpType, FastNoiseLite, FractalType, NoiseType};

use crate::stage::{NAME, StageError};

/// Side of the square. units: m
const SIDE_M: f32 = 20_480.0;
/// Heights of the lowest and the highest code.
const RANGE_M: (f32, f32) = (0.0, 2_400.0);

/// A file's, else mountains; of 2048 samples a side, or of 512.
pub fn read_or_make(file: Option<&Path>, is_small: bool) -> Result<HeightField, StageError> {
    let Some(path) = file else {
        let samples = if is_small { 512 } else { 2048 };
        return mountains(samples).map_err(StageError::input);
    };
    let settings = HeightFieldSettings::default();
    let (field, notes) = read_height_field(path, &settings).map_err(|error| match error {
        // This one names the file itself.
        HeightFieldLoadError::Read { .. } => StageError::input(error),
        _ => StageError::input(format!("{}: {error}", path.display())),
    })?;
    for note in notes {
        eprintln!("{NAME}: {}: {note}", path.display());
    }
    Ok(field)
}

/// Ridged mountains that rise out of valleys and a rolling plain, about 20 km across.
fn mountains(samples: u32) -> Result<HeightField, HeightFieldError> {
    let noise = Noise::new();
    let side = samples as usize;
    let texel_m = SIDE_M / samples as f32;
    let mut heights_m = vec![0.0; side * side];
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let rows_each = side.div_ceil(threads);
    thread::scope(|scope| {
        for (index, rows) in heights_m.chunks_mut(rows_each * side).enumerate() {
            let noise = &noise;
            scope.spawn(move || {
                for (i, height_m) in rows.iter_mut().enumerate() {
                    let (row, column) = (index * rows_each + i / side, i % side);
                    *height_m = noise.height_m(Vec2::new(column as f32, row as f32) * texel_m);
                }
            });
        }
    });
    HeightField::from_fn(UVec2::splat(samples), texel_m, RANGE_M, |column, row| {
        heights_m[row as usize * side + column as usize]
    })
}

struct Noise {
    /// Bends what lies on straight lines.
    warp: FastNoiseLite,
    /// Where mountains are and where there are none.
    lie: FastNoiseLite,
    ridges: FastNoiseLite,
    hills: FastNoiseLite,
}

impl Noise {
    fn new() -> Self {
        let mut warp = FastNoiseLite::with_seed(7);
        warp.set_domain_warp_type(Some(DomainWarpType::OpenSimplex2));
        warp.set_domain_warp_amp(Some(450.0));
        warp.set_frequency(Some(1.0 / 3_500.0));
        warp.set_fractal_type(Some(FractalType::DomainWarpProgressive));
        warp.set_fractal_octaves(Some(3));
        warp.set_fractal_gain(Some(0.4));
        Self {
            warp,
            lie: fractal(77, 1.0 / 11_000.0, FractalType::FBm, 3, 0.0),
            ridges: fractal(8, 1.0 / 5_600.0, FractalType::Ridged, 9, 0.25),
            hills: fractal(41, 1.0 / 1_500.0, FractalType::FBm, 7, 0.3),
        }
    }

    fn height_m(&self, at: Vec2) -> f32 {
        let (x, z) = self.warp.domain_warp_2d(at.x, at.y);
        let lie = smooth(self.lie.get_noise_2d(x, z) * 1.3 + 0.5);
        let ridges = (0.5 + 0.5 * self.ridges.get_noise_2d(x, z)).clamp(0.0, 1.0);
        let hills = self.hills.get_noise_2d(x, z);
        // Hills soften the valley floors and leave the crests alone.
        let mountains = ridges.powf(1.4);
        150.0
            + 250.0 * lie
            + 110.0 * hills * (1.0 - ridges)
            + 1_700.0 * mountains * (0.10 + 0.90 * lie)
    }
}

fn fractal(
    seed: i32,
    frequency: f32,
    kind: FractalType,
    octaves: i32,
    weighted: f32,
) -> FastNoiseLite {
    let mut noise = FastNoiseLite::with_seed(seed);
    noise.set_noise_type(Some(NoiseType::OpenSimplex2));
    noise.set_frequency(Some(frequency));
    noise.set_fractal_type(Some(kind));
    noise.set_fractal_octaves(Some(octaves));
    noise.set_fractal_gain(Some(0.5));
    noise.set_fractal_lacunarity(Some(2.07));
    noise.set_fractal_weighted_strength(Some(weighted));
    noise
}

fn smooth(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
