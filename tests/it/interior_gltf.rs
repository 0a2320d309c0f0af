//! glTF files as Bevy's own loader reads them: what `skyline interior` wrote, and models that are culled once loaded.

use std::path::Path;

use bevy::{
    asset::{LoadState, RecursiveDependencyLoadState},
    camera::{primitives::Aabb, visibility::VisibilityClass},
    gltf::{
        GltfMaterialExtras, GltfMaterialName, GltfMeshExtras, GltfMeshName, GltfSceneExtras,
        GltfSceneName,
    },
    mesh::Indices,
    prelude::*,
    transform::components::TransformTreeChanged,
    world_serialization::WorldAssetRoot,
};
use bevy_skyline::{offline::Offline, prelude::*};
use serde_json::json;

use crate::{
    cli::{directory, path},
    cli_interior::interior,
    data::shared,
    glb::Glb,
};

/// An app that knows what scenes are made of. With Bevy's default features it does by itself.
fn device() -> Option<Offline> {
    crate::device_with(|app| {
        app.register_type::<Transform>()
            .register_type::<GlobalTransform>()
            .register_type::<TransformTreeChanged>()
            .register_type::<Visibility>()
            .register_type::<InheritedVisibility>()
            .register_type::<ViewVisibility>()
            .register_type::<VisibilityClass>()
            .register_type::<Aabb>()
            .register_type::<Name>()
            .register_type::<Children>()
            .register_type::<ChildOf>()
            .register_type::<Mesh3d>()
            .register_type::<MeshMaterial3d<StandardMaterial>>()
            .register_type::<GltfExtras>()
            .register_type::<GltfSceneExtras>()
            .register_type::<GltfSceneName>()
            .register_type::<GltfMeshExtras>()
            .register_type::<GltfMeshName>()
            .register_type::<GltfMaterialExtras>()
            .register_type::<GltfMaterialName>();
    })
}

/// Loads a file's first scene and spawns it. Returns its root.
fn spawn(offline: &mut Offline, file: &str) -> Entity {
    let file = std::path::absolute(file).expect("a path");
    let assets = offline.app.world().resource::<AssetServer>().clone();
    let scene = assets.load(GltfAssetLabel::Scene(0).from_asset(file));
    for _ in 0..20_000 {
        offline.step();
        if let LoadState::Failed(why) = assets.load_state(&scene) {
            panic!("Bevy does not load it: {why}");
        }
        if matches!(
            assets.recursive_dependency_load_state(&scene),
            RecursiveDependencyLoadState::Loaded
        ) {
            let root = offline.app.world_mut().spawn(WorldAssetRoot(scene)).id();
            // It is spawned in the next frame.
            offline.step();
            offline.step();
            return root;
        }
        std::thread::sleep(core::time::Duration::from_millis(1));
    }
    panic!("it never loaded");
}

/// Triangles of everything with a mesh below an entity, node by node, and the nodes' names.
fn drawn(offline: &mut Offline, root: Entity) -> (usize, Vec<String>) {
    let world = offline.app.world_mut();
    let mut meshes = world.query::<(Entity, &Mesh3d)>();
    let found: Vec<_> = meshes
        .iter(world)
        .map(|(entity, mesh)| (entity, mesh.id()))
        .collect();
    let (mut triangles, mut names) = (0, Vec::new());
    for (entity, mesh) in found {
        let mut above = Some(entity);
        let mut is_below = false;
        while let Some(at) = above {
            is_below |= at == root;
            above = world.get::<ChildOf>(at).map(ChildOf::parent);
        }
        if !is_below {
            continue;
        }
        let mesh = world.resource::<Assets<Mesh>>().get(mesh).expect("a mesh");
        triangles += mesh.indices().map_or(mesh.count_vertices(), Indices::len) / 3;
        // Bevy puts a node's meshes below it.
        let node = world.get::<ChildOf>(entity).map(ChildOf::parent);
        names.extend(
            node.and_then(|node| world.get::<Name>(node))
                .map(|name| name.to_string()),
        );
    }
    names.sort();
    names.dedup();
    (triangles, names)
}

