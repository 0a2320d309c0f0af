//! `skyline accuracy all`, `growth` and `idle`: what they refuse, and what nothing costs, by count.

use std::process::Command;

use bevy::math::UVec2;
use bevy_skyline::offline::accuracy::idle;

#[test]
fn a_scene_that_uses_nothing_runs_no_pass_and_holds_nothing() {
    if crate::device().is_none() {
        return;
    }
    let out = tempfile::tempdir().unwrap();
    let plan = idle::Plan {
        objects: UVec2::new(6, 5),
        frames: 12,
    };
    let summary = idle::measure(&plan, out.path()).unwrap();
    let lines = summary.highlights.as_array().unwrap();
    let names: Vec<_> = lines
        .iter()
        .map(|line| line["setting"]["plugins"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["none", "none, again", "skyline"]);
    for line in lines {
        assert_eq!(line["time_ms"]["runs"], 12, "{line}");
        assert_eq!(line["more_passes"], 0, "{line}");
        assert_eq!(line["gpu_bytes"], 0, "{line}");
        assert_eq!(line["awake"].as_array().unwrap().len(), 0, "{line}");
    }
    println!(
        "{}: ratio {}, of a second app without the plugins {}",
        summary.adapter, lines[2]["ratio"], lines[1]["ratio"]
    );
}

#[test]
fn flags_of_one_effect_are_refused_in_one_line() {
    let out = tempfile::tempdir().unwrap();
    let refuses = |effect: &str, flags: &[&str], names: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_skyline"))
            .args(["accuracy", effect, "--out"])
            .arg(out.path().join("never"))
            .args(flags)
            .output()
            .unwrap();
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{effect} {flags:?}: {error}");
        assert_eq!(error.lines().count(), 1, "{error}");
        assert!(error.contains(names), "{error}");
        assert!(output.stdout.is_empty());
    };
    for effect in ["growth", "idle"] {
        refuses(effect, &["--city", "a.glb"], "--quick and --out");
        refuses(effect, &["--rounds", "2"], "--quick and --out");
        refuses(effect, &["--spacing", "2"], "make their own scenes");
    }
    refuses("all", &["--few-settings"], "all takes --heightmap");
    refuses("all", &["--path-frames", "9"], "all takes --heightmap");
    let two = ["--model", "a.obj", "--model", "b.OBJ"];
    refuses("all", &two, "one .obj --model");
    refuses("all", &["--spacing", "2"], "none is given");
    refuses("all", &["--heightmap", "no/such.png"], "no/such.png");
    assert!(!out.path().join("never").exists());
}
