//! The one integration-test binary.

#[path = "it/terrain_scenes.rs"]
mod terrain_scenes;
#[path = "it/twin.rs"]
mod twin;
