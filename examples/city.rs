//! A dense city in which most is hidden, and four ways to leave out what is: none, what is out of view, Bevy's
//! occlusion culling, ours.
//!
//! ```sh
//! cargo run --all-features --example city
//! cargo run --all-features --example city -- city.glb
//! cargo run --all-features --example city -- --headless --out picture.png
//! ```
//!
//! In the window: W, A, S, D, E and Q fly, Shift flies faster, the right mouse button looks around, the wheel sets
//! the speed; 1 to 4 choose what is left out, V what stands for an object, B how depth is read, P whether a depth
//! prepass comes before ours; O shows from above what the camera draws (green), what is hidden from it (red) and what
//! is out of its view (grey). With feature `panel`, F3 opens the panel.

#[path = "common/city_options.rs"]
mod city_options;
#[path = "common/command_line.rs"]
mod command_line;
#[path = "common/overview.rs"]
mod overview;

use std::time::{Duration, Instant};

use bevy::{
    camera::{ClearColorConfig, RenderTarget, visibility::NoFrustumCulling},
    camera_controller::free_camera::{FreeCamera, FreeCameraPlugin},
    core_pipeline::{prepass::DepthPrepass, tonemapping::DebandDither},
    diagnostic::{DiagnosticsStore, FrameTimeDiagnosticsPlugin},
    light::AmbientLight,
    prelude::*,
    render::occlusion_culling::OcclusionCulling,
    time::common_conditions::on_timer,
    window::PrimaryWindow,
};
use bevy_skyline::{
    occlusion::{OccludeeVolume, Sampling, ZBufferOcclusion},
    offline::{
        Offline,
        scenes::{
            CameraPath, Look, Scene,
            city::{self, CitySize},
        },
    },
    prelude::*,
};
use city_options::{CityError, Options};
use clap::Parser;
use command_line::{exit_with, has_display};
use overview::{Overview, OverviewPlugin, Tally};

/// What is left out.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Way {
    None,
    Frustum,
    Bevy,
    Ours,
}

const WAYS: [(Way, &str); 4] = [
    (Way::None, "none"),
    (Way::Frustum, "frustum"),
    (Way::Bevy, "frustum + Bevy's occlusion culling"),
    (Way::Ours, "frustum + Z-buffer occlusion"),
];
const VOLUMES: [OccludeeVolume; 3] = [
    OccludeeVolume::Aabb,
    OccludeeVolume::Obb,
    OccludeeVolume::Proxy { triangles: 100 },
];
const SAMPLINGS: [Sampling; 6] = [
    Sampling::Conservative { block: 0 },
    Sampling::Conservative { block: 2 },
    Sampling::Conservative { block: 4 },
    Sampling::Conservative { block: 8 },
    Sampling::Conservative { block: 16 },
    Sampling::Strided { x: 5, y: 4 },
];

/// Where the headless walk begins: not at the city's edge. units: frames of the path
const FIRST_STEP: u32 = 6_000;

/// The city and how it is culled.
#[derive(Resource)]
struct City {
    scene: Scene,
    entities: Vec<Entity>,
    camera: Entity,
    way: Way,
    /// Whether a depth prepass comes before ours.
    prepass: bool,
    settings: ZBufferOcclusion,
    /// Frames shown so far, which everything that moves follows.
    frame: u32,
}

fn main() -> AppExit {
    let options = Options::parse();
    run(&options)
        .unwrap_or_else(|error| exit_with("city", &error, matches!(error, CityError::Offline(_))))
}

fn run(options: &Options) -> Result<AppExit, CityError> {
    let headless = options.headless || options.out.is_some();
    if !headless && !has_display() {
        return Err(CityError::NoDisplay);
    }
    let scene = match &options.file {
        Some(path) => city::from_file(path)?,
        None => city::generated(CitySize::Full),
    };
    println!(
        "{}: {} objects, {} triangles",
        scene.name,
        scene.objects.len(),
        scene.triangles()
    );
    if headless {
        draw(options, scene)?;
        return Ok(AppExit::Success);
    }
    Ok(fly(options, scene))
}

