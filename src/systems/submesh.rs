//! Makes a mesh of some triangles of another: the attributes of their vertices, some of them a frame.

use bevy::{
    math::bounding::Aabb3d,
    mesh::{Indices, MeshVertexAttribute, VertexAttributeValues},
    prelude::*,
};

/// So many vertices are copied before the clock is looked at.
const BATCH: usize = 8192;

/// Which vertices and triangles of a mesh another has.
pub struct SubMesh {
    /// Those of the mesh's vertices that it has; in their order where there are indices.
    pub vertices: Vec<u32>,
    /// Of the new mesh, as wide as the mesh's own; `None` where that has none.
    pub indices: Option<Indices>,
    pub bounds: Option<Aabb3d>,
}

/// Numbers of vertices in a new mesh, kept from one to the next so that each costs no more than what it has.
pub struct Renumbering(Vec<u32>);

impl Renumbering {
    /// For a mesh of so many vertices.
    pub fn new(vertices: usize) -> Self {
        Self(vec![u32::MAX; vertices])
    }

    /// `wide`: whether the mesh's indices are of 32 bits; `None` if it has none. Corners that are no vertices are left
    /// out.
    pub fn sub_mesh(
        &mut self,
        positions: &[[f32; 3]],
        triangles: impl Iterator<Item = [u32; 3]> + Clone,
        wide: Option<bool>,
    ) -> SubMesh {
        let count = self.0.len();
        let corners = || {
            let all = triangles.clone().flatten();
            all.filter(|corner| (*corner as usize) < count)
        };
        let (vertices, indices) = match wide {
            // Each triangle has its own three.
            None => (corners().collect(), None),
            Some(wide) => {
                let mut list = Vec::new();
                for corner in corners() {
                    let number = &mut self.0[corner as usize];
                    if *number == u32::MAX {
                        *number = 0;
                        list.push(corner);
                    }
                }
                list.sort_unstable();
                for (number, vertex) in (0..).zip(&list) {
                    self.0[*vertex as usize] = number;
                }
                let renumbered = corners().map(|corner| self.0[corner as usize]);
                let indices = if wide {
                    Indices::U32(renumbered.collect())
                } else {
                    // There are no more vertices than there were.
                    Indices::U16(renumbered.map(|number| number as u16).collect())
                };
                for vertex in &list {
                    self.0[*vertex as usize] = u32::MAX;
                }
                (list, Some(indices))
            }
        };
        let mut places = vertices
            .iter()
            .filter_map(|vertex| positions.get(*vertex as usize))
            .map(|place| Vec3::from(*place));
        let bounds = places.next().map(|first| {
            let (min, max) =
                places.fold((first, first), |(min, max), at| (min.min(at), max.max(at)));
            Aabb3d::from_min_max(min, max)
        });
        SubMesh {
            vertices,
            indices,
            bounds,
        }
    }
}

/// A mesh that is being made.
pub struct Making {
    sub: SubMesh,
    attributes: Vec<(MeshVertexAttribute, VertexAttributeValues)>,
    /// The attribute that is being copied, and how many vertices of it are there.
    which: usize,
    copied: usize,
}

impl Making {
    /// `None`: the mesh cannot be read.
    pub fn begin(sub: SubMesh, source: &Mesh) -> Option<Self> {
        let attributes = source.try_attributes().ok()?;
        Some(Self {
            attributes: attributes
                .map(|(attribute, values)| (*attribute, empty(values, sub.vertices.len())))
                .collect(),
            sub,
            which: 0,
            copied: 0,
        })
    }

    /// Copies a batch. Whether that was the last.
    pub fn copy(&mut self, source: &Mesh) -> bool {
        let Some((attribute, to)) = self.attributes.get_mut(self.which) else {
            return true;
        };
        let end = self.sub.vertices.len().min(self.copied + BATCH);
        let batch = &self.sub.vertices[self.copied..end];
        if let Ok(Some(from)) = source.try_attribute_option(attribute.id) {
            extend(to, from, batch);
        }
        self.copied = end;
        if end == self.sub.vertices.len() {
            self.which += 1;
            self.copied = 0;
        }
        self.which == self.attributes.len()
    }

