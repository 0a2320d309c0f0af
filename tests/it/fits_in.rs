//! What apps have beside this crate: temporal anti-aliasing, frame limiters, an `egui` of their own. What else they have
//! is tested with each effect: prepasses, deferred shading, multisampling, HDR and Bevy's own `OcclusionCulling` in
//! `terrain_app.rs`, `occlusion_app.rs` and `occlusion_life.rs`.

use std::{thread, time::Duration};

use bevy::{
    asset::RenderAssetUsages,
    camera::{Exposure, RenderTarget, visibility::RenderLayers},
    ecs::schedule::IntoScheduleConfigs,
    image::ImageSampler,
    light::{AmbientLight, Atmosphere, atmosphere::ScatteringMedium, light_consts},
    mesh::{Indices, PrimitiveTopology},
    pbr::AtmosphereSettings,
    prelude::*,
    render::{
        Render, RenderApp, RenderSystems,
        render_resource::{Extent3d, TextureDimension, TextureFormat},
    },
};
use bevy_anti_alias::taa::{TemporalAntiAliasPlugin, TemporalAntiAliasing};
use bevy_egui::{EguiContext, EguiContexts, EguiPlugin, EguiPrimaryContextPass, egui};
use bevy_skyline::{
    offline::Offline,
    panel::{PanelCamera, PanelPlugin, SkylinePanel},
    prelude::*,
};
use image::RgbaImage;

use crate::occlusion_app::{self, always};

/// An app with what `configure` adds, or `None` where there is no device, which is said.
fn app(configure: impl FnOnce(&mut App)) -> Option<Offline> {
    drop(crate::device()?);
    Offline::with(configure).ok()
}

const SIZE: UVec2 = UVec2::new(200, 150);
const CELLS: u32 = 32;
const CELL_M: f32 = 8.0;
const GROUND: RenderLayers = RenderLayers::layer(1);
const MESH: RenderLayers = RenderLayers::layer(2);

/// Roofs: along x up and down by turns, along z level, so that triangles and bilinear cells are the same surface.
fn roof_m(i: u32) -> f32 {
    [0.0, 5.0, 10.0, 15.0, 20.0, 15.0, 10.0, 5.0][i as usize % 8]
}

fn field() -> HeightField {
    HeightField::from_fn(UVec2::splat(CELLS + 1), CELL_M, (0.0, 20.0), |i, _| {
        roof_m(i)
    })
    .unwrap()
}

/// The same ground of triangles, each corner with the place in the picture that the terrain has there.
fn mesh() -> Mesh {
    let (mut positions, mut uvs) = (Vec::new(), Vec::new());
    for (j, i) in (0..=CELLS).flat_map(|j| (0..=CELLS).map(move |i| (j, i))) {
        positions.push([i as f32 * CELL_M, roof_m(i), j as f32 * CELL_M]);
        uvs.push([i, j].map(|k| k as f32 / CELLS as f32));
    }
    let mut indices = Vec::new();
    for (j, i) in (0..CELLS).flat_map(|j| (0..CELLS).map(move |i| (j, i))) {
        let at = j * (CELLS + 1) + i;
        let below = at + CELLS + 1;
        indices.extend([at, below, at + 1, at + 1, below, below + 1]);
    }
    Mesh::new(
        PrimitiveTopology::TriangleList,
        RenderAssetUsages::default(),
    )
    .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
    .with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, uvs)
    .with_inserted_indices(Indices::U32(indices))
    .with_computed_smooth_normals()
}

/// Squares of two colours, large enough never to be drawn smaller than they are.
fn squares() -> Image {
    let side = 2 * CELLS;
    let texels = (0..side * side).flat_map(|at| {
        if (at % side / 2 + at / side / 2).is_multiple_of(2) {
            [230, 200, 40, 255]
        } else {
            [30, 60, 140, 255]
        }
    });
    let mut image = Image::new(
        Extent3d {
            width: side,
            height: side,
            depth_or_array_layers: 1,
        },
        TextureDimension::D2,
        texels.collect(),
        TextureFormat::Rgba8UnormSrgb,
        RenderAssetUsages::default(),
    );
    image.sampler = ImageSampler::linear();
    image
}

