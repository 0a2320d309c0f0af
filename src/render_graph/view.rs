//! What each camera needs for the terrains it sees: the numbers the shaders read, the textures and buffers of
//! its passes, and their bind groups.
//!
//! All of it is kept from frame to frame and only made anew when a size, a field or a setting changes; a
//! standing scene writes its uniforms and allocates nothing.

use bevy::{
    asset::AssetId,
    camera::MainPassResolutionOverride,
    core_pipeline::prepass::ViewPrepassTextures,
    math::{DAffine3, DMat4, DVec3},
    pbr::ViewKeyCache,
    platform::{collections::HashMap, time::Instant},
    prelude::*,
    render::{
        camera::{ExtractedCamera, TemporalJitter},
        render_asset::RenderAssets,
        render_resource::*,
        renderer::{RenderDevice, RenderQueue},
        texture::{FallbackImage, GpuImage},
        view::{ExtractedView, Msaa},
    },
};

use super::{
    extract::{ExtractedTerrain, ExtractedTerrains, affine64, clip_from_world},
    height_mips::{GpuHeightField, GpuHeightFields},
    pipelines::{BOX_DEPTH_FORMAT, BOX_ENTRY_FORMAT, PipelineId, PipelineKey, TerrainPipelines},
    readback::BoxCountReadback,
    stats::TerrainStats,
    subdivide::{COUNT_BYTES, GpuSubdividePass, MAX_PASSES, initial_counts},
};
use crate::terrain::{
    HeightField, TerrainColour, TerrainLook, TerrainRayCasting, Traversal,
    view_rays::{ViewInputs, ViewRays},
};

/// Terrains one camera can draw: `hit_surface` names them in eight bits.
pub const MAX_TERRAINS: usize = 255;
/// Side of a workgroup of `ray_cast.wgsl`. units: px
pub const WORKGROUP_PX: u32 = 8;
/// Sides of the tiles that one beam stands for, coarse and fine, as in `beam.wgsl`. Boxes are drawn at the
/// coarse tiles. units: px
pub const BEAM_PX: [u32; 2] = [16, 4];
/// Boxes a list first has room for, and the most it grows to.
const FIRST_BOXES: u32 = 1 << 14;
const MOST_BOXES: u32 = 1 << 22;

/// Flags of `TerrainView`; as in `types.wgsl`.
mod flag {
    pub const STARTS_IN_AIR: u32 = 1;
    pub const BASEMENT: u32 = 2;
    pub const FIRST: u32 = 4;
    pub const MIRRORED: u32 = 8;
}

/// Mirrors `TerrainView` in `types.wgsl`, field by field.
#[derive(ShaderType, Clone, Copy, Debug, Default)]
pub struct GpuTerrainView {
    origin: Vec3,
    t_base: f32,
    origin_dx: Vec3,
    t_far: f32,
    origin_dy: Vec3,
    lod_a: f32,
    direction: Vec3,
    lod_b: f32,
    direction_dx: Vec3,
    y_max: f32,
    direction_dy: Vec3,
    y_min: f32,
    depth: Vec4,
    beam_a: Vec3,
    anchor_y: f32,
    beam_b: Vec3,
    max_error_px: f32,
    beam_slack: Vec3,
    y_magnitude: f32,
    anchor: IVec2,
    cells: IVec2,
    size_px: UVec2,
    levels: u32,
    flags: u32,
    terrain_id: u32,
    traversal: u32,
    box_level: u32,
    tile_px: u32,
    box_area_px: f32,
    box_capacity: u32,
    pixel_a: f32,
    pixel_b: f32,
    clip_from_grid: Mat4,
    depth_from_grid: Vec4,
    frustum: [Vec4; 6],
    level_offset: [UVec4; 8],
}

/// Mirrors `Placement` in `placement.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug, Default)]
pub struct GpuPlacement {
    world_from_grid: Mat4,
    normal_from_grid: Mat3,
    clip_from_grid: Mat4,
    previous_clip_from_grid: Mat4,
    viewport_px: Vec2,
}

