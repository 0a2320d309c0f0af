//! `skyline interior` on files that are apart, in place, wrong or broken at random.

use std::{num::NonZero, path::Path};

use bevy_skyline::{
    interior::{InteriorCulling, InteriorGrid},
    offline::interior::trim,
};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{
    cli::{assert_bad, directory, path, skyline},
    cli_interior::{assert_part_of, interior},
    glb::{Glb, glb_of},
};

/// A box with a texture, a hidden one, and one that is hidden but moves.
fn model() -> Glb {
    let mut model = Glb::new();
    let shell = model.boxes("shell", &[([0.0; 3], 1.0), ([0.3, 0.0, 0.0], 0.2)]);
    let core = model.boxes("core", &[([0.0; 3], 0.1)]);
    model.node(json!({ "name": "shell", "mesh": shell }), true);
    let core = model.node(json!({ "name": "core", "mesh": core }), false);
    model.node(
        json!({ "name": "group", "children": [core], "rotation": [0, 0, 0, 1] }),
        true,
    );
    model
}

/// The same with a strip, an animation, a skin, a picture, a material and a sparse accessor.
pub fn rich_model() -> Glb {
    let mut model = model();
    let core = model.json["nodes"][1]["mesh"].clone();
    let strip = model.primitive(
        &[[0.0; 3], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [9.0; 3]],
        &[0, 1, 2, 3],
    );
    model.json["meshes"][1]["primitives"]
        .as_array_mut()
        .expect("a list")
        .push(strip);
    model.json["meshes"][1]["primitives"][1]["mode"] = 5.into();
    let ticks = model.floats("SCALAR", &[0.0, 1.0]);
    let moves = model.floats("VEC3", &[0.0, 0.0, 0.0, 5.0, 0.0, 0.0]);
    let mover = model.node(json!({ "name": "mover", "mesh": core, "camera": 0 }), true);
    model.push(
        "animations",
        json!({
            "samplers": [{ "input": ticks, "output": moves }],
            "channels": [{ "sampler": 0, "target": { "node": mover, "path": "translation" } }],
        }),
    );
    model.push("skins", json!({ "joints": [mover], "skeleton": 0 }));
    model.push(
        "images",
        json!({ "bufferView": 0, "mimeType": "image/png" }),
    );
    model.push(
        "materials",
        json!({ "alphaMode": "OPAQUE", "doubleSided": false }),
    );
    model.json["meshes"][0]["primitives"][0]["material"] = 0.into();
    model.json["accessors"][0]["sparse"] = json!({ "count": 1,
        "indices": { "bufferView": 2, "componentType": 5123 },
        "values": { "bufferView": 0, "byteOffset": 12 } });
    model
}

/// A PNG of one pixel.
fn picture(dir: &TempDir) -> Vec<u8> {
    let file = path(dir, "pixel.png");
    image::RgbImage::new(1, 1)
        .save(&file)
        .expect("a picture can be written");
    std::fs::read(&file).expect("it is there")
}

fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for three in bytes.chunks(3) {
        let at = |i: usize| u32::from(three.get(i).copied().unwrap_or(0));
        let bits = at(0) << 16 | at(1) << 8 | at(2);
        for i in 0..4 {
            text.push(if i <= three.len() {
                char::from(ALPHABET[(bits >> (18 - 6 * i) & 63) as usize])
            } else {
                '='
            });
        }
    }
    text
}

