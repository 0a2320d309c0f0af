//! The measured lines as plots, tables, pictures and highlights.

use serde_json::json;

use super::{
    super::report::{Report, Table, optional, short},
    AccuracyError, SettingLine, SphericalLine,
};
use crate::offline::plot::{Axis, LinePlot, Series};

/// Case, windows and their size, frames a second without and with the selection, share of triangles drawn.
type Published = (&'static str, u32, [u32; 2], f64, f64, Option<f64>);

/// P3's tables.
const P3: [Published; 9] = [
    ("run", 1, [320, 240], 295.0, 486.0, Some(0.094)),
    ("clump", 1, [320, 240], 300.0, 432.0, Some(0.114)),
    ("split", 1, [320, 240], 295.0, 389.0, Some(0.183)),
    ("run", 4, [320, 240], 80.0, 376.0, None),
    ("clump", 4, [320, 240], 84.0, 421.0, None),
    ("split", 4, [320, 240], 80.0, 202.0, None),
    ("run", 4, [640, 480], 63.0, 153.0, None),
    ("clump", 4, [640, 480], 65.0, 174.0, None),
    ("split", 4, [640, 480], 63.0, 136.0, None),
];

/// A setting in words.
fn name(setting: &SettingLine) -> String {
    let mut name = setting.mode.to_owned();
    if let Some([theta, phi]) = setting.bins {
        name += &format!(" {theta}×{phi}");
    }
    if let Some(size) = setting.chunk_triangles {
        name += &format!(", {size}");
    }
    name
}

/// Scene, windows and size, in the order of their first appearance.
fn groups(lines: &[SphericalLine]) -> Vec<(&str, u32, [u32; 2])> {
    let mut groups: Vec<_> = lines
        .iter()
        .map(|line| (&*line.scene, line.windows, line.size_px))
        .collect();
    groups.dedup();
    groups
}

fn of<'a>(
    lines: &'a [SphericalLine],
    (scene, windows, size): (&str, u32, [u32; 2]),
) -> impl Iterator<Item = &'a SphericalLine> {
    lines
        .iter()
        .filter(move |line| line.scene == scene && line.windows == windows && line.size_px == size)
}

pub(super) fn draw(report: &mut Report, lines: &[SphericalLine]) -> Result<(), AccuracyError> {
    for group in groups(lines) {
        let (scene, windows, [width, height]) = group;
        let series = ["none", "conservative", "paper", "cones"].map(|mode| Series {
            name: mode.to_owned(),
            points: of(lines, group)
                .filter(|line| line.setting.mode == mode)
                .map(|line| (line.time_ms.median, line.share))
                .collect(),
            quoted: false,
        });
        let plot = LinePlot {
            title: format!("{scene}, {windows} × {width}×{height} px"),
            x: Axis::linear("time of a frame, ms"),
            y: Axis::linear("share of the triangles drawn"),
            series: series.into(),
        };
        let stem = format!("{scene}_{windows}x{width}").replace(['/', ' ', ','], "_");
        let what = format!("{scene}, {windows} windows: share of the triangles drawn, by time");
        plot.write(&report.file(&format!("{stem}.png"), &what))?;
    }
    Ok(())
}

/// A view as it is drawn whole, as it was drawn, and what differs in red.
pub(super) fn picture(
    report: &mut Report,
    setting: &SettingLine,
    wrong: u64,
    whole: &image::RgbaImage,
    drawn: &image::RgbaImage,
) -> Result<(), AccuracyError> {
    let name = name(setting);
    let what = format!("{name}: {wrong} px wrong, the most of all views of the whole");
    let stem = format!("wrong_{name}")
        .replace([' ', ','], "_")
        .replace('×', "x");
    let rgb =
        |picture: &image::RgbaImage| image::DynamicImage::ImageRgba8(picture.clone()).into_rgb8();
    report.compare(&format!("{stem}.png"), &what, &rgb(whole), &rgb(drawn))?;
    Ok(())
}

const HEADS: [&str; 9] = [
    "setting",
    "ms",
    "least … most",
    "times as fast",
    "triangles",
    "%",
    "objects",
    "wrong px",
    "views with",
];

fn row(line: &SphericalLine) -> Vec<String> {
    let (time, error) = (&line.time_ms, &line.error);
    vec![
        name(&line.setting),
        short(time.median),
        format!("{} … {}", short(time.min), short(time.max)),
        short(line.faster),
        short(line.triangles),
        short(100.0 * line.share),
        short(line.objects),
        error.false_cull_px.to_string(),
        format!("{} of {}", error.views_with_false_culls, error.views),
    ]
}

