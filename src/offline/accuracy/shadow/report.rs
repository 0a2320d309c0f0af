//! The measured lines as plots, maps and tables.

use super::{
    sizes::{MAKERS, PAPER, Sizes},
    *,
};
use crate::offline::{
    accuracy::{
        Table,
        report::{optional, short},
    },
    plot::{Axis, LinePlot, Series},
};

/// Columns a map is shown with at most. units: px
const SHOWN: u32 = 480;
const GAP: u32 = 8;

fn of<'a>(
    lines: &'a [ShadowLine],
    name: &str,
    lamp: &Lamp,
) -> impl Iterator<Item = &'a ShadowLine> {
    let scene = format!("{name}/{}", lamp.name);
    lines.iter().filter(move |line| line.scene == scene)
}

pub(super) fn draw(
    report: &mut Report,
    name: &str,
    lamps: &[Lamp],
    lines: &[ShadowLine],
    table: &Sizes,
) -> Result<(), AccuracyError> {
    draw_sizes(report, table)?;
    draw_elevations(report, lines)?;
    for lamp in lamps {
        for size in &lamp.sized {
            draw_penumbra(report, name, lamp, size, lines)?;
        }
    }
    Ok(())
}

fn draw_sizes(report: &mut Report, table: &Sizes) -> Result<(), AccuracyError> {
    let mut elevations: Vec<f64> = table.rows.iter().map(|row| row.elevation_deg).collect();
    elevations.sort_by(f64::total_cmp);
    elevations.dedup();
    for elevation in elevations {
        let mut series: Vec<Series> = MAKERS
            .into_iter()
            .map(|maker| Series {
                name: maker.words().into(),
                points: table
                    .rows
                    .iter()
                    .filter(|row| row.elevation_deg == elevation)
                    .filter_map(|row| Some((f64::from(row.side), row.ms(maker)?)))
                    .collect(),
                quoted: false,
            })
            .collect();
        let paper = |name: &str, pick: fn(&(u32, f64, f64)) -> f64| Series {
            name: name.into(),
            points: PAPER
                .iter()
                .map(|row| (f64::from(row.0), 1e3 * pick(row)))
                .collect(),
            quoted: true,
        };
        series.push(paper("CPU in P5b", |row| row.1));
        series.push(paper("GPU in P5b", |row| row.2));
        let path = report.file(
            &format!("time_size_{elevation}.png"),
            &format!("Time of one map against samples a side, hard shadows, sun {elevation}° high"),
        );
        LinePlot {
            title: format!("Time of one shadow map, sun {elevation} degrees high"),
            x: Axis::log("samples a side"),
            y: Axis::log("ms"),
            series,
        }
        .write(&path)?;
    }
    Ok(())
}

fn draw_elevations(report: &mut Report, lines: &[ShadowLine]) -> Result<(), AccuracyError> {
    let series = METHODS.iter().map(|(_, method)| Series {
        name: (*method).into(),
        points: lines
            .iter()
            .filter(|line| {
                line.setting.method == *method && line.setting.angular_size_deg == Some(0.0)
            })
            .filter_map(|line| Some((line.setting.elevation_deg?, line.time_ms.median)))
            .collect(),
        quoted: false,
    });
    let path = report.file(
        "time_elevation.png",
        "Time of one map of hard shadows against the sun's elevation",
    );
    LinePlot {
        title: "Time of one shadow map against the sun's elevation".into(),
        x: Axis::log("elevation, degrees"),
        y: Axis::log("ms"),
        series: series.collect(),
    }
    .write(&path)?;
    Ok(())
}

/// Name and words of a light's size.
fn size_of(light: &MapLight) -> (String, String) {
    match *light {
        MapLight::Sun {
            angular_size_deg, ..
        } => (
            format!("{angular_size_deg}"),
            format!("{angular_size_deg}° wide"),
        ),
        MapLight::Point { radius_m, .. } => (
            format!("{radius_m:.0}m"),
            format!("{radius_m:.0} m in radius"),
        ),
    }
}

fn is_of(line: &ShadowLine, light: &MapLight) -> bool {
    match *light {
        MapLight::Sun {
            angular_size_deg, ..
        } => line.setting.angular_size_deg == Some(angular_size_deg),
        MapLight::Point { radius_m, .. } => line.setting.radius_m == Some(radius_m),
    }
}

