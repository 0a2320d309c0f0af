//! The spherical index against its twin: the comparators, and meshes to try them on.

use bevy::math::{DAffine3, DMat4, DVec3, DVec4, Mat4, Vec3};
use bevy_skyline::{
    reference::spherical as twin,
    spherical::{
        Bins, Eye, Layout, MapSettings, Shown, SphericalChunks, SphericalMaps, View,
        half_space_in_local,
    },
};

/// The finest that tests try, the coarsest, and what divides nothing.
pub const BINS: [Bins; 4] = [
    Bins {
        theta: 90,
        phi: 180,
    },
    Bins { theta: 45, phi: 90 },
    Bins { theta: 7, phi: 3 },
    Bins { theta: 1, phi: 1 },
];

#[derive(Clone, Default)]
pub struct Mesh {
    pub positions: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Three vertices of its own for each triangle.
    pub fn of(triangles: &[[[f32; 3]; 3]]) -> Self {
        Self {
            positions: triangles.iter().flatten().copied().collect(),
            triangles: (0..triangles.len() as u32)
                .map(|number| [0, 1, 2].map(|corner| 3 * number + corner))
                .collect(),
        }
    }

    /// A closed ball: `rings` rings of twice as many sides; its poles' triangles have two corners at one place.
    pub fn ball(rings: u32) -> Self {
        let mut ball = Self::default();
        for ring in 0..=rings {
            for side in 0..2 * rings {
                let theta = std::f32::consts::PI * ring as f32 / rings as f32;
                let phi = std::f32::consts::PI * side as f32 / rings as f32;
                let across = if ring == 0 || ring == rings {
                    0.0
                } else {
                    theta.sin()
                };
                ball.positions
                    .push([across * phi.cos(), theta.cos(), across * phi.sin()]);
            }
        }
        for ring in 0..rings {
            for side in 0..2 * rings {
                let at = |ring: u32, side: u32| ring * 2 * rings + side % (2 * rings);
                let [a, b] = [at(ring, side), at(ring, side + 1)];
                let [c, d] = [at(ring + 1, side), at(ring + 1, side + 1)];
                ball.triangles.extend([[a, b, d], [a, d, c]]);
            }
        }
        ball
    }

    /// Stretched, then moved.
    pub fn placed(mut self, scale: [f32; 3], by: [f32; 3]) -> Self {
        for position in &mut self.positions {
            *position = core::array::from_fn(|axis| position[axis] * scale[axis] + by[axis]);
        }
        self
    }

    pub fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize]
            .map(|vertex| DVec3::from_array(self.positions[vertex as usize].map(f64::from)))
    }

    pub fn maps(&self, bins: Bins, layout: Layout, chunk_triangles: u32) -> SphericalMaps {
        let settings = MapSettings {
            bins,
            layout,
            chunk_triangles,
            ..MapSettings::default()
        };
        SphericalMaps::build(&self.positions, &self.triangles, settings).unwrap()
    }

    pub fn chunks(&self, maps: &SphericalMaps) -> SphericalChunks {
        SphericalChunks::build(&self.positions, &self.triangles, maps).unwrap()
    }
}

/// Numbers that are the same in every run.
pub struct Dice(pub u64);

impl Dice {
    /// From 0 to 1.
    pub fn roll(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (mixed ^ (mixed >> 31)) as f64 / u64::MAX as f64
    }

    /// In a cube from −1 to 1.
    pub fn place(&mut self) -> DVec3 {
        DVec3::from_array([(); 3].map(|()| self.roll() * 2.0 - 1.0))
    }

    /// Triangles of all sizes from the whole cube to a hundredth; some slivers, some with corners in common.
    pub fn soup(&mut self, triangles: usize) -> Mesh {
        let triangles: Vec<_> = (0..triangles)
            .map(|_| {
                let (middle, size) = (self.place(), 10.0_f64.powf(-2.0 * self.roll()));
                let mut corners = [(); 3].map(|()| middle + self.place() * size);
                if self.roll() < 0.1 {
                    corners[2] = corners[0].lerp(corners[1], self.roll());
                }
                if self.roll() < 0.05 {
                    corners[1] = corners[0];
                }
                corners.map(|corner| corner.as_vec3().to_array())
            })
            .collect();
        Mesh::of(&triangles)
    }
}

