//! `contribution`: which candidates in view cover too little, found on the GPU, and taken out of the camera's draws in
//! the same frame (P4, for scenes so large that the CPU would be long at it).
//!
//! The data path, in order: `extract` → `prepare` → `pass`, with the shaders `contribution.wgsl` and
//! `late_draws.wgsl`.
//!
//! # Inputs / outputs
//! [`pipeline`]'s bind group, all storage buffers: [`GpuAreaView`]; [`GpuOccludee`](super::occludee_verdicts::GpuOccludee)s,
//! of which only the box is read; a bit each slot: in view; a bit each slot: another entity's than in the last frame; a
//! bit each slot: too small, kept from frame to frame. Then each mesh instance of the camera's own draws whose slot is
//! not too small is written again, as Bevy's preprocessing writes it.
//!
//! # Limits
//! A dispatch has at most 65,535 workgroups, that is 4,194,240 slots; what is beyond is drawn. Bevy's own culling on the
//! GPU by frustum is not repeated: all that is in a camera's `VisibleEntities` is in its frustum.
//!
//! # Reference
//! P4, steps 3 to 5.

pub(crate) mod extract;
pub(crate) mod pass;
pub(crate) mod prepare;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bevy::{
    asset::AssetServer,
    core_pipeline::schedule::Core3d,
    pbr::{early_gpu_preprocess, early_prepass_build_indirect_parameters},
    prelude::*,
    render::{
        ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems,
        camera::DirtySpecializationSystems,
        render_resource::{
            binding_types::{storage_buffer_read_only_sized, storage_buffer_sized},
            *,
        },
    },
};
use bytemuck::{Pod, Zeroable};

use super::{
    called::{self, ask, is_called_for},
    occlusion::can_rewrite_draws,
    shaders,
};
use crate::contribution::{ContributionCamera, area::AreaView};
use extract::{ExtractedContribution, extract_contribution, respecialize_dithered};
use pass::contribution;
use prepare::{
    ContributionViews, GpuCandidates, init_contribution_pipelines, prepare_contribution,
    prepare_contribution_bind_groups,
};

/// Slots of a workgroup, as in `contribution.wgsl`.
pub const SLOTS_PER_GROUP: u32 = 64;

/// What the render world tells the main world, beside the verdicts, and the other way round.
#[derive(Resource, Clone, Default)]
pub struct ContributionStats(Arc<Mutex<ContributionWork>>);

/// See [`ContributionStats`].
#[derive(Clone, Debug, Default)]
pub struct ContributionWork {
    /// Why the GPU cannot measure here.
    pub unsupported: Option<String>,
    /// Whether a camera would have the GPU measure.
    pub wanted: bool,
    /// Whether its shaders are compiled.
    pub ready: bool,
    /// GPU memory held. units: bytes
    pub bytes: u64,
    /// Times that areas were measured on the GPU.
    pub measured: u64,
    /// Times that a camera's draws were rewritten.
    pub rewritten: u64,
}

impl ContributionStats {
    /// Looks or changes.
    pub fn lock(&self) -> MutexGuard<'_, ContributionWork> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ContributionWork {
    /// Whether the GPU can measure from this frame on; its shaders are compiled once that was asked.
    pub(crate) fn is_ready(&mut self) -> bool {
        self.wanted = true;
        self.ready && self.unsupported.is_none()
    }
}

/// Mirrors `AreaView` in `contribution_area.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct GpuAreaView {
    /// Clip space from world space.
    pub clip_from_world: [[f32; 4]; 4],
    /// units: px
    pub viewport: [f32; 2],
    /// What covers less leaves. units: px²
    pub leaves: f32,
    /// What has left comes back from here on. units: px²
    pub comes_back: f32,
    /// Whether any slot is another entity's than in the last frame.
    pub any_fresh: u32,
    /// 0.
    pub pad: [u32; 3],
}

