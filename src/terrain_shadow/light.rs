//! A light as the shadow rays of one height field see it: composed in `f64`, in the field's own grid space.
//!
//! A sample (i, j) with height h stands at (i, h, j). Its shadow ray goes from there straight to the light, and
//! the sample is in shadow if any part of the ray in between lies below the surface. The sample itself lies
//! *on* the surface: the ray starts at height zero above it exactly, so neither acne nor a bias against it can
//! arise, and a light that only grazes a plane leaves it lit.

use bevy::math::{DAffine3, DMat3, DVec3, URect, UVec2, Vec3Swizzles};

/// Components of a ray's direction below this, where the largest horizontal one is 1, count as none.
/// As `STILL` in `light_rays.wgsl`.
pub const STILL: f64 = 1e-15;

/// Where a light is. units: grid
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightSource {
    /// Infinitely far away: the direction to it, of any length.
    Directional(DVec3),
    /// A point or spot light's position: x and z in cells from sample (0, 0), y in height units as stored.
    Point(DVec3),
}

/// A light as one height field sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridLight {
    /// Where it is.
    pub source: LightSource,
    /// Half its size: of a directional light the tangent of its angular radius, of others their radius in
    /// metres. 0 = a hard shadow.
    pub radius: f64,
    /// Nothing farther away is lit; infinite for directional lights. units: m
    pub range: f64,
    /// Metres in the world from grid units, the linear part.
    pub world_from_grid: DMat3,
}

/// The way from a sample to a light, at a unit speed along the axis, x or z, on which it goes faster.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightRay {
    /// units: grid per unit of t; the larger of |x| and |z| is 1
    pub direction: DVec3,
    /// When it reaches the light; infinite for directional lights.
    pub t_end: f64,
}

/// The light's disc as seen from a sample: the grid direction to the point (α, β) of it, α² + β² ≤ 1, is
/// `centre + α right + β up`, where `up` is as near to the ground's own up as a tangent of the line of sight
/// can be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// To the disc's middle. units: grid
    pub centre: DVec3,
    /// To its right edge, from the middle. units: grid
    pub right: DVec3,
    /// To its upper edge, from the middle. units: grid
    pub up: DVec3,
}

impl GridLight {
    /// A directional light. `to_light` is in the world and of any length, `angular_radius` in radians.
    pub fn directional(to_light: DVec3, angular_radius: f64, world_from_grid: DAffine3) -> Self {
        let grid_from_world = world_from_grid.matrix3.inverse();
        Self {
            source: LightSource::Directional(grid_from_world * to_light),
            radius: angular_radius.tan(),
            range: f64::INFINITY,
            world_from_grid: world_from_grid.matrix3,
        }
    }

    /// A point or spot light; all in metres, in the world.
    pub fn point(position: DVec3, radius: f64, range: f64, world_from_grid: DAffine3) -> Self {
        Self {
            source: LightSource::Point(world_from_grid.inverse().transform_point3(position)),
            radius,
            range,
            world_from_grid: world_from_grid.matrix3,
        }
    }

    /// Whether every number is finite and the terrain isn't flattened.
    pub fn is_usable(&self) -> bool {
        let (LightSource::Directional(at) | LightSource::Point(at)) = self.source;
        let determinant = self.world_from_grid.determinant();
        at.is_finite()
            && self.radius.is_finite()
            && determinant.is_finite()
            && determinant != 0.0
            && (self.range > 0.0)
            && !matches!(self.source, LightSource::Directional(DVec3::ZERO))
    }

    /// Direction to the light from a sample's place (column, height, row), of any length. units: grid
    pub fn to_light(&self, from: DVec3) -> DVec3 {
        match self.source {
            LightSource::Directional(direction) => direction,
            LightSource::Point(position) => position - from,
        }
    }

