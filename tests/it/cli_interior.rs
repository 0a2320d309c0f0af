//! `skyline interior`, run as its users run it. What it refuses is in `cli_interior_errors.rs`.

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{
    cli::{directory, path, skyline, stdout_json},
    data::shared,
    glb::{Glb, box_of, boxes_of},
};

/// Runs `skyline interior`, and checks what comes out against the format and what went in.
pub fn interior(input: &str, out: &str, more: &[&str]) -> (Value, Glb) {
    let mut arguments = vec!["interior", input, "--out", out];
    if !more.contains(&"--gap") && !more.contains(&"--resolution") {
        arguments.extend(["--resolution", "32"]);
    }
    arguments.extend(more);
    let printed = stdout_json(&skyline(&arguments));
    let model = Glb::read(out);
    model.check();
    for [all, kept, removed] in [
        ["nodes", "kept_nodes", "removed_nodes"],
        ["triangles", "kept_triangles", "removed_triangles"],
    ] {
        let figure = |name: &str| printed[name].as_u64().expect("a number");
        assert_eq!(figure(all), figure(kept) + figure(removed), "{printed}");
    }
    (printed, model)
}

/// Everything that is drawn was drawn before, with the same normals, materials and winding.
pub fn assert_part_of(after: &Glb, before: &Glb) -> (usize, usize) {
    let (before, after) = (before.drawn(), after.drawn());
    let mut rest = before.iter();
    for triangle in &after {
        assert!(rest.any(|old| old == triangle), "{triangle:?} is new");
    }
    (before.len(), after.len())
}

fn run(dir: &TempDir, model: &Glb, more: &[&str]) -> (Value, Glb) {
    let (input, out) = (path(dir, "in.glb"), path(dir, "out.glb"));
    model.save(&input);
    let (printed, after) = interior(&input, &out, more);
    assert_part_of(&after, model);
    (printed, after)
}

/// A box, and one inside it.
fn nested() -> Glb {
    let mut model = Glb::new();
    let shell = model.boxes("shell", &[([0.0; 3], 1.0)]);
    let core = model.boxes("core", &[([0.1, 0.0, 0.0], 0.3)]);
    model.node(json!({ "name": "shell", "mesh": shell }), true);
    model.node(json!({ "name": "core", "mesh": core }), true);
    model
}

#[test]
fn a_box_in_a_box_goes() {
    let dir = directory();
    for level in ["node", "triangle"] {
        for mode in ["sampled", "conservative"] {
            let more = ["--level", level, "--mode", mode, "--threads", "2"];
            let (printed, after) = run(&dir, &nested(), &more);
            after.check_tidy();
            assert_eq!(after.names("nodes"), ["shell"]);
            assert_eq!(after.names("meshes"), ["shell"]);
            assert_eq!(after.drawn().len(), 12, "{level} {mode}");
            for (figure, value) in [
                ("nodes", 2),
                ("triangles", 24),
                ("kept_nodes", 1),
                ("kept_triangles", 12),
                ("seen_triangles", 12),
                ("kept_moving", 0),
                ("resolution", 32),
                ("threads", 2),
            ] {
                assert_eq!(printed[figure], value, "{figure}");
            }
            assert_eq!(
                (&printed["level"], &printed["mode"]),
                (&level.into(), &mode.into())
            );
            let gap = printed["gap"].as_f64().expect("a number");
            assert!((gap - 3f64.sqrt() * 2.0 / 32.0).abs() < 1e-9, "{gap}");
            let points = printed["lattice_points"].as_u64().expect("a number");
            assert!(points > 32 * 32 * 32 && printed["outside_points"].as_u64() < Some(points));
            assert!(printed["bytes_after"].as_u64() < printed["bytes_before"].as_u64());
            for stage in ["read", "snapping", "field", "front", "extraction", "write"] {
                assert!(printed["seconds"][stage].as_f64() >= Some(0.0), "{stage}");
            }
        }
    }
    let (printed, _) = run(&dir, &nested(), &["--gap", "0.25"]);
    let gap = printed["gap"].as_f64().expect("a number");
    assert!((gap - 0.25).abs() < 1e-6, "{gap}");
}

