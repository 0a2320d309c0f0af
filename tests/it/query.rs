//! Queries of the surface, against hard cases known by hand and against brute force.

use bevy::{
    asset::AssetPlugin,
    ecs::system::RunSystemOnce,
    math::{DVec2, DVec3},
    prelude::*,
};
use bevy_skyline::terrain::{
    HeightField, HeightFieldHitF64, HeightFieldPlugin, HitSide, Terrain, TerrainQuery,
};
use proptest::prelude::*;

use crate::height_field::hash;

// ---------------------------------------------------------------------------------------------
// Fields

fn plane(size: UVec2, texel_m: f32, f: impl Fn(f32, f32) -> f32) -> HeightField {
    let samples = (0..size.y)
        .flat_map(|z| (0..size.x).map(move |x| (x, z)))
        .map(|(x, z)| f(x as f32, z as f32))
        .collect();
    HeightField::from_f32(size, texel_m, samples).unwrap()
}

fn flat(size: u32, height: f32) -> HeightField {
    plane(UVec2::splat(size), 1.0, |_, _| height)
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    Noise,
    Cliffs,
    Smooth,
    Flat,
    Spike,
}

const KINDS: [Kind; 5] = [
    Kind::Noise,
    Kind::Cliffs,
    Kind::Smooth,
    Kind::Flat,
    Kind::Spike,
];

/// A 16-bit field whose heights are of the order of a few of its cells.
fn field(kind: Kind, size: UVec2, texel_m: f32, seed: u32) -> HeightField {
    let codes = (0..size.x * size.y)
        .map(|index| {
            let (x, z) = ((index % size.x) as f32, (index / size.x) as f32);
            match kind {
                Kind::Noise => hash(index ^ hash(seed)) as u16,
                Kind::Cliffs => u16::MAX * (hash(index ^ hash(seed)) & 1) as u16,
                Kind::Smooth => {
                    let phase = seed as f32;
                    (32768.0 + 15000.0 * (x * 0.7 + phase).sin() + 15000.0 * (z * 0.45).cos())
                        as u16
                }
                Kind::Flat => 40000,
                Kind::Spike if index == hash(seed) % (size.x * size.y) => u16::MAX,
                Kind::Spike => 100,
            }
        })
        .collect();
    HeightField::from_u16(size, texel_m, (-texel_m, 4.0 * texel_m), codes).unwrap()
}

// ---------------------------------------------------------------------------------------------
// Brute force: every cell, no pyramid, no walk, roots by bisection

#[derive(Clone, Copy, Debug, PartialEq)]
enum Met {
    Nothing,
    Surface(f64),
    Wall(f64),
}

impl Met {
    fn distance(self) -> Option<f64> {
        match self {
            Met::Nothing => None,
            Met::Surface(t) | Met::Wall(t) => Some(t),
        }
    }

    fn same_kind(self, other: Met) -> bool {
        core::mem::discriminant(&self) == core::mem::discriminant(&other)
    }
}

/// The definition, cell by cell.
fn brute_force(field: &HeightField, o: DVec3, d: DVec3, max: f64) -> Met {
    let texel = f64::from(field.texel_m());
    let cells = field.cells();
    let d = d.normalize();
    let clip = |o: f64, d: f64, lo: f64, hi: f64| -> Option<(f64, f64)> {
        if d == 0.0 {
            return (lo..=hi).contains(&o).then_some((-1e300, 1e300));
        }
        let (a, b) = ((lo - o) / d, (hi - o) / d);
        Some((a.min(b), a.max(b)))
    };
    let mut spans = Vec::new();
    for j in 0..cells.y {
        for i in 0..cells.x {
            let x = clip(o.x, d.x, f64::from(i) * texel, f64::from(i + 1) * texel);
            let z = clip(o.z, d.z, f64::from(j) * texel, f64::from(j + 1) * texel);
            if let (Some(x), Some(z)) = (x, z) {
                let span = (x.0.max(z.0).max(0.0), x.1.min(z.1).min(max));
                if span.0 <= span.1 {
                    spans.push((span, i, j));
                }
            }
        }
    }
    spans.sort_by(|a, b| a.0.0.total_cmp(&b.0.0).then(a.0.1.total_cmp(&b.0.1)));
    let Some(&((start, _), i, j)) = spans.first() else {
        return Met::Nothing;
    };

    let clearance = |i: u32, j: u32, t: f64| {
        let p = o + d * t;
        let (u, v) = (p.x / texel - f64::from(i), p.z / texel - f64::from(j));
        let h = |a: u32, b: u32| field.sample_m(i + a, j + b);
        let h = h(0, 0)
            + u * (h(1, 0) - h(0, 0))
            + v * (h(0, 1) - h(0, 0))
            + u * v * (h(0, 0) + h(1, 1) - h(1, 0) - h(0, 1));
        p.y - h
    };
    let mut above = clearance(i, j, start) > 0.0;
    if !above && start > 0.0 {
        return Met::Wall(start);
    }
    let mut done = start;
    for ((from, to), i, j) in spans {
        let from = from.max(done);
        if from > to {
            continue;
        }
        // A vertical ray never leaves its cell: no further than where nothing more can happen.
        let to = to.min(from + 1e3 * (1.0 + o.y.abs() + texel));
        done = to;
        // The quadratic through three values has its vertex where the ray is closest to parallel.
        let f = |t: f64| clearance(i, j, t);
        let (f0, f1, f2) = (f(from), f(0.5 * (from + to)), f(to));
        let (a, b) = (2.0 * (f0 - 2.0 * f1 + f2), -3.0 * f0 + 4.0 * f1 - f2);
        let mut stops = vec![from];
        let vertex = -b / (2.0 * a);
        if vertex > 0.0 && vertex < 1.0 {
            stops.push(from + vertex * (to - from));
        }
        stops.push(to);
        for piece in stops.windows(2) {
            let (mut p, mut q) = (piece[0], piece[1]);
            let falls_below = f(q) <= 0.0;
            if above && falls_below {
                for _ in 0..200 {
                    let middle = 0.5 * (p + q);
                    if f(middle) > 0.0 {
                        p = middle;
                    } else {
                        q = middle;
                    }
                }
                return Met::Surface(q);
            }
            above |= !falls_below;
        }
    }
    Met::Nothing
}

