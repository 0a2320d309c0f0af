//! The frame budget: one frame time, wherever the camera looks (P4, and what it lacks).
//!
//! Each frame: **measure** what the last frames took, **learn** what an object, a triangle, a pixel and a terrain ray
//! cost on this machine, **predict** this frame, and **choose** the knobs' settings with the least visible loss whose
//! predicted time meets the target. Feedback trims what the model gets wrong.

pub mod knobs;

use bevy::prelude::*;

pub use knobs::{Knob, KnobStep, Knobs};

/// On a camera: holds the app's frame time to a target by moving other effects' knobs, those with the least visible
/// loss first, and gives them back in reverse.
///
/// Frame time is the app's, not a camera's: where several active cameras have a budget, the strictest target holds.
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Clone, Debug, PartialEq)]
#[require(BudgetState)]
pub struct FrameBudget {
    /// What a frame may take. units: ms
    pub target_ms: f32,
    /// Which time is held.
    pub clock: BudgetClock,
}

impl FrameBudget {
    /// So many frames a second.
    pub fn from_hz(hz: f32) -> Self {
        Self::from_ms(1_000.0 / hz)
    }

    /// So many milliseconds a frame.
    pub fn from_ms(target_ms: f32) -> Self {
        Self {
            target_ms,
            clock: BudgetClock::default(),
        }
    }
}

/// Which time a [`FrameBudget`] holds.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum BudgetClock {
    /// The longest of what the main world, the render world and the GPU worked on a frame; waiting for the display is
    /// not work.
    #[default]
    Work,
    /// From one frame's start to the next one's, waiting included.
    Interval,
    /// What is put into [`GivenFrameTimes`].
    Given,
}

/// Frame times for [`BudgetClock::Given`].
#[derive(Resource, Clone, Debug, Default)]
pub struct GivenFrameTimes {
    /// What the last frame took, until it is read. Zero, negative and non-finite times count as missing. units: ms
    pub last_ms: Option<f32>,
}

/// How a [`FrameBudget`] stands.
#[derive(Component, Reflect, Clone, Debug, Default, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct BudgetState {
    /// What the last measured frame took. units: ms
    pub measured_ms: Option<f32>,
    /// What this frame was predicted to take. units: ms
    pub predicted_ms: Option<f32>,
    /// The contribution threshold that is demanded. units: px²
    pub threshold_px2: f32,
    /// In short.
    pub status: BudgetStatus,
}

/// See [`BudgetState`].
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum BudgetStatus {
    /// No frame time that could be believed has come yet, or none for a while: all knobs stay where they are.
    #[default]
    NoMeasurement,
    /// The target is met with every knob at its best.
    Ample,
    /// The target is met by moving knobs.
    Held,
    /// The target cannot be met with every knob at its cheapest.
    Short,
}

/// Registers types and main-world systems.
pub(crate) fn register(app: &mut App) {
    app.register_type::<FrameBudget>()
        .register_type::<BudgetState>()
        .init_resource::<GivenFrameTimes>()
        .init_resource::<Knobs>();
}
