//! The picture with culling and the same without it, side by side, and what a frame of each takes.
//!
//! Each half is drawn by a camera of its own into an image; the left one has the effects that a camera can have
//! (occlusion, contribution, budget), the right one has none; a third camera puts both into the window. What effects do
//! to the scene (terrain shadow, interior culling, spherical index) both show. Most of the time both are drawn. Every
//! [`PERIOD`] frames each in turn is drawn alone for [`ALONE`] frames, while the other half stands still: these are the
//! frames that are timed.

use bevy::{
    camera::{ClearColorConfig, RenderTarget, ScalingMode, visibility::RenderLayers},
    core_pipeline::tonemapping::{DebandDither, Tonemapping},
    prelude::*,
    render::render_resource::TextureFormat,
    window::{PresentMode, PrimaryWindow},
};

use super::{sky, sky::Sun, world::Scenery};

/// The layer of the two halves. Terrain and all else is on layer 0.
const LAYER: usize = 7;
/// From one timing to the next, and how long it takes for each half. units: frames
const PERIOD: u32 = 120;
/// See [`PERIOD`]. units: frames
const ALONE: u32 = 10;
/// The first of these frames are still the others' in the renderer. units: frames
const SKIPPED: u32 = 4;

/// There while both are shown.
#[derive(Resource)]
pub struct Split {
    without: Entity,
    /// What goes when it is over, beside that camera.
    stage: Vec<Entity>,
    frame: u32,
    /// Sum and number of the times of this timing, and the mean of the last, of each half. units: ms
    sums: [(f32, u32); 2],
    means_ms: [Option<f32>; 2],
    /// How the window showed pictures before.
    present: PresentMode,
}

impl Split {
    /// Both times, in words.
    pub fn times(&self) -> String {
        let time = |mean: Option<f32>| mean.map_or("…".into(), |ms| format!("{ms:.1} ms"));
        let [with, without] = self.means_ms.map(time);
        format!("with culling {with} | without {without}")
    }
}

/// Shows both halves, or the one picture again.
pub fn toggle(world: &mut World) {
    match world.remove_resource::<Split>() {
        Some(split) => end(world, &split),
        None => begin(world),
    }
}

fn begin(world: &mut World) {
    let mut windows = world.query_filtered::<&mut Window, With<PrimaryWindow>>();
    let Ok(mut window) = windows.single_mut(world) else {
        return;
    };
    let size = window.physical_size();
    let present = window.present_mode;
    // Waiting for the display would be timed too.
    window.present_mode = PresentMode::AutoNoVsync;
    let half = UVec2::new((size.x / 2).max(1), size.y.max(1));
    let images = [(); 2].map(|()| {
        let image = Image::new_target_texture(half.x, half.y, TextureFormat::Rgba8UnormSrgb, None);
        world.resource_mut::<Assets<Image>>().add(image)
    });
    let camera = world.resource::<Scenery>().camera;
    let place = world.get::<Transform>(camera).copied().unwrap_or_default();
    world
        .entity_mut(camera)
        .insert(RenderTarget::Image(images[0].clone().into()));
    if let Some(mut camera) = world.get_mut::<Camera>(camera) {
        // See `end`.
        camera.is_active = true;
    }
    let without = world
        .spawn((
            Camera3d::default(),
            sky::lens(),
            place,
            RenderTarget::Image(images[1].clone().into()),
        ))
        .id();
    let quad = world
        .resource_mut::<Assets<Mesh>>()
        .add(Rectangle::new(0.998, 1.0));
    let mut stage: Vec<Entity> = images
        .into_iter()
        .zip([-0.5, 0.5])
        .map(|(image, x)| {
            let paint = world
                .resource_mut::<Assets<StandardMaterial>>()
                .add(StandardMaterial {
                    base_color_texture: Some(image),
                    unlit: true,
                    fog_enabled: false,
                    ..default()
                });
            world
                .spawn((
                    Mesh3d(quad.clone()),
                    MeshMaterial3d(paint),
                    Transform::from_xyz(x, 0.0, -1.0),
                    RenderLayers::layer(LAYER),
                ))
                .id()
        })
        .collect();
    stage.push(
        world
            .spawn((
                Camera3d::default(),
                Camera {
                    order: 1,
                    clear_color: ClearColorConfig::Custom(Color::BLACK),
                    ..default()
                },
                Projection::Orthographic(OrthographicProjection {
                    scaling_mode: ScalingMode::Fixed {
                        width: 2.0,
                        height: 1.0,
                    },
                    ..OrthographicProjection::default_3d()
                }),
                // The halves are as they are to be seen.
                Tonemapping::None,
                DebandDither::Disabled,
                Msaa::Off,
                RenderLayers::layer(LAYER),
            ))
            .id(),
    );
    world.insert_resource(Split {
        without,
        stage,
        // The first timing comes at once.
        frame: PERIOD - 2 * ALONE,
        sums: default(),
        means_ms: default(),
        present,
    });
    // The new camera has no sky yet.
    world.resource_mut::<Sun>().set_changed();
}

fn end(world: &mut World, split: &Split) {
    for &entity in split.stage.iter().chain([&split.without]) {
        world.despawn(entity);
    }
    let camera = world.resource::<Scenery>().camera;
    world.entity_mut(camera).insert(RenderTarget::default());
    if let Some(mut camera) = world.get_mut::<Camera>(camera) {
        // Written even if it is active: only of a camera that has changed Bevy looks how large its target is.
        camera.is_active = true;
    }
    let mut windows = world.query_filtered::<&mut Window, With<PrimaryWindow>>();
    for mut window in windows.iter_mut(world) {
        window.present_mode = split.present;
    }
}

/// Keeps both cameras in one place, and times them.
pub fn follow(world: &mut World) {
    let Some(mut split) = world.remove_resource::<Split>() else {
        return;
    };
    let camera = world.resource::<Scenery>().camera;
    let place = world.get::<Transform>(camera).copied().unwrap_or_default();
    if let Some(mut without) = world.get_mut::<Transform>(split.without) {
        *without = place;
    }
    let ms = world.resource::<Time<Real>>().delta_secs() * 1e3;
    let (half, alone) = turn(split.frame);
    if let Some(half) = half.filter(|_| alone >= SKIPPED) {
        let (sum, count) = &mut split.sums[half];
        (*sum, *count) = (*sum + ms, *count + 1);
    }
    if half.is_none() {
        for (sum, mean) in split.sums.iter_mut().zip(&mut split.means_ms) {
            if sum.1 > 0 {
                *mean = Some(sum.0 / sum.1 as f32);
                *sum = default();
            }
        }
    }
    split.frame = split.frame.wrapping_add(1);
    let (half, _) = turn(split.frame);
    set_active(world, camera, half != Some(1));
    set_active(world, split.without, half != Some(0));
    world.insert_resource(split);
}

/// Which half is drawn alone in a frame, if one is, and for how many frames it has been.
fn turn(frame: u32) -> (Option<usize>, u32) {
    let at = frame % PERIOD;
    match at.checked_sub(PERIOD - 2 * ALONE) {
        Some(at) => (Some((at / ALONE) as usize), at % ALONE),
        None => (None, 0),
    }
}

fn set_active(world: &mut World, camera: Entity, is_active: bool) {
    if let Some(mut camera) = world.get_mut::<Camera>(camera)
        && camera.is_active != is_active
    {
        camera.is_active = is_active;
    }
}
