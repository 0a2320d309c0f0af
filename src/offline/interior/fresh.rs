//! Numbers that are written anew: vertices and indices of what was trimmed, in a few views that they share.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use super::{
    accessor::{Component, Numbers},
    error::{Budget, ModelFileError},
};

const ARRAY_BUFFER: u32 = 34_962;
const ELEMENT_ARRAY_BUFFER: u32 = 34_963;

/// Bytes that come after the views of the file, as views of their own.
#[derive(Debug, Default)]
pub(super) struct FreshView {
    pub bytes: Vec<u8>,
    /// Between elements. units: bytes
    pub stride: Option<usize>,
    pub target: Option<u32>,
}

/// What was written anew.
#[derive(Debug)]
pub(super) struct Fresh {
    /// Views of the file that was read.
    first: usize,
    pub views: Vec<FreshView>,
    vertices: BTreeMap<usize, usize>,
    indices: BTreeMap<usize, usize>,
}

impl Fresh {
    pub(super) fn after(views: usize) -> Self {
        Self {
            first: views,
            views: Vec::new(),
            vertices: BTreeMap::new(),
            indices: BTreeMap::new(),
        }
    }

    /// Of all views. units: bytes
    pub(super) fn bytes(&self) -> u64 {
        self.views.iter().map(|view| view.bytes.len() as u64).sum()
    }

    /// Adds a view; gives its number.
    pub(super) fn add(&mut self, view: FreshView) -> usize {
        self.views.push(view);
        self.first + self.views.len() - 1
    }

    /// An accessor of some elements of another, in their order.
    pub(super) fn vertices(
        &mut self,
        numbers: &Numbers,
        (accessor, old): (usize, &Value),
        kept: &[u32],
        is_position: bool,
        budget: &mut Budget,
    ) -> Result<Value, ModelFileError> {
        let elements = numbers.elements(accessor);
        let accessor = &elements.accessor;
        // Vertex attributes start at multiples of 4 bytes.
        let stride = accessor.size.next_multiple_of(4);
        budget.take(kept.len(), stride)?;
        let Self { views, first, .. } = self;
        let pool = *self.vertices.entry(stride).or_insert_with(|| {
            views.push(FreshView {
                stride: Some(stride),
                target: Some(ARRAY_BUFFER),
                ..Default::default()
            });
            views.len() - 1
        });
        let bytes = &mut views[pool].bytes;
        let offset = bytes.len();
        for vertex in kept {
            bytes.extend_from_slice(elements.get(*vertex as usize));
            bytes.resize(bytes.len().next_multiple_of(4), 0);
        }
        let mut fresh = describe(Some(old), *first + pool, offset, kept.len());
        if is_position {
            let (component, width) = (accessor.component, accessor.width);
            let elements = &elements;
            let lane = |i: usize| {
                let from = i * component.size();
                let element =
                    move |vertex: &u32| component.read(&elements.get(*vertex as usize)[from..]);
                kept.iter().map(element)
            };
            let least = (0..width).map(|i| number(component, lane(i).fold(f64::MAX, f64::min)));
            let greatest = (0..width).map(|i| number(component, lane(i).fold(f64::MIN, f64::max)));
            fresh.insert("min".into(), least.collect());
            fresh.insert("max".into(), greatest.collect());
        }
        Ok(Value::Object(fresh))
    }

    /// An accessor of indices, of the narrowest type that fits; its largest number is none that a restart would have.
    pub(super) fn indices(
        &mut self,
        old: Option<&Value>,
        indices: &[u32],
        budget: &mut Budget,
    ) -> Result<Value, ModelFileError> {
        let component = match indices.iter().max() {
            Some(0xffff..) => Component::U32,
            Some(0xff..) => Component::U16,
            _ => Component::U8,
        };
        let size = component.size();
        budget.take(indices.len(), size)?;
        let Self { views, first, .. } = self;
        let pool = *self.indices.entry(size).or_insert_with(|| {
            views.push(FreshView {
                target: Some(ELEMENT_ARRAY_BUFFER),
                ..Default::default()
            });
            views.len() - 1
        });
        let bytes = &mut views[pool].bytes;
        let offset = bytes.len();
        for index in indices {
            bytes.extend_from_slice(&index.to_le_bytes()[..size]);
        }
        let mut fresh = describe(old, *first + pool, offset, indices.len());
        fresh.insert("componentType".into(), component.code().into());
        fresh.insert("type".into(), "SCALAR".into());
        Ok(Value::Object(fresh))
    }
}

/// An accessor like an old one, over other bytes.
fn describe(old: Option<&Value>, view: usize, offset: usize, count: usize) -> Map<String, Value> {
    let mut fresh = old.and_then(Value::as_object).cloned().unwrap_or_default();
    for key in ["sparse", "min", "max"] {
        fresh.remove(key);
    }
    fresh.insert("bufferView".into(), view.into());
    fresh.insert("byteOffset".into(), offset.into());
    fresh.insert("count".into(), count.into());
    fresh
}

/// A bound: whole where the numbers are.
fn number(component: Component, number: f64) -> Value {
    match component {
        Component::F32 => json!(number),
        _ => json!(number as i64),
    }
}
