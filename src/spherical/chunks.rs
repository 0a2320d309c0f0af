//! What is really drawn: runs of the reordered triangles that are drawn or left out whole.
//!
//! # When a chunk is left out
//! If all its triangles are seen from behind. Corners are off by up to δ on the way to the screen ([`View`]), so that
//! a triangle seen nearly edge-on may be drawn although its back is turned to the eye. Let *a* be its least altitude
//! (twice its area over its longest side), *h* the eye's distance behind its plane and *D* that to its farthest
//! corner. It is left out only if
//!
//! *h*·*a* > 1½·δ·(*a* + 2·*D*).
//!
//! Why that is enough: if corners off by δ turn it round, then on the way there they are once in one plane with the
//! eye. So there is a plane through the eye, with unit normal *q*, that all three corners are within δ of. The
//! distance from it changes by at most 2δ over the altitude: along the triangle's own plane it grows by at most *s* =
//! 2δ/*a* a unit. That is the length of *q*'s part in the triangle's plane, and the other part has the length √(1 −
//! *s*²). At a corner, √(1 − *s*²)·*h* ≤ δ + *s*·*D*. From the condition and *h* ≤ *D* follows *a* > 3δ, *s* < ⅔, and
//! 1/√(1 − *s*²) < 1½: then the condition and this can't both hold. ∎ For an orthographic camera the same way: 1½·2δ
//! < *a*·|cosine to the normal|.
//!
//! Triangles that have no altitude to speak of are thus never left out; those with two corners at one place never are
//! drawn by any rasteriser, and don't count.
//!
//! # Limits
//! A triangle that the rasteriser cuts at the sides of the picture may be told by its parts. Parts narrower than the
//! grid of sub-pixels can turn round where the whole can't; what they cover then is not taken into account. What
//! comes as near as a perspective camera's near plane is always drawn.

use core::ops::Range;

use bevy::math::{DVec3, DVec4, Vec4};

use super::{
    error::SphericalError,
    maps::{SphericalMaps, corners},
    view::View,
};

/// The factor of the condition; at least √2.
const FACTOR: f64 = 1.5;
/// By how much a plane's product with the eye is off: three numbers of the plane's and the eye's each, in all not
/// longer than 1, and one more pair below 1. Plane and eye are rounded once, then come four products and three sums:
/// 6 roundings of 2, taken for 8.
const PLANE_ROUNDING: f64 = 16.0 / (1 << 24) as f64;
/// An altitude smaller than that, by the longest side, can't be told from none: in `f64` it is off by up to 2⁻⁵¹ of
/// that side, and its direction by 2⁻²⁴ of 1.
const FLAT: f64 = 1e-8;
/// Wider cones than that, by their cosine, are not worth a test.
const WIDE: f64 = 0.1;
/// Planes looked at between two questions whether that is enough.
const BATCH: usize = 16;

/// Triangles that are drawn together.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    /// In the reordered index buffer. units: triangles
    pub triangles: Range<u32>,
    /// The box around its corners; exactly. space: mesh
    pub least: [f32; 3],
    /// The box around its corners; exactly. space: mesh
    pub greatest: [f32; 3],
    /// The box's middle.
    centre: DVec3,
    /// From there to the farthest corner, no less.
    radius: f64,
    /// The greatest altitude of all.
    altitude: f64,
    /// The least; 0 if one has none to speak of.
    thinnest: f64,
    /// Around all normals; of length 1.
    cone_axis: DVec3,
    /// Of half its opening, no more; −1 if there is no cone.
    cone_cos: f64,
    planes: Range<u32>,
}

/// A mesh cut into chunks.
#[derive(Clone, Debug, Default)]
pub struct SphericalChunks {
    chunks: Vec<Chunk>,
    /// The farthest corner from the mesh's origin, no less.
    reach: f64,
    /// The planes, by coordinate: the normal times the altitude, by the chunk's greatest altitude; and how far it is
    /// from the chunk's middle, times and by the same, and by the chunk's radius. So no number exceeds 1.
    planes: [Vec<f32>; 4],
}

impl SphericalChunks {
    /// Of the mesh that the maps were made of.
    ///
    /// # Errors
    /// [`SphericalError`] if it is another.
    pub fn build(
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        maps: &SphericalMaps,
    ) -> Result<Self, SphericalError> {
        let corners = corners(positions, triangles)?;
        let mut made = Self {
            reach: (maps.centre.length() + maps.radius) * (1.0 + 1e-12),
            ..Self::default()
        };
        for cut in maps.cuts.windows(2) {
            let run = cut[0]..cut[1];
            let of_run: Vec<[DVec3; 3]> = maps
                .order
                .get(run.start as usize..run.end as usize)
                .unwrap_or_default()
                .iter()
                .filter_map(|&triangle| corners.get(triangle as usize).copied())
                .collect();
            if !of_run.is_empty() {
                made.add(run, &of_run);
            }
        }
        Ok(made)
    }

