//! `reference::terrain_shadow` against analytic cases, brute force, and `f32` shadow rays with the worst rounding
//! that WGSL allows.

use core::{cmp::Ordering, f64::consts::TAU};
use std::time::{Duration, Instant};

use bevy::math::{DAffine3, DMat3, DVec2, DVec3, UVec2};
use bevy_skyline::{
    reference::terrain_shadow::{ShadowTally, ShadowTwin, ShadowVerdict},
    terrain::HeightSamples,
    terrain_shadow::light::{GridLight, LightSource, strip_above},
};

struct Field {
    samples: HeightSamples,
    size: UVec2,
    /// From the lowest sample to the highest.
    span: f64,
}

impl Field {
    fn new(width: u32, height: u32, h: impl Fn(u32, u32) -> f32) -> Self {
        let samples: Vec<f32> = (0..width * height)
            .map(|k| h(k % width, k / width))
            .collect();
        let high = samples.iter().copied().fold(f32::MIN, f32::max);
        let low = samples.iter().copied().fold(f32::MAX, f32::min);
        Self {
            samples: HeightSamples::F32(samples),
            size: UVec2::new(width, height),
            span: f64::from(high - low),
        }
    }

    fn codes(self) -> Self {
        let HeightSamples::F32(samples) = self.samples else {
            return self;
        };
        Self {
            samples: HeightSamples::U16(samples.iter().map(|&h| h as u16).collect()),
            ..self
        }
    }

    fn twin(&self) -> ShadowTwin<'_> {
        ShadowTwin::new(&self.samples, self.size)
    }

    fn height(&self, i: u32, j: u32) -> f32 {
        let index = (j * self.size.x + i) as usize;
        match &self.samples {
            HeightSamples::U16(samples) => f32::from(samples[index]),
            HeightSamples::F32(samples) => samples[index],
        }
    }

    fn places(&self) -> impl Iterator<Item = UVec2> + use<> {
        let size = self.size;
        (0..size.x * size.y).map(move |k| UVec2::new(k % size.x, k / size.x))
    }
}

/// Numbers that look random.
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    }

    fn below(&mut self, n: u64) -> u64 {
        self.bits() % n
    }

    /// From `low` to `high`.
    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn sun(x: f64, y: f64, z: f64) -> GridLight {
    GridLight::directional(DVec3::new(x, y, z), 0.0, DAffine3::IDENTITY)
}

fn lamp(x: f64, y: f64, z: f64) -> GridLight {
    let position = DVec3::new(x, y, z);
    GridLight::point(position, 0.0, f64::INFINITY, DAffine3::IDENTITY)
}

/// All must be so, exactly and for the GPU; `None`: for the GPU the answer is rounding's.
fn expect(field: &Field, light: &GridLight, lit: impl Fn(UVec2) -> Option<bool>) {
    let twin = field.twin();
    for sample in field.places() {
        let verdict = twin.judge(light, sample);
        let what = || format!("{sample} of {light:?}: {verdict:?}");
        match lit(sample) {
            Some(true) => {
                assert!(twin.lit(light, sample), "{}", what());
                assert_eq!(verdict, ShadowVerdict::Lit, "{}", what());
            }
            Some(false) => {
                assert!(!twin.lit(light, sample), "{}", what());
                assert_eq!(verdict, ShadowVerdict::Dark, "{}", what());
            }
            None => {
                assert!(twin.lit(light, sample), "{}", what());
                assert_ne!(verdict, ShadowVerdict::Dark, "{}", what());
            }
        }
    }
}

// Analytic cases.

#[test]
fn flat_ground_sees_every_sun_that_is_up() {
    for field in [
        Field::new(7, 5, |_, _| 3.0),
        Field::new(2, 2, |_, _| -0.1),
        Field::new(5, 13, |_, _| 60000.0).codes(),
    ] {
        for azimuth in 0..24 {
            let (z, x) = (TAU / 24.0 * f64::from(azimuth)).sin_cos();
            for y in [0.0, 1e-30, 1e-4, 0.3, 1e6, 1e18] {
                expect(&field, &sun(x, y, z), |_| Some(true));
            }
            // Below the horizon: lit only where the ray leaves the footprint at once.
            let (right, down) = (x > 1e-9, z > 1e-9);
            let (left, up) = (x < -1e-9, z < -1e-9);
            let light = sun(
                if left || right { x } else { 0.0 },
                -1e-4,
                if up || down { z } else { 0.0 },
            );
            let last = field.size - 1;
            expect(&field, &light, |at| {
                let leaves = right && at.x == last.x
                    || left && at.x == 0
                    || down && at.y == last.y
                    || up && at.y == 0;
                Some(leaves)
            });
        }
        expect(&field, &sun(0.0, 1.0, 0.0), |_| Some(true));
        expect(&field, &sun(0.0, -1.0, 0.0), |_| Some(false));
    }
}

