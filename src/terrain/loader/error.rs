//! What can be wrong with an elevation file.

use std::path::PathBuf;

use bevy::{asset::ReadAssetBytesError, math::UVec2};

use crate::terrain::height_field::HeightFieldError;

/// Why a file could not become a [`HeightField`](crate::terrain::HeightField).
#[derive(thiserror::Error, Debug)]
#[non_exhaustive]
pub enum HeightFieldLoadError {
    /// The extension is none of the known ones.
    #[error(
        "`{extension}` is no height format known here: use a 16-bit grey PNG (.png), a 16-bit or \
         float TIFF (.tif, .tiff), an SRTM tile (.hgt) or raw 16-bit samples (.raw, .r16)"
    )]
    UnknownFormat {
        /// The extension, in lower case.
        extension: String,
    },
    /// The bytes do not start as this format does.
    #[error(
        "this is no {format} file, whatever its name says: it does not start with the {format} \
         signature; give it the extension of its real format"
    )]
    NotThisFormat {
        /// `PNG` or `TIFF`.
        format: &'static str,
    },
    /// Colour, a palette or transparency: no telling which channel is the height.
    #[error(
        "this {format} file holds {found}, but a height field is one grey channel: convert it, \
         e.g. `magick in.{extension} -alpha off -colorspace Gray -depth 16 out.{extension}`, or \
         export the heights as 16-bit grey"
    )]
    Colour {
        /// `PNG` or `TIFF`.
        format: &'static str,
        /// Its usual extension.
        extension: &'static str,
        /// What it holds instead.
        found: String,
    },
    /// Grey, but of a depth or kind that is not read.
    #[error(
        "this {format} file holds {found}, which is not read: convert it to 16-bit unsigned or \
         32-bit float samples, e.g. with `gdal_translate -ot Float32 in.tif out.tif`"
    )]
    SampleFormat {
        /// `PNG` or `TIFF`.
        format: &'static str,
        /// What it holds.
        found: String,
    },
    /// It starts well and ends badly.
    #[error(
        "this {format} file cannot be decoded ({reason}): it is truncated or damaged; fetch or \
         export it again"
    )]
    Damaged {
        /// `PNG` or `TIFF`.
        format: &'static str,
        /// The decoder's words.
        reason: String,
    },
    /// The number of bytes does not fit the size that was given.
    #[error(
        "{size} samples of 16 bits are {expected} bytes, but this file has {found}: correct \
         `raw_size`, or the sidecar's width and height"
    )]
    Length {
        /// Columns and rows.
        size: UVec2,
        /// Their bytes.
        expected: u64,
        /// The file's bytes.
        found: u64,
    },
    /// No size was given, and the number of bytes is no square one.
    #[error(
        "{found} bytes are no square of 16-bit samples (1201×1201 would be {}): the file is \
         truncated, or not square: then give its size as `raw_size` or in a .json sidecar with \
         width and height",
        1201 * 1201 * 2
    )]
    NotSquare {
        /// The file's bytes.
        found: u64,
    },
    /// Every sample is marked as missing.
    #[error("every sample of this file is marked as missing: there is no height to show")]
    AllVoid,
    /// Missing samples, in a file that may have none.
    #[error(
        "{count} samples are marked as missing, the first at column {column}, row {row}: set \
         `voids` to `Fill` or to `Height(..)`, or mend the file"
    )]
    Voids {
        /// How many.
        count: usize,
        /// Column of the first.
        column: u32,
        /// Row of the first.
        row: u32,
    },
    /// A height range was given for float samples that are not fractions of it.
    #[error(
        "with a height range, float samples must lie between 0 and 1, but the one at column \
         {column}, row {row} is {value}: if the samples are metres, leave the height range out \
         (settings and sidecar)"
    )]
    FractionOutOfRange {
        /// Column of the first such sample.
        column: u32,
        /// Its row.
        row: u32,
        /// Its value.
        value: f32,
    },
    /// The sidecar is no JSON object, or a field is of the wrong kind.
    #[error(
        "the .json sidecar cannot be read ({reason}): it should hold numbers named width, height, \
         metres_per_texel, height_min_m and height_max_m, each optional; correct or remove it"
    )]
    Sidecar {
        /// What is wrong, and where.
        reason: String,
    },
    /// The sidecar speaks of another image.
    #[error(
        "the .json sidecar says {sidecar} samples, but the file has {file}: it belongs to another \
         file; correct or remove it"
    )]
    SidecarSize {
        /// Columns and rows by the sidecar.
        sidecar: UVec2,
        /// Columns and rows of the file.
        file: UVec2,
    },
    /// A file could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The asset server could not read the sidecar, though it is there.
    #[error("cannot read the .json sidecar: {0}")]
    ReadSidecar(#[source] Box<ReadAssetBytesError>),
    /// The samples, the spacing or the range cannot make a height field.
    #[error(transparent)]
    HeightField(#[from] HeightFieldError),
}

/// A deflated or LZW stream holds at most about 2700 times its own length. A header that claims
/// more than this many bytes for each byte of the file lies, and must not make us allocate.
pub(super) const MOST_BYTES_A_BYTE: u64 = 4096;

/// Refuses a header whose image cannot possibly be in the file.
pub(super) fn check_plausible(
    format: &'static str,
    size: UVec2,
    bytes_a_sample: u64,
    file: &[u8],
) -> Result<(), HeightFieldLoadError> {
    let claimed = u64::from(size.x) * u64::from(size.y);
    if claimed / MOST_BYTES_A_BYTE > file.len() as u64 / bytes_a_sample {
        return Err(HeightFieldLoadError::Damaged {
            format,
            reason: format!("{size} samples do not fit into {} bytes", file.len()),
        });
    }
    Ok(())
}
