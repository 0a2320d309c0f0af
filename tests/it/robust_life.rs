//! What comes to pass in the life of an app: targets without an inch, things that go while they are worked on, assets
//! exchanged meanwhile, several apps in one process. Afterwards the picture is what it was.

use bevy::{
    camera::{RenderTarget, Viewport},
    prelude::*,
    render::error_handler::{RenderErrorHandler, RenderErrorPolicy},
    window::{WindowRef, WindowResolution},
};
use bevy_skyline::{offline::scenes::compare::differing_px, prelude::*};

use crate::life_stage::{Stage, ball, front, hills, interior, shadow, stripes};

/// The comparator's sabotage: what changes a little is seen.
#[test]
fn a_picture_that_differs_is_told() {
    let Some(mut stage) = Stage::new() else {
        return;
    };
    let before = stage.settled();
    println!("{}", stage.states());
    stage.steps(3);
    assert_eq!(differing_px(&before, &stage.picture()), 0);
    let wall = stage.boxes[0];
    stage.world().despawn(wall);
    stage.steps(3);
    assert!(differing_px(&before, &stage.picture()) > 20);
}

#[test]
fn a_target_without_size_is_outlived() {
    let Some(mut stage) = Stage::new() else {
        return;
    };
    let before = stage.settled();
    let camera = stage.camera;
    // A window that is minimised has no size.
    let minimised = Window {
        resolution: WindowResolution::new(0, 0),
        ..default()
    };
    let window = stage.world().spawn(minimised).id();
    let none = [
        RenderTarget::Window(WindowRef::Entity(window)),
        RenderTarget::None { size: UVec2::ZERO },
        RenderTarget::None {
            size: UVec2::new(0, 48),
        },
    ];
    for none in none {
        let target = RenderTarget::Image(stage.target.clone().into());
        stage.world().entity_mut(camera).insert(none.clone());
        stage.steps(5);
        assert!(!stage.has_ended(), "{none:?}");
        stage.world().entity_mut(camera).insert(target);
        let after = stage.settled();
        assert_eq!(differing_px(&before, &after), 0, "{none:?}");
    }
}

/// Bevy 0.19.1 itself asks for textures of no size for such a viewport (`clustering dummy texture`), where it clusters
/// lights on the GPU; the app is asked to go on all the same.
#[test]
fn a_viewport_without_area_is_outlived() {
    let Some(mut stage) = Stage::with(|app| {
        app.insert_resource(RenderErrorHandler(|_, _, _| RenderErrorPolicy::Ignore));
    }) else {
        return;
    };
    stage.cluster_on_the_cpu();
    let before = stage.settled();
    let camera = stage.camera;
    for size in [
        UVec2::ZERO,
        UVec2::new(0, 20),
        UVec2::new(20, 0),
        UVec2::ONE,
    ] {
        let viewport = Viewport {
            physical_position: UVec2::new(3, 5),
            physical_size: size,
            ..default()
        };
        let set = |stage: &mut Stage, viewport| {
            let mut of = stage.world().get_mut::<Camera>(camera).expect("a camera");
            of.viewport = viewport;
        };
        set(&mut stage, Some(viewport));
        stage.steps(5);
        assert!(!stage.has_ended(), "{size}");
        set(&mut stage, None);
        let after = stage.settled();
        assert_eq!(differing_px(&before, &after), 0, "{size}");
    }
}

