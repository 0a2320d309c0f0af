//! A map's numbers as the shaders read them, and the commands that make and show it.

use core::ops::Range;

use bevy::{
    math::{DVec3, Vec3Swizzles},
    prelude::*,
    render::{
        render_resource::*,
        renderer::{RenderDevice, RenderQueue},
    },
};
use wgpu::ComputePassTimestampWrites;

use crate::{
    render_graph::{
        height_mips::GpuHeightField,
        pipelines::{PipelineId, PipelineKey, TerrainPipelines},
        stats::TerrainStats,
    },
    terrain_shadow::{
        ShadowMethod,
        light::{LightRay, LightSource},
        plan::{MadeFor, MapPlan, Publish, Step, SweepLines, Work},
        tiles::{TILE_BYTES, TileGrid},
    },
};

/// Workgroups of a tile, made exactly and coarsely, as in `terrain_shadow.wgsl`.
const TILE_GROUPS: u32 = 64;
const COARSE_GROUPS: u32 = 4;
/// Workgroups along one dimension of a dispatch, as in `light_rays.wgsl`.
const MOST_GROUPS: u32 = 65_535;
/// Lines of a workgroup, as in `shadow_sweep.wgsl`.
const SWEEP_LINES: u32 = 64;

/// Mirrors `Light` in `light_rays.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug, Default)]
pub struct GpuShadowLight {
    direction: Vec3,
    kind: u32,
    position_high: Vec3,
    radius: f32,
    position_low: Vec3,
    strips: u32,
    world_from_grid: Mat3,
    grid_from_world: Mat3,
    inverse: Vec2,
    y_max: f32,
    y_magnitude: f32,
    first_tile: UVec2,
    tiles: UVec2,
    listed: u32,
}

impl GpuShadowLight {
    /// `listed` is how many tiles of the map are made, `heights` the range of the field's samples. units: grid
    pub fn new(made_for: &MadeFor, grid: TileGrid, listed: u32, heights: (f64, f64)) -> Self {
        let light = &made_for.light;
        let mut gpu = Self {
            radius: light.radius as f32,
            strips: made_for.strips,
            world_from_grid: light.world_from_grid.as_mat3(),
            grid_from_world: light.world_from_grid.inverse().as_mat3(),
            y_max: heights.1 as f32,
            y_magnitude: (heights.1 - heights.0) as f32,
            first_tile: grid.first,
            tiles: grid.count,
            listed,
            ..default()
        };
        match light.source {
            LightSource::Directional(way) => {
                if let Some(ray) = light.ray(DVec3::ZERO) {
                    let inverse = |d: f64| if d == 0.0 { 0.0 } else { (1.0 / d) as f32 };
                    gpu.direction = ray.direction.as_vec3();
                    gpu.inverse = Vec2::new(inverse(ray.direction.x), inverse(ray.direction.z));
                } else {
                    gpu.direction = Vec3::new(0.0, way.y.signum() as f32, 0.0);
                }
            }
            LightSource::Point(position) => {
                gpu.kind = 1;
                gpu.position_high = position.as_vec3();
                gpu.position_low = (position - gpu.position_high.as_dvec3()).as_vec3();
            }
        }
        gpu
    }
}

/// Mirrors `Sweep` in `shadow_sweep.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug, Default)]
pub struct GpuSweep {
    first: i32,
    count: u32,
    along_x: u32,
    forward: u32,
    m: f32,
    drop: f32,
    drop_low: f32,
    drop_high: f32,
}

/// How parallel lines go over a field, away from a directional light.
#[derive(Clone, Debug)]
pub struct SweepPath {
    numbers: GpuSweep,
    /// Which lines there are, and the samples on each.
    pub lines: SweepLines,
}

impl SweepPath {
    /// Of a map that is swept; `None` for others.
    pub fn of(made_for: &MadeFor, size: UVec2) -> Option<Self> {
        if made_for.method != ShadowMethod::Sweep {
            return None;
        }
        let light = &made_for.light;
        let LightRay { direction, .. } = light.ray(DVec3::ZERO)?;
        let along_x = direction.x.abs() == 1.0;
        let (toward, m, columns, rows) = if along_x {
            (direction.x, -direction.z, size.x, size.y)
        } else {
            (direction.z, -direction.x, size.y, size.x)
        };
        let disc = light.disc(DVec3::ZERO);
        let slope = |way: DVec3| {
            let speed = way.xz().abs().max_element();
            (way.y / speed.max(f64::MIN_POSITIVE)).clamp(-1e18, 1e18) as f32
        };
        let last = (f64::from(columns - 1) * m).round() as i32;
        Some(Self {
            numbers: GpuSweep {
                along_x: u32::from(along_x),
                forward: u32::from(toward < 0.0),
                m: m as f32,
                drop: slope(disc.centre),
                drop_low: slope(disc.centre - disc.up),
                drop_high: slope(disc.centre + disc.up),
                ..default()
            },
            lines: SweepLines {
                lines: -last.max(0) - 2..rows as i32 - last.min(0) + 1,
                columns,
            },
        })
    }

