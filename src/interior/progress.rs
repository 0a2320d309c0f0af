//! How far a culling in the background has come.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicUsize, Ordering};

/// The stages of a culling, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Vertices are snapped to the lattice.
    Snapping,
    /// The directed distance field is made.
    Field,
    /// The front moves in from outside.
    Front,
    /// What is seen is collected.
    Extraction,
}

impl Stage {
    const ALL: [Self; 4] = [Self::Snapping, Self::Field, Self::Front, Self::Extraction];

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Snapping => "snapping",
            Self::Field => "distance field",
            Self::Front => "front propagation",
            Self::Extraction => "extraction",
        }
    }
}

/// Shared between who culls, who watches and who may stop it.
#[derive(Debug, Default)]
pub struct Progress {
    stage: AtomicU8,
    done: AtomicUsize,
    whole: AtomicUsize,
    is_cancelled: AtomicBool,
}

impl Progress {
    /// The stage it is in, and how much of that is done, from 0 to 1.
    pub fn now(&self) -> (Stage, f32) {
        let stage = Stage::ALL[usize::from(self.stage.load(Ordering::Relaxed))];
        let whole = self.whole.load(Ordering::Relaxed).max(1);
        let done = self.done.load(Ordering::Relaxed).min(whole);
        (stage, done as f32 / whole as f32)
    }

    /// It ends as soon as it can.
    pub fn cancel(&self) {
        self.is_cancelled.store(true, Ordering::Relaxed);
    }

    /// Whether it is to end.
    pub fn is_cancelled(&self) -> bool {
        self.is_cancelled.load(Ordering::Relaxed)
    }

    pub(super) fn enter(&self, stage: Stage, whole: usize) {
        self.done.store(0, Ordering::Relaxed);
        self.whole.store(whole, Ordering::Relaxed);
        self.stage.store(stage as u8, Ordering::Relaxed);
    }

    pub(super) fn advance(&self, by: usize) {
        self.done.fetch_add(by, Ordering::Relaxed);
    }
}
