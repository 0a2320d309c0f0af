//! The paper's three maps of a mesh: centroids, index, memory access.

use bevy::math::DVec3;

use super::{
    bins::Bins,
    cover::Cover,
    error::SphericalError,
    order::{Key, Layout, order},
};

/// How [`SphericalMaps`] are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapSettings {
    /// How finely directions are told apart.
    pub bins: Bins,
    /// In what order.
    pub layout: Layout,
    /// Triangles in a chunk, at most; the least is 1. On average a third fewer, as bins are not torn apart.
    pub chunk_triangles: u32,
    /// What the index map may take. If it would take more, it gets coarser bins than the other maps, down to a single
    /// one that all triangles are in. units: bytes
    pub index_bytes: usize,
}

impl Default for MapSettings {
    /// The paper's bins in blocks, chunks of up to 128 triangles, an index map of at most 16 MiB.
    fn default() -> Self {
        Self {
            bins: Bins::default(),
            layout: Layout::default(),
            chunk_triangles: 128,
            index_bytes: 16 << 20,
        }
    }
}

impl From<Bins> for MapSettings {
    fn from(bins: Bins) -> Self {
        Self {
            bins,
            ..Self::default()
        }
    }
}

/// The number of a bin that there is none of.
pub const NO_BIN: u32 = u32::MAX;

/// A bin of the centroid map.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CentroidCell {
    /// Centroids in all earlier bins.
    pub earlier: u32,
    /// Centroids in this one.
    pub count: u32,
    /// The last earlier bin with centroids, for one that has none itself; else itself. [`NO_BIN`] if there is none.
    pub previous: u32,
    /// The centroid farthest from the centre; 0 where there are none. units: the mesh's
    pub farthest: f32,
}

/// Where a bin's triangles are in the reordered index buffer. units: triangles
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MemoryCell {
    /// The first that faces outward.
    pub outward: u32,
    /// How many do.
    pub outward_count: u32,
    /// The first that faces inward.
    pub inward: u32,
    /// How many do.
    pub inward_count: u32,
    /// The last earlier bin with triangles, [`NO_BIN`] if none.
    pub previous: u32,
    /// The first later bin with triangles, [`NO_BIN`] if none.
    pub next: u32,
}

/// From a bin to every triangle that, seen from the centre, covers a part of it.
///
/// The paper keeps, by its table 1, 2·360·180 floats for each face, though the 6.7 MB it gives are less than two for
/// each of all. Here bins hold triangles' numbers one after another.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IndexMap {
    /// Its own, coarser than the others' if it took too much.
    pub bins: Bins,
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

impl IndexMap {
    /// The triangles that cover a bin, by their numbers in the mesh as it was given. None for a bin there is none of.
    pub fn triangles(&self, bin: usize) -> &[u32] {
        match (self.starts.get(bin), self.starts.get(bin + 1)) {
            (Some(&from), Some(&to)) => &self.triangles[from as usize..to as usize],
            _ => &[],
        }
    }

    /// What it takes. units: bytes
    pub fn bytes(&self) -> usize {
        (self.starts.len() + self.triangles.len()) * size_of::<u32>()
    }

    /// `None` if it takes more than it may and can be made coarser.
    fn build(corners: &[[DVec3; 3]], bins: Bins, most: usize) -> Option<Self> {
        let most = if bins.count() == 1 {
            usize::MAX
        } else {
            let numbers = (most / size_of::<u32>()).min(u32::MAX as usize);
            numbers.checked_sub(bins.count() + 1)?
        };
        let mut cover = Cover::new(bins);
        let mut pairs: Vec<(u32, u32)> = Vec::with_capacity(corners.len());
        for (triangle, corners) in corners.iter().enumerate() {
            cover.each(*corners, |bin| pairs.push((bin as u32, triangle as u32)));
            if pairs.len() > most {
                return None;
            }
        }
        let mut starts = vec![0_u32; bins.count() + 1];
        for &(bin, _) in &pairs {
            starts[bin as usize + 1] += 1;
        }
        for bin in 0..bins.count() {
            starts[bin + 1] += starts[bin];
        }
        let mut next = starts.clone();
        let mut triangles = vec![0; pairs.len()];
        for (bin, triangle) in pairs {
            let at = &mut next[bin as usize];
            triangles[*at as usize] = triangle;
            *at += 1;
        }
        Some(Self {
            bins,
            starts,
            triangles,
        })
    }
}

/// A mesh's triangles by their directions from its centre (P3, §2.2).
///
/// # Limits
/// Takes at most 12 bytes a triangle, 40 bytes a bin, and for the index map [`MapSettings::index_bytes`] or, if that is
/// more, 4 bytes a triangle. While it is made, up to three times the index map, 150 bytes a triangle and 24 a bin more.
#[derive(Clone, Debug)]
pub struct SphericalMaps {
    /// How they were made.
    pub settings: MapSettings,
    /// The middle of the box around all triangles' corners. space: mesh
    pub centre: DVec3,
    /// From there to the farthest corner. units: the mesh's
    pub radius: f64,
    /// Triangles' numbers in their new order: at each place of the reordered index buffer, which of the mesh it is.
    pub order: Vec<u32>,
    /// From the centre to the centroids, in the new order. units: the mesh's
    pub distances: Vec<f32>,
    /// The centroid map, by bin.
    pub centroids: Vec<CentroidCell>,
    /// The memory-access map, by bin.
    pub memory: Vec<MemoryCell>,
    /// The index map.
    pub index: IndexMap,
    /// Where the new order is cut into chunks: both its ends and what is between. units: triangles
    pub cuts: Vec<u32>,
}

