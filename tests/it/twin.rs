//! `reference::ray_cast` against analytic cases and brute force, and the rays of a view in `f64`.

use bevy::math::{DMat4, DVec2, DVec3, UVec2, Vec2, Vec3Swizzles};
use bevy_skyline::{
    precision::UNIT_ROUNDOFF,
    reference::{
        guard::{RayMagnitude, depth_error},
        ray_cast::{Part, Tally, Twin, Verdict},
    },
    terrain::{HeightField, view_rays::ViewRays},
};
use proptest::prelude::*;

use crate::terrain_scenes::{Scene, hills, scenes};

fn floats(width: u32, height: u32, h: impl Fn(u32, u32) -> f32) -> HeightField {
    let samples = (0..width * height)
        .map(|k| h(k % width, k / width))
        .collect();
    HeightField::from_f32(UVec2::new(width, height), 1.0, samples).unwrap()
}

fn cast(field: &HeightField, o: [f64; 3], d: [f64; 3]) -> Option<(f64, Part)> {
    let hit = Twin::new(field).cast(o.into(), d.into(), DVec3::ZERO, 1e9);
    hit.map(|hit| (hit.t, hit.part))
}

fn anchor(rays: &ViewRays) -> DVec3 {
    DVec3::new(
        f64::from(rays.anchor.x),
        f64::from(rays.anchor_y),
        f64::from(rays.anchor.y),
    )
}

/// NDC depth of t as a perfect GPU would write it.
fn ndc_depth(rays: &ViewRays, t: f64) -> f32 {
    let [x, y, z, w] = rays.depth.as_dvec4().to_array();
    ((x + y * t) / (z + w * t)) as f32
}

// Analytic cases.

#[test]
fn a_plane_is_met_where_algebra_says() {
    // y = 2 + x / 2 + z / 4
    let field = floats(17, 9, |i, j| 2.0 + 0.5 * i as f32 + 0.25 * j as f32);
    for (o, d) in [
        ([1.0, 20.0, 1.0], [0.3, -1.0, 0.2]),
        ([15.5, 30.0, 7.5], [-1.0, -2.0, -0.01]),
        ([4.0, 11.0, 4.0], [0.0, -1.0, 0.0]),
        ([0.0, 3.0, 0.0], [1.0, 0.0, 0.0]),
        ([-3.0, 12.0, 2.25], [1.0, -0.4, 0.0]),
    ] {
        let above = o[1] - 2.0 - 0.5 * o[0] - 0.25 * o[2];
        let rate = d[1] - 0.5 * d[0] - 0.25 * d[2];
        let (t, part) = cast(&field, o, d).unwrap();
        assert!((t - above / -rate).abs() < 1e-12, "{o:?} {d:?}: {t}");
        assert_eq!(part, Part::Surface);
    }
}

#[test]
fn a_saddle_is_met_where_algebra_says() {
    // y = 3 x z over one cell; along the diagonal that is 3 s².
    let field = floats(2, 2, |i, j| 3.0 * (i * j) as f32);
    let (t, _) = cast(&field, [0.0, 0.75, 0.0], [1.0, 0.0, 1.0]).unwrap();
    assert!((t - 0.5).abs() < 1e-15);
    // Across the saddle: 1 - t = 3 (1 - t/2) (t/2).
    let (t, _) = cast(&field, [1.0, 1.0, 0.0], [-0.5, -1.0, 0.5]).unwrap();
    assert!((t - (2.5 - 3.25f64.sqrt()) / 1.5).abs() < 1e-12);
    // Above it throughout: it is no higher than 3/4 there.
    assert_eq!(cast(&field, [1.0, 3.5, 0.0], [-0.5, -1.0, 0.5]), None);
}

#[test]
fn only_one_side_of_the_ground_is_seen() {
    let flat = floats(5, 5, |_, _| 1.0);
    assert_eq!(
        cast(&flat, [2.0, 0.5, 2.0], [0.0, -1.0, 0.0]),
        None,
        "down, from inside"
    );
    assert_eq!(
        cast(&flat, [2.0, 0.5, 2.0], [0.1, 1.0, 0.0]),
        None,
        "out into the sky"
    );
    assert_eq!(
        cast(&flat, [2.0, 1.0, 2.0], [0.0, -1.0, 0.0]),
        None,
        "on it is inside"
    );
    assert_eq!(
        cast(&flat, [2.0, 0.5, 2.0], [1.0, 0.0, 0.0]),
        None,
        "out through a wall"
    );
    // Out of one hill, into the next.
    let hills = floats(7, 2, |i, _| [5.0, 5.0, 0.0, 0.0, 5.0, 5.0, 5.0][i as usize]);
    let (t, part) = cast(&hills, [0.5, 2.5, 0.5], [1.0, 0.0, 0.0]).unwrap();
    assert!((t - 3.0).abs() < 1e-15 && part == Part::Surface);
}

