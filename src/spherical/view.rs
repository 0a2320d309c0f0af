//! From where a mesh is looked at, in its own space, and how far its corners may be off on the screen.

use bevy::math::{DAffine3, DMat3, DVec3, DVec4};

/// Half the distance from 1 to the next `f32`.
const ROUNDING: f64 = 1.0 / (1 << 24) as f64;

/// In units of [`ROUNDING`] and of the magnitudes that enter: how far a corner may be off, across the view, when it has
/// gone through `world_from_local` and `clip_from_world` in `f32`.
///
/// With u for [`ROUNDING`], M, t and p the matrix, the translation and the corner: each coordinate in the world is a
/// sum of four, its matrix rounded before, off by at most 5·u·Σ|terms|; as a vector by 5·√3·u·(σ|p| + |t|), σ being
/// the most that M stretches: below 9. The same holds again for the coordinates across and for `w`, which counts for
/// up to twice as much at the border of a view of 127° from corner to corner: 9·(1 + 2). The inverse of the camera's
/// transform and its product with the projection are themselves made in `f32`, off by up to 25·u of the camera's
/// distance from the origin. In all below 64.
const OPERATIONS: f64 = 64.0;

/// Which side of its triangles a mesh shows: what is left by the material's culling.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shown {
    /// The front, as with `cull_mode: Some(Face::Back)`.
    #[default]
    Front,
    /// The back, as with `cull_mode: Some(Face::Front)`.
    Back,
    /// Both, as with `cull_mode: None`.
    Both,
}

/// Where a camera of the world looks from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    /// Where it is. units: m
    pub position: DVec3,
    /// Orthographic: from the scene towards the camera, of any length but 0. `None`: perspective.
    pub backward: Option<DVec3>,
    /// A pixel's side: perspective, at distance 1 along the view; orthographic, in m.
    pub pixel: f64,
    /// The longer side of the viewport. units: px
    pub viewport: f64,
    /// Bits of the rasteriser's places after the point. 8 on what Direct3D 11 runs on, at least 4 by Vulkan.
    pub sub_pixel_bits: u32,
    /// From the camera to the corners of the near plane; 0 for orthographic. units: m
    pub near: f64,
    /// The way from the world to the picture mirrors: the camera's transform does, or its projection.
    pub is_mirrored: bool,
}

impl Eye {
    /// What Direct3D 11 asks of all hardware.
    pub const SUB_PIXEL_BITS: u32 = 8;

    /// A perspective one that looks through the middle of its picture.
    ///
    /// `fov` is vertical, in rad; `size` is the viewport's, in px.
    pub fn perspective(position: DVec3, fov: f64, size: [f64; 2], near: f64) -> Self {
        let half = (fov / 2.0).tan();
        let across = half * size[0] / size[1];
        Self {
            position,
            backward: None,
            pixel: 2.0 * half / size[1],
            viewport: size[0].max(size[1]),
            sub_pixel_bits: Self::SUB_PIXEL_BITS,
            near: near * (1.0 + half * half + across * across).sqrt(),
            is_mirrored: false,
        }
    }

    /// An orthographic one. `height` is what its picture shows from bottom to top, in m.
    pub fn orthographic(position: DVec3, backward: DVec3, height: f64, size: [f64; 2]) -> Self {
        Self {
            position,
            backward: Some(backward),
            pixel: height / size[1],
            viewport: size[0].max(size[1]),
            sub_pixel_bits: Self::SUB_PIXEL_BITS,
            near: 0.0,
            is_mirrored: false,
        }
    }
}

/// A camera as a mesh sees it.
///
/// The rasteriser doesn't know a corner's place exactly: it is computed in `f32` and then put on a grid of parts of a
/// pixel. In the mesh's space a corner at distance *D* from the eye is off by at most δ = `offset` + `slope`·*D*.
/// A triangle's side is told by corners that are off by that, so only what no such corners can turn round is
/// taken to be seen from behind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// A place with `w` 1, or the direction towards the eye, of length 1, with `w` 0. space: mesh
    pub(super) eye: DVec4,
    /// 1 if fronts are shown, −1 if backs, in the mesh's space.
    pub(super) sign: f64,
    /// Nothing is known, or both sides are shown.
    pub(super) is_any: bool,
    /// units: the mesh's
    pub(super) offset: f64,
    /// Per unit of distance.
    pub(super) slope: f64,
    /// What comes so near may be cut by the near plane. units: the mesh's
    pub(super) near: f64,
}

