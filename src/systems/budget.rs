//! Main-world side of the frame budget: measures, chooses, notes what was drawn, reports.

#[cfg_attr(feature = "culling", path = "budget/candidates.rs")]
#[cfg_attr(not(feature = "culling"), path = "budget/objects.rs")]
mod in_view;
#[cfg_attr(feature = "terrain", path = "budget/rays.rs")]
#[cfg_attr(not(feature = "terrain"), path = "budget/no_rays.rs")]
mod rays;

use core::fmt::Write;

use bevy::{
    camera::visibility::VisibleEntities,
    diagnostic::{DiagnosticPath, Diagnostics, DiagnosticsStore},
    platform::time::Instant,
    prelude::*,
    render::pipelined_rendering::RenderAppChannels,
    window::{Monitor, OnMonitor, PresentMode, PrimaryWindow},
};

use crate::{
    budget::{
        Budget, BudgetClock, BudgetState, BudgetStatus, BudgetWork, FrameBudget, GivenFrameTimes,
        Knobs,
        built_in::CONTRIBUTION_AREA,
        controller::{Contribution, Input, Measured},
        measure::{Bound, RenderClock},
        workload::{DemandProfile, Workload},
    },
    effects::{Effect, EffectState, Effects},
};
use in_view::{BudgetCamera, Table};
pub(crate) use in_view::{give_back, order};
use rays::Rays;

/// The last frame time that was believed. units: ms
pub const MEASURED_MS: DiagnosticPath = DiagnosticPath::const_new("skyline/budget/measured_ms");
/// What the frame was predicted to take. units: ms
pub const PREDICTED_MS: DiagnosticPath = DiagnosticPath::const_new("skyline/budget/predicted_ms");
/// What was demanded of contribution culling. units: px²
pub const DEMANDED_PX2: DiagnosticPath = DiagnosticPath::const_new("skyline/budget/demanded_px2");

/// Notices whether any camera asks for a budget; what was kept goes when none does any more.
pub fn wake(
    mut budget: ResMut<Budget>,
    mut knobs: ResMut<Knobs>,
    cameras: Query<(), With<FrameBudget>>,
) {
    let is_asked = !cameras.is_empty();
    if !is_asked && !budget.is_awake && !budget.was_asked {
        return;
    }
    // Once more after the last camera: its settings are put back.
    budget.is_awake = is_asked || budget.was_asked;
    budget.was_asked = is_asked;
    if is_asked {
        budget.frame += 1;
        budget.work.get_or_insert_default();
    } else {
        budget.work = None;
        knobs.set_present(CONTRIBUTION_AREA, false);
    }
}

/// The window's part in measuring.
type Display<'w, 's> = (
    Query<'w, 's, (&'static Window, Option<&'static OnMonitor>), With<PrimaryWindow>>,
    Query<'w, 's, &'static Monitor>,
);

/// Starts the clock, and takes in what became known of past frames.
#[expect(clippy::too_many_arguments, reason = "each is a source of times")]
pub fn begin(
    mut budget: ResMut<Budget>,
    mut given: ResMut<GivenFrameTimes>,
    time: Res<Time<Real>>,
    clock: Res<RenderClock>,
    store: Option<Res<DiagnosticsStore>>,
    channels: Option<Res<RenderAppChannels>>,
    cameras: Query<(&Camera, &FrameBudget)>,
    (windows, monitors): Display,
) {
    let frame = budget.frame;
    let Some(work) = budget.work.as_deref_mut() else {
        return;
    };
    let strictest = cameras
        .iter()
        .filter(|(camera, asked)| {
            camera.is_active && asked.target_ms.is_finite() && asked.target_ms > 0.0
        })
        .map(|(_, asked)| asked)
        .min_by(|a, b| a.target_ms.total_cmp(&b.target_ms));
    if work.asked.as_ref() != strictest {
        work.asked = strictest.cloned();
    }
    work.measured = None;
    work.quantum_ms = None;
    let last = frame.saturating_sub(1);
    match work.asked.as_ref().map(|asked| asked.clock) {
        None => {}
        Some(BudgetClock::Given) => {
            work.measured = given.last_ms.take().map(|ms| Measured { frame: last, ms });
        }
        Some(BudgetClock::Interval) => {
            let ms = time.delta_secs() * 1e3;
            work.measured = Some(Measured { frame: last, ms });
            work.quantum_ms = refresh_ms(&windows, &monitors);
        }
        Some(BudgetClock::Work) => {
            work.times.take_render(&clock);
            if let Some(store) = &store {
                work.times.take_gpu(store, frame);
            }
            // What never drew anything has no render world to wait for.
            work.measured = work.times.work(frame, channels.is_some(), clock.runs());
            work.times.begin(frame);
        }
    }
}

