//! Meshes of flat faces with colours, and with places on a façade's texture.

use bevy::{
    asset::RenderAssetUsages,
    mesh::{Indices, PrimitiveTopology},
    prelude::*,
};

/// Between windows, and between floors. units: m
pub const WINDOW_M: Vec2 = Vec2::new(3.2, 3.4);
/// Windows and floors of a façade's texture.
pub const WINDOWS: f32 = 8.0;

/// A mesh under construction.
#[derive(Default)]
pub struct Shape {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    places: Vec<[f32; 2]>,
    colours: Vec<[f32; 4]>,
    indices: Vec<u32>,
}

impl Shape {
    /// A convex polygon, counter-clockwise from where it is seen; without windows.
    pub fn polygon(&mut self, corners: &[Vec3], colour: LinearRgba) {
        self.face(corners, |_| Vec2::ZERO, colour);
    }

    fn face(&mut self, corners: &[Vec3], place: impl Fn(Vec3) -> Vec2, colour: LinearRgba) {
        let &[a, b, c, ..] = corners else {
            return;
        };
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let first = self.positions.len() as u32;
        for &corner in corners {
            self.positions.push(corner.to_array());
            self.normals.push(normal.to_array());
            self.places.push(place(corner).to_array());
            self.colours.push(colour.to_f32_array());
        }
        for i in 2..corners.len() as u32 {
            self.indices.extend([first, first + i - 1, first + i]);
        }
    }

    /// A wall with windows between two corners, counter-clockwise seen from above being out. Floors count from height
    /// 0; a whole number of windows fits between the corners.
    fn wall(&mut self, from: Vec2, to: Vec2, bottom: f32, top: f32, colour: LinearRgba) {
        let at = |corner: Vec2, y: f32| Vec3::new(corner.x, y, corner.y);
        let length = from.distance(to);
        let columns = (length / WINDOW_M.x).round().max(1.0);
        let place = |corner: Vec3| {
            let along = corner.xz().distance(from) / length.max(1e-3) * columns;
            Vec2::new(along, -corner.y / WINDOW_M.y) / WINDOWS
        };
        let corners = [at(from, bottom), at(from, top), at(to, top), at(to, bottom)];
        self.face(&corners, place, colour);
    }

    /// Walls with windows over a ring of corners, and a roof. The ring goes from +X toward +Z.
    pub fn prism(
        &mut self,
        ring: &[Vec2],
        bottom: f32,
        top: f32,
        wall: LinearRgba,
        roof: LinearRgba,
    ) {
        for (i, &from) in ring.iter().enumerate() {
            self.wall(from, ring[(i + 1) % ring.len()], bottom, top, wall);
        }
        let lid: Vec<Vec3> = ring
            .iter()
            .rev()
            .map(|corner| Vec3::new(corner.x, top, corner.y))
            .collect();
        self.polygon(&lid, roof);
    }

    /// A [`prism`](Self::prism) over a rectangle.
    pub fn block(
        &mut self,
        centre: Vec2,
        half: Vec2,
        bottom: f32,
        top: f32,
        wall: LinearRgba,
        roof: LinearRgba,
    ) {
        self.prism(&rectangle(centre, half), bottom, top, wall, roof);
    }

    /// A box without windows, all round.
    pub fn solid(&mut self, low: Vec3, high: Vec3, colour: LinearRgba) {
        let at = |x: f32, y: f32, z: f32| low + (high - low) * Vec3::new(x, y, z);
        for face in [
            [
                at(0., 0., 0.),
                at(0., 1., 0.),
                at(1., 1., 0.),
                at(1., 0., 0.),
            ],
            [
                at(1., 0., 1.),
                at(1., 1., 1.),
                at(0., 1., 1.),
                at(0., 0., 1.),
            ],
            [
                at(0., 0., 1.),
                at(0., 1., 1.),
                at(0., 1., 0.),
                at(0., 0., 0.),
            ],
            [
                at(1., 0., 0.),
                at(1., 1., 0.),
                at(1., 1., 1.),
                at(1., 0., 1.),
            ],
            [
                at(0., 1., 0.),
                at(0., 1., 1.),
                at(1., 1., 1.),
                at(1., 1., 0.),
            ],
            [
                at(0., 0., 1.),
                at(0., 0., 0.),
                at(1., 0., 0.),
                at(1., 0., 1.),
            ],
        ] {
            self.polygon(&face, colour);
        }
    }