    /// The same as the mesh that it comes from, but for what it has not of it.
    pub fn finish(self, source: &Mesh) -> Mesh {
        let mut mesh = Mesh::new(source.primitive_topology(), source.asset_usage);
        mesh.enable_raytracing = source.enable_raytracing;
        // Else Bevy goes through all positions to find it.
        mesh.final_aabb = self.sub.bounds;
        for (attribute, values) in self.attributes {
            mesh.insert_attribute(attribute, values);
        }
        if let Some(indices) = self.sub.indices {
            mesh.insert_indices(indices);
        }
        mesh
    }
}

/// What a mesh takes on the GPU. units: bytes
pub fn bytes(mesh: &Mesh) -> u64 {
    let indices = mesh
        .try_indices_option()
        .ok()
        .flatten()
        .map_or(0, |indices| match indices {
            Indices::U16(all) => 2 * all.len(),
            Indices::U32(all) => 4 * all.len(),
        });
    (mesh.get_vertex_buffer_size() + indices) as u64
}

macro_rules! formats {
    ($($format:ident)*) => {
        /// Values of the same format, none so far.
        fn empty(like: &VertexAttributeValues, capacity: usize) -> VertexAttributeValues {
            match like {
                $(VertexAttributeValues::$format(_) => {
                    VertexAttributeValues::$format(Vec::with_capacity(capacity))
                })*
            }
        }

        /// Appends the values of some vertices.
        fn extend(to: &mut VertexAttributeValues, from: &VertexAttributeValues, vertices: &[u32]) {
            match (to, from) {
                $((VertexAttributeValues::$format(to), VertexAttributeValues::$format(from)) => {
                    to.extend(vertices.iter().filter_map(|vertex| from.get(*vertex as usize)));
                })*
                // An edit would have been heard of.
                _ => {}
            }
        }
    };
}

formats! {
    Uint8 Uint8x2 Uint8x4 Sint8 Sint8x2 Sint8x4 Unorm8 Unorm8x2 Unorm8x4 Snorm8 Snorm8x2 Snorm8x4
    Uint16 Uint16x2 Uint16x4 Sint16 Sint16x2 Sint16x4 Unorm16 Unorm16x2 Unorm16x4 Snorm16 Snorm16x2 Snorm16x4
    Float16 Float16x2 Float16x4 Float32 Float32x2 Float32x3 Float32x4
    Uint32 Uint32x2 Uint32x3 Uint32x4 Sint32 Sint32x2 Sint32x3 Sint32x4
    Float64 Float64x2 Float64x3 Float64x4 Unorm8x4Bgra Unorm10_10_10_2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sub_mesh_has_the_vertices_of_its_triangles_in_their_order() {
        let positions: Vec<_> = (0..6).map(|i| [i as f32, 0.0, 0.0]).collect();
        let triangles = [[5, 1, 3], [3, 1, 4], [9, 9, 9]];
        let mut numbers = Renumbering::new(6);
        for _ in 0..2 {
            let some = numbers.sub_mesh(&positions, triangles.into_iter(), Some(false));
            assert_eq!(some.vertices, [1, 3, 4, 5]);
            assert_eq!(some.indices, Some(Indices::U16(vec![3, 0, 1, 1, 0, 2])));
            assert_eq!(some.bounds.map(|b| (b.min.x, b.max.x)), Some((1.0, 5.0)));
        }
        let loose = numbers.sub_mesh(&positions, triangles.into_iter(), None);
        assert_eq!(loose.vertices, [5, 1, 3, 3, 1, 4]);
        assert_eq!(loose.indices, None);
    }
}
