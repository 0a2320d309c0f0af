//! Bevy without a window, driven frame by frame: what the `skyline` command and the tests stand on. [`interior`] needs
//! no Bevy at all: it takes what is hidden out of a model's file.

pub mod accuracy;
pub mod glyphs;
pub mod interior;
pub mod plot;
pub mod render;
pub mod scenes;
pub mod shadow;
pub mod shadow_map;
pub mod workload;

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use bevy::{
    app::PluginsState,
    asset::{RenderAssetUsages, UnapprovedPathMode},
    camera::RenderTarget,
    diagnostic::{DiagnosticPath, DiagnosticsStore},
    image::Image,
    log::{DEFAULT_FILTER, Level, LogPlugin},
    platform::time::Instant,
    prelude::*,
    render::{
        RenderApp, RenderPlugin,
        diagnostic::RenderDiagnosticsPlugin,
        pipelined_rendering::PipelinedRenderingPlugin,
        render_asset::RenderAssets,
        render_resource::*,
        renderer::{RenderAdapterInfo, RenderDevice, RenderQueue},
        texture::GpuImage,
    },
    time::TimeUpdateStrategy,
    window::{ExitCondition, WindowPlugin},
};

use crate::{
    plugin::SkylinePlugins,
    precision::affine64,
    render_graph::{
        height_mips::GpuHeightFields,
        stats::{TerrainCounts, TerrainStats},
        terrain::Caster,
        view::TerrainViews,
    },
    systems::spans::in_frame,
    terrain::{
        HeightField, HeightSamples, Terrain, TerrainRayCasting, Traversal,
        view_rays::{ViewInputs, ViewRays},
    },
};

/// Every traversal and its name as a flag's value.
pub const TRAVERSALS: [(Traversal, &str); 4] = [
    (Traversal::PerTexel, "per-texel"),
    (Traversal::MaxMip, "max-mip"),
    (Traversal::Boxes, "boxes"),
    (Traversal::Hybrid, "hybrid"),
];

/// Name of a traversal as a flag's value.
pub fn traversal_name(traversal: Traversal) -> &'static str {
    TRAVERSALS
        .iter()
        .find(|(t, _)| *t == traversal)
        .map_or("unknown", |(_, name)| name)
}

/// Time that passes from one frame to the next. units: s
const FRAME_S: f64 = 1.0 / 60.0;

/// Why something could not be rendered without a window.
#[derive(thiserror::Error, Debug)]
#[non_exhaustive]
pub enum OfflineError {
    /// No GPU or no driver.
    #[error(
        "no GPU device could be opened: install a Vulkan driver (on Debian: mesa-vulkan-drivers)"
    )]
    NoDevice,
    /// The picture did not appear.
    #[error("the picture was not finished after {0} frames; see the log for the pass that failed")]
    NotFinished(u32),
    /// The GPU gave back no data.
    #[error("the GPU's memory could not be read back: {0}")]
    ReadBack(String),
    /// Terrain cannot be drawn here.
    #[error("terrain cannot be drawn here: {0}")]
    Unsupported(String),
    /// One of the GPU's limits stands against it.
    #[error("this GPU cannot hold the height field: {0}")]
    Refused(String),
}

/// What rays hit, pixel by pixel, row by row from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct HitImage {
    /// Size in pixels.
    pub size: UVec2,
    /// NDC depth, reverse-Z; 0 where there is no terrain.
    pub ndc_depth: Vec<f32>,
    /// Low 8 bits: which terrain, from 1. Above: nodes and cells its rays read.
    pub surface: Vec<u32>,
    /// Nodes that the beams of all tiles read before the rays did.
    pub beam_reads: u64,
}

impl HitImage {
    /// An image of sky.
    pub fn sky(size: UVec2) -> Self {
        let pixels = size.x as usize * size.y as usize;
        Self {
            size,
            ndc_depth: vec![0.0; pixels],
            surface: vec![0; pixels],
            beam_reads: 0,
        }
    }