impl SphericalMaps {
    /// Maps of triangles given by their corners' numbers; counter-clockwise from the front.
    ///
    /// No triangles make empty maps. Triangles without area have no facing and count as facing outward; corners that
    /// no triangle has don't matter.
    ///
    /// # Errors
    /// [`SphericalError`]: no bins or too many; a corner that is missing or not finite.
    pub fn build(
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        settings: impl Into<MapSettings>,
    ) -> Result<Self, SphericalError> {
        let settings = settings.into();
        let bins = settings.bins.checked()?;
        if settings.chunk_triangles == 0 {
            return Err(SphericalError::NoChunk);
        }
        if triangles.len() > u32::MAX as usize / 3 {
            return Err(SphericalError::TooManyTriangles(triangles.len()));
        }
        let mut corners = corners(positions, triangles)?;
        let (mut least, mut greatest) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &corner in corners.iter().flatten() {
            least = least.min(corner);
            greatest = greatest.max(corner);
        }
        let centre = if triangles.is_empty() {
            DVec3::ZERO
        } else {
            (least + greatest) / 2.0
        };
        let mut radius = 0.0_f64;
        for corner in corners.iter_mut().flatten() {
            *corner -= centre;
            radius = radius.max(corner.length());
        }
        let keys: Vec<Key> = corners.iter().map(|corners| key(corners, bins)).collect();
        let size = settings.chunk_triangles as usize;
        let (order, cuts) = order(&keys, bins, settings.layout, size);
        let (centroids, memory) = cells(&order, &keys, bins);
        let mut index_bins = bins;
        let index = loop {
            match IndexMap::build(&corners, index_bins, settings.index_bytes) {
                Some(index) => break index,
                None => index_bins = index_bins.halved(),
            }
        };
        Ok(Self {
            settings,
            centre,
            radius,
            distances: order
                .iter()
                .map(|&triangle| keys[triangle as usize].distance as f32)
                .collect(),
            order,
            centroids,
            memory,
            index,
            cuts,
        })
    }

    /// What they take. units: bytes
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.order)
            + size_of_val(&*self.distances)
            + size_of_val(&*self.centroids)
            + size_of_val(&*self.memory)
            + size_of_val(&*self.cuts)
            + self.index.bytes()
    }
}

/// The corners' places. space: mesh
pub(super) fn corners(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
) -> Result<Vec<[DVec3; 3]>, SphericalError> {
    triangles
        .iter()
        .enumerate()
        .map(|(triangle, indices)| {
            let mut corners = [DVec3::ZERO; 3];
            for (corner, &vertex) in corners.iter_mut().zip(indices) {
                let position =
                    positions
                        .get(vertex as usize)
                        .ok_or(SphericalError::NoSuchVertex {
                            triangle,
                            vertex,
                            vertices: positions.len(),
                        })?;
                *corner = DVec3::from_array(position.map(f64::from));
                if !corner.is_finite() {
                    return Err(SphericalError::NotFinite { triangle, vertex });
                }
            }
            Ok(corners)
        })
        .collect()
}

/// Of corners relative to the centre.
fn key(&[a, b, c]: &[DVec3; 3], bins: Bins) -> Key {
    let centroid = (a + b + c) / 3.0;
    let normal = (b - a).cross(c - a).normalize_or_zero();
    Key {
        bin: bins.of(centroid) as u32,
        is_inward: normal.dot(centroid) < 0.0,
        distance: centroid.length(),
        normal,
    }
}

/// The cells of the centroid map and of the memory-access map.
fn cells(order: &[u32], keys: &[Key], bins: Bins) -> (Vec<CentroidCell>, Vec<MemoryCell>) {
    let mut centroids = vec![CentroidCell::default(); bins.count()];
    let mut memory = vec![MemoryCell::default(); bins.count()];
    for (place, &triangle) in order.iter().enumerate() {
        let key = &keys[triangle as usize];
        let (centroid, cell) = (
            &mut centroids[key.bin as usize],
            &mut memory[key.bin as usize],
        );
        centroid.count += 1;
        centroid.farthest = centroid.farthest.max(key.distance as f32);
        let (first, count) = if key.is_inward {
            (&mut cell.inward, &mut cell.inward_count)
        } else {
            (&mut cell.outward, &mut cell.outward_count)
        };
        if *count == 0 {
            *first = place as u32;
        }
        *count += 1;
    }
    let (mut earlier, mut filled) = (0, NO_BIN);
    for (bin, (centroid, cell)) in centroids.iter_mut().zip(&mut memory).enumerate() {
        cell.previous = filled;
        centroid.earlier = earlier;
        earlier += centroid.count;
        if centroid.count > 0 {
            filled = bin as u32;
        }
        centroid.previous = filled;
    }
    let mut filled = NO_BIN;
    for (bin, cell) in memory.iter_mut().enumerate().rev() {
        cell.next = filled;
        if cell.outward_count + cell.inward_count > 0 {
            filled = bin as u32;
        }
    }
    (centroids, memory)
}
