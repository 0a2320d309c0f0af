//! P5b's table made again: the same ground with more and more samples, by the CPU and by the GPU.

use bevy::platform::time::Instant;

use super::{
    plain::{PlainEnd, PlainField},
    *,
};
use crate::offline::accuracy::{Table, report::short};

/// What P5b reports: samples a side, CPU and GPU (GeForce 6800). units: s
pub(super) const PAPER: [(u32, f64, f64); 3] =
    [(256, 2.39, 0.50), (512, 9.56, 1.81), (1024, 38.24, 7.32)];

/// What takes longer is made once. units: ms
const ONCE_MS: f64 = 20_000.0;
/// What would take longer is left out. units: ms
const MOST_MS: f64 = 30_000.0;

/// Who makes a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Maker {
    Plain(PlainEnd),
    Gpu(ShadowMethod),
}

/// In the tables' order.
pub(super) const MAKERS: [Maker; 5] = [
    Maker::Plain(PlainEnd::Border),
    Maker::Plain(PlainEnd::AboveAll),
    Maker::Gpu(ShadowMethod::PerTexel),
    Maker::Gpu(ShadowMethod::MaxMip),
    Maker::Gpu(ShadowMethod::Sweep),
];

impl Maker {
    fn name(self) -> &'static str {
        match self {
            Self::Plain(PlainEnd::Border) => "plain",
            Self::Plain(PlainEnd::AboveAll) => "plain-above-all",
            Self::Gpu(method) => method_name(method),
        }
    }

    pub(super) fn words(self) -> &'static str {
        match self {
            Self::Plain(PlainEnd::Border) => "CPU to the border",
            Self::Plain(PlainEnd::AboveAll) => "CPU to above all",
            Self::Gpu(method) => method_name(method),
        }
    }

    /// By how much its time grows at most when there are twice the samples a side.
    fn growth(self) -> f64 {
        match self {
            Self::Gpu(ShadowMethod::Sweep | ShadowMethod::MaxMip) => 4.0,
            _ => 8.0,
        }
    }
}

/// Times of one size and sun, in the order of [`MAKERS`].
pub(super) struct Row {
    pub(super) side: u32,
    pub(super) elevation_deg: f64,
    pub(super) lines: [Option<ShadowLine>; MAKERS.len()],
    /// Cells that the CPU looked at on the way to the border.
    cells: Option<u64>,
}

impl Row {
    /// A maker's median. units: ms
    pub(super) fn ms(&self, maker: Maker) -> Option<f64> {
        let index = MAKERS.iter().position(|m| *m == maker)?;
        self.lines[index].as_ref().map(|line| line.time_ms.median)
    }

    fn ratio(&self, slow: Maker, quick: Maker) -> Option<f64> {
        Some(self.ms(slow)? / self.ms(quick)?)
    }
}

/// P5b's table.
pub(super) struct Sizes {
    pub(super) rows: Vec<Row>,
}

fn sides(field: &HeightField, plan: &Plan) -> Vec<u32> {
    let all: &[u32] = if plan.quick {
        &[32, 64, 128]
    } else {
        &[256, 512, 1024, 2048, 4096]
    };
    let largest = field.size().max_element();
    all.iter()
        .copied()
        .filter(|side| *side <= largest)
        .collect()
}

pub(super) fn elevations_deg(plan: &Plan) -> &'static [f64] {
    if plan.quick { &[45.0] } else { &[45.0, 20.0] }
}

/// How often progress is told.
pub(super) fn steps(field: &HeightField, plan: &Plan) -> usize {
    sides(field, plan).len() * elevations_deg(plan).len()
}

pub(super) fn measure(
    stage: &mut MapStage,
    field: &HeightField,
    name: &str,
    plan: &Plan,
    progress: &ProgressBar,
) -> Result<Sizes, AccuracyError> {
    let mut rows: Vec<Row> = Vec::new();
    for side in sides(field, plan) {
        let field = coarser(field, block_for(field, side))?;
        stage.replace(field.clone());
        for &elevation_deg in elevations_deg(plan) {
            progress.set_message(format!("{side}x{side}, sun {elevation_deg} degrees high"));
            let before = rows
                .iter()
                .rfind(|row| row.elevation_deg == elevation_deg)
                .map(|row| {
                    let grown = (f64::from(side) / f64::from(row.side)).log2();
                    MAKERS.map(|maker| {
                        row.ms(maker)
                            .map_or(f64::INFINITY, |ms| ms * maker.growth().powf(grown))
                    })
                });
            let takes = before.unwrap_or([0.0; MAKERS.len()]);
            let mut row = measure_row(stage, &field, elevation_deg, plan, takes)?;
            for line in row.lines.iter_mut().flatten() {
                let [w, h] = line.samples;
                line.scene = format!("{name}/{w}x{h}/sun_{elevation_deg}");
            }
            row.side = side;
            rows.push(row);
            progress.inc(1);
        }
    }
    Ok(Sizes { rows })
}

