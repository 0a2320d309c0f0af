//! The background: one thread, which culls a model and works out its trimmed meshes.

use core::num::NonZero;
use std::sync::Arc;

use bevy::{
    math::DAffine3,
    mesh::{Indices, PrimitiveTopology},
    prelude::*,
};

use super::store::{Content, Found, Mask, is_set};
use crate::{
    interior::{
        self, FieldBy, FieldDevice, FieldOrigin, InteriorCulling, InteriorError, InteriorGpu,
        Model, Progress, Surface, Verdict, cull_on,
    },
    systems::{
        background::Job,
        gather::Raw,
        submesh::{Renumbering, SubMesh},
    },
};

/// Of so many cores one works in the background.
const CORES_A_THREAD: usize = 4;

/// What the background is given.
pub(super) struct Input {
    pub settings: InteriorCulling,
    /// The app's, where it has one.
    pub gpu: Option<InteriorGpu>,
    pub raws: Vec<Raw>,
    pub parts: Vec<InputPart>,
    /// By mesh, whether a trimmed one is to be made if need be.
    pub wanted: Vec<bool>,
    /// What is known already.
    pub found: Option<Arc<Found>>,
}

pub(super) struct InputPart {
    pub mesh: u32,
    pub root_from_local: DAffine3,
    pub is_transparent: bool,
    pub is_two_sided: bool,
}

/// What the background gives back.
pub(super) struct Output {
    pub found: Arc<Found>,
    pub trims: Vec<Trim>,
}

/// What a trimmed mesh has.
pub(super) struct Trim {
    /// Number of the mesh in the model.
    pub mesh: u32,
    pub mask: Mask,
    pub sub: SubMesh,
}

/// Work that is under way; it ends when this is dropped.
pub(super) struct Work {
    pub content: Content,
    progress: Arc<Progress>,
    job: Job<Result<Output, InteriorError>>,
}

impl Drop for Work {
    fn drop(&mut self) {
        self.progress.cancel();
    }
}

impl Work {
    /// # Errors
    /// In words: the system gives no thread.
    pub fn begin(content: Content, input: Input) -> Result<Self, String> {
        let progress = Arc::new(Progress::default());
        let shared = progress.clone();
        let job = Job::begin("interior culling", move || Some(work(input, &shared)))?;
        Ok(Self {
            content,
            progress,
            job,
        })
    }

    /// The stage it is in, and how much of that is done, from 0 to 1.
    pub fn now(&self) -> (interior::Stage, f32) {
        self.progress.now()
    }

    /// `None`: not yet.
    ///
    /// # Errors
    /// In words.
    pub fn poll(&mut self) -> Option<Result<Output, String>> {
        let result = self.job.poll()?;
        Some(result.and_then(|made| made.map_err(|error| error.to_string())))
    }
}

fn threads() -> NonZero<usize> {
    let cores = std::thread::available_parallelism().map_or(1, NonZero::get);
    NonZero::new(cores / CORES_A_THREAD).unwrap_or(NonZero::<usize>::MIN)
}

