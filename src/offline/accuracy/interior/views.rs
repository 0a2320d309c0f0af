//! What is seen of a model from outside, looked at from many sides: which triangle shows in each pixel, and which would
//! be missed there.

use bevy::math::{DVec2, DVec3, UVec2};

use super::super::lot::Lot;
use crate::interior::Model;

/// Every so many views are close ones.
const CLOSE: usize = 3;
/// How much closer.
const CLOSER: f64 = 5.0;
/// Surfaces nearer to each other than this show each other's pixels. units: of the model's size
const TIE: f64 = 1e-6;
/// The golden angle, π·(3 − √5). units: rad
const GOLDEN: f64 = 2.399_963_229_728_653;
/// Balls that are tried around a pixel's ray.
const BALLS: u32 = 64;

/// A triangle as it is looked at.
#[derive(Clone, Copy, Debug)]
pub struct Shown {
    /// In the model's frame, counter-clockwise from the front.
    pub corners: [DVec3; 3],
    /// Number of its part.
    pub part: u32,
    /// Number in its part.
    pub number: u32,
    /// What is behind it shows too.
    pub is_transparent: bool,
    /// It shows from behind.
    pub is_two_sided: bool,
}

/// All triangles of a model as they are drawn.
pub fn shown(model: &Model) -> Vec<Shown> {
    let mut all = Vec::with_capacity(model.triangle_count());
    for (part_number, part) in (0..).zip(&model.parts) {
        let is_mirrored = part.model_from_local.matrix3.determinant() < 0.0;
        let places: Vec<_> = part
            .surface
            .positions
            .iter()
            .map(|p| part.place(*p))
            .collect();
        for (number, triangle) in (0..).zip(&part.surface.triangles) {
            let [Some(a), Some(b), Some(c)] = triangle.map(|i| places.get(i as usize).copied())
            else {
                continue;
            };
            all.push(Shown {
                corners: if is_mirrored { [a, c, b] } else { [a, b, c] },
                part: part_number,
                number,
                is_transparent: part.is_transparent,
                is_two_sided: part.is_two_sided,
            });
        }
    }
    all
}

/// A parallel projection from outside.
#[derive(Clone, Copy, Debug)]
pub struct View {
    right: DVec3,
    up: DVec3,
    forward: DVec3,
    centre: DVec3,
    /// units: of the model's frame
    pixel: f64,
    /// Both sides. units: px
    pub size: u32,
    /// Only some of the model is in it.
    pub is_close: bool,
}

/// So many views of everything between two corners, evenly from all sides (Fibonacci's lattice), every third a close
/// one.
pub fn around((least, greatest): (DVec3, DVec3), count: usize, size: u32) -> Vec<View> {
    let (middle, radius) = (
        (least + greatest) / 2.0,
        (greatest - least).length().max(f64::MIN_POSITIVE) / 2.0,
    );
    let mut lot = Lot(3);
    (0..count)
        .map(|i| {
            let y = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
            let across = (1.0 - y * y).sqrt();
            let turn = GOLDEN * i as f64;
            let forward = -DVec3::new(across * turn.cos(), y, across * turn.sin());
            let (up, right) = forward.any_orthonormal_pair();
            let near = 2.0 * radius * 1.01 / f64::from(size);
            let [x, y] = [(); 2].map(|()| lot.between(-0.6, 0.6) * radius);
            let is_close = i % CLOSE == CLOSE - 1;
            View {
                right,
                up,
                forward,
                centre: middle
                    + if is_close {
                        right * x + up * y
                    } else {
                        DVec3::ZERO
                    },
                pixel: if is_close { near / CLOSER } else { near },
                size,
                is_close,
            }
        })
        .collect()
}

/// Pixels of one view.
pub struct Picture {
    /// Distance along the view of what hides all behind it. units: of the model's frame
    depth: Vec<f64>,
    /// The first of the triangles that show there, as its number in the list; `u32::MAX` for none.
    pub first: Vec<u32>,
    /// Bits of which something that shows there lacks.
    pub missed: Vec<u64>,
}

impl View {
    fn project(&self, place: DVec3) -> DVec3 {
        let to = place - self.centre;
        let half = f64::from(self.size) / 2.0;
        DVec3::new(
            to.dot(self.right) / self.pixel + half,
            half - to.dot(self.up) / self.pixel,
            to.dot(self.forward),
        )
    }

