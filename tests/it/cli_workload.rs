//! `skyline workload`, `skyline accuracy contribution` and `skyline accuracy budget`, run as their users run them.

use std::collections::BTreeMap;

use serde_json::Value;

use crate::cli::{assert_bad, directory, path, skyline, stdout_json};

/// The table's rows under its heads.
fn table(file: &str) -> Vec<BTreeMap<String, String>> {
    let text = std::fs::read_to_string(file).expect("the table is there");
    let mut lines = text.lines().map(|line| line.split(','));
    let heads: Vec<&str> = lines.next().expect("there are heads").collect();
    lines
        .map(|cells| {
            let cells: Vec<&str> = cells.collect();
            assert_eq!(cells.len(), heads.len());
            let pairs = heads.iter().zip(cells);
            pairs
                .map(|(h, c)| ((*h).to_owned(), c.to_owned()))
                .collect()
        })
        .collect()
}

fn number(row: &BTreeMap<String, String>, head: &str) -> f64 {
    row[head].parse().expect("the cell is a number")
}

#[test]
fn one_policy_leaves_a_row_a_frame() {
    let dir = directory();
    let out = path(&dir, "frustum.csv");
    let arguments = [
        "workload",
        "--scene",
        "city",
        "--quick",
        "--path",
        "zoom",
        "--target-ms",
        "16",
        "--policy",
        "frustum",
        "--frames",
        "5",
        "--cost",
        "0.01,0.0001,0,1",
        "--out",
        &out,
    ];
    let summary = stdout_json(&skyline(&arguments));
    assert_eq!(summary["path"], "zoom");
    assert_eq!(summary["frames"], 5);
    assert_eq!(summary["policies"].as_array().map(Vec::len), Some(1));
    let of = &summary["policies"][0];
    assert_eq!(of["policy"], "frustum");
    let rows = table(&out);
    assert_eq!(rows.len(), 5);
    for (frame, row) in rows.iter().enumerate() {
        assert_eq!(number(row, "frame"), frame as f64);
        assert!(number(row, "frame_ms") > 0.0);
        let counted = 0.01 * number(row, "objects") + 1e-4 * number(row, "polygons") + 1.0;
        assert!(
            (number(row, "counted_ms") - counted).abs() < 1e-3,
            "{row:?}"
        );
        assert_eq!(row["policy"], "frustum");
    }
    assert_eq!(number(&rows[0], "parameter"), 1.0);
    assert!(number(&rows[4], "parameter") > 5.0, "{:?}", rows[4]);
    assert!(number(&rows[4], "objects") < number(&rows[0], "objects"));
    let mean = rows
        .iter()
        .map(|row| number(row, "counted_ms"))
        .sum::<f64>()
        / 5.0;
    let told = of["counted_ms"]["mean"].as_f64().expect("a number");
    assert!((told - mean).abs() < 1e-3, "{told} and {mean}");
    let files = std::fs::read_dir(dir.path()).expect("it is a directory");
    assert_eq!(files.count(), 1, "the table and nothing else");
}