fn met(hit: Option<HeightFieldHitF64>) -> Met {
    match hit {
        None => Met::Nothing,
        Some(hit) if hit.side == HitSide::Wall => Met::Wall(hit.distance),
        Some(hit) => Met::Surface(hit.distance),
    }
}

/// How a ray's answer compares with brute force.
#[derive(PartialEq, Debug)]
enum Verdict {
    Agree(Met),
    /// A hair's breadth to the side changes the answer: both are right.
    Ambiguous,
    Differ(String),
}

/// The guard band: moving the ray by 1e-9 of the heights and coordinates in play along any axis, a
/// million times the rounding of a double, must not change what is met, and where by no more.
fn compare(field: &HeightField, truth: &HeightField, o: DVec3, d: DVec3, max: f64) -> Verdict {
    let (low, high) = field.data_range_m();
    let texel = f64::from(field.texel_m());
    let extent = texel * field.size().as_dvec2().length();
    let size = o.abs().max_element() + low.abs() + high.abs() + extent;
    let guard = 1e-9 * size;
    let got = met(field.ray_cast_f64(o, d, max));
    let exact = brute_force(truth, o, d, max);
    let (mut nearest, mut farthest) = (f64::INFINITY, 0.0f64);
    for corner in 0..10 {
        let sign = |bit: u32| {
            if corner >> bit & 1 == 0 {
                guard
            } else {
                -guard
            }
        };
        // More upward than sideways: the steepest slopes here turn one into several of the other,
        // and where a ray runs along a border, into many.
        let offset = match corner {
            8 => DVec3::Y * 1000.0 * guard,
            9 => DVec3::Y * -1000.0 * guard,
            _ => DVec3::new(sign(0), 30.0 * sign(1), sign(2)),
        };
        let moved = brute_force(truth, o + offset, d, max);
        if !moved.same_kind(exact) {
            return Verdict::Ambiguous;
        }
        if let (Some(t), true) = (moved.distance(), corner < 8) {
            nearest = nearest.min(t);
            farthest = farthest.max(t);
        }
    }
    let differ = |why: &str| {
        Verdict::Differ(format!(
            "{why}: got {got:?}, expected {exact:?} ({nearest} to {farthest}); ray from {o} along \
             {d} up to {max}; field {:?} of texels {texel}",
            field.size()
        ))
    };
    if !got.same_kind(exact) {
        return differ("kind");
    }
    if let (Some(got_t), Some(exact_t)) = (got.distance(), exact.distance()) {
        let spread = farthest - nearest;
        if spread > 1e-3 * size || exact_t < nearest - guard || exact_t > farthest + guard {
            // So small a move shifts the hit far: it is a grazing one, or another.
            return Verdict::Ambiguous;
        }
        if (got_t - exact_t).abs() > spread + guard {
            return differ("distance");
        }
    }
    Verdict::Agree(got)
}

