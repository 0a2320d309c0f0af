//! Grey PNG.

use std::io::Cursor;

use bevy::math::UVec2;
use image::{ColorType, ImageDecoder, ImageError, codecs::png::PngDecoder};

use super::{Decoded, HeightFieldLoadError, error::check_plausible};
use crate::{one_line::one_line, terrain::height_field::HeightSamples};

const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";

pub(super) fn decode(bytes: &[u8]) -> Result<Decoded, HeightFieldLoadError> {
    if !bytes.starts_with(SIGNATURE) {
        return Err(HeightFieldLoadError::NotThisFormat { format: "PNG" });
    }
    let damaged = |error: ImageError| HeightFieldLoadError::Damaged {
        format: "PNG",
        reason: one_line(&error.to_string()),
    };
    let decoder = PngDecoder::new(Cursor::new(bytes)).map_err(damaged)?;
    let size = UVec2::from(decoder.dimensions());
    let count = size.x as usize * size.y as usize;
    let eight_bit = match decoder.color_type() {
        ColorType::L16 => false,
        // 1-, 2- and 4-bit grey arrive here too, widened by the decoder.
        ColorType::L8 => true,
        other => {
            // A palette arrives as RGB.
            let found = match other {
                ColorType::La8 | ColorType::La16 => "grey with transparency",
                ColorType::Rgba8 | ColorType::Rgba16 => "colour with transparency",
                _ => "colour",
            };
            return Err(HeightFieldLoadError::Colour {
                format: "PNG",
                extension: "png",
                found: found.to_owned(),
            });
        }
    };
    let codes = if eight_bit {
        check_plausible("PNG", size, 1, bytes)?;
        let mut grey = vec![0u8; count];
        decoder.read_image(&mut grey).map_err(damaged)?;
        widen(&grey)
    } else {
        check_plausible("PNG", size, 2, bytes)?;
        let mut codes = vec![0u16; count];
        decoder
            .read_image(bytemuck::cast_slice_mut(&mut codes))
            .map_err(damaged)?;
        codes
    };
    Ok(Decoded {
        size,
        samples: HeightSamples::U16(codes),
        range_m: None,
        texel_m: None,
        voids: Vec::new(),
        eight_bit,
    })
}

/// 8-bit codes over the full 16-bit range: 255 becomes 65535.
pub(super) fn widen(grey: &[u8]) -> Vec<u16> {
    grey.iter().map(|&g| u16::from(g) * 257).collect()
}
