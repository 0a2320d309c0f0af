//! How thick each triangle of a simplified mesh must be for all of them to enclose the mesh.

use std::collections::BinaryHeap;

use bevy::{math::DVec3, prelude::*};

use crate::{culling::volume::SweptTriangle, occlusion::obb::round_up};

/// How often a face may be halved.
const MOST_HALVINGS: u8 = 8;
/// Faces are halved so often at most, or once for each face if there are more.
const LEAST_HALVINGS: usize = 20_000;
/// What distances may be short by: a part of themselves, and a part of the coordinates that they come from.
const ROUNDING: (f64, f64) = (1e-9, 16.0 * f64::EPSILON);

/// Thickens the triangles, and some of the faces themselves while there are fewer than `most`, until they enclose
/// the faces. Those that enclose nothing the others don't are left out.
///
/// `None` if there is no triangle, or if a radius is too large for an `f32`.
pub(super) fn enclose(
    faces: &[[DVec3; 3]],
    triangles: &[[Vec3; 3]],
    most: usize,
) -> Option<Vec<SweptTriangle>> {
    let mut triangles = triangles.to_vec();
    let mut targets: Vec<Target> = triangles.iter().map(Target::new).collect();
    if targets.is_empty() {
        return None;
    }
    let mut near = 0;
    let mut pieces: Vec<Piece> = faces
        .iter()
        .map(|&corners| {
            let piece = Piece::nearest(corners, 0, &targets, near);
            near = piece.target;
            piece
        })
        .collect();

    // Where the simplified mesh left the mesh farthest, room that is left goes to a triangle of the mesh itself.
    while targets.len() < most
        && let Some(worst) = pieces.iter().max().filter(|worst| worst.squared > 0.0)
    {
        let triangle = worst.corners.map(|corner| corner.as_vec3());
        let target = Target::new(&triangle);
        for piece in &mut pieces {
            piece.try_target(targets.len(), &target);
        }
        triangles.push(triangle);
        targets.push(target);
    }

    let mut pieces = BinaryHeap::from(pieces);
    // The worst first: it pays for its radius, and whatever lies within that radius comes free.
    let mut squared: Vec<Option<f64>> = vec![None; targets.len()];
    let mut paid: Vec<usize> = Vec::new();
    let mut halvings = LEAST_HALVINGS.max(faces.len());
    while let Some(piece) = pieces.pop() {
        if squared[piece.target].is_some_and(|squared| piece.squared <= squared) {
            continue;
        }
        let enclosed = paid.iter().any(|&target| {
            squared[target].is_some_and(|squared| targets[target].reaches(&piece.corners, squared))
        });
        if enclosed {
            continue;
        }
        if halvings > 0
            && let Some(halves) = piece.halves()
        {
            halvings -= 1;
            let depth = piece.depth + 1;
            let near = piece.target;
            pieces.extend(halves.map(|half| Piece::nearest(half, depth, &targets, near)));
            continue;
        }
        // By rounding, a half may need a little more than what it is the half of, and its target pay again.
        if squared[piece.target].replace(piece.squared).is_none() {
            paid.push(piece.target);
        }
    }

    let largest = faces
        .as_flattened()
        .iter()
        .fold(0.0, |largest: f64, corner| {
            largest.max(corner.abs().max_element())
        });
    paid.iter()
        .map(|&target| {
            let distance = squared[target].unwrap_or_default().sqrt();
            let radius = round_up(distance * (1.0 + ROUNDING.0) + largest * ROUNDING.1);
            radius.is_finite().then_some(SweptTriangle {
                corners: triangles[target],
                radius,
            })
        })
        .collect()
}

/// A face, or a part of one, given to the target whose radius it needs least of. Ordered by what it needs.
struct Piece {
    corners: [DVec3; 3],
    depth: u8,
    target: usize,
    /// Square of the radius that its target must have to enclose it.
    squared: f64,
}

impl Piece {
    /// Tries `near` first: neighbours in a mesh often go to the same target, and the rest is then soon ruled out.
    fn nearest(corners: [DVec3; 3], depth: u8, targets: &[Target], near: usize) -> Self {
        let mut piece = Self {
            corners,
            depth,
            target: near,
            squared: targets[near].needs(&corners, f64::INFINITY),
        };
        for (index, target) in targets.iter().enumerate() {
            if index != near {
                piece.try_target(index, target);
            }
        }
        piece
    }

