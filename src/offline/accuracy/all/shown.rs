//! How each effect's lines are shown: which errors, what is a circumstance rather than a knob, what is the default,
//! and why it may be behind.

use serde_json::{Value, json};

use super::{
    super::{contribution, interior, occlusion, shadow, spherical, terrain},
    lines::Line,
};

/// Why a default may be behind another setting, if it is this one.
pub struct Reason {
    /// Whether it is about that setting, beside the default's line.
    pub about: fn(&Line, &Line) -> bool,
    /// The reason.
    pub text: &'static str,
}

/// How an effect is shown.
pub struct Shown {
    /// Name of the command, of the directory, and of the page.
    pub effect: &'static str,
    /// In words.
    pub title: &'static str,
    /// What it does and guarantees.
    pub what: &'static str,
    /// Where to read on.
    pub doc: &'static str,
    /// Places of errors in a line, and what they are called; the less the better.
    pub errors: &'static [(&'static str, &'static str)],
    /// Places of circumstances.
    pub circumstances: &'static [&'static str],
    /// Settings that are the default, each in other circumstances; the first that is there counts.
    pub defaults: fn() -> Vec<Value>,
    /// Why defaults may be behind.
    pub reasons: &'static [Reason],
}

/// By a field's text.
fn has(line: &Line, field: &str, text: &str) -> bool {
    line.setting.get(field).and_then(Value::as_str) == Some(text)
}

/// Whether a setting drew at least as many objects and triangles as the default, and more of one.
fn draws_no_less(line: &Line, default: &Line) -> bool {
    let of = |line: &Line| {
        ["/drawn/objects", "/drawn/triangles"]
            .map(|at| line.all.pointer(at).and_then(Value::as_f64))
    };
    let ([Some(objects), Some(triangles)], [Some(least), Some(fewest)]) = (of(line), of(default))
    else {
        return false;
    };
    objects >= least && triangles >= fewest && (objects, triangles) != (least, fewest)
}

/// Every effect with knobs, in the order of its papers' place in a frame.
pub const SHOWN: [Shown; 7] = [
    Shown {
        effect: "terrain",
        title: "Terrain ray casting",
        what: "Draws the exact piecewise-bilinear surface of a height field to within max_error_px (P1).",
        doc: "docs/terrain.md",
        errors: &[
            ("/error/depth_error_px_p999", "depth error, px (99.9 %)"),
            ("/error/flip_mean", "FLIP, mean"),
            ("/error/coverage_errors_px", "pixels of wrong coverage"),
        ],
        circumstances: &[],
        defaults: || vec![terrain::default_setting()],
        reasons: &[],
    },
    Shown {
        effect: "shadow",
        title: "Terrain shadow maps",
        what: "Finds for every sample how much of a light it sees; remade only when the light or the heights change (P5b).",
        doc: "docs/terrain_shadow.md",
        errors: &[
            ("/error/wrong_texels", "wrong texels"),
            (
                "/error/penumbra_rms",
                "penumbra, root of the mean squared error",
            ),
        ],
        circumstances: &[
            "/setting/elevation_deg",
            "/setting/angular_size_deg",
            "/setting/radius_m",
        ],
        defaults: || shadow::default_settings(),
        reasons: &[
            Reason {
                about: |line, _| has(line, "method", "sweep"),
                text: "a sweep takes horizons for level across the light's disc and is off by up to half a cell: it is for those who \
                       move a sun every frame; the default is exact, for every light",
            },
            Reason {
                about: |line, _| {
                    has(line, "method", "plain") || has(line, "method", "plain-above-all")
                },
                text: "the CPU makes so small a map in less time than a dispatch takes: it is here to compare with P5b",
            },
        ],
    },
    Shown {
        effect: "occlusion",
        title: "Z-buffer occlusion culling",
        what: "Leaves out what is hidden behind the depth already drawn, terrain included; by default nothing visible ever (P2).",
        doc: "docs/occlusion.md",
        errors: &[
            ("/error/false_cull_px", "pixels lost"),
            (
                "/error/missed_culls",
                "share of what is drawn that nobody sees",
            ),
        ],
        circumstances: &[],
        defaults: || vec![occlusion::default_setting()],
        reasons: &[
            Reason {
                about: |line, _| {
                    !has(line, "culling", "z-buffer") && !has(line, "culling", "z-buffer-prepass")
                },
                text: "where little is hidden, looking for it is not paid for: in an app the default notices and rests, which is \
                       switched off here so that it can be measured",
            },
            Reason {
                about: |line, _| has(line, "recheck", "never"),
                text: "what the recheck is for, a camera that jumps, does not happen in a view that stands still",
            },
            Reason {
                about: |line, _| has(line, "culling", "z-buffer-prepass"),
                text: "a depth prepass is the app's choice and no knob of this effect: it pays where much is drawn over other things",
            },
        ],
    },
    Shown {
        effect: "contribution",
        title: "Contribution culling",
        what: "Leaves out what covers less of the picture than a stated area (P4).",
        doc: "docs/frame_budget.md",
        errors: &[
            ("/error/flip_mean", "FLIP, mean"),
            ("/error/flicker_objects", "objects that come and go a frame"),
        ],
        circumstances: &["/setting/occlusion"],
        defaults: contribution::default_settings,
        reasons: &[Reason {
            about: draws_no_less,
            text: "the default draws fewer objects and triangles of the same view, as it also takes out what shows less than the \
                   threshold states, through gaps; that it took longer is the clock's doing, or what weighing takes",
        }],
    },
    Shown {
        effect: "budget",
        title: "The frame budget",
        what: "Holds the frame time to a target by moving the other effects' knobs, cheapest visible loss first (P4 and beyond).",
        doc: "docs/frame_budget.md",
        errors: &[
            (
                "/error/frame_ms_std",
                "standard deviation of the frame time, ms",
            ),
            ("/error/flip_mean", "FLIP, mean"),
        ],
        circumstances: &["/setting/target_ms", "/setting/clock"],
        defaults: || vec![json!({ "policy": "budget" })],
        reasons: &[Reason {
            about: |line, _| !has(line, "policy", "budget"),
            text: "a baseline's number was chosen with the whole path known beforehand, so that its mean is the budget's: the budget \
                   knows no frame before it is there",
        }],
    },
    Shown {
        effect: "interior",
        title: "Interior culling",
        what: "Takes out of a model what cannot be seen from anywhere outside, through gaps wider than a stated one (P5a).",
        doc: "docs/interior_culling.md",
        errors: &[
            ("/error/false_cull_px", "pixels lost"),
            ("/error/kept_hidden", "share of what stays that nobody sees"),
            (
                "/gap",
                "gap that something must show through to stay for sure, units of the model",
            ),
        ],
        circumstances: &[],
        defaults: interior::default_settings,
        reasons: &[],
    },
    Shown {
        effect: "spherical",
        title: "Spherical index",
        what: "Draws of a detailed mesh only the chunks that a camera can see; by default never without a visible triangle (P3).",
        doc: "docs/spherical_index.md",
        errors: &[
            ("/error/false_cull_px", "pixels lost in all views"),
            ("/share", "share of the triangles drawn"),
        ],
        circumstances: &["/windows", "/size_px"],
        defaults: || vec![spherical::default_setting()],
        reasons: &[],
    },
];
