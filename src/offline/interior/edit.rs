//! What is hidden is taken out of nodes and meshes.
//!
//! Primitives with the same attributes share their vertices, often with other materials or in other meshes. So they
//! are trimmed together: the vertices that any of them still uses are written once.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    sync::Arc,
};

use serde_json::{Map, Value};

use super::{
    accessor::Numbers,
    error::{Budget, ModelFileError},
    extensions::VARIANTS,
    fresh::Fresh,
    json::{extension_names, index, list, list_mut},
    read::Reading,
};
use crate::interior::{Surface, Verdict};

/// What of a primitive stays.
#[derive(Clone, Debug, PartialEq)]
enum Stay {
    Nothing,
    Some(Box<[bool]>),
    All,
}

impl Stay {
    /// It stays as well where another sees it.
    fn widen(&mut self, verdict: &Verdict) {
        match (&mut *self, verdict) {
            (Self::All, _) | (_, Verdict::Hidden) => {}
            (_, Verdict::Seen) => *self = Self::All,
            (Self::Nothing, Verdict::Partly(seen)) => *self = Self::Some(seen.clone()),
            (Self::Some(all), Verdict::Partly(seen)) => {
                for (all, seen) in all.iter_mut().zip(seen) {
                    *all |= *seen;
                }
                if !all.contains(&false) {
                    *self = Self::All;
                }
            }
        }
    }

    fn triangles<'a>(&'a self, surface: &'a Surface) -> impl Iterator<Item = [u32; 3]> {
        let is_kept = move |number: usize| match self {
            Self::Nothing => false,
            Self::Some(seen) => seen.get(number).copied().unwrap_or(false),
            Self::All => true,
        };
        let all = surface.triangles.iter().enumerate();
        all.filter(move |(number, _)| is_kept(*number))
            .map(|(_, triangle)| *triangle)
    }
}

/// What was taken out.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Edited {
    /// Nodes that have lost their meshes.
    pub hidden: BTreeSet<usize>,
    /// Nodes that were judged.
    pub nodes: usize,
    /// Triangles that those of them that stay still draw.
    pub kept_triangles: usize,
}

/// Takes out what is hidden. Meshes that nothing uses any more stay for the sweep.
pub(super) fn edit(
    json: &mut Value,
    numbers: &Numbers,
    reading: &Reading,
    verdicts: &[Verdict],
    fresh: &mut Fresh,
    budget: &mut Budget,
) -> Result<Edited, ModelFileError> {
    let (edited, stays) = judge(json, reading, verdicts);
    for group in groups(json, reading, &stays) {
        group.rewrite(json, numbers, fresh, budget)?;
    }
    for ((mesh, primitive), stay) in stays.iter().rev() {
        let primitives = list_mut(json, "meshes")[*mesh].get_mut("primitives");
        if let (Stay::Nothing, Some(Value::Array(primitives))) = (stay, primitives) {
            primitives.remove(*primitive);
        }
    }
    for node in &edited.hidden {
        if let Some(node) = list_mut(json, "nodes")[*node].as_object_mut() {
            node.remove("mesh");
        }
    }
    Ok(edited)
}

