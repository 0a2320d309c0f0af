//! What is known of the models that interior culling looks after.

use std::sync::Arc;

use bevy::{
    camera::visibility::RenderLayers,
    ecs::entity::{EntityHashMap, EntityIndexMap},
    math::DAffine3,
    platform::collections::{HashMap, HashSet},
    prelude::*,
};

pub use crate::culling::part::PartOf;

use super::{
    build::Build,
    node::{Kind, Left, Look},
    store::{Found, Store, Trimmed},
    walk::Walk,
    work::Work,
};
use crate::{
    interior::{InteriorCounts, InteriorCulling, InteriorGpu},
    render_graph::mesh_uploads::MeshUploads,
    systems::gather::Gather,
};

/// Frames that a model must have been left alone before it is looked at again.
const QUIET_FRAMES: u32 = 8;
/// One that is disturbed again and again has to keep still for longer and longer, up to this.
const MOST_QUIET_FRAMES: u32 = 256;

/// The models that ask for interior culling, and what it has found in them. Empty when there is none.
#[derive(Resource, Default)]
pub struct InteriorModels {
    pub(super) jobs: EntityIndexMap<Job>,
    /// Models that are not asked for any more, and whose parts are to be restored.
    pub(super) leaving: Vec<Job>,
    /// Whose meshes are copied, worked on or made: one model at a time.
    pub(super) turn: Option<Entity>,
    pub(super) store: Store,
    pub(super) uploads: MeshUploads,
    /// The app's, where it has one.
    pub(super) gpu: Option<InteriorGpu>,
    pub(super) frame: u32,
    /// Time spent in this frame by what goes in slices. units: ms
    pub(super) cpu_ms: f32,
}

impl InteriorModels {
    /// Whether it holds nothing and has nothing to do.
    pub fn is_empty(&self) -> bool {
        self.jobs.is_empty() && self.leaving.is_empty() && self.store.is_empty()
    }

    /// Whether the app has a GPU that fields can be made by.
    pub fn has_gpu(&self) -> bool {
        self.gpu.is_some()
    }

    /// Trimmed meshes that are in use.
    pub fn trimmed_meshes(&self) -> usize {
        self.store.trimmed().count()
    }

    /// Results that are kept, for a model that is the same.
    pub fn kept_results(&self) -> usize {
        self.store.len()
    }

    pub(super) fn job_of(&mut self, part: &PartOf) -> Option<&mut Job> {
        self.jobs.get_mut(&part.root)
    }
}

/// One model.
pub(super) struct Job {
    pub root: Entity,
    pub settings: InteriorCulling,
    /// In the order of the walk: what is above comes first.
    pub nodes: Vec<Node>,
    pub index: EntityHashMap<u32>,
    /// Listened to without being among the nodes: came later, and has no mesh.
    pub extra: Vec<Entity>,
    /// Listened to since an earlier look, and not come to yet in this one.
    pub stale: Vec<Entity>,
    pub parts: Vec<Part>,
    /// Meshes of the parts, by first use.
    pub meshes: Vec<AssetId<Mesh>>,
    pub mesh_index: HashMap<AssetId<Mesh>, u32>,
    pub materials: HashMap<AssetId<StandardMaterial>, Look>,
    pub left: LeftCounts,
    pub layers: RenderLayers,
    pub is_mirrored: bool,
    /// Some parts are drawn whether the root is shown or not, others are not: then this is whether it was.
    pub depends_on_root: Option<bool>,
    pub step: Step,
    /// What it shows comes from this.
    pub found: Option<Arc<Found>>,
    /// By mesh.
    pub trimmed: Vec<Option<Arc<Trimmed>>>,
    /// By part, while it is being hidden.
    pub hideable: Vec<bool>,
    /// Once it is done.
    pub counts: InteriorCounts,
    /// Something has changed: all is to be restored in this frame.
    pub is_disturbed: bool,
    /// What has changed is what is asked for, so that nothing has to be waited for.
    pub is_anew: bool,
    pub quiet_frames: u32,
    pub disturbed_at: u32,
}

/// What a model is waiting for or going through; how it goes from one to the next is drawn in the
/// [module](super).
pub(super) enum Step {
    /// That it is left alone for so many more frames.
    Still(u32),
    /// Its hierarchy is looked through.
    Walk(Walk),
    /// Its meshes and materials load.
    Load(Load),
    /// There is nothing to cull.
    Nothing,
    /// Another has its turn.
    Turn,
    /// Meshes are copied.
    Gather(Gather),
    /// The background works.
    Work(Work),
    /// Trimmed meshes are made.
    Build(Build),
    /// The first so many parts are as they will be.
    Hide(usize),
    Done,
    /// Why, in words.
    Failed(String),
}

/// What is not there yet.
pub(super) struct Load {
    pub meshes: HashSet<AssetId<Mesh>>,
    pub materials: HashSet<AssetId<StandardMaterial>>,
    /// Of so many meshes and materials.
    pub of: [usize; 2],
}

