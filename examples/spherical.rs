//! A detailed mesh, what of it is drawn, and the same on the map of directions (θ, φ), as in P3's figures.
//!
//! ```sh
//! cargo run --all-features --example spherical
//! cargo run --all-features --example spherical -- model.obj --chunk-triangles 128
//! cargo run --all-features --example spherical -- --headless --size 1440x480 --out pictures
//! ```
//!
//! On the left what the camera sees, in the middle the same mesh from the side with only the triangles that this camera
//! draws, on the right the map: bins with triangles grey, those that are drawn orange. In the window: W, A, S, D, E and Q
//! fly, the right mouse button looks around; P draws as the paper does or what can be seen, O draws all, N and M make
//! chunks smaller and larger.

#[path = "spherical/aside.rs"]
mod aside;
#[path = "common/stage.rs"]
mod stage;

use std::path::{Path, PathBuf};

use aside::{Aside, AsidePlugin, WIDE, lens, viewports};
use bevy::{camera::primitives::MeshAabb, camera_controller::free_camera::FreeCamera, prelude::*};
use bevy_skyline::{offline::scenes::bunnies, prelude::*};
use stage::{Film, Stage, StageError, Status};

/// Where the command looks for a model of its own: beside the checkout.
const MODEL: &str = "../shared/data/mesh/stanford_bunny.obj";
/// Triangles of the one made by code, and of a small one.
const TRIANGLES: [u32; 2] = [60_000, 6_000];
/// Frames that an index is waited for, at most.
const PATIENCE: u32 = 20_000;
const MODES: [SphericalMode; 2] = [SphericalMode::Conservative, SphericalMode::Paper];

/// Shows what a spherical index draws of a mesh, in a window or in pictures.
#[derive(clap::Args)]
struct Options {
    /// Triangle mesh (.obj); else Stanford's bunny beside this checkout, else a shape made by code.
    file: Option<PathBuf>,
    /// About how many triangles a chunk has.
    #[arg(long, value_name = "N", default_value_t = SphericalIndex::default().chunk_triangles)]
    chunk_triangles: u32,
}

/// What is shown.
#[derive(Resource)]
struct Shown {
    camera: Entity,
    model: Entity,
    settings: SphericalIndex,
    draws_all: bool,
}

fn main() -> AppExit {
    stage::start(run)
}

fn run(stage: Stage, options: Options) -> Result<AppExit, StageError> {
    let is_small = stage.options.small;
    let own = Some(Path::new(MODEL)).filter(|path| !is_small && path.exists());
    let mesh = match options.file.as_deref().or(own) {
        Some(path) => bunnies::whole_from_file(path).map_err(StageError::input)?,
        None => bunnies::bumpy_mesh(TRIANGLES[usize::from(is_small)]),
    };
    let settings = SphericalIndex {
        chunk_triangles: options.chunk_triangles,
        ..default()
    };
    let size = stage.options.size;
    let stage = Stage {
        keys: "P the paper's mode or the default, O all, N and M smaller and larger chunks",
        effects: &[Effect::SphericalIndex],
        ..stage
    };
    stage.show(
        |app| {
            app.add_plugins(AsidePlugin)
                .add_systems(Update, choose)
                .add_systems(Last, describe);
        },
        |world| populate(world, mesh, settings, size),
        draw,
    )
}

/// Fills an empty world.
fn populate(world: &mut World, mesh: Mesh, settings: SphericalIndex, size: UVec2) {
    let mesh = world.resource_mut::<Assets<Mesh>>().add(unit(mesh));
    let clay = aside::paint(world, Color::srgb(0.78, 0.68, 0.55));
    let model = world.spawn((Mesh3d(mesh), clay, settings)).id();
    let [left, ..] = viewports(size);
    let camera = world
        .spawn((
            Camera3d::default(),
            Camera {
                viewport: Some(left),
                clear_color: ClearColorConfig::Custom(Color::srgb(0.94, 0.95, 0.96)),
                ..default()
            },
            lens(WIDE, size),
            aside::ambient(),
            cases()[0].1,
            FreeCamera {
                walk_speed: 1.0,
                run_speed: 4.0,
                ..default()
            },
        ))
        .id();
    aside::spawn(world, Aside { camera, model }, size);
    world.insert_resource(Shown {
        camera,
        model,
        settings,
        draws_all: false,
    });
}

