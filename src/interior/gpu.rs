//! The directed distance field on the GPU: the same bits as on the CPU, as both compute with the same integers.
//!
//! # How it goes
//! - The host takes each triangle to [`Piece`]s: itself and a box of lattice points that it may come near, of at most
//!   [`MOST_POINTS`]. A large triangle is taken apart, halving its box and dropping the halves that it does not reach
//!   ([`Snapped::overlaps`]), until the boxes are small. So the work of an invocation, and with it that of a submission
//!   of [`PIECES`] pieces, has a bound that does not depend on the model: no watchdog bites, and a frame that is drawn
//!   meanwhile waits for few submissions at most, [`AHEAD`] and the one being worked on. Leaving large triangles to the CPU would need no such division, but a model
//!   of few large triangles on a fine grid, walls, is where the field takes longest, and the CPU would have all of it.
//! - The field is made in slabs of layers across z, one after another, as many layers as fit into the memory that is
//!   allowed and into one binding. A step's bit is at its lower point, so no two slabs share one.
//! - Pieces of any triangles, in any order, from any thread, are collected to submissions
//!   (`assets/shaders/interior_field.wgsl`), which set bits.
//! - A slab's bits are read back into the [`Field`]: what comes after (`front`) goes along rows and runs on the CPU.
//!
//! # Threads
//! Any thread but the one that draws. [`wgpu::Device::poll`] is never told to wait: while it waits it holds a lock that
//! [`wgpu::Queue::submit`] needs, so that nothing could be drawn meanwhile. It is asked again and again instead.

use core::{
    ops::Range,
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
    time::Duration,
};
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use bevy::tasks::futures::now_or_never;
use wgpu::{
    BindGroupDescriptor, BindGroupEntry, BindingResource, Buffer, BufferBinding, BufferDescriptor,
    BufferUsages, CommandEncoderDescriptor, ComputePassDescriptor, ComputePipeline,
    ComputePipelineDescriptor, Device, ErrorFilter, MapMode, PollType, Queue,
    ShaderModuleDescriptor, ShaderSource,
};

use super::{
    field::Field,
    lattice::{Lattice, SEAL_UNITS, UNITS},
    overlap::Snapped,
};

/// `assets/shaders/interior_field.wgsl`. It does not go through the app's assets and its pipeline cache, as those answer
/// only while frames are drawn.
pub const INTERIOR_FIELD_WGSL: &str = include_str!("../../assets/shaders/interior_field.wgsl");
/// Lattice points of a piece. Sums over as many fit into the 32 bits that the shader has for them.
const MOST_POINTS: i64 = 256;
/// Pieces of a submission.
const PIECES: usize = 32_768;
/// Invocations of a workgroup.
const PIECES_IN_GROUP: usize = 64;
/// Submissions that the GPU may have before it.
const AHEAD: u64 = 2;
/// How long to sleep before asking again whether the GPU is done.
const SLEEP: Duration = Duration::from_micros(200);
/// A GPU that does nothing for so long does nothing more.
const PATIENCE: Duration = Duration::from_secs(60);
/// What the GPU may have of its memory if nothing else is said. units: bytes
const MEMORY: u64 = 256 << 20;

/// Where the directed distance field is made.
#[derive(Clone, Copy, Debug, Default)]
pub enum FieldDevice<'a> {
    /// On the threads that cull.
    #[default]
    Cpu,
    /// On the GPU; if that fails, on the CPU.
    Gpu(&'a InteriorGpu),
}

/// Where a directed distance field was made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FieldOrigin {
    /// On the CPU, as it was asked to be.
    Cpu,
    /// On the GPU.
    Gpu,
    /// On the CPU, as the GPU could not.
    Fallback(InteriorGpuError),
}

