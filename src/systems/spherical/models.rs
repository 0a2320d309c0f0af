//! What is known of the meshes that are indexed and of the entities that have them.

use core::any::TypeId;
use std::sync::Arc;

use bevy::{
    asset::RenderAssetUsages, camera::visibility::VisibleEntities, ecs::entity::EntityIndexMap,
    prelude::*, render::render_resource::Face,
};

use super::work::{Made, Source, Work};
use crate::{
    render_graph::mesh_uploads::{Asker, MeshUploads},
    spherical::{Bins, SphericalChunks, SphericalIndex, SphericalMaps, SphericalMode},
    systems::{
        gather::Gather,
        slice::Slice,
        submesh::{Making, SubMesh, bytes},
    },
};

/// No more is handed to the renderer in a frame, unless it is one mesh. units: bytes
const MOST_HANDED: u64 = 1 << 19;

/// The meshes that are indexed, and the entities that ask for it. Empty when there is none.
#[derive(Resource, Default)]
pub struct SphericalModels {
    /// In the order in which they were asked for.
    pub(super) indices: Vec<(Key, Step)>,
    /// In the order in which they came.
    pub(super) roots: EntityIndexMap<Root>,
    /// Every chunk there is, sorted by entity.
    pub(super) chunks: Vec<Record>,
    pub(super) uploads: MeshUploads,
    /// Time spent in this frame in slices. units: ms
    pub(super) making_ms: f32,
    /// Time spent in this frame on selecting, over all cameras. units: ms
    pub(super) selecting_ms: f32,
}

/// A mesh, and how it is indexed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Key {
    pub mesh: AssetId<Mesh>,
    pub bins: Bins,
    pub chunk_triangles: u32,
    /// What P3's rules look up is kept.
    pub is_paper: bool,
}

impl Key {
    pub fn of(mesh: AssetId<Mesh>, settings: &SphericalIndex) -> Self {
        Self {
            mesh,
            bins: settings.bins,
            chunk_triangles: settings.chunk_triangles.max(1),
            is_paper: settings.mode == SphericalMode::Paper,
        }
    }
}

/// How far the index of a mesh is.
pub(super) enum Step {
    /// Its mesh was edited: work begins once it has been left alone for so many frames more.
    Still(u32),
    /// Its triangles are copied.
    Gather(Gather),
    /// The background works.
    Work(Work),
    /// Chunks' meshes are made and come to the GPU.
    Build(Box<Build>),
    Ready(Arc<Indexed>),
    /// Why, in words.
    Failed(String),
}

/// The chunks' meshes, so far.
pub(super) struct Build {
    maps: SphericalMaps,
    chunks: SphericalChunks,
    source: Option<Source>,
    /// To be made, the last first.
    todo: Vec<SubMesh>,
    current: Option<Making>,
    meshes: Vec<Handle<Mesh>>,
    waiting: Vec<AssetId<Mesh>>,
    /// Of the meshes, on the GPU.
    pub(super) bytes: u64,
}

/// A mesh and its index.
pub struct Indexed {
    pub maps: SphericalMaps,
    pub chunks: SphericalChunks,
    /// What P3's rules look up, where they are asked for.
    pub(super) source: Option<Source>,
    /// By chunk.
    pub(super) meshes: Vec<Handle<Mesh>>,
    /// Of the chunks' meshes on the GPU.
    pub gpu_bytes: u64,
}

/// What a camera draws of a mesh, by direction from the mesh's middle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ViewedBins {
    /// How many there are.
    pub size: Bins,
    /// Whether any triangle of a bin is drawn, row by row; `None` of a bin that has none.
    pub bins: Vec<Option<bool>>,
}

/// An entity that asks to be drawn by chunks.
pub(super) struct Root {
    pub settings: SphericalIndex,
    pub mesh: AssetId<Mesh>,
    /// How its material is drawn; `None`: it has none that is known.
    pub look: Option<Look>,
    /// Of which kind that is.
    pub look_of: Option<TypeId>,
    /// Why it is drawn whole for good.
    pub left: Option<Left>,
    /// Its chunks, by number; none until they are spawned.
    pub chunks: Vec<Entity>,
    pub indexed: Option<Arc<Indexed>>,
    /// It is to be looked at again.
    pub is_stale: bool,
    /// Its mesh is another under the same name.
    pub is_reset: bool,
    /// Its mesh is not there yet.
    pub is_loading: bool,
    /// Something that its chunks have of it has changed.
    pub is_repainted: bool,
    /// Drawn in the last frame, all cameras together.
    pub drawn: Drawn,
}

/// What was drawn of an entity in a frame, all cameras together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Drawn {
    /// Cameras that have it in view.
    pub views: u32,
    /// Of these, those that draw it by chunks.
    pub by_chunks: u32,
    pub chunks: u32,
    pub triangles: u64,
}

/// What matters of a material.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Look {
    /// The side that is not drawn.
    pub cull: Option<Face>,
    /// Drawn in an order that chunks would change.
    pub is_sorted: bool,
}

