//! Resolution scale: before a frame is drawn, a camera's main passes are given a smaller part of its viewport; after
//! them, `upscale` stretches that part over the viewport.
//!
//! Bevy's passes look in three places for where to draw: `MainPassResolutionOverride`, the viewport of the
//! [`ExtractedCamera`], and that of the [`ExtractedView`], which the shaders see. All three are given the drawn part
//! here, because no pass looks at all of them: by the override alone, lights' clusters, deferred lighting and the skybox
//! would be those of the whole viewport. Bevy extracts camera and view anew each frame, and `upscale` gives the camera
//! its viewport back for the passes after it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bevy::{
    camera::{MainPassResolutionOverride, Viewport},
    core_pipeline::{
        prepass::MotionVectorPrepass,
        schedule::{Core3d, Core3dSystems},
    },
    ecs::{entity::EntityHashMap, schedule::ScheduleLabel},
    light::VolumetricFog,
    pbr::{
        ContactShadows, ScreenSpaceAmbientOcclusion, ScreenSpaceReflections,
        wireframe::wireframe_3d,
    },
    platform::time::Instant,
    prelude::*,
    render::{
        Extract, ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderStartup,
        RenderSystems,
        camera::{CameraRenderGraph, ExtractedCamera, TemporalJitter},
        diagnostic::RecordDiagnostics,
        occlusion_culling::OcclusionCulling,
        render_resource::{
            binding_types::{texture_2d, uniform_buffer_sized},
            *,
        },
        renderer::{RenderContext, RenderDevice, RenderQueue, ViewQuery},
        sync_world::RenderEntity,
        view::{ExtractedView, ViewTarget},
    },
};
use bytemuck::{Pod, Zeroable};

use super::{
    called::{self, ask, is_called_for},
    shaders,
};
use crate::resolution::{FullSize, ResolutionScale};

/// Adds the pass to the render app. An app that renders nothing has no use for it.
pub(crate) fn add_upscale_pass(app: &mut App) {
    let stats = app.world_mut().get_resource_or_init::<ScaleStats>().clone();
    let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
        return;
    };
    called::init::<ResolutionScale>(render_app);
    render_app
        .insert_resource(stats)
        .init_resource::<ExtractedScales>()
        .init_gpu_resource::<Upscalers>()
        .add_systems(RenderStartup, init_upscale_pipelines)
        .add_systems(
            ExtractSchedule,
            (
                ask::<ResolutionScale>,
                extract_scales.run_if(is_called_for::<ResolutionScale>),
            )
                .chain(),
        )
        .add_systems(
            Render,
            scale_main_passes
                // Bevy has extracted cameras and views by then.
                .after(RenderSystems::ExtractCommands)
                // All that looks at a camera's viewport comes later; late views of occlusion culling copy it there.
                .before(RenderSystems::PrepareAssets)
                .before(RenderSystems::PrepareMeshes)
                .run_if(any_asked_or_held),
        )
        .add_systems(
            Core3d,
            upscale
                // What they draw is stretched.
                .after(Core3dSystems::MainPass)
                .after(wireframe_3d)
                // Which comes at full resolution.
                .before(Core3dSystems::EarlyPostProcess)
                .run_if(any_scaled),
        );
}

/// What the render world tells the main world.
#[derive(Resource, Clone, Default)]
pub struct ScaleStats(Arc<Mutex<ScaleWork>>);

/// See [`ScaleStats`]; of the last frame that a camera asked in.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScaleWork {
    /// Cameras that were drawn with fewer pixels.
    pub cameras: u32,
    /// Of one of them, what was drawn and what that was stretched to. units: px
    pub size: (UVec2, UVec2),
    /// Why another was not.
    pub refused: Option<FullSize>,
    /// Whether the pass was still being compiled.
    pub compiling: bool,
    /// GPU memory held. units: bytes
    pub bytes: u64,
    /// Time to make it ready. units: ms
    pub cpu_ms: f32,
}

