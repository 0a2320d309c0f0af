//! Areas of contribution culling against dense samples of what the box covers, and against the `f64` twin.

use core::{cell::OnceCell, f32::consts::FRAC_PI_2};
use std::rc::Rc;

use bevy::{
    math::{Affine3A, DMat4, DVec2, DVec3, DVec4},
    prelude::*,
};
use bevy_skyline::{
    contribution::rank::Standard, culling::volume::LocalBox, reference::contribution::AreaTwin,
};
use proptest::{prelude::*, test_runner::TestRunner};

use super::{Claim, Found, Measured, Table, all_hold, by_name, document::number};
use crate::contribution::{Gpu, View, boxed, hard};

const ABOUT: &str = "\
The area that a box is taken to cover, against what it does cover: points of its edges, and rays through 160×160 places about it or in all \
of the picture, cut with the box in `f64`. The figure is the area of the smallest rectangle around all places that it covers, less the area it is taken \
for, of the CPU and of the GPU whichever is less: above 0 would be an object that is culled for less than it covers. The twin \
says in addition how much more than the exact rectangle it may be.";

const COVERED: Claim = Claim::none(
    "it is taken for no less than it covers, and no more than the twin allows",
    "px² short",
    "all of the box in front of the near plane lies in the rectangle, grown by the slack counted in `contribution::area`",
);
const RANKED: Claim = Claim::none(
    "it goes, or stays, as it must",
    "wrong ways",
    "comparisons of the numbers themselves",
);

/// Places along each side of the part of the picture that a box may cover.
const PLACES: u32 = 160;

type Shared = Rc<OnceCell<Option<Gpu>>>;

/// The box's local space from its own unit cube, an axis that is zero or in the plane of the others standing for a very
/// thin one across them.
fn local_from_cube(volume: &LocalBox) -> DMat4 {
    let mut axes = volume.axes.map(|axis| axis.as_dvec3());
    let largest = axes.iter().map(|axis| axis.length()).fold(0.0, f64::max);
    // The shortest first, so that the others are there when an axis across them is looked for.
    let mut order = [0, 1, 2];
    order.sort_by(|a: &usize, b: &usize| axes[*a].length().total_cmp(&axes[*b].length()));
    for k in order {
        let [a, b, c] = [axes[k], axes[(k + 1) % 3], axes[(k + 2) % 3]];
        let across = b.cross(c);
        let is_flat = across.dot(a).abs() <= 1e-15 * largest * across.length();
        if is_flat {
            let longer = if b.length() > c.length() { b } else { c };
            let any = longer.normalize_or(DVec3::X).any_orthonormal_vector();
            axes[k] = across.normalize_or(any) * (1e-7 * largest).max(1e-30);
        }
    }
    let [x, y, z] = axes.map(|axis| axis.extend(0.0));
    DMat4::from_cols(x, y, z, volume.centre.as_dvec3().extend(1.0))
}

/// Whether the ray through a place of the picture meets the cube |x|, |y|, |z| ≤ 1, between the near plane and the far.
///
/// Homogeneous throughout: along the ray a point is p + λ q, λ from 0 on the near plane to 1 infinitely far away, and each
/// side of the cube an inequality that is linear in λ.
fn is_met(cube_from_clip: &DMat4, ndc: DVec2) -> bool {
    let near = *cube_from_clip * DVec4::new(ndc.x, ndc.y, 1.0, 1.0);
    let far = *cube_from_clip * DVec4::new(ndc.x, ndc.y, 0.0, 1.0);
    let sign = if near.w < 0.0 { -1.0 } else { 1.0 };
    let (near, far) = (near * sign, far * sign);
    let (mut least, mut most) = (0.0f64, 1.0f64);
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            // w − side·x, at both ends.
            let (a, b) = (near.w - side * near[axis], far.w - side * far[axis]);
            if a < 0.0 && b < 0.0 {
                return false;
            }
            if a < 0.0 {
                least = least.max(a / (a - b));
            } else if b < 0.0 {
                most = most.min(a / (a - b));
            }
        }
    }
    least <= most
}

