//! The spherical index: what it leaves out shows the eye nothing.

use bevy::math::{DAffine3, DQuat, DVec3, DVec4, Vec3};
use bevy_skyline::{
    reference::spherical::side,
    spherical::{Bins, Layout, MapSettings, Shown, SphericalChunks, SphericalError, SphericalMaps},
};
use proptest::prelude::*;

use super::{Claim, Found, Measured, Table, all_hold};
use crate::spherical_check::{
    Dice, Mesh, Shot, Tally, for_all_views, maps_are_right, nothing_visible_goes,
};

const ABOUT: &str = "\
A mesh is looked at by 288 cameras: from its centre, from within, close, far; in perspective and parallel; its fronts, backs or \
both. Its maps are compared with the twin's, and no triangle may be left out that the twin says faces the eye or that a \
rasteriser in `f32` would draw. The figure is how much of a triangle that was left out comes nearest to facing the eye: the \
sine of its angle to the line of sight, above 0 on the shown side.";

const TURNED_AWAY: Claim = Claim::none(
    "all that is left out is turned away: the sine is below 0; the maps are the twin's",
    "",
    "left out only if no corners off by the blur of `View` can turn it round",
);
const COUNT: Claim = Claim::none(
    "so many triangles are drawn as must be, no more and no less",
    "triangles off",
    "known by hand",
);
const REFUSED: Claim = Claim::none(
    "it is refused by name",
    "other answers",
    "there is no such mesh",
);

/// A figure and what it was made of.
struct Worst {
    sine: f64,
    tally: Tally,
}

impl Worst {
    const NONE: Self = Self {
        sine: f64::NEG_INFINITY,
        tally: Tally {
            left_out: 0,
            must_stay: 0,
        },
    };

    fn found(self) -> Found {
        let Tally {
            left_out,
            must_stay,
        } = self.tally;
        if left_out + must_stay == 0 {
            return Err(String::from("nothing was compared").into());
        }
        let note = format!("{left_out} chunks left out, {must_stay} triangles had to stay");
        Measured::noted(self.sine, note)
    }

    /// Takes in one view.
    fn look(
        &mut self,
        mesh: &Mesh,
        maps: &SphericalMaps,
        chunks: &SphericalChunks,
        shot: &Shot,
    ) -> Result<(), String> {
        let view = shot.view(chunks.reach());
        let tally = nothing_visible_goes(mesh, maps, chunks, shot, &view)?;
        self.tally.left_out += tally.left_out;
        self.tally.must_stay += tally.must_stay;
        let sign = match shot.shown {
            Shown::Front => 1.0,
            Shown::Back => -1.0,
            Shown::Both => return Ok(()),
        };
        let eye = match shot.camera.backward {
            None => shot.camera.position.extend(1.0),
            Some(backward) => backward.extend(0.0),
        };
        let turned = chunks
            .chunks()
            .iter()
            .filter(|chunk| !chunks.faces_eye(chunk, &view));
        for place in turned.flat_map(|chunk| chunk.triangles.clone()) {
            let corners = mesh.corners(maps.order[place as usize]);
            let placed = corners.map(|corner| shot.world_from_local.transform_point3(corner));
            if let Some(sine) = sine(placed, eye) {
                self.sine = self.sine.max(sign * sine);
            }
        }
        Ok(())
    }
}

/// Of the angle between a triangle's plane and the way to the eye; `None` of a triangle without area.
fn sine(corners: [DVec3; 3], eye: DVec4) -> Option<f64> {
    let [a, b, c] = corners;
    let way = (eye.truncate() - a * eye.w).length();
    let normal = (b - a).cross(c - a).length();
    (normal * way > 0.0).then(|| side(corners, eye) / (normal * way))
}

fn ball() -> Mesh {
    Mesh::ball(12)
}

/// All views of a mesh.
fn all_views(mesh: &Mesh) -> Found {
    let mut worst = Worst::NONE;
    for_all_views(mesh, 30, |maps, chunks, shot| {
        worst.look(mesh, maps, chunks, shot)
    })?;
    worst.found()
}

