//! The flight in a window: the camera's own way or yours, every effect on a key, and both pictures side by side.

use std::time::Duration;

use bevy::{
    camera_controller::free_camera::{FreeCamera, FreeCameraPlugin},
    diagnostic::{DiagnosticsStore, FrameTimeDiagnosticsPlugin},
    prelude::*,
    render::diagnostic::RenderDiagnosticsPlugin,
    time::common_conditions::on_timer,
    window::PrimaryWindow,
};
use bevy_skyline::prelude::*;

use super::{
    path::FLIGHT_S,
    sky::{self, Sun},
    split::{self, Split},
    world::{self, Flight, Scenery, Switches},
};

/// What the window's world is made of.
#[derive(Resource)]
struct Start {
    field: HeightField,
    buildings: usize,
}

/// What Digit6 gives back.
#[derive(Resource)]
struct Target(f32);

/// Opens the window, and stays until it is closed.
pub fn fly(size: UVec2, field: HeightField, buildings: usize, target_ms: Option<f32>) -> AppExit {
    let window = Window {
        title: "Skyline".into(),
        resolution: (size.x, size.y).into(),
        ..default()
    };
    let target_ms = target_ms.unwrap_or(1_000.0 / 60.0);
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
    app.insert_resource(Start { field, buildings })
        .insert_resource(Target(target_ms))
        .insert_resource(Switches::all(Some(target_ms)))
        .insert_resource(Flight {
            running: true,
            ..Flight::start()
        })
        .add_systems(Startup, start)
        .add_systems(
            Update,
            (
                choose,
                turn_sun,
                advance,
                world::switch,
                world::follow_script,
                world::cut_open,
                sky::follow_sun,
                split::follow,
            )
                .chain()
                .run_if(resource_exists::<Scenery>),
        )
        .add_systems(Last, report.run_if(on_timer(Duration::from_secs(1))))
        .run()
}

fn start(world: &mut World) {
    let Some(Start { field, buildings }) = world.remove_resource() else {
        return;
    };
    let controls = FreeCamera {
        walk_speed: 60.0,
        run_speed: 400.0,
        friction: 8.0,
        ..default()
    };
    info!("{controls}");
    info!("C camera: yours or the script's; Space stops the time; the arrows turn the sun");
    info!(
        "1 terrain shadow, 2 occlusion, 3 contribution, 4 interior, 5 spherical index, 6 frame budget; 0 all; V with and \
         without side by side; X cuts the tower open"
    );
    let census = world::populate(world, field, buildings, ());
    info!("{census}");
    // It waits until the camera is yours.
    world.insert_resource(Controls(controls));
}

/// What the camera has while it is yours.
#[derive(Resource)]
struct Controls(FreeCamera);

fn advance(time: Res<Time>, mut flight: ResMut<Flight>) {
    if flight.running {
        flight.share = (flight.share + time.delta_secs() / FLIGHT_S).fract();
    }
}

fn choose(world: &mut World) {
    let keys = world.resource::<ButtonInput<KeyCode>>();
    let pressed = |key| keys.just_pressed(key);
    let digits = [
        KeyCode::Digit1,
        KeyCode::Digit2,
        KeyCode::Digit3,
        KeyCode::Digit4,
        KeyCode::Digit5,
        KeyCode::Digit6,
        KeyCode::Digit0,
    ]
    .map(pressed);
    let [camera, space, view, open] =
        [KeyCode::KeyC, KeyCode::Space, KeyCode::KeyV, KeyCode::KeyX].map(pressed);
    let budget_ms = world.resource::<Target>().0;
    let mut switches = *world.resource::<Switches>();
    let [
        shadow,
        occlusion,
        contribution,
        interior,
        spherical,
        budget,
        all,
    ] = digits;
    switches.terrain_shadow ^= shadow;
    switches.occlusion ^= occlusion;
    switches.contribution ^= contribution;
    switches.interior ^= interior;
    switches.spherical ^= spherical;
    if budget {
        switches.budget_ms = switches.budget_ms.is_none().then_some(budget_ms);
    }
    if all {
        let on = Switches::all(Some(budget_ms));
        switches = if switches == on {
            Switches::SHADOW_ALONE
        } else {
            on
        };
    }
    if world.resource_mut::<Switches>().set_if_neq(switches) {
        info!("{switches:?}");
    }
    if space {
        world.resource_mut::<Flight>().running ^= true;
    }
    if camera {
        take_camera(world);
    }
    if view {
        split::toggle(world);
    }
    if open && world.remove_resource::<world::CutOpen>().is_none() {
        world.insert_resource(world::CutOpen);
    }
}

/// Gives the camera to the user, or back to the script.
fn take_camera(world: &mut World) {
    let mut flight = world.resource_mut::<Flight>();
    flight.scripted ^= true;
    let scripted = flight.scripted;
    let camera = world.resource::<Scenery>().camera;
    let controls = world.resource::<Controls>().0.clone();
    let mut camera = world.entity_mut(camera);
    if scripted {
        camera.remove::<FreeCamera>();
    } else {
        camera.insert(controls);
    }
}

/// Turns the sun about the vertical and raises it, for as long as keys are held; from then on it is yours.
fn turn_sun(
    time: Res<Time>,
    keys: Res<ButtonInput<KeyCode>>,
    mut flight: ResMut<Flight>,
    mut sun: ResMut<Sun>,
) {
    let held = |key| f32::from(u8::from(keys.pressed(key)));
    let turn = held(KeyCode::ArrowRight) - held(KeyCode::ArrowLeft);
    let rise = held(KeyCode::ArrowUp) - held(KeyCode::ArrowDown);
    if turn == 0.0 && rise == 0.0 {
        return;
    }
    flight.sun_scripted = false;
    let step = 0.3 * time.delta_secs();
    sun.azimuth += turn * step;
    sun.elevation = (sun.elevation + rise * step).clamp(-0.15, 1.5);
}

fn report(
    diagnostics: Res<DiagnosticsStore>,
    effects: Res<Effects>,
    split: Option<Res<Split>>,
    mut windows: Query<&mut Window, With<PrimaryWindow>>,
) {
    let frame = diagnostics.get(&FrameTimeDiagnosticsPlugin::FRAME_TIME);
    let Some(frame_ms) = frame.and_then(|diagnostic| diagnostic.smoothed()) else {
        return;
    };
    let title = match split {
        Some(split) => format!("Skyline · {}", split.times()),
        None => format!("Skyline · {frame_ms:.1} ms"),
    };
    info!("{title}");
    for (effect, state) in effects.iter() {
        debug!("{effect:?}: {state}");
    }
    for mut window in &mut windows {
        window.title.clone_from(&title);
    }
}
