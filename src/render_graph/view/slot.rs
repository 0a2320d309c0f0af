//! One terrain as one camera sees it: its uniforms, its lists of boxes, its tiles.

use bevy::{
    asset::AssetId,
    math::{DAffine3, DMat4, DVec3},
    prelude::*,
    render::{
        render_resource::*,
        renderer::{RenderDevice, RenderQueue},
    },
};

use super::{
    BEAM_PX, ViewTerrain,
    bind::{BoundTo, SlotBindGroups},
    gpu::{GpuPlacement, GpuTerrainLook, GpuTerrainView, flag, gpu_look},
};
use crate::{
    render_graph::{
        extract::ExtractedTerrain,
        height_mips::GpuHeightField,
        readback::BoxCountReadback,
        subdivide::{COUNT_BYTES, GpuSubdividePass, MAX_PASSES, initial_counts},
    },
    terrain::{HeightField, TerrainColour, TerrainRayCasting, Traversal, view_rays::ViewRays},
};

/// Boxes a list first has room for, and the most it grows to.
const FIRST_BOXES: u32 = 1 << 14;
const MOST_BOXES: u32 = 1 << 22;

/// How far the rays of each tile may go blindly: 8 bytes a tile, t, then the level its beam ended at (8 bits)
/// and the nodes the beam read (24 bits).
pub struct TileStarts {
    pub buffer: Buffer,
    pub tiles: UVec2,
    /// Tiles there is room for.
    room: UVec2,
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
    pub(super) generation: u64,
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
    pub(in crate::render_graph) view: UniformBuffer<GpuTerrainView>,
    pub(super) placement: UniformBuffer<GpuPlacement>,
    pub(super) look: UniformBuffer<GpuTerrainLook>,
    pub lists: Option<BoxLists>,
    /// Where tiles of rays may start, coarse and fine.
    pub tile_start: Option<[TileStarts; 2]>,
    pub bind_groups: Option<SlotBindGroups>,
    pub(super) bound: Option<BoundTo>,
    pub pipelines: Option<SlotPipelines>,
    /// Clip from world without jitter, and world from local, of the last frame drawn.
    previous: Option<(DMat4, DAffine3)>,
    pub traversal: Traversal,
    pub float: bool,
    pub levels: u32,
    pub box_level: u32,
    pub(super) albedo: Option<AssetId<Image>>,
    pub(super) field: Option<AssetId<HeightField>>,
    wanted_boxes: u32,
    pub(super) seen: bool,
}

/// What a slot is prepared from.
pub(in crate::render_graph) struct SlotInputs<'a> {
    pub terrain: &'a ExtractedTerrain,
    pub field: &'a GpuHeightField,
    pub rays: &'a ViewRays,
    /// The most pixels that these rays may become without anything being made anew. units: px
    pub room_px: UVec2,
    pub settings: &'a TerrainRayCasting,
    pub in_air: bool,
    /// Whether traversals that use boxes get them; without, their rays start where the terrain may begin.
    pub boxes: bool,
    pub id: u32,
    pub viewport_px: Vec2,
    pub clip_from_world: DMat4,
}

impl BoxLists {
    fn bytes(&self) -> u64 {
        let [a, b] = &self.nodes;
        [
            a,
            b,
            &self.boxes,
            &self.counts,
            &self.arguments,
            &self.template,
        ]
        .into_iter()
        .chain(self.passes.buffer())
        .chain([self.readback.buffer()])
        .map(|buffer| buffer.size())
        .sum()
    }
}

impl TerrainSlot {
    /// Notes where a terrain is that is not drawn: when it comes into view it has moved from there.
    pub(super) fn pass_over(&mut self, clip_from_world: DMat4, world_from_local: DAffine3) {
        self.previous = Some((clip_from_world, world_from_local));
    }

    /// GPU memory of uniforms, lists and tiles. units: bytes
    pub(in crate::render_graph) fn bytes(&self) -> u64 {
        let uniforms = [
            self.view.buffer(),
            self.placement.buffer(),
            self.look.buffer(),
        ];
        let tiles = self
            .tile_start
            .iter()
            .flatten()
            .map(|starts| &starts.buffer);
        let buffers = uniforms.into_iter().flatten().chain(tiles);
        let lists = self.lists.as_ref().map_or(0, BoxLists::bytes);
        lists + buffers.map(|buffer| buffer.size()).sum::<u64>()
    }

    pub(in crate::render_graph) fn prepare(
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
        if self.view.buffer().is_none() {
            self.view.set_label(Some("skyline_terrain_view"));
            self.placement.set_label(Some("skyline_placement"));
            self.look.set_label(Some("skyline_look"));
        }
        self.traversal = settings.traversal;
        self.float = field.float;
        self.levels = field.level_offsets.len() as u32;
        self.box_level = settings.box_texels.max(4).ilog2().min(self.levels);
        let uses_boxes =
            inputs.boxes && matches!(self.traversal, Traversal::Boxes | Traversal::Hybrid);
        let hybrid = self.traversal == Traversal::Hybrid;
        let tiles = BEAM_PX.map(|side| rays.size_px.map(|n| n.div_ceil(side)));
        let room = BEAM_PX.map(|side| inputs.room_px.max(rays.size_px).map(|n| n.div_ceil(side)));
        if !hybrid {
            self.tile_start = None;
        } else if self
            .tile_start
            .as_ref()
            .is_none_or(|starts| starts[1].room != room[1])
        {
            self.tile_start = Some(room.map(|room| TileStarts {
                buffer: device.create_buffer(&BufferDescriptor {
                    label: Some("skyline_tile_start"),
                    size: u64::from(room.x) * u64::from(room.y) * 8,
                    usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC,
                    mapped_at_creation: false,
                }),
                tiles: room,
                room,
            }));
        }
        if let Some(starts) = &mut self.tile_start {
            for (starts, tiles) in starts.iter_mut().zip(tiles) {
                starts.tiles = tiles;
            }
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
            size_px: rays.size_px,
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
            viewport_px: inputs.viewport_px.as_uvec2(),
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
        passes.set_label(Some("skyline_subdivide_passes"));
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
