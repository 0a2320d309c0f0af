//! The scenes that occlusion culling is measured on: what they promise, what bad files give, what is drawn.

use bevy::prelude::*;
use bevy_skyline::offline::scenes::{
    CameraPath, Look, Scene, SceneError, SceneObject,
    bunnies::{self, Block},
    city::{self, CitySize},
    compare::{Difference, compare_frames},
    obj,
    paths::PATHS,
    seabed::seabed,
    stage::{Culling, SceneStage},
};

use crate::data::shared;

/// A picture small enough for many frames.
const SIZE: UVec2 = UVec2::new(320, 180);

fn stage(scene: Scene, look: Look) -> Option<SceneStage> {
    match SceneStage::new(scene, SIZE, look) {
        Ok(stage) => Some(stage),
        Err(reason) => {
            println!("skipped: {reason}");
            None
        }
    }
}

/// What holds for every scene.
fn check(scene: &Scene) {
    assert!(!scene.views.is_empty() && scene.triangles() > 0);
    for object in &scene.objects {
        assert!(object.mesh < scene.meshes.len() && object.paint < scene.paints.len());
        assert!(object.place(77).translation.is_finite());
    }
    assert!(
        scene.bounds[0].cmplt(scene.bounds[1]).all(),
        "{:?}",
        scene.bounds
    );
    for (path, name) in PATHS {
        for frame in [0, 1, 59, 1_999] {
            let camera = path.at(scene, frame);
            assert!(camera.is_finite(), "{name} {frame}");
            assert_eq!(camera, path.at(scene, frame), "{name} {frame}");
        }
        assert_ne!(path.at(scene, 0), path.at(scene, 40), "{name} stands still");
    }
}

#[test]
fn the_generated_city_is_dense_and_always_the_same() {
    let scene = city::generated(CitySize::Full);
    check(&scene);
    let buildings = scene.meshes.len().saturating_sub(7);
    assert!(buildings >= 10_000, "{buildings}");
    assert!(scene.objects.len() >= 12_000, "{}", scene.objects.len());
    assert!(scene.objects.iter().filter(|o| o.shuttle.is_some()).count() >= 8);
    let again = city::generated(CitySize::Full);
    assert_eq!(scene.objects, again.objects);
    assert_eq!(scene.views, again.views);
    assert_eq!(scene.walk, again.walk);
    let small = city::generated(CitySize::Small);
    check(&small);
    assert!(
        (450..1_500).contains(&small.objects.len()),
        "{}",
        small.objects.len()
    );
    assert!(
        small.walk[0].distance(small.walk[1]) > 50.0,
        "{:?}",
        small.walk
    );
}

#[test]
fn the_real_city_has_all_its_buildings_about_their_own_middles() {
    let Some(path) = shared("city/manhattan_midtown.glb") else {
        return;
    };
    let scene = city::from_file(&path).expect("the file can be read");
    check(&scene);
    assert_eq!(scene.meshes.len(), 8_587 + 7);
    assert!(scene.objects.len() >= 10_000, "{}", scene.objects.len());
    assert!(
        (scene.bounds[1].y - 443.2).abs() < 0.1,
        "{:?}",
        scene.bounds
    );
    for object in &scene.objects[..8_587] {
        let mesh = &scene.meshes[object.mesh];
        let (centre, half) = bevy::camera::primitives::MeshAabb::compute_aabb(mesh)
            .map(|aabb| (aabb.center, aabb.half_extents))
            .expect("a building has a box");
        assert!(centre.x.abs() < 0.01 && centre.z.abs() < 0.01, "{centre}");
        assert!((centre.y - half.y).abs() < 0.01, "{centre} {half}");
    }
}

#[test]
fn blocks_of_models_have_the_triangles_asked_for() {
    let scenes = match shared("mesh/stanford_bunny.obj") {
        Some(path) => [Block::NINE, Block::of(UVec3::new(10, 1, 10), 1_000)]
            .map(|block| bunnies::from_file(&path, block).expect("the file can be read")),
        None => [Block::NINE, Block::of(UVec3::new(10, 1, 10), 1_000)].map(bunnies::generated),
    };
    for (scene, (count, triangles)) in scenes.iter().zip([(9, 10_000), (100, 1_000)]) {
        check(scene);
        assert_eq!(scene.objects.len(), count);
        let each = scene.triangles() / count;
        assert!((triangles * 95 / 100..=triangles).contains(&each), "{each}");
    }
    let made = bunnies::generated(Block::HUNDRED);
    check(&made);
    assert_eq!(made.name, "bumpy_sphere_100");
    assert_eq!(made.triangles(), 1_000_000);
}

