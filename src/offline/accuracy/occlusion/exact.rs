//! What an exact test would remove: the same volume against the depth of every pixel.

use core::any::TypeId;

use bevy::{
    camera::{primitives::Aabb, visibility::VisibleEntities},
    math::Vec3A,
    prelude::*,
};

use super::AccuracyError;
use crate::{
    occlusion::OccludeeVolume,
    offline::scenes::stage::{Culling, DepthImage, SceneStage},
};

/// Objects in view that are behind the picture's depth at every pixel of their volume's screen rectangle.
///
/// `None` for settings that have no volume, and for volumes that have no exact test here.
pub(super) fn removable(
    stage: &mut SceneStage,
    culling: &Culling,
) -> Result<Option<usize>, AccuracyError> {
    let Culling::ZBuffer(settings) = culling else {
        return Ok(None);
    };
    if settings.volume != OccludeeVolume::Aabb {
        return Ok(None);
    }
    // The frustum camera's frame: everything in view, nothing removed.
    stage.cull(&Culling::Frustum);
    let depth = stage.depth()?;
    let camera = stage.camera();
    let world = stage.offline.app.world();
    let parts = (
        world.get::<Camera>(camera),
        world.get::<GlobalTransform>(camera),
        world.get::<VisibleEntities>(camera),
    );
    let (Some(lens), Some(place), Some(visible)) = parts else {
        return Ok(None);
    };
    let clip_from_world = lens.clip_from_view() * Mat4::from(place.affine().inverse());
    let hidden = visible
        .get(TypeId::of::<Mesh3d>())
        .iter()
        .filter(|entity| {
            let (Some(aabb), Some(place)) = (
                world.get::<Aabb>(**entity),
                world.get::<GlobalTransform>(**entity),
            ) else {
                return false;
            };
            is_hidden(
                &depth,
                aabb,
                &(clip_from_world * Mat4::from(place.affine())),
            )
        })
        .count();
    stage.cull(culling);
    Ok(Some(hidden))
}

/// Whether every pixel that the box's rectangle touches is nearer than the box's nearest corner. A box that reaches
/// behind the near plane is not hidden.
fn is_hidden(depth: &DepthImage, aabb: &Aabb, clip_from_local: &Mat4) -> bool {
    let (mut low, mut high, mut nearest) = (Vec2::INFINITY, Vec2::NEG_INFINITY, 0f32);
    for corner in 0..8u32 {
        let side = |bit: u32| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
        let at = aabb.center + aabb.half_extents * Vec3A::new(side(0), side(1), side(2));
        let clip = *clip_from_local * Vec3::from(at).extend(1.0);
        if clip.w <= 0.0 || clip.z >= clip.w {
            return false;
        }
        let ndc = clip.truncate() / clip.w;
        let pixel = (ndc.xy() * Vec2::new(0.5, -0.5) + 0.5) * depth.size.as_vec2();
        (low, high) = (low.min(pixel), high.max(pixel));
        nearest = nearest.max(ndc.z);
    }
    let last = depth.size.as_vec2() - 1.0;
    if high.cmplt(Vec2::ZERO).any() || low.cmpgt(last + 1.0).any() {
        return true;
    }
    let (low, high) = (
        low.floor().clamp(Vec2::ZERO, last).as_uvec2(),
        high.floor().clamp(Vec2::ZERO, last).as_uvec2(),
    );
    (low.y..=high.y).all(|y| {
        let row = (y * depth.size.x) as usize;
        depth.ndc_depth[row + low.x as usize..=row + high.x as usize]
            .iter()
            .all(|depth| *depth > nearest)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_behind_a_wall_is_hidden_unless_the_wall_has_a_hole() {
        let lens = Mat4::perspective_infinite_reverse_rh(1.0, 1.0, 0.1);
        let aabb = Aabb::from_min_max(Vec3::splat(-1.0), Vec3::splat(1.0));
        let at = |z: f32| lens * Mat4::from_translation(Vec3::new(0.0, 0.0, z));
        let wall = 0.1 / 5.0;
        let mut depth = DepthImage {
            size: UVec2::splat(64),
            ndc_depth: vec![wall; 64 * 64],
        };
        assert!(is_hidden(&depth, &aabb, &at(-10.0)));
        assert!(!is_hidden(&depth, &aabb, &at(-4.0)));
        assert!(!is_hidden(&depth, &aabb, &at(0.0)));
        depth.ndc_depth[32 * 64 + 32] = 0.0;
        assert!(!is_hidden(&depth, &aabb, &at(-10.0)));
    }
}
