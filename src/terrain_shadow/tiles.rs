//! The tiles a shadow map is made of, and which of them an edit of the heights can change.

use bevy::math::{DVec2, DVec3, URect, UVec2, Vec3Swizzles};

use super::light::{GridLight, LightSource};

/// Side of a tile, as `TILE` in `shadow_tiles.wgsl`. units: samples
pub const TILE: u32 = 64;

/// Bytes of a tile: its samples, row by row, then their averages over 2×2, 4×4 … 64×64, and padding.
pub const TILE_BYTES: u64 = 5464;

/// The tiles of one map: those that hold the samples its light can reach.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileGrid {
    /// The first tile's column and row among those of the whole field.
    pub first: UVec2,
    /// Tiles a row, and rows.
    pub count: UVec2,
}

impl TileGrid {
    /// The tiles that hold a rectangle of samples.
    pub fn over(samples: URect) -> Self {
        let first = samples.min / TILE;
        Self {
            first,
            count: samples.max.map(|n| n.div_ceil(TILE)) - first,
        }
    }

    /// How many tiles.
    pub fn len(&self) -> u32 {
        self.count.x * self.count.y
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes of the map.
    pub fn bytes(&self) -> u64 {
        u64::from(self.len()) * TILE_BYTES
    }

    /// The samples of a tile, cut off at the field's size; the last is not included.
    pub fn samples(&self, tile: u32, size: UVec2) -> URect {
        let at = self.first + UVec2::new(tile % self.count.x, tile / self.count.x);
        URect::from_corners((at * TILE).min(size), ((at + 1) * TILE).min(size))
    }

    /// Where in the map a sample's byte is.
    pub fn byte(&self, sample: UVec2) -> usize {
        let tile = sample / TILE - self.first;
        let inside = sample % TILE;
        let tile = (tile.y * self.count.x + tile.x) as usize;
        tile * TILE_BYTES as usize + (inside.y * TILE + inside.x) as usize
    }
}

/// A set of tiles.
#[derive(Clone, Debug, Default)]
pub struct TileSet {
    words: Vec<u64>,
    len: u32,
}

impl TileSet {
    /// Empties it, for tiles below `count`.
    pub fn reset(&mut self, count: u32) {
        self.words.clear();
        self.words.resize(count.div_ceil(64) as usize, 0);
        self.len = 0;
    }

    /// Fills it with the tiles below `count`.
    pub fn fill(&mut self, count: u32) {
        self.reset(count);
        for tile in 0..count {
            self.insert(tile);
        }
    }

    /// How many tiles are in it.
    pub fn len(&self) -> u32 {
        self.len
    }

    /// Whether it holds none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Puts a tile in.
    pub fn insert(&mut self, tile: u32) {
        let Some(word) = self.words.get_mut(tile as usize / 64) else {
            return;
        };
        let bit = 1 << (tile % 64);
        self.len += u32::from(*word & bit == 0);
        *word |= bit;
    }

    /// Takes a tile out.
    pub fn remove(&mut self, tile: u32) {
        let Some(word) = self.words.get_mut(tile as usize / 64) else {
            return;
        };
        let bit = 1 << (tile % 64);
        self.len -= u32::from(*word & bit != 0);
        *word &= !bit;
    }

    /// The tiles, in order.
    pub fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        self.words.iter().enumerate().flat_map(|(index, word)| {
            let mut word = *word;
            core::iter::from_fn(move || {
                let bit = (word != 0).then(|| word.trailing_zeros())?;
                word &= word - 1;
                Some(index as u32 * 64 + bit)
            })
        })
    }
}

/// Tells which tiles' shadow rays can pass over an edited rectangle. Errs toward tiles that need not be made anew.
pub struct EditReach {
    light: GridLight,
    /// The edited samples, grown by the cells they shape. units: cells
    edit: (DVec2, DVec2),
    /// How far a ray may go before it is above everything; infinite if it never is. units: of its own t
    t_most: f64,
}

impl EditReach {
    /// `heights` is the range of all heights before and after the edit. units: grid
    pub fn new(light: &GridLight, edit: URect, heights: (f64, f64)) -> Self {
        let mut grow = 2.0;
        let mut t_most = f64::INFINITY;
        match light.source {
            LightSource::Directional(_) => {
                let disc = light.disc(DVec3::ZERO);
                let lowest = disc.centre - disc.up;
                let speed = lowest.xz().abs().max_element();
                if lowest.y > 0.0 && speed > 0.0 {
                    t_most = (heights.1 - heights.0) * speed / lowest.y + 1.0;
                } else if lowest.y > 0.0 {
                    t_most = 1.0;
                }
                let horizontal = disc.centre.xz().abs().max_element();
                if disc.right.xz() != DVec2::ZERO && horizontal > 0.0 {
                    // Strips to the sides of the disc look along other azimuths.
                    grow += disc.right.xz().length() / horizontal * t_most.min(1e9);
                }
            }
            LightSource::Point(_) => {
                // Seen from anywhere, the light's disc lies within its radius.
                let grid_from_world = light.world_from_grid.inverse();
                let row = |axis| grid_from_world.row(axis).length();
                grow += light.radius * row(0).max(row(2));
            }
        }
        let edit = (edit.min.as_dvec2() - grow, edit.max.as_dvec2() + grow);
        Self {
            light: *light,
            edit,
            t_most,
        }
    }

