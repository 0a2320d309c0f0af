//! Small glTF binaries: written for tests, and read back with every rule checked that a reader may count on.

use std::{collections::BTreeSet, path::Path};

use bevy::math::{DAffine3, DMat4, DQuat, DVec3};
use serde_json::{Value, json};

/// A model in the making.
#[derive(Clone)]
pub struct Glb {
    pub json: Value,
    pub bin: Vec<u8>,
}

/// The faces of a box seen from outside: corners are numbered by bits, x first.
const QUADS: [[u32; 4]; 6] = [
    [0, 4, 6, 2],
    [1, 3, 7, 5],
    [0, 1, 5, 4],
    [2, 6, 7, 3],
    [0, 2, 3, 1],
    [4, 5, 7, 6],
];

/// Corners and triangles of a box.
pub fn box_of(centre: [f32; 3], half: f32) -> (Vec<[f32; 3]>, Vec<u32>) {
    let corner =
        |c: usize| std::array::from_fn(|i| centre[i] + if c >> i & 1 == 1 { half } else { -half });
    let triangles = QUADS
        .iter()
        .flat_map(|[a, b, c, d]| [*a, *b, *c, *a, *c, *d])
        .collect();
    ((0..8).map(corner).collect(), triangles)
}

/// Several boxes as one list of triangles.
pub fn boxes_of(boxes: &[([f32; 3], f32)]) -> (Vec<[f32; 3]>, Vec<u32>) {
    let (mut positions, mut indices) = (Vec::new(), Vec::new());
    for (centre, half) in boxes {
        let (corners, triangles) = box_of(*centre, *half);
        let first = positions.len() as u32;
        positions.extend(corners);
        indices.extend(triangles.iter().map(|index| index + first));
    }
    (positions, indices)
}

/// A triangle: its material, and of each corner the place in the scene (in 1/100,000) and the bits of its normal.
pub type Drawn = (Option<u64>, [([i64; 3], [u32; 3]); 3]);

impl Glb {
    pub fn new() -> Self {
        let json = json!({
            "asset": { "version": "2.0", "generator": "a test", "extras": { "kept": [1.5, "two"] } },
            "scene": 0,
            "scenes": [{ "name": "all", "nodes": [] }],
            "nodes": [], "meshes": [], "accessors": [], "bufferViews": [],
        });
        Self {
            json,
            bin: Vec::new(),
        }
    }

    /// Adds to a list; gives the number.
    pub fn push(&mut self, key: &str, entry: Value) -> usize {
        if self.json.get(key).is_none() {
            self.json[key] = json!([]);
        }
        let entries = self.json[key].as_array_mut().expect("a list");
        entries.push(entry);
        entries.len() - 1
    }

