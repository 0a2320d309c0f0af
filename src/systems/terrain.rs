//! Main-world side of terrain: what it tells the user. Rendering works from the components alone.

use core::fmt::Write;

use bevy::{diagnostic::DiagnosticsStore, prelude::*};

use super::spans::Spans;
use crate::{
    effects::{Effect, EffectState, Effects},
    render_graph::stats::TerrainStats,
    terrain::{HeightField, Terrain},
};

/// Spans that terrain's GPU time is the sum of.
const SPANS: [&str; 10] = [
    "height_mips",
    "subdivide",
    "box_entry",
    "beam",
    "ray_cast",
    "terrain_depth",
    "terrain_shade",
    "terrain_cascade_cast",
    "terrain_cascade_erode",
    "terrain_cascade",
];

/// The diagnostics terrain's spans appear under, made once.
#[derive(Resource)]
pub struct TerrainDiagnosticPaths(Spans<{ SPANS.len() }>);

impl Default for TerrainDiagnosticPaths {
    fn default() -> Self {
        Self(Spans::new(SPANS))
    }
}

/// Writes terrain's entry in [`Effects`]. Takes the same time whatever the fields' sizes, and allocates only
/// when the state changes in kind.
pub fn report_terrain(
    mut effects: ResMut<Effects>,
    stats: Res<TerrainStats>,
    paths: Res<TerrainDiagnosticPaths>,
    diagnostics: Option<Res<DiagnosticsStore>>,
    fields: Res<Assets<HeightField>>,
    terrains: Query<(&Terrain, &InheritedVisibility)>,
) {
    let counts = stats.lock();
    let bytes = counts.field_bytes + counts.view_bytes + counts.cascade_bytes;
    let effects = effects.bypass_change_detection();
    effects.hold(Effect::Terrain, bytes);
    let entry = effects.entry(Effect::Terrain);
    if let Some(reason) = &counts.unsupported {
        if !matches!(entry, EffectState::Unsupported(_)) {
            *entry = EffectState::Unsupported(reason.clone());
        }
        return;
    }
    if terrains.is_empty() {
        if *entry != EffectState::Dormant {
            *entry = EffectState::Dormant;
        }
        return;
    }
    if counts.views_drawn == 0 {
        let loaded = terrains
            .iter()
            .any(|(terrain, _)| fields.contains(&terrain.height_field));
        let shown = terrains.iter().any(|(_, visible)| visible.get());
        entry.idle(match (counts.refused.first(), loaded, shown) {
            (Some(reason), ..) => reason,
            (None, false, _) => "its height field is not loaded yet",
            (None, true, false) => "every terrain is hidden",
            (None, true, true) => "no camera has terrain in view",
        });
        return;
    }
    let activity = entry.activity();
    activity.cpu_ms = counts.cpu_ms;
    activity.bytes = bytes;
    activity.gpu_ms = diagnostics.and_then(|store| paths.0.latest_ms(&store));
    activity.what.clear();
    // Writing to a string cannot fail.
    let views = counts.views_drawn;
    let s = if views == 1 { "" } else { "s" };
    let _ = write!(activity.what, "{views} view{s} ray cast");
    if counts.box_capacity > 0 {
        let _ = write!(activity.what, ", {} boxes", counts.boxes);
        if counts.boxes > counts.box_capacity {
            let _ = write!(
                activity.what,
                " for which the list had room for {}: rays start without boxes until it has grown",
                counts.box_capacity
            );
        }
    }
    for reason in &counts.refused {
        let _ = write!(activity.what, "; {reason}");
    }
}
