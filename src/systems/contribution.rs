//! Main-world side of contribution culling: measures, removes, reports.

use core::{any::TypeId, fmt::Write};

use bevy::{
    camera::{
        MainPassResolutionOverride,
        visibility::{NoCpuCulling, VisibleEntities},
    },
    diagnostic::{Diagnostic, DiagnosticPath, Diagnostics, DiagnosticsStore},
    ecs::{lifecycle::RemovedComponents, query::QueryData},
    platform::time::Instant,
    prelude::*,
    render::{occlusion_culling::OcclusionCulling, view::NoIndirectDrawing},
    tasks::ComputeTaskPool,
};

use super::spans::Spans;
#[cfg(feature = "budget")]
use crate::budget::{FrameBudget, WorkloadPolicy};
use crate::{
    contribution::{
        ContributionCamera, ContributionCounts, ContributionCulling, ContributionExit,
        area::AreaView,
        rank::{NEVER_GOES, Standard},
    },
    culling::{
        CulledEntities,
        candidates::{Candidates, NO_SLOT},
    },
    effects::{Effect, EffectState, Effects},
    occlusion::{OcclusionCamera, ZBufferOcclusion, verdict::DepthTest},
    render_graph::contribution::ContributionStats,
};

/// On no camera where the frame budget is not built.
#[cfg(not(feature = "budget"))]
#[derive(Component)]
pub struct FrameBudget;

/// As [`FrameBudget`].
#[cfg(not(feature = "budget"))]
#[derive(Component)]
pub struct WorkloadPolicy;

/// Entities removed, over all cameras.
pub const REMOVED: DiagnosticPath = DiagnosticPath::const_new("skyline/contribution/removed");
/// Time of measuring areas and removing, over all cameras. units: ms
pub const CPU_MS: DiagnosticPath = DiagnosticPath::const_new("skyline/contribution/cpu_ms");

/// From so many entities in view on, areas are measured by several threads: fewer take less time than waking them.
const PARALLEL_FROM: usize = 4096;

/// The least share of its area that an object counts with: what comes into sight is drawn before newer depth tells, if it
/// is of some size.
pub const LEAST_SHARE: f32 = 1.0 / 16.0;

/// The diagnostics of the effect.
pub(crate) fn diagnostics() -> [Diagnostic; 2] {
    [
        Diagnostic::new(REMOVED),
        Diagnostic::new(CPU_MS).with_suffix(" ms"),
    ]
}

/// What is known of a camera when areas are measured.
#[derive(QueryData)]
#[query_data(mutable)]
pub struct MeasuredCamera {
    camera: &'static Camera,
    place: &'static GlobalTransform,
    resolution: Option<&'static MainPassResolutionOverride>,
    settings: &'static ContributionCulling,
    visible: &'static VisibleEntities,
    has_budget: Has<FrameBudget>,
    has_policy: Has<WorkloadPolicy>,
    has_occlusion: Has<ZBufferOcclusion>,
    has_bevys_occlusion: Has<OcclusionCulling>,
    draws_directly: Has<NoIndirectDrawing>,
    state: &'static mut ContributionCamera,
    counts: &'static mut ContributionCounts,
}

