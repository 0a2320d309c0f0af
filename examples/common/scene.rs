//! A scene around any height field: a low sun, haze, and ordinary meshes that stand on the ground.

use core::f32::consts::TAU;

use bevy::{
    camera::ClearColorConfig,
    camera_controller::free_camera::FreeCamera,
    light::{
        AmbientLight, CascadeShadowConfigBuilder, NotShadowCaster, NotShadowReceiver, SunDisk,
    },
    mesh::VertexAttributeValues,
    pbr::{DistanceFog, FogFalloff},
    prelude::*,
};
use bevy_skyline::{offline::OfflineError, prelude::*};

use crate::stage::{Film, StageError};

/// The sky at the horizon, which distant ground fades into.
const HAZE: LinearRgba = LinearRgba::rgb(0.86, 1.00, 1.16);
/// The sky overhead.
const ZENITH: LinearRgba = LinearRgba::rgb(0.12, 0.32, 0.92);
/// Direction to the sun: low, and from the left of where the camera first looks.
const TO_SUN: Vec3 = Vec3::new(0.66, 0.44, -0.52);
/// Time for shadows in a frame that nobody waits for. units: ms
const SLICE_MS: f32 = 1_000.0;

/// Where to look from.
#[derive(Clone, Copy, Debug)]
pub struct Viewpoint {
    /// units: m
    pub eye: Vec3,
    /// units: m
    pub target: Vec3,
}

impl Viewpoint {
    /// A third of the way along the field's diagonal, above all ground near by, looking along the rest of it.
    pub fn over(field: &HeightField) -> Self {
        let extent = field.extent_m();
        let diagonal = diagonal_m(field);
        let (lowest, highest) = field.data_range_m();
        let range = (highest - lowest) as f32;
        let eye = extent / 3.0;
        let ground_near = highest_within(field, eye, 0.02 * diagonal);
        let height = ground_near + (0.05 * range).max(0.004 * diagonal);
        let ahead = extent * 0.62;
        let ground_ahead = highest_within(field, ahead, 0.02 * diagonal);
        // Level, or down as far as it takes to see the ground ahead.
        let target = ground_ahead.min(height - 0.15 * eye.distance(ahead));
        Self {
            eye: Vec3::new(eye.x, height, eye.y),
            target: Vec3::new(ahead.x, target, ahead.y),
        }
    }

    /// The camera that takes this view.
    fn transform(&self) -> Transform {
        let ahead = self.target - self.eye;
        let up = if ahead.xz().length() > 1e-3 * ahead.y.abs() {
            Vec3::Y
        } else {
            Vec3::NEG_Z
        };
        Transform::from_translation(self.eye).looking_at(self.target, up)
    }
}

/// From the lowest point of one corner to the highest of the other: what every length here is a share of.
fn diagonal_m(field: &HeightField) -> f32 {
    let (lowest, highest) = field.data_range_m();
    field.extent_m().extend((highest - lowest) as f32).length()
}

/// The highest ground within a distance, looked at in 17×17 places.
fn highest_within(field: &HeightField, centre: Vec2, distance: f32) -> f32 {
    places(centre, distance)
        .filter_map(|at| field.height_at(at))
        .reduce(f32::max)
        .unwrap_or_else(|| field.data_range_m().1 as f32)
}

fn places(centre: Vec2, distance: f32) -> impl Iterator<Item = Vec2> {
    let line = move || (-8..=8).map(move |i| distance * i as f32 / 8.0);
    line().flat_map(move |z| line().map(move |x| centre + Vec2::new(x, z)))
}

