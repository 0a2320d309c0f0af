//! Takes each model a step further, in a slice of the frame.

use std::sync::Arc;

use bevy::prelude::*;

use super::{
    build::Build,
    models::{InteriorModels, Job, Step},
    node::NodeQuery,
    store::{Content, Found, Store},
    walk::{Ground, Walk},
    watch::{AboveQuery, is_shown},
    work::{Input, InputPart, Output, Work},
};
use crate::{
    interior::InteriorGpu,
    render_graph::mesh_uploads::{Asker, MeshUploads},
    systems::{
        gather::{Gather, Raw},
        slice::Slice,
    },
};

/// Whether a model can go on in this frame.
#[derive(PartialEq, Eq)]
enum Next {
    Again,
    Later,
}

/// Looks through hierarchies, copies meshes, starts and collects work in the background, makes trimmed meshes: what has
/// its turn first, and all together no longer than a slice.
pub fn advance_models(
    mut models: ResMut<InteriorModels>,
    nodes: Query<NodeQuery>,
    above: Query<AboveQuery>,
    mut meshes: ResMut<Assets<Mesh>>,
    materials: Res<Assets<StandardMaterial>>,
    mut commands: Commands,
) {
    let slice = Slice::begin();
    let models = &mut *models;
    let InteriorModels {
        jobs,
        turn,
        store,
        uploads,
        gpu,
        ..
    } = models;
    for job in jobs.values_mut() {
        loop {
            let next = match &mut job.step {
                Step::Still(frames) if *frames > 0 => {
                    *frames -= 1;
                    Next::Later
                }
                Step::Still(_) => {
                    job.step = Step::Walk(Walk::default());
                    Next::Again
                }
                Step::Walk(walk) => {
                    let mut walk = core::mem::take(walk);
                    let ground = Ground {
                        nodes: &nodes,
                        meshes: &meshes,
                        materials: &materials,
                        is_root_shown: is_shown(job.root, &above),
                    };
                    if walk.run(job, &ground, &mut commands, &slice) {
                        job.step = walk.finish(job, &ground, &mut commands);
                        Next::Again
                    } else {
                        job.step = Step::Walk(walk);
                        Next::Later
                    }
                }
                Step::Load(load) if load.meshes.is_empty() && load.materials.is_empty() => {
                    job.step = Step::Walk(Walk::default());
                    Next::Again
                }
                Step::Load(_) | Step::Nothing | Step::Hide(_) | Step::Done | Step::Failed(_) => {
                    Next::Later
                }
                Step::Turn | Step::Gather(_) | Step::Work(_) | Step::Build(_) => {
                    if *turn.get_or_insert(job.root) != job.root {
                        break;
                    }
                    let next = take_turn(job, store, uploads, gpu.as_ref(), &mut meshes, &slice);
                    if matches!(job.step, Step::Hide(_) | Step::Failed(_) | Step::Still(_)) {
                        *turn = None;
                        uploads.clear(Asker::Interior);
                    }
                    next
                }
            };
            if next == Next::Later || slice.is_over() {
                break;
            }
        }
    }
    models.cpu_ms = slice.spent_ms();
}

/// A step of the one model that has its turn.
fn take_turn(
    job: &mut Job,
    store: &mut Store,
    uploads: &MeshUploads,
    gpu: Option<&InteriorGpu>,
    meshes: &mut ResMut<Assets<Mesh>>,
    slice: &Slice,
) -> Next {
    match &mut job.step {
        Step::Turn => {
            let found = store.find(&Content::of(job));
            let is_ready = found.as_ref().is_some_and(|found| adopt(job, found, store));
            job.found = found;
            job.step = if is_ready {
                Step::Hide(0)
            } else {
                Step::Gather(Gather::default())
            };
            Next::Again
        }
        Step::Gather(gather) => {
            match gather.run(&job.meshes, meshes, slice) {
                Ok(false) => return Next::Later,
                Ok(true) => {
                    let raws = core::mem::take(gather).finish();
                    let content = Content::of(job);
                    job.step = match Work::begin(content, input(job, raws, gpu)) {
                        Ok(work) => Step::Work(work),
                        Err(why) => Step::Failed(why),
                    };
                }
                // Gone meanwhile: that is looked at anew.
                Err(_) => job.step = Step::Still(job.quiet_frames),
            }
            Next::Later
        }
        Step::Work(work) => {
            let Some(result) = work.poll() else {
                return Next::Later;
            };
            let content = work.content.clone();
            match result {
                Ok(Output { found, mut trims }) => {
                    store.keep(content, found.clone());
                    adopt(job, &found, store);
                    // What others use already is not made again.
                    trims.retain(|trim| job.trimmed[trim.mesh as usize].is_none());
                    job.found = Some(found);
                    job.step = Step::Build(Build::new(trims));
                    Next::Again
                }
                Err(why) => {
                    job.step = Step::Failed(why);
                    Next::Later
                }
            }
        }
        Step::Build(build) => {
            let mut build = core::mem::take(build);
            let is_made = build.run(job, store, uploads, meshes, slice);
            uploads.retain_waiting(&mut build.waiting);
            if is_made && build.waiting.is_empty() {
                job.step = Step::Hide(0);
            } else {
                job.step = Step::Build(build);
            }
            Next::Later
        }
        _ => Next::Later,
    }
}

/// Takes the trimmed meshes that are there. Whether all are that are needed.
fn adopt(job: &mut Job, found: &Arc<Found>, store: &Store) -> bool {
    let mut has_all = true;
    for (mesh, mask) in found.masks.iter().enumerate() {
        if let (Some(mask), Some(id)) = (mask, job.meshes.get(mesh)) {
            job.trimmed[mesh] = store.trimmed_of(*id, mask);
            has_all &= job.trimmed[mesh].is_some();
        }
    }
    has_all
}

fn input(job: &Job, raws: Vec<Raw>, gpu: Option<&InteriorGpu>) -> Input {
    Input {
        settings: job.settings.clone(),
        gpu: gpu.cloned(),
        raws,
        parts: job
            .parts
            .iter()
            .map(|part| InputPart {
                mesh: part.mesh,
                root_from_local: part.root_from_local,
                is_transparent: part.is_transparent,
                is_two_sided: part.is_two_sided,
            })
            .collect(),
        wanted: job.trimmed.iter().map(Option::is_none).collect(),
        found: job.found.clone(),
    }
}