    /// Whether each pixel shows terrain.
    pub fn coverage(&self) -> impl Iterator<Item = bool> + '_ {
        self.surface.iter().map(|surface| surface & 0xff != 0)
    }

    /// Pixels that show terrain.
    pub fn terrain_px(&self) -> usize {
        self.coverage().filter(|terrain| *terrain).count()
    }

    /// Nodes and cells read by each pixel's own ray.
    pub fn reads(&self) -> impl Iterator<Item = u32> + '_ {
        self.surface.iter().map(|surface| surface >> 8)
    }

    /// Mean over the pixels of everything read: by their rays, and their share of what beams read.
    pub fn mean_reads(&self) -> f64 {
        let rays: u64 = self.reads().map(u64::from).sum();
        (rays + self.beam_reads) as f64 / self.surface.len().max(1) as f64
    }
}

/// The plugins of a headless app: everything Bevy renders with, no window, pipelines compiled before their
/// first frame, steps taken by hand. A process has one log, which its first app sets up.
pub fn headless_plugins() -> impl PluginGroup {
    static LOGS: AtomicBool = AtomicBool::new(false);
    let plugins = DefaultPlugins
        .set(WindowPlugin {
            primary_window: None,
            exit_condition: ExitCondition::DontExit,
            ..default()
        })
        // Progress is ours to report, the adapter too; RUST_LOG still asks for more.
        .set(LogPlugin {
            level: Level::WARN,
            filter: format!("{DEFAULT_FILTER}bevy_render::renderer=error"),
            ..default()
        })
        .set(RenderPlugin {
            synchronous_pipeline_compilation: true,
            ..default()
        })
        .set(AssetPlugin {
            unapproved_path_mode: UnapprovedPathMode::Allow,
            ..default()
        })
        .disable::<PipelinedRenderingPlugin>();
    #[cfg(feature = "window")]
    let plugins = plugins.disable::<bevy::winit::WinitPlugin>();
    if LOGS.swap(true, Ordering::Relaxed) {
        plugins.disable::<LogPlugin>()
    } else {
        plugins
    }
}

/// A headless app with [`SkylinePlugins`].
pub struct Offline {
    /// The app itself.
    pub app: App,
}

impl Offline {
    /// Opens a device and starts the app.
    ///
    /// # Errors
    /// [`OfflineError::NoDevice`] where there is no GPU driver, not even a software one.
    pub fn new() -> Result<Self, OfflineError> {
        Self::with(|_| {})
    }

    /// The same, after `configure` has added what else the app needs.
    pub fn with(configure: impl FnOnce(&mut App)) -> Result<Self, OfflineError> {
        Self::start(|app| {
            app.add_plugins(SkylinePlugins);
            configure(app);
        })
    }

    /// A headless app with what `configure` adds and nothing else of ours.
    ///
    /// # Errors
    /// As [`Offline::new`].
    pub fn start(configure: impl FnOnce(&mut App)) -> Result<Self, OfflineError> {
        let mut app = App::new();
        app.add_plugins((headless_plugins(), RenderDiagnosticsPlugin))
            .insert_resource(TimeUpdateStrategy::ManualDuration(Duration::from_secs_f64(
                FRAME_S,
            )));
        configure(&mut app);
        while app.plugins_state() == PluginsState::Adding {
            bevy::tasks::tick_global_task_pools_on_main_thread();
        }
        app.finish();
        app.cleanup();
        if app.world().get_resource::<RenderDevice>().is_none() {
            return Err(OfflineError::NoDevice);
        }
        Ok(Self { app })
    }

    /// Name of the GPU.
    pub fn adapter(&self) -> String {
        self.app
            .world()
            .get_resource::<RenderAdapterInfo>()
            .map_or_else(|| "none".into(), |info| info.name.clone())
    }

    /// Whether the GPU is a software driver, on whose timestamps around compute passes nothing can be built.
    pub fn is_software(&self) -> bool {
        self.app
            .world()
            .get_resource::<RenderAdapterInfo>()
            .is_some_and(|info| info.device_type == wgpu::DeviceType::Cpu)
    }

