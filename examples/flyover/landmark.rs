//! A tower with everything in it: floors, cores, columns, ducts, desks. From outside none of it can be seen, and
//! interior culling takes it out.

use core::f32::consts::{FRAC_PI_4, TAU};

use bevy::prelude::*;
use bevy_skyline::interior::InteriorCulling;

use super::shape::{Shape, ring};

/// Floors above the podium.
const FLOORS: u32 = 72;
/// From floor to floor. units: m
const STOREY_M: f32 = 4.0;
/// From the tower's axis to its corners at the foot and at the top. units: m
const RADII_M: [f32; 2] = [31.0, 20.0];
/// By how much a floor is turned against the one below. units: rad
const TWIST: f32 = 0.022;
/// Corners of a floor.
const SIDES: u32 = 8;
/// Height of the podium. units: m
const PODIUM_M: f32 = 12.0;

/// On the tower's root.
#[derive(Component)]
pub struct Landmark;

/// Spawns the tower at a place on the ground.
pub fn spawn(world: &mut World, at: Vec3, turn: Quat) -> Entity {
    let mut mesh = |shape: Shape| world.resource_mut::<Assets<Mesh>>().add(shape.mesh());
    let inside = [core(), columns(), desks(), ducts(), slab()].map(&mut mesh);
    let glass = mesh(glass());
    let posts = mesh(posts());
    let podium = mesh(podium());
    let crown = mesh(crown());
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    let matt = materials.add(StandardMaterial {
        perceptual_roughness: 0.8,
        ..default()
    });
    let shiny = materials.add(StandardMaterial {
        perceptual_roughness: 0.16,
        reflectance: 0.9,
        ..default()
    });
    let steel = materials.add(StandardMaterial {
        perceptual_roughness: 0.55,
        metallic: 0.3,
        ..default()
    });
    let root = world
        .spawn((
            Transform::from_translation(at).with_rotation(turn),
            Visibility::default(),
            Landmark,
            InteriorCulling::default(),
        ))
        .id();
    for floor in 0..FLOORS {
        let share = floor as f32 / FLOORS as f32;
        // Slender toward the top, a little swollen in the middle.
        let radius = RADII_M[0] + (RADII_M[1] - RADII_M[0]) * share.powf(1.6);
        let place = Transform::from_xyz(0.0, PODIUM_M + STOREY_M * floor as f32, 0.0)
            .with_rotation(Quat::from_rotation_y(TWIST * floor as f32))
            .with_scale(Vec3::new(radius, 1.0, radius));
        let inside = inside.iter().map(|part| (part, &matt));
        for (part, paint) in inside.chain([(&glass, &shiny), (&posts, &steel)]) {
            world.spawn((
                Mesh3d(part.clone()),
                MeshMaterial3d(paint.clone()),
                place,
                ChildOf(root),
            ));
        }
    }
    let top = Transform::from_xyz(0.0, PODIUM_M + STOREY_M * FLOORS as f32, 0.0)
        .with_rotation(Quat::from_rotation_y(TWIST * FLOORS as f32))
        .with_scale(Vec3::new(RADII_M[1], 1.0, RADII_M[1]));
    world.spawn((Mesh3d(crown), MeshMaterial3d(steel), top, ChildOf(root)));
    let foot = Transform::default();
    world.spawn((Mesh3d(podium), MeshMaterial3d(matt), foot, ChildOf(root)));
    root
}

fn octagon(radius: f32) -> Vec<Vec2> {
    let corners = ring(Vec2::ZERO, radius, SIDES);
    let turn = Vec2::from_angle(0.5 * FRAC_PI_4);
    corners
        .into_iter()
        .map(|corner| turn.rotate(corner))
        .collect()
}

/// All that follows is for a floor of radius 1; heights are in metres.
fn slab() -> Shape {
    let mut shape = Shape::default();
    let edge = LinearRgba::rgb(0.30, 0.27, 0.23);
    shape.prism(&octagon(1.012), -0.35, 0.0, edge, edge);
    // Its underside.
    let under: Vec<Vec3> = octagon(1.012)
        .into_iter()
        .map(|corner| Vec3::new(corner.x, -0.35, corner.y))
        .collect();
    shape.polygon(&under, edge);
    shape
}

fn glass() -> Shape {
    let mut shape = Shape::default();
    let corners = octagon(1.0);
    for (i, from) in corners.iter().enumerate() {
        let to = corners[(i + 1) % corners.len()];
        let tint = LinearRgba::rgb(0.05, 0.085, 0.12);
        let at = |corner: Vec2, y: f32| Vec3::new(corner.x, y, corner.y);
        // Opaque, and closed from inside too.
        let top = STOREY_M - 0.35;
        shape.polygon(
            &[at(*from, 0.0), at(*from, top), at(to, top), at(to, 0.0)],
            tint,
        );
        shape.polygon(
            &[at(to, 0.0), at(to, top), at(*from, top), at(*from, 0.0)],
            tint,
        );
    }
    shape
}

fn posts() -> Shape {
    let mut shape = Shape::default();
    let corners = octagon(1.006);
    let steel = LinearRgba::gray(0.20);
    for (i, from) in corners.iter().enumerate() {
        let to = corners[(i + 1) % corners.len()];
        for post in 0..4 {
            let at = from.lerp(to, post as f32 / 4.0);
            let size = if post == 0 { 0.016 } else { 0.006 };
            shape.solid(
                Vec3::new(at.x - size, 0.0, at.y - size),
                Vec3::new(at.x + size, STOREY_M - 0.3, at.y + size),
                steel,
            );
        }
    }
    shape
}

