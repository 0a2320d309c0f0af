//! Resolution scale: the main passes draw fewer pixels, and one pass stretches them over the viewport.
//!
//! A camera with a [`ResolutionScale`] below 1 has its main passes draw into the upper left part of its viewport
//! (Bevy's `MainPassResolutionOverride`). [`upscale`](mod@crate::render_graph::upscale) then stretches that part over
//! the viewport, before any post-processing. What it guarantees:
//!
//! - The picture does not shift: the drawn part and the viewport have the same corners, whatever the sizes are, and the
//!   stretch reads each pixel's centre from where it lies in the drawn part.
//! - No colour appears that its four nearest drawn pixels do not span, so bright edges neither ring nor turn black.
//! - Pixels outside the camera's viewport stay as they were, and none of them is mixed into its picture.
//! - Post-processing and user interfaces come after the stretch, at full resolution. On an `Hdr` camera the stretch is
//!   before tonemapping; on others Bevy tonemaps in the main passes, so that it comes after; in linear light all the same, unless the
//!   camera's `CompositingSpace` keeps its texture otherwise.
//! - The scale may change every frame: nothing is allocated and no pipeline compiled for it.
//! - At 1, or without the component, nothing runs and nothing is held: no override, no pipeline, no pass.
//!
//! The first scaled camera of a kind of target is drawn at full size until the one pipeline is compiled. Culling,
//! picking and areas in pixels keep counting in pixels of the whole viewport.
//!
//! # What of Bevy heeds it
//! | In Bevy 0.19 | With a scale |
//! |---|---|
//! | prepasses, deferred prepass, opaque and transparent passes, atmosphere, order-independent transparency | heed the override by themselves |
//! | clustered lights and decals, deferred lighting, skybox, fog, transmission, wireframes | look at the view's viewport instead; while the main passes run this is the drawn part, so that they are right too |
//! | bloom, tonemapping, FXAA, SMAA, auto exposure, lens effects, UI, egui | come after the stretch, at full resolution |
//! | textures | are sampled for the pixels drawn; there is no mip bias |
//! | gizmos and wide wireframes | have their width in drawn pixels, so lines become thicker in the picture |
//! | jitter (TAA, DLSS), motion vectors, SSAO, screen-space reflections, contact shadows, volumetric fog, Bevy's own `OcclusionCulling` | take the textures of the camera for whole: a camera with one of them is drawn at full size ([`FullSize`]), with one warning |
//! | depth of field | reads the depth, which is not stretched, and focuses wrongly: don't use both |
//!
//! The crate's own terrain and occlusion culling heed it. A pass of your own that runs among the main passes finds the
//! drawn part in `view.main_pass_viewport` (and in `view.viewport`), one that runs after them gets the stretched picture,
//! but the depth and prepass textures as they were drawn.

//! # What it saves
//! Measured on a software renderer with two busy cores, 480×270, 60 spheres in the light of twelve point lights, settings
//! in turn, medians of 15 frames. Pixels were the work there: where vertices or objects are, less is saved.
//!
//! | Scale | Share of the pixels | Frame, share of that at 1 | The same with `Hdr` |
//! |---|---|---|---|
//! | 1 | 1 | 1 | 1 |
//! | 0.75 | 0.56 | 0.69 | 0.71 |
//! | 0.5 | 0.25 | 0.47 | 0.46 |
//! | 0.25 | 0.06 | 0.18 | 0.18 |
//!
//! `upscale` took 6 to 16 ms of frames of 200 to 1,250 ms.

use bevy::prelude::*;

/// On a camera with `Camera3d`: the share of the viewport's width and height that the main passes draw.
///
/// 1 draws all and costs nothing; 0.5 draws a quarter of the pixels. range: 0.25..=1, default: 1. What lies outside
/// counts as the nearest bound, what is not a number as 1; either warns once for each camera.
///
/// It does nothing, and says why in one warning and in [`Effects`](crate::effects::Effects), where [`FullSize`] lists a
/// reason.
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// # let target = headless::target();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let world = app.world_mut();
/// let scale = ResolutionScale(0.5);
/// let camera = world.spawn((Camera3d::default(), target, scale)).id();
/// # app.update();
///
/// // The camera's own viewport stays as it is: culling and picking count in its pixels.
/// let viewport = app.world().get::<Camera>(camera).and_then(|camera| camera.physical_viewport_size());
/// assert_eq!(viewport, Some(UVec2::new(1280, 720)));
/// assert_eq!(scale.drawn_size(UVec2::new(1280, 720)), UVec2::new(640, 360));
/// ```
#[derive(Component, Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct ResolutionScale(
    /// Share of the width and height. range: 0.25..=1, default: 1
    pub f32,
);

impl Default for ResolutionScale {
    fn default() -> Self {
        Self(1.0)
    }
}

impl ResolutionScale {
    /// The smallest scale: below it the stretch would have too little to go by.
    pub const LEAST: f32 = 0.25;

