//! Terrain.
pub mod terrain;
