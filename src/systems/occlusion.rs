//! Main-world side of Z-buffer occlusion culling: predicts, removes, reports.

use core::{any::TypeId, fmt::Write};

use bevy::{
    camera::visibility::VisibleEntities,
    diagnostic::{DiagnosticPath, Diagnostics, DiagnosticsStore, FrameCount},
    ecs::lifecycle::RemovedComponents,
    platform::time::Instant,
    prelude::*,
};

use super::spans::Spans;
use crate::{
    contribution::ContributionCulling,
    culling::{CulledEntities, candidates::Candidates},
    effects::{Effect, EffectState, Effects},
    occlusion::{
        OcclusionCamera, OcclusionCounts, Recheck, ZBufferOcclusion,
        pace::{Frame, Plan},
        verdict::{DepthTest, Verdict},
    },
    render_graph::occlusion::OcclusionStats,
};

/// Passes that occlusion culling's GPU time is the sum of.
const SPANS: [&str; 6] = [
    "depth_reduce",
    "occludee_verdicts",
    "late_draws",
    "late_view_prepass",
    "late_view_deferred",
    "late_opaque",
];

/// Candidates in view, over all cameras.
pub const CANDIDATES: DiagnosticPath = DiagnosticPath::const_new("skyline/occlusion/candidates");
/// Entities removed, over all cameras.
pub const REMOVED: DiagnosticPath = DiagnosticPath::const_new("skyline/occlusion/removed");
/// Entities drawn late, over all cameras.
pub const RESCUED: DiagnosticPath = DiagnosticPath::const_new("skyline/occlusion/rescued");
/// Time of keeping the table, testing and removing, over all cameras. units: ms
pub const CPU_MS: DiagnosticPath = DiagnosticPath::const_new("skyline/occlusion/cpu_ms");

/// Candidates not hidden that the CPU tests in one frame, about; the others have their turn in the next ones. Nothing
/// but time is lost with it: they are drawn.
const SEEN_TESTS: u32 = 1000;
/// If one in so many tests finds something hidden, all have their turn at once.
const WORTH_ALL: u32 = 16;
/// Frames after which each of them had its turn, at most.
const MOST_TURNS: u32 = 16;

/// Takes what the newest depth hides out of each camera's visible entities, in order.
pub fn cull_occluded(
    mut table: ResMut<Candidates>,
    stats: Res<OcclusionStats>,
    frame: Res<FrameCount>,
    time: Res<Time<Real>>,
    paths: Res<OcclusionDiagnosticPaths>,
    store: Option<Res<DiagnosticsStore>>,
    mut cameras: Query<(
        &Camera,
        &ZBufferOcclusion,
        &mut OcclusionCamera,
        &mut VisibleEntities,
        &mut CulledEntities,
        &mut OcclusionCounts,
    )>,
) {
    if cameras.is_empty() {
        return;
    }
    let (supported, rechecks, ready) = {
        let stats = stats.lock();
        let supported = stats.unsupported.is_none();
        (
            supported,
            stats.no_recheck.is_none(),
            stats.ready_to_recheck,
        )
    };
    let table = &mut *table;
    table.refresh_groups();
    let gpu_ms = store
        .as_deref()
        .map_or(0.0, |store| paths.0.smoothed_ms(store).unwrap_or(0.0));
    // What is done for all cameras, or known of all together: each bears its part.
    let active = cameras.iter().filter(|(camera, ..)| camera.is_active);
    let shared_ms = (table.update_ms + gpu_ms) / active.count().max(1) as f32;
    for (camera, settings, mut state, mut visible, mut culled, mut counts) in &mut cameras {
        let began = Instant::now();
        culled.occluded.clear();
        let rechecks_here = settings.recheck == Recheck::SameFrame;
        let works = camera.is_active && supported && (rechecks || !rechecks_here);
        let plan = match (works, settings.rests) {
            (false, _) => Plan::Rest,
            (true, true) => state.pace.plan(),
            (true, false) => Plan::Work,
        };
        let removes = plan == Plan::Work && (ready || !rechecks_here);
        let culled = removes.then_some(&mut culled.occluded);
        let list = visible.get_mut(TypeId::of::<Mesh3d>());
        let in_list = list.len();
        let hidden = cull_camera(settings, &mut state, table, list, plan, culled, &mut counts);
        counts.age = state
            .newest
            .as_ref()
            .map_or(0, |newest| frame.0.wrapping_sub(newest.frame));
        counts.cpu_ms = began.elapsed().as_secs_f32() * 1e3;
        if works && settings.rests {
            let frame = Frame {
                frame_ms: time.delta_secs() * 1e3,
                own_ms: counts.cpu_ms + shared_ms,
                in_view: in_list,
                removed: hidden.unwrap_or(0).saturating_sub(counts.rescued) as usize,
                // While shaders are compiled nothing can be said of what culling saves.
                judged: hidden.is_some() && (removes || plan == Plan::Probe),
            };
            state.pace.step(&frame);
        }
    }
}

