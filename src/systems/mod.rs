//! Systems of the main world, one file a feature.

pub mod budget;
pub mod candidates;
pub mod contribution;
pub mod contribution_fade;
pub mod interior;
pub mod occlusion;
pub mod terrain;
pub mod terrain_shadow;
pub mod workload_policy;
