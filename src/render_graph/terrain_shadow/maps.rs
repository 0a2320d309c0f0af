//! The shadow maps of one terrain: one for each light, all in one buffer, and a second one where the map at hand is
//! made.

use bevy::{
    asset::AssetId,
    math::{DMat4, DVec3, DVec4, URect},
    prelude::*,
    render::{
        render_resource::*,
        renderer::{RenderDevice, RenderQueue},
    },
};

use super::{
    extract::{ExtractedShadow, ExtractedShadowLight},
    gpu::Making,
};
use crate::{
    terrain::{HeightField, HeightFieldChanged},
    terrain_shadow::{
        light::GridLight,
        plan::{MadeFor, MapPlan, Publish, Step},
        tiles::{EditReach, TileGrid},
    },
};

/// Lights a terrain can have maps for, as in `visibility.wgsl`.
pub const MAX_LIGHTS: usize = 16;

/// Frames after which the buffer that maps are made in is given back.
const REST_FRAMES: u32 = 60;

/// Mirrors `LightMap` in `visibility.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug, Default, PartialEq)]
pub struct GpuLightMap {
    place: Vec4,
    first_tile: UVec2,
    tiles: UVec2,
    first_word: u32,
    range: f32,
}

/// Mirrors `LightMaps` in `visibility.wgsl`.
#[derive(ShaderType, Clone, Copy, Debug, Default, PartialEq)]
pub struct GpuLightMaps {
    count: u32,
    maps: [GpuLightMap; MAX_LIGHTS],
}

/// A part of the buffer that shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    pub grid: TileGrid,
    pub offset: u64,
}

/// One light's map.
pub struct LightMap {
    pub entity: Entity,
    pub plan: MapPlan,
    /// Where it goes when it is complete.
    pub region: Region,
    /// Where the one that shows is; `None` before the first.
    pub shown: Option<Region>,
    /// Whether the buffer has room for it on this GPU.
    fits: bool,
    seen: bool,
}

/// What is recorded in a frame.
pub struct Planned {
    pub map: usize,
    pub step: Step,
    pub made_for: MadeFor,
    /// The step's, and that of the averages.
    pub pipelines: [CachedComputePipelineId; 2],
    /// The heights' pyramid is computed in the same frame, before.
    pub after_mips: bool,
}

/// All shadow maps of one terrain.
#[derive(Default)]
pub struct TerrainMaps {
    field: Option<AssetId<HeightField>>,
    size: UVec2,
    revision: u64,
    heights_epoch: u64,
    /// Edits since the maps were last looked at, and the range of heights before and after them.
    edits: Option<(URect, (f64, f64))>,
    heights: (f64, f64),
    pub lights: Vec<LightMap>,
    pub shown: Option<Buffer>,
    pub making: Option<Making>,
    rested: u32,
    pub planned: Option<Planned>,
    pub table: UniformBuffer<GpuLightMaps>,
    table_now: GpuLightMaps,
    turn: usize,
    /// Lights that have no map here, and why.
    pub refused: Option<String>,
}

/// The half spaces of the views that are looked from, in a terrain's grid space.
pub struct Frustum([DVec4; 5]);

impl Frustum {
    /// Without the far plane.
    pub fn new(clip_from_grid: DMat4) -> Self {
        let row = |i: usize| clip_from_grid.row(i);
        let (x, y, z, w) = (row(0), row(1), row(2), row(3));
        Self([w + x, w - x, w + y, w - y, w - z])
    }

    /// Whether some of a box may be in view.
    pub fn sees(&self, (low, high): (DVec3, DVec3)) -> bool {
        self.0.iter().all(|plane| {
            let corner = DVec3::select(plane.truncate().cmpge(DVec3::ZERO), high, low);
            plane.truncate().dot(corner) + plane.w >= 0.0
        })
    }
}

impl TerrainMaps {
    /// Whether a map shows, so that shading has something to read.
    pub fn show(&self) -> bool {
        self.shown.is_some() && self.lights.iter().any(|light| light.shown.is_some())
    }

    /// What of the field the maps follow.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Samples of the field the maps are of.
    pub fn size(&self) -> UVec2 {
        self.size
    }

    /// Bytes held.
    pub fn bytes(&self) -> u64 {
        let buffers = self.shown.iter().chain(self.table.buffer());
        let held: u64 = buffers.map(|buffer| buffer.size()).sum();
        held + self.making.as_ref().map_or(0, Making::bytes)
    }

