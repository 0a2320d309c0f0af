//! Bind group layouts and pipelines of occlusion culling. A pipeline is queued when a camera first needs it.

use bevy::{
    asset::AssetServer,
    platform::collections::HashMap,
    prelude::*,
    render::render_resource::{
        binding_types::{
            sampler, storage_buffer_read_only_sized, storage_buffer_sized, texture_depth_2d,
            texture_depth_2d_multisampled,
        },
        *,
    },
    render::renderer::RenderDevice,
    shader::ShaderDefVal,
};

use super::{
    super::{occludee_verdicts, shaders},
    OcclusionStats,
    buffers::ReduceKey,
};

/// Layouts, and the pipelines queued so far.
#[derive(Resource)]
pub struct OcclusionPipelines {
    assets: AssetServer,
    pub reduce: BindGroupLayoutDescriptor,
    pub reduce_multisampled: BindGroupLayoutDescriptor,
    pub verdicts: BindGroupLayoutDescriptor,
    pub late_draws: BindGroupLayoutDescriptor,
    pub nearest: Sampler,
    queued_reduce: HashMap<ReduceKey, [CachedComputePipelineId; 2]>,
    queued_verdicts: Option<CachedComputePipelineId>,
    queued_late_draws: Option<CachedComputePipelineId>,
}

/// Makes the layouts; runs again after the device was lost.
pub fn init_occlusion_pipelines(
    mut commands: Commands,
    assets: Res<AssetServer>,
    device: Res<RenderDevice>,
    stats: Res<OcclusionStats>,
) {
    stats.lock().ready_to_recheck = false;
    let read = || storage_buffer_read_only_sized(false, None);
    let write = || storage_buffer_sized(false, None);
    let compute = ShaderStages::COMPUTE;
    commands.insert_resource(OcclusionPipelines {
        assets: assets.clone(),
        reduce: BindGroupLayoutDescriptor::new(
            "skyline_depth_reduce",
            &BindGroupLayoutEntries::sequential(
                compute,
                (
                    read(),
                    write(),
                    texture_depth_2d(),
                    sampler(SamplerBindingType::NonFiltering),
                ),
            ),
        ),
        reduce_multisampled: BindGroupLayoutDescriptor::new(
            "skyline_depth_reduce_multisampled",
            &BindGroupLayoutEntries::sequential(
                compute,
                (read(), write(), texture_depth_2d_multisampled()),
            ),
        ),
        verdicts: occludee_verdicts::selected_layout(),
        late_draws: late_draws_layout("skyline_late_draws"),
        nearest: device.create_sampler(&SamplerDescriptor {
            label: Some("skyline_depth_reduce"),
            ..default()
        }),
        queued_reduce: HashMap::default(),
        queued_verdicts: None,
        queued_late_draws: None,
    });
}

/// What `late_draws.wgsl` is bound to.
pub fn late_draws_layout(label: &'static str) -> BindGroupLayoutDescriptor {
    let read = || storage_buffer_read_only_sized(false, None);
    let write = || storage_buffer_sized(false, None);
    BindGroupLayoutDescriptor::new(
        label,
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                read(),
                read(),
                read(),
                read(),
                read(),
                read(),
                write(),
                read(),
                write(),
            ),
        ),
    )
}

impl OcclusionPipelines {
    /// Layout of `depth_reduce` for so many samples a pixel.
    pub fn reduce_layout(&self, samples: u32) -> &BindGroupLayoutDescriptor {
        if samples > 1 {
            &self.reduce_multisampled
        } else {
            &self.reduce
        }
    }

    /// Queues what a camera needs and what is not queued yet.
    pub fn queue(&mut self, cache: &PipelineCache, key: ReduceKey, tests: bool, late: bool) {
        if !self.queued_reduce.contains_key(&key) {
            let mut defs: Vec<ShaderDefVal> = vec![
                ShaderDefVal::UInt("BLOCK_X".into(), key.block.x),
                ShaderDefVal::UInt("BLOCK_Y".into(), key.block.y),
            ];
            if key.strided {
                defs.push("STRIDED".into());
            } else if key.block == UVec2::ONE {
                defs.push("PIXELS".into());
            } else if key.block % 2 == UVec2::ZERO {
                defs.push("EVEN_BLOCK".into());
            }
            if key.samples > 1 {
                defs.push("MULTISAMPLED".into());
                defs.push(ShaderDefVal::UInt("SAMPLES".into(), key.samples));
            }
            let ids = ["depth_reduce", "depth_reduce_rest"].map(|entry| {
                cache.queue_compute_pipeline(ComputePipelineDescriptor {
                    label: Some(entry.into()),
                    layout: vec![self.reduce_layout(key.samples).clone()],
                    shader: shaders::culling::depth_reduce(&self.assets),
                    shader_defs: defs.clone(),
                    entry_point: Some(entry.into()),
                    ..default()
                })
            });
            self.queued_reduce.insert(key, ids);
        }
        if tests && self.queued_verdicts.is_none() {
            let descriptor = occludee_verdicts::selected_pipeline(&self.assets);
            self.queued_verdicts = Some(cache.queue_compute_pipeline(descriptor));
        }
        if late && self.queued_late_draws.is_none() {
            self.queued_late_draws =
                Some(cache.queue_compute_pipeline(ComputePipelineDescriptor {
                    label: Some("late_draws".into()),
                    layout: vec![self.late_draws.clone()],
                    shader: shaders::culling::late_draws(&self.assets),
                    shader_defs: vec!["WRITE_INDIRECT_PARAMETERS_METADATA".into()],
                    entry_point: Some("late_draws".into()),
                    ..default()
                }));
        }
    }

    /// The two pipelines of `depth_reduce`, once compiled.
    pub fn reduce<'a>(
        &self,
        cache: &'a PipelineCache,
        key: ReduceKey,
    ) -> Option<[&'a ComputePipeline; 2]> {
        let [first, rest] = *self.queued_reduce.get(&key)?;
        Some([
            cache.get_compute_pipeline(first)?,
            cache.get_compute_pipeline(rest)?,
        ])
    }

    /// The pipeline of `occludee_verdicts`, once compiled.
    pub fn verdicts<'a>(&self, cache: &'a PipelineCache) -> Option<&'a ComputePipeline> {
        cache.get_compute_pipeline(self.queued_verdicts?)
    }

    /// The pipeline of `late_draws`, once compiled.
    pub fn late_draws<'a>(&self, cache: &'a PipelineCache) -> Option<&'a ComputePipeline> {
        cache.get_compute_pipeline(self.queued_late_draws?)
    }
}
