//! Elevation files: what they may hold, how they become a [`HeightField`], and the
//! [`AssetLoader`] for them.
//!
//! [`decode_height_field`] does all the work, on bytes. The asset loader and the file functions
//! only fetch those bytes.

mod error;
mod png;
mod raw;
mod settings;
mod tiff;
mod voids;

pub use error::HeightFieldLoadError;
pub use settings::{HeightFieldNote, HeightFieldSettings, VoidHandling};

use std::path::{Path, PathBuf};

use bevy::{
    app::{App, Plugin},
    asset::{
        AssetApp, AssetLoader, AssetPath, LoadContext, ReadAssetBytesError,
        io::{AssetReaderError, Reader},
    },
    log::warn,
    math::UVec2,
    reflect::TypePath,
};

use self::settings::{Sidecar, resolve};
use super::{
    height_field::{Changed, HeightField, HeightSamples},
    pyramid::{MinMaxPyramid, PyramidNodes},
    query::{HeightFieldHit, HeightFieldHitF64, HitSide, TerrainHit},
};

/// The formats an elevation file can have, told by its extension.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Format {
    Png,
    Tiff,
    Hgt,
    Raw,
}

/// What a file holds before spacing and height range are known.
struct Decoded {
    size: UVec2,
    samples: HeightSamples,
    /// Heights of codes 0 and 65535, where the format settles them.
    range_m: Option<(f32, f32)>,
    /// Metres between samples, where the format settles them.
    texel_m: Option<f32>,
    /// Which samples the file marks as missing; empty if it marks none.
    voids: Vec<bool>,
    /// 8-bit samples were widened.
    eight_bit: bool,
}

impl Format {
    fn of(path: &Path) -> Result<Self, HeightFieldLoadError> {
        // Accepts "alps.png" and plain "png" alike.
        let extension = path.extension().unwrap_or(path.as_os_str());
        match extension.to_string_lossy().to_ascii_lowercase().as_str() {
            "png" => Ok(Self::Png),
            "tif" | "tiff" => Ok(Self::Tiff),
            "hgt" => Ok(Self::Hgt),
            "raw" | "r16" => Ok(Self::Raw),
            other => Err(HeightFieldLoadError::UnknownFormat {
                extension: other.to_owned(),
            }),
        }
    }
}

/// Makes a height field of an elevation file's bytes, and says what had to be assumed or mended.
///
/// `path` may be a whole path or just an extension; only the extension counts. `sidecar` is the
/// content of the `.json` file of the same stem, if there is one.
///
/// | Extension | Samples | Heights | Spacing |
/// |---|---|---|---|
/// | `png` | 16-bit grey; 8-bit grey with a note | the range | the spacing |
/// | `tif`, `tiff` | 16-bit unsigned grey; 8-bit with a note | the range | the spacing |
/// | | 16-bit signed | metres, unless a range says what −32768 and 32767 stand for | the spacing |
/// | | 16-, 32- and 64-bit float, kept as 32-bit | metres; with a range, 0 to 1 of it | the spacing |
/// | `hgt` | 16-bit signed, big-endian | metres, as above | one degree from first to last row, at 30.87 m an arc second |
/// | `raw`, `r16` | 16-bit unsigned, little-endian unless set otherwise | the range | the spacing |
///
/// "The range" and "the spacing" come from `settings`, else from the sidecar, else they are
/// assumed to be 0 to 1000 m and 1 m, with a note. A sidecar's fields, each optional, are `width`,
/// `height`, `metres_per_texel`, `height_min_m` and `height_max_m`. 16-bit samples stay the exact
/// codes of the file.
///
/// The spacing of a `.hgt` file is that from north to south. From west to east its samples stand
/// closer by the cosine of the latitude: scale the terrain's `Transform` along X by that.
///
/// Samples that the file declares missing (−32768 in `.hgt`, the value of the `GDAL_NODATA` tag in
/// TIFF) are treated as [`HeightFieldSettings::voids`] says.
///
/// # Errors
/// [`HeightFieldLoadError`], whose text says what to do about it. Damaged and truncated files are
/// errors, never panics.
///
/// # Limits
/// TIFF: strips and tiles, uncompressed, LZW, Deflate or PackBits; the first image of a file;
/// bilevel and 32-bit integer samples are refused. Georeferencing is not read.
pub fn decode_height_field(
    path: impl AsRef<Path>,
    bytes: &[u8],
    settings: &HeightFieldSettings,
    sidecar: Option<&[u8]>,
) -> Result<(HeightField, Vec<HeightFieldNote>), HeightFieldLoadError> {
    let format = Format::of(path.as_ref())?;
    let sidecar = sidecar.map(Sidecar::parse).transpose()?.unwrap_or_default();
    let raw_size = settings.raw_size.or(sidecar.size());
    let decoded = match format {
        Format::Png => png::decode(bytes)?,
        Format::Tiff => tiff::decode(bytes)?,
        Format::Hgt => raw::decode_hgt(bytes, raw_size)?,
        Format::Raw => raw::decode_raw(bytes, raw_size, settings.raw_big_endian)?,
    };
    sidecar.check_size(decoded.size)?;
    resolve(decoded, settings, &sidecar)
}

