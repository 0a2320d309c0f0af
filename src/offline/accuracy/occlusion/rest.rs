//! What culling costs where there is nothing to cull (P2's sea bed with everything visible: 0.825 frames a second
//! without, 0.811 with its tests): while it works all the same, and once it has found that it does not pay.

use bevy::platform::time::Instant;
use indicatif::ProgressBar;
use serde::Serialize;

use super::{AccuracyError, Timing};
use crate::{
    effects::{EffectState, Effects},
    occlusion::ZBufferOcclusion,
    offline::scenes::{
        View,
        stage::{Culling, SceneStage},
    },
};

/// Frames that culling is given to find that it does not pay.
const SETTLE_FRAMES: usize = 40;
/// Frames before each timing that needs no settling.
const WARM_FRAMES: usize = 8;
/// Frames of each block timed.
const TIMED_FRAMES: usize = 20;

/// Frames from a place where next to nothing is hidden.
#[derive(Serialize, Clone, Debug)]
pub struct RestLine {
    /// Scene and view.
    pub scene: String,
    /// Frustum culling alone. units: ms
    pub frustum_ms: Timing,
    /// Ours as it is by default, after 40 frames. units: ms
    pub resting_ms: Timing,
    /// In how many of these it rested.
    pub rested_frames: usize,
    /// Ours, at work all the time. units: ms
    pub working_ms: Timing,
    /// Ours by default as a multiple of frustum culling alone, by medians.
    pub resting_to_frustum: f64,
    /// Ours at work as a multiple of frustum culling alone, by medians.
    pub working_to_frustum: f64,
    /// [`resting_to_frustum`](Self::resting_to_frustum) by the quickest frames, which other load on the machine
    /// disturbs least.
    pub resting_to_frustum_least: f64,
}

/// Times a view with frustum culling alone, with ours, and with ours kept at work, in alternating blocks.
pub(super) fn measure_rest(
    stage: &mut SceneStage,
    view: &View,
    rounds: usize,
    progress: &ProgressBar,
) -> Result<RestLine, AccuracyError> {
    let ours = |rests| {
        Culling::ZBuffer(ZBufferOcclusion {
            rests,
            ..ZBufferOcclusion::default()
        })
    };
    let ways = [
        (Culling::Frustum, WARM_FRAMES),
        // Whatever it decided before, it has time to decide again.
        (ours(true), SETTLE_FRAMES),
        (ours(false), WARM_FRAMES),
    ];
    stage.look(view.transform);
    let mut times: [Vec<f64>; 3] = Default::default();
    let mut rested_frames = 0;
    for _ in 0..rounds {
        for ((culling, warm), times) in ways.iter().zip(&mut times) {
            stage.set_culling(culling);
            for _ in 0..*warm {
                stage.offline.step();
            }
            for _ in 0..TIMED_FRAMES {
                let start = Instant::now();
                stage.offline.step();
                times.push(start.elapsed().as_secs_f64() * 1e3);
                if *culling == ways[1].0 {
                    let effects = stage.offline.app.world().get_resource::<Effects>();
                    let idle = effects
                        .is_some_and(|effects| matches!(effects.occlusion(), EffectState::Idle(_)));
                    rested_frames += usize::from(idle);
                }
            }
            progress.inc(1);
        }
    }
    let [frustum_ms, resting_ms, working_ms] = times.map(Timing::of);
    let to_frustum = |of: Timing| of.median / frustum_ms.median.max(1e-9);
    Ok(RestLine {
        scene: format!("{}/{}", stage.scene.name, view.name),
        frustum_ms,
        resting_ms,
        rested_frames,
        working_ms,
        resting_to_frustum: to_frustum(resting_ms),
        working_to_frustum: to_frustum(working_ms),
        resting_to_frustum_least: resting_ms.min / frustum_ms.min.max(1e-9),
    })
}
