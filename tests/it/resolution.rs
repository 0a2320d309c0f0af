//! Resolution scale in a headless app: what is stretched is what a smaller camera draws, bit for bit, and it is
//! stretched as the twin says.

use bevy::{
    asset::RenderAssetUsages,
    camera::{Hdr, MainPassResolutionOverride, RenderTarget, Viewport},
    core_pipeline::{
        prepass::{DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass},
        tonemapping::{DebandDither, Tonemapping},
    },
    light::{Skybox, VolumetricFog},
    math::DVec4,
    pbr::{
        ContactShadows, DefaultOpaqueRendererMethod, ScreenSpaceAmbientOcclusion,
        ScreenSpaceReflections,
    },
    prelude::*,
    render::{
        RenderApp,
        camera::TemporalJitter,
        occlusion_culling::OcclusionCulling,
        render_resource::{
            Extent3d, TextureDimension, TextureFormat, TextureId, TextureUsages,
            TextureViewDescriptor, TextureViewDimension,
        },
        sync_world::RenderEntity,
    },
};
use bevy_skyline::{
    occlusion::depth::{layout, room_for, texel_count},
    offline::{HitImage, Offline, scenes::compare::differing_px},
    prelude::*,
    reference::upscale::{LinearPicture, stretch, stretch_error},
    render_graph::{
        upscale::{GpuStretch, UpscalePipelines, Upscalers, scale_main_passes},
        view::TerrainViews,
    },
    resolution::FullSize,
};
use image::RgbaImage;

use super::occlusion_app::{Scene, always, eye};

const SIZE: UVec2 = UVec2::new(160, 90);
const HALF: UVec2 = UVec2::new(80, 45);

/// An 8-bit value may be off by so much, in its own unit, when it is written: what graphics APIs allow.
const WRITTEN: f64 = 0.6;
/// What sampling with 8 bits of position can differ by between two textures of different size, in 8-bit units: half of
/// such a step along each axis, in either picture. Glass samples what lies behind it.
const SAMPLED: f64 = 2.0;
/// What a half float of at most 1 may be off by, in 8-bit units.
const HALF_FLOAT: f64 = 255.0 / 4096.0;

fn linear(byte: f64) -> f64 {
    let c = byte / 255.0;
    if c <= 0.04045 {
        c / 12.92
    } else {
        ((c + 0.055) / 1.055).powf(2.4)
    }
}

fn encoded(linear: f64) -> f64 {
    let c = linear.clamp(0.0, 1.0);
    255.0
        * if c <= 0.003_130_8 {
            12.92 * c
        } else {
            1.055 * c.powf(1.0 / 2.4) - 0.055
        }
}

fn of_bytes(picture: &RgbaImage, convert: impl Fn(f64) -> f64) -> LinearPicture {
    LinearPicture {
        size: picture.dimensions().into(),
        pixels: picture
            .pixels()
            .map(|p| {
                let [r, g, b, a] = p.0.map(|byte| convert(f64::from(byte)));
                DVec4::new(r, g, b, a)
            })
            .collect(),
    }
}

/// A target whose bytes are linear light, so that no driver's rounding of sRGB comes in.
pub fn target(offline: &mut Offline, size: UVec2) -> Handle<Image> {
    let mut image = Image::new_target_texture(size.x, size.y, TextureFormat::Rgba8Unorm, None);
    image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
    image.asset_usage = RenderAssetUsages::default();
    let mut images = offline.app.world_mut().resource_mut::<Assets<Image>>();
    images.add(image)
}

/// Colours of `large`, drawn to a [`target`], that are not the stretch of `small`, and the colours compared. The pixels
/// of `small` are those that were stretched but for `unknown`, in 8-bit units; of HDR cameras they were rounded to bytes.
pub fn outside(large: &RgbaImage, small: &RgbaImage, unknown: f64) -> (usize, usize) {
    let size = large.dimensions().into();
    let middle = stretch(&of_bytes(small, |byte| byte), size);
    let error = stretch_error(
        &of_bytes(small, |byte| match (unknown == 0.0, byte < 255.0) {
            (true, _) => 0.0,
            (false, true) => unknown,
            // It was this bright or any brighter.
            (false, false) => 1e6,
        }),
        size,
    );
    let written = if unknown == 0.0 {
        WRITTEN
    } else {
        WRITTEN + HALF_FLOAT
    };
    let mut wrong = 0;
    for ((pixel, middle), error) in large.pixels().zip(&middle.pixels).zip(&error.pixels) {
        for channel in 0..4 {
            let off = (f64::from(pixel.0[channel]) - middle[channel]).abs();
            wrong += usize::from(off > error[channel] + written);
        }
    }
    (wrong, large.pixels().len() * 4)
}

fn part(picture: &RgbaImage, at: UVec2, size: UVec2) -> RgbaImage {
    image::imageops::crop_imm(picture, at.x, at.y, size.x, size.y).to_image()
}

/// Written to `/tmp` where that is asked for, to be looked at.
fn keep(name: &str, picture: &RgbaImage) {
    if let Some(folder) = std::env::var_os("SKYLINE_KEEP_PICTURES") {
        let path = std::path::Path::new(&folder).join(format!("{name}.png"));
        picture.save(path).expect("the picture can be written");
    }
}

