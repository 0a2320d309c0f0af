//! Exact questions to the surface from the CPU: its height and normal at a point, and what a ray
//! meets first. For placing objects, picking and collision.

use bevy::{
    asset::Assets,
    ecs::{
        entity::Entity,
        system::{Query, Res, SystemParam},
    },
    math::{DAffine3, DVec2, DVec3, Ray3d, UVec2, Vec2, Vec3, Vec3Swizzles},
    reflect::Reflect,
    transform::components::GlobalTransform,
};

use super::{Terrain, height_field::HeightField};

/// What a ray met, in the local space of a [`HeightField`], in metres.
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
pub struct HeightFieldHit {
    /// Distance from the ray's origin.
    pub distance: f32,
    /// Where.
    pub point: Vec3,
    /// Unit normal, on the air's side.
    pub normal: Vec3,
    /// The cell that was hit; on a border between cells, one of them.
    pub cell: UVec2,
    /// The surface, or a wall below its border.
    pub side: HitSide,
}

/// [`HeightFieldHit`] in double precision, as it was computed.
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
pub struct HeightFieldHitF64 {
    /// Distance from the ray's origin.
    pub distance: f64,
    /// Where.
    pub point: DVec3,
    /// Unit normal, on the air's side.
    pub normal: DVec3,
    /// The cell that was hit; on a border between cells, one of them.
    pub cell: UVec2,
    /// The surface, or a wall below its border.
    pub side: HitSide,
}

/// Which part of the solid ground a ray met.
#[derive(Reflect, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HitSide {
    /// The bilinear surface, from above.
    Surface,
    /// A wall straight down from the field's border, from outside.
    Wall,
}

/// What a ray met in the world.
#[derive(Reflect, Clone, Copy, Debug, PartialEq)]
pub struct TerrainHit {
    /// The terrain.
    pub entity: Entity,
    /// Distance from the ray's origin.
    pub distance: f32,
    /// Where.
    pub point: Vec3,
    /// Unit normal, on the air's side.
    pub normal: Vec3,
    /// The cell that was hit; on a border between cells, one of them.
    pub cell: UVec2,
    /// The surface, or a wall below its border.
    pub side: HitSide,
}

impl From<HeightFieldHitF64> for HeightFieldHit {
    fn from(hit: HeightFieldHitF64) -> Self {
        Self {
            distance: hit.distance as f32,
            point: hit.point.as_vec3(),
            normal: hit.normal.as_vec3(),
            cell: hit.cell,
            side: hit.side,
        }
    }
}

/// Queries in local space (see [`HeightField`]): exact, in double precision inside, without
/// allocating.
impl HeightField {
    /// The surface's height in metres at `(x, z)` metres, or `None` outside the footprint. The
    /// border belongs to the footprint, [`extent_m`](Self::extent_m) included as it is rounded.
    ///
    /// At a sample it is the sample's height, to within the rounding to `f32`.
    pub fn height_at(&self, local_xz: Vec2) -> Option<f32> {
        let inside = self.inside(local_xz)?;
        Some(self.grid_to_metres_at(inside) as f32)
    }

    /// [`height_at`](Self::height_at) in double precision: exactly
    /// [`sample_m`](Self::sample_m) at a sample.
    pub fn height_at_f64(&self, local_xz: DVec2) -> Option<f64> {
        let grid = self.inside_f64(local_xz)?;
        Some(self.grid_to_metres_at(grid))
    }

    /// The unit normal of the surface at `(x, z)` metres, or `None` outside the footprint.
    ///
    /// The surface has creases between cells: there it is the normal of the cell with the larger
    /// column and row.
    pub fn normal_at(&self, local_xz: Vec2) -> Option<Vec3> {
        let grid = self.inside(local_xz)?;
        Some(self.patch_at(grid).normal(self, grid).as_vec3())
    }

    /// [`normal_at`](Self::normal_at) in double precision.
    pub fn normal_at_f64(&self, local_xz: DVec2) -> Option<DVec3> {
        let grid = self.inside_f64(local_xz)?;
        Some(self.patch_at(grid).normal(self, grid))
    }

