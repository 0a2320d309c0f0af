//! Extraction: which triangles are seen from outside.

use core::ops::ControlFlow;

use bevy::platform::collections::HashMap;

use super::{
    field::for_steps,
    front::Outside,
    lattice::{Lattice, REACH_UNITS, UNITS},
    overlap::{Boxes, Snapped},
};

/// Whether a triangle comes within [`REACH_UNITS`] of an outside point, in every axis.
pub(super) fn is_near(lattice: &Lattice, outside: &Outside, triangle: &Snapped) -> bool {
    let boxes = Boxes {
        axis: 0,
        shift: 0,
        half_along: REACH_UNITS,
        half_across: REACH_UNITS,
    };
    let found = boxes.overlapping(triangle, |run| {
        let [_, y, z] = run.point(0);
        let row = lattice.row(y, z);
        let (first, last) = (*run.along.start() as u32, *run.along.end() as u32);
        for word in first / 64..=last / 64 {
            let start = word * 64;
            let mut points = outside.words[row + word as usize];
            points &= u64::MAX << first.saturating_sub(start);
            points &= u64::MAX >> 63u32.saturating_sub(last - start);
            while points != 0 {
                if run.overlaps((start + points.trailing_zeros()) as i32) {
                    return ControlFlow::Break(());
                }
                points &= points - 1;
            }
        }
        ControlFlow::Continue(())
    });
    found.is_break()
}

/// What is met first on each step from an outside point to one that is not: for each such step, up or down, the least
/// distance and the triangle's number, which decides between triangles that meet a step at the same place.
pub(super) type Met = HashMap<Step, (i64, u64)>;

/// A step: its point, its axis, whether it leads up.
pub(super) type Step = ([u32; 3], u8, bool);

/// Adds a triangle to what is met.
pub(super) fn meet(
    lattice: &Lattice,
    outside: &Outside,
    triangle: &Snapped,
    number: u64,
    met: &mut Met,
) {
    for axis in 0..3 {
        for_steps(triangle, axis, |point| {
            let mut next = point;
            next[axis] += 1;
            let is_up = outside.contains(lattice, point);
            if is_up == outside.contains(lattice, next) {
                return;
            }
            let from = if is_up { point } else { next };
            let distance = distance(triangle, from, axis, is_up);
            let first = met
                .entry((point, axis as u8, is_up))
                .or_insert((distance, number));
            *first = (*first).min((distance, number));
        });
    }
}

/// From a point along an axis to a triangle's plane, or to where the triangle ends before it. units: 1/256 of a unit
fn distance(triangle: &Snapped, from: [u32; 3], axis: usize, is_up: bool) -> i64 {
    let (normal, on) = (triangle.normal, triangle.corners[0]);
    let from = from.map(|at| at as i32 * UNITS);
    let across: i64 = (0..3)
        .filter(|i| *i != axis)
        .map(|i| normal[i] * i64::from(on[i] - from[i]))
        .sum();
    let (least, greatest) = (
        f64::from(triangle.least[axis]),
        f64::from(triangle.greatest[axis]),
    );
    let meets = if normal[axis] == 0 {
        if is_up { least } else { greatest }
    } else {
        (f64::from(on[axis]) + across as f64 / normal[axis] as f64).clamp(least, greatest)
    };
    let distance = (meets - f64::from(from[axis])) * if is_up { 1.0 } else { -1.0 };
    (distance * 256.0).round() as i64
}
