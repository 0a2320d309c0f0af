//! What can be seen of a triangle, by rays that leave it: whether any gets out of the model.
//!
//! Rays are finitely many, so that a triangle of which none gets out may still be seen through a slit; one of which a ray
//! gets out is seen.

use bevy::math::DVec3;

use super::{super::lot::Lot, views::Shown};

/// Triangles in a leaf.
const LEAF: usize = 4;

/// Boxes in boxes around what hides, halved at the middle of their triangles along the longest side.
pub struct Walls<'a> {
    triangles: &'a [Shown],
    /// Those that hide, in the order of the leaves.
    order: Vec<u32>,
    nodes: Vec<Node>,
    extent: f64,
}

struct Node {
    least: DVec3,
    greatest: DVec3,
    /// Of the order; of a leaf.
    start: u32,
    count: u32,
    /// The second child; the first comes after its parent.
    second: u32,
}

impl<'a> Walls<'a> {
    /// Around triangles; transparent ones hide nothing. `extent`: the model's size.
    pub fn new(triangles: &'a [Shown], extent: f64) -> Self {
        let mut walls = Self {
            triangles,
            order: (0..triangles.len() as u32)
                .filter(|i| !triangles[*i as usize].is_transparent)
                .collect(),
            nodes: Vec::new(),
            extent,
        };
        let mut order = core::mem::take(&mut walls.order);
        if !order.is_empty() {
            walls.split(&mut order, 0);
        }
        walls.order = order;
        walls
    }

    fn split(&mut self, order: &mut [u32], start: usize) {
        let corners = |i: &u32| self.triangles[*i as usize].corners;
        let mut least = DVec3::MAX;
        let mut greatest = DVec3::MIN;
        for corner in order.iter().flat_map(corners) {
            least = least.min(corner);
            greatest = greatest.max(corner);
        }
        let number = self.nodes.len();
        let is_leaf = order.len() <= LEAF;
        self.nodes.push(Node {
            least,
            greatest,
            start: start as u32,
            count: if is_leaf { order.len() as u32 } else { 0 },
            second: 0,
        });
        if is_leaf {
            return;
        }
        let axis = (greatest - least).max_position();
        let triangles = self.triangles;
        let middle = |i: &u32| -> f64 {
            let corners = triangles[*i as usize].corners;
            corners.iter().map(|corner| corner[axis]).sum()
        };
        let half = order.len() / 2;
        order.select_nth_unstable_by(half, |a, b| middle(a).total_cmp(&middle(b)));
        let (first, second) = order.split_at_mut(half);
        self.split(first, start);
        self.nodes[number].second = self.nodes.len() as u32;
        self.split(second, start + half);
    }

