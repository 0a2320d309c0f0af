//! One picture of a height field, with its depth and what it cost: `skyline render`.

use std::collections::BTreeMap;

use bevy::{
    camera::ClearColorConfig,
    core_pipeline::tonemapping::Tonemapping,
    light::{AmbientLight, SunDisk},
    math::DVec3,
    pbr::{DistanceFog, FogFalloff},
    platform::time::Instant,
    prelude::*,
};
use serde::Serialize;

use super::{HitImage, Offline, OfflineError, traversal_name};
use crate::terrain::{HeightField, Terrain, TerrainRayCasting, Traversal};

/// Frames to wait for a picture; loading and compiling take two.
const MOST_FRAMES: u32 = 16;
/// Colour of the sky, which distant ground fades into.
const SKY: Color = Color::srgb(0.66, 0.77, 0.88);
/// Distance at which the ground has all but faded, as a multiple of the field's longer side.
const VISIBILITY_EXTENTS: f32 = 4.0;

/// Passes that find where rays hit, in their order.
pub const CAST_PASSES: [&str; 4] = ["subdivide", "box_entry", "beam", "ray_cast"];

/// Whether a traversal has a pass of [`CAST_PASSES`] at all.
pub fn has_pass(traversal: Traversal, pass: &str) -> bool {
    match pass {
        "subdivide" | "box_entry" => matches!(traversal, Traversal::Boxes | Traversal::Hybrid),
        "beam" => traversal == Traversal::Hybrid,
        _ => true,
    }
}

/// Where a picture is taken from, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// Where the camera is. units: m
    pub eye: DVec3,
    /// What it looks at. units: m
    pub target: DVec3,
    /// units: px
    pub size: UVec2,
    /// Vertical field of view. units: degrees
    pub fov_deg: f64,
    /// Direction to the sun.
    pub sun: Sun,
    /// How rays are cast.
    pub casting: TerrainRayCasting,
}

/// Direction to the sun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sun {
    /// From +Z (rows) toward +X (columns). units: degrees
    pub azimuth_deg: f64,
    /// Above the horizon. units: degrees
    pub elevation_deg: f64,
}

impl Default for Sun {
    /// North-west of a map with north up, as cartographers light relief.
    fn default() -> Self {
        Self {
            azimuth_deg: 235.0,
            elevation_deg: 32.0,
        }
    }
}

impl Sun {
    /// Unit vector to the sun.
    pub fn direction(&self) -> DVec3 {
        let (azimuth, elevation) = (
            self.azimuth_deg.to_radians(),
            self.elevation_deg.to_radians(),
        );
        DVec3::new(
            azimuth.sin() * elevation.cos(),
            elevation.sin(),
            azimuth.cos() * elevation.cos(),
        )
    }
}

/// Why a picture could not be taken.
#[derive(thiserror::Error, Debug)]
#[non_exhaustive]
pub enum RenderError {
    /// A coordinate or an angle is no number.
    #[error("{0} must be finite numbers")]
    NonFinite(&'static str),
    /// There is no direction to look in.
    #[error(
        "eye and target are the same point: move one of them, so that there is a direction to look in"
    )]
    NoDirection,
    /// No pixels.
    #[error("a picture of {0}x{1} pixels has none: both numbers must be at least 1")]
    Empty(u32, u32),
    /// Too many pixels.
    #[error(
        "a picture of {width}x{height} pixels is larger than this GPU can draw: at most {limit} a side"
    )]
    TooLarge {
        /// units: px
        width: u32,
        /// units: px
        height: u32,
        /// units: px
        limit: u32,
    },
    /// No field of view.
    #[error(
        "a field of view of {0} degrees cannot be drawn: it must be more than 0 and less than 180"
    )]
    FieldOfView(f64),
    /// No such elevation.
    #[error("the sun cannot stand {0} degrees above the horizon: use -90 to 90")]
    Elevation(f64),
    /// No such error bound.
    #[error("an error of {0} px cannot be asked for: use 0 (exact) or more")]
    MaxError(f32),
    /// Boxes too small.
    #[error("boxes of {0} texels are too small to pay: use 4 or more")]
    BoxTexels(u32),
    /// The device refused.
    #[error(transparent)]
    Offline(#[from] OfflineError),
}

