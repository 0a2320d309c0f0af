//! Contract: the shipped shaders on the real device against the `f64` twin, ray by ray. The hard cases by name are in
//! `hard_cases::terrain`.

use bevy::{
    camera::{CameraProjection, SubCameraView},
    math::Vec3A,
    prelude::*,
};
use bevy_skyline::{
    offline::{HitImage, Offline},
    prelude::*,
    reference::ray_cast::{Tally, Twin},
    terrain::view_rays::ViewRays,
};

use crate::{data::elevation_model, terrain_scenes::Scene};

/// A projection that is whatever matrix the scene says.
#[derive(Clone, Debug)]
struct MatrixProjection(Mat4);

impl CameraProjection for MatrixProjection {
    fn get_clip_from_view(&self) -> Mat4 {
        self.0
    }

    fn get_clip_from_view_for_sub(&self, _: &SubCameraView) -> Mat4 {
        self.0
    }

    fn update(&mut self, _: f32, _: f32) {}

    fn far(&self) -> f32 {
        1e6
    }

    fn get_frustum_corners(&self, _: f32, _: f32) -> [Vec3A; 8] {
        [Vec3A::ZERO; 8]
    }
}

/// Draws one scene and returns what its rays hit; all sky where the camera holds no terrain at all.
pub fn draw(offline: &mut Offline, scene: &Scene, casting: TerrainRayCasting) -> HitImage {
    let field = offline
        .app
        .world_mut()
        .resource_mut::<Assets<HeightField>>()
        .add(scene.field.clone());
    let terrain = offline
        .app
        .world_mut()
        .spawn((Terrain::new(field), scene.world_from_local))
        .id();
    let target = offline.target(scene.size_px);
    let camera = offline.camera(
        &target,
        (
            Msaa::Off,
            casting,
            scene.camera,
            Projection::custom(MatrixProjection(scene.clip_from_view)),
        ),
    );
    let settled = offline.settle(camera, 6);
    let hits = offline.hits(camera).unwrap();
    let image = match (settled, hits) {
        (Ok(()), Some(hits)) => hits,
        // Not one ray can meet the terrain: the camera holds no picture of it. The twin must agree.
        _ => HitImage::sky(scene.size_px),
    };
    offline.app.world_mut().despawn(camera);
    offline.app.world_mut().despawn(terrain);
    offline.step();
    image
}

/// Judges every pixel of a picture.
fn judge(field: &HeightField, rays: &ViewRays, image: &HitImage) -> Tally {
    let twin = Twin::new(field);
    let mut tally = Tally::default();
    for y in 0..image.size.y {
        for x in 0..image.size.x {
            let pixel = Vec2::new(x as f32, y as f32) + 0.5;
            let verdict = twin.judge(rays, pixel, f64::from(rays.t_far));
            tally.check(
                rays,
                pixel,
                verdict,
                image.ndc_depth[(y * image.size.x + x) as usize],
            );
        }
    }
    tally
}

pub fn exact(traversal: Traversal, box_texels: u32) -> TerrainRayCasting {
    TerrainRayCasting {
        traversal,
        box_texels,
        max_error_px: 0.0,
    }
}

pub const TRAVERSALS: [(Traversal, u32); 5] = [
    (Traversal::PerTexel, 16),
    (Traversal::MaxMip, 16),
    (Traversal::Boxes, 4),
    (Traversal::Hybrid, 16),
    (Traversal::Hybrid, 4),
];

#[test]
fn the_real_elevation_model_agrees_with_the_twin() {
    let Some(mut offline) = crate::device() else {
        return;
    };
    let Some(field) = elevation_model("taiwan_central_range_4096") else {
        return;
    };
    let mut total = Tally::default();
    for (eye, at) in [
        (
            Vec3::new(30_000.0, 2_600.0, 60_000.0),
            Vec3::new(50_000.0, 1_500.0, 20_000.0),
        ),
        (
            Vec3::new(41_000.0, 14_000.0, 50_000.0),
            Vec3::new(41_000.0, 0.0, 40_000.0),
        ),
        (
            Vec3::new(41_000.0, 40_000.0, 41_000.0),
            Vec3::new(41_001.0, 0.0, 41_000.0),
        ),
        (
            Vec3::new(-9_000.0, 5_000.0, -4_000.0),
            Vec3::new(20_000.0, 1_000.0, 20_000.0),
        ),
    ] {
        let size_px = UVec2::new(160, 90);
        let mut projection = PerspectiveProjection::default();
        projection.update(size_px.x as f32, size_px.y as f32);
        let scene = Scene {
            name: "real elevation model",
            field: field.clone(),
            world_from_local: Transform::IDENTITY,
            camera: Transform::from_translation(eye).looking_at(at, Vec3::Y),
            clip_from_view: projection.get_clip_from_view(),
            size_px,
        };
        for (traversal, box_texels) in TRAVERSALS {
            let image = draw(&mut offline, &scene, exact(traversal, box_texels));
            total.merge(judge(&scene.field, &scene.rays(), &image));
        }
    }
    println!(
        "{} rays of the real model: {} hits, {} misses, {} in the guard band",
        total.rays(),
        total.hits,
        total.misses,
        total.in_band
    );
    total.assert_ok(0.02);
    let compared = total.rays();
    assert!(compared >= 20_000, "only {compared} rays were compared");
}