/// Rays of every awkward sort around and in a field.
fn awkward_ray(field: &HeightField, seed: u32) -> (DVec3, DVec3) {
    let mut state = seed;
    let mut next = move || {
        state = hash(state.wrapping_add(0x1234_5679));
        state
    };
    let texel = f64::from(field.texel_m());
    let size = field.size();
    let (low, high) = field.data_range_m();
    let span = (high - low).max(texel);
    let mut unit = {
        let mut next = next;
        move || f64::from(next()) / f64::from(u32::MAX)
    };
    let extent = field.cells().as_dvec2() * texel;
    let mut anywhere = || {
        DVec3::new(
            extent.x * (1.6 * unit() - 0.3),
            low + span * (2.0 * unit() - 0.5),
            extent.y * (1.6 * unit() - 0.3),
        )
    };
    let (a, b) = (anywhere(), anywhere());
    let mut sample = |lift: f64| {
        let (i, j) = (next() % size.x, next() % size.y);
        DVec3::new(
            f64::from(i) * texel,
            field.sample_m(i, j) + lift,
            f64::from(j) * texel,
        )
    };
    match seed % 12 {
        // From anywhere, and from above, to anywhere.
        0 => (a, b - a),
        1 | 2 => (
            a.with_y(high + 0.5 * span),
            b.with_y(low) - a.with_y(high + 0.5 * span),
        ),
        // Along an axis.
        3 => (a, DVec3::X * (b.x - a.x).signum()),
        4 => (a, DVec3::Z * (b.z - a.z).signum()),
        5 => (a, DVec3::Y * (b.y - a.y).signum()),
        // Through a sample; along a border between cells.
        6 => (a, sample(0.0) - a),
        7 => {
            let on = sample(0.0);
            (
                DVec3::new(a.x, a.y, on.z),
                DVec3::new(b.x - a.x, b.y - a.y, 0.0),
            )
        }
        8 => {
            let on = sample(0.0);
            (
                DVec3::new(on.x, a.y, a.z),
                DVec3::new(0.0, b.y - a.y, b.z - a.z),
            )
        }
        // From sample to sample, just above, and level at the height of a sample.
        9 => (sample(1e-3 * span), sample(2e-3 * span) - sample(0.0)),
        10 => {
            let (from, to) = (sample(1e-6 * span), sample(1e-6 * span));
            (from, to - from)
        }
        // Diagonally through corners.
        _ => {
            let from = sample(0.5 * span);
            let sign = |bit: u32| if seed >> bit & 1 == 0 { 1.0 } else { -1.0 };
            (
                from,
                DVec3::new(sign(8), 0.4 * sign(9) * unit_of(seed), sign(10)),
            )
        }
    }
}

fn unit_of(seed: u32) -> f64 {
    f64::from(hash(seed)) / f64::from(u32::MAX)
}

#[derive(Default, Debug)]
struct Tally {
    surface: usize,
    wall: usize,
    nothing: usize,
    ambiguous: usize,
}

impl Tally {
    fn add(&mut self, verdict: Verdict) {
        match verdict {
            Verdict::Agree(Met::Surface(_)) => self.surface += 1,
            Verdict::Agree(Met::Wall(_)) => self.wall += 1,
            Verdict::Agree(Met::Nothing) => self.nothing += 1,
            Verdict::Ambiguous => self.ambiguous += 1,
            Verdict::Differ(why) => panic!("{why}"),
        }
    }
}

#[test]
fn rays_agree_with_brute_force_on_every_kind_of_field() {
    let sizes = [(2, 2), (2, 9), (9, 2), (3, 7), (5, 5), (17, 17), (33, 20)];
    let mut tally = Tally::default();
    let mut seed = 0;
    for (x, y) in sizes {
        for kind in KINDS {
            for texel_m in [0.001, 1.0, 30.87, 10_000.0] {
                seed += 1;
                let field = field(kind, UVec2::new(x, y), texel_m, seed);
                for ray in 0..100 {
                    let (o, d) = awkward_ray(&field, hash(seed * 100000 + ray));
                    let max = if ray % 5 == 0 {
                        3.0 * f64::from(texel_m)
                    } else {
                        f64::INFINITY
                    };
                    if d.length_squared() > 0.0 {
                        tally.add(compare(&field, &field, o, d, max));
                    }
                }
            }
        }
    }
    // A field whose pyramid is high enough to skip far.
    for kind in KINDS {
        let field = field(kind, UVec2::new(130, 97), 1.0, 7);
        for ray in 0..60 {
            let (o, d) = awkward_ray(&field, hash(ray));
            if d.length_squared() > 0.0 {
                tally.add(compare(&field, &field, o, d, f64::INFINITY));
            }
        }
    }
    println!("{tally:?}");
    // It must have compared something of each kind, and the guard band must be narrow: a third of
    // the rays are aimed at a sample or along a border, and lie in it by intention.
    assert!(tally.surface > 2500, "{tally:?}");
    assert!(tally.wall > 500, "{tally:?}");
    assert!(tally.nothing > 5000, "{tally:?}");
    assert!(tally.ambiguous < 2000, "{tally:?}");
}

#[test]
fn the_comparison_notices_a_wrong_surface() {
    let size = UVec2::new(9, 9);
    let good = field(Kind::Smooth, size, 1.0, 3);
    let mut bad = good.clone();
    bad.edit(URect::new(4, 4, 5, 5), |_, _, h| h + 0.5).unwrap();
    let wrong = (0..2000)
        .filter(|&seed| {
            let (o, d) = awkward_ray(&good, seed);
            d.length_squared() > 0.0
                && matches!(compare(&bad, &good, o, d, 1e9), Verdict::Differ(_))
        })
        .count();
    assert!(wrong > 10, "{wrong}");
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(3000) })]
    #[test]
    fn rays_agree_with_brute_force(
        (width, height) in (2u32..14, 2u32..14),
        kind in prop::sample::select(KINDS.to_vec()),
        seed: u32,
        ray: u32,
        from in prop::array::uniform3(-0.5f64..1.5),
        to in prop::array::uniform3(-0.5f64..1.5),
        given: bool,
    ) {
        let field = field(kind, UVec2::new(width, height), 2.0, seed);
        let (o, d) = if given {
            let scale = DVec3::new(2.0 * f64::from(width), 10.0, 2.0 * f64::from(height));
            let o = DVec3::from(from) * scale;
            (o, DVec3::from(to) * scale - o)
        } else {
            awkward_ray(&field, ray)
        };
        prop_assume!(d.length_squared() > 0.0);
        if let Verdict::Differ(why) = compare(&field, &field, o, d, f64::INFINITY) {
            prop_assert!(false, "{}", why);
        }
    }
}

