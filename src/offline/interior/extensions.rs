//! What is known about glTF's extensions: which change nothing here, and what to do about the others.

use std::collections::BTreeSet;

use serde_json::Value;

use super::{
    error::ModelFileError,
    json::{extension_names, list},
};
use crate::one_line::one_line;

/// Vertices cannot be read at all.
const COMPRESSIONS: [&str; 3] = [
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
];

/// They refer to nothing but textures, images, materials and lights, which stay where they are, and move nothing.
const SELF_CONTAINED: [&str; 18] = [
    "ADOBE_materials_clearcoat_specular",
    "ADOBE_materials_clearcoat_tint",
    "ADOBE_materials_thin_transparency",
    "EXT_lights_ies",
    "EXT_lights_image_based",
    "EXT_texture_avif",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_node_visibility",
    "KHR_techniques_webgl",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MSFT_texture_dds",
];

/// What they refer to is known.
pub(super) const INSTANCING: &str = "EXT_mesh_gpu_instancing";
pub(super) const VISIBILITY: &str = "KHR_node_visibility";
pub(super) const VARIANTS: &str = "KHR_materials_variants";
pub(super) const TRANSMISSION: &str = "KHR_materials_transmission";
pub(super) const POINTER: &str = "KHR_animation_pointer";

/// Whether it says nothing about what is where, or refers to it.
pub(super) fn is_self_contained(name: &str) -> bool {
    SELF_CONTAINED.contains(&name) || name.starts_with("KHR_materials_")
}

/// Checks that the vertices can be read, and nothing is required that might change what is seen.
pub(super) fn check(json: &Value) -> Result<(), ModelFileError> {
    let listed = |key| list(json, key).iter().filter_map(Value::as_str);
    let mut inside = BTreeSet::new();
    gather(json, &mut |name, _| {
        inside.insert(name.to_owned());
    });
    let compression = listed("extensionsUsed")
        .chain(listed("extensionsRequired"))
        .chain(inside.iter().map(String::as_str))
        .find(|name| COMPRESSIONS.contains(name));
    if let Some(name) = compression {
        return Err(ModelFileError::Compressed(name.to_owned()));
    }
    let is_known = |name: &str| is_self_contained(name) || [INSTANCING, POINTER].contains(&name);
    match listed("extensionsRequired").find(|name| !is_known(name)) {
        Some(name) => Err(ModelFileError::Extension(one_line(name))),
        None => Ok(()),
    }
}

/// What extensions that are not known may refer to by number.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Unknown {
    /// Their names.
    pub names: BTreeSet<String>,
    /// Every number in them.
    pub numbers: BTreeSet<usize>,
}

impl Unknown {
    /// Gathers the numbers in all extensions that are not known to be without references.
    pub(super) fn of(json: &Value) -> Self {
        let mut unknown = Self::default();
        gather(json, &mut |name, value| {
            if name != INSTANCING && !is_self_contained(name) {
                unknown.names.insert(name.to_owned());
                unknown.gather_numbers(value);
            }
        });
        unknown
    }

    fn gather_numbers(&mut self, value: &Value) {
        match value {
            Value::Array(values) => values.iter().for_each(|value| self.gather_numbers(value)),
            Value::Object(values) => values.values().for_each(|value| self.gather_numbers(value)),
            Value::Number(number) => {
                let number = number
                    .as_u64()
                    .and_then(|number| usize::try_from(number).ok());
                self.numbers.extend(number);
            }
            // JSON pointers: /nodes/3/translation
            Value::String(text) if text.starts_with('/') => {
                let numbers = text
                    .split('/')
                    .filter_map(|step| step.parse::<usize>().ok());
                self.numbers.extend(numbers);
            }
            _ => {}
        }
    }
}

/// Calls for each extension of each object.
fn gather(value: &Value, found: &mut impl FnMut(&str, &Value)) {
    match value {
        Value::Array(values) => values.iter().for_each(|value| gather(value, found)),
        Value::Object(values) => {
            for name in extension_names(value) {
                found(name, &value["extensions"][name]);
            }
            for (key, value) in values {
                // Extras are an application's own.
                if key != "extras" {
                    gather(value, found);
                }
            }
        }
        _ => {}
    }
}
