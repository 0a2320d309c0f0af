//! `occludee_verdicts`: which of a list of occludees a reduced depth hides, found on the GPU.
//!
//! # Inputs / outputs
//! One bind group, [`layout`]: [`GpuOcclusionView`](crate::occlusion::depth::GpuOcclusionView); the texels of its
//! levels, `f32`; [`GpuSweptTriangle`]s; [`GpuOccludee`]s; and one word an occludee, its
//! [`Verdict`](crate::occlusion::verdict::Verdict) as a number. All are storage buffers. As many occludees are tested
//! as the binding of their list holds, in ⌈n/64⌉ workgroups.
//!
//! # Limits
//! A storage buffer may not be empty: bind at least one swept triangle, used or not. A dispatch has at most 65,535
//! workgroups a dimension, that is 4,194,240 occludees.
//!
//! # Reference
//! P2, sections 3.2 and 4.3.

use core::ops::Range;

use bevy::{
    asset::AssetServer,
    math::Affine3A,
    prelude::*,
    render::render_resource::{
        binding_types::{storage_buffer_read_only_sized, storage_buffer_sized},
        *,
    },
};
use bytemuck::{Pod, Zeroable};

use super::shaders;
use crate::culling::volume::{LocalBox, SweptTriangle};

/// Candidates of a workgroup, as in `occludee_verdicts.wgsl`.
pub const OCCLUDEES_PER_GROUP: u32 = 64;

/// Mirrors `Candidate` in `occludee_verdicts.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GpuOccludee {
    /// Rows of the affine matrix.
    pub world_from_local: [[f32; 4]; 3],
    /// The box, in local space.
    pub centre: [f32; 3],
    /// Index of its proxy's first triangle.
    pub first_triangle: u32,
    /// A half axis.
    pub axis_0: [f32; 3],
    /// Triangles of its proxy; 0 if it has none.
    pub triangle_count: u32,
    /// A half axis.
    pub axis_1: [f32; 3],
    /// Whether there is a turned box.
    pub has_turned: u32,
    /// A half axis.
    pub axis_2: [f32; 3],
    /// 0.
    pub pad: u32,
    /// The turned box, in local space: its centre and half axes. The fourth numbers are 0.
    pub turned: [[f32; 4]; 4],
}

impl GpuOccludee {
    /// Of a box, of another along other axes, and of the proxy at `triangles` of the list of swept triangles; an empty
    /// range is no proxy.
    pub fn new(
        world_from_local: &Affine3A,
        volume: &LocalBox,
        turned: Option<&LocalBox>,
        triangles: Range<u32>,
    ) -> Self {
        let linear = world_from_local.matrix3.transpose();
        let rows = [linear.x_axis, linear.y_axis, linear.z_axis];
        let translation = world_from_local.translation.to_array();
        let mut world_from_local = [[0.0; 4]; 3];
        for ((out, row), moved) in world_from_local.iter_mut().zip(rows).zip(translation) {
            *out = [row.x, row.y, row.z, moved];
        }
        Self {
            world_from_local,
            centre: volume.centre.to_array(),
            first_triangle: triangles.start,
            axis_0: volume.axes[0].to_array(),
            triangle_count: triangles.end.saturating_sub(triangles.start),
            axis_1: volume.axes[1].to_array(),
            has_turned: u32::from(turned.is_some()),
            axis_2: volume.axes[2].to_array(),
            pad: 0,
            turned: turned.map_or_else(Default::default, |turned| {
                let [a, b, c] = turned.axes;
                [turned.centre, a, b, c].map(|v| v.extend(0.0).to_array())
            }),
        }
    }
}

/// A [`SweptTriangle`] in `swept_triangles` of `occludee.wgsl`: three corners, the first's fourth number the radius.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GpuSweptTriangle {
    /// Corners, and the radius.
    pub corners: [[f32; 4]; 3],
}

impl From<&SweptTriangle> for GpuSweptTriangle {
    fn from(triangle: &SweptTriangle) -> Self {
        let [a, b, c] = triangle.corners;
        Self {
            corners: [
                a.extend(triangle.radius).to_array(),
                b.extend(0.0).to_array(),
                c.extend(0.0).to_array(),
            ],
        }
    }
}

/// The pass's bind group: view, texels, swept triangles, occludees, verdicts.
pub fn layout() -> BindGroupLayoutDescriptor {
    let read = || storage_buffer_read_only_sized(false, None);
    BindGroupLayoutDescriptor::new(
        "skyline_occludee_verdicts",
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                read(),
                read(),
                read(),
                read(),
                storage_buffer_sized(false, None),
            ),
        ),
    )
}

/// The bind group of the pass over the occludees that a set of bits selects: view, texels, swept triangles,
/// occludees, bits of those found hidden, bits of those to be tested.
pub fn selected_layout() -> BindGroupLayoutDescriptor {
    let read = || storage_buffer_read_only_sized(false, None);
    BindGroupLayoutDescriptor::new(
        "skyline_selected_occludee_verdicts",
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE,
            (
                read(),
                read(),
                read(),
                read(),
                storage_buffer_sized(false, None),
                read(),
            ),
        ),
    )
}

/// The pipeline of the pass over the occludees that a set of bits selects.
pub fn selected_pipeline(assets: &AssetServer) -> ComputePipelineDescriptor {
    ComputePipelineDescriptor {
        layout: vec![selected_layout()],
        shader_defs: vec!["SELECTED".into()],
        ..pipeline(assets)
    }
}

/// The pass's pipeline, to be queued in the app's cache.
pub fn pipeline(assets: &AssetServer) -> ComputePipelineDescriptor {
    ComputePipelineDescriptor {
        label: Some("occludee_verdicts".into()),
        layout: vec![layout()],
        shader: shaders::culling::occludee_verdicts(assets),
        entry_point: Some("occludee_verdicts".into()),
        ..default()
    }
}
