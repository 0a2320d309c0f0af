//! A dense city in which most is hidden, and four ways to leave out what is: none, what is out of view, Bevy's
//! occlusion culling, ours.
//!
//! ```sh
//! cargo run --all-features --example occlusion
//! cargo run --all-features --example occlusion -- city.glb
//! cargo run --all-features --example occlusion -- --headless --out pictures
//! ```
//!
//! In the window: W, A, S, D, E and Q fly, Shift flies faster, the right mouse button looks around, the wheel sets
//! the speed; 1 to 4 choose what is left out, V what stands for an object, B how depth is read, P whether a depth
//! prepass comes before ours; O shows from above what the camera draws (green), what is hidden from it (red) and what
//! is out of its view (grey). With feature `panel`, F3 opens the panel.

#[path = "common/city.rs"]
mod city;
#[path = "occlusion/overview.rs"]
mod overview;
#[path = "common/stage.rs"]
mod stage;

use std::path::PathBuf;

use bevy::{
    camera::visibility::NoFrustumCulling, core_pipeline::prepass::DepthPrepass, prelude::*,
    render::occlusion_culling::OcclusionCulling,
};
use bevy_skyline::{
    offline::scenes::{
        CameraPath, Scene,
        city::{CitySize, from_file, generated},
    },
    prelude::*,
};
use overview::{Overview, OverviewPlugin, Tally};
use stage::{Film, Stage, StageError, Status};

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
const SAMPLINGS: [DepthSampling; 6] = [
    DepthSampling::Conservative { block: 0 },
    DepthSampling::Conservative { block: 2 },
    DepthSampling::Conservative { block: 4 },
    DepthSampling::Conservative { block: 8 },
    DepthSampling::Conservative { block: 16 },
    DepthSampling::Strided { x: 5, y: 4 },
];

/// Where the headless walk begins: not at the city's edge. units: frames of the path
const FIRST_STEP: u32 = 6_000;

/// Flies through a city in a window, or makes a picture of it.
#[derive(clap::Args)]
struct Options {
    /// glTF binary with one node and mesh a building; else a city made by code.
    file: Option<PathBuf>,
}

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
    stage::start(run)
}

fn run(stage: Stage, options: Options) -> Result<AppExit, StageError> {
    let city_size = if stage.options.small {
        CitySize::Small
    } else {
        CitySize::Full
    };
    let scene = city::read_or_make(options.file.as_deref(), from_file, || generated(city_size))?;
    let size = stage.options.size;
    let stage = Stage {
        keys: "1 none, 2 frustum, 3 Bevy's, 4 ours; V the volume, B the sampling, P a depth prepass before ours, \
               O the overview: green drawn, red hidden, grey out of view",
        effects: &[Effect::ZBufferOcclusion],
        ..stage
    };
    stage.show(
        |app| {
            app.add_plugins(OverviewPlugin)
                .add_systems(Update, (choose, drive))
                // Counts are this frame's.
                .add_systems(Last, describe.after(overview::colour));
        },
        |world| {
            let (entities, camera) = city::populate(world, &scene, "street", ());
            overview::spawn(world, &scene, &entities, camera, size);
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
        },
        walk,
    )
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

/// A few steps through the streets in each way to cull, and a picture of the last with the map.
fn walk(film: &mut Film) -> Result<(), StageError> {
    let step = |world: &mut World, frame| {
        world.resource_scope(|world, city: Mut<City>| {
            let place = CameraPath::Walk.at(&city.scene, FIRST_STEP + frame);
            world.entity_mut(city.camera).insert(place);
        });
    };
    show_overview(film.world(), |_| false);
    for (way, name) in WAYS {
        cull(film.world(), way);
        film.world().resource_mut::<City>().frame = 0;
        step(film.world(), 0);
        film.settle();
        film.time(name, step);
    }
    show_overview(film.world(), |_| true);
    film.settle();
    let mut picture = film.look()?;
    overview::legend(&mut picture, film.world().resource::<Tally>());
    film.write("", &picture)
}

fn choose(world: &mut World) {
    let digit = stage::digit(world);
    let [volume, sampling, prepass, above] = stage::pressed(
        world,
        [KeyCode::KeyV, KeyCode::KeyB, KeyCode::KeyP, KeyCode::KeyO],
    );
    let mut city = world.resource_mut::<City>();
    if volume {
        city.settings.volume = stage::after(&VOLUMES, city.settings.volume);
    }
    if sampling {
        city.settings.sampling = stage::after(&SAMPLINGS, city.settings.sampling);
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

/// What is drawn and why not the rest.
fn describe(city: Res<City>, tally: Res<Tally>, mut status: ResMut<Status>) {
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
    status.0 = format!(
        "{name}{settings}: {} drawn, {} hidden, {} out of view of {}",
        tally.drawn,
        tally.hidden,
        tally.out_of_view,
        city.entities.len()
    );
}
