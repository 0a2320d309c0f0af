//! The one integration-test binary.

#[path = "it/height_field.rs"]
mod height_field;
#[path = "it/loader.rs"]
mod loader;
#[path = "it/query.rs"]
mod query;