    /// Notes what has changed of the heights.
    pub fn note_heights(&mut self, id: AssetId<HeightField>, field: &HeightField) {
        let (highest, lowest) = field.pyramid().top();
        if self.field != Some(id) {
            *self = Self {
                field: Some(id),
                heights_epoch: self.heights_epoch + 1,
                size: field.size(),
                revision: field.revision(),
                heights: (lowest, highest),
                ..default()
            };
            return;
        }
        match field.changed_since(self.revision) {
            HeightFieldChanged::Nothing => return,
            HeightFieldChanged::Everything => {
                self.heights_epoch += 1;
                self.edits = None;
                if self.size != field.size() {
                    self.lights.clear();
                }
            }
            HeightFieldChanged::Rect(rect) => {
                let heights = (lowest.min(self.heights.0), highest.max(self.heights.1));
                self.edits = Some(match self.edits {
                    Some((before, range)) => (
                        before.union(rect),
                        (range.0.min(heights.0), range.1.max(heights.1)),
                    ),
                    None => (rect, heights),
                });
            }
        }
        self.heights = (lowest, highest);
        self.size = field.size();
        self.revision = field.revision();
    }

    /// What a light's map is to be made for.
    pub fn wanted(&self, terrain: &ExtractedShadow, light: &GridLight) -> MadeFor {
        MadeFor::new(light, terrain.method, terrain.strips, self.heights_epoch)
    }

    /// Makes the list of maps follow the list of lights, and finds each its place.
    pub fn follow(
        &mut self,
        terrain: &ExtractedShadow,
        lights: &[ExtractedShadowLight],
        device: &RenderDevice,
        queue: &RenderQueue,
    ) {
        for map in &mut self.lights {
            map.seen = false;
        }
        self.refused = None;
        let mut moved = false;
        for light in lights {
            if !light.light.is_usable() {
                self.refused = Some(
                    "a light shines through: its direction, position or size is no usable number, or the \
                     terrain's transform flattens it"
                        .into(),
                );
                continue;
            }
            let Some(samples) = light.light.reached(terrain.size) else {
                continue;
            };
            let grid = TileGrid::over(samples);
            let known = self
                .lights
                .iter()
                .position(|map| map.entity == light.entity);
            match known {
                Some(index) => {
                    let map = &mut self.lights[index];
                    map.seen = true;
                    // A lamp on the move: what is half made for where it was is completed and shown first.
                    if map.region.grid != grid && !map.plan.is_half_made() {
                        map.plan = MapPlan::new(grid);
                        map.region.grid = grid;
                        moved = true;
                    }
                }
                None if self.lights.len() < MAX_LIGHTS => {
                    self.lights.push(LightMap {
                        entity: light.entity,
                        plan: MapPlan::new(grid),
                        region: Region { grid, offset: 0 },
                        shown: None,
                        fits: true,
                        seen: true,
                    });
                    moved = true;
                }
                None => {
                    self.refused = Some(format!(
                        "a terrain casts the shadows of at most {MAX_LIGHTS} lights: the others shine through"
                    ));
                }
            }
        }
        let before = self.lights.len();
        self.lights.retain(|map| map.seen);
        if moved || before != self.lights.len() {
            self.lay_out(device, queue);
        }
        if self.lights.iter().any(|map| !map.fits) {
            self.refused = Some(
                "the shadow maps of a terrain take more than this GPU's max_storage_buffer_binding_size: some \
                 lights shine through"
                    .into(),
            );
        }
    }

