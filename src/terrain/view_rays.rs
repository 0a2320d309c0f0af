//! The rays of one camera through one terrain, set up in `f64` and handed to the GPU in `f32`.
//!
//! Large offsets cancel here and nowhere else: the camera's and the terrain's matrices are composed in
//! double precision, the rays start at a depth just short of the terrain (`t_base`), and positions are
//! relative to a whole cell near that start (`anchor`). What is left for `f32` is never larger than the
//! terrain itself, wherever camera and terrain are.

use bevy::math::{
    DAffine3, DMat4, DVec2, DVec3, IVec2, Mat4, UVec2, Vec2, Vec3, Vec4, Vec4Swizzles,
};

use super::HeightField;
use crate::precision::UNIT_ROUNDOFF;

/// What [`ViewRays::new`] needs to know of camera and terrain.
#[derive(Clone, Copy, Debug)]
pub struct ViewInputs {
    /// Projection with jitter; reverse-Z, perspective or orthographic.
    pub clip_from_view: Mat4,
    /// Grid space (cells, height units) from view space (metres, -Z forward).
    pub grid_from_view: DAffine3,
    /// Size of the viewport. units: px
    pub size_px: UVec2,
    /// Cells of the field.
    pub cells: UVec2,
    /// Lowest and highest sample. units: grid
    pub height_range: (f64, f64),
    /// Whether heights are whole numbers, so that the anchor's height should be one too.
    pub whole_heights: bool,
    /// The error allowed; 0 = exact. units: px
    pub max_error_px: f32,
}

/// Rays of one view, in the terrain's grid space relative to `anchor`.
///
/// The ray of a pixel whose middle lies `q` pixels right of and below the viewport's centre is
/// `origin + q.x origin_dx + q.y origin_dy + t (direction + q.x direction_dx + q.y direction_dy)`,
/// with t the view depth beyond `t_base`. Field by field the same as `TerrainView` in `types.wgsl`.
#[derive(Clone, Copy, Debug)]
pub struct ViewRays {
    pub origin: Vec3,
    pub origin_dx: Vec3,
    pub origin_dy: Vec3,
    pub direction: Vec3,
    pub direction_dx: Vec3,
    pub direction_dy: Vec3,
    /// units: m
    pub t_base: f32,
    /// units: m; finite even where the far plane is not
    pub t_far: f32,
    /// NDC depth is (x + y t) / (z + w t).
    pub depth: Vec4,
    pub lod_a: f32,
    pub lod_b: f32,
    pub beam_a: Vec3,
    pub beam_b: Vec3,
    pub beam_slack: Vec3,
    pub pixel_a: f32,
    pub pixel_b: f32,
    pub y_min: f32,
    pub y_max: f32,
    pub y_magnitude: f32,
    pub anchor: IVec2,
    pub anchor_y: f32,
    pub cells: IVec2,
    pub size_px: UVec2,
    pub max_error_px: f32,
    pub clip_from_grid: Mat4,
    pub depth_from_grid: Vec4,
    pub frustum: [Vec4; 6],
    /// Grid space is mirrored against view space.
    pub mirrored: bool,
    /// Rays can come into the footprint from outside.
    pub enters: bool,
}

/// As `T_NEVER` in `types.wgsl`.
pub const T_NEVER: f32 = 1e18;

/// Rays of a projection in view space: `origin(ndc, t)` and `direction(ndc)` for depth t along -Z.
#[derive(Clone, Copy)]
struct Unprojection {
    matrix: DMat4,
    xy_from_clip: bevy::math::DMat2,
}

impl Unprojection {
    /// `None` for projections with skewed depth or none at all.
    fn new(clip_from_view: DMat4) -> Option<Self> {
        let m = clip_from_view;
        let skewed = [m.x_axis.z, m.x_axis.w, m.y_axis.z, m.y_axis.w]
            .iter()
            .any(|v| v.abs() > 1e-9);
        let xy = bevy::math::DMat2::from_cols(m.x_axis.xy(), m.y_axis.xy());
        let usable = m.is_finite() && !skewed && xy.determinant().abs() > 1e-300;
        usable.then(|| Self {
            matrix: m,
            xy_from_clip: xy.inverse(),
        })
    }

    fn w(&self, t: f64) -> f64 {
        self.matrix.w_axis.w - self.matrix.z_axis.w * t
    }

    fn w_slope(&self) -> f64 {
        -self.matrix.z_axis.w
    }

    /// Point at depth t of the ray through `ndc`.
    fn point(&self, ndc: DVec2, t: f64) -> DVec3 {
        let offset = self.matrix.w_axis.xy() - self.matrix.z_axis.xy() * t;
        (self.xy_from_clip * (ndc * self.w(t) - offset)).extend(-t)
    }

