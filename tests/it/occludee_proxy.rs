//! The simplified mesh that stands for a mesh: that it encloses it, rigorously, and how closely.

use std::fs;

use bevy::{math::DVec3, prelude::*};
use bevy_skyline::{
    culling::volume::{Proxy, SweptTriangle},
    occlusion::proxy::{MOST_TRIANGLES, build},
};
use proptest::prelude::*;

use crate::{data::shared, height_field::hash};

struct Soup {
    positions: Vec<Vec3>,
    indices: Vec<u32>,
}

impl Soup {
    fn new(positions: Vec<Vec3>, indices: Vec<u32>) -> Self {
        Self { positions, indices }
    }

    /// One of the real models, or `None` with the reason printed.
    fn model(name: &str) -> Option<Self> {
        let text = fs::read_to_string(shared(&format!("mesh/{name}.obj"))?).unwrap();
        let mut soup = Self::new(Vec::new(), Vec::new());
        for line in text.lines() {
            let mut words = line.split_whitespace();
            match words.next() {
                Some("v") => {
                    let position: Vec<f32> = words.map(|word| word.parse().unwrap()).collect();
                    soup.positions.push(Vec3::from_slice(&position));
                }
                Some("f") => {
                    let corners: Vec<u32> = words
                        .map(|word| word.split('/').next().unwrap().parse::<u32>().unwrap() - 1)
                        .collect();
                    for i in 2..corners.len() {
                        soup.indices
                            .extend([corners[0], corners[i - 1], corners[i]]);
                    }
                }
                _ => {}
            }
        }
        Some(soup)
    }

    /// As flat shading has it: no two faces share a vertex.
    fn unshared(&self) -> Self {
        let corners: Vec<Vec3> = self
            .indices
            .iter()
            .map(|&i| self.positions[i as usize])
            .collect();
        let indices = (0..corners.len() as u32).collect();
        Self::new(corners, indices)
    }

    fn scaled(&self, factor: f32, away: Vec3) -> Self {
        let positions = self.positions.iter().map(|&p| p * factor + away).collect();
        Self::new(positions, self.indices.clone())
    }

    fn build(&self, most: u32) -> Option<Proxy> {
        build(&self.positions, &self.indices, most)
    }

    fn size(&self) -> f64 {
        let min = self.positions.iter().fold(Vec3::MAX, |min, &p| min.min(p));
        let max = self.positions.iter().fold(Vec3::MIN, |max, &p| max.max(p));
        max.as_dvec3().distance(min.as_dvec3())
    }

    /// Corners, middles and random points of the faces, all told about `count`, spread over them.
    fn points(&self, count: usize) -> Vec<DVec3> {
        let faces = self.indices.len() / 3;
        let picks = count.div_ceil(5);
        let unit = |i: usize, salt: u32| f64::from(hash(i as u32 ^ hash(salt))) / 4294967295.0;
        (0..picks)
            .flat_map(|pick| {
                let face = if faces <= picks {
                    pick % faces
                } else {
                    pick * faces / picks
                };
                let [a, b, c] = [0, 1, 2]
                    .map(|k| self.positions[self.indices[3 * face + k] as usize].as_dvec3());
                let (mut u, mut v) = (unit(pick, 1), unit(pick, 2));
                if u + v > 1.0 {
                    (u, v) = (1.0 - u, 1.0 - v);
                }
                [a, b, c, (a + b + c) / 3.0, a + u * (b - a) + v * (c - a)]
            })
            .collect()
    }
}

fn to_segment(point: DVec3, a: DVec3, b: DVec3) -> f64 {
    let ab = b - a;
    let t = if ab == DVec3::ZERO {
        0.0
    } else {
        (point - a).dot(ab) / ab.dot(ab)
    };
    point.distance(a + ab * t.clamp(0.0, 1.0))
}

