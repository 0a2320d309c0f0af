//! What the terrain's passes did, counted as they do it and shared with the main world.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bevy::{platform::collections::HashMap, prelude::*};

/// Counters of the terrain's rendering since the app began, and what it holds now.
///
/// The same counters are in the main world and in the render world; with pipelined rendering they are a frame
/// late in the former.
#[derive(Resource, Clone, Default)]
pub struct TerrainStats(Arc<Mutex<TerrainCounts>>);

/// See [`TerrainStats`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TerrainCounts {
    /// Dispatches and draws of each pass, and the threads, boxes or pixels they were asked for.
    pub passes: HashMap<&'static str, PassCount>,
    /// GPU memory held: height fields with their pyramids, and everything views need. units: bytes
    pub field_bytes: u64,
    /// As above, of the views.
    pub view_bytes: u64,
    /// As above, of what is drawn into Bevy's cascades.
    pub cascade_bytes: u64,
    /// Pipelines queued so far.
    pub pipelines: u64,
    /// Camera and terrain pairs drawn in the last frame.
    pub views_drawn: u64,
    /// Boxes in the last list that came back, and how many there was room for.
    pub boxes: u64,
    /// See `boxes`.
    pub box_capacity: u64,
    /// Time the render world spent on terrain in the last frame. units: ms
    pub cpu_ms: f32,
    /// What is known of shadow maps.
    pub shadows: ShadowCounts,
    /// Why terrain cannot be drawn here at all, if so.
    pub unsupported: Option<String>,
    /// Height fields this GPU cannot hold, cameras it cannot serve: one sentence each.
    pub refused: Vec<String>,
}

/// The shadow maps of all terrains in the last frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShadowCounts {
    /// Maps, one for each terrain and light.
    pub maps: u64,
    /// Those of them that show.
    pub shown: u64,
    /// Whether a map is out of date, seen or not.
    pub waiting: bool,
    /// Whether one is being made.
    pub working: bool,
    /// Whether nothing can be timed here, so that the time slice is a guess.
    pub unmeasured: bool,
    /// Rays of this frame's step.
    pub rays: u64,
    /// What a ray costs by the last measurements. units: ns
    pub ns_per_ray: f32,
    /// GPU memory held. units: bytes
    pub bytes: u64,
    /// Time the render world spent on planning. units: ms
    pub cpu_ms: f32,
    /// Lights that have no map here, and why: one sentence each.
    pub refused: Vec<String>,
}

/// How often a pass ran, and over how much.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PassCount {
    /// Dispatches and draws.
    pub runs: u64,
    /// What they were over: nodes, rays or texels, as the pass has it.
    pub work: u64,
}

impl TerrainStats {
    /// The counters; held only while they are read or written.
    pub fn lock(&self) -> MutexGuard<'_, TerrainCounts> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts one dispatch or draw of a pass.
    pub fn count_dispatch(&self, pass: &'static str, work: u64) {
        let mut counts = self.lock();
        let count = counts.passes.entry(pass).or_default();
        count.runs += 1;
        count.work += work;
    }
}

impl TerrainCounts {
    /// Dispatches and draws of all passes together.
    pub fn total_runs(&self) -> u64 {
        self.passes.values().map(|count| count.runs).sum()
    }
}
