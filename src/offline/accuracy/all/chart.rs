//! Time against error as a drawing within a page.

use std::fmt::Write;

use super::super::report::{escaped, short};

/// Size of a drawing. units: px
const SIZE: [f64; 2] = [640.0, 380.0];
/// Room for labels: left, above, right, below. units: px
const ROOM: [f64; 4] = [64.0, 14.0, 14.0, 46.0];
/// What a number below the drawing takes. units: px
const LABEL: f64 = 50.0;
/// Errors of zero stand apart, so wide. units: px
const ZERO: f64 = 44.0;
/// Colours that the colour-blind can tell apart (Okabe and Ito 2008).
pub const COLOURS: [&str; 6] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9",
];

/// A measured setting.
#[derive(Clone, Debug)]
pub struct Dot {
    /// Number in the table.
    pub number: usize,
    /// In words.
    pub name: String,
    /// units: ms
    pub ms: f64,
    /// How far off.
    pub error: f64,
    /// Which colour it has; grey without one.
    pub kind: Option<usize>,
    /// Whether users get it without asking.
    pub is_default: bool,
    /// Whether none is better in time and this error.
    pub on_front: bool,
}

/// All settings of one scene by one measure of error.
#[derive(Clone, Debug)]
pub struct Chart {
    /// The error and its unit.
    pub error: String,
    /// The settings.
    pub dots: Vec<Dot>,
}

/// An axis of powers of two, from the least value to the greatest, with room on both sides.
struct Scale {
    low: f64,
    span: f64,
    from: f64,
    to: f64,
}

impl Scale {
    fn over(values: impl Iterator<Item = f64> + Clone, from: f64, to: f64) -> Self {
        let values = values.filter(|value| *value > 0.0 && value.is_finite());
        let low = values.clone().fold(f64::INFINITY, f64::min);
        let high = values.fold(0.0, f64::max);
        let (low, high) = if low <= high {
            (low.log2(), high.log2())
        } else {
            (0.0, 1.0)
        };
        let room = 0.08 * (high - low).max(0.5);
        Self {
            low: low - room,
            span: high - low + 2.0 * room,
            from,
            to,
        }
    }

    fn at(&self, value: f64) -> f64 {
        let share = (value.log2() - self.low) / self.span;
        self.from + share * (self.to - self.from)
    }

    /// Values to label: 1, 2 and 5 of each power of ten, thinned until at most eight are left.
    fn ticks(&self) -> Vec<f64> {
        let decades = (self.low * core::f64::consts::LOG10_2).floor() as i32
            ..=((self.low + self.span) * core::f64::consts::LOG10_2).ceil() as i32;
        for kept in [
            &[1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0][..],
            &[1.0, 1.5, 2.0, 3.0, 5.0, 7.0],
            &[1.0, 2.0, 5.0],
            &[1.0, 3.0],
            &[1.0],
        ] {
            let ticks: Vec<f64> = decades
                .clone()
                .flat_map(|decade| kept.iter().map(move |k| k * 10f64.powi(decade)))
                .filter(|tick| (0.0..=1.0).contains(&((tick.log2() - self.low) / self.span)))
                .collect();
            if ticks.len() <= 8 || kept.len() == 1 {
                let step = ticks.len().div_ceil(8).max(1);
                return ticks.into_iter().step_by(step).collect();
            }
        }
        Vec::new()
    }
}