/// Distance from a point to a triangle by way of barycentric coordinates; too large by up to a sliver's width.
fn distance_at_most(point: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let edges = to_segment(point, a, b)
        .min(to_segment(point, b, c))
        .min(to_segment(point, c, a));
    let (ab, ac, ap) = (b - a, c - a, point - a);
    let (bb, bc, cc) = (ab.dot(ab), ab.dot(ac), ac.dot(ac));
    let determinant = bb * cc - bc * bc;
    let v = (cc * ab.dot(ap) - bc * ac.dot(ap)) / determinant;
    let w = (bb * ac.dot(ap) - bc * ab.dot(ap)) / determinant;
    if determinant > 0.0 && v >= 0.0 && w >= 0.0 && v + w <= 1.0 {
        return edges.min(point.distance(a + v * ab + w * ac));
    }
    edges
}

/// The same by search among the segments parallel to one edge, over which distance is convex: exact for slivers.
fn distance(point: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let at = |t: f64| to_segment(point, a + t * (b - a), a + t * (c - a));
    let (mut low, mut high) = (0.0, 1.0);
    let mut least = at(low).min(at(high));
    for _ in 0..100 {
        let (t, u) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        let (at_t, at_u) = (at(t), at(u));
        least = least.min(at_t).min(at_u);
        if at_t < at_u {
            high = u;
        } else {
            low = t;
        }
    }
    least
}

/// How far the farthest of the points lies outside every thickened triangle; not positive if none does.
fn outside(proxy: &Proxy, points: &[DVec3]) -> f64 {
    assert!(!points.is_empty());
    let least = |point: DVec3, distance: fn(DVec3, [DVec3; 3]) -> f64| {
        let of = |swept: &SweptTriangle| {
            distance(point, swept.corners.map(|corner| corner.as_dvec3())) - f64::from(swept.radius)
        };
        proxy.triangles.iter().map(of).fold(f64::INFINITY, f64::min)
    };
    points
        .iter()
        .map(|&point| {
            let quick = least(point, distance_at_most);
            if quick > 0.0 {
                least(point, distance)
            } else {
                quick
            }
        })
        .fold(f64::NEG_INFINITY, f64::max)
}

fn check(name: &str, soup: &Soup, most: u32, points: usize) -> Proxy {
    let proxy = soup
        .build(most)
        .unwrap_or_else(|| panic!("{name}: no proxy"));
    let count = proxy.triangles.len();
    assert!(
        (1..=most as usize).contains(&count),
        "{name}: {count} of {most}"
    );
    assert!(
        proxy
            .triangles
            .iter()
            .all(|swept| swept.radius >= 0.0 && swept.radius.is_finite())
    );
    let outside = outside(&proxy, &soup.points(points));
    assert!(outside <= 0.0, "{name}: a point is {outside} outside");
    proxy
}

/// Mean and largest radius as parts of the object's diagonal.
fn radii(soup: &Soup, proxy: &Proxy) -> (f64, f64) {
    let radii = proxy.triangles.iter().map(|swept| f64::from(swept.radius));
    let mean = radii.clone().sum::<f64>() / proxy.triangles.len() as f64;
    (mean / soup.size(), radii.fold(0.0, f64::max) / soup.size())
}

#[test]
fn models_are_enclosed_closely() {
    for (name, bounds) in [
        ("stanford_bunny", [0.045, 0.025, 0.006]),
        ("spot", [0.036, 0.02, 0.005]),
        ("xyzrgb_dragon_20k", [0.06, 0.033, 0.009]),
    ] {
        let Some(soup) = Soup::model(name) else {
            continue;
        };
        for (most, bound) in [50, 100, 500].into_iter().zip(bounds) {
            let proxy = check(name, &soup, most, 20_000);
            let (mean, largest) = radii(&soup, &proxy);
            println!(
                "{name}, at most {most}: {} triangles, radius {:.2} % of the diagonal, at most {:.2} %",
                proxy.triangles.len(),
                100.0 * mean,
                100.0 * largest,
            );
            assert!(mean < bound, "{name}, at most {most}: {mean}");
        }
    }
}