#[test]
fn hits_lie_on_the_surface_and_face_the_ray() {
    let field = field(Kind::Noise, UVec2::new(33, 20), 2.0, 9);
    let mut checked = 0;
    for seed in 0..3000 {
        let (o, d) = awkward_ray(&field, seed);
        let Some(hit) = field.ray_cast_f64(o, d, f64::INFINITY) else {
            continue;
        };
        assert!((hit.normal.length() - 1.0).abs() < 1e-12);
        assert!((hit.point - (o + d.normalize() * hit.distance)).length() < 1e-9);
        let border = field.cells().as_dvec2() * 2.0;
        let xz = DVec2::new(hit.point.x, hit.point.z).clamp(DVec2::ZERO, border);
        let height = field.height_at_f64(xz).unwrap();
        match hit.side {
            HitSide::Surface => {
                assert!((height - hit.point.y).abs() < 1e-6, "{hit:?} {height}");
                let grid = xz / 2.0 - hit.cell.as_dvec2();
                assert!(grid.cmpge(DVec2::splat(-1e-6)).all());
                assert!(grid.cmple(DVec2::splat(1.0 + 1e-6)).all());
                assert!(hit.normal.y > 0.0);
            }
            HitSide::Wall => {
                assert!(hit.point.y <= height + 1e-9);
                assert_eq!(hit.normal.y, 0.0);
                assert!(hit.normal.dot(d) < 0.0);
            }
        }
        checked += 1;
    }
    assert!(checked > 1000, "{checked}");
}

// ---------------------------------------------------------------------------------------------
// Heights and normals

#[test]
fn height_is_bilinear_and_exact_at_samples() {
    let field = field(Kind::Noise, UVec2::new(5, 4), 3.0, 1);
    for j in 0..4 {
        for i in 0..5 {
            let p = DVec2::new(f64::from(i) * 3.0, f64::from(j) * 3.0);
            assert_eq!(field.height_at_f64(p), Some(field.sample_m(i, j)));
            assert_eq!(
                field.height_at(p.as_vec2()),
                Some(field.sample_m(i, j) as f32)
            );
        }
    }
    // The middle of a cell is the mean of its corners.
    let mean =
        (field.sample_m(1, 2) + field.sample_m(2, 2) + field.sample_m(1, 3) + field.sample_m(2, 3))
            / 4.0;
    assert!((field.height_at_f64(DVec2::new(4.5, 7.5)).unwrap() - mean).abs() < 1e-12);
}

#[test]
fn the_border_belongs_to_the_footprint_however_it_is_rounded() {
    for texel_m in [20.031, 30.87, 0.1, 1.0 / 3.0, 92.61, 69.847] {
        let field = plane(UVec2::new(41, 4), texel_m, |x, z| x + z);
        let extent = field.extent_m();
        assert_eq!(field.height_at(extent), Some(43.0));
        assert_eq!(field.height_at(Vec2::ZERO), Some(0.0));
        assert!(field.normal_at(extent).is_some());
        let exact = field.cells().as_dvec2() * f64::from(texel_m);
        assert_eq!(field.height_at_f64(exact), Some(43.0));
        assert_eq!(field.height_at(extent * 1.000_001), None);
        assert_eq!(field.height_at_f64(exact + 1e-9), None);
        assert_eq!(field.height_at(Vec2::new(-1e-6, 0.0)), None);
        assert_eq!(field.height_at(Vec2::new(0.0, extent.y * 1.000_001)), None);
    }
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert_eq!(flat(3, 0.0).height_at(Vec2::new(bad, 1.0)), None);
        assert_eq!(flat(3, 0.0).normal_at(Vec2::new(1.0, bad)), None);
    }
}

#[test]
fn normals_are_those_of_the_patch() {
    // A plane rising 2 m in 4 m along X and falling 1 m in 4 m along Z.
    let tilted = plane(UVec2::splat(5), 4.0, |x, z| 2.0 * x - z);
    let expected = Vec3::new(-0.5, 1.0, 0.25).normalize();
    for p in [Vec2::ZERO, Vec2::new(3.0, 9.0), Vec2::splat(16.0)] {
        assert!(tilted.normal_at(p).unwrap().abs_diff_eq(expected, 1e-6));
    }
    // A twisted patch: h = x·z, whose slope along X at (x, z) is z.
    let twisted = plane(UVec2::splat(2), 1.0, |x, z| x * z);
    for (x, z) in [(0.25, 0.5), (1.0, 1.0), (0.0, 0.75)] {
        let expected = Vec3::new(-z, 1.0, -x).normalize();
        assert!(
            twisted
                .normal_at(Vec2::new(x, z))
                .unwrap()
                .abs_diff_eq(expected, 1e-6)
        );
    }
}