/// Measures the area of everything in view of each camera, or asks the GPU to.
pub fn measure_areas(
    table: Res<Candidates>,
    stats: Res<ContributionStats>,
    culled_by_gpu_alone: Query<(), With<NoCpuCulling>>,
    mut cameras: Query<MeasuredCamera>,
) {
    // What Bevy culls on the GPU alone would be drawn without that.
    let can_gpu = culled_by_gpu_alone.is_empty();
    for item in &mut cameras {
        let began = Instant::now();
        let (state, counts) = (item.state.into_inner(), item.counts.into_inner());
        *counts = ContributionCounts::default();
        state.areas.clear();
        state.slots.clear();
        state.gpu = None;
        if !item.has_budget {
            state.demanded_px2 = 0.0;
        }
        if state.epoch != table.epoch() {
            // Slots are others' now.
            state.epoch = table.epoch();
            state.removed.clear(0);
            state.in_view.clear(0);
        }
        for slot in table.assigned() {
            state.removed.remove(*slot);
            state.in_view.remove(*slot);
        }
        let (true, Some(viewport)) = (item.camera.is_active, item.camera.physical_viewport_size())
        else {
            state.removed.clear(0);
            state.in_view.clear(0);
            continue;
        };
        let viewport = item.resolution.map_or(viewport, |to| to.0).as_vec2();
        state.standard = Standard {
            own_px2: own_threshold(item.settings),
            hysteresis: hysteresis(item.settings),
            never_px2: NEVER_GOES * viewport.element_product(),
        };
        let view = AreaView::new(
            item.camera.clip_from_view() * item.place.to_matrix().inverse(),
            viewport,
        );
        let list = item.visible.get(TypeId::of::<Mesh3d>());
        let by_gpu = can_gpu
            && list.len() >= item.settings.gpu_from
            && item.settings.exit == ContributionExit::Cut
            && !item.has_budget
            && !item.has_policy
            && !item.has_occlusion
            && !item.has_bevys_occlusion
            && !item.draws_directly
            && stats.lock().is_ready();
        if by_gpu {
            state.gpu = Some(view);
            state.asked.clear(table.slots());
        }
        // A policy goes by something else.
        let by_policy = item.has_policy && !item.has_budget;
        let view = (!by_gpu && !by_policy).then_some(&view);
        let measured = measure(&table, view, list, state);
        (counts.candidates, counts.triangles) = measured;
        counts.cpu_ms = began.elapsed().as_secs_f32() * 1e3;
    }
}

/// Fills a camera's slots and, with a view, areas, in the order of `list`; returns how many are candidates, and their
/// triangles.
fn measure(
    table: &Candidates,
    view: Option<&AreaView>,
    list: &[Entity],
    state: &mut ContributionCamera,
) -> (u32, u64) {
    let ContributionCamera {
        slots,
        areas,
        asked,
        gpu,
        ..
    } = state;
    slots.resize(list.len(), NO_SLOT);
    areas.resize(list.len(), f32::INFINITY);
    let one = |entity: Entity, slot: &mut u32, area: &mut f32| {
        let found = table.weighable(entity);
        let Some((found, of)) = found.and_then(|slot| Some((slot, table.get(slot)?))) else {
            return (0, 0);
        };
        *slot = found;
        if let Some(view) = view {
            *area = view.area_px2(&of.world_from_local, &of.volume);
        }
        (1, u64::from(of.triangles))
    };
    let sum = |a: (u32, u64), b: (u32, u64)| (a.0 + b.0, a.1 + b.1);
    let part = |list: &[Entity], slots: &mut [u32], areas: &mut [f32]| {
        let mut total = (0, 0);
        for ((entity, slot), area) in list.iter().zip(slots).zip(areas) {
            total = sum(total, one(*entity, slot, area));
        }
        total
    };
    let threads = match list.len() {
        0..PARALLEL_FROM => 1,
        _ => ComputeTaskPool::try_get().map_or(1, |pool| pool.thread_num()),
    };
    let total = if threads <= 1 {
        part(list, slots, areas)
    } else {
        let size = list.len().div_ceil(threads);
        let parts = (list.chunks(size))
            .zip(slots.chunks_mut(size))
            .zip(areas.chunks_mut(size));
        let part = &part;
        let totals = ComputeTaskPool::get().scope(|scope| {
            for ((list, slots), areas) in parts {
                scope.spawn(async move { part(list, slots, areas) });
            }
        });
        totals.into_iter().fold((0, 0), sum)
    };
    if gpu.is_some() {
        for slot in slots.iter().filter(|slot| **slot != NO_SLOT) {
            asked.insert(*slot);
        }
    }
    total
}