fn measure_row(
    stage: &mut MapStage,
    field: &HeightField,
    elevation_deg: f64,
    plan: &Plan,
    takes: [f64; MAKERS.len()],
) -> Result<Row, AccuracyError> {
    let size = field.size();
    let map_light = sun_at(elevation_deg, 0.0);
    let light = map_light.over(field);
    let heights: Vec<f32> = match field.samples() {
        HeightSamples::U16(codes) => codes.iter().map(|code| f32::from(*code)).collect(),
        HeightSamples::F32(heights) => heights.clone(),
    };
    let plain = PlainField {
        heights: &heights,
        width: size.x as usize,
        height: size.y as usize,
    };
    let direction = light
        .ray(bevy::math::DVec3::ZERO)
        .map_or([1.0, 0.0, 0.0], |ray| ray.direction.to_array());
    // The field's upload is not to be part of anything.
    stage.cast(&light, ShadowMethod::Sweep, 0, 1)?;
    let mut cells = None;
    let mut make = |maker: Maker| -> Result<(ShadowImage, f64), AccuracyError> {
        match maker {
            Maker::Plain(end) => {
                let start = Instant::now();
                let (visibility, looked_at) = plain.cast(direction, end);
                let ms = start.elapsed().as_secs_f64() * 1e3;
                if end == PlainEnd::Border {
                    cells = Some(looked_at);
                }
                Ok((ShadowImage { size, visibility }, ms))
            }
            Maker::Gpu(method) => {
                let (map, times) = stage.cast(&light, method, 0, 1)?;
                Ok((map, times.into_iter().sum()))
            }
        }
    };
    let mut maps = [const { None }; MAKERS.len()];
    let mut times = [const { Vec::new() }; MAKERS.len()];
    // Makers alternate, so that whatever else the machine does meets all of them alike.
    for round in 0..plan.rounds() {
        for (index, maker) in MAKERS.into_iter().enumerate() {
            let slow = times[index].last().is_some_and(|ms| *ms > ONCE_MS);
            if takes[index] > MOST_MS || (round > 0 && slow) {
                continue;
            }
            let (map, ms) = make(maker)?;
            maps[index].get_or_insert(map);
            times[index].push(ms);
        }
    }
    let twin = ShadowTwin::new(field.samples(), size);
    let verdicts = verdicts(&twin, &light, size, plan.judged() / 10);
    let adapter = stage.offline.adapter();
    let mut lines = [const { None }; MAKERS.len()];
    for (index, (maker, times)) in MAKERS.into_iter().zip(times).enumerate() {
        lines[index] = maps[index].as_ref().map(|map| ShadowLine {
            effect: "shadow",
            scene: String::new(),
            setting: Setting {
                method: maker.name(),
                strips: 0,
                elevation_deg: Some(elevation_deg),
                angular_size_deg: Some(0.0),
                radius_m: None,
            },
            time_ms: Timing::of(times),
            error: ShadowError::of_hard(map, &verdicts),
            samples: size.to_array(),
            time_by: Clock::Wait,
            adapter: match maker {
                Maker::Plain(_) => "CPU, one thread".into(),
                Maker::Gpu(_) => adapter.clone(),
            },
        });
    }
    Ok(Row {
        side: 0,
        elevation_deg,
        lines,
        cells,
    })
}

const CPU: Maker = Maker::Plain(PlainEnd::Border);
const CPU_ABOVE: Maker = Maker::Plain(PlainEnd::AboveAll);
const PER_TEXEL: Maker = Maker::Gpu(ShadowMethod::PerTexel);
const MAX_MIP: Maker = Maker::Gpu(ShadowMethod::MaxMip);
const SWEEP: Maker = Maker::Gpu(ShadowMethod::Sweep);

impl Sizes {
    /// A maker's time with four times the samples a side, over its time without: 16 is linear in the samples.
    fn growth(&self, row: &Row, maker: Maker) -> Option<f64> {
        let small = self
            .rows
            .iter()
            .find(|small| small.side * 4 == row.side && small.elevation_deg == row.elevation_deg)?;
        Some(row.ms(maker)? / small.ms(maker)?)
    }

