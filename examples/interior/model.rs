//! A model as plain data, from a glTF binary or made by code.

use std::{collections::HashMap, path::Path};

use bevy::{
    asset::RenderAssetUsages,
    mesh::{Indices, PrimitiveTopology},
    prelude::*,
    render::render_resource::Face,
};

use crate::removed::positions;

/// Meshes, materials, and where they stand.
#[derive(Default)]
pub struct ModelData {
    pub name: String,
    pub meshes: Vec<Mesh>,
    pub materials: Vec<StandardMaterial>,
    /// What is above comes first.
    pub nodes: Vec<NodeData>,
}

/// One entity.
pub struct NodeData {
    pub above: Option<usize>,
    pub place: Transform,
    /// Indices of a mesh and a material.
    pub drawn: Option<(usize, usize)>,
}

/// Why a model could not be read; says itself in one line.
#[derive(thiserror::Error, Debug)]
pub enum ModelError {
    #[error("cannot read {0}: {1}")]
    Read(String, std::io::Error),
    #[error("{0} is no glTF binary that can be shown: {1}")]
    Gltf(String, String),
}

impl ModelData {
    /// Reads nodes, triangles and plain colours of a `.glb` file.
    ///
    /// # Errors
    /// [`ModelError`]: unreadable, no glTF binary, data that points outside the file, nothing to show.
    pub fn read(path: &Path) -> Result<Self, ModelError> {
        let name = path.display().to_string();
        let bytes = std::fs::read(path).map_err(|error| ModelError::Read(name.clone(), error))?;
        let broken =
            |reason: &dyn core::fmt::Display| ModelError::Gltf(name.clone(), reason.to_string());
        let file = gltf::Gltf::from_slice(&bytes).map_err(|error| broken(&error))?;
        let blob = file.blob.as_deref().unwrap_or_default();
        let mut model = Self {
            name: path
                .file_stem()
                .map_or_else(|| "model".into(), |stem| stem.to_string_lossy().into()),
            ..default()
        };
        let (mut mesh_of, mut material_of) = (HashMap::new(), HashMap::new());
        let roots = file.scenes().flat_map(|scene| scene.nodes());
        let mut open: Vec<_> = roots.map(|node| (node, None, false)).collect();
        while let Some((node, above, is_mirrored)) = open.pop() {
            let place = Mat4::from_cols_array_2d(&node.transform().matrix());
            let is_mirrored = is_mirrored != (place.determinant() < 0.0);
            let number = model.nodes.len();
            model.nodes.push(NodeData {
                above,
                place: Transform::from_matrix(place),
                drawn: None,
            });
            for part in node.mesh().iter().flat_map(|mesh| mesh.primitives()) {
                if part.mode() != gltf::mesh::Mode::Triangles {
                    continue;
                }
                let key = (node.mesh().map(|mesh| mesh.index()), part.index());
                let mesh = match mesh_of.get(&key) {
                    Some(mesh) => *mesh,
                    None => {
                        let mesh = triangles(&part, blob)
                            .ok_or_else(|| broken(&"a mesh points outside its data"))?;
                        model.meshes.push(mesh);
                        mesh_of.insert(key, model.meshes.len() - 1);
                        model.meshes.len() - 1
                    }
                };
                // As Bevy's loader does: in what is mirrored the other side is the front.
                let material = part.material();
                let material = *material_of
                    .entry((material.index(), is_mirrored))
                    .or_insert_with(|| {
                        model.materials.push(paint(&material, is_mirrored));
                        model.materials.len() - 1
                    });
                model.nodes.push(NodeData {
                    above: Some(number),
                    place: Transform::IDENTITY,
                    drawn: Some((mesh, material)),
                });
            }
            open.extend(
                node.children()
                    .map(|child| (child, Some(number), is_mirrored)),
            );
        }
        if model.meshes.is_empty() {
            return Err(broken(&"it has no triangles"));
        }
        Ok(model)
    }