// ---------------------------------------------------------------------------------------------
// Hard cases by name

fn cast(field: &HeightField, o: [f32; 3], d: [f32; 3]) -> Option<(f32, HitSide)> {
    field
        .ray_cast(o.into(), d.into(), f32::INFINITY)
        .map(|hit| (hit.distance, hit.side))
}

#[test]
fn straight_down_and_straight_up() {
    let field = field(Kind::Noise, UVec2::splat(5), 1.0, 4);
    for (x, z) in [(0.0, 0.0), (2.0, 2.0), (1.5, 2.25), (4.0, 4.0), (4.0, 0.5)] {
        let height = field.height_at(Vec2::new(x, z)).unwrap();
        let (distance, side) = cast(&field, [x, 100.0, z], [0.0, -3.0, 0.0]).unwrap();
        assert!((distance - (100.0 - height)).abs() < 1e-4);
        assert_eq!(side, HitSide::Surface);
        assert_eq!(cast(&field, [x, 100.0, z], [0.0, 1.0, 0.0]), None);
        assert_eq!(
            cast(&field, [x, -100.0, z], [0.0, 1.0, 0.0]),
            None,
            "one-sided"
        );
        assert_eq!(cast(&field, [x, -100.0, z], [0.0, -1.0, 0.0]), None);
    }
    assert_eq!(cast(&field, [4.001, 100.0, 2.0], [0.0, -1.0, 0.0]), None);
}

#[test]
fn eye_below_on_and_inside_the_surface() {
    let ground = flat(5, 2.0);
    // Inside, looking level, down and out through the wall: nothing.
    assert_eq!(cast(&ground, [2.0, 1.0, 2.0], [1.0, 0.0, 0.0]), None);
    assert_eq!(cast(&ground, [2.0, 1.0, 2.0], [1.0, -1.0, 0.3]), None);
    // Out through the surface, upward: nothing more to meet.
    assert_eq!(cast(&ground, [2.0, 1.0, 2.0], [1.0, 1.0, 0.0]), None);
    // On it.
    assert_eq!(cast(&ground, [2.0, 2.0, 2.0], [1.0, -1.0, 0.0]), None);
    assert_eq!(cast(&ground, [2.0, 2.0, 2.0], [1.0, 0.0, 0.0]), None);
    // From inside one hill, through the air, to the next.
    let hills = plane(UVec2::new(5, 2), 1.0, |x, _| {
        [0.0, 4.0, 0.0, 4.0, 0.0][x as usize]
    });
    let hit = hills
        .ray_cast(Vec3::new(1.0, 2.0, 0.5), Vec3::X, 100.0)
        .unwrap();
    assert!((hit.distance - 1.5).abs() < 1e-6, "{hit:?}");
    assert_eq!(hit.cell.x, 2);
    assert!(hit.normal.x < 0.0);
}

#[test]
fn walls_are_solid_down_to_minus_infinity() {
    let ground = flat(5, 2.0);
    for (o, d, normal) in [
        ([-3.0, 1.0, 2.0], [1.0, 0.0, 0.0], Vec3::NEG_X),
        ([7.0, 1.0, 2.0], [-1.0, 0.0, 0.0], Vec3::X),
        ([2.0, 1.0, -3.0], [0.0, 0.0, 1.0], Vec3::NEG_Z),
        ([2.0, 1.0, 7.0], [0.0, 0.0, -1.0], Vec3::Z),
        ([-3.0, -1e6, 2.0], [1.0, 0.0, 0.0], Vec3::NEG_X),
        // Exactly at the border's height is at the surface: a wall.
        ([-3.0, 2.0, 2.0], [1.0, 0.0, 0.0], Vec3::NEG_X),
    ] {
        let hit = ground
            .ray_cast(Vec3::from(o), Vec3::from(d), f32::INFINITY)
            .unwrap();
        assert!((hit.distance - 3.0).abs() < 1e-6);
        assert_eq!((hit.side, hit.normal), (HitSide::Wall, normal));
    }
    // Over the border and down onto the surface.
    let (distance, side) = cast(&ground, [-1.0, 3.0, 2.0], [3.0, -1.0, 0.0]).unwrap();
    assert!((distance - 10f32.sqrt()).abs() < 1e-6);
    assert_eq!(side, HitSide::Surface);
    // Past it, above it, away from it.
    assert_eq!(cast(&ground, [-3.0, 1.0, 4.1], [1.0, 0.0, 0.0]), None);
    assert_eq!(cast(&ground, [-3.0, 2.1, 2.0], [1.0, 0.0, 0.0]), None);
    assert_eq!(cast(&ground, [-3.0, 1.0, 2.0], [-1.0, 0.0, 0.0]), None);
    // From outside, up past the wall into the air over the field: the wall is in the way.
    assert_eq!(
        cast(&ground, [-1.0, 0.0, 2.0], [1.0, 1.0, 0.0]).unwrap().1,
        HitSide::Wall
    );
}

