//! The box that stands for a mesh: along the axes of the covariance of its vertices (P2, §3.2), or along the
//! mesh's own axes where that one is smaller.

use bevy::{camera::primitives::Aabb, math::DVec3, prelude::*};

use crate::culling::volume::LocalBox;

/// How often a box may be widened to undo the rounding of its axes to `f32`, before it is given up for the
/// aligned one.
const WIDENINGS: usize = 16;
/// How far inside their box the points stay, as a part of its half axes: far above what `f64` arithmetic on
/// `f32` values can be wrong by.
const MARGIN: f64 = 1e-9;

impl From<Aabb> for LocalBox {
    fn from(aabb: Aabb) -> Self {
        let half = Vec3::from(aabb.half_extents);
        Self {
            centre: aabb.center.into(),
            axes: along_axes(half),
        }
    }
}

/// The box along the coordinate axes from `min` to `max`, which must be finite and in order. Errs outward by less
/// than the rounding of its numbers.
pub fn aligned(min: Vec3, max: Vec3) -> LocalBox {
    let (low, high) = (min.as_dvec3(), max.as_dvec3());
    let centre = (0.5 * (low + high)).as_vec3();
    let half = (high - centre.as_dvec3()).max(centre.as_dvec3() - low);
    LocalBox {
        centre,
        axes: along_axes(Vec3::from_array(half.to_array().map(round_up))),
    }
}

/// A box that encloses every position, or `None` if there is none or one is not finite.
///
/// Of the box along the axes of the positions' covariance and the one along the coordinate axes it is that of the
/// smaller volume, at equal volumes that of the smaller surface: never larger than the axis-aligned one.
///
/// Every position lies in the `f32` box as it is, with the error of its rounded axes and centre counted in, when
/// the test for it is evaluated in `f64`. Its axes are at right angles to within the rounding of `f32`; positions
/// in a line, in a plane or at one point may give axes that are zero.
///
/// # Reference
/// P2, §3.2.
pub fn fit(positions: &[Vec3]) -> Option<LocalBox> {
    let first = *positions.first()?;
    if !positions.iter().all(|position| position.is_finite()) {
        return None;
    }
    let (min, max) = positions
        .iter()
        .fold((first, first), |(min, max), &p| (min.min(p), max.max(p)));
    let plain = aligned(min, max);
    Some(match turned(positions, covariance_axes(positions)) {
        Some(turned) if size(&turned) < size(&plain) => turned,
        _ => plain,
    })
}

/// The least `f32` that is not less than `value`.
pub(super) fn round_up(value: f64) -> f32 {
    let rounded = value as f32;
    if f64::from(rounded) < value {
        rounded.next_up()
    } else {
        rounded
    }
}

fn along_axes(half: Vec3) -> [Vec3; 3] {
    [
        Vec3::new(half.x, 0.0, 0.0),
        Vec3::new(0.0, half.y, 0.0),
        Vec3::new(0.0, 0.0, half.z),
    ]
}

/// Volume and surface, up to a factor. The first of a box whose axes are slightly askew is not less than its
/// volume.
fn size(of: &LocalBox) -> (f64, f64) {
    let [a, b, c] = of.axes.map(|axis| axis.as_dvec3().length());
    (a * b * c, a * b + b * c + c * a)
}

/// Unit eigenvectors of the positions' covariance, at right angles to each other.
fn covariance_axes(positions: &[Vec3]) -> [DVec3; 3] {
    let mean = positions.iter().map(|p| p.as_dvec3()).sum::<DVec3>() / positions.len() as f64;
    let mut covariance = [[0.0; 3]; 3];
    for position in positions {
        let from_mean = (position.as_dvec3() - mean).to_array();
        for (row, x) in covariance.iter_mut().zip(from_mean) {
            for (cell, y) in row.iter_mut().zip(from_mean) {
                *cell += x * y;
            }
        }
    }
    eigenvectors(covariance)
}

