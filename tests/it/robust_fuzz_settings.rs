//! Settings, transforms and measurements that are nobody's, handed to what the components and systems compute with: no
//! panic, no result that is no number where one is promised, and errors of one line.

use core::num::NonZero;
use std::sync::Arc;

use bevy::{
    camera::{CameraProjection, OrthographicProjection, PerspectiveProjection},
    math::{Affine3A, DAffine3, DMat3, DVec3, DVec4, Mat3A, Mat4, URect, UVec2, Vec2, Vec3, Vec3A},
};
use bevy_skyline::{
    budget::{
        Knob, KnobCost,
        controller::{Contribution, Controller, Input, Measured},
        policy::{InView, distance_m, nearest_within},
        workload::{DemandProfile, Workload},
    },
    contribution::{area::AreaView, rank::Standard},
    culling::volume::LocalBox,
    interior::{
        InteriorCulling, InteriorFaces, InteriorGrid, InteriorLevel, InteriorMode,
        InteriorTransparent, Model, Part, Progress, Surface, cull,
    },
    occlusion::{
        DepthSampling,
        depth::ReducedDepth,
        obb,
        pace::{self, Pace},
        proxy,
        verdict::DepthTest,
    },
    spherical::{
        Bins, Eye, Frustum, Layout, MapSettings, PaperScratch, Ray, Shown, SphericalChunks,
        SphericalMaps, View, half_space_in_local,
    },
    terrain::view_rays::{ViewInputs, ViewRays, near_plane_bounds},
    terrain_shadow::{
        ShadowMethod,
        light::{GridLight, strip_above},
        plan::{MadeFor, MapPlan},
        tiles::{EditReach, TileGrid},
    },
};

use crate::fuzz::{Lot, holds, refused, run};

/// One number in so many is hostile.
const ODD: usize = 12;

fn vec3(lot: &mut Lot, reach: f64) -> Vec3 {
    Vec3::from_array([(); 3].map(|()| (lot.mostly(2.0 * reach, ODD) - reach) as f32))
}

fn dvec3(lot: &mut Lot, reach: f64) -> DVec3 {
    DVec3::from_array([(); 3].map(|()| lot.mostly(2.0 * reach, ODD) - reach))
}

fn affine(lot: &mut Lot) -> Affine3A {
    let axes = [(); 3].map(|()| Vec3A::from(vec3(lot, 2.0)));
    Affine3A {
        matrix3: Mat3A::from_cols(axes[0], axes[1], axes[2]),
        translation: Vec3A::from(vec3(lot, 50.0)),
    }
}

fn daffine(lot: &mut Lot) -> DAffine3 {
    let axes = [(); 3].map(|()| dvec3(lot, 2.0));
    DAffine3 {
        matrix3: DMat3::from_cols(axes[0], axes[1], axes[2]),
        translation: dvec3(lot, 50.0),
    }
}

/// A projection of a camera, or a matrix that is none.
fn projection(lot: &mut Lot) -> Mat4 {
    match lot.below(4) {
        0 => OrthographicProjection {
            near: lot.mostly(1.0, ODD) as f32,
            far: lot.mostly(90.0, ODD) as f32,
            scale: lot.mostly(9.0, ODD) as f32,
            ..OrthographicProjection::default_3d()
        }
        .get_clip_from_view(),
        1 => Mat4::from_cols_array(&[(); 16].map(|()| lot.mostly(2.0, ODD) as f32)),
        _ => PerspectiveProjection {
            fov: lot.mostly(3.0, ODD) as f32,
            aspect_ratio: lot.mostly(3.0, ODD) as f32,
            near: lot.mostly(1.0, ODD) as f32,
            far: lot.mostly(900.0, ODD) as f32,
            ..PerspectiveProjection::default()
        }
        .get_clip_from_view(),
    }
}

fn volume(lot: &mut Lot) -> LocalBox {
    LocalBox {
        centre: vec3(lot, 9.0),
        axes: [(); 3].map(|()| vec3(lot, 3.0)),
    }
}