/// What of the picture a box may cover, from 0 to 1 each way: around its corners if all are in front of the near plane.
fn window(clip_from_cube: &DMat4) -> (DVec2, DVec2) {
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for corner in 0..8 {
        let sign = |bit: u32| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
        let clip = *clip_from_cube * DVec4::new(sign(0), sign(1), sign(2), 1.0);
        if clip.w <= 0.0 || clip.z > clip.w {
            return (DVec2::ZERO, DVec2::ONE);
        }
        let at = clip.truncate().truncate() / clip.w * 0.5 + 0.5;
        (low, high) = (low.min(at), high.max(at));
    }
    let around = 0.1 * (high - low) + 1e-12;
    let clamp = |at: DVec2| at.clamp(DVec2::ZERO, DVec2::ONE);
    (clamp(low - around), clamp(high + around))
}

/// Where points of a box's edges are seen, from 0 to 1 each way.
fn on_edges(clip_from_cube: &DMat4) -> impl Iterator<Item = DVec2> {
    let corner = |k: usize| {
        let sign = |bit: usize| if k >> bit & 1 == 0 { -1.0 } else { 1.0 };
        *clip_from_cube * DVec4::new(sign(0), sign(1), sign(2), 1.0)
    };
    let corners: [DVec4; 8] = core::array::from_fn(corner);
    let edges = (0..8).flat_map(|from| [1, 2, 4].map(|axis| (from, from | axis)));
    edges
        .filter(|(from, to)| from != to)
        .flat_map(|edge| (0..=64).map(move |k| (edge, f64::from(k) / 64.0)))
        .map(move |((from, to), share)| corners[from].lerp(corners[to], share))
        .filter(|clip| clip.w > 0.0 && clip.z >= 0.0 && clip.z <= clip.w)
        .map(|clip| clip.truncate().truncate() / clip.w * 0.5 + 0.5)
        .filter(|at| at.cmpge(DVec2::ZERO).all() && at.cmple(DVec2::ONE).all())
}

/// Area of the smallest rectangle around the places covered, and their number. units: px²
fn sampled(view: &View, world: &Affine3A, volume: &LocalBox) -> (f64, u64) {
    let linear = world.matrix3;
    let column = |v: bevy::math::Vec3A, w: f64| Vec3::from(v).as_dvec3().extend(w);
    let world = DMat4::from_cols(
        column(linear.x_axis, 0.0),
        column(linear.y_axis, 0.0),
        column(linear.z_axis, 0.0),
        column(world.translation, 1.0),
    );
    let clip_from_cube = view.clip.as_dmat4() * world * local_from_cube(volume);
    let cube_from_clip = clip_from_cube.inverse();
    let size = view.viewport.as_dvec2();
    // Of what cannot be inverted or is no number, nothing is seen.
    if !(cube_from_clip.is_finite() && size.is_finite() && size.min_element() > 0.0) {
        return (0.0, 0);
    }
    let (from, to) = window(&clip_from_cube);
    if !from.cmplt(to).all() {
        return (0.0, 0);
    }
    let (mut low, mut high, mut met) = (DVec2::INFINITY, DVec2::NEG_INFINITY, 0);
    for k in 0..PLACES * PLACES {
        let share = DVec2::new(f64::from(k % PLACES), f64::from(k / PLACES)) + 0.5;
        let at = from + (to - from) * (share / f64::from(PLACES));
        if is_met(&cube_from_clip, at * 2.0 - 1.0) {
            (low, high) = (low.min(at), high.max(at));
            met += 1;
        }
    }
    for at in on_edges(&clip_from_cube) {
        (low, high) = (low.min(at), high.max(at));
        met += 1;
    }
    if met == 0 {
        return (0.0, 0);
    }
    let sides = (high - low) * size;
    (sides.x * sides.y, met)
}

