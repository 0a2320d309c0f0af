//! `skyline accuracy interior`: what is taken out of models at each grid, what it takes, and what is wrong about it (P5a).
//!
//! Each model is culled at each grid by the default (`conservative`, glass open, back faces seen through), by the paper's
//! extraction with the same surfaces (`sampled`), and by the paper's choices altogether (`paper`: `sampled`, glass closed,
//! everything two-sided). Two errors:
//!
//! - `false_cull_px`: pixels, in many views from outside, of which something that shows there was taken out
//!   (`views.rs`); `false_cull_px_in_gap`, of the default alone, which guarantees that there are none: those of them at which
//!   a ball as wide as the grid's gap, brought straight from the eye, touches something that was taken out (`truth.rs`).
//! - `kept_hidden`: share of the triangles that stay though nobody sees them: they show in no view, and no ray from them
//!   gets out (`truth.rs`); where it is known how a model was made, by that too.

pub(super) mod machine;
mod report;
mod truth;
mod views;

use core::num::NonZero;
use std::path::{Path, PathBuf};

use bevy::math::DVec3;
use indicatif::ProgressBar;
use serde::Serialize;

use self::{
    truth::Walls,
    views::{Shown, View},
};
use super::{AccuracyError, Found, Report, Summary, Timing};
use crate::{
    interior::{
        InteriorCulling, InteriorFaces, InteriorGrid, InteriorMode, InteriorTransparent, Model,
        Outcome, Progress, Stage, Verdict, cull,
    },
    offline::{interior, spinner},
};

/// What a model and its lattice may take. units: MiB
const MEMORY_MIB: u32 = 1 << 14;

/// What to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Models (`.glb`, `.gltf`).
    pub models: Vec<PathBuf>,
    /// Triangles of the machine made by code; 0 for none.
    pub machine_triangles: usize,
    /// Grids, as cells on the longest side; at most 21.
    pub grids: Vec<u32>,
    /// Views from outside.
    pub views: usize,
    /// Both sides of the views' pictures. units: px
    pub size: u32,
    /// Places on a triangle that rays leave from, and rays from each.
    pub rays: (usize, usize),
    /// How often each setting is timed.
    pub rounds: usize,
    /// Threads that cull.
    pub threads: NonZero<usize>,
}

impl Plan {
    /// P5a's grids, more views than can be counted on.
    pub fn full() -> Self {
        Self {
            models: Vec::new(),
            machine_triangles: 3_000_000,
            grids: vec![64, 128, 256, 512],
            views: 500,
            size: 512,
            rays: (1, 64),
            rounds: 3,
            threads: threads(),
        }
    }

    /// Seconds.
    pub fn quick() -> Self {
        Self {
            machine_triangles: 300_000,
            grids: vec![64, 128, 256],
            views: 60,
            size: 256,
            rays: (1, 24),
            rounds: 1,
            ..Self::full()
        }
    }
}

pub(super) fn threads() -> NonZero<usize> {
    std::thread::available_parallelism().unwrap_or(NonZero::<usize>::MIN)
}

/// The ways to cull that are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    Conservative,
    Sampled,
    Paper,
}

impl Way {
    const ALL: [Self; 3] = [Self::Conservative, Self::Sampled, Self::Paper];

    fn name(self) -> &'static str {
        match self {
            Self::Conservative => "conservative",
            Self::Sampled => "sampled",
            Self::Paper => "paper",
        }
    }

    fn at(self, grid: u32) -> InteriorCulling {
        let base = InteriorCulling {
            grid: InteriorGrid::Resolution(grid),
            // What it takes is told.
            memory_mib: MEMORY_MIB,
            ..Default::default()
        };
        match self {
            Self::Conservative => base,
            Self::Sampled => InteriorCulling {
                mode: InteriorMode::Sampled,
                ..base
            },
            Self::Paper => InteriorCulling {
                mode: InteriorMode::Sampled,
                transparent: InteriorTransparent::Closed,
                faces: InteriorFaces::TwoSided,
                ..base
            },
        }
    }
}

/// A setting, by its component's fields.
#[derive(Serialize, Clone, Debug, PartialEq)]
pub struct SettingLine {
    /// `conservative`, `sampled`, or `paper`: sampled, glass closed, everything two-sided.
    pub mode: &'static str,
    /// Cells on the longest side.
    pub resolution: u32,
}

/// The default, as lines name it.
pub(super) fn default_settings() -> Vec<serde_json::Value> {
    let InteriorGrid::Resolution(resolution) = InteriorGrid::default() else {
        return Vec::new();
    };
    let mode = Way::Conservative.name();
    vec![serde_json::json!(SettingLine { mode, resolution })]
}

