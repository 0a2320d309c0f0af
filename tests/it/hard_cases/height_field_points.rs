//! Heights and normals of a height field at points, in its own space and in the world's.

use bevy::{
    math::{DVec2, DVec3},
    prelude::*,
};
use bevy_skyline::prelude::HeightField;

use super::{
    Claim, Measured, Table,
    height_field::{SLIGHT, cliff, flat, ridge, spike, surface},
};
use crate::query::{ask, world_with};

const EXACT: Claim = Claim::none("the very number", "m", "weights of 1 and 0 are exact");
const HEIGHT: Claim = Claim {
    asserts: "the height is the bilinear one",
    bound: 0.0,
    unit: "m",
    why: "8 roundings of the corners and of the place times the slope",
};
const NORMAL: Claim = Claim {
    asserts: "the normal is the patch's",
    bound: 4.0 * f32::EPSILON as f64,
    unit: "",
    why: "4 roundings to f32 of numbers up to 1",
};
const REFUSED: Claim = Claim::none("no answer is given", "answers", "there is none");
const WORLD: Claim = Claim {
    asserts: "the world's answer is the local one, moved",
    bound: 0.0,
    unit: "m",
    why: "a rounding to f32 of the coordinates, times what the slope makes of it",
};

/// Numbers that look random, from −1 to 1.
fn noise(i: f64, j: f64) -> f64 {
    ((i * 12.989_8 + j * 78.233).sin() * 43_758.545_3).fract()
}

#[rustfmt::skip]
pub fn heights(table: &mut Table) {
    let grid = |texel: f32, top: f64| surface((17, 9), texel, move |i, j| top * noise(i, j));
    for (name, texel, top) in [("1 m", 1.0, 40.0), ("1 mm", 0.001, 0.04), ("10 km", 1e4, 9e3), ("30.87 m", 30.87, 4e3)] {
        let field = grid(texel, top);
        table.case(EXACT, format!("the height at every sample, texels of {name}"), move |_| {
            let mut worst = 0.0f64;
            for j in 0..9 {
                for i in 0..17 {
                    let at = UVec2::new(i, j).as_dvec2() * f64::from(field.texel_m());
                    let height = field.height_at_f64(at).ok_or(format!("none at {at}"))?;
                    worst = worst.max((height - field.sample_m(i, j)).abs());
                }
            }
            Measured::of(worst)
        });
    }
    // Of heights up to 40 m in cells of slopes up to 80 m.
    let rounding = |top: f64| 8.0 * f64::EPSILON * (top + 2.0 * top * 17.0);
    let field = grid(1.0, 40.0);
    table.case(HEIGHT.at_most(rounding(40.0)), "the middle of every cell is the mean of its corners", move |_| {
        let mut worst = 0.0f64;
        for j in 0..8 {
            for i in 0..16 {
                let at = UVec2::new(i, j).as_dvec2() + 0.5;
                let corners = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(a, b)| field.sample_m(i + a, j + b));
                let mean = corners.iter().sum::<f64>() / 4.0;
                worst = worst.max((field.height_at_f64(at).ok_or("none".to_string())? - mean).abs());
            }
        }
        Measured::of(worst)
    });
    let field = grid(1.0, 40.0);
    table.case(Claim { asserts: "no height beyond the cell's corners", ..HEIGHT }.at_most(rounding(40.0)), "nowhere higher than the highest corner", move |_| {
        let mut worst = f64::NEG_INFINITY;
        for k in 0..20_000u32 {
            let at = DVec2::new(16.0 * noise(f64::from(k), 1.0).abs(), 8.0 * noise(f64::from(k), 2.0).abs());
            let (i, j) = ((at.x as u32).min(15), (at.y as u32).min(7));
            let corners = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(a, b)| field.sample_m(i + a, j + b));
            let (low, high) = corners.iter().fold((f64::MAX, f64::MIN), |(low, high), h| (low.min(*h), high.max(*h)));
            let height = field.height_at_f64(at).ok_or("none".to_string())?;
            worst = worst.max(height - high).max(low - height);
        }
        Measured::of(worst)
    });
    let field = grid(1.0, 40.0);
    table.case(Claim { asserts: "the surface has no step", ..HEIGHT }.at_most(rounding(40.0)), "one rounding across every border of cells", move |_| {
        let mut worst = 0.0f64;
        for j in 0..80 {
            for border in 1..16 {
                let (x, z) = (f64::from(border), f64::from(j) * 0.1);
                let at = |x: f64| field.height_at_f64(DVec2::new(x, z)).ok_or("none".to_string());
                worst = worst.max((at(x.next_down())? - at(x)?).abs());
            }
        }
        Measured::of(worst)
    });
    table.case(HEIGHT.at_most(8.0 * f64::EPSILON * (65_535.0 + 65_535.0 * 9.0)), "halfway up a cliff of all 16 bits", |_| {
        let height = cliff().height_at_f64(DVec2::new(3.5, 2.5)).ok_or("none".to_string())?;
        Measured::of((height - 32_767.5).abs())
    });
    for (name, bad) in [("NaN", f32::NAN), ("∞", f32::INFINITY), ("−∞", f32::NEG_INFINITY), ("the next f32 below 0", 0.0f32.next_down()), ("the next f32 past the extent", 4.0f32.next_up())] {
        table.case(REFUSED, format!("height and normal at {name}"), move |_| {
            let field = flat(1.0);
            let at = [Vec2::new(bad, 1.0), Vec2::new(1.0, bad)];
            let answers = at.iter().map(|at| u8::from(field.height_at(*at).is_some()) + u8::from(field.normal_at(*at).is_some()));
            Measured::of(f64::from(answers.sum::<u8>()))
        });
    }
    let mut normal = |name: &str, field: HeightField, at: [f32; 2], expected: [f64; 3]| {
        table.case(NORMAL, name, move |_| {
            let normal = field.normal_at(at.into()).ok_or("none".to_string())?;
            Measured::of((normal.as_dvec3() - DVec3::from(expected).normalize()).length())
        });
    };
    normal("normal of flat ground", flat(1.0), [2.5, 2.5], [0.0, 1.0, 0.0]);
    normal("normal of a slope of 10⁻⁶", ridge(), [2.5, 2.5], [-SLIGHT, 1.0, 0.0]);
    normal("normal of a cliff of all 16 bits", cliff(), [3.5, 2.5], [-65_535.0, 1.0, 0.0]);
    normal("normal at a spike's tip: of the last cell there", spike(), [4.0, 4.0], [8.0, 1.0, 8.0]);
    normal("normal of a saddle at its corner", surface((2, 2), 1.0, |i, j| i * j), [1.0, 1.0], [-1.0, 1.0, -1.0]);
    normal("normal on ten-kilometre texels", surface((3, 3), 1e4, |i, _| 5e3 * i), [1.5e4, 1e4], [-0.5, 1.0, 0.0]);
    normal("normal on millimetre texels", surface((3, 3), 0.001, |i, _| 0.001 * i), [0.0015, 0.001], [-1.0, 1.0, 0.0]);
}