/// Why an entity is drawn whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Left {
    /// Skins and morph targets move vertices.
    Deforms,
    /// It has no material that has been announced.
    OtherMaterial,
    /// Blended or transmitting.
    Sorted,
    /// It fades with its distance.
    Ranged,
    /// Its triangles cannot be read.
    RenderWorldOnly,
    /// Lines, points, strips.
    NotTriangles,
    /// It has no more triangles than one chunk.
    Small,
    /// It cannot be indexed.
    Failed,
}

impl Left {
    pub const COUNT: usize = 8;
    /// What there are so many meshes of.
    pub const WORDS: [&str; Self::COUNT] = [
        "skinned or morphing",
        "with a material that register_spherical_material has not announced",
        "with a blended or transmitting material",
        "with a VisibilityRange",
        "in the render world only: load them with RenderAssetUsages::MAIN_WORLD too",
        "not of triangle lists",
        "of no more triangles than a chunk",
        "that cannot be indexed",
    ];
}

/// A chunk, in the table of all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Record {
    pub entity: Entity,
    /// Index of its root.
    pub root: u32,
    pub number: u32,
}

impl Indexed {
    /// Of the mesh.
    pub(super) fn triangles(&self) -> u32 {
        self.maps.order.len() as u32
    }
}

impl Root {
    pub fn new(settings: SphericalIndex) -> Self {
        Self {
            settings,
            mesh: AssetId::default(),
            look: None,
            look_of: None,
            left: None,
            chunks: Vec::new(),
            indexed: None,
            is_stale: true,
            is_reset: false,
            is_loading: false,
            is_repainted: false,
            drawn: Drawn::default(),
        }
    }

    /// By chunk, whether a camera with these visible entities draws it, by itself or with the whole.
    fn drawn_in(&self, entity: Entity, visible: &VisibleEntities) -> Vec<bool> {
        let list = visible.get(TypeId::of::<Mesh3d>());
        let is_whole = list.binary_search(&entity).is_ok();
        let chunks = self.chunks.iter();
        chunks
            .map(|chunk| is_whole || list.binary_search(chunk).is_ok())
            .collect()
    }

    /// Its index, once all its chunks are there.
    pub fn ready(&self) -> Option<&Indexed> {
        let indexed = self.indexed.as_deref()?;
        let is_whole = self.left.is_some() || self.is_repainted;
        (self.chunks.len() == indexed.meshes.len() && !is_whole).then_some(indexed)
    }

    /// Whether its index is not worth keeping: what fades comes back.
    pub fn is_left_for_good(&self) -> bool {
        !matches!(self.left, None | Some(Left::Ranged | Left::Failed))
    }
}

impl SphericalModels {
    /// Whether it holds nothing and has nothing to do.
    pub fn is_empty(&self) -> bool {
        self.roots.is_empty() && self.indices.is_empty()
    }

    /// Meshes whose index is held.
    pub fn indexed_meshes(&self) -> usize {
        self.indices.len()
    }

    /// What a camera draws of an entity's mesh, by direction; `None` if the mesh is not indexed.
    pub fn viewed_bins(&self, entity: Entity, visible: &VisibleEntities) -> Option<ViewedBins> {
        let root = self.roots.get(&entity)?;
        let indexed = root.ready()?;
        let maps = &indexed.maps;
        let drawn = root.drawn_in(entity, visible);
        let chunk_of = |place: u32| maps.cuts.partition_point(|cut| *cut <= place) - 1;
        let any = |first: u32, count: u32| {
            count > 0 && (chunk_of(first)..=chunk_of(first + count - 1)).any(|chunk| drawn[chunk])
        };
        Some(ViewedBins {
            size: maps.settings.bins,
            bins: maps
                .memory
                .iter()
                .map(|bin| {
                    (bin.outward_count + bin.inward_count > 0).then(|| {
                        any(bin.outward, bin.outward_count) || any(bin.inward, bin.inward_count)
                    })
                })
                .collect(),
        })
    }

    /// The triangles that a camera draws of an entity's mesh, by their numbers in it; `None` if it is not indexed.
    pub fn drawn_triangles(
        &self,
        entity: Entity,
        visible: &VisibleEntities,
    ) -> Option<impl Iterator<Item = u32> + '_> {
        let root = self.roots.get(&entity)?;
        let indexed = root.ready()?;
        let drawn = root.drawn_in(entity, visible).into_iter();
        let chunks = indexed.chunks.chunks().iter().zip(drawn);
        Some(chunks.filter(|(_, drawn)| *drawn).flat_map(|(chunk, _)| {
            let run = chunk.triangles.start as usize..chunk.triangles.end as usize;
            indexed.maps.order[run].iter().copied()
        }))
    }

    /// What an entity is a chunk of.
    pub(super) fn root_of(&mut self, chunk: Entity) -> Option<&mut Root> {
        let at = self
            .chunks
            .binary_search_by_key(&chunk, |record| record.entity);
        let root = self.chunks.get(at.ok()?)?.root;
        let (_, root) = self.roots.get_index_mut(root as usize)?;
        Some(root)
    }

    /// Puts every chunk into the table.
    pub(super) fn tabulate(&mut self) {
        self.chunks.clear();
        for (root, (_, of)) in (0..).zip(&self.roots) {
            let records = (0..).zip(&of.chunks).map(|(number, entity)| Record {
                entity: *entity,
                root,
                number,
            });
            self.chunks.extend(records);
        }
        self.chunks.sort_unstable();
    }

    /// Lets go of the indices that nobody asks for any more.
    pub(super) fn sweep(&mut self) {
        let roots = &self.roots;
        self.indices.retain(|(key, _)| {
            roots
                .values()
                .any(|root| !root.is_left_for_good() && Key::of(root.mesh, &root.settings) == *key)
        });
        let is_building = |(_, step): &(Key, Step)| matches!(step, Step::Build(_));
        if !self.indices.iter().any(is_building) {
            self.uploads.clear(Asker::Spherical);
        }
        if self.roots.is_empty() {
            // Nothing is held any more, not even memory for more.
            *self = Self {
                uploads: self.uploads.clone(),
                ..default()
            };
        }
    }
}

