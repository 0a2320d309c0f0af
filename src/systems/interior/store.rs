//! Results of models that are the same, and trimmed meshes that several of them share.

use std::{
    collections::VecDeque,
    sync::{Arc, Weak},
};

use bevy::{math::DAffine3, platform::collections::HashMap, prelude::*};

use super::models::Job;
use crate::interior::{FieldBy, InteriorCulling};

/// So many results are kept beside those in use, the newest.
const MOST_RESULTS: usize = 8;
/// They take no more than this. units: bytes
const MOST_BYTES: usize = 64 << 20;

/// What a result depends on. As long as no mesh of it is edited, in which case it is forgotten, the same content has
/// the same result: mesh assets stand for their triangles.
#[derive(Clone, PartialEq)]
pub(super) struct Content {
    settings: InteriorCulling,
    /// By part: its mesh, whether it is transparent and two-sided, and where it is, bit by bit.
    parts: Vec<(AssetId<Mesh>, bool, bool, [u64; 12])>,
}

impl Content {
    pub fn of(job: &Job) -> Self {
        let parts = job.parts.iter().map(|part| {
            (
                job.meshes[part.mesh as usize],
                part.is_transparent,
                part.is_two_sided,
                bits(&part.root_from_local),
            )
        });
        Self {
            settings: job.settings.clone(),
            parts: parts.collect(),
        }
    }

    fn bytes(&self) -> usize {
        size_of_val(self.parts.as_slice())
    }
}

fn bits(place: &DAffine3) -> [u64; 12] {
    place.to_cols_array().map(f64::to_bits)
}

/// What was found in a model.
pub(super) struct Found {
    /// By part, whether nothing of it is seen.
    pub hidden: Box<[bool]>,
    /// By mesh, which of its triangles are seen in any part: one bit each. `None`: it stays whole.
    pub masks: Box<[Option<Mask>]>,
    /// By mesh, how many triangles it has.
    pub triangles: Box<[u32]>,
    /// By mesh, how many of them stay.
    pub kept: Box<[u32]>,
    pub gap: f64,
    /// Where its distance field was made.
    pub field: FieldBy,
}

/// One bit for each triangle of a mesh.
pub(super) type Mask = Arc<[u64]>;

pub(super) fn is_set(mask: &[u64], triangle: usize) -> bool {
    mask.get(triangle / 64)
        .is_some_and(|word| word >> (triangle % 64) & 1 == 1)
}

impl Found {
    fn bytes(&self) -> usize {
        let masks: usize = self.masks.iter().flatten().map(|mask| 8 * mask.len()).sum();
        masks + self.hidden.len() + self.masks.len() * 24
    }
}

/// A mesh without the triangles that are hidden; lives as long as a model shows it.
pub(super) struct Trimmed {
    pub handle: Handle<Mesh>,
    /// units: bytes on the GPU
    pub bytes: u64,
}

/// See the [module](self).
#[derive(Default)]
pub(super) struct Store {
    /// The newest last.
    results: VecDeque<(Content, Arc<Found>)>,
    trimmed: HashMap<AssetId<Mesh>, Vec<(Mask, Weak<Trimmed>)>>,
}

impl Store {
    pub fn is_empty(&self) -> bool {
        self.results.is_empty() && self.trimmed.is_empty()
    }

    pub fn len(&self) -> usize {
        self.results.len()
    }

    /// What was found in a model of this content.
    pub fn find(&mut self, content: &Content) -> Option<Arc<Found>> {
        let at = self.results.iter().position(|(of, _)| of == content)?;
        let result = self.results.remove(at)?;
        let found = result.1.clone();
        self.results.push_back(result);
        Some(found)
    }

    pub fn keep(&mut self, content: Content, found: Arc<Found>) {
        self.results.retain(|(of, _)| *of != content);
        self.results.push_back((content, found));
        let mut bytes: usize = self
            .results
            .iter()
            .map(|(content, found)| content.bytes() + found.bytes())
            .sum();
        while self.results.len() > MOST_RESULTS || bytes > MOST_BYTES {
            let Some((content, found)) = self.results.pop_front() else {
                break;
            };
            bytes -= content.bytes() + found.bytes();
        }
    }

    /// The trimmed mesh, if one is in use.
    pub fn trimmed_of(&self, mesh: AssetId<Mesh>, mask: &Mask) -> Option<Arc<Trimmed>> {
        let (_, trimmed) = self.trimmed.get(&mesh)?.iter().find(|(of, _)| of == mask)?;
        trimmed.upgrade()
    }

    pub fn keep_trimmed(&mut self, mesh: AssetId<Mesh>, mask: Mask, trimmed: &Arc<Trimmed>) {
        let all = self.trimmed.entry(mesh).or_default();
        all.retain(|(_, trimmed)| trimmed.strong_count() > 0);
        all.push((mask, Arc::downgrade(trimmed)));
    }

    pub fn trimmed(&self) -> impl Iterator<Item = Arc<Trimmed>> + '_ {
        let all = self.trimmed.values().flatten();
        all.filter_map(|(_, trimmed)| trimmed.upgrade())
    }

    /// A mesh is another from now on, or gone.
    pub fn forget(&mut self, mesh: AssetId<Mesh>) {
        self.trimmed.remove(&mesh);
        self.results
            .retain(|(content, _)| content.parts.iter().all(|(of, ..)| *of != mesh));
    }

    /// Lets go of what no model uses any more.
    pub fn sweep(&mut self) {
        self.trimmed.retain(|_, all| {
            all.retain(|(_, trimmed)| trimmed.strong_count() > 0);
            !all.is_empty()
        });
    }
}
