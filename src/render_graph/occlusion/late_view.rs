//! The late view: for each camera a second view, in the render world only, whose visible entities are those that
//! the camera had taken away. Bevy specialises, queues and batches for it as for any view; its draws are encoded by
//! `passes`, after the recheck, with the camera's own bind groups.
//!
//! Bevy keeps a view's phases only if a camera of the main world stands behind it, so from
//! [`RenderSystems::Cleanup`](bevy::render::RenderSystems) to the next frame's preparation they are kept here.

use core::any::TypeId;

use bevy::{
    camera::{MainPassResolutionOverride, visibility::RenderLayers},
    core_pipeline::{
        core_3d::{AlphaMask3d, Opaque3d, Transparent3d},
        deferred::{AlphaMask3dDeferred, Opaque3dDeferred},
        prepass::{
            AlphaMask3dPrepass, DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass,
            Opaque3dPrepass,
        },
        schedule::RootNonCameraView,
    },
    ecs::schedule::ScheduleLabel,
    material::RenderPhaseType,
    mesh::PrimitiveTopology,
    pbr::{
        PreparedMaterial, RenderMaterialInstances, RenderMeshInstances, Transmissive3d,
        ViewKeyCache, ViewKeyPrepassCache,
    },
    platform::collections::HashMap,
    prelude::*,
    render::{
        batching::gpu_preprocessing::GpuPreprocessingMode,
        camera::DirtySpecializations,
        erased_render_asset::ErasedRenderAssets,
        mesh::RenderMesh,
        render_asset::RenderAssets,
        render_phase::{
            BinnedPhaseItem, BinnedRenderPhase, ViewBinnedRenderPhases, ViewSortedRenderPhases,
        },
        render_resource::PipelineCache,
        renderer::RenderDevice,
        sync_world::MainEntity,
        view::{
            ExtractedView, RenderExtractedVisibleEntities, RenderVisibleEntities,
            RetainedViewEntity,
        },
    },
};

use super::{
    extract::{ExtractedOcclusion, ExtractedOcclusionCamera},
    pipelines::OcclusionPipelines,
    prepare::reducible,
};

/// Of a camera's late view; no subview of Bevy's has this number.
const LATE_SUBVIEW: u32 = u32::MAX;

/// Frames for which a late view without entities is kept, bins and all.
const PATIENCE: u32 = 120;

/// Runs for each late view before any camera: Bevy's `unpack_bins`.
#[derive(ScheduleLabel, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct UnpackLateBins;

/// Identity of a camera's late view.
pub fn late_view_of(camera: Entity) -> RetainedViewEntity {
    RetainedViewEntity::new(MainEntity::from(camera), None, LATE_SUBVIEW)
}

/// The late views there are, by their cameras' entities in the main world.
#[derive(Resource, Default)]
pub struct LateViews(HashMap<Entity, LateView>);

struct LateView {
    entity: Entity,
    id: RetainedViewEntity,
    /// Frames since it last had an entity.
    empty: u32,
    /// Entities that may be drawn late, sorted; the lists of the last frame, to compare with.
    accepted: Vec<MainEntity>,
    phases: KeptPhases,
    /// Whether it was made ready this frame.
    prepared: bool,
}

#[derive(Default)]
struct KeptPhases {
    opaque: Option<BinnedRenderPhase<Opaque3d>>,
    alpha_mask: Option<BinnedRenderPhase<AlphaMask3d>>,
    opaque_prepass: Option<BinnedRenderPhase<Opaque3dPrepass>>,
    alpha_mask_prepass: Option<BinnedRenderPhase<AlphaMask3dPrepass>>,
    opaque_deferred: Option<BinnedRenderPhase<Opaque3dDeferred>>,
    alpha_mask_deferred: Option<BinnedRenderPhase<AlphaMask3dDeferred>>,
}

impl LateViews {
    /// Entity of a camera's late view, if it has one.
    pub fn entity(&self, camera: Entity) -> Option<Entity> {
        self.0.get(&camera).map(|late| late.entity)
    }

    /// Whether no camera has one.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// Phases of the passes that a late view is drawn in.
type Phases<'w> = (
    ResMut<'w, ViewBinnedRenderPhases<Opaque3d>>,
    ResMut<'w, ViewBinnedRenderPhases<AlphaMask3d>>,
    ResMut<'w, ViewBinnedRenderPhases<Opaque3dPrepass>>,
    ResMut<'w, ViewBinnedRenderPhases<AlphaMask3dPrepass>>,
    ResMut<'w, ViewBinnedRenderPhases<Opaque3dDeferred>>,
    ResMut<'w, ViewBinnedRenderPhases<AlphaMask3dDeferred>>,
    ResMut<'w, ViewSortedRenderPhases<Transmissive3d>>,
    ResMut<'w, ViewSortedRenderPhases<Transparent3d>>,
);