/// Both boxes in one mesh: triangles go at one level, nothing at the other.
#[test]
fn triangles_of_a_mesh_go_at_their_level_only() {
    let dir = directory();
    let mut model = Glb::new();
    let both = model.boxes("both", &[([0.0; 3], 0.3), ([0.0; 3], 1.0)]);
    model.node(
        json!({ "name": "both", "mesh": both, "scale": [2, -3, 1] }),
        true,
    );
    let (printed, after) = run(&dir, &model, &["--level", "node"]);
    assert_eq!(
        (&printed["kept_triangles"], after.drawn().len()),
        (&24.into(), 24)
    );
    let (printed, after) = run(&dir, &model, &[]);
    after.check_tidy();
    assert_eq!(
        (&printed["kept_triangles"], after.drawn().len()),
        (&12.into(), 12)
    );
    let primitive = &after.json["meshes"][0]["primitives"][0];
    let of = |accessor: &Value| {
        after.list("accessors")[accessor.as_u64().expect("one") as usize].clone()
    };
    let indices = of(&primitive["indices"]);
    assert_eq!(
        (&indices["count"], &indices["componentType"]),
        (&36.into(), &5121.into())
    );
    assert_eq!(
        of(&primitive["attributes"]["POSITION"])["min"],
        json!([-1.0, -1.0, -1.0])
    );
    assert_eq!(of(&primitive["attributes"]["NORMAL"])["count"], 8);
}

/// Three boxes in a mesh, two of its nodes each with another outside of the shell, and a third node all inside.
#[test]
fn a_shared_mesh_keeps_what_is_seen_of_it_anywhere() {
    let dir = directory();
    let mut model = Glb::new();
    let shell = model.boxes("shell", &[([0.0; 3], 15.0)]);
    let row = model.boxes(
        "row",
        &[
            ([0.0; 3], 1.0),
            ([10.0, 0.0, 0.0], 1.0),
            ([20.0, 0.0, 0.0], 1.0),
        ],
    );
    // The same vertices with another material: they stay shared.
    let mut primitive = model.json["meshes"][row]["primitives"][0].clone();
    let paint = model.push("materials", json!({ "name": "paint" }));
    primitive["material"] = paint.into();
    let painted = model.push(
        "meshes",
        json!({ "name": "painted", "primitives": [primitive] }),
    );
    model.node(json!({ "mesh": shell }), true);
    for (mesh, at) in [
        (row, [-20, 0, 0]),
        (row, [0, 5, 0]),
        (painted, [-20, 5, 5]),
        (row, [-10, -5, 0]),
    ] {
        model.node(
            json!({ "name": format!("{at:?}"), "mesh": mesh, "translation": at }),
            true,
        );
    }
    let (printed, after) = run(&dir, &model, &["--resolution", "64"]);
    after.check_tidy();
    assert_eq!(
        after.names("nodes"),
        ["", "[-20, 0, 0]", "[0, 5, 0]", "[-20, 5, 5]"]
    );
    // Boxes 0 and 2 of the row at both its nodes; box 0 of the painted one.
    let triangles = 12 + 2 * 24 + 12;
    assert_eq!(
        (&printed["kept_triangles"], after.drawn().len()),
        (&triangles.into(), triangles)
    );
    assert_eq!(printed["seen_triangles"], 12 + 12 + 12 + 12);
    let primitive = |name: &str| &after.named("meshes", name)["primitives"][0];
    assert_eq!(
        primitive("row")["attributes"],
        primitive("painted")["attributes"]
    );
    assert_ne!(primitive("row")["indices"], primitive("painted")["indices"]);
}