/// One view, of fronts or backs as asked.
fn one_view(mesh: &Mesh, shots: &[Shot]) -> Found {
    let bins = Bins { theta: 45, phi: 90 };
    let maps = mesh.maps(bins, Layout::Blocks, 8);
    maps_are_right(mesh, &maps, 20)?;
    let chunks = mesh.chunks(&maps);
    let mut worst = Worst::NONE;
    for shot in shots {
        worst.look(mesh, &maps, &chunks, shot)?;
    }
    worst.found()
}

/// A mesh so large that its middle stays at the origin, with these triangles.
fn around_origin(triangles: &[[[f32; 3]; 3]]) -> Mesh {
    let mut all = triangles.to_vec();
    all.push([[9.0, 9.0, 9.0], [9.0, 8.9, 9.0], [8.9, 9.0, 9.0]]);
    all.push([[-9.0, -9.0, -9.0], [-9.0, -8.9, -9.0], [-8.9, -9.0, -9.0]]);
    Mesh::of(&all)
}

fn disc(sides: u32) -> Mesh {
    let rim = |at: u32| {
        let angle = at as f32 * core::f32::consts::TAU / sides as f32;
        [angle.cos(), 0.0, -angle.sin()]
    };
    let fan: Vec<_> = (0..sides)
        .map(|at| [[0.0; 3], rim(at), rim(at + 1)])
        .collect();
    Mesh::of(&fan)
}

/// With every triangle turned round.
fn inside_out(mut mesh: Mesh) -> Mesh {
    for [_, b, c] in &mut mesh.triangles {
        core::mem::swap(b, c);
    }
    mesh
}

