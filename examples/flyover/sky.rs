//! Sun, sky, haze and sea at any time of the day, all from the sun's direction.

use core::f32::consts::FRAC_PI_2;

use bevy::{
    camera::visibility::NoFrustumCulling,
    core_pipeline::prepass::DepthPrepass,
    light::{
        AmbientLight, CascadeShadowConfigBuilder, NotShadowCaster, NotShadowReceiver, SunDisk,
    },
    mesh::VertexAttributeValues,
    pbr::{DistanceFog, FogFalloff},
    prelude::*,
    render::view::{ColorGrading, ColorGradingGlobal, ColorGradingSection},
};
use bevy_skyline::{
    contribution::NoContributionCulling, occlusion::NoOcclusionCulling, terrain::HeightField,
};

use super::{
    coast::smooth,
    shape::Shape,
    texture::{Texels, image, unit},
    town::Facades,
};

/// How far one sees. units: m
const VISIBILITY_M: f32 = 42_000.0;
/// From the middle of the scene to the dome. units: m
const DOME_M: f32 = 90_000.0;
/// Where pictures begin. units: m
pub const NEAR_M: f32 = 0.5;
/// The sea stands a little higher than height 0, where real data have it flat. units: m
pub const SEA_M: f32 = 0.6;
/// Width of a texture of waves. units: m
const WAVES_M: f32 = 110.0;

/// Where the sun is. Its change is followed.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct Sun {
    /// From +X toward +Z. units: rad
    pub azimuth: f32,
    /// Above the horizon. units: rad
    pub elevation: f32,
}

impl Sun {
    /// The direction to it.
    pub fn direction(&self) -> Vec3 {
        let (sin, cos) = self.elevation.sin_cos();
        let flat = Vec2::from_angle(self.azimuth) * cos;
        Vec3::new(flat.x, sin, flat.y)
    }
}

/// What depends on the sun's height alone.
#[derive(Clone, Copy, Debug)]
struct Hour {
    elevation_deg: f32,
    sun: [f32; 3],
    sun_lux: f32,
    ambient: [f32; 3],
    ambient_nits: f32,
    zenith: [f32; 3],
    horizon: [f32; 3],
    glow: [f32; 3],
    windows: f32,
}

/// From night to day.
const HOURS: [Hour; 6] = [
    Hour {
        elevation_deg: -7.0,
        sun: [1.0, 0.35, 0.15],
        sun_lux: 0.0,
        ambient: [0.42, 0.50, 1.0],
        ambient_nits: 150.0,
        zenith: [0.010, 0.020, 0.070],
        horizon: [0.085, 0.080, 0.125],
        glow: [0.25, 0.08, 0.04],
        windows: 0.8,
    },
    Hour {
        elevation_deg: -0.5,
        sun: [1.0, 0.40, 0.17],
        sun_lux: 500.0,
        ambient: [0.52, 0.56, 1.0],
        ambient_nits: 380.0,
        zenith: [0.035, 0.075, 0.24],
        horizon: [0.42, 0.27, 0.24],
        glow: [1.1, 0.36, 0.10],
        windows: 0.5,
    },
    Hour {
        elevation_deg: 4.0,
        sun: [1.0, 0.56, 0.29],
        sun_lux: 4_800.0,
        ambient: [0.62, 0.68, 1.0],
        ambient_nits: 640.0,
        zenith: [0.065, 0.14, 0.42],
        horizon: [0.78, 0.52, 0.38],
        glow: [1.3, 0.58, 0.19],
        windows: 0.14,
    },
    Hour {
        elevation_deg: 11.0,
        sun: [1.0, 0.75, 0.50],
        sun_lux: 8_200.0,
        ambient: [0.68, 0.76, 1.0],
        ambient_nits: 820.0,
        zenith: [0.085, 0.20, 0.58],
        horizon: [0.84, 0.72, 0.60],
        glow: [0.9, 0.52, 0.22],
        windows: 0.0,
    },
    Hour {
        elevation_deg: 24.0,
        sun: [1.0, 0.90, 0.74],
        sun_lux: 10_000.0,
        ambient: [0.72, 0.80, 1.0],
        ambient_nits: 950.0,
        zenith: [0.095, 0.25, 0.72],
        horizon: [0.76, 0.84, 0.92],
        glow: [0.55, 0.42, 0.26],
        windows: 0.0,
    },
    Hour {
        elevation_deg: 50.0,
        sun: [1.0, 0.96, 0.90],
        sun_lux: 11_000.0,
        ambient: [0.74, 0.82, 1.0],
        ambient_nits: 1_050.0,
        zenith: [0.10, 0.28, 0.80],
        horizon: [0.72, 0.88, 1.05],
        glow: [0.3, 0.26, 0.2],
        windows: 0.0,
    },
];