fn place() -> Transform {
    eye(Vec3::new(0.0, 4.0, 13.0), Vec3::new(0.0, 1.0, 0.0))
}

/// What differs from camera to camera on purpose is taken out: dither goes by the pixel's place in the texture.
fn plain() -> impl Bundle {
    (place(), DebandDither::Disabled)
}

/// A scene with edges in all directions, smooth slopes, lights in clusters, shadows, something to see through, and a
/// sky that depends on the direction.
fn scene() -> Option<(Offline, Handle<Image>)> {
    let mut offline = crate::device()?;
    let world = offline.app.world_mut();
    world.insert_resource(ClearColor(Color::srgb(0.2, 0.3, 0.5)));
    world.insert_resource(GlobalAmbientLight {
        brightness: 200.0,
        ..default()
    });
    let mut meshes = world.resource_mut::<Assets<Mesh>>();
    let cube = meshes.add(Cuboid::from_length(2.0));
    let sphere = meshes.add(Sphere::new(1.2));
    let ground = meshes.add(Plane3d::default().mesh().size(40.0, 40.0));
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    let matt = |colour: Color| StandardMaterial {
        base_color: colour,
        perceptual_roughness: 0.9,
        ..default()
    };
    let colours =
        [0.0, 60.0, 140.0, 220.0, 300.0].map(|hue| materials.add(matt(Color::hsl(hue, 0.8, 0.5))));
    let grey = materials.add(matt(Color::srgb(0.5, 0.5, 0.5)));
    let blended = materials.add(StandardMaterial {
        alpha_mode: AlphaMode::Blend,
        ..matt(Color::srgba(1.0, 1.0, 0.2, 0.5))
    });
    world.spawn((
        Mesh3d(ground),
        MeshMaterial3d(grey),
        Transform::from_xyz(0.0, -1.0, 0.0),
    ));
    for (i, colour) in colours.into_iter().enumerate() {
        let x = 3.0 * (i as f32 - 2.0);
        world.spawn((
            Mesh3d(cube.clone()),
            MeshMaterial3d(colour),
            Transform::from_xyz(x, 0.2 * i as f32, 0.0)
                .with_rotation(Quat::from_rotation_y(0.4 * i as f32)),
        ));
        world.spawn((
            PointLight {
                color: Color::hsl(72.0 * i as f32 + 40.0, 0.9, 0.6),
                intensity: 60_000.0,
                range: 5.0,
                ..default()
            },
            Transform::from_xyz(x, 1.0, 3.0),
        ));
    }
    world.spawn((
        Mesh3d(sphere),
        MeshMaterial3d(blended),
        Transform::from_xyz(-3.5, 1.0, 4.0),
    ));
    world.spawn((
        DirectionalLight {
            illuminance: 1500.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-1.0, -2.0, -1.5), Vec3::Y),
    ));
    let colours = [[200, 40, 40], [40, 200, 40], [90, 160, 250]];
    let mut sky = Image::new(
        Extent3d {
            width: 2,
            height: 2,
            depth_or_array_layers: 6,
        },
        TextureDimension::D2,
        (0..24u8)
            .flat_map(|texel| {
                let face = usize::from(texel / 8);
                let [r, g, b] = colours[face].map(|c: u8| c.saturating_sub(30 * (texel % 4)));
                [r, g, b, 255]
            })
            .collect(),
        TextureFormat::Rgba8UnormSrgb,
        RenderAssetUsages::default(),
    );
    sky.texture_view_descriptor = Some(TextureViewDescriptor {
        dimension: Some(TextureViewDimension::Cube),
        ..default()
    });
    let sky = world.resource_mut::<Assets<Image>>().add(sky);
    Some((offline, sky))
}

fn with_sky(sky: &Handle<Image>) -> Skybox {
    Skybox {
        image: Some(sky.clone()),
        brightness: 300.0,
        ..default()
    }
}

fn settle(offline: &mut Offline) {
    for _ in 0..5 {
        offline.step();
    }
}

fn render_world(offline: &mut Offline) -> &mut World {
    offline
        .app
        .get_sub_app_mut(RenderApp)
        .expect("it renders")
        .world_mut()
}

/// Cameras scaled, passes run, pipelines queued, things made.
fn work(offline: &mut Offline) -> (usize, u64, usize, u64) {
    let world = render_world(offline);
    let upscalers = world.resource::<Upscalers>();
    (
        upscalers.cameras.len(),
        upscalers.passes,
        world.resource::<UpscalePipelines>().count(),
        upscalers.made,
    )
}

/// Draws with a scaled camera and with one whose target has the smaller size.
pub fn drawn_twice<B: Bundle>(
    offline: &mut Offline,
    size: UVec2,
    scale: f32,
    camera: impl Fn() -> B,
) -> [RgbaImage; 2] {
    let small_size = ResolutionScale(scale).drawn_size(size);
    let [large, small] = [size, small_size].map(|size| target(offline, size));
    let scaled = offline.camera(&large, (plain(), camera(), ResolutionScale(scale)));
    let smaller = offline.camera(&small, (plain(), camera()));
    settle(offline);
    assert_eq!(work(offline).0, 1, "the camera is scaled");
    let pictures = [large, small].map(|target| offline.picture(&target).expect("it can be read"));
    for camera in [scaled, smaller] {
        offline.app.world_mut().despawn(camera);
    }
    offline.step();
    pictures
}

