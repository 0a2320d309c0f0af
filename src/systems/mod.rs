//! Systems of the main world, one file or folder a feature; and what those that prepare models share: the `slice` of a
//! frame, `gather` to copy meshes, `background` threads, `submesh` to make meshes of some triangles; and `spans`, by which
//! all tell what their passes took on the GPU.

pub(crate) mod background;
pub mod budget;
pub mod candidates;
pub mod contribution;
pub mod contribution_fade;
pub(crate) mod gather;
pub mod interior;
pub mod occlusion;
pub(crate) mod slice;
pub(crate) mod spans;
pub mod spherical;
pub(crate) mod submesh;
pub mod terrain;
pub mod terrain_shadow;
pub mod workload_policy;