fn draw_penumbra(
    report: &mut Report,
    name: &str,
    lamp: &Lamp,
    light: &MapLight,
    lines: &[ShadowLine],
) -> Result<(), AccuracyError> {
    let (file, words) = size_of(light);
    let series: Vec<Series> = METHODS
        .iter()
        .map(|(_, method)| Series {
            name: (*method).into(),
            points: of(lines, name, lamp)
                .filter(|line| line.setting.method == *method && is_of(line, light))
                .filter_map(|line| Some((line.error.penumbra_rms?, line.time_ms.median)))
                .collect(),
            quoted: false,
        })
        .filter(|series| !series.points.is_empty())
        .collect();
    if series.is_empty() {
        return Ok(());
    }
    let path = report.file(
        &format!("time_error_{}_{file}.png", lamp.name),
        &format!(
            "Time against the penumbra's error, {}, {words}; along max-mip's line the strips are {}",
            lamp.what,
            strips_of(lines),
        ),
    );
    LinePlot {
        title: format!("Time against error, {}, {words}", lamp.what).replace('°', " degrees"),
        x: Axis::log("penumbra, RMS error as a share of the light"),
        y: Axis::log("ms"),
        series,
    }
    .write(&path)?;
    Ok(())
}

fn strips_of(lines: &[ShadowLine]) -> String {
    let mut strips: Vec<u32> = lines
        .iter()
        .map(|line| line.setting.strips)
        .filter(|strips| *strips > 0)
        .collect();
    strips.sort_unstable();
    strips.dedup();
    let strips: Vec<_> = strips.iter().map(u32::to_string).collect();
    strips.join(", ")
}

/// A map, shrunk if it must be: grey, or where it differs from `exact` red if darker and blue if lighter.
fn panel(map: &ShadowImage, exact: Option<&ShadowImage>) -> image::RgbImage {
    let shrink = map.size.x.div_ceil(SHOWN).max(1);
    let shown = (map.size / shrink).max(UVec2::ONE);
    image::RgbImage::from_fn(shown.x, shown.y, |x, y| {
        let texels = || {
            (0..shrink * shrink)
                .map(move |k| UVec2::new(x * shrink + k % shrink, y * shrink + k / shrink))
                .filter(|at| at.cmplt(map.size).all())
        };
        let differs = exact.and_then(|exact| {
            texels()
                .map(|at| i32::from(map.at(at)) - i32::from(exact.at(at)))
                .max_by_key(|difference| difference.abs())
                .filter(|difference| *difference != 0)
        });
        match differs {
            Some(difference) if difference < 0 => image::Rgb([213, 0, 0]),
            Some(_) => image::Rgb([0, 60, 213]),
            None => {
                let (sum, count) = texels().fold((0, 0), |(sum, count), at| {
                    (sum + u32::from(map.at(at)), count + 1)
                });
                let grey = (sum / count.max(1)) as u8;
                // Under a difference the map is pale.
                let grey = if exact.is_some() {
                    170 + grey / 3
                } else {
                    grey
                };
                image::Rgb([grey; 3])
            }
        }
    })
}