/// What is known of a camera when what is too small is removed.
#[derive(QueryData)]
#[query_data(mutable)]
pub struct CullingCamera {
    camera: &'static Camera,
    settings: &'static ContributionCulling,
    occlusion: Option<&'static OcclusionCamera>,
    state: &'static mut ContributionCamera,
    visible: &'static mut VisibleEntities,
    culled: &'static mut CulledEntities,
    counts: &'static mut ContributionCounts,
}

/// Takes what covers too little out of each camera's visible entities, in order.
pub fn cull_small(
    table: Res<Candidates>,
    time: Res<Time<Real>>,
    mut cameras: Query<CullingCamera>,
) {
    for item in &mut cameras {
        let began = Instant::now();
        let (settings, state) = (item.settings, item.state.into_inner());
        let (culled, counts) = (
            &mut item.culled.into_inner().small,
            item.counts.into_inner(),
        );
        culled.clear();
        counts.triangles_drawn = counts.triangles;
        if !item.camera.is_active {
            state.fades.end_all();
            continue;
        }
        let standard = state.standard;
        counts.threshold_px2 = standard.own_px2;
        counts.demanded_px2 = state.demanded_px2;
        let list = item.visible.into_inner().get_mut(TypeId::of::<Mesh3d>());
        if state.gpu.is_some() {
            counts.on_gpu = true;
            state.fades.end_all();
            let own = standard.own_px2;
            state.thresholds = (own, own * standard.hysteresis);
            take_verdicts(&table, list, state, culled, counts);
        } else {
            let seconds = match settings.exit {
                ContributionExit::Dithered { seconds } if seconds.is_finite() && seconds > 0.0 => {
                    Some(seconds)
                }
                _ => None,
            };
            if let Some(seconds) = seconds {
                state.fades.advance(time.delta_secs() / seconds);
                state.in_view_now.clear(table.slots());
            } else {
                state.fades.end_all();
            }
            let depth = item
                .occlusion
                .filter(|_| settings.weigh_by_visibility)
                .and_then(|occlusion| occlusion.newest.as_ref())
                .map(|newest| DepthTest::new(&newest.depth));
            let judge = Judge {
                table: &table,
                standard,
                demanded: state.demanded_px2,
                depth,
                fades: seconds.is_some(),
            };
            judge.cull(list, state, culled, counts);
            if seconds.is_some() {
                state.fades.end_frame();
                core::mem::swap(&mut state.in_view, &mut state.in_view_now);
            }
        }
        counts.removed = culled.len() as u32;
        counts.cpu_ms += began.elapsed().as_secs_f32() * 1e3;
    }
}

/// The threshold that holds without a budget; 0 where nothing is ever too small. units: px²
pub(crate) fn own_threshold(settings: &ContributionCulling) -> f32 {
    let threshold = settings.threshold_px2;
    if threshold.is_finite() {
        threshold.max(0.0)
    } else {
        0.0
    }
}

/// How many times the threshold it takes to come back, at least 1.
pub(crate) fn hysteresis(settings: &ContributionCulling) -> f32 {
    let hysteresis = settings.hysteresis;
    if hysteresis.is_finite() {
        hysteresis.max(1.0)
    } else {
        1.0
    }
}

/// A setting outside its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Complaint {
    Threshold,
    Hysteresis,
    Seconds,
}

/// What is wrong with settings. Where something else takes objects out, too, nothing need be too small by itself.
fn complaint(settings: &ContributionCulling, may_be_zero: bool) -> Option<Complaint> {
    let threshold = settings.threshold_px2;
    if own_threshold(settings) != threshold || (threshold == 0.0 && !may_be_zero) {
        Some(Complaint::Threshold)
    } else if hysteresis(settings) != settings.hysteresis {
        Some(Complaint::Hysteresis)
    } else {
        match settings.exit {
            ContributionExit::Dithered { seconds } if !(seconds.is_finite() && seconds > 0.0) => {
                Some(Complaint::Seconds)
            }
            _ => None,
        }
    }
}

