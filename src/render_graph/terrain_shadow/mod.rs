//! `terrain_shadow` and `shadow_sweep`: for each light of a terrain, how much of it every sample sees (P5b).
//!
//! `extract` brings terrains and lights over; [`prepare_terrain_shadows`] has each terrain's `maps` plan a frame's
//! work on the one map at hand, as much as fits the time slice by the `clock`; [`terrain_shadow`] records it with
//! `gpu`. `terrain_shade` reads what shows.
//!
//! # Inputs / outputs
//! In: the height field and its pyramid. Out: per terrain one storage buffer, a byte a sample and light, 255 = all of
//! the light, in tiles of 64×64 samples of which each lies in one piece with its averages behind; while a map is made, a second buffer of the
//! largest map's size. Point and spot lights have maps of the samples within their range.
//!
//! # Reference
//! P5b; Timonen and Westerholm 2010 for the sweep.

mod clock;
pub mod extract;
pub mod gpu;
pub mod maps;

use bevy::{
    asset::AssetId,
    math::{DMat4, Vec3Swizzles},
    platform::{collections::HashMap, time::Instant},
    prelude::*,
    render::{
        camera::ExtractedCamera,
        diagnostic::RecordDiagnostics,
        render_resource::*,
        renderer::{RenderAdapterInfo, RenderContext, RenderDevice, RenderQueue},
        view::ExtractedView,
    },
};

use super::{
    extract::clip_from_world,
    height_mips::{GpuHeightField, GpuHeightFields},
    pipelines::TerrainPipelines,
    stats::TerrainStats,
    view::TerrainViews,
};
use crate::{
    terrain::HeightField,
    terrain_shadow::{
        ShadowMethod,
        plan::{MadeFor, Publish, Work},
    },
};
use clock::{RayKind, ShadowClock};
use extract::{ExtractedShadow, ExtractedShadows};
use gpu::{Making, SweepPath};
use maps::{Frustum, Planned, TerrainMaps};

/// The shadow maps of all terrains.
#[derive(Resource, Default)]
pub struct TerrainShadows {
    terrains: HashMap<Entity, TerrainMaps>,
    clock: Option<ShadowClock>,
    frusta: Vec<Frustum>,
}

impl TerrainShadows {
    /// A terrain's maps.
    pub fn get(&self, terrain: Entity) -> Option<&TerrainMaps> {
        self.terrains.get(&terrain)
    }

    /// Frees the maps of terrains that cast no shadows any more.
    pub fn retain(&mut self, used: impl Fn(Entity) -> bool) {
        self.terrains.retain(|entity, _| used(*entity));
        if self.terrains.is_empty() {
            self.clock = None;
        }
    }

    /// Notes what has changed of a terrain's heights.
    pub fn note_heights(&mut self, terrain: Entity, id: AssetId<HeightField>, field: &HeightField) {
        self.terrains
            .entry(terrain)
            .or_default()
            .note_heights(id, field);
    }
}

/// Plans the frame's work on every terrain's maps.
#[expect(clippy::too_many_arguments, reason = "a system asks for what it needs")]
pub fn prepare_terrain_shadows(
    mut shadows: ResMut<TerrainShadows>,
    extracted: Res<ExtractedShadows>,
    fields: Res<GpuHeightFields>,
    pipelines: Option<ResMut<TerrainPipelines>>,
    cache: Res<PipelineCache>,
    stats: Res<TerrainStats>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    adapter: Res<RenderAdapterInfo>,
    views: Res<TerrainViews>,
    cameras: Query<&ExtractedView, With<ExtractedCamera>>,
) {
    let Some(mut pipelines) = pipelines.filter(|_| !shadows.terrains.is_empty()) else {
        stats.lock().shadows = default();
        return;
    };
    let start = Instant::now();
    let TerrainShadows {
        terrains,
        clock,
        frusta,
    } = &mut *shadows;
    let mut counts = super::stats::ShadowCounts::default();
    for terrain in &extracted.terrains {
        let Some(maps) = terrains.get_mut(&terrain.terrain) else {
            continue;
        };
        let lights = &extracted.lights[terrain.lights.clone()];
        maps.planned = None;
        maps.follow(terrain, lights, &device, &queue);
        // The pyramid of what was edited this frame is computed before the maps are made.
        let field = fields
            .get(terrain.field)
            .filter(|field| field.ready && field.revision == maps.revision());
        if let Some(field) = field {
            maps.take_edits(terrain);
            if let Some((index, wanted)) = maps.next(terrain, lights) {
                // A box that no plane of a frustum cuts off may be out of view all the same: who draws the terrain
                // is known exactly.
                let draws = |view: &&ExtractedView| {
                    let camera = view.retained_view_entity.main_entity.id();
                    let view = views.views.get(&camera);
                    view.is_some_and(|view| view.drawn.contains(&terrain.terrain))
                };
                frusta.clear();
                frusta.extend(cameras.iter().filter(draws).map(|view| {
                    let clip = clip_from_world(view.clip_from_view, &view.world_from_view);
                    Frustum::new(clip * DMat4::from(terrain.world_from_grid))
                }));
                counts.waiting = true;
                if sees(
                    frusta,
                    terrain,
                    field,
                    URect::from_corners(UVec2::ZERO, terrain.size),
                ) {
                    let clock =
                        clock.get_or_insert_with(|| ShadowClock::new(&device, &queue, &adapter));
                    let kind = ray_kind(&wanted);
                    let budget = clock.rays_in(terrain.slice_ms, kind);
                    counts.unmeasured = !clock.is_measured(kind);
                    counts.ns_per_ray = clock.ns_per_ray(kind) as f32;
                    maps.planned = plan(
                        maps,
                        index,
                        wanted,
                        terrain,
                        field,
                        budget,
                        frusta,
                        &mut pipelines,
                        &cache,
                        &device,
                        &queue,
                    );
                    counts.working = true;
                    counts.rays += maps.planned.as_ref().map_or(0, |planned| planned.step.rays);
                }
            }
        }
        if maps.planned.is_none() {
            maps.rest();
        }
        maps.update_table(lights, &device, &queue);
        counts.maps += maps.lights.len() as u64;
        counts.shown += maps.lights.iter().filter(|map| map.shown.is_some()).count() as u64;
        counts.refused.extend(maps.refused.clone());
    }
    // A hidden terrain keeps its maps.
    counts.bytes = terrains.values().map(TerrainMaps::bytes).sum();
    counts.cpu_ms = start.elapsed().as_secs_f32() * 1e3;
    stats.lock().shadows = counts;
}

