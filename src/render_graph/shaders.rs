//! The WGSL of `assets/shaders/`, embedded in the binary. Registered and loaded from this one file, because
//! an embedded asset's path depends on the file that names it. All but `interior_field.wgsl`: see
//! [`crate::interior::gpu::INTERIOR_FIELD_WGSL`].

use bevy::{
    asset::{AssetServer, embedded_asset, load_embedded_asset},
    prelude::*,
    shader::{Shader, load_shader_library},
};

/// Registers every shader with the app. Small: text in memory, compiled only when a pass first needs it.
pub fn embed(app: &mut App) {
    load_shader_library!(app, "../../assets/shaders/types.wgsl");
    load_shader_library!(app, "../../assets/shaders/height_field.wgsl");
    load_shader_library!(app, "../../assets/shaders/rays.wgsl");
    load_shader_library!(app, "../../assets/shaders/view_rays.wgsl");
    load_shader_library!(app, "../../assets/shaders/traverse.wgsl");
    load_shader_library!(app, "../../assets/shaders/boxes.wgsl");
    load_shader_library!(app, "../../assets/shaders/surface.wgsl");
    load_shader_library!(app, "../../assets/shaders/placement.wgsl");
    load_shader_library!(app, "../../assets/shaders/fullscreen.wgsl");
    load_shader_library!(app, "../../assets/shaders/shadow_tiles.wgsl");
    load_shader_library!(app, "../../assets/shaders/light_rays.wgsl");
    load_shader_library!(app, "../../assets/shaders/visibility.wgsl");
    load_shader_library!(app, "../../assets/shaders/terrain_lighting.wgsl");
    load_shader_library!(app, "../../assets/shaders/clip.wgsl");
    load_shader_library!(app, "../../assets/shaders/occludee.wgsl");
    load_shader_library!(app, "../../assets/shaders/contribution_area.wgsl");
    embedded_asset!(app, "../../assets/shaders/contribution.wgsl");
    embedded_asset!(app, "../../assets/shaders/depth_reduce.wgsl");
    embedded_asset!(app, "../../assets/shaders/late_draws.wgsl");
    embedded_asset!(app, "../../assets/shaders/height_mips.wgsl");
    embedded_asset!(app, "../../assets/shaders/subdivide.wgsl");
    embedded_asset!(app, "../../assets/shaders/box_entry.wgsl");
    embedded_asset!(app, "../../assets/shaders/beam.wgsl");
    embedded_asset!(app, "../../assets/shaders/ray_cast.wgsl");
    embedded_asset!(app, "../../assets/shaders/terrain_depth.wgsl");
    embedded_asset!(app, "../../assets/shaders/terrain_shade.wgsl");
    embedded_asset!(app, "../../assets/shaders/terrain_shadow.wgsl");
    embedded_asset!(app, "../../assets/shaders/shadow_sweep.wgsl");
    embedded_asset!(app, "../../assets/shaders/shadow_mips.wgsl");
    embedded_asset!(app, "../../assets/shaders/terrain_cascade_erode.wgsl");
    embedded_asset!(app, "../../assets/shaders/terrain_cascade.wgsl");
    embedded_asset!(app, "../../assets/shaders/occludee_verdicts.wgsl");
    embedded_asset!(app, "../../assets/shaders/upscale.wgsl");
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
            height_mips: load_embedded_asset!(assets, "../../assets/shaders/height_mips.wgsl"),
            subdivide: load_embedded_asset!(assets, "../../assets/shaders/subdivide.wgsl"),
            box_entry: load_embedded_asset!(assets, "../../assets/shaders/box_entry.wgsl"),
            beam: load_embedded_asset!(assets, "../../assets/shaders/beam.wgsl"),
            ray_cast: load_embedded_asset!(assets, "../../assets/shaders/ray_cast.wgsl"),
            terrain_depth: load_embedded_asset!(assets, "../../assets/shaders/terrain_depth.wgsl"),
            terrain_shade: load_embedded_asset!(assets, "../../assets/shaders/terrain_shade.wgsl"),
            terrain_shadow: load_embedded_asset!(
                assets,
                "../../assets/shaders/terrain_shadow.wgsl"
            ),
            shadow_sweep: load_embedded_asset!(assets, "../../assets/shaders/shadow_sweep.wgsl"),
            shadow_mips: load_embedded_asset!(assets, "../../assets/shaders/shadow_mips.wgsl"),
            terrain_cascade_erode: load_embedded_asset!(
                assets,
                "../../assets/shaders/terrain_cascade_erode.wgsl"
            ),
            terrain_cascade: load_embedded_asset!(
                assets,
                "../../assets/shaders/terrain_cascade.wgsl"
            ),
        }
    }
}

/// `depth_reduce.wgsl`.
pub fn depth_reduce(assets: &AssetServer) -> Handle<Shader> {
    load_embedded_asset!(assets, "../../assets/shaders/depth_reduce.wgsl")
}

/// `late_draws.wgsl`.
pub fn late_draws(assets: &AssetServer) -> Handle<Shader> {
    load_embedded_asset!(assets, "../../assets/shaders/late_draws.wgsl")
}

/// The one entry point that needs no terrain.
pub fn occludee_verdicts(assets: &AssetServer) -> Handle<Shader> {
    load_embedded_asset!(assets, "../../assets/shaders/occludee_verdicts.wgsl")
}

/// `contribution.wgsl`.
pub fn contribution(assets: &AssetServer) -> Handle<Shader> {
    load_embedded_asset!(assets, "../../assets/shaders/contribution.wgsl")
}

/// `upscale.wgsl`.
pub fn upscale(assets: &AssetServer) -> Handle<Shader> {
    load_embedded_asset!(assets, "../../assets/shaders/upscale.wgsl")
}
