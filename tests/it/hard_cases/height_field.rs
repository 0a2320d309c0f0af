//! Rays through a height field, by the CPU's query and by the `f64` twin of the GPU's: against algebra.

use bevy::{
    math::{DVec2, DVec3},
    prelude::*,
};
use bevy_skyline::{
    prelude::HeightField,
    reference::ray_cast::{Part, Twin},
    terrain::HitSide,
};
use proptest::prelude::*;

use super::{Claim, Found, Measured, Table, all_hold, height_field_points};

const ABOUT: &str = "\
`HeightField::ray_cast` and the twin of the GPU's rays, both held against algebra; the figure is the larger error. Then \
`height_at`, `normal_at` and `TerrainQuery`.";

const DISTANCE: Claim = Claim {
    asserts: "query and twin meet it, at this distance",
    bound: 0.0,
    unit: "m",
    why: "64 roundings of all magnitudes in play, over the speed of closing in",
};
const NOTHING: Claim = Claim::none("nothing is met", "hits", "there is nothing to meet");
const WALL: Claim = Claim {
    asserts: "query and twin meet the wall",
    ..DISTANCE
};

/// Samples of any function, as floats.
pub fn surface(size: (u32, u32), texel_m: f32, h: impl Fn(f64, f64) -> f64) -> HeightField {
    let samples = (0..size.0 * size.1)
        .map(|k| h(f64::from(k % size.0), f64::from(k / size.0)) as f32)
        .collect();
    HeightField::from_f32(UVec2::from(size), texel_m, samples).expect("a field")
}

pub fn flat(height: f64) -> HeightField {
    surface((5, 5), 1.0, |_, _| height)
}

/// One sample of 8 m among zeros.
pub fn spike() -> HeightField {
    surface(
        (9, 9),
        1.0,
        |i, j| if (i, j) == (4.0, 4.0) { 8.0 } else { 0.0 },
    )
}

/// The full range of 16 bits in one cell.
pub fn cliff() -> HeightField {
    let codes = (0..9 * 9)
        .map(|k| if k % 9 < 4 { 0 } else { 65_535 })
        .collect();
    HeightField::from_u16(UVec2::splat(9), 1.0, (0.0, 65_535.0), codes).expect("a field")
}

/// A millionth, and a power of two.
pub const SLIGHT: f64 = 1.0 / (1 << 20) as f64;

/// A ridge whose sides fall by about a millionth.
pub fn ridge() -> HeightField {
    surface((9, 5), 1.0, |i, _| -SLIGHT * (i - 4.0).abs())
}

/// What a ray comes to. `way` counts lengths of the direction; `closing` is how fast height is lost over the ground, in
/// m a length of the direction.
#[derive(Clone, Copy, Debug)]
enum Meets {
    Ground { way: f64, closing: f64 },
    Wall { way: f64 },
}

/// Length of a direction whose squares may vanish or overflow.
fn length(d: DVec3) -> f64 {
    let largest = d.abs().max_element();
    largest * (d / largest).length()
}

/// What 64 roundings of everything that is added on the way may come to. units: m
fn rounding_m(field: &HeightField, o: DVec3, d: DVec3, distance: f64) -> f64 {
    let (low, high) = field.data_range_m();
    let reach = o.abs().max_element() + distance;
    let across = o.x.abs().max(o.z.abs()) + distance * (d.x.hypot(d.z) / length(d));
    let size = field.size();
    let mut steepest = 0.0f64;
    for j in 0..size.y {
        for i in 0..size.x {
            let here = field.sample_m(i, j);
            if i > 0 {
                steepest = steepest.max((here - field.sample_m(i - 1, j)).abs());
            }
            if j > 0 {
                steepest = steepest.max((here - field.sample_m(i, j - 1)).abs());
            }
        }
    }
    let cells = f64::from(size.max_element()) + across / f64::from(field.texel_m());
    64.0 * f64::EPSILON * (reach + low.abs().max(high.abs()) + steepest * cells)
}

fn bound_m(field: &HeightField, o: DVec3, d: DVec3, meets: Meets) -> f64 {
    let (way, closing) = match meets {
        Meets::Ground { way, closing } => (way, closing),
        Meets::Wall { way } => (way, length(d)),
    };
    let distance = way * length(d);
    rounding_m(field, o, d, distance) * length(d) / closing
}