#[test]
fn a_ray_may_leave_and_return_within_one_cell() {
    // Along the diagonal the height is 4 (u - u²): a bump of one, to look through from inside.
    let field = floats(2, 2, |i, j| if i == j { 0.0 } else { 2.0 });
    // 0.5 is reached at u = 0.1464..., then left again behind the bump: a start inside comes out there.
    let out = 0.5 + 0.125f64.sqrt();
    assert_eq!(cast(&field, [0.5, 0.5, 0.5], [1.0, 0.0, 1.0]), None);
    let (t, _) = cast(&field, [0.0, 0.5, 0.0], [1.0, 0.0, 1.0]).unwrap();
    assert!((t - (1.0 - out)).abs() < 1e-12);
    // A hollow: from inside its rim through the air to the other side.
    let hollow = floats(2, 2, |i, j| if i == j { 2.0 } else { 0.0 });
    let (t, _) = cast(&hollow, [0.01, 1.5, 0.01], [1.0, 0.0, 1.0]).unwrap();
    assert!((0.01 + t - out).abs() < 1e-12, "{t}");
}

#[test]
fn walls_are_endless_and_exact() {
    let field = floats(5, 5, |_, _| 1.0);
    for depth in [1.0, 0.0, -1e6] {
        assert_eq!(
            cast(&field, [-2.0, depth, 2.5], [0.5, 0.0, 0.0]),
            Some((4.0, Part::Wall))
        );
        assert_eq!(
            cast(&field, [2.0, depth, 9.0], [0.0, 0.0, -1.0]),
            Some((5.0, Part::Wall))
        );
    }
    assert_eq!(
        cast(&field, [-2.0, 1.5, 2.5], [0.5, 0.0, 0.0]),
        None,
        "over it"
    );
    assert_eq!(
        cast(&field, [-2.0, 0.5, 4.5], [0.5, 0.0, 0.0]),
        None,
        "beside it"
    );
    assert_eq!(
        cast(&field, [2.0, -9.0, 5.0], [0.0, 1.0, 0.0]),
        None,
        "up, before a wall"
    );
}

#[test]
fn a_spike_is_met_from_all_sides() {
    let field = floats(9, 9, |i, j| if (i, j) == (4, 4) { 8.0 } else { 0.0 });
    for (dx, dz) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
        // Along a cell border the spike is two straight lines.
        let (t, _) = cast(&field, [4.0 - 8.0 * dx, 2.0, 4.0 - 8.0 * dz], [dx, 0.0, dz]).unwrap();
        assert!((t - 7.25).abs() < 1e-12, "{t}");
    }
    // Along a diagonal it is 8 (1 - r)².
    let (t, _) = cast(&field, [0.0, 2.0, 0.0], [1.0, 0.0, 1.0]).unwrap();
    assert!((t - 3.5).abs() < 1e-12, "{t}");
    assert_eq!(cast(&field, [0.0, 8.1, 4.0], [1.0, 0.0, 0.0]), None);
}

// Brute force.

/// Height of the ray above the surface at t; `None` beside the footprint.
fn above(field: &HeightField, o: DVec3, d: DVec3, t: f64) -> Option<f64> {
    let at = o + t * d;
    let cells = field.cells().as_dvec2();
    if at.xz().cmplt(DVec2::ZERO).any() || at.xz().cmpgt(cells).any() {
        return None;
    }
    let cell = at.xz().floor().min(cells - 1.0);
    let (u, v) = (at.x - cell.x, at.z - cell.y);
    let h = |i: u32, j: u32| field.grid_height(cell.x as u32 + i, cell.y as u32 + j);
    let near = h(0, 0) * (1.0 - u) + h(1, 0) * u;
    let far = h(0, 1) * (1.0 - u) + h(1, 1) * u;
    Some(at.y - (near * (1.0 - v) + far * v))
}