#[test]
fn all_policies_leave_a_table_and_a_plot() {
    let dir = directory();
    let out = path(&dir, "all.csv");
    let arguments = [
        "workload",
        "--quick",
        "--path",
        "rotate",
        "--target-ms",
        "5",
        "--policy",
        "all",
        "--clock",
        "counted",
        "--frames",
        "8",
        "--out",
        &out,
    ];
    let summary = stdout_json(&skyline(&arguments));
    assert_eq!(summary["clock"], "counted");
    assert!(summary["cost_misfit"].as_f64() > Some(0.0), "{summary}");
    let policies: Vec<&str> = summary["policies"]
        .as_array()
        .expect("an array")
        .iter()
        .filter_map(|of| of["policy"].as_str())
        .collect();
    let kinds: Vec<&str> = policies
        .iter()
        .map(|policy| policy.split(':').next().unwrap_or_default())
        .collect();
    assert_eq!(
        kinds,
        [
            "none",
            "frustum",
            "polygons",
            "distance",
            "threshold",
            "budget"
        ]
    );
    let rows = table(&out);
    assert_eq!(rows.len(), 6 * 8);
    for policy in &policies {
        let angles: Vec<f64> = rows
            .iter()
            .filter(|row| row["policy"] == **policy)
            .map(|row| number(row, "parameter"))
            .collect();
        let expected: Vec<f64> = (0..8).map(|frame| 45.0 * f64::from(frame)).collect();
        assert_eq!(angles, expected);
    }
    let plot = image::open(path(&dir, "all.png")).expect("the plot is a picture");
    assert_eq!((plot.width(), plot.height()), (1100, 2100));
    let colours: std::collections::BTreeSet<_> =
        plot.to_rgb8().pixels().map(|pixel| pixel.0).collect();
    assert!(
        colours.len() > 8,
        "lines in many colours: {}",
        colours.len()
    );
}

#[test]
fn bad_input_is_named() {
    let dir = directory();
    let out = path(&dir, "w.csv");
    let missing = path(&dir, "none.glb");
    let nowhere = path(&dir, "no/where.csv");
    let picture = path(&dir, "w.png");
    let good = [
        ("--path", "rotate"),
        ("--target-ms", "16"),
        ("--policy", "frustum"),
        ("--out", out.as_str()),
    ];
    let with = |flags: &[(&str, &str)], names: &str| {
        let mut arguments = vec!["workload"];
        for (flag, value) in &good {
            let value = flags
                .iter()
                .find(|of| of.0 == *flag)
                .map_or(*value, |of| of.1);
            arguments.extend([*flag, value]);
        }
        for (flag, value) in flags {
            if good.iter().all(|of| of.0 != *flag) {
                arguments.extend([*flag, *value]);
            }
        }
        arguments.retain(|argument| !argument.is_empty());
        assert_bad(&skyline(&arguments), names, &arguments);
        assert!(!dir.path().join("w.csv").exists(), "nothing was written");
    };
    for target in ["0", "-3", "nan", "inf", "soon"] {
        with(&[("--target-ms", target)], "--target-ms");
    }
    for policy in [
        "some",
        "polygons",
        "polygons:0",
        "distance:nan",
        "threshold:-1",
        "budget:3",
    ] {
        with(&[("--policy", policy)], "--policy");
    }
    with(&[("--path", "spin")], "--path");
    with(&[("--scene", "forest")], "--scene");
    with(&[("--frames", "0")], "--frames");
    with(&[("--size", "0x180"), ("--quick", "")], "--size");
    with(&[("--size", "many")], "--size");
    with(&[("--size", "99999x180"), ("--quick", "")], "99999x180");
    with(&[("--clock", "sun")], "--clock");
    with(&[("--cost", "1,2,3")], "--cost");
    with(&[("--cost", "-1,0,0,0")], "--cost");
    with(&[("--city", &missing)], "none.glb");
    with(&[("--city", &missing), ("--quick", "")], "--quick");
    with(&[("--out", &nowhere)], "where.csv");
    with(&[("--out", &picture), ("--policy", "all")], "--out");
    let arguments = [
        "workload", "--path", "rotate", "--policy", "all", "--out", &out,
    ];
    assert_bad(&skyline(&arguments), "--target-ms", &arguments);

    let report = path(&dir, "report");
    for effect in ["contribution", "budget"] {
        let with = |flags: &[&str], names: &str| {
            let base = ["accuracy", effect, "--out", &report];
            let arguments: Vec<&str> = base.iter().chain(flags).copied().collect();
            assert_bad(&skyline(&arguments), names, &arguments);
        };
        with(&["--heightmap", &missing], "--heightmap");
        with(&["--scenes", "city"], "--scenes");
        with(&["--model", &missing], "--model");
        with(&["--city", &missing], "none.glb");
        with(&["--quick", "--city", &missing], "--quick");
        with(&["--path-frames", "0"], "--path-frames");
    }
    let arguments = [
        "accuracy", "budget", "--quick", "--rounds", "2", "--out", &report,
    ];
    assert_bad(&skyline(&arguments), "--rounds", &arguments);
}

