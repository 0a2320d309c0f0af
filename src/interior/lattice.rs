//! The lattice: points at one spacing around the model, and vertices snapped to 1/256 of it.

use bevy::math::DVec3;

use super::{
    SEAL,
    error::InteriorError,
    settings::{InteriorCulling, InteriorGrid},
};

/// Units of snapped coordinates in a spacing.
pub const UNITS: i32 = 256;
/// [`SEAL`] in units.
pub const SEAL_UNITS: i32 = (SEAL * UNITS as f64) as i32;
/// Spacings in a cell: see [what is guaranteed](super#what-is-guaranteed). What is over the 1/256 that the proof asks
/// for is for the rounding of `f64`, and so that what only touches the ball lies outside it.
pub const SPACINGS_IN_CELL: f64 = 1.0 + 2.0 * SEAL + 1.0 / 128.0;
/// Spacings from the model to the outermost points: what blocks and what is extracted lies within [`REACH_UNITS`] of
/// the model.
const MARGIN: f64 = 2.0;
/// A triangle that comes within so much of an outside point, in every axis, is seen. units: units
pub const REACH_UNITS: i32 = UNITS * 3 / 2;
/// Coordinates stay below 2²⁰ units, so that products of three differences stay below 2⁶³.
const MOST_POINTS: u32 = 4096;
/// What is smaller than such a share of its distance from the origin is taken for that large: the finest units are then
/// 2⁻²⁰ of it, some 10⁻¹⁴ of the coordinates, of which `f64` has 10⁻¹⁶. units: 1
const POINT: f64 = 1e-8;
/// The most that can be asked for.
const MOST_CELLS: u32 = 3500;

/// See the [module](self).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Where point (0, 0, 0) is. units: of the model's frame
    pub origin: DVec3,
    /// Between neighbours. units: of the model's frame
    pub spacing: f64,
    /// Points along each axis.
    pub size: [u32; 3],
    /// 64-bit words of one bit for each point of a row along x.
    pub words: usize,
}

impl Lattice {
    /// The lattice that the settings ask for around a model with these bounds. `one_sided`: whether steps to and fro
    /// are told apart. `extra`: memory needed besides. units: bytes
    ///
    /// # Errors
    /// A grid that is none, or that takes more memory than is allowed.
    pub(super) fn plan(
        settings: &InteriorCulling,
        (least, greatest): (DVec3, DVec3),
        one_sided: bool,
        extra: u64,
    ) -> Result<Self, InteriorError> {
        let longest = (greatest - least).max_element();
        // A model that is one point has no longest side, or one lost in the rounding of where it is; any spacing will do
        // that is not.
        let grain = POINT * least.abs().max(greatest.abs()).max_element();
        let longest = match longest.max(grain) {
            0.0 => 1.0,
            longest => longest,
        };
        let around = |cell: f64| Self::around((least, greatest), cell / SPACINGS_IN_CELL);
        let cell = match settings.grid {
            InteriorGrid::Resolution(cells) if (1..=MOST_CELLS).contains(&cells) => {
                longest / f64::from(cells)
            }
            InteriorGrid::Resolution(cells) => return Err(InteriorError::Resolution(cells)),
            InteriorGrid::Gap(gap) if gap.is_finite() && gap > 0.0 => {
                (f64::from(gap) / 3f64.sqrt()).min(longest)
            }
            InteriorGrid::Gap(gap) => return Err(InteriorError::Gap(gap)),
        };
        let allowed = u64::from(settings.memory_mib) << 20;
        let needs = |cell: f64| {
            Self::bytes_around((least, greatest), cell, one_sided).saturating_add(extra)
        };
        let fits = |cell: f64| longest / cell <= f64::from(MOST_CELLS) && needs(cell) <= allowed;
        if fits(cell) {
            return Ok(around(cell));
        }
        let in_mib = |bytes: u64| bytes.div_ceil(1 << 20);
        if !fits(longest) {
            return Err(InteriorError::NoMemory {
                needs_mib: in_mib(needs(longest)),
                allowed_mib: settings.memory_mib,
            });
        }
        // The most cells that fit; what is needed rises with them.
        let (mut low, mut high) = (1, MOST_CELLS + 1);
        while high - low > 1 {
            let middle = (low + high) / 2;
            if fits(longest / f64::from(middle)) {
                low = middle;
            } else {
                high = middle;
            }
        }
        Err(InteriorError::Memory {
            needs_mib: in_mib(needs(cell)),
            allowed_mib: settings.memory_mib,
            smallest_gap: longest / f64::from(low) * 3f64.sqrt(),
            resolution: low,
        })
    }

    fn around((least, greatest): (DVec3, DVec3), spacing: f64) -> Self {
        let size = ((greatest - least) / spacing)
            .to_array()
            .map(|side| (side.ceil() + 2.0 * MARGIN) as u32 + 1);
        debug_assert!(size.iter().all(|side| *side <= MOST_POINTS));
        Self {
            origin: least - DVec3::splat(MARGIN * spacing),
            spacing,
            size,
            words: size[0].div_ceil(64) as usize,
        }
    }

    /// In floating point, as a grid that does not fit may have more points than can be counted.
    fn bytes_around((least, greatest): (DVec3, DVec3), cell: f64, one_sided: bool) -> u64 {
        let size =
            (greatest - least) / (cell / SPACINGS_IN_CELL) + DVec3::splat(2.0 * MARGIN + 2.0);
        let words = (size.x / 64.0).ceil();
        let arrays = if one_sided { 7.0 } else { 4.0 };
        (words * 8.0 * size.y * size.z * arrays) as u64
    }

    /// What a ball so wide can touch from outside stays. units: of the model's frame
    pub fn gap(&self) -> f64 {
        3f64.sqrt() * self.spacing * SPACINGS_IN_CELL
    }

    /// Memory of the field and of what is outside, one bit a step and a point. units: bytes
    pub fn bytes(&self, is_one_sided: bool) -> u64 {
        let arrays = if is_one_sided { 7 } else { 4 };
        (self.rows() * self.words * size_of::<u64>()) as u64 * arrays
    }

    /// How many points there are.
    pub fn points(&self) -> u64 {
        self.size.iter().map(|side| u64::from(*side)).product()
    }

    /// Rows along x.
    pub fn rows(&self) -> usize {
        self.size[1] as usize * self.size[2] as usize
    }

    /// The first word of the row of points (·, y, z).
    pub fn row(&self, y: u32, z: u32) -> usize {
        (z as usize * self.size[1] as usize + y as usize) * self.words
    }

    /// A place in the model's frame, snapped. units: units, at least 2 and at most all but 2 spacings
    pub fn snap(&self, position: DVec3) -> [i32; 3] {
        ((position - self.origin) / self.spacing * f64::from(UNITS))
            .round()
            .as_ivec3()
            .to_array()
    }

    /// Where a point is, in the model's frame.
    pub fn place(&self, point: [u32; 3]) -> DVec3 {
        self.origin + DVec3::from_array(point.map(f64::from)) * self.spacing
    }
}
