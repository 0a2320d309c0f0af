//! What the GPU is compared with: a sun's shadow map by one CPU thread in `f32`, as plainly as it can be written.
//!
//! From every sample the ray to the sun is walked cell by cell, and over each bilinear cell it is told exactly
//! whether the ray dips below the surface: the GPU's test, with nothing that skips. A walk ends where the ray is
//! blocked or leaves the field.
//!
//! It is written so that a build for development measures it fairly: everything the walk calls is inlined into it,
//! and its sums of whole numbers wrap unchecked. At `opt-level = 1` it is then as quick as at 3.

/// A field's heights, as stored. units: grid
pub struct PlainField<'a> {
    /// Row by row from sample (0, 0).
    pub heights: &'a [f32],
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// When the walk along a ray may end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlainEnd {
    /// Where it is blocked or leaves the field, as P5b's on the CPU.
    Border,
    /// There, or where it is above the field's highest sample.
    AboveAll,
}

/// How the ray goes along one axis.
#[derive(Clone, Copy)]
struct Axis {
    /// Cells per unit of t: from −1 to 1.
    speed: f32,
    /// t per cell; without bound where it stands still.
    per_cell: f32,
    /// Whether it goes up the axis.
    up: bool,
}

impl Axis {
    fn new(speed: f64) -> Self {
        Self {
            speed: speed as f32,
            per_cell: if speed == 0.0 {
                f32::INFINITY
            } else {
                (1.0 / speed.abs()) as f32
            },
            up: speed >= 0.0,
        }
    }

    /// The first cell's index, of those between `samples` samples; `None` if the ray leaves the field at once.
    #[inline(always)]
    fn first(&self, sample: usize, samples: usize) -> Option<usize> {
        if self.speed == 0.0 {
            Some(sample.min(samples - 2))
        } else if self.up {
            (sample + 1 < samples).then_some(sample)
        } else {
            sample.checked_sub(1)
        }
    }
}

impl PlainField<'_> {
    /// The map for a sun in `direction`, of which the larger of |x| and |z| is 1: 255 = lit, 0 = in shadow; and how
    /// many cells were looked at.
    pub fn cast(&self, direction: [f64; 3], end: PlainEnd) -> (Vec<u8>, u64) {
        let [x, y, z] = direction;
        let (x, y, z) = (Axis::new(x), y as f32, Axis::new(z));
        let highest = match end {
            PlainEnd::Border => f32::INFINITY,
            PlainEnd::AboveAll => self.heights.iter().copied().fold(f32::MIN, f32::max),
        };
        let mut map = Vec::with_capacity(self.heights.len());
        let mut cells = 0;
        for row in 0..self.height {
            for column in 0..self.width {
                let lit = self.is_lit(column, row, (x, y, z), highest, &mut cells);
                map.push(if lit { 255 } else { 0 });
            }
        }
        (map, cells)
    }

    /// Whether nothing of the ray from a sample lies below the surface.
    #[inline(always)]
    fn is_lit(
        &self,
        column: usize,
        row: usize,
        (x, y, z): (Axis, f32, Axis),
        highest: f32,
        cells: &mut u64,
    ) -> bool {
        let (Some(mut i), Some(mut j)) = (x.first(column, self.width), z.first(row, self.height))
        else {
            return true;
        };
        let here = self.heights[row * self.width + column];
        // The cell's first corner, and a step along each axis; below 0 it wraps to more cells than there are.
        let mut at = j * self.width + i;
        let back = usize::MAX;
        let step = (if x.up { 1 } else { back }, if z.up { 1 } else { back });
        let last = (self.width - 1, self.height - 1);
        // How far the cell's corner is from the sample, and how many borders the ray has crossed.
        let mut corner = (i as f32 - column as f32, j as f32 - row as f32);
        let mut crossed = (0.0, 0.0);
        let mut t = 0.0;
        let mut next = (x.per_cell, z.per_cell);
        loop {
            *cells = cells.wrapping_add(1);
            let t_out = if next.0 < next.1 { next.0 } else { next.1 };
            let h00 = self.heights[at] - here;
            let p = self.heights[at.wrapping_add(1)] - here - h00;
            let below = at.wrapping_add(self.width);
            let q = self.heights[below] - here - h00;
            let r = self.heights[below.wrapping_add(1)] - self.heights[below] - p;
            // Height of the ray above the surface, s = T − t: c + s (b + s a).
            let (u, v) = (t * x.speed - corner.0, t * z.speed - corner.1);
            let c = if t == 0.0 {
                // The sample itself, which lies on the surface.
                0.0
            } else {
                t * y - h00 - (p * u + q * v + r * u * v)
            };
            let b = y - p * x.speed - q * z.speed - r * (u * z.speed + v * x.speed);
            let a = -r * x.speed * z.speed;
            let s = t_out - t;
            let turns = a > 0.0 && b < 0.0 && -b < 2.0 * a * s;
            if c < 0.0 || c + s * (b + s * a) < 0.0 || (turns && b * b > 4.0 * a * c) {
                return false;
            }
            if t_out * y > highest - here {
                return true;
            }
            if next.0 <= next.1 {
                i = i.wrapping_add(step.0);
                if i >= last.0 {
                    return true;
                }
                at = at.wrapping_add(step.0);
                corner.0 += if x.up { 1.0 } else { -1.0 };
                crossed.0 += 1.0;
                next.0 = (crossed.0 + 1.0) * x.per_cell;
            } else {
                j = j.wrapping_add(step.1);
                if j >= last.1 {
                    return true;
                }
                at = at.wrapping_add(if z.up {
                    self.width
                } else {
                    self.width.wrapping_neg()
                });
                corner.1 += if z.up { 1.0 } else { -1.0 };
                crossed.1 += 1.0;
                next.1 = (crossed.1 + 1.0) * z.per_cell;
            }
            t = t_out;
        }
    }
}
