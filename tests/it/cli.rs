//! The `skyline` command, run as its users run it.

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

use image::{ImageBuffer, Luma};
use serde_json::Value;
use tempfile::TempDir;

pub fn skyline(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_skyline"))
        .args(arguments)
        .output()
        .expect("the command can be run")
}

pub fn directory() -> TempDir {
    tempfile::tempdir().expect("a directory can be made")
}

pub fn path(directory: &TempDir, name: &str) -> String {
    directory.path().join(name).display().to_string()
}

/// A 16-bit PNG of 33×17 samples of one code.
fn flat_map(directory: &TempDir, code: u16) -> String {
    let file = path(directory, "flat.png");
    ImageBuffer::<Luma<u16>, _>::from_pixel(33, 17, Luma([code]))
        .save(&file)
        .expect("a picture can be written");
    file
}

pub fn stdout_json(output: &Output) -> Value {
    assert!(
        output.status.success(),
        "{:?}: {}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).expect("stdout is JSON")
}

fn depths(file: &str) -> Vec<f32> {
    let bytes = std::fs::read(file).expect("the depth file is there");
    bytes
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect()
}

/// 33×17 samples 10 m apart, all 25 m high, seen from above the middle toward +X and down: every pixel's depth
/// follows from the plane it looks at.
#[test]
fn depth_of_a_flat_field_is_that_of_a_plane() {
    let dir = directory();
    let map = flat_map(&dir, 16_384);
    let (width, height) = (96usize, 54usize);
    let fov = 50f64;
    let eye = [-20.0, 70.0, 80.0];
    let target = [160.0, 30.0, 80.0];
    let range = "0,100";
    let plane = 16_384.0 / 65_535.0 * 100.0;
    for traversal in ["per-texel", "max-mip", "boxes", "hybrid"] {
        let (out, depth) = (path(&dir, "flat_out.png"), path(&dir, "flat.f32"));
        let printed = stdout_json(&skyline(&[
            "render",
            "--heightmap",
            &map,
            "--spacing",
            "10",
            "--height-range",
            range,
            "--eye",
            "-20,70,80",
            "--target",
            "160,30,80",
            "--size",
            "96x54",
            "--fov",
            "50",
            "--max-error-px",
            "0",
            "--traversal",
            traversal,
            "--out",
            &out,
            "--depth",
            &depth,
        ]));
        assert_eq!(printed["traversal"], traversal);
        let total = printed["gpu_ms"]["total"].as_f64();
        assert!(total >= printed["gpu_ms"]["ray_cast"].as_f64() && total > Some(0.0));
        assert_eq!(printed["size"], serde_json::json!([width, height]));
        let picture = image::open(&out).expect("the picture can be read");
        assert_eq!(
            (picture.width() as usize, picture.height() as usize),
            (width, height)
        );
        let depths = depths(&depth);
        assert_eq!(depths.len(), width * height);

        let sub = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
        let length = |a: [f64; 3]| a.iter().map(|v| v * v).sum::<f64>().sqrt();
        let ahead = sub(target, eye);
        let forward = ahead.map(|v| v / length(ahead));
        // Right is +Z: forward × up, up being +Y.
        let right = [-forward[2], 0.0, forward[0]];
        let right = right.map(|v| v / length(right));
        let up = [
            right[1] * forward[2] - right[2] * forward[1],
            right[2] * forward[0] - right[0] * forward[2],
            right[0] * forward[1] - right[1] * forward[0],
        ];
        let half = (fov.to_radians() / 2.0).tan();
        let (mut ground, mut sky, mut unsure) = (0, 0, 0);
        for y in 0..height {
            for x in 0..width {
                let across = ((x as f64 + 0.5) / width as f64 * 2.0 - 1.0) * half * width as f64
                    / height as f64;
                let upward = (1.0 - (y as f64 + 0.5) / height as f64 * 2.0) * half;
                let way: [f64; 3] =
                    std::array::from_fn(|i| forward[i] + across * right[i] + upward * up[i]);
                let got = f64::from(depths[y * width + x]);
                // Depth along −Z at which the ray meets the plane, and where that is.
                let t = (plane - eye[1]) / way[1];
                let at = [eye[0] + t * way[0], eye[2] + t * way[2]];
                let inside = |slack: f64| {
                    way[1] < 0.0
                        && at[0] > slack
                        && at[0] < 320.0 - slack
                        && at[1] > slack
                        && at[1] < 160.0 - slack
                };
                if inside(0.05) {
                    ground += 1;
                    assert!(
                        (got - t).abs() <= 1e-4 * t,
                        "{traversal} pixel {x},{y}: {got}, not {t}"
                    );
                } else if !inside(-0.05) && at[0] > 0.0 {
                    // Past the far and the side borders there is only sky (walls face away or are entered
                    // from in front, where at.x < 0).
                    let enters_side = eye[2] + (0.0 - eye[0]) / way[0] * way[2];
                    if (0.0..160.0).contains(&enters_side) {
                        sky += 1;
                        assert_eq!(got, f64::INFINITY, "{traversal} pixel {x},{y}");
                    }
                } else {
                    unsure += 1;
                }
            }
        }
        assert!(
            ground > 1000 && sky > 500,
            "{traversal}: {ground} ground, {sky} sky, {unsure} not compared"
        );
        assert_eq!(
            printed["terrain_px"].as_u64(),
            Some(depths.iter().filter(|d| d.is_finite()).count() as u64)
        );
    }
}

/// Straight down, −Z is up: the picture's top is the field's first row.
#[test]
fn looking_straight_down_has_rows_from_top_to_bottom() {
    let dir = directory();
    let map = path(&dir, "ramp.png");
    // Heights rise with the row, so that depth falls from top to bottom.
    ImageBuffer::<Luma<u16>, _>::from_fn(17, 17, |_, row| Luma([row as u16 * 4000]))
        .save(&map)
        .expect("a picture can be written");
    let (out, depth) = (path(&dir, "down.png"), path(&dir, "down.f32"));
    let output = skyline(&[
        "render",
        "--heightmap",
        &map,
        "--spacing",
        "10",
        "--height-range",
        "0,100",
        "--eye",
        "80,300,80",
        "--target",
        "80,0,80",
        "--size",
        "33x33",
        "--fov",
        "20",
        "--out",
        &out,
        "--depth",
        &depth,
    ]);
    let printed = stdout_json(&output);
    assert_eq!(printed["terrain_px"], 33 * 33);
    let depths = depths(&depth);
    let column: Vec<f32> = (0..33).map(|y| depths[y * 33 + 16]).collect();
    assert!(
        column.windows(2).all(|pair| pair[0] > pair[1]),
        "{column:?}"
    );
    assert_eq!(depths[16 * 33], depths[16 * 33 + 32], "rows are level");
}

#[test]
fn a_view_of_nothing_but_sky_is_a_picture_too() {
    let dir = directory();
    let map = flat_map(&dir, 100);
    let (out, depth) = (path(&dir, "sky.png"), path(&dir, "sky.f32"));
    let printed = stdout_json(&skyline(&[
        "render",
        "--heightmap",
        &map,
        "--spacing",
        "10",
        "--height-range",
        "0,100",
        "--eye",
        "-50,500,3",
        "--target",
        "-100,600,3",
        "--size",
        "40x30",
        "--out",
        &out,
        "--depth",
        &depth,
    ]));
    assert_eq!(printed["terrain_px"], 0);
    assert_eq!(printed["depth_range_m"], Value::Null);
    assert!(depths(&depth).iter().all(|d| *d == f32::INFINITY));
    let picture = image::open(&out)
        .expect("the picture can be read")
        .into_rgb8();
    assert!(
        picture
            .pixels()
            .all(|pixel| pixel == picture.get_pixel(0, 0))
    );
}

#[test]
fn a_sidecar_supplies_spacing_and_range_and_flags_overrule_it() {
    let dir = directory();
    let map = flat_map(&dir, 65_535);
    std::fs::write(
        path(&dir, "flat.json"),
        r#"{"width":33,"height":17,"metres_per_texel":7.5,"height_min_m":-20,"height_max_m":40,"note":"x"}"#,
    )
    .expect("a sidecar can be written");
    let out = path(&dir, "side.png");
    let rendered = |more: &[&str]| {
        let mut arguments = vec![
            "render",
            "--heightmap",
            &map,
            "--eye",
            "-100,200,3",
            "--target",
            "50,0,50",
            "--size",
            "32x18",
            "--out",
            &out,
        ];
        arguments.extend(more);
        stdout_json(&skyline(&arguments))
    };
    let printed = rendered(&[]);
    assert_eq!(
        (&printed["spacing_m"], &printed["height_range_m"][1]),
        (&7.5.into(), &40.0.into())
    );
    let printed = rendered(&["--spacing", "3", "--height-range", "-10,10"]);
    assert_eq!(
        (&printed["spacing_m"], &printed["height_range_m"][1]),
        (&3.0.into(), &10.0.into())
    );
}

#[test]
fn bad_input_is_told_in_one_line_and_exit_code_two() {
    let dir = directory();
    let map = flat_map(&dir, 1000);
    let colour = path(&dir, "colour.png");
    image::RgbImage::new(4, 4)
        .save(&colour)
        .expect("a picture can be written");
    let text = path(&dir, "text.png");
    std::fs::write(&text, "not a picture").expect("a file can be written");
    let missing = path(&dir, "missing.png");
    let nowhere = path(&dir, "no/such/place.png");
    let out = path(&dir, "out.png");
    let here = dir.path().display().to_string();
    let base = [
        ("--heightmap", map.as_str()),
        ("--eye", "-5,30,2"),
        ("--target", "50,0,50"),
        ("--size", "32x18"),
        ("--out", out.as_str()),
    ];
    // What is changed, to what, and what the message must name.
    let cases: &[(&str, &str, &str)] = &[
        ("--heightmap", &missing, "missing.png"),
        ("--heightmap", &colour, "colour"),
        ("--heightmap", &text, "PNG"),
        ("--heightmap", "flat.xyz", "xyz"),
        ("--eye", "50,0,50", "same point"),
        ("--eye", "1,nan,2", "finite"),
        ("--eye", "1,2", "3 numbers"),
        ("--eye", "1e39,2,3", "finite"),
        ("--target", "a,b,c", "3 numbers"),
        ("--size", "0x18", "0x18"),
        ("--size", "100000x18", "larger than this GPU"),
        ("--size", "big", "1280x720"),
        ("--fov", "0", "field of view"),
        ("--fov", "180", "field of view"),
        ("--fov", "-3", "field of view"),
        ("--sun", "10,95", "sun"),
        ("--sun", "10", "2 numbers"),
        ("--spacing", "-1", "positive"),
        ("--spacing", "0", "positive"),
        ("--height-range", "9,1", "height range"),
        ("--traversal", "teleport", "hybrid"),
        ("--box-texels", "2", "4 or more"),
        ("--max-error-px", "-1", "0 (exact) or more"),
        ("--out", &nowhere, "create it first"),
        ("--out", &here, "directory"),
        ("--depth", &nowhere, "create it first"),
        ("--colour", "red", "--colour"),
    ];
    for (flag, value, names) in cases {
        let mut arguments = vec!["render"];
        for (name, usual) in base {
            if name != *flag {
                arguments.extend([name, usual]);
            }
        }
        arguments.extend([flag, value]);
        assert_bad(&skyline(&arguments), names, &arguments);
        assert!(!Path::new(&out).exists(), "{arguments:?} wrote a picture");
    }
    assert_bad(&skyline(&["render"]), "--heightmap", &["render"]);
    assert_bad(
        &skyline(&["accuracy", "weather", "--out", &here]),
        "weather",
        &["accuracy"],
    );
    let file = path(&dir, "flat.png");
    assert_bad(
        &skyline(&["accuracy", "terrain", "--quick", "--out", &file]),
        "--out",
        &["accuracy"],
    );
}

pub fn assert_bad(output: &Output, names: &str, arguments: &[&str]) {
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
    assert_eq!(message.lines().count(), 1, "{arguments:?}: {message}");
    assert!(
        message.contains(names),
        "{arguments:?} should name {names:?}: {message}"
    );
    assert!(output.stdout.is_empty(), "{arguments:?} printed a result");
}

#[test]
fn help_and_version_succeed() {
    for arguments in [&["--help"][..], &["render", "--help"], &["--version"]] {
        let output = skyline(arguments);
        assert!(
            output.status.success() && !output.stdout.is_empty(),
            "{arguments:?}"
        );
    }
}

#[test]
fn a_quick_accuracy_run_leaves_valid_files() {
    let dir = directory();
    let out = dir.path().join("accuracy");
    let summary = stdout_json(&skyline(&[
        "accuracy",
        "terrain",
        "--quick",
        "--out",
        &out.display().to_string(),
    ]));
    assert_eq!(summary["effect"], "terrain");
    let read = |name: &str| std::fs::read_to_string(out.join(name)).expect("the file is there");

    let lines: Vec<Value> = read("results.jsonl")
        .lines()
        .map(|line| serde_json::from_str(line).expect("a line is JSON"))
        .collect();
    assert_eq!(summary["results"].as_u64(), Some(lines.len() as u64));
    let mut seen = std::collections::BTreeSet::new();
    for line in &lines {
        assert_eq!(line["effect"], "terrain");
        let setting = &line["setting"];
        seen.insert(setting["traversal"].as_str().unwrap_or_default().to_owned());
        let time = |name: &str| line["time_ms"][name].as_f64().expect("a number");
        assert!(
            time("min") > 0.0 && time("min") <= time("median") && time("median") <= time("max")
        );
        assert!(line["time_ms"]["runs"].as_u64() >= Some(1));
        assert!(
            line["adapter"]
                .as_str()
                .is_some_and(|name| !name.is_empty())
        );
        assert!(line["reads"]["mean"].as_f64() > Some(0.5), "{line}");
        let error = &line["error"];
        let allowed = setting["max_error_px"].as_f64().expect("a number");
        if allowed == 0.0 {
            assert_eq!(error["coverage_errors_px"], 0, "{line}");
            assert_eq!(error["flip_mean"], 0.0, "{line}");
        }
        // A thousandth of a pixel for the rounding of what exact rays hit.
        assert!(
            error["depth_error_px_p999"].as_f64() <= Some(allowed + 1e-3),
            "{line}"
        );
        assert!(
            error["silhouette_px_max"].as_f64() <= Some(allowed.ceil() + 1.5),
            "{line}"
        );
    }
    let all = ["boxes", "hybrid", "max-mip", "per-texel"].map(str::to_owned);
    assert_eq!(seen, std::collections::BTreeSet::from(all));

    let csv = read("results.csv");
    let columns = csv.lines().next().expect("a head").split(',').count();
    assert_eq!(csv.lines().count(), lines.len() + 1);
    assert!(
        csv.lines()
            .all(|line| line.contains('"') || line.split(',').count() == columns)
    );

    let html = read("index.html");
    let adapter = lines[0]["adapter"].as_str().expect("a name");
    assert!(html.contains(adapter) && html.contains("UTC"));
    let pictures: Vec<PathBuf> = summary["files"]
        .as_array()
        .expect("a list")
        .iter()
        .filter_map(|file| Some(PathBuf::from(file.as_str()?)))
        .collect();
    for file in &pictures {
        assert!(file.exists(), "{} was not written", file.display());
        if file.extension().is_some_and(|extension| extension == "png") {
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
    }
    assert!(pictures.len() >= 14, "{pictures:?}");
    assert!(read("table.md").contains("| traversal |"));
}
