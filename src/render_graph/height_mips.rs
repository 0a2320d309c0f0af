//! `height_mips`: the height fields on the GPU, and their pyramids of maxima and minima.
//!
//! A field is uploaded while a [`Terrain`](crate::terrain::Terrain) has it, hidden or not, and freed when none does. After
//! an edit only the rectangle is uploaded and only the nodes above it are computed again.
//!
//! # Inputs / outputs
//! Heights: one texture of W×H samples, `R16Uint` or `R32Float`. Pyramid: one storage buffer laid out as
//! [`MinMaxPyramid`], 4 or 8 bytes a node. For 16-bit input that is
//! 2 + 4/3 bytes a sample, everything included.
//!
//! # Reference
//! P1 section 3.1; Tevs, Ihrke and Seidel 2008.

use bevy::{
    asset::AssetId,
    math::{URect, UVec2},
    platform::collections::HashMap,
    prelude::*,
    render::{
        diagnostic::RecordDiagnostics,
        render_resource::*,
        renderer::{RenderContext, RenderDevice, RenderQueue},
    },
};

use super::{
    pipelines::{PipelineId, PipelineKey, TerrainPipelines},
    stats::TerrainStats,
};
use crate::{
    device_errors::checked,
    terrain::{HeightField, HeightFieldChanged, HeightSamples, MinMaxPyramid},
    terrain_shadow::tiles::TILE,
};

/// The level whose nodes have the cells of one tile of shadow maps.
const TILE_LEVEL: u32 = TILE.ilog2();

/// One level to compute. Mirrors `Level` in `height_mips.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug)]
pub struct GpuMipLevel {
    first: IVec2,
    count: IVec2,
    size_in: IVec2,
    offset_in: u32,
    offset_out: u32,
    width_out: i32,
    level: u32,
}

/// What every pass over a field has to know of it. Mirrors `Field` in `types.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug, Default)]
pub struct GpuField {
    cells: IVec2,
    levels: u32,
    level: [UVec4; 32],
}

/// A height field on the GPU.
pub struct GpuHeightField {
    /// Holds a [`GpuField`].
    pub uniform: Buffer,
    pub heights: TextureView,
    pub pyramid: Buffer,
    /// Samples.
    pub size: UVec2,
    pub float: bool,
    /// Where each level starts; `level_offsets.len()` levels from level 1.
    pub level_offsets: Vec<u32>,
    texture: Texture,
    /// Of the asset, as it was last uploaded.
    pub revision: u64,
    /// Samples uploaded whose nodes are still to be computed.
    pending: Option<URect>,
    /// The pyramid has been computed at least once.
    pub ready: bool,
    /// Distinguishes this upload's buffers from those of any other.
    pub generation: u64,
    bytes: u64,
    /// Lowest and highest sample of every node of [`TILE_LEVEL`], row by row. units: grid
    tile_heights: Vec<(f32, f32)>,
}

/// All fields that some terrain shows.
#[derive(Resource)]
pub struct GpuHeightFields {
    fields: HashMap<AssetId<HeightField>, GpuHeightField>,
    /// Fields this GPU cannot hold, and why.
    refused: HashMap<AssetId<HeightField>, Refused>,
    next_generation: u64,
    /// What they are on. Frames are extracted between the loss of a device and the making of all that is on the next, and
    /// then the render world's is another.
    device: RenderDevice,
    queue: RenderQueue,
}

/// A field that is not on the GPU.
struct Refused {
    /// Which state of it was refused.
    revision: u64,
    /// By the driver, which may take it once another field has gone; else by a limit.
    by_driver: bool,
    reason: String,
}

impl FromWorld for GpuHeightFields {
    fn from_world(world: &mut World) -> Self {
        Self {
            fields: HashMap::default(),
            refused: HashMap::default(),
            next_generation: 0,
            device: world.resource::<RenderDevice>().clone(),
            queue: world.resource::<RenderQueue>().clone(),
        }
    }
}

impl GpuHeightFields {
    pub fn get(&self, id: AssetId<HeightField>) -> Option<&GpuHeightField> {
        self.fields.get(&id)
    }

    /// Bytes of all textures, pyramids and uniforms.
    pub fn bytes(&self) -> u64 {
        let bytes = |field: &GpuHeightField| field.bytes + field.uniform.size();
        self.fields.values().map(bytes).sum()
    }

    /// Frees what no terrain shows any more.
    pub fn retain(&mut self, used: impl Fn(AssetId<HeightField>) -> bool) {
        let before = self.fields.len();
        self.fields.retain(|id, _| used(*id));
        let is_room = self.fields.len() < before;
        self.refused
            .retain(|id, of| used(*id) && !(is_room && of.by_driver));
    }

