//! Only the effects that a scene calls for: for every effect alone, every pair and all of them, what runs, what is held
//! and what is told in `Effects` is what those effects need; and with their components everything goes.

use std::collections::BTreeSet;

use bevy::{platform::time::Instant, prelude::*};
use bevy_skyline::{
    culling::candidates::Candidates,
    prelude::*,
    render_graph::stats::{ShadowCounts, TerrainCounts},
    systems::{
        interior::models::InteriorModels,
        spherical::{models::SphericalModels, spawn::ChunkOf},
    },
};

use crate::effect_scene::{Asked, EFFECTS, SAMPLES, Scene, differences};
use Effect::{
    ContributionCulling as Contribution, FrameBudget as Budget, InteriorCulling as Interior,
    ResolutionScale as Scale, SphericalIndex as Spherical, Terrain as Ground,
    TerrainShadow as Shadow, ZBufferOcclusion as Occlusion,
};

/// A software driver rounds what it allocates up by so much on average: buffers to 64 bytes, rows of textures, too, and
/// their number to four. units: bytes
const ROUNDING: u64 = 128;

/// Frames that work is counted over.
const FRAMES: u32 = 5;

/// Which passes run each frame while the scene stands still, and for which effects: a row holds where all of its effects
/// are asked for and none of those it gives way to.
const EACH_FRAME: [(&[&str], &[Effect], &[Effect]); 5] = [
    (
        &[
            "subdivide",
            "box_entry",
            "beam",
            "ray_cast",
            "terrain_depth",
            "terrain_shade",
        ],
        &[Ground],
        &[],
    ),
    // The sun has one cascade; what was cast for it is kept.
    (&["terrain_cascade"], &[Ground, Shadow], &[]),
    (
        &[
            "depth_reduce",
            "occludee_verdicts",
            "late_draws",
            "late_opaque",
        ],
        &[Occlusion],
        &[],
    ),
    // Where something else asks for areas the CPU measures them.
    (
        &["contribution", "contribution_draws"],
        &[Contribution],
        &[Occlusion, Budget],
    ),
    (&["upscale"], &[Scale], &[]),
];

/// Which passes run once, when their effects come.
const ONCE: [(&[&str], &[Effect]); 2] = [
    (&["height_mips"], &[Ground]),
    (
        &[
            "terrain_shadow",
            "shadow_mips",
            "terrain_cascade_cast",
            "terrain_cascade_erode",
        ],
        &[Ground, Shadow],
    ),
];

fn each_frame(asked: Asked) -> BTreeSet<&'static str> {
    let rows = EACH_FRAME.iter().filter(|(_, needed, against)| {
        needed.iter().all(|of| asked.has(*of)) && !against.iter().any(|of| asked.has(*of))
    });
    rows.flat_map(|(passes, ..)| passes.iter().copied())
        .collect()
}

fn once(asked: Asked) -> BTreeSet<&'static str> {
    let rows = ONCE
        .iter()
        .filter(|(_, needed)| needed.iter().all(|of| asked.has(*of)));
    rows.flat_map(|(passes, _)| passes.iter().copied())
        .collect()
}

/// What is drawn by its own span but not counted.
fn counted(passes: &BTreeSet<&'static str>) -> BTreeSet<&'static str> {
    passes
        .iter()
        .copied()
        .filter(|pass| *pass != "late_opaque")
        .collect()
}

#[test]
fn nothing_asked_for_is_nothing_done_held_or_queued() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let start = Instant::now();
    scene.steps(8);
    assert!(scene.work_of(4).passes().is_empty(), "{:?}", scene.work());
    assert_eq!(scene.work().get("choose"), 0);
    assert!(scene.pipelines().is_empty(), "{:?}", scene.pipelines());
    assert!(scene.allocations().is_empty(), "{:?}", scene.allocations());
    let counts = TerrainCounts {
        cpu_ms: 0.0,
        ..scene.offline.counts()
    };
    assert_eq!(counts, TerrainCounts::default());
    nothing_is_left(&scene);
    let spans = scene.spans_since(start);
    let all: BTreeSet<_> = each_frame(Asked::ALL)
        .union(&once(Asked::ALL))
        .copied()
        .collect();
    assert!(!spans.is_empty(), "nothing was measured at all");
    assert!(
        spans.iter().all(|span| !all.contains(span.as_str())),
        "{spans:?}"
    );

    // Each of these would have found something, had there been any.
    scene.ask(Asked::of(&[Ground]));
    scene.settle(Asked::of(&[Ground]));
    assert!(!scene.work().passes().is_empty());
    assert!(!scene.pipelines().is_empty() && !scene.allocations().is_empty());
}

