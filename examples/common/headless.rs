//! For the smallest example, with nothing but Bevy: `--headless --frames N --out DIR --size WxH` draws frames without a
//! window, prints what they took and writes the last one as a picture.

#[path = "command_line.rs"]
mod command_line;

use std::{
    path::{Path, PathBuf},
    sync::mpsc,
    time::Instant,
};

use bevy::{
    app::{PluginGroupBuilder, PluginsState},
    camera::RenderTarget,
    log::{DEFAULT_FILTER, Level, LogPlugin},
    prelude::*,
    render::{
        RenderPlugin,
        pipelined_rendering::PipelinedRenderingPlugin,
        render_resource::{PollType, TextureFormat, TextureUsages},
        renderer::{RenderAdapterInfo, RenderDevice},
        view::screenshot::{Screenshot, ScreenshotCaptured},
    },
    window::{ExitCondition, WindowPlugin},
    winit::WinitPlugin,
};
use bevy_skyline::prelude::{Effects, TerrainShadow};
use command_line::{exit_with, has_display, size};

const NAME: &str = env!("CARGO_CRATE_NAME");
const USAGE: &str = "options: --headless, --frames N, --out DIR, --size WxH";
/// Frames until a picture has come back, at most.
const PATIENCE: u32 = 100;

/// Why there is nothing to see; says itself in one line.
#[derive(thiserror::Error, Debug)]
enum HeadlessError {
    #[error("{0}; {USAGE}")]
    Usage(String),
    #[error("there is no display to open a window on: use --headless")]
    NoDisplay,
    #[error("no GPU device could be opened: install a Vulkan driver")]
    NoDevice,
    #[error("the picture did not come back; see the log")]
    NoPicture,
    #[error("cannot write {0}: {1}")]
    Write(String, String),
}

impl HeadlessError {
    fn unwritten(path: &Path, reason: &dyn core::fmt::Display) -> Self {
        Self::Write(path.display().to_string(), reason.to_string())
    }
}

/// The command line without `--headless` itself.
#[derive(Clone)]
struct Options {
    folder: PathBuf,
    frames: u32,
    size: UVec2,
}

/// `plugins` as they are, or without a window where the command line says so.
pub fn window_or_picture(plugins: DefaultPlugins) -> PluginGroupBuilder {
    match parse(std::env::args().skip(1)) {
        Ok(Some(options)) => plugins
            .set(WindowPlugin {
                primary_window: None,
                exit_condition: ExitCondition::DontExit,
                ..default()
            })
            .set(LogPlugin {
                level: Level::WARN,
                filter: format!("{DEFAULT_FILTER}bevy_render::renderer=error"),
                ..default()
            })
            .set(RenderPlugin {
                synchronous_pipeline_compilation: true,
                ..default()
            })
            .disable::<WinitPlugin>()
            .disable::<PipelinedRenderingPlugin>()
            .add(Headless(options)),
        Ok(None) if has_display() => plugins.build(),
        Ok(None) => leave(&HeadlessError::NoDisplay),
        Err(error) => leave(&error),
    }
}

fn leave(error: &HeadlessError) -> ! {
    let code = match exit_with(NAME, error, false) {
        AppExit::Error(code) => i32::from(code.get()),
        AppExit::Success => 0,
    };
    std::process::exit(code)
}

/// `None`: a window is asked for.
fn parse(mut words: impl Iterator<Item = String>) -> Result<Option<Options>, HeadlessError> {
    let mut headless = false;
    let mut options = Options {
        folder: ".".into(),
        frames: 10,
        size: UVec2::new(1280, 720),
    };
    while let Some(word) = words.next() {
        let mut value = || {
            let missing = || HeadlessError::Usage(format!("{word} lacks a value"));
            words.next().ok_or_else(missing)
        };
        let wrong = |why: &str| HeadlessError::Usage(format!("{word}: {why}"));
        match word.as_str() {
            "--headless" => headless = true,
            "--out" => (headless, options.folder) = (true, value()?.into()),
            "--size" => options.size = size(&value()?).map_err(|why| wrong(&why))?,
            "--frames" => {
                let frames = value()?.parse().ok().filter(|frames| *frames > 0);
                options.frames = frames.ok_or_else(|| wrong("not a number above 0"))?;
            }
            "--help" | "-h" => {
                println!("{NAME}: {USAGE}");
                std::process::exit(0);
            }
            _ => return Err(HeadlessError::Usage(format!("unexpected {word}"))),
        }
    }
    if headless {
        std::fs::create_dir_all(&options.folder)
            .map_err(|error| HeadlessError::unwritten(&options.folder, &error))?;
    }
    Ok(headless.then_some(options))
}

