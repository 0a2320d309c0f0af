//! When a comparison of many answers with a twin's counts as passed.

use core::fmt::Debug;

/// # Errors
/// In words, if any answer was wrong, if none was decided, or if more than this fraction of all was in the guard
/// band. `what` names the answers.
pub(super) fn outcome<W: Debug>(
    what: &str,
    wrong: &[W],
    decided: usize,
    in_band: usize,
    max_in_band_fraction: f64,
) -> Result<(), String> {
    let all = wrong.len() + decided + in_band;
    if let Some(first) = wrong.first() {
        Err(format!(
            "{} of {all} {what} are wrong; the first: {first:?}",
            wrong.len()
        ))
    } else if decided == 0 {
        Err(format!(
            "nothing was compared: {in_band} of {all} {what} are in the guard band"
        ))
    } else if in_band as f64 > max_in_band_fraction * all as f64 {
        Err(format!(
            "{in_band} of {all} {what} are in the guard band: too many to mean anything"
        ))
    } else {
        Ok(())
    }
}
