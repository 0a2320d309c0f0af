//! Meshes built from flat faces, each corner with its face's normal.

use bevy::{
    asset::RenderAssetUsages,
    mesh::{Indices, PrimitiveTopology, VertexAttributeValues},
    prelude::*,
};

/// A mesh under construction.
#[derive(Default)]
pub(super) struct Faces {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    indices: Vec<u32>,
}

impl Faces {
    /// A convex polygon, counter-clockwise from where it is seen. One without area is left out.
    pub(super) fn polygon(&mut self, corners: &[Vec3]) {
        let &[a, b, c, ..] = corners else {
            return;
        };
        let normal = (b - a).cross(c - a).normalize_or_zero();
        if normal == Vec3::ZERO {
            return;
        }
        let first = self.positions.len() as u32;
        for corner in corners {
            self.positions.push(corner.to_array());
            self.normals.push(normal.to_array());
        }
        for i in 2..corners.len() as u32 {
            self.indices.extend([first, first + i - 1, first + i]);
        }
    }

    /// Walls and roof over a ring of corners in the ground plane, clockwise seen from above with x to the right
    /// and z down. No floor: nobody sees it.
    pub(super) fn prism(&mut self, ring: &[Vec2], bottom: f32, top: f32) {
        let at = |corner: Vec2, y: f32| Vec3::new(corner.x, y, corner.y);
        for (i, &a) in ring.iter().enumerate() {
            let b = ring[(i + 1) % ring.len()];
            self.polygon(&[at(b, bottom), at(a, bottom), at(a, top), at(b, top)]);
        }
        let roof: Vec<Vec3> = ring.iter().rev().map(|&corner| at(corner, top)).collect();
        self.polygon(&roof);
    }

    /// A [`prism`](Self::prism) over a rectangle.
    pub(super) fn block(&mut self, centre: Vec2, half: Vec2, bottom: f32, top: f32) {
        let ring = [
            Vec2::new(-half.x, -half.y),
            Vec2::new(half.x, -half.y),
            Vec2::new(half.x, half.y),
            Vec2::new(-half.x, half.y),
        ];
        self.prism(&ring.map(|corner| centre + corner), bottom, top);
    }

    /// A [`prism`](Self::prism) over a regular polygon.
    pub(super) fn column(&mut self, centre: Vec2, radius: f32, sides: u32, bottom: f32, top: f32) {
        self.prism(&regular(centre, radius, sides), bottom, top);
    }

    /// A pyramid over a regular polygon, without its floor.
    pub(super) fn cone(&mut self, centre: Vec2, radius: f32, sides: u32, bottom: f32, top: f32) {
        let ring = regular(centre, radius, sides);
        let at = |corner: Vec2| Vec3::new(corner.x, bottom, corner.y);
        let tip = Vec3::new(centre.x, top, centre.y);
        for (i, &a) in ring.iter().enumerate() {
            self.polygon(&[at(ring[(i + 1) % ring.len()]), at(a), tip]);
        }
    }

    /// Takes in another mesh, turned, moved and scaled evenly.
    pub(super) fn add(&mut self, other: Self, place: Transform) {
        let first = self.positions.len() as u32;
        let at = |position| place.transform_point(Vec3::from(position)).to_array();
        self.positions.extend(other.positions.into_iter().map(at));
        let turned = |normal| (place.rotation * Vec3::from(normal)).to_array();
        self.normals.extend(other.normals.into_iter().map(turned));
        self.indices
            .extend(other.indices.into_iter().map(|index| first + index));
    }

    /// A [`column`](Self::column) from one point to another.
    pub(super) fn bar(&mut self, from: Vec3, to: Vec3, radius: f32, sides: u32) {
        let along = to - from;
        let mut bar = Self::default();
        bar.column(Vec2::ZERO, radius, sides, 0.0, along.length());
        let turn = Quat::from_rotation_arc(Vec3::Y, along.normalize_or(Vec3::Y));
        self.add(bar, Transform::from_translation(from).with_rotation(turn));
    }

    /// A convex polygon that is seen from both sides.
    pub(super) fn sheet(&mut self, corners: &[Vec3]) {
        self.polygon(corners);
        let back: Vec<Vec3> = corners.iter().rev().copied().collect();
        self.polygon(&back);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.indices.is_empty()
    }

