//! A block of detailed models, as in P2's Fig. 16 (100 bunnies of 10,000 triangles) and Table 1 (9, 100, 1000).

use core::f32::consts::{PI, TAU};
use std::path::Path;

use bevy::prelude::*;
use meshopt::{SimplifyOptions, simplify_decoder};

use super::{
    Object, Scene, SceneError, View,
    obj::{self, ObjMesh},
    shapes,
};

/// From one model to the next, in models' sizes.
const PITCH: Vec3 = Vec3::new(1.02, 1.0, 0.9);

/// How many models, and of how many triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// Columns, layers and rows.
    pub count: UVec3,
    /// Most triangles of a model.
    pub triangles: u32,
}

impl Block {
    /// Nine of 10,000 triangles, three in each of three rows (P2, Table 1).
    pub const NINE: Self = Self::of(UVec3::new(3, 1, 3), 10_000);
    /// A hundred of 10,000 triangles, ten in each of ten rows (P2, Fig. 16 and Table 1).
    pub const HUNDRED: Self = Self::of(UVec3::new(10, 1, 10), 10_000);
    /// A thousand, ten hundreds on top of each other (P2, Table 1).
    pub const THOUSAND: Self = Self::of(UVec3::splat(10), 10_000);

    /// Of any size.
    pub const fn of(count: UVec3, triangles: u32) -> Self {
        Self { count, triangles }
    }

    /// How many models.
    pub fn len(self) -> usize {
        (self.count.x * self.count.y * self.count.z) as usize
    }

    /// Whether there is none.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }
}

/// A block of a model from an OBJ file, simplified with meshoptimizer.
///
/// # Errors
/// [`SceneError`].
pub fn from_file(path: &Path, block: Block) -> Result<Scene, SceneError> {
    let model = obj::read(path)?;
    let stem = path.file_stem().unwrap_or(path.as_os_str());
    let name = format!("{}_{}", stem.to_string_lossy(), block.len());
    Ok(arrange(name, simplify(model, block.triangles), block))
}

/// A model from an OBJ file as it is.
///
/// # Errors
/// [`SceneError`].
pub fn whole_from_file(path: &Path) -> Result<Mesh, SceneError> {
    Ok(mesh_of(obj::read(path)?))
}

/// A sphere with bumps of about so many triangles.
pub fn bumpy_mesh(triangles: u32) -> Mesh {
    mesh_of(bumpy_sphere(triangles))
}

/// The same block of spheres with bumps, for machines without the model.
pub fn generated(block: Block) -> Scene {
    let name = format!("bumpy_sphere_{}", block.len());
    arrange(name, bumpy_sphere(block.triangles), block)
}

/// At most so many triangles, without unused vertices.
fn simplify(model: ObjMesh, triangles: u32) -> ObjMesh {
    let indices = simplify_decoder(
        &model.indices,
        &model.positions,
        3 * triangles as usize,
        // The count alone decides.
        1.0,
        SimplifyOptions::None,
        None,
    );
    let mut place = vec![u32::MAX; model.positions.len()];
    let mut simple = ObjMesh::default();
    for index in indices {
        let at = &mut place[index as usize];
        if *at == u32::MAX {
            *at = simple.positions.len() as u32;
            simple.positions.push(model.positions[index as usize]);
        }
        simple.indices.push(*at);
    }
    simple
}

/// A sphere of exactly so many triangles for 1,000 and 10,000, about so many else.
fn bumpy_sphere(triangles: u32) -> ObjMesh {
    // Around the poles one triangle a slice, between them two; about twice as many stacks as half the slices.
    let slices = ((triangles as f32).sqrt() as u32).max(3);
    let slices = (slices..2 * slices)
        .find(|slices| triangles.is_multiple_of(2 * slices))
        .unwrap_or(slices);
    let stacks = (triangles / (2 * slices) + 1).max(2);
    let at = |stack: u32, slice: u32| {
        let (down, round) = (
            PI * stack as f32 / stacks as f32,
            TAU * slice as f32 / slices as f32,
        );
        let bumps = (5.0 * round).sin() * (4.0 * down).sin() * down.sin();
        let radius =
            0.5 * (1.0 + 0.12 * bumps + 0.25 * down.cos() * (2.0 * round).cos() * down.sin());
        let (sin, cos) = round.sin_cos();
        [
            radius * down.sin() * cos,
            radius * down.cos(),
            radius * down.sin() * sin,
        ]
    };
    let mut sphere = ObjMesh::default();
    sphere.positions.push(at(0, 0));
    for stack in 1..stacks {
        sphere
            .positions
            .extend((0..slices).map(|slice| at(stack, slice)));
    }
    sphere.positions.push(at(stacks, 0));
    let last = sphere.positions.len() as u32 - 1;
    let index = |stack: u32, slice: u32| match stack {
        0 => 0,
        _ if stack == stacks => last,
        _ => 1 + (stack - 1) * slices + slice % slices,
    };
    for stack in 0..stacks {
        for slice in 0..slices {
            let (a, b) = (index(stack, slice), index(stack, slice + 1));
            let (c, d) = (index(stack + 1, slice), index(stack + 1, slice + 1));
            if stack > 0 {
                sphere.indices.extend([a, b, c]);
            }
            if stack + 1 < stacks {
                sphere.indices.extend([b, d, c]);
            }
        }
    }
    sphere
}