    pub(super) fn tables(&self) -> Vec<Table> {
        let number = |value: Option<f64>| value.map_or_else(|| "–".into(), short);
        let mut elevations: Vec<f64> = self.rows.iter().map(|row| row.elevation_deg).collect();
        elevations.dedup();
        elevations.sort_by(f64::total_cmp);
        elevations.dedup();
        let of = |elevation: f64| {
            self.rows
                .iter()
                .filter(move |row| row.elevation_deg == elevation)
        };
        elevations
            .iter()
            .rev()
            .flat_map(|&elevation| {
                let times = of(elevation).map(|row| {
                    let paper = PAPER.iter().find(|paper| paper.0 == row.side);
                    let mut cells = vec![format!("{}²", row.side)];
                    cells.extend(MAKERS.map(|maker| number(row.ms(maker))));
                    cells.extend([
                        number(row.ratio(CPU, PER_TEXEL)),
                        number(row.ratio(CPU, MAX_MIP)),
                        number(row.ratio(CPU_ABOVE, PER_TEXEL)),
                        number(row.ratio(CPU_ABOVE, MAX_MIP)),
                        number(paper.map(|paper| paper.1 * 1e3)),
                        number(paper.map(|paper| paper.2 * 1e3)),
                        number(paper.map(|paper| paper.1 / paper.2)),
                    ]);
                    cells
                });
                let mut heads = vec!["samples".to_owned()];
                heads.extend(MAKERS.map(|maker| format!("{} ms", maker.words())));
                heads.extend(
                    [
                        "CPU:per-texel",
                        "CPU:max-mip",
                        "CPU above all:per-texel",
                        "CPU above all:max-mip",
                        "CPU in P5b ms",
                        "GPU in P5b ms",
                        "CPU:GPU in P5b",
                    ]
                    .map(str::to_owned),
                );
                let growth = of(elevation)
                    .filter(|row| MAKERS.iter().any(|m| self.growth(row, *m).is_some()))
                    .map(|row| {
                        let mut cells = vec![format!("{}² → {}²", row.side / 4, row.side)];
                        cells.extend(MAKERS.map(|maker| number(self.growth(row, maker))));
                        cells
                    });
                let mut growth_heads = vec!["samples".to_owned()];
                growth_heads.extend(MAKERS.map(|maker| maker.words().to_owned()));
                let wrong = of(elevation).map(|row| {
                    let mut cells = vec![format!("{}²", row.side)];
                    cells.extend(row.lines.iter().map(|line| {
                        let error = line.as_ref().map(|line| line.error);
                        let count = |n: Option<usize>| n.map_or_else(|| "–".into(), |n| n.to_string());
                        count(error.and_then(|error| error.wrong_texels))
                    }));
                    let judged = row.lines.iter().flatten().next();
                    cells.push(judged.map_or_else(
                        || "–".into(),
                        |line| {
                            let error = line.error;
                            format!(
                                "{} of {}",
                                error.in_band.unwrap_or(0),
                                error.judged_texels.unwrap_or(0)
                            )
                        },
                    ));
                    cells
                });
                let mut wrong_heads = growth_heads.clone();
                wrong_heads.push("in the guard band".into());
                [
                    (
                        format!(
                            "P5b's table, sun {elevation}° high, hard shadows (CPU: one thread, f32; the GPU's \
                             rays end above all too; left out: what would take more than {} s)",
                            MOST_MS / 1e3
                        ),
                        heads,
                        times.collect(),
                    ),
                    (
                        format!("Times longer with 16 times the samples, sun {elevation}° high"),
                        growth_heads,
                        growth.collect(),
                    ),
                    (
                        format!("Wrong texels of these maps, sun {elevation}° high"),
                        wrong_heads,
                        wrong.collect::<Vec<_>>(),
                    ),
                ]
            })
            .filter(|(_, _, rows)| !rows.is_empty())
            .collect()
    }

    pub(super) fn highlights(&self) -> serde_json::Value {
        let rows = self.rows.iter().map(|row| {
            serde_json::json!({
                "samples": row.side,
                "elevation_deg": row.elevation_deg,
                "cpu_ns_per_cell": row.ms(CPU).zip(row.cells).map(|(ms, cells)| 1e6 * ms / cells as f64),
                "cpu_to_per_texel": row.ratio(CPU, PER_TEXEL),
                "cpu_to_max_mip": row.ratio(CPU, MAX_MIP),
                "cpu_above_all_to_per_texel": row.ratio(CPU_ABOVE, PER_TEXEL),
                "cpu_above_all_to_max_mip": row.ratio(CPU_ABOVE, MAX_MIP),
                "sweep_growth_from_a_quarter": self.growth(row, SWEEP),
            })
        });
        rows.collect::<Vec<_>>().into()
    }

    pub(super) fn into_lines(self) -> impl Iterator<Item = ShadowLine> {
        self.rows.into_iter().flat_map(|row| row.lines).flatten()
    }
}
