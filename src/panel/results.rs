//! What `skyline accuracy` measured, read back for the plot of accuracy against time.
//!
//! A file is lines of JSON. A line is a result if it has an object `error` with at least one number and a time
//! `time_ms.median` that is finite and above 0; everything else may be missing. What is no result is left out and
//! named by its line's number; a file without any result is an error.

use std::{
    fs::File,
    io::Read,
    path::{Path, PathBuf},
};

use serde_json::{Map, Value};

/// Larger files are not read. units: bytes
const MOST_BYTES: u64 = 64 << 20;
/// Larger numbers are none: differences and quotients of these are finite.
const LARGEST: f64 = 1e30;

/// Why a file could not be shown.
#[derive(thiserror::Error, Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ResultsError {
    /// There is nothing to read.
    #[error(
        "{} cannot be read ({reason}); `skyline accuracy all --out DIR` writes DIR/results.jsonl",
        path.display()
    )]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What is in the way.
        reason: String,
    },
    /// More than a plot can show.
    #[error("{} is larger than 64 MiB; load the results of one effect instead", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
    },
    /// Nothing in it is a result.
    #[error(
        "{} holds no result (line {line}: {why}); load a results.jsonl that `skyline accuracy` wrote",
        path.display()
    )]
    NoResult {
        /// The file.
        path: PathBuf,
        /// The first line that is none.
        line: usize,
        /// Why it is none.
        why: &'static str,
    },
}

/// A line that was left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BadLine {
    /// From 1.
    pub line: usize,
    /// Why it is no result.
    pub why: &'static str,
}

/// One setting, measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Index into [`Results::groups`].
    pub group: usize,
    /// Index into [`Results::kinds`].
    pub kind: usize,
    /// The setting in words.
    pub setting: String,
    /// Median. range: above 0; units: ms
    pub time_ms: f64,
    /// By [`Results::errors`]; `None` where it was not measured.
    pub errors: Vec<Option<f64>>,
}

/// A file of results.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Results {
    /// In the order of their lines.
    pub points: Vec<Point>,
    /// Effect and scene: only points of one group can be compared.
    pub groups: Vec<String>,
    /// Names of the error fields.
    pub errors: Vec<String>,
    /// Values of the setting that points are coloured by: the first one that is a word and varies.
    pub kinds: Vec<String>,
    /// What was left out.
    pub left_out: Vec<BadLine>,
}

impl Results {
    /// Reads a file, or `results.jsonl` in a directory.
    ///
    /// # Errors
    /// [`ResultsError`].
    pub fn load(path: &Path) -> Result<Self, ResultsError> {
        let path = if path.is_dir() {
            path.join("results.jsonl")
        } else {
            path.to_owned()
        };
        let unreadable = |error: std::io::Error| ResultsError::Unreadable {
            path: path.clone(),
            reason: error.to_string(),
        };
        let file = File::open(&path).map_err(unreadable)?;
        let mut bytes = Vec::new();
        // One byte more than allowed tells; a size that the file system states may be wrong.
        let read = file.take(MOST_BYTES + 1).read_to_end(&mut bytes);
        if read.map_err(unreadable)? as u64 > MOST_BYTES {
            return Err(ResultsError::TooLarge { path });
        }
        Self::parse(&String::from_utf8_lossy(&bytes)).map_err(|bad| ResultsError::NoResult {
            path,
            line: bad.line,
            why: bad.why,
        })
    }

    /// Reads lines.
    ///
    /// # Errors
    /// The first line that is no result, where none is.
    pub fn parse(text: &str) -> Result<Self, BadLine> {
        let mut results = Self::default();
        let mut settings = Vec::new();
        for (i, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() {
                continue;
            }
            match results.read_line(line) {
                Ok(setting) => settings.push(setting),
                Err(why) => results.left_out.push(BadLine { line: i + 1, why }),
            }
        }
        if results.points.is_empty() {
            let nothing = BadLine {
                line: 1,
                why: "there is nothing in it",
            };
            return Err(results.left_out.first().copied().unwrap_or(nothing));
        }
        results.find_kinds(&settings);
        // A field that first came up on a later line is missing on those before.
        for point in &mut results.points {
            point.errors.resize(results.errors.len(), None);
        }
        Ok(results)
    }

