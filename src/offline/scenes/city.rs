//! A dense city: buildings from a file or made by code, and what stands and drives along its streets.

use std::path::Path;

use bevy::prelude::*;

use super::{
    Object, Scene, SceneError, Shuttle, View,
    city_file::{self, Building},
    furniture,
    shapes::{self, Faces},
    streets::{Ground, Spot},
};
use crate::offline::accuracy::scene::lattice;

/// Height of a walker's eye. units: m
const EYE_M: f32 = 1.7;
/// The most objects stand along streets, as a share of the buildings.
const STREET_SHARE: f32 = 0.4;
/// Boxes that drive through the streets.
const OCCLUDERS: usize = 8;
/// Objects that furnish a full city beside its buildings.
const FULL_FURNITURE: usize = 7_500;

/// How large a city is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CitySize {
    /// For tests: a few hundred objects.
    Small,
    /// To be [`furnished`]: several thousand.
    Medium,
    /// For measuring: more than 10,000.
    Full,
}

impl CitySize {
    fn name(self) -> &'static str {
        match self {
            Self::Small => "small_generated_city",
            Self::Medium => "medium_generated_city",
            Self::Full => "generated_city",
        }
    }

    /// Blocks along x and z, of [`LOTS`] buildings each.
    fn blocks(self) -> UVec2 {
        match self {
            Self::Small => UVec2::new(6, 5),
            Self::Medium => UVec2::new(20, 16),
            Self::Full => UVec2::new(34, 26),
        }
    }

    /// The blocks of a [`furnished`] city that a park takes: the lowest corner, and the one past the highest.
    fn park(self) -> [UVec2; 2] {
        match self {
            Self::Small => [UVec2::new(4, 1), UVec2::new(5, 3)],
            Self::Medium => [UVec2::new(12, 6), UVec2::new(16, 10)],
            Self::Full => [UVec2::new(20, 11), UVec2::new(26, 17)],
        }
    }

    /// Fewest objects of the scene.
    pub fn objects(self) -> usize {
        match self {
            Self::Small => 450,
            Self::Medium => 5_000,
            Self::Full => 12_000,
        }
    }
}

/// Lots along x and z of a block.
const LOTS: UVec2 = UVec2::new(6, 2);
/// Size of a block. units: m
const BLOCK_M: Vec2 = Vec2::new(150.0, 56.0);
/// Widths of the streets along z and along x. units: m
const STREET_M: Vec2 = Vec2::new(26.0, 16.0);

/// The city of a glTF binary with one node and mesh a building, furnished to at least 12,000 objects.
///
/// # Errors
/// [`SceneError`].
pub fn from_file(path: &Path) -> Result<Scene, SceneError> {
    let (buildings, paints) = city_file::read(path)?;
    let stem = path.file_stem().unwrap_or(path.as_os_str());
    let name = stem.to_string_lossy().into_owned();
    Ok(furnish(name, buildings, paints, CitySize::Full.objects()).0)
}

/// The same with furniture of many sizes and shapes: trees with leaves, vehicles, railings, what stands on roofs. At
/// least 1.3 million triangles in at least 10,000 objects, where the buildings leave room for them, most of them in
/// small objects.
///
/// # Errors
/// [`SceneError`].
pub fn furnished_from_file(path: &Path) -> Result<Scene, SceneError> {
    let (buildings, paints) = city_file::read(path)?;
    let stem = path.file_stem().unwrap_or(path.as_os_str());
    let name = format!("{}_furnished", stem.to_string_lossy());
    let count = buildings.len();
    let (scene, ground) = furnish(name, buildings, paints, CitySize::Medium.objects());
    Ok(furniture::add(scene, &ground, count, FULL_FURNITURE))
}