fn nothing_is_left(scene: &Scene) {
    for effect in EFFECTS {
        assert_eq!(
            *scene.effects().state(effect),
            EffectState::Dormant,
            "{effect:?}"
        );
    }
    assert_eq!(scene.bytes(), [0; EFFECTS.len()]);
    let counts = scene.offline.counts();
    assert_eq!(
        (counts.field_bytes, counts.view_bytes, counts.cascade_bytes),
        (0, 0, 0)
    );
    assert_eq!(counts.shadows, ShadowCounts::default());
    let world = scene.world();
    assert_eq!(world.resource::<Candidates>().slots(), 0);
    assert!(world.resource::<InteriorModels>().is_empty());
    assert!(world.resource::<SphericalModels>().is_empty());
    assert_eq!(world.resource::<Knobs>().iter().len(), 0);
    components_are(scene, Asked::NONE);
}

/// What effects put beside their components is there with them alone.
fn components_are(scene: &Scene, asked: Asked) {
    let world = scene.world();
    let camera = world.entity(scene.camera);
    let [culls, weighs] = [Occlusion, Contribution].map(|effect| asked.has(effect));
    assert_eq!(camera.contains::<OcclusionCounts>(), culls, "{asked}");
    assert_eq!(camera.contains::<ContributionCounts>(), weighs, "{asked}");
    assert_eq!(
        camera.contains::<CulledEntities>(),
        culls || weighs,
        "{asked}"
    );
    assert_eq!(
        camera.contains::<BudgetState>(),
        asked.has(Budget),
        "{asked}"
    );
    let model = world.entity(scene.model);
    assert_eq!(
        model.contains::<InteriorCounts>(),
        asked.has(Interior),
        "{asked}"
    );
    let ball = world.entity(scene.ball);
    assert_eq!(
        ball.contains::<SphericalCounts>(),
        asked.has(Spherical),
        "{asked}"
    );
}

