//! Interior culling against its twin, step by step and triangle by triangle; its guarantee with a rolling ball; and its
//! hard cases by rays from outside.

use std::{num::NonZero, sync::Arc};

use bevy::math::{DAffine3, DQuat, DVec3};
use bevy_skyline::{
    interior::{
        InteriorCulling, InteriorError, InteriorFaces, InteriorGrid, InteriorLevel, InteriorMode,
        InteriorTransparent, Model, Outcome, Part, Progress, Stage, Surface, Verdict, cull,
        distance_field, front,
    },
    reference::interior as twin,
};
use proptest::prelude::*;

/// Threads: more than one, so that they meet.
pub fn crew() -> NonZero<usize> {
    NonZero::new(3).expect("three")
}

pub fn at(resolution: u32) -> InteriorCulling {
    InteriorCulling {
        grid: InteriorGrid::Resolution(resolution),
        ..Default::default()
    }
}

fn culled(model: &Model, settings: &InteriorCulling) -> Outcome {
    cull(model, settings, crew(), &Progress::default()).expect("it can be culled")
}

/// A surface as a part that is drawn as closed models are.
pub fn part(surface: Surface) -> Part {
    Part {
        node: 0,
        surface: Arc::new(surface),
        model_from_local: DAffine3::IDENTITY,
        is_transparent: false,
        is_two_sided: false,
    }
}

/// Parts, each its own node.
pub fn model(parts: impl IntoIterator<Item = Part>) -> Model {
    let parts = parts.into_iter().zip(0..);
    Model {
        parts: parts.map(|(part, node)| Part { node, ..part }).collect(),
    }
}

/// A box from one corner to the other, outward.
pub fn cuboid(least: [f32; 3], greatest: [f32; 3]) -> Surface {
    let corners = [least, greatest];
    let positions = (0..8)
        .map(|i| core::array::from_fn(|axis| corners[i >> axis & 1][axis]))
        .collect();
    let quads = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    Surface {
        positions,
        triangles: quads
            .iter()
            .flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]])
            .collect(),
    }
}

pub fn cube(half: f32) -> Surface {
    cuboid([-half; 3], [half; 3])
}

/// The same seen from inside.
pub fn inside_out(surface: Surface) -> Surface {
    Surface {
        triangles: surface
            .triangles
            .iter()
            .map(|[a, b, c]| [*a, *c, *b])
            .collect(),
        ..surface
    }
}

pub fn two_sided(part: Part) -> Part {
    Part {
        is_two_sided: true,
        ..part
    }
}

pub fn placed(part: Part, model_from_local: DAffine3) -> Part {
    Part {
        model_from_local,
        ..part
    }
}

/// One surface of several.
pub fn joined(surfaces: impl IntoIterator<Item = Surface>) -> Surface {
    let mut all = Surface::default();
    for surface in surfaces {
        let first = all.positions.len() as u32;
        all.positions.extend(surface.positions);
        all.triangles
            .extend(surface.triangles.iter().map(|t| t.map(|i| i + first)));
    }
    all
}

