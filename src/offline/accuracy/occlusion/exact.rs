//! What an exact test would remove: the same volume against the depth of every pixel.

use core::any::TypeId;

use bevy::{camera::visibility::VisibleEntities, prelude::*};

use super::AccuracyError;
use crate::{
    culling::candidates::Candidates,
    occlusion::{
        DepthSampling, OcclusionCounts,
        depth::ReducedDepth,
        verdict::{DepthTest, Verdict},
    },
    offline::{
        OfflineError,
        scenes::stage::{Culling, SceneStage},
    },
};

/// Candidates in view that an exact test removes, and those that were removed and stayed so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Removable {
    /// Hidden behind the picture's depth at every pixel that their volume could cover.
    pub by_exact_test: usize,
    /// Removed and not drawn late.
    pub removed: usize,
}

impl Removable {
    /// Share removed of what the exact test removes; `None` where there is nothing to remove and nothing was.
    pub fn share(self) -> Option<f64> {
        let any = self.by_exact_test > 0 || self.removed > 0;
        any.then(|| self.removed as f64 / self.by_exact_test.max(1) as f64)
    }
}

/// Tests what is in view in the frame last drawn with a setting of ours. `None` for other ways to cull.
pub(super) fn removable(
    stage: &mut SceneStage,
    culling: &Culling,
) -> Result<Option<Removable>, AccuracyError> {
    if culling.settings().is_none() {
        return Ok(None);
    }
    let camera = stage.camera();
    let depth = stage.depth()?;
    let world = stage.offline.app.world();
    let (Some(lens), Some(place), Some(visible), Some(counts), Some(culled)) = (
        world.get::<Camera>(camera),
        world.get::<GlobalTransform>(camera),
        world.get::<VisibleEntities>(camera),
        world.get::<OcclusionCounts>(camera),
        world.get::<crate::culling::CulledEntities>(camera),
    ) else {
        return Ok(None);
    };
    let clip_from_world = lens.clip_from_view() * place.to_matrix().inverse();
    let every_pixel = DepthSampling::Conservative { block: 1 };
    let depth =
        ReducedDepth::from_pixels(clip_from_world, depth.size, every_pixel, &depth.ndc_depth)
            .map_err(|error| OfflineError::ReadBack(error.to_string()))?;
    let test = DepthTest::new(&depth);
    let table = world.resource::<Candidates>();
    let in_view = visible
        .get(TypeId::of::<Mesh3d>())
        .iter()
        .copied()
        .chain(culled.iter().map(|(entity, _)| entity));
    let by_exact_test = in_view
        .filter_map(|entity| table.get(table.occludable(entity)?))
        .filter(|of| {
            let proxy = of.proxy.as_deref();
            test.verdict(&of.world_from_local, &of.volume, of.turned.as_ref(), proxy)
                == Verdict::Hidden
        })
        .count();
    Ok(Some(Removable {
        by_exact_test,
        removed: (counts.removed - counts.rescued.min(counts.removed)) as usize,
    }))
}
