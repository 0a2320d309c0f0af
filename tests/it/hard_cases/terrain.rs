//! Rays through terrain on the GPU, in every traversal, against their `f64` twin.

use core::cell::RefCell;
use std::rc::Rc;

use bevy::prelude::*;
use bevy_skyline::{
    offline::HitImage,
    prelude::*,
    reference::{
        guard::depth_error,
        ray_cast::{Tally, Twin},
    },
    terrain::view_rays::ViewRays,
};
use proptest::{prelude::*, test_runner::TestRunner};

use super::{Claim, Found, Machine, Measured, Table, all_hold};
use crate::{
    ray_cast::{TRAVERSALS, draw, exact},
    terrain_scenes::{Scene, codes, floats, hills, look, orthographic, perspective, scene, scenes},
};

const ABOUT: &str = "\
Pictures of up to 96×64 px, every ray of which is held against its twin in `f64`. For each ray the twin says how near a \
hit may be and how far, if every rounding goes the worst way: the guard band. The figure is how much of the band, from the \
exact hit to its end, the farthest of all rays needs; all traversals must give the same picture bit by bit.";

const RAYS: Claim = Claim {
    asserts: "every ray hits where, and only where, it may; in five traversals alike",
    bound: 1.0,
    unit: "of the band",
    why: "operations counted in `reference::guard`",
};
const ALLOWED: Claim = Claim {
    asserts: "hits are no farther from the exact ground than the error allowed",
    bound: 0.0,
    unit: "px",
    why: "what is allowed, and 0.01 px that rounding adds to a hit",
};
const UNDECIDED: Claim = Claim {
    asserts: "rays of all scenes above that the twin leaves open are few",
    bound: 0.05,
    unit: "of all rays",
    why: "a comparison that leaves more open means little",
};

/// What rays of a picture needs of its guard bands.
struct Needed {
    tally: Tally,
    /// Largest share of a band, from the exact hit to the end on the side where the hit is; −∞ of no hits.
    share: f64,
}

impl Needed {
    fn nothing() -> Self {
        Self {
            tally: Tally::default(),
            share: f64::NEG_INFINITY,
        }
    }
}

/// Holds every pixel against the twin.
fn needed(field: &HeightField, rays: &ViewRays, image: &HitImage) -> Needed {
    let twin = Twin::new(field);
    let mut all = Needed::nothing();
    for (k, &ndc) in image.ndc_depth.iter().enumerate() {
        let pixel = UVec2::new(k as u32 % image.size.x, k as u32 / image.size.x).as_vec2() + 0.5;
        let verdict = twin.judge(rays, pixel, f64::from(rays.t_far));
        if !all.tally.check(rays, pixel, verdict, ndc) {
            all.share = f64::INFINITY;
            continue;
        }
        let (Some(exact), Some(earliest), true) = (verdict.exact, verdict.earliest, ndc > 0.0)
        else {
            continue;
        };
        let t = rays.view_depth(ndc) - f64::from(rays.t_base);
        let tolerance = depth_error(rays, t).0;
        let share = match verdict.latest {
            _ if t <= exact => (exact - t) / (exact - earliest + tolerance),
            Some(latest) => (t - exact) / (latest - exact + tolerance),
            None => 0.0,
        };
        all.share = all.share.max(share);
    }
    all
}

/// Draws a scene in every traversal.
fn in_every_traversal(machine: &mut Machine, scene: &Scene, total: &RefCell<Tally>) -> Found {
    let offline = machine.offline()?;
    let rays = scene.rays();
    let mut first: Option<HitImage> = None;
    let mut found = Needed::nothing();
    for (traversal, box_texels) in TRAVERSALS {
        let image = draw(offline, scene, exact(traversal, box_texels));
        match &first {
            None => {
                found = needed(&scene.field, &rays, &image);
                first = Some(image);
            }
            Some(first) => {
                let pairs = first.ndc_depth.iter().zip(&image.ndc_depth);
                let differ = pairs.filter(|(a, b)| a != b).count();
                if differ > 0 {
                    return Err(format!(
                        "{differ} px of {traversal:?} {box_texels} differ from PerTexel's"
                    )
                    .into());
                }
            }
        }
    }
    let Needed { tally, share } = found;
    tally.verdict(1.0)?;
    let note = format!(
        "{} hits, {} misses, {} open",
        tally.hits, tally.misses, tally.in_band
    );
    total.borrow_mut().merge(tally);
    Measured::noted(share, note)
}

