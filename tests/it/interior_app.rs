//! Interior culling in the life of an app: what is hidden and trimmed, that it is not seen in the picture, and that
//! nothing is left of it afterwards.

use bevy::{
    asset::{AssetPlugin, RenderAssetUsages},
    camera::visibility::{InheritedVisibility, ViewVisibility, VisibilityPlugin},
    ecs::system::SystemState,
    mesh::{Indices, MeshPlugin},
    prelude::*,
};
use bevy_skyline::{
    interior::FieldBy,
    offline::{Offline, scenes::compare::differing_px},
    prelude::*,
    systems::interior::models::{InteriorModels, PartOf},
};

const SIZE: UVec2 = UVec2::new(160, 120);

/// A model under a root, a floor that its shadow falls on, a camera.
struct Scene {
    offline: Offline,
    camera: Entity,
    target: Handle<Image>,
    root: Entity,
    /// Meshes that are there before anything is culled.
    meshes: usize,
    paint: Handle<StandardMaterial>,
}

fn settings() -> InteriorCulling {
    InteriorCulling {
        grid: InteriorGrid::Resolution(64),
        ..default()
    }
}

fn cube(side: f32) -> Mesh {
    Cuboid::from_length(side).mesh().build()
}

/// A closed box with a closed box in it, as one mesh: all that is seen is the outer one's twelve triangles.
fn shell() -> Mesh {
    let mut shell = cube(2.0);
    shell.merge(&cube(1.6)).expect("the same attributes");
    shell
}

impl Scene {
    fn new() -> Option<Self> {
        let mut offline = crate::device()?;
        let target = offline.target(SIZE);
        let camera = offline.camera(&target, (Msaa::Off, Transform::default()));
        let world = offline.app.world_mut();
        let floor = world.resource_mut::<Assets<Mesh>>().add(cube(1.0));
        let paint = world
            .resource_mut::<Assets<StandardMaterial>>()
            .add(StandardMaterial::from_color(Color::srgb(0.8, 0.3, 0.2)));
        world.spawn((
            Mesh3d(floor),
            MeshMaterial3d(paint.clone()),
            Transform::from_xyz(0.0, -2.0, 0.0).with_scale(Vec3::new(20.0, 0.2, 20.0)),
        ));
        world.spawn((
            DirectionalLight {
                shadow_maps_enabled: true,
                ..default()
            },
            Transform::default().looking_to(Vec3::new(-1.0, -2.0, -1.5), Vec3::Y),
        ));
        let root = world
            .spawn((
                Transform::from_xyz(3.0, 1.0, -2.0).with_rotation(Quat::from_rotation_y(0.4)),
                Visibility::default(),
            ))
            .id();
        let mut scene = Self {
            offline,
            camera,
            target,
            root,
            meshes: 0,
            paint,
        };
        scene.look(Vec3::new(4.0, 3.0, 6.0));
        Some(scene)
    }

    fn world(&mut self) -> &mut World {
        self.offline.app.world_mut()
    }

    fn add_mesh(&mut self, mesh: Mesh) -> Handle<Mesh> {
        self.world().resource_mut::<Assets<Mesh>>().add(mesh)
    }

    fn part(&mut self, mesh: &Handle<Mesh>, at: Vec3) -> Entity {
        let (root, paint) = (self.root, self.paint.clone());
        self.world()
            .spawn((
                Mesh3d(mesh.clone()),
                MeshMaterial3d(paint),
                Transform::from_translation(at),
                ChildOf(root),
            ))
            .id()
    }

    /// Looks at the model from an offset.
    fn look(&mut self, from: Vec3) {
        let (camera, root) = (self.camera, self.root);
        let world = self.world();
        let at = world
            .get::<Transform>(root)
            .map_or(Vec3::ZERO, |t| t.translation);
        world
            .entity_mut(camera)
            .insert(Transform::from_translation(at + from).looking_at(at, Vec3::Y));
    }

    fn step(&mut self) {
        self.offline.step();
    }

    fn state(&self) -> EffectState {
        let effects = self.offline.app.world().resource::<Effects>();
        effects.interior().clone()
    }

    fn begin(&mut self, settings: InteriorCulling) {
        self.step();
        self.meshes = self.count_meshes();
        let root = self.root;
        self.world().entity_mut(root).insert(settings);
    }

    fn count_meshes(&self) -> usize {
        self.offline.app.world().resource::<Assets<Mesh>>().len()
    }

    /// Steps until the state says so.
    fn until(&mut self, what: &str) {
        self.until_is(what, |state| state.to_string().contains(what));
    }

    fn until_is(&mut self, what: &str, is: impl Fn(&EffectState) -> bool) {
        for _ in 0..20_000 {
            self.step();
            if is(&self.state()) {
                return;
            }
            std::thread::sleep(core::time::Duration::from_millis(1));
        }
        panic!("it never came to {what:?}: {}", self.state());
    }