/// Eigenvectors of a symmetric matrix by cyclic Jacobi rotations. Their being at right angles does not depend on
/// convergence: they are a product of rotations.
fn eigenvectors(mut m: [[f64; 3]; 3]) -> [DVec3; 3] {
    let mut vectors = [DVec3::X, DVec3::Y, DVec3::Z];
    // It converges quadratically: some five sweeps are the rule.
    for _ in 0..32 {
        let off = m[0][1].abs() + m[0][2].abs() + m[1][2].abs();
        let trace = m[0][0].abs() + m[1][1].abs() + m[2][2].abs();
        if off <= 1e-20 * trace {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if m[p][q] == 0.0 {
                continue;
            }
            // The smaller of the two angles that make m[p][q] zero; a ratio that overflows gives the angle zero.
            let ratio = (m[q][q] - m[p][p]) / (2.0 * m[p][q]);
            let sign = if ratio < 0.0 { -1.0 } else { 1.0 };
            let tangent = sign / (ratio.abs() + ratio.hypot(1.0));
            let cosine = 1.0 / tangent.hypot(1.0);
            let sine = tangent * cosine;
            for row in &mut m {
                (row[p], row[q]) = (
                    cosine * row[p] - sine * row[q],
                    sine * row[p] + cosine * row[q],
                );
            }
            let (row_p, row_q) = (m[p], m[q]);
            m[p] = [0, 1, 2].map(|i| cosine * row_p[i] - sine * row_q[i]);
            m[q] = [0, 1, 2].map(|i| sine * row_p[i] + cosine * row_q[i]);
            (m[p][q], m[q][p]) = (0.0, 0.0);
            (vectors[p], vectors[q]) = (
                cosine * vectors[p] - sine * vectors[q],
                sine * vectors[p] + cosine * vectors[q],
            );
        }
    }
    vectors
}

/// The box along `axes`, which are unit vectors at right angles, that encloses the finite `positions`; `None`
/// where its numbers leave what `f32` can say.
fn turned(positions: &[Vec3], axes: [DVec3; 3]) -> Option<LocalBox> {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for position in positions {
        for (axis, (low, high)) in axes.iter().zip(low.iter_mut().zip(&mut high)) {
            let along = axis.dot(position.as_dvec3());
            (*low, *high) = (low.min(along), high.max(along));
        }
    }
    let exact = (0..3)
        .map(|i| axes[i] * (0.5 * (low[i] + high[i])))
        .sum::<DVec3>();
    let centre = exact.as_vec3();
    let moved = centre.as_dvec3() - exact;
    let mut half = [0, 1, 2].map(|i| {
        let half = 0.5 * (high[i] - low[i]) + axes[i].dot(moved).abs();
        half * (1.0 + 2.0 * f64::from(f32::EPSILON))
    });
    // No axis can be told from zero beside a longer one whose rounding sways more than this.
    let floor = 4.0 * f64::from(f32::EPSILON) * half.into_iter().fold(0.0, f64::max);
    for _ in 0..WIDENINGS {
        let rounded = [0, 1, 2].map(|i| (axes[i] * half[i]).as_vec3());
        if !centre.is_finite() || rounded.iter().any(|axis| !axis.is_finite()) {
            return None;
        }
        // Along a zero axis a point must not stray at all; its unit vector measures whether it does.
        let basis = [0, 1, 2].map(|i| {
            if rounded[i] == Vec3::ZERO {
                axes[i].as_vec3().as_dvec3()
            } else {
                rounded[i].as_dvec3()
            }
        });
        let strays = farthest(positions, centre, basis)?;
        let mut enclosed = true;
        for i in 0..3 {
            let flat = rounded[i] == Vec3::ZERO;
            if strays[i] > if flat { 0.0 } else { 1.0 - MARGIN } {
                enclosed = false;
                let stretch = if flat { 1.0 } else { strays[i] };
                half[i] = (half[i] * stretch * (1.0 + f64::from(f32::EPSILON))).max(floor);
            }
        }
        if enclosed {
            return Some(LocalBox {
                centre,
                axes: rounded,
            });
        }
    }
    None
}

/// The largest coordinates, by size, that the positions have from `centre` in the basis, which need not be at
/// right angles; `None` where it does not span space.
fn farthest(positions: &[Vec3], centre: Vec3, basis: [DVec3; 3]) -> Option<[f64; 3]> {
    let [a, b, c] = basis;
    let normals = [b.cross(c), c.cross(a), a.cross(b)];
    let volume = a.dot(normals[0]);
    if !volume.is_normal() {
        return None;
    }
    let mut farthest = [0.0_f64; 3];
    for position in positions {
        let from_centre = position.as_dvec3() - centre.as_dvec3();
        for (farthest, normal) in farthest.iter_mut().zip(normals) {
            *farthest = farthest.max((normal.dot(from_centre) / volume).abs());
        }
    }
    Some(farthest)
}
