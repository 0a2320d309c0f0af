//! The shaders of terrain and its shadows.

use bevy::{
    asset::{AssetServer, embedded_asset, load_embedded_asset},
    prelude::*,
    shader::{Shader, load_shader_library},
};

/// Registers them with the app.
pub fn embed(app: &mut App) {
    super::embed_fullscreen(app);
    load_shader_library!(app, "../../../assets/shaders/types.wgsl");
    load_shader_library!(app, "../../../assets/shaders/height_field.wgsl");
    load_shader_library!(app, "../../../assets/shaders/rays.wgsl");
    load_shader_library!(app, "../../../assets/shaders/view_rays.wgsl");
    load_shader_library!(app, "../../../assets/shaders/traverse.wgsl");
    load_shader_library!(app, "../../../assets/shaders/boxes.wgsl");
    load_shader_library!(app, "../../../assets/shaders/surface.wgsl");
    load_shader_library!(app, "../../../assets/shaders/placement.wgsl");
    load_shader_library!(app, "../../../assets/shaders/shadow_tiles.wgsl");
    load_shader_library!(app, "../../../assets/shaders/light_rays.wgsl");
    load_shader_library!(app, "../../../assets/shaders/visibility.wgsl");
    load_shader_library!(app, "../../../assets/shaders/terrain_lighting.wgsl");
    embedded_asset!(app, "../../../assets/shaders/height_mips.wgsl");
    embedded_asset!(app, "../../../assets/shaders/subdivide.wgsl");
    embedded_asset!(app, "../../../assets/shaders/box_entry.wgsl");
    embedded_asset!(app, "../../../assets/shaders/beam.wgsl");
    embedded_asset!(app, "../../../assets/shaders/ray_cast.wgsl");
    embedded_asset!(app, "../../../assets/shaders/terrain_depth.wgsl");
    embedded_asset!(app, "../../../assets/shaders/terrain_shade.wgsl");
    embedded_asset!(app, "../../../assets/shaders/terrain_shadow.wgsl");
    embedded_asset!(app, "../../../assets/shaders/shadow_sweep.wgsl");
    embedded_asset!(app, "../../../assets/shaders/shadow_mips.wgsl");
    embedded_asset!(app, "../../../assets/shaders/terrain_cascade_erode.wgsl");
    embedded_asset!(app, "../../../assets/shaders/terrain_cascade.wgsl");
}

/// Handles to the entry points.
#[derive(Clone)]
pub struct Shaders {
    pub height_mips: Handle<Shader>,
    pub subdivide: Handle<Shader>,
    pub box_entry: Handle<Shader>,
    pub beam: Handle<Shader>,
    pub ray_cast: Handle<Shader>,
    pub terrain_depth: Handle<Shader>,
    pub terrain_shade: Handle<Shader>,
    pub terrain_shadow: Handle<Shader>,
    pub shadow_sweep: Handle<Shader>,
    pub shadow_mips: Handle<Shader>,
    pub terrain_cascade_erode: Handle<Shader>,
    pub terrain_cascade: Handle<Shader>,
}

impl Shaders {
    pub fn load(assets: &AssetServer) -> Self {
        Self {
            height_mips: load_embedded_asset!(assets, "../../../assets/shaders/height_mips.wgsl"),
            subdivide: load_embedded_asset!(assets, "../../../assets/shaders/subdivide.wgsl"),
            box_entry: load_embedded_asset!(assets, "../../../assets/shaders/box_entry.wgsl"),
            beam: load_embedded_asset!(assets, "../../../assets/shaders/beam.wgsl"),
            ray_cast: load_embedded_asset!(assets, "../../../assets/shaders/ray_cast.wgsl"),
            terrain_depth: load_embedded_asset!(
                assets,
                "../../../assets/shaders/terrain_depth.wgsl"
            ),
            terrain_shade: load_embedded_asset!(
                assets,
                "../../../assets/shaders/terrain_shade.wgsl"
            ),
            terrain_shadow: load_embedded_asset!(
                assets,
                "../../../assets/shaders/terrain_shadow.wgsl"
            ),
            shadow_sweep: load_embedded_asset!(assets, "../../../assets/shaders/shadow_sweep.wgsl"),
            shadow_mips: load_embedded_asset!(assets, "../../../assets/shaders/shadow_mips.wgsl"),
            terrain_cascade_erode: load_embedded_asset!(
                assets,
                "../../../assets/shaders/terrain_cascade_erode.wgsl"
            ),
            terrain_cascade: load_embedded_asset!(
                assets,
                "../../../assets/shaders/terrain_cascade.wgsl"
            ),
        }
    }
}
