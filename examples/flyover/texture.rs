//! Images made by code, with all their mips, so that nothing glitters in the distance.

use bevy::{
    asset::RenderAssetUsages,
    image::{Image, ImageAddressMode, ImageFilterMode, ImageSampler, ImageSamplerDescriptor},
    prelude::*,
    render::render_resource::{Extent3d, TextureDimension, TextureFormat},
};

/// What an image's numbers mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Texels {
    /// Colours to look at, sRGB.
    Colour,
    /// Directions, as normal maps have them.
    Normals,
}

/// An image of `size` texels, rows from the top, 4 bytes a texel, with its mips. Both sides are powers of two.
pub fn image(size: UVec2, texels: Texels, mut level: Vec<u8>, repeats: bool) -> Image {
    let levels = size.min_element().ilog2() + 1;
    let mut data = level.clone();
    let mut side = size;
    for _ in 1..levels {
        level = half(&level, side, texels);
        side /= 2;
        data.extend_from_slice(&level);
    }
    let format = match texels {
        Texels::Colour => TextureFormat::Rgba8UnormSrgb,
        Texels::Normals => TextureFormat::Rgba8Unorm,
    };
    let extent = Extent3d {
        width: size.x,
        height: size.y,
        depth_or_array_layers: 1,
    };
    let mut image = Image::new_uninit(
        extent,
        TextureDimension::D2,
        format,
        RenderAssetUsages::RENDER_WORLD,
    );
    image.texture_descriptor.mip_level_count = levels;
    image.data = Some(data);
    let address = if repeats {
        ImageAddressMode::Repeat
    } else {
        ImageAddressMode::ClampToEdge
    };
    image.sampler = ImageSampler::Descriptor(ImageSamplerDescriptor {
        address_mode_u: address,
        address_mode_v: address,
        mag_filter: ImageFilterMode::Linear,
        min_filter: ImageFilterMode::Linear,
        mipmap_filter: ImageFilterMode::Linear,
        ..default()
    });
    image
}

/// The mean of each four texels.
fn half(level: &[u8], size: UVec2, texels: Texels) -> Vec<u8> {
    let (width, to) = (size.x as usize, (size / 2).as_usizevec2());
    let mut halved = Vec::with_capacity(to.x * to.y * 4);
    for y in 0..to.y {
        for x in 0..to.x {
            let corner = 4 * (2 * y * width + 2 * x);
            let four = [
                corner,
                corner + 4,
                corner + 4 * width,
                corner + 4 * width + 4,
            ];
            for channel in 0..4 {
                let value = four.map(|at| u32::from(level[at + channel]));
                let mean = if texels == Texels::Colour && channel < 3 {
                    // Light adds up by its square, near enough to sRGB's curve.
                    ((value.map(|v| v * v).iter().sum::<u32>() as f32 * 0.25).sqrt() + 0.5) as u8
                } else {
                    ((value.iter().sum::<u32>() + 2) / 4) as u8
                };
                halved.push(mean);
            }
        }
    }
    halved
}

/// Four bytes of a colour.
pub fn bytes(colour: LinearRgba) -> [u8; 4] {
    Srgba::from(colour).to_u8_array()
}

/// A random number from 0 to 1 for a place and a purpose.
pub fn unit(x: i32, y: i32, salt: u32) -> f32 {
    let mut bits = (x as u32)
        .wrapping_mul(0x9E37_79B1)
        .wrapping_add((y as u32).wrapping_mul(0x85EB_CA77))
        .wrapping_add(salt.wrapping_mul(0xC2B2_AE3D));
    bits = (bits ^ (bits >> 15)).wrapping_mul(0x2C1B_3C6D);
    bits = (bits ^ (bits >> 12)).wrapping_mul(0x297A_2D39);
    bits ^= bits >> 15;
    bits as f32 / u32::MAX as f32
}
