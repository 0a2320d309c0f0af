//! A terrain to fly over: an elevation file, or mountains made by code.
//!
//! ```sh
//! cargo run --all-features --example demo
//! cargo run --all-features --example demo -- heights.png
//! cargo run --all-features --example demo -- --headless --out picture.png
//! ```
//!
//! In the window: W, A, S, D, E and Q fly, Shift flies faster, the right mouse button looks around, the wheel
//! sets the speed; 1 to 4 choose how rays skip empty space, + and − how far the picture may be from the exact
//! surface.

mod common;

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use bevy::{
    camera_controller::free_camera::{FreeCamera, FreeCameraPlugin},
    diagnostic::{DiagnosticsStore, FrameTimeDiagnosticsPlugin},
    input::keyboard::Key,
    prelude::*,
    render::diagnostic::RenderDiagnosticsPlugin,
    time::common_conditions::on_timer,
    window::PrimaryWindow,
};
use bevy_skyline::{
    offline::{Offline, OfflineError, TRAVERSALS, traversal_name},
    prelude::*,
    terrain::{HeightFieldError, HeightFieldLoadError, read_height_field},
};
use clap::Parser;
use common::{
    command_line::{exit_with, has_display, size},
    landscape,
    scene::{Viewpoint, camera, diagonal_m, populate},
};

/// Shows a terrain in a window, or makes a picture of it.
#[derive(Parser)]
#[command(name = "demo")]
struct Options {
    /// Elevation file: 16-bit PNG or TIFF, float TIFF, SRTM .hgt, raw 16-bit; else mountains made by code.
    file: Option<PathBuf>,
    /// Open no window: write a picture and print its path and the frame times.
    #[arg(long)]
    headless: bool,
    /// The picture to write; implies --headless [default: demo.png].
    #[arg(long, value_name = "P.png")]
    out: Option<PathBuf>,
    /// Pixels of the picture or the window.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size)]
    size: UVec2,
    /// Frames to time for the picture.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// How far the picture may be from the exact surface, in pixels; 0 is exact.
    #[arg(long, value_name = "E", default_value_t = TerrainRayCasting::default().max_error_px)]
    max_error_px: f32,
    /// Where the camera starts, in metres; Y is up, sample (0,0) at the origin, columns +X, rows +Z.
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true, requires = "target")]
    eye: Option<Vec3>,
    /// What it looks at, in metres.
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true, requires = "eye")]
    target: Option<Vec3>,
}

fn point(text: &str) -> Result<Vec3, String> {
    let numbers = text
        .split(',')
        .map(|n| n.trim().parse::<f32>().ok().filter(|n| n.is_finite()));
    let numbers: Vec<f32> = numbers.collect::<Option<_>>().ok_or("not three numbers")?;
    let numbers: [f32; 3] = numbers.try_into().map_err(|_| "not three numbers")?;
    Ok(numbers.into())
}

