//! What is on the device while a field is made, and what is asked of it.

use core::{
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
    time::Duration,
};
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
    time::Instant,
};

use wgpu::{
    BindGroupDescriptor, BindGroupEntry, BindingResource, Buffer, BufferBinding, BufferDescriptor,
    BufferUsages, CommandEncoderDescriptor, ComputePassDescriptor, ComputePipeline,
    ComputePipelineDescriptor, Device, MapMode, PollType, ShaderModuleDescriptor, ShaderSource,
};

use super::{
    super::{field::Field, lattice::Lattice},
    INTERIOR_FIELD_WGSL, InteriorGpu, InteriorGpuError, Slabs,
    piece::Piece,
};

/// Pieces of a submission: few, so that a frame that is drawn meanwhile does not wait long for it. At worst, six million
/// boxes.
pub(super) const PIECES: usize = 8_192;
/// Invocations of a workgroup.
pub(super) const PIECES_IN_GROUP: usize = 64;
/// Submissions that the GPU may have before it when it gets another: enough to keep it busy while the next is made.
pub(super) const AHEAD: u64 = 2;
/// How long to sleep before asking again whether the GPU is done.
const SLEEP: Duration = Duration::from_micros(200);
/// A GPU that does nothing for so long does nothing more.
const PATIENCE: Duration = Duration::from_secs(60);

/// Mirrors the shader's `Slab`.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
struct GpuSlab {
    words_in_row: u32,
    rows_in_layer: u32,
    first_layer: u32,
    words_in_direction: u32,
    has_down: u32,
    _to_16: [u32; 3],
}

/// What is on the device while a field is made.
pub(super) struct Stream {
    gpu: InteriorGpu,
    pipeline: ComputePipeline,
    slab: Buffer,
    pieces: Buffer,
    bits: Buffer,
    back: Buffer,
    lattice: Lattice,
    is_one_sided: bool,
    submitted: u64,
    done: Arc<AtomicU64>,
}

impl Stream {
    pub(super) fn new(
        gpu: &InteriorGpu,
        lattice: &Lattice,
        slabs: &Slabs,
    ) -> Result<Self, InteriorGpuError> {
        let device = &gpu.device;
        let bits = Self::words(lattice, slabs.layers) * 4 * if slabs.is_one_sided { 6 } else { 3 };
        checked(device, || {
            let module = device.create_shader_module(ShaderModuleDescriptor {
                label: Some("interior_field"),
                source: ShaderSource::Wgsl(INTERIOR_FIELD_WGSL.into()),
            });
            let pipeline = device.create_compute_pipeline(&ComputePipelineDescriptor {
                label: Some("interior_field"),
                layout: None,
                module: &module,
                entry_point: Some("interior_field"),
                compilation_options: Default::default(),
                cache: None,
            });
            let buffer = |label, size, usage| {
                device.create_buffer(&BufferDescriptor {
                    label: Some(label),
                    size,
                    usage,
                    mapped_at_creation: false,
                })
            };
            Self {
                gpu: gpu.clone(),
                pipeline,
                slab: buffer(
                    "interior_field_slab",
                    size_of::<GpuSlab>() as u64,
                    BufferUsages::UNIFORM | BufferUsages::COPY_DST,
                ),
                pieces: buffer(
                    "interior_field_pieces",
                    (PIECES * size_of::<Piece>()) as u64,
                    BufferUsages::STORAGE | BufferUsages::COPY_DST,
                ),
                bits: buffer(
                    "interior_field_bits",
                    bits,
                    BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC,
                ),
                back: buffer(
                    "interior_field_back",
                    bits,
                    BufferUsages::MAP_READ | BufferUsages::COPY_DST,
                ),
                lattice: *lattice,
                is_one_sided: slabs.is_one_sided,
                submitted: 0,
                done: Arc::default(),
            }
        })
    }

    /// Words of 32 bits of one direction.
    fn words(lattice: &Lattice, layers: u32) -> u64 {
        u64::from(layers) * u64::from(lattice.size[1]) * lattice.words as u64 * 2
    }

    /// Nothing is in the way of a slab's steps.
    pub(super) fn begin(&mut self, layers: &Range<u32>) -> Result<(), InteriorGpuError> {
        let slab = GpuSlab {
            words_in_row: 2 * self.lattice.words as u32,
            rows_in_layer: self.lattice.size[1],
            first_layer: layers.start,
            words_in_direction: Self::words(&self.lattice, layers.len() as u32) as u32,
            has_down: self.is_one_sided.into(),
            _to_16: [0; 3],
        };
        checked(&self.gpu.device, || {
            self.gpu
                .queue
                .write_buffer(&self.slab, 0, bytemuck::bytes_of(&slab));
            let mut encoder = self.encoder();
            encoder.clear_buffer(&self.bits, 0, None);
            self.gpu.queue.submit([encoder.finish()]);
        })
    }

