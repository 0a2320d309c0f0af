//! What passes took on the GPU, as Bevy's `RenderDiagnosticsPlugin` has it.

use bevy::diagnostic::{Diagnostic, DiagnosticPath, DiagnosticsStore};

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
        self.sum(store, Diagnostic::value)
    }

    /// The same, smoothed pass by pass. units: ms
    pub fn smoothed_ms(&self, store: &DiagnosticsStore) -> Option<f32> {
        self.sum(store, Diagnostic::smoothed)
    }

    fn sum(
        &self,
        store: &DiagnosticsStore,
        value: impl Fn(&Diagnostic) -> Option<f64>,
    ) -> Option<f32> {
        let known = || {
            let spans = self.0.iter().filter_map(|path| store.get(path));
            spans.filter_map(|span| Some((span.measurement()?.time, value(span)?)))
        };
        let newest = known().map(|(time, _)| time).max()?;
        let of_newest = known().filter(|(time, _)| *time == newest);
        Some(of_newest.map(|(_, ms)| ms).sum::<f64>() as f32)
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
}
