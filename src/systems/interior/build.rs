//! Makes trimmed meshes: the attributes of the vertices that stay, some of them a frame.

use std::{collections::VecDeque, sync::Arc};

use bevy::{
    asset::RenderAssetUsages,
    mesh::{MeshVertexAttribute, VertexAttributeValues},
    prelude::*,
};

use super::{
    models::Job,
    slice::Slice,
    store::{Store, Trimmed},
    work::Trim,
};
use crate::render_graph::trimmed::MeshUploads;

/// So many vertices are copied before the clock is looked at.
const BATCH: usize = 8192;
/// No more is handed to the renderer in a frame, unless it is one mesh: it copies and packs what it is given in the
/// frame in which it is given it. units: bytes
const MOST_HANDED: u64 = 1 << 19;

/// How far the making has come.
#[derive(Default)]
pub(super) struct Build {
    todo: VecDeque<Trim>,
    of: usize,
    current: Option<Making>,
    /// On their way to the GPU.
    pub waiting: Vec<AssetId<Mesh>>,
}

struct Making {
    trim: Trim,
    attributes: Vec<(MeshVertexAttribute, VertexAttributeValues)>,
    /// The attribute that is being copied, and how many vertices of it are there.
    which: usize,
    copied: usize,
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
            let Some(making) = &mut self.current else {
                let Some(trim) = self.todo.pop_front() else {
                    return true;
                };
                let source = job.meshes.get(trim.mesh as usize);
                let source = source.and_then(|id| meshes.get(*id));
                self.current = source.and_then(|source| Making::begin(trim, source));
                continue;
            };
            let id = job.meshes[making.trim.mesh as usize];
            let Some(source) = meshes.get(id) else {
                self.current = None;
                continue;
            };
            if !making.copy(source) {
                continue;
            }
            let Some(making) = self.current.take() else {
                continue;
            };
            let (mesh, mask) = (making.trim.mesh as usize, making.trim.mask.clone());
            let trimmed = making.finish(source);
            let bytes = bytes(&trimmed);
            let is_drawn = trimmed
                .asset_usage
                .contains(RenderAssetUsages::RENDER_WORLD);
            let handle = meshes.add(trimmed);
            if is_drawn && uploads.ask(handle.id()) {
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

fn bytes(mesh: &Mesh) -> u64 {
    let indices = mesh
        .try_indices_option()
        .ok()
        .flatten()
        .map_or(0, |indices| match indices {
            bevy::mesh::Indices::U16(all) => 2 * all.len(),
            bevy::mesh::Indices::U32(all) => 4 * all.len(),
        });
    (mesh.get_vertex_buffer_size() + indices) as u64
}

impl Making {
    fn begin(trim: Trim, source: &Mesh) -> Option<Self> {
        let attributes = source.try_attributes().ok()?;
        Some(Self {
            attributes: attributes
                .map(|(attribute, values)| (*attribute, empty(values, trim.vertices.len())))
                .collect(),
            trim,
            which: 0,
            copied: 0,
        })
    }

    /// Copies a batch. Whether that was the last.
    fn copy(&mut self, source: &Mesh) -> bool {
        let Some((attribute, to)) = self.attributes.get_mut(self.which) else {
            return true;
        };
        let end = self.trim.vertices.len().min(self.copied + BATCH);
        let batch = &self.trim.vertices[self.copied..end];
        if let Ok(Some(from)) = source.try_attribute_option(attribute.id) {
            extend(to, from, batch);
        }
        self.copied = end;
        if end == self.trim.vertices.len() {
            self.which += 1;
            self.copied = 0;
        }
        self.which == self.attributes.len()
    }

    /// The same as the mesh that it comes from, but for what is hidden of it.
    fn finish(self, source: &Mesh) -> Mesh {
        let mut mesh = Mesh::new(source.primitive_topology(), source.asset_usage);
        mesh.enable_raytracing = source.enable_raytracing;
        // Else Bevy goes through all positions to find it.
        mesh.final_aabb = self.trim.bounds;
        for (attribute, values) in self.attributes {
            mesh.insert_attribute(attribute, values);
        }
        if let Some(indices) = self.trim.indices {
            mesh.insert_indices(indices);
        }
        mesh
    }
}

macro_rules! formats {
    ($($format:ident)*) => {
        /// Values of the same format, none so far.
        fn empty(like: &VertexAttributeValues, capacity: usize) -> VertexAttributeValues {
            match like {
                $(VertexAttributeValues::$format(_) => {
                    VertexAttributeValues::$format(Vec::with_capacity(capacity))
                })*
            }
        }

        /// Appends the values of some vertices.
        fn extend(to: &mut VertexAttributeValues, from: &VertexAttributeValues, vertices: &[u32]) {
            match (to, from) {
                $((VertexAttributeValues::$format(to), VertexAttributeValues::$format(from)) => {
                    to.extend(vertices.iter().filter_map(|vertex| from.get(*vertex as usize)));
                })*
                // An edit would have been heard of.
                _ => {}
            }
        }
    };
}

formats! {
    Uint8 Uint8x2 Uint8x4 Sint8 Sint8x2 Sint8x4 Unorm8 Unorm8x2 Unorm8x4 Snorm8 Snorm8x2 Snorm8x4
    Uint16 Uint16x2 Uint16x4 Sint16 Sint16x2 Sint16x4 Unorm16 Unorm16x2 Unorm16x4 Snorm16 Snorm16x2 Snorm16x4
    Float16 Float16x2 Float16x4 Float32 Float32x2 Float32x3 Float32x4
    Uint32 Uint32x2 Uint32x3 Uint32x4 Sint32 Sint32x2 Sint32x3 Sint32x4
    Float64 Float64x2 Float64x3 Float64x4 Unorm8x4Bgra Unorm10_10_10_2
}
