//! What is drawn by the paper's own rules (P3, §2.3 and appendix 1): may leave out what can be seen.
//!
//! # Where the text leaves a choice
//! - *Which rule.* By its words the hidden side is removed when none of the four corner rays meets the object; by its
//!   appendix, when the frustum includes the bounding sphere. Here: it includes it, or no corner ray meets a
//!   triangle. The frustum's near and far sides are not used.
//! - *A corner ray that meets no triangle while others do* counts as meeting the object where it comes nearest to the
//!   centre.
//! - *Where a ray meets the object.* The index map is looked up along all of the ray's way through the bounding
//!   sphere, in steps of half a bin, as a triangle behind the place of entry need not be in the bin of that place.
//! - *The visible region* is the least box in (θ, φ) around the four places that were met. If a pole is between them,
//!   it is all φ from that pole to the farthest of them: the first of the three cases, a run.
//! - *All triangles of a bin are drawn*, whichever way they face and however far from the centre.
//! - *The view ray* of the hidden-side rule goes through the centre: only then are the ends of its way through the
//!   sphere opposite, as the text has them.
//! - *The samples* of the sphere are rings around the view ray, one bin of θ wide, cut into sectors one bin of φ
//!   wide, each with its own axis across the view ray. The text says "by fixed θ, φ", and that each has its axis.
//! - *What hides.* The size S of a bin is that of its farthest centroid. Behind the first 180° a bin is hidden if a
//!   ring before its own has, in the same sector, a bin of greater S.
//! - *Up to 180°* is taken for the half of the sphere towards the eye: angles of up to 90° with the view ray.

use core::{
    f64::consts::{FRAC_PI_2, TAU},
    ops::Range,
};

use bevy::math::DVec3;

use super::{
    bins::angles,
    chunks::push,
    cover::holds,
    maps::{MemoryCell, NO_BIN, SphericalMaps},
    order::Layout,
    ray::Ray,
};

/// The four corners of a picture, one after another around it. space: mesh
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frustum {
    /// Through the corners.
    pub rays: [Ray; 4],
    /// Whether they all begin at the eye; otherwise they are parallel.
    pub is_perspective: bool,
}

impl Frustum {
    /// Of an eye and the directions of the picture's corners.
    pub fn perspective(eye: DVec3, corners: [DVec3; 4]) -> Self {
        Self {
            rays: corners.map(|direction| Ray {
                origin: eye,
                direction,
            }),
            is_perspective: true,
        }
    }

    /// Of the places of the picture's corners and the direction of the view.
    pub fn orthographic(corners: [DVec3; 4], direction: DVec3) -> Self {
        Self {
            rays: corners.map(|origin| Ray { origin, direction }),
            is_perspective: false,
        }
    }

