//! Render-world side of Z-buffer occlusion culling (P2): reduce the depth, test what was removed against it, draw
//! what turns out visible, send depth and verdicts back.
//!
//! The data path, in order: `extract` → [`late_view`] → [`buffers`], filled by [`prepare`] → `passes`, with
//! the shaders of `pipelines`.

pub mod buffers;
pub(crate) mod extract;
pub mod late_view;
pub(crate) mod passes;
pub(crate) mod pipelines;
pub mod prepare;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bevy::{
    core_pipeline::{
        core_3d::{main_opaque_pass_3d, main_transparent_pass_3d},
        deferred::node::late_deferred_prepass,
        prepass::node::late_prepass,
        schedule::{Core3d, Core3dSystems},
    },
    pbr::{
        LATE_SHADOW_PASS, MeshPipelineSystems, check_prepass_views_need_specialization,
        check_views_need_specialization, main_build_indirect_parameters, main_transmissive_pass_3d,
        per_view_shadow_pass, shared_shadow_pass, unpack_bins,
    },
    prelude::*,
    render::{
        ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems,
        batching::gpu_preprocessing::GpuPreprocessingSupport,
        render_resource::DownlevelFlags,
        renderer::{RenderAdapter, RenderDevice},
        view::collect_visible_cpu_culled_entities,
    },
};

use super::{
    TerrainShadeSystems,
    called::{self, ask, is_called_for},
    order::{before_all, over_opaque},
};
use crate::occlusion::ZBufferOcclusion;
use buffers::{GpuOccludees, OcclusionViews};
use extract::{ExtractedOcclusion, extract_occlusion};
use late_view::{
    LateViews, UnpackLateBins, forget_late_views, keep_late_phases, prepare_late_views,
};
use passes::{
    WithPrepass, WithoutPrepass, build_late_main, build_late_prepass, late_opaque,
    late_view_deferred, late_view_prepass, recheck,
};
use pipelines::init_occlusion_pipelines;
use prepare::{
    LateDrawGroups, make_depth_readable, prepare_occlusion, prepare_occlusion_bind_groups,
};

/// What the render world tells the main world, beside what comes back from the GPU.
#[derive(Resource, Clone, Default)]
pub struct OcclusionStats(Arc<Mutex<OcclusionWork>>);

/// See [`OcclusionStats`].
#[derive(Clone, Debug, Default)]
pub struct OcclusionWork {
    /// Why culling cannot run here.
    pub unsupported: Option<String>,
    /// Why removed entities cannot be tested again in the same frame here.
    pub no_recheck: Option<String>,
    /// Whether the recheck's shaders are compiled; before, nothing is removed that would need it.
    pub ready_to_recheck: bool,
    /// GPU memory held. units: bytes
    pub bytes: u64,
    /// Times that depth was reduced.
    pub reduced: u64,
    /// Times that occludees were tested on the GPU.
    pub tested: u64,
    /// Times that late draws were made ready.
    pub late: u64,
}

