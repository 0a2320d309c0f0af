//! Which cascades want terrain, and what of theirs is out of date.

use core::any::TypeId;

use bevy::{
    camera::visibility::RenderLayers,
    light::ShadowFilteringMethod,
    mesh::Mesh3d,
    pbr::{ExtractedDirectionalLight, LightEntity, ShadowView, ViewLightEntities},
    platform::time::Instant,
    prelude::*,
    render::{
        render_resource::*,
        renderer::{RenderDevice, RenderQueue},
        view::{ExtractedView, RenderVisibleEntities},
    },
};

use super::{
    CascadeCaster, CasterKey, TerrainCascade, TerrainCascades,
    light_square::{CascadeSquare, LightRange, LightSquare, reach},
};
use crate::{
    render_graph::{
        extract::{ExtractedTerrain, ExtractedTerrains},
        height_mips::{GpuHeightField, GpuHeightFields},
        pipelines::TerrainPipelines,
        stats::TerrainStats,
        view::{MAX_TERRAINS, SlotInputs},
    },
    terrain::{
        TerrainRayCasting, Traversal,
        view_rays::{ViewInputs, ViewRays},
    },
};

/// How lights cast: exactly, as the derivation wants it, and with beams, because their rays lie so close together
/// that each has little left to do by itself. There are no boxes: every cascade would keep a list of them for the
/// few frames in which it casts.
const LIGHT_RAYS: TerrainRayCasting = TerrainRayCasting {
    traversal: Traversal::Hybrid,
    box_texels: 64,
    max_error_px: 0.0,
};

/// Finds out which cascades terrain is drawn into, composes the rays of those that must be cast anew, and frees
/// what belongs to cascades that are gone.
///
/// A camera that sees no mesh needs no terrain in its cascades: nothing is done for it.
#[expect(clippy::too_many_arguments, reason = "a system asks for what it needs")]
pub fn prepare_terrain_cascades(
    mut cascades: ResMut<TerrainCascades>,
    mut pipelines: ResMut<TerrainPipelines>,
    cache: Res<PipelineCache>,
    extracted: Res<ExtractedTerrains>,
    fields: Res<GpuHeightFields>,
    stats: Res<TerrainStats>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    cameras: Query<(
        &ExtractedView,
        &ViewLightEntities,
        Option<&RenderVisibleEntities>,
        Option<&ShadowFilteringMethod>,
    )>,
    views: Query<(&ExtractedView, &LightEntity, &RenderLayers), With<ShadowView>>,
    lights: Query<&ExtractedDirectionalLight>,
) {
    let terrains = &extracted.terrains;
    if !terrains.iter().any(|terrain| terrain.on_meshes) {
        if !cascades.cascades.is_empty() {
            *cascades = default();
            stats.lock().cascade_bytes = 0;
        }
        return;
    }
    let start = Instant::now();
    let cascades = &mut *cascades;
    for cascade in cascades.cascades.values_mut() {
        cascade.seen = false;
        cascade.drawn = false;
    }
    for (camera, camera_lights, visible, filter) in &cameras {
        let receives = visible.is_some_and(shows_meshes);
        for (view, light, layers) in camera_lights
            .lights
            .iter()
            .filter_map(|e| views.get(*e).ok())
        {
            let LightEntity::Directional {
                light_entity,
                cascade_index,
            } = *light
            else {
                continue;
            };
            let casts = |terrain: &&ExtractedTerrain| {
                terrain.on_meshes && terrain.layers.intersects(layers)
            };
            if !terrains.iter().any(|terrain| casts(&terrain)) {
                continue;
            }
            let (Ok(light), Some(square)) = (lights.get(light_entity), CascadeSquare::new(view))
            else {
                continue;
            };
            let cascade = cascades
                .cascades
                .entry(view.retained_view_entity)
                .or_default();
            cascade.seen = true;
            if !receives {
                continue;
            }
            let far_m = light
                .cascade_shadow_config
                .bounds
                .get(cascade_index)
                .copied()
                .unwrap_or_default();
            let receiver_m = receiver_error_m(camera, &extracted, far_m);
            let reach = reach(
                filter.copied().unwrap_or_default(),
                light.soft_shadow_size,
                square.texel_m(),
                receiver_m,
            );
            cascade.prepare(
                &CascadeInputs {
                    square: &square,
                    reach,
                    receiver_m,
                    fields: &fields,
                    device: &device,
                    queue: &queue,
                },
                terrains.iter().filter(casts),
                &mut cascades.generation,
            );
        }
    }
    cascades.cascades.retain(|_, cascade| cascade.seen);
    if cascades.cascades.is_empty() {
        *cascades = default();
    }
    cascades.bind(&mut pipelines, &cache, &fields, &device);
    let mut counts = stats.lock();
    counts.cascade_bytes = cascades.bytes();
    counts.pipelines = pipelines.count() as u64;
    counts.cpu_ms += start.elapsed().as_secs_f32() * 1e3;
}

/// Whether a camera has any ordinary mesh in view.
fn shows_meshes(visible: &RenderVisibleEntities) -> bool {
    visible
        .classes
        .get(&TypeId::of::<Mesh3d>())
        .is_some_and(|class| {
            !class.entities_cpu_culling.is_empty() || !class.entities_gpu_culling.is_empty()
        })
}

