//! The pass: rays where a cascade needs them, then one draw for each.

use bevy::{
    pbr::{ShadowView, ViewLightEntities},
    prelude::*,
    render::{
        diagnostic::{DiagnosticsRecorder, RecordDiagnostics},
        render_resource::*,
        renderer::{RenderContext, ViewQuery},
        view::ExtractedView,
    },
};

use super::{CastTargets, TerrainCascade, TerrainCascades};
use crate::render_graph::{stats::TerrainStats, view::WORKGROUP_PX};

/// Draws terrain into the shadow cascades of one camera, casting the light's rays first where what is kept is
/// out of date.
///
/// Runs when Bevy has drawn, or only cleared, the maps: the nearer caster wins, so meshes stay what they are.
pub fn terrain_cascade(
    view: ViewQuery<&ViewLightEntities>,
    shadow_views: Query<(&ShadowView, &ExtractedView)>,
    mut cascades: ResMut<TerrainCascades>,
    cache: Res<PipelineCache>,
    stats: Res<TerrainStats>,
    mut ctx: RenderContext,
) {
    if cascades.cascades.is_empty() {
        return;
    }
    let cascades = &mut *cascades;
    let (Some(targets), Some(erode), Some(draw)) = (
        &cascades.targets,
        cascades.erode,
        cascades.draw.and_then(|id| cache.get_render_pipeline(id)),
    ) else {
        return;
    };
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    for light in &view.into_inner().lights {
        let Ok((shadow_view, extracted_view)) = shadow_views.get(*light) else {
            continue;
        };
        let Some(cascade) = cascades
            .cascades
            .get_mut(&extracted_view.retained_view_entity)
            .filter(|cascade| cascade.drawn)
        else {
            continue;
        };
        let encoder = ctx.command_encoder();
        if cascade.due {
            cascade.due = !cascade.cast_rays(targets, erode, &cache, &stats, diagnostics, encoder);
        }
        if !cascade.due {
            cascade.draw(shadow_view, draw, &stats, diagnostics, encoder);
        }
    }
}

impl TerrainCascade {
    /// Casts, and makes what was hit a caster. Returns whether it could: all of it or nothing.
    fn cast_rays(
        &self,
        targets: &CastTargets,
        erode: [CachedComputePipelineId; 3],
        cache: &PipelineCache,
        stats: &TerrainStats,
        diagnostics: Option<&DiagnosticsRecorder>,
        encoder: &mut CommandEncoder,
    ) -> bool {
        let casters = || self.casters.iter().filter(|caster| caster.in_view);
        let ready = casters().all(|caster| {
            let groups = caster.groups.as_ref();
            groups.is_some_and(|groups| {
                let [coarse, fine] = groups.beam_pipelines;
                [coarse, fine, groups.pipeline]
                    .iter()
                    .all(|id| cache.get_compute_pipeline(*id).is_some())
            })
        });
        let [dips, rows, columns] = erode.map(|id| cache.get_compute_pipeline(id));
        let (Some(dips), Some(rows), Some(columns), Some([to_kept, to_hits])) =
            (dips, rows, columns, &self.erode_groups)
        else {
            return false;
        };
        if !ready {
            return false;
        }
        let groups_across = targets.side.div_ceil(WORKGROUP_PX);
        let rays = u64::from(targets.side) * u64::from(targets.side);
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
            label: Some("terrain_cascade_cast"),
            timestamp_writes: None,
        });
        let span = diagnostics.pass_span(&mut pass, "terrain_cascade_cast");
        for groups in casters().filter_map(|caster| caster.groups.as_ref()) {
            let Some(pipeline) = cache.get_compute_pipeline(groups.pipeline) else {
                continue;
            };
            pass.set_bind_group(0, &*groups.field, &[]);
            for ((group, tiles), id) in groups.beam.iter().zip(groups.beam_pipelines) {
                let Some(beam) = cache.get_compute_pipeline(id) else {
                    continue;
                };
                pass.set_pipeline(beam);
                pass.set_bind_group(1, &**group, &[]);
                pass.dispatch_workgroups(tiles.x, tiles.y, 1);
            }
            pass.set_pipeline(pipeline);
            pass.set_bind_group(1, &*groups.ray_cast, &[]);
            pass.dispatch_workgroups(groups_across, groups_across, 1);
            stats.count_dispatch("terrain_cascade_cast", rays);
        }
        span.end(&mut pass);
        drop(pass);
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
            label: Some("terrain_cascade_erode"),
            timestamp_writes: None,
        });
        let span = diagnostics.pass_span(&mut pass, "terrain_cascade_erode");
        // What was hit is not needed any more, so the middle step may overwrite it.
        for (step, group) in [(dips, to_kept), (rows, to_hits), (columns, to_kept)] {
            pass.set_pipeline(step);
            pass.set_bind_group(0, &**group, &[]);
            pass.dispatch_workgroups(groups_across, groups_across, 1);
        }
        span.end(&mut pass);
        stats.count_dispatch("terrain_cascade_erode", rays);
        true
    }

    /// Writes the kept depth into Bevy's map.
    fn draw(
        &self,
        shadow_view: &ShadowView,
        pipeline: &RenderPipeline,
        stats: &TerrainStats,
        diagnostics: Option<&DiagnosticsRecorder>,
        encoder: &mut CommandEncoder,
    ) {
        let Some(group) = &self.draw_group else {
            return;
        };
        let mut pass = encoder.begin_render_pass(&RenderPassDescriptor {
            label: Some("terrain_cascade"),
            color_attachments: &[],
            depth_stencil_attachment: Some(
                shadow_view.depth_attachment.get_attachment(StoreOp::Store),
            ),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        let span = diagnostics.pass_span(&mut pass, "terrain_cascade");
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &**group, &[]);
        pass.draw(0..3, 0..1);
        span.end(&mut pass);
        stats.count_dispatch("terrain_cascade", 1);
    }
}