/// Fills an empty world with a terrain, its light, its meshes, and a camera with more components. Returns the place that
/// the meshes stand around.
pub fn populate(
    world: &mut World,
    field: HeightField,
    viewpoint: Viewpoint,
    on_camera: impl Bundle,
) -> Vec3 {
    let speed = 0.012 * diagonal_m(&field);
    let controls = FreeCamera {
        walk_speed: speed,
        run_speed: 5.0 * speed,
        friction: 8.0,
        ..default()
    };
    world.spawn((
        Camera3d::default(),
        camera(&field, viewpoint),
        controls,
        on_camera,
    ));
    let centre = spawn_meshes(world, &field, viewpoint);
    let extent = field.extent_m();
    let diagonal = diagonal_m(&field);
    spawn_sky(
        world,
        Vec3::new(0.5 * extent.x, viewpoint.eye.y, 0.5 * extent.y),
        8.0 * diagonal,
    );
    let handle = world.resource_mut::<Assets<HeightField>>().add(field);
    world.spawn((Terrain::new(handle), TerrainShadow::default()));
    world.spawn((
        DirectionalLight {
            color: Color::srgb(1.0, 0.86, 0.68),
            illuminance: 9_500.0,
            shadow_maps_enabled: true,
            ..default()
        },
        CascadeShadowConfigBuilder {
            num_cascades: 2,
            minimum_distance: 1e-4 * diagonal,
            first_cascade_far_bound: 0.06 * diagonal,
            maximum_distance: 0.2 * diagonal,
            ..default()
        }
        .build(),
        // As large as ours, for the penumbrae.
        SunDisk::EARTH,
        Transform::default().looking_to(-TO_SUN, Vec3::Y),
    ));
    centre
}

/// What a `Camera3d` needs to show a field.
fn camera(field: &HeightField, viewpoint: Viewpoint) -> impl Bundle {
    let diagonal = diagonal_m(field);
    (
        Camera {
            clear_color: ClearColorConfig::Custom(HAZE.into()),
            ..default()
        },
        // Bevy leaves out meshes beyond `far`; terrain has no such limit.
        Projection::Perspective(PerspectiveProjection {
            near: 5e-6 * diagonal,
            far: 20.0 * diagonal,
            ..default()
        }),
        Msaa::Off,
        viewpoint.transform(),
        AmbientLight {
            color: Color::srgb(0.74, 0.82, 1.0),
            brightness: 1_100.0,
            ..default()
        },
        DistanceFog {
            color: HAZE.into(),
            directional_light_color: Color::srgba(1.0, 0.88, 0.66, 0.35),
            directional_light_exponent: 12.0,
            falloff: FogFalloff::from_visibility_colors(
                0.9 * diagonal,
                Color::srgb(0.70, 0.76, 0.84),
                Color::srgb(0.70, 0.78, 0.90),
            ),
        },
    )
}

/// Draws frames until the terrain and its shadows are there.
pub fn settle(film: &mut Film) -> Result<(), StageError> {
    let world = film.world();
    let mut shadows = world.query::<&mut TerrainShadow>();
    for mut shadow in shadows.iter_mut(world) {
        shadow.slice_ms = SLICE_MS;
    }
    let mut cameras = world.query_filtered::<Entity, With<Camera3d>>();
    for camera in cameras.iter(world).collect::<Vec<_>>() {
        // Where only sky is in view nothing settles, and there is nothing to wait for either.
        match film.offline.settle(camera, 16) {
            Err(OfflineError::NotFinished(_)) if film.offline.counts().views_drawn == 0 => {}
            settled => settled?,
        }
    }
    if film.offline.counts().views_drawn > 0 {
        film.offline.settle_shadows(200)?;
    }
    Ok(())
}