    pub fn view(&mut self, bytes: &[u8], more: Value) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let mut view = json!({
            "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len(),
        });
        for (key, value) in more.as_object().into_iter().flatten() {
            view[key] = value.clone();
        }
        self.bin.extend_from_slice(bytes);
        self.push("bufferViews", view)
    }

    pub fn floats(&mut self, kind: &str, numbers: &[f32]) -> usize {
        let width = match kind {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        let bytes: Vec<u8> = numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        let view = self.view(&bytes, json!({}));
        let lane = |i: usize| numbers.iter().skip(i).step_by(width).copied();
        let mut accessor = json!({
            "bufferView": view, "componentType": 5126, "type": kind, "count": numbers.len() / width,
        });
        if kind == "VEC3" || kind == "SCALAR" {
            let bound = |f: fn(f32, f32) -> f32| -> Vec<f32> {
                (0..width)
                    .map(|i| lane(i).reduce(f).unwrap_or(0.0))
                    .collect()
            };
            accessor["min"] = json!(bound(f32::min));
            accessor["max"] = json!(bound(f32::max));
        }
        self.push("accessors", accessor)
    }

    pub fn indices(&mut self, indices: &[u32]) -> usize {
        let bytes: Vec<u8> = indices
            .iter()
            .flat_map(|index| (*index as u16).to_le_bytes())
            .collect();
        let view = self.view(&bytes, json!({ "target": 34963 }));
        let accessor = json!({
            "bufferView": view, "componentType": 5123, "type": "SCALAR", "count": indices.len(),
        });
        self.push("accessors", accessor)
    }

    /// A primitive with normals that tell vertices apart.
    pub fn primitive(&mut self, positions: &[[f32; 3]], indices: &[u32]) -> Value {
        let position = self.floats("VEC3", positions.as_flattened());
        let lengths: Vec<[f32; 3]> = positions
            .iter()
            .map(|at| {
                DVec3::from_array(at.map(f64::from))
                    .normalize_or(DVec3::X)
                    .as_vec3()
                    .to_array()
            })
            .collect();
        let normal = self.floats("VEC3", lengths.as_flattened());
        let indices = self.indices(indices);
        json!({ "attributes": { "POSITION": position, "NORMAL": normal }, "indices": indices })
    }

    /// A mesh of boxes in one primitive.
    pub fn boxes(&mut self, name: &str, boxes: &[([f32; 3], f32)]) -> usize {
        let (positions, indices) = boxes_of(boxes);
        let primitive = self.primitive(&positions, &indices);
        self.push("meshes", json!({ "name": name, "primitives": [primitive] }))
    }

    /// A node; at the root of the scene if so said.
    pub fn node(&mut self, node: Value, is_root: bool) -> usize {
        let number = self.push("nodes", node);
        if is_root {
            let roots = &mut self.json["scenes"][0]["nodes"];
            roots.as_array_mut().expect("a list").push(number.into());
        }
        number
    }

    pub fn bytes(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        let mut bin = self.bin.clone();
        if json.get("buffers").is_none() {
            json["buffers"] = json!([{ "byteLength": bin.len() }]);
        }
        bin.resize(bin.len().next_multiple_of(4), 0);
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        glb_of(&text, &bin)
    }

    pub fn save(&self, path: impl AsRef<Path>) {
        std::fs::write(path, self.bytes()).expect("a model can be written");
    }

    /// Reads a `.glb` or a `.gltf` with one `.bin`.
    pub fn read(path: impl AsRef<Path>) -> Self {
        let path = path.as_ref();
        let bytes = std::fs::read(path).expect("the model is there");
        if !bytes.starts_with(b"glTF") {
            let json: Value = serde_json::from_slice(&bytes).expect("JSON");
            let uri = json["buffers"][0]["uri"].as_str().expect("a file");
            let bin = std::fs::read(path.with_file_name(uri.replace("%20", " ")))
                .expect("the buffer is there");
            return Self { json, bin };
        }
        let word =
            |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("4")) as usize;
        assert_eq!((word(4), word(8)), (2, bytes.len()), "version and length");
        let json = 20..20 + word(12);
        assert_eq!(&bytes[16..20], b"JSON");
        let (mut at, mut bin) = (json.end, Vec::new());
        assert_eq!(at % 4, 0);
        if at < bytes.len() {
            assert_eq!(&bytes[at + 4..at + 8], b"BIN\0");
            bin = bytes[at + 8..at + 8 + word(at)].to_vec();
            at += 8 + bin.len();
        }
        assert_eq!((at, bin.len() % 4), (bytes.len(), 0));
        Self {
            json: serde_json::from_slice(&bytes[json]).expect("JSON"),
            bin,
        }
    }

    pub fn list(&self, key: &str) -> &[Value] {
        self.json[key].as_array().map_or(&[], |list| list)
    }

    pub fn names(&self, key: &str) -> Vec<&str> {
        self.list(key)
            .iter()
            .map(|entry| entry["name"].as_str().unwrap_or(""))
            .collect()
    }

    pub fn named(&self, key: &str, name: &str) -> &Value {
        let found = self.list(key).iter().find(|entry| entry["name"] == name);
        found.unwrap_or_else(|| panic!("no {name} among the {key}"))
    }

    /// The elements of an accessor, number by number; without sparse ones.
    pub fn elements(&self, accessor: usize) -> Vec<Vec<f64>> {
        let accessor = &self.json["accessors"][accessor];
        assert!(accessor.get("sparse").is_none());
        let number = |value: &Value| value.as_u64().unwrap_or(0) as usize;
        let view = &self.json["bufferViews"][number(&accessor["bufferView"])];
        let (size, width) = element(accessor);
        let stride = match number(&view["byteStride"]) {
            0 => size * width,
            stride => stride,
        };
        let start = number(&view["byteOffset"]) + number(&accessor["byteOffset"]);
        let one = match (&accessor["normalized"], number(&accessor["componentType"])) {
            (Value::Bool(true), 5120) => 127.0,
            (Value::Bool(true), 5122) => 32_767.0,
            _ => 1.0,
        };
        (0..number(&accessor["count"]))
            .map(|at| {
                let component = |i: usize| {
                    let b = &self.bin[start + at * stride + i * size..];
                    (match number(&accessor["componentType"]) {
                        5120 => f64::from(b[0] as i8),
                        5121 => f64::from(b[0]),
                        5122 => f64::from(i16::from_le_bytes([b[0], b[1]])),
                        5123 => f64::from(u16::from_le_bytes([b[0], b[1]])),
                        5125 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
                        _ => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
                    }) / one
                };
                (0..width).map(component).collect()
            })
            .collect()
    }

    /// The indices of a primitive's triangles.
    fn triangle_indices(&self, primitive: &Value) -> Vec<[usize; 3]> {
        let number = |value: &Value| value.as_u64().map(|number| number as usize);
        let indices: Vec<usize> = match number(&primitive["indices"]) {
            Some(accessor) => self
                .elements(accessor)
                .iter()
                .map(|e| e[0] as usize)
                .collect(),
            None => {
                let position = number(&primitive["attributes"]["POSITION"]).expect("positions");
                (0..self.elements(position).len()).collect()
            }
        };
        let last = indices.len().max(2) - 2;
        let of = |three: [usize; 3]| three.map(|at| indices[at]);
        let mut triangles: Vec<_> = match primitive["mode"].as_u64().unwrap_or(4) {
            4 => (0..indices.len() / 3)
                .map(|i| of([3 * i, 3 * i + 1, 3 * i + 2]))
                .collect(),
            5 => (0..last)
                .map(|i| of([i, i + 1 + i % 2, i + 2 - i % 2]))
                .collect(),
            6 => (0..last).map(|i| of([i + 1, i + 2, 0])).collect(),
            _ => Vec::new(),
        };
        triangles.retain(|[a, b, c]| a != b && b != c && c != a);
        triangles
    }

    /// What the default scene draws, in order.
    pub fn drawn(&self) -> Vec<Drawn> {
        let mut drawn = Vec::new();
        let roots = self.json["scenes"][0]["nodes"].as_array();
        let number = |value: &Value| value.as_u64().expect("a number") as usize;
        let mut open: Vec<(usize, DAffine3)> = roots
            .into_iter()
            .flatten()
            .map(|root| (number(root), DAffine3::IDENTITY))
            .collect();
        while let Some((node, above)) = open.pop() {
            let node = &self.json["nodes"][node];
            let world = above * transform(node);
            for child in node["children"].as_array().into_iter().flatten() {
                open.push((number(child), world));
            }
            if node.get("mesh").is_none() {
                continue;
            }
            let mesh = &self.json["meshes"][number(&node["mesh"])];
            for primitive in mesh["primitives"].as_array().expect("a list") {
                let positions = self.elements(number(&primitive["attributes"]["POSITION"]));
                let normals = primitive["attributes"].get("NORMAL");
                let normals = normals.map(|normals| self.elements(number(normals)));
                for triangle in self.triangle_indices(primitive) {
                    let corner = |index: usize| {
                        let at = &positions[index];
                        let at = world.transform_point3(DVec3::new(at[0], at[1], at[2]));
                        let place = at.to_array().map(|x| (x * 1e5).round() as i64);
                        let normal = normals.as_ref().map_or([0; 3], |normals| {
                            std::array::from_fn(|i| (normals[index][i] as f32).to_bits())
                        });
                        (place, normal)
                    };
                    let mut corners = triangle.map(corner);
                    let first = (0..3).min_by_key(|i| corners[*i]).unwrap_or(0);
                    corners.rotate_left(first);
                    drawn.push((primitive["material"].as_u64(), corners));
                }
            }
        }
        drawn.sort();
        drawn
    }

    /// Checks all that glTF 2.0 asks of what is read here, and that nothing is there in vain.
    pub fn check(&self) {
        let without_uri = {
            let mut model = self.clone();
            if let Some(buffer) = model.json["buffers"][0].as_object_mut() {
                buffer.remove("uri");
            }
            model
        };
        // It refuses files that require what it does not know, and animations of anything but nodes.
        let is_known = !self.json.to_string().contains("KHR_animation_pointer");
        if self.list("extensionsRequired").is_empty() && is_known {
            gltf::Gltf::from_slice(&without_uri.bytes()).expect("the gltf crate finds it valid");
        }
        assert_eq!(self.list("buffers").len(), 1);
        let length = self.json["buffers"][0]["byteLength"]
            .as_u64()
            .expect("a length") as usize;
        assert!(length <= self.bin.len() && self.bin.len() < length + 4);
        let number = |value: &Value| value.as_u64().unwrap_or(0) as usize;
        for view in self.list("bufferViews") {
            assert!(number(&view["byteLength"]) > 0, "{view}");
            assert!(
                number(&view["byteOffset"]) + number(&view["byteLength"]) <= length,
                "{view}"
            );
            let stride = number(&view["byteStride"]);
            assert!(
                stride == 0 || (stride % 4 == 0 && (4..=252).contains(&stride)),
                "{view}"
            );
        }
        for accessor in self.list("accessors") {
            let (size, width) = element(accessor);
            let count = number(&accessor["count"]);
            assert!(count > 0, "{accessor}");
            let Some(view) = accessor.get("bufferView") else {
                continue;
            };
            let view = &self.list("bufferViews")[number(view)];
            let stride = number(&view["byteStride"]).max(size * width);
            let offset = number(&accessor["byteOffset"]);
            assert!(
                offset + stride * (count - 1) + size * width <= number(&view["byteLength"]),
                "{accessor} in {view}"
            );
            assert_eq!(
                (offset + number(&view["byteOffset"])) % size,
                0,
                "{accessor}"
            );
            assert_eq!(offset % size, 0, "{accessor}");
        }
        for primitive in self
            .list("meshes")
            .iter()
            .flat_map(|mesh| mesh["primitives"].as_array().expect("a list"))
        {
            let attributes = primitive["attributes"].as_object().expect("attributes");
            let vertices =
                number(&self.list("accessors")[number(&attributes["POSITION"])]["count"]);
            for attribute in attributes.values() {
                let accessor = &self.list("accessors")[number(attribute)];
                assert_eq!(number(&accessor["count"]), vertices, "{primitive}");
                assert_eq!(number(&accessor["byteOffset"]) % 4, 0, "{accessor}");
            }
            self.check_bounds(number(&attributes["POSITION"]));
            if let Some(indices) = primitive.get("indices") {
                let accessor = &self.list("accessors")[number(indices)];
                let restart = [255, 65_535, 4_294_967_295][[5121, 5123, 5125]
                    .iter()
                    .position(|c| accessor["componentType"] == *c)
                    .expect("unsigned")];
                for index in self.elements(number(indices)) {
                    let index = index[0] as usize;
                    assert!(
                        index < vertices && index != restart,
                        "{index} of {vertices}"
                    );
                }
            }
        }
    }

    fn check_bounds(&self, accessor: usize) {
        let value = &self.list("accessors")[accessor];
        if value.get("sparse").is_some() || value.get("bufferView").is_none() {
            return;
        }
        let mut raw = self.clone();
        raw.json["accessors"][accessor]["normalized"] = false.into();
        let elements = raw.elements(accessor);
        for (key, pick) in [("min", f64::min as fn(f64, f64) -> f64), ("max", f64::max)] {
            for i in 0..3 {
                let bound = elements.iter().map(|e| e[i]).reduce(pick);
                assert_eq!(value[key][i].as_f64(), bound, "{key} of {value}");
            }
        }
    }

    /// Checks that everything is used.
    pub fn check_tidy(&self) {
        let text = self.json.to_string();
        let number = |value: &Value| value.as_u64().map(|number| number as usize);
        let mut meshes = BTreeSet::new();
        for node in self.list("nodes") {
            meshes.extend(number(&node["mesh"]));
        }
        assert_eq!(meshes.len(), self.list("meshes").len(), "{text}");
        let mut accessors = BTreeSet::new();
        for primitive in self
            .list("meshes")
            .iter()
            .flat_map(|m| m["primitives"].as_array().expect("a list"))
        {
            accessors.extend(number(&primitive["indices"]));
            let attributes = primitive["attributes"].as_object().expect("attributes");
            accessors.extend(attributes.values().filter_map(number));
            for target in primitive["targets"].as_array().into_iter().flatten() {
                accessors.extend(
                    target
                        .as_object()
                        .expect("attributes")
                        .values()
                        .filter_map(number),
                );
            }
        }
        for skin in self.list("skins") {
            accessors.extend(number(&skin["inverseBindMatrices"]));
        }
        for sampler in self
            .list("animations")
            .iter()
            .flat_map(|a| a["samplers"].as_array().expect("a list"))
        {
            accessors.extend(
                number(&sampler["input"])
                    .into_iter()
                    .chain(number(&sampler["output"])),
            );
        }
        assert_eq!(accessors.len(), self.list("accessors").len(), "{text}");
        let mut views = BTreeSet::new();
        for accessor in self.list("accessors") {
            views.extend(number(&accessor["bufferView"]));
            views.extend(number(&accessor["sparse"]["indices"]["bufferView"]));
            views.extend(number(&accessor["sparse"]["values"]["bufferView"]));
        }
        for image in self.list("images") {
            views.extend(number(&image["bufferView"]));
        }
        assert_eq!(views.len(), self.list("bufferViews").len(), "{text}");
    }
}

