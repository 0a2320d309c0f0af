//! Bind groups and pipelines of one camera and terrain, made when something they name is new.

use bevy::{
    core_pipeline::prepass::ViewPrepassTextures,
    pbr::ViewKeyCache,
    prelude::*,
    render::{
        render_asset::RenderAssets,
        render_resource::*,
        renderer::RenderDevice,
        texture::{FallbackImage, GpuImage},
        view::{ExtractedView, Msaa},
    },
};

use super::{
    BoxTargets, HitTargets, TerrainViews,
    slot::{SlotPipelines, TerrainSlot},
};
use crate::render_graph::{
    height_mips::{GpuHeightField, GpuHeightFields},
    pipelines::{BOX_ENTRY_FORMAT, PipelineId, PipelineKey, TerrainPipelines},
    stats::TerrainStats,
    subdivide::COUNT_BYTES,
    terrain_shadow::{TerrainShadows, maps::TerrainMaps},
};

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

/// What a slot's bind groups were made for; anything else makes them anew.
#[derive(PartialEq, Clone, Copy)]
pub(super) struct BoundTo {
    field: u64,
    targets: u64,
    boxes: u64,
    lists: u64,
    tile_start: Option<BufferId>,
    drawn_depth: Option<TextureViewId>,
    albedo: TextureViewId,
    visibility: Option<BufferId>,
}

/// Stand-ins for what a traversal doesn't use.
pub(in crate::render_graph) struct Unused {
    pub buffer: Buffer,
    pub texture: TextureView,
    pub nearest: Sampler,
}

/// Binds what `prepare_terrain_views` prepared, where it is not bound already, and queues the pipelines.
#[expect(clippy::too_many_arguments, reason = "a system asks for what it needs")]
pub fn prepare_terrain_bind_groups(
    mut terrain_views: ResMut<TerrainViews>,
    mut pipelines: ResMut<TerrainPipelines>,
    cache: Res<PipelineCache>,
    view_keys: Res<ViewKeyCache>,
    fields: Res<GpuHeightFields>,
    shadows: Res<TerrainShadows>,
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
            // Asked for before the first map shows, and used when it is compiled: nothing waits for it.
            let maps = shadows.get(*terrain).filter(|maps| !maps.lights.is_empty());
            let shadowed = mesh_key.zip(maps).and_then(|(mesh, _)| {
                let key = PipelineKey::TerrainShade {
                    float,
                    mesh,
                    shadowed: true,
                };
                match pipelines.get(&cache, key) {
                    PipelineId::Render(id) => cache.get_render_pipeline(id).map(|_| id),
                    PipelineId::Compute(_) => None,
                }
            });
            let shadow = maps.filter(|maps| maps.show() && shadowed.is_some());
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
            let terrain_shade = match shadow {
                Some(_) => shadowed,
                None => mesh_key.and_then(|mesh| {
                    render(PipelineKey::TerrainShade {
                        float,
                        mesh,
                        shadowed: false,
                    })
                }),
            };
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
                visibility: shadow.and_then(|maps| Some(maps.shown.as_ref()?.id())),
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
                    shadow,
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
    shadow: Option<&'a TerrainMaps>,
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
    let mut terrain_shade: Vec<BindGroupEntry> = BindGroupEntries::sequential((
        &targets.depth_view,
        &targets.surface_view,
        slot.placement.binding()?,
        slot.look.binding()?,
        &inputs.albedo.texture_view,
        &inputs.albedo.sampler,
    ))
    .to_vec();
    if let Some(maps) = inputs.shadow {
        terrain_shade.extend([
            BindGroupEntry {
                binding: 6,
                resource: maps.table.binding()?,
            },
            BindGroupEntry {
                binding: 7,
                resource: maps.shown.as_ref()?.as_entire_binding(),
            },
        ]);
    }
    Some(SlotBindGroups {
        field: device.create_bind_group(
            "skyline_field",
            &layout(pipelines.field(field.float)),
            &BindGroupEntries::sequential((
                field.uniform.as_entire_binding(),
                &field.heights,
                field.pyramid.as_entire_binding(),
                &unused.nearest,
                slot.view.binding()?,
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
            &layout(pipelines.terrain_shade(inputs.shadow.is_some())),
            &terrain_shade,
        ),
    })
}

impl Unused {
    /// GPU memory, one texel's included. units: bytes
    pub fn bytes(&self) -> u64 {
        self.buffer.size() + 4
    }

    pub fn new(device: &RenderDevice) -> Self {
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
