//! Uploads what changed, gives each camera its memory, binds it.

use core::num::NonZero;

use bevy::{
    camera::MainPassResolutionOverride,
    pbr::{MeshInputUniform, MeshUniform, RenderMeshInstances},
    platform::collections::HashMap,
    prelude::*,
    render::{
        batching::gpu_preprocessing::{
            BatchedInstanceBuffers, IndirectParametersBuffers, PreprocessWorkItem,
            PreprocessWorkItemBuffers,
        },
        camera::{ExtractedCamera, TemporalJitter},
        render_resource::*,
        renderer::{RenderDevice, RenderQueue},
        sync_world::MainEntity,
        view::{ExtractedView, RenderVisibleEntities, RetainedViewEntity, ViewDepthTexture},
    },
};

use crate::occlusion::{
    DepthSampling,
    depth::{GpuOcclusionView, ReducedDepth, room_for, texel_count},
};

use super::{
    OcclusionStats,
    buffers::{GpuOccludees, OcclusionViews, ReduceKey, ViewOcclusion},
    extract::ExtractedOcclusion,
    late_view::{LateViews, draws_late, late_view_of},
    pipelines::OcclusionPipelines,
};

/// Lets the depth of cameras that are read be read by a shader.
pub fn make_depth_readable(extracted: Res<ExtractedOcclusion>, mut cameras: Query<&mut Camera3d>) {
    for camera in &extracted.cameras {
        if let Ok(mut camera) = cameras.get_mut(camera.render) {
            let usages =
                TextureUsages::from(camera.depth_texture_usages) | TextureUsages::TEXTURE_BINDING;
            camera.depth_texture_usages = usages.into();
        }
    }
}

/// What is known of a camera when its memory is made ready.
type CameraData<'w> = (
    &'w ExtractedView,
    &'w ExtractedCamera,
    &'w Msaa,
    Option<&'w TemporalJitter>,
    Option<&'w MainPassResolutionOverride>,
);

/// Uploads the table and this frame's views.
#[expect(
    clippy::too_many_arguments,
    reason = "it fills all of the effect's memory"
)]
pub fn prepare_occlusion(
    extracted: Res<ExtractedOcclusion>,
    mut table: ResMut<GpuOccludees>,
    mut views: ResMut<OcclusionViews>,
    mut pipelines: ResMut<OcclusionPipelines>,
    late_views: Res<LateViews>,
    late_entities: Query<&RenderVisibleEntities>,
    meshes: Res<RenderMeshInstances>,
    mut unplaced: Local<Vec<(MainEntity, u32)>>,
    cameras: Query<CameraData>,
    cache: Res<PipelineCache>,
    stats: Res<OcclusionStats>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    if !extracted.asked {
        if !table.is_empty() || !views.0.is_empty() {
            *table = GpuOccludees::default();
            views.0.clear();
            unplaced.clear();
            stats.lock().bytes = 0;
        }
        return;
    }
    if extracted.all {
        table.restart(extracted.epoch);
    }
    for (slot, of) in &extracted.changed {
        table.set(*slot, of.as_ref());
    }
    // Mesh inputs of what came into a late view.
    unplaced.retain(|(entity, slot)| {
        let removed = extracted.cameras.iter().any(|camera| {
            let found = camera
                .removed
                .binary_search_by_key(entity, |(e, _)| MainEntity::from(*e));
            found.is_ok_and(|i| camera.removed[i].1 == *slot)
        });
        let mesh = meshes.render_mesh_queue_data(*entity);
        if let (true, Some(mesh)) = (removed, &mesh) {
            table.note_input(mesh.current_uniform_index.0, *slot);
        }
        removed && mesh.is_none()
    });
    for camera in extracted.cameras.iter().filter(|c| c.rechecks) {
        let added = late_views
            .entity(camera.main)
            .and_then(|late| late_entities.get(late).ok())
            .and_then(|list| list.get::<Mesh3d>())
            .map_or(&[][..], |class| class.added_entities());
        for (_, entity) in added {
            let Ok(i) = camera
                .removed
                .binary_search_by_key(entity, |(e, _)| MainEntity::from(*e))
            else {
                continue;
            };
            let slot = camera.removed[i].1;
            match meshes.render_mesh_queue_data(*entity) {
                Some(mesh) => table.note_input(mesh.current_uniform_index.0, slot),
                None => unplaced.push((*entity, slot)),
            }
        }
    }
    table.flush(&device, &queue);

    views.0.values_mut().for_each(|view| view.live = false);
    for camera in &extracted.cameras {
        let Ok((view, extracted_camera, msaa, jitter, resolution)) = cameras.get(camera.render)
        else {
            continue;
        };
        let size = resolution.map_or(view.viewport.zw(), |to| to.0);
        let clip_from_world = drawn_clip_from_world(view, jitter, size);
        // A resolution scale may change every frame: blocks and memory are those of the whole viewport.
        let whole = extracted_camera
            .physical_viewport_size
            .map_or(size, |whole| whole.max(size));
        let sampling = camera.sampling.for_viewport(whole);
        let key = ReduceKey {
            block: sampling.block(size),
            strided: sampling.is_strided(),
            samples: msaa.samples(),
        };
        let Some(header) = reducible(clip_from_world, size, sampling, &device) else {
            continue;
        };
        let gpu = GpuOcclusionView::of_header(&header, view.viewport.xy());
        let texels = texel_count(&header.levels);
        let room = if whole == size {
            texels
        } else {
            room_for(whole, key.block)
        };
        let words = extracted.slots.div_ceil(32).max(1);
        let fits = views
            .0
            .get(&MainEntity::from(camera.main))
            .is_some_and(|v| v.key == key && v.room == room && v.words >= words);
        if !fits {
            views.0.insert(
                camera.main.into(),
                ViewOcclusion::new(&device, room, words * 3 / 2, key),
            );
        }
        let Some(to) = views.0.get_mut(&MainEntity::from(camera.main)) else {
            continue;
        };
        to.live = true;
        to.texels = texels;
        to.tests = camera.to_test.as_words().iter().any(|word| *word != 0);
        to.header = header;
        queue.write_buffer(&to.view, 0, bytemuck::bytes_of(&gpu));
        if to.tests {
            let words = bytemuck::cast_slice(camera.to_test.as_words());
            queue.write_buffer(&to.to_test, 0, words);
        }
        if draws_late(camera) {
            queue.write_buffer(&to.late, 0, bytemuck::bytes_of(&extracted.frame));
        }
        pipelines.queue(&cache, key, camera.rechecks || to.tests, camera.rechecks);
    }
    views.0.retain(|_, view| view.live);

    let mut stats = stats.lock();
    stats.bytes = table.bytes() + views.0.values().map(ViewOcclusion::bytes).sum::<u64>();
    stats.ready_to_recheck =
        pipelines.late_draws(&cache).is_some() && pipelines.verdicts(&cache).is_some();
}