/// Time from one picture of the display to the next, where the window waits for it. units: ms
fn refresh_ms(
    windows: &Query<(&Window, Option<&OnMonitor>), With<PrimaryWindow>>,
    monitors: &Query<&Monitor>,
) -> Option<f32> {
    let (window, on) = windows.single().ok()?;
    let waits = matches!(
        window.present_mode,
        PresentMode::AutoVsync | PresentMode::Fifo | PresentMode::FifoRelaxed
    );
    let monitor = monitors.get(on?.0).ok()?;
    let millihertz = monitor.refresh_rate_millihertz.filter(|_| waits)?;
    (millihertz > 0).then(|| 1e6 / millihertz as f32)
}

/// Stops the clock.
pub fn end(mut budget: ResMut<Budget>) {
    let frame = budget.frame;
    if let Some(work) = budget.work.as_deref_mut()
        && work
            .asked
            .as_ref()
            .is_some_and(|asked| asked.clock == BudgetClock::Work)
    {
        work.times.end(frame);
    }
}

/// Sums up what is in view, and chooses.
pub fn choose(
    mut budget: ResMut<Budget>,
    mut knobs: ResMut<Knobs>,
    table: Table,
    rays: Rays,
    mut cameras: Query<BudgetCamera, With<FrameBudget>>,
) {
    let frame = budget.frame;
    let budget = &mut *budget;
    let Some(work) = budget.work.as_deref_mut() else {
        return;
    };
    let Some(asked) = work.asked.as_ref().map(|asked| asked.target_ms) else {
        for mut item in &mut cameras {
            item.state.set_if_neq(BudgetState::default());
            item.demand(0.0);
        }
        // There is no time to move them for.
        if knobs.iter().any(|knob| knob.at != 0) {
            knobs.rest();
        }
        return;
    };
    let began = Instant::now();
    let BudgetWork {
        profile,
        areas,
        controller,
        ..
    } = work;
    profile.clear();
    areas.clear();
    areas.resize(table.slots(), 0.0);
    let mut has_contribution = false;
    let mut picture = 0.0;
    for item in cameras.iter().filter(|item| item.camera.is_active) {
        let viewport = viewport_px2(item.camera);
        profile.add_picture(viewport);
        picture += f64::from(viewport);
        has_contribution |= item.add_to(profile, areas, &table, viewport);
    }
    profile.add_fixed(rays.of(picture));
    profile.finish();
    knobs.set_present(CONTRIBUTION_AREA, has_contribution);
    let manual = knobs
        .get(CONTRIBUTION_AREA)
        .and_then(|knob| knob.steps.get(knob.manual?))
        .map(|step| step.value);
    let decision = controller.step(
        &Input {
            frame,
            target_ms: asked,
            measured: work.measured,
            profile,
            contribution: match (has_contribution, manual) {
                (false, _) => Contribution::Absent,
                (true, None) => Contribution::Budget,
                (true, Some(px2)) => Contribution::Manual(px2),
            },
            quantum_ms: work.quantum_ms,
        },
        knobs.present_mut(),
    );
    if has_contribution {
        show_demand(&mut knobs, profile, decision.demanded_px2);
    }
    let new = BudgetState {
        measured_ms: controller.measured_ms(),
        predicted_ms: decision.predicted_ms,
        demanded_px2: decision.demanded_px2,
        status: decision.status.into(),
    };
    for mut item in &mut cameras {
        let is_active = item.camera.is_active;
        item.state.set_if_neq(if is_active {
            new.clone()
        } else {
            BudgetState::default()
        });
        item.demand(if is_active {
            decision.demanded_px2
        } else {
            0.0
        });
    }
    budget.chosen += 1;
    work.cpu_ms = began.elapsed().as_secs_f32() * 1e3;
}

fn viewport_px2(camera: &Camera) -> f32 {
    camera
        .physical_viewport_size()
        .map_or(0.0, |size| size.x as f32 * size.y as f32)
}

