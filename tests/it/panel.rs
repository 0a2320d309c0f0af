//! The panel without a window: what it gathers, what its widgets ask for, and what is left when it closes.

use std::time::Duration;

use bevy::{
    camera::{RenderTarget, visibility::RenderLayers},
    ecs::system::SystemState,
    input::{
        ButtonState,
        keyboard::{Key, KeyboardInput},
    },
    prelude::*,
    time::TimeUpdateStrategy,
};
use bevy_egui::{
    EguiContext, EguiManagedTextures,
    egui::{self, Event, Modifiers, PointerButton, RawInput},
};
use bevy_skyline::{
    budget::Knobs,
    offline::Offline,
    panel::{
        PanelCamera, PanelData, PanelPlugin, PanelRequest, SkylinePanel,
        counts::ReasonCounts,
        data::{BudgetRow, EffectRow, KnobRow},
        draw::{self, PanelView},
        results::Results,
    },
    prelude::*,
};

/// A real run of `skyline accuracy terrain --quick`.
pub const RESULTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/results.jsonl");

fn app() -> Option<Offline> {
    // Says why, where there is no device.
    drop(crate::device()?);
    Offline::with(|app| {
        app.add_plugins(PanelPlugin);
        // Every frame is due.
        app.insert_resource(TimeUpdateStrategy::ManualDuration(Duration::from_millis(
            300,
        )));
    })
    .ok()
}

fn press(app: &mut App, key_code: KeyCode) {
    for state in [ButtonState::Pressed, ButtonState::Released] {
        app.world_mut().write_message(KeyboardInput {
            key_code,
            logical_key: Key::F3,
            state,
            text: None,
            repeat: false,
            window: Entity::PLACEHOLDER,
        });
    }
}

/// Contexts, panel cameras, textures of egui, and whether there is data.
fn held(app: &mut App) -> (usize, usize, usize, bool) {
    let world = app.world_mut();
    let contexts = world.query::<&EguiContext>().iter(world).count();
    let cameras = world.query::<&PanelCamera>().iter(world).count();
    let textures = world.resource::<EguiManagedTextures>().len();
    let data = world.contains_resource::<PanelData>();
    (contexts, cameras, textures, data)
}

#[test]
fn closed_it_holds_nothing_and_hears_nothing() {
    let Some(mut offline) = app() else { return };
    let target = offline.target(UVec2::new(400, 300));
    offline.camera(&target, ());
    let app = &mut offline.app;
    app.update();
    assert_eq!(held(app), (0, 0, 0, false));
    app.world_mut()
        .write_message(PanelRequest::Load("/nowhere".into()));
    app.update();
    assert_eq!(app.world().resource::<SkylinePanel>().results, None);

    press(app, KeyCode::F4);
    app.update();
    assert_eq!(held(app), (0, 0, 0, false), "another key");
    press(app, KeyCode::F3);
    app.update();
    assert!(app.world().resource::<SkylinePanel>().open);
    let world = app.world_mut();
    let camera = world
        .query_filtered::<Entity, With<PanelCamera>>()
        .single(world)
        .unwrap();
    // There is no window here.
    world
        .entity_mut(camera)
        .insert(RenderTarget::Image(target.into()));
    for _ in 0..4 {
        app.update();
    }
    assert_eq!(held(app), (1, 1, 1, true));
    let data = app.world().resource::<PanelData>();
    assert!(data.frames.len() >= 4);
    assert!(data.own.draw_ms > 0.0 && data.own.gather_ms > 0.0);

    // A scene that sweeps everything away takes the camera too; it comes back, with its data.
    app.world_mut().entity_mut(camera).despawn();
    app.update();
    let (contexts, cameras, _, data) = held(app);
    assert_eq!((contexts, cameras, data), (1, 1, true));

    press(app, KeyCode::F3);
    app.update();
    assert_eq!(held(app), (0, 0, 0, false));

    // By code as well as by key, and with no key at all. Nothing piles up.
    let once = app.world().entities().count_spawned();
    app.world_mut().resource_mut::<SkylinePanel>().key = None;
    for open in [true, false, true, false] {
        app.world_mut().resource_mut::<SkylinePanel>().open = open;
        app.update();
        app.update();
    }
    assert_eq!(held(app), (0, 0, 0, false));
    assert_eq!(app.world().entities().count_spawned(), once);
    app.world_mut().resource_mut::<SkylinePanel>().open = true;
    app.update();
    press(app, KeyCode::F3);
    app.update();
    assert!(held(app).3);
}

