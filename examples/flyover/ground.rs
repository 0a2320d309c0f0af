//! The colours of the ground: sea floor, beach, grass, woods, rock and snow by height and slope, and the city's streets.

use std::{collections::HashSet, thread};

use bevy::prelude::*;
use bevy_skyline::terrain::HeightField;
use fastnoise_lite::{FastNoiseLite, FractalType, NoiseType};

use super::{
    coast::smooth,
    site::{BLOCK_M, PITCH_M, Site},
    texture::{Texels, bytes, image},
};

/// The most texels a side.
const MOST_TEXELS: u32 = 4096;

/// An image to lay over the field.
pub fn colours(field: &HeightField, painter: &Painter) -> Image {
    let cells = field.cells().max_element();
    let side = (2 * cells).next_power_of_two().clamp(256, MOST_TEXELS);
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let rows_each = (side as usize).div_ceil(threads);
    let mut texels = vec![0; (side * side) as usize * 4];
    thread::scope(|scope| {
        for (index, rows) in texels.chunks_mut(rows_each * side as usize * 4).enumerate() {
            scope.spawn(move || {
                for (i, texel) in rows.chunks_exact_mut(4).enumerate() {
                    let row = index * rows_each + i / side as usize;
                    let place = Vec2::new((i % side as usize) as f32, row as f32) + 0.5;
                    let at = place / side as f32 * painter.extent;
                    texel.copy_from_slice(&bytes(painter.colour(at)));
                }
            });
        }
    });
    image(UVec2::splat(side), Texels::Colour, texels, false)
}

/// Knows what grows and lies where.
pub struct Painter<'a> {
    field: &'a HeightField,
    site: &'a Site,
    blocks: HashSet<IVec2>,
    extent: Vec2,
    /// Where snow begins. units: m
    snow_m: f32,
    patches: FastNoiseLite,
}

impl<'a> Painter<'a> {
    pub fn new(field: &'a HeightField, site: &'a Site) -> Self {
        let mut patches = FastNoiseLite::with_seed(5);
        patches.set_noise_type(Some(NoiseType::OpenSimplex2));
        patches.set_fractal_type(Some(FractalType::FBm));
        patches.set_fractal_octaves(Some(4));
        patches.set_frequency(Some(1.0 / 420.0));
        Self {
            field,
            site,
            blocks: site.blocks.iter().map(|block| block.index).collect(),
            extent: field.extent_m(),
            snow_m: 0.56 * field.data_range_m().1 as f32,
            patches,
        }
    }

    fn colour(&self, at: Vec2) -> LinearRgba {
        let (height, slope, patch) = self.lie(at);
        let wild = self.wild(height, slope, patch);
        match self.street(at) {
            Some((paved, town)) => wild.mix(&paved, town),
            None => wild,
        }
    }

    /// Height, rise over run, and a number of 0 to 1 that differs from patch to patch.
    fn lie(&self, at: Vec2) -> (f32, f32, f32) {
        let inside = at.clamp(Vec2::ZERO, self.extent);
        let height = self.field.height_at(inside).unwrap_or(0.0);
        let up = self.field.normal_at(inside).map_or(1.0, |normal| normal.y);
        let slope = (1.0 - up * up).max(0.0).sqrt() / up.max(1e-3);
        (
            height,
            slope,
            0.5 + 0.5 * self.patches.get_noise_2d(at.x, at.y),
        )
    }

    /// How thickly trees stand at a place; none in the city.
    pub fn woods(&self, at: Vec2) -> f32 {
        let (height, slope, patch) = self.lie(at);
        if height < 5.0 || slope > 0.75 || self.street(at).is_some() {
            return 0.0;
        }
        self.wooded(height, patch) + 0.04
    }

    fn wooded(&self, height: f32, patch: f32) -> f32 {
        smooth(0.42, 0.62, patch + 0.25 * smooth(60.0, 300.0, height))
            * (1.0 - smooth(0.62, 0.85, height / self.snow_m))
    }

    /// The land as it would be without people.
    fn wild(&self, height: f32, slope: f32, patch: f32) -> LinearRgba {
        let deep = LinearRgba::rgb(0.020, 0.060, 0.065);
        let sand = LinearRgba::rgb(0.48, 0.39, 0.25);
        if height < 0.0 {
            return sand.mix(&deep, smooth(0.0, -22.0, height));
        }
        let meadow =
            LinearRgba::rgb(0.105, 0.135, 0.032).mix(&LinearRgba::rgb(0.20, 0.18, 0.062), patch);
        let wood =
            LinearRgba::rgb(0.020, 0.048, 0.014).mix(&LinearRgba::rgb(0.045, 0.075, 0.02), patch);
        let rock =
            LinearRgba::rgb(0.125, 0.10, 0.08).mix(&LinearRgba::rgb(0.22, 0.19, 0.16), patch);
        let snow = LinearRgba::rgb(0.86, 0.89, 0.94);
        let mut colour = meadow.mix(&wood, self.wooded(height, patch));
        let alpine = smooth(0.55, 0.85, height / self.snow_m);
        colour = colour.mix(&LinearRgba::rgb(0.17, 0.155, 0.085), 0.7 * alpine);
        colour = colour.mix(&rock, smooth(0.62, 1.0, slope + 0.25 * (patch - 0.5)));
        let snowed = smooth(
            -0.10,
            0.10,
            height / self.snow_m - 1.0 + 0.22 * (patch - 0.5),
        ) * (1.0 - 0.9 * smooth(0.95, 1.7, slope));
        colour = colour.mix(&snow, snowed);
        colour.mix(
            &sand,
            smooth(4.0, 2.2, height) * (1.0 - smooth(0.25, 0.5, slope)),
        )
    }

    /// What people have made of a place in the city, and how much of it shows.
    fn street(&self, at: Vec2) -> Option<(LinearRgba, f32)> {
        let local = self.site.local(at);
        let index = (local / PITCH_M).round();
        let block = index.as_ivec2();
        let inside = (local - index * PITCH_M).abs() - 0.5 * BLOCK_M;
        // A street has the block that it belongs to on either side of it.
        let built = |block: IVec2| self.blocks.contains(&block);
        if !built(block) {
            let near = [IVec2::X, IVec2::NEG_X, IVec2::Y, IVec2::NEG_Y];
            let edge = inside.max_element() > 0.0 && near.iter().any(|way| built(block + *way));
            return edge.then(|| (asphalt(), 0.5));
        }
        let out = inside.max_element();
        let colour = if out > 3.2 {
            asphalt()
        } else if out > 0.0 {
            LinearRgba::gray(0.21)
        } else {
            let patch = 0.5 + 0.5 * self.patches.get_noise_2d(9.0 * at.x, 9.0 * at.y);
            LinearRgba::rgb(0.16, 0.15, 0.125).mix(&LinearRgba::rgb(0.09, 0.12, 0.04), patch)
        };
        Some((colour, 1.0))
    }
}

fn asphalt() -> LinearRgba {
    LinearRgba::rgb(0.062, 0.062, 0.066)
}
