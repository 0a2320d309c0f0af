//! Real data that tests use where it lies beside the checkout, and say so where it doesn't.

use std::path::{Path, PathBuf};

use bevy_skyline::prelude::*;

/// A file of the shared data, or `None` with the reason printed.
pub fn shared(path: &str) -> Option<PathBuf> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../shared/data")
        .join(path);
    if file.exists() {
        return Some(file);
    }
    println!("skipped: {path} of the shared data is not beside this checkout");
    None
}

/// One of the real elevation models.
pub fn elevation_model(name: &str) -> Option<HeightField> {
    let file = shared(&format!("dem/{name}.png"))?;
    Some(HeightField::from_file(&file, &HeightFieldSettings::default()).unwrap())
}