    /// The first point within `max_distance` metres where a ray meets the ground from the air.
    ///
    /// That is where its height above the surface goes from above zero to zero or below, or where
    /// it comes into the footprint from outside at the surface or below it: a wall. The ground is
    /// one-sided: a ray that starts in it, or on it, meets nothing until it has come out into the
    /// air; a ray that touches the surface and leaves it again upward has met it.
    ///
    /// `direction` may have any length. `None` also for a zero direction, for a distance below
    /// zero or NaN (infinity is allowed), and for anything else that is not finite.
    ///
    /// # Limits
    /// Computed in double precision from the roots of the exact quadratic. A ray that comes within
    /// a few rounding errors (about 10⁻¹⁵ of the coordinates and heights involved, all in metres)
    /// of touching the surface may be told either way; one that comes out of the ground by less
    /// than that is taken to stay in it. A ray started at a point returned in `f32` starts up to an
    /// `f32` rounding error above or below the surface: move such a start along the normal.
    pub fn ray_cast(
        &self,
        origin: Vec3,
        direction: Vec3,
        max_distance: f32,
    ) -> Option<HeightFieldHit> {
        self.ray_cast_f64(
            origin.as_dvec3(),
            direction.as_dvec3(),
            f64::from(max_distance),
        )
        .map(Into::into)
    }

    /// [`ray_cast`](Self::ray_cast) in double precision.
    pub fn ray_cast_f64(
        &self,
        origin: DVec3,
        direction: DVec3,
        max_distance: f64,
    ) -> Option<HeightFieldHitF64> {
        let direction = unit(direction)?;
        self.ray_cast_scaled(origin, direction, max_distance)
    }

    /// The cast itself: `direction` is not normalised, and distances are in units of its length.
    fn ray_cast_scaled(
        &self,
        origin: DVec3,
        direction: DVec3,
        max_distance: f64,
    ) -> Option<HeightFieldHitF64> {
        if !(origin.is_finite() && direction.is_finite() && max_distance >= 0.0) {
            return None;
        }
        let texel_m = f64::from(self.texel_m());
        let cells = self.cells().as_dvec2();
        let (o, d) = (
            DVec3::new(origin.x / texel_m, origin.y, origin.z / texel_m),
            DVec3::new(direction.x / texel_m, direction.y, direction.z / texel_m),
        );

        // The part of the ray over the footprint.
        let (x_in, x_out) = slab(o.x, d.x, cells.x)?;
        let (z_in, z_out) = slab(o.z, d.z, cells.y)?;
        let enter = x_in.max(z_in).max(0.0);
        let leave = x_out.min(z_out).min(max_distance);
        if enter > leave {
            return None;
        }
        let start = o + d * enter;
        let start = DVec3::new(
            start.x.clamp(0.0, cells.x),
            start.y,
            start.z.clamp(0.0, cells.y),
        );

        let clearance = start.y - self.grid_to_metres_at(start.xz());
        let mut above = clearance > 0.0;
        let (t, cell, side) = if enter > 0.0 && !above {
            (enter, self.patch_at(start.xz()).cell, HitSide::Wall)
        } else if d.x == 0.0 && d.z == 0.0 {
            // Straight down it is the clearance; straight up it never comes back.
            let t = clearance / -d.y;
            if !(above && d.y < 0.0 && t <= max_distance) {
                return None;
            }
            (t, self.patch_at(start.xz()).cell, HitSide::Surface)
        } else {
            let leave = leave - enter;
            // Below everything or above everything, and going on so, there is nothing to meet.
            let (low, high) = self.data_range_m();
            let margin = 1.0 + 1e-6 * (low.abs() + high.abs() + start.y.abs()) + (high - low);
            let beyond = match d.y {
                y if y < 0.0 => (low - margin - start.y) / y,
                y if y > 0.0 => (high + margin - start.y) / y,
                _ => f64::INFINITY,
            };
            let walk = Walk {
                field: self,
                o: start,
                d,
                end: leave.min(beyond),
            };
            let (t, cell) = walk.first_hit(&mut above)?;
            (enter + t, cell, HitSide::Surface)
        };

        let point = origin + direction * t;
        let normal = match side {
            HitSide::Surface => {
                let grid = DVec2::new(point.x / texel_m, point.z / texel_m);
                Patch::new(self, cell).normal(self, grid)
            }
            // Outward, against the ray, on the axis whose slab was entered last.
            HitSide::Wall if x_in >= z_in => DVec3::new(-d.x.signum(), 0.0, 0.0),
            HitSide::Wall => DVec3::new(0.0, 0.0, -d.z.signum()),
        };
        Some(HeightFieldHitF64 {
            distance: t,
            point,
            normal,
            cell,
            side,
        })
    }