#[test]
fn no_view_makes_areas_rays_or_depth_tests_panic() {
    let tally = run("views", 1 << 20, |lot| {
        let place = affine(lot);
        let clip_from_world = projection(lot) * Mat4::from(place);
        let size = Vec2::new(lot.mostly(90.0, ODD) as f32, lot.mostly(60.0, ODD) as f32);
        let (world, volume) = (affine(lot), volume(lot));
        let area = AreaView::new(clip_from_world, size).area_px2(&world, &volume);
        holds(area >= 0.0, || format!("{area} px² of {volume:?}"))?;
        let standard = Standard {
            own_px2: lot.f32(),
            hysteresis: lot.f32(),
            never_px2: lot.f32(),
        };
        let (triangles, was_gone) = (lot.u32(), lot.one_in(2));
        let _ = (
            standard.least_px2(area, triangles, lot.f32(), was_gone),
            standard.stays_up_to_px2(area, triangles, was_gone),
            distance_m(vec3(lot, 9.0), &world, &volume),
        );

        let sampling = if lot.one_in(2) {
            DepthSampling::Conservative { block: lot.u32() }
        } else {
            DepthSampling::Strided {
                x: lot.u32(),
                y: lot.u32(),
            }
        };
        let viewport = UVec2::new(lot.below(24) as u32, lot.below(24) as u32);
        let any = UVec2::new(lot.u32(), lot.u32());
        let block = sampling.block(any);
        holds(
            block.min_element() >= 1 && block.max_element() <= 64,
            || format!("blocks of {block} for {sampling:?} of {any}"),
        )?;
        let _ = (sampling.for_viewport(any), sampling.complaint());
        let pixels = (viewport.x * viewport.y) as usize + usize::from(lot.one_in(20));
        let depths = lot.many(pixels, |lot| lot.mostly(0.2, ODD) as f32);
        let depth = match ReducedDepth::from_pixels(clip_from_world, viewport, sampling, &depths) {
            Ok(mut depth) => {
                if lot.one_in(9) {
                    depth.texels.pop();
                    depth.block = any;
                }
                depth
            }
            Err(error) => {
                refused(&error)?;
                ReducedDepth::header(clip_from_world, any, sampling)
            }
        };
        let test = DepthTest::new(&depth);
        let _ = test.verdict(&world, &volume, None, None);
        let share = test.visible_share(&world, &volume);
        holds((0.0..=1.0).contains(&share), || {
            format!("{share} of it is visible")
        })?;

        let clip_from_view = projection(lot);
        let (low, high) = (lot.unit() * 90.0, 90.0 + lot.unit());
        let grid_from_view = daffine(lot);
        let rays = ViewRays::new(&ViewInputs {
            clip_from_view,
            grid_from_view,
            size_px: if lot.one_in(5) { any } else { viewport },
            cells: UVec2::new(1 + lot.below(900) as u32, 1 + lot.below(900) as u32),
            height_range: (low, high),
            whole_heights: lot.one_in(2),
            max_error_px: lot.f32(),
        });
        let near = near_plane_bounds(clip_from_view, grid_from_view);
        holds(
            near.is_none_or(|(low, high)| low.is_finite() && high.is_finite()),
            || format!("a near plane at {near:?}"),
        )?;
        if let Some(rays) = &rays {
            let _ = (
                rays.ray(vec3(lot, 9.0).truncate()),
                rays.view_depth(lot.f32()),
                rays.sees_terrain(),
            );
        }
        Ok(rays.is_some())
    });
    tally.expect_both(50);
}