/// Mirrors `Look` in `terrain_shade.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug, Default)]
pub struct GpuTerrainLook {
    colours: [Vec4; 4],
    edges: Vec4,
    perceptual_roughness: f32,
    metallic: f32,
    reflectance: f32,
    textured: u32,
}

/// What a camera holds for terrain.
#[derive(Default)]
pub struct ViewTerrain {
    pub targets: Option<HitTargets>,
    pub boxes: Option<BoxTargets>,
    pub slots: HashMap<Entity, TerrainSlot>,
    /// Terrains to draw this frame, in the order of their ids.
    pub drawn: Vec<Entity>,
    pub viewport: Option<bevy::camera::Viewport>,
    seen: bool,
}

/// Where rays write what they hit.
pub struct HitTargets {
    pub size: UVec2,
    pub depth: Texture,
    pub depth_view: TextureView,
    pub surface: Texture,
    pub surface_view: TextureView,
    generation: u64,
}

/// Where boxes are drawn: one texel a pixel, or one a tile.
pub struct BoxTargets {
    pub size: UVec2,
    pub entry_view: TextureView,
    pub depth_view: TextureView,
    generation: u64,
}

/// How far the rays of each tile may go blindly: t and level, 8 bytes a tile.
pub struct TileStarts {
    pub buffer: Buffer,
    pub tiles: UVec2,
}

/// The lists of one subdivision.
pub struct BoxLists {
    pub nodes: [Buffer; 2],
    pub boxes: Buffer,
    pub counts: Buffer,
    /// Copies of `counts` that dispatches and the draw take their sizes from.
    pub arguments: Buffer,
    /// The counts before the first pass, then the root node.
    pub template: Buffer,
    pub passes: DynamicUniformBuffer<GpuSubdividePass>,
    pub pass_offsets: Vec<u32>,
    pub capacity: u32,
    pub readback: BoxCountReadback,
    levels: u32,
    generation: u64,
}

/// Bind groups of one camera and terrain.
pub struct SlotBindGroups {
    pub field: BindGroup,
    /// By which list is read.
    pub subdivide: Option<[BindGroup; 2]>,
    pub box_entry: Option<BindGroup>,
    pub beam: Option<[BindGroup; 2]>,
    pub ray_cast: BindGroup,
    pub terrain_depth: BindGroup,
    pub terrain_shade: BindGroup,
}

/// Pipelines of one camera and terrain.
#[derive(Clone, Copy)]
pub struct SlotPipelines {
    pub subdivide: Option<CachedComputePipelineId>,
    pub box_entry: Option<CachedRenderPipelineId>,
    pub beam: Option<[CachedComputePipelineId; 2]>,
    pub ray_cast: CachedComputePipelineId,
    pub terrain_depth: CachedRenderPipelineId,
    pub terrain_shade: Option<CachedRenderPipelineId>,
}

/// One terrain as one camera sees it.
#[derive(Default)]
pub struct TerrainSlot {
    view: UniformBuffer<GpuTerrainView>,
    placement: UniformBuffer<GpuPlacement>,
    look: UniformBuffer<GpuTerrainLook>,
    pub lists: Option<BoxLists>,
    /// Where tiles of rays may start, coarse and fine.
    pub tile_start: Option<[TileStarts; 2]>,
    pub bind_groups: Option<SlotBindGroups>,
    bound: Option<BoundTo>,
    pub pipelines: Option<SlotPipelines>,
    /// Clip from world without jitter, and world from local, of the last frame drawn.
    previous: Option<(DMat4, DAffine3)>,
    pub traversal: Traversal,
    pub float: bool,
    pub levels: u32,
    pub box_level: u32,
    albedo: Option<AssetId<Image>>,
    field: Option<AssetId<HeightField>>,
    wanted_boxes: u32,
    seen: bool,
}

/// What a slot's bind groups were made for; anything else makes them anew.
#[derive(PartialEq, Clone, Copy)]
struct BoundTo {
    field: u64,
    targets: u64,
    boxes: u64,
    lists: u64,
    tile_start: Option<BufferId>,
    drawn_depth: Option<TextureViewId>,
    albedo: TextureViewId,
}