/// The larger error of the query's and of the twin's distance. units: m
fn error_m(field: &HeightField, o: DVec3, d: DVec3, meets: Meets) -> Result<f64, String> {
    let (way, side, part) = match meets {
        Meets::Ground { way, .. } => (way, HitSide::Surface, Part::Surface),
        Meets::Wall { way } => (way, HitSide::Wall, Part::Wall),
    };
    let distance = way * length(d);
    let query = field.ray_cast_f64(o, d, f64::INFINITY);
    let grid = field.grid_from_local();
    // Of length 1, so that the twin's t are metres.
    let unit = (d / d.abs().max_element()).normalize();
    let twin = Twin::new(field).cast(
        grid.transform_point3(o),
        grid.transform_vector3(unit),
        DVec3::ZERO,
        4.0 * distance + 1.0,
    );
    match (query, twin) {
        (Some(query), Some(twin)) if query.side == side && twin.part == part => {
            let of_query = (query.distance - distance).abs();
            let of_twin = (twin.t - distance).abs();
            Ok(of_query.max(of_twin))
        }
        other => Err(format!("{other:?} instead of {meets:?} at {distance} m")),
    }
}

fn nothing(field: &HeightField, o: DVec3, d: DVec3, max: f64) -> Found {
    let hit = field.ray_cast_f64(o, d, max);
    Measured::noted(
        f64::from(u8::from(hit.is_some())),
        hit.map_or_else(String::new, |hit| format!("{hit:?}")),
    )
}

struct Rays<'a>(&'a mut Table);

impl Rays<'_> {
    fn meets(&mut self, name: &str, field: HeightField, o: [f64; 3], d: [f64; 3], meets: Meets) {
        let (o, d) = (DVec3::from(o), DVec3::from(d));
        let claim = match meets {
            Meets::Ground { .. } => DISTANCE,
            Meets::Wall { .. } => WALL,
        };
        let claim = claim.at_most(bound_m(&field, o, d, meets));
        self.0.case(claim, name, move |_| {
            Measured::of(error_m(&field, o, d, meets)?)
        });
    }

    fn ground(
        &mut self,
        name: &str,
        field: HeightField,
        (o, d): ([f64; 3], [f64; 3]),
        (way, closing): (f64, f64),
    ) {
        self.meets(name, field, o, d, Meets::Ground { way, closing });
    }

    /// From `o` to `p` on a plane of these slopes.
    fn plane(
        &mut self,
        name: &str,
        field: HeightField,
        (o, p): ([f64; 3], [f64; 3]),
        slopes: (f64, f64),
    ) {
        let d = DVec3::from(p) - DVec3::from(o);
        let closing = slopes.0 * d.x + slopes.1 * d.z - d.y;
        self.ground(name, field, (o, d.to_array()), (1.0, closing));
    }

    fn wall(&mut self, name: &str, field: HeightField, o: [f64; 3], d: [f64; 3], way: f64) {
        self.meets(name, field, o, d, Meets::Wall { way });
    }

    fn none(&mut self, name: &str, field: HeightField, o: [f64; 3], d: [f64; 3]) {
        self.within(name, field, o, d, f64::INFINITY);
    }

    fn within(&mut self, name: &str, field: HeightField, o: [f64; 3], d: [f64; 3], max: f64) {
        let (o, d) = (DVec3::from(o), DVec3::from(d));
        self.0
            .case(NOTHING, name, move |_| nothing(&field, o, d, max));
    }
}

