//! The gauntlet: the hard cases of every effect by name, in one table, each with what is asserted of it, its bound and
//! what the bound comes from. `docs/hard_cases.md` is made of it, see [`document`].
//!
//! A [`Claim`] says what is asserted and how far it may be off; a [`Case`] is a condition under which it is measured. The
//! figure is always on the side on which the predicate may err: a case holds if its figure is at most its bound.
//!
//! To add a case, add it to its effect's table. Names are unique within an effect, and say what is hard.

mod budget;
mod contribution;
mod document;
mod height_field;
mod height_field_points;
mod interior;
mod interior_models;
mod occlusion;
mod resolution;
mod spherical;
mod terrain;
mod terrain_shadow;

use std::panic::{AssertUnwindSafe, catch_unwind};

use bevy_skyline::offline::Offline;

/// What is asserted, how far it may be off, and why no less.
#[derive(Clone, Copy, Debug)]
pub struct Claim {
    pub asserts: &'static str,
    pub bound: f64,
    pub unit: &'static str,
    pub why: &'static str,
}

impl Claim {
    /// Nothing of the kind may happen at all.
    pub const fn none(asserts: &'static str, unit: &'static str, why: &'static str) -> Self {
        Self {
            asserts,
            bound: 0.0,
            unit,
            why,
        }
    }

    /// Whether it is another's but for the bound.
    pub fn is_same(&self, other: &Self) -> bool {
        (self.asserts, self.unit, self.why) == (other.asserts, other.unit, other.why)
    }

    /// The same with a bound that is the case's own.
    pub const fn at_most(self, bound: f64) -> Self {
        Self { bound, ..self }
    }
}

/// What a case came to.
#[derive(Clone, Debug)]
pub struct Measured {
    /// In the claim's unit.
    pub value: f64,
    /// What else is worth knowing.
    pub note: String,
}

impl Measured {
    pub fn of(value: f64) -> Found {
        Self::noted(value, "")
    }

    pub fn noted(value: f64, note: impl Into<String>) -> Found {
        Ok(Self {
            value,
            note: note.into(),
        })
    }
}

/// Why a case came to no figure.
#[derive(Clone, Debug)]
pub enum Trouble {
    /// Another answer than the claim is about.
    Wrong(String),
    /// This machine lacks what it takes.
    Skipped(String),
}

impl From<String> for Trouble {
    fn from(why: String) -> Self {
        Self::Wrong(why)
    }
}

pub type Found = Result<Measured, Trouble>;
type Run = Box<dyn Fn(&mut Machine) -> Found>;

/// A condition under which a claim is tried.
pub struct Case {
    pub name: String,
    pub claim: Claim,
    run: Run,
}

/// The cases of one effect.
pub struct Table {
    pub effect: &'static str,
    /// For readers: what the figures are.
    pub about: &'static str,
    pub cases: Vec<Case>,
}

impl Table {
    pub fn new(effect: &'static str, about: &'static str) -> Self {
        Self {
            effect,
            about,
            cases: Vec::new(),
        }
    }

    pub fn case(
        &mut self,
        claim: Claim,
        name: impl Into<String>,
        run: impl Fn(&mut Machine) -> Found + 'static,
    ) {
        self.cases.push(Case {
            name: name.into(),
            claim,
            run: Box::new(run),
        });
    }
}

/// What cases run on: opened when the first of them asks for it.
#[derive(Default)]
pub struct Machine {
    offline: Option<Option<Offline>>,
}

impl Machine {
    /// A headless app on the device that is there.
    pub fn offline(&mut self) -> Result<&mut Offline, Trouble> {
        self.offline
            .get_or_insert_with(crate::device)
            .as_mut()
            .ok_or_else(no_device)
    }

    /// Its name.
    pub fn adapter(&mut self) -> String {
        self.offline()
            .map_or_else(|_| "no device".into(), |offline| offline.adapter())
    }
}

pub fn no_device() -> Trouble {
    Trouble::Skipped("no device could be opened".into())
}