/// How the depth of a viewport is reduced; `None` if it is larger than can be.
pub fn reducible(
    clip_from_world: Mat4,
    size: UVec2,
    sampling: DepthSampling,
    device: &RenderDevice,
) -> Option<ReducedDepth> {
    let header = ReducedDepth::header(clip_from_world, size, sampling);
    let bytes = 4 * texel_count(&header.levels) as u64;
    let most = device.limits().max_storage_buffer_binding_size;
    (bytes > 0 && bytes <= most).then_some(header)
}

/// The matrix that the camera's vertices go through, worked out as Bevy does.
fn drawn_clip_from_world(
    view: &ExtractedView,
    jitter: Option<&TemporalJitter>,
    size: UVec2,
) -> Mat4 {
    let mut clip_from_view = view.clip_from_view;
    let view_from_world = view.world_from_view.to_matrix().inverse();
    match (jitter, view.clip_from_world) {
        (Some(jitter), _) => {
            jitter.jitter_projection(&mut clip_from_view, size.as_vec2());
            clip_from_view * view_from_world
        }
        (None, Some(clip_from_world)) => clip_from_world,
        (None, None) => clip_from_view * view_from_world,
    }
}

/// The late draws of one phase and kind of mesh: their bind group, and how many instances there are.
pub struct LateDraws {
    pub group: BindGroup,
    pub instances: u32,
}

/// Late draws of every camera, by its entity in the main world.
#[derive(Resource, Default)]
pub struct LateDrawGroups(pub HashMap<Entity, Vec<LateDraws>>);

