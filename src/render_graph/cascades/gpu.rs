//! The numbers the shaders read, laid out as they read them.

use bevy::{prelude::*, render::render_resource::ShaderType};

/// Mirrors `Erosion` in `terrain_cascade_erode.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug, Default, PartialEq)]
pub struct GpuCascadeErosion {
    pub(super) size: i32,
    pub(super) reach: i32,
    pub(super) max_push: f32,
    pub(super) slack: f32,
}

/// Mirrors `Cascade` in `terrain_cascade.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug, Default, PartialEq)]
pub struct GpuCascadeWrite {
    pub(super) offset: Vec2,
    pub(super) scale: f32,
    pub(super) depth_scale: f32,
    pub(super) depth_offset: f32,
    pub(super) edge: f32,
}
