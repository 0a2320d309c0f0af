//! What nothing uses any more goes: nodes, meshes, accessors, views, in this order, and their bytes.
//!
//! Extensions that are not known here may refer to anything by number. Where there are any, everything keeps its
//! number: what goes leaves the smallest valid thing in its place, and what any number in them may mean stays.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use super::{
    accessor::Numbers,
    error::ModelFileError,
    extensions::Unknown,
    fresh::{Fresh, FreshView},
    json::{List, index, list, list_mut},
    pack::pack,
};

/// Takes out what nothing uses; gives the bytes of the one buffer that is left, at most `most`.
///
/// `hidden`: nodes that have just lost their meshes. `None`: there are more bytes.
pub(super) fn sweep(
    json: &mut Value,
    numbers: &Numbers,
    hidden: &BTreeSet<usize>,
    fresh: &mut Fresh,
    most: u64,
) -> Result<Option<Vec<u8>>, ModelFileError> {
    let unknown = Unknown::of(json);
    if unknown.names.is_empty() {
        let is_kept = kept_nodes(json, hidden);
        drop_from(
            json,
            &[("scenes", "nodes"), ("nodes", "children")],
            &is_kept,
        );
        shorten(json, List::Nodes, &is_kept);
    }
    let is_kept = used(json, List::Meshes, &unknown);
    let origin = if unknown.names.is_empty() {
        shorten(json, List::Meshes, &is_kept);
        None
    } else {
        let origin = origin(fresh);
        let point = push(json, List::Accessors, origin.clone());
        let mesh = json!({ "primitives": [{ "mode": 0, "attributes": { "POSITION": point } }] });
        replace(json, List::Meshes, &is_kept, &mesh);
        Some(origin)
    };
    let is_kept = used(json, List::Accessors, &unknown);
    let Some(packed) = pack(json, numbers, &is_kept, &unknown, fresh, most)? else {
        return Ok(None);
    };
    if let Some(origin) = origin {
        replace(json, List::Accessors, &is_kept, &origin);
        let view = json!({ "buffer": 0, "byteLength": 1 });
        replace(json, List::Views, &packed.is_used, &view);
    } else {
        shorten(json, List::Accessors, &is_kept);
        shorten(json, List::Views, &packed.is_used);
    }
    for key in ["nodes", "meshes", "accessors", "bufferViews", "buffers"] {
        if list(json, key).is_empty()
            && let Some(json) = json.as_object_mut()
        {
            json.remove(key);
        }
    }
    Ok(Some(packed.bytes))
}

/// A point at the origin.
fn origin(fresh: &mut Fresh) -> Value {
    let view = fresh.add(FreshView {
        bytes: vec![0; 3 * size_of::<f32>()],
        ..Default::default()
    });
    json!({
        "bufferView": view, "componentType": 5126, "type": "VEC3", "count": 1,
        "min": [0, 0, 0], "max": [0, 0, 0],
    })
}

/// A node that has lost its mesh goes, and then what is above it and was there for it only; not one that something
/// else needs. What had no mesh from the start is there for some reason.
fn kept_nodes(json: &Value, hidden: &BTreeSet<usize>) -> Vec<bool> {
    let nodes = list(json, "nodes");
    let mut is_needed: Vec<bool> = nodes
        .iter()
        .map(|node| {
            let has = |key: &str| node.get(key).is_some();
            has("mesh") || has("camera") || has("skin") || has("extensions")
        })
        .collect();
    let skins = list(json, "skins").iter();
    let joints = skins.flat_map(|skin| list(skin, "joints").iter().chain(skin.get("skeleton")));
    let channels = list(json, "animations")
        .iter()
        .flat_map(|animation| list(animation, "channels"));
    let targets = channels.filter_map(|channel| channel.get("target")?.get("node"));
    for node in joints.chain(targets).filter_map(index) {
        is_needed[node] = true;
    }
    let mut above = vec![Vec::new(); nodes.len()];
    let mut children = vec![0; nodes.len()];
    for (number, node) in nodes.iter().enumerate() {
        for child in list(node, "children").iter().filter_map(index) {
            above[child].push(number);
            children[number] += 1;
        }
    }
    let mut is_kept = vec![true; nodes.len()];
    let mut open: Vec<usize> = hidden.iter().copied().collect();
    while let Some(node) = open.pop() {
        if is_kept[node] && !is_needed[node] && children[node] == 0 {
            is_kept[node] = false;
            for above in &above[node] {
                children[*above] -= 1;
                open.push(*above);
            }
        }
    }
    is_kept
}

/// Drops what goes from lists of references; a list may not be empty, but may be absent.
fn drop_from(json: &mut Value, lists: &[(&str, &str)], is_kept: &[bool]) {
    for (outer, inner) in lists {
        for value in list_mut(json, outer) {
            let Some(references) = value.get_mut(*inner).and_then(Value::as_array_mut) else {
                continue;
            };
            references.retain(|reference| index(reference).is_some_and(|at| is_kept[at]));
            if references.is_empty()
                && let Some(value) = value.as_object_mut()
            {
                value.remove(*inner);
            }
        }
    }
}

/// Of each entry of a list, whether anything refers to it, or may.
fn used(json: &mut Value, of: List, unknown: &Unknown) -> Vec<bool> {
    let mut is_used = vec![false; list(json, of.key()).len()];
    of.visit(json, |reference| {
        if let Some(is_used) = index(reference).and_then(|at| is_used.get_mut(at)) {
            *is_used = true;
        }
    });
    for number in &unknown.numbers {
        if let Some(is_used) = is_used.get_mut(*number) {
            *is_used = true;
        }
    }
    is_used
}

/// Takes entries out of a list, and has references follow those that stay.
fn shorten(json: &mut Value, of: List, is_kept: &[bool]) {
    let mut kept = is_kept.iter();
    if let Some(entries) = json.get_mut(of.key()).and_then(Value::as_array_mut) {
        entries.retain(|_| kept.next() == Some(&true));
    }
    let mut next = 0usize;
    let new_of: Vec<usize> = is_kept
        .iter()
        .map(|is_kept| {
            next += usize::from(*is_kept);
            next.saturating_sub(1)
        })
        .collect();
    of.visit(json, |reference| {
        if let Some(new) = index(reference).and_then(|at| new_of.get(at)) {
            *reference = (*new).into();
        }
    });
}

/// Has something else stand where an entry of a list was.
fn replace(json: &mut Value, of: List, is_kept: &[bool], with: &Value) {
    for (entry, is_kept) in list_mut(json, of.key()).iter_mut().zip(is_kept) {
        if !is_kept {
            *entry = with.clone();
        }
    }
}

fn push(json: &mut Value, to: List, entry: Value) -> usize {
    match json.get_mut(to.key()).and_then(Value::as_array_mut) {
        Some(entries) => {
            entries.push(entry);
            entries.len() - 1
        }
        None => 0,
    }
}