/// Names, extras, an animation, a skin, a camera, a light and their nodes are what they were.
#[test]
fn what_stays_is_what_it_was() {
    let dir = directory();
    let mut model = nested();
    let core = model.json["nodes"][1]["mesh"].clone();
    let light = json!({ "KHR_lights_punctual": { "lights": [{ "type": "point" }] } });
    model.json["extensions"] = light;
    model.json["extensionsUsed"] = json!(["KHR_lights_punctual", "KHR_materials_unlit"]);
    model.push(
        "cameras",
        json!({ "type": "perspective", "perspective": { "yfov": 1, "znear": 0.5 } }),
    );
    let unlit = json!({ "name": "unlit", "extensions": { "KHR_materials_unlit": {} }, "extras": { "n": 7 } });
    model.push("materials", unlit);
    model.json["meshes"][0]["primitives"][0]["material"] = 0.into();
    model.json["meshes"][0]["extras"] = json!({ "deep": [null, { "x": 0.1 }] });
    let light = json!({ "KHR_lights_punctual": { "light": 0 } });
    let hidden = |name: &str, more: Value| {
        let mut node = json!({ "name": name, "mesh": core });
        node.as_object_mut()
            .expect("one")
            .extend(more.as_object().expect("one").clone());
        node
    };
    let gone = model.node(hidden("gone", json!({ "extras": { "n": 1 } })), false);
    model.node(json!({ "name": "empty then", "children": [gone] }), true);
    model.node(hidden("lamp", json!({ "extensions": light })), true);
    model.node(hidden("eye", json!({ "camera": 0 })), true);
    let joint = model.node(hidden("joint", json!({ "scale": [0.5, 0.5, 0.5] })), false);
    let locator = model.node(
        json!({ "name": "locator", "extras": { "slot": "wheel" } }),
        false,
    );
    let other = model.node(hidden("gone too", json!({})), false);
    model.node(
        json!({ "name": "group", "children": [other, joint, locator] }),
        true,
    );
    let mover = model.node(hidden("mover", json!({ "extras": { "m": "m" } })), true);
    let ticks = model.floats("SCALAR", &[0.0, 1.0]);
    let moves = model.floats("VEC3", &[0.0, 0.0, 0.0, 5.0, 0.0, 0.0]);
    let animation = json!({
        "name": "out", "extras": { "loop": true },
        "samplers": [{ "input": ticks, "output": moves }],
        "channels": [{ "sampler": 0, "target": { "node": mover, "path": "translation" } }],
    });
    model.push("animations", animation);
    let matrices: Vec<f32> = (0..16).map(|i| f32::from(i % 5 == 0)).collect();
    let matrices = model.floats("MAT4", &matrices);
    let skin = json!({ "name": "skin", "joints": [joint], "inverseBindMatrices": matrices });
    model.push("skins", skin);
    let (printed, after) = run(&dir, &model, &[]);
    after.check_tidy();
    let names = ["shell", "lamp", "eye", "joint", "locator", "group", "mover"];
    assert_eq!(after.names("nodes"), names);
    assert_eq!(
        (&printed["kept_moving"], &printed["removed_nodes"]),
        (&2.into(), &5.into())
    );
    // What they refer to is what they referred to.
    let name_of = |node: &Value| after.names("nodes")[node.as_u64().expect("a number") as usize];
    let channel = &after.json["animations"][0]["channels"][0];
    assert_eq!(name_of(&channel["target"]["node"]), "mover");
    assert_eq!(name_of(&after.json["skins"][0]["joints"][0]), "joint");
    let group = after.named("nodes", "group")["children"]
        .as_array()
        .expect("a list");
    assert_eq!(
        group.iter().map(name_of).collect::<Vec<_>>(),
        ["joint", "locator"]
    );
    for name in ["lamp", "eye"] {
        assert!(after.named("nodes", name).get("mesh").is_none(), "{name}");
    }
    assert!(
        after.named("nodes", "mover").get("mesh").is_some(),
        "what moves keeps its mesh"
    );
    for key in [
        "asset",
        "extensions",
        "extensionsUsed",
        "materials",
        "cameras",
    ] {
        assert_eq!(after.json[key], model.json[key], "{key}");
    }
    assert_eq!(
        after.json["meshes"][0]["extras"],
        model.json["meshes"][0]["extras"]
    );
    assert_eq!(
        after.json["animations"][0]["extras"],
        json!({ "loop": true })
    );
    let sampler = &after.json["animations"][0]["samplers"][0];
    let output = after.elements(sampler["output"].as_u64().expect("a number") as usize);
    assert_eq!(output, [[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]);
}

/// A shell that may move, is transparent or one-sided the wrong way round hides nothing.
#[test]
fn only_what_is_sure_to_hide_hides() {
    let dir = directory();
    let kept = |model: &Glb, more: &[&str]| {
        let (printed, after) = run(&dir, model, more);
        (
            after.names("nodes").contains(&"core"),
            printed["kept_moving"].as_u64(),
        )
    };
    assert_eq!(kept(&nested(), &[]), (false, Some(0)));
    let with = |change: fn(&mut Value)| {
        let mut model = nested();
        change(&mut model.json);
        model
    };
    let moving: [fn(&mut Value); 6] = [
        |json| json["nodes"][0]["skin"] = 0.into(),
        |json| {
            let position = json["meshes"][0]["primitives"][0]["attributes"]["POSITION"].clone();
            json["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": position }]);
        },
        |json| {
            json["nodes"][0]["extensions"] = json!({ "KHR_node_visibility": { "visible": false } });
        },
        |json| json["nodes"][0]["extensions"] = json!({ "ACME_hinge": { "node": 1 } }),
        |json| {
            let target = json!({ "path": "pointer", "extensions": {
                "KHR_animation_pointer": { "pointer": "/nodes/0/rotation" } } });
            json["animations"] = json!([{ "channels": [{ "sampler": 0, "target": target }],
                "samplers": [{ "input": 0, "output": 0 }] }]);
        },
        |json| {
            let at = json["meshes"][0]["primitives"][0]["attributes"]["POSITION"].clone();
            json["nodes"][0]["extensions"] =
                json!({ "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": at } } });
        },
    ];
    for (number, change) in moving.into_iter().enumerate() {
        let mut model = with(change);
        if number == 0 {
            model.push("skins", json!({ "joints": [1] }));
            let joint = model.node(json!({ "name": "a joint" }), true);
            model.json["skins"][0]["joints"] = json!([joint]);
        }
        assert_eq!(kept(&model, &[]), (true, Some(1)), "{number}");
    }
    let blend = with(|json| {
        json["materials"] = json!([{ "alphaMode": "BLEND" }]);
        json["meshes"][0]["primitives"][0]["material"] = 0.into();
    });
    assert!(kept(&blend, &[]).0 && !kept(&blend, &["--transparent", "closed"]).0);
    let glass = with(|json| {
        json["materials"] = json!([{ "extensions":
            { "KHR_materials_transmission": { "transmissionFactor": 0.9 } } }]);
        json["meshes"][0]["primitives"][0]["material"] = 0.into();
    });
    assert!(kept(&glass, &[]).0);
    let mut inside_out = nested();
    let (positions, mut indices) = box_of([0.0; 3], 1.0);
    indices.reverse();
    inside_out.json["meshes"][0]["primitives"][0] = inside_out.primitive(&positions, &indices);
    assert!(kept(&inside_out, &[]).0 && !kept(&inside_out, &["--faces", "two-sided"]).0);
    inside_out.json["materials"] = json!([{ "doubleSided": true }]);
    inside_out.json["meshes"][0]["primitives"][0]["material"] = 0.into();
    assert!(!kept(&inside_out, &[]).0);
    // A mirror turns the winding round and what counts as the front with it.
    let mirror = |mut model: Glb| {
        model.json["materials"] = json!([{}]);
        model.json["nodes"][0]["scale"] = json!([-1, 1, 1]);
        model
    };
    assert!(kept(&mirror(inside_out), &[]).0 && !kept(&mirror(nested()), &[]).0);
}

