//! What the demo shows: a landscape made by code, and a scene around any height field; and what its command line has
//! in common with others.

pub mod command_line;
pub mod landscape;
pub mod scene;