#[test]
fn a_plane_is_lit_from_its_own_side() {
    // y = x / 2 + z / 4
    let field = Field::new(17, 9, |i, j| 0.5 * i as f32 + 0.25 * j as f32);
    let leaves = |at: UVec2, x: f64, z: f64| {
        x > 0.0 && at.x == 16
            || z > 0.0 && at.y == 8
            || x < 0.0 && at.x == 0
            || z < 0.0 && at.y == 0
    };
    for (x, z) in [
        (1.0, 0.0),
        (-1.0, 0.0),
        (0.0, 1.0),
        (0.0, -1.0),
        (1.0, 1.0),
        (-1.0, 1.0),
        (0.7, -0.3),
        (1.0, 1e-9),
        (-0.123, 1.0),
    ] {
        let along = 0.5 * x + 0.25 * z;
        expect(&field, &sun(x, along + 1e-4, z), |_| Some(true));
        expect(&field, &sun(x, along - 1e-4, z), |at| {
            Some(leaves(at, x, z))
        });
        // Grazing: lit, but only where the numbers are round does f32 know.
        expect(&field, &sun(x, along, z), |at| {
            leaves(at, x, z).then_some(true)
        });
    }
}

#[test]
fn a_wall_casts_a_shadow_of_its_height_over_the_suns_tangent() {
    let field = Field::new(40, 4, |i, _| if i >= 30 { 8.0 } else { 0.0 });
    for tangent in [1e-4f64, 0.3, 0.5, 0.81, 1.0, 1.7, 9.0] {
        for azimuth in [0.0, 0.01, 0.03] {
            // To the right, and sideways by less than a cell until it is there; out of the last row at once.
            let light = sun(1.0, tangent, azimuth);
            expect(&field, &light, |at| {
                let to_wall = f64::from(30 - at.x as i32);
                let leaves = at.y == 3 && azimuth > 0.0;
                let lit = to_wall <= 0.0 || leaves || to_wall * tangent > 8.0;
                (to_wall * tangent != 8.0).then_some(lit)
            });
        }
        // From the side where the ground is low.
        expect(&field, &sun(-1.0, tangent, 0.0), |_| Some(true));
    }
    // From behind and below: over the edge, and out of the footprint.
    expect(&field, &sun(-1.0, -0.01, 0.0), |at| {
        Some(at.x == 0 || at.x == 30)
    });
}

#[test]
fn a_spike_casts_a_shadow_along_axes_and_diagonals() {
    let middle = UVec2::new(11, 13);
    let field = Field::new(
        23,
        27,
        |i, j| {
            if UVec2::new(i, j) == middle { 4.0 } else { 0.0 }
        },
    );
    for (x, z) in [
        (1, 0),
        (-1, 0),
        (0, 1),
        (0, -1),
        (1, 1),
        (-1, 1),
        (1, -1),
        (-1, -1),
    ] {
        for tangent in [0.001, 0.45, 1.1, 3.0, 5.0] {
            let light = sun(f64::from(x), tangent, f64::from(z));
            expect(&field, &light, |at| {
                let way = middle.as_ivec2() - at.as_ivec2();
                let steps = way.abs().max_element();
                // Diagonals beside the top's own run through the pyramid's flanks, highest at their middle: 1/4 of it.
                let beside = (way.x * z - way.y * x).abs();
                let ahead = way.x * x + way.y * z > 0;
                let diagonal = x != 0 && z != 0;
                Some(if !ahead {
                    true
                } else if beside == 0 {
                    f64::from(steps) * tangent > 4.0
                } else if diagonal && beside == 1 {
                    // 4 u (1 − u) from the cell's border on: the first such cell begins at steps − 1.
                    let from = f64::from(steps - 1);
                    let highest = (1..4000)
                        .map(|k| f64::from(k) / 4000.0)
                        .map(|u| 4.0 * u * (1.0 - u) / (from + u))
                        .fold(if from == 0.0 { 4.0 } else { 0.0 }, f64::max);
                    tangent > highest
                } else {
                    true
                })
            });
        }
    }
    // Past it by half a cell: over the height of two.
    for (tangent, lit) in [(1.99, false), (2.01, true)] {
        let light = sun(1.0, tangent, 0.5);
        let at = middle - 1;
        assert_eq!(field.twin().lit(&light, at), lit);
    }
}