/// Which nodes are hidden, and what stays of each primitive of each mesh that another still uses.
fn judge(
    json: &Value,
    reading: &Reading,
    verdicts: &[Verdict],
) -> (Edited, BTreeMap<(usize, usize), Stay>) {
    let mut parts: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (number, part) in reading.model.parts.iter().enumerate() {
        parts.entry(part.node as usize).or_default().push(number);
    }
    let mut edited = Edited {
        nodes: parts.len(),
        ..Default::default()
    };
    let mut stays = BTreeMap::new();
    for (number, node) in list(json, "nodes").iter().enumerate() {
        let Some(mesh) = node.get("mesh").and_then(index) else {
            continue;
        };
        let primitives = list(&list(json, "meshes")[mesh], "primitives");
        let judged = parts
            .get(&number)
            .filter(|_| !reading.is_shown_elsewhere[number]);
        // Points and lines are not judged; they stay.
        let has_others = reading
            .meshes
            .get(&mesh)
            .is_none_or(|primitives| primitives.iter().any(Option::is_none));
        let is_seen =
            |parts: &Vec<usize>| parts.iter().any(|part| verdicts[*part] != Verdict::Hidden);
        if judged.is_some_and(|parts| !has_others && !is_seen(parts)) {
            edited.hidden.insert(number);
            continue;
        }
        for primitive in 0..primitives.len() {
            stays.entry((mesh, primitive)).or_insert(Stay::Nothing);
        }
        match judged {
            Some(parts) => {
                for part in parts {
                    let stay = stays.entry(reading.sites[*part]);
                    stay.or_insert(Stay::Nothing).widen(&verdicts[*part]);
                }
            }
            None => (0..primitives.len()).for_each(|primitive| {
                stays.insert((mesh, primitive), Stay::All);
            }),
        }
    }
    for ((mesh, primitive), stay) in &mut stays {
        let value = &list(&list(json, "meshes")[*mesh], "primitives")[*primitive];
        let is_read = surface(reading, *mesh, *primitive).is_some();
        if !is_read || (is_fixed(value) && *stay != Stay::Nothing) {
            *stay = Stay::All;
        }
    }
    let kept = parts
        .iter()
        .filter(|(node, _)| !edited.hidden.contains(*node));
    edited.kept_triangles = kept
        .flat_map(|(_, parts)| parts)
        .filter_map(|part| {
            let stay = stays.get(&reading.sites[*part])?;
            Some(stay.triangles(&reading.model.parts[*part].surface).count())
        })
        .sum();
    (edited, stays)
}

fn surface(reading: &Reading, mesh: usize, primitive: usize) -> Option<&Arc<Surface>> {
    reading.meshes.get(&mesh)?.get(primitive)?.as_ref()
}

/// Whether something may refer to its vertices or triangles by number.
fn is_fixed(primitive: &Value) -> bool {
    let is_morphed = !list(primitive, "targets").is_empty();
    is_morphed || extension_names(primitive).any(|name| name != VARIANTS)
}

/// Primitives with the same attributes.
#[derive(Default)]
struct Group {
    members: Vec<Member>,
    /// Whether anything was taken out of them.
    is_changed: bool,
    /// Whether all vertices have to stay.
    is_fixed: bool,
}

/// A primitive of which something stays.
struct Member {
    site: (usize, usize),
    surface: Option<Arc<Surface>>,
    stay: Stay,
}

/// Those groups that have to be written anew.
fn groups(json: &Value, reading: &Reading, stays: &BTreeMap<(usize, usize), Stay>) -> Vec<Group> {
    let mut groups: BTreeMap<String, Group> = BTreeMap::new();
    for (mesh, value) in list(json, "meshes").iter().enumerate() {
        for (primitive, value) in list(value, "primitives").iter().enumerate() {
            let group = groups.entry(value["attributes"].to_string()).or_default();
            let stay = stays.get(&(mesh, primitive)).unwrap_or(&Stay::Nothing);
            group.is_changed |= *stay != Stay::All;
            if *stay == Stay::Nothing {
                continue;
            }
            let surface = surface(reading, mesh, primitive);
            group.is_fixed |= is_fixed(value) || surface.is_none();
            group.members.push(Member {
                site: (mesh, primitive),
                surface: surface.cloned(),
                stay: stay.clone(),
            });
        }
    }
    groups
        .into_values()
        .filter(|group| group.is_changed && !group.members.is_empty())
        .collect()
}