/// Where an extension that is not known may refer to anything, everything keeps its number.
#[test]
fn unknown_extensions_find_what_they_refer_to() {
    let dir = directory();
    let mut model = nested();
    let spare = model.floats("VEC3", &[1.0, 2.0, 3.0]);
    let unused = model.boxes("unused", &[([0.0; 3], 1.0)]);
    model.node(json!({ "name": "last" }), true);
    model.json["extensionsUsed"] = json!(["ACME_links"]);
    model.json["extensions"] =
        json!({ "ACME_links": { "last": 2, "list": spare, "way": "/nodes/2/name" } });
    let (printed, after) = run(&dir, &model, &[]);
    assert_eq!(printed["removed_nodes"], 1);
    assert_eq!(after.names("nodes"), ["shell", "core", "last"]);
    assert_eq!(after.json["extensions"], model.json["extensions"]);
    assert_eq!(after.elements(spare), [[1.0, 2.0, 3.0]]);
    assert_eq!(after.list("meshes").len(), unused + 1);
    assert_eq!(after.drawn().len(), 12);
    assert!(after.bin.len() < model.bin.len());
}

/// A name, and what makes a mesh's primitives, one or a list.
type Way<'a> = (&'a str, &'a dyn Fn(&mut Glb) -> Value);

/// Every way to say the same triangles gives the same result.
#[test]
fn all_ways_to_store_triangles_are_understood() {
    let dir = directory();
    let (positions, list) = boxes_of(&[([0.0; 3], 0.25), ([0.0; 3], 1.0)]);
    let expected = {
        let mut model = Glb::new();
        let mesh = model.boxes("both", &[([0.0; 3], 0.25), ([0.0; 3], 1.0)]);
        model.node(json!({ "mesh": mesh }), true);
        let places = |model: &Glb| -> Vec<_> {
            let mut all: Vec<_> = model
                .drawn()
                .iter()
                .map(|(_, corners)| {
                    let mut corners = corners.map(|(place, _)| place);
                    corners.sort();
                    corners
                })
                .collect();
            all.sort();
            all
        };
        let (_, after) = run(&dir, &model, &[]);
        assert_eq!(after.drawn().len(), 12);
        (places(&after), places)
    };
    let (expected, places) = (expected.0, expected.1);
    let plain: Vec<[f32; 3]> = list
        .iter()
        .map(|index| positions[*index as usize])
        .collect();
    // Triangles joined by repeated corners.
    let strip: Vec<u32> = list
        .chunks(3)
        .flat_map(|t| [t[0], t[0], t[0], t[1], t[2], t[2]])
        .collect();
    let ways: [Way; 8] = [
        ("not indexed", &|model| {
            let position = model.floats("VEC3", plain.as_flattened());
            json!({ "attributes": { "POSITION": position }, "mode": 4.0 })
        }),
        ("strip", &|model| {
            let mut primitive = model.primitive(&positions, &strip);
            primitive["mode"] = 5.into();
            primitive
        }),
        ("strip, not indexed", &|model| {
            let corners: Vec<[f32; 3]> = strip.iter().map(|i| positions[*i as usize]).collect();
            let mut primitive = model.primitive(&corners, &[]);
            primitive.as_object_mut().expect("one").remove("indices");
            primitive["mode"] = 5.into();
            primitive
        }),
        ("32-bit indices", &|model| {
            let mut primitive = model.primitive(&positions, &[]);
            let bytes: Vec<u8> = list.iter().flat_map(|i| i.to_le_bytes()).collect();
            let view = model.view(&bytes, json!({}));
            primitive["indices"] = model
                .push("accessors", json!({ "bufferView": view, "componentType": 5125, "type": "SCALAR", "count": list.len() }))
                .into();
            primitive
        }),
        ("interleaved", &|model| {
            let mut primitive = model.primitive(&positions, &list);
            let bytes: Vec<u8> = positions
                .iter()
                .flat_map(|at| {
                    at.iter()
                        .chain(&[0.0, 1.0, 0.0, 9.0])
                        .flat_map(|n| n.to_le_bytes())
                })
                .collect();
            let view = model.view(&bytes, json!({ "byteStride": 28, "target": 34962 }));
            for (semantic, offset) in [("POSITION", 0), ("NORMAL", 12)] {
                let number = primitive["attributes"][semantic].as_u64().expect("one") as usize;
                model.json["accessors"][number]["bufferView"] = view.into();
                model.json["accessors"][number]["byteOffset"] = offset.into();
                if offset == 12 {
                    model.json["accessors"][number]["min"] = json!([0, 1, 0]);
                    model.json["accessors"][number]["max"] = json!([0, 1, 0]);
                }
            }
            primitive["material"] = model.push("materials", json!({})).into();
            primitive
        }),
        ("quantised", &|model| {
            model.json["extensionsUsed"] = json!(["KHR_mesh_quantization"]);
            model.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
            let mut primitive = model.primitive(&positions, &list);
            let code = |x: f32| (x * 4.0) as i16;
            let bytes: Vec<u8> = positions
                .iter()
                .flat_map(|at| [code(at[0]), code(at[1]), code(at[2]), 0])
                .flat_map(i16::to_le_bytes)
                .collect();
            let view = model.view(&bytes, json!({ "byteStride": 8, "target": 34962 }));
            primitive["attributes"]["POSITION"] = model
                .push(
                    "accessors",
                    json!({ "bufferView": view, "componentType": 5122, "type": "VEC3", "count": 16,
                    "min": [-4, -4, -4], "max": [4, 4, 4] }),
                )
                .into();
            model.json["nodes"][0]["scale"] = json!([0.25, 0.25, 0.25]);
            primitive
        }),
        ("sparse", &|model| {
            let primitive = model.primitive(&positions, &list);
            let number = primitive["attributes"]["POSITION"].as_u64().expect("one") as usize;
            // The last three vertices are elsewhere in the view, and right in the sparse part.
            let values: Vec<u8> = positions[13..]
                .as_flattened()
                .iter()
                .flat_map(|n| n.to_le_bytes())
                .collect();
            let (values, indices) = (
                model.view(&values, json!({})),
                model.view(&[13, 14, 15], json!({})),
            );
            let start = model.json["bufferViews"][model.json["accessors"][number]["bufferView"]
                .as_u64()
                .expect("one") as usize]["byteOffset"]
                .as_u64()
                .expect("one") as usize;
            model.bin[start + 13 * 12..start + 16 * 12].fill(0);
            model.json["accessors"][number]["sparse"] = json!({
                "count": 3,
                "indices": { "bufferView": indices, "componentType": 5121 },
                "values": { "bufferView": values },
            });
            primitive
        }),
        ("fans", &|model| {
            let mut primitive = model.primitive(&positions, &list[..36]);
            // The faces of the outer box as fans of two triangles.
            let fans: Vec<Value> = list[36..]
                .chunks(6)
                .map(|face| {
                    let mut fan = primitive.clone();
                    fan["indices"] = model.indices(&[face[0], face[1], face[2], face[5]]).into();
                    fan["mode"] = 6.into();
                    fan
                })
                .collect();
            let mut fans = fans;
            primitive["extras"] = json!({ "inner": true });
            fans.push(primitive);
            Value::Array(fans)
        }),
    ];
    for (name, way) in ways {
        let mut model = Glb::new();
        model.node(json!({ "mesh": 0 }), true);
        let primitives = match way(&mut model) {
            Value::Array(primitives) => primitives,
            primitive => vec![primitive],
        };
        model.push("meshes", json!({ "primitives": primitives }));
        let (input, out) = (path(&dir, "in.glb"), path(&dir, "out.glb"));
        model.save(&input);
        let (printed, after) = interior(&input, &out, &[]);
        after.check_tidy();
        assert_eq!(places(&after), expected, "{name}");
        assert_eq!(
            (&printed["triangles"], &printed["kept_triangles"]),
            (&24.into(), &12.into()),
            "{name}"
        );
        for primitive in after.json["meshes"][0]["primitives"]
            .as_array()
            .expect("a list")
        {
            let is_same = name == "fans" && primitive["mode"] == 6;
            assert!(
                is_same || primitive["mode"].as_u64().unwrap_or(4) == 4,
                "{name}"
            );
        }
    }
}

