//! The city: buildings, parks, street furniture, vehicles that drive, woods around it; everything put on the ground by
//! the terrain's CPU height query.

use core::f32::consts::{FRAC_PI_2, TAU};

use bevy::{light::NotShadowCaster, prelude::*};
use bevy_skyline::{offline::scenes::furniture, terrain::HeightField};

use super::{
    buildings::{self, Class, STYLES},
    ground::Painter,
    shape::Shape,
    site::{BLOCK_M, Block, PITCH_M, Site},
    texture::unit,
};

/// Lots across and along a block.
const LOTS: UVec2 = UVec2::new(6, 2);
/// Things along the pavements of a block.
const FURNITURE: u32 = 4;
/// Trees of a park.
const PARK_TREES: u32 = 28;
/// Trees of the woods that are tried, and how far from the city's middle. units: m
const WOODS: (u32, f32) = (26_000, 4_600.0);

/// How many blocks hold so many buildings, parks aside.
pub fn blocks(buildings: usize) -> usize {
    (buildings as f32 / (LOTS.x * LOTS.y) as f32 * 1.09) as usize
}

/// Windows that shine at night.
#[derive(Resource)]
pub struct Facades(pub Vec<Handle<StandardMaterial>>);

/// On what drives round and round its block.
#[derive(Component)]
pub struct Vehicle {
    block: IVec2,
    /// Of the way round at time 0. units: m
    start_m: f32,
    /// units: m/s
    speed: f32,
}

/// How much there is of what the city is made of; says itself in one line.
#[derive(Clone, Debug, Default)]
pub struct Census {
    pub buildings: usize,
    pub furniture: usize,
    pub vehicles: usize,
    pub trees: usize,
}

impl core::fmt::Display for Census {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self {
            buildings,
            furniture,
            vehicles,
            trees,
        } = self;
        write!(
            f,
            "{buildings} buildings, {furniture} things along streets and in parks, {vehicles} vehicles, {trees} trees in \
             the woods"
        )
    }
}

/// Builds the city.
pub fn spawn(world: &mut World, field: &HeightField, site: &Site, painter: &Painter) -> Census {
    Census {
        buildings: spawn_buildings(world, field, site),
        furniture: spawn_furniture(world, field, site),
        vehicles: spawn_vehicles(world, site),
        trees: spawn_woods(world, field, site, painter),
    }
}

/// Whether a block is a park.
fn is_park(block: &Block) -> bool {
    (0.04..0.92).contains(&block.outward) && unit(block.index.x, block.index.y, 3) < 0.06
}

fn spawn_buildings(world: &mut World, field: &HeightField, site: &Site) -> usize {
    let kinds = buildings::kinds();
    let facades = STYLES.map(|style| {
        let [colours, lights] = buildings::facade(style);
        let mut images = world.resource_mut::<Assets<Image>>();
        let (colours, lights) = (images.add(colours), images.add(lights));
        let glass = style == buildings::Style::Curtain;
        world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial {
                base_color_texture: Some(colours),
                emissive_texture: Some(lights),
                perceptual_roughness: if glass { 0.35 } else { 0.85 },
                reflectance: if glass { 0.7 } else { 0.35 },
                ..default()
            })
    });
    let mut meshes = world.resource_mut::<Assets<Mesh>>();
    let handles: Vec<_> = kinds.iter().map(|k| meshes.add(k.mesh.clone())).collect();
    let of_class = |class: Class| -> Vec<usize> {
        (0..kinds.len())
            .filter(|i| kinds[*i].class == class)
            .collect()
    };
    let by_class = [Class::House, Class::WalkUp, Class::Slab, Class::Tower].map(of_class);
    let lot = BLOCK_M / LOTS.as_vec2();
    let mut count = 0;
    // The first block is the landmark's.
    for block in site.blocks.iter().skip(1).filter(|block| !is_park(block)) {
        for index in 0..LOTS.x * LOTS.y {
            let key = block.index * IVec2::new(LOTS.x as i32, LOTS.y as i32)
                + IVec2::new((index % LOTS.x) as i32, (index / LOTS.x) as i32);
            let draw = |salt: u32| unit(key.x, key.y, 10 + salt);
            let density = 1.0 - block.outward;
            let of = &by_class[class(density, draw(0), draw(1))];
            // The higher the nearer to the middle.
            let rank = draw(2) * (0.25 + 0.75 * density.powi(3)) + 0.1 * density;
            let kind = of[((rank * of.len() as f32) as usize).min(of.len() - 1)];
            let half = kinds[kind].half;
            let at = UVec2::new(index % LOTS.x, index / LOTS.x).as_vec2() + 0.5;
            let mut way = at * lot - 0.5 * BLOCK_M;
            // Up to the pavement.
            way.y = way.y.signum() * (0.5 * BLOCK_M.y - half.y - 0.5);
            let middle = site.middle(block.index) + turned(site, way);
            let Some(ground) = footing(field, site, middle, half) else {
                continue;
            };
            let about = if draw(3) > 0.5 { 0.0 } else { 2.0 * FRAC_PI_2 };
            let style = STYLES.iter().position(|s| *s == kinds[kind].style);
            world.spawn((
                Mesh3d(handles[kind].clone()),
                MeshMaterial3d(facades[style.unwrap_or(0)].clone()),
                Transform::from_xyz(middle.x, ground, middle.y)
                    .with_rotation(site.turn() * Quat::from_rotation_y(about)),
            ));
            count += 1;
        }
    }
    world.insert_resource(Facades(facades.to_vec()));
    count
}

