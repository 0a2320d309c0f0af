//! Plots as PNG files: lines over two axes, and heat maps of a number per pixel.

use std::path::Path;

use bevy::math::UVec2;
use plotters::{coord::Shift, prelude::*};

use super::glyphs;

/// Why a plot could not be drawn.
#[derive(thiserror::Error, Debug)]
#[error("the plot {file} could not be drawn: {reason}")]
pub struct PlotError {
    /// Its file.
    pub file: String,
    /// The drawing library's words.
    pub reason: String,
}

/// Size of a [`LinePlot`]. units: px
const SIZE: (u32, u32) = (1100, 700);
/// From so many points on, lines have no dots.
const MANY_POINTS: usize = 60;

type Canvas<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

const GREY_300: RGBColor = RGBColor(224, 224, 224);
const GREY_600: RGBColor = RGBColor(96, 96, 96);

/// Colours that the colour-blind can tell apart (Okabe and Ito 2008).
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];

/// An axis.
#[derive(Clone, Debug)]
pub struct Axis {
    /// What it shows, with the unit.
    pub label: String,
    /// Powers of two are equally far apart. Values must be positive then.
    pub log: bool,
}

/// Points joined by lines.
#[derive(Clone, Debug)]
pub struct Series {
    /// For the legend.
    pub name: String,
    /// In the axes' units.
    pub points: Vec<(f64, f64)>,
    /// Drawn thin and dashed: somebody else's figures.
    pub quoted: bool,
}

/// Lines over two axes.
#[derive(Clone, Debug)]
pub struct LinePlot {
    /// Above the plot.
    pub title: String,
    /// Rightward.
    pub x: Axis,
    /// Upward.
    pub y: Axis,
    /// In the legend's order.
    pub series: Vec<Series>,
}

impl Axis {
    /// A linear axis.
    pub fn linear(label: impl Into<String>) -> Self {
        Self {
            label: label.into(),
            log: false,
        }
    }

    /// A logarithmic axis.
    pub fn log(label: impl Into<String>) -> Self {
        Self {
            label: label.into(),
            log: true,
        }
    }

    fn place(&self, value: f64) -> f64 {
        if self.log {
            value.max(1e-9).log2()
        } else {
            value
        }
    }

    /// Lowest and highest place, and the places to label.
    fn ticks(&self, values: impl Iterator<Item = f64>) -> (f64, f64, Vec<f64>) {
        let (mut low, mut high) = values
            .map(|value| self.place(value))
            .filter(|place| place.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
                (a.min(v), b.max(v))
            });
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        if !self.log {
            low = low.min(0.0);
        }
        let span = (high - low).max(if self.log { 1.0 } else { 1e-9 });
        let rough = span / 8.0;
        let magnitude = 10f64.powf(rough.log10().floor());
        let step = if self.log {
            rough.ceil().max(1.0)
        } else {
            [1.0, 2.0, 5.0, 10.0]
                .map(|n| n * magnitude)
                .into_iter()
                .find(|s| *s >= rough)
                .unwrap_or(rough)
        };
        let (low, high) = (
            (low / step).floor() * step,
            ((low + span) / step).ceil() * step,
        );
        let count = ((high - low) / step).round() as usize;
        (
            low,
            high,
            (0..=count).map(|i| low + i as f64 * step).collect(),
        )
    }

    fn tick_label(&self, place: f64) -> String {
        let value = if self.log { place.exp2() } else { place };
        if value == 0.0 {
            "0".into()
        } else if value.abs() >= 1.0 {
            let text = format!("{value:.1}");
            text.strip_suffix(".0").unwrap_or(&text).into()
        } else {
            let digits = (2.0 - value.abs().log10().floor()) as usize;
            let text = format!("{value:.digits$}");
            text.trim_end_matches('0').into()
        }
    }
}

/// Where a text's given point is.
#[derive(Clone, Copy)]
enum Anchor {
    Left,
    Middle,
    Right,
}

