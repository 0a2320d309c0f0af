//! What a ray costs on this machine, learned from the steps already made, so that a step fits its time slice.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

use bevy::{
    platform::time::Instant,
    render::{
        render_resource::*,
        renderer::{RenderAdapterInfo, RenderDevice, RenderQueue},
    },
};
use wgpu::{ComputePassTimestampWrites, QuerySet, QuerySetDescriptor, QueryType};

/// What a ray is taken to cost before any was timed. units: ns
const FIRST_GUESS_NS: f64 = 100.0;
/// How much of a new measurement goes into the estimate.
const LEARNING_RATE: f64 = 0.5;

/// Times steps, and turns a time slice into a number of rays.
///
/// A GPU writes timestamps around the dispatch, which come back some frames later. A software driver's say
/// nothing about compute work, but there the work and the app share the same processor, and nothing is lost by
/// waiting for it. Where there is neither, [`FIRST_GUESS_NS`] stays, and [`is_measured`](Self::is_measured) is
/// false.
pub struct ShadowClock {
    way: Way,
    /// By [`RayKind`].
    costs: [Cost; 4],
}

/// Rays that cost the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RayKind {
    HardRay,
    PenumbraRay,
    HardSweep,
    PenumbraSweep,
}

#[derive(Clone, Copy)]
struct Cost {
    ns_per_ray: f64,
    measured: bool,
}

enum Way {
    Wait,
    Timestamps(Box<Timestamps>),
    Guess,
}

struct Timestamps {
    queries: QuerySet,
    resolved: Buffer,
    staging: Buffer,
    period_ns: f32,
    busy: Arc<AtomicBool>,
    /// Time and rays of the last step that came back; 0 rays for none. units: ns
    time: Arc<AtomicU64>,
    rays: Arc<AtomicU64>,
    /// Of those rays.
    kind: RayKind,
}

impl ShadowClock {
    /// A clock that has measured nothing yet.
    pub fn new(device: &RenderDevice, queue: &RenderQueue, adapter: &RenderAdapterInfo) -> Self {
        let way = if adapter.device_type == wgpu::DeviceType::Cpu {
            Way::Wait
        } else if device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            Way::Timestamps(Box::new(Timestamps::new(device, queue)))
        } else {
            Way::Guess
        };
        Self {
            way,
            costs: [Cost {
                ns_per_ray: FIRST_GUESS_NS,
                measured: false,
            }; 4],
        }
    }

    /// Rays that fit into a time slice.
    pub fn rays_in(&mut self, slice_ms: f32, kind: RayKind) -> u64 {
        if let Way::Timestamps(timestamps) = &self.way {
            let rays = timestamps.rays.swap(0, Ordering::AcqRel);
            if rays > 0 {
                let time = timestamps.time.load(Ordering::Acquire);
                let kind = timestamps.kind;
                self.learn(kind, rays, time as f64);
            }
        }
        // A slice that is not a number, or none, still gets on a tile at a time.
        (f64::from(slice_ms).max(0.0) * 1e6 / self.ns_per_ray(kind)) as u64
    }

    /// What a ray costs by the last measurements. units: ns
    pub fn ns_per_ray(&self, kind: RayKind) -> f64 {
        self.costs[kind as usize].ns_per_ray
    }

    /// Whether anything was ever timed.
    pub fn is_measured(&self, kind: RayKind) -> bool {
        self.costs[kind as usize].measured
    }

    fn learn(&mut self, kind: RayKind, rays: u64, time_ns: f64) {
        let cost = &mut self.costs[kind as usize];
        let new = (time_ns / rays as f64).clamp(1e-3, 1e6);
        let rate = if cost.measured { LEARNING_RATE } else { 1.0 };
        cost.ns_per_ray += rate * (new - cost.ns_per_ray);
        cost.measured = true;
    }

    /// Has `record` write a step's commands, and times them. They run before anything else of the frame where they
    /// are waited for, so nothing recorded in the same frame may have to come before them: without a `kind` they are
    /// recorded in their turn and not timed.
    pub fn time(
        &mut self,
        kind: Option<RayKind>,
        rays: u64,
        device: &RenderDevice,
        queue: &RenderQueue,
        encoder: &mut CommandEncoder,
        record: impl FnOnce(&mut CommandEncoder, Option<ComputePassTimestampWrites>),
    ) {
        let Some(kind) = kind else {
            record(encoder, None);
            return;
        };
        match &mut self.way {
            Way::Guess => record(encoder, None),
            Way::Timestamps(timestamps) => {
                if timestamps.busy.swap(true, Ordering::AcqRel) {
                    record(encoder, None);
                    return;
                }
                record(
                    encoder,
                    Some(ComputePassTimestampWrites {
                        query_set: &timestamps.queries,
                        beginning_of_pass_write_index: Some(0),
                        end_of_pass_write_index: Some(1),
                    }),
                );
                timestamps.kind = kind;
                timestamps.request(rays, encoder);
            }
            Way::Wait => {
                let mut own = device.create_command_encoder(&CommandEncoderDescriptor::default());
                record(&mut own, None);
                // A lost device is Bevy's to report.
                let _ = device.poll(PollType::wait_indefinitely());
                let start = Instant::now();
                queue.submit([own.finish()]);
                let _ = device.poll(PollType::wait_indefinitely());
                self.learn(kind, rays.max(1), start.elapsed().as_secs_f64() * 1e9);
            }
        }
    }
}

impl Timestamps {
    fn new(device: &RenderDevice, queue: &RenderQueue) -> Self {
        let buffer = |label, usage| {
            device.create_buffer(&BufferDescriptor {
                label: Some(label),
                size: 16,
                usage: usage | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        Self {
            queries: device.wgpu_device().create_query_set(&QuerySetDescriptor {
                label: Some("skyline_shadow_time"),
                ty: QueryType::Timestamp,
                count: 2,
            }),
            resolved: buffer(
                "skyline_shadow_time",
                BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC,
            ),
            staging: buffer("skyline_shadow_time_staging", BufferUsages::MAP_READ),
            period_ns: queue.get_timestamp_period(),
            busy: Arc::default(),
            time: Arc::default(),
            rays: Arc::default(),
            kind: RayKind::HardRay,
        }
    }

    fn request(&self, rays: u64, encoder: &mut CommandEncoder) {
        encoder.resolve_query_set(&self.queries, 0..2, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.staging, 0, 16);
        let (staging, busy, time, seen) = (
            self.staging.clone(),
            self.busy.clone(),
            self.time.clone(),
            self.rays.clone(),
        );
        let period_ns = self.period_ns;
        encoder.map_buffer_on_submit(&self.staging, MapMode::Read, .., move |result| {
            if result.is_ok() {
                let words: Vec<u64> =
                    bytemuck::pod_collect_to_vec(&staging.slice(..).get_mapped_range());
                if let [start, end] = words[..] {
                    let ns = end.saturating_sub(start) as f64 * f64::from(period_ns);
                    time.store(ns as u64, Ordering::Release);
                    seen.store(rays, Ordering::Release);
                }
                staging.unmap();
            }
            busy.store(false, Ordering::Release);
        });
    }
}
