//! `f64` twins of what runs on the GPU: slow, plain, and what every GPU result is compared with.
//! No Bevy render types here.

pub mod cell;
pub mod contribution;
pub mod guard;
pub mod interior;
pub mod occlusion;
mod outcome;
pub mod ray_cast;
pub mod spherical;
pub mod surface;
pub mod terrain_shadow;
pub mod upscale;
