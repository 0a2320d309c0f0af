//! The files an accuracy run leaves: results, tables, and one page that shows everything.

use std::{
    fmt::Write,
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

use bevy::platform::time::Instant;
use serde::{Deserialize, Serialize};

use super::{AccuracyError, Summary};

/// A table: title, heads, rows.
pub type Table = (String, Vec<String>, Vec<Vec<String>>);

/// A cell that may be empty.
pub fn optional(value: Option<impl ToString>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

/// Why a file could not be written.
#[derive(thiserror::Error, Debug)]
#[error("cannot write {}: {reason}; choose another directory with --out", path.display())]
pub struct ReportError {
    /// The file or directory.
    pub path: PathBuf,
    /// What is in the way.
    pub reason: String,
}

/// A picture for pages.
#[derive(Serialize, Deserialize, Clone, Debug, PartialEq)]
pub struct Picture {
    /// File in the report's directory.
    pub file: String,
    /// What it shows.
    pub what: String,
}

/// What was found, in the end.
pub struct Found<'a> {
    /// Heading of the page.
    pub title: &'a str,
    /// What was measured and how, in a sentence.
    pub head: &'a str,
    /// All figures.
    pub tables: &'a [Table],
    /// How times were measured, in words.
    pub clock: &'static str,
    /// Name of what did the work.
    pub adapter: String,
    /// Result lines written.
    pub results: usize,
    /// The most telling figures.
    pub highlights: serde_json::Value,
}

/// A directory being filled.
pub struct Report {
    out: PathBuf,
    effect: &'static str,
    began: Instant,
    files: Vec<PathBuf>,
    pictures: Vec<Picture>,
}

impl Report {
    /// Makes the directory, if need be, and makes sure that it can be written to.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn new(out: &Path, effect: &'static str) -> Result<Self, ReportError> {
        let report = Self {
            out: out.to_owned(),
            effect,
            began: Instant::now(),
            files: Vec::new(),
            pictures: Vec::new(),
        };
        std::fs::create_dir_all(out).map_err(|error| failed(out, &error))?;
        // Found out now rather than after minutes of measuring.
        let probe = out.join(".skyline_probe");
        std::fs::write(&probe, "").map_err(|error| failed(out, &error))?;
        let _ = std::fs::remove_file(&probe);
        Ok(report)
    }

    /// Path for a picture that the page will show.
    pub fn file(&mut self, name: &str, what: &str) -> PathBuf {
        let path = self.out.join(name);
        self.files.push(path.clone());
        self.pictures.push(Picture {
            file: name.to_owned(),
            what: what.to_owned(),
        });
        path
    }

    /// Writes a picture beside its reference, and what differs in red.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn compare(
        &mut self,
        name: &str,
        what: &str,
        reference: &image::RgbImage,
        result: &image::RgbImage,
    ) -> Result<(), ReportError> {
        let what = format!("{what}; left the reference, right what differs");
        let path = self.file(name, &what);
        self.save(&path, &beside(reference, result))
    }

    /// Writes a picture.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn save(&self, path: &Path, picture: &image::RgbImage) -> Result<(), ReportError> {
        picture
            .save_with_format(path, image::ImageFormat::Png)
            .map_err(|error| failed(path, &error))
    }

    /// Writes tables and page, and says what there is now.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn finish(mut self, found: Found) -> Result<Summary, AccuracyError> {
        let Found {
            title,
            head,
            tables,
            clock,
            adapter,
            results,
            highlights,
        } = found;
        self.tables(head, tables)?;
        let index = self.index(title, head, tables)?;
        Ok(Summary {
            effect: self.effect,
            adapter,
            clock,
            results,
            seconds: self.began.elapsed().as_secs_f64(),
            index,
            files: self.files,
            pictures: self.pictures,
            head: head.to_owned(),
            highlights,
        })
    }

    fn write(&mut self, name: &str, text: &str) -> Result<PathBuf, ReportError> {
        let path = self.out.join(name);
        std::fs::write(&path, text).map_err(|error| failed(&path, &error))?;
        self.files.push(path.clone());
        Ok(path)
    }

    /// Writes `results.jsonl`: a line for each setting.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn results(&mut self, lines: &[impl Serialize]) -> Result<(), ReportError> {
        let mut text = String::new();
        for line in lines {
            let line = serde_json::to_string(line)
                .map_err(|error| failed(&self.out.join("results.jsonl"), &error))?;
            text.push_str(&line);
            text.push('\n');
        }
        self.write("results.jsonl", &text).map(drop)
    }

    /// Writes `results.csv`.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn csv(&mut self, (_, heads, rows): &Table) -> Result<(), ReportError> {
        self.write("results.csv", &csv_text(heads, rows)).map(drop)
    }

    /// Writes `table.md`, ready for the docs, and `tables.json` for pages.
    ///
    /// # Errors
    /// [`ReportError`].
    fn tables(&mut self, head: &str, tables: &[Table]) -> Result<(), ReportError> {
        let mut text = format!("{head} Measured on {}.\n", utc_now());
        for (title, heads, rows) in tables {
            let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
            let _ = write!(
                text,
                "\n### {title}\n\n{}|{}\n",
                line(heads),
                "---|".repeat(heads.len())
            );
            for row in rows {
                text.push_str(&line(row));
            }
        }
        self.write("table.md", &text)?;
        let json = serde_json::to_string(tables)
            .map_err(|error| failed(&self.out.join("tables.json"), &error))?;
        self.write("tables.json", &json).map(drop)
    }

    /// Writes `index.html`, with every picture and table; returns its path.
    ///
    /// # Errors
    /// [`ReportError`].
    fn index(&mut self, title: &str, head: &str, tables: &[Table]) -> Result<PathBuf, ReportError> {
        let mut text = format!(
            "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>{title}</title>\n\
             <style>body{{font:15px/1.5 system-ui,sans-serif;max-width:1500px;margin:2em auto;padding:0 1em}}\
             img{{max-width:100%;border:1px solid #ccc}}figure{{margin:2em 0}}\
             table{{border-collapse:collapse;display:block;overflow-x:auto;font-size:13px}}\
             td,th{{border:1px solid #ccc;padding:.2em .6em;text-align:right;white-space:nowrap}}\
             th{{background:#f3f3f3}}td:first-child,th:first-child{{text-align:left}}</style>\n\
             <h1>{title}</h1>\n<p>{head} Measured on {date}.</p>\n\
             <p>Numbers: <a href=\"results.jsonl\">results.jsonl</a>, <a href=\"results.csv\">results.csv</a>, \
             <a href=\"table.md\">table.md</a>. Effect: {effect}.</p>\n",
            title = escaped(title),
            head = escaped(head),
            date = utc_now(),
            effect = self.effect,
        );
        for Picture { file, what } in &self.pictures {
            let what = escaped(what);
            let _ = writeln!(
                text,
                "<figure><img src=\"{file}\" alt=\"{what}\"><figcaption>{what}</figcaption></figure>"
            );
        }
        for (title, heads, rows) in tables {
            let cells = |tag: &str, row: &[String]| {
                row.iter()
                    .map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell)))
                    .collect::<String>()
            };
            let _ = writeln!(
                text,
                "<h2>{}</h2>\n<table><tr>{}</tr>",
                escaped(title),
                cells("th", heads)
            );
            for row in rows {
                let _ = writeln!(text, "<tr>{}</tr>", cells("td", row));
            }
            text.push_str("</table>\n");
        }
        text.push_str("</html>\n");
        self.write("index.html", &text)
    }
}

