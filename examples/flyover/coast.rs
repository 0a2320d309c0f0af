//! An island made of noise, the same on every machine: a bay, a plain behind it that a city has room on, mountains all
//! around the plain.

use std::thread;

use bevy::prelude::*;
use bevy_skyline::terrain::{HeightField, HeightFieldError};
use fastnoise_lite::{DomainWarpType, FastNoiseLite, FractalType, NoiseType};

/// Samples a side.
const SAMPLES: u32 = 2048;
/// Metres between samples.
const TEXEL_M: f32 = 7.0;
/// Heights of the lowest and the highest code.
const RANGE_M: (f32, f32) = (-90.0, 1_900.0);
/// Side of the field. units: m
const SIDE_M: f32 = SAMPLES as f32 * TEXEL_M;

/// The island, about 12 km across, in the sea at height 0. The bay opens toward +Z.
pub fn island() -> Result<HeightField, HeightFieldError> {
    let noise = Noise::new();
    let mut heights_m = vec![0.0; (SAMPLES * SAMPLES) as usize];
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let rows_each = (SAMPLES as usize).div_ceil(threads);
    thread::scope(|scope| {
        for (index, rows) in heights_m
            .chunks_mut(rows_each * SAMPLES as usize)
            .enumerate()
        {
            let noise = &noise;
            scope.spawn(move || {
                for (i, height_m) in rows.iter_mut().enumerate() {
                    let (row, column) = (
                        index * rows_each + i / SAMPLES as usize,
                        i % SAMPLES as usize,
                    );
                    *height_m = noise.height_m(Vec2::new(column as f32, row as f32) * TEXEL_M);
                }
            });
        }
    });
    HeightField::from_fn(UVec2::splat(SAMPLES), TEXEL_M, RANGE_M, |column, row| {
        heights_m[(row * SAMPLES + column) as usize]
    })
}

struct Noise {
    /// Bends what lies on straight lines.
    warp: FastNoiseLite,
    /// How far the shore lies out.
    shore: FastNoiseLite,
    ridges: FastNoiseLite,
    hills: FastNoiseLite,
}

impl Noise {
    fn new() -> Self {
        let mut warp = FastNoiseLite::with_seed(7);
        warp.set_domain_warp_type(Some(DomainWarpType::OpenSimplex2));
        warp.set_domain_warp_amp(Some(380.0));
        warp.set_frequency(Some(1.0 / 2_600.0));
        warp.set_fractal_type(Some(FractalType::DomainWarpProgressive));
        warp.set_fractal_octaves(Some(3));
        warp.set_fractal_gain(Some(0.4));
        Self {
            warp,
            shore: fractal(77, 1.0 / 3_000.0, FractalType::FBm, 5, 0.0),
            ridges: fractal(8, 1.0 / 4_200.0, FractalType::Ridged, 9, 0.25),
            hills: fractal(41, 1.0 / 1_300.0, FractalType::FBm, 6, 0.3),
        }
    }

    fn height_m(&self, at: Vec2) -> f32 {
        let (x, z) = self.warp.domain_warp_2d(at.x, at.y);
        let bent = Vec2::new(x, z);
        // Half bent: the shore winds less than the ridges.
        let place = (0.5 * (at + bent)) / SIDE_M;
        let shore = 700.0 * self.shore.get_noise_2d(at.x, at.y);
        let island = 0.42 * SIDE_M - place.distance(Vec2::new(0.5, 0.48)) * SIDE_M;
        let bay = (place - Vec2::new(0.5, 0.96)) * Vec2::new(0.8, 1.0);
        let bay = bay.length() * SIDE_M - 2_500.0;
        // Way to the shore, positive on land. units: m
        let inland = smooth_min(island, bay, 900.0) + shore;
        // Where the plain is.
        let plain = (place - Vec2::new(0.5, 0.66)) * Vec2::new(0.62, 1.0) * SIDE_M;
        let plain = 1.0 - smooth(1_300.0, 2_900.0, plain.length() - 0.6 * shore);
        let mountains = smooth(150.0, 3_000.0, inland) * (1.0 - plain);
        let ridges = (0.5 + 0.5 * self.ridges.get_noise_2d(bent.x, bent.y)).clamp(0.0, 1.0);
        let hills = self.hills.get_noise_2d(bent.x, bent.y);
        if inland < 0.0 {
            return (0.06 * inland - 1.0).max(-80.0 + 4.0 * hills);
        }
        // A beach, then land that rises slowly.
        let land = 0.03 * inland.min(120.0) + 0.011 * (inland - 120.0).max(0.0) - 1.0;
        let rolling = 26.0 * (hills + 0.35) * smooth(150.0, 1_600.0, inland) * (1.0 - 0.7 * plain);
        land + rolling.max(0.0) + mountains * (60.0 + 60.0 * hills + 1_600.0 * ridges.powf(1.6))
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

/// 0 up to `from`, 1 from `to` on, without a kink.
pub fn smooth(from: f32, to: f32, x: f32) -> f32 {
    let x = ((x - from) / (to - from)).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// The less of two, rounded off where they differ by less than `width`.
fn smooth_min(a: f32, b: f32, width: f32) -> f32 {
    let share = (0.5 + 0.5 * (b - a) / width).clamp(0.0, 1.0);
    b + (a - b) * share - width * share * (1.0 - share)
}