/// Every camera's terrain state.
#[derive(Resource, Default)]
pub struct TerrainViews {
    pub views: HashMap<Entity, ViewTerrain>,
    /// Stand-ins for what a traversal doesn't use.
    unused: Option<Unused>,
    generation: u64,
}

struct Unused {
    buffer: Buffer,
    texture: TextureView,
    nearest: Sampler,
}

impl TerrainViews {
    /// Bytes of all textures and buffers.
    fn bytes(&self) -> u64 {
        let pixels = |size: UVec2| u64::from(size.x) * u64::from(size.y);
        self.views
            .values()
            .map(|view| {
                let targets = view.targets.as_ref().map_or(0, |t| 8 * pixels(t.size));
                let boxes = view.boxes.as_ref().map_or(0, |b| 8 * pixels(b.size));
                let slots: u64 =
                    view.slots
                        .values()
                        .map(|slot| {
                            let lists = slot.lists.as_ref().map_or(0, |lists| {
                                24 * u64::from(lists.capacity) + 3 * COUNT_BYTES
                            });
                            let tiles = slot
                                .tile_start
                                .as_ref()
                                .map_or(0, |starts| starts.iter().map(|s| s.buffer.size()).sum());
                            lists + tiles + 1024
                        })
                        .sum();
                targets + boxes + slots
            })
            .sum()
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
        let mut clip_from_view = extracted_view.clip_from_view;
        let unjittered = clip_from_view;
        if let Some(jitter) = jitter {
            jitter.jitter_projection(&mut clip_from_view, size_px.as_vec2());
        }
        let world_from_view = affine64(extracted_view.world_from_view.affine());
        let clip_from_world = clip_from_world(unjittered, &extracted_view.world_from_view);

        let mut view = terrain_views.views.remove(&main_entity).unwrap_or_default();
        view.seen = true;
        view.viewport = bevy::camera::Viewport::from_viewport_and_override(
            camera.viewport.as_ref(),
            resolution,
        );
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
            // Out of view for now or not, the slot stays: only a terrain that is gone frees it.
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
            let Some(rays) = rays.filter(ViewRays::sees_terrain) else {
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
                    settings: &terrain_camera.settings,
                    in_air,
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
            view.prepare_targets(size_px, &device, &mut terrain_views.generation);
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
    counts.refused.extend(fields.refused.values().cloned());
    counts.cpu_ms = start.elapsed().as_secs_f32() * 1e3;
}

/// What a slot is prepared from.
struct SlotInputs<'a> {
    terrain: &'a ExtractedTerrain,
    field: &'a GpuHeightField,
    rays: &'a ViewRays,
    settings: &'a TerrainRayCasting,
    in_air: bool,
    id: u32,
    viewport_px: Vec2,
    clip_from_world: DMat4,
}

impl TerrainSlot {
    fn prepare(
        &mut self,
        inputs: &SlotInputs,
        device: &RenderDevice,
        queue: &RenderQueue,
        generation: &mut u64,
    ) {
        let SlotInputs {
            terrain,
            field,
            rays,
            settings,
            in_air,
            id,
            ..
        } = *inputs;
        self.traversal = settings.traversal;
        self.float = field.float;
        self.levels = field.level_offsets.len() as u32;
        self.box_level = settings.box_texels.max(4).ilog2().min(self.levels);
        let uses_boxes = matches!(self.traversal, Traversal::Boxes | Traversal::Hybrid);
        let hybrid = self.traversal == Traversal::Hybrid;
        let tiles = BEAM_PX.map(|side| rays.size_px.map(|n| n.div_ceil(side)));
        if !hybrid {
            self.tile_start = None;
        } else if self
            .tile_start
            .as_ref()
            .is_none_or(|starts| starts[1].tiles != tiles[1])
        {
            self.tile_start = Some(tiles.map(|tiles| TileStarts {
                buffer: device.create_buffer(&BufferDescriptor {
                    label: Some("skyline_tile_start"),
                    size: u64::from(tiles.x) * u64::from(tiles.y) * 8,
                    usage: BufferUsages::STORAGE,
                    mapped_at_creation: false,
                }),
                tiles,
            }));
        }
        if uses_boxes {
            self.prepare_lists(device, queue, generation);
        } else {
            self.lists = None;
        }

        let mut flags = 0;
        if in_air {
            flags |= flag::STARTS_IN_AIR;
        }
        if rays.enters {
            flags |= flag::BASEMENT;
        }
        if id == 1 {
            flags |= flag::FIRST;
        }
        if rays.mirrored {
            flags |= flag::MIRRORED;
        }
        // P1 divides while four texels of the box would still cover more than a pixel. A hybrid's boxes need
        // not be finer than its tiles.
        let texels = f32::from(1u16 << self.box_level.min(15));
        let lod_area = 4.0 * (texels * rays.max_error_px).powi(2);
        let tile_area = if hybrid {
            (BEAM_PX[0] * BEAM_PX[0]) as f32
        } else {
            0.0
        };
        let mut level_offset = [UVec4::ZERO; 8];
        for (i, offset) in field.level_offsets.iter().enumerate() {
            // Level k is `level_offsets[k - 1]`.
            level_offset[(i + 1) / 4][(i + 1) % 4] = *offset;
        }
        self.view.set(GpuTerrainView {
            origin: rays.origin,
            t_base: rays.t_base,
            origin_dx: rays.origin_dx,
            t_far: rays.t_far,
            origin_dy: rays.origin_dy,
            lod_a: rays.lod_a,
            direction: rays.direction,
            lod_b: rays.lod_b,
            direction_dx: rays.direction_dx,
            y_max: rays.y_max,
            direction_dy: rays.direction_dy,
            y_min: rays.y_min,
            depth: rays.depth,
            beam_a: rays.beam_a,
            anchor_y: rays.anchor_y,
            beam_b: rays.beam_b,
            max_error_px: rays.max_error_px,
            beam_slack: rays.beam_slack,
            y_magnitude: rays.y_magnitude,
            anchor: rays.anchor,
            cells: rays.cells,
            size_px: rays.size_px,
            levels: self.levels,
            flags,
            terrain_id: id,
            traversal: match self.traversal {
                Traversal::PerTexel => 0,
                Traversal::MaxMip => 1,
                Traversal::Boxes => 2,
                Traversal::Hybrid => 3,
            },
            box_level: self.box_level,
            tile_px: if hybrid { BEAM_PX[0] } else { 1 },
            box_area_px: lod_area.max(tile_area),
            box_capacity: self.lists.as_ref().map_or(0, |lists| lists.capacity),
            pixel_a: rays.pixel_a,
            pixel_b: rays.pixel_b,
            clip_from_grid: rays.clip_from_grid,
            depth_from_grid: rays.depth_from_grid,
            frustum: rays.frustum,
            level_offset,
        });
        self.view.write_buffer(device, queue);

        let shift = DAffine3::from_translation(DVec3::new(
            f64::from(rays.anchor.x),
            f64::from(rays.anchor_y),
            f64::from(rays.anchor.y),
        ));
        let local_from_grid = terrain.grid_from_local.inverse() * shift;
        let world_from_grid = terrain.world_from_local * local_from_grid;
        let linear = world_from_grid.matrix3;
        let scale = DVec3::new(
            linear.x_axis.length(),
            linear.y_axis.length(),
            linear.z_axis.length(),
        )
        .max_element();
        let normal_from_grid = (linear * (1.0 / scale)).inverse().transpose();
        let (previous_clip, previous_world) = self
            .previous
            .unwrap_or((inputs.clip_from_world, terrain.world_from_local));
        self.placement.set(GpuPlacement {
            world_from_grid: DMat4::from(world_from_grid).as_mat4(),
            normal_from_grid: normal_from_grid.as_mat3(),
            clip_from_grid: (inputs.clip_from_world * DMat4::from(world_from_grid)).as_mat4(),
            previous_clip_from_grid: (previous_clip
                * DMat4::from(previous_world * local_from_grid))
            .as_mat4(),
            viewport_px: inputs.viewport_px,
        });
        self.placement.write_buffer(device, queue);
        self.previous = Some((inputs.clip_from_world, terrain.world_from_local));

        self.look.set(gpu_look(&terrain.look, terrain.height_range));
        self.look.write_buffer(device, queue);
        self.albedo = match &terrain.look.colour {
            TerrainColour::Albedo(image) => Some(image.id()),
            _ => None,
        };
    }

