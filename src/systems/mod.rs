//! Systems of the main world, one file a feature.

pub mod occlusion;
pub mod terrain;
pub mod terrain_shadow;