/// Draws text, its vertical middle at `at`.
fn text(
    canvas: &Canvas,
    text: &str,
    at: (i32, i32),
    anchor: Anchor,
    upward: bool,
    scale: i32,
    colour: &RGBColor,
) -> Result<(), String> {
    let width = glyphs::width(text) * scale;
    let before = match anchor {
        Anchor::Left => 0,
        Anchor::Middle => width / 2,
        Anchor::Right => width,
    };
    let (size_x, size_y) = canvas.dim_in_pixel();
    let mut result = Ok(());
    glyphs::for_each_dot(text, |x, y| {
        for i in 0..scale * scale {
            let along = x * scale + i % scale - before;
            let across = y * scale + i / scale - glyphs::HEIGHT * scale / 2;
            let (px, py) = if upward {
                (at.0 + across, at.1 - along)
            } else {
                (at.0 + along, at.1 + across)
            };
            if px >= 0 && py >= 0 && px < size_x as i32 && py < size_y as i32 {
                let drawn = canvas
                    .draw_pixel((px, py), colour)
                    .map_err(|error| error.to_string());
                if drawn.is_err() {
                    result = drawn;
                }
            }
        }
    });
    result
}

impl LinePlot {
    /// Draws it to a PNG file of 1100×700 pixels.
    ///
    /// # Errors
    /// [`PlotError`], with the file's name.
    pub fn write(&self, path: &Path) -> Result<(), PlotError> {
        self.draw(path).map_err(|reason| PlotError {
            file: path.display().to_string(),
            reason,
        })
    }

    fn draw(&self, path: &Path) -> Result<(), String> {
        let root = BitMapBackend::new(path, SIZE).into_drawing_area();
        self.draw_on(&root)?;
        root.present().map_err(|error| error.to_string())
    }

    fn draw_on(&self, root: &Canvas) -> Result<(), String> {
        let words = |error: &dyn std::fmt::Display| error.to_string();
        root.fill(&WHITE).map_err(|e| words(&e))?;
        // Text is placed within this plot, charts within the whole picture.
        let (left, above) = root.get_base_pixel();
        let within = |(x, y): (i32, i32)| (x - left, y - above);
        let all = || self.series.iter().flat_map(|series| &series.points);
        let (x_low, x_high, x_ticks) = self.x.ticks(all().map(|point| point.0));
        let (y_low, y_high, y_ticks) = self.y.ticks(all().map(|point| point.1));
        let mut chart = ChartBuilder::on(root)
            .margin_top(60)
            .margin_right(30)
            .margin_bottom(10)
            .margin_left(10)
            .set_label_area_size(LabelAreaPosition::Left, 110)
            .set_label_area_size(LabelAreaPosition::Bottom, 70)
            .build_cartesian_2d(x_low..x_high, y_low..y_high)
            .map_err(|e| words(&e))?;
        let line = |from, to| PathElement::new(vec![from, to], GREY_300);
        chart
            .draw_series(
                x_ticks
                    .iter()
                    .map(|&x| line((x, y_low), (x, y_high)))
                    .chain(y_ticks.iter().map(|&y| line((x_low, y), (x_high, y)))),
            )
            .map_err(|e| words(&e))?;
        for (index, series) in self.series.iter().enumerate() {
            let colour = COLOURS[index % COLOURS.len()];
            let points: Vec<_> = series
                .points
                .iter()
                .map(|(x, y)| (self.x.place(*x), self.y.place(*y)))
                .collect();
            if series.quoted {
                chart
                    .draw_series(DashedLineSeries::new(
                        points.iter().copied(),
                        8,
                        6,
                        colour.into(),
                    ))
                    .map_err(|e| words(&e))?;
            } else {
                chart
                    .draw_series(LineSeries::new(
                        points.iter().copied(),
                        colour.stroke_width(3),
                    ))
                    .map_err(|e| words(&e))?;
            }
            let radius = match series.points.len() {
                MANY_POINTS.. => 1,
                _ if series.quoted => 3,
                _ => 5,
            };
            chart
                .draw_series(
                    points
                        .iter()
                        .map(|&at| Circle::new(at, radius, colour.filled())),
                )
                .map_err(|e| words(&e))?;
        }
        // Where the lines run, a few places on each piece.
        let drawn: Vec<(i32, i32)> = self
            .series
            .iter()
            .flat_map(|series| {
                let pieces = series.points.windows(2);
                let last = series.points.last().map(|last| (*last, *last));
                pieces.map(|pair| (pair[0], pair[1])).chain(last)
            })
            .flat_map(|(from, to)| {
                let from = (self.x.place(from.0), self.y.place(from.1));
                let to = (self.x.place(to.0), self.y.place(to.1));
                (0..8).map(move |step| {
                    let part = f64::from(step) / 8.0;
                    (
                        from.0 + part * (to.0 - from.0),
                        from.1 + part * (to.1 - from.1),
                    )
                })
            })
            .map(|place| within(chart.backend_coord(&place)))
            .collect();
        for &x in &x_ticks {
            let (px, py) = within(chart.backend_coord(&(x, y_low)));
            text(
                root,
                &self.x.tick_label(x),
                (px, py + 16),
                Anchor::Middle,
                false,
                2,
                &BLACK,
            )?;
        }
        for &y in &y_ticks {
            let (px, py) = within(chart.backend_coord(&(x_low, y)));
            text(
                root,
                &self.y.tick_label(y),
                (px - 8, py),
                Anchor::Right,
                false,
                2,
                &BLACK,
            )?;
        }
        text(
            root,
            &self.title,
            (550, 28),
            Anchor::Middle,
            false,
            2,
            &BLACK,
        )?;
        text(
            root,
            &self.x.label,
            (610, 672),
            Anchor::Middle,
            false,
            2,
            &GREY_600,
        )?;
        text(
            root,
            &self.y.label,
            (18, 350),
            Anchor::Middle,
            true,
            2,
            &GREY_600,
        )?;
        self.legend(root, &drawn)
    }