    /// Adds a line's point and returns its setting.
    fn read_line(&mut self, line: &str) -> Result<Map<String, Value>, &'static str> {
        let value: Value = serde_json::from_str(line).map_err(|_| "it is no JSON")?;
        let time_ms = value
            .pointer("/time_ms/median")
            .and_then(Value::as_f64)
            .filter(|ms| *ms > 0.0 && *ms <= LARGEST)
            .ok_or("it has no time_ms.median above 0")?;
        let fields = value
            .get("error")
            .and_then(Value::as_object)
            .filter(|fields| fields.values().any(Value::is_number))
            .ok_or("it has no error with a number in it")?;
        let mut errors = Vec::new();
        for (name, value) in fields {
            let Some(value) = value.as_f64().filter(|value| value.abs() <= LARGEST) else {
                continue;
            };
            let at = index_of(&mut self.errors, name);
            if errors.len() <= at {
                errors.resize(at + 1, None);
            }
            errors[at] = Some(value);
        }
        let text = |key| value.get(key).and_then(Value::as_str).unwrap_or("");
        let group = match (text("effect"), text("scene")) {
            (effect, "") => effect.to_owned(),
            ("", scene) => scene.to_owned(),
            (effect, scene) => format!("{effect} · {scene}"),
        };
        let setting = match value.get("setting") {
            Some(Value::Object(setting)) => setting.clone(),
            Some(other) if !other.is_null() => Map::from_iter([("setting".into(), other.clone())]),
            _ => Map::new(),
        };
        let group = index_of(&mut self.groups, &group);
        self.points.push(Point {
            group,
            kind: 0,
            setting: words(&setting),
            time_ms,
            errors,
        });
        Ok(setting)
    }

    /// Sorts points into kinds by the first setting, by name, that is a word and not always the same.
    fn find_kinds(&mut self, settings: &[Map<String, Value>]) {
        let word = |setting: &Map<String, Value>, key: &str| {
            setting.get(key).and_then(Value::as_str).map(str::to_owned)
        };
        let varies = |key: &&String| {
            let mut values = settings.iter().map(|setting| word(setting, key));
            let first = values.find(Option::is_some).flatten();
            first.is_some() && values.flatten().any(|value| Some(value) != first)
        };
        let Some(key) = settings.iter().flat_map(Map::keys).find(varies) else {
            self.kinds = vec![String::new()];
            return;
        };
        for (point, setting) in self.points.iter_mut().zip(settings) {
            let value = word(setting, key).unwrap_or_else(|| format!("no {key}"));
            point.kind = index_of(&mut self.kinds, &value);
        }
    }

    /// What was left out, in a sentence; `None` if nothing was.
    pub fn complaint(&self) -> Option<String> {
        let first = self.left_out.first()?;
        let lines = self.left_out.len();
        Some(if lines == 1 {
            format!("Line {} was left out: {}.", first.line, first.why)
        } else {
            format!(
                "{lines} lines were left out, the first is line {}: {}.",
                first.line, first.why
            )
        })
    }

    /// Points of a group that have an error, as (index, time, error).
    pub fn of_group(
        &self,
        group: usize,
        error: usize,
    ) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let points = self.points.iter().enumerate();
        points
            .filter(move |(_, point)| point.group == group)
            .filter_map(move |(i, point)| {
                let error = point.errors.get(error).copied().flatten()?;
                Some((i, point.time_ms, error))
            })
    }

    /// The first error field that tells a group's points apart, else the first that it has.
    pub fn telling_error(&self, group: usize) -> usize {
        let differs = |error: &usize| {
            let mut values = self.of_group(group, *error).map(|(_, _, value)| value);
            let first = values.next();
            values.any(|value| Some(value) != first)
        };
        let has = |error: &usize| self.of_group(group, *error).next().is_some();
        let mut all = 0..self.errors.len();
        all.clone().find(differs).or(all.find(has)).unwrap_or(0)
    }
}

