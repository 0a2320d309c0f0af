//! `skyline shadow` and `skyline accuracy shadow`, run as their users run them.

use std::path::{Path, PathBuf};

use bevy::math::{DAffine3, DVec3, UVec2};
use bevy_skyline::{
    offline::accuracy::{
        scene::mountains,
        shadow::plain::{PlainEnd, PlainField},
    },
    reference::terrain_shadow::{ShadowTally, ShadowTwin},
    terrain::HeightSamples,
    terrain_shadow::light::GridLight,
};
use image::{GrayImage, ImageBuffer, Luma};
use serde_json::Value;
use tempfile::TempDir;

use crate::cli::{assert_bad, directory, path, skyline, stdout_json};

/// A 16-bit PNG of `size` samples; code 65535 is 100 m with [`RANGE`].
fn map_of(dir: &TempDir, name: &str, size: (u32, u32), code: impl Fn(u32, u32) -> u16) -> String {
    let file = path(dir, name);
    ImageBuffer::<Luma<u16>, _>::from_fn(size.0, size.1, |column, row| Luma([code(column, row)]))
        .save(&file)
        .expect("a picture can be written");
    file
}

const RANGE: &str = "0,100";

/// Runs `skyline shadow` over samples 10 m apart.
fn shadow(map: &str, out: &str, more: &[&str]) -> (Value, GrayImage) {
    let mut arguments = vec!["shadow", "--heightmap", map, "--spacing", "10"];
    arguments.extend(["--height-range", RANGE, "--out", out]);
    arguments.extend(more);
    let printed = stdout_json(&skyline(&arguments));
    let picture = image::open(out).expect("the map can be read");
    assert!(
        matches!(picture, image::DynamicImage::ImageLuma8(_)),
        "8-bit grey"
    );
    (printed, picture.into_luma8())
}

fn dark(map: &GrayImage) -> Vec<(u32, u32)> {
    map.enumerate_pixels()
        .filter(|(_, _, pixel)| pixel[0] == 0)
        .map(|(x, y, _)| (x, y))
        .collect()
}

/// A spike 100 m high on samples 10 m apart, the sun 45° high: straight away from the sun, 9 samples lie in its
/// shadow and the tenth sees the sun just over the tip. Those beside do not: the spike's sides fall to nothing there.
#[test]
fn a_spikes_shadow_falls_away_from_the_sun_and_is_as_long_as_it_must_be() {
    let dir = directory();
    let (width, height, spike) = (33u32, 27u32, (17u32, 12u32));
    let map = map_of(&dir, "spike.png", (width, height), |column, row| {
        if (column, row) == spike { 65_535 } else { 0 }
    });
    let out = path(&dir, "shadow.png");
    // 45.1°: the tip's own shadow falls a little short of the tenth sample, whatever the rounding.
    for (azimuth, away) in [(0, (0, -1)), (90, (-1, 0)), (180, (0, 1)), (270, (1, 0))] {
        let expected: Vec<(i32, i32)> = (1..=9)
            .map(|n| (spike.0 as i32 + n * away.0, spike.1 as i32 + n * away.1))
            .collect();
        for method in ["per-texel", "max-mip", "sweep"] {
            let sun = format!("{azimuth},45.1");
            let (printed, picture) = shadow(&map, &out, &["--sun", &sun, "--method", method]);
            let mut got: Vec<(i32, i32)> = dark(&picture)
                .iter()
                .map(|(x, y)| (*x as i32, *y as i32))
                .collect();
            let mut expected = expected.clone();
            got.sort_unstable();
            expected.sort_unstable();
            assert_eq!(got, expected, "{method} at azimuth {azimuth}");
            assert_eq!(printed["method"], method);
            assert_eq!(printed["size"], serde_json::json!([width, height]));
            assert_eq!(printed["sun"]["azimuth_deg"], f64::from(azimuth));
            assert_eq!(printed["sun"]["elevation_deg"], 45.1);
            assert_eq!(printed["light"], Value::Null);
            let lit = 1.0 - 9.0 / f64::from(width * height);
            let told = printed["lit_fraction"].as_f64().expect("a number");
            assert!((told - lit).abs() < 1e-9, "{told}, not {lit}");
            let time = |name: &str| printed["time_ms"][name].as_f64().expect("a number");
            assert!(time("min") > 0.0 && time("min") <= time("median"));
            assert!(
                printed["adapter"]
                    .as_str()
                    .is_some_and(|name| !name.is_empty())
            );
        }
    }
}

