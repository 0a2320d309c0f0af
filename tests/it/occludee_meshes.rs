//! The volumes of mesh assets through their life: made once, dropped when the mesh is another, shared by all.

use std::{sync::Arc, thread, time::Duration};

use bevy::{
    asset::{AssetEventSystems, AssetPlugin, RenderAssetUsages},
    mesh::{Indices, PrimitiveTopology, VertexAttributeValues, morph::MorphAttributes},
    prelude::*,
};
use bevy_skyline::occlusion::{
    OccludeeVolume,
    meshes::{MeshVolumes, OccludeeMeshes, build_mesh_volumes},
    obb,
};

const PROXY: OccludeeVolume = OccludeeVolume::Proxy { triangles: 50 };

fn app() -> App {
    let mut app = App::new();
    app.add_plugins((MinimalPlugins, AssetPlugin::default()))
        .init_asset::<Mesh>()
        .init_resource::<OccludeeMeshes>()
        .add_systems(PostUpdate, build_mesh_volumes.after(AssetEventSystems));
    app
}

fn add(app: &mut App, mesh: Mesh) -> Handle<Mesh> {
    app.world_mut().resource_mut::<Assets<Mesh>>().add(mesh)
}

fn kept(app: &mut App) -> Mut<'_, OccludeeMeshes> {
    app.world_mut().resource_mut::<OccludeeMeshes>()
}

fn volumes(app: &mut App, id: AssetId<Mesh>) -> MeshVolumes {
    kept(app).get(id).cloned().unwrap_or_default()
}

/// Updates until everything asked for is there. Returns what changed meanwhile, in order.
fn settle(app: &mut App) -> Vec<AssetId<Mesh>> {
    let mut changed = Vec::new();
    for _ in 0..2000 {
        app.update();
        changed.extend(kept(app).changed());
        if !kept(app).is_busy() {
            return changed;
        }
        thread::sleep(Duration::from_millis(2));
    }
    panic!("the volumes never came");
}

fn positions(mesh: &Mesh) -> Vec<Vec3> {
    let Some(VertexAttributeValues::Float32x3(positions)) =
        mesh.attribute(Mesh::ATTRIBUTE_POSITION)
    else {
        panic!("no positions");
    };
    positions.iter().copied().map(Vec3::from).collect()
}

fn sphere() -> Mesh {
    Sphere::new(2.0).mesh().ico(8).unwrap()
}

#[test]
fn each_mesh_is_made_once_for_all_that_ask() {
    let mut app = app();
    let mesh = sphere();
    let expected = obb::fit(&positions(&mesh));
    let handle = add(&mut app, mesh);
    kept(&mut app).want(handle.id(), OccludeeVolume::Obb);
    assert_eq!(settle(&mut app), [handle.id()]);
    let first = volumes(&mut app, handle.id());
    assert_eq!(first.obb, expected);
    assert!(expected.is_some() && first.proxy.is_none() && !first.has_morph_targets());

    for _ in 0..3 {
        for volume in [OccludeeVolume::Aabb, OccludeeVolume::Obb] {
            kept(&mut app).want(handle.id(), volume);
        }
        assert!(!kept(&mut app).is_busy());
        assert!(settle(&mut app).is_empty());
    }
    assert_eq!(
        volumes(&mut app, handle.id()).generation(),
        first.generation()
    );

    // The strongest wish wins, and what is there stays until the rest has come.
    kept(&mut app).want(handle.id(), PROXY);
    kept(&mut app).want(handle.id(), OccludeeVolume::Obb);
    assert_eq!(settle(&mut app), [handle.id()]);
    let second = volumes(&mut app, handle.id());
    assert_eq!(second.obb, expected);
    let proxy = second.proxy.clone().unwrap();
    assert!(
        (20..=50).contains(&proxy.triangles.len()),
        "{}",
        proxy.triangles.len()
    );
    assert_ne!(second.generation(), first.generation());

    kept(&mut app).want(handle.id(), OccludeeVolume::Proxy { triangles: 30 });
    assert!(settle(&mut app).is_empty());
    assert!(Arc::ptr_eq(
        &proxy,
        volumes(&mut app, handle.id()).proxy.as_ref().unwrap()
    ));

    kept(&mut app).want(handle.id(), OccludeeVolume::Proxy { triangles: 200 });
    assert_eq!(settle(&mut app), [handle.id()]);
    let finer = volumes(&mut app, handle.id()).proxy.unwrap();
    assert!(finer.triangles.len() > 50);
}

