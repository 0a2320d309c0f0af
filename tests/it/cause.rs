//! Cause before work, for every effect in one place: what each change in the scene sets going, counted, and that nothing
//! else moves. What is then shown is asserted where each effect's own life is tested.

use bevy::prelude::*;
use bevy_skyline::prelude::*;

use crate::effect_scene::{Asked, SAMPLES, Scene, Work, eye, sun_at};

/// Frames that each cause is given.
const FRAMES: u32 = 6;

/// What is counted, in the columns of the table.
const COLUMNS: [&str; 14] = [
    "ray_cast",
    "terrain_shade",
    "height_mips work",
    "terrain_shadow work",
    "terrain_cascade_cast",
    "terrain_cascade",
    "depth_reduce",
    "occludee_verdicts",
    "late_draws",
    "upscale",
    "choose",
    "slots_changed",
    "slots_assigned",
    "meshes_changed",
];

/// How much of something a cause is to set going.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Much {
    Exactly(u64),
    /// At least the one, at most the other.
    Within(u64, u64),
}
use Much::{Exactly, Within};

impl Much {
    fn holds(self, count: u64) -> bool {
        match self {
            Exactly(n) => count == n,
            Within(least, most) => (least..=most).contains(&count),
        }
    }
}

/// What of the counted work is not as it should be: what is not named is to be as it is in every frame.
fn wrong(work: &Work, expected: &[(&str, Much)]) -> Vec<String> {
    let each = |name: &str| match name {
        "ray_cast" | "terrain_shade" | "terrain_cascade" | "depth_reduce" | "occludee_verdicts"
        | "late_draws" | "upscale" | "choose" => Exactly(FRAMES.into()),
        _ => Exactly(0),
    };
    let checked = COLUMNS.iter().filter_map(|name| {
        let named = expected.iter().find(|(of, _)| of == name);
        let much = named.map_or(each(name), |(_, much)| *much);
        let count = work.get(name);
        (!much.holds(count)).then(|| format!("{name}: {count}, not {much:?}"))
    });
    let unknown = expected.iter().filter(|(name, _)| !COLUMNS.contains(name));
    checked
        .chain(unknown.map(|(name, _)| format!("{name} is not counted")))
        .collect()
}

#[test]
fn work_that_has_no_cause_is_noticed() {
    let mut work = Work::default();
    for name in &COLUMNS[..11] {
        work.0.insert(name, FRAMES.into());
    }
    let quiet = [
        "height_mips work",
        "terrain_shadow work",
        "terrain_cascade_cast",
    ];
    for name in quiet {
        work.0.remove(name);
    }
    assert!(wrong(&work, &[]).is_empty(), "{:?}", wrong(&work, &[]));
    assert_eq!(wrong(&work, &[("slots_changed", Exactly(1))]).len(), 1);
    assert_eq!(
        wrong(&work, &[("a_pass", Exactly(0))]),
        ["a_pass is not counted"]
    );
    work.0.insert("height_mips work", 1);
    assert_eq!(wrong(&work, &[]), ["height_mips work: 1, not Exactly(0)"]);
    assert!(wrong(&work, &[("height_mips work", Within(1, 2))]).is_empty());
    work.0.insert("ray_cast", u64::from(FRAMES) + 1);
    assert_eq!(wrong(&work, &[("height_mips work", Within(1, 2))]).len(), 1);
}

struct Table {
    scene: Scene,
    asked: Asked,
}

impl Table {
    fn new() -> Option<Self> {
        let mut scene = Scene::new()?;
        scene.ask(Asked::ALL);
        scene.settle(Asked::ALL);
        scene.steps(62);
        println!("{FRAMES} frames with | {}", COLUMNS.join(" | "));
        Some(Self {
            scene,
            asked: Asked::ALL,
        })
    }

    /// Does something before each frame and counts what it sets going.
    fn row(
        &mut self,
        cause: &str,
        expected: &[(&str, Much)],
        mut change: impl FnMut(&mut Scene, u32),
    ) -> Work {
        let before = self.scene.work();
        for frame in 0..FRAMES {
            change(&mut self.scene, frame);
            self.scene.step();
        }
        let work = self.scene.work().since(&before);
        let counts: Vec<_> = COLUMNS
            .iter()
            .map(|name| work.get(name).to_string())
            .collect();
        println!("{cause} | {}", counts.join(" | "));
        let wrong = wrong(&work, expected);
        assert!(wrong.is_empty(), "{cause}: {wrong:?}");
        work
    }

