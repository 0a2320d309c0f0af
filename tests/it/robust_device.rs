//! A device that is lost: with a renderer that recovers the picture comes back, where all work
//! was done before.
//!
//! Bevy 0.19 asks its `RenderErrorHandler` what to do; `wgpu::Device::destroy` loses a device at will, on a software
//! driver as well. Two things of Bevy's own stand in the way, and are avoided here: where it clusters lights on the GPU,
//! `prepare_clusters_for_gpu_clustering` panics as it reads a buffer of the device that was lost; and a frame that is
//! drawn after the loss and before it is told of it. So lights are clustered on the CPU, and the device is polled.

use core::sync::atomic::{AtomicU32, Ordering};

use bevy::{
    prelude::*,
    render::{
        error_handler::{ErrorType, RenderError, RenderErrorHandler, RenderErrorPolicy},
        renderer::RenderDevice,
        settings::RenderCreation,
    },
};
use bevy_skyline::offline::scenes::compare::differing_px;

use crate::life_stage::Stage;

/// Errors that the renderer asked about, losses and others.
static LOST: AtomicU32 = AtomicU32::new(0);
static OTHER: AtomicU32 = AtomicU32::new(0);

fn note(error: &RenderError) {
    let count = if matches!(error.ty, ErrorType::DeviceLost) {
        &LOST
    } else {
        &OTHER
    };
    count.fetch_add(1, Ordering::Relaxed);
}

fn recover(error: &RenderError, _: &mut World, _: &mut World) -> RenderErrorPolicy {
    note(error);
    RenderErrorPolicy::Recover(RenderCreation::Automatic(Box::default()))
}

fn device(stage: &Stage) -> wgpu::Device {
    let device = stage.offline.app.world().resource::<RenderDevice>();
    device.wgpu_device().clone()
}

/// Destroys the device, and has it told.
fn lose(stage: &Stage) {
    let device = device(stage);
    device.destroy();
    let _ = device.poll(wgpu::PollType::Poll);
}

/// One test, as its counts are the process's.
#[test]
fn a_lost_device_is_outlived() {
    let Some(mut stage) = Stage::with(|app| {
        app.insert_resource(RenderErrorHandler(recover));
    }) else {
        return;
    };
    stage.cluster_on_the_cpu();
    let before = stage.settled();
    let counts = stage.count();
    lose(&stage);
    stage.steps(4);
    assert!(!stage.has_ended());
    let after = stage.settled();
    assert_eq!(differing_px(&before, &after), 0);
    assert_eq!(stage.count(), counts);
    assert_eq!(
        (LOST.load(Ordering::Relaxed), OTHER.load(Ordering::Relaxed)),
        (1, 0)
    );
}