    /// An image cameras can draw to and that can be read back.
    pub fn target(&mut self, size: UVec2) -> Handle<Image> {
        let mut image =
            Image::new_target_texture(size.x, size.y, TextureFormat::Rgba8UnormSrgb, None);
        image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
        image.asset_usage = RenderAssetUsages::default();
        self.app
            .world_mut()
            .resource_mut::<Assets<Image>>()
            .add(image)
    }

    /// Spawns a camera that draws to `target`.
    pub fn camera(&mut self, target: &Handle<Image>, bundle: impl Bundle) -> Entity {
        self.app
            .world_mut()
            .spawn((
                Camera3d::default(),
                RenderTarget::Image(target.clone().into()),
                bundle,
            ))
            .id()
    }

    /// One frame, finished on the GPU when this returns.
    pub fn step(&mut self) {
        self.app.update();
        if let Some(device) = self.app.world().get_resource::<RenderDevice>() {
            // A lost device is Bevy's to report.
            let _ = device.poll(PollType::wait_indefinitely());
        }
    }

    /// Frames until `camera` has terrain drawn, at most `limit`.
    ///
    /// # Errors
    /// [`OfflineError::NotFinished`], or [`OfflineError::Unsupported`] with the reason.
    pub fn settle(&mut self, camera: Entity, limit: u32) -> Result<(), OfflineError> {
        for _ in 0..limit {
            self.step();
            if self.views().is_some_and(|views| {
                views.views.get(&camera).is_some_and(|view| {
                    !view.drawn.is_empty()
                        && view.slots.values().all(|slot| slot.bind_groups.is_some())
                })
            }) {
                // Once more: the first frame found its pipelines only while it was being drawn.
                self.step();
                return Ok(());
            }
        }
        let counts = self.counts();
        if let Some(reason) = counts.unsupported {
            return Err(OfflineError::Unsupported(reason));
        }
        if let Some(reason) = counts.refused.into_iter().next() {
            return Err(OfflineError::Refused(reason));
        }
        Err(OfflineError::NotFinished(limit))
    }

    /// What the terrain's passes have counted so far.
    pub fn counts(&self) -> TerrainCounts {
        self.app
            .world()
            .get_resource::<TerrainStats>()
            .map_or_else(default, |s| s.lock().clone())
    }

    /// Boxes the last frame's subdivision of a terrain asked for, and how many there was room for.
    pub fn boxes(&self, camera: Entity, terrain: Entity) -> Option<(u64, u64)> {
        let lists = self
            .views()?
            .views
            .get(&camera)?
            .slots
            .get(&terrain)?
            .lists
            .as_ref()?;
        Some((lists.readback.latest(), u64::from(lists.capacity)))
    }

    /// The most pixels an image may have a side.
    pub fn max_image_side(&self) -> u32 {
        let device = self.app.world().get_resource::<RenderDevice>();
        device.map_or(0, |device| device.limits().max_texture_dimension_2d)
    }

    /// The rays `camera` cast at `terrain` in the last frame, composed as the renderer does.
    ///
    /// `None` if none of them could meet it. A camera that jitters is not served.
    pub fn view_rays(&self, camera: Entity, terrain: Entity) -> Option<ViewRays> {
        let world = self.app.world();
        let settings = world
            .get::<TerrainRayCasting>(camera)
            .copied()
            .unwrap_or_default();
        let handle = &world.get::<Terrain>(terrain)?.height_field;
        let field = world.get_resource::<Assets<HeightField>>()?.get(handle)?;
        let transform = |entity| {
            world
                .get::<GlobalTransform>(entity)
                .map(|t| affine64(t.affine()))
        };
        let view = world.get::<Camera>(camera)?;
        let (highest, lowest) = field.pyramid().top();
        ViewRays::new(&ViewInputs {
            clip_from_view: view.clip_from_view(),
            grid_from_view: field.grid_from_local()
                * transform(terrain)?.inverse()
                * transform(camera)?,
            size_px: view.physical_viewport_size()?,
            cells: field.cells(),
            height_range: (lowest, highest),
            whole_heights: matches!(field.samples(), HeightSamples::U16(_)),
            max_error_px: settings.max_error_px,
        })
        .filter(ViewRays::sees_terrain)
    }