/// With smooth normals.
fn mesh_of(model: ObjMesh) -> Mesh {
    let normals = shapes::smooth_normals(&model.positions, &model.indices);
    shapes::mesh(model.positions, normals, model.indices)
}

/// One metre large, on the ground, in rows.
fn arrange(name: String, mut model: ObjMesh, block: Block) -> Scene {
    let bounds = |positions: &[[f32; 3]]| {
        positions
            .iter()
            .map(|at| Vec3::from(*at))
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), at| {
                (low.min(at), high.max(at))
            })
    };
    let (low, high) = bounds(&model.positions);
    let size = (high - low).max_element().max(f32::MIN_POSITIVE);
    let foot = Vec3::new(0.5 * (low.x + high.x), low.y, 0.5 * (low.z + high.z));
    for at in &mut model.positions {
        *at = ((Vec3::from(*at) - foot) / size).to_array();
    }
    let (low, high) = bounds(&model.positions);
    let mesh = mesh_of(model);
    let pitch = PITCH * (high - low);
    let middle = 0.5 * (block.count.as_vec3() - 1.0) * Vec3::new(1.0, 0.0, 1.0);
    let objects: Vec<Object> = (0..block.len() as u32)
        .map(|index| {
            let at = UVec3::new(
                index % block.count.x,
                index / (block.count.x * block.count.z),
                index / block.count.x % block.count.z,
            );
            let place = (at.as_vec3() - middle) * pitch;
            Object::still(0, index as usize % 3, Transform::from_translation(place))
        })
        .collect();
    let reach = 0.5 * block.count.as_vec3() * pitch;
    let (low, high) = (
        Vec3::new(-reach.x, 0.0, -reach.z),
        Vec3::new(reach.x, 2.0 * reach.y, reach.z),
    );
    let centre = 0.5 * (low + high);
    let back = 0.9 * reach.x.max(reach.y) + 0.6;
    let front = Vec3::new(0.0, centre.y, high.z + back);
    let far = 2.2 * (high - low).length();
    Scene {
        name,
        meshes: vec![mesh],
        paints: vec![
            Color::linear_rgb(0.6, 0.5, 0.4),
            Color::linear_rgb(0.4, 0.5, 0.6),
            Color::linear_rgb(0.5, 0.55, 0.4),
        ],
        objects,
        views: vec![
            View::at("front", front, centre),
            View::at("above", centre + far * Vec3::new(0.1, 0.9, 0.3), centre),
        ],
        walk: [
            front - Vec3::X * reach.x,
            front + Vec3::X * reach.x - Vec3::Z * 0.4 * back,
        ],
        bounds: [low, high],
        stride_m: 0.02,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spheres_have_the_triangles_asked_for_and_are_closed() {
        for triangles in [1_000, 10_000] {
            let sphere = bumpy_sphere(triangles);
            assert_eq!(sphere.indices.len(), 3 * triangles as usize);
            let edges = |from: usize, to: usize| {
                sphere
                    .indices
                    .chunks_exact(3)
                    .flat_map(move |t| (0..3).map(move |i| (t[(i + from) % 3], t[(i + to) % 3])))
                    .collect::<std::collections::BTreeSet<_>>()
            };
            // Each edge is met once from either side.
            assert_eq!(edges(0, 1), edges(1, 0));
            assert_eq!(edges(0, 1).len(), sphere.indices.len());
            for three in sphere.indices.chunks_exact(3) {
                let [a, b, c] = [0, 1, 2].map(|i| Vec3::from(sphere.positions[three[i] as usize]));
                assert!((b - a).cross(c - a).dot(a + b + c) > 0.0, "turned inward");
            }
        }
    }
}
