//! Occlusion culling in a headless app: what it draws is, pixel by pixel, what is drawn without it.

use bevy::{
    camera::Viewport,
    core_pipeline::prepass::{DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass},
    material::OpaqueRendererMethod,
    pbr::DefaultOpaqueRendererMethod,
    prelude::*,
};
use bevy_skyline::{
    offline::{Offline, scenes::compare::differing_px},
    prelude::*,
};

pub const SIZE: UVec2 = UVec2::new(160, 120);

/// Frames of a deferred camera's motion: Mesa 22's software driver has no room for all shaders of such a scene at once,
/// compiles some of them anew in each frame and keeps 200 MB of each.
const DEFERRED: usize = 24;

/// A scene that two cameras see from the same place: one culls, the other does not.
pub struct Scene {
    pub offline: Offline,
    pub culling: Entity,
    pub plain: Entity,
    pub pictures: [Handle<Image>; 2],
    pub wall: Entity,
    pub boxes: Vec<Entity>,
}

/// A position of the camera, and what it looks at.
pub fn eye(from: Vec3, at: Vec3) -> Transform {
    Transform::from_translation(from).looking_at(at, Vec3::Y)
}

impl Scene {
    /// A wall across the view, and behind it a field of boxes, each of its own colour, some alone, some in groups.
    pub fn new<B: Bundle>(settings: ZBufferOcclusion, camera: impl Fn() -> B) -> Option<Self> {
        Some(Self::within(crate::device()?, settings, camera))
    }

    /// The same in an app that is there already.
    pub fn within<B: Bundle>(
        mut offline: Offline,
        settings: ZBufferOcclusion,
        camera: impl Fn() -> B,
    ) -> Self {
        let pictures = [offline.target(SIZE), offline.target(SIZE)];
        let place = eye(Vec3::new(0.0, 2.0, 20.0), Vec3::new(0.0, 2.0, 0.0));
        let culling = offline.camera(&pictures[0], (place, camera(), settings));
        let plain = offline.camera(&pictures[1], (place, camera()));
        let world = offline.app.world_mut();
        let cube = world
            .resource_mut::<Assets<Mesh>>()
            .add(Cuboid::from_length(1.0));
        let colour = |world: &mut World, i: usize| {
            let hue = (i * 47 % 360) as f32;
            world
                .resource_mut::<Assets<StandardMaterial>>()
                .add(StandardMaterial {
                    base_color: Color::hsl(hue, 0.9, 0.5),
                    alpha_mode: if i % 7 == 3 {
                        AlphaMode::Mask(0.5)
                    } else {
                        AlphaMode::Opaque
                    },
                    ..default()
                })
        };
        let grey = colour(world, 0);
        let wall = world
            .spawn((
                Mesh3d(cube.clone()),
                MeshMaterial3d(grey),
                Transform::from_xyz(0.0, 2.0, 10.0).with_scale(Vec3::new(14.0, 12.0, 0.3)),
            ))
            .id();
        world.spawn((
            DirectionalLight::default(),
            Transform::default().looking_to(Vec3::new(-1.0, -2.0, -1.5), Vec3::Y),
        ));
        let mut boxes = Vec::new();
        for row in 0..12 {
            let group = world
                .spawn((
                    Transform::from_xyz(0.0, 0.0, -3.0 * row as f32),
                    Visibility::default(),
                ))
                .id();
            for column in 0..15 {
                let material = colour(world, row * 15 + column);
                let place = Vec3::new(2.0 * (column as f32 - 7.0), (row * column % 4) as f32, 0.0);
                let mut new = world.spawn((Mesh3d(cube.clone()), MeshMaterial3d(material)));
                if row % 2 == 0 {
                    new.insert((Transform::from_translation(place), ChildOf(group)));
                } else {
                    new.insert(Transform::from_translation(
                        place - Vec3::Z * 3.0 * row as f32,
                    ));
                }
                boxes.push(new.id());
            }
        }
        Self {
            offline,
            culling,
            plain,
            pictures,
            wall,
            boxes,
        }
    }

    pub fn look(&mut self, place: Transform) {
        for camera in [self.culling, self.plain] {
            self.offline
                .app
                .world_mut()
                .entity_mut(camera)
                .insert(place);
        }
    }

    pub fn step(&mut self) -> OcclusionCounts {
        self.offline.step();
        *self
            .offline
            .app
            .world()
            .get::<OcclusionCounts>(self.culling)
            .expect("the camera culls")
    }

    /// Pixels that differ between the two pictures, and pixels that show anything at all.
    pub fn differing(&self) -> (usize, usize) {
        let [culled, plain] = [0, 1].map(|i| {
            self.offline
                .picture(&self.pictures[i])
                .expect("the picture can be read")
        });
        let background = *plain.get_pixel(0, 0);
        (
            differing_px(&culled, &plain) as usize,
            plain.pixels().filter(|p| **p != background).count(),
        )
    }
}

/// Culls, whether it pays or not.
pub fn always() -> ZBufferOcclusion {
    ZBufferOcclusion {
        rests: false,
        ..default()
    }
}

