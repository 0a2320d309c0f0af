//! The shader that stretches what was drawn.

use bevy::{
    asset::{AssetServer, embedded_asset, load_embedded_asset},
    prelude::*,
    shader::Shader,
};

/// Registers it with the app.
pub fn embed(app: &mut App) {
    super::embed_fullscreen(app);
    embedded_asset!(app, "../../../assets/shaders/upscale.wgsl");
}

/// `upscale.wgsl`.
pub fn upscale(assets: &AssetServer) -> Handle<Shader> {
    load_embedded_asset!(assets, "../../../assets/shaders/upscale.wgsl")
}