    fn cull(&mut self, settings: InteriorCulling) {
        self.begin(settings);
        self.until("are hidden");
    }

    fn counts(&self) -> InteriorCounts {
        let counts = self.offline.app.world().get::<InteriorCounts>(self.root);
        *counts.expect("something was culled")
    }

    fn is_hidden(&self, entity: Entity) -> bool {
        let world = self.offline.app.world();
        let part = world.get::<PartOf>(entity).is_some_and(PartOf::is_hidden);
        let is_drawn = world.get::<ViewVisibility>(entity).is_some_and(|v| v.get());
        assert!(!(part && is_drawn), "{entity} is hidden and drawn");
        part
    }

    fn is_drawn(&self, entity: Entity) -> bool {
        let world = self.offline.app.world();
        world.get::<ViewVisibility>(entity).is_some_and(|v| v.get())
    }

    fn mesh_of(&self, entity: Entity) -> Handle<Mesh> {
        let mesh = self.offline.app.world().get::<Mesh3d>(entity);
        mesh.expect("it has a mesh").0.clone()
    }

    fn mesh(&self, handle: &Handle<Mesh>) -> &Mesh {
        let meshes = self.offline.app.world().resource::<Assets<Mesh>>();
        meshes.get(handle).expect("it is there")
    }

    fn picture(&self) -> image::RgbaImage {
        self.offline.picture(&self.target).expect("a picture")
    }

    fn pictures(&mut self) -> Vec<image::RgbaImage> {
        let views = [
            Vec3::new(4.0, 3.0, 6.0),
            Vec3::new(-5.0, 1.0, 2.0),
            Vec3::new(0.5, 5.0, -3.0),
            Vec3::new(1.0, 0.0, -4.0),
        ];
        views
            .map(|from| {
                self.look(from);
                // The first frames draw nothing yet.
                for _ in 0..3 {
                    self.step();
                }
                self.picture()
            })
            .into()
    }

    fn same_pictures(&mut self, before: &[image::RgbaImage]) {
        let after = self.pictures();
        for (before, after) in before.iter().zip(&after) {
            let background = *before.get_pixel(0, 0);
            assert!(
                before.pixels().any(|pixel| *pixel != background),
                "an empty picture"
            );
            assert_eq!(differing_px(before, after), 0);
        }
    }

    /// The picture is the one without culling.
    fn nothing_is_missing(&mut self) {
        let culled = self.picture();
        let root = self.root;
        let settings = self.world().entity_mut(root).take::<InteriorCulling>();
        self.step();
        let plain = self.picture();
        assert_eq!(differing_px(&culled, &plain), 0);
        if let Some(settings) = settings {
            self.world().entity_mut(root).insert(settings);
        }
    }

    fn nothing_is_held(&mut self) {
        self.step();
        self.step();
        let models = self.world().resource::<InteriorModels>();
        assert!(models.is_empty());
        assert_eq!((models.trimmed_meshes(), models.kept_results()), (0, 0));
        let mut tracked = self.world().query::<&PartOf>();
        assert_eq!(tracked.iter(self.offline.app.world()).count(), 0);
        assert_eq!(self.state(), EffectState::Dormant);
    }
}

fn triangles(mesh: &Mesh) -> usize {
    mesh.indices().map_or(0, Indices::len) / 3
}

#[test]
fn a_field_made_by_the_apps_gpu_hides_the_same() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (whole, ball) = (
        scene.add_mesh(shell()),
        scene.add_mesh(Sphere::new(0.4).mesh().build()),
    );
    let hull = scene.part(&whole, Vec3::ZERO);
    let inside = scene.part(&ball, Vec3::new(0.1, 0.0, 0.0));
    let by = |scene: &mut Scene, field| {
        scene.cull(InteriorCulling {
            field,
            ..settings()
        });
        assert!(scene.is_hidden(inside) && !scene.is_hidden(hull));
        let counts = scene.counts();
        let root = scene.root;
        scene.world().entity_mut(root).remove::<InteriorCulling>();
        scene.step();
        scene.step();
        assert!(!scene.is_hidden(inside));
        counts
    };
    let by_gpu = by(&mut scene, FieldBy::Gpu);
    assert_eq!(by_gpu.field, FieldBy::Gpu);
    let by_cpu = InteriorCounts {
        field: FieldBy::Cpu,
        ..by_gpu
    };
    assert_eq!(by(&mut scene, FieldBy::Cpu), by_cpu);
    // Once nothing is asked for any more the GPU is still the app's.
    assert!(scene.world().resource::<InteriorModels>().has_gpu());
}