/// Steps through the whole field and holds each step against the hit.
fn agrees_with_steps(field: &HeightField, o: DVec3, d: DVec3, t_max: f64) -> Result<(), String> {
    let hit = Twin::new(field).cast(o, d, DVec3::ZERO, t_max);
    let t_hit = hit.map_or(f64::INFINITY, |hit| hit.t);
    let slack = 1e-9 * (1.0 + o.length() + d.length() * t_max);
    if let Some(hit) = hit {
        let here = above(field, o, d, hit.t - 1e-12)
            .or(above(field, o, d, hit.t + 1e-12))
            .or(above(field, o, d, hit.t));
        match (hit.part, here) {
            (Part::Surface, Some(height)) if height.abs() < slack => {}
            (Part::Wall, Some(height)) if height < slack => {}
            _ => return Err(format!("{hit:?} is no hit: {here:?}")),
        }
    }
    let mut air = above(field, o, d, 0.0).is_none_or(|height| height > slack);
    let steps = 4000;
    for step in 1..=steps {
        let t = t_max * f64::from(step) / f64::from(steps);
        let height = above(field, o, d, t);
        if t >= t_hit - 1e-9 {
            break;
        }
        if air && height.is_some_and(|height| height < -slack) {
            return Err(format!("in the ground at {t}, hit at {t_hit}"));
        }
        // Beside the footprint counts as air only before the ray comes in.
        air |= height.is_some_and(|height| height > slack);
    }
    if hit.is_some_and(|hit| hit.part == Part::Surface) && !air {
        // The air may have been shorter than a step, or a touch within rounding; but not a way out of the ground.
        let found = (0..20_000).any(|k| {
            let t = t_hit * f64::from(k) / 20_000.0;
            above(field, o, d, t).is_none_or(|height| height > 0.0)
        });
        let touch = above(field, o, d, t_hit + 1e-7).is_some_and(|height| height < slack);
        if !found && !touch {
            return Err(format!("hit at {t_hit} without having been in the air"));
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, rng_seed: prop::test_runner::RngSeed::Fixed(7), failure_persistence: None, ..Default::default() })]

    #[test]
    fn agrees_with_brute_force(
        width in 2u32..9, height in 2u32..9, seed in 0u32..1000,
        o in prop::array::uniform3(-4.0..12.0f64), target in prop::array::uniform3(-1.0..9.0f64),
    ) {
        let field = floats(width, height, |i, j| {
            let k = seed.wrapping_mul(77).wrapping_add(i * 31 + j * 17).wrapping_mul(0x9e37_79b9);
            (k >> 16) as f32 / 8192.0
        });
        let (o, target) = (DVec3::from(o), DVec3::from(target));
        let result = agrees_with_steps(&field, o, target - o, 3.0);
        prop_assert!(result.is_ok(), "{}", result.unwrap_err());
    }

    #[test]
    fn agrees_with_brute_force_on_the_grid(
        seed in 0u32..1000, from in prop::array::uniform3(-2i32..10), to in prop::array::uniform3(-2i32..10),
    ) {
        // Whole numbers only: borders, samples, ties everywhere.
        let field = floats(6, 8, |i, j| {
            let k = seed.wrapping_mul(77).wrapping_add(i * 31 + j * 17).wrapping_mul(0x9e37_79b9);
            (k >> 29) as f32
        });
        let (o, to) = (DVec3::from(from.map(f64::from)), DVec3::from(to.map(f64::from)));
        prop_assume!(o != to);
        let result = agrees_with_steps(&field, o, to - o, 3.0);
        prop_assert!(result.is_ok(), "{}", result.unwrap_err());
    }
}

// The guard band.

/// A middle of a pixel that is hit in the open, and its verdict.
fn sure_hit(scene: &Scene) -> (ViewRays, Vec2, Verdict) {
    let (twin, rays) = (Twin::new(&scene.field), scene.rays());
    let sure = scene.pixels().find_map(|pixel| {
        let verdict = twin.judge(&rays, pixel, f64::from(rays.t_far));
        verdict.latest.map(|_| (pixel, verdict))
    });
    let (pixel, verdict) = sure.expect("a hit");
    (rays, pixel, verdict)
}

