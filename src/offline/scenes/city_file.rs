//! A city from a glTF file: one node a building.

use std::{collections::HashMap, path::Path};

use bevy::prelude::*;

use super::{SceneError, shapes::Faces};
use crate::offline::interior::{ModelFileError, PaintedPart, read_painted};

/// What a city may take in main memory. units: MiB
const MEMORY_MIB: u32 = 1024;
/// No city is larger: its streets are looked for in cells of 2 m. units: m
const MOST_ACROSS_M: f32 = 20_000.0;
/// None stands farther from the origin, where `f32` can still tell its walls apart. units: m
const FARTHEST_M: f32 = 1.0e6;

/// A building: its mesh about its own middle, on the ground.
pub(super) struct Building {
    pub mesh: Mesh,
    /// Where the middle of its foot stands. units: m
    pub at: Vec3,
    /// Its highest point above its foot. units: m
    pub height_m: f32,
    /// Index of its colour.
    pub paint: usize,
}

/// Reads every node that has triangles and stands still, with flat normals and the colours of the file's materials.
///
/// # Errors
/// [`SceneError`]: unreadable, no glTF or a broken one, buildings too far apart, no buildings at all.
pub(super) fn read(path: &Path) -> Result<(Vec<Building>, Vec<Color>), SceneError> {
    let parts = read_painted(path, MEMORY_MIB).map_err(|error| match error {
        ModelFileError::Read(reason) => SceneError::read(path, &reason),
        error => SceneError::Gltf {
            path: path.to_owned(),
            reason: error.to_string(),
        },
    })?;
    let mut paints = Vec::new();
    let mut paint_of = HashMap::new();
    let mut buildings = Vec::new();
    let (mut lowest, mut highest) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for parts in parts.chunk_by(|a, b| a.part.node == b.part.node) {
        let triangles: Vec<[Vec3; 3]> = parts.iter().flat_map(triangles).collect();
        let corners = triangles.iter().flatten();
        let (low, high) = corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), at| {
            (low.min(*at), high.max(*at))
        });
        let at = Vec3::new(0.5 * (low.x + high.x), low.y, 0.5 * (low.z + high.z));
        let mut faces = Faces::default();
        for triangle in &triangles {
            faces.polygon(&triangle.map(|corner| corner - at));
        }
        if faces.is_empty() {
            continue;
        }
        (lowest, highest) = (lowest.min(low), highest.max(high));
        let paint = *paint_of.entry(parts[0].material).or_insert_with(|| {
            let [r, g, b] = parts[0].colour;
            paints.push(Color::linear_rgb(r, g, b));
            paints.len() - 1
        });
        buildings.push(Building {
            mesh: faces.mesh(),
            at,
            height_m: high.y - low.y,
            paint,
        });
    }
    if buildings.is_empty() {
        return Err(SceneError::NoBuildings {
            path: path.to_owned(),
        });
    }
    let across_m = (highest - lowest).max_element();
    let farthest_m = lowest.abs().max(highest.abs()).max_element();
    if across_m > MOST_ACROSS_M || farthest_m > FARTHEST_M {
        return Err(SceneError::TooLarge {
            path: path.to_owned(),
            across_m,
            farthest_m,
        });
    }
    Ok((buildings, paints))
}

/// Of a part, in the city's frame.
fn triangles(painted: &PaintedPart) -> impl Iterator<Item = [Vec3; 3]> {
    let part = &painted.part;
    part.corners()
        .map(|triangle| triangle.map(|corner| part.place(corner).as_vec3()))
}
