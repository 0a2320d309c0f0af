//! A spherical index in the life of an app: that the picture stays the same, what is drawn for it, and that nothing is
//! left of it afterwards.

use bevy::{
    asset::RenderAssetUsages,
    camera::{ScalingMode, Viewport, visibility::RenderLayers},
    mesh::{MeshTag, PrimitiveTopology},
    prelude::*,
    render::render_resource::Face,
};
use bevy_skyline::{
    culling::{CullReason, Culling},
    offline::{
        Offline,
        scenes::{
            compare::differing_px,
            ids::{ObjectIdMaterial, ObjectIdPlugin},
        },
    },
    prelude::*,
    systems::spherical::{models::SphericalModels, spawn::ChunkOf},
};

const SIZE: UVec2 = UVec2::new(200, 160);

/// A knot of a thick cord: closed, folded, far from star-shaped.
fn knot(rings: u32, sides: u32) -> Mesh {
    let centre = |t: f32| {
        let turn = core::f32::consts::TAU * t;
        let out = 1.0 + 0.45 * (3.0 * turn).cos();
        Vec3::new(
            out * (2.0 * turn).cos(),
            0.45 * (3.0 * turn).sin(),
            out * (2.0 * turn).sin(),
        )
    };
    let (mut positions, mut normals, mut uvs) = (Vec::new(), Vec::new(), Vec::new());
    for ring in 0..rings {
        let t = ring as f32 / rings as f32;
        let along = (centre(t + 1e-3) - centre(t - 1e-3)).normalize();
        let side = along.cross(Vec3::Y).normalize();
        let up = side.cross(along);
        for i in 0..sides {
            let turn = core::f32::consts::TAU * i as f32 / sides as f32;
            let normal = side * turn.cos() + up * turn.sin();
            positions.push(centre(t) + 0.22 * normal);
            normals.push(normal);
            uvs.push([t, i as f32 / sides as f32]);
        }
    }
    let mut indices = Vec::new();
    for ring in 0..rings {
        for i in 0..sides {
            let at = |ring: u32, i: u32| (ring % rings) * sides + i % sides;
            let [a, b, c, d] = [
                at(ring, i),
                at(ring, i + 1),
                at(ring + 1, i + 1),
                at(ring + 1, i),
            ];
            indices.extend([a, b, c, a, c, d]);
        }
    }
    let mut mesh = Mesh::new(
        PrimitiveTopology::TriangleList,
        RenderAssetUsages::default(),
    );
    mesh.insert_attribute(Mesh::ATTRIBUTE_POSITION, positions);
    mesh.insert_attribute(Mesh::ATTRIBUTE_NORMAL, normals);
    mesh.insert_attribute(Mesh::ATTRIBUTE_UV_0, uvs);
    mesh.insert_indices(bevy::mesh::Indices::U32(indices));
    mesh
}

fn settings() -> SphericalIndex {
    SphericalIndex {
        chunk_triangles: 256,
        ..default()
    }
}

/// Rings and sides of the knot that most is shown on.
const KNOT: (u32, u32) = (400, 80);
const TRIANGLES: u32 = 2 * KNOT.0 * KNOT.1;

/// A knot over a floor that its shadow falls on, and a camera.
struct Scene {
    offline: Offline,
    camera: Entity,
    target: Handle<Image>,
    knot: Entity,
    paint: Handle<StandardMaterial>,
    /// Meshes that are there before anything is indexed.
    meshes: usize,
}

impl Scene {
    fn new() -> Option<Self> {
        Some(Self::with(crate::device()?))
    }