    /// Sets the bits of pieces, at most `PIECES`.
    pub(super) fn submit(&mut self, pieces: &[Piece]) -> Result<(), InteriorGpuError> {
        self.wait(|stream| stream.done.load(Ordering::Acquire) + AHEAD >= stream.submitted)?;
        let bytes: &[u8] = bytemuck::cast_slice(pieces);
        checked(&self.gpu.device, || {
            let whole = |buffer| {
                BindingResource::Buffer(BufferBinding {
                    buffer,
                    offset: 0,
                    size: None,
                })
            };
            let entry = |binding, resource| BindGroupEntry { binding, resource };
            self.gpu.queue.write_buffer(&self.pieces, 0, bytes);
            let group = self.gpu.device.create_bind_group(&BindGroupDescriptor {
                label: Some("interior_field"),
                layout: &self.pipeline.get_bind_group_layout(0),
                entries: &[
                    entry(0, whole(&self.slab)),
                    entry(
                        1,
                        BindingResource::Buffer(BufferBinding {
                            buffer: &self.pieces,
                            offset: 0,
                            size: core::num::NonZero::new(bytes.len() as u64),
                        }),
                    ),
                    entry(2, whole(&self.bits)),
                ],
            });
            let mut encoder = self.encoder();
            {
                let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor {
                    label: Some("interior_field"),
                    timestamp_writes: None,
                });
                pass.set_pipeline(&self.pipeline);
                pass.set_bind_group(0, &group, &[]);
                pass.dispatch_workgroups(pieces.len().div_ceil(PIECES_IN_GROUP) as u32, 1, 1);
            }
            self.gpu.queue.submit([encoder.finish()]);
            let done = self.done.clone();
            self.gpu.queue.on_submitted_work_done(move || {
                done.fetch_add(1, Ordering::Release);
            });
        })?;
        self.submitted += 1;
        Ok(())
    }

    pub(super) fn read_back(
        &mut self,
        lattice: &Lattice,
        layers: &Range<u32>,
        field: &mut Field,
    ) -> Result<(), InteriorGpuError> {
        let direction = 4 * Self::words(lattice, layers.len() as u32);
        let whole = direction * if self.is_one_sided { 6 } else { 3 };
        // 0: not yet; 1: mapped; 2: failed.
        let mapped = Arc::new(AtomicU64::new(0));
        checked(&self.gpu.device, || {
            let mut encoder = self.encoder();
            encoder.copy_buffer_to_buffer(&self.bits, 0, &self.back, 0, whole);
            self.gpu.queue.submit([encoder.finish()]);
            let mapped = mapped.clone();
            self.back.map_async(MapMode::Read, 0..whole, move |result| {
                mapped.store(if result.is_ok() { 1 } else { 2 }, Ordering::Release);
            });
        })?;
        self.wait(|_| mapped.load(Ordering::Acquire) != 0)?;
        if mapped.load(Ordering::Acquire) != 1 {
            return Err(InteriorGpuError::NoAnswer);
        }
        let start = lattice.row(0, layers.start);
        // It panics where the device was lost since.
        let read = catch_unwind(AssertUnwindSafe(|| {
            let bytes = self.back.get_mapped_range(0..whole);
            let all = field.up.iter_mut().chain(field.down.iter_mut().flatten());
            for (words, bytes) in all.zip(bytes.chunks_exact(direction as usize)) {
                let (bytes, _) = bytes.as_chunks::<8>();
                for (word, bytes) in words[start..].iter_mut().zip(bytes) {
                    *word = u64::from_le_bytes(*bytes);
                }
            }
        }));
        read.map_err(|_| InteriorGpuError::NoAnswer)?;
        self.back.unmap();
        Ok(())
    }

    fn encoder(&self) -> wgpu::CommandEncoder {
        self.gpu
            .device
            .create_command_encoder(&CommandEncoderDescriptor {
                label: Some("interior_field"),
            })
    }

    /// Waits without keeping other threads from the device.
    fn wait(&self, is_done: impl Fn(&Self) -> bool) -> Result<(), InteriorGpuError> {
        let since = Instant::now();
        while !is_done(self) {
            // It panics where the device is lost.
            let polled = catch_unwind(AssertUnwindSafe(|| self.gpu.device.poll(PollType::Poll)));
            let is_gone = self.gpu.is_gone.load(Ordering::Relaxed);
            if is_gone || !matches!(polled, Ok(Ok(_))) || since.elapsed() > PATIENCE {
                return Err(InteriorGpuError::NoAnswer);
            }
            if !is_done(self) {
                std::thread::sleep(SLEEP);
            }
        }
        Ok(())
    }
}

/// Does what may fail on the device, and says so instead of telling the app.
fn checked<T>(device: &Device, work: impl FnOnce() -> T) -> Result<T, InteriorGpuError> {
    crate::device_errors::checked(device, work).map_err(InteriorGpuError::Device)
}
