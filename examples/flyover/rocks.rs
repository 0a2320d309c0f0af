//! Stacks of rock in the sea, each a mesh of many triangles of which a camera sees half: what the spherical index is
//! for. And ships that lie at anchor.

use bevy::{light::NotShadowReceiver, mesh::VertexAttributeValues, prelude::*};
use bevy_skyline::{spherical::SphericalIndex, terrain::HeightField};
use fastnoise_lite::{FastNoiseLite, FractalType, NoiseType};

use super::{shape::Shape, site::Site, texture::unit};

/// On a rock.
#[derive(Component)]
pub struct Rock;

/// Places across from the city's middle and beyond its shore, with heights of the rocks. units: m
const PLACES: [(f32, f32, f32); 5] = [
    (-520.0, 830.0, 125.0),
    (-390.0, 940.0, 66.0),
    (-660.0, 720.0, 52.0),
    (330.0, 880.0, 92.0),
    (430.0, 820.0, 40.0),
];

/// Spawns the rocks.
pub fn spawn(world: &mut World, field: &HeightField, site: &Site) {
    let mesh = world.resource_mut::<Assets<Mesh>>().add(rock());
    let paint = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            perceptual_roughness: 0.95,
            reflectance: 0.2,
            ..default()
        });
    for (index, (across, out, height)) in PLACES.into_iter().enumerate() {
        let at = site.at(across, site.shore_m + out);
        let ground = field.height_at(at).unwrap_or(0.0).max(-3.0);
        world.spawn((
            Mesh3d(mesh.clone()),
            MeshMaterial3d(paint.clone()),
            Transform::from_xyz(at.x, ground - 0.12 * height, at.y)
                .with_rotation(Quat::from_rotation_y(2.1 * index as f32))
                .with_scale(Vec3::new(0.62 + 0.1 * (index % 3) as f32, 1.0, 0.62) * height),
            SphericalIndex::default(),
            // Its clefts are finer than the shadow maps' texels.
            NotShadowReceiver,
            Rock,
        ));
    }
}

/// A stack about one unit high that stands on height 0.
fn rock() -> Mesh {
    let mut noise = FastNoiseLite::with_seed(19);
    noise.set_noise_type(Some(NoiseType::OpenSimplex2));
    noise.set_fractal_type(Some(FractalType::FBm));
    // No finer than its triangles can show.
    noise.set_fractal_octaves(Some(4));
    noise.set_fractal_gain(Some(0.38));
    noise.set_frequency(Some(1.3));
    let mut mesh = Sphere::new(1.0)
        .mesh()
        .ico(60)
        .unwrap_or_else(|_| Sphere::new(1.0).into());
    let mut colours = Vec::new();
    if let Some(VertexAttributeValues::Float32x3(places)) =
        mesh.attribute_mut(Mesh::ATTRIBUTE_POSITION)
    {
        for place in places {
            let out = Vec3::from(*place);
            // Upright clefts: noise that hardly changes with height, and ledges that hardly change around.
            let cleft = noise.get_noise_3d(1.1 * out.x, 0.35 * out.y, 1.1 * out.z);
            let ledge = noise.get_noise_3d(0.2 * out.x + 7.0, 3.2 * out.y, 0.2 * out.z);
            let height = 0.5 + 0.5 * out.y;
            let waist = 0.46 - 0.26 * height * height;
            let flat =
                out.xz().normalize_or_zero() * (1.0 - out.y * out.y).max(0.0).sqrt().powf(0.45);
            let width = waist * (1.0 + 0.5 * cleft + 0.16 * ledge);
            let rise = height * (1.0 + 0.07 * cleft);
            *place = [flat.x * width, rise, flat.y * width];
            let dry = LinearRgba::rgb(0.36, 0.30, 0.23).mix(
                &LinearRgba::rgb(0.20, 0.165, 0.135),
                (0.5 - 0.6 * ledge).clamp(0.0, 1.0),
            );
            let green = LinearRgba::rgb(0.09, 0.12, 0.035);
            let wet = LinearRgba::rgb(0.035, 0.035, 0.036);
            let colour = dry
                .mix(&green, ((rise - 0.93) * 14.0).clamp(0.0, 1.0))
                .mix(&wet, ((0.17 - rise) * 18.0).clamp(0.0, 1.0));
            colours.push(colour.to_f32_array());
        }
    }
    mesh.insert_attribute(Mesh::ATTRIBUTE_COLOR, colours);
    mesh.duplicate_vertices();
    mesh.compute_flat_normals();
    mesh
}

