//! Shadow rays and sweeps on the GPU against their `f64` twin, sample by sample.

use core::f64::consts::{FRAC_PI_2, TAU};

use bevy::{
    math::{DAffine3, DQuat, DVec3},
    prelude::*,
};
use bevy_skyline::{
    offline::{Offline, shadow::ShadowImage},
    prelude::*,
    reference::terrain_shadow::{ShadowTally, ShadowTwin},
    terrain_shadow::light::{GridLight, strip_above},
};
use proptest::{prelude::*, test_runner::TestRunner};

use super::{Claim, Found, Machine, Measured, Table, Trouble, all_hold};
use crate::terrain_shadow::{codes, metres, show, sun};

const ABOUT: &str = "\
Every light shines on ten small grounds: flat, a spike, a pit, a full-range cliff, 2×2 samples, one cell wide, noise, hills in \
metres, of millimetre and of ten-kilometre texels. `PerTexel` and `MaxMip` are held against the twin at every sample, and \
against each other bit by bit.";

const TEXELS: Claim = Claim::none(
    "no sample is lit or dark that may not be; both exact methods alike",
    "wrong samples",
    "what rounding may decide is in the twin's guard band, counted in `reference::terrain_shadow`",
);
const KNOWN: Claim = Claim::none(
    "twin and GPU say at every sample what algebra says",
    "wrong samples",
    "numbers chosen so that no rounding has a say",
);
const PENUMBRA: Claim = Claim {
    asserts: "the share of the light that is seen is the twin's",
    bound: 0.01,
    unit: "of the light",
    why: "half a byte, and twice as much for f32's slope of the horizon",
};
const SWEPT: Claim = Claim::none(
    "a sweep makes no shadow on a plane that faces the sun",
    "dark samples",
    "a plane's horizon is its own slope",
);
const UNUSABLE: Claim = Claim::none(
    "the light is known to be none",
    "lights taken for usable",
    "a light is finite, and not nowhere",
);

/// Small grounds, each hard in its own way.
#[rustfmt::skip]
fn grounds() -> Vec<(&'static str, HeightField)> {
    let hill = |i: u32, j: u32| {
        let (x, z) = (i as f32 - 17.0, j as f32 - 13.0);
        120.0 * (-(x * x + z * z) / 60.0).exp() + 9.0 * (i as f32 * 0.9).sin() * (j as f32 * 0.7).cos()
    };
    let hash = |n: u32| n.wrapping_mul(0x9e37_79b9).rotate_left(13).wrapping_mul(0x85eb_ca6b) >> 16;
    vec![
        ("flat", codes((17, 13), 20.0, |_, _| 1_000)),
        ("spike", codes((23, 21), 20.0, |i, j| if (i, j) == (11, 9) { 40_000 } else { 0 })),
        ("pit", codes((23, 21), 20.0, |i, j| if (i, j) == (11, 9) { 0 } else { 40_000 })),
        ("cliff", codes((30, 17), 20.0, |i, _| if i < 12 { 65_535 } else { 0 })),
        ("2×2", codes((2, 2), 20.0, |i, j| [100, 9_000, 300, 20][(i + 2 * j) as usize])),
        ("one cell wide", codes((2, 40), 20.0, |i, j| hash(i * 100 + j) as u16)),
        ("noise", codes((37, 21), 20.0, |i, j| hash(i * 1_000 + j) as u16)),
        ("hill", metres((35, 27), 20.0, hill)),
        ("hill of millimetre texels", metres((35, 27), 1e-3, |i, j| 5e-5 * hill(i, j))),
        ("hill of ten-kilometre texels", metres((35, 27), 1e4, |i, j| 500.0 * hill(i, j))),
    ]
}

/// A light by what it is relative to a ground, in the world that the ground stands in.
type Place = Box<dyn Fn(&HeightField, DAffine3) -> GridLight>;

fn sun_at(azimuth: f64, elevation: f64) -> Place {
    direct(sun(azimuth, elevation))
}

fn direct(way: DVec3) -> Place {
    Box::new(move |field, world| GridLight::directional(way, 0.0, world * field.local_from_grid()))
}

