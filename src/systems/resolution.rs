//! Main-world side of resolution scale: what it tells the user. Rendering works from the component alone.

use core::fmt::Write;

use bevy::{diagnostic::DiagnosticsStore, prelude::*};

use super::spans::Spans;
use crate::{
    effects::{Effect, EffectState, Effects},
    render_graph::upscale::ScaleStats,
    resolution::ResolutionScale,
};

/// The diagnostic that its pass appears under, made once.
#[derive(Resource)]
pub struct ScaleDiagnosticPaths(Spans<1>);

impl Default for ScaleDiagnosticPaths {
    fn default() -> Self {
        Self(Spans::new(["upscale"]))
    }
}

/// Writes resolution scale's entry in [`Effects`]. Allocates only when the state changes in kind.
pub fn report_scale(
    mut effects: ResMut<Effects>,
    stats: Res<ScaleStats>,
    paths: Res<ScaleDiagnosticPaths>,
    diagnostics: Option<Res<DiagnosticsStore>>,
    cameras: Query<(&Camera, &ResolutionScale)>,
) {
    let work = *stats.lock();
    let effects = effects.bypass_change_detection();
    effects.hold(Effect::ResolutionScale, work.bytes);
    let entry = effects.entry(Effect::ResolutionScale);
    if cameras.is_empty() {
        if *entry != EffectState::Dormant {
            *entry = EffectState::Dormant;
        }
        return;
    }
    let mut active = cameras.iter().filter(|(camera, _)| camera.is_active);
    if work.cameras == 0 {
        let is_asked = |(_, scale): (_, &ResolutionScale)| scale.clamped() < 1.0;
        entry.idle(match (work.refused, work.compiling) {
            (Some(why), _) => why.reason(),
            (None, true) => "its pass is being compiled: all pixels are drawn until then",
            (None, false) if active.clone().next().is_none() => {
                "no camera that asks for it is active"
            }
            (None, false) if !active.any(is_asked) => "its scale is 1: all pixels are drawn",
            (None, false) => "no camera that asks for it was drawn with fewer pixels yet",
        });
        return;
    }
    let activity = entry.activity();
    activity.cpu_ms = work.cpu_ms;
    activity.bytes = work.bytes;
    activity.gpu_ms = diagnostics.and_then(|store| paths.0.latest_ms(&store));
    activity.what.clear();
    // Writing to a string cannot fail.
    let what = &mut activity.what;
    let (drawn, size) = work.size;
    let _ = write!(
        what,
        "{}×{} of {}×{} pixels drawn",
        drawn.x, drawn.y, size.x, size.y
    );
    if work.cameras > 1 {
        let _ = write!(what, " and {} cameras more", work.cameras - 1);
    }
    if let Some(why) = work.refused {
        let _ = write!(what, "; of another camera all: {why}");
    }
}
