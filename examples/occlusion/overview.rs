//! The city from above, in a corner of the picture: what the camera draws and what it leaves out, by colour.

use bevy::{
    camera::{
        ClearColorConfig, ScalingMode, Viewport,
        primitives::{Aabb, MeshAabb},
        visibility::RenderLayers,
    },
    core_pipeline::tonemapping::{DebandDither, Tonemapping},
    prelude::*,
};
use bevy_skyline::{
    offline::{glyphs, scenes::Scene},
    prelude::{CullReason, Culling},
};

/// The layer that only the camera from above sees.
const LAYER: usize = 1;
/// Objects that are narrower are not shown. units: m
const LEAST_M: f32 = 3.0;
/// Side of the square that is shown. units: m
const SHOWN_M: f32 = 1_100.0;
/// From the highest roof to the camera that looks down. units: m
const ABOVE_M: f32 = 200.0;
/// From the camera to the middle of what is shown. units: m
const AHEAD_M: f32 = 320.0;

/// Colours of what is drawn, hidden and out of view.
const PAINTS: [LinearRgba; 3] = [
    LinearRgba::rgb(0.06, 0.60, 0.10),
    LinearRgba::rgb(0.80, 0.05, 0.04),
    LinearRgba::rgb(0.16, 0.17, 0.19),
];

/// On the camera from above.
#[derive(Component)]
pub struct Overview;

/// On the arrow that shows where the camera is.
#[derive(Component)]
struct Arrow;

/// Why an object is drawn or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Drawn,
    Hidden,
    OutOfView,
}

/// How many objects were drawn in the last frame, and why the others were not.
#[derive(Resource, Default, Clone, Copy, Debug)]
pub struct Tally {
    pub drawn: usize,
    pub hidden: usize,
    pub out_of_view: usize,
}

/// What the colours are made from.
#[derive(Resource)]
pub struct Map {
    camera: Entity,
    /// An object, its twin if it has one, and its state when that was last coloured.
    objects: Vec<(Entity, Option<Entity>, State)>,
    /// Above all roofs, and below the camera. units: m
    arrow_y: f32,
    paints: [Handle<StandardMaterial>; 3],
}

/// Colours the map after each frame's visibility is settled.
pub struct OverviewPlugin;

impl Plugin for OverviewPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Tally>()
            .add_systems(Last, (colour, follow).run_if(resource_exists::<Map>));
    }
}

/// A twin of each object in a flat colour, and the camera that sees them.
pub fn spawn(world: &mut World, scene: &Scene, entities: &[Entity], camera: Entity, size: UVec2) {
    let flat = |world: &mut World, colour: LinearRgba| {
        world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial {
                base_color: colour.into(),
                unlit: true,
                ..default()
            })
    };
    let paints = PAINTS.map(|paint| flat(world, paint));
    let floor = flat(world, LinearRgba::rgb(0.02, 0.02, 0.03));
    let white = flat(world, LinearRgba::WHITE);
    let mut meshes = world.resource_mut::<Assets<Mesh>>();
    let ground = meshes.add(Plane3d::default().mesh().size(1e5, 1e5));
    let cone = meshes.add(Cone::new(28.0, 90.0));
    let boxes: Vec<Option<Aabb>> = scene.meshes.iter().map(MeshAabb::compute_aabb).collect();
    let layer = RenderLayers::layer(LAYER);
    let [low, high] = scene.bounds;
    let objects = scene
        .objects
        .iter()
        .zip(entities)
        .map(|(object, &entity)| {
            let shown = boxes[object.mesh].filter(|aabb| {
                let size = 2.0 * aabb.half_extents;
                // Not the ground, not what drives about, and nothing too small to be made out.
                object.shuttle.is_none()
                    && size.y > 0.1
                    && size.x.min(size.z) * object.transform.scale.x > LEAST_M
            });
            let mesh = world.get::<Mesh3d>(entity).filter(|_| shown.is_some());
            let twin = mesh.cloned().map(|mesh| {
                let paint = MeshMaterial3d(paints[2].clone());
                let parts = (mesh, paint, object.transform, layer.clone());
                world.spawn(parts).id()
            });
            (entity, twin, State::OutOfView)
        })
        .collect();
    world.spawn((
        Mesh3d(ground),
        MeshMaterial3d(floor),
        Transform::from_xyz(0.0, low.y - 1.0, 0.0),
        layer.clone(),
    ));
    world.spawn((
        Mesh3d(cone),
        MeshMaterial3d(white),
        Transform::default(),
        layer.clone(),
        Arrow,
    ));
    let side = (size.min_element() / 2).max(1);
    world.spawn((
        Camera3d::default(),
        Camera {
            order: 1,
            clear_color: ClearColorConfig::None,
            viewport: Some(Viewport {
                physical_position: UVec2::new(size.x.saturating_sub(side), 0),
                physical_size: UVec2::splat(side),
                ..default()
            }),
            ..default()
        },
        Projection::Orthographic(OrthographicProjection {
            scaling_mode: ScalingMode::Fixed {
                width: SHOWN_M,
                height: SHOWN_M,
            },
            far: 4.0 * (high.y - low.y) + 1_000.0,
            ..OrthographicProjection::default_3d()
        }),
        Msaa::Off,
        // The colours of the legend, to the letter.
        Tonemapping::None,
        DebandDither::Disabled,
        Transform::from_xyz(0.0, high.y + ABOVE_M, 0.0).looking_to(Vec3::NEG_Y, Vec3::NEG_Z),
        layer,
        Overview,
    ));
    world.insert_resource(Map {
        camera,
        objects,
        arrow_y: high.y + 0.5 * ABOVE_M,
        paints,
    });
}

