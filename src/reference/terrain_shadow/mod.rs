//! Twin of the terrain's shadow rays: from each sample to the light, cell by cell, in `f64`.
//!
//! It knows no pyramid and no slices. A sample (i, j) of height h stands at (i, h, j), *on* the surface; all
//! cells on its ray's way to the light are visited in order, and over each of them the ray's height above the surface
//! is a quadratic in t, of which it is known exactly whether it is negative anywhere.
//!
//! What is a shadow: some part of the ray, before the light and within the footprint, lies strictly below the surface.
//! Outside of the footprint all is air; the ground goes down without end. A ray straight up or down is lit unless
//! the light is below the sample.
//!
//! [`ShadowTwin::judge`] asks the same of the surface lowered and raised by the `guard`. What a correct `f32` ray
//! finds in its way lies in the raised ground and covers the lowered one: so a sample must be dark if even the lowered
//! ground is in the way, and must be lit if not even the raised one is. Where the guard is zero, as over flat ground
//! with the sun on the horizon, a ray of height zero is lit without a doubt.

pub(crate) mod guard;
mod tally;

use bevy::math::{DVec2, DVec3, UVec2};

use self::guard::ShadowGuard;
pub use self::tally::{ShadowTally, WrongTexel};
use super::{cell::Quadratic, guard::Steepness, surface::Surface};
use crate::{
    precision::UNIT_ROUNDOFF,
    terrain::HeightSamples,
    terrain_shadow::light::{GridLight, LightRay, LightSource, STILL, strip_above},
};

/// A height field whose shadows are to be known.
pub struct ShadowTwin<'a> {
    surface: Surface<'a>,
    /// Of the whole field.
    steepest: Steepness,
    highest: f64,
    lowest: f64,
}

/// What a correct `f32` shadow ray may answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ShadowVerdict {
    /// That the sample sees the light.
    Lit,
    /// That it doesn't.
    Dark,
    /// Either: rounding decides.
    InBand,
}

/// A cell on a ray's way.
#[derive(Clone, Copy, Debug)]
struct Crossing {
    cell: UVec2,
    /// When the ray comes into it; 0 for the first alone.
    t: f64,
    t_out: f64,
}

/// The cells on a ray's way, in order, until `end`. Beside the footprint, those nearest.
struct Crossings {
    next: Option<Crossing>,
    ray: LightRay,
    sample: UVec2,
    last: UVec2,
    end: f64,
}

/// Whether a ray comes below the lowered surface and below the raised one.
struct Found {
    lowered: bool,
    raised: bool,
}

impl Crossings {
    fn new(ray: &LightRay, sample: UVec2, cells: UVec2, end: f64) -> Self {
        let last = cells - 1;
        let first = |d: f64, sample: u32, last: u32| {
            if d < 0.0 {
                sample.saturating_sub(1)
            } else {
                sample.min(last)
            }
        };
        let mut crossings = Self {
            next: None,
            ray: *ray,
            sample,
            last,
            end,
        };
        let cell = UVec2::new(
            first(ray.direction.x, sample.x, last.x),
            first(ray.direction.z, sample.y, last.y),
        );
        let (leave_x, leave_z) = crossings.leave(cell);
        crossings.next = Some(Crossing {
            cell,
            t: 0.0,
            t_out: leave_x.min(leave_z).min(end),
        });
        crossings
    }

    /// When the ray comes to the next column and to the next row.
    fn leave(&self, cell: UVec2) -> (f64, f64) {
        let leave = |d: f64, sample: u32, cell: u32, last: u32| {
            if d > 0.0 && cell < last {
                f64::from(cell + 1 - sample) / d
            } else if d < 0.0 && cell > 0 {
                f64::from(sample - cell) / -d
            } else {
                f64::INFINITY
            }
        };
        let d = self.ray.direction;
        (
            leave(d.x, self.sample.x, cell.x, self.last.x),
            leave(d.z, self.sample.y, cell.y, self.last.y),
        )
    }
}