#[test]
fn lamps_of_every_kind() {
    let hill = Field::new(11, 11, |i, j| {
        let far = (i as f32 - 5.0).abs().max((j as f32 - 5.0).abs());
        (10.0 - 3.0 * far).max(0.0)
    });
    // Inside of the hill, and deep below all.
    expect(&hill, &lamp(5.25, 5.0, 5.1), |_| Some(false));
    expect(&hill, &lamp(5.25, -1e5, 5.1), |_| Some(false));
    // High above, very far away, on the top, just below it.
    let convex = Field::new(9, 9, |i, j| {
        -0.5 * ((i as f32 - 4.0).powi(2) + (j as f32 - 4.0).powi(2))
    });
    expect(&convex, &lamp(4.0, 40.0, 4.0), |_| Some(true));
    expect(&convex, &lamp(4.3, 1e7, 4.6), |_| Some(true));
    expect(&convex, &lamp(4.0, 1e18, 4.6), |_| Some(true));
    let top = UVec2::new(4, 4);
    assert!(convex.twin().lit(&lamp(4.0, 0.0, 4.0), top));
    assert_eq!(
        convex.twin().judge(&lamp(4.0, 0.0, 4.0), top),
        ShadowVerdict::Lit
    );
    expect(&convex, &lamp(4.0, -0.01, 4.0), |_| Some(false));
    let flat = Field::new(12, 7, |_, _| 2.0);
    for (x, y, z) in [
        (3.0, 2.0, 3.0),
        (3.0, 9.0, 3.0),
        (3.5, 2.0 + 1e-9, 3.25),
        (1e7, 2.0, -1e7),
        (1e7, 2.5, 3.0),
        (-1e6, 1e7, 0.1),
        (3.0 + 1e-14, 5.0, 3.0),
    ] {
        expect(&flat, &lamp(x, y, z), |_| Some(true));
    }
    expect(&flat, &lamp(3.0, 1.9, 3.0), |_| Some(false));
    expect(&flat, &lamp(3.0 + 1e-14, 1.0, 3.0), |_| Some(false));
    // Behind a wall.
    let wall = Field::new(40, 4, |i, _| if i == 20 { 8.0 } else { 0.0 });
    for y in [0.25, 1.0, 4.0, 16.5] {
        expect(&wall, &lamp(30.0, y, 1.5), |at| {
            let (to_wall, to_lamp) = (20.0 - f64::from(at.x), 30.0 - f64::from(at.x));
            let top = if at.x == 20 { 8.0 } else { 0.0 };
            let over = top + (y - top) * to_wall / to_lamp;
            Some(at.x >= 20 || over > 8.0)
        });
    }
}

#[test]
fn a_lamp_that_hardly_leans_is_judged_as_f32_sees_it() {
    let slope = Field::new(9, 9, |i, _| 1000.0 * i as f32);
    for x in [4.0, 4.0 + 1e-15, 4.0 + 1e-13, 4.0 + 1e-10, 4.0 + 1e-7] {
        for y in [4000.0, 4001.0, 1e6, 3999.0, 4000.0 + 1e-9] {
            let light = lamp(x, y, 4.0);
            let twin = slope.twin();
            let sample = UVec2::new(4, 4);
            let verdict = twin.judge(&light, sample);
            let lit = twin.lit(&light, sample);
            assert_ne!(
                verdict,
                if lit {
                    ShadowVerdict::Dark
                } else {
                    ShadowVerdict::Lit
                },
                "{x} {y}"
            );
            if (y - 4000.0).abs() >= 1.0 {
                assert_ne!(verdict, ShadowVerdict::InBand, "{x} {y}");
            }
        }
    }
    // Along a border, or out of it: it is not known, but both are lit over flat ground.
    let flat = Field::new(9, 9, |_, _| 1.0);
    for x in [8.0 - 1e-15, 8.0, 8.0 + 1e-15, 8.0 + 1e-13] {
        let twin = flat.twin();
        let sample = UVec2::new(8, 2);
        assert_eq!(twin.judge(&lamp(x, 1.0, 6.0), sample), ShadowVerdict::Lit);
        assert_eq!(
            twin.judge(&lamp(x, 0.5, 6.0), sample),
            if x == 8.0 {
                ShadowVerdict::Dark
            } else {
                ShadowVerdict::InBand
            },
            "{x}"
        );
    }
}

// Brute force.

fn rough(random: &mut Random, width: u32, height: u32, top: u64) -> Field {
    let heights: Vec<f32> = (0..width * height)
        .map(|_| random.below(top + 1) as f32)
        .collect();
    Field::new(width, height, |i, j| heights[(j * width + i) as usize])
}

/// A sun or a lamp, often in a direction that meets samples and borders.
fn some_light(random: &mut Random, size: UVec2, top: f64) -> GridLight {
    let size = size.as_dvec2();
    let round = |x: f64| (x * 2.0).round() / 2.0;
    match random.below(4) {
        0 => {
            let step = |random: &mut Random| random.below(5) as f64 - 2.0;
            let (x, z) = (step(random), step(random));
            sun(x, random.within(-0.02, 1.0) * top * 0.5, z)
        }
        1 => {
            let (z, x) = random.within(0.0, TAU).sin_cos();
            sun(x, random.within(0.0, 1.0).powi(3) * top, z)
        }
        2 => lamp(
            round(random.within(-1.0, size.x)),
            round(random.within(0.0, 1.5 * top)),
            round(random.within(-1.0, size.y)),
        ),
        _ => lamp(
            random.within(-size.x, 2.0 * size.x),
            random.within(-0.1, 3.0) * top,
            random.within(-size.y, 2.0 * size.y),
        ),
    }
}