#[test]
fn no_light_makes_shadow_planning_panic() {
    let tally = run("lights", 1 << 20, |lot| {
        let grid = daffine(lot);
        let light = if lot.one_in(2) {
            GridLight::directional(dvec3(lot, 1.0), lot.mostly(0.1, ODD), grid)
        } else {
            GridLight::point(
                dvec3(lot, 90.0),
                lot.mostly(1.0, ODD),
                lot.mostly(90.0, ODD),
                grid,
            )
        };
        if !light.is_usable() {
            return Ok(false);
        }
        let size = UVec2::new(2 + lot.below(150) as u32, 2 + lot.below(150) as u32);
        let from = DVec3::new(lot.unit() * 90.0, lot.unit() * 9.0, lot.unit() * 90.0);
        let _ = (light.ray(from), light.disc(from), light.can_sweep());
        let share = strip_above(lot.mostly(2.0, ODD) - 1.0, (-1.0 + lot.unit(), lot.unit()));
        holds((0.0..=1.0).contains(&share) || share.is_nan(), || {
            format!("a share of {share}")
        })?;
        let Some(reached) = light.reached(size) else {
            return Ok(true);
        };
        holds(!reached.is_empty() && reached.max.cmple(size).all(), || {
            format!("{reached:?} of {size} are reached")
        })?;
        let min = UVec2::new(
            lot.below(size.x as usize) as u32,
            lot.below(size.y as usize) as u32,
        );
        let edit = URect {
            min,
            max: (min + 3).min(size),
        };
        let reach = EditReach::new(&light, edit, (0.0, lot.unit() * 90.0));
        // A map comes to its end, whatever slices it is made in, and each tile is made.
        let method = lot.pick(&[ShadowMethod::PerTexel, ShadowMethod::MaxMip]);
        let wanted = MadeFor::new(&light, method, lot.u32(), 0);
        let tiles = TileGrid::over(reached);
        let mut plan = MapPlan::new(tiles);
        let mut is_made = vec![false; tiles.len() as usize];
        for tile in 0..tiles.len() {
            if reach.touches(tiles.samples(tile, size)) {
                plan.touch(tile);
            }
        }
        let budget = if lot.one_in(2) {
            lot.draw()
        } else {
            lot.below(99_999) as u64
        };
        let hidden = lot.u32();
        for _ in 0..4 * tiles.len() + 9 {
            if plan.is_done(&wanted) {
                break;
            }
            let _ = plan.step(&wanted, None, budget, |tile| tile != hidden);
            for tile in plan.list() {
                is_made[*tile as usize] = true;
            }
        }
        holds(plan.is_done(&wanted) && !is_made.contains(&false), || {
            format!(
                "{wanted:?} is not made of {} tiles with {budget} rays a frame",
                tiles.len()
            )
        })?;
        Ok(true)
    });
    tally.expect_both(50);
}

fn work(lot: &mut Lot) -> Workload {
    Workload {
        objects: lot.mostly(900.0, 40),
        triangles: lot.mostly(1e6, 40),
        pixels: lot.mostly(1e6, 40),
        rays: lot.mostly(1e6, 40),
    }
}

#[test]
fn no_measurement_makes_the_budget_panic() {
    let tally = run("budget", 1 << 20, |lot| {
        let mut knobs = Vec::new();
        for _ in 0..lot.below(3) {
            let steps = lot.below(4);
            let mut loss = 0.0;
            let steps = lot.many(steps, |lot| {
                loss += lot.mostly(0.1, 40) as f32;
                (
                    loss,
                    if lot.one_in(20) {
                        loss
                    } else {
                        loss - 0.1 * lot.unit() as f32
                    },
                )
            });
            // Sound steps begin at no loss, and losses never fall.
            let steps: Vec<(f32, f32)> = if lot.one_in(3) {
                steps
            } else {
                (0..=steps.len())
                    .map(|step| (step as f32, 0.1 * step as f32))
                    .collect()
            };
            match Knob::new("knob", "px", &steps, KnobCost::Measured) {
                Ok(knob) => knobs.push(knob),
                Err(error) => drop(refused(&error)?),
            }
        }
        let mut controller = Controller::default();
        let mut pace = Pace::default();
        let mut profile = DemandProfile::default();
        let any = lot.mostly(20.0, 9) as f32;
        let mut frame = if lot.one_in(9) {
            u64::MAX - 60
        } else {
            lot.below(9) as u64
        };
        for _ in 0..50 {
            profile.clear();
            profile.add_picture(if lot.one_in(30) { lot.f32() } else { 5_000.0 });
            for _ in 0..5 {
                let stays = if lot.one_in(30) {
                    lot.f32()
                } else {
                    lot.unit() as f32 * 100.0
                };
                let work = Workload::object(lot.u32(), stays, lot.mostly(5_000.0, 40) as f32);
                profile.add(stays, work);
            }
            if lot.one_in(9) {
                profile.add_fixed(work(lot));
            }
            profile.finish();
            let past = frame.saturating_sub(lot.below(4) as u64);
            let decision = controller.step(
                &Input {
                    frame,
                    target_ms: if lot.one_in(9) { any } else { 10.0 },
                    measured: (!lot.one_in(4)).then(|| Measured {
                        frame: past,
                        ms: lot.mostly(25.0, ODD) as f32,
                    }),
                    profile: &profile,
                    contribution: match lot.below(9) {
                        0 => Contribution::Absent,
                        1 => Contribution::Manual(any),
                        _ => Contribution::Budget,
                    },
                    quantum_ms: lot.one_in(5).then(|| lot.mostly(16.0, 4) as f32),
                },
                &mut knobs,
            );
            if lot.one_in(9) {
                controller.drew(frame, work(lot));
            }
            let demanded = decision.demanded_px2;
            holds(
                demanded >= 0.0 || demanded.to_bits() == any.to_bits(),
                || format!("{demanded} px² are demanded"),
            )?;
            for knob in &knobs {
                holds(knob.stands_at() < knob.steps.len(), || {
                    "a knob stands beside its steps".into()
                })?;
            }
            let _ = pace.step(&pace::Frame {
                frame_ms: lot.mostly(20.0, ODD) as f32,
                own_ms: lot.mostly(2.0, ODD) as f32,
                in_view: lot.below(900),
                removed: if lot.one_in(20) {
                    lot.u32() as usize
                } else {
                    lot.below(90)
                },
                judged: lot.one_in(2),
            });
            frame = frame.wrapping_add(1);
        }
        let mut objects = lot.many(9, |lot| InView {
            at: lot.u32(),
            distance_m: lot.f32(),
            triangles: lot.u32(),
        });
        let most = if lot.one_in(2) {
            lot.draw()
        } else {
            u64::from(lot.u32())
        };
        holds(nearest_within(&mut objects, most) <= 9, || {
            "more than there are".into()
        })?;
        Ok(true)
    });
    assert!(tally.cases == 0 || tally.taken > 0);
}