/// Steps the app by hand. Cameras draw to an image.
struct Headless(Options);

/// What cameras draw to.
#[derive(Resource)]
struct Target(Handle<Image>);

impl Plugin for Headless {
    fn build(&self, app: &mut App) {
        let options = self.0.clone();
        app.add_observer(retarget)
            .add_observer(hurry)
            .set_runner(move |app| {
                run(app, &options).unwrap_or_else(|error| {
                    exit_with(
                        NAME,
                        &error,
                        matches!(error, HeadlessError::NoDevice | HeadlessError::NoPicture),
                    )
                })
            });
    }
}

fn retarget(added: On<Add, Camera3d>, target: Res<Target>, mut commands: Commands) {
    let image = RenderTarget::Image(target.0.clone().into());
    commands.entity(added.entity).insert(image);
}

/// Nobody waits for these frames: all the time they need for shadows.
fn hurry(added: On<Add, TerrainShadow>, mut shadows: Query<&mut TerrainShadow>) {
    if let Ok(mut shadow) = shadows.get_mut(added.entity) {
        shadow.slice_ms = 1_000.0;
    }
}

fn run(mut app: App, options: &Options) -> Result<AppExit, HeadlessError> {
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
    let Some(device) = app.world().get_resource::<RenderDevice>().cloned() else {
        return Err(HeadlessError::NoDevice);
    };
    let UVec2 { x, y } = options.size;
    let mut image = Image::new_target_texture(x, y, TextureFormat::Rgba8UnormSrgb, None);
    image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
    let target = app.world_mut().resource_mut::<Assets<Image>>().add(image);
    app.insert_resource(Target(target.clone()));

    let mut times_ms = Vec::new();
    for _ in 0..options.frames {
        let start = Instant::now();
        app.update();
        // A lost device is Bevy's to report.
        let _ = device.poll(PollType::wait_indefinitely());
        times_ms.push(start.elapsed().as_secs_f64() * 1e3);
    }
    times_ms.sort_by(f64::total_cmp);
    let (min, median, max) = (
        times_ms[0],
        times_ms[times_ms.len() / 2],
        times_ms[times_ms.len() - 1],
    );

    let path = options.folder.join(format!("{NAME}.png"));
    let (sender, receiver) = mpsc::channel();
    app.world_mut().spawn(Screenshot::image(target)).observe(
        move |shot: On<ScreenshotCaptured>| {
            // The receiver waits below.
            let _ = sender.send(shot.image.clone());
        },
    );
    let picture = (0..PATIENCE).find_map(|_| {
        app.update();
        let _ = device.poll(PollType::wait_indefinitely());
        receiver.try_recv().ok()
    });
    let picture = picture.and_then(|image| image.try_into_dynamic().ok());
    let picture = picture.ok_or(HeadlessError::NoPicture)?.into_rgb8();
    picture
        .save(&path)
        .map_err(|error| HeadlessError::unwritten(&path, &error))?;
    println!("{}", std::path::absolute(&path).unwrap_or(path).display());
    println!(
        "frame times: median {median:.1} ms, min {min:.1} ms, max {max:.1} ms ({} frames of {x}x{y})",
        options.frames
    );
    if let Some(adapter) = app.world().get_resource::<RenderAdapterInfo>() {
        println!("adapter: {}", adapter.name);
    }
    if let Some(effects) = app.world().get_resource::<Effects>() {
        println!("Terrain {}", effects.terrain());
        println!("TerrainShadow {}", effects.terrain_shadow());
    }
    Ok(AppExit::Success)
}