    fn views(&self) -> Option<&TerrainViews> {
        self.app
            .get_sub_app(RenderApp)?
            .world()
            .get_resource::<TerrainViews>()
    }

    /// What the rays of the last frame hit; `None` if this camera had no terrain in view.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn hits(&self, camera: Entity) -> Result<Option<HitImage>, OfflineError> {
        let Some((view, targets)) = self
            .views()
            .and_then(|views| views.views.get(&camera))
            .filter(|view| !view.drawn.is_empty())
            .and_then(|view| Some((view, view.targets.as_ref()?)))
        else {
            return Ok(None);
        };
        let mut beam_reads = 0;
        for starts in view
            .drawn_slots()
            .filter_map(|slot| slot.tile_start.as_ref())
            .flatten()
        {
            let size = 8 * u64::from(starts.tiles.x) * u64::from(starts.tiles.y);
            let bytes = self.read_back(size, |encoder, buffer| {
                encoder.copy_buffer_to_buffer(&starts.buffer, 0, buffer, 0, size);
            })?;
            let words: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
            beam_reads += words
                .iter()
                .skip(1)
                .step_by(2)
                .map(|word| u64::from(word >> 8))
                .sum::<u64>();
        }
        let depth = self.read_texture(&targets.depth, targets.size, 4)?;
        let surface = self.read_texture(&targets.surface, targets.size, 4)?;
        Ok(Some(HitImage {
            size: targets.size,
            ndc_depth: bytemuck::pod_collect_to_vec(&depth),
            surface: bytemuck::pod_collect_to_vec(&surface),
            beam_reads,
        }))
    }

    /// The colours last drawn to an image made by [`target`](Self::target).
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn picture(&self, target: &Handle<Image>) -> Result<image::RgbaImage, OfflineError> {
        let gone = || OfflineError::ReadBack("the image is not on the GPU".into());
        let gpu = self
            .app
            .get_sub_app(RenderApp)
            .and_then(|render| {
                render
                    .world()
                    .get_resource::<RenderAssets<GpuImage>>()?
                    .get(target)
            })
            .ok_or_else(gone)?;
        let size = UVec2::new(
            gpu.texture_descriptor.size.width,
            gpu.texture_descriptor.size.height,
        );
        let bytes = self.read_texture(&gpu.texture, size, 4)?;
        image::RgbaImage::from_raw(size.x, size.y, bytes).ok_or_else(gone)
    }

    /// The pyramid of a height field as the GPU has it, laid out as
    /// [`MinMaxPyramid`](crate::terrain::MinMaxPyramid); `None` if no terrain shows it.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn pyramid(&self, field: AssetId<HeightField>) -> Result<Option<Vec<u8>>, OfflineError> {
        let Some(field) = self
            .app
            .get_sub_app(RenderApp)
            .and_then(|render| render.world().get_resource::<GpuHeightFields>()?.get(field))
        else {
            return Ok(None);
        };
        let size = field.pyramid.size();
        self.read_back(size, |encoder, buffer| {
            encoder.copy_buffer_to_buffer(&field.pyramid, 0, buffer, 0, size);
        })
        .map(Some)
    }

    /// Copies a texture back, rows from the top, without padding.
    fn read_texture(
        &self,
        texture: &Texture,
        size: UVec2,
        texel_bytes: u32,
    ) -> Result<Vec<u8>, OfflineError> {
        let row = size.x * texel_bytes;
        let padded = row.next_multiple_of(256);
        let bytes = self.read_back(u64::from(padded) * u64::from(size.y), |encoder, buffer| {
            encoder.copy_texture_to_buffer(
                texture.as_image_copy(),
                TexelCopyBufferInfo {
                    buffer,
                    layout: TexelCopyBufferLayout {
                        offset: 0,
                        bytes_per_row: Some(padded),
                        rows_per_image: None,
                    },
                },
                Extent3d {
                    width: size.x,
                    height: size.y,
                    depth_or_array_layers: 1,
                },
            );
        })?;
        Ok(bytes
            .chunks(padded as usize)
            .flat_map(|line| &line[..row as usize])
            .copied()
            .collect())
    }

    /// Has the GPU write a buffer, waits for it, and returns its bytes.
    fn read_back(
        &self,
        size: u64,
        write: impl FnOnce(&mut CommandEncoder, &Buffer),
    ) -> Result<Vec<u8>, OfflineError> {
        let world = self.app.world();
        let (Some(device), Some(queue)) = (
            world.get_resource::<RenderDevice>(),
            world.get_resource::<RenderQueue>(),
        ) else {
            return Err(OfflineError::NoDevice);
        };
        let buffer = device.create_buffer(&BufferDescriptor {
            label: Some("skyline_read_back"),
            size,
            usage: BufferUsages::COPY_DST | BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = device.create_command_encoder(&default());
        write(&mut encoder, &buffer);
        queue.submit([encoder.finish()]);
        let (sender, receiver) = std::sync::mpsc::channel();
        buffer.slice(..).map_async(MapMode::Read, move |result| {
            // The receiver waits below for as long as this can run.
            let _ = sender.send(result);
        });
        let failed = |error: &dyn core::fmt::Display| OfflineError::ReadBack(error.to_string());
        device
            .poll(PollType::wait_indefinitely())
            .map_err(|error| failed(&error))?;
        receiver
            .recv()
            .map_err(|error| failed(&error))?
            .map_err(|error| failed(&error))?;
        Ok(buffer.slice(..).get_mapped_range().to_vec())
    }

    /// GPU time of each span in the last frame it was measured in. units: ms
    pub fn gpu_ms(&self, span: &str) -> Option<f64> {
        let store = self.app.world().get_resource::<DiagnosticsStore>()?;
        let path = DiagnosticPath::new(format!("render/{span}/elapsed_gpu"));
        let span = store.get(&path)?;
        Some(in_frame(span, span.measurement()?.time))
    }

    /// The same, if it came to the main world after `since`.
    pub fn gpu_ms_since(&self, span: &str, since: Instant) -> Option<f64> {
        let store = self.app.world().get_resource::<DiagnosticsStore>()?;
        let path = DiagnosticPath::new(format!("render/{span}/elapsed_gpu"));
        let span = store.get(&path)?;
        let newest = span.measurement()?.time;
        (newest >= since).then(|| in_frame(span, newest))
    }

    /// Casts a camera's rays again, by themselves and waited for: times of subdivide, box_entry, beam and
    /// ray_cast. units: ms
    ///
    /// Where a driver's timestamps around compute passes mean nothing (Mesa's software driver) this is what
    /// can be trusted; it includes the time to submit each pass and wait for it.
    pub fn time_cast(&self, camera: Entity) -> Option<[f64; 4]> {
        let render = self.app.get_sub_app(RenderApp)?.world();
        let view = self.views()?.views.get(&camera)?;
        let cache = render.get_resource::<PipelineCache>()?;
        let stats = render.get_resource::<TerrainStats>()?;
        let device = render.get_resource::<RenderDevice>()?;
        let queue = render.get_resource::<RenderQueue>()?;
        let mut times = [0.0; 4];
        for slot in view.drawn_slots() {
            for (stage, time) in times.iter_mut().enumerate() {
                let mut encoder = device.create_command_encoder(&default());
                let mut caster = Caster {
                    cache,
                    stats,
                    diagnostics: None,
                    encoder: &mut encoder,
                };
                match stage {
                    0 => caster.subdivide(slot),
                    1 => caster.box_entry(slot, view),
                    2 => caster.beam(slot),
                    _ => caster.ray_cast(slot, view),
                }
                let start = Instant::now();
                queue.submit([encoder.finish()]);
                device.poll(PollType::wait_indefinitely()).ok()?;
                *time += start.elapsed().as_secs_f64() * 1e3;
            }
        }
        Some(times)
    }
}
/// Shows on standard error what long work is at, how far it is and for how long.
fn spinner() -> indicatif::ProgressBar {
    let progress = indicatif::ProgressBar::new_spinner();
    let style = indicatif::ProgressStyle::with_template("{spinner} {pos} {elapsed} {msg}");
    if let Ok(style) = style {
        progress.set_style(style);
    }
    progress
}