/// How much less than what it covers a box is taken for.
fn short(view: &View, areas: &[f32]) -> Found {
    let (world, volume) = &view.cases[0];
    let (covered, places) = sampled(view, world, volume);
    let twin = AreaTwin::new(view.clip, view.viewport).areas(world, volume);
    let mut worst = f64::NEG_INFINITY;
    for &area in areas {
        // The GPU writes no infinities.
        let area = if area == f32::MAX {
            f32::INFINITY
        } else {
            area
        };
        if !twin.allows(area) {
            return Err(format!("{area} px² is not allowed: {twin:?}").into());
        }
        worst = worst.max(covered - f64::from(area));
    }
    let area = areas.first().copied().unwrap_or_default();
    let note = if area.is_finite() {
        format!(
            "taken for {} px², {places} places of it seen",
            number(area.into())
        )
    } else {
        "taken for boundless".into()
    };
    Measured::noted(worst, note)
}

fn measured(gpu: &Shared, view: &View) -> Found {
    let mut areas = view.on_cpu();
    if let Some(gpu) = gpu.get_or_init(Gpu::new) {
        areas.extend(gpu.areas(view));
    }
    short(view, &areas)
}

fn named(table: &mut Table, gpu: &Shared) {
    for (name, cases) in by_name(hard(), |case| case.name) {
        let gpu = Rc::clone(gpu);
        table.case(COVERED, name, move |_| {
            let mut worst = Measured {
                value: f64::NEG_INFINITY,
                note: String::new(),
            };
            for case in &cases {
                let found = measured(&gpu, &case.view)?;
                if found.value >= worst.value {
                    worst = found;
                }
            }
            Ok(worst)
        });
    }
}

