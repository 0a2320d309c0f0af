//! Copies of what interior culling leaves of a model and of what it takes out, to be looked at: as in the figures of
//! P5a, the one transparent and blue, the other solid and red; and both cut open.

use std::collections::HashSet;

use bevy::{
    asset::RenderAssetUsages,
    mesh::{Indices, PrimitiveTopology, VertexAttributeValues},
    prelude::*,
};
use bevy_skyline::systems::interior::models::PartOf;

/// A part of the model as it was before anything was culled.
pub struct Original {
    entity: Entity,
    mesh: Handle<Mesh>,
    colour: Color,
}

impl Original {
    pub fn of(world: &World, entity: Entity) -> Option<Self> {
        let mesh = world.get::<Mesh3d>(entity)?.0.clone();
        let material = &world.get::<MeshMaterial3d<StandardMaterial>>(entity)?.0;
        let material = world.resource::<Assets<StandardMaterial>>().get(material)?;
        Some(Self {
            entity,
            mesh,
            colour: material.base_color,
        })
    }
}

/// The copies: what is seen and what was removed, whole and cut open.
pub struct Removed {
    whole: Vec<Entity>,
    cut: Vec<Entity>,
}

/// A triangle where it stands, and whether it was removed.
#[derive(Clone, Copy)]
struct Triangle {
    corners: [Vec3; 3],
    normals: [Vec3; 3],
    colour: [f32; 4],
    is_removed: bool,
}

impl Removed {
    /// Makes the copies from what the culled entities show now.
    pub fn spawn(world: &mut World, parts: &[Original]) -> Self {
        let triangles = collect(world, parts);
        let (low, high) = triangles
            .iter()
            .flat_map(|triangle| triangle.corners)
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), at| {
                (low.min(at), high.max(at))
            });
        let middle = 0.5 * (low + high);
        let blue = StandardMaterial {
            base_color: Color::srgba(0.2, 0.4, 0.95, 0.12),
            alpha_mode: AlphaMode::Blend,
            unlit: true,
            ..default()
        };
        let red = StandardMaterial {
            base_color: Color::srgb(0.85, 0.08, 0.06),
            perceptual_roughness: 0.7,
            cull_mode: None,
            double_sided: true,
            ..default()
        };
        let own = StandardMaterial {
            perceptual_roughness: 0.7,
            cull_mode: None,
            double_sided: true,
            ..default()
        };
        let mut add = |triangles: &[Triangle], material: &StandardMaterial, is_painted: bool| {
            let mesh = mesh(triangles, is_painted);
            let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
            let material = world
                .resource_mut::<Assets<StandardMaterial>>()
                .add(material.clone());
            world.spawn((Mesh3d(mesh), MeshMaterial3d(material))).id()
        };
        let (removed, seen): (Vec<_>, Vec<_>) = triangles
            .into_iter()
            .partition(|triangle| triangle.is_removed);
        let cut = |all: &[Triangle]| -> Vec<Triangle> {
            all.iter()
                .flat_map(|triangle| triangle.cut(middle))
                .collect()
        };
        Self {
            whole: vec![add(&seen, &blue, false), add(&removed, &red, false)],
            cut: vec![
                add(&cut(&seen), &own, true),
                add(&cut(&removed), &red, false),
            ],
        }
    }

    pub fn show(&self, world: &mut World, whole: bool, cut: bool) {
        for (entities, is_shown) in [(&self.whole, whole), (&self.cut, cut)] {
            let visibility = if is_shown {
                Visibility::Visible
            } else {
                Visibility::Hidden
            };
            for entity in entities {
                world.entity_mut(*entity).insert(visibility);
            }
        }
    }

    pub fn despawn(self, world: &mut World) {
        for entity in self.whole.into_iter().chain(self.cut) {
            world.despawn(entity);
        }
    }
}

impl Triangle {
    /// What is left of it when the quarter that faces the camera is taken away: where x and z are above the middle's.
    fn cut(&self, middle: Vec3) -> Vec<Self> {
        let corners = [0, 1, 2].map(|i| (self.corners[i], self.normals[i]));
        let left = clip(&corners, |at| middle.x - at.x);
        let right = clip(&corners, |at| at.x - middle.x);
        let behind = clip(&right, |at| middle.z - at.z);
        let fans = [left, behind];
        let fans = fans
            .iter()
            .flat_map(|fan| (2..fan.len()).map(|i| [fan[0], fan[i - 1], fan[i]]));
        fans.map(|three| Self {
            corners: three.map(|(at, _)| at),
            normals: three.map(|(_, normal)| normal),
            ..*self
        })
        .collect()
    }
}

