//! What a user may say about an elevation file, in code or in a sidecar, and what follows from it.

use bevy::{
    math::UVec2,
    reflect::{Reflect, std_traits::ReflectDefault},
};
use serde::{Deserialize, Serialize};

use super::{Decoded, HeightFieldLoadError, voids};
use crate::{
    one_line::one_line,
    terrain::height_field::{HeightField, HeightFieldError, HeightSamples},
};

/// Assumed where nobody says: metres between samples.
const ASSUMED_TEXEL_M: f32 = 1.0;
/// Assumed where nobody says: heights of code 0 and of code 65535.
const ASSUMED_RANGE_M: (f32, f32) = (0.0, 1000.0);

/// How to read an elevation file. What is `None` comes from the file's `.json` sidecar, then from
/// the format; see [`decode_height_field`](super::decode_height_field).
#[derive(Reflect, Serialize, Deserialize, Clone, Debug, Default, PartialEq)]
#[serde(default)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub struct HeightFieldSettings {
    /// Metres between neighbouring samples.
    pub texel_m: Option<f32>,
    /// Heights, in metres, of the lowest and the highest code that the file's samples can have:
    /// of 0 and 65535, or of −32768 and 32767 where they are signed. Float samples are metres
    /// without it, and fractions of it, from 0 to 1, with it.
    pub height_range_m: Option<(f32, f32)>,
    /// Columns and rows of a file that does not say so itself (`.raw`, `.r16`, `.hgt`); without
    /// it, such a file must be square.
    pub raw_size: Option<UVec2>,
    /// Whether `.raw` and `.r16` files are big-endian. `.hgt` files always are.
    pub raw_big_endian: bool,
    /// What to do with samples that the file marks as missing.
    pub voids: VoidHandling,
}

/// What to do with samples that a file marks as missing.
#[derive(Reflect, Serialize, Deserialize, Clone, Copy, Debug, Default, PartialEq)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub enum VoidHandling {
    /// Stretch a smooth surface over each hole from its rim, never outside the rim's heights.
    #[default]
    Fill,
    /// Give them this height, in metres: 0, say, where the sea is marked as missing.
    Height(f32),
    /// Refuse the file.
    Refuse,
}

/// Something that was assumed or mended while a file was read, and that its user should know.
#[derive(thiserror::Error, Reflect, Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum HeightFieldNote {
    /// 256 levels make terraces.
    #[error(
        "8-bit heights show as terraces: this file has 256 levels at most; export it with 16 bits"
    )]
    EightBit,
    /// Neither settings nor sidecar nor format give the scale.
    #[error("{}", assumed(*.texel_m, *.height_range_m))]
    Assumed {
        /// The assumed metres between samples, if they were.
        texel_m: Option<f32>,
        /// The assumed heights of the lowest and the highest code, if they were.
        height_range_m: Option<(f32, f32)>,
    },
    /// Missing samples were given heights.
    #[error("{count} samples are marked as missing in this file; they were {}", match .height_m {
        None => "filled from their surroundings".to_owned(),
        Some(m) => format!("set to {m} m"),
    })]
    VoidsFilled {
        /// How many.
        count: usize,
        /// The one height they were given, or `None` if they were filled smoothly.
        height_m: Option<f32>,
    },
}

fn assumed(texel_m: Option<f32>, range_m: Option<(f32, f32)>) -> String {
    let spacing = texel_m.map(|m| format!("a spacing of {m} m"));
    let range = range_m.map(|(min, max)| format!("heights from {min} m to {max} m"));
    let what: Vec<_> = spacing.into_iter().chain(range).collect();
    format!(
        "{} assumed: set `texel_m` and `height_range_m` of `HeightFieldSettings`, or put a .json \
         file of the same stem beside it with metres_per_texel, height_min_m and height_max_m",
        what.join(" and ")
    )
}

/// The `.json` file beside an elevation file. Fields it does not know are no concern of ours.
#[derive(Deserialize, Default, Debug)]
#[serde(default)]
pub(super) struct Sidecar {
    width: Option<u32>,
    height: Option<u32>,
    metres_per_texel: Option<f32>,
    height_min_m: Option<f32>,
    height_max_m: Option<f32>,
}

impl Sidecar {
    pub(super) fn parse(bytes: &[u8]) -> Result<Self, HeightFieldLoadError> {
        let reason = |reason: String| HeightFieldLoadError::Sidecar {
            reason: one_line(&reason),
        };
        // Not `Self` at once: serde would take an array for a list of the fields in order.
        let object: serde_json::Map<String, serde_json::Value> =
            serde_json::from_slice(bytes).map_err(|e| reason(e.to_string()))?;
        let sidecar: Self =
            serde_json::from_value(object.into()).map_err(|e| reason(e.to_string()))?;
        if sidecar.height_min_m.is_some() != sidecar.height_max_m.is_some() {
            return Err(reason(
                "one of height_min_m and height_max_m without the other".to_owned(),
            ));
        }
        if sidecar.width.is_some() != sidecar.height.is_some() {
            return Err(reason(
                "one of width and height without the other".to_owned(),
            ));
        }
        Ok(sidecar)
    }

