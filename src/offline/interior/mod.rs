//! Interior culling of a model's file: `skyline interior`.
//!
//! The JSON of a glTF stays JSON from one end to the other, so that what is not known here survives. The reading order
//! is the data path:
//!
//! | File | What |
//! |---|---|
//! | `container.rs`, `uri.rs` | a `.glb`, or a `.gltf` with what lies beside or within it |
//! | `json.rs`, `extensions.rs` | the table of all references in it, and what is known about its extensions |
//! | `accessor.rs` | its numbers, checked once |
//! | `scene.rs` | where nodes stand, and which may move |
//! | `read.rs` | to the [`Model`] that is culled |
//! | `edit.rs`, `fresh.rs` | what is hidden taken out of nodes and meshes; their vertices and indices written anew |
//! | `sweep.rs`, `pack.rs` | what nothing uses any more taken out, and the rest packed |
//! | `images.rs`, `save.rs` | pictures that lay beside it, and the file that is written |
//! | `error.rs` | why it fails |

mod accessor;
mod container;
mod edit;
mod error;
mod extensions;
mod fresh;
mod images;
mod json;
mod pack;
mod read;
mod save;
mod scene;
mod sweep;
mod uri;

use std::{
    num::NonZero,
    path::Path,
    sync::mpsc::{RecvTimeoutError, sync_channel},
    time::{Duration, Instant},
};

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

pub use self::error::{ModelFileError, TrimError};
use self::{accessor::Numbers, container::Container, error::Budget, fresh::Fresh, read::Reading};
use crate::interior::{
    InteriorCulling, InteriorError, InteriorLevel, InteriorMode, Model, Outcome, Part, Progress,
    Stage, cull, lattice::SPACINGS_IN_CELL,
};
use crate::one_line::one_line;

/// How often the bar is brought up to date.
const BAR_PERIOD: Duration = Duration::from_millis(100);

/// What was taken out of a model's file, and what it took.
#[derive(Serialize, Clone, Debug)]
pub struct TrimFigures {
    /// Nodes with triangles that stand still in the scene; the others stay as they are.
    pub nodes: usize,
    /// Triangles that these draw; those of a mesh that several nodes draw count for each.
    pub triangles: usize,
    /// Nodes of these of which something is seen.
    pub kept_nodes: usize,
    /// Triangles that are still drawn by them: what is seen, and what is seen of the same mesh at another node.
    pub kept_triangles: usize,
    /// Nodes that are hidden.
    pub removed_nodes: usize,
    /// Triangles that are no longer drawn.
    pub removed_triangles: usize,
    /// Triangles that are seen themselves.
    pub seen_triangles: usize,
    /// Nodes with triangles that stay as they are since they may move: animated, skinned, morphed, instanced,
    /// switched, with unknown extensions, or below such a node.
    pub kept_moving: usize,
    /// What was taken out: nodes or triangles.
    pub level: &'static str,
    /// Which surfaces counted as seen.
    pub mode: &'static str,
    /// What is seen through openings this wide stays. units: of the model's scene
    pub gap: f64,
    /// Cells on the model's longest side.
    pub resolution: u32,
    /// Side of a cell. units: of the model's scene
    pub cell: f64,
    /// Points of the lattice along x, y and z.
    pub lattice: [u32; 3],
    /// All its points.
    pub lattice_points: u64,
    /// Those that are outside.
    pub outside_points: u64,
    /// Threads that it was found with.
    pub threads: usize,
    /// Of the model, with the files it names. units: bytes
    pub bytes_before: u64,
    /// Of what was written. units: bytes
    pub bytes_after: u64,
    /// How long each stage took.
    pub seconds: TrimSeconds,
}

/// How long the stages took. units: s
#[derive(Serialize, Clone, Copy, Debug)]
pub struct TrimSeconds {
    /// Reading and decoding the model.
    pub read: f64,
    /// Snapping vertices to the lattice.
    pub snapping: f64,
    /// The directed distance field.
    pub field: f64,
    /// Front propagation.
    pub front: f64,
    /// Extraction.
    pub extraction: f64,
    /// Trimming the model and writing it.
    pub write: f64,
}

/// What was done to a model's file.
#[derive(Clone, Debug)]
pub struct Trimmed {
    /// Figures.
    pub figures: TrimFigures,
    /// What a user should know, a line each.
    pub notes: Vec<String>,
}

