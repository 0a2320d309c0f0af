//! Systems of the main world, one file or folder a feature; and what those that prepare models share: [`slice`] of a
//! frame, [`gather`] to copy meshes, [`background`] threads, [`submesh`] to make meshes of some triangles.

pub mod background;
pub mod budget;
pub mod candidates;
pub mod contribution;
pub mod contribution_fade;
pub mod gather;
pub mod interior;
pub mod occlusion;
pub mod slice;
pub mod submesh;
pub mod terrain;
pub mod terrain_shadow;
pub mod workload_policy;
