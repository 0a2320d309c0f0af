//! The [`HeightField`] asset: the samples, what they mean in metres, and edits to them.

use core::sync::atomic::{AtomicU64, Ordering};
use std::collections::VecDeque;

use bevy::{
    asset::Asset,
    math::{DAffine3, DMat3, DVec3, URect, UVec2, Vec2},
    reflect::Reflect,
};

use super::pyramid::MinMaxPyramid;

/// The largest height code of a 16-bit field.
const MAX_CODE: f64 = u16::MAX as f64;

/// How many edits a field remembers one by one; see [`HeightField::changed_since`].
const REMEMBERED_EDITS: usize = 32;

/// Source of revision numbers: no two states of any two fields share one.
static NEXT_REVISION: AtomicU64 = AtomicU64::new(1);

/// A rectangular grid of heights, and the surface it stands for.
///
/// The surface is the **bilinear interpolation of the samples**, which sit at the corners of the
/// cells: a field of W×H samples has (W−1)×(H−1) cells, and cell (i, j) lies between the samples
/// i, i+1 and j, j+1. The ground is solid below that surface, with walls straight down from its
/// border.
///
/// In its own local space, sample (0, 0) stands at the origin, columns run along +X, rows along
/// +Z, both [`texel_m`](Self::texel_m) metres apart, and heights are metres along +Y.
///
/// Samples are 16-bit codes over a range of heights, or floats in metres. Everything that the
/// renderer and the queries need, the [`MinMaxPyramid`] included, is kept up to date by
/// [`edit`](Self::edit) and its kin, in time proportional to the edited rectangle.
///
/// ```
/// use bevy_skyline::terrain::HeightField;
/// use bevy::math::UVec2;
///
/// let hills = HeightField::from_fn(UVec2::new(257, 257), 2.0, (0.0, 60.0), |column, row| {
///     30.0 + 20.0 * (column as f32 * 0.05).sin() + 10.0 * (row as f32 * 0.11).cos()
/// })?;
/// assert_eq!(hills.cells(), UVec2::new(256, 256));
/// assert_eq!(hills.extent_m().x, 512.0);
/// # Ok::<(), bevy_skyline::terrain::HeightFieldError>(())
/// ```
#[derive(Asset, Reflect, Clone)]
#[reflect(opaque)]
#[reflect(Clone, Debug)]
pub struct HeightField {
    size: UVec2,
    texel_m: f32,
    /// Heights of code 0 and of code 65535. Unused, and (0, 0), for float samples.
    code_range_m: (f32, f32),
    samples: HeightSamples,
    pyramid: MinMaxPyramid,
    revision: u64,
    /// The revision before the first of `edits`.
    oldest_known_revision: u64,
    /// Each edit's rectangle and the revision it led to, oldest first.
    edits: VecDeque<(u64, URect)>,
}

/// The samples of a [`HeightField`], row-major.
#[derive(Reflect, Clone, Debug, PartialEq)]
pub enum HeightSamples {
    /// Codes: 0 stands for the lower end of the field's height range, 65535 for the upper.
    U16(Vec<u16>),
    /// Metres; always finite.
    F32(Vec<f32>),
}

/// What has changed in a [`HeightField`] since a revision.
#[derive(Reflect, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Changed {
    /// It is that revision.
    Nothing,
    /// At most the samples of this rectangle (maximum exclusive).
    Rect(URect),
    /// Anything: the revision is of another field, or from too many edits ago.
    Everything,
}

