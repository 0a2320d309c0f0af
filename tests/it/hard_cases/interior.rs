//! Interior culling: what rays from outside meet stays, on CPU and GPU alike.

use core::cell::OnceCell;
use std::rc::Rc;

use bevy_skyline::interior::{
    FieldDevice, FieldOrigin, InteriorCulling, InteriorError, InteriorGrid, Model, Outcome,
    Progress, Verdict, cull, cull_on,
};
use proptest::prelude::*;

use super::{
    Claim, Found, Measured, Table, all_hold,
    interior_models::{Culled, Stays, models},
};
use crate::{
    interior::{Dice, at, crew, cube, hits, model, part},
    interior_field::Gpu,
};

const ABOUT: &str = "\
Models that are hard to tell inside from outside of. 1000 or more rays from outside must meet nothing that was taken out, \
where the guarantee covers what they see through; parts stay and go as stated; and the directed distance field of the GPU \
leads to the same verdicts.";

const SEEN: Claim = Claim::none(
    "rays from outside meet nothing that is gone; parts stay and go as they must; GPU and CPU alike",
    "triangles wrongly gone",
    "the guarantee: integers throughout, and a seal proved in `interior`",
);
const STATED: Claim = Claim::none(
    "parts stay and go as they must; GPU and CPU alike",
    "wrong parts",
    "the guarantee of a gap of √3 cells, and that of a crack below an eighth of a spacing",
);
const REFUSED: Claim = Claim::none(
    "it is refused with the reason and the remedy",
    "other answers",
    "there is nothing to cull, or nothing to go by",
);

type Shared = Rc<OnceCell<Option<Gpu>>>;

/// Whether a part is what it must be.
fn is_right(verdict: &Verdict, stays: Stays) -> bool {
    match stays {
        Stays::All => *verdict == Verdict::Seen,
        Stays::Some => *verdict != Verdict::Hidden,
        Stays::None => *verdict == Verdict::Hidden,
        Stays::AsSeen => true,
    }
}

/// How many triangles that rays met first are gone.
fn wrongly_gone(model: &Model, outcome: &Outcome, rays: usize) -> usize {
    let met = hits(model, rays, 11);
    let gone = |(part, triangle): &&(usize, usize)| !outcome.parts[*part].is_seen(*triangle);
    met.iter().filter(gone).count()
}

fn judged(culled: &Culled, outcome: &Outcome) -> Result<usize, String> {
    let parts = outcome.parts.iter().zip(&culled.stays).enumerate();
    for (number, (verdict, stays)) in parts {
        if !is_right(verdict, *stays) {
            return Err(format!("part {number}: {verdict:?} instead of {stays:?}"));
        }
    }
    Ok(if culled.rays > 0 {
        wrongly_gone(&culled.model, outcome, culled.rays)
    } else {
        0
    })
}

fn culled(gpu: &Shared, case: &Culled) -> Found {
    let progress = Progress::default();
    let outcome =
        cull(&case.model, &case.settings, crew(), &progress).map_err(|why| why.to_string())?;
    let gone = judged(case, &outcome)?;
    let triangles = case.model.triangle_count();
    let kept: usize = outcome
        .parts
        .iter()
        .zip(&case.model.parts)
        .map(|(verdict, part)| verdict.count(part.surface.triangles.len()))
        .sum();
    let mut note = format!("{kept} of {triangles} triangles kept");
    if let Some(gpu) = gpu.get_or_init(Gpu::new) {
        let interior = gpu.interior();
        let device = FieldDevice::Gpu(&interior);
        let there = cull_on(
            device,
            &case.model,
            &case.settings,
            crew(),
            &Progress::default(),
        );
        let there = there.map_err(|why| why.to_string())?;
        if there.parts != outcome.parts {
            return Err(String::from("the GPU's verdicts are others").into());
        }
        if there.field_origin != FieldOrigin::Gpu {
            note += ", on the CPU only";
        }
    }
    if case.rays > 0 {
        note += &format!(", {} rays", case.rays);
    }
    Measured::noted(gone as f64, note)
}

