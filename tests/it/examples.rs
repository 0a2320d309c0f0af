//! Every example, run without a window as a reader would run it.

use std::{
    collections::BTreeSet,
    env, fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use tempfile::TempDir;

/// Name, how the lines of its effects begin, and pictures.
type Example = (
    &'static str,
    &'static [&'static str],
    &'static [&'static str],
);

const EXAMPLES: [Example; 9] = [
    ("minimal", &["Terrain active"], &["minimal"]),
    (
        "terrain",
        &["Terrain active", "TerrainShadow idle: up to date: 1 maps"],
        &["terrain"],
    ),
    (
        "terrain_shadow",
        &["TerrainShadow idle: up to date: 1 maps"],
        &[
            "terrain_shadow_07h",
            "terrain_shadow_12h",
            "terrain_shadow_17h",
            "terrain_shadow_close",
        ],
    ),
    (
        "contribution",
        &["ContributionCulling active"],
        &[
            "contribution_all",
            "contribution_culled",
            "contribution_removed",
        ],
    ),
    ("occlusion", &["ZBufferOcclusion active"], &["occlusion"]),
    (
        "budget",
        &["FrameBudget active"],
        &["budget_off", "budget_on", "budget_times"],
    ),
    (
        "interior",
        &["InteriorCulling active"],
        &[
            "interior_plain",
            "interior_culled",
            "interior_removed",
            "interior_cut",
        ],
    ),
    (
        "spherical",
        &["SphericalIndex active"],
        &[
            "spherical_whole_conservative",
            "spherical_run_conservative",
            "spherical_clump_conservative",
            "spherical_split_conservative",
            "spherical_whole_paper",
            "spherical_run_paper",
            "spherical_clump_paper",
            "spherical_split_paper",
        ],
    ),
    (
        "flyover",
        &[
            "Terrain active",
            "TerrainShadow",
            "ZBufferOcclusion",
            "ContributionCulling active",
            "FrameBudget active",
            "InteriorCulling active",
            "SphericalIndex",
            "tower: ",
        ],
        &[
            "flyover_frame_0000",
            "flyover_frame_0001",
            "flyover_split_1",
            "flyover_split_2",
            "flyover_split_3",
            "flyover_cut_away",
            "flyover_contact_sheet",
            "flyover_frame_times",
        ],
    ),
];
/// Plots are as large as plots are, and a page of pictures as what is on it.
const PLOTS: [&str; 3] = [
    "budget_times",
    "flyover_contact_sheet",
    "flyover_frame_times",
];
const SIZE: (u32, u32) = (160, 90);
/// Longest that the first thing a newcomer reads may be. units: lines
const MINIMAL_LINES: usize = 40;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("examples")
}

/// Where cargo puts an example, seen from where it puts this test.
fn binary(name: &str) -> PathBuf {
    let test = env::current_exe().expect("this test has a path");
    let built = test
        .parent()
        .and_then(Path::parent)
        .expect("a target folder");
    let binary = built
        .join("examples")
        .join(format!("{name}{}", env::consts::EXE_SUFFIX));
    assert!(
        binary.exists(),
        "{} is not there: `cargo test --all-features` builds the examples, but with `--test main` it does not: run \
         `cargo build --all-features --examples` first",
        binary.display()
    );
    binary
}

fn run(name: &str, arguments: &[&str]) -> Output {
    Command::new(binary(name))
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .output()
        .expect("the example can be run")
}

/// Input that is refused: status 2, nothing on stdout, and one line that begins with the example's name.
fn refusal(name: &str, arguments: &[&str]) -> String {
    let output = run(name, arguments);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(
        output.status.code(),
        Some(2),
        "{name} {arguments:?}: {text}"
    );
    assert_eq!(text.lines().count(), 1, "{name} {arguments:?}: {text}");
    assert!(text.starts_with(&format!("{name}: ")), "{text}");
    text
}

