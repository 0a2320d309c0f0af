//! Says how interior culling stands.

use core::fmt::Write;

use bevy::prelude::*;

use super::{
    Assetry,
    models::{InteriorModels, Job, LeftCounts, Step},
    node::Left,
};
use crate::{
    effects::{Effect, EffectState, Effects},
    interior::{InteriorCounts, InteriorCulling},
};

/// Writes interior culling's entry in [`Effects`]. Allocates only when its words change.
pub fn report_interior(
    mut effects: ResMut<Effects>,
    models: Res<InteriorModels>,
    roots: Query<(), With<InteriorCulling>>,
    assets: Assetry,
    mut words: Local<String>,
) {
    let effects = effects.bypass_change_detection();
    let trimmed = || models.store.trimmed().map(|trimmed| trimmed.bytes).sum();
    if roots.is_empty() {
        effects.hold(Effect::InteriorCulling, trimmed());
        let entry = effects.entry(Effect::InteriorCulling);
        if *entry != EffectState::Dormant {
            *entry = EffectState::Dormant;
            *words = String::new();
        }
        return;
    }
    let entry = effects.entry(Effect::InteriorCulling);
    if let Some(missing) = assets.missing() {
        if !matches!(entry, EffectState::Unsupported(_)) {
            warn!("no interior is culled: {missing}");
            *entry = EffectState::Unsupported(missing.to_owned());
        }
        return;
    }
    words.clear();
    let mut total = InteriorCounts::default();
    let (mut done, mut left) = (0, LeftCounts::default());
    let mut waiting: Option<(&Job, u32)> = None;
    for job in models.jobs.values() {
        if matches!(job.step, Step::Done) {
            done += 1;
            total.nodes += job.counts.nodes;
            total.hidden_nodes += job.counts.hidden_nodes;
            total.triangles += job.counts.triangles;
            total.hidden_triangles += job.counts.hidden_triangles;
            left.add_all(&job.left);
        } else {
            // What went wrong is said before what takes its time, and what works before what waits.
            let rank = rank(&job.step);
            if waiting.is_none_or(|(_, least)| rank < least) {
                waiting = Some((job, rank));
            }
        }
    }
    if done > 0 {
        let _ = write!(
            words,
            "{} of {} nodes and {} of {} triangles are hidden",
            Grouped(total.hidden_nodes.into()),
            Grouped(total.nodes.into()),
            Grouped(total.hidden_triangles),
            Grouped(total.triangles),
        );
        say_left(&mut words, &left);
        if models.jobs.len() > 1 {
            let _ = write!(words, "; {done} of {} models", models.jobs.len());
        }
    }
    if let Some((job, _)) = waiting {
        if done > 0 {
            words.push_str("; ");
        }
        say(&mut words, job);
    }
    if words.is_empty() {
        words.push_str("nothing below its root is known yet");
    }
    // What is held changes with what is said.
    let said = match entry {
        EffectState::Idle(why) => Some(why.as_str()),
        EffectState::Active(activity) => Some(activity.what.as_str()),
        EffectState::Unsupported(_) | EffectState::Dormant => None,
    };
    if said != Some(words.as_str()) {
        effects.hold(Effect::InteriorCulling, trimmed());
    }
    let bytes = effects.bytes(Effect::InteriorCulling);
    let entry = effects.entry(Effect::InteriorCulling);
    if done == 0 {
        entry.idle(&words);
        return;
    }
    let activity = entry.activity();
    if activity.what != *words {
        activity.what.clone_from(&words);
    }
    activity.gpu_ms = None;
    activity.bytes = bytes;
    activity.cpu_ms = models.cpu_ms;
}

fn rank(step: &Step) -> u32 {
    match step {
        Step::Failed(_) => 0,
        Step::Work(_) => 1,
        Step::Gather(_) | Step::Build(_) | Step::Hide(_) => 2,
        Step::Load(_) => 3,
        Step::Walk(_) | Step::Still(_) | Step::Nothing => 4,
        Step::Turn | Step::Done => 5,
    }
}

fn say(words: &mut String, job: &Job) {
    let percent = |part: f32| (100.0 * part).round() as u32;
    let _ = match &job.step {
        Step::Still(_) => write!(words, "waiting for the model to keep still"),
        Step::Walk(_) => write!(
            words,
            "looking through the model, {} nodes so far",
            Grouped(job.nodes.len() as u64)
        ),
        Step::Load(load) => {
            let [meshes, materials] = load.of;
            if load.meshes.is_empty() {
                write!(
                    words,
                    "waiting for {} of {materials} materials to load",
                    load.materials.len()
                )
            } else {
                write!(
                    words,
                    "waiting for {} of {meshes} meshes to load",
                    load.meshes.len()
                )
            }
        }
        Step::Nothing if job.left.total() == 0 => {
            write!(words, "waiting for a mesh: there is none below the root")
        }
        Step::Nothing => {
            words.push_str("there is nothing to cull");
            say_left(words, &job.left);
            Ok(())
        }
        Step::Turn => write!(words, "waiting for another model to be done"),
        Step::Gather(gather) => write!(
            words,
            "copying meshes, {} %",
            percent(gather.done(&job.meshes))
        ),
        Step::Work(work) => {
            let (stage, part) = work.now();
            write!(words, "{}, {} %", stage.name(), percent(part))
        }
        Step::Build(build) => {
            let [made, of] = build.made();
            if made < of {
                write!(words, "trimming meshes, {made} of {of}")
            } else {
                write!(
                    words,
                    "waiting for {} of {of} trimmed meshes to come to the GPU",
                    build.waiting.len()
                )
            }
        }
        Step::Hide(next) => write!(
            words,
            "hiding, {} %",
            percent(*next as f32 / job.parts.len().max(1) as f32)
        ),
        Step::Done => Ok(()),
        Step::Failed(why) => write!(words, "{why}"),
    };
}

fn say_left(words: &mut String, left: &LeftCounts) {
    for (count, what) in left
        .0
        .iter()
        .zip(Left::WORDS)
        .filter(|(count, _)| **count > 0)
    {
        let (nodes, are) = if *count == 1 {
            ("node", "is")
        } else {
            ("nodes", "are")
        };
        let _ = write!(
            words,
            "; {} {nodes} {are} left alone, {what}",
            Grouped((*count).into())
        );
    }
}

impl LeftCounts {
    fn add_all(&mut self, other: &Self) {
        for (sum, count) in self.0.iter_mut().zip(other.0) {
            *sum += count;
        }
    }
}

/// A count with its thousands apart.
struct Grouped(u64);

impl core::fmt::Display for Grouped {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        if self.0 >= 1000 {
            write!(f, "{},{:03}", Self(self.0 / 1000), self.0 % 1000)
        } else {
            write!(f, "{}", self.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Grouped;

    #[test]
    fn thousands_stand_apart() {
        for (count, words) in [
            (0, "0"),
            (999, "999"),
            (1_000, "1,000"),
            (1_103_041, "1,103,041"),
        ] {
            assert_eq!(Grouped(count).to_string(), words);
        }
    }
}