/// One camera's share of [`cull_occluded`]. Removes only if there is a `culled` to note it in. Returns how many in view
/// are hidden, removed or not; `None` without a verdict.
fn cull_camera(
    settings: &ZBufferOcclusion,
    state: &mut OcclusionCamera,
    table: &Candidates,
    list: &mut Vec<Entity>,
    plan: Plan,
    mut culled: Option<&mut Vec<Entity>>,
    counts: &mut OcclusionCounts,
) -> Option<u32> {
    let slots = table.slots();
    *counts = OcclusionCounts {
        // Of the newest verdicts, until newer ones come.
        rescued: if settings.recheck == Recheck::SameFrame {
            counts.rescued
        } else {
            0
        },
        ..default()
    };
    state.removed.clear(slots);
    state.to_test.clear(slots);
    state.reads = plan != Plan::Rest;
    state.predicts_on_gpu = false;
    if plan == Plan::Rest {
        state.hidden.clear(0);
        state.turns = 1;
        counts.rescued = 0;
        if let Some(old) = state.newest.take() {
            state.mailbox.recycle(old);
        }
        // What is still on its way is not for later.
        if let Some(late) = state.mailbox.take() {
            state.mailbox.recycle(late);
        }
        return None;
    }
    state.hidden.grow(slots);
    for slot in table.assigned() {
        state.hidden.remove(*slot);
    }
    let fresh = match state.mailbox.take() {
        // Of a table that was forgotten: its slots are others'.
        Some(old) if old.epoch != table.epoch() => {
            state.mailbox.recycle(old);
            None
        }
        fresh => fresh,
    };
    let is_fresh = fresh.is_some();
    if let Some(fresh) = fresh {
        // What was removed and then found visible was drawn late, and is drawn early from now on.
        state.hidden.set_from(&fresh.tested, &fresh.hidden);
        if settings.recheck == Recheck::SameFrame {
            counts.rescued = fresh.removed.count_without(&fresh.hidden) as u32;
        }
        if let Some(old) = state.newest.replace(fresh) {
            state.mailbox.recycle(old);
        }
    }
    let on_gpu = slots > 0 && list.len() >= settings.gpu_from;
    // What is seen is tested in turns where there is much of it, unless there is much to be found.
    let turns = match plan {
        Plan::Probe => 1,
        _ => state.turns.max(1),
    };
    state.turn = state.turn.wrapping_add(u32::from(is_fresh));
    let turn = state.turn % turns;
    let is_final = settings.recheck == Recheck::Never;
    let tester = state
        .newest
        .as_ref()
        .filter(|_| is_fresh && !on_gpu)
        .map(|newest| DepthTest::new(&newest.depth));
    let mut descent = Descent {
        table,
        tester,
        groups: &mut state.groups,
        path: &mut state.group_path,
        tested: 0,
        spared: 0,
    };
    descent.begin();
    if is_final {
        state.in_view_now.clear(slots);
    }
    let (mut candidates, mut hidden_ones, mut found) = (0, 0, 0);
    list.retain(|entity| {
        let Some(slot) = table.occludable(*entity) else {
            return true;
        };
        candidates += 1;
        if is_final {
            state.in_view_now.insert(slot);
            // Nothing is known of what was out of view.
            if !state.in_view.contains(slot) {
                state.hidden.remove(slot);
            }
        }
        if on_gpu {
            state.to_test.insert(slot);
        }
        // The recheck says of what was removed whether it still is hidden.
        let hidden = state.hidden.contains(slot);
        let due = if hidden {
            is_final
        } else {
            slot % turns == turn
        };
        if due {
            match descent.verdict(slot) {
                Some(Verdict::Hidden) => {
                    found += u32::from(!hidden);
                    state.hidden.insert(slot);
                }
                Some(Verdict::Visible | Verdict::Outside) => state.hidden.remove(slot),
                None => {}
            }
        }
        if !state.hidden.contains(slot) {
            return true;
        }
        hidden_ones += 1;
        let Some(culled) = &mut culled else {
            return true;
        };
        culled.push(*entity);
        state.removed.insert(slot);
        if !is_final {
            state.to_test.insert(slot);
        }
        false
    });
    if is_final {
        core::mem::swap(&mut state.in_view, &mut state.in_view_now);
    }
    state.predicts_on_gpu = on_gpu;
    counts.candidates = candidates;
    let seen = candidates - hidden_ones;
    state.turns = if is_fresh && found * WORTH_ALL <= descent.tested {
        seen.div_ceil(SEEN_TESTS).min(MOST_TURNS)
    } else if is_fresh {
        1
    } else {
        state.turns
    };
    counts.removed = culled.map_or(0, |culled| culled.len() as u32);
    counts.tested = descent.tested;
    counts.spared = descent.spared;
    counts.on_gpu = on_gpu;
    state.newest.is_some().then_some(hidden_ones)
}