#[test]
fn counts_are_those_that_the_game_is_told() {
    let Some(mut offline) = app() else { return };
    let target = offline.target(UVec2::new(160, 120));
    // One leaves small things out on the CPU, one on the GPU.
    let views = [
        (RenderLayers::default(), usize::MAX),
        (RenderLayers::layer(2), 0),
    ];
    let cameras = views.map(|(layers, gpu_from)| {
        let contribution = ContributionCulling {
            gpu_from,
            ..default()
        };
        let occlusion = ZBufferOcclusion {
            // Whether it pays is another test's.
            rests: false,
            ..default()
        };
        let culling = (occlusion, contribution);
        let place = Transform::from_xyz(0.0, 2.0, 20.0).looking_at(Vec3::Y, Vec3::Y);
        offline.camera(&target, (place, layers, culling, Msaa::Off))
    });
    let world = offline.app.world_mut();
    let mut meshes = world.resource_mut::<Assets<Mesh>>();
    let cube = meshes.add(Cuboid::from_length(1.0));
    let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
    let grey = materials.add(StandardMaterial::default());
    let thing = |place: Transform| (Mesh3d(cube.clone()), MeshMaterial3d(grey.clone()), place);
    // A wall with things behind it, some of them small, some to the side, some hidden, some on other layers.
    let wall = Transform::from_xyz(0.0, 2.0, 10.0).with_scale(Vec3::new(12.0, 12.0, 0.3));
    world.spawn(thing(wall));
    for i in 0..60 {
        let place = Transform::from_xyz(i as f32 - 30.0, 1.0, -(i % 7) as f32)
            .with_scale(Vec3::splat(if i % 3 == 0 { 0.01 } else { 1.0 }));
        let mut entity = world.spawn(thing(place));
        if i % 10 == 4 {
            entity.insert(Visibility::Hidden);
        }
        if i % 5 == 2 {
            entity.insert(RenderLayers::layer(2));
        }
    }
    world.resource_mut::<SkylinePanel>().open = true;
    let (mut occluded, mut small) = (0, 0);
    // Shaders are compiled and depth comes back meanwhile.
    for frame in 0..400 {
        if frame > 12 && occluded > 0 && small > 0 {
            break;
        }
        offline.step();
        let world = offline.app.world_mut();
        let mut state = SystemState::<(Culling, Query<Entity, With<Mesh3d>>)>::new(world);
        let (culling, all) = state.get(world).unwrap();
        let expected = cameras.map(|camera| {
            let mut counts = ReasonCounts::default();
            for mesh in &all {
                counts.all += 1;
                *match culling.reason(camera, mesh) {
                    None => &mut counts.drawn,
                    Some(CullReason::Hidden) => &mut counts.hidden,
                    Some(CullReason::Layers) => &mut counts.layers,
                    Some(CullReason::Frustum) => &mut counts.frustum,
                    Some(CullReason::Contribution) => &mut counts.contribution,
                    Some(CullReason::Occluded) => &mut counts.occluded,
                    Some(other) => panic!("{other:?} has no column"),
                } += 1;
            }
            counts
        });
        let rows = &world.resource::<PanelData>().cameras;
        assert_eq!(rows.len(), 2, "the panel's own camera is not counted");
        for (camera, expected) in cameras.into_iter().zip(expected) {
            let row = rows.iter().find(|row| row.camera == camera).unwrap();
            assert_eq!(row.counts, expected);
            assert!(expected.hidden > 0 && expected.layers > 0, "{expected:?}");
            occluded += expected.occluded;
            small += expected.contribution;
        }
    }
    let world = offline.app.world();
    let counts = cameras.map(|camera| world.get::<OcclusionCounts>(camera));
    assert!(
        occluded > 0 && small > 0,
        "{occluded} hidden, {small} small; {}; {counts:?}",
        world.resource::<Effects>().occlusion()
    );
}

#[test]
fn a_knob_taken_by_hand_stays_so() {
    let Some(mut offline) = app() else { return };
    let target = offline.target(UVec2::new(64, 64));
    let culling = (ZBufferOcclusion::default(), ContributionCulling::default());
    offline.camera(&target, (FrameBudget::from_hz(60.0), culling, Msaa::Off));
    offline.app.world_mut().resource_mut::<SkylinePanel>().open = true;
    for _ in 0..4 {
        offline.step();
    }
    let ask = |offline: &mut Offline, knob, step| {
        let request = PanelRequest::SetManual { knob, step };
        offline.app.world_mut().write_message(request);
        offline.step();
    };
    let manual = |offline: &Offline, name: &str| {
        let knob = offline.app.world().resource::<Knobs>().get(name);
        knob.expect("it is registered").manual
    };
    let rows = &offline.app.world().resource::<PanelData>().knobs;
    let knob = rows.first().expect("the scene has knobs").clone();
    assert_eq!(knob.manual, None);
    let last = knob.values.len() - 1;
    ask(&mut offline, knob.name, Some(last));
    assert_eq!(manual(&offline, knob.name), Some(last));
    let rows = &offline.app.world().resource::<PanelData>().knobs;
    assert_eq!(rows[0].manual, Some(last), "it shows at once");
    // What there is not changes nothing.
    ask(&mut offline, knob.name, Some(last + 1));
    ask(&mut offline, "no_such_knob", Some(0));
    assert_eq!(manual(&offline, knob.name), Some(last));
    offline.app.world_mut().resource_mut::<SkylinePanel>().open = false;
    for _ in 0..3 {
        offline.step();
    }
    assert_eq!(manual(&offline, knob.name), Some(last), "closed");
    offline.app.world_mut().resource_mut::<SkylinePanel>().open = true;
    offline.step();
    ask(&mut offline, knob.name, None);
    assert_eq!(manual(&offline, knob.name), None);
}