#[test]
fn along_cell_borders_and_through_samples() {
    // A ridge along the border x = 2: 3 m high, falling to 0.
    let ridge = plane(UVec2::new(5, 5), 1.0, |x, _| 3.0 - 1.5 * (x - 2.0).abs());
    // Along the ridge, just above, level with it, and dipping into it at 1e-6 slope.
    assert_eq!(cast(&ridge, [2.0, 3.001, -1.0], [0.0, 0.0, 1.0]), None);
    assert_eq!(
        cast(&ridge, [2.0, 3.0, -1.0], [0.0, 0.0, 1.0]).unwrap(),
        (1.0, HitSide::Wall)
    );
    let hit = ridge
        .ray_cast_f64(
            DVec3::new(2.0, 3.0 + 2e-6, 0.0),
            DVec3::new(0.0, -1e-6, 1.0),
            1e9,
        )
        .unwrap();
    assert!((hit.distance - 2.0).abs() < 1e-8, "{hit:?}");
    // Across the ridge at 1e-6 slope, touching its crest.
    let hit = ridge
        .ray_cast_f64(
            DVec3::new(0.0, 3.0 + 1e-6, 2.0),
            DVec3::new(1.0, -1e-6, 0.0),
            1e9,
        )
        .unwrap();
    assert!((hit.distance - 1.0).abs() < 1.01 && hit.point.y <= 3.0 + 1e-6);
    // Level, 1e-9 below and above the crest.
    let across = |y: f64| ridge.ray_cast_f64(DVec3::new(-1.0, y, 2.0), DVec3::X, 1e9);
    assert!((across(3.0 - 1e-9).unwrap().distance - 3.0).abs() < 1e-8);
    assert_eq!(across(3.0 + 1e-9), None);
    // Exactly touching is meeting.
    assert_eq!(across(3.0).unwrap().distance, 3.0);

    // A diagonal through every corner.
    let ground = flat(9, 1.0);
    let hit = ground
        .ray_cast(Vec3::new(0.0, 5.0, 0.0), Vec3::new(1.0, -1.0, 1.0), 1e9)
        .unwrap();
    assert!(hit.point.abs_diff_eq(Vec3::new(4.0, 1.0, 4.0), 1e-5));
}

#[test]
fn one_sample_spike_is_not_missed() {
    let mut samples = vec![0u16; 65 * 65];
    samples[32 * 65 + 32] = 65535;
    let spike = HeightField::from_u16(UVec2::splat(65), 1.0, (0.0, 100.0), samples).unwrap();
    // Just under the tip: the spike is 2·(1 − y/100) wide here.
    let hit = spike
        .ray_cast(Vec3::new(-5.0, 99.0, 32.0), Vec3::X, 1e9)
        .unwrap();
    assert!((hit.point.x - 31.99).abs() < 1e-3, "{hit:?}");
    assert_eq!(cast(&spike, [-5.0, 99.0, 32.5], [1.0, 0.0, 0.0]), None);
    assert_eq!(cast(&spike, [-5.0, 100.1, 32.0], [1.0, 0.0, 0.0]), None);
}

#[test]
fn a_twisted_patch_is_left_and_entered_again() {
    // h = x·z is a saddle: along its diagonal the ray's clearance is a true quadratic.
    let saddle = plane(UVec2::splat(2), 1.0, |x, z| x * z);
    // y = 0.3 − 0.2·s over h = s²: meets where s² + 0.2·s − 0.3 = 0.
    let hit = saddle
        .ray_cast_f64(DVec3::new(0.0, 0.3, 0.0), DVec3::new(1.0, -0.2, 1.0), 1e9)
        .unwrap();
    let s = (-0.2 + (0.04f64 + 1.2).sqrt()) / 2.0;
    assert!((hit.point.x - s).abs() < 1e-12);
    // The other diagonal: h = s·(1 − s) has a hump of 1/4 in the middle. From inside the hump out
    // into the air: nothing. From outside at 0.16: at s = 0.2.
    let across = |x: f64, y: f64| {
        saddle.ray_cast_f64(DVec3::new(x, y, 1.0 - x), DVec3::new(1.0, 0.0, -1.0), 1e9)
    };
    assert_eq!(across(0.5, 0.1), None);
    assert!((across(0.0, 0.16).unwrap().point.x - 0.2).abs() < 1e-12);
    assert_eq!(across(0.0, 0.25 + 1e-12), None);
    assert!((across(0.0, 0.25 - 1e-12).unwrap().point.x - 0.5).abs() < 1e-5);
}

