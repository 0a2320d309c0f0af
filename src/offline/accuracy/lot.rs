//! Numbers drawn by lot, the same ones each time.

use bevy::math::{DVec3, UVec2};

/// A source of numbers (splitmix64; Steele, Lea and Flood 2014).
pub(super) struct Lot(pub u64);

impl Lot {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    }

    /// A texel of a picture of this size.
    pub(super) fn texel(&mut self, size: UVec2) -> UVec2 {
        let mut below = |n: u32| (self.next() % u64::from(n)) as u32;
        UVec2::new(below(size.x), below(size.y))
    }

    /// From `least` to below `greatest`.
    pub(super) fn between(&mut self, least: f64, greatest: f64) -> f64 {
        least + (greatest - least) * ((self.next() >> 11) as f64 / (1_u64 << 53) as f64)
    }

    /// A direction, all alike.
    pub(super) fn direction(&mut self) -> DVec3 {
        let z = self.between(-1.0, 1.0);
        let turn = self.between(0.0, core::f64::consts::TAU);
        let across = (1.0 - z * z).max(0.0).sqrt();
        DVec3::new(across * turn.cos(), z, across * turn.sin())
    }
}
