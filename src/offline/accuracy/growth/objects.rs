//! What the main world does each frame about more and more objects.

use bevy::prelude::*;
use indicatif::ProgressBar;

use super::{Curve, Plan};
use crate::{
    budget::{BudgetClock, FrameBudget},
    contribution::ContributionCulling,
    effects::{Effect, EffectState, Effects},
    occlusion::ZBufferOcclusion,
    offline::{
        Offline,
        accuracy::{AccuracyError, Timing, boxes::boxes},
    },
};

/// Culling what is hidden, all of it in view.
pub(super) fn occlusion(
    plan: Plan,
    progress: &ProgressBar,
    curves: &mut Vec<Curve>,
) -> Result<(), AccuracyError> {
    let camera = || ZBufferOcclusion {
        rests: false,
        ..default()
    };
    measure(
        "occlusion",
        Effect::ZBufferOcclusion,
        camera,
        plan,
        progress,
        curves,
    )
}

/// Comparing areas with the threshold.
pub(super) fn contribution(
    plan: Plan,
    progress: &ProgressBar,
    curves: &mut Vec<Curve>,
) -> Result<(), AccuracyError> {
    let camera = ContributionCulling::default;
    measure(
        "contribution",
        Effect::ContributionCulling,
        camera,
        plan,
        progress,
        curves,
    )
}

/// Choosing what a frame can have; areas are compared for it, which counts as contribution's.
pub(super) fn budget(
    plan: Plan,
    progress: &ProgressBar,
    curves: &mut Vec<Curve>,
) -> Result<(), AccuracyError> {
    let camera = || {
        let budget = FrameBudget {
            clock: BudgetClock::Interval,
            ..FrameBudget::from_hz(60.0)
        };
        (budget, ContributionCulling::default())
    };
    measure(
        "budget",
        Effect::FrameBudget,
        camera,
        plan,
        progress,
        curves,
    )
}

fn measure<B: Bundle>(
    name: &'static str,
    effect: Effect,
    camera: impl Fn() -> B,
    plan: Plan,
    progress: &ProgressBar,
    curves: &mut Vec<Curve>,
) -> Result<(), AccuracyError> {
    let counts: &[usize] = if plan.quick {
        &[500, 2_000, 8_000, 32_000]
    } else {
        &[1_000, 4_000, 16_000, 64_000, 128_000]
    };
    let mut curve = Curve {
        effect: name,
        of: "objects",
        way: "main world".to_owned(),
        points: Vec::new(),
        adapter: String::new(),
    };
    for &count in counts {
        progress.set_message(format!("{name} of {count} objects"));
        let mut offline = Offline::new()?;
        boxes(&mut offline, count, 0.0, camera());
        let mut times = Vec::new();
        let warm = 4;
        for frame in 0..warm + plan.rounds() {
            offline.step();
            let effects = offline.app.world().resource::<Effects>();
            if let (true, EffectState::Active(activity)) = (frame >= warm, effects.state(effect)) {
                times.push(f64::from(activity.cpu_ms));
            }
        }
        curve.points.push((count as f64, Timing::of(times)));
        curve.adapter = offline.adapter();
        progress.inc(1);
    }
    curves.push(curve);
    Ok(())
}
