//! A panel over the picture (feature `panel`): frame times, effects, knobs, counts, and what accuracy costs.
//!
//! [`PanelPlugin`] is not one of [`SkylinePlugins`](crate::plugin::SkylinePlugins): an app that wants the panel adds
//! it. A key, F3 unless [`SkylinePanel::key`] says otherwise, opens and closes it.
//!
//! - While it is closed, nothing is gathered, drawn or held: one system looks at the key, the others do not run. The
//!   camera it is drawn by, its `egui` context, its font's texture and [`PanelData`] live from opening to closing.
//! - While it is open, it shows its own time on the CPU.
//! - It shows what of the suite is built.
//! - It changes nothing but by [`PanelRequest`], which it hears while it is open: a knob taken by hand stays so when
//!   the panel closes.
//!
//! | Where | What |
//! |---|---|
//! | [`data`] | what is shown, gathered into plain values |
//! | `budget` | what the frame budget says of itself |
//! | `stats` | the last frames and their statistics |
//! | [`counts`] | meshes that a camera does not show, by reason |
//! | [`results`] | a file of `skyline accuracy`, and its Pareto front |
//! | `axis` | an axis of a plot |
//! | [`draw`] | the widgets, functions of the data |
//!
//! It is drawn by a camera of its own, after all others, into the primary window: the scene's cameras stay as they are,
//! and whatever they do (viewports, HDR, a smaller resolution) does not touch it. `bevy_egui` is added unless the app
//! did so before; then its settings are the app's. Else it makes no context of its own accord, and input that the panel
//! uses is kept from the rest of the app.

pub(crate) mod axis;
#[cfg_attr(not(feature = "budget"), path = "no_budget.rs")]
mod budget;
pub mod counts;
pub mod data;
pub mod draw;
pub mod results;
pub(crate) mod stats;

use std::path::PathBuf;

use bevy::{
    camera::{CameraOutputMode, ClearColorConfig, visibility::RenderLayers},
    input::InputSystems,
    platform::time::Instant,
    prelude::*,
};
use bevy_egui::{
    EguiContext, EguiContextSettings, EguiFullOutput, EguiGlobalSettings, EguiInput,
    EguiManagedTextures, EguiPlugin, EguiPostUpdateSet, EguiPreUpdateSet,
    egui::{
        self,
        epaint::{ClippedPrimitive, ClippedShape, Primitive},
    },
};
use wgpu::BlendState;

pub use data::{PanelData, PanelRequest};

use crate::plugin::ReportSystems;
use data::OwnCost;
use draw::PanelView;

/// Whether the panel is open, and how.
#[derive(Resource, Reflect, Clone, Debug, PartialEq)]
#[reflect(Resource, Default, Clone, Debug, PartialEq)]
pub struct SkylinePanel {
    /// Whether it is to be seen. default: `false`
    pub open: bool,
    /// Opens and closes it; `None` leaves that to code. default: F3
    pub key: Option<KeyCode>,
    /// How wide it is; dragging its edge changes this. units: logical px, default: 400
    pub width: f32,
    /// The file of results in the plot of accuracy against time, or its directory.
    pub results: Option<PathBuf>,
}

impl Default for SkylinePanel {
    fn default() -> Self {
        Self {
            open: false,
            key: Some(KeyCode::F3),
            width: 400.0,
            results: None,
        }
    }
}

/// On the camera that draws the panel. There is one while it is open.
#[derive(Component, Clone, Copy, Debug, Default)]
pub struct PanelCamera;

/// The panel. An app with an `egui` of its own adds `EguiPlugin` before this.
pub struct PanelPlugin;

impl Plugin for PanelPlugin {
    fn build(&self, app: &mut App) {
        if !app.is_plugin_added::<EguiPlugin>() {
            #[allow(
                clippy::needless_update,
                reason = "what other fields there are depends on bevy_egui's features"
            )]
            app.add_plugins(EguiPlugin {
                // One texture, its font's, needs no binding array.
                bindless_mode_array_size: None,
                ..default()
            });
            if let Some(mut settings) = app.world_mut().get_resource_mut::<EguiGlobalSettings>() {
                settings.auto_create_primary_context = false;
                settings.enable_absorb_bevy_input_system = true;
            }
        }
        app.register_type::<SkylinePanel>()
            .init_resource::<SkylinePanel>()
            .add_message::<PanelRequest>()
            .add_systems(
                PreUpdate,
                (
                    // Before what is typed into the panel is kept from the rest of the app.
                    press_key.after(InputSystems),
                    (
                        (free_textures, open).chain().run_if(is_to_open),
                        (close, free_textures).chain().run_if(is_to_close),
                    ),
                )
                    .chain()
                    // A context made here takes part in the whole frame.
                    .before(EguiPreUpdateSet::InitContexts),
            )
            .add_systems(
                PostUpdate,
                draw_panel
                    .in_set(EguiPostUpdateSet::EndPass)
                    .run_if(resource_exists::<PanelData>),
            )
            .add_systems(
                Last,
                (data::take_dropped_files, data::apply_requests, data::gather)
                    .chain()
                    // Effects are this frame's.
                    .after(ReportSystems)
                    .run_if(resource_exists::<PanelData>),
            );
    }
}

