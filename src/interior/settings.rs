//! What a user asks of interior culling.

use bevy::prelude::*;

/// On the root of a model: what cannot be seen from anywhere outside it is taken out.
///
/// Once everything below it has loaded, what is hidden is found in the background; then hidden nodes are hidden and
/// hidden triangles are left out of meshes. With the component gone, everything is as it was.
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct InteriorCulling {
    /// How fine it looks.
    pub grid: Grid,
    /// What is taken out.
    pub level: Level,
    /// Which surfaces count as seen.
    pub mode: Mode,
    /// Whether what is behind transparent materials is seen.
    pub transparent: Transparent,
    /// Whether one-sided materials are seen through from behind.
    pub faces: Faces,
    /// How much memory it may take. default: 1024, units: MiB
    pub memory_mib: u32,
}

impl Default for InteriorCulling {
    fn default() -> Self {
        Self {
            grid: Grid::default(),
            level: Level::default(),
            mode: Mode::default(),
            transparent: Transparent::default(),
            faces: Faces::default(),
            memory_mib: 1024,
        }
    }
}

/// How fine interior culling looks; see [what is guaranteed](super#what-is-guaranteed).
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub enum Grid {
    /// So many cells on the model's longest side. default: 256
    Resolution(u32),
    /// What is seen through openings this wide stays. units: of the model's frame, in Bevy m
    Gap(f32),
}

impl Default for Grid {
    fn default() -> Self {
        Self::Resolution(256)
    }
}

/// What is taken out.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum Level {
    /// Nodes of which no triangle is seen.
    Node,
    /// Triangles that are not seen.
    #[default]
    Triangle,
}

/// Which surfaces count as seen.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum Mode {
    /// What is met first on a step from a point outside to one that is not (P5a): with a coarse grid, much that is seen
    /// is missed.
    Sampled,
    /// All that is within 1½ spacings of a point outside.
    #[default]
    Conservative,
}

/// Whether what is behind transparent materials is seen.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum Transparent {
    /// It is.
    #[default]
    Open,
    /// They hide like all others (P5a).
    Closed,
}

/// Whether one-sided materials are seen through from behind.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum Faces {
    /// They are, as they are not drawn.
    #[default]
    AsDrawn,
    /// They hide from both sides (P5a).
    TwoSided,
}