    pub(super) fn mesh(self) -> Mesh {
        mesh(self.positions, self.normals, self.indices)
    }
}

fn regular(centre: Vec2, radius: f32, sides: u32) -> Vec<Vec2> {
    let step = core::f32::consts::TAU / sides as f32;
    (0..sides)
        .map(|i| centre + radius * Vec2::from_angle(i as f32 * step))
        .collect()
}

/// An indexed triangle mesh.
pub(super) fn mesh(positions: Vec<[f32; 3]>, normals: Vec<[f32; 3]>, indices: Vec<u32>) -> Mesh {
    Mesh::new(
        PrimitiveTopology::TriangleList,
        RenderAssetUsages::default(),
    )
    .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
    .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, normals)
    .with_inserted_indices(Indices::U32(indices))
}

/// Triangles of a mesh.
pub(super) fn triangles(mesh: &Mesh) -> usize {
    mesh.indices().map_or(0, Indices::len) / 3
}

/// Corners of a mesh's triangles.
pub(super) fn corners(mesh: &Mesh) -> Vec<[Vec3; 3]> {
    let (Some(VertexAttributeValues::Float32x3(positions)), Some(indices)) =
        (mesh.attribute(Mesh::ATTRIBUTE_POSITION), mesh.indices())
    else {
        return Vec::new();
    };
    let indices: Vec<usize> = indices.iter().collect();
    indices
        .chunks_exact(3)
        .map(|three| [three[0], three[1], three[2]].map(|i| Vec3::from(positions[i])))
        .collect()
}

/// Normals of shared vertices, weighted by the areas of their triangles.
pub(super) fn smooth_normals(positions: &[[f32; 3]], indices: &[u32]) -> Vec<[f32; 3]> {
    let mut sums = vec![Vec3::ZERO; positions.len()];
    for three in indices.chunks_exact(3) {
        let [a, b, c] = [three[0], three[1], three[2]].map(|i| Vec3::from(positions[i as usize]));
        let area = (b - a).cross(c - a);
        for &i in three {
            sums[i as usize] += area;
        }
    }
    sums.into_iter()
        .map(|sum| sum.normalize_or(Vec3::Y).to_array())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_and_roofs_face_outward() {
        let mut faces = Faces::default();
        faces.block(Vec2::ZERO, Vec2::new(2.0, 3.0), 0.0, 5.0);
        faces.cone(Vec2::ZERO, 1.0, 5, 5.0, 9.0);
        let mesh = faces.mesh();
        assert_eq!(triangles(&mesh), 10 + 5);
        for [a, b, c] in corners(&mesh) {
            let outward = (b - a).cross(c - a);
            let middle = (a + b + c) / 3.0 - Vec3::new(0.0, 2.5, 0.0);
            assert!(outward.dot(middle) > 0.0, "{a} {b} {c}");
        }
    }

    #[test]
    fn bars_reach_from_end_to_end_and_face_outward() {
        let (from, to) = (Vec3::new(1.0, 2.0, 3.0), Vec3::new(-2.0, 2.5, 7.0));
        let mut faces = Faces::default();
        faces.bar(from, to, 0.1, 6);
        let normals = faces.normals.clone();
        let mesh = faces.mesh();
        assert_eq!(triangles(&mesh), 12 + 4);
        for [a, b, c] in corners(&mesh) {
            let middle = (a + b + c) / 3.0 - 0.5 * (from + to);
            assert!((b - a).cross(c - a).dot(middle) > 0.0, "{a} {b} {c}");
            for corner in [a, b, c] {
                let ends = corner.distance(from).min(corner.distance(to));
                assert!((ends - 0.1).abs() < 1e-4, "{corner}");
            }
        }
        assert!(normals.iter().all(|n| Vec3::from(*n).is_normalized()));
    }

    #[test]
    fn a_sheet_shows_from_both_sides() {
        let mut faces = Faces::default();
        faces.sheet(&[Vec3::ZERO, Vec3::X, Vec3::Y]);
        let normals = corners(&faces.mesh())
            .into_iter()
            .map(|[a, b, c]| (b - a).cross(c - a).normalize_or_zero());
        assert_eq!(normals.collect::<Vec<_>>(), [Vec3::Z, Vec3::NEG_Z]);
    }
}
