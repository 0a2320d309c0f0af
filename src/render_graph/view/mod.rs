//! What each camera needs for the terrains it sees: the numbers the shaders read (`gpu`), the textures and
//! buffers of its passes (here and `slot`), and their bind groups (`bind`).
//!
//! All of it is kept from frame to frame and only made anew when a size, a field or a setting changes; a
//! standing scene writes its uniforms and allocates nothing.

mod bind;
mod gpu;
mod slot;

use bevy::{
    camera::{MainPassResolutionOverride, Viewport},
    platform::{collections::HashMap, time::Instant},
    prelude::*,
    render::{
        camera::{ExtractedCamera, TemporalJitter},
        render_resource::*,
        renderer::{RenderDevice, RenderQueue},
        view::ExtractedView,
    },
};

use super::{
    extract::{ExtractedTerrains, clip_from_world},
    height_mips::GpuHeightFields,
    pipelines::{BOX_DEPTH_FORMAT, BOX_ENTRY_FORMAT},
    stats::TerrainStats,
};
use crate::{
    precision::affine64,
    terrain::{
        Traversal,
        view_rays::{ViewInputs, ViewRays},
    },
};

pub(super) use bind::Unused;
pub use bind::{SlotBindGroups, prepare_terrain_bind_groups};
pub use gpu::{GpuPlacement, GpuTerrainLook, GpuTerrainView};
pub(super) use slot::SlotInputs;
pub use slot::{BoxLists, SlotPipelines, TerrainSlot, TileStarts};

/// Terrains one camera can draw: `hit_surface` names them in eight bits.
pub const MAX_TERRAINS: usize = 255;
/// Side of a workgroup of `ray_cast.wgsl`. units: px
pub const WORKGROUP_PX: u32 = 8;
/// Sides of the tiles that one beam stands for, coarse and fine, as in `beam.wgsl`. Boxes are drawn at the
/// coarse tiles. units: px
pub const BEAM_PX: [u32; 2] = [16, 4];

/// What a camera holds for terrain.
#[derive(Default)]
pub struct ViewTerrain {
    pub targets: Option<HitTargets>,
    pub boxes: Option<BoxTargets>,
    pub slots: HashMap<Entity, TerrainSlot>,
    /// Terrains to draw this frame, in the order of their ids.
    pub drawn: Vec<Entity>,
    pub viewport: Option<Viewport>,
    seen: bool,
}

/// Where rays write what they hit.
pub struct HitTargets {
    /// Pixels cast this frame, from the upper left corner.
    pub size: UVec2,
    /// Size of the textures: of the whole viewport, so that a [`ResolutionScale`](crate::resolution::ResolutionScale)
    /// may change every frame.
    room: UVec2,
    pub depth: Texture,
    pub depth_view: TextureView,
    pub surface: Texture,
    pub surface_view: TextureView,
    generation: u64,
}

/// Where boxes are drawn: one texel a pixel, or one a tile.
pub struct BoxTargets {
    /// Size of the textures.
    pub room: UVec2,
    pub entry_view: TextureView,
    pub depth_view: TextureView,
    generation: u64,
}

/// Every camera's terrain state.
#[derive(Resource, Default)]
pub struct TerrainViews {
    pub views: HashMap<Entity, ViewTerrain>,
    /// Stand-ins for what a traversal doesn't use.
    unused: Option<Unused>,
    generation: u64,
}

impl TerrainViews {
    /// Bytes of all textures and buffers.
    fn bytes(&self) -> u64 {
        let pixels = |size: UVec2| u64::from(size.x) * u64::from(size.y);
        self.views
            .values()
            .map(|view| {
                let targets = view.targets.as_ref().map_or(0, |t| 8 * pixels(t.room));
                let boxes = view.boxes.as_ref().map_or(0, |b| 8 * pixels(b.room));
                targets + boxes + view.slots.values().map(TerrainSlot::bytes).sum::<u64>()
            })
            .sum::<u64>()
            + self.unused.as_ref().map_or(0, Unused::bytes)
    }
}

