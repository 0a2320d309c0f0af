//! What the render world takes from the main world: terrains that cast shadows, and the lights they cast them from.

use core::ops::Range;

use bevy::{asset::AssetId, light::SunDisk, math::DAffine3, prelude::*, render::Extract};

use super::TerrainShadows;
use crate::{
    precision::affine64,
    terrain::{HeightField, Terrain},
    terrain_shadow::{
        ExactLight, MOST_STRIPS, ShadowMethod, ShadowedLights, TerrainShadow, light::GridLight,
    },
};

/// One terrain that casts shadows.
pub struct ExtractedShadow {
    pub terrain: Entity,
    pub field: AssetId<HeightField>,
    pub size: UVec2,
    /// Lowest and highest sample. units: grid
    pub heights: (f64, f64),
    pub method: ShadowMethod,
    pub strips: u32,
    pub slice_ms: f32,
    pub world_from_grid: DAffine3,
    /// Its lights, among [`ExtractedShadows::lights`].
    pub lights: Range<usize>,
}

/// One light as a terrain sees it.
pub struct ExtractedShadowLight {
    pub entity: Entity,
    pub light: GridLight,
    /// As Bevy's shaders name it: the direction to it (w = 0) or its position (w = 1).
    pub place: Vec4,
    /// As Bevy's shaders have it; tells lights at one place apart. 0 for directional lights. units: m
    pub range: f32,
}

/// Everything extracted; the lists are refilled in place every frame.
#[derive(Resource, Default)]
pub struct ExtractedShadows {
    pub terrains: Vec<ExtractedShadow>,
    pub lights: Vec<ExtractedShadowLight>,
}

/// What is read of a terrain that casts shadows.
type ShadowData = (
    Entity,
    &'static Terrain,
    &'static TerrainShadow,
    &'static GlobalTransform,
    &'static InheritedVisibility,
);

/// What is read of a light of any kind.
type LightData<L> = (
    Entity,
    &'static L,
    &'static GlobalTransform,
    &'static InheritedVisibility,
    Option<&'static ExactLight>,
);

/// Fills [`ExtractedShadows`], and notes which heights have changed.
pub fn extract_shadows(
    mut extracted: ResMut<ExtractedShadows>,
    mut shadows: ResMut<TerrainShadows>,
    fields: Extract<Res<Assets<HeightField>>>,
    terrains: Extract<Query<ShadowData>>,
    suns: Extract<Query<(LightData<DirectionalLight>, Option<&SunDisk>)>>,
    points: Extract<Query<LightData<PointLight>>>,
    spots: Extract<Query<LightData<SpotLight>>>,
) {
    let ExtractedShadows {
        terrains: out,
        lights,
    } = &mut *extracted;
    out.clear();
    lights.clear();
    if terrains.is_empty() {
        shadows.retain(|_| false);
        return;
    }
    shadows.retain(|entity| terrains.contains(entity));
    for (entity, terrain, shadow, transform, visible) in &terrains {
        let id = terrain.height_field.id();
        let Some(field) = fields.get(id) else {
            continue;
        };
        shadows.note_heights(entity, id, field);
        if !visible.get() {
            continue;
        }
        let world_from_grid = affine64(transform.affine()) * field.local_from_grid();
        let first = lights.len();
        let casts = |shadow_maps: bool| shadow_maps || shadow.lights == ShadowedLights::All;
        for ((entity, light, transform, visible, exact), disk) in &suns {
            if !visible.get() || !casts(light.shadow_maps_enabled) {
                continue;
            }
            let to_light = Vec3::from(transform.back());
            let angular_radius = disk.map_or(0.0, |disk| f64::from(disk.angular_size) / 2.0);
            let exact = match exact {
                Some(ExactLight::Direction(direction)) => *direction,
                _ => to_light.as_dvec3(),
            };
            lights.push(ExtractedShadowLight {
                entity,
                light: GridLight::directional(exact, angular_radius, world_from_grid),
                place: to_light.extend(0.0),
                range: 0.0,
            });
        }
        let mut push = |entity, exact: Option<&ExactLight>, at: Vec3, radius: f32, range: f32| {
            let position = match exact {
                Some(ExactLight::Position(position)) => *position,
                _ => at.as_dvec3(),
            };
            lights.push(ExtractedShadowLight {
                entity,
                light: GridLight::point(
                    position,
                    f64::from(radius),
                    f64::from(range),
                    world_from_grid,
                ),
                place: at.extend(1.0),
                range,
            });
        };
        for (entity, light, transform, visible, exact) in &points {
            if visible.get() && casts(light.shadow_maps_enabled) {
                let at = transform.translation();
                push(entity, exact, at, light.radius, light.range);
            }
        }
        for (entity, light, transform, visible, exact) in &spots {
            if visible.get() && casts(light.shadow_maps_enabled) {
                let at = transform.translation();
                push(entity, exact, at, light.radius, light.range);
            }
        }
        let (highest, lowest) = field.pyramid().top();
        out.push(ExtractedShadow {
            terrain: entity,
            field: id,
            size: field.size(),
            heights: (lowest, highest),
            method: shadow.method,
            strips: shadow.penumbra_strips.min(MOST_STRIPS),
            slice_ms: shadow.slice_ms,
            world_from_grid,
            lights: first..lights.len(),
        });
    }
}