/// Compares all that the maps say with the twin's; the first difference in words.
pub fn maps_are_right(mesh: &Mesh, maps: &SphericalMaps, samples: u32) -> Result<(), String> {
    let count = mesh.triangles.len();
    let mut is_there = vec![false; count];
    for &triangle in &maps.order {
        match is_there.get_mut(triangle as usize) {
            Some(is_there) if !*is_there => *is_there = true,
            _ => {
                return Err(format!(
                    "{triangle} is twice in the order, or not in the mesh"
                ));
            }
        }
    }
    if maps.order.len() != count {
        return Err(format!("{} of {count} in the order", maps.order.len()));
    }
    let mut earlier = 0;
    let mut last_filled = None;
    for (bin, (cell, centroid)) in maps.memory.iter().zip(&maps.centroids).enumerate() {
        let (outward, inward) = (
            cell.outward..cell.outward + cell.outward_count,
            cell.inward..cell.inward + cell.inward_count,
        );
        let held = cell.outward_count + cell.inward_count;
        if (centroid.earlier, centroid.count) != (earlier, held) {
            return Err(format!("bin {bin}: {centroid:?} of {held} after {earlier}"));
        }
        earlier += held;
        if cell.previous != last_filled.unwrap_or(u32::MAX) {
            return Err(format!("bin {bin}: previous of {cell:?}"));
        }
        if held > 0 {
            if let Some(last) = last_filled
                && maps.memory[last as usize].next != bin as u32
            {
                return Err(format!("bin {last}: next"));
            }
            last_filled = Some(bin as u32);
        }
        for (range, is_inward) in [(outward, false), (inward, true)] {
            let mut distance = 0.0;
            for place in range {
                let [a, b, c] = mesh
                    .corners(maps.order[place as usize])
                    .map(|corner| corner - maps.centre);
                let centroid = (a + b + c) / 3.0;
                let turn = (b - a).cross(c - a).dot(centroid);
                if maps.settings.bins.of(centroid) != bin
                    || (turn < -1e-9 && !is_inward)
                    || (turn > 1e-9 && is_inward)
                {
                    return Err(format!("bin {bin} has what is not its own"));
                }
                if centroid.length() < distance - 1e-9 {
                    return Err(format!("bin {bin} is not in order of distance"));
                }
                distance = centroid.length();
            }
        }
    }
    for triangle in 0..count as u32 {
        let corners = mesh.corners(triangle).map(|corner| corner - maps.centre);
        for bin in twin::sampled_bins(corners, maps.index.bins, samples) {
            if !maps.index.triangles(bin).contains(&triangle) {
                return Err(format!("triangle {triangle} is not in bin {bin}"));
            }
        }
    }
    Ok(())
}

/// A camera, what it shows, and the transform of what it looks at.
#[derive(Clone, Copy)]
pub struct Shot {
    pub camera: Eye,
    pub clip_from_view: Mat4,
    pub world_from_view: DAffine3,
    pub world_from_local: DAffine3,
    pub shown: Shown,
}

pub const SIZE: [f32; 2] = [640.0, 480.0];

impl Shot {
    /// A perspective one; `near` is also how far its near plane is.
    pub fn at(eye: DVec3, target: DVec3, near: f32) -> Self {
        let size = SIZE.map(f64::from);
        Self {
            camera: Eye::perspective(eye, 1.0, size, f64::from(near)),
            clip_from_view: Mat4::perspective_infinite_reverse_rh(1.0, SIZE[0] / SIZE[1], near),
            world_from_view: look(eye, target),
            world_from_local: DAffine3::IDENTITY,
            shown: Shown::Front,
        }
    }

    /// An orthographic one that shows so much from bottom to top.
    pub fn parallel(eye: DVec3, target: DVec3, height: f64) -> Self {
        let half = (height / 2.0) as f32;
        let across = half * SIZE[0] / SIZE[1];
        let size = SIZE.map(f64::from);
        Self {
            camera: Eye::orthographic(eye, eye - target, height, size),
            clip_from_view: Mat4::orthographic_rh(-across, across, -half, half, 1e6, -1e6),
            ..Self::at(eye, target, 0.1)
        }
    }

    pub fn with(self, world_from_local: DAffine3, shown: Shown) -> Self {
        Self {
            world_from_local,
            shown,
            ..self
        }
    }

    pub fn view(&self, reach: f64) -> View {
        View::new(&self.camera, &self.world_from_local, reach, self.shown)
    }

    /// The picture's four sides. space: world
    pub fn sides(&self) -> [DVec4; 4] {
        let clip_from_world =
            self.clip_from_view.as_dmat4() * DMat4::from(self.world_from_view.inverse());
        let [x, y, w] = [0, 1, 3].map(|row| clip_from_world.row(row));
        [w + x, w - x, w + y, w - y]
    }
}

fn look(eye: DVec3, target: DVec3) -> DAffine3 {
    let backward = (eye - target).normalize_or(DVec3::Z);
    let right = backward.any_orthonormal_vector();
    let up = backward.cross(right);
    DAffine3::from_cols(right, up, backward, eye)
}

/// What was compared: chunks left out, and triangles that the twin says must stay.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    pub left_out: usize,
    pub must_stay: usize,
}

