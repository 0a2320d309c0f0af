//! The share of a frame that preparing models may take on the main thread.

use core::time::Duration;

use bevy::platform::time::Instant;

/// units: ms
const SLICE_MS: u64 = 1;

/// Ends a little while after it began.
#[derive(Clone, Copy)]
pub struct Slice {
    began: Instant,
}

impl Slice {
    pub fn begin() -> Self {
        Self::begin_after(0.0)
    }

    /// What is left of one, of which so much is spent. units: ms
    pub fn begin_after(spent_ms: f32) -> Self {
        let spent = Duration::from_secs_f32(spent_ms.max(0.0) * 1e-3);
        let now = Instant::now();
        Self {
            began: now.checked_sub(spent).unwrap_or(now),
        }
    }

    pub fn is_over(&self) -> bool {
        self.began.elapsed() >= Duration::from_millis(SLICE_MS)
    }

    /// Since it began, what was spent before included. units: ms
    pub fn spent_ms(&self) -> f32 {
        self.began.elapsed().as_secs_f32() * 1e3
    }
}