/// Whether an object was drawn, and if not, why: as any game may ask.
///
/// What Bevy's own occlusion culling removes, the GPU alone knows; it counts as drawn.
fn state_of(culling: &Culling, camera: Entity, object: Entity) -> State {
    match culling.reason(camera, object) {
        None => State::Drawn,
        Some(CullReason::Occluded) => State::Hidden,
        Some(_) => State::OutOfView,
    }
}

/// Colours what has changed its state since it was last coloured, and counts.
pub fn colour(
    mut map: ResMut<Map>,
    mut tally: ResMut<Tally>,
    culling: Culling,
    mut twins: Query<&mut MeshMaterial3d<StandardMaterial>>,
) {
    *tally = Tally::default();
    let Map {
        camera,
        objects,
        paints,
        ..
    } = &mut *map;
    for (entity, twin, last) in objects {
        let state = state_of(&culling, *camera, *entity);
        let (count, paint) = match state {
            State::Drawn => (&mut tally.drawn, &paints[0]),
            State::Hidden => (&mut tally.hidden, &paints[1]),
            State::OutOfView => (&mut tally.out_of_view, &paints[2]),
        };
        *count += 1;
        if state != *last {
            *last = state;
            if let Some(mut material) = twin.and_then(|twin| twins.get_mut(twin).ok()) {
                material.0 = paint.clone();
            }
        }
    }
}

/// Keeps what lies ahead of the camera in the middle of the map, and its arrow where it looks.
fn follow(
    map: Res<Map>,
    places: Query<&GlobalTransform>,
    mut above: Query<&mut Transform, (With<Overview>, Without<Arrow>)>,
    mut arrows: Query<&mut Transform, With<Arrow>>,
) {
    let Ok(place) = places.get(map.camera) else {
        return;
    };
    let (at, ahead) = (place.translation(), place.forward());
    let level = Vec3::new(ahead.x, 0.0, ahead.z).normalize_or(Vec3::NEG_Z);
    for mut camera in &mut above {
        camera.translation = (at + AHEAD_M * level).with_y(camera.translation.y);
    }
    for mut arrow in &mut arrows {
        // A cone's tip is up.
        *arrow = Transform::from_translation(at.with_y(map.arrow_y) + 30.0 * level)
            .with_rotation(Quat::from_rotation_arc(Vec3::Y, level));
    }
}

/// Writes what the colours stand for, and how many objects there are of each, below the map in its picture.
pub fn legend(picture: &mut image::RgbImage, tally: &Tally) {
    let (width, height) = picture.dimensions();
    let side = width.min(height) / 2;
    let scale = (height / 360).max(1);
    let line = 12 * scale;
    let entries = [
        format!("{} drawn", tally.drawn),
        format!("{} hidden", tally.hidden),
        format!("{} out of view", tally.out_of_view),
    ];
    let (left, top) = (width - side, side);
    let bottom = (top + line * entries.len() as u32 + 4 * scale).min(height);
    for (x, y) in (top..bottom).flat_map(|y| (left..width).map(move |x| (x, y))) {
        picture.put_pixel(x, y, image::Rgb([16, 17, 20]));
    }
    let mut fill = |x: u32, y: u32, size: u32, colour: [u8; 3]| {
        for (x, y) in (y..y + size).flat_map(|y| (x..x + size).map(move |x| (x, y))) {
            if let Some(pixel) = picture.get_pixel_mut_checked(x, y) {
                pixel.0 = colour;
            }
        }
    };
    for (index, (entry, paint)) in entries.iter().zip(PAINTS).enumerate() {
        let y = top + 4 * scale + index as u32 * line;
        let [red, green, blue, _] = Srgba::from(paint).to_u8_array();
        fill(left + 4 * scale, y, 8 * scale, [red, green, blue]);
        glyphs::for_each_dot(entry, |dot_x, dot_y| {
            let at = |start: u32, dot: i32| start + dot.max(0) as u32 * scale;
            fill(at(left + 16 * scale, dot_x), at(y, dot_y), scale, [235; 3]);
        });
    }
}
