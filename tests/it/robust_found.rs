//! What fuzzing found, each by its name: files and numbers that once made the product panic, take vast memory, write
//! what nobody can read, or speak in more than a line.

use core::num::NonZero;
use std::{path::Path, sync::Arc};

use bevy::math::DAffine3;
use bevy_skyline::{
    interior::{
        InteriorCulling, InteriorError, InteriorGrid, Model, Part, Progress, Surface, cull,
    },
    offline::{
        interior::{read_model, trim},
        scenes::{SceneError, city},
    },
    terrain::{HeightFieldSettings, decode_height_field},
};
use serde_json::json;
use tiff::encoder::{Compression, colortype};

use crate::{
    allocations::largest,
    cli::directory,
    fuzz::one_line,
    glb::Glb,
    loader::{noise, tiff, tiled_tiff16},
};

/// Where in a little-endian TIFF the entry of a tag is.
fn entry(file: &[u8], tag: u16) -> usize {
    let directory = u32::from_le_bytes([file[4], file[5], file[6], file[7]]) as usize;
    let count = usize::from(u16::from_le_bytes([file[directory], file[directory + 1]]));
    (0..count)
        .map(|i| directory + 2 + 12 * i)
        .find(|at| file[*at..at + 2] == tag.to_le_bytes())
        .expect("it has the tag")
}

/// What the loader says of a TIFF, and the most that it took at once. units: bytes
fn refusal(file: &[u8]) -> (String, usize) {
    let (made, bytes) =
        largest(|| decode_height_field("tif", file, &HeightFieldSettings::default(), None));
    let text = made.expect_err("it cannot be read").to_string();
    assert_eq!(one_line(&text), Ok(()));
    (text, bytes)
}

#[test]
fn a_tiff_entry_longer_than_its_file_takes_no_room() {
    let whole = tiff::<colortype::Gray16>(9, 7, &noise(63), Compression::Uncompressed, None);
    // A decoder that is not told before makes room for 32 bytes a value.
    for tag in [273, 279] {
        let mut file = whole.clone();
        let at = entry(&file, tag) + 4;
        file[at..at + 4].copy_from_slice(&2_000_000u32.to_le_bytes());
        let (text, bytes) = refusal(&file);
        assert!(text.contains("an entry of"), "{text}");
        assert!(bytes < 64 << 10, "{bytes} bytes");
    }
}

#[test]
fn a_tile_far_larger_than_its_file_takes_no_room() {
    let mut file = tiled_tiff16(9, 7, 16, &noise(63));
    for (tag, number) in [(322, 8_192u32), (323, 8_192), (325, 8_192 * 8_192 * 2 - 1)] {
        let at = entry(&file, tag) + 8;
        file[at..at + 4].copy_from_slice(&number.to_le_bytes());
    }
    let (_, bytes) = refusal(&file);
    assert!(bytes <= 4096 * file.len(), "{bytes} bytes");
}

#[test]
fn what_a_decoder_says_is_cut_to_a_line() {
    let mut file = tiff::<colortype::Gray16>(9, 7, &noise(63), Compression::Uncompressed, None);
    // Forty kinds of samples, each a number of the picture.
    let at = entry(&file, 339);
    file[at + 4..at + 12].copy_from_slice(&[40, 0, 0, 0, 8, 0, 0, 0]);
    let (text, _) = refusal(&file);
    assert!(text.contains('…') && text.len() < 400, "{text}");
}

/// A box with a name, saved.
fn save(dir: &Path, change: impl FnOnce(&mut Glb)) -> std::path::PathBuf {
    let mut model = Glb::new();
    let mesh = model.boxes("a\nb", &[([0.0; 3], 1.0)]);
    model.node(json!({ "name": "c\td", "mesh": mesh }), true);
    change(&mut model);
    let path = dir.join("in.glb");
    model.save(&path);
    path
}

#[test]
fn a_name_with_a_line_break_stays_in_its_line() {
    let dir = directory();
    let said = |change: fn(&mut Glb)| {
        let path = save(dir.path(), change);
        let text = read_model(&path, 16).expect_err("it is broken").to_string();
        assert_eq!(one_line(&text), Ok(()));
        text
    };
    let text = said(|model| model.json["accessors"][2]["componentType"] = json!(5122));
    assert!(text.contains("mesh 0 (a\\nb)"), "{text}");
    let text = said(|model| model.json["nodes"][0]["children"] = json!([0]));
    assert!(text.contains("node 0 (c\\td)"), "{text}");
    let text = said(|model| model.json["extensionsRequired"] = json!(["e\rf"]));
    assert!(text.contains("e\\rf"), "{text}");
}

