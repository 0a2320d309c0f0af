//! Adds the passes of terrain and its shadows to the render app, where the GPU can run them.

use bevy::{
    core_pipeline::{
        core_3d::{main_opaque_pass_3d, main_transparent_pass_3d},
        mip_generation::experimental::depth::early_downsample_depth,
        prepass::node::{early_prepass, late_prepass},
        schedule::{Core3d, Core3dSystems, camera_driver},
    },
    pbr::{
        EARLY_SHADOW_PASS, LATE_SHADOW_PASS, MeshPipelineSystems, main_transmissive_pass_3d,
        per_view_shadow_pass,
    },
    prelude::*,
    render::{
        ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems,
        render_resource::DownlevelFlags,
        renderer::{RenderAdapter, RenderDevice, RenderGraph, RenderGraphSystems},
        settings::WgpuLimits,
    },
};

use super::{
    TerrainShadeSystems,
    called::{self, ask, is_called_for},
    cascades::{TerrainCascades, prepare_terrain_cascades, terrain_cascade},
    extract::{ExtractedTerrains, extract_terrains},
    height_mips::{GpuHeightFields, height_mips},
    order::{before_all, over_opaque},
    pipelines::init_terrain_pipelines,
    stats::TerrainStats,
    terrain,
    terrain_shadow::{
        TerrainShadows, extract::ExtractedShadows, extract::extract_shadows,
        prepare_terrain_shadows, terrain_shadow,
    },
    view::{TerrainViews, prepare_terrain_bind_groups, prepare_terrain_views},
};

use crate::{terrain::Terrain, terrain_shadow::TerrainShadow};

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
    let over_opaque = over_opaque(render_app);
    called::init::<Terrain>(render_app);
    called::init::<TerrainShadow>(render_app);
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
        .add_systems(
            ExtractSchedule,
            (
                (
                    ask::<Terrain>,
                    extract_terrains.run_if(is_called_for::<Terrain>),
                )
                    .chain(),
                (
                    ask::<TerrainShadow>,
                    extract_shadows.run_if(is_called_for::<TerrainShadow>),
                )
                    .chain(),
            ),
        )
        .add_systems(
            Render,
            (
                (
                    prepare_terrain_views.run_if(is_called_for::<Terrain>),
                    prepare_terrain_shadows
                        // It knows which terrains are drawn.
                        .after(prepare_terrain_views)
                        .run_if(is_called_for::<TerrainShadow>),
                )
                    .in_set(RenderSystems::PrepareResources),
                prepare_terrain_cascades
                    .in_set(RenderSystems::PrepareResources)
                    .after(prepare_terrain_views)
                    .run_if(is_called_for::<Terrain>),
                prepare_terrain_bind_groups
                    .in_set(RenderSystems::PrepareBindGroups)
                    .run_if(is_called_for::<Terrain>),
            ),
        )
        .add_systems(
            RenderGraph,
            (
                height_mips.run_if(is_called_for::<Terrain>),
                terrain_shadow.run_if(is_called_for::<TerrainShadow>),
            )
                // Rays walk the pyramid; views read what shows.
                .chain()
                // Their times are taken as those of cameras are.
                .in_set(RenderGraphSystems::Render)
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
                before_all(
                    terrain::terrain_shade
                        // What meshes cover is not lit.
                        .after(main_opaque_pass_3d)
                        // Transparent things blend over the lit terrain, glass shows it.
                        .before(main_transmissive_pass_3d)
                        .before(main_transparent_pass_3d)
                        .in_set(TerrainShadeSystems)
                        .in_set(Core3dSystems::MainPass),
                    // Air lies before it.
                    &over_opaque,
                ),
            )
                .run_if(is_called_for::<Terrain>),
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
