//! A detailed mesh, what of it is drawn, and the same on the map of directions (θ, φ), as in P3's figures.
//!
//! ```sh
//! cargo run --all-features --example bunny
//! cargo run --all-features --example bunny -- model.obj --chunk-triangles 128
//! cargo run --all-features --example bunny -- --headless --out pictures
//! ```
//!
//! On the left what the camera sees, in the middle the same mesh from the side with only the triangles that this camera
//! draws, on the right the map: bins with triangles grey, those that are drawn orange. In the window: W, A, S, D, E and Q
//! fly, the right mouse button looks around; P draws as the paper does or what can be seen, O draws all, N and M make
//! chunks smaller and larger.

#[path = "common/command_line.rs"]
mod command_line;

use std::path::PathBuf;

use bevy::{
    asset::RenderAssetUsages,
    camera::{
        RenderTarget, Viewport,
        primitives::MeshAabb,
        visibility::{RenderLayers, VisibleEntities},
    },
    camera_controller::free_camera::{FreeCamera, FreeCameraPlugin},
    core_pipeline::tonemapping::{DebandDither, Tonemapping},
    image::ImageSampler,
    light::AmbientLight,
    prelude::*,
    render::render_resource::{Extent3d, TextureDimension, TextureFormat},
};
use bevy_skyline::{
    offline::{
        Offline, OfflineError,
        scenes::{SceneError, bunnies},
    },
    prelude::*,
    systems::spherical::models::{SphericalModels, ViewedBins},
};
use clap::Parser;
use command_line::{exit_with, has_display, size};

/// Where the command looks for a model of its own: beside the checkout.
const MODEL: &str = "../shared/data/mesh/stanford_bunny.obj";
/// The side view and the map: what no other camera sees.
const ASIDE: RenderLayers = RenderLayers::layer(1);
const MAP: RenderLayers = RenderLayers::layer(2);
/// Frames that an index is waited for, at most.
const PATIENCE: u32 = 20_000;

/// Shows what a spherical index draws of a mesh, in a window or in pictures.
#[derive(Parser)]
#[command(name = "bunny")]
struct Options {
    /// Triangle mesh (.obj); else Stanford's bunny beside this checkout, else a shape made by code.
    file: Option<PathBuf>,
    /// Open no window: write pictures.
    #[arg(long)]
    headless: bool,
    /// Folder to write the pictures to; implies --headless [default: .].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Pixels of the pictures or the window.
    #[arg(long, value_name = "WxH", default_value = "1440x480", value_parser = size)]
    size: UVec2,
    /// About how many triangles a chunk has.
    #[arg(long, value_name = "N", default_value_t = SphericalIndex::default().chunk_triangles)]
    chunk_triangles: u32,
}

