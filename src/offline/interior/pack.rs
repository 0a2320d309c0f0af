//! All bytes that are still used, in one buffer.
//!
//! Of a view of the file, the stretches stay that accessors in use span, so that interleaved vertices stay so and
//! what lies between goes. Images' views, and those that may belong to unknown extensions, stay whole.

use core::ops::Range;

use serde_json::{Value, json};

use super::{
    accessor::Numbers,
    error::ModelFileError,
    extensions::Unknown,
    fresh::Fresh,
    json::{count, index, list, list_mut},
};

/// Every number type's size divides it.
const ALIGNMENT: usize = 4;
/// What some extensions ask for, of views that are theirs.
const VIEW_ALIGNMENT: usize = 8;

/// The one buffer.
pub(super) struct Packed {
    pub bytes: Vec<u8>,
    /// Of each view, fresh ones too: whether anything of it is in use.
    pub is_used: Vec<bool>,
}

/// Packs what the accessors that are kept use, and has them and the views follow; gives nothing where more than
/// `most` bytes are used: a small file can have any number of views of the same bytes.
pub(super) fn pack(
    json: &mut Value,
    numbers: &Numbers,
    is_kept: &[bool],
    unknown: &Unknown,
    fresh: &Fresh,
    most: u64,
) -> Result<Option<Packed>, ModelFileError> {
    let stretches = stretches(json, numbers, is_kept, unknown);
    let sizes = stretches.iter().map(Stretches::length);
    let fresh_sizes = fresh.views.iter().map(|view| view.bytes.len());
    let size: u64 = sizes
        .chain(fresh_sizes)
        .map(|size| (size + VIEW_ALIGNMENT) as u64)
        .sum();
    if size > most {
        return Ok(None);
    }
    follow(json, is_kept, &stretches)?;
    let mut packed = Packed {
        bytes: Vec::new(),
        is_used: Vec::new(),
    };
    for (number, stretches) in stretches.iter().enumerate() {
        packed.is_used.push(!stretches.0.is_empty());
        if stretches.0.is_empty() {
            continue;
        }
        // Numbers stay aligned as they were.
        let residue = numbers.views[number].start % VIEW_ALIGNMENT;
        while packed.bytes.len() % VIEW_ALIGNMENT != residue {
            packed.bytes.push(0);
        }
        let offset = packed.bytes.len();
        for stretch in &stretches.0 {
            packed.bytes.resize(offset + stretch.now, 0);
            let was = &numbers.bytes(number)[stretch.was.clone()];
            packed.bytes.extend_from_slice(was);
        }
        if let Some(view) = list_mut(json, "bufferViews")[number].as_object_mut() {
            view.insert("buffer".into(), 0.into());
            view.insert("byteOffset".into(), offset.into());
            view.insert("byteLength".into(), stretches.length().into());
        }
    }
    let mut views = Vec::new();
    for view in &fresh.views {
        packed.is_used.push(true);
        let aligned = packed.bytes.len().next_multiple_of(VIEW_ALIGNMENT);
        packed.bytes.resize(aligned, 0);
        let mut entry = json!({
            "buffer": 0, "byteOffset": aligned, "byteLength": view.bytes.len(),
        });
        for (key, value) in [
            ("byteStride", view.stride.map(Value::from)),
            ("target", view.target.map(Value::from)),
        ] {
            if let Some(value) = value {
                entry[key] = value;
            }
        }
        views.push(entry);
        packed.bytes.extend_from_slice(&view.bytes);
    }
    packed
        .bytes
        .resize(packed.bytes.len().next_multiple_of(ALIGNMENT), 0);
    if let Some(json) = json.as_object_mut() {
        let all = json
            .entry("bufferViews")
            .or_insert_with(|| Value::Array(Vec::new()));
        if let Some(all) = all.as_array_mut() {
            all.extend(views);
        }
        let mut buffer = json
            .get("buffers")
            .and_then(|buffers| buffers.get(0)?.as_object().cloned())
            .unwrap_or_default();
        buffer.remove("uri");
        buffer.insert("byteLength".into(), packed.bytes.len().into());
        let buffers = if packed.bytes.is_empty() {
            Vec::new()
        } else {
            vec![Value::Object(buffer)]
        };
        json.insert("buffers".into(), buffers.into());
    }
    Ok(Some(packed))
}

/// What of a view is in use: from multiples of [`ALIGNMENT`], in order, apart from each other.
struct Stretches(Vec<Stretch>);