/// Reads a model, takes out what cannot be seen from outside, and writes what is left; the two files may be the same.
///
/// # Errors
/// [`TrimError`]; nothing was written then, and what was there is as it was.
///
/// # Limits
/// Only what stands still in the default scene, or in the first if there is no default, is judged; what may move
/// neither goes nor hides anything. Of scenes apart from that, everything stays.
pub fn trim(
    input: &Path,
    out: &Path,
    settings: &InteriorCulling,
    threads: NonZero<usize>,
) -> Result<Trimmed, TrimError> {
    let to = save::destination(out)?;
    let wrong = TrimError::input(input);
    let bar = bar();
    let start = Instant::now();
    let mut budget = Budget::new(settings.memory_mib);
    bar.set_message("reading");
    let mut container = Container::read(input).map_err(&wrong)?;
    extensions::check(&container.json).map_err(&wrong)?;
    let numbers = Numbers::new(&container.json, &container.buffers).map_err(&wrong)?;
    let reading = read::read(&container.json, &numbers, &mut budget).map_err(&wrong)?;
    let read_s = start.elapsed().as_secs_f64();

    let outcome = watch(&reading.model, settings, threads, &bar)
        .map_err(|error| wrong(explain(error, &reading)))?;

    let start = Instant::now();
    bar.set_message("writing");
    let json = &mut container.json;
    let mut fresh = Fresh::after(numbers.views.len());
    let (left, beside_bytes) = images::take_along(json, input, &to, &mut fresh);
    let edited = edit::edit(
        json,
        &numbers,
        &reading,
        &outcome.parts,
        &mut fresh,
        &mut budget,
    )
    .map_err(&wrong)?;
    let bytes_before = container.bytes + beside_bytes;
    let most = bytes_before + fresh.bytes() + (u64::from(settings.memory_mib) << 20);
    let bin = sweep::sweep(json, &numbers, &edited.hidden, &mut fresh, most)
        .and_then(|bin| bin.ok_or_else(|| budget.exceeded()))
        .map_err(&wrong)?;
    let bytes_after = save::save(json, &bin, input, &to, &container.beside)?;
    let write_s = start.elapsed().as_secs_f64();
    bar.finish_and_clear();

    let took = |stage: Stage| outcome.took(stage).as_secs_f64();
    let lattice = &outcome.lattice;
    let triangles = reading.model.triangle_count();
    let cell = lattice.spacing * SPACINGS_IN_CELL;
    let parts = reading.model.parts.iter().zip(&outcome.parts);
    let figures = TrimFigures {
        nodes: edited.nodes,
        triangles,
        kept_nodes: edited.nodes - edited.hidden.len(),
        kept_triangles: edited.kept_triangles,
        removed_nodes: edited.hidden.len(),
        removed_triangles: triangles - edited.kept_triangles,
        seen_triangles: parts
            .map(|(part, verdict)| verdict.count(part.surface.triangles.len()))
            .sum(),
        kept_moving: reading.moving.values().sum(),
        level: level_name(settings.level),
        mode: mode_name(settings.mode),
        gap: lattice.gap(),
        resolution: (reading.longest / cell).round().max(1.0) as u32,
        cell,
        lattice: lattice.size,
        lattice_points: lattice.points(),
        outside_points: outcome.outside_points,
        threads: threads.get(),
        bytes_before,
        bytes_after,
        seconds: TrimSeconds {
            read: read_s,
            snapping: took(Stage::Snapping),
            field: took(Stage::Field),
            front: took(Stage::Front),
            extraction: took(Stage::Extraction),
            write: write_s,
        },
    };
    Ok(Trimmed {
        figures,
        notes: notes(&reading, &left),
    })
}

/// The model that a file holds, as [`trim`] judges it.
///
/// # Errors
/// [`TrimError::Input`].
pub fn read_model(path: &Path, memory_mib: u32) -> Result<Model, TrimError> {
    let wrong = TrimError::input(path);
    let container = Container::read(path).map_err(&wrong)?;
    extensions::check(&container.json).map_err(&wrong)?;
    let numbers = Numbers::new(&container.json, &container.buffers).map_err(&wrong)?;
    let mut budget = Budget::new(memory_mib);
    let reading = read::read(&container.json, &numbers, &mut budget).map_err(&wrong)?;
    Ok(reading.model)
}