#[rustfmt::skip]
fn more(table: &mut Table, gpu: &Shared) {
    let screen = Vec2::new(64.0, 48.0);
    let lens = |fov: f32, near: f32| Mat4::perspective_infinite_reverse_rh(fov.to_radians(), 4.0 / 3.0, near);
    let see = lens(90.0, 0.1);
    let here = Affine3A::IDENTITY;
    let mut case = |name: &str, clip: Mat4, viewport: Vec2, world: Affine3A, volume: LocalBox| {
        let gpu = Rc::clone(gpu);
        let view = View { clip, viewport, cases: vec![(world, volume)] };
        table.case(COVERED, name, move |_| measured(&gpu, &view));
    };
    let at = |z: f32, half: Vec3| boxed(Vec3::NEG_Z * z, half);
    case("a lens of 179°", lens(179.0, 0.1), screen, here, at(11.0, Vec3::ONE));
    case("a lens of a hundredth of a degree", lens(0.01, 0.1), screen, here, at(2e4, Vec3::ONE));
    case("a near plane of a micrometre", lens(90.0, 1e-6), screen, here, at(1e-5, Vec3::splat(5e-6)));
    case("a near plane of a kilometre, cut by it", lens(90.0, 1e3), screen, here, at(1e3, Vec3::splat(300.0)));
    case("its front one rounding before the near plane", see, screen, here, at(0.2, Vec3::new(0.1, 0.1, 0.100_000_01)));
    case("its front one rounding behind the near plane", see, screen, here, at(0.2, Vec3::new(0.1, 0.1, 0.099_999_99)));
    case("turned by an eighth, an edge through the near plane", see, screen, Affine3A::from_rotation_translation(Quat::from_rotation_y(FRAC_PI_2 / 2.0), Vec3::NEG_Z * 1.4), at(0.0, Vec3::ONE));
    case("standing on a corner", see, screen, Affine3A::from_rotation_translation(Quat::from_euler(EulerRot::XYZ, 0.785, 0.615, 0.0), Vec3::NEG_Z * 6.0), at(0.0, Vec3::ONE));
    case("a corner exactly at the eye, turned", see, screen, Affine3A::from_rotation_translation(Quat::from_rotation_z(0.7), Vec3::ZERO), boxed(Vec3::new(1.0, 1.0, -1.0), Vec3::ONE));
    case("a needle across the whole picture", see, screen, Affine3A::from_rotation_translation(Quat::from_rotation_z(0.64), Vec3::NEG_Z * 10.0), at(0.0, Vec3::new(100.0, 1e-3, 1e-3)));
    case("a needle toward the eye", see, screen, here, at(50.0, Vec3::new(1e-3, 1e-3, 49.0)));
    case("a needle through the eye", see, screen, here, at(0.0, Vec3::new(1e-3, 1e-3, 49.0)));
    case("a plate edge-on", see, screen, here, at(10.0, Vec3::new(0.0, 1.0, 5.0)));
    case("a plate through the camera", see, screen, here, at(0.0, Vec3::new(5.0, 0.0, 5.0)));
    case("a thousandth of a pixel", see, screen, here, at(24.0, Vec3::new(5e-4, 5e-4, 0.0)));
    case("a pixel exactly, on the borders of pixels", see, screen, here, boxed(Vec3::new(0.5, 0.5, -24.0), Vec3::new(0.5, 0.5, 0.0)));
    case("its side on the picture's border", see, screen, here, boxed(Vec3::new(31.0, 0.0, -24.0), Vec3::new(1.0, 1.0, 0.0)));
    case("its side beside the picture's border by a rounding", see, screen, here, boxed(Vec3::new(33.000_004, 0.0, -24.0), Vec3::new(1.0, 1.0, 0.0)));
    case("scales of 10⁻⁶ and 10⁶ at once", see, screen, Affine3A::from_scale_rotation_translation(Vec3::new(1e-6, 1e6, 1.0), Quat::from_rotation_z(0.3), Vec3::NEG_Z * 10.0), at(0.0, Vec3::new(1e6, 1e-6, 1.0)));
    case("sheared by unequal scales", see, screen, Affine3A::from_scale(Vec3::new(1.0, 8.0, 1.0)) * Affine3A::from_rotation_translation(Quat::from_rotation_z(0.5), Vec3::NEG_Z * 30.0), at(0.0, Vec3::ONE));
    case("mirrored, cut by the near plane", see, screen, Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0)), at(0.3, Vec3::new(0.2, 0.2, 0.25)));
    case("a lens upside down and mirrored", Mat4::from_scale(Vec3::new(-1.0, -1.0, 1.0)) * see, screen, here, boxed(Vec3::new(2.0, 1.0, -11.0), Vec3::ONE));
    case("off-centre by almost a picture", Mat4::from_translation(Vec3::new(1.9, 0.0, 0.0)) * see, screen, here, boxed(Vec3::new(-25.0, 0.0, -20.0), Vec3::splat(3.0)));
    case("a picture of 16,384×1 px", see, Vec2::new(16_384.0, 1.0), here, at(11.0, Vec3::ONE));
    case("a picture of 10⁹ px a side", see, Vec2::splat(1e9), here, at(11.0, Vec3::ONE));
    case("a picture of half a pixel", see, Vec2::splat(0.5), here, at(11.0, Vec3::splat(8.0)));
    let remote = Vec3::new(1e6, -1e6, 1e6);
    case("1,000 km from the origin, a box of a metre", see * Mat4::from_translation(-remote), screen, Affine3A::from_translation(remote + Vec3::NEG_Z * 11.0), at(0.0, Vec3::ONE));
    let flat = Mat4::orthographic_rh(-32.0, 32.0, -24.0, 24.0, 1e6, -1e6);
    case("orthographic from behind to ahead", flat, screen, here, boxed(Vec3::new(3.0, 4.0, 5e5), Vec3::splat(2.0)));
    case("orthographic, standing on a corner", flat, screen, Affine3A::from_quat(Quat::from_euler(EulerRot::XYZ, 0.785, 0.615, 0.0)), at(0.0, Vec3::splat(9.0)));
}