/// What marching along a ray finds: surely dark, surely lit, or neither.
fn march(field: &Field, light: &GridLight, sample: UVec2, slack: f64) -> Option<bool> {
    let from = DVec3::new(
        f64::from(sample.x),
        f64::from(field.height(sample.x, sample.y)),
        f64::from(sample.y),
    );
    let Some(ray) = light.ray(from) else {
        return Some(light.to_light(from).y >= 0.0);
    };
    let (d, last) = (ray.direction, (field.size - 1).as_dvec2());
    let end = ray.t_end.min(last.max_element());
    // Steps, borders, and the end: the surface is a quadratic between any two.
    let mut times: Vec<f64> = (1..)
        .map(|k| f64::from(k) / 64.0)
        .take_while(|&t| t < end)
        .collect();
    for n in 1..=last.max_element() as u32 {
        times.extend([d.x, d.z].map(|d| f64::from(n) / d.abs()));
    }
    times.push(end);
    times.retain(|&t| t <= end);
    times.sort_by(f64::total_cmp);
    let (mut before, mut height, mut sure) = (0.0, 0.0f64, true);
    for t in times {
        let at = from + t * d;
        let inside = |x: f64, last: f64| x >= -1e-12 && x <= last + 1e-12;
        if !inside(at.x, last.x) || !inside(at.z, last.y) {
            break;
        }
        let plan = DVec2::new(at.x, at.z).clamp(DVec2::ZERO, last);
        let cell = plan.floor().min(last - 1.0);
        let part = plan - cell;
        let corner = |i: u32, j: u32| f64::from(field.height(cell.x as u32 + i, cell.y as u32 + j));
        let row = |j: u32| corner(0, j) + (corner(1, j) - corner(0, j)) * part.x;
        let ground = row(0) + (row(1) - row(0)) * part.y;
        let above = at.y - ground;
        if above < -slack {
            return Some(false);
        }
        // No quadratic of this curvature dips below zero between them; in the first step, from zero.
        let curve = 2.0 * field.span * (d.x * d.z).abs();
        let step = t - before;
        let clear = if before == 0.0 {
            above >= 2.0 * curve * step * step
        } else {
            height.min(above) > slack + curve * step * step / 4.0
        };
        sure &= clear;
        (before, height) = (t, above);
    }
    sure.then_some(true)
}

#[test]
fn marching_in_small_steps_agrees() {
    let mut random = Random(1);
    let (mut dark, mut lit, mut neither) = (0, 0, 0);
    for _ in 0..400 {
        let size = UVec2::new(2 + random.below(7) as u32, 2 + random.below(7) as u32);
        let field = rough(&mut random, size.x, size.y, 6);
        let light = some_light(&mut random, size, 6.0);
        if !light.is_usable() {
            continue;
        }
        let twin = field.twin();
        for sample in field.places() {
            let found = march(&field, &light, sample, 1e-9);
            match found {
                Some(true) => lit += 1,
                Some(false) => dark += 1,
                None => neither += 1,
            }
            if let Some(found) = found {
                assert_eq!(
                    twin.lit(&light, sample),
                    found,
                    "{sample} of {:?} {}, {light:?}",
                    field.samples,
                    field.size
                );
            }
        }
    }
    println!("{dark} dark, {lit} lit, {neither} undecided");
    assert!(dark > 3000 && lit > 1500 && neither < (dark + lit) / 4);
}

// What f32 may make of it.

/// Arithmetic of a GPU, as careless as WGSL allows.
struct Gpu {
    /// `None`: to the nearest.
    random: Option<Random>,
    mood: u64,
}

impl Gpu {
    /// One of the two neighbours in f32: any, or for all of a ray the upper or the lower.
    fn round(&mut self, exact: f64) -> f32 {
        let near = exact as f32;
        let (below, above) = match f64::from(near).total_cmp(&exact) {
            Ordering::Less => (near, near.next_up()),
            Ordering::Equal => return near,
            Ordering::Greater => (near.next_down(), near),
        };
        let Some(random) = &mut self.random else {
            return near;
        };
        match self.mood {
            0 => below,
            1 => above,
            _ if random.below(2) == 0 => below,
            _ => above,
        }
    }

    fn mul(&mut self, a: f32, b: f32) -> f32 {
        self.round(f64::from(a) * f64::from(b))
    }

    fn add(&mut self, a: f32, b: f32) -> f32 {
        self.round(f64::from(a) + f64::from(b))
    }

    fn sub(&mut self, a: f32, b: f32) -> f32 {
        self.add(a, -b)
    }

    /// Off by up to 2.5 ulp.
    fn div(&mut self, a: f32, b: f32) -> f32 {
        let off = match &mut self.random {
            Some(random) => match self.mood {
                0 => -4.0,
                1 => 4.0,
                _ => random.within(-4.0, 4.0),
            },
            None => 0.0,
        };
        self.round(f64::from(a) / f64::from(b) * (1.0 + off * 0.5 / f64::from(1 << 24)))
    }