#[test]
fn the_exact_hit_lies_in_every_guard_band() {
    let (mut rays_in_all, mut undecided) = (0, Vec::new());
    for scene in scenes() {
        let (twin, rays) = (Twin::new(&scene.field), scene.rays());
        let (mut tally, mut widest_px) = (Tally::default(), 0.0f64);
        for pixel in scene.pixels() {
            let verdict = twin.judge(&rays, pixel, f64::from(rays.t_far));
            let order = match (verdict.earliest, verdict.exact, verdict.latest) {
                (None, None, None) => true,
                (Some(earliest), None, None) => earliest >= 0.0,
                (Some(earliest), Some(exact), None) => earliest <= exact,
                (Some(earliest), Some(exact), Some(latest)) => earliest <= exact && exact <= latest,
                _ => false,
            };
            assert!(order, "{} {pixel}: {verdict:?}", scene.name);
            let depth = verdict.exact.map_or(0.0, |t| ndc_depth(&rays, t));
            tally.check(&rays, pixel, verdict, depth);
            if let (Some(earliest), Some(_)) = (verdict.earliest, verdict.latest) {
                widest_px = widest_px.max(twin.displacement_px(&rays, pixel, earliest));
            }
            // The exact cast is the same walk, without a guard.
            let (o, d) = rays.ray(pixel);
            let hit = twin.cast(o, d, anchor(&rays), f64::from(rays.t_far));
            let same = match (hit, verdict.exact) {
                (Some(hit), Some(t)) => (hit.t - t).abs() <= 1e-9 * (1.0 + t),
                (hit, t) => hit.is_none() && t.is_none(),
            };
            assert!(same, "{} {pixel}: {hit:?}, {verdict:?}", scene.name);
            if let Some(hit) = hit {
                let px = twin.displacement_px(&rays, pixel, hit.t);
                assert!(
                    px < 1e-3 * (1.0 + f64::from(rays.size_px.x)),
                    "{} {pixel}: {px} px",
                    scene.name
                );
            }
        }
        println!(
            "{:45} {:5} hits {:5} misses {:5} in band, up to {widest_px:.1e} px wide",
            scene.name, tally.hits, tally.misses, tally.in_band
        );
        assert!(
            tally.wrong.is_empty(),
            "{}: {:?}",
            scene.name,
            tally.wrong[0]
        );
        rays_in_all += tally.rays();
        if let Err(why) = tally.verdict(0.05) {
            undecided.push(format!("{}: {why}", scene.name));
        }
    }
    assert!(undecided.is_empty(), "{undecided:#?}");
    assert!(rays_in_all > 100_000);
}

#[test]
fn rays_moved_by_less_than_the_guard_get_legal_answers() {
    let mut random = 1u64;
    let mut next = || {
        random = random
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (random >> 33) as f64 / f64::from(1u32 << 30) - 1.0
    };
    let mut moved = 0;
    for scene in scenes() {
        let (twin, rays) = (Twin::new(&scene.field), scene.rays());
        let anchor = anchor(&rays);
        for pixel in scene.pixels().step_by(3) {
            let verdict = twin.judge(&rays, pixel, f64::from(rays.t_far));
            let (o, d) = rays.ray(pixel);
            // What the count of roundings allows the origin and the direction by themselves: 6u each.
            let by = DVec3::new(next(), next(), next());
            let q = (pixel - 0.5 * rays.size_px.as_vec2()).as_dvec2().abs();
            let size = |v: bevy::math::Vec3, dx: bevy::math::Vec3, dy: bevy::math::Vec3| {
                v.as_dvec3().abs() + q.x * dx.as_dvec3().abs() + q.y * dy.as_dvec3().abs()
            };
            let o =
                o + 6.0 * UNIT_ROUNDOFF * by * size(rays.origin, rays.origin_dx, rays.origin_dy);
            let d = d + 6.0
                * UNIT_ROUNDOFF
                * by.yzx()
                * size(rays.direction, rays.direction_dx, rays.direction_dy);
            let t = twin
                .cast(o, d, anchor, f64::from(rays.t_far))
                .map(|hit| hit.t);
            let legal = match t {
                None => verdict.latest.is_none(),
                Some(t) => {
                    verdict.earliest.is_some_and(|earliest| earliest <= t)
                        && verdict.latest.is_none_or(|latest| t <= latest)
                }
            };
            assert!(legal, "{} {pixel}: {t:?}, {verdict:?}", scene.name);
            moved += usize::from(t != verdict.exact);
        }
    }
    assert!(moved > 10_000, "{moved} hits moved");
}