fn core() -> Shape {
    let mut shape = Shape::default();
    let wall = LinearRgba::rgb(0.46, 0.44, 0.40);
    let height = STOREY_M - 0.35;
    // Two lift shafts and a stair between four walls.
    for x in [-0.26_f32, -0.09, 0.08, 0.25] {
        shape.solid(
            Vec3::new(x, 0.0, -0.22),
            Vec3::new(x + 0.015, height, 0.22),
            wall,
        );
    }
    for z in [-0.22_f32, 0.205] {
        shape.solid(
            Vec3::new(-0.26, 0.0, z),
            Vec3::new(0.265, height, z + 0.015),
            wall,
        );
    }
    for step in 0..22 {
        let (x, y) = (0.09 + 0.007 * step as f32, STOREY_M * step as f32 / 22.0);
        shape.solid(
            Vec3::new(x, y, -0.2),
            Vec3::new(x + 0.009, y + 0.16, -0.05),
            LinearRgba::gray(0.3),
        );
    }
    shape
}

fn columns() -> Shape {
    let mut shape = Shape::default();
    for i in 0..12 {
        let at = Vec2::from_angle(TAU * (i as f32 + 0.5) / 12.0) * 0.7;
        let grey = LinearRgba::gray(0.5);
        shape.column(at, [0.02; 2], 16, 0.0, STOREY_M - 0.35, grey);
    }
    shape
}

/// Rings of desks, each with a chair and a screen.
fn desks() -> Shape {
    let mut shape = Shape::default();
    let wood = LinearRgba::rgb(0.36, 0.22, 0.11);
    let dark = LinearRgba::gray(0.05);
    for (ring, (radius, count)) in [(0.38, 14), (0.5, 20), (0.62, 26)].into_iter().enumerate() {
        for i in 0..count {
            let angle = TAU * (i as f32 + 0.3 * ring as f32) / count as f32;
            let at = radius * Vec2::from_angle(angle);
            let half = Vec2::new(0.032, 0.018);
            let (low, high) = (at - half, at + half);
            shape.solid(
                Vec3::new(low.x, 0.70, low.y),
                Vec3::new(high.x, 0.74, high.y),
                wood,
            );
            for (x, y) in [
                (low.x, low.y),
                (high.x, low.y),
                (low.x, high.y),
                (high.x, high.y),
            ] {
                let leg = 0.0015;
                shape.solid(
                    Vec3::new(x - leg, 0.0, y - leg),
                    Vec3::new(x + leg, 0.7, y + leg),
                    dark,
                );
            }
            shape.solid(
                Vec3::new(at.x - 0.012, 0.8, at.y),
                Vec3::new(at.x + 0.012, 1.15, at.y + 0.001),
                dark,
            );
            let chair = at * (radius + 0.04) / radius;
            shape.column(chair, [0.012; 2], 10, 0.42, 0.5, dark);
            shape.column(chair, [0.002; 2], 6, 0.05, 0.42, dark);
            for leg in 0..5 {
                let out = chair + 0.01 * Vec2::from_angle(TAU * leg as f32 / 5.0);
                shape.column(out, [0.002; 2], 6, 0.0, 0.05, dark);
            }
        }
    }
    shape
}

/// Air ducts and sprinklers under the ceiling.
fn ducts() -> Shape {
    let mut shape = Shape::default();
    let zinc = LinearRgba::gray(0.45);
    let (low, high) = (STOREY_M - 0.95, STOREY_M - 0.5);
    for i in 0..8 {
        let ahead = Vec2::from_angle(FRAC_PI_4 * i as f32);
        let aside = 0.018 * ahead.perp();
        let corners = [
            0.32 * ahead - aside,
            0.72 * ahead - aside,
            0.72 * ahead + aside,
            0.32 * ahead + aside,
        ];
        shape.prism(&corners, low, high, zinc, zinc);
        for step in 0..10 {
            let at = ahead * (0.35 + 0.036 * step as f32);
            shape.column(
                at,
                [0.003; 2],
                8,
                low - 0.2,
                low,
                LinearRgba::rgb(0.5, 0.1, 0.05),
            );
        }
    }
    shape
}

/// In metres.
fn podium() -> Shape {
    let mut shape = Shape::default();
    let stone = LinearRgba::rgb(0.50, 0.46, 0.40);
    let glass = LinearRgba::rgb(0.05, 0.08, 0.10);
    shape.solid(
        Vec3::new(-44.0, -6.0, -24.0),
        Vec3::new(44.0, PODIUM_M - 0.35, 24.0),
        stone,
    );
    for x in 0..11 {
        for z in [-24.15_f32, 24.0] {
            let low = Vec3::new(-42.0 + 7.7 * x as f32, 1.2, z);
            shape.solid(low, low + Vec3::new(6.2, 8.6, 0.15), glass);
        }
    }
    shape
}

/// The roof, a lantern and a spire over a radius of 1, heights in metres.
fn crown() -> Shape {
    let mut shape = Shape::default();
    let steel = LinearRgba::gray(0.6);
    let dark = LinearRgba::rgb(0.06, 0.09, 0.12);
    shape.column(Vec2::ZERO, [1.012; 2], SIDES, -0.35, 0.6, steel);
    shape.column(Vec2::ZERO, [0.72, 0.6], SIDES, 0.6, 9.0, dark);
    shape.column(Vec2::ZERO, [0.5, 0.32], SIDES, 9.0, 15.0, steel);
    shape.column(Vec2::ZERO, [0.06, 0.02], 8, 15.0, 64.0, steel);
    shape
}
