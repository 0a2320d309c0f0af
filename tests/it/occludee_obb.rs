//! The box that stands for a mesh: hard clouds by name, and any cloud.

use bevy::{camera::primitives::Aabb, prelude::*};
use bevy_skyline::{
    culling::volume::LocalBox,
    occlusion::obb::{aligned, fit},
};
use proptest::prelude::*;

/// Solves for the coordinates of `point` in the box by Gauss elimination with full pivoting. A zero axis stands
/// for a direction in which the point must not stray.
fn coordinates(of: &LocalBox, point: Vec3) -> Option<[f64; 3]> {
    let axes = of.axes.map(|axis| axis.as_dvec3());
    let mut rows = [0, 1, 2].map(|row| {
        let right = point.as_dvec3()[row] - of.centre.as_dvec3()[row];
        [axes[0][row], axes[1][row], axes[2][row], right]
    });
    let mut used = [false; 3];
    let mut pivots = [None; 3];
    for _ in 0..3 {
        let free = (0..3)
            .filter(|&row| !used[row])
            .flat_map(|row| (0..3).map(move |column| (row, column)))
            .filter(|&(_, column)| pivots[column].is_none());
        let Some((row, column)) =
            free.max_by(|a, b| rows[a.0][a.1].abs().total_cmp(&rows[b.0][b.1].abs()))
        else {
            break;
        };
        if rows[row][column] == 0.0 {
            break;
        }
        used[row] = true;
        pivots[column] = Some(row);
        for other in 0..3 {
            if other != row {
                let factor = rows[other][column] / rows[row][column];
                let pivot = rows[row];
                for (cell, pivot) in rows[other].iter_mut().zip(pivot) {
                    *cell -= factor * pivot;
                }
                rows[other][column] = 0.0;
            }
        }
    }
    // What no axis can account for.
    if (0..3).any(|row| !used[row] && rows[row][3] != 0.0) {
        return None;
    }
    Some([0, 1, 2].map(|column| pivots[column].map_or(0.0, |row| rows[row][3] / rows[row][column])))
}

fn encloses(of: &LocalBox, points: &[Vec3]) -> bool {
    points
        .iter()
        .all(|&point| coordinates(of, point).is_some_and(|uvw| uvw.iter().all(|u| u.abs() <= 1.0)))
}

fn volume(of: &LocalBox) -> f64 {
    of.axes
        .map(|axis| axis.as_dvec3().length())
        .into_iter()
        .product()
}

fn surface(of: &LocalBox) -> f64 {
    let [a, b, c] = of.axes.map(|axis| axis.as_dvec3().length());
    a * b + b * c + c * a
}

fn around(points: &[Vec3]) -> LocalBox {
    let (mut min, mut max) = (points[0], points[0]);
    for &point in points {
        (min, max) = (min.min(point), max.max(point));
    }
    aligned(min, max)
}

fn check(points: &[Vec3]) -> Result<LocalBox, String> {
    let found = fit(points).ok_or("no box")?;
    let plain = around(points);
    let mut faults = Vec::new();
    if !found.centre.is_finite() || found.axes.iter().any(|axis| !axis.is_finite()) {
        faults.push("not finite");
    }
    if !encloses(&found, points) {
        faults.push("a point is outside");
    }
    if !encloses(&plain, points) {
        faults.push("a point is outside the aligned box");
    }
    if volume(&found) > volume(&plain)
        || (volume(&found) == volume(&plain) && surface(&found) > surface(&plain))
    {
        faults.push("larger than the aligned box");
    }
    let axes = found.axes.map(|axis| axis.as_dvec3().normalize_or_zero());
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        // Axes of some 1e-40 have few bits left.
        let bits = if found.axes[a].min_element().abs() < 1e-30 {
            1e-4
        } else {
            4e-7
        };
        if axes[a].dot(axes[b]).abs() > bits {
            faults.push("axes not at right angles");
        }
    }
    if faults.is_empty() {
        Ok(found)
    } else {
        Err(format!("{}: {found:?}", faults.join(", ")))
    }
}

