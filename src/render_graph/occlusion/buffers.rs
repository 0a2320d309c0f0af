//! GPU memory of occlusion culling: the table of occludees, shared by all cameras, and what each camera has.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use bevy::{
    platform::collections::HashMap,
    prelude::*,
    render::{
        render_resource::*,
        renderer::{RenderDevice, RenderQueue},
        sync_world::MainEntity,
    },
};
use bytemuck::Pod;

use crate::{
    culling::{
        candidates::{Candidate, NO_SLOT},
        volume::Proxy,
    },
    occlusion::{
        camera::Returned,
        depth::{GpuOcclusionView, ReducedDepth},
    },
};

use super::{
    super::occludee_verdicts::{GpuOccludee, GpuSweptTriangle},
    extract::ExtractedOcclusionCamera,
};

/// A growing array of plain values and its copy on the GPU. Only what changed is uploaded.
pub struct GpuTable<T> {
    label: &'static str,
    values: Vec<T>,
    changed: Vec<u32>,
    buffer: Option<Buffer>,
}

impl<T: Pod> GpuTable<T> {
    /// Empty; its buffer will have this label.
    pub fn new(label: &'static str) -> Self {
        Self {
            label,
            values: Vec::new(),
            changed: Vec::new(),
            buffer: None,
        }
    }

    fn clear(&mut self) {
        self.values.clear();
        self.changed.clear();
    }

    fn has_changed(&self) -> bool {
        !self.changed.is_empty()
    }

    /// Whether it holds nothing.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Sets a value; those before it that were never set are `empty`.
    pub fn set(&mut self, i: u32, value: T, empty: T) {
        if self.values.len() <= i as usize {
            self.values.resize(i as usize + 1, empty);
        }
        self.values[i as usize] = value;
        self.changed.push(i);
    }

    fn extend(&mut self, values: impl IntoIterator<Item = T>) -> u32 {
        let first = self.values.len() as u32;
        self.values.extend(values);
        self.changed.extend(first..self.values.len() as u32);
        first
    }

    /// Uploads what changed; all of it if it has outgrown its buffer.
    pub fn flush(&mut self, device: &RenderDevice, queue: &RenderQueue) {
        let bytes = (self.values.len() * size_of::<T>()) as u64;
        if self.buffer.as_ref().is_none_or(|b| b.size() < bytes) {
            let room = (bytes * 3 / 2).next_multiple_of(256).max(256);
            let buffer = device.create_buffer(&BufferDescriptor {
                label: Some(self.label),
                size: room,
                usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            });
            queue.write_buffer(&buffer, 0, bytemuck::cast_slice(&self.values));
            self.buffer = Some(buffer);
            self.changed.clear();
            return;
        }
        let Some(buffer) = &self.buffer else { return };
        self.changed.sort_unstable();
        self.changed.dedup();
        for run in self.changed.chunk_by(|a, b| a + 1 == *b) {
            let (first, last) = (run[0] as usize, run[run.len() - 1] as usize);
            let size = size_of::<T>();
            queue.write_buffer(
                buffer,
                (first * size) as u64,
                bytemuck::cast_slice(&self.values[first..=last]),
            );
        }
        self.changed.clear();
    }

    /// The GPU's copy.
    pub fn buffer(&self) -> Option<&Buffer> {
        self.buffer.as_ref()
    }

    /// Memory held. units: bytes
    pub fn bytes(&self) -> u64 {
        self.buffer.as_ref().map_or(0, |buffer| buffer.size())
    }
}

/// The table of occludees on the GPU, shared by all cameras. Empty while no camera asks for culling.
#[derive(Resource)]
pub struct GpuOccludees {
    pub occludees: GpuTable<GpuOccludee>,
    /// Triangles of all proxies.
    pub triangles: GpuTable<GpuSweptTriangle>,
    /// Where the triangles of a proxy are; it is kept, so that its address stays its own.
    proxies: HashMap<usize, (Arc<Proxy>, u32)>,
    /// By index in Bevy's buffer of mesh inputs: the occludee's slot.
    pub slot_of_input: GpuTable<u32>,
    /// Whether it is to be filled anew, and of which epoch of the main world's table it is.
    stale: bool,
    epoch: u32,
}

impl Default for GpuOccludees {
    fn default() -> Self {
        Self {
            occludees: GpuTable::new("skyline_occludees"),
            triangles: GpuTable::new("skyline_swept_triangles"),
            proxies: HashMap::default(),
            slot_of_input: GpuTable::new("skyline_slot_of_input"),
            stale: false,
            epoch: 0,
        }
    }
}

impl GpuOccludees {
    /// Whether it holds nothing yet.
    pub fn is_empty(&self) -> bool {
        self.occludees.values.is_empty()
    }

