//! The share of a frame that interior culling may take on the main thread.

use core::time::Duration;

use bevy::platform::time::Instant;

/// units: ms
const SLICE_MS: u64 = 1;

/// Ends a little while after it began.
#[derive(Clone, Copy)]
pub(super) struct Slice {
    began: Instant,
}

impl Slice {
    pub fn begin() -> Self {
        Self {
            began: Instant::now(),
        }
    }

    pub fn is_over(&self) -> bool {
        self.began.elapsed() >= Duration::from_millis(SLICE_MS)
    }

    /// units: ms
    pub fn spent_ms(&self) -> f32 {
        self.began.elapsed().as_secs_f32() * 1e3
    }
}
