//! What is recorded for each camera: measure, take what is too small out of its draws, send the verdicts back.

use bevy::{
    prelude::*,
    render::{
        diagnostic::RecordDiagnostics,
        render_resource::*,
        renderer::{RenderContext, RenderDevice, ViewQuery},
        sync_world::MainEntity,
        view::ExtractedView,
    },
};

use super::{
    ContributionStats, SLOTS_PER_GROUP,
    extract::ExtractedContribution,
    prepare::{ContributionPipelines, ContributionViews},
};

/// Workgroups of a dispatch along an axis, at most: WebGPU's least limit.
const MOST_WORKGROUPS: u32 = 65_535;
/// Mesh instances of a workgroup, as in `late_draws.wgsl`.
const INSTANCES_PER_GROUP: u32 = 64;

/// `contribution`, `forget_draws` and `late_draws` of one camera: after Bevy has made its instances ready, before their
/// number is taken for the draws.
#[expect(clippy::too_many_arguments, reason = "two passes that go together")]
pub fn contribution(
    view: ViewQuery<Entity, With<ExtractedView>>,
    extracted: Res<ExtractedContribution>,
    mut views: ResMut<ContributionViews>,
    pipelines: Res<ContributionPipelines>,
    cache: Res<PipelineCache>,
    stats: Res<ContributionStats>,
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
    let (Some([measure, forget, draw]), Some((_, group))) = (pipelines.all(&cache), &of.group)
    else {
        return;
    };
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let encoder = ctx.command_encoder();
    {
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
            label: Some("contribution"),
            timestamp_writes: None,
        });
        let span = diagnostics.pass_span(&mut pass, "contribution");
        pass.set_pipeline(measure);
        pass.set_bind_group(0, group, &[]);
        let groups = (extracted.slots as u32).div_ceil(SLOTS_PER_GROUP);
        pass.dispatch_workgroups(groups.min(MOST_WORKGROUPS), 1, 1);
        span.end(&mut pass);
    }
    {
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
            label: Some("contribution_draws"),
            timestamp_writes: None,
        });
        let span = diagnostics.pass_span(&mut pass, "contribution_draws");
        for pipeline in [forget, draw] {
            pass.set_pipeline(pipeline);
            for draws in &of.draws {
                pass.set_bind_group(0, &draws.group, &[]);
                let groups = draws.instances.div_ceil(INSTANCES_PER_GROUP);
                pass.dispatch_workgroups(groups, 1, 1);
            }
        }
        span.end(&mut pass);
    }
    {
        let mut done = stats.lock();
        done.measured += 1;
        done.rewritten += u64::from(!of.draws.is_empty());
    }
    if !of.draws.is_empty() {
        of.send(&device, encoder, camera, extracted.frame, extracted.epoch);
    }
}