    /// What shows; `missing[i]` has the bits in which triangle i lacks. Marks what shows in `seen`. `extent`: the model's
    /// size, of which ties are a share.
    pub fn look(
        &self,
        triangles: &[Shown],
        missing: &[u64],
        extent: f64,
        seen: &mut [bool],
    ) -> Picture {
        let count = (self.size * self.size) as usize;
        let mut picture = Picture {
            depth: vec![f64::INFINITY; count],
            first: vec![u32::MAX; count],
            missed: vec![0; count],
        };
        let tie = TIE * extent;
        for (number, triangle) in triangles.iter().enumerate() {
            if triangle.is_transparent {
                continue;
            }
            self.draw(triangle, |at, depth| {
                if depth < picture.depth[at] - tie {
                    picture.depth[at] = depth;
                    picture.first[at] = number as u32;
                    picture.missed[at] = missing[number];
                } else if depth <= picture.depth[at] + tie {
                    // Of two in one place either does.
                    picture.missed[at] &= missing[number];
                }
            });
        }
        for first in &picture.first {
            if let Some(seen) = seen.get_mut(*first as usize) {
                *seen = true;
            }
        }
        for (number, triangle) in triangles.iter().enumerate() {
            if !triangle.is_transparent {
                continue;
            }
            self.draw(triangle, |at, depth| {
                if depth < picture.depth[at] - tie {
                    seen[number] = true;
                    picture.missed[at] |= missing[number];
                    if picture.first[at] == u32::MAX {
                        picture.first[at] = number as u32;
                    }
                }
            });
        }
        picture
    }

    fn draw(&self, triangle: &Shown, mut pixel: impl FnMut(usize, f64)) {
        let [a, b, c] = triangle.corners.map(|corner| self.project(corner));
        let (u, v) = ((b - a).truncate(), (c - a).truncate());
        // Rows go down, so that what faces the eye is clockwise.
        let area = -u.perp_dot(v);
        if area == 0.0 || (area < 0.0 && !triangle.is_two_sided) {
            return;
        }
        let least = a.min(b).min(c).truncate();
        let greatest = a.max(b).max(c).truncate();
        let last = f64::from(self.size) - 1.0;
        let from = (least - 0.5).ceil().max(DVec2::ZERO);
        let to = (greatest - 0.5).floor().min(DVec2::splat(last));
        if from.x > to.x || from.y > to.y {
            return;
        }
        let depth_x = ((b.z - a.z) * v.y - (c.z - a.z) * u.y) / -area;
        let depth_y = ((c.z - a.z) * u.x - (b.z - a.z) * v.x) / -area;
        for y in from.y as u32..=to.y as u32 {
            for x in from.x as u32..=to.x as u32 {
                let at = UVec2::new(x, y).as_dvec2() + 0.5;
                let is_inside = [(a, b), (b, c), (c, a)].iter().all(|(from, to)| {
                    let side = (to - from).truncate().perp_dot(at - from.truncate());
                    side * -area >= 0.0
                });
                if is_inside {
                    let off = at - a.truncate();
                    let depth = a.z + off.x * depth_x + off.y * depth_y;
                    pixel((y * self.size + x) as usize, depth);
                }
            }
        }
    }

    /// Which way the eye looks. units: 1
    pub fn forward(&self) -> DVec3 {
        self.forward
    }

    /// Where the middles of balls of this radius begin, in front of everything, that move along with the ray of a pixel
    /// inside them; that of the first moves along the ray itself. `extent`: the model's size.
    pub fn balls(&self, at: usize, radius: f64, extent: f64) -> impl Iterator<Item = DVec3> {
        let (column, row) = (at as u32 % self.size, at as u32 / self.size);
        let half = f64::from(self.size) / 2.0;
        let middle = self.centre
            + self.right * ((f64::from(column) + 0.5 - half) * self.pixel)
            + self.up * ((half - f64::from(row) - 0.5) * self.pixel)
            - self.forward * (2.0 * extent + radius);
        let (right, up) = (self.right, self.up);
        // Evenly over the disc (Vogel 1979).
        (0..BALLS).map(move |i| {
            let off = radius * (f64::from(i) / f64::from(BALLS)).sqrt();
            let turn = DVec2::from_angle(f64::from(i) * GOLDEN) * off;
            middle + right * turn.x + up * turn.y
        })
    }

