//! The volumes that stand for an object, in its mesh's own space. Each encloses the object; a test that finds the
//! volume hidden has found the object hidden.

use bevy::prelude::*;

/// A box of any orientation: the points `centre + u·axes[0] + v·axes[1] + w·axes[2]` with `u, v, w` in `-1..=1`.
/// An axis may be zero.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub struct LocalBox {
    /// Its centre.
    pub centre: Vec3,
    /// Its half axes, at right angles to each other.
    pub axes: [Vec3; 3],
}

impl LocalBox {
    /// Whether its axes are those of the space it is in: an `Aabb` there.
    pub fn is_along_axes(&self) -> bool {
        self.axes
            .iter()
            .all(|axis| axis.to_array().iter().filter(|part| **part != 0.0).count() <= 1)
    }

    /// Its point nearest to a point of the same space.
    pub fn nearest(&self, point: Vec3) -> Vec3 {
        let from_centre = point - self.centre;
        let along = |axis: &Vec3| {
            let length2 = axis.length_squared();
            if length2 > 0.0 {
                *axis * (from_centre.dot(*axis) / length2).clamp(-1.0, 1.0)
            } else {
                Vec3::ZERO
            }
        };
        self.centre + self.axes.iter().map(along).sum::<Vec3>()
    }
}

/// All points within `radius` of a triangle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SweptTriangle {
    /// The triangle's corners; they may coincide.
    pub corners: [Vec3; 3],
    /// How far around the triangle it reaches, not negative.
    pub radius: f32,
}

/// A simplified mesh whose thickened triangles together enclose every point of the mesh it stands for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Proxy {
    /// The thickened triangles.
    pub triangles: Vec<SweptTriangle>,
}