/// Lines and points are not judged, and what they share with triangles stays whole.
#[test]
fn lines_and_points_stay() {
    let dir = directory();
    let mut model = nested();
    let mut lines = model.json["meshes"][1]["primitives"][0].clone();
    lines["mode"] = 1.into();
    let primitives = model.json["meshes"][1]["primitives"]
        .as_array_mut()
        .expect("a list");
    primitives.push(lines.clone());
    let (printed, after) = run(&dir, &model, &[]);
    after.check_tidy();
    assert_eq!(
        after.named("meshes", "core")["primitives"]
            .as_array()
            .map(Vec::len),
        Some(1)
    );
    assert_eq!(after.named("meshes", "core")["primitives"][0]["mode"], 1);
    assert_eq!(
        (&printed["kept_nodes"], &printed["kept_triangles"]),
        (&2.into(), &12.into())
    );
}

/// What only another scene shows stays, and so does what it shows of this one.
#[test]
fn other_scenes_stay_whole() {
    let dir = directory();
    let mut model = nested();
    let other = model.boxes("other", &[([0.0; 3], 0.2)]);
    let far = model.node(json!({ "name": "other", "mesh": other }), false);
    model.push("scenes", json!({ "name": "inside", "nodes": [far, 1] }));
    let (printed, after) = run(&dir, &model, &[]);
    assert_eq!(after.names("nodes"), ["shell", "core", "other"]);
    assert_eq!(printed["removed_nodes"], 0);
    assert_eq!(after.json["scenes"], model.json["scenes"]);
}

