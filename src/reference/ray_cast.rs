//! Twin of `ray_cast.wgsl`: one ray through a height field, cell by cell, in `f64`.
//!
//! It knows no pyramid, box or beam. All cells on a ray's way are visited in order, and over each of them the
//! ray's height above the surface is a quadratic in t, whose sign changes are found exactly. Height and sign
//! carry over from cell to cell, so no ray slips through between two.
//!
//! What is a hit: the first t ≥ 0 at which the ray has been in the air, and is at or below the surface within
//! the footprint. Outside the footprint all is air, down to the walls' endless foot.
//!
//! [`Twin::judge`] walks three surfaces at once: the exact one, one raised and one lowered by the
//! [guard](super::guard). What a correct `f32` ray casting takes for ground lies in the raised ground and
//! covers the lowered one; the same with air. So whatever it does, it cannot see a hit before the first t at which
//! the ray *may* have been in the air and *may* be in the ground, nor can it go on beyond the first t at which
//! the ray *must* have been in the air before and *must* be in the ground now.

use bevy::math::{DVec2, DVec3, UVec2, Vec2, Vec3Swizzles};

use super::{
    cell::Quadratic,
    guard::{RayMagnitude, Steepness, depth_error},
    outcome::outcome,
    surface::Surface,
};
use crate::terrain::{HeightField, view_rays::ViewRays};

/// A height field to cast rays through.
pub struct Twin<'a> {
    surface: Surface<'a>,
    /// Of the whole field, heights as stored.
    steepest: Steepness,
    lowest: f64,
    highest: f64,
}

/// Which part of the ground a ray came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The bilinear surface.
    Surface,
    /// A wall below the footprint's border.
    Wall,
}

/// Where a ray comes from the air to the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwinHit {
    /// Along the ray, in its own unit.
    pub t: f64,
    /// What it hits.
    pub part: Part,
    /// The cell it is in then.
    pub cell: UVec2,
}

/// What a correct `f32` ray casting may answer for one ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict {
    /// The hit, without rounding. units: m beyond `t_base`, as of the other two
    pub exact: Option<f64>,
    /// No hit may be nearer; `None`: there may be no hit.
    pub earliest: Option<f64>,
    /// There must be a hit, and no farther; `None`: there may be none.
    pub latest: Option<f64>,
}

/// Where in t a ray is over a footprint: closed, empty if the first is the larger.
type Window = (f64, f64);

/// A ray, its origin in the field's own grid space for x and z, and relative to the anchor for y.
struct Ray {
    origin: DVec3,
    direction: DVec3,
    anchor_y: f64,
}

/// Walks towards one of the three surfaces.
struct Search {
    /// Ground is where the ray is no higher than `side` times the guard; air, where it is higher than minus that.
    side: f64,
    /// When the ray is over the footprint.
    window: Window,
    /// Whether it has been in the air.
    air: bool,
    hit: Option<(f64, UVec2)>,
}

/// A ray's way through one cell.
struct Visit {
    cell: UVec2,
    /// When it begins.
    t: f64,
    /// How long it lasts; may be infinite.
    span: f64,
    /// The ray's height above the cell's surface, and how far that may be off, as functions of s = time since t.
    above: Quadratic,
    guard: Quadratic,
    /// The s for which the ray is in this cell beyond doubt.
    inner: Window,
}

impl Search {
    fn visit(&mut self, visit: &Visit) {
        let &Visit {
            cell,
            t,
            span,
            above,
            guard,
            inner,
        } = visit;
        let mut s = 0.0;
        if !self.air {
            let height = above.plus(self.side, guard);
            if height.c <= 0.0 {
                // What only begins at the far border is the next cell's to tell: it goes on otherwise there.
                let within = |&rise: &f64| rise < span || (rise == span && self.side > 0.0);
                let Some(rise) = height.first_rise().filter(within) else {
                    return;
                };
                // Where within one cell the lowered height is still below zero and the raised one already above,
                // whatever quadratic lies between has come up, once, and is not seen.
                let clean = if self.side == 0.0 {
                    Some((height, rise))
                } else if self.side > 0.0 && rise >= inner.0 {
                    let lower = above.plus(-self.side, guard);
                    let later = lower.from(rise).first_rise().map(|later| rise + later);
                    later
                        .filter(|&later| later < inner.1.min(span))
                        .map(|later| (lower, later))
                } else {
                    None
                };
                if let Some((height, rise)) = clean {
                    // Counted from the rise on, the height is b r + a r²: nothing is left of c but rounding.
                    let b = height.slope_at(rise);
                    if b <= 0.0 && height.a <= 0.0 {
                        return;
                    }
                    self.air = true;
                    if height.a < 0.0 {
                        let fall = rise + b / -height.a;
                        if fall <= span && t + fall <= self.window.1 {
                            self.hit = Some((t + fall, cell));
                        }
                    }
                    return;
                }
                s = rise;
            }
            self.air = true;
        }
        let from = s.max(self.window.0 - t);
        let to = span.min(self.window.1 - t);
        if from > to {
            return;
        }
        let height = above.plus(-self.side, guard).from(from);
        let fall = if height.c <= 0.0 {
            Some(0.0)
        } else {
            height.first_fall()
        };
        if let Some(fall) = fall.filter(|fall| from + fall <= to) {
            // Exactly the window's start where it is that: the wall.
            let t_hit = if fall == 0.0 {
                (t + s).max(self.window.0)
            } else {
                t + from + fall
            };
            self.hit = Some((t_hit, cell));
        }
    }
}