    /// The shadow ray, cell by cell. The ray's slope is multiplied by `tilt`: 1 for a correct one.
    fn sees(&mut self, field: &Field, light: &GridLight, sample: UVec2, tilt: f32) -> bool {
        self.mood = self.random.as_mut().map_or(0, |random| random.below(3));
        let at_sample = field.height(sample.x, sample.y);
        let place = [sample.x as f32, at_sample, sample.y as f32];
        let (mut d, mut inverse) = ([0f32; 3], [0f32; 3]);
        let mut t_end = f32::MAX;
        match light.source {
            LightSource::Directional(way) => {
                let Some(ray) = light.ray(DVec3::ZERO) else {
                    return way.y >= 0.0;
                };
                for axis in 0..3 {
                    d[axis] = ray.direction[axis] as f32;
                    inverse[axis] = (1.0 / ray.direction[axis]) as f32;
                }
            }
            LightSource::Point(position) => {
                let mut way = [0f32; 3];
                for axis in 0..3 {
                    let hi = position[axis] as f32;
                    let lo = (position[axis] - f64::from(hi)) as f32;
                    let near = self.sub(hi, place[axis]);
                    way[axis] = self.add(near, lo);
                }
                let m = way[0].abs().max(way[2].abs());
                if m == 0.0 || m < 1e-15 * way[1].abs() {
                    return way[1] >= 0.0;
                }
                for axis in 0..3 {
                    d[axis] = self.div(way[axis], m);
                    inverse[axis] = self.div(m, way[axis]);
                }
                t_end = m;
            }
        }
        d[1] *= tilt;
        for axis in [0, 2] {
            if d[axis].abs() < 1e-15 {
                d[axis] = 0.0;
            }
        }
        let at = [sample.x as i32, sample.y as i32];
        let last = [field.size.x as i32 - 2, field.size.y as i32 - 2];
        let flat = [d[0], d[2]];
        let inverse = [inverse[0], inverse[2]];
        let mut cell = [0, 0];
        for axis in 0..2 {
            cell[axis] = if flat[axis] < 0.0 {
                at[axis] - 1
            } else if flat[axis] > 0.0 {
                at[axis]
            } else {
                at[axis].min(last[axis])
            };
        }
        let y_mag = field.span as f32;
        let mut t_in = 0f32;
        loop {
            if (0..2).any(|axis| cell[axis] < 0 || cell[axis] > last[axis]) || t_in >= t_end {
                return true;
            }
            let mut leave = [f32::MAX; 2];
            for axis in 0..2 {
                if flat[axis] != 0.0 {
                    let n = cell[axis] + i32::from(flat[axis] > 0.0) - at[axis];
                    leave[axis] = self.mul(n as f32, inverse[axis]);
                }
            }
            let t_out = leave[0].min(leave[1]).min(t_end);
            let s_max = self.sub(t_out, t_in).max(0.0);
            let corner = |i: i32, j: i32| field.height((cell[0] + i) as u32, (cell[1] + j) as u32);
            let corners =
                [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| self.sub(corner(i, j), at_sample));
            let [c00, c10, c01, c11] = corners;
            let (y, y_out) = (self.mul(t_in, d[1]), self.mul(t_out, d[1]));
            let top = c00.max(c10).max(c01).max(c11);
            let bound = 32.0 / 16_777_216.0 * (y_mag + y.abs().max(y_out.abs()));
            let skipped = y.min(y_out) > top + bound;
            if !skipped
                && self.blocks(&flat, d[1], t_in, s_max, [c00, c10, c01, c11], {
                    [cell[0] - at[0], cell[1] - at[1]]
                })
            {
                return false;
            }
            t_in = t_out;
            if leave[0] <= leave[1] {
                cell[0] += if flat[0] > 0.0 { 1 } else { -1 };
            } else {
                cell[1] += if flat[1] > 0.0 { 1 } else { -1 };
            }
        }
    }

    fn blocks(
        &mut self,
        flat: &[f32; 2],
        dy: f32,
        t_in: f32,
        s_max: f32,
        [c00, c10, c01, c11]: [f32; 4],
        away: [i32; 2],
    ) -> bool {
        let [x, z] = [0, 1].map(|axis| {
            let there = self.mul(t_in, flat[axis]);
            self.sub(there, away[axis] as f32).clamp(0.0, 1.0)
        });
        let (p, q) = (self.sub(c10, c00), self.sub(c01, c00));
        let r = self.sub(c11, c01);
        let r = self.sub(r, p);
        let c = if t_in == 0.0 {
            0.0
        } else {
            let y = self.mul(t_in, dy);
            let y = self.sub(y, c00);
            let (px, qz) = (self.mul(p, x), self.mul(q, z));
            let rx = self.mul(r, x);
            let rxz = self.mul(rx, z);
            let sum = self.add(px, qz);
            let sum = self.add(sum, rxz);
            self.sub(y, sum)
        };
        let (pd, qd) = (self.mul(p, flat[0]), self.mul(q, flat[1]));
        let (xd, zd) = (self.mul(x, flat[1]), self.mul(z, flat[0]));
        let cross = self.add(xd, zd);
        let twist = self.mul(r, cross);
        let b = self.sub(dy, pd);
        let b = self.sub(b, qd);
        let b = self.sub(b, twist);
        let rd = self.mul(-r, flat[0]);
        let a = self.mul(rd, flat[1]);
        if c < 0.0 {
            return true;
        }
        let sa = self.mul(s_max, a);
        let slope = self.add(b, sa);
        let rise = self.mul(s_max, slope);
        if self.add(c, rise) < 0.0 {
            return true;
        }
        let turn = self.mul(2.0 * a, s_max);
        a > 0.0 && b < 0.0 && -b < turn && self.mul(b, b) > self.mul(4.0 * a, c)
    }
}