    /// All at rest again.
    fn settle(&mut self) {
        let asked = self.asked;
        self.scene.settle(asked);
    }
}

fn put(scene: &mut Scene, entity: Entity, place: Transform) {
    scene.world_mut().entity_mut(entity).insert(place);
}

/// The first of the frames alone.
fn at_once(mut change: impl FnMut(&mut Scene)) -> impl FnMut(&mut Scene, u32) {
    move |scene, frame| {
        if frame == 0 {
            change(scene);
        }
    }
}

#[test]
fn each_change_sets_going_what_depends_on_it_and_nothing_else() {
    let Some(mut table) = Table::new() else {
        return;
    };
    table.row("nothing", &[], |_, _| {});
    table.row("the camera moving", &[], |scene, frame| {
        let mut place = eye();
        place.translation.x += 0.01 * (frame + 1) as f32;
        place.rotate_y(0.001 * frame as f32);
        put(scene, scene.camera, place);
    });
    table.row(
        "the camera back",
        &[],
        at_once(|scene| put(scene, scene.camera, eye())),
    );

    // One rectangle of heights.
    let rect = URect::new(10, 12, 13, 14);
    let nodes = nodes_under(&table.scene, rect);
    let samples = u64::from(SAMPLES * SAMPLES);
    let edited = table.row(
        "heights edited",
        &[
            ("height_mips work", Exactly(nodes)),
            // The tile anew, sample by sample, and the coarse look at it before.
            ("terrain_shadow work", Within(samples, 2 * 64 * 64)),
            ("terrain_cascade_cast", Exactly(1)),
        ],
        at_once(move |scene| {
            let field = scene.field.clone();
            let mut fields = scene.world_mut().resource_mut::<Assets<HeightField>>();
            let mut field = fields.get_mut(&field).expect("it is there");
            field.edit(rect, |_, _, _| 3.0).expect("it lies within");
        }),
    );
    assert!(
        nodes * 4 < nodes_under(&table.scene, URect::new(0, 0, SAMPLES, SAMPLES)),
        "{edited:?}"
    );
    table.settle();
    table.row("nothing after that", &[], |_, _| {});

    table.row(
        "the sun moved",
        &[
            ("terrain_shadow work", Within(samples, 2 * 64 * 64)),
            ("terrain_cascade_cast", Exactly(1)),
        ],
        at_once(|scene| put(scene, scene.sun, sun_at(0.9))),
    );
    table.settle();
    table.row("nothing after that", &[], |_, _| {});

    table.row(
        "one box moving",
        &[("slots_changed", Exactly(FRAMES.into()))],
        |scene, frame| {
            let place = Transform::from_xyz(0.0, 2.0 + 0.1 * frame as f32, -12.0);
            put(scene, scene.boxes[20], place);
        },
    );
    table.row(
        "a box more",
        &[
            ("slots_changed", Exactly(1)),
            ("slots_assigned", Exactly(1)),
        ],
        at_once(|scene| {
            let like = scene.world().entity(scene.boxes[3]);
            let looks = (
                like.get::<Mesh3d>().cloned().expect("a mesh"),
                like.get::<MeshMaterial3d<StandardMaterial>>()
                    .cloned()
                    .expect("a material"),
            );
            let place = Transform::from_xyz(1.0, 2.0, -15.0);
            let new = scene.world_mut().spawn((looks, place)).id();
            scene.boxes.push(new);
        }),
    );
    table.row(
        "a box less",
        &[("slots_changed", Exactly(1))],
        at_once(|scene| {
            let gone = scene.boxes.pop().expect("one more");
            scene.world_mut().despawn(gone);
        }),
    );
}

