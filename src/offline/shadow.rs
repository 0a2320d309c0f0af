//! Shadow maps by themselves, made at once: what `skyline shadow` writes, and what is measured.

use bevy::{
    platform::time::Instant,
    prelude::*,
    render::{RenderApp, render_resource::*, renderer::RenderDevice, renderer::RenderQueue},
};

use super::{Offline, OfflineError};
use crate::{
    render_graph::{
        height_mips::GpuHeightFields,
        pipelines::TerrainPipelines,
        stats::TerrainStats,
        terrain_shadow::{
            TerrainShadows,
            gpu::{Making, SweepPath},
        },
    },
    terrain::HeightField,
    terrain_shadow::{
        ShadowMethod,
        light::GridLight,
        plan::{MadeFor, MapPlan, Work},
        tiles::TileGrid,
    },
};

/// Every method and its name as a flag's value.
pub const METHODS: [(ShadowMethod, &str); 3] = [
    (ShadowMethod::PerTexel, "per-texel"),
    (ShadowMethod::MaxMip, "max-mip"),
    (ShadowMethod::Sweep, "sweep"),
];

/// Name of a method as a flag's value.
pub fn method_name(method: ShadowMethod) -> &'static str {
    METHODS
        .iter()
        .find(|(m, _)| *m == method)
        .map_or("unknown", |(_, name)| name)
}

/// Frames to wait for a field's upload and for a pipeline.
const PATIENCE: u32 = 60;

/// How much of a light each sample of a field sees: 255 all of it, 0 none. Row by row from sample (0, 0).
#[derive(Clone, Debug, PartialEq)]
pub struct ShadowImage {
    /// Samples.
    pub size: UVec2,
    /// A byte a sample. Samples the light cannot reach are 255.
    pub visibility: Vec<u8>,
}

impl ShadowImage {
    /// From a map's bytes, tile by tile.
    fn from_tiles(size: UVec2, grid: TileGrid, bytes: &[u8]) -> Self {
        let mut visibility = vec![255; size.x as usize * size.y as usize];
        for tile in 0..grid.len() {
            let samples = grid.samples(tile, size);
            for j in samples.min.y..samples.max.y {
                let from = grid.byte(UVec2::new(samples.min.x, j));
                let to = j as usize * size.x as usize + samples.min.x as usize;
                let count = samples.width() as usize;
                visibility[to..to + count].copy_from_slice(&bytes[from..from + count]);
            }
        }
        Self { size, visibility }
    }

    /// A sample's byte.
    pub fn at(&self, sample: UVec2) -> u8 {
        self.visibility[sample.y as usize * self.size.x as usize + sample.x as usize]
    }
}

impl Offline {
    /// Frames until every shadow map is up to date, at most `limit`. How many it takes depends on
    /// [`slice_ms`](crate::terrain_shadow::TerrainShadow::slice_ms).
    ///
    /// # Errors
    /// [`OfflineError::NotFinished`]; also if no camera sees the terrain, for then nothing is made.
    pub fn settle_shadows(&mut self, limit: u32) -> Result<(), OfflineError> {
        for _ in 0..limit {
            self.step();
            let shadows = self.counts().shadows;
            if !shadows.waiting && shadows.shown == shadows.maps {
                // Once more: what shows was copied while this frame's pipelines were still chosen without it.
                self.step();
                return Ok(());
            }
        }
        Err(OfflineError::NotFinished(limit))
    }

