//! The knobs of this suite.
//!
//! | Knob | Moves | Unit | Loss |
//! |---|---|---|---|
//! | `contribution_area` | what is demanded of [`ContributionCulling`](crate::contribution::ContributionCulling), see [`rank`](crate::contribution::rank) | px² of an object without triangles | the pixels that go, counted each frame |
//! | `terrain_error` | [`TerrainRayCasting::max_error_px`] | px | how much of the ground is off by how many steps that can be told apart |
//! | `resolution_scale` | [`ResolutionScale`] | share of a side | detail finer than the pixels drawn, in all of the picture |
//! | `shadow_slice` | [`TerrainShadow::slice_ms`] | ms | shadows appear later, and nothing else |
//! | `occlusion_volume` | [`ZBufferOcclusion::volume`] | 0 `Aabb`, 1 `Obb`, 2 + triangles `Proxy` | none: it only decides how much that is hidden is drawn |

use bevy::prelude::*;

use super::knobs::{AppKnobs, Knob, KnobCost, KnobError, KnobOn};
use crate::{
    occlusion::{OccludeeVolume, ZBufferOcclusion},
    resolution::ResolutionScale,
    terrain::TerrainRayCasting,
    terrain_shadow::TerrainShadow,
};

/// Name of the knob that does the fine work.
pub const CONTRIBUTION_AREA: &str = "contribution_area";

/// Registers all of them, before any app's own.
pub(crate) fn register(app: &mut App) -> Result<(), KnobError> {
    let mut knobs = app
        .world_mut()
        .get_resource_or_init::<super::knobs::Knobs>();
    knobs.register_absent(contribution_area()?)?;
    app.register_component_knob::<TerrainRayCasting>(
        Knob::new(
            "terrain_error",
            "px",
            &[
                (0.5, 0.0),
                (1.0, 0.002),
                (2.0, 0.006),
                (4.0, 0.016),
                (8.0, 0.04),
            ],
            KnobCost::Measured,
        )?,
        KnobOn::Cameras,
        |casting| casting.max_error_px,
        |casting, value| casting.max_error_px = value,
    )?;
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
            // Areas are measured in pixels drawn, and so follow by themselves.
            KnobCost::Measured,
        )?,
        KnobOn::Cameras,
        |scale| scale.0,
        |scale, value| scale.0 = value,
    )?;
    app.register_component_knob::<TerrainShadow>(
        Knob::new(
            "shadow_slice",
            "ms",
            &[(2.0, 0.0), (1.0, 0.001), (0.5, 0.003), (0.25, 0.006)],
            KnobCost::Measured,
        )?,
        KnobOn::Everything,
        |shadow| shadow.slice_ms,
        |shadow, value| shadow.slice_ms = value,
    )?;
    app.register_component_knob::<ZBufferOcclusion>(
        Knob::new(
            "occlusion_volume",
            "volume",
            &[(102.0, 0.0), (1.0, 0.0), (0.0, 0.0)],
            KnobCost::Measured,
        )?,
        KnobOn::Cameras,
        |occlusion| match occlusion.volume {
            OccludeeVolume::Aabb => 0.0,
            OccludeeVolume::Obb => 1.0,
            OccludeeVolume::Proxy { triangles } => triangles as f32 + 2.0,
        },
        |occlusion, value| {
            occlusion.volume = match value {
                value if value < 0.5 => OccludeeVolume::Aabb,
                value if value < 1.5 => OccludeeVolume::Obb,
                value => OccludeeVolume::Proxy {
                    triangles: (value - 2.0).max(0.0) as u32,
                },
            }
        },
    )
}

/// Steps of an octave each: what lies between them is its live value. Their losses are this frame's.
fn contribution_area() -> Result<Knob, KnobError> {
    let mut steps = [(0.0, 0.0); 18];
    for (i, step) in steps.iter_mut().enumerate().skip(1) {
        step.0 = (1_u32 << (i - 1)) as f32;
    }
    let mut knob = Knob::new(CONTRIBUTION_AREA, "px²", &steps, KnobCost::Measured)?;
    knob.is_continuous = true;
    Ok(knob)
}
