// Where a terrain stands in the world, for the passes that leave grid space.
#define_import_path bevy_skyline::placement

/// Mirrors `GpuPlacement`. Grid space is relative to the anchor of the same frame.
struct Placement {
    world_from_grid: mat4x4<f32>,
    /// Inverse transpose of the linear part, scaled to keep its terms near one.
    normal_from_grid: mat3x3<f32>,
    /// Clip space without jitter, of this frame and of the last one.
    clip_from_grid: mat4x4<f32>,
    previous_clip_from_grid: mat4x4<f32>,
    /// Left and top of the viewport in its target. units: px
    viewport_px: vec2<f32>,
};