#[rustfmt::skip]
pub fn world(table: &mut Table) {
    let ulp = |x: f64| f64::from(f32::EPSILON) * x;
    // 2²⁴ m: there f32 knows whole metres.
    let far = Vec3::new(16_777_216.0, -1024.0, 8_388_608.0);
    let mut height = |name: &str, field: fn() -> HeightField, place: Transform, at: [f32; 2], expected: f64, slack: f64| {
        table.case(WORLD.at_most(slack), name, move |_| {
            let (mut app, _) = world_with(vec![(field(), place)]);
            let (_, height) = ask(&mut app, move |query| query.height_at(at.into())).ok_or("no ground".to_string())?;
            Measured::of((f64::from(height) - expected).abs())
        });
    };
    height("a terrain at 16,777,216 m", slope_field, Transform::from_translation(far), [far.x + 640.0, far.z + 512.0], 112.0 - 1024.0, ulp(1024.0));
    height("a terrain mirrored along X", slope_field, Transform::from_scale(Vec3::new(-1.0, 1.0, 1.0)), [-640.0, 512.0], 112.0, ulp(640.0));
    height("a terrain turned by a quarter", slope_field, Transform::from_rotation(Quat::from_rotation_y(core::f32::consts::FRAC_PI_2)), [512.0, -640.0], 112.0, 4.0 * ulp(640.0));
    height("a terrain stretched by 10⁶", flat_field, Transform::from_scale(Vec3::new(1.0, 1e6, 1.0)), [2.0, 2.0], 1e6, ulp(1e6));
    height("a terrain shrunk to a millionth", flat_field, Transform::from_scale(Vec3::splat(1e-6)), [2e-6, 2e-6], 1e-6, ulp(4e-6));
    let tilted = Transform::from_rotation(Quat::from_rotation_z(-core::f32::consts::FRAC_PI_4));
    height("a slope of 45° tilted by 45° until it is level", steep_field, tilted, [2.0, 2.0], 0.0, 16.0 * ulp(2.0));
    for (name, place) in [
        ("a terrain flattened to a scale of 0", Transform::from_scale(Vec3::new(1.0, 0.0, 1.0))),
        ("a terrain whose place is NaN", Transform::from_xyz(f32::NAN, 0.0, 0.0)),
        ("a terrain whose scale is ∞", Transform::from_scale(Vec3::splat(f32::INFINITY))),
    ] {
        table.case(REFUSED, name, move |_| {
            let (mut app, _) = world_with(vec![(flat_field(), place)]);
            let answer = ask(&mut app, move |query| query.height_at(Vec2::splat(2.0)));
            Measured::of(f64::from(u8::from(answer.is_some())))
        });
    }
}

fn slope_field() -> HeightField {
    surface((33, 33), 64.0, |i, j| 8.0 * i + 4.0 * j)
}

fn flat_field() -> HeightField {
    flat(1.0)
}

fn steep_field() -> HeightField {
    surface((5, 5), 1.0, |i, _| i)
}