/// How far off its exact height a camera may draw terrain that is `far_m` away. units: m
fn receiver_error_m(camera: &ExtractedView, extracted: &ExtractedTerrains, far_m: f32) -> f64 {
    let entity = camera.retained_view_entity.main_entity.id();
    let error_px = extracted
        .cameras
        .iter()
        .find(|camera| camera.entity == entity)
        .map_or(0.0, |camera| camera.settings.max_error_px.max(0.0));
    let projection = camera.clip_from_view;
    let depth = if projection.w_axis.w == 1.0 {
        1.0
    } else {
        far_m
    };
    let pixel_m = 2.0 * depth / (projection.y_axis.y.abs() * camera.viewport.w.max(1) as f32);
    let error_m = f64::from(error_px * pixel_m);
    if error_m.is_finite() { error_m } else { 0.0 }
}

struct CascadeInputs<'a> {
    square: &'a CascadeSquare,
    reach: u32,
    receiver_m: f64,
    fields: &'a GpuHeightFields,
    device: &'a RenderDevice,
    queue: &'a RenderQueue,
}

impl TerrainCascade {
    fn prepare<'a>(
        &mut self,
        inputs: &CascadeInputs,
        terrains: impl Iterator<Item = &'a ExtractedTerrain> + Clone,
        generation: &mut u64,
    ) {
        let CascadeInputs {
            square: cascade,
            fields,
            device,
            queue,
            ..
        } = *inputs;
        // A field that cannot be walked yet, or at all, casts nothing.
        let terrains = terrains.filter_map(|terrain| {
            let field = fields.get(terrain.field).filter(|field| field.ready)?;
            Some((terrain, field))
        });
        let mut range = LightRange::empty();
        for (terrain, _) in terrains.clone() {
            range.add(terrain, cascade);
        }
        let Some(wanted) = LightSquare::new(cascade, &range, inputs.reach, inputs.receiver_m)
        else {
            return;
        };
        let square = match self.square {
            Some(square) if square.serves(cascade, &wanted) && self.has_cast(terrains.clone()) => {
                square
            }
            _ => {
                self.compose(&wanted, terrains, device, queue, generation);
                wanted
            }
        };
        self.drawn = self.casters.iter().any(|caster| caster.in_view);
        let write = square.write(cascade);
        if self.write.buffer().is_none() || *self.write.get() != write {
            self.write.set_label(Some("skyline_cascade_write"));
            self.write.set(write);
            self.write.write_buffer(device, queue);
        }
    }

    /// Whether these terrains, as they are now, are what was cast.
    fn has_cast<'a>(
        &self,
        terrains: impl Iterator<Item = (&'a ExtractedTerrain, &'a GpuHeightField)>,
    ) -> bool {
        terrains
            .map(|(terrain, field)| Some(CasterKey::new(terrain, field)))
            .eq(self.casters.iter().map(|caster| caster.key))
    }

    /// Composes the rays of every terrain anew.
    fn compose<'a>(
        &mut self,
        square: &LightSquare,
        terrains: impl Iterator<Item = (&'a ExtractedTerrain, &'a GpuHeightField)>,
        device: &RenderDevice,
        queue: &RenderQueue,
        generation: &mut u64,
    ) {
        let clip_from_view = square.clip_from_view();
        let world_from_view = square.world_from_view();
        let mut count = 0;
        let mut id = 0;
        for (terrain, field) in terrains {
            if self.casters.len() == count {
                self.casters.push(CascadeCaster::default());
            }
            let caster = &mut self.casters[count];
            count += 1;
            caster.key = Some(CasterKey::new(terrain, field));
            let rays = ViewRays::new(&ViewInputs {
                clip_from_view,
                grid_from_view: terrain.grid_from_local
                    * terrain.world_from_local.inverse()
                    * world_from_view,
                size_px: UVec2::splat(square.side),
                cells: terrain.cells,
                height_range: terrain.height_range,
                whole_heights: terrain.whole_heights,
                max_error_px: LIGHT_RAYS.max_error_px,
            })
            .filter(ViewRays::sees_terrain);
            let rays = rays.filter(|_| id < MAX_TERRAINS as u32);
            caster.in_view = rays.is_some();
            let Some(rays) = rays else { continue };
            id += 1;
            caster.slot.prepare(
                &SlotInputs {
                    terrain,
                    field,
                    rays: &rays,
                    room_px: rays.size_px,
                    settings: &LIGHT_RAYS,
                    // They start before the whole terrain.
                    in_air: true,
                    boxes: false,
                    id,
                    viewport_px: Vec2::ZERO,
                    clip_from_world: clip_from_view.as_dmat4()
                        * bevy::math::DMat4::from(world_from_view.inverse()),
                },
                device,
                queue,
                generation,
            );
        }
        self.casters.truncate(count);
        if self.square.is_none_or(|old| old.side != square.side) {
            self.depth = None;
        }
        self.square = Some(*square);
        self.erosion.set_label(Some("skyline_cascade_erosion"));
        self.erosion.set(square.erosion);
        self.erosion.write_buffer(device, queue);
        self.due = self.casters.iter().any(|caster| caster.in_view);
    }
}

impl CasterKey {
    fn new(terrain: &ExtractedTerrain, field: &GpuHeightField) -> Self {
        Self {
            entity: terrain.entity,
            field: terrain.field,
            generation: field.generation,
            revision: field.revision,
            world_from_local: terrain.world_from_local,
        }
    }
}