/// One line of `results.jsonl`.
#[derive(Serialize, Clone, Debug)]
pub struct InteriorLine {
    /// Always `interior`.
    pub effect: &'static str,
    /// The model.
    pub scene: String,
    /// How it was culled.
    pub setting: SettingLine,
    /// All stages. units: ms
    pub time_ms: Timing,
    /// Medians of the stages: snapping, field, front, extraction. units: ms
    pub stages_ms: [f64; 4],
    /// Nodes with triangles, and those of which none stays.
    pub nodes: usize,
    /// See `nodes`.
    pub removed_nodes: usize,
    /// Triangles, each node's own, and those that go.
    pub triangles: usize,
    /// See `triangles`.
    pub removed_triangles: usize,
    /// What a ball so wide can touch from outside stays. units: of the model
    pub gap: f64,
    /// Of the lattice. units: MiB
    pub lattice_mib: f64,
    /// What is wrong.
    pub error: InteriorErrors,
    /// What did the work.
    pub adapter: String,
}

/// What is wrong about a culling.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct InteriorErrors {
    /// Pixels of which something that shows there was taken out, in all views.
    pub false_cull_px: u64,
    /// Those of them where a ball as wide as the gap, brought straight from the eye, touches what was taken out; of
    /// `conservative` only, which guarantees that there are none.
    pub false_cull_px_in_gap: Option<u64>,
    /// Of so many pixels that show anything.
    pub pixels: u64,
    /// Views with such pixels.
    pub views_with_false_culls: usize,
    /// Of so many.
    pub views: usize,
    /// Share of the triangles that stay and nobody sees.
    pub kept_hidden: f64,
    /// The same of nodes.
    pub kept_hidden_nodes: f64,
    /// Nodes that stay though it is known that they cannot be seen; of the machine only.
    pub known_hidden_kept: Option<usize>,
}

/// Measures interior culling and writes everything to a directory.
///
/// # Errors
/// [`AccuracyError`].
///
/// # Panics
/// If there are more than 21 grids.
pub fn measure(plan: &Plan, out: &Path) -> Result<Summary, AccuracyError> {
    assert!(
        plan.grids.len() * Way::ALL.len() <= u64::BITS as usize,
        "more than 21 grids"
    );
    let mut report = Report::new(out, "interior")?;
    let progress = spinner();
    let mut lines = Vec::new();
    let mut notes = Vec::new();
    for path in &plan.models {
        progress.set_message(format!("reading {}", path.display()));
        let model = interior::read_model(path, MEMORY_MIB)?;
        let name = path.file_stem().unwrap_or(path.as_os_str());
        let name = name.to_string_lossy().into_owned();
        measure_model(
            plan,
            &name,
            &model,
            None,
            &progress,
            &mut report,
            &mut lines,
        )?;
    }
    if plan.machine_triangles > 0 {
        progress.set_message("making the machine");
        let machine = machine::machine(plan.machine_triangles);
        let known = Some(&*machine.is_hidden);
        measure_model(
            plan,
            "machine",
            &machine.model,
            known,
            &progress,
            &mut report,
            &mut lines,
        )?;
    }
    notes.push(format!(
        "{} views of {}×{} px from all sides, every third a close one; rays from {} places of a triangle, {} from each",
        plan.views, plan.size, plan.size, plan.rays.0, plan.rays.1
    ));
    progress.finish_and_clear();
    report::draw(&mut report, &lines)?;
    report.results(&lines)?;
    report.csv(&report::csv(&lines))?;
    let tables = report::tables(&lines);
    let adapter = adapter(plan);
    let head = format!(
        "{adapter}; {}; times are medians of {} rounds.",
        notes.join("; "),
        plan.rounds
    );
    report.finish(Found {
        title: "What accuracy costs: interior culling",
        head: &head,
        tables: &tables,
        clock: "the wall clock, of all stages",
        adapter,
        results: lines.len(),
        highlights: report::highlights(&lines),
    })
}

fn adapter(plan: &Plan) -> String {
    format!("the CPU, {} threads", plan.threads)
}

/// One way at one grid, done.
struct Done {
    way: Way,
    grid: u32,
    outcome: Outcome,
    /// Of all stages, and of each; a row a round. units: ms
    times: Vec<[f64; 4]>,
}

