//! Model files damaged at random, and sound ones with hostile numbers in them: what is read is whole, what is trimmed
//! can be read again, and all else is an error of one line.

use std::{
    num::NonZero,
    path::{Path, PathBuf},
};

use bevy_skyline::{
    interior::{
        InteriorCulling, InteriorFaces, InteriorGrid, InteriorLevel, InteriorMode,
        InteriorTransparent, Model,
    },
    offline::{
        interior::{read_model, trim},
        scenes::{city, obj},
    },
};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{
    cli_interior_errors::rich_model,
    fuzz::{Lot, Verdict, holds, refused, run},
    glb::{Glb, glb_of},
};

/// What models may take here. units: MiB
const MEMORY_MIB: u32 = 4;
/// One allocation of them, doubled as it grows, and what JSON takes.
const MOST_BYTES: usize = 10 << 20;

/// In memory where the system has such a place: a case writes a file or two.
fn directory() -> TempDir {
    tempfile::tempdir_in("/dev/shm")
        .or_else(|_| tempfile::tempdir())
        .expect("a directory can be made")
}

fn write(path: &Path, bytes: &[u8]) {
    std::fs::write(path, bytes).expect("a file can be written");
}

/// What holds of every model that was read.
fn check(model: &Model) -> Result<(), String> {
    for part in &model.parts {
        let vertices = part.surface.positions.len();
        let mut corners = part.surface.triangles.iter().flatten();
        holds(corners.all(|corner| (*corner as usize) < vertices), || {
            format!(
                "a corner of node {} is none of its {vertices} vertices",
                part.node
            )
        })?;
        let mut corners = part.corners().flatten();
        holds(corners.all(|corner| part.place(corner).is_finite()), || {
            format!("a corner of node {} is nowhere", part.node)
        })?;
    }
    Ok(())
}

fn read(path: &Path) -> Verdict {
    match read_model(path, MEMORY_MIB) {
        Ok(model) => check(&model).map(|()| true),
        Err(error) => refused(&error),
    }
}

/// A number where a count or a reference is.
fn number(lot: &mut Lot, sound: usize) -> Value {
    if !lot.one_in(50) {
        return json!(lot.below(sound));
    }
    let number = lot.f64();
    match lot.below(6) {
        0 => json!(lot.u32()),
        1 => json!(u64::MAX - lot.below(9) as u64),
        2 => json!(-1),
        3 => json!(number),
        4 => json!(f64::from(lot.u32())),
        _ => json!(null),
    }
}

/// Sets a member, or leaves it out.
fn set(lot: &mut Lot, object: &mut Value, key: &str, value: Value) {
    if !lot.one_in(60) {
        object[key] = value;
    }
}

fn view(lot: &mut Lot, bin: usize) -> Value {
    let start = 4 * lot.below(bin / 8);
    let mut view = json!({});
    let of = if lot.one_in(60) {
        number(lot, 3)
    } else {
        json!(0)
    };
    set(lot, &mut view, "buffer", of);
    let start = if lot.one_in(30) {
        number(lot, bin)
    } else {
        json!(start)
    };
    set(lot, &mut view, "byteOffset", start);
    let length = if lot.one_in(12) {
        number(lot, 2 * bin)
    } else {
        json!(bin / 2)
    };
    set(lot, &mut view, "byteLength", length);
    if lot.one_in(6) {
        view["byteStride"] = number(lot, 40);
    }
    view
}

fn accessor(lot: &mut Lot, views: usize, kind: &str, component: u32, count: usize) -> Value {
    let kind = if lot.one_in(30) {
        lot.pick(&[
            "SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4", "VEC9", "a\nb",
        ])
    } else {
        kind
    };
    let component = if lot.one_in(30) {
        5119 + lot.below(9) as u32
    } else {
        component
    };
    let count = if lot.one_in(20) {
        number(lot, 90)
    } else {
        json!(count)
    };
    let mut accessor = json!({});
    set(lot, &mut accessor, "type", json!(kind));
    set(lot, &mut accessor, "componentType", json!(component));
    set(lot, &mut accessor, "count", count);
    let of = number(lot, views);
    set(lot, &mut accessor, "bufferView", of);
    if kind == "VEC3" {
        accessor["min"] = json!([-9.0, -9.0, -9.0]);
        accessor["max"] = json!([9.0, 9.0, 9.0]);
    }
    if lot.one_in(8) {
        accessor["byteOffset"] = number(lot, 60);
    }
    if lot.one_in(10) {
        accessor["normalized"] = json!(true);
    }
    if lot.one_in(24) {
        let component = lot.pick(&[5121, 5123, 5125, 5126]);
        accessor["sparse"] = json!({
            "count": number(lot, 3),
            "indices": { "bufferView": number(lot, views), "componentType": component },
            "values": { "bufferView": number(lot, views), "byteOffset": number(lot, 50) },
        });
    }
    accessor
}