/// Fills an empty world; without a target the window is drawn to.
fn populate(world: &mut World, scene: Scene, target: Option<&Handle<Image>>, size: UVec2) {
    let entities = scene.spawn(world, Look::Shaded);
    let haze = Color::linear_rgb(0.55, 0.68, 0.85);
    let camera = world
        .spawn((
            Camera3d::default(),
            Camera {
                clear_color: ClearColorConfig::Custom(haze),
                ..default()
            },
            Projection::Perspective(scene.projection()),
            Msaa::Off,
            scene.view("street"),
            AmbientLight {
                brightness: 900.0,
                ..default()
            },
            FreeCamera {
                walk_speed: 20.0,
                run_speed: 150.0,
                friction: 8.0,
                ..default()
            },
        ))
        .id();
    overview::spawn(world, &scene, &entities, camera, size);
    if let Some(target) = target {
        let mut cameras = world.query_filtered::<Entity, With<Camera3d>>();
        let cameras: Vec<Entity> = cameras.iter(world).collect();
        for camera in cameras {
            world
                .entity_mut(camera)
                .insert(RenderTarget::Image(target.clone().into()));
        }
    }
    world.insert_resource(City {
        scene,
        entities,
        camera,
        way: Way::Frustum,
        prepass: false,
        settings: ZBufferOcclusion::default(),
        frame: 0,
    });
    cull(world, Way::Ours);
}

/// Leaves out what is asked for from the next frame on.
fn cull(world: &mut World, way: Way) {
    world.resource_scope(|world, mut city: Mut<City>| {
        let none = way == Way::None;
        if none != (city.way == Way::None) {
            for &entity in &city.entities {
                let mut entity = world.entity_mut(entity);
                if none {
                    entity.insert(NoFrustumCulling);
                } else {
                    entity.remove::<NoFrustumCulling>();
                }
            }
        }
        city.way = way;
        let mut camera = world.entity_mut(city.camera);
        camera.remove::<(OcclusionCulling, DepthPrepass, ZBufferOcclusion)>();
        match way {
            Way::None | Way::Frustum => {}
            Way::Bevy => {
                camera.insert((DepthPrepass, OcclusionCulling));
            }
            Way::Ours => {
                camera.insert(city.settings.clone());
                if city.prepass {
                    camera.insert(DepthPrepass);
                }
            }
        }
    });
}

/// What moves follows the frames.
fn drive(world: &mut World) {
    world.resource_scope(|world, mut city: Mut<City>| {
        city.frame = city.frame.wrapping_add(1);
        city.scene.place(world, &city.entities, city.frame);
    });
}

/// A line of what is drawn and why not the rest, and of what occlusion culling does.
fn line(city: &City, tally: &Tally, effects: &Effects) -> String {
    let name = WAYS
        .iter()
        .find(|(way, _)| *way == city.way)
        .map_or("", |(_, name)| name);
    let settings = match city.way {
        Way::Ours => format!(
            " ({:?}, {:?}{})",
            city.settings.volume,
            city.settings.sampling,
            if city.prepass { ", depth prepass" } else { "" }
        ),
        Way::Bevy => " (what it removes only the GPU knows)".into(),
        _ => String::new(),
    };
    format!(
        "{name}{settings}: {} drawn, {} hidden, {} out of view of {}; Z-buffer occlusion {}",
        tally.drawn,
        tally.hidden,
        tally.out_of_view,
        city.entities.len(),
        effects.occlusion()
    )
}

/// A few steps through the streets in each way to cull, and a picture of the last.
fn draw(options: &Options, scene: Scene) -> Result<(), CityError> {
    let mut offline = Offline::with(|app| {
        app.add_plugins(OverviewPlugin).add_systems(Update, drive);
    })?;
    let limit = offline.max_image_side();
    if options.size.max_element() > limit {
        return Err(CityError::TooLarge(options.size.x, options.size.y, limit));
    }
    let target = offline.target(options.size);
    populate(offline.app.world_mut(), scene, Some(&target), options.size);
    let world = offline.app.world_mut();
    show_overview(world, |_| false);
    if let Some(camera) = world.get_resource::<City>().map(|city| city.camera) {
        // Noise would make the picture's file four times as large.
        world.entity_mut(camera).insert(DebandDither::Disabled);
    }
    for (way, name) in WAYS {
        cull(offline.app.world_mut(), way);
        offline.app.world_mut().resource_mut::<City>().frame = 0;
        let mut times_ms = Vec::new();
        // Some frames until the change has reached everything.
        for frame in 0..options.frames + 4 {
            let world = offline.app.world_mut();
            world.resource_scope(|world, city: Mut<City>| {
                let place = CameraPath::Walk.at(&city.scene, FIRST_STEP + frame);
                world.entity_mut(city.camera).insert(place);
            });
            let start = Instant::now();
            offline.step();
            if frame >= 4 {
                times_ms.push(start.elapsed().as_secs_f64() * 1e3);
            }
        }
        times_ms.sort_by(f64::total_cmp);
        println!(
            "{name}: median {:.1} ms, min {:.1} ms, max {:.1} ms ({} frames of {}x{})",
            times_ms[times_ms.len() / 2],
            times_ms[0],
            times_ms[times_ms.len() - 1],
            times_ms.len(),
            options.size.x,
            options.size.y
        );
        let world = offline.app.world();
        if let (Some(city), Some(tally), Some(effects)) = (
            world.get_resource::<City>(),
            world.get_resource::<Tally>(),
            world.get_resource::<Effects>(),
        ) {
            println!("  {}", line(city, tally, effects));
        }
    }
    show_overview(offline.app.world_mut(), |_| true);
    for _ in 0..3 {
        offline.step();
    }
    let path = options.out.clone().unwrap_or_else(|| "city.png".into());
    let mut picture = image::DynamicImage::ImageRgba8(offline.picture(&target)?).into_rgb8();
    if let Some(tally) = offline.app.world().get_resource::<Tally>() {
        overview::legend(&mut picture, tally);
    }
    picture
        .save_with_format(&path, image::ImageFormat::Png)
        .map_err(|source| CityError::Write {
            path: path.clone(),
            source,
        })?;
    let path = std::path::absolute(&path).unwrap_or(path);
    println!("{}", path.display());
    println!("adapter: {}", offline.adapter());
    Ok(())
}

