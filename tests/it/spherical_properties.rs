//! The spherical index: what holds for any triangles and any camera.

use bevy::math::{DAffine3, DMat3, DQuat, DVec3};
use bevy_skyline::{
    reference::spherical as twin,
    spherical::{Bins, Frustum, Layout, PaperScratch, Ray, Shown},
};
use proptest::prelude::*;

use crate::spherical_check::{BINS, Dice, Mesh, Shot, Tally, maps_are_right, nothing_visible_goes};

fn layout(is_rows: bool) -> Layout {
    if is_rows {
        Layout::Rows
    } else {
        Layout::Blocks
    }
}

/// Turned, moved, scaled, and if asked for stretched and mirrored.
fn transform(dice: &mut Dice, is_stretched: bool, is_mirrored: bool) -> DAffine3 {
    let turn =
        DQuat::from_rotation_y(dice.roll() * 6.0) * DQuat::from_rotation_x(dice.roll() * 6.0);
    let size = 10.0_f64.powf(dice.roll() * 4.0 - 2.0);
    let mut scale = DVec3::splat(size);
    if is_stretched {
        scale *= (dice.place() + 1.1) * DVec3::new(1.0, 3.0, 0.2);
    }
    if is_mirrored {
        scale.z = -scale.z;
    }
    let distance = 10.0_f64.powf(dice.roll() * 6.0 - 1.0);
    DAffine3::from_mat3_translation(
        DMat3::from_quat(turn) * DMat3::from_diagonal(scale),
        dice.place() * distance,
    )
}

fn shots_at(mesh: &Mesh, layout: Layout, size: u32, dice: &mut Dice) -> Result<Tally, String> {
    let maps = mesh.maps(BINS[1], layout, size);
    let chunks = mesh.chunks(&maps);
    let mut all = Tally::default();
    for number in 0..24 {
        let world_from_local = transform(dice, number % 3 == 0, number % 2 == 0);
        let centre = world_from_local.transform_point3(maps.centre);
        let radius = world_from_local.matrix3.determinant().abs().cbrt() * maps.radius;
        let eye = centre + dice.place() * radius * 10.0_f64.powf(dice.roll() * 4.0 - 1.0);
        let target = centre + dice.place() * radius;
        let shot = if number % 5 == 0 {
            Shot::parallel(eye, target, radius * (0.2 + 4.0 * dice.roll()))
        } else {
            Shot::at(eye, target, (radius * 1e-3) as f32)
        };
        let shown =
            [Shown::Front, Shown::Back, Shown::Both][usize::from(number % 7 == 0) * (number % 3)];
        let shot = shot.with(world_from_local, shown);
        let tally = nothing_visible_goes(mesh, &maps, &chunks, &shot, &shot.view(chunks.reach()))?;
        all.left_out += tally.left_out;
        all.must_stay += tally.must_stay;
    }
    Ok(all)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn maps_of_any_soup_are_right(seed: u64, count in 1usize..60, theta in 1u16..100, phi in 1u16..200, is_rows: bool) {
        let mesh = Dice(seed).soup(count);
        let maps = mesh.maps(Bins { theta, phi }, layout(is_rows), 9);
        prop_assert_eq!(maps_are_right(&mesh, &maps, 40), Ok(()));
    }

    #[test]
    fn nothing_visible_goes_from_any_soup(seed: u64, count in 1usize..200, size in 1u32..20, is_rows: bool) {
        let mut dice = Dice(seed);
        let mesh = dice.soup(count);
        let tally = shots_at(&mesh, layout(is_rows), size, &mut dice);
        prop_assert!(tally.is_ok(), "{:?}", tally);
    }

    #[test]
    fn nothing_visible_goes_from_any_stretched_ball(seed: u64, rings in 8u32..24, size in 1u32..12) {
        let mut dice = Dice(seed);
        let scale = (dice.place() + 1.05).as_vec3().to_array();
        let mesh = Mesh::ball(rings).placed(scale, (dice.place() * 100.0).as_vec3().to_array());
        let tally = shots_at(&mesh, Layout::Blocks, size, &mut dice).unwrap();
        prop_assert!(tally.left_out > 0 && tally.must_stay > 0, "{:?}", tally);
    }

    #[test]
    fn rays_find_what_the_twin_finds(seed: u64, count in 1usize..60) {
        let mut dice = Dice(seed);
        let mesh = dice.soup(count);
        let maps = mesh.maps(BINS[0], Layout::Rows, 9);
        let corners: Vec<_> = (0..count as u32).map(|triangle| mesh.corners(triangle)).collect();
        let mut missed = 0;
        for _ in 0..50 {
            let origin = dice.place() * 4.0;
            let target = corners[(dice.roll() * (count - 1) as f64) as usize][0].lerp(dice.place(), 0.02);
            let ray = Ray { origin, direction: target - origin };
            let ours = maps.first_hit(&mesh.positions, &mesh.triangles, &ray);
            let theirs = twin::first_hit(&corners, ray.origin, ray.direction);
            match (ours, theirs) {
                (Some((_, ours)), Some((_, theirs))) if (ours - theirs).abs() < 1e-6 => {}
                (None, None) => {}
                // By the corners of bins.
                _ => missed += 1,
            }
        }
        prop_assert!(missed <= 1, "{} of 50", missed);
    }

    #[test]
    fn as_published_ranges_are_in_order_and_of_the_mesh(seed: u64, count in 1usize..60, is_rows: bool, is_parallel: bool) {
        let mut dice = Dice(seed);
        let mesh = dice.soup(count);
        let maps = mesh.maps(BINS[1], layout(is_rows), 9);
        let (mut scratch, mut ranges) = (PaperScratch::default(), vec![]);
        for number in 0..40 {
            // From inside, from around, from far; wide, narrow, and of no width.
            let eye = dice.place() * 10.0_f64.powf(dice.roll() * 4.0 - 2.0);
            let forward = (dice.place() * 0.5 - eye) * f64::from(number % 7);
            let (right, up) = (dice.place() * dice.roll(), dice.place() * dice.roll());
            let corners = [-right - up, right - up, right + up, up - right];
            let frustum = if is_parallel {
                Frustum::orthographic(corners.map(|corner| eye + corner), forward)
            } else {
                Frustum::perspective(eye, corners.map(|corner| forward + corner))
            };
            let (positions, triangles) = (&mesh.positions, &mesh.triangles);
            maps.select_as_published(positions, triangles, &frustum, &mut scratch, &mut ranges);
            let mut end = 0;
            for range in &ranges {
                prop_assert!((end == 0 || range.start > end) && range.end > range.start, "{:?}", ranges);
                end = range.end;
            }
            prop_assert!(end as usize <= count);
        }
    }
}
