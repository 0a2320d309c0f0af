//! Scripted cameras: where a camera is in a frame follows from the frame's number alone.

use core::f32::consts::TAU;

use bevy::prelude::*;

use super::Scene;
use crate::offline::accuracy::scene::lattice;

/// Frames a teleporting camera stays where it is.
const STAY: u32 = 4;

/// How a camera moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraPath {
    /// Along the scene's way, and back, looking a little to either side.
    Walk,
    /// Fast and low, round the middle of the scene, banking and climbing.
    Flight,
    /// On the spot, a full turn a second.
    Spin,
    /// To a place and a direction that have nothing to do with the last ones, every fourth frame.
    Teleport,
}

/// All paths, and their names as values of flags.
pub const PATHS: [(CameraPath, &str); 4] = [
    (CameraPath::Walk, "walk"),
    (CameraPath::Flight, "flight"),
    (CameraPath::Spin, "spin"),
    (CameraPath::Teleport, "teleport"),
];

impl CameraPath {
    /// Its name as a flag's value.
    pub fn name(self) -> &'static str {
        PATHS
            .iter()
            .find(|(path, _)| *path == self)
            .map_or("unknown", |(_, name)| name)
    }

    /// The camera in a frame.
    pub fn at(self, scene: &Scene, frame: u32) -> Transform {
        let [from, to] = scene.walk;
        let way = to - from;
        let ahead = way.normalize_or(Vec3::NEG_Z);
        match self {
            Self::Walk => {
                let period = (2.0 * way.length() / scene.stride_m).ceil().max(2.0) as u32;
                let eye = from.lerp(to, there_and_back(frame, period));
                let glance = 0.35 * (frame as f32 * 0.021).sin();
                Transform::from_translation(eye)
                    .looking_to(Quat::from_rotation_y(glance) * ahead, Vec3::Y)
            }
            Self::Flight => {
                let [low, high] = scene.bounds;
                let (centre, half) = (0.5 * (low + high), 0.5 * (high - low));
                // A lap in four seconds; fast, whatever the scene's size.
                let place = |frame: f32| {
                    let turn = TAU * frame / 240.0;
                    let height = 0.05 + 0.55 * (0.5 + 0.5 * (2.3 * turn).sin());
                    Vec3::new(
                        centre.x + 0.7 * half.x * turn.cos(),
                        low.y + height * (high.y - low.y),
                        centre.z + 0.7 * half.z * (1.7 * turn).sin(),
                    )
                };
                let frame = frame as f32;
                let eye = place(frame);
                let along = (place(frame + 8.0) - eye).normalize_or(ahead);
                let inward = (centre.with_y(low.y) - eye).normalize_or(ahead);
                let ahead = (along + inward).normalize_or(ahead);
                let bank = Quat::from_rotation_z(0.4 * (frame * 0.03).sin());
                let mut camera = Transform::from_translation(eye).looking_to(ahead, Vec3::Y);
                camera.rotation *= bank;
                camera
            }
            Self::Spin => {
                let turn = Quat::from_rotation_y(TAU * frame as f32 / 60.0);
                Transform::from_translation(from.lerp(to, 0.5)).looking_to(turn * ahead, Vec3::Y)
            }
            Self::Teleport => {
                let draw = |salt: u32| 0.5 + 0.5 * lattice((frame / STAY) as i32, 7, salt);
                let [low, high] = scene.bounds;
                let in_the_air = low
                    + (high - low) * Vec3::new(0.1 + 0.8 * draw(1), draw(2), 0.1 + 0.8 * draw(3));
                let eye = if draw(4) < 0.5 {
                    from.lerp(to, draw(5))
                } else {
                    in_the_air
                };
                let turn =
                    Quat::from_euler(EulerRot::YXZ, TAU * draw(6), 0.9 * (draw(7) - 0.6), 0.0);
                Transform::from_translation(eye).with_rotation(turn)
            }
        }
    }
}

/// From 0 to 1 and back in `period` frames.
pub(super) fn there_and_back(frame: u32, period: u32) -> f32 {
    let period = period.max(1);
    let part = (frame % period) as f32 / period as f32;
    1.0 - (2.0 * part - 1.0).abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_shuttles_starts_at_one_end_and_reaches_the_other() {
        assert_eq!(there_and_back(0, 100), 0.0);
        assert_eq!(there_and_back(50, 100), 1.0);
        assert_eq!(there_and_back(100, 100), 0.0);
        assert_eq!(there_and_back(25, 100), there_and_back(75, 100));
    }
}
