//! The background: one thread, which indexes a mesh and says what its chunks have.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use bevy::{
    math::{Vec3A, bounding::BoundingVolume},
    mesh::Indices,
};

use super::models::Key;
use crate::{
    spherical::{Layout, MapSettings, SphericalChunks, SphericalError, SphericalMaps},
    systems::{
        background::Job,
        gather::Raw,
        submesh::{Renumbering, SubMesh},
    },
};

/// Boxes are larger by so much: by some roundings of what enters their test. units: of the mesh's reach
const BOX_ROUNDING: f32 = 1.0 / (1 << 20) as f32;

/// What the background gives back.
pub(super) struct Made {
    pub maps: SphericalMaps,
    pub chunks: SphericalChunks,
    pub source: Option<Source>,
    /// By chunk.
    pub subs: Vec<SubMesh>,
}

/// A mesh's triangles.
pub(super) struct Source {
    pub positions: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

/// Work that is under way. When this is dropped the thread ends with the step that it is at.
pub(super) struct Work {
    is_cancelled: Arc<AtomicBool>,
    job: Job<Result<Made, SphericalError>>,
}

impl Drop for Work {
    fn drop(&mut self) {
        self.is_cancelled.store(true, Ordering::Relaxed);
    }
}

impl Work {
    /// # Errors
    /// In words: the system gives no thread.
    pub fn begin(raw: Raw, key: &Key) -> Result<Self, String> {
        let is_cancelled = Arc::new(AtomicBool::new(false));
        let (flag, key) = (is_cancelled.clone(), *key);
        let job = Job::begin("spherical index", move || make(raw, &key, &flag))?;
        Ok(Self { is_cancelled, job })
    }

    /// `None`: not yet.
    ///
    /// # Errors
    /// In words.
    pub fn poll(&mut self) -> Option<Result<Made, String>> {
        let result = self.job.poll()?;
        Some(result.and_then(|made| made.map_err(|error| error.to_string())))
    }
}

/// `None`: nobody wants it any more.
fn make(raw: Raw, key: &Key, is_cancelled: &AtomicBool) -> Option<Result<Made, SphericalError>> {
    // It may have waited for its share of the processor.
    if is_cancelled.load(Ordering::Relaxed) {
        return None;
    }
    let triangles = raw.triangles();
    let settings = MapSettings {
        bins: key.bins,
        chunk_triangles: key.chunk_triangles,
        layout: if key.is_paper {
            Layout::Rows
        } else {
            Layout::Blocks
        },
        // Only P3's rules look anything up in it.
        index_bytes: if key.is_paper {
            MapSettings::default().index_bytes
        } else {
            0
        },
    };
    let maps = match SphericalMaps::build(&raw.positions, &triangles, settings) {
        Ok(maps) => maps,
        Err(error) => return Some(Err(error)),
    };
    if is_cancelled.load(Ordering::Relaxed) {
        return None;
    }
    let chunks = match SphericalChunks::build(&raw.positions, &triangles, &maps) {
        Ok(chunks) => chunks,
        Err(error) => return Some(Err(error)),
    };
    let wide = raw
        .indices
        .as_ref()
        .map(|indices| matches!(indices, Indices::U32(_)));
    let mut numbers = Renumbering::new(raw.positions.len());
    let mut subs = Vec::with_capacity(chunks.chunks().len());
    for chunk in chunks.chunks() {
        if is_cancelled.load(Ordering::Relaxed) {
            return None;
        }
        let run = chunk.triangles.start as usize..chunk.triangles.end as usize;
        let kept = maps.order[run].iter();
        let kept = kept.map(|triangle| triangles[*triangle as usize]);
        let mut sub = numbers.sub_mesh(&raw.positions, kept, wide);
        if let Some(bounds) = &mut sub.bounds {
            // Bevy tests boxes in `f32`.
            *bounds = bounds.grow(Vec3A::splat(BOX_ROUNDING * chunks.reach() as f32));
        }
        subs.push(sub);
    }
    let source = key.is_paper.then_some(Source {
        positions: raw.positions,
        triangles,
    });
    Some(Ok(Made {
        maps,
        chunks,
        source,
        subs,
    }))
}