/// When all of k t ≥ m hold, for t ≥ 0.
fn when(conditions: impl IntoIterator<Item = (f64, f64)>) -> Window {
    let mut window = (0.0f64, f64::INFINITY);
    for (k, m) in conditions {
        if k > 0.0 {
            window.0 = window.0.max(m / k);
        } else if k < 0.0 {
            window.1 = window.1.min(m / k);
        } else if m > 0.0 {
            window.1 = f64::NEG_INFINITY;
        }
    }
    window
}

/// When `o + t d` lies between 0 and `size` along x and z, grown by `side` times `fixed + t growing`.
fn when_inside(
    o: DVec3,
    d: DVec3,
    size: DVec2,
    side: f64,
    (fixed, growing): (DVec3, DVec3),
) -> Window {
    let (grow, more) = (side * fixed, side * growing);
    when([
        (d.x + more.x, -o.x - grow.x),
        (more.x - d.x, o.x - size.x - grow.x),
        (d.z + more.z, -o.z - grow.z),
        (more.z - d.z, o.z - size.y - grow.z),
    ])
}

impl<'a> Twin<'a> {
    /// Looks at every sample once, for the steepest slope.
    pub fn new(field: &'a HeightField) -> Self {
        let surface = Surface::new(field.samples(), field.size());
        let (highest, lowest) = field.pyramid().top();
        Self {
            surface,
            steepest: surface.steepest(),
            lowest,
            highest,
        }
    }

    /// The first hit of a ray at 0 ≤ t ≤ `t_max`. `origin` and `direction` are in grid space, `origin` relative to
    /// `anchor`.
    pub fn cast(
        &self,
        origin: DVec3,
        direction: DVec3,
        anchor: DVec3,
        t_max: f64,
    ) -> Option<TwinHit> {
        let ray = Ray {
            origin: origin + DVec3::new(anchor.x, 0.0, anchor.z),
            direction,
            anchor_y: anchor.y,
        };
        let cells = self.surface.cells.as_dvec2();
        let window = when_inside(ray.origin, direction, cells, 0.0, Default::default());
        let mut search = [Search {
            side: 0.0,
            window,
            air: window.0 > 0.0,
            hit: None,
        }];
        self.walk(&ray, None, &mut search, window, t_max);
        search[0].hit.map(|(t, cell)| {
            let part = if t == window.0 && t > 0.0 {
                Part::Wall
            } else {
                Part::Surface
            };
            TwinHit { t, part, cell }
        })
    }

    /// What the GPU may see through `pixel` (its middle, from the viewport's top left corner) at 0 ≤ t < `t_max`.
    pub fn judge(&self, rays: &ViewRays, pixel: Vec2, t_max: f64) -> Verdict {
        let (origin, direction) = rays.ray(pixel);
        let anchor = rays.anchor.as_dvec2();
        let ray = Ray {
            origin: origin + DVec3::new(anchor.x, 0.0, anchor.y),
            direction,
            anchor_y: f64::from(rays.anchor_y),
        };
        let size = RayMagnitude::new(rays, pixel);
        let error = size.position_error();
        let cells = self.surface.cells.as_dvec2();
        let [shrunk, exact, grown] =
            [-1.0, 0.0, 1.0].map(|side| when_inside(ray.origin, direction, cells, side, error));
        let inside = |window: Window| window.0 <= 0.0 && window.1 >= 0.0;
        let mut searches = [
            Search {
                side: 0.0,
                window: exact,
                air: !inside(exact),
                hit: None,
            },
            Search {
                side: 1.0,
                window: grown,
                air: !inside(shrunk),
                hit: None,
            },
            Search {
                side: -1.0,
                window: shrunk,
                air: !inside(grown),
                hit: None,
            },
        ];
        let undecided = self.walk(&ray, Some(&size), &mut searches, grown, t_max);
        let [exact, mut earliest, mut latest] = searches.map(|search| search.hit.map(|(t, _)| t));
        if let Some(t) = undecided {
            // Rounding reaches beyond the next cell from here on: nothing can be told.
            earliest = Some(earliest.map_or(t, |earliest| earliest.min(t)));
            latest = None;
        }
        // A hit so near the far plane that its depth may round to the sky's need not be told from it.
        let latest = latest.filter(|&t| depth_error(rays, t).1);
        Verdict {
            exact,
            earliest,
            latest,
        }
    }

