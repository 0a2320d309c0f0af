//! The directed distance field on the GPU: the same bits as on the CPU, as both compute with the same integers.
//!
//! # How it goes
//! - The host makes *pieces* of each triangle: itself and a box of lattice points that it may come near, of at most
//!   `MOST_POINTS`. A large triangle is taken apart, halving its box and dropping the halves that it does not reach
//!   ([`Snapped::overlaps`]), until the boxes are small. So the work of an invocation, and with it that of a submission
//!   of `PIECES` pieces, has a bound that does not depend on the model: no watchdog bites, and a frame that is drawn
//!   meanwhile waits for at most the `AHEAD` + 1 submissions that may be before it. The CPU could do the large
//!   triangles instead, but where they are what takes long, walls on a fine grid, it would have nearly all of the work;
//!   to find their pieces takes it a third of the time that it takes to find their steps.
//! - The field is made in slabs of layers across z, one after another, as many layers as fit into the memory that is
//!   allowed and into one binding. A step's bit is at its lower point, so no two slabs share one.
//! - Pieces of any triangles, in any order, from any thread, are collected to submissions
//!   (`assets/shaders/interior_field.wgsl`), which set bits.
//! - A slab's bits are read back into the [`Field`]: what comes after (`front`) goes along rows and runs on the CPU.
//!
//! # Threads
//! Any thread but the one that draws. [`wgpu::Device::poll`] is never told to wait: while it waits it holds a lock that
//! [`wgpu::Queue::submit`] needs, so that nothing could be drawn meanwhile. It is asked again and again instead.

mod feed;
mod piece;
mod stream;

use core::{
    ops::Range,
    sync::atomic::{AtomicBool, Ordering},
};
use std::sync::Arc;

use wgpu::{Device, Queue};

pub(super) use feed::Feed;

use self::{
    piece::Piece,
    stream::{AHEAD, PIECES, PIECES_IN_GROUP, Stream},
};
use super::{field::Field, lattice::Lattice, overlap::Snapped};

/// `assets/shaders/interior_field.wgsl`. It goes past the app's assets and its pipeline cache, as those answer
/// only while frames are drawn.
pub const INTERIOR_FIELD_WGSL: &str = include_str!("../../../assets/shaders/interior_field.wgsl");
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
#[non_exhaustive]
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
    /// Another has come for it, so that it answers no more.
    is_gone: Arc<AtomicBool>,
}

impl InteriorGpu {
    /// With up to 256 MiB of the GPU's memory. Bevy's device and queue are what its `RenderDevice` and `RenderQueue` are
    /// around; clones of them are handles to the same.
    pub fn new(device: Device, queue: Queue) -> Self {
        Self {
            device,
            queue,
            memory: MEMORY,
            is_gone: Arc::default(),
        }
    }

    /// Has whoever waits for it wait no longer, as it was lost and another has come.
    pub(crate) fn give_up(&self) {
        self.is_gone.store(true, Ordering::Relaxed);
    }

    /// With up to so much of the GPU's memory, what is read back and what is on its way included. units: bytes
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
            let feeding = Feed::new(&layers, stream);
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
