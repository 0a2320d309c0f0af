//! `skyline accuracy shadow`: what each way to a shadow map costs and how far it is off, and P5b's table made again.
//!
//! Hard shadows are held against [`ShadowTwin::judge`], penumbrae against [`ShadowTwin::visible_share`] of many
//! strips, both at texels drawn by lot with a fixed seed: the twin takes microseconds a ray.

mod blinn_phong;
pub mod plain;
mod report;
mod sizes;

use std::path::Path;

use bevy::{math::UVec2, prelude::*};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::{AccuracyError, Found, Report, Summary, Timing, lot::Lot};
use crate::{
    offline::{
        render::{Clock, Sun},
        shadow::{METHODS, ShadowImage, method_name},
        shadow_map::{MapLight, MapStage},
    },
    reference::terrain_shadow::{ShadowTally, ShadowTwin, ShadowVerdict},
    terrain::{HeightField, HeightFieldError, HeightSamples},
    terrain_shadow::{ShadowMethod, TerrainShadow, light::GridLight},
};

/// Azimuth of every sun. units: degrees
const AZIMUTH_DEG: f64 = 235.0;
/// A map that takes longer is not made again for its time. units: ms
const SLOW_MS: f64 = 2_000.0;
/// Side of the map in the two pictures of one view.
const PICTURE_SIDE: u32 = 1024;
/// Strips of the twin's penumbra.
const TWIN_STRIPS: u32 = 64;
/// Of so many texels drawn one after the other those in a penumbra are taken.
const DRAWS: usize = 400_000;

/// What to measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Few settings and small maps.
    pub quick: bool,
}

impl Plan {
    /// Every setting, on maps of 512×512, and P5b's table up to 4096×4096.
    pub fn full() -> Self {
        Self { quick: false }
    }

    /// Seconds rather than minutes.
    pub fn quick() -> Self {
        Self { quick: true }
    }

    fn rounds(&self) -> usize {
        if self.quick { 2 } else { 3 }
    }

    /// Side of the map on which settings are measured.
    fn side(&self) -> u32 {
        if self.quick { 128 } else { 512 }
    }

    fn elevations_deg(&self) -> &'static [f64] {
        if self.quick {
            &[20.0, 5.0]
        } else {
            &[45.0, 20.0, 10.0, 5.0, 1.0]
        }
    }

    /// Diameters of the sun where there are penumbrae: as it is, and a large one.
    fn angular_sizes_deg(&self) -> &'static [f64] {
        if self.quick { &[5.0] } else { &[0.53, 5.0] }
    }

    fn strips(&self) -> &'static [u32] {
        if self.quick {
            &[1, 4]
        } else {
            &[1, 2, 4, 8, 16]
        }
    }

    /// Texels held against the twin's verdict.
    fn judged(&self) -> usize {
        if self.quick { 2_000 } else { 20_000 }
    }

    /// Texels held against the twin's penumbra.
    fn penumbra_texels(&self) -> usize {
        if self.quick { 60 } else { 400 }
    }
}

/// One line of `results.jsonl`.
#[derive(Serialize, Clone, Debug)]
pub struct ShadowLine {
    /// Always `shadow`.
    pub effect: &'static str,
    /// Field and light.
    pub scene: String,
    /// What was set.
    pub setting: Setting,
    /// Of a whole map. units: ms
    pub time_ms: Timing,
    /// Against the twin.
    pub error: ShadowError,
    /// Columns and rows.
    pub samples: [u32; 2],
    /// How times were measured.
    pub time_by: Clock,
    /// Name of the GPU, or of what else made the map.
    pub adapter: String,
}

/// A setting, by the names of its flags.
#[derive(Serialize, Clone, Debug, PartialEq)]
pub struct Setting {
    /// How visibility is found; `plain` and `plain-above-all` are the CPU's.
    pub method: &'static str,
    /// Strips of the light's disc; 0 = hard.
    pub strips: u32,
    /// Of the sun; none for a point light. units: degrees
    pub elevation_deg: Option<f64>,
    /// Of the sun. units: degrees
    pub angular_size_deg: Option<f64>,
    /// Of a point light. units: m
    pub radius_m: Option<f64>,
}