    fn add(&mut self, run: Range<u32>, corners: &[[DVec3; 3]]) {
        let (mut least, mut greatest) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &corner in corners.iter().flatten() {
            least = least.min(corner);
            greatest = greatest.max(corner);
        }
        let centre = (least + greatest) / 2.0;
        let radius = corners
            .iter()
            .flatten()
            .map(|corner| (corner - centre).length())
            .fold(0.0, f64::max)
            * (1.0 + 1e-12);
        let shapes: Vec<Shape> = corners.iter().filter_map(Shape::new).collect();
        let altitude = shapes
            .iter()
            .map(|shape| shape.altitude)
            .fold(0.0, f64::max);
        let thinnest = shapes
            .iter()
            .map(|shape| shape.altitude)
            .fold(altitude, f64::min);
        let axis = shapes
            .iter()
            .map(|shape| shape.normal)
            .sum::<DVec3>()
            .normalize_or_zero();
        let cos = shapes
            .iter()
            .map(|shape| shape.normal.dot(axis))
            .fold(1.0, f64::min);
        let first = self.planes[0].len() as u32;
        for shape in &shapes {
            let plane = if shape.altitude > 0.0 {
                let normal = shape.normal * (shape.altitude / altitude);
                normal.extend(-normal.dot((shape.corner - centre) / radius))
            } else {
                DVec4::ZERO
            };
            for (numbers, number) in self.planes.iter_mut().zip(plane.to_array()) {
                numbers.push(number as f32);
            }
        }
        self.chunks.push(Chunk {
            triangles: run,
            least: least.to_array().map(|number| number as f32),
            greatest: greatest.to_array().map(|number| number as f32),
            centre,
            radius,
            altitude,
            thinnest,
            cone_axis: axis,
            cone_cos: if cos > WIDE { cos - 1e-9 } else { -1.0 },
            planes: first..self.planes[0].len() as u32,
        });
    }

    /// The chunks, in the order of their triangles.
    pub fn chunks(&self) -> &[Chunk] {
        &self.chunks
    }

    /// The farthest that a corner is from the mesh's origin: what [`View::new`] asks for. units: the mesh's
    pub const fn reach(&self) -> f64 {
        self.reach
    }

    /// What they take. units: bytes
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.chunks)
            + self
                .planes
                .iter()
                .map(|numbers| size_of_val(&**numbers))
                .sum::<usize>()
    }

    /// Whether a chunk shows the eye anything: `false` only if no triangle of it can be drawn, being seen from behind.
    /// It errs towards `true`; the head of this file says what a chunk is left out by.
    pub fn faces_eye(&self, chunk: &Chunk, view: &View) -> bool {
        if view.is_any {
            return true;
        }
        if chunk.planes.is_empty() {
            return false;
        }
        // The eye from the chunk's middle in units of its radius, shortened to at most 1; its blur in the same units.
        let (eye, limit) = if view.eye.w == 0.0 {
            let blur = 2.0 * view.offset;
            match chunk.by_cone(view, view.eye.truncate(), 0.0, blur / chunk.thinnest) {
                Some(answer) => return answer,
                None => (view.eye, blur / chunk.altitude),
            }
        } else {
            let way = view.eye.truncate() - chunk.centre;
            let distance = way.length();
            if distance - chunk.radius <= view.near
                && chunk.distance(view.eye.truncate()) <= view.near
            {
                return true;
            }
            let farthest = distance + chunk.radius;
            let blur = view.blur(farthest);
            let guard = blur * (1.0 + 2.0 * farthest / chunk.thinnest);
            if let Some(answer) = chunk.by_cone(view, way, chunk.radius, guard) {
                return answer;
            }
            let scale = chunk.radius.max(distance);
            let guard = blur * (1.0 + 2.0 * farthest / chunk.altitude);
            ((way / scale).extend(chunk.radius / scale), guard / scale)
        };
        let limit = FACTOR * limit + PLANE_ROUNDING;
        // No product exceeds 2; and if anything is no number, nothing is known.
        let can_tell = limit < 2.0;
        !can_tell || self.any_above(chunk, (eye * view.sign).as_vec4(), -limit as f32)
    }

    /// Whether the product of any of a chunk's planes with the eye is above the limit.
    fn any_above(&self, chunk: &Chunk, eye: Vec4, limit: f32) -> bool {
        let range = chunk.planes.start as usize..chunk.planes.end as usize;
        let [x, y, z, w] = &self.planes;
        let (Some(x), Some(y), Some(z), Some(w)) = (
            x.get(range.clone()),
            y.get(range.clone()),
            z.get(range.clone()),
            w.get(range),
        ) else {
            return true;
        };
        let (x, y) = (x.chunks(BATCH), y.chunks(BATCH));
        let (z, w) = (z.chunks(BATCH), w.chunks(BATCH));
        x.zip(y).zip(z.zip(w)).any(|((x, y), (z, w))| {
            let mut is_above = false;
            for (((x, y), z), w) in x.iter().zip(y).zip(z).zip(w) {
                is_above |= x * eye.x + y * eye.y + z * eye.z + w * eye.w > limit;
            }
            is_above
        })
    }

    /// Whether a chunk's box has a part inside all half-spaces; `true` if it is too close to tell. The half-spaces
    /// are in the mesh's space, see [`half_space_in_local`](super::half_space_in_local); corners may be off as in
    /// [`View`].
    pub fn in_frustum(&self, chunk: &Chunk, half_spaces: &[DVec4], view: &View) -> bool {
        let distance = if view.eye.w == 0.0 {
            0.0
        } else {
            (view.eye.truncate() - chunk.centre).length() + chunk.radius
        };
        // Rounding in `f64`: four products and sums of at most the magnitudes that are in `magnitude`.
        let magnitude = self.reach + chunk.radius;
        let slack = view.blur(distance);
        let (least, greatest) = (place(chunk.least), place(chunk.greatest));
        half_spaces.iter().all(|half_space| {
            let normal = half_space.truncate();
            let farthest = DVec3::select(normal.cmpge(DVec3::ZERO), greatest, least);
            let rounding = 1e-14 * (normal.length() * magnitude + half_space.w.abs());
            let outside = -(normal.dot(farthest) + half_space.w);
            let is_outside = outside > slack * normal.length() + rounding;
            !is_outside
        })
    }

    /// The ranges of the reordered triangles that are to be drawn, in order, neighbours joined. Returns how many
    /// triangles they hold.
    ///
    /// `ranges` is cleared first; with room for a range a chunk it doesn't grow.
    pub fn select(
        &self,
        view: &View,
        half_spaces: &[DVec4],
        ranges: &mut Vec<Range<u32>>,
    ) -> usize {
        ranges.clear();
        let mut count = 0;
        for chunk in &self.chunks {
            if self.in_frustum(chunk, half_spaces, view) && self.faces_eye(chunk, view) {
                count += chunk.triangles.len();
                push(ranges, chunk.triangles.clone());
            }
        }
        count
    }
}