    /// The ray from a sample's place to the light; `None` if it goes straight up or down, which is lit if the
    /// light is not below.
    pub fn ray(&self, from: DVec3) -> Option<LightRay> {
        let way = self.to_light(from);
        let speed = way.x.abs().max(way.z.abs());
        if speed == 0.0 || speed < STILL * way.y.abs() {
            return None;
        }
        let mut direction = way / speed;
        for axis in [0, 2] {
            if direction[axis].abs() < STILL {
                direction[axis] = 0.0;
            }
        }
        let t_end = match self.source {
            LightSource::Directional(_) => f64::INFINITY,
            LightSource::Point(_) => speed,
        };
        Some(LightRay { direction, t_end })
    }

    /// Whether a sweep can go away from it: it is directional, and not straight above or below.
    pub fn can_sweep(&self) -> bool {
        matches!(self.source, LightSource::Directional(_)) && self.ray(DVec3::ZERO).is_some()
    }

    /// The light's disc as seen from a sample's place.
    pub fn disc(&self, from: DVec3) -> Disc {
        let centre = self.to_light(from);
        let world = self.world_from_grid * centre;
        let distance = world.length();
        let radius = match self.source {
            LightSource::Directional(_) => distance * self.radius,
            LightSource::Point(_) => self.radius,
        };
        let to_light = world / distance.max(f64::MIN_POSITIVE);
        let ground_up = self.world_from_grid.y_axis;
        let right = to_light.cross(ground_up);
        // Straight above any direction will do.
        let right = if right.length() > 1e-9 * ground_up.length() {
            right.normalize()
        } else {
            to_light.any_orthonormal_vector()
        };
        let up = right.cross(to_light);
        let grid_from_world = self.world_from_grid.inverse();
        Disc {
            centre,
            right: grid_from_world * (radius * right),
            up: grid_from_world * (radius * up),
        }
    }

    /// The samples that can be lit, rounded outward; `None` if there are none. `size` is in samples.
    pub fn reached(&self, size: UVec2) -> Option<URect> {
        let whole = URect::from_corners(UVec2::ZERO, size);
        let LightSource::Point(position) = self.source else {
            return Some(whole);
        };
        if self.range.is_infinite() {
            return Some(whole);
        }
        let grid_from_world = self.world_from_grid.inverse();
        let reach = DVec3::new(
            grid_from_world.row(0).length(),
            0.0,
            grid_from_world.row(2).length(),
        ) * self.range;
        let last = size.as_dvec2() - 1.0;
        let low = (position - reach).xz().ceil().max(bevy::math::DVec2::ZERO);
        let high = (position + reach).xz().floor().min(last);
        (low.x <= high.x && low.y <= high.y)
            .then(|| URect::from_corners(low.as_uvec2(), high.as_uvec2() + 1))
    }
}

