//! A sea bed of about 2,134,016 triangles in 256 blocks, as in P2's Fig. 17: ridges hide most of it.

use bevy::prelude::*;

use super::{Object, Scene, View, shapes};
use crate::offline::accuracy::scene::fractal;

/// Blocks a side.
const BLOCKS: u32 = 16;
/// Side of a block. units: m
const BLOCK_M: f32 = 100.0;
/// Cells of a block, along x and along z: 2,129,920 triangles in all, P2's 2,134,016 to within 0.2 %.
const CELLS: UVec2 = UVec2::new(65, 64);
/// The same for quick runs: 131,072 triangles.
const QUICK_CELLS: UVec2 = UVec2::new(16, 16);

/// The sea bed. `quick` has the same blocks with fewer triangles.
pub fn seabed(quick: bool) -> Scene {
    let cells = if quick { QUICK_CELLS } else { CELLS };
    let mut meshes = Vec::new();
    let mut objects = Vec::new();
    for block in 0..BLOCKS * BLOCKS {
        let corner = UVec2::new(block % BLOCKS, block / BLOCKS);
        let transform = Transform::from_translation(block_middle(corner));
        objects.push(Object::still(
            meshes.len(),
            (corner.x + corner.y) as usize % 2,
            transform,
        ));
        meshes.push(block_mesh(corner, cells));
    }
    let half = 0.5 * BLOCKS as f32 * BLOCK_M;
    // Looking across the ridges: from low between two of them, and from just below a crest.
    let ahead = Vec3::new(10.0, 0.0, -100.0);
    let valley = Vec3::new(60.0, 110.0, 300.0);
    let crest = Vec3::new(60.0, 150.0, 280.0);
    let name = if quick { "quick_seabed" } else { "seabed" };
    Scene {
        name: name.into(),
        meshes,
        paints: vec![
            Color::linear_rgb(0.34, 0.42, 0.38),
            Color::linear_rgb(0.30, 0.40, 0.42),
        ],
        objects,
        views: vec![
            View::at("above", Vec3::new(0.0, 1_750.0, 0.0), Vec3::ZERO),
            View::at("view_1", valley, valley + ahead),
            View::at("view_2", crest, crest + ahead),
        ],
        walk: [
            Vec3::new(-200.0, 110.0, 300.0),
            Vec3::new(200.0, 110.0, 300.0),
        ],
        bounds: [Vec3::new(-half, -20.0, -half), Vec3::new(half, 190.0, half)],
        stride_m: 0.5,
    }
}

fn block_middle(corner: UVec2) -> Vec3 {
    let at = (corner.as_vec2() + 0.5 - 0.5 * BLOCKS as f32) * BLOCK_M;
    Vec3::new(at.x, 0.0, at.y)
}

/// Height of the ground. units: m
fn height_m(at: Vec2) -> f32 {
    let rough = fractal(at * (1.0 / 260.0), 6, |n| n);
    let bend = 60.0 * fractal(at * (1.0 / 700.0) + 11.0, 3, |n| n);
    // Long ridges across the view, each 200 m from the next, and of uneven height.
    let crest = 0.5 + 0.5 * (core::f32::consts::TAU * (at.y + bend) / 200.0).cos();
    let tall = 0.75 + 0.5 * fractal(at * (1.0 / 400.0) + 5.0, 2, |n| n);
    150.0 * tall * crest.powi(3) + 26.0 * rough
}

fn block_mesh(corner: UVec2, cells: UVec2) -> Mesh {
    let middle = block_middle(corner);
    let at = |column: u32, row: u32| {
        let part = UVec2::new(column, row).as_vec2() / cells.as_vec2() - 0.5;
        let local = part * BLOCK_M;
        Vec3::new(local.x, height_m(middle.xz() + local), local.y)
    };
    let (mut positions, mut normals, mut indices) = (Vec::new(), Vec::new(), Vec::new());
    for row in 0..=cells.y {
        for column in 0..=cells.x {
            let place = at(column, row);
            let (dx, dz) = (Vec2::new(0.5, 0.0), Vec2::new(0.0, 0.5));
            let ground = middle.xz() + place.xz();
            let slope = Vec2::new(
                height_m(ground + dx) - height_m(ground - dx),
                height_m(ground + dz) - height_m(ground - dz),
            );
            positions.push(place.to_array());
            normals.push(Vec3::new(-slope.x, 1.0, -slope.y).normalize().to_array());
        }
    }
    let line = cells.x + 1;
    for row in 0..cells.y {
        for column in 0..cells.x {
            let a = row * line + column;
            let (b, c, d) = (a + 1, a + line, a + line + 1);
            indices.extend([a, c, b, b, c, d]);
        }
    }
    shapes::mesh(positions, normals, indices)
}
