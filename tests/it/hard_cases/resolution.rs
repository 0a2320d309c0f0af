//! Resolution scale: what is drawn of a picture, and how it is stretched.

use bevy::{math::DVec4, prelude::*};
use bevy_skyline::{
    prelude::ResolutionScale,
    reference::upscale::{LinearPicture, stretch, stretch_error},
};
use proptest::prelude::*;

use super::{Claim, Found, Machine, Measured, Table, all_hold};
use crate::resolution::{drawn_twice, outside};

const ABOUT: &str = "\
How many pixels a scale draws; the stretch in `f64`, by which that of the GPU is measured, against what is known of it by hand; \
and the GPU's, of whole pictures against those of a camera that has the smaller size.";

const SIZES: Claim = Claim::none(
    "so many pixels are drawn",
    "px off",
    "the nearest whole number, at least one and never more than there are",
);
const STRETCHED: Claim = Claim {
    asserts: "the stretched picture is what is known of it",
    bound: 32.0 * f64::EPSILON,
    unit: "of the brightest",
    why: "16 taps of a product and a sum each",
};
const RANGE: Claim = Claim::none(
    "no colour beyond its four nearest pixels'",
    "beyond",
    "it is clamped to them",
);
const DRAWN: Claim = Claim::none(
    "the GPU's picture is the twin's stretch of the smaller one",
    "colours off",
    "0.6 of an 8-bit step, as graphics APIs allow for writing",
);

fn picture(size: (u32, u32), colour: impl Fn(f64, f64) -> f64) -> LinearPicture {
    let pixels = (0..size.1)
        .flat_map(|y| (0..size.0).map(move |x| (x, y)))
        .map(|(x, y)| DVec4::splat(colour(f64::from(x) + 0.5, f64::from(y) + 0.5)))
        .collect();
    LinearPicture {
        size: size.into(),
        pixels,
    }
}

/// A picture's colour at a pixel.
fn at(picture: &LinearPicture, x: u32, y: u32) -> f64 {
    picture.pixels[(y * picture.size.x + x) as usize].x
}

/// The largest difference from what is expected at a pixel's middle, in shares of the brightest.
fn off(
    picture: &LinearPicture,
    brightest: f64,
    expected: impl Fn(f64, f64) -> Option<f64>,
) -> Found {
    let (mut worst, mut compared) = (0.0f64, 0);
    for y in 0..picture.size.y {
        for x in 0..picture.size.x {
            if let Some(expected) = expected(f64::from(x) + 0.5, f64::from(y) + 0.5) {
                worst = worst.max((at(picture, x, y) - expected).abs() / brightest);
                compared += 1;
            }
        }
    }
    if compared == 0 {
        return Err(String::from("nothing was compared").into());
    }
    Measured::noted(worst, format!("{compared} px"))
}

#[rustfmt::skip]
fn sizes(table: &mut Table) {
    for (name, scale, size, expected) in [
        ("half of 160×90", 0.5, (160, 90), (80, 45)),
        ("three quarters of odd sides", 0.75, (161, 91), (121, 68)),
        ("half of odd sides, rounded up", 0.5, (161, 91), (81, 46)),
        ("one pixel of one", 0.25, (1, 1), (1, 1)),
        ("a column of pixels", 0.25, (1, 720), (1, 180)),
        ("nothing of nothing", 0.25, (0, 5), (0, 1)),
        ("the largest side there is", 1.0, (u32::MAX, 3), (u32::MAX, 3)),
        ("a quarter of the largest side there is", 0.25, (u32::MAX, u32::MAX), (1 << 30, 1 << 30)),
        ("a rounding below 1", 1.0f32.next_down(), (1920, 1080), (1920, 1080)),
        ("a rounding below the least", 0.25f32.next_down(), (160, 96), (40, 24)),
        ("a scale of 0", 0.0, (160, 96), (40, 24)),
        ("a scale of −3", -3.0, (160, 96), (40, 24)),
        ("a scale of 7", 7.0, (160, 96), (160, 96)),
        ("a scale of NaN", f32::NAN, (33, 3), (33, 3)),
        ("a scale of ∞", f32::INFINITY, (33, 3), (33, 3)),
        ("a scale of −∞", f32::NEG_INFINITY, (32, 4), (8, 1)),
        ("a subnormal scale", 1e-40, (160, 96), (40, 24)),
    ] {
        table.case(SIZES, name, move |_| {
            let drawn = ResolutionScale(scale).drawn_size(UVec2::from(size));
            let off = drawn.x.abs_diff(expected.0) + drawn.y.abs_diff(expected.1);
            Measured::noted(f64::from(off), format!("{}×{}", drawn.x, drawn.y))
        });
    }
}