/// The ground twice, ray-cast and of triangles, each before a camera of its own.
struct Ground {
    offline: Offline,
    cameras: [Entity; 2],
    pictures: [Handle<Image>; 2],
}

impl Ground {
    /// Once the ground is there, as what comes in later is slow to show at rest.
    fn new<B: Bundle>(camera: impl Fn() -> B) -> Option<Self> {
        let mut offline = app(|app| {
            app.add_plugins(TemporalAntiAliasPlugin);
        })?;
        let world = offline.app.world_mut();
        let squares = world.resource_mut::<Assets<Image>>().add(squares());
        let field = world.resource_mut::<Assets<HeightField>>().add(field());
        world.spawn((
            Terrain::new(field).with_look(TerrainLook {
                colour: TerrainColour::Albedo(squares.clone()),
                perceptual_roughness: 1.0,
                reflectance: 0.0,
                ..default()
            }),
            GROUND,
        ));
        let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh());
        let material = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial {
                base_color_texture: Some(squares),
                perceptual_roughness: 1.0,
                reflectance: 0.0,
                ..default()
            });
        world.spawn((Mesh3d(mesh), MeshMaterial3d(material), MESH));
        let pictures = [offline.target(SIZE), offline.target(SIZE)];
        let light = AmbientLight {
            brightness: 800.0,
            ..default()
        };
        let cameras = [(0, GROUND), (1, MESH)].map(|(i, layers)| {
            offline.camera(&pictures[i], (Msaa::Off, look(0), layers, light.clone()))
        });
        offline.settle(cameras[0], 20).unwrap();
        for of in cameras {
            offline.app.world_mut().entity_mut(of).insert(camera());
        }
        Some(Self {
            offline,
            cameras,
            pictures,
        })
    }

    fn frame(&mut self, place: Transform) -> [RgbaImage; 2] {
        for camera in self.cameras {
            self.offline
                .app
                .world_mut()
                .entity_mut(camera)
                .insert(place);
        }
        self.offline.step();
        [0, 1].map(|i| self.offline.picture(&self.pictures[i]).unwrap())
    }
}

/// A way over the ground, on which much comes into view at the border and from behind ridges.
fn look(frame: u32) -> Transform {
    let t = frame as f32;
    let eye = Vec3::new(60.0 + 1.6 * t, 34.0 + 0.2 * t, 200.0 - 1.1 * t);
    Transform::from_translation(eye).looking_to(Vec3::new(0.35 + 0.012 * t, -0.42, -1.0), Vec3::Y)
}

/// Mean over channels and pixels.
fn difference(a: &RgbaImage, b: &RgbaImage) -> f64 {
    let sum: u64 = (a.iter().zip(b.iter()))
        .map(|(a, b)| u64::from(a.abs_diff(*b)))
        .sum();
    sum as f64 / f64::from(3 * SIZE.x * SIZE.y)
}

/// What the ground and the mesh differ by, on the way, with these beside the camera and in the scene; and what these
/// change of the picture of the mesh.
fn differences(scene: impl Fn(&mut Ground), camera: impl Bundle + Clone) -> Option<(f64, f64)> {
    let mut bare = Ground::new(|| ())?;
    // Each in an app of its own: Bevy 0.19's atmosphere is for one camera.
    let one_camera = |which: usize| {
        let mut ground = Ground::new(|| ())?;
        scene(&mut ground);
        let world = ground.offline.app.world_mut();
        world
            .entity_mut(ground.cameras[which])
            .insert(camera.clone());
        Some(ground)
    };
    let (mut ground, mut triangles) = (one_camera(0)?, one_camera(1)?);
    let (mut apart, mut changed) = (0.0_f64, 0.0_f64);
    for at in 0..12 {
        let [ray, _] = ground.frame(look(at));
        let [_, mesh] = triangles.frame(look(at));
        let [_, plain] = bare.frame(look(at));
        // Pipelines are compiled, tables filled.
        if at < 4 {
            continue;
        }
        apart = apart.max(difference(&ray, &mesh));
        changed = changed.max(difference(&plain, &mesh));
        if let (Ok(dir), 8) = (std::env::var("FITS_IN"), at) {
            ray.save(format!("{dir}/ray.png")).unwrap();
            mesh.save(format!("{dir}/mesh.png")).unwrap();
        }
    }
    println!("ground and mesh differ by {apart} at most, {changed} is changed");
    Some((apart, changed))
}