/// Around the origin, and about 2 m large.
fn unit(mesh: Mesh) -> Mesh {
    let Some(bounds) = mesh.compute_aabb() else {
        return mesh;
    };
    let size = 2.0 * bounds.half_extents.max_element();
    mesh.translated_by(-Vec3::from(bounds.center))
        .scaled_by(Vec3::splat(1.6 / size))
}

/// P3's cases: where the camera is, and the angle that it sees. units: rad
fn cases() -> [(&'static str, Transform, f32); 4] {
    let toward = |way: Vec3| {
        let way = way.normalize();
        let at = 0.55 * way;
        Transform::from_translation(2.4 * way).looking_at(at, way.any_orthonormal_vector())
    };
    let whole = Transform::from_xyz(0.6, 0.5, 2.6).looking_at(Vec3::ZERO, Vec3::Y);
    [
        ("whole", whole, WIDE),
        ("run", toward(Vec3::new(0.1, 1.0, 0.1)), 0.26),
        ("clump", toward(Vec3::new(-1.0, 0.1, -0.1)), 0.26),
        ("split", toward(Vec3::new(1.0, 0.1, 0.05)), 0.26),
    ]
}

/// A picture of each case in both modes.
fn draw(film: &mut Film) -> Result<(), StageError> {
    for mode in MODES {
        let world = film.world();
        let mut shown = world.resource_mut::<Shown>();
        shown.settings.mode = mode;
        let (camera, model, settings) = (shown.camera, shown.model, shown.settings);
        world.entity_mut(model).insert(settings);
        wait(film, model)?;
        for (name, place, angle) in cases() {
            let lens = lens(angle, film.options.size);
            film.world().entity_mut(camera).insert((place, lens));
            film.settle();
            let mode = format!("{mode:?}").to_lowercase();
            film.time(&format!("{name}, {mode}"), |_, _| {});
            film.picture(&format!("{name}_{mode}"))?;
        }
    }
    Ok(())
}

/// Until the mesh is indexed.
fn wait(film: &mut Film, model: Entity) -> Result<(), StageError> {
    film.step();
    for _ in 0..PATIENCE {
        film.step();
        let counts = film.world().get::<SphericalCounts>(model);
        if counts.is_some_and(|counts| counts.triangles > 0) {
            return Ok(());
        }
        std::thread::sleep(core::time::Duration::from_millis(1));
    }
    let state = film.world().resource::<Effects>().spherical().to_string();
    Err(StageError::input(format!(
        "the mesh was not indexed: {state}"
    )))
}

fn choose(world: &mut World) {
    let [mode, all, smaller, larger] = stage::pressed(
        world,
        [KeyCode::KeyP, KeyCode::KeyO, KeyCode::KeyN, KeyCode::KeyM],
    );
    if !(mode || all || smaller || larger) {
        return;
    }
    let mut shown = world.resource_mut::<Shown>();
    if mode {
        shown.settings.mode = stage::after(&MODES, shown.settings.mode);
    }
    shown.draws_all ^= all;
    let size = &mut shown.settings.chunk_triangles;
    if smaller {
        *size = (*size / 2).max(16);
    }
    if larger {
        *size = (*size * 2).min(1 << 16);
    }
    let (draws_all, settings) = (shown.draws_all, shown.settings);
    let model = shown.model;
    let mut model = world.entity_mut(model);
    if draws_all {
        model.remove::<SphericalIndex>();
    } else {
        model.insert(settings);
    }
}

fn describe(shown: Res<Shown>, counts: Query<&SphericalCounts>, mut status: ResMut<Status>) {
    let SphericalIndex {
        mode,
        chunk_triangles,
        ..
    } = shown.settings;
    status.0 = match counts.get(shown.model) {
        Ok(counts) => format!(
            "{mode:?}, chunks of {chunk_triangles}: {} of {} triangles in {} chunks",
            counts.drawn_triangles, counts.triangles, counts.drawn_chunks
        ),
        Err(_) => "everything is drawn".into(),
    };
}