/// Positions and triangles: one list in so many is hostile.
fn mesh(lot: &mut Lot) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let vertices = lot.below(12);
    let odd = if lot.one_in(3) { 20 } else { 1_000_000 };
    let scale = if lot.one_in(5) {
        10f64.powi(lot.below(70) as i32 - 35)
    } else {
        1.0
    };
    let positions = lot.many(vertices, |lot| {
        [(); 3].map(|()| (scale * lot.mostly(1.0, odd)) as f32)
    });
    let triangles = lot.below(20);
    let triangles = lot.many(triangles, |lot| {
        [(); 3].map(|()| {
            if lot.one_in(2_000) {
                lot.u32()
            } else {
                lot.below(vertices) as u32
            }
        })
    });
    (positions, triangles)
}

#[test]
fn no_mesh_or_setting_makes_the_spherical_index_panic() {
    let tally = run("spherical", 64 << 20, |lot| {
        let (positions, triangles) = mesh(lot);
        let bins = |lot: &mut Lot| {
            if lot.one_in(600) {
                lot.u32() as u16
            } else {
                1 + lot.below(20) as u16
            }
        };
        let settings = MapSettings {
            bins: Bins {
                theta: bins(lot),
                phi: bins(lot),
            },
            layout: lot.pick(&[Layout::Rows, Layout::Blocks]),
            chunk_triangles: if lot.one_in(3) {
                lot.u32()
            } else {
                1 + lot.below(9) as u32
            },
            index_bytes: if lot.one_in(3) {
                lot.u32() as usize
            } else {
                4096
            },
        };
        let maps = match SphericalMaps::build(&positions, &triangles, settings) {
            Ok(maps) => maps,
            Err(error) => return refused(&error),
        };
        let mut order = maps.order.clone();
        order.sort_unstable();
        holds(order.iter().copied().eq(0..triangles.len() as u32), || {
            format!(
                "{:?} is no order of {} triangles",
                maps.order,
                triangles.len()
            )
        })?;
        let whole = triangles.len() as u32;
        holds(
            maps.cuts.is_sorted() && maps.cuts.last().is_none_or(|last| *last == whole),
            || format!("cut at {:?}", maps.cuts),
        )?;
        let chunks = match SphericalChunks::build(&positions, &triangles, &maps) {
            Ok(chunks) => chunks,
            Err(error) => return refused(&error),
        };
        let place = daffine(lot);
        let size = [lot.mostly(90.0, ODD), lot.mostly(60.0, ODD)];
        let (at, way) = (dvec3(lot, 9.0), dvec3(lot, 1.0));
        let eye = if lot.one_in(2) {
            Eye::perspective(at, lot.mostly(3.0, ODD), size, lot.mostly(1.0, ODD))
        } else {
            Eye::orthographic(at, way, lot.mostly(9.0, ODD), size)
        };
        let shown = lot.pick(&[Shown::Front, Shown::Back, Shown::Both]);
        let view = View::new(&eye, &place, chunks.reach(), shown);
        let planes = lot.many(6, |lot| {
            half_space_in_local(dvec3(lot, 1.0).extend(lot.mostly(9.0, ODD)), &place)
        });
        let planes: &[DVec4] = if lot.one_in(4) { &[] } else { &planes };
        let mut ranges = Vec::new();
        let drawn = chunks.select(&view, planes, &mut ranges);
        let is_sound = |ranges: &[core::ops::Range<u32>]| {
            ranges.is_sorted_by(|a, b| a.end < b.start)
                && ranges
                    .iter()
                    .all(|range| range.start < range.end && range.end <= whole)
        };
        holds(drawn <= triangles.len() && is_sound(&ranges), || {
            format!("{ranges:?} of {whole}")
        })?;
        let corners = [(); 4].map(|()| dvec3(lot, 3.0));
        let frustum = if lot.one_in(2) {
            Frustum::perspective(at, corners)
        } else {
            Frustum::orthographic(corners, way)
        };
        let mut scratch = PaperScratch::default();
        maps.select_as_published(&positions, &triangles, &frustum, &mut scratch, &mut ranges);
        holds(is_sound(&ranges), || {
            format!("as published {ranges:?} of {whole}")
        })?;
        let hit = maps.first_hit(
            &positions,
            &triangles,
            &Ray {
                origin: at,
                direction: way,
            },
        );
        holds(hit.is_none_or(|(triangle, _)| triangle < whole), || {
            format!("{hit:?}")
        })?;
        Ok(true)
    });
    tally.expect_both(50);
}