/// Fields from mild to as rough as can be, large enough for rounding to add up.
fn fields() -> Vec<Field> {
    let mut random = Random(7);
    let smooth = |i: u32, j: u32| {
        let (x, z) = (f64::from(i), f64::from(j));
        let wave = (x / 17.0).sin() * (z / 23.0).cos() + 0.3 * (x / 5.0 + z / 3.0).sin();
        ((wave + 1.4) * 1000.0) as f32
    };
    let mut fields = vec![
        Field::new(200, 150, smooth).codes(),
        Field::new(131, 200, |i, j| smooth(i, j) * 1e-3 - 77.7),
        Field::new(
            64,
            64,
            |i, j| if (i / 8 + j / 8) % 2 == 0 { 0.0 } else { 9.0 },
        ),
        Field::new(200, 3, smooth),
        Field::new(2, 2, smooth),
    ];
    fields.push(rough(&mut random, 150, 90, 65535).codes());
    fields.push(rough(&mut random, 2, 77, 65535));
    let wide: Vec<f32> = (0..60 * 50)
        .map(|_| random.within(-1.0, 1.0).powi(9) as f32 * 1e4)
        .collect();
    fields.push(Field::new(60, 50, |i, j| wide[(j * 60 + i) as usize]));
    fields
}

fn top(field: &Field) -> f64 {
    f64::from(field.height(0, 0)) + field.span
}

fn lights(random: &mut Random, field: &Field) -> Vec<GridLight> {
    let span = field.span;
    let size = field.size.as_dvec2();
    let mut lights = vec![
        sun(1.0, 1e-4, 0.0),
        sun(-1.0, 0.0, 1.0),
        sun(0.3, 1e-4 * span, -1.0),
        sun(1e-12, 0.02 * span, 1.0),
        lamp(size.x * 0.5, top(field), size.y * 0.5),
        lamp(1e7, 1e5 * span, -3e6),
        lamp(3.0 + 1e-9, top(field) + 1.0, 2.0 - 1e-13),
    ];
    for _ in 0..14 {
        let (z, x) = random.within(0.0, TAU).sin_cos();
        let slope = span * 10f64.powf(random.within(-3.5, 0.0));
        lights.push(sun(x, slope, z));
        lights.push(lamp(
            random.within(-0.5, 1.5) * size.x,
            top(field) + random.within(-1.0, 1.0) * span,
            random.within(-0.5, 1.5) * size.y,
        ));
    }
    lights
}

/// All samples of all fields under all lights, answered by `answer` of (lit by f32, verdict).
fn compare(
    step: usize,
    careless: bool,
    tilt: f32,
    answer: impl Fn(bool, UVec2) -> u8,
) -> ShadowTally {
    let mut all = ShadowTally::default();
    let mut random = Random(3);
    let mut gpu = Gpu {
        random: careless.then_some(Random(5)),
        mood: 0,
    };
    for (f, field) in fields().iter().enumerate() {
        let mut here = ShadowTally::default();
        let twin = field.twin();
        for light in lights(&mut random, field) {
            for sample in field.places().step_by(step) {
                let sees = gpu.sees(field, &light, sample, tilt);
                let verdict = twin.judge(&light, sample);
                let lit = twin.lit(&light, sample);
                assert_ne!(
                    verdict,
                    if lit {
                        ShadowVerdict::Dark
                    } else {
                        ShadowVerdict::Lit
                    }
                );
                here.check(sample, verdict, answer(sees, sample));
            }
        }
        println!(
            "field {f}, {}: {} lit, {} dark, {} in band, {} wrong, the first {:?}",
            field.size,
            here.lit,
            here.dark,
            here.in_band,
            here.wrong.len(),
            here.wrong.first()
        );
        all.merge(here);
    }
    all
}

fn byte(lit: bool) -> u8 {
    if lit { 255 } else { 0 }
}

#[test]
fn every_legal_rounding_is_legal() {
    for careless in [false, true] {
        compare(5, careless, 1.0, |lit, _| byte(lit)).assert_ok(0.002);
    }
}

