//! Terrain.

mod height_field;
mod loader;
mod pyramid;
mod query;

pub use height_field::{
    Changed as HeightFieldChanged, HeightField, HeightFieldError, HeightSamples,
};
pub use loader::{
    HeightFieldLoadError, HeightFieldLoader, HeightFieldNote, HeightFieldPlugin,
    HeightFieldSettings, VoidHandling, decode_height_field, read_height_field,
};
pub use pyramid::{MinMaxPyramid, PyramidNodes};
pub use query::{HeightFieldHit, HeightFieldHitF64, HitSide, TerrainHit, TerrainQuery};

use bevy::prelude::*;

/// Shows a height field.
#[derive(Component, Reflect)]
#[reflect(Component)]
pub struct Terrain {
    /// The heights.
    pub height_field: Handle<HeightField>,
}

impl Terrain {
    /// Shows `height_field`.
    pub fn new(height_field: Handle<HeightField>) -> Self {
        Self { height_field }
    }
}