/// A lamp at a share of the extent, so far above the sample nearest to it: in spans of the heights.
fn lamp_at(share: [f64; 2], above: f64) -> Place {
    Box::new(move |field, world| {
        let cells = field.cells().as_dvec2();
        let texel = f64::from(field.texel_m());
        let at = [0, 1].map(|axis| (share[axis] * cells[axis]).round());
        let nearest = [0, 1].map(|axis| at[axis].clamp(0.0, cells[axis]) as u32);
        let (low, high) = field.data_range_m();
        let span = (high - low).max(1e-3 * cells.x * texel);
        let height = field.sample_m(nearest[0], nearest[1]) + above * span;
        let place = DVec3::new(at[0] * texel, height, at[1] * texel);
        let world_from_grid = world * field.local_from_grid();
        GridLight::point(
            world.transform_point3(place),
            0.0,
            f64::INFINITY,
            world_from_grid,
        )
    })
}

fn lamp_in_world(at: DVec3) -> Place {
    Box::new(move |field, world| {
        GridLight::point(at, 0.0, f64::INFINITY, world * field.local_from_grid())
    })
}

#[rustfmt::skip]
fn lights() -> Vec<(String, Place)> {
    let mut lights: Vec<(String, Place)> = Vec::new();
    let mut light = |name: &str, place: Place| lights.push((name.into(), place));
    for (way, azimuth) in [("along +X", FRAC_PI_2), ("along −Z", TAU / 2.0), ("along a diagonal", TAU / 8.0), ("askew", 1.1), ("10⁻⁷ rad off an axis", FRAC_PI_2 + 1e-7)] {
        for (height, elevation) in [("on the horizon", 0.0), ("10⁻⁴ rad above it", 1e-4), ("low", 0.05), ("high", 0.9), ("below the horizon", -0.1)] {
            light(&format!("sun {way}, {height}"), sun_at(azimuth, elevation));
        }
    }
    light("sun overhead", direct(DVec3::Y));
    light("sun 10⁻⁷ off overhead", direct(DVec3::new(1e-7, 1.0, -3e-8)));
    light("sun 10⁻¹⁷ off overhead", direct(DVec3::new(1e-17, 1.0, 1e-17)));
    light("sun underfoot", direct(DVec3::NEG_Y));
    light("sun 10⁻³⁰⁰ m long", direct(1e-300 * DVec3::new(3.0, 1.0, 2.0)));
    light("sun on the horizon, a rounding up", direct(DVec3::new(1.0, f64::EPSILON, 0.3)));
    light("sun on the horizon, a rounding down", direct(DVec3::new(1.0, -f64::EPSILON, 0.3)));
    light("sun 10⁻³⁰⁰ off the horizon", direct(DVec3::new(1.0, 1e-300, 0.3)));
    light("lamp above", lamp_at([0.5, 0.5], 0.3));
    light("lamp high above", lamp_at([0.5, 0.5], 1e6));
    light("lamp on a sample", lamp_at([0.5, 0.5], 0.0));
    light("lamp on the first corner", lamp_at([0.0, 0.0], 0.0));
    light("lamp on the last corner", lamp_at([1.0, 1.0], 0.0));
    light("lamp 10⁻⁹ spans above a sample", lamp_at([0.5, 0.5], 1e-9));
    light("lamp inside the ground", lamp_at([0.5, 0.5], -0.2));
    light("lamp far below the ground", lamp_at([0.4, 0.6], -100.0));
    light("lamp beside the terrain", lamp_at([-0.5, 0.5], 0.2));
    light("lamp below and beside", lamp_at([1.5, 0.5], -2.0));
    light("lamp beside, level with the border's samples", lamp_at([-0.5, 0.5], 0.0));
    light("lamp at 10⁷ m", lamp_in_world(DVec3::new(1e7, 3e6, -2e6)));
    light("sun as a lamp at its true distance", lamp_in_world(1.496e11 * sun(0.6, 0.328)));
    light("lamp at 10¹⁸ m", lamp_in_world(DVec3::new(7e17, 3e17, -7e17)));
    lights
}

/// Holds a map against the twin.
fn judged(field: &HeightField, light: &GridLight, image: &ShadowImage) -> ShadowTally {
    let twin = ShadowTwin::new(field.samples(), field.size());
    let mut tally = ShadowTally::default();
    for (n, visibility) in image.visibility.iter().enumerate() {
        let n = n as u32;
        let sample = UVec2::new(n % image.size.x, n / image.size.x);
        tally.check(sample, twin.judge(light, sample), *visibility);
    }
    tally
}