#[test]
fn the_guard_grows_with_distance_and_size() {
    // The same picture of the same hills, the second as a corner of a much larger field.
    let camera = scenes().remove(0);
    let width = |scene: &Scene| {
        let (_, _, verdict) = sure_hit(scene);
        let (earliest, latest) = (verdict.earliest.unwrap(), verdict.latest.unwrap());
        latest - earliest
    };
    let near = width(&camera);
    assert!(near > 0.0 && near < 0.1, "{near}");
    let scale = |by: f32| {
        let mut scene = scenes().remove(0);
        scene.field = hills(129, 97, 10.0 * by, 400.0 * by);
        scene.camera.translation *= by;
        scene
    };
    let thousandfold = width(&scale(1000.0));
    assert!(
        (thousandfold / near / 1000.0 - 1.0).abs() < 0.1,
        "the band is in proportion: {thousandfold}"
    );
}

#[test]
fn a_tally_catches_what_is_wrong() {
    let scene = scenes().remove(0);
    let (twin, rays) = (Twin::new(&scene.field), scene.rays());
    let answers: Vec<_> = scene
        .pixels()
        .map(|pixel| {
            let verdict = twin.judge(&rays, pixel, f64::from(rays.t_far));
            (
                pixel,
                verdict,
                verdict.exact.map_or(0.0, |t| ndc_depth(&rays, t)),
            )
        })
        .collect();
    let tally = |spoil: &dyn Fn(usize, f32) -> f32| {
        let mut tally = Tally::default();
        for (k, &(pixel, verdict, depth)) in answers.iter().enumerate() {
            tally.check(&rays, pixel, verdict, spoil(k, depth));
        }
        tally
    };
    tally(&|_, depth| depth).assert_ok(0.01);
    let hit = answers
        .iter()
        .position(|(_, verdict, _)| verdict.latest.is_some())
        .unwrap();
    let miss = answers
        .iter()
        .position(|(_, verdict, _)| verdict.earliest.is_none())
        .unwrap();
    let one = |at: usize, to: &dyn Fn(f32) -> f32| {
        tally(&|k, depth| if k == at { to(depth) } else { depth })
    };
    for spoiled in [
        one(hit, &|depth| depth * 1.01),
        one(hit, &|depth| depth * 0.99),
        one(hit, &|_| 0.0),
        one(hit, &|_| f32::NAN),
        one(miss, &|_| 1e-4),
        one(miss, &|_| -1.0),
    ] {
        assert_eq!(spoiled.wrong.len(), 1);
        assert!(spoiled.verdict(1.0).is_err());
    }
    assert!(Tally::default().verdict(1.0).is_err(), "nothing compared");
    let undecided = Verdict {
        exact: None,
        earliest: Some(0.0),
        latest: None,
    };
    let mut tally = Tally::default();
    tally.check(&rays, Vec2::ONE, undecided, 0.5);
    assert!(tally.verdict(1.0).is_err(), "only undecided rays");
}

#[test]
fn displacement_is_measured_in_pixels() {
    let scene = scenes().remove(0);
    let twin = Twin::new(&scene.field);
    let (rays, pixel, verdict) = sure_hit(&scene);
    let t = verdict.exact.unwrap();
    assert!(twin.displacement_px(&rays, pixel, t) < 1e-3);
    // The farther from the surface the more, but no more than along the ray's own way.
    let (near, far) = (
        twin.displacement_px(&rays, pixel, 0.99 * t),
        twin.displacement_px(&rays, pixel, 0.9 * t),
    );
    assert!(0.05 < near && near < far, "{near} {far}");
    // Before a wall the way to it is what counts, not the height above.
    let scene = scenes()
        .into_iter()
        .find(|scene| scene.name == "walls_from_below_the_lowest")
        .unwrap();
    let (twin, rays) = (Twin::new(&scene.field), scene.rays());
    let middle = 0.5 * scene.size_px.as_vec2() + Vec2::new(0.0, 10.0);
    let t = twin.judge(&rays, middle, 1e9).exact.expect("a wall");
    assert!(twin.displacement_px(&rays, middle, t) < 1e-3);
    assert!(twin.displacement_px(&rays, middle, t * 0.999) < 1.0);
}

