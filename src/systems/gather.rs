//! Copies the triangles of meshes for the background, some of them a frame.

use bevy::{
    asset::RenderAssetUsages,
    mesh::{Indices, MeshAccessError, PrimitiveTopology, VertexAttributeValues},
    prelude::*,
};

use super::slice::Slice;

/// Why a mesh's triangles cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unreadable {
    /// They are in the render world, or may go there at any time.
    RenderWorldOnly,
    /// Morph targets move its vertices.
    Morphs,
    /// Lines, points, no positions, attributes of different lengths.
    NotTriangles,
}

/// The positions of a mesh of triangles, in a list or in strips, that can be read and will be.
///
/// # Errors
/// [`Unreadable`].
pub fn readable(mesh: &Mesh) -> Result<&[[f32; 3]], Unreadable> {
    if !mesh.asset_usage.contains(RenderAssetUsages::MAIN_WORLD) {
        return Err(Unreadable::RenderWorldOnly);
    }
    let gone = |_: MeshAccessError| Unreadable::RenderWorldOnly;
    if mesh.try_has_morph_targets().map_err(gone)? {
        return Err(Unreadable::Morphs);
    }
    if !matches!(
        mesh.primitive_topology(),
        PrimitiveTopology::TriangleList | PrimitiveTopology::TriangleStrip
    ) {
        return Err(Unreadable::NotTriangles);
    }
    let Some(VertexAttributeValues::Float32x3(positions)) = mesh
        .try_attribute_option(Mesh::ATTRIBUTE_POSITION)
        .map_err(gone)?
    else {
        return Err(Unreadable::NotTriangles);
    };
    let mut attributes = mesh.try_attributes().map_err(gone)?;
    if attributes.any(|(_, values)| values.len() != positions.len()) {
        return Err(Unreadable::NotTriangles);
    }
    Ok(positions)
}

/// So many elements are copied before the clock is looked at.
const BATCH: usize = 16_384;

/// How far the copying has come.
#[derive(Default)]
pub struct Gather {
    raws: Vec<Raw>,
    /// Of the last.
    is_done: bool,
}

/// A mesh's triangles as they lie in it.
pub struct Raw {
    pub topology: PrimitiveTopology,
    pub positions: Vec<[f32; 3]>,
    /// `None`: one vertex after another.
    pub indices: Option<Indices>,
}

impl Gather {
    /// How far it is, from 0 to 1.
    pub fn done(&self, meshes: &[AssetId<Mesh>]) -> f32 {
        self.raws.len() as f32 / meshes.len().max(1) as f32
    }

    /// Goes on until the slice is over. Whether it has come to the end.
    ///
    /// # Errors
    /// The number of a mesh that cannot be read any more.
    pub fn run(
        &mut self,
        ids: &[AssetId<Mesh>],
        meshes: &Assets<Mesh>,
        slice: &Slice,
    ) -> Result<bool, usize> {
        loop {
            if self.raws.is_empty() || self.is_done {
                let Some(id) = ids.get(self.raws.len()) else {
                    return Ok(true);
                };
                let source = meshes.get(*id).and_then(Source::of);
                let source = source.ok_or(self.raws.len())?;
                self.raws.push(source.begin());
                self.is_done = false;
            }
            let at = self.raws.len() - 1;
            let source = ids.get(at).and_then(|id| Source::of(meshes.get(*id)?));
            let (Some(source), Some(raw)) = (source, self.raws.last_mut()) else {
                return Err(at);
            };
            self.is_done = source.copy(raw);
            if slice.is_over() {
                return Ok(self.is_done && self.raws.len() == ids.len());
            }
        }
    }

    pub fn finish(self) -> Vec<Raw> {
        self.raws
    }
}

/// What is copied.
struct Source<'a> {
    topology: PrimitiveTopology,
    positions: &'a [[f32; 3]],
    indices: Option<&'a Indices>,
}

impl<'a> Source<'a> {
    fn of(mesh: &'a Mesh) -> Option<Self> {
        let positions = match mesh.try_attribute_option(Mesh::ATTRIBUTE_POSITION) {
            Ok(Some(VertexAttributeValues::Float32x3(positions))) => positions,
            _ => return None,
        };
        Some(Self {
            topology: mesh.primitive_topology(),
            positions,
            indices: mesh.try_indices_option().ok()?,
        })
    }

