//! Main-world side of terrain shadows: what they tell the user.

use core::fmt::Write;

use bevy::prelude::*;

use crate::{
    effects::{Effect, EffectState, Effects},
    render_graph::stats::TerrainStats,
    terrain::{HeightField, Terrain},
    terrain_shadow::TerrainShadow,
};

/// Writes the shadow maps' entry in [`Effects`]. Takes the same time however large they are, and allocates only
/// when what it says changes.
pub fn report_terrain_shadow(
    mut effects: ResMut<Effects>,
    stats: Res<TerrainStats>,
    fields: Res<Assets<HeightField>>,
    shadows: Query<(&Terrain, &InheritedVisibility), With<TerrainShadow>>,
    mut words: Local<String>,
) {
    let counts = stats.lock();
    let effects = effects.bypass_change_detection();
    effects.hold(Effect::TerrainShadow, counts.shadows.bytes);
    let entry = effects.entry(Effect::TerrainShadow);
    if let Some(reason) = &counts.unsupported {
        if !matches!(entry, EffectState::Unsupported(_)) {
            *entry = EffectState::Unsupported(reason.clone());
        }
        return;
    }
    if shadows.is_empty() {
        if *entry != EffectState::Dormant {
            *entry = EffectState::Dormant;
        }
        return;
    }
    let maps = &counts.shadows;
    words.clear();
    // Writing to a string cannot fail.
    if maps.working {
        let _ = write!(words, "{} of {} maps show", maps.shown, maps.maps);
        if maps.unmeasured {
            let _ = write!(
                words,
                "; the time slice is a guess until a ray has been timed"
            );
        } else {
            let _ = write!(words, ", {:.0} ns a ray", maps.ns_per_ray);
        }
    } else if maps.waiting {
        let _ = write!(words, "out of date, but no camera sees the terrain");
    } else if maps.maps == 0 {
        let mut loaded = shadows
            .iter()
            .filter(|(terrain, _)| fields.contains(&terrain.height_field))
            .peekable();
        words.push_str(if loaded.peek().is_none() {
            "its height field is not loaded yet"
        } else if !loaded.any(|(_, visible)| visible.get()) {
            "every terrain that casts it is hidden"
        } else {
            "no light casts it: set shadow_maps_enabled on one, or ShadowedLights::All"
        });
    } else if maps.shown < maps.maps {
        let _ = write!(words, "waiting for the height field and the shaders");
    } else {
        let mb = maps.bytes as f64 / 1e6;
        let _ = write!(words, "up to date: {} maps, {mb:.1} MB", maps.maps);
    }
    for reason in &maps.refused {
        let _ = write!(words, "; {reason}");
    }
    if !maps.working {
        entry.idle(&words);
        return;
    }
    let activity = entry.activity();
    activity.cpu_ms = maps.cpu_ms;
    // What the step takes by the last ones timed; its own time comes back frames later.
    activity.gpu_ms = (!maps.unmeasured).then_some(maps.ns_per_ray * maps.rays as f32 * 1e-6);
    activity.bytes = maps.bytes;
    activity.what.clear();
    activity.what.push_str(&words);
}
