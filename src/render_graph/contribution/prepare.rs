//! Uploads what changed, gives each camera its memory, binds it.

use core::sync::atomic::Ordering;

use bevy::{
    asset::AssetServer,
    pbr::{MeshInputUniform, MeshUniform, RenderMeshInstances},
    platform::collections::HashMap,
    prelude::*,
    render::{
        batching::gpu_preprocessing::{BatchedInstanceBuffers, IndirectParametersBuffers},
        render_resource::*,
        renderer::{RenderDevice, RenderQueue},
        sync_world::MainEntity,
        view::{ExtractedView, RenderVisibleEntities},
    },
};

use super::{
    super::{
        occludee_verdicts::GpuOccludee,
        occlusion::{
            buffers::{GpuTable, StagingRing, copy_words, storage},
            pipelines::late_draws_layout,
            prepare::{DrawBindings, LateDraws},
        },
        shaders,
    },
    ContributionStats, GpuAreaView,
    extract::{ExtractedContribution, ExtractedContributionCamera},
    layout, pipeline,
};
use crate::{culling::candidates::NO_SLOT, occlusion::camera::Returned};

/// The table of candidates on the GPU, shared by all cameras. Empty while the GPU measures for none.
#[derive(Resource)]
pub struct GpuCandidates {
    candidates: GpuTable<GpuOccludee>,
    /// By index in Bevy's buffer of mesh inputs: the slot.
    slot_of_input: GpuTable<u32>,
    slot_of_entity: HashMap<MainEntity, u32>,
    entity_of_slot: Vec<Option<MainEntity>>,
    /// Entities whose mesh inputs are to be noted.
    unplaced: Vec<MainEntity>,
    epoch: u32,
}

impl Default for GpuCandidates {
    fn default() -> Self {
        Self {
            candidates: GpuTable::new("skyline_candidates"),
            slot_of_input: GpuTable::new("skyline_slot_of_mesh_input"),
            slot_of_entity: HashMap::default(),
            entity_of_slot: Vec::new(),
            unplaced: Vec::new(),
            epoch: 0,
        }
    }
}

impl GpuCandidates {
    /// Whether the whole table has to come again.
    pub fn wants_all(&self, epoch: u32) -> bool {
        self.candidates.is_empty() || self.epoch != epoch
    }

    fn bytes(&self) -> u64 {
        self.candidates.bytes() + self.slot_of_input.bytes()
    }

    /// Follows the main world's table.
    fn update(&mut self, extracted: &ExtractedContribution) {
        if extracted.all {
            *self = Self {
                epoch: extracted.epoch,
                ..default()
            };
        }
        for (slot, of) in &extracted.changed {
            let i = *slot as usize;
            if self.entity_of_slot.len() <= i {
                self.entity_of_slot.resize(i + 1, None);
            }
            let new = of.as_ref().map(|of| MainEntity::from(of.entity));
            let old = core::mem::replace(&mut self.entity_of_slot[i], new);
            if old != new {
                if let Some(old) = old
                    && self.slot_of_entity.get(&old) == Some(slot)
                {
                    self.slot_of_entity.remove(&old);
                    self.unplaced.push(old);
                }
                if let Some(new) = new {
                    self.slot_of_entity.insert(new, *slot);
                    self.unplaced.push(new);
                }
            }
            let gpu = of.as_ref().map_or_else(GpuOccludee::default, |of| {
                GpuOccludee::new(&of.world_from_local, &of.volume, None, 0..0)
            });
            self.candidates.set(*slot, gpu, GpuOccludee::default());
        }
    }

    /// Notes which slot each unplaced entity's mesh input is; keeps those that have none yet and are in `view`.
    fn place(&mut self, meshes: &RenderMeshInstances, in_view: impl Fn(MainEntity) -> bool) {
        let Self {
            slot_of_input,
            slot_of_entity,
            unplaced,
            ..
        } = self;
        unplaced.retain(|entity| match meshes.render_mesh_queue_data(*entity) {
            Some(mesh) => {
                let slot = slot_of_entity.get(entity).copied().unwrap_or(NO_SLOT);
                slot_of_input.set(mesh.current_uniform_index.0, slot, NO_SLOT);
                false
            }
            None => in_view(*entity),
        });
    }
}

/// What one camera has on the GPU.
pub struct ViewContribution {
    view: Buffer,
    asked: Buffer,
    fresh: Buffer,
    /// A bit each slot: too small.
    small: Buffer,
    frame: Buffer,
    words: usize,
    /// Whether this frame uses it.
    live: bool,
    pub(super) group: Option<(BufferId, BindGroup)>,
    pub(super) draws: Vec<LateDraws>,
    staging: StagingRing,
}