#[test]
fn through_glass_terrain_is_as_a_mesh() {
    let glass = |ground: &mut Ground| {
        let world = ground.offline.app.world_mut();
        let ball = world
            .resource_mut::<Assets<Mesh>>()
            .add(Sphere::new(14.0).mesh().uv(48, 24));
        let material = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial {
                specular_transmission: 0.95,
                perceptual_roughness: 0.05,
                thickness: 8.0,
                ior: 1.4,
                ..default()
            });
        world.spawn((
            Mesh3d(ball),
            MeshMaterial3d(material),
            Transform::from_xyz(80.0, 34.0, 155.0),
            RenderLayers::from_layers(&[1, 2]),
        ));
    };
    let Some((apart, changed)) = differences(glass, ()) else {
        return;
    };
    assert!(changed > 1.0, "there is no glass: {changed}");
    assert!(apart < 0.05, "ground and mesh differ by {apart}");
}

/// That the air comes after the ground is held by `architecture.rs`, too, on any driver.
#[test]
fn in_bevys_atmosphere_terrain_is_as_a_mesh() {
    match crate::device() {
        Some(offline) if offline.is_software() => {
            println!(
                "skipped: Bevy's atmosphere, without terrain, crashes Mesa 22's software driver"
            );
            return;
        }
        Some(_) => {}
        None => return,
    }
    let air = |ground: &mut Ground| {
        let world = ground.offline.app.world_mut();
        let medium = world
            .resource_mut::<Assets<ScatteringMedium>>()
            .add(ScatteringMedium::earth(64, 64));
        // A hundredth of the earth's: some metres are a kilometre of air.
        let atmosphere = Atmosphere::earth(medium);
        let depth = 0.01 * atmosphere.inner_radius;
        world.spawn((
            atmosphere,
            Transform::from_xyz(0.0, -depth, 0.0).with_scale(Vec3::splat(0.01)),
        ));
        world.spawn((
            DirectionalLight {
                illuminance: light_consts::lux::RAW_SUNLIGHT,
                ..default()
            },
            Transform::default().looking_to(Vec3::new(-1.0, -0.6, -0.4), Vec3::Y),
        ));
    };
    let camera = (AtmosphereSettings::default(), Exposure { ev100: 13.0 });
    let Some((apart, changed)) = differences(air, camera) else {
        return;
    };
    assert!(changed > 1.0, "there is no air: {changed}");
    assert!(apart < 0.5, "ground and mesh differ by {apart}");
}

/// Under temporal anti-aliasing terrain is what a mesh is: its edges are smoothed at rest, and it drags nothing behind it
/// in motion. Both need rays that jitter as triangles do, and motion vectors.
#[test]
fn under_temporal_anti_aliasing_terrain_is_as_a_mesh() {
    let Some(mut sharp) = Ground::new(|| ()) else {
        return;
    };
    let Some(mut smooth) = Ground::new(TemporalAntiAliasing::default) else {
        return;
    };
    for _ in 0..20 {
        sharp.frame(look(0));
        smooth.frame(look(0));
    }
    let (mut least, mut most) = (f64::MAX, 0.0_f64);
    // At rest, then on the way.
    for at in 0..40 {
        let [(plain, plain_mesh), (ground, mesh)] =
            [&mut sharp, &mut smooth].map(|of| of.frame(look(at)).into());
        // Else they would be two scenes.
        assert!(difference(&plain, &plain_mesh) < 0.02, "frame {at}");
        least = least.min(difference(&plain, &ground));
        most = most.max(difference(&ground, &mesh));
    }
    // Away, and back from elsewhere.
    for at in 0..6 {
        let away = Transform::from_translation(look(10 * at).translation)
            .looking_to(Vec3::new(0.3, 0.9, 0.2), Vec3::X);
        smooth.frame(if at < 3 { away } else { look(at) });
        let [ground, mesh] = smooth.frame(look(20 + at));
        most = most.max(difference(&ground, &mesh));
    }
    println!("smoothing changes {least} at least; ground and mesh differ by {most} at most");
    assert!(least > 1.0, "nothing is smoothed: {least}");
    assert!(most < 0.25, "ground and mesh differ by {most}");
}