/// A `.glb` of two chunks, as they are.
pub fn glb_of(json: &[u8], bin: &[u8]) -> Vec<u8> {
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    let length = 12 + 8 + json.len() + if bin.is_empty() { 0 } else { 8 + bin.len() };
    bytes.extend((length as u32).to_le_bytes());
    for (kind, body) in [(b"JSON", json), (b"BIN\0", bin)] {
        if kind == b"JSON" || !body.is_empty() {
            bytes.extend((body.len() as u32).to_le_bytes());
            bytes.extend(kind);
            bytes.extend(body);
        }
    }
    bytes
}

/// Size of a number, and how many in an element.
fn element(accessor: &Value) -> (usize, usize) {
    let size = match accessor["componentType"].as_u64() {
        Some(5120 | 5121) => 1,
        Some(5122 | 5123) => 2,
        _ => 4,
    };
    let width = match accessor["type"].as_str() {
        Some("SCALAR") => 1,
        Some("VEC2") => 2,
        Some("VEC3") => 3,
        Some("VEC4") => 4,
        _ => 16,
    };
    (size, width)
}

fn transform(node: &Value) -> DAffine3 {
    let numbers = |key: &str| -> Option<Vec<f64>> {
        node.get(key)?
            .as_array()?
            .iter()
            .map(Value::as_f64)
            .collect()
    };
    if let Some(matrix) = numbers("matrix") {
        let matrix: [f64; 16] = matrix.try_into().expect("16 numbers");
        return DAffine3::from_mat4(DMat4::from_cols_array(&matrix));
    }
    let vector =
        |key: &str, default: DVec3| numbers(key).map_or(default, |v| DVec3::from_slice(&v));
    let rotation = numbers("rotation").map_or(DQuat::IDENTITY, |q| DQuat::from_slice(&q));
    DAffine3::from_scale_rotation_translation(
        vector("scale", DVec3::ONE),
        rotation,
        vector("translation", DVec3::ZERO),
    )
}