/// What goes: it is despawned, and spawned anew as it was.
type Goes = (&'static str, fn(&Stage) -> Entity, fn(&mut Stage));

const ALL_THAT_GOES: [Goes; 5] = [
    ("terrain", |stage| stage.terrain, Stage::spawn_terrain),
    ("sun", |stage| stage.sun, Stage::spawn_sun),
    ("camera", |stage| stage.camera, Stage::spawn_camera),
    ("model", |stage| stage.model, Stage::spawn_model),
    ("ball", |stage| stage.ball, Stage::spawn_ball),
];

/// After so many frames some shadow tiles are made and others not, a model is looked through, copied or worked on, a mesh
/// is indexed, a verdict of the GPU is on its way.
#[test]
fn what_goes_while_it_is_worked_on_leaves_nothing_behind() {
    let Some(mut stage) = Stage::new() else {
        return;
    };
    let before = stage.settled();
    let counts = stage.count();
    for frames in [1, 2, 4, 9, 14] {
        for (name, entity, spawn) in ALL_THAT_GOES {
            // Begun anew, then gone in the middle of it.
            let gone = entity(&stage);
            stage.world().despawn(gone);
            stage.step();
            spawn(&mut stage);
            stage.steps(frames);
            let gone = entity(&stage);
            stage.world().despawn(gone);
            stage.steps(frames % 3);
            spawn(&mut stage);
            assert!(!stage.has_ended(), "{name} after {frames}");
        }
        let after = stage.settled();
        assert_eq!(differing_px(&before, &after), 0, "after {frames} frames");
        assert_eq!(stage.count(), counts, "after {frames} frames");
    }
    // All at once, and in the very frame in which it came.
    for (_, entity, _) in ALL_THAT_GOES {
        let gone = entity(&stage);
        stage.world().despawn(gone);
    }
    stage.steps(2);
    for (_, entity, spawn) in ALL_THAT_GOES {
        spawn(&mut stage);
        let gone = entity(&stage);
        stage.world().despawn(gone);
    }
    stage.steps(3);
    for effect in [
        stage.effects().terrain(),
        stage.effects().terrain_shadow(),
        stage.effects().interior(),
        stage.effects().spherical(),
    ] {
        assert_eq!(*effect, EffectState::Dormant, "{}", stage.states());
    }
    for (_, _, spawn) in ALL_THAT_GOES {
        spawn(&mut stage);
    }
    let after = stage.settled();
    assert_eq!(differing_px(&before, &after), 0);
    assert_eq!(stage.count(), counts);
}

/// One exchange of assets; `false` puts back what was there.
type Exchange = (&'static str, fn(&mut Stage, bool));

const EXCHANGES: [Exchange; 6] = [
    ("edited heights", |stage, other| {
        let field = stage.field.clone();
        let mut fields = stage.world().resource_mut::<Assets<HeightField>>();
        let mut field = fields.get_mut(&field).expect("a field");
        let rect = URect::new(10, 10, 40, 50);
        let whole = hills();
        let edited = field.edit(rect, |x, z, _| {
            whole.sample_m(x, z) as f32 + if other { 3.0 } else { 0.0 }
        });
        edited.expect("it is within the field");
    }),
    ("other heights", |stage, other| {
        let field = stage.field.clone();
        let made = if other {
            HeightField::from_f32(UVec2::new(33, 21), 2.0, vec![1.5; 33 * 21])
        } else {
            Ok(hills())
        };
        let mut fields = stage.world().resource_mut::<Assets<HeightField>>();
        fields
            .insert(&field, made.expect("sound"))
            .expect("its own");
    }),
    ("no heights", |stage, other| {
        let field = stage.field.clone();
        let mut fields = stage.world().resource_mut::<Assets<HeightField>>();
        if other {
            fields.remove(&field);
        } else {
            fields.insert(&field, hills()).expect("its own");
        }
    }),
    ("another ball", |stage, other| {
        let mesh = stage.meshes.ball.clone();
        let mut meshes = stage.world().resource_mut::<Assets<Mesh>>();
        meshes
            .insert(&mesh, ball(if other { 9 } else { 16 }))
            .expect("its own");
    }),
    ("another core", |stage, other| {
        let mesh = stage.meshes.core.clone();
        let radius = if other { 2.9 } else { 1.0 };
        let mut meshes = stage.world().resource_mut::<Assets<Mesh>>();
        if other {
            meshes.remove(&mesh);
        }
        let made = Sphere::new(radius).mesh().uv(24, 12);
        meshes.insert(&mesh, made).expect("its own");
    }),
    ("no picture", |stage, other| {
        let albedo = stage.albedo.clone();
        let mut images = stage.world().resource_mut::<Assets<Image>>();
        if other {
            images.remove(&albedo);
        } else {
            images.insert(&albedo, stripes()).expect("its own");
        }
    }),
];

#[test]
fn assets_may_be_exchanged_while_they_are_worked_on() {
    let Some(mut stage) = Stage::new() else {
        return;
    };
    let before = stage.settled();
    let counts = stage.count();
    for frames in [1, 2, 5, 11] {
        for (name, exchange) in EXCHANGES {
            // Work begins with the new, and is in the middle of it when the old comes back.
            exchange(&mut stage, true);
            stage.steps(frames);
            assert!(!stage.has_ended(), "{name} for {frames}");
            exchange(&mut stage, false);
        }
        let after = stage.settled();
        assert_eq!(differing_px(&before, &after), 0, "for {frames} frames");
    }
    // What is exchanged for good is drawn.
    for (name, exchange) in EXCHANGES {
        exchange(&mut stage, true);
        stage.steps(40);
        assert!(!stage.has_ended(), "{name}");
        // What is hidden does not show, and ground keeps the last picture that it had.
        if !["another core", "no picture"].contains(&name) {
            assert!(differing_px(&before, &stage.picture()) > 0, "{name}");
        }
        exchange(&mut stage, false);
        let after = stage.settled();
        assert_eq!(differing_px(&before, &after), 0, "{name}");
    }
    // Everything at once, in one frame, there and back.
    for (_, exchange) in EXCHANGES {
        exchange(&mut stage, true);
        exchange(&mut stage, false);
    }
    let after = stage.settled();
    assert_eq!(differing_px(&before, &after), 0);
    assert_eq!(stage.count(), counts);
}

/// Components come and go in the middle of their own work.
#[test]
fn settings_may_come_and_go_at_any_frame() {
    let Some(mut stage) = Stage::new() else {
        return;
    };
    let before = stage.settled();
    for frames in [0, 1, 3, 6] {
        let (terrain, model, ball_, camera) =
            (stage.terrain, stage.model, stage.ball, stage.camera);
        stage.world().entity_mut(terrain).remove::<TerrainShadow>();
        stage.world().entity_mut(model).remove::<InteriorCulling>();
        stage.steps(frames);
        stage.world().entity_mut(ball_).remove::<SphericalIndex>();
        stage
            .world()
            .entity_mut(camera)
            .remove::<(ZBufferOcclusion, ContributionCulling)>();
        stage.world().entity_mut(terrain).insert(shadow());
        stage.steps(frames);
        stage
            .world()
            .entity_mut(camera)
            .insert((crate::life_stage::culling(), ResolutionScale(0.4)));
        stage.world().entity_mut(model).insert(interior());
        stage.steps(frames);
        stage
            .world()
            .entity_mut(ball_)
            .insert(crate::life_stage::index());
        stage.world().entity_mut(camera).remove::<ResolutionScale>();
        let after = stage.settled();
        assert_eq!(differing_px(&before, &after), 0, "{frames} frames");
    }
}

/// Places that a camera looks from, one a frame.
fn place(frame: u32) -> Transform {
    let turn = Quat::from_rotation_y(0.2 * (frame as f32 * 0.7).sin());
    let mut place = front();
    place.rotate_around(Vec3::new(32.0, 4.0, 36.0), turn);
    place
}

/// Pictures of some frames.
fn film(stages: &mut [Stage]) -> Vec<Vec<image::RgbaImage>> {
    let mut films = vec![Vec::new(); stages.len()];
    for frame in 0..8 {
        // One goes ahead of the other by a frame each time.
        for (number, stage) in stages.iter_mut().enumerate() {
            let camera = stage.camera;
            let at = place(frame + 3 * number as u32);
            stage.world().entity_mut(camera).insert(at);
        }
        for stage in stages.iter_mut() {
            stage.step();
        }
        for (film, stage) in films.iter_mut().zip(stages.iter()) {
            film.push(stage.picture());
        }
    }
    films
}

#[test]
fn apps_beside_each_other_and_after_each_other_draw_as_one_alone() {
    let ready = || {
        let mut stage = Stage::new()?;
        stage.settled();
        Some(stage)
    };
    let Some(stage) = ready() else {
        return;
    };
    let alone = film(&mut [stage]).remove(0);
    // The first has gone; two come after it, at once.
    let (Some(one), Some(other)) = (ready(), ready()) else {
        return;
    };
    let mut stages = [one, other];
    let films = film(&mut stages);
    let same = |a: &[image::RgbaImage], b: &[image::RgbaImage]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| differing_px(a, b))
            .sum::<u64>()
    };
    assert_eq!(same(&films[0], &alone), 0);
    // The other is three places ahead.
    assert_eq!(same(&films[1][..5], &alone[3..]), 0);
    assert!(same(&films[1], &alone) > 100, "all places look the same");
    // One goes, and the other stays as it was.
    let [one, other] = stages;
    drop(one);
    let mut left = [other];
    let camera = left[0].camera;
    left[0].world().entity_mut(camera).insert(front());
    let again = film(&mut left).remove(0);
    assert_eq!(same(&again, &alone), 0);
}