/// The culling camera's depth jitters, so does the picture it is held against; what is smoothed over frames shows a
/// pixel that went missing for several of them.
#[test]
fn nothing_is_missing_under_temporal_anti_aliasing() {
    let Some(offline) = app(|app| {
        app.add_plugins(TemporalAntiAliasPlugin);
    }) else {
        return;
    };
    let camera = || (Msaa::Off, TemporalAntiAliasing::default());
    let mut scene = occlusion_app::Scene::within(offline, always(), camera);
    for _ in 0..8 {
        scene.step();
    }
    let (most, rescued) = occlusion_app::compare_motion(&mut scene, 60);
    assert!(most > 100 && rescued > 0, "{most} {rescued}");
}

/// A limiter sleeps in the render world's cleaning up, as `bevy_framepace` does. A budget that took that for work would
/// cull for nothing.
#[test]
fn a_frame_limiters_sleep_is_not_work() {
    const SLEEP: Duration = Duration::from_millis(1_500);
    let Some(mut offline) = app(|app| {
        app.sub_app_mut(RenderApp).add_systems(
            Render,
            (|| thread::sleep(SLEEP))
                .in_set(RenderSystems::Cleanup)
                .after(World::clear_entities),
        );
    }) else {
        return;
    };
    let target = offline.target(UVec2::new(32, 32));
    let camera = offline.camera(&target, (Msaa::Off, FrameBudget::from_ms(10_000.0)));
    for _ in 0..5 {
        offline.step();
    }
    let state = offline.app.world().get::<BudgetState>(camera).unwrap();
    let measured_ms = state.measured_ms.unwrap();
    assert!(
        measured_ms > 0.0 && measured_ms < SLEEP.as_secs_f32() * 1e3,
        "{measured_ms} ms with a sleep of {SLEEP:?}"
    );
}

#[derive(Resource, Default)]
struct OwnFrames(u32);

fn own_window(mut contexts: EguiContexts, mut frames: ResMut<OwnFrames>) {
    let Ok(context) = contexts.ctx_mut() else {
        return;
    };
    egui::Window::new("the app's own").show(context, |ui| {
        ui.label("something of the app");
    });
    frames.0 += 1;
}

/// The panel has a context of its own, and leaves the app's alone.
#[test]
fn the_panel_stands_beside_an_egui_of_the_apps_own() {
    let Some(mut offline) = app(|app| {
        app.add_plugins((EguiPlugin::default(), PanelPlugin))
            .init_resource::<OwnFrames>()
            .add_systems(EguiPrimaryContextPass, own_window);
    }) else {
        return;
    };
    let target = offline.target(UVec2::new(400, 300));
    offline.camera(&target, Msaa::Off);
    // Windows are faded in.
    for _ in 0..30 {
        offline.step();
    }
    let without_panel = offline.picture(&target).unwrap();
    let frames = |offline: &Offline| offline.app.world().resource::<OwnFrames>().0;
    let contexts = |offline: &mut Offline| {
        let world = offline.app.world_mut();
        world.query::<&EguiContext>().iter(world).count()
    };
    assert_eq!(contexts(&mut offline), 1);
    let before = frames(&offline);
    assert!(before > 0, "the app's own window is not drawn");

    // There is no window here.
    let world = offline.app.world_mut();
    let onto = RenderTarget::Image(target.clone().into());
    world.add_observer(move |added: On<Add, PanelCamera>, mut commands: Commands| {
        commands.entity(added.entity).insert(onto.clone());
    });
    world.resource_mut::<SkylinePanel>().open = true;
    for _ in 0..5 {
        offline.step();
    }
    assert_eq!(contexts(&mut offline), 2);
    assert_eq!(frames(&offline), before + 5);
    let with_panel = offline.picture(&target).unwrap();
    assert!(with_panel != without_panel, "the panel is not drawn");

    offline.app.world_mut().resource_mut::<SkylinePanel>().open = false;
    for _ in 0..3 {
        offline.step();
    }
    assert_eq!(contexts(&mut offline), 1);
    assert_eq!(frames(&offline), before + 8);
    assert!(offline.picture(&target).unwrap() == without_panel);
}