/// The default, as lines name it: of hard shadows, and of penumbrae.
pub(super) fn default_settings() -> Vec<serde_json::Value> {
    let default = TerrainShadow::default();
    let method = method_name(default.method);
    [0, default.penumbra_strips]
        .map(|strips| serde_json::json!({ "method": method, "strips": strips }))
        .into()
}

/// How far a map is off.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct ShadowError {
    /// Of hard shadows: texels that no correct rounding explains, of those judged.
    pub wrong_texels: Option<usize>,
    /// Of those judged, texels in the guard band.
    pub in_band: Option<usize>,
    /// Texels judged.
    pub judged_texels: Option<usize>,
    /// Of penumbrae: root of the mean squared difference from the twin's share of the light, over
    /// `penumbra_texels`.
    pub penumbra_rms: Option<f64>,
    /// Texels drawn by lot that lie in the map's penumbra or in the twin's.
    pub penumbra_texels: Option<usize>,
    /// Share of the light that all texels see on average.
    pub lit_fraction: f64,
}

/// Verdicts on texels drawn by lot.
fn verdicts(
    twin: &ShadowTwin,
    light: &GridLight,
    size: UVec2,
    count: usize,
) -> Vec<(UVec2, ShadowVerdict)> {
    let mut lot = Lot(1);
    let texels = (0..count).map(|_| lot.texel(size));
    texels.map(|at| (at, twin.judge(light, at))).collect()
}

impl ShadowError {
    fn of_hard(map: &ShadowImage, verdicts: &[(UVec2, ShadowVerdict)]) -> Self {
        let mut tally = ShadowTally::default();
        for &(at, verdict) in verdicts {
            tally.check(at, verdict, map.at(at));
        }
        Self {
            wrong_texels: Some(tally.wrong.len()),
            in_band: Some(tally.in_band),
            judged_texels: Some(tally.samples()),
            lit_fraction: lit_fraction(map),
            ..Self::default()
        }
    }

    fn of_penumbra(map: &ShadowImage, shares: &[(UVec2, f64)]) -> Self {
        let differences: Vec<f64> = shares
            .iter()
            .map(|&(at, share)| (share, map.at(at)))
            .filter(|(share, byte)| (*share > 0.0 && *share < 1.0) || (1..=254).contains(byte))
            .map(|(share, byte)| f64::from(byte) / 255.0 - share)
            .collect();
        let count = differences.len();
        let mean = differences.iter().map(|d| d * d).sum::<f64>() / count.max(1) as f64;
        Self {
            penumbra_rms: (count > 0).then_some(mean.sqrt()),
            penumbra_texels: Some(count),
            lit_fraction: lit_fraction(map),
            ..Self::default()
        }
    }
}

fn lit_fraction(map: &ShadowImage) -> f64 {
    let seen: u64 = map.visibility.iter().map(|share| u64::from(*share)).sum();
    seen as f64 / (255.0 * map.visibility.len().max(1) as f64)
}

/// A light, without and with a size.
struct Lamp {
    name: String,
    /// In words.
    what: String,
    hard: MapLight,
    sized: Vec<MapLight>,
}

fn sun_at(elevation_deg: f64, angular_size_deg: f64) -> MapLight {
    MapLight::Sun {
        sun: Sun {
            azimuth_deg: AZIMUTH_DEG,
            elevation_deg,
        },
        angular_size_deg,
    }
}

fn lamps(field: &HeightField, plan: &Plan) -> Vec<Lamp> {
    let sizes = plan.angular_sizes_deg();
    let suns = plan.elevations_deg().iter().map(|&elevation_deg| Lamp {
        name: format!("sun_{elevation_deg}"),
        what: format!("sun {elevation_deg}° high"),
        hard: sun_at(elevation_deg, 0.0),
        sized: sizes
            .iter()
            .map(|&size| sun_at(elevation_deg, size))
            .collect(),
    });
    let extent = field.extent_m().as_dvec2();
    let (lowest, highest) = field.data_range_m();
    let height = highest + 0.1 * (highest - lowest) + 0.01 * extent.max_element();
    let point = |radius_m| MapLight::Point {
        position_m: bevy::math::DVec3::new(0.4 * extent.x, height, 0.6 * extent.y),
        radius_m,
    };
    // As large, from half the field away, as the sun.
    let radius = |deg: &f64| 0.5 * extent.max_element() * (0.5 * deg).to_radians().tan();
    let lamp = Lamp {
        name: "point".into(),
        what: format!("point light at {height:.0} m"),
        hard: point(0.0),
        sized: sizes.iter().map(|size| point(radius(size))).collect(),
    };
    suns.chain([lamp]).collect()
}