impl ScaleStats {
    /// Looks or changes.
    pub fn lock(&self) -> MutexGuard<'_, ScaleWork> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Cameras that ask for fewer pixels; refilled in place every frame.
#[derive(Resource, Default)]
pub struct ExtractedScales {
    cameras: Vec<ExtractedScale>,
    warned: EntityHashMap<Warned>,
}

struct ExtractedScale {
    main: Entity,
    render: Entity,
    scale: ResolutionScale,
}

/// What was said about a camera already.
#[derive(Clone, Copy, Default)]
struct Warned {
    range: bool,
    full_size: Option<FullSize>,
}

fn refuse(warned: &mut EntityHashMap<Warned>, camera: Entity, why: FullSize) {
    let warned = warned.entry(camera).or_default();
    if warned.full_size != Some(why) {
        warned.full_size = Some(why);
        warn!("`ResolutionScale` of camera {camera} does nothing: {why}");
    }
}

/// What is looked at of a camera with a [`ResolutionScale`].
type ScaledCamera<'w> = (
    Entity,
    RenderEntity,
    &'w ResolutionScale,
    &'w Camera,
    Option<&'w CameraRenderGraph>,
    (
        Has<TemporalJitter>,
        Has<MotionVectorPrepass>,
        Has<ScreenSpaceAmbientOcclusion>,
        Has<ScreenSpaceReflections>,
        Has<ContactShadows>,
        Has<VolumetricFog>,
        Has<OcclusionCulling>,
    ),
);

/// Lists the cameras whose scale is below 1 and can be followed; warns once of each that cannot.
pub fn extract_scales(
    mut extracted: ResMut<ExtractedScales>,
    stats: Res<ScaleStats>,
    cameras: Extract<Query<ScaledCamera<'static>>>,
) {
    let mut stats = stats.lock();
    *stats = ScaleWork {
        bytes: stats.bytes,
        ..default()
    };
    let ExtractedScales {
        cameras: asked,
        warned,
    } = &mut *extracted;
    asked.clear();
    if !warned.is_empty() {
        warned.retain(|camera, _| cameras.contains(*camera));
    }
    for (main, render, scale, camera, graph, has) in &cameras {
        if !scale.is_valid() {
            let warned = warned.entry(main).or_default();
            if !warned.range {
                warned.range = true;
                warn!(
                    "`ResolutionScale({})` of camera {main} is not within {}..=1: {} is used",
                    scale.0,
                    ResolutionScale::LEAST,
                    scale.clamped()
                );
            }
        }
        if scale.clamped() >= 1.0 || !camera.is_active {
            continue;
        }
        let (jitters, motion, ambient, reflections, contact, fog, culls) = has;
        let why = [
            (
                graph.is_none_or(|graph| graph.0 != Core3d.intern()),
                FullSize::NotCore3d,
            ),
            (
                matches!(camera.clear_color, ClearColorConfig::None),
                FullSize::DrawsOverOthers,
            ),
            (jitters, FullSize::Jitters),
            (motion, FullSize::MotionVectors),
            (ambient, FullSize::AmbientOcclusion),
            (reflections, FullSize::Reflections),
            (contact, FullSize::ContactShadows),
            (fog, FullSize::VolumetricFog),
            (culls, FullSize::BevysOcclusionCulling),
        ]
        .into_iter()
        .find_map(|(holds, why)| holds.then_some(why));
        match why {
            Some(why) => {
                stats.refused = Some(why);
                refuse(warned, main, why);
            }
            None => asked.push(ExtractedScale {
                main,
                render,
                scale: *scale,
            }),
        }
    }
}

/// On a camera in the render world: the override that was set here, to tell it from anyone else's.
#[derive(Component)]
pub struct OwnOverride(UVec2);

/// Where a pixel of the viewport lies in the drawn part; mirrored in `upscale.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct GpuStretch {
    /// Upper left corner of the viewport in the texture. units: px
    pub origin: [u32; 2],
    /// Its size. units: px
    pub size: [u32; 2],
    /// Size of the part that was drawn, from the same corner. units: px
    pub drawn: [u32; 2],
    /// `drawn` by `size`.
    pub ratio: [f32; 2],
}

/// What a camera that draws fewer pixels holds.
pub struct Upscaler {
    /// What is drawn of the viewport. units: px
    pub drawn: UVec2,
    stretch: GpuStretch,
    buffer: Buffer,
    /// The camera's own viewport, for the passes after `upscale`.
    viewport: Option<Viewport>,
    pipeline: CachedRenderPipelineId,
    /// By the main texture that is read; Bevy swaps two.
    bind_groups: [Option<(TextureViewId, BindGroup)>; 2],
    /// The newer of the two.
    newest: usize,
    live: bool,
}

/// Every camera's [`Upscaler`], by render entity.
#[derive(Resource, Default)]
pub struct Upscalers {
    /// Cameras that draw fewer pixels this frame.
    pub cameras: EntityHashMap<Upscaler>,
    /// Passes recorded so far.
    pub passes: u64,
    /// Bind groups and buffers made so far.
    pub made: u64,
}

/// Layout, and a pipeline for each format that was asked for.
#[derive(Resource)]
pub struct UpscalePipelines {
    assets: AssetServer,
    layout: BindGroupLayoutDescriptor,
    queued: Vec<(TextureFormat, CachedRenderPipelineId)>,
}