    fn with(mut offline: Offline) -> Self {
        let target = offline.target(SIZE);
        let camera = offline.camera(&target, (Msaa::Off, Transform::default()));
        let world = offline.app.world_mut();
        let [floor, mesh] = [
            Cuboid::new(30.0, 0.2, 30.0).mesh().build(),
            knot(KNOT.0, KNOT.1),
        ]
        .map(|mesh| world.resource_mut::<Assets<Mesh>>().add(mesh));
        let paint = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial::from_color(Color::srgb(0.8, 0.3, 0.2)));
        world.spawn((
            Mesh3d(floor),
            MeshMaterial3d(paint.clone()),
            Transform::from_xyz(0.0, -2.0, 0.0),
        ));
        world.spawn((
            DirectionalLight {
                shadow_maps_enabled: true,
                ..default()
            },
            Transform::default().looking_to(Vec3::new(-1.0, -2.0, -1.5), Vec3::Y),
        ));
        let knot = world
            .spawn((
                Mesh3d(mesh),
                MeshMaterial3d(paint.clone()),
                Transform::from_rotation(Quat::from_euler(EulerRot::XYZ, 0.4, 0.8, 0.2)),
            ))
            .id();
        let mut scene = Self {
            offline,
            camera,
            target,
            knot,
            paint,
            meshes: 0,
        };
        scene.look(Vec3::new(1.0, 2.0, 4.0));
        scene.offline.step();
        scene.meshes = scene.count_meshes();
        scene
    }

    fn world(&mut self) -> &mut World {
        self.offline.app.world_mut()
    }

    fn count_meshes(&self) -> usize {
        self.offline.app.world().resource::<Assets<Mesh>>().len()
    }

    fn look(&mut self, from: Vec3) {
        let camera = self.camera;
        let place = Transform::from_translation(from).looking_at(Vec3::ZERO, Vec3::Y);
        self.world().entity_mut(camera).insert(place);
    }

    fn state(&self) -> EffectState {
        let effects = self.offline.app.world().resource::<Effects>();
        effects.spherical().clone()
    }

    fn until(&mut self, what: &str) {
        for _ in 0..5_000 {
            self.offline.step();
            if self.state().to_string().contains(what) {
                return;
            }
            std::thread::sleep(core::time::Duration::from_millis(1));
        }
        panic!("it never came to {what:?}: {}", self.state());
    }

    fn index(&mut self, settings: SphericalIndex) {
        let knot = self.knot;
        self.world().entity_mut(knot).insert(settings);
        self.until("triangles are drawn");
    }

    fn counts(&self) -> SphericalCounts {
        let counts = self.offline.app.world().get::<SphericalCounts>(self.knot);
        *counts.expect("it is asked for")
    }

    fn chunks(&mut self) -> Vec<Entity> {
        let world = self.world();
        let mut chunks = world.query_filtered::<Entity, With<ChunkOf>>();
        chunks.iter(world).collect()
    }

    fn picture(&mut self) -> image::RgbaImage {
        for _ in 0..2 {
            self.offline.step();
        }
        self.offline.picture(&self.target).expect("a picture")
    }

    /// Pictures from some sides, and the share of triangles that was drawn for each where it was indexed.
    fn pictures(&mut self, from: &[Vec3]) -> Vec<(image::RgbaImage, f64)> {
        from.iter()
            .map(|from| {
                self.look(*from);
                let picture = self.picture();
                let share = self.offline.app.world().get::<SphericalCounts>(self.knot);
                let share = share.map_or(1.0, |counts| {
                    counts.drawn_triangles as f64 / f64::from(counts.triangles.max(1))
                });
                (picture, share)
            })
            .collect()
    }

    /// The pictures are the same, drawn by chunks where a chunk is wanted to be left out at all.
    fn same_from(&mut self, from: &[Vec3], settings: SphericalIndex) -> Vec<f64> {
        let knot = self.knot;
        self.world().entity_mut(knot).remove::<SphericalIndex>();
        let before = self.pictures(from);
        self.index(settings);
        let after = self.pictures(from);
        for ((before, _), (after, _)) in before.iter().zip(&after) {
            let background = *before.get_pixel(0, 0);
            assert!(
                before.pixels().any(|pixel| *pixel != background),
                "an empty picture"
            );
            assert_eq!(differing_px(before, after), 0);
        }
        after.into_iter().map(|(_, share)| share).collect()
    }
}