/// Why a [`HeightField`] could not be made or edited.
#[derive(thiserror::Error, Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum HeightFieldError {
    /// Fewer than two columns or rows: there is no cell to draw.
    #[error(
        "a height field of {width}×{height} samples has no surface: it needs at least 2×2 samples"
    )]
    TooSmall {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The number of samples is not width × height.
    #[error("{width}×{height} samples are {expected}, but {found} were given")]
    SampleCount {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Width × height.
        expected: u64,
        /// The number given.
        found: u64,
    },
    /// A NaN or an infinity.
    #[error(
        "the sample at column {column}, row {row} is {value}: heights must be finite; \
         fill missing data before making a height field of it"
    )]
    NonFinite {
        /// Column of the first such sample, in row-major order.
        column: u32,
        /// Its row.
        row: u32,
        /// Its value.
        value: f32,
    },
    /// The distance between samples is no length.
    #[error(
        "a sample spacing of {texel_m} m cannot be used: it must be positive, and the whole \
         field's extent finite"
    )]
    Spacing {
        /// The value given.
        texel_m: f32,
    },
    /// The range of heights is upside down or not finite.
    #[error(
        "a height range of {min_m} m to {max_m} m cannot be used: both ends must be finite, \
         and the first no higher than the second"
    )]
    HeightRange {
        /// Height of code 0.
        min_m: f32,
        /// Height of code 65535.
        max_m: f32,
    },
    /// An edit reaches outside the field.
    #[error(
        "the rectangle from sample {min} to {max} (exclusive) is not inside the field of {size} \
         samples: clip it to the field first"
    )]
    RectOutOfBounds {
        /// First column and row.
        min: UVec2,
        /// One past the last column and row.
        max: UVec2,
        /// The field's size in samples.
        size: UVec2,
    },
    /// The samples handed to a write are of the other kind than the field's.
    #[error("this height field stores {stored} samples; write those, or use `HeightField::edit`")]
    SampleKind {
        /// `u16` or `f32`.
        stored: &'static str,
    },
}

impl core::fmt::Debug for HeightField {
    /// A summary: a field has millions of samples.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("HeightField")
            .field("size", &self.size)
            .field("texel_m", &self.texel_m)
            .field("height_range_m", &self.height_range_m())
            .field("samples", &self.samples.kind())
            .field("revision", &self.revision)
            .finish_non_exhaustive()
    }
}

impl HeightSamples {
    /// The number of samples.
    pub fn len(&self) -> usize {
        match self {
            Self::U16(samples) => samples.len(),
            Self::F32(samples) => samples.len(),
        }
    }

    /// Whether there are none; never so inside a [`HeightField`].
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::U16(_) => "u16",
            Self::F32(_) => "f32",
        }
    }
}

impl HeightField {
    /// A field of 16-bit codes: code 0 is `height_range_m.0` metres high, 65535 is
    /// `height_range_m.1`, those between in proportion.
    ///
    /// A range of zero length makes a flat field; its codes carry no height and are set to 0.
    ///
    /// # Errors
    /// [`TooSmall`](HeightFieldError::TooSmall), [`SampleCount`](HeightFieldError::SampleCount),
    /// [`Spacing`](HeightFieldError::Spacing), [`HeightRange`](HeightFieldError::HeightRange).
    pub fn from_u16(
        size: UVec2,
        texel_m: f32,
        height_range_m: (f32, f32),
        mut samples: Vec<u16>,
    ) -> Result<Self, HeightFieldError> {
        check_shape(size, texel_m, samples.len())?;
        check_range(height_range_m)?;
        if height_range_m.0 == height_range_m.1 {
            samples.fill(0);
        }
        Ok(Self::new(
            size,
            texel_m,
            height_range_m,
            HeightSamples::U16(samples),
        ))
    }

    /// A field of floats, in metres.
    ///
    /// # Errors
    /// [`TooSmall`](HeightFieldError::TooSmall), [`SampleCount`](HeightFieldError::SampleCount),
    /// [`Spacing`](HeightFieldError::Spacing), and [`NonFinite`](HeightFieldError::NonFinite) for
    /// the first NaN or infinity.
    pub fn from_f32(
        size: UVec2,
        texel_m: f32,
        samples: Vec<f32>,
    ) -> Result<Self, HeightFieldError> {
        check_shape(size, texel_m, samples.len())?;
        check_finite(
            URect {
                min: UVec2::ZERO,
                max: size,
            },
            &samples,
        )?;
        Ok(Self::new(
            size,
            texel_m,
            (0.0, 0.0),
            HeightSamples::F32(samples),
        ))
    }

    /// A field of 16-bit codes made by a function of column and row that returns metres.
    ///
    /// `height_m` is called once a sample, row by row. Its values are clamped to
    /// `height_range_m` and rounded to the nearest code, so they are off by at most half of
    /// 1/65535 of the range; where that is too coarse, use [`from_f32`](Self::from_f32).
    ///
    /// # Errors
    /// As [`from_u16`](Self::from_u16), and [`NonFinite`](HeightFieldError::NonFinite).
    pub fn from_fn(
        size: UVec2,
        texel_m: f32,
        height_range_m: (f32, f32),
        mut height_m: impl FnMut(u32, u32) -> f32,
    ) -> Result<Self, HeightFieldError> {
        let count = size.x as usize * size.y as usize;
        // Before anything is allocated or called.
        check_shape(size, texel_m, count)?;
        check_range(height_range_m)?;
        let mut samples = Vec::with_capacity(count);
        for row in 0..size.y {
            for column in 0..size.x {
                let value = height_m(column, row);
                if !value.is_finite() {
                    return Err(HeightFieldError::NonFinite { column, row, value });
                }
                samples.push(code_of(value, height_range_m));
            }
        }
        Self::from_u16(size, texel_m, height_range_m, samples)
    }