    /// Names of the series, in their colours, in the corner where the fewest of `drawn` would be covered.
    fn legend(&self, root: &Canvas, drawn: &[(i32, i32)]) -> Result<(), String> {
        let widest = self
            .series
            .iter()
            .map(|s| glyphs::width(&s.name))
            .max()
            .unwrap_or(0)
            * 2;
        let (width, height) = (widest + 67, 8 + 24 * self.series.len() as i32);
        let corners = [
            (1062 - width, 68),
            (1062 - width, 612 - height),
            (128, 68),
            (128, 612 - height),
        ];
        let covered = |(x, y): &(i32, i32)| {
            let is_under = |at: &&(i32, i32)| {
                (*x..x + width).contains(&at.0) && (*y..y + height).contains(&at.1)
            };
            drawn.iter().filter(is_under).count()
        };
        let (x, top) = corners
            .into_iter()
            .min_by_key(covered)
            .unwrap_or(corners[0]);
        let left = x + 10;
        let frame = Rectangle::new(
            [(x, top), (x + width, top + height)],
            WHITE.mix(0.85).filled(),
        );
        root.draw(&frame).map_err(|e| e.to_string())?;
        for (index, series) in self.series.iter().enumerate() {
            let colour = COLOURS[index % COLOURS.len()];
            let y = top + 16 + 24 * index as i32;
            let thickness = if series.quoted { 1 } else { 3 };
            let stroke = PathElement::new(
                vec![(left, y), (left + 36, y)],
                colour.stroke_width(thickness),
            );
            root.draw(&stroke).map_err(|e| e.to_string())?;
            text(
                root,
                &series.name,
                (left + 46, y),
                Anchor::Left,
                false,
                2,
                &BLACK,
            )?;
        }
        Ok(())
    }
}

/// Draws plots to one PNG file, each of 1100×700 pixels, below each other.
///
/// # Errors
/// [`PlotError`], with the file's name.
pub fn write_stacked(path: &Path, plots: &[LinePlot]) -> Result<(), PlotError> {
    let drawn = || {
        let height = SIZE.1 * plots.len().max(1) as u32;
        let root = BitMapBackend::new(path, (SIZE.0, height)).into_drawing_area();
        for (plot, part) in plots.iter().zip(root.split_evenly((plots.len().max(1), 1))) {
            plot.draw_on(&part)?;
        }
        root.present().map_err(|error| error.to_string())
    };
    drawn().map_err(|reason| PlotError {
        file: path.display().to_string(),
        reason,
    })
}

/// One picture of a number per pixel.
pub struct HeatPanel<'a> {
    /// Above it.
    pub title: String,
    /// Row by row from the top left.
    pub values: &'a [u32],
}

/// Stops of the colour scale, dark to bright (after Viridis, Smith and van der Walt 2015).
const SCALE: [[f64; 3]; 6] = [
    [68.0, 1.0, 84.0],
    [65.0, 68.0, 135.0],
    [42.0, 120.0, 142.0],
    [34.0, 168.0, 132.0],
    [122.0, 209.0, 81.0],
    [253.0, 231.0, 37.0],
];

/// Colour of a share from 0 to 1.
fn scale_colour(share: f64) -> RGBColor {
    let at = share.clamp(0.0, 1.0) * (SCALE.len() - 1) as f64;
    let index = (at as usize).min(SCALE.len() - 2);
    let mix = |i: usize| {
        let (a, b) = (SCALE[index][i], SCALE[index + 1][i]);
        (a + (b - a) * (at - index as f64)).round() as u8
    };
    RGBColor(mix(0), mix(1), mix(2))
}

