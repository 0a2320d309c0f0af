// Boxes in clip space: `culling/clip.rs`, operation by operation. What may be off by how much is counted there.
//
// Clip space is reverse-Z: z = w on the near plane, z = 0 infinitely far away. Comparisons of what may not be a
// number are made with its bits.
#define_import_path bevy_skyline::clip

/// As in `culling/clip.rs`.
const CLIP_ERROR: f32 = 3.814697265625e-6;
const CLIP_TINY: f32 = 1e-18;
const CLIP_HUGE: f32 = 1e18;
const PIXEL_ERROR: f32 = 1.9073486328125e-6;
const LARGEST: f32 = 3.4028234663852886e38;

/// Clip space from local space, and the sums of magnitudes that its elements are made of.
struct ClipFrame {
    x: vec4<f32>,
    y: vec4<f32>,
    z: vec4<f32>,
    w: vec4<f32>,
    x_magnitude: vec4<f32>,
    y_magnitude: vec4<f32>,
    z_magnitude: vec4<f32>,
    w_magnitude: vec4<f32>,
};

/// Bounds of some corners' quotients.
struct Quotients {
    lo: vec4<f32>,
    hi: vec4<f32>,
    w_min: f32,
};

fn view_way(m: mat4x4<f32>, v: vec3<f32>) -> vec4<f32> {
    return m[0] * v.x + m[1] * v.y + m[2] * v.z;
}

fn view_magnitude(m: mat4x4<f32>, v: vec3<f32>) -> vec4<f32> {
    return abs(m[0]) * v.x + abs(m[1]) * v.y + abs(m[2]) * v.z;
}

/// `rows` are those of the affine matrix, as Bevy's `Mesh` has them.
fn clip_frame(m: mat4x4<f32>, rows: mat3x4<f32>) -> ClipFrame {
    let x = vec3(rows[0].x, rows[1].x, rows[2].x);
    let y = vec3(rows[0].y, rows[1].y, rows[2].y);
    let z = vec3(rows[0].z, rows[1].z, rows[2].z);
    let w = vec3(rows[0].w, rows[1].w, rows[2].w);
    return ClipFrame(
        view_way(m, x),
        view_way(m, y),
        view_way(m, z),
        view_way(m, w) + m[3],
        view_magnitude(m, abs(x)),
        view_magnitude(m, abs(y)),
        view_magnitude(m, abs(z)),
        view_magnitude(m, abs(w)) + abs(m[3]),
    );
}

fn clip_way(frame: ClipFrame, v: vec3<f32>) -> vec4<f32> {
    return frame.x * v.x + frame.y * v.y + frame.z * v.z;
}

fn clip_point(frame: ClipFrame, v: vec3<f32>) -> vec4<f32> {
    return frame.x * v.x + frame.y * v.y + frame.z * v.z + frame.w;
}

fn clip_magnitude(frame: ClipFrame, v: vec3<f32>) -> vec4<f32> {
    return frame.x_magnitude * v.x + frame.y_magnitude * v.y + frame.z_magnitude * v.z + frame.w_magnitude;
}

/// Whether all are finite, not negative and below `CLIP_HUGE`.
fn is_calculable(magnitudes: vec4<f32>) -> bool {
    return all(bitcast<vec4<u32>>(magnitudes) < vec4(bitcast<u32>(CLIP_HUGE)));
}

fn no_quotients() -> Quotients {
    return Quotients(vec4(LARGEST), vec4(-LARGEST), LARGEST);
}

fn with_corner(all: Quotients, corner: vec4<f32>) -> Quotients {
    let q = corner * (1.0 / max(corner.w, CLIP_TINY));
    return Quotients(min(all.lo, q), max(all.hi, q), min(all.w_min, corner.w));
}