    /// Whether the whole table has to come again: nothing of it is here, or much of what is here is of no use.
    pub fn wants_all(&self, epoch: u32) -> bool {
        self.is_empty() || self.stale || self.epoch != epoch
    }

    /// Begins to fill the table anew.
    pub fn restart(&mut self, epoch: u32) {
        self.occludees.clear();
        self.triangles.clear();
        self.proxies.clear();
        (self.stale, self.epoch) = (false, epoch);
    }

    /// Puts an occludee in its slot, or nothing.
    pub fn set(&mut self, slot: u32, of: Option<&Candidate>) {
        let gpu = of.map_or_else(GpuOccludee::default, |of| {
            let (first, count) = of.proxy.as_ref().map_or((0, 0), |proxy| self.proxy(proxy));
            GpuOccludee::new(&of.world_from_local, &of.volume, first..first + count)
        });
        self.occludees.set(slot, gpu, GpuOccludee::default());
    }

    fn proxy(&mut self, proxy: &Arc<Proxy>) -> (u32, u32) {
        let count = proxy.triangles.len() as u32;
        let (_, first) = self
            .proxies
            .entry(Arc::as_ptr(proxy) as usize)
            .or_insert_with(|| {
                let first = self
                    .triangles
                    .extend(proxy.triangles.iter().map(Into::into));
                (proxy.clone(), first)
            });
        (*first, count)
    }

    /// Notes which occludee a mesh input is.
    pub fn note_input(&mut self, input: u32, slot: u32) {
        self.slot_of_input.set(input, slot, NO_SLOT);
    }

    /// Uploads what changed.
    pub fn flush(&mut self, device: &RenderDevice, queue: &RenderQueue) {
        // Once proxies of meshes that are gone have become the larger part, the table comes again without them.
        let dead = |(proxy, _): &&(Arc<Proxy>, u32)| Arc::strong_count(proxy) == 1;
        let triangles = |(proxy, _): &(Arc<Proxy>, u32)| proxy.triangles.len();
        if self.triangles.has_changed() {
            let dead: usize = self.proxies.values().filter(dead).map(triangles).sum();
            self.stale = 2 * dead > self.triangles.values.len();
        }
        self.occludees.flush(device, queue);
        self.triangles.flush(device, queue);
        self.slot_of_input.flush(device, queue);
    }

    /// Memory held. units: bytes
    pub fn bytes(&self) -> u64 {
        self.occludees.bytes() + self.triangles.bytes() + self.slot_of_input.bytes()
    }
}

/// What one camera has on the GPU.
pub struct ViewOcclusion {
    /// The view, and the camera's matrix.
    pub view: Buffer,
    /// Reduced depth, all levels.
    pub reduced: Buffer,
    /// Texels of all levels.
    pub texels: usize,
    /// A bit each slot: is to be tested.
    pub to_test: Buffer,
    /// A bit each slot: was found hidden.
    pub hidden: Buffer,
    /// What the late draws need to know of the frame.
    pub late: Buffer,
    /// Words of the bit sets.
    pub words: usize,
    /// Whether this frame uses it.
    pub live: bool,
    /// Whether any slot is to be tested this frame.
    pub tests: bool,
    /// The frame as it will come back.
    pub header: ReducedDepth,
    pub key: ReduceKey,
    pub reduce_group: Option<(TextureViewId, BindGroup)>,
    pub verdict_group: Option<([BufferId; 2], BindGroup)>,
    staging: StagingRing,
}

/// What distinguishes one pipeline of `depth_reduce` from another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ReduceKey {
    pub block: UVec2,
    pub strided: bool,
    pub samples: u32,
}

/// Everything each camera has.
#[derive(Resource, Default)]
pub struct OcclusionViews(pub HashMap<MainEntity, ViewOcclusion>);

/// A storage buffer that can be written and read back.
pub fn storage(device: &RenderDevice, label: &str, bytes: usize) -> Buffer {
    device.create_buffer(&BufferDescriptor {
        label: Some(label),
        size: (bytes as u64).next_multiple_of(16).max(16),
        usage: BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC,
        mapped_at_creation: false,
    })
}

impl ViewOcclusion {
    /// Memory for a camera whose reduced depth has so many texels, and for so many words of slots.
    pub fn new(device: &RenderDevice, texels: usize, words: usize, key: ReduceKey) -> Self {
        Self {
            view: storage(
                device,
                "skyline_occlusion_view",
                size_of::<GpuOcclusionView>(),
            ),
            reduced: storage(device, "skyline_reduced_depth", 4 * texels),
            texels,
            to_test: storage(device, "skyline_occlusion_to_test", 4 * words),
            hidden: storage(device, "skyline_occlusion_hidden", 4 * words),
            late: storage(device, "skyline_late_draws", 4),
            words,
            live: false,
            tests: false,
            header: ReducedDepth::default(),
            key,
            reduce_group: None,
            verdict_group: None,
            staging: StagingRing::new("skyline_occlusion_staging"),
        }
    }