#[test]
fn it_is_the_stretch_of_a_smaller_picture() {
    let Some((mut offline, sky)) = scene() else {
        return;
    };
    let offline = &mut offline;
    let check = |name: &str, unknown: f64, [large, small]: [RgbaImage; 2]| {
        keep(&format!("{name}_large"), &large);
        keep(&format!("{name}_small"), &small);
        let (wrong, compared) = outside(&large, &small, unknown);
        assert!(compared > 10_000);
        assert_eq!(wrong, 0, "{name}: of {compared} colours");
        // The comparison would notice: a picture moved by one pixel is not within it.
        let mut moved = large.clone();
        image::imageops::replace(&mut moved, &large, 1, 0);
        assert!(outside(&moved, &small, unknown).0 > compared / 50, "{name}");
    };
    let sky = || with_sky(&sky);
    check(
        "plain",
        0.0,
        drawn_twice(offline, SIZE, 0.5, || (Msaa::Off, sky())),
    );
    check(
        "msaa",
        0.0,
        drawn_twice(offline, SIZE, 0.5, || (Msaa::Sample4, sky())),
    );
    let prepasses = || (DepthPrepass, NormalPrepass, sky());
    check(
        "prepass",
        0.0,
        drawn_twice(offline, SIZE, 0.5, || (Msaa::Off, prepasses())),
    );
    check(
        "prepass_msaa",
        0.0,
        drawn_twice(offline, SIZE, 0.5, || (Msaa::Sample4, prepasses())),
    );
    let hdr = || (Hdr, Tonemapping::None, sky());
    check(
        "hdr",
        WRITTEN,
        drawn_twice(offline, SIZE, 0.5, || (Msaa::Off, hdr())),
    );
    check(
        "hdr_msaa",
        WRITTEN,
        drawn_twice(offline, SIZE, 0.5, || (Msaa::Sample4, hdr())),
    );
    // Sides whose aspect is kept exactly; others have a slightly different lens in the smaller camera.
    for scale in [0.25, 0.75] {
        check(
            &format!("scale_{scale}"),
            0.0,
            drawn_twice(offline, UVec2::new(160, 96), scale, || (Msaa::Off, sky())),
        );
    }
    let world = offline.app.world_mut();
    let ball = world.resource_mut::<Assets<Mesh>>().add(Sphere::new(1.2));
    let glass = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            base_color: Color::WHITE,
            specular_transmission: 0.9,
            thickness: 0.5,
            ior: 1.3,
            perceptual_roughness: 0.1,
            ..default()
        });
    let place = Transform::from_xyz(3.5, 1.0, 4.0);
    let glass = world
        .spawn((Mesh3d(ball), MeshMaterial3d(glass), place))
        .id();
    check(
        "glass",
        SAMPLED + WRITTEN,
        drawn_twice(offline, SIZE, 0.5, || (Msaa::Off, sky())),
    );
    offline.app.world_mut().despawn(glass);
    offline
        .app
        .insert_resource(DefaultOpaqueRendererMethod::deferred());
    check(
        "deferred",
        0.0,
        drawn_twice(offline, SIZE, 0.5, || {
            (Msaa::Off, DepthPrepass, DeferredPrepass, sky())
        }),
    );
}

#[test]
fn in_viewports_nothing_else_is_touched_and_nothing_else_seen() {
    let Some((mut offline, sky)) = scene() else {
        return;
    };
    let viewports = [
        (UVec2::new(10, 6), UVec2::new(64, 48)),
        (UVec2::new(80, 20), UVec2::new(72, 56)),
    ];
    let target = target(&mut offline, SIZE);
    let mut smaller = Vec::new();
    let mut scaled = Vec::new();
    for (i, (at, size)) in viewports.into_iter().enumerate() {
        let camera = Camera {
            viewport: Some(Viewport {
                physical_position: at,
                physical_size: size,
                ..default()
            }),
            order: i as isize,
            ..default()
        };
        let bundle = || (plain(), Msaa::Off, with_sky(&sky));
        scaled.push(offline.camera(&target, (bundle(), camera)));
        let small = self::target(&mut offline, size / 2);
        offline.camera(&small, bundle());
        smaller.push(small);
    }
    settle(&mut offline);
    let before = offline.picture(&target).unwrap();
    for camera in scaled {
        offline
            .app
            .world_mut()
            .entity_mut(camera)
            .insert(ResolutionScale(0.5));
    }
    settle(&mut offline);
    let after = offline.picture(&target).unwrap();
    keep("split_before", &before);
    keep("split_after", &after);
    assert_eq!(work(&mut offline).0, 2);
    let mut beside = 0;
    for (x, y, pixel) in after.enumerate_pixels() {
        let p = UVec2::new(x, y);
        let within = |(at, size): &(UVec2, UVec2)| p.cmpge(*at).all() && p.cmplt(*at + *size).all();
        if !viewports.iter().any(within) {
            assert_eq!(pixel, before.get_pixel(x, y), "{p}");
            beside += 1;
        }
    }
    assert!(beside > 5_000);
    for ((at, size), small) in viewports.into_iter().zip(&smaller) {
        let small = offline.picture(small).unwrap();
        let (wrong, compared) = outside(&part(&after, at, size), &small, 0.0);
        assert_eq!(wrong, 0, "of {compared} at {at}");
    }
}

