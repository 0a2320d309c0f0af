//! P5b's own lighting beside Bevy's: the same view, the same hits and the same shadow map.
//!
//! Left, Blinn–Phong as in the paper: lit at the samples ("per vertex") and interpolated over each cell,
//! colour = base × (ambient + seen × diffuse) + seen × specular, on display values as its fixed function did.
//! Right, what the renderer draws.

use bevy::{
    light::DirectionalLight,
    math::{DMat3, DVec2, DVec3},
    prelude::*,
};

use crate::{
    offline::{
        OfflineError,
        accuracy::{AccuracyError, scene::views},
        render::{Shot, Stage, Sun},
        shadow::ShadowImage,
    },
    terrain::HeightField,
    terrain_shadow::TerrainShadow,
};

/// Of each of the two pictures. units: px
const SIZE: UVec2 = UVec2::new(480, 270);
const GAP: u32 = 6;
const SUN: Sun = Sun {
    azimuth_deg: 235.0,
    elevation_deg: 16.0,
};
/// Frames to wait for the shadow map, and then for what of it is still coarse.
const MOST_FRAMES: u32 = 60;
const LAST_FRAMES: u32 = 6;

const AMBIENT: f64 = 0.35;
const DIFFUSE: f64 = 0.85;
const SPECULAR: f64 = 0.12;
const SHININESS: i32 = 24;
const SKY: [f64; 3] = [0.66, 0.77, 0.88];
/// Dark green, light green, brown and white, and where each begins as a share of the heights.
const COLOURS: [(f64, [f64; 3]); 4] = [
    (0.0, [0.10, 0.34, 0.12]),
    (0.18, [0.47, 0.66, 0.30]),
    (0.45, [0.50, 0.37, 0.24]),
    (0.78, [0.96, 0.96, 0.97]),
];

/// Both pictures of a field side by side.
///
/// # Errors
/// [`AccuracyError::Render`], also if no shadow map shows.
pub(super) fn side_by_side(field: HeightField) -> Result<image::RgbImage, AccuracyError> {
    let [view, _] = views(&field);
    let shot = Shot {
        size: SIZE,
        sun: SUN,
        casting: crate::terrain::TerrainRayCasting {
            max_error_px: 0.0,
            ..default()
        },
        ..Shot::new(view.eye, view.target)
    };
    let mut stage = Stage::new(field.clone(), &shot)?;
    let world = stage.offline.app.world_mut();
    let mut lights = world.query::<(Entity, &mut DirectionalLight)>();
    let mut sun = None;
    for (entity, mut light) in lights.iter_mut(world) {
        light.shadow_maps_enabled = true;
        sun = Some(entity);
    }
    let unlit = || OfflineError::Unsupported("its shadow map does not show".into());
    let sun = sun.ok_or_else(unlit)?;
    world.entity_mut(stage.terrain).insert(TerrainShadow {
        slice_ms: 1e4,
        ..default()
    });
    stage.settle()?;
    let mut map = None;
    for _ in 0..MOST_FRAMES {
        map = stage.offline.shadow_map(stage.terrain, sun)?;
        if map.is_some() {
            break;
        }
        stage.offline.step();
    }
    map.ok_or_else(unlit)?;
    for _ in 0..LAST_FRAMES {
        stage.offline.step();
    }
    let map = stage
        .offline
        .shadow_map(stage.terrain, sun)?
        .ok_or_else(unlit)?;
    let right = stage.picture()?;
    let hits = stage.hits(SIZE)?;
    let rays = stage.offline.view_rays(stage.camera, stage.terrain);
    let ground = Ground::new(&field, &map, shot.eye);
    let axes = DMat3::from_quat(shot.transform().rotation.as_dquat());
    let half = (0.5 * shot.fov_deg.to_radians()).tan();
    let left = image::RgbImage::from_fn(SIZE.x, SIZE.y, |x, y| {
        let depth = rays.as_ref().map_or(f64::INFINITY, |rays| {
            rays.view_depth(hits.ndc_depth[(y * SIZE.x + x) as usize])
        });
        let colour = if depth.is_finite() {
            let pixel = DVec2::new(f64::from(x), f64::from(y)) + 0.5 - 0.5 * SIZE.as_dvec2();
            let across = pixel * 2.0 * half / f64::from(SIZE.y);
            ground.colour(shot.eye + depth * (axes * DVec3::new(across.x, -across.y, -1.0)))
        } else {
            DVec3::from_array(SKY)
        };
        let byte = |value: f64| (255.0 * value.clamp(0.0, 1.0)).round() as u8;
        image::Rgb(colour.to_array().map(byte))
    });
    let mut both = image::RgbImage::from_pixel(2 * SIZE.x + GAP, SIZE.y, image::Rgb([255; 3]));
    image::imageops::replace(&mut both, &left, 0, 0);
    image::imageops::replace(&mut both, &right, (SIZE.x + GAP).into(), 0);
    Ok(both)
}

