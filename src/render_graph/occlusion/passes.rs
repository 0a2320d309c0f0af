//! What is recorded for each camera: reduce the depth, test what was removed against it, draw what is not hidden.

use bevy::{
    camera::{MainPassResolutionOverride, Viewport},
    core_pipeline::{
        core_3d::{AlphaMask3d, Opaque3d},
        deferred::{AlphaMask3dDeferred, Opaque3dDeferred},
        prepass::{
            AlphaMask3dPrepass, DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass,
            Opaque3dPrepass, ViewPrepassTextures,
        },
    },
    ecs::query::QueryFilter,
    pbr::{
        BuildIndirectParametersBindGroups, PreprocessPipelines,
        early_prepass_build_indirect_parameters, main_build_indirect_parameters,
    },
    prelude::*,
    render::{
        batching::gpu_preprocessing::IndirectParametersBuffers,
        camera::ExtractedCamera,
        diagnostic::RecordDiagnostics,
        render_phase::{BinnedPhaseItem, TrackedRenderPass, ViewBinnedRenderPhases},
        render_resource::*,
        renderer::{RenderContext, RenderDevice, ViewQuery},
        sync_world::MainEntity,
        view::{ExtractedView, ViewDepthTexture, ViewTarget},
    },
};

use super::{
    super::occludee_verdicts::OCCLUDEES_PER_GROUP,
    OcclusionStats,
    buffers::OcclusionViews,
    extract::ExtractedOcclusion,
    late_view::{draws_late, late_view_of},
    pipelines::OcclusionPipelines,
    prepare::LateDrawGroups,
};

/// Texels of level 0 along a side of `depth_reduce`'s workgroup.
const REDUCE_TILE: u32 = 16;
/// Levels that `depth_reduce` makes; `depth_reduce_rest` makes the others.
const REDUCE_LEVELS: usize = 5;

/// Workgroups of a dispatch along an axis, at most: WebGPU's least limit.
const MOST_WORKGROUPS: u32 = 65_535;

/// A camera that draws into the depth before its main pass.
pub type WithPrepass = Or<(
    With<DepthPrepass>,
    With<NormalPrepass>,
    With<MotionVectorPrepass>,
    With<DeferredPrepass>,
)>;

/// A camera whose main pass is the first to draw into the depth.
pub type WithoutPrepass = (
    Without<DepthPrepass>,
    Without<NormalPrepass>,
    Without<MotionVectorPrepass>,
    Without<DeferredPrepass>,
);

/// `depth_reduce`, `occludee_verdicts` and `late_draws` of one camera: after the first pass that draws into the
/// depth, before what is drawn late. Then sends depth and verdicts back.
#[expect(clippy::too_many_arguments, reason = "three passes that go together")]
pub fn recheck<F: QueryFilter + 'static>(
    view: ViewQuery<&ExtractedView, (F, With<ViewDepthTexture>)>,
    extracted: Res<ExtractedOcclusion>,
    mut views: ResMut<OcclusionViews>,
    groups: Res<LateDrawGroups>,
    pipelines: Res<OcclusionPipelines>,
    cache: Res<PipelineCache>,
    stats: Res<OcclusionStats>,
    device: Res<RenderDevice>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let Some(camera) = extracted.cameras.iter().find(|c| c.render == entity) else {
        return;
    };
    let Some(of) = views.0.get_mut(&MainEntity::from(camera.main)) else {
        return;
    };
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let encoder = ctx.command_encoder();
    let mut done = stats.lock();

    // Without verdicts nothing is hidden, and all of the late view is drawn.
    encoder.clear_buffer(&of.hidden, 0, None);
    let reduced = pipelines
        .reduce(&cache, of.key)
        .zip(of.reduce_group.as_ref());
    if let Some(([first, rest], (_, group))) = reduced {
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
            label: Some("depth_reduce"),
            timestamp_writes: None,
        });
        let span = diagnostics.pass_span(&mut pass, "depth_reduce");
        let size = of.header.levels.first().map_or(UVec2::ONE, |l| l.size);
        pass.set_bind_group(0, group, &[]);
        pass.set_pipeline(first);
        pass.dispatch_workgroups(
            size.x.div_ceil(REDUCE_TILE),
            size.y.div_ceil(REDUCE_TILE),
            1,
        );
        if of.header.levels.len() > REDUCE_LEVELS {
            pass.set_pipeline(rest);
            pass.dispatch_workgroups(1, 1, 1);
        }
        span.end(&mut pass);
        drop(pass);
        done.reduced += 1;

        if let (true, Some(pipeline), Some((_, group))) =
            (of.tests, pipelines.verdicts(&cache), &of.verdict_group)
        {
            let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
                label: Some("occludee_verdicts"),
                timestamp_writes: None,
            });
            let span = diagnostics.pass_span(&mut pass, "occludee_verdicts");
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, group, &[]);
            // Slots beyond the largest dispatch are not tested, and so are drawn.
            let groups = (extracted.slots as u32)
                .div_ceil(OCCLUDEES_PER_GROUP)
                .min(MOST_WORKGROUPS);
            pass.dispatch_workgroups(groups, 1, 1);
            span.end(&mut pass);
            drop(pass);
            done.tested += 1;
        }
    }
    if let (true, Some(pipeline), Some(groups)) = (
        draws_late(camera),
        pipelines.late_draws(&cache),
        groups.0.get(&camera.main),
    ) {
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
            label: Some("late_draws"),
            timestamp_writes: None,
        });
        let span = diagnostics.pass_span(&mut pass, "late_draws");
        pass.set_pipeline(pipeline);
        for late in groups {
            pass.set_bind_group(0, &late.group, &[]);
            pass.dispatch_workgroups(late.instances.div_ceil(64), 1, 1);
        }
        span.end(&mut pass);
        drop(pass);
        done.late += 1;
    }
    if reduced.is_some() {
        of.send(&device, encoder, camera, extracted.frame, extracted.epoch);
    }
}

