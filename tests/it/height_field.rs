//! `HeightField`: construction, edits, and the pyramid against brute force.

use bevy::math::{URect, UVec2};
use bevy_skyline::terrain::{
    HeightField, HeightFieldChanged, HeightFieldError, HeightSamples, PyramidNodes,
};
use proptest::prelude::*;

/// A small reproducible source of numbers.
pub fn hash(mut x: u32) -> u32 {
    x = x.wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b;
    x ^= x >> 16;
    x = x.wrapping_mul(0x21f0_aaad);
    x ^= x >> 15;
    x = x.wrapping_mul(0x735a_2d97);
    x ^ (x >> 15)
}

fn noise_u16(size: UVec2, seed: u32) -> HeightField {
    let samples = (0..size.x * size.y)
        .map(|i| hash(i ^ hash(seed)) as u16)
        .collect();
    HeightField::from_u16(size, 1.0, (0.0, 100.0), samples).unwrap()
}

fn noise_f32(size: UVec2, seed: u32) -> HeightField {
    let samples = (0..size.x * size.y)
        .map(|i| hash(i ^ hash(seed)) as i32 as f32 * 1e-5)
        .collect();
    HeightField::from_f32(size, 1.0, samples).unwrap()
}

/// Every node of every level from its definition: the samples it covers, shared ones included.
fn assert_pyramid(field: &HeightField) {
    let pyramid = field.pyramid();
    let (size, cells) = (field.size(), field.cells());
    let mut checked = 0;
    for level in 1..=pyramid.levels() {
        let span = 1u32 << level;
        let nodes = pyramid.level_size(level);
        assert_eq!(nodes.x, cells.x.div_ceil(span));
        assert_eq!(nodes.y, cells.y.div_ceil(span));
        assert_eq!(pyramid.level_offset(level), checked);
        for j in 0..nodes.y {
            for i in 0..nodes.x {
                let (mut max, mut min) = (f64::MIN, f64::MAX);
                for row in j * span..=((j + 1) * span).min(size.y - 1) {
                    for column in i * span..=((i + 1) * span).min(size.x - 1) {
                        max = max.max(field.grid_height(column, row));
                        min = min.min(field.grid_height(column, row));
                    }
                }
                assert_eq!(
                    pyramid.get(level, i, j),
                    (max, min),
                    "level {level}, node {i},{j} of {size}"
                );
                let index = pyramid.level_offset(level) + (j * nodes.x + i) as usize;
                match pyramid.nodes() {
                    PyramidNodes::U16(n) => {
                        assert_eq!(n[index], (max as u32) << 16 | min as u32);
                    }
                    PyramidNodes::F32(n) => assert_eq!(n[index], [max as f32, min as f32]),
                }
                checked += 1;
            }
        }
    }
    assert_eq!(pyramid.level_size(pyramid.levels()), UVec2::ONE);
    assert_eq!(pyramid.node_count(), checked);
}

const SIZES: [(u32, u32); 14] = [
    (2, 2),
    (2, 3),
    (3, 2),
    (3, 3),
    (2, 17),
    (17, 2),
    (4, 4),
    (5, 5),
    (3, 7),
    (33, 20),
    (64, 64),
    (65, 65),
    (66, 63),
    (2, 300),
];

#[test]
fn pyramid_matches_brute_force_at_every_size() {
    for (x, y) in SIZES {
        assert_pyramid(&noise_u16(UVec2::new(x, y), x * 1000 + y));
        assert_pyramid(&noise_f32(UVec2::new(x, y), x * 1000 + y));
    }
}

#[test]
fn pyramid_shares_samples_with_right_and_lower_neighbours() {
    // One spike on the line between two nodes of every level raises the nodes on both sides.
    let size = UVec2::splat(9);
    let mut samples = vec![0; 81];
    samples[4 * 9 + 4] = 1000;
    let field = HeightField::from_u16(size, 1.0, (0.0, 1.0), samples).unwrap();
    for (level, nodes) in [(1, [1, 2]), (2, [0, 1])] {
        for j in nodes {
            for i in nodes {
                assert_eq!(field.pyramid().get(level, i, j), (1000.0, 0.0));
            }
        }
    }
    assert_eq!(field.pyramid().get(1, 0, 0), (0.0, 0.0));
    assert_eq!(field.pyramid().get(1, 3, 3), (0.0, 0.0));
}

