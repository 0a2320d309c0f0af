//! What a frame took: of the main world, of the render world, of the GPU.
//!
//! Work is timed, not waiting: the main world from the start of `First` to the end of `Last`; the render world from the
//! start of its schedule to its cleaning up, in which frame limiters sleep, less the acquisition of the window's next
//! image, in which it waits for the display; the GPU by the spans of Bevy's `RenderDiagnosticsPlugin`, where it is
//! added and the GPU has timestamps.
//! Where the render world has a thread of its own (`PipelinedRenderingPlugin`) the longest of the three is the frame's
//! time; else the first two follow each other and count together.
//!
//! Each time is put down to its own frame. Bevy does not say which frame GPU times are of: they are taken for those of
//! [`GPU_AGE`] frames ago. Where that is a frame off, a workload that jumps looks like a frame far off, which feedback
//! passes over.

use std::sync::{Arc, Mutex, PoisonError};

use bevy::{
    diagnostic::DiagnosticsStore,
    ecs::schedule::IntoScheduleConfigs,
    platform::time::Instant,
    prelude::*,
    render::{Extract, ExtractSchedule, Render, RenderApp, RenderSystems, view::prepare_windows},
};

use super::{Budget, controller::Measured};
use crate::systems::spans::in_frame;

/// Frames between one and the arrival of its GPU times.
pub const GPU_AGE: u64 = 3;
/// Frames that times are collected for.
const KEPT: usize = 8;
/// Frames without a new GPU time, after which none is waited for.
const GPU_PATIENCE: u64 = 8;

/// What is known of one frame. units: ms
#[derive(Clone, Copy, Debug, Default)]
struct Times {
    frame: u64,
    main: Option<f32>,
    render: Option<f32>,
    gpu: Option<f32>,
}

/// Which part of a frame took longest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Bound {
    /// The main world, or both worlds one after the other.
    #[default]
    Cpu,
    /// The render world, in a thread of its own.
    Render,
    /// The GPU.
    Gpu,
}

/// Collects what becomes known of each frame.
#[derive(Debug, Default)]
pub struct FrameTimes {
    kept: [Times; KEPT],
    began: Option<Instant>,
    newest_gpu: Option<Instant>,
    /// Frame in which a GPU time last came.
    gpu_came: Option<u64>,
    told: u64,
    bound: Bound,
}

impl FrameTimes {
    /// Which part of the last frame told of took longest.
    pub fn bound(&self) -> Bound {
        self.bound
    }

    /// The main world begins a frame.
    pub(crate) fn begin(&mut self, frame: u64) {
        self.kept[frame as usize % KEPT] = Times { frame, ..default() };
        self.began = Some(Instant::now());
    }

    /// The main world ends its frame.
    pub(crate) fn end(&mut self, frame: u64) {
        let ms = self.began.map(|began| began.elapsed().as_secs_f32() * 1e3);
        self.of(frame, |times| times.main = ms);
    }

    fn of(&mut self, frame: u64, put: impl FnOnce(&mut Times)) {
        let times = &mut self.kept[frame as usize % KEPT];
        if times.frame == frame {
            put(times);
        }
    }

    /// Takes in what came from the render world.
    pub(crate) fn take_render(&mut self, clock: &RenderClock) {
        let mut times = clock.times.lock().unwrap_or_else(PoisonError::into_inner);
        for (frame, ms) in times.iter_mut().filter_map(Option::take) {
            self.of(frame, |times| times.render = Some(ms));
        }
    }

    /// Takes in the GPU's times, if new ones came: of all spans that lie in no other.
    pub(crate) fn take_gpu(&mut self, store: &DiagnosticsStore, now: u64) {
        let spans = || {
            store.iter().filter(|diagnostic| {
                let mut path = diagnostic.path().components();
                path.next() == Some("render")
                    && path.next().is_some()
                    && path.next() == Some("elapsed_gpu")
                    && path.next().is_none()
            })
        };
        let measured = spans().filter_map(|span| span.measurement());
        let Some(newest) = measured.map(|measurement| measurement.time).max() else {
            return;
        };
        if self.newest_gpu == Some(newest) {
            return;
        }
        self.newest_gpu = Some(newest);
        self.gpu_came = Some(now);
        let ms: f64 = spans().map(|span| in_frame(span, newest)).sum();
        if let Some(frame) = now.checked_sub(GPU_AGE) {
            self.of(frame, |times| times.gpu = Some(ms as f32));
        }
    }

