//! The orthographic views of lights: the cascade as Bevy has it, and the square around it that is cast.
//!
//! Light space is the world turned so that the light shines along -Z; x and y are those of the cascade. units: m

use bevy::{
    light::ShadowFilteringMethod,
    math::{DAffine3, DMat3, DVec2, DVec3, Mat4, Vec2, Vec4},
    render::view::ExtractedView,
};

use super::{
    BORDER, COARSE_TEXELS, EDGE_SLOPE, MAX_REACH,
    gpu::{GpuCascadeErosion, GpuCascadeWrite},
};
use crate::{precision::UNIT_ROUNDOFF, render_graph::extract::ExtractedTerrain};

/// A cascade as receivers see it: NDC = scale * light space + offset.
#[derive(Clone, Copy, Debug)]
pub struct CascadeSquare {
    world_from_light: DMat3,
    scale: DVec3,
    offset: DVec3,
    /// Texels a side.
    size: u32,
}

impl CascadeSquare {
    /// `None` for anything but the orthographic views Bevy makes for directional lights.
    pub fn new(view: &ExtractedView) -> Option<Self> {
        let clip_from_view = view.clip_from_view;
        let world_from_light = view.world_from_view.affine().matrix3.as_dmat3();
        // The receivers' own matrix has the translation with fewer roundings than the view's placement has.
        let clip_from_world = view.clip_from_world.unwrap_or_else(|| {
            clip_from_view * Mat4::from(view.world_from_view.affine().inverse())
        });
        let scale = DVec3::new(
            f64::from(clip_from_view.x_axis.x),
            f64::from(clip_from_view.y_axis.y),
            f64::from(clip_from_view.z_axis.z),
        );
        let size = view.viewport.z;
        let usable = clip_from_view.row(3) == Vec4::W
            && scale.cmpgt(DVec3::ZERO).all()
            && clip_from_world.is_finite()
            && world_from_light.is_finite()
            && size > 0;
        usable.then(|| Self {
            world_from_light,
            scale,
            offset: clip_from_world.w_axis.truncate().as_dvec3(),
            size,
        })
    }

    /// Side of a texel of the shadow map. units: m
    pub fn texel_m(&self) -> f64 {
        2.0 / (self.scale.x.min(self.scale.y) * f64::from(self.size))
    }

    fn centre(&self) -> DVec2 {
        -(self.offset / self.scale).truncate()
    }

    fn half_side(&self) -> f64 {
        1.0 / self.scale.x.min(self.scale.y)
    }
}

/// Between which depths of light space some terrains lie, and how large their coordinates are. units: m
#[derive(Clone, Copy, Debug)]
pub struct LightRange {
    low: f64,
    high: f64,
    magnitude: f64,
}

impl LightRange {
    pub fn empty() -> Self {
        Self {
            low: f64::INFINITY,
            high: f64::NEG_INFINITY,
            magnitude: 0.0,
        }
    }

    /// Takes a terrain's bounding box in.
    pub fn add(&mut self, terrain: &ExtractedTerrain, cascade: &CascadeSquare) {
        let world_from_grid = terrain.world_from_local * terrain.grid_from_local.inverse();
        let (lowest, highest) = terrain.height_range;
        let cells = terrain.cells.as_dvec2();
        for corner in 0..8 {
            let pick = |bit: u32, a: f64, b: f64| if corner & bit == 0 { a } else { b };
            let at = world_from_grid.transform_point3(DVec3::new(
                pick(1, 0.0, cells.x),
                pick(2, lowest, highest),
                pick(4, 0.0, cells.y),
            ));
            let z = cascade.world_from_light.z_axis.dot(at);
            self.low = self.low.min(z);
            self.high = self.high.max(z);
            self.magnitude = self.magnitude.max(at.abs().max_element());
        }
    }
}

/// What was cast for a cascade: a square about it, from before all terrain to behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSquare {
    world_from_light: DMat3,
    coarse_m: f64,
    centre: DVec2,
    near_z: f64,
    range_m: f64,
    pub side: u32,
    pub erosion: GpuCascadeErosion,
}

