//! The knobs of this suite, of what of it is built.
//!
//! | Knob | Moves | Unit | Loss |
//! |---|---|---|---|
//! | `contribution_area` | what is demanded of [`ContributionCulling`](crate::contribution::ContributionCulling), see [`rank`](crate::contribution::rank) | px² of an object without triangles | the pixels that go, counted each frame |
//! | `terrain_error` | [`TerrainRayCasting::max_error_px`](crate::terrain::TerrainRayCasting::max_error_px) | px | how much of the ground is off by how many steps that can be told apart |
//! | `resolution_scale` | [`ResolutionScale`] | share of a side | detail finer than the pixels drawn, in all of the picture |
//! | `shadow_slice` | [`TerrainShadow::slice_ms`](crate::terrain_shadow::TerrainShadow::slice_ms) | ms | shadows appear later, and nothing else |
//! | `occlusion_volume` | [`ZBufferOcclusion::volume`](crate::occlusion::ZBufferOcclusion::volume) | 0 `Aabb`, 1 `Obb`, 2 + triangles `Proxy` | none: it only decides how much that is hidden is drawn |

#[cfg(feature = "culling")]
mod culling;
#[cfg(feature = "terrain")]
mod terrain;

use bevy::prelude::*;

use super::knobs::{AppKnobs, Knob, KnobCost, KnobError, KnobOn};
use crate::resolution::ResolutionScale;

/// Name of the knob that does the fine work.
pub const CONTRIBUTION_AREA: &str = "contribution_area";

/// Registers all of them, before any app's own.
pub(crate) fn register(app: &mut App) -> Result<(), KnobError> {
    #[cfg(feature = "culling")]
    culling::register_contribution_area(app)?;
    #[cfg(feature = "terrain")]
    terrain::register_terrain_error(app)?;
    register_resolution_scale(app)?;
    #[cfg(feature = "terrain")]
    terrain::register_shadow_slice(app)?;
    #[cfg(feature = "culling")]
    culling::register_occlusion_volume(app)?;
    Ok(())
}

fn register_resolution_scale(app: &mut App) -> Result<(), KnobError> {
    app.register_component_knob::<ResolutionScale>(
        Knob::new(
            "resolution_scale",
            "",
            &[
                (1.0, 0.0),
                (0.85, 0.03),
                (0.7, 0.07),
                (0.59, 0.12),
                (0.5, 0.18),
            ],
            // Areas are counted in pixels of the whole viewport: what fewer drawn ones save is learned.
            KnobCost::Measured,
        )?,
        KnobOn::Cameras,
        |scale| scale.0,
        |scale, value| scale.0 = value,
    )
}