/// Points of a grid of `n`³, in the box of these half axes, turned.
fn turned(half: Vec3, n: u32, rotation: Quat, centre: Vec3) -> Vec<Vec3> {
    let step = |i: u32| 2.0 * i as f32 / (n - 1) as f32 - 1.0;
    (0..n * n * n)
        .map(|i| {
            let unit = Vec3::new(step(i % n), step(i / n % n), step(i / n / n));
            centre + rotation * (unit * half)
        })
        .collect()
}

const ASKEW: Quat = Quat::from_xyzw(0.182_574_2, 0.365_148_4, 0.547_722_6, 0.730_296_7);

#[test]
fn hard_clouds_have_valid_boxes() {
    let line = |direction: Vec3| -> Vec<Vec3> {
        (0..50)
            .map(|i| direction * (i as f32 * 0.37 - 3.0))
            .collect()
    };
    let scaled = |factor: f32| -> Vec<Vec3> {
        turned(Vec3::new(3.0, 1.0, 0.2), 4, ASKEW, Vec3::ONE)
            .into_iter()
            .map(|point| point * factor)
            .collect()
    };
    let cases: Vec<(&str, Vec<Vec3>)> = vec![
        ("one point", vec![Vec3::new(1.1, -2.3, 1e6)]),
        ("one point, repeated", vec![Vec3::splat(0.1); 9]),
        ("the origin", vec![Vec3::ZERO; 3]),
        ("two points", vec![Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0)]),
        ("line along an axis", line(Vec3::Y)),
        ("line in a coordinate plane", line(Vec3::new(1.0, 1.0, 0.0))),
        ("line askew", line(Vec3::new(1.0, -0.3, 0.77))),
        (
            "coordinate plane",
            turned(Vec3::new(2.0, 1.0, 0.0), 5, Quat::IDENTITY, Vec3::ONE),
        ),
        (
            "rectangle turned in a coordinate plane",
            turned(
                Vec3::new(2.0, 1.0, 0.0),
                5,
                Quat::from_rotation_z(0.6),
                Vec3::Z,
            ),
        ),
        (
            "plane askew",
            turned(Vec3::new(2.0, 1.0, 0.0), 5, ASKEW, Vec3::ZERO),
        ),
        (
            "a thousand times as wide as thick",
            turned(Vec3::new(1e3, 1e3, 1e-3), 4, ASKEW, Vec3::ZERO),
        ),
        ("cube", turned(Vec3::ONE, 3, Quat::IDENTITY, Vec3::ZERO)),
        (
            "cube askew: equal eigenvalues",
            turned(Vec3::ONE, 3, ASKEW, Vec3::ZERO),
        ),
        (
            "far from the origin",
            turned(Vec3::new(3.0, 1.0, 0.2), 4, ASKEW, Vec3::splat(1e6)),
        ),
        (
            "as far as f32 can tell points apart",
            turned(Vec3::new(3.0, 1.0, 0.2), 4, ASKEW, Vec3::splat(1e7)),
        ),
        ("huge", scaled(1e18)),
        ("as huge as can be", scaled(5e37)),
        (
            "the ends of f32",
            vec![Vec3::splat(f32::MAX), Vec3::splat(f32::MIN)],
        ),
        ("tiny", scaled(1e-18)),
        ("subnormal", scaled(1e-40)),
        (
            "subnormal and huge",
            vec![Vec3::splat(1e-42), Vec3::new(1e30, 0.0, 1e-30), Vec3::ZERO],
        ),
        (
            "repeated points weigh more",
            [
                vec![Vec3::ZERO; 100],
                turned(Vec3::new(3.0, 1.0, 0.2), 4, ASKEW, Vec3::ONE),
            ]
            .concat(),
        ),
    ];
    for (name, points) in cases {
        if let Err(fault) = check(&points) {
            panic!("{name}: {fault}");
        }
    }
}

