//! Everything that runs in the render world, and the one table of when.
//!
//! | Pass | Schedule | After | Before | Because |
//! |---|---|---|---|---|
//! | `extract_terrains` | `ExtractSchedule` | – | – | uploads changed heights straight from the asset |
//! | `extract_shadows` | `ExtractSchedule` | – | – | notes which heights have changed |
//! | `prepare_terrain_views` | `Render`, `PrepareResources` | – | – | rays, textures, lists |
//! | `prepare_terrain_shadows` | `Render`, `PrepareResources` | `prepare_terrain_views` | – | plans what is made of the shadow maps of terrains that some camera draws |
//! | `prepare_terrain_cascades` | `Render`, `PrepareResources` | `prepare_terrain_views` | – | adds to its counts; the cascades are there since `CreateViews` |
//! | `prepare_terrain_bind_groups` | `Render`, `PrepareBindGroups` | – | – | binds what is new, queues pipelines |
//! | `height_mips` | `RenderGraph` | – | `camera_driver` | views read this frame's pyramid |
//! | `terrain_shadow` | `RenderGraph` | `height_mips` | `camera_driver` | views read the maps it shows |
//! | `cast_terrain` | `Core3d`, `Prepass` | `early_prepass` | `early_downsample_depth`, `late_prepass` | rays stop at meshes; terrain is in Bevy's depth pyramid |
//! | `terrain_cascade` | `Core3d`, `Prepass` | `per_view_shadow_pass` (early) | `early_downsample_depth`, `per_view_shadow_pass` (late), `MainPass` | terrain is among the casters that occlusion culling of lights and shading read |
//! | `terrain_shade` | `Core3d`, `MainPass` | `main_opaque_pass_3d` | `main_transparent_pass_3d` | pixels that meshes cover are not lit; transparency blends over terrain |
//! | `extract_contribution` | `ExtractSchedule` | – | – | takes over what each camera whose areas the GPU measures has in view, and what changed in the table of candidates |
//! | `respecialize_dithered` | `ExtractSchedule`, `CheckForChanges` | – | – | what begins or ceases to dither is drawn by other pipelines in this very frame |
//! | `prepare_contribution` | `Render`, `PrepareResources` | – | – | uploads both; which mesh input is which candidate |
//! | `prepare_contribution_bind_groups` | `Render`, `PrepareBindGroups` | – | – | batches, whose instances are written again, are built by then |
//! | `contribution` | `Core3d` | `early_gpu_preprocess` | `early_prepass_build_indirect_parameters` | takes what is too small out of the camera's instances before their number is taken for the draws |
//! | `extract_occlusion` | `ExtractSchedule` | – | – | takes over what each camera has removed and wants tested, and where occludees stand |
//! | `prepare_late_views` | `Render`, `PrepareAssets` | `check_views_need_specialization`, `check_prepass_views_need_specialization` | `collect_visible_cpu_culled_entities` | hands the camera's keys on to its late view; what came into that view is found as for any |
//! | `make_depth_readable` | `Render`, `PrepareViews` | – | – | depth textures are made in `PrepareResources`, with the usages asked for by then |
//! | `prepare_occlusion` | `Render`, `PrepareResources` | – | – | uploads the table and this frame's views |
//! | `prepare_occlusion_bind_groups` | `Render`, `PrepareBindGroups` | – | – | batches, whose instances are to be drawn late, are built by then |
//! | `keep_late_phases` | `Render`, `Cleanup` | – | – | Bevy drops phases that no camera of the main world stands behind |
//! | `extract_scales` | `ExtractSchedule` | – | – | lists the cameras that draw fewer pixels |
//! | `scale_main_passes` | `Render` | `ExtractCommands` | `PrepareAssets`, `PrepareMeshes` | camera and view are extracted by then; all that looks at their viewports comes later |
//! | `upscale` | `Core3d` | `MainPass`, `wireframe_3d` | `EarlyPostProcess` | what they draw is stretched; post-processing comes at full resolution |
//! | `note_uploads` | `Render`, `PrepareAssets` | `prepare_assets::<RenderMesh>` | – | meshes of some triangles of others are shown once they can be drawn |
//! | `unpack_bins` | `UnpackLateBins`, for each late view before any camera | – | – | a late view's draws need what Bevy unpacks for its own |
//! | `recheck::<WithPrepass>`, `build_late_prepass`, `late_view_prepass`, `late_view_deferred` | `Core3d`, `Prepass`, chained | `late_prepass`, the lights' late shadow passes | `late_deferred_prepass`, `main_build_indirect_parameters` | all that a prepass draws early is in the depth, terrain included; draw commands that the lights still need are not rebuilt before; copies of what the deferred prepass wrote come after; what is drawn late is in the main pass's draws |
//! | `recheck::<WithoutPrepass>`, `build_late_main`, `late_opaque` | `Core3d`, `MainPass`, chained | `main_opaque_pass_3d` | `terrain_shade`, `main_transparent_pass_3d` | all that is drawn early is in the depth; pixels drawn late are not lit as terrain; transparency blends over them |
//!
//! `terrain_shadow` is one dispatch of `terrain_shadow` or `shadow_sweep`, then `shadow_mips`.
//! `cast_terrain` is `subdivide`, `box_entry`, `beam`, `ray_cast` for each terrain, then `terrain_depth` for all.
//! `terrain_cascade` is `terrain_cascade_cast` and `terrain_cascade_erode` for each cascade that needs it, then the
//! depth of each.
//! `contribution` is the dispatch of that name, then `forget_draws` and `late_draws` over the camera's own instances.
//! `recheck` is `depth_reduce`, `occludee_verdicts`, `late_draws`, then the copies that are read back; a camera has
//! one of the two, by whether it draws into its depth before the main pass. `late_opaque` also draws, in the main
//! pass, what `late_view_prepass` drew in the prepass.