/// What is built where so much is going on, 1 being the middle of the city.
fn class(density: f32, draw: f32, luck: f32) -> usize {
    let density = (density + 0.16 * (luck - 0.5)).clamp(0.0, 1.0);
    let tower = ((density - 0.70) / 0.3).clamp(0.0, 1.0).powi(2) * 0.62;
    let slab = (0.36 * density).min(1.0 - tower);
    let house = ((0.55 - density) / 0.4).clamp(0.0, 0.85);
    match draw {
        draw if draw < tower => 3,
        draw if draw < tower + slab * (1.0 - house) => 2,
        draw if draw < 1.0 - house * (1.0 - tower) => 1,
        _ => 0,
    }
}

/// Across and along the street to +X and +Z.
fn turned(site: &Site, way: Vec2) -> Vec2 {
    site.across() * way.x + site.seaward * way.y
}

/// The floor of a building so that no wall hangs in the air; `None` where the ground is too steep. units: m
fn footing(field: &HeightField, site: &Site, middle: Vec2, half: Vec2) -> Option<f32> {
    let (mut low, mut high) = (f32::MAX, f32::MIN);
    for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)] {
        let height = field.height_at(middle + turned(site, half * Vec2::new(x, y)))?;
        low = low.min(height);
        high = high.max(height);
    }
    (high - low < 14.0).then_some((low + 4.5).min(high))
}

/// Meshes with their materials.
fn kinds_of(
    world: &mut World,
    kinds: Vec<(Mesh, Color)>,
) -> Vec<(Handle<Mesh>, Handle<StandardMaterial>)> {
    kinds
        .into_iter()
        .map(|(mesh, base_color)| {
            let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
            let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
            let paint = materials.add(StandardMaterial {
                base_color,
                perceptual_roughness: 0.9,
                ..default()
            });
            (mesh, paint)
        })
        .collect()
}

fn spawn_furniture(world: &mut World, field: &HeightField, site: &Site) -> usize {
    let pavement = kinds_of(world, furniture::pavement_kinds());
    let park = kinds_of(world, furniture::park_kinds());
    let mut count = 0;
    for block in site.blocks.iter().skip(1) {
        let key = block.index;
        let is_park = is_park(block);
        let things = if is_park { PARK_TREES } else { 0 } + FURNITURE;
        for index in 0..things {
            let draw = |salt: u32| unit(key.x * 64 + index as i32, key.y, 30 + salt);
            let (kinds, way) = if index < FURNITURE {
                let m = draw(0) * 2.0 * (BLOCK_M.x + BLOCK_M.y);
                (&pavement, round(m, BLOCK_M + 3.0).0)
            } else {
                (&park, (Vec2::new(draw(0), draw(1)) - 0.5) * 0.94 * BLOCK_M)
            };
            let at = site.middle(key) + turned(site, way);
            let Some(ground) = field.height_at(at) else {
                continue;
            };
            let (mesh, paint) =
                &kinds[((draw(2) * kinds.len() as f32) as usize).min(kinds.len() - 1)];
            world.spawn((
                Mesh3d(mesh.clone()),
                MeshMaterial3d(paint.clone()),
                Transform::from_xyz(at.x, ground, at.y)
                    .with_rotation(site.turn() * Quat::from_rotation_y(TAU * draw(3)))
                    .with_scale(Vec3::splat(1.0 + 0.4 * draw(4))),
                // Thousands of triangles each, and a shadow of a few pixels.
                NotShadowCaster,
            ));
            count += 1;
        }
    }
    count
}