#[test]
fn no_positions_or_one_that_is_not_finite_have_no_box() {
    assert_eq!(fit(&[]), None);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert_eq!(
            fit(&[Vec3::ONE, Vec3::new(0.0, bad, 0.0), Vec3::ZERO]),
            None
        );
    }
}

#[test]
fn a_turned_box_is_found_again() {
    let half = Vec3::new(5.0, 1.0, 0.25);
    let points = turned(half, 4, ASKEW, Vec3::new(3.0, -2.0, 8.0));
    let found = check(&points).unwrap();
    let exact = f64::from(half.x * half.y * half.z);
    assert!((volume(&found) / exact - 1.0).abs() < 1e-5, "{found:?}");
    assert!(volume(&around(&points)) > 10.0 * exact);
}

#[test]
fn where_the_aligned_box_is_smaller_it_is_taken() {
    // Many points along a diagonal turn the covariance's axes away from the sides of the cube.
    let diagonal = (0..100).map(|i| Vec3::splat(i as f32 / 50.0 - 1.0));
    let points: Vec<Vec3> = turned(Vec3::ONE, 2, Quat::IDENTITY, Vec3::ZERO)
        .into_iter()
        .chain(diagonal)
        .collect();
    assert_eq!(check(&points).unwrap(), aligned(Vec3::NEG_ONE, Vec3::ONE));
}

#[test]
fn an_aabb_is_a_box() {
    let aabb = Aabb::from_min_max(Vec3::new(-1.0, 0.0, 2.0), Vec3::new(1.0, 4.0, 2.0));
    let of = LocalBox::from(aabb);
    assert_eq!(of, aligned(aabb.min().into(), aabb.max().into()));
    assert_eq!(of.axes, [Vec3::X, Vec3::Y * 2.0, Vec3::ZERO]);
}

#[test]
fn a_box_that_is_too_small_is_noticed() {
    let points = turned(Vec3::new(5.0, 1.0, 0.25), 4, ASKEW, Vec3::ONE);
    let good = fit(&points).unwrap();
    assert!(encloses(&good, &points));
    for axis in 0..3 {
        let mut small = good;
        small.axes[axis] *= 0.99999;
        assert!(!encloses(&small, &points), "axis {axis}");
        small.axes[axis] = Vec3::ZERO;
        assert!(!encloses(&small, &points), "axis {axis}");
    }
    let moved = LocalBox {
        centre: good.centre + Vec3::X * 1e-4,
        ..good
    };
    assert!(!encloses(&moved, &points));
}

fn cloud() -> impl Strategy<Value = Vec<Vec3>> {
    let point = prop::array::uniform3(-1.0_f32..1.0);
    let frame = (
        prop::array::uniform3(-6.0_f32..6.0),
        prop::array::uniform4(-1.0_f32..1.0),
        prop::array::uniform3(-1.0_f32..1.0),
        -18.0_f32..18.0,
        -3.0_f32..6.0,
    );
    (prop::collection::vec(point, 1..60), frame).prop_map(
        |(points, (stretch, turn, centre, scale, away))| {
            let rotation = Quat::from_array(turn.map(|x| x + 1.5)).normalize();
            let stretch = Vec3::from(stretch.map(|exponent| 10_f32.powf(exponent * 0.5)));
            let centre = Vec3::from(centre) * 10_f32.powf(away);
            points
                .into_iter()
                .map(|point| {
                    (centre + rotation * (Vec3::from(point) * stretch)) * 10_f32.powf(scale)
                })
                .collect()
        },
    )
}

proptest! {
    #[test]
    fn every_cloud_is_inside_a_box_no_larger_than_the_aligned_one(points in cloud()) {
        if let Err(fault) = check(&points) {
            return Err(TestCaseError::fail(fault));
        }
    }
}
