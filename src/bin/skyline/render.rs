//! `skyline render`.

use std::path::PathBuf;

use bevy::math::{DVec3, UVec2};
use bevy_skyline::{
    offline::render::{Figures, Shot, Sun, render},
    terrain::{TerrainRayCasting, Traversal},
};
use clap::Args;
use serde::Serialize;

use crate::{
    error::{CliError, check_writable},
    height_map::{HeightMapArgs, read, tell},
    parse::{size, sun, traversal, vector},
    print_json,
};

#[derive(Args)]
pub(crate) struct RenderArgs {
    /// 16-bit PNG or TIFF, float TIFF, SRTM .hgt or raw 16-bit.
    #[arg(long, value_name = "F")]
    heightmap: PathBuf,
    #[command(flatten)]
    scale: HeightMapArgs,
    /// Where the camera is, in metres; Y is up, sample (0,0) at the origin, columns +X, rows +Z.
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    eye: DVec3,
    /// What it looks at, in metres.
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    target: DVec3,
    /// Pixels of the picture.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size, allow_hyphen_values = true)]
    size: UVec2,
    /// Vertical field of view in degrees.
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = 45.0,
        allow_hyphen_values = true
    )]
    fov: f64,
    /// Direction to the sun in degrees: azimuth from +Z toward +X, elevation above the horizon.
    #[arg(long, value_name = "AZ,EL", value_parser = sun, allow_hyphen_values = true)]
    sun: Option<Sun>,
    /// How rays skip empty space: per-texel, max-mip, boxes or hybrid. All give the same picture.
    #[arg(long, default_value = "hybrid", value_parser = traversal)]
    traversal: Traversal,
    /// Side of the smallest box in cells, from 4.
    #[arg(long, value_name = "N", default_value_t = TerrainRayCasting::default().box_texels, allow_hyphen_values = true)]
    box_texels: u32,
    /// How far the picture may be from the exact surface, in pixels; 0 is exact.
    // A picture made once can take its time: exact, unless less is asked for.
    #[arg(
        long,
        value_name = "E",
        default_value_t = 0.0,
        allow_hyphen_values = true
    )]
    max_error_px: f32,
    /// The picture to write.
    #[arg(long, value_name = "P.png")]
    out: PathBuf,
    /// View-space distances along -Z to write: little-endian f32 in metres, rows from the top left, +inf for sky.
    #[arg(long, value_name = "D.f32")]
    depth: Option<PathBuf>,
}

/// What `skyline render` prints.
#[derive(Serialize)]
struct RenderOutput {
    out: PathBuf,
    depth: Option<PathBuf>,
    #[serde(flatten)]
    figures: Figures,
}

pub(crate) fn run(args: &RenderArgs) -> Result<(), CliError> {
    let shot = Shot {
        eye: args.eye,
        target: args.target,
        size: args.size,
        fov_deg: args.fov,
        sun: args.sun.unwrap_or_default(),
        casting: TerrainRayCasting {
            traversal: args.traversal,
            box_texels: args.box_texels,
            max_error_px: args.max_error_px,
        },
    };
    // Everything that can be known to be wrong is said before any work is done.
    shot.check()?;
    check_writable(&args.out)?;
    args.depth.as_deref().map_or(Ok(()), check_writable)?;
    let (field, notes) = read(&args.heightmap, &args.scale)?;
    let rendered = render(field, &shot)?;
    tell(&args.heightmap, notes);
    rendered
        .picture
        .save_with_format(&args.out, image::ImageFormat::Png)
        .map_err(|error| CliError::Write {
            path: args.out.clone(),
            reason: error.to_string(),
        })?;
    if let Some(path) = &args.depth {
        let bytes: Vec<u8> = rendered
            .depth_m
            .iter()
            .flat_map(|depth| depth.to_le_bytes())
            .collect();
        std::fs::write(path, bytes).map_err(|error| CliError::Write {
            path: path.clone(),
            reason: error.to_string(),
        })?;
    }
    print_json(&RenderOutput {
        out: args.out.clone(),
        depth: args.depth.clone(),
        figures: rendered.figures,
    });
    Ok(())
}
