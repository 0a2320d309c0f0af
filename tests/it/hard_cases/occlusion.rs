//! Verdicts of occlusion culling, on the CPU and by the shipped WGSL, against the `f64` twin; and cameras that jump.

use core::{cell::OnceCell, f32::consts::FRAC_PI_2};
use std::rc::Rc;

use bevy::{
    math::{Affine3A, Mat3A},
    prelude::*,
};
use bevy_skyline::{
    culling::volume::LocalBox,
    occlusion::{
        DepthSampling,
        depth::ReducedDepth,
        verdict::{DepthTest, Verdict},
    },
    reference::occlusion::OcclusionTwin,
};
use proptest::{prelude::*, test_runner::TestRunner};

use super::{Claim, Found, Measured, Table, all_hold, by_name, no_device};
use crate::{
    occlusion_app::{Scene, always, eye},
    occlusion_cases::{
        Case, Random, boxed, filled, flat_lens, hard_cases, lens, local_box, over_pixels, placed,
        random_view, reduced,
    },
    occlusion_twin::{Gpu, case_judgement, case_verdict},
};

const ABOUT: &str = "\
A volume against a reduced depth buffer of 64×48 px, if nothing else is said: outside the view, hidden, or visible. The CPU's \
verdict, the GPU's and the one expected must be the same, and the twin must allow it: no visible thing may be removed, and \
nothing that is hidden by more than rounding may be kept. The last ones are whole pictures of an app, with culling and \
without.";

const VERDICT: Claim = Claim::none(
    "CPU and GPU come to the verdict expected, which the twin allows",
    "other verdicts",
    "what rounding may decide is in the twin's guard band, counted in `reference::occlusion`",
);
const ALLOWED: Claim = Claim::none(
    "CPU and GPU come to one verdict, which the twin allows",
    "other verdicts",
    "the twin's guard band, counted in `reference::occlusion`",
);
const PICTURE: Claim = Claim::none(
    "the culled picture is the unculled one, from the first frame on",
    "px that differ",
    "nothing visible may be missing",
);

/// The GPU's pass, made when it is first asked for.
type Shared = Rc<OnceCell<Option<Gpu>>>;

/// Compares all three; with no verdict expected, the CPU's counts as that.
fn compared(gpu: &Shared, depth: &ReducedDepth, case: &Case, expected: Option<Verdict>) -> Found {
    let judgement = case_judgement(&OcclusionTwin::new(depth), case);
    let cpu = case_verdict(&DepthTest::new(depth), case);
    let expected = expected.unwrap_or(cpu);
    let mut wrong = u8::from(!judgement.allows(cpu)) + u8::from(cpu != expected);
    let mut words = format!("{expected:?}").to_lowercase();
    match gpu.get_or_init(Gpu::new) {
        Some(gpu) => {
            let found = gpu.verdicts(depth, core::slice::from_ref(case));
            wrong += u8::from(found != [expected]);
        }
        None => words += ", on the CPU only",
    }
    if judgement.is_in_band() {
        words += ", rounding has a say";
    }
    if wrong > 0 {
        return Err(format!("CPU {cpu:?}, expected {expected:?}, {judgement:?}").into());
    }
    Measured::noted(f64::from(wrong), words)
}

/// The named cases there are, those of one name together.
fn named(table: &mut Table, gpu: &Shared) {
    for (name, cases) in by_name(hard_cases(), |case| case.name) {
        let gpu = Rc::clone(gpu);
        table.case(VERDICT, name, move |_| {
            let mut note = String::new();
            for case in &cases {
                note = compared(&gpu, &case.depth, &case.case, Some(case.expected))?.note;
            }
            if cases.len() > 1 {
                note += &format!(", {} of this kind", cases.len());
            }
            Measured::noted(0.0, note)
        });
    }
}

fn turned(case: Case, turn: Quat) -> Case {
    let world = case.world * Affine3A::from_quat(turn);
    Case { world, ..case }
}