    /// The four sides against a sphere.
    fn meets(&self, centre: DVec3, radius: f64) -> Meets {
        let inside = self
            .rays
            .map(|ray| ray.origin + ray.direction.normalize_or_zero())
            .iter()
            .sum::<DVec3>()
            / 4.0;
        let mut meets = Meets::Includes;
        for (at, ray) in self.rays.iter().enumerate() {
            let next = &self.rays[(at + 1) % 4];
            let normal = (next.origin + next.direction - ray.origin)
                .cross(ray.direction)
                .normalize_or_zero();
            let sign = normal.dot(inside - ray.origin).signum();
            let distance = sign * normal.dot(centre - ray.origin);
            if distance < -radius {
                return Meets::Not;
            }
            if distance < radius {
                meets = Meets::Cuts;
            }
        }
        meets
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Meets {
    Not,
    Cuts,
    Includes,
}

/// By which rule triangles were selected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Case {
    /// The mesh is not in view; nothing is selected.
    Outside,
    /// The frustum cuts it; the region goes all around in φ (case 1).
    Run,
    /// The frustum cuts it; the region is in the middle (case 2).
    Clump,
    /// The frustum cuts it; the region is split in two by φ = 0 (case 3).
    Split,
    /// The whole mesh is in view; the hidden side is left out.
    Whole,
}

/// Memory that [`SphericalMaps::select_as_published`] uses again.
#[derive(Clone, Debug, Default)]
pub struct PaperScratch {
    /// The greatest S by ring and sector, then of all rings up to each.
    sizes: Vec<f32>,
}

/// A region of bins: rows, and one or two ranges of columns.
struct Region {
    case: Case,
    rows: [usize; 2],
    columns: [Option<[usize; 2]>; 2],
}

impl SphericalMaps {
    /// The ranges of the reordered triangles that the paper's rules draw, in order, neighbours joined.
    ///
    /// The mesh is that which the maps were made of. `ranges` is cleared first; it and the scratch don't grow after the
    /// first calls.
    ///
    /// # Limits
    /// Leaves out visible triangles where the picture's borders bulge beyond the box around its corners, where one part
    /// of the mesh sticks out sideways behind another without hiding it, and more.
    pub fn select_as_published(
        &self,
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        frustum: &Frustum,
        scratch: &mut PaperScratch,
        ranges: &mut Vec<Range<u32>>,
    ) -> Case {
        ranges.clear();
        if self.order.is_empty() {
            return Case::Outside;
        }
        let meets = frustum.meets(self.centre, self.radius);
        if meets == Meets::Not {
            return Case::Outside;
        }
        let region = if meets == Meets::Cuts {
            self.region(positions, triangles, frustum)
        } else {
            None
        };
        let case = if let Some(region) = region {
            self.select_region(&region, ranges);
            region.case
        } else {
            self.select_whole(frustum, scratch, ranges);
            Case::Whole
        };
        if self.settings.layout == Layout::Blocks {
            join(ranges);
        }
        case
    }

