//! Grey TIFF: 8 and 16 bits, and floats.

use std::io::Cursor;

use bevy::math::UVec2;
use tiff::{
    ColorType, TiffError, TiffFormatError,
    decoder::{Decoder, DecodingResult, Limits},
    tags::Tag,
};

use super::{
    Decoded, HeightFieldLoadError,
    error::{MOST_BYTES_A_BYTE, check_plausible},
    png::widen,
    raw,
};
use crate::{one_line::one_line, terrain::height_field::HeightSamples};

pub(super) fn decode(bytes: &[u8]) -> Result<Decoded, HeightFieldLoadError> {
    // Classic and BigTIFF, of either byte order.
    if !(bytes.starts_with(b"II*\0")
        || bytes.starts_with(b"MM\0*")
        || bytes.starts_with(b"II+\0")
        || bytes.starts_with(b"MM\0+"))
    {
        return Err(HeightFieldLoadError::NotThisFormat { format: "TIFF" });
    }
    check_directory(bytes)?;
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

    // The default limits stop at 256 MiB, where a 16384² field of floats is 1 GiB, and let a file
    // of a hundred bytes have a tile of 64. Both the image and a strip or tile of it, which may
    // reach out of the image, are held against the file's length.
    let total = u64::from(size.x) * u64::from(size.y) * bytes_a_sample;
    let mut limits = Limits::default();
    limits.decoding_buffer_size = usize::try_from(total).unwrap_or(usize::MAX);
    limits.intermediate_buffer_size = bytes.len().saturating_mul(MOST_BYTES_A_BYTE as usize);
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

/// Refuses a first directory with an entry that is longer than the file: the decoder makes room for
/// what an entry claims before it looks whether that is there, and before it can be told its limits.
/// What else may be wrong with a directory the decoder says.
fn check_directory(bytes: &[u8]) -> Result<(), HeightFieldLoadError> {
    let is_big = bytes.get(2..4).is_some_and(|word| word.contains(&43));
    let number = |at: usize, size: usize| -> Option<u64> {
        let bytes_of = bytes.get(at..at.checked_add(size)?)?.iter();
        let push = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        Some(if bytes.starts_with(b"MM") {
            bytes_of.fold(0, push)
        } else {
            bytes_of.rev().fold(0, push)
        })
    };
    // Where its offset is, the sizes of offsets and counts, of the number of entries, of an entry.
    let (first, wide, entries, entry) = if is_big { (8, 8, 8, 20) } else { (4, 4, 2, 12) };
    let at = number(first, wide).and_then(|at| usize::try_from(at).ok());
    let Some((at, count)) = at.and_then(|at| Some((at, number(at, entries)?))) else {
        return Ok(());
    };
    let count = usize::try_from(count).unwrap_or(usize::MAX);
    let starts =
        (0..count).map_while(|i| i.checked_mul(entry)?.checked_add(at)?.checked_add(entries));
    for start in starts {
        let (Some(kind), Some(values)) = (number(start + 2, 2), number(start + 4, wide)) else {
            return Ok(());
        };
        let size = match kind {
            3 | 8 => 2,
            4 | 9 | 11 | 13 => 4,
            5 | 10 | 12 | 16..=18 => 8,
            _ => 1,
        };
        let length = values.saturating_mul(size);
        if length > bytes.len() as u64 {
            return Err(HeightFieldLoadError::Damaged {
                format: "TIFF",
                reason: format!("an entry of {length} bytes in a file of {}", bytes.len()),
            });
        }
    }
    Ok(())
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
            found: format!("something unusual ({})", one_line(&error.to_string())),
        },
        TiffError::FormatError(TiffFormatError::InvalidDimensions(width, height)) => {
            crate::terrain::HeightFieldError::TooSmall { width, height }.into()
        }
        error => HeightFieldLoadError::Damaged {
            format: "TIFF",
            reason: one_line(&error.to_string()),
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