/// The generated city with a park and the same furniture. From [`CitySize::Medium`] on at least 1.3 million triangles
/// in at least 10,000 objects.
pub fn furnished(size: CitySize) -> Scene {
    let (buildings, paints) = buildings(size, Some(size.park()));
    let count = buildings.len();
    let name = format!("{}_furnished", size.name());
    let (scene, ground) = furnish(name, buildings, paints, 0);
    let furniture = match size {
        CitySize::Small => FULL_FURNITURE / 10,
        CitySize::Medium | CitySize::Full => FULL_FURNITURE,
    };
    furniture::add(scene, &ground, count, furniture)
}

/// A city on a street grid: towers towards its middle, setbacks, round towers, low houses.
pub fn generated(size: CitySize) -> Scene {
    let (buildings, paints) = buildings(size, None);
    furnish(size.name().into(), buildings, paints, size.objects()).0
}

/// Buildings but for those of some blocks, and their colours.
fn buildings(size: CitySize, park: Option<[UVec2; 2]>) -> (Vec<Building>, Vec<Color>) {
    let blocks = size.blocks();
    let pitch = BLOCK_M + STREET_M;
    let lot = BLOCK_M / LOTS.as_vec2();
    let mut buildings = Vec::new();
    for index in 0..blocks.x * blocks.y * LOTS.x * LOTS.y {
        let lot_at = UVec2::new(index % (blocks.x * LOTS.x), index / (blocks.x * LOTS.x));
        let block = lot_at / LOTS;
        if park.is_some_and(|[from, to]| block.cmpge(from).all() && block.cmplt(to).all()) {
            continue;
        }
        let middle = (block.as_vec2() - 0.5 * (blocks.as_vec2() - 1.0)) * pitch
            + ((lot_at % LOTS).as_vec2() - 0.5 * (LOTS.as_vec2() - 1.0)) * lot;
        let draw = |salt| unit(index, salt);
        let half = 0.5 * lot * Vec2::new(0.78 + 0.2 * draw(0), 0.82 + 0.16 * draw(1));
        let outward = middle.length() / (0.5 * blocks.as_vec2() * pitch).length();
        let height_m =
            8.0 + 22.0 * draw(2) + 190.0 * (1.0 - outward).max(0.0).powi(2) * draw(3).powi(3);
        buildings.push(Building {
            mesh: tower(half, height_m, [draw(4), draw(5), draw(6)]),
            at: Vec3::new(middle.x, 0.0, middle.y),
            height_m,
            paint: usize::from(height_m > 20.0) + usize::from(height_m > 60.0),
        });
    }
    let paints = vec![
        Color::linear_rgb(0.55, 0.35, 0.27),
        Color::linear_rgb(0.62, 0.58, 0.5),
        Color::linear_rgb(0.5, 0.56, 0.62),
    ];
    (buildings, paints)
}

/// The furnished city of a file, else one made by code, a small one where it has to be quick.
///
/// # Errors
/// [`SceneError`] of the file.
pub fn furnished_for(file: Option<&Path>, quick: bool) -> Result<Scene, SceneError> {
    match file {
        Some(file) => furnished_from_file(file),
        None if quick => Ok(furnished(CitySize::Small)),
        None => Ok(furnished(CitySize::Medium)),
    }
}

/// Up to four storeys of setbacks, some of them round.
fn tower(half: Vec2, height_m: f32, draw: [f32; 3]) -> Mesh {
    let mut faces = Faces::default();
    let tiers = if height_m < 25.0 {
        1
    } else {
        2 + (2.99 * draw[0]) as u32
    };
    let (mut bottom, mut width) = (0.0, half);
    for tier in 0..tiers {
        let top = height_m * ((tier + 1) as f32 / tiers as f32).powf(0.6 + draw[1]);
        if tier > 0 && draw[2] > 0.8 {
            faces.column(Vec2::ZERO, width.min_element(), 12, bottom, top);
        } else {
            faces.block(Vec2::ZERO, width, bottom, top);
        }
        (bottom, width) = (top, width * (0.72 + 0.2 * draw[1]));
    }
    // What stands on roofs.
    faces.block(0.2 * half, 0.15 * half, bottom, bottom + 2.5);
    faces.mesh()
}

