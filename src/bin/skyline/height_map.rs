//! What commands on height maps share: the flags that say how to read one, and reading it.

use std::path::Path;

use bevy_skyline::terrain::{
    HeightField, HeightFieldLoadError, HeightFieldNote, HeightFieldSettings, read_height_field,
};
use clap::Args;

use crate::{
    error::CliError,
    parse::{positive, range},
};

#[derive(Args)]
pub(crate) struct HeightMapArgs {
    /// Metres between samples; else from the file's .json sidecar or format.
    #[arg(long, value_name = "M", value_parser = positive, allow_hyphen_values = true)]
    pub(crate) spacing: Option<f32>,
    /// Heights of the lowest and the highest code, in metres; else from the sidecar or format.
    #[arg(long, value_name = "MIN,MAX", value_parser = range, allow_hyphen_values = true)]
    pub(crate) height_range: Option<(f32, f32)>,
}

pub(crate) fn read(
    path: &Path,
    scale: &HeightMapArgs,
) -> Result<(HeightField, Vec<HeightFieldNote>), CliError> {
    let settings = HeightFieldSettings {
        texel_m: scale.spacing,
        height_range_m: scale.height_range,
        ..Default::default()
    };
    read_height_field(path, &settings).map_err(|source| {
        // Its text names the file itself.
        if let HeightFieldLoadError::Read { .. } = source {
            CliError::Usage(source.to_string())
        } else {
            CliError::HeightMap {
                path: path.to_owned(),
                source,
            }
        }
    })
}

/// Says what had to be assumed; after the work, so that an error stands alone.
pub(crate) fn tell(path: &Path, notes: Vec<HeightFieldNote>) {
    for note in notes {
        match note {
            HeightFieldNote::Assumed {
                texel_m,
                height_range_m,
            } => {
                let spacing = texel_m.map(|m| format!("--spacing {m}"));
                let range = height_range_m.map(|(min, max)| format!("--height-range {min},{max}"));
                let flags: Vec<_> = spacing.into_iter().chain(range).collect();
                eprintln!(
                    "skyline: {}: {} assumed: give the flag, or a .json sidecar beside the file",
                    path.display(),
                    flags.join(" and ")
                );
            }
            note => eprintln!("skyline: {}: {note}", path.display()),
        }
    }
}
