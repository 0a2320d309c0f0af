//! Makes trimmed meshes: the attributes of the vertices that stay, some of them a frame.

use std::{collections::VecDeque, sync::Arc};

use bevy::{asset::RenderAssetUsages, prelude::*};

use super::{
    models::Job,
    store::{Mask, Store, Trimmed},
    work::Trim,
};
use crate::{
    render_graph::mesh_uploads::{Asker, MeshUploads},
    systems::{
        slice::Slice,
        submesh::{Making, bytes},
    },
};

/// No more is handed to the renderer in a frame, unless it is one mesh: it copies and packs what it is given in the
/// frame in which it is given it. units: bytes
const MOST_HANDED: u64 = 1 << 19;

/// How far the making has come.
#[derive(Default)]
pub(super) struct Build {
    todo: VecDeque<Trim>,
    of: usize,
    current: Option<Current>,
    /// On their way to the GPU.
    pub waiting: Vec<AssetId<Mesh>>,
}

/// A trimmed mesh that is being made.
struct Current {
    mesh: usize,
    mask: Mask,
    making: Making,
}

impl Build {
    pub fn new(trims: Vec<Trim>) -> Self {
        Self {
            of: trims.len(),
            todo: trims.into(),
            current: None,
            waiting: Vec::new(),
        }
    }

    /// How many are made, of how many.
    pub fn made(&self) -> [usize; 2] {
        let left = self.todo.len() + usize::from(self.current.is_some());
        [self.of - left, self.of]
    }

    /// Goes on until the slice is over. Whether all are made.
    pub fn run(
        &mut self,
        job: &mut Job,
        store: &mut Store,
        uploads: &MeshUploads,
        meshes: &mut Assets<Mesh>,
        slice: &Slice,
    ) -> bool {
        let mut handed = 0;
        while handed < MOST_HANDED && !slice.is_over() {
            let Some(current) = &mut self.current else {
                let Some(trim) = self.todo.pop_front() else {
                    return true;
                };
                let source = job.meshes.get(trim.mesh as usize);
                let source = source.and_then(|id| meshes.get(*id));
                self.current = source.and_then(|source| {
                    Some(Current {
                        mesh: trim.mesh as usize,
                        mask: trim.mask,
                        making: Making::begin(trim.sub, source)?,
                    })
                });
                continue;
            };
            let id = job.meshes[current.mesh];
            let Some(source) = meshes.get(id) else {
                self.current = None;
                continue;
            };
            if !current.making.copy(source) {
                continue;
            }
            let Some(Current { mesh, mask, making }) = self.current.take() else {
                continue;
            };
            let trimmed = making.finish(source);
            let bytes = bytes(&trimmed);
            let is_drawn = trimmed
                .asset_usage
                .contains(RenderAssetUsages::RENDER_WORLD);
            let handle = meshes.add(trimmed);
            if is_drawn && uploads.ask(Asker::Interior, handle.id()) {
                self.waiting.push(handle.id());
            }
            handed += bytes;
            let trimmed = Arc::new(Trimmed { handle, bytes });
            store.keep_trimmed(id, mask, &trimmed);
            job.trimmed[mesh] = Some(trimmed);
        }
        self.todo.is_empty() && self.current.is_none()
    }
}