    fn direction(&self, ndc: DVec2) -> DVec3 {
        let slope = -self.matrix.z_axis.xy();
        (self.xy_from_clip * (ndc * self.w_slope() - slope)).extend(-1.0)
    }

    /// Depth of the near plane, where NDC depth is 1.
    fn near(&self) -> f64 {
        let m = self.matrix;
        (m.w_axis.w - m.w_axis.z) / (m.z_axis.w - m.z_axis.z)
    }

    /// Depth of the far plane, where NDC depth is 0; infinite if there is none.
    fn far(&self) -> f64 {
        let m = self.matrix;
        if m.z_axis.z.abs() < 1e-30 {
            f64::INFINITY
        } else {
            m.w_axis.z / m.z_axis.z
        }
    }
}

/// The four corners of a viewport, as NDC.
const CORNERS: [DVec2; 4] = [
    DVec2::new(-1.0, -1.0),
    DVec2::new(1.0, -1.0),
    DVec2::new(-1.0, 1.0),
    DVec2::new(1.0, 1.0),
];

/// The smallest box around where a view's rays start, on its near plane. units: grid
///
/// `None` if the projection has no rays.
pub fn near_plane_bounds(clip_from_view: Mat4, grid_from_view: DAffine3) -> Option<(DVec3, DVec3)> {
    let view = Unprojection::new(clip_from_view.as_dmat4())?;
    let near = view.near();
    let points = CORNERS.map(|ndc| grid_from_view.transform_point3(view.point(ndc, near)));
    let low = points.into_iter().reduce(DVec3::min)?;
    let high = points.into_iter().reduce(DVec3::max)?;
    (low.is_finite() && high.is_finite()).then_some((low, high))
}