/// Makes the layout; runs again after the device was lost.
pub fn init_upscale_pipelines(mut commands: Commands, assets: Res<AssetServer>) {
    commands.insert_resource(UpscalePipelines {
        assets: assets.clone(),
        layout: BindGroupLayoutDescriptor::new(
            "skyline_upscale",
            &BindGroupLayoutEntries::sequential(
                ShaderStages::FRAGMENT,
                (
                    uniform_buffer_sized(
                        false,
                        core::num::NonZero::new(size_of::<GpuStretch>() as u64),
                    ),
                    texture_2d(TextureSampleType::Float { filterable: false }),
                ),
            ),
        ),
        queued: Vec::new(),
    });
}

impl UpscalePipelines {
    /// How many pipelines were queued.
    pub fn count(&self) -> usize {
        self.queued.len()
    }

    /// The pipeline for a format, queued if it is the first time; `None` until it is compiled.
    fn ready(
        &mut self,
        cache: &PipelineCache,
        format: TextureFormat,
    ) -> Option<CachedRenderPipelineId> {
        let found = self.queued.iter().find(|(of, _)| *of == format);
        let id = match found {
            Some((_, id)) => *id,
            None => {
                let shader = shaders::upscale::upscale(&self.assets);
                let id = cache.queue_render_pipeline(RenderPipelineDescriptor {
                    label: Some("upscale".into()),
                    layout: vec![self.layout.clone()],
                    vertex: VertexState {
                        shader: shader.clone(),
                        entry_point: Some("vertex".into()),
                        ..default()
                    },
                    fragment: Some(FragmentState {
                        shader,
                        entry_point: Some("fragment".into()),
                        targets: vec![Some(format.into())],
                        ..default()
                    }),
                    ..default()
                });
                self.queued.push((format, id));
                id
            }
        };
        cache.get_render_pipeline(id).map(|_| id)
    }
}

/// A camera that was despawned leaves no override, but an upscaler; a lost device, overrides without upscalers.
fn any_asked_or_held(
    extracted: Res<ExtractedScales>,
    upscalers: Res<Upscalers>,
    held: Query<(), With<OwnOverride>>,
) -> bool {
    !(extracted.cameras.is_empty() && upscalers.cameras.is_empty() && held.is_empty())
}

fn any_scaled(upscalers: Res<Upscalers>) -> bool {
    !upscalers.cameras.is_empty()
}

/// Gives the main passes of each camera that asks for it their part of the viewport, and takes it back from those that
/// no longer ask.
#[expect(
    clippy::too_many_arguments,
    reason = "it makes all of the effect's memory ready"
)]
pub fn scale_main_passes(
    mut commands: Commands,
    mut extracted: ResMut<ExtractedScales>,
    mut upscalers: ResMut<Upscalers>,
    mut pipelines: ResMut<UpscalePipelines>,
    stats: Res<ScaleStats>,
    mut cameras: Query<(
        &mut ExtractedCamera,
        &mut ExtractedView,
        Option<&mut MainPassResolutionOverride>,
        Option<&mut OwnOverride>,
    )>,
    held: Query<Entity, With<OwnOverride>>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    let start = Instant::now();
    let mut stats = stats.lock();
    let ExtractedScales {
        cameras: asked,
        warned,
    } = &mut *extracted;
    let Upscalers {
        cameras: upscalers,
        made,
        ..
    } = &mut *upscalers;
    upscalers.values_mut().for_each(|u| u.live = false);
    for asked in asked {
        let Ok((mut camera, mut view, mut given, mut own)) = cameras.get_mut(asked.render) else {
            continue;
        };
        if given.as_ref().map(|given| given.0) != own.as_ref().map(|own| own.0) {
            stats.refused = Some(FullSize::Overridden);
            refuse(warned, asked.main, FullSize::Overridden);
            continue;
        }
        let Some(size) = camera.physical_viewport_size else {
            continue;
        };
        let drawn = asked.scale.drawn_size(size);
        if drawn == size || drawn.min_element() == 0 {
            continue;
        }
        let Some(pipeline) = pipelines.ready(&cache, view.target_format) else {
            stats.compiling = true;
            continue;
        };
        let origin = view.viewport.xy();
        let stretch = GpuStretch {
            origin: origin.to_array(),
            size: size.to_array(),
            drawn: drawn.to_array(),
            ratio: (drawn.as_dvec2() / size.as_dvec2()).as_vec2().to_array(),
        };
        let upscaler = upscalers.entry(asked.render).or_insert_with(|| {
            *made += 1;
            Upscaler {
                drawn,
                stretch,
                buffer: device.create_buffer_with_data(&BufferInitDescriptor {
                    label: Some("skyline_upscale"),
                    usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
                    contents: bytemuck::bytes_of(&stretch),
                }),
                viewport: None,
                pipeline,
                bind_groups: [None, None],
                newest: 0,
                live: true,
            }
        });
        if upscaler.stretch != stretch {
            queue.write_buffer(&upscaler.buffer, 0, bytemuck::bytes_of(&stretch));
        }
        stats.cameras += 1;
        stats.size = (drawn, size);
        upscaler.live = true;
        (upscaler.drawn, upscaler.stretch, upscaler.pipeline) = (drawn, stretch, pipeline);
        upscaler.viewport.clone_from(&camera.viewport);
        if let (Some(given), Some(own)) = (&mut given, &mut own) {
            (given.0, own.0) = (drawn, drawn);
        } else {
            let both = (MainPassResolutionOverride(drawn), OwnOverride(drawn));
            commands.entity(asked.render).insert(both);
        }
        (view.viewport.z, view.viewport.w) = (drawn.x, drawn.y);
        let part = camera.viewport.get_or_insert_with(|| Viewport {
            physical_position: origin,
            ..default()
        });
        part.physical_size = drawn;
    }
    upscalers.retain(|_, upscaler| upscaler.live);
    stats.bytes = upscalers.values().map(|of| of.buffer.size()).sum();
    for entity in &held {
        if upscalers.contains_key(&entity) {
            continue;
        }
        let mut entity_commands = commands.entity(entity);
        entity_commands.remove::<OwnOverride>();
        // An inactive camera's has no view, but its override is ours as long as none has been put over it.
        if let Ok((_, _, given, own)) = cameras.get(entity)
            && given.map(|given| given.0) != own.map(|own| own.0)
        {
            continue;
        }
        entity_commands.remove::<MainPassResolutionOverride>();
    }
    stats.cpu_ms = start.elapsed().as_secs_f32() * 1e3;
}