/// A box; one inside it, painted; and one inside that moves in and out.
fn model() -> Glb {
    let mut model = Glb::new();
    let shell = model.boxes("shell", &[([0.0; 3], 1.0)]);
    let core = model.boxes("core", &[([0.1, 0.0, 0.0], 0.3)]);
    let paint = model.push(
        "materials",
        json!({ "name": "paint", "pbrMetallicRoughness": { "baseColorFactor": [0.8, 0.1, 0.1, 1.0] } }),
    );
    model.json["meshes"][shell]["primitives"][0]["material"] = json!(paint);
    model.node(
        json!({ "name": "shell", "mesh": shell, "extras": { "made": "by code" } }),
        true,
    );
    model.node(json!({ "name": "core", "mesh": core }), true);
    let slide = model.node(json!({ "name": "slide", "mesh": core }), true);
    let times = model.floats("SCALAR", &[0.0, 1.0]);
    let places = model.floats("VEC3", &[0.0, 0.0, 0.0, 4.0, 0.0, 0.0]);
    model.push(
        "animations",
        json!({
            "name": "out",
            "samplers": [{ "input": times, "output": places }],
            "channels": [{ "sampler": 0, "target": { "node": slide, "path": "translation" } }],
        }),
    );
    model
}

#[test]
fn what_was_written_is_loaded_by_bevy() {
    let Some(mut offline) = device() else {
        return;
    };
    let dir = directory();
    let (input, out) = (path(&dir, "in.glb"), path(&dir, "out.glb"));
    model().save(&input);
    let (printed, _) = interior(&input, &out, &[]);
    let root = spawn(&mut offline, &out);
    let (triangles, names) = drawn(&mut offline, root);
    assert_eq!(names, ["shell", "slide"]);
    // What moves is left alone, and not counted.
    assert_eq!(printed["kept_triangles"], triangles - 12);
    let world = offline.app.world_mut();
    let mut extras = world.query::<&GltfExtras>();
    assert!(
        extras
            .iter(world)
            .any(|extras| extras.value.contains("by code"))
    );
    let mut materials = world.query::<&MeshMaterial3d<StandardMaterial>>();
    let paints: Vec<_> = materials.iter(world).map(|paint| paint.id()).collect();
    let library = world.resource::<Assets<StandardMaterial>>();
    assert!(paints.iter().any(|paint| {
        let colour = library
            .get(*paint)
            .map(|material| material.base_color.to_linear());
        colour.is_some_and(|colour| (colour.red - 0.8).abs() < 1e-6)
    }));
}

#[test]
fn a_real_model_that_was_trimmed_is_loaded_by_bevy() {
    let Some(file) = shared("cad/engine_four_cylinder_ldraw.glb") else {
        return;
    };
    let Some(mut offline) = device() else {
        return;
    };
    let file = file.display().to_string();
    let dir = directory();
    let out = path(&dir, "out.glb");
    let (printed, _) = interior(&file, &out, &["--resolution", "128"]);
    let [before, after] = [&file, &out].map(|file| {
        let root = spawn(&mut offline, file);
        let found = drawn(&mut offline, root);
        offline.app.world_mut().despawn(root);
        found
    });
    println!("{} of {} triangles stay", after.0, before.0);
    assert_eq!(printed["triangles"], before.0);
    assert_eq!(printed["kept_triangles"], after.0);
    assert!(after.0 < before.0);
    assert!(after.1.iter().all(|name| before.1.contains(name)));
}

#[test]
fn a_model_that_bevy_loads_is_culled_as_its_file_is() {
    let Some(mut offline) = device() else {
        return;
    };
    let dir = directory();
    let (input, out) = (path(&dir, "in.glb"), path(&dir, "out.glb"));
    let mut model = model();
    // The app leaves alone what it is told to, the file what is animated.
    model
        .json
        .as_object_mut()
        .expect("an object")
        .remove("animations");
    model.save(&input);
    let (printed, _) = interior(&input, &out, &[]);
    let assets = offline.app.world().resource::<AssetServer>().clone();
    let scene = assets.load(GltfAssetLabel::Scene(0).from_asset(Path::new(&input).to_owned()));
    // Asked for before anything is there.
    let root = offline.app.world_mut().spawn((
        WorldAssetRoot(scene),
        InteriorCulling {
            grid: InteriorGrid::Resolution(32),
            ..default()
        },
    ));
    let root = root.id();
    let counts = (0..20_000).find_map(|_| {
        offline.step();
        std::thread::sleep(core::time::Duration::from_millis(1));
        offline.app.world().get::<InteriorCounts>(root).copied()
    });
    let state = offline
        .app
        .world()
        .resource::<Effects>()
        .interior()
        .to_string();
    println!("{state}");
    let counts = counts.unwrap_or_else(|| panic!("never culled: {state}"));
    assert_eq!(printed["nodes"], counts.nodes);
    assert_eq!(printed["removed_nodes"], counts.hidden_nodes);
    assert_eq!(printed["removed_triangles"], counts.hidden_triangles);
    assert_eq!(counts.hidden_nodes, 2);
}