    fn part(&self, lines: &Range<i32>) -> GpuSweep {
        GpuSweep {
            first: lines.start,
            count: (lines.end - lines.start).max(0) as u32,
            ..self.numbers
        }
    }
}

/// Where a map is made before it shows.
pub struct Making {
    /// A byte a sample, tile by tile.
    pub visibility: Buffer,
    light: UniformBuffer<GpuShadowLight>,
    sweep: UniformBuffer<GpuSweep>,
    tiles: Buffer,
    nearest: Sampler,
    bound: Option<Bound>,
}

/// What the bind groups were made for.
struct Bound {
    field: u64,
    groups: [BindGroup; 3],
}

impl Making {
    /// Room for a map of so many tiles.
    pub fn new(tiles: u32, device: &RenderDevice, queue: &RenderQueue) -> Self {
        let buffer = |label, size| {
            device.create_buffer(&BufferDescriptor {
                label: Some(label),
                size,
                usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let mut light = UniformBuffer::<GpuShadowLight>::default();
        light.set_label(Some("skyline_shadow_light"));
        light.write_buffer(device, queue);
        let mut sweep = UniformBuffer::<GpuSweep>::default();
        sweep.set_label(Some("skyline_shadow_sweep"));
        sweep.write_buffer(device, queue);
        Self {
            visibility: buffer("skyline_shadow_making", u64::from(tiles) * TILE_BYTES),
            tiles: buffer("skyline_shadow_tiles", u64::from(tiles) * 4),
            light,
            sweep,
            nearest: device.create_sampler(&SamplerDescriptor::default()),
            bound: None,
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> u64 {
        let uniforms = [self.light.buffer(), self.sweep.buffer()];
        let uniforms = uniforms.into_iter().flatten().map(|buffer| buffer.size());
        self.visibility.size() + self.tiles.size() + uniforms.sum::<u64>()
    }

    /// Tiles there is room for.
    pub fn capacity(&self) -> u32 {
        (self.visibility.size() / TILE_BYTES) as u32
    }

    /// The pipeline that does a step's work; `None` while it is being compiled.
    pub fn pipeline(
        made_for: &MadeFor,
        work: &Work,
        float: bool,
        pipelines: &mut TerrainPipelines,
        cache: &PipelineCache,
    ) -> Option<CachedComputePipelineId> {
        let penumbra = made_for.strips > 0;
        let key = match work {
            Work::None => return None,
            Work::Lines { .. } => PipelineKey::ShadowSweep { float, penumbra },
            Work::Coarse | Work::Exact => PipelineKey::TerrainShadow {
                float,
                per_texel: made_for.method == ShadowMethod::PerTexel,
                coarse: *work == Work::Coarse,
                penumbra,
            },
        };
        let PipelineId::Compute(id) = pipelines.get(cache, key) else {
            return None;
        };
        cache.get_compute_pipeline(id).map(|_| id)
    }

    /// Hands a step's numbers to the GPU, and binds what is not bound.
    #[expect(
        clippy::too_many_arguments,
        reason = "each is one thing the step is made of"
    )]
    pub fn prepare(
        &mut self,
        made_for: &MadeFor,
        plan: &MapPlan,
        step: &Step,
        field: &GpuHeightField,
        heights: (f64, f64),
        pipelines: &TerrainPipelines,
        cache: &PipelineCache,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) {
        self.light.set(GpuShadowLight::new(
            made_for,
            plan.grid(),
            plan.list().len() as u32,
            heights,
        ));
        self.light.write_buffer(device, queue);
        if let Work::Lines { lines, .. } = &step.work
            && let Some(path) = SweepPath::of(made_for, field.size)
        {
            self.sweep.set(path.part(lines));
            self.sweep.write_buffer(device, queue);
        }
        queue.write_buffer(&self.tiles, 0, bytemuck::cast_slice(plan.list()));
        if self
            .bound
            .as_ref()
            .is_none_or(|bound| bound.field != field.generation)
        {
            self.bound = self.bind(field, pipelines, cache, device);
        }
    }

    fn bind(
        &self,
        field: &GpuHeightField,
        pipelines: &TerrainPipelines,
        cache: &PipelineCache,
        device: &RenderDevice,
    ) -> Option<Bound> {
        let light = self.light.binding()?;
        Some(Bound {
            field: field.generation,
            groups: [
                device.create_bind_group(
                    "skyline_shadow_field",
                    &cache.get_bind_group_layout(pipelines.shadow_field(field.float)),
                    &BindGroupEntries::sequential((
                        field.uniform.as_entire_binding(),
                        &field.heights,
                        field.pyramid.as_entire_binding(),
                        &self.nearest,
                    )),
                ),
                device.create_bind_group(
                    "skyline_terrain_shadow",
                    &cache.get_bind_group_layout(&pipelines.terrain_shadow),
                    &BindGroupEntries::sequential((
                        light.clone(),
                        self.tiles.as_entire_binding(),
                        self.visibility.as_entire_binding(),
                    )),
                ),
                device.create_bind_group(
                    "skyline_shadow_sweep",
                    &cache.get_bind_group_layout(&pipelines.shadow_sweep),
                    &BindGroupEntries::sequential((
                        light,
                        self.sweep.binding()?,
                        self.visibility.as_entire_binding(),
                    )),
                ),
            ],
        })
    }

    /// The pipeline that averages what a step has made.
    pub fn mips_pipeline(
        float: bool,
        pipelines: &mut TerrainPipelines,
        cache: &PipelineCache,
    ) -> Option<CachedComputePipelineId> {
        let PipelineId::Compute(id) = pipelines.get(cache, PipelineKey::ShadowMips { float })
        else {
            return None;
        };
        cache.get_compute_pipeline(id).map(|_| id)
    }

    /// Records a step's work: one dispatch, and one for the averages of the tiles it has completed.
    pub fn record(
        &self,
        plan: &MapPlan,
        step: &Step,
        [pipeline, mips]: [&ComputePipeline; 2],
        encoder: &mut CommandEncoder,
        timestamps: Option<ComputePassTimestampWrites>,
        stats: &TerrainStats,
    ) {
        let Some(bound) = &self.bound else {
            return;
        };
        if matches!(step.work, Work::Lines { first: true, .. }) {
            encoder.clear_buffer(&self.visibility, 0, None);
        }
        let listed = plan.list().len() as u32;
        // Tiles are dealt out over two dimensions: one alone ends at 65,535.
        let rows = listed.min(MOST_GROUPS);
        let layers = listed.div_ceil(MOST_GROUPS);
        let (label, group, groups) = match &step.work {
            Work::None => return,
            Work::Coarse => ("terrain_shadow", 1, (COARSE_GROUPS, rows, layers)),
            Work::Exact => ("terrain_shadow", 1, (TILE_GROUPS, rows, layers)),
            Work::Lines { lines, .. } => {
                let lines = (lines.end - lines.start).max(0) as u32;
                ("shadow_sweep", 2, (lines.div_ceil(SWEEP_LINES), 1, 1))
            }
        };
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
            label: Some(label),
            timestamp_writes: timestamps,
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &bound.groups[0], &[]);
        pass.set_bind_group(1, &bound.groups[group], &[]);
        pass.dispatch_workgroups(groups.0, groups.1, groups.2);
        stats.count_dispatch(label, step.rays);
        if listed > 0 {
            pass.set_pipeline(mips);
            pass.set_bind_group(1, &bound.groups[1], &[]);
            pass.dispatch_workgroups(1, rows, layers);
            stats.count_dispatch("shadow_mips", u64::from(listed));
        }
    }

    /// Copies what is to show to where it shows.
    pub fn publish(
        &self,
        plan: &MapPlan,
        publish: Publish,
        shown: &Buffer,
        offset: u64,
        encoder: &mut CommandEncoder,
    ) {
        let mut copy = |first: u32, count: u32| {
            let at = u64::from(first) * TILE_BYTES;
            encoder.copy_buffer_to_buffer(
                &self.visibility,
                at,
                shown,
                offset + at,
                u64::from(count) * TILE_BYTES,
            );
        };
        match publish {
            Publish::None => {}
            Publish::All => copy(0, plan.grid().len()),
            Publish::Listed => runs(plan.list().iter().copied(), copy),
            Publish::Edited => runs(plan.edited().iter(), copy),
        }
    }
}

/// Calls `each` with every run of consecutive numbers: its first, and how many.
fn runs(numbers: impl Iterator<Item = u32>, mut each: impl FnMut(u32, u32)) {
    let mut run: Option<(u32, u32)> = None;
    for number in numbers {
        run = match run {
            Some((first, count)) if first + count == number => Some((first, count + 1)),
            Some((first, count)) => {
                each(first, count);
                Some((number, 1))
            }
            None => Some((number, 1)),
        };
    }
    if let Some((first, count)) = run {
        each(first, count);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain_shadow::light::GridLight;

    #[test]
    fn consecutive_tiles_are_copied_in_one() {
        let mut copies = Vec::new();
        runs([3, 4, 5, 9, 11, 12].into_iter(), |first, count| {
            copies.push((first, count));
        });
        assert_eq!(copies, [(3, 3), (9, 1), (11, 2)]);
        runs([].into_iter(), |_, _| panic!("nothing to copy"));
    }

    #[test]
    fn a_position_far_away_keeps_its_last_bits() {
        use bevy::math::DAffine3;
        let position = DVec3::new(1.5e11 + 0.25, 1e7 + 1e-4, 2.0 + 1e-9);
        let light = GridLight::point(position, 0.0, f64::INFINITY, DAffine3::IDENTITY);
        let made_for = MadeFor {
            light,
            method: ShadowMethod::MaxMip,
            strips: 0,
            heights: 0,
        };
        let gpu = GpuShadowLight::new(&made_for, TileGrid::default(), 0, (0.0, 1.0));
        let back = gpu.position_high.as_dvec3() + gpu.position_low.as_dvec3();
        assert!(((back - position) / position).abs().max_element() < 1e-14);
    }
}
