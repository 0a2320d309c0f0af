//! What of a mesh asset its volumes are made from, copied out of it.

use bevy::{
    mesh::{Indices, PrimitiveTopology, VertexAttributeValues},
    prelude::*,
};

/// The mesh's positions; `None` if they are not in the main world (any more), not there, or not `Float32x3`.
pub(super) fn positions(mesh: &Mesh) -> Option<&[[f32; 3]]> {
    match mesh.try_attribute_option(Mesh::ATTRIBUTE_POSITION) {
        Ok(Some(VertexAttributeValues::Float32x3(positions))) => Some(positions),
        _ => None,
    }
}

/// The mesh's triangles as a list; `None` if it is one of lines or points, or not in the main world.
pub(super) fn triangles(mesh: &Mesh) -> Option<Vec<u32>> {
    let topology = mesh.primitive_topology();
    let vertices = positions(mesh)?.len();
    match mesh.try_indices_option().ok()? {
        Some(Indices::U16(indices)) => {
            let restart = u32::from(u16::MAX);
            listed(topology, indices.iter().copied().map(u32::from), restart)
        }
        Some(Indices::U32(indices)) => listed(topology, indices.iter().copied(), u32::MAX),
        None => listed(topology, 0..u32::try_from(vertices).ok()?, u32::MAX),
    }
}

/// As the GPU reads them: a list's last, unfinished triangle is none; the index `restart` begins a new strip.
fn listed(
    topology: PrimitiveTopology,
    indices: impl Iterator<Item = u32>,
    restart: u32,
) -> Option<Vec<u32>> {
    match topology {
        PrimitiveTopology::TriangleList => {
            let mut list: Vec<u32> = indices.collect();
            list.truncate(list.len() - list.len() % 3);
            Some(list)
        }
        PrimitiveTopology::TriangleStrip => {
            let strip: Vec<u32> = indices.collect();
            let mut list = Vec::with_capacity(3 * strip.len());
            for triangle in strip.array_windows::<3>() {
                if !triangle.contains(&restart) {
                    list.extend(triangle);
                }
            }
            Some(list)
        }
        _ => None,
    }
}