#[rustfmt::skip]
fn rays(table: &mut Table) {
    let mut ray = Rays(table);
    let down = [0.0, -1.0, 0.0];
    // Shapes of field.
    ray.ground("2×2 samples, straight down", surface((2, 2), 1.0, |_, _| 1.0), ([0.5, 10.0, 0.5], down), (9.0, 1.0));
    let saddle = || surface((2, 2), 1.0, |i, j| i * j);
    ray.ground("2×2 saddle, along its curved diagonal", saddle(), ([0.0, 0.5, 0.0], [1.0, -0.5, 1.0]), (0.5, 1.5));
    // s (1 − s) = ¼ − 10⁻¹² at s = ½ − 10⁻⁶.
    ray.ground("2×2 saddle, 10⁻¹² m below the top of its hump", saddle(), ([0.0, 0.25 - 1e-12, 1.0], [1.0, 0.0, -1.0]), (0.5 - 1e-6, 2e-6));
    ray.none("2×2 saddle, 10⁻¹² m above the top of its hump", saddle(), [0.0, 0.25 + 1e-12, 1.0], [1.0, 0.0, -1.0]);
    ray.ground("one cell wide, from beside", surface((2, 9), 1.0, |_, j| 0.5 * j), ([-0.5, 5.0, 3.5], [1.0, -4.0, 0.0]), (0.8125, 4.0));
    ray.ground("one cell deep, from beside", surface((9, 2), 1.0, |i, _| 0.5 * i), ([3.5, 5.0, -0.5], [0.0, -4.0, 1.0]), (0.8125, 4.0));
    ray.plane("131×77 samples, from the first cell into the last", surface((131, 77), 1.0, |i, j| 0.25 * i + 0.5 * j), ([0.0, 200.0, 0.0], [129.5, 70.125, 75.5]), (0.25, 0.5));
    ray.plane("one sample past powers of two, from the last cell back", surface((66, 34), 1.0, |i, j| 0.25 * i + 0.5 * j), ([64.5, 90.0, 32.5], [0.5, 0.375, 0.5]), (0.25, 0.5));
    ray.plane("millimetre texels", surface((33, 33), 0.001, |i, j| 0.0005 * (i + j)), ([0.0, 0.05, 0.0], [16.0 * f64::from(0.001f32), f64::from(0.0005f32) * 32.0, 16.0 * f64::from(0.001f32)]), (0.5, 0.5));
    ray.plane("ten-kilometre texels", surface((33, 33), 1e4, |i, j| 64.0 * (i + j)), ([0.0, 9e3, 3e4], [1.6e5, 2048.0, 1.6e5]), (0.0064, 0.0064));
    ray.plane("texels of 10⁻²⁰ m", surface((5, 5), 1e-20, |i, _| f64::from(1e-20f32) * i), ([0.0, 9e-20, 1.5 * f64::from(1e-20f32)], [1.5 * f64::from(1e-20f32); 3]), (1.0, 0.0));
    ray.plane("heights of 10³⁰ m", surface((5, 5), 1.0, |i, _| f64::from(1e30f32) * i), ([0.0, 9e30, 2.5], [1.5, 1.5 * f64::from(1e30f32), 2.5]), (f64::from(1e30f32), 0.0));
    ray.plane("heights about 10⁷ m", surface((9, 9), 1.0, |i, j| 1e7 + i + 2.0 * j), ([0.0, 1e7 + 90.0, 0.0], [4.5, 1e7 + 13.5, 4.5]), (1.0, 2.0));
    ray.plane("heights of 10⁻⁴⁰ m, which f32 holds but half", surface((9, 9), 1.0, |_, _| 1e-40), ([0.0, 4.0, 0.0], [4.0, f64::from(1e-40f32), 4.0]), (0.0, 0.0));
    // Spikes and cliffs.
    ray.ground("spike of one sample, from beside", spike(), ([-4.0, 2.0, 4.0], [1.0, 0.0, 0.0]), (7.25, 8.0));
    ray.ground("spike, along the diagonal", spike(), ([0.0, 2.0, 0.0], [1.0, 0.0, 1.0]), (3.5, 8.0));
    ray.ground("spike, straight down onto its tip", spike(), ([4.0, 20.0, 4.0], down), (12.0, 1.0));
    ray.ground("spike, straight down a millionth beside its tip", spike(), ([4.0 + SLIGHT, 20.0, 4.0], down), (12.0 + 8.0 * SLIGHT, 1.0));
    let under = 12.0 - 1e-9;
    ray.ground("spike, 10⁻⁹ m under its very tip", spike(), ([0.0, under, 4.0], [1.0, -1.0, 0.0]), ((under + 24.0) / 9.0, 9.0));
    ray.none("spike, 10⁻⁹ m over its tip", spike(), [-4.0, 8.0 + 1e-9, 4.0], [1.0, 0.0, 0.0]);
    ray.none("spike, half a cell beside it", spike(), [-4.0, 4.0 + 1e-9, 4.5], [1.0, 0.0, 0.0]);
    ray.ground("cliff of all 16 bits in one cell, level", cliff(), ([0.0, 30_000.0, 2.5], [1.0, 0.0, 0.0]), (3.0 + 30_000.0 / 65_535.0, 65_535.0));
    ray.ground("cliff, straight down onto its face", cliff(), ([3.25, 70_000.0, 2.5], down), (70_000.0 - 16_383.75, 1.0));
    ray.none("cliff, level 10⁻⁹ m over it", cliff(), [0.0, 65_535.0 + 1e-9, 2.5], [1.0, 0.0, 0.0]);
    ray.ground("cliff, down along its top into the last cell", cliff(), ([4.0, 65_538.5, 4.0], [1.0, -1.0, 0.0]), (3.5, 1.0));
    // Along axes and borders, through samples.
    ray.ground("flat, along a cell border", flat(1.0), ([0.0, 3.0, 2.0], [1.0, -1.0, 0.0]), (2.0, 1.0));
    ray.ground("flat, along the field's own border", flat(1.0), ([0.0, 3.0, 4.0], [1.0, -1.0, 0.0]), (2.0, 1.0));
    ray.ground("flat, along a border one rounding off it", flat(1.0), ([0.0, 3.0, 2.0_f64.next_down()], [1.0, -1.0, 0.0]), (2.0, 1.0));
    ray.ground("flat, through every sample of the diagonal", flat(1.0), ([0.0, 4.0, 0.0], [1.0, -1.0, 1.0]), (3.0, 1.0));
    ray.ground("flat, almost along an axis (10⁻³⁰⁰ across)", flat(1.0), ([0.0, 3.0, 2.0], [1.0, -1.0, 1e-300]), (2.0, 1.0));
    ray.ground("flat, almost straight down (10⁻¹⁷ across)", flat(1.0), ([2.0, 3.0, 2.0], [1e-17, -1.0, 1e-17]), (2.0, 1.0));
    ray.ground("straight down onto the first corner", flat(1.0), ([0.0, 10.0, 0.0], down), (9.0, 1.0));
    let rounds = 20.031f32;
    let far = 40.0 * f64::from(rounds);
    ray.ground("straight down onto the last corner of an extent that f32 rounds", surface((41, 4), rounds, |i, j| i + j), ([far, 100.0, 3.0 * f64::from(rounds)], down), (57.0, 1.0));
    ray.none("straight down, a rounding outside", flat(1.0), [4.0_f64.next_up(), 10.0, 2.0], down);
    ray.none("straight down, 10⁻³⁰⁰ m outside", flat(1.0), [-1e-300, 10.0, 2.0], down);
    // Grazing.
    ray.ground("grazing a ridge: down at 10⁻⁶ onto ground that rises at 10⁻⁶", ridge(), ([0.0, 2.0 * SLIGHT, 2.0], [1.0, -SLIGHT, 0.0]), (3.0, 2.0 * SLIGHT));
    ray.ground("touching a ridge's crest, level", ridge(), ([0.0, 0.0, 2.0], [1.0, 0.0, 0.0]), (4.0, SLIGHT));
    ray.none("level, 10⁻¹² m over a ridge's crest", ridge(), [0.0, 1e-12, 2.0], [1.0, 0.0, 0.0]);
    ray.none("along a falling side, 10⁻¹² m above it", ridge(), [4.0, 1e-12, 2.0], [1.0, -SLIGHT, 0.0]);
    ray.none("along a falling side, 10⁻¹² m inside", ridge(), [4.0, -1e-12, 2.0], [1.0, -SLIGHT, 0.0]);
    ray.none("level along flat ground, in it", flat(1.0), [0.0, 1.0, 2.0], [1.0, 0.0, 0.0]);
    ray.none("level, one rounding over flat ground", flat(1.0), [0.0, 1.0_f64.next_up(), 2.0], [1.0, 0.0, 0.0]);
    // From inside, from below, on the surface.
    let hills = || surface((5, 2), 1.0, |i, _| if i % 2.0 == 1.0 { 4.0 } else { 0.0 });
    ray.ground("from inside a hill, through the air, into the next", hills(), ([1.0, 2.0, 0.5], [1.0, 0.0, 0.0]), (1.5, 4.0));
    ray.none("from inside the last hill, out through the wall", hills(), [3.0, 2.0, 0.5], [1.0, 0.0, 0.0]);
    let hollow = || surface((2, 2), 1.0, |i, j| if i == j { 2.0 } else { 0.0 });
    let out = 0.5 + 0.125f64.sqrt();
    ray.ground("out of the ground and back into it in one cell", hollow(), ([0.01, 1.5, 0.01], [1.0, 0.0, 1.0]), (out - 0.01, 8.0 * 0.125f64.sqrt()));
    ray.none("straight up from inside", flat(1.0), [2.0, 0.5, 2.0], [0.0, 1.0, 0.0]);
    ray.none("straight down from inside", flat(1.0), [2.0, 0.5, 2.0], down);
    ray.none("straight up from far below", flat(1.0), [2.0, -1e9, 2.0], [0.0, 1.0, 0.0]);
    ray.none("from the surface, down", flat(1.0), [2.0, 1.0, 2.0], [1.0, -1.0, 0.0]);
    ray.none("from the surface, up and away", flat(1.0), [2.0, 1.0, 2.0], [1.0, 1.0, 0.0]);
    ray.ground("from 10⁻¹² m above the surface, straight down", flat(1.0), ([2.0, 1.0 + 1e-12, 2.0], down), ((1.0 + 1e-12) - 1.0, 1.0));
    // Walls.
    ray.wall("wall, level", flat(2.0), [-3.0, 1.0, 2.0], [1.0, 0.0, 0.0], 3.0);
    ray.wall("wall, 10⁶ m down", flat(2.0), [-3.0, -1e6, 2.0], [1.0, 0.0, 0.0], 3.0);
    ray.wall("wall, at the very height of the ground", flat(2.0), [-3.0, 2.0, 2.0], [1.0, 0.0, 0.0], 3.0);
    ray.wall("wall, at its corner", flat(2.0), [-3.0, 1.0, -3.0], [1.0, 0.0, 1.0], 3.0);
    ray.wall("wall, from 10⁻¹² m outside", flat(2.0), [-1e-12, 1.0, 2.0], [1.0, 0.0, 0.0], 1e-12);
    ray.wall("wall, on the way up into the air above", flat(2.0), [-1.0, 0.0, 2.0], [1.0, 1.0, 0.0], 1.0);
    ray.none("over the wall by a rounding", flat(2.0), [-3.0, 2.0_f64.next_up(), 2.0], [1.0, 0.0, 0.0]);
    ray.none("along the wall's outside, 10⁻³⁰⁰ m off", flat(2.0), [-1.0, 1.0, -1e-300], [1.0, 0.0, 0.0]);
    // Far away.
    let hill = || surface((65, 65), 1.0, |i, j| 0.25 * i + 0.125 * j);
    let aim = [31.75, 0.25 * 31.75 + 0.125 * 20.25, 20.25];
    for (name, way) in [("an eye 10⁵ m away", 1e5), ("an eye 10⁷ m away", 1e7), ("an eye 10⁹ m away", 1e9)] {
        ray.plane(name, hill(), ([aim[0] - 0.3 * way, aim[1] + 0.9 * way, aim[2] + 0.2 * way], aim), (0.25, 0.125));
    }
    // Directions and distances that are none, or of odd length.
    for (name, length) in [("a direction of length 10⁻³⁰⁰", 1e-300), ("a direction of length 10³⁰⁰", 1e300)] {
        ray.ground(name, flat(1.0), ([2.0, 3.0, 2.0], [0.0, -length, 0.0]), (2.0 / length, length));
    }
    ray.none("no direction", flat(1.0), [2.0, 3.0, 2.0], [0.0; 3]);
    for (name, bad) in [("NaN", f64::NAN), ("∞", f64::INFINITY), ("−∞", f64::NEG_INFINITY)] {
        ray.none(&format!("a direction with {name}"), flat(1.0), [2.0, 3.0, 2.0], [bad, -1.0, 0.0]);
        ray.none(&format!("an origin with {name}"), flat(1.0), [2.0, bad, 2.0], down);
    }
    ray.within("a way of NaN", flat(1.0), [2.0, 3.0, 2.0], down, f64::NAN);
    ray.within("a way below zero", flat(1.0), [2.0, 3.0, 2.0], down, -1.0);
    ray.within("a way one rounding too short", flat(1.0), [2.0, 3.0, 2.0], down, 2.0_f64.next_down());
}