/// Takes the index that is being made a step further: one at a time, and no longer than a slice.
pub fn advance_indices(mut models: ResMut<SphericalModels>, mut meshes: ResMut<Assets<Mesh>>) {
    let slice = Slice::begin();
    let models = &mut *models;
    let is_made = |step: &Step| matches!(step, Step::Ready(_) | Step::Failed(_));
    for (key, step) in &mut models.indices {
        if let Step::Still(frames) = step {
            if *frames > 0 {
                *frames -= 1;
                continue;
            }
            *step = Step::Gather(Gather::default());
        }
        while !is_made(step) && !slice.is_over() {
            let next = match core::mem::replace(step, Step::Failed(String::new())) {
                Step::Gather(mut gather) => match gather.run(&[key.mesh], &meshes, &slice) {
                    Ok(false) => Step::Gather(gather),
                    Ok(true) => begin_work(gather, key),
                    Err(_) => Step::Failed("its mesh is gone".to_owned()),
                },
                Step::Work(mut work) => match work.poll() {
                    None => {
                        *step = Step::Work(work);
                        break;
                    }
                    Some(Ok(made)) => Step::Build(Box::new(Build::new(made))),
                    Some(Err(why)) => Step::Failed(why),
                },
                Step::Build(mut build) => {
                    if build.run(key.mesh, &mut meshes, &models.uploads, &slice) {
                        Step::Ready(Arc::new(build.finish()))
                    } else {
                        *step = Step::Build(build);
                        break;
                    }
                }
                made => made,
            };
            *step = next;
        }
        if !is_made(step) {
            break;
        }
    }
    models.making_ms = slice.spent_ms();
}

fn begin_work(gather: Gather, key: &Key) -> Step {
    match gather.finish().pop().map(|raw| Work::begin(raw, key)) {
        Some(Ok(work)) => Step::Work(work),
        Some(Err(why)) => Step::Failed(why),
        None => Step::Failed("its mesh is gone".to_owned()),
    }
}

impl Build {
    fn new(made: Made) -> Self {
        let Made {
            maps,
            chunks,
            source,
            mut subs,
        } = made;
        subs.reverse();
        Self {
            maps,
            chunks,
            source,
            meshes: Vec::with_capacity(subs.len()),
            todo: subs,
            current: None,
            waiting: Vec::new(),
            bytes: 0,
        }
    }

    /// Chunks' meshes that are made, of how many.
    pub fn made(&self) -> [usize; 2] {
        [self.meshes.len(), self.chunks.chunks().len()]
    }

    /// Goes on until the slice is over. Whether all is made and has come to the GPU.
    fn run(
        &mut self,
        mesh: AssetId<Mesh>,
        meshes: &mut Assets<Mesh>,
        uploads: &MeshUploads,
        slice: &Slice,
    ) -> bool {
        let mut handed = 0;
        while handed < MOST_HANDED && !slice.is_over() {
            let Some(source) = meshes.get(mesh) else {
                // That is heard of, and ends this.
                return false;
            };
            let Some(mut making) = self
                .current
                .take()
                .or_else(|| Making::begin(self.todo.pop()?, source))
            else {
                break;
            };
            if !making.copy(source) {
                self.current = Some(making);
                continue;
            }
            let made = making.finish(source);
            let size = bytes(&made);
            let is_drawn = made.asset_usage.contains(RenderAssetUsages::RENDER_WORLD);
            let handle = meshes.add(made);
            if is_drawn && uploads.ask(Asker::Spherical, handle.id()) {
                self.waiting.push(handle.id());
            }
            self.meshes.push(handle);
            handed += size;
            self.bytes += size;
        }
        uploads.retain_waiting(&mut self.waiting);
        self.todo.is_empty() && self.current.is_none() && self.waiting.is_empty()
    }

    fn finish(self) -> Indexed {
        Indexed {
            maps: self.maps,
            chunks: self.chunks,
            source: self.source,
            meshes: self.meshes,
            gpu_bytes: self.bytes,
        }
    }
}
