//! What the demo shows: a landscape made by code, and a scene around any height field.

pub mod landscape;
pub mod scene;