/// Indices of the pairs (a, b) that no other pair beats: none is at most as large in both and smaller in one. In the
/// order of `a`; of equal pairs all are there.
pub fn pareto(pairs: &[(f64, f64)]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..pairs.len()).collect();
    order.sort_by(|i, j| {
        let (a, b) = (pairs[*i], pairs[*j]);
        a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    let mut front: Vec<usize> = Vec::new();
    for i in order {
        let Some(last) = front.last().map(|last| pairs[*last]) else {
            front.push(i);
            continue;
        };
        if pairs[i].1 < last.1 || pairs[i] == last {
            front.push(i);
        }
    }
    front
}

/// Where `name` is in the list, putting it at the end if it is not.
fn index_of(list: &mut Vec<String>, name: &str) -> usize {
    list.iter().position(|n| n == name).unwrap_or_else(|| {
        list.push(name.to_owned());
        list.len() - 1
    })
}

/// A setting in words; what is null goes without saying.
fn words(setting: &Map<String, Value>) -> String {
    let mut all = String::new();
    for (key, value) in setting {
        let key = key.replace('_', " ");
        let words = match value {
            Value::Null => continue,
            Value::Bool(true) => key,
            Value::Bool(false) => format!("no {key}"),
            Value::Number(number) => format!("{key} {number}"),
            Value::String(word) => format!("{key} {word}"),
            Value::Array(_) => format!("{key} {value}"),
            Value::Object(inner) => format!("{key} ({})", words(inner)),
        };
        if !all.is_empty() {
            all.push_str(", ");
        }
        all.push_str(&words);
    }
    all
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const FILE: &str = r#"
{"effect":"terrain","scene":"alps","setting":{"traversal":"boxes","box_texels":16,"max_error_px":0.5},"time_ms":{"median":12.5,"min":12,"max":14,"runs":5},"error":{"coverage_errors_px":3,"flip_mean":0.01},"adapter":"x"}
{"effect":"terrain","scene":"alps","setting":{"traversal":"max-mip","box_texels":null,"max_error_px":0.0},"time_ms":{"median":30},"error":{"coverage_errors_px":0,"depth_error_px_p999":null}}

not json at all
{"effect":"terrain","scene":"alps","setting":{},"error":{"flip_mean":1}}
{"effect":"shadow","scene":"alps","setting":{"exit":{"dithered":{"seconds":0.5}},"rests":true,"weighs":false},"time_ms":{"median":1.25},"error":{"penumbra_rms":0.125}}
{"effect":"shadow","time_ms":{"median":0},"error":{"penumbra_rms":0.125}}
{"effect":"shadow","time_ms":{"median":1},"error":{"penumbra_rms":null}}
"#;

    #[test]
    fn lines_become_points_and_bad_lines_are_named() {
        let results = Results::parse(FILE).unwrap();
        assert_eq!(results.groups, ["terrain · alps", "shadow · alps"]);
        assert_eq!(
            results.errors,
            ["coverage_errors_px", "flip_mean", "penumbra_rms"]
        );
        let [boxes, mips, shadow] = &results.points[..] else {
            panic!("{:?}", results.points);
        };
        assert_eq!((boxes.group, mips.group, shadow.group), (0, 0, 1));
        assert_eq!(
            boxes.setting,
            "box texels 16, max error px 0.5, traversal boxes"
        );
        assert_eq!(mips.setting, "max error px 0.0, traversal max-mip");
        assert_eq!(
            shadow.setting,
            "exit (dithered (seconds 0.5)), rests, no weighs"
        );
        assert_eq!(boxes.time_ms, 12.5);
        assert_eq!(boxes.errors, [Some(3.0), Some(0.01), None]);
        assert_eq!(mips.errors, [Some(0.0), None, None]);
        assert_eq!(shadow.errors, [None, None, Some(0.125)]);
        assert_eq!(results.kinds, ["boxes", "max-mip", "no traversal"]);
        assert_eq!((boxes.kind, mips.kind, shadow.kind), (0, 1, 2));
        let lines: Vec<usize> = results.left_out.iter().map(|bad| bad.line).collect();
        assert_eq!(lines, [5, 6, 8, 9]);
        let complaint = results.complaint().unwrap();
        assert!(complaint.starts_with("4 lines"), "{complaint}");
        assert!(complaint.contains("line 5: it is no JSON"), "{complaint}");
        assert!(results.left_out[1].why.contains("time_ms"));
        assert!(results.left_out[3].why.contains("error"));
    }

    #[test]
    fn the_error_that_is_shown_first_tells_points_apart() {
        let line = |time: u32, a: u32, b: u32| {
            format!(r#"{{"time_ms":{{"median":{time}}},"error":{{"a":{a},"b":{b}}}}}"#)
        };
        let text = [line(1, 0, 1), line(2, 0, 2)].join("\n");
        let results = Results::parse(&text).unwrap();
        assert_eq!(results.errors[results.telling_error(0)], "b");
        assert_eq!(results.complaint(), None);
        assert_eq!(results.kinds, [""]);
        let pairs: Vec<_> = results.of_group(0, 1).collect();
        assert_eq!(pairs, [(0, 1.0, 1.0), (1, 2.0, 2.0)]);
    }

    #[test]
    fn a_file_that_is_none_is_one_sentence_with_the_remedy() {
        let directory = tempfile::tempdir().unwrap();
        let missing = Results::load(&directory.path().join("none.jsonl")).unwrap_err();
        assert!(matches!(missing, ResultsError::Unreadable { .. }));
        let empty_directory = Results::load(directory.path()).unwrap_err();
        assert!(
            empty_directory
                .to_string()
                .contains("results.jsonl cannot be read")
        );
        let picture = directory.path().join("picture.png");
        std::fs::write(&picture, [0x89, b'P', b'N', b'G', 0xff, 0, b'\n', 7]).unwrap();
        let none = Results::load(&picture).unwrap_err();
        assert!(
            matches!(none, ResultsError::NoResult { line: 1, .. }),
            "{none}"
        );
        let empty = directory.path().join("empty.jsonl");
        std::fs::write(&empty, "\n\n").unwrap();
        let nothing = Results::load(&empty).unwrap_err();
        for error in [missing, none, nothing, empty_directory] {
            let text = error.to_string();
            assert!(text.contains("skyline accuracy"), "{text}");
            assert!(!text.contains('\n'), "{text}");
        }
        std::fs::write(directory.path().join("results.jsonl"), FILE).unwrap();
        assert_eq!(Results::load(directory.path()).unwrap().points.len(), 3);
    }

    #[test]
    fn the_front_of_a_few() {
        let pairs = [
            (1.0, 9.0),
            (2.0, 5.0),
            (2.0, 6.0),
            (3.0, 5.0),
            (4.0, 0.0),
            (2.0, 5.0),
        ];
        assert_eq!(pareto(&pairs), [0, 1, 5, 4]);
        assert!(pareto(&[]).is_empty());
    }

    proptest! {
        #[test]
        fn the_front_is_what_nothing_beats(
            pairs in prop::collection::vec((0_u8..12, 0_u8..12), 0..40)
        ) {
            let pairs: Vec<(f64, f64)> =
                pairs.into_iter().map(|(a, b)| (a.into(), b.into())).collect();
            let beaten = |i: &usize| pairs.iter().any(|other| {
                let own = pairs[*i];
                other.0 <= own.0 && other.1 <= own.1 && *other != own
            });
            let expected: Vec<usize> = (0..pairs.len()).filter(|i| !beaten(i)).collect();
            let mut front = pareto(&pairs);
            front.sort_unstable();
            prop_assert_eq!(front, expected);
        }
    }
}
