//! `skyline accuracy all`: every effect measured in one run, and one page that shows it all.
//!
//! Each part is measured as its own command measures it, into its own directory, and marked as done with what it was
//! measured with: a run that was cut off goes on where it was, and one with other settings begins anew. From the parts'
//! results come `results.jsonl`, `results.csv` and `index.html`, one file that needs no network and no other file.

mod chart;
pub mod front;
mod lines;
mod page;
mod shown;

use std::path::{Path, PathBuf};

use bevy::platform::time::Instant;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{
    AccuracyError, ReportError, Summary, Table, budget, contribution, growth, idle, interior,
    occlusion,
    report::{failed, utc_now},
    scene::Ground,
    shadow, spherical, terrain,
};

pub use page::Verdict;

/// The version that is built with.
const BEVY: &str = "0.19.1";
/// Marks a part as done.
const DONE: &str = "done.json";

/// What to measure.
#[derive(Clone, Debug)]
pub struct Plan {
    /// At most ten minutes on two cores without a GPU.
    pub quick: bool,
    /// A height field and its name; else ground made by code.
    pub field: Option<(crate::terrain::HeightField, String)>,
    /// A mesh (`.obj`) for occlusion and spherical.
    pub mesh: Option<PathBuf>,
    /// Models (`.glb`) for interior.
    pub models: Vec<PathBuf>,
    /// A city (`.glb`) for occlusion, contribution and budget.
    pub city: Option<PathBuf>,
    /// The command that this is, for the page.
    pub command: String,
}

/// One thing that is measured.
struct Part {
    name: &'static str,
    title: &'static str,
    measure: fn(&Plan, &Path) -> Result<Summary, AccuracyError>,
    /// What it is measured with: another key, and it is measured anew.
    key: fn(&Plan) -> String,
}

/// A part that is measured.
pub(crate) struct Done {
    name: &'static str,
    title: &'static str,
    date: String,
    summary: Told,
    lines: Vec<lines::Line>,
    tables: Vec<Table>,
}

/// What is kept of a [`Summary`].
#[derive(Serialize, Deserialize, Clone, Debug)]
struct Told {
    adapter: String,
    seconds: f64,
    head: String,
    pictures: Vec<super::Picture>,
}

/// The mark.
#[derive(Serialize, Deserialize, Debug)]
struct Mark {
    key: String,
    version: String,
    date: String,
    summary: Told,
}

impl Plan {
    fn ground(&self, of_shadow: bool) -> Result<Ground, AccuracyError> {
        match &self.field {
            Some((field, name)) => Ok(Ground {
                field: field.clone(),
                name: name.clone(),
            }),
            None => Ok(Ground::made_by_code(self.quick, of_shadow)?),
        }
    }

    /// A plan of a part: the quick one or the full one.
    fn pick<T>(&self, quick: fn() -> T, full: fn() -> T) -> T {
        if self.quick { quick() } else { full() }
    }

    /// What ground is measured on, for a key.
    fn field_key(&self) -> String {
        match &self.field {
            Some((field, name)) => format!("{name} {} {}", field.size(), field.texel_m()),
            None => "made by code".to_owned(),
        }
    }

    fn occlusion(&self) -> occlusion::Plan {
        let base = self.pick(occlusion::Plan::quick, occlusion::Plan::full);
        occlusion::Plan {
            model: self.mesh.clone(),
            city: self.city_of(),
            ..base
        }
    }

    fn contribution(&self) -> contribution::Plan {
        contribution::Plan {
            city: self.city_of(),
            ..self.pick(contribution::Plan::quick, contribution::Plan::full)
        }
    }

    fn budget(&self) -> budget::Plan {
        budget::Plan {
            city: self.city_of(),
            ..self.pick(budget::Plan::quick, budget::Plan::full)
        }
    }

    fn interior(&self) -> interior::Plan {
        interior::Plan {
            models: self.models.clone(),
            ..self.pick(interior::Plan::quick, interior::Plan::full)
        }
    }

    fn spherical(&self) -> spherical::Plan {
        spherical::Plan {
            model: self.mesh.clone(),
            ..self.pick(spherical::Plan::quick, spherical::Plan::full)
        }
    }

    /// Quick runs take a small city made by code.
    fn city_of(&self) -> Option<PathBuf> {
        self.city.clone().filter(|_| !self.quick)
    }
}