#[test]
fn buffers_and_pictures_may_lie_anywhere() {
    let (dir, other) = (directory(), directory());
    let mut model = model();
    let png = picture(&dir);
    std::fs::write(path(&dir, "a pixel.png"), &png).expect("a file can be written");
    std::fs::write(path(&dir, "mo del.bin"), &model.bin).expect("a file can be written");
    for uri in ["a%20pixel.png", "nowhere.png"] {
        model.push("images", json!({ "uri": uri }));
    }
    let length = model.bin.len();
    let data = format!(
        "data:application/octet-stream;base64,{}",
        base64(&model.bin)
    );
    for uri in ["mo%20del.bin", &data] {
        let input = path(&dir, "mo del.gltf");
        model.json["buffers"] = json!([{ "byteLength": length, "uri": uri }]);
        std::fs::write(&input, model.json.to_string()).expect("a file can be written");
        // Beside it, pictures stay where they are; the model's own buffer is not written over.
        let before = std::fs::read(path(&dir, "mo del.bin")).expect("it is there");
        for name in ["mo del.gltf", "out.gltf", "out.glb"] {
            let (_, after) = interior(&input, &path(&dir, name), &[]);
            after.check_tidy();
            assert_part_of(&after, &model);
            assert_eq!(after.json["images"], model.json["images"]);
            assert_eq!(after.names("nodes"), ["shell"]);
            assert_eq!(after.drawn().len(), 12);
            std::fs::write(&input, model.json.to_string()).expect("a file can be written");
        }
        if uri != data {
            assert_eq!(
                std::fs::read(path(&dir, "mo del.bin")).expect("it is there"),
                before
            );
        }
        // Elsewhere, those that can be found come along.
        for name in ["out.glb", "out.gltf"] {
            let (_, after) = interior(&input, &path(&other, name), &[]);
            after.check_tidy();
            let image = &after.json["images"][0];
            assert_eq!(
                (image.get("uri"), &image["mimeType"]),
                (None, &"image/png".into())
            );
            let view =
                &after.json["bufferViews"][image["bufferView"].as_u64().expect("one") as usize];
            let start = view["byteOffset"].as_u64().expect("a number") as usize;
            assert_eq!(after.bin[start..start + png.len()], png);
            assert_eq!(after.json["images"][1], model.json["images"][1]);
        }
        std::fs::remove_file(path(&other, "out.gltf")).expect("it is there");
    }
    let told = skyline(&[
        "interior",
        &path(&dir, "mo del.gltf"),
        "--out",
        &path(&other, "out.glb"),
    ]);
    assert!(String::from_utf8_lossy(&told.stderr).contains("nowhere.png"));
    assert!(!has_drafts(&dir) && !has_drafts(&other));
}

fn has_drafts(dir: &TempDir) -> bool {
    let entries = std::fs::read_dir(dir.path()).expect("the directory is there");
    entries
        .flatten()
        .any(|entry| entry.file_name().to_string_lossy().ends_with(".part"))
}

#[test]
fn a_model_can_be_trimmed_in_place() {
    let dir = directory();
    let model = model();
    let file = path(&dir, "model.glb");
    model.save(&file);
    let (_, after) = interior(&file, &file, &[]);
    assert_eq!(assert_part_of(&after, &model), (36, 12));
    // And again: nothing is left to go, and nothing goes.
    let (printed, again) = interior(&file, &file, &[]);
    assert_eq!(
        (&printed["removed_triangles"], again.bin),
        (&0.into(), after.bin)
    );
    #[cfg(unix)]
    {
        let link = path(&dir, "link.glb");
        std::os::unix::fs::symlink(&file, &link).expect("a link can be made");
        model.save(&file);
        interior(&file, &link, &[]);
        assert!(Path::new(&link).is_symlink(), "the link is still one");
        assert_eq!(Glb::read(&file).drawn().len(), 12);
    }
}

/// A mesh of zeros that lie nowhere.
fn make_huge(json: &mut Value, count: u64) {
    for accessor in [0, 1, 2] {
        let accessor = &mut json["accessors"][accessor];
        accessor["count"] = count.into();
        if let Some(accessor) = accessor.as_object_mut() {
            accessor.remove("bufferView");
        }
    }
}

