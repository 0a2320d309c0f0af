//! The stages of a culling, one after another, on as many threads as are given.

use core::{
    num::NonZero,
    sync::atomic::{AtomicUsize, Ordering},
};
use std::{
    sync::Mutex,
    time::{Duration, Instant},
};

use super::{
    error::InteriorError,
    extract::{self, Met},
    field::{Field, SharedField},
    front,
    gpu::{FieldDevice, FieldOrigin, InteriorGpu, InteriorGpuError, Stopped},
    lattice::Lattice,
    model::{Model, Part},
    overlap::Snapped,
    progress::{Progress, Stage},
    settings::{InteriorCulling, InteriorFaces, InteriorLevel, InteriorMode, InteriorTransparent},
};

/// Triangles that a thread takes at a time.
const BATCH: usize = 4096;

/// What was found.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// A verdict for each part of the model.
    pub parts: Vec<Verdict>,
    /// The lattice that was used.
    pub lattice: Lattice,
    /// Points of it that are outside.
    pub outside_points: u64,
    /// Where the directed distance field was made.
    pub field_origin: FieldOrigin,
    /// Whether steps to and fro were told apart, for surfaces that are seen through from behind.
    pub is_one_sided: bool,
    /// How long each stage took, by [`Stage`].
    pub took: [Duration; 4],
}

/// Which triangles of a part stay.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// None: it is hidden.
    Hidden,
    /// All.
    Seen,
    /// Those whose entry, by the number of the triangle, is `true`; some are, and some not.
    Partly(Box<[bool]>),
}

impl Verdict {
    fn of(seen: Box<[bool]>) -> Self {
        match (seen.contains(&true), seen.contains(&false)) {
            (false, _) => Self::Hidden,
            (true, false) => Self::Seen,
            (true, true) => Self::Partly(seen),
        }
    }

    /// Whether a triangle stays.
    pub fn is_seen(&self, triangle: usize) -> bool {
        match self {
            Self::Hidden => false,
            Self::Seen => true,
            Self::Partly(seen) => seen.get(triangle).copied().unwrap_or(false),
        }
    }

    /// How many stay, of so many.
    pub fn count(&self, triangles: usize) -> usize {
        match self {
            Self::Hidden => 0,
            Self::Seen => triangles,
            Self::Partly(seen) => seen.iter().filter(|seen| **seen).count(),
        }
    }
}

impl Outcome {
    /// How long a stage took.
    pub fn took(&self, stage: Stage) -> Duration {
        self.took[stage as usize]
    }
}

/// Finds what of a model is seen from outside it. The verdicts are the same whatever the number of threads.
///
/// # Errors
/// A model without triangles or with a vertex that is nowhere; a grid that is none, or takes more memory than is
/// allowed; stopped by `progress`.
pub fn cull(
    model: &Model,
    settings: &InteriorCulling,
    threads: NonZero<usize>,
    progress: &Progress,
) -> Result<Outcome, InteriorError> {
    cull_on(FieldDevice::Cpu, model, settings, threads, progress)
}

/// The same, with the directed distance field made on a device: the verdicts are the same whichever it is. What the GPU
/// cannot do, the CPU does, and [`Outcome::field_origin`] says why.
///
/// # Errors
/// As [`cull`].
pub fn cull_on(
    device: FieldDevice,
    model: &Model,
    settings: &InteriorCulling,
    threads: NonZero<usize>,
    progress: &Progress,
) -> Result<Outcome, InteriorError> {
    let crew = Crew { threads, progress };
    let mut clock = Clock::start();

    progress.enter(Stage::Snapping, model.parts.len());
    let snapped = SnappedModel::new(model, settings, &crew)?;
    clock.lap(Stage::Snapping);

    let (field, field_origin) = match device {
        FieldDevice::Cpu => (snapped.field(&crew)?, FieldOrigin::Cpu),
        FieldDevice::Gpu(gpu) => match snapped.field_on_gpu(gpu, &crew)? {
            Ok(field) => (field, FieldOrigin::Gpu),
            Err(why) => (snapped.field(&crew)?, FieldOrigin::Fallback(why)),
        },
    };
    clock.lap(Stage::Field);

    let lattice = &snapped.lattice;
    progress.enter(Stage::Front, lattice.rows());
    let outside = front::propagate(lattice, &field, progress)?;
    drop(field);
    clock.lap(Stage::Front);

    let parts = snapped.extract(settings, &outside, &crew)?;
    clock.lap(Stage::Extraction);
    Ok(Outcome {
        parts,
        lattice: *lattice,
        outside_points: outside.count(),
        field_origin,
        is_one_sided: snapped.is_one_sided,
        took: clock.took,
    })
}

/// The lattice around a model and its directed distance field, on their own.
///
/// # Errors
/// As [`cull`].
pub fn distance_field(
    model: &Model,
    settings: &InteriorCulling,
    threads: NonZero<usize>,
    progress: &Progress,
) -> Result<(Lattice, Field), InteriorError> {
    let crew = Crew { threads, progress };
    let snapped = SnappedModel::new(model, settings, &crew)?;
    let field = snapped.field(&crew)?;
    Ok((snapped.lattice, field))
}

