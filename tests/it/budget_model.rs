//! The cost model: it finds costs, never predicts less for more, and is not led astray.

use bevy_skyline::budget::{
    knobs::{Knob, KnobCost, KnobError},
    model::CostModel,
    workload::{BINS, DemandProfile, Workload},
};
use proptest::prelude::*;

use crate::{allocations, budget_controller::Dice};

fn work(objects: f64, triangles: f64, pixels: f64) -> Workload {
    Workload {
        objects,
        triangles,
        pixels,
        rays: 0.0,
    }
}

#[test]
fn costs_that_can_be_told_apart_are_found() {
    let truth = [3.0, 0.004, 2.0e-5, 1.0e-6];
    let mut model = CostModel::default();
    let mut dice = Dice::new(5);
    for _ in 0..400 {
        let x = work(
            4_000.0 * dice.roll(),
            5.0e5 * dice.roll(),
            2.0e6 * dice.roll(),
        );
        let terms = x.terms();
        let ms: f64 = (0..4).map(|i| truth[i] * terms[i]).sum();
        model.learn(&x, ms * (1.0 + 0.01 * dice.normal()), 0.01, false);
    }
    let found = model.costs();
    for i in 0..4 {
        let off = found[i] / truth[i] - 1.0;
        assert!(off.abs() < 0.05, "term {i}: {} for {}", found[i], truth[i]);
    }
}

#[test]
fn terms_that_move_together_share_the_cost() {
    let mut model = CostModel::default();
    for i in 0..200 {
        let share = 0.2 + 0.8 * f64::from(i % 50) / 50.0;
        let x = work(1_000.0 * share, 1.0e5 * share, 0.0);
        model.learn(&x, 2.0 + 10.0 * share, 0.01, false);
    }
    let costs = model.costs();
    assert!(costs[1] > 0.0 && costs[2] > 0.0, "{costs:?}");
    // Neither takes it all, and together they predict what was seen.
    let off = model.predict(&work(500.0, 5.0e4, 0.0)) / 7.0 - 1.0;
    assert!(off.abs() < 0.02, "{off}");
}

#[test]
fn one_sample_far_off_hardly_counts() {
    let mut model = CostModel::default();
    let mut dice = Dice::new(9);
    let mut sample = |model: &mut CostModel, times: f64| {
        let x = work(
            2_000.0 * (0.2 + dice.roll()),
            1.0e5 * (0.2 + dice.roll()),
            0.0,
        );
        let ms = times * (1.0 + 0.003 * x.objects + 3.0e-5 * x.triangles);
        model.learn(&x, ms, 0.01, false);
    };
    for _ in 0..200 {
        sample(&mut model, 1.0);
    }
    let at = work(1_500.0, 8.0e4, 0.0);
    let before = model.predict(&at);
    sample(&mut model, 10.0);
    let off = model.predict(&at) / before - 1.0;
    assert!(off.abs() < 0.01, "{off}");
    sample(&mut model, 0.1);
    let off = model.predict(&at) / before - 1.0;
    assert!(off.abs() < 0.05, "{off}");
}

#[test]
fn a_machine_that_is_twice_as_slow_is_so_for_every_term() {
    let mut model = CostModel::default();
    for i in 1..50 {
        let x = work(f64::from(i), f64::from(i * i), f64::from(50 - i));
        model.learn(&x, 1.0 + 0.1 * x.objects, 0.01, false);
    }
    let at = work(20.0, 100.0, 20.0);
    let before = model.predict(&at);
    model.rescale(2.0);
    assert!((model.predict(&at) / before - 2.0).abs() < 1e-12);
    for by in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        model.rescale(by);
    }
    assert!((model.predict(&at) / before - 2.0).abs() < 1e-12);
}

#[test]
fn learning_and_summing_up_allocate_nothing() {
    let mut model = CostModel::default();
    let mut profile = DemandProfile::default();
    let allocations = allocations::count(|| {
        for i in 0..100 {
            profile.clear();
            profile.add_picture(1e6);
            for area in 0..100_u16 {
                profile.add(f32::from(area), Workload::object(12, f32::from(area), 1e6));
            }
            profile.finish();
            model.learn(&profile.kept(i), 5.0 + i as f64, 0.01, false);
        }
    });
    assert_eq!(allocations, 0);
}

#[test]
fn knobs_that_make_no_sense_are_refused_with_the_remedy() {
    let new = |steps: &[(f32, f32)]| Knob::new("odd", "", steps, KnobCost::Measured);
    assert!(matches!(new(&[]), Err(KnobError::NoSteps("odd"))));
    let wrong: [&[(f32, f32)]; 6] = [
        &[(1.0, 0.1)],
        &[(1.0, 0.0), (2.0, -0.1)],
        &[(1.0, 0.0), (2.0, 0.2), (3.0, 0.1)],
        &[(1.0, 0.0), (3.0, 0.1), (2.0, 0.2)],
        &[(1.0, 0.0), (f32::NAN, 0.1)],
        &[(1.0, 0.0), (2.0, f32::INFINITY)],
    ];
    for steps in wrong {
        let problem = new(steps).err().map(|problem| problem.to_string());
        assert!(
            problem.is_some_and(|words| words.contains("must")),
            "{steps:?}"
        );
    }
    assert!(new(&[(1.0, 0.0), (0.5, 0.1), (0.25, 0.1)]).is_ok());
}

fn any_work() -> impl Strategy<Value = Workload> {
    (0.0..1e5, 0.0..1e7, 0.0..1e8, 0.0..1e7).prop_map(|(objects, triangles, pixels, rays)| {
        Workload {
            objects,
            triangles,
            pixels,
            rays,
        }
    })
}

proptest! {
    /// Whatever it is told, costs are finite and not negative, so that less work is never predicted to take longer.
    #[test]
    fn more_never_takes_less(
        samples in prop::collection::vec((any_work(), prop::num::f64::ANY, 0.0..0.3, any::<bool>()), 1..60),
        at in any_work(),
        more in any_work(),
    ) {
        let mut model = CostModel::default();
        for (x, ms, noise, is_new) in samples {
            model.learn(&x, ms.abs().min(1e6), noise, is_new);
            let costs = model.costs();
            prop_assert!(costs.iter().all(|cost| cost.is_finite() && *cost >= 0.0), "{:?}", costs);
        }
        let (less, all) = (model.predict(&at), model.predict(&(at + more)));
        prop_assert!(less.is_finite() && less <= all * (1.0 + 1e-12), "{less} {all}");
    }

    /// A profile keeps what is not below the edge, and its losses only grow.
    #[test]
    fn a_profile_counts_like_a_list(
        objects in prop::collection::vec((0.0_f32..1e8, 0_u32..1000), 0..200),
        bin in 0..BINS,
    ) {
        let mut profile = DemandProfile::default();
        profile.add_picture(1e6);
        for (area, triangles) in &objects {
            profile.add(*area, Workload::object(*triangles, *area, 1e6));
        }
        profile.finish();
        let edge = DemandProfile::edge(bin);
        let kept = objects.iter().filter(|(area, _)| *area >= edge);
        prop_assert_eq!(profile.kept(bin).objects, kept.clone().count() as f64);
        let triangles: u64 = kept.map(|(_, triangles)| u64::from(*triangles)).sum();
        prop_assert_eq!(profile.kept(bin).triangles, triangles as f64);
        prop_assert!(profile.loss(0, bin) <= profile.loss(0, (bin + 7).min(BINS - 1)));
    }
}