/// Why the GPU could not make a field. The CPU can.
#[derive(thiserror::Error, Clone, Debug, PartialEq, Eq)]
pub enum InteriorGpuError {
    /// It runs no compute shaders, or too small ones.
    #[error("the device lacks what the compute pass needs: {0}")]
    Unsupported(&'static str),
    /// One layer of the lattice is more than is allowed.
    #[error(
        "one layer of the lattice takes {needs} bytes of the GPU where {allowed} are allowed; allow as much"
    )]
    Memory {
        /// What one layer takes, with all that is besides. units: bytes
        needs: u64,
        /// What is allowed. units: bytes
        allowed: u64,
    },
    /// One layer of the lattice is more than a binding can hold.
    #[error(
        "one layer of the lattice takes {needs} bytes where the device binds {most} at most; take a coarser grid"
    )]
    Binding {
        /// What one layer takes. units: bytes
        needs: u64,
        /// What the device binds. units: bytes
        most: u64,
    },
    /// The device has no memory left, or would not do something.
    #[error("the device says: {0}")]
    Device(String),
    /// The device was lost, or hangs.
    #[error("the device does not answer; it may be lost")]
    NoAnswer,
}

/// A GPU for interior culling. Holds nothing of it but the device and its queue: all else is made when a field is, and
/// let go after.
#[derive(Clone, Debug)]
pub struct InteriorGpu {
    device: Device,
    queue: Queue,
    memory: u64,
}

impl InteriorGpu {
    /// With up to 256 MiB of the GPU's memory.
    pub fn new(device: Device, queue: Queue) -> Self {
        Self {
            device,
            queue,
            memory: MEMORY,
        }
    }

    /// With up to so much of the GPU's memory, and of the host's for what is read back. units: bytes
    pub fn with_memory(self, memory: u64) -> Self {
        Self { memory, ..self }
    }

    /// The field of triangles, two-sided if their entry says so. `is_one_sided`: whether steps up and down are told
    /// apart.
    ///
    /// # Errors
    /// See [`InteriorGpuError`].
    pub fn field(
        &self,
        lattice: &Lattice,
        triangles: &[(Snapped, bool)],
        is_one_sided: bool,
    ) -> Result<Field, InteriorGpuError> {
        let slabs = self.slabs(lattice, is_one_sided)?;
        let made = self.make(lattice, &slabs, |feed| {
            feed.add(triangles.iter().copied());
            Ok::<_, core::convert::Infallible>(())
        });
        made.map_err(|stopped| match stopped {
            Stopped::Gpu(error) => error,
            Stopped::Host(never) => match never {},
        })
    }

    /// How a field is to be divided.
    ///
    /// # Errors
    /// A device without compute shaders; a layer that is too large.
    pub(super) fn slabs(
        &self,
        lattice: &Lattice,
        is_one_sided: bool,
    ) -> Result<Slabs, InteriorGpuError> {
        let limits = self.device.limits();
        let groups = PIECES.div_ceil(PIECES_IN_GROUP) as u32;
        if limits.max_compute_workgroups_per_dimension < groups
            || limits.max_compute_invocations_per_workgroup < PIECES_IN_GROUP as u32
            || limits.max_compute_workgroup_size_x < PIECES_IN_GROUP as u32
        {
            return Err(InteriorGpuError::Unsupported("compute shaders"));
        }
        if limits.max_storage_buffers_per_shader_stage < 2 {
            return Err(InteriorGpuError::Unsupported("two storage buffers"));
        }
        let [_, size_y, size_z] = lattice.size;
        let directions = if is_one_sided { 6 } else { 3 };
        let layer = directions * u64::from(size_y) * lattice.words as u64 * 8;
        // The shader counts words in 32 bits.
        let most = limits
            .max_storage_buffer_binding_size
            .min(limits.max_buffer_size)
            .min(u64::from(u32::MAX));
        // Pieces: those being worked on, and those on their way.
        let besides = (1 + AHEAD + 1) * PIECES as u64 * size_of::<Piece>() as u64;
        // Bits: on the device, and where they are read back.
        let needs = 2 * layer + besides;
        if layer > most {
            return Err(InteriorGpuError::Binding { needs: layer, most });
        }
        if needs > self.memory {
            return Err(InteriorGpuError::Memory {
                needs,
                allowed: self.memory,
            });
        }
        let fit = (most / layer).min((self.memory - besides) / (2 * layer));
        let count = u64::from(size_z).div_ceil(fit);
        Ok(Slabs {
            // No more than fit, as there are at most so many to each.
            layers: u64::from(size_z).div_ceil(count) as u32,
            size_z,
            is_one_sided,
        })
    }