pub fn table() -> Table {
    let mut table = Table::new("Height field", ABOUT);
    rays(&mut table);
    height_field_points::heights(&mut table);
    height_field_points::world(&mut table);
    table
}

#[test]
fn every_case_holds() {
    all_hold(&table());
}

#[test]
fn a_surface_moved_by_little_is_caught() {
    // By ten times the bound, up.
    let (o, d) = (DVec3::new(2.0, 3.0, 2.0), DVec3::NEG_Y);
    let meets = Meets::Ground {
        way: 2.0,
        closing: 1.0,
    };
    let bound = bound_m(&flat(1.0), o, d, meets);
    assert!(error_m(&flat(1.0), o, d, meets).is_ok_and(|error| error <= bound));
    let moved = o + DVec3::Y * 10.0 * bound;
    assert!(error_m(&flat(1.0), moved, d, meets).is_ok_and(|error| error > bound));
    // Another part of the ground, or none.
    let wall = Meets::Wall { way: 2.0 };
    assert!(error_m(&flat(1.0), o, d, wall).is_err());
    assert!(error_m(&flat(1.0), o, -d, meets).is_err());
    assert!(nothing(&flat(1.0), o, d, 9.0).is_ok_and(|found| found.value == 1.0));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, rng_seed: prop::test_runner::RngSeed::Fixed(41), failure_persistence: None, max_global_rejects: 50_000, ..Default::default() })]

    /// Any ray onto any saddle over any grid meets it where its quadratic says.
    #[test]
    fn any_ray_onto_any_saddle_meets_it(
        size in (2u32..9, 2u32..9),
        scale in -12i32..12,
        slopes in (-64i32..64, -64i32..64, -16i32..16),
        target in (0.001f64..0.999, 0.001f64..0.999),
        from in prop::array::uniform3(-2.0f64..3.0),
        above in -3i32..12,
    ) {
        let texel = 2f64.powi(scale);
        // Whole 64ths, which f32 holds with their products.
        let [gx, gz, twist] = [slopes.0, slopes.1, slopes.2].map(|slope| f64::from(slope) / 64.0);
        let h = |x: f64, z: f64| gx * x + gz * z + twist * x * z;
        let field = surface(size, texel as f32, h);
        let cells = field.cells().as_dvec2();
        let at = DVec2::new(target.0, target.1) * cells;
        let p = DVec3::new(at.x * texel, h(at.x, at.y), at.y * texel);
        let up = 2f64.powi(above) * (1.0 + gx.abs() + gz.abs() + twist.abs());
        let o = DVec3::new(from[0] * cells.x * texel, p.y + up, from[2] * cells.y * texel);
        let d = p - o;
        // Its height over the ground along the way, a s² + b s + c with f(1) = 0.
        let (u, v) = (d.x / texel, d.z / texel);
        let a = -twist * u * v;
        let start = DVec2::new(o.x, o.z) / texel;
        let b = d.y - (gx * u + gz * v + twist * (start.x * v + start.y * u));
        let c = o.y - h(start.x, start.y);
        let closing = -(2.0 * a + b);
        // From the air, by the first of its roots, over the border.
        prop_assume!(c > 1e-3 * up && closing > 1e-3 * up);
        prop_assume!(a == 0.0 || !(0.0..=1.0001).contains(&(c / a)));
        let meets = Meets::Ground { way: 1.0, closing };
        let enters = {
            let axis = |o: f64, d: f64, end: f64| if d == 0.0 { 0.0 } else { (-o / d).min((end - o) / d) };
            axis(start.x, u, cells.x).max(axis(start.y, v, cells.y)).max(0.0)
        };
        prop_assume!((a * enters + b) * enters + c > 1e-6 * up);
        // The quadratic's own rounding is that of p and o.
        let bound = bound_m(&field, o, d, meets);
        let error = error_m(&field, o, d, meets);
        prop_assert!(error.as_ref().is_ok_and(|error| *error <= bound), "{:?} of {}", error, bound);
    }
}