impl RenderError {
    /// Whether other input would have helped, rather than another machine.
    pub fn is_input(&self) -> bool {
        !matches!(
            self,
            Self::Offline(
                OfflineError::NoDevice
                    | OfflineError::NotFinished(_)
                    | OfflineError::ReadBack(_)
                    | OfflineError::Unsupported(_)
            )
        )
    }
}

impl Shot {
    /// The default picture from a point toward another: 1280×720, 45°.
    pub fn new(eye: DVec3, target: DVec3) -> Self {
        Self {
            eye,
            target,
            size: UVec2::new(1280, 720),
            fov_deg: 45.0,
            sun: Sun::default(),
            casting: TerrainRayCasting::default(),
        }
    }

    /// Says what is wrong with it, before any device is opened.
    ///
    /// # Errors
    /// Every [`RenderError`] that needs no GPU to be seen.
    pub fn check(&self) -> Result<(), RenderError> {
        let finite = |v: DVec3| v.as_vec3().is_finite();
        if !finite(self.eye) {
            return Err(RenderError::NonFinite("the coordinates of the eye"));
        }
        if !finite(self.target) {
            return Err(RenderError::NonFinite("the coordinates of the target"));
        }
        if self.eye == self.target {
            return Err(RenderError::NoDirection);
        }
        if self.size.min_element() == 0 {
            return Err(RenderError::Empty(self.size.x, self.size.y));
        }
        if !(self.fov_deg > 0.0 && self.fov_deg < 180.0) {
            return Err(RenderError::FieldOfView(self.fov_deg));
        }
        if !self.sun.azimuth_deg.is_finite() || !self.sun.elevation_deg.is_finite() {
            return Err(RenderError::NonFinite("the sun's angles"));
        }
        if self.sun.elevation_deg.abs() > 90.0 {
            return Err(RenderError::Elevation(self.sun.elevation_deg));
        }
        if !(self.casting.max_error_px >= 0.0 && self.casting.max_error_px.is_finite()) {
            return Err(RenderError::MaxError(self.casting.max_error_px));
        }
        if self.casting.box_texels < 4 {
            return Err(RenderError::BoxTexels(self.casting.box_texels));
        }
        Ok(())
    }

    /// The camera's placement: +Y up, or −Z where it looks straight up or down.
    pub fn transform(&self) -> Transform {
        let forward = (self.target - self.eye).normalize();
        let level = DVec3::new(forward.x, 0.0, forward.z).length();
        let up = if level < 1e-9 { DVec3::NEG_Z } else { DVec3::Y };
        let right = forward.cross(up).normalize();
        let axes = bevy::math::DMat3::from_cols(right, right.cross(forward), -forward);
        let rotation = bevy::math::DQuat::from_mat3(&axes).as_quat();
        Transform::from_translation(self.eye.as_vec3()).with_rotation(rotation)
    }

    /// The lens. Nothing is nearer than its near plane: a thousandth of a cell, or of the way to the target.
    pub fn projection(&self, field: &HeightField) -> PerspectiveProjection {
        let reach = f64::from(field.texel_m()).min(self.eye.distance(self.target));
        PerspectiveProjection {
            fov: self.fov_deg.to_radians() as f32,
            near: (1e-3 * reach).clamp(1e-6, 0.1) as f32,
            ..default()
        }
    }
}

/// A picture and what it took.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// sRGB.
    pub picture: image::RgbImage,
    /// View-space distance along −Z, row by row from the top left; infinite for sky. units: m
    pub depth_m: Vec<f32>,
    /// What the rays hit and read.
    pub hits: HitImage,
    /// Figures.
    pub figures: Figures,
}

