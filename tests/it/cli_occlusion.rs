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
    assert_eq!(all, ["bevy", "frustum", "none", "z-buffer"]);
    assert_eq!(read("results.csv").lines().count(), lines.len() + 1);
    assert!(read("index.html").contains("/front"));
    for cost in summary["highlights"]["main_world"]
        .as_array()
        .expect("an array")
    {
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
    let arguments = [
        "accuracy", "terrain", "--quick", "--out", &out, "--city", &missing,
    ];
    assert_bad(&skyline(&arguments), "--city", &arguments);
}
