//! What effects that calculate in `f64` for `f32` have in common.

use bevy::math::{Affine3A, DAffine3, Mat4};

/// Half the distance from 1 to the next `f32`.
pub const UNIT_ROUNDOFF: f64 = 1.0 / (1u64 << 24) as f64;

/// A matrix that is affine up to its last row, in double precision.
pub fn affine64(affine: Affine3A) -> DAffine3 {
    DAffine3::from_mat4(Mat4::from(affine).as_dmat4())
}