/// Why there is nothing to see; says itself in one line.
#[derive(thiserror::Error, Debug)]
enum DemoError {
    #[error(transparent)]
    Unreadable(HeightFieldLoadError),
    #[error("{}: {source}", path.display())]
    File {
        path: PathBuf,
        source: HeightFieldLoadError,
    },
    #[error(transparent)]
    Landscape(#[from] HeightFieldError),
    #[error("there is no display to open a window on: use --headless")]
    NoDisplay,
    #[error("a picture of {0}x{1} pixels is larger than this GPU can draw: at most {2} a side")]
    TooLarge(u32, u32, u32),
    #[error(transparent)]
    Offline(#[from] OfflineError),
    #[error("cannot write {}: {source}", path.display())]
    Write {
        path: PathBuf,
        source: image::ImageError,
    },
}

fn main() -> AppExit {
    let options = Options::parse();
    run(&options)
        .unwrap_or_else(|error| exit_with("demo", &error, matches!(error, DemoError::Offline(_))))
}

fn run(options: &Options) -> Result<AppExit, DemoError> {
    let headless = options.headless || options.out.is_some();
    if !headless && !has_display() {
        return Err(DemoError::NoDisplay);
    }
    let field = match &options.file {
        Some(path) => read(path)?,
        None => landscape::mountains()?,
    };
    let viewpoint = match options.eye.zip(options.target) {
        Some((eye, target)) => Viewpoint { eye, target },
        None => Viewpoint::over(&field),
    };
    if headless {
        draw(options, field, viewpoint)?;
        return Ok(AppExit::Success);
    }
    Ok(fly(options, field, viewpoint))
}

fn read(path: &Path) -> Result<HeightField, DemoError> {
    let settings = HeightFieldSettings::default();
    let (field, notes) = read_height_field(path, &settings).map_err(|source| match source {
        // This one names the file itself.
        HeightFieldLoadError::Read { .. } => DemoError::Unreadable(source),
        _ => DemoError::File {
            path: path.into(),
            source,
        },
    })?;
    for note in notes {
        eprintln!("demo: {}: {note}", path.display());
    }
    Ok(field)
}

fn casting(options: &Options) -> TerrainRayCasting {
    TerrainRayCasting {
        max_error_px: options.max_error_px.max(0.0),
        ..default()
    }
}

/// One picture, and how long its frames take.
fn draw(options: &Options, field: HeightField, viewpoint: Viewpoint) -> Result<(), DemoError> {
    let mut offline = Offline::new()?;
    let limit = offline.max_image_side();
    if options.size.max_element() > limit {
        return Err(DemoError::TooLarge(options.size.x, options.size.y, limit));
    }
    let target = offline.target(options.size);
    let casting = casting(options);
    let camera = offline.camera(&target, (camera(&field, viewpoint), casting));
    populate(offline.app.world_mut(), field, viewpoint);
    // Where only sky is in view nothing settles, and there is nothing to wait for either.
    match offline.settle(camera, 16) {
        Err(OfflineError::NotFinished(_)) if offline.counts().views_drawn == 0 => {}
        settled => settled?,
    }
    // Nobody waits for these frames: all the time they need for shadows.
    let world = offline.app.world_mut();
    let mut shadows = world.query::<&mut TerrainShadow>();
    for mut shadow in shadows.iter_mut(world) {
        shadow.slice_ms = 1_000.0;
    }
    if offline.counts().views_drawn > 0 {
        offline.settle_shadows(200)?;
    }
    let mut times_ms: Vec<f64> = (0..options.frames)
        .map(|_| {
            let start = Instant::now();
            offline.step();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times_ms.sort_by(f64::total_cmp);
    let (min, median, max) = (
        times_ms[0],
        times_ms[times_ms.len() / 2],
        times_ms[times_ms.len() - 1],
    );

    let path = options.out.clone().unwrap_or_else(|| "demo.png".into());
    let picture = image::DynamicImage::ImageRgba8(offline.picture(&target)?).into_rgb8();
    picture
        .save_with_format(&path, image::ImageFormat::Png)
        .map_err(|source| DemoError::Write {
            path: path.clone(),
            source,
        })?;
    let path = std::path::absolute(&path).unwrap_or(path);
    println!("{}", path.display());
    println!(
        "frame times: median {median:.1} ms, min {min:.1} ms, max {max:.1} ms ({} frames of {}x{})",
        options.frames, options.size.x, options.size.y
    );
    println!("adapter: {}", offline.adapter());
    if let Some(effects) = offline.app.world().get_resource::<Effects>() {
        println!("terrain: {}", effects.terrain());
        println!("terrain shadow: {}", effects.terrain_shadow());
    }
    Ok(())
}

/// What the window's world is made of.
#[derive(Resource)]
struct Start {
    field: HeightField,
    viewpoint: Viewpoint,
    casting: TerrainRayCasting,
}

/// A window with a flying camera.
fn fly(options: &Options, field: HeightField, viewpoint: Viewpoint) -> AppExit {
    let window = Window {
        title: "Skyline".into(),
        resolution: (options.size.x, options.size.y).into(),
        ..default()
    };
    App::new()
        .add_plugins((
            DefaultPlugins.set(WindowPlugin {
                primary_window: Some(window),
                ..default()
            }),
            SkylinePlugins,
            FreeCameraPlugin,
            FrameTimeDiagnosticsPlugin::default(),
            RenderDiagnosticsPlugin,
        ))
        .insert_resource(Start {
            field,
            viewpoint,
            casting: casting(options),
        })
        .add_systems(Startup, start)
        .add_systems(
            Update,
            (
                choose,
                turn_sun,
                report.run_if(on_timer(Duration::from_secs(1))),
            ),
        )
        .run()
}

fn start(world: &mut World) {
    let Some(Start {
        field,
        viewpoint,
        casting,
    }) = world.remove_resource()
    else {
        return;
    };
    let speed = 0.012 * diagonal_m(&field);
    let controls = FreeCamera {
        walk_speed: speed,
        run_speed: 5.0 * speed,
        friction: 8.0,
        ..default()
    };
    info!("{controls}");
    info!("1 per texel, 2 max mip, 3 boxes, 4 hybrid; + and - change the error allowed");
    info!("the arrows turn the sun, raise it and lower it");
    world.spawn((
        Camera3d::default(),
        camera(&field, viewpoint),
        casting,
        controls,
    ));
    populate(world, field, viewpoint);
}

/// Errors that + and − step through. units: px
const ERRORS_PX: [f32; 6] = [0.0, 0.5, 1.0, 2.0, 4.0, 8.0];

fn choose(
    digits: Res<ButtonInput<KeyCode>>,
    signs: Res<ButtonInput<Key>>,
    mut cameras: Query<&mut TerrainRayCasting>,
) {
    let keys = [
        KeyCode::Digit1,
        KeyCode::Digit2,
        KeyCode::Digit3,
        KeyCode::Digit4,
    ];
    let traversal = keys.iter().position(|key| digits.just_pressed(*key));
    // By what they write: keyboards put them in different places. `=` is + without Shift on many.
    let pressed = |sign: &str| signs.just_pressed(Key::Character(sign.into()));
    let step = i32::from(pressed("+") || pressed("=")) - i32::from(pressed("-"));
    if traversal.is_none() && step == 0 {
        return;
    }
    for mut casting in &mut cameras {
        if let Some(index) = traversal {
            casting.traversal = TRAVERSALS[index].0;
        }
        let at = ERRORS_PX
            .iter()
            .rposition(|error| *error <= casting.max_error_px)
            .unwrap_or(0);
        let last = ERRORS_PX.len() as i32 - 1;
        casting.max_error_px = ERRORS_PX[(at as i32 + step).clamp(0, last) as usize];
        info!(
            "{}, at most {} px off",
            traversal_name(casting.traversal),
            casting.max_error_px
        );
    }
}

/// Turns the sun about the vertical and raises it, for as long as keys are held.
fn turn_sun(
    time: Res<Time>,
    keys: Res<ButtonInput<KeyCode>>,
    mut suns: Query<&mut Transform, With<DirectionalLight>>,
) {
    let held = |key| f32::from(u8::from(keys.pressed(key)));
    let turn = held(KeyCode::ArrowRight) - held(KeyCode::ArrowLeft);
    let rise = held(KeyCode::ArrowUp) - held(KeyCode::ArrowDown);
    if turn == 0.0 && rise == 0.0 {
        return;
    }
    let step = 0.3 * time.delta_secs();
    for mut sun in &mut suns {
        let to_sun = *sun.back();
        let elevation = (to_sun.y.asin() + rise * step).clamp(0.0, 1.5);
        let azimuth = to_sun.x.atan2(to_sun.z) + turn * step;
        let (sin, cos) = elevation.sin_cos();
        let to_sun = Vec3::new(cos * azimuth.sin(), sin, cos * azimuth.cos());
        *sun = Transform::default().looking_to(-to_sun, Vec3::Y);
    }
}

fn report(
    diagnostics: Res<DiagnosticsStore>,
    effects: Res<Effects>,
    cameras: Query<&TerrainRayCasting>,
    mut windows: Query<&mut Window, With<PrimaryWindow>>,
) {
    let frame = diagnostics.get(&FrameTimeDiagnosticsPlugin::FRAME_TIME);
    let Some(frame_ms) = frame.and_then(|diagnostic| diagnostic.smoothed()) else {
        return;
    };
    info!("frame {frame_ms:.1} ms; terrain {}", effects.terrain());
    info!("terrain shadow {}", effects.terrain_shadow());
    for (mut window, casting) in windows.iter_mut().zip(&cameras) {
        window.title = format!(
            "Skyline · {frame_ms:.1} ms · {} · at most {} px off",
            traversal_name(casting.traversal),
            casting.max_error_px
        );
    }
}
