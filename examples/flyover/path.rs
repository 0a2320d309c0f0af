//! The scripted flight: from the sea past the rocks, over the harbour, down an avenue, up into the mountains, and a look
//! back at the evening.

use bevy::prelude::*;
use bevy_skyline::terrain::HeightField;

use super::{site::Site, sky::Sun};

/// Duration of the flight in a window. units: s
pub const FLIGHT_S: f32 = 75.0;
/// The camera stays so far above ground and water. units: m
const CLEARANCE_M: f32 = 14.0;

/// Where the camera is, and where it looks: across from the city's middle, seaward of it, and above the ground;
/// the camera counts from the shore while it is over the sea. units: m
struct Waypoint {
    eye: [f32; 3],
    eye_from_shore: bool,
    target: [f32; 3],
}

const fn at_sea(eye: [f32; 3], target: [f32; 3]) -> Waypoint {
    Waypoint {
        eye,
        eye_from_shore: true,
        target,
    }
}

const fn on_land(eye: [f32; 3], target: [f32; 3]) -> Waypoint {
    Waypoint {
        eye,
        eye_from_shore: false,
        target,
    }
}

/// An avenue runs along 88 m across.
const WAY: [Waypoint; 11] = [
    at_sea([-760.0, 1_330.0, 62.0], [0.0, 0.0, 190.0]),
    at_sea([-380.0, 1_130.0, 46.0], [-10.0, 0.0, 170.0]),
    at_sea([-120.0, 720.0, 44.0], [0.0, 0.0, 160.0]),
    at_sea([10.0, 300.0, 66.0], [40.0, -100.0, 140.0]),
    at_sea([88.0, -180.0, 74.0], [70.0, -700.0, 90.0]),
    on_land([88.0, 120.0, 46.0], [88.0, -1_200.0, 60.0]),
    on_land([88.0, -420.0, 40.0], [88.0, -1_900.0, 70.0]),
    on_land([88.0, -1_020.0, 90.0], [160.0, -2_300.0, 160.0]),
    on_land([330.0, -1_650.0, 230.0], [1_250.0, -1_950.0, 60.0]),
    on_land([800.0, -1_950.0, 330.0], [900.0, -900.0, 20.0]),
    on_land([430.0, -1_900.0, 400.0], [330.0, 500.0, 0.0]),
];

/// The camera at a share of the flight, 0 to 1.
pub fn camera(share: f32, field: &HeightField, site: &Site) -> Transform {
    let point = |[across, seaward, above]: [f32; 3], from_m: f32| {
        let at = site.at(across, from_m + seaward);
        Vec3::new(at.x, ground(field, at) + above, at.y)
    };
    let from_m = |w: &Waypoint| if w.eye_from_shore { site.shore_m } else { 0.0 };
    let eyes: Vec<Vec3> = WAY.iter().map(|w| point(w.eye, from_m(w))).collect();
    let targets: Vec<Vec3> = WAY.iter().map(|w| point(w.target, 0.0)).collect();
    let mut eye = along(&eyes, share);
    let target = along(&targets, share);
    eye.y = eye.y.max(ground(field, eye.xz()) + CLEARANCE_M);
    Transform::from_translation(eye).looking_at(target, Vec3::Y)
}

/// The sun at a share of the flight: from an afternoon behind the camera's shoulder to an evening over the sea.
pub fn sun(share: f32, site: &Site) -> Sun {
    let turn = (40.0 + 36.0 * share).to_radians();
    let toward = site.across() * turn.cos() + site.seaward * turn.sin();
    Sun {
        azimuth: toward.to_angle(),
        elevation: (27.0 - 30.5 * share).to_radians(),
    }
}

fn ground(field: &HeightField, at: Vec2) -> f32 {
    field.height_at(at).unwrap_or(0.0).max(0.0)
}

/// A smooth way through points (Catmull and Rom 1974).
fn along(points: &[Vec3], share: f32) -> Vec3 {
    let last = points.len() - 1;
    let m = share.clamp(0.0, 1.0) * last as f32;
    let i = (m as usize).min(last - 1);
    let t = m - i as f32;
    let [a, b, c, d] = [
        points[i.saturating_sub(1)],
        points[i],
        points[i + 1],
        points[(i + 2).min(last)],
    ];
    0.5 * (2.0 * b
        + (c - a) * t
        + (2.0 * a - 5.0 * b + 4.0 * c - d) * t * t
        + (3.0 * b - a - 3.0 * c + d) * t * t * t)
}