/// Why there is nothing to see; says itself in one line.
#[derive(thiserror::Error, Debug)]
enum BunnyError {
    #[error(transparent)]
    Model(#[from] SceneError),
    #[error("there is no display to open a window on: use --headless")]
    NoDisplay,
    #[error(transparent)]
    Offline(#[from] OfflineError),
    #[error("the mesh was not indexed: {0}")]
    NotIndexed(String),
    #[error("cannot write {0}: {1}")]
    Write(String, String),
}

/// What is shown.
#[derive(Resource)]
struct Shown {
    camera: Entity,
    model: Entity,
    /// The drawn triangles, from the side.
    aside: Entity,
    map: Handle<Image>,
    board: Handle<StandardMaterial>,
    settings: SphericalIndex,
    draws_all: bool,
    size: UVec2,
    /// What the aside shows.
    bins: Option<ViewedBins>,
}

fn main() -> AppExit {
    let options = Options::parse();
    run(&options)
        .unwrap_or_else(|error| exit_with("bunny", &error, matches!(error, BunnyError::Offline(_))))
}

fn run(options: &Options) -> Result<AppExit, BunnyError> {
    let file = options
        .file
        .clone()
        .or_else(|| Some(PathBuf::from(MODEL)).filter(|path| path.exists()));
    let mesh = match &file {
        Some(path) => bunnies::whole_from_file(path)?,
        None => bunnies::bumpy_mesh(60_000),
    };
    if options.headless || options.out.is_some() {
        draw(options, mesh)?;
        return Ok(AppExit::Success);
    }
    if !has_display() {
        return Err(BunnyError::NoDisplay);
    }
    Ok(fly(options, mesh))
}

/// Fills an empty world.
fn populate(world: &mut World, mesh: Mesh, options: &Options, target: Option<&Handle<Image>>) {
    let settings = SphericalIndex {
        chunk_triangles: options.chunk_triangles,
        ..default()
    };
    let mesh = world.resource_mut::<Assets<Mesh>>().add(unit(mesh));
    let paint = |world: &mut World, colour: Color| {
        let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
        MeshMaterial3d(materials.add(StandardMaterial {
            base_color: colour,
            perceptual_roughness: 0.9,
            ..default()
        }))
    };
    let clay = paint(world, Color::srgb(0.78, 0.68, 0.55));
    let orange = paint(world, Color::srgb(0.93, 0.55, 0.18));
    let model = world.spawn((Mesh3d(mesh), clay, settings)).id();
    let aside = world.spawn((orange, Transform::default(), ASIDE)).id();
    let picture = Image::new_fill(
        Extent3d {
            width: 360,
            height: 180,
            depth_or_array_layers: 1,
        },
        TextureDimension::D2,
        &[255; 4],
        TextureFormat::Rgba8UnormSrgb,
        RenderAssetUsages::default(),
    );
    let map = world.resource_mut::<Assets<Image>>().add(Image {
        sampler: ImageSampler::nearest(),
        ..picture
    });
    let board = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            base_color_texture: Some(map.clone()),
            unlit: true,
            ..default()
        });
    let quad = world
        .resource_mut::<Assets<Mesh>>()
        .add(Rectangle::new(2.0, 1.0));
    world.spawn((Mesh3d(quad), MeshMaterial3d(board.clone()), MAP));
    let ambient = AmbientLight {
        brightness: 500.0,
        ..default()
    };
    let [first, second, third] = viewports(options.size);
    let part = |order, viewport| Camera {
        order,
        viewport: Some(viewport),
        clear_color: if order == 0 {
            ClearColorConfig::Custom(Color::srgb(0.94, 0.95, 0.96))
        } else {
            ClearColorConfig::None
        },
        ..default()
    };
    let camera = world
        .spawn((
            Camera3d::default(),
            part(0, first),
            ambient.clone(),
            Transform::from_xyz(0.6, 0.5, 2.6).looking_at(Vec3::ZERO, Vec3::Y),
            FreeCamera {
                walk_speed: 1.0,
                run_speed: 4.0,
                ..default()
            },
        ))
        .id();
    let side = world
        .spawn((
            Camera3d::default(),
            part(1, second),
            ambient,
            Transform::from_xyz(-2.4, 0.6, -1.3).looking_at(Vec3::ZERO, Vec3::Y),
            ASIDE,
        ))
        .id();
    let board_camera = world
        .spawn((
            Camera3d::default(),
            part(2, third),
            Projection::Orthographic(OrthographicProjection {
                scaling_mode: bevy::camera::ScalingMode::AutoMin {
                    min_width: 2.1,
                    min_height: 1.1,
                },
                ..OrthographicProjection::default_3d()
            }),
            Transform::from_xyz(0.0, 0.0, 1.0),
            Tonemapping::None,
            MAP,
        ))
        .id();
    // From over each eye's shoulder.
    for (camera, layers) in [(camera, RenderLayers::layer(0)), (side, ASIDE)] {
        world.spawn((
            DirectionalLight {
                illuminance: 5_000.0,
                ..default()
            },
            Transform::default().looking_to(Vec3::new(-0.5, -0.6, -1.0), Vec3::Y),
            layers,
            ChildOf(camera),
        ));
    }
    for camera in [camera, side, board_camera] {
        let mut camera = world.entity_mut(camera);
        // Noise would make no two pictures the same.
        camera.insert(DebandDither::Disabled);
        if let Some(target) = target {
            camera.insert(RenderTarget::Image(target.clone().into()));
        }
    }
    world.insert_resource(Shown {
        camera,
        model,
        aside,
        map,
        board,
        settings,
        draws_all: false,
        size: options.size,
        bins: None,
    });
}