#[test]
fn what_is_inside_is_hidden_and_trimmed_and_restored() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (whole, ball) = (
        scene.add_mesh(shell()),
        scene.add_mesh(Sphere::new(0.4).mesh().build()),
    );
    let hull = scene.part(&whole, Vec3::ZERO);
    let inside = scene.part(&ball, Vec3::new(0.1, 0.0, 0.0));
    let before = scene.pictures();
    scene.cull(settings());
    println!("{}", scene.state());
    assert!(scene.is_hidden(inside) && !scene.is_drawn(inside));
    assert!(!scene.is_hidden(hull) && scene.is_drawn(hull));
    let counts = scene.counts();
    assert_eq!((counts.nodes, counts.hidden_nodes), (2, 1));
    let in_ball = triangles(scene.mesh(&ball)) as u64;
    assert_eq!(counts.triangles, 24 + in_ball);
    assert_eq!(counts.hidden_triangles, 12 + in_ball);
    let expected = format!(
        "active: 1 of 2 nodes and {} of {} triangles are hidden; CPU",
        counts.hidden_triangles, counts.triangles
    );
    assert!(
        scene.state().to_string().starts_with(&expected),
        "{}",
        scene.state()
    );

    // The trimmed mesh is the outer box with all its attributes.
    assert_ne!(scene.mesh_of(hull), whole);
    // No handle stays here that would keep it.
    let (outer, trimmed) = (cube(2.0), scene.mesh(&scene.mesh_of(hull)));
    assert_eq!(trimmed.indices(), outer.indices());
    assert_eq!(trimmed.asset_usage, outer.asset_usage);
    for ((of, trimmed), (_, whole)) in trimmed.attributes().zip(outer.attributes()) {
        assert_eq!(trimmed, whole, "{}", of.name);
    }
    assert_eq!(trimmed.attributes().count(), outer.attributes().count());

    // A game can ask.
    let camera = scene.camera;
    let mut state = SystemState::<Culling>::new(scene.world());
    let culling = state.get(scene.offline.app.world()).expect("valid");
    assert_eq!(culling.reason(camera, inside), Some(CullReason::Interior));
    assert_eq!(culling.reason(camera, hull), None);
    scene.same_pictures(&before);

    let root = scene.root;
    scene.world().entity_mut(root).remove::<InteriorCulling>();
    scene.step();
    assert_eq!((scene.mesh_of(hull), scene.mesh_of(inside)), (whole, ball));
    let world = scene.offline.app.world();
    assert_eq!(
        world.get::<InheritedVisibility>(inside),
        Some(&InheritedVisibility::VISIBLE)
    );
    assert_eq!(
        world.get::<Visibility>(inside),
        Some(&Visibility::Inherited)
    );
    assert!(world.get::<InteriorCounts>(root).is_none());
    scene.same_pictures(&before);
    scene.nothing_is_held();
    assert_eq!(scene.count_meshes(), scene.meshes);
}

#[test]
fn other_settings_are_taken_up() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (whole, ball) = (scene.add_mesh(shell()), scene.add_mesh(cube(0.3)));
    let hull = scene.part(&whole, Vec3::ZERO);
    let inside = scene.part(&ball, Vec3::ZERO);
    scene.cull(settings());
    assert_ne!(scene.mesh_of(hull), whole);
    let root = scene.root;
    let level = |scene: &mut Scene, level| {
        if let Some(mut of) = scene.world().get_mut::<InteriorCulling>(root) {
            of.level = level;
        }
        scene.step();
        assert!(!scene.is_hidden(inside), "restored at once");
        assert_eq!(scene.mesh_of(hull), whole);
        scene.until("are hidden");
    };
    level(&mut scene, InteriorLevel::Node);
    assert!(scene.is_hidden(inside));
    assert_eq!(scene.mesh_of(hull), whole);
    level(&mut scene, InteriorLevel::Triangle);
    assert_ne!(scene.mesh_of(hull), whole);
    let models = scene.world().resource::<InteriorModels>();
    assert_eq!(models.kept_results(), 2, "the first was there still");

    // Written without being another: nothing happens.
    if let Some(mut of) = scene.world().get_mut::<InteriorCulling>(root) {
        of.set_changed();
    }
    scene.step();
    assert!(scene.is_hidden(inside));
}

#[test]
fn work_in_the_background_ends_with_its_model() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let ball = scene.add_mesh(Sphere::new(0.5).mesh().uv(200, 200));
    for i in 0..20 {
        scene.part(&ball, Vec3::new(i as f32 * 0.1, 0.0, 0.0));
    }
    let long = InteriorCulling {
        grid: InteriorGrid::Resolution(800),
        ..default()
    };
    let is_at_work = |state: &EffectState| {
        let words = state.to_string();
        ["snapping", "distance field", "front", "extraction"]
            .iter()
            .any(|stage| words.contains(stage))
    };
    let root = scene.root;
    for _ in 0..2 {
        scene.begin(long.clone());
        scene.until_is("work", is_at_work);
        scene.world().entity_mut(root).remove::<InteriorCulling>();
        scene.nothing_is_held();
    }
    scene.begin(long);
    scene.until_is("work", is_at_work);
    scene.world().despawn(root);
    scene.nothing_is_held();
}