    /// The scale that holds. range: 0.25..=1
    pub fn clamped(self) -> f32 {
        if self.0.is_nan() {
            1.0
        } else {
            self.0.clamp(Self::LEAST, 1.0)
        }
    }

    /// Whether the scale is one that holds as it is.
    pub fn is_valid(self) -> bool {
        (Self::LEAST..=1.0).contains(&self.0)
    }

    /// Size of what is drawn of a viewport: the scaled size, rounded, at least one pixel a side and never more than
    /// the viewport has. units: px
    pub fn drawn_size(self, viewport: UVec2) -> UVec2 {
        let scale = f64::from(self.clamped());
        viewport.map(|side| ((f64::from(side) * scale).round() as u32).clamp(side.min(1), side))
    }
}

/// Why a camera with a [`ResolutionScale`] is drawn at full size all the same.
#[derive(Reflect, Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[reflect(Clone, Debug, PartialEq, Hash)]
pub enum FullSize {
    /// `MainPassResolutionOverride` was set by someone else, an upscaler for instance.
    Overridden,
    /// The camera is not drawn by `Core3d`.
    NotCore3d,
    /// `ClearColorConfig::None`: what is there already would be stretched with what is drawn.
    DrawsOverOthers,
    /// `TemporalJitter`: frames are put together by their pixels (TAA, DLSS).
    Jitters,
    /// `MotionVectorPrepass`: who reads motion looks for it in the pixels of the whole viewport.
    MotionVectors,
    /// `ScreenSpaceAmbientOcclusion`.
    AmbientOcclusion,
    /// `ScreenSpaceReflections`.
    Reflections,
    /// `ContactShadows`.
    ContactShadows,
    /// `VolumetricFog`.
    VolumetricFog,
    /// Bevy's own `OcclusionCulling`.
    BevysOcclusionCulling,
}

impl FullSize {
    /// The reason and its remedy, as said of the camera.
    pub const fn reason(self) -> &'static str {
        match self {
            Self::Overridden => {
                "it already has a `MainPassResolutionOverride` from elsewhere: use one of the two"
            }
            Self::NotCore3d => {
                "it is not drawn by `Core3d`: use `Camera3d` with its own render graph"
            }
            Self::DrawsOverOthers => {
                "it draws over what is there already (`ClearColorConfig::None`): give it a clear colour"
            }
            Self::Jitters => {
                "it has `TemporalJitter` (TAA, DLSS), which puts frames together by their pixels: use one of the two"
            }
            Self::MotionVectors => {
                "it has `MotionVectorPrepass`, whose readers expect the whole viewport: use one of the two"
            }
            Self::AmbientOcclusion => {
                "it has `ScreenSpaceAmbientOcclusion`, which reads depth of the whole viewport: use one of the two"
            }
            Self::Reflections => {
                "it has `ScreenSpaceReflections`, which read depth of the whole viewport: use one of the two"
            }
            Self::ContactShadows => {
                "it has `ContactShadows`, which read depth of the whole viewport: use one of the two"
            }
            Self::VolumetricFog => {
                "it has `VolumetricFog`, which is drawn over the whole viewport: use one of the two"
            }
            Self::BevysOcclusionCulling => {
                "it has Bevy's `OcclusionCulling`, which reads depth of the whole target: use `ZBufferOcclusion` instead"
            }
        }
    }
}

impl core::fmt::Display for FullSize {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.reason())
    }
}

/// Registers types.
pub(crate) fn register(app: &mut App) {
    app.register_type::<ResolutionScale>();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_out_of_range_counts_as_the_nearest_bound() {
        for (given, holds) in [
            (1.0, 1.0),
            (0.5, 0.5),
            (0.25, 0.25),
            (0.0, 0.25),
            (-3.0, 0.25),
            (7.0, 1.0),
            (f32::INFINITY, 1.0),
            (f32::NEG_INFINITY, 0.25),
            (f32::NAN, 1.0),
        ] {
            assert_eq!(ResolutionScale(given).clamped(), holds, "{given}");
            assert_eq!(ResolutionScale(given).is_valid(), given == holds, "{given}");
        }
    }

    #[test]
    fn at_least_a_pixel_is_drawn_and_never_more_than_there_are() {
        let drawn = |scale, x, y| ResolutionScale(scale).drawn_size(UVec2::new(x, y));
        assert_eq!(drawn(0.5, 160, 90), UVec2::new(80, 45));
        assert_eq!(drawn(0.75, 161, 91), UVec2::new(121, 68));
        assert_eq!(drawn(0.25, 1, 1), UVec2::ONE);
        assert_eq!(drawn(0.25, 0, 5), UVec2::new(0, 1));
        assert_eq!(drawn(1.0, u32::MAX, 3), UVec2::new(u32::MAX, 3));
        assert_eq!(drawn(f32::NAN, 33, 3), UVec2::new(33, 3));
        assert_eq!(drawn(0.999, 100, 100), UVec2::new(100, 100));
    }
}