const PARTS: [Part; 9] = [
    Part {
        name: "terrain",
        title: "Terrain ray casting",
        measure: |plan, out| {
            let Ground { field, name } = plan.ground(false)?;
            let of = plan.pick(terrain::Plan::quick, terrain::Plan::full);
            terrain::measure(field, &name, &of, out)
        },
        key: |plan| {
            let of = plan.pick(terrain::Plan::quick, terrain::Plan::full);
            format!("{of:?} {}", plan.field_key())
        },
    },
    Part {
        name: "shadow",
        title: "Terrain shadow maps",
        measure: |plan, out| {
            let Ground { field, name } = plan.ground(true)?;
            let of = plan.pick(shadow::Plan::quick, shadow::Plan::full);
            shadow::measure(field, &name, &of, out)
        },
        key: |plan| {
            let of = plan.pick(shadow::Plan::quick, shadow::Plan::full);
            format!("{of:?} {}", plan.field_key())
        },
    },
    Part {
        name: "occlusion",
        title: "Z-buffer occlusion culling",
        measure: |plan, out| occlusion::measure(&plan.occlusion(), out),
        key: |plan| format!("{:?}", plan.occlusion()),
    },
    Part {
        name: "contribution",
        title: "Contribution culling",
        measure: |plan, out| contribution::measure(&plan.contribution(), out),
        key: |plan| format!("{:?}", plan.contribution()),
    },
    Part {
        name: "budget",
        title: "The frame budget",
        measure: |plan, out| budget::measure(&plan.budget(), out),
        key: |plan| format!("{:?}", plan.budget()),
    },
    Part {
        name: "interior",
        title: "Interior culling",
        measure: |plan, out| interior::measure(&plan.interior(), out),
        key: |plan| format!("{:?}", plan.interior()),
    },
    Part {
        name: "spherical",
        title: "Spherical index",
        measure: |plan, out| spherical::measure(&plan.spherical(), out),
        key: |plan| format!("{:?}", plan.spherical()),
    },
    Part {
        name: "growth",
        title: "How cost grows with size",
        measure: |plan, out| {
            growth::measure(&plan.pick(growth::Plan::quick, growth::Plan::full), out)
        },
        key: |plan| format!("{:?}", plan.pick(growth::Plan::quick, growth::Plan::full)),
    },
    Part {
        name: "idle",
        title: "What nothing costs: the plugins in a scene that uses none of them",
        measure: |plan, out| idle::measure(&plan.pick(idle::Plan::quick, idle::Plan::full), out),
        key: |plan| format!("{:?}", plan.pick(idle::Plan::quick, idle::Plan::full)),
    },
];

/// Measures everything that isn't done yet, and writes the page. `tell` hears what is begun and what was done before.
///
/// # Errors
/// [`AccuracyError`]: what is done by then stays, and needs not be done again.
pub fn measure(
    plan: &Plan,
    out: &Path,
    tell: &mut dyn FnMut(&str),
) -> Result<Summary, AccuracyError> {
    let began = Instant::now();
    let mut parts = Vec::new();
    for (at, part) in PARTS.iter().enumerate() {
        let directory = out.join(part.name);
        let key = (part.key)(plan);
        let (date, summary) = match done_before(&directory, &key) {
            Some(mark) => {
                tell(&format!(
                    "{} ({} of {}): done before, on {}; to measure it again, remove {}",
                    part.name,
                    at + 1,
                    PARTS.len(),
                    mark.date,
                    directory.display()
                ));
                (mark.date, mark.summary)
            }
            None => {
                tell(&format!("{} ({} of {})", part.name, at + 1, PARTS.len()));
                let summary = (part.measure)(plan, &directory)?;
                let mark = Mark {
                    key,
                    version: env!("CARGO_PKG_VERSION").to_owned(),
                    date: utc_now(),
                    summary: Told {
                        adapter: summary.adapter,
                        seconds: summary.seconds,
                        head: summary.head,
                        pictures: summary.pictures,
                    },
                };
                write(&directory.join(DONE), &json!(mark).to_string())?;
                (mark.date, mark.summary)
            }
        };
        parts.push(Done {
            name: part.name,
            title: part.title,
            date,
            summary,
            lines: lines::read(&directory.join("results.jsonl"))?,
            tables: tables(&directory)?,
        });
    }
    let (page, verdicts) = page::page(plan, &parts, out)?;
    let index = out.join("index.html");
    write(&index, &page)?;
    let mut files = vec![index.clone()];
    files.extend(merged(&parts, out)?);
    let unexplained: usize = verdicts
        .iter()
        .map(|verdict| verdict.unexplained.len())
        .sum();
    Ok(Summary {
        effect: "all",
        adapter: adapters(&parts),
        clock: "each part's own",
        results: parts.iter().map(|part| part.lines.len()).sum(),
        seconds: began.elapsed().as_secs_f64(),
        index,
        files,
        pictures: Vec::new(),
        head: String::new(),
        highlights: json!({
            "seconds": parts.iter().map(|part| (part.name.to_owned(), json!(part.summary.seconds))).collect::<serde_json::Map<_, _>>(),
            "unexplained": unexplained,
            "defaults": verdicts.iter().map(|verdict| json!({
                "effect": verdict.effect,
                "scenes": verdict.groups,
                "on_front": verdict.on_front,
                "in_scatter": verdict.in_scatter,
                "explained": verdict.explained,
                "unexplained": verdict.unexplained,
            })).collect::<Vec<_>>(),
        }),
    })
}

