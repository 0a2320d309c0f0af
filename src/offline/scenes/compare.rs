//! Two pictures of one frame, side by side, and of each frame of a scripted path.

use core::{iter::Sum, ops::Range};

use image::{ImageFormat, RgbaImage};

use super::{
    CameraPath,
    stage::{DepthImage, SceneStage},
};
use crate::offline::OfflineError;

/// What one frame drew.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The picture.
    pub colour: RgbaImage,
    /// Reverse-Z depth of every pixel, 0 = far: the four bytes of its `f32` as a pixel.
    pub depth: RgbaImage,
}

impl Frame {
    /// A picture and its depth.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`] where they are not of one size.
    pub fn new(colour: RgbaImage, depth: &DepthImage) -> Result<Self, OfflineError> {
        let bytes = bytemuck::cast_slice(&depth.ndc_depth).to_vec();
        let depth = RgbaImage::from_raw(depth.size.x, depth.size.y, bytes)
            .filter(|depth| depth.dimensions() == colour.dimensions())
            .ok_or_else(|| {
                OfflineError::ReadBack("a picture and its depth differ in size".into())
            })?;
        Ok(Self { colour, depth })
    }

    /// Of how many pixels another frame shows something else.
    pub fn difference(&self, other: &Self) -> Difference {
        if self.colour.dimensions() != other.colour.dimensions() {
            return Difference {
                lost_px: (self.colour.len().max(other.colour.len()) / 4) as u64,
                tied_px: 0,
            };
        }
        let colours = self.colour.pixels().zip(other.colour.pixels());
        let depths = self.depth.pixels().zip(other.depth.pixels());
        let mut difference = Difference::default();
        for ((a, b), (near_a, near_b)) in colours.zip(depths) {
            if a == b {
                continue;
            }
            // What is not drawn on at all has no surfaces to tie.
            if near_a == near_b && *near_a != FAR {
                difference.tied_px += 1;
            } else {
                difference.lost_px += 1;
            }
        }
        difference
    }

    /// The same in less memory.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn packed(&self) -> Result<PackedFrame, OfflineError> {
        Ok(PackedFrame {
            colour: packed(&self.colour)?,
            depth: packed(&self.depth)?,
        })
    }
}

/// Nothing was drawn there.
const FAR: image::Rgba<u8> = image::Rgba([0; 4]);

/// A [`Frame`] to keep.
pub struct PackedFrame {
    colour: Vec<u8>,
    depth: Vec<u8>,
}

impl PackedFrame {
    /// The frame.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn unpacked(&self) -> Result<Frame, OfflineError> {
        Ok(Frame {
            colour: unpacked(&self.colour)?,
            depth: unpacked(&self.depth)?,
        })
    }
}

fn packed(picture: &RgbaImage) -> Result<Vec<u8>, OfflineError> {
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    let mut bytes = Vec::new();
    let encoder =
        PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive);
    picture
        .write_with_encoder(encoder)
        .map_err(|error| OfflineError::ReadBack(error.to_string()))?;
    Ok(bytes)
}

fn unpacked(bytes: &[u8]) -> Result<RgbaImage, OfflineError> {
    image::load_from_memory_with_format(bytes, ImageFormat::Png)
        .map(image::DynamicImage::into_rgba8)
        .map_err(|error| OfflineError::ReadBack(error.to_string()))
}

/// Pixels whose colour differs between two frames, in any channel, of opaque scenes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Difference {
    /// With another depth: another surface shows.
    pub lost_px: u64,
    /// With the same depth to the last bit: surfaces lie in one plane, and which of them shows is decided by the order
    /// of draws, which neither Bevy nor anyone else promises.
    pub tied_px: u64,
}

impl Sum for Difference {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |a, b| Self {
            lost_px: a.lost_px + b.lost_px,
            tied_px: a.tied_px + b.tied_px,
        })
    }
}

/// Pixels that differ in any channel; all of the larger one where sizes differ.
pub fn differing_px(a: &RgbaImage, b: &RgbaImage) -> u64 {
    if a.dimensions() != b.dimensions() {
        return (a.len().max(b.len()) / 4) as u64;
    }
    a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count() as u64
}

/// Runs two apps in lock-step along a path: what differs in each frame.
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
) -> Result<Vec<Difference>, OfflineError> {
    frames
        .map(|frame| {
            for stage in [&mut *a, &mut *b] {
                stage.set_frame(path, frame);
                stage.offline.step();
            }
            Ok(a.frame()?.difference(&b.frame()?))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use bevy::math::UVec2;

    use super::*;

    #[test]
    fn one_changed_channel_of_one_pixel_is_found() {
        let a = RgbaImage::from_pixel(5, 4, image::Rgba([1, 2, 3, 255]));
        let mut b = a.clone();
        assert_eq!(differing_px(&a, &b), 0);
        b.get_pixel_mut(3, 2).0[1] += 1;
        assert_eq!(differing_px(&a, &b), 1);
        assert_eq!(differing_px(&a, &RgbaImage::new(5, 5)), 25);
    }

    fn frame() -> Frame {
        let colour = RgbaImage::from_fn(37, 19, |x, y| {
            image::Rgba([x as u8 * 7, y as u8 * 13, (x ^ y) as u8, 255 - x as u8])
        });
        let depth = DepthImage {
            size: UVec2::new(37, 19),
            ndc_depth: (0..37 * 19).map(|px| px as f32 / 1_000.0).collect(),
        };
        Frame::new(colour, &depth).expect("both are of one size")
    }

    #[test]
    fn another_surface_is_a_loss_and_another_colour_in_one_plane_a_tie() {
        let whole = frame();
        assert_eq!(whole.difference(&whole), Difference::default());
        let other = |x, y, depth: bool| {
            let mut other = whole.clone();
            other.colour.get_pixel_mut(x, y).0[2] ^= 1;
            if depth {
                other.depth.get_pixel_mut(x, y).0[0] ^= 1;
            }
            whole.difference(&other)
        };
        let of = |lost_px, tied_px| Difference { lost_px, tied_px };
        assert_eq!(other(36, 18, true), of(1, 0));
        assert_eq!(other(36, 18, false), of(0, 1));
        // The first pixel lies at the far end: there is nothing that could tie.
        assert_eq!(other(0, 0, false), of(1, 0));
        let far = DepthImage {
            size: UVec2::splat(5),
            ndc_depth: vec![0.0; 25],
        };
        let smaller = Frame::new(RgbaImage::new(5, 5), &far).expect("both are of one size");
        assert_eq!(whole.difference(&smaller), of(37 * 19, 0));
        assert_eq!(
            [of(1, 2), of(3, 4)].into_iter().sum::<Difference>(),
            of(4, 6)
        );
        assert!(Frame::new(RgbaImage::new(5, 4), &far).is_err());
    }

    #[test]
    fn a_kept_frame_is_the_same() {
        let whole = frame();
        let kept = whole.packed().expect("it is packed");
        assert_eq!(kept.unpacked().expect("it is unpacked"), whole);
        assert!(unpacked(&[1, 2, 3]).is_err());
    }
}