#[rustfmt::skip]
fn more(table: &mut Table, gpu: &Shared) {
    use Verdict::{Hidden, Outside, Visible};
    let mut case = |name: &str, depth: ReducedDepth, case: Case, expected: Option<Verdict>| {
        let gpu = Rc::clone(gpu);
        let claim = if expected.is_some() { VERDICT } else { ALLOWED };
        table.case(claim, name, move |_| compared(&gpu, &depth, &case, expected));
    };
    let see = lens(0.1);
    let ahead = |z: f32, half: f32| boxed(0.0, 0.0, z, half);
    // Extremes of reverse-Z.
    case("depth of the smallest normal f32, a box at 10¹⁰ m", filled(see, f32::MIN_POSITIVE), ahead(-1e10, 1e3), Some(Visible));
    case("subnormal depth, a box at 10⁶ m", filled(see, 1e-40), ahead(-1e6, 1e3), Some(Visible));
    case("depth of −0", filled(see, -0.0), ahead(-1e6, 1.0), Some(Visible));
    case("depth one rounding below 1, a box at the near plane's distance and a tenth", filled(see, 1.0f32.next_down()), ahead(-0.2, 0.01), Some(Hidden));
    case("depth above 1", filled(see, 1.5), ahead(-20.0, 1.0), Some(Visible));
    case("depth below 0", filled(see, -0.5), ahead(-20.0, 1.0), Some(Visible));
    case("a near plane of a micrometre, behind a wall at a kilometre", filled(lens(1e-6), 1e-9), ahead(-2e3, 1.0), Some(Hidden));
    case("a near plane of a kilometre, behind a wall at ten", filled(lens(1e3), 0.1), ahead(-2e4, 1e2), Some(Hidden));
    // The very depth of the wall, in front and behind by little.
    for (name, z) in [("its front at the wall's very depth", -11.0), ("its front 10⁻⁵ behind the wall", -11.0001), ("its front 10⁻⁶ before the wall", -10.999_99)] {
        case(name, filled(see, 0.1 / 10.0), ahead(z, 1.0), None);
    }
    // Lenses.
    let angle = |fov: f32, near: f32| Mat4::perspective_infinite_reverse_rh(fov.to_radians(), 4.0 / 3.0, near);
    case("a lens of 179°", filled(angle(179.0, 0.1), 0.01), ahead(-20.0, 1.0), Some(Hidden));
    case("a lens of a hundredth of a degree", filled(angle(0.01, 0.1), 1e-5), ahead(-2e4, 10.0), Some(Hidden));
    let mirror = Mat4::from_scale(Vec3::new(-1.0, 1.0, 1.0));
    case("a lens that mirrors", filled(mirror * see, 0.01), ahead(-20.0, 1.0), Some(Hidden));
    case("a lens upside down", filled(Mat4::from_scale(Vec3::new(1.0, -1.0, 1.0)) * see, 0.01), ahead(-20.0, 1.0), Some(Hidden));
    let shifted = Mat4::from_translation(Vec3::new(1.9, 0.0, 0.0)) * see;
    case("off-centre by almost a picture, in its middle", filled(shifted, 0.01), ahead(-20.0, 1.0), Some(Outside));
    case("off-centre by almost a picture, where it looks", filled(shifted, 0.01), boxed(-45.0, 0.0, -20.0, 1.0), Some(Hidden));
    let flat_off = Mat4::from_translation(Vec3::new(0.5, 0.5, 0.0)) * flat_lens();
    case("orthographic and off-centre", filled(flat_off, 0.9), boxed(-20.0, -15.0, -50.0, 1.0), Some(Hidden));
    // Shapes.
    let eighth = Quat::from_rotation_y(FRAC_PI_2 / 2.0);
    case("a box turned by an eighth, an edge at the wall", filled(see, 0.01), turned(placed(Affine3A::from_translation(Vec3::Z * -11.5), local_box(Vec3::ZERO, Vec3::ONE)), eighth), Some(Hidden));
    case("a needle of a kilometre and a micrometre", filled(see, 0.01), placed(Affine3A::IDENTITY, local_box(Vec3::NEG_Z * 20.0, Vec3::new(1e3, 1e-6, 1e-6))), Some(Hidden));
    case("a needle toward the eye, through the wall", filled(see, 0.01), placed(Affine3A::IDENTITY, local_box(Vec3::NEG_Z * 20.0, Vec3::new(1e-6, 1e-6, 15.0))), Some(Visible));
    case("a plate of 10¹² m", filled(see, 0.01), placed(Affine3A::IDENTITY, local_box(Vec3::NEG_Z * 20.0, Vec3::new(1e12, 1e12, 0.0))), Some(Hidden));
    let flat_axes = |axes| placed(Affine3A::IDENTITY, LocalBox { centre: Vec3::NEG_Z * 20.0, axes });
    case("axes that are one and the same", filled(see, 0.01), flat_axes([Vec3::X; 3]), Some(Hidden));
    case("subnormal axes", filled(see, 0.01), flat_axes([Vec3::splat(1e-40); 3]), Some(Hidden));
    case("a scale of 10⁻¹⁵ of a box of 10¹⁵ m", filled(see, 0.01), placed(Affine3A { matrix3: Mat3A::from_diagonal(Vec3::splat(1e-15)), translation: Vec3::new(0.0, 0.0, -20.0).into() }, local_box(Vec3::ZERO, Vec3::splat(1e15))), Some(Hidden));
    case("around the camera by a hair more than the near plane", filled(see, 0.01), ahead(0.0, 0.100_001), Some(Visible));
    case("wholly between the eye and the near plane", filled(see, 0.01), ahead(-0.05, 0.049), Some(Outside));
    // Viewports and blocks.
    let pixels = |depth: f32, size: UVec2| vec![depth; (size.x * size.y) as usize];
    let wide = UVec2::new(16_384, 1);
    case("a viewport of 16,384×1 px", reduced(flat_lens(), wide, DepthSampling::Conservative { block: 64 }, &pixels(0.9, wide)), ahead(-50.0, 20.0), Some(Hidden));
    let mut holed = pixels(0.9, wide);
    holed[16_383] = 0.0;
    case("a viewport of 16,384×1 px, a hole in its last", reduced(flat_lens(), wide, DepthSampling::Conservative { block: 64 }, &holed), placed(Affine3A::IDENTITY, local_box(Vec3::NEG_Z * 50.0, Vec3::new(40.0, 1.0, 1.0))), Some(Visible));
    case("a viewport of one pixel in a block of 64", reduced(see, UVec2::ONE, DepthSampling::Conservative { block: 64 }, &[0.01]), ahead(-20.0, 1.0), Some(Hidden));
    case("a block of its own choice", reduced(see, UVec2::new(61, 47), DepthSampling::Conservative { block: 0 }, &pixels(0.01, UVec2::new(61, 47))), ahead(-20.0, 1.0), Some(Hidden));
    case("strides of 64 both ways", reduced(flat_lens(), UVec2::new(64, 48), DepthSampling::Strided { x: 64, y: 64 }, &pixels(0.9, UVec2::new(64, 48))), over_pixels([0.5, 63.0], [0.5, 47.0]), Some(Hidden));
    for (name, x) in [("its right side on the picture's left border", [-8.0, 0.0]), ("its left side on the picture's right border", [64.0, 72.0])] {
        case(name, filled(flat_lens(), 0.9), over_pixels(x, [10.0, 20.0]), None);
    }
    let screen = UVec2::new(64, 48);
    let mut near = pixels(0.9, screen);
    near[21 * 64 + 22] = 0.0;
    let one_hole = reduced(flat_lens(), screen, DepthSampling::Conservative { block: 1 }, &near);
    for (name, right, expected) in [
        ("its side on the border of a pixel that is a hole", 22.0, Some(Visible)),
        ("its side 10⁻³ px short of a hole, which a rasteriser may snap it into", 21.999, None),
        ("its side a fortieth of a pixel short of a hole", 21.975, Some(Hidden)),
        ("its side 10⁻³ px into a hole", 22.001, Some(Visible)),
    ] {
        case(name, one_hole.clone(), over_pixels([20.1, right], [21.1, 21.9]), expected);
    }
}