    fn new(size: UVec2, texel_m: f32, code_range_m: (f32, f32), samples: HeightSamples) -> Self {
        let pyramid = MinMaxPyramid::build(size, &samples);
        let revision = next_revision();
        Self {
            size,
            texel_m,
            code_range_m,
            samples,
            pyramid,
            revision,
            oldest_known_revision: revision,
            edits: VecDeque::new(),
        }
    }

    /// Columns and rows of samples, each at least 2.
    pub fn size(&self) -> UVec2 {
        self.size
    }

    /// Columns and rows of cells: one fewer than samples.
    pub fn cells(&self) -> UVec2 {
        self.size - UVec2::ONE
    }

    /// Metres between neighbouring samples.
    pub fn texel_m(&self) -> f32 {
        self.texel_m
    }

    /// The footprint in metres: cells × [`texel_m`](Self::texel_m).
    pub fn extent_m(&self) -> Vec2 {
        self.cells().as_vec2() * self.texel_m
    }

    /// The heights, in metres, that the samples can take: of codes 0 and 65535 for 16-bit
    /// samples, of the lowest and the highest sample for floats.
    pub fn height_range_m(&self) -> (f32, f32) {
        match self.samples {
            HeightSamples::U16(_) => self.code_range_m,
            HeightSamples::F32(_) => {
                let (max, min) = self.pyramid.top();
                (min as f32, max as f32)
            }
        }
    }

    /// The heights, in metres, of the lowest and of the highest sample.
    pub fn data_range_m(&self) -> (f64, f64) {
        let (max, min) = self.pyramid.top();
        (self.metres(min), self.metres(max))
    }

    /// The samples as stored, row-major.
    pub fn samples(&self) -> &HeightSamples {
        &self.samples
    }

    /// Bounds of the surface over squares of cells.
    pub fn pyramid(&self) -> &MinMaxPyramid {
        &self.pyramid
    }

    /// Maps local space (metres) to **grid space**: x and z in cells, y in stored heights, which
    /// are codes for 16-bit samples and metres for floats.
    ///
    /// It scales and translates along the axes, so it keeps rays straight and distances along one
    /// ray in proportion, and it is always invertible. Sample values are exact in grid space.
    pub fn grid_from_local(&self) -> DAffine3 {
        let cell = 1.0 / f64::from(self.texel_m);
        let (offset_m, step_m) = self.offset_and_step_m();
        DAffine3 {
            matrix3: DMat3::from_diagonal(DVec3::new(cell, 1.0 / step_m, cell)),
            translation: DVec3::new(0.0, -offset_m / step_m, 0.0),
        }
    }

    /// The inverse of [`grid_from_local`](Self::grid_from_local).
    pub fn local_from_grid(&self) -> DAffine3 {
        let texel_m = f64::from(self.texel_m);
        let (offset_m, step_m) = self.offset_and_step_m();
        DAffine3 {
            matrix3: DMat3::from_diagonal(DVec3::new(texel_m, step_m, texel_m)),
            translation: DVec3::new(0.0, offset_m, 0.0),
        }
    }

    /// The stored height of the sample at column `i`, row `j`: its code, or its metres.
    ///
    /// # Panics
    /// If it is outside the field.
    pub fn grid_height(&self, i: u32, j: u32) -> f64 {
        assert!(
            i < self.size.x && j < self.size.y,
            "sample ({i}, {j}) of {}",
            self.size
        );
        let index = j as usize * self.size.x as usize + i as usize;
        match &self.samples {
            HeightSamples::U16(samples) => f64::from(samples[index]),
            HeightSamples::F32(samples) => f64::from(samples[index]),
        }
    }

    /// The height, in metres, of the sample at column `i`, row `j`.
    ///
    /// # Panics
    /// If it is outside the field.
    pub fn sample_m(&self, i: u32, j: u32) -> f64 {
        self.metres(self.grid_height(i, j))
    }

    /// Metres of a stored height.
    pub(super) fn metres(&self, grid_height: f64) -> f64 {
        let (offset_m, step_m) = self.offset_and_step_m();
        offset_m + grid_height * step_m
    }