/// A picture in three, side by side.
fn viewports(size: UVec2) -> [Viewport; 3] {
    let third = UVec2::new((size.x / 3).max(1), size.y.max(1));
    [0, 1, 2].map(|i| Viewport {
        physical_position: UVec2::new(i * third.x, 0),
        physical_size: third,
        ..default()
    })
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

/// Shows on the map and from the side what the camera draws in this frame.
fn follow(world: &mut World) {
    world.resource_scope(|world, mut shown: Mut<Shown>| {
        let (Some(models), Some(visible)) = (
            world.get_resource::<SphericalModels>(),
            world.get::<VisibleEntities>(shown.camera),
        ) else {
            return;
        };
        let bins = models.viewed_bins(shown.model, visible);
        if bins == shown.bins {
            return;
        }
        let drawn = models.drawn_triangles(shown.model, visible);
        let mesh = world.get::<Mesh3d>(shown.model).map(|mesh| mesh.0.clone());
        let part = mesh.zip(drawn).and_then(|(mesh, drawn)| {
            let mesh = world.resource::<Assets<Mesh>>().get(&mesh)?;
            let all: Vec<u32> = mesh.indices()?.iter().map(|index| index as u32).collect();
            let some = drawn.flat_map(|triangle| {
                let first = 3 * triangle as usize;
                all.get(first..first + 3).unwrap_or_default().to_vec()
            });
            let some = some.collect();
            Some(
                mesh.clone()
                    .with_inserted_indices(bevy::mesh::Indices::U32(some)),
            )
        });
        // While there is no index, what was drawn last stays.
        if let Some(part) = part {
            let part = world.resource_mut::<Assets<Mesh>>().add(part);
            world.entity_mut(shown.aside).insert(Mesh3d(part));
        }
        if let Some(bins) = &bins
            && let Some(mut image) = world.resource_mut::<Assets<Image>>().get_mut(&shown.map)
        {
            *image = map_of(bins);
        }
        // The material holds the picture that was.
        let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
        if let Some(mut board) = materials.get_mut(&shown.board) {
            board.base_color = Color::WHITE;
        }
        shown.bins = bins;
    });
}

fn map_of(bins: &ViewedBins) -> Image {
    let pixels = bins.bins.iter().flat_map(|bin| match bin {
        None => [255, 255, 255, 255],
        Some(false) => [176, 180, 186, 255],
        Some(true) => [237, 140, 46, 255],
    });
    let image = Image::new(
        Extent3d {
            width: u32::from(bins.size.phi),
            height: u32::from(bins.size.theta),
            depth_or_array_layers: 1,
        },
        TextureDimension::D2,
        pixels.collect(),
        TextureFormat::Rgba8UnormSrgb,
        RenderAssetUsages::default(),
    );
    Image {
        sampler: ImageSampler::nearest(),
        ..image
    }
}

/// P3's cases: where the camera is, and the vertical angle that it sees. units: rad
fn cases() -> [(&'static str, Transform, f32); 4] {
    let toward = |way: Vec3| {
        let way = way.normalize();
        let at = 0.55 * way;
        Transform::from_translation(2.4 * way).looking_at(at, way.any_orthonormal_vector())
    };
    [
        (
            "whole",
            Transform::from_xyz(0.6, 0.5, 2.6).looking_at(Vec3::ZERO, Vec3::Y),
            0.78,
        ),
        ("run", toward(Vec3::new(0.1, 1.0, 0.1)), 0.26),
        ("clump", toward(Vec3::new(-1.0, 0.1, -0.1)), 0.26),
        ("split", toward(Vec3::new(1.0, 0.1, 0.05)), 0.26),
    ]
}

/// A picture of each case in both modes.
fn draw(options: &Options, mesh: Mesh) -> Result<(), BunnyError> {
    let mut offline = Offline::with(|app| {
        app.add_systems(Last, follow.run_if(resource_exists::<Shown>));
    })?;
    let target = offline.target(options.size);
    populate(offline.app.world_mut(), mesh, options, Some(&target));
    let folder = options.out.clone().unwrap_or_else(|| ".".into());
    std::fs::create_dir_all(&folder)
        .map_err(|error| BunnyError::Write(folder.display().to_string(), error.to_string()))?;
    for mode in [SphericalMode::Conservative, SphericalMode::Paper] {
        let world = offline.app.world_mut();
        let (camera, model) = {
            let mut shown = world.resource_mut::<Shown>();
            shown.settings.mode = mode;
            (shown.camera, shown.model)
        };
        let settings = world.resource::<Shown>().settings;
        world.entity_mut(model).insert(settings);
        wait(&mut offline, model)?;
        for (name, place, fov) in cases() {
            let projection = Projection::Perspective(PerspectiveProjection { fov, ..default() });
            offline
                .app
                .world_mut()
                .entity_mut(camera)
                .insert((place, projection));
            for _ in 0..4 {
                offline.step();
            }
            let counts = offline.app.world().get::<SphericalCounts>(model);
            let counts = counts.copied().unwrap_or_default();
            let mode = if mode == SphericalMode::Paper {
                "paper"
            } else {
                "conservative"
            };
            println!(
                "{name}, {mode}: {} of {} triangles in {} chunks",
                counts.drawn_triangles, counts.triangles, counts.drawn_chunks
            );
            let path = folder.join(format!("bunny_{name}_{mode}.png"));
            image::DynamicImage::ImageRgba8(offline.picture(&target)?)
                .into_rgb8()
                .save(&path)
                .map_err(|error| {
                    BunnyError::Write(path.display().to_string(), error.to_string())
                })?;
            println!("  {}", std::path::absolute(&path).unwrap_or(path).display());
        }
    }
    println!("adapter: {}", offline.adapter());
    Ok(())
}

/// Until the mesh is indexed.
fn wait(offline: &mut Offline, model: Entity) -> Result<(), BunnyError> {
    offline.step();
    for _ in 0..PATIENCE {
        offline.step();
        let counts = offline.app.world().get::<SphericalCounts>(model);
        if counts.is_some_and(|counts| counts.triangles > 0) {
            return Ok(());
        }
        std::thread::sleep(core::time::Duration::from_millis(1));
    }
    let effects = offline.app.world().resource::<Effects>();
    Err(BunnyError::NotIndexed(effects.spherical().to_string()))
}

/// What the window's world is filled with.
#[derive(Resource)]
struct Start(Mesh, Options);

/// A window with a flying camera.
fn fly(options: &Options, mesh: Mesh) -> AppExit {
    let window = Window {
        title: "Skyline".into(),
        resolution: (options.size.x, options.size.y).into(),
        ..default()
    };
    let options = Options {
        file: None,
        headless: false,
        out: None,
        ..*options
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
    app.insert_resource(Start(mesh, options))
        .add_systems(Startup, start)
        .add_systems(Update, (choose, fit))
        .add_systems(Last, follow.run_if(resource_exists::<Shown>))
        .run()
}

fn start(world: &mut World) {
    if let Some(Start(mesh, options)) = world.remove_resource() {
        info!("P the paper's mode or the default, O all, N and M smaller and larger chunks");
        populate(world, mesh, &options, None);
    }
}

fn choose(keys: Res<ButtonInput<KeyCode>>, mut shown: ResMut<Shown>, mut commands: Commands) {
    let [mode, all, smaller, larger] = [KeyCode::KeyP, KeyCode::KeyO, KeyCode::KeyN, KeyCode::KeyM]
        .map(|key| keys.just_pressed(key));
    if !(mode || all || smaller || larger) {
        return;
    }
    let shown = &mut *shown;
    if mode {
        shown.settings.mode = match shown.settings.mode {
            SphericalMode::Conservative => SphericalMode::Paper,
            SphericalMode::Paper => SphericalMode::Conservative,
        };
    }
    shown.draws_all ^= all;
    let size = &mut shown.settings.chunk_triangles;
    if smaller {
        *size = (*size / 2).max(16);
    }
    if larger {
        *size = (*size * 2).min(1 << 16);
    }
    let mut model = commands.entity(shown.model);
    if shown.draws_all {
        model.remove::<SphericalIndex>();
    } else {
        model.insert(shown.settings);
    }
}

/// Keeps the three parts of the window when its size changes.
fn fit(windows: Query<&Window>, mut cameras: Query<&mut Camera>, mut shown: ResMut<Shown>) {
    let Ok(window) = windows.single() else {
        return;
    };
    let size = window.physical_size();
    if size == shown.size || size.min_element() == 0 {
        return;
    }
    shown.size = size;
    let parts = viewports(size);
    for mut camera in &mut cameras {
        if let Some(part) = parts.get(camera.order as usize) {
            camera.viewport = Some(part.clone());
        }
    }
}