fn cast(
    offline: &mut Offline,
    handle: &Handle<HeightField>,
    light: &GridLight,
    method: ShadowMethod,
    strips: u32,
) -> Result<ShadowImage, String> {
    let made = offline.cast_shadow(handle.id(), light, method, strips, 1);
    made.map(|(image, _)| image).map_err(|why| why.to_string())
}

/// Shows a field while `with` looks at it.
fn shown<T>(
    machine: &mut Machine,
    field: &HeightField,
    with: impl FnOnce(&mut Offline, &Handle<HeightField>) -> Result<T, Trouble>,
) -> Result<T, Trouble> {
    let offline = machine.offline()?;
    let (terrain, handle) = show(offline, field.clone());
    let found = with(offline, &handle);
    offline.app.world_mut().despawn(terrain);
    offline.step();
    found
}

/// Both exact methods under one light on one ground, judged.
fn on_ground(
    machine: &mut Machine,
    field: &HeightField,
    light: &GridLight,
) -> Result<ShadowTally, Trouble> {
    shown(machine, field, |offline, handle| {
        let rays = cast(offline, handle, light, ShadowMethod::PerTexel, 0)?;
        let skipping = cast(offline, handle, light, ShadowMethod::MaxMip, 0)?;
        if rays != skipping {
            return Err(String::from("MaxMip answers differently").into());
        }
        Ok(judged(field, light, &rays))
    })
}

fn noted(tally: &ShadowTally) -> Found {
    let note = format!(
        "{} lit, {} dark, {} open",
        tally.lit, tally.dark, tally.in_band
    );
    if let Some(wrong) = tally.wrong.first() {
        return Err(format!("{} wrong, the first {wrong:?}", tally.wrong.len()).into());
    }
    Measured::noted(tally.wrong.len() as f64, note)
}

/// One light on all grounds, in a world of any placing.
fn on_all(machine: &mut Machine, place: &Place, world: DAffine3) -> Found {
    let mut all = ShadowTally::default();
    for (name, field) in grounds() {
        let light = place(&field, world);
        let tally = on_ground(machine, &field, &light)?;
        if let Some(wrong) = tally.wrong.first() {
            return Err(format!("{name}: {wrong:?}").into());
        }
        all.merge(tally);
    }
    if all.lit + all.dark == 0 {
        return Err(String::from("nothing was decided").into());
    }
    noted(&all)
}

/// What is known of every sample, against the twin and both exact methods.
fn known(
    machine: &mut Machine,
    field: &HeightField,
    light: &GridLight,
    is_lit: impl Fn(UVec2) -> bool,
) -> Found {
    let twin = ShadowTwin::new(field.samples(), field.size());
    let size = field.size();
    let (lit, image) = shown(machine, field, |offline, handle| {
        let image = cast(offline, handle, light, ShadowMethod::MaxMip, 0)?;
        let lit = (0..size.x * size.y)
            .map(|n| UVec2::new(n % size.x, n / size.x))
            .filter(|sample| is_lit(*sample))
            .count();
        Ok((lit, image))
    })?;
    let mut wrong = 0;
    for (n, visibility) in image.visibility.iter().enumerate() {
        let sample = UVec2::new(n as u32 % size.x, n as u32 / size.x);
        let expected = is_lit(sample);
        wrong += usize::from(twin.lit(light, sample) != expected);
        wrong += usize::from((*visibility == 255) != expected || !matches!(*visibility, 0 | 255));
    }
    Measured::noted(
        wrong as f64,
        format!("{lit} of {} lit", image.visibility.len()),
    )
}