const AROUND: [Vec3; 6] = [
    Vec3::new(1.0, 2.0, 4.0),
    Vec3::new(-4.0, 0.5, 0.3),
    Vec3::new(0.1, 4.5, 0.2),
    Vec3::new(1.5, -1.2, -2.0),
    Vec3::new(0.9, 0.2, 0.9),
    Vec3::new(0.0, 0.0, 12.0),
];

#[test]
fn the_picture_is_the_same_and_half_of_the_triangles_are_drawn() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let shares = scene.same_from(&AROUND, settings());
    println!("{shares:.3?}; {}", scene.state());
    for share in &shares {
        assert!((0.0..0.85).contains(share), "{share}");
    }
    let counts = scene.counts();
    assert_eq!(counts.triangles, TRIANGLES);
    assert_eq!((counts.views, counts.views_by_chunks), (1, 1));
    assert_eq!(scene.chunks().len(), counts.chunks as usize);
    assert!(counts.chunks >= TRIANGLES / 256);
}

#[test]
fn it_is_the_same_mirrored_stretched_orthographic_two_sided_and_inside_out() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let knot = scene.knot;
    for scale in [
        Vec3::new(-1.0, 1.0, 1.0),
        Vec3::new(0.2, 1.0, -2.5),
        Vec3::splat(0.5),
    ] {
        let from: Vec<_> = AROUND
            .iter()
            .map(|from| *from * scale.abs().max_element().min(1.0))
            .collect();
        scene
            .world()
            .entity_mut(knot)
            .insert(Transform::from_scale(scale));
        let shares = scene.same_from(&from, settings());
        println!("{scale}: {shares:.3?}");
        assert!(shares.iter().any(|share| *share < 0.9));
    }
    scene.world().entity_mut(knot).insert(Transform::IDENTITY);
    for (cull, is_whole) in [(Some(Face::Front), false), (None, true)] {
        let paint = scene.paint.clone();
        let mut materials = scene.world().resource_mut::<Assets<StandardMaterial>>();
        materials.get_mut(&paint).expect("a material").cull_mode = cull;
        let shares = scene.same_from(&AROUND, settings());
        println!("{cull:?}: {shares:.3?}");
        assert_eq!(shares[5] > 0.999, is_whole);
    }
    let paint = scene.paint.clone();
    let mut materials = scene.world().resource_mut::<Assets<StandardMaterial>>();
    materials.get_mut(&paint).expect("a material").cull_mode = Some(Face::Back);
    let camera = scene.camera;
    scene
        .world()
        .entity_mut(camera)
        .insert(Projection::Orthographic(OrthographicProjection {
            scaling_mode: ScalingMode::FixedVertical {
                viewport_height: 4.0,
            },
            ..OrthographicProjection::default_3d()
        }));
    let shares = scene.same_from(&AROUND, settings());
    println!("orthographic: {shares:.3?}");
    assert!(shares.iter().all(|share| *share < 0.85));
}

