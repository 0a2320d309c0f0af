//! Main-world side of contribution culling: measures, removes, reports.

use core::any::TypeId;

use bevy::{
    camera::visibility::VisibleEntities,
    diagnostic::{Diagnostic, DiagnosticPath, Diagnostics},
    ecs::lifecycle::RemovedComponents,
    platform::time::Instant,
    prelude::*,
};

use crate::{
    contribution::{ContributionCamera, ContributionCounts, ContributionCulling, area::AreaView},
    culling::{CulledEntities, candidates::Candidates},
    effects::{Effect, EffectState, Effects},
};

/// Entities removed, over all cameras.
pub const REMOVED: DiagnosticPath = DiagnosticPath::const_new("skyline/contribution/removed");
/// Time of measuring areas and removing, over all cameras. units: ms
pub const CPU_MS: DiagnosticPath = DiagnosticPath::const_new("skyline/contribution/cpu_ms");

/// The diagnostics of the effect.
pub(crate) fn diagnostics() -> [Diagnostic; 2] {
    [
        Diagnostic::new(REMOVED),
        Diagnostic::new(CPU_MS).with_suffix(" ms"),
    ]
}

/// Measures the area of everything in view of each camera.
pub fn measure_areas(
    table: Res<Candidates>,
    mut cameras: Query<
        (
            &Camera,
            &GlobalTransform,
            &VisibleEntities,
            &mut ContributionCamera,
            &mut ContributionCounts,
        ),
        With<ContributionCulling>,
    >,
) {
    for (camera, place, visible, mut state, mut counts) in &mut cameras {
        let began = Instant::now();
        *counts = ContributionCounts::default();
        state.areas.clear();
        let (true, Some(viewport)) = (camera.is_active, camera.physical_viewport_size()) else {
            continue;
        };
        let view = AreaView {
            clip_from_world: camera.clip_from_view() * place.to_matrix().inverse(),
            viewport: viewport.as_vec2(),
        };
        for entity in visible.get(TypeId::of::<Mesh3d>()) {
            let Some(of) = table.weighable(*entity).and_then(|slot| table.get(slot)) else {
                state.areas.push(f32::INFINITY);
                continue;
            };
            counts.candidates += 1;
            counts.triangles += u64::from(of.triangles);
            state
                .areas
                .push(view.area_px2(&of.world_from_local, &of.volume));
        }
        counts.cpu_ms = began.elapsed().as_secs_f32() * 1e3;
    }
}

/// Takes what covers too little out of each camera's visible entities, in order.
pub fn cull_small(
    table: Res<Candidates>,
    mut cameras: Query<(
        &ContributionCulling,
        &mut ContributionCamera,
        &mut VisibleEntities,
        &mut CulledEntities,
        &mut ContributionCounts,
    )>,
) {
    for (settings, mut state, mut visible, mut culled, mut counts) in &mut cameras {
        let began = Instant::now();
        culled.small.clear();
        let threshold = settings.threshold_px2.max(state.demanded_px2);
        counts.threshold_px2 = threshold;
        counts.triangles_drawn = counts.triangles;
        let ContributionCamera { removed, areas, .. } = &mut *state;
        let back = threshold * settings.hysteresis.max(1.0);
        let mut at = 0;
        visible.get_mut(TypeId::of::<Mesh3d>()).retain(|entity| {
            let area = areas.get(at).copied().unwrap_or(f32::INFINITY);
            at += 1;
            let Some(slot) = table.weighable(*entity) else {
                return true;
            };
            let least = if removed.contains(slot) {
                back
            } else {
                threshold
            };
            let small = area < least;
            removed.set(slot, small);
            if small {
                culled.small.push(*entity);
                let triangles = table.get(slot).map_or(0, |of| of.triangles);
                counts.triangles_drawn -= u64::from(triangles);
            }
            !small
        });
        counts.removed = culled.small.len() as u32;
        counts.cpu_ms += began.elapsed().as_secs_f32() * 1e3;
    }
}

/// A camera whose culling was taken from it shows nothing of it.
pub fn forget_small(
    mut removed: RemovedComponents<ContributionCulling>,
    mut commands: Commands,
    mut cameras: Query<&mut CulledEntities, Without<ContributionCulling>>,
) {
    for camera in removed.read() {
        if let Ok(mut culled) = cameras.get_mut(camera) {
            culled.small = Vec::new();
            commands
                .entity(camera)
                .remove::<(ContributionCamera, ContributionCounts)>();
        }
    }
}

/// Writes contribution culling's entry in [`Effects`] and its diagnostics.
pub fn report_contribution(
    mut effects: ResMut<Effects>,
    cameras: Query<(&Camera, &ContributionCounts), With<ContributionCulling>>,
    mut diagnostics: Diagnostics,
) {
    let entry = effects
        .bypass_change_detection()
        .entry(Effect::ContributionCulling);
    if cameras.is_empty() {
        if *entry != EffectState::Dormant {
            *entry = EffectState::Dormant;
        }
        return;
    }
    let (mut removed, mut cpu_ms) = (0, 0.0);
    for (_, counts) in cameras.iter().filter(|(camera, _)| camera.is_active) {
        removed += counts.removed;
        cpu_ms += counts.cpu_ms;
    }
    diagnostics.add_measurement(&REMOVED, || f64::from(removed));
    diagnostics.add_measurement(&CPU_MS, || f64::from(cpu_ms));
    entry.activity().cpu_ms = cpu_ms;
}
