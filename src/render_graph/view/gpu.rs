//! The numbers the shaders read, laid out as they read them.

use bevy::{math::Mat3, prelude::*, render::render_resource::ShaderType};

use crate::terrain::{TerrainColour, TerrainLook};

/// Flags of `TerrainView`; as in `types.wgsl`.
pub(super) mod flag {
    pub const STARTS_IN_AIR: u32 = 1;
    pub const BASEMENT: u32 = 2;
    pub const FIRST: u32 = 4;
    pub const MIRRORED: u32 = 8;
}

/// Mirrors `TerrainView` in `types.wgsl`, field by field.
#[derive(ShaderType, Clone, Copy, Debug, Default)]
pub struct GpuTerrainView {
    pub(super) origin: Vec3,
    pub(super) t_base: f32,
    pub(super) origin_dx: Vec3,
    pub(super) t_far: f32,
    pub(super) origin_dy: Vec3,
    pub(super) lod_a: f32,
    pub(super) direction: Vec3,
    pub(super) lod_b: f32,
    pub(super) direction_dx: Vec3,
    pub(super) y_max: f32,
    pub(super) direction_dy: Vec3,
    pub(super) y_min: f32,
    pub(super) depth: Vec4,
    pub(super) beam_a: Vec3,
    pub(super) anchor_y: f32,
    pub(super) beam_b: Vec3,
    pub(super) max_error_px: f32,
    pub(super) beam_slack: Vec3,
    pub(super) y_magnitude: f32,
    pub(super) anchor: IVec2,
    pub(super) size_px: UVec2,
    pub(super) flags: u32,
    pub(super) terrain_id: u32,
    pub(super) traversal: u32,
    pub(super) box_level: u32,
    pub(super) tile_px: u32,
    pub(super) box_area_px: f32,
    pub(super) box_capacity: u32,
    pub(super) pixel_a: f32,
    pub(super) pixel_b: f32,
    pub(super) clip_from_grid: Mat4,
    pub(super) depth_from_grid: Vec4,
    pub(super) frustum: [Vec4; 6],
    pub(super) viewport_px: UVec2,
}

/// Mirrors `Placement` in `placement.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug, Default)]
pub struct GpuPlacement {
    pub(super) world_from_grid: Mat4,
    pub(super) normal_from_grid: Mat3,
    pub(super) clip_from_grid: Mat4,
    pub(super) previous_clip_from_grid: Mat4,
    pub(super) viewport_px: Vec2,
}

/// Mirrors `Look` in `terrain_shade.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug, Default)]
pub struct GpuTerrainLook {
    pub(super) colours: [Vec4; 4],
    pub(super) edges: Vec4,
    pub(super) perceptual_roughness: f32,
    pub(super) metallic: f32,
    pub(super) reflectance: f32,
    pub(super) textured: u32,
}

pub(super) fn gpu_look(look: &TerrainLook, (lowest, highest): (f64, f64)) -> GpuTerrainLook {
    let linear = |colour: Color| colour.to_linear().to_vec4();
    let (colours, edges, textured) = match &look.colour {
        TerrainColour::Bands {
            colours,
            edges,
            blend,
        } => {
            // A flat field is all one band, whatever rounding does to its height.
            let span = (highest - lowest).max(1e-5 * lowest.abs().max(1.0));
            let at = |share: f32| (lowest + f64::from(share) * span) as f32;
            (
                colours.map(linear),
                Vec4::new(
                    at(edges[0]),
                    at(edges[1]),
                    at(edges[2]),
                    (f64::from(*blend) * span) as f32,
                ),
                0,
            )
        }
        TerrainColour::Uniform(colour) => ([linear(*colour); 4], Vec4::new(0.0, 0.0, 0.0, 1.0), 0),
        TerrainColour::Albedo(_) => ([Vec4::ONE; 4], Vec4::new(0.0, 0.0, 0.0, 1.0), 1),
    };
    GpuTerrainLook {
        colours,
        edges,
        perceptual_roughness: look.perceptual_roughness.clamp(0.089, 1.0),
        metallic: look.metallic.clamp(0.0, 1.0),
        reflectance: look.reflectance.clamp(0.0, 1.0),
        textured,
    }
}
