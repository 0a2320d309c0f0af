//! The frame budget's controller and cost model, told nonsense, extremes and jumps.

use bevy_skyline::{
    budget::{
        Knob, KnobCost,
        controller::{Contribution, Controller, Decision, Input, Measured as Time, Status},
        model::CostModel,
        workload::{BINS, DemandProfile, Workload},
    },
    contribution::rank::NEVER_GOES,
};
use proptest::prelude::*;

use super::{Claim, Found, Measured, Table, all_hold, document::number};
use crate::budget_controller::{City, Plant, Row, dial, run};

const ABOUT: &str = "\
A controller that holds a city to 16 ms on a machine whose costs it does not know (`budget_controller` has the machine), or \
is told times by hand. In every frame of every case all that it says must be finite, its demand between 0 and a sixteenth of \
the picture, and every knob at a step that it has; figures are of what else is claimed.";

const TARGET: f32 = 16.0;
const PICTURE: f32 = 1280.0 * 720.0;
/// Frames in which the machine is heard wrongly.
const ODD: core::ops::Range<u64> = 100..130;

const AS_IF_LOST: Claim = Claim::none(
    "the time counts as lost",
    "decisions that differ",
    "what cannot be a frame's time says nothing",
);
const SETTLES: Claim = Claim {
    asserts: "after the change it is within 10 % of the target for good",
    bound: 15.0,
    unit: "frames",
    why: "a quarter of a second at 60 Hz",
};
const FORGETS: Claim = Claim {
    asserts: "afterwards it is between the aim for a scatter of 10 % and 10 % over the target for good",
    bound: 30.0,
    unit: "frames",
    why: "it forgets in no more time than it was told",
};
const BETWEEN: Claim = Claim {
    asserts: "no other frame is over the target",
    bound: 1.0,
    unit: "of the target",
    why: "the target",
};
const SILENT: Claim = Claim::none(
    "it asks for nothing and says that it has no measurement",
    "frames that ask",
    "there is nothing to hold, or to go by",
);
const IN_RANGE: Claim = Claim::none(
    "finite, in range, at a step there is",
    "frames that are not",
    "clamps",
);
const PASSED_ON: Claim = Claim::none(
    "it is passed on as it is, and all else is finite",
    "frames in which it is not",
    "it is the user's",
);
const KNOWN_COSTS: Claim = Claim::none(
    "costs are finite and not negative",
    "costs that are not so",
    "least squares held at 0, and what cannot be calculated with is not learned",
);

/// Whether all that a decision says can be used.
fn is_sound(decision: &Decision, knobs: &[Knob], picture_px2: f32) -> bool {
    let most = DemandProfile::edge(DemandProfile::bin(picture_px2 * NEVER_GOES) + 1);
    let Decision {
        demanded_px2,
        predicted_ms,
        aim_ms,
        loss,
        ..
    } = *decision;
    (0.0..=most.max(0.0)).contains(&demanded_px2)
        && predicted_ms.is_none_or(f32::is_finite)
        && aim_ms.is_finite()
        && loss.is_finite()
        && knobs.iter().all(|knob| {
            knob.at < knob.steps.len()
                && knob.value().is_some_and(f32::is_finite)
                && knob.saves_ms.is_none_or(f32::is_finite)
        })
}

fn all_sound(rows: &[Row], knobs: &[Knob]) -> Result<(), String> {
    let wrong = rows
        .iter()
        .position(|row| !is_sound(&row.decision, knobs, PICTURE));
    wrong.map_or(Ok(()), |frame| {
        Err(format!("frame {frame}: {:?}", rows[frame].decision))
    })
}

fn turning(frame: u64) -> f64 {
    0.01 * frame as f64
}

/// A time that is nonsense, against the same time lost.
fn nonsense(bad: f32) -> Found {
    let city = City::new();
    let heard = |told: Option<f32>| Plant {
        hears: Box::new(move |frame, ms| if ODD.contains(&frame) { told } else { Some(ms) }),
        ..Default::default()
    };
    let (expected, _) = run(&city, &heard(None), TARGET, 300, turning, &mut []);
    let (rows, _) = run(&city, &heard(Some(bad)), TARGET, 300, turning, &mut []);
    all_sound(&rows, &[])?;
    let pairs = rows.iter().zip(&expected);
    let differ = pairs.filter(|(a, b)| a.decision != b.decision).count();
    Measured::of(differ as f64)
}