pub mod cascades;
pub mod contribution;
pub mod extract;
pub mod height_mips;
pub mod mesh_uploads;
pub mod occludee_verdicts;
pub mod occlusion;
pub mod pipelines;
mod readback;
mod shaders;
pub mod stats;
pub mod subdivide;
pub mod terrain;
pub mod terrain_shadow;
pub mod upscale;
pub mod view;

use bevy::{
    core_pipeline::{
        core_3d::{main_opaque_pass_3d, main_transparent_pass_3d},
        mip_generation::experimental::depth::early_downsample_depth,
        prepass::node::{early_prepass, late_prepass},
        schedule::{Core3d, Core3dSystems, camera_driver},
    },
    pbr::{EARLY_SHADOW_PASS, LATE_SHADOW_PASS, MeshPipelineSystems, per_view_shadow_pass},
    prelude::*,
    render::{
        ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems,
        render_resource::DownlevelFlags,
        renderer::{RenderAdapter, RenderDevice, RenderGraph},
        settings::WgpuLimits,
    },
};

use cascades::{TerrainCascades, prepare_terrain_cascades, terrain_cascade};
use extract::{ExtractedTerrains, extract_terrains};
use height_mips::{GpuHeightFields, height_mips};
use pipelines::init_terrain_pipelines;
use stats::TerrainStats;
use terrain_shadow::{
    TerrainShadows, extract::ExtractedShadows, extract::extract_shadows, prepare_terrain_shadows,
    terrain_shadow,
};
use view::{TerrainViews, prepare_terrain_bind_groups, prepare_terrain_views};

pub(crate) fn embed_shaders(app: &mut App) {
    shaders::embed(app);
}