#[rustfmt::skip]
fn by_algebra(table: &mut Table) {
    // One height unit a metre, one metre a texel.
    let metre = |size, h: fn(u32, u32) -> f32| metres(size, 1.0, h);
    let of = |field: &HeightField, way: DVec3| GridLight::directional(way, 0.0, field.local_from_grid());
    let wall = || metre((40, 4), |i, _| if i >= 30 { 8.0 } else { 0.0 });
    for (name, tangent) in [("a shadow shorter than a cell", 9.0), ("a shadow of 16½ cells", 8.0 / 16.5), ("a shadow longer than the field", 1e-4)] {
        let (field, light) = (wall(), of(&wall(), DVec3::new(1.0, tangent, 0.0)));
        table.case(KNOWN, format!("a wall of 8 m casts {name}"), move |machine| {
            known(machine, &field, &light, |at| {
                let to_wall = 30.0 - f64::from(at.x);
                to_wall <= 0.0 || to_wall * tangent > 8.0
            })
        });
    }
    let (field, light) = (wall(), of(&wall(), DVec3::new(-1.0, -0.01, 0.0)));
    table.case(KNOWN, "a sun under the horizon is seen over the border and over an edge only", move |machine| {
        known(machine, &field, &light, |at| at.x == 0 || at.x == 30)
    });
    let spike = || metre((23, 27), |i, j| if (i, j) == (11, 13) { 4.0 } else { 0.0 });
    for (name, tangent, reach) in [("at 45°", 1.01, 3), ("at 1 in 8", 0.126, 31)] {
        let (field, light) = (spike(), of(&spike(), DVec3::new(1.0, tangent, 0.0)));
        table.case(KNOWN, format!("a spike of 4 m darkens the samples of its row, sun {name}"), move |machine| {
            known(machine, &field, &light, |at| at.y != 13 || at.x >= 11 || 11 - at.x > reach)
        });
    }
    let flat = || metre((12, 7), |_, _| 2.0);
    for (name, at, is_lit) in [
        ("a lamp on the ground lights flat ground", DVec3::new(3.0, 2.0, 3.0), true),
        ("a lamp a rounding above the ground lights it", DVec3::new(3.0, 2.0_f64.next_up(), 3.0), true),
        ("a lamp 0.1 m under the ground lights nothing", DVec3::new(3.0, 1.9, 3.0), false),
        ("a lamp 10⁶ m under the ground lights nothing", DVec3::new(3.5, -1e6, 3.5), false),
        ("a lamp level with flat ground, 10⁷ m away, lights it", DVec3::new(1e7, 2.0, -1e7), true),
    ] {
        let field = flat();
        let light = GridLight::point(at, 0.0, f64::INFINITY, field.local_from_grid());
        table.case(KNOWN, name, move |machine| known(machine, &field, &light, |_| is_lit));
    }
    let convex = || metre((9, 9), |i, j| -0.5 * ((i as f32 - 4.0).powi(2) + (j as f32 - 4.0).powi(2)));
    for (name, at, is_lit) in [("a lamp over a dome", DVec3::new(4.0, 40.0, 4.0), true), ("a lamp just inside a dome's top", DVec3::new(4.0, -0.01, 4.0), false)] {
        let field = convex();
        let light = GridLight::point(at, 0.0, f64::INFINITY, field.local_from_grid());
        table.case(KNOWN, name, move |machine| known(machine, &field, &light, |_| is_lit));
    }
    let slope = || metre((17, 9), |i, j| 0.5 * i as f32 + 0.25 * j as f32);
    for (name, off, is_lit) in [("10⁻⁴ above", 1e-4, true), ("10⁻⁴ below", -1e-4, false)] {
        let (field, light) = (slope(), of(&slope(), DVec3::new(0.7, 0.5 * 0.7 + 0.25 * 0.3 + off, 0.3)));
        table.case(KNOWN, format!("a plane under a sun {name} it"), move |machine| {
            known(machine, &field, &light, |at| is_lit || at.x == 16 || at.y == 8)
        });
    }
}