/// Below and above the target, of which frames are not off.
const TIGHT: (f64, f64) = (0.9, 1.1);
/// The same while frames have scattered: the margin is a tenth then, and the dead band 3.5 · 0.55 · 0.1 / 2.25.
const WARY: (f64, f64) = (1.0 - 0.1 - 0.086, 1.1);

/// Frames from `at` until the true time stays within a band about the target.
fn frames_to_settle(rows: &[Row], at: usize, (low, high): (f64, f64)) -> usize {
    let is_off = |row: &Row| !(low..=high).contains(&(row.true_ms / f64::from(TARGET)));
    rows[at..]
        .iter()
        .rposition(is_off)
        .map_or(0, |last| last + 1)
}

/// A machine that changes by a factor in frame 200; without a fixed cost that alone would exceed the target.
fn stepping(by: f64, delay: u64, noise: f64) -> Found {
    let plant = Plant {
        slower: Box::new(move |frame| if frame < 200 { 0.7 } else { 0.7 * by }),
        costs: [1.0, 0.054, 1.1e-4, 9.0e-6, 0.0],
        delay,
        noise,
        ..Default::default()
    };
    let (rows, _) = run(&City::new(), &plant, TARGET, 420, |_| 0.4, &mut []);
    all_sound(&rows, &[])?;
    Measured::of(frames_to_settle(&rows, 200, TIGHT) as f64)
}

/// Frames that are heard as another time now and then: how far the others are over the target.
fn between(hears: impl Fn(u64, f32) -> Option<f32> + 'static, is_odd: fn(u64) -> bool) -> Found {
    let plant = Plant {
        hears: Box::new(hears),
        ..Default::default()
    };
    let (rows, _) = run(&City::new(), &plant, TARGET, 700, |_| 0.4, &mut []);
    all_sound(&rows, &[])?;
    let others = (100..700).filter(|frame| !is_odd(*frame));
    let of = |frame: u64| rows[frame as usize].true_ms / f64::from(TARGET);
    let (least, most) = others.fold((f64::MAX, 0.0f64), |(least, most), frame| {
        (least.min(of(frame)), most.max(of(frame)))
    });
    if least < 0.8 {
        return Err(format!("down to {least} of the target").into());
    }
    Measured::noted(most, format!("and no less than {least:.3}"))
}

/// A target that is none.
fn no_target(target: f32) -> Found {
    let (rows, _) = run(
        &City::new(),
        &Plant::default(),
        target,
        60,
        |_| 0.4,
        &mut [],
    );
    all_sound(&rows, &[])?;
    let asks = |row: &&Row| {
        row.decision.status != Status::NoMeasurement || row.decision.demanded_px2 != 0.0
    };
    Measured::of(rows.iter().filter(asks).count() as f64)
}

/// Objects by their areas, each of 100 triangles.
fn profile(picture: f32, areas: impl IntoIterator<Item = f32>) -> DemandProfile {
    let mut profile = DemandProfile::default();
    profile.add_picture(picture);
    for area in areas {
        profile.add(area, Workload::object(100, area, picture));
    }
    profile.finish();
    profile
}

/// What a controller is told, frame by frame.
struct Told {
    profile: DemandProfile,
    picture: f32,
    target_ms: f32,
    quantum_ms: Option<f32>,
    contribution: Contribution,
}

impl Default for Told {
    fn default() -> Self {
        Self {
            profile: profile(PICTURE, (1..=100).map(|area| area as f32)),
            picture: PICTURE,
            target_ms: TARGET,
            quantum_ms: None,
            contribution: Contribution::Budget,
        }
    }
}

/// Frames in which what a controller says is not sound, whatever it is told of times.
fn unsound(
    told: &Told,
    knobs: &mut [Knob],
    frames: u64,
    time: impl Fn(u64, &Decision) -> Option<Time>,
) -> (usize, Decision) {
    let mut controller = Controller::default();
    let mut decision = Decision::default();
    let mut wrong = 0;
    for frame in 0..frames {
        let measured = time(frame, &decision);
        decision = controller.step(
            &Input {
                frame,
                target_ms: told.target_ms,
                measured,
                profile: &told.profile,
                contribution: told.contribution,
                quantum_ms: told.quantum_ms,
            },
            knobs,
        );
        let demanded = match told.contribution {
            // What the user holds is passed on as it is.
            Contribution::Manual(_) => 0.0,
            _ => decision.demanded_px2,
        };
        let sound = Decision {
            demanded_px2: demanded,
            ..decision
        };
        wrong += usize::from(!is_sound(&sound, knobs, told.picture));
    }
    (wrong, decision)
}