#[test]
fn a_sparse_part_of_nothing_is_taken_out() {
    let dir = directory();
    let path = save(dir.path(), |model| {
        model.json["accessors"][0]["sparse"] = json!({
            "count": 0,
            "indices": { "bufferView": 2, "componentType": 5123 },
            "values": { "bufferView": 0 },
        });
    });
    let out = dir.path().join("out.glb");
    let settings = InteriorCulling {
        grid: InteriorGrid::Resolution(8),
        ..Default::default()
    };
    let before = read_model(&path, 16)
        .expect("it can be read")
        .triangle_count();
    let trimmed = trim(&path, &out, &settings, NonZero::<usize>::MIN);
    assert_eq!(
        trimmed
            .expect("nothing is wrong with it")
            .figures
            .kept_triangles,
        before
    );
    let after = read_model(&out, 16).expect("what was written can be read");
    assert_eq!(after.triangle_count(), before);
    assert!(Glb::read(&out).json["accessors"][0].get("sparse").is_none());
}

#[test]
fn a_model_too_far_away_to_calculate_with_is_refused() {
    let surface = Arc::new(Surface {
        positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        triangles: vec![[0, 1, 2]],
    });
    let at = |scale: f64| Model {
        parts: vec![Part {
            node: 3,
            surface: surface.clone(),
            model_from_local: DAffine3::from_scale(bevy::math::DVec3::splat(scale)),
            is_transparent: false,
            is_two_sided: true,
        }],
    };
    let settings = InteriorCulling {
        grid: InteriorGrid::Resolution(8),
        ..Default::default()
    };
    let found = |scale| {
        cull(
            &at(scale),
            &settings,
            NonZero::<usize>::MIN,
            &Progress::default(),
        )
    };
    for scale in [1e-100, 1.0, 1e99] {
        assert!(found(scale).is_ok(), "{scale:e}");
    }
    for scale in [1e101, 1.7e308, f64::INFINITY, f64::NAN] {
        let error = found(scale).expect_err("it is nowhere");
        assert_eq!(
            error,
            InteriorError::NotFinite { part: 0, node: 3 },
            "{scale:e}"
        );
    }
}

/// Each of these made the reader of cities panic, or never end.
#[test]
fn a_city_that_is_broken_is_refused() {
    let dir = directory();
    type Damage = fn(&mut Glb);
    let broken: [(&str, Damage); 6] = [
        ("among its 0 accessors", |model| {
            model.json["accessors"] = json!([])
        }),
        ("\"accessors\" are not a list", |model| {
            model.json["accessors"] = json!([7])
        }),
        ("below itself", |model| {
            model.json["nodes"][0]["children"] = json!([0])
        }),
        ("has an index", |model| {
            model.json["accessors"][0]["count"] = json!(1)
        }),
        ("reaches out", |model| {
            model.json["accessors"][0]["byteOffset"] = json!(u64::MAX);
        }),
        ("scale the city", |model| {
            model.json["nodes"][0]["scale"] = json!([1e6, 1, 1e6])
        }),
    ];
    for (word, change) in broken {
        let path = save(dir.path(), |model| {
            // Positions alone, so that nothing else is wrong.
            let attributes = &mut model.json["meshes"][0]["primitives"][0]["attributes"];
            attributes
                .as_object_mut()
                .expect("an object")
                .remove("NORMAL");
            change(model);
        });
        let text = city::from_file(&path).expect_err(word).to_string();
        assert_eq!(one_line(&text), Ok(()));
        assert!(text.contains(word), "{word}: {text}");
    }
    // Nothing to see is no city either.
    let path = save(dir.path(), |model| {
        for accessor in 0..3 {
            model.json["accessors"][accessor]["count"] = json!(0);
        }
    });
    let error = city::from_file(&path).expect_err("there is nothing in it");
    assert!(matches!(error, SceneError::NoBuildings { .. }), "{error}");
    // And one that is sound is one.
    let city = city::from_file(&save(dir.path(), |_| {})).expect("it is sound");
    assert!(city.objects.len() >= 2);
}