#[test]
fn nothing_asked_for_costs_nothing() {
    let mut app = app();
    let handle = add(&mut app, sphere());
    kept(&mut app).want(handle.id(), OccludeeVolume::Aabb);
    for _ in 0..5 {
        app.update();
        assert!(kept(&mut app).get(handle.id()).is_none());
        assert!(!kept(&mut app).is_busy());
        assert_eq!(kept(&mut app).bytes(), 0);
    }
    kept(&mut app).want(handle.id(), PROXY);
    settle(&mut app);
    assert!(kept(&mut app).bytes() > 0);
    kept(&mut app).clear();
    assert_eq!(kept(&mut app).bytes(), 0);
    assert_eq!(settle(&mut app), [handle.id()]);
    assert!(kept(&mut app).get(handle.id()).is_none());
}

#[test]
fn an_edited_mesh_loses_its_volumes_at_once() {
    let mut app = app();
    let handle = add(&mut app, sphere());
    kept(&mut app).want(handle.id(), PROXY);
    settle(&mut app);
    let old = volumes(&mut app, handle.id());
    assert!(old.proxy.is_some());

    // In the same frame, though nobody asks again.
    let larger = sphere().scaled_by(Vec3::splat(3.0));
    let expected = obb::fit(&positions(&larger));
    *app.world_mut()
        .resource_mut::<Assets<Mesh>>()
        .get_mut(handle.id())
        .unwrap() = larger;
    app.update();
    let dropped = volumes(&mut app, handle.id());
    assert!(dropped.obb.is_none() && dropped.proxy.is_none());
    assert_eq!(kept(&mut app).changed(), [handle.id()]);
    assert_ne!(dropped.generation(), old.generation());

    settle(&mut app);
    let new = volumes(&mut app, handle.id());
    assert_eq!(new.obb, expected);
    assert!(new.proxy.is_some());
    assert_ne!(new.generation(), dropped.generation());
}

#[test]
fn what_was_being_made_of_a_mesh_before_its_edit_is_thrown_away() {
    // At every stage: before the box is taken up, while it is made, while the proxy is.
    for updates_before in 0..6 {
        let mut app = app();
        let handle = add(&mut app, sphere());
        kept(&mut app).want(handle.id(), PROXY);
        for _ in 0..updates_before {
            app.update();
        }
        let moved = sphere().translated_by(Vec3::X * 100.0);
        let expected = obb::fit(&positions(&moved));
        *app.world_mut()
            .resource_mut::<Assets<Mesh>>()
            .get_mut(handle.id())
            .unwrap() = moved;
        for _ in 0..2000 {
            app.update();
            let now = volumes(&mut app, handle.id());
            assert!(
                now.obb.is_none() || now.obb == expected,
                "after {updates_before} updates"
            );
            if let Some(proxy) = &now.proxy {
                assert!(
                    proxy
                        .triangles
                        .iter()
                        .all(|swept| swept.corners[0].x > 90.0)
                );
            }
            if !kept(&mut app).is_busy() {
                break;
            }
            thread::sleep(Duration::from_millis(1));
        }
        assert!(volumes(&mut app, handle.id()).proxy.is_some());
    }
}

#[test]
fn a_mesh_edited_in_every_frame_is_left_alone() {
    let mut app = app();
    let handle = add(&mut app, sphere());
    kept(&mut app).want(handle.id(), PROXY);
    for frame in 0..60 {
        app.world_mut()
            .resource_mut::<Assets<Mesh>>()
            .get_mut(handle.id())
            .unwrap()
            .translate_by(Vec3::X);
        app.update();
        let now = volumes(&mut app, handle.id());
        assert!(now.obb.is_none() && now.proxy.is_none(), "frame {frame}");
        thread::sleep(Duration::from_millis(1));
    }
    settle(&mut app);
    assert!(volumes(&mut app, handle.id()).proxy.is_some());
}

#[test]
fn a_removed_mesh_leaves_nothing() {
    for drop_handle in [false, true] {
        let mut app = app();
        let handle = add(&mut app, sphere());
        let id = handle.id();
        kept(&mut app).want(id, PROXY);
        settle(&mut app);
        assert!(volumes(&mut app, id).proxy.is_some());
        if drop_handle {
            drop(handle);
        } else {
            app.world_mut().resource_mut::<Assets<Mesh>>().remove(id);
        }
        app.update();
        app.update();
        assert!(
            kept(&mut app).get(id).is_none(),
            "by dropping its handle: {drop_handle}"
        );
        assert!(!kept(&mut app).is_busy());
    }
}

#[test]
fn a_mesh_asked_for_before_it_is_loaded_gets_its_volumes_then() {
    let mut app = app();
    let handle = app.world().resource::<Assets<Mesh>>().reserve_handle();
    kept(&mut app).want(handle.id(), PROXY);
    for _ in 0..3 {
        app.update();
    }
    assert!(!kept(&mut app).is_busy());
    app.world_mut()
        .resource_mut::<Assets<Mesh>>()
        .insert(handle.id(), sphere())
        .unwrap();
    settle(&mut app);
    assert!(volumes(&mut app, handle.id()).proxy.is_some());
}