/// The city before the window's world is there.
#[derive(Resource)]
struct Start(Scene, UVec2);

/// A window with a flying camera.
fn fly(options: &Options, scene: Scene) -> AppExit {
    let window = Window {
        title: "Skyline".into(),
        resolution: (options.size.x, options.size.y).into(),
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
        OverviewPlugin,
    ));
    #[cfg(feature = "panel")]
    app.add_plugins(bevy_skyline::panel::PanelPlugin);
    app.insert_resource(Start(scene, options.size))
        .add_systems(Startup, start)
        .add_systems(
            Update,
            (
                drive.run_if(resource_exists::<City>),
                choose.run_if(resource_exists::<City>),
                report.run_if(on_timer(Duration::from_secs(1))),
            ),
        )
        .run()
}

fn start(world: &mut World) {
    if let Some(Start(scene, size)) = world.remove_resource() {
        info!(
            "1 none, 2 frustum, 3 Bevy's, 4 ours; V the volume, B the sampling, P a depth prepass before ours, \
             O the overview: green drawn, red hidden, grey out of view"
        );
        populate(world, scene, None, size);
    }
}

fn choose(world: &mut World) {
    let keys = world.resource::<ButtonInput<KeyCode>>();
    let digits = [
        KeyCode::Digit1,
        KeyCode::Digit2,
        KeyCode::Digit3,
        KeyCode::Digit4,
    ];
    let digit = digits.iter().position(|key| keys.just_pressed(*key));
    let [volume, sampling, prepass, above] =
        [KeyCode::KeyV, KeyCode::KeyB, KeyCode::KeyP, KeyCode::KeyO]
            .map(|key| keys.just_pressed(key));
    let mut city = world.resource_mut::<City>();
    if volume {
        city.settings.volume = after(&VOLUMES, city.settings.volume);
    }
    if sampling {
        city.settings.sampling = after(&SAMPLINGS, city.settings.sampling);
    }
    city.prepass ^= prepass;
    let asked = digit
        .map(|digit| WAYS[digit].0)
        .or((volume || sampling || prepass).then_some(city.way));
    if let Some(way) = asked {
        cull(world, way);
    }
    if above {
        show_overview(world, |shown| !shown);
    }
}

/// Whether the city is shown from above too, as a function of whether it was.
fn show_overview(world: &mut World, show: impl Fn(bool) -> bool) {
    let mut cameras = world.query_filtered::<&mut Camera, With<Overview>>();
    for mut camera in cameras.iter_mut(world) {
        camera.is_active = show(camera.is_active);
    }
}

/// The one after `value`, round and round.
fn after<T: Copy + PartialEq>(all: &[T], value: T) -> T {
    let at = all.iter().position(|other| *other == value);
    at.map_or(value, |at| all[(at + 1) % all.len()])
}

fn report(
    diagnostics: Res<DiagnosticsStore>,
    city: Option<Res<City>>,
    tally: Res<Tally>,
    effects: Res<Effects>,
    mut windows: Query<&mut Window, With<PrimaryWindow>>,
) {
    let frame = diagnostics.get(&FrameTimeDiagnosticsPlugin::FRAME_TIME);
    let (Some(frame_ms), Some(city)) = (frame.and_then(|d| d.smoothed()), city) else {
        return;
    };
    let line = line(&city, &tally, &effects);
    info!("frame {frame_ms:.1} ms; {line}");
    for mut window in &mut windows {
        window.title = format!("Skyline · {frame_ms:.1} ms · {line}");
    }
}
