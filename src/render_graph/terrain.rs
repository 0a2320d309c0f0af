//! The terrain's passes for one camera: `subdivide`, `box_entry`, `beam`, `ray_cast`, `terrain_depth`,
//! `terrain_shade`. Reading [`cast_terrain`] from top to bottom is reading P1.

use bevy::{
    core_pipeline::prepass::ViewPrepassTextures,
    pbr::MeshViewBindGroup,
    prelude::*,
    render::{
        diagnostic::{DiagnosticsRecorder, RecordDiagnostics},
        render_resource::*,
        renderer::{RenderContext, ViewQuery},
        view::{ExtractedView, ViewDepthTexture, ViewTarget},
    },
};

use super::{
    stats::TerrainStats,
    subdivide::{COUNT_BYTES, DRAW_OFFSET},
    view::{TerrainSlot, TerrainViews, ViewTerrain, WORKGROUP_PX},
};

/// Casts the rays of every terrain in view, nearest wins, and puts their depth among the meshes'.
///
/// Runs after what meshes draw before the main pass, whose depth stops rays, and before Bevy's depth
/// pyramid, so that terrain hides meshes there.
pub fn cast_terrain(
    view: ViewQuery<(
        &ExtractedView,
        &ViewDepthTexture,
        Option<&ViewPrepassTextures>,
    )>,
    views: Res<TerrainViews>,
    cache: Res<PipelineCache>,
    stats: Res<TerrainStats>,
    mut ctx: RenderContext,
) {
    let (extracted_view, depth, prepass) = view.into_inner();
    let Some(view) = views
        .views
        .get(&extracted_view.retained_view_entity.main_entity.id())
    else {
        return;
    };
    if !view.is_castable(&cache) {
        return;
    }
    let diagnostics = ctx.diagnostic_recorder();
    let mut caster = Caster {
        cache: &cache,
        stats: &stats,
        diagnostics: diagnostics.as_deref(),
        encoder: ctx.command_encoder(),
    };
    for slot in view.drawn_slots() {
        caster.subdivide(slot);
        caster.box_entry(slot, view);
        caster.beam(slot);
        caster.ray_cast(slot, view);
    }
    caster.terrain_depth(view, depth, prepass);
}

/// Records passes. Each does nothing where the traversal doesn't use it.
pub struct Caster<'a> {
    pub cache: &'a PipelineCache,
    pub stats: &'a TerrainStats,
    pub diagnostics: Option<&'a DiagnosticsRecorder>,
    pub encoder: &'a mut CommandEncoder,
}

impl ViewTerrain {
    /// Terrains to draw this frame.
    pub fn drawn_slots(&self) -> impl Iterator<Item = &TerrainSlot> {
        self.drawn
            .iter()
            .filter_map(|entity| self.slots.get(entity))
    }

    /// Whether every pipeline needed to cast is compiled; half a terrain is never shown.
    pub fn is_castable(&self, cache: &PipelineCache) -> bool {
        let compute = |id: Option<_>| id.is_none_or(|id| cache.get_compute_pipeline(id).is_some());
        let render = |id: Option<_>| id.is_none_or(|id| cache.get_render_pipeline(id).is_some());
        self.targets.is_some()
            && !self.drawn.is_empty()
            && self.drawn_slots().all(|slot| {
                slot.bind_groups.is_some()
                    && slot.pipelines.is_some_and(|ids| {
                        compute(ids.subdivide)
                            && render(ids.box_entry)
                            && ids
                                .beam
                                .is_none_or(|ids| ids.iter().all(|id| compute(Some(*id))))
                            && compute(Some(ids.ray_cast))
                            && render(Some(ids.terrain_depth))
                            && ids.terrain_shade.is_some()
                            && render(ids.terrain_shade)
                    })
            })
    }
}