/// Ground, street furniture, moving boxes, views and ways for any buildings; the buildings are the first objects, each
/// with the mesh of its own number.
fn furnish(
    name: String,
    buildings: Vec<Building>,
    mut paints: Vec<Color>,
    least_objects: usize,
) -> (Scene, Ground) {
    let roofs = buildings.iter().flat_map(|building| {
        let at = building.at;
        shapes::corners(&building.mesh)
            .into_iter()
            .map(move |three| three.map(|corner| corner + at))
    });
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for corner in roofs.clone().flatten() {
        low = low.min(corner);
        high = high.max(corner);
    }
    low.y = 0.0;
    let ground = Ground::new(low.xz(), high.xz(), roofs);
    let ways = ground.ways(OCCLUDERS, 500.0);
    let centre = 0.5 * (low + high).xz();
    let inward = |[a, b]: [Vec2; 2]| {
        if a.distance(centre) < b.distance(centre) {
            [b, a]
        } else {
            [a, b]
        }
    };
    let ways: Vec<[Vec2; 2]> = ways.into_iter().map(inward).collect();
    let street = ways.first().copied().unwrap_or([low.xz(), high.xz()]);
    let cross = ways.get(1).copied().unwrap_or(street);
    let highest = buildings
        .iter()
        .max_by(|a, b| a.height_m.total_cmp(&b.height_m))
        .map_or(Vec3::ZERO, |building| {
            building.at + building.height_m * Vec3::Y
        });

    let mut meshes = Vec::with_capacity(buildings.len() + 8);
    let mut objects = Vec::with_capacity(least_objects);
    for building in buildings {
        let transform = Transform::from_translation(building.at);
        objects.push(Object::still(meshes.len(), building.paint, transform));
        meshes.push(building.mesh);
    }
    let mut paint = |r, g, b| {
        paints.push(Color::linear_rgb(r, g, b));
        paints.len() - 1
    };
    let mut faces = Faces::default();
    let half = 0.55 * (high - low).xz();
    let corner = |x: f32, z: f32| Vec3::new(x * half.x, 0.0, z * half.y);
    faces.polygon(&[
        corner(-1.0, -1.0),
        corner(-1.0, 1.0),
        corner(1.0, 1.0),
        corner(1.0, -1.0),
    ]);
    let place = Transform::from_xyz(centre.x, -0.05, centre.y);
    objects.push(Object::still(meshes.len(), paint(0.12, 0.12, 0.13), place));
    meshes.push(faces.mesh());

    let furniture = [
        (tree(), paint(0.09, 0.24, 0.07)),
        (lamp(), paint(0.2, 0.22, 0.24)),
        (car(), paint(0.45, 0.05, 0.04)),
        (car(), paint(0.7, 0.55, 0.05)),
        (kiosk(), paint(0.1, 0.25, 0.3)),
    ];
    let first = meshes.len();
    let kinds: Vec<usize> = furniture.iter().map(|(_, paint)| *paint).collect();
    meshes.extend(furniture.into_iter().map(|(mesh, _)| mesh));
    let missing = least_objects.saturating_sub(objects.len() + OCCLUDERS);
    let count = missing.max((STREET_SHARE * objects.len() as f32) as usize);
    for (index, spot) in along_streets(&ground, count).into_iter().enumerate() {
        let kind = (index * 7 + index / 5) % kinds.len();
        let scale = 0.8 + 0.5 * unit(index as u32, 11);
        let turn = Quat::from_rotation_y(-spot.along.to_angle());
        let transform = Transform::from_xyz(spot.at.x, 0.0, spot.at.y)
            .with_rotation(turn)
            .with_scale(Vec3::splat(scale));
        objects.push(Object::still(first + kind, kinds[kind], transform));
    }

    let mut faces = Faces::default();
    faces.block(Vec2::ZERO, Vec2::new(12.0, 4.0), 0.0, 14.0);
    let (mover, mover_paint) = (meshes.len(), paint(0.8, 0.3, 0.02));
    meshes.push(faces.mesh());
    for (index, [from, to]) in ways.iter().cycle().take(OCCLUDERS).enumerate() {
        let way = *to - *from;
        let from = from.lerp(*to, 0.12 * (index / ways.len().max(1)) as f32);
        let turn = Quat::from_rotation_y(-way.to_angle());
        objects.push(Object {
            shuttle: Some(Shuttle {
                to: Vec3::new(to.x, 0.0, to.y),
                // 60 km/h and more.
                period: ((2.0 * way.length() / 0.3) as u32).max(2) + 37 * index as u32,
            }),
            ..Object::still(
                mover,
                mover_paint,
                Transform::from_xyz(from.x, 0.0, from.y).with_rotation(turn),
            )
        });
    }

    let eye = |at: Vec2| Vec3::new(at.x, EYE_M, at.y);
    let walk = street.map(eye);
    let middle = 0.5 * (low + high);
    let span = high - low;
    let roof = highest + Vec3::Y * 3.0;
    let above = middle + Vec3::new(0.0, 0.9 * span.x.max(1.6 * span.z), 0.0);
    let scene = Scene {
        name,
        meshes,
        paints,
        objects,
        views: vec![
            View::at("street", walk[0], walk[1]),
            View::at("crossing", eye(cross[0].lerp(cross[1], 0.4)), eye(cross[1])),
            View::at("roofs", roof, roof + Vec3::new(300.0, -60.0, 140.0)),
            View::at("above", above, middle.with_y(0.0)),
        ],
        walk,
        bounds: [low, high],
        stride_m: 0.05,
    };
    (scene, ground)
}