/// Walls around a room, of two-sided sheets, with a slit so wide all along one of them.
pub fn room_with_slit(half: f32, slit: f32) -> Part {
    let sheet = |corners: [[f32; 3]; 4]| Surface {
        positions: corners.to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    let h = half;
    let mut walls = cube(half);
    // Without the wall at +x, in whose place two leave a slit in y between them.
    walls.triangles.drain(2..4);
    two_sided(part(joined([
        walls,
        sheet([
            [h, -h, -h],
            [h, -slit / 2.0, -h],
            [h, -slit / 2.0, h],
            [h, -h, h],
        ]),
        sheet([
            [h, slit / 2.0, -h],
            [h, h, -h],
            [h, h, h],
            [h, slit / 2.0, h],
        ]),
    ])))
}

/// Random numbers, the same on every machine.
pub struct Dice(pub u64);

impl Dice {
    fn roll(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// In a cube from −1 to 1.
    fn place(&mut self) -> DVec3 {
        DVec3::new(self.roll(), self.roll(), self.roll()) * 2.0 - 1.0
    }

    fn way(&mut self) -> DVec3 {
        loop {
            let place = self.place();
            if (1e-3..=1.0).contains(&place.length()) {
                return place.normalize();
            }
        }
    }

    pub fn turn(&mut self) -> DQuat {
        DQuat::from_axis_angle(self.way(), self.roll() * core::f64::consts::TAU)
    }

    /// Triangles of all sizes, some of them degenerate, on planes of a lattice, or one in the place of another.
    pub fn soup(&mut self, count: usize, two_sided: bool) -> Part {
        let mut surface = Surface::default();
        for _ in 0..count {
            let size = 10f64.powf(-1.5 + 1.9 * self.roll());
            let middle = self.place();
            let mut corners = [(); 3].map(|()| (middle + self.place() * size).as_vec3().to_array());
            match (self.roll() * 12.0) as u32 {
                0 => corners[2] = corners[1],
                1 => corners = [corners[0]; 3],
                2 => corners.iter_mut().for_each(|corner| corner[1] = 0.25),
                3 => corners[2] = core::array::from_fn(|i| 0.5 * (corners[0][i] + corners[1][i])),
                _ => {}
            }
            if self.roll() < 0.1 && !surface.triangles.is_empty() {
                let [a, b, c] = *surface.triangles.last().expect("there is one");
                surface.triangles.push([c, b, a]);
                continue;
            }
            let first = surface.positions.len() as u32;
            surface.positions.extend(corners);
            surface.triangles.push([first, first + 1, first + 2]);
        }
        Part {
            is_two_sided: two_sided,
            ..part(surface)
        }
    }
}

/// What a ray meets first, as (part, triangle): from both sides, or from where it is drawn.
pub fn first_hit(
    triangles: &[(usize, usize, [DVec3; 3], bool)],
    from: DVec3,
    way: DVec3,
) -> Option<(usize, usize)> {
    let mut first = (f64::INFINITY, None);
    for (part, number, [a, b, c], is_two_sided) in triangles {
        let (u, v) = (*b - *a, *c - *a);
        let across = way.cross(v);
        let det = u.dot(across);
        if det.abs() < 1e-14 || (det < 0.0 && !is_two_sided) {
            continue;
        }
        let to = from - *a;
        let s = to.dot(across) / det;
        let q = to.cross(u);
        let t = way.dot(q) / det;
        let far = v.dot(q) / det;
        // What is met at an edge may be either side's.
        if s > 1e-9 && t > 1e-9 && s + t < 1.0 - 1e-9 && far > 0.0 && far < first.0 {
            first = (far, Some((*part, *number)));
        }
    }
    first.1
}

/// The triangles that rays from outside meet first.
pub fn hits(model: &Model, rays: usize, seed: u64) -> Vec<(usize, usize)> {
    let mut triangles = Vec::new();
    for (number, part) in model.parts.iter().enumerate() {
        let is_mirrored = part.model_from_local.matrix3.determinant() < 0.0;
        for (at, corners) in part.corners().enumerate() {
            let [a, b, c] = corners.map(|corner| part.place(corner));
            let corners = if is_mirrored { [a, c, b] } else { [a, b, c] };
            triangles.push((number, at, corners, part.is_two_sided));
        }
    }
    let corners = || triangles.iter().flat_map(|(_, _, corners, _)| corners);
    let least = corners().copied().reduce(DVec3::min).expect("a corner");
    let greatest = corners().copied().reduce(DVec3::max).expect("a corner");
    let (middle, radius) = ((least + greatest) / 2.0, (greatest - least).length());
    let mut dice = Dice(seed);
    let mut hits = Vec::new();
    for _ in 0..rays {
        let from = middle + dice.way() * radius;
        let to = middle + dice.place() * (greatest - least) / 2.0;
        if let Some(hit) = first_hit(&triangles, from, (to - from).normalize()) {
            hits.push(hit);
        }
    }
    assert!(!hits.is_empty(), "no ray met anything");
    hits
}

/// Rays from outside meet nothing that was taken away.
fn assert_seen_stays(model: &Model, outcome: &Outcome) {
    for (part, triangle) in hits(model, 3000, 11) {
        assert!(
            outcome.parts[part].is_seen(triangle),
            "triangle {triangle} of part {part} is seen and gone"
        );
    }
}

fn each_face() -> [(bool, InteriorFaces); 3] {
    [
        (true, InteriorFaces::AsDrawn),
        (false, InteriorFaces::AsDrawn),
        (false, InteriorFaces::TwoSided),
    ]
}

// The twin.

#[test]
fn every_step_is_blocked_where_the_twin_says() {
    let (mut decided, mut open, mut in_band) = (0, 0, 0);
    for (round, (is_two_sided, faces)) in (0..12).zip(each_face().iter().cycle()) {
        let mut dice = Dice(round);
        let model = model([dice.soup(60, *is_two_sided)]);
        let settings = InteriorCulling {
            faces: *faces,
            ..at(6 + round as u32)
        };
        let (lattice, field) =
            distance_field(&model, &settings, crew(), &Progress::default()).expect("a field");
        let triangles = twin::triangles(&model, &settings, &lattice);
        for point in twin::points(&lattice) {
            for axis in (0..3).filter(|axis| point[*axis] + 1 < lattice.size[*axis]) {
                let mut next = point;
                next[axis] += 1;
                let ours = [
                    field.is_blocked_up(&lattice, point, axis),
                    field.is_blocked_down(&lattice, point, axis),
                ];
                let theirs = [
                    twin::is_blocked(&triangles, point, axis, true),
                    twin::is_blocked(&triangles, next, axis, false),
                ];
                for (ours, theirs) in ours.into_iter().zip(theirs) {
                    match theirs {
                        Some(theirs) => {
                            assert_eq!(ours, theirs, "round {round}, {point:?}, axis {axis}");
                            decided += 1;
                            open += u32::from(!theirs);
                        }
                        None => in_band += 1,
                    }
                }
            }
        }
    }
    println!("{decided} steps decided, {open} of them open; {in_band} too close to tell");
    assert!(open > 10_000 && decided - open > 5_000);
    assert!(in_band * 50 < decided);
}

#[test]
fn a_twin_of_another_model_is_told_from_ours() {
    let mut dice = Dice(3);
    let settings = at(10);
    let ours = model([dice.soup(20, true)]);
    let mut other = ours.clone();
    let mut surface = (*other.parts[0].surface).clone();
    for position in &mut surface.positions[..12] {
        position[2] += 0.1;
    }
    other.parts[0].surface = Arc::new(surface);
    let (lattice, field) =
        distance_field(&ours, &settings, crew(), &Progress::default()).expect("a field");
    let triangles = twin::triangles(&other, &settings, &lattice);
    let differs = twin::points(&lattice).any(|point| {
        point[2] + 1 < lattice.size[2]
            && twin::is_blocked(&triangles, point, 2, true)
                .is_some_and(|theirs| theirs != field.is_blocked_up(&lattice, point, 2))
    });
    assert!(differs);
}

#[test]
fn the_front_comes_to_the_points_that_the_twin_comes_to() {
    // Rows shorter and longer than a word, and of one word or two exactly.
    for (round, resolution) in [5, 20, 51, 52, 53, 56, 70, 108, 109, 120]
        .into_iter()
        .enumerate()
    {
        let mut dice = Dice(round as u64);
        let sides = [1.0, 0.4, 0.3];
        let shape = DAffine3::from_scale(DVec3::from_array(sides));
        let shells = (0..3).map(|_| {
            let turned = DAffine3::from_quat(dice.turn())
                * DAffine3::from_scale(DVec3::splat(0.3 + 0.3 * dice.roll()));
            placed(part(cube(1.0)), shape * turned)
        });
        let mut parts: Vec<_> = shells.collect();
        parts.push(placed(dice.soup(60, false), shape));
        let model = model(parts);
        let (lattice, field) =
            distance_field(&model, &at(resolution), crew(), &Progress::default()).expect("a field");
        let ours = front::propagate(&lattice, &field, &Progress::default()).expect("not stopped");
        let theirs = twin::outside(&lattice, |point, axis, is_up| {
            let mut low = point;
            if is_up {
                field.is_blocked_up(&lattice, low, axis)
            } else {
                low[axis] -= 1;
                field.is_blocked_down(&lattice, low, axis)
            }
        });
        let theirs_count = theirs.iter().filter(|is_outside| **is_outside).count();
        assert_eq!(ours.count(), theirs_count as u64, "resolution {resolution}");
        assert!(ours.count() < lattice.points(), "nothing is inside");
        for (point, theirs) in twin::points(&lattice).zip(theirs) {
            assert_eq!(ours.contains(&lattice, point), theirs, "{point:?}");
        }
    }
}

#[test]
fn what_is_near_is_what_the_twin_says() {
    let (mut seen, mut hidden) = (0, 0);
    for round in 0..6 {
        let mut dice = Dice(100 + round);
        let mut inner = dice.soup(60, false);
        inner.model_from_local = DAffine3::from_scale(DVec3::splat(0.35));
        let model = model([part(cube(1.0)), inner]);
        let settings = at(9 + 2 * round as u32);
        let outcome = culled(&model, &settings);
        let (lattice, field) =
            distance_field(&model, &settings, crew(), &Progress::default()).expect("a field");
        let outside =
            front::propagate(&lattice, &field, &Progress::default()).expect("not stopped");
        for triangle in twin::triangles(&model, &settings, &lattice) {
            let points = twin::points(&lattice).filter(|point| outside.contains(&lattice, *point));
            let (part, number) = triangle.number;
            if let Some(theirs) = twin::is_near(&triangle, points) {
                assert_eq!(outcome.parts[part].is_seen(number), theirs, "{triangle:?}");
                seen += u32::from(theirs);
                hidden += u32::from(!theirs);
            }
        }
    }
    assert!(seen > 50 && hidden > 50, "{seen} seen, {hidden} hidden");
}

// The guarantee.

/// Lets a ball of the gap's diameter come from outside, straight or by a walk at random, until it touches: what it
/// touches must stay. Returns how often it touched.
fn roll_ball(model: &Model, settings: &InteriorCulling, balls: usize, seed: u64) -> usize {
    let outcome = culled(model, settings);
    let triangles: Vec<_> = model
        .parts
        .iter()
        .enumerate()
        .flat_map(|(number, part)| {
            part.corners()
                .map(|corners| corners.map(|corner| part.place(corner)))
                .enumerate()
                .map(move |(at, corners)| (number, at, corners))
                .collect::<Vec<_>>()
        })
        .collect();
    // Its size, but for what the lattice's own rounding leaves open.
    let radius = outcome.lattice.gap() / 2.0;
    let nearest = |place: DVec3| {
        triangles
            .iter()
            .map(|(part, at, corners)| (twin::distance(place, *corners), *part, *at))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .expect("a triangle")
    };
    let mut dice = Dice(seed);
    let mut touched = 0;
    for _ in 0..balls {
        let mut place = dice.way() * 6.0;
        // At a triangle, so that it touches that or another.
        let (_, _, [a, b, c]) = triangles[(dice.roll() * triangles.len() as f64) as usize];
        let mut way = ((a + b + c) / 3.0 - place).normalize();
        for step in 0..400 {
            let (distance, part, at) = nearest(place);
            let free = distance - radius;
            if free < 1e-9 {
                assert!(
                    outcome.parts[part].is_seen(at),
                    "a ball at {place} touches triangle {at} of part {part}, which is gone"
                );
                touched += 1;
                // Back off, and on another way.
                place -= way * radius * 0.5 * dice.roll();
                way = dice.way();
                if nearest(place).0 < radius {
                    break;
                }
                continue;
            }
            place += way * free;
            if place.length() > 8.0 {
                break;
            }
            if step % 40 == 39 {
                way = dice.way();
            }
        }
    }
    touched
}

#[test]
fn what_a_ball_from_outside_touches_stays() {
    let mut touched = 0;
    for round in 0..8 {
        let mut dice = Dice(200 + round);
        let model = model([dice.soup(60, true)]);
        touched += roll_ball(&model, &at(8 + 5 * round as u32), 300, round);
    }
    println!("touched {touched} times");
    assert!(touched > 3000);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_a_ball_touches_stays_for_any_soup(seed: u64, triangles in 1usize..80, resolution in 1u32..40) {
        let mut dice = Dice(seed);
        let model = model([dice.soup(triangles, true)]);
        let touched = roll_ball(&model, &at(resolution), 25, seed);
        prop_assert!(touched >= 25, "touched {} times", touched);
    }
}

#[test]
fn what_a_ball_touches_in_a_room_stays_when_it_gets_in_and_the_room_is_hidden_when_nothing_does() {
    let resolution = 40;
    let mut dice = Dice(5);
    for _ in 0..12 {
        // A cell is 1/40 of the longest side, which turning lengthens.
        let turned = DAffine3::from_quat(dice.turn());
        let with_slit = |slit: f64| {
            let mut model = model([room_with_slit(1.0, slit as f32), two_sided(part(cube(0.5)))]);
            model
                .parts
                .iter_mut()
                .for_each(|part| part.model_from_local = turned);
            model
        };
        let lattice = culled(&with_slit(0.0), &at(resolution)).lattice;
        let cell = lattice.gap() / 3f64.sqrt();
        // Just wide enough for the ball: wherever the lattice lies, what is inside is seen.
        let outcome = culled(&with_slit(cell * 3f64.sqrt() * 1.0001), &at(resolution));
        assert_eq!(outcome.parts[1], Verdict::Seen);
        // A crack narrower than what is sealed lets nothing in.
        for crack in [0.0, 0.05, 0.115] {
            let outcome = culled(&with_slit(lattice.spacing * crack), &at(resolution));
            assert_eq!(outcome.parts[1], Verdict::Hidden, "{crack} spacings");
        }
    }
}

// Hard cases.

#[test]
fn an_open_box_shows_what_is_in_it_and_a_closed_one_does_not() {
    for resolution in [16, 64, 100] {
        let mut open = cube(1.0);
        open.triangles.drain(6..8);
        let shows = model([two_sided(part(open)), part(cube(0.4))]);
        let outcome = culled(&shows, &at(resolution));
        assert_eq!(outcome.parts[0], Verdict::Seen);
        assert_ne!(outcome.parts[1], Verdict::Hidden);
        assert_seen_stays(&shows, &outcome);

        let hides = model([part(cube(1.0)), part(cube(0.4))]);
        let outcome = culled(&hides, &at(resolution));
        assert_eq!(outcome.parts, [Verdict::Seen, Verdict::Hidden]);
    }
}

#[test]
fn of_nested_shells_the_outermost_stays() {
    let shells = (1..=5).map(|i| part(cube(0.2 * i as f32)));
    let outcome = culled(&model(shells), &at(64));
    let hidden = [0, 1, 2, 3].map(|_| Verdict::Hidden);
    assert_eq!(outcome.parts[..4], hidden);
    assert_eq!(outcome.parts[4], Verdict::Seen);
}

#[test]
fn parts_that_touch_close_each_other() {
    // A box without a lid, and the lid on it: nothing is shared, and neither is closed.
    let mut tray = cube(1.0);
    let lid: Vec<_> = tray.triangles.drain(6..8).collect();
    let lid = Surface {
        positions: tray.positions.clone(),
        triangles: lid,
    };
    let parts = |lid| model([two_sided(part(tray.clone())), lid, part(cube(0.4))]);
    let mut dice = Dice(1);
    for resolution in [16, 33, 100] {
        let turned = DAffine3::from_quat(dice.turn());
        let mut closed = parts(two_sided(part(lid.clone())));
        closed
            .parts
            .iter_mut()
            .for_each(|part| part.model_from_local = turned);
        assert_eq!(culled(&closed, &at(resolution)).parts[2], Verdict::Hidden);
        // Lifted by a hundredth of a spacing it still closes.
        let spacing = culled(&closed, &at(resolution)).lattice.spacing;
        let lift = DAffine3::from_translation(DVec3::Y * spacing * 0.01);
        closed.parts[1].model_from_local = turned * lift;
        assert_eq!(culled(&closed, &at(resolution)).parts[2], Verdict::Hidden);
    }
}

#[test]
fn a_wall_of_slivers_and_huge_triangles_is_a_wall() {
    // The wall at +z as a fan of 500 slivers from a corner, the others as they are.
    let mut walls = cube(1.0);
    walls.triangles.truncate(10);
    let count = 500;
    let mut fan = Surface {
        positions: vec![[-1.0, -1.0, 1.0]],
        triangles: Vec::new(),
    };
    for i in 0..=count {
        let along = -1.0 + 2.0 * i as f32 / count as f32;
        fan.positions.push([1.0, along, 1.0]);
    }
    for i in 0..=count {
        let along = 1.0 - 2.0 * i as f32 / count as f32;
        fan.positions.push([along, 1.0, 1.0]);
    }
    for i in 1..fan.positions.len() as u32 - 1 {
        fan.triangles.push([0, i, i + 1]);
    }
    for resolution in [16, 64, 256] {
        let model = model([part(joined([walls.clone(), fan.clone()])), part(cube(0.9))]);
        let outcome = culled(&model, &at(resolution));
        if resolution > 16 {
            assert_eq!(outcome.parts[1], Verdict::Hidden, "resolution {resolution}");
        }
        assert_seen_stays(&model, &outcome);
    }
}

#[test]
fn a_plane_without_thickness_stays_and_hides_what_is_below_it_from_nobody() {
    let plane = Surface {
        positions: vec![
            [-1.0, 0.0, -1.0],
            [1.0, 0.0, -1.0],
            [1.0, 0.0, 1.0],
            [-1.0, 0.0, 1.0],
        ],
        triangles: vec![[0, 2, 1], [0, 3, 2]],
    };
    let model = model([
        part(plane),
        placed(part(cube(0.1)), DAffine3::from_translation(DVec3::NEG_Y)),
    ]);
    for mode in [InteriorMode::Conservative, InteriorMode::Sampled] {
        let outcome = culled(&model, &InteriorCulling { mode, ..at(32) });
        match mode {
            InteriorMode::Conservative => assert_eq!(outcome.parts, [Verdict::Seen, Verdict::Seen]),
            // The paper's extraction reads surfaces between an outside point and an inside one; a plane has none.
            InteriorMode::Sampled => assert_eq!(outcome.parts[0], Verdict::Hidden),
        }
    }
}

#[test]
fn one_flat_triangle_and_one_that_is_a_point_stay() {
    for corners in [
        [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [[3.0; 3], [3.0; 3], [3.0; 3]],
        [[0.0; 3], [0.0, 5.0, 0.0], [0.0, 2.5, 0.0]],
    ] {
        let single = Surface {
            positions: corners.to_vec(),
            triangles: vec![[0, 1, 2]],
        };
        for resolution in [1, 16, 300] {
            let outcome = culled(&model([part(single.clone())]), &at(resolution));
            assert_eq!(outcome.parts, [Verdict::Seen], "{corners:?}");
        }
    }
}

#[test]
fn mirrored_and_unevenly_scaled_nodes_face_the_right_way() {
    let scales = [
        DVec3::new(-1.0, 1.0, 1.0),
        DVec3::new(2.0, -0.1, 1.0),
        DVec3::new(-3.0, -1.0, -0.2),
        DVec3::new(1.0, 5.0, 0.2),
    ];
    let mut dice = Dice(9);
    for scale in scales {
        let shape = DAffine3::from_quat(dice.turn()) * DAffine3::from_scale(scale);
        let closed = model([
            placed(part(cube(1.0)), shape),
            placed(part(cube(0.5)), shape),
        ]);
        let outcome = culled(&closed, &at(400));
        assert_eq!(outcome.parts, [Verdict::Seen, Verdict::Hidden], "{scale}");
        // Turned inside out it is seen through, and the far walls' inner faces show.
        let open = model([
            placed(part(inside_out(cube(1.0))), shape),
            placed(part(cube(0.5)), shape),
        ]);
        let outcome = culled(&open, &at(400));
        assert_eq!(outcome.parts[1], Verdict::Seen, "{scale}");
        assert_seen_stays(&open, &outcome);
    }
}

#[test]
fn what_is_seen_through_the_back_of_one_sided_faces_stays() {
    let mut dice = Dice(77);
    for round in 0..10 {
        let turned = DAffine3::from_quat(dice.turn());
        // A shell that shows its inside only: from outside, all of the inner box and the shell's far side are seen.
        let mut room = model([
            part(inside_out(cube(1.0))),
            part(cube(0.3 + 0.04 * round as f32)),
        ]);
        room.parts
            .iter_mut()
            .for_each(|part| part.model_from_local = turned);
        let outcome = culled(&room, &at(24 + 7 * round));
        assert_seen_stays(&room, &outcome);
        assert_eq!(outcome.parts, [Verdict::Seen, Verdict::Seen]);
        let closed = InteriorCulling {
            faces: InteriorFaces::TwoSided,
            ..at(64)
        };
        assert_eq!(culled(&room, &closed).parts[1], Verdict::Hidden);
    }
}

#[test]
fn transparent_parts_are_open_or_closed_as_is_asked() {
    let glass = Part {
        is_transparent: true,
        ..part(cube(1.0))
    };
    let model = model([glass, part(cube(0.4)), part(cube(0.2))]);
    let outcome = culled(&model, &at(64));
    assert_eq!(
        outcome.parts,
        [Verdict::Seen, Verdict::Seen, Verdict::Hidden]
    );
    let closed = InteriorCulling {
        transparent: InteriorTransparent::Closed,
        ..at(64)
    };
    let outcome = culled(&model, &closed);
    assert_eq!(
        outcome.parts,
        [Verdict::Seen, Verdict::Hidden, Verdict::Hidden]
    );
}

#[test]
fn far_from_the_origin_the_verdicts_are_the_same() {
    let mut dice = Dice(4);
    let mut near = model([part(cube(1.0)), dice.soup(80, false), part(cube(0.4))]);
    near.parts[1].model_from_local = DAffine3::from_scale(DVec3::splat(0.7));
    let mut far = near.clone();
    for part in &mut far.parts {
        // A power of two, so that nothing is rounded on the way.
        part.model_from_local.translation += DVec3::new(1048576.0, -2097152.0, 1048576.0);
    }
    let (near, far) = (culled(&near, &at(128)), culled(&far, &at(128)));
    assert_eq!(near.parts, far.parts);
    assert_eq!(near.outside_points, far.outside_points);
    assert_eq!(near.parts[2], Verdict::Hidden);
}

#[test]
fn a_model_smaller_than_the_rounding_of_where_it_is_stays() {
    for (far, size) in [(1e9, 1e-4), (1e9, 1e-9), (1e12, 1.0), (1e3, 0.0)] {
        for grid in [
            InteriorGrid::Resolution(3),
            InteriorGrid::Resolution(256),
            InteriorGrid::Gap(1e6),
        ] {
            let mut tiny = model([part(cube(1.0))]);
            tiny.parts[0].model_from_local =
                DAffine3::from_translation(DVec3::new(far, -far, 0.3 * far))
                    * DAffine3::from_scale(DVec3::splat(size));
            let settings = InteriorCulling {
                grid,
                ..Default::default()
            };
            let outcome = culled(&tiny, &settings);
            assert_eq!(outcome.parts, [Verdict::Seen], "{size} at {far}, {grid:?}");
        }
    }
}

#[test]
fn coincident_faces_neither_leak_nor_vanish() {
    // Two boxes in the same place, and a third whose face lies in one of theirs.
    let beside = cuboid([1.0, -1.0, -1.0], [2.0, 1.0, 1.0]);
    let model = model([
        part(cube(1.0)),
        part(cube(1.0)),
        part(beside),
        part(cube(0.3)),
    ]);
    let outcome = culled(&model, &at(75));
    assert_eq!(outcome.parts[0], outcome.parts[1]);
    assert_ne!(outcome.parts[0], Verdict::Hidden);
    assert_ne!(outcome.parts[2], Verdict::Hidden);
    assert_eq!(outcome.parts[3], Verdict::Hidden);
    assert_seen_stays(&model, &outcome);
}

#[test]
fn a_coarse_sampled_grid_takes_what_is_seen_and_a_conservative_one_does_not() {
    // Rods thinner than a spacing, around a box.
    let mut parts = vec![part(cube(0.5))];
    for i in 0..40 {
        let along = -0.95 + 0.05 * i as f32;
        parts.push(part(cuboid([along, -1.0, 0.7], [along + 0.01, 1.0, 0.71])));
    }
    let model = model(parts);
    let count = |mode| {
        let outcome = culled(&model, &InteriorCulling { mode, ..at(16) });
        let gone = hits(&model, 3000, 2)
            .iter()
            .filter(|(part, triangle)| !outcome.parts[*part].is_seen(*triangle))
            .count();
        println!("{mode:?}: {gone} rays meet what is gone");
        gone
    };
    assert!(count(InteriorMode::Sampled) > 100);
    assert_eq!(count(InteriorMode::Conservative), 0);
}

#[test]
fn a_node_stays_whole_when_any_of_it_is_seen() {
    let mut model = model([part(cube(1.0)), part(cube(0.5)), part(cube(0.2))]);
    model.parts[1].node = 0;
    let settings = InteriorCulling {
        level: InteriorLevel::Node,
        ..at(64)
    };
    let outcome = culled(&model, &settings);
    assert_eq!(
        outcome.parts,
        [Verdict::Seen, Verdict::Seen, Verdict::Hidden]
    );
}

#[test]
fn verdicts_do_not_depend_on_threads() {
    let mut dice = Dice(8);
    let model = model([part(cube(0.8)), dice.soup(3000, false)]);
    for mode in [InteriorMode::Sampled, InteriorMode::Conservative] {
        let settings = InteriorCulling { mode, ..at(60) };
        let with = |threads| {
            let threads = NonZero::new(threads).expect("some");
            cull(&model, &settings, threads, &Progress::default())
                .expect("it can be culled")
                .parts
        };
        assert_eq!(with(1), with(2));
        assert_eq!(with(1), with(7));
    }
}

#[test]
fn a_gap_is_a_resolution() {
    let model = model([part(cube(1.0))]);
    let by_cells = culled(&model, &at(100)).lattice;
    assert!((by_cells.gap() - 2.0 / 100.0 * 3f64.sqrt()).abs() < 1e-12);
    let by_gap = InteriorCulling {
        grid: InteriorGrid::Gap(by_cells.gap() as f32),
        ..Default::default()
    };
    let by_gap = culled(&model, &by_gap).lattice;
    assert!((by_gap.spacing / by_cells.spacing - 1.0).abs() < 1e-6);
}

#[test]
fn what_cannot_be_culled_says_why_and_what_would_help() {
    let refused = |model: &Model, settings: &InteriorCulling| {
        cull(model, settings, crew(), &Progress::default()).expect_err("it cannot be culled")
    };
    assert_eq!(
        refused(&Model::default(), &at(10)),
        InteriorError::NoTriangles
    );
    let mut nowhere = cube(1.0);
    nowhere.positions[3][1] = f32::NAN;
    let nowhere = model([part(cube(1.0)), part(nowhere)]);
    assert_eq!(
        refused(&nowhere, &at(10)),
        InteriorError::NotFinite { part: 1, node: 1 }
    );
    let cube = model([part(cube(1.0))]);
    assert_eq!(refused(&cube, &at(0)), InteriorError::Resolution(0));
    assert_eq!(
        refused(&cube, &at(100_000)),
        InteriorError::Resolution(100_000)
    );
    for gap in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let settings = InteriorCulling {
            grid: InteriorGrid::Gap(gap),
            ..Default::default()
        };
        assert!(matches!(refused(&cube, &settings), InteriorError::Gap(_)));
    }
    let fine = InteriorCulling {
        grid: InteriorGrid::Gap(1e-5),
        memory_mib: 100,
        ..Default::default()
    };
    let InteriorError::Memory {
        smallest_gap,
        resolution,
        allowed_mib: 100,
        ..
    } = refused(&cube, &fine)
    else {
        panic!("it takes too much memory");
    };
    // What is named fits, and is the finest that does.
    let fits = |grid| {
        let settings = InteriorCulling {
            grid,
            ..fine.clone()
        };
        distance_field(&cube, &settings, crew(), &Progress::default()).is_ok()
    };
    assert!(fits(InteriorGrid::Gap(smallest_gap as f32 * 1.000_001)));
    assert!(fits(InteriorGrid::Resolution(resolution)));
    assert!(!fits(InteriorGrid::Resolution(resolution + 1)));
    let stopped = Progress::default();
    stopped.cancel();
    assert_eq!(
        cull(&cube, &at(10), crew(), &stopped).err(),
        Some(InteriorError::Cancelled)
    );
}

#[test]
fn triangles_of_vertices_that_are_not_there_are_as_if_they_were_not() {
    let mut broken = cube(1.0);
    broken.triangles.insert(0, [0, 1, 99]);
    broken.positions.push([f32::NAN; 3]);
    let model = model([part(broken)]);
    let outcome = culled(&model, &at(16));
    assert!(!outcome.parts[0].is_seen(0));
    assert_eq!(outcome.parts[0].count(13), 12);
    assert_seen_stays_but_the_first(&model, &outcome);
}

fn assert_seen_stays_but_the_first(model: &Model, outcome: &Outcome) {
    // `corners` leaves the broken one out, so that numbers are one less.
    for (part, triangle) in hits(model, 500, 3) {
        assert!(outcome.parts[part].is_seen(triangle + 1));
    }
}

#[test]
fn progress_goes_through_the_stages() {
    let progress = Progress::default();
    assert_eq!(progress.now(), (Stage::Snapping, 0.0));
    cull(&model([part(cube(1.0))]), &at(32), crew(), &progress).expect("it can be culled");
    assert_eq!(progress.now(), (Stage::Extraction, 1.0));
}