impl Caster<'_> {
    /// Divides the bounding box, one indirect dispatch a level.
    pub fn subdivide(&mut self, slot: &TerrainSlot) {
        let (Some(lists), Some(groups), Some(ids)) =
            (&slot.lists, &slot.bind_groups, slot.pipelines)
        else {
            return;
        };
        let (Some(subdivide), Some(pipeline)) = (
            &groups.subdivide,
            ids.subdivide
                .and_then(|id| self.cache.get_compute_pipeline(id)),
        ) else {
            return;
        };
        let span = self.diagnostics.time_span(self.encoder, "subdivide");
        let encoder = &mut *self.encoder;
        encoder.copy_buffer_to_buffer(&lists.template, 0, &lists.counts, 0, COUNT_BYTES);
        encoder.copy_buffer_to_buffer(&lists.template, COUNT_BYTES, &lists.nodes[0], 0, 8);
        for index in 0..slot.subdivide_passes() {
            let arguments = u64::from(index) * 16;
            encoder.copy_buffer_to_buffer(
                &lists.counts,
                arguments,
                &lists.arguments,
                arguments,
                12,
            );
            let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
                label: Some("subdivide"),
                timestamp_writes: None,
            });
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &groups.field, &[]);
            let from = index as usize % 2;
            pass.set_bind_group(1, &subdivide[from], &[lists.pass_offsets[index as usize]]);
            pass.dispatch_workgroups_indirect(&lists.arguments, arguments);
            self.stats.count_dispatch("subdivide", 1);
        }
        encoder.copy_buffer_to_buffer(
            &lists.counts,
            DRAW_OFFSET,
            &lists.arguments,
            DRAW_OFFSET,
            16,
        );
        lists.readback.request(&lists.counts, encoder);
        span.end(self.encoder);
    }

    /// Draws the boxes' back faces and keeps the nearest entry.
    pub fn box_entry(&mut self, slot: &TerrainSlot, view: &ViewTerrain) {
        let (Some(lists), Some(targets), Some(groups), Some(ids)) =
            (&slot.lists, &view.boxes, &slot.bind_groups, slot.pipelines)
        else {
            return;
        };
        let (Some(bind_group), Some(pipeline)) = (
            &groups.box_entry,
            ids.box_entry
                .and_then(|id| self.cache.get_render_pipeline(id)),
        ) else {
            return;
        };
        let mut pass = self.encoder.begin_render_pass(&RenderPassDescriptor {
            label: Some("box_entry"),
            color_attachments: &[Some(RenderPassColorAttachment {
                view: &targets.entry_view,
                depth_slice: None,
                resolve_target: None,
                ops: Operations {
                    load: LoadOp::Clear(LinearRgba::new(-1.0, 0.0, 0.0, 0.0).into()),
                    store: StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(RenderPassDepthStencilAttachment {
                view: &targets.depth_view,
                depth_ops: Some(Operations {
                    load: LoadOp::Clear(0.0),
                    store: StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        let span = self.diagnostics.pass_span(&mut pass, "box_entry");
        // The targets are as large as the view's finest traversal asks for; this one's tiles lie in a corner.
        let size = slot.box_target_size(view);
        pass.set_viewport(0.0, 0.0, size.x as f32, size.y as f32, 0.0, 1.0);
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &*groups.field, &[]);
        pass.set_bind_group(1, &**bind_group, &[]);
        pass.draw_indirect(&lists.arguments, DRAW_OFFSET);
        span.end(&mut pass);
        self.stats
            .count_dispatch("box_entry", lists.readback.latest());
    }

    /// One beam for each coarse tile, then one for each fine tile from there.
    pub fn beam(&mut self, slot: &TerrainSlot) {
        let (Some(starts), Some(groups), Some(ids)) =
            (&slot.tile_start, &slot.bind_groups, slot.pipelines)
        else {
            return;
        };
        let (Some(bind_groups), Some(ids)) = (&groups.beam, ids.beam) else {
            return;
        };
        let mut pass = self.encoder.begin_compute_pass(&ComputePassDescriptor {
            label: Some("beam"),
            timestamp_writes: None,
        });
        let span = self.diagnostics.pass_span(&mut pass, "beam");
        pass.set_bind_group(0, &*groups.field, &[]);
        for ((starts, bind_group), id) in starts.iter().zip(bind_groups).zip(ids) {
            let Some(pipeline) = self.cache.get_compute_pipeline(id) else {
                continue;
            };
            pass.set_pipeline(pipeline);
            pass.set_bind_group(1, &**bind_group, &[]);
            let tiles = starts.tiles;
            pass.dispatch_workgroups(tiles.x.div_ceil(8), tiles.y.div_ceil(8), 1);
            self.stats
                .count_dispatch("beam", u64::from(tiles.x) * u64::from(tiles.y));
        }
        span.end(&mut pass);
    }

    /// One ray a pixel.
    pub fn ray_cast(&mut self, slot: &TerrainSlot, view: &ViewTerrain) {
        let (Some(targets), Some(groups), Some(ids)) =
            (&view.targets, &slot.bind_groups, slot.pipelines)
        else {
            return;
        };
        let Some(pipeline) = self.cache.get_compute_pipeline(ids.ray_cast) else {
            return;
        };
        let mut pass = self.encoder.begin_compute_pass(&ComputePassDescriptor {
            label: Some("ray_cast"),
            timestamp_writes: None,
        });
        let span = self.diagnostics.pass_span(&mut pass, "ray_cast");
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &*groups.field, &[]);
        pass.set_bind_group(1, &*groups.ray_cast, &[]);
        let tiles = targets.size.map(|n| n.div_ceil(WORKGROUP_PX));
        pass.dispatch_workgroups(tiles.x, tiles.y, 1);
        span.end(&mut pass);
        self.stats.count_dispatch(
            "ray_cast",
            u64::from(targets.size.x) * u64::from(targets.size.y),
        );
    }

    /// Writes depth, and normals and motion where the camera keeps them.
    fn terrain_depth(
        &mut self,
        view: &ViewTerrain,
        depth: &ViewDepthTexture,
        prepass: Option<&ViewPrepassTextures>,
    ) {
        let colours = [
            prepass.and_then(|textures| Some(textures.normal.as_ref()?.get_attachment())),
            prepass.and_then(|textures| Some(textures.motion_vectors.as_ref()?.get_attachment())),
        ];
        let colours = if colours.iter().all(Option::is_none) {
            &[][..]
        } else {
            &colours
        };
        let mut pass = self.encoder.begin_render_pass(&RenderPassDescriptor {
            label: Some("terrain_depth"),
            color_attachments: colours,
            depth_stencil_attachment: Some(depth.get_attachment(StoreOp::Store)),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        let span = self.diagnostics.pass_span(&mut pass, "terrain_depth");
        if let Some(viewport) = &view.viewport {
            let (at, size) = (viewport.physical_position, viewport.physical_size);
            pass.set_viewport(
                at.x as f32,
                at.y as f32,
                size.x as f32,
                size.y as f32,
                0.0,
                1.0,
            );
        }
        for slot in view.drawn_slots() {
            let (Some(groups), Some(ids)) = (&slot.bind_groups, slot.pipelines) else {
                continue;
            };
            let Some(pipeline) = self.cache.get_render_pipeline(ids.terrain_depth) else {
                continue;
            };
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &*groups.field, &[]);
            pass.set_bind_group(1, &*groups.terrain_depth, &[]);
            pass.draw(0..3, 0..1);
            self.stats.count_dispatch("terrain_depth", 1);
        }
        span.end(&mut pass);
        drop(pass);
        // Bevy copies the depth for its prepass readers when meshes are drawn; the copy must have terrain too.
        if let Some(textures) = prepass
            && let Some(copy) = &textures.depth
        {
            self.encoder.copy_texture_to_texture(
                depth.texture.as_image_copy(),
                copy.texture.texture.as_image_copy(),
                textures.size,
            );
        }
    }
}

/// Lights every terrain pixel that is still in front.
pub fn terrain_shade(
    view: ViewQuery<(
        &ExtractedView,
        &ViewTarget,
        &ViewDepthTexture,
        &MeshViewBindGroup,
    )>,
    views: Res<TerrainViews>,
    cache: Res<PipelineCache>,
    stats: Res<TerrainStats>,
    mut ctx: RenderContext,
) {
    let (extracted_view, target, depth, mesh_view) = view.into_inner();
    let Some(view) = views
        .views
        .get(&extracted_view.retained_view_entity.main_entity.id())
    else {
        return;
    };
    if !view.is_castable(&cache) {
        return;
    }
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let mut pass = ctx.begin_tracked_render_pass(RenderPassDescriptor {
        label: Some("terrain_shade"),
        color_attachments: &[Some(target.get_color_attachment())],
        depth_stencil_attachment: Some(depth.get_attachment(StoreOp::Store)),
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    });
    let span = diagnostics.pass_span(&mut pass, "terrain_shade");
    if let Some(viewport) = &view.viewport {
        pass.set_camera_viewport(viewport);
    }
    for slot in view.drawn_slots() {
        let (Some(groups), Some(ids)) = (&slot.bind_groups, slot.pipelines) else {
            continue;
        };
        let Some(pipeline) = ids
            .terrain_shade
            .and_then(|id| cache.get_render_pipeline(id))
        else {
            continue;
        };
        pass.set_render_pipeline(pipeline);
        pass.set_bind_group(0, &mesh_view.main, &mesh_view.main_offsets);
        pass.set_bind_group(1, &mesh_view.binding_array, &[]);
        pass.set_bind_group(2, &groups.field, &[]);
        pass.set_bind_group(3, &groups.terrain_shade, &[]);
        pass.draw(0..3, 0..1);
        stats.count_dispatch("terrain_shade", 1);
    }
    span.end(&mut pass);
}