    fn begin(&self) -> Raw {
        Raw {
            topology: self.topology,
            positions: Vec::with_capacity(self.positions.len()),
            indices: self.indices.map(|indices| match indices {
                Indices::U16(all) => Indices::U16(Vec::with_capacity(all.len())),
                Indices::U32(all) => Indices::U32(Vec::with_capacity(all.len())),
            }),
        }
    }

    /// Copies a batch. Whether that was the last.
    fn copy(&self, raw: &mut Raw) -> bool {
        if more(&mut raw.positions, self.positions) {
            return false;
        }
        match (&mut raw.indices, self.indices) {
            (Some(Indices::U16(to)), Some(Indices::U16(from))) => !more(to, from),
            (Some(Indices::U32(to)), Some(Indices::U32(from))) => !more(to, from),
            _ => true,
        }
    }
}

/// Copies a batch, if there is one left. Whether there is more.
fn more<T: Copy>(to: &mut Vec<T>, from: &[T]) -> bool {
    let end = from.len().min(to.len() + BATCH);
    to.extend_from_slice(from.get(to.len()..end).unwrap_or_default());
    to.len() < from.len()
}

impl Raw {
    /// Its triangles in the order in which they lie in the mesh, as the GPU reads them: a list's last, unfinished
    /// triangle is none; in a strip every other one is turned round, and the greatest index begins a new strip.
    pub fn triangles(&self) -> Vec<[u32; 3]> {
        match &self.indices {
            Some(Indices::U16(all)) => listed(
                self.topology,
                all.len(),
                |i| u32::from(all[i]),
                Some(u16::MAX.into()),
            ),
            Some(Indices::U32(all)) => listed(self.topology, all.len(), |i| all[i], Some(u32::MAX)),
            None => listed(self.topology, self.positions.len(), |i| i as u32, None),
        }
    }
}

fn listed(
    topology: PrimitiveTopology,
    count: usize,
    index: impl Fn(usize) -> u32,
    restart: Option<u32>,
) -> Vec<[u32; 3]> {
    match topology {
        PrimitiveTopology::TriangleList => (0..count / 3)
            .map(|i| [3 * i, 3 * i + 1, 3 * i + 2].map(&index))
            .collect(),
        PrimitiveTopology::TriangleStrip => {
            let mut triangles = Vec::with_capacity(count.saturating_sub(2));
            // Where the strip began.
            let mut first = 0;
            for i in 0..count {
                if restart == Some(index(i)) {
                    first = i + 1;
                } else if i >= first + 2 {
                    let [a, b, c] = [i - 2, i - 1, i].map(&index);
                    let is_turned = (i - first) % 2 == 1;
                    triangles.push(if is_turned { [b, a, c] } else { [a, b, c] });
                }
            }
            triangles
        }
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(topology: PrimitiveTopology, indices: Option<Indices>) -> Raw {
        Raw {
            topology,
            positions: vec![[0.0; 3]; 7],
            indices,
        }
    }

    #[test]
    fn lists_and_strips_are_read_as_the_gpu_does() {
        let list = raw(
            PrimitiveTopology::TriangleList,
            Some(Indices::U16(vec![0, 1, 2, 3, 4])),
        );
        assert_eq!(list.triangles(), [[0, 1, 2]]);
        assert_eq!(
            raw(PrimitiveTopology::TriangleList, None).triangles(),
            [[0, 1, 2], [3, 4, 5]]
        );
        let end = u16::MAX;
        let strip = raw(
            PrimitiveTopology::TriangleStrip,
            Some(Indices::U16(vec![0, 1, 2, 3, end, 4, 5, 6, 0, 1])),
        );
        assert_eq!(
            strip.triangles(),
            [[0, 1, 2], [2, 1, 3], [4, 5, 6], [6, 5, 0], [6, 0, 1]]
        );
    }

    #[test]
    fn a_mesh_is_copied_whole() {
        let mut meshes = Assets::<Mesh>::default();
        let ids: Vec<_> = [3, 200]
            .map(|sectors| meshes.add(Sphere::new(1.0).mesh().uv(sectors, sectors)))
            .map(|handle| handle.id())
            .into();
        let mut gather = Gather::default();
        while !gather
            .run(&ids, &meshes, &Slice::begin())
            .expect("readable")
        {}
        for (raw, id) in gather.finish().iter().zip(&ids) {
            let mesh = meshes.get(*id).expect("a mesh");
            assert_eq!(raw.positions.len(), mesh.count_vertices());
            assert_eq!(raw.indices.as_ref(), mesh.indices());
            assert_eq!(
                3 * raw.triangles().len(),
                mesh.indices().map_or(0, Indices::len)
            );
        }
    }
}