/// A wall 50 m high along column 20, a light 100 m high over column 10: beyond the wall the shadow reaches as far
/// again as the light is before it, to column 30.
#[test]
fn a_light_is_where_it_was_put() {
    let dir = directory();
    let map = map_of(&dir, "wall.png", (41, 9), |column, _| {
        if column == 20 { 32_768 } else { 0 }
    });
    let out = path(&dir, "shadow.png");
    for method in ["per-texel", "max-mip"] {
        let (printed, picture) = shadow(
            &map,
            &out,
            &["--light", "100,100.05,40", "--method", method],
        );
        for (column, row) in (0..41).flat_map(|x| (0..9).map(move |y| (x, y))) {
            let seen = picture.get_pixel(column, row)[0];
            let expected = if (21..30).contains(&column) { 0 } else { 255 };
            assert_eq!(seen, expected, "{method} at {column},{row}");
        }
        assert_eq!(
            printed["light"]["position_m"],
            serde_json::json!([100.0, 100.05, 40.0])
        );
        assert_eq!(printed["sun"], Value::Null);
    }
    // A sweep goes away from a sun; for a light max-mip takes its place, and that is said.
    let mut arguments = vec!["shadow", "--heightmap", &map, "--spacing", "10"];
    arguments.extend(["--height-range", RANGE, "--out", &out]);
    arguments.extend(["--light", "100,100.05,40", "--method", "sweep"]);
    let output = skyline(&arguments);
    assert_eq!(stdout_json(&output)["method"], "max-mip");
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(
        told.lines().count() == 1 && told.contains("max-mip"),
        "{told}"
    );
}

#[test]
fn a_large_sun_has_a_penumbra_and_a_hard_one_none() {
    let dir = directory();
    let map = map_of(&dir, "wall.png", (65, 9), |column, _| {
        if column == 20 { 65_535 } else { 0 }
    });
    let out = path(&dir, "shadow.png");
    let greys = |picture: &GrayImage| {
        let is_grey = |value: u8| value != 0 && value != 255;
        picture.pixels().filter(|pixel| is_grey(pixel[0])).count()
    };
    let (printed, picture) = shadow(&map, &out, &["--sun", "270,30"]);
    assert_eq!((greys(&picture), printed["strips"].as_u64()), (0, Some(0)));
    let wide = ["--sun", "270,30", "--angular-size", "10"];
    let (printed, picture) = shadow(&map, &out, &wide);
    assert!(greys(&picture) > 9, "{}", greys(&picture));
    assert_eq!(printed["strips"], 16);
    assert_eq!(printed["sun"]["angular_size_deg"], 10.0);
    // Away from the wall the light can only grow.
    let row: Vec<u8> = (21..65).map(|x| picture.get_pixel(x, 4)[0]).collect();
    assert!(row.windows(2).all(|pair| pair[0] <= pair[1]), "{row:?}");
    let lamp = ["--light", "-300,300,40", "--radius", "30", "--strips", "4"];
    let (printed, picture) = shadow(&map, &out, &lamp);
    assert!(greys(&picture) > 9, "{}", greys(&picture));
    assert_eq!(
        (&printed["strips"], &printed["light"]["radius_m"]),
        (&4.into(), &30.0.into())
    );
}

#[test]
fn a_sidecar_supplies_what_flags_do_not() {
    let dir = directory();
    let map = map_of(&dir, "side.png", (5, 4), |column, _| column as u16);
    std::fs::write(
        path(&dir, "side.json"),
        r#"{"metres_per_texel":7.5,"height_min_m":-20,"height_max_m":40}"#,
    )
    .expect("a sidecar can be written");
    let out = path(&dir, "out.png");
    let base = [
        "shadow",
        "--heightmap",
        &map,
        "--sun",
        "0,90",
        "--out",
        &out,
    ];
    let printed = stdout_json(&skyline(&base));
    assert_eq!(printed["spacing_m"], 7.5);
    assert_eq!(
        (&printed["size"], &printed["lit_fraction"]),
        (&serde_json::json!([5, 4]), &1.0.into())
    );
    let printed = stdout_json(&skyline(&[&base[..], &["--spacing", "3"]].concat()));
    assert_eq!(printed["spacing_m"], 3.0);
}

