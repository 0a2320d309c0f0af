//! Terrain.
pub mod reference;
pub mod terrain;
