//! Models that are hard to tell inside from outside of, and what must become of their parts.

use std::sync::Arc;

use bevy::math::{DAffine3, DVec3};
use bevy_skyline::interior::{
    InteriorCulling, InteriorFaces, InteriorGrid, InteriorLevel, InteriorMode, InteriorTransparent,
    Model, Part, Surface,
};

use crate::interior::{
    Dice, at, cube, cuboid, inside_out, joined, model, part, placed, room_with_slit, two_sided,
};

/// What must become of a part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stays {
    /// All of it.
    All,
    /// Some of it at least.
    Some,
    /// None.
    None,
    /// Whatever rays from outside do not meet may go.
    AsSeen,
}

/// A model, how it is culled, what must become of each of its parts, and how many rays look at it from outside. Rays see
/// through gaps of any width: where the guarantee is of wider ones, none are sent.
pub struct Culled {
    pub name: &'static str,
    pub model: Model,
    pub settings: InteriorCulling,
    pub stays: Vec<Stays>,
    pub rays: usize,
}

fn quad(corners: [[f32; 3]; 4]) -> Surface {
    Surface {
        positions: corners.to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

fn single(corners: [[f32; 3]; 3]) -> Surface {
    Surface {
        positions: corners.to_vec(),
        triangles: vec![[0, 1, 2]],
    }
}

/// The wall at +z as a fan of slivers from a corner.
fn slivers(count: u32) -> Surface {
    let mut walls = cube(1.0);
    walls.triangles.truncate(10);
    let first = walls.positions.len() as u32;
    walls.positions.push([-1.0, -1.0, 1.0]);
    for i in 0..=count {
        walls
            .positions
            .push([1.0, -1.0 + 2.0 * i as f32 / count as f32, 1.0]);
    }
    for i in 0..=count {
        walls
            .positions
            .push([1.0 - 2.0 * i as f32 / count as f32, 1.0, 1.0]);
    }
    for i in first + 1..walls.positions.len() as u32 - 1 {
        walls.triangles.push([first, i, i + 1]);
    }
    walls
}

/// A closed box whose walls each are `n`×`n` quads that share no vertex.
fn tiles(n: u32) -> Surface {
    let mut all = Vec::new();
    let step = 2.0 / n as f32;
    for axis in 0..3 {
        for side in [-1.0f32, 1.0] {
            for k in 0..n * n {
                let (u, v) = (-1.0 + step * (k % n) as f32, -1.0 + step * (k / n) as f32);
                let mut corners =
                    [(u, v), (u + step, v), (u + step, v + step), (u, v + step)].map(|(u, v)| {
                        let mut corner = [0.0; 3];
                        corner[axis] = side;
                        corner[(axis + 1) % 3] = u;
                        corner[(axis + 2) % 3] = v;
                        corner
                    });
                if side < 0.0 {
                    corners.reverse();
                }
                all.push(quad(corners));
            }
        }
    }
    joined(all)
}

fn open_box() -> Surface {
    let mut open = cube(1.0);
    open.triangles.drain(6..8);
    open
}

fn transparent(part: Part) -> Part {
    Part {
        is_transparent: true,
        ..part
    }
}

fn with(settings: InteriorCulling, change: impl FnOnce(&mut InteriorCulling)) -> InteriorCulling {
    let mut changed = settings;
    change(&mut changed);
    changed
}

#[rustfmt::skip]
pub fn models() -> Vec<Culled> {
    use Stays::{All, AsSeen, None as Gone, Some as Partly};
    let mut all = Vec::new();
    let mut case = |name, parts: Vec<Part>, settings: InteriorCulling, stays: &[Stays], rays| {
        all.push(Culled { name, model: model(parts), settings, stays: stays.to_vec(), rays });
    };
    let solid = |half: f32| part(cube(half));
    let moved = |part: Part, by: DVec3| placed(part, DAffine3::from_translation(by));
    case("a box in a closed box", vec![solid(1.0), solid(0.4)], at(32), &[All, Gone], 1000);
    case("a box in an open box", vec![two_sided(part(open_box())), solid(0.4)], at(32), &[All, Partly], 1000);
    case("five shells in each other", (1..=5).map(|i| solid(0.2 * i as f32)).collect(), at(64), &[Gone, Gone, Gone, Gone, All], 1000);
    case("shells a cell apart", vec![solid(1.0), solid(1.0 - 2.0 / 32.0)], at(32), &[All, AsSeen], 1000);
    case("two boxes in the same place", vec![solid(1.0), solid(1.0), solid(0.3)], at(50), &[AsSeen, AsSeen, Gone], 1000);
    case("two boxes in the same place, one inside out", vec![solid(1.0), part(inside_out(cube(1.0))), solid(0.3)], at(50), &[AsSeen, AsSeen, Gone], 1000);
    case("a face in another box's face", vec![solid(1.0), part(cuboid([1.0, -1.0, -1.0], [2.0, 1.0, 1.0])), solid(0.3)], at(75), &[Partly, Partly, Gone], 1000);
    case("a wall of 500 slivers", vec![part(slivers(500)), solid(0.8)], at(64), &[AsSeen, Gone], 1000);
    case("walls of 24×24 quads without a vertex in common", vec![part(tiles(24)), solid(0.8)], at(48), &[All, Gone], 1000);
    case("inside out: its far walls are seen through the near ones", vec![part(inside_out(cube(1.0))), solid(0.4)], at(40), &[All, All], 1000);
    case("inside out, but hiding from both sides", vec![part(inside_out(cube(1.0))), solid(0.4)], with(at(40), |s| s.faces = InteriorFaces::TwoSided), &[All, Gone], 0);
    case("behind glass that is open", vec![transparent(solid(1.0)), solid(0.4), solid(0.2)], at(40), &[All, All, Gone], 0);
    case("behind glass that is closed", vec![transparent(solid(1.0)), solid(0.4)], with(at(40), |s| s.transparent = InteriorTransparent::Closed), &[All, Gone], 0);
    case("glass only", vec![transparent(solid(1.0)), transparent(solid(0.4))], at(40), &[All, All], 1000);
    // Gaps.
    let cells = 40u32;
    let room = |slit: f64, turn: DAffine3| {
        let mut parts = vec![room_with_slit(1.0, slit as f32), two_sided(solid(0.5))];
        parts.iter_mut().for_each(|part| part.model_from_local = turn);
        parts
    };
    let cell = 2.0 / f64::from(cells);
    let wide = 3f64.sqrt() * cell;
    // Turned, its box is larger, and so is a cell.
    let turn = DAffine3::from_quat(Dice(5).turn());
    case("a slit of √3 cells and a ten-thousandth", room(wide * 1.0001, DAffine3::IDENTITY), at(cells), &[AsSeen, All], 0);
    case("a slit of twice √3 cells, the room turned", room(2.0 * wide, turn), at(cells), &[AsSeen, All], 0);
    case("a crack of a tenth of a cell", room(0.1 * cell, DAffine3::IDENTITY), at(cells), &[AsSeen, Gone], 0);
    case("a crack of a tenth of a cell, the room turned", room(0.1 * cell, turn), at(cells), &[AsSeen, Gone], 0);
    case("a crack of no width between two sheets", room(0.0, turn), at(cells), &[AsSeen, Gone], 0);
    // Flat, single, degenerate.
    let sheet = || quad([[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]]);
    case("a sheet without thickness, a box below it", vec![part(sheet()), moved(solid(0.1), DVec3::NEG_Y)], at(32), &[All, All], 1000);
    case("a sheet alone", vec![part(sheet())], at(32), &[All], 1000);
    case("one triangle", vec![part(single([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))], at(300), &[All], 0);
    case("one triangle in one cell", vec![part(single([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))], at(1), &[All], 0);
    case("a triangle that is a point", vec![part(single([[3.0; 3]; 3]))], at(16), &[All], 0);
    case("a triangle that is a segment", vec![part(single([[0.0; 3], [0.0, 5.0, 0.0], [0.0, 2.5, 0.0]]))], at(16), &[All], 0);
    case("a triangle that is a point inside a box", vec![solid(1.0), part(single([[0.1; 3]; 3]))], at(32), &[All, Gone], 1000);
    case("a box 1000 times as long as wide", vec![part(cuboid([-1.0, -0.001, -0.001], [1.0, 0.001, 0.001]))], at(100), &[All], 0);
    case("a box thinner than a unit of the lattice", vec![part(cuboid([-1.0, -1.0, -1e-7], [1.0, 1.0, 1e-7]))], at(64), &[All], 0);
    // Places and transforms.
    for (name, scale) in [("mirrored in X", DVec3::new(-1.0, 1.0, 1.0)), ("mirrored in all", DVec3::NEG_ONE), ("stretched 1:50 and mirrored", DVec3::new(2.0, -0.1, 5.0))] {
        let shape = DAffine3::from_scale(scale);
        case(name, vec![placed(solid(1.0), shape), placed(solid(0.5), shape)], at(400), &[All, Gone], 1000);
    }
    let away = DVec3::new(1e7, -1e7, 1e7);
    case("10⁷ m from the origin", vec![moved(solid(1.0), away), moved(solid(0.4), away)], at(32), &[All, Gone], 0);
    case("10⁹ m from the origin, a tenth of a millimetre large", vec![placed(solid(1.0), DAffine3::from_translation(away * 100.0) * DAffine3::from_scale(DVec3::splat(1e-4)))], at(64), &[All], 0);
    case("a nanometre large", vec![placed(solid(1.0), DAffine3::from_scale(DVec3::splat(1e-9))), placed(solid(0.4), DAffine3::from_scale(DVec3::splat(1e-9)))], at(32), &[All, Gone], 0);
    case("10¹² m large", vec![placed(solid(1.0), DAffine3::from_scale(DVec3::splat(1e12))), placed(solid(0.4), DAffine3::from_scale(DVec3::splat(1e12)))], at(32), &[All, Gone], 0);
    case("scaled to nothing beside a box", vec![solid(1.0), placed(solid(1.0), DAffine3::from_scale_rotation_translation(DVec3::ZERO, bevy::math::DQuat::IDENTITY, DVec3::X * 3.0))], at(32), &[All, All], 0);
    case("scaled to nothing inside a box", vec![solid(1.0), placed(solid(1.0), DAffine3::from_scale(DVec3::ZERO))], at(32), &[All, Gone], 0);
    // One surface at two places, and one node of two parts.
    let shared = Arc::new(cube(0.3));
    let twin = |by: DVec3| Part { surface: Arc::clone(&shared), ..moved(solid(0.3), by) };
    case("one surface placed inside and outside", vec![solid(1.0), twin(DVec3::ZERO), twin(DVec3::X * 3.0)], at(64), &[All, Gone, All], 1000);
    case("the same node twice in one place", vec![solid(1.0), twin(DVec3::ZERO), twin(DVec3::ZERO)], at(40), &[All, Gone, Gone], 1000);
    let mut of_one_node = model([solid(1.0), solid(0.5), solid(0.2)]);
    of_one_node.parts[1].node = 0;
    all.push(Culled { name: "a hidden part of a seen node stays, a hidden node goes", model: of_one_node, settings: with(at(40), |s| s.level = InteriorLevel::Node), stays: vec![All, All, Gone], rays: 1000 });
    // Indices.
    let mut broken = cube(1.0);
    broken.triangles.push([0, 1, 99]);
    broken.positions.push([f32::NAN; 3]);
    all.push(Culled { name: "a triangle of a vertex that is not there, and a NaN that none has", model: model([part(broken)]), settings: at(16), stays: vec![Partly], rays: 0 });
    // Soups, by any grid.
    for (name, seed, two, cells) in [("a soup of 200 triangles", 1, false, 24), ("a soup of 200 two-sided triangles", 2, true, 24), ("a soup in a grid of 3 cells", 3, true, 3)] {
        all.push(Culled { name, model: model([Dice(seed).soup(200, two)]), settings: at(cells), stays: vec![AsSeen], rays: 0 });
    }
    let rods = (0..40).map(|i| { let x = -0.95 + 0.05 * i as f32; part(cuboid([x, -1.0, 0.7], [x + 0.01, 1.0, 0.71])) });
    all.push(Culled { name: "rods thinner than a cell around a box", model: model(core::iter::once(solid(0.5)).chain(rods)), settings: at(16), stays: Vec::new(), rays: 1500 });
    all.push(Culled { name: "the paper's extraction, of a closed box", model: model([solid(1.0), solid(0.4)]), settings: with(at(32), |s| s.mode = InteriorMode::Sampled), stays: vec![All, Gone], rays: 0 });
    all.push(Culled { name: "a gap larger than the model", model: model([solid(1.0), solid(0.4)]), settings: InteriorCulling { grid: InteriorGrid::Gap(1e6), ..InteriorCulling::default() }, stays: vec![All, AsSeen], rays: 1000 });
    all
}
