//! What accuracy costs: time and error of every setting, measured in one run on one machine, and the files that
//! show them. `skyline accuracy`.

pub mod all;
mod boxes;
pub mod budget;
pub mod contribution;
mod difference;
pub mod growth;
pub mod idle;
pub mod interior;
mod lot;
pub mod occlusion;
mod report;
pub mod scene;
pub mod shadow;
pub mod spherical;
pub mod terrain;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

pub use report::{Found, Picture, Report, ReportError, Table, utc_now};

use super::{OfflineError, plot::PlotError, render::RenderError};

/// Why an accuracy run failed.
#[derive(thiserror::Error, Debug)]
#[non_exhaustive]
pub enum AccuracyError {
    /// Nothing could be drawn.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// A plot could not be drawn.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// A file could not be written.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// The built-in scene could not be made.
    #[error("the built-in height field could not be made: {0}")]
    Field(#[from] crate::terrain::HeightFieldError),
    /// The scene could not be made.
    #[error(transparent)]
    Scene(#[from] super::scenes::SceneError),
    /// A model could not be read.
    #[error(transparent)]
    Model(#[from] super::interior::TrimError),
    /// A model could not be culled.
    #[error(transparent)]
    Interior(crate::interior::InteriorError),
    /// A workload could not be measured.
    #[error(transparent)]
    Workload(#[from] super::workload::WorkloadError),
}

impl From<OfflineError> for AccuracyError {
    fn from(error: OfflineError) -> Self {
        Self::Render(error.into())
    }
}

impl AccuracyError {
    /// Whether other input would have helped, rather than another machine.
    pub fn is_input(&self) -> bool {
        match self {
            Self::Render(error) => error.is_input(),
            Self::Workload(error) => error.is_input(),
            Self::Report(_)
            | Self::Plot(_)
            | Self::Scene(_)
            | Self::Model(_)
            | Self::Interior(_) => true,
            Self::Field(_) => false,
        }
    }
}

/// Several timings of one thing. units: ms
#[derive(Serialize, Deserialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct Timing {
    /// Half of the runs took no longer.
    pub median: f64,
    /// The quickest.
    pub min: f64,
    /// The slowest.
    pub max: f64,
    /// How many there were.
    pub runs: usize,
}

impl Timing {
    /// Of any number of timings, zero for none.
    pub fn of(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        let (Some(min), Some(max)) = (times.first(), times.last()) else {
            return Self::default();
        };
        let middle = times.len() / 2;
        let median = if times.len() % 2 == 1 {
            times[middle]
        } else {
            0.5 * (times[middle - 1] + times[middle])
        };
        Self {
            median,
            min: *min,
            max: *max,
            runs: times.len(),
        }
    }
}

/// What a run tells on stdout.
#[derive(Serialize, Clone, Debug)]
pub struct Summary {
    /// What was measured.
    pub effect: &'static str,
    /// Name of the GPU.
    pub adapter: String,
    /// How times were measured, in words.
    pub clock: &'static str,
    /// Result lines written.
    pub results: usize,
    /// Time the whole run took. units: s
    pub seconds: f64,
    /// The page that shows it all.
    pub index: PathBuf,
    /// All files written.
    pub files: Vec<PathBuf>,
    /// Those of them that are pictures, with what they show.
    pub pictures: Vec<Picture>,
    /// What was measured and how.
    pub head: String,
    /// The most telling figures.
    pub highlights: serde_json::Value,
}

/// The value below which a share of the values lies; the largest for 1, 0 for none.
fn percentile<T: Copy + Default>(sorted: &[T], share: f64) -> T {
    let last = sorted.len().saturating_sub(1);
    sorted
        .get(((share * last as f64).ceil() as usize).min(last))
        .copied()
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timings_have_a_median_whether_even_or_odd() {
        assert_eq!(Timing::of(vec![]), Timing::default());
        let odd = Timing::of(vec![3.0, 1.0, 2.0]);
        assert_eq!((odd.median, odd.min, odd.max, odd.runs), (2.0, 1.0, 3.0, 3));
        assert_eq!(Timing::of(vec![4.0, 1.0]).median, 2.5);
    }

    #[test]
    fn percentiles_are_values_that_occur() {
        let sorted: Vec<u32> = (0..1000).collect();
        assert_eq!(percentile(&sorted, 0.99), 990);
        assert_eq!(percentile(&sorted, 1.0), 999);
        assert_eq!(percentile::<u32>(&[], 0.5), 0);
    }
}