/// The lines of a report, whose files are all there.
fn lines(summary: &Value, directory: &str) -> Vec<Value> {
    let read = |name: &str| {
        std::fs::read_to_string(format!("{directory}/{name}")).expect("the file is there")
    };
    for file in summary["files"].as_array().expect("an array") {
        let file = file.as_str().expect("a path");
        assert!(std::path::Path::new(file).exists(), "{file}");
        let name = file.rsplit('/').next().unwrap_or(file);
        assert!(
            !name.ends_with(".png") || read("index.html").contains(name),
            "{name}"
        );
    }
    let lines: Vec<Value> = read("results.jsonl")
        .lines()
        .map(|line| serde_json::from_str(line).expect("a line is JSON"))
        .collect();
    assert_eq!(summary["results"].as_u64(), Some(lines.len() as u64));
    assert_eq!(read("results.csv").lines().count(), lines.len() + 1);
    lines
}

#[test]
fn a_quick_run_of_contribution_leaves_valid_files() {
    let dir = directory();
    let out = path(&dir, "contribution");
    let arguments = [
        "accuracy",
        "contribution",
        "--quick",
        "--path-frames",
        "4",
        "--out",
        &out,
    ];
    let summary = stdout_json(&skyline(&arguments));
    assert_eq!(summary["effect"], "contribution");
    let lines = lines(&summary, &out);
    assert_eq!(lines.len(), 2 * 30 + 13);
    for line in &lines {
        let error = &line["error"];
        assert!(line["time_ms"]["median"].as_f64() > Some(0.0), "{line}");
        let flip = error["flip_mean"].as_f64().expect("a number");
        assert!((0.0..=1.0).contains(&flip), "{line}");
        if line["setting"]["threshold_px2"] == 0.0 && line["setting"]["occlusion"] == false {
            assert_eq!(error["flip_mean"], 0.0, "{line}");
            assert_eq!(error["changed_fraction"], 0.0, "{line}");
        }
    }
    let of = |threshold: f64| {
        let line = lines.iter().find(|line| {
            line["setting"]["threshold_px2"] == threshold && line["setting"]["occlusion"] == false
        });
        line.and_then(|line| line["drawn"]["objects"].as_f64())
            .expect("it was measured")
    };
    assert!(of(256.0) < of(16.0) && of(16.0) < of(0.0), "more goes");
}

#[test]
fn a_quick_run_of_the_budget_leaves_valid_files() {
    let dir = directory();
    let out = path(&dir, "budget");
    let arguments = [
        "accuracy",
        "budget",
        "--quick",
        "--path-frames",
        "6",
        "--out",
        &out,
    ];
    let summary = stdout_json(&skyline(&arguments));
    assert_eq!(summary["effect"], "budget");
    let lines = lines(&summary, &out);
    // Two paths, two clocks, one target; six policies.
    assert_eq!(lines.len(), 2 * 2 * 6);
    for line in &lines {
        let error = &line["error"];
        assert!(error["frame_ms_mean"].as_f64() > Some(0.0), "{line}");
        assert!(error["frame_ms_std"].as_f64() >= Some(0.0), "{line}");
        let over = error["over_budget_fraction"].as_f64().expect("a number");
        assert!((0.0..=1.0).contains(&over), "{line}");
        if line["setting"]["policy"] == "none" {
            assert_eq!(
                error["flip_mean"], 0.0,
                "what is out of view shows nowhere: {line}"
            );
        }
    }
    let held = summary["highlights"]["held"].as_array().expect("an array");
    assert_eq!(held.len(), 4);
    for held in held {
        let to = held["budget_to"].as_object().expect("an object");
        assert!(to.len() == 5 && to.contains_key("polygons"), "{held}");
    }
}