/// Whether a figure keeps a bound; what is no number keeps none.
fn holds(value: f64, bound: f64) -> bool {
    value <= bound
}

/// Runs a case. What it asserts on its own and fails in is its answer, too.
fn found(case: &Case, machine: &mut Machine) -> Found {
    let answer = catch_unwind(AssertUnwindSafe(|| (case.run)(machine)));
    let found = answer.unwrap_or_else(|panic| {
        let words = panic
            .downcast_ref::<String>()
            .cloned()
            .or_else(|| panic.downcast_ref::<&str>().map(|words| (*words).into()));
        Err(Trouble::Wrong(words.unwrap_or_else(|| "a panic".into())))
    })?;
    if holds(found.value, case.claim.bound) {
        Ok(found)
    } else {
        Err(Trouble::Wrong(format!(
            "{:e} {unit}, more than {:e} {unit} {}",
            found.value,
            case.claim.bound,
            found.note,
            unit = case.claim.unit
        )))
    }
}

/// The cases that fail, in words; or all that were tried were skipped.
fn failing(table: &Table) -> Vec<String> {
    let mut machine = Machine::default();
    let mut wrong = Vec::new();
    for case in &table.cases {
        let start = std::time::Instant::now();
        match found(case, &mut machine) {
            Ok(Measured { value, note }) => println!(
                "{}: {value:.3e} of {:.3e} {} {note} ({} ms)",
                case.name,
                case.claim.bound,
                case.claim.unit,
                start.elapsed().as_millis()
            ),
            Err(Trouble::Skipped(why)) => println!("{}: skipped: {why}", case.name),
            Err(Trouble::Wrong(why)) => wrong.push(format!("{}: {why}", case.name)),
        }
    }
    wrong
}

/// Fails with every case that does, not only the first.
#[track_caller]
fn all_hold(table: &Table) {
    assert!(
        table.cases.len() >= 25,
        "{}: only {} cases",
        table.effect,
        table.cases.len()
    );
    let wrong = failing(table);
    assert!(
        wrong.is_empty(),
        "{}: {} of {} cases fail:\n{}",
        table.effect,
        wrong.len(),
        table.cases.len(),
        wrong.join("\n")
    );
}

/// Those of one name together, in the order of their first appearance.
pub fn by_name<T>(
    cases: impl IntoIterator<Item = T>,
    name: impl Fn(&T) -> &'static str,
) -> Vec<(&'static str, Vec<T>)> {
    let mut named: Vec<(&'static str, Vec<T>)> = Vec::new();
    for case in cases {
        let name = name(&case);
        match named.iter_mut().find(|(of, _)| *of == name) {
            Some((_, cases)) => cases.push(case),
            None => named.push((name, vec![case])),
        }
    }
    named
}

/// All effects, in the order of the design.
pub fn tables() -> Vec<Table> {
    vec![
        height_field::table(),
        terrain::table(),
        terrain_shadow::table(),
        occlusion::table(),
        contribution::table(),
        budget::table(),
        interior::table(),
        spherical::table(),
        resolution::table(),
    ]
}

#[test]
fn what_is_too_much_or_no_number_or_a_panic_fails() {
    const CLAIM: Claim = Claim {
        asserts: "nothing",
        bound: 1.0,
        unit: "px",
        why: "for the test",
    };
    let mut table = Table::new("None", "");
    for (name, value) in [("at it", 1.0), ("above", 1.0 + 1e-15), ("none", f64::NAN)] {
        table.case(CLAIM, name, move |_| Measured::of(value));
    }
    table.case(CLAIM, "wrong", |_| Err(String::from("other").into()));
    table.case(CLAIM, "panics", |_| panic!("on purpose"));
    table.case(CLAIM, "skipped", |_| Err(Trouble::Skipped("no".into())));
    let wrong = failing(&table);
    let names: Vec<_> = wrong
        .iter()
        .filter_map(|why| why.split(':').next())
        .collect();
    assert_eq!(names, ["above", "none", "wrong", "panics"]);
}