/// What each camera has, by its entity in the main world.
#[derive(Resource, Default)]
pub struct ContributionViews(pub HashMap<MainEntity, ViewContribution>);

impl ViewContribution {
    fn new(device: &RenderDevice, words: usize) -> Self {
        let bits = |label| storage(device, label, 4 * words);
        Self {
            view: storage(
                device,
                "skyline_contribution_view",
                size_of::<GpuAreaView>(),
            ),
            asked: bits("skyline_contribution_asked"),
            fresh: bits("skyline_contribution_fresh"),
            small: bits("skyline_contribution_small"),
            frame: storage(device, "skyline_contribution_frame", 4),
            words,
            live: false,
            group: None,
            draws: Vec::new(),
            staging: StagingRing::new("skyline_contribution_staging"),
        }
    }

    fn bytes(&self) -> u64 {
        3 * self.small.size() + self.view.size() + self.frame.size() + self.staging.bytes()
    }

    /// Sends this frame's verdicts on their way to the camera. Never waits: if all buffers are under way, this frame's
    /// are not sent.
    pub(super) fn send(
        &mut self,
        device: &RenderDevice,
        encoder: &mut CommandEncoder,
        camera: &ExtractedContributionCamera,
        frame: u32,
        epoch: u32,
    ) {
        let bytes = 4 * camera.asked.as_words().len() as u64;
        if bytes == 0 {
            return;
        }
        let Some((buffer, busy)) = self.staging.take(device, bytes) else {
            return;
        };
        encoder.copy_buffer_to_buffer(&self.small, 0, &buffer, 0, bytes);
        let mut returned = camera.mailbox.blank();
        let Returned {
            tested,
            frame: of_frame,
            epoch: of_epoch,
            ..
        } = &mut returned;
        tested.clone_from(&camera.asked);
        (*of_frame, *of_epoch) = (frame, epoch);
        let (mailbox, staging) = (camera.mailbox.clone(), buffer.clone());
        encoder.map_buffer_on_submit(&buffer, MapMode::Read, ..bytes, move |result| {
            if result.is_ok() {
                copy_words(
                    returned.hidden.words_mut(),
                    &staging.slice(..bytes).get_mapped_range(),
                );
                staging.unmap();
                mailbox.post(returned);
            } else {
                mailbox.recycle(returned);
            }
            busy.store(false, Ordering::Release);
        });
    }
}

/// Layouts, and the pipelines queued so far.
#[derive(Resource)]
pub struct ContributionPipelines {
    assets: AssetServer,
    layout: BindGroupLayoutDescriptor,
    draws: BindGroupLayoutDescriptor,
    queued: Option<[CachedComputePipelineId; 3]>,
}

/// Makes the layouts; runs again after the device was lost.
pub fn init_contribution_pipelines(
    mut commands: Commands,
    assets: Res<AssetServer>,
    stats: Res<ContributionStats>,
) {
    stats.lock().ready = false;
    commands.insert_resource(ContributionPipelines {
        assets: assets.clone(),
        layout: layout(),
        draws: late_draws_layout("skyline_contribution_draws"),
        queued: None,
    });
}

impl ContributionPipelines {
    fn queue(&mut self, cache: &PipelineCache) {
        if self.queued.is_some() {
            return;
        }
        let draws = |entry: &'static str| {
            cache.queue_compute_pipeline(ComputePipelineDescriptor {
                label: Some(entry.into()),
                layout: vec![self.draws.clone()],
                shader: shaders::culling::late_draws(&self.assets),
                shader_defs: vec!["WRITE_INDIRECT_PARAMETERS_METADATA".into()],
                entry_point: Some(entry.into()),
                ..default()
            })
        };
        self.queued = Some([
            cache.queue_compute_pipeline(pipeline(&self.assets)),
            draws("forget_draws"),
            draws("late_draws"),
        ]);
    }

    /// `contribution`, `forget_draws` and `late_draws`, once all are compiled.
    pub(super) fn all<'a>(&self, cache: &'a PipelineCache) -> Option<[&'a ComputePipeline; 3]> {
        let [a, b, c] = self.queued?.map(|id| cache.get_compute_pipeline(id));
        Some([a?, b?, c?])
    }
}

