//! A device that is lost: with a renderer that recovers the picture comes back, be it at rest or in the middle of work.
//!
//! Bevy 0.19 asks its `RenderErrorHandler` what to do; `wgpu::Device::destroy` loses a device at will, on a software
//! driver as well. Two things of Bevy's own stand in the way, and are avoided here: where it clusters lights on the GPU,
//! `prepare_clusters_for_gpu_clustering` panics as it reads a buffer of the device that was lost; and a frame that is
//! drawn after the loss and before it is told of it. So lights are clustered on the CPU, and the device is polled.

use bevy::{
    prelude::*,
    render::{
        error_handler::{ErrorType, RenderError, RenderErrorHandler, RenderErrorPolicy},
        renderer::RenderDevice,
        settings::RenderCreation,
    },
};
use bevy_skyline::{interior::FieldBy, offline::scenes::compare::differing_px, prelude::*};

use crate::life_stage::{Counts, Stage};

/// Errors that the renderer asked about: losses, and others.
#[derive(Resource, Default, Clone, Copy, Debug, PartialEq, Eq)]
struct Asked {
    lost: u32,
    other: u32,
}

fn recover(error: &RenderError, main: &mut World, _: &mut World) -> RenderErrorPolicy {
    let mut asked = main.resource_mut::<Asked>();
    if matches!(error.ty, ErrorType::DeviceLost) {
        asked.lost += 1;
    } else {
        asked.other += 1;
    }
    RenderErrorPolicy::Recover(RenderCreation::Automatic(Box::default()))
}

fn stage() -> Option<Stage> {
    let mut stage = Stage::with(|app| {
        app.init_resource::<Asked>()
            .insert_resource(RenderErrorHandler(recover));
    })?;
    stage.cluster_on_the_cpu();
    Some(stage)
}

fn asked(stage: &Stage) -> Asked {
    *stage.offline.app.world().resource::<Asked>()
}

/// Destroys the device, and has it told: that is, once all is done that was asked of it.
fn lose(stage: &Stage) {
    let device = stage.offline.app.world().resource::<RenderDevice>();
    let device = device.wgpu_device().clone();
    device.destroy();
    let _ = device.poll(wgpu::PollType::wait_indefinitely());
}

#[test]
fn a_device_lost_at_rest_is_outlived() {
    let Some(mut stage) = stage() else {
        return;
    };
    let before = stage.settled();
    let counts = stage.count();
    lose(&stage);
    stage.steps(4);
    assert!(!stage.has_ended());
    let after = stage.settled();
    assert_eq!(differing_px(&before, &after), 0);
    assert_eq!(stage.count(), counts);
    assert_eq!(asked(&stage), Asked { lost: 1, other: 0 });
}

/// Whose work is begun anew before the device is lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Work {
    Terrain,
    Shadows,
    Camera,
    Interior,
    InteriorOnGpu,
    Spherical,
    All,
}

impl Work {
    /// Takes away what asks for it, until nothing is left of it.
    fn forget(self, stage: &mut Stage) {
        let has = |other| self == other || self == Self::All;
        let mut gone = Vec::new();
        if has(Self::Terrain) {
            gone.push(stage.terrain);
        }
        if has(Self::Shadows) {
            gone.push(stage.sun);
        }
        if has(Self::Camera) {
            gone.push(stage.camera);
        }
        if has(Self::Interior) || self == Self::InteriorOnGpu {
            gone.push(stage.model);
        }
        if has(Self::Spherical) {
            gone.push(stage.ball);
        }
        for entity in gone {
            stage.world().despawn(entity);
        }
        stage.steps(3);
    }

    /// Asks for it again.
    fn begin(self, stage: &mut Stage) {
        let has = |other| self == other || self == Self::All;
        if has(Self::Terrain) {
            stage.spawn_terrain();
        }
        if has(Self::Shadows) {
            stage.spawn_sun();
        }
        if has(Self::Camera) {
            stage.spawn_camera();
        }
        if has(Self::Interior) || self == Self::InteriorOnGpu {
            stage.spawn_model();
        }
        if self == Self::InteriorOnGpu || self == Self::All {
            let model = stage.model;
            let on_gpu = InteriorCulling {
                field: FieldBy::Gpu,
                ..crate::life_stage::interior()
            };
            stage.world().entity_mut(model).insert(on_gpu);
        }
        if has(Self::Spherical) {
            stage.spawn_ball();
        }
    }
}