/// Binds what this frame's passes need.
#[expect(
    clippy::too_many_arguments,
    reason = "it binds all of the effect's passes"
)]
pub fn prepare_occlusion_bind_groups(
    extracted: Res<ExtractedOcclusion>,
    table: Res<GpuOccludees>,
    mut views: ResMut<OcclusionViews>,
    mut groups: ResMut<LateDrawGroups>,
    pipelines: Res<OcclusionPipelines>,
    depths: Query<&ViewDepthTexture>,
    batched: Option<Res<BatchedInstanceBuffers<MeshUniform, MeshInputUniform>>>,
    indirect: Option<Res<IndirectParametersBuffers>>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
) {
    groups.0.values_mut().for_each(Vec::clear);
    for camera in &extracted.cameras {
        let Some(view) = views.0.get_mut(&MainEntity::from(camera.main)) else {
            continue;
        };
        if let Ok(depth) = depths.get(camera.render) {
            let id = depth.view().id();
            if view.reduce_group.as_ref().is_none_or(|(of, _)| *of != id) {
                let layout = cache.get_bind_group_layout(pipelines.reduce_layout(view.key.samples));
                let (of, reduced) = (
                    view.view.as_entire_binding(),
                    view.reduced.as_entire_binding(),
                );
                let label = "skyline_depth_reduce";
                let group = if view.key.samples > 1 {
                    let entries = BindGroupEntries::sequential((of, reduced, depth.view()));
                    device.create_bind_group(label, &layout, &entries)
                } else {
                    let nearest = &pipelines.nearest;
                    let entries =
                        BindGroupEntries::sequential((of, reduced, depth.view(), nearest));
                    device.create_bind_group(label, &layout, &entries)
                };
                view.reduce_group = Some((id, group));
            }
        }
        if let (Some(occludees), Some(triangles)) =
            (table.occludees.buffer(), table.triangles.buffer())
        {
            let ids = [occludees.id(), triangles.id()];
            if view.verdict_group.as_ref().is_none_or(|(of, _)| *of != ids) {
                let group = device.create_bind_group(
                    "skyline_occludee_verdicts",
                    &cache.get_bind_group_layout(&pipelines.verdicts),
                    &BindGroupEntries::sequential((
                        view.view.as_entire_binding(),
                        view.reduced.as_entire_binding(),
                        triangles.as_entire_binding(),
                        occludees.as_entire_binding(),
                        view.hidden.as_entire_binding(),
                        view.to_test.as_entire_binding(),
                    )),
                );
                view.verdict_group = Some((ids, group));
            }
        }
        if !draws_late(camera) {
            continue;
        }
        let (Some(batched), Some(indirect), Some(slots)) =
            (&batched, &indirect, table.slot_of_input.buffer())
        else {
            continue;
        };
        DrawBindings {
            label: "skyline_late_draws",
            slots,
            left_out: &view.hidden,
            frame: &view.late,
            batched,
            indirect,
            layout: &pipelines.late_draws,
            cache: &cache,
            device: &device,
        }
        .bind(
            late_view_of(camera.main),
            groups.0.entry(camera.main).or_default(),
        );
    }
    groups.0.retain(|_, groups| !groups.is_empty());
}

/// What `late_draws.wgsl` is bound to for a view.
pub struct DrawBindings<'a> {
    pub label: &'static str,
    /// By index in Bevy's buffer of mesh inputs: the slot.
    pub slots: &'a Buffer,
    /// A bit each slot: is left out.
    pub left_out: &'a Buffer,
    /// Number of the frame.
    pub frame: &'a Buffer,
    pub batched: &'a BatchedInstanceBuffers<MeshUniform, MeshInputUniform>,
    pub indirect: &'a IndirectParametersBuffers,
    pub layout: &'a BindGroupLayoutDescriptor,
    pub cache: &'a PipelineCache,
    pub device: &'a RenderDevice,
}

impl DrawBindings<'_> {
    /// A bind group for each phase and kind of mesh that the view draws.
    pub fn bind(&self, view: RetainedViewEntity, to: &mut Vec<LateDraws>) {
        let Self {
            batched, indirect, ..
        } = self;
        let (Some(current), Some(previous)) = (
            batched.current_input_buffer.buffer().buffer(),
            batched.previous_input_buffer.buffer(),
        ) else {
            return;
        };
        for (phase, buffers) in &batched.phase_instance_buffers {
            let (Some(output), Some(draws), Some(work)) = (
                buffers.data_buffer.buffer(),
                indirect.get(phase),
                buffers.work_item_buffers.get(&view),
            ) else {
                continue;
            };
            let PreprocessWorkItemBuffers::Indirect {
                indexed,
                non_indexed,
                ..
            } = work
            else {
                continue;
            };
            let kinds = [
                (
                    indexed,
                    draws.indexed.cpu_metadata_buffer(),
                    draws.indexed.gpu_metadata_buffer(),
                ),
                (
                    non_indexed,
                    draws.non_indexed.cpu_metadata_buffer(),
                    draws.non_indexed.gpu_metadata_buffer(),
                ),
            ];
            for (work, cpu_metadata, gpu_metadata) in kinds {
                let (Some(work_buffer), Some(cpu_metadata), Some(gpu_metadata)) =
                    (work.buffer(), cpu_metadata, gpu_metadata)
                else {
                    continue;
                };
                // The shader goes by the binding's length; the buffer may be longer.
                let bytes = (work.len() * size_of::<PreprocessWorkItem>()) as u64;
                let Some(size) = NonZero::new(bytes) else {
                    continue;
                };
                let group = self.device.create_bind_group(
                    self.label,
                    &self.cache.get_bind_group_layout(self.layout),
                    &BindGroupEntries::sequential((
                        self.slots.as_entire_binding(),
                        self.left_out.as_entire_binding(),
                        self.frame.as_entire_binding(),
                        current.as_entire_binding(),
                        previous.as_entire_binding(),
                        BindingResource::Buffer(BufferBinding {
                            buffer: work_buffer,
                            offset: 0,
                            size: Some(size),
                        }),
                        output.as_entire_binding(),
                        cpu_metadata.as_entire_binding(),
                        gpu_metadata.as_entire_binding(),
                    )),
                );
                to.push(LateDraws {
                    group,
                    instances: work.len() as u32,
                });
            }
        }
    }
}