/// The time of the frame before, by what was demanded.
fn plain(frame: u64, decision: &Decision) -> Option<Time> {
    let frame = frame.checked_sub(1)?;
    let ms = 40.0 / (1.0 + decision.demanded_px2.sqrt());
    Some(Time { frame, ms })
}

#[rustfmt::skip]
fn times(table: &mut Table) {
    for (name, bad) in [("0", 0.0), ("−0", -0.0), ("−5 ms", -5.0), ("NaN", f32::NAN), ("∞", f32::INFINITY), ("−∞", f32::NEG_INFINITY), ("10⁹ ms", 1e9), ("the largest f32", f32::MAX), ("10 s and a rounding", 10_000.0f32.next_up())] {
        table.case(AS_IF_LOST, format!("30 frames of {name}"), move |_| nonsense(bad));
    }
    for (name, told) in [("10⁻³⁸ ms", f32::MIN_POSITIVE), ("a subnormal time", 1e-40), ("a microsecond", 1e-3), ("twenty times the target", 320.0), ("10 s, which is still believed", 10_000.0)] {
        table.case(FORGETS, format!("30 frames of {name}"), move |_| {
            let plant = Plant {
                hears: Box::new(move |frame, ms| Some(if ODD.contains(&frame) { told } else { ms })),
                ..Default::default()
            };
            let (rows, _) = run(&City::new(), &plant, TARGET, 400, |_| 0.4, &mut []);
            all_sound(&rows, &[])?;
            // The last of them is known two frames later.
            Measured::of(frames_to_settle(&rows, ODD.end as usize + 2, WARY) as f64)
        });
    }
    for by in [0.25, 0.5, 0.8, 1.25, 2.0, 4.0] {
        table.case(SETTLES, format!("the machine becomes {by} times as slow"), move |_| stepping(by, 2, 0.0));
    }
    for (name, delay) in [("one frame", 1), ("three frames", 3)] {
        table.case(SETTLES, format!("twice as slow, times known after {name}"), move |_| stepping(2.0, delay, 0.0));
    }
    table.case(SETTLES, "twice as slow, in noise of 2 %", |_| stepping(2.0, 2, 0.02));
    let every_37th = |frame: u64| frame > 100 && frame.is_multiple_of(37);
    for (name, spike) in [("ten times as long", 10.0), ("a hundred times as long", 100.0), ("a tenth as long", 0.1)] {
        table.case(BETWEEN, format!("every 37th frame is told {name}"), move |_| between(move |frame, ms| Some(if every_37th(frame) { spike * ms } else { ms }), every_37th));
    }
    table.case(BETWEEN, "one pause of a minute", |_| between(|frame, ms| Some(if frame == 300 { 60_000.0 } else { ms }), |_| false));
    table.case(BETWEEN, "every other time is lost", |_| between(|frame, ms| frame.is_multiple_of(2).then_some(ms), |_| false));
    table.case(BETWEEN, "one time in 59 is heard", |_| between(|frame, ms| (frame < 30 || frame.is_multiple_of(59)).then_some(ms), |_| false));
    table.case(BETWEEN, "300 frames without any time", |_| between(|frame, ms| (!(200..500).contains(&frame)).then_some(ms), |_| false));
    table.case(SILENT, "no time ever", |_| {
        let plant = Plant { hears: Box::new(|_, _| None), ..Default::default() };
        let (rows, _) = run(&City::new(), &plant, TARGET, 200, |_| 0.4, &mut []);
        Measured::of(rows.iter().filter(|row| row.decision.status != Status::NoMeasurement || row.decision.demanded_px2 != 0.0).count() as f64)
    });
    table.case(SILENT, "times 20 frames late, after all are forgotten", |_| {
        let plant = Plant { delay: 20, ..Default::default() };
        let (rows, _) = run(&City::new(), &plant, TARGET, 200, |_| 0.4, &mut []);
        Measured::of(rows.iter().filter(|row| row.decision.status != Status::NoMeasurement || row.decision.demanded_px2 != 0.0).count() as f64)
    });
    for (name, target) in [("0", 0.0), ("−1 ms", -1.0), ("NaN", f32::NAN), ("∞", f32::INFINITY), ("−∞", f32::NEG_INFINITY)] {
        table.case(SILENT, format!("a target of {name}"), move |_| no_target(target));
    }
}