    /// Whether the ray of some sample in `samples` may cross the edited rectangle.
    pub fn touches(&self, samples: URect) -> bool {
        let (low, high) = (samples.min.as_dvec2(), samples.max.as_dvec2());
        let corners = [
            low,
            DVec2::new(high.x, low.y),
            high,
            DVec2::new(low.x, high.y),
        ];
        // Rays from the tile sweep the hull of these points.
        let mut points = [DVec2::ZERO; 8];
        points[..4].copy_from_slice(&corners);
        let mut axes = [DVec2::X; 6];
        axes[1] = DVec2::Y;
        match self.light.source {
            LightSource::Directional(way) => {
                let speed = way.xz().abs().max_element();
                let way = if speed > 0.0 {
                    way.xz() / speed
                } else {
                    DVec2::ZERO
                };
                for (far, corner) in points[4..].iter_mut().zip(corners) {
                    *far = corner + way * self.t_most.min(1e9);
                }
                axes[2..].fill(way.perp());
            }
            LightSource::Point(position) => {
                points[4..].fill(position.xz());
                for (axis, corner) in axes[2..].iter_mut().zip(corners) {
                    *axis = (position.xz() - corner).perp();
                }
            }
        }
        let edit = [
            self.edit.0,
            DVec2::new(self.edit.1.x, self.edit.0.y),
            self.edit.1,
            DVec2::new(self.edit.0.x, self.edit.1.y),
        ];
        let extent = |points: &[DVec2], axis: DVec2| {
            points
                .iter()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| {
                    (low.min(p.dot(axis)), high.max(p.dot(axis)))
                })
        };
        axes.iter().all(|&axis| {
            let (a, b) = (extent(&points, axis), extent(&edit, axis));
            a.0 <= b.1 && b.0 <= a.1
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::math::DAffine3;

    #[test]
    fn a_set_of_tiles_counts_and_lists_them() {
        let mut set = TileSet::default();
        set.reset(130);
        for tile in [3, 128, 3, 64] {
            set.insert(tile);
        }
        assert_eq!(
            (set.len(), set.iter().collect::<Vec<_>>()),
            (3, vec![3, 64, 128])
        );
        set.remove(64);
        set.remove(65);
        assert_eq!(
            (set.len(), set.iter().collect::<Vec<_>>()),
            (2, vec![3, 128])
        );
        set.fill(70);
        assert_eq!((set.len(), set.iter().last()), (70, Some(69)));
    }

    #[test]
    fn every_sample_has_a_byte_of_its_own() {
        let size = UVec2::new(200, 130);
        let grid = TileGrid::over(URect::new(70, 10, 200, 130));
        assert_eq!(
            (grid.first, grid.count),
            (UVec2::new(1, 0), UVec2::new(3, 3))
        );
        let mut seen = vec![false; grid.bytes() as usize];
        for tile in 0..grid.len() {
            let samples = grid.samples(tile, size);
            for j in samples.min.y..samples.max.y {
                for i in samples.min.x..samples.max.x {
                    let byte = grid.byte(UVec2::new(i, j));
                    assert!(!core::mem::replace(&mut seen[byte], true));
                    assert_eq!(byte / TILE_BYTES as usize, tile as usize);
                }
            }
        }
        assert_eq!(seen.iter().filter(|seen| **seen).count(), 136 * 130);
    }

    /// The tiles whose rays cross the edit, found the slow way.
    fn crossing(light: &GridLight, edit: URect, samples: URect, t_most: f64) -> bool {
        (samples.min.y..samples.max.y).step_by(3).any(|j| {
            (samples.min.x..samples.max.x).step_by(3).any(|i| {
                let from = DVec3::new(f64::from(i), 0.0, f64::from(j));
                let Some(ray) = light.ray(from) else {
                    return false;
                };
                (0..4000).any(|n| {
                    let t = 0.25 * f64::from(n);
                    let at = (from + t * ray.direction).xz();
                    t <= ray.t_end.min(t_most)
                        && at.cmpge(edit.min.as_dvec2()).all()
                        && at.cmple(edit.max.as_dvec2()).all()
                })
            })
        })
    }

    #[test]
    fn no_tile_whose_rays_cross_an_edit_is_left_out_and_most_others_are() {
        let size = UVec2::new(640, 640);
        let grid = TileGrid::over(URect::new(0, 0, 640, 640));
        let edit = URect::new(300, 310, 330, 320);
        let lights = [
            GridLight::directional(DVec3::new(1.0, 0.3, 0.4), 0.0, DAffine3::IDENTITY),
            GridLight::directional(DVec3::new(0.0, 0.1, -1.0), 0.0, DAffine3::IDENTITY),
            GridLight::point(DVec3::new(400.0, 50.0, 100.0), 0.0, 1e9, DAffine3::IDENTITY),
            GridLight::point(DVec3::new(315.0, 50.0, 315.0), 0.0, 1e9, DAffine3::IDENTITY),
        ];
        for light in lights {
            let reach = EditReach::new(&light, edit, (0.0, 60.0));
            let (mut touched, mut crossed) = (0, 0);
            for tile in 0..grid.len() {
                let samples = grid.samples(tile, size);
                let crosses = crossing(&light, edit, samples, 60.0 * 1.2 / 0.1);
                let crosses = crosses && crossing(&light, edit, samples, reach.t_most);
                assert!(!crosses || reach.touches(samples), "{light:?} {samples:?}");
                touched += u32::from(reach.touches(samples));
                crossed += u32::from(crosses);
            }
            assert!(
                crossed > 0 && touched < 2 * crossed + 12,
                "{touched} {crossed}"
            );
        }
    }
}