#[test]
fn no_model_or_grid_makes_interior_culling_or_volumes_panic() {
    let tally = run("interior", 16 << 20, |lot| {
        let parts = lot.below(4);
        let parts = lot.many(parts, |lot| {
            let (positions, triangles) = mesh(lot);
            let place = if lot.one_in(4) {
                daffine(lot)
            } else {
                DAffine3::IDENTITY
            };
            Part {
                node: lot.u32(),
                surface: Arc::new(Surface {
                    positions,
                    triangles,
                }),
                model_from_local: place,
                is_transparent: lot.one_in(3),
                is_two_sided: lot.one_in(2),
            }
        });
        let model = Model { parts };
        // What stands for a mesh when it is tested encloses it or is not there.
        if let Some(part) = model.parts.first() {
            let positions: Vec<Vec3> = part
                .surface
                .positions
                .iter()
                .copied()
                .map(Vec3::from)
                .collect();
            let fitted = obb::fit(&positions);
            holds(
                fitted.is_none_or(|fitted| fitted.centre.is_finite()),
                || format!("{fitted:?}"),
            )?;
            let indices: Vec<u32> = part.surface.triangles.iter().flatten().copied().collect();
            let most = if lot.one_in(4) {
                lot.u32()
            } else {
                lot.below(9) as u32
            };
            let made = proxy::build(&positions, &indices, most);
            let is_sound = made.as_ref().is_none_or(|made| {
                made.triangles.len() as u64 <= u64::from(most)
                    && made
                        .triangles
                        .iter()
                        .all(|swept| swept.radius >= 0.0 && swept.radius.is_finite())
            });
            holds(is_sound, || format!("{made:?} of at most {most}"))?;
        }
        let settings = InteriorCulling {
            grid: match lot.below(9) {
                0 => InteriorGrid::Resolution(lot.u32()),
                1 => InteriorGrid::Gap(lot.f32()),
                _ => InteriorGrid::Resolution(1 + lot.below(12) as u32),
            },
            level: lot.pick(&[InteriorLevel::Node, InteriorLevel::Triangle]),
            mode: lot.pick(&[InteriorMode::Sampled, InteriorMode::Conservative]),
            transparent: lot.pick(&[InteriorTransparent::Open, InteriorTransparent::Closed]),
            faces: lot.pick(&[InteriorFaces::AsDrawn, InteriorFaces::TwoSided]),
            memory_mib: lot.below(3) as u32,
            ..Default::default()
        };
        match cull(
            &model,
            &settings,
            NonZero::<usize>::MIN,
            &Progress::default(),
        ) {
            Ok(outcome) => {
                holds(outcome.parts.len() == model.parts.len(), || {
                    "a part has no verdict".into()
                })?;
                let gap = outcome.lattice.gap();
                holds(gap.is_finite() && gap > 0.0, || format!("a gap of {gap}"))?;
                Ok(true)
            }
            Err(error) => refused(&error),
        }
    });
    tally.expect_both(50);
}
