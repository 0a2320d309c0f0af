//! The panel in a real window, on a display in memory.
//!
//! The test starts `Xvfb` and itself once more as a child with that display: an event loop and its display belong to a
//! whole process.

use std::{
    env,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use bevy::{
    core_pipeline::tonemapping::DebandDither,
    input::{
        ButtonState,
        keyboard::{Key, KeyboardInput},
    },
    light::AmbientLight,
    prelude::*,
    render::{
        RenderPlugin,
        diagnostic::RenderDiagnosticsPlugin,
        view::screenshot::{Screenshot, ScreenshotCaptured},
    },
    window::PrimaryWindow,
    winit::{WinitPlugin, WinitSettings},
};
use bevy_skyline::{
    budget::GivenFrameTimes,
    offline::scenes::{
        Look,
        city::{self, CitySize},
    },
    panel::{PanelData, PanelPlugin, PanelRequest, SkylinePanel},
    prelude::*,
};
use image::RgbImage;

/// Set for the child. Its value is where the picture with the panel is kept; empty for nowhere.
const CHILD: &str = "SKYLINE_PANEL_CHILD";
/// Keeps the picture with the panel, as a PNG.
const PICTURE: &str = "SKYLINE_PANEL_PNG";
/// What the child does not take.
const LONGEST: Duration = Duration::from_secs(300);
/// The knob that is taken by hand; it changes no pixel.
const KNOB: &str = "occlusion_volume";
const SIZE: UVec2 = UVec2::new(960, 1000);

/// Ends with the test, whatever becomes of it.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A display, and its name.
fn display() -> Option<(Running, String)> {
    let screen = format!("{}x{}x24", SIZE.x, SIZE.y);
    let spawned = Command::new("Xvfb")
        .args([
            "-displayfd",
            "1",
            "-screen",
            "0",
            &screen,
            "-nolisten",
            "tcp",
        ])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn();
    let mut server = match spawned {
        Ok(server) => Running(server),
        Err(error) => {
            println!("skipped: Xvfb does not start ({error}): scripts/setup.sh --test installs it");
            return None;
        }
    };
    let mut number = String::new();
    let stdout = server.0.stdout.take()?;
    let read = BufReader::new(stdout).read_line(&mut number);
    if read.is_err() || number.trim().is_empty() {
        println!("skipped: Xvfb opened no display");
        return None;
    }
    Some((server, format!(":{}", number.trim())))
}

#[test]
fn a_real_window_shows_it() {
    if let Ok(picture) = env::var(CHILD) {
        in_the_window(&picture);
        return;
    }
    if crate::device().is_none() {
        return;
    }
    let Some((_server, display)) = display() else {
        return;
    };
    let mut child = Running(
        Command::new(env::current_exe().unwrap())
            .args([
                "panel_window::a_real_window_shows_it",
                "--exact",
                "--nocapture",
            ])
            // Where the file of results is.
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .env("DISPLAY", display)
            .env_remove("WAYLAND_DISPLAY")
            .env(CHILD, env::var(PICTURE).unwrap_or_default())
            .spawn()
            .unwrap(),
    );
    let began = Instant::now();
    let status = loop {
        if let Some(status) = child.0.try_wait().unwrap() {
            break status;
        }
        assert!(
            began.elapsed() < LONGEST,
            "the window does not come to an end"
        );
        std::thread::sleep(Duration::from_millis(100));
    };
    assert!(status.success(), "see above: {status}");
}

/// What happens in the window, in this order. Each step waits until what it needs is there.
#[derive(Resource, Default)]
struct Play {
    frame: u32,
    /// Frame in which the last step was taken.
    since: u32,
    step: usize,
    asked: bool,
    /// Frames before a picture.
    wait: u32,
    /// Whether the camera turns and the budget has work to do: for a picture that is looked at and not compared.
    turns: bool,
    seen: Arc<Mutex<Seen>>,
}

#[derive(Default)]
struct Seen {
    pictures: Vec<RgbImage>,
    /// Width of the panel. units: px
    width: f32,
    rows: usize,
    frames: usize,
    /// Step of the knob that is taken by hand.
    by_hand: Option<usize>,
    done: bool,
}

fn in_the_window(picture: &str) {
    let seen = Arc::<Mutex<Seen>>::default();
    let window = Window {
        title: "Skyline".into(),
        resolution: (SIZE.x, SIZE.y).into(),
        ..default()
    };
    let mut app = App::new();
    app.add_plugins((
        DefaultPlugins
            .set(WindowPlugin {
                primary_window: Some(window),
                ..default()
            })
            .set(RenderPlugin {
                synchronous_pipeline_compilation: true,
                ..default()
            })
            // Tests have no main thread.
            .set(WinitPlugin {
                run_on_any_thread: true,
            }),
        SkylinePlugins,
        RenderDiagnosticsPlugin,
        PanelPlugin,
    ))
    // Without a window manager nothing has the focus.
    .insert_resource(WinitSettings::continuous())
    .insert_resource(Play {
        seen: seen.clone(),
        // A graph that is to be looked at has some bars.
        wait: if picture.is_empty() { 12 } else { 130 },
        turns: !picture.is_empty(),
        ..default()
    })
    .add_systems(Startup, scene)
    .add_systems(Update, (play, give_time));
    assert_eq!(app.run(), AppExit::Success);

    let seen = seen.lock().unwrap();
    assert!(seen.done);
    let [closed, open, again] = &seen.pictures[..] else {
        panic!("{} pictures", seen.pictures.len());
    };
    if !picture.is_empty() {
        open.save_with_format(Path::new(picture), image::ImageFormat::Png)
            .unwrap();
    }
    assert!(seen.frames > 8, "{} frame times", seen.frames);
    assert_eq!(seen.rows, Effect::ALL.len());
    assert_eq!(seen.by_hand, Some(1));
    let left = SIZE.x - seen.width.ceil() as u32;
    assert!((200..SIZE.x - 300).contains(&left), "{left}");
    assert!(
        closed
            .pixels()
            .any(|pixel| *pixel != *closed.get_pixel(0, 0))
    );
    let differing = |a: &RgbImage, b: &RgbImage, from: u32, to: u32| {
        let columns = (from..to).flat_map(|x| (0..SIZE.y).map(move |y| (x, y)));
        let differs = |(x, y): &(u32, u32)| {
            let [a, b] = [a, b].map(|picture| picture.get_pixel(*x, *y).0);
            // One code is rounding.
            a.iter().zip(b).any(|(a, b)| a.abs_diff(b) > 1)
        };
        columns.filter(differs).count()
    };
    let of_panel = seen.width as usize * SIZE.y as usize;
    let changed = differing(closed, open, left, SIZE.x);
    assert!(
        changed * 10 > of_panel * 9,
        "{changed} of {of_panel} pixels"
    );
    if !picture.is_empty() {
        return;
    }
    assert_eq!(
        differing(closed, open, 0, left),
        0,
        "the picture beside the panel"
    );
    assert_eq!(differing(closed, again, 0, SIZE.x), 0, "closed again");
}

fn scene(world: &mut World) {
    let scene = city::generated(CitySize::Small);
    scene.spawn(world, Look::Shaded);
    world.spawn((
        Name::new("street"),
        Camera3d::default(),
        Camera {
            clear_color: ClearColorConfig::Custom(Color::linear_rgb(0.55, 0.68, 0.85)),
            ..default()
        },
        Projection::Perspective(scene.projection()),
        // Dithering would differ from picture to picture.
        DebandDither::Disabled,
        Msaa::Off,
        scene.view("street"),
        AmbientLight {
            brightness: 900.0,
            ..default()
        },
        ZBufferOcclusion::default(),
        ContributionCulling::default(),
        FrameBudget {
            clock: BudgetClock::Given,
            ..FrameBudget::from_hz(60.0)
        },
    ));
}

/// The same time every frame, so that the budget leaves the picture as it is; or what the drawn objects and triangles
/// of a camera that turns are said to cost.
fn give_time(
    play: Res<Play>,
    camera: Single<(&mut Transform, &ContributionCounts)>,
    mut given: ResMut<GivenFrameTimes>,
) {
    if !play.turns {
        given.last_ms = Some(12.0);
        return;
    }
    let (mut place, counts) = camera.into_inner();
    place.rotate_y(0.02);
    let objects = counts.candidates.saturating_sub(counts.removed) as f32;
    given.last_ms = Some(2.0 + 0.03 * objects + 0.0005 * counts.triangles_drawn as f32);
}

/// A picture of the window, once.
fn look(commands: &mut Commands, seen: &Arc<Mutex<Seen>>) {
    let seen = seen.clone();
    commands
        .spawn(Screenshot::primary_window())
        .observe(move |shot: On<ScreenshotCaptured>| {
            let picture = shot.image.clone().try_into_dynamic().unwrap();
            seen.lock().unwrap().pictures.push(picture.into_rgb8());
        });
}

fn press(keys: &mut MessageWriter<KeyboardInput>, window: Entity) {
    for state in [ButtonState::Pressed, ButtonState::Released] {
        keys.write(KeyboardInput {
            key_code: KeyCode::F3,
            logical_key: Key::F3,
            state,
            text: None,
            repeat: false,
            window,
        });
    }
}

fn play(
    mut play: ResMut<Play>,
    mut commands: Commands,
    window: Single<Entity, With<PrimaryWindow>>,
    mut keys: MessageWriter<KeyboardInput>,
    mut exit: MessageWriter<AppExit>,
    mut panel: ResMut<SkylinePanel>,
    data: Option<Res<PanelData>>,
) {
    play.frame += 1;
    let waited = play.frame - play.since;
    let pictures = play.seen.lock().unwrap().pictures.len();
    let asked = play.asked;
    let next = match play.step {
        // Culling settles meanwhile, and the graph fills.
        0 | 2 | 4 if waited < play.wait => false,
        0 | 2 | 4 if !asked => {
            let seen = play.seen.clone();
            if let Some(data) = &data {
                let mut seen = seen.lock().unwrap();
                let knob = data.knobs.iter().find(|knob| knob.name == KNOB);
                seen.by_hand = knob.and_then(|knob| knob.manual);
                seen.width = panel.width;
                seen.rows = data.effects.len();
                seen.frames = data.frames.len();
            }
            look(&mut commands, &seen);
            play.asked = true;
            false
        }
        0 | 2 | 4 => pictures > play.step / 2,
        // What the closed panel is asked it does not hear.
        1 if panel.open => {
            commands.write_message(PanelRequest::SetManual {
                knob: KNOB,
                step: Some(1),
            });
            true
        }
        1 => {
            press(&mut keys, *window);
            panel.results = Some("tests/golden/results.jsonl".into());
            false
        }
        3 => {
            press(&mut keys, *window);
            true
        }
        _ => {
            play.seen.lock().unwrap().done = !panel.open;
            exit.write(AppExit::Success);
            false
        }
    };
    if next {
        play.step += 1;
        play.since = play.frame;
        play.asked = false;
    }
}