/// The mean over all colours, in 8-bit units.
fn mean_difference(a: &RgbaImage, b: &RgbaImage) -> f64 {
    let sum: f64 = (a.as_raw().iter().zip(b.as_raw()))
        .map(|(a, b)| f64::from(a.abs_diff(*b)))
        .sum();
    sum / a.as_raw().len() as f64
}

fn bytes_of(picture: &LinearPicture) -> RgbaImage {
    let mut bytes = RgbaImage::new(picture.size.x, picture.size.y);
    for (to, from) in bytes.pixels_mut().zip(&picture.pixels) {
        let [r, g, b] = [from.x, from.y, from.z].map(|c| encoded(c).round() as u8);
        to.0 = [r, g, b, 255];
    }
    bytes
}

#[test]
fn it_resembles_the_full_picture_and_does_not_shift() {
    let Some((mut offline, sky)) = scene() else {
        return;
    };
    let bundle = || (plain(), Msaa::Sample4, with_sky(&sky));
    let [full, scaled] = [1.0, 0.5].map(|scale| {
        let target = offline.target(SIZE);
        offline.camera(&target, (bundle(), ResolutionScale(scale)));
        target
    });
    settle(&mut offline);
    let [full, scaled] = [full, scaled].map(|target| offline.picture(&target).unwrap());
    keep("resembles_full", &full);
    keep("resembles_half", &scaled);
    // The best that so many pixels can hold: each the mean of the four it stands for.
    let of_full = of_bytes(&full, linear);
    let mean = LinearPicture {
        size: HALF,
        pixels: (0..HALF.y)
            .flat_map(|y| (0..HALF.x).map(move |x| (x, y)))
            .map(|(x, y)| {
                let at = |i, j| of_full.pixels[((2 * y + j) * SIZE.x + 2 * x + i) as usize];
                0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1))
            })
            .collect(),
    };
    let least = mean_difference(&full, &bytes_of(&stretch(&mean, SIZE)));
    let got = mean_difference(&full, &scaled);
    println!("mean difference {got:.3}, of the mean of the full picture {least:.3}");
    assert!(least > 0.1, "a picture without detail shows nothing");
    // Four samples a drawn pixel stand for sixteen a pixel of the mean. Each is off by what its pixel spans, which the
    // detail that is lost already measures; twice covers both, and a unit the rounding of two pictures.
    assert!(got < 2.0 * least + 1.0, "{got} > 2 * {least} + 1");
    // Moved by a single pixel it would fit worse, whichever way.
    for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
        let inner = part(&full, UVec2::splat(2), SIZE - 4);
        let at = |dx: i32, dy: i32| IVec2::new(2 + dx, 2 + dy).as_uvec2();
        let still = mean_difference(&inner, &part(&scaled, at(0, 0), SIZE - 4));
        let moved = mean_difference(&inner, &part(&scaled, at(dx, dy), SIZE - 4));
        assert!(moved > 1.2 * still, "{dx} {dy}: {moved} against {still}");
    }
}

#[test]
fn edges_stay_within_half_a_drawn_pixel() {
    let Some(mut offline) = crate::device() else {
        return;
    };
    let world = offline.app.world_mut();
    world.insert_resource(ClearColor(Color::BLACK));
    let square = world
        .resource_mut::<Assets<Mesh>>()
        .add(Rectangle::new(20.0, 20.0));
    let white = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            base_color: Color::WHITE,
            unlit: true,
            ..default()
        });
    // Its left and lower edges cross the picture, each a little aslant so that they meet every phase of the pixels.
    world.spawn((
        Mesh3d(square),
        MeshMaterial3d(white),
        Transform::from_xyz(10.0, 10.0, -10.0).with_rotation(Quat::from_rotation_z(0.05)),
    ));
    for (scale, size) in [(0.5, SIZE), (0.25, SIZE), (0.7, UVec2::new(151, 83))] {
        let [full, scaled] = [1.0, scale].map(|scale| {
            let target = offline.target(size);
            let camera = (
                Msaa::Sample4,
                DebandDither::Disabled,
                Tonemapping::None,
                ResolutionScale(scale),
            );
            (target.clone(), offline.camera(&target, camera))
        });
        settle(&mut offline);
        let pictures = [&full, &scaled].map(|(target, _)| offline.picture(target).unwrap());
        keep(&format!("edge_{scale}_full"), &pictures[0]);
        keep(&format!("edge_{scale}"), &pictures[1]);
        for (_, camera) in [full, scaled] {
            offline.app.world_mut().despawn(camera);
        }
        let [full, scaled] = pictures.map(|picture| of_bytes(&picture, linear));
        let light = |picture: &LinearPicture, x: u32, y: u32| {
            picture.pixels[(y * picture.size.x + x) as usize].x
        };
        // The dark part's length along a row's or column's way: where its edge lies, to a share of a pixel.
        let row = |p: &LinearPicture, y| (0..size.x).map(|x| 1.0 - light(p, x, y)).sum::<f64>();
        let column = |p: &LinearPicture, x| (0..size.y).map(|y| light(p, x, y)).sum::<f64>();
        let half_px = 0.5 / f64::from(scale);
        for (name, edges) in [
            (
                "rows",
                (0..size.y / 3)
                    .map(|y| row(&scaled, y) - row(&full, y))
                    .collect::<Vec<f64>>(),
            ),
            (
                "columns",
                (size.x * 2 / 3..size.x)
                    .map(|x| column(&scaled, x) - column(&full, x))
                    .collect(),
            ),
        ] {
            let most = edges.iter().fold(0.0, |most: f64, e| most.max(e.abs()));
            let mean = edges.iter().sum::<f64>() / edges.len() as f64;
            println!("scale {scale}, {name}: off by {most:.3} px at most, {mean:.3} in the mean");
            assert!(most <= half_px, "scale {scale}, {name}: {most}");
            assert!(
                mean.abs() <= 0.25 * half_px,
                "scale {scale}, {name}: {mean}"
            );
        }
    }
}