/// So many places along the streets, evenly picked: the pavement first, then the kerb, then the carriageway.
pub(super) fn along_streets(ground: &Ground, count: usize) -> Vec<Spot> {
    let mut spots = Vec::new();
    for distance_m in [2.5, 5.0, 7.5] {
        spots.extend(ground.spots(distance_m));
        if spots.len() >= 3 * count {
            break;
        }
    }
    let all = spots.len();
    (0..count.min(all))
        .map(|index| spots[index * all / count.min(all)])
        .collect()
}

fn tree() -> Mesh {
    let mut faces = Faces::default();
    faces.column(Vec2::ZERO, 0.18, 5, 0.0, 2.2);
    faces.cone(Vec2::ZERO, 1.6, 7, 1.8, 4.6);
    faces.cone(Vec2::ZERO, 1.2, 7, 3.4, 6.4);
    faces.mesh()
}

fn lamp() -> Mesh {
    let mut faces = Faces::default();
    faces.column(Vec2::ZERO, 0.09, 5, 0.0, 6.0);
    faces.block(Vec2::new(0.0, 0.6), Vec2::new(0.15, 0.7), 6.0, 6.2);
    faces.mesh()
}

fn car() -> Mesh {
    let mut faces = Faces::default();
    faces.block(Vec2::ZERO, Vec2::new(2.2, 0.9), 0.25, 0.9);
    faces.block(Vec2::new(-0.2, 0.0), Vec2::new(1.1, 0.8), 0.9, 1.5);
    faces.mesh()
}

fn kiosk() -> Mesh {
    let mut faces = Faces::default();
    faces.block(Vec2::ZERO, Vec2::new(1.3, 1.0), 0.0, 2.4);
    faces.block(Vec2::ZERO, Vec2::new(1.6, 1.3), 2.4, 2.6);
    faces.mesh()
}

/// A random number of 0 to 1.
pub(super) fn unit(index: u32, salt: u32) -> f32 {
    0.5 + 0.5 * lattice(index as i32, 1, salt)
}