#[rustfmt::skip]
fn soft(table: &mut Table) {
    let wall = || metres((60, 41), 20.0, |i, _| if i >= 30 { 50.0 } else { 0.0 });
    let horizon = (50.0f64 / 400.0).atan();
    // Sample (10, 20) is 20 cells of 20 m before a wall of 50 m.
    for (name, off) in [("all", 1.5), ("nine tenths", 0.8), ("half", 0.0), ("a tenth", -0.8), ("none", -1.5)] {
        table.case(PENUMBRA, format!("a wall that leaves {name} of the sun"), move |machine| {
            let field = wall();
            let radius = 0.02f64;
            let elevation = horizon + (off * radius.tan()).atan();
            let way = DVec3::new(elevation.cos(), elevation.sin(), 0.0);
            let light = GridLight::directional(way, radius, field.local_from_grid());
            let image = shown(machine, &field, |offline, handle| Ok(cast(offline, handle, &light, ShadowMethod::MaxMip, 1)?))?;
            let seen = f64::from(image.at(UVec2::new(10, 20))) / 255.0;
            Measured::noted((seen - strip_above(-off, (-1.0, 1.0))).abs(), format!("{seen:.3} of it seen"))
        });
    }
    let hills = || metres((49, 41), 20.0, |i, j| 120.0 * (i as f32 * 0.3).sin() * (j as f32 * 0.2).cos());
    for (name, radius, elevation) in [("a sun of no size", 0.0, 0.1), ("a sun of 10⁻⁹ rad", 1e-9, 0.1), ("a sun of the true size on the horizon", 0.00465, 0.0), ("a sun of 30°", 0.26, 0.15), ("a sun all but below the horizon", 0.05, -0.045)] {
        table.case(PENUMBRA, format!("{name} over hills"), move |machine| {
            let field = hills();
            let light = GridLight::directional(sun(1.1, elevation), radius, field.local_from_grid());
            let strips = if radius > 0.0 { 4 } else { 0 };
            let image = shown(machine, &field, |offline, handle| Ok(cast(offline, handle, &light, ShadowMethod::MaxMip, strips)?))?;
            let twin = ShadowTwin::new(field.samples(), field.size());
            let (mut worst, mut partly) = (0.0f64, 0);
            for n in (0..image.visibility.len() as u32).step_by(3) {
                let sample = UVec2::new(n % 49, n / 49);
                let share = f64::from(image.at(sample)) / 255.0;
                let exact = twin.visible_share(&light, sample, strips.max(1));
                partly += u32::from(exact > 0.0 && exact < 1.0);
                // Of no disc to speak of the answer at the very horizon is rounding's.
                if radius >= 1e-6 || !matches!(twin.judge(&light, sample), bevy_skyline::reference::terrain_shadow::ShadowVerdict::InBand) {
                    worst = worst.max((share - exact).abs());
                }
            }
            Measured::noted(worst, format!("{partly} samples partly lit"))
        });
    }
    for (name, azimuth) in [("along an axis", 0.0), ("along a diagonal", TAU / 8.0), ("askew", 1.234), ("10⁻⁷ rad off an axis", FRAC_PI_2 - 1e-7)] {
        table.case(SWEPT, format!("sweep over a plane, sun {name}"), move |machine| {
            let field = metres((45, 35), 20.0, |i, j| 3.0 * i as f32 - 2.0 * j as f32);
            let light = GridLight::directional(sun(azimuth, 0.3), 0.0, field.local_from_grid());
            let image = shown(machine, &field, |offline, handle| Ok(cast(offline, handle, &light, ShadowMethod::Sweep, 1)?))?;
            Measured::of(image.visibility.iter().filter(|byte| **byte != 255).count() as f64)
        });
    }
}

#[rustfmt::skip]
fn unusable(table: &mut Table) {
    let grid = DAffine3::from_scale(DVec3::new(20.0, 0.5, 20.0));
    let flat = DAffine3::from_scale(DVec3::new(20.0, 0.0, 20.0));
    for (name, light) in [
        ("a sun whose direction is NaN", GridLight::directional(DVec3::new(f64::NAN, 1.0, 0.0), 0.0, grid)),
        ("a sun whose direction is ∞", GridLight::directional(DVec3::new(f64::INFINITY, 1.0, 0.0), 0.0, grid)),
        ("a sun without a direction", GridLight::directional(DVec3::ZERO, 0.0, grid)),
        ("a sun whose size is NaN", GridLight::directional(DVec3::Y, f64::NAN, grid)),
        ("a lamp at −∞", GridLight::point(DVec3::new(0.0, f64::NEG_INFINITY, 0.0), 0.0, f64::INFINITY, grid)),
        ("a lamp whose range is 0", GridLight::point(DVec3::Y, 0.0, 0.0, grid)),
        ("a lamp whose range is NaN", GridLight::point(DVec3::Y, 0.0, f64::NAN, grid)),
        ("a sun over a terrain flattened to a scale of 0", GridLight::directional(DVec3::Y, 0.0, flat)),
    ] {
        table.case(UNUSABLE, name, move |_| Measured::of(f64::from(u8::from(light.is_usable()))));
    }
}

