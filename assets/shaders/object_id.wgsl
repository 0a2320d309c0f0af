// An object's number as a colour: six bits a channel, in the middle of four 8-bit codes, so that no rounding on the
// way through sRGB can turn one number into another. Twin: `offline::scenes::ids`.

#import bevy_pbr::{forward_io::VertexOutput, mesh_functions::get_tag}

/// The linear value that sRGB stores as the middle code of six bits.
fn linear_of(bits: u32) -> f32 {
    let code = f32(4u * (bits & 63u) + 2u) / 255.0;
    if code <= 0.04045 {
        return code / 12.92;
    }
    return pow((code + 0.055) / 1.055, 2.4);
}

@fragment
fn fragment(in: VertexOutput) -> @location(0) vec4<f32> {
    let tag = get_tag(in.instance_index);
    return vec4<f32>(linear_of(tag), linear_of(tag >> 6u), linear_of(tag >> 12u), 1.0);
}
