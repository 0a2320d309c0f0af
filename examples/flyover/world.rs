//! What the flight goes over, the effects that are switched on and off in it, and what moves.

use bevy::prelude::*;
use bevy_skyline::{prelude::*, terrain_shadow::ShadowMethod};

use super::{
    ground::{self, Painter},
    landmark::{self, Landmark},
    path,
    rocks::{self, Rock},
    site::Site,
    sky::{self, Sun},
    town::{self, Census, Vehicle},
};

/// What there is.
#[derive(Resource)]
pub struct Scenery {
    pub field: Handle<HeightField>,
    pub site: Site,
    pub terrain: Entity,
    pub camera: Entity,
    pub landmark: Entity,
}

/// How far the flight is, and what goes by it.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct Flight {
    /// 0 to 1.
    pub share: f32,
    /// Whether the camera follows the script.
    pub scripted: bool,
    /// Whether time goes on.
    pub running: bool,
    /// Whether the sun follows the script.
    pub sun_scripted: bool,
}

impl Flight {
    /// At its start, and not yet under way.
    pub fn start() -> Self {
        Self {
            share: 0.0,
            scripted: true,
            running: false,
            sun_scripted: true,
        }
    }
}

/// Which effects are on.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct Switches {
    pub terrain_shadow: bool,
    pub occlusion: bool,
    pub contribution: bool,
    pub interior: bool,
    pub spherical: bool,
    /// units: ms
    pub budget_ms: Option<f32>,
}

impl Switches {
    /// Nothing that leaves anything out; the picture is the same as with [`all`](Self::all), but for what is too small.
    pub const SHADOW_ALONE: Self = Self {
        terrain_shadow: true,
        occlusion: false,
        contribution: false,
        interior: false,
        spherical: false,
        budget_ms: None,
    };

    /// All, with or without a budget.
    pub fn all(budget_ms: Option<f32>) -> Self {
        Self {
            terrain_shadow: true,
            occlusion: true,
            contribution: true,
            interior: true,
            spherical: true,
            budget_ms,
        }
    }
}

/// Fills an empty world.
pub fn populate(world: &mut World, field: HeightField, buildings: usize) -> Census {
    let site = Site::find(&field, town::blocks(buildings));
    let painter = Painter::new(&field, &site);
    let colours = ground::colours(&field, &painter);
    let census = town::spawn(world, &field, &site, &painter);
    rocks::spawn(world, &field, &site);
    rocks::spawn_ships(world, &field, &site);
    let foot = site.centre;
    let foot = Vec3::new(foot.x, field.height_at(foot).unwrap_or(0.0), foot.y);
    let landmark = landmark::spawn(world, foot, site.turn());
    let colours = world.resource_mut::<Assets<Image>>().add(colours);
    sky::spawn(world, &field, path::sun(0.0, &site));
    let camera = world
        .spawn((
            Camera3d::default(),
            sky::lens(),
            path::camera(0.0, &field, &site),
        ))
        .id();
    let field = world.resource_mut::<Assets<HeightField>>().add(field);
    let terrain = world
        .spawn(Terrain::new(field.clone()).with_look(TerrainLook {
            colour: TerrainColour::Albedo(colours),
            ..default()
        }))
        .id();
    world.insert_resource(Scenery {
        field,
        site,
        terrain,
        camera,
        landmark,
    });
    census
}

