//! What the render world takes from the main world: terrains, the cameras that see them, and changed heights.

use bevy::{
    asset::AssetId,
    camera::visibility::RenderLayers,
    math::{DAffine3, DMat4},
    platform::collections::{HashMap, HashSet},
    prelude::*,
    render::Extract,
};

use super::height_mips::GpuHeightFields;
use crate::{
    precision::affine64,
    terrain::{
        HeightField, HeightSamples, Terrain, TerrainLook, TerrainRayCasting,
        view_rays::{near_plane_bounds, starts_in_air},
    },
    terrain_shadow::TerrainShadow,
};

/// One terrain of this frame.
pub struct ExtractedTerrain {
    pub entity: Entity,
    pub field: AssetId<HeightField>,
    pub grid_from_local: DAffine3,
    pub world_from_local: DAffine3,
    /// Lowest and highest sample. units: grid
    pub height_range: (f64, f64),
    pub whole_heights: bool,
    pub cells: UVec2,
    pub layers: RenderLayers,
    pub look: TerrainLook,
    /// It is drawn into Bevy's cascades.
    pub on_meshes: bool,
}

/// One camera that draws terrain.
pub struct ExtractedTerrainCamera {
    pub entity: Entity,
    pub settings: TerrainRayCasting,
    pub layers: RenderLayers,
}

/// Everything extracted; the lists are refilled in place every frame.
#[derive(Resource, Default)]
pub struct ExtractedTerrains {
    pub terrains: Vec<ExtractedTerrain>,
    pub cameras: Vec<ExtractedTerrainCamera>,
    /// Whether every ray of a camera (first) starts in a terrain's (second) air.
    pub in_air: HashMap<(Entity, Entity), bool>,
    /// Fields that any terrain shows, hidden ones too.
    shown: HashSet<AssetId<HeightField>>,
}

/// What is read of a terrain in the main world.
type TerrainData = (
    Entity,
    &'static Terrain,
    &'static GlobalTransform,
    &'static InheritedVisibility,
    Option<&'static RenderLayers>,
    Option<&'static TerrainShadow>,
);

/// What is read of a camera in the main world.
type CameraData = (
    Entity,
    &'static Camera,
    &'static GlobalTransform,
    Option<&'static TerrainRayCasting>,
    Option<&'static RenderLayers>,
);

/// Fills [`ExtractedTerrains`] and uploads what has changed in the height fields they show.
pub fn extract_terrains(
    mut extracted: ResMut<ExtractedTerrains>,
    mut gpu_fields: ResMut<GpuHeightFields>,
    fields: Extract<Res<Assets<HeightField>>>,
    terrains: Extract<Query<TerrainData>>,
    cameras: Extract<Query<CameraData, With<Camera3d>>>,
) {
    let extracted = &mut *extracted;
    extracted.terrains.clear();
    extracted.cameras.clear();
    extracted.in_air.clear();
    extracted.shown.clear();
    if terrains.is_empty() {
        gpu_fields.retain(|_| false);
        return;
    }
    for (entity, terrain, transform, visible, layers, shadow) in &terrains {
        let id = terrain.height_field.id();
        extracted.shown.insert(id);
        let Some(field) = fields.get(id) else {
            continue;
        };
        gpu_fields.upload(id, field);
        if !visible.get() {
            continue;
        }
        let (highest, lowest) = field.pyramid().top();
        extracted.terrains.push(ExtractedTerrain {
            entity,
            field: id,
            grid_from_local: field.grid_from_local(),
            world_from_local: affine64(transform.affine()),
            height_range: (lowest, highest),
            whole_heights: matches!(field.samples(), HeightSamples::U16(_)),
            cells: field.cells(),
            layers: layers.cloned().unwrap_or_default(),
            look: terrain.look.clone(),
            on_meshes: shadow.is_some_and(|shadow| shadow.on_meshes),
        });
    }
    gpu_fields.retain(|id| extracted.shown.contains(&id));
    for (entity, camera, transform, settings, layers) in &cameras {
        if !camera.is_active {
            continue;
        }
        extracted.cameras.push(ExtractedTerrainCamera {
            entity,
            settings: settings.copied().unwrap_or_default(),
            layers: layers.cloned().unwrap_or_default(),
        });
        let world_from_view = affine64(transform.affine());
        let layers = layers.cloned().unwrap_or_default();
        for terrain in &extracted.terrains {
            let Some(field) = fields.get(terrain.field) else {
                continue;
            };
            if !terrain.layers.intersects(&layers) {
                continue;
            }
            let grid_from_view =
                terrain.grid_from_local * terrain.world_from_local.inverse() * world_from_view;
            let in_air = near_plane_bounds(camera.clip_from_view(), grid_from_view)
                .is_some_and(|bounds| starts_in_air(field, bounds));
            extracted.in_air.insert((entity, terrain.entity), in_air);
        }
    }
}

/// Clip space of the world in double precision, from a view's projection and placement.
pub fn clip_from_world(clip_from_view: Mat4, world_from_view: &GlobalTransform) -> DMat4 {
    clip_from_view.as_dmat4() * DMat4::from(affine64(world_from_view.affine()).inverse())
}