fn node(lot: &mut Lot, nodes: usize, meshes: usize) -> Value {
    let mut node = json!({ "name": lot.pick(&["tower", "", "a\nb", "\u{7}"]) });
    if !lot.one_in(4) {
        node["mesh"] = number(lot, meshes);
    }
    // Often one that has a parent already, or the node itself.
    if lot.one_in(16) {
        node["children"] = json!([number(lot, nodes)]);
    }
    let numbers = |lot: &mut Lot, count| -> Value {
        lot.many(count, |lot| json!(lot.mostly(3.0, 12))).into()
    };
    match lot.below(9) {
        0 => node["matrix"] = numbers(lot, 16),
        1 => node["translation"] = numbers(lot, 3),
        2 => node["rotation"] = numbers(lot, 4),
        3 => node["scale"] = numbers(lot, 3),
        4 if lot.one_in(9) => node["scale"] = numbers(lot, 2),
        _ => {}
    }
    node
}

/// A container that is sound, with a model in it of which any number may be anything.
fn generated(lot: &mut Lot) -> Vec<u8> {
    let hostile = if lot.one_in(2) { 2_000 } else { 40 };
    let bin: Vec<u8> = (0..120)
        .flat_map(|at| match at {
            // Floats in one half, small numbers for indices in the other.
            0..60 => (lot.mostly(9.0, hostile) as f32).to_le_bytes(),
            _ => [(); 4].map(|()| {
                if lot.one_in(40) {
                    lot.draw() as u8
                } else {
                    lot.below(3) as u8
                }
            }),
        })
        .collect();
    let (views, meshes, nodes) = (4, 2, 4);
    let mut model = Glb {
        json: json!({ "asset": { "version": "2.0" } }),
        bin,
    };
    let size = model.bin.len();
    model.push("buffers", json!({ "byteLength": size }));
    if lot.one_in(60) {
        model.json["buffers"][0]["byteLength"] = number(lot, 9);
    }
    model.push(
        "bufferViews",
        json!({ "buffer": 0, "byteLength": size / 2 }),
    );
    let bytes = json!({ "buffer": 0, "byteOffset": size / 2, "byteLength": size / 2 });
    model.push("bufferViews", bytes);
    for _ in 2..views {
        model.push("bufferViews", view(lot, size));
    }
    for at in 0..6 {
        let (kind, component) = [("VEC3", 5126), ("SCALAR", 5121), ("VEC3", 5122)][at % 3];
        let count = lot.pick(&[3, 6, 9, 12]);
        let mut accessor = accessor(lot, views, kind, component, count);
        // They lie where such numbers are.
        if !lot.one_in(12) {
            accessor["bufferView"] = json!(at % 3 % 2);
        }
        model.push("accessors", accessor);
    }
    for _ in 0..meshes {
        let primitives = lot.many(2, |lot| {
            let mut attributes = json!({ "POSITION": 0 });
            if lot.one_in(2) {
                attributes["POSITION"] = json!(lot.pick(&[2, 3, 5]));
            }
            if lot.one_in(12) {
                attributes["POSITION"] = number(lot, 6);
            }
            if lot.one_in(20) {
                attributes["NORMAL"] = number(lot, 6);
            }
            let mut primitive = json!({ "attributes": attributes });
            match lot.below(20) {
                0 => primitive["indices"] = number(lot, 6),
                1..10 => primitive["indices"] = json!(lot.pick(&[1, 4])),
                _ => {}
            }
            if lot.one_in(3) {
                primitive["mode"] = number(lot, 7);
            }
            if lot.one_in(5) {
                primitive["material"] = number(lot, 2);
            }
            if lot.one_in(9) {
                primitive["extensions"]["KHR_materials_variants"] =
                    json!({ "mappings": [{ "material": number(lot, 2), "variants": [0] }] });
            }
            primitive
        });
        model.push(
            "meshes",
            json!({ "name": "a\tb", "primitives": primitives }),
        );
    }
    for _ in 0..nodes {
        let node = node(lot, nodes, meshes);
        model.push("nodes", node);
    }
    let roots: Vec<Value> = if lot.one_in(12) {
        lot.many(3, |lot| number(lot, nodes))
    } else {
        (0..nodes).map(|node| json!(node)).collect()
    };
    model.push("scenes", json!({ "nodes": roots }));
    if lot.one_in(4) {
        model.json["scene"] = number(lot, 1);
    }
    for alpha in ["OPAQUE", "BLEND"] {
        model.push(
            "materials",
            json!({ "alphaMode": alpha, "doubleSided": lot.one_in(2) }),
        );
    }
    if lot.one_in(40) {
        let name = lot.pick(&[
            "KHR_draco_mesh_compression",
            "a\nb",
            "KHR_texture_transform",
        ]);
        model.json["extensionsRequired"] = json!([name]);
    }
    if lot.one_in(12) {
        let all = model.json.as_object_mut().expect("an object");
        let at = lot.below(all.len());
        let key = all.keys().nth(at).expect("a key").clone();
        all[&key] =
            [json!(null), json!([]), json!([[]]), json!({}), json!([7])][lot.below(5)].clone();
    }
    model.bytes()
}