/// Puts on and takes off what the switches say.
pub fn switch(world: &mut World) {
    let Some(switches) = world.get_resource_ref::<Switches>() else {
        return;
    };
    if !switches.is_changed() {
        return;
    }
    let on = *switches;
    world.resource_scope(|world, scenery: Mut<Scenery>| {
        fn set<T: Bundle>(world: &mut World, entity: Entity, on: bool, value: impl FnOnce() -> T) {
            let mut entity = world.entity_mut(entity);
            if on {
                entity.insert(value());
            } else {
                entity.remove::<T>();
            }
        }
        set(world, scenery.terrain, on.terrain_shadow, || {
            TerrainShadow {
                // The sun moves all the time: a method whose time does not depend on how low it stands.
                method: ShadowMethod::Sweep,
                ..default()
            }
        });
        let camera = scenery.camera;
        set(world, camera, on.occlusion, ZBufferOcclusion::default);
        set(world, camera, on.contribution, || ContributionCulling {
            threshold_px2: 4.0,
            ..default()
        });
        let budget = on.budget_ms;
        set(world, camera, budget.is_some(), ResolutionScale::default);
        set(world, camera, budget.is_some(), || {
            FrameBudget::from_ms(budget.unwrap_or(f32::NAN))
        });
        set(
            world,
            scenery.landmark,
            on.interior,
            InteriorCulling::default,
        );
        let mut rocks = world.query_filtered::<Entity, With<Rock>>();
        let rocks: Vec<Entity> = rocks.iter(world).collect();
        for rock in rocks {
            set(world, rock, on.spherical, SphericalIndex::default);
        }
    });
}

/// Moves camera, sun, vehicles and waves to where they are at this moment of the flight.
pub fn follow_script(world: &mut World) {
    let Some(&flight) = world.get_resource::<Flight>() else {
        return;
    };
    let time_s = path::FLIGHT_S * flight.share;
    world.resource_scope(|world, scenery: Mut<Scenery>| {
        world.resource_scope(|world, fields: Mut<Assets<HeightField>>| {
            let Some(field) = fields.get(&scenery.field) else {
                return;
            };
            if flight.sun_scripted {
                let sun = path::sun(flight.share, &scenery.site);
                world.resource_mut::<Sun>().set_if_neq(sun);
            }
            if flight.scripted {
                let place = path::camera(flight.share, field, &scenery.site);
                if let Some(mut camera) = world.get_mut::<Transform>(scenery.camera) {
                    *camera = place;
                }
            }
            let mut vehicles = world.query::<(&Vehicle, &mut Transform)>();
            town::drive(time_s, field, &scenery.site, vehicles.iter_mut(world));
        });
    });
    sky::run_waves(world, time_s);
    if let Some(camera) = world
        .get_resource::<Scenery>()
        .map(|scenery| scenery.camera)
    {
        sky::follow_camera(world, camera);
    }
}

/// There while the tower is cut open.
#[derive(Resource)]
pub struct CutOpen;

/// Lets pictures begin at the tower's axis, so that one looks into its far half; or where they usually do.
pub fn cut_open(world: &mut World) {
    let Some(scenery) = world.get_resource::<Scenery>() else {
        return;
    };
    let (camera, landmark) = (scenery.camera, scenery.landmark);
    let is_open = world.contains_resource::<CutOpen>();
    let place = |entity| world.get::<Transform>(entity).copied().unwrap_or_default();
    let (eye, axis) = (place(camera), place(landmark).translation);
    let away = (axis.xz() - eye.translation.xz()).dot(eye.forward().xz());
    let near = if is_open {
        away.max(sky::NEAR_M)
    } else {
        sky::NEAR_M
    };
    if let Some(mut projection) = world.get_mut::<Projection>(camera)
        && let Projection::Perspective(lens) = projection.bypass_change_detection()
        && lens.near != near
    {
        lens.near = near;
        projection.set_changed();
    }
}

/// Whether what effects do in the background is done.
pub fn is_settled(world: &mut World, on: Switches) -> bool {
    let interior = landmark_counts(world).is_some() == on.interior;
    let mut rocks = world.query_filtered::<Option<&SphericalCounts>, With<Rock>>();
    let chunks = |counts: Option<&SphericalCounts>| counts.is_some_and(|c| c.chunks > 0);
    let spherical = rocks
        .iter(world)
        .all(|counts| chunks(counts) == on.spherical);
    interior && spherical
}

/// What interior culling has taken out of the landmark.
pub fn landmark_counts(world: &mut World) -> Option<InteriorCounts> {
    let mut landmarks = world.query_filtered::<&InteriorCounts, With<Landmark>>();
    landmarks.iter(world).next().copied()
}