fn spawn_vehicles(world: &mut World, site: &Site) -> usize {
    let kinds = kinds_of(world, furniture::vehicle_kinds());
    for (index, block) in site.blocks.iter().enumerate() {
        let key = block.index;
        let draw = |salt: u32| unit(key.x, key.y, 50 + salt);
        let (mesh, paint) = &kinds[index % kinds.len()];
        world.spawn((
            Mesh3d(mesh.clone()),
            MeshMaterial3d(paint.clone()),
            Transform::default(),
            NotShadowCaster,
            Vehicle {
                block: key,
                start_m: draw(0) * 2.0 * (PITCH_M.x + PITCH_M.y),
                speed: 8.0 + 5.0 * draw(1),
            },
        ));
    }
    site.blocks.len()
}

/// A place so far along the way round a rectangle, and the way ahead there.
fn round(m: f32, size: Vec2) -> (Vec2, Vec2) {
    let mut m = m.rem_euclid(2.0 * (size.x + size.y));
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
        .map(|(x, y)| 0.5 * size * Vec2::new(x, y));
    for (i, from) in corners.iter().enumerate() {
        let to = corners[(i + 1) % 4];
        let length = from.distance(to);
        if m < length {
            let ahead = (to - from) / length;
            return (*from + ahead * m, ahead);
        }
        m -= length;
    }
    (corners[0], Vec2::X)
}

/// Puts every vehicle where it is at a time, upright on the ground.
pub fn drive<'a>(
    time_s: f32,
    field: &HeightField,
    site: &Site,
    vehicles: impl Iterator<Item = (&'a Vehicle, Mut<'a, Transform>)>,
) {
    for (vehicle, mut transform) in vehicles {
        let (way, ahead) = round(
            vehicle.start_m + vehicle.speed * time_s,
            // The lane beside the pavement.
            BLOCK_M + 2.0 * 5.4,
        );
        let at = site.middle(vehicle.block) + turned(site, way);
        let ahead = turned(site, ahead);
        let (Some(height), Some(up)) = (field.height_at(at), field.normal_at(at)) else {
            continue;
        };
        let side = Vec3::new(ahead.x, 0.0, ahead.y)
            .cross(up)
            .normalize_or(Vec3::Z);
        *transform = Transform::from_xyz(at.x, height, at.y)
            .with_rotation(Quat::from_mat3(&Mat3::from_cols(up.cross(side), up, side)));
    }
}

fn spawn_woods(world: &mut World, field: &HeightField, site: &Site, painter: &Painter) -> usize {
    let kinds: Vec<_> = [
        (0.045, 0.085, 0.022),
        (0.030, 0.066, 0.024),
        (0.075, 0.095, 0.020),
    ]
    .into_iter()
    .enumerate()
    .map(|(i, (r, g, b))| {
        let mut shape = Shape::default();
        let leaf = LinearRgba::rgb(r, g, b);
        let bark = LinearRgba::rgb(0.06, 0.04, 0.025);
        shape.column(Vec2::ZERO, [0.03, 0.02], 4, -0.1, 0.3, bark);
        if i < 2 {
            shape.column(Vec2::ZERO, [0.22, 0.0], 7, 0.14, 0.62, leaf);
            shape.column(Vec2::ZERO, [0.16, 0.0], 7, 0.42, 1.0, leaf);
        } else {
            shape.column(Vec2::ZERO, [0.12, 0.32], 7, 0.22, 0.45, leaf);
            shape.column(Vec2::ZERO, [0.32, 0.16], 7, 0.45, 0.8, leaf);
        }
        world.resource_mut::<Assets<Mesh>>().add(shape.mesh())
    })
    .collect();
    let paint = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            perceptual_roughness: 1.0,
            reflectance: 0.1,
            ..default()
        });
    let (tries, reach_m) = WOODS;
    let mut count = 0;
    for index in 0..tries {
        let draw = |salt: u32| unit(index as i32, 7, 70 + salt);
        let at = site.centre + Vec2::from_angle(TAU * draw(0)) * reach_m * draw(1).sqrt();
        let (Some(ground), true) = (field.height_at(at), draw(2) < painter.woods(at)) else {
            continue;
        };
        let size = 8.0 + 9.0 * draw(3);
        let kind = (draw(4) * 2.99 - 0.4 * (ground / 300.0)).clamp(0.0, 2.9) as usize;
        world.spawn((
            Mesh3d(kinds[kind].clone()),
            MeshMaterial3d(paint.clone()),
            Transform::from_xyz(at.x, ground, at.y)
                .with_rotation(Quat::from_rotation_y(TAU * draw(5)))
                .with_scale(Vec3::splat(size)),
        ));
        count += 1;
    }
    count
}
