//! Result lines of any effect, read back.

use std::path::Path;

use serde::Deserialize;
use serde_json::{Map, Value};

use super::super::{
    ReportError, Timing,
    report::{failed, short},
};

/// A line of `results.jsonl`, as far as all effects' lines are alike.
#[derive(Clone, Debug, Deserialize)]
pub struct Line {
    /// What was looked at.
    pub scene: String,
    /// What was set, by field.
    #[serde(default)]
    pub setting: Map<String, Value>,
    /// What it took. units: ms
    pub time_ms: Timing,
    /// The whole line.
    #[serde(skip)]
    pub all: Value,
}

/// Lines that may be compared: of one scene, in the same circumstances.
#[derive(Clone, Debug)]
pub struct Group<'a> {
    /// Scene and circumstances, in words.
    pub name: String,
    /// In the file's order.
    pub lines: Vec<&'a Line>,
}

/// All lines of a file; none if it isn't there.
///
/// # Errors
/// [`ReportError`] if it is not a file of results.
pub fn read(path: &Path) -> Result<Vec<Line>, ReportError> {
    let text = match std::fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(failed(path, &error)),
    };
    text.lines()
        .map(|text| {
            let all: Value = serde_json::from_str(text)?;
            let line = Line::deserialize(&all)?;
            Ok(Line { all, ..line })
        })
        .collect::<Result<_, serde_json::Error>>()
        .map_err(|error| failed(path, &error))
}

/// A value as a cell of a table.
pub fn words(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        Value::Number(number) => number.as_f64().map_or_else(|| number.to_string(), short),
        Value::Array(values) => values.iter().map(words).collect::<Vec<_>>().join("×"),
        other => other.to_string(),
    }
}

impl Line {
    /// The number at a place in the line, if there is one.
    pub fn number(&self, pointer: &str) -> Option<f64> {
        self.all.pointer(pointer)?.as_f64()
    }

    /// Whether every field given is set so.
    pub fn is_set(&self, to: &Value) -> bool {
        to.as_object().is_some_and(|to| {
            to.iter()
                .all(|(field, value)| self.setting.get(field).is_some_and(|own| same(own, value)))
        })
    }

    /// What was set, without circumstances, which are places in the line.
    pub fn knobs(&self, circumstances: &[&str]) -> Map<String, Value> {
        let is_knob = |field: &str| {
            !circumstances
                .iter()
                .any(|place| place.strip_prefix("/setting/") == Some(field))
        };
        self.setting
            .iter()
            .filter(|(field, _)| is_knob(field))
            .map(|(field, value)| (field.clone(), value.clone()))
            .collect()
    }

    /// What was set, in words, without what is given.
    pub fn name(&self, without: &[&str]) -> String {
        let fields = self
            .setting
            .iter()
            .filter(|(field, value)| !without.contains(&field.as_str()) && !value.is_null());
        let words = fields.map(|(field, value)| match value {
            Value::String(text) => text.clone(),
            Value::Bool(true) => field.clone(),
            Value::Bool(false) => format!("no {field}"),
            value => format!("{field} {}", words(value)),
        });
        words.collect::<Vec<_>>().join(", ")
    }
}

/// Whether two values are the same, `0` and `0.0` too.
pub fn same(a: &Value, b: &Value) -> bool {
    match (a.as_f64(), b.as_f64()) {
        (Some(a), Some(b)) => a == b,
        _ => a == b,
    }
}

/// Lines by scene and circumstances, which are places in a line.
pub fn groups<'a>(lines: &'a [Line], circumstances: &[&str]) -> Vec<Group<'a>> {
    let mut groups: Vec<Group> = Vec::new();
    for line in lines {
        let mut name = line.scene.clone();
        for place in circumstances {
            let field = place.rsplit('/').next().unwrap_or(place);
            match line.all.pointer(place) {
                None | Some(Value::Null) => {}
                Some(Value::Bool(true)) => name += &format!(", {field}"),
                Some(Value::Bool(false)) => name += &format!(", no {field}"),
                Some(value) => name += &format!(", {field} {}", words(value)),
            }
        }
        match groups.iter_mut().find(|group| group.name == name) {
            Some(group) => group.lines.push(line),
            None => groups.push(Group {
                name,
                lines: vec![line],
            }),
        }
    }
    groups
}

/// Every leaf of lines as a table: one column a place, in the order of their first appearance.
pub fn flat<'a>(lines: impl Iterator<Item = &'a Value>) -> (Vec<String>, Vec<Vec<String>>) {
    let mut heads: Vec<String> = Vec::new();
    let mut rows = Vec::new();
    for line in lines {
        let mut cells = Vec::new();
        leaves(line, "", &mut cells);
        let mut row = vec![String::new(); heads.len()];
        for (place, value) in cells {
            let at = heads.iter().position(|head| *head == place);
            let at = at.unwrap_or_else(|| {
                heads.push(place);
                row.push(String::new());
                heads.len() - 1
            });
            row[at] = value;
        }
        rows.push(row);
    }
    for row in &mut rows {
        row.resize(heads.len(), String::new());
    }
    (heads, rows)
}

fn leaves(value: &Value, place: &str, cells: &mut Vec<(String, String)>) {
    let below = |key: &dyn std::fmt::Display| match place {
        "" => key.to_string(),
        place => format!("{place}.{key}"),
    };
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                leaves(value, &below(key), cells);
            }
        }
        Value::Array(values) => {
            for (at, value) in values.iter().enumerate() {
                leaves(value, &below(&at), cells);
            }
        }
        Value::Null => {}
        Value::String(text) => cells.push((place.to_owned(), text.clone())),
        other => cells.push((place.to_owned(), other.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn line(value: Value) -> Line {
        let line = Line::deserialize(&value).expect("a line");
        Line { all: value, ..line }
    }

    fn timed(scene: &str, setting: Value) -> Line {
        line(json!({
            "effect": "x", "scene": scene, "setting": setting,
            "time_ms": { "median": 1.0, "min": 1.0, "max": 1.0, "runs": 1 },
        }))
    }

    #[test]
    fn lines_are_grouped_by_scene_and_circumstances_and_named_by_the_rest() {
        let lines = [
            timed(
                "a",
                json!({ "way": "slow", "size": 4, "sun": 10.0, "off": null }),
            ),
            timed("a", json!({ "way": "fast", "size": 4.0, "sun": 20.0 })),
            timed("a", json!({ "way": "fast", "size": 4.0, "sun": 10.0 })),
        ];
        let groups = groups(&lines, &["/setting/sun"]);
        let names: Vec<_> = groups.iter().map(|group| &*group.name).collect();
        assert_eq!(names, ["a, sun 10", "a, sun 20"]);
        assert_eq!(groups[0].lines.len(), 2);
        assert_eq!(groups[0].lines[0].name(&["sun"]), "size 4, slow");
        assert!(lines[0].is_set(&json!({ "size": 4.0 })));
        assert!(!lines[0].is_set(&json!({ "size": 4.0, "way": "fast" })));
        assert!(!lines[0].is_set(&json!({ "nowhere": 1 })));
    }

    #[test]
    fn flat_lines_have_a_column_for_every_leaf_of_any() {
        let (heads, rows) = flat([json!({ "a": { "b": 1 } }), json!({ "c": [2, 3] })].iter());
        assert_eq!(heads, ["a.b", "c.0", "c.1"]);
        assert_eq!(rows, [["1", "", ""], ["", "2", "3"]]);
    }
}
