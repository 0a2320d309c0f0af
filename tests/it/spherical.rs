//! The spherical index: hard cases by name.

use bevy::math::{DAffine3, DVec3};
use bevy_skyline::spherical::{
    Bins, Case, Eye, Frustum, Layout, MapSettings, PaperScratch, Shown, SphericalChunks,
    SphericalError, SphericalMaps, View,
};

use crate::spherical_check::{
    BINS, Dice, Mesh, Shot, everything_is_right, maps_are_right, nothing_visible_goes,
};

/// Compares everything, and says if there was nothing to compare.
fn check(mesh: &Mesh) {
    let tally = everything_is_right(mesh, 60);
    assert!(tally.must_stay > 0 && tally.left_out > 0, "{tally:?}");
}

/// A mesh so big that its middle stays at the origin, with these triangles.
fn around_origin(triangles: &[[[f32; 3]; 3]]) -> Mesh {
    let mut all = triangles.to_vec();
    all.push([[9.0, 9.0, 9.0], [9.0, 8.9, 9.0], [8.9, 9.0, 9.0]]);
    all.push([[-9.0, -9.0, -9.0], [-9.0, -8.9, -9.0], [-8.9, -9.0, -9.0]]);
    Mesh::of(&all)
}

fn build(mesh: &Mesh) -> Result<SphericalMaps, SphericalError> {
    SphericalMaps::build(&mesh.positions, &mesh.triangles, Bins::default())
}

#[test]
fn triangles_over_a_pole_cover_the_bins_around_it() {
    let over = |y: f32| [[1.0, y, 0.5], [-0.7, y, 0.9], [-0.2, y, -1.1]];
    let mesh = around_origin(&[over(3.0), over(-3.0), over(0.01), over(-0.01)]);
    check(&mesh);
    let maps = build(&mesh).unwrap();
    let first_row = 0..360;
    for bin in first_row {
        assert!(maps.index.triangles(bin).contains(&0));
        assert!(maps.index.triangles(179 * 360 + bin).contains(&1));
        assert!(!maps.index.triangles(bin).contains(&1));
    }
}

#[test]
fn a_corner_or_an_edge_at_a_pole_is_covered() {
    check(&around_origin(&[
        [[0.0, 2.0, 0.0], [0.3, 2.0, 0.0], [0.0, 2.0, 0.3]],
        [[-1.0, -2.0, 0.0], [1.0, -2.0, 0.0], [0.0, -2.0, 1.0]],
        [[0.0, 3.0, 0.0], [0.0, -3.0, 0.1], [0.1, 2.0, 0.1]],
    ]));
}

#[test]
fn triangles_across_azimuth_zero_cover_both_sides_of_it() {
    let mesh = around_origin(&[[[3.0, 0.1, -0.4], [3.0, 0.5, 0.4], [3.0, -0.5, 0.4]]]);
    check(&mesh);
    let maps = build(&mesh).unwrap();
    let row = 90 * 360;
    assert!(maps.index.triangles(row).contains(&0));
    assert!(maps.index.triangles(row + 359).contains(&0));
    assert!(!maps.index.triangles(row + 180).contains(&0));
}

#[test]
fn a_centroid_at_the_centre_is_indexed() {
    check(&around_origin(&[
        [[1.0, 0.0, 0.0], [-0.5, 0.5, 0.0], [-0.5, -0.5, 0.0]],
        [[4.0, 1.0, 1.0], [-2.0, 0.0, 1.0], [-2.0, -1.0, -2.0]],
    ]));
}

#[test]
fn the_centre_may_be_on_the_surface_on_an_edge_or_at_a_corner() {
    check(&around_origin(&[
        [[2.0, 0.0, 1.0], [-2.0, 0.3, -1.0], [-2.0, -0.3, -1.0]],
        [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 1.0]],
        [[0.0, 0.0, 0.0], [1.0, 0.0, 2.0], [0.0, 1.0, 0.0]],
    ]));
}

#[test]
fn huge_triangles_around_the_centre_cover_up_to_half_of_all() {
    let far = 1000.0;
    check(&Mesh::of(&[
        [[far, 0.1, far], [-far, 0.1, far], [0.0, 0.1, -far]],
        [[far, -0.1, far], [0.0, -0.1, -far], [-far, -0.1, far]],
        [[0.1, far, -far], [0.1, -far, -far], [0.1, 0.0, far]],
    ]));
}