/// Steps through a fixed motion and compares every frame. Returns the most that were removed at once, and how many
/// were drawn late in all.
pub fn compare_motion(scene: &mut Scene, frames: usize) -> (u32, u32) {
    let (mut most, mut rescued, mut shown) = (0, 0, 0);
    let leg = (frames / 3).min(20);
    for frame in 0..frames {
        let t = frame as f32;
        // Forth and back, a spin, and a jump to the other side, every 20 frames where there are so many.
        let from = match frame / leg % 3 {
            0 => Vec3::new(0.3 * t % 9.0, 2.0, 20.0),
            1 => Vec3::new(4.0, 3.0, 20.0 - 0.8 * (t % 20.0)),
            _ => Vec3::new(-12.0, 6.0, -10.0 + t % 20.0),
        };
        let at = match frame / leg % 4 {
            3 => from + Quat::from_rotation_y(t * 0.5) * Vec3::NEG_Z,
            _ => Vec3::new(0.0, 2.0, -10.0),
        };
        scene.look(eye(from, at));
        let shift = Vec3::new(3.0 * (t * 0.4).sin(), 2.0, 10.0);
        let world = scene.offline.app.world_mut();
        if let Some(mut place) = world.get_mut::<Transform>(scene.wall) {
            place.translation = shift;
        }
        let moving = scene.boxes[frame % scene.boxes.len()];
        if let Some(mut place) = world.get_mut::<Transform>(moving) {
            place.translation.y += 1.0;
        }
        let counts = scene.step();
        most = most.max(counts.removed);
        rescued += counts.rescued;
        let (differing, drawn) = scene.differing();
        shown += drawn;
        assert_eq!(differing, 0, "pixels differ in frame {frame}, {counts:?}");
    }
    assert!(shown > 0, "the pictures show nothing");
    (most, rescued)
}

/// At rest and in motion. A frame behind the wall has at least `hidden` objects.
fn holds_in_motion<B: Bundle>(hidden: u32, frames: usize, camera: impl Fn() -> B) {
    let Some(mut scene) = Scene::new(always(), camera) else {
        return;
    };
    for _ in 0..6 {
        scene.step();
    }
    let counts = scene.step();
    println!("at rest: {counts:?}");
    assert!(counts.removed >= hidden, "{counts:?}");
    assert_eq!(scene.differing().0, 0);
    let (most, rescued) = compare_motion(&mut scene, frames);
    println!("in motion: at most {most} removed at once, {rescued} drawn late");
    assert!(most >= hidden && rescued > 0);
}

#[test]
fn nothing_is_missing_in_a_forward_camera() {
    holds_in_motion(170, 120, || Msaa::Off);
}

#[test]
fn nothing_is_missing_with_multisampling() {
    holds_in_motion(170, 60, || Msaa::Sample4);
}

#[test]
fn nothing_is_missing_after_a_depth_prepass() {
    holds_in_motion(170, 60, || (Msaa::Off, DepthPrepass));
}

#[test]
fn nothing_is_missing_after_a_normal_and_motion_prepass() {
    holds_in_motion(170, 60, || {
        (Msaa::Off, DepthPrepass, NormalPrepass, MotionVectorPrepass)
    });
}

#[test]
fn nothing_is_missing_in_a_viewport() {
    holds_in_motion(170, 60, || {
        (
            Msaa::Off,
            Camera {
                viewport: Some(Viewport {
                    physical_position: UVec2::new(37, 21),
                    physical_size: UVec2::new(101, 77),
                    ..default()
                }),
                ..default()
            },
        )
    });
}

#[test]
fn nothing_is_missing_in_an_orthographic_camera() {
    holds_in_motion(80, 60, || {
        (
            Msaa::Off,
            Projection::Orthographic(OrthographicProjection {
                scaling_mode: bevy::camera::ScalingMode::FixedVertical {
                    viewport_height: 12.0,
                },
                ..OrthographicProjection::default_3d()
            }),
        )
    });
}

/// What is drawn late is there when glass takes its picture of what lies behind it.
#[test]
fn nothing_is_missing_behind_glass() {
    let Some(mut scene) = Scene::new(always(), || Msaa::Off) else {
        return;
    };
    let world = scene.offline.app.world_mut();
    let pane = world
        .resource_mut::<Assets<Mesh>>()
        .add(Cuboid::new(40.0, 40.0, 0.2));
    let glass = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            specular_transmission: 1.0,
            perceptual_roughness: 0.0,
            ..default()
        });
    world.spawn((
        Mesh3d(pane),
        MeshMaterial3d(glass),
        Transform::from_xyz(0.0, 2.0, 13.0),
    ));
    for _ in 0..8 {
        scene.step();
    }
    let (most, rescued) = compare_motion(&mut scene, 60);
    assert!(most > 100 && rescued > 0, "{most} {rescued}");
}

#[test]
fn nothing_is_missing_in_a_deferred_camera() {
    let Some(mut scene) = Scene::new(always(), || (Msaa::Off, DepthPrepass, DeferredPrepass))
    else {
        return;
    };
    scene
        .offline
        .app
        .insert_resource(DefaultOpaqueRendererMethod::deferred());
    let world = scene.offline.app.world_mut();
    for (_, material) in world.resource_mut::<Assets<StandardMaterial>>().iter_mut() {
        material.opaque_render_method = OpaqueRendererMethod::Deferred;
    }
    for _ in 0..8 {
        scene.step();
    }
    let counts = scene.step();
    assert!(counts.removed > 100, "{counts:?}");
    let (most, rescued) = compare_motion(&mut scene, DEFERRED);
    assert!(most > 100 && rescued > 0, "{most} {rescued}");
}
