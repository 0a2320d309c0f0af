//! A model full of parts that nobody sees from outside, and what interior culling takes out of it.
//!
//! ```sh
//! cargo run --all-features --example interior
//! cargo run --all-features --example interior -- model.glb --resolution 512
//! cargo run --all-features --example interior -- --headless --out pictures
//! cargo run --all-features --example interior -- --frame-times --cabinet 3000000
//! ```
//!
//! In the window: W, A, S, D, E and Q fly, the right mouse button looks around; 1 shows the model as it is, 2 what of it
//! is drawn, 3 that in transparent blue with what was taken out in red, 4 both cut open; N and M make the grid coarser
//! and finer, L takes out whole nodes or triangles, P samples as the paper does or errs on the safe side.

#[path = "common/command_line.rs"]
mod command_line;
#[path = "common/glb_model.rs"]
mod glb_model;
#[path = "common/interior_options.rs"]
mod interior_options;
#[path = "common/removed.rs"]
mod removed;

use std::{
    path::Path,
    time::{Duration, Instant},
};

use bevy::{
    camera::RenderTarget,
    camera_controller::free_camera::{FreeCamera, FreeCameraPlugin},
    core_pipeline::tonemapping::DebandDither,
    light::AmbientLight,
    prelude::*,
    time::common_conditions::on_timer,
    window::PrimaryWindow,
};
use bevy_skyline::{offline::Offline, prelude::*};
use clap::Parser;
use command_line::{exit_with, has_display};
use glb_model::ModelData;
use interior_options::{InteriorExampleError, Options};
use removed::{Original, Removed};

/// Where the command looks for a model of its own: beside the checkout.
const MODEL: &str = "../shared/data/cad/car_f40_ldraw.glb";
/// Triangles of the one made by code.
const TRIANGLES: usize = 400_000;
/// Frames that are waited for a result, at most.
const PATIENCE: Duration = Duration::from_secs(1800);

/// What is shown.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum View {
    Plain,
    Culled,
    Removed,
    Cut,
}

const VIEWS: [(View, &str); 4] = [
    (View::Plain, "plain"),
    (View::Culled, "culled"),
    (View::Removed, "removed"),
    (View::Cut, "cut"),
];

/// The model and what is shown of it.
#[derive(Resource)]
struct Shown {
    root: Entity,
    parts: Vec<Original>,
    settings: InteriorCulling,
    view: View,
    /// Made of the last result.
    removed: Option<Removed>,
}

fn main() -> AppExit {
    let options = Options::parse();
    run(&options).unwrap_or_else(|error| {
        exit_with(
            "interior",
            &error,
            matches!(error, InteriorExampleError::Offline(_)),
        )
    })
}

fn run(options: &Options) -> Result<AppExit, InteriorExampleError> {
    let headless = options.headless || options.out.is_some() || options.frame_times;
    if !headless && !has_display() {
        return Err(InteriorExampleError::NoDisplay);
    }
    let model = match (&options.file, options.cabinet) {
        (Some(path), _) => ModelData::read(path)?,
        (None, Some(triangles)) => ModelData::cabinet(triangles),
        (None, None) if Path::new(MODEL).exists() => ModelData::read(Path::new(MODEL))?,
        (None, None) => ModelData::cabinet(TRIANGLES),
    };
    println!(
        "{}: {} nodes with meshes, {} triangles",
        model.name,
        model
            .nodes
            .iter()
            .filter(|node| node.drawn.is_some())
            .count(),
        model.triangles()
    );
    let settings = InteriorCulling {
        grid: Grid::Resolution(options.resolution),
        ..default()
    };
    if options.frame_times {
        time_frames(options, model, settings)?;
    } else if headless {
        draw(options, model, settings)?;
    } else {
        return Ok(fly(options, model, settings));
    }
    Ok(AppExit::Success)
}