#[test]
fn two_by_two_has_one_level() {
    let field = HeightField::from_u16(UVec2::splat(2), 1.0, (0.0, 1.0), vec![1, 2, 3, 4]).unwrap();
    assert_eq!(field.pyramid().levels(), 1);
    assert_eq!(field.pyramid().node_count(), 1);
    assert_eq!(field.pyramid().top(), (4.0, 1.0));
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]
    #[test]
    fn pyramid_stays_exact_under_edits(
        width in 2u32..40,
        height in 2u32..40,
        seed: u32,
        float: bool,
        edits in prop::collection::vec((any::<[u32; 4]>(), -50.0f32..150.0), 1..6),
    ) {
        let size = UVec2::new(width, height);
        let mut field = if float { noise_f32(size, seed) } else { noise_u16(size, seed) };
        for (corners, value) in edits {
            let rect = URect::new(
                corners[0] % (width + 1), corners[1] % (height + 1),
                corners[2] % (width + 1), corners[3] % (height + 1),
            );
            let before = field.clone();
            field.edit(rect, |x, z, old| value + 0.25 * old + (x ^ z) as f32).unwrap();
            assert_pyramid(&field);
            for row in 0..height {
                for column in 0..width {
                    let p = UVec2::new(column, row);
                    let inside = p.cmpge(rect.min).all() && p.cmplt(rect.max).all();
                    if !inside {
                        prop_assert_eq!(
                            field.grid_height(column, row), before.grid_height(column, row));
                    }
                }
            }
            // What the field names as stale is all that differs.
            for level in 1..=field.pyramid().levels() {
                let affected = field.pyramid().affected_nodes(level, rect);
                let nodes = field.pyramid().level_size(level);
                for j in 0..nodes.y {
                    for i in 0..nodes.x {
                        let p = UVec2::new(i, j);
                        if !(p.cmpge(affected.min).all() && p.cmplt(affected.max).all()) {
                            prop_assert_eq!(
                                field.pyramid().get(level, i, j), before.pyramid().get(level, i, j));
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn codes_map_to_metres_exactly() {
    let field = HeightField::from_u16(
        UVec2::new(2, 2),
        30.0,
        (-32768.0, 32767.0),
        vec![0, 65535, 32768, 32769],
    )
    .unwrap();
    assert_eq!(field.sample_m(0, 0), -32768.0);
    assert_eq!(field.sample_m(1, 0), 32767.0);
    assert_eq!(field.sample_m(0, 1), 0.0);
    assert_eq!(field.sample_m(1, 1), 1.0);
    assert_eq!(field.height_range_m(), (-32768.0, 32767.0));
    assert_eq!(field.extent_m(), bevy::math::Vec2::splat(30.0));
}

#[test]
fn float_range_is_that_of_the_data() {
    let mut field =
        HeightField::from_f32(UVec2::new(3, 2), 1.0, vec![1.0, -2.0, 3.0, 0.0, 7.5, 2.0]).unwrap();
    assert_eq!(field.height_range_m(), (-2.0, 7.5));
    assert_eq!(field.data_range_m(), (-2.0, 7.5));
    field.edit(URect::new(1, 1, 2, 2), |_, _, _| 4.0).unwrap();
    assert_eq!(field.height_range_m(), (-2.0, 4.0));
}

#[test]
fn grid_and_local_space_are_inverse() {
    for field in [
        HeightField::from_u16(UVec2::splat(3), 0.001, (100.0, 104.0), vec![7; 9]).unwrap(),
        HeightField::from_u16(UVec2::splat(3), 1e4, (5.0, 5.0), vec![7; 9]).unwrap(),
        HeightField::from_f32(UVec2::splat(3), 30.0, vec![7.0; 9]).unwrap(),
    ] {
        let there_and_back = field.local_from_grid() * field.grid_from_local();
        let point = bevy::math::DVec3::new(1.5, 103.0, -2.5);
        assert!(
            there_and_back
                .transform_point3(point)
                .abs_diff_eq(point, 1e-9)
        );
        let grid = bevy::math::DVec3::new(1.0, field.grid_height(1, 2), 2.0);
        let local = field.local_from_grid().transform_point3(grid);
        assert_eq!(local.y, field.sample_m(1, 2));
    }
}

#[test]
fn flat_range_is_flat_and_stays_so() {
    let mut field =
        HeightField::from_u16(UVec2::splat(3), 1.0, (12.0, 12.0), vec![900; 9]).unwrap();
    assert_eq!(field.sample_m(1, 1), 12.0);
    assert!(field.grid_from_local().is_finite());
    field
        .edit(URect::new(0, 0, 3, 3), |_, _, old| old + 5.0)
        .unwrap();
    field.write_u16(URect::new(0, 0, 1, 1), &[4]).unwrap();
    assert_eq!(field.data_range_m(), (12.0, 12.0));
    assert_pyramid(&field);
}

#[test]
fn from_fn_rounds_to_the_nearest_code_and_clamps() {
    let range = (0.0, 655.35);
    let field = HeightField::from_fn(UVec2::new(3, 2), 1.0, range, |x, z| match (x, z) {
        (0, 0) => -5.0,
        (1, 0) => 1e9,
        (2, 0) => 1.234,
        _ => 100.004,
    })
    .unwrap();
    assert_eq!(field.grid_height(0, 0), 0.0);
    assert_eq!(field.grid_height(1, 0), 65535.0);
    assert_eq!(field.grid_height(2, 0), 123.0);
    assert_eq!(field.grid_height(2, 1), 10000.0);
}

#[test]
fn construction_errors_name_the_trouble() {
    let ok = (0.0, 1.0);
    for size in [(0, 0), (1, 1), (1, 9), (9, 1), (0, 5)] {
        let size = UVec2::from(size);
        let samples = vec![0; (size.x * size.y) as usize];
        let error = HeightField::from_u16(size, 1.0, ok, samples).unwrap_err();
        assert!(
            error.to_string().contains("at least 2×2 samples"),
            "{error}"
        );
    }
    let error = HeightField::from_u16(UVec2::new(3, 4), 1.0, ok, vec![0; 11]).unwrap_err();
    assert!(error.to_string().contains("12") && error.to_string().contains("11"));

    for bad in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e-44, f32::MAX] {
        let error = HeightField::from_u16(UVec2::splat(3), bad, ok, vec![0; 9]).unwrap_err();
        assert!(
            matches!(error, HeightFieldError::Spacing { .. }),
            "{bad}: {error}"
        );
    }
    for bad in [(1.0, 0.0), (f32::NAN, 1.0), (0.0, f32::INFINITY)] {
        let error = HeightField::from_u16(UVec2::splat(3), 1.0, bad, vec![0; 9]).unwrap_err();
        assert!(
            matches!(error, HeightFieldError::HeightRange { .. }),
            "{error}"
        );
    }
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut samples = vec![0.0; 12];
        samples[7] = bad;
        let error = HeightField::from_f32(UVec2::new(3, 4), 1.0, samples).unwrap_err();
        assert!(error.to_string().contains("column 1, row 2"), "{error}");
        let error = HeightField::from_fn(UVec2::new(3, 4), 1.0, ok, |x, z| {
            if (x, z) == (1, 2) { bad } else { 0.0 }
        })
        .unwrap_err();
        assert!(error.to_string().contains("column 1, row 2"), "{error}");
    }
}

#[test]
fn failed_edits_leave_everything_as_it_was() {
    for mut field in [noise_u16(UVec2::splat(9), 1), noise_f32(UVec2::splat(9), 1)] {
        let before = field.clone();
        let float = matches!(field.samples(), HeightSamples::F32(_));

        for rect in [
            URect::new(0, 0, 10, 1),
            URect::new(8, 8, 9, 10),
            URect {
                min: UVec2::splat(5),
                max: UVec2::splat(4),
            },
        ] {
            let error = field.edit(rect, |_, _, _| 1.0).unwrap_err();
            assert!(
                matches!(error, HeightFieldError::RectOutOfBounds { .. }),
                "{error}"
            );
        }
        let error = field
            .edit(URect::new(2, 3, 6, 6), |x, z, _| {
                if (x, z) == (5, 4) { f32::NAN } else { 1.0 }
            })
            .unwrap_err();
        assert!(error.to_string().contains("column 5, row 4"), "{error}");

        let rect = URect::new(2, 3, 4, 5);
        if float {
            assert!(matches!(
                field.write_u16(rect, &[0; 4]),
                Err(HeightFieldError::SampleKind { stored: "f32" })
            ));
            assert!(
                field
                    .write_f32(rect, &[0.0, 0.0, f32::INFINITY, 0.0])
                    .is_err()
            );
            assert!(field.write_f32(rect, &[0.0; 5]).is_err());
        } else {
            assert!(matches!(
                field.write_f32(rect, &[0.0; 4]),
                Err(HeightFieldError::SampleKind { stored: "u16" })
            ));
            assert!(field.write_u16(rect, &[0; 3]).is_err());
        }

        assert_eq!(field.samples(), before.samples());
        assert_eq!(field.pyramid(), before.pyramid());
        assert_eq!(field.revision(), before.revision());
        assert_eq!(
            field.changed_since(before.revision()),
            HeightFieldChanged::Nothing
        );
    }
}

#[test]
fn revisions_tell_what_changed() {
    let mut field = noise_u16(UVec2::splat(64), 5);
    let other = noise_u16(UVec2::splat(64), 5);
    assert_ne!(field.revision(), other.revision());

    let start = field.revision();
    field.edit(URect::new(1, 2, 3, 4), |_, _, _| 1.0).unwrap();
    let middle = field.revision();
    field.edit(URect::new(10, 1, 12, 2), |_, _, _| 1.0).unwrap();
    assert!(start < middle && middle < field.revision());

    assert_eq!(
        field.changed_since(field.revision()),
        HeightFieldChanged::Nothing
    );
    assert_eq!(
        field.changed_since(middle),
        HeightFieldChanged::Rect(URect::new(10, 1, 12, 2))
    );
    assert_eq!(
        field.changed_since(start),
        HeightFieldChanged::Rect(URect::new(1, 1, 12, 4))
    );
    // Another field's revision, though it lies between two of ours, tells nothing.
    assert_eq!(
        field.changed_since(other.revision()),
        HeightFieldChanged::Everything
    );
    assert_eq!(field.changed_since(0), HeightFieldChanged::Everything);

    // An empty rectangle is no edit.
    let before = field.revision();
    field.edit(URect::new(4, 4, 4, 9), |_, _, _| 1.0).unwrap();
    assert_eq!(field.revision(), before);

    // A clone shares the past, not the future.
    let mut clone = field.clone();
    field.edit(URect::new(5, 5, 6, 6), |_, _, _| 2.0).unwrap();
    clone.edit(URect::new(7, 7, 8, 8), |_, _, _| 2.0).unwrap();
    assert_ne!(field.revision(), clone.revision());
    assert_eq!(
        field.changed_since(before),
        HeightFieldChanged::Rect(URect::new(5, 5, 6, 6))
    );
    assert_eq!(
        clone.changed_since(before),
        HeightFieldChanged::Rect(URect::new(7, 7, 8, 8))
    );
    assert_eq!(
        clone.changed_since(field.revision()),
        HeightFieldChanged::Everything
    );
}

#[test]
fn old_edits_are_forgotten_safely() {
    let mut field = noise_u16(UVec2::splat(64), 5);
    let start = field.revision();
    let mut revisions = vec![start];
    for i in 0..40 {
        field
            .edit(URect::new(i, i, i + 1, i + 1), |_, _, _| 3.0)
            .unwrap();
        revisions.push(field.revision());
    }
    assert_eq!(field.changed_since(start), HeightFieldChanged::Everything);
    assert_eq!(
        field.changed_since(revisions[7]),
        HeightFieldChanged::Everything
    );
    // 32 edits back is the limit.
    assert_eq!(
        field.changed_since(revisions[8]),
        HeightFieldChanged::Rect(URect::new(8, 8, 40, 40))
    );
    assert_eq!(
        field.changed_since(revisions[39]),
        HeightFieldChanged::Rect(URect::new(39, 39, 40, 40))
    );
}

#[test]
fn reflection_sees_a_whole_and_cannot_break_it() {
    use bevy::reflect::{PartialReflect, ReflectRef};
    let field = noise_u16(UVec2::splat(4), 5);
    assert!(matches!(field.reflect_ref(), ReflectRef::Opaque(_)));
    let clone = field
        .reflect_clone()
        .unwrap()
        .take::<HeightField>()
        .unwrap();
    assert_eq!(clone.revision(), field.revision());
}