    /// A picture of what shows, lit from the eye, in the parts' own greys; what lacks in `bit` is red.
    pub fn shade(&self, triangles: &[Shown], picture: &Picture, bit: u64) -> image::RgbImage {
        image::RgbImage::from_fn(self.size, self.size, |x, y| {
            let at = (y * self.size + x) as usize;
            let Some(triangle) = triangles.get(picture.first[at] as usize) else {
                return image::Rgb([255; 3]);
            };
            let [a, b, c] = triangle.corners;
            let facing = (b - a)
                .cross(c - a)
                .normalize_or_zero()
                .dot(self.forward)
                .abs();
            let tone =
                0.75 + 0.25 * f64::from(triangle.part.wrapping_mul(0x9e37_79b9) >> 24) / 255.0;
            let grey = (40.0 + 200.0 * facing * tone) as u8;
            if picture.missed[at] & bit != 0 {
                image::Rgb([255, grey / 4, grey / 4])
            } else {
                image::Rgb([grey, grey, (f64::from(grey) * 1.06).min(255.0) as u8])
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wall(depth: f64, half: f64, is_transparent: bool, is_two_sided: bool) -> [Shown; 2] {
        // Faces −x, from where `eye` looks.
        let corner = |y: f64, z: f64| DVec3::new(depth, y * half, z * half);
        let [a, b, c, d] = [
            corner(-1.0, -1.0),
            corner(-1.0, 1.0),
            corner(1.0, 1.0),
            corner(1.0, -1.0),
        ];
        [[a, b, c], [a, c, d]].map(|corners| Shown {
            corners,
            part: 0,
            number: 0,
            is_transparent,
            is_two_sided,
        })
    }

    fn eye() -> View {
        View {
            right: DVec3::Z,
            up: DVec3::Y,
            forward: DVec3::X,
            centre: DVec3::ZERO,
            pixel: 0.1,
            size: 40,
            is_close: false,
        }
    }

    #[test]
    fn the_nearest_shows_and_what_is_behind_glass_shows_too() {
        let far = wall(1.0, 1.0, false, false);
        let near = wall(0.0, 0.5, false, false);
        let glass = wall(-1.0, 0.2, true, false);
        let triangles: Vec<_> = far.into_iter().chain(near).chain(glass).collect();
        let mut seen = vec![false; 6];
        let picture = eye().look(&triangles, &[1, 1, 2, 2, 4, 4], 1.0, &mut seen);
        assert!(seen.iter().all(|seen| *seen));
        let count = |bit| {
            picture
                .missed
                .iter()
                .filter(|missed| **missed & bit != 0)
                .count()
        };
        assert_eq!([count(1), count(2), count(4)], [400 - 100, 100, 16]);
    }

    #[test]
    fn what_is_behind_an_opaque_wall_or_turned_away_does_not_show() {
        let mut away = wall(0.0, 0.5, false, false);
        for triangle in &mut away {
            triangle.corners.swap(1, 2);
        }
        let triangles: Vec<_> = away
            .into_iter()
            .chain(wall(1.0, 1.0, false, false))
            .collect();
        let mut seen = vec![false; 4];
        eye().look(&triangles, &[0; 4], 1.0, &mut seen);
        assert_eq!(seen, [false, false, true, true]);
        let hidden: Vec<_> = wall(1.0, 0.5, false, false)
            .into_iter()
            .chain(wall(0.0, 1.0, false, true))
            .collect();
        let mut seen = vec![false; 4];
        eye().look(&hidden, &[0; 4], 1.0, &mut seen);
        assert_eq!(seen, [false, false, true, true]);
    }

    #[test]
    fn of_two_in_one_place_either_does() {
        let triangles: Vec<_> = wall(0.0, 1.0, false, false)
            .into_iter()
            .chain(wall(0.0, 1.0, false, false))
            .collect();
        let look = |missing: &[u64]| {
            let picture = eye().look(&triangles, missing, 1.0, &mut [false; 4]);
            picture.missed.iter().filter(|missed| **missed != 0).count()
        };
        assert_eq!(look(&[1, 1, 0, 0]), 0);
        assert_eq!(look(&[1, 1, 1, 1]), 400);
    }

    #[test]
    fn balls_move_along_with_a_pixel_s_ray_inside_them() {
        let view = eye();
        let balls: Vec<_> = view.balls(3 * 40 + 7, 2.0, 10.0).collect();
        assert_eq!(view.project(balls[0]), DVec3::new(7.5, 3.5, -22.0));
        for ball in &balls {
            let off = (view.project(*ball) - view.project(balls[0])).truncate();
            assert!(off.length() * view.pixel < 2.0);
        }
    }

    #[test]
    fn views_come_from_all_sides() {
        let views = around((-DVec3::ONE, DVec3::ONE), 500, 64);
        let mean: DVec3 = views.iter().map(|view| view.forward).sum::<DVec3>() / 500.0;
        assert!(mean.length() < 0.01);
        for view in &views {
            let frame = view.right.cross(view.up).dot(view.forward);
            assert!((frame + 1.0).abs() < 1e-9, "{frame}");
        }
    }
}