    /// Visits the cells on the ray's way within `window`, those nearest for where it is beside the footprint.
    /// Returns where rounding becomes too large to know even the cell's neighbours, if the walk came there.
    fn walk(
        &self,
        ray: &Ray,
        size: Option<&RayMagnitude>,
        searches: &mut [Search],
        window: Window,
        t_max: f64,
    ) -> Option<f64> {
        let (o, d) = (ray.origin, ray.direction);
        let end = window.1.min(t_max);
        let mut t = window.0.max(0.0);
        let comes_in_time = t <= end;
        if !comes_in_time || !end.is_finite() && d == DVec3::ZERO {
            return None;
        }
        let last = self.surface.cells - 1;
        let start = (o + t * d).xz().floor().clamp(DVec2::ZERO, last.as_dvec2());
        let mut cell = start.as_uvec2();
        let steepest = Steepness {
            height: (self.highest - ray.anchor_y)
                .abs()
                .max((self.lowest - ray.anchor_y).abs()),
            ..self.steepest
        };
        let (low, high) = (self.lowest - ray.anchor_y, self.highest - ray.anchor_y);
        loop {
            let border = |o: f64, d: f64, cell: u32, last: u32| {
                if d > 0.0 && cell < last {
                    (f64::from(cell + 1) - o) / d
                } else if d < 0.0 && cell > 0 {
                    (f64::from(cell) - o) / d
                } else {
                    f64::INFINITY
                }
            };
            let leave_x = border(o.x, d.x, cell.x, last.x);
            let leave_z = border(o.z, d.z, cell.y, last.y);
            let t_out = leave_x.min(leave_z).min(end).max(t);
            let span = t_out - t;

            // Far enough from this cell's surface, and on the known side of it, to pass it by?
            let any_air = searches
                .iter()
                .any(|search| search.hit.is_none() && search.air);
            let any_ground = searches
                .iter()
                .any(|search| search.hit.is_none() && !search.air);
            let y = o.y + t * d.y;
            let y_out = if span.is_finite() {
                o.y + t_out * d.y
            } else {
                d.y * f64::INFINITY
            };
            let worst = size.map_or(0.0, |size| {
                let guard = size.guard(&steepest, t, span).at(span);
                if guard.is_finite() {
                    2.0 * guard
                } else {
                    f64::INFINITY
                }
            });
            let patch = self.surface.patch(cell, ray.anchor_y);
            let above = y.min(y_out) > patch.max() + worst;
            let below = y.max(y_out) < patch.min() - worst;
            if (any_air || !below) && (any_ground || !above) {
                let guard = size.map_or(Quadratic::default(), |size| {
                    size.guard(&self.surface.steepness(cell, ray.anchor_y), t, span)
                });
                let at = o + t * d;
                let corner = cell.as_dvec2();
                let from = DVec3::new(at.x - corner.x, at.y, at.z - corner.y);
                let visit = Visit {
                    cell,
                    t,
                    span,
                    above: patch.above(from.to_array(), d.to_array()),
                    guard,
                    inner: match size {
                        Some(size) if any_ground => {
                            let (fixed, growing) = size.position_error();
                            when_inside(from, d, DVec2::ONE, -1.0, (fixed + t * growing, growing))
                        }
                        _ => (f64::INFINITY, 0.0),
                    },
                };
                for search in searches.iter_mut().filter(|search| search.hit.is_none()) {
                    search.visit(&visit);
                }
                if searches.iter().all(|search| search.hit.is_some()) {
                    return None;
                }
            }
            if t_out >= end {
                return None;
            }
            t = t_out;
            if let Some(size) = size {
                let (fixed, growing) = size.position_error();
                let error = fixed + growing * t;
                if error.x.max(error.z) >= 0.5 {
                    return Some(t);
                }
            }
            // Out of reach for good?
            if d.y >= 0.0 && y_out > high + worst || d.y <= 0.0 && !any_air && y_out < low - worst {
                return None;
            }
            if leave_x <= leave_z {
                cell.x = if d.x > 0.0 { cell.x + 1 } else { cell.x - 1 };
            } else {
                cell.y = if d.z > 0.0 { cell.y + 1 } else { cell.y - 1 };
            }
        }
    }