    /// Metres → cells, if inside the footprint.
    fn inside_f64(&self, local_xz: DVec2) -> Option<DVec2> {
        let grid = local_xz / f64::from(self.texel_m());
        let cells = self.cells().as_dvec2();
        // The second comparison forgives the rounding of the division.
        let extent = cells * f64::from(self.texel_m());
        let inside =
            local_xz.cmpge(DVec2::ZERO).all() && (grid.cmple(cells) | local_xz.cmple(extent)).all();
        inside.then(|| grid.min(cells))
    }

    /// Metres → cells, if inside the footprint as `extent_m` rounds it.
    fn inside(&self, local_xz: Vec2) -> Option<DVec2> {
        let inside = local_xz.cmpge(Vec2::ZERO).all() && local_xz.cmple(self.extent_m()).all();
        let grid = local_xz.as_dvec2() / f64::from(self.texel_m());
        inside.then(|| grid.min(self.cells().as_dvec2()))
    }

    /// The surface's height in metres at a point in cells. At a sample it is exactly the sample's.
    fn grid_to_metres_at(&self, grid: DVec2) -> f64 {
        self.patch_at(grid).height_m(self, grid)
    }

    /// The cell that a point in cells lies in; on a border, the one after it if there is one.
    fn patch_at(&self, grid: DVec2) -> Patch {
        let last = self.cells() - UVec2::ONE;
        // `as` saturates, so that a rounding error below zero is the first cell.
        let cell = UVec2::new(grid.x as u32, grid.y as u32).min(last);
        Patch::new(self, cell)
    }
}

/// One cell's bilinear patch, by its corners' stored heights.
struct Patch {
    cell: UVec2,
    h00: f64,
    h10: f64,
    h01: f64,
    h11: f64,
}

impl Patch {
    fn new(field: &HeightField, cell: UVec2) -> Self {
        let (i, j) = (cell.x, cell.y);
        Self {
            cell,
            h00: field.grid_height(i, j),
            h10: field.grid_height(i + 1, j),
            h01: field.grid_height(i, j + 1),
            h11: field.grid_height(i + 1, j + 1),
        }
    }

    /// The height at a point in cells. Weighted by each corner, not by differences: at a corner
    /// the weights are exactly 1 and 0.
    fn height_m(&self, field: &HeightField, grid: DVec2) -> f64 {
        let (u, v) = (
            grid.x - f64::from(self.cell.x),
            grid.y - f64::from(self.cell.y),
        );
        let near = self.h00 * (1.0 - u) + self.h10 * u;
        let far = self.h01 * (1.0 - u) + self.h11 * u;
        field.metres(near * (1.0 - v) + far * v)
    }

    /// Slopes in metres a cell at (0, 0) of the patch, and how much each grows over the other.
    fn slopes_m(&self, field: &HeightField) -> (f64, f64, f64) {
        let (_, step_m) = field.offset_and_step_m();
        (
            (self.h10 - self.h00) * step_m,
            (self.h01 - self.h00) * step_m,
            ((self.h00 - self.h10) + (self.h11 - self.h01)) * step_m,
        )
    }

    /// The unit normal at a point in cells.
    fn normal(&self, field: &HeightField, grid: DVec2) -> DVec3 {
        let u = (grid.x - f64::from(self.cell.x)).clamp(0.0, 1.0);
        let v = (grid.y - f64::from(self.cell.y)).clamp(0.0, 1.0);
        let (along_x, along_z, twist) = self.slopes_m(field);
        let texel_m = f64::from(field.texel_m());
        DVec3::new(-(along_x + v * twist), texel_m, -(along_z + u * twist)).normalize()
    }
}

/// A walk over the cells below a ray that starts over the footprint and is not vertical. x and z
/// in cells, y in metres, distances in units of the direction's length.
struct Walk<'a> {
    field: &'a HeightField,
    o: DVec3,
    d: DVec3,
    /// Where to stop: the end of the footprint or of the ray.
    end: f64,
}

