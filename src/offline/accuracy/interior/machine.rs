//! A machine made by code, with parts of which it is known that they cannot be seen: gears, bearings, bolts and springs
//! in a closed chamber, in one with a window, in one behind a grille, and on the outside of a casing.

use core::f32::consts::TAU;
use std::sync::Arc;

use super::super::lot::Lot;
use crate::interior::{Model, Part, Surface};
use bevy::math::{DAffine3, DQuat, DVec3, EulerRot, Vec2, Vec3};

/// The machine.
pub struct Machine {
    /// Its parts; each is a node.
    pub model: Model,
    /// Whether a part cannot be seen from anywhere outside.
    pub is_hidden: Vec<bool>,
}

/// Inner half sides of a chamber; the machine has three of them in a row. units: m
const CHAMBER: Vec3 = Vec3::new(0.6, 0.6, 0.6);
/// Thickness of the casing. units: m
const WALL: f32 = 0.06;
/// Bars of the grille and what is open between them. units: m
const BAR: f32 = 0.02;
const OPEN: f32 = 0.04;

/// A machine with at least so many triangles, in parts of some thousands each.
pub fn machine(triangles: usize) -> Machine {
    let mut made = Machine {
        model: Model::default(),
        is_hidden: Vec::new(),
    };
    let pitch = 2.0 * (CHAMBER.x + WALL);
    let chambers = [-pitch, 0.0, pitch];
    for (x, front) in chambers
        .into_iter()
        .zip([Front::Closed, Front::Window, Front::Grille])
    {
        for plate in plates(front) {
            made.add(&Arc::new(plate), at(x, 0.0, 0.0), false);
        }
    }
    let mut lot = Lot(6);
    let kinds = [
        gear(),
        lathe(&BEARING, 96),
        lathe(&BOLT, 64),
        spring(),
        lathe(&SHAFT, 48),
    ]
    .map(Arc::new);
    let inside = |lot: &mut Lot, size: f32, x: f32| {
        // Nothing reaches farther from its middle than its size.
        let room = CHAMBER - Vec3::splat(1.01 * size);
        let [a, b, c] = [(); 3].map(|()| lot.between(-1.0, 1.0) as f32);
        let turn = [(); 3].map(|()| lot.between(0.0, f64::from(TAU)));
        DAffine3::from_translation(DVec3::new(
            f64::from(x + a * room.x),
            f64::from(b * room.y),
            f64::from(c * room.z),
        )) * DAffine3::from_quat(DQuat::from_euler(EulerRot::XYZ, turn[0], turn[1], turn[2]))
            * DAffine3::from_scale(DVec3::splat(f64::from(size)))
    };
    let mut number = 0;
    while made.model.triangle_count() < triangles {
        let size = 0.02 * 6f32.powf(lot.between(0.0, 1.0) as f32);
        let kind = &kinds[number % kinds.len()];
        // Half of all in the closed chamber, a little on the outside.
        let (place, is_hidden) = match number % 16 {
            0..8 => (inside(&mut lot, size, chambers[0]), true),
            8..11 => (inside(&mut lot, size, chambers[1]), false),
            11..15 => (inside(&mut lot, size, chambers[2]), false),
            _ => {
                let y = f64::from(CHAMBER.y + WALL + 1.02 * size);
                let mut place = inside(&mut lot, size, chambers[number % 3]);
                place.translation.y = y;
                (place, false)
            }
        };
        made.add(kind, place, is_hidden);
        number += 1;
    }
    made
}

impl Machine {
    fn add(&mut self, surface: &Arc<Surface>, model_from_local: DAffine3, is_hidden: bool) {
        self.model.parts.push(Part {
            node: self.model.parts.len() as u32,
            surface: surface.clone(),
            model_from_local,
            is_transparent: false,
            is_two_sided: false,
        });
        self.is_hidden.push(is_hidden);
    }
}

fn at(x: f32, y: f32, z: f32) -> DAffine3 {
    DAffine3::from_translation(Vec3::new(x, y, z).as_dvec3())
}

/// What a chamber has at its front.
#[derive(Clone, Copy)]
enum Front {
    Closed,
    Window,
    Grille,
}