/// Draw commands of the late view's prepass, from what `late_draws` counted.
pub fn build_late_prepass(
    view: ViewQuery<Entity, WithPrepass>,
    extracted: Res<ExtractedOcclusion>,
    preprocess: Res<PreprocessPipelines>,
    groups: Option<Res<BuildIndirectParametersBindGroups>>,
    cache: Res<PipelineCache>,
    buffers: Option<Res<IndirectParametersBuffers>>,
    ctx: RenderContext,
) {
    if late_camera(&extracted, view.entity()).is_some() {
        early_prepass_build_indirect_parameters(preprocess, groups, cache, buffers, ctx);
    }
}

/// Draw commands of the late view's main pass, where the camera has no prepass: Bevy has built its own by then.
#[expect(
    clippy::too_many_arguments,
    reason = "Bevy's system of the same kind has them"
)]
pub fn build_late_main(
    view: ViewQuery<Entity, Without<bevy::pbr::ShadowView>>,
    prepasses: Query<(), WithPrepass>,
    extracted: Res<ExtractedOcclusion>,
    preprocess: Res<PreprocessPipelines>,
    groups: Option<Res<BuildIndirectParametersBindGroups>>,
    cache: Res<PipelineCache>,
    buffers: Option<Res<IndirectParametersBuffers>>,
    ctx: RenderContext,
) {
    let entity = view.entity();
    if late_camera(&extracted, entity).is_some() && !prepasses.contains(entity) {
        main_build_indirect_parameters(view, preprocess, groups, cache, buffers, ctx);
    }
}

/// A pass of a late view: where it draws to, with its camera's bind groups.
struct LatePass<'a> {
    label: &'static str,
    colours: &'a [Option<RenderPassColorAttachment<'a>>],
    depth: &'a ViewDepthTexture,
    camera: &'a ExtractedCamera,
    resolution: Option<&'a MainPassResolutionOverride>,
    /// The camera in the main world, and its view.
    main: Entity,
    view: Entity,
}

impl LatePass<'_> {
    /// Draws the opaque and the alpha-masked phase.
    fn draw<O: BinnedPhaseItem, A: BinnedPhaseItem>(
        &self,
        world: &World,
        ctx: &mut RenderContext,
        opaque: &ViewBinnedRenderPhases<O>,
        alpha_mask: &ViewBinnedRenderPhases<A>,
    ) {
        let diagnostics = ctx.diagnostic_recorder();
        let diagnostics = diagnostics.as_deref();
        let mut pass = ctx.begin_tracked_render_pass(RenderPassDescriptor {
            label: Some(self.label),
            color_attachments: self.colours,
            depth_stencil_attachment: Some(self.depth.get_attachment(StoreOp::Store)),
            ..default()
        });
        let span = diagnostics.pass_span(&mut pass, self.label);
        if let Some(viewport) =
            Viewport::from_viewport_and_override(self.camera.viewport.as_ref(), self.resolution)
        {
            pass.set_camera_viewport(&viewport);
        }
        self.draw_phase(opaque, &mut pass, world);
        self.draw_phase(alpha_mask, &mut pass, world);
        span.end(&mut pass);
    }

    fn draw_phase<'w, P: BinnedPhaseItem>(
        &self,
        phases: &ViewBinnedRenderPhases<P>,
        pass: &mut TrackedRenderPass<'w>,
        world: &'w World,
    ) {
        if let Some(phase) = phases.get(&late_view_of(self.main))
            && !phase.is_empty()
            && let Err(error) = phase.render(pass, world, self.view)
        {
            error_once!("what was hidden could not be drawn late: {error:?}");
        }
    }
}

