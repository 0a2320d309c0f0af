//! Grey TIFF: 8 and 16 bits, and floats.

use std::io::Cursor;

use bevy::math::UVec2;
use tiff::{
    ColorType, TiffError, TiffFormatError,
    decoder::{Decoder, DecodingResult, Limits},
    tags::Tag,
};

use super::{Decoded, HeightFieldLoadError, error::check_plausible, png::widen, raw};
use crate::terrain::height_field::HeightSamples;

pub(super) fn decode(bytes: &[u8]) -> Result<Decoded, HeightFieldLoadError> {
    // Classic and BigTIFF, of either byte order.
    if !(bytes.starts_with(b"II*\0")
        || bytes.starts_with(b"MM\0*")
        || bytes.starts_with(b"II+\0")
        || bytes.starts_with(b"MM\0+"))
    {
        return Err(HeightFieldLoadError::NotThisFormat { format: "TIFF" });
    }
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(failed)?;
    let size = UVec2::from(decoder.dimensions().map_err(failed)?);
    let bits = match decoder.colortype().map_err(failed)? {
        ColorType::Gray(bits) => bits,
        other => {
            return Err(HeightFieldLoadError::Colour {
                format: "TIFF",
                extension: "tif",
                found: describe(other),
            });
        }
    };
    let bytes_a_sample = u64::from(bits).div_ceil(8).max(1);
    check_plausible("TIFF", size, bytes_a_sample, bytes)?;

    // The default limits stop at 256 MiB; a 16384² field of floats is 1 GiB. What the header
    // claims has just been held against the file's length.
    let total = u64::from(size.x) * u64::from(size.y) * bytes_a_sample;
    let mut limits = Limits::default();
    let total = usize::try_from(total).unwrap_or(usize::MAX);
    limits.decoding_buffer_size = limits.decoding_buffer_size.max(total);
    limits.intermediate_buffer_size = limits.intermediate_buffer_size.max(total);
    limits.ifd_value_size = limits.ifd_value_size.max(bytes.len());
    let mut decoder = decoder.with_limits(limits);

    let no_data = no_data(&mut decoder);
    let count = size.x as usize * size.y as usize;
    let pixels = decoder.read_image().map_err(failed)?;
    let (samples, voids, range_m, eight_bit) = match pixels {
        DecodingResult::U8(grey) if bits == 8 => {
            let voids = marked(&grey, no_data);
            (HeightSamples::U16(widen(&grey)), voids, None, true)
        }
        DecodingResult::U16(codes) => {
            let voids = marked(&codes, no_data);
            (HeightSamples::U16(codes), voids, None, false)
        }
        DecodingResult::I16(metres) => {
            let voids = marked(&metres, no_data);
            let codes = metres.into_iter().map(raw::signed_code).collect();
            let range = Some(raw::SIGNED_RANGE_M);
            (HeightSamples::U16(codes), voids, range, false)
        }
        DecodingResult::F16(heights) => {
            let heights: Vec<f32> = heights.into_iter().map(f32::from).collect();
            let voids = marked(&heights, no_data);
            (HeightSamples::F32(heights), voids, None, false)
        }
        DecodingResult::F32(heights) => {
            // The tag often has more digits than the samples: compare in their own precision.
            let voids = marked(&heights, no_data.map(|n| f64::from(n as f32)));
            (HeightSamples::F32(heights), voids, None, false)
        }
        DecodingResult::F64(heights) => {
            let voids = marked(&heights, no_data);
            let heights = heights.into_iter().map(|h| h as f32).collect();
            (HeightSamples::F32(heights), voids, None, false)
        }
        other => {
            return Err(HeightFieldLoadError::SampleFormat {
                format: "TIFF",
                found: format!("{} samples of {bits} bits", kind(&other)),
            });
        }
    };
    if samples.len() != count {
        return Err(HeightFieldLoadError::Damaged {
            format: "TIFF",
            reason: format!("{} samples instead of {count}", samples.len()),
        });
    }
    Ok(Decoded {
        size,
        samples,
        range_m,
        texel_m: None,
        voids,
        eight_bit,
    })
}

/// The value that stands for missing data, in the tag that GDAL writes. A tag that holds no number
/// marks nothing.
fn no_data(decoder: &mut Decoder<Cursor<&[u8]>>) -> Option<f64> {
    let text = decoder.get_tag_ascii_string(Tag::GdalNodata).ok()?;
    text.trim_matches(['\0', ' ']).parse().ok()
}

/// Which samples are `no_data`; empty if none are.
fn marked<T: Copy + Into<f64>>(samples: &[T], no_data: Option<f64>) -> Vec<bool> {
    let Some(no_data) = no_data else {
        return Vec::new();
    };
    let is_void = |sample: T| {
        let sample: f64 = sample.into();
        sample == no_data || (sample.is_nan() && no_data.is_nan())
    };
    if samples.iter().any(|&s| is_void(s)) {
        samples.iter().map(|&s| is_void(s)).collect()
    } else {
        Vec::new()
    }
}

fn failed(error: TiffError) -> HeightFieldLoadError {
    match error {
        // Not damage: a sound file of a kind that is not read.
        TiffError::UnsupportedError(error) => HeightFieldLoadError::SampleFormat {
            format: "TIFF",
            found: format!("something unusual ({error})"),
        },
        TiffError::FormatError(TiffFormatError::InvalidDimensions(width, height)) => {
            crate::terrain::HeightFieldError::TooSmall { width, height }.into()
        }
        error => HeightFieldLoadError::Damaged {
            format: "TIFF",
            reason: error.to_string(),
        },
    }
}

fn describe(color: ColorType) -> String {
    match color {
        ColorType::GrayA(_) => "grey with transparency".to_owned(),
        ColorType::Palette(_) => "colours from a palette".to_owned(),
        ColorType::RGBA(_) => "colour with transparency".to_owned(),
        ColorType::Multiband { num_samples, .. } => format!("{num_samples} bands"),
        _ => "colour".to_owned(),
    }
}

fn kind(pixels: &DecodingResult) -> &'static str {
    match pixels {
        DecodingResult::U8(_)
        | DecodingResult::U16(_)
        | DecodingResult::U32(_)
        | DecodingResult::U64(_) => "unsigned",
        DecodingResult::I8(_)
        | DecodingResult::I16(_)
        | DecodingResult::I32(_)
        | DecodingResult::I64(_) => "signed",
        DecodingResult::F16(_) | DecodingResult::F32(_) | DecodingResult::F64(_) => "float",
    }
}