/// What a picture took.
#[derive(Serialize, Clone, Debug)]
pub struct Figures {
    /// units: px
    pub size: [u32; 2],
    /// Name of the GPU.
    pub adapter: String,
    /// How rays skipped empty space.
    pub traversal: &'static str,
    /// Side of the smallest box. units: cells
    pub box_texels: u32,
    /// The error allowed. units: px
    pub max_error_px: f32,
    /// GPU time of each pass that casts rays, and their `total`. units: ms
    pub gpu_ms: BTreeMap<&'static str, f64>,
    /// How `gpu_ms` was measured.
    pub gpu_ms_by: Clock,
    /// Nodes and cells read for each pixel, on average.
    pub mean_reads: f64,
    /// Pixels that show terrain.
    pub terrain_px: usize,
    /// Nearest and farthest terrain, along −Z. units: m
    pub depth_range_m: Option<[f32; 2]>,
    /// Columns and rows of samples.
    pub samples: [u32; 2],
    /// Metres between samples.
    pub spacing_m: f32,
    /// Lowest and highest sample. units: m
    pub height_range_m: [f64; 2],
}

/// How a GPU time was measured.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum Clock {
    /// Nothing ran.
    #[default]
    None,
    /// The GPU's own timestamps around a pass.
    Timestamps,
    /// Each pass by itself, from its submission until it was done.
    Wait,
}

impl Clock {
    /// In words, for tables.
    pub fn words(self) -> &'static str {
        match self {
            Self::None => "not measured",
            Self::Timestamps => "the GPU's timestamps",
            Self::Wait => "the wall clock, from a pass's submission until it was done",
        }
    }
}

/// A field, its light and one camera, in a headless app.
pub struct Stage {
    /// The app.
    pub offline: Offline,
    /// The terrain's entity.
    pub terrain: Entity,
    /// The camera's entity.
    pub camera: Entity,
    /// What the camera draws to.
    pub target: Handle<Image>,
}

impl Stage {
    /// Opens a device and sets up a field for pictures of one size.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`], or that there is no device.
    pub fn new(field: HeightField, shot: &Shot) -> Result<Self, RenderError> {
        let mut offline = Offline::new()?;
        let limit = offline.max_image_side();
        if shot.size.max_element() > limit {
            let UVec2 {
                x: width,
                y: height,
            } = shot.size;
            return Err(RenderError::TooLarge {
                width,
                height,
                limit,
            });
        }
        let extent = field.extent_m().max_element();
        let projection = shot.projection(&field);
        let world = offline.app.world_mut();
        let handle = world.resource_mut::<Assets<HeightField>>().add(field);
        let terrain = world.spawn(Terrain::new(handle)).id();
        let to_sun = shot.sun.direction().as_vec3();
        let up = if to_sun.xz().length() < 1e-3 {
            Vec3::NEG_Z
        } else {
            Vec3::Y
        };
        world.spawn((
            DirectionalLight {
                illuminance: 6_500.0,
                color: Color::srgb(1.0, 0.95, 0.87),
                ..default()
            },
            SunDisk::OFF,
            Transform::IDENTITY.looking_to(-to_sun, up),
        ));
        let target = offline.target(shot.size);
        let camera = offline.camera(
            &target,
            (
                Camera {
                    clear_color: ClearColorConfig::Custom(SKY),
                    ..default()
                },
                Projection::Perspective(projection),
                Msaa::Off,
                Tonemapping::None,
                shot.transform(),
                shot.casting,
                AmbientLight {
                    color: Color::srgb(0.75, 0.86, 1.0),
                    brightness: 560.0,
                    ..default()
                },
                DistanceFog {
                    color: SKY,
                    falloff: FogFalloff::from_visibility(extent * VISIBILITY_EXTENTS),
                    ..default()
                },
            ),
        );
        Ok(Self {
            offline,
            terrain,
            camera,
            target,
        })
    }

    /// Points the camera; the picture's size stays.
    pub fn look(&mut self, shot: &Shot) {
        let mut camera = self.offline.app.world_mut().entity_mut(self.camera);
        camera.insert((shot.transform(), shot.casting));
    }

    /// Sets how rays are cast.
    pub fn cast(&mut self, casting: TerrainRayCasting) {
        self.offline
            .app
            .world_mut()
            .entity_mut(self.camera)
            .insert(casting);
    }