fn measure_model(
    plan: &Plan,
    name: &str,
    model: &Model,
    known_hidden: Option<&[bool]>,
    progress: &ProgressBar,
    report: &mut Report,
    lines: &mut Vec<InteriorLine>,
) -> Result<(), AccuracyError> {
    let mut done: Vec<Done> = Vec::new();
    for round in 0..plan.rounds {
        // Grids in turn, so that what else the machine does falls on all.
        let ways = plan
            .grids
            .iter()
            .flat_map(|grid| Way::ALL.map(|way| (*grid, way)));
        for (at, (grid, way)) in ways.enumerate() {
            progress.set_message(format!("{name}, {} at {grid}", way.name()));
            progress.inc(1);
            let outcome = cull(model, &way.at(grid), plan.threads, &Progress::default())
                .map_err(AccuracyError::Interior)?;
            let times = outcome.took.map(|took| took.as_secs_f64() * 1e3);
            if round == 0 {
                done.push(Done {
                    way,
                    grid,
                    outcome,
                    times: vec![times],
                });
            } else {
                done[at].times.push(times);
            }
        }
    }
    progress.set_message(format!("{name}, looking at it"));
    let shown = views::shown(model);
    let missing: Vec<u64> = shown
        .iter()
        .map(|triangle| {
            let lacks = |verdict: &Verdict| !verdict.is_seen(triangle.number as usize);
            (0..)
                .zip(&done)
                .filter(|(_, done)| lacks(&done.outcome.parts[triangle.part as usize]))
                .fold(0, |bits, (at, _)| bits | 1 << at)
        })
        .collect();
    let corners = || shown.iter().flat_map(|triangle| triangle.corners);
    let least = corners().fold(DVec3::MAX, DVec3::min);
    let greatest = corners().fold(DVec3::MIN, DVec3::max);
    let extent = (greatest - least).length();
    let walls = Walls::new(&shown, extent);
    let scene = Scene {
        shown: &shown,
        missing: &missing,
        walls: &walls,
        extent,
        gaps: done
            .iter()
            .map(|done| (done.way == Way::Conservative).then(|| done.outcome.lattice.gap()))
            .collect(),
    };
    let views = views::around((least, greatest), plan.views, plan.size);
    let looked = look(plan, &scene, &views, progress);
    progress.set_message(format!("{name}, rays from what does not show"));
    let stays_in_any = |i: usize| missing[i] != (1 << done.len()) - 1;
    let seen = in_parallel(plan.threads, shown.len(), |i| {
        looked.seen[i]
            || (stays_in_any(i) && walls.is_seen(&shown[i], plan.rays.0, plan.rays.1, i as u64))
    });
    for (at, done) in done.iter().enumerate() {
        let bit = 1 << at;
        let kept = || (0..shown.len()).filter(|i| missing[*i] & bit == 0);
        let kept_hidden = kept().filter(|i| !seen[*i]).count();
        let nodes = Nodes::of(model, &shown, &seen, &done.outcome);
        let all = done.times.iter().map(|times| times.iter().sum()).collect();
        let stage = |stage: Stage| {
            let times = done.times.iter().map(|times| times[stage as usize]);
            Timing::of(times.collect()).median
        };
        let lattice = &done.outcome.lattice;
        lines.push(InteriorLine {
            effect: "interior",
            scene: name.to_owned(),
            setting: SettingLine {
                mode: done.way.name(),
                resolution: done.grid,
            },
            time_ms: Timing::of(all),
            stages_ms: [
                Stage::Snapping,
                Stage::Field,
                Stage::Front,
                Stage::Extraction,
            ]
            .map(stage),
            nodes: nodes.all,
            removed_nodes: nodes.all - nodes.kept,
            triangles: shown.len(),
            removed_triangles: shown.len() - kept().count(),
            gap: lattice.gap(),
            lattice_mib: lattice.bytes(done.outcome.is_one_sided) as f64 / f64::from(1 << 20),
            error: InteriorErrors {
                false_cull_px: looked.missed[at],
                false_cull_px_in_gap: (done.way == Way::Conservative)
                    .then_some(looked.missed_in_gap[at]),
                pixels: looked.pixels,
                views_with_false_culls: looked.views_with[at],
                views: plan.views,
                kept_hidden: share(kept_hidden, kept().count()),
                kept_hidden_nodes: share(nodes.kept_hidden, nodes.kept),
                known_hidden_kept: known_hidden.map(|known| {
                    let kept = done.outcome.parts.iter().zip(known);
                    kept.filter(|(verdict, hidden)| **hidden && **verdict != Verdict::Hidden)
                        .count()
                }),
            },
            adapter: adapter(plan),
        });
    }
    report::pictures(report, name, &scene, &looked, plan, &|at| {
        let done: &Done = &done[at];
        (done.way.name(), done.grid)
    })
}