/// What is drawn and what is left out, in numbers that do not depend on which entities they are.
#[derive(Clone, Debug, PartialEq)]
struct Kept {
    /// Why each box is not drawn.
    boxes: Vec<Option<CullReason>>,
    /// Nodes and triangles that interior culling hides.
    hidden: Option<(u32, u64)>,
    /// Chunks and triangles of the ball that are drawn.
    drawn: Option<(u32, u64)>,
    counts: Counts,
}

fn kept(stage: &Stage) -> Kept {
    let world = stage.offline.app.world();
    let culled = world.get::<CulledEntities>(stage.camera);
    let boxes = stage.boxes.iter();
    let hidden = world.get::<InteriorCounts>(stage.model);
    let drawn = world.get::<SphericalCounts>(stage.ball);
    Kept {
        boxes: boxes
            .map(|entity| culled.and_then(|culled| culled.reason(*entity)))
            .collect(),
        hidden: hidden.map(|counts| (counts.hidden_nodes, counts.hidden_triangles)),
        drawn: drawn.map(|counts| (counts.drawn_chunks, counts.drawn_triangles)),
        counts: stage.count(),
    }
}

/// Frames of work before the device is lost.
const FRAMES: core::ops::RangeInclusive<u32> = 1..=6;

/// Begins the work anew and loses the device so many frames into it, and once more so many frames after: all comes out as
/// it was where nothing was lost, in no more frames than [`Stage::settle`] waits for.
fn outlives(work: Work, losses: impl Iterator<Item = (u32, Option<u32>)>) {
    let Some(mut stage) = stage() else {
        return;
    };
    let before = stage.settled();
    let kept_before = kept(&stage);
    let sets = [CullReason::Occluded, CullReason::Contribution];
    for set in sets {
        assert!(kept_before.boxes.contains(&Some(set)), "{kept_before:?}");
    }
    let mut lost = 0;
    let mut were_done = 0;
    for (frames, again) in losses {
        work.forget(&mut stage);
        work.begin(&mut stage);
        stage.steps(frames);
        were_done += u32::from(kept(&stage) == kept_before && !stage.is_working());
        lose(&stage);
        lost += 1;
        if let Some(frames) = again {
            stage.steps(frames);
            lose(&stage);
            lost += 1;
        }
        let case = format!("{work:?}, {frames} frames in, again after {again:?}");
        stage.steps(4);
        assert!(!stage.has_ended(), "{case}");
        let after = stage.settled();
        assert_eq!(differing_px(&before, &after), 0, "{case}");
        assert_eq!(kept(&stage), kept_before, "{case}");
        assert_eq!(asked(&stage), Asked { lost, other: 0 }, "{case}");
    }
    assert!(were_done < lost, "it was lost at rest only");

    // Whoever compares would have seen one box less.
    let entity = stage.boxes[0];
    stage.world().despawn(entity);
    let after = stage.settled();
    assert!(differing_px(&before, &after) > 0);
    assert_ne!(kept(&stage), kept_before);
}

fn once() -> impl Iterator<Item = (u32, Option<u32>)> {
    FRAMES.map(|frames| (frames, None))
}

/// Also where it comes when there is no device that it could be put on.
#[test]
fn a_device_lost_while_terrain_comes_is_outlived() {
    outlives(Work::Terrain, core::iter::once((0, None)).chain(once()));
}

#[test]
fn a_device_lost_while_shadow_maps_are_made_is_outlived() {
    outlives(Work::Shadows, once());
}

#[test]
fn a_device_lost_while_a_camera_begins_to_cull_is_outlived() {
    outlives(Work::Camera, once());
}

#[test]
fn a_device_lost_while_a_model_is_culled_is_outlived() {
    outlives(Work::Interior, once());
}

#[test]
fn a_device_lost_while_it_makes_a_field_is_outlived() {
    outlives(Work::InteriorOnGpu, once());
}

#[test]
fn a_device_lost_while_chunks_come_is_outlived() {
    outlives(Work::Spherical, once());
}

#[test]
fn a_device_lost_while_all_of_it_is_under_way_is_outlived() {
    outlives(Work::All, once());
}

/// The second before anything is made on it, in the first frame drawn on it, and in the next.
#[test]
fn two_devices_lost_in_a_row_are_outlived() {
    outlives(Work::All, (2..=4).map(|frames| (2, Some(frames))));
}