/// Tests volumes, groups first: what is in a hidden or absent group is not tested.
struct Descent<'a> {
    table: &'a Candidates,
    tester: Option<DepthTest<'a>>,
    /// By group: 0 not known yet, else what its verdict is.
    groups: &'a mut Vec<u8>,
    /// Groups to be tested, from the lowest up.
    path: &'a mut Vec<u32>,
    tested: u32,
    spared: u32,
}

impl Descent<'_> {
    fn begin(&mut self) {
        self.groups.clear();
        if self.tester.is_some() {
            self.groups.resize(self.table.groups.len(), 0);
        }
    }

    /// `None` where nothing new is known.
    fn verdict(&mut self, slot: u32) -> Option<Verdict> {
        self.tester.as_ref()?;
        match self.group(self.table.groups.of(slot)) {
            Verdict::Visible => {}
            verdict => {
                self.spared += 1;
                return Some(verdict);
            }
        }
        let candidate = self.table.get(slot)?;
        self.tested += 1;
        let tester = self.tester.as_ref()?;
        Some(tester.verdict(
            &candidate.world_from_local,
            &candidate.volume,
            candidate.turned.as_ref(),
            candidate.proxy.as_deref(),
        ))
    }

    /// Groups above first: one that is hidden or absent decides for all below it.
    fn group(&mut self, group: u32) -> Verdict {
        const KNOWN: [Verdict; 3] = [Verdict::Visible, Verdict::Hidden, Verdict::Outside];
        let mut verdict = Verdict::Visible;
        self.path.clear();
        let mut above = group;
        while let Some(state) = self.table.groups.get(above) {
            match self.groups[above as usize] {
                0 => self.path.push(above),
                known => {
                    verdict = KNOWN[known as usize - 1];
                    break;
                }
            }
            above = state.parent;
        }
        while let Some(group) = self.path.pop() {
            if verdict == Verdict::Visible
                && let Some(state) = self.table.groups.get(group).filter(|g| g.spares())
                && let (Some(bound), Some(tester)) = (state.bound(), &self.tester)
            {
                self.tested += 1;
                verdict = tester.verdict(&bevy::math::Affine3A::IDENTITY, bound, None, None);
            }
            self.groups[group as usize] = match verdict {
                Verdict::Visible => 1,
                Verdict::Hidden => 2,
                Verdict::Outside => 3,
            };
        }
        verdict
    }
}

