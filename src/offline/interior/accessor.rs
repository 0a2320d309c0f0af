//! The numbers of a glTF: accessors over views over buffers. All are checked once; reading them then cannot fail.

use serde_json::Value;

use super::{
    error::ModelFileError,
    json::{count, list},
};

/// The largest element: a 4×4 matrix of `f32`.
const LARGEST: usize = 64;
static ZEROS: [u8; LARGEST] = [0; LARGEST];

/// The type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn of(code: usize) -> Option<Self> {
        Some(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    pub(super) fn code(self) -> u32 {
        match self {
            Self::I8 => 5120,
            Self::U8 => 5121,
            Self::I16 => 5122,
            Self::U16 => 5123,
            Self::U32 => 5125,
            Self::F32 => 5126,
        }
    }

    /// units: bytes
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// The first number of some bytes.
    pub(super) fn read(self, bytes: &[u8]) -> f64 {
        let byte = |at: usize| bytes.get(at).copied().unwrap_or(0);
        let two = [byte(0), byte(1)];
        let four = [byte(0), byte(1), byte(2), byte(3)];
        match self {
            Self::I8 => f64::from(two[0] as i8),
            Self::U8 => f64::from(two[0]),
            Self::I16 => f64::from(i16::from_le_bytes(two)),
            Self::U16 => f64::from(u16::from_le_bytes(two)),
            Self::U32 => f64::from(u32::from_le_bytes(four)),
            Self::F32 => f64::from(f32::from_le_bytes(four)),
        }
    }

    /// What the largest number stands for 1 with, where numbers are normalised.
    fn one(self) -> f64 {
        match self {
            Self::I8 => f64::from(i8::MAX),
            Self::U8 => f64::from(u8::MAX),
            Self::I16 => f64::from(i16::MAX),
            Self::U16 => f64::from(u16::MAX),
            Self::U32 => f64::from(u32::MAX),
            Self::F32 => 1.0,
        }
    }
}

/// Bytes of a buffer.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    buffer: usize,
    /// In its buffer. units: bytes
    pub start: usize,
    pub length: usize,
    stride: Option<usize>,
}

/// A list of elements.
#[derive(Clone, Copy, Debug)]
pub(super) struct Accessor {
    /// All elements are 0 if there is none.
    pub view: Option<usize>,
    pub offset: usize,
    pub count: usize,
    pub component: Component,
    /// Numbers in an element.
    pub width: usize,
    pub is_normalized: bool,
    /// Of an element. units: bytes
    pub size: usize,
    /// Between elements where there is nothing in between. units: bytes
    packed: usize,
    /// Between elements. units: bytes
    stride: usize,
    pub sparse: Option<Sparse>,
}

/// Elements that stand in for others.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sparse {
    pub count: usize,
    pub index_view: usize,
    pub index_offset: usize,
    pub index: Component,
    pub value_view: usize,
    pub value_offset: usize,
}

impl Accessor {
    /// From its first byte to its last, in its view, if it has any. units: bytes
    pub(super) fn span(&self) -> Option<core::ops::Range<usize>> {
        self.view?;
        let last = self.count.checked_sub(1)?;
        Some(self.offset..self.offset + last * self.stride + self.size)
    }

    /// Of so many elements with nothing in between. units: bytes
    pub(super) fn packed_length(&self, elements: usize) -> usize {
        match elements.checked_sub(1) {
            Some(last) => last * self.packed + self.size,
            None => 0,
        }
    }
}

/// Everything that accessors can reach.
#[derive(Debug)]
pub(super) struct Numbers<'a> {
    buffers: &'a [Vec<u8>],
    pub views: Vec<View>,
    pub accessors: Vec<Accessor>,
}