    /// Whether a ray from a place gets out: an eye out there, looking along it, meets nothing before that place. One-sided
    /// triangles that it sees from behind hide nothing.
    fn gets_out(&self, from: DVec3, way: DVec3) -> bool {
        let inverse = way.recip();
        let mut stack = [0u32; 96];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let number = stack[depth];
            let node = &self.nodes[number as usize];
            if !meets_box(node, from, inverse) {
                continue;
            }
            if node.count == 0 {
                stack[depth] = node.second;
                stack[depth + 1] = number + 1;
                depth += 2;
                continue;
            }
            let leaf = node.start as usize..(node.start + node.count) as usize;
            let is_hit = self.order[leaf]
                .iter()
                .any(|i| Self::hides(&self.triangles[*i as usize], from, way));
            if is_hit {
                return false;
            }
        }
        true
    }

    fn hides(triangle: &Shown, from: DVec3, way: DVec3) -> bool {
        let [a, b, c] = triangle.corners;
        let (u, v) = (b - a, c - a);
        let across = way.cross(v);
        let determinant = u.dot(across);
        // The ray leaves through the front of what hides the place from the eye out there.
        let normal_along = u.cross(v).dot(way);
        if determinant == 0.0 || (normal_along < 0.0 && !triangle.is_two_sided) {
            return false;
        }
        let to = from - a;
        let s = to.dot(across) / determinant;
        let q = to.cross(u);
        let t = way.dot(q) / determinant;
        let far = v.dot(q) / determinant;
        s >= 0.0 && t >= 0.0 && s + t <= 1.0 && far > 0.0
    }

    /// Whether a ray from any of so many places on a triangle, in any of so many directions, gets out on a side that it
    /// shows from.
    pub fn is_seen(&self, triangle: &Shown, places: usize, directions: usize, seed: u64) -> bool {
        let [a, b, c] = triangle.corners;
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let mut lot = Lot(seed.wrapping_mul(0x2545_f491_4f6c_dd1d));
        (0..places).any(|place| {
            // The middle first.
            let (s, t) = if place == 0 {
                (1.0 / 3.0, 1.0 / 3.0)
            } else {
                let (s, t) = (lot.between(0.0, 1.0), lot.between(0.0, 1.0));
                if s + t > 1.0 {
                    (1.0 - s, 1.0 - t)
                } else {
                    (s, t)
                }
            };
            let on = a + (b - a) * s + (c - a) * t;
            (0..directions).any(|_| {
                let way = lot.direction();
                let side = way.dot(normal);
                // An edge-on or flat triangle shows nothing.
                if side == 0.0 || (side < 0.0 && !triangle.is_two_sided) {
                    return false;
                }
                let from = on + normal * side.signum() * self.extent * 1e-9;
                self.gets_out(from, way)
            })
        })
    }
}

fn meets_box(node: &Node, from: DVec3, inverse: DVec3) -> bool {
    let (a, b) = (
        (node.least - from) * inverse,
        (node.greatest - from) * inverse,
    );
    // Along an axis that the ray does not move in, both are infinite, or no number where it starts on the box's face:
    // `min` and `max` pass over these.
    let enters = a.x.min(b.x).max(a.y.min(b.y)).max(a.z.min(b.z));
    let leaves = a.x.max(b.x).min(a.y.max(b.y)).min(a.z.max(b.z));
    leaves >= enters.max(0.0) || leaves.is_nan() || enters.is_nan()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use bevy::math::DAffine3;

    use super::{
        super::{machine::cuboid, views::shown},
        *,
    };
    use crate::interior::{Model, Part};

    /// A cube around the origin, outward.
    fn cube(half: f32, is_two_sided: bool) -> Vec<Shown> {
        let part = Part {
            node: 0,
            surface: Arc::new(cuboid([-half; 3], [half; 3])),
            model_from_local: DAffine3::IDENTITY,
            is_transparent: false,
            is_two_sided,
        };
        shown(&Model { parts: vec![part] })
    }

    #[test]
    fn a_shell_is_seen_and_what_is_in_it_is_not() {
        let all: Vec<_> = cube(1.0, false)
            .into_iter()
            .chain(cube(0.5, false))
            .collect();
        let walls = Walls::new(&all, 2.0);
        for (i, triangle) in all.iter().enumerate() {
            assert_eq!(
                walls.is_seen(triangle, 2, 32, i as u64),
                i < 12,
                "triangle {i}"
            );
        }
    }

    #[test]
    fn an_open_shell_shows_its_inside_and_a_shell_seen_from_behind_hides_nothing() {
        let mut open = cube(1.0, true);
        open.truncate(10);
        let all: Vec<_> = open.into_iter().chain(cube(0.5, false)).collect();
        let walls = Walls::new(&all, 2.0);
        let seen = (10..22)
            .filter(|i| walls.is_seen(&all[*i], 8, 64, *i as u64))
            .count();
        assert!(seen > 0);
        let mut away = cube(1.0, false);
        for triangle in &mut away {
            triangle.corners.swap(0, 1);
        }
        let all: Vec<_> = away.into_iter().chain(cube(0.5, false)).collect();
        let walls = Walls::new(&all, 2.0);
        assert!((0..24).all(|i| walls.is_seen(&all[i], 4, 64, i as u64)));
    }
}