    /// The map that shows of a terrain and a light; `None` if there is none.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn shadow_map(
        &self,
        terrain: Entity,
        light: Entity,
    ) -> Result<Option<ShadowImage>, OfflineError> {
        let size = self.app.get_sub_app(RenderApp).and_then(|render| {
            let maps = render.world().get_resource::<TerrainShadows>()?;
            Some(maps.get(terrain)?.size())
        });
        let tiles = self.shadow_tiles(terrain, light)?;
        Ok(size
            .zip(tiles)
            .map(|(size, (grid, bytes))| ShadowImage::from_tiles(size, grid, &bytes)))
    }

    /// The same as the GPU has it: tile by tile, each with its averages behind.
    ///
    /// # Errors
    /// [`OfflineError::ReadBack`].
    pub fn shadow_tiles(
        &self,
        terrain: Entity,
        light: Entity,
    ) -> Result<Option<(TileGrid, Vec<u8>)>, OfflineError> {
        let found = self.app.get_sub_app(RenderApp).and_then(|render| {
            let shadows = render.world().get_resource::<TerrainShadows>()?;
            let maps = shadows.get(terrain)?;
            let map = maps.lights.iter().find(|map| map.entity == light)?;
            Some((maps.shown.as_ref()?, map.shown?))
        });
        let Some((buffer, shown)) = found else {
            return Ok(None);
        };
        let bytes = self.read_back(shown.grid.bytes(), |encoder, to| {
            encoder.copy_buffer_to_buffer(buffer, shown.offset, to, 0, shown.grid.bytes());
        })?;
        Ok(Some((shown.grid, bytes)))
    }

    /// Makes a map of a field that some terrain shows, in one go, `runs` times. Returns it, and how long each took
    /// from its commands' submission to their end. units: ms
    ///
    /// # Errors
    /// [`OfflineError::NotFinished`] if the field or a pipeline did not become ready, [`OfflineError::ReadBack`],
    /// [`OfflineError::Refused`] if the light reaches none of the field.
    pub fn cast_shadow(
        &mut self,
        id: AssetId<HeightField>,
        light: &GridLight,
        method: ShadowMethod,
        strips: u32,
        runs: usize,
    ) -> Result<(ShadowImage, Vec<f64>), OfflineError> {
        for _ in 0..PATIENCE {
            if let Some(made) = self.try_cast_shadow(id, light, method, strips, runs)? {
                return Ok(made);
            }
            self.step();
        }
        if let Some(reason) = self.counts().refused.into_iter().next() {
            return Err(OfflineError::Refused(reason));
        }
        Err(OfflineError::NotFinished(PATIENCE))
    }

    fn try_cast_shadow(
        &mut self,
        id: AssetId<HeightField>,
        light: &GridLight,
        method: ShadowMethod,
        strips: u32,
        runs: usize,
    ) -> Result<Option<(ShadowImage, Vec<f64>)>, OfflineError> {
        let Some(heights) = self
            .app
            .world()
            .get_resource::<Assets<HeightField>>()
            .and_then(|fields| fields.get(id))
            .map(|field| field.pyramid().top())
        else {
            return Ok(None);
        };
        let Some(render) = self.app.get_sub_app_mut(RenderApp) else {
            return Err(OfflineError::NoDevice);
        };
        let made =
            render
                .world_mut()
                .try_resource_scope(|world, mut pipelines: Mut<TerrainPipelines>| {
                    let (device, queue, cache, fields, stats) = (
                        world.get_resource::<RenderDevice>()?,
                        world.get_resource::<RenderQueue>()?,
                        world.get_resource::<PipelineCache>()?,
                        world.get_resource::<GpuHeightFields>()?,
                        world.get_resource::<TerrainStats>()?,
                    );
                    let field = fields.get(id).filter(|field| field.is_settled())?;
                    let grid = TileGrid::over(light.reached(field.size)?);
                    let wanted = MadeFor::new(light, method, strips, 0);
                    let sweep = SweepPath::of(&wanted, field.size).map(|path| path.lines);
                    let mut making = Making::new(grid.len(), device, queue);
                    let mut times = Vec::with_capacity(runs);
                    for _ in 0..runs.max(1) {
                        let mut plan = MapPlan::new(grid);
                        let step = plan.step(&wanted, sweep.clone(), u64::MAX, |_| true);
                        debug_assert!(step.work != Work::None);
                        let pipeline = Making::pipeline(
                            &wanted,
                            &step.work,
                            field.float,
                            &mut pipelines,
                            cache,
                        )?;
                        let pipeline = cache.get_compute_pipeline(pipeline)?;
                        let mips = Making::mips_pipeline(field.float, &mut pipelines, cache)?;
                        let mips = cache.get_compute_pipeline(mips)?;
                        making.prepare(
                            &wanted,
                            &plan,
                            &step,
                            field,
                            (heights.1, heights.0),
                            &pipelines,
                            cache,
                            device,
                            queue,
                        );
                        let mut encoder = device.create_command_encoder(&default());
                        making.record(&plan, &step, [pipeline, mips], &mut encoder, None, stats);
                        // What was written to the GPU's buffers above is not part of the time.
                        queue.submit([]);
                        device.poll(PollType::wait_indefinitely()).ok()?;
                        let start = Instant::now();
                        queue.submit([encoder.finish()]);
                        device.poll(PollType::wait_indefinitely()).ok()?;
                        times.push(start.elapsed().as_secs_f64() * 1e3);
                    }
                    Some((field.size, grid, making, times))
                });
        let Some((size, grid, making, times)) = made.flatten() else {
            return Ok(None);
        };
        let bytes = self.read_back(grid.bytes(), |encoder, to| {
            encoder.copy_buffer_to_buffer(&making.visibility, 0, to, 0, grid.bytes());
        })?;
        Ok(Some((ShadowImage::from_tiles(size, grid, &bytes), times)))
    }
}