impl Chart {
    /// As an `svg` element.
    pub fn svg(&self) -> String {
        let [width, height] = SIZE;
        let [left, above, right, below] = ROOM;
        let has_zero = self.dots.iter().any(|dot| dot.error <= 0.0);
        let from = left + if has_zero { ZERO } else { 0.0 };
        let x = Scale::over(self.dots.iter().map(|dot| dot.error), from, width - right);
        let y = Scale::over(self.dots.iter().map(|dot| dot.ms), height - below, above);
        let place = |dot: &Dot| {
            let across = if dot.error > 0.0 {
                x.at(dot.error)
            } else {
                left + 0.5 * ZERO
            };
            (across, y.at(dot.ms))
        };
        let mut svg = format!(
            "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"time against {}\">",
            escaped(&self.error)
        );
        let base = height - below;
        for tick in y.ticks() {
            let at = y.at(tick);
            let _ = write!(
                svg,
                "<path class=\"grid\" d=\"M{left} {at:.1}H{}\"/><text x=\"{}\" y=\"{:.1}\" class=\"end\">{}</text>",
                width - right,
                left - 6.0,
                at + 4.0,
                short(tick)
            );
        }
        let has_more = self.dots.iter().any(|dot| dot.error > 0.0);
        let mut free = f64::NEG_INFINITY;
        for tick in x.ticks().into_iter().filter(|_| has_more) {
            let at = x.at(tick);
            if at < free {
                continue;
            }
            free = at + LABEL;
            let _ = write!(
                svg,
                "<path class=\"grid\" d=\"M{at:.1} {above}V{base}\"/><text x=\"{at:.1}\" y=\"{}\" class=\"mid\">{}</text>",
                base + 16.0,
                short(tick)
            );
        }
        if has_zero {
            let _ = write!(
                svg,
                "<path class=\"grid\" d=\"M{0:.1} {above}V{base}\"/><text x=\"{0:.1}\" y=\"{1}\" class=\"mid\">0</text>",
                left + 0.5 * ZERO,
                base + 16.0
            );
        }
        let _ = write!(
            svg,
            "<text x=\"{}\" y=\"{}\" class=\"mid\">{}</text><text class=\"mid\" transform=\"translate(14 {}) rotate(-90)\">ms</text>",
            0.5 * (left + width - right),
            height - 8.0,
            escaped(&self.error),
            0.5 * (above + base)
        );
        let mut front: Vec<&Dot> = self.dots.iter().filter(|dot| dot.on_front).collect();
        front.sort_by(|a, b| a.error.total_cmp(&b.error));
        let mut line = String::new();
        for (at, dot) in front.iter().enumerate() {
            let (across, up) = place(dot);
            // Between two of the front there is nothing measured: it goes along, then up.
            let _ = if at == 0 {
                write!(line, "M{across:.1} {up:.1}")
            } else {
                write!(line, "H{across:.1}V{up:.1}")
            };
        }
        let _ = write!(svg, "<path class=\"front\" d=\"{line}\"/>");
        for dot in &self.dots {
            let (across, up) = place(dot);
            let colour = dot
                .kind
                .map_or("#9a9a9a", |kind| COLOURS[kind % COLOURS.len()]);
            let _ = write!(
                svg,
                "<g><title>{}: {}: {} ms, {} {}</title>",
                dot.number,
                escaped(&dot.name),
                short(dot.ms),
                short(dot.error),
                escaped(&self.error)
            );
            if dot.is_default {
                let _ = write!(
                    svg,
                    "<circle cx=\"{across:.1}\" cy=\"{up:.1}\" r=\"9\" class=\"ring\"/>"
                );
            }
            let _ = write!(
                svg,
                "<circle cx=\"{across:.1}\" cy=\"{up:.1}\" r=\"4.5\" fill=\"{colour}\"/>"
            );
            if dot.is_default || dot.on_front {
                let _ = write!(
                    svg,
                    "<text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                    across + 8.0,
                    up - 6.0,
                    dot.number
                );
            }
            svg.push_str("</g>");
        }
        svg.push_str("</svg>");
        svg
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dot(ms: f64, error: f64) -> Dot {
        Dot {
            number: 1,
            name: "a < b".into(),
            ms,
            error,
            kind: None,
            is_default: true,
            on_front: true,
        }
    }

    #[test]
    fn dots_are_within_the_drawing_whatever_their_values() {
        for dots in [
            vec![],
            vec![dot(1.0, 0.0)],
            vec![dot(1e-3, 1e-9), dot(1e4, 1e3), dot(5.0, 0.0)],
        ] {
            let count = dots.len();
            let svg = Chart {
                error: "px".into(),
                dots,
            }
            .svg();
            assert!(!svg.contains("NaN") && !svg.contains("inf") && !svg.contains("a < b"));
            let mut seen = 0;
            for part in svg.split("cx=\"").skip(1) {
                let value = |text: &str| text.split('"').next().and_then(|t| t.parse::<f64>().ok());
                let (x, y) = (value(part), part.split("cy=\"").nth(1).and_then(value));
                assert!(x.is_some_and(|x| (0.0..=SIZE[0]).contains(&x)));
                assert!(y.is_some_and(|y| (0.0..=SIZE[1]).contains(&y)));
                seen += 1;
            }
            assert_eq!(seen, 2 * count);
        }
    }
}