impl LightSquare {
    /// The square to cast for a cascade, its texels on a grid that doesn't move with the camera.
    ///
    /// `reach` and `receiver_m` as [`reach`] has them.
    pub fn new(
        cascade: &CascadeSquare,
        range: &LightRange,
        reach: u32,
        receiver_m: f64,
    ) -> Option<Self> {
        let coarse_m = cascade.texel_m() * f64::from(COARSE_TEXELS);
        // A little more either way: nothing of the terrain is cut off, and none is at depth 0, which is none.
        let margin_m =
            1.0 + 1e-3 * (range.high - range.low) + 8.0 * UNIT_ROUNDOFF * range.magnitude;
        let range_m = range.high - range.low + 2.0 * margin_m;
        // A product of three terms and its sum for each of two matrices, and the depth's own.
        let rounding_m = 16.0 * UNIT_ROUNDOFF * (range.magnitude + range_m);
        let side = side(cascade.size);
        range_m.is_finite().then(|| Self {
            world_from_light: cascade.world_from_light,
            coarse_m,
            centre: (cascade.centre() / coarse_m).round() * coarse_m,
            near_z: range.high + margin_m,
            range_m,
            side,
            erosion: GpuCascadeErosion {
                size: side as i32,
                reach: reach as i32,
                max_push: (EDGE_SLOPE * 0.5 * coarse_m / range_m) as f32,
                slack: ((rounding_m + receiver_m) / range_m) as f32,
            },
        })
    }

    /// Whether what is wanted of a cascade now can be had from this square too.
    pub fn serves(&self, cascade: &CascadeSquare, wanted: &Self) -> bool {
        let margin = self.coarse_m * f64::from(self.erosion.reach + 2);
        let reaches = (cascade.centre() - self.centre).abs().max_element() + cascade.half_side();
        let same = Self {
            centre: self.centre,
            ..*wanted
        };
        *self == same && reaches <= 0.5 * f64::from(self.side) * self.coarse_m - margin
    }

    /// Projection of the rays.
    pub fn clip_from_view(&self) -> Mat4 {
        let scale = (2.0 / (f64::from(self.side) * self.coarse_m)) as f32;
        Mat4::from_cols(
            Vec4::new(scale, 0.0, 0.0, 0.0),
            Vec4::new(0.0, scale, 0.0, 0.0),
            Vec4::new(0.0, 0.0, (1.0 / self.range_m) as f32, 0.0),
            Vec4::new(0.0, 0.0, 1.0, 1.0),
        )
    }

    /// Placement of the rays.
    pub fn world_from_view(&self) -> DAffine3 {
        DAffine3::from_mat3_translation(
            self.world_from_light,
            self.world_from_light * self.centre.extend(self.near_z),
        )
    }

    /// How a cascade is drawn from this square.
    pub fn write(&self, cascade: &CascadeSquare) -> GpuCascadeWrite {
        let middle = 0.5 * f64::from(self.side);
        let (scale, offset) = (cascade.scale, cascade.offset);
        let x = ((-1.0 - offset.x) / scale.x - self.centre.x) / self.coarse_m + middle;
        let y = ((offset.y - 1.0) / scale.y + self.centre.y) / self.coarse_m + middle;
        GpuCascadeWrite {
            offset: Vec2::new(x as f32, y as f32),
            scale: (cascade.texel_m() / self.coarse_m) as f32,
            depth_scale: (scale.z * self.range_m) as f32,
            depth_offset: (scale.z * (self.near_z - self.range_m) + offset.z) as f32,
            edge: (EDGE_SLOPE * self.coarse_m / self.range_m) as f32,
        }
    }
}

/// Coarse texels a side for a shadow map of `size` texels.
fn side(size: u32) -> u32 {
    let inner = size.div_ceil(COARSE_TEXELS);
    let border = ((inner as f32 * BORDER) as u32).max(1) + MAX_REACH + 2;
    (inner + 2 * border).next_multiple_of(8)
}

/// How far casters shrink, in coarse texels: `ceil(2 + r) - 1`, as derived in `terrain_cascade_erode.wgsl`.
///
/// `receiver_m` is how far below its surface the terrain may be drawn, which moves what it looks up by as much.
pub fn reach(
    filter: ShadowFilteringMethod,
    soft_m: Option<f32>,
    texel_m: f64,
    receiver_m: f64,
) -> u32 {
    // Bevy's `shadow_sampling.wgsl`: the outermost texel that each filter reads, from the point looked up. The
    // spirals are widened by a fitted amount that depends on the texel's size.
    let spiral = |size: f64| {
        let spread = 0.015 + (texel_m - 0.003_906_25) * (0.02 / 0.019_042_969);
        spread * size / texel_m + 1.0
    };
    let filter = match (soft_m, filter) {
        (Some(size), _) if size > 0.0 => {
            let size = f64::from(size);
            (size / texel_m + 1.0).max(spiral(size.max(0.5)))
        }
        (_, ShadowFilteringMethod::Hardware2x2) => 1.0,
        (_, ShadowFilteringMethod::Gaussian) => 3.0,
        (_, ShadowFilteringMethod::Temporal) => spiral(1.0),
    };
    let r = (filter + receiver_m / texel_m) / f64::from(COARSE_TEXELS);
    (((2.0 + r).ceil() - 1.0) as u32).clamp(1, MAX_REACH)
}
