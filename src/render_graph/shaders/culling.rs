//! The shaders of contribution culling and occlusion culling.

use bevy::{
    asset::{AssetServer, embedded_asset, load_embedded_asset},
    prelude::*,
    shader::{Shader, load_shader_library},
};

/// Registers them with the app.
pub fn embed(app: &mut App) {
    load_shader_library!(app, "../../../assets/shaders/clip.wgsl");
    load_shader_library!(app, "../../../assets/shaders/occludee.wgsl");
    load_shader_library!(app, "../../../assets/shaders/contribution_area.wgsl");
    embedded_asset!(app, "../../../assets/shaders/contribution.wgsl");
    embedded_asset!(app, "../../../assets/shaders/depth_reduce.wgsl");
    embedded_asset!(app, "../../../assets/shaders/late_draws.wgsl");
    embedded_asset!(app, "../../../assets/shaders/occludee_verdicts.wgsl");
}

/// `depth_reduce.wgsl`.
pub fn depth_reduce(assets: &AssetServer) -> Handle<Shader> {
    load_embedded_asset!(assets, "../../../assets/shaders/depth_reduce.wgsl")
}

/// `late_draws.wgsl`.
pub fn late_draws(assets: &AssetServer) -> Handle<Shader> {
    load_embedded_asset!(assets, "../../../assets/shaders/late_draws.wgsl")
}

/// `occludee_verdicts.wgsl`.
pub fn occludee_verdicts(assets: &AssetServer) -> Handle<Shader> {
    load_embedded_asset!(assets, "../../../assets/shaders/occludee_verdicts.wgsl")
}

/// `contribution.wgsl`.
pub fn contribution(assets: &AssetServer) -> Handle<Shader> {
    load_embedded_asset!(assets, "../../../assets/shaders/contribution.wgsl")
}