#[test]
fn at_one_or_without_it_nothing_runs_and_removal_gives_everything_back() {
    let Some((mut offline, sky)) = scene() else {
        return;
    };
    let target = offline.target(SIZE);
    let camera = offline.camera(&target, (plain(), Msaa::Off, with_sky(&sky)));
    let set = |offline: &mut Offline, scale: Option<f32>| {
        let mut entity = offline.app.world_mut().entity_mut(camera);
        match scale {
            Some(scale) => entity.insert(ResolutionScale(scale)),
            None => entity.remove::<ResolutionScale>(),
        };
        settle(offline);
    };
    let overrides = |offline: &mut Offline| {
        let world = render_world(offline);
        let mut query = world.query::<&MainPassResolutionOverride>();
        query.iter(world).count()
    };
    settle(&mut offline);
    let full = offline.picture(&target).unwrap();
    for scale in [None, Some(1.0), Some(7.0), Some(f32::NAN)] {
        set(&mut offline, scale);
        assert_eq!(work(&mut offline), (0, 0, 0, 0), "{scale:?}");
        assert_eq!(overrides(&mut offline), 0, "{scale:?}");
        assert_eq!(offline.picture(&target).unwrap(), full);
    }
    set(&mut offline, Some(0.5));
    let (cameras, passes, pipelines, _) = work(&mut offline);
    assert_eq!((cameras, pipelines, overrides(&mut offline)), (1, 1, 1));
    // All frames but the first ones, in which the pipeline was not there yet.
    assert!((1..=4).contains(&passes), "{passes}");
    let half = offline.picture(&target).unwrap();
    assert!(differing_px(&half, &full) > 1000);
    for scale in [Some(1.0), None] {
        set(&mut offline, Some(0.5));
        assert_eq!(offline.picture(&target).unwrap(), half);
        let passes = work(&mut offline).1;
        set(&mut offline, scale);
        let after = work(&mut offline);
        assert_eq!((after.0, after.1), (0, passes), "{scale:?}");
        assert_eq!(overrides(&mut offline), 0, "{scale:?}");
        assert_eq!(offline.picture(&target).unwrap(), full, "{scale:?}");
    }
    // A camera that is switched off, and one that is despawned, hold nothing either.
    set(&mut offline, Some(0.5));
    let active = |offline: &mut Offline, is_active| {
        let mut entity = offline.app.world_mut().entity_mut(camera);
        entity.get_mut::<Camera>().unwrap().is_active = is_active;
        settle(offline);
    };
    active(&mut offline, false);
    assert_eq!((work(&mut offline).0, overrides(&mut offline)), (0, 0));
    active(&mut offline, true);
    assert_eq!(offline.picture(&target).unwrap(), half);
    offline.app.world_mut().despawn(camera);
    settle(&mut offline);
    assert_eq!((work(&mut offline).0, overrides(&mut offline)), (0, 0));
}

