//! One page of everything, in one file that needs no other.

use std::{fmt::Write, path::Path};

use base64::Engine;
use image::{ImageFormat, imageops::FilterType};

use super::{
    super::{
        Picture, Table, Timing,
        report::{escaped, failed, short, utc_now},
    },
    Done, Plan,
    chart::{COLOURS, Chart, Dot},
    front::{Point, Standing, front, standing},
    lines::{Group, Line, groups, same, words},
    shown::{SHOWN, Shown},
};
use crate::offline::accuracy::ReportError;

/// Pictures are made smaller to be no wider. units: px
const MOST_WIDE: u32 = 960;
/// So many groups of an effect are open at first.
const OPEN: usize = 2;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:1400px;margin:0 auto;padding:1em}\
h1{font-size:1.6em}h2{font-size:1.35em;margin-top:2em}\
nav{position:sticky;top:0;background:#fff;border-bottom:1px solid #ccc;padding:.4em 0;z-index:1}\
section{scroll-margin-top:6em}nav a{margin-right:1em;white-space:nowrap}nav a.here{font-weight:bold;color:#000;text-decoration:none}\
img{max-width:100%;border:1px solid #ccc}figure{margin:1.5em 0}figcaption{color:#444}\
table{border-collapse:collapse;display:block;overflow-x:auto;font-size:13px;margin:.6em 0}\
td,th{border:1px solid #ccc;padding:.15em .55em;text-align:right;white-space:nowrap}\
th{background:#f3f3f3}td.text,th.text{text-align:left}tr.default{background:#fff5d6}tr.front td:first-child{font-weight:bold}\
svg{width:640px;max-width:100%;height:auto}svg text{font:12px system-ui,sans-serif;fill:#333}\
svg .end{text-anchor:end}svg .mid{text-anchor:middle}svg .grid{stroke:#e4e4e4;fill:none}\
svg .front{stroke:#888;stroke-dasharray:5 4;fill:none}svg .ring{fill:none;stroke:#000;stroke-width:1.6}\
.charts{display:flex;flex-wrap:wrap;gap:1em}.key span{display:inline-block;width:.8em;height:.8em;border-radius:50%;margin:0 .3em 0 1em}\
details{margin:.8em 0}summary{cursor:pointer;font-weight:600}code{background:#f3f3f3;padding:.1em .3em}\
.ok{color:#00674b}.no{color:#a33000}";

/// Shows one page at a time; without it all are shown.
const SCRIPT: &str = "const all=[...document.querySelectorAll('section')],links=[...document.querySelectorAll('nav a')];\
function show(){const id=location.hash.slice(1)||'overview';\
const found=all.some(s=>s.id===id);all.forEach(s=>s.hidden=found&&s.id!==id);\
links.forEach(a=>a.className=a.hash.slice(1)===id?'here':'');scrollTo(0,0)}\
addEventListener('hashchange',show);show();";

/// Where defaults of an effect are.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verdict {
    /// Name of the effect.
    pub effect: &'static str,
    /// Groups with a default, and those in which it is on its front.
    pub groups: usize,
    /// See `groups`.
    pub on_front: usize,
    /// Groups where the clock can't tell.
    pub in_scatter: usize,
    /// Groups where it is behind, and it is said why.
    pub explained: usize,
    /// Groups where it is behind, and it isn't: `group: what beats it`.
    pub unexplained: Vec<String>,
}

/// A page, and where defaults are on it.
pub fn page(
    plan: &Plan,
    parts: &[Done],
    out: &Path,
) -> Result<(String, Vec<Verdict>), ReportError> {
    let mut verdicts = Vec::new();
    let mut sections = String::new();
    for part in parts {
        let _ = write!(sections, "<section id=\"{}\">", part.name);
        match SHOWN.iter().find(|shown| shown.effect == part.name) {
            Some(shown) => {
                let _ = write!(
                    sections,
                    "<h2>{}</h2><p>{} How it works, and when not to use it: <code>{}</code>.</p>",
                    shown.title, shown.what, shown.doc
                );
                verdicts.push(effect(&mut sections, shown, part));
            }
            None => {
                let _ = write!(sections, "<h2>{}</h2>", escaped(part.title));
            }
        }
        let _ = write!(
            sections,
            "<p>{} Measured on {} in {:.0} s.</p>",
            escaped(&part.summary.head),
            part.date,
            part.summary.seconds
        );
        for picture in &part.summary.pictures {
            figure(&mut sections, picture, &out.join(part.name))?;
        }
        let is_open = if SHOWN.iter().any(|shown| shown.effect == part.name) {
            ""
        } else {
            " open"
        };
        let _ = write!(
            sections,
            "<details{is_open}><summary>All tables of this part</summary>"
        );
        for table in &part.tables {
            tabled(&mut sections, table);
        }
        sections.push_str("</details></section>");
    }
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>What accuracy costs</title><style>{STYLE}</style>\n<h1>What accuracy costs</h1>\n<nav><a href=\"#overview\">overview</a>"
    );
    for part in parts {
        let _ = write!(page, "<a href=\"#{0}\">{0}</a>", part.name);
    }
    page.push_str("</nav>\n<section id=\"overview\">");
    overview(&mut page, plan, parts, &verdicts);
    page.push_str("</section>\n");
    page.push_str(&sections);
    let _ = writeln!(page, "<script>{SCRIPT}</script></html>");
    Ok((page, verdicts))
}

fn overview(page: &mut String, plan: &Plan, parts: &[Done], verdicts: &[Verdict]) {
    let _ = write!(
        page,
        "<p>Time against error for every knob of every effect, in one run on one machine: adapter {}; \
         bevy_skyline {}, Bevy {}; made on {} by <code>{}</code>.</p>\
         <p>In the drawings, further left is less wrong and further down is quicker. The dashed line joins the Pareto \
         front: settings that no other beats in both. A ring marks the default; numbers are those of the table beneath. \
         Point at a dot to see its setting. All figures: <a href=\"results.csv\">results.csv</a>, \
         <a href=\"results.jsonl\">results.jsonl</a>.</p>",
        escaped(&super::adapters(parts)),
        env!("CARGO_PKG_VERSION"),
        super::BEVY,
        utc_now(),
        escaped(&plan.command),
    );
    page.push_str(
        "<table><tr><th class=\"text\">effect</th><th>settings measured</th><th>scenes</th><th>default on its front</th>\
         <th>within scatter</th><th>behind, reason given</th><th>unexplained</th><th>s</th></tr>",
    );
    for part in parts {
        let verdict = verdicts.iter().find(|verdict| verdict.effect == part.name);
        let cell = |of: fn(&Verdict) -> usize| {
            verdict.map_or_else(String::new, |verdict| of(verdict).to_string())
        };
        let _ = write!(
            page,
            "<tr><td class=\"text\"><a href=\"#{0}\">{0}</a></td><td>{1}</td><td>{2}</td><td>{3}</td><td>{4}</td><td>{5}</td><td>{6}</td><td>{7:.0}</td></tr>",
            part.name,
            part.lines.len(),
            cell(|verdict| verdict.groups),
            cell(|verdict| verdict.on_front),
            cell(|verdict| verdict.in_scatter),
            cell(|verdict| verdict.explained),
            cell(|verdict| verdict.unexplained.len()),
            part.summary.seconds,
        );
    }
    page.push_str("</table>");
}

/// All groups of an effect.
fn effect(page: &mut String, shown: &Shown, part: &Done) -> Verdict {
    let mut verdict = Verdict {
        effect: shown.effect,
        ..Verdict::default()
    };
    let groups = groups(&part.lines, shown.circumstances);
    let all: Vec<(&Group, Compared)> = groups
        .iter()
        .filter_map(|group| Some((group, Compared::of(shown, group)?)))
        .collect();
    for (number, (group, compared)) in all.iter().enumerate() {
        let open = if number < OPEN { " open" } else { "" };
        let _ = write!(
            page,
            "<details{open}><summary>{}</summary>",
            escaped(&group.name)
        );
        page.push_str(&compared.judge(shown, group, &all, &mut verdict));
        compared.draw(page);
        page.push_str("</details>");
    }
    verdict
}

/// A group whose settings can be compared: those that were timed, by the errors that all of them have.
struct Compared<'a> {
    errors: Vec<(&'static str, &'static str)>,
    lines: Vec<&'a Line>,
    points: Vec<Point>,
    on_front: Vec<bool>,
    default: Option<usize>,
    /// Fields that differ.
    knobs: Vec<String>,
}

impl<'a> Compared<'a> {
    fn of(shown: &Shown, group: &Group<'a>) -> Option<Self> {
        let mut lines: Vec<&Line> = group
            .lines
            .iter()
            .copied()
            .filter(|line| line.time_ms.runs > 0)
            .collect();
        lines.sort_by(|a, b| a.time_ms.median.total_cmp(&b.time_ms.median));
        let errors: Vec<_> = shown
            .errors
            .iter()
            .copied()
            .filter(|(place, _)| lines.iter().all(|line| line.number(place).is_some()))
            .collect();
        if lines.len() < 2 || errors.is_empty() {
            return None;
        }
        let points: Vec<Point> = lines
            .iter()
            .map(|line| Point {
                ms: line.time_ms,
                errors: errors
                    .iter()
                    .filter_map(|(place, _)| line.number(place))
                    .collect(),
            })
            .collect();
        let default = (shown.defaults)()
            .iter()
            .find_map(|default| lines.iter().position(|line| line.is_set(default)));
        let mut knobs: Vec<String> = Vec::new();
        for line in &lines {
            for field in line.setting.keys() {
                let own = |line: &Line| line.setting.get(field).cloned().unwrap_or_default();
                let differs = lines.iter().any(|other| !same(&own(other), &own(line)));
                if differs && !knobs.contains(field) {
                    knobs.push(field.clone());
                }
            }
        }
        Some(Self {
            errors,
            on_front: front(&points),
            lines,
            points,
            default,
            knobs,
        })
    }

    fn name(&self, at: usize) -> String {
        let same: Vec<&str> = self.lines[at]
            .setting
            .keys()
            .map(String::as_str)
            .filter(|field| !self.knobs.iter().any(|knob| knob == field))
            .collect();
        self.lines[at].name(&same)
    }

    /// The one knob that is not at its default, by its number; none if it is several.
    fn kind(&self, at: usize) -> Option<usize> {
        let default = &self.lines[self.default?].setting;
        let own = &self.lines[at].setting;
        let mut moved = (0..self.knobs.len()).filter(|&knob| {
            let knob = &self.knobs[knob];
            !same(
                own.get(knob).unwrap_or(&serde_json::Value::Null),
                default.get(knob).unwrap_or(&serde_json::Value::Null),
            )
        });
        let first = moved.next();
        first.filter(|_| moved.next().is_none())
    }

    /// Says where the default is.
    fn judge(
        &self,
        shown: &Shown,
        group: &Group,
        all: &[(&Group, Self)],
        verdict: &mut Verdict,
    ) -> String {
        let Some(at) = self.default else {
            return "<p>The default is not among these settings.</p>".to_owned();
        };
        verdict.groups += 1;
        let own = &self.points[at];
        let beaten = |by: usize| {
            let quicker = 1.0 - self.points[by].ms.median / own.ms.median.max(1e-12);
            format!(
                "number {} ({}) is {} % quicker and no more wrong",
                by + 1,
                escaped(&self.name(by)),
                short(100.0 * quicker)
            )
        };
        let default = format!("The default (number {})", at + 1);
        match standing(&self.points, at) {
            Standing::OnFront => {
                verdict.on_front += 1;
                format!("<p class=\"ok\">{default} is on its Pareto front.</p>")
            }
            Standing::Scatter { by } => {
                verdict.in_scatter += 1;
                format!(
                    "<p class=\"ok\">{default} is on its Pareto front as far as can be told: {}, and it was as quick at times.</p>",
                    beaten(by)
                )
            }
            Standing::Behind { by } => {
                let said = format!("{default} is behind: {}", beaten(by));
                let reason = shown
                    .reasons
                    .iter()
                    .find(|reason| (reason.about)(self.lines[by], self.lines[at]))
                    .map(|reason| reason.text.to_owned());
                if let Some(reason) = elsewhere(shown, self.lines[by], all).or(reason) {
                    verdict.explained += 1;
                    format!("<p>{said}: {reason}.</p>")
                } else {
                    let found = format!("{}: {}", group.name, self.name(by));
                    verdict.unexplained.push(found);
                    format!("<p class=\"no\">{said}. Not explained.</p>")
                }
            }
        }
    }

    fn draw(&self, page: &mut String) {
        page.push_str("<div class=\"charts\">");
        for (which, (_, name)) in self.errors.iter().enumerate() {
            let alone: Vec<Point> = self
                .points
                .iter()
                .map(|point| Point {
                    ms: point.ms,
                    errors: vec![point.errors[which]],
                })
                .collect();
            let on_front = front(&alone);
            let dots = (0..self.lines.len()).map(|at| Dot {
                number: at + 1,
                name: self.name(at),
                ms: self.points[at].ms.median,
                error: self.points[at].errors[which],
                kind: self.kind(at),
                is_default: self.default == Some(at),
                on_front: on_front[at],
            });
            let chart = Chart {
                error: (*name).to_owned(),
                dots: dots.collect(),
            };
            page.push_str(&chart.svg());
        }
        page.push_str("</div><p class=\"key\">Only this knob is not at its default:");
        for (at, knob) in self.knobs.iter().enumerate() {
            let _ = write!(
                page,
                "<span style=\"background:{}\"></span>{}",
                COLOURS[at % COLOURS.len()],
                escaped(knob)
            );
        }
        page.push_str("<span style=\"background:#9a9a9a\"></span>several, or none</p>");
        self.table(page);
    }

    fn table(&self, page: &mut String) {
        page.push_str("<table><tr><th>#</th>");
        for knob in &self.knobs {
            let _ = write!(page, "<th class=\"text\">{}</th>", escaped(knob));
        }
        page.push_str("<th>ms</th><th>least … most (runs)</th>");
        for (_, name) in &self.errors {
            let _ = write!(page, "<th>{}</th>", escaped(name));
        }
        page.push_str("<th class=\"text\"></th></tr>");
        for (at, line) in self.lines.iter().enumerate() {
            let is_default = self.default == Some(at);
            let class = match (is_default, self.on_front[at]) {
                (true, _) => " class=\"default\"",
                (false, true) => " class=\"front\"",
                (false, false) => "",
            };
            let _ = write!(page, "<tr{class}><td>{}</td>", at + 1);
            for knob in &self.knobs {
                let value = line.setting.get(knob).map(words).unwrap_or_default();
                let _ = write!(page, "<td class=\"text\">{}</td>", escaped(&value));
            }
            let Timing {
                median,
                min,
                max,
                runs,
            } = line.time_ms;
            let _ = write!(
                page,
                "<td>{}</td><td>{} … {} ({runs})</td>",
                short(median),
                short(min),
                short(max)
            );
            for (place, _) in &self.errors {
                let value = line.number(place).map(short).unwrap_or_default();
                let _ = write!(page, "<td>{value}</td>");
            }
            let marks = [
                is_default.then_some("default"),
                self.on_front[at].then_some("on the front"),
            ];
            let marks: Vec<_> = marks.into_iter().flatten().collect();
            let _ = write!(page, "<td class=\"text\">{}</td></tr>", marks.join(", "));
        }
        page.push_str("</table>");
    }
}

/// Where a setting that is better than the default in one scene is worse in another, beyond scatter: the scene in which it is
/// most so.
fn elsewhere(shown: &Shown, setting: &Line, all: &[(&Group, Compared)]) -> Option<String> {
    let mut most: Option<(f64, String)> = None;
    for (group, compared) in all {
        let by =
            |line: &&Line| line.knobs(shown.circumstances) == setting.knobs(shown.circumstances);
        let (Some(default), Some(by)) = (compared.default, compared.lines.iter().position(by))
        else {
            continue;
        };
        let (own, other) = (&compared.points[default], &compared.points[by]);
        let scene = escaped(&group.name);
        let more_wrong = compared
            .errors
            .iter()
            .zip(own.errors.iter().zip(&other.errors))
            .find(|(_, (own, other))| other > own);
        let slower = other.ms.median / own.ms.median.max(1e-12);
        let found = if let Some(((_, name), (own, other))) = more_wrong {
            // Whatever it gains in time elsewhere.
            let text = format!(
                "in {scene} it is more wrong, {} instead of {} ({name})",
                short(*other),
                short(*own)
            );
            (f64::INFINITY, text)
        } else if other.ms.median > own.ms.max {
            let percent = short(100.0 * (slower - 1.0));
            (slower, format!("in {scene} it takes {percent} % longer"))
        } else {
            continue;
        };
        if most.as_ref().is_none_or(|most| found.0 > most.0) {
            most = Some(found);
        }
    }
    most.map(|(_, text)| format!("elsewhere it is not; {text}"))
}

/// A picture within the page.
fn figure(page: &mut String, picture: &Picture, directory: &Path) -> Result<(), ReportError> {
    let path = directory.join(&picture.file);
    let bytes = std::fs::read(&path).map_err(|error| failed(&path, &error))?;
    let decoded = image::load_from_memory_with_format(&bytes, ImageFormat::Png)
        .map_err(|error| failed(&path, &error))?;
    let bytes = if decoded.width() > MOST_WIDE {
        let height = decoded.height() * MOST_WIDE / decoded.width();
        let smaller = decoded.resize(MOST_WIDE, height.max(1), FilterType::Triangle);
        let mut bytes = std::io::Cursor::new(Vec::new());
        smaller
            .write_to(&mut bytes, ImageFormat::Png)
            .map_err(|error| failed(&path, &error))?;
        bytes.into_inner()
    } else {
        bytes
    };
    let what = escaped(&picture.what);
    let data = base64::engine::general_purpose::STANDARD.encode(bytes);
    let _ = writeln!(
        page,
        "<figure><img src=\"data:image/png;base64,{data}\" alt=\"{what}\"><figcaption>{what}</figcaption></figure>"
    );
    Ok(())
}

fn tabled(page: &mut String, (title, heads, rows): &Table) {
    let cells = |tag: &str, row: &[String]| {
        row.iter()
            .map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell)))
            .collect::<String>()
    };
    let _ = write!(
        page,
        "<h3>{}</h3><table><tr>{}</tr>",
        escaped(title),
        cells("th", heads)
    );
    for row in rows {
        let _ = write!(page, "<tr>{}</tr>", cells("td", row));
    }
    page.push_str("</table>");
}