/// A table as comma-separated values.
pub(super) fn csv_text(heads: &[String], rows: &[Vec<String>]) -> String {
    let quoted = |cell: &String| {
        if cell.contains([',', '"', '\n']) {
            format!("\"{}\"", cell.replace('"', "\"\""))
        } else {
            cell.clone()
        }
    };
    let mut text = String::new();
    for row in std::iter::once(heads).chain(rows.iter().map(Vec::as_slice)) {
        text.push_str(&row.iter().map(quoted).collect::<Vec<_>>().join(","));
        text.push('\n');
    }
    text
}

/// The reference, the result, and what differs between them in red.
fn beside(reference: &image::RgbImage, result: &image::RgbImage) -> image::RgbImage {
    let (width, height) = reference.dimensions();
    image::RgbImage::from_fn(3 * width, height, |x, y| {
        let at = x % width;
        let (a, b) = (reference.get_pixel(at, y), result.get_pixel_checked(at, y));
        match x / width {
            0 => *a,
            1 => b.copied().unwrap_or(image::Rgb([0; 3])),
            _ if Some(a) != b => image::Rgb([220, 0, 0]),
            _ => image::Rgb(a.0.map(|value| 192 + value / 4)),
        }
    })
}

pub(super) fn failed(path: &Path, reason: &dyn std::fmt::Display) -> ReportError {
    ReportError {
        path: path.to_owned(),
        reason: reason.to_string(),
    }
}

pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// Three significant digits.
pub(super) fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let digits = (2.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').into()
    } else {
        text
    }
}

/// Date and time of day, by this machine's clock: `2026-01-31 12:00 UTC`.
pub fn utc_now() -> String {
    let seconds = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |past| past.as_secs());
    let (year, month, day) = civil(seconds / 86_400);
    let (hour, minute) = (seconds / 3_600 % 24, seconds / 60 % 60);
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02} UTC")
}

/// Year, month and day of a number of days after 1970-01-01 (Hinnant, "chrono-compatible low-level date
/// algorithms", 2013).
fn civil(days: u64) -> (u64, u64, u64) {
    let shifted = days + 719_468;
    let era = shifted / 146_097;
    let of_era = shifted % 146_097;
    let year_of_era = (of_era - of_era / 1_460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 {
        from_march + 3
    } else {
        from_march - 9
    };
    (era * 400 + year_of_era + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_right_about_leap_years() {
        assert_eq!(civil(0), (1970, 1, 1));
        assert_eq!(civil(11_016), (2000, 2, 29));
        assert_eq!(civil(19_782), (2024, 2, 29));
        assert_eq!(civil(20_454), (2026, 1, 1));
    }

    #[test]
    fn what_differs_is_red_and_nothing_else() {
        let reference = image::RgbImage::from_pixel(2, 1, image::Rgb([40, 80, 120]));
        let mut result = reference.clone();
        result.put_pixel(1, 0, image::Rgb([40, 80, 121]));
        let all = beside(&reference, &result);
        assert_eq!(all.dimensions(), (6, 1));
        assert_eq!(all.get_pixel(3, 0), result.get_pixel(1, 0));
        assert_eq!(all.get_pixel(4, 0).0, [202, 212, 222]);
        assert_eq!(all.get_pixel(5, 0).0, [220, 0, 0]);
    }

    #[test]
    fn numbers_are_short_but_not_wrong() {
        assert_eq!(short(0.0), "0");
        assert_eq!(short(1234.5), "1234");
        assert_eq!(short(42.51), "42.5");
        assert_eq!(short(0.001_234), "0.00123");
        assert_eq!(short(100.0), "100");
    }
}