/// A check that cannot fail is none.
#[test]
fn the_checks_find_what_is_wrong() {
    let fails =
        |check: &dyn Fn()| std::panic::catch_unwind(std::panic::AssertUnwindSafe(check)).is_err();
    let finish = |model: &mut Glb| {
        model.json["buffers"] = json!([{ "byteLength": model.bin.len() }]);
    };
    let mut model = nested();
    finish(&mut model);
    assert!(!fails(&|| model.check()) && !fails(&|| model.check_tidy()));
    let wrongs: [fn(&mut Glb); 6] = [
        |model| model.bin[3] = 0x40,
        |model| model.json["accessors"][2]["count"] = 99.into(),
        |model| model.json["accessors"][1]["count"] = 7.into(),
        |model| model.json["accessors"][0]["byteOffset"] = 2.into(),
        |model| model.json["nodes"][1]["mesh"] = 2.into(),
        |model| {
            let indices = &model.json["bufferViews"][2]["byteOffset"];
            let at = indices.as_u64().expect("a number") as usize;
            model.bin[at] = 8;
        },
    ];
    for (number, wrong) in wrongs.iter().enumerate() {
        let mut model = model.clone();
        wrong(&mut model);
        assert!(fails(&|| model.check()), "{number}");
    }
    let mut moved = model.clone();
    moved.json["nodes"][1]["translation"] = json!([0, 0, 0.01]);
    assert!(fails(&|| _ = assert_part_of(&moved, &model)));
    let mut untidy = model.clone();
    untidy.floats("VEC3", &[0.0; 3]);
    finish(&mut untidy);
    assert!(!fails(&|| untidy.check()) && fails(&|| untidy.check_tidy()));
}