    /// Makes a field, slab by slab: `feed` is called once for each, and adds all triangles.
    pub(super) fn make<E>(
        &self,
        lattice: &Lattice,
        slabs: &Slabs,
        mut feed: impl FnMut(&Feed) -> Result<(), E>,
    ) -> Result<Field, Stopped<E>> {
        let mut stream = Stream::new(self, lattice, slabs)?;
        let mut field = Field::empty(lattice, slabs.is_one_sided);
        for layers in slabs.iter() {
            stream.begin(&layers)?;
            let feeding = Feed {
                layers: layers.start as i32..layers.end as i32,
                stream: Mutex::new(Ok(stream)),
                spare: Mutex::default(),
                has_failed: AtomicBool::new(false),
            };
            feed(&feeding).map_err(Stopped::Host)?;
            stream = feeding.finish()?;
            stream.read_back(lattice, &layers, &mut field)?;
        }
        Ok(field)
    }
}

/// How a field is divided into slabs.
#[derive(Clone, Debug)]
pub(super) struct Slabs {
    layers: u32,
    size_z: u32,
    is_one_sided: bool,
}

impl Slabs {
    pub(super) fn len(&self) -> usize {
        self.size_z.div_ceil(self.layers) as usize
    }

    fn iter(&self) -> impl Iterator<Item = Range<u32>> {
        let (layers, size_z) = (self.layers, self.size_z);
        (0..size_z)
            .step_by(layers as usize)
            .map(move |first| first..size_z.min(first + layers))
    }
}

/// Why a field was not made.
pub(super) enum Stopped<E> {
    /// The GPU could not.
    Gpu(InteriorGpuError),
    /// Who feeds it said so.
    Host(E),
}

impl<E> From<InteriorGpuError> for Stopped<E> {
    fn from(error: InteriorGpuError) -> Self {
        Self::Gpu(error)
    }
}

/// Takes a slab's triangles, from several threads.
pub(super) struct Feed {
    layers: Range<i32>,
    stream: Mutex<Result<Stream, InteriorGpuError>>,
    /// Pieces that are not yet enough for a submission, as many lots as there are threads.
    spare: Mutex<Vec<Vec<Piece>>>,
    has_failed: AtomicBool,
}

impl Feed {
    /// The triangles are in the way; two-sided if their entry says so. Waits where the GPU does not keep up.
    pub(super) fn add(&self, triangles: impl Iterator<Item = (Snapped, bool)>) {
        let mut pieces = lock(&self.spare).pop().unwrap_or_default();
        for (triangle, is_two_sided) in triangles {
            if self.has_failed.load(Ordering::Relaxed) {
                return;
            }
            Piece::each(&triangle, is_two_sided, &self.layers, &mut |piece| {
                pieces.push(piece);
                if pieces.len() == PIECES {
                    self.send(&mut pieces);
                }
            });
        }
        lock(&self.spare).push(pieces);
    }

    fn send(&self, pieces: &mut Vec<Piece>) {
        let mut stream = lock(&self.stream);
        if let Ok(open) = &mut *stream
            && let Err(error) = open.submit(pieces)
        {
            *stream = Err(error);
            self.has_failed.store(true, Ordering::Relaxed);
        }
        pieces.clear();
    }