/// How far hits are from the exact ground at an allowed error.
fn displaced(machine: &mut Machine, scene: &Scene, traversal: Traversal, error_px: f32) -> Found {
    let offline = machine.offline()?;
    let casting = TerrainRayCasting {
        traversal,
        box_texels: 16,
        max_error_px: error_px,
    };
    let image = draw(offline, scene, casting);
    let rays = ViewRays::new(&scene.inputs(error_px)).ok_or("no rays".to_string())?;
    let twin = Twin::new(&scene.field);
    let (mut worst, mut hits) = (0.0f64, 0);
    for (k, &ndc) in image.ndc_depth.iter().enumerate() {
        if ndc > 0.0 {
            let pixel =
                UVec2::new(k as u32 % image.size.x, k as u32 / image.size.x).as_vec2() + 0.5;
            let t = rays.view_depth(ndc) - f64::from(rays.t_base);
            worst = worst.max(twin.displacement_px(&rays, pixel, t));
            hits += 1;
        }
    }
    if hits < 100 {
        return Err(format!("only {hits} hits").into());
    }
    Measured::noted(worst, format!("{hits} hits"))
}

/// Name of a scene in words.
fn words(name: &str) -> String {
    name.replace('_', " ")
}

/// More scenes, each hard for a reason of its own.
#[rustfmt::skip]
fn more() -> Vec<Scene> {
    let field = || hills(65, 49, 10.0, 200.0);
    let over = || look([320.0, 400.0, 700.0], [320.0, 80.0, 240.0]);
    let rolled = |turn: f32| { let camera = over(); camera.with_rotation(camera.rotation * Quat::from_rotation_z(turn)) };
    let stripes = || codes(65, 65, 4.0, 100.0, |i, _| if i % 2 == 0 { 0 } else { 65_535 });
    let comb = || codes(65, 65, 4.0, 100.0, |i, j| if i % 4 == 0 && j % 4 == 0 { 65_535 } else { 0 });
    let steps = || codes(65, 65, 4.0, 300.0, |i, _| 8_000 * (i / 8) as u16);
    let wide = perspective(60.0, 4.0 / 3.0, 0.1);
    let placed = |name, transform: Transform| Scene {
        world_from_local: transform,
        camera: transform * over(),
        ..scene(name, field(), Transform::IDENTITY)
    };
    vec![
        scene("one_pixel", field(), over()).size(1, 1),
        scene("one_column_of_pixels", field(), over()).size(1, 64),
        scene("one_row_of_pixels", field(), over()).size(64, 1),
        scene("one_pixel_more_than_a_tile", field(), over()).size(33, 17),
        scene("a_lens_of_179_degrees", field(), look([320.0, 260.0, 240.0], [320.0, 200.0, 100.0])).projection(perspective(179.0, 1.0, 0.1)),
        scene("a_lens_of_a_hundredth_degree", field(), look([9_000.0, 3_000.0, 9_000.0], [320.0, 90.0, 240.0])).projection(perspective(0.01, 4.0 / 3.0, 0.1)),
        scene("a_near_plane_of_a_micrometre", field(), over()).projection(perspective(60.0, 4.0 / 3.0, 1e-6)),
        scene("a_micrometre_above_flat_ground", floats(33, 33, 4.0, |_, _| 12.5), look([64.0, 12.5f32.next_up(), 64.0], [0.0, 12.0, 0.0])).projection(perspective(60.0, 4.0 / 3.0, 1e-6)),
        scene("an_eye_on_the_first_corner", field(), look([0.0, 120.0, 0.0], [320.0, 60.0, 240.0])),
        scene("an_eye_on_the_plane_of_a_wall", field(), look([0.0, 50.0, -100.0], [0.0, 50.0, 480.0])),
        scene("along_a_wall_from_inside_its_plane", field(), look([640.0, 300.0, -50.0], [640.0, 0.0, 300.0])).size(61, 37),
        scene("a_lens_rolled_by_an_eighth", field(), rolled(core::f32::consts::FRAC_PI_4)),
        scene("a_lens_upside_down", field(), rolled(core::f32::consts::PI)),
        scene("stripes_of_one_sample_along", stripes(), look([130.0, 140.0, 300.0], [130.0, 50.0, 100.0])),
        scene("stripes_of_one_sample_across", stripes(), look([-60.0, 130.0, 130.0], [130.0, 60.0, 130.0])),
        scene("a_comb_of_spikes", comb(), look([-40.0, 60.0, 100.0], [130.0, 40.0, 130.0])),
        scene("steps_of_vertical_cells_and_flat_ones", steps(), look([280.0, 400.0, 330.0], [100.0, 100.0, 130.0])),
        scene("steps_level_with_a_tread", steps(), look([-20.0, 8_000.0 * 300.0 / 65_535.0 * 3.0, 130.0], [260.0, 8_000.0 * 300.0 / 65_535.0 * 3.0, 130.0])).size(61, 37),
        scene("saddles_at_a_grazing_angle", codes(65, 65, 4.0, 2.0, |i, j| if (i + j) % 2 == 0 { 0 } else { 65_535 }), look([-300.0, 4.0, 100.0], [130.0, 1.0, 130.0])),
        scene("smaller_than_a_pixel", floats(2, 2, 0.01, |_, _| 0.01), look([10.0, 10.0, 10.0], [0.005, 0.005, 0.005])).size(33, 33),
        scene("two_by_two_of_full_range_and_a_millimetre", codes(2, 2, 0.001, 1_000.0, |i, j| if i == j { 65_535 } else { 0 }), look([-0.003, 1_000.003, 0.005], [0.0005, 999.999, 0.0005])).projection(perspective(60.0, 4.0 / 3.0, 1e-4)),
        scene("heights_below_f32s_normal_range", floats(33, 33, 4.0, |i, j| 1e-40 * (i * j) as f32), look([-20.0, 40.0, -30.0], [64.0, 0.0, 64.0])),
        scene("heights_of_ten_thousand_kilometres", floats(33, 33, 1e6, |i, j| 1e7 * ((i + 2 * j) % 7) as f32 / 7.0), look([-9e6, 3e7, -9e6], [1.6e7, 0.0, 1.6e7])),
        scene("one_code_of_relief_over_the_full_range", codes(65, 65, 4.0, 8_848.0, |i, j| 30_000 + ((i ^ j) & 1) as u16), look([-60.0, 4_100.0, -60.0], [130.0, 4_050.0, 130.0])),
        placed("turned_at_ten_thousand_kilometres", Transform::from_xyz(1e7, -1e7, 1e7).with_rotation(Quat::from_euler(EulerRot::YXZ, 0.7, 0.4, -0.3))),
        scene("off_centre_by_a_whole_picture", field(), over()).projection(crate::terrain_scenes::off_centre(wide, (1.9, -1.9))),
        scene("an_orthographic_lens_thinner_than_a_cell", field(), look([320.0, 400.0, 240.0], [320.0, 0.0, 240.0])).projection(orthographic(0.01, 0.01, 0.0, 1_000.0)).size(16, 16),
        scene("an_orthographic_lens_wider_than_the_world", field(), look([320.0, 400.0, 240.0], [320.0, 0.0, 240.0])).projection(orthographic(1e6, 1e6, 0.0, 1_000.0)).size(65, 65),
    ]
}