/// A sound model's bytes, changed.
fn damaged(lot: &mut Lot, seed: &[u8]) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    match lot.below(3) {
        // Its JSON or its data, in a container that is sound.
        0 => {
            let end = 20 + u32::from_le_bytes([seed[12], seed[13], seed[14], seed[15]]) as usize;
            let (mut json, mut bin) = (seed[20..end].to_vec(), seed[end + 8..].to_vec());
            let of = if lot.one_in(2) { &mut json } else { &mut bin };
            lot.mutate(
                of,
                b"\"byteOffset\":4294967295,\"count\":-1,\"children\":[0,1],{}[]",
            );
            bytes = glb_of(&json, &bin);
        }
        // Its chunks, doubled, swapped or told to be longer.
        1 => {
            let at = lot.pick(&[4, 8, 12, 16]);
            let word = lot.u32().to_le_bytes();
            if lot.one_in(2) {
                bytes[at..at + 4].copy_from_slice(&word);
            } else {
                let chunk = bytes[12..].to_vec();
                bytes.extend(chunk);
                let length = bytes.len() as u32;
                bytes[8..12].copy_from_slice(&length.to_le_bytes());
            }
        }
        _ => lot.mutate(&mut bytes, seed),
    }
    bytes
}

#[test]
fn no_damage_makes_the_model_reader_panic() {
    let dir = directory();
    let (seed, path) = (rich_model().bytes(), dir.path().join("in.glb"));
    let tally = run("glb", MOST_BYTES, move |lot| {
        write(&path, &damaged(lot, &seed));
        read(&path)
    });
    tally.expect_both(20);
}

#[test]
fn no_numbers_make_the_model_reader_panic() {
    let dir = directory();
    let path = dir.path().join("in.glb");
    let tally = run("gltf", MOST_BYTES, move |lot| {
        write(&path, &generated(lot));
        read(&path)
    });
    tally.expect_both(20);
}

#[test]
fn what_is_trimmed_can_be_read_again() {
    let dir = directory();
    let seed = rich_model().bytes();
    let [input, out]: [PathBuf; 2] = ["in.glb", "out.glb"].map(|name| dir.path().join(name));
    let tally = run("trim", MOST_BYTES, move |lot| {
        let bytes = if lot.one_in(2) {
            generated(lot)
        } else {
            damaged(lot, &seed)
        };
        write(&input, &bytes);
        let settings = InteriorCulling {
            grid: match lot.below(6) {
                0 => InteriorGrid::Resolution(lot.u32()),
                1 => InteriorGrid::Gap(lot.f32()),
                _ => InteriorGrid::Resolution(1 + lot.below(9) as u32),
            },
            level: lot.pick(&[InteriorLevel::Node, InteriorLevel::Triangle]),
            mode: lot.pick(&[InteriorMode::Sampled, InteriorMode::Conservative]),
            transparent: lot.pick(&[InteriorTransparent::Open, InteriorTransparent::Closed]),
            faces: lot.pick(&[InteriorFaces::AsDrawn, InteriorFaces::TwoSided]),
            memory_mib: if lot.one_in(20) { 0 } else { MEMORY_MIB },
            ..Default::default()
        };
        let trimmed = match trim(&input, &out, &settings, NonZero::<usize>::MIN) {
            Ok(trimmed) => trimmed.figures,
            Err(error) => return refused(&error),
        };
        holds(
            trimmed.kept_nodes + trimmed.removed_nodes == trimmed.nodes
                && trimmed.kept_triangles + trimmed.removed_triangles == trimmed.triangles
                && trimmed.seen_triangles <= trimmed.kept_triangles,
            || format!("{trimmed:?}"),
        )?;
        let model = read_model(&out, MEMORY_MIB).map_err(|error| format!("written so: {error}"))?;
        check(&model)?;
        holds(model.triangle_count() == trimmed.kept_triangles, || {
            format!("{} triangles of {trimmed:?}", model.triangle_count())
        })?;
        Ok(true)
    });
    tally.expect_both(20);
}