impl Walk<'_> {
    /// The first descent through the surface from the air, and its cell.
    ///
    /// The walk goes from square to square of the pyramid: over those that the ray stays above
    /// while it is in the air, under those that it stays below while in the ground, and down into
    /// the others until it stands in one cell, whose crossing is exact. Squares are integers and
    /// each step leaves one for good, so that nothing is skipped or visited forever; `above` is
    /// carried from cell to cell, so that a crossing that rounding moves over a border is found on
    /// the other side of it.
    fn first_hit(&self, above: &mut bool) -> Option<(f64, UVec2)> {
        let pyramid = self.field.pyramid();
        let cells = self.field.cells().as_ivec2();
        let (o, d) = (self.o, self.d);
        let forward = [d.x >= 0.0, d.z >= 0.0];
        let top = pyramid.levels();
        let mut level = top;
        let mut cell = [(o.x as i32).min(cells.x - 1), (o.z as i32).min(cells.y - 1)];
        let mut t = 0.0;
        loop {
            // The square of this level around the cell, and where the ray leaves it.
            let first = [cell[0] >> level << level, cell[1] >> level << level];
            let end = [
                (first[0] + (1 << level)).min(cells.x),
                (first[1] + (1 << level)).min(cells.y),
            ];
            let leave_x = crossing(o.x, d.x, if forward[0] { end[0] } else { first[0] });
            let leave_z = crossing(o.z, d.z, if forward[1] { end[1] } else { first[1] });
            let leave = leave_x.min(leave_z).min(self.end).max(t);

            if level > 0 {
                let (max, min) =
                    pyramid.get(level, (cell[0] >> level) as u32, (cell[1] >> level) as u32);
                let (y0, y1) = (o.y + d.y * t, o.y + d.y * leave);
                let clear = if *above {
                    y0.min(y1) > self.field.metres(max)
                } else {
                    y0.max(y1) < self.field.metres(min)
                };
                if !clear {
                    level -= 1;
                    continue;
                }
            } else if let Some(hit) = self.cross_cell(cell, t, leave, above) {
                return Some((hit, UVec2::new(cell[0] as u32, cell[1] as u32)));
            }

            if leave >= self.end {
                return None;
            }
            // Over one border for sure; along the other axis as far as the ray has come, but
            // never out of this square and never back.
            let crossed = usize::from(leave_z < leave_x);
            let along = 1 - crossed;
            let (o_along, d_along) = if along == 0 { (o.x, d.x) } else { (o.z, d.z) };
            let reached = (o_along + d_along * leave).floor() as i32;
            if forward[along] {
                cell[along] = reached.clamp(cell[along], end[along] - 1);
            } else {
                cell[along] = reached.clamp(first[along], cell[along]);
            }
            if forward[crossed] {
                cell[crossed] = end[crossed];
            } else {
                cell[crossed] = first[crossed] - 1;
            }
            if cell[crossed] < 0 || cell[crossed] >= [cells.x, cells.y][crossed] {
                return None;
            }
            t = leave;
            level = (level + 1).min(top);
        }
    }

    /// The first descent through one cell's patch between `t` and `leave`; otherwise brings
    /// `above` up to date.
    ///
    /// Along the ray, its height above the patch is a·s² + b·s + c, s from `t`. Each root is
    /// taken in the form that subtracts nothing (2c / (−b + √) or (b + √) / −2a, by the sign of
    /// b), so that a vanishing `a` needs no case of its own.
    ///
    /// Rounding may not make a ray come out of the ground, nor fall back onto a surface that it
    /// has just left: both would be hits out of nothing. So coming out takes more height than
    /// rounding explains, and the error is on the side of staying in the ground.
    fn cross_cell(&self, cell: [i32; 2], t: f64, leave: f64, above: &mut bool) -> Option<f64> {
        let patch = Patch::new(self.field, UVec2::new(cell[0] as u32, cell[1] as u32));
        let d = self.d;
        let at = self.o + d * t;
        let (u, v) = (at.x - f64::from(cell[0]), at.z - f64::from(cell[1]));
        let (along_x, along_z, twist) = patch.slopes_m(self.field);
        let a = -twist * d.x * d.z;
        let b = d.y - (d.x * (along_x + v * twist) + d.z * (along_z + u * twist));
        let mut c = at.y - patch.height_m(self.field, at.xz());
        let span = leave - t;

        // Of c: a few roundings of each height that goes into it, and of the position, whose
        // coordinates the slopes turn into heights.
        let slopes = along_x.abs() + along_z.abs() + 2.0 * twist.abs();
        let rounding = 8.0
            * f64::EPSILON
            * (self.o.y.abs()
                + (d.y * t).abs()
                + self.field.metres(patch.h00).abs()
                + slopes * (1.0 + f64::from(cell[0].max(cell[1]))));

        let mut came_out = false;
        if !*above {
            let mut highest = c.max((a * span + b) * span + c);
            let peak = -0.5 * b / a;
            if a < 0.0 && peak > 0.0 && peak < span {
                highest = highest.max(c + 0.5 * b * peak);
            }
            if highest <= rounding {
                return None;
            }
            *above = true;
            if c <= rounding {
                if a >= 0.0 {
                    // Straight, or ever steeper: it stays out.
                    return None;
                }
                c = c.min(0.0);
                came_out = true;
            }
        } else if c <= 0.0 {
            // In the air at the end of the last cell, not so here. Going down, or deeper than
            // rounding explains: this is the crossing.
            if b <= 0.0 || c < -rounding {
                return Some(t);
            }
            c = 0.0;
            came_out = true;
        }

        let root_of_discriminant = (b * b - 4.0 * a * c).max(0.0).sqrt();
        let root = if came_out || b >= 0.0 {
            // First up: down again only if it bends down, at the larger root.
            if a < 0.0 {
                (b + root_of_discriminant) / (-2.0 * a)
            } else {
                f64::INFINITY
            }
        } else if b * b >= 4.0 * a * c {
            2.0 * c / (-b + root_of_discriminant)
        } else {
            f64::INFINITY
        };
        // The second test is for a root that rounding put behind the end.
        let below_at_end = (a * span + b) * span + c <= 0.0;
        if root <= span || (below_at_end && !came_out) {
            Some(t + root.min(span))
        } else {
            None
        }
    }
}