/// Fills an empty world. Returns the entities that stand for what is shown.
fn populate(
    world: &mut World,
    model: ModelData,
    settings: InteriorCulling,
    target: Option<&Handle<Image>>,
) {
    let bounds = bounds(&model);
    let (centre, radius) = (
        0.5 * (bounds[0] + bounds[1]),
        0.5 * bounds[0].distance(bounds[1]),
    );
    let (root, entities) = model.spawn(world);
    let parts = entities
        .into_iter()
        .filter_map(|entity| Original::of(world, entity))
        .collect();
    world.spawn((
        DirectionalLight {
            illuminance: 8_000.0,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-0.5, -1.0, -0.7), Vec3::Y),
    ));
    let camera = world
        .spawn((
            Camera3d::default(),
            Camera {
                clear_color: bevy::camera::ClearColorConfig::Custom(Color::srgb(0.93, 0.94, 0.95)),
                ..default()
            },
            Projection::Perspective(PerspectiveProjection {
                near: 0.01 * radius,
                far: 20.0 * radius,
                fov: 0.6,
                ..default()
            }),
            Transform::from_translation(centre + radius * Vec3::new(1.7, 1.2, 2.4))
                .looking_at(centre, Vec3::Y),
            AmbientLight {
                brightness: 700.0,
                ..default()
            },
            FreeCamera {
                walk_speed: radius,
                run_speed: 4.0 * radius,
                ..default()
            },
        ))
        .id();
    if let Some(target) = target {
        // Noise would make the picture's file four times as large, and no two pictures the same.
        world.entity_mut(camera).insert((
            RenderTarget::Image(target.clone().into()),
            DebandDither::Disabled,
        ));
    }
    world.insert_resource(Shown {
        root,
        parts,
        settings,
        view: View::Plain,
        removed: None,
    });
}

/// Lowest and highest corner.
fn bounds(model: &ModelData) -> [Vec3; 2] {
    let mut places: Vec<Mat4> = Vec::new();
    let mut bounds = [Vec3::INFINITY, Vec3::NEG_INFINITY];
    for node in &model.nodes {
        let above = node.above.and_then(|above| places.get(above).copied());
        let place = above.unwrap_or(Mat4::IDENTITY) * node.place.to_matrix();
        places.push(place);
        let mesh = node.drawn.and_then(|(mesh, _)| model.meshes.get(mesh));
        for at in mesh.into_iter().flat_map(removed::positions) {
            let at = place.transform_point3(Vec3::from(*at));
            bounds = [bounds[0].min(at), bounds[1].max(at)];
        }
    }
    bounds
}

/// Shows something else from the next frame on.
fn show(world: &mut World, view: View) {
    world.resource_scope(|world, mut shown: Mut<Shown>| {
        shown.view = view;
        let settings = shown.settings.clone();
        let mut root = world.entity_mut(shown.root);
        if view == View::Plain {
            root.remove::<InteriorCulling>();
        } else if root.get::<InteriorCulling>() != Some(&settings) {
            root.insert(settings);
        }
        let is_seen = matches!(view, View::Plain | View::Culled);
        root.insert(if is_seen {
            Visibility::Inherited
        } else {
            Visibility::Hidden
        });
        if view == View::Plain
            && let Some(removed) = shown.removed.take()
        {
            removed.despawn(world);
        }
        if let Some(removed) = &shown.removed {
            removed.show(world, view == View::Removed, view == View::Cut);
        }
    });
}

/// Makes what stands for visible and removed parts, once there is a result, and lets go of it when that is undone.
fn follow_result(world: &mut World) {
    world.resource_scope(|world, mut shown: Mut<Shown>| {
        let is_done = world.get::<InteriorCounts>(shown.root).is_some();
        if is_done && shown.removed.is_none() {
            let removed = Removed::spawn(world, &shown.parts);
            removed.show(world, shown.view == View::Removed, shown.view == View::Cut);
            shown.removed = Some(removed);
        } else if !is_done && let Some(removed) = shown.removed.take() {
            removed.despawn(world);
        }
    });
}

