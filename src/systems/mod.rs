//! Systems of the main world, one file a feature.

pub mod terrain;