/// A part of a model where it stands in its scene, and what it is painted with.
pub(super) struct PaintedPart {
    /// The surface, in the scene's frame.
    pub part: Part,
    /// Its material, and that material's colour: linear red, green and blue. range: 0..=1
    pub material: Option<usize>,
    /// See [`material`](Self::material).
    pub colour: [f32; 3],
}

/// Every part that stands still, nodes in their order.
///
/// # Errors
/// [`ModelFileError`].
pub(super) fn read_painted(
    path: &Path,
    memory_mib: u32,
) -> Result<Vec<PaintedPart>, ModelFileError> {
    let Container { json, buffers, .. } = Container::read(path)?;
    extensions::check(&json)?;
    let numbers = Numbers::new(&json, &buffers)?;
    let reading = read::read(&json, &numbers, &mut Budget::new(memory_mib))?;
    let (parts, sites) = (reading.model.parts, reading.sites);
    let painted = parts.into_iter().zip(sites).map(|(mut part, site)| {
        part.model_from_local.translation += reading.middle;
        let material = read::material(&json, site);
        PaintedPart {
            part,
            material,
            colour: read::colour(&json, material),
        }
    });
    Ok(painted.collect())
}

/// Name of a level as a flag's value.
pub fn level_name(level: InteriorLevel) -> &'static str {
    match level {
        InteriorLevel::Node => "node",
        InteriorLevel::Triangle => "triangle",
    }
}

/// Name of a mode as a flag's value.
pub fn mode_name(mode: InteriorMode) -> &'static str {
    match mode {
        InteriorMode::Sampled => "sampled",
        InteriorMode::Conservative => "conservative",
    }
}

/// Culls on other threads, and shows how far that is.
fn watch(
    model: &Model,
    settings: &InteriorCulling,
    threads: NonZero<usize>,
    bar: &ProgressBar,
) -> Result<Outcome, InteriorError> {
    let progress = Progress::default();
    std::thread::scope(|scope| {
        let (done, is_done) = sync_channel(1);
        let progress = &progress;
        let worker = scope.spawn(move || {
            let outcome = cull(model, settings, threads, progress);
            // Whether anybody still waits does not matter.
            let _ = done.send(());
            outcome
        });
        while let Err(RecvTimeoutError::Timeout) = is_done.recv_timeout(BAR_PERIOD) {
            let (stage, share) = progress.now();
            bar.set_message(stage.name());
            bar.set_position((share * 100.0) as u64);
        }
        match worker.join() {
            Ok(outcome) => outcome,
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

/// A bar on standard error; none where that is no terminal.
fn bar() -> ProgressBar {
    let bar = ProgressBar::new(100);
    let style = ProgressStyle::with_template("{msg:>17} {wide_bar} {percent:>3} % {elapsed}");
    if let Ok(style) = style {
        bar.set_style(style);
    }
    bar
}

/// Why nothing was culled, where the reader knows more.
fn explain(error: InteriorError, reading: &Reading) -> ModelFileError {
    match error {
        InteriorError::NoTriangles if !reading.moving.is_empty() => {
            ModelFileError::AllMove(reasons(reading))
        }
        error => error.into(),
    }
}

/// How many nodes may move, by why.
fn reasons(reading: &Reading) -> String {
    let each = reading.moving.iter();
    let each: Vec<_> = each
        .map(|(why, nodes)| format!("{nodes} {}", why.name()))
        .collect();
    each.join(", ")
}

fn notes(reading: &Reading, left: &[String]) -> Vec<String> {
    let mut notes = Vec::new();
    if !reading.moving.is_empty() {
        notes.push(format!(
            "nodes that may move stay as they are, and hide nothing: {}",
            reasons(reading)
        ));
    }
    let elsewhere = reading.is_shown_elsewhere.iter().filter(|shown| **shown);
    let elsewhere = elsewhere.count();
    if elsewhere > 0 {
        notes.push(format!(
            "{elsewhere} nodes of other scenes stay as they are"
        ));
    }
    if let Some(uri) = left.first() {
        notes.push(format!(
            "{} pictures could not be taken along, {} for one; copy them to where the model is now",
            left.len(),
            one_line(uri)
        ));
    }
    notes
}