/// Composes every camera's rays and makes sure of its textures and buffers.
pub fn prepare_terrain_views(
    mut terrain_views: ResMut<TerrainViews>,
    extracted: Res<ExtractedTerrains>,
    fields: Res<GpuHeightFields>,
    stats: Res<TerrainStats>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    cameras: Query<(
        &ExtractedView,
        &ExtractedCamera,
        Option<&TemporalJitter>,
        Option<&MainPassResolutionOverride>,
    )>,
) {
    let start = Instant::now();
    let terrain_views = &mut *terrain_views;
    for view in terrain_views.views.values_mut() {
        view.seen = false;
        view.drawn.clear();
    }
    let mut drawn = 0;
    let mut boxes = (0, 0);
    for (extracted_view, camera, jitter, resolution) in &cameras {
        let main_entity = extracted_view.retained_view_entity.main_entity.id();
        let Some(terrain_camera) = extracted.cameras.iter().find(|c| c.entity == main_entity)
        else {
            continue;
        };
        if extracted.terrains.is_empty() {
            continue;
        }
        let Some(full_size) = camera.physical_viewport_size else {
            continue;
        };
        let size_px = resolution.map_or(full_size, |size| size.0);
        let room_px = full_size.max(size_px);
        let mut clip_from_view = extracted_view.clip_from_view;
        let unjittered = clip_from_view;
        if let Some(jitter) = jitter {
            jitter.jitter_projection(&mut clip_from_view, size_px.as_vec2());
        }
        let world_from_view = affine64(extracted_view.world_from_view.affine());
        let clip_from_world = clip_from_world(unjittered, &extracted_view.world_from_view);

        let mut view = terrain_views.views.remove(&main_entity).unwrap_or_default();
        view.seen = true;
        view.viewport = Viewport::from_viewport_and_override(camera.viewport.as_ref(), resolution);
        let viewport_px = view
            .viewport
            .as_ref()
            .map_or(Vec2::ZERO, |v| v.physical_position.as_vec2());
        for slot in view.slots.values_mut() {
            slot.seen = false;
        }
        for terrain in &extracted.terrains {
            if !terrain.layers.intersects(&terrain_camera.layers) {
                continue;
            }
            let Some(field) = fields.get(terrain.field) else {
                continue;
            };
            // In view or not, the slot stays: only a terrain that is gone frees it.
            let slot = view.slots.entry(terrain.entity).or_default();
            slot.seen = true;
            if !field.ready {
                continue;
            }
            let rays = ViewRays::new(&ViewInputs {
                clip_from_view,
                grid_from_view: terrain.grid_from_local
                    * terrain.world_from_local.inverse()
                    * world_from_view,
                size_px,
                cells: terrain.cells,
                height_range: terrain.height_range,
                whole_heights: terrain.whole_heights,
                max_error_px: terrain_camera.settings.max_error_px,
            });
            let rays = rays.filter(ViewRays::sees_terrain);
            let is_room = view.drawn.len() < MAX_TERRAINS;
            if rays.is_some() && !is_room {
                warn_once!("more than {MAX_TERRAINS} terrains are in view; the rest is not drawn");
            }
            let Some(rays) = rays.filter(|_| is_room) else {
                slot.pass_over(clip_from_world, terrain.world_from_local);
                continue;
            };
            let in_air = extracted
                .in_air
                .get(&(main_entity, terrain.entity))
                .copied()
                .unwrap_or(false);
            slot.field = Some(terrain.field);
            slot.prepare(
                &SlotInputs {
                    terrain,
                    field,
                    rays: &rays,
                    room_px,
                    settings: &terrain_camera.settings,
                    in_air,
                    boxes: true,
                    id: view.drawn.len() as u32 + 1,
                    viewport_px,
                    clip_from_world,
                },
                &device,
                &queue,
                &mut terrain_views.generation,
            );
            if let Some(lists) = &slot.lists {
                boxes = (lists.readback.latest(), u64::from(lists.capacity));
            }
            view.drawn.push(terrain.entity);
            drawn += 1;
        }
        view.slots.retain(|_, slot| slot.seen);
        if !view.drawn.is_empty() {
            view.prepare_targets(size_px, room_px, &device, &mut terrain_views.generation);
        }
        terrain_views.views.insert(main_entity, view);
    }
    terrain_views
        .views
        .retain(|_, view| view.seen && !view.slots.is_empty());
    if terrain_views.views.is_empty() {
        terrain_views.unused = None;
    }
    let mut counts = stats.lock();
    counts.field_bytes = fields.bytes();
    counts.view_bytes = terrain_views.bytes();
    counts.views_drawn = drawn;
    (counts.boxes, counts.box_capacity) = boxes;
    counts.refused.clear();
    counts.refused.extend(fields.reasons().cloned());
    counts.cpu_ms = start.elapsed().as_secs_f32() * 1e3;
}

impl ViewTerrain {
    fn prepare_targets(
        &mut self,
        size: UVec2,
        room: UVec2,
        device: &RenderDevice,
        generation: &mut u64,
    ) {
        let texture = |label, size: UVec2, format, usage| {
            device.create_texture(&TextureDescriptor {
                label: Some(label),
                size: Extent3d {
                    width: size.x,
                    height: size.y,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        if self
            .targets
            .as_ref()
            .is_none_or(|targets| targets.room != room)
        {
            *generation += 1;
            let usage = TextureUsages::STORAGE_BINDING
                | TextureUsages::TEXTURE_BINDING
                | TextureUsages::COPY_SRC;
            let depth = texture("skyline_hit_depth", room, TextureFormat::R32Float, usage);
            let surface = texture("skyline_hit_surface", room, TextureFormat::R32Uint, usage);
            self.targets = Some(HitTargets {
                size,
                room,
                depth_view: depth.create_view(&default()),
                surface_view: surface.create_view(&default()),
                depth,
                surface,
                generation: *generation,
            });
        }
        if let Some(targets) = &mut self.targets {
            targets.size = size;
        }
        let traversals = |traversal| {
            self.drawn.iter().any(|e| {
                self.slots
                    .get(e)
                    .is_some_and(|slot| slot.traversal == traversal)
            })
        };
        let box_room = if traversals(Traversal::Boxes) {
            Some(room)
        } else if traversals(Traversal::Hybrid) {
            Some(room.map(|n| n.div_ceil(BEAM_PX[0])))
        } else {
            None
        };
        match box_room {
            None => self.boxes = None,
            Some(room) if self.boxes.as_ref().is_none_or(|boxes| boxes.room != room) => {
                *generation += 1;
                let entry = texture(
                    "skyline_box_entry",
                    room,
                    BOX_ENTRY_FORMAT,
                    TextureUsages::RENDER_ATTACHMENT
                        | TextureUsages::TEXTURE_BINDING
                        | TextureUsages::COPY_SRC,
                );
                let depth = texture(
                    "skyline_box_depth",
                    room,
                    BOX_DEPTH_FORMAT,
                    TextureUsages::RENDER_ATTACHMENT,
                );
                self.boxes = Some(BoxTargets {
                    room,
                    entry_view: entry.create_view(&default()),
                    depth_view: depth.create_view(&default()),
                    generation: *generation,
                });
            }
            Some(_) => {}
        }
    }
}
