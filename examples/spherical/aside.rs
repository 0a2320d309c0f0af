//! What a camera draws of a mesh: from the side, and on the map of directions.

use bevy::{
    asset::RenderAssetUsages,
    camera::{
        ScalingMode, Viewport,
        visibility::{RenderLayers, VisibleEntities},
    },
    core_pipeline::tonemapping::Tonemapping,
    image::ImageSampler,
    light::AmbientLight,
    mesh::Indices,
    prelude::*,
    render::render_resource::{Extent3d, TextureDimension, TextureFormat},
};
use bevy_skyline::systems::spherical::models::{SphericalModels, ViewedBins};

/// The side view and the map: what no other camera sees.
const ASIDE: RenderLayers = RenderLayers::layer(1);
const MAP: RenderLayers = RenderLayers::layer(2);
/// Angle that sees the whole model. units: rad
pub const WIDE: f32 = 0.78;

/// Whose view of what is shown.
pub struct Aside {
    pub camera: Entity,
    pub model: Entity,
}

/// What shows it.
#[derive(Resource)]
struct Shown {
    of: Aside,
    /// The drawn triangles, from the side.
    part: Entity,
    map: Handle<Image>,
    board: Handle<StandardMaterial>,
    size: UVec2,
    /// What is shown.
    bins: Option<ViewedBins>,
}

/// Keeps both as the last frame was drawn.
pub struct AsidePlugin;

impl Plugin for AsidePlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(Update, fit.run_if(resource_exists::<Shown>))
            .add_systems(Last, follow.run_if(resource_exists::<Shown>));
    }
}

/// A picture in three, side by side.
pub fn viewports(size: UVec2) -> [Viewport; 3] {
    let ends = [0, size.x / 3, 2 * size.x / 3, size.x];
    [0, 1, 2].map(|i| Viewport {
        physical_position: UVec2::new(ends[i], 0),
        physical_size: UVec2::new((ends[i + 1] - ends[i]).max(1), size.y.max(1)),
        ..default()
    })
}

/// A lens for one of the three that sees such an angle both across and upright. units: rad
pub fn lens(angle: f32, size: UVec2) -> Projection {
    let aspect = size.x as f32 / (3 * size.y.max(1)) as f32;
    Projection::Perspective(PerspectiveProjection {
        fov: 2.0 * ((0.5 * angle).tan() / aspect.min(1.0)).atan(),
        ..default()
    })
}

pub fn paint(world: &mut World, colour: Color) -> MeshMaterial3d<StandardMaterial> {
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    MeshMaterial3d(materials.add(StandardMaterial {
        base_color: colour,
        perceptual_roughness: 0.9,
        ..default()
    }))
}

pub fn ambient() -> AmbientLight {
    AmbientLight {
        brightness: 500.0,
        ..default()
    }
}

/// The side view, the map, and a light for each eye.
pub fn spawn(world: &mut World, of: Aside, size: UVec2) {
    let orange = paint(world, Color::srgb(0.93, 0.55, 0.18));
    let part = world.spawn((orange, Transform::default(), ASIDE)).id();
    let white = picture(UVec2::new(360, 180), vec![255; 4 * 360 * 180]);
    let map = world.resource_mut::<Assets<Image>>().add(white);
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    let board = materials.add(StandardMaterial {
        base_color_texture: Some(map.clone()),
        unlit: true,
        ..default()
    });
    let mut meshes = world.resource_mut::<Assets<Mesh>>();
    let quad = meshes.add(Rectangle::new(2.0, 1.0));
    world.spawn((Mesh3d(quad), MeshMaterial3d(board.clone()), MAP));
    let [_, middle, right] = viewports(size);
    let after = |order, viewport| {
        (
            Camera3d::default(),
            Camera {
                order,
                viewport: Some(viewport),
                clear_color: ClearColorConfig::None,
                ..default()
            },
        )
    };
    let side = world
        .spawn((
            after(1, middle),
            lens(WIDE, size),
            ambient(),
            Transform::from_xyz(-2.4, 0.6, -1.3).looking_at(Vec3::ZERO, Vec3::Y),
            ASIDE,
        ))
        .id();
    world.spawn((
        after(2, right),
        Projection::Orthographic(OrthographicProjection {
            scaling_mode: ScalingMode::AutoMin {
                min_width: 2.1,
                min_height: 1.1,
            },
            ..OrthographicProjection::default_3d()
        }),
        Transform::from_xyz(0.0, 0.0, 1.0),
        Tonemapping::None,
        MAP,
    ));
    // From over each eye's shoulder.
    for (camera, layers) in [(of.camera, RenderLayers::layer(0)), (side, ASIDE)] {
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
    world.insert_resource(Shown {
        of,
        part,
        map,
        board,
        size,
        bins: None,
    });
}

/// Shows on the map and from the side what the camera draws in this frame.
fn follow(world: &mut World) {
    world.resource_scope(|world, mut shown: Mut<Shown>| {
        let (Some(models), Some(visible)) = (
            world.get_resource::<SphericalModels>(),
            world.get::<VisibleEntities>(shown.of.camera),
        ) else {
            return;
        };
        let model = shown.of.model;
        let bins = models.viewed_bins(model, visible);
        if bins == shown.bins {
            return;
        }
        let drawn = models.drawn_triangles(model, visible);
        let mesh = world.get::<Mesh3d>(model).map(|mesh| mesh.0.clone());
        let part = mesh.zip(drawn).and_then(|(mesh, drawn)| {
            let mesh = world.resource::<Assets<Mesh>>().get(&mesh)?;
            let all: Vec<u32> = mesh.indices()?.iter().map(|index| index as u32).collect();
            let some = drawn.flat_map(|triangle| {
                let first = 3 * triangle as usize;
                all.get(first..first + 3).unwrap_or_default().to_vec()
            });
            let some = Indices::U32(some.collect());
            Some(mesh.clone().with_inserted_indices(some))
        });
        // While there is no index, what was drawn last stays.
        if let Some(part) = part {
            let part = world.resource_mut::<Assets<Mesh>>().add(part);
            world.entity_mut(shown.part).insert(Mesh3d(part));
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
    let size = UVec2::new(bins.size.phi.into(), bins.size.theta.into());
    picture(size, pixels.collect())
}

fn picture(size: UVec2, pixels: Vec<u8>) -> Image {
    let image = Image::new(
        Extent3d {
            width: size.x,
            height: size.y,
            depth_or_array_layers: 1,
        },
        TextureDimension::D2,
        pixels,
        TextureFormat::Rgba8UnormSrgb,
        RenderAssetUsages::default(),
    );
    Image {
        sampler: ImageSampler::nearest(),
        ..image
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
