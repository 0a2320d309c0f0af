//! What can be seen and what can be touched, by rays and by balls that meet a model's triangles.
//!
//! - Whether any ray that leaves a triangle gets out. Rays are finitely many, so that a triangle of which none gets out may
//!   still be seen through a slit; one of which a ray gets out is seen.
//! - What a ball touches first that comes straight from outside: what it must not have lost, by
//!   [what is guaranteed](crate::interior#what-is-guaranteed).

use bevy::math::DVec3;

use super::{super::lot::Lot, views::Shown};

/// Triangles in a leaf.
const LEAF: usize = 4;
/// What a ball touches within so much of its way is touched at once. units: of the model's size
const TIE: f64 = 1e-9;

/// Boxes in boxes around a model's triangles, halved at the middle of their triangles along the longest side.
pub struct Walls<'a> {
    triangles: &'a [Shown],
    /// Their numbers, in the order of the leaves.
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
    /// `extent`: the model's size.
    pub fn new(triangles: &'a [Shown], extent: f64) -> Self {
        let mut walls = Self {
            triangles,
            order: Vec::new(),
            nodes: Vec::new(),
            extent,
        };
        let mut order: Vec<u32> = (0..triangles.len() as u32).collect();
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

    /// Asks about the triangles in whatever boxes a ray comes to within a distance of, until told to stop. Whether it was.
    fn find(
        &self,
        from: DVec3,
        way: DVec3,
        within: f64,
        mut ask: impl FnMut(usize, &Shown) -> bool,
    ) -> bool {
        let inverse = way.recip();
        let mut stack = [0u32; 96];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let number = stack[depth];
            let node = &self.nodes[number as usize];
            if !meets_box(node, within, from, inverse) {
                continue;
            }
            if node.count == 0 {
                stack[depth] = node.second;
                stack[depth + 1] = number + 1;
                depth += 2;
                continue;
            }
            for i in &self.order[node.start as usize..(node.start + node.count) as usize] {
                if ask(*i as usize, &self.triangles[*i as usize]) {
                    return true;
                }
            }
        }
        false
    }

    /// Whether a ray from a place gets out: an eye out there, looking along it, meets nothing before that place. One-sided
    /// triangles that it sees from behind hide nothing, and neither do transparent ones.
    fn gets_out(&self, from: DVec3, way: DVec3) -> bool {
        !self.find(from, way, 0.0, |_, triangle| {
            !triangle.is_transparent && Self::hides(triangle, from, way)
        })
    }

    /// Whether a ball of this radius, its middle moving from a place outside along a way (units: 1), touches any of the
    /// triangles asked for before anything opaque stops it, or as it does. One-sided triangles that an eye looking along
    /// the way sees from behind it passes through.
    pub fn ball_touches(
        &self,
        from: DVec3,
        way: DVec3,
        radius: f64,
        is_asked_for: impl Fn(usize) -> bool,
    ) -> bool {
        let shows = |triangle: &Shown| {
            let [a, b, c] = triangle.corners;
            triangle.is_two_sided || (b - a).cross(c - a).dot(way) < 0.0
        };
        let (mut stopped, mut touched) = (f64::INFINITY, f64::INFINITY);
        self.find(from, way, radius, |i, triangle| {
            if shows(triangle)
                && let Some(after) = touch(triangle.corners, from, way, radius)
            {
                if !triangle.is_transparent {
                    stopped = stopped.min(after);
                }
                if is_asked_for(i) {
                    touched = touched.min(after);
                }
            }
            false
        });
        touched < f64::INFINITY && touched <= stopped + TIE * self.extent
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

/// How far a ball's middle moves along a way (units: 1) until the ball touches a triangle; `None` if it never does, or
/// cuts it where it begins.
fn touch(corners: [DVec3; 3], from: DVec3, way: DVec3, radius: f64) -> Option<f64> {
    let [a, b, c] = corners;
    let mut first = f64::INFINITY;
    // The inside: the foot of the ball's middle on the plane, when that is as far from it as the radius.
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let (height, sinks) = ((from - a).dot(normal), way.dot(normal));
    if sinks * height < 0.0 {
        let after = (height.abs() - radius) / sinks.abs();
        let foot = from + way * after - normal * (radius * height.signum());
        let is_inside = [(a, b), (b, c), (c, a)]
            .iter()
            .all(|(p, q)| (*q - *p).cross(foot - *p).dot(normal) >= 0.0);
        if after >= 0.0 && is_inside {
            first = after;
        }
    }
    // When |m + t·w| first is the radius: m and w from a corner, or across an edge.
    let meets = |m: DVec3, w: DVec3| {
        let (ww, mw) = (w.length_squared(), m.dot(w));
        let inside = mw * mw - ww * (m.length_squared() - radius * radius);
        let after = (-mw - inside.max(0.0).sqrt()) / ww;
        (ww > 0.0 && inside >= 0.0 && after >= 0.0).then_some(after)
    };
    for (p, q) in [(a, b), (b, c), (c, a)] {
        if let Some(after) = meets(from - p, way) {
            first = first.min(after);
        }
        let whole = (q - p).length_squared();
        if whole == 0.0 {
            continue;
        }
        let across = |v: DVec3| v - (q - p) * (v.dot(q - p) / whole);
        if let Some(after) = meets(across(from - p), across(way)) {
            let along = (from + way * after - p).dot(q - p) / whole;
            if (0.0..=1.0).contains(&along) {
                first = first.min(after);
            }
        }
    }
    (first < f64::INFINITY).then_some(first)
}

/// Whether a ray comes to a box, or to within a distance of it in every axis.
fn meets_box(node: &Node, within: f64, from: DVec3, inverse: DVec3) -> bool {
    let (a, b) = (
        (node.least - within - from) * inverse,
        (node.greatest + within - from) * inverse,
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

    #[test]
    fn a_ball_touches_a_triangle_inside_at_an_edge_and_at_a_corner() {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let after = |x, y| touch(corners, DVec3::new(x, y, 5.0), DVec3::NEG_Z, 0.5);
        assert_eq!(after(0.25, 0.25), Some(4.5));
        let close = |found: Option<f64>, wanted: f64| {
            assert!((found.unwrap() - wanted).abs() < 1e-12, "{found:?}");
        };
        // √(0.5² − 0.3²) above the edge; the same from a corner that is 0.3 away.
        close(after(0.5, -0.3), 5.0 - 0.4);
        close(after(-0.18, -0.24), 5.0 - 0.4);
        assert_eq!(after(-0.5, -0.5), None);
        // Wherever it touches, it is as far from the triangle as its radius.
        let mut lot = Lot(1);
        for _ in 0..1000 {
            let corners = [(); 3].map(|()| lot.direction() * lot.between(0.0, 2.0));
            let from = lot.direction() * 10.0;
            let way = (lot.direction() * lot.between(0.0, 2.0) - from).normalize();
            let away = |t: f64| crate::reference::interior::distance(from + way * t, corners);
            match touch(corners, from, way, 0.5) {
                Some(after) => {
                    assert!((away(after) - 0.5).abs() < 1e-9);
                    assert!((0..100).all(|i| away(after * f64::from(i) / 100.0) > 0.5));
                }
                None => assert!((0..400).all(|i| away(f64::from(i) / 20.0) > 0.5)),
            }
        }
    }

    #[test]
    fn a_shaft_lets_in_a_ball_as_wide_as_it_and_no_wider() {
        let wall = |depth: f32, least: [f32; 2], greatest: [f32; 2]| {
            let cuboid = cuboid(
                [depth, least[0], least[1]],
                [depth + 0.1, greatest[0], greatest[1]],
            );
            shown(&Model {
                parts: vec![Part {
                    node: 0,
                    surface: Arc::new(cuboid),
                    model_from_local: DAffine3::IDENTITY,
                    is_transparent: false,
                    is_two_sided: false,
                }],
            })
        };
        // A wall with a hole of half side 0.5, and another wall behind it, which lacks.
        let mut all = wall(1.0, [-2.0; 2], [2.0; 2]);
        all.extend(wall(-1.0, [0.5, -2.0], [2.0, 2.0]));
        all.extend(wall(-1.0, [-2.0, -2.0], [-0.5, 2.0]));
        all.extend(wall(-1.0, [-0.5, 0.5], [0.5, 2.0]));
        all.extend(wall(-1.0, [-0.5, -2.0], [0.5, -0.5]));
        let touches = |all: &[Shown], radius, is_missing: fn(usize) -> bool| {
            let from = DVec3::new(-5.0, 0.0, 0.0);
            Walls::new(all, 8.0).ball_touches(from, DVec3::X, radius, is_missing)
        };
        assert!(touches(&all, 0.4999, |i| i < 12));
        assert!(!touches(&all, 0.5001, |i| i < 12));
        assert!(touches(&all, 0.5001, |i| i >= 12));
        // A pane in front is touched on the way, and lets the ball through.
        let panes = wall(-2.0, [-0.4; 2], [0.4; 2]);
        all.extend(panes.into_iter().map(|pane| Shown {
            is_transparent: true,
            ..pane
        }));
        assert!(touches(&all, 0.4999, |i| i < 12));
        assert!(touches(&all, 3.0, |i| i >= 60));
        assert!(!touches(&all, 3.0, |i| i < 12));
    }
}