/// What a map is made with.
#[derive(Clone, Copy)]
struct Job {
    method: ShadowMethod,
    strips: u32,
    light: MapLight,
    /// Which of the lamp's sizes; none for hard shadows.
    size: Option<usize>,
}

fn jobs(lamp: &Lamp, plan: &Plan) -> Vec<Job> {
    let is_sun = matches!(lamp.hard, MapLight::Sun { .. });
    let methods = METHODS
        .iter()
        .map(|(method, _)| *method)
        .filter(|method| is_sun || *method != ShadowMethod::Sweep);
    let mut jobs: Vec<Job> = methods
        .map(|method| Job {
            method,
            strips: 0,
            light: lamp.hard,
            size: None,
        })
        .collect();
    for (size, &light) in lamp.sized.iter().enumerate() {
        let mut add = |method, strips| {
            jobs.push(Job {
                method,
                strips,
                light,
                size: Some(size),
            });
        };
        // Its answers are max-mip's; what a strip costs, one tells.
        add(ShadowMethod::PerTexel, 1);
        for &strips in plan.strips() {
            add(ShadowMethod::MaxMip, strips);
        }
        if is_sun {
            // However many: a sweep takes the horizon for level across the disc.
            add(ShadowMethod::Sweep, 1);
        }
    }
    jobs
}

impl Setting {
    fn of(job: &Job) -> Self {
        let mut setting = Self {
            method: method_name(job.method),
            strips: job.strips,
            elevation_deg: None,
            angular_size_deg: None,
            radius_m: None,
        };
        match job.light {
            MapLight::Sun {
                sun,
                angular_size_deg,
            } => {
                setting.elevation_deg = Some(sun.elevation_deg);
                setting.angular_size_deg = Some(angular_size_deg);
            }
            MapLight::Point { radius_m, .. } => setting.radius_m = Some(radius_m),
        }
        setting
    }
}

/// The same ground with fewer samples: each the mean of `block`×`block`.
///
/// # Errors
/// Fewer than 2×2 would be left.
fn coarser(field: &HeightField, block: u32) -> Result<HeightField, HeightFieldError> {
    if block == 1 {
        return Ok(field.clone());
    }
    let (size, from) = (field.size() / block, field.size());
    let means = (0..size.x * size.y).map(|index| {
        let corner = UVec2::new(index % size.x, index / size.x) * block;
        let sum: f64 = (0..block * block)
            .map(|k| corner + UVec2::new(k % block, k / block))
            .map(|at| at.y as usize * from.x as usize + at.x as usize)
            .map(|index| match field.samples() {
                HeightSamples::U16(codes) => f64::from(codes[index]),
                HeightSamples::F32(heights) => f64::from(heights[index]),
            })
            .sum();
        sum / f64::from(block * block)
    });
    let texel_m = field.texel_m() * block as f32;
    match field.samples() {
        HeightSamples::U16(_) => {
            let codes = means.map(|mean| mean.round() as u16).collect();
            HeightField::from_u16(size, texel_m, field.height_range_m(), codes)
        }
        HeightSamples::F32(_) => {
            HeightField::from_f32(size, texel_m, means.map(|mean| mean as f32).collect())
        }
    }
}

/// How many samples a side one of a coarser field stands for, so that at least `side` are left.
fn block_for(field: &HeightField, side: u32) -> u32 {
    (field.size().max_element() / side)
        .min(field.size().min_element() / 2)
        .max(1)
}

