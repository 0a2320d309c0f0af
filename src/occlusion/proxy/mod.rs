//! The simplified mesh that stands for a mesh (P2, §4.4), made to enclose it.
//!
//! A simplified mesh alone is no bound: it cuts corners, and what it cuts off may be seen. So each of its
//! triangles is thickened: it stands for all points within a radius of it.
//!
//! # Why it encloses the mesh
//! Every triangle of the mesh is given to one triangle of the proxy. The distance to a convex set is a convex
//! function, so over the given triangle it is largest at one of the three corners; the proxy triangle's radius is
//! not less than the largest of these. The distance to a corner is measured to a point that lies in the proxy
//! triangle by construction, so that even a poor choice of that point errs outward.

mod enclose;
mod simplify;

use bevy::{
    math::DVec3,
    platform::collections::{HashMap, HashSet},
    prelude::*,
};

use crate::occlusion::volume::{Proxy, SweptTriangle};

/// No proxy has more triangles, whatever is asked for: work grows with their number times the mesh's.
pub const MOST_TRIANGLES: u32 = 1024;

/// Makes the proxy of a triangle list: at most `most_triangles`, and at most [`MOST_TRIANGLES`], thickened
/// triangles that together enclose every point of every triangle of the mesh, those of no area included.
///
/// `None` if there is no triangle, if `most_triangles` is zero, if the number of indices is no multiple of three,
/// if one points past the positions, if a position is not finite, or if a radius is too large for an `f32`.
///
/// Takes about a second for 100,000 triangles: for a thread in the background.
///
/// # Reference
/// P2, §4.4, which simplifies by QSlim and draws what comes out as it is.
pub fn build(positions: &[Vec3], indices: &[u32], most_triangles: u32) -> Option<Proxy> {
    let mesh = weld(positions, indices)?;
    let most = most_triangles.min(MOST_TRIANGLES) as usize;
    if most == 0 {
        return None;
    }
    let faces: Vec<[DVec3; 3]> = mesh
        .faces
        .iter()
        .map(|face| face.map(|corner| mesh.positions[corner as usize].as_dvec3()))
        .collect();
    let triangles = simplify::candidates(&mesh, most)
        .iter()
        .filter_map(|candidate| enclose::enclose(&faces, candidate))
        .min_by(|a, b| surface(a).total_cmp(&surface(b)))?;
    Some(Proxy { triangles })
}

/// A mesh whose corners at one place are one vertex, with every face once and no vertex without a face.
struct Welded {
    positions: Vec<Vec3>,
    faces: Vec<[u32; 3]>,
}

/// Joins what the mesh keeps apart for its normals and texture coordinates: a simplifier moves no vertex that
/// has a neighbour it does not know of.
fn weld(positions: &[Vec3], indices: &[u32]) -> Option<Welded> {
    let (faces, []) = indices.as_chunks::<3>() else {
        return None;
    };
    if faces.is_empty() || !positions.iter().all(|position| position.is_finite()) {
        return None;
    }
    let mut vertices = HashMap::with_capacity(positions.len());
    let mut welded = Vec::with_capacity(positions.len());
    let mut places = vec![None; positions.len()];
    let mut seen = HashSet::with_capacity(faces.len());
    let mut kept = Vec::with_capacity(faces.len());
    for face in faces {
        let mut corners = [0; 3];
        for (corner, &index) in corners.iter_mut().zip(face) {
            let position = *positions.get(index as usize)?;
            *corner = *places[index as usize].get_or_insert_with(|| {
                // Adding zero makes the two zeros one.
                let place = (position + Vec3::ZERO).to_array().map(f32::to_bits);
                *vertices.entry(place).or_insert_with(|| {
                    welded.push(position);
                    welded.len() as u32 - 1
                })
            });
        }
        let mut sorted = corners;
        sorted.sort_unstable();
        if seen.insert(sorted) {
            kept.push(corners);
        }
    }
    Some(Welded {
        positions: welded,
        faces: kept,
    })
}

/// Surface of the thickened triangles, each for itself: four times the area that they show on average over all
/// directions of view (Cauchy), by Steiner's formula for a flat convex set.
fn surface(triangles: &[SweptTriangle]) -> f64 {
    let of = |swept: &SweptTriangle| {
        let [a, b, c] = swept.corners.map(|corner| corner.as_dvec3());
        let radius = f64::from(swept.radius);
        let area = 0.5 * (b - a).cross(c - a).length();
        let perimeter = a.distance(b) + b.distance(c) + c.distance(a);
        core::f64::consts::PI * radius * (perimeter + 4.0 * radius) + 2.0 * area
    };
    triangles.iter().map(of).sum()
}