#[rustfmt::skip]
fn extremes(table: &mut Table) {
    let mut told = |name: &str, told: fn() -> Told, status: Option<Status>, time: fn(u64, &Decision) -> Option<Time>| {
        table.case(IN_RANGE, name, move |_| {
            let mut knobs = [dial("near", [0.01, 0.02]), dial("far", [0.1, 0.3])];
            let (wrong, last) = unsound(&told(), &mut knobs, 300, time);
            if status.is_some_and(|status| status != last.status) {
                return Err(format!("in the end {last:?}").into());
            }
            Measured::noted(wrong as f64, format!("in the end {:?}, {} px²", last.status, number(last.demanded_px2.into())))
        });
    };
    told("a target of 10⁻³⁸ ms", || Told { target_ms: f32::MIN_POSITIVE, ..Told::default() }, Some(Status::Short), plain);
    told("a target of a microsecond", || Told { target_ms: 1e-3, ..Told::default() }, Some(Status::Short), plain);
    told("a target of the largest f32", || Told { target_ms: f32::MAX, ..Told::default() }, Some(Status::Ample), plain);
    told("nothing in view", || Told { profile: profile(PICTURE, []), ..Told::default() }, None, plain);
    told("a picture without pixels", || Told { profile: profile(0.0, [1.0, 4.0]), picture: 0.0, ..Told::default() }, None, plain);
    told("a picture of NaN pixels", || Told { profile: profile(f32::NAN, [1.0, 4.0]), picture: 0.0, ..Told::default() }, None, plain);
    told("areas that are NaN", || Told { profile: profile(PICTURE, [f32::NAN; 50]), ..Told::default() }, None, plain);
    told("areas that are boundless", || Told { profile: profile(PICTURE, [f32::INFINITY; 50]), ..Told::default() }, None, plain);
    told("areas below 0", || Told { profile: profile(PICTURE, [-1.0; 50]), ..Told::default() }, None, plain);
    told("one object that is everything", || Told { profile: profile(PICTURE, [PICTURE]), ..Told::default() }, None, plain);
    told("a million objects of one area", || Told { profile: profile(PICTURE, (0..1_000_000).map(|_| 16.0)), ..Told::default() }, None, plain);
    told("4 billion triangles in an object", || {
        let mut profile = DemandProfile::default();
        profile.add_picture(PICTURE);
        profile.add(50.0, Workload::object(u32::MAX, 50.0, PICTURE));
        profile.finish();
        Told { profile, ..Told::default() }
    }, None, plain);
    told("work that is boundless", || {
        let mut profile = DemandProfile::default();
        profile.add_picture(PICTURE);
        profile.add_fixed(Workload { rays: 1e300, ..Workload::default() });
        profile.finish();
        Told { profile, ..Told::default() }
    }, None, plain);
    for (name, quantum) in [("0", 0.0), ("NaN", f32::NAN), ("−16 ms", -16.0), ("∞", f32::INFINITY), ("10 s", 10_000.0), ("10⁻³⁸ ms", f32::MIN_POSITIVE)] {
        let quantum: f32 = quantum;
        table.case(IN_RANGE, format!("a display's period of {name}"), move |_| {
            let told = Told { quantum_ms: Some(quantum), ..Told::default() };
            let (wrong, last) = unsound(&told, &mut [dial("near", [0.01, 0.02])], 300, plain);
            Measured::noted(wrong as f64, format!("in the end {:?}", last.status))
        });
    }
    for (name, held) in [("0", 0.0), ("64 px²", 64.0), ("the largest f32", f32::MAX), ("−1 px²", -1.0)] {
        let held: f32 = held;
        table.case(PASSED_ON, format!("a demand that the user holds at {name}"), move |_| {
            let told = Told { contribution: Contribution::Manual(held), ..Told::default() };
            let (wrong, last) = unsound(&told, &mut [dial("near", [0.01, 0.02])], 300, plain);
            let is_passed_on = last.demanded_px2.to_bits() == held.to_bits();
            Measured::of(wrong as f64 + f64::from(u8::from(!is_passed_on)))
        });
    }
    let mut time = |name: &str, time: fn(u64, &Decision) -> Option<Time>| {
        table.case(IN_RANGE, name, move |_| {
            let (wrong, last) = unsound(&Told::default(), &mut [dial("near", [0.01, 0.02])], 400, time);
            Measured::noted(wrong as f64, format!("in the end {:?}", last.status))
        });
    };
    time("times of frames that never were", |_, _| Some(Time { frame: u64::MAX, ms: 16.0 }));
    time("times of frames to come", |frame, _| Some(Time { frame: frame + 3, ms: 16.0 }));
    time("every time told twice, once too late", |frame, decision| plain(frame - frame % 2, decision));
    time("times in the wrong order", |frame, decision| plain(if frame % 4 == 1 { frame + 1 } else { frame.saturating_sub(frame % 4) }, decision));
    time("0.1 and 100 ms in turn", |frame, _| Some(Time { frame: frame.checked_sub(1)?, ms: if frame % 2 == 0 { 0.1 } else { 100.0 } }));
    time("a time that doubles every frame", |frame, _| Some(Time { frame: frame.checked_sub(1)?, ms: 1e-6 * 2f32.powi((frame % 33) as i32) }));
    time("a time that does not depend on anything", |frame, _| Some(Time { frame: frame.checked_sub(1)?, ms: 33.0 }));
    // Knobs.
    let mut knob = |name: &str, knobs: fn() -> Vec<Knob>| {
        table.case(IN_RANGE, name, move |_| {
            let mut knobs = knobs();
            let (wrong, last) = unsound(&Told { target_ms: 1.0, ..Told::default() }, &mut knobs, 600, plain);
            let at: Vec<_> = knobs.iter().take(4).map(|knob| knob.at).collect();
            Measured::noted(wrong as f64, format!("in the end {:?}, knobs at {at:?}", last.status))
        });
    };
    knob("a knob of one step", || Knob::new("odd", "", &[(1.0, 0.0)], KnobCost::Measured).into_iter().collect());
    knob("a knob of 1000 steps that lose nothing", || {
        let steps: Vec<_> = (0..1000).map(|step| (step as f32, 0.0)).collect();
        Knob::new("odd", "", &steps, KnobCost::Measured).into_iter().collect()
    });
    knob("a knob that loses 10³⁰ pictures", || Knob::new("odd", "", &[(0.0, 0.0), (1.0, 1e30)], KnobCost::Measured).into_iter().collect());
    knob("a knob that the user holds at its cheapest", || {
        let mut dial = dial("held", [0.1, 0.2]);
        dial.manual = Some(2);
        vec![dial]
    });
    knob("a knob whose work becomes nothing", || Knob::new("odd", "", &[(1.0, 0.0), (0.0, 0.1)], KnobCost::Scales(|value| Workload { pixels: f64::from(value), ..Workload::UNSCALED })).into_iter().collect());
    knob("a knob whose work becomes NaN", || Knob::new("odd", "", &[(1.0, 0.0), (0.5, 0.1)], KnobCost::Scales(|value| Workload { pixels: if value < 1.0 { f64::NAN } else { 1.0 }, ..Workload::UNSCALED })).into_iter().collect());
    knob("sixty-four knobs", || (0..64).map(|_| dial("one of many", [0.01, 0.02])).collect());
}

