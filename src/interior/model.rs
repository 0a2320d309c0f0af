//! What is culled: the triangles of a model, part by part.

use std::sync::Arc;

use bevy::math::{DAffine3, DVec3};

/// What is farther from the origin is nowhere: differences and products of such places are no numbers. units: of the
/// model's frame
pub const FARTHEST: f64 = 1e100;

/// A model: parts in one frame.
#[derive(Clone, Debug, Default)]
pub struct Model {
    /// In any order; verdicts come in the same.
    pub parts: Vec<Part>,
}

/// One surface at one place.
#[derive(Clone, Debug)]
pub struct Part {
    /// Which node it belongs to, as the caller counts them.
    pub node: u32,
    /// Its triangles; parts may share them.
    pub surface: Arc<Surface>,
    /// From the surface's own frame to the model's. Mirroring turns the winding round, as it does where it is drawn.
    pub model_from_local: DAffine3,
    /// Drawn with a material that lets see what is behind it: blended or masked.
    pub is_transparent: bool,
    /// Drawn from both sides.
    pub is_two_sided: bool,
}

/// Triangles over shared vertices.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    /// Vertices in the surface's own frame.
    pub positions: Vec<[f32; 3]>,
    /// Counter-clockwise from the front. Those that name a vertex that is not there are as if they were not.
    pub triangles: Vec<[u32; 3]>,
}

impl Model {
    /// How many triangles there are, each placed part's own.
    pub fn triangle_count(&self) -> usize {
        self.parts
            .iter()
            .map(|part| part.surface.triangles.len())
            .sum()
    }

    /// Least and greatest corner of all that a triangle uses; `None` if there is no triangle.
    ///
    /// # Errors
    /// The number of a part with a vertex that is not finite, or beyond [`FARTHEST`].
    pub(super) fn bounds(&self) -> Result<Option<(DVec3, DVec3)>, usize> {
        let mut bounds: Option<(DVec3, DVec3)> = None;
        for (number, part) in self.parts.iter().enumerate() {
            for position in part.corners().flatten() {
                let position = part.place(position);
                // No number is at most that either.
                if !position.abs().cmple(DVec3::splat(FARTHEST)).all() {
                    return Err(number);
                }
                let (least, greatest) = bounds.get_or_insert((position, position));
                *least = least.min(position);
                *greatest = greatest.max(position);
            }
        }
        Ok(bounds)
    }
}

impl Part {
    /// A vertex of its surface, in the model's frame.
    pub fn place(&self, position: [f32; 3]) -> DVec3 {
        self.model_from_local
            .transform_point3(DVec3::from_array(position.map(f64::from)))
    }

    /// The corners of its triangles, in its own frame.
    pub fn corners(&self) -> impl Iterator<Item = [[f32; 3]; 3]> {
        let positions = &self.surface.positions;
        self.surface.triangles.iter().filter_map(|triangle| {
            let [a, b, c] = triangle.map(|index| positions.get(index as usize).copied());
            Some([a?, b?, c?])
        })
    }

    /// Whether its front faces are what its surface's winding says are its back faces.
    pub(super) fn is_mirrored(&self) -> bool {
        self.model_from_local.matrix3.determinant() < 0.0
    }
}
