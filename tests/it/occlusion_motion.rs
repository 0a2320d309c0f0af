//! A city in motion, frame by frame against the unculled picture; and terrain that hides meshes.

use bevy::prelude::*;
use bevy_skyline::{
    offline::scenes::{
        Look,
        city::{CitySize, generated},
        compare::{Difference, compare_frames},
        paths::PATHS,
        stage::{Culling, SceneStage},
    },
    prelude::*,
};

use crate::occlusion_app::{Scene, always, eye};

const SIZE: UVec2 = UVec2::new(160, 90);
/// Frames of each path. `skyline accuracy occlusion --path-frames 500` follows 2,000 in all.
const FRAMES: u32 = 60;

#[test]
fn a_city_in_motion_is_drawn_whole() {
    let stage = || SceneStage::new(generated(CitySize::Small), SIZE, Look::Shaded);
    let (Ok(mut whole), Ok(mut culled)) = (stage(), stage()) else {
        println!("skipped: no GPU device could be opened");
        return;
    };
    whole.cull(&Culling::Frustum);
    culled.cull(&Culling::ZBuffer(always()));
    let (mut frames, mut removed) = (0, 0);
    for (path, name) in PATHS {
        let differing = compare_frames(&mut whole, &mut culled, path, 0..FRAMES)
            .expect("pictures can be read back");
        let wrong: Vec<_> = differing
            .iter()
            .enumerate()
            .filter(|(_, px)| **px != Difference::default())
            .collect();
        assert!(wrong.is_empty(), "{name}: (frame, pixels) {wrong:?}");
        frames += differing.len();
        let counts = culled
            .offline
            .app
            .world()
            .get::<OcclusionCounts>(culled.camera());
        removed += counts.map_or(0, |counts| counts.removed);
    }
    println!("{frames} frames, {removed} removed at the paths' ends");
    assert_eq!(frames, PATHS.len() * FRAMES as usize);
    assert!(removed > 100);
}

/// A ridge along x, 20 m high, between the camera and the boxes.
fn ridge() -> HeightField {
    let size = UVec2::new(65, 65);
    let heights = (0..size.y)
        .flat_map(|row| {
            (0..size.x).map(move |_| {
                let off = (row as f32 - 40.0).abs();
                (20.0 - 4.0 * off).max(0.0)
            })
        })
        .collect::<Vec<f32>>();
    HeightField::from_f32(size, 1.0, heights).expect("a field of finite heights")
}

#[test]
fn terrain_hides_meshes() {
    let Some(mut scene) = Scene::new(always(), || Msaa::Off) else {
        return;
    };
    let world = scene.offline.app.world_mut();
    let wall = scene.wall;
    world.despawn(wall);
    let field = world.resource_mut::<Assets<HeightField>>().add(ridge());
    // The ridge stands where the wall stood, at z = 10.
    world.spawn((Terrain::new(field), Transform::from_xyz(-32.0, -6.0, -30.0)));
    let place = eye(Vec3::new(0.0, 4.0, 30.0), Vec3::new(0.0, 2.0, 0.0));
    scene.look(place);
    for _ in 0..10 {
        scene.step();
    }
    let counts = scene.step();
    println!("{counts:?}");
    assert!(counts.removed > 100, "{counts:?}");
    assert_eq!(scene.differing().0, 0);
    let mut rescued = 0;
    for frame in 0..40 {
        // Up over the ridge and down again.
        let height = 4.0 + 30.0 * (frame as f32 * 0.1).sin().abs();
        scene.look(eye(Vec3::new(0.0, height, 30.0), Vec3::new(0.0, 2.0, 0.0)));
        rescued += scene.step().rescued;
        assert_eq!(scene.differing().0, 0, "frame {frame}");
    }
    assert!(rescued > 0);
}
