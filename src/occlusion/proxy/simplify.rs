//! Simplified meshes to choose from. None of them needs to be good for the proxy to be right.

use bevy::{math::DVec3, prelude::*};
use meshopt::{SimplifyOptions, VertexDataAdapter, simplify_sloppy, simplify_with_update};

use super::Welded;

/// Simplified meshes of at least one and at most `most` triangles, which must not be zero.
pub(super) fn candidates(mesh: &Welded, most: usize) -> Vec<Vec<[Vec3; 3]>> {
    let proper: Vec<[u32; 3]> = mesh
        .faces
        .iter()
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .copied()
        .collect();
    let mut found = if proper.len() <= most {
        vec![corners(&mesh.positions, proper.as_flattened())]
    } else {
        simplified(mesh, proper.as_flattened(), most)
    };
    found.retain(|candidate| (1..=most).contains(&candidate.len()));
    if found.is_empty() {
        found.push(vec![longest(&mesh.positions)]);
    }
    found
}

/// By edge collapses, vertices moved to where they fit best; where these stop short, also with small parts left
/// out, and by clustering.
fn simplified(mesh: &Welded, indices: &[u32], most: usize) -> Vec<Vec<[Vec3; 3]>> {
    let target = 3 * most;
    // In a unit cube, so that no quadric over- or underflows.
    let (min, max) = mesh.positions.iter().fold(
        (DVec3::INFINITY, DVec3::NEG_INFINITY),
        |(min, max), position| (min.min(position.as_dvec3()), max.max(position.as_dvec3())),
    );
    let size = (max - min).max_element();
    if size == 0.0 {
        return Vec::new();
    }
    let unit: Vec<[f32; 3]> = mesh
        .positions
        .iter()
        .map(|position| ((position.as_dvec3() - min) / size).as_vec3().to_array())
        .collect();
    let back = |unit: &[f32; 3]| (Vec3::from(*unit).as_dvec3() * size + min).as_vec3();

    let collapsed = |options| {
        let mut moved = unit.clone();
        let mut kept = indices.to_vec();
        let count = simplify_with_update(
            &mut kept,
            &mut moved,
            &mut [],
            &[],
            0,
            None,
            target,
            f32::MAX,
            options,
            None,
        );
        kept.truncate(count);
        let moved: Vec<Vec3> = moved.iter().map(back).collect();
        (1..=target)
            .contains(&count)
            .then(|| corners(&moved, &kept))
    };
    let mut found: Vec<Vec<[Vec3; 3]>> = [SimplifyOptions::None, SimplifyOptions::RegularizeLight]
        .into_iter()
        .filter_map(collapsed)
        .collect();
    if found.is_empty() {
        found.extend(collapsed(SimplifyOptions::Prune));
        if let Ok(vertices) = VertexDataAdapter::new(bytemuck::cast_slice(&unit), 12, 0) {
            let kept = simplify_sloppy(indices, &vertices, target, 1.0, None);
            found.push(corners(&mesh.positions, &kept));
        }
    }
    found
}

/// The triangles, less those that name a vertex that is not there.
fn corners(positions: &[Vec3], indices: &[u32]) -> Vec<[Vec3; 3]> {
    indices
        .as_chunks::<3>()
        .0
        .iter()
        .filter_map(|&[a, b, c]| {
            Some([
                *positions.get(a as usize)?,
                *positions.get(b as usize)?,
                *positions.get(c as usize)?,
            ])
        })
        .collect()
}

/// A triangle of no area, nearly as long as the mesh is.
fn longest(positions: &[Vec3]) -> [Vec3; 3] {
    let farthest_from = |from: Vec3| {
        positions.iter().fold(from, |farthest, &position| {
            let (was, is) = (
                from.as_dvec3().distance_squared(farthest.as_dvec3()),
                from.as_dvec3().distance_squared(position.as_dvec3()),
            );
            if is > was { position } else { farthest }
        })
    };
    let start = positions.first().copied().unwrap_or_default();
    let end = farthest_from(start);
    [end, farthest_from(end), end]
}