impl OcclusionStats {
    /// Looks or changes.
    pub fn lock(&self) -> MutexGuard<'_, OcclusionWork> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Adds the passes to the render app, or says in [`OcclusionStats`] why it cannot.
pub(crate) fn add_occlusion_passes(app: &mut App) {
    let stats = app.world().resource::<OcclusionStats>().clone();
    let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
        stats.lock().unsupported = Some("the app renders nothing: it has no RenderPlugin".into());
        return;
    };
    if let Err(reason) = check_capabilities(render_app.world()) {
        warn!("nothing is removed by the depth buffer: {reason}");
        stats.lock().unsupported = Some(reason);
        return;
    }
    stats.lock().no_recheck = lacks_for_recheck(render_app.world());
    let over_opaque = over_opaque(render_app);
    called::init::<ZBufferOcclusion>(render_app);
    render_app
        .insert_resource(stats)
        .init_resource::<ExtractedOcclusion>()
        .init_gpu_resource::<GpuOccludees>()
        .init_gpu_resource::<OcclusionViews>()
        .init_gpu_resource::<LateDrawGroups>()
        .init_resource::<LateViews>()
        .add_systems(
            RenderStartup,
            (
                init_occlusion_pipelines.after(MeshPipelineSystems),
                forget_late_views,
            ),
        )
        .add_systems(
            ExtractSchedule,
            (
                ask::<ZBufferOcclusion>,
                extract_occlusion.run_if(is_called_for::<ZBufferOcclusion>),
            )
                .chain(),
        )
        .add_systems(
            Render,
            (
                prepare_late_views
                    .in_set(RenderSystems::PrepareAssets)
                    // It hands on the camera's keys.
                    .after(check_views_need_specialization)
                    .after(check_prepass_views_need_specialization)
                    // Which finds what came into view of the late view, as of any.
                    .before(collect_visible_cpu_culled_entities),
                make_depth_readable.in_set(RenderSystems::PrepareViews),
                prepare_occlusion.in_set(RenderSystems::PrepareResources),
                prepare_occlusion_bind_groups.in_set(RenderSystems::PrepareBindGroups),
                keep_late_phases.in_set(RenderSystems::Cleanup),
            )
                .run_if(any_camera),
        )
        .init_schedule(UnpackLateBins)
        .add_systems(UnpackLateBins, unpack_bins)
        .add_systems(
            Core3d,
            (
                (
                    recheck::<WithPrepass>,
                    build_late_prepass,
                    late_view_prepass,
                    late_view_deferred,
                )
                    .chain()
                    // All that a prepass draws early is in the depth, terrain included.
                    .after(late_prepass)
                    // Draw commands of the lights' late passes are not to be rebuilt before they are used.
                    .after(per_view_shadow_pass::<LATE_SHADOW_PASS>)
                    .after(shared_shadow_pass::<LATE_SHADOW_PASS>)
                    // Copies of what the deferred prepass wrote are made after this one.
                    .before(late_deferred_prepass)
                    .before(main_build_indirect_parameters)
                    .in_set(Core3dSystems::Prepass),
                before_all(
                    (recheck::<WithoutPrepass>, build_late_main, late_opaque)
                        .chain()
                        // All that is drawn early is in the depth.
                        .after(main_opaque_pass_3d)
                        // Pixels that they cover are not lit as terrain.
                        .before(TerrainShadeSystems)
                        // Transparency blends over them, glass shows them.
                        .before(main_transmissive_pass_3d)
                        .before(main_transparent_pass_3d)
                        .in_set(Core3dSystems::MainPass),
                    // Air lies before them.
                    &over_opaque,
                ),
            )
                .run_if(any_camera),
        );
}

/// Whether a camera's depth is read this frame, or memory of earlier frames is still held.
fn any_camera(
    extracted: Res<ExtractedOcclusion>,
    table: Res<GpuOccludees>,
    late_views: Res<LateViews>,
) -> bool {
    !extracted.cameras.is_empty() || !table.is_empty() || !late_views.is_empty()
}

/// What reading the depth needs of the GPU; the reason names what is missing.
fn check_capabilities(world: &World) -> Result<(), String> {
    let (Some(device), Some(adapter)) = (
        world.get_resource::<RenderDevice>(),
        world.get_resource::<RenderAdapter>(),
    ) else {
        return Err("no GPU was found: install a Vulkan, Metal or DirectX 12 driver".into());
    };
    let flags = adapter.get_downlevel_capabilities().flags;
    if !flags.contains(DownlevelFlags::COMPUTE_SHADERS) {
        return Err(
            "this GPU's driver has no compute shaders: use Vulkan, Metal or DirectX 12 instead of GL"
                .into(),
        );
    }
    let buffers = device.limits().max_storage_buffers_per_shader_stage;
    if buffers < 6 {
        return Err(format!(
            "this GPU's max_storage_buffers_per_shader_stage is {buffers}, and occlusion culling needs 6"
        ));
    }
    Ok(())
}

/// What drawing late needs beyond that.
fn lacks_for_recheck(world: &World) -> Option<String> {
    (!can_rewrite_draws(world)).then(|| {
        "this GPU cannot draw what it finds visible without the CPU (indirect drawing with GPU culling), so nothing \
         is removed; `Recheck::Never` removes all the same and shows what comes into view some frames late"
            .into()
    })
}

/// Whether `late_draws.wgsl` can run here.
pub fn can_rewrite_draws(world: &World) -> bool {
    let culls = world
        .get_resource::<GpuPreprocessingSupport>()
        .is_some_and(GpuPreprocessingSupport::is_culling_supported);
    let buffers = world.get_resource::<RenderDevice>().map_or(0, |device| {
        device.limits().max_storage_buffers_per_shader_stage
    });
    culls && buffers >= 9
}