/// Bytes of a view.
struct Stretch {
    was: Range<usize>,
    /// Where in the new view they start.
    now: usize,
}

impl Stretches {
    fn new(mut spans: Vec<Range<usize>>) -> Self {
        spans.sort_unstable_by_key(|span| span.start);
        let mut all: Vec<Stretch> = Vec::new();
        for span in spans {
            let start = span.start / ALIGNMENT * ALIGNMENT;
            match all.last_mut() {
                Some(last) if start <= last.was.end.next_multiple_of(ALIGNMENT) => {
                    last.was.end = last.was.end.max(span.end);
                }
                last => {
                    let now = last.map_or(0, |last| last.end().next_multiple_of(ALIGNMENT));
                    all.push(Stretch {
                        was: start..span.end,
                        now,
                    });
                }
            }
        }
        Self(all)
    }

    /// With padding in between. units: bytes
    fn length(&self) -> usize {
        self.0.last().map_or(0, Stretch::end)
    }

    /// Where a byte of the view that is in use has gone.
    fn moved(&self, byte: usize) -> Option<usize> {
        let after = self.0.partition_point(|stretch| stretch.was.start <= byte);
        let stretch = &self.0[after.checked_sub(1)?];
        let is_in = stretch.was.contains(&byte);
        is_in.then(|| stretch.now + byte - stretch.was.start)
    }
}

impl Stretch {
    fn end(&self) -> usize {
        self.now + self.was.len()
    }
}

/// Of each view of the file.
fn stretches(
    json: &Value,
    numbers: &Numbers,
    is_kept: &[bool],
    unknown: &Unknown,
) -> Vec<Stretches> {
    let mut spans: Vec<Vec<Range<usize>>> = vec![Vec::new(); numbers.views.len()];
    for (accessor, _) in numbers
        .accessors
        .iter()
        .zip(is_kept)
        .filter(|(_, is_kept)| **is_kept)
    {
        if let (Some(view), Some(span)) = (accessor.view, accessor.span()) {
            spans[view].push(span);
        }
        if let Some(sparse) = accessor.sparse.filter(|sparse| sparse.count > 0) {
            let index = sparse.index_offset;
            let end = index + sparse.count * sparse.index.size();
            spans[sparse.index_view].push(index..end);
            let value = sparse.value_offset;
            spans[sparse.value_view].push(value..value + accessor.packed_length(sparse.count));
        }
    }
    let images = list(json, "images")
        .iter()
        .filter_map(|image| image.get("bufferView").and_then(index));
    for view in images.chain(unknown.numbers.iter().copied()) {
        if let Some(spans) = spans.get_mut(view) {
            spans.push(0..numbers.views[view].length);
        }
    }
    spans.into_iter().map(Stretches::new).collect()
}

/// Has the accessors of the file that are kept follow their bytes.
fn follow(
    json: &mut Value,
    is_kept: &[bool],
    stretches: &[Stretches],
) -> Result<(), ModelFileError> {
    let accessors = list_mut(json, "accessors").iter_mut().zip(is_kept);
    for (accessor, _) in accessors.filter(|(_, is_kept)| **is_kept) {
        move_offset(accessor, stretches)?;
        let sparse = accessor.get("sparse");
        if sparse.is_some_and(|sparse| sparse.get("count").and_then(index) == Some(0))
            && let Some(accessor) = accessor.as_object_mut()
        {
            // Of no elements, and so of no bytes that it could say the place of.
            accessor.remove("sparse");
        }
        for part in ["indices", "values"] {
            if let Some(part) = accessor
                .get_mut("sparse")
                .and_then(|sparse| sparse.get_mut(part))
            {
                move_offset(part, stretches)?;
            }
        }
    }
    Ok(())
}

fn move_offset(of: &mut Value, stretches: &[Stretches]) -> Result<(), ModelFileError> {
    let offset = count(of, "byteOffset")?.unwrap_or(0);
    // Fresh views don't move.
    let view = count(of, "bufferView")?.and_then(|view| stretches.get(view));
    if let (Some(stretches), Some(of)) = (view, of.as_object_mut()) {
        match stretches.moved(offset) {
            Some(0) => {
                of.remove("byteOffset");
            }
            Some(offset) => {
                of.insert("byteOffset".into(), offset.into());
            }
            // It has no elements, and so no bytes.
            None => {
                of.remove("bufferView");
                of.remove("byteOffset");
            }
        }
    }
    Ok(())
}