    /// The next frame of which all is known that will be, and that was not told of yet.
    pub(crate) fn work(
        &mut self,
        now: u64,
        is_pipelined: bool,
        has_render: bool,
    ) -> Option<Measured> {
        let has_gpu = self.gpu_came.is_some_and(|came| now - came < GPU_PATIENCE);
        let age = match (has_gpu, is_pipelined) {
            (true, _) => GPU_AGE,
            (false, true) => 2,
            (false, false) => 1,
        };
        let frame = now.checked_sub(age)?;
        let times = self.kept[frame as usize % KEPT];
        if times.frame != frame || frame < self.told {
            return None;
        }
        // A frame of which a part is missing would seem short.
        let main = times.main?;
        let render = if has_render { times.render? } else { 0.0 };
        let gpu = if has_gpu { times.gpu? } else { 0.0 };
        self.told = frame + 1;
        let (cpu, render) = if is_pipelined {
            (main, render)
        } else {
            (main + render, 0.0)
        };
        let ms = cpu.max(render).max(gpu);
        self.bound = if ms == gpu {
            Bound::Gpu
        } else if ms == render {
            Bound::Render
        } else {
            Bound::Cpu
        };
        Some(Measured { frame, ms })
    }
}

/// A frame, and what it took. units: ms
type Timed = Option<(u64, f32)>;

/// Times of the render world's last frames, by frame, on their way to the main world. units: ms
#[derive(Resource, Clone, Default)]
pub struct RenderClock {
    times: Arc<Mutex<[Timed; KEPT]>>,
    /// Whether there is a render world.
    runs: bool,
}

impl RenderClock {
    /// Whether there is a render world to be timed.
    pub(crate) fn runs(&self) -> bool {
        self.runs
    }
}

/// The render world's side.
#[derive(Resource)]
struct RenderTimer {
    clock: RenderClock,
    /// The frame that is drawn, if it is to be timed.
    frame: Option<u64>,
    began: Option<Instant>,
    wait_began: Option<Instant>,
    waited_ms: f32,
}

/// Registers the render world's side.
pub(crate) fn add_render_timer(app: &mut App) {
    let runs = app.get_sub_app(RenderApp).is_some();
    let mut clock = app.world_mut().get_resource_or_init::<RenderClock>();
    clock.runs = runs;
    let clock = clock.clone();
    let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
        return;
    };
    render_app
        .insert_resource(RenderTimer {
            clock,
            frame: None,
            began: None,
            wait_began: None,
            waited_ms: 0.0,
        })
        .add_systems(ExtractSchedule, extract_frame)
        .add_systems(
            Render,
            (
                // All that draws lies between the first and the last. What comes after, in `Cleanup`, is little, and
                // limiters such as `bevy_framepace`'s sleep there.
                begin_render.before(RenderSystems::ExtractCommands),
                (
                    begin_wait.before(prepare_windows),
                    end_wait.after(prepare_windows),
                )
                    .in_set(RenderSystems::PrepareViews),
                end_render
                    .after(RenderSystems::Render)
                    .before(RenderSystems::Cleanup),
            )
                .run_if(is_timed),
        );
}

fn is_timed(timer: Res<RenderTimer>) -> bool {
    timer.frame.is_some()
}

fn extract_frame(mut timer: ResMut<RenderTimer>, budget: Extract<Res<Budget>>) {
    timer.frame = budget.timed_frame();
}

fn begin_render(mut timer: ResMut<RenderTimer>) {
    timer.began = Some(Instant::now());
    timer.waited_ms = 0.0;
}

fn begin_wait(mut timer: ResMut<RenderTimer>) {
    timer.wait_began = Some(Instant::now());
}

fn end_wait(mut timer: ResMut<RenderTimer>) {
    if let Some(began) = timer.wait_began.take() {
        timer.waited_ms += began.elapsed().as_secs_f32() * 1e3;
    }
}

fn end_render(mut timer: ResMut<RenderTimer>) {
    if let (Some(frame), Some(began)) = (timer.frame.take(), timer.began.take()) {
        let ms = (began.elapsed().as_secs_f32() * 1e3 - timer.waited_ms).max(0.0);
        let mut times = timer
            .clock
            .times
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        times[frame as usize % KEPT] = Some((frame, ms));
    }
}
