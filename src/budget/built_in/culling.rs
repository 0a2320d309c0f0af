//! The knobs of contribution culling and occlusion culling.

use bevy::prelude::*;

use super::CONTRIBUTION_AREA;
use crate::{
    budget::knobs::{AppKnobs, Knob, KnobCost, KnobError, KnobOn, Knobs},
    occlusion::{OccludeeVolume, ZBufferOcclusion},
};

/// Steps of an octave each: what lies between them is its live value. Their losses are this frame's.
pub(super) fn register_contribution_area(app: &mut App) -> Result<(), KnobError> {
    let mut steps = [(0.0, 0.0); 18];
    for (i, step) in steps.iter_mut().enumerate().skip(1) {
        step.0 = (1_u32 << (i - 1)) as f32;
    }
    let mut knob = Knob::new(CONTRIBUTION_AREA, "px²", &steps, KnobCost::Measured)?;
    knob.is_continuous = true;
    let mut knobs = app.world_mut().get_resource_or_init::<Knobs>();
    // In the scene while a camera with a budget has contribution culling.
    knobs.register_absent(knob)
}

pub(super) fn register_occlusion_volume(app: &mut App) -> Result<(), KnobError> {
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