/// Shows how much is demanded, and what each of the knob's steps would lose now.
fn show_demand(knobs: &mut Knobs, profile: &DemandProfile, demanded: f32) {
    let Some(knob) = knobs.get_mut(CONTRIBUTION_AREA) else {
        return;
    };
    for step in &mut knob.steps {
        step.loss = profile.loss(0, DemandProfile::bin(step.value)) as f32;
    }
    knob.live = Some(demanded);
    knob.at = knob
        .steps
        .iter()
        .rposition(|step| step.value <= demanded)
        .unwrap_or(0);
}

/// Notes what is drawn in the end, whatever removed the rest.
pub fn note_drawn(
    mut budget: ResMut<Budget>,
    table: Table,
    rays: Rays,
    cameras: Query<(&Camera, &VisibleEntities), With<FrameBudget>>,
) {
    let frame = budget.frame;
    let Some(work) = budget
        .work
        .as_deref_mut()
        .filter(|work| work.asked.is_some())
    else {
        return;
    };
    let mut drawn = Workload::default();
    let mut picture = 0.0;
    for (camera, visible) in cameras.iter().filter(|(camera, _)| camera.is_active) {
        let viewport = viewport_px2(camera);
        picture += f64::from(viewport);
        drawn = drawn + table.drawn(visible, &work.areas, viewport);
    }
    work.controller.drew(frame, drawn + rays.of(picture));
}

/// Writes the budget's entry in [`Effects`] and its diagnostics. Allocates only when the state changes in kind.
pub fn report_budget(
    budget: Res<Budget>,
    knobs: Res<Knobs>,
    mut effects: ResMut<Effects>,
    cameras: Query<&BudgetState, With<FrameBudget>>,
    mut diagnostics: Diagnostics,
) {
    let entry = effects.bypass_change_detection().entry(Effect::FrameBudget);
    let Some(work) = budget.work.as_deref().filter(|_| !cameras.is_empty()) else {
        if *entry != EffectState::Dormant {
            *entry = EffectState::Dormant;
        }
        return;
    };
    let Some(asked) = &work.asked else {
        entry.idle("no active camera asks for a time above 0: set FrameBudget::target_ms");
        return;
    };
    let decision = work.controller.decision();
    let measured = work.controller.measured_ms();
    if let Some(ms) = measured {
        diagnostics.add_measurement(&MEASURED_MS, || f64::from(ms));
    }
    if let Some(ms) = decision.predicted_ms {
        diagnostics.add_measurement(&PREDICTED_MS, || f64::from(ms));
    }
    diagnostics.add_measurement(&DEMANDED_PX2, || f64::from(decision.demanded_px2));
    let status = BudgetStatus::from(decision.status);
    if status == BudgetStatus::NoMeasurement {
        entry.idle(match asked.clock {
            BudgetClock::Given => {
                "no frame time that can be believed: put each frame's into GivenFrameTimes"
            }
            _ => "no frame time that can be believed has come yet, or none for a second",
        });
        return;
    }
    let activity = entry.activity();
    activity.cpu_ms = work.cpu_ms;
    activity.what.clear();
    // Writing to a string cannot fail.
    let what = &mut activity.what;
    let _ = match status {
        BudgetStatus::Ample => write!(what, "ample"),
        BudgetStatus::Short => write!(what, "out of reach with every knob at its cheapest"),
        _ => write!(what, "held"),
    };
    let _ = write!(what, ": ");
    if let Some(ms) = measured {
        let _ = write!(what, "{ms:.2} of {:.2} ms measured", asked.target_ms);
    }
    if asked.clock == BudgetClock::Work {
        let _ = write!(
            what,
            " ({})",
            match work.times.bound() {
                Bound::Cpu => "main thread",
                Bound::Render => "render thread",
                Bound::Gpu => "GPU",
            }
        );
    }
    if let Some(ms) = decision.predicted_ms {
        let _ = write!(what, ", {ms:.2} ms predicted");
    }
    for knob in knobs.iter().filter(|knob| knob.is_moved()) {
        let _ = write!(
            what,
            "; {} at {} {}",
            knob.name,
            knob.value().unwrap_or(0.0),
            knob.unit
        );
        if knob.manual.is_some() {
            let _ = write!(what, ", by hand");
        }
    }
}