    /// The height of grid height 0, and the metres of one unit of it.
    pub(super) fn offset_and_step_m(&self) -> (f64, f64) {
        match self.samples {
            HeightSamples::U16(_) => {
                let min = f64::from(self.code_range_m.0);
                (min, code_step_m(self.code_range_m))
            }
            HeightSamples::F32(_) => (0.0, 1.0),
        }
    }

    /// Replaces the samples of `rect` (maximum exclusive) by `height_m(column, row, old height)`,
    /// in metres, and brings the pyramid up to date above them.
    ///
    /// 16-bit samples are clamped to the height range and rounded to the nearest code. Each
    /// sample is visited once, row by row. An empty rectangle changes nothing, not even the
    /// revision. The time taken goes with the rectangle, not with the field.
    ///
    /// # Errors
    /// [`RectOutOfBounds`](HeightFieldError::RectOutOfBounds), and
    /// [`NonFinite`](HeightFieldError::NonFinite) for the first NaN or infinity returned; in both
    /// cases the field is as it was.
    pub fn edit(
        &mut self,
        rect: URect,
        mut height_m: impl FnMut(u32, u32, f32) -> f32,
    ) -> Result<(), HeightFieldError> {
        self.check_rect(rect)?;
        let mut heights_m = Vec::with_capacity(area(rect));
        for row in rect.min.y..rect.max.y {
            for column in rect.min.x..rect.max.x {
                let old = self.sample_m(column, row) as f32;
                let value = height_m(column, row, old);
                if !value.is_finite() {
                    return Err(HeightFieldError::NonFinite { column, row, value });
                }
                heights_m.push(value);
            }
        }
        match self.samples {
            HeightSamples::U16(_) => {
                let range = self.code_range_m;
                let codes: Vec<u16> = heights_m.iter().map(|&m| code_of(m, range)).collect();
                self.write_u16(rect, &codes)
            }
            HeightSamples::F32(_) => self.write_f32(rect, &heights_m),
        }
    }

    /// Replaces the codes of `rect` (maximum exclusive) by `codes`, row-major.
    ///
    /// # Errors
    /// [`SampleKind`](HeightFieldError::SampleKind) for a field of floats,
    /// [`RectOutOfBounds`](HeightFieldError::RectOutOfBounds),
    /// [`SampleCount`](HeightFieldError::SampleCount); the field is then as it was.
    pub fn write_u16(&mut self, rect: URect, codes: &[u16]) -> Result<(), HeightFieldError> {
        self.check_rect(rect)?;
        check_count(rect.size(), codes.len())?;
        let stored = self.samples.kind();
        let HeightSamples::U16(samples) = &mut self.samples else {
            return Err(HeightFieldError::SampleKind { stored });
        };
        // On a flat range every code stands for the one height there is; see `from_u16`.
        if self.code_range_m.0 != self.code_range_m.1 {
            copy_rect(samples, self.size.x as usize, rect, codes);
        }
        self.changed(rect);
        Ok(())
    }

    /// Replaces the heights of `rect` (maximum exclusive) by `heights_m`, row-major, in metres.
    ///
    /// # Errors
    /// [`SampleKind`](HeightFieldError::SampleKind) for a field of 16-bit codes,
    /// [`RectOutOfBounds`](HeightFieldError::RectOutOfBounds),
    /// [`SampleCount`](HeightFieldError::SampleCount),
    /// [`NonFinite`](HeightFieldError::NonFinite); the field is then as it was.
    pub fn write_f32(&mut self, rect: URect, heights_m: &[f32]) -> Result<(), HeightFieldError> {
        self.check_rect(rect)?;
        check_count(rect.size(), heights_m.len())?;
        check_finite(rect, heights_m)?;
        let stored = self.samples.kind();
        let HeightSamples::F32(samples) = &mut self.samples else {
            return Err(HeightFieldError::SampleKind { stored });
        };
        copy_rect(samples, self.size.x as usize, rect, heights_m);
        self.changed(rect);
        Ok(())
    }