/// Adds a range, joined to the last if that ends where it begins.
pub(super) fn push(ranges: &mut Vec<Range<u32>>, range: Range<u32>) {
    match ranges.last_mut() {
        Some(last) if last.end == range.start => last.end = range.end,
        _ if range.is_empty() => {}
        _ => ranges.push(range),
    }
}

fn place(place: [f32; 3]) -> DVec3 {
    DVec3::from_array(place.map(f64::from))
}

impl Chunk {
    /// From a place to the box.
    fn distance(&self, from: DVec3) -> f64 {
        (from - from.clamp(place(self.least), place(self.greatest))).length()
    }

    /// Whether any triangle may be seen from its shown side, as far as the cone around the normals tells it. `way` is
    /// towards the eye; planes are up to `radius` away from where it begins, and what is not farther behind than the
    /// guard is not known to be behind.
    fn by_cone(&self, view: &View, way: DVec3, radius: f64, guard: f64) -> Option<bool> {
        if self.cone_cos < 0.0 {
            return None;
        }
        let length = way.length();
        let along = way.dot(self.cone_axis) * view.sign;
        let across = (length * length - along * along).max(0.0).sqrt();
        let sin = (1.0 - self.cone_cos * self.cone_cos).sqrt();
        let rounding = 1e-7 * length;
        if along * self.cone_cos - across * sin > radius + rounding {
            return Some(true);
        }
        let is_outside = along < length * self.cone_cos;
        let most = along * self.cone_cos + across * sin;
        (is_outside && most + radius + rounding < -FACTOR * guard).then_some(false)
    }
}

/// What the test needs of a triangle.
struct Shape {
    corner: DVec3,
    /// Of length 1, or 0.
    normal: DVec3,
    /// 0 if it can't be told from none.
    altitude: f64,
}

impl Shape {
    /// `None` of a triangle with two corners at one place.
    fn new(&[a, b, c]: &[DVec3; 3]) -> Option<Self> {
        if a == b || b == c || c == a {
            return None;
        }
        let longest = [b - a, c - b, a - c]
            .map(DVec3::length)
            .into_iter()
            .fold(0.0, f64::max);
        // Sides by the longest, so that no product is lost.
        let normal = ((b - a) / longest).cross((c - a) / longest);
        let altitude = normal.length();
        Some(if altitude > FLAT {
            Self {
                corner: a,
                normal: normal / altitude,
                altitude: altitude * longest,
            }
        } else {
            Self {
                corner: a,
                normal: DVec3::ZERO,
                altitude: 0.0,
            }
        })
    }
}