#[test]
fn what_moves_away_uncovers_in_the_same_frame() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let wall = scene.add_mesh(Cuboid::new(2.0, 0.1, 2.0).mesh().build());
    let ball = scene.add_mesh(cube(0.8));
    let inside = scene.part(&ball, Vec3::ZERO);
    let mut walls = Vec::new();
    for axis in [
        Vec3::Y,
        Vec3::NEG_Y,
        Vec3::X,
        Vec3::NEG_X,
        Vec3::Z,
        Vec3::NEG_Z,
    ] {
        let wall = scene.part(&wall, Vec3::ZERO);
        let place = Transform::from_translation(axis * 0.95)
            .with_rotation(Quat::from_rotation_arc(Vec3::Y, axis));
        scene.world().entity_mut(wall).insert(place);
        walls.push(wall);
    }
    scene.look(Vec3::new(1.0, 5.0, 1.0));
    scene.cull(settings());
    assert!(scene.is_hidden(inside));
    let closed = scene.picture();
    scene.nothing_is_missing();
    scene.until("are hidden");

    let lid = walls[0];
    let lift = |scene: &mut Scene, by: f32| {
        if let Some(mut place) = scene.world().get_mut::<Transform>(lid) {
            place.translation.x = by;
        }
        scene.step();
        assert!(!scene.is_hidden(inside));
    };
    lift(&mut scene, 2.2);
    assert!(
        differing_px(&closed, &scene.picture()) > 0,
        "it was to be seen"
    );
    scene.nothing_is_missing();
    scene.until("are hidden");
    assert!(!scene.is_hidden(inside), "it is seen from above");
    lift(&mut scene, 0.0);
    scene.until_is("closed again", |state| {
        state.to_string().contains("1 of 7 nodes")
    });
    assert!(scene.is_hidden(inside));

    // The whole model moves, is touched, has a lamp that moves: nothing is uncovered.
    let root = scene.root;
    let lamp = scene
        .world()
        .spawn((PointLight::default(), ChildOf(root)))
        .id();
    for frame in 0..4 {
        let world = scene.world();
        for entity in [root, lamp] {
            if let Some(mut place) = world.get_mut::<Transform>(entity) {
                place.translation.z -= 0.1 * frame as f32;
            }
        }
        if let Some(mut place) = world.get_mut::<Transform>(lid) {
            place.set_changed();
        }
        scene.step();
        assert!(scene.is_hidden(inside), "frame {frame}");
    }

    // A wall that goes, and one that goes to another place in the hierarchy.
    scene.look(Vec3::new(1.0, 5.0, 1.0));
    scene.world().despawn(lid);
    scene.step();
    assert!(!scene.is_hidden(inside));
    scene.nothing_is_missing();
    let wall = walls[1];
    scene.until("are hidden");
    scene.world().entity_mut(wall).remove::<ChildOf>();
    scene.step();
    assert_eq!(scene.offline.app.world().get::<InteriorCounts>(root), None);
    scene.until("of 5 nodes");
    assert!(scene.offline.app.world().get::<PartOf>(wall).is_none());

    // One more part.
    let late = scene.part(&ball, Vec3::new(0.0, 0.1, 0.0));
    scene.step();
    assert_eq!(scene.offline.app.world().get::<InteriorCounts>(root), None);
    scene.until("of 6 nodes");
    assert!(scene.is_drawn(late));
}

#[test]
fn a_mesh_of_several_parts_is_trimmed_to_what_is_seen_of_any() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let whole = scene.add_mesh(shell());
    let [a, b] = [-1.5, 1.5].map(|x| scene.part(&whole, Vec3::new(x, 0.0, 0.0)));
    // Upside down there is one more in a larger box.
    let big = scene.add_mesh(cube(4.0));
    scene.part(&big, Vec3::new(0.0, 0.0, 6.0));
    let hidden = scene.part(&whole, Vec3::new(0.0, 0.0, 6.0));
    let before = scene.pictures();
    scene.cull(settings());
    assert_eq!(scene.mesh_of(a), scene.mesh_of(b));
    assert_ne!(scene.mesh_of(a), whole);
    assert_eq!(triangles(scene.mesh(&scene.mesh_of(a))), 12);
    assert!(scene.is_hidden(hidden));
    assert_eq!(scene.mesh_of(hidden), whole);
    scene.same_pictures(&before);

    // The same mesh with a hole to look in through: all of it is seen in that one, so it stays whole in both.
    let root = scene.root;
    scene.world().entity_mut(root).remove::<InteriorCulling>();
    let mut open = cube(2.0);
    let indices = open
        .indices()
        .map(|all| all.iter().skip(6).map(|i| i as u32).collect());
    open.insert_indices(Indices::U32(indices.expect("indices")));
    open.merge(&cube(0.5)).expect("the same attributes");
    let open = scene.add_mesh(open);
    for part in [a, b] {
        scene.world().entity_mut(part).insert(Mesh3d(open.clone()));
    }
    scene.cull(settings());
    assert_eq!((scene.mesh_of(a), scene.mesh_of(b)), (open.clone(), open));
}