#[test]
fn each_camera_has_its_own_part() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (target, first) = (scene.target.clone(), scene.camera);
    let half = UVec2::new(SIZE.x / 2, SIZE.y);
    let viewport = |x: u32| {
        Some(Viewport {
            physical_position: UVec2::new(x, 0),
            physical_size: half,
            ..default()
        })
    };
    let second = scene.offline.camera(
        &target,
        (
            Msaa::Off,
            Camera {
                viewport: viewport(half.x),
                order: 1,
                clear_color: ClearColorConfig::None,
                ..default()
            },
            Transform::from_xyz(-3.0, 1.0, -3.0).looking_at(Vec3::ZERO, Vec3::Y),
        ),
    );
    scene
        .world()
        .get_mut::<Camera>(first)
        .expect("a camera")
        .viewport = viewport(0);
    let shares = scene.same_from(&AROUND[..2], settings());
    println!("{shares:.3?}");
    let counts = scene.counts();
    assert_eq!((counts.views, counts.views_by_chunks), (2, 2));
    let list = |scene: &Scene, camera| {
        let visible = scene
            .offline
            .app
            .world()
            .get::<bevy::camera::visibility::VisibleEntities>(camera);
        visible
            .expect("a camera")
            .get(core::any::TypeId::of::<Mesh3d>())
            .to_vec()
    };
    assert_ne!(list(&scene, first), list(&scene, second));
    for camera in [first, second] {
        let list = list(&scene, camera);
        assert!(list.is_sorted());
        assert!(!list.contains(&scene.knot));
    }
    // To a game it is seen as ever.
    let (knot, some) = (scene.knot, scene.chunks());
    let seen = scene.world().run_system_cached_with(
        move |In((camera, knot, chunks)): In<(Entity, Entity, Vec<Entity>)>, culling: Culling| {
            let unseen = chunks
                .iter()
                .filter(|chunk| culling.reason(camera, **chunk) == Some(CullReason::Chunk));
            (
                culling.is_seen(knot),
                culling.reason(camera, knot),
                unseen.count(),
                chunks.len(),
            )
        },
        (first, knot, some),
    );
    let (is_seen, reason, unseen, all) = seen.expect("it runs");
    assert!(is_seen && reason.is_none());
    assert!(0 < unseen && unseen < all);
}

#[test]
fn no_frame_flickers_while_it_comes_and_goes() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let before = scene.picture();
    let knot = scene.knot;
    let same = |scene: &mut Scene, what: &str| {
        scene.offline.step();
        let now = scene.offline.picture(&scene.target).expect("a picture");
        assert_eq!(differing_px(&before, &now), 0, "{what}: {}", scene.state());
    };
    scene.world().entity_mut(knot).insert(settings());
    let mut by_chunks = 0;
    for _ in 0..5_000 {
        same(&mut scene, "coming");
        by_chunks += scene.counts().views_by_chunks;
        if by_chunks == 8 {
            break;
        }
        std::thread::sleep(core::time::Duration::from_millis(1));
    }
    assert_eq!(by_chunks, 8);
    // Another material of the same look, on and off.
    let paint = StandardMaterial::from_color(Color::srgb(0.8, 0.3, 0.2));
    let paint = scene
        .world()
        .resource_mut::<Assets<StandardMaterial>>()
        .add(paint);
    scene.offline.step();
    scene
        .world()
        .entity_mut(knot)
        .insert(MeshMaterial3d(paint.clone()));
    for _ in 0..4 {
        same(&mut scene, "repainted");
        assert_eq!(scene.counts().views_by_chunks, 1);
    }
    scene.world().entity_mut(knot).insert(SphericalIndex {
        chunk_triangles: 400,
        ..settings()
    });
    for _ in 0..60 {
        same(&mut scene, "changing");
    }
    scene.until("triangles are drawn");
    scene.world().entity_mut(knot).remove::<SphericalIndex>();
    for _ in 0..4 {
        same(&mut scene, "going");
    }
}

