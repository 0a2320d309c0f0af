//! What the main world pays for culling, as a ratio to Bevy's own check of what is in view.

use std::time::Instant;

use bevy::{camera::visibility::VisibilitySystems, diagnostic::DiagnosticsStore, prelude::*};
use serde::Serialize;

use super::{super::boxes::boxes, Timing};
use crate::{
    occlusion::ZBufferOcclusion,
    offline::{Offline, OfflineError},
    systems::occlusion::CPU_MS,
};

/// Main-world time of one frame's culling.
#[derive(Serialize, Clone, Debug)]
pub struct CostLine {
    /// Boxes in the scene.
    pub candidates: usize,
    /// Whether half of them are out of view.
    pub half_out_of_view: bool,
    /// Bevy's `CheckVisibility`. units: ms
    pub check_visibility_ms: Timing,
    /// Ours, where it ran. units: ms
    pub occlusion_ms: Option<Timing>,
    /// Ours as a multiple of Bevy's, by medians.
    pub ratio: Option<f64>,
}

/// Times of Bevy's `CheckVisibility`, by two systems that run alone on either side of it.
#[derive(Resource, Default)]
struct CheckVisibilityClock {
    start: Option<Instant>,
    ms: f64,
}

fn start_clock(world: &mut World) {
    world.resource_mut::<CheckVisibilityClock>().start = Some(Instant::now());
}

fn stop_clock(world: &mut World) {
    let mut clock = world.resource_mut::<CheckVisibilityClock>();
    if let Some(start) = clock.start.take() {
        clock.ms = start.elapsed().as_secs_f64() * 1e3;
    }
}

/// Times culling of so many small boxes, all in view or half of them.
///
/// # Errors
/// [`OfflineError`].
pub fn measure_cost(
    candidates: usize,
    half_out_of_view: bool,
    quick: bool,
) -> Result<CostLine, OfflineError> {
    let mut offline = Offline::with(|app| {
        use VisibilitySystems::{
            CalculateBounds, CheckVisibility, MarkNewlyHiddenEntitiesInvisible, UpdateFrusta,
            VisibilityPropagate,
        };
        app.init_resource::<CheckVisibilityClock>().add_systems(
            PostUpdate,
            (
                start_clock
                    .after(CalculateBounds)
                    .after(UpdateFrusta)
                    .after(VisibilityPropagate)
                    .before(CheckVisibility),
                stop_clock
                    .after(CheckVisibility)
                    .before(MarkNewlyHiddenEntitiesInvisible),
            ),
        );
    })?;
    let aside = if half_out_of_view { 0.5 } else { 0.0 };
    let culling = ZBufferOcclusion {
        rests: false,
        ..default()
    };
    boxes(&mut offline, candidates, aside, culling);
    let (warm, timed) = if quick { (3, 5) } else { (6, 21) };
    let (mut bevys, mut ours) = (Vec::new(), Vec::new());
    for frame in 0..warm + timed {
        offline.step();
        if frame >= warm {
            let world = offline.app.world();
            bevys.extend(
                world
                    .get_resource::<CheckVisibilityClock>()
                    .map(|clock| clock.ms),
            );
            ours.extend(occlusion_ms(world));
        }
    }
    let check_visibility_ms = Timing::of(bevys);
    let occlusion_ms = (!ours.is_empty()).then(|| Timing::of(ours));
    Ok(CostLine {
        candidates,
        half_out_of_view,
        check_visibility_ms,
        ratio: occlusion_ms.map(|ours| ours.median / check_visibility_ms.median.max(1e-9)),
        occlusion_ms,
    })
}

/// Main-world time of our culling in the last frame, if it ran. units: ms
fn occlusion_ms(world: &World) -> Option<f64> {
    world
        .get_resource::<DiagnosticsStore>()?
        .get(&CPU_MS)?
        .value()
}
