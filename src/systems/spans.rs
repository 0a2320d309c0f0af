//! What passes took on the GPU, as Bevy's `RenderDiagnosticsPlugin` has it.

use core::time::Duration;

use bevy::{
    diagnostic::{Diagnostic, DiagnosticPath, DiagnosticsStore},
    platform::time::Instant,
};

/// Over how long times are smoothed.
const SMOOTHED: Duration = Duration::from_millis(100);

/// What a span took in one frame: a pass that runs for each camera or each terrain has one measurement for each, all of
/// the same time. units: ms
pub(crate) fn in_frame(span: &Diagnostic, of: Instant) -> f64 {
    let all = span.measurements();
    all.filter(|one| one.time == of).map(|one| one.value).sum()
}

/// The diagnostics that the spans of an effect's passes appear under, made once.
///
/// A diagnostic keeps the last time of a pass however long ago that ran: only those of the newest frame that has come
/// back count, or a pass that ran once would be told of for ever.
pub(crate) struct Spans<const N: usize>([DiagnosticPath; N]);

impl<const N: usize> Spans<N> {
    /// Of these passes.
    pub fn new(passes: [&str; N]) -> Self {
        Self(passes.map(|pass| DiagnosticPath::new(format!("render/{pass}/elapsed_gpu"))))
    }

    /// What they took in the newest frame that is known; `None` where nothing is measured. units: ms
    pub fn latest_ms(&self, store: &DiagnosticsStore) -> Option<f32> {
        self.sum(store, in_frame)
    }

    /// The same, each pass by its mean over the last tenth of a second. units: ms
    pub fn smoothed_ms(&self, store: &DiagnosticsStore) -> Option<f32> {
        self.sum(store, |span, newest| {
            let (mut total, mut frames, mut last) = (0.0, 0, None);
            for one in span.measurements() {
                if newest.saturating_duration_since(one.time) > SMOOTHED {
                    continue;
                }
                total += one.value;
                if last.replace(one.time) != Some(one.time) {
                    frames += 1;
                }
            }
            total / f64::from(frames.max(1))
        })
    }

    /// Of the passes that ran in the newest frame.
    fn sum(
        &self,
        store: &DiagnosticsStore,
        value: impl Fn(&Diagnostic, Instant) -> f64,
    ) -> Option<f32> {
        let known = || {
            let spans = self.0.iter().filter_map(|path| store.get(path));
            spans.filter_map(|span| Some((span, span.measurement()?.time)))
        };
        let newest = known().map(|(_, time)| time).max()?;
        let of_newest = known().filter(|(_, time)| *time == newest);
        Some(of_newest.map(|(span, time)| value(span, time)).sum::<f64>() as f32)
    }
}

#[cfg(test)]
mod tests {
    use core::time::Duration;

    use bevy::{diagnostic::DiagnosticMeasurement, platform::time::Instant};

    use super::*;

    #[test]
    fn a_pass_that_ran_in_an_earlier_frame_does_not_count() {
        let spans = Spans::new(["once", "always", "never"]);
        let mut store = DiagnosticsStore::default();
        assert_eq!(spans.latest_ms(&store), None);
        for pass in ["once", "always", "never", "another"] {
            let path = DiagnosticPath::new(format!("render/{pass}/elapsed_gpu"));
            store.add(Diagnostic::new(path));
        }
        assert_eq!(spans.latest_ms(&store), None);
        let start = Instant::now();
        let mut frame = |number: u64, passes: &[(&str, f64)]| {
            let time = start + Duration::from_millis(number);
            for (pass, value) in passes {
                let path = DiagnosticPath::new(format!("render/{pass}/elapsed_gpu"));
                if let Some(span) = store.get_mut(&path) {
                    span.add_measurement(DiagnosticMeasurement {
                        time,
                        value: *value,
                    });
                }
            }
            spans.latest_ms(&store)
        };
        let first = frame(1, &[("once", 8.0), ("always", 2.0), ("another", 64.0)]);
        assert_eq!(first, Some(10.0));
        assert_eq!(frame(2, &[("always", 3.0), ("another", 64.0)]), Some(3.0));
    }

    #[test]
    fn a_pass_that_ran_for_several_cameras_counts_for_each() {
        let spans = Spans::new(["each"]);
        let path = || DiagnosticPath::new("render/each/elapsed_gpu");
        let mut store = DiagnosticsStore::default();
        store.add(Diagnostic::new(path()));
        let start = Instant::now();
        let mut measured = |ms: u64, values: &[f64]| {
            let time = start + Duration::from_millis(ms);
            let span = store.get_mut(&path()).unwrap();
            for value in values.iter().copied() {
                span.add_measurement(DiagnosticMeasurement { time, value });
            }
            [spans.latest_ms(&store), spans.smoothed_ms(&store)].map(Option::unwrap)
        };
        assert_eq!(measured(0, &[1.0, 2.0, 4.0]), [7.0, 7.0]);
        assert_eq!(measured(20, &[5.0, 6.0]), [11.0, 9.0]);
        // What is long ago is forgotten.
        assert_eq!(measured(110, &[1.0]), [1.0, 6.0]);
        assert_eq!(measured(500, &[3.0]), [3.0, 3.0]);
    }
}