#[test]
fn entities_that_share_a_mesh_share_its_index() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let knot = scene.knot;
    let mesh = scene.world().get::<Mesh3d>(knot).expect("a mesh").clone();
    let paint = MeshMaterial3d(scene.paint.clone());
    let others = [-2.5, 2.5].map(|x| {
        let place = Transform::from_xyz(x, 0.5, -1.0).with_scale(Vec3::splat(0.8));
        scene
            .world()
            .spawn((mesh.clone(), paint.clone(), place))
            .id()
    });
    let before = scene.pictures(&AROUND);
    for (entity, chunk_triangles) in [(knot, 256), (others[0], 256), (others[1], 300)] {
        scene.world().entity_mut(entity).insert(SphericalIndex {
            chunk_triangles,
            ..default()
        });
    }
    for _ in 0..5_000 {
        scene.offline.step();
        let world = scene.offline.app.world();
        let is_ready = |entity| {
            let counts = world.get::<SphericalCounts>(entity);
            counts.is_some_and(|counts| counts.triangles > 0)
        };
        if is_ready(knot) && is_ready(others[0]) && is_ready(others[1]) {
            break;
        }
        std::thread::sleep(core::time::Duration::from_millis(1));
    }
    assert_eq!(
        scene.world().resource::<SphericalModels>().indexed_meshes(),
        2
    );
    let after = scene.pictures(&AROUND);
    for ((before, _), (after, _)) in before.iter().zip(&after) {
        assert_eq!(differing_px(before, after), 0);
    }
    println!("{}", scene.state());
    // One goes, the others stay.
    scene.world().despawn(others[0]);
    scene
        .world()
        .entity_mut(others[1])
        .remove::<SphericalIndex>();
    scene.offline.step();
    assert_eq!(
        scene.world().resource::<SphericalModels>().indexed_meshes(),
        1
    );
    let chunks = scene.counts().chunks as usize;
    assert_eq!(scene.chunks().len(), chunks);
}

#[test]
fn a_mirrored_camera_and_one_that_inverts_culling_lose_nothing() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (camera, knot) = (scene.camera, scene.knot);
    for (scale, inverts) in [(-1.0, false), (-1.0, true), (1.0, true)] {
        let pictures = |scene: &mut Scene| -> Vec<image::RgbaImage> {
            AROUND[..3]
                .iter()
                .map(|from| {
                    scene.look(*from);
                    let mut entity = scene.world().entity_mut(camera);
                    if let Some(mut place) = entity.get_mut::<Transform>() {
                        place.scale.x = scale;
                    }
                    if let Some(mut camera) = entity.get_mut::<Camera>() {
                        camera.invert_culling = inverts;
                    }
                    scene.picture()
                })
                .collect()
        };
        scene.world().entity_mut(knot).remove::<SphericalIndex>();
        let whole = pictures(&mut scene);
        scene.index(SphericalIndex {
            chunk_cost: 0,
            ..settings()
        });
        let by_chunks = pictures(&mut scene);
        assert_eq!(scene.counts().views_by_chunks, 1);
        for (whole, by_chunks) in whole.iter().zip(&by_chunks) {
            let differing = differing_px(whole, by_chunks);
            assert_eq!(differing, 0, "scale {scale}, inverted {inverts}");
        }
    }
}

#[test]
fn chunks_that_a_user_takes_away_or_clones_are_put_right() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let knot = scene.knot;
    let before = scene.picture();
    scene.index(settings());
    let count = scene.chunks().len();
    let is_right = |scene: &mut Scene, what: &str| {
        for _ in 0..3 {
            scene.offline.step();
        }
        scene.until("in 1 of 1 views");
        assert_eq!(scene.chunks().len(), count, "{what}");
        assert_eq!(differing_px(&scene.picture(), &before), 0, "{what}");
    };
    scene.world().entity_mut(knot).despawn_related::<Children>();
    is_right(&mut scene, "despawned");
    scene.world().entity_mut(knot).detach_all_children();
    is_right(&mut scene, "detached");
    let some = scene.chunks()[3];
    scene.world().entity_mut(some).clone_and_spawn();
    is_right(&mut scene, "cloned");
}