#[test]
fn the_sea_bed_has_256_blocks_that_join() {
    let scene = seabed(true);
    check(&scene);
    assert_eq!(scene.objects.len(), 256);
    let heights = |object: usize, x: f32| -> Vec<u32> {
        let positions = scene.meshes[object].attribute(Mesh::ATTRIBUTE_POSITION);
        positions
            .and_then(|positions| positions.as_float3())
            .expect("blocks have positions")
            .iter()
            .filter(|at| at[0] == x)
            .map(|at| at[1].to_bits())
            .collect()
    };
    let (left, right) = (heights(0, 50.0), heights(1, -50.0));
    assert_eq!(left.len(), 17);
    assert_eq!(left, right);
    let full = seabed(false);
    assert!(
        (full.triangles() as f64 / 2_134_016.0 - 1.0).abs() < 0.005,
        "{}",
        full.triangles()
    );
}

#[test]
fn bad_files_are_told_apart() {
    let dir = tempfile::tempdir().expect("a directory can be made");
    let file = |name: &str, bytes: &[u8]| {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).expect("a file can be written");
        path
    };
    let missing = dir.path().join("none.glb");
    assert!(matches!(
        city::from_file(&missing),
        Err(SceneError::Read { .. })
    ));
    let noise = file("noise.glb", b"not a glTF at all");
    assert!(matches!(
        city::from_file(&noise),
        Err(SceneError::Gltf { .. })
    ));
    assert!(matches!(
        city::from_file(&file(
            "empty.glb",
            &glb(r#""nodes":[{"name":"nothing"}],"#, "0")
        )),
        Err(SceneError::NoBuildings { .. })
    ));
    // Says it has a hundred positions in the twelve bytes it has.
    let past = glb(
        r#""nodes":[{"mesh":0,"name":"tower"}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
           "accessors":[{"bufferView":0,"componentType":5126,"count":100,"type":"VEC3","min":[0,0,0],"max":[1,1,1]}],
           "bufferViews":[{"buffer":0,"byteLength":12}],"buffers":[{"byteLength":12}],"#,
        "0",
    );
    let error = city::from_file(&file("past.glb", &past)).expect_err("its data are missing");
    assert!(
        matches!(&error, SceneError::Gltf { reason, .. } if reason.contains("accessor 0 reaches out")),
        "{error}"
    );

    let obj_error =
        |name: &str, text: &str| obj::read(&file(name, text.as_bytes())).expect_err(text);
    assert!(matches!(
        obj_error("a.obj", "v 0 0\n"),
        SceneError::Obj { line: 1, .. }
    ));
    assert!(matches!(
        obj_error("b.obj", "v 0 0 0\nf 1 2 3\n"),
        SceneError::Obj { line: 2, .. }
    ));
    assert!(matches!(
        obj_error("c.obj", "v 0 0 nan\n"),
        SceneError::Obj { line: 1, .. }
    ));
    assert!(matches!(
        obj_error("d.obj", "v 0 0 0\n"),
        SceneError::NoFaces { .. }
    ));
    let square = file(
        "square.obj",
        b"# made\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1 2//2 -2 4\n",
    );
    let square = obj::read(&square).expect("this one is right");
    assert_eq!(square.indices, [0, 1, 2, 0, 2, 3]);
}