/// Everything of one light.
struct Measured {
    lines: Vec<ShadowLine>,
    /// Hard shadows by each method.
    hard: Vec<(&'static str, ShadowImage)>,
}

fn measure_lamp(
    stage: &mut MapStage,
    field: &HeightField,
    twin: &ShadowTwin,
    lamp: &Lamp,
    plan: &Plan,
    progress: &ProgressBar,
) -> Result<Measured, AccuracyError> {
    let size = field.size();
    let jobs = jobs(lamp, plan);
    let mut maps = Vec::new();
    let mut times: Vec<Vec<f64>> = Vec::new();
    for job in &jobs {
        progress.set_message(format!("{} {}", lamp.name, method_name(job.method)));
        // The first waits for the driver's compiler.
        let light = job.light.over(field);
        let (map, first) = stage.cast(&light, job.method, job.strips, 1)?;
        maps.push(map);
        times.push(first.into_iter().filter(|ms| *ms > SLOW_MS).collect());
        progress.inc(1);
    }
    // Settings alternate, so that whatever else the machine does meets all of them alike.
    let slow: Vec<bool> = times.iter().map(|times| !times.is_empty()).collect();
    for _ in 0..plan.rounds() {
        for (index, job) in jobs.iter().enumerate() {
            if !slow[index] {
                let light = job.light.over(field);
                times[index].extend(stage.cast(&light, job.method, job.strips, 1)?.1);
            }
            progress.inc(1);
        }
    }
    let verdicts = verdicts(twin, &lamp.hard.over(field), size, plan.judged());
    let shares: Vec<Vec<(UVec2, f64)>> = lamp
        .sized
        .iter()
        .enumerate()
        .map(|(index, light)| {
            let of_size: Vec<&ShadowImage> = jobs
                .iter()
                .zip(&maps)
                .filter(|(job, _)| job.size == Some(index))
                .map(|(_, map)| map)
                .collect();
            penumbra(
                twin,
                &light.over(field),
                size,
                &of_size,
                plan.penumbra_texels(),
            )
        })
        .collect();
    let adapter = stage.offline.adapter();
    let mut lines = Vec::new();
    let mut hard = Vec::new();
    for ((job, map), times) in jobs.iter().zip(maps).zip(times) {
        let error = match job.size {
            None => ShadowError::of_hard(&map, &verdicts),
            Some(index) => ShadowError::of_penumbra(&map, &shares[index]),
        };
        lines.push(ShadowLine {
            effect: "shadow",
            scene: lamp.name.clone(),
            setting: Setting::of(job),
            time_ms: Timing::of(times),
            error,
            samples: size.to_array(),
            time_by: Clock::Wait,
            adapter: adapter.clone(),
        });
        if job.size.is_none() {
            hard.push((method_name(job.method), map));
        }
    }
    Ok(Measured { lines, hard })
}

/// The twin's share of the light at texels drawn by lot: as many as asked for that some map has in its penumbra,
/// and a quarter as many more wherever they are, to find what all maps miss.
fn penumbra(
    twin: &ShadowTwin,
    light: &GridLight,
    size: UVec2,
    maps: &[&ShadowImage],
    count: usize,
) -> Vec<(UVec2, f64)> {
    let mut lot = Lot(2);
    let anywhere: Vec<UVec2> = (0..count / 4).map(|_| lot.texel(size)).collect();
    let drawn = (0..DRAWS).map(|_| lot.texel(size));
    drawn
        .filter(|at| maps.iter().any(|map| (1..=254).contains(&map.at(*at))))
        .take(count)
        .chain(anywhere)
        .map(|at| (at, twin.visible_share(light, at, TWIN_STRIPS)))
        .collect()
}

/// Measures shadow maps and writes everything to a directory.
///
/// # Errors
/// [`AccuracyError`].
pub fn measure(
    field: HeightField,
    name: &str,
    plan: &Plan,
    out: &Path,
) -> Result<Summary, AccuracyError> {
    let mut report = Report::new(out, "shadow")?;
    let map_field = coarser(&field, block_for(&field, plan.side()))?;
    let lamps = lamps(&map_field, plan);
    let steps: usize = lamps.iter().map(|lamp| jobs(lamp, plan).len()).sum();
    let progress =
        ProgressBar::new((steps * (1 + plan.rounds()) + sizes::steps(&field, plan)) as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:32} {pos}/{len} {elapsed} {msg}") {
        progress.set_style(style);
    }
    let mut stage = MapStage::new(map_field.clone())?;
    let adapter = stage.offline.adapter();
    let twin = ShadowTwin::new(map_field.samples(), map_field.size());
    let mut lines = Vec::new();
    let mut maps = Vec::new();
    for lamp in &lamps {
        let mut measured = measure_lamp(&mut stage, &map_field, &twin, lamp, plan, &progress)?;
        for line in &mut measured.lines {
            line.scene = format!("{name}/{}", lamp.name);
        }
        lines.extend(measured.lines);
        maps.push(measured.hard);
    }
    let table = sizes::measure(&mut stage, &field, name, plan, &progress)?;
    drop(stage);
    progress.set_message("Blinn–Phong and PBR");
    let pictures = blinn_phong::side_by_side(coarser(&field, block_for(&field, PICTURE_SIDE))?)?;
    progress.finish_and_clear();