/// A picture of each view, and whether culling changed any pixel.
fn draw(
    options: &Options,
    model: ModelData,
    settings: InteriorCulling,
) -> Result<(), InteriorExampleError> {
    let mut offline = Offline::with(|app| {
        app.add_systems(Last, follow_result.run_if(resource_exists::<Shown>));
    })?;
    let limit = offline.max_image_side();
    if options.size.max_element() > limit {
        return Err(InteriorExampleError::TooLarge(
            options.size.x,
            options.size.y,
            limit,
        ));
    }
    let target = offline.target(options.size);
    populate(offline.app.world_mut(), model, settings, Some(&target));
    let folder = options.out.clone().unwrap_or_else(|| ".".into());
    std::fs::create_dir_all(&folder).map_err(|error| {
        InteriorExampleError::Write(folder.display().to_string(), error.to_string())
    })?;
    let mut plain = None;
    for (view, name) in VIEWS {
        show(offline.app.world_mut(), view);
        if view == View::Culled {
            // Nothing is drawn meanwhile, which takes a CPU long.
            activate(&mut offline, false);
            until_culled(&mut offline)?;
            activate(&mut offline, true);
        }
        for _ in 0..4 {
            offline.step();
        }
        let mut times_ms: Vec<f64> = (0..options.frames).map(|_| timed(&mut offline)).collect();
        println!("{name}: {}", Times::of(&mut times_ms));
        let picture = offline.picture(&target)?;
        match (view, &plain) {
            (View::Plain, _) => plain = Some(picture.clone()),
            (View::Culled, Some(plain)) => {
                let differing = plain
                    .pixels()
                    .zip(picture.pixels())
                    .filter(|(a, b)| a != b)
                    .count();
                println!(
                    "  {differing} of {} pixels differ from the plain picture",
                    plain.pixels().len()
                );
            }
            _ => {}
        }
        let path = folder.join(format!("interior_{name}.png"));
        image::DynamicImage::ImageRgba8(picture)
            .into_rgb8()
            .save(&path)
            .map_err(|error| {
                InteriorExampleError::Write(path.display().to_string(), error.to_string())
            })?;
        println!("  {}", std::path::absolute(&path).unwrap_or(path).display());
    }
    println!("adapter: {}", offline.adapter());
    Ok(())
}

/// Whether the camera draws.
fn activate(offline: &mut Offline, is_active: bool) {
    let world = offline.app.world_mut();
    for mut camera in world.query::<&mut Camera>().iter_mut(world) {
        camera.is_active = is_active;
    }
}

fn timed(offline: &mut Offline) -> f64 {
    let start = Instant::now();
    offline.step();
    start.elapsed().as_secs_f64() * 1e3
}

/// Steps until there is a result. Returns the times of the frames by what went on in them. units: ms
fn until_culled(offline: &mut Offline) -> Result<Vec<(String, Vec<f64>)>, InteriorExampleError> {
    let start = Instant::now();
    let mut stages: Vec<(String, Vec<f64>)> = Vec::new();
    loop {
        let time_ms = timed(offline);
        let state = offline
            .app
            .world()
            .resource::<Effects>()
            .interior()
            .to_string();
        let stage = state.split(',').next().unwrap_or_default();
        if state.contains("are hidden") {
            return Ok(stages);
        }
        match stages.last_mut() {
            Some((last, times_ms)) if last == stage => times_ms.push(time_ms),
            _ => {
                println!("  {:.1} s: {state}", start.elapsed().as_secs_f64());
                stages.push((stage.to_owned(), vec![time_ms]));
            }
        }
        if start.elapsed() > PATIENCE {
            return Err(InteriorExampleError::NotCulled(state));
        }
    }
}

/// Frames of a small scene, while the model, out of the camera's view, is culled in the background.
fn time_frames(
    options: &Options,
    model: ModelData,
    settings: InteriorCulling,
) -> Result<(), InteriorExampleError> {
    let mut offline = Offline::new()?;
    let target = offline.target(options.size);
    offline.camera(
        &target,
        (
            Msaa::Off,
            Transform::from_xyz(0.0, 6.0, 18.0).looking_at(Vec3::ZERO, Vec3::Y),
        ),
    );
    let world = offline.app.world_mut();
    world.spawn((
        DirectionalLight::default(),
        Transform::default().looking_to(Vec3::new(-1.0, -2.0, -1.5), Vec3::Y),
    ));
    let cube = world
        .resource_mut::<Assets<Mesh>>()
        .add(Cuboid::from_length(1.0));
    let paint = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial::default());
    for i in 0..100 {
        let place = Vec3::new((i % 10) as f32 - 4.5, 0.0, (i / 10) as f32 - 4.5) * 1.6;
        world.spawn((
            Mesh3d(cube.clone()),
            MeshMaterial3d(paint.clone()),
            Transform::from_translation(place),
        ));
    }
    let (root, _) = model.spawn(world);
    world
        .entity_mut(root)
        .insert(Transform::from_xyz(0.0, 0.0, 10_000.0));
    for _ in 0..20 {
        offline.step();
    }
    let report =
        |name: &str, mut times_ms: Vec<f64>| println!("{name}: {}", Times::of(&mut times_ms));
    let some = |offline: &mut Offline| {
        (0..options.frames)
            .map(|_| timed(offline))
            .collect::<Vec<_>>()
    };
    report("before", some(&mut offline));
    offline.app.world_mut().entity_mut(root).insert(settings);
    let start = Instant::now();
    let stages = until_culled(&mut offline)?;
    println!("culled after {:.1} s", start.elapsed().as_secs_f64());
    for (stage, times_ms) in &stages {
        report(&format!("  while {stage}"), times_ms.clone());
    }
    report(
        "while",
        stages
            .into_iter()
            .flat_map(|(_, times_ms)| times_ms)
            .collect(),
    );
    report("after", some(&mut offline));
    println!("{}", offline.app.world().resource::<Effects>().interior());
    offline
        .app
        .world_mut()
        .entity_mut(root)
        .remove::<InteriorCulling>();
    report("the frame of its removal", vec![timed(&mut offline)]);
    println!("adapter: {}", offline.adapter());
    Ok(())
}