/// The plates around a chamber, each a closed box; they overlap where they meet, so that nothing is open between them.
fn plates(front: Front) -> Vec<Surface> {
    let c = CHAMBER;
    let o = c + Vec3::splat(WALL);
    let mut plates = vec![
        cuboid([-o.x, -o.y, -o.z], [o.x, -c.y, o.z]),
        cuboid([-o.x, c.y, -o.z], [o.x, o.y, o.z]),
        cuboid([-o.x, -o.y, -o.z], [-c.x, o.y, o.z]),
        cuboid([c.x, -o.y, -o.z], [o.x, o.y, o.z]),
        cuboid([-o.x, -o.y, -o.z], [o.x, o.y, -c.z]),
    ];
    match front {
        Front::Closed => plates.push(cuboid([-o.x, -o.y, c.z], [o.x, o.y, o.z])),
        Front::Window => {
            plates.push(cuboid([-o.x, -o.y, c.z], [o.x, -0.3, o.z]));
            plates.push(cuboid([-o.x, 0.3, c.z], [o.x, o.y, o.z]));
        }
        Front::Grille => {
            let mut x = -o.x;
            while x < o.x {
                plates.push(cuboid([x, -o.y, c.z], [x + BAR, o.y, o.z]));
                x += BAR + OPEN;
            }
        }
    }
    plates
}

/// A box from one corner to the other, outward.
pub(super) fn cuboid(least: [f32; 3], greatest: [f32; 3]) -> Surface {
    let corners = [least, greatest];
    Surface {
        positions: (0..8)
            .map(|i| core::array::from_fn(|axis| corners[i >> axis & 1][axis]))
            .collect(),
        triangles: [
            [0, 4, 6, 2],
            [1, 3, 7, 5],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 2, 3, 1],
            [4, 5, 7, 6],
        ]
        .iter()
        .flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]])
        .collect(),
    }
}

/// Radius and height from bottom to top, closed at the axis or in itself. units: of the part's size
const BOLT: [Vec2; 8] = [
    Vec2::new(0.0, -0.8),
    Vec2::new(0.25, -0.8),
    Vec2::new(0.3, -0.7),
    Vec2::new(0.3, 0.2),
    Vec2::new(0.6, 0.2),
    Vec2::new(0.6, 0.5),
    Vec2::new(0.5, 0.6),
    Vec2::new(0.0, 0.6),
];
const SHAFT: [Vec2; 10] = [
    Vec2::new(0.0, -0.95),
    Vec2::new(0.2, -0.95),
    Vec2::new(0.2, -0.5),
    Vec2::new(0.3, -0.5),
    Vec2::new(0.3, 0.1),
    Vec2::new(0.25, 0.1),
    Vec2::new(0.25, 0.6),
    Vec2::new(0.15, 0.6),
    Vec2::new(0.15, 0.95),
    Vec2::new(0.0, 0.95),
];
const BEARING: [Vec2; 9] = [
    Vec2::new(0.5, -0.2),
    Vec2::new(0.9, -0.2),
    Vec2::new(0.95, -0.15),
    Vec2::new(0.95, 0.15),
    Vec2::new(0.9, 0.2),
    Vec2::new(0.5, 0.2),
    Vec2::new(0.45, 0.15),
    Vec2::new(0.45, -0.15),
    Vec2::new(0.5, -0.2),
];

/// A profile turned about the y axis, outward; each of its edges in eight rings.
fn lathe(profile: &[Vec2], around: u32) -> Surface {
    let rings: Vec<Vec2> = profile
        .windows(2)
        .flat_map(|edge| (0..8).map(|i| edge[0].lerp(edge[1], i as f32 / 8.0)))
        .chain(profile.last().copied())
        .collect();
    sheet(rings.len() as u32, around, |i, j| {
        let ring = rings[i as usize];
        let turn = TAU * j as f32 / around as f32;
        Vec3::new(ring.x * turn.cos(), ring.y, ring.x * turn.sin())
    })
}

/// A disc with teeth and a rim.
fn gear() -> Surface {
    let around = 240;
    let profile = [
        Vec2::new(0.0, -0.15),
        Vec2::new(0.7, -0.15),
        Vec2::new(1.0, -0.15),
        Vec2::new(1.0, 0.15),
        Vec2::new(0.7, 0.15),
        Vec2::new(0.0, 0.15),
    ];
    sheet(profile.len() as u32, around, |i, j| {
        let mut ring = profile[i as usize];
        if ring.x > 0.9 && j % 12 < 6 {
            ring.x = 0.85;
        }
        let turn = TAU * j as f32 / around as f32;
        Vec3::new(ring.x * turn.cos(), ring.y, ring.x * turn.sin()) * 0.98
    })
}