/// Pictures of an app whose camera jumps, culled and not.
fn jumps(table: &mut Table) {
    let places = |name: &str| -> Vec<Transform> {
        let front = eye(Vec3::new(0.0, 2.0, 20.0), Vec3::new(0.0, 2.0, 0.0));
        match name {
            "beyond the wall" => vec![eye(Vec3::new(0.0, 2.0, 5.0), Vec3::new(0.0, 2.0, -20.0))],
            "to the other side and back, every frame" => {
                let back = eye(Vec3::new(0.0, 4.0, -45.0), Vec3::new(0.0, 2.0, 0.0));
                vec![back, front, back, front]
            }
            "high above, straight down" => {
                vec![Transform::from_xyz(0.0, 60.0, -12.0).looking_to(Vec3::NEG_Y, Vec3::NEG_Z)]
            }
            "half a turn in place" => vec![
                eye(Vec3::new(0.0, 2.0, 20.0), Vec3::new(0.0, 2.0, 40.0)),
                front,
            ],
            "upside down" => {
                vec![front.with_rotation(Quat::from_rotation_z(core::f32::consts::PI))]
            }
            _ => vec![eye(Vec3::new(12.0, 2.0, 9.9), Vec3::new(-12.0, 2.0, 9.0))],
        }
    };
    for name in [
        "beyond the wall",
        "to the other side and back, every frame",
        "high above, straight down",
        "half a turn in place",
        "upside down",
        "along the wall, a tenth of a metre before it",
    ] {
        table.case(PICTURE, format!("a camera jumps: {name}"), move |_| {
            let scene = Scene::new(always(), || Msaa::Off);
            let mut scene = scene.ok_or_else(no_device)?;
            // Until what the wall hides is removed.
            let mut removed = 0;
            for _ in 0..8 {
                removed = scene.step().removed;
            }
            let mut worst = 0;
            for place in places(name) {
                scene.look(place);
                for _ in 0..3 {
                    scene.step();
                    worst = worst.max(scene.differing().0);
                }
            }
            if removed < 50 {
                return Err(format!("only {removed} removed before it jumped").into());
            }
            Measured::noted(worst as f64, format!("{removed} removed before"))
        });
    }
}

