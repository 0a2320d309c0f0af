//! Where the camera is: a function of how far along its path it is, and of nothing else.

use core::str::FromStr;

use bevy::prelude::*;

use crate::offline::scenes::Scene;

/// Field of view at both ends of a zoom, vertical. units: °
const ZOOM_FOV_DEG: [f32; 2] = [80.0, 6.0];

/// How the camera moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WorkloadPath {
    /// A full turn on the spot, over the middle of the city (P4, Fig. 6).
    Rotate,
    /// From a wide lens to a long one, at the same place.
    Zoom,
    /// Along the scene's way, at a walker's height.
    Walk,
}

/// Every path and its name as a flag's value.
pub const WORKLOAD_PATHS: [(WorkloadPath, &str); 3] = [
    (WorkloadPath::Rotate, "rotate"),
    (WorkloadPath::Zoom, "zoom"),
    (WorkloadPath::Walk, "walk"),
];

impl FromStr for WorkloadPath {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        WORKLOAD_PATHS
            .iter()
            .find(|(_, name)| *name == text)
            .map(|(path, _)| *path)
            .ok_or_else(|| "expected rotate, zoom or walk".into())
    }
}

/// Where a camera is, and how wide it sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// The camera.
    pub transform: Transform,
    /// Vertical field of view. units: rad
    pub fov: f32,
}

impl WorkloadPath {
    /// Its name as a flag's value.
    pub fn name(self) -> &'static str {
        WORKLOAD_PATHS
            .iter()
            .find(|(path, _)| *path == self)
            .map_or("unknown", |(_, name)| name)
    }

    /// What [`parameter`](Self::parameter) is, with its unit.
    pub fn parameter_name(self) -> &'static str {
        match self {
            Self::Rotate => "angle_deg",
            Self::Zoom => "zoom",
            Self::Walk => "walked_m",
        }
    }

    /// How far along the path a frame of `frames` is: from 0 up to 1. A turn's last frame is one step before its
    /// first. Frames before the first lead up to it: those of a turn turn, others stand.
    pub fn part(self, frame: i64, frames: u32) -> f64 {
        match self {
            Self::Rotate => (frame as f64 / f64::from(frames.max(1))).rem_euclid(1.0),
            Self::Zoom | Self::Walk => {
                let last = f64::from(frames.saturating_sub(1).max(1));
                (frame as f64 / last).clamp(0.0, 1.0)
            }
        }
    }

    /// The angle turned by (°), the focal length as a multiple of the shortest, or the way walked (m).
    pub fn parameter(self, scene: &Scene, part: f64) -> f64 {
        match self {
            Self::Rotate => 360.0 * part,
            Self::Zoom => {
                let focal = |fov: f32| 1.0 / f64::from((0.5 * fov).tan());
                focal(self.at(scene, part).fov) / focal(self.at(scene, 0.0).fov)
            }
            Self::Walk => part * f64::from(scene.walk[0].distance(scene.walk[1])),
        }
    }

    /// The camera at a part of the path.
    pub fn at(self, scene: &Scene, part: f64) -> Pose {
        let part = part as f32;
        let fov = scene.projection().fov;
        let over = scene.view("over");
        match self {
            Self::Rotate => {
                let turn = Quat::from_rotation_y(core::f32::consts::TAU * part);
                Pose {
                    transform: over.with_rotation(turn * over.rotation),
                    fov,
                }
            }
            Self::Zoom => {
                let [wide, long] = ZOOM_FOV_DEG.map(|fov| (0.5 * fov.to_radians()).tan());
                // By equal factors in equal times, as it looks even.
                let half = wide * (long / wide).powf(part);
                Pose {
                    transform: over,
                    fov: 2.0 * half.atan(),
                }
            }
            Self::Walk => {
                let [from, to] = scene.walk;
                let ahead = (to - from).normalize_or(Vec3::NEG_Z);
                Pose {
                    transform: Transform::from_translation(from.lerp(to, part))
                        .looking_to(ahead, Vec3::Y),
                    fov,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::offline::scenes::city::{self, CitySize};

    #[test]
    fn a_turn_comes_round_and_a_zoom_and_a_walk_go_from_end_to_end() {
        let scene = city::furnished(CitySize::Small);
        let rotate = WorkloadPath::Rotate;
        assert_eq!(rotate.part(0, 8), 0.0);
        assert_eq!(rotate.part(7, 8), 0.875);
        assert_eq!(rotate.part(-1, 8), 0.875);
        assert_eq!(rotate.parameter(&scene, 0.25), 90.0);
        let [a, b] = [0.0, 0.5].map(|part| rotate.at(&scene, part).transform);
        assert_eq!(a.translation, b.translation);
        let flat = |of: Transform| of.forward().xz().normalize();
        assert!(flat(a).dot(flat(b)) < -0.999);

        let zoom = WorkloadPath::Zoom;
        assert_eq!([zoom.part(-5, 9), zoom.part(8, 9)], [0.0, 1.0]);
        assert_eq!(zoom.parameter(&scene, 0.0), 1.0);
        let times = zoom.parameter(&scene, 1.0);
        let expected = (40f64.to_radians().tan()) / (3f64.to_radians().tan());
        assert!((times - expected).abs() < 1e-3 * expected, "{times}");

        let walk = WorkloadPath::Walk;
        assert_eq!(walk.at(&scene, 0.0).transform.translation, scene.walk[0]);
        assert_eq!(walk.at(&scene, 1.0).transform.translation, scene.walk[1]);
        assert!(walk.parameter(&scene, 1.0) > 50.0);
    }

    #[test]
    fn names_are_read_back_and_others_are_not() {
        for (path, name) in WORKLOAD_PATHS {
            assert_eq!(name.parse(), Ok(path));
            assert_eq!(path.name(), name);
        }
        assert!("Rotate".parse::<WorkloadPath>().is_err());
        assert!("".parse::<WorkloadPath>().is_err());
    }
}