fn share(part: usize, of: usize) -> f64 {
    if of > 0 { part as f64 / of as f64 } else { 0.0 }
}

/// Nodes with triangles.
struct Nodes {
    all: usize,
    kept: usize,
    kept_hidden: usize,
}

impl Nodes {
    fn of(model: &Model, shown: &[Shown], seen: &[bool], outcome: &Outcome) -> Self {
        let count = model.parts.iter().map(|part| part.node as usize + 1).max();
        let mut has = vec![[false; 3]; count.unwrap_or(0)];
        for (part, verdict) in model.parts.iter().zip(&outcome.parts) {
            let node = &mut has[part.node as usize];
            node[0] |= !part.surface.triangles.is_empty();
            node[1] |= *verdict != Verdict::Hidden;
        }
        for (triangle, seen) in shown.iter().zip(seen) {
            has[model.parts[triangle.part as usize].node as usize][2] |= seen;
        }
        let count = |wanted: fn(&[bool; 3]) -> bool| has.iter().filter(|has| wanted(has)).count();
        Self {
            all: count(|has| has[0]),
            kept: count(|has| has[1]),
            kept_hidden: count(|has| has[1] && !has[2]),
        }
    }
}

/// A model, and what of it lacks in whatever was done to it.
struct Scene<'a> {
    shown: &'a [Shown],
    /// By triangle, a bit for each that was done in which it lacks.
    missing: &'a [u64],
    walls: &'a Walls<'a>,
    /// units: of the model
    extent: f64,
    /// By what was done, how wide what is guaranteed to be seen through is, if anything is. units: of the model
    gaps: Vec<Option<f64>>,
}

/// What all views together show.
struct Looked {
    /// By triangle.
    seen: Vec<bool>,
    pixels: u64,
    /// By what was done.
    missed: Vec<u64>,
    missed_in_gap: Vec<u64>,
    views_with: Vec<usize>,
    /// For each that was done, the view of the whole model that misses most.
    worst: Vec<Option<(u64, View)>>,
}

fn look(plan: &Plan, scene: &Scene, views: &[View], progress: &ProgressBar) -> Looked {
    let next = core::sync::atomic::AtomicUsize::new(0);
    let one = || {
        let count = scene.gaps.len();
        let mut looked = Looked {
            seen: vec![false; scene.shown.len()],
            pixels: 0,
            missed: vec![0; count],
            missed_in_gap: vec![0; count],
            views_with: vec![0; count],
            worst: vec![None; count],
        };
        loop {
            let at = next.fetch_add(1, core::sync::atomic::Ordering::Relaxed);
            let Some(view) = views.get(at) else {
                return looked;
            };
            progress.inc(1);
            looked.add(view, scene);
        }
    };
    let all: Vec<Looked> = std::thread::scope(|scope| {
        let others: Vec<_> = (1..plan.threads.get()).map(|_| scope.spawn(one)).collect();
        let mine = one();
        let others = others.into_iter().filter_map(|thread| thread.join().ok());
        core::iter::once(mine).chain(others).collect()
    });
    all.into_iter()
        .reduce(Looked::with)
        .expect("this thread looked")
}

impl Looked {
    fn add(&mut self, view: &View, scene: &Scene) {
        let picture = view.look(scene.shown, scene.missing, scene.extent, &mut self.seen);
        let mut missed = vec![0; scene.gaps.len()];
        for (at, bits) in picture.missed.iter().enumerate() {
            self.pixels += u64::from(picture.first[at] != u32::MAX);
            let mut bits = *bits;
            while bits != 0 {
                let way = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                missed[way] += 1;
                let is_in_gap = |gap| scene.is_seen_through(gap, way, view, at);
                self.missed_in_gap[way] += u64::from(scene.gaps[way].is_some_and(is_in_gap));
            }
        }
        for (way, missed) in missed.into_iter().enumerate() {
            self.missed[way] += missed;
            self.views_with[way] += usize::from(missed > 0);
            if !view.is_close && missed > self.worst[way].map_or(0, |(most, _)| most) {
                self.worst[way] = Some((missed, *view));
            }
        }
    }

    fn with(mut self, other: Self) -> Self {
        for (seen, other) in self.seen.iter_mut().zip(other.seen) {
            *seen |= other;
        }
        self.pixels += other.pixels;
        for way in 0..self.missed.len() {
            self.missed[way] += other.missed[way];
            self.missed_in_gap[way] += other.missed_in_gap[way];
            self.views_with[way] += other.views_with[way];
            let most = |worst: &Option<(u64, View)>| worst.map_or(0, |(most, _)| most);
            if most(&other.worst[way]) > most(&self.worst[way]) {
                self.worst[way] = other.worst[way];
            }
        }
        self
    }
}

