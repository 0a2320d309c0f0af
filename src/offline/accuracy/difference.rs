//! How far one picture is from the exact one.

use bevy::math::{UVec2, Vec2};
use serde::Serialize;

use super::percentile;
use crate::{offline::HitImage, reference::ray_cast::Twin, terrain::view_rays::ViewRays};

/// Errors of a picture of terrain.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct TerrainError {
    /// Pixels that show terrain where the exact picture shows sky, or the other way round.
    pub coverage_errors_px: usize,
    /// How far the farthest of them is from a pixel of the exact picture that shows what it shows. units: px
    pub silhouette_px_max: f64,
    /// Distance of hits from the exact surface, straight up or down, on the screen: below this are 99.9 % of
    /// them. units: px
    pub depth_error_px_p999: f64,
    /// The largest. units: px
    pub depth_error_px_max: f64,
    /// Mean of the FLIP error of the shaded picture (Andersson et al. 2020): 0 same … 1.
    pub flip_mean: f64,
}

impl TerrainError {
    /// Of hits against the exact picture and the surface itself.
    pub fn of(
        hits: &HitImage,
        picture: &image::RgbImage,
        exact: (&HitImage, &image::RgbImage),
        twin: &Twin,
        rays: &ViewRays,
    ) -> Self {
        let exact_coverage: Vec<bool> = exact.0.coverage().collect();
        let mut error = Self::default();
        let mut displacements = Vec::new();
        for (index, covered) in hits.coverage().enumerate() {
            let at = UVec2::new(index as u32 % hits.size.x, index as u32 / hits.size.x);
            if covered != exact_coverage[index] {
                error.coverage_errors_px += 1;
                let distance = distance_to(covered, at, &exact_coverage, hits.size);
                error.silhouette_px_max = error.silhouette_px_max.max(distance);
            }
            if covered {
                let t = rays.view_depth(hits.ndc_depth[index]) - f64::from(rays.t_base);
                displacements.push(twin.displacement_px(rays, at.as_vec2() + Vec2::splat(0.5), t));
            }
        }
        displacements.sort_by(f64::total_cmp);
        error.depth_error_px_p999 = percentile(&displacements, 0.999);
        error.depth_error_px_max = percentile(&displacements, 1.0);
        error.flip_mean = flip_mean(exact.1, picture);
        error
    }
}

/// Distance from `at` to the nearest pixel of that coverage; the image's diagonal if there is none. units: px
fn distance_to(covered: bool, at: UVec2, coverage: &[bool], size: UVec2) -> f64 {
    let at = at.as_ivec2();
    let limit = size.as_ivec2();
    let mut nearest = size.as_dvec2().length();
    for radius in 1..=limit.max_element() {
        if f64::from(radius) >= nearest {
            break;
        }
        for along in -radius..=radius {
            for (dx, dy) in [
                (along, -radius),
                (along, radius),
                (-radius, along),
                (radius, along),
            ] {
                let (x, y) = (at.x + dx, at.y + dy);
                let inside = x >= 0 && y >= 0 && x < limit.x && y < limit.y;
                if inside && coverage[(y * limit.x + x) as usize] == covered {
                    nearest = nearest.min(f64::from(dx).hypot(f64::from(dy)));
                }
            }
        }
    }
    nearest
}

/// Mean FLIP error of two pictures of one size, as seen at 67 pixels a degree.
pub(super) fn flip_mean(reference: &image::RgbImage, test: &image::RgbImage) -> f64 {
    if reference == test {
        return 0.0;
    }
    let flip_image = |picture: &image::RgbImage| {
        nv_flip::FlipImageRgb8::with_data(picture.width(), picture.height(), picture.as_raw())
    };
    let map = nv_flip::flip(
        flip_image(reference),
        flip_image(test),
        nv_flip::DEFAULT_PIXELS_PER_DEGREE,
    );
    f64::from(nv_flip::FlipPool::from_image(&map).mean())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_to_a_silhouette_is_euclidean_and_finds_the_nearest() {
        let size = UVec2::new(9, 9);
        let mut coverage = vec![false; 81];
        coverage[4 * 9 + 1] = true;
        coverage[7 * 9 + 6] = true;
        let from = UVec2::new(4, 4);
        assert_eq!(distance_to(true, from, &coverage, size), 3.0);
        coverage[4 * 9 + 1] = false;
        assert_eq!(distance_to(true, from, &coverage, size), 13f64.sqrt());
        assert_eq!(distance_to(true, from, &[false; 81], size), 162f64.sqrt());
    }

    #[test]
    fn flip_sees_a_difference_and_only_a_difference() {
        let black = image::RgbImage::new(16, 16);
        let white = image::RgbImage::from_pixel(16, 16, image::Rgb([255; 3]));
        assert_eq!(flip_mean(&black, &black), 0.0);
        assert!(flip_mean(&black, &white) > 0.5);
    }
}
