//! What the examples share: a command line, a window with a flying camera, and pictures where there is none.
#![allow(dead_code, reason = "no example uses all of it")]

#[path = "command_line.rs"]
mod command_line;

use std::{
    error::Error,
    path::PathBuf,
    time::{Duration, Instant},
};

use bevy::{
    camera::RenderTarget,
    camera_controller::free_camera::{FreeCamera, FreeCameraPlugin},
    core_pipeline::tonemapping::DebandDither,
    diagnostic::{DiagnosticsStore, FrameTimeDiagnosticsPlugin},
    prelude::*,
    render::diagnostic::RenderDiagnosticsPlugin,
    time::common_conditions::on_timer,
    window::PrimaryWindow,
};
use bevy_skyline::{
    offline::{Offline, OfflineError},
    prelude::*,
};
use clap::{Args, CommandFactory, Parser, error::ErrorKind};
use command_line::{exit_with, has_display, size};
use image::RgbImage;

/// The example's name: its command's, and what its pictures' names begin with.
pub const NAME: &str = env!("CARGO_CRATE_NAME");
/// Frames until a change has reached everything.
const SETTLE_FRAMES: u32 = 4;

/// What every example is started with.
#[derive(Args)]
pub struct StageOptions {
    /// Open no window: write pictures and print what their frames took.
    #[arg(long)]
    pub headless: bool,
    /// Folder for the pictures; implies --headless [default: .].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Pixels of the pictures or the window.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size)]
    pub size: UVec2,
    /// Frames to time for each picture.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    pub frames: u32,
    /// Of what is made by code: little, for a slow machine.
    #[arg(long)]
    pub small: bool,
}

#[derive(Parser)]
struct CommandLine<O: Args> {
    #[command(flatten)]
    stage: StageOptions,
    #[command(flatten)]
    own: O,
}

/// Why there is nothing to see; says itself in one line.
#[derive(thiserror::Error, Debug)]
pub enum StageError {
    #[error("there is no display to open a window on: use --headless")]
    NoDisplay,
    #[error("a picture of {0}x{1} pixels is larger than this GPU can draw: at most {2} a side")]
    TooLarge(u32, u32, u32),
    #[error("cannot write {}: {reason}", path.display())]
    Write { path: PathBuf, reason: String },
    #[error(transparent)]
    Input(Box<dyn Error>),
    #[error(transparent)]
    Offline(#[from] OfflineError),
}

impl StageError {
    /// Another file or option would help.
    pub fn input(error: impl Into<Box<dyn Error>>) -> Self {
        Self::Input(error.into())
    }
}

/// Reads the command line and runs the example.
pub fn start<O: Args>(run: impl FnOnce(Stage, O) -> Result<AppExit, StageError>) -> AppExit {
    let command = CommandLine::<O>::command().name(NAME);
    let parsed = command
        .try_get_matches()
        .and_then(|matches| <CommandLine<O> as clap::FromArgMatches>::from_arg_matches(&matches));
    let options = match parsed {
        Ok(options) => options,
        Err(error)
            if matches!(
                error.kind(),
                ErrorKind::DisplayHelp | ErrorKind::DisplayVersion
            ) =>
        {
            // A reader that has gone is no failure of ours.
            let _ = error.print();
            return AppExit::Success;
        }
        Err(error) => return exit_with(NAME, &UsageError(error), false),
    };
    let stage = Stage {
        options: options.stage,
        keys: "",
        effects: &[],
    };
    let result = if stage.is_headless() || has_display() {
        run(stage, options.own)
    } else {
        Err(StageError::NoDisplay)
    };
    result.unwrap_or_else(|error| exit_with(NAME, &error, matches!(error, StageError::Offline(_))))
}

/// What is wrong with the command line, in one line.
#[derive(thiserror::Error, Debug)]
struct UsageError(clap::Error);

impl core::fmt::Display for UsageError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let text = self.0.to_string();
        let first = text.split("\n\n").next().unwrap_or(&text);
        let first = first.strip_prefix("error: ").unwrap_or(first);
        let line: Vec<_> = first.split_whitespace().collect();
        write!(f, "{}; see --help", line.join(" "))
    }
}

/// A line of how things stand, beside what [`Effects`] says: in the window's title, and below each picture's times.
#[derive(Resource, Default)]
pub struct Status(pub String);

/// A window or pictures, as the command line asks.
pub struct Stage {
    pub options: StageOptions,
    /// Keys of the window beside those that fly.
    pub keys: &'static str,
    /// Effects whose state is told.
    pub effects: &'static [Effect],
}