#[rustfmt::skip]
fn model(table: &mut Table) {
    let some = Workload { objects: 100.0, triangles: 1e4, pixels: 1e5, rays: 0.0 };
    let mut learns = |name: &str, samples: Vec<(Workload, f64)>| {
        table.case(KNOWN_COSTS, name, move |_| {
            let mut model = CostModel::default();
            for (work, ms) in samples.iter().cycle().take(200) {
                model.learn(work, *ms, 0.01, false);
                model.rescale(f64::NAN);
            }
            let costs = model.costs();
            let predicted = model.predict(&some);
            let wrong = costs.iter().filter(|cost| !(cost.is_finite() && **cost >= 0.0)).count();
            Measured::noted(wrong as f64 + f64::from(u8::from(!predicted.is_finite())), format!("{} ms for a plain frame", number(predicted + 0.0)))
        });
    };
    let with = |objects: f64, triangles: f64| Workload { objects, triangles, ..Workload::default() };
    learns("learning from nothing but nothing", vec![(Workload::default(), 5.0)]);
    learns("learning from one and the same frame", vec![(some, 5.0)]);
    learns("learning from terms that are one and the same", (1..9).map(|k| (with(f64::from(k), f64::from(k)), f64::from(k))).collect());
    learns("learning from times of NaN, 0, −1 and ∞", vec![(some, f64::NAN), (some, 0.0), (some, -1.0), (some, f64::INFINITY)]);
    learns("learning from work of NaN, −1 and ∞", vec![(with(f64::NAN, 1.0), 5.0), (with(-1.0, 1.0), 5.0), (with(f64::INFINITY, 1.0), 5.0)]);
    learns("learning from terms 10¹⁸ apart", vec![(with(1.0, 1e18), 5.0), (with(2.0, 1e18), 6.0), (with(1.0, 2e17), 2.0)]);
    learns("learning that more takes less", (1..50).map(|k| (with(f64::from(k), 0.0), 100.0 / f64::from(k))).collect());
    learns("learning from times 10¹⁵ apart", vec![(some, 1e-6), (some, 1e9)]);
    table.case(KNOWN_COSTS, "edges and bins of demands at every power of two, and beyond", |_| {
        let mut wrong = 0;
        for exponent in -150..=150 {
            let demand = 2f64.powi(exponent) as f32;
            let bin = DemandProfile::bin(demand);
            wrong += usize::from(bin >= BINS || DemandProfile::edge(bin) > demand || (bin + 1 < BINS && DemandProfile::edge(bin + 1) <= demand));
        }
        Measured::of(wrong as f64)
    });
}