#[test]
fn distances_bound_the_ray() {
    let ground = flat(5, 0.0);
    let down = |max: f32| ground.ray_cast(Vec3::new(2.0, 3.0, 2.0), Vec3::NEG_Y, max);
    assert!(down(3.0).is_some(), "the end belongs to the ray");
    assert!(down(2.999).is_none());
    assert!(down(-1.0).is_none());
    assert!(down(f32::NAN).is_none());
    let slanted =
        |max: f32| ground.ray_cast(Vec3::new(0.5, 3.0, 0.5), Vec3::new(2.0, -3.0, 2.0), max);
    let distance = slanted(f32::INFINITY).unwrap().distance;
    assert!(slanted(distance * 1.0001).is_some());
    assert!(slanted(distance * 0.9999).is_none());
    // The length of the direction does not count.
    for length in [1e-30, 1e-3, 1e30] {
        let hit = ground.ray_cast(
            Vec3::new(0.5, 3.0, 0.5),
            Vec3::new(2.0, -3.0, 2.0) * length,
            1e9,
        );
        assert!((hit.unwrap().distance - distance).abs() < 1e-5);
    }
}

#[test]
fn nonsense_meets_nothing() {
    let ground = flat(5, 0.0);
    let o = Vec3::new(2.0, 3.0, 2.0);
    assert!(ground.ray_cast(o, Vec3::ZERO, 1e9).is_none());
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for axis in 0..3 {
            let mut v = Vec3::NEG_Y;
            v[axis] = bad;
            assert!(ground.ray_cast(o, v, 1e9).is_none());
            let mut p = o;
            p[axis] = bad;
            assert!(ground.ray_cast(p, Vec3::NEG_Y, 1e9).is_none());
        }
    }
    // Absurd but finite: no panic, no endless walk.
    for seed in 0..2000 {
        let number = |k: u32| {
            let bits = hash(seed * 16 + k);
            let value = f32::from_bits(bits);
            if value.is_finite() { value } else { 1e38 }
        };
        let (o, d) = (
            Vec3::new(number(0), number(1), number(2)),
            Vec3::new(number(3), number(4), number(5)),
        );
        let _ = ground.ray_cast(o, d, f32::INFINITY);
        let _ = ground.ray_cast(Vec3::new(2.0, number(1), 2.0), d, f32::INFINITY);
        let _ = ground.ray_cast_f64(o.as_dvec3() * 1e200, d.as_dvec3() * 1e-250, f64::INFINITY);
    }
}

#[test]
fn far_away_eyes_still_hit() {
    let ground = field(Kind::Smooth, UVec2::splat(65), 1.0, 2);
    let target = DVec3::new(
        31.7,
        ground.height_at_f64(DVec2::new(31.7, 20.2)).unwrap(),
        20.2,
    );
    for distance in [1e3, 1e5, 1e7] {
        let o = target + DVec3::new(-0.3, 0.9, 0.2).normalize() * distance;
        let hit = ground.ray_cast_f64(o, target - o, f64::INFINITY).unwrap();
        assert!((hit.point - target).length() < 1e-7, "{distance}: {hit:?}");
    }
}

// ---------------------------------------------------------------------------------------------
// In the world

pub fn world_with(terrains: Vec<(HeightField, Transform)>) -> (App, Vec<Entity>) {
    let mut app = App::new();
    app.add_plugins((
        MinimalPlugins,
        AssetPlugin::default(),
        TransformPlugin,
        HeightFieldPlugin,
    ));
    app.finish();
    app.cleanup();
    let mut entities = Vec::new();
    for (field, transform) in terrains {
        let handle = app
            .world_mut()
            .resource_mut::<Assets<HeightField>>()
            .add(field);
        entities.push(
            app.world_mut()
                .spawn((Terrain::new(handle), transform))
                .id(),
        );
    }
    app.update();
    (app, entities)
}

pub fn ask<T: 'static>(
    app: &mut App,
    question: impl Fn(TerrainQuery) -> T + Send + Sync + 'static,
) -> T {
    app.world_mut()
        .run_system_once(move |query: TerrainQuery| question(query))
        .unwrap()
}

#[test]
fn world_queries_see_the_highest_and_the_nearest_terrain() {
    let (mut app, entities) = world_with(vec![
        (flat(5, 1.0), Transform::IDENTITY),
        (flat(5, 1.0), Transform::from_xyz(2.0, 3.0, 0.0)),
    ]);
    let (low, high) = (entities[0], entities[1]);
    assert_eq!(
        ask(&mut app, |q| q.height_at(Vec2::new(1.0, 1.0))),
        Some((low, 1.0))
    );
    assert_eq!(
        ask(&mut app, |q| q.height_at(Vec2::new(3.0, 1.0))),
        Some((high, 4.0))
    );
    assert_eq!(
        ask(&mut app, |q| q.height_at(Vec2::new(6.0, 1.0))),
        Some((high, 4.0))
    );
    assert_eq!(ask(&mut app, |q| q.height_at(Vec2::new(7.0, 1.0))), None);
    assert_eq!(
        ask(&mut app, |q| q.normal_at(Vec2::new(3.0, 1.0))),
        Some(Vec3::Y)
    );

    let down = Ray3d::new(Vec3::new(3.0, 10.0, 1.0), Dir3::NEG_Y);
    let hit = ask(&mut app, move |q| q.ray_cast(down, 100.0)).unwrap();
    assert_eq!(
        (hit.entity, hit.distance, hit.side),
        (high, 6.0, HitSide::Surface)
    );
    // The upper terrain is solid all the way down: its wall comes first.
    let level = Ray3d::new(Vec3::new(0.5, 2.0, 1.0), Dir3::X);
    let hit = ask(&mut app, move |q| q.ray_cast(level, 100.0)).unwrap();
    assert_eq!(
        (hit.entity, hit.distance, hit.side),
        (high, 1.5, HitSide::Wall)
    );
    assert!(ask(&mut app, move |q| q.ray_cast(level, 1.4)).is_none());
}

