//! `skyline shadow`.

use std::path::PathBuf;

use bevy::math::DVec3;
use bevy_skyline::{
    offline::{
        render::Sun,
        shadow_map::{self, MapFigures, MapLight, MapShot},
    },
    terrain_shadow::{MOST_STRIPS, ShadowMethod},
};
use clap::Args;
use serde::Serialize;

use crate::{
    error::{CliError, check_writable},
    height_map::{HeightMapArgs, read, tell},
    parse::{method, number, sun, vector},
    print_json,
};

#[derive(Args)]
pub(crate) struct ShadowArgs {
    /// 16-bit PNG or TIFF, float TIFF, SRTM .hgt or raw 16-bit.
    #[arg(long, value_name = "F")]
    heightmap: PathBuf,
    #[command(flatten)]
    scale: HeightMapArgs,
    /// Direction to the sun in degrees: azimuth from +Z (rows) toward +X (columns), elevation above the horizon.
    #[arg(long, value_name = "AZ,EL", value_parser = sun, allow_hyphen_values = true)]
    sun: Option<Sun>,
    /// Position of a point light in metres; Y is up, sample (0,0) at the origin, columns +X, rows +Z.
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    light: Option<DVec3>,
    /// How visibility is found: per-texel, max-mip or sweep (suns only).
    #[arg(long, default_value = "max-mip", value_parser = method)]
    method: ShadowMethod,
    /// Diameter of the sun in degrees, as 0.53; 0 = hard shadows.
    #[arg(long, value_name = "DEG", value_parser = number, allow_hyphen_values = true)]
    angular_size: Option<f64>,
    /// Radius of the light in metres; 0 = hard shadows.
    #[arg(long, value_name = "M", value_parser = number, allow_hyphen_values = true)]
    radius: Option<f64>,
    /// Upright strips that the disc of a light with a size is cut into, each with a ray of its own: 1 to 16.
    // A map made once can take its time.
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    strips: Option<u32>,
    /// The map to write: an 8-bit grey PNG.
    #[arg(long, value_name = "P.png")]
    out: PathBuf,
}

impl ShadowArgs {
    fn shot(&self) -> Result<MapShot, CliError> {
        let usage = |text: &str| Err(CliError::Usage(text.into()));
        let light = match (self.sun, self.light) {
            (Some(_), Some(_)) => {
                return usage(
                    "--sun and --light are two lights, and a map has one: give one of them",
                );
            }
            (None, None) => {
                return usage("where the light is must be said: give --sun AZ,EL or --light X,Y,Z");
            }
            (Some(_), None) if self.radius.is_some() => {
                return usage("--radius is a --light's, in metres: a sun has an --angular-size");
            }
            (None, Some(_)) if self.angular_size.is_some() => {
                return usage("--angular-size is a sun's, in degrees: a --light has a --radius");
            }
            (Some(sun), None) => MapLight::Sun {
                sun,
                angular_size_deg: self.angular_size.unwrap_or(0.0),
            },
            (None, Some(position_m)) => MapLight::Point {
                position_m,
                radius_m: self.radius.unwrap_or(0.0),
            },
        };
        let shot = MapShot {
            light,
            method: self.method,
            strips: self.strips.unwrap_or(MOST_STRIPS),
        };
        shot.check()?;
        if self.strips.is_some() && light.is_hard() {
            return usage(
                "--strips cut the disc of a light that has a size, and this has none: give --angular-size to a \
                 --sun, --radius to a --light",
            );
        }
        Ok(shot)
    }
}

/// What `skyline shadow` prints.
#[derive(Serialize)]
struct ShadowOutput {
    out: PathBuf,
    #[serde(flatten)]
    figures: MapFigures,
}

pub(crate) fn run(args: &ShadowArgs) -> Result<(), CliError> {
    // Everything that can be known to be wrong is said before any work is done.
    let shot = args.shot()?;
    check_writable(&args.out)?;
    let (field, notes) = read(&args.heightmap, &args.scale)?;
    let made = shadow_map::make(field, &shot)?;
    tell(&args.heightmap, notes);
    if shot.method_used() != shot.method {
        let why = match shot.light {
            MapLight::Sun { .. } => "this one stands straight above or below",
            MapLight::Point { .. } => "this light is near by",
        };
        eprintln!(
            "skyline: --method sweep goes away from a sun, and {why}: max-mip was used instead"
        );
    }
    let [width, height] = made.figures.size;
    let picture = image::GrayImage::from_raw(width, height, made.image.visibility);
    let written = picture.map_or_else(
        || Err("the map has the wrong size".to_owned()),
        |picture| {
            picture
                .save_with_format(&args.out, image::ImageFormat::Png)
                .map_err(|error| error.to_string())
        },
    );
    written.map_err(|reason| CliError::Write {
        path: args.out.clone(),
        reason,
    })?;
    print_json(&ShadowOutput {
        out: args.out.clone(),
        figures: made.figures,
    });
    Ok(())
}