pub(super) fn tables(lines: &[SphericalLine]) -> Vec<Table> {
    let mut tables = vec![against_p3(lines)];
    for group in groups(lines) {
        let (scene, windows, [width, height]) = group;
        tables.push((
            format!("{scene}, {windows} × {width}×{height} px"),
            HEADS.map(str::to_owned).into(),
            of(lines, group).map(row).collect(),
        ));
    }
    tables
}

/// The default at the default's size of chunks.
fn is_default(setting: &SettingLine) -> bool {
    let default = crate::spherical::SphericalIndex::default();
    setting.mode == "conservative"
        && setting.chunk_triangles == Some(default.chunk_triangles)
        && setting.bins == Some([default.bins.theta, default.bins.phi])
}

fn against_p3(lines: &[SphericalLine]) -> Table {
    let heads = [
        "case",
        "windows",
        "P3: times as fast",
        "P3: % drawn",
        "default: times as fast",
        "default: % drawn",
        "paper: times as fast",
        "paper: % drawn",
    ];
    let rows = P3
        .iter()
        .filter_map(|(case, windows, size, without, with, share)| {
            let find = |is: &dyn Fn(&SettingLine) -> bool| {
                lines.iter().find(|line| {
                    line.scene.ends_with(case)
                        && line.windows == *windows
                        && line.size_px == *size
                        && is(&line.setting)
                })
            };
            let default = find(&is_default)?;
            let paper =
                find(&|setting| setting.mode == "paper" && setting.bins == Some([180, 360]))?;
            Some(vec![
                (*case).to_owned(),
                format!("{windows} × {}×{}", size[0], size[1]),
                short(with / without),
                optional(share.map(|share| short(100.0 * share))),
                short(default.faster),
                short(100.0 * default.share),
                short(paper.faster),
                short(100.0 * paper.share),
            ])
        });
    (
        "Against P3's tables".to_owned(),
        heads.map(str::to_owned).into(),
        rows.collect(),
    )
}

pub(super) fn csv(lines: &[SphericalLine]) -> Table {
    let heads = [
        "scene",
        "mode",
        "bins_theta",
        "bins_phi",
        "chunk_triangles",
        "windows",
        "width_px",
        "height_px",
        "time_ms_median",
        "time_ms_min",
        "time_ms_max",
        "runs",
        "faster",
        "triangles",
        "share",
        "objects",
        "false_cull_px",
        "pixels",
        "views_with_false_culls",
        "views",
        "adapter",
    ];
    let rows = lines.iter().map(|line| {
        let (setting, time, error) = (&line.setting, &line.time_ms, &line.error);
        vec![
            line.scene.clone(),
            setting.mode.to_owned(),
            optional(setting.bins.map(|bins| bins[0])),
            optional(setting.bins.map(|bins| bins[1])),
            optional(setting.chunk_triangles),
            line.windows.to_string(),
            line.size_px[0].to_string(),
            line.size_px[1].to_string(),
            time.median.to_string(),
            time.min.to_string(),
            time.max.to_string(),
            time.runs.to_string(),
            line.faster.to_string(),
            line.triangles.to_string(),
            line.share.to_string(),
            line.objects.to_string(),
            error.false_cull_px.to_string(),
            error.pixels.to_string(),
            error.views_with_false_culls.to_string(),
            error.views.to_string(),
            line.adapter.clone(),
        ]
    });
    (
        "results".to_owned(),
        heads.map(str::to_owned).into(),
        rows.collect(),
    )
}

pub(super) fn highlights(lines: &[SphericalLine]) -> serde_json::Value {
    let of = |line: &SphericalLine| {
        json!({
            "scene": line.scene,
            "windows": line.windows,
            "size_px": line.size_px,
            "setting": name(&line.setting),
            "faster": line.faster,
            "share": line.share,
            "false_cull_px": line.error.false_cull_px,
        })
    };
    let some = |wanted: &dyn Fn(&SettingLine) -> bool| -> Vec<_> {
        lines
            .iter()
            .filter(|line| wanted(&line.setting))
            .map(of)
            .collect()
    };
    json!({
        "default": some(&is_default),
        "paper": some(&|setting| setting.mode == "paper" && setting.bins == Some([180, 360])),
        "cones": some(&|setting| setting.mode == "cones"),
    })
}