#[test]
fn what_opted_out_is_left_alone_and_hides_nothing() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (outer, ball) = (scene.add_mesh(cube(2.0)), scene.add_mesh(cube(0.4)));
    let hull = scene.part(&outer, Vec3::ZERO);
    let root = scene.root;
    let group = scene
        .world()
        .spawn((
            Transform::default(),
            Visibility::default(),
            NoInteriorCulling,
            ChildOf(root),
        ))
        .id();
    let free = scene.part(&ball, Vec3::ZERO);
    scene.world().entity_mut(free).insert(ChildOf(group));
    let inside = scene.part(&ball, Vec3::new(0.5, 0.0, 0.0));
    scene.cull(settings());
    assert!(scene.is_hidden(inside) && !scene.is_hidden(free));
    assert!(
        scene
            .state()
            .to_string()
            .contains("1 node is left alone, opted out")
    );
    // It may move as it likes.
    if let Some(mut place) = scene.world().get_mut::<Transform>(group) {
        place.translation.y = 0.2;
    }
    scene.step();
    assert!(scene.is_hidden(inside));

    scene.world().entity_mut(hull).insert(NoInteriorCulling);
    scene.step();
    assert!(!scene.is_hidden(inside));
    scene.until("0 of 1 nodes");
    scene.world().entity_mut(hull).remove::<NoInteriorCulling>();
    scene.until("1 of 2 nodes");
    assert!(scene.is_hidden(inside));
}

#[test]
fn the_users_visibility_is_respected() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (outer, ball) = (scene.add_mesh(cube(2.0)), scene.add_mesh(cube(0.8)));
    let hull = scene.part(&outer, Vec3::ZERO);
    let inside = scene.part(&ball, Vec3::ZERO);
    let root = scene.root;
    scene.cull(settings());
    let show = |scene: &mut Scene, entity: Entity, visibility: Visibility| {
        scene.world().entity_mut(entity).insert(visibility);
        scene.step();
    };
    // The model comes and goes as a whole.
    show(&mut scene, root, Visibility::Hidden);
    assert!(scene.is_hidden(inside) && !scene.is_drawn(hull));
    show(&mut scene, root, Visibility::Inherited);
    assert!(scene.is_hidden(inside) && !scene.is_drawn(inside) && scene.is_drawn(hull));
    assert_eq!(scene.counts().hidden_nodes, 1);

    // Who takes away the hull wants to see what is inside.
    show(&mut scene, hull, Visibility::Hidden);
    assert!(scene.is_drawn(inside));
    scene.nothing_is_missing();
    scene.until("0 of 1 nodes");
    show(&mut scene, hull, Visibility::Inherited);
    scene.until("1 of 2 nodes");
    assert!(scene.is_hidden(inside));

    // What the user has hidden is not shown when culling ends.
    show(&mut scene, inside, Visibility::Hidden);
    assert!(!scene.is_drawn(inside));
    scene.world().entity_mut(root).remove::<InteriorCulling>();
    scene.step();
    assert!(!scene.is_drawn(inside));
    show(&mut scene, inside, Visibility::Inherited);
    assert!(scene.is_drawn(inside));

    // What is shown whether the root is or not, is seen when the root is hidden, with all its walls.
    show(&mut scene, inside, Visibility::Visible);
    scene.cull(settings());
    assert!(scene.is_hidden(inside));
    show(&mut scene, root, Visibility::Hidden);
    assert!(scene.is_drawn(inside) && !scene.is_drawn(hull));
    scene.until("0 of 1 nodes");
    assert!(scene.is_drawn(inside));
}

