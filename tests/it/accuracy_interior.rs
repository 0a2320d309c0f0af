//! `skyline accuracy interior`, on a small machine: what its figures have to say.

use bevy_skyline::offline::accuracy::interior::{Plan, measure};

#[test]
fn the_default_misses_nothing_through_its_gap_and_the_paper_does() {
    let out = tempfile::tempdir().expect("a directory");
    let plan = Plan {
        machine_triangles: 120_000,
        grids: vec![24, 64],
        views: 24,
        size: 128,
        rays: (1, 16),
        ..Plan::quick()
    };
    let summary = measure(&plan, out.path()).expect("it can be measured");
    assert_eq!(summary.results, 6);
    assert!(summary.files.iter().all(|file| file.exists()));
    let text = std::fs::read_to_string(out.path().join("results.jsonl")).expect("results");
    let lines: Vec<serde_json::Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).expect("a line of JSON"))
        .collect();
    let number = |line: &serde_json::Value, name: &str| {
        line["error"][name]
            .as_f64()
            .unwrap_or_else(|| panic!("{name} in {line}"))
    };
    for line in &lines {
        assert!(number(line, "pixels") > 10_000.0);
        assert!(line["removed_triangles"].as_u64() > Some(0));
        assert!(number(line, "kept_hidden") < 1.0);
        if line["setting"]["mode"] == "conservative" {
            assert_eq!(number(line, "false_cull_px_in_gap"), 0.0, "{line}");
            // Every part of the closed chamber goes, at any grid.
            assert_eq!(number(line, "known_hidden_kept"), 0.0, "{line}");
        } else {
            assert!(number(line, "false_cull_px") > 0.0, "{line}");
            assert!(line["error"]["false_cull_px_in_gap"].is_null());
        }
    }
}