/// Frame times in words. units: ms
struct Times {
    median: f64,
    p99: f64,
    max: f64,
    count: usize,
}

impl Times {
    fn of(times_ms: &mut [f64]) -> Self {
        times_ms.sort_by(f64::total_cmp);
        let at = |part: f64| {
            let last = times_ms.len().saturating_sub(1);
            times_ms
                .get((part * last as f64).round() as usize)
                .copied()
                .unwrap_or(f64::NAN)
        };
        Self {
            median: at(0.5),
            p99: at(0.99),
            max: at(1.0),
            count: times_ms.len(),
        }
    }
}

impl core::fmt::Display for Times {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self {
            median,
            p99,
            max,
            count,
        } = self;
        write!(
            f,
            "median {median:.2} ms, 99th percentile {p99:.2} ms, max {max:.2} ms, {count} frames"
        )
    }
}

/// The model before the window's world is there.
#[derive(Resource)]
struct Start(ModelData, InteriorCulling);

/// A window with a flying camera.
fn fly(options: &Options, model: ModelData, settings: InteriorCulling) -> AppExit {
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
    ));
    #[cfg(feature = "panel")]
    app.add_plugins(bevy_skyline::panel::PanelPlugin);
    app.insert_resource(Start(model, settings))
        .add_systems(Startup, start)
        .add_systems(
            Update,
            (
                choose.run_if(resource_exists::<Shown>),
                report.run_if(on_timer(Duration::from_millis(250))),
            ),
        )
        .add_systems(Last, follow_result.run_if(resource_exists::<Shown>))
        .run()
}

fn start(world: &mut World) {
    if let Some(Start(model, settings)) = world.remove_resource() {
        info!(
            "1 as it is, 2 culled, 3 what was removed, 4 cut open; N, M the grid, L nodes or triangles, P the mode"
        );
        populate(world, model, settings, None);
        show(world, View::Culled);
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
    let [coarser, finer, level, mode] =
        [KeyCode::KeyN, KeyCode::KeyM, KeyCode::KeyL, KeyCode::KeyP]
            .map(|key| keys.just_pressed(key));
    let mut shown = world.resource_mut::<Shown>();
    let settings = &mut shown.settings;
    if let Grid::Resolution(cells) = &mut settings.grid {
        if coarser {
            *cells = (*cells / 2).max(16);
        }
        if finer {
            *cells = (*cells * 2).min(2048);
        }
    }
    if level {
        settings.level = match settings.level {
            Level::Node => Level::Triangle,
            Level::Triangle => Level::Node,
        };
    }
    if mode {
        settings.mode = match settings.mode {
            Mode::Sampled => Mode::Conservative,
            Mode::Conservative => Mode::Sampled,
        };
    }
    let view = digit.map_or(shown.view, |digit| VIEWS[digit].0);
    if digit.is_some() || coarser || finer || level || mode {
        show(world, view);
    }
}

fn report(
    shown: Option<Res<Shown>>,
    effects: Res<Effects>,
    mut windows: Query<&mut Window, With<PrimaryWindow>>,
) {
    if let Some(shown) = shown {
        let grid = shown.settings.grid;
        for mut window in &mut windows {
            window.title = format!(
                "Skyline · {:?} · {grid:?} · {}",
                shown.view,
                effects.interior()
            );
        }
    }
}