/// The scenes that catch starts in the ground do start where they say.
#[test]
fn scenes_inside_the_ground_come_out_where_they_should() {
    for (name, last_cell) in [
        ("inside_the_last_cell_looking_out", true),
        ("inside_near_a_corner_looking_out", true),
        ("inside_the_ground", false),
    ] {
        let scene = scenes()
            .into_iter()
            .find(|scene| scene.name == name)
            .unwrap();
        let rays = scene.rays();
        let middle = 0.5 * scene.size_px.as_vec2() + 0.5;
        let (o, d) = rays.ray(middle);
        let o = o + anchor(&rays);
        assert!(above(&scene.field, o, d, 0.0).unwrap() < 0.0, "{name}");
        let mut t = 0.0;
        while above(&scene.field, o, d, t).is_some_and(|height| height <= 0.0) {
            t += 1e-3;
        }
        let out = o + t * d;
        assert!(
            above(&scene.field, o, d, t).is_some(),
            "{name}: out by a wall"
        );
        let last = scene.field.cells().as_dvec2() - 1.0;
        let at_border = out.xz().cmpgt(last).any() || out.xz().cmplt(DVec2::ONE).any();
        assert_eq!(at_border, last_cell, "{name}: out at {out}");
    }
    // Exactly on a sample, a hit within its own cell.
    let scene = scenes()
        .into_iter()
        .find(|scene| scene.name == "orthographic_from_a_sample_over_a_saddle")
        .unwrap();
    let (twin, rays) = (Twin::new(&scene.field), scene.rays());
    let middle = 0.5 * scene.size_px.as_vec2();
    let (o, d) = rays.ray(middle);
    let start = above(&scene.field, o + anchor(&rays), d, 0.0).unwrap();
    let verdict = twin.judge(&rays, middle, 1e9);
    assert!(
        start == 0.0 && verdict.latest.is_some(),
        "{start} {verdict:?}"
    );
}

// The rays themselves.

#[test]
fn rays_pass_through_what_the_projection_shows() {
    for scene in scenes() {
        let rays = scene.rays();
        let view_from_clip = scene.clip_from_view.as_dmat4().inverse();
        let grid_from_view = scene.grid_from_view();
        for pixel in scene.pixels().step_by(101) {
            let ndc =
                (pixel / scene.size_px.as_vec2() * 2.0 - 1.0).as_dvec2() * DVec2::new(1.0, -1.0);
            // Two points of that pixel by the inverse of the projection, and the one at any other depth.
            let a = view_from_clip.project_point3(ndc.extend(0.9));
            let b = view_from_clip.project_point3(ndc.extend(0.3));
            let at_depth = |depth: f64| a + (b - a) * ((depth + a.z) / (a.z - b.z));
            let (o, d) = rays.ray(pixel);
            let (fixed, growing) = RayMagnitude::new(&rays, pixel).position_error();
            for t in [0.0, 1.0, 1000.0] {
                let point = at_depth(f64::from(rays.t_base) + t);
                let expected = grid_from_view.transform_point3(point) - anchor(&rays);
                let f64_error = 1e-12
                    * (grid_from_view.matrix3.abs() * point.abs()
                        + grid_from_view.translation.abs());
                let error = (o + t * d - expected).abs();
                let allowed = fixed + t * growing + f64_error;
                assert!(
                    error.cmple(allowed).all(),
                    "{} {pixel} t {t}: {error} > {allowed}",
                    scene.name
                );
            }
        }
    }
}

#[test]
fn depth_goes_there_and_back() {
    for scene in scenes() {
        let rays = scene.rays();
        let clip_from_view: DMat4 = scene.clip_from_view.as_dmat4();
        for k in 0..40 {
            let t = f64::from(rays.t_far.min(1e6)) * (f64::from(k) + 0.5) / 40.0;
            let view = f64::from(rays.t_base) + t;
            let clip = clip_from_view * DVec3::new(0.0, 0.0, -view).extend(1.0);
            let (expected, ndc) = (clip.z / clip.w, ndc_depth(&rays, t));
            assert!(
                (f64::from(ndc) - expected).abs()
                    <= 8.0 * UNIT_ROUNDOFF * (expected.abs() + f64::from(rays.depth.y != 0.0)),
                "{} t {t}: {ndc}, {expected}",
                scene.name
            );
            let back = rays.view_depth(ndc);
            let (tolerance, told) = depth_error(&rays, t);
            assert!(
                (back - view).abs() <= tolerance,
                "{} t {t}: {back}, {view}, {tolerance}",
                scene.name
            );
            assert!(
                told || t > 0.99 * f64::from(rays.t_far),
                "{} t {t}",
                scene.name
            );
        }
        assert_eq!(rays.view_depth(0.0), f64::INFINITY);
    }
}