#[test]
fn a_scale_that_changes_every_frame_makes_nothing_anew() {
    let Some((mut offline, sky)) = scene() else {
        return;
    };
    let field = HeightField::from_fn(UVec2::new(65, 65), 1.0, (-3.0, 3.0), |x, z| {
        (x as f32 * 0.3).sin() + (z as f32 * 0.2).cos()
    })
    .unwrap();
    let field = offline
        .app
        .world_mut()
        .resource_mut::<Assets<HeightField>>()
        .add(field);
    offline
        .app
        .world_mut()
        .spawn((Terrain::new(field), Transform::from_xyz(-32.0, -2.0, -50.0)));
    let target = offline.target(SIZE);
    let camera = offline.camera(
        &target,
        (
            plain(),
            Msaa::Off,
            with_sky(&sky),
            always(),
            ResolutionScale(0.5),
        ),
    );
    settle(&mut offline);
    settle(&mut offline);
    let textures = |offline: &mut Offline| -> [TextureId; 2] {
        let views = render_world(offline).resource::<TerrainViews>();
        let targets = views.views[&camera].targets.as_ref().unwrap();
        [targets.depth.id(), targets.surface.id()]
    };
    let held = textures(&mut offline);
    let (_, passes, pipelines, made) = work(&mut offline);
    let bytes = |offline: &Offline| offline.counts().view_bytes;
    let before = bytes(&offline);
    let mut sizes = Vec::new();
    for frame in 0..40 {
        let scale = 0.25 + 0.7 * (frame as f32 * 0.7).sin().abs();
        offline
            .app
            .world_mut()
            .entity_mut(camera)
            .insert(ResolutionScale(scale));
        offline.step();
        let hits = offline.hits(camera).unwrap().expect("terrain is in view");
        assert_eq!(hits.size, ResolutionScale(scale).drawn_size(SIZE));
        sizes.push(hits.size);
    }
    sizes.sort_by_key(|size| size.x);
    sizes.dedup();
    assert!(sizes.len() > 20);
    // Bevy's two main textures may both have been read by now.
    let (cameras, passes_after, pipelines_after, made_after) = work(&mut offline);
    assert_eq!((cameras, passes_after - passes), (1, 40));
    assert_eq!(pipelines_after, pipelines);
    assert!(
        made_after <= 3 && made_after - made <= 1,
        "{made} to {made_after}"
    );
    assert_eq!(textures(&mut offline), held);
    assert_eq!(bytes(&offline), before);

    let world = render_world(&mut offline);
    let system = world.register_system(scale_main_passes);
    world.run_system(system).unwrap();
    let allocations = crate::allocations::count(|| {
        for _ in 0..10 {
            world.run_system(system).unwrap();
        }
    });
    assert_eq!(allocations, 0);
}

#[test]
fn room_is_what_the_layout_takes() {
    for viewport in [(1, 1), (160, 90), (1281, 719), (7, 4000)] {
        for block in [(1, 1), (3, 2), (64, 64)] {
            let (viewport, block) = (UVec2::from(viewport), UVec2::from(block));
            assert_eq!(
                room_for(viewport, block),
                texel_count(&layout(viewport, block))
            );
        }
    }
}

#[test]
fn someone_elses_override_is_left_alone() {
    let Some((mut offline, sky)) = scene() else {
        return;
    };
    let target = offline.target(SIZE);
    let camera = offline.camera(&target, (plain(), Msaa::Off, with_sky(&sky)));
    settle(&mut offline);
    let render = offline
        .app
        .world()
        .get::<RenderEntity>(camera)
        .unwrap()
        .id();
    let set = |offline: &mut Offline, size: Option<UVec2>| {
        let mut entity = render_world(offline).entity_mut(render);
        match size {
            Some(size) => entity.insert(MainPassResolutionOverride(size)),
            None => entity.remove::<MainPassResolutionOverride>(),
        };
    };
    let given = |offline: &mut Offline| {
        let world = render_world(offline);
        world.get::<MainPassResolutionOverride>(render).map(|o| o.0)
    };
    let own = UVec2::new(100, 50);
    set(&mut offline, Some(own));
    settle(&mut offline);
    let theirs = offline.picture(&target).unwrap();
    offline
        .app
        .world_mut()
        .entity_mut(camera)
        .insert(ResolutionScale(0.5));
    settle(&mut offline);
    assert_eq!(work(&mut offline).0, 0);
    assert_eq!(given(&mut offline), Some(own));
    assert_eq!(offline.picture(&target).unwrap(), theirs);
    // Without it the scale works; put over the scale's, it holds again, and stays when the scale goes.
    set(&mut offline, None);
    settle(&mut offline);
    assert_eq!(given(&mut offline), Some(HALF));
    set(&mut offline, Some(own));
    settle(&mut offline);
    assert_eq!((work(&mut offline).0, given(&mut offline)), (0, Some(own)));
    assert_eq!(offline.picture(&target).unwrap(), theirs);
    offline
        .app
        .world_mut()
        .entity_mut(camera)
        .remove::<ResolutionScale>();
    settle(&mut offline);
    assert_eq!(given(&mut offline), Some(own));
}

#[test]
fn what_cannot_be_stretched_is_drawn_in_full() {
    fn stays_full(offline: &mut Offline, name: &str, bundle: impl Bundle) {
        let target = offline.target(SIZE);
        let camera = (plain(), Msaa::Off, bundle, ResolutionScale(0.5));
        let camera = offline.camera(&target, camera);
        settle(offline);
        assert_eq!(work(offline), (0, 0, 0, 0), "{name}");
        let told = state(offline);
        assert!(
            told.starts_with("idle: it ") && told.contains(": "),
            "{name}: {told}"
        );
        offline.app.world_mut().despawn(camera);
        offline.step();
    }
    let Some((mut offline, _)) = scene() else {
        return;
    };
    let offline = &mut offline;
    let over = Camera {
        clear_color: ClearColorConfig::None,
        ..default()
    };
    stays_full(offline, "draws over others", over);
    stays_full(offline, "jitter", TemporalJitter::default());
    stays_full(offline, "motion", MotionVectorPrepass);
    stays_full(offline, "occlusion", ScreenSpaceAmbientOcclusion::default());
    stays_full(offline, "contact", ContactShadows::default());
    stays_full(offline, "fog", VolumetricFog::default());
    stays_full(offline, "culling", (DepthPrepass, OcclusionCulling));
    stays_full(offline, "reflections", ScreenSpaceReflections::default());
}

