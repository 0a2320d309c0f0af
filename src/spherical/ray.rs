//! Where a ray meets a mesh, by the index map.

use bevy::math::DVec3;

use super::maps::SphericalMaps;

/// A half-line. The direction may have any length but 0. space: mesh
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it begins.
    pub origin: DVec3,
    /// Where to.
    pub direction: DVec3,
}

impl SphericalMaps {
    /// The nearest triangle on a ray, by the index map: its number in the mesh, and how far along the ray, in
    /// lengths of its direction.
    ///
    /// # Limits
    /// A triangle may be missed if the ray passes only through corners of the bins that it covers.
    pub fn first_hit(
        &self,
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        ray: &Ray,
    ) -> Option<(u32, f64)> {
        let speed = ray.direction.length();
        let way = ray.direction / speed;
        let start = ray.origin - self.centre;
        // The ray is nearest to the centre at `nearest`; its direction from the centre turns by an angle there, whose
        // tangent is the way from there over the distance.
        let nearest = -start.dot(way);
        let aside = (start + way * nearest).length();
        let half = ((self.radius - aside) * (self.radius + aside)).sqrt();
        // No number if the ray passes by.
        if half.is_nan() || nearest + half < 0.0 {
            return None;
        }
        let aside = aside.max(1e-9 * self.radius).max(f64::MIN_POSITIVE);
        let bins = self.index.bins;
        let longest = bins.theta_step().min(bins.phi_step()) / 2.0;
        let first = ((0.0_f64).max(nearest - half) - nearest).atan2(aside);
        let last = half.atan2(aside);
        let (mut found, mut last_bin) = (None::<(u32, f64)>, usize::MAX);
        let (mut angle, mut is_last) = (first, false);
        while !is_last {
            is_last = angle >= last;
            let along = nearest + aside * angle.min(last).tan();
            if found.is_some_and(|(_, distance)| distance < along - self.radius * longest) {
                break;
            }
            let place = start + way * along;
            // Towards the poles bins are narrower.
            let width = place.x.hypot(place.z) / place.length().max(f64::MIN_POSITIVE);
            angle += longest * width.clamp(1.0 / 64.0, 1.0);
            let bin = bins.of(place);
            if bin == last_bin {
                continue;
            }
            last_bin = bin;
            for &triangle in self.index.triangles(bin) {
                let Some(corners) = self.corners(positions, triangles, triangle) else {
                    continue;
                };
                if let Some(distance) = hit(corners, start, way)
                    && found.is_none_or(|(_, nearest)| distance < nearest)
                {
                    found = Some((triangle, distance));
                }
            }
        }
        found.map(|(triangle, distance)| (triangle, distance / speed))
    }

    /// A triangle's corners, from the centre.
    fn corners(
        &self,
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        triangle: u32,
    ) -> Option<[DVec3; 3]> {
        let mut corners = [DVec3::ZERO; 3];
        for (corner, &vertex) in corners.iter_mut().zip(triangles.get(triangle as usize)?) {
            let position = positions.get(vertex as usize)?;
            *corner = DVec3::from_array(position.map(f64::from)) - self.centre;
        }
        Some(corners)
    }
}

/// How far along a triangle is met, from either side (Möller and Trumbore 1997).
fn hit([a, b, c]: [DVec3; 3], origin: DVec3, way: DVec3) -> Option<f64> {
    let (ab, ac, from) = (b - a, c - a, origin - a);
    let p = way.cross(ac);
    let whole = ab.dot(p);
    if whole == 0.0 {
        return None;
    }
    let q = from.cross(ab);
    let (u, v, along) = (from.dot(p) / whole, way.dot(q) / whole, ac.dot(q) / whole);
    // A little beyond the edges, so that nothing slips through between two triangles.
    let edge = -1e-9;
    (u >= edge && v >= edge && u + v <= 1.0 - edge && along >= 0.0).then_some(along)
}
