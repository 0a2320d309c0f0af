//! The WGSL of `assets/shaders/`, embedded in the binary, by the feature that it is for. All but `interior_field.wgsl`:
//! see `INTERIOR_FIELD_WGSL` in `crate::interior::gpu`.
//!
//! A shader is registered and loaded from one file, because an embedded asset's path depends on the file that names it.
//! Registering is small: text in memory, compiled only when a pass first needs it; doing it twice changes nothing.

#[cfg(feature = "culling")]
pub mod culling;
#[cfg(feature = "terrain")]
pub mod terrain;
#[cfg(feature = "budget")]
pub mod upscale;

use bevy::{prelude::*, shader::load_shader_library};

/// What passes over the whole picture share.
fn embed_fullscreen(app: &mut App) {
    load_shader_library!(app, "../../assets/shaders/fullscreen.wgsl");
}