    /// `Visibility_Area_Test`: the box around what the corner rays meet; `None` if they meet nothing.
    fn region(
        &self,
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        frustum: &Frustum,
    ) -> Option<Region> {
        let mut is_met = false;
        let places = frustum.rays.map(|ray| {
            let along = self.first_hit(positions, triangles, &ray).map(|hit| hit.1);
            is_met |= along.is_some();
            let along = along.unwrap_or_else(|| {
                let whole = ray.direction.length_squared();
                ((self.centre - ray.origin).dot(ray.direction) / whole).max(0.0)
            });
            (ray.origin + ray.direction * along - self.centre).normalize_or(DVec3::Y)
        });
        if !is_met {
            return None;
        }
        let bins = self.settings.bins;
        let (last_row, last_column) = (usize::from(bins.theta) - 1, usize::from(bins.phi) - 1);
        let (mut rows, mut phi) = ([last_row, 0], angles(places[0]).1);
        let (mut least, mut greatest) = (phi, phi);
        for place in places {
            let (theta, turned) = angles(place);
            phi += (turned - phi + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
            (least, greatest) = (least.min(phi), greatest.max(phi));
            let row = bins.row(theta);
            rows = [rows[0].min(row), rows[1].max(row)];
        }
        let [a, b, c, d] = places;
        let between = |pole| holds([a, b, c], pole) || holds([a, c, d], pole);
        let (up, down) = (between(DVec3::Y), between(DVec3::NEG_Y));
        if up {
            rows[0] = 0;
        }
        if down {
            rows[1] = last_row;
        }
        let (first, last) = (bins.column(least), bins.column(greatest));
        let (case, columns) = if up || down || greatest - least > TAU - bins.phi_step() {
            (Case::Run, [Some([0, last_column]), None])
        } else if least.div_euclid(TAU) == greatest.div_euclid(TAU) {
            (Case::Clump, [Some([first, last]), None])
        } else {
            (Case::Split, [Some([0, last]), Some([first, last_column])])
        };
        Some(Region {
            case,
            rows,
            columns,
        })
    }

    /// `Render_State`: by as few scans as the case needs.
    fn select_region(&self, region: &Region, ranges: &mut Vec<Range<u32>>) {
        let columns = usize::from(self.settings.bins.phi);
        let [first, last] = region.rows;
        if region.case == Case::Run {
            self.scan(first * columns, (last + 1) * columns - 1, ranges);
            return;
        }
        for row in first..=last {
            for [from, to] in region.columns.into_iter().flatten() {
                self.scan(row * columns + from, row * columns + to, ranges);
            }
        }
    }

    /// Adds the triangles of bins that follow one another. In rows, they are one range: from the first to the last
    /// that has any, which the cells of empty bins say.
    fn scan(&self, from: usize, to: usize, ranges: &mut Vec<Range<u32>>) {
        let filled = |bin: usize, neighbour: fn(&MemoryCell) -> u32| {
            let cell = self.memory.get(bin)?;
            if cell.outward_count + cell.inward_count > 0 {
                return Some(bin);
            }
            let other = neighbour(cell);
            (other != NO_BIN).then_some(other as usize)
        };
        let Some(mut first) = filled(from, |cell| cell.next).filter(|&first| first <= to) else {
            return;
        };
        let Some(last) = filled(to, |cell| cell.previous) else {
            return;
        };
        if self.settings.layout == Layout::Rows {
            push(ranges, self.memory[first].first()..self.memory[last].end());
            return;
        }
        loop {
            self.memory[first].push_to(ranges);
            match filled(first + 1, |cell| cell.next) {
                Some(next) if next <= last => first = next,
                _ => return,
            }
        }
    }

    /// `Area_sampling`, `Hidden_Surface_Test` and `Render_Selected`.
    fn select_whole(
        &self,
        frustum: &Frustum,
        scratch: &mut PaperScratch,
        ranges: &mut Vec<Range<u32>>,
    ) {
        let bins = self.settings.bins;
        let (rings, sectors) = (usize::from(bins.theta), usize::from(bins.phi));
        let ray = frustum.rays[0];
        let towards = if frustum.is_perspective {
            ray.origin - self.centre
        } else {
            -ray.direction
        };
        let towards = towards.normalize_or(DVec3::Y);
        let (across, up) = towards.any_orthonormal_pair();
        // A bin's ring and sector, its angle with the view ray and its S.
        let sample = |bin: usize, farthest: f32| {
            let middle = bins.middle(bin);
            let (along, x, y) = (middle.dot(towards), middle.dot(across), middle.dot(up));
            let sin = x.hypot(y);
            let angle = sin.atan2(along);
            let cell = bins.row(angle) * sectors + bins.column(y.atan2(x));
            (cell, angle, farthest * sin as f32)
        };
        scratch.sizes.clear();
        scratch.sizes.resize(rings * sectors, 0.0);
        let filled = || {
            self.centroids
                .iter()
                .enumerate()
                .filter(|(_, cell)| cell.count > 0)
        };
        for (bin, cell) in filled() {
            let (at, _, size) = sample(bin, cell.farthest);
            scratch.sizes[at] = scratch.sizes[at].max(size);
        }
        for at in sectors..rings * sectors {
            scratch.sizes[at] = scratch.sizes[at].max(scratch.sizes[at - sectors]);
        }
        for (bin, cell) in filled() {
            let (at, angle, size) = sample(bin, cell.farthest);
            let hides = at
                .checked_sub(sectors)
                .map_or(0.0, |before| scratch.sizes[before]);
            if angle <= FRAC_PI_2 || size >= hides {
                self.memory[bin].push_to(ranges);
            }
        }
    }
}

impl MemoryCell {
    /// In rows: the bin's first triangle.
    fn first(&self) -> u32 {
        if self.outward_count > 0 {
            self.outward
        } else {
            self.inward
        }
    }

    /// In rows: the triangle after the bin's last.
    fn end(&self) -> u32 {
        if self.inward_count > 0 {
            self.inward + self.inward_count
        } else {
            self.outward + self.outward_count
        }
    }

    fn push_to(&self, ranges: &mut Vec<Range<u32>>) {
        push(ranges, self.outward..self.outward + self.outward_count);
        push(ranges, self.inward..self.inward + self.inward_count);
    }
}

/// Sorts ranges that don't overlap, and joins neighbours.
fn join(ranges: &mut Vec<Range<u32>>) {
    ranges.sort_unstable_by_key(|range| range.start);
    ranges.dedup_by(|next, last| {
        let is_joined = last.end == next.start;
        if is_joined {
            last.end = next.end;
        }
        is_joined
    });
}
