//! `f64` twins of what runs on the GPU: slow, plain, and what every GPU result is compared with.
//! No Bevy render types here.

#[cfg(feature = "terrain")]
pub(crate) mod cell;
#[cfg(feature = "culling")]
pub mod contribution;
#[cfg(feature = "terrain")]
pub mod guard;
#[cfg(feature = "interior")]
pub mod interior;
#[cfg(feature = "culling")]
pub mod occlusion;
mod outcome;
#[cfg(feature = "terrain")]
pub mod ray_cast;
#[cfg(feature = "spherical")]
pub mod spherical;
#[cfg(feature = "terrain")]
pub(crate) mod surface;
#[cfg(feature = "terrain")]
pub mod terrain_shadow;
#[cfg(feature = "budget")]
pub mod upscale;