/// A light that a sample sees just over its horizon, or not quite: closer than rounding knows.
fn grazing(random: &mut Random, twin: &ShadowTwin, sample: UVec2) -> Option<GridLight> {
    let mut azimuth = random.within(0.0, TAU);
    if random.below(3) == 0 {
        // Almost along an axis.
        azimuth = (azimuth * 4.0 / TAU).round() * TAU / 4.0
            + random.within(-1.0, 1.0) * 10f64.powf(random.within(-12.0, -2.0));
    }
    let (z, x) = azimuth.sin_cos();
    let from = twin.place(sample);
    let far = 10f64.powf(random.within(0.0, 3.0));
    let way = DVec3::new(far * x, 0.0, far * z);
    let is_lamp = random.below(2) == 0;
    let light = |y: f64| {
        let way = way + y * DVec3::Y;
        if is_lamp {
            let at = from + way;
            lamp(at.x, at.y, at.z)
        } else {
            sun(way.x, way.y, way.z)
        }
    };
    let ray = light(0.0).ray(from)?;
    let slope = twin.horizon(&ray, sample)?;
    let off = random.within(-1.0, 1.0).signum() * 10f64.powf(random.within(-8.0, -3.0));
    Some(light(slope * way.x.abs().max(way.z.abs()) * (1.0 + off)))
}

#[test]
fn legal_rounding_is_legal_on_the_very_horizon() {
    let mut random = Random(23);
    let mut gpu = Gpu {
        random: Some(Random(29)),
        mood: 0,
    };
    let mut all = ShadowTally::default();
    let mut off = 0;
    for field in fields() {
        let twin = field.twin();
        for _ in 0..20_000 {
            let sample = UVec2::new(
                random.below(field.size.x.into()) as u32,
                random.below(field.size.y.into()) as u32,
            );
            let Some(light) = grazing(&mut random, &twin, sample) else {
                continue;
            };
            let sees = gpu.sees(&field, &light, sample, 1.0);
            off += usize::from(sees != twin.lit(&light, sample));
            let legal = all.check(sample, twin.judge(&light, sample), byte(sees));
            assert!(legal, "{:?} of {light:?}", all.wrong);
        }
    }
    println!(
        "{} lit, {} dark, {} in band, of which {off} are not as in f64",
        all.lit, all.dark, all.in_band
    );
    // Rounding must have mattered, and the band must not be all.
    assert!(off > 1000);
    all.assert_ok(0.8);
}

#[test]
fn the_real_elevation_model_is_hardly_ever_in_the_band() {
    let Some(field) = crate::data::elevation_model("taiwan_central_range_4096") else {
        return;
    };
    let range = field.data_range_m();
    let field = Field {
        samples: field.samples().clone(),
        size: field.size(),
        span: (range.1 - range.0) * 16.0,
    };
    let twin = field.twin();
    let mut gpu = Gpu {
        random: Some(Random(31)),
        mood: 0,
    };
    // 20 m a texel, 16 codes a metre.
    let grid = DAffine3::from_scale(DVec3::new(20.03, 1.0 / 16.0, 20.03));
    let suns = [0.01, 1.0, 5.0, 15.0, 40.0].map(|degrees: f64| {
        let (y, along) = degrees.to_radians().sin_cos();
        let (z, x) = (degrees * 0.3 + 0.2).sin_cos();
        GridLight::directional(DVec3::new(along * x, y, along * z), 0.0, grid)
    });
    let lamps = [(40_000.0, 3000.0, 40_000.0), (11_111.0, 4000.0, 60_000.0)]
        .map(|(x, y, z)| GridLight::point(DVec3::new(x, y, z), 0.0, f64::INFINITY, grid));
    let mut all = ShadowTally::default();
    for light in suns.iter().chain(&lamps) {
        let mut here = ShadowTally::default();
        let mut of_twin = Duration::ZERO;
        for sample in field.places().step_by(8209) {
            let sees = gpu.sees(&field, light, sample, 1.0);
            let start = Instant::now();
            let verdict = twin.judge(light, sample);
            of_twin += start.elapsed();
            here.check(sample, verdict, byte(sees));
        }
        println!(
            "{:?}: {} lit, {} dark, {} in band; {of_twin:?}",
            light.source, here.lit, here.dark, here.in_band
        );
        all.merge(here);
    }
    all.assert_ok(0.005);
}

#[test]
fn wrong_answers_are_found() {
    let flipped = compare(29, false, 1.0, |lit, _| byte(!lit));
    assert!(flipped.wrong.len() > 100 * flipped.in_band.max(1));
    let one = compare(29, false, 1.0, |lit, at| {
        byte(lit != (at == UVec2::new(29, 0)))
    });
    assert!(!one.wrong.is_empty() && one.verdict(1.0).is_err());
    let tilted = compare(7, false, 1.001, |lit, _| byte(lit));
    assert!(tilted.wrong.len() > 30);
    let grey = compare(29, false, 1.0, |_, _| 128);
    assert_eq!(grey.wrong.len(), grey.samples());
}

#[test]
fn a_comparison_of_nothing_fails() {
    let mut tally = ShadowTally::default();
    assert!(tally.verdict(1.0).is_err());
    tally.check(UVec2::ZERO, ShadowVerdict::InBand, 0);
    assert!(tally.verdict(1.0).is_err());
    tally.check(UVec2::ZERO, ShadowVerdict::Dark, 0);
    tally.assert_ok(0.5);
    assert!(tally.verdict(0.4).is_err());
    assert!(!tally.check(UVec2::ZERO, ShadowVerdict::Lit, 0));
    assert!(tally.verdict(1.0).is_err());
}