    /// A closed cabinet with a window and a grille, full of shafts and balls, with about so many triangles.
    pub fn cabinet(triangles: usize) -> Self {
        let mut model = Self {
            name: "cabinet_generated".into(),
            ..default()
        };
        let paint = |color: Color| StandardMaterial {
            base_color: color,
            perceptual_roughness: 0.6,
            ..default()
        };
        model.materials = vec![
            paint(Color::srgb(0.75, 0.75, 0.78)),
            paint(Color::srgb(0.85, 0.55, 0.15)),
            paint(Color::srgb(0.25, 0.55, 0.35)),
            StandardMaterial {
                alpha_mode: AlphaMode::Blend,
                ..paint(Color::srgba(0.6, 0.8, 0.9, 0.3))
            },
        ];
        model.nodes.push(NodeData {
            above: None,
            place: Transform::IDENTITY,
            drawn: None,
        });
        let side = 8;
        let count = side * side * side;
        // A sphere of n sectors and n stacks has about 2 n² triangles.
        let fine = (((triangles / count) as f32 / 2.0).sqrt() as u32).clamp(6, 2000);
        let add = |model: &mut Self, mesh: Mesh, material: usize, place: Transform| {
            model.meshes.push(mesh);
            model.nodes.push(NodeData {
                above: Some(0),
                place,
                drawn: Some((model.meshes.len() - 1, material)),
            });
        };
        // Walls of some thickness, whose inner sides nobody sees; a quarter of the front is a window, and what is behind
        // that is parted from the rest.
        let walls = [
            ([0.4, 10.0, 10.0], [-4.8, 0.0, 0.0], 0),
            ([0.4, 10.0, 10.0], [4.8, 0.0, 0.0], 0),
            ([10.0, 0.4, 10.0], [0.0, -4.8, 0.0], 0),
            ([10.0, 0.4, 10.0], [0.0, 4.8, 0.0], 0),
            ([10.0, 10.0, 0.4], [0.0, 0.0, -4.8], 0),
            ([10.0, 5.0, 0.4], [0.0, -2.5, 4.8], 0),
            ([5.0, 5.0, 0.4], [-2.5, 2.5, 4.8], 0),
            ([5.0, 5.0, 0.4], [2.5, 2.5, 4.8], 3),
            ([0.06, 5.0, 10.0], [0.0, 2.5, 0.0], 0),
            ([5.0, 0.06, 10.0], [2.5, 0.0, 0.0], 0),
        ];
        for (size, at, material) in walls {
            let wall = Cuboid::from_size(size.into()).mesh().build();
            add(
                &mut model,
                wall,
                material,
                Transform::from_translation(at.into()),
            );
        }
        for i in 0..count {
            let at = |i: usize| (i as f32 - 3.5) * 1.1;
            let place = Vec3::new(at(i % side), at(i / side % side), at(i / side / side));
            let (mesh, material): (Mesh, usize) = if i % 3 == 0 {
                (
                    Torus::new(0.2, 0.45)
                        .mesh()
                        .major_resolution(fine as usize)
                        .minor_resolution(fine as usize)
                        .build(),
                    1,
                )
            } else {
                (Sphere::new(0.5).mesh().uv(fine, fine), 2)
            };
            add(
                &mut model,
                mesh,
                material,
                Transform::from_translation(place),
            );
        }
        model
    }

    /// Lowest and highest corner.
    pub fn bounds(&self) -> [Vec3; 2] {
        let mut places: Vec<Mat4> = Vec::new();
        let mut bounds = [Vec3::INFINITY, Vec3::NEG_INFINITY];
        for node in &self.nodes {
            let above = node.above.and_then(|above| places.get(above).copied());
            let place = above.unwrap_or(Mat4::IDENTITY) * node.place.to_matrix();
            places.push(place);
            let mesh = node.drawn.and_then(|(mesh, _)| self.meshes.get(mesh));
            for at in mesh.into_iter().flat_map(positions) {
                let at = place.transform_point3(Vec3::from(*at));
                bounds = [bounds[0].min(at), bounds[1].max(at)];
            }
        }
        bounds
    }

    /// How many triangles its nodes draw.
    pub fn triangles(&self) -> usize {
        let of = |mesh: &Mesh| mesh.indices().map_or(mesh.count_vertices(), Indices::len) / 3;
        self.nodes
            .iter()
            .filter_map(|node| node.drawn)
            .map(|(mesh, _)| of(&self.meshes[mesh]))
            .sum()
    }

