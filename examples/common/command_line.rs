//! What the examples' command lines share.

use std::num::NonZero;

use bevy::prelude::*;

/// A size in pixels, of the form 1280x720.
pub fn size(text: &str) -> Result<UVec2, String> {
    let (width, height) = text.split_once('x').ok_or("not of the form 1280x720")?;
    let side = |text: &str| text.parse::<u32>().ok().filter(|n| *n > 0);
    let (width, height) = side(width)
        .zip(side(height))
        .ok_or("not two whole numbers above 0")?;
    Ok(UVec2::new(width, height))
}

/// Whether there is something to open a window on. Bevy panics where there is not.
pub fn has_display() -> bool {
    let set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    !cfg!(target_os = "linux") || set("DISPLAY")
}

/// Says why nothing came of it, in one line, and how to exit: 1 if another machine would have helped, 2 if other input
/// would.
pub fn exit_with(name: &str, error: &dyn core::error::Error, machine: bool) -> AppExit {
    eprintln!("{name}: {error}");
    NonZero::new(if machine { 1 } else { 2 }).map_or(AppExit::error(), AppExit::Error)
}