/// Real models: all rules are kept, and nothing is drawn that was not.
#[test]
fn real_models_lose_what_is_hidden() {
    let dir = directory();
    for name in ["engine_four_cylinder", "car_f40", "carriage_house"] {
        let Some(input) = shared(&format!("cad/{name}_ldraw.glb")) else {
            return;
        };
        let before = Glb::read(&input);
        let (input, out) = (input.display().to_string(), path(&dir, "out.glb"));
        let more = [
            "--resolution",
            "128",
            "--faces",
            "two-sided",
            "--transparent",
            "closed",
        ];
        let (printed, after) = interior(&input, &out, &more);
        after.check_tidy();
        let (all, kept) = assert_part_of(&after, &before);
        assert_eq!(
            (&printed["triangles"], &printed["kept_triangles"]),
            (&all.into(), &kept.into())
        );
        assert!(kept < all && kept > all / 10, "{name}: {kept} of {all}");
        assert_eq!(after.json["asset"], before.json["asset"]);
        assert_eq!(after.json["materials"], before.json["materials"]);
        println!("{name}: {kept} of {all} triangles, {}", printed["seconds"]);
        // Once more, and nothing that was seen goes.
        let again = path(&dir, "again.glb");
        let (printed, _) = interior(&out, &again, &more);
        let left = printed["kept_triangles"].as_u64().expect("a number");
        assert!(
            left <= kept as u64 && left > kept as u64 / 2,
            "{left} of {kept}"
        );
    }
}