/// What [`Stage::effects`] was.
#[derive(Resource, Clone, Copy)]
struct Told(&'static [Effect]);

impl Stage {
    pub fn is_headless(&self) -> bool {
        self.options.headless || self.options.out.is_some()
    }

    /// Adds `systems` to an app, fills its world with `scene`, and opens a window on it, or makes `film`.
    pub fn show(
        self,
        systems: impl FnOnce(&mut App),
        scene: impl FnOnce(&mut World),
        film: impl FnOnce(&mut Film) -> Result<(), StageError>,
    ) -> Result<AppExit, StageError> {
        if self.is_headless() {
            let mut camera = Film::new(self, systems, scene)?;
            film(&mut camera)?;
            println!("adapter: {}", camera.offline.adapter());
            return Ok(AppExit::Success);
        }
        let window = Window {
            title: "Skyline".into(),
            resolution: (self.options.size.x, self.options.size.y).into(),
            ..default()
        };
        let mut app = App::new();
        app.add_plugins((
            DefaultPlugins.set(WindowPlugin {
                primary_window: Some(window),
                ..default()
            }),
            SkylinePlugins,
            FreeCameraPlugin,
            FrameTimeDiagnosticsPlugin::default(),
            RenderDiagnosticsPlugin,
        ));
        #[cfg(feature = "panel")]
        app.add_plugins(bevy_skyline::panel::PanelPlugin);
        app.init_resource::<Status>()
            .insert_resource(Told(self.effects))
            .add_systems(Update, report.run_if(on_timer(Duration::from_secs(1))));
        systems(&mut app);
        scene(app.world_mut());
        info!("{}", FreeCamera::default());
        info!("{}", self.keys);
        Ok(app.run())
    }
}

/// Once a second, in the window's title and the log.
fn report(
    diagnostics: Res<DiagnosticsStore>,
    effects: Res<Effects>,
    told: Res<Told>,
    status: Res<Status>,
    mut windows: Query<&mut Window, With<PrimaryWindow>>,
) {
    let frame = diagnostics.get(&FrameTimeDiagnosticsPlugin::FRAME_TIME);
    let Some(frame_ms) = frame.and_then(|diagnostic| diagnostic.smoothed()) else {
        return;
    };
    for mut window in &mut windows {
        window.title = format!("{NAME} · {frame_ms:.1} ms · {}", status.0);
    }
    info!("frame {frame_ms:.1} ms; {}", status.0);
    for &effect in told.0 {
        info!("{effect:?} {}", effects.state(effect));
    }
}

/// Frames without a window, which are timed and become pictures.
pub struct Film {
    pub offline: Offline,
    pub options: StageOptions,
    target: Handle<Image>,
    folder: PathBuf,
    effects: &'static [Effect],
}

impl Film {
    fn new(
        stage: Stage,
        systems: impl FnOnce(&mut App),
        scene: impl FnOnce(&mut World),
    ) -> Result<Self, StageError> {
        let Stage {
            options, effects, ..
        } = stage;
        let folder = options.out.clone().unwrap_or_else(|| ".".into());
        std::fs::create_dir_all(&folder).map_err(|error| StageError::Write {
            path: folder.clone(),
            reason: error.to_string(),
        })?;
        let mut offline = Offline::with(|app| {
            app.init_resource::<Status>();
            systems(app);
        })?;
        let (size, limit) = (options.size, offline.max_image_side());
        if size.max_element() > limit {
            return Err(StageError::TooLarge(size.x, size.y, limit));
        }
        let target = offline.target(size);
        let world = offline.app.world_mut();
        scene(world);
        let mut cameras = world.query_filtered::<Entity, With<Camera3d>>();
        for camera in cameras.iter(world).collect::<Vec<_>>() {
            world.entity_mut(camera).insert((
                RenderTarget::Image(target.clone().into()),
                // Noise makes a picture's file four times as large, and no two pictures the same.
                DebandDither::Disabled,
            ));
        }
        Ok(Self {
            offline,
            options,
            target,
            folder,
            effects,
        })
    }

    pub fn world(&mut self) -> &mut World {
        self.offline.app.world_mut()
    }

    /// Draws frames until a change has reached everything.
    pub fn settle(&mut self) {
        (0..SETTLE_FRAMES).for_each(|_| self.offline.step());
    }

    /// Draws one frame. Returns how long it took, until the GPU was done. units: ms
    pub fn step(&mut self) -> f64 {
        let start = Instant::now();
        self.offline.step();
        start.elapsed().as_secs_f64() * 1e3
    }

    /// Draws as many frames as are asked for, each after `before` with its number, and tells what they took.
    pub fn time(&mut self, what: &str, mut before: impl FnMut(&mut World, u32)) {
        let mut times_ms = Vec::new();
        for frame in 0..self.options.frames {
            before(self.world(), frame);
            times_ms.push(self.step());
        }
        self.tell(what, times_ms);
    }

    /// Prints frame times, and how things stand. units: ms
    pub fn tell(&mut self, what: &str, mut times_ms: Vec<f64>) {
        times_ms.sort_by(f64::total_cmp);
        let [Some(min), Some(median), Some(max)] =
            [0, times_ms.len() / 2, times_ms.len().saturating_sub(1)].map(|i| times_ms.get(i))
        else {
            return;
        };
        println!(
            "{what}: median {median:.1} ms, min {min:.1} ms, max {max:.1} ms ({} frames of {}x{})",
            times_ms.len(),
            self.options.size.x,
            self.options.size.y
        );
        let world = self.offline.app.world();
        let status = world.get_resource::<Status>().map(|status| &status.0);
        if let Some(status) = status.filter(|status| !status.is_empty()) {
            println!("  {status}");
        }
        if let Some(effects) = world.get_resource::<Effects>() {
            for &effect in self.effects {
                println!("  {effect:?} {}", effects.state(effect));
            }
        }
    }

    /// What the last frame shows.
    pub fn look(&self) -> Result<RgbImage, StageError> {
        let picture = self.offline.picture(&self.target)?;
        Ok(image::DynamicImage::ImageRgba8(picture).into_rgb8())
    }

    /// Where a picture goes: its name is the example's, and `what` unless that is empty.
    pub fn path(&self, what: &str) -> PathBuf {
        let between = if what.is_empty() { "" } else { "_" };
        self.folder.join(format!("{NAME}{between}{what}.png"))
    }

    /// Writes a picture and prints its path.
    pub fn write(&self, what: &str, picture: &RgbImage) -> Result<(), StageError> {
        let path = self.path(what);
        picture
            .save_with_format(&path, image::ImageFormat::Png)
            .map_err(|error| StageError::Write {
                path: path.clone(),
                reason: error.to_string(),
            })?;
        self.wrote(what);
        Ok(())
    }

    /// Prints the path of a picture that is there.
    pub fn wrote(&self, what: &str) {
        let path = self.path(what);
        println!("{}", std::path::absolute(&path).unwrap_or(path).display());
    }

    /// Writes what the last frame shows.
    pub fn picture(&self, what: &str) -> Result<(), StageError> {
        self.write(what, &self.look()?)
    }
}

/// Pixels of one picture that another has otherwise.
pub fn differing(a: &RgbImage, b: &RgbImage) -> usize {
    a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count()
}

/// Which of some keys was pressed in this frame.
pub fn pressed<const N: usize>(world: &World, keys: [KeyCode; N]) -> [bool; N] {
    let input = world.get_resource::<ButtonInput<KeyCode>>();
    keys.map(|key| input.is_some_and(|input| input.just_pressed(key)))
}

/// Which of the keys 1 to 4 was pressed in this frame, from 0.
pub fn digit(world: &World) -> Option<usize> {
    let keys = [
        KeyCode::Digit1,
        KeyCode::Digit2,
        KeyCode::Digit3,
        KeyCode::Digit4,
    ];
    pressed(world, keys)
        .iter()
        .position(|is_pressed| *is_pressed)
}

/// 1 if + was pressed in this frame, −1 if − was.
pub fn sign(world: &World) -> i32 {
    use bevy::input::keyboard::Key;
    // By what they write: keyboards put them in different places. `=` is + without Shift on many.
    let input = world.get_resource::<ButtonInput<Key>>();
    let is_pressed =
        |sign: &str| input.is_some_and(|input| input.just_pressed(Key::Character(sign.into())));
    i32::from(is_pressed("+") || is_pressed("=")) - i32::from(is_pressed("-"))
}

/// The one after `value`, round and round.
pub fn after<T: Copy + PartialEq>(all: &[T], value: T) -> T {
    let at = all.iter().position(|other| *other == value);
    at.map_or(value, |at| all[(at + 1) % all.len()])
}