#[test]
fn each_draws_without_a_window() {
    let Some(device) = crate::device() else {
        return;
    };
    let adapter = format!("adapter: {}", device.adapter());
    drop(device);
    let size = format!("{}x{}", SIZE.0, SIZE.1);
    for (name, effects, pictures) in EXAMPLES {
        let directory = TempDir::new().expect("a directory can be made");
        // A folder that is not there yet.
        let out = directory.path().join("pictures");
        let out_text = out.display().to_string();
        let mut arguments = vec![
            "--headless",
            "--frames",
            "2",
            "--size",
            &size,
            "--out",
            &out_text,
        ];
        if name != "minimal" {
            arguments.push("--small");
        }
        let output = run(name, &arguments);
        let printed = String::from_utf8_lossy(&output.stdout);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success(),
            "{name}: {:?}: {said}",
            output.status
        );
        assert!(!said.contains("ERROR"), "{name}: {said}");
        assert!(printed.contains(&adapter), "{name}: {printed}");
        for word in ["median", "min", "max", "2 frames of 160x90"] {
            assert!(printed.contains(word), "{name} lacks {word}: {printed}");
        }
        for line in effects {
            assert!(printed.contains(line), "{name} lacks {line}: {printed}");
        }
        let written: BTreeSet<String> = fs::read_dir(&out)
            .expect("the folder is there")
            .filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned()))
            .collect();
        let expected = pictures.iter().map(|picture| format!("{picture}.png"));
        let expected: BTreeSet<String> = expected.collect();
        assert_eq!(written, expected, "{name}");
        for picture in pictures {
            let path = out.join(format!("{picture}.png"));
            assert!(
                printed.contains(&path.display().to_string()),
                "{name}: {printed}"
            );
            let image = image::open(&path)
                .expect("the picture can be read")
                .into_rgb8();
            if !PLOTS.contains(picture) {
                assert_eq!(image.dimensions(), SIZE, "{picture}");
            }
            let first = image.get_pixel(0, 0);
            let others = image.pixels().filter(|pixel| *pixel != first).count();
            assert!(
                others > image.pixels().len() / 100,
                "{picture} is of one colour"
            );
        }
    }
}

#[test]
fn what_cannot_be_is_refused_in_one_line() {
    let file = folder().join("minimal.rs").display().to_string();
    for (name, ..) in EXAMPLES {
        refusal(name, &["--no-such-option"]);
        refusal(name, &["--headless", "--size", "wide"]);
        refusal(name, &["--headless", "--frames", "0"]);
        if cfg!(target_os = "linux") {
            let windowless = refusal(name, &[]);
            assert!(windowless.contains("--headless"), "{windowless}");
        }
    }
    for name in [
        "terrain",
        "terrain_shadow",
        "contribution",
        "occlusion",
        "budget",
        "interior",
        "spherical",
        "flyover",
    ] {
        let unread = refusal(name, &["--headless", &file]);
        assert!(unread.contains(&file), "{unread}");
        let missing = refusal(name, &["--headless", "no_such_file.glb"]);
        assert!(missing.contains("no_such_file.glb"), "{missing}");
    }
    refusal("budget", &["--headless", "--target-ms", "NaN"]);
    refusal("flyover", &["--headless", "--target-ms", "0"]);
    // A folder cannot be made in a file.
    let out = format!("{file}/pictures");
    for (name, small) in [("minimal", None), ("terrain", Some("--small"))] {
        let mut arguments = vec!["--headless", "--out", &out];
        arguments.extend(small);
        let unwritten = refusal(name, &arguments);
        assert!(unwritten.contains("cannot write"), "{unwritten}");
    }
}

#[test]
fn none_is_forgotten() {
    let files = fs::read_dir(folder()).expect("the examples are there");
    let there: BTreeSet<String> = files
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|extension| extension == "rs"))
        .filter_map(|path| Some(path.file_stem()?.to_string_lossy().into_owned()))
        .collect();
    let run = EXAMPLES.map(|(name, ..)| name.to_owned());
    assert_eq!(
        there,
        BTreeSet::from(run),
        "every example is run by this suite"
    );
}

#[test]
fn the_smallest_stays_small() {
    let text = fs::read_to_string(folder().join("minimal.rs")).expect("it can be read");
    assert!(text.lines().count() <= MINIMAL_LINES);
    for word in [
        "App::new()",
        "DefaultPlugins",
        "SkylinePlugins",
        "Terrain::new",
        "Camera3d",
    ] {
        assert!(text.contains(word), "{word}");
    }
}