impl Hour {
    fn at(elevation: f32) -> Self {
        let degrees = elevation.to_degrees();
        let above = HOURS.iter().position(|hour| hour.elevation_deg > degrees);
        let above = above.unwrap_or(HOURS.len() - 1).max(1);
        let (a, b) = (HOURS[above - 1], HOURS[above]);
        let share = (degrees - a.elevation_deg) / (b.elevation_deg - a.elevation_deg);
        let share = share.clamp(0.0, 1.0);
        let mix = |a: f32, b: f32| a + (b - a) * share;
        let mix3 = |a: [f32; 3], b: [f32; 3]| [0, 1, 2].map(|i| mix(a[i], b[i]));
        Self {
            elevation_deg: degrees,
            sun: mix3(a.sun, b.sun),
            sun_lux: mix(a.sun_lux, b.sun_lux),
            ambient: mix3(a.ambient, b.ambient),
            ambient_nits: mix(a.ambient_nits, b.ambient_nits),
            zenith: mix3(a.zenith, b.zenith),
            horizon: mix3(a.horizon, b.horizon),
            glow: mix3(a.glow, b.glow),
            windows: mix(a.windows, b.windows),
        }
    }
}

fn linear([r, g, b]: [f32; 3]) -> LinearRgba {
    LinearRgba::rgb(r, g, b)
}

/// The dome, and the sun on it.
#[derive(Resource)]
struct Dome {
    mesh: Handle<Mesh>,
    /// Directions of its vertices.
    ways: Vec<Vec3>,
    sphere: Entity,
    disk: Entity,
    disk_paint: Handle<StandardMaterial>,
}

/// On the one light.
#[derive(Component)]
pub struct Sunlight;

/// On what is drawn behind all else, and is not to be culled.
fn backdrop() -> impl Bundle {
    (
        NotShadowCaster,
        NotShadowReceiver,
        NoFrustumCulling,
        NoContributionCulling,
        NoOcclusionCulling,
    )
}

/// Spawns light, dome and, if some ground lies below it, the sea.
pub fn spawn(world: &mut World, field: &HeightField, sun: Sun) {
    world.spawn((
        DirectionalLight {
            shadow_maps_enabled: true,
            ..default()
        },
        CascadeShadowConfigBuilder {
            num_cascades: 2,
            minimum_distance: 2.0,
            first_cascade_far_bound: 420.0,
            maximum_distance: 2_800.0,
            ..default()
        }
        .build(),
        // As large as ours, for the penumbrae.
        SunDisk::EARTH,
        Transform::default(),
        Sunlight,
    ));
    spawn_dome(world);
    if field.data_range_m().0 <= 0.0 {
        spawn_sea(world, field);
    }
    world.insert_resource(sun);
}

/// What a camera needs to see it.
pub fn lens() -> impl Bundle {
    (
        Projection::Perspective(PerspectiveProjection {
            fov: 52f32.to_radians(),
            near: NEAR_M,
            far: 4.0 * DOME_M,
            ..default()
        }),
        Msaa::Off,
        // A street has five walls behind each other: only the first is to be lit.
        DepthPrepass,
        AmbientLight::default(),
        DistanceFog::default(),
        ColorGrading::with_identical_sections(
            ColorGradingGlobal {
                exposure: 0.25,
                post_saturation: 1.22,
                ..default()
            },
            ColorGradingSection {
                contrast: 1.10,
                ..default()
            },
        ),
    )
}

fn spawn_dome(world: &mut World) {
    let mut dome = Sphere::new(1.0).mesh().uv(120, 80);
    // The sphere's poles lie on its z axis.
    dome.rotate_by(Quat::from_rotation_x(-FRAC_PI_2));
    let ways: Vec<Vec3> = match dome.attribute(Mesh::ATTRIBUTE_POSITION) {
        Some(VertexAttributeValues::Float32x3(places)) => {
            places.iter().map(|place| Vec3::from(*place)).collect()
        }
        _ => Vec::new(),
    };
    let colours = vec![[0.0, 0.0, 0.0, 1.0]; ways.len()];
    dome.insert_attribute(Mesh::ATTRIBUTE_COLOR, colours);
    let mut meshes = world.resource_mut::<Assets<Mesh>>();
    let mesh = meshes.add(dome);
    let ball = meshes.add(Sphere::new(1.0).mesh().uv(32, 18));
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    let unlit = StandardMaterial {
        unlit: true,
        fog_enabled: false,
        cull_mode: None,
        ..default()
    };
    let paint = materials.add(unlit.clone());
    let disk_paint = materials.add(unlit);
    let sphere = world
        .spawn((
            Mesh3d(mesh.clone()),
            MeshMaterial3d(paint),
            Transform::from_scale(Vec3::splat(DOME_M)),
            backdrop(),
        ))
        .id();
    let disk = world
        .spawn((
            Mesh3d(ball),
            MeshMaterial3d(disk_paint.clone()),
            Transform::default(),
            backdrop(),
        ))
        .id();
    world.insert_resource(Dome {
        mesh,
        ways,
        sphere,
        disk,
        disk_paint,
    });
}

