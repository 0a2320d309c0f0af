//! The flight in a window: the camera's own way or yours, every effect on a key, and both pictures side by side.

use bevy::{camera_controller::free_camera::FreeCamera, prelude::*};

use super::{
    path::FLIGHT_S,
    sky::{self, Sun},
    split::{self, Split},
    stage::{Status, pressed},
    world::{self, Flight, Scenery, Switches},
};

/// What the budget's key gives back. units: ms
#[derive(Resource)]
struct Target(f32);

/// Adds what goes by the script, and in a window the keys.
pub fn build(app: &mut App, target_ms: Option<f32>, headless: bool) {
    let target_ms = target_ms.unwrap_or(1_000.0 / 60.0);
    app.insert_resource(Target(target_ms))
        .insert_resource(Switches::all((!headless).then_some(target_ms)))
        .insert_resource(Flight {
            running: !headless,
            ..Flight::start()
        })
        .add_systems(
            Update,
            (
                (choose, turn_sun, advance)
                    .chain()
                    .run_if(move || !headless),
                world::switch,
                world::follow_script,
                world::cut_open,
                sky::follow_sun,
                split::follow,
                describe,
            )
                .chain()
                .run_if(resource_exists::<Scenery>),
        );
}

fn advance(time: Res<Time>, mut flight: ResMut<Flight>) {
    if flight.running {
        flight.share = (flight.share + time.delta_secs() / FLIGHT_S).fract();
    }
}

fn choose(world: &mut World) {
    let digits = pressed(
        world,
        [
            KeyCode::Digit1,
            KeyCode::Digit2,
            KeyCode::Digit3,
            KeyCode::Digit4,
            KeyCode::Digit5,
            KeyCode::Digit6,
            KeyCode::Digit0,
        ],
    );
    let keys = [KeyCode::KeyC, KeyCode::Space, KeyCode::KeyV, KeyCode::KeyX];
    let [camera, space, view, open] = pressed(world, keys);
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
    let mut camera = world.entity_mut(camera);
    if scripted {
        camera.remove::<FreeCamera>();
    } else {
        camera.insert(FreeCamera {
            walk_speed: 60.0,
            run_speed: 400.0,
            friction: 8.0,
            ..default()
        });
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

fn describe(split: Option<Res<Split>>, mut status: ResMut<Status>) {
    let text = split.map(|split| split.times()).unwrap_or_default();
    if status.0 != text {
        status.0 = text;
    }
}