fn work(input: Input, progress: &Progress) -> Result<Output, InteriorError> {
    let Input {
        settings,
        gpu,
        raws,
        parts,
        wanted,
        found,
    } = input;
    let mut kinds = Vec::with_capacity(raws.len());
    let mut surfaces = Vec::with_capacity(raws.len());
    for raw in raws {
        if progress.is_cancelled() {
            return Err(InteriorError::Cancelled);
        }
        let triangles = raw.triangles();
        kinds.push((raw.topology, raw.indices.as_ref().map(is_wide)));
        surfaces.push(Arc::new(Surface {
            positions: raw.positions,
            triangles,
        }));
    }
    let found = match found {
        Some(found) => found,
        None => {
            let part = |(node, part): (u32, &InputPart)| interior::Part {
                node,
                surface: surfaces[part.mesh as usize].clone(),
                model_from_local: part.root_from_local,
                is_transparent: part.is_transparent,
                is_two_sided: part.is_two_sided,
            };
            let model = Model {
                parts: (0..).zip(&parts).map(part).collect(),
            };
            let by_gpu = settings.field == FieldBy::Gpu;
            let device = match &gpu {
                Some(gpu) if by_gpu => FieldDevice::Gpu(gpu),
                _ => FieldDevice::Cpu,
            };
            let outcome = cull_on(device, &model, &settings, threads(), progress)?;
            match &outcome.field_origin {
                FieldOrigin::Fallback(why) => {
                    warn!("interior culling made a distance field on the CPU: {why}");
                }
                FieldOrigin::Cpu if by_gpu => {
                    warn!("interior culling made a distance field on the CPU: the app has no GPU");
                }
                FieldOrigin::Cpu | FieldOrigin::Gpu => {}
            }
            let can_trim = |mesh: usize| kinds[mesh].0 == PrimitiveTopology::TriangleList;
            Arc::new(union(&outcome, &parts, &surfaces, can_trim))
        }
    };
    let mut trims = Vec::new();
    for (mesh, mask) in found.masks.iter().enumerate() {
        if progress.is_cancelled() {
            return Err(InteriorError::Cancelled);
        }
        if let Some(mask) = mask
            && wanted[mesh]
        {
            let surface = &surfaces[mesh];
            let kept = (surface.triangles.iter().copied().enumerate())
                .filter(|(triangle, _)| is_set(mask, *triangle))
                .map(|(_, corners)| corners);
            let mut numbers = Renumbering::new(surface.positions.len());
            trims.push(Trim {
                mesh: mesh as u32,
                mask: mask.clone(),
                sub: numbers.sub_mesh(&surface.positions, kept, kinds[mesh].1),
            });
        }
    }
    Ok(Output { found, trims })
}

/// Whether indices are of 32 bits.
fn is_wide(indices: &Indices) -> bool {
    matches!(indices, Indices::U32(_))
}

/// What of each mesh is seen in any of its parts. Of a strip no triangle can be left out: it stays whole.
fn union(
    outcome: &interior::Outcome,
    parts: &[InputPart],
    surfaces: &[Arc<Surface>],
    can_trim: impl Fn(usize) -> bool,
) -> Found {
    let count = |mesh: usize| surfaces[mesh].triangles.len();
    // `None`: no part is seen.
    let mut seen: Vec<Option<Vec<u64>>> = vec![None; surfaces.len()];
    for (part, verdict) in parts.iter().zip(&outcome.parts) {
        let mesh = part.mesh as usize;
        if *verdict == Verdict::Hidden {
            continue;
        }
        let bits = seen[mesh].get_or_insert_with(|| vec![0; count(mesh).div_ceil(64)]);
        for triangle in (0..count(mesh)).filter(|triangle| verdict.is_seen(*triangle)) {
            bits[triangle / 64] |= 1 << (triangle % 64);
        }
    }
    let mut kept = Vec::with_capacity(surfaces.len());
    let mut masks = Vec::with_capacity(surfaces.len());
    for (mesh, bits) in seen.into_iter().enumerate() {
        let some = bits
            .as_ref()
            .map(|bits| bits.iter().map(|word| word.count_ones()).sum::<u32>());
        let is_part = some.is_some_and(|some| (some as usize) < count(mesh)) && can_trim(mesh);
        kept.push(some.filter(|_| is_part).unwrap_or(count(mesh) as u32));
        masks.push(bits.filter(|_| is_part).map(Mask::from));
    }
    Found {
        hidden: outcome
            .parts
            .iter()
            .map(|verdict| *verdict == Verdict::Hidden)
            .collect(),
        masks: masks.into(),
        triangles: (0..surfaces.len()).map(|mesh| count(mesh) as u32).collect(),
        kept: kept.into(),
        gap: outcome.lattice.gap(),
        field: match outcome.field_origin {
            FieldOrigin::Gpu => FieldBy::Gpu,
            FieldOrigin::Cpu | FieldOrigin::Fallback(_) => FieldBy::Cpu,
        },
    }
}