/// What kind of ray a map's work is counted in.
fn ray_kind(made_for: &MadeFor) -> RayKind {
    match (made_for.method == ShadowMethod::Sweep, made_for.strips > 0) {
        (false, false) => RayKind::HardRay,
        (false, true) => RayKind::PenumbraRay,
        (true, false) => RayKind::HardSweep,
        (true, true) => RayKind::PenumbraSweep,
    }
}

/// Whether some view sees a rectangle of samples.
fn sees(
    frusta: &[Frustum],
    terrain: &ExtractedShadow,
    field: &GpuHeightField,
    samples: URect,
) -> bool {
    let heights = field.heights_over(samples).unwrap_or(terrain.heights);
    let bounds = (
        samples.min.as_dvec2().extend(heights.0).xzy(),
        samples.max.as_dvec2().extend(heights.1).xzy(),
    );
    frusta.iter().any(|frustum| frustum.sees(bounds))
}

#[expect(
    clippy::too_many_arguments,
    reason = "each is one thing the step is made of"
)]
fn plan(
    maps: &mut TerrainMaps,
    index: usize,
    wanted: MadeFor,
    terrain: &ExtractedShadow,
    field: &GpuHeightField,
    budget: u64,
    frusta: &[Frustum],
    pipelines: &mut TerrainPipelines,
    cache: &PipelineCache,
    device: &RenderDevice,
    queue: &RenderQueue,
) -> Option<Planned> {
    let sweep = SweepPath::of(&wanted, terrain.size).map(|path| path.lines);
    // Nothing is begun before it can be recorded.
    let works: &[Work] = if sweep.is_some() {
        &[Work::Lines {
            lines: 0..0,
            first: false,
        }]
    } else {
        &[Work::Coarse, Work::Exact]
    };
    for work in works {
        Making::pipeline(&wanted, work, field.float, pipelines, cache)?;
    }
    let mips = Making::mips_pipeline(field.float, pipelines, cache)?;
    let grid = maps.lights[index].plan.grid();
    maps.make_room(grid.len(), device, queue);
    let map = &mut maps.lights[index];
    let step = map.plan.step(&wanted, sweep, budget, |tile| {
        sees(frusta, terrain, field, grid.samples(tile, terrain.size))
    });
    let made_for = *map.plan.working_on()?;
    let pipeline = Making::pipeline(&made_for, &step.work, field.float, pipelines, cache)?;
    maps.making.as_mut()?.prepare(
        &made_for,
        &map.plan,
        &step,
        field,
        terrain.heights,
        pipelines,
        cache,
        device,
        queue,
    );
    Some(Planned {
        map: index,
        step,
        made_for,
        pipelines: [pipeline, mips],
        after_mips: !field.is_settled(),
    })
}

/// The pass: does what was planned. Does nothing, and allocates nothing, where nothing was.
pub fn terrain_shadow(
    mut shadows: ResMut<TerrainShadows>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    stats: Res<TerrainStats>,
    mut ctx: RenderContext,
) {
    if shadows.terrains.values().all(|maps| maps.planned.is_none()) {
        return;
    }
    let diagnostics = ctx.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let span = diagnostics.time_span(ctx.command_encoder(), "terrain_shadow");
    let TerrainShadows {
        terrains, clock, ..
    } = &mut *shadows;
    for maps in terrains.values_mut() {
        let (Some(planned), Some(making), Some(shown), Some(clock)) = (
            maps.planned.take(),
            &maps.making,
            &maps.shown,
            clock.as_mut(),
        ) else {
            continue;
        };
        let [Some(pipeline), Some(mips)] =
            planned.pipelines.map(|id| cache.get_compute_pipeline(id))
        else {
            continue;
        };
        let map = &maps.lights[planned.map];
        let kind = (!planned.after_mips).then(|| ray_kind(&planned.made_for));
        clock.time(
            kind,
            planned.step.rays,
            &device,
            &queue,
            ctx.command_encoder(),
            |encoder, timestamps| {
                making.record(
                    &map.plan,
                    &planned.step,
                    [pipeline, mips],
                    encoder,
                    timestamps,
                    &stats,
                );
                let publish = planned.step.publish;
                if publish != Publish::None {
                    making.publish(&map.plan, publish, shown, map.region.offset, encoder);
                }
            },
        );
    }
    span.end(ctx.command_encoder());
}