pub fn table() -> Table {
    let mut table = Table::new("Frame budget", ABOUT);
    times(&mut table);
    extremes(&mut table);
    model(&mut table);
    table
}

#[test]
fn every_case_holds() {
    all_hold(&table());
}

#[test]
fn a_decision_that_is_not_sound_is_caught() {
    let sound = Decision::default();
    let knobs = [dial("one", [0.1, 0.2])];
    assert!(is_sound(&sound, &knobs, PICTURE));
    for wrong in [
        Decision {
            demanded_px2: f32::NAN,
            ..sound
        },
        Decision {
            demanded_px2: -1.0,
            ..sound
        },
        Decision {
            demanded_px2: PICTURE,
            ..sound
        },
        Decision {
            predicted_ms: Some(f32::INFINITY),
            ..sound
        },
        Decision {
            aim_ms: f32::NAN,
            ..sound
        },
        Decision {
            loss: f32::NAN,
            ..sound
        },
    ] {
        assert!(!is_sound(&wrong, &knobs, PICTURE), "{wrong:?}");
    }
    let mut off = dial("off", [0.1, 0.2]);
    off.at = 3;
    assert!(!is_sound(&sound, &[off], PICTURE));
    // A machine that is not followed does not settle.
    let plant = Plant {
        slower: Box::new(|frame| if frame < 200 { 0.7 } else { 1.4 }),
        hears: Box::new(|frame, ms| (frame < 200).then_some(ms)),
        costs: [1.0, 0.054, 1.1e-4, 9.0e-6, 0.0],
        ..Default::default()
    };
    let (rows, _) = run(&City::new(), &plant, TARGET, 300, |_| 0.4, &mut []);
    assert!(frames_to_settle(&rows, 200, TIGHT) > 15);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, rng_seed: prop::test_runner::RngSeed::Fixed(43), failure_persistence: None, ..Default::default() })]

    /// Whatever it is told, what it says can be used.
    #[test]
    fn whatever_it_is_told_it_stays_in_range(
        target in prop_oneof![1e-3f32..1e3, prop::num::f32::ANY],
        quantum in prop::option::of(prop_oneof![1.0f32..40.0, prop::num::f32::ANY]),
        times in prop::collection::vec(prop_oneof![3 => 0.1f32..100.0, 1 => prop::num::f32::ANY], 1..40),
        areas in prop::collection::vec(prop_oneof![0.01f32..1e6, prop::num::f32::ANY], 0..60),
        late in 1u64..20,
    ) {
        let told = Told {
            profile: profile(PICTURE, areas.iter().copied()),
            target_ms: target,
            quantum_ms: quantum,
            ..Told::default()
        };
        let mut knobs = [dial("near", [0.01, 0.02]), dial("far", [0.1, 0.3])];
        let (wrong, last) = unsound(&told, &mut knobs, 200, |frame, _| {
            let frame = frame.checked_sub(late)?;
            Some(Time { frame, ms: times[frame as usize % times.len()] })
        });
        prop_assert!(wrong == 0, "{} frames: {:?}", wrong, last);
    }
}
