// Stretches what the main passes have drawn of a viewport over the whole viewport.
//
// In:  the camera's main texture, whose viewport is drawn in its upper left part. Out: the other main texture, of
// the same format; pixels outside the viewport are carried over.
//
// Catmull-Rom, held between the smallest and the largest of the four nearest pixels. Bilinear interpolation blurs a
// picture again at each of its pixels, and its slope jumps from one to the next, which shows as a grid at small
// scales. The cubic keeps edges sharp; what it would add beyond its neighbours (rings around highlights, black rims
// beside an HDR sun) is cut. The pixels are loaded, not sampled: a sampler's 8 bits of position would show in smooth
// slopes, and its footprint would reach beyond the drawn part.

#import bevy_skyline::fullscreen::fullscreen_corner

/// Mirrors `GpuStretch`.
struct Stretch {
    /// Upper left corner of the viewport in the texture. units: px
    origin: vec2<u32>,
    /// Its size. units: px
    size: vec2<u32>,
    /// Size of the part that was drawn, from the same corner. units: px
    drawn: vec2<u32>,
    /// drawn / size
    ratio: vec2<f32>,
};

@group(0) @binding(0) var<uniform> stretch: Stretch;
@group(0) @binding(1) var picture: texture_2d<f32>;

/// The largest finite half float: infinities would become NaN where a weight is 0.
const MOST: f32 = 65504.0;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return fullscreen_corner(index);
}

fn pixel_at(x: i32, y: i32) -> vec4<f32> {
    return clamp(textureLoad(picture, vec2(x, y), 0), vec4(-MOST), vec4(MOST));
}

/// Weights of four neighbours for a place at `f` between the middle two.
fn catmull_rom(f: f32) -> vec4<f32> {
    let g = 1.0 - f;
    return vec4(
        -0.5 * f * g * g,
        1.0 + f * f * (1.5 * f - 2.5),
        1.0 + g * g * (1.5 * g - 2.5),
        -0.5 * g * f * f,
    );
}

fn outer_row(x: vec4<i32>, y: i32, w: vec4<f32>) -> vec4<f32> {
    return w.x * pixel_at(x.x, y) + w.y * pixel_at(x.y, y) + w.z * pixel_at(x.z, y) + w.w * pixel_at(x.w, y);
}

struct Row {
    sum: vec4<f32>,
    low: vec4<f32>,
    high: vec4<f32>,
};

fn inner_row(x: vec4<i32>, y: i32, w: vec4<f32>) -> Row {
    let b = pixel_at(x.y, y);
    let c = pixel_at(x.z, y);
    let sum = w.x * pixel_at(x.x, y) + w.y * b + w.z * c + w.w * pixel_at(x.w, y);
    return Row(sum, min(b, c), max(b, c));
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let pixel = vec2<i32>(floor(position.xy));
    let origin = vec2<i32>(stretch.origin);
    let inside = pixel - origin;
    if any(inside < vec2(0)) || any(inside >= vec2<i32>(stretch.size)) {
        return textureLoad(picture, pixel, 0);
    }
    let at = (vec2<f32>(inside) + 0.5) * stretch.ratio - 0.5;
    let before = floor(at);
    let wx = catmull_rom(at.x - before.x);
    let wy = catmull_rom(at.y - before.y);
    // The border's pixels go on beyond it.
    let last = vec2<i32>(stretch.drawn) - 1;
    let taps = vec4(-1, 0, 1, 2);
    let x = origin.x + clamp(vec4(i32(before.x)) + taps, vec4(0), vec4(last.x));
    let y = origin.y + clamp(vec4(i32(before.y)) + taps, vec4(0), vec4(last.y));
    let b = inner_row(x, y.y, wx);
    let c = inner_row(x, y.z, wx);
    let sum = wy.x * outer_row(x, y.x, wx) + wy.y * b.sum + wy.z * c.sum + wy.w * outer_row(x, y.w, wx);
    return clamp(sum, min(b.low, c.low), max(b.high, c.high));
}
