//! Textures, bind groups and pipelines of the cascades, made when something they name is new.

use bevy::{
    prelude::*,
    render::{render_resource::*, renderer::RenderDevice},
};

use super::{CastTargets, CasterGroups, TerrainCascade, TerrainCascades};
use crate::render_graph::{
    height_mips::GpuHeightFields,
    pipelines::{PipelineId, PipelineKey, TerrainPipelines},
    view::{Unused, WORKGROUP_PX},
};

impl TerrainCascades {
    /// Makes sure of everything that the cascades drawn in this frame name.
    pub(super) fn bind(
        &mut self,
        pipelines: &mut TerrainPipelines,
        cache: &PipelineCache,
        fields: &GpuHeightFields,
        device: &RenderDevice,
    ) {
        let Some(side) = self
            .cascades
            .values()
            .filter(|cascade| cascade.drawn)
            .find_map(|cascade| Some(cascade.square?.side))
        else {
            return;
        };
        if self.targets.as_ref().is_none_or(|t| t.side != side) {
            let view = |label, format| texture(device, label, side, format).create_view(&default());
            self.targets = Some(CastTargets {
                side,
                depth: view("skyline_cascade_hit_depth", TextureFormat::R32Float),
                surface: view("skyline_cascade_hit_surface", TextureFormat::R32Uint),
            });
            for cascade in self.cascades.values_mut() {
                cascade.erode_groups = None;
                for caster in &mut cascade.casters {
                    caster.groups = None;
                }
            }
        }
        if self.draw.is_none() {
            let mut step = |dips, rows| match pipelines
                .get(cache, PipelineKey::TerrainCascadeErode { dips, rows })
            {
                PipelineId::Compute(id) => Some(id),
                PipelineId::Render(_) => None,
            };
            self.erode = match [step(true, false), step(false, true), step(false, false)] {
                [Some(dips), Some(rows), Some(columns)] => Some([dips, rows, columns]),
                _ => None,
            };
            if let PipelineId::Render(draw) = pipelines.get(cache, PipelineKey::TerrainCascade) {
                self.draw = Some(draw);
            }
        }
        let unused = self.unused.get_or_insert_with(|| Unused::new(device));
        let Some(targets) = &self.targets else { return };
        for cascade in self.cascades.values_mut().filter(|cascade| cascade.drawn) {
            cascade.bind(targets, unused, pipelines, cache, fields, device);
        }
    }
}

impl TerrainCascade {
    fn bind(
        &mut self,
        targets: &CastTargets,
        unused: &Unused,
        pipelines: &mut TerrainPipelines,
        cache: &PipelineCache,
        fields: &GpuHeightFields,
        device: &RenderDevice,
    ) {
        for caster in self.casters.iter_mut().filter(|caster| caster.in_view) {
            let Some(field) = caster.key.and_then(|key| fields.get(key.field)) else {
                continue;
            };
            let bound = caster.groups.as_ref();
            let tiles = caster.slot.tile_start.as_ref();
            if bound.is_some_and(|groups| {
                groups.generation == field.generation
                    && tiles.is_some_and(|tiles| tiles[1].buffer.id() == groups.tiles)
            }) {
                continue;
            }
            let key = PipelineKey::RayCast {
                float: field.float,
                stop_at_depth: false,
            };
            let float = field.float;
            let (
                PipelineId::Compute(pipeline),
                PipelineId::Compute(coarse),
                PipelineId::Compute(fine),
            ) = (
                pipelines.get(cache, key),
                pipelines.get(cache, PipelineKey::Beam { float, fine: false }),
                pipelines.get(cache, PipelineKey::Beam { float, fine: true }),
            )
            else {
                continue;
            };
            let Some(starts) = &caster.slot.tile_start else {
                continue;
            };
            let Some(view) = caster.slot.view.binding() else {
                continue;
            };
            caster.groups = Some(CasterGroups {
                generation: field.generation,
                pipeline,
                field: device.create_bind_group(
                    "skyline_cascade_field",
                    &cache.get_bind_group_layout(pipelines.field(field.float)),
                    &BindGroupEntries::sequential((
                        field.uniform.as_entire_binding(),
                        &field.heights,
                        field.pyramid.as_entire_binding(),
                        &unused.nearest,
                        view,
                    )),
                ),
                tiles: starts[1].buffer.id(),
                beam_pipelines: [coarse, fine],
                beam: [
                    (&starts[0], &unused.buffer),
                    (&starts[1], &starts[0].buffer),
                ]
                .map(|(starts, coarse)| {
                    let group = device.create_bind_group(
                        "skyline_cascade_beam",
                        &cache.get_bind_group_layout(&pipelines.beam),
                        &BindGroupEntries::sequential((
                            starts.buffer.as_entire_binding(),
                            &unused.texture,
                            unused.buffer.as_entire_binding(),
                            coarse.as_entire_binding(),
                        )),
                    );
                    (group, starts.tiles.map(|n| n.div_ceil(WORKGROUP_PX)))
                }),
                ray_cast: device.create_bind_group(
                    "skyline_cascade_ray_cast",
                    &cache.get_bind_group_layout(pipelines.ray_cast(false)),
                    &BindGroupEntries::sequential((
                        &targets.depth,
                        &targets.surface,
                        starts[1].buffer.as_entire_binding(),
                        &unused.texture,
                        unused.buffer.as_entire_binding(),
                    )),
                ),
            });
        }
        if self.depth.is_none() {
            let depth = texture(
                device,
                "skyline_cascade_depth",
                targets.side,
                TextureFormat::R32Float,
            );
            self.depth = Some(depth.create_view(&default()));
            self.erode_groups = None;
            self.draw_group = None;
        }
        let Some(depth) = &self.depth else { return };
        if self.erode_groups.is_none()
            && let Some(erosion) = self.erosion.binding()
        {
            let layout = cache.get_bind_group_layout(&pipelines.terrain_cascade_erode);
            self.erode_groups = Some([(&targets.depth, depth), (depth, &targets.depth)].map(
                |(from, to)| {
                    device.create_bind_group(
                        "skyline_terrain_cascade_erode",
                        &layout,
                        &BindGroupEntries::sequential((erosion.clone(), from, to)),
                    )
                },
            ));
        }
        if self.draw_group.is_none()
            && let Some(write) = self.write.binding()
        {
            self.draw_group = Some(device.create_bind_group(
                "skyline_terrain_cascade",
                &cache.get_bind_group_layout(&pipelines.terrain_cascade),
                &BindGroupEntries::sequential((write, depth)),
            ));
        }
    }
}

fn texture(
    device: &RenderDevice,
    label: &'static str,
    side: u32,
    format: TextureFormat,
) -> Texture {
    device.create_texture(&TextureDescriptor {
        label: Some(label),
        size: Extent3d {
            width: side,
            height: side,
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: TextureDimension::D2,
        format,
        usage: TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    })
}
