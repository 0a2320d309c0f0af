//! A device that is lost: with a renderer that recovers the picture comes back, with one that stops the app goes on.
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
        settings::{RenderCreation, WgpuSettings},
    },
};
use bevy_skyline::{offline::scenes::compare::differing_px, prelude::*};

use crate::life_stage::{Stage, interior_by_gpu};

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
    RenderErrorPolicy::Recover(RenderCreation::Automatic(Box::new(WgpuSettings::default())))
}

fn stop(error: &RenderError, _: &mut World, _: &mut World) -> RenderErrorPolicy {
    note(error);
    RenderErrorPolicy::StopRendering
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
    // At rest; then in the middle of all work, after so many frames of it.
    for frames in [0, 1, 3, 8] {
        if frames > 0 {
            let (terrain, model, ball) = (stage.terrain, stage.model, stage.ball);
            for gone in [terrain, model, ball] {
                stage.world().despawn(gone);
            }
            stage.steps(2);
            stage.spawn_terrain();
            stage.spawn_model();
            stage.spawn_ball();
            if frames == 3 {
                let model = stage.model;
                stage.world().entity_mut(model).insert(interior_by_gpu());
            }
            stage.steps(frames);
        }
        let was = device(&stage);
        lose(&stage);
        stage.steps(4);
        assert_ne!(
            device(&stage),
            was,
            "after {frames} frames there is no other device"
        );
        assert!(!stage.has_ended());
        let after = stage.settled();
        assert_eq!(differing_px(&before, &after), 0, "after {frames} frames");
        assert_eq!(stage.count(), counts);
    }
    assert_eq!(LOST.load(Ordering::Relaxed), 4);

    // What is made by the GPU is made by the new one.
    let model = stage.model;
    stage.world().entity_mut(model).remove::<InteriorCulling>();
    stage.steps(2);
    stage.world().entity_mut(model).insert(interior_by_gpu());
    let after = stage.settled();
    assert_eq!(differing_px(&before, &after), 0);
    println!("{}", stage.states());
    let words = stage.effects().interior().to_string();
    assert!(
        !words.contains("GPU could not") && !words.contains("lost"),
        "{words}"
    );

    // Twice in a row, before anything is drawn.
    lose(&stage);
    stage.steps(3);
    lose(&stage);
    let after = stage.settled();
    assert_eq!(differing_px(&before, &after), 0);
    println!(
        "{} losses, {} other errors on the way",
        LOST.load(Ordering::Relaxed),
        OTHER.load(Ordering::Relaxed)
    );

    // A renderer that stops leaves the app to go on without pictures, and what changes meanwhile is no trouble.
    stage.world().insert_resource(RenderErrorHandler(stop));
    lose(&stage);
    stage.steps(5);
    let (terrain, model, camera) = (stage.terrain, stage.model, stage.camera);
    stage.world().despawn(terrain);
    stage.world().entity_mut(model).remove::<InteriorCulling>();
    stage
        .world()
        .entity_mut(camera)
        .remove::<ZBufferOcclusion>();
    stage.steps(5);
    stage.spawn_terrain();
    stage.steps(5);
    assert!(!stage.has_ended());

    // It can be told to recover later.
    let (model, camera) = (stage.model, stage.camera);
    stage.world().entity_mut(model).insert(interior_by_gpu());
    stage
        .world()
        .entity_mut(camera)
        .insert(crate::life_stage::culling());
    stage.world().insert_resource(RenderErrorHandler(recover));
    let after = stage.settled();
    assert_eq!(differing_px(&before, &after), 0);

    // Bevy's own handler asks the app to end; until it does, it goes on.
    stage.world().insert_resource(RenderErrorHandler::default());
    lose(&stage);
    stage.steps(5);
    assert!(stage.has_ended());
    stage.steps(5);
}