pub fn table() -> Table {
    let mut table = Table::new("Terrain", ABOUT);
    let total = Rc::new(RefCell::new(Tally::default()));
    for scene in scenes().into_iter().chain(more()) {
        let total = Rc::clone(&total);
        table.case(RAYS, words(scene.name), move |machine| {
            in_every_traversal(machine, &scene, &total)
        });
    }
    table.case(UNDECIDED, "all of these together", move |machine| {
        machine.offline()?;
        let total = total.borrow();
        let rays = total.rays().max(1);
        Measured::noted(
            total.in_band as f64 / rays as f64,
            format!("of {rays} rays"),
        )
    });
    for (name, traversal, error_px) in [
        ("half a pixel allowed", Traversal::Hybrid, 0.5),
        (
            "half a pixel allowed, by each ray's pyramid",
            Traversal::MaxMip,
            0.5,
        ),
        ("half a pixel allowed, by boxes", Traversal::Boxes, 0.5),
        ("four pixels allowed", Traversal::Hybrid, 4.0),
        (
            "sixteen pixels allowed, more than the boxes have",
            Traversal::Hybrid,
            16.0,
        ),
        ("a thousandth of a pixel allowed", Traversal::Hybrid, 0.001),
    ] {
        let scene = scene(
            "allowed",
            hills(257, 193, 5.0, 200.0),
            look([640.0, 500.0, 1400.0], [640.0, 80.0, 480.0]),
        )
        .size(96, 64);
        let claim = ALLOWED.at_most(f64::from(error_px) + 0.01);
        table.case(claim, name, move |machine| {
            displaced(machine, &scene, traversal, error_px)
        });
    }
    table
}