/// A glTF binary of some JSON members, in a scene of the nodes listed, and twelve bytes of data.
fn glb(members: &str, nodes: &str) -> Vec<u8> {
    let mut json =
        format!(r#"{{{members}"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[{nodes}]}}]}}"#)
            .into_bytes();
    while json.len() % 4 != 0 {
        json.push(b' ');
    }
    let data = [0u8; 12];
    let word = |n: usize| (n as u32).to_le_bytes();
    [
        b"glTF".as_slice(),
        &word(2),
        &word(12 + 8 + json.len() + 8 + data.len()),
        &word(json.len()),
        b"JSON",
        &json,
        &word(data.len()),
        b"BIN\0",
        &data,
    ]
    .concat()
}

#[test]
fn each_way_to_cull_draws_what_it_should() {
    let scene = city::generated(CitySize::Small);
    let objects = scene.objects.len();
    let Some(mut truth) = stage(scene.clone(), Look::Ids) else {
        return;
    };
    let Some(mut lit) = stage(scene, Look::Shaded) else {
        return;
    };
    for view in lit.scene.views.clone() {
        for stage in [&mut truth, &mut lit] {
            stage.look(view.transform);
            stage.cull(&Culling::None);
        }
        let seen = truth.seen().expect("the picture is one of numbers");
        let seen = seen.iter().filter(|px| **px > 0).count();
        let whole = lit.picture().expect("there is a picture");
        assert_eq!(lit.drawn().expect("counted"), objects);
        lit.cull(&Culling::Frustum);
        let in_view = lit.drawn().expect("counted");
        assert_eq!(
            lit.picture().expect("there is a picture"),
            whole,
            "{}",
            view.name
        );
        lit.cull(&Culling::Bevy);
        let by_bevy = lit.drawn().expect("counted");
        println!(
            "{}: {objects} objects, {in_view} in view, {by_bevy} by Bevy, {seen} seen",
            view.name
        );
        assert!(seen > 0 && in_view >= seen && in_view < objects || view.name == "above");
        assert!(
            (seen..=in_view).contains(&by_bevy),
            "{}: {by_bevy} of {seen}..{in_view}",
            view.name
        );
    }
}

#[test]
fn frames_that_differ_are_found_and_frames_that_do_not_are_not() {
    let scene = city::generated(CitySize::Small);
    let Some(mut a) = stage(scene.clone(), Look::Shaded) else {
        return;
    };
    let Some(mut b) = stage(scene, Look::Shaded) else {
        return;
    };
    a.cull(&Culling::None);
    b.cull(&Culling::Frustum);
    for (path, name) in PATHS {
        let differ = compare_frames(&mut a, &mut b, path, 0..12).expect("pictures come back");
        assert_eq!(differ, vec![Difference::default(); 12], "{name}");
    }
    // What shows most, the ground among it, goes missing in one of them.
    let Some(mut truth) = stage(a.scene.clone(), Look::Ids) else {
        return;
    };
    truth.set_frame(CameraPath::Walk, 0);
    truth.cull(&Culling::Frustum);
    let seen = truth.seen().expect("the picture is one of numbers");
    let mut most: Vec<usize> = (0..seen.len()).collect();
    most.sort_by_key(|&index| std::cmp::Reverse(seen[index]));
    assert!(seen[most[1]] > 500, "{}", seen[most[1]]);
    for &shown in &most[..2] {
        let world = b.offline.app.world_mut();
        assert_eq!(
            world.get::<SceneObject>(b.entities[shown]),
            Some(&SceneObject(shown))
        );
        world
            .entity_mut(b.entities[shown])
            .insert(Visibility::Hidden);
    }
    let differ =
        compare_frames(&mut a, &mut b, CameraPath::Walk, 0..3).expect("pictures come back");
    assert!(differ.iter().all(|differ| differ.lost_px > 0), "{differ:?}");
}

/// P2's Fig. 17: one view that shows nine of the 256 blocks, one that shows 46.
#[test]
fn the_sea_bed_hides_most_of_itself() {
    let Some(mut truth) = stage(seabed(true), Look::Ids) else {
        return;
    };
    for (view, seen_blocks) in [
        ("above", 256..=256),
        ("view_1", 4..=14),
        ("view_2", 40..=52),
    ] {
        truth.look(truth.scene.view(view));
        truth.cull(&Culling::Frustum);
        let seen = truth.seen().expect("the picture is one of numbers");
        let seen = seen.iter().filter(|px| **px > 0).count();
        assert!(seen_blocks.contains(&seen), "{view}: {seen}");
    }
}