/// Where a ray along one axis crosses a border; never, if it runs along it.
fn crossing(o: f64, d: f64, border: i32) -> f64 {
    if d == 0.0 {
        f64::INFINITY
    } else {
        (f64::from(border) - o) / d
    }
}

/// Where a ray along one axis enters and leaves `0..=end`, the borders included.
fn slab(o: f64, d: f64, end: f64) -> Option<(f64, f64)> {
    if d == 0.0 {
        return (0.0..=end)
            .contains(&o)
            .then_some((f64::NEG_INFINITY, f64::INFINITY));
    }
    let (a, b) = (-o / d, (end - o) / d);
    Some((a.min(b), a.max(b)))
}

/// A direction of any length at length 1.
fn unit(direction: DVec3) -> Option<DVec3> {
    // First to a size whose square neither overflows nor vanishes.
    let largest = direction.abs().max_element();
    if largest > 0.0 && largest.is_finite() && direction.is_finite() {
        Some((direction / largest).normalize())
    } else {
        None
    }
}

/// Asks all [`Terrain`]s of the world at once, in world space.
///
/// It sees every entity with a `Terrain` and a `GlobalTransform` whose height field has loaded,
/// visible or not, where its transform was when transforms were last propagated. Transforms are
/// composed in double precision; a terrain whose transform cannot be inverted (a scale of zero) is
/// passed over. Needs the [`HeightFieldPlugin`](super::HeightFieldPlugin), which the terrain
/// plugin brings along.
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_skyline::terrain::TerrainQuery;
/// # #[derive(Component)] struct Tree;
/// fn stand_on_the_ground(terrain: TerrainQuery, mut trees: Query<&mut Transform, With<Tree>>) {
///     for mut tree in &mut trees {
///         if let Some((_, height)) = terrain.height_at(tree.translation.xz()) {
///             tree.translation.y = height;
///         }
///     }
/// }
/// ```
#[derive(SystemParam)]
pub struct TerrainQuery<'w, 's> {
    terrains: Query<'w, 's, (Entity, &'static Terrain, &'static GlobalTransform)>,
    height_fields: Res<'w, Assets<HeightField>>,
}

impl TerrainQuery<'_, '_> {
    /// The highest ground at `(x, z)` of the world: which terrain, and its height.
    ///
    /// It is the first surface that a ray straight down from above the terrain meets, so it also
    /// works for terrains that are tilted; the walls of a terrain are no ground.
    pub fn height_at(&self, world_xz: Vec2) -> Option<(Entity, f32)> {
        let hit = self.ground_at(world_xz)?;
        Some((hit.entity, hit.point.y as f32))
    }

    /// The unit normal of that ground, in world space.
    pub fn normal_at(&self, world_xz: Vec2) -> Option<Vec3> {
        Some(self.ground_at(world_xz)?.normal.as_vec3())
    }