/// Six turns of wire.
fn spring() -> Surface {
    tube(16, 12, |t| {
        let turn = 6.0 * TAU * t;
        Vec3::new(0.5 * turn.cos(), 2.0 * t - 1.0, 0.5 * turn.sin())
    })
}

/// A wire along a curve, with a cap at each end.
fn tube(sides: u32, per_turn: u32, curve: impl Fn(f32) -> Vec3) -> Surface {
    let rings = 6 * per_turn * 2;
    let radius = 0.08;
    let centre = |i: u32| curve(i as f32 / (rings - 1) as f32) * 0.9;
    // A ring of no radius closes each end.
    sheet(rings + 2, sides, |i, j| {
        let at = i.clamp(1, rings) - 1;
        let along = (centre((at + 1).min(rings - 1)) - centre(at.saturating_sub(1))).normalize();
        let across = along.any_orthonormal_pair();
        // Against the way along the wire, as rings are stacked.
        let turn = -TAU * j as f32 / sides as f32;
        let out = across.0 * turn.cos() + across.1 * turn.sin();
        let radius = if i == 0 || i == rings + 1 {
            0.0
        } else {
            radius
        };
        centre(at) + out * radius
    })
}

/// Rings of points, the last of each next to its first.
fn sheet(rings: u32, around: u32, point: impl Fn(u32, u32) -> Vec3) -> Surface {
    let positions = (0..rings)
        .flat_map(|i| (0..around).map(move |j| (i, j)))
        .map(|(i, j)| point(i, j).to_array())
        .collect();
    let mut triangles = Vec::new();
    for i in 0..rings - 1 {
        for j in 0..around {
            let k = (j + 1) % around;
            let [a, b, c, d] =
                [(i, j), (i, k), (i + 1, k), (i + 1, j)].map(|(i, j)| i * around + j);
            triangles.extend([[a, d, c], [a, c, b]]);
        }
    }
    Surface {
        positions,
        triangles,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_is_closed_and_faces_outward() {
        let surfaces = [
            spring(),
            gear(),
            lathe(&BEARING, 96),
            lathe(&BOLT, 64),
            lathe(&SHAFT, 48),
            cuboid([0.0; 3], [1.0; 3]),
        ];
        for (number, surface) in surfaces.iter().enumerate() {
            let corner = |i: u32| Vec3::from_array(surface.positions[i as usize]);
            // By place: points at one place are one, where a profile begins and ends and on the axis.
            let place = |i: u32| corner(i).to_array().map(|x| (x * 1e5).round() as i32);
            let mut open = std::collections::HashMap::<_, i32>::new();
            for [a, b, c] in &surface.triangles {
                for (from, to) in [(a, b), (b, c), (c, a)] {
                    let (from, to) = (place(*from), place(*to));
                    if from < to {
                        *open.entry((from, to)).or_default() += 1;
                    } else if to < from {
                        *open.entry((to, from)).or_default() -= 1;
                    }
                }
            }
            assert!(
                open.values().all(|times| *times == 0),
                "surface {number}: an edge without its reverse"
            );
            let six_volumes: f32 = surface
                .triangles
                .iter()
                .map(|[a, b, c]| corner(*a).cross(corner(*b)).dot(corner(*c)))
                .sum();
            assert!(six_volumes > 0.1, "surface {number}: {six_volumes}");
            assert!(
                surface
                    .positions
                    .iter()
                    .all(|p| Vec3::from_array(*p).length() <= 1.8)
            );
        }
    }

    #[test]
    fn half_of_a_machine_s_inside_is_hidden() {
        let machine = machine(1_000_000);
        let hidden = machine.is_hidden.iter().filter(|hidden| **hidden).count();
        assert!(machine.model.triangle_count() >= 1_000_000);
        assert_eq!(machine.model.parts.len(), machine.is_hidden.len());
        let chambers = [Front::Closed, Front::Window, Front::Grille];
        let casing = chambers
            .map(|front| plates(front).len())
            .iter()
            .sum::<usize>();
        let inside = machine.model.parts.len() - casing;
        assert_eq!(hidden, inside / 16 * 8 + (inside % 16).min(8));
    }
}