impl GpuAreaView {
    /// Of a view. Areas are finite on the GPU, so thresholds are kept finite, too.
    pub fn new(view: &AreaView, (leaves, comes_back): (f32, f32), any_fresh: bool) -> Self {
        Self {
            clip_from_world: view.clip_from_world().to_cols_array_2d(),
            viewport: view.viewport().to_array(),
            leaves: leaves.min(f32::MAX),
            comes_back: comes_back.min(f32::MAX),
            any_fresh: any_fresh.into(),
            pad: [0; 3],
        }
    }
}

/// The pass's bind group: view, candidates, bits of those in view, bits of those that are new, bits of those too small.
pub fn layout() -> BindGroupLayoutDescriptor {
    let read = || storage_buffer_read_only_sized(false, None);
    BindGroupLayoutDescriptor::new(
        "skyline_contribution",
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                read(),
                read(),
                read(),
                read(),
                storage_buffer_sized(false, None),
            ),
        ),
    )
}

/// The bind group of the pass that writes areas instead: view, candidates, an area each.
pub fn areas_layout() -> BindGroupLayoutDescriptor {
    let read = || storage_buffer_read_only_sized(false, None);
    BindGroupLayoutDescriptor::new(
        "skyline_contribution_areas",
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (read(), read(), storage_buffer_sized(false, None)),
        ),
    )
}

/// The pass's pipeline, to be queued in the app's cache.
pub fn pipeline(assets: &AssetServer) -> ComputePipelineDescriptor {
    ComputePipelineDescriptor {
        label: Some("contribution".into()),
        layout: vec![layout()],
        shader: shaders::culling::contribution(assets),
        entry_point: Some("contribution".into()),
        ..default()
    }
}

/// The pipeline that writes areas instead of verdicts: what areas are compared with the CPU's by.
pub fn areas_pipeline(assets: &AssetServer) -> ComputePipelineDescriptor {
    ComputePipelineDescriptor {
        layout: vec![areas_layout()],
        shader_defs: vec!["AREAS".into()],
        ..pipeline(assets)
    }
}

/// Adds the pass to the render app, or says in [`ContributionStats`] why it cannot.
pub(crate) fn add_contribution_passes(app: &mut App) {
    let stats = app.world().resource::<ContributionStats>().clone();
    let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
        stats.lock().unsupported = Some("the app renders nothing: it has no RenderPlugin".into());
        return;
    };
    called::init::<ContributionCamera>(render_app);
    render_app.add_systems(
        ExtractSchedule,
        (
            ask::<ContributionCamera>,
            respecialize_dithered
                .in_set(DirtySpecializationSystems::CheckForChanges)
                .run_if(is_called_for::<ContributionCamera>),
        )
            .chain(),
    );
    if !can_rewrite_draws(render_app.world()) {
        stats.lock().unsupported =
            Some("this GPU cannot draw indirectly with GPU culling; the CPU measures".into());
        return;
    }
    render_app
        .insert_resource(stats)
        .init_resource::<ExtractedContribution>()
        .init_gpu_resource::<GpuCandidates>()
        .init_gpu_resource::<ContributionViews>()
        .add_systems(RenderStartup, init_contribution_pipelines)
        .add_systems(
            ExtractSchedule,
            extract_contribution
                .after(ask::<ContributionCamera>)
                .run_if(is_called_for::<ContributionCamera>),
        )
        .add_systems(
            Render,
            (
                prepare_contribution.in_set(RenderSystems::PrepareResources),
                prepare_contribution_bind_groups.in_set(RenderSystems::PrepareBindGroups),
            )
                .run_if(is_wanted),
        )
        .add_systems(
            Core3d,
            contribution
                // It writes the instances again.
                .after(early_gpu_preprocess)
                // What is counted is drawn from here on.
                .before(early_prepass_build_indirect_parameters)
                .run_if(is_wanted),
        );
}

/// Whether a camera measures on the GPU, waits for its shaders, or did so and left memory behind.
fn is_wanted(
    extracted: Res<ExtractedContribution>,
    views: Res<ContributionViews>,
    stats: Res<ContributionStats>,
) -> bool {
    if !extracted.cameras.is_empty() || !views.0.is_empty() {
        return true;
    }
    let stats = stats.lock();
    stats.wanted && !stats.ready
}