// Penumbrae.

fn disc_sun(x: f64, y: f64, z: f64, radius: f64) -> GridLight {
    let grid = DAffine3::from_scale(DVec3::new(20.0, 0.5, 20.0));
    GridLight::directional(grid.matrix3 * DVec3::new(x, y, z), radius, grid)
}

#[test]
fn a_level_horizon_cuts_a_disc_exactly() {
    // 20 cells of 20 m to a wall of 100 height units of 0.5 m.
    let field = Field::new(60, 201, |i, _| if i >= 30 { 100.0 } else { 0.0 });
    let twin = field.twin();
    let at = UVec2::new(10, 100);
    let radius = 0.02f64;
    let horizon = (50.0f64 / 400.0).atan();
    for off in [-1.5, -0.9, -0.3, 0.0, 0.2, 0.7, 1.1] {
        // The middle of the disc is off by so many radii, as a tangent of the angle.
        let elevation = horizon + (off * radius.tan()).atan();
        let way = DVec3::new(elevation.cos(), elevation.sin(), 0.0);
        let grid = DAffine3::from_scale(DVec3::new(20.0, 0.5, 20.0));
        let light = GridLight::directional(way, radius, grid);
        let share = twin.visible_share(&light, at, 1);
        let expected = strip_above(-off, (-1.0, 1.0));
        assert!((share - expected).abs() < 1e-9, "{off}: {share} {expected}");
        // Cut into strips, the wall's ridge is a straight line across the disc all the same.
        for strips in [2, 3, 16, 512] {
            let finer = twin.visible_share(&light, at, strips);
            assert!(
                (finer - expected).abs() < 2e-3,
                "{off} {strips}: {finer} {expected}"
            );
        }
    }
}

#[test]
fn strips_converge() {
    let mut random = Random(11);
    let field = rough(&mut random, 40, 30, 30);
    let twin = field.twin();
    let (mut worst, mut partial) = ([0f64; 3], 0);
    for light in [
        disc_sun(1.0, 9.0, 0.4, 0.1),
        disc_sun(-0.3, 6.0, 1.0, 0.05),
        GridLight {
            radius: 60.0,
            ..GridLight::point(
                DVec3::new(300.0, 40.0, 330.0),
                0.0,
                f64::INFINITY,
                DAffine3::from_scale(DVec3::new(20.0, 0.5, 20.0)),
            )
        },
    ] {
        for sample in field.places().step_by(7) {
            let share = |strips| twin.visible_share(&light, sample, strips);
            let fine = share(512);
            assert!((0.0..=1.0 + 1e-12).contains(&fine));
            partial += usize::from(fine > 0.01 && fine < 0.99);
            for (worst, strips) in worst.iter_mut().zip([1, 16, 128]) {
                *worst = worst.max((share(strips) - fine).abs());
            }
        }
    }
    println!("{partial} in penumbra; off by {worst:?}");
    assert!(partial > 50);
    assert!(worst[1] < 0.1 && worst[2] < 0.02, "{worst:?}");
}

#[test]
fn whole_discs() {
    let flat = Field::new(30, 30, |_, _| 7.0);
    let twin = flat.twin();
    let middle = UVec2::new(15, 15);
    let share = |light: &GridLight| twin.visible_share(light, middle, 4);
    assert!((share(&disc_sun(1.0, 5.0, 0.2, 0.01)) - 1.0).abs() < 1e-12);
    assert!((share(&disc_sun(1.0, 0.0, 0.2, 0.01)) - 0.5).abs() < 1e-12);
    assert!(share(&disc_sun(1.0, -5.0, 0.2, 0.01)).abs() < 1e-12);
    // Straight above and below, and a lamp of no size.
    assert!((share(&disc_sun(0.0, 1.0, 0.0, 0.3)) - 1.0).abs() < 1e-12);
    assert!(share(&disc_sun(0.0, -1.0, 0.0, 0.3)).abs() < 1e-12);
    assert_eq!(share(&disc_sun(1.0, 1.0, 0.0, 0.0)), 1.0);
    assert_eq!(share(&lamp(3.0, 6.0, 9.0)), 0.0);
    // Half of a quarter: the horizon is level in all strips, so that strips don't matter.
    let at_horizon = GridLight {
        source: LightSource::Directional(DVec3::new(1.0, 0.0, 0.0)),
        radius: 0.1,
        range: f64::INFINITY,
        world_from_grid: DMat3::IDENTITY,
    };
    assert!((share(&at_horizon) - 0.5).abs() < 1e-12);
    // From the border outward there is no ground at all.
    let out = disc_sun(1.0, -50.0, 0.0, 0.01);
    assert_eq!(twin.visible_share(&out, UVec2::new(29, 4), 3), 1.0);
}