#[test]
fn a_proxy_that_is_too_thin_is_noticed() {
    let soups = [
        Some(("sphere", sphere(40))),
        Soup::model("spot").map(|soup| ("spot", soup)),
    ];
    for (name, soup) in soups.into_iter().flatten() {
        let mut proxy = check(name, &soup, 100, 20_000);
        for swept in &mut proxy.triangles {
            swept.radius *= 0.5;
        }
        assert!(outside(&proxy, &soup.points(2000)) > 0.0, "{name}");
    }
    // One triangle less.
    let soup = sphere(40);
    let mut proxy = check("sphere", &soup, 100, 20_000);
    proxy.triangles.truncate(proxy.triangles.len() - 1);
    assert!(outside(&proxy, &soup.points(2000)) > 0.0);
}

/// A sphere of `n` × 2`n` quads, which degenerate at its poles.
fn sphere(n: u32) -> Soup {
    let vertex = |i: u32| {
        let (ring, step) = (i / (2 * n + 1), i % (2 * n + 1));
        let theta = ring as f32 / n as f32 * core::f32::consts::PI;
        let phi = step as f32 / n as f32 * core::f32::consts::PI;
        Vec3::new(
            theta.sin() * phi.cos(),
            theta.cos(),
            theta.sin() * phi.sin(),
        )
    };
    let positions = (0..(n + 1) * (2 * n + 1)).map(vertex).collect();
    let indices = (0..n * 2 * n)
        .flat_map(|quad| {
            let corner = quad / (2 * n) * (2 * n + 1) + quad % (2 * n);
            let below = corner + 2 * n + 1;
            [corner, corner + 1, below, below, corner + 1, below + 1]
        })
        .collect();
    Soup::new(positions, indices)
}

/// Triangles anywhere in a unit cube, each of the given size.
fn scattered(count: u32, size: f32) -> Soup {
    let unit = |i: u32| hash(i) as f32 / 4294967295.0;
    let positions = (0..9 * count)
        .collect::<Vec<_>>()
        .chunks(9)
        .flat_map(|nine| {
            let at = |k: usize| Vec3::new(unit(nine[k]), unit(nine[k + 1]), unit(nine[k + 2]));
            [at(0), at(0) + at(3) * size, at(0) + at(6) * size]
        })
        .collect();
    Soup::new(positions, (0..3 * count).collect())
}

#[test]
fn hard_meshes_are_enclosed() {
    let one = vec![Vec3::ZERO, Vec3::X, Vec3::new(0.3, 2.0, -1.0)];
    let fan: Vec<Vec3> = (0..200)
        .map(|i| Vec3::new(i as f32, (i % 2) as f32 * 1e-6, 0.0))
        .collect();
    let strip = (0..198)
        .flat_map(|i| [i, i + 1, i + 2])
        .collect::<Vec<u32>>();
    let needles: Vec<Vec3> = (0..300)
        .map(|i| {
            Vec3::new(
                (hash(i) % 7) as f32,
                (i % 3) as f32 * 1e-7,
                (hash(i + 999) % 5) as f32,
            )
        })
        .collect();
    let ball = sphere(24);
    let doubled = Soup::new(
        ball.positions.clone(),
        ball.indices
            .iter()
            .copied()
            .chain(
                ball.indices
                    .as_chunks::<3>()
                    .0
                    .iter()
                    .flat_map(|&[a, b, c]| [a, c, b]),
            )
            .collect(),
    );
    let cases = [
        ("one triangle", Soup::new(one.clone(), vec![0, 1, 2])),
        (
            "two coincident faces",
            Soup::new(one.clone(), vec![0, 1, 2, 1, 0, 2]),
        ),
        (
            "an edge as a triangle",
            Soup::new(one.clone(), vec![0, 1, 0]),
        ),
        (
            "a point as a triangle",
            Soup::new(one.clone(), vec![2, 2, 2]),
        ),
        (
            "points only",
            Soup::new(one.clone(), (0..200).flat_map(|i| [i % 3; 3]).collect()),
        ),
        (
            "one place many times",
            Soup::new(vec![Vec3::splat(0.1); 300], (0..300).collect()),
        ),
        (
            "many in a line",
            Soup::new(fan.iter().map(|p| p * Vec3::X).collect(), strip.clone()),
        ),
        ("slivers", Soup::new(fan, strip)),
        ("needles", Soup::new(needles, (0..300).collect())),
        ("two sides", doubled),
        ("flat shaded", ball.unshared()),
        ("scattered", scattered(3000, 0.01)),
        ("scattered and large", scattered(300, 3.0)),
        ("huge", ball.scaled(1e18, Vec3::ZERO)),
        ("as huge as can be", ball.scaled(1e38, Vec3::ZERO)),
        ("tiny", ball.scaled(1e-18, Vec3::ZERO)),
        ("subnormal", ball.scaled(1e-42, Vec3::ZERO)),
        ("far away", ball.scaled(1.0, Vec3::splat(1e6))),
        (
            "so far away that it is a few steps wide",
            ball.scaled(1.0, Vec3::splat(1e7)),
        ),
    ];
    for (name, soup) in &cases {
        for most in [1, 2, 20, 100] {
            check(name, soup, most, 3000);
        }
    }
}