/// Says of everything in one camera's view whether it is too small.
struct Judge<'a> {
    table: &'a Candidates,
    standard: Standard,
    /// By a budget. units: px²
    demanded: f32,
    depth: Option<DepthTest<'a>>,
    fades: bool,
}

impl Judge<'_> {
    fn cull(
        &self,
        list: &mut Vec<Entity>,
        state: &mut ContributionCamera,
        culled: &mut Vec<Entity>,
        counts: &mut ContributionCounts,
    ) {
        let ContributionCamera {
            removed,
            areas,
            slots,
            in_view,
            in_view_now,
            fades,
            ..
        } = state;
        let mut measured = slots.iter().zip(areas.iter());
        list.retain(|entity| {
            let Some((&slot, &area)) = measured.next().filter(|(slot, _)| **slot != NO_SLOT) else {
                return true;
            };
            let was_small = removed.contains(slot);
            let small = self.is_small(slot, area, was_small);
            if small != was_small {
                removed.set(slot, small);
            }
            let drawn = if self.fades {
                in_view_now.set(slot, true);
                fades.is_drawn(*entity, small, was_small, in_view.contains(slot))
            } else {
                !small
            };
            if !drawn {
                culled.push(*entity);
                let triangles = self.table.get(slot).map_or(0, |of| of.triangles);
                counts.triangles_drawn -= u64::from(triangles);
            }
            drawn
        });
    }

    /// By its area, as far as it shows: that is looked up only where it decides.
    fn is_small(&self, slot: u32, area: f32, was_small: bool) -> bool {
        // Only to a demand does it matter how many triangles there are.
        let triangles = if self.demanded > 0.0 {
            self.table.get(slot).map_or(0, |of| of.triangles)
        } else {
            0
        };
        let least = (self.standard).least_px2(area, triangles, self.demanded, was_small);
        if area < least {
            return true;
        }
        let (true, Some(depth)) = (area * LEAST_SHARE < least, &self.depth) else {
            return false;
        };
        self.table.get(slot).is_some_and(|of| {
            let share = depth.visible_share(&of.world_from_local, &of.volume);
            // Of what does not show at all occlusion culling knows more: it looks again in the same frame.
            share > 0.0 && area * share.max(LEAST_SHARE) < least
        })
    }
}

/// Notes what the GPU's newest verdicts to come back have left out of the picture.
fn take_verdicts(
    table: &Candidates,
    list: &[Entity],
    state: &mut ContributionCamera,
    culled: &mut Vec<Entity>,
    counts: &mut ContributionCounts,
) {
    if let Some(returned) = state.mailbox.take() {
        if returned.epoch == table.epoch() {
            state.removed.set_from(&returned.tested, &returned.hidden);
            for slot in table.assigned() {
                state.removed.remove(*slot);
            }
        }
        state.mailbox.recycle(returned);
    }
    for (entity, slot) in list.iter().zip(&state.slots) {
        if *slot != NO_SLOT && state.removed.contains(*slot) {
            culled.push(*entity);
            let triangles = table.get(*slot).map_or(0, |of| of.triangles);
            counts.triangles_drawn -= u64::from(triangles);
        }
    }
}

/// A camera whose culling was taken from it keeps nothing of it.
pub fn forget_small(
    mut removed: RemovedComponents<ContributionCulling>,
    mut commands: Commands,
    mut cameras: Query<
        (Option<&mut CulledEntities>, Has<ZBufferOcclusion>),
        Without<ContributionCulling>,
    >,
) {
    for camera in removed.read() {
        if let Ok((culled, occludes)) = cameras.get_mut(camera) {
            if let Some(mut culled) = culled {
                culled.small = Vec::new();
            }
            let mut entity = commands.entity(camera);
            entity.remove::<(ContributionCamera, ContributionCounts)>();
            if !occludes {
                entity.remove::<CulledEntities>();
            }
        }
    }
}