/// What users are told.
fn state(offline: &Offline) -> String {
    let effects = offline.app.world().resource::<Effects>();
    effects.resolution_scale().to_string()
}

#[test]
fn what_it_does_is_told_in_words() {
    let Some((mut offline, _)) = scene() else {
        return;
    };
    settle(&mut offline);
    assert!(state(&offline).starts_with("dormant"));
    let target = offline.target(SIZE);
    let camera = offline.camera(&target, (plain(), Msaa::Off, ResolutionScale(1.0)));
    settle(&mut offline);
    assert_eq!(
        state(&offline),
        "idle: its scale is 1: all pixels are drawn"
    );
    let scale = |offline: &mut Offline, to| {
        let world = offline.app.world_mut();
        world.entity_mut(camera).insert(ResolutionScale(to));
        settle(offline);
    };
    scale(&mut offline, 0.5);
    let size = ResolutionScale(0.5).drawn_size(SIZE);
    let words = format!(
        "{}×{} of {}×{} pixels drawn",
        size.x, size.y, SIZE.x, SIZE.y
    );
    assert!(state(&offline).contains(&words), "{}", state(&offline));
    let held = |offline: &Offline| {
        let effects = offline.app.world().resource::<Effects>();
        effects.bytes(Effect::ResolutionScale)
    };
    assert_eq!(held(&offline), size_of::<GpuStretch>() as u64);
    // One that cannot be scaled does not hide one that is.
    let over = Camera {
        clear_color: ClearColorConfig::None,
        order: 1,
        ..default()
    };
    let other = offline.camera(&target, (over, Msaa::Off, ResolutionScale(0.5)));
    settle(&mut offline);
    let told = state(&offline);
    assert!(
        told.contains(&words) && told.contains(FullSize::DrawsOverOthers.reason()),
        "{told}"
    );
    offline.app.world_mut().despawn(other);
    let world = offline.app.world_mut();
    world
        .entity_mut(camera)
        .get_mut::<Camera>()
        .unwrap()
        .is_active = false;
    settle(&mut offline);
    assert_eq!(
        state(&offline),
        "idle: no camera that asks for it is active"
    );
    offline.app.world_mut().despawn(camera);
    settle(&mut offline);
    assert!(state(&offline).starts_with("dormant"));
    assert_eq!(held(&offline), 0);
}

#[test]
fn a_resized_target_is_followed() {
    let Some((mut offline, sky)) = scene() else {
        return;
    };
    let bundle = || (plain(), Msaa::Off, with_sky(&sky));
    let target = offline.target(SIZE);
    let camera = offline.camera(&target, (bundle(), ResolutionScale(0.5)));
    settle(&mut offline);
    for size in [UVec2::new(96, 120), UVec2::new(202, 64)] {
        let [target, small] = [size, size / 2].map(|size| self::target(&mut offline, size));
        offline
            .app
            .world_mut()
            .entity_mut(camera)
            .insert(RenderTarget::Image(target.clone().into()));
        let smaller = offline.camera(&small, bundle());
        settle(&mut offline);
        let [large, small] = [&target, &small].map(|target| offline.picture(target).unwrap());
        assert_eq!(outside(&large, &small, 0.0).0, 0, "{size}");
        offline.app.world_mut().despawn(smaller);
    }
}

#[test]
fn with_occlusion_culling_nothing_goes_missing() {
    let check = |name: &str, msaa: Msaa, prepass: bool, wanders: bool| {
        let Some(mut scene) = Scene::new(always(), || (msaa, ResolutionScale(0.5))) else {
            return;
        };
        if prepass {
            for camera in [scene.culling, scene.plain] {
                let mut entity = scene.offline.app.world_mut().entity_mut(camera);
                entity.insert((DepthPrepass, NormalPrepass));
            }
        }
        settle(&mut scene.offline);
        let mut removed = 0;
        for frame in 0..40 {
            let t = frame as f32;
            if wanders {
                let scale = 0.25 + 0.7 * (t * 0.7).sin().abs();
                for camera in [scene.culling, scene.plain] {
                    let mut entity = scene.offline.app.world_mut().entity_mut(camera);
                    entity.insert(ResolutionScale(scale));
                }
            }
            let side = 9.0 * (t * 0.3).sin();
            scene.look(eye(
                Vec3::new(side, 2.0, 20.0),
                Vec3::new(0.3 * side, 2.0, 0.0),
            ));
            removed += scene.step().removed;
            let (differ, shown) = scene.differing();
            assert_eq!(differ, 0, "{name}, frame {frame}");
            assert!(shown > 1000, "{name}, frame {frame}");
        }
        assert!(removed > 500, "{name}: {removed} removed in all");
    };
    check("plain", Msaa::Off, false, false);
    check("msaa", Msaa::Sample4, false, false);
    check("prepass", Msaa::Off, true, false);
    check("changing", Msaa::Off, false, true);
}

