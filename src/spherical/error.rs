use super::bins::MAX_BINS;

/// What is wrong with what was given to be indexed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SphericalError {
    /// The bins' number is zero or too great.
    #[error(
        "{theta} × {phi} bins: give at least one of each, and at most {MAX_BINS} in all; 180 × 360 is the paper's"
    )]
    Bins {
        /// From pole to pole.
        theta: u16,
        /// Around.
        phi: u16,
    },
    /// A triangle has a corner that the mesh does not have.
    #[error(
        "triangle {triangle} has vertex {vertex} for a corner, but there are {vertices} vertices: check the mesh's indices"
    )]
    NoSuchVertex {
        /// The triangle's number.
        triangle: usize,
        /// What it asks for.
        vertex: u32,
        /// How many there are.
        vertices: usize,
    },
    /// A corner is not at any place.
    #[error(
        "vertex {vertex}, a corner of triangle {triangle}, has a coordinate that is not a finite number: take the triangle out or repair the vertex"
    )]
    NotFinite {
        /// The first triangle that has it.
        triangle: usize,
        /// The vertex's number.
        vertex: u32,
    },
    /// More triangles than can be numbered.
    #[error("{0} triangles have more corners than 32 bits can number: split the mesh")]
    TooManyTriangles(usize),
    /// Chunks of no triangles.
    #[error("chunks of 0 triangles: give at least one, 128 is the default")]
    NoChunk,
}