/// The diagnostics that the passes' spans appear under, made once.
#[derive(Resource)]
pub struct ContributionDiagnosticPaths(Spans<2>);

impl Default for ContributionDiagnosticPaths {
    fn default() -> Self {
        Self(Spans::new(["contribution", "contribution_draws"]))
    }
}

/// What is told of a camera.
#[derive(QueryData)]
pub struct ReportedCamera {
    camera: &'static Camera,
    settings: &'static ContributionCulling,
    counts: &'static ContributionCounts,
    has_budget: Has<FrameBudget>,
    has_policy: Has<WorkloadPolicy>,
}

/// Writes contribution culling's entry in [`Effects`] and its diagnostics. Allocates only when the state changes in kind.
#[expect(clippy::too_many_arguments, reason = "each is a part of what is told")]
pub fn report_contribution(
    mut effects: ResMut<Effects>,
    stats: Res<ContributionStats>,
    paths: Res<ContributionDiagnosticPaths>,
    store: Option<Res<DiagnosticsStore>>,
    table: Res<Candidates>,
    cameras: Query<ReportedCamera>,
    occluders: Query<(), With<ZBufferOcclusion>>,
    mut diagnostics: Diagnostics,
) {
    let bytes = stats.lock().bytes;
    let effects = effects.bypass_change_detection();
    effects.hold(Effect::ContributionCulling, bytes);
    let entry = effects.entry(Effect::ContributionCulling);
    if cameras.is_empty() {
        if *entry != EffectState::Dormant {
            *entry = EffectState::Dormant;
        }
        return;
    }
    let mut total = ContributionCounts::default();
    let (mut active, mut wrong) = (0, None);
    for item in &cameras {
        let (settings, counts) = (item.settings, item.counts);
        if !item.camera.is_active {
            continue;
        }
        active += 1;
        total.candidates += counts.candidates;
        total.removed += counts.removed;
        total.cpu_ms += counts.cpu_ms;
        total.on_gpu |= counts.on_gpu;
        total.threshold_px2 = total.threshold_px2.max(counts.threshold_px2);
        total.demanded_px2 = total.demanded_px2.max(counts.demanded_px2);
        wrong = wrong.or_else(|| {
            Some((
                complaint(settings, item.has_budget || item.has_policy)?,
                settings,
            ))
        });
    }
    diagnostics.add_measurement(&REMOVED, || f64::from(total.removed));
    diagnostics.add_measurement(&CPU_MS, || f64::from(total.cpu_ms));
    if active == 0 {
        entry.idle("no camera that asks for it is active");
        return;
    }
    let activity = entry.activity();
    activity.what.clear();
    let what = &mut activity.what;
    let _ = write!(
        what,
        "{} of {} candidates removed, below {} px²",
        total.removed, total.candidates, total.threshold_px2
    );
    if total.demanded_px2 > 0.0 {
        let _ = write!(what, ", {} px² demanded", total.demanded_px2);
    }
    if total.on_gpu {
        let _ = write!(what, ", compared by the GPU");
    }
    if let Some((wrong, settings)) = wrong {
        let _ = match wrong {
            Complaint::Threshold => write!(
                what,
                "; a threshold of {} px² removes nothing: set one above 0",
                settings.threshold_px2
            ),
            Complaint::Hysteresis => write!(
                what,
                "; a hysteresis of {} is taken for 1: set 1 or more",
                settings.hysteresis
            ),
            Complaint::Seconds => {
                write!(what, "; {:?} is a cut: set a time above 0", settings.exit)
            }
        };
    }
    // The table of candidates is kept for both; where both are asked for, occlusion culling tells its time.
    let of_table = if occluders.is_empty() {
        table.update_ms
    } else {
        0.0
    };
    activity.cpu_ms = of_table + total.cpu_ms;
    activity.gpu_ms = store
        .filter(|_| total.on_gpu)
        .and_then(|store| paths.0.smoothed_ms(&store));
    activity.bytes = bytes;
}