/// Share of a unit disc's strip α₀ ≤ α ≤ α₁ that lies above β = `level`.
///
/// The strip's area above a level is ∫ clamp(c − level, 0, 2c) dα with c = √(1 − α²), whose antiderivative
/// for a level ≥ 0 is ½ (α c + asin α) − level α over the α with c > level; below the middle it is the strip's
/// area less the mirrored one.
pub fn strip_above(level: f64, strip: (f64, f64)) -> f64 {
    let area = |level: f64| {
        let level = level.min(1.0);
        let half = (1.0 - level * level).sqrt();
        let primitive = |alpha: f64| {
            0.5 * (alpha * (1.0 - alpha * alpha).max(0.0).sqrt() + alpha.asin()) - level * alpha
        };
        let (a, b) = (strip.0.clamp(-half, half), strip.1.clamp(-half, half));
        primitive(b) - primitive(a)
    };
    let whole = 2.0 * area(0.0);
    let above = if level >= 0.0 {
        area(level)
    } else {
        whole - area(-level)
    };
    (above / whole).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_moves_at_unit_speed_along_its_faster_axis() {
        let light = GridLight::directional(DVec3::new(-2.0, 3.0, 1.0), 0.0, DAffine3::IDENTITY);
        let ray = light.ray(DVec3::ZERO).unwrap();
        assert_eq!(ray.direction, DVec3::new(-1.0, 1.5, 0.5));
        assert_eq!(ray.t_end, f64::INFINITY);
        let above = GridLight::directional(DVec3::Y, 0.0, DAffine3::IDENTITY);
        assert_eq!(above.ray(DVec3::ZERO), None);
    }

    #[test]
    fn grid_directions_follow_the_terrains_scale() {
        let grid = DAffine3::from_scale(DVec3::new(20.0, 0.0625, 20.0));
        let light = GridLight::directional(DVec3::new(1.0, 1.0, 0.0), 0.0, grid);
        let ray = light.ray(DVec3::ZERO).unwrap();
        // One cell is 20 m, and 20 m up are 320 height units.
        assert!((ray.direction - DVec3::new(1.0, 320.0, 0.0)).length() < 1e-9);
    }

    #[test]
    fn a_disc_is_round_in_the_world() {
        let grid = DAffine3::from_scale(DVec3::new(20.0, 0.0625, 20.0));
        let light = GridLight::directional(DVec3::new(1.0, 0.5, 0.3), 0.01, grid);
        let disc = light.disc(DVec3::ZERO);
        let [centre, right, up] =
            [disc.centre, disc.right, disc.up].map(|v| light.world_from_grid * v);
        assert!((right.length() - up.length()).abs() < 1e-12);
        assert!((right.length() / centre.length() - 0.01f64.tan()).abs() < 1e-12);
        assert!(right.dot(up).abs() < 1e-12 && right.dot(centre).abs() < 1e-12);
        assert!(right.y.abs() < 1e-12 && up.y > 0.0);
    }

    #[test]
    fn only_samples_in_range_are_reached() {
        let grid = DAffine3::from_scale(DVec3::new(10.0, 1.0, 10.0));
        let size = UVec2::new(100, 80);
        let light = GridLight::point(DVec3::new(200.0, 5.0, 100.0), 0.0, 35.0, grid);
        assert_eq!(light.reached(size), Some(URect::new(17, 7, 24, 14)));
        let far = GridLight::point(DVec3::new(-200.0, 5.0, 100.0), 0.0, 35.0, grid);
        assert_eq!(far.reached(size), None);
        let sun = GridLight::directional(DVec3::Y, 0.0, grid);
        assert_eq!(sun.reached(size), Some(URect::new(0, 0, 100, 80)));
    }

    #[test]
    fn strips_of_a_disc_add_up() {
        assert!((strip_above(0.0, (-1.0, 1.0)) - 0.5).abs() < 1e-12);
        assert_eq!(strip_above(1.5, (-1.0, 1.0)), 0.0);
        assert_eq!(strip_above(-1.5, (-1.0, 1.0)), 1.0);
        // A quarter chord: (2π/3 − √3/2) / 2π of the disc lies above half its radius... twice that of π.
        let cap = (core::f64::consts::FRAC_PI_3 - 0.75f64.sqrt() / 2.0) / core::f64::consts::PI;
        assert!((strip_above(0.5, (-1.0, 1.0)) - cap).abs() < 1e-12);
        let level = 0.3;
        let weigh = |strip: (f64, f64)| {
            let steps = 100_000;
            let width = (strip.1 - strip.0) / f64::from(steps);
            let (mut above, mut all) = (0.0, 0.0);
            for n in 0..steps {
                let alpha = strip.0 + (f64::from(n) + 0.5) * width;
                let c = (1.0 - alpha * alpha).sqrt();
                above += (c - level).clamp(0.0, 2.0 * c);
                all += 2.0 * c;
            }
            above / all
        };
        for strip in [(-1.0, -0.5), (-0.5, 0.0), (0.2, 1.0)] {
            assert!(
                (strip_above(level, strip) - weigh(strip)).abs() < 1e-6,
                "{strip:?}"
            );
        }
    }
}
