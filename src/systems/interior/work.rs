//! The background: one thread of the lowest priority, which culls a model and works out its trimmed meshes.
//!
//! Neither Bevy's compute pool nor its asynchronous one will do: their threads have the priority of the frame's own, and
//! on two cores each is one that a frame waits for.

use core::num::NonZero;
use std::sync::{
    Arc, Mutex,
    mpsc::{Receiver, TryRecvError, sync_channel},
};

use bevy::{
    math::{DAffine3, bounding::Aabb3d},
    mesh::{Indices, PrimitiveTopology},
    prelude::*,
};
use thread_priority::{ThreadPriority, set_current_thread_priority};

use super::{
    gather::Raw,
    store::{Content, Found, Mask, is_set},
};
use crate::interior::{
    self, FieldDevice, FieldOrigin, InteriorCulling, InteriorError, InteriorGpu, Model, Progress,
    Surface, Verdict, cull_on,
};

/// Of so many cores one works in the background.
const CORES_A_THREAD: usize = 4;

/// What the background is given.
pub(super) struct Input {
    pub settings: InteriorCulling,
    /// Makes the field, where it is asked to.
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

/// Which vertices and triangles a trimmed mesh has.
pub(super) struct Trim {
    /// Number of the mesh in the model.
    pub mesh: u32,
    pub mask: Mask,
    /// Those of the mesh's vertices that it has, in their order.
    pub vertices: Vec<u32>,
    /// Of the trimmed mesh, as wide as the mesh's own; `None` where that has none.
    pub indices: Option<Indices>,
    pub bounds: Option<Aabb3d>,
}

/// Work that is under way; it ends when this is dropped.
pub(super) struct Work {
    pub content: Content,
    progress: Arc<Progress>,
    result: Mutex<Receiver<Result<Output, InteriorError>>>,
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
        let (sender, result) = sync_channel(1);
        let shared = progress.clone();
        let run = move || {
            // Threads that it starts have its priority where the system passes that on, as Linux does. Where it may not
            // be lowered, it works on with the one it has.
            let _ = set_current_thread_priority(ThreadPriority::Min);
            let output = work(input, &shared);
            // Whoever waited may be gone.
            let _ = sender.send(output);
        };
        std::thread::Builder::new()
            .name("interior culling".into())
            .spawn(run)
            .map_err(|error| {
                format!("the system gives no thread to work in the background: {error}")
            })?;
        Ok(Self {
            content,
            progress,
            result: Mutex::new(result),
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
        let result = self
            .result
            .get_mut()
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        match result.try_recv() {
            Ok(output) => Some(output.map_err(|error| error.to_string())),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err(
                "the thread in the background ended without a result".into(),
            )),
        }
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
            let device = gpu.as_ref().map_or(FieldDevice::Cpu, FieldDevice::Gpu);
            let outcome = cull_on(device, &model, &settings, threads(), progress)?;
            if let FieldOrigin::Fallback(why) = &outcome.field_origin {
                warn!("interior culling made a distance field on the CPU: {why}");
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
            trims.push(trim(mesh as u32, mask, &surfaces[mesh], kinds[mesh].1));
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
    }
}

/// `wide`: whether the mesh's indices are of 32 bits; `None` if it has none.
fn trim(mesh: u32, mask: &Mask, surface: &Surface, wide: Option<bool>) -> Trim {
    let vertices = surface.positions.len();
    let kept = || {
        let all = surface.triangles.iter().enumerate();
        all.filter(|(triangle, _)| is_set(mask, *triangle))
            .flat_map(|(_, corners)| corners.iter().copied())
            .filter(|corner| (*corner as usize) < vertices)
    };
    let (list, indices) = match wide {
        // Each triangle has its own three.
        None => (kept().collect(), None),
        Some(wide) => {
            let mut numbers = vec![u32::MAX; vertices];
            for corner in kept() {
                numbers[corner as usize] = 0;
            }
            let mut list = Vec::new();
            for (vertex, number) in numbers.iter_mut().enumerate().filter(|(_, n)| **n == 0) {
                *number = list.len() as u32;
                list.push(vertex as u32);
            }
            let renumbered = kept().map(|corner| numbers[corner as usize]);
            let indices = if wide {
                Indices::U32(renumbered.collect())
            } else {
                // There are no more vertices than there were.
                Indices::U16(renumbered.map(|number| number as u16).collect())
            };
            (list, Some(indices))
        }
    };
    let mut places = list
        .iter()
        .map(|vertex| Vec3::from(surface.positions[*vertex as usize]));
    let bounds = places.next().map(|first| {
        let (min, max) = places.fold((first, first), |(min, max), at| (min.min(at), max.max(at)));
        Aabb3d::from_min_max(min, max)
    });
    Trim {
        mesh,
        mask: mask.clone(),
        vertices: list,
        indices,
        bounds,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trimmed_mesh_has_the_vertices_of_its_triangles_in_their_order() {
        let surface = Surface {
            positions: (0..6).map(|i| [i as f32, 0.0, 0.0]).collect(),
            triangles: vec![[5, 1, 3], [0, 1, 2], [3, 1, 4]],
        };
        let mask: Mask = vec![0b101].into();
        let trimmed = trim(7, &mask, &surface, Some(false));
        assert_eq!(trimmed.vertices, [1, 3, 4, 5]);
        assert_eq!(trimmed.indices, Some(Indices::U16(vec![3, 0, 1, 1, 0, 2])));
        assert_eq!(trimmed.bounds.map(|b| (b.min.x, b.max.x)), Some((1.0, 5.0)));
        let loose = trim(7, &mask, &surface, None);
        assert_eq!(loose.vertices, [5, 1, 3, 3, 1, 4]);
        assert_eq!(loose.indices, None);
    }
}