/// A dome around everything, hazy at the horizon and blue above.
fn spawn_sky(world: &mut World, centre: Vec3, radius: f32) {
    let mut dome = Sphere::new(1.0).mesh().uv(48, 96);
    let shade = |&[.., up]: &[f32; 3]| HAZE.mix(&ZENITH, (up.max(0.0) * 1.8).min(1.0).powf(0.7));
    if let Some(VertexAttributeValues::Float32x3(places)) = dome.attribute(Mesh::ATTRIBUTE_POSITION)
    {
        let colours: Vec<_> = places.iter().map(|at| shade(at).to_f32_array()).collect();
        dome.insert_attribute(Mesh::ATTRIBUTE_COLOR, colours);
    }
    let dome = world.resource_mut::<Assets<Mesh>>().add(dome);
    let material = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            unlit: true,
            fog_enabled: false,
            cull_mode: None,
            ..default()
        });
    // The sphere's poles lie on its z axis.
    let upright = Quat::from_rotation_x(-core::f32::consts::FRAC_PI_2);
    let place = Transform::from_translation(centre)
        .with_rotation(upright)
        .with_scale(Vec3::splat(radius));
    world.spawn((
        Mesh3d(dome),
        MeshMaterial3d(material),
        place,
        NotShadowCaster,
        NotShadowReceiver,
    ));
}

/// Rings of pillars, boxes and spheres around a hill ahead: the ground hides some, and some hide the ground.
fn spawn_meshes(world: &mut World, field: &HeightField, viewpoint: Viewpoint) -> Vec3 {
    let diagonal = diagonal_m(field);
    let ahead = (viewpoint.target - viewpoint.eye)
        .xz()
        .normalize_or(Vec2::X);
    let near = viewpoint.eye.xz() + ahead * 0.08 * diagonal;
    let hills = || places(near, 0.035 * diagonal).filter_map(|at| Some((at, field.height_at(at)?)));
    let highest = |a: (Vec2, f32), b: (Vec2, f32)| if b.1 > a.1 { b } else { a };
    // The highest that can be seen, if any can.
    let seen = |&(at, ground): &(Vec2, f32)| {
        let way = Vec3::new(at.x, ground + 1e-3 * diagonal, at.y) - viewpoint.eye;
        Dir3::new(way).is_ok_and(|dir| field.ray_cast(viewpoint.eye, *dir, way.length()).is_none())
    };
    let centre = hills()
        .filter(seen)
        .reduce(highest)
        .or_else(|| hills().reduce(highest));
    let centre = centre.map_or(near, |(at, _)| at);
    let size = 2e-3 * diagonal;
    let mut meshes = world.resource_mut::<Assets<Mesh>>();
    let pillar = meshes.add(Cylinder::new(0.18 * size, 2.4 * size));
    let cube = meshes.add(Cuboid::from_length(0.9 * size));
    let ball = meshes.add(
        Sphere::new(0.5 * size)
            .mesh()
            .ico(5)
            .unwrap_or_else(|_| Sphere::new(0.5 * size).into()),
    );
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    let mut matt = |r, g, b| {
        materials.add(StandardMaterial {
            base_color: Color::srgb(r, g, b),
            perceptual_roughness: 0.8,
            ..default()
        })
    };
    // Mesh, its half width and half height, its colour, the ring it stands in and how many there are.
    let rings = [
        (pillar, 0.18, 1.2, matt(0.93, 0.90, 0.84), 3.4, 16),
        (ball, 0.5, 0.5, matt(0.85, 0.22, 0.16), 5.4, 12),
        (cube, 0.45, 0.45, matt(0.16, 0.36, 0.74), 7.6, 14),
    ];
    for (mesh, half_width, half_height, material, radius, count) in rings {
        for i in 0..count {
            let at = centre + radius * size * Vec2::from_angle(TAU * i as f32 / count as f32);
            // On the lowest ground under its foot, so that no corner hangs in the air.
            let foot = places(at, half_width * size).map(|place| field.height_at(place));
            let Some(ground) = foot.reduce(|a, b| Some(a?.min(b?))).flatten() else {
                continue;
            };
            world.spawn((
                Mesh3d(mesh.clone()),
                MeshMaterial3d(material.clone()),
                Transform::from_xyz(at.x, ground + half_height * size, at.y),
            ));
        }
    }
    let ground = field.height_at(centre).unwrap_or(viewpoint.target.y);
    Vec3::new(centre.x, ground, centre.y)
}