/// A model in a lattice's units.
pub(super) struct SnappedModel<'a> {
    pub(super) lattice: Lattice,
    pub(super) parts: Vec<SnappedPart<'a>>,
    is_one_sided: bool,
}

pub(super) struct SnappedPart<'a> {
    part: &'a Part,
    vertices: Vec<[i32; 3]>,
    is_mirrored: bool,
    /// Whether anything is seen through it; else, whether it hides from both sides.
    is_open: bool,
    is_two_sided: bool,
}

impl SnappedPart<'_> {
    /// A triangle; `None` if it names a vertex that is not there.
    fn triangle(&self, number: usize) -> Option<Snapped> {
        let [a, b, c] = self.part.surface.triangles[number]
            .map(|index| self.vertices.get(index as usize).copied());
        let (b, c) = if self.is_mirrored { (c, b) } else { (b, c) };
        Some(Snapped::new([a?, b?, c?]))
    }

    fn len(&self) -> usize {
        self.part.surface.triangles.len()
    }
}

impl<'a> SnappedModel<'a> {
    fn new(
        model: &'a Model,
        settings: &InteriorCulling,
        crew: &Crew,
    ) -> Result<Self, InteriorError> {
        let bounds = model.bounds().map_err(|part| InteriorError::NotFinite {
            part,
            node: model.parts[part].node,
        })?;
        let bounds = bounds.ok_or(InteriorError::NoTriangles)?;
        let one_sided =
            |part: &Part| settings.faces == InteriorFaces::AsDrawn && !part.is_two_sided;
        let open =
            |part: &Part| settings.transparent == InteriorTransparent::Open && part.is_transparent;
        let is_one_sided = model
            .parts
            .iter()
            .any(|part| one_sided(part) && !open(part));
        let vertices: usize = model
            .parts
            .iter()
            .map(|part| part.surface.positions.len())
            .sum();
        let extra = (vertices * size_of::<[i32; 3]>() + model.triangle_count()) as u64;
        let lattice = Lattice::plan(settings, bounds, is_one_sided, extra)?;
        let parts = crew.map(model.parts.len(), |number| {
            let part = &model.parts[number];
            SnappedPart {
                part,
                vertices: snap(&lattice, part),
                is_mirrored: part.is_mirrored(),
                is_open: open(part),
                is_two_sided: !one_sided(part),
            }
        })?;
        Ok(Self {
            lattice,
            parts,
            is_one_sided,
        })
    }

    fn field(&self, crew: &Crew) -> Result<Field, InteriorError> {
        let field = SharedField::new(&self.lattice, self.is_one_sided);
        let solid: Vec<_> = self.batches(|part| !part.is_open);
        crew.progress.enter(Stage::Field, solid.len());
        crew.each(solid.len(), |at| {
            let batch = &solid[at];
            let part = &self.parts[batch.part];
            for triangle in batch
                .triangles
                .clone()
                .filter_map(|number| part.triangle(number))
            {
                field.block(&self.lattice, &triangle, part.is_two_sided);
            }
        })?;
        Ok(field.into_field())
    }

    /// The same, on the GPU, if it can.
    fn field_on_gpu(
        &self,
        gpu: &InteriorGpu,
        crew: &Crew,
    ) -> Result<Result<Field, InteriorGpuError>, InteriorError> {
        let solid: Vec<_> = self.batches(|part| !part.is_open);
        let slabs = match gpu.slabs(&self.lattice, self.is_one_sided) {
            Ok(slabs) => slabs,
            Err(why) => return Ok(Err(why)),
        };
        crew.progress.enter(Stage::Field, slabs.len() * solid.len());
        let made = gpu.make(&self.lattice, &slabs, |feed| {
            crew.each(solid.len(), |at| {
                let batch = &solid[at];
                let part = &self.parts[batch.part];
                let triangles = batch.triangles.clone();
                feed.add(
                    triangles
                        .filter_map(|number| Some((part.triangle(number)?, part.is_two_sided))),
                );
            })
        });
        match made {
            Ok(field) => Ok(Ok(field)),
            Err(Stopped::Gpu(why)) => Ok(Err(why)),
            Err(Stopped::Host(stopped)) => Err(stopped),
        }
    }