/// One entity of a model.
pub(super) struct Node {
    pub entity: Entity,
    /// Index of the node above.
    pub above: Option<u32>,
    pub place: Transform,
    pub visibility: Visibility,
    pub kind: Kind,
    /// The way from its space to the world mirrors.
    pub is_mirrored: bool,
    /// It or something below it has a surface that counts: it matters where it is and whether it is shown.
    pub carries: bool,
    pub part: Option<u32>,
}

/// One entity whose mesh counts.
pub(super) struct Part {
    pub node: u32,
    /// Index of its mesh in the model.
    pub mesh: u32,
    /// What it is to have again.
    pub original: Handle<Mesh>,
    pub root_from_local: DAffine3,
    pub is_transparent: bool,
    pub is_two_sided: bool,
    pub shown: Shown,
}

/// What interior culling has made of a part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shown {
    AsItWas,
    Hidden,
    Trimmed(AssetId<Mesh>),
}

/// How many nodes are left alone, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct LeftCounts(pub [u32; Left::COUNT]);

impl LeftCounts {
    pub fn add(&mut self, why: Left) {
        self.0[why as usize] += 1;
    }

    pub fn total(&self) -> u32 {
        self.0.iter().sum()
    }
}

impl Job {
    pub fn new(root: Entity, settings: InteriorCulling, frame: u32) -> Self {
        Self {
            root,
            settings,
            nodes: Vec::new(),
            index: default(),
            extra: Vec::new(),
            stale: Vec::new(),
            parts: Vec::new(),
            meshes: Vec::new(),
            mesh_index: default(),
            materials: default(),
            left: default(),
            layers: default(),
            is_mirrored: false,
            depends_on_root: None,
            // Once without a change.
            step: Step::Still(1),
            found: None,
            trimmed: Vec::new(),
            hideable: Vec::new(),
            counts: default(),
            is_disturbed: false,
            is_anew: false,
            quiet_frames: QUIET_FRAMES,
            disturbed_at: frame,
        }
    }

    /// All is undone in this frame, and it begins again when it has been left alone for a while: the longer, the more
    /// often that was in vain.
    pub fn begin_again(&mut self, frame: u32) {
        let was_at_work = match self.step {
            Step::Gather(_) | Step::Work(_) | Step::Build(_) | Step::Hide(_) | Step::Done => true,
            Step::Still(_)
            | Step::Walk(_)
            | Step::Load(_)
            | Step::Nothing
            | Step::Turn
            | Step::Failed(_) => false,
        };
        if was_at_work {
            let since = frame.wrapping_sub(self.disturbed_at);
            self.quiet_frames = if since > 4 * self.quiet_frames + QUIET_FRAMES {
                QUIET_FRAMES
            } else {
                (2 * self.quiet_frames).min(MOST_QUIET_FRAMES)
            };
            self.disturbed_at = frame;
        }
        if core::mem::take(&mut self.is_anew) {
            self.quiet_frames = QUIET_FRAMES;
            self.step = Step::Still(0);
        } else {
            // Work in the background ends with its step.
            self.step = Step::Still(self.quiet_frames);
        }
        self.found = None;
        self.trimmed = Vec::new();
    }

    pub fn node(&self, entity: Entity) -> Option<&Node> {
        self.nodes.get(*self.index.get(&entity)? as usize)
    }

    /// The mesh that a node's own stands for: the one that was there before it was trimmed.
    pub fn original_of(&self, node: &Node, mesh: AssetId<Mesh>) -> AssetId<Mesh> {
        match node.part.and_then(|part| self.parts.get(part as usize)) {
            Some(part) if part.shown == Shown::Trimmed(mesh) => part.original.id(),
            _ => mesh,
        }
    }

    /// The number of a mesh in the model.
    pub fn number_of(&mut self, mesh: AssetId<Mesh>) -> u32 {
        let next = self.meshes.len() as u32;
        let number = *self.mesh_index.entry(mesh).or_insert(next);
        if number == next {
            self.meshes.push(mesh);
        }
        number
    }

    /// What was known of the hierarchy; nothing of it may be hidden or trimmed.
    pub fn forget_nodes(&mut self) {
        self.stale.extend(self.nodes.iter().map(|node| node.entity));
        self.stale.append(&mut self.extra);
        self.stale.sort_unstable();
        self.stale.dedup();
        self.nodes.clear();
        self.index.clear();
        self.parts.clear();
        self.meshes.clear();
        self.mesh_index.clear();
        self.materials.clear();
        self.left = default();
    }

    /// Every entity that was given a [`PartOf`].
    pub fn tracked(&self) -> impl Iterator<Item = Entity> + '_ {
        let nodes = self.nodes.iter().map(|node| node.entity);
        let others = self.extra.iter().chain(&self.stale).copied();
        nodes.chain(others).chain([self.root])
    }
}