/// For the light with a shadow most worth seeing: the map by each method, and its difference from per-texel's.
pub(super) fn draw_maps(
    report: &mut Report,
    lamps: &[Lamp],
    maps: &[Vec<(&'static str, ShadowImage)>],
) -> Result<(), AccuracyError> {
    let low =
        |lamp: &Lamp| matches!(lamp.hard, MapLight::Sun { sun, .. } if sun.elevation_deg <= 20.0);
    let Some((lamp, maps)) = lamps.iter().zip(maps).find(|(lamp, _)| low(lamp)) else {
        return Ok(());
    };
    let Some((_, exact)) = maps.first() else {
        return Ok(());
    };
    let rows = [None, Some(exact)];
    let one = panel(exact, None);
    let step = UVec2::new(one.width() + GAP, one.height() + GAP);
    let mut picture = image::RgbImage::from_pixel(
        step.x * maps.len() as u32 - GAP,
        step.y * 2 - GAP,
        image::Rgb([255; 3]),
    );
    for (row, against) in rows.into_iter().enumerate() {
        for (column, (_, map)) in maps.iter().enumerate() {
            let (x, y) = (step.x * column as u32, step.y * row as u32);
            image::imageops::replace(&mut picture, &panel(map, against), x.into(), y.into());
        }
    }
    let names: Vec<_> = maps.iter().map(|(name, _)| *name).collect();
    let path = report.file(
        "maps.png",
        &format!(
            "Hard shadows, {}: by {}. Below, where each differs from per-texel: red darker, blue lighter",
            lamp.what,
            names.join(", ")
        ),
    );
    report.save(&path, &picture)?;
    Ok(())
}

pub(super) fn tables(name: &str, lamps: &[Lamp], lines: &[ShadowLine]) -> Vec<Table> {
    let heads = |names: &[&str]| {
        names
            .iter()
            .map(|name| (*name).to_owned())
            .collect::<Vec<_>>()
    };
    let count = |n: Option<usize>| n.map_or_else(|| "–".into(), |n| n.to_string());
    let spread = |time: &Timing| format!("{}…{} ({})", short(time.min), short(time.max), time.runs);
    let mut hard = Vec::new();
    let mut soft = Vec::new();
    for lamp in lamps {
        for line in of(lines, name, lamp) {
            let (setting, error, time) = (&line.setting, &line.error, &line.time_ms);
            if error.judged_texels.is_some() {
                hard.push(vec![
                    lamp.what.clone(),
                    setting.method.to_owned(),
                    short(time.median),
                    spread(time),
                    count(error.wrong_texels),
                    count(error.in_band),
                    count(error.judged_texels),
                    short(error.lit_fraction),
                ]);
                continue;
            }
            let light = lamp.sized.iter().find(|light| is_of(line, light));
            soft.push(vec![
                lamp.what.clone(),
                light.map_or_else(String::new, |light| size_of(light).1),
                setting.method.to_owned(),
                if setting.strips == 0 {
                    "–".into()
                } else {
                    setting.strips.to_string()
                },
                short(time.median),
                spread(time),
                error.penumbra_rms.map_or_else(|| "–".into(), short),
                count(error.penumbra_texels),
                short(error.lit_fraction),
            ]);
        }
    }
    vec![
        (
            "Hard shadows, every setting".into(),
            heads(&[
                "light",
                "method",
                "ms",
                "min…max (runs)",
                "wrong texels",
                "in the guard band",
                "of",
                "lit",
            ]),
            hard,
        ),
        (
            "Penumbrae, every setting".into(),
            heads(&[
                "light",
                "size",
                "method",
                "strips",
                "ms",
                "min…max (runs)",
                "penumbra RMS",
                "texels in it",
                "lit",
            ]),
            soft,
        ),
    ]
}

pub(super) fn csv(lines: &[ShadowLine]) -> Table {
    let heads = [
        "effect",
        "scene",
        "method",
        "strips",
        "elevation_deg",
        "angular_size_deg",
        "radius_m",
        "time_ms_median",
        "time_ms_min",
        "time_ms_max",
        "time_ms_runs",
        "wrong_texels",
        "in_band",
        "judged_texels",
        "penumbra_rms",
        "penumbra_texels",
        "lit_fraction",
        "width",
        "height",
        "adapter",
    ];
    let rows = lines.iter().map(|line| {
        let (setting, error) = (&line.setting, &line.error);
        vec![
            line.effect.to_owned(),
            line.scene.clone(),
            setting.method.to_owned(),
            setting.strips.to_string(),
            optional(setting.elevation_deg),
            optional(setting.angular_size_deg),
            optional(setting.radius_m),
            line.time_ms.median.to_string(),
            line.time_ms.min.to_string(),
            line.time_ms.max.to_string(),
            line.time_ms.runs.to_string(),
            optional(error.wrong_texels),
            optional(error.in_band),
            optional(error.judged_texels),
            optional(error.penumbra_rms),
            optional(error.penumbra_texels),
            error.lit_fraction.to_string(),
            line.samples[0].to_string(),
            line.samples[1].to_string(),
            line.adapter.clone(),
        ]
    });
    (
        String::new(),
        heads.map(str::to_owned).to_vec(),
        rows.collect(),
    )
}