    fn extract(
        &self,
        settings: &InteriorCulling,
        outside: &front::Outside,
        crew: &Crew,
    ) -> Result<Vec<Verdict>, InteriorError> {
        let batches = self.batches(|_| true);
        crew.progress.enter(Stage::Extraction, batches.len());
        let seen = match settings.mode {
            InteriorMode::Conservative => {
                let seen = crew.map(batches.len(), |at| {
                    let batch = &batches[at];
                    let part = &self.parts[batch.part];
                    batch
                        .triangles
                        .clone()
                        .map(|number| {
                            part.triangle(number).is_some_and(|triangle| {
                                extract::is_near(&self.lattice, outside, &triangle)
                            })
                        })
                        .collect::<Vec<_>>()
                })?;
                let mut all: Vec<Vec<bool>> = vec![Vec::new(); self.parts.len()];
                for (batch, seen) in batches.iter().zip(seen) {
                    all[batch.part].extend(seen);
                }
                all
            }
            InteriorMode::Sampled => {
                let met = crew.map(batches.len(), |at| {
                    let batch = &batches[at];
                    let part = &self.parts[batch.part];
                    let mut met = Met::default();
                    for number in batch.triangles.clone() {
                        if let Some(triangle) = part.triangle(number) {
                            let number = (batch.part as u64) << 32 | number as u64;
                            extract::meet(&self.lattice, outside, &triangle, number, &mut met);
                        }
                    }
                    met
                })?;
                let mut first = Met::default();
                for (step, found) in met.into_iter().flatten() {
                    let nearest = first.entry(step).or_insert(found);
                    *nearest = (*nearest).min(found);
                }
                let mut all: Vec<Vec<bool>> = self
                    .parts
                    .iter()
                    .map(|part| vec![false; part.len()])
                    .collect();
                for (_, number) in first.into_values() {
                    all[(number >> 32) as usize][number as u32 as usize] = true;
                }
                all
            }
        };
        let mut verdicts: Vec<_> = seen
            .into_iter()
            .map(|seen| Verdict::of(seen.into_boxed_slice()))
            .collect();
        if settings.level == InteriorLevel::Node {
            self.take_whole_nodes(&mut verdicts);
        }
        Ok(verdicts)
    }

    /// A node of which anything is seen stays as it is.
    fn take_whole_nodes(&self, verdicts: &mut [Verdict]) {
        let seen: bevy::platform::collections::HashSet<u32> = self
            .parts
            .iter()
            .zip(&*verdicts)
            .filter(|(_, verdict)| **verdict != Verdict::Hidden)
            .map(|(part, _)| part.part.node)
            .collect();
        for (part, verdict) in self.parts.iter().zip(verdicts) {
            *verdict = if seen.contains(&part.part.node) && part.len() > 0 {
                Verdict::Seen
            } else {
                Verdict::Hidden
            };
        }
    }

    fn batches(&self, wanted: impl Fn(&SnappedPart) -> bool) -> Vec<Batch> {
        let mut batches = Vec::new();
        for (number, part) in self
            .parts
            .iter()
            .enumerate()
            .filter(|(_, part)| wanted(part))
        {
            for start in (0..part.len()).step_by(BATCH) {
                batches.push(Batch {
                    part: number,
                    triangles: start..part.len().min(start + BATCH),
                });
            }
        }
        batches
    }
}

/// Triangles of one part.
struct Batch {
    part: usize,
    triangles: core::ops::Range<usize>,
}

/// Vertices that no triangle uses may be anywhere, or nowhere.
fn snap(lattice: &Lattice, part: &Part) -> Vec<[i32; 3]> {
    part.surface
        .positions
        .iter()
        .map(|position| lattice.snap(part.place(*position)))
        .collect()
}

/// Threads that share the work of a stage.
pub(super) struct Crew<'a> {
    pub(super) threads: NonZero<usize>,
    pub(super) progress: &'a Progress,
}

impl Crew<'_> {
    /// Does all of so many pieces of work, in any order.
    fn each(&self, pieces: usize, work: impl Fn(usize) + Sync) -> Result<(), InteriorError> {
        let next = AtomicUsize::new(0);
        let run = || {
            while !self.progress.is_cancelled() {
                let at = next.fetch_add(1, Ordering::Relaxed);
                if at >= pieces {
                    break;
                }
                work(at);
                self.progress.advance(1);
            }
        };
        std::thread::scope(|scope| {
            for _ in 1..self.threads.get().min(pieces) {
                scope.spawn(run);
            }
            run();
        });
        if self.progress.is_cancelled() {
            return Err(InteriorError::Cancelled);
        }
        Ok(())
    }

    /// What the pieces of work give, in their order.
    fn map<T: Send>(
        &self,
        pieces: usize,
        work: impl Fn(usize) -> T + Sync,
    ) -> Result<Vec<T>, InteriorError> {
        let results = Mutex::new(Vec::with_capacity(pieces));
        self.each(pieces, |at| {
            let result = work(at);
            let mut results = results
                .lock()
                .unwrap_or_else(|poisoned| poisoned.into_inner());
            results.push((at, result));
        })?;
        let mut results = results
            .into_inner()
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        results.sort_unstable_by_key(|(at, _)| *at);
        Ok(results.into_iter().map(|(_, result)| result).collect())
    }
}

/// How long stages took.
struct Clock {
    since: Instant,
    took: [Duration; 4],
}

impl Clock {
    fn start() -> Self {
        Self {
            since: Instant::now(),
            took: [Duration::ZERO; 4],
        }
    }

    fn lap(&mut self, stage: Stage) {
        let now = Instant::now();
        self.took[stage as usize] = now - self.since;
        self.since = now;
    }
}