/// Every adapter that did a part.
fn adapters(parts: &[Done]) -> String {
    let mut names: Vec<&str> = Vec::new();
    for part in parts {
        if !names.contains(&&*part.summary.adapter) {
            names.push(&part.summary.adapter);
        }
    }
    names.join("; ")
}

fn done_before(directory: &Path, key: &str) -> Option<Mark> {
    let text = std::fs::read_to_string(directory.join(DONE)).ok()?;
    let mark: Mark = serde_json::from_str(&text).ok()?;
    let is_whole = mark
        .summary
        .pictures
        .iter()
        .all(|picture| directory.join(&picture.file).is_file());
    let is_same = mark.key == key && mark.version == env!("CARGO_PKG_VERSION");
    (is_same && is_whole && directory.join("results.jsonl").is_file()).then_some(mark)
}

fn tables(directory: &Path) -> Result<Vec<Table>, ReportError> {
    let path = directory.join("tables.json");
    let text = std::fs::read_to_string(&path).map_err(|error| failed(&path, &error))?;
    serde_json::from_str(&text).map_err(|error| failed(&path, &error))
}

/// All lines in one file of each kind.
fn merged(parts: &[Done], out: &Path) -> Result<[PathBuf; 2], ReportError> {
    let all = || parts.iter().flat_map(|part| &part.lines);
    let mut text = String::new();
    for line in all() {
        text += &line.all.to_string();
        text.push('\n');
    }
    let results = out.join("results.jsonl");
    write(&results, &text)?;
    let (heads, rows) = lines::flat(all().map(|line| &line.all));
    let table = out.join("results.csv");
    write(&table, &super::report::csv_text(&heads, &rows))?;
    Ok([results, table])
}

