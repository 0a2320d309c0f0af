//! `f64` twin of the [spherical index](crate::spherical): each triangle on its own, by other ways; and what a
//! rasteriser makes of it in `f32`.

use core::f64::consts::{PI, TAU};

use bevy::math::{DVec3, DVec4, Mat4, Vec3};

use crate::spherical::Bins;

/// Where the eye is with respect to a triangle's plane: six times the volume that they span, above 0 in front. The
/// eye is a place with `w` 1, or a direction towards it with `w` 0.
///
/// Off by some 2⁻⁴⁹ of the product of the three distances.
pub fn side([a, b, c]: [DVec3; 3], eye: DVec4) -> f64 {
    (b - a).cross(c - a).dot(eye.truncate() - a * eye.w)
}

/// Whether all of a triangle is outside a half-space.
pub fn is_outside(corners: [DVec3; 3], half_space: DVec4) -> bool {
    corners
        .iter()
        .all(|corner| corner.extend(1.0).dot(half_space) < 0.0)
}

/// The bins that points of a triangle's inside are in, seen from the origin; `samples` to a side, each bin once.
pub fn sampled_bins([a, b, c]: [DVec3; 3], bins: Bins, samples: u32) -> Vec<usize> {
    let mut found = Vec::new();
    for i in 0..samples {
        for j in 0..samples - i {
            let at = |k: u32| (f64::from(k) + 1.0 / 3.0) / f64::from(samples);
            let (u, v) = (at(i), at(j));
            let point = a * (1.0 - u - v) + b * u + c * v;
            let length = point.length();
            if length > 0.0 {
                found.push(bin(point / length, bins));
            }
        }
    }
    found.sort_unstable();
    found.dedup();
    found
}

/// The bin of a direction of length 1, by arc cosines.
fn bin(direction: DVec3, bins: Bins) -> usize {
    let theta = direction.y.clamp(-1.0, 1.0).acos();
    let across = direction.x.hypot(direction.z);
    let phi = if across > 0.0 {
        let from_x = (direction.x / across).clamp(-1.0, 1.0).acos();
        if direction.z < 0.0 {
            TAU - from_x
        } else {
            from_x
        }
    } else {
        0.0
    };
    let at = |angle: f64, whole: f64, count: u16| {
        ((angle / whole * f64::from(count)) as usize).min(usize::from(count) - 1)
    };
    at(theta, PI, bins.theta) * usize::from(bins.phi) + at(phi, TAU, bins.phi)
}

/// The nearest triangle on a half-line, of all: its number, and how far, in lengths of the direction. By volumes.
pub fn first_hit(
    triangles: &[[DVec3; 3]],
    origin: DVec3,
    direction: DVec3,
) -> Option<(usize, f64)> {
    let mut nearest: Option<(usize, f64)> = None;
    for (number, &[a, b, c]) in triangles.iter().enumerate() {
        let volume = |p: DVec3, q: DVec3| direction.dot((p - origin).cross(q - origin));
        let sides = [volume(a, b), volume(b, c), volume(c, a)];
        let is_met = sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0);
        let normal = (b - a).cross(c - a);
        let speed = normal.dot(direction);
        let along = normal.dot(a - origin) / speed;
        if is_met && speed != 0.0 && along >= 0.0 && nearest.is_none_or(|(_, least)| along < least)
        {
            nearest = Some((number, along));
        }
    }
    nearest
}

/// The signed area, in pixels squared, that a rasteriser makes of a triangle: corners through both matrices in `f32`,
/// divided, put on the grid of parts of a pixel. Above 0 from the front. `None` if the near plane cuts it or it is
/// behind.
pub fn rasterised_area(
    corners: [Vec3; 3],
    world_from_local: Mat4,
    clip_from_world: Mat4,
    size: [f32; 2],
    sub_pixel_bits: u32,
) -> Option<f64> {
    let steps = sub_pixel_bits as f32;
    let steps = steps.exp2();
    let mut places = [[0_i64; 2]; 3];
    for (place, corner) in places.iter_mut().zip(corners) {
        let clip = clip_from_world * (world_from_local * corner.extend(1.0));
        if !(clip.w > 0.0 && clip.z <= clip.w) {
            return None;
        }
        let at = |coordinate: f32, size: f32| {
            let pixel = (coordinate / clip.w) * (size * 0.5) + size * 0.5;
            (f64::from(pixel) * f64::from(steps)).round() as i64
        };
        *place = [at(clip.x, size[0]), at(clip.y, size[1])];
    }
    let [a, b, c] = places;
    let wide = |p: i64, q: i64| i128::from(p - q);
    let area = wide(b[0], a[0]) * wide(c[1], a[1]) - wide(b[1], a[1]) * wide(c[0], a[0]);
    Some(area as f64 / f64::from(steps * steps) / 2.0)
}
