//! The knobs of terrain and its shadows.

use bevy::prelude::*;

use crate::{
    budget::knobs::{AppKnobs, Knob, KnobCost, KnobError, KnobOn},
    terrain::TerrainRayCasting,
    terrain_shadow::TerrainShadow,
};

pub(super) fn register_terrain_error(app: &mut App) -> Result<(), KnobError> {
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
    )
}

pub(super) fn register_shadow_slice(app: &mut App) -> Result<(), KnobError> {
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
    )
}