/// One app goes through all of the matrix, so that nothing that an effect leaves behind escapes.
#[test]
fn what_runs_and_what_is_held_is_what_the_effects_asked_for_need() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    scene.steps(6);
    let idle = Instant::now();
    scene.steps(4);
    let bevys = scene.spans_since(idle);
    let before = (scene.mesh_bytes(), scene.chunks());
    assert_eq!(before.1, 0);
    println!("effects | passes each frame | passes once | GPU memory held by each (bytes) | slots");
    for asked in Asked::matrix() {
        let start = scene.work();
        scene.ask(asked);
        scene.settle(asked);
        if asked.has(Ground) && asked.has(Shadow) {
            // What maps are made in is given back after a rest.
            scene.steps(62);
        }
        let to_settle = scene.work().since(&start);
        let then = Instant::now();
        let work = scene.work_of(FRAMES);
        // What was measured in the last of them is known a frame later.
        scene.step();
        let spans = scene.spans_since(then);
        let ours = spans
            .iter()
            .map(String::as_str)
            .filter(|span| !bevys.contains(*span));
        let each = each_frame(asked);
        let wrong = differences(each.iter().copied(), ours);
        assert!(wrong.is_empty(), "{asked}: {wrong:?}");
        let wrong = differences(counted(&each), work.passes());
        assert!(wrong.is_empty(), "{asked}, by count: {wrong:?}");
        for pass in counted(&each) {
            // Levels and tiles have dispatches of their own.
            let runs = work.get(pass);
            let of_levels = ["subdivide", "beam"].contains(&pass);
            assert!(
                runs == u64::from(FRAMES) || of_levels,
                "{asked}: {pass} ran {runs} times"
            );
            assert_eq!(runs % u64::from(FRAMES), 0, "{asked}: {pass}");
        }
        let all: BTreeSet<_> = counted(&each).union(&once(asked)).copied().collect();
        let wrong = differences(all, to_settle.passes());
        assert!(wrong.is_empty(), "{asked}, until it settled: {wrong:?}");

        let chose = if asked.has(Budget) { FRAMES } else { 0 };
        assert_eq!(work.get("choose"), u64::from(chose), "{asked}");
        for nothing in ["slots_changed", "slots_assigned", "meshes_changed"] {
            assert_eq!(work.get(nothing), 0, "{asked}: {nothing}");
        }
        let slots = scene.world().resource::<Candidates>().len();
        assert_eq!(slots, scene.expected_slots(asked), "{asked}");
        components_are(&scene, asked);
        states_are_told(&scene, asked);
        bytes_are_told(&mut scene, asked, before.0);
        println!(
            "{asked} | {} | {} | {} | {slots}",
            words(&each),
            words(&once(asked)),
            bytes_by_effect(&scene),
        );

        scene.ask_for_nothing();
        scene.steps(6);
        nothing_is_left(&scene);
        let left = scene.allocations();
        assert!(left.is_empty(), "{asked} leaves {left:?}");
        assert_eq!((scene.mesh_bytes(), scene.chunks()), before, "{asked}");
        let after = scene.work_of(2);
        assert_eq!(after, default(), "after {asked}");
    }
}

fn words(passes: &BTreeSet<&str>) -> String {
    let list: Vec<_> = passes.iter().copied().collect();
    if list.is_empty() {
        "–".to_owned()
    } else {
        list.join(" ")
    }
}

fn bytes_by_effect(scene: &Scene) -> String {
    let held = EFFECTS.into_iter().zip(scene.bytes());
    let held = held.filter(|(_, bytes)| *bytes > 0);
    let list: Vec<_> = held.map(|(of, bytes)| format!("{of:?} {bytes}")).collect();
    if list.is_empty() {
        "–".to_owned()
    } else {
        list.join(" ")
    }
}

impl Scene {
    /// Meshes that may be removed: none unless something removes; chunks only by the depth buffer.
    fn expected_slots(&mut self, asked: Asked) -> usize {
        match (asked.has(Occlusion), asked.has(Contribution)) {
            (true, _) => self.meshes + self.chunks(),
            (false, true) => self.meshes,
            (false, false) => 0,
        }
    }

    fn chunks(&mut self) -> usize {
        let world = self.world_mut();
        let mut chunks = world.query_filtered::<Entity, With<ChunkOf>>();
        chunks.iter(world).count()
    }

    /// What all meshes have on the GPU. units: bytes
    fn mesh_bytes(&self) -> u64 {
        let meshes = self.world().resource::<Assets<Mesh>>();
        let bytes = |mesh: &Mesh| {
            let indices = mesh.get_index_buffer_bytes().map_or(0, <[u8]>::len);
            (mesh.get_vertex_buffer_size() + indices) as u64
        };
        meshes.iter().map(|(_, mesh)| bytes(mesh)).sum()
    }
}