#[rustfmt::skip]
fn meshes() -> Vec<(&'static str, Mesh)> {
    let over = |y: f32| [[1.0, y, 0.5], [-0.7, y, 0.9], [-0.2, y, -1.1]];
    let both = |mesh: Mesh| {
        let mut all = mesh.clone();
        let first = all.positions.len() as u32;
        let back = inside_out(mesh);
        all.positions.extend(back.positions);
        all.triangles.extend(back.triangles.iter().map(|corners| corners.map(|vertex| vertex + first)));
        all
    };
    let strip: Vec<_> = (0..64).map(|at| { let x = at as f32 * 0.1 - 3.2; [[x, 0.0, 1.0], [x + 0.1, 0.0, 1.0], [x, 1e-6, 1.0]] }).collect();
    vec![
        ("triangles over both poles, near and far", around_origin(&[over(3.0), over(-3.0), over(0.01), over(-0.01)])),
        ("corners at the poles", around_origin(&[[[0.0, 2.0, 0.0], [0.3, 2.0, 0.0], [0.0, 2.0, 0.3]], [[0.0, -2.0, 0.0], [0.3, -2.0, 0.0], [0.0, -2.0, 0.3]]])),
        ("edges through the poles", around_origin(&[[[-1.0, 2.0, 0.0], [1.0, 2.0, 0.0], [0.0, 2.0, 1.0]], [[-1.0, -2.0, 0.0], [1.0, -2.0, 0.0], [0.0, -2.0, 1.0]]])),
        ("a triangle from pole to pole", around_origin(&[[[0.0, 3.0, 0.0], [0.0, -3.0, 0.1], [0.1, 2.0, 0.1]]])),
        ("across azimuth 0", around_origin(&[[[3.0, 0.1, -0.4], [3.0, 0.5, 0.4], [3.0, -0.5, 0.4]]])),
        ("a corner on azimuth 0", around_origin(&[[[3.0, 0.0, 0.0], [3.0, 0.5, 0.4], [3.0, -0.5, 0.4]]])),
        ("an edge along azimuth 0", around_origin(&[[[3.0, 0.0, 0.0], [4.0, 0.0, 0.0], [3.0, 0.5, 0.4]]])),
        ("azimuths of almost half a turn", around_origin(&[[[3.0, 0.2, 0.001], [-3.0, 0.2, 0.001], [0.0, 0.4, 2.0]]])),
        ("a centroid at the centre", around_origin(&[[[1.0, 0.0, 0.0], [-0.5, 0.5, 0.0], [-0.5, -0.5, 0.0]]])),
        ("the centre inside a triangle", around_origin(&[[[2.0, 0.0, 1.0], [-2.0, 0.3, -1.0], [-2.0, -0.3, -1.0]]])),
        ("the centre on an edge", around_origin(&[[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 1.0]]])),
        ("the centre at a corner", around_origin(&[[[0.0, 0.0, 0.0], [1.0, 0.0, 2.0], [0.0, 1.0, 0.0]]])),
        ("planes 10⁻⁷ beside the centre", around_origin(&[[[2.0, 1e-7, 2.0], [-2.0, 1e-7, 2.0], [0.0, 1e-7, -2.0]], [[2.0, -1e-7, 2.0], [0.0, -1e-7, -2.0], [-2.0, -1e-7, 2.0]]])),
        ("three huge triangles about the centre", Mesh::of(&[[[1e3, 0.1, 1e3], [-1e3, 0.1, 1e3], [0.0, 0.1, -1e3]], [[1e3, -0.1, 1e3], [0.0, -0.1, -1e3], [-1e3, -0.1, 1e3]], [[0.1, 1e3, -1e3], [0.1, -1e3, -1e3], [0.1, 0.0, 1e3]]])),
        ("a flat disc", disc(16)),
        ("a flat disc of both sides", both(disc(16))),
        ("a disc of 500 slivers", disc(500)),
        ("one triangle", Mesh::of(&[[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])),
        ("two triangles back to back", both(Mesh::of(&[[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]))),
        ("a ball", Mesh::ball(12)),
        ("a ball inside out", inside_out(Mesh::ball(12))),
        ("a ball of both sides", both(Mesh::ball(8))),
        ("a ball about another, inside out", {
            let mut all = Mesh::ball(8);
            let inner = inside_out(Mesh::ball(8).placed([0.9; 3], [0.0; 3]));
            let first = all.positions.len() as u32;
            all.positions.extend(inner.positions);
            all.triangles.extend(inner.triangles.iter().map(|corners| corners.map(|vertex| vertex + first)));
            all
        }),
        ("a ball flattened to a thousandth", Mesh::ball(10).placed([1.0, 1e-3, 1.0], [0.0; 3])),
        ("a needle of a ball", Mesh::ball(10).placed([1e-3, 1.0, 1e-3], [0.0; 3])),
        ("a ball of 10⁻²⁰ m", Mesh::ball(8).placed([1e-20; 3], [0.0; 3])),
        ("a ball of 10¹⁵ m", Mesh::ball(8).placed([1e15; 3], [0.0; 3])),
        ("a ball of 400 m at 10⁷ m", Mesh::ball(10).placed([400.0; 3], [1e7, -1e7, 1e7])),
        ("a strip of slivers of 10⁻⁶", around_origin(&strip)),
        ("triangles with two corners at one place, beside one without", Mesh::of(&[[[1.0; 3], [1.0; 3], [2.0; 3]], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])),
        ("corners on one line, beside a triangle", Mesh::of(&[[[0.0, 1.0, 5.0], [1.0, 1.0, 5.0], [2.0, 1.0, 5.0]], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])),
        ("a soup of all sizes", Dice(5).soup(150)),
        ("a soup of one place", { let mut soup = Dice(6).soup(3); for _ in 0..5 { soup.triangles.extend_from_within(..3); } soup }),
    ]
}

#[rustfmt::skip]
fn cameras(table: &mut Table) {
    let mut views = |name: &str, mesh: fn() -> Mesh, shots: Vec<Shot>| {
        table.case(TURNED_AWAY, name, move |_| one_view(&mesh(), &shots));
    };
    let aim = DVec3::new(0.1, 0.2, 0.3);
    let at = |eye: DVec3| [Shown::Front, Shown::Back].map(|shown| Shot::at(eye, aim, 1e-4).with(DAffine3::IDENTITY, shown)).to_vec();
    let mesh = ball();
    let [a, b, c] = mesh.corners(100);
    views("an eye on a corner", ball, at(a));
    views("an eye on an edge", ball, at((a + b) / 2.0));
    views("an eye on a face", ball, at((a + b + c) / 3.0));
    views("an eye in a face's plane", ball, at(a + (b - a) * 300.0 + (c - a) * 100.0));
    views("an eye a rounding behind a face", ball, at((a + b + c) / 3.0 * (1.0 - 1e-15)));
    views("an eye at the very centre", ball, at(DVec3::ZERO));
    views("an eye at 10⁹ radii", ball, at(DVec3::new(1.0, 2.0, 3.0) * 1e9));
    views("an eye above a pole", ball, at(DVec3::Y * 3.0));
    let placed = |scale: DVec3, turn: DQuat, by: DVec3| {
        let near = (1e-3 * scale.abs().min_element()) as f32;
        let place = DAffine3::from_scale_rotation_translation(scale, turn, by);
        let eye = place.transform_point3(DVec3::new(3.0, 2.0, 1.0));
        [Shown::Front, Shown::Back].map(|shown| Shot::at(eye, by, near).with(place, shown)).to_vec()
    };
    let turn = DQuat::from_rotation_x(0.7) * DQuat::from_rotation_y(1.9);
    views("mirrored in one axis", ball, placed(DVec3::new(1.0, 1.0, -1.0), turn, DVec3::ZERO));
    views("mirrored in all axes", ball, placed(DVec3::NEG_ONE, turn, DVec3::ZERO));
    views("stretched 1:1000", ball, placed(DVec3::new(1.0, 1000.0, 1.0), turn, DVec3::ZERO));
    views("turned at 10⁷ m", ball, placed(DVec3::ONE, turn, DVec3::new(1e7, -1e7, 1e7)));
    views("shrunk to a millionth", ball, placed(DVec3::splat(1e-6), turn, DVec3::ZERO));
    views("parallel light along an axis", ball, [Shown::Front, Shown::Back].map(|shown| Shot::parallel(DVec3::Z * 5.0, DVec3::ZERO, 3.0).with(DAffine3::IDENTITY, shown)).to_vec());
    views("a parallel camera inside", ball, [Shown::Front, Shown::Back].map(|shown| Shot::parallel(aim, DVec3::ZERO, 3.0).with(DAffine3::IDENTITY, shown)).to_vec());
    views("a disc edge-on", || disc(16), at(DVec3::new(3.0, 0.0, 0.0)));
    views("a disc edge-on but for 10⁻¹² m", || disc(16), [at(DVec3::new(3.0, 1e-12, 0.0)), at(DVec3::new(3.0, -1e-12, 0.0))].concat());
}

#[rustfmt::skip]
fn counts(table: &mut Table) {
    let mut count = |name: &str, mesh: fn() -> Mesh, shot: Shot, expected: fn(usize) -> usize| {
        table.case(COUNT, name, move |_| {
            let mesh = mesh();
            let maps = mesh.maps(Bins { theta: 45, phi: 90 }, Layout::Blocks, 4);
            let chunks = mesh.chunks(&maps);
            let count = chunks.select(&shot.view(chunks.reach()), &[], &mut Vec::new());
            let expected = expected(mesh.triangles.len());
            Measured::noted(count.abs_diff(expected) as f64, format!("{count} of {}", mesh.triangles.len()))
        });
    };
    let shot = Shot::at(DVec3::new(0.3, 1.0, 3.0), DVec3::ZERO, 0.1);
    let scaled = |scale: DVec3| shot.with(DAffine3::from_scale(scale), Shown::Front);
    count("no triangles", Mesh::default, shot, |_| 0);
    count("only triangles with two corners at one place", || Mesh::of(&[[[1.0; 3], [1.0; 3], [2.0; 3]], [[3.0; 3]; 3]]), shot, |_| 0);
    count("a disc from above", || disc(16), shot, |all| all);
    count("a disc from below", || disc(16), Shot::at(DVec3::new(0.3, -1.0, 3.0), DVec3::ZERO, 0.1), |_| 0);
    count("a disc from below, mirrored", || disc(16), Shot::at(DVec3::new(0.3, -1.0, 3.0), DVec3::ZERO, 0.1).with(DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)), Shown::Front), |all| all);
    count("a ball from its centre", ball, Shot::at(DVec3::ZERO, DVec3::X, 0.1), |_| 0);
    count("a ball from its centre, both sides", ball, Shot::at(DVec3::ZERO, DVec3::X, 0.1).with(DAffine3::IDENTITY, Shown::Both), |all| all);
    count("a triangle before the near plane, from behind", || Mesh::of(&[[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]), Shot::at(DVec3::new(0.3, 0.3, -0.05), DVec3::new(-0.7, 0.3, -0.05), 0.1), |all| all);
    count("a triangle beyond the near plane, from behind", || Mesh::of(&[[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]), Shot::at(DVec3::new(0.3, 0.3, -0.5), DVec3::new(-0.7, 0.3, -0.5), 0.1), |_| 0);
    for (name, scale) in [("a scale of 0", DVec3::ZERO), ("a scale of 0 along one axis", DVec3::new(1.0, 0.0, 1.0)), ("a scale of NaN", DVec3::NAN), ("a scale of 10⁻²⁰⁰", DVec3::splat(1e-200)), ("a scale of 10²⁰⁰", DVec3::splat(1e200))] {
        count(name, || Mesh::ball(6), scaled(scale), |all| all);
    }
    let nowhere = |eye: DVec3| Shot::at(eye, DVec3::ZERO, 0.1);
    count("an eye at NaN", || Mesh::ball(6), nowhere(DVec3::new(f64::NAN, 0.0, 3.0)), |all| all);
    count("an eye infinitely far away", || Mesh::ball(6), nowhere(DVec3::new(f64::INFINITY, 0.0, 3.0)), |all| all);
}

fn refusals(table: &mut Table) {
    type Change = fn(&mut Mesh, &mut MapSettings);
    type IsRight = fn(&SphericalError) -> bool;
    let cases: [(&str, Change, IsRight); 7] = [
        (
            "a corner of NaN",
            |mesh, _| mesh.positions[17][1] = f32::NAN,
            |why| matches!(why, SphericalError::NotFinite { vertex: 17, .. }),
        ),
        (
            "a corner of ∞",
            |mesh, _| mesh.positions[17][1] = f32::INFINITY,
            |why| matches!(why, SphericalError::NotFinite { vertex: 17, .. }),
        ),
        (
            "a corner that is not there",
            |mesh, _| mesh.triangles[5][2] = 4000,
            |why| matches!(why, SphericalError::NoSuchVertex { triangle: 5, .. }),
        ),
        (
            "no bins from pole to pole",
            |_, settings| settings.bins.theta = 0,
            |why| matches!(why, SphericalError::Bins { theta: 0, .. }),
        ),
        (
            "no bins around",
            |_, settings| settings.bins.phi = 0,
            |why| matches!(why, SphericalError::Bins { phi: 0, .. }),
        ),
        (
            "4 billion bins",
            |_, settings| {
                settings.bins = Bins {
                    theta: u16::MAX,
                    phi: u16::MAX,
                }
            },
            |why| matches!(why, SphericalError::Bins { .. }),
        ),
        (
            "chunks of no triangles",
            |_, settings| settings.chunk_triangles = 0,
            |why| *why == SphericalError::NoChunk,
        ),
    ];
    for (name, change, is_right) in cases {
        table.case(REFUSED, name, move |_| {
            let (mut mesh, mut settings) = (Mesh::ball(4), MapSettings::default());
            change(&mut mesh, &mut settings);
            match SphericalMaps::build(&mesh.positions, &mesh.triangles, settings) {
                Err(why) if is_right(&why) => Measured::noted(0.0, format!("“{why}”")),
                Err(why) => Err(why.to_string().into()),
                Ok(_) => Err(String::from("it was not refused").into()),
            }
        });
    }
}

pub fn table() -> Table {
    let mut table = Table::new("Spherical index", ABOUT);
    for (name, mesh) in meshes() {
        table.case(TURNED_AWAY, name, move |_| all_views(&mesh));
    }
    cameras(&mut table);
    counts(&mut table);
    refusals(&mut table);
    table
}

#[test]
fn every_case_holds() {
    all_hold(&table());
}

#[test]
fn a_triangle_that_is_left_out_and_shown_is_caught() {
    // What is left out of a ball, looked at from the other side.
    let mesh = Mesh::ball(12);
    let maps = mesh.maps(Bins { theta: 45, phi: 90 }, Layout::Blocks, 8);
    let chunks = mesh.chunks(&maps);
    let shot = Shot::at(DVec3::new(3.0, 2.0, 1.0), DVec3::ZERO, 0.1);
    let view = shot.view(chunks.reach());
    let opposite = -shot.camera.position;
    let out = chunks
        .chunks()
        .iter()
        .filter(|chunk| !chunks.faces_eye(chunk, &view));
    let sines = out.flat_map(|chunk| chunk.triangles.clone()).map(|place| {
        let corners = mesh.corners(maps.order[place as usize]);
        [shot.camera.position, opposite].map(|eye| sine(corners, eye.extend(1.0)).unwrap_or(-1.0))
    });
    let [mut here, mut there] = [f64::NEG_INFINITY; 2];
    for [a, b] in sines {
        (here, there) = (here.max(a), there.max(b));
    }
    assert!(here < 0.0 && there > 0.5, "{here} {there}");
    // And the comparison that the claim is about.
    let other = Shot {
        camera: bevy_skyline::spherical::Eye {
            position: opposite,
            ..shot.camera
        },
        ..shot
    };
    let compared = nothing_visible_goes(&mesh, &maps, &chunks, &shot, &other.view(chunks.reach()));
    assert!(compared.is_err());
    assert!(Worst::NONE.found().is_err());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, rng_seed: prop::test_runner::RngSeed::Fixed(53), failure_persistence: None, ..Default::default() })]

    /// Each mesh of the table, its corners moved by little or much, from anywhere.
    #[test]
    fn what_is_near_a_hard_mesh_is_right(number in 0usize..33, by in -9i32..0, seed: u64) {
        let (name, mut mesh) = meshes().swap_remove(number % meshes().len());
        let mut dice = Dice(seed);
        let size = mesh.positions.iter().flatten().fold(0.0f32, |most, x| most.max(x.abs()));
        for position in &mut mesh.positions {
            let off = (dice.place() * 10f64.powi(by)).as_vec3() * size;
            *position = (Vec3::from(*position) + off).to_array();
        }
        let maps = mesh.maps(Bins { theta: 45, phi: 90 }, Layout::Blocks, 5);
        let chunks = mesh.chunks(&maps);
        let mut worst = Worst::NONE;
        for _ in 0..8 {
            let eye = maps.centre + dice.place() * maps.radius * 10f64.powf(4.0 * dice.roll() - 2.0);
            let near = (maps.radius * 1e-3) as f32;
            for shown in [Shown::Front, Shown::Back] {
                let shot = Shot::at(eye, maps.centre, near).with(DAffine3::IDENTITY, shown);
                let looked = worst.look(&mesh, &maps, &chunks, &shot);
                prop_assert!(looked.is_ok(), "{}: {:?}", name, looked);
            }
        }
        prop_assert!(worst.sine < 0.0, "{}: {}", name, worst.sine);
    }
}