/// Draws panels of one size, two a row, on one logarithmic scale up to the largest value of all, with a
/// legend. Zero is black.
///
/// # Errors
/// [`PlotError`], with the file's name.
pub fn write_heat_maps(
    path: &Path,
    title: &str,
    unit: &str,
    size: UVec2,
    panels: &[HeatPanel],
) -> Result<(), PlotError> {
    draw_heat_maps(path, title, unit, size, panels).map_err(|reason| PlotError {
        file: path.display().to_string(),
        reason,
    })
}

fn draw_heat_maps(
    path: &Path,
    title: &str,
    unit: &str,
    size: UVec2,
    panels: &[HeatPanel],
) -> Result<(), String> {
    let words = |error: &dyn std::fmt::Display| error.to_string();
    // Panels are shown at most 800 pixels wide, each pixel the largest of those it stands for.
    let shrink = size.x.div_ceil(800).max(1);
    let shown = (size / shrink).max(UVec2::ONE);
    let enlarge = (480 / shown.x).max(1);
    let panel = shown * enlarge;
    let columns = panels.len().clamp(1, 2) as u32;
    let rows = panels.len().div_ceil(2).max(1) as u32;
    let (gap, head, foot) = (16, 34, 78);
    let whole = UVec2::new(
        (columns * (panel.x + gap) + gap).max(640),
        44 + rows * (panel.y + head) + foot,
    );
    let root = BitMapBackend::new(path, (whole.x, whole.y)).into_drawing_area();
    root.fill(&WHITE).map_err(|e| words(&e))?;
    let middle = whole.x as i32 / 2;
    text(&root, title, (middle, 22), Anchor::Middle, false, 2, &BLACK)?;
    let most = panels
        .iter()
        .flat_map(|p| p.values)
        .copied()
        .max()
        .unwrap_or(1)
        .max(2);
    let share = |value: f64| value.max(1.0).ln() / f64::from(most).ln();
    for (index, heat) in panels.iter().enumerate() {
        let left = gap + (index as u32 % 2) * (panel.x + gap);
        let top = 44 + (index as u32 / 2) * (panel.y + head);
        text(
            &root,
            &heat.title,
            (left as i32, top as i32 + 16),
            Anchor::Left,
            false,
            2,
            &BLACK,
        )?;
        for y in 0..shown.y {
            for x in 0..shown.x {
                let block = (0..shrink * shrink)
                    .map(|i| (x * shrink + i % shrink, y * shrink + i / shrink))
                    .filter_map(|(x, y)| heat.values.get((y * size.x + x) as usize));
                let value = block.copied().max().unwrap_or(0);
                let colour = if value == 0 {
                    BLACK
                } else {
                    scale_colour(share(f64::from(value)))
                };
                for i in 0..enlarge * enlarge {
                    let px = left + x * enlarge + i % enlarge;
                    let py = top + head + y * enlarge + i / enlarge;
                    root.draw_pixel((px as i32, py as i32), &colour)
                        .map_err(|e| words(&e))?;
                }
            }
        }
    }
    let bar = (60, whole.x as i32 - 60);
    let top = whole.y as i32 - foot as i32 + 10;
    for x in bar.0..bar.1 {
        let colour = scale_colour(f64::from(x - bar.0) / f64::from(bar.1 - bar.0));
        for y in top..top + 18 {
            root.draw_pixel((x, y), &colour).map_err(|e| words(&e))?;
        }
    }
    let mut labels = vec![most];
    let mut value = 1u32;
    while f64::from(value) * 1.6 < f64::from(most) {
        labels.push(value);
        value = value.saturating_mul(if most > 4096 {
            8
        } else if most > 64 {
            4
        } else {
            2
        });
    }
    for value in labels {
        let x = bar.0 + (share(f64::from(value)) * f64::from(bar.1 - bar.0)) as i32;
        text(
            &root,
            &value.to_string(),
            (x, top + 30),
            Anchor::Middle,
            false,
            2,
            &BLACK,
        )?;
    }
    text(
        &root,
        unit,
        (middle, top + 54),
        Anchor::Middle,
        false,
        2,
        &GREY_600,
    )?;
    root.present().map_err(|e| words(&e))
}