    fn finish(self) -> Result<Stream, InteriorGpuError> {
        let mut last = Vec::new();
        for piece in core::mem::take(&mut *lock(&self.spare))
            .into_iter()
            .flatten()
        {
            last.push(piece);
            if last.len() == PIECES {
                self.send(&mut last);
            }
        }
        if !last.is_empty() {
            self.send(&mut last);
        }
        self.stream
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

/// A triangle, and lattice points whose steps it may be in the way of; mirrors the shader's `Piece`.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
struct Piece {
    corners: [[i32; 3]; 3],
    first: [i32; 3],
    last: [i32; 3],
    is_two_sided: u32,
}

impl Piece {
    /// Calls for each piece of a triangle that has points in the layers.
    fn each(
        triangle: &Snapped,
        is_two_sided: bool,
        layers: &Range<i32>,
        found: &mut impl FnMut(Self),
    ) {
        // The box around a step reaches from its point by the seal downwards, and by that and a spacing upwards. What
        // touches, overlaps.
        let mut first = triangle
            .least
            .map(|least| (least - SEAL_UNITS - UNITS + (UNITS - 1)).div_euclid(UNITS));
        let mut last = triangle
            .greatest
            .map(|greatest| (greatest + SEAL_UNITS).div_euclid(UNITS));
        first[2] = first[2].max(layers.start);
        last[2] = last[2].min(layers.end - 1);
        let whole = Self {
            corners: triangle.corners,
            first,
            last,
            is_two_sided: is_two_sided.into(),
        };
        if (0..3).all(|axis| first[axis] <= last[axis]) {
            whole.divide(triangle, found);
        }
    }

    fn divide(self, triangle: &Snapped, found: &mut impl FnMut(Self)) {
        let size: [i64; 3] =
            core::array::from_fn(|axis| i64::from(self.last[axis] - self.first[axis] + 1));
        if size.iter().product::<i64>() <= MOST_POINTS {
            return found(self);
        }
        let longest = (0..3).max_by_key(|axis| size[*axis]).unwrap_or(0);
        let middle = (self.first[longest] + self.last[longest]).div_euclid(2);
        let (mut low, mut high) = (self, self);
        low.last[longest] = middle;
        high.first[longest] = middle + 1;
        for half in [low, high] {
            if half.is_reached(triangle) {
                half.divide(triangle, found);
            }
        }
    }

    /// Whether the triangle comes near any step of the points.
    fn is_reached(&self, triangle: &Snapped) -> bool {
        let centre =
            core::array::from_fn(|axis| (self.first[axis] + self.last[axis] + 1) * (UNITS / 2));
        let half = core::array::from_fn(|axis| {
            (self.last[axis] - self.first[axis] + 1) * (UNITS / 2) + SEAL_UNITS
        });
        triangle.overlaps(centre, half)
    }
}

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
struct Stream {
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
    fn new(gpu: &InteriorGpu, lattice: &Lattice, slabs: &Slabs) -> Result<Self, InteriorGpuError> {
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
    fn begin(&mut self, layers: &Range<u32>) -> Result<(), InteriorGpuError> {
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

    /// Sets the bits of pieces, at most [`PIECES`].
    fn submit(&mut self, pieces: &[Piece]) -> Result<(), InteriorGpuError> {
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

    fn read_back(
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
        {
            let bytes = self.back.get_mapped_range(0..whole);
            let all = field.up.iter_mut().chain(field.down.iter_mut().flatten());
            for (words, bytes) in all.zip(bytes.chunks_exact(direction as usize)) {
                let (bytes, _) = bytes.as_chunks::<8>();
                for (word, bytes) in words[start..].iter_mut().zip(bytes) {
                    *word = u64::from_le_bytes(*bytes);
                }
            }
        }
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
            if !matches!(polled, Ok(Ok(_))) || since.elapsed() > PATIENCE {
                return Err(InteriorGpuError::NoAnswer);
            }
            if !is_done(self) {
                std::thread::sleep(SLEEP);
            }
        }
        Ok(())
    }
}

/// Does what may fail on the device, and says so instead of telling the app. What other threads do is their own.
fn checked<T>(device: &Device, work: impl FnOnce() -> T) -> Result<T, InteriorGpuError> {
    let memory = device.push_error_scope(ErrorFilter::OutOfMemory);
    let validation = device.push_error_scope(ErrorFilter::Validation);
    let internal = device.push_error_scope(ErrorFilter::Internal);
    let result = work();
    // Natively, what they give is there at once.
    let errors = [
        now_or_never(internal.pop()),
        now_or_never(validation.pop()),
        now_or_never(memory.pop()),
    ];
    match errors.into_iter().flatten().flatten().next() {
        Some(error) => Err(InteriorGpuError::Device(error.to_string())),
        None => Ok(result),
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
