//! `skyline accuracy spherical`, on a small mesh: what its figures have to say.

use bevy::math::UVec2;
use bevy_skyline::offline::accuracy::spherical::{Plan, measure};

#[test]
fn the_default_loses_no_pixel_and_the_papers_way_does() {
    if crate::device().is_none() {
        return;
    }
    let out = tempfile::tempdir().expect("a directory");
    let plan = Plan {
        triangles: 30_000,
        windows: vec![(2, UVec2::new(96, 72))],
        frames: 2,
        views: 25,
        view_size: UVec2::new(96, 72),
        ..Plan::quick()
    };
    let summary = measure(&plan, out.path()).expect("it can be measured");
    // Four cases; drawn whole, by default, as published and by cones.
    assert_eq!(summary.results, 16);
    assert!(summary.files.iter().all(|file| file.exists()));
    let text = std::fs::read_to_string(out.path().join("results.jsonl")).expect("results");
    for line in text.lines() {
        let line: serde_json::Value = serde_json::from_str(line).expect("a line of JSON");
        let number = |value: &serde_json::Value| value.as_f64().expect("a number");
        let (share, wrong) = (
            number(&line["share"]),
            number(&line["error"]["false_cull_px"]),
        );
        match line["setting"]["mode"].as_str() {
            Some("none") => assert_eq!((share, wrong), (1.0, 0.0)),
            Some("conservative") => {
                assert!(0.02 < share && share < 0.9, "{line}");
                assert_eq!(wrong, 0.0, "{line}");
            }
            Some("cones") => assert!(0.02 < share && share < 1.0, "{line}"),
            mode => {
                assert_eq!(mode, Some("paper"));
                assert!(share < 1.0 && wrong > 0.0, "{line}");
            }
        }
    }
}