#[test]
fn nothing_is_left_of_it() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let knot = scene.knot;
    for _ in 0..2 {
        scene.index(settings());
        assert!(scene.count_meshes() > scene.meshes);
        scene.world().entity_mut(knot).remove::<SphericalIndex>();
        for _ in 0..3 {
            scene.offline.step();
        }
        assert_eq!(scene.chunks(), []);
        assert!(scene.world().get::<SphericalCounts>(knot).is_none());
        assert!(scene.world().resource::<SphericalModels>().is_empty());
        assert_eq!(scene.count_meshes(), scene.meshes);
        assert_eq!(scene.state(), EffectState::Dormant);
    }
    scene.index(settings());
    scene.world().despawn(knot);
    for _ in 0..3 {
        scene.offline.step();
    }
    assert_eq!(scene.chunks(), []);
    assert!(scene.world().resource::<SphericalModels>().is_empty());
    assert_eq!(scene.state(), EffectState::Dormant);
}

#[test]
fn chunks_look_as_their_entity_and_follow_it() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (knot, camera) = (scene.knot, scene.camera);
    let blue = scene
        .world()
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial::from_color(Color::srgb(0.1, 0.4, 0.9)));
    type Change = Box<dyn Fn(&mut World)>;
    let paint = scene.paint.clone();
    let changes: Vec<Change> = vec![
        Box::new(|_| {}),
        Box::new(move |world| {
            world.entity_mut(knot).insert(MeshMaterial3d(blue.clone()));
        }),
        // In layers that the camera does not see, and again in those that it does.
        Box::new(move |world| {
            world.entity_mut(knot).insert(RenderLayers::layer(3));
        }),
        Box::new(move |world| {
            world
                .entity_mut(camera)
                .insert(RenderLayers::from_layers(&[0, 3]));
        }),
        Box::new(move |world| {
            world.entity_mut(knot).remove::<RenderLayers>();
        }),
        // Where it goes they go, and when it hides they hide.
        Box::new(move |world| {
            world
                .get_mut::<Transform>(knot)
                .expect("a place")
                .translation
                .x = 0.7;
        }),
        Box::new(move |world| {
            world.entity_mut(knot).insert(Visibility::Hidden);
        }),
        Box::new(move |world| {
            world.entity_mut(knot).insert(Visibility::Inherited);
        }),
        Box::new(move |world| {
            world
                .entity_mut(knot)
                .insert(bevy::light::NotShadowReceiver);
        }),
        // As it was.
        Box::new(move |world| {
            world
                .entity_mut(knot)
                .remove::<bevy::light::NotShadowReceiver>()
                .insert((
                    MeshMaterial3d(paint.clone()),
                    Transform::from_rotation(Quat::from_euler(EulerRot::XYZ, 0.4, 0.8, 0.2)),
                ));
            world.entity_mut(camera).remove::<RenderLayers>();
        }),
    ];
    let all = |scene: &mut Scene| -> Vec<(image::RgbaImage, SphericalCounts)> {
        changes
            .iter()
            .map(|change| {
                change(scene.world());
                let picture = scene.picture();
                let counts = scene.offline.app.world().get(knot).copied();
                (picture, counts.unwrap_or_default())
            })
            .collect()
    };
    let whole = all(&mut scene);
    scene.index(settings());
    let by_chunks = all(&mut scene);
    for (at, ((whole, _), (by_chunks, counts))) in whole.iter().zip(&by_chunks).enumerate() {
        assert_eq!(differing_px(whole, by_chunks), 0, "after change {at}");
        let is_seen = ![2, 6].contains(&at);
        assert_eq!(
            counts.views_by_chunks,
            u32::from(is_seen),
            "after change {at}"
        );
    }
    // Most changes show.
    let showing = whole
        .windows(2)
        .filter(|pair| differing_px(&pair[0].0, &pair[1].0) > 50);
    assert!(showing.count() >= 7);
}