#[test]
fn meshes_are_waited_for_and_those_out_of_reach_left_alone() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    scene.begin(settings());
    scene.until("waiting for a mesh: there is none below the root");
    let outer = scene.add_mesh(cube(2.0));
    let hull = scene.part(&outer, Vec3::ZERO);
    let late = scene
        .world()
        .resource_mut::<Assets<Mesh>>()
        .reserve_handle();
    let inside = scene.part(&late, Vec3::ZERO);
    let mut far = cube(0.3);
    far.asset_usage = RenderAssetUsages::RENDER_WORLD;
    let far = scene.add_mesh(far);
    let away = scene.part(&far, Vec3::new(0.5, 0.0, 0.0));
    scene.until("idle: waiting for 1 of 2 meshes to load");
    for _ in 0..20 {
        scene.step();
    }
    assert!(!scene.is_hidden(inside) && !scene.is_hidden(away));
    let arrived = scene
        .world()
        .resource_mut::<Assets<Mesh>>()
        .insert(&late, cube(0.4));
    arrived.expect("the handle is its own");
    scene.until("are hidden");
    let words = scene.state().to_string();
    println!("{words}");
    assert!(scene.is_hidden(inside) && !scene.is_hidden(away) && !scene.is_hidden(hull));
    assert!(words.contains("RenderAssetUsages::MAIN_WORLD"), "{words}");
    assert_eq!(scene.counts().nodes, 2);
    // An edit of a mesh is another mesh.
    if let Some(mut mesh) = scene.world().resource_mut::<Assets<Mesh>>().get_mut(&outer) {
        mesh.scale_by(Vec3::splat(1.1));
    }
    scene.step();
    assert!(!scene.is_hidden(inside));
    scene.until("are hidden");
    assert!(scene.is_hidden(inside));
}

#[test]
fn a_mesh_that_comes_while_the_model_is_looked_through_is_not_waited_for() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let late = scene
        .world()
        .resource_mut::<Assets<Mesh>>()
        .reserve_handle();
    let inside = scene.part(&late, Vec3::ZERO);
    let outer = scene.add_mesh(cube(2.0));
    scene.part(&outer, Vec3::ZERO);
    // So many that it takes several frames; children are looked at in their order.
    let root = scene.root;
    let others = scene.world().spawn_batch(
        (0..60_000).map(move |_| (Transform::default(), Visibility::default(), ChildOf(root))),
    );
    drop(others);
    scene.begin(settings());
    scene.until("looking through the model");
    let arrived = scene
        .world()
        .resource_mut::<Assets<Mesh>>()
        .insert(&late, cube(0.4));
    arrived.expect("the handle is its own");
    scene.step();
    assert!(
        scene.state().to_string().contains("looking through"),
        "it was over too soon: {}",
        scene.state()
    );
    scene.until("are hidden");
    assert!(scene.is_hidden(inside));
}

#[test]
fn a_trimmed_mesh_that_is_indexed_is_restored_in_the_same_frame() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    // Two balls, one in the other, as one mesh, in halves that move apart.
    let mut both = Sphere::new(1.0).mesh().uv(120, 120);
    both.merge(&Sphere::new(0.6).mesh().uv(120, 120))
        .expect("the same attributes");
    let both = scene.add_mesh(both);
    let lid = scene.add_mesh(cube(3.0));
    let ball = scene.part(&both, Vec3::ZERO);
    let lid = scene.part(&lid, Vec3::ZERO);
    scene.world().entity_mut(ball).insert((
        SphericalIndex {
            chunk_triangles: 200,
            chunk_cost: 0,
            ..default()
        },
        Transform::from_xyz(0.0, 0.0, 1.2),
    ));
    scene.cull(settings());
    for _ in 0..400 {
        scene.step();
        std::thread::sleep(core::time::Duration::from_millis(1));
    }
    println!(
        "{}",
        scene.offline.app.world().resource::<Effects>().spherical()
    );
    // With the lid gone all of the ball shows, in that very frame.
    scene.world().despawn(lid);
    scene.step();
    let restored = scene.picture();
    let root = scene.root;
    scene.world().entity_mut(root).remove::<InteriorCulling>();
    scene.world().entity_mut(ball).remove::<SphericalIndex>();
    scene.step();
    scene.step();
    let plain = scene.picture();
    assert_eq!(differing_px(&restored, &plain), 0);
}

#[test]
fn a_lamp_hung_from_a_hidden_node_is_lit() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (outer, ball) = (scene.add_mesh(cube(2.0)), scene.add_mesh(cube(0.4)));
    scene.part(&outer, Vec3::ZERO);
    let inside = scene.part(&ball, Vec3::ZERO);
    scene.cull(settings());
    assert!(scene.is_hidden(inside));
    let lamp = (Transform::default(), Visibility::default(), ChildOf(inside));
    let lamp = scene.world().spawn(lamp).id();
    let is_lit = |scene: &Scene| {
        let world = scene.offline.app.world();
        world.get::<InheritedVisibility>(lamp).unwrap().get()
    };
    scene.step();
    assert!(is_lit(&scene) && !scene.is_hidden(inside));
    scene.until("0 of 2 nodes");
    assert!(is_lit(&scene));
    // With the lamp gone it can be hidden again, and what only listens goes with the model.
    scene.world().despawn(lamp);
    for _ in 0..100 {
        let root = scene.root;
        let brief = scene.world().spawn((Transform::default(), ChildOf(root)));
        let brief = brief.id();
        scene.step();
        scene.world().despawn(brief);
    }
    let root = scene.root;
    scene.world().entity_mut(root).remove::<InteriorCulling>();
    scene.nothing_is_held();
}

