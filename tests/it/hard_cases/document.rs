//! `docs/hard_cases.md`, made of the tables. What is in it may differ from them in nothing but what was measured, and
//! that may not exceed its bound.

use std::{collections::HashSet, fmt::Write, path::PathBuf};

use bevy_skyline::offline::accuracy::utc_now;

use super::{Claim, Found, Machine, Measured, Table, Trouble, found, tables};

/// Set: the document is written anew, with everything measured. Unset: it is held against the tables.
const WRITE: &str = "SKYLINE_WRITE_DOCS";
const INTRO: &str = "\
<!-- Made by `SKYLINE_WRITE_DOCS=1 scripts/test.sh hard_cases::document`. Don't edit it by hand. -->
# Hard cases

Inputs on which culling and ray casting usually go wrong, by name, and what they came to here. Each row is run by the
test suite against a twin in `f64`, an answer known by algebra, or brute force. The figure is on the side on which the
predicate may err: hits off by so much, visible things removed, pixels missed. **A case holds if its figure is at most
its bound.** Bounds are counted from the roundings of an operation, or are what is promised, or 0. A figure below 0 is a
distance kept; a dash says that there was nothing that could have been off.

- Run them: `scripts/test.sh hard_cases`. On another GPU: `WGPU_ADAPTER_NAME=… scripts/test.sh hard_cases`.
- Measure anew, and write this page: `SKYLINE_WRITE_DOCS=1 scripts/test.sh hard_cases::document`.
- Add one: a line in the table of its effect in `tests/it/hard_cases/`, then write this page. A test fails while page and
  tables differ in a name, a claim or a bound.
- Around the cases of each effect random neighbours are tried as well, the same in every run, and every comparison is
  shown to fail when one of its sides is perturbed.
";

fn path() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("docs/hard_cases.md")
}

/// A number as short as tells it: whole ones whole, others with two places.
pub fn number(x: f64) -> String {
    let magnitude = x.abs();
    let digits = if x.is_nan() {
        "no number".into()
    } else if magnitude.is_infinite() {
        "∞".into()
    } else if magnitude == magnitude.trunc() && magnitude < 1e6 {
        format!("{magnitude}")
    } else if (0.01..1000.0).contains(&magnitude) {
        format!("{magnitude:.3}")
    } else {
        let text = format!("{magnitude:.1e}");
        match text.split_once('e') {
            Some((digits, exponent)) => format!("{digits}·10{}", raised(exponent)),
            None => text,
        }
    };
    if x < 0.0 {
        format!("−{digits}")
    } else {
        digits
    }
}

fn raised(exponent: &str) -> String {
    let up = |c: char| match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        '0' | '4'..='9' => char::from_u32('⁰' as u32 + c as u32 - '0' as u32).unwrap_or(c),
        other => other,
    };
    exponent.chars().map(up).collect()
}

/// A number and its unit; `share` is written as none.
fn with_unit(x: f64, unit: &str) -> String {
    if unit.is_empty() {
        number(x)
    } else {
        format!("{} {unit}", number(x))
    }
}

fn measured(claim: &Claim, found: &Found) -> String {
    match found {
        Ok(Measured { value, note }) => {
            let value = if *value == f64::NEG_INFINITY {
                "–".into()
            } else {
                with_unit(*value, claim.unit)
            };
            if note.is_empty() {
                value
            } else {
                format!("{value}; {note}")
            }
        }
        Err(Trouble::Skipped(why)) => format!("skipped: {why}"),
        Err(Trouble::Wrong(why)) => format!("**fails**: {why}"),
    }
}

/// The page, its last column by `measure`.
fn page(
    tables: &[Table],
    on: &str,
    mut measure: impl FnMut(usize, usize) -> Option<Found>,
) -> String {
    let mut page = String::from(INTRO);
    let cases: usize = tables.iter().map(|table| table.cases.len()).sum();
    let _ = write!(
        page,
        "\nMeasured on {on}.\n\n| Effect | Cases |\n|---|---|\n"
    );
    for table in tables {
        let link = table.effect.to_lowercase().replace(' ', "-");
        let _ = writeln!(
            page,
            "| [{}](#{link}) | {} |",
            table.effect,
            table.cases.len()
        );
    }
    let _ = writeln!(page, "| all | {cases} |");
    for (number, table) in tables.iter().enumerate() {
        let _ = write!(page, "\n## {}\n\n{}\n", table.effect, table.about);
        let mut claims: Vec<&Claim> = Vec::new();
        for case in &table.cases {
            if !claims.iter().any(|claim| claim.is_same(&case.claim)) {
                claims.push(&case.claim);
            }
        }
        for claim in claims {
            let _ = write!(
                page,
                "\n**Asserted:** {}.<br>\n**The bound comes from:** {}.\n\n| Case | Bound | Measured |\n|---|---|---|\n",
                claim.asserts, claim.why
            );
            let of_claim = table.cases.iter().enumerate();
            for (at, case) in of_claim.filter(|(_, case)| case.claim.is_same(claim)) {
                let found = measure(number, at);
                let last = found.map_or_else(String::new, |found| measured(claim, &found));
                let bound = with_unit(case.claim.bound, claim.unit);
                let row = [case.name.as_str(), &bound, &last];
                let row = row.map(|cell| cell.replace('|', "\\|").replace('\n', " "));
                let _ = writeln!(page, "| {} |", row.join(" | "));
            }
        }
    }
    page
}

