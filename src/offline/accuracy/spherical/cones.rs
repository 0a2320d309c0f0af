//! Meshlets with normal cones, to compare with: meshoptimizer's, culled by its own test for each camera.

use core::any::TypeId;

use bevy::{
    camera::visibility::VisibleEntities, light::NotShadowCaster, mesh::VertexAttributeValues,
    prelude::*,
};
use meshopt::{VertexDataAdapter, build_meshlets, compute_meshlet_bounds};

use crate::{
    culling::CullSteps,
    systems::submesh::{Making, Renumbering},
};

/// As the library's documentation has them.
const MOST_VERTICES: usize = 64;
const MOST_TRIANGLES: usize = 124;

/// On a meshlet's entity.
#[derive(Component)]
struct Meshlet {
    centre: Vec3,
    radius: f32,
    axis: Vec3,
    cutoff: f32,
    triangles: u32,
}

/// The mesh that meshlets are drawn in place of, and what the last frame drew.
#[derive(Resource)]
pub struct Meshlets {
    model: Entity,
    triangles: u64,
    objects: u64,
}

pub fn register(app: &mut App) {
    app.add_systems(
        PostUpdate,
        cull_cones
            .run_if(resource_exists::<Meshlets>)
            .in_set(CullSteps::Selection),
    );
}

impl Meshlets {
    /// In the place of a model at the origin.
    pub fn spawn(world: &mut World, model: Entity, mesh: &Handle<Mesh>) {
        let mut made = Vec::new();
        world.resource_scope(|_, mut meshes: Mut<Assets<Mesh>>| {
            let Some(source) = meshes.get(mesh).cloned() else {
                return;
            };
            let Some(VertexAttributeValues::Float32x3(positions)) =
                source.attribute(Mesh::ATTRIBUTE_POSITION)
            else {
                return;
            };
            let indices: Vec<u32> = source
                .indices()
                .into_iter()
                .flat_map(|indices| indices.iter())
                .map(|index| index as u32)
                .collect();
            let bytes: &[u8] = bytemuck::cast_slice(positions);
            let Ok(vertices) = VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0) else {
                return;
            };
            let meshlets = build_meshlets(&indices, &vertices, MOST_VERTICES, MOST_TRIANGLES, 0.5);
            let mut numbers = Renumbering::new(positions.len());
            for meshlet in meshlets.iter() {
                let bounds = compute_meshlet_bounds(meshlet, &vertices);
                let corner = |i: &u8| meshlet.vertices[usize::from(*i)];
                let triangles = meshlet
                    .triangles
                    .chunks_exact(3)
                    .map(|of| [corner(&of[0]), corner(&of[1]), corner(&of[2])]);
                let sub = numbers.sub_mesh(positions, triangles, Some(true));
                let Some(mut making) = Making::begin(sub, &source) else {
                    continue;
                };
                while !making.copy(&source) {}
                made.push((
                    meshes.add(making.finish(&source)),
                    Meshlet {
                        centre: bounds.center.into(),
                        radius: bounds.radius,
                        axis: bounds.cone_axis.into(),
                        cutoff: bounds.cone_cutoff,
                        triangles: (meshlet.triangles.len() / 3) as u32,
                    },
                ));
            }
        });
        let paint = world
            .get::<MeshMaterial3d<StandardMaterial>>(model)
            .cloned();
        for (mesh, meshlet) in made {
            let mut entity = world.spawn((Mesh3d(mesh), meshlet, NotShadowCaster));
            if let Some(paint) = paint.clone() {
                entity.insert(paint);
            }
        }
        world.insert_resource(Self {
            model,
            triangles: 0,
            objects: 0,
        });
    }

    pub fn remove(world: &mut World) {
        world.remove_resource::<Self>();
        let mut all = world.query_filtered::<Entity, With<Meshlet>>();
        let all: Vec<Entity> = all.iter(world).collect();
        for meshlet in all {
            world.despawn(meshlet);
        }
    }

    /// Triangles and objects, over all cameras.
    pub fn drawn(world: &World) -> (u64, u64) {
        world
            .get_resource::<Self>()
            .map_or((0, 0), |of| (of.triangles, of.objects))
    }
}

/// Takes from each perspective camera the meshlets that show it their back, and the mesh that they stand for.
fn cull_cones(
    mut drawn: ResMut<Meshlets>,
    mut cameras: Query<(&Camera, &GlobalTransform, &mut VisibleEntities)>,
    meshlets: Query<&Meshlet>,
) {
    (drawn.triangles, drawn.objects) = (0, 0);
    for (camera, place, visible) in &mut cameras {
        if !camera.is_active {
            continue;
        }
        let eye = place.translation();
        let list = visible.into_inner().get_mut(TypeId::of::<Mesh3d>());
        list.retain(|entity| {
            if *entity == drawn.model {
                return false;
            }
            let Ok(meshlet) = meshlets.get(*entity) else {
                return true;
            };
            let way = meshlet.centre - eye;
            if way.dot(meshlet.axis) >= meshlet.cutoff * way.length() + meshlet.radius {
                return false;
            }
            drawn.triangles += u64::from(meshlet.triangles);
            drawn.objects += 1;
            true
        });
    }
}