#[test]
fn every_case_holds() {
    all_hold(&table());
}

#[test]
fn a_picture_of_other_ground_is_caught() {
    let mut machine = Machine::default();
    let Ok(offline) = machine.offline() else {
        return;
    };
    let scene = scene(
        "seen",
        hills(65, 49, 10.0, 200.0),
        look([320.0, 400.0, 700.0], [320.0, 80.0, 240.0]),
    );
    let image = draw(offline, &scene, exact(Traversal::Hybrid, 16));
    assert!(needed(&scene.field, &scene.rays(), &image).share <= 1.0);
    // A sample in view, up by a tenth of a metre.
    let mut other = scene.field.clone();
    let edited = other.edit(URect::new(32, 24, 33, 25), |_, _, height| height + 0.1);
    assert!(edited.is_ok());
    let found = needed(&other, &scene.rays(), &image);
    assert!(found.share > 1.0 && !found.tally.wrong.is_empty());
    // A pixel of sky where there is ground.
    let mut holed = image.clone();
    holed.ndc_depth[32 * 64 + 32] = 0.0;
    assert!(needed(&scene.field, &scene.rays(), &holed).share > 1.0);
}

/// Cameras around any small field, near it, in it and far away.
#[test]
fn any_view_of_any_small_field_agrees() {
    let mut machine = Machine::default();
    if machine.offline().is_err() {
        return;
    }
    let total = RefCell::new(Tally::default());
    let strategy = (
        (2u32..40, 2u32..40, 0u32..4),
        prop::array::uniform3(-0.5f32..1.5),
        prop::array::uniform3(0.1f32..0.9),
        (-3i32..4, 1.0f32..150.0),
    );
    let mut runner = TestRunner::new_with_rng(
        ProptestConfig {
            cases: 24,
            failure_persistence: None,
            ..Default::default()
        },
        prop::test_runner::TestRng::deterministic_rng(prop::test_runner::RngAlgorithm::ChaCha),
    );
    let machine = RefCell::new(machine);
    let result = runner.run(
        &strategy,
        |((width, height, kind), eye, target, (scale, fov))| {
            let texel = 10f32.powi(scale);
            let hash = |i: u32, j: u32| {
                (i.wrapping_mul(0x9e37_79b9) ^ j.wrapping_mul(0x85eb_ca6b))
                    .wrapping_mul(0x21f0_aaad)
                    >> 16
            };
            let top = 8.0 * texel;
            let field = codes(width, height, texel, top, |i, j| match kind {
                0 => hash(i, j) as u16,
                1 => 65_535 * (hash(i, j) & 1) as u16,
                2 => (1_500 * (i + j).min(43)) as u16,
                _ => 30_000,
            });
            let extent = Vec3::new((width - 1) as f32 * texel, top, (height - 1) as f32 * texel);
            let [eye, target] = [eye, target].map(|at| (Vec3::from(at) * extent).to_array());
            let scene = scene("any", field, look(eye, target))
                .size(24, 16)
                .projection(perspective(fov, 1.5, 0.01 * texel));
            prop_assume!(ViewRays::new(&scene.inputs(0.0)).is_some());
            let found = in_every_traversal(&mut machine.borrow_mut(), &scene, &total);
            // A view of nothing but the guard band says nothing.
            if let Err(super::Trouble::Wrong(why)) = &found
                && why.contains("nothing was compared")
            {
                return Ok(());
            }
            prop_assert!(
                found.as_ref().is_ok_and(|found| found.value <= 1.0),
                "{:?}",
                found
            );
            Ok(())
        },
    );
    assert!(result.is_ok(), "{result:?}");
    assert!(total.borrow().rays() > 5_000);
}