#[test]
fn a_file_of_results_is_loaded_and_a_bad_one_is_no_end() {
    let Some(mut offline) = app() else { return };
    let app = &mut offline.app;
    app.world_mut().resource_mut::<SkylinePanel>().open = true;
    let load = |app: &mut App, path: &str| {
        app.world_mut()
            .write_message(PanelRequest::Load(path.into()));
        app.update();
        let data = app.world().resource::<PanelData>();
        let (at, results) = data.results.as_ref().expect("an answer");
        assert_eq!(at.as_os_str(), path);
        results.clone()
    };
    let results = load(app, RESULTS).unwrap();
    assert_eq!(results.points.len(), 28);
    assert!(results.left_out.is_empty());
    assert!(
        results
            .errors
            .iter()
            .any(|name| name == "coverage_errors_px")
    );
    assert!(results.kinds.iter().any(|kind| kind == "max-mip"));
    let error = load(app, "/nowhere/results.jsonl").unwrap_err();
    assert!(error.to_string().contains("skyline accuracy"), "{error}");
    // The path outlives the panel, the file's content does not.
    app.world_mut().resource_mut::<SkylinePanel>().open = false;
    app.update();
    assert!(!app.world().contains_resource::<PanelData>());
    assert!(app.world().resource::<SkylinePanel>().results.is_some());
}

#[test]
fn effects_stand_in_one_order_with_their_reasons() {
    let Some(mut offline) = app() else { return };
    let target = offline.target(UVec2::new(64, 64));
    offline.camera(&target, (ZBufferOcclusion::default(), Msaa::Off));
    offline.app.world_mut().resource_mut::<SkylinePanel>().open = true;
    for _ in 0..3 {
        offline.step();
    }
    let world = offline.app.world();
    let rows = &world.resource::<PanelData>().effects;
    assert_eq!(rows.len(), Effect::ALL.len());
    let effects = world.resource::<Effects>();
    for EffectRow { effect, state } in rows {
        assert_eq!(state, effects.state(*effect));
    }
    let occlusion = rows.iter().find(|row| row.name() == "Z-buffer occlusion");
    assert_ne!(occlusion.unwrap().state, EffectState::Dormant);
}

/// A knob that stands at a step of four.
fn knob(manual: Option<usize>) -> KnobRow {
    KnobRow {
        name: "terrain_error",
        unit: "px",
        values: vec![0.5, 1.0, 2.0, 4.0],
        at: 1,
        value: Some(1.0),
        manual,
        saves_ms: Some(3.25),
    }
}

/// The panel in a window of the mind.
struct Screen {
    context: egui::Context,
    view: PanelView,
    time: f64,
    requests: Vec<PanelRequest>,
}

impl Screen {
    const SIZE: egui::Vec2 = egui::vec2(900.0, 900.0);

    fn new() -> Self {
        Self {
            context: egui::Context::default(),
            view: PanelView::new(&SkylinePanel::default()),
            time: 0.0,
            requests: Vec::new(),
        }
    }

    /// A frame; returns what is painted.
    fn pass(&mut self, data: &PanelData, events: Vec<Event>) -> Vec<egui::Shape> {
        self.time += 0.1;
        let input = RawInput {
            screen_rect: Some(egui::Rect::from_min_size(egui::Pos2::ZERO, Self::SIZE)),
            time: Some(self.time),
            events,
            ..RawInput::default()
        };
        let Self { view, requests, .. } = self;
        let mut output = self.context.run_ui(input, |ui| {
            view.width = draw::panel(ui, data, view, "", requests);
        });
        output.textures_delta.clear();
        output.shapes.into_iter().map(|shape| shape.shape).collect()
    }

    fn click(&mut self, data: &PanelData, pos: egui::Pos2) {
        let button = |pressed| Event::PointerButton {
            pos,
            button: PointerButton::Primary,
            pressed,
            modifiers: Modifiers::NONE,
        };
        self.pass(data, vec![Event::PointerMoved(pos)]);
        self.pass(data, vec![button(true)]);
        self.pass(data, vec![button(false)]);
    }
}