#[test]
fn what_goes_wrong_is_said_with_the_remedy() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let outer = scene.add_mesh(cube(2.0));
    let hull = scene.part(&outer, Vec3::ZERO);
    let grid = |grid| InteriorCulling { grid, ..settings() };
    scene.begin(grid(InteriorGrid::Resolution(0)));
    scene.until("idle: a grid of 0 cells is none; ask for 1");
    let root = scene.root;
    scene
        .world()
        .entity_mut(root)
        .insert(grid(InteriorGrid::Gap(f32::NAN)));
    scene.until("a gap of NaN is none");
    scene.world().entity_mut(root).insert(InteriorCulling {
        memory_mib: 1,
        ..grid(InteriorGrid::Resolution(3000))
    });
    scene.until("are allowed; allow as much");
    scene.world().entity_mut(root).insert(settings());
    scene.until("0 of 1 nodes and 0 of 12 triangles are hidden");
    if let Some(mut place) = scene.world().get_mut::<Transform>(hull) {
        place.translation.y = f32::INFINITY;
    }
    scene.until("not finite");
    scene.world().entity_mut(hull).insert(Transform::default());
    // A mirrored root turns its parts inside out.
    if let Some(mut place) = scene.world().get_mut::<Transform>(root) {
        place.scale.x = -1.0;
    }
    scene.until("nothing to cull; 1 node is left alone, drawn inside out");
    scene.world().entity_mut(root).remove::<InteriorCulling>();
    scene.nothing_is_held();
}

#[test]
fn materials_decide_what_is_a_wall() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (outer, ball) = (scene.add_mesh(cube(2.0)), scene.add_mesh(cube(0.8)));
    let hull = scene.part(&outer, Vec3::ZERO);
    let inside = scene.part(&ball, Vec3::ZERO);
    let material = scene
        .world()
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial::default());
    scene
        .world()
        .entity_mut(hull)
        .insert(MeshMaterial3d(material.clone()));
    scene.cull(settings());
    assert!(scene.is_hidden(inside));
    let edit = |scene: &mut Scene, edit: &dyn Fn(&mut StandardMaterial)| {
        let mut materials = scene.world().resource_mut::<Assets<StandardMaterial>>();
        if let Some(mut material) = materials.get_mut(&material) {
            edit(&mut material);
        }
        scene.step();
    };
    // Its colour is nothing to us.
    edit(&mut scene, &|material| {
        material.base_color = Color::srgba(0.2, 0.4, 0.9, 0.4)
    });
    assert!(scene.is_hidden(inside));
    edit(&mut scene, &|material| {
        material.alpha_mode = AlphaMode::Blend
    });
    assert!(scene.is_drawn(inside), "in the same frame");
    scene.nothing_is_missing();
    scene.until("0 of 2 nodes");
    edit(&mut scene, &|material| {
        material.alpha_mode = AlphaMode::Opaque
    });
    scene.until("1 of 2 nodes");
    // Without its material nothing is known of how it is drawn.
    scene
        .world()
        .entity_mut(hull)
        .remove::<MeshMaterial3d<StandardMaterial>>();
    scene.step();
    assert!(scene.is_drawn(inside));
    scene.until("with another material");
    assert!(scene.is_drawn(inside));
}

#[test]
fn models_that_are_the_same_share_what_was_found() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (whole, ball) = (scene.add_mesh(shell()), scene.add_mesh(cube(0.8)));
    let first = scene.root;
    let hull = scene.part(&whole, Vec3::ZERO);
    let inside = scene.part(&ball, Vec3::ZERO);
    let second = scene
        .world()
        .spawn((
            Transform::from_xyz(6.0, 1.0, 0.0),
            Visibility::default(),
            settings(),
        ))
        .id();
    scene.root = second;
    let other_hull = scene.part(&whole, Vec3::ZERO);
    let other_inside = scene.part(&ball, Vec3::ZERO);
    scene.root = first;
    scene.cull(settings());
    scene.until("2 of 4 nodes");
    assert_eq!(scene.mesh_of(hull), scene.mesh_of(other_hull));
    assert!(scene.is_hidden(inside) && scene.is_hidden(other_inside));
    let models = scene.world().resource::<InteriorModels>();
    assert_eq!((models.kept_results(), models.trimmed_meshes()), (1, 1));
    // One of them goes; the other keeps what they shared.
    let trimmed = scene.mesh_of(hull);
    scene.world().despawn(second);
    scene.step();
    scene.step();
    assert_eq!(scene.mesh_of(hull), trimmed);
    assert!(scene.is_hidden(inside));
    // A model of its own inside is none of the outer one's parts.
    scene.world().entity_mut(inside).insert(settings());
    scene.step();
    assert!(!scene.is_hidden(inside));
    scene.until("2 of 2 models");
    assert!(!scene.is_hidden(inside));
    scene.world().entity_mut(inside).remove::<InteriorCulling>();
    scene.until("1 of 2 nodes");
    assert!(scene.is_hidden(inside));
}