/// What of a page comes from the tables alone: without the last column of rows with three, and what it was measured on.
fn skeleton(page: &str) -> Vec<&str> {
    page.lines()
        .filter(|line| !line.starts_with("Measured on "))
        .map(|line| match line.rsplit_once(" | ") {
            Some((before, _)) if is_row(line) => before.trim_end(),
            _ => line,
        })
        .collect()
}

/// Whether it is of a table of cases.
fn is_row(line: &str) -> bool {
    line.starts_with("| ") && line.matches(" | ").count() >= 2
}

/// Rows whose last column is empty or says that they failed.
fn unmeasured(page: &str) -> Vec<&str> {
    page.lines()
        .filter(|line| is_row(line))
        .filter(|line| {
            let last = line.rsplit_once(" | ").map_or("", |(_, last)| last);
            last.trim_end_matches('|').trim().is_empty() || last.starts_with("**fails**")
        })
        .collect()
}

/// The first line in which a page differs from the tables.
fn difference(page: &str, made: &str) -> Option<String> {
    let (there, here) = (skeleton(page), skeleton(made));
    let longest = there.len().max(here.len());
    (0..longest).find_map(|line| {
        let (there, here) = (there.get(line), here.get(line));
        (there != here).then(|| format!("line {}: {there:?} instead of {here:?}", line + 1))
    })
}

/// Date, by this machine's clock.
fn today() -> String {
    let now = utc_now();
    now.split(' ').next().unwrap_or(&now).to_owned()
}

#[test]
fn the_document_is_made_of_the_tables() {
    let tables = tables();
    let cases: usize = tables.iter().map(|table| table.cases.len()).sum();
    assert!(cases >= 200, "{cases} cases");
    for table in &tables {
        let mut names = HashSet::new();
        for case in &table.cases {
            let is_new = names.insert(&case.name);
            assert!(is_new, "{}: {} is there twice", table.effect, case.name);
        }
    }
    if std::env::var_os(WRITE).is_some() {
        let mut machine = Machine::default();
        let on = format!("{}, {}", machine.adapter(), today());
        let made = page(&tables, &on, |table, case| {
            Some(found(&tables[table].cases[case], &mut machine))
        });
        std::fs::write(path(), made).expect("the document can be written");
    }
    let there = std::fs::read_to_string(path()).unwrap_or_default();
    let made = page(&tables, "", |_, _| None);
    if let Some(difference) = difference(&there, &made) {
        panic!("docs/hard_cases.md is not the tables': {difference}; write it anew with {WRITE}=1");
    }
    let unmeasured = unmeasured(&there);
    assert!(unmeasured.is_empty(), "{unmeasured:#?}");
}

#[test]
fn a_page_that_differs_is_found() {
    const CLAIM: Claim = Claim {
        asserts: "it is right",
        bound: 0.5,
        unit: "px",
        why: "it must be",
    };
    let table = |name: &str, bound: f64| {
        let mut table = Table::new("An effect", "About it.");
        table.case(CLAIM.at_most(bound), name, |_| Measured::of(0.25));
        [table]
    };
    let measured =
        |tables: &[Table]| page(tables, "it", |_, _| Some(Measured::noted(0.25, "a | b")));
    let written = measured(&table("one", 0.5));
    assert!(written.contains("0.250 px; a \\| b"), "{written}");
    let differs = |tables: &[Table]| difference(&written, &page(tables, "another", |_, _| None));
    assert_eq!(differs(&table("one", 0.5)), None);
    assert!(differs(&table("two", 0.5)).is_some());
    assert!(differs(&table("one", 0.6)).is_some());
    assert!(differs(&[]).is_some());
    assert!(unmeasured(&written).is_empty());
    assert_eq!(
        unmeasured(&page(&table("one", 0.5), "it", |_, _| None)).len(),
        1
    );
    let failed = page(&table("one", 0.5), "it", |_, _| {
        Some(Err(Trouble::Wrong("no".into())))
    });
    assert_eq!(unmeasured(&failed).len(), 1);
}

#[test]
fn numbers_are_short() {
    for (x, text) in [
        (0.0, "0"),
        (12.0, "12"),
        (-0.25, "−0.250"),
        (3.2e-15, "3.2·10⁻¹⁵"),
        (1.5e7, "1.5·10⁷"),
        (f64::NEG_INFINITY, "−∞"),
    ] {
        assert_eq!(number(x), text);
    }
}