impl HeightField {
    /// Makes a height field of an elevation file's bytes. [`decode_height_field`] has the details;
    /// this logs its notes as warnings instead of returning them, and looks for no sidecar.
    ///
    /// # Errors
    /// [`HeightFieldLoadError`], whose text says what to do about it.
    pub fn from_bytes(
        extension_or_path: impl AsRef<Path>,
        bytes: &[u8],
        settings: &HeightFieldSettings,
    ) -> Result<Self, HeightFieldLoadError> {
        let path = extension_or_path.as_ref();
        let (field, notes) = decode_height_field(path, bytes, settings, None)?;
        log_notes(&path.display().to_string(), &notes);
        Ok(field)
    }

    /// Reads an elevation file and, if there is one, the `.json` sidecar of the same stem beside
    /// it. [`decode_height_field`] has the details; its notes are logged as warnings.
    ///
    /// # Errors
    /// [`HeightFieldLoadError`], whose text says what to do about it.
    pub fn from_file(
        path: impl AsRef<Path>,
        settings: &HeightFieldSettings,
    ) -> Result<Self, HeightFieldLoadError> {
        let path = path.as_ref();
        let (field, notes) = read_height_field(path, settings)?;
        log_notes(&path.display().to_string(), &notes);
        Ok(field)
    }
}

/// [`HeightField::from_file`], with the notes returned instead of logged.
///
/// # Errors
/// [`HeightFieldLoadError`], whose text says what to do about it.
pub fn read_height_field(
    path: impl AsRef<Path>,
    settings: &HeightFieldSettings,
) -> Result<(HeightField, Vec<HeightFieldNote>), HeightFieldLoadError> {
    let path = path.as_ref();
    // A wrong extension is told before a large file is read.
    Format::of(path)?;
    let read = |path: PathBuf| match std::fs::read(&path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(source) if source.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(HeightFieldLoadError::Read { path, source }),
    };
    let bytes = std::fs::read(path).map_err(|source| HeightFieldLoadError::Read {
        path: path.to_owned(),
        source,
    })?;
    let sidecar = read(path.with_extension("json"))?;
    decode_height_field(path, &bytes, settings, sidecar.as_deref())
}

/// Loads [`HeightField`] assets from elevation files; [`decode_height_field`] lists the formats.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_skyline::terrain::{HeightField, HeightFieldSettings};
/// # fn system(assets: Res<AssetServer>) {
/// // Spacing and height range from `alps.json` beside it, if there is one:
/// let alps: Handle<HeightField> = assets.load("alps.png");
/// // or from code:
/// let hills: Handle<HeightField> = assets
///     .load_builder()
///     .with_settings(|settings: &mut HeightFieldSettings| {
///         settings.texel_m = Some(2.0);
///         settings.height_range_m = Some((0.0, 350.0));
///     })
///     .load("hills.png");
/// # }
/// ```
///
/// The file is read again when it or its sidecar changes and the asset server watches for changes.
///
/// # Limits
/// The asset server chooses this loader by the type of the handle, so PNG and TIFF files load as
/// height fields wherever a `Handle<HeightField>` is asked for. It does not claim those extensions
/// for itself: loaded without a type, by folder or untyped, they stay images.
#[derive(TypePath, Default, Clone, Copy, Debug)]
pub struct HeightFieldLoader;

impl AssetLoader for HeightFieldLoader {
    type Asset = HeightField;
    type Settings = HeightFieldSettings;
    type Error = HeightFieldLoadError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        settings: &Self::Settings,
        load_context: &mut LoadContext<'_>,
    ) -> Result<Self::Asset, Self::Error> {
        let path = load_context.path().clone();
        Format::of(path.path())?;
        let mut bytes = Vec::new();
        reader
            .read_to_end(&mut bytes)
            .await
            .map_err(|source| HeightFieldLoadError::Read {
                path: path.path().to_owned(),
                source,
            })?;
        // Reading it through the context makes it a dependency: a changed sidecar reloads us.
        let sidecar_path = AssetPath::from(path.path().with_extension("json"))
            .with_source(path.source().clone_owned());
        let sidecar = match load_context.read_asset_bytes(sidecar_path).await {
            Ok(bytes) => Some(bytes),
            Err(ReadAssetBytesError::AssetReaderError(AssetReaderError::NotFound(_))) => None,
            Err(source) => return Err(HeightFieldLoadError::ReadSidecar(Box::new(source))),
        };
        let (field, notes) =
            decode_height_field(path.path(), &bytes, settings, sidecar.as_deref())?;
        log_notes(&path.to_string(), &notes);
        Ok(field)
    }

    fn extensions(&self) -> &[&str] {
        &["hgt", "raw", "r16"]
    }
}

/// The [`HeightField`] asset and its loader, without anything that draws: enough for a server or a
/// tool that only asks a [`TerrainQuery`](super::TerrainQuery). Needs Bevy's `AssetPlugin`.
pub struct HeightFieldPlugin;

impl Plugin for HeightFieldPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<HeightField>()
            .register_type::<HeightSamples>()
            .register_type::<Changed>()
            .register_type::<MinMaxPyramid>()
            .register_type::<PyramidNodes>()
            .register_type::<HeightFieldSettings>()
            .register_type::<VoidHandling>()
            .register_type::<HeightFieldNote>()
            .register_type::<HeightFieldHit>()
            .register_type::<HeightFieldHitF64>()
            .register_type::<HitSide>()
            .register_type::<TerrainHit>()
            .init_asset::<HeightField>()
            .register_asset_reflect::<HeightField>()
            .init_asset_loader::<HeightFieldLoader>();
    }
}

fn log_notes(path: &str, notes: &[HeightFieldNote]) {
    for note in notes {
        warn!("{path}: {note}");
    }
}