impl<'a> Numbers<'a> {
    /// Checks that everything lies within what it lies in.
    pub(super) fn new(json: &Value, buffers: &'a [Vec<u8>]) -> Result<Self, ModelFileError> {
        let mut numbers = Self {
            buffers,
            views: Vec::new(),
            accessors: Vec::new(),
        };
        for (number, view) in list(json, "bufferViews").iter().enumerate() {
            let view = numbers.view(view)?.ok_or_else(|| {
                ModelFileError::Broken(format!("buffer view {number} reaches out of its buffer"))
            })?;
            numbers.views.push(view);
        }
        for (number, accessor) in list(json, "accessors").iter().enumerate() {
            let accessor = numbers.accessor(number, accessor)?;
            numbers.accessors.push(accessor);
        }
        Ok(numbers)
    }

    fn view(&self, view: &Value) -> Result<Option<View>, ModelFileError> {
        let (Some(buffer), Some(length)) = (count(view, "buffer")?, count(view, "byteLength")?)
        else {
            return Ok(None);
        };
        let start = count(view, "byteOffset")?.unwrap_or(0);
        let end = start.checked_add(length);
        let fits = self.buffers.get(buffer).zip(end);
        Ok(fits
            .is_some_and(|(bytes, end)| end <= bytes.len())
            .then_some(View {
                buffer,
                start,
                length,
                stride: count(view, "byteStride")?.filter(|stride| *stride > 0),
            }))
    }

    fn accessor(&self, number: usize, accessor: &Value) -> Result<Accessor, ModelFileError> {
        let broken = |what: &str| ModelFileError::Broken(format!("accessor {number} {what}"));
        let component = count(accessor, "componentType")?
            .and_then(Component::of)
            .ok_or_else(|| broken("is of numbers of no known type"))?;
        let kind = accessor.get("type").and_then(Value::as_str);
        let (rows, columns) = match kind.unwrap_or_default() {
            "SCALAR" => (1, 1),
            "VEC2" => (2, 1),
            "VEC3" => (3, 1),
            "VEC4" => (4, 1),
            "MAT2" => (2, 2),
            "MAT3" => (3, 3),
            "MAT4" => (4, 4),
            _ => return Err(broken("is of elements of no known type")),
        };
        // Each column of a matrix starts at a multiple of 4 bytes.
        let column = rows * component.size();
        let aligned = if columns > 1 {
            column.next_multiple_of(4)
        } else {
            column
        };
        let elements = count(accessor, "count")?.ok_or_else(|| broken("does not say its count"))?;
        let view = count(accessor, "bufferView")?;
        let stride = view.and_then(|view| self.views[view].stride);
        let found =
            Accessor {
                view,
                offset: count(accessor, "byteOffset")?.unwrap_or(0),
                count: elements,
                component,
                width: rows * columns,
                is_normalized: accessor.get("normalized") == Some(&Value::Bool(true)),
                size: aligned * (columns - 1) + column,
                packed: aligned * columns,
                stride: stride.unwrap_or(aligned * columns),
                sparse: match accessor.get("sparse") {
                    Some(sparse) => Some(self.sparse(sparse)?.ok_or_else(|| {
                        broken("has a sparse part that does not say where it lies")
                    })?),
                    None => None,
                },
            };
        let reaches = |view: usize, offset: usize, count: usize, stride: usize, size: usize| {
            let last = count.saturating_sub(1).checked_mul(stride);
            let end = last
                .and_then(|last| last.checked_add(offset)?.checked_add(size))
                .filter(|_| count > 0);
            count == 0 || end.is_some_and(|end| end <= self.views[view].length)
        };
        if let Some(view) = view
            && !reaches(view, found.offset, elements, found.stride, found.size)
        {
            return Err(broken("reaches out of its buffer view"));
        }
        if let Some(sparse) = &found.sparse {
            let (index, value) = (sparse.index.size(), found.size);
            let step = found.packed;
            if !reaches(
                sparse.index_view,
                sparse.index_offset,
                sparse.count,
                index,
                index,
            ) || !reaches(
                sparse.value_view,
                sparse.value_offset,
                sparse.count,
                step,
                value,
            ) {
                return Err(broken(
                    "has a sparse part that reaches out of its buffer view",
                ));
            }
            let indices = self.sparse_indices(sparse);
            if !indices.is_sorted_by(|a, b| a < b) || indices.last() >= Some(&(elements as u64)) {
                return Err(broken(
                    "has sparse indices that do not rise, or pass its end",
                ));
            }
        }
        Ok(found)
    }