pub fn table() -> Table {
    let mut table = Table::new("Occlusion", ABOUT);
    let gpu = Shared::default();
    named(&mut table, &gpu);
    more(&mut table, &gpu);
    jumps(&mut table);
    table
}

#[test]
fn every_case_holds() {
    all_hold(&table());
}

#[test]
fn another_verdict_or_depth_is_caught() {
    let gpu = Shared::default();
    let (wall, behind) = (filled(lens(0.1), 0.01), boxed(0.0, 0.0, -20.0, 1.0));
    assert!(compared(&gpu, &wall, &behind, Some(Verdict::Hidden)).is_ok());
    for other in [Verdict::Visible, Verdict::Outside] {
        assert!(compared(&gpu, &wall, &behind, Some(other)).is_err());
    }
    let sky = filled(lens(0.1), 0.0);
    assert!(compared(&gpu, &sky, &behind, Some(Verdict::Hidden)).is_err());
}

/// Each named box moved and stretched a little, and much.
#[test]
fn what_is_near_a_hard_case_is_judged_alike() {
    let gpu = Gpu::new();
    let cases = hard_cases();
    let mut runner = TestRunner::new_with_rng(
        ProptestConfig {
            cases: 150,
            failure_persistence: None,
            ..Default::default()
        },
        prop::test_runner::TestRng::deterministic_rng(prop::test_runner::RngAlgorithm::ChaCha),
    );
    let strategy = (0..cases.len(), -7i32..2, any::<u64>());
    let result = runner.run(&strategy, |(number, size, seed)| {
        let hard = &cases[number];
        let size = 10f64.powi(size);
        let mut random = Random(seed);
        // Many at once: a dispatch costs more than what it does.
        let near: Vec<Case> = (0..32)
            .map(|_| {
                let mut case = hard.case.clone();
                let mut by = |x: f32| x + (random.within(-size, size) as f32) * x.abs().max(1e-3);
                let volume = &mut case.volume;
                for place in core::iter::once(&mut volume.centre).chain(&mut volume.axes) {
                    *place = Vec3::from_array(place.to_array().map(&mut by));
                }
                case
            })
            .collect();
        let test = DepthTest::new(&hard.depth);
        let twin = OcclusionTwin::new(&hard.depth);
        let cpu: Vec<_> = near.iter().map(|case| case_verdict(&test, case)).collect();
        for (case, verdict) in near.iter().zip(&cpu) {
            let judgement = case_judgement(&twin, case);
            prop_assert!(
                judgement.allows(*verdict),
                "{}: {verdict:?} {judgement:?} {case:?}",
                hard.name
            );
        }
        if let Some(gpu) = &gpu {
            prop_assert_eq!(gpu.verdicts(&hard.depth, &near), cpu, "{}", hard.name);
        }
        Ok(())
    });
    assert!(result.is_ok(), "{result:?}");
    // And of any camera.
    let (depth, cases) = random_view(&mut Random(77), 64);
    let twin = OcclusionTwin::new(&depth);
    let test = DepthTest::new(&depth);
    for case in &cases {
        assert!(case_judgement(&twin, case).allows(case_verdict(&test, case)));
    }
}
