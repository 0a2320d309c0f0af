// Not a module of the crate: the examples in its documentation include it.

use bevy::{
    camera::RenderTarget,
    prelude::*,
    render::{RenderPlugin, settings::WgpuSettings},
    window::{ExitCondition, WindowPlugin},
};

/// `DefaultPlugins` and `SkylinePlugins`, without a window and without a GPU: what the main world does can be seen, and
/// nothing is drawn.
pub fn app() -> App {
    let plugins = DefaultPlugins
        .set(WindowPlugin {
            primary_window: None,
            exit_condition: ExitCondition::DontExit,
            ..default()
        })
        .set(RenderPlugin {
            render_creation: WgpuSettings {
                backends: None,
                ..default()
            }
            .into(),
            ..default()
        })
        // A process has one log, and these have several apps.
        .disable::<bevy::log::LogPlugin>();
    #[cfg(feature = "window")]
    let plugins = plugins.disable::<bevy::winit::WinitPlugin>();
    let mut app = App::new();
    app.add_plugins((plugins, bevy_skyline::prelude::SkylinePlugins));
    app.finish();
    app.cleanup();
    app
}

/// Where cameras of that app draw to.
#[allow(dead_code, reason = "not every example has a camera")]
pub fn target() -> RenderTarget {
    let size = UVec2::new(1280, 720);
    RenderTarget::None { size }
}
