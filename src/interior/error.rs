//! Why a model cannot be culled, and what would help.

/// Says itself in one line, with the remedy.
#[derive(thiserror::Error, Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum InteriorError {
    /// There is nothing to cull.
    #[error("the model has no triangles: there is nothing to cull")]
    NoTriangles,
    /// A vertex is nowhere.
    #[error(
        "part {part}, of node {node}, has a vertex that is not finite, or farther away than 1e100; repair the model or its \
         transforms"
    )]
    NotFinite {
        /// Number of the part in the model.
        part: usize,
        /// Its node.
        node: u32,
    },
    /// The grid is none.
    #[error("a grid of {0} cells is none; ask for 1 to 3500 on the longest side")]
    Resolution(u32),
    /// The gap is none.
    #[error("a gap of {0} is none; ask for a finite one above 0")]
    Gap(f32),
    /// More memory than is allowed.
    #[error(
        "this grid takes {needs_mib} MiB where {allowed_mib} are allowed; allow as much, or take a gap of at least \
         {smallest_gap:.3e}, {resolution} cells on the longest side"
    )]
    Memory {
        /// What the grid takes. units: MiB
        needs_mib: u64,
        /// What is allowed. units: MiB
        allowed_mib: u32,
        /// The smallest gap that fits. units: of the model's frame
        smallest_gap: f64,
        /// The same as a resolution.
        resolution: u32,
    },
    /// Even the coarsest grid takes more memory than is allowed.
    #[error(
        "even the coarsest grid takes {needs_mib} MiB for this model where {allowed_mib} are allowed; allow as much"
    )]
    NoMemory {
        /// What the coarsest grid takes. units: MiB
        needs_mib: u64,
        /// What is allowed. units: MiB
        allowed_mib: u32,
    },
    /// Stopped.
    #[error("it was stopped")]
    Cancelled,
}
