//! Gives objects that contribution culling fades the range that dithers them, and takes it back.

use core::any::TypeId;

use bevy::{
    camera::visibility::{VisibilityRange, VisibleEntities},
    ecs::{lifecycle::HookContext, world::DeferredWorld},
    prelude::*,
};

use crate::contribution::{ContributionCamera, fade::range};

/// Follows the fades of all cameras. What another active camera sees too, or what has a range of its own, is cut in the
/// next frame instead.
pub fn fade_small(
    mut states: Query<(Entity, &mut ContributionCamera)>,
    cameras: Query<(Entity, &Camera, &VisibleEntities)>,
    ranges: Query<&VisibilityRange>,
    mut commands: Commands,
) {
    for (camera, mut state) in &mut states {
        if state.fades.is_empty() {
            continue;
        }
        let fades = &mut state.bypass_change_detection().fades;
        for (entity, step) in fades.ended.drain(..) {
            if ranges.get(entity).is_ok_and(|of| *of == range(step)) {
                commands.entity(entity).try_remove::<VisibilityRange>();
            }
        }
        for fade in &mut fades.list {
            let own = ranges.get(fade.entity).ok();
            let is_ours = match (own, fade.shown) {
                (None, shown) => shown.is_none(),
                (Some(own), Some(shown)) => *own == range(shown),
                (Some(_), None) => false,
            };
            if !is_ours {
                (fade.cut, fade.shown) = (true, None);
                continue;
            }
            let seen_elsewhere = cameras.iter().any(|(other, by, visible)| {
                let meshes = visible.get(TypeId::of::<Mesh3d>());
                other != camera && by.is_active && meshes.binary_search(&fade.entity).is_ok()
            });
            if seen_elsewhere {
                fade.cut = true;
                if fade.shown.take().is_some() {
                    commands.entity(fade.entity).try_remove::<VisibilityRange>();
                }
                continue;
            }
            let step = fade.step();
            if fade.shown != Some(step) {
                fade.shown = Some(step);
                commands.entity(fade.entity).try_insert(range(step));
            }
        }
    }
}

/// A camera that is despawned, or whose culling ends, takes its ranges back.
pub(crate) fn take_ranges_back(mut world: DeferredWorld, context: HookContext) {
    let Some(state) = world.get::<ContributionCamera>(context.entity) else {
        return;
    };
    let with_range: Vec<(Entity, u8)> = state.fades.with_range().collect();
    for (entity, step) in with_range {
        if world
            .get::<VisibilityRange>(entity)
            .is_some_and(|of| *of == range(step))
        {
            world
                .commands()
                .entity(entity)
                .try_remove::<VisibilityRange>();
        }
    }
}
