//! The spherical index on the paper's model, the bunny: how much of it is drawn.

use std::time::Instant;

use bevy::math::{DAffine3, DVec3};
use bevy_skyline::spherical::{Bins, Eye, Layout, Shown, View};

use crate::{
    data::shared,
    spherical_check::{Mesh, Shot, maps_are_right, nothing_visible_goes},
};

pub fn bunny() -> Option<Mesh> {
    let text = std::fs::read_to_string(shared("mesh/stanford_bunny.obj")?).unwrap();
    let mut mesh = Mesh::default();
    for line in text.lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let mut next = || words.next().unwrap().parse().unwrap();
                mesh.positions.push([next(), next(), next()]);
            }
            Some("f") => {
                let mut next = || words.next().unwrap().parse::<u32>().unwrap() - 1;
                mesh.triangles.push([next(), next(), next()]);
            }
            _ => {}
        }
    }
    Some(mesh)
}

/// Evenly around, by the golden angle.
pub fn ways(count: u32) -> impl Iterator<Item = DVec3> {
    (0..count).map(move |number| {
        let y = 1.0 - (2.0 * f64::from(number) + 1.0) / f64::from(count);
        let (sin, cos) = (f64::from(number) * 2.399_963_229_728_653).sin_cos();
        let across = (1.0 - y * y).sqrt();
        DVec3::new(across * cos, y, across * sin)
    })
}

pub const EYES: u32 = 64;
const DISTANCES: [f64; 3] = [1.5, 3.0, 10.0];

/// Percent.
pub fn share(count: usize, mesh: &Mesh) -> f64 {
    100.0 * count as f64 / mesh.triangles.len() as f64
}

/// What is drawn on average of all eyes, by distance. Percent.
fn by_distance(
    mesh: &Mesh,
    centre: DVec3,
    radius: f64,
    mut drawn: impl FnMut(DVec3) -> usize,
) -> [f64; 3] {
    DISTANCES.map(|distance| {
        let count: usize = ways(EYES)
            .map(|way| drawn(centre + way * radius * distance))
            .sum();
        share(count, mesh) / f64::from(EYES)
    })
}

pub fn is_front([a, b, c]: [DVec3; 3], eye: DVec3) -> bool {
    (b - a).cross(c - a).dot(eye - a) > 0.0
}

/// By meshlets' cones, as meshoptimizer says that they are to be used.
fn by_cones(mesh: &Mesh, cone_weight: f32, centre: DVec3, radius: f64) -> (usize, [f64; 3]) {
    let bytes: &[u8] = bytemuck::cast_slice(&mesh.positions);
    let vertices = meshopt::VertexDataAdapter::new(bytes, 12, 0).unwrap();
    let indices = mesh.triangles.as_flattened();
    let meshlets = meshopt::build_meshlets(indices, &vertices, 64, 124, cone_weight);
    let bounds: Vec<_> = meshlets
        .iter()
        .map(|meshlet| {
            let bounds = meshopt::compute_meshlet_bounds(meshlet, &vertices);
            (bounds, meshlet.triangles.len() / 3)
        })
        .collect();
    let place = |place: [f32; 3]| DVec3::from_array(place.map(f64::from));
    let shares = by_distance(mesh, centre, radius, |eye| {
        bounds
            .iter()
            .filter(|(cone, _)| {
                let way = (place(cone.cone_apex) - eye).normalize();
                way.dot(place(cone.cone_axis)) < f64::from(cone.cone_cutoff)
            })
            .map(|(_, count)| count)
            .sum()
    });
    (bounds.len(), shares)
}

#[test]
fn of_the_whole_bunny_no_more_is_drawn_than_by_cones() {
    let Some(mesh) = bunny() else {
        return;
    };
    let started = Instant::now();
    let maps = mesh.maps(Bins::default(), Layout::Blocks, 128);
    let (mapped, bytes) = (started.elapsed(), maps.bytes());
    maps_are_right(&mesh, &maps, 4).unwrap();
    let started = Instant::now();
    let chunks = mesh.chunks(&maps);
    let count = chunks.chunks().len();
    println!(
        "{} triangles; maps {bytes} B in {mapped:.1?}, chunks {count}, {} B in {:.1?}",
        mesh.triangles.len(),
        chunks.bytes(),
        started.elapsed()
    );
    let (centre, radius) = (maps.centre, maps.radius);
    let ideal = by_distance(&mesh, centre, radius, |eye| {
        let all = 0..mesh.triangles.len() as u32;
        all.filter(|&triangle| is_front(mesh.corners(triangle), eye))
            .count()
    });
    let mut ranges = Vec::with_capacity(count);
    let room = ranges.capacity();
    let (mut most_ranges, mut took) = (0, Vec::new());
    let ours = by_distance(&mesh, centre, radius, |eye| {
        let camera = Eye::perspective(eye, 1.0, [1920.0, 1080.0], 0.01 * radius);
        let started = Instant::now();
        let view = View::new(&camera, &DAffine3::IDENTITY, chunks.reach(), Shown::Front);
        let count = chunks.select(&view, &[], &mut ranges);
        took.push(started.elapsed());
        most_ranges = most_ranges.max(ranges.len());
        count
    });
    assert_eq!(ranges.capacity(), room);
    took.sort_unstable();
    println!("at {DISTANCES:?} radii: front-facing {ideal:.2?} %");
    println!(
        "chunks {ours:.2?} %, at most {most_ranges} ranges, {:.1?} at the median, {:.1?} at most",
        took[took.len() / 2],
        took[took.len() - 1]
    );
    for weight in [0.0, 0.25, 0.5, 1.0] {
        let (meshlets, cones) = by_cones(&mesh, weight, centre, radius);
        println!("cones, weight {weight}: {cones:.2?} % of {meshlets} meshlets");
        for (ours, cones) in ours.iter().zip(cones) {
            assert!(*ours <= cones);
        }
    }
    for (ours, ideal) in ours.iter().zip(ideal) {
        assert!(*ours >= ideal);
    }
    for way in ways(6) {
        for shot in [
            Shot::at(centre + way * radius * 2.0, centre, 1e-3),
            Shot::at(centre + way * radius * 0.5, centre, 1e-4),
            Shot::parallel(centre + way * radius * 2.0, centre, radius),
        ] {
            let view = shot.view(chunks.reach());
            nothing_visible_goes(&mesh, &maps, &chunks, &shot, &view).unwrap();
        }
    }
}