#[test]
fn bad_input_of_shadow_is_told_in_one_line_and_exit_code_two() {
    let dir = directory();
    let map = map_of(&dir, "flat.png", (5, 5), |_, _| 1000);
    let missing = path(&dir, "missing.png");
    let nowhere = path(&dir, "no/such/place.png");
    let here = dir.path().display().to_string();
    let out = path(&dir, "out.png");
    let sun = ["--sun", "10,20"];
    let light = ["--light", "1,2,3"];
    // What is given beside the height map and --out, and what the message must name.
    let cases: &[(&[&str], &str)] = &[
        (&[], "--sun AZ,EL or --light X,Y,Z"),
        (&[sun, light].concat(), "one of them"),
        (&["--sun", "10"], "2 numbers"),
        (&["--sun", "nan,20"], "finite"),
        (&["--sun", "10,inf"], "finite"),
        (&["--sun", "10,90.5"], "-90 to 90"),
        (&["--sun", "10,-91"], "-90 to 90"),
        (&["--light", "1,2"], "3 numbers"),
        (&["--light", "1,inf,3"], "finite"),
        (&["--light", "1,1e300,3"], "finite"),
        (&["--sun", "10,20", "--angular-size", "-1"], "less than 90"),
        (&["--sun", "10,20", "--angular-size", "90"], "less than 90"),
        (&["--sun", "10,20", "--angular-size", "nan"], "finite"),
        (&["--sun", "10,20", "--radius", "2"], "--angular-size"),
        (
            &["--light", "1,2,3", "--radius", "-1"],
            "0 (hard shadows) or more",
        ),
        (&["--light", "1,2,3", "--angular-size", "2"], "--radius"),
        (
            &["--sun", "10,20", "--angular-size", "2", "--strips", "0"],
            "1 to 16",
        ),
        (
            &["--sun", "10,20", "--angular-size", "2", "--strips", "17"],
            "1 to 16",
        ),
        (&["--sun", "10,20", "--strips", "4"], "--angular-size"),
        (&["--sun", "10,20", "--method", "magic"], "sweep"),
        (&["--sun", "10,20", "--colour", "red"], "--colour"),
        (&["--sun", "10,20", "--spacing", "0"], "positive"),
        (&["--sun", "10,20", "--height-range", "9,1"], "height range"),
    ];
    for (given, names) in cases {
        let mut arguments = vec!["shadow", "--heightmap", &map, "--out", &out];
        arguments.extend(*given);
        assert_bad(&skyline(&arguments), names, &arguments);
    }
    for (map, out, names) in [
        (&missing, &out, "missing.png"),
        (&map, &nowhere, "create it first"),
        (&map, &here, "directory"),
    ] {
        let mut arguments = vec!["shadow", "--heightmap", map, "--out", out];
        arguments.extend(sun);
        assert_bad(&skyline(&arguments), names, &arguments);
    }
    assert!(!Path::new(&out).exists(), "a map was written");
    assert_bad(
        &skyline(&["accuracy", "shadow", "--quick", "--out", &map]),
        "--out",
        &["accuracy"],
    );
}

/// The CPU's plain loop gives the twin's map, outside of the guard band.
#[test]
fn the_plain_loop_agrees_with_the_twin() {
    let field = mountains(65).expect("a field can be made");
    let HeightSamples::U16(codes) = field.samples() else {
        panic!("the mountains are 16-bit");
    };
    let heights: Vec<f32> = codes.iter().map(|code| f32::from(*code)).collect();
    let size = field.size();
    let plain = PlainField {
        heights: &heights,
        width: size.x as usize,
        height: size.y as usize,
    };
    let twin = ShadowTwin::new(field.samples(), size);
    let mut tally = ShadowTally::default();
    for (azimuth, elevation) in [
        (235f64, 45f64),
        (17.0, 20.0),
        (90.0, 10.0),
        (180.0, 5.0),
        (135.0, 1.0),
    ] {
        let (azimuth, elevation) = (azimuth.to_radians(), elevation.to_radians());
        // Straight along an axis where it was meant so.
        let snap = |v: f64| if v.abs() < 1e-12 { 0.0 } else { v };
        let to_sun = DVec3::new(snap(azimuth.sin()), elevation.tan(), snap(azimuth.cos()));
        let light = GridLight::directional(to_sun, 0.0, field.local_from_grid());
        let direction = light
            .ray(DVec3::ZERO)
            .expect("it is not straight above")
            .direction;
        let (map, all) = plain.cast(direction.to_array(), PlainEnd::Border);
        let (same, fewer) = plain.cast(direction.to_array(), PlainEnd::AboveAll);
        assert!(map == same && fewer < all, "{fewer} cells of {all}");
        for index in 0..size.x * size.y {
            let at = UVec2::new(index % size.x, index / size.x);
            tally.check(at, twin.judge(&light, at), map[index as usize]);
        }
    }
    tally.assert_ok(0.01);
    assert!(tally.lit > 1_000 && tally.dark > 1_000, "{tally:?}");
    // A comparison that cannot fail is none: the same map of another sun.
    let sun = |y: f64| GridLight::directional(DVec3::new(1.0, y, 0.3), 0.0, DAffine3::IDENTITY);
    let low = sun(400.0).ray(DVec3::ZERO).expect("a ray").direction;
    let (map, _) = plain.cast(low.to_array(), PlainEnd::Border);
    let mut wrong = ShadowTally::default();
    for index in 0..size.x * size.y {
        let at = UVec2::new(index % size.x, index / size.x);
        wrong.check(at, twin.judge(&sun(1200.0), at), map[index as usize]);
    }
    assert!(wrong.verdict(0.01).is_err());
}