fn write(path: &Path, text: &str) -> Result<(), ReportError> {
    std::fs::write(path, text).map_err(|error| failed(path, &error))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan() -> Plan {
        Plan {
            quick: true,
            field: None,
            mesh: None,
            models: Vec::new(),
            city: None,
            command: "skyline accuracy all --quick --out <DIR>".into(),
        }
    }

    /// Every part as if it had been measured: the default, and one that is quicker and more wrong.
    fn all_done(out: &Path, plan: &Plan) {
        for part in &PARTS {
            let directory = out.join(part.name);
            std::fs::create_dir_all(&directory).expect("a directory");
            image::RgbImage::new(1200, 30)
                .save(directory.join("a.png"))
                .expect("a picture");
            let shown = shown::SHOWN.iter().find(|shown| shown.effect == part.name);
            let default = shown.and_then(|shown| (shown.defaults)().into_iter().next());
            let line = |ms: f64, error: f64, setting: &serde_json::Value| {
                let mut line = json!({
                    "effect": part.name,
                    "scene": "here",
                    "setting": setting,
                    "time_ms": Timing::of(vec![ms, 1.01 * ms]),
                });
                for (place, _) in shown.map_or(&[][..], |shown| shown.errors) {
                    match place.strip_prefix("/error/") {
                        Some(field) => line["error"][field] = json!(error),
                        None => line[place.trim_start_matches('/')] = json!(error),
                    }
                }
                line
            };
            let default = default.unwrap_or(json!({}));
            let mut other = json!({ "knob": "other" });
            if let Some(occlusion) = default.get("occlusion") {
                other["occlusion"] = occlusion.clone();
            }
            let lines = [line(2.0, 0.0, &default), line(1.0, 3.0, &other)];
            let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
            write(&directory.join("results.jsonl"), &text).expect("results");
            let tables: Vec<Table> = vec![("t".into(), vec!["a<b".into()], vec![vec!["1".into()]])];
            write(&directory.join("tables.json"), &json!(tables).to_string()).expect("tables");
            let mark = Mark {
                key: (part.key)(plan),
                version: env!("CARGO_PKG_VERSION").into(),
                date: "then".into(),
                summary: Told {
                    adapter: "an adapter".into(),
                    seconds: 1.0,
                    head: "measured".into(),
                    pictures: vec![crate::offline::accuracy::Picture {
                        file: "a.png".into(),
                        what: "a & b".into(),
                    }],
                },
            };
            write(&directory.join(DONE), &json!(mark).to_string()).expect("a mark");
        }
    }

    use crate::offline::accuracy::Timing;

    #[test]
    fn what_is_done_is_not_done_again_and_the_page_needs_no_other_file() {
        let out = tempfile::tempdir().expect("a directory");
        let plan = plan();
        all_done(out.path(), &plan);
        let mut told = Vec::new();
        let summary = measure(&plan, out.path(), &mut |line| told.push(line.to_owned()))
            .expect("nothing is left to measure");
        assert_eq!(told.len(), PARTS.len());
        assert!(told.iter().all(|line| line.contains("done before")));
        let page = std::fs::read_to_string(&summary.index).expect("a page");
        for part in &PARTS {
            assert!(page.contains(&format!("<section id=\"{}\">", part.name)));
        }
        assert_eq!(
            page.matches("<img src=\"data:image/png;base64,").count(),
            PARTS.len()
        );
        assert_eq!(page.matches("<img").count(), PARTS.len());
        assert!(!page.contains("http") && !page.contains("<link") && !page.contains("src=\"/"));
        assert!(page.contains("a &amp; b") && page.contains("a&lt;b"));
        assert!(page.contains("accuracy all --quick --out &lt;DIR&gt;"));
        // The default is less wrong and slower: on its front, in each of the seven.
        assert_eq!(
            page.matches("is on its Pareto front.").count(),
            shown::SHOWN.len()
        );
        assert_eq!(summary.highlights["unexplained"], 0);
        let text = |name: &str| std::fs::read_to_string(out.path().join(name)).expect("a file");
        assert_eq!(text("results.jsonl").lines().count(), 2 * PARTS.len());
        assert_eq!(text("results.csv").lines().count(), 2 * PARTS.len() + 1);
    }

    #[test]
    fn what_was_done_with_other_settings_or_is_not_whole_is_measured_again() {
        let out = tempfile::tempdir().expect("a directory");
        let plan = plan();
        all_done(out.path(), &plan);
        let terrain = out.path().join("terrain");
        let key = (PARTS[0].key)(&plan);
        assert!(done_before(&terrain, &key).is_some());
        let full = Plan {
            quick: false,
            ..plan
        };
        assert!(done_before(&terrain, &(PARTS[0].key)(&full)).is_none());
        std::fs::remove_file(terrain.join("a.png")).expect("it is there");
        assert!(done_before(&terrain, &key).is_none());
        assert!(done_before(out.path(), &key).is_none());
    }

    #[test]
    fn a_default_that_is_beaten_is_told() {
        let out = tempfile::tempdir().expect("a directory");
        let plan = plan();
        all_done(out.path(), &plan);
        let results = out.path().join("interior/results.jsonl");
        let text = std::fs::read_to_string(&results).expect("results");
        // The other is no more wrong now.
        write(&results, &text.replace("3.0", "0.0")).expect("results");
        let summary = measure(&plan, out.path(), &mut |_| {}).expect("a page");
        assert_eq!(summary.highlights["unexplained"], 1);
        let page = std::fs::read_to_string(&summary.index).expect("a page");
        assert_eq!(page.matches("Not explained.").count(), 1);
    }
}
