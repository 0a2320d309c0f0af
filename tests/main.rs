#[path = "it/height_field.rs"]
mod height_field;