    /// Draws until the picture is there.
    ///
    /// # Errors
    /// [`OfflineError`].
    pub fn settle(&mut self) -> Result<(), OfflineError> {
        // The camera learns its size, and the terrain's heights reach the GPU, in the first frame.
        self.offline.step();
        if self.offline.view_rays(self.camera, self.terrain).is_some() {
            return self.offline.settle(self.camera, MOST_FRAMES);
        }
        // Only sky: nothing to wait for, but the height field may still be refused.
        self.offline.step();
        let counts = self.offline.counts();
        match (counts.unsupported, counts.refused.into_iter().next()) {
            (Some(reason), _) => Err(OfflineError::Unsupported(reason)),
            (None, Some(reason)) => Err(OfflineError::Refused(reason)),
            (None, None) => Ok(()),
        }
    }

    /// Time of each pass that casts the rays of the view last drawn, and how it was measured. units: ms
    ///
    /// Draws one to three more frames.
    pub fn gpu_ms(&mut self) -> (BTreeMap<&'static str, f64>, Clock) {
        let casting = self
            .offline
            .app
            .world()
            .get::<TerrainRayCasting>(self.camera);
        let traversal = casting.copied().unwrap_or_default().traversal;
        let runs = |pass: &&str| has_pass(traversal, pass);
        if self.offline.is_software() {
            let times = self.offline.time_cast(self.camera);
            let times = times
                .into_iter()
                .flat_map(|times| CAST_PASSES.into_iter().zip(times));
            return (times.filter(|(pass, _)| runs(pass)).collect(), Clock::Wait);
        }
        // A frame's timestamps reach the main world two frames later.
        let asked = Instant::now();
        for _ in 0..3 {
            self.offline.step();
        }
        let ms = |pass| self.offline.gpu_ms_since(pass, asked);
        let times = CAST_PASSES
            .into_iter()
            .filter(runs)
            .filter_map(|pass| Some((pass, ms(pass)?)));
        (times.collect(), Clock::Timestamps)
    }

    /// The picture last drawn.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn picture(&self) -> Result<image::RgbImage, OfflineError> {
        let picture = self.offline.picture(&self.target)?;
        Ok(image::DynamicImage::ImageRgba8(picture).into_rgb8())
    }

    /// What rays hit in the frame last drawn.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn hits(&self, size: UVec2) -> Result<HitImage, OfflineError> {
        Ok(self
            .offline
            .hits(self.camera)?
            .unwrap_or_else(|| HitImage::sky(size)))
    }
}

/// Takes one picture of `field`.
///
/// # Errors
/// [`RenderError`]; [`RenderError::is_input`] tells whose fault it is.
pub fn render(field: HeightField, shot: &Shot) -> Result<Rendered, RenderError> {
    shot.check()?;
    let samples = field.size().to_array();
    let spacing_m = field.texel_m();
    let (lowest, highest) = field.data_range_m();
    let mut stage = Stage::new(field, shot)?;
    stage.settle()?;
    let hits = stage.hits(shot.size)?;
    let rays = stage.offline.view_rays(stage.camera, stage.terrain);
    let depth_m: Vec<f32> = hits
        .ndc_depth
        .iter()
        .map(|ndc| {
            rays.as_ref()
                .map_or(f32::INFINITY, |rays| rays.view_depth(*ndc) as f32)
        })
        .collect();
    let ground = || depth_m.iter().copied().filter(|depth| depth.is_finite());
    let depth_range_m = ground()
        .reduce(f32::min)
        .zip(ground().reduce(f32::max))
        .map(<[f32; 2]>::from);
    let picture = stage.picture()?;
    let (mut gpu_ms, gpu_ms_by) = if rays.is_some() {
        stage.gpu_ms()
    } else {
        default()
    };
    if !gpu_ms.is_empty() {
        gpu_ms.insert("total", gpu_ms.values().sum());
    }
    let figures = Figures {
        size: shot.size.to_array(),
        adapter: stage.offline.adapter(),
        traversal: traversal_name(shot.casting.traversal),
        box_texels: shot.casting.box_texels,
        max_error_px: shot.casting.max_error_px,
        gpu_ms,
        gpu_ms_by,
        mean_reads: hits.mean_reads(),
        terrain_px: hits.terrain_px(),
        depth_range_m,
        samples,
        spacing_m,
        height_range_m: [lowest, highest],
    };
    Ok(Rendered {
        picture,
        depth_m,
        hits,
        figures,
    })
}