impl Group {
    fn rewrite(
        &self,
        json: &mut Value,
        numbers: &Numbers,
        fresh: &mut Fresh,
        budget: &mut Budget,
    ) -> Result<(), ModelFileError> {
        let kept = self.kept_vertices();
        let attributes = match &kept {
            Some(kept) => Some(self.write_attributes(json, numbers, kept, fresh, budget)?),
            None => None,
        };
        let mut new_of = Vec::new();
        for (new, old) in kept.iter().flatten().enumerate() {
            let old = *old as usize;
            new_of.resize(new_of.len().max(old + 1), 0);
            new_of[old] = new as u32;
        }
        let renumber = |index: u32| match kept {
            Some(_) => new_of[index as usize],
            None => index,
        };
        let mut written: HashMap<Vec<u32>, usize> = HashMap::new();
        for Member {
            site,
            surface,
            stay,
        } in &self.members
        {
            let Some(surface) = surface else { continue };
            if kept.is_none() && *stay == Stay::All {
                continue;
            }
            let primitive = primitive(json, *site);
            let old = primitive.get("indices").and_then(index);
            let indices: Vec<u32> = stay.triangles(surface).flatten().map(renumber).collect();
            let in_order = indices.iter().zip(0..).all(|(index, at)| *index == at);
            let all = kept.as_ref().map_or(surface.positions.len(), Vec::len);
            let accessor = if old.is_none() && in_order && indices.len() == all {
                None
            } else if let Some(accessor) = written.get(&indices) {
                Some(*accessor)
            } else {
                let old = old.and_then(|old| list(json, "accessors").get(old));
                let accessor = push(json, fresh.indices(old, &indices, budget)?);
                written.insert(indices, accessor);
                Some(accessor)
            };
            let Some(primitive) = primitive_mut(json, *site) else {
                continue;
            };
            if let Some(accessor) = accessor {
                primitive.insert("indices".into(), accessor.into());
            }
            if let Some(attributes) = &attributes {
                primitive.insert("attributes".into(), attributes.clone());
            }
            // Strips and fans have come apart.
            primitive.remove("mode");
        }
        Ok(())
    }

    /// The vertices that stay; `None`: all.
    fn kept_vertices(&self) -> Option<Vec<u32>> {
        if self.is_fixed {
            return None;
        }
        let mut is_used = Vec::new();
        for member in &self.members {
            let surface = member.surface.as_ref()?;
            is_used.resize(surface.positions.len(), false);
            for index in member.stay.triangles(surface).flatten() {
                is_used[index as usize] = true;
            }
        }
        let used = (0..).zip(&is_used).filter(|(_, is_used)| **is_used);
        is_used
            .contains(&false)
            .then(|| used.map(|(vertex, _)| vertex).collect())
    }

    fn write_attributes(
        &self,
        json: &mut Value,
        numbers: &Numbers,
        kept: &[u32],
        fresh: &mut Fresh,
        budget: &mut Budget,
    ) -> Result<Value, ModelFileError> {
        let mut attributes = primitive(json, self.members[0].site)["attributes"].clone();
        let mut written: BTreeMap<(usize, bool), usize> = BTreeMap::new();
        for (semantic, accessor) in attributes.as_object_mut().into_iter().flatten() {
            let Some(old) = index(accessor) else { continue };
            let is_position = semantic == "POSITION";
            let new = match written.get(&(old, is_position)) {
                Some(new) => *new,
                None => {
                    let value = &list(json, "accessors")[old];
                    let fresh = fresh.vertices(numbers, (old, value), kept, is_position, budget)?;
                    push(json, fresh)
                }
            };
            written.insert((old, is_position), new);
            *accessor = new.into();
        }
        Ok(attributes)
    }
}

/// A primitive that is known to be there.
fn primitive(json: &Value, (mesh, primitive): (usize, usize)) -> &Value {
    &json["meshes"][mesh]["primitives"][primitive]
}

fn primitive_mut(
    json: &mut Value,
    (mesh, primitive): (usize, usize),
) -> Option<&mut Map<String, Value>> {
    json["meshes"][mesh]["primitives"][primitive].as_object_mut()
}

/// Adds an accessor; gives its number.
fn push(json: &mut Value, accessor: Value) -> usize {
    match json.get_mut("accessors").and_then(Value::as_array_mut) {
        Some(accessors) => {
            accessors.push(accessor);
            accessors.len() - 1
        }
        None => 0,
    }
}