/// Gives everything the colours of the hour, when the sun has moved.
pub fn follow_sun(world: &mut World) {
    let Some(sun) = world.get_resource_ref::<Sun>() else {
        return;
    };
    if !sun.is_changed() {
        return;
    }
    let sun = *sun;
    let hour = Hour::at(sun.elevation);
    let to_sun = sun.direction();
    let mut lights =
        world.query_filtered::<(&mut Transform, &mut DirectionalLight), With<Sunlight>>();
    for (mut transform, mut light) in lights.iter_mut(world) {
        *transform = Transform::default().looking_to(-to_sun, Vec3::Y);
        light.color = linear(hour.sun).into();
        light.illuminance = hour.sun_lux;
    }
    let horizon = linear(hour.horizon);
    let mut cameras = world.query::<(&mut Camera, &mut AmbientLight, &mut DistanceFog)>();
    for (mut camera, mut ambient, mut fog) in cameras.iter_mut(world) {
        camera.clear_color = bevy::camera::ClearColorConfig::Custom(horizon.into());
        ambient.color = linear(hour.ambient).into();
        ambient.brightness = hour.ambient_nits;
        let grey = Color::linear_rgb(0.72, 0.78, 0.86);
        *fog = DistanceFog {
            color: horizon.into(),
            directional_light_color: linear(hour.glow).with_alpha(0.5).into(),
            directional_light_exponent: 9.0,
            falloff: FogFalloff::from_visibility_colors(VISIBILITY_M, grey, grey),
        };
    }
    let windows = world
        .get_resource::<Facades>()
        .map(|facades| facades.0.clone());
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    for facade in windows.into_iter().flatten() {
        if let Some(mut facade) = materials.get_mut(&facade) {
            facade.emissive = LinearRgba::WHITE * hour.windows;
        }
    }
    world.resource_scope(|world, dome: Mut<Dome>| paint_dome(world, &dome, to_sun, &hour));
}

fn paint_dome(world: &mut World, dome: &Dome, to_sun: Vec3, hour: &Hour) {
    let (horizon, zenith, glow) = (linear(hour.horizon), linear(hour.zenith), linear(hour.glow));
    let shade = |way: &Vec3| {
        let up = way.y.max(0.0);
        let sky = horizon.mix(&zenith, (1.7 * up).min(1.0).powf(0.62));
        let near = way.dot(to_sun).max(0.0);
        // A wide glow along the horizon, and a bright one around the sun.
        let wide = 0.42 * near.powi(5) * (1.0 - up).powi(3);
        let bright = 0.5 * near.powi(40) + 1.2 * near.powi(400);
        (sky + glow * (wide + bright))
            .with_alpha(1.0)
            .to_f32_array()
    };
    if let Some(mut mesh) = world.resource_mut::<Assets<Mesh>>().get_mut(&dome.mesh)
        && let Some(VertexAttributeValues::Float32x4(colours)) =
            mesh.attribute_mut(Mesh::ATTRIBUTE_COLOR)
    {
        for (colour, way) in colours.iter_mut().zip(&dome.ways) {
            *colour = shade(way);
        }
    }
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    if let Some(mut paint) = materials.get_mut(&dome.disk_paint) {
        paint.base_color = (linear(hour.sun) * 6.0).with_alpha(1.0).into();
    }
}

/// Keeps the sky around the camera: it is as far away wherever one is.
pub fn follow_camera(world: &mut World, camera: Entity) {
    let Some(eye) = world
        .get::<Transform>(camera)
        .map(|camera| camera.translation)
    else {
        return;
    };
    let Some(dome) = world.get_resource::<Dome>() else {
        return;
    };
    let (sphere, disk) = (dome.sphere, dome.disk);
    let Some(to_sun) = world.get_resource::<Sun>().map(Sun::direction) else {
        return;
    };
    let away = 0.97 * DOME_M;
    if let Some(mut sphere) = world.get_mut::<Transform>(sphere) {
        sphere.translation = eye;
    }
    if let Some(mut disk) = world.get_mut::<Transform>(disk) {
        *disk =
            Transform::from_translation(eye + to_sun * away).with_scale(Vec3::splat(0.008 * away));
    }
}