#[test]
fn a_flat_disc_is_indexed_and_seen_from_one_side() {
    let rim = |at: u32| {
        let angle = at as f32 * std::f32::consts::TAU / 16.0;
        [angle.cos(), 0.0, -angle.sin()]
    };
    let fan: Vec<_> = (0..16).map(|at| [[0.0; 3], rim(at), rim(at + 1)]).collect();
    let mesh = Mesh::of(&fan);
    check(&mesh);
    let maps = mesh.maps(BINS[1], Layout::Blocks, 4);
    let chunks = mesh.chunks(&maps);
    let mut ranges = Vec::new();
    for (height, count) in [(1.0, 16), (-1.0, 0), (0.0, 16)] {
        let shot = Shot::at(DVec3::new(0.3, height, 3.0), DVec3::ZERO, 0.1);
        let view = shot.view(chunks.reach());
        assert_eq!(
            chunks.select(&view, &[], &mut ranges),
            count,
            "from {height}"
        );
    }
}

#[test]
fn a_single_triangle_is_one_chunk() {
    let mesh = Mesh::of(&[[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]);
    check(&mesh);
    let maps = build(&mesh).unwrap();
    assert_eq!(
        (maps.order.as_slice(), maps.cuts.as_slice()),
        (&[0][..], &[0, 1][..])
    );
}

#[test]
fn an_empty_mesh_makes_empty_maps() {
    let mesh = Mesh::default();
    for layout in [Layout::Rows, Layout::Blocks] {
        let maps = mesh.maps(BINS[1], layout, 128);
        maps_are_right(&mesh, &maps, 1).unwrap();
        let chunks = mesh.chunks(&maps);
        assert!(chunks.chunks().is_empty());
        let mut ranges = Vec::new();
        let shot = Shot::at(DVec3::Z, DVec3::ZERO, 0.1);
        assert_eq!(
            chunks.select(&shot.view(chunks.reach()), &[], &mut ranges),
            0
        );
        let frustum = Frustum::perspective(DVec3::Z, [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y]);
        let case = maps.select_as_published(
            &[],
            &[],
            &frustum,
            &mut PaperScratch::default(),
            &mut ranges,
        );
        assert_eq!(case, Case::Outside);
    }
}

#[test]
fn ten_thousand_kilometres_from_the_origin_nothing_visible_goes() {
    let away = [1.0e7, -1.0e7, 1.0e7];
    let mesh = Mesh::ball(12).placed([400.0; 3], away);
    check(&mesh);
    // The same, but put back by its transform, so that large numbers cancel.
    let maps = mesh.maps(BINS[1], Layout::Blocks, 16);
    let chunks = mesh.chunks(&maps);
    let back = DAffine3::from_translation(-maps.centre);
    for way in [DVec3::X, DVec3::Y, DVec3::new(1.0, -2.0, 0.5)] {
        let shot = Shot::at(way * 900.0, DVec3::ZERO, 0.1).with(back, Shown::Front);
        let view = shot.view(chunks.reach());
        nothing_visible_goes(&mesh, &maps, &chunks, &shot, &view).unwrap();
    }
}

#[test]
fn slivers_are_kept_with_their_chunk() {
    let mesh = around_origin(&[
        [[0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [0.5, 1e-7, 5.0]],
        [[0.0, 1.0, 5.0], [1.0, 1.0, 5.0], [2.0, 1.0, 5.0]],
    ]);
    check(&mesh);
    let maps = mesh.maps(BINS[1], Layout::Blocks, 1);
    let chunks = mesh.chunks(&maps);
    for side in [-1.0, 1.0] {
        let shot = Shot::at(DVec3::new(0.0, 0.0, side * 100.0), DVec3::ZERO, 0.1);
        let view = shot.view(chunks.reach());
        for chunk in chunks.chunks() {
            let is_sliver = maps.order[chunk.triangles.start as usize] < 2;
            assert!(!is_sliver || chunks.faces_eye(chunk, &view));
        }
    }
}

#[test]
fn triangles_with_two_corners_at_one_place_are_never_drawn() {
    let mesh = Mesh::of(&[[[1.0; 3], [1.0; 3], [2.0; 3]], [[3.0; 3]; 3]]);
    let maps = build(&mesh).unwrap();
    maps_are_right(&mesh, &maps, 10).unwrap();
    let chunks = mesh.chunks(&maps);
    let view = Shot::at(DVec3::Z, DVec3::ZERO, 0.1).view(chunks.reach());
    assert_eq!(chunks.select(&view, &[], &mut Vec::new()), 0);
}

#[test]
fn what_is_not_a_mesh_is_refused_by_name() {
    let not_finite = |bad: f32| {
        let mut mesh = Mesh::ball(4);
        mesh.positions[17][1] = bad;
        build(&mesh).unwrap_err()
    };
    for bad in [f32::NAN, f32::INFINITY] {
        let error = not_finite(bad);
        assert!(
            matches!(error, SphericalError::NotFinite { vertex: 17, .. }),
            "{error}"
        );
    }
    let mut mesh = Mesh::ball(4);
    mesh.triangles[5][2] = 4000;
    let error = build(&mesh).unwrap_err();
    assert_eq!(
        error.to_string(),
        "triangle 5 has vertex 4000 for a corner, but there are 40 vertices: check the mesh's indices"
    );
    let mesh = Mesh::ball(4);
    let with =
        |settings: MapSettings| SphericalMaps::build(&mesh.positions, &mesh.triangles, settings);
    for (theta, phi) in [(0, 5), (5, 0), (u16::MAX, u16::MAX)] {
        let error = with(Bins { theta, phi }.into()).unwrap_err();
        assert_eq!(error, SphericalError::Bins { theta, phi });
    }
    let none = MapSettings {
        chunk_triangles: 0,
        ..Default::default()
    };
    assert_eq!(with(none).unwrap_err(), SphericalError::NoChunk);
    // A vertex that no triangle has doesn't matter.
    let mut mesh = Mesh::ball(4);
    mesh.positions.push([f32::NAN; 3]);
    assert!(build(&mesh).is_ok());
}

#[test]
fn an_index_map_over_its_budget_gets_coarser_down_to_one_bin() {
    let mesh = Dice(1).soup(300);
    let mut last = usize::MAX;
    for index_bytes in [1 << 30, 1 << 18, 1 << 14, 4000, 0] {
        let settings = MapSettings {
            index_bytes,
            ..Default::default()
        };
        let maps = SphericalMaps::build(&mesh.positions, &mesh.triangles, settings).unwrap();
        maps_are_right(&mesh, &maps, 20).unwrap();
        assert!(maps.index.bytes() <= index_bytes.max(4 * 300 + 8));
        assert!(maps.index.bins.count() < last);
        last = maps.index.bins.count();
    }
    assert_eq!(last, 1);
}

#[test]
fn a_camera_at_the_centre_sees_the_inside_only() {
    let mesh = Mesh::ball(12);
    let maps = mesh.maps(BINS[0], Layout::Blocks, 32);
    let chunks = mesh.chunks(&maps);
    let shot = Shot::at(DVec3::ZERO, DVec3::X, 0.1);
    let selected = |shown| {
        let shot = shot.with(DAffine3::IDENTITY, shown);
        let view = shot.view(chunks.reach());
        nothing_visible_goes(&mesh, &maps, &chunks, &shot, &view).unwrap();
        chunks.select(&view, &[], &mut Vec::new())
    };
    assert_eq!(selected(Shown::Front), 0);
    assert!(selected(Shown::Back) > 500);
    assert_eq!(selected(Shown::Both), mesh.triangles.len());
}

#[test]
fn a_camera_on_a_vertex_and_in_a_plane_loses_nothing() {
    let mesh = Mesh::ball(8);
    let maps = mesh.maps(BINS[1], Layout::Blocks, 8);
    let chunks = mesh.chunks(&maps);
    for triangle in (0..mesh.triangles.len() as u32).step_by(7) {
        let [a, b, c] = mesh.corners(triangle);
        let far = (b - a) * 300.0 + (c - a) * 100.0;
        for eye in [a, (a + b) / 2.0, (a + b + c) / 3.0, a + far, a - far] {
            let shot = Shot::at(eye, DVec3::new(0.1, 0.2, 0.3), 1e-4);
            let view = shot.view(chunks.reach());
            nothing_visible_goes(&mesh, &maps, &chunks, &shot, &view).unwrap();
            // In its plane, not behind it: its chunk stays.
            let chunk = chunks.chunks().iter().find(|chunk| {
                let order =
                    &maps.order[chunk.triangles.start as usize..chunk.triangles.end as usize];
                order.contains(&triangle)
            });
            let is_degenerate = a == b || b == c || c == a;
            assert!(is_degenerate || chunks.faces_eye(chunk.unwrap(), &view));
        }
    }
}

#[test]
fn what_the_near_plane_may_cut_is_kept_though_seen_from_behind() {
    let mesh = Mesh::of(&[[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]);
    let chunks = mesh.chunks(&mesh.maps(BINS[1], Layout::Blocks, 1));
    for (behind, is_kept) in [(0.05, true), (0.5, false)] {
        let eye = DVec3::new(0.3, 0.3, -behind);
        let view = Shot::at(eye, eye - DVec3::X, 0.1).view(chunks.reach());
        assert_eq!(chunks.faces_eye(&chunks.chunks()[0], &view), is_kept);
    }
}

#[test]
fn a_mirrored_mesh_shows_its_backs() {
    let mesh = Mesh::ball(10);
    let maps = mesh.maps(BINS[1], Layout::Blocks, 16);
    let chunks = mesh.chunks(&maps);
    let shot = Shot::at(DVec3::new(3.0, 2.0, 1.0), DVec3::ZERO, 0.1);
    let selected = |scale, shown| {
        let shot = shot.with(DAffine3::from_scale(scale), shown);
        let view = shot.view(chunks.reach());
        nothing_visible_goes(&mesh, &maps, &chunks, &shot, &view).unwrap();
        let mut ranges = Vec::new();
        chunks.select(&view, &[], &mut ranges);
        ranges
    };
    let mirrored = DVec3::new(1.0, 1.0, -1.0);
    let fronts = selected(DVec3::ONE, Shown::Front);
    assert_ne!(fronts, selected(mirrored, Shown::Front));
    assert_ne!(fronts, selected(DVec3::ONE, Shown::Back));
    assert!(fronts.iter().map(|range| range.len()).sum::<usize>() < 300);
}

#[test]
fn a_transform_without_an_inverse_shows_everything() {
    let mesh = Mesh::ball(6);
    let chunks = mesh.chunks(&mesh.maps(BINS[1], Layout::Blocks, 8));
    for scale in [
        DVec3::ZERO,
        DVec3::new(1.0, 0.0, 1.0),
        DVec3::NAN,
        DVec3::splat(1e-200),
    ] {
        let shot = Shot::at(DVec3::Z * 5.0, DVec3::ZERO, 0.1)
            .with(DAffine3::from_scale(scale), Shown::Front);
        let view = shot.view(chunks.reach());
        assert_eq!(
            chunks.select(&view, &[], &mut Vec::new()),
            mesh.triangles.len()
        );
    }
}

#[test]
fn an_orthographic_camera_sees_half_a_ball() {
    let mesh = Mesh::ball(24);
    check(&mesh);
    let maps = mesh.maps(BINS[0], Layout::Blocks, 8);
    let chunks = mesh.chunks(&maps);
    let shot = Shot::parallel(DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO, 3.0);
    let count = chunks.select(&shot.view(chunks.reach()), &[], &mut Vec::new());
    let share = count as f64 / mesh.triangles.len() as f64;
    assert!((0.5..0.65).contains(&share), "{share}");
}

#[test]
fn what_is_not_star_shaped_or_not_closed_is_right() {
    // A ball in a ball with its inside out, a part of a third, and a sheet.
    let mut mesh = Mesh::ball(10);
    let mut add = |other: Mesh, is_turned: bool, count: usize| {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(other.positions);
        for [a, b, c] in other.triangles.into_iter().take(count) {
            let triangle = if is_turned { [a, c, b] } else { [a, b, c] };
            mesh.triangles.push(triangle.map(|vertex| vertex + first));
        }
    };
    add(Mesh::ball(10).placed([0.9; 3], [0.0; 3]), true, usize::MAX);
    add(Mesh::ball(10).placed([0.4; 3], [0.3, 0.1, 0.0]), false, 130);
    add(
        Mesh::of(&[[[0.0, -1.0, 0.0], [0.9, 0.9, 0.0], [0.0, 1.0, 0.1]]]),
        false,
        1,
    );
    check(&mesh);
}

#[test]
fn a_comparator_finds_what_is_wrong() {
    let (ball, other) = (Mesh::ball(10), Dice(3).soup(400));
    let maps = ball.maps(BINS[1], Layout::Blocks, 16);
    // The maps of one mesh are not those of another.
    assert!(maps_are_right(&other, &maps, 20).is_err());
    let mut swapped = maps.clone();
    swapped.order.swap(0, 200);
    assert!(maps_are_right(&ball, &swapped, 20).is_err());
    // The other side, and another eye.
    let chunks: SphericalChunks = ball.chunks(&maps);
    let shot = Shot::at(DVec3::new(3.0, 2.0, 1.0), DVec3::ZERO, 0.1);
    let compare = |view: &View| nothing_visible_goes(&ball, &maps, &chunks, &shot, view);
    assert!(compare(&shot.view(chunks.reach())).is_ok());
    let back = shot.with(DAffine3::IDENTITY, Shown::Back);
    assert!(compare(&back.view(chunks.reach())).is_err());
    let elsewhere = Eye {
        position: DVec3::new(-3.0, 2.0, 1.0),
        ..shot.camera
    };
    let view = View::new(
        &elsewhere,
        &DAffine3::IDENTITY,
        chunks.reach(),
        Shown::Front,
    );
    assert!(compare(&view).is_err());
}
