//! One shadow map of a height field, and what it took: `skyline shadow`.

use bevy::{math::DVec3, prelude::*};
use serde::Serialize;

use super::{
    Offline, OfflineError,
    accuracy::Timing,
    render::Sun,
    shadow::{ShadowImage, method_name},
};
use crate::{
    terrain::{HeightField, Terrain},
    terrain_shadow::{MOST_STRIPS, ShadowMethod, light::GridLight, plan::MadeFor},
};

/// A map that takes longer is made once, others a few times more, for their time. units: ms
const SLOW_MS: f64 = 2_000.0;
/// How many times more.
const RUNS: usize = 5;

/// A light over a field, in the field's local space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MapLight {
    /// Infinitely far away.
    Sun {
        /// Where it stands.
        sun: Sun,
        /// Its diameter; 0 for hard shadows. units: degrees
        angular_size_deg: f64,
    },
    /// Near by.
    Point {
        /// units: m
        position_m: DVec3,
        /// 0 for hard shadows. units: m
        radius_m: f64,
    },
}

/// Which map to make, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapShot {
    /// Where the light is.
    pub light: MapLight,
    /// How visibility is found.
    pub method: ShadowMethod,
    /// Strips the disc of a light that has one is cut into.
    pub strips: u32,
}

/// Why a map could not be made.
#[derive(thiserror::Error, Debug)]
#[non_exhaustive]
pub enum MapError {
    /// No such elevation.
    #[error("the sun cannot stand {0} degrees above the horizon: use -90 to 90")]
    Elevation(f64),
    /// No such size.
    #[error("the sun cannot be {0} degrees wide: use 0 (hard shadows) to less than 90")]
    AngularSize(f64),
    /// No such size.
    #[error("a light's radius cannot be {0} m: use 0 (hard shadows) or more")]
    Radius(f64),
    /// A coordinate or an angle is no number, or none that a GPU can hold.
    #[error("{0} must be finite numbers")]
    NonFinite(&'static str),
    /// Too few or too many.
    #[error("a light cannot be cut into {0} strips: use 1 to {MOST_STRIPS}")]
    Strips(u32),
    /// The device refused.
    #[error(transparent)]
    Offline(#[from] OfflineError),
}

impl MapError {
    /// Whether other input would have helped, rather than another machine.
    pub fn is_input(&self) -> bool {
        !matches!(self, Self::Offline(error) if !matches!(error, OfflineError::Refused(_)))
    }
}

/// A map and what it took.
#[derive(Clone, Debug)]
pub struct MadeMap {
    /// The map.
    pub image: ShadowImage,
    /// Figures.
    pub figures: MapFigures,
}

/// What a map took.
#[derive(Serialize, Clone, Debug)]
pub struct MapFigures {
    /// Columns and rows, of the map as of the samples.
    pub size: [u32; 2],
    /// How it was made; see [`MapShot::method_used`].
    pub method: &'static str,
    /// The sun, if it was one.
    pub sun: Option<SunFigures>,
    /// The light, if it was one.
    pub light: Option<LightFigures>,
    /// Strips the light's disc was cut into; 0 = hard shadows. A sweep has 1, however many are asked for.
    pub strips: u32,
    /// How much of the light all samples see on average: of hard shadows, the share that is lit.
    pub lit_fraction: f64,
    /// From a map's submission to the GPU until it was done. units: ms
    pub time_ms: Timing,
    /// Name of the GPU.
    pub adapter: String,
    /// Metres between samples.
    pub spacing_m: f32,
    /// Lowest and highest sample. units: m
    pub height_range_m: [f64; 2],
}

/// A sun, as it is printed.
#[derive(Serialize, Clone, Copy, Debug, PartialEq)]
pub struct SunFigures {
    /// From +Z (rows) toward +X (columns). units: degrees
    pub azimuth_deg: f64,
    /// Above the horizon. units: degrees
    pub elevation_deg: f64,
    /// Its diameter. units: degrees
    pub angular_size_deg: f64,
}

/// A point light, as it is printed.
#[derive(Serialize, Clone, Copy, Debug, PartialEq)]
pub struct LightFigures {
    /// units: m
    pub position_m: [f64; 3],
    /// units: m
    pub radius_m: f64,
}

impl MapLight {
    /// The light as a field's own grid sees it.
    pub fn over(&self, field: &HeightField) -> GridLight {
        let local_from_grid = field.local_from_grid();
        match *self {
            Self::Sun {
                sun,
                angular_size_deg,
            } => GridLight::directional(
                sun.direction(),
                0.5 * angular_size_deg.to_radians(),
                local_from_grid,
            ),
            Self::Point {
                position_m,
                radius_m,
            } => GridLight::point(position_m, radius_m, f64::INFINITY, local_from_grid),
        }
    }

    /// Whether its shadows have no penumbra.
    pub fn is_hard(&self) -> bool {
        match *self {
            Self::Sun {
                angular_size_deg, ..
            } => angular_size_deg == 0.0,
            Self::Point { radius_m, .. } => radius_m == 0.0,
        }
    }

    fn check(&self) -> Result<(), MapError> {
        match *self {
            Self::Sun {
                sun,
                angular_size_deg,
            } => {
                if !sun.azimuth_deg.is_finite() || !sun.elevation_deg.is_finite() {
                    Err(MapError::NonFinite("the sun's angles"))
                } else if sun.elevation_deg.abs() > 90.0 {
                    Err(MapError::Elevation(sun.elevation_deg))
                } else if !(0.0..90.0).contains(&angular_size_deg) {
                    Err(MapError::AngularSize(angular_size_deg))
                } else {
                    Ok(())
                }
            }
            Self::Point {
                position_m,
                radius_m,
            } => {
                // Squares of distances have to be finite too, in `f32`.
                if !(0.0..1e18).contains(&radius_m) {
                    Err(MapError::Radius(radius_m))
                } else if position_m.length() < 1e18 {
                    Ok(())
                } else {
                    Err(MapError::NonFinite(
                        "the coordinates of the light, below 1e18 m,",
                    ))
                }
            }
        }
    }
}

impl MapShot {
    /// Says what is wrong with it, before any device is opened.
    ///
    /// # Errors
    /// Every [`MapError`] that needs no GPU to be seen.
    pub fn check(&self) -> Result<(), MapError> {
        self.light.check()?;
        if (1..=MOST_STRIPS).contains(&self.strips) {
            Ok(())
        } else {
            Err(MapError::Strips(self.strips))
        }
    }

    /// The method that makes the map: [`MaxMip`](ShadowMethod::MaxMip) where a sweep has no way to go, for lights
    /// near by and for a sun straight above or below.
    pub fn method_used(&self) -> ShadowMethod {
        let can_sweep = match self.light {
            MapLight::Sun { sun, .. } => {
                GridLight::directional(sun.direction(), 0.0, default()).can_sweep()
            }
            MapLight::Point { .. } => false,
        };
        if self.method == ShadowMethod::Sweep && !can_sweep {
            ShadowMethod::MaxMip
        } else {
            self.method
        }
    }
}

/// A field in a headless app, for maps of it.
pub struct MapStage {
    /// The app.
    pub offline: Offline,
    field: Handle<HeightField>,
    terrain: Entity,
}

impl MapStage {
    /// Opens a device and puts a field into it.
    ///
    /// # Errors
    /// [`OfflineError::NoDevice`].
    pub fn new(field: HeightField) -> Result<Self, OfflineError> {
        let mut offline = Offline::new()?;
        let (field, terrain) = show(&mut offline, field);
        Ok(Self {
            offline,
            field,
            terrain,
        })
    }

    /// Another field in the place of this one.
    pub fn replace(&mut self, field: HeightField) {
        self.offline.app.world_mut().despawn(self.terrain);
        (self.field, self.terrain) = show(&mut self.offline, field);
    }

    /// Makes a map `runs` times; returns it, and the time each took. units: ms
    ///
    /// # Errors
    /// As [`Offline::cast_shadow`].
    pub fn cast(
        &mut self,
        light: &GridLight,
        method: ShadowMethod,
        strips: u32,
        runs: usize,
    ) -> Result<(ShadowImage, Vec<f64>), OfflineError> {
        self.offline
            .cast_shadow(self.field.id(), light, method, strips, runs)
    }
}

fn show(offline: &mut Offline, field: HeightField) -> (Handle<HeightField>, Entity) {
    let world = offline.app.world_mut();
    let handle = world.resource_mut::<Assets<HeightField>>().add(field);
    let terrain = world.spawn(Terrain::new(handle.clone())).id();
    (handle, terrain)
}

/// Makes one map of `field`.
///
/// # Errors
/// [`MapError`]; [`MapError::is_input`] tells whose fault it is.
pub fn make(field: HeightField, shot: &MapShot) -> Result<MadeMap, MapError> {
    shot.check()?;
    let light = shot.light.over(&field);
    // Far away or on tiny cells, a place in metres may be none in cells.
    if !light.is_usable() {
        return Err(MapError::NonFinite(
            "the light's place, in cells of the field,",
        ));
    }
    let size = field.size().to_array();
    let spacing_m = field.texel_m();
    let (lowest, highest) = field.data_range_m();
    let method = shot.method_used();
    let mut stage = MapStage::new(field)?;
    let (image, mut times) = stage.cast(&light, method, shot.strips, 1)?;
    if times.iter().sum::<f64>() < SLOW_MS {
        // The first may have waited for the driver's compiler.
        times = stage.cast(&light, method, shot.strips, RUNS)?.1;
    }
    let seen: u64 = image.visibility.iter().map(|share| u64::from(*share)).sum();
    let strips = MadeFor::new(&light, method, shot.strips, 0).strips;
    let figures = MapFigures {
        size,
        method: method_name(method),
        sun: match shot.light {
            MapLight::Sun {
                sun,
                angular_size_deg,
            } => Some(SunFigures {
                azimuth_deg: sun.azimuth_deg,
                elevation_deg: sun.elevation_deg,
                angular_size_deg,
            }),
            MapLight::Point { .. } => None,
        },
        light: match shot.light {
            MapLight::Sun { .. } => None,
            MapLight::Point {
                position_m,
                radius_m,
            } => Some(LightFigures {
                position_m: position_m.to_array(),
                radius_m,
            }),
        },
        strips,
        lit_fraction: seen as f64 / (255.0 * image.visibility.len() as f64),
        time_ms: Timing::of(times),
        adapter: stage.offline.adapter(),
        spacing_m,
        height_range_m: [lowest, highest],
    };
    Ok(MadeMap { image, figures })
}