/// A camera whose culling was taken from it shows nothing of it.
pub fn forget_occluded(
    mut removed: RemovedComponents<ZBufferOcclusion>,
    mut commands: Commands,
    mut cameras: Query<
        (Option<&mut CulledEntities>, Has<ContributionCulling>),
        Without<ZBufferOcclusion>,
    >,
) {
    for camera in removed.read() {
        if let Ok((culled, weighs)) = cameras.get_mut(camera) {
            if let Some(mut culled) = culled {
                culled.occluded = Vec::new();
            }
            let mut entity = commands.entity(camera);
            entity.remove::<(OcclusionCamera, OcclusionCounts)>();
            if !weighs {
                entity.remove::<CulledEntities>();
            }
        }
    }
}

/// The diagnostics that the passes' spans appear under, made once.
#[derive(Resource)]
pub struct OcclusionDiagnosticPaths(Spans<{ SPANS.len() }>);

impl Default for OcclusionDiagnosticPaths {
    fn default() -> Self {
        Self(Spans::new(SPANS))
    }
}

/// Writes occlusion culling's entry in [`Effects`] and its diagnostics. Allocates only when the state changes in
/// kind.
pub fn report_occlusion(
    mut effects: ResMut<Effects>,
    stats: Res<OcclusionStats>,
    paths: Res<OcclusionDiagnosticPaths>,
    store: Option<Res<DiagnosticsStore>>,
    table: Res<Candidates>,
    cameras: Query<(
        &ZBufferOcclusion,
        &OcclusionCounts,
        &OcclusionCamera,
        &Camera,
    )>,
    mut diagnostics: Diagnostics,
) {
    let stats = stats.lock();
    let effects = effects.bypass_change_detection();
    effects.hold(Effect::ZBufferOcclusion, stats.bytes);
    let entry = effects.entry(Effect::ZBufferOcclusion);
    if cameras.is_empty() {
        if *entry != EffectState::Dormant {
            *entry = EffectState::Dormant;
        }
        return;
    }
    let no_recheck = stats.no_recheck.as_ref().filter(|_| {
        cameras
            .iter()
            .all(|(settings, ..)| settings.recheck == Recheck::SameFrame)
    });
    if let Some(reason) = stats.unsupported.as_ref().or(no_recheck) {
        if !matches!(entry, EffectState::Unsupported(_)) {
            warn!("nothing is removed by the depth buffer: {reason}");
            *entry = EffectState::Unsupported(reason.clone());
        }
        return;
    }
    let mut total = OcclusionCounts {
        cpu_ms: table.update_ms,
        ..default()
    };
    let (mut cameras_at_work, mut rests, mut wrong) = (0, None, None);
    for (settings, counts, state, camera) in &cameras {
        if !camera.is_active {
            continue;
        }
        if settings.rests && state.pace.plan() != Plan::Work {
            rests = Some(&state.pace);
            continue;
        }
        cameras_at_work += 1;
        wrong = wrong.or_else(|| settings.sampling.complaint());
        total.candidates += counts.candidates;
        total.removed += counts.removed;
        total.rescued += counts.rescued;
        total.cpu_ms += counts.cpu_ms;
    }
    diagnostics.add_measurement(&CANDIDATES, || f64::from(total.candidates));
    diagnostics.add_measurement(&REMOVED, || f64::from(total.removed));
    diagnostics.add_measurement(&RESCUED, || f64::from(total.rescued));
    diagnostics.add_measurement(&CPU_MS, || f64::from(total.cpu_ms));
    if cameras_at_work == 0 {
        let Some(pace) = rests else {
            entry.idle("no camera that asks for it is active");
            return;
        };
        if !matches!(entry, EffectState::Idle(why) if why.starts_with("it would cost")) {
            entry.idle(&format!(
                "it would cost {:.2} ms a frame and save {:.2} ms; it looks again later",
                pace.own_ms(),
                pace.saved_ms()
            ));
        }
        return;
    }
    let activity = entry.activity();
    activity.what.clear();
    let _ = write!(
        activity.what,
        "{} of {} candidates removed, {} drawn late",
        total.removed, total.candidates, total.rescued
    );
    if let Some(wrong) = wrong {
        let _ = write!(activity.what, "; {wrong}");
    }
    activity.cpu_ms = total.cpu_ms;
    activity.gpu_ms = store.and_then(|store| paths.0.smoothed_ms(&store));
    activity.bytes = stats.bytes;
}