/// A field lit at its samples.
struct Ground<'a> {
    field: &'a HeightField,
    map: &'a ShadowImage,
    eye: DVec3,
    to_sun: DVec3,
}

impl<'a> Ground<'a> {
    fn new(field: &'a HeightField, map: &'a ShadowImage, eye: DVec3) -> Self {
        Self {
            field,
            map,
            eye,
            to_sun: SUN.direction(),
        }
    }

    /// At a place on the ground: between the four samples around.
    fn colour(&self, at: DVec3) -> DVec3 {
        let cells = self.field.cells();
        let at = (DVec2::new(at.x, at.z) / f64::from(self.field.texel_m()))
            .clamp(DVec2::ZERO, cells.as_dvec2());
        let cell = at.as_uvec2().min(cells - 1);
        let part = at - cell.as_dvec2();
        let row = |j: u32| {
            let left = self.lit(cell + UVec2::new(0, j));
            left.lerp(self.lit(cell + UVec2::new(1, j)), part.x)
        };
        row(0).lerp(row(1), part.y)
    }

    /// At a sample.
    fn lit(&self, sample: UVec2) -> DVec3 {
        let texel_m = f64::from(self.field.texel_m());
        let height = |i: u32, j: u32| self.field.sample_m(i, j);
        let last = self.field.cells();
        let (before, after) = (sample.saturating_sub(UVec2::ONE), (sample + 1).min(last));
        let apart = (after - before).as_dvec2() * texel_m;
        let slope = DVec2::new(
            height(after.x, sample.y) - height(before.x, sample.y),
            height(sample.x, after.y) - height(sample.x, before.y),
        ) / apart;
        let normal = DVec3::new(-slope.x, 1.0, -slope.y).normalize();
        let place = DVec3::new(
            f64::from(sample.x) * texel_m,
            height(sample.x, sample.y),
            f64::from(sample.y) * texel_m,
        );
        let seen = f64::from(self.map.at(sample)) / 255.0;
        let half = (self.to_sun + (self.eye - place).normalize()).normalize();
        let diffuse = normal.dot(self.to_sun).max(0.0);
        let specular = normal.dot(half).max(0.0).powi(SHININESS);
        self.base(place.y) * (AMBIENT + seen * DIFFUSE * diffuse) + seen * SPECULAR * specular
    }

    /// Colour of a height, each band blended into the next about where it begins.
    fn base(&self, height_m: f64) -> DVec3 {
        let (low, high) = self.field.data_range_m();
        let share = (height_m - low) / (high - low).max(1e-9);
        let mut colour = DVec3::from_array(COLOURS[0].1);
        for (begin, next) in &COLOURS[1..] {
            let mix = ((share - begin) / 0.16 + 0.5).clamp(0.0, 1.0);
            colour = colour.lerp(DVec3::from_array(*next), mix);
        }
        colour
    }
}
