//! Systems of the main world, one file or folder a feature; and what those that prepare models share: the `slice` of a
//! frame, `gather` to copy meshes, `background` threads, `submesh` to make meshes of some triangles; and `spans`, by which
//! all tell what their passes took on the GPU.

#[cfg(any(feature = "interior", feature = "spherical"))]
pub(crate) mod background;
#[cfg(feature = "budget")]
pub mod budget;
#[cfg(feature = "culling")]
pub(crate) mod candidates;
#[cfg(feature = "culling")]
pub mod contribution;
#[cfg(feature = "culling")]
pub(crate) mod contribution_fade;
#[cfg(any(feature = "interior", feature = "spherical"))]
pub(crate) mod gather;
#[cfg(feature = "interior")]
pub mod interior;
#[cfg(feature = "culling")]
pub mod occlusion;
#[cfg(feature = "budget")]
pub(crate) mod resolution;
#[cfg(any(feature = "interior", feature = "spherical"))]
pub(crate) mod slice;
#[cfg(any(feature = "budget", feature = "culling", feature = "terrain"))]
pub(crate) mod spans;
#[cfg(feature = "spherical")]
pub mod spherical;
#[cfg(any(feature = "interior", feature = "spherical"))]
pub(crate) mod submesh;
#[cfg(feature = "terrain")]
pub mod terrain;
#[cfg(feature = "terrain")]
pub mod terrain_shadow;
#[cfg(all(feature = "budget", feature = "culling"))]
pub(crate) mod workload_policy;