impl View {
    /// Of a mesh whose corners are at most `reach` from its own origin.
    ///
    /// If the transform has no inverse, or if anything is not finite, the view is one in which everything is shown.
    pub fn new(camera: &Eye, world_from_local: &DAffine3, reach: f64, shown: Shown) -> Self {
        let [most, least] = stretch(world_from_local.matrix3);
        let moved = world_from_local.translation.length();
        let magnitude = most * reach + moved + camera.position.length();
        // Half a step of the grid each way, and the way from clip space to pixels: four roundings.
        let grid = 0.5 / f64::from(camera.sub_pixel_bits).exp2() + 4.0 * ROUNDING * camera.viewport;
        let on_screen = grid * core::f64::consts::SQRT_2 * camera.pixel;
        let local_from_world = world_from_local.inverse();
        let (eye, across, slope) = match camera.backward {
            None => {
                let eye = local_from_world.transform_point3(camera.position);
                (eye.extend(1.0), 0.0, on_screen * most / least)
            }
            Some(backward) => {
                let backward = local_from_world.transform_vector3(backward);
                (backward.normalize().extend(0.0), on_screen, 0.0)
            }
        };
        let offset = (OPERATIONS * ROUNDING * magnitude + across) / least;
        let is_mirrored = (world_from_local.matrix3.determinant() < 0.0) != camera.is_mirrored;
        let near = camera.near / least;
        let is_known = eye.is_finite() && (offset + slope + near).is_finite();
        Self {
            eye,
            sign: if (shown == Shown::Back) == is_mirrored {
                1.0
            } else {
                -1.0
            },
            is_any: shown == Shown::Both || !is_known || least <= 0.0,
            offset,
            slope,
            near,
        }
    }

    /// How far a corner at this distance from the eye may be off. units: the mesh's
    pub fn blur(&self, distance: f64) -> f64 {
        self.offset + self.slope * distance
    }
}

/// A half-space of the world in a mesh's space. Inside is where `plane.xyz · place + plane.w` is not negative.
pub fn half_space_in_local(world: DVec4, world_from_local: &DAffine3) -> DVec4 {
    let normal = world.truncate();
    (world_from_local.matrix3.transpose() * normal)
        .extend(normal.dot(world_from_local.translation) + world.w)
}

/// The most and the least that a matrix stretches: no less and no more than its greatest and its least singular value.
/// From the eigenvalues of MᵀM in closed form (O. K. Smith, 1961).
fn stretch(matrix: DMat3) -> [f64; 2] {
    let square = matrix.transpose() * matrix;
    let mean = (square.x_axis.x + square.y_axis.y + square.z_axis.z) / 3.0;
    let rest = square - DMat3::from_diagonal(DVec3::splat(mean));
    let norm =
        rest.x_axis.length_squared() + rest.y_axis.length_squared() + rest.z_axis.length_squared();
    let p = (norm / 6.0).sqrt();
    let angle = if p > 0.0 {
        ((rest * p.recip()).determinant() / 2.0)
            .clamp(-1.0, 1.0)
            .acos()
            / 3.0
    } else {
        0.0
    };
    let third = core::f64::consts::TAU / 3.0;
    // The closed form is off by some 10⁻⁸ of p where eigenvalues are nearly the same, by 10⁻¹⁵ of all elsewhere.
    let slack = 1e-7 * p + 1e-14 * mean;
    let most = mean + 2.0 * p * angle.cos() + slack;
    let least = mean + 2.0 * p * (angle + third).cos() - slack;
    [most.sqrt(), least.max(0.0).sqrt()]
}
