//! Terrain.

mod height_field;
mod pyramid;

pub use height_field::{Changed, HeightField, HeightFieldError, HeightSamples};
pub use pyramid::{MinMaxPyramid, PyramidNodes};

use bevy::prelude::*;

/// Shows a height field.
#[derive(Component, Reflect)]
#[reflect(Component)]
pub struct Terrain {
    /// The heights.
    pub height_field: Handle<HeightField>,
}