#[test]
fn a_quick_accuracy_run_of_shadows_leaves_valid_files() {
    let dir = directory();
    let out = dir.path().join("accuracy");
    let map = map_of(&dir, "hills.png", (65, 65), |column, row| {
        let (x, z) = (f64::from(column) * 0.21, f64::from(row) * 0.17);
        (20_000.0 * (1.5 + x.sin() * z.cos() + 0.4 * (2.7 * x + z).sin())) as u16
    });
    let summary = stdout_json(&skyline(&[
        "accuracy",
        "shadow",
        "--quick",
        "--heightmap",
        &map,
        "--spacing",
        "10",
        "--height-range",
        RANGE,
        "--out",
        &out.display().to_string(),
    ]));
    assert_eq!(summary["effect"], "shadow");
    let read = |name: &str| std::fs::read_to_string(out.join(name)).expect("the file is there");
    let lines: Vec<Value> = read("results.jsonl")
        .lines()
        .map(|line| serde_json::from_str(line).expect("a line is JSON"))
        .collect();
    assert_eq!(summary["results"].as_u64(), Some(lines.len() as u64));
    let mut seen = std::collections::BTreeSet::new();
    let (mut judged, mut in_penumbra) = (0, 0);
    for line in &lines {
        assert_eq!(line["effect"], "shadow");
        let method = line["setting"]["method"].as_str().expect("a name");
        seen.insert(method.to_owned());
        let time = |name: &str| line["time_ms"][name].as_f64().expect("a number");
        assert!(
            time("min") > 0.0 && time("min") <= time("median") && time("median") <= time("max")
        );
        assert!(
            line["adapter"]
                .as_str()
                .is_some_and(|name| !name.is_empty())
        );
        let error = &line["error"];
        let lit = error["lit_fraction"].as_f64().expect("a number");
        assert!(lit > 0.0 && lit < 1.0, "{line}");
        if let Some(wrong) = error["wrong_texels"].as_u64() {
            judged += error["judged_texels"].as_u64().expect("a number");
            assert!(method == "sweep" || wrong == 0, "{line}");
        } else {
            in_penumbra += error["penumbra_texels"].as_u64().expect("a number");
            // A sweep is off by half a cell, where a penumbra is a cell or two wide.
            let most = if method == "sweep" { 0.4 } else { 0.1 };
            let rms = error["penumbra_rms"].as_f64();
            assert!(rms.is_none_or(|rms| rms < most), "{line}");
        }
    }
    let all = ["max-mip", "per-texel", "plain", "plain-above-all", "sweep"].map(str::to_owned);
    assert_eq!(seen, std::collections::BTreeSet::from(all));
    assert!(
        judged > 10_000 && in_penumbra > 100,
        "{judged} and {in_penumbra}"
    );

    let csv = read("results.csv");
    assert_eq!(csv.lines().count(), lines.len() + 1);
    let html = read("index.html");
    let files: Vec<PathBuf> = summary["files"]
        .as_array()
        .expect("a list")
        .iter()
        .filter_map(|file| Some(PathBuf::from(file.as_str()?)))
        .collect();
    let mut pictures = 0;
    for file in &files {
        assert!(file.exists(), "{} was not written", file.display());
        if file.extension().is_none_or(|extension| extension != "png") {
            continue;
        }
        pictures += 1;
        let picture = image::open(file)
            .expect("a picture can be read")
            .into_rgb8();
        let first = picture.get_pixel(0, 0);
        assert!(
            picture.pixels().any(|pixel| pixel != first),
            "{} is blank",
            file.display()
        );
        let name = file
            .file_name()
            .expect("a name")
            .to_string_lossy()
            .into_owned();
        assert!(html.contains(&name), "the page does not show {name}");
    }
    assert!(pictures >= 7, "{files:?}");
    for name in [
        "maps.png",
        "blinn_phong_and_pbr.png",
        "time_size_45.png",
        "time_elevation.png",
    ] {
        assert!(out.join(name).exists(), "{name} is missing");
    }
    assert!(read("table.md").contains("CPU:max-mip"));
}
