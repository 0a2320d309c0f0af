//! Triangles from several threads, to submissions of one size.

use core::{
    ops::Range,
    sync::atomic::{AtomicBool, Ordering},
};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::{
    super::overlap::Snapped,
    InteriorGpuError,
    piece::Piece,
    stream::{PIECES, Stream},
};

/// Takes a slab's triangles, from several threads.
pub struct Feed {
    layers: Range<i32>,
    stream: Mutex<Result<Stream, InteriorGpuError>>,
    /// Pieces that are not yet enough for a submission, as many lots as there are threads.
    spare: Mutex<Vec<Vec<Piece>>>,
    has_failed: AtomicBool,
}

impl Feed {
    pub(super) fn new(layers: &Range<u32>, stream: Stream) -> Self {
        Self {
            layers: layers.start as i32..layers.end as i32,
            stream: Mutex::new(Ok(stream)),
            spare: Mutex::default(),
            has_failed: AtomicBool::new(false),
        }
    }

    /// The triangles are in the way; two-sided if their entry says so. Waits where the GPU does not keep up.
    pub fn add(&self, triangles: impl Iterator<Item = (Snapped, bool)>) {
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

    /// Sends what is left.
    pub(super) fn finish(self) -> Result<Stream, InteriorGpuError> {
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

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