fn press_key(keys: Option<Res<ButtonInput<KeyCode>>>, mut panel: ResMut<SkylinePanel>) {
    if let (Some(keys), Some(key)) = (keys, panel.key)
        && keys.just_pressed(key)
    {
        panel.open = !panel.open;
    }
}

/// Also where somebody else took the camera away.
fn is_to_open(panel: Res<SkylinePanel>, cameras: Query<(), With<PanelCamera>>) -> bool {
    panel.open && cameras.is_empty()
}

fn is_to_close(panel: Res<SkylinePanel>, data: Option<Res<PanelData>>) -> bool {
    !panel.open && data.is_some()
}

fn open(mut commands: Commands, panel: Res<SkylinePanel>) {
    let mut context = EguiContext::default();
    draw::style(context.get_mut());
    commands.insert_resource(PanelData::default());
    commands.insert_resource(PanelView::new(&panel));
    commands.spawn((
        Name::new("skyline panel"),
        PanelCamera,
        Camera2d,
        Msaa::Off,
        Camera {
            // Over everything.
            order: isize::MAX,
            clear_color: ClearColorConfig::Custom(Color::NONE),
            output_mode: CameraOutputMode::Write {
                // egui's colours are multiplied by their alpha.
                blend_state: Some(BlendState::PREMULTIPLIED_ALPHA_BLENDING),
                clear_color: ClearColorConfig::None,
            },
            ..default()
        },
        RenderLayers::none(),
        context,
        EguiContextSettings {
            // By `draw_panel`, so that its time is known.
            run_manually: true,
            ..default()
        },
    ));
}

fn close(mut commands: Commands, cameras: Query<Entity, With<PanelCamera>>) {
    for camera in &cameras {
        commands.entity(camera).despawn();
    }
    commands.remove_resource::<PanelData>();
    commands.remove_resource::<PanelView>();
}

/// bevy_egui keeps the textures of a context whose entity is gone.
fn free_textures(
    contexts: Query<(), With<EguiContext>>,
    textures: Option<ResMut<EguiManagedTextures>>,
) {
    if let Some(mut textures) = textures {
        textures.retain(|(context, _), _| contexts.contains(*context));
    }
}

/// Lays out and tessellates the panel.
fn draw_panel(
    mut contexts: Query<
        (
            &Camera,
            &mut EguiContext,
            &mut EguiInput,
            &mut EguiFullOutput,
        ),
        With<PanelCamera>,
    >,
    mut panel: ResMut<SkylinePanel>,
    mut data: ResMut<PanelData>,
    mut view: ResMut<PanelView>,
    mut requests: MessageWriter<PanelRequest>,
) {
    let began = Instant::now();
    let key = panel
        .key
        .map_or_else(String::new, |key| format!(" · {key:?} closes"));
    let mut asked = Vec::new();
    for (camera, mut context, mut input, mut output) in &mut contexts {
        let context = context.get_mut();
        // A camera learns its window's size at the end of its first frame.
        let has_size = camera.physical_viewport_size().is_some();
        let mut full = context.run_ui(core::mem::take(&mut **input), |ui| {
            if has_size {
                view.width = draw::panel(ui, &data, &mut view, &key, &mut asked);
            }
        });
        // Here rather than by bevy_egui, which has no clock: of what is tessellated already it only makes a copy.
        let meshes = context.tessellate(core::mem::take(&mut full.shapes), full.pixels_per_point);
        full.shapes = meshes.into_iter().filter_map(as_shape).collect();
        **output = Some(full);
    }
    // egui may lay a frame out twice; asking twice for the same is asking once.
    requests.write_batch(asked);
    if panel.width != view.width {
        panel.width = view.width;
    }
    OwnCost::average(&mut data.own.draw_ms, began);
}

fn as_shape(primitive: ClippedPrimitive) -> Option<ClippedShape> {
    match primitive.primitive {
        Primitive::Mesh(mesh) => Some(ClippedShape {
            clip_rect: primitive.clip_rect,
            shape: egui::Shape::mesh(mesh),
        }),
        // The panel has none.
        Primitive::Callback(_) => None,
    }
}
