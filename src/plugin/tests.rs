//! What is built works without what is not: run with each effect alone by `scripts/features.sh --run`, and here with
//! whatever the features are.

use bevy::{
    app::PluginsState,
    asset::RenderAssetUsages,
    camera::RenderTarget,
    log::LogPlugin,
    prelude::*,
    render::{
        pipelined_rendering::PipelinedRenderingPlugin, render_resource::TextureFormat,
        renderer::RenderDevice,
    },
    window::ExitCondition,
};

use super::SkylinePlugins;
use crate::effects::{Effect, EffectState, Effects};

/// A headless app with all that is built.
fn app() -> App {
    let plugins = DefaultPlugins
        .set(WindowPlugin {
            primary_window: None,
            exit_condition: ExitCondition::DontExit,
            ..default()
        })
        .disable::<LogPlugin>()
        .disable::<PipelinedRenderingPlugin>();
    #[cfg(feature = "window")]
    let plugins = plugins.disable::<bevy::winit::WinitPlugin>();
    let mut app = App::new();
    app.add_plugins((plugins, SkylinePlugins));
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
    app
}

/// A camera and a box, with everything on them that asks for an effect; and a terrain.
fn ask_for_all(world: &mut World) {
    let size = UVec2::splat(64);
    let mut image = Image::new_target_texture(size.x, size.y, TextureFormat::Rgba8UnormSrgb, None);
    image.asset_usage = RenderAssetUsages::default();
    let image = world.resource_mut::<Assets<Image>>().add(image);
    let camera = (
        Camera3d::default(),
        Msaa::Off,
        RenderTarget::Image(image.into()),
        Transform::from_xyz(8.0, 12.0, 8.0).looking_at(Vec3::ZERO, Vec3::Y),
    );
    let camera = world.spawn(camera).id();
    let mesh = world.resource_mut::<Assets<Mesh>>().add(Cuboid::default());
    let material = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial::default());
    let cube = world.spawn((Mesh3d(mesh), MeshMaterial3d(material))).id();
    let light = DirectionalLight {
        shadow_maps_enabled: true,
        ..default()
    };
    world.spawn((light, Transform::default().looking_to(-Vec3::ONE, Vec3::Y)));
    #[cfg(feature = "budget")]
    world.entity_mut(camera).insert((
        crate::budget::FrameBudget::from_ms(1.0),
        crate::resolution::ResolutionScale(0.5),
    ));
    #[cfg(feature = "culling")]
    world.entity_mut(camera).insert((
        crate::contribution::ContributionCulling::default(),
        crate::occlusion::ZBufferOcclusion::default(),
    ));
    #[cfg(feature = "interior")]
    world
        .entity_mut(cube)
        .insert(crate::interior::InteriorCulling::default());
    #[cfg(feature = "spherical")]
    world
        .entity_mut(cube)
        .insert(crate::spherical::SphericalIndex::default());
    #[cfg(feature = "terrain")]
    {
        let field = crate::terrain::HeightField::from_fn(size, 1.0, (0.0, 8.0), |x, y| {
            ((x + y) % 8) as f32
        });
        let field = world.resource_mut::<Assets<_>>().add(field.unwrap());
        let shadow = crate::terrain_shadow::TerrainShadow::default();
        world.spawn((crate::terrain::Terrain::new(field), shadow));
    }
    let _ = (camera, cube);
}

#[test]
fn what_is_built_works_and_what_is_not_is_named() {
    let mut app = app();
    if app.world().get_resource::<RenderDevice>().is_none() {
        println!("skipped: there is no GPU driver, not even a software one");
        return;
    }
    app.update();
    for (effect, state) in app.world().resource::<Effects>().iter() {
        let EffectState::Unsupported(why) = state else {
            assert_eq!(state, &EffectState::Dormant, "{effect:?}");
            continue;
        };
        assert!(!effect.is_built(), "{effect:?}: {why}");
    }
    ask_for_all(app.world_mut());
    for _ in 0..8 {
        app.update();
    }
    let effects = app.world().resource::<Effects>();
    for effect in Effect::ALL {
        match effects.state(effect) {
            EffectState::Unsupported(why) => {
                assert!(!effect.is_built(), "{effect:?}: {why}");
                assert!(why.contains("enable bevy_skyline's feature"), "{why}");
            }
            EffectState::Dormant => panic!("{effect:?} was asked for"),
            EffectState::Idle(_) | EffectState::Active(_) => {
                assert!(effect.is_built(), "{effect:?}");
            }
        }
    }
}