/// A change to a model's JSON, and what the message must name.
type Wrong = (fn(&mut Value), &'static str);

#[test]
fn bad_models_are_told_in_one_line_and_exit_code_two() {
    let dir = directory();
    let (input, out) = (path(&dir, "in.glb"), path(&dir, "out.glb"));
    let wrongs: &[Wrong] = &[
        (|json| json["asset"]["version"] = "1.0".into(), "glTF 1.0"),
        (|json| json["asset"] = Value::Null, "version"),
        (
            |json| json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]),
            "gltf-transform",
        ),
        (
            |json| json["extensionsUsed"] = json!(["EXT_meshopt_compression"]),
            "gltf-transform",
        ),
        (
            |json| json["bufferViews"][0]["extensions"] = json!({ "EXT_meshopt_compression": {} }),
            "gltf-transform",
        ),
        (
            |json| json["extensionsRequired"] = json!(["ACME_other"]),
            "ACME_other",
        ),
        (|json| json["scene"] = 3.into(), "default scene"),
        (|json| json["nodes"] = json!({ "a": 1 }), "\"nodes\""),
        (
            |json| json["nodes"][0]["mesh"] = 17.into(),
            "17 among its 2 meshes",
        ),
        (|json| json["nodes"][0]["mesh"] = (-1).into(), "-1"),
        (
            |json| json["nodes"][0]["children"] = json!([0]),
            "below itself",
        ),
        (
            |json| json["nodes"][1]["children"] = json!([2]),
            "below itself",
        ),
        (
            |json| json["nodes"][2]["rotation"] = json!([0, 0, 0, 0]),
            "2 (group)",
        ),
        (
            |json| json["nodes"][2]["matrix"] = json!([1, 2, 3]),
            "2 (group)",
        ),
        (
            |json| json["nodes"][2]["translation"] = json!([1e300, 0, 0]),
            "1 (core)",
        ),
        (
            |json| json["nodes"][0]["scale"] = json!([1e39, 1, 1]),
            "0 (shell)",
        ),
        (
            |json| {
                json["nodes"][0]["scale"] = json!([0, 0, 1e-250]);
                json["nodes"][2]["scale"] = json!([0, 0, 0]);
            },
            "scale it up",
        ),
        (
            |json| json["meshes"][0]["primitives"][0]["mode"] = 7.into(),
            "mode 7",
        ),
        (
            |json| json["meshes"][0]["primitives"][0]["mode"] = "x".into(),
            "mode",
        ),
        (
            |json| json["meshes"][0]["primitives"][0]["indices"] = 4.into(),
            "whole numbers",
        ),
        (
            |json| json["meshes"][0]["primitives"][0]["indices"] = 99.into(),
            "99",
        ),
        (
            |json| json["meshes"][0]["primitives"][0]["material"] = 9.into(),
            "material 9",
        ),
        (
            |json| json["meshes"][0]["primitives"][0]["attributes"] = 9.into(),
            "attributes",
        ),
        (
            |json| json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = 2.into(),
            "shell",
        ),
        (
            |json| json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = 4.into(),
            "as many",
        ),
        (
            |json| json["accessors"][0]["componentType"] = 5130.into(),
            "accessor 0",
        ),
        (
            |json| json["accessors"][0]["componentType"] = 5125.into(),
            "vectors of 3",
        ),
        (
            |json| json["accessors"][0]["type"] = "VEC9".into(),
            "accessor 0",
        ),
        (
            |json| json["accessors"][0]["count"] = 17.into(),
            "accessor 0 reaches",
        ),
        (
            |json| json["accessors"][0]["count"] = u64::MAX.into(),
            "accessor 0 reaches",
        ),
        (
            |json| json["accessors"][0]["count"] = (-3).into(),
            "whole number",
        ),
        (
            |json| json["accessors"][0]["byteOffset"] = (u64::MAX - 3).into(),
            "accessor 0 reaches",
        ),
        (|json| make_huge(json, 4_000_000_000), "--memory-mib"),
        (|json| make_huge(json, 1 << 61), "--memory-mib"),
        (|json| make_huge(json, u64::MAX), "--memory-mib"),
        (
            |json| {
                json["accessors"][0]["sparse"] = json!({ "count": 1,
                    "indices": { "bufferView": 0, "componentType": 5125 },
                    "values": { "bufferView": 0, "byteOffset": 186 } });
            },
            "sparse",
        ),
        (
            |json| json["bufferViews"][0]["byteLength"] = 1e9.into(),
            "view 0",
        ),
        (
            |json| json["bufferViews"][0]["byteOffset"] = u64::MAX.into(),
            "view 0",
        ),
        (|json| json["bufferViews"][0]["buffer"] = 1.into(), "view 0"),
        (
            |json| json["buffers"] = json!([{ "byteLength": 99_999 }]),
            "cut off",
        ),
        (|json| json["buffers"] = json!([{}]), "length"),
        (
            |json| json["buffers"] = json!([{ "byteLength": 4, "uri": "data:x" }]),
            "address",
        ),
        (
            |json| json["buffers"] = json!([{ "byteLength": 4, "uri": "away/my.bin" }]),
            "my.bin",
        ),
        (
            |json| json["buffers"] = json!([{ "byteLength": 4, "uri": "/dev/zero" }]),
            "no file",
        ),
        (
            |json| json["buffers"] = json!([{ "byteLength": 4, "uri": "http://a/b.bin" }]),
            "b.bin",
        ),
        (
            |json| json["scenes"][0]["nodes"] = json!([]),
            "no triangles",
        ),
        (|json| json["scenes"] = json!([{}]), "no triangles"),
        (
            |json| json["skins"] = json!([{ "joints": [0, 1, 2] }]),
            "2 below a skin's joint",
        ),
    ];
    for (number, (change, names)) in wrongs.iter().enumerate() {
        let mut model = model();
        change(&mut model.json);
        model.save(&input);
        let arguments = ["interior", &input, "--out", &out, "--resolution", "16"];
        println!("{number}");
        assert_bad(&skyline(&arguments), names, &arguments);
    }
    let mut nan = model();
    let start = nan.json["bufferViews"][0]["byteOffset"]
        .as_u64()
        .expect("one") as usize;
    nan.bin[start..start + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let mut index = model();
    let start = index.json["bufferViews"][2]["byteOffset"]
        .as_u64()
        .expect("one") as usize;
    index.bin[start..start + 2].copy_from_slice(&[16, 0]);
    let whole = model().bytes();
    let cut = whole.len() * 2 / 3;
    for (bytes, names) in [
        (nan.bytes(), "node 0 (shell)"),
        (index.bytes(), "index 16 into 16 vertices"),
        (whole[..cut].to_vec(), "cut off"),
        (whole[..10].to_vec(), "cut off"),
        (b"glTF\x01\0\0\0\x0c\0\0\0".to_vec(), "glTF 1"),
        (b"glTF\x02\0\0\0\x0c\0\0\0".to_vec(), "JSON"),
        (glb_of(b"[1] ", &[]), "no object"),
        (glb_of(b"{\"a\"", &[]), "export the model again"),
        (b"{ \"asset\": ".to_vec(), "export the model again"),
        (b"solid cube".to_vec(), "no glTF"),
        (Vec::new(), "no glTF"),
        (
            [b"{\"a\":".repeat(100_000), b"1".to_vec()].concat(),
            "recursion",
        ),
    ] {
        std::fs::write(&input, bytes).expect("a file can be written");
        let arguments = ["interior", &input, "--out", &out];
        assert_bad(&skyline(&arguments), names, &arguments);
    }
    assert!(
        !Path::new(&out).exists() && !has_drafts(&dir),
        "something was written"
    );
}