    /// Why fields are not on the GPU.
    pub fn reasons(&self) -> impl Iterator<Item = &String> {
        self.refused.values().map(|of| &of.reason)
    }

    /// Brings one field up to date: uploads what has changed since it was last seen.
    pub fn upload(&mut self, id: AssetId<HeightField>, field: &HeightField) {
        let float = matches!(field.samples(), HeightSamples::F32(_));
        let known = self
            .fields
            .get(&id)
            .filter(|gpu| gpu.size == field.size() && gpu.float == float);
        let edited = match known.map(|gpu| field.changed_since(gpu.revision)) {
            Some(HeightFieldChanged::Nothing) => return,
            Some(HeightFieldChanged::Rect(rect)) => Some(rect),
            Some(HeightFieldChanged::Everything) => Some(whole(field)),
            None if self.is_refused(id, field) => return,
            None => match check_limits(field, &self.device.limits()) {
                Ok(()) => None,
                Err(reason) => return self.refuse(id, field, reason, false),
            },
        };
        if edited.is_none() {
            self.next_generation += 1;
        }
        let Self {
            fields,
            next_generation,
            device,
            queue,
            ..
        } = self;
        let uploaded = checked(device.wgpu_device(), || {
            if edited.is_none() {
                let gpu = GpuHeightField::new(field, float, *next_generation, device, queue);
                fields.insert(id, gpu);
            }
            if let Some(gpu) = fields.get_mut(&id) {
                let rect = edited.unwrap_or_else(|| whole(field));
                gpu.write(field.samples(), rect, queue);
                gpu.note_tile_heights(field.pyramid(), rect);
                gpu.revision = field.revision();
                gpu.pending = Some(gpu.pending.map_or(rect, |old| old.union(rect)));
            }
        });
        match uploaded {
            Ok(()) => {
                self.refused.remove(&id);
            }
            Err(why) => {
                let size = field.size();
                let reason = format!(
                    "a height field of {}x{} samples is not on the GPU, as its driver says: {why}; free memory of it, \
                     or reduce the field",
                    size.x, size.y
                );
                self.refuse(id, field, reason, true);
            }
        }
    }

    /// Whether it is as it was when it was refused: trying again would come to the same.
    fn is_refused(&self, id: AssetId<HeightField>, field: &HeightField) -> bool {
        let refused = self.refused.get(&id);
        refused.is_some_and(|of| of.revision == field.revision())
    }

    fn refuse(
        &mut self,
        id: AssetId<HeightField>,
        field: &HeightField,
        reason: String,
        by_driver: bool,
    ) {
        error!("{reason}");
        let refused = Refused {
            revision: field.revision(),
            by_driver,
            reason,
        };
        self.refused.insert(id, refused);
        self.fields.remove(&id);
    }
}

/// All samples.
fn whole(field: &HeightField) -> URect {
    URect::from_corners(UVec2::ZERO, field.size())
}

/// Whether this GPU can hold the field; the reason names the limit.
fn check_limits(field: &HeightField, limits: &WgpuLimits) -> Result<(), String> {
    let size = field.size();
    let largest = limits.max_texture_dimension_2d;
    if size.max_element() > largest {
        return Err(format!(
            "a height field of {}x{} samples is larger than this GPU's max_texture_dimension_2d of \
             {largest}: split it into several terrains, or reduce it",
            size.x, size.y
        ));
    }
    let node_bytes = if matches!(field.samples(), HeightSamples::F32(_)) {
        8
    } else {
        4
    };
    let bytes = field.pyramid().node_count() as u64 * node_bytes;
    let most = limits
        .max_storage_buffer_binding_size
        .min(limits.max_buffer_size);
    if bytes > most {
        return Err(format!(
            "the pyramid of a height field of {}x{} samples takes {bytes} bytes, more than this GPU's \
             max_storage_buffer_binding_size of {most}: split it into several terrains, or reduce it",
            size.x, size.y
        ));
    }
    Ok(())
}