#[test]
fn a_mesh_in_the_render_world_only_has_no_volumes() {
    let mut app = app();
    let mut mesh = sphere();
    mesh.asset_usage = RenderAssetUsages::RENDER_WORLD;
    // As the renderer takes it.
    mesh.take_gpu_data().unwrap();
    let handle = add(&mut app, mesh);
    kept(&mut app).want(handle.id(), PROXY);
    settle(&mut app);
    let found = volumes(&mut app, handle.id());
    assert!(found.obb.is_none() && found.proxy.is_none());

    // A new one in its place is read again.
    app.world_mut()
        .resource_mut::<Assets<Mesh>>()
        .insert(handle.id(), sphere())
        .unwrap();
    settle(&mut app);
    assert!(volumes(&mut app, handle.id()).proxy.is_some());

    // One that goes there after its box was made has no proxy.
    let handle = add(&mut app, sphere());
    kept(&mut app).want(handle.id(), OccludeeVolume::Obb);
    settle(&mut app);
    let mut meshes = app.world_mut().resource_mut::<Assets<Mesh>>();
    meshes
        .get_mut_untracked(handle.id())
        .unwrap()
        .take_gpu_data()
        .unwrap();
    kept(&mut app).want(handle.id(), PROXY);
    settle(&mut app);
    let found = volumes(&mut app, handle.id());
    assert!(found.obb.is_some() && found.proxy.is_none());
}

#[test]
fn every_topology_and_index_type_is_read() {
    let mut app = app();
    let corners: Vec<[f32; 3]> = (0..8)
        .map(|i| [(i / 2) as f32, (i % 2) as f32, (i / 4) as f32])
        .collect();
    let of = |topology, indices: Option<Indices>| {
        let mut mesh = Mesh::new(topology, RenderAssetUsages::default())
            .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, corners.clone());
        if let Some(indices) = indices {
            mesh.insert_indices(indices);
        }
        mesh
    };
    let strip = vec![0, 1, 2, 3, u16::MAX, 4, 5, 6];
    use PrimitiveTopology::{LineList, LineStrip, PointList, TriangleList, TriangleStrip};
    let without_positions = Mesh::new(TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, corners.clone());
    // What it is, the mesh, whether it has a box, triangles of its proxy.
    let cases = [
        ("list", of(TriangleList, None), true, Some(2)),
        (
            "list of u16",
            of(TriangleList, Some(Indices::U16(vec![0, 1, 2, 5, 6, 7]))),
            true,
            Some(2),
        ),
        (
            "list of u32",
            of(TriangleList, Some(Indices::U32(vec![0, 1, 2, 5, 6, 7, 3]))),
            true,
            Some(2),
        ),
        ("strip", of(TriangleStrip, None), true, Some(6)),
        (
            "strip that begins again",
            of(TriangleStrip, Some(Indices::U16(strip))),
            true,
            Some(3),
        ),
        (
            "strip of u32",
            of(
                TriangleStrip,
                Some(Indices::U32(vec![0, 1, 2, u32::MAX, 3])),
            ),
            true,
            Some(1),
        ),
        ("points", of(PointList, None), true, None),
        ("lines", of(LineList, None), true, None),
        (
            "line strip",
            of(LineStrip, Some(Indices::U16(vec![0, 1, 2]))),
            true,
            None,
        ),
        (
            "index past the end",
            of(TriangleList, Some(Indices::U16(vec![0, 1, 8]))),
            true,
            None,
        ),
        (
            "no triangle",
            of(TriangleList, Some(Indices::U16(vec![]))),
            true,
            None,
        ),
        ("no positions", without_positions, false, None),
        (
            "nothing",
            Mesh::new(TriangleList, RenderAssetUsages::default()),
            false,
            None,
        ),
    ];
    let cases = cases.map(|(name, mesh, has_box, triangles)| {
        let handle = add(&mut app, mesh);
        kept(&mut app).want(handle.id(), PROXY);
        (name, handle, has_box, triangles)
    });
    settle(&mut app);
    for (name, handle, has_box, triangles) in cases {
        let found = volumes(&mut app, handle.id());
        assert_eq!(found.obb.is_some(), has_box, "{name}");
        assert_eq!(
            found.proxy.map(|proxy| proxy.triangles.len()),
            triangles,
            "{name}"
        );
    }
}

#[test]
fn a_mesh_with_morph_targets_says_so() {
    let mut app = app();
    let mut mesh = sphere();
    let vertices = mesh.count_vertices();
    mesh.set_morph_targets(vec![MorphAttributes::default(); vertices]);
    let handle = add(&mut app, mesh);
    kept(&mut app).want(handle.id(), OccludeeVolume::Obb);
    settle(&mut app);
    assert!(volumes(&mut app, handle.id()).has_morph_targets());
}