    /// A column without windows, with its lid.
    pub fn column(
        &mut self,
        centre: Vec2,
        radii: [f32; 2],
        sides: u32,
        bottom: f32,
        top: f32,
        colour: LinearRgba,
    ) {
        let [below, above] = radii.map(|radius| ring(centre, radius, sides));
        let at = |corner: Vec2, y: f32| Vec3::new(corner.x, y, corner.y);
        for i in 0..sides as usize {
            let next = (i + 1) % sides as usize;
            let mut corners = vec![at(below[i], bottom)];
            if radii[1] > 0.0 {
                corners.push(at(above[i], top));
            }
            corners.extend([at(above[next], top), at(below[next], bottom)]);
            self.polygon(&corners, colour);
        }
        if radii[1] > 0.0 {
            let lid: Vec<Vec3> = above.iter().rev().map(|&corner| at(corner, top)).collect();
            self.polygon(&lid, colour);
        }
    }

    /// A roof with a ridge along x over a rectangle, and the gables under it.
    pub fn gable(
        &mut self,
        half: Vec2,
        eaves: f32,
        ridge: f32,
        wall: LinearRgba,
        roof: LinearRgba,
    ) {
        let out = half + Vec2::splat(0.4);
        for side in [1.0, -1.0] {
            let at = |x: f32, y: f32, z: f32| Vec3::new(side * x, y, side * z);
            self.polygon(
                &[
                    at(-out.x, eaves, out.y),
                    at(out.x, eaves, out.y),
                    at(out.x, ridge, 0.0),
                    at(-out.x, ridge, 0.0),
                ],
                roof,
            );
            self.polygon(
                &[
                    at(half.x, eaves, half.y),
                    at(half.x, eaves, -half.y),
                    at(half.x, ridge, 0.0),
                ],
                wall,
            );
        }
    }

    /// A level quadrilateral at a height, each corner in a colour of its own; its texture repeats every so many metres.
    pub fn sheet(
        &mut self,
        corners: [Vec2; 4],
        height: f32,
        repeat_m: f32,
        colour: impl Fn(Vec2) -> LinearRgba,
    ) {
        let first = self.positions.len();
        let at = corners.map(|corner| Vec3::new(corner.x, height, corner.y));
        self.face(&at, |corner| corner.xz() / repeat_m, LinearRgba::WHITE);
        for (i, corner) in corners.into_iter().enumerate() {
            self.colours[first + i] = colour(corner).to_f32_array();
        }
    }

    /// The mesh.
    pub fn mesh(self) -> Mesh {
        Mesh::new(
            PrimitiveTopology::TriangleList,
            RenderAssetUsages::default(),
        )
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, self.positions)
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, self.normals)
        .with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, self.places)
        .with_inserted_attribute(Mesh::ATTRIBUTE_COLOR, self.colours)
        .with_inserted_indices(Indices::U32(self.indices))
    }
}

/// A regular polygon, from +X toward +Z.
pub fn ring(centre: Vec2, radius: f32, sides: u32) -> Vec<Vec2> {
    let step = core::f32::consts::TAU / sides as f32;
    (0..sides)
        .map(|i| centre + radius * Vec2::from_angle(i as f32 * step))
        .collect()
}

/// A rectangle, from +X toward +Z.
pub fn rectangle(centre: Vec2, half: Vec2) -> [Vec2; 4] {
    [(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)]
        .map(|(x, z)| centre + half * Vec2::new(x, z))
}