    /// How far a hit at t is from the exact ground, in pixels: straight up or down to the surface, or sideways to the
    /// wall if that is nearer. Infinite behind the camera.
    pub fn displacement_px(&self, rays: &ViewRays, pixel: Vec2, t: f64) -> f64 {
        let (o, d) = rays.ray(pixel);
        let point = o + t * d;
        let anchor = rays.anchor.as_dvec2();
        let cells = self.surface.cells.as_dvec2();
        let at = (point.xz() + anchor).clamp(DVec2::ZERO, cells);
        let height = |at: DVec2| {
            let cell = at.floor().min(cells - 1.0);
            let part = at - cell;
            self.surface
                .patch(cell.as_uvec2(), f64::from(rays.anchor_y))
                .height(part.x, part.y)
        };
        let clip_from_grid = rays.clip_from_grid.as_dmat4();
        let project = |grid: DVec3| {
            let clip = clip_from_grid * grid.extend(1.0);
            let px = 0.5 * rays.size_px.as_dvec2() / clip.w;
            (clip.w > 0.0).then_some(DVec2::new(clip.x, clip.y) * px)
        };
        let distance = |other: DVec3| match (project(point), project(other)) {
            (Some(a), Some(b)) => a.distance(b),
            _ => f64::INFINITY,
        };
        let grid = |at: DVec2, y: f64| DVec3::new(at.x - anchor.x, y, at.y - anchor.y);
        let walls = [
            DVec2::new(0.0, at.y),
            DVec2::new(cells.x, at.y),
            DVec2::new(at.x, 0.0),
            DVec2::new(at.x, cells.y),
        ];
        walls
            .into_iter()
            .filter(|&wall| point.y <= height(wall))
            .map(|wall| distance(grid(wall, point.y)))
            .fold(distance(grid(at, height(at))), f64::min)
    }
}

/// The GPU's answers to many rays, held against the twin's.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Rays that had to hit, and did, where they should.
    pub hits: usize,
    /// Rays that had to miss, and did.
    pub misses: usize,
    /// Rays inside the guard band, either answer being legal.
    pub in_band: usize,
    /// Rays whose answer no correct rounding explains.
    pub wrong: Vec<Wrong>,
}

/// One ray's wrong answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrong {
    /// Middle of the pixel.
    pub pixel: Vec2,
    /// What would have been right.
    pub verdict: Verdict,
    /// What came instead; `None` for the sky.
    pub t: Option<f64>,
    /// How far t may be off because it came as NDC depth.
    pub tolerance: f64,
}

impl Tally {
    /// Counts one ray. `ndc_depth` is as the GPU wrote it, 0 for the sky. Returns whether it is legal.
    pub fn check(
        &mut self,
        rays: &ViewRays,
        pixel: Vec2,
        verdict: Verdict,
        ndc_depth: f32,
    ) -> bool {
        if ndc_depth.is_nan() || ndc_depth <= 0.0 {
            let legal = verdict.latest.is_none() && ndc_depth == 0.0;
            match (legal, verdict.earliest) {
                (false, _) => {
                    self.wrong.push(Wrong {
                        pixel,
                        verdict,
                        t: None,
                        tolerance: 0.0,
                    });
                }
                (true, None) => self.misses += 1,
                (true, Some(_)) => self.in_band += 1,
            }
            return legal;
        }
        let t = rays.view_depth(ndc_depth) - f64::from(rays.t_base);
        let tolerance = depth_error(rays, t).0;
        let legal = verdict
            .earliest
            .is_some_and(|earliest| t >= earliest - tolerance)
            && verdict.latest.is_none_or(|latest| t <= latest + tolerance);
        if !legal {
            self.wrong.push(Wrong {
                pixel,
                verdict,
                t: Some(t),
                tolerance,
            });
        } else if verdict.latest.is_some() {
            self.hits += 1;
        } else {
            self.in_band += 1;
        }
        legal
    }

    /// All rays counted.
    pub fn rays(&self) -> usize {
        self.hits + self.misses + self.in_band + self.wrong.len()
    }

    /// Adds another's counts.
    pub fn merge(&mut self, other: Self) {
        self.hits += other.hits;
        self.misses += other.misses;
        self.in_band += other.in_band;
        self.wrong.extend(other.wrong);
    }

    /// # Errors
    /// In words, if any answer was wrong, if no ray was decided, or if more than this fraction of the rays was in
    /// the guard band, where hardly anything is wrong.
    pub fn verdict(&self, max_in_band_fraction: f64) -> Result<(), String> {
        outcome(
            "rays",
            &self.wrong,
            self.hits + self.misses,
            self.in_band,
            max_in_band_fraction,
        )
    }

    /// Panics with [`verdict`](Self::verdict)'s words.
    ///
    /// # Panics
    /// For tests: if the comparison failed, or compared too little.
    #[track_caller]
    pub fn assert_ok(&self, max_in_band_fraction: f64) {
        if let Err(why) = self.verdict(max_in_band_fraction) {
            panic!("{why}");
        }
    }
}