#[test]
fn an_edited_mesh_is_indexed_anew_and_never_drawn_as_it_was() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    scene.index(settings());
    let knot = scene.knot;
    let handle = scene.world().get::<Mesh3d>(knot).expect("a mesh").0.clone();
    let edit = |scene: &mut Scene| {
        let mut meshes = scene.world().resource_mut::<Assets<Mesh>>();
        let mut mesh = meshes.get_mut(&handle).expect("a mesh");
        mesh.scale_by(Vec3::new(1.0, 0.5, 1.0));
    };
    edit(&mut scene);
    // In this very frame it is drawn whole, as it is now.
    scene.offline.step();
    assert_eq!(scene.counts(), SphericalCounts::default());
    let first = scene.offline.picture(&scene.target).expect("a picture");
    scene.until("triangles are drawn");
    assert_eq!(scene.counts().views_by_chunks, 1);
    assert_eq!(differing_px(&scene.picture(), &first), 0);
    // Another mesh.
    let other = scene
        .world()
        .resource_mut::<Assets<Mesh>>()
        .add(knot_of(120));
    scene.world().entity_mut(knot).insert(Mesh3d(other));
    scene.until(&format!("of {} triangles are drawn", 120 * KNOT.1 * 2));
}

/// Water, say: no work is begun for what is of no use a frame later.
#[test]
fn a_mesh_that_is_edited_in_every_frame_is_left_alone() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    scene.index(settings());
    let knot = scene.knot;
    let handle = scene.world().get::<Mesh3d>(knot).expect("a mesh").0.clone();
    for frame in 0..40 {
        let mut meshes = scene.world().resource_mut::<Assets<Mesh>>();
        let mut mesh = meshes.get_mut(&handle).expect("a mesh");
        mesh.scale_by(Vec3::splat(if frame % 2 == 0 { 1.01 } else { 1.0 / 1.01 }));
        drop(mesh);
        scene.offline.step();
        let told = scene.state();
        assert!(told.to_string().contains("to be left alone"), "{told}");
        assert_eq!(scene.chunks(), []);
    }
    scene.until("triangles are drawn");
}

fn knot_of(rings: u32) -> Mesh {
    knot(rings, KNOT.1)
}

#[test]
fn what_cannot_be_indexed_is_drawn_whole_and_why_is_said() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (knot, paint) = (scene.knot, scene.paint.clone());
    let check = |scene: &mut Scene, what: &str| {
        scene.until(what);
        println!("{}", scene.state());
        assert_eq!(scene.chunks(), []);
    };
    scene.world().entity_mut(knot).insert(settings());
    scene.until("triangles are drawn");
    let blend = |scene: &mut Scene, mode| {
        let mut materials = scene.world().resource_mut::<Assets<StandardMaterial>>();
        materials.get_mut(&paint).expect("a material").alpha_mode = mode;
    };
    blend(&mut scene, AlphaMode::Blend);
    check(
        &mut scene,
        "1 mesh is drawn whole, with a blended or transmitting material",
    );
    blend(&mut scene, AlphaMode::Opaque);
    scene.until("triangles are drawn");
    let mut far = knot_of(100);
    far.asset_usage = RenderAssetUsages::RENDER_WORLD;
    let small = Cuboid::from_length(1.0).mesh().build();
    let strip = Mesh::new(
        PrimitiveTopology::TriangleStrip,
        RenderAssetUsages::default(),
    )
    .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, vec![[0.0_f32, 1.0, 0.0]; 5000])
    .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, vec![[0.0_f32, 1.0, 0.0]; 5000]);
    let mut broken = knot_of(100);
    if let Some(bevy::mesh::VertexAttributeValues::Float32x3(positions)) =
        broken.attribute_mut(Mesh::ATTRIBUTE_POSITION)
    {
        positions[7] = [f32::NAN; 3];
    }
    for (mesh, why) in [
        (far, "RenderAssetUsages::MAIN_WORLD"),
        (small, "of no more triangles than a chunk"),
        (strip, "not of triangle lists"),
        (broken, "is not a finite number"),
    ] {
        let mesh = scene.world().resource_mut::<Assets<Mesh>>().add(mesh);
        scene.world().entity_mut(knot).insert(Mesh3d(mesh));
        check(&mut scene, why);
    }
    let mesh = scene
        .world()
        .resource_mut::<Assets<Mesh>>()
        .add(knot_of(100));
    scene.world().entity_mut(knot).insert(Mesh3d(mesh));
    scene.until("triangles are drawn");
    scene
        .world()
        .entity_mut(knot)
        .remove::<MeshMaterial3d<StandardMaterial>>();
    check(&mut scene, "register_spherical_material");
}

