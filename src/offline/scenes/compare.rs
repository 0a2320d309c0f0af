//! Two pictures of each frame of a scripted path, side by side.

use core::ops::Range;

use super::{CameraPath, stage::SceneStage};
use crate::offline::OfflineError;

/// Pixels that differ in any channel; all of the larger one where sizes differ.
pub fn differing_px(a: &image::RgbaImage, b: &image::RgbaImage) -> u64 {
    if a.dimensions() != b.dimensions() {
        return (a.len().max(b.len()) / 4) as u64;
    }
    a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count() as u64
}

/// Runs two apps in lock-step along a path: how many pixels differ in each frame.
///
/// Both show the same scene at one size, and each culls in its own way. Nothing is warmed up: the first frame
/// counts like every other, but pipelines must have been made.
///
/// # Errors
/// [`OfflineError::ReadBack`].
pub fn compare_frames(
    a: &mut SceneStage,
    b: &mut SceneStage,
    path: CameraPath,
    frames: Range<u32>,
) -> Result<Vec<u64>, OfflineError> {
    frames
        .map(|frame| {
            for stage in [&mut *a, &mut *b] {
                stage.set_frame(path, frame);
                stage.offline.step();
            }
            Ok(differing_px(&a.picture()?, &b.picture()?))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_changed_channel_of_one_pixel_is_found() {
        let a = image::RgbaImage::from_pixel(5, 4, image::Rgba([1, 2, 3, 255]));
        let mut b = a.clone();
        assert_eq!(differing_px(&a, &b), 0);
        b.get_pixel_mut(3, 2).0[1] += 1;
        assert_eq!(differing_px(&a, &b), 1);
        assert_eq!(differing_px(&a, &image::RgbaImage::new(5, 5)), 25);
    }
}