/// Whether no chunk is left out that has a triangle which, by the twin, shows the eye the shown side, or which a
/// rasteriser would draw; nor any that has a triangle in view.
pub fn nothing_visible_goes(
    mesh: &Mesh,
    maps: &SphericalMaps,
    chunks: &SphericalChunks,
    shot: &Shot,
    view: &View,
) -> Result<Tally, String> {
    let mut tally = Tally::default();
    let sign = match shot.shown {
        Shown::Front => 1.0,
        Shown::Back => -1.0,
        Shown::Both => 0.0,
    };
    let eye = match shot.camera.backward {
        None => shot.camera.position.extend(1.0),
        Some(backward) => backward.extend(0.0),
    };
    let world_from_view = DMat4::from(shot.world_from_view).as_mat4();
    let clip_from_world = shot.clip_from_view * world_from_view.inverse();
    let world_from_local = DMat4::from(shot.world_from_local).as_mat4();
    let sides = shot.sides();
    let in_local = sides.map(|side| half_space_in_local(side, &shot.world_from_local));
    for chunk in chunks.chunks() {
        let (faces, in_view) = (
            chunks.faces_eye(chunk, view),
            chunks.in_frustum(chunk, &in_local, view),
        );
        tally.left_out += usize::from(!faces || !in_view);
        for place in chunk.triangles.clone() {
            let triangle = maps.order[place as usize];
            let corners = mesh.corners(triangle);
            let placed = corners.map(|corner| shot.world_from_local.transform_point3(corner));
            let [a, b, c] = placed;
            let side = twin::side(placed, eye) * sign;
            let reach = |corner: DVec3| eye.truncate().length() + corner.length();
            let band = 1e-14 * reach(a) * reach(b) * reach(c);
            let is_drawn = twin::rasterised_area(
                corners.map(|corner: DVec3| -> Vec3 { corner.as_vec3() }),
                world_from_local,
                clip_from_world,
                SIZE,
                shot.camera.sub_pixel_bits,
            )
            .is_some_and(|area| area * sign > 0.0 || (sign == 0.0 && area != 0.0));
            let must_face = side > band || is_drawn;
            if must_face && !faces {
                return Err(format!(
                    "triangle {triangle} is left out: side {side}, drawn {is_drawn}"
                ));
            }
            let is_outside = sides.iter().any(|&half| twin::is_outside(placed, half));
            if !is_outside && !in_view {
                return Err(format!("triangle {triangle} is in view, its chunk is not"));
            }
            tally.must_stay += usize::from(must_face && !is_outside);
        }
    }
    Ok(tally)
}

/// All comparisons for a mesh: bins, layouts, sizes of chunks, cameras around, close and inside, both projections.
pub fn everything_is_right(mesh: &Mesh, samples: u32) -> Tally {
    let mut all = Tally::default();
    for_all_views(mesh, samples, |maps, chunks, shot| {
        let view = shot.view(chunks.reach());
        let tally = nothing_visible_goes(mesh, maps, chunks, shot, &view)?;
        all.left_out += tally.left_out;
        all.must_stay += tally.must_stay;
        Ok(())
    })
    .unwrap();
    all
}

/// The maps of a mesh by [`BINS`] and layouts, compared with the twin's; and `look` at all of their views.
pub fn for_all_views(
    mesh: &Mesh,
    samples: u32,
    mut look: impl FnMut(&SphericalMaps, &SphericalChunks, &Shot) -> Result<(), String>,
) -> Result<(), String> {
    for (number, bins) in BINS.into_iter().enumerate() {
        for layout in [Layout::Rows, Layout::Blocks] {
            let maps = mesh.maps(bins, layout, [1, 5, 128, 7][number]);
            maps_are_right(mesh, &maps, samples)?;
            let chunks = mesh.chunks(&maps);
            let mut next = 0;
            for chunk in chunks.chunks() {
                assert_eq!(chunk.triangles.start, next);
                next = chunk.triangles.end;
            }
            assert_eq!(next as usize, mesh.triangles.len());
            let mut dice = Dice(number as u64);
            for distance in [0.0, 0.3, 1.01, 2.0, 30.0, 3000.0] {
                let way = dice.place().normalize_or(DVec3::X);
                let eye = maps.centre + way * maps.radius * distance;
                let target = maps.centre + dice.place() * maps.radius;
                let near = (maps.radius * 1e-3).max(1e-6) as f32;
                for shown in [Shown::Front, Shown::Back, Shown::Both] {
                    for shot in [
                        Shot::at(eye, target, near),
                        Shot::parallel(eye, target, 3.0 * maps.radius),
                    ] {
                        look(&maps, &chunks, &shot.with(DAffine3::IDENTITY, shown))?;
                    }
                }
            }
        }
    }
    Ok(())
}
