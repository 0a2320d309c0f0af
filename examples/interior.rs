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

#[path = "interior/frame_times.rs"]
mod frame_times;
#[path = "interior/model.rs"]
mod model;
#[path = "interior/removed.rs"]
mod removed;
#[path = "common/stage.rs"]
mod stage;

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use bevy::{
    camera::ClearColorConfig, camera_controller::free_camera::FreeCamera, light::AmbientLight,
    prelude::*,
};
use bevy_skyline::prelude::*;
use model::ModelData;
use removed::{Original, Removed};
use stage::{Film, Stage, StageError, Status};

/// Where the command looks for a model of its own: beside the checkout.
const MODEL: &str = "../shared/data/cad/car_f40_ldraw.glb";
/// Triangles of the one made by code, and of a small one.
const TRIANGLES: [usize; 2] = [400_000, 20_000];
/// How long a result is waited for, at most.
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

/// Shows what interior culling takes out of a model, in a window or in pictures.
#[derive(clap::Args)]
struct Options {
    /// glTF binary; else a car of bricks beside this checkout, else a cabinet made by code.
    file: Option<PathBuf>,
    /// Cells on the model's longest side [default: 256; 64 with --small].
    #[arg(long, value_name = "N")]
    resolution: Option<u32>,
    /// Show a cabinet made by code with about so many triangles.
    #[arg(long, value_name = "N", conflicts_with = "file")]
    cabinet: Option<usize>,
    /// Draw no pictures: time the frames of a small scene before, while and after the model, out of view, is culled.
    #[arg(long)]
    frame_times: bool,
}

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
    stage::start(run)
}

fn run(mut stage: Stage, options: Options) -> Result<AppExit, StageError> {
    let is_small = stage.options.small;
    let own = Some(Path::new(MODEL)).filter(|path| !is_small && path.exists());
    let model = match (options.file.as_deref(), options.cabinet) {
        (None, Some(triangles)) => ModelData::cabinet(triangles),
        (file, _) => match file.or(own) {
            Some(path) => ModelData::read(path).map_err(StageError::input)?,
            None => ModelData::cabinet(TRIANGLES[usize::from(is_small)]),
        },
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
    let resolution = options
        .resolution
        .unwrap_or(if is_small { 64 } else { 256 });
    let settings = InteriorCulling {
        grid: InteriorGrid::Resolution(resolution),
        ..default()
    };
    stage.keys = "1 as it is, 2 culled, 3 what was removed, 4 cut open; N, M the grid, L nodes or triangles, P the mode";
    stage.effects = &[Effect::InteriorCulling];
    if options.frame_times {
        stage.options.headless = true;
        return stage.show(
            |_| {},
            |world| frame_times::populate(world, model),
            |film| frame_times::measure(film, settings),
        );
    }
    stage.show(
        |app| {
            app.add_systems(Update, choose)
                .add_systems(Last, (follow_result, describe).chain());
        },
        |world| {
            populate(world, model, settings);
            show(world, View::Culled);
        },
        draw,
    )
}

/// Fills an empty world.
fn populate(world: &mut World, model: ModelData, settings: InteriorCulling) {
    let bounds = model.bounds();
    let centre = 0.5 * (bounds[0] + bounds[1]);
    let radius = 0.5 * bounds[0].distance(bounds[1]);
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
    world.spawn((
        Camera3d::default(),
        Camera {
            clear_color: ClearColorConfig::Custom(Color::srgb(0.93, 0.94, 0.95)),
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
    ));
    world.insert_resource(Shown {
        root,
        parts,
        settings,
        view: View::Plain,
        removed: None,
    });
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
fn draw(film: &mut Film) -> Result<(), StageError> {
    let mut plain = None;
    for (view, name) in VIEWS {
        show(film.world(), view);
        if view == View::Culled {
            // Nothing is drawn meanwhile, which takes a CPU long.
            activate(film.world(), false);
            until_culled(film)?;
            activate(film.world(), true);
        }
        film.settle();
        film.time(name, |_, _| {});
        let picture = film.look()?;
        if view == View::Culled
            && let Some(plain) = &plain
        {
            let differing = stage::differing(plain, &picture);
            let all = picture.pixels().len();
            println!("  {differing} of {all} pixels differ from the plain picture");
        }
        film.write(name, &picture)?;
        plain.get_or_insert(picture);
    }
    Ok(())
}

/// Whether the camera draws.
fn activate(world: &mut World, is_active: bool) {
    for mut camera in world.query::<&mut Camera>().iter_mut(world) {
        camera.is_active = is_active;
    }
}

/// Steps until there is a result. Returns the times of the frames by what went on in them. units: ms
fn until_culled(film: &mut Film) -> Result<Vec<(String, Vec<f64>)>, StageError> {
    let start = Instant::now();
    let mut stages: Vec<(String, Vec<f64>)> = Vec::new();
    loop {
        let time_ms = film.step();
        let state = film.world().resource::<Effects>().interior().to_string();
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
            return Err(StageError::input(format!("nothing was culled: {state}")));
        }
    }
}

fn choose(world: &mut World) {
    let digit = stage::digit(world);
    let [coarser, finer, level, mode] = stage::pressed(
        world,
        [KeyCode::KeyN, KeyCode::KeyM, KeyCode::KeyL, KeyCode::KeyP],
    );
    let mut shown = world.resource_mut::<Shown>();
    let settings = &mut shown.settings;
    if let InteriorGrid::Resolution(cells) = &mut settings.grid {
        if coarser {
            *cells = (*cells / 2).max(16);
        }
        if finer {
            *cells = (*cells * 2).min(2048);
        }
    }
    if level {
        settings.level = stage::after(
            &[InteriorLevel::Node, InteriorLevel::Triangle],
            settings.level,
        );
    }
    if mode {
        settings.mode = stage::after(
            &[InteriorMode::Sampled, InteriorMode::Conservative],
            settings.mode,
        );
    }
    let view = digit.map_or(shown.view, |digit| VIEWS[digit].0);
    if digit.is_some() || coarser || finer || level || mode {
        show(world, view);
    }
}

fn describe(shown: Res<Shown>, mut status: ResMut<Status>) {
    let InteriorCulling {
        grid, level, mode, ..
    } = &shown.settings;
    status.0 = format!("{:?}, {grid:?}, {level:?}, {mode:?}", shown.view);
}