#[test]
fn a_node_with_something_seen_below_it_is_not_hidden() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let (outer, ball) = (scene.add_mesh(cube(2.0)), scene.add_mesh(cube(0.4)));
    scene.part(&outer, Vec3::ZERO);
    let [with_mast, with_ball] = [-0.5, 0.5].map(|x| scene.part(&ball, Vec3::new(x, 0.0, 0.0)));
    let mast = scene.part(&ball, Vec3::new(0.0, 2.0, 0.0));
    scene.world().entity_mut(mast).insert(ChildOf(with_mast));
    let below = scene.part(&ball, Vec3::ZERO);
    scene.world().entity_mut(below).insert(ChildOf(with_ball));
    let before = scene.pictures();
    scene.cull(settings());
    assert!(scene.is_drawn(mast) && !scene.is_hidden(with_mast));
    assert!(scene.is_hidden(with_ball) && scene.is_hidden(below));
    assert_eq!(scene.counts().hidden_nodes, 2);
    scene.same_pictures(&before);
    let root = scene.root;
    scene.world().entity_mut(root).remove::<InteriorCulling>();
    scene.step();
    assert!(scene.is_drawn(with_ball) && scene.is_drawn(below));
}

#[test]
fn a_mesh_given_by_the_user_meanwhile_stays() {
    let Some(mut scene) = Scene::new() else {
        return;
    };
    let whole = scene.add_mesh(shell());
    let [a, b] = [-1.5, 1.5].map(|x| scene.part(&whole, Vec3::new(x, 0.0, 0.0)));
    scene.cull(settings());
    let own = scene.add_mesh(cube(1.0));
    scene.world().entity_mut(a).insert(Mesh3d(own.clone()));
    scene.step();
    assert_eq!(
        (scene.mesh_of(a), scene.mesh_of(b)),
        (own.clone(), whole.clone())
    );
    scene.until("are hidden");
    assert_eq!(scene.mesh_of(a), own);
    assert_ne!(scene.mesh_of(b), whole);
    let root = scene.root;
    scene.world().entity_mut(root).remove::<InteriorCulling>();
    scene.step();
    assert_eq!((scene.mesh_of(a), scene.mesh_of(b)), (own, whole));
}

/// Nothing renders, and the plugin is the only one of the suite.
#[test]
fn it_works_alone_and_without_a_renderer() {
    let mut app = App::new();
    app.add_plugins((
        MinimalPlugins,
        AssetPlugin::default(),
        TransformPlugin,
        MeshPlugin,
        VisibilityPlugin,
        InteriorPlugin,
    ));
    app.finish();
    app.cleanup();
    let mut mesh = |mesh: Mesh| app.world_mut().resource_mut::<Assets<Mesh>>().add(mesh);
    let (whole, ball) = (mesh(shell()), mesh(cube(0.5)));
    let world = app.world_mut();
    let root = world
        .spawn((Transform::default(), Visibility::default(), settings()))
        .id();
    let [hull, inside] = [&whole, &ball].map(|mesh| {
        let paint = MeshMaterial3d::<StandardMaterial>::default();
        world
            .spawn((Mesh3d(mesh.clone()), paint, ChildOf(root)))
            .id()
    });
    app.update();
    let state = |app: &App| app.world().resource::<Effects>().interior().to_string();
    assert!(
        state(&app).starts_with("unsupported: the app has no StandardMaterial"),
        "{}",
        state(&app)
    );
    app.init_asset::<StandardMaterial>();
    let paint = app
        .world_mut()
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial::default());
    for entity in [hull, inside] {
        app.world_mut()
            .entity_mut(entity)
            .insert(MeshMaterial3d(paint.clone()));
    }
    for _ in 0..20_000 {
        app.update();
        if state(&app).contains("are hidden") {
            break;
        }
        std::thread::sleep(core::time::Duration::from_millis(1));
    }
    assert!(state(&app).contains("1 of 2 nodes"), "{}", state(&app));
    let shown = app.world().get::<InheritedVisibility>(inside);
    assert_eq!(shown, Some(&InheritedVisibility::HIDDEN));
    assert_ne!(
        app.world().get::<Mesh3d>(hull).map(|mesh| mesh.id()),
        Some(whole.id())
    );
}