/// A sheet over the field, clear where it is shallow, and on to the horizon.
fn spawn_sea(world: &mut World, field: &HeightField) {
    const CELLS: u32 = 256;
    let extent = field.extent_m();
    let mut shape = Shape::default();
    let colour = |at: Vec2| {
        let deep = field.height_at(at).map_or(60.0, |height| SEA_M - height);
        let shallow = LinearRgba::rgb(0.030, 0.170, 0.165);
        let dark = LinearRgba::rgb(0.004, 0.030, 0.052);
        let share = smooth(0.0, 26.0, deep);
        shallow
            .mix(&dark, share)
            .with_alpha(0.35 + 0.64 * smooth(0.0, 11.0, deep))
    };
    let place = |x: u32, z: u32| Vec2::new(x as f32, z as f32) / CELLS as f32 * extent;
    for z in 0..CELLS {
        for x in 0..CELLS {
            let corners = [(0, 0), (0, 1), (1, 1), (1, 0)].map(|(dx, dz)| place(x + dx, z + dz));
            // Not under land.
            let wet = |at: Vec2| {
                field
                    .height_at(at)
                    .is_none_or(|height| height < SEA_M + 6.0)
            };
            if corners.iter().any(|at| wet(*at)) {
                shape.sheet(corners, SEA_M, WAVES_M, colour);
            }
        }
    }
    let far = 1.2 * DOME_M;
    let (low, high) = (Vec2::ZERO, extent);
    let rim = |x: f32, z: f32| Vec2::new(x, z);
    for corners in [
        [
            rim(-far, -far),
            rim(-far, low.y),
            rim(far, low.y),
            rim(far, -far),
        ],
        [
            rim(-far, high.y),
            rim(-far, far),
            rim(far, far),
            rim(far, high.y),
        ],
        [
            rim(-far, low.y),
            rim(-far, high.y),
            rim(low.x, high.y),
            rim(low.x, low.y),
        ],
        [
            rim(high.x, low.y),
            rim(high.x, high.y),
            rim(far, high.y),
            rim(far, low.y),
        ],
    ] {
        shape.sheet(corners, SEA_M, WAVES_M, |_| {
            LinearRgba::rgb(0.004, 0.030, 0.052).with_alpha(0.99)
        });
    }
    let mut mesh = shape.mesh();
    let count = mesh.count_vertices();
    mesh.insert_attribute(Mesh::ATTRIBUTE_TANGENT, vec![[1.0, 0.0, 0.0, 1.0]; count]);
    let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
    let waves = world.resource_mut::<Assets<Image>>().add(waves());
    let paint = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            normal_map_texture: Some(waves),
            perceptual_roughness: 0.14,
            reflectance: 0.2,
            alpha_mode: AlphaMode::Blend,
            ..default()
        });
    world.spawn((
        Mesh3d(mesh),
        MeshMaterial3d(paint.clone()),
        NotShadowCaster,
        NoContributionCulling,
        NoOcclusionCulling,
    ));
    world.insert_resource(Sea(paint));
}

/// The sea's look.
#[derive(Resource)]
pub struct Sea(Handle<StandardMaterial>);

/// Lets waves run.
pub fn run_waves(world: &mut World, time_s: f32) {
    let Some(sea) = world.get_resource::<Sea>().map(|sea| sea.0.clone()) else {
        return;
    };
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    if let Some(mut sea) = materials.get_mut(&sea) {
        let drift = Vec2::new(0.011, 0.017) * time_s;
        sea.uv_transform.translation = drift.rem_euclid(Vec2::ONE);
    }
}

/// Normals of waves that run in all directions, and fit together at the edges.
fn waves() -> Image {
    const SIDE: u32 = 512;
    let height = |x: f32, y: f32| {
        let mut sum = 0.0;
        for wave in 0..40 {
            let draw = |salt: u32| unit(wave, 1, 300 + salt);
            let period = 3 + wave * wave / 28;
            let angle = core::f32::consts::TAU * draw(0);
            // Whole waves fit on the side.
            let k = (Vec2::from_angle(angle) * period as f32).round();
            let phase = core::f32::consts::TAU * (k.x * x + k.y * y + draw(1));
            sum += phase.sin() / k.length().max(1.0).powf(1.3);
        }
        sum
    };
    let mut normals = Vec::new();
    let step = 1.0 / SIDE as f32;
    for row in 0..SIDE {
        for column in 0..SIDE {
            let (x, y) = (column as f32 * step, row as f32 * step);
            let slope = Vec2::new(
                height(x + step, y) - height(x - step, y),
                height(x, y + step) - height(x, y - step),
            ) * (0.5 * SIDE as f32 * 0.0035);
            let normal = Vec3::new(-slope.x, -slope.y, 1.0).normalize();
            let byte = |v: f32| ((0.5 + 0.5 * v) * 255.0 + 0.5) as u8;
            normals.extend([byte(normal.x), byte(normal.y), byte(normal.z), 255]);
        }
    }
    image(UVec2::splat(SIDE), Texels::Normals, normals, true)
}