#[test]
fn bad_flags_of_interior_are_told_in_one_line_and_exit_code_two() {
    let dir = directory();
    let (input, out) = (path(&dir, "in.glb"), path(&dir, "out.glb"));
    model().save(&input);
    let cases: &[(&[&str], &str)] = &[
        (&["--resolution", "0"], "1 to"),
        (&["--resolution", "100000"], "1 to"),
        (&["--resolution", "-3"], "--resolution"),
        (&["--gap", "0"], "positive"),
        (&["--gap", "nan"], "finite"),
        (&["--gap", "1e-30"], "at least"),
        (&["--gap", "1", "--resolution", "9"], "--resolution"),
        (
            &["--resolution", "3000", "--memory-mib", "64"],
            "allow as much",
        ),
        (&["--memory-mib", "0"], "--memory-mib"),
        (&["--threads", "0"], "--threads"),
        (&["--level", "mesh"], "triangle"),
        (&["--mode", "exact"], "conservative"),
        (&["--transparent", "yes"], "open"),
        (&["--faces", "three-sided"], "as-drawn"),
    ];
    for (given, names) in cases {
        let mut arguments = vec!["interior", &input, "--out", &out];
        arguments.extend(*given);
        assert_bad(&skyline(&arguments), names, &arguments);
    }
    let nowhere = path(&dir, "no/such/place.glb");
    let here = dir.path().display().to_string();
    let missing = path(&dir, "missing.glb");
    for (input, out, names) in [
        (&missing, &out, "missing.glb"),
        (&here, &out, "no file"),
        (&input, &nowhere, "create it first"),
        (&input, &here, "directory"),
        (&input, &"/dev/null".to_owned(), "no file"),
    ] {
        let arguments = ["interior", input, "--out", out];
        assert_bad(&skyline(&arguments), names, &arguments);
    }
    assert!(
        !Path::new(&out).exists() && !has_drafts(&dir),
        "something was written"
    );
    assert_eq!(
        Glb::read(&input).bin,
        model().bin,
        "the model is what it was"
    );
}