impl Iterator for Crossings {
    type Item = Crossing;

    fn next(&mut self) -> Option<Crossing> {
        let now = self.next?;
        self.next = (now.t_out < self.end).then(|| {
            let d = self.ray.direction;
            let mut cell = now.cell;
            let (leave_x, leave_z) = self.leave(cell);
            if leave_x <= now.t_out {
                cell.x = if d.x > 0.0 { cell.x + 1 } else { cell.x - 1 };
            }
            if leave_z <= now.t_out {
                cell.y = if d.z > 0.0 { cell.y + 1 } else { cell.y - 1 };
            }
            let (leave_x, leave_z) = self.leave(cell);
            Crossing {
                cell,
                t: now.t_out,
                t_out: leave_x.min(leave_z).min(self.end).max(now.t_out),
            }
        });
        Some(now)
    }
}

/// Whether the polynomial is negative anywhere from 0 to `span`.
fn dips(height: Quadratic, span: f64) -> bool {
    let Quadratic { c, b, a } = height;
    c < 0.0
        || height.at(span) < 0.0
        || (a > 0.0 && b < 0.0 && -b < 2.0 * a * span && b * b > 4.0 * a * c)
}

impl<'a> ShadowTwin<'a> {
    /// Looks at every sample once, for the steepest slope. `size` is in samples.
    pub fn new(samples: &'a HeightSamples, size: UVec2) -> Self {
        let surface = Surface::new(samples, size);
        let (lowest, highest) = surface.range();
        Self {
            surface,
            steepest: surface.steepest(),
            highest,
            lowest,
        }
    }

    /// Where a sample stands. units: grid
    pub fn place(&self, sample: UVec2) -> DVec3 {
        let height = self.surface.height(sample.x as usize, sample.y as usize);
        DVec3::new(f64::from(sample.x), height, f64::from(sample.y))
    }

    /// Whether a sample sees the light, without rounding. What touches the ray within the last few bits of `f64`
    /// isn't in its way.
    pub fn lit(&self, light: &GridLight, sample: UVec2) -> bool {
        let from = self.place(sample);
        match light.ray(from) {
            None => light.to_light(from).y >= 0.0,
            Some(ray) => {
                let guard = ShadowGuard::of_f64(&ray);
                !self.search(&ray, sample, &guard).lowered
            }
        }
    }

    /// What a correct `f32` shadow casting may answer.
    pub fn judge(&self, light: &GridLight, sample: UVec2) -> ShadowVerdict {
        let from = self.place(sample);
        if let Some(verdict) = self.judge_upright(light, sample) {
            return verdict;
        }
        let Some(ray) = light.ray(from) else {
            return if light.to_light(from).y >= 0.0 {
                ShadowVerdict::Lit
            } else {
                ShadowVerdict::Dark
            };
        };
        let guard = ShadowGuard::of_f32(light, from, &ray);
        match self.search(&ray, sample, &guard) {
            Found { lowered: true, .. } => ShadowVerdict::Dark,
            Found { raised: true, .. } => ShadowVerdict::InBand,
            _ => ShadowVerdict::Lit,
        }
    }

    /// What may be answered where a point light is so nearly straight above or below that `f32` doesn't know
    /// which way the ray leans, or whether.
    fn judge_upright(&self, light: &GridLight, sample: UVec2) -> Option<ShadowVerdict> {
        let LightSource::Point(position) = light.source else {
            return None;
        };
        let from = self.place(sample);
        let way = light.to_light(from);
        // What hi + lo don't reach, of components that are not zero.
        let error = DVec3::from_array([0, 1, 2].map(|axis| {
            let exact = way[axis] == 0.0;
            let unknown = 4.0 * UNIT_ROUNDOFF * UNIT_ROUNDOFF * position[axis].abs();
            if exact { 0.0 } else { unknown }
        }));
        let reach = way.x.abs().max(way.z.abs());
        let leans = reach > 2.0 * STILL * way.y.abs() && reach > 256.0 * error.x.max(error.z);
        if leans {
            return None;
        }
        // On its way up the ray rises evenly, and the ground no more than this.
        let aside = way.abs() + error;
        let ground = 2.0 * (self.steepest.x * aside.x + self.steepest.z * aside.z);
        let unsure = error.y + 8.0 * UNIT_ROUNDOFF * way.y.abs();
        let last = self.surface.cells;
        let on_border = sample.cmpeq(UVec2::ZERO).any() || sample.cmpeq(last).any();
        Some(if way.y - unsure >= ground {
            ShadowVerdict::Lit
        } else if way.y + unsure < -ground && (!on_border || reach == 0.0) {
            ShadowVerdict::Dark
        } else {
            ShadowVerdict::InBand
        })
    }

