//! Says how spherical indices stand.

use core::fmt::Write;

use bevy::prelude::*;

use super::models::{Key, Left, SphericalModels, Step};
use crate::{
    effects::{Effect, EffectState, Effects},
    spherical::{SphericalCounts, SphericalIndex},
};

/// Writes the spherical index's entry in [`Effects`]. Allocates only when its words change.
pub fn report_spherical(
    mut effects: ResMut<Effects>,
    models: Res<SphericalModels>,
    roots: Query<&SphericalCounts, With<SphericalIndex>>,
    meshes: Option<Res<Assets<Mesh>>>,
    mut words: Local<String>,
) {
    let bytes = models
        .indices
        .iter()
        .map(|(_, step)| step.gpu_bytes())
        .sum();
    let effects = effects.bypass_change_detection();
    effects.hold(Effect::SphericalIndex, bytes);
    let entry = effects.entry(Effect::SphericalIndex);
    if roots.is_empty() {
        if *entry != EffectState::Dormant {
            *entry = EffectState::Dormant;
            *words = String::new();
        }
        return;
    }
    if meshes.is_none() {
        if !matches!(entry, EffectState::Unsupported(_)) {
            let missing = "the app has no meshes: add Bevy's MeshPlugin";
            warn!("no mesh is indexed: {missing}");
            *entry = EffectState::Unsupported(missing.to_owned());
        }
        return;
    }
    words.clear();
    let mut left = [0_u32; Left::COUNT];
    let (mut ready, mut loading) = (0, 0);
    for root in models.roots.values() {
        match root.left {
            Some(why) => left[why as usize] += 1,
            None if root.is_loading => loading += 1,
            None => ready += usize::from(root.ready().is_some()),
        }
    }
    let mut total = SphericalCounts::default();
    let mut triangles = 0;
    for counts in roots.iter().filter(|counts| counts.views > 0) {
        total.views += counts.views;
        total.views_by_chunks += counts.views_by_chunks;
        total.drawn_chunks += counts.drawn_chunks;
        total.drawn_triangles += counts.drawn_triangles;
        triangles += u64::from(counts.triangles) * u64::from(counts.views);
    }
    if ready > 0 {
        let _ = write!(
            words,
            "{} of {triangles} triangles are drawn, in {} of {} views by {} chunks",
            total.drawn_triangles, total.views_by_chunks, total.views, total.drawn_chunks,
        );
    }
    let and = |words: &mut String| {
        if !words.is_empty() {
            words.push_str("; ");
        }
    };
    if loading > 0 {
        and(&mut words);
        let _ = write!(words, "waiting for {loading} meshes to load");
    }
    if let Some((_, step)) = models.indices.iter().find(|(_, step)| step.is_under_way()) {
        and(&mut words);
        step.say(&mut words);
    }
    for (count, what) in left
        .iter()
        .zip(Left::WORDS)
        .filter(|(count, _)| **count > 0)
    {
        and(&mut words);
        let (meshes, are) = if *count == 1 {
            ("mesh", "is")
        } else {
            ("meshes", "are")
        };
        let _ = write!(words, "{count} {meshes} {are} drawn whole, {what}");
    }
    for (key, why) in models.indices.iter().filter_map(|(key, step)| match step {
        Step::Failed(why) => Some((key, why)),
        _ => None,
    }) {
        and(&mut words);
        let Key { mesh, .. } = key;
        let _ = write!(words, "{mesh}: {why}");
    }
    if words.is_empty() {
        words.push_str("nothing with it is known yet");
    }
    if total.views_by_chunks == 0 {
        entry.idle(&words);
        return;
    }
    let activity = entry.activity();
    if activity.what != *words {
        activity.what.clone_from(&words);
    }
    activity.gpu_ms = None;
    activity.cpu_ms = models.making_ms + models.selecting_ms;
    activity.bytes = bytes;
}

impl Step {
    /// Of the chunks' meshes, so far.
    fn gpu_bytes(&self) -> u64 {
        match self {
            Self::Build(build) => build.bytes,
            Self::Ready(indexed) => indexed.gpu_bytes,
            Self::Still(_) | Self::Gather(_) | Self::Work(_) | Self::Failed(_) => 0,
        }
    }

    fn is_under_way(&self) -> bool {
        !matches!(self, Self::Ready(_) | Self::Failed(_))
    }

    fn say(&self, words: &mut String) {
        let _ = match self {
            Self::Still(_) => write!(words, "waiting for a mesh to be left alone"),
            Self::Gather(_) => write!(words, "copying a mesh"),
            Self::Work(_) => write!(words, "making a mesh's maps"),
            Self::Build(build) => {
                let [made, of] = build.made();
                write!(words, "making chunks, {made} of {of}")
            }
            Self::Ready(_) | Self::Failed(_) => Ok(()),
        };
    }
}
