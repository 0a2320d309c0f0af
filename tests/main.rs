//! The one integration-test binary.

#[path = "it/height_field.rs"]
mod height_field;
#[path = "it/loader.rs"]
mod loader;
#[path = "it/query.rs"]
mod query;
#[path = "it/terrain_scenes.rs"]
mod terrain_scenes;
#[path = "it/twin.rs"]
mod twin;
#[cfg(feature = "cli")]
#[path = "it/cli.rs"]
mod cli;