fn hills(offline: &mut Offline) {
    let field = HeightField::from_fn(UVec2::new(101, 101), 4.0, (0.0, 60.0), |x, z| {
        let (x, z) = (x as f32 * 0.13, z as f32 * 0.17);
        20.0 + 10.0 * x.sin() + 10.0 * z.cos()
    })
    .unwrap();
    let world = offline.app.world_mut();
    let field = world.resource_mut::<Assets<HeightField>>().add(field);
    world.spawn(Terrain::new(field));
    world.spawn((
        DirectionalLight {
            illuminance: 3_000.0,
            ..default()
        },
        Transform::from_xyz(1.0, 2.0, 0.5).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    // A mesh in it, that rays stop at where there is a prepass.
    let cube = world
        .resource_mut::<Assets<Mesh>>()
        .add(Cuboid::from_length(40.0));
    let red = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial::from_color(Color::srgb(0.8, 0.1, 0.1)));
    world.spawn((
        Mesh3d(cube),
        MeshMaterial3d(red),
        Transform::from_xyz(200.0, 30.0, 200.0),
    ));
}

fn over_hills() -> Transform {
    eye(Vec3::new(200.0, 90.0, 380.0), Vec3::new(200.0, 10.0, 150.0))
}

fn same_hits(a: &HitImage, b: &HitImage) -> usize {
    assert_eq!(a.size, b.size);
    let depths = a.ndc_depth.iter().zip(&b.ndc_depth);
    depths.filter(|(a, b)| a.to_bits() == b.to_bits()).count()
}

#[test]
fn terrain_is_cast_for_the_pixels_drawn() {
    let Some(mut offline) = crate::device() else {
        return;
    };
    hills(&mut offline);
    let viewport = (UVec2::new(70, 30), UVec2::new(64, 48));
    for traversal in [Traversal::Hybrid, Traversal::Boxes, Traversal::MaxMip] {
        for (name, msaa, prepass, within) in [
            ("whole", Msaa::Off, false, None),
            ("msaa", Msaa::Sample4, false, None),
            ("prepass", Msaa::Off, true, None),
            ("viewport", Msaa::Off, true, Some(viewport)),
        ] {
            let size = within.map_or(SIZE, |(_, size)| size);
            let [target, small] = [SIZE, size / 2].map(|size| target(&mut offline, size));
            let bundle = || {
                let casting = TerrainRayCasting {
                    traversal,
                    ..default()
                };
                (over_hills(), msaa, DebandDither::Disabled, casting)
            };
            let camera = Camera {
                viewport: within.map(|(at, size)| Viewport {
                    physical_position: at,
                    physical_size: size,
                    ..default()
                }),
                ..default()
            };
            let scaled = offline.camera(&target, (bundle(), camera, ResolutionScale(0.5)));
            let smaller = offline.camera(&small, bundle());
            if prepass {
                for camera in [scaled, smaller] {
                    offline
                        .app
                        .world_mut()
                        .entity_mut(camera)
                        .insert(DepthPrepass);
                }
            }
            offline.settle(scaled, 60).unwrap();
            offline.settle(smaller, 60).unwrap();
            settle(&mut offline);
            let name = format!("{traversal:?}, {name}");
            let [of_scaled, of_smaller] =
                [scaled, smaller].map(|camera| offline.hits(camera).unwrap().unwrap());
            let all = of_smaller.ndc_depth.len();
            let same = same_hits(&of_scaled, &of_smaller);
            assert_eq!(same, all, "{name}: rays that hit the same");
            let terrain = of_smaller.surface.iter().filter(|s| *s & 0xff != 0).count();
            assert!(terrain > all / 4, "{name}: {terrain} of {all}");
            let [large, small] = [&target, &small].map(|target| offline.picture(target).unwrap());
            let large = match within {
                Some((at, size)) => part(&large, at, size),
                None => large,
            };
            keep(&format!("terrain_{}", name.replace(", ", "_")), &large);
            assert_eq!(outside(&large, &small, 0.0).0, 0, "{name}");
            for camera in [scaled, smaller] {
                offline.app.world_mut().despawn(camera);
            }
            offline.step();
        }
    }
}

#[test]
fn rays_stop_at_meshes_of_their_own_viewport() {
    let Some(mut offline) = crate::device() else {
        return;
    };
    hills(&mut offline);
    let size = UVec2::new(64, 48);
    let target = offline.target(SIZE);
    let [first, second] = [UVec2::new(0, 0), UVec2::new(90, 40)].map(|at| {
        let camera = Camera {
            viewport: Some(Viewport {
                physical_position: at,
                physical_size: size,
                ..default()
            }),
            order: at.x as isize,
            ..default()
        };
        offline.camera(&target, (over_hills(), Msaa::Off, DepthPrepass, camera))
    });
    offline.settle(first, 60).unwrap();
    offline.settle(second, 60).unwrap();
    let [a, b] = [first, second].map(|camera| offline.hits(camera).unwrap().unwrap());
    assert_eq!(same_hits(&a, &b), a.ndc_depth.len());
}