    /// Finds each map its place in a new buffer, and takes what shows along.
    fn lay_out(&mut self, device: &RenderDevice, queue: &RenderQueue) {
        self.planned = None;
        let most = device
            .limits()
            .max_storage_buffer_binding_size
            .min(device.limits().max_buffer_size);
        let mut end = 0;
        let mut copies = Vec::new();
        for map in &mut self.lights {
            let stays = map.shown.filter(|shown| shown.grid != map.region.grid);
            let needs = map.region.grid.bytes() + stays.map_or(0, |shown| shown.grid.bytes());
            map.fits = end + needs <= most;
            if !map.fits {
                map.shown = None;
                continue;
            }
            map.region.offset = end;
            end += map.region.grid.bytes();
            if let Some(shown) = &mut map.shown {
                let to = if stays.is_some() {
                    let to = end;
                    end += shown.grid.bytes();
                    to
                } else {
                    map.region.offset
                };
                copies.push((shown.offset, to, shown.grid.bytes()));
                shown.offset = to;
            }
        }
        if end == 0 {
            self.shown = None;
            self.making = None;
            return;
        }
        let buffer = device.create_buffer(&BufferDescriptor {
            label: Some("skyline_visibility"),
            size: end,
            usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        if let Some(old) = &self.shown
            && !copies.is_empty()
        {
            let mut encoder = device.create_command_encoder(&default());
            for (from, to, bytes) in copies {
                encoder.copy_buffer_to_buffer(old, from, &buffer, to, bytes);
            }
            queue.submit([encoder.finish()]);
        }
        self.shown = Some(buffer);
    }

    /// Marks the tiles that edits have made stale.
    pub fn take_edits(&mut self, terrain: &ExtractedShadow) {
        let Some((rect, heights)) = self.edits.take() else {
            return;
        };
        for map in &mut self.lights {
            let Some(made_for) = map.plan.working_on() else {
                continue;
            };
            let grid = map.plan.grid();
            let reach = EditReach::new(&made_for.light, rect, heights);
            for tile in 0..grid.len() {
                if reach.touches(grid.samples(tile, terrain.size)) {
                    map.plan.touch(tile);
                }
            }
        }
    }

    /// The map whose turn it is among those with something to do: first one that is half made, as there is room for
    /// one.
    pub fn next(
        &mut self,
        terrain: &ExtractedShadow,
        lights: &[ExtractedShadowLight],
    ) -> Option<(usize, MadeFor)> {
        let wanted = |map: &LightMap| {
            let light = lights.iter().find(|light| light.entity == map.entity)?;
            Some(self.wanted(terrain, &light.light))
        };
        let busy = |map: &LightMap| {
            map.fits && wanted(map).is_some_and(|wanted| !map.plan.is_done(&wanted))
        };
        let count = self.lights.len();
        let index = (0..count)
            .find(|&index| self.lights[index].plan.is_half_made() && busy(&self.lights[index]))
            .or_else(|| {
                (0..count)
                    .map(|n| (self.turn + n) % count)
                    .find(|&index| busy(&self.lights[index]))
            })?;
        let wanted = wanted(&self.lights[index])?;
        self.turn = index + 1;
        Some((index, wanted))
    }

    /// Makes sure of a place to make a map of so many tiles in.
    pub fn make_room(&mut self, tiles: u32, device: &RenderDevice, queue: &RenderQueue) {
        self.rested = 0;
        if self
            .making
            .as_ref()
            .is_none_or(|making| making.capacity() < tiles)
        {
            self.making = Some(Making::new(tiles, device, queue));
        }
    }

    /// Gives that place back when it has not been needed for a while. A map that is half made there, because no
    /// camera sees the terrain any more, keeps it.
    pub fn rest(&mut self) {
        if self.lights.iter().any(|map| map.plan.is_half_made()) {
            return;
        }
        self.rested = self.rested.saturating_add(1);
        if self.rested > REST_FRAMES {
            self.making = None;
        }
    }

    /// Has shading read what shows after this frame's step.
    pub fn update_table(
        &mut self,
        lights: &[ExtractedShadowLight],
        device: &RenderDevice,
        queue: &RenderQueue,
    ) {
        if let Some(planned) = &self.planned
            && planned.step.publish == Publish::All
        {
            let map = &mut self.lights[planned.map];
            map.shown = Some(map.region);
        }
        let mut table = GpuLightMaps::default();
        for map in &self.lights {
            let light = lights.iter().find(|light| light.entity == map.entity);
            let (Some(shown), Some(light)) = (map.shown, light) else {
                continue;
            };
            table.maps[table.count as usize] = GpuLightMap {
                place: light.place,
                first_tile: shown.grid.first,
                tiles: shown.grid.count,
                first_word: (shown.offset / 4) as u32,
                range: light.range,
            };
            table.count += 1;
        }
        if table != self.table_now || self.table.binding().is_none() {
            self.table_now = table;
            self.table.set_label(Some("skyline_light_maps"));
            self.table.set(table);
            self.table.write_buffer(device, queue);
        }
    }
}