/// A line of an OBJ file, or nearly.
fn line(lot: &mut Lot) -> String {
    let number = lot.mostly(9.0, 40);
    let word = lot.pick(&[
        "v", "v", "v", "v", "f", "f", "vn", "#", "o", "vt", "usemtl", "",
    ]);
    let words = match word {
        "v" => lot.many(3, |lot| lot.mostly(9.0, 90).to_string()),
        "f" => {
            let corners = if lot.one_in(30) { lot.below(40) } else { 3 };
            lot.many(corners, |lot| {
                let corner = if lot.one_in(60) {
                    i64::from(lot.u32())
                } else {
                    1 + lot.below(3) as i64
                };
                match lot.below(40) {
                    0 => format!("-{corner}"),
                    1 => format!("{corner}//"),
                    2 => format!("{corner}/{}", i64::MIN),
                    3 => i64::MIN.to_string(),
                    _ => corner.to_string(),
                }
            })
        }
        _ => vec![number.to_string()],
    };
    format!("{word} {}", words.join(lot.pick(&[" ", " ", "  ", "\t"])))
}

#[test]
fn no_text_makes_the_obj_reader_panic() {
    let dir = directory();
    let path = dir.path().join("in.obj");
    let tally = run("obj", 1 << 20, move |lot| {
        let mut text = "v 0 0 0\nv 1 0 0\nv 0 1 0\n".to_owned();
        for _ in 0..lot.below(9) {
            text += &line(lot);
            text += lot.pick(&["\n", "\n", "\r\n", "\r"]);
        }
        let mut bytes = (text + "f 1 2 3\n").into_bytes();
        if lot.one_in(3) {
            lot.mutate(&mut bytes, b"f -9223372036854775808 1e999 \xff v nan inf");
        }
        write(&path, &bytes);
        match obj::read(&path) {
            Ok(mesh) => {
                let vertices = mesh.positions.len();
                holds(
                    mesh.indices.len().is_multiple_of(3) && !mesh.indices.is_empty(),
                    || format!("{} corners", mesh.indices.len()),
                )?;
                holds(
                    mesh.indices
                        .iter()
                        .all(|index| (*index as usize) < vertices),
                    || format!("a corner is none of {vertices} vertices"),
                )?;
                holds(
                    mesh.positions
                        .iter()
                        .flatten()
                        .all(|number| number.is_finite()),
                    || "a vertex is nowhere".into(),
                )?;
                Ok(true)
            }
            Err(error) => refused(&error),
        }
    });
    tally.expect_both(20);
}

#[test]
fn no_model_makes_the_city_reader_panic() {
    let dir = directory();
    let (seed, path) = (rich_model().bytes(), dir.path().join("in.glb"));
    let tally = run("city", 400 << 20, move |lot| {
        let bytes = if lot.one_in(4) {
            damaged(lot, &seed)
        } else {
            generated(lot)
        };
        write(&path, &bytes);
        match city::from_file(&path) {
            Ok(scene) => {
                let [low, high] = scene.bounds;
                holds(low.is_finite() && high.is_finite(), || {
                    format!("{low} to {high}")
                })?;
                let is_sound = scene.objects.iter().all(|object| {
                    object.mesh < scene.meshes.len() && object.place(3).translation.is_finite()
                });
                holds(is_sound, || "an object is nowhere".into()).map(|()| true)
            }
            Err(error) => refused(&error),
        }
    });
    tally.expect_both(50);
}

/// The lot's models are not all refused for the same reason.
#[test]
fn what_is_generated_reaches_most_of_what_can_be_said() {
    let dir = directory();
    let path = dir.path().join("in.glb");
    let mut said = std::collections::BTreeSet::new();
    for number in 0..3_000 {
        write(&path, &generated(&mut Lot::of("gltf", number)));
        let text = match read_model(&path, MEMORY_MIB) {
            Ok(model) => format!("{} parts", model.parts.len()),
            Err(error) => error
                .to_string()
                .replace(path.to_str().unwrap_or_default(), ""),
        };
        // Names and numbers aside.
        let kind: String = text
            .chars()
            .filter(|c| !c.is_ascii_digit())
            .take(40)
            .collect();
        said.insert(kind);
    }
    println!("{} outcomes", said.len());
    assert!(said.len() >= 12, "{said:?}");
}
