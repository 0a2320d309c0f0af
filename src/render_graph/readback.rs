//! Brings the number of boxes back from the GPU, some frames late and without ever waiting for it.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

use bevy::render::{render_resource::*, renderer::RenderDevice};

use super::subdivide::BOX_COUNT_WORD;

/// One number on its way back; the next is asked for when it has come.
pub struct BoxCountReadback {
    staging: Buffer,
    busy: Arc<AtomicBool>,
    latest: Arc<AtomicU64>,
}

impl BoxCountReadback {
    pub fn new(device: &RenderDevice) -> Self {
        Self {
            staging: device.create_buffer(&BufferDescriptor {
                label: Some("skyline_box_count"),
                size: 4,
                usage: BufferUsages::COPY_DST | BufferUsages::MAP_READ,
                mapped_at_creation: false,
            }),
            busy: Arc::default(),
            latest: Arc::default(),
        }
    }

    /// What it comes back in.
    pub fn buffer(&self) -> &Buffer {
        &self.staging
    }

    /// The last count that came back; 0 before the first.
    pub fn latest(&self) -> u64 {
        self.latest.load(Ordering::Relaxed)
    }

    /// Asks for this frame's count, unless an earlier one is still on its way.
    pub fn request(&self, counts: &Buffer, encoder: &mut CommandEncoder) {
        if self.busy.swap(true, Ordering::Relaxed) {
            return;
        }
        encoder.copy_buffer_to_buffer(counts, 4 * BOX_COUNT_WORD, &self.staging, 0, 4);
        let (staging, busy, latest) =
            (self.staging.clone(), self.busy.clone(), self.latest.clone());
        encoder.map_buffer_on_submit(&self.staging, MapMode::Read, .., move |result| {
            if result.is_ok() {
                if let Ok(bytes) = <[u8; 4]>::try_from(&*staging.slice(..).get_mapped_range()) {
                    latest.store(u64::from(u32::from_le_bytes(bytes)), Ordering::Relaxed);
                }
                staging.unmap();
            }
            busy.store(false, Ordering::Relaxed);
        });
    }
}
