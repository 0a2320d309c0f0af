//! `terrain_cascade`: terrains among the casters of Bevy's directional shadow cascades, so that ordinary meshes
//! stand in a hill's shadow.
//!
//! The rays of a light are cast as those of a camera are, with an orthographic view of its own (`light_square`)
//! that reaches from before the whole terrain to behind it. What they hit is made a caster that cannot shadow the
//! terrain itself (`terrain_cascade_erode.wgsl` has the derivation) and kept. As long as a cascade stays within
//! the square that was cast, and neither light nor terrains change, all that runs is one draw a cascade, which
//! moves the kept depth to where the cascade is now.
//!
//! # Inputs / outputs
//! Kept: one `R32Float` of n×n a cascade, n a quarter of the shadow map's side and a border. Shared by all while
//! they cast: `R32Float` and `R32Uint` of the same size. Written: Bevy's own `Depth32Float` layers.
//!
//! # Limits
//! Shadows of hills on meshes end up to three coarse texels (twelve of the shadow map's) inside the true edge,
//! and begin as far behind the ground. A filter wider than `MAX_REACH` allows (percentage-closer soft shadows
//! of very large lights) can darken the ground near by.

mod bind;
mod gpu;
mod light_square;
mod pass;
mod prepare;

use bevy::{
    asset::AssetId,
    math::DAffine3,
    platform::collections::HashMap,
    prelude::*,
    render::{render_resource::*, view::RetainedViewEntity},
};

use super::view::{TerrainSlot, Unused};
use crate::terrain::HeightField;
use light_square::LightSquare;

pub use gpu::{GpuCascadeErosion, GpuCascadeWrite};
pub use pass::terrain_cascade;
pub use prepare::prepare_terrain_cascades;

/// Side of a coarse texel, for which one ray is cast. A full cast of 4 × 2048² takes sixteen times as long, and
/// Bevy's filter blurs over six texels anyway; with eight, casters would shrink by twice as much for a cast that
/// is cheap already. units: texels of the shadow map
const COARSE_TEXELS: u32 = 4;
/// What is cast beyond each side of a cascade, so that it can move on without a new cast. units: its side
const BORDER: f32 = 0.125;
/// The farthest that casters shrink for. units: coarse texels
const MAX_REACH: u32 = 6;
/// Depth that changes faster than this with the distance across the light (76° to it) is taken for an edge: no dip
/// is believed to be deeper, and what is farther apart isn't blended.
const EDGE_SLOPE: f64 = 4.0;

/// What every cascade of every camera and light holds for terrain.
#[derive(Resource, Default)]
pub struct TerrainCascades {
    cascades: HashMap<RetainedViewEntity, TerrainCascade>,
    /// Where rays write what they hit, until it is made a caster.
    targets: Option<CastTargets>,
    /// Stand-ins for what `ray_cast` doesn't use here.
    unused: Option<Unused>,
    /// Its steps, in order.
    erode: Option<[CachedComputePipelineId; 3]>,
    draw: Option<CachedRenderPipelineId>,
    generation: u64,
}

/// What rays of lights hit. One pair serves all cascades: each makes use of it before the next one casts.
struct CastTargets {
    side: u32,
    depth: TextureView,
    surface: TextureView,
}

/// One cascade of one light for one camera.
#[derive(Default)]
struct TerrainCascade {
    casters: Vec<CascadeCaster>,
    /// What was cast last, or is about to be.
    square: Option<LightSquare>,
    /// What was cast last, as a caster.
    depth: Option<TextureView>,
    erosion: UniformBuffer<GpuCascadeErosion>,
    write: UniformBuffer<GpuCascadeWrite>,
    /// From what was hit to `depth`, and back.
    erode_groups: Option<[BindGroup; 2]>,
    draw_group: Option<BindGroup>,
    /// `depth` is out of date.
    due: bool,
    /// It is drawn in this frame.
    drawn: bool,
    seen: bool,
}

/// One terrain in one cascade.
#[derive(Default)]
struct CascadeCaster {
    key: Option<CasterKey>,
    slot: TerrainSlot,
    /// The light sees it within the square.
    in_view: bool,
    groups: Option<CasterGroups>,
}

/// What a cast depends on, of the terrain.
#[derive(Clone, Copy, PartialEq)]
struct CasterKey {
    entity: Entity,
    field: AssetId<HeightField>,
    generation: u64,
    revision: u64,
    world_from_local: DAffine3,
}

/// Bind groups of a caster, and the field and tiles they were made for.
struct CasterGroups {
    generation: u64,
    tiles: BufferId,
    pipeline: CachedComputePipelineId,
    field: BindGroup,
    beam_pipelines: [CachedComputePipelineId; 2],
    /// Coarse tiles, then fine ones, and how many workgroups a side they take.
    beam: [(BindGroup, UVec2); 2],
    ray_cast: BindGroup,
}

impl TerrainCascades {
    /// Bytes of all textures and buffers.
    fn bytes(&self) -> u64 {
        let texels = |side: u32| u64::from(side) * u64::from(side);
        let targets = self.targets.as_ref().map_or(0, |t| 8 * texels(t.side));
        let cascades: u64 = self
            .cascades
            .values()
            .map(|cascade| {
                let depth = match (&cascade.depth, &cascade.square) {
                    (Some(_), Some(square)) => 4 * texels(square.side),
                    _ => 0,
                };
                let casters = cascade.casters.iter().map(|caster| caster.slot.bytes());
                let uniforms = [cascade.erosion.buffer(), cascade.write.buffer()];
                let uniforms = uniforms.into_iter().flatten().map(|buffer| buffer.size());
                depth + casters.sum::<u64>() + uniforms.sum::<u64>()
            })
            .sum();
        targets + cascades + self.unused.as_ref().map_or(0, Unused::bytes)
    }
}