    /// When a ray leaves the footprint if that is grown by `sideways` t.
    fn leaves(&self, ray: &LightRay, sample: UVec2, sideways: DVec2) -> f64 {
        let axis = |d: f64, grow: f64, before: u32, after: u32| {
            let room = |rate: f64, room: u32| {
                if rate > 0.0 {
                    f64::from(room) / rate
                } else {
                    f64::INFINITY
                }
            };
            room(d - grow, after).min(room(-d - grow, before))
        };
        let (d, cells) = (ray.direction, self.surface.cells);
        axis(d.x, sideways.x, sample.x, cells.x - sample.x).min(axis(
            d.z,
            sideways.y,
            sample.y,
            cells.y - sample.y,
        ))
    }

    /// A ray from a sample, against the surface lowered and raised.
    fn search(&self, ray: &LightRay, sample: UVec2, guard: &ShadowGuard) -> Found {
        let mut found = Found {
            lowered: false,
            raised: false,
        };
        let d = ray.direction;
        let from = self.place(sample);
        let sideways = guard.sideways();
        // From here on not even the cell's neighbours are known.
        let known = 0.5 / sideways.max_element();
        let inside = self.leaves(ray, sample, -sideways).min(ray.t_end);
        let near = self.leaves(ray, sample, sideways).min(ray.t_end);
        let (inside, end) = (inside.min(known), near.min(known));

        let high = self.highest - from.y;
        let worst = guard.anywhere(&Steepness {
            height: high.max(from.y - self.lowest),
            ..self.steepest
        });
        let out_of_reach = high + worst.at(end);
        for Crossing { cell, t, t_out } in Crossings::new(ray, sample, self.surface.cells, end) {
            let (y, y_out) = (t * d.y, t_out * d.y);
            let patch = self.surface.patch(cell, from.y);
            if y.min(y_out) <= patch.max() + worst.at(t_out) {
                let corner = cell.as_dvec2();
                let at = [
                    t * d.x - (corner.x - from.x),
                    y,
                    t * d.z - (corner.y - from.z),
                ];
                let mut above = patch.above(at, d.to_array());
                if t == 0.0 {
                    above.c = 0.0;
                }
                let guard = guard.over_cell(&self.surface.steepness(cell, from.y), t);
                let sure = t_out.min(inside) - t;
                if sure >= 0.0 && dips(above.plus(1.0, guard), sure) {
                    found.lowered = true;
                    return found;
                }
                found.raised |= dips(above.plus(-1.0, guard), t_out - t);
            }
            if d.y >= 0.0 && y_out > out_of_reach {
                break;
            }
        }
        found.raised |= known < near;
        found
    }

    /// The share of the light's disc that a sample sees, the disc cut into upright strips of equal width, each
    /// with the horizon along its middle. A light of no size is seen or not.
    pub fn visible_share(&self, light: &GridLight, sample: UVec2, strips: u32) -> f64 {
        let from = self.place(sample);
        if light.radius == 0.0 {
            return if self.lit(light, sample) { 1.0 } else { 0.0 };
        }
        let disc = light.disc(from);
        let area = |(from, to): (f64, f64)| {
            let primitive = |a: f64| a * (1.0 - a * a).max(0.0).sqrt() + a.asin();
            primitive(to) - primitive(from)
        };
        let seen = (0..strips).map(|k| {
            let alpha = |k: f64| 2.0 * k / f64::from(strips) - 1.0;
            let k = f64::from(k);
            let strip = (alpha(k), alpha(k + 1.0));
            let middle = disc.centre + alpha(k + 0.5) * disc.right;
            let share = self.strip_share(light, sample, middle, disc.up, strip);
            area(strip) * share
        });
        seen.sum::<f64>() / core::f64::consts::PI
    }

