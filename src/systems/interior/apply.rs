//! Hides and trims, restores, and keeps hidden what is hidden.
//!
//! # How a node is hidden
//! Its `InheritedVisibility` is held at hidden. That is what cameras and the shadow views of lights ask first, so it is
//! drawn in none, and costs nothing in any frame; and what is hidden inside casts no shadow that the walls around it do
//! not. Its `Visibility` is the user's: it keeps its value, and is marked as changed when the node is restored, so that
//! Bevy says anew what is shown, there and below. Below a hidden node Bevy would hide what inherits, so that only those
//! nodes are hidden below which all is hidden too.

use bevy::prelude::*;

use super::models::{InteriorModels, Job, PartOf, Shown, Step};
use crate::{interior::InteriorCounts, render_graph::mesh_uploads::Asker, systems::slice::Slice};

/// So many parts are done before the clock is looked at.
const BATCH: usize = 64;

/// What is written of a part.
type Parts<'w, 's> = Query<
    'w,
    's,
    (
        &'static mut PartOf,
        Option<&'static mut Mesh3d>,
        Option<&'static mut Visibility>,
        Option<&'static mut InheritedVisibility>,
    ),
>;

/// Restores the models that were disturbed and those that are not asked for any more, in the frame in which that
/// happens.
pub fn restore_parts(mut models: ResMut<InteriorModels>, mut parts: Parts, mut commands: Commands) {
    let models = &mut *models;
    for job in models.jobs.values_mut() {
        if core::mem::take(&mut job.is_disturbed) {
            restore(job, &mut parts, &mut commands);
            if models.turn == Some(job.root) {
                models.turn = None;
                models.uploads.clear(Asker::Interior);
            }
        }
    }
    for mut job in models.leaving.drain(..) {
        restore(&mut job, &mut parts, &mut commands);
        if models.turn == Some(job.root) {
            models.turn = None;
            models.uploads.clear(Asker::Interior);
        }
        let is_back = models.jobs.contains_key(&job.root);
        for entity in job
            .tracked()
            .filter(|entity| !(is_back && *entity == job.root))
        {
            // It may have come to another model meanwhile.
            if parts
                .get(entity)
                .is_ok_and(|(part, ..)| part.root == job.root)
            {
                commands.entity(entity).try_remove::<PartOf>();
            }
        }
    }
    models.store.sweep();
    if models.jobs.is_empty() {
        // Nothing is held any more, not even memory for more.
        *models = InteriorModels {
            uploads: models.uploads.clone(),
            // The app's own; nothing of it is held.
            gpu: models.gpu.take(),
            ..default()
        };
    }
}

fn restore(job: &mut Job, parts: &mut Parts, commands: &mut Commands) {
    for part in &mut job.parts {
        let shown = core::mem::replace(&mut part.shown, Shown::AsItWas);
        let Some(node) = job.nodes.get(part.node as usize) else {
            continue;
        };
        match shown {
            Shown::AsItWas => {}
            Shown::Hidden => {
                if let Ok((mut part, _, visibility, _)) = parts.get_mut(node.entity) {
                    part.is_hidden = false;
                    if let Some(mut visibility) = visibility {
                        visibility.set_changed();
                    }
                }
            }
            Shown::Trimmed(trimmed) => {
                if let Ok((_, Some(mut mesh), ..)) = parts.get_mut(node.entity)
                    && mesh.id() == trimmed
                {
                    mesh.0 = part.original.clone();
                }
            }
        }
    }
    commands.entity(job.root).try_remove::<InteriorCounts>();
}

/// Hides and trims what was found to be hidden, some of it a frame: on the way the picture from outside is the same.
pub fn hide_parts(mut models: ResMut<InteriorModels>, mut parts: Parts, mut commands: Commands) {
    let models = &mut *models;
    let slice = Slice::begin_after(models.cpu_ms);
    for job in models.jobs.values_mut() {
        let Step::Hide(done) = job.step else {
            continue;
        };
        let is_hideable = if done == 0 {
            hideable(job)
        } else {
            core::mem::take(&mut job.hideable)
        };
        let mut next = done;
        while next < job.parts.len() && (next % BATCH != 0 || next == done || !slice.is_over()) {
            apply(job, next, &is_hideable, &mut parts);
            next += 1;
        }
        job.step = if next == job.parts.len() {
            let counts = count(job);
            commands.entity(job.root).try_insert(counts);
            job.counts = counts;
            Step::Done
        } else {
            job.hideable = is_hideable;
            Step::Hide(next)
        };
    }
    models.cpu_ms = slice.spent_ms();
}

/// By part, whether it can be hidden: nothing of it is seen, nor of anything below it.
fn hideable(job: &Job) -> Vec<bool> {
    let Some(found) = &job.found else {
        return vec![false; job.parts.len()];
    };
    let mut can: Vec<bool> = found.hidden.to_vec();
    let mut keeps_above = vec![false; job.nodes.len()];
    for (number, node) in job.nodes.iter().enumerate().rev() {
        let part = node.part.and_then(|part| can.get_mut(part as usize));
        let is_hidden = part.is_some_and(|part| {
            *part &= !keeps_above[number];
            *part
        });
        if !is_hidden && let Some(above) = node.above {
            keeps_above[above as usize] = true;
        }
    }
    can
}

fn apply(job: &mut Job, number: usize, is_hideable: &[bool], parts: &mut Parts) {
    let Some(part) = job.parts.get_mut(number) else {
        return;
    };
    let entity = job.nodes.get(part.node as usize).map(|node| node.entity);
    let Some((mut of, mesh, _, inherited)) = entity.and_then(|e| parts.get_mut(e).ok()) else {
        return;
    };
    if is_hideable.get(number) == Some(&true) {
        of.is_hidden = true;
        if let Some(mut inherited) = inherited.filter(|inherited| inherited.get()) {
            *inherited = InheritedVisibility::HIDDEN;
        }
        part.shown = Shown::Hidden;
    } else if let Some(Some(trimmed)) = job.trimmed.get(part.mesh as usize)
        && let Some(mut mesh) = mesh.filter(|mesh| mesh.id() == part.original.id())
    {
        mesh.0 = trimmed.handle.clone();
        part.shown = Shown::Trimmed(trimmed.handle.id());
    }
}

fn count(job: &Job) -> InteriorCounts {
    let Some(found) = &job.found else {
        return default();
    };
    let mut counts = InteriorCounts {
        nodes: job.parts.len() as u32,
        gap: found.gap as f32,
        field: found.field,
        ..default()
    };
    for part in &job.parts {
        let mesh = part.mesh as usize;
        let [all, kept] = [&found.triangles, &found.kept].map(|of| u64::from(of[mesh]));
        counts.triangles += all;
        match part.shown {
            Shown::AsItWas => {}
            Shown::Hidden => {
                counts.hidden_nodes += 1;
                counts.hidden_triangles += all;
            }
            Shown::Trimmed(_) => counts.hidden_triangles += all - kept,
        }
    }
    counts
}

/// Holds hidden what is hidden, after Bevy has said anew what is shown.
pub fn keep_hidden(
    mut parts: Query<(&PartOf, &mut InheritedVisibility), Changed<InheritedVisibility>>,
) {
    for (part, mut inherited) in &mut parts {
        if part.is_hidden && inherited.get() {
            *inherited = InheritedVisibility::HIDDEN;
        }
    }
}
