//! Interior culling (P5a): what cannot be seen from anywhere outside a model is taken out of it.
//!
//! # How it goes
//! 1. **Lattice** ([`lattice`]). Points at one spacing in all axes around the model; its vertices are snapped to 1/256 of
//!    the spacing, so that everything after is integer arithmetic, the same on every device.
//! 2. **Directed distance field** ([`field`]). P5a stores for each point the distance to the first surface in six
//!    directions, and then asks of each whether it exceeds the spacing. That answer is all that is kept: one bit for each
//!    step from a point to a neighbour, set if a surface is in the way. On the CPU or the GPU ([`gpu`]), with the same bits.
//! 3. **Front propagation** ([`front`]). From the outermost points, step by step where nothing is in the way: the points
//!    that are *outside*.
//! 4. **Extraction** (`extract.rs`). [`InteriorMode::Sampled`]: the surfaces that are met first on a step from an outside point to
//!    one that is not. [`InteriorMode::Conservative`]: every triangle that comes within 1½ spacings, in every axis, of an outside
//!    point.
//!
//! # What is guaranteed
//! Let a *cell* be the model's longest side over [`InteriorGrid::Resolution`], and the *gap* √3 cells. With
//! [`InteriorMode::Conservative`] and two-sided surfaces **what a ball of the gap's diameter can touch, that comes from outside and
//! on its way cuts no surface, stays.** What is seen but cannot be touched so, deep in a groove narrower than the gap for
//! instance, may go.
//!
//! Why: let *s* be the spacing, and the ball's radius ρ = √3/2 cells = √3/2·(1 + 2·[`SEAL`] + 1/128)·s (this is how *s*
//! follows from a cell). The point nearest to the ball's centre is at most √3/2·s from it. When the centre
//! passes from being nearest to one point to being nearest to another, it is as near to all points of the face,
//! edge or corner between them, and the steps among these points lie inside the ball of radius √3/2·s. What blocks a step
//! comes within [`SEAL`]·s of it in every axis, hence within √3·[`SEAL`]·s, after having been moved by less than √3/512·s by
//! snapping, and so within ρ of the ball's centre: it would have to be inside the ball, which cuts no surface. So the front
//! passes wherever the ball does. Where the ball touches a triangle, the point nearest to its centre is within ½·s of the
//! centre in every axis and the triangle within ρ < 0.99·s: within 1½ spacings, and extraction keeps the triangle. ∎
//!
//! The other way round: a crack narrower than 2·[`SEAL`] − 1/256 spacings lets nothing through, and two triangles that share an
//! edge, or meet anywhere along it, leave no leak: what touches a step blocks it. Openings in between may do either.
//!
//! One-sided materials ([`InteriorFaces::AsDrawn`]) are seen through from behind, so a step is blocked only where it meets a front
//! face: a closed model is the same as if it were two-sided, an open one keeps what shows through the back of its faces.
//! The proof above covers the surfaces that are two-sided; for what is seen through one-sided ones there are tests.

mod app;
mod cull;
mod error;
pub(crate) mod extract;
pub mod field;
pub mod front;
pub mod gpu;
pub mod lattice;
mod model;
pub mod overlap;
mod progress;
mod settings;

pub(crate) use app::register;
pub use app::{InteriorCounts, NoInteriorCulling};
pub use cull::{Outcome, Verdict, cull, cull_on, distance_field};
pub use error::InteriorError;
pub use gpu::{FieldDevice, FieldOrigin, InteriorGpu, InteriorGpuError};
pub use model::{FARTHEST, Model, Part, Surface};
pub use progress::{Progress, Stage};
pub use settings::{
    FieldBy, InteriorCulling, InteriorFaces, InteriorGrid, InteriorLevel, InteriorMode,
    InteriorTransparent,
};

/// A surface blocks a step that it comes within so much of, in every axis. units: spacings
pub const SEAL: f64 = 1.0 / 16.0;