#[rustfmt::skip]
fn stretches(table: &mut Table) {
    let wave = |x: f64, y: f64| 0.5 + 0.5 * (12.9 * x + 78.2 * y).sin();
    table.case(STRETCHED, "to its own size", move |_| off(&stretch(&picture((9, 7), wave), UVec2::new(9, 7)), 1.0, |x, y| Some(wave(x, y))));
    table.case(STRETCHED, "one colour, to any size", |_| off(&stretch(&picture((5, 3), |_, _| 0.3), UVec2::new(31, 17)), 1.0, |_, _| Some(0.3)));
    table.case(STRETCHED, "one pixel, to 64×64", |_| off(&stretch(&picture((1, 1), |_, _| 0.7), UVec2::splat(64)), 1.0, |_, _| Some(0.7)));
    table.case(STRETCHED, "one row, to a picture", |_| off(&stretch(&picture((6, 1), |_, _| 0.2), UVec2::new(24, 24)), 1.0, |_, _| Some(0.2)));
    table.case(STRETCHED, "a picture of no pixels becomes black", |_| off(&stretch(&picture((0, 0), |_, _| 1.0), UVec2::new(4, 4)), 1.0, |_, _| Some(0.0)));
    for (name, small, large) in [("a slope, 20×12 to 53×30", (20, 12), (53, 30)), ("a slope, 8×8 to 4 times as many", (8, 8), (16, 16)), ("a slope, 30×30 to 31×31", (30, 30), (31, 31))] {
        table.case(STRETCHED, name, move |_| {
            let ratio = UVec2::from(small).as_dvec2() / UVec2::from(large).as_dvec2();
            let end = UVec2::from(small).as_dvec2();
            let stretched = stretch(&picture(small, |x, y| 0.3 * x + 0.7 * y), UVec2::from(large));
            off(&stretched, 0.3 * end.x + 0.7 * end.y, |x, y| {
                let at = bevy::math::DVec2::new(x, y) * ratio;
                // Away from the border, where the nearest pixel stands in for what is beyond.
                (at.min_element() > 2.0 && (end - at).min_element() > 2.0).then_some(0.3 * at.x + 0.7 * at.y)
            })
        });
    }
    table.case(STRETCHED, "mirrored before or after, the same", move |_| {
        // No pixel's middle on one of the smaller picture: there the nearest four are either side's.
            let (small, large) = ((11, 7), UVec2::new(28, 18));
        let there = stretch(&picture(small, wave), large);
        let mirrored = stretch(&picture(small, |x, y| wave(11.0 - x, y)), large);
        off(&mirrored, 1.0, |x, y| Some(at(&there, 27 - x as u32, y as u32)))
    });
    table.case(STRETCHED, "turned on its side before or after, the same", move |_| {
        let there = stretch(&picture((11, 7), wave), UVec2::new(29, 19));
        let turned = stretch(&picture((7, 11), |x, y| wave(y, x)), UVec2::new(19, 29));
        off(&turned, 1.0, |x, y| Some(at(&there, y as u32, x as u32)))
    });
    table.case(STRETCHED, "as bright as 10³⁰", |_| off(&stretch(&picture((5, 3), |_, _| 1e30), UVec2::new(31, 17)), 1e30, |_, _| Some(1e30)));
    for (name, dark, bright) in [("an edge from 0 to 1", 0.0, 1.0), ("an edge from 0 to 10⁴, as of the sun", 0.0, 1e4), ("an edge below 0", -1.0, 0.0), ("an edge of one rounding", 1.0, 1.0 + f64::EPSILON)] {
        for (shape, is_checked) in [("straight", false), ("of a checkerboard", true)] {
            table.case(RANGE, format!("{name}, {shape}"), move |_| {
                let colour = |x: f64, y: f64| {
                    let odd = if is_checked { (x as u32 + y as u32) % 2 == 1 } else { x > 4.0 };
                    if odd { bright } else { dark }
                };
                let stretched = stretch(&picture((8, 8), colour), UVec2::splat(31));
                let beyond = stretched.pixels.iter().map(|pixel| (pixel.x - bright).max(dark - pixel.x));
                Measured::of(beyond.fold(f64::NEG_INFINITY, f64::max))
            });
        }
    }
    table.case(Claim { asserts: "errors stay within their stated bound", ..RANGE }, "pixels off by a hundredth, up and down in turn", move |_| {
        let any = picture((9, 7), wave);
        let error = picture((9, 7), |_, _| 0.01);
        let mut moved = any.clone();
        for (k, pixel) in moved.pixels.iter_mut().enumerate() {
            *pixel += DVec4::splat(if k % 2 == 0 { 0.01 } else { -0.01 });
        }
        let large = UVec2::new(22, 19);
        let (there, here, bound) = (stretch(&any, large), stretch(&moved, large), stretch_error(&error, large));
        let over = there.pixels.iter().zip(&here.pixels).zip(&bound.pixels).map(|((a, b), bound)| (a.x - b.x).abs() - bound.x - 1e-15);
        Measured::of(over.fold(f64::NEG_INFINITY, f64::max))
    });
}