/// What of a polygon of places and normals is where a linear function is not negative.
fn clip(corners: &[(Vec3, Vec3)], inside: impl Fn(Vec3) -> f32) -> Vec<(Vec3, Vec3)> {
    let mut left = Vec::new();
    for (i, &(at, normal)) in corners.iter().enumerate() {
        let (next, next_normal) = corners[(i + 1) % corners.len()];
        let (here, there) = (inside(at), inside(next));
        if here >= 0.0 {
            left.push((at, normal));
        }
        if (here >= 0.0) != (there >= 0.0) {
            let part = here / (here - there);
            left.push((at.lerp(next, part), normal.lerp(next_normal, part)));
        }
    }
    left
}

fn collect(world: &World, parts: &[Original]) -> Vec<Triangle> {
    let meshes = world.resource::<Assets<Mesh>>();
    let mut triangles = Vec::new();
    for part in parts {
        let (Some(place), Some(now), Some(whole)) = (
            world.get::<GlobalTransform>(part.entity),
            world.get::<Mesh3d>(part.entity),
            meshes.get(&part.mesh),
        ) else {
            continue;
        };
        let is_hidden = world
            .get::<PartOf>(part.entity)
            .is_some_and(PartOf::is_hidden);
        // A trimmed mesh has the triangles that stay, to the last bit.
        let kept: Option<HashSet<[[u32; 3]; 3]>> = (now.0 != part.mesh)
            .then(|| meshes.get(&now.0))
            .flatten()
            .map(|trimmed| {
                corners(trimmed)
                    .into_iter()
                    .map(|(corners, _)| bits(corners))
                    .collect()
            });
        // Blue-grey, so that red is what was removed.
        let bright = 0.15 + 0.7 * part.colour.luminance().sqrt();
        let colour = Color::srgb(0.72 * bright, 0.82 * bright, bright)
            .to_linear()
            .to_f32_array();
        for (local, normals) in corners(whole) {
            let is_removed = is_hidden
                || kept
                    .as_ref()
                    .is_some_and(|kept| !kept.contains(&bits(local)));
            triangles.push(Triangle {
                corners: local.map(|at| place.transform_point(Vec3::from(at))),
                normals: normals.map(|n| {
                    (place.affine().matrix3 * bevy::math::Vec3A::from(n))
                        .normalize_or_zero()
                        .into()
                }),
                colour,
                is_removed,
            });
        }
    }
    triangles
}

/// Something at each corner of a triangle.
type Corners = [[f32; 3]; 3];

fn bits(corners: Corners) -> [[u32; 3]; 3] {
    corners.map(|at| at.map(f32::to_bits))
}

/// A mesh's positions; none if they are not here.
pub fn positions(mesh: &Mesh) -> &[[f32; 3]] {
    match mesh.try_attribute_option(Mesh::ATTRIBUTE_POSITION) {
        Ok(Some(VertexAttributeValues::Float32x3(positions))) => positions,
        _ => &[],
    }
}

/// The corners of a list's triangles, and the normals there.
fn corners(mesh: &Mesh) -> Vec<(Corners, Corners)> {
    let positions = positions(mesh);
    let normals = match mesh.try_attribute_option(Mesh::ATTRIBUTE_NORMAL) {
        Ok(Some(VertexAttributeValues::Float32x3(normals))) => normals.as_slice(),
        _ => &[],
    };
    let indices: Vec<usize> = match mesh.indices() {
        Some(indices) => indices.iter().collect(),
        None => (0..positions.len()).collect(),
    };
    let three = |i: &[usize]| {
        let [a, b, c] = [i[0], i[1], i[2]].map(|i| Some((*positions.get(i)?, *normals.get(i)?)));
        let [a, b, c] = [a?, b?, c?];
        Some(([a.0, b.0, c.0], [a.1, b.1, c.1]))
    };
    indices.chunks_exact(3).filter_map(three).collect()
}

fn mesh(triangles: &[Triangle], is_painted: bool) -> Mesh {
    let of = |pick: fn(&Triangle) -> [Vec3; 3]| -> Vec<[f32; 3]> {
        triangles.iter().flat_map(pick).map(Vec3::into).collect()
    };
    let mut mesh = Mesh::new(
        PrimitiveTopology::TriangleList,
        RenderAssetUsages::RENDER_WORLD,
    )
    .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, of(|triangle| triangle.corners))
    .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, of(|triangle| triangle.normals))
    .with_inserted_indices(Indices::U32((0..3 * triangles.len() as u32).collect()));
    if is_painted {
        let colours: Vec<[f32; 4]> = triangles
            .iter()
            .flat_map(|triangle| [triangle.colour; 3])
            .collect();
        mesh.insert_attribute(Mesh::ATTRIBUTE_COLOR, colours);
    }
    mesh
}