impl GpuHeightField {
    fn new(
        field: &HeightField,
        float: bool,
        generation: u64,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> Self {
        let size = field.size();
        let (format, sample_bytes, node_bytes) = if float {
            (TextureFormat::R32Float, 4, 8)
        } else {
            (TextureFormat::R16Uint, 2, 4)
        };
        let texture = device.create_texture(&TextureDescriptor {
            label: Some("skyline_heights"),
            size: Extent3d {
                width: size.x,
                height: size.y,
                depth_or_array_layers: 1,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format,
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let pyramid = field.pyramid();
        let pyramid_bytes = pyramid.node_count() as u64 * node_bytes;
        let buffer = device.create_buffer(&BufferDescriptor {
            label: Some("skyline_pyramid"),
            size: pyramid_bytes,
            usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let level_offsets = offsets(pyramid);
        let mut level = [UVec4::ZERO; 32];
        for (k, offset) in (1..).zip(&level_offsets) {
            let nodes = pyramid.level_size(k);
            level[k as usize] = UVec4::new(*offset, nodes.x, nodes.y, 0);
        }
        let of_field = GpuField {
            cells: field.cells().as_ivec2(),
            levels: level_offsets.len() as u32,
            level,
        };
        // A buffer that is mapped from the start cannot be made on a device that was lost.
        let uniform = device.create_buffer(&BufferDescriptor {
            label: Some("skyline_field"),
            size: of_field.size().get(),
            usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut bytes = encase::UniformBuffer::new(Vec::new());
        // Memory is all that it could lack.
        if bytes.write(&of_field).is_ok() {
            queue.write_buffer(&uniform, 0, bytes.as_ref());
        }
        Self {
            uniform,
            heights: texture.create_view(&TextureViewDescriptor::default()),
            pyramid: buffer,
            size,
            float,
            level_offsets,
            texture,
            revision: 0,
            pending: None,
            ready: false,
            generation,
            bytes: u64::from(size.x) * u64::from(size.y) * sample_bytes + pyramid_bytes,
            tile_heights: Vec::new(),
        }
    }

    /// Whether all heights are uploaded and their pyramid is computed.
    pub fn is_settled(&self) -> bool {
        self.ready && self.pending.is_none()
    }

    /// Lowest and highest sample within a tile of shadow maps; `None` for larger rectangles and smaller fields.
    pub fn heights_over(&self, samples: URect) -> Option<(f64, f64)> {
        if samples.size().max_element() > TILE {
            return None;
        }
        let nodes = (self.size - 1).map(|cells| cells.div_ceil(TILE));
        let node = (samples.min / TILE).min(nodes - 1);
        let &(low, high) = self
            .tile_heights
            .get((node.y * nodes.x + node.x) as usize)?;
        Some((f64::from(low), f64::from(high)))
    }

    fn note_tile_heights(&mut self, pyramid: &MinMaxPyramid, rect: URect) {
        if pyramid.levels() < TILE_LEVEL {
            return;
        }
        let size = pyramid.level_size(TILE_LEVEL);
        self.tile_heights
            .resize((size.x * size.y) as usize, (0.0, 0.0));
        let nodes = pyramid.affected_nodes(TILE_LEVEL, rect);
        for j in nodes.min.y..nodes.max.y {
            for i in nodes.min.x..nodes.max.x {
                let (high, low) = pyramid.get(TILE_LEVEL, i, j);
                self.tile_heights[(j * size.x + i) as usize] = (low as f32, high as f32);
            }
        }
    }

    /// Uploads a rectangle straight out of the asset's rows; nothing is copied on the way.
    fn write(&self, samples: &HeightSamples, rect: URect, queue: &RenderQueue) {
        let (bytes, sample_bytes): (&[u8], u32) = match samples {
            HeightSamples::U16(samples) => (bytemuck::cast_slice(samples), 2),
            HeightSamples::F32(samples) => (bytemuck::cast_slice(samples), 4),
        };
        let offset = u64::from(rect.min.y * self.size.x + rect.min.x) * u64::from(sample_bytes);
        queue.write_texture(
            TexelCopyTextureInfo {
                texture: &self.texture,
                mip_level: 0,
                origin: Origin3d {
                    x: rect.min.x,
                    y: rect.min.y,
                    z: 0,
                },
                aspect: TextureAspect::All,
            },
            bytes,
            TexelCopyBufferLayout {
                offset,
                bytes_per_row: Some(self.size.x * sample_bytes),
                rows_per_image: None,
            },
            Extent3d {
                width: rect.width(),
                height: rect.height(),
                depth_or_array_layers: 1,
            },
        );
    }
}

/// Where each level of a pyramid starts, from level 1.
fn offsets(pyramid: &MinMaxPyramid) -> Vec<u32> {
    (1..=pyramid.levels())
        .map(|k| pyramid.level_offset(k) as u32)
        .collect()
}

/// The levels to compute for a rectangle of samples, bottom-up.
fn levels_under(
    size: UVec2,
    level_offsets: &[u32],
    rect: URect,
) -> impl Iterator<Item = GpuMipLevel> + '_ {
    let cells = size - 1;
    let size_of = move |k: usize| (cells + (1 << k) - 1) >> k as u32;
    (1..=level_offsets.len()).map(move |k| {
        let level_size = size_of(k);
        let node = 1u32 << k;
        // A sample on a node's border belongs to the nodes on both sides.
        let first = (rect.min.saturating_sub(UVec2::ONE) / node).min(level_size - 1);
        let last = ((rect.max - 1) / node).min(level_size - 1);
        GpuMipLevel {
            first: first.as_ivec2(),
            count: (last - first + 1).as_ivec2(),
            size_in: if k == 1 { size } else { size_of(k - 1) }.as_ivec2(),
            offset_in: if k == 1 { 0 } else { level_offsets[k - 2] },
            offset_out: level_offsets[k - 1],
            width_out: level_size.x as i32,
            level: k as u32,
        }
    })
}

/// The pass: computes what uploads have left pending. Does nothing, and allocates nothing, otherwise.
pub fn height_mips(
    mut fields: ResMut<GpuHeightFields>,
    mut pipelines: ResMut<TerrainPipelines>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    stats: Res<TerrainStats>,
    mut ctx: RenderContext,
) {
    if fields.fields.values().all(|field| field.pending.is_none()) {
        return;
    }
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    for field in fields.fields.values_mut() {
        let Some(rect) = field.pending else { continue };
        let key = PipelineKey::HeightMips { float: field.float };
        let PipelineId::Compute(id) = pipelines.get(&cache, key) else {
            continue;
        };
        let Some(pipeline) = cache.get_compute_pipeline(id) else {
            continue;
        };
        let mut uniforms = DynamicUniformBuffer::<GpuMipLevel>::default();
        uniforms.set_label(Some("skyline_mip_levels"));
        let levels: Vec<_> = levels_under(field.size, &field.level_offsets, rect)
            .map(|level| (uniforms.push(&level), level.count.as_uvec2()))
            .collect();
        uniforms.write_buffer(&device, &queue);
        let Some(binding) = uniforms.binding() else {
            continue;
        };
        let bind_group = device.create_bind_group(
            "skyline_height_mips",
            &cache.get_bind_group_layout(pipelines.height_mips(field.float)),
            &BindGroupEntries::sequential((
                binding,
                &field.heights,
                field.pyramid.as_entire_binding(),
            )),
        );
        let span = diagnostics.time_span(ctx.command_encoder(), "height_mips");
        {
            let mut pass = ctx
                .command_encoder()
                .begin_compute_pass(&ComputePassDescriptor {
                    label: Some("height_mips"),
                    timestamp_writes: None,
                });
            pass.set_pipeline(pipeline);
            for (offset, count) in levels {
                pass.set_bind_group(0, &bind_group, &[offset]);
                pass.dispatch_workgroups(count.x.div_ceil(8), count.y.div_ceil(8), 1);
                stats.count_dispatch("height_mips", u64::from(count.x) * u64::from(count.y));
            }
        }
        span.end(ctx.command_encoder());
        field.pending = None;
        field.ready = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_beyond_a_limit_is_refused_by_that_limits_name() {
        let field = HeightField::from_fn(UVec2::new(65, 33), 1.0, (0.0, 1.0), |_, _| 0.5).unwrap();
        assert_eq!(check_limits(&field, &WgpuLimits::default()), Ok(()));
        let narrow = WgpuLimits {
            max_texture_dimension_2d: 64,
            ..default()
        };
        let reason = check_limits(&field, &narrow).unwrap_err();
        assert!(
            reason.contains("max_texture_dimension_2d of 64"),
            "{reason}"
        );
        let small = WgpuLimits {
            max_storage_buffer_binding_size: 256,
            ..default()
        };
        let reason = check_limits(&field, &small).unwrap_err();
        assert!(
            reason.contains("max_storage_buffer_binding_size of 256"),
            "{reason}"
        );
    }

    #[test]
    fn an_edit_reaches_the_nodes_on_both_sides_of_a_shared_sample() {
        let field = HeightField::from_fn(UVec2::new(9, 9), 1.0, (0.0, 1.0), |_, _| 0.5).unwrap();
        let pyramid = field.pyramid();
        for rect in [
            URect::new(4, 4, 5, 5),
            URect::new(0, 0, 9, 9),
            URect::new(8, 3, 9, 4),
        ] {
            for k in 1..=pyramid.levels() {
                let expected = pyramid.affected_nodes(k, rect);
                let level = levels_under(field.size(), &offsets(pyramid), rect)
                    .nth(k as usize - 1)
                    .unwrap();
                assert_eq!(
                    level.first.as_uvec2(),
                    expected.min,
                    "level {k} under {rect:?}"
                );
                assert_eq!(
                    level.count.as_uvec2(),
                    expected.size(),
                    "level {k} under {rect:?}"
                );
            }
        }
    }
}