    /// A number for the field's present content. It grows with each edit, and no two fields made
    /// in one process share one, except a clone and its original while neither is edited: equal
    /// revisions mean equal content.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// What has changed since this field, or the one it was cloned from, had `revision`.
    ///
    /// # Limits
    /// The last 32 edits are remembered; what happened before them is
    /// [`Everything`](Changed::Everything). Two edits far apart are told as the rectangle around
    /// both.
    pub fn changed_since(&self, revision: u64) -> Changed {
        if revision == self.revision {
            return Changed::Nothing;
        }
        let first = if revision == self.oldest_known_revision {
            0
        } else {
            match self.edits.iter().position(|&(r, _)| r == revision) {
                Some(index) => index + 1,
                None => return Changed::Everything,
            }
        };
        self.edits
            .range(first..)
            .map(|&(_, rect)| rect)
            .reduce(|a, b| a.union(b))
            .map_or(Changed::Everything, Changed::Rect)
    }

    /// Refreshes the pyramid over `rect` and records the edit.
    fn changed(&mut self, rect: URect) {
        if rect.is_empty() {
            return;
        }
        self.pyramid.update(&self.samples, rect);
        self.revision = next_revision();
        if self.edits.len() == REMEMBERED_EDITS
            && let Some((revision, _)) = self.edits.pop_front()
        {
            self.oldest_known_revision = revision;
        }
        self.edits.push_back((self.revision, rect));
    }

    fn check_rect(&self, rect: URect) -> Result<(), HeightFieldError> {
        let inside = rect.min.cmple(rect.max).all() && rect.max.cmple(self.size).all();
        if inside {
            Ok(())
        } else {
            Err(HeightFieldError::RectOutOfBounds {
                min: rect.min,
                max: rect.max,
                size: self.size,
            })
        }
    }
}

fn next_revision() -> u64 {
    NEXT_REVISION.fetch_add(1, Ordering::Relaxed)
}

/// Metres per code. On a flat range only code 0 occurs; the step of 1 keeps the map invertible.
fn code_step_m((min, max): (f32, f32)) -> f64 {
    if min == max {
        1.0
    } else {
        (f64::from(max) - f64::from(min)) / MAX_CODE
    }
}

/// The code nearest to a finite height.
fn code_of(height_m: f32, range: (f32, f32)) -> u16 {
    if range.0 == range.1 {
        return 0;
    }
    let code = (f64::from(height_m) - f64::from(range.0)) / code_step_m(range);
    // `as` saturates, which is the clamp to the range.
    code.round() as u16
}

fn area(rect: URect) -> usize {
    rect.width() as usize * rect.height() as usize
}

fn copy_rect<T: Copy>(samples: &mut [T], width: usize, rect: URect, new: &[T]) {
    if rect.is_empty() {
        return;
    }
    let rect_width = rect.width() as usize;
    for (row, new) in new.chunks_exact(rect_width).enumerate() {
        let start = (rect.min.y as usize + row) * width + rect.min.x as usize;
        samples[start..start + rect_width].copy_from_slice(new);
    }
}

fn check_shape(size: UVec2, texel_m: f32, count: usize) -> Result<(), HeightFieldError> {
    if size.min_element() < 2 {
        return Err(HeightFieldError::TooSmall {
            width: size.x,
            height: size.y,
        });
    }
    check_count(size, count)?;
    let extent = (size - UVec2::ONE).as_vec2() * texel_m;
    // 1 / texel_m must be finite too: a subnormal spacing is no spacing.
    if texel_m.is_normal() && texel_m > 0.0 && extent.is_finite() {
        Ok(())
    } else {
        Err(HeightFieldError::Spacing { texel_m })
    }
}

fn check_count(size: UVec2, count: usize) -> Result<(), HeightFieldError> {
    let expected = u64::from(size.x) * u64::from(size.y);
    if expected == count as u64 {
        Ok(())
    } else {
        Err(HeightFieldError::SampleCount {
            width: size.x,
            height: size.y,
            expected,
            found: count as u64,
        })
    }
}

fn check_range((min_m, max_m): (f32, f32)) -> Result<(), HeightFieldError> {
    if min_m.is_finite() && max_m.is_finite() && min_m <= max_m {
        Ok(())
    } else {
        Err(HeightFieldError::HeightRange { min_m, max_m })
    }
}

/// Finds the first sample of `rect`'s rows that is no number.
fn check_finite(rect: URect, samples: &[f32]) -> Result<(), HeightFieldError> {
    match samples.iter().position(|s| !s.is_finite()) {
        None => Ok(()),
        Some(index) => Err(HeightFieldError::NonFinite {
            column: rect.min.x + (index % rect.width() as usize) as u32,
            row: rect.min.y + (index / rect.width() as usize) as u32,
            value: samples[index],
        }),
    }
}