fn refusals(table: &mut Table) {
    type IsRight = fn(&InteriorError) -> bool;
    let nowhere = |bad: f32| {
        let mut surface = cube(1.0);
        surface.positions[3][1] = bad;
        model([part(cube(1.0)), part(surface)])
    };
    let gap = |gap: f32| InteriorCulling {
        grid: InteriorGrid::Gap(gap),
        ..Default::default()
    };
    let whole = || model([part(cube(1.0))]);
    let flattened = || {
        let mut flat = whole();
        flat.parts[0].model_from_local.translation.x = f64::NAN;
        flat
    };
    let is_nowhere: IsRight = |why| matches!(why, InteriorError::NotFinite { .. });
    let is_gap: IsRight = |why| matches!(why, InteriorError::Gap(_));
    let is_grid: IsRight = |why| matches!(why, InteriorError::Resolution(_));
    let is_memory: IsRight = |why| matches!(why, InteriorError::Memory { .. });
    let no_triangles: IsRight = |why| *why == InteriorError::NoTriangles;
    let tight = InteriorCulling {
        memory_mib: 100,
        ..gap(1e-5)
    };
    let cases: [(&str, Model, InteriorCulling, IsRight); 14] = [
        ("no parts at all", Model::default(), at(10), no_triangles),
        (
            "parts without triangles",
            model([part(Default::default())]),
            at(10),
            no_triangles,
        ),
        ("a vertex of NaN", nowhere(f32::NAN), at(10), is_nowhere),
        ("a vertex of ∞", nowhere(f32::INFINITY), at(10), is_nowhere),
        (
            "a vertex of −∞",
            nowhere(f32::NEG_INFINITY),
            at(10),
            is_nowhere,
        ),
        ("a node whose place is NaN", flattened(), at(10), is_nowhere),
        ("a grid of no cells", whole(), at(0), is_grid),
        (
            "a grid of more cells than can be",
            whole(),
            at(3501),
            is_grid,
        ),
        ("a grid of 4 billion cells", whole(), at(u32::MAX), is_grid),
        ("a gap of 0", whole(), gap(0.0), is_gap),
        ("a gap below 0", whole(), gap(-1.0), is_gap),
        ("a gap of NaN", whole(), gap(f32::NAN), is_gap),
        ("a gap of ∞", whole(), gap(f32::INFINITY), is_gap),
        (
            "a gap that takes more memory than is allowed",
            whole(),
            tight,
            is_memory,
        ),
    ];
    for (name, model, settings, is_right) in cases {
        table.case(REFUSED, name, move |_| {
            match cull(&model, &settings, crew(), &Progress::default()) {
                Err(why) if is_right(&why) => Measured::noted(0.0, format!("“{why}”")),
                other => Err(format!("{:?}", other.map(|outcome| outcome.parts)).into()),
            }
        });
    }
}

pub fn table() -> Table {
    let mut table = Table::new("Interior", ABOUT);
    let gpu = Shared::default();
    for case in models() {
        let gpu = Rc::clone(&gpu);
        let claim = if case.rays > 0 { SEEN } else { STATED };
        table.case(claim, case.name, move |_| culled(&gpu, &case));
    }
    refusals(&mut table);
    table
}

#[test]
fn every_case_holds() {
    all_hold(&table());
}

#[test]
fn what_is_wrongly_gone_or_wrongly_there_is_caught() {
    let case = models().swap_remove(0);
    let progress = Progress::default();
    let mut outcome = cull(&case.model, &case.settings, crew(), &progress).expect("it can be");
    assert_eq!(judged(&case, &outcome), Ok(0));
    // A triangle of the outer box less.
    let mut seen = vec![true; 12];
    seen[4] = false;
    outcome.parts[0] = Verdict::Partly(seen.into());
    assert!(wrongly_gone(&case.model, &outcome, case.rays) > 10);
    assert!(judged(&case, &outcome).is_err());
    outcome.parts = vec![Verdict::Seen, Verdict::Seen];
    assert!(judged(&case, &outcome).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, rng_seed: prop::test_runner::RngSeed::Fixed(47), failure_persistence: None, ..Default::default() })]

    /// A closed box turned, stretched and mirrored anyhow hides what is well inside it, and keeps what rays meet.
    #[test]
    fn any_placed_box_hides_its_inside(seed: u64, stretch in prop::array::uniform3(0.2f64..5.0), mirrored: bool, cells in 60u32..160, far in 0i32..8) {
        let mut dice = Dice(seed);
        let mut scale = bevy::math::DVec3::from_array(stretch);
        if mirrored {
            scale.y = -scale.y;
        }
        let away = bevy::math::DVec3::new(1.0, -1.0, 0.5) * 10f64.powi(far);
        let place = bevy::math::DAffine3::from_translation(away)
            * bevy::math::DAffine3::from_quat(dice.turn())
            * bevy::math::DAffine3::from_scale(scale);
        let mut boxes = model([part(cube(1.0)), part(cube(0.3))]);
        boxes.parts.iter_mut().for_each(|part| part.model_from_local = place);
        let outcome = cull(&boxes, &at(cells), crew(), &Progress::default());
        let outcome = outcome.map_err(|why| TestCaseError::fail(why.to_string()))?;
        prop_assert_eq!(wrongly_gone(&boxes, &outcome, 300), 0);
        // Where the walls are farther apart than extraction reaches.
        let thinnest = stretch.iter().copied().fold(f64::MAX, f64::min);
        if thinnest * 0.7 > 4.0 * outcome.lattice.spacing {
            prop_assert_eq!(&outcome.parts[1], &Verdict::Hidden);
        }
    }
}