/// What is known of a camera when its late view is made ready.
type CameraData<'w> = (
    &'w ExtractedView,
    Option<&'w MainPassResolutionOverride>,
    &'w Msaa,
    Has<DepthPrepass>,
    Has<NormalPrepass>,
    Has<MotionVectorPrepass>,
    Has<DeferredPrepass>,
);

/// What meshes and materials are.
type Drawables<'w> = (
    Res<'w, RenderMaterialInstances>,
    Res<'w, ErasedRenderAssets<PreparedMaterial>>,
    Res<'w, RenderMeshInstances>,
    Res<'w, RenderAssets<RenderMesh>>,
);

/// Gives every camera that removed something its late view, with this frame's entities, the camera's keys and the
/// phases kept since the last frame. What cannot be drawn late goes back to the camera: it blends, its material has
/// a depth bias or is not known yet, it is no mesh of triangles; or nothing can be tested again this frame.
#[expect(
    clippy::too_many_arguments,
    reason = "it stands for several of Bevy's systems"
)]
pub fn prepare_late_views(
    mut commands: Commands,
    extracted: Res<ExtractedOcclusion>,
    mut late_views: ResMut<LateViews>,
    cameras: Query<CameraData>,
    mut lists: Query<&mut RenderExtractedVisibleEntities>,
    (instances, materials, meshes, render_meshes): Drawables,
    (pipelines, cache, device): (
        Res<OcclusionPipelines>,
        Res<PipelineCache>,
        Res<RenderDevice>,
    ),
    mut dirty: ResMut<DirtySpecializations>,
    mut keys: ResMut<ViewKeyCache>,
    mut prepass_keys: ResMut<ViewKeyPrepassCache>,
    mut phases: Phases,
) {
    for camera in &extracted.cameras {
        if !camera.rechecks {
            continue;
        }
        // Without a view, Bevy starts the camera afresh when it comes back, and so does this.
        let Ok((view, resolution, msaa, depth, normal, motion, deferred)) =
            cameras.get(camera.render)
        else {
            continue;
        };
        let size = resolution.map_or(view.viewport.zw(), |to| to.0);
        let can_recheck = pipelines.late_draws(&cache).is_some()
            && reducible(Mat4::IDENTITY, size, camera.sampling, &device).is_some();
        let known = late_views.0.contains_key(&camera.main);
        if !known && camera.removed.is_empty() {
            continue;
        }
        let late = late_views.0.entry(camera.main).or_insert_with(|| LateView {
            entity: commands
                .spawn((
                    RenderVisibleEntities::default(),
                    // What is culled by the GPU alone stays the camera's.
                    RenderLayers::none(),
                    RootNonCameraView(UnpackLateBins.intern()),
                ))
                .id(),
            id: late_view_of(camera.main),
            empty: 0,
            accepted: Vec::new(),
            phases: KeptPhases::default(),
            prepared: true,
        });
        late.prepared = true;
        late.empty = if camera.removed.is_empty() {
            late.empty + 1
        } else {
            0
        };

        let drawn_late = |entity: MainEntity| {
            // Lines and points reach beyond their vertices.
            let triangles = meshes
                .mesh_asset_id(entity)
                .and_then(|id| render_meshes.get(id))
                .is_some_and(|mesh| {
                    matches!(
                        mesh.primitive_topology(),
                        PrimitiveTopology::TriangleList | PrimitiveTopology::TriangleStrip
                    )
                });
            triangles
                && instances
                    .instances
                    .get(&entity)
                    .and_then(|instance| materials.get(instance.asset_id))
                    .is_some_and(|material| {
                        let properties = &material.properties;
                        // A bias lets what lies behind the depth be drawn all the same.
                        properties.depth_bias == 0.0
                            && matches!(
                                properties.render_phase_type,
                                RenderPhaseType::Opaque | RenderPhaseType::AlphaMask
                            )
                    })
        };
        let mut of_late = lists
            .get_mut(late.entity)
            .map(|mut list| core::mem::take(&mut *list))
            .unwrap_or_default();
        let class = of_late.classes.entry(TypeId::of::<Mesh3d>()).or_default();
        class.entities.clear();
        let mut before = late.accepted.iter().peekable();
        let mut back: Vec<(Entity, MainEntity)> = Vec::new();
        for (entity, _) in &camera.removed {
            let main = MainEntity::from(*entity);
            while before.next_if(|old| **old < main).is_some() {}
            let accepted_before = before.next_if(|old| **old == main).is_some();
            let changed = || {
                dirty.changed_renderables.contains(&main)
                    || dirty.removed_renderables.contains(&main)
            };
            // What changes this frame may be something else by the time it is queued.
            if can_recheck && !changed() && (accepted_before || drawn_late(main)) {
                class.entities.push((Entity::PLACEHOLDER, main));
            } else {
                back.push((Entity::PLACEHOLDER, main));
            }
        }
        late.accepted.clear();
        late.accepted
            .extend(class.entities.iter().map(|(_, main)| *main));
        if !back.is_empty()
            && let Ok(mut list) = lists.get_mut(camera.render)
        {
            let class = list.classes.entry(TypeId::of::<Mesh3d>()).or_default();
            class.entities.append(&mut back);
            class.entities.sort_unstable_by_key(|(_, main)| *main);
        }

        let mut entity = commands.entity(late.entity);
        entity.insert((
            of_late,
            ExtractedView {
                retained_view_entity: late.id,
                clip_from_view: view.clip_from_view,
                world_from_view: view.world_from_view,
                clip_from_world: view.clip_from_world,
                target_format: view.target_format,
                viewport: view.viewport,
                color_grading: view.color_grading.clone(),
                invert_culling: view.invert_culling,
            },
            // Until the end of the frame: Bevy would otherwise work out keys of its own for this view.
            *msaa,
        ));
        if motion {
            entity.insert(MotionVectorPrepass);
        } else {
            entity.remove::<MotionVectorPrepass>();
        }
        if deferred {
            entity.insert(DeferredPrepass);
        } else {
            entity.remove::<DeferredPrepass>();
        }

        // The camera's pipelines are the late view's.
        let camera_view = view.retained_view_entity;
        if dirty.views.contains(&camera_view) {
            dirty.views.insert(late.id);
        }
        follow(&mut keys, camera_view, late.id, &mut dirty);
        follow(&mut prepass_keys, camera_view, late.id, &mut dirty);

        let id = late.id;
        let kept = &mut late.phases;
        put_back(&mut phases.0, id, &mut kept.opaque, true);
        put_back(&mut phases.1, id, &mut kept.alpha_mask, true);
        let prepass = depth || normal || motion;
        put_back(&mut phases.2, id, &mut kept.opaque_prepass, prepass);
        put_back(&mut phases.3, id, &mut kept.alpha_mask_prepass, prepass);
        put_back(&mut phases.4, id, &mut kept.opaque_deferred, deferred);
        put_back(&mut phases.5, id, &mut kept.alpha_mask_deferred, deferred);
        // Nothing is queued in these, but Bevy queues nothing without them.
        phases.6.prepare_for_new_frame(id);
        phases.7.prepare_for_new_frame(id);
    }
    late_views.0.retain(|_, late| {
        let kept = core::mem::take(&mut late.prepared) && late.empty < PATIENCE;
        if !kept {
            commands.entity(late.entity).despawn();
            keys.remove(&late.id);
            prepass_keys.remove(&late.id);
        }
        kept
    });
}

