//! Files without a header: SRTM `.hgt`, and raw 16-bit samples.

use bevy::math::UVec2;

use super::{Decoded, HeightFieldLoadError};
use crate::terrain::height_field::{HeightFieldError, HeightSamples};

/// Heights of codes 0 and 65535 where samples are signed metres: every code is a whole metre.
pub(super) const SIGNED_RANGE_M: (f32, f32) = (-32768.0, 32767.0);

/// Metres of one arc second from north to south: 111 132 m a degree, at 45° of latitude.
const ARC_SECOND_M: f32 = 30.87;

/// The code of signed metres in [`SIGNED_RANGE_M`].
pub(super) fn signed_code(metres: i16) -> u16 {
    (i32::from(metres) - i32::from(i16::MIN)) as u16
}

/// An SRTM tile: big-endian `i16` metres, row 0 in the north, −32768 where there is no data. A
/// square tile of n×n samples spans one degree: 1201² has 3, 3601² has 1 arc second a sample.
pub(super) fn decode_hgt(
    bytes: &[u8],
    size: Option<UVec2>,
) -> Result<Decoded, HeightFieldLoadError> {
    let size = size_of(bytes, size)?;
    let mut codes = Vec::with_capacity(bytes.len() / 2);
    let mut any_void = false;
    for &pair in bytes.as_chunks::<2>().0 {
        let metres = i16::from_be_bytes(pair);
        any_void |= metres == i16::MIN;
        codes.push(signed_code(metres));
    }
    let voids = if any_void {
        codes.iter().map(|&code| code == 0).collect()
    } else {
        Vec::new()
    };
    Ok(Decoded {
        size,
        samples: HeightSamples::U16(codes),
        range_m: Some(SIGNED_RANGE_M),
        texel_m: Some(ARC_SECOND_M * 3600.0 / (size.y - 1) as f32),
        voids,
        eight_bit: false,
    })
}

/// Bare 16-bit unsigned samples, row-major.
pub(super) fn decode_raw(
    bytes: &[u8],
    size: Option<UVec2>,
    big_endian: bool,
) -> Result<Decoded, HeightFieldLoadError> {
    let size = size_of(bytes, size)?;
    let from_bytes = if big_endian {
        u16::from_be_bytes
    } else {
        u16::from_le_bytes
    };
    let pairs = bytes.as_chunks::<2>().0;
    Ok(Decoded {
        size,
        samples: HeightSamples::U16(pairs.iter().map(|&pair| from_bytes(pair)).collect()),
        range_m: None,
        texel_m: None,
        voids: Vec::new(),
        eight_bit: false,
    })
}

/// The given size, or the square one that the length allows.
fn size_of(bytes: &[u8], given: Option<UVec2>) -> Result<UVec2, HeightFieldLoadError> {
    let found = bytes.len() as u64;
    let size = match given {
        Some(size) => size,
        None => {
            let side = (found / 2).isqrt();
            match u32::try_from(side) {
                Ok(n) if side * side * 2 == found => UVec2::splat(n),
                _ => return Err(HeightFieldLoadError::NotSquare { found }),
            }
        }
    };
    if size.min_element() < 2 {
        return Err(HeightFieldError::TooSmall {
            width: size.x,
            height: size.y,
        }
        .into());
    }
    // Two u32 multiply into a u64; twice that may not fit.
    let expected = u64::from(size.x) * u64::from(size.y);
    if expected.checked_mul(2) == Some(found) {
        Ok(size)
    } else {
        Err(HeightFieldLoadError::Length {
            size,
            expected: expected.saturating_mul(2),
            found,
        })
    }
}