#[test]
fn what_nobody_sees_is_not_worked_on() {
    let Some(mut table) = Table::new() else {
        return;
    };
    let unseen = [
        ("ray_cast", Exactly(0)),
        ("terrain_shade", Exactly(0)),
        ("terrain_cascade", Exactly(0)),
        // The depth is read, but there is nothing to be tested by it.
        ("occludee_verdicts", Exactly(0)),
        ("late_draws", Exactly(0)),
    ];
    table.row(
        "looking away",
        &unseen,
        at_once(|scene| {
            let away = eye().looking_to(Vec3::new(0.0, 1.0, 0.5), Vec3::Y);
            put(scene, scene.camera, away);
        }),
    );
    let passes = table.scene.work_of(4).passes();
    assert_eq!(
        passes.into_iter().collect::<Vec<_>>(),
        ["depth_reduce", "upscale"]
    );
    let idles = |table: &Table, effect, reason: &str| {
        let state = table.scene.effects().state(effect);
        assert!(
            matches!(state, EffectState::Idle(why) if why.contains(reason)),
            "{state}"
        );
    };
    idles(&table, Effect::Terrain, "no camera has terrain in view");
    table.row(
        "the sun moved, unseen",
        &unseen,
        at_once(|scene| put(scene, scene.sun, sun_at(0.9))),
    );
    idles(&table, Effect::TerrainShadow, "no camera sees the terrain");
    let most = FRAMES.into();
    table.row(
        "looking back",
        &[
            (
                "terrain_shadow work",
                Within((SAMPLES * SAMPLES).into(), 2 * 64 * 64),
            ),
            ("terrain_cascade_cast", Exactly(1)),
            // What comes into view is drawn at first.
            ("occludee_verdicts", Within(1, most)),
            ("late_draws", Within(1, most)),
        ],
        at_once(|scene| put(scene, scene.camera, eye())),
    );
}

#[test]
fn a_part_that_moves_restores_its_model_and_no_other_work_is_done() {
    let Some(mut table) = Table::new() else {
        return;
    };
    let interior = |table: &Table| table.scene.effects().interior().to_string();
    let before = interior(&table);
    table.row(
        "a part of the model moved",
        &[
            // It, what it hid, and the mesh that was trimmed.
            ("slots_changed", Within(1, 3)),
            ("meshes_changed", Within(0, 2)),
        ],
        at_once(|scene| {
            let place = Transform::from_xyz(0.05, 0.0, 0.0).with_scale(Vec3::splat(0.6));
            put(scene, scene.inside, place);
        }),
    );
    let state = table.scene.effects().interior();
    assert!(matches!(state, EffectState::Idle(_)), "{state}");
    table.settle();
    assert_eq!(interior(&table).split(';').next(), before.split(';').next());
    table.row("nothing after that", &[], |_, _| {});
}

/// The clock is set by hand, so that nothing here depends on how long a frame takes.
#[test]
fn where_nothing_is_hidden_occlusion_culling_rests_and_looks_again_later() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let hidden: Vec<_> = scene
        .boxes
        .iter()
        .copied()
        .chain([scene.inside, scene.wall])
        .collect();
    for entity in hidden {
        scene
            .world_mut()
            .entity_mut(entity)
            .insert(Visibility::Hidden);
    }
    let camera = scene.camera;
    let settings = ZBufferOcclusion::default();
    scene.world_mut().entity_mut(camera).insert(settings);
    let mut worked = 0;
    let rests = |scene: &Scene| {
        let state = scene.effects().occlusion();
        matches!(state, EffectState::Idle(why) if why.starts_with("it would cost"))
    };
    while !rests(&scene) {
        worked += scene.work_of(1).get("depth_reduce");
        assert!(
            worked < 60,
            "it never rests: {}",
            scene.effects().occlusion()
        );
    }
    let rest = scene.work_of(50);
    assert_eq!(rest, Work::default(), "it rests");
    let mut frames_to_probe = 0;
    let mut probed = 0;
    while probed == 0 {
        probed = scene.work_of(1).get("depth_reduce");
        frames_to_probe += 1;
        assert!(frames_to_probe < 60, "it never looks again");
    }
    probed += scene.work_of(16).get("depth_reduce");
    let again = scene.work_of(80);
    println!(
        "worked for {worked} frames, rested for {}, looked for {probed}, rested again",
        50 + frames_to_probe - 1
    );
    assert!((1..=16).contains(&probed), "{probed}");
    assert_eq!(again, Work::default(), "it rests again, for longer");
}

/// Nodes of the pyramid that an edit of these samples reaches.
fn nodes_under(scene: &Scene, rect: URect) -> u64 {
    let fields = scene.world().resource::<Assets<HeightField>>();
    let pyramid = fields.get(&scene.field).expect("it is there").pyramid();
    let area = |level| {
        let size = pyramid.affected_nodes(level, rect).size();
        u64::from(size.x) * u64::from(size.y)
    };
    (1..=pyramid.levels()).map(area).sum()
}
