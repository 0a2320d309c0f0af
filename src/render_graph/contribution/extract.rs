//! What the render world takes over each frame: which candidates changed, and what each camera has in view.

use bevy::{
    camera::visibility::VisibilityRange,
    diagnostic::FrameCount,
    ecs::lifecycle::RemovedComponents,
    math::Affine3A,
    prelude::*,
    render::{
        Extract,
        camera::DirtySpecializations,
        sync_world::{MainEntity, RenderEntity},
    },
};

use crate::{
    contribution::{ContributionCamera, area::AreaView},
    culling::{
        bits::Bits,
        candidates::{Candidate, Candidates},
        volume::LocalBox,
    },
    occlusion::camera::Mailbox,
};

use super::prepare::GpuCandidates;

/// One camera, as this frame's pass needs it.
#[derive(Clone)]
pub struct ExtractedContributionCamera {
    /// Its entity in the main world.
    pub main: Entity,
    /// Its entity in the render world.
    pub render: Entity,
    /// The view that areas are measured in.
    pub view: AreaView,
    /// Below which area an object leaves, and from which on it comes back. units: px²
    pub thresholds: (f32, f32),
    /// Slots in view.
    pub asked: Bits,
    /// Slots that were too small when last known.
    pub removed: Bits,
    /// Where to leave what comes back.
    pub mailbox: Mailbox,
}

/// What of a candidate is weighed.
#[derive(Clone, Copy, Debug)]
pub struct Weighed {
    /// Whose mesh it is.
    pub entity: Entity,
    /// Where it stands.
    pub world_from_local: Affine3A,
    /// What stands for it.
    pub volume: LocalBox,
}

impl Weighed {
    fn of(candidate: &Candidate) -> Option<Self> {
        candidate.by.contribution.then_some(Self {
            entity: candidate.entity,
            world_from_local: candidate.world_from_local,
            volume: candidate.volume,
        })
    }
}

/// This frame's work for the pass.
#[derive(Resource, Default)]
pub struct ExtractedContribution {
    /// Cameras for which the GPU measures this frame.
    pub cameras: Vec<ExtractedContributionCamera>,
    /// Cameras of earlier frames, whose memory is used again.
    spare: Vec<ExtractedContributionCamera>,
    /// Slots there are.
    pub slots: usize,
    /// Slots that changed, with what is in them now.
    pub changed: Vec<(u32, Option<Weighed>)>,
    /// Slots that were given to another entity.
    pub fresh: Bits,
    /// Whether there are any.
    pub any_fresh: bool,
    /// Number of the frame.
    pub frame: u32,
    /// Which table slots are of.
    pub epoch: u32,
    /// Whether `changed` is all there is.
    pub all: bool,
}

/// Has what begins or ceases to dither drawn by the pipelines for that from this frame on: Bevy looks for them only when
/// a mesh or a material changes.
pub fn respecialize_dithered(
    dirty: Option<ResMut<DirtySpecializations>>,
    begun: Extract<Query<Entity, Added<VisibilityRange>>>,
    mut ended: Extract<RemovedComponents<VisibilityRange>>,
) {
    let Some(mut dirty) = dirty else { return };
    let both = begun.iter().chain(ended.read()).map(MainEntity::from);
    dirty.changed_renderables.extend(both);
}

/// Fills [`ExtractedContribution`].
pub fn extract_contribution(
    mut extracted: ResMut<ExtractedContribution>,
    gpu: Res<GpuCandidates>,
    table: Extract<Res<Candidates>>,
    frame: Extract<Res<FrameCount>>,
    cameras: Extract<Query<(Entity, RenderEntity, &ContributionCamera)>>,
) {
    let extracted = &mut *extracted;
    extracted.spare.append(&mut extracted.cameras);
    extracted.changed.clear();
    for (main, render, state) in &cameras {
        let Some(view) = state.gpu else { continue };
        let mut to = match extracted.spare.pop() {
            Some(to) => ExtractedContributionCamera {
                main,
                render,
                view,
                mailbox: state.mailbox.clone(),
                ..to
            },
            None => ExtractedContributionCamera {
                main,
                render,
                view,
                thresholds: (0.0, 0.0),
                asked: Bits::default(),
                removed: Bits::default(),
                mailbox: state.mailbox.clone(),
            },
        };
        to.thresholds = state.thresholds;
        to.asked.clone_from(&state.asked);
        to.removed.clone_from(&state.removed);
        extracted.cameras.push(to);
    }
    if extracted.cameras.is_empty() {
        extracted.spare.clear();
        return;
    }
    (extracted.frame, extracted.epoch) = (frame.0, table.epoch());
    extracted.slots = table.slots();
    extracted.any_fresh = !table.assigned().is_empty();
    if extracted.any_fresh {
        extracted.fresh.clear(table.slots());
        for slot in table.assigned() {
            extracted.fresh.insert(*slot);
        }
    }
    // The GPU's table follows the main world's; an empty one, new or lost with its device, is filled anew.
    extracted.all = gpu.wants_all(table.epoch());
    if extracted.all {
        let all = table.iter();
        extracted
            .changed
            .extend(all.map(|(slot, of)| (slot, Weighed::of(of))));
    } else {
        let dirty = table.dirty().iter();
        extracted
            .changed
            .extend(dirty.map(|slot| (*slot, table.get(*slot).and_then(Weighed::of))));
    }
}