/// Adds the terrain's passes to the render app, or says in [`TerrainStats`] why it cannot.
pub(crate) fn add_terrain_passes(app: &mut App) {
    let stats = app.world().resource::<TerrainStats>().clone();
    let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
        stats.lock().unsupported = Some("the app renders nothing: it has no RenderPlugin".into());
        return;
    };
    if let Err(reason) = check_capabilities(render_app.world()) {
        warn!("terrain is not drawn: {reason}");
        stats.lock().unsupported = Some(reason);
        return;
    }
    render_app
        .insert_resource(stats)
        .init_resource::<ExtractedTerrains>()
        .init_resource::<ExtractedShadows>()
        .init_gpu_resource::<GpuHeightFields>()
        .init_gpu_resource::<TerrainShadows>()
        .init_gpu_resource::<TerrainViews>()
        .init_gpu_resource::<TerrainCascades>()
        .add_systems(
            RenderStartup,
            init_terrain_pipelines.after(MeshPipelineSystems),
        )
        .add_systems(ExtractSchedule, (extract_terrains, extract_shadows))
        .add_systems(
            Render,
            (
                (
                    prepare_terrain_views,
                    // It knows which terrains are drawn.
                    prepare_terrain_shadows.after(prepare_terrain_views),
                )
                    .in_set(RenderSystems::PrepareResources),
                prepare_terrain_cascades
                    .in_set(RenderSystems::PrepareResources)
                    .after(prepare_terrain_views),
                prepare_terrain_bind_groups.in_set(RenderSystems::PrepareBindGroups),
            ),
        )
        .add_systems(
            RenderGraph,
            (height_mips, terrain_shadow)
                // Rays walk the pyramid; views read what shows.
                .chain()
                .before(camera_driver),
        )
        .add_systems(
            Core3d,
            (
                terrain::cast_terrain
                    // Rays stop at what meshes have drawn by then. (The deferred prepass may come before or
                    // after: it tests against whatever depth is there, and rays don't look at its.)
                    .after(early_prepass)
                    // Both read the depth that terrain must be part of.
                    .before(early_downsample_depth)
                    .before(late_prepass)
                    .in_set(Core3dSystems::Prepass),
                terrain_cascade
                    // Bevy's pass clears the maps, at the latest.
                    .after(per_view_shadow_pass::<EARLY_SHADOW_PASS>)
                    // Casters that terrain hides from the light are not drawn late.
                    .before(early_downsample_depth)
                    .before(per_view_shadow_pass::<LATE_SHADOW_PASS>)
                    // Which reads the maps.
                    .before(Core3dSystems::MainPass),
                terrain::terrain_shade
                    // What meshes cover is not lit.
                    .after(main_opaque_pass_3d)
                    // Transparent things blend over the lit terrain.
                    .before(main_transparent_pass_3d)
                    .in_set(Core3dSystems::MainPass),
            ),
        );
}

/// What the passes need of the GPU; the reason names what is missing.
fn check_capabilities(world: &World) -> Result<(), String> {
    let (Some(device), Some(adapter)) = (
        world.get_resource::<RenderDevice>(),
        world.get_resource::<RenderAdapter>(),
    ) else {
        return Err("no GPU was found: install a Vulkan, Metal or DirectX 12 driver".into());
    };
    let flags = adapter.get_downlevel_capabilities().flags;
    let needed = DownlevelFlags::COMPUTE_SHADERS
        | DownlevelFlags::INDIRECT_EXECUTION
        | DownlevelFlags::VERTEX_STORAGE;
    if !flags.contains(needed) {
        return Err(format!(
            "this GPU's driver lacks {:?}: use Vulkan, Metal or DirectX 12 instead of GL",
            needed - flags
        ));
    }
    let limits: WgpuLimits = device.limits();
    let most = [
        (
            "max_storage_buffers_per_shader_stage",
            limits.max_storage_buffers_per_shader_stage,
            5,
        ),
        (
            "max_storage_textures_per_shader_stage",
            limits.max_storage_textures_per_shader_stage,
            2,
        ),
        ("max_bind_groups", limits.max_bind_groups, 4),
        (
            "max_compute_invocations_per_workgroup",
            limits.max_compute_invocations_per_workgroup,
            64,
        ),
    ];
    for (name, has, needs) in most {
        if has < needs {
            return Err(format!(
                "this GPU's {name} is {has}, and terrain needs {needs}"
            ));
        }
    }
    Ok(())
}