/// Stretches the drawn part over the viewport, and gives the camera its viewport back.
///
/// # Inputs / outputs
/// The camera's main texture, to the other one, same size and format; pixels outside the viewport are carried over.
///
/// # Reference
/// Keys 1981, cubic convolution; twin: [`reference::upscale`](crate::reference::upscale).
pub fn upscale(
    view: ViewQuery<(
        &mut ExtractedCamera,
        &ViewTarget,
        Option<&MainPassResolutionOverride>,
    )>,
    mut upscalers: ResMut<Upscalers>,
    pipelines: Res<UpscalePipelines>,
    cache: Res<PipelineCache>,
    mut ctx: RenderContext,
) {
    let entity = view.entity();
    let (mut camera, target, given) = view.into_inner();
    let Upscalers {
        cameras,
        passes,
        made,
    } = &mut *upscalers;
    let Some(upscaler) = cameras.get_mut(&entity) else {
        return;
    };
    camera.viewport.clone_from(&upscaler.viewport);
    // Someone else has set a size of his own since: what was drawn is his to stretch.
    if given.is_none_or(|given| given.0 != upscaler.drawn) {
        return;
    }
    let Some(pipeline) = cache.get_render_pipeline(upscaler.pipeline) else {
        return;
    };
    let write = target.post_process_write();
    let bound = |slot: &Option<(TextureViewId, BindGroup)>| {
        slot.as_ref()
            .is_some_and(|(id, _)| *id == write.source.id())
    };
    let at = match upscaler.bind_groups.iter().position(bound) {
        Some(at) => at,
        None => {
            *made += 1;
            let group = ctx.render_device().create_bind_group(
                "upscale",
                &cache.get_bind_group_layout(&pipelines.layout),
                &BindGroupEntries::sequential((upscaler.buffer.as_entire_binding(), write.source)),
            );
            let at = 1 - upscaler.newest;
            upscaler.bind_groups[at] = Some((write.source.id(), group));
            at
        }
    };
    upscaler.newest = at;
    let Some((_, group)) = &upscaler.bind_groups[at] else {
        return;
    };
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let mut pass = ctx.begin_tracked_render_pass(RenderPassDescriptor {
        label: Some("upscale"),
        color_attachments: &[Some(RenderPassColorAttachment {
            view: write.destination,
            depth_slice: None,
            resolve_target: None,
            ops: Operations {
                // Every pixel is written; on tiled GPUs clearing spares loading.
                load: LoadOp::Clear(default()),
                store: StoreOp::Store,
            },
        })],
        depth_stencil_attachment: None,
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    });
    let span = diagnostics.pass_span(&mut pass, "upscale");
    pass.set_render_pipeline(pipeline);
    pass.set_bind_group(0, group, &[]);
    pass.draw(0..3, 0..1);
    span.end(&mut pass);
    *passes += 1;
}