/// Everything that is written.
fn texts(shapes: &[egui::Shape]) -> String {
    let words = shapes.iter().map(|shape| match shape {
        egui::Shape::Text(text) => text.galley.text().to_owned(),
        egui::Shape::Vec(shapes) => texts(shapes),
        _ => String::new(),
    });
    words.collect::<Vec<_>>().join("\n")
}

/// Draws the data, and clicks at every place of a grid over the panel.
fn clicked(data: &PanelData) -> Vec<PanelRequest> {
    let mut screen = Screen::new();
    assert!(!screen.pass(data, Vec::new()).is_empty());
    let width = screen.view.width;
    assert!((320.0..500.0).contains(&width), "{width}");
    for y in (40..880).step_by(7) {
        for across in [20.0, 120.0, width - 40.0] {
            let pos = egui::pos2(Screen::SIZE.x - width + across, y as f32);
            screen.click(data, pos);
        }
    }
    screen.requests
}

#[test]
fn a_click_asks_for_what_it_says() {
    let mut data = PanelData::default();
    assert_eq!(clicked(&data), [], "there is nothing to ask for");
    let ask = |step| PanelRequest::SetManual {
        knob: "terrain_error",
        step,
    };
    data.knobs = vec![knob(None)];
    let requests = clicked(&data);
    assert!(!requests.is_empty());
    // By hand from where it stands.
    assert!(requests.iter().all(|request| *request == ask(Some(1))));
    data.knobs = vec![knob(Some(1))];
    let requests = clicked(&data);
    assert!(requests.contains(&ask(None)), "{requests:?}");
    assert!(requests.contains(&ask(Some(0))), "{requests:?}");
    assert!(requests.contains(&ask(Some(3))), "{requests:?}");
}

#[test]
fn what_is_known_is_written() {
    let mut data = PanelData::default();
    let active = EffectState::Active(Activity {
        what: "7 of 9 candidates removed".into(),
        cpu_ms: 1.25,
        gpu_ms: None,
        bytes: 3_500_000,
    });
    let states = [
        (Effect::ZBufferOcclusion, active),
        (Effect::Terrain, EffectState::Idle("out of view".into())),
        (
            Effect::TerrainShadow,
            EffectState::Unsupported("no GPU".into()),
        ),
        (Effect::FrameBudget, EffectState::Dormant),
    ];
    data.effects = states
        .map(|(effect, state)| EffectRow { effect, state })
        .into();
    data.knobs = vec![knob(None)];
    data.budget = Some(BudgetRow {
        target_ms: 16.5,
        predicted_ms: Some(15.5),
        demanded_px2: 40.0,
        is_met: Some(true),
        words: "target met by moving knobs",
    });
    // The last of four is over the target.
    for ms in [10.0, 12.0, 14.0, 20.0] {
        data.frames.push(ms);
    }
    let shapes = Screen::new().pass(&data, Vec::new());
    let written = texts(&shapes);
    for words in [
        "target 16.5 ms",
        "14.00 ms",
        "20.00 ms",
        "25.0 %",
        "Z-buffer occlusion",
        "7 of 9 candidates removed",
        "1.25",
        "3.5",
        "out of view",
        "no GPU",
        "nothing in the scene asks for it",
        "active",
        "idle",
        "unsupported",
        "dormant",
        "terrain error",
        "1 px",
        "saves 3.25 ms",
        "predicted 15.5 ms",
    ] {
        assert!(written.contains(words), "no {words:?} in\n{written}");
    }
}

#[test]
fn a_point_says_its_setting() {
    let results = Results::load(RESULTS.as_ref()).unwrap();
    let mut data = PanelData::default();
    data.results = Some((RESULTS.into(), Ok(results.clone())));
    let mut screen = Screen::new();
    // The second frame knows the widths of the first.
    screen.pass(&data, Vec::new());
    let shapes = screen.pass(&data, Vec::new());
    let at: Vec<egui::Pos2> = shapes
        .iter()
        .filter_map(|shape| match shape {
            egui::Shape::Circle(circle) if circle.radius == 3.0 => Some(circle.center),
            _ => None,
        })
        .collect();
    let shown = results.points.iter().filter(|point| point.group == 0);
    let settings: Vec<&String> = shown.map(|point| &point.setting).collect();
    assert_eq!(at.len(), settings.len());
    for pos in at {
        let mut written = String::new();
        screen.pass(&data, vec![Event::PointerMoved(pos)]);
        // It says so to a pointer that rests.
        for _ in 0..12 {
            written = texts(&screen.pass(&data, Vec::new()));
        }
        assert!(
            settings.iter().any(|setting| written.contains(*setting)),
            "{pos} says no setting:\n{written}"
        );
    }
}