/// What is kept of late views is of the device there was: with a new one all begin anew.
pub fn forget_late_views(mut commands: Commands, mut late_views: ResMut<LateViews>) {
    for (_, late) in late_views.0.drain() {
        commands.entity(late.entity).despawn();
    }
}

/// Gives the late view the camera's pipeline key.
fn follow<K: Copy + PartialEq>(
    keys: &mut HashMap<RetainedViewEntity, K>,
    camera: RetainedViewEntity,
    late: RetainedViewEntity,
    dirty: &mut DirtySpecializations,
) {
    let Some(key) = keys.get(&camera).copied() else {
        return;
    };
    if keys.insert(late, key) != Some(key) {
        dirty.views.insert(late);
    }
}

fn put_back<P: BinnedPhaseItem>(
    phases: &mut ViewBinnedRenderPhases<P>,
    id: RetainedViewEntity,
    kept: &mut Option<BinnedRenderPhase<P>>,
    wanted: bool,
) {
    let kept = kept.take();
    if !wanted {
        phases.remove(&id);
        return;
    }
    if let Some(kept) = kept {
        phases.insert(id, kept);
    }
    phases.prepare_for_new_frame(id, GpuPreprocessingMode::Culling);
}

/// Takes the late views' phases to where Bevy does not clear them away.
pub fn keep_late_phases(
    mut commands: Commands,
    mut late_views: ResMut<LateViews>,
    mut phases: Phases,
) {
    for late in late_views.0.values_mut() {
        let id = late.id;
        late.phases = KeptPhases {
            opaque: phases.0.remove(&id),
            alpha_mask: phases.1.remove(&id),
            opaque_prepass: phases.2.remove(&id),
            alpha_mask_prepass: phases.3.remove(&id),
            opaque_deferred: phases.4.remove(&id),
            alpha_mask_deferred: phases.5.remove(&id),
        };
        commands.entity(late.entity).remove::<Msaa>();
    }
}

/// Whether a camera removed something that may have to be drawn late.
pub fn draws_late(camera: &ExtractedOcclusionCamera) -> bool {
    camera.rechecks && !camera.removed.is_empty()
}