    /// Memory held. units: bytes
    pub fn bytes(&self) -> u64 {
        let staging = self.staging.bytes();
        self.view.size() + self.reduced.size() + self.to_test.size() * 2 + 16 + staging
    }

    /// Sends this frame's reduced depth and verdicts on their way to the camera. Never waits: if all buffers are
    /// under way, this frame's are not sent.
    pub fn send(
        &mut self,
        device: &RenderDevice,
        encoder: &mut CommandEncoder,
        camera: &ExtractedOcclusionCamera,
        frame: u32,
        epoch: u32,
    ) {
        let texels = if camera.sends_depth { self.texels } else { 0 };
        let ExtractedOcclusionCamera {
            mailbox,
            to_test,
            removed_slots: removed,
            ..
        } = camera;
        let (depth_bytes, words) = (4 * texels as u64, to_test.as_words().len());
        let bytes = depth_bytes + 4 * words as u64;
        if bytes == 0 {
            return;
        }
        let Some((buffer, busy)) = self.staging.take(device, bytes) else {
            return;
        };
        if depth_bytes > 0 {
            encoder.copy_buffer_to_buffer(&self.reduced, 0, &buffer, 0, depth_bytes);
        }
        if self.tests && words > 0 {
            encoder.copy_buffer_to_buffer(&self.hidden, 0, &buffer, depth_bytes, 4 * words as u64);
        }
        let mut returned = mailbox.blank();
        let Returned {
            depth,
            tested,
            hidden,
            removed: was_removed,
            frame: of_frame,
            epoch: of_epoch,
        } = &mut returned;
        depth.clone_header_from(&self.header);
        tested.clone_from(to_test);
        was_removed.clone_from(removed);
        hidden.clear(words * 32);
        (*of_frame, *of_epoch) = (frame, epoch);
        let tests = self.tests;
        let (mailbox, staging) = (mailbox.clone(), buffer.clone());
        encoder.map_buffer_on_submit(&buffer, MapMode::Read, ..bytes, move |result| {
            if result.is_ok() {
                {
                    let bytes = staging.slice(..bytes).get_mapped_range();
                    let (depth, bits) = bytes.split_at(4 * texels);
                    copy_words(&mut returned.depth.texels, depth);
                    if tests {
                        copy_words(returned.hidden.words_mut(), &bits[..4 * words]);
                    }
                }
                staging.unmap();
                mailbox.post(returned);
            } else {
                mailbox.recycle(returned);
            }
            busy.store(false, Ordering::Release);
        });
    }
}

/// Frames that may be on their way back at once.
const MOST_UNDER_WAY: usize = 4;

/// Buffers on their way back from the GPU.
pub struct StagingRing {
    label: &'static str,
    list: Vec<(Buffer, Arc<AtomicBool>)>,
}

impl StagingRing {
    /// Empty; its buffers will have this label.
    pub fn new(label: &'static str) -> Self {
        Self {
            label,
            list: Vec::new(),
        }
    }

    /// A buffer of at least so many bytes, marked busy until its user says that it is not; `None` if all are under way.
    pub fn take(&mut self, device: &RenderDevice, bytes: u64) -> Option<(Buffer, Arc<AtomicBool>)> {
        let label = self.label;
        let new = || {
            let buffer = device.create_buffer(&BufferDescriptor {
                label: Some(label),
                size: bytes.next_multiple_of(16),
                usage: BufferUsages::COPY_DST | BufferUsages::MAP_READ,
                mapped_at_creation: false,
            });
            (buffer, Arc::default())
        };
        let free = self
            .list
            .iter()
            .position(|(_, busy)| !busy.load(Ordering::Acquire));
        let i = match free {
            Some(i) => i,
            None if self.list.len() < MOST_UNDER_WAY => {
                self.list.push(new());
                self.list.len() - 1
            }
            None => return None,
        };
        if self.list[i].0.size() < bytes {
            self.list[i] = new();
        }
        let (buffer, busy) = self.list[i].clone();
        busy.store(true, Ordering::Release);
        Some((buffer, busy))
    }

    /// Memory held. units: bytes
    pub fn bytes(&self) -> u64 {
        self.list.iter().map(|(buffer, _)| buffer.size()).sum()
    }
}

/// Replaces `to` by the little-endian words of `bytes`.
pub fn copy_words<T: Pod>(to: &mut Vec<T>, bytes: &[u8]) {
    to.clear();
    to.resize(bytes.len() / size_of::<T>(), T::zeroed());
    bytemuck::cast_slice_mut(to).copy_from_slice(bytes);
}