#[test]
fn world_queries_follow_rotation_scale_and_mirroring() {
    let slope = plane(UVec2::splat(5), 1.0, |x, _| x);
    // Turned by a quarter: local +X is world −Z.
    let turned = Transform::from_xyz(10.0, 0.0, 20.0)
        .with_rotation(Quat::from_rotation_y(core::f32::consts::FRAC_PI_2))
        .with_scale(Vec3::new(2.0, 3.0, 2.0));
    let (mut app, _) = world_with(vec![(slope.clone(), turned)]);
    let (_, height) = ask(&mut app, |q| q.height_at(Vec2::new(13.0, 16.0))).unwrap();
    // 4 m along −Z at scale 2 is x = 2, at height 2, times 3.
    assert!((height - 6.0).abs() < 1e-5, "{height}");
    let normal = ask(&mut app, |q| q.normal_at(Vec2::new(13.0, 16.0))).unwrap();
    // Rises 3 in 2 towards −Z.
    assert!(
        normal.abs_diff_eq(Vec3::new(0.0, 1.0, 1.5).normalize(), 1e-5),
        "{normal}"
    );

    // Mirrored along X: it rises towards −X, and its normal still points to the air.
    let mirrored = Transform::from_scale(Vec3::new(-1.0, 1.0, 1.0));
    let (mut app, _) = world_with(vec![(slope.clone(), mirrored)]);
    let (_, height) = ask(&mut app, |q| q.height_at(Vec2::new(-3.0, 1.0))).unwrap();
    assert!((height - 3.0).abs() < 1e-5);
    let normal = ask(&mut app, |q| q.normal_at(Vec2::new(-3.0, 1.0))).unwrap();
    assert!(
        normal.abs_diff_eq(Vec3::new(1.0, 1.0, 0.0).normalize(), 1e-5),
        "{normal}"
    );

    // Tilted by 45° about Z, the slope of 45° becomes a wall of sorts or level ground.
    let tilted = Transform::from_rotation(Quat::from_rotation_z(-core::f32::consts::FRAC_PI_4));
    let (mut app, _) = world_with(vec![(slope, tilted)]);
    let (_, height) = ask(&mut app, |q| q.height_at(Vec2::new(2.0, 2.0))).unwrap();
    assert!(height.abs() < 1e-5, "{height}");
    let normal = ask(&mut app, |q| q.normal_at(Vec2::new(2.0, 2.0))).unwrap();
    assert!(normal.abs_diff_eq(Vec3::Y, 1e-5), "{normal}");
    // Beyond the surface there is only wall, which is no ground.
    assert_eq!(ask(&mut app, |q| q.height_at(Vec2::new(-0.5, 2.0))), None);
}

#[test]
fn a_terrain_at_ten_million_metres_keeps_its_shape() {
    let field = field(Kind::Smooth, UVec2::splat(33), 64.0, 2);
    // A power of two that f32 holds exactly, with a metre's precision: the terrain's own heights
    // must not suffer from it.
    let far = Vec3::new(16_777_216.0, -1024.0, 8_388_608.0);
    let (mut app, _) = world_with(vec![(field.clone(), Transform::from_translation(far))]);
    for (x, z) in [(64.0, 64.0), (1000.0, 512.0), (2048.0, 2048.0)] {
        let local = field.height_at(Vec2::new(x, z)).unwrap();
        let world = Vec2::new(far.x + x, far.z + z);
        let (_, height) = ask(&mut app, move |q| q.height_at(world)).unwrap();
        assert!((height - (local - 1024.0)).abs() < 1e-3);
    }
}

#[test]
fn flattened_and_unloaded_terrains_are_passed_over() {
    let (mut app, entities) = world_with(vec![
        (
            flat(5, 1.0),
            Transform::from_scale(Vec3::new(1.0, 0.0, 1.0)),
        ),
        (
            flat(5, 1.0),
            Transform::from_scale(Vec3::new(1.0, 0.0, 1.0))
                .with_rotation(Quat::from_rotation_z(0.3)),
        ),
        (flat(5, 9.0), Transform::from_xyz(f32::NAN, 0.0, 0.0)),
        (flat(5, 1.0), Transform::from_xyz(0.0, 1.0, 0.0)),
    ]);
    app.world_mut()
        .spawn((Terrain::new(Handle::default()), Transform::default()));
    app.update();
    assert_eq!(
        ask(&mut app, |q| q.height_at(Vec2::new(1.0, 1.0))),
        Some((entities[3], 2.0))
    );
}