    report::draw_maps(&mut report, &lamps, &maps)?;
    report::draw(&mut report, name, &lamps, &lines, &table)?;
    let path = report.file(
        "blinn_phong_and_pbr.png",
        "The same view and the same shadow map: left P5b's Blinn–Phong per vertex, right Bevy's PBR per pixel",
    );
    report.save(&path, &pictures)?;
    let mut tables = table.tables();
    tables.extend(report::tables(name, &lamps, &lines));
    let highlights = table.highlights();
    lines.extend(table.into_lines());
    report.results(&lines)?;
    report.csv(&report::csv(&lines))?;
    let clock = Clock::Wait.words();
    let head = format!(
        "{name}, {}×{} samples {} m apart; settings on {}×{} of it, each the mean of a block; suns at azimuth \
         {AZIMUTH_DEG}°; {adapter}; times are the median of up to {} alternating rounds, of the whole map, by the \
         wall clock from its submission until it was done; errors at {} texels drawn by lot (hard) and up to {} \
         (penumbra, against the twin's {TWIN_STRIPS} strips).",
        field.size().x,
        field.size().y,
        field.texel_m(),
        map_field.size().x,
        map_field.size().y,
        plan.rounds(),
        plan.judged(),
        plan.penumbra_texels() * 5 / 4,
    );
    report.finish(Found {
        title: "What accuracy costs: terrain shadows",
        head: &head,
        tables: &tables,
        clock,
        adapter,
        results: lines.len(),
        highlights,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coarser_ground_is_the_mean_of_its_blocks() {
        let field =
            HeightField::from_f32(UVec2::new(4, 5), 2.0, (0..20).map(|h| h as f32).collect())
                .expect("a field can be made");
        let half = coarser(&field, 2).expect("a field can be made");
        assert_eq!((half.size(), half.texel_m()), (UVec2::new(2, 2), 4.0));
        assert_eq!(half.sample_m(0, 0), 2.5);
        assert_eq!(half.sample_m(1, 1), 12.5);
    }

    #[test]
    fn a_map_that_is_off_has_an_error() {
        let map = |byte| ShadowImage {
            size: UVec2::new(2, 2),
            visibility: vec![byte; 4],
        };
        let shares = [(UVec2::ZERO, 0.5), (UVec2::ONE, 1.0)];
        let error = ShadowError::of_penumbra(&map(255), &shares);
        assert_eq!(
            (error.penumbra_texels, error.penumbra_rms),
            (Some(1), Some(0.5))
        );
        let verdicts = [
            (UVec2::ZERO, ShadowVerdict::Dark),
            (UVec2::ONE, ShadowVerdict::Lit),
        ];
        assert_eq!(
            ShadowError::of_hard(&map(255), &verdicts).wrong_texels,
            Some(1)
        );
        assert_eq!(
            ShadowError::of_hard(&map(128), &verdicts).wrong_texels,
            Some(2)
        );
    }
}