    /// Spawns it below a root. Returns that, and the entities with meshes.
    pub fn spawn(self, world: &mut World) -> (Entity, Vec<Entity>) {
        let mut meshes = world.resource_mut::<Assets<Mesh>>();
        let meshes: Vec<_> = self
            .meshes
            .into_iter()
            .map(|mesh| meshes.add(mesh))
            .collect();
        let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
        let materials: Vec<_> = self
            .materials
            .into_iter()
            .map(|paint| materials.add(paint))
            .collect();
        let root = world
            .spawn((
                Transform::IDENTITY,
                Visibility::default(),
                Name::new(self.name),
            ))
            .id();
        let (mut entities, mut drawn) = (Vec::new(), Vec::new());
        for node in self.nodes {
            let above = node
                .above
                .and_then(|above| entities.get(above).copied())
                .unwrap_or(root);
            let mut entity = world.spawn((node.place, Visibility::default(), ChildOf(above)));
            if let Some((mesh, material)) = node.drawn {
                entity.insert((
                    Mesh3d(meshes[mesh].clone()),
                    MeshMaterial3d(materials[material].clone()),
                ));
                drawn.push(entity.id());
            }
            entities.push(entity.id());
        }
        (root, drawn)
    }
}

fn paint(material: &gltf::Material, is_mirrored: bool) -> StandardMaterial {
    let pbr = material.pbr_metallic_roughness();
    let [r, g, b, a] = pbr.base_color_factor();
    StandardMaterial {
        base_color: Color::linear_rgba(r, g, b, a),
        // Without surroundings to mirror, metal would be black.
        metallic: 0.3 * pbr.metallic_factor(),
        perceptual_roughness: pbr.roughness_factor().max(0.4),
        alpha_mode: match material.alpha_mode() {
            gltf::material::AlphaMode::Opaque => AlphaMode::Opaque,
            gltf::material::AlphaMode::Mask => {
                AlphaMode::Mask(material.alpha_cutoff().unwrap_or(0.5))
            }
            gltf::material::AlphaMode::Blend => AlphaMode::Blend,
        },
        double_sided: material.double_sided(),
        cull_mode: match (material.double_sided(), is_mirrored) {
            (true, _) => None,
            (false, true) => Some(Face::Front),
            (false, false) => Some(Face::Back),
        },
        ..default()
    }
}

/// `None`: it points outside the file's data.
fn triangles(part: &gltf::Primitive, blob: &[u8]) -> Option<Mesh> {
    let semantics = [gltf::Semantic::Positions, gltf::Semantic::Normals];
    let accessors = semantics
        .iter()
        .filter_map(|semantic| part.get(semantic))
        .chain(part.indices());
    for accessor in accessors {
        // The reader would panic.
        let view = accessor.view()?;
        let stride = view.stride().unwrap_or(accessor.size());
        let last = accessor.count().checked_sub(1)?.checked_mul(stride)?;
        let end = last
            .checked_add(accessor.offset())?
            .checked_add(accessor.size())?;
        let is_inside =
            end <= view.length() && view.offset().checked_add(view.length())? <= blob.len();
        is_inside.then_some(())?;
    }
    let reader = part.reader(|buffer| (buffer.index() == 0).then_some(blob));
    let positions: Vec<[f32; 3]> = reader.read_positions()?.collect();
    let vertices = positions.len() as u32;
    let mut mesh = Mesh::new(
        PrimitiveTopology::TriangleList,
        RenderAssetUsages::default(),
    )
    .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions);
    if let Some(indices) = reader.read_indices() {
        let indices: Vec<u32> = indices.into_u32().collect();
        if indices.iter().any(|index| *index >= vertices) {
            return None;
        }
        mesh.insert_indices(Indices::U32(indices));
    }
    match reader.read_normals() {
        Some(normals) => mesh.insert_attribute(Mesh::ATTRIBUTE_NORMAL, normals.collect::<Vec<_>>()),
        // As glTF asks for.
        None => {
            if mesh.indices().is_some() {
                mesh.duplicate_vertices();
            }
            mesh.compute_flat_normals();
        }
    }
    Some(mesh)
}
