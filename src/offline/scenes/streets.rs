//! Where nothing is built: the ways through a city, found from the roofs of its buildings.

use bevy::prelude::*;

/// Side of a cell. units: m
const CELL_M: f32 = 2.0;
/// Kept free on both sides of a way. units: m
const CLEARANCE_M: f32 = 5.0;
/// Nothing farther from all buildings is a street. units: m
const WIDEST_M: f32 = 22.0;
/// Directions tried for the longest way.
const DIRECTIONS: u32 = 90;

/// Which cells of the ground plane are built on.
pub(super) struct Ground {
    low: Vec2,
    size: UVec2,
    /// Distance to the nearest built cell, within about a tenth. units: m
    distance_m: Vec<f32>,
}

/// A place beside a street.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Spot {
    /// units: m
    pub at: Vec2,
    /// Along the nearest wall.
    pub along: Vec2,
}

impl Ground {
    /// Of the triangles that look upward, between two corners.
    pub(super) fn new(low: Vec2, high: Vec2, roofs: impl Iterator<Item = [Vec3; 3]>) -> Self {
        let size = ((high - low) / CELL_M).ceil().as_uvec2().max(UVec2::ONE);
        let mut ground = Self {
            low,
            size,
            distance_m: vec![f32::MAX; (size.x * size.y) as usize],
        };
        for triangle in roofs {
            if (triangle[1] - triangle[0])
                .cross(triangle[2] - triangle[0])
                .y
                > 0.0
            {
                ground.build_on(triangle.map(|corner| corner.xz()));
            }
        }
        ground.spread();
        ground
    }