/// A few cubes, drawn at a scale and by a camera of the smaller size.
fn drawn(machine: &mut Machine, size: UVec2, scale: f32, msaa: Msaa) -> Found {
    let offline = machine.offline()?;
    let world = offline.app.world_mut();
    let cube = world
        .resource_mut::<Assets<Mesh>>()
        .add(Cuboid::from_length(2.0));
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    let colours = [10.0, 130.0, 250.0].map(|hue| {
        materials.add(StandardMaterial {
            base_color: Color::hsl(hue, 0.9, 0.5),
            unlit: true,
            ..default()
        })
    });
    let cubes: Vec<Entity> = colours
        .into_iter()
        .enumerate()
        .map(|(k, colour)| {
            let place = Transform::from_xyz(3.0 * (k as f32 - 1.0), 1.0, 0.0)
                .with_rotation(Quat::from_rotation_y(0.4 + k as f32));
            world
                .spawn((Mesh3d(cube.clone()), MeshMaterial3d(colour), place))
                .id()
        })
        .collect();
    let [large, small] = drawn_twice(offline, size, scale, || msaa);
    for cube in cubes {
        offline.app.world_mut().despawn(cube);
    }
    let shown = large
        .pixels()
        .filter(|pixel| *pixel != large.get_pixel(0, 0))
        .count();
    if shown == 0 && size.min_element() > 8 {
        return Err(String::from("nothing is in the picture").into());
    }
    let (wrong, compared) = outside(&large, &small, 0.0);
    Measured::noted(
        wrong as f64,
        format!(
            "of {compared}, {}×{} stretched to {}×{}",
            small.width(),
            small.height(),
            size.x,
            size.y
        ),
    )
}

pub fn table() -> Table {
    let mut table = Table::new("Resolution", ABOUT);
    sizes(&mut table);
    stretches(&mut table);
    for (name, size, scale, msaa) in [
        ("drawn at a quarter", UVec2::new(96, 64), 0.25, Msaa::Off),
        (
            "drawn at a half, of four samples a pixel",
            UVec2::new(96, 64),
            0.5,
            Msaa::Sample4,
        ),
        ("drawn at a third", UVec2::new(96, 66), 1.0 / 3.0, Msaa::Off),
        (
            "drawn at 31 of 32",
            UVec2::new(96, 64),
            31.0 / 32.0,
            Msaa::Off,
        ),
        ("one pixel drawn for 4×4", UVec2::new(4, 4), 0.25, Msaa::Off),
        (
            "a row of 4 px high and 256 px long",
            UVec2::new(256, 4),
            0.25,
            Msaa::Off,
        ),
    ] {
        table.case(DRAWN, name, move |machine| {
            drawn(machine, size, scale, msaa)
        });
    }
    table
}

#[test]
fn every_case_holds() {
    all_hold(&table());
}

#[test]
fn another_stretch_is_caught() {
    let small = picture((20, 12), |x, y| 0.3 * x + 0.7 * y);
    let mut large = stretch(&small, UVec2::new(53, 30));
    let truth = large.clone();
    let same = |large: &LinearPicture| {
        off(large, 15.0, |x, y| Some(at(&truth, x as u32, y as u32)))
            .is_ok_and(|found| found.value <= STRETCHED.bound)
    };
    assert!(same(&large));
    large.pixels[700].x += 1e-12;
    assert!(!same(&large));
    let nothing = off(&large, 15.0, |_, _| None);
    assert!(nothing.is_err());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, rng_seed: prop::test_runner::RngSeed::Fixed(59), failure_persistence: None, ..Default::default() })]

    /// Any picture stretched to any size stays within its colours, and any scale draws a size there is.
    #[test]
    fn any_stretch_stays_in_range(small in (1u32..9, 1u32..9), large in (1u32..30, 1u32..30), seed in 0u32..1000, scale: f32) {
        let hash = |x: f64, y: f64| ((f64::from(seed) + 12.9 * x + 78.2 * y).sin() * 43_758.545_3).fract();
        let any = picture(small, hash);
        let most = any.pixels.iter().map(|pixel| pixel.x).fold(f64::MIN, f64::max);
        let least = any.pixels.iter().map(|pixel| pixel.x).fold(f64::MAX, f64::min);
        for pixel in stretch(&any, UVec2::from(large)).pixels {
            prop_assert!((least..=most).contains(&pixel.x));
        }
        let drawn = ResolutionScale(scale).drawn_size(UVec2::from(large));
        prop_assert!(drawn.cmpge(UVec2::ONE).all() && drawn.cmple(UVec2::from(large)).all());
    }
}
