//! What a frame has to do, as numbers; and how much of it any demand on contribution culling leaves.

use core::any::TypeId;

use bevy::{camera::visibility::VisibleEntities, prelude::*};

/// What a frame draws: what its time is predicted from.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Workload {
    /// Entities with a mesh.
    pub objects: f64,
    /// Triangles of their meshes.
    pub triangles: f64,
    /// Sum of their areas, each at most its viewport. units: px²
    pub pixels: f64,
    /// Rays that terrain is cast with.
    pub rays: f64,
}

/// Terms of the cost model: one that is always there, and those of [`Workload`] in their order.
pub const TERMS: usize = 5;

impl Workload {
    /// As many objects as a camera has meshes in view, of which nothing else is known.
    pub(crate) fn objects(visible: &VisibleEntities) -> Self {
        Self {
            objects: visible.get(TypeId::of::<Mesh3d>()).len() as f64,
            ..default()
        }
    }

    /// The terms of the cost model.
    pub fn terms(&self) -> [f64; TERMS] {
        [1.0, self.objects, self.triangles, self.pixels, self.rays]
    }

    /// Each term `by` times as large; the fixed one is not in here.
    pub fn scaled(&self, by: &Self) -> Self {
        Self {
            objects: self.objects * by.objects,
            triangles: self.triangles * by.triangles,
            pixels: self.pixels * by.pixels,
            rays: self.rays * by.rays,
        }
    }

    /// One object that covers so much of a viewport. units: px²
    pub fn object(triangles: u32, area_px2: f32, viewport_px2: f32) -> Self {
        Self {
            objects: 1.0,
            triangles: f64::from(triangles),
            // `min` and `max` pass over what is no number.
            pixels: f64::from(area_px2.min(viewport_px2).max(0.0)),
            rays: 0.0,
        }
    }

    /// As it is.
    pub const UNSCALED: Self = Self {
        objects: 1.0,
        triangles: 1.0,
        pixels: 1.0,
        rays: 1.0,
    };
}

impl core::ops::Add for Workload {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            objects: self.objects + other.objects,
            triangles: self.triangles + other.triangles,
            pixels: self.pixels + other.pixels,
            rays: self.rays + other.rays,
        }
    }
}

impl core::ops::Sub for Workload {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self {
            objects: self.objects - other.objects,
            triangles: self.triangles - other.triangles,
            pixels: self.pixels - other.pixels,
            rays: self.rays - other.rays,
        }
    }
}

/// Bits of a demand's mantissa that tell bins apart: 64 bins an octave, each 1.1 to 1.6 % wide.
const MANTISSA_BITS: u32 = 6;
const SHIFT: u32 = 23 - MANTISSA_BITS;
/// Demands below 2⁻⁶ px² are one bin, and so are those from 2²⁴ px² on, a picture of 4096×4096.
const LOWEST: u32 = ((127 - 6) << 23) >> SHIFT;
const HIGHEST: u32 = ((127 + 24) << 23) >> SHIFT;
/// Bins of an [`DemandProfile`].
pub const BINS: usize = (HIGHEST - LOWEST) as usize + 2;

/// What cameras have in view, by the demand that each object stays up to
/// ([`Standard::stays_up_to_px2`](crate::contribution::rank::Standard::stays_up_to_px2)). The work that a demand leaves is looked up.
///
/// A histogram over the demands' leading bits, so that the edges of bins are exact `f32` numbers and what a demand on
/// an edge keeps is what the culling keeps, but for rounding. Its memory is taken once.
#[derive(Clone, Debug)]
pub struct DemandProfile {
    /// What is in each bin; after [`finish`](Self::finish), what is in it and in all above.
    bins: Vec<Workload>,
    /// Pixels of the picture. units: px²
    picture: f64,
}

impl Default for DemandProfile {
    fn default() -> Self {
        Self {
            bins: vec![Workload::default(); BINS],
            picture: 0.0,
        }
    }
}

impl DemandProfile {
    /// The lowest demand that is in a bin. units: px²
    pub fn edge(bin: usize) -> f32 {
        match bin.min(BINS - 1) {
            0 => 0.0,
            bin => f32::from_bits((LOWEST + bin as u32 - 1) << SHIFT),
        }
    }