    /// Makes sure of lists with room for what the last subdivision asked for.
    fn prepare_lists(&mut self, device: &RenderDevice, queue: &RenderQueue, generation: &mut u64) {
        let wanted = match &self.lists {
            Some(lists) if lists.readback.latest() > u64::from(lists.capacity) => {
                let count = u32::try_from(lists.readback.latest()).unwrap_or(MOST_BOXES);
                if count > MOST_BOXES {
                    warn_once!(
                        "terrain asks for {count} boxes, more than the {MOST_BOXES} its list may hold; \
                         rays start without boxes: raise `box_texels`"
                    );
                }
                count.min(MOST_BOXES).next_power_of_two()
            }
            Some(lists) => lists.capacity,
            None => self.wanted_boxes.max(FIRST_BOXES),
        };
        self.wanted_boxes = wanted;
        if self
            .lists
            .as_ref()
            .is_some_and(|lists| lists.capacity == wanted && lists.levels == self.levels)
        {
            return;
        }
        *generation += 1;
        let list = |label, usage| {
            device.create_buffer(&BufferDescriptor {
                label: Some(label),
                size: 8 * u64::from(wanted),
                usage: BufferUsages::STORAGE | usage,
                mapped_at_creation: false,
            })
        };
        let mut passes = DynamicUniformBuffer::default();
        let pass_offsets = (0..MAX_PASSES)
            .map(|index| {
                passes.push(&GpuSubdividePass {
                    index,
                    node_capacity: wanted,
                })
            })
            .collect();
        passes.write_buffer(device, queue);
        let mut template = initial_counts().to_vec();
        template.extend([0, self.levels]);
        let counts = |label, usage| {
            device.create_buffer(&BufferDescriptor {
                label: Some(label),
                size: COUNT_BYTES,
                usage: usage | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        self.lists = Some(BoxLists {
            nodes: [
                list("skyline_nodes", BufferUsages::COPY_DST),
                list("skyline_nodes", BufferUsages::empty()),
            ],
            boxes: list("skyline_boxes", BufferUsages::empty()),
            counts: counts(
                "skyline_box_counts",
                BufferUsages::STORAGE | BufferUsages::COPY_SRC,
            ),
            arguments: counts("skyline_box_arguments", BufferUsages::INDIRECT),
            template: device.create_buffer_with_data(&BufferInitDescriptor {
                label: Some("skyline_box_template"),
                contents: bytemuck::cast_slice(&template),
                usage: BufferUsages::COPY_SRC,
            }),
            passes,
            pass_offsets,
            capacity: wanted,
            readback: BoxCountReadback::new(device),
            levels: self.levels,
            generation: *generation,
        });
    }

    /// Texels of the view's box targets that this traversal draws to.
    pub fn box_target_size(&self, view: &ViewTerrain) -> UVec2 {
        let size = view
            .targets
            .as_ref()
            .map_or(UVec2::ONE, |targets| targets.size);
        match self.traversal {
            Traversal::Hybrid => size.map(|n| n.div_ceil(BEAM_PX[0])),
            _ => size,
        }
    }

    /// Levels the subdivision goes through, the root's included.
    pub fn subdivide_passes(&self) -> u32 {
        (self.levels - self.box_level + 1).min(MAX_PASSES - 1)
    }
}

fn gpu_look(look: &TerrainLook, (lowest, highest): (f64, f64)) -> GpuTerrainLook {
    let linear = |colour: Color| colour.to_linear().to_vec4();
    let (colours, edges, textured) = match &look.colour {
        TerrainColour::Bands {
            colours,
            edges,
            blend,
        } => {
            let span = (highest - lowest).max(1e-9);
            let at = |share: f32| (lowest + f64::from(share) * span) as f32;
            (
                colours.map(linear),
                Vec4::new(
                    at(edges[0]),
                    at(edges[1]),
                    at(edges[2]),
                    (f64::from(*blend) * span) as f32,
                ),
                0,
            )
        }
        TerrainColour::Uniform(colour) => ([linear(*colour); 4], Vec4::new(0.0, 0.0, 0.0, 1.0), 0),
        TerrainColour::Albedo(_) => ([Vec4::ONE; 4], Vec4::new(0.0, 0.0, 0.0, 1.0), 1),
    };
    GpuTerrainLook {
        colours,
        edges,
        perceptual_roughness: look.perceptual_roughness.clamp(0.089, 1.0),
        metallic: look.metallic.clamp(0.0, 1.0),
        reflectance: look.reflectance.clamp(0.0, 1.0),
        textured,
    }
}

impl ViewTerrain {
    fn prepare_targets(&mut self, size: UVec2, device: &RenderDevice, generation: &mut u64) {
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
            .is_none_or(|targets| targets.size != size)
        {
            *generation += 1;
            let usage = TextureUsages::STORAGE_BINDING
                | TextureUsages::TEXTURE_BINDING
                | TextureUsages::COPY_SRC;
            let depth = texture("skyline_hit_depth", size, TextureFormat::R32Float, usage);
            let surface = texture("skyline_hit_surface", size, TextureFormat::R32Uint, usage);
            self.targets = Some(HitTargets {
                size,
                depth_view: depth.create_view(&default()),
                surface_view: surface.create_view(&default()),
                depth,
                surface,
                generation: *generation,
            });
        }
        let traversals = |traversal| {
            self.drawn.iter().any(|e| {
                self.slots
                    .get(e)
                    .is_some_and(|slot| slot.traversal == traversal)
            })
        };
        let box_size = if traversals(Traversal::Boxes) {
            Some(size)
        } else if traversals(Traversal::Hybrid) {
            Some(size.map(|n| n.div_ceil(BEAM_PX[0])))
        } else {
            None
        };
        match box_size {
            None => self.boxes = None,
            Some(size) if self.boxes.as_ref().is_none_or(|boxes| boxes.size != size) => {
                *generation += 1;
                let entry = texture(
                    "skyline_box_entry",
                    size,
                    BOX_ENTRY_FORMAT,
                    TextureUsages::RENDER_ATTACHMENT
                        | TextureUsages::TEXTURE_BINDING
                        | TextureUsages::COPY_SRC,
                );
                let depth = texture(
                    "skyline_box_depth",
                    size,
                    BOX_DEPTH_FORMAT,
                    TextureUsages::RENDER_ATTACHMENT,
                );
                self.boxes = Some(BoxTargets {
                    size,
                    entry_view: entry.create_view(&default()),
                    depth_view: depth.create_view(&default()),
                    generation: *generation,
                });
            }
            Some(_) => {}
        }
    }
}

/// Binds what [`prepare_terrain_views`] prepared, where it is not bound already, and queues the pipelines.
#[expect(clippy::too_many_arguments, reason = "a system asks for what it needs")]
pub fn prepare_terrain_bind_groups(
    mut terrain_views: ResMut<TerrainViews>,
    mut pipelines: ResMut<TerrainPipelines>,
    cache: Res<PipelineCache>,
    view_keys: Res<ViewKeyCache>,
    fields: Res<GpuHeightFields>,
    images: Res<RenderAssets<GpuImage>>,
    fallback: Res<FallbackImage>,
    device: Res<RenderDevice>,
    stats: Res<TerrainStats>,
    cameras: Query<(&ExtractedView, &Msaa, Option<&ViewPrepassTextures>)>,
) {
    if terrain_views.views.is_empty() {
        return;
    }
    let terrain_views = &mut *terrain_views;
    let unused = terrain_views
        .unused
        .get_or_insert_with(|| Unused::new(&device));
    for (extracted_view, msaa, prepass) in &cameras {
        let main_entity = extracted_view.retained_view_entity.main_entity.id();
        let Some(view) = terrain_views.views.get_mut(&main_entity) else {
            continue;
        };
        let Some(targets) = &view.targets else {
            continue;
        };
        let drawn_depth = prepass
            .and_then(|textures| textures.depth.as_ref())
            // A deferred camera's copy is made later, and a multisampled one has no single depth.
            .filter(|_| msaa.samples() == 1 && prepass.is_some_and(|p| p.deferred.is_none()))
            .map(|depth| &depth.texture.default_view);
        let mesh_key = view_keys.get(&extracted_view.retained_view_entity).copied();
        for terrain in &view.drawn {
            let Some(slot) = view.slots.get_mut(terrain) else {
                continue;
            };
            let Some(field) = slot.field.and_then(|id| fields.get(id)) else {
                continue;
            };
            let float = field.float;
            let mut compute = |key| match pipelines.get(&cache, key) {
                PipelineId::Compute(id) => Some(id),
                PipelineId::Render(_) => None,
            };
            let uses_boxes = slot.lists.is_some();
            let beams = slot.tile_start.is_some();
            let stop_at_depth = drawn_depth.is_some();
            let subdivide = uses_boxes
                .then(|| compute(PipelineKey::Subdivide { float }))
                .flatten();
            let beam = beams
                .then(|| {
                    Some([
                        compute(PipelineKey::Beam { float, fine: false })?,
                        compute(PipelineKey::Beam { float, fine: true })?,
                    ])
                })
                .flatten();
            let ray_cast = compute(PipelineKey::RayCast {
                float,
                stop_at_depth,
            });
            let mut render = |key| match pipelines.get(&cache, key) {
                PipelineId::Render(id) => Some(id),
                PipelineId::Compute(_) => None,
            };
            let box_entry = uses_boxes
                .then(|| render(PipelineKey::BoxEntry { float }))
                .flatten();
            let terrain_depth = render(PipelineKey::TerrainDepth {
                float,
                samples: msaa.samples(),
                normal: prepass.is_some_and(|textures| textures.normal.is_some()),
                motion: prepass.is_some_and(|textures| textures.motion_vectors.is_some()),
            });
            let terrain_shade =
                mesh_key.and_then(|mesh| render(PipelineKey::TerrainShade { float, mesh }));
            slot.pipelines = match (ray_cast, terrain_depth) {
                (Some(ray_cast), Some(terrain_depth)) => Some(SlotPipelines {
                    subdivide,
                    box_entry,
                    beam,
                    ray_cast,
                    terrain_depth,
                    terrain_shade,
                }),
                _ => None,
            };

            let albedo = slot
                .albedo
                .and_then(|id| images.get(id))
                .unwrap_or(&fallback.d2);
            let bound = BoundTo {
                field: field.generation,
                targets: targets.generation,
                boxes: view.boxes.as_ref().map_or(0, |boxes| boxes.generation),
                lists: slot.lists.as_ref().map_or(0, |lists| lists.generation),
                tile_start: slot.tile_start.as_ref().map(|starts| starts[1].buffer.id()),
                drawn_depth: drawn_depth.map(|depth| depth.id()),
                albedo: albedo.texture_view.id(),
            };
            if slot.bound == Some(bound) {
                continue;
            }
            slot.bind_groups = bind(
                slot,
                &BindInputs {
                    field,
                    targets,
                    boxes: view.boxes.as_ref(),
                    unused,
                    drawn_depth,
                    albedo,
                    device: &device,
                    cache: &cache,
                    pipelines: &pipelines,
                },
            );
            slot.bound = slot.bind_groups.is_some().then_some(bound);
        }
    }
    stats.lock().pipelines = pipelines.count() as u64;
}

struct BindInputs<'a> {
    field: &'a GpuHeightField,
    targets: &'a HitTargets,
    boxes: Option<&'a BoxTargets>,
    unused: &'a Unused,
    drawn_depth: Option<&'a TextureView>,
    albedo: &'a GpuImage,
    device: &'a RenderDevice,
    cache: &'a PipelineCache,
    pipelines: &'a TerrainPipelines,
}

fn bind(slot: &TerrainSlot, inputs: &BindInputs) -> Option<SlotBindGroups> {
    let BindInputs {
        field,
        targets,
        unused,
        device,
        cache,
        pipelines,
        ..
    } = *inputs;
    let layout = |descriptor| cache.get_bind_group_layout(descriptor);
    let lists = slot.lists.as_ref();
    let box_entry_view = inputs
        .boxes
        .map_or(&unused.texture, |boxes| &boxes.entry_view);
    let tile_start = slot
        .tile_start
        .as_ref()
        .map_or(&unused.buffer, |starts| &starts[1].buffer);
    let counts = lists.map_or(&unused.buffer, |lists| &lists.counts);
    let subdivide = lists.and_then(|lists| {
        let passes = lists.passes.binding()?;
        Some([0, 1].map(|from: usize| {
            device.create_bind_group(
                "skyline_subdivide",
                &layout(&pipelines.subdivide),
                &BindGroupEntries::sequential((
                    passes.clone(),
                    lists.nodes[from].as_entire_binding(),
                    lists.nodes[1 - from].as_entire_binding(),
                    lists.boxes.as_entire_binding(),
                    lists.counts.as_entire_binding(),
                )),
            )
        }))
    });
    let stop_at_depth = inputs.drawn_depth.is_some();
    let mut ray_cast: Vec<BindGroupEntry> = BindGroupEntries::sequential((
        &targets.depth_view,
        &targets.surface_view,
        tile_start.as_entire_binding(),
        box_entry_view,
        counts.as_entire_binding(),
    ))
    .to_vec();
    if let Some(depth) = inputs.drawn_depth {
        ray_cast.push(BindGroupEntry {
            binding: 5,
            resource: depth.into_binding(),
        });
    }
    Some(SlotBindGroups {
        field: device.create_bind_group(
            "skyline_field",
            &layout(pipelines.field(field.float)),
            &BindGroupEntries::sequential((
                slot.view.binding()?,
                &field.heights,
                field.pyramid.as_entire_binding(),
                &unused.nearest,
            )),
        ),
        subdivide,
        box_entry: lists.map(|lists| {
            device.create_bind_group(
                "skyline_box_entry",
                &layout(&pipelines.box_entry),
                &BindGroupEntries::single(lists.boxes.as_entire_binding()),
            )
        }),
        beam: slot.tile_start.as_ref().map(|starts| {
            [
                (&starts[0].buffer, &unused.buffer),
                (&starts[1].buffer, &starts[0].buffer),
            ]
            .map(|(out, coarse)| {
                device.create_bind_group(
                    "skyline_beam",
                    &layout(&pipelines.beam),
                    &BindGroupEntries::sequential((
                        out.as_entire_binding(),
                        box_entry_view,
                        counts.as_entire_binding(),
                        coarse.as_entire_binding(),
                    )),
                )
            })
        }),
        ray_cast: device.create_bind_group(
            "skyline_ray_cast",
            &layout(pipelines.ray_cast(stop_at_depth)),
            &ray_cast,
        ),
        terrain_depth: device.create_bind_group(
            "skyline_terrain_depth",
            &layout(&pipelines.terrain_depth),
            &BindGroupEntries::sequential((
                &targets.depth_view,
                &targets.surface_view,
                slot.placement.binding()?,
            )),
        ),
        terrain_shade: device.create_bind_group(
            "skyline_terrain_shade",
            &layout(&pipelines.terrain_shade),
            &BindGroupEntries::sequential((
                &targets.depth_view,
                &targets.surface_view,
                slot.placement.binding()?,
                slot.look.binding()?,
                &inputs.albedo.texture_view,
                &inputs.albedo.sampler,
            )),
        ),
    })
}

impl Unused {
    fn new(device: &RenderDevice) -> Self {
        let texture = device.create_texture(&TextureDescriptor {
            label: Some("skyline_unused"),
            size: Extent3d::default(),
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format: BOX_ENTRY_FORMAT,
            usage: TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        Self {
            buffer: device.create_buffer(&BufferDescriptor {
                label: Some("skyline_unused"),
                size: COUNT_BYTES,
                usage: BufferUsages::STORAGE,
                mapped_at_creation: false,
            }),
            texture: texture.create_view(&default()),
            nearest: device.create_sampler(&SamplerDescriptor::default()),
        }
    }
}
