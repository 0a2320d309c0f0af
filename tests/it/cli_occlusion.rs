//! `skyline accuracy occlusion`, run as its users run it.

use serde_json::Value;

use crate::cli::{assert_bad, directory, path, skyline, stdout_json};

#[test]
fn a_quick_run_on_the_smallest_scene_leaves_valid_files() {
    let dir = directory();
    let out = path(&dir, "occlusion");
    let arguments = [
        "accuracy",
        "occlusion",
        "--quick",
        "--scenes",
        "bunnies",
        "--path-frames",
        "3",
        "--out",
        &out,
    ];
    let summary = stdout_json(&skyline(&arguments));
    assert_eq!(summary["effect"], "occlusion");
    let read = |name: &str| {
        std::fs::read_to_string(dir.path().join("occlusion").join(name)).expect("the file is there")
    };
    let lines: Vec<Value> = read("results.jsonl")
        .lines()
        .map(|line| serde_json::from_str(line).expect("a line is JSON"))
        .collect();
    assert_eq!(summary["results"].as_u64(), Some(lines.len() as u64));
    let mut cullings = std::collections::BTreeSet::new();
    for line in &lines {
        let culling = line["setting"]["culling"].as_str().unwrap_or_default();
        cullings.insert(culling.to_owned());
        assert!(line["time_ms"]["median"].as_f64() > Some(0.0), "{line}");
        assert!(line["objects"]["all"].as_u64() == Some(9), "{line}");
        if culling == "none" {
            assert_eq!(line["objects"]["drawn"], 9.0, "{line}");
            assert_eq!(line["error"]["false_cull_px"], 0, "{line}");
        }
    }
    let all: Vec<_> = cullings.iter().map(String::as_str).collect();
    assert_eq!(
        all,
        ["bevy", "frustum", "none", "z-buffer", "z-buffer-prepass"]
    );
    assert_eq!(read("results.csv").lines().count(), lines.len() + 1);
    assert!(read("index.html").contains("/front"));
    let walks: Vec<_> = lines
        .iter()
        .filter(|line| line["scene"].as_str().is_some_and(|s| s.ends_with("/walk")))
        .collect();
    assert!(!walks.is_empty() && walks.iter().all(|line| line["frames"] == 3));
    let highlights = &summary["highlights"];
    assert_eq!(highlights["false_cull_px"], 0, "{highlights}");
    assert!(highlights["frames"].as_u64() > Some(0), "{highlights}");
    let against = highlights["against_bevy"].as_array().expect("an array");
    assert!(
        against
            .iter()
            .any(|row| row["drawn_z_buffer"].as_f64() > Some(0.0)
                && row["drawn_z_buffer_prepass"].as_f64() > Some(0.0)),
        "{highlights}"
    );
    let visible = highlights["everything_visible"].as_array();
    for line in visible.expect("an array") {
        assert!(line["resting_to_frustum"].as_f64() > Some(0.0), "{line}");
        assert_eq!(line["frustum_ms"]["runs"], 20, "{line}");
    }
    for cost in highlights["main_world"].as_array().expect("an array") {
        assert!(
            cost["check_visibility_ms"]["median"].as_f64() > Some(0.0),
            "{cost}"
        );
    }
}

#[test]
fn bad_input_is_named() {
    let dir = directory();
    let out = path(&dir, "occlusion");
    let missing = path(&dir, "none.obj");
    let with = |flags: &[&str], names: &str| {
        let base = ["accuracy", "occlusion", "--quick", "--out", &out];
        let arguments: Vec<&str> = base.iter().chain(flags).copied().collect();
        assert_bad(&skyline(&arguments), names, &arguments);
    };
    with(&["--scenes", "bunnies", "--model", &missing], "none.obj");
    with(&["--scenes", "city", "--city", &missing], "none.obj");
    with(&["--scenes", "forest"], "forest");
    with(&["--heightmap", &missing], "--heightmap");
    with(&["--path-frames", "0"], "--path-frames");
    let arguments = [
        "accuracy", "terrain", "--quick", "--out", &out, "--city", &missing,
    ];
    assert_bad(&skyline(&arguments), "--city", &arguments);
    let arguments = [
        "accuracy",
        "shadow",
        "--quick",
        "--out",
        &out,
        "--path-frames",
        "9",
    ];
    assert_bad(&skyline(&arguments), "--path-frames", &arguments);
}