/// A sequence of numbers that look random, the same every time (splitmix64).
struct Dice(u64);

impl Dice {
    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ x >> 31) % end.max(1) as u64) as usize
    }

    /// Changes something somewhere in a value.
    fn change(&mut self, value: &mut Value) {
        let inner = match value {
            Value::Array(values) => values.len(),
            Value::Object(values) => values.len(),
            _ => 0,
        };
        if inner > 0 && self.below(12) > 0 {
            let at = self.below(inner);
            match value {
                Value::Array(values) => self.change(&mut values[at]),
                Value::Object(values) => {
                    let key = values.keys().nth(at).expect("a key").clone();
                    if self.below(12) == 0 {
                        values.remove(&key);
                    } else {
                        self.change(&mut values[&key]);
                    }
                }
                _ => {}
            }
            return;
        }
        let small = self.below(20);
        let others = [
            json!(small),
            json!(small),
            json!(small),
            json!(-1),
            json!(u64::MAX),
            json!(u32::MAX),
            json!(1e30),
            json!(1e308),
            json!(0.5),
            json!(null),
            json!([]),
            json!({}),
            json!("SCALAR"),
            json!("data:;base64,AAAA"),
            json!([small, small, small]),
            json!(5120 + small),
        ];
        *value = others[self.below(others.len())].clone();
    }
}

#[test]
fn no_mutation_makes_it_panic() {
    let dir = directory();
    let model = rich_model();
    let settings = InteriorCulling {
        grid: InteriorGrid::Resolution(8),
        memory_mib: 16,
        ..Default::default()
    };
    let (input, out) = (dir.path().join("in.glb"), dir.path().join("out.glb"));
    let run = |bytes: &[u8]| {
        std::fs::write(&input, bytes).expect("a file can be written");
        trim(&input, &out, &settings, NonZero::<usize>::MIN)
    };
    run(&model.bytes()).expect("it is valid as it is");
    let mut dice = Dice(0x5eed);
    let (mut taken, mut refused) = (0, 0);
    for _ in 0..2_000 {
        let mut mutant = model.clone();
        let kind = dice.below(4);
        for _ in 0..=dice.below(3) {
            match kind {
                0 => {
                    let at = dice.below(mutant.bin.len());
                    mutant.bin[at] = dice.below(256) as u8;
                }
                _ => dice.change(&mut mutant.json),
            }
        }
        let mut bytes = if mutant.json.is_object() {
            mutant.bytes()
        } else {
            glb_of(b"null", &[])
        };
        if kind == 1 {
            for _ in 0..4 {
                let at = dice.below(bytes.len());
                bytes[at] = dice.below(256) as u8;
            }
            bytes.truncate(bytes.len() - dice.below(9) / 8 * dice.below(bytes.len()));
        }
        match run(&bytes) {
            Ok(_) => {
                taken += 1;
                // What it writes it can read; all may have been moved out of the scene, or be hidden by nothing.
                std::fs::copy(&out, &input).expect("it was written");
                let again = trim(&input, &out, &settings, NonZero::<usize>::MIN);
                assert!(again.is_ok(), "{}", again.expect_err("it failed"));
            }
            Err(error) => {
                refused += 1;
                let text = error.to_string();
                assert!(!text.contains('\n') && text.len() < 600, "{text}");
            }
        }
    }
    println!("{taken} taken, {refused} refused");
    assert!(
        taken > 200 && refused > 200,
        "{taken} taken, {refused} refused"
    );
}