pub fn table() -> Table {
    let mut table = Table::new("Terrain shadow", ABOUT);
    for (name, place) in lights() {
        table.case(TEXELS, name, move |machine| {
            on_all(machine, &place, DAffine3::IDENTITY)
        });
    }
    let turned = DAffine3::from_scale_rotation_translation(
        DVec3::new(1.0, 2.5, 0.4),
        DQuat::from_euler(EulerRot::XYZ, 0.4, 2.0, -0.3),
        DVec3::new(1e7, -3e6, 2e6),
    );
    let mirrored = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    let upside_down = DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0));
    for (name, world, place) in [
        (
            "grounds turned and stretched at 10⁷ m, sun",
            turned,
            sun_at(1.1, 0.2),
        ),
        (
            "grounds turned and stretched at 10⁷ m, lamp on a sample",
            turned,
            lamp_at([0.5, 0.5], 0.0),
        ),
        ("grounds mirrored in X, sun", mirrored, sun_at(1.1, 0.2)),
        (
            "grounds mirrored in Y, sun from their own above",
            upside_down,
            sun_at(1.1, -0.2),
        ),
    ] {
        table.case(TEXELS, name, move |machine| on_all(machine, &place, world));
    }
    by_algebra(&mut table);
    soft(&mut table);
    unusable(&mut table);
    table
}

#[test]
fn every_case_holds() {
    all_hold(&table());
}

#[test]
fn a_map_of_another_light_is_caught() {
    let mut machine = Machine::default();
    if machine.offline().is_err() {
        return;
    }
    let (_, field) = grounds().swap_remove(7);
    let place = |elevation| sun_at(1.1, elevation)(&field, DAffine3::IDENTITY);
    let map = shown(&mut machine, &field, |offline, handle| {
        Ok(cast(offline, handle, &place(0.2), ShadowMethod::MaxMip, 0)?)
    });
    let map = map.expect("a map");
    assert!(noted(&judged(&field, &place(0.2), &map)).is_ok());
    assert!(noted(&judged(&field, &place(0.21), &map)).is_err());
    let mut grey = map.clone();
    grey.visibility[0] = 128;
    assert!(noted(&judged(&field, &place(0.2), &grey)).is_err());
    let known = known(&mut machine, &field, &place(0.2), |_| true);
    assert!(known.is_ok_and(|found| found.value > 0.0));
}

/// Lights near the hard ones, over a ground that is rough at every scale.
#[test]
fn any_light_near_a_hard_one_agrees() {
    let mut machine = Machine::default();
    if machine.offline().is_err() {
        return;
    }
    let machine = core::cell::RefCell::new(machine);
    let all = core::cell::RefCell::new(ShadowTally::default());
    let strategy = (
        (0usize..10, 0u32..5),
        (0u32..8, -12i32..0, any::<bool>()),
        (-8i32..0, any::<bool>()),
    );
    let mut runner = TestRunner::new_with_rng(
        ProptestConfig {
            cases: 48,
            failure_persistence: None,
            ..Default::default()
        },
        prop::test_runner::TestRng::deterministic_rng(prop::test_runner::RngAlgorithm::ChaCha),
    );
    let result = runner.run(
        &strategy,
        |((ground, kind), (eighth, off, is_left), (height, is_down))| {
            let (_, field) = grounds().swap_remove(ground);
            let nudge = 10f64.powi(off) * if is_left { -1.0 } else { 1.0 };
            let rise = 10f64.powi(height) * if is_down { -1.0 } else { 1.0 };
            let azimuth = f64::from(eighth) * TAU / 8.0 + nudge;
            let place = match kind {
                0..3 => sun_at(azimuth, rise),
                3 => direct(DVec3::new(nudge, 1.0, rise)),
                _ => lamp_at([f64::from(eighth) / 7.0, 0.5 + nudge], rise),
            };
            let light = place(&field, DAffine3::IDENTITY);
            let tally = on_ground(&mut machine.borrow_mut(), &field, &light);
            prop_assert!(
                tally.as_ref().is_ok_and(|tally| tally.wrong.is_empty()),
                "{:?}",
                tally
            );
            all.borrow_mut().merge(tally.unwrap_or_default());
            Ok(())
        },
    );
    assert!(result.is_ok(), "{result:?}");
    let all = all.into_inner();
    assert!(
        all.lit > 1_000 && all.dark > 1_000,
        "{} lit, {} dark",
        all.lit,
        all.dark
    );
}