    /// The share of one strip that lies above the horizon; its points are `middle + β up`.
    fn strip_share(
        &self,
        light: &GridLight,
        sample: UVec2,
        middle: DVec3,
        up: DVec3,
        strip: (f64, f64),
    ) -> f64 {
        let from = self.place(sample);
        let toward = match light.source {
            LightSource::Directional(_) => LightSource::Directional(middle),
            LightSource::Point(_) => LightSource::Point(from + middle),
        };
        let toward = GridLight {
            source: toward,
            ..*light
        };
        let Some(ray) = toward.ray(from) else {
            return if middle.y >= 0.0 { 1.0 } else { 0.0 };
        };
        let Some(slope) = self.horizon(&ray, sample) else {
            return 1.0;
        };
        let ahead = |v: DVec3| {
            if ray.direction.x.abs() >= ray.direction.z.abs() {
                v.x * ray.direction.x.signum()
            } else {
                v.z * ray.direction.z.signum()
            }
        };
        // At β the strip is higher than the horizon by `clear + β rise`.
        let rise = up.y - slope * ahead(up);
        let clear = middle.y - slope * ahead(middle);
        if rise <= 0.0 {
            // `up` leans forward, the light being below, and even β = ∞ is below a horizon this high; or it leans
            // back, and even β = −∞ is above one this low; or the light is straight above or below. The middle
            // tells which.
            return if clear >= 0.0 { 1.0 } else { 0.0 };
        }
        strip_above(-clear / rise, strip)
    }

    /// The steepest way from a sample to the surface under its ray, in height per unit of t; `None` if there is
    /// none under it.
    pub fn horizon(&self, ray: &LightRay, sample: UVec2) -> Option<f64> {
        let from = self.place(sample);
        let level = DVec3::new(ray.direction.x, 0.0, ray.direction.z);
        let end = self.leaves(ray, sample, DVec2::ZERO).min(ray.t_end);
        if end <= 0.0 {
            return None;
        }
        let highest = self.highest - from.y;
        let mut steepest = f64::NEG_INFINITY;
        for Crossing { cell, t, t_out } in Crossings::new(ray, sample, self.surface.cells, end) {
            if highest <= steepest * t {
                break;
            }
            let corner = cell.as_dvec2();
            let at = [
                t * level.x - (corner.x - from.x),
                0.0,
                t * level.z - (corner.y - from.z),
            ];
            let below = self.surface.patch(cell, from.y).above(at, level.to_array());
            steepest = steepest.max(steepest_way(below, t, t_out));
        }
        Some(steepest)
    }
}

/// Largest slope from the origin to the surface at t ≤ T ≤ `t_out`, which lies `-below` high, s = T − t.
fn steepest_way(below: Quadratic, t: f64, t_out: f64) -> f64 {
    let slope = |s: f64| -below.at(s) / (t + s);
    if t == 0.0 {
        // c = 0: the slope is that of b s + a s² over s.
        return (-below.b).max(-(below.b + t_out * below.a));
    }
    // The height is A + B T + C T², the slope A / T + B + C T: highest in between only where A, C < 0.
    let from_start = below.from(-t);
    let (a, c) = (-from_start.c, -from_start.a);
    let ends = slope(0.0).max(slope(t_out - t));
    if a < 0.0 && c < 0.0 {
        let middle = (a / c).sqrt();
        if t < middle && middle < t_out {
            return ends.max(slope(middle - t));
        }
    }
    ends
}