impl ViewRays {
    /// Composes the rays. `None` if no ray can meet the terrain: it lies behind the camera or beyond its
    /// far plane, its transform flattens it, or the projection is skewed in depth.
    pub fn new(inputs: &ViewInputs) -> Option<Self> {
        let clip_from_view = inputs.clip_from_view.as_dmat4();
        let view = Unprojection::new(clip_from_view)?;
        let grid_from_view = inputs.grid_from_view;
        let determinant = grid_from_view.matrix3.determinant();
        if !grid_from_view.is_finite() || determinant == 0.0 || inputs.size_px.min_element() == 0 {
            return None;
        }
        let cells = inputs.cells.as_dvec2();
        let (lowest, highest) = inputs.height_range;
        let near = view.near();
        let far = view.far();
        if !near.is_finite() || far <= near {
            return None;
        }

        // No ray meets the terrain before this depth.
        let starts = CORNERS.map(|ndc| grid_from_view.transform_point3(view.point(ndc, near)));
        let ways = CORNERS.map(|ndc| grid_from_view.transform_vector3(view.direction(ndc)));
        let start_low = starts.into_iter().reduce(DVec3::min)?;
        let start_high = starts.into_iter().reduce(DVec3::max)?;
        let way_low = ways.into_iter().reduce(DVec3::min)?;
        let way_high = ways.into_iter().reduce(DVec3::max)?;
        let mut skip: f64 = 0.0;
        let sides = [
            (-start_high.x, way_high.x),
            (start_low.x - cells.x, -way_low.x),
            (-start_high.z, way_high.z),
            (start_low.z - cells.y, -way_low.z),
            (start_low.y - highest, -way_low.y),
        ];
        for (gap, speed) in sides {
            if gap > 0.0 {
                if speed <= 0.0 {
                    return None;
                }
                skip = skip.max(gap / speed);
            }
        }
        // Rounded toward the camera, so that no ray starts beyond what it should have entered.
        let t_base = near.max((near + skip) * (1.0 - 8.0 * UNIT_ROUNDOFF)) as f32;
        let base = f64::from(t_base);
        if base >= far {
            return None;
        }

        let size = inputs.size_px.as_dvec2();
        let ndc_per_px = DVec2::new(2.0 / size.x, -2.0 / size.y);
        let at = |ndc: DVec2| grid_from_view.transform_point3(view.point(ndc, base));
        let way = |ndc: DVec2| grid_from_view.transform_vector3(view.direction(ndc));
        let origin = at(DVec2::ZERO);
        let direction = way(DVec2::ZERO);
        let dx = DVec2::new(ndc_per_px.x, 0.0);
        let dy = DVec2::new(0.0, ndc_per_px.y);
        // Differences of linear functions: taken over the whole viewport, where they cancel least.
        let per_px = |f: &dyn Fn(DVec2) -> DVec3, step: DVec2, count: f64| {
            (f(step * count / 2.0) - f(step * count / -2.0)) / count
        };
        let origin_dx = per_px(&at, dx, size.x);
        let origin_dy = per_px(&at, dy, size.y);
        let direction_dx = per_px(&way, dx, size.x);
        let direction_dy = per_px(&way, dy, size.y);

        let anchor = DVec2::new(origin.x, origin.z)
            .floor()
            .clamp(DVec2::ZERO, cells);
        let anchor_y = origin.y.clamp(lowest, highest);
        let anchor_y = if inputs.whole_heights {
            anchor_y.round()
        } else {
            anchor_y
        } as f32;
        let shift = DVec3::new(anchor.x, f64::from(anchor_y), anchor.y);
        let view_from_grid = grid_from_view.inverse();
        let view_from_anchored = view_from_grid * DAffine3::from_translation(shift);
        let clip_from_grid = clip_from_view * DMat4::from(view_from_anchored);

        // A height error of d grid units moves a point by d |up| metres, hence on the screen by at most
        // focal d |up| sqrt(1 + tan^2) / (t - d |up.z|) pixels; solved for d that is lod_a + lod_b t.
        let up = view_from_grid.matrix3.y_axis;
        let focal = (clip_from_view.x_axis.xy().length() * size.x)
            .max(clip_from_view.y_axis.xy().length() * size.y)
            / 2.0;
        let error = f64::from(inputs.max_error_px).max(0.0);
        let perspective = view.w_slope() != 0.0;
        let (lod_a, lod_b) = if perspective {
            let slant = CORNERS
                .map(|ndc| view.direction(ndc).length())
                .into_iter()
                .fold(1.0, f64::max);
            let per_t = error / (focal / view.w_slope() * up.length() * slant + error * up.z.abs());
            (per_t * base, per_t)
        } else {
            (error * view.w(base) / (focal * up.length()), 0.0)
        };

        let corner_origins = CORNERS.map(|ndc| at(ndc) - shift);
        let origin_size = corner_origins
            .iter()
            .fold(DVec3::ZERO, |m, o| m.max(o.abs()));
        let field_size = DVec3::new(cells.x, highest - lowest, cells.y)
            .max((DVec3::new(0.0, lowest, 0.0) - shift).abs())
            .max((DVec3::new(cells.x, highest, cells.y) - shift).abs());
        let magnitude = field_size + origin_size;
        let sample_size = if inputs.whole_heights {
            0.0
        } else {
            lowest.abs().max(highest.abs())
        };

        let rows = [0, 1, 2, 3].map(|i| clip_from_grid.row(i));
        let frustum = [
            rows[3] + rows[0],
            rows[3] - rows[0],
            rows[3] + rows[1],
            rows[3] - rows[1],
            rows[3] - rows[2],
            rows[3],
        ]
        .map(|plane| {
            let length = plane.xyz().length();
            (if length > 0.0 { plane / length } else { plane }).as_vec4()
        });
        let depth_row = view_from_anchored.matrix3.row(2);
        let outside = start_low.x < 0.0
            || start_low.z < 0.0
            || start_high.x > cells.x
            || start_high.z > cells.y;
        let pixel = |a: DVec3, b: DVec3| {
            DVec2::new(a.x, a.z)
                .length()
                .max(DVec2::new(b.x, b.z).length()) as f32
        };
        Some(Self {
            origin: (origin - shift).as_vec3(),
            origin_dx: origin_dx.as_vec3(),
            origin_dy: origin_dy.as_vec3(),
            direction: direction.as_vec3(),
            direction_dx: direction_dx.as_vec3(),
            direction_dy: direction_dy.as_vec3(),
            t_base,
            t_far: ((far - base).min(f64::from(T_NEVER))) as f32,
            depth: Vec4::new(
                (clip_from_view.w_axis.z - clip_from_view.z_axis.z * base) as f32,
                -clip_from_view.z_axis.z as f32,
                view.w(base) as f32,
                view.w_slope() as f32,
            ),
            lod_a: lod_a as f32,
            lod_b: lod_b as f32,
            beam_a: (0.5 * (origin_dx.abs() + origin_dy.abs())).as_vec3(),
            beam_b: (0.5 * (direction_dx.abs() + direction_dy.abs())).as_vec3(),
            beam_slack: (32.0 * UNIT_ROUNDOFF * magnitude).as_vec3(),
            pixel_a: pixel(origin_dx, origin_dy),
            pixel_b: pixel(direction_dx, direction_dy),
            y_min: (lowest - f64::from(anchor_y)) as f32,
            y_max: (highest - f64::from(anchor_y)) as f32,
            y_magnitude: (magnitude.y + sample_size) as f32,
            anchor: anchor.as_ivec2(),
            anchor_y,
            cells: inputs.cells.as_ivec2(),
            size_px: inputs.size_px,
            max_error_px: error as f32,
            clip_from_grid: clip_from_grid.as_mat4(),
            depth_from_grid: (-depth_row)
                .extend(-view_from_anchored.translation.z - base)
                .as_vec4(),
            frustum,
            mirrored: determinant < 0.0,
            enters: outside,
        })
    }