#[test]
fn a_material_of_another_kind_is_announced() {
    let offline = crate::device_with(|app| {
        app.add_plugins(ObjectIdPlugin)
            .register_spherical_material::<ObjectIdMaterial>(|_| Some(Face::Back));
    });
    let Some(mut scene) = offline.map(Scene::with) else {
        return;
    };
    let knot = scene.knot;
    let paint = scene
        .world()
        .resource_mut::<Assets<ObjectIdMaterial>>()
        .add(ObjectIdMaterial {});
    scene
        .world()
        .entity_mut(knot)
        .remove::<MeshMaterial3d<StandardMaterial>>()
        .insert((MeshMaterial3d(paint), MeshTag(0x00ff_7f3f)));
    let shares = scene.same_from(&AROUND, settings());
    println!("{shares:.3?}");
    assert!(shares.iter().all(|share| *share < 0.85));
}

#[test]
fn what_an_interior_hides_and_what_is_indexed_get_along() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    // The knot in a closed box, both below a root.
    let (knot, paint) = (scene.knot, scene.paint.clone());
    let hull = scene
        .world()
        .resource_mut::<Assets<Mesh>>()
        .add(Cuboid::from_length(5.0).mesh().build());
    let root = scene
        .world()
        .spawn((Transform::default(), Visibility::default()))
        .id();
    let hull = scene
        .world()
        .spawn((Mesh3d(hull), MeshMaterial3d(paint), ChildOf(root)))
        .id();
    scene.world().entity_mut(knot).insert(ChildOf(root));
    scene.look(Vec3::new(2.0, 3.0, 9.0));
    scene.index(settings());
    let before = scene.picture();
    scene.world().entity_mut(root).insert(InteriorCulling {
        grid: InteriorGrid::Resolution(48),
        ..default()
    });
    let interior = |scene: &Scene| {
        scene
            .offline
            .app
            .world()
            .resource::<Effects>()
            .interior()
            .to_string()
    };
    let mut quiet = 0;
    for _ in 0..5_000 {
        scene.offline.step();
        quiet += u32::from(interior(&scene).contains("1 of 2 nodes"));
        if quiet > 40 {
            break;
        }
        std::thread::sleep(core::time::Duration::from_millis(1));
    }
    assert!(quiet > 40, "{}", interior(&scene));
    // Nothing of the knot is drawn, whole or in chunks, and the picture is the box as before.
    assert_eq!(
        (scene.counts().views, scene.counts().drawn_triangles),
        (0, 0)
    );
    assert_eq!(differing_px(&scene.picture(), &before), 0);
    scene.world().despawn(hull);
    scene.offline.step();
    assert_eq!(scene.counts().views, 1);
}

#[test]
fn as_published_less_is_drawn_and_some_of_it_is_missing() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let plain = scene.pictures(&AROUND);
    scene.index(SphericalIndex {
        mode: SphericalMode::Paper,
        chunk_cost: 0,
        ..settings()
    });
    let paper = scene.pictures(&AROUND);
    let missing: Vec<_> = plain
        .iter()
        .zip(&paper)
        .map(|((plain, _), (paper, share))| (differing_px(plain, paper), *share))
        .collect();
    println!("{missing:.3?}");
    assert!(missing.iter().any(|(px, _)| *px > 0));
    assert!(missing.iter().all(|(_, share)| *share < 1.0));
}