    pub(super) fn size(&self) -> Option<UVec2> {
        Some(UVec2::new(self.width?, self.height?))
    }

    fn range_m(&self) -> Option<(f32, f32)> {
        Some((self.height_min_m?, self.height_max_m?))
    }

    pub(super) fn check_size(&self, file: UVec2) -> Result<(), HeightFieldLoadError> {
        match self.size() {
            Some(sidecar) if sidecar != file => {
                Err(HeightFieldLoadError::SidecarSize { sidecar, file })
            }
            _ => Ok(()),
        }
    }
}

/// Settles spacing, range and missing samples, and makes the height field.
pub(super) fn resolve(
    decoded: Decoded,
    settings: &HeightFieldSettings,
    sidecar: &Sidecar,
) -> Result<(HeightField, Vec<HeightFieldNote>), HeightFieldLoadError> {
    let Decoded {
        size,
        mut samples,
        range_m: format_range_m,
        texel_m: format_texel_m,
        voids,
        eight_bit,
    } = decoded;
    let mut notes = Vec::new();
    if eight_bit {
        notes.push(HeightFieldNote::EightBit);
    }

    let texel_m = settings
        .texel_m
        .or(sidecar.metres_per_texel)
        .or(format_texel_m);
    let given_range_m = settings.height_range_m.or(sidecar.range_m());
    let code_range_m = given_range_m.or(format_range_m);

    // Metres of the void height → the samples' own unit.
    let void_unit = |metres: f32| match (&samples, given_range_m) {
        (HeightSamples::U16(_), _) => {
            let (min, max) = code_range_m.unwrap_or(ASSUMED_RANGE_M);
            let fraction = (f64::from(metres) - f64::from(min)) / (f64::from(max) - f64::from(min));
            fraction * f64::from(u16::MAX)
        }
        (HeightSamples::F32(_), Some((min, max))) => {
            (f64::from(metres) - f64::from(min)) / (f64::from(max) - f64::from(min))
        }
        (HeightSamples::F32(_), None) => f64::from(metres),
    };
    let handling = match settings.voids {
        VoidHandling::Height(metres) => voids::Handling::Value {
            value: void_unit(metres) as f32,
            height_m: metres,
        },
        VoidHandling::Fill => voids::Handling::Fill,
        VoidHandling::Refuse => voids::Handling::Refuse,
    };
    notes.extend(voids::handle(size, &mut samples, &voids, handling)?);

    let is_float = matches!(samples, HeightSamples::F32(_));
    let assumed = HeightFieldNote::Assumed {
        texel_m: texel_m.is_none().then_some(ASSUMED_TEXEL_M),
        height_range_m: (code_range_m.is_none() && !is_float).then_some(ASSUMED_RANGE_M),
    };
    if !matches!(
        assumed,
        HeightFieldNote::Assumed {
            texel_m: None,
            height_range_m: None
        }
    ) {
        notes.push(assumed);
    }

    let texel_m = texel_m.unwrap_or(ASSUMED_TEXEL_M);
    let field = match samples {
        HeightSamples::U16(codes) => HeightField::from_u16(
            size,
            texel_m,
            code_range_m.unwrap_or(ASSUMED_RANGE_M),
            codes,
        )?,
        HeightSamples::F32(mut heights) => {
            if let Some(range_m) = given_range_m {
                scale_fractions(size, range_m, &mut heights)?;
            }
            HeightField::from_f32(size, texel_m, heights)?
        }
    };
    Ok((field, notes))
}

/// Fractions from 0 to 1 → metres.
fn scale_fractions(
    size: UVec2,
    (min_m, max_m): (f32, f32),
    samples: &mut [f32],
) -> Result<(), HeightFieldLoadError> {
    if !(min_m.is_finite() && max_m.is_finite() && min_m <= max_m) {
        return Err(HeightFieldError::HeightRange { min_m, max_m }.into());
    }
    let span = f64::from(max_m) - f64::from(min_m);
    for (index, sample) in samples.iter_mut().enumerate() {
        // NaN passes here: the height field's own error names it.
        if *sample < 0.0 || *sample > 1.0 {
            return Err(HeightFieldLoadError::FractionOutOfRange {
                column: (index % size.x as usize) as u32,
                row: (index / size.x as usize) as u32,
                value: *sample,
            });
        }
        *sample = (f64::from(min_m) + f64::from(*sample) * span) as f32;
    }
    Ok(())
}
