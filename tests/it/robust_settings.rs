//! Settings of every component that are nobody's, in an app that draws: it goes on, says what it makes of them, and draws
//! as before when they are sound again.

use bevy::{math::DVec3, prelude::*};
use bevy_skyline::{
    budget::{BudgetClock, GivenFrameTimes},
    interior::FieldBy,
    offline::scenes::compare::differing_px,
    prelude::*,
    spherical::Bins,
};

use crate::{
    fuzz::{Lot, one_line},
    life_stage::{Stage, culling, front, index, interior, shadow},
};

fn camera_settings(lot: &mut Lot, mut camera: EntityWorldMut) {
    match lot.below(6) {
        0 => camera.insert(ZBufferOcclusion {
            volume: lot.pick(&[
                OccludeeVolume::Aabb,
                OccludeeVolume::Obb,
                OccludeeVolume::Proxy { triangles: 0 },
                OccludeeVolume::Proxy {
                    triangles: u32::MAX,
                },
            ]),
            sampling: if lot.one_in(2) {
                DepthSampling::Conservative { block: lot.u32() }
            } else {
                DepthSampling::Strided {
                    x: lot.u32(),
                    y: lot.u32(),
                }
            },
            recheck: lot.pick(&[Recheck::SameFrame, Recheck::Never]),
            gpu_from: lot.pick(&[0, 1, usize::MAX]),
            rests: lot.one_in(2),
        }),
        1 => camera.insert(ContributionCulling {
            threshold_px2: lot.f32(),
            hysteresis: lot.f32(),
            exit: if lot.one_in(2) {
                ContributionExit::Dithered { seconds: lot.f32() }
            } else {
                ContributionExit::Cut
            },
            weigh_by_visibility: lot.one_in(2),
            gpu_from: lot.pick(&[0, 1, usize::MAX]),
        }),
        2 => camera.insert(FrameBudget {
            target_ms: lot.f32(),
            clock: lot.pick(&[BudgetClock::Work, BudgetClock::Interval, BudgetClock::Given]),
        }),
        3 => camera.insert(ResolutionScale(lot.f32())),
        4 => camera.insert(TerrainRayCasting {
            traversal: lot.pick(&[
                Traversal::PerTexel,
                Traversal::MaxMip,
                Traversal::Boxes,
                Traversal::Hybrid,
            ]),
            box_texels: lot.u32(),
            max_error_px: lot.f32(),
        }),
        _ => camera.remove::<(FrameBudget, ResolutionScale)>(),
    };
}

fn terrain_settings(lot: &mut Lot, mut terrain: EntityWorldMut) {
    terrain.insert(TerrainShadow {
        method: lot.pick(&[
            ShadowMethod::PerTexel,
            ShadowMethod::MaxMip,
            ShadowMethod::Sweep,
        ]),
        lights: lot.pick(&[ShadowedLights::ShadowMaps, ShadowedLights::All]),
        penumbra_strips: lot.u32(),
        slice_ms: lot.f32(),
        on_meshes: lot.one_in(2),
    });
    let mut colour = || Color::linear_rgba(lot.f32(), lot.f32(), lot.f32(), lot.f32());
    let colours = [colour(), colour(), colour(), colour()];
    if let Some(mut terrain) = terrain.get_mut::<Terrain>() {
        terrain.look = TerrainLook {
            colour: TerrainColour::Bands {
                colours,
                edges: [lot.f32(), lot.f32(), lot.f32()],
                blend: lot.f32(),
            },
            perceptual_roughness: lot.f32(),
            metallic: lot.f32(),
            reflectance: lot.f32(),
        };
    }
}

/// With little memory: what it may take is the one thing that it is to believe.
fn model_settings(lot: &mut Lot, mut model: EntityWorldMut) {
    model.insert(InteriorCulling {
        grid: if lot.one_in(2) {
            InteriorGrid::Resolution(lot.u32())
        } else {
            InteriorGrid::Gap(lot.f32())
        },
        level: lot.pick(&[InteriorLevel::Node, InteriorLevel::Triangle]),
        mode: lot.pick(&[InteriorMode::Sampled, InteriorMode::Conservative]),
        transparent: lot.pick(&[InteriorTransparent::Open, InteriorTransparent::Closed]),
        faces: lot.pick(&[InteriorFaces::AsDrawn, InteriorFaces::TwoSided]),
        field: lot.pick(&[FieldBy::Cpu, FieldBy::Gpu]),
        memory_mib: lot.pick(&[0, 1, 16]),
    });
}

fn change(lot: &mut Lot, stage: &mut Stage) {
    let last_ms = lot.one_in(2).then(|| lot.f32());
    stage.world().insert_resource(GivenFrameTimes { last_ms });
    let (camera, terrain, model) = (stage.camera, stage.terrain, stage.model);
    let (ball, sun) = (stage.ball, stage.sun);
    let world = stage.world();
    match lot.below(8) {
        0..=2 => camera_settings(lot, world.entity_mut(camera)),
        3 | 4 => terrain_settings(lot, world.entity_mut(terrain)),
        5 => model_settings(lot, world.entity_mut(model)),
        6 => {
            let side = |lot: &mut Lot| lot.pick(&[0, 1, 2, 180, 400, u16::MAX]);
            world.entity_mut(ball).insert(SphericalIndex {
                bins: Bins {
                    theta: side(lot),
                    phi: side(lot),
                },
                mode: lot.pick(&[SphericalMode::Conservative, SphericalMode::Paper]),
                chunk_triangles: lot.u32(),
                chunk_cost: lot.u32(),
            });
        }
        _ => {
            let place = DVec3::new(lot.f64(), lot.f64(), lot.f64());
            let exact = if lot.one_in(2) {
                ExactLight::Direction(place)
            } else {
                ExactLight::Position(place)
            };
            world.entity_mut(sun).insert(exact);
        }
    }
}

#[test]
fn settings_that_are_nobodys_are_outlived() {
    let Some(mut stage) = Stage::new() else {
        return;
    };
    let before = stage.settled();
    let counts = stage.count();
    for number in 0..90 {
        let mut lot = Lot::of("settings", number);
        change(&mut lot, &mut stage);
        stage.steps(1 + number as u32 % 3);
        assert!(!stage.has_ended(), "case {number}: {}", stage.states());
        for (effect, state) in stage.effects().iter() {
            assert_eq!(
                one_line(&state.to_string()),
                Ok(()),
                "case {number}: {effect:?}"
            );
        }
    }
    println!("{}", stage.states());
    let (camera, terrain, model, ball, sun) = (
        stage.camera,
        stage.terrain,
        stage.model,
        stage.ball,
        stage.sun,
    );
    let look = TerrainLook {
        colour: TerrainColour::Albedo(stage.albedo.clone()),
        ..default()
    };
    let world = stage.world();
    world
        .entity_mut(camera)
        .remove::<(FrameBudget, ResolutionScale, TerrainRayCasting)>();
    world.entity_mut(camera).insert((culling(), front()));
    world.entity_mut(terrain).insert(shadow());
    if let Some(mut terrain) = world.get_mut::<Terrain>(terrain) {
        terrain.look = look;
    }
    world.entity_mut(model).insert(interior());
    world.entity_mut(ball).insert(index());
    world.entity_mut(sun).remove::<ExactLight>();
    let after = stage.settled();
    assert_eq!(differing_px(&before, &after), 0);
    assert_eq!(stage.count(), counts);
}
