//! What a camera keeps from frame to frame, and what has come back from the GPU.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bevy::prelude::*;

use super::{depth::ReducedDepth, pace::Pace};
use crate::culling::bits::Bits;

/// What occlusion culling did for a camera, this frame but for what has to come back from the GPU.
#[derive(Component, Reflect, Clone, Copy, Debug, Default, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct OcclusionCounts {
    /// Candidates in view.
    pub candidates: u32,
    /// Of these, removed this frame.
    pub removed: u32,
    /// Volumes tested by the CPU this frame, groups included.
    pub tested: u32,
    /// Volumes that were not tested because their group was hidden or out of view.
    pub spared: u32,
    /// Entities that the newest recheck to come back drew late.
    pub rescued: u32,
    /// Whether verdicts were predicted by the GPU.
    pub on_gpu: bool,
    /// Frames between the depth that verdicts came from and this frame; 0 if none was there.
    pub age: u32,
    /// Time of testing and removing. units: ms
    pub cpu_ms: f32,
}

/// What came back from the GPU for one frame.
#[derive(Clone, Debug, Default)]
pub struct Returned {
    /// The depth drawn first in that frame, with the camera that drew it.
    pub depth: ReducedDepth,
    /// Slots that were tested against it on the GPU.
    pub tested: Bits,
    /// Of these, those found hidden.
    pub hidden: Bits,
    /// Of these, those that had been removed: what of them is not hidden was drawn late.
    pub removed: Bits,
    /// Number of that frame.
    pub frame: u32,
    /// Which table the slots are of.
    pub epoch: u32,
}

/// Where the render world leaves what has come back. Memory goes round: nothing is allocated in steady state.
#[derive(Clone, Default)]
pub struct Mailbox(Arc<Mutex<Post>>);

#[derive(Default)]
struct Post {
    fresh: Option<Returned>,
    spare: Vec<Returned>,
}

impl Mailbox {
    fn lock(&self) -> MutexGuard<'_, Post> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The newest that has come and was not taken yet.
    pub fn take(&self) -> Option<Returned> {
        self.lock().fresh.take()
    }

    /// Gives back memory to be filled again.
    pub fn recycle(&self, returned: Returned) {
        self.lock().spare.push(returned);
    }

    /// Memory to be filled.
    pub fn blank(&self) -> Returned {
        self.lock().spare.pop().unwrap_or_default()
    }

    /// Leaves what has come; what lies there unread goes round.
    pub fn post(&self, returned: Returned) {
        let mut post = self.lock();
        if let Some(unread) = post.fresh.replace(returned) {
            post.spare.push(unread);
        }
    }
}

/// What a camera with [`ZBufferOcclusion`](super::ZBufferOcclusion) keeps from frame to frame. By slots of
/// [`Candidates`](crate::culling::candidates::Candidates).
#[derive(Component, Default)]
pub struct OcclusionCamera {
    /// Predicted hidden.
    pub(crate) hidden: Bits,
    /// In view last frame, where the prediction is final.
    pub(crate) in_view: Bits,
    /// In view this frame.
    pub(crate) in_view_now: Bits,
    /// Removed this frame.
    pub(crate) removed: Bits,
    /// To be tested by the GPU this frame.
    pub(crate) to_test: Bits,
    /// Verdicts on groups this frame: 0 unknown, else 1 + the verdict.
    pub(crate) groups: Vec<u8>,
    /// Memory for the way from a group up.
    pub(crate) group_path: Vec<u32>,
    /// The newest that has come back.
    pub(crate) newest: Option<Returned>,
    /// Whether the depth of this frame is reduced and read back.
    pub(crate) reads: bool,
    /// Whether all candidates are tested by the GPU this frame.
    pub(crate) predicts_on_gpu: bool,
    /// In how many turns what is seen is tested, and whose turn it is.
    pub(crate) turns: u32,
    pub(crate) turn: u32,
    pub(crate) mailbox: Mailbox,
    pub(crate) pace: Pace,
}