    fn sparse(&self, sparse: &Value) -> Result<Option<Sparse>, ModelFileError> {
        let (Some(indices), Some(values)) = (sparse.get("indices"), sparse.get("values")) else {
            return Ok(None);
        };
        let index = count(indices, "componentType")?.and_then(Component::of);
        let index =
            index.filter(|index| matches!(index, Component::U8 | Component::U16 | Component::U32));
        let (Some(count_of), Some(index), Some(index_view), Some(value_view)) = (
            count(sparse, "count")?,
            index,
            count(indices, "bufferView")?,
            count(values, "bufferView")?,
        ) else {
            return Ok(None);
        };
        Ok(Some(Sparse {
            count: count_of,
            index_view,
            index_offset: count(indices, "byteOffset")?.unwrap_or(0),
            index,
            value_view,
            value_offset: count(values, "byteOffset")?.unwrap_or(0),
        }))
    }

    fn sparse_indices(&self, sparse: &Sparse) -> Vec<u64> {
        if sparse.count == 0 {
            return Vec::new();
        }
        let bytes = &self.bytes(sparse.index_view)[sparse.index_offset..];
        let size = sparse.index.size();
        (0..sparse.count)
            .map(|at| sparse.index.read(&bytes[at * size..]) as u64)
            .collect()
    }

    /// All of a view.
    pub(super) fn bytes(&self, view: usize) -> &'a [u8] {
        let view = &self.views[view];
        &self.buffers[view.buffer][view.start..view.start + view.length]
    }

    /// The elements of an accessor, whatever they are made up from.
    pub(super) fn elements(&self, accessor: usize) -> Elements<'a> {
        let accessor = self.accessors[accessor];
        let (indices, values): (_, &[u8]) = match &accessor.sparse {
            Some(sparse) if sparse.count > 0 => (
                self.sparse_indices(sparse),
                &self.bytes(sparse.value_view)[sparse.value_offset..],
            ),
            _ => (Vec::new(), &[]),
        };
        Elements {
            accessor,
            bytes: accessor
                .span()
                .zip(accessor.view)
                .map(|(span, view)| &self.bytes(view)[span]),
            indices,
            values,
        }
    }
}

/// The elements of an accessor.
pub(super) struct Elements<'a> {
    pub accessor: Accessor,
    bytes: Option<&'a [u8]>,
    /// Those that stand in for others, and which they stand in for.
    indices: Vec<u64>,
    values: &'a [u8],
}

impl<'a> Elements<'a> {
    /// The bytes of an element that is there.
    pub(super) fn get(&self, at: usize) -> &'a [u8] {
        let size = self.accessor.size;
        if !self.indices.is_empty()
            && let Ok(found) = self.indices.binary_search(&(at as u64))
        {
            return &self.values[found * self.accessor.packed..][..size];
        }
        match self.bytes {
            Some(bytes) => &bytes[at * self.accessor.stride..][..size],
            None => &ZEROS[..size],
        }
    }

    /// The numbers of an element that is there, of a vector or scalar.
    pub(super) fn numbers<const N: usize>(&self, at: usize) -> [f64; N] {
        let component = self.accessor.component;
        let bytes = self.get(at);
        core::array::from_fn(|i| {
            let number = component.read(bytes.get(i * component.size()..).unwrap_or_default());
            if self.accessor.is_normalized {
                (number / component.one()).max(-1.0)
            } else {
                number
            }
        })
    }
}
