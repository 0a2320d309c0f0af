//! Spherical index (P3): of a mesh each camera draws only the part that it can see.
//!
//! # How it goes
//! 1. **Maps** ([`SphericalMaps`]). About the middle of its box each triangle's centroid has a direction, in bins of zenith θ and
//!    azimuth φ. Triangles are put in an order in which each bin's are together. P3's centroid map, index map and
//!    memory-access map say which bin has which triangles, and where.
//! 2. **Chunks** (`chunks`). Runs of that order, of neighbouring bins whose triangles face alike: each a mesh, drawn as
//!    any other. To draw ranges of one index buffer for each camera Bevy has no means; chunks are batched into one draw
//!    all the same.
//! 3. **Selection**, each frame and camera. [`SphericalMode::Conservative`]: chunks whose box is in view (by Bevy's own
//!    test) and of which any triangle faces the eye. [`SphericalMode::Paper`]: chunks with any triangle that P3's maps
//!    give (`paper`).
//!
//! # What is guaranteed
//! In `Conservative` mode no triangle is left out that the same mesh, drawn whole, would have drawn a pixel of: a chunk is
//! left out only if its box is out of view by Bevy's test, or if all its triangles are seen from the side that its material
//! does not draw, by more than rounding could be wrong about. `chunks` derives that, for rasterisers with at least
//! [`Eye::SUB_PIXEL_BITS`] and views of up to 127° from corner to corner, and says what it does not cover. It asks nothing
//! of the mesh's shape and of where the camera is: meshes that are open, not star-shaped or folded, cameras in their
//! middle, mirrored and orthographic ones are as any other. Of cameras that jitter, Bevy's test of boxes does not know the
//! half pixel by which they do.
//!
//! # Reference
//! P3, §2 and appendix 1. What its text leaves open, and what was chosen, is listed in `paper`.

mod app;
mod bins;
pub(crate) mod chunks;
mod cover;
mod error;
mod maps;
mod order;
pub(crate) mod paper;
mod ray;
mod settings;
mod view;

pub use crate::culling::part::ChunkOf;
pub(crate) use app::register;
pub use app::{SphericalAppExt, SphericalCounts};
pub use bins::{Bins, MAX_BINS};
pub use chunks::{Chunk, SphericalChunks};
pub use error::SphericalError;
pub use maps::{CentroidCell, IndexMap, MapSettings, MemoryCell, NO_BIN, SphericalMaps};
pub use order::Layout;
pub use paper::{Case, Frustum, PaperScratch};
pub use ray::Ray;
pub use settings::{SphericalIndex, SphericalMode};
pub use view::{Eye, Shown, View, half_space_in_local};