    /// The first ground, of all terrains, that a ray meets within `max_distance`. What meeting
    /// means, and what a ray from inside the ground sees, is as in [`HeightField::ray_cast`]; it
    /// holds for each terrain by itself, so a ray that starts inside one terrain may meet another.
    pub fn ray_cast(&self, ray: Ray3d, max_distance: f32) -> Option<TerrainHit> {
        let origin = ray.origin.as_dvec3();
        let direction = unit(ray.direction.as_vec3().as_dvec3())?;
        self.placed()
            .filter_map(|placed| placed.cast(origin, direction, f64::from(max_distance)))
            .min_by(|a, b| a.distance.total_cmp(&b.distance))
            .map(|hit| TerrainHit {
                entity: hit.entity,
                distance: hit.distance as f32,
                point: hit.point.as_vec3(),
                normal: hit.normal.as_vec3(),
                cell: hit.cell,
                side: hit.side,
            })
    }

    fn ground_at(&self, world_xz: Vec2) -> Option<WorldHit> {
        let world_xz = world_xz.as_dvec2();
        self.placed()
            .filter_map(|placed| {
                let top = placed.top();
                let origin = DVec3::new(world_xz.x, top, world_xz.y);
                placed.cast(origin, DVec3::NEG_Y, f64::INFINITY)
            })
            .filter(|hit| hit.side == HitSide::Surface)
            .max_by(|a, b| a.point.y.total_cmp(&b.point.y))
    }

    /// Every terrain that has a place and a surface.
    fn placed(&self) -> impl Iterator<Item = Placed<'_>> {
        self.terrains
            .iter()
            .filter_map(|(entity, terrain, transform)| {
                let field = self.height_fields.get(&terrain.height_field)?;
                let world_from_local = transform.affine().as_daffine3();
                let local_from_world = invert(world_from_local)?;
                Some(Placed {
                    entity,
                    field,
                    world_from_local,
                    local_from_world,
                })
            })
    }
}

/// A terrain in the world.
struct Placed<'a> {
    entity: Entity,
    field: &'a HeightField,
    world_from_local: DAffine3,
    local_from_world: DAffine3,
}

struct WorldHit {
    entity: Entity,
    distance: f64,
    point: DVec3,
    normal: DVec3,
    cell: UVec2,
    side: HitSide,
}

impl Placed<'_> {
    /// Casts a ray in world space. `direction` has length 1, but what it becomes in local space
    /// does not: that keeps distances those of the world.
    fn cast(&self, origin: DVec3, direction: DVec3, max_distance: f64) -> Option<WorldHit> {
        let hit = self.field.ray_cast_scaled(
            self.local_from_world.transform_point3(origin),
            self.local_from_world.transform_vector3(direction),
            max_distance,
        )?;
        // Normals go by the inverse transpose, which keeps them on the air's side even where the
        // transform mirrors.
        let normal = self.local_from_world.matrix3.transpose() * hit.normal;
        Some(WorldHit {
            entity: self.entity,
            distance: hit.distance,
            point: origin + direction * hit.distance,
            normal: unit(normal)?,
            cell: hit.cell,
            side: hit.side,
        })
    }

    /// A world height above every point of the surface.
    fn top(&self) -> f64 {
        let (low, high) = self.field.data_range_m();
        let texel_m = f64::from(self.field.texel_m());
        let extent = self.field.cells().as_dvec2() * texel_m;
        let to_y = self.world_from_local.matrix3.row(1);
        let most = |factor: f64, from: f64, to: f64| (factor * from).max(factor * to);
        let top = self.world_from_local.translation.y
            + most(to_y.x, 0.0, extent.x)
            + most(to_y.y, low, high)
            + most(to_y.z, 0.0, extent.y);
        top + 1.0 + 1e-6 * top.abs()
    }
}

/// The inverse, unless the transform flattens space, by the precision of its `f32` entries.
fn invert(world_from_local: DAffine3) -> Option<DAffine3> {
    let matrix = world_from_local.matrix3;
    let volume = matrix.determinant().abs();
    let most = matrix.x_axis.length() * matrix.y_axis.length() * matrix.z_axis.length();
    if !(world_from_local.is_finite() && volume > 1e-6 * most) {
        return None;
    }
    let inverse = world_from_local.inverse();
    inverse.is_finite().then_some(inverse)
}