/// Which objects go by which area.
fn ranks(table: &mut Table) {
    let standard = Standard {
        own_px2: 4.0,
        hysteresis: 1.25,
        never_px2: 1_000.0,
    };
    let goes = move |area: f32, demanded: f32, was_gone: bool| {
        area < standard.least_px2(area, 64, demanded, was_gone)
    };
    let mut rank = |name: &str, wrong: u8| {
        table.case(RANKED, name, move |_| Measured::of(f64::from(wrong)));
    };
    rank(
        "an area at the threshold stays, a rounding below goes",
        u8::from(goes(4.0, 0.0, false)) + u8::from(!goes(4.0f32.next_down(), 0.0, false)),
    );
    rank(
        "what is gone comes back at the threshold and a quarter, not before",
        u8::from(goes(5.0, 0.0, true)) + u8::from(!goes(5.0f32.next_down(), 0.0, true)),
    );
    rank(
        "a boundless area never goes, whatever is demanded",
        u8::from(goes(f32::INFINITY, f32::MAX, false)) + u8::from(goes(f32::INFINITY, 0.0, true)),
    );
    rank(
        "no area at all goes by the threshold alone",
        u8::from(!goes(0.0, 0.0, false)),
    );
    rank(
        "a sixteenth of the picture stays under any demand",
        u8::from(goes(1_000.0, f32::MAX, false)) + u8::from(goes(1_250.0, f32::MAX, true)),
    );
    rank(
        "nothing that is held goes for a demand of 0 or below",
        u8::from(goes(4.0, -1.0, false)) + u8::from(goes(4.0, -0.0, false)),
    );
}

pub fn table() -> Table {
    let mut table = Table::new("Contribution", ABOUT);
    let gpu = Shared::default();
    named(&mut table, &gpu);
    more(&mut table, &gpu);
    ranks(&mut table);
    table
}

#[test]
fn every_case_holds() {
    all_hold(&table());
}

#[test]
fn an_area_too_small_or_too_large_is_caught() {
    let case = hard().swap_remove(0);
    let area = case.view.on_cpu()[0];
    assert!(short(&case.view, &[area]).is_ok_and(|found| found.value <= 0.0));
    assert!(short(&case.view, &[area * 0.999]).is_err());
    assert!(short(&case.view, &[area * 1.01]).is_err());
    assert!(short(&case.view, &[f32::NAN]).is_err());
    // The samples alone find it, without the twin, by more than their distance.
    let (world, volume) = &case.view.cases[0];
    let (covered, places) = sampled(&case.view, world, volume);
    assert!(places > 100 && covered > f64::from(area) * 0.95 && covered <= f64::from(area));
}

/// Boxes of any kind around the eye and the near plane.
#[test]
fn any_box_near_the_eye_is_taken_for_what_it_covers() {
    let strategy = (
        prop::array::uniform3(-3.0f32..3.0),
        prop::array::uniform3(0u32..4),
        prop::array::uniform3(-3.2f32..3.2),
        (-4i32..3, 5.0f32..170.0, any::<bool>()),
    );
    let mut runner = TestRunner::new_with_rng(
        ProptestConfig {
            cases: 300,
            failure_persistence: None,
            ..Default::default()
        },
        prop::test_runner::TestRng::deterministic_rng(prop::test_runner::RngAlgorithm::ChaCha),
    );
    let result = runner.run(&strategy, |(place, half, turn, (size, fov, is_flat))| {
        let size = 10f32.powi(size);
        let near = 0.3 * size;
        let clip = if is_flat {
            Mat4::orthographic_rh(
                -2.0 * size,
                2.0 * size,
                -1.5 * size,
                1.5 * size,
                10.0 * size,
                near,
            )
        } else {
            Mat4::perspective_infinite_reverse_rh(fov.to_radians(), 4.0 / 3.0, near)
        };
        let turn = Quat::from_euler(EulerRot::XYZ, turn[0], turn[1], turn[2]);
        let world = Affine3A::from_rotation_translation(turn, Vec3::from(place) * size);
        let half = Vec3::from(half.map(|half| half as f32)) * 0.5 * size;
        let view = View {
            clip,
            viewport: Vec2::new(16.0, 12.0),
            cases: vec![(world, boxed(Vec3::ZERO, half))],
        };
        let found = short(&view, &view.on_cpu());
        prop_assert!(
            found.as_ref().is_ok_and(|found| found.value <= 0.0),
            "{:?}",
            found
        );
        Ok(())
    });
    assert!(result.is_ok(), "{result:?}");
}