/// Brings Bevy's copy of the depth, made before the late view's prepass, up to date.
fn copy_depth(ctx: &mut RenderContext, depth: &ViewDepthTexture, textures: &ViewPrepassTextures) {
    if let Some(copy) = &textures.depth {
        ctx.command_encoder().copy_texture_to_texture(
            depth.texture.as_image_copy(),
            copy.texture.texture.as_image_copy(),
            textures.size,
        );
    }
}

/// The camera of a view if it has something to be drawn late.
fn late_camera(extracted: &ExtractedOcclusion, view: Entity) -> Option<Entity> {
    extracted
        .cameras
        .iter()
        .find(|camera| camera.render == view && draws_late(camera))
        .map(|camera| camera.main)
}

/// What a prepass draws to.
type PrepassData<'w> = (
    &'w ExtractedCamera,
    &'w ViewDepthTexture,
    &'w ViewPrepassTextures,
    Has<DeferredPrepass>,
    Option<&'w MainPassResolutionOverride>,
);

/// The late view's prepass, after the camera's.
pub fn late_view_prepass(
    world: &World,
    view: ViewQuery<PrepassData>,
    extracted: Res<ExtractedOcclusion>,
    opaque: Res<ViewBinnedRenderPhases<Opaque3dPrepass>>,
    alpha_mask: Res<ViewBinnedRenderPhases<AlphaMask3dPrepass>>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let Some(main) = late_camera(&extracted, entity) else {
        return;
    };
    let (camera, depth, textures, deferred, resolution) = view.into_inner();
    if !opaque.contains_key(&late_view_of(main)) {
        return;
    }
    let colours = [
        textures.normal.as_ref().map(|t| t.get_attachment()),
        textures.motion_vectors.as_ref().map(|t| t.get_attachment()),
        // The deferred attachments, which pipelines of the prepass expect to be there and empty.
        None,
        None,
    ];
    // Without any, the pipelines expect no attachments at all.
    let colours = match colours.iter().any(Option::is_some) {
        true => &colours[..],
        false => &[],
    };
    let pass = LatePass {
        label: "late_view_prepass",
        colours,
        depth,
        camera,
        resolution,
        main,
        view: entity,
    };
    pass.draw(world, &mut ctx, &opaque, &alpha_mask);
    if !deferred {
        copy_depth(&mut ctx, depth, textures);
    }
}

/// The late view's deferred prepass, after the camera's.
pub fn late_view_deferred(
    world: &World,
    view: ViewQuery<
        (
            &ExtractedCamera,
            &ViewDepthTexture,
            &ViewPrepassTextures,
            Option<&MainPassResolutionOverride>,
        ),
        With<DeferredPrepass>,
    >,
    extracted: Res<ExtractedOcclusion>,
    opaque: Res<ViewBinnedRenderPhases<Opaque3dDeferred>>,
    alpha_mask: Res<ViewBinnedRenderPhases<AlphaMask3dDeferred>>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let Some(main) = late_camera(&extracted, entity) else {
        return;
    };
    let (camera, depth, textures, resolution) = view.into_inner();
    let colours = [
        textures.normal.as_ref().map(|t| t.get_attachment()),
        textures.motion_vectors.as_ref().map(|t| t.get_attachment()),
        textures.deferred.as_ref().map(|t| t.get_attachment()),
        textures
            .deferred_lighting_pass_id
            .as_ref()
            .map(|t| t.get_attachment()),
    ];
    let pass = LatePass {
        label: "late_view_deferred",
        colours: &colours,
        depth,
        camera,
        resolution,
        main,
        view: entity,
    };
    pass.draw(world, &mut ctx, &opaque, &alpha_mask);
    copy_depth(&mut ctx, depth, textures);
}

/// The late view's opaque and alpha-masked meshes, after the camera's.
pub fn late_opaque(
    world: &World,
    view: ViewQuery<(
        &ExtractedCamera,
        &ViewTarget,
        &ViewDepthTexture,
        Option<&MainPassResolutionOverride>,
    )>,
    extracted: Res<ExtractedOcclusion>,
    opaque: Res<ViewBinnedRenderPhases<Opaque3d>>,
    alpha_mask: Res<ViewBinnedRenderPhases<AlphaMask3d>>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let Some(main) = late_camera(&extracted, entity) else {
        return;
    };
    let (camera, target, depth, resolution) = view.into_inner();
    let pass = LatePass {
        label: "late_opaque",
        colours: &[Some(target.get_color_attachment())],
        depth,
        camera,
        resolution,
        main,
        view: entity,
    };
    pass.draw(world, &mut ctx, &opaque, &alpha_mask);
}