/// Every effect that is asked for is at work, or says why not, with what it takes; every other is dormant.
fn states_are_told(scene: &Scene, asked: Asked) {
    for effect in EFFECTS {
        let state = scene.effects().state(effect);
        // Shadows bring an empty terrain with them.
        let brought = effect == Ground && asked.has(Shadow);
        match state {
            EffectState::Dormant => assert!(!asked.has(effect) && !brought, "{asked}: {effect:?}"),
            EffectState::Idle(why) => {
                let expected = match effect {
                    Shadow if asked.has(Ground) => "up to date: 1 maps",
                    Shadow => "its height field is not loaded yet",
                    Ground if !asked.has(Ground) => "its height field is not loaded yet",
                    _ => "at work",
                };
                assert!(
                    why.starts_with(expected),
                    "{asked}: {effect:?} idles: {why}"
                );
            }
            EffectState::Active(activity) => {
                assert!(asked.has(effect), "{asked}: {effect:?}");
                assert!(!activity.what.is_empty(), "{asked}: {effect:?}");
                let cpu_ms = activity.cpu_ms;
                assert!(
                    cpu_ms > 0.0 && cpu_ms < 10_000.0,
                    "{asked}: {effect:?} {cpu_ms}"
                );
                let on_gpu = match effect {
                    Ground | Occlusion | Scale => true,
                    Contribution => scene.is_measured_by_gpu(asked),
                    _ => false,
                };
                assert_eq!(activity.gpu_ms.is_some(), on_gpu, "{asked}: {effect:?}");
                let gpu_ms = activity.gpu_ms.unwrap_or(0.0);
                assert!(
                    (0.0..10_000.0).contains(&gpu_ms),
                    "{asked}: {effect:?} {gpu_ms}"
                );
                assert_eq!(
                    activity.bytes,
                    scene.effects().bytes(effect),
                    "{asked}: {effect:?}"
                );
            }
            EffectState::Unsupported(why) => panic!("{effect:?}: {why}"),
        }
    }
}

/// What effects say they hold is what the driver has given them, and what follows from the scene.
fn bytes_are_told(scene: &mut Scene, asked: Asked, mesh_bytes: u64) {
    let bytes = |effect| scene.effects().bytes(effect);
    let allocations = scene.allocations();
    // Samples of two bytes, nodes of four, and the uniform.
    let samples = u64::from(SAMPLES * SAMPLES);
    let nodes = scene.field().pyramid().node_count() as u64;
    let field = if asked.has(Ground) {
        samples * 2 + nodes * 4 + 528
    } else {
        0
    };
    assert_eq!(scene.offline.counts().field_bytes, field, "{asked}");
    // One tile with its averages, and the table.
    let is_shadowed = asked.has(Ground) && asked.has(Shadow);
    let shadow = if is_shadowed { 5464 + 784 } else { 0 };
    assert_eq!(bytes(Shadow), shadow, "{asked}");
    assert_eq!(
        scene.offline.counts().cascade_bytes > 0,
        is_shadowed,
        "{asked}"
    );
    for (effect, on_gpu) in [
        (Ground, asked.has(Ground)),
        (Occlusion, asked.has(Occlusion)),
        (Contribution, scene.is_measured_by_gpu(asked)),
        (Interior, asked.has(Interior)),
        (Spherical, asked.has(Spherical)),
        (Scale, asked.has(Scale)),
        (Budget, false),
    ] {
        assert_eq!(bytes(effect) > 0, on_gpu, "{asked}: {effect:?}");
    }
    let made = scene.mesh_bytes() - mesh_bytes;
    assert_eq!(bytes(Interior) + bytes(Spherical), made, "{asked}");
    // Meshes are in Bevy's own buffers.
    let told = EFFECTS.into_iter().map(bytes).sum::<u64>() - made;
    let given: u64 = allocations.iter().map(|(_, bytes)| bytes).sum();
    assert!(told <= given, "{asked}: {told} bytes told, {given} given");
    // Other drivers round textures up to whatever suits them.
    if scene.offline.is_software() {
        // Three textures of the cascade have rows of no such number.
        let cascade = if is_shadowed { 3 * 2560 } else { 0 };
        let most = told + ROUNDING * allocations.len() as u64 + cascade;
        assert!(
            given <= most,
            "{asked}: {told} bytes told, {given} given: {allocations:?}"
        );
    }
}

impl Scene {
    fn field(&self) -> &HeightField {
        let fields = self.world().resource::<Assets<HeightField>>();
        fields.get(&self.field).expect("it is there")
    }
}