    /// Goes to this target if it needs less of it.
    fn try_target(&mut self, index: usize, target: &Target) {
        let [a, b, c] = self.corners;
        if target.is_beyond((a + b + c) / 3.0, self.squared) {
            return;
        }
        let squared = target.needs(&self.corners, self.squared);
        if squared < self.squared {
            (self.target, self.squared) = (index, squared);
        }
    }

    /// Its two parts on both sides of its longest edge's middle, if they could need much less than it does.
    fn halves(&self) -> Option<[[DVec3; 3]; 2]> {
        let [a, b, c] = self.corners;
        let edges = [
            (a.distance_squared(b), [a, b, c]),
            (b.distance_squared(c), [b, c, a]),
            (c.distance_squared(a), [c, a, b]),
        ];
        let (length, [a, b, c]) =
            edges.into_iter().fold(
                edges[0],
                |best, edge| if edge.0 > best.0 { edge } else { best },
            );
        if self.depth >= MOST_HALVINGS || 4.0 * length <= self.squared {
            return None;
        }
        let middle = 0.5 * (a + b);
        Some([[a, middle, c], [middle, b, c]])
    }
}

impl PartialEq for Piece {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Piece {}

impl PartialOrd for Piece {
    fn partial_cmp(&self, other: &Self) -> Option<core::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Piece {
    fn cmp(&self, other: &Self) -> core::cmp::Ordering {
        self.squared.total_cmp(&other.squared)
    }
}

/// A triangle of the simplified mesh, with what makes distances to it cheap.
struct Target {
    a: DVec3,
    ab: DVec3,
    ac: DVec3,
    normal: DVec3,
    /// Square of the normal's length; zero where the normal is too short for its direction to mean anything.
    normal_squared: f64,
    middle: DVec3,
    /// From the middle to the farthest corner.
    reach: f64,
}

impl Target {
    fn new(corners: &[Vec3; 3]) -> Self {
        let [a, b, c] = corners.map(|corner| corner.as_dvec3());
        let (ab, ac) = (b - a, c - a);
        let normal = ab.cross(ac);
        let sliver = normal.length_squared() <= 1e-20 * ab.length_squared() * ac.length_squared();
        let middle = (a + b + c) / 3.0;
        let reach = [a, b, c]
            .into_iter()
            .map(|corner| corner.distance_squared(middle))
            .fold(0.0, f64::max);
        Self {
            a,
            ab,
            ac,
            normal,
            normal_squared: if sliver { 0.0 } else { normal.length_squared() },
            middle,
            reach: reach.sqrt(),
        }
    }

    /// Whether a face with this middle needs more than the square root of `squared`. The middle's distance is
    /// no more than the face's, as distance is convex. May say no where it is so, for rounding.
    fn is_beyond(&self, middle: DVec3, squared: f64) -> bool {
        let height = self.normal.dot(middle - self.a);
        if self.normal_squared > 0.0 && height * height > squared * self.normal_squared {
            return true;
        }
        let least = squared.sqrt() + self.reach;
        middle.distance_squared(self.middle) > least * least
    }

    /// Square of the radius that encloses the face; anything not less than `enough` where it is no less.
    fn needs(&self, face: &[DVec3; 3], enough: f64) -> f64 {
        let mut most = 0.0;
        for &corner in face {
            most = f64::max(most, self.distance_squared(corner));
            if most >= enough {
                break;
            }
        }
        most
    }

    /// Whether the face lies within the square root of `squared`.
    fn reaches(&self, face: &[DVec3; 3], squared: f64) -> bool {
        face.iter()
            .all(|&corner| self.distance_squared(corner) <= squared)
    }

    /// Square of the distance from `point` to the point of the triangle nearest to it. However badly that one is
    /// chosen for rounding, it is in the triangle: the distance errs only upward.
    fn distance_squared(&self, point: DVec3) -> f64 {
        let from_a = point - self.a;
        if self.normal_squared > 0.0 {
            let u = from_a.cross(self.ac).dot(self.normal) / self.normal_squared;
            let v = self.ab.cross(from_a).dot(self.normal) / self.normal_squared;
            if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
                return (from_a - u * self.ab - v * self.ac).length_squared();
            }
        }
        let to_edge = |from: DVec3, edge: DVec3| {
            let length_squared = edge.length_squared();
            let t = if length_squared > 0.0 {
                (from.dot(edge) / length_squared).clamp(0.0, 1.0)
            } else {
                0.0
            };
            (from - t * edge).length_squared()
        };
        to_edge(from_a, self.ab)
            .min(to_edge(from_a, self.ac))
            .min(to_edge(from_a - self.ab, self.ac - self.ab))
    }
}