    /// The bin of a demand. What is no number counts as infinite.
    pub fn bin(px2: f32) -> usize {
        if px2.is_nan() {
            return BINS - 1;
        }
        // Positive floats are in the order of their bits; negative zero and below are none.
        let bits = px2.max(0.0).to_bits() >> SHIFT;
        match bits {
            bits if bits < LOWEST => 0,
            bits if bits >= HIGHEST => BINS - 1,
            bits => (bits - LOWEST) as usize + 1,
        }
    }

    /// Empties it.
    pub fn clear(&mut self) {
        self.bins.fill(Workload::default());
        self.picture = 0.0;
    }

    /// Adds a picture of so many pixels that objects are seen in. units: px²
    pub fn add_picture(&mut self, px2: f32) {
        if px2.is_finite() {
            self.picture += f64::from(px2.max(0.0));
        }
    }

    /// Adds an object that stays up to a demand.
    pub fn add(&mut self, stays_up_to_px2: f32, work: Workload) {
        let bin = &mut self.bins[Self::bin(stays_up_to_px2)];
        *bin = *bin + work;
    }

    /// Adds what no demand takes away.
    pub fn add_fixed(&mut self, work: Workload) {
        let bin = &mut self.bins[BINS - 1];
        *bin = *bin + work;
    }

    /// Sums up. Until [`clear`](Self::clear) nothing may be added.
    pub fn finish(&mut self) {
        let mut above = Workload::default();
        for bin in self.bins.iter_mut().rev() {
            above = above + *bin;
            *bin = above;
        }
    }

    /// What the lowest demand of a bin keeps.
    pub fn kept(&self, bin: usize) -> Workload {
        self.bins[bin.min(BINS - 1)]
    }

    /// Share of the picture's pixels that go when the demand rises from one bin to another. Objects in front of
    /// each other count twice, so it may exceed 1.
    pub fn loss(&self, from: usize, to: usize) -> f64 {
        let gone = self.kept(from).pixels - self.kept(to).pixels;
        if self.picture > 0.0 {
            gone.max(0.0) / self.picture
        } else {
            0.0
        }
    }

    /// Pixels of the pictures. units: px²
    pub fn picture_px2(&self) -> f64 {
        self.picture
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_demand_is_in_the_bin_whose_edges_enclose_it() {
        let mut area = 1e-4_f32;
        while area < 1e9 {
            let bin = DemandProfile::bin(area);
            assert!(DemandProfile::edge(bin) <= area, "{area}");
            if bin + 1 < BINS {
                assert!(area < DemandProfile::edge(bin + 1), "{area}");
            }
            area *= 1.003;
        }
        for bin in 0..BINS {
            assert_eq!(DemandProfile::bin(DemandProfile::edge(bin)), bin);
        }
        assert_eq!(DemandProfile::bin(f32::INFINITY), BINS - 1);
        assert_eq!(DemandProfile::bin(f32::NAN), BINS - 1);
        assert_eq!(DemandProfile::bin(-3.0), 0);
        assert_eq!(DemandProfile::bin(-0.0), 0);
    }

    #[test]
    fn a_demand_keeps_what_is_not_below_it() {
        let mut profile = DemandProfile::default();
        profile.add_picture(1_000.0);
        for (area, triangles) in [(0.0, 1), (4.0, 10), (16.0, 100), (f32::INFINITY, 1_000)] {
            profile.add(area, Workload::object(triangles, area, 1_000.0));
        }
        profile.add_fixed(Workload {
            rays: 7.0,
            ..Workload::default()
        });
        profile.finish();
        let of = |threshold| profile.kept(DemandProfile::bin(threshold));
        assert_eq!((of(0.0).objects, of(0.0).triangles), (4.0, 1_111.0));
        assert_eq!((of(4.0).objects, of(4.0).triangles), (3.0, 1_110.0));
        assert_eq!((of(16.0).pixels, of(16.0).rays), (1_016.0, 7.0));
        assert_eq!(of(17.0).objects, 1.0);
        let loss = profile.loss(0, DemandProfile::bin(17.0));
        assert!((loss - 0.02).abs() < 1e-12, "{loss}");
    }
}