/// Spawns ships where the sea is deep enough.
pub fn spawn_ships(world: &mut World, field: &HeightField, site: &Site) -> usize {
    let mesh = world.resource_mut::<Assets<Mesh>>().add(ship());
    let paint = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            perceptual_roughness: 0.7,
            ..default()
        });
    let mut count = 0;
    for index in 0..60 {
        let draw = |salt: u32| unit(index, 3, 400 + salt);
        let at = site.at(
            3_200.0 * (draw(0) - 0.5),
            site.shore_m + 250.0 + 2_200.0 * draw(1),
        );
        let deep = field.height_at(at).is_some_and(|height| height < -12.0);
        let rocky = PLACES
            .iter()
            .any(|(across, out, _)| site.at(*across, site.shore_m + *out).distance(at) < 260.0);
        // The way that the camera comes stays free.
        let ahead = site.local(at).x.abs() < 130.0;
        if !deep || rocky || ahead || count == 7 {
            continue;
        }
        world.spawn((
            Mesh3d(mesh.clone()),
            MeshMaterial3d(paint.clone()),
            Transform::from_xyz(at.x, 0.0, at.y)
                .with_rotation(Quat::from_rotation_y(0.4 + 0.9 * draw(2)))
                .with_scale(Vec3::splat(0.8 + 0.4 * draw(3))),
        ));
        count += 1;
    }
    count
}

/// A container ship of 190 m; the water is at height 0.
fn ship() -> Mesh {
    let mut shape = Shape::default();
    let hull = LinearRgba::rgb(0.10, 0.03, 0.025);
    let deck = LinearRgba::rgb(0.25, 0.12, 0.09);
    let white = LinearRgba::rgb(0.75, 0.75, 0.73);
    let keel = [
        Vec2::new(-95.0, -11.0),
        Vec2::new(-88.0, -14.0),
        Vec2::new(62.0, -14.0),
        Vec2::new(84.0, -8.0),
        Vec2::new(98.0, 0.0),
        Vec2::new(84.0, 8.0),
        Vec2::new(62.0, 14.0),
        Vec2::new(-88.0, 14.0),
        Vec2::new(-95.0, 11.0),
    ];
    shape.prism(&keel, -4.0, 9.0, hull, deck);
    let bows: Vec<Vec2> = keel[2..7].to_vec();
    shape.prism(&bows, 9.0, 12.5, hull, deck);
    shape.solid(
        Vec3::new(-84.0, 9.0, -11.0),
        Vec3::new(-66.0, 32.0, 11.0),
        white,
    );
    shape.solid(
        Vec3::new(-80.0, 32.0, -14.0),
        Vec3::new(-70.0, 35.0, 14.0),
        white,
    );
    shape.column(Vec2::new(-78.0, 0.0), [3.0, 2.6], 12, 35.0, 43.0, hull);
    for bay in 0..9 {
        for row in 0..5 {
            let draw = |salt: u32| unit(bay, row, 420 + salt);
            let colours = [
                (0.45, 0.09, 0.05),
                (0.06, 0.16, 0.32),
                (0.10, 0.28, 0.20),
                (0.55, 0.30, 0.06),
                (0.40, 0.40, 0.40),
            ];
            let (r, g, b) = colours[((draw(0) * 5.0) as usize).min(4)];
            let low = Vec3::new(-58.0 + 13.2 * bay as f32, 9.0, -12.5 + 5.0 * row as f32);
            let layers = 2.0 + (3.0 * draw(1)).floor();
            shape.solid(
                low,
                low + Vec3::new(12.4, 2.6 * layers, 4.9),
                LinearRgba::rgb(r, g, b),
            );
        }
    }
    shape.mesh()
}