impl Scene<'_> {
    /// Whether a pixel shows what lacks through an opening: any ball so wide, moved straight away from the eye around the
    /// pixel's ray, touches something that lacks.
    fn is_seen_through(&self, gap: f64, way: usize, view: &View, at: usize) -> bool {
        let lacks = |i: usize| self.missing[i] >> way & 1 == 1;
        view.balls(at, gap / 2.0, self.extent).any(|from| {
            self.walls
                .ball_touches(from, view.forward(), gap / 2.0, lacks)
        })
    }
}

/// What a question about each of so many has for an answer.
fn in_parallel(
    threads: NonZero<usize>,
    count: usize,
    answer: impl Fn(usize) -> bool + Sync,
) -> Vec<bool> {
    let mut answers = vec![false; count];
    let share = count.div_ceil(threads.get() * 16).max(1);
    let chunks: Vec<_> = answers.chunks_mut(share).enumerate().collect();
    let chunks = std::sync::Mutex::new(chunks.into_iter());
    let work = || {
        loop {
            let taken = chunks
                .lock()
                .unwrap_or_else(|poisoned| poisoned.into_inner())
                .next();
            let Some((number, chunk)) = taken else {
                return;
            };
            for (at, one) in chunk.iter_mut().enumerate() {
                *one = answer(number * share + at);
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..threads.get() {
            scope.spawn(work);
        }
        work();
    });
    answers
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use bevy::math::DAffine3;

    use super::{machine::cuboid, *};
    use crate::interior::{Part, Surface};

    /// What is missed of surfaces, the last of which is taken out, in any of 40 views; and that where a ball so wide
    /// touches it.
    fn missed(surfaces: Vec<Surface>, gap: f64) -> [u64; 2] {
        let parts = surfaces.into_iter().map(|surface| Part {
            node: 0,
            surface: Arc::new(surface),
            model_from_local: DAffine3::IDENTITY,
            is_transparent: false,
            is_two_sided: false,
        });
        let shown = views::shown(&Model {
            parts: parts.collect(),
        });
        let last = shown.last().expect("a triangle").part;
        let missing: Vec<_> = shown
            .iter()
            .map(|triangle| u64::from(triangle.part == last))
            .collect();
        let scene = Scene {
            shown: &shown,
            missing: &missing,
            walls: &Walls::new(&shown, 4.0),
            extent: 4.0,
            gaps: vec![Some(gap)],
        };
        let views = views::around((DVec3::NEG_ONE, DVec3::ONE), 40, 48);
        let plan = Plan::quick();
        let looked = look(&plan, &scene, &views, &ProgressBar::hidden());
        [looked.missed[0], looked.missed_in_gap[0]]
    }

    #[test]
    fn what_is_missed_in_the_gap_is_told_from_what_is_missed() {
        let core = || cuboid([-0.4; 3], [0.4; 3]);
        let hull = || cuboid([-1.0; 3], [1.0; 3]);
        // Alone it is missed wherever it shows, and any ball touches it.
        let [all, in_gap] = missed(vec![core()], 0.2);
        assert!(all > 1000 && in_gap == all, "{in_gap} of {all}");
        assert_eq!(missed(vec![hull(), core()], 0.2), [0, 0]);
        // Behind a grille it shows, and what is wider than its openings does not come to it.
        let bars = || (0..10).map(|i| 0.2 * i as f32 - 1.0);
        let grille = bars()
            .map(|x| cuboid([x, -1.0, 0.8], [x + 0.1, 1.0, 1.0]))
            .chain(bars().map(|x| cuboid([x, -1.0, -1.0], [x + 0.1, 1.0, -0.8])))
            .chain([
                cuboid([-1.0, 0.9, -1.0], [1.0, 1.0, 1.0]),
                cuboid([-1.0, -1.0, -1.0], [1.0, -0.9, 1.0]),
                cuboid([-1.0, -1.0, -1.0], [-0.9, 1.0, 1.0]),
                cuboid([0.9, -1.0, -1.0], [1.0, 1.0, 1.0]),
                core(),
            ]);
        let surfaces: Vec<_> = grille.collect();
        let [through, in_gap] = missed(surfaces.clone(), 0.12);
        assert!(through > 50, "{through}");
        assert_eq!(in_gap, 0);
        let [same, in_gap] = missed(surfaces, 0.08);
        assert_eq!(same, through);
        assert!(in_gap > 0);
    }
}
