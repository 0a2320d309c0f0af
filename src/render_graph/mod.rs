//! Everything that runs in the render world, and the one table of when.
//!
//! | Pass | Schedule | After | Before | Because |
//! |---|---|---|---|---|
//! | `ask::<Terrain>` | `ExtractSchedule` | – | `extract_terrains` | whether anything asks; see `called` |
//! | `ask::<TerrainShadow>` | `ExtractSchedule` | – | `extract_shadows` | whether anything asks; see `called` |
//! | `ask::<ContributionCamera>` | `ExtractSchedule` | – | `extract_contribution` | whether anything asks; see `called` |
//! | `ask::<ZBufferOcclusion>` | `ExtractSchedule` | – | `extract_occlusion` | whether anything asks; see `called` |
//! | `ask::<ResolutionScale>` | `ExtractSchedule` | – | `extract_scales` | whether anything asks; see `called` |
//! | `extract_terrains` | `ExtractSchedule` | – | – | uploads changed heights straight from the asset |
//! | `extract_shadows` | `ExtractSchedule` | – | – | notes which heights have changed |
//! | `prepare_terrain_views` | `Render`, `PrepareResources` | – | – | rays, textures, lists |
//! | `prepare_terrain_shadows` | `Render`, `PrepareResources` | `prepare_terrain_views` | – | plans what is made of the shadow maps of terrains that some camera draws |
//! | `prepare_terrain_cascades` | `Render`, `PrepareResources` | `prepare_terrain_views` | – | adds to its counts; the cascades are there since `CreateViews` |
//! | `prepare_terrain_bind_groups` | `Render`, `PrepareBindGroups` | – | – | binds what is new, queues pipelines |
//! | `height_mips` | `RenderGraph`, `Render` | `begin_diagnostics_frame` | `camera_driver` | its time is of this frame; views read this frame's pyramid |
//! | `terrain_shadow` | `RenderGraph`, `Render` | `height_mips` | `camera_driver` | views read the maps it shows |
//! | `cast_terrain` | `Core3d`, `Prepass` | `early_prepass` | `early_downsample_depth`, `late_prepass` | rays stop at meshes; terrain is in Bevy's depth pyramid |
//! | `terrain_cascade` | `Core3d` | `per_view_shadow_pass::<EARLY_SHADOW_PASS>` | `early_downsample_depth`, `per_view_shadow_pass::<LATE_SHADOW_PASS>`, `MainPass` | terrain is among the casters that occlusion culling of lights and shading read |
//! | `terrain_shade` | `Core3d`, `MainPass` | `main_opaque_pass_3d` | `main_transmissive_pass_3d`, `main_transparent_pass_3d`, `render_sky` | pixels that meshes cover are not lit; transparency blends over terrain |
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
//! | `upscale` | `Core3d` | `MainPass`, wireframe_3d where there is one | `EarlyPostProcess` | what they draw is stretched; post-processing comes at full resolution |
//! | `extract_frame` | `ExtractSchedule` | – | – | which frame the frame budget wants timed |
//! | `begin_render` | `Render` | – | `ExtractCommands` | the schedule's time starts with it |
//! | `begin_wait` | `Render`, `PrepareViews` | – | `prepare_windows` | waiting for the display is no work |
//! | `end_wait` | `Render`, `PrepareViews` | `prepare_windows` | – | it has waited |
//! | `end_render` | `Render` | `render_system` | `Cleanup` | all that draws has; limiters sleep in `Cleanup` |
//! | `note_uploads` | `Render`, `PrepareAssets` | `prepare_assets::<RenderMesh>` | – | meshes of some triangles of others are shown once they can be drawn |
//! | `unpack_bins` | `UnpackLateBins`, for each late view before any camera | – | – | a late view's draws need what Bevy unpacks for its own |
//! | `recheck::<WithPrepass>`, `build_late_prepass`, `late_view_prepass`, `late_view_deferred` | `Core3d`, `Prepass`, chained | `late_prepass`, `per_view_shadow_pass::<LATE_SHADOW_PASS>`, `shared_shadow_pass::<LATE_SHADOW_PASS>` | `late_deferred_prepass`, `main_build_indirect_parameters` | all that a prepass draws early is in the depth, terrain included; draw commands that the lights still need are not rebuilt before; copies of what the deferred prepass wrote come after; what is drawn late is in the main pass's draws |
//! | `recheck::<WithoutPrepass>`, `build_late_main`, `late_opaque` | `Core3d`, `MainPass`, chained | `main_opaque_pass_3d` | `terrain_shade`, `main_transmissive_pass_3d`, `main_transparent_pass_3d`, `render_sky` | all that is drawn early is in the depth; pixels drawn late are not lit as terrain; glass shows them, transparency blends over them, air lies before them |
//!
//! Of an effect that no entity asks for, nothing runs but the question (`called`): `extract_…` and all below are
//! conditional on its answer, or on what was extracted and is still held.
//!
//! A test holds every row against the schedules as they are built, and finds systems that are not in it; the picture of
//! it is in `docs/architecture.md`. `budget::measure` has the four that time `Render`.
//!
//! `terrain_shadow` is one dispatch of `terrain_shadow` or `shadow_sweep`, then `shadow_mips`.
//! `cast_terrain` is `subdivide`, `box_entry`, `beam`, `ray_cast` for each terrain, then `terrain_depth` for all.
//! `terrain_cascade` is `terrain_cascade_cast` and `terrain_cascade_erode` for each cascade that needs it, then the
//! depth of each.
//! `contribution` is the dispatch of that name, then `forget_draws` and `late_draws` over the camera's own instances.
//! `recheck` is `depth_reduce`, `occludee_verdicts`, `late_draws`, then the copies that are read back; a camera has
//! one of the two, by whether it draws into its depth before the main pass. `late_opaque` also draws, in the main
//! pass, what `late_view_prepass` drew in the prepass.

#[cfg(any(feature = "terrain", feature = "culling", feature = "budget"))]
pub(crate) mod called;
#[cfg(feature = "terrain")]
pub mod cascades;
#[cfg(feature = "culling")]
pub mod contribution;
#[cfg(feature = "terrain")]
pub(crate) mod extract;
#[cfg(feature = "terrain")]
pub mod height_mips;
#[cfg(any(feature = "interior", feature = "spherical"))]
pub(crate) mod mesh_uploads;
#[cfg(feature = "culling")]
pub mod occludee_verdicts;
#[cfg(feature = "culling")]
pub mod occlusion;
#[cfg(any(feature = "terrain", feature = "culling"))]
mod order;
#[cfg(feature = "terrain")]
pub(crate) mod pipelines;
#[cfg(feature = "terrain")]
mod readback;
pub(crate) mod shaders;
#[cfg(feature = "terrain")]
pub mod stats;
#[cfg(feature = "terrain")]
pub(crate) mod subdivide;
#[cfg(feature = "terrain")]
pub mod terrain;
#[cfg(feature = "terrain")]
pub(crate) mod terrain_passes;
#[cfg(feature = "terrain")]
pub mod terrain_shadow;
#[cfg(feature = "budget")]
pub mod upscale;
#[cfg(feature = "terrain")]
pub mod view;

use bevy::prelude::*;

/// Where `terrain_shade` lights terrain, in `Core3d`; empty where no terrain is built.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TerrainShadeSystems;
