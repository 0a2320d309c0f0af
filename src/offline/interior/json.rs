//! Reading glTF's JSON, and the table of all references in it.
//!
//! The JSON stays a [`Value`] from the file that is read to the file that is written, so that what is not known here
//! survives.

use serde_json::{Map, Value};

use super::error::ModelFileError;
use crate::one_line::one_line;

/// Lists of a glTF that others refer into by number, and that are shortened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum List {
    Nodes,
    Meshes,
    Accessors,
    Views,
}

impl List {
    pub(super) fn key(self) -> &'static str {
        match self {
            Self::Nodes => "nodes",
            Self::Meshes => "meshes",
            Self::Accessors => "accessors",
            Self::Views => "bufferViews",
        }
    }

    /// Where the references into it are; `*` stands for every entry of a list or object.
    fn references(self) -> &'static [&'static [&'static str]] {
        match self {
            Self::Nodes => &[
                &["scenes", "*", "nodes", "*"],
                &["nodes", "*", "children", "*"],
                &["skins", "*", "joints", "*"],
                &["skins", "*", "skeleton"],
                &["animations", "*", "channels", "*", "target", "node"],
            ],
            Self::Meshes => &[&["nodes", "*", "mesh"]],
            Self::Accessors => &[
                &["meshes", "*", "primitives", "*", "attributes", "*"],
                &["meshes", "*", "primitives", "*", "indices"],
                &["meshes", "*", "primitives", "*", "targets", "*", "*"],
                &["skins", "*", "inverseBindMatrices"],
                &["animations", "*", "samplers", "*", "input"],
                &["animations", "*", "samplers", "*", "output"],
                &[
                    "nodes",
                    "*",
                    "extensions",
                    "EXT_mesh_gpu_instancing",
                    "attributes",
                    "*",
                ],
            ],
            Self::Views => &[
                &["accessors", "*", "bufferView"],
                &["accessors", "*", "sparse", "indices", "bufferView"],
                &["accessors", "*", "sparse", "values", "bufferView"],
                &["images", "*", "bufferView"],
            ],
        }
    }

    /// Calls for each reference into it.
    pub(super) fn visit(self, json: &mut Value, mut found: impl FnMut(&mut Value)) {
        for path in self.references() {
            walk(json, path, &mut found);
        }
    }
}

fn walk(value: &mut Value, path: &[&str], found: &mut impl FnMut(&mut Value)) {
    let Some((step, rest)) = path.split_first() else {
        found(value);
        return;
    };
    match value {
        Value::Array(entries) if *step == "*" => {
            for entry in entries {
                walk(entry, rest, found);
            }
        }
        Value::Object(entries) if *step == "*" => {
            for entry in entries.values_mut() {
                walk(entry, rest, found);
            }
        }
        Value::Object(entries) => {
            if let Some(entry) = entries.get_mut(*step) {
                walk(entry, rest, found);
            }
        }
        _ => {}
    }
}

/// Checks that everything refers to something, and that lists are lists of objects; what follows counts on that.
pub(super) fn check(json: &mut Value) -> Result<(), ModelFileError> {
    for key in [
        "scenes",
        "nodes",
        "meshes",
        "accessors",
        "bufferViews",
        "buffers",
        "images",
        "materials",
        "skins",
        "animations",
    ] {
        let is_list = |list: &Value| {
            list.as_array()
                .is_some_and(|list| list.iter().all(Value::is_object))
        };
        if json.get(key).is_some_and(|list| !is_list(list)) {
            let what = format!("its \"{key}\" are not a list of objects");
            return Err(ModelFileError::Broken(what));
        }
    }
    for mesh in list(json, "meshes") {
        for primitive in list(mesh, "primitives") {
            if !primitive.is_object() || !primitive.get("attributes").is_some_and(Value::is_object)
            {
                let what = "a mesh has a primitive without attributes";
                return Err(ModelFileError::broken(what));
            }
        }
    }
    for kind in [List::Nodes, List::Meshes, List::Accessors, List::Views] {
        let length = list(json, kind.key()).len();
        let mut wrong = None;
        kind.visit(json, |reference| match index(reference) {
            Some(number) if number < length => *reference = number.into(),
            _ => wrong = Some(reference.to_string()),
        });
        if let Some(wrong) = wrong {
            let key = kind.key();
            let what = format!("it refers to {wrong:.40} among its {length} {key}");
            return Err(ModelFileError::Broken(what));
        }
    }
    Ok(())
}

/// A list in an object; empty if there is none.
pub(super) fn list<'a>(value: &'a Value, key: &str) -> &'a [Value] {
    value
        .get(key)
        .and_then(Value::as_array)
        .map_or(&[], |list| list)
}

/// A list in an object, to change; empty if there is none.
pub(super) fn list_mut<'a>(value: &'a mut Value, key: &str) -> &'a mut [Value] {
    value
        .get_mut(key)
        .and_then(Value::as_array_mut)
        .map_or(&mut [], |list| list)
}

/// A whole number that can count or index; some exporters write `5.0`.
pub(super) fn index(value: &Value) -> Option<usize> {
    let whole = |number: f64| {
        (number >= 0.0 && number < 2f64.powi(53) && number.fract() == 0.0).then_some(number as u64)
    };
    let number = value.as_u64().or_else(|| value.as_f64().and_then(whole))?;
    usize::try_from(number).ok()
}

/// A whole number in an object; `None` if there is none.
///
/// # Errors
/// There is something else.
pub(super) fn count(value: &Value, key: &str) -> Result<Option<usize>, ModelFileError> {
    match value.get(key) {
        None => Ok(None),
        Some(found) => match index(found) {
            Some(number) => Ok(Some(number)),
            None => Err(ModelFileError::Broken(format!(
                "a \"{key}\" is {:.40}, not a whole number",
                found.to_string()
            ))),
        },
    }
}

/// An extension of an object.
pub(super) fn extension<'a>(value: &'a Value, name: &str) -> Option<&'a Value> {
    value.get("extensions")?.get(name)
}

/// The names of an object's extensions.
pub(super) fn extension_names(value: &Value) -> impl Iterator<Item = &str> {
    value
        .get("extensions")
        .and_then(Value::as_object)
        .into_iter()
        .flat_map(Map::keys)
        .map(String::as_str)
}

/// A number and, if it has one, its name; in one line.
pub(super) fn named(number: usize, value: &Value) -> String {
    match value.get("name").and_then(Value::as_str) {
        Some(name) => format!("{number} ({})", one_line(name)),
        None => number.to_string(),
    }
}