/// Uploads the table and this frame's views.
#[expect(
    clippy::too_many_arguments,
    reason = "it fills all of the effect's memory"
)]
pub fn prepare_contribution(
    extracted: Res<ExtractedContribution>,
    mut table: ResMut<GpuCandidates>,
    mut views: ResMut<ContributionViews>,
    mut pipelines: ResMut<ContributionPipelines>,
    lists: Query<&RenderVisibleEntities>,
    meshes: Res<RenderMeshInstances>,
    cache: Res<PipelineCache>,
    stats: Res<ContributionStats>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    pipelines.queue(&cache);
    stats.lock().ready = pipelines.all(&cache).is_some();
    if extracted.cameras.is_empty() {
        *table = GpuCandidates::default();
        views.0.clear();
        stats.lock().bytes = 0;
        return;
    }
    table.update(&extracted);

    views.0.values_mut().for_each(|view| view.live = false);
    let words = extracted.slots.div_ceil(32).max(1);
    let list_of = |camera: &ExtractedContributionCamera| {
        let list = lists.get(camera.render).ok()?;
        list.get::<Mesh3d>()
    };
    for camera in &extracted.cameras {
        let key = MainEntity::from(camera.main);
        let known = views.0.contains_key(&key);
        // Mesh inputs of what came into view, be they candidates or not: an input may have been another's.
        if let Some(list) = list_of(camera) {
            if known && !extracted.all {
                let added = list.added_entities().iter();
                table.unplaced.extend(added.map(|(_, entity)| *entity));
            } else {
                let all = list.iter_visible();
                table.unplaced.extend(all.map(|(_, entity)| *entity));
            }
        }
        let small = camera.removed.as_words();
        if views.0.get(&key).is_none_or(|view| view.words < words) {
            let view = ViewContribution::new(&device, words * 3 / 2);
            // What the CPU last knew.
            let known = &small[..small.len().min(words)];
            if !known.is_empty() {
                queue.write_buffer(&view.small, 0, bytemuck::cast_slice(known));
            }
            views.0.insert(key, view);
        }
        let Some(to) = views.0.get_mut(&key) else {
            continue;
        };
        to.live = true;
        let gpu = GpuAreaView::new(&camera.view, camera.thresholds, extracted.any_fresh);
        queue.write_buffer(&to.view, 0, bytemuck::bytes_of(&gpu));
        queue.write_buffer(&to.frame, 0, bytemuck::bytes_of(&extracted.frame));
        queue.write_buffer(&to.asked, 0, bytemuck::cast_slice(camera.asked.as_words()));
        if extracted.any_fresh {
            let fresh = bytemuck::cast_slice(extracted.fresh.as_words());
            queue.write_buffer(&to.fresh, 0, fresh);
        }
    }
    views.0.retain(|_, view| view.live);
    table.place(&meshes, |entity| {
        extracted.cameras.iter().any(|camera| {
            list_of(camera).is_some_and(|list| {
                list.entities_cpu_culling
                    .binary_search_by_key(&entity, |(_, main)| *main)
                    .is_ok()
            })
        })
    });
    table.candidates.flush(&device, &queue);
    table.slot_of_input.flush(&device, &queue);
    stats.lock().bytes = table.bytes() + views.0.values().map(ViewContribution::bytes).sum::<u64>();
}

/// Binds what this frame's pass needs.
#[expect(
    clippy::too_many_arguments,
    reason = "it binds all of the effect's memory"
)]
pub fn prepare_contribution_bind_groups(
    extracted: Res<ExtractedContribution>,
    table: Res<GpuCandidates>,
    mut views: ResMut<ContributionViews>,
    pipelines: Res<ContributionPipelines>,
    cameras: Query<&ExtractedView>,
    batched: Option<Res<BatchedInstanceBuffers<MeshUniform, MeshInputUniform>>>,
    indirect: Option<Res<IndirectParametersBuffers>>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
) {
    let (Some(batched), Some(indirect), Some(candidates), Some(slots)) = (
        &batched,
        &indirect,
        table.candidates.buffer(),
        table.slot_of_input.buffer(),
    ) else {
        return;
    };
    for camera in &extracted.cameras {
        let (Some(of), Ok(view)) = (
            views.0.get_mut(&MainEntity::from(camera.main)),
            cameras.get(camera.render),
        ) else {
            continue;
        };
        if of
            .group
            .as_ref()
            .is_none_or(|(id, _)| *id != candidates.id())
        {
            let group = device.create_bind_group(
                "skyline_contribution",
                &cache.get_bind_group_layout(&pipelines.layout),
                &BindGroupEntries::sequential((
                    of.view.as_entire_binding(),
                    candidates.as_entire_binding(),
                    of.asked.as_entire_binding(),
                    of.fresh.as_entire_binding(),
                    of.small.as_entire_binding(),
                )),
            );
            of.group = Some((candidates.id(), group));
        }
        of.draws.clear();
        DrawBindings {
            label: "skyline_contribution_draws",
            slots,
            left_out: &of.small,
            frame: &of.frame,
            batched,
            indirect,
            layout: &pipelines.draws,
            cache: &cache,
            device: &device,
        }
        .bind(view.retained_view_entity, &mut of.draws);
    }
}
