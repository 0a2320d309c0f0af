// One triangle over the whole viewport.
#define_import_path bevy_skyline::fullscreen

/// Clip position of its corner 0, 1 or 2.
fn fullscreen_corner(index: u32) -> vec4<f32> {
    let uv = vec2<f32>(f32(index >> 1u), f32(index & 1u)) * 2.0;
    return vec4(uv * vec2(2.0, -2.0) + vec2(-1.0, 1.0), 0.0, 1.0);
}