    fn build_on(&mut self, triangle: [Vec2; 3]) {
        let cell = |at: Vec2| ((at - self.low) / CELL_M).as_ivec2();
        let (low, high) = triangle.iter().fold(
            (Vec2::INFINITY, Vec2::NEG_INFINITY),
            |(low, high), corner| (low.min(*corner), high.max(*corner)),
        );
        let last = self.size.as_ivec2() - 1;
        let (first, last) = (
            cell(low).clamp(IVec2::ZERO, last),
            cell(high).clamp(IVec2::ZERO, last),
        );
        for y in first.y..=last.y {
            for x in first.x..=last.x {
                let at = self.low + (Vec2::new(x as f32, y as f32) + 0.5) * CELL_M;
                let side = |i: usize| {
                    let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
                    (b - a).perp_dot(at - a)
                };
                let sides = [side(0), side(1), side(2)];
                if sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0) {
                    self.distance_m[(y as u32 * self.size.x + x as u32) as usize] = 0.0;
                }
            }
        }
    }

    /// Distances by two sweeps (Borgefors 1986).
    fn spread(&mut self) {
        let (width, height) = (self.size.x as i32, self.size.y as i32);
        let straight = CELL_M;
        let diagonal = CELL_M * core::f32::consts::SQRT_2;
        for back in [false, true] {
            for step in 0..width * height {
                let index = if back {
                    width * height - 1 - step
                } else {
                    step
                };
                let (x, y) = (index % width, index / width);
                let sign = if back { 1 } else { -1 };
                let mut nearest = self.distance_m[index as usize];
                for (dx, dy, length) in [
                    (sign, 0, straight),
                    (0, sign, straight),
                    (sign, sign, diagonal),
                    (-sign, sign, diagonal),
                ] {
                    let (nx, ny) = (x + dx, y + dy);
                    if (0..width).contains(&nx) && (0..height).contains(&ny) {
                        nearest = nearest.min(self.distance_m[(ny * width + nx) as usize] + length);
                    }
                }
                self.distance_m[index as usize] = nearest;
            }
        }
    }

    /// Distance to the nearest building; `None` outside. units: m
    pub(super) fn distance(&self, at: Vec2) -> Option<f32> {
        let cell = ((at - self.low) / CELL_M).floor();
        if cell.min_element() < 0.0 {
            return None;
        }
        let cell = cell.as_uvec2();
        (cell.x < self.size.x && cell.y < self.size.y)
            .then(|| self.distance_m[(cell.y * self.size.x + cell.x) as usize])
    }

    /// The longest straight ways between buildings, through the city's inner three fifths, each turned from or far
    /// from those before it.
    ///
    /// None longer than `most_m`; there may be fewer than `count`.
    pub(super) fn ways(&self, count: usize, most_m: f32) -> Vec<[Vec2; 2]> {
        let extent = self.size.as_vec2() * CELL_M;
        let mut ways: Vec<(f32, [Vec2; 2])> = Vec::new();
        let step = (extent.max_element() / 40.0).max(CELL_M);
        let (columns, rows) = ((extent.x / step) as u32, (extent.y / step) as u32);
        for row in rows / 5..=4 * rows / 5 {
            for column in columns / 5..=4 * columns / 5 {
                let start = self.low + Vec2::new(column as f32, row as f32) * step;
                // The middle of the street that this place lies in.
                let start = self.climb(start);
                if !self.is_street(start) {
                    continue;
                }
                let best = (0..DIRECTIONS)
                    .map(|direction| {
                        let angle = core::f32::consts::PI * direction as f32 / DIRECTIONS as f32;
                        let ahead = Vec2::from_angle(angle);
                        let half = 0.5 * most_m;
                        let ends = [-ahead, ahead].map(|way| self.go(start, way, half));
                        (ends[0].distance(ends[1]), ends)
                    })
                    .max_by(|a, b| a.0.total_cmp(&b.0));
                ways.extend(best);
            }
        }
        ways.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<[Vec2; 2]> = Vec::new();
        for (length, way) in ways {
            let middle = |way: &[Vec2; 2]| 0.5 * (way[0] + way[1]);
            let apart = |other: &[Vec2; 2]| {
                let across = (way[1] - way[0]).normalize_or_zero();
                let turned = across
                    .perp_dot((other[1] - other[0]).normalize_or_zero())
                    .abs();
                turned > 0.5 || (middle(&way) - middle(other)).perp_dot(across).abs() > 25.0
            };
            if chosen.len() < count && length > 4.0 * CELL_M && chosen.iter().all(apart) {
                chosen.push(way);
            }
        }
        chosen
    }

    /// Uphill in distance from buildings, a few cells.
    fn climb(&self, mut at: Vec2) -> Vec2 {
        for _ in 0..8 {
            let around =
                (-1..=1).flat_map(|y| (-1..=1).map(move |x| Vec2::new(x as f32, y as f32)));
            let best = around
                .map(|offset| at + offset * CELL_M)
                .filter_map(|place| Some((self.distance(place)?, place)))
                .max_by(|a, b| a.0.total_cmp(&b.0));
            match best {
                Some((distance, place)) if self.distance(at).is_none_or(|d| distance > d) => {
                    at = place;
                }
                _ => break,
            }
        }
        at
    }

    fn is_street(&self, at: Vec2) -> bool {
        self.distance(at)
            .is_some_and(|distance| (CLEARANCE_M..WIDEST_M).contains(&distance))
    }

    fn go(&self, from: Vec2, ahead: Vec2, most_m: f32) -> Vec2 {
        let mut gone = 0.0;
        while gone < most_m {
            let next = from + ahead * (gone + CELL_M);
            if !self.is_street(next) {
                break;
            }
            gone += CELL_M;
        }
        from + ahead * gone
    }

    /// Places of squares and parks, farther from all buildings than any street's middle; in rows from the lowest
    /// corner, at least so far from each other.
    pub(super) fn open(&self, apart_m: f32) -> Vec<Vec2> {
        let step = (apart_m / CELL_M).ceil().max(1.0) as usize;
        let rows = (0..self.size.y).step_by(step);
        rows.flat_map(|y| (0..self.size.x).step_by(step).map(move |x| (x, y)))
            .filter(|(x, y)| self.distance_m[(y * self.size.x + x) as usize] > WIDEST_M)
            .map(|(x, y)| self.low + (Vec2::new(x as f32, y as f32) + 0.5) * CELL_M)
            .collect()
    }

    /// The place nearest to another that is at least [`CLEARANCE_M`] from all buildings; the same place if there is
    /// none.
    pub(super) fn free_near(&self, place: Vec2) -> Vec2 {
        let cells = (0..self.size.y).flat_map(|y| (0..self.size.x).map(move |x| (x, y)));
        cells
            .filter(|(x, y)| self.distance_m[(y * self.size.x + x) as usize] >= CLEARANCE_M)
            .map(|(x, y)| self.low + (Vec2::new(x as f32, y as f32) + 0.5) * CELL_M)
            .min_by(|a, b| {
                a.distance_squared(place)
                    .total_cmp(&b.distance_squared(place))
            })
            .unwrap_or(place)
    }

    /// Places so far from a wall, for things that stand along streets; in rows from the lowest corner.
    pub(super) fn spots(&self, distance_m: f32) -> Vec<Spot> {
        let mut spots = Vec::new();
        for y in 1..self.size.y.saturating_sub(1) {
            for x in 1..self.size.x.saturating_sub(1) {
                let at = |x: u32, y: u32| self.distance_m[(y * self.size.x + x) as usize];
                let away = at(x, y) - distance_m;
                if !(0.0..CELL_M).contains(&away) {
                    continue;
                }
                let slope = Vec2::new(at(x + 1, y) - at(x - 1, y), at(x, y + 1) - at(x, y - 1));
                let centre = Vec2::new(x as f32, y as f32) + 0.5;
                spots.push(Spot {
                    at: self.low + centre * CELL_M,
                    along: slope.normalize_or(Vec2::Y).perp(),
                });
            }
        }
        spots
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two walls 20 m apart, along x.
    fn street() -> Ground {
        let roof = |z0: f32, z1: f32| {
            [
                [
                    Vec3::new(0.0, 9.0, z0),
                    Vec3::new(0.0, 9.0, z1),
                    Vec3::new(200.0, 9.0, z1),
                ],
                [
                    Vec3::new(0.0, 9.0, z0),
                    Vec3::new(200.0, 9.0, z1),
                    Vec3::new(200.0, 9.0, z0),
                ],
            ]
        };
        let roofs = roof(0.0, 40.0).into_iter().chain(roof(60.0, 100.0));
        Ground::new(Vec2::ZERO, Vec2::new(200.0, 100.0), roofs)
    }

    #[test]
    fn the_way_runs_along_the_street() {
        let ground = street();
        let ways = ground.ways(1, 1_000.0);
        let [from, to] = ways[0];
        assert!(from.distance(to) > 150.0, "{from} {to}");
        for step in 0..=100 {
            let at = from.lerp(to, step as f32 / 100.0);
            assert!((44.0..=56.0).contains(&at.y), "{at}");
        }
        assert_eq!(ground.distance(Vec2::new(50.0, 20.0)), Some(0.0));
    }

    #[test]
    fn open_places_are_far_from_walls_and_free_ones_near() {
        assert!(street().open(4.0).is_empty(), "a street is no square");
        let roof = [
            Vec3::new(0.0, 9.0, 0.0),
            Vec3::new(0.0, 9.0, 100.0),
            Vec3::new(40.0, 9.0, 100.0),
        ];
        let ground = Ground::new(Vec2::ZERO, Vec2::new(200.0, 100.0), [roof].into_iter());
        let open = ground.open(10.0);
        assert!(open.len() > 20, "{}", open.len());
        for place in &open {
            assert!(ground.distance(*place) > Some(WIDEST_M), "{place}");
        }
        let built = Vec2::new(10.0, 90.0);
        assert_eq!(ground.distance(built), Some(0.0));
        let free = ground.free_near(built);
        assert!(ground.distance(free) >= Some(CLEARANCE_M), "{free}");
        assert!(free.distance(built) < 30.0, "{free}");
    }

    #[test]
    fn spots_stand_along_the_walls() {
        let spots = street().spots(3.0);
        assert!(!spots.is_empty());
        for spot in spots {
            assert!((42.0..58.0).contains(&spot.at.y), "{spot:?}");
            assert!(spot.along.y.abs() < 0.5, "{spot:?}");
        }
    }
}