#[test]
fn what_is_no_mesh_has_no_proxy() {
    let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
    assert!(build(&corners, &[0, 1, 2], 100).is_some());
    assert_eq!(build(&corners, &[0, 1, 2], 0), None);
    assert_eq!(build(&[], &[], 100), None);
    assert_eq!(build(&corners, &[], 100), None);
    assert_eq!(build(&[], &[0, 0, 0], 100), None);
    assert_eq!(build(&corners, &[0, 1, 2, 0], 100), None);
    assert_eq!(build(&corners, &[0, 1, 3], 100), None);
    assert_eq!(build(&corners, &[0, 1, u32::MAX], 100), None);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert_eq!(
            build(&[Vec3::ZERO, Vec3::X, Vec3::splat(bad)], &[0, 1, 2], 100),
            None
        );
    }
}

#[test]
fn what_is_simple_enough_stays_as_it_is() {
    let soup = sphere(4);
    let faces = soup.indices.len() as u32 / 3;
    let proxy = check("sphere", &soup, faces, 2000);
    assert!(proxy.triangles.iter().all(|swept| swept.radius < 1e-12));
}

#[test]
fn shared_vertices_make_no_difference() {
    let soup = sphere(24);
    let (mean, _) = radii(&soup, &check("shared", &soup, 100, 5000));
    let (flat, _) = radii(&soup, &check("unshared", &soup.unshared(), 100, 5000));
    assert!((flat / mean - 1.0).abs() < 0.3, "{flat} for {mean}");
}

#[test]
fn no_more_triangles_are_made_than_there_may_be() {
    let soup = sphere(40);
    let proxy = check("sphere", &soup, u32::MAX, 2000);
    assert!(proxy.triangles.len() <= MOST_TRIANGLES as usize);
}

proptest! {
    #[test]
    fn any_soup_is_enclosed(
        points in prop::collection::vec(prop::array::uniform3(-1.0_f32..1.0), 3..40),
        picks in prop::collection::vec(0..1000_u32, 3..300),
        most in 1..30_u32,
        scale in -18.0_f32..18.0,
    ) {
        let factor = 10_f32.powf(scale);
        let positions: Vec<Vec3> = points.iter().map(|&p| Vec3::from(p) * factor).collect();
        let mut indices: Vec<u32> = picks.iter().map(|i| i % positions.len() as u32).collect();
        indices.truncate(indices.len() / 3 * 3);
        check("soup", &Soup::new(positions, indices), most, 2000);
    }
}
