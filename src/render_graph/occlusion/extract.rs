//! What the render world takes over each frame: which occludees changed, and what each camera removed.

use bevy::{
    diagnostic::FrameCount,
    prelude::*,
    render::{Extract, sync_world::RenderEntity},
};

use crate::{
    culling::{
        CulledEntities,
        bits::Bits,
        candidates::{Candidate, Candidates},
    },
    occlusion::{DepthSampling, OcclusionCamera, Recheck, ZBufferOcclusion, camera::Mailbox},
};

use super::buffers::GpuOccludees;

/// One camera, as this frame's passes need it.
#[derive(Clone)]
pub struct ExtractedOcclusionCamera {
    /// Its entity in the main world.
    pub main: Entity,
    /// Its entity in the render world.
    pub render: Entity,
    /// How its depth is read.
    pub sampling: DepthSampling,
    /// Whether the depth itself is sent back, and not only verdicts.
    pub sends_depth: bool,
    /// Whether removed entities are tested again.
    pub rechecks: bool,
    /// What was removed, with its slot, sorted by entity.
    pub removed: Vec<(Entity, u32)>,
    /// Slots that were removed.
    pub removed_slots: Bits,
    /// Slots to be tested.
    pub to_test: Bits,
    /// Where to leave what comes back.
    pub mailbox: Mailbox,
}

/// This frame's work for the passes.
#[derive(Resource, Default)]
pub struct ExtractedOcclusion {
    /// Cameras whose depth is read this frame.
    pub cameras: Vec<ExtractedOcclusionCamera>,
    /// Cameras of earlier frames, whose memory is used again.
    spare: Vec<ExtractedOcclusionCamera>,
    /// Slots there are.
    pub slots: usize,
    /// Slots that changed, with what is in them now.
    pub changed: Vec<(u32, Option<Candidate>)>,
    /// Whether any camera asks for culling.
    pub asked: bool,
    /// Number of the frame.
    pub frame: u32,
    /// Which table slots are of.
    pub epoch: u32,
    /// Whether `changed` is all there is.
    pub all: bool,
}

/// What is taken over of a camera.
type CameraData<'w> = (
    Entity,
    RenderEntity,
    &'w Camera,
    &'w ZBufferOcclusion,
    &'w OcclusionCamera,
    &'w CulledEntities,
);

/// Fills [`ExtractedOcclusion`].
pub fn extract_occlusion(
    mut extracted: ResMut<ExtractedOcclusion>,
    gpu: Res<GpuOccludees>,
    table: Extract<Res<Candidates>>,
    frame: Extract<Res<FrameCount>>,
    cameras: Extract<Query<CameraData>>,
) {
    let extracted = &mut *extracted;
    extracted.spare.append(&mut extracted.cameras);
    extracted.changed.clear();
    extracted.asked = !cameras.is_empty();
    extracted.frame = frame.0;
    extracted.slots = table.slots();
    extracted.epoch = table.epoch();
    if !extracted.asked {
        extracted.spare.clear();
        return;
    }
    for (main, render, camera, settings, state, culled) in &cameras {
        if !camera.is_active || !state.reads {
            continue;
        }
        let mut to = match extracted.spare.pop() {
            Some(to) => ExtractedOcclusionCamera {
                main,
                render,
                mailbox: state.mailbox.clone(),
                ..to
            },
            None => ExtractedOcclusionCamera {
                main,
                render,
                sampling: settings.sampling,
                sends_depth: true,
                rechecks: false,
                removed: Vec::new(),
                removed_slots: Bits::default(),
                to_test: Bits::default(),
                mailbox: state.mailbox.clone(),
            },
        };
        to.sampling = settings.sampling;
        to.sends_depth = !state.predicts_on_gpu;
        to.rechecks = settings.recheck == Recheck::SameFrame;
        to.removed.clear();
        if to.rechecks {
            to.removed.extend(
                culled
                    .occluded
                    .iter()
                    .filter_map(|entity| Some((*entity, table.slot(*entity)?))),
            );
        }
        to.removed_slots.clone_from(&state.removed);
        to.to_test.clone_from(&state.to_test);
        extracted.cameras.push(to);
    }
    // The GPU's table follows the main world's; an empty one, new or lost with its device, is filled anew, once
    // somebody reads it.
    extracted.all = gpu.wants_all(table.epoch());
    if extracted.all && extracted.cameras.is_empty() {
        extracted.all = false;
        return;
    }
    if extracted.all {
        extracted
            .changed
            .extend(table.iter().map(|(slot, of)| (slot, Some(of.clone()))));
    } else {
        extracted.changed.extend(
            table
                .dirty()
                .iter()
                .map(|slot| (*slot, table.get(*slot).cloned())),
        );
    }
}