    /// Origin and direction of the ray through a point of the viewport (pixels from its top left corner),
    /// of the very `f32` numbers the GPU has, without the rounding it adds. units: grid, anchored
    pub fn ray(&self, pixel: Vec2) -> (DVec3, DVec3) {
        let q = (pixel - 0.5 * self.size_px.as_vec2()).as_dvec2();
        let along =
            |o: Vec3, dx: Vec3, dy: Vec3| o.as_dvec3() + q.x * dx.as_dvec3() + q.y * dy.as_dvec3();
        (
            along(self.origin, self.origin_dx, self.origin_dy),
            along(self.direction, self.direction_dx, self.direction_dy),
        )
    }

    /// View depth of an NDC depth as the GPU writes it; infinite for 0. units: m
    pub fn view_depth(&self, ndc: f32) -> f64 {
        let d = self.depth.as_dvec4();
        let ndc = f64::from(ndc);
        if ndc <= 0.0 {
            return f64::INFINITY;
        }
        f64::from(self.t_base) + (ndc * d.z - d.x) / (d.y - ndc * d.w)
    }

    /// Whether any part of the terrain, walls included, can lie in the view. Errs toward `true`.
    pub fn sees_terrain(&self) -> bool {
        let low = (-self.anchor).as_vec2();
        let high = (self.cells - self.anchor).as_vec2();
        // Walls go down without end where rays can come in from outside.
        let floor = if self.enters { -1e12 } else { self.y_min };
        self.frustum[..5].iter().all(|plane| {
            let pick = |n: f32, a: f32, b: f32| if n >= 0.0 { b } else { a };
            let at = Vec3::new(
                pick(plane.x, low.x, high.x),
                pick(plane.y, floor, self.y_max),
                pick(plane.z, low.y, high.y),
            );
            let terms = plane.xyz() * at;
            let slack = 1e-5 * (terms.abs().element_sum() + plane.w.abs());
            terms.element_sum() + plane.w >= -slack
        })
    }
}

/// Whether a box of ray starts (as [`near_plane_bounds`] gives it) lies wholly above the surface or beside
/// the footprint. Errs toward `false`, which only costs time.
///
/// The cost does not depend on the field's size: a small box is compared with the surface itself, a large one
/// with the pyramid.
pub fn starts_in_air(field: &HeightField, (low, high): (DVec3, DVec3)) -> bool {
    // Jitter moves rays by up to a pixel; the box is widened by its own size to be safe.
    let slack = (high - low) * 0.5 + 1e-9 * (low.abs() + high.abs());
    let (low, high) = (low - slack, high + slack);
    let cells = field.cells().as_dvec2();
    if high.x < 0.0 || high.z < 0.0 || low.x > cells.x || low.z > cells.y {
        return true;
    }
    let first = DVec2::new(low.x, low.z).clamp(DVec2::ZERO, cells);
    let last = DVec2::new(high.x, high.z).clamp(DVec2::ZERO, cells);
    low.y > highest_over(field, first, last)
}

/// Highest point of the surface over a rectangle within the footprint, or a bound of it. units: grid
fn highest_over(field: &HeightField, first: DVec2, last: DVec2) -> f64 {
    let cell_of = |at: DVec2| at.floor().as_uvec2().min(field.cells() - 1);
    let (a, b) = (cell_of(first), cell_of(last));
    let mut highest = f64::NEG_INFINITY;
    let across = (b - a).max_element() + 1;
    if across <= 8 {
        // A bilinear patch is highest at a corner of whatever rectangle it is cut down to.
        for j in a.y..=b.y {
            for i in a.x..=b.x {
                let cell = DVec2::new(f64::from(i), f64::from(j));
                let u = (first - cell).clamp(DVec2::ZERO, DVec2::ONE);
                let v = (last - cell).clamp(DVec2::ZERO, DVec2::ONE);
                for at in [u, DVec2::new(v.x, u.y), DVec2::new(u.x, v.y), v] {
                    let edge = |row: u32| {
                        let (p, q) = (
                            field.grid_height(i, j + row),
                            field.grid_height(i + 1, j + row),
                        );
                        p + (q - p) * at.x
                    };
                    let (near, far) = (edge(0), edge(1));
                    highest = highest.max(near + (far - near) * at.y);
                }
            }
        }
        return highest;
    }
    let pyramid = field.pyramid();
    let k = across.ilog2().clamp(1, pyramid.levels());
    for j in (a.y >> k)..=(b.y >> k) {
        for i in (a.x >> k)..=(b.x >> k) {
            highest = highest.max(pyramid.get(k, i, j).0);
        }
    }
    highest
}
