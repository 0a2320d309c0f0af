//! A city from a glTF binary: one node and one mesh a building.

use std::{collections::HashMap, path::Path};

use bevy::prelude::*;

use super::{SceneError, shapes::Faces};

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

/// Reads every node that has triangles, with flat normals and the colours of the file's materials.
///
/// # Errors
/// [`SceneError`]: unreadable, no glTF binary, a mesh that points outside its data, no buildings at all.
pub(super) fn read(path: &Path) -> Result<(Vec<Building>, Vec<Color>), SceneError> {
    let bytes = std::fs::read(path).map_err(|error| SceneError::read(path, &error))?;
    let broken = |reason: &dyn core::fmt::Display| SceneError::Gltf {
        path: path.to_owned(),
        reason: reason.to_string(),
    };
    let file = gltf::Gltf::from_slice(&bytes).map_err(|error| broken(&error))?;
    let Some(blob) = file.blob.as_deref() else {
        return Err(broken(
            &"it has no binary chunk; its data must lie in the file itself",
        ));
    };
    let mut paints = Vec::new();
    let mut paint_of = HashMap::new();
    let mut buildings = Vec::new();
    let roots = file.scenes().flat_map(|scene| scene.nodes());
    let mut open: Vec<_> = roots.map(|node| (node, Mat4::IDENTITY)).collect();
    open.reverse();
    while let Some((node, above)) = open.pop() {
        let world = above * Mat4::from_cols_array_2d(&node.transform().matrix());
        let wrong = |what| SceneError::Mesh {
            path: path.to_owned(),
            node: node
                .name()
                .map_or_else(|| node.index().to_string(), str::to_owned),
            what,
        };
        open.extend(node.children().map(|child| (child, world)));
        let Some(mesh) = node.mesh() else {
            continue;
        };
        let mut triangles: Vec<[Vec3; 3]> = Vec::new();
        let mut paint = None;
        for part in mesh.primitives() {
            if part.mode() != gltf::mesh::Mode::Triangles {
                return Err(wrong("is not made of triangles"));
            }
            let inside = |accessor: Option<gltf::Accessor>| {
                accessor.is_none_or(|accessor| lies_inside(&accessor, blob.len()))
            };
            if !inside(part.get(&gltf::Semantic::Positions)) || !inside(part.indices()) {
                return Err(wrong("points outside the file's data"));
            }
            let reader = part.reader(|buffer| (buffer.index() == 0).then_some(blob));
            let positions: Vec<Vec3> = reader
                .read_positions()
                .ok_or_else(|| wrong("has no positions"))?
                .map(|at| world.transform_point3(Vec3::from(at)))
                .collect();
            if positions.iter().any(|at| !at.is_finite()) {
                return Err(wrong("has a position that is not finite"));
            }
            let indices: Vec<usize> = match reader.read_indices() {
                Some(indices) => indices.into_u32().map(|i| i as usize).collect(),
                None => (0..positions.len()).collect(),
            };
            for three in indices.chunks_exact(3) {
                let corner = |i: usize| positions.get(three[i]).copied();
                let (Some(a), Some(b), Some(c)) = (corner(0), corner(1), corner(2)) else {
                    return Err(wrong("has an index past its last vertex"));
                };
                triangles.push([a, b, c]);
            }
            let material = part.material();
            paint.get_or_insert_with(|| {
                *paint_of.entry(material.index()).or_insert_with(|| {
                    let [r, g, b, _] = material.pbr_metallic_roughness().base_color_factor();
                    paints.push(Color::linear_rgb(r, g, b));
                    paints.len() - 1
                })
            });
        }
        let (low, high) = triangles
            .iter()
            .flatten()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), at| {
                (low.min(*at), high.max(*at))
            });
        let at = Vec3::new(0.5 * (low.x + high.x), low.y, 0.5 * (low.z + high.z));
        let mut faces = Faces::default();
        for triangle in &triangles {
            faces.polygon(&triangle.map(|corner| corner - at));
        }
        if let (false, Some(paint)) = (faces.is_empty(), paint) {
            buildings.push(Building {
                mesh: faces.mesh(),
                at,
                height_m: high.y - low.y,
                paint,
            });
        }
    }
    if buildings.is_empty() {
        return Err(SceneError::NoBuildings {
            path: path.to_owned(),
        });
    }
    Ok((buildings, paints))
}

/// Whether all of an accessor's data lie within so many bytes; the reader would panic if not.
fn lies_inside(accessor: &gltf::Accessor, bytes: usize) -> bool {
    let Some(view) = accessor.view() else {
        return accessor.count() == 0;
    };
    let stride = view.stride().unwrap_or(accessor.size());
    let last = accessor.count().saturating_sub(1).checked_mul(stride);
    let end = last
        .and_then(|last| last.checked_add(accessor.offset()))
        .and_then(|end| end.checked_add(accessor.size()));
    end.is_some_and(|end| end <= view.length())
        && view
            .offset()
            .checked_add(view.length())
            .is_some_and(|end| end <= bytes)
}
