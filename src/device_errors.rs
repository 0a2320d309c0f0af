//! What a device says of work, told to whoever asked for the work.

use std::panic::{AssertUnwindSafe, catch_unwind};

use bevy::tasks::futures::now_or_never;
use wgpu::{Device, ErrorFilter};

/// Does what may fail on a device, and says so instead of telling the app. What other threads do is their own.
///
/// A device that was lost is silent about it, but complains of what is made of things that it did not make, and panics
/// where they are to be mapped.
///
/// # Errors
/// In the device's words.
pub(crate) fn checked<T>(device: &Device, work: impl FnOnce() -> T) -> Result<T, String> {
    let memory = device.push_error_scope(ErrorFilter::OutOfMemory);
    let validation = device.push_error_scope(ErrorFilter::Validation);
    let internal = device.push_error_scope(ErrorFilter::Internal);
    let result = catch_unwind(AssertUnwindSafe(work));
    // Natively, what they give is there at once.
    let errors = [
        now_or_never(internal.pop()),
        now_or_never(validation.pop()),
        now_or_never(memory.pop()),
    ];
    match (result, errors.into_iter().flatten().flatten().next()) {
        (Ok(result), None) => Ok(result),
        (_, Some(error)) => Err(error.to_string()),
        (Err(_), None) => Err("it was lost".into()),
    }
}
