//! What furnishes a city so that most of its triangles are in small things: from bins of half a metre to trees of ten,
//! from forty triangles to some two thousand.

use core::f32::consts::{FRAC_PI_2, PI, TAU};

use bevy::prelude::*;

use super::{
    Object, Scene, View,
    city::{along_streets, unit},
    shapes::{self, Faces},
    streets::Ground,
};

/// Height of the eye that looks around from the middle of the city. units: m
const MIDDLE_EYE_M: f32 = 30.0;
/// The same of the eye over the middle, above the highest roof. units: m
const OVER_EYE_M: f32 = 5.0;
/// From tree to tree in a park. units: m
const TREE_PITCH_M: f32 = 10.0;
/// Shares of vehicles, of what stands on roofs, and of the trees in parks; the rest stands on pavements.
const VEHICLES: f32 = 0.2;
const ROOFS: f32 = 0.22;
const PARKS: f32 = 0.1;

/// A kind of thing: its mesh, in metres and standing on height 0, and its colour.
pub type Kind = (Mesh, Color);

/// Adds so many things to a city whose first objects are its buildings, and the views `middle` and `over`.
pub(super) fn add(mut scene: Scene, ground: &Ground, buildings: usize, count: usize) -> Scene {
    let share = |of: f32| (of * count as f32) as usize;
    let park = park_places(ground, share(PARKS));
    let roofs = roof_places(&scene, buildings, share(ROOFS));
    let vehicles = street_places(ground, 7.5, share(VEHICLES), 0.3);
    let rest = count.saturating_sub(park.len() + roofs.len() + vehicles.len());
    let pavement = street_places(ground, 3.0, rest, 1.2);
    for (kinds, places, salt) in [
        (park_kinds(), park, 21),
        (roof_kinds(), roofs, 22),
        (vehicle_kinds(), vehicles, 23),
        (pavement_kinds(), pavement, 24),
    ] {
        put(&mut scene, kinds, &places, salt);
    }
    let [low, high] = scene.bounds;
    let middle = ground.free_near(0.5 * (low + high).xz());
    let eye = Vec3::new(middle.x, MIDDLE_EYE_M, middle.y);
    // A little down, so that the horizon lies above the middle of the picture.
    let view = View::at("middle", eye, eye + Vec3::new(200.0, -24.0, 0.0));
    scene.views.push(view);
    let eye = eye.with_y(high.y + OVER_EYE_M);
    let view = View::at("over", eye, eye + Vec3::new(200.0, -60.0, 0.0));
    scene.views.push(view);
    scene
}

/// One thing at each place, its kind drawn by lot.
fn put(scene: &mut Scene, kinds: Vec<Kind>, places: &[Transform], salt: u32) {
    let (first_mesh, first_paint) = (scene.meshes.len(), scene.paints.len());
    let count = kinds.len();
    for (mesh, paint) in kinds {
        scene.meshes.push(mesh);
        scene.paints.push(paint);
    }
    for (index, place) in places.iter().enumerate() {
        let kind = ((unit(index as u32, salt) * count as f32) as usize).min(count - 1);
        let scale = Vec3::splat(0.8 + 0.45 * unit(index as u32, salt + 10));
        let place = place.with_scale(scale);
        scene
            .objects
            .push(Object::still(first_mesh + kind, first_paint + kind, place));
    }
}

/// Places along streets, at most so far beside the line at a distance from the walls.
fn street_places(ground: &Ground, distance_m: f32, count: usize, aside_m: f32) -> Vec<Transform> {
    let mut spots = ground.spots(distance_m);
    if spots.len() < count {
        spots = along_streets(ground, count);
    }
    let (all, count) = (spots.len(), count.min(spots.len()));
    (0..count)
        .map(|index| {
            let spot = spots[index * all / count];
            let at = spot.at + aside_m * (2.0 * unit(index as u32, 31) - 1.0) * spot.along.perp();
            Transform::from_xyz(at.x, 0.0, at.y)
                .with_rotation(Quat::from_rotation_y(-spot.along.to_angle()))
        })
        .collect()
}

/// Places in parks, in rows that are not quite straight.
fn park_places(ground: &Ground, count: usize) -> Vec<Transform> {
    let open = ground.open(TREE_PITCH_M);
    let (all, count) = (open.len(), count.min(open.len()));
    (0..count)
        .map(|index| {
            let draw = |salt| unit(index as u32, salt) - 0.5;
            let at = open[index * all / count] + 0.7 * TREE_PITCH_M * Vec2::new(draw(32), draw(33));
            Transform::from_xyz(at.x, 0.0, at.y)
                .with_rotation(Quat::from_rotation_y(TAU * draw(34)))
        })
        .collect()
}

/// Places on roofs: within the largest level triangle of each building in turn.
fn roof_places(scene: &Scene, buildings: usize, count: usize) -> Vec<Transform> {
    let roofs: Vec<[Vec3; 3]> = scene.objects[..buildings.min(scene.objects.len())]
        .iter()
        .filter_map(|building| {
            let level = |three: &[Vec3; 3]| {
                let area = 0.5 * (three[1] - three[0]).cross(three[2] - three[0]);
                (area.y > 0.95 * area.length()).then_some(area.y)
            };
            shapes::corners(&scene.meshes[building.mesh])
                .into_iter()
                .filter_map(|three| Some((level(&three)?, three)))
                .max_by(|a, b| a.0.total_cmp(&b.0))
                .map(|(_, three)| three.map(|corner| building.transform.transform_point(corner)))
        })
        .collect();
    if roofs.is_empty() {
        return Vec::new();
    }
    (0..count)
        .map(|index| {
            let [a, b, c] = roofs[(index * roofs.len() / count) % roofs.len()];
            let draw = |salt| 0.15 + 0.25 * unit(index as u32, salt);
            let at = a + draw(35) * (b - a) + draw(36) * (c - a);
            Transform::from_translation(at)
                .with_rotation(Quat::from_rotation_y(FRAC_PI_2 * (index % 4) as f32))
        })
        .collect()
}

/// Trees of parks, with leaves.
pub fn park_kinds() -> Vec<Kind> {
    let paints = [
        Color::linear_rgb(0.08, 0.22, 0.05),
        Color::linear_rgb(0.13, 0.26, 0.04),
        Color::linear_rgb(0.22, 0.19, 0.03),
    ];
    let leaves = [220, 340, 480];
    paints
        .into_iter()
        .zip(leaves)
        .enumerate()
        .map(|(seed, (paint, leaves))| (tree(seed as u32, leaves, 9.0 + seed as f32), paint))
        .collect()
}

/// What stands on pavements: small trees, lamps, bins, benches, stalls.
pub fn pavement_kinds() -> Vec<Kind> {
    let dark = Color::linear_rgb(0.06, 0.08, 0.07);
    let steel = Color::linear_rgb(0.3, 0.31, 0.33);
    let wood = Color::linear_rgb(0.3, 0.18, 0.09);
    let leaf = Color::linear_rgb(0.1, 0.25, 0.07);
    vec![
        (tree(7, 70, 5.5), leaf),
        (tree(8, 110, 6.5), leaf),
        (bin(), dark),
        (bin(), Color::linear_rgb(0.05, 0.2, 0.08)),
        (hydrant(), Color::linear_rgb(0.5, 0.04, 0.03)),
        (bench(), wood),
        (rack(), steel),
        (railing(), dark),
        (street_lamp(), steel),
        (signal(), dark),
        (stall(), Color::linear_rgb(0.45, 0.3, 0.12)),
    ]
}

/// What drives, ahead being +X.
pub fn vehicle_kinds() -> Vec<Kind> {
    [
        (0.5, 0.05, 0.04),
        (0.7, 0.55, 0.05),
        (0.05, 0.08, 0.3),
        (0.6, 0.6, 0.62),
    ]
    .map(|(r, g, b)| (car(), Color::linear_rgb(r, g, b)))
    .into_iter()
    .chain([(bus(), Color::linear_rgb(0.65, 0.2, 0.03))])
    .collect()
}

/// What stands on roofs.
pub fn roof_kinds() -> Vec<Kind> {
    vec![
        (air_unit(), Color::linear_rgb(0.5, 0.52, 0.53)),
        (tank(), Color::linear_rgb(0.25, 0.16, 0.1)),
        (mast(), Color::linear_rgb(0.6, 0.08, 0.05)),
        (dish(), Color::linear_rgb(0.7, 0.7, 0.7)),
    ]
}

/// A trunk, branches, and leaves all over and within the crown, each seen from both sides.
fn tree(seed: u32, leaves: u32, height_m: f32) -> Mesh {
    let mut faces = Faces::default();
    let trunk = 0.45 * height_m;
    faces.bar(Vec3::ZERO, Vec3::Y * trunk, 0.022 * height_m, 7);
    let middle = Vec3::Y * 0.66 * height_m;
    let crown = Vec3::new(0.27, 0.34, 0.27) * height_m;
    for branch in 0..5 {
        let turn = Quat::from_rotation_y(TAU * branch as f32 / 5.0 + 0.3 * seed as f32);
        let tip = middle + turn * (Vec3::new(0.7, 0.1, 0.0) * crown);
        faces.bar(Vec3::Y * 0.8 * trunk, tip, 0.009 * height_m, 4);
    }
    for leaf in 0..leaves {
        let draw = |salt: u32| unit(leaf, 100 + 16 * seed + salt);
        let (down, round) = ((2.0 * draw(0) - 1.0).acos(), TAU * draw(1));
        let out = Vec3::new(
            down.sin() * round.cos(),
            down.cos(),
            down.sin() * round.sin(),
        );
        // More of them outside than inside.
        let at = middle + crown * out * draw(2).cbrt();
        let turn = Quat::from_euler(EulerRot::YXZ, TAU * draw(3), PI * draw(4), 0.0);
        let size = height_m * (0.035 + 0.03 * draw(5));
        let corner = |x: f32, y: f32| at + turn * (size * Vec3::new(x, y, 0.0));
        faces.sheet(&[
            corner(-1.0, 0.0),
            corner(0.0, -0.6),
            corner(1.0, 0.0),
            corner(0.0, 0.6),
        ]);
    }
    faces.mesh()
}

fn bin() -> Mesh {
    let mut faces = Faces::default();
    faces.column(Vec2::ZERO, 0.28, 12, 0.05, 0.85);
    faces.column(Vec2::ZERO, 0.32, 12, 0.85, 0.92);
    faces.cone(Vec2::ZERO, 0.3, 12, 0.92, 1.05);
    faces.mesh()
}

fn hydrant() -> Mesh {
    let mut faces = Faces::default();
    faces.column(Vec2::ZERO, 0.17, 10, 0.0, 0.08);
    faces.column(Vec2::ZERO, 0.11, 10, 0.08, 0.55);
    faces.cone(Vec2::ZERO, 0.13, 10, 0.55, 0.72);
    for side in [Vec3::X, Vec3::NEG_X, Vec3::Z] {
        let at = Vec3::Y * 0.42;
        faces.bar(at, at + 0.2 * side, 0.055, 8);
    }
    faces.mesh()
}

fn bench() -> Mesh {
    let mut faces = Faces::default();
    for slat in 0..5 {
        let at = Vec2::new(0.0, 0.11 * (slat as f32 - 2.0));
        faces.block(at, Vec2::new(0.9, 0.045), 0.42, 0.46);
    }
    for slat in 0..3 {
        let bottom = 0.55 + 0.14 * slat as f32;
        faces.block(
            Vec2::new(0.0, 0.28),
            Vec2::new(0.9, 0.02),
            bottom,
            bottom + 0.1,
        );
    }
    for end in [-0.75, 0.75] {
        faces.block(Vec2::new(end, 0.0), Vec2::new(0.04, 0.26), 0.0, 0.42);
        faces.block(Vec2::new(end, 0.3), Vec2::new(0.04, 0.02), 0.0, 0.95);
    }
    faces.mesh()
}

/// Hoops that bicycles lean on.
fn rack() -> Mesh {
    let mut faces = Faces::default();
    for hoop in 0..5 {
        let x = 0.8 * (hoop as f32 - 2.0);
        let at = |step: i32| {
            let angle = PI * step as f32 / 8.0;
            Vec3::new(x, 0.85 * angle.sin(), 0.4 * angle.cos())
        };
        for step in 0..8 {
            faces.bar(at(step), at(step + 1), 0.03, 5);
        }
    }
    faces.mesh()
}

fn railing() -> Mesh {
    let mut faces = Faces::default();
    for bar in 0..=24 {
        let x = 0.2 * (bar as f32 - 12.0);
        faces.column(Vec2::new(x, 0.0), 0.015, 5, 0.0, 1.0);
    }
    for bottom in [0.12, 0.95] {
        faces.block(Vec2::ZERO, Vec2::new(2.45, 0.025), bottom, bottom + 0.05);
    }
    faces.mesh()
}

fn street_lamp() -> Mesh {
    let mut faces = Faces::default();
    faces.column(Vec2::ZERO, 0.16, 10, 0.0, 0.9);
    faces.column(Vec2::ZERO, 0.08, 8, 0.9, 7.0);
    let at = |step: i32| {
        let angle = FRAC_PI_2 * step as f32 / 5.0;
        Vec3::new(0.0, 7.0 + 0.8 * angle.sin(), 1.4 * (1.0 - angle.cos()))
    };
    for step in 0..5 {
        faces.bar(at(step), at(step + 1), 0.06, 6);
    }
    faces.block(Vec2::new(0.0, 1.8), Vec2::new(0.16, 0.45), 7.7, 7.88);
    faces.mesh()
}

fn signal() -> Mesh {
    let mut faces = Faces::default();
    faces.column(Vec2::ZERO, 0.08, 8, 0.0, 3.6);
    faces.block(Vec2::ZERO, Vec2::new(0.18, 0.15), 2.5, 3.5);
    for light in 0..3 {
        let at = Vec3::new(0.0, 2.68 + 0.31 * light as f32, 0.15);
        faces.bar(at, at + Vec3::Z * 0.12, 0.12, 14);
    }
    faces.mesh()
}

/// A stall with crates of goods under a roof on four posts.
fn stall() -> Mesh {
    let mut faces = Faces::default();
    for x in [-1.4, 1.4] {
        for z in [-0.8, 0.8] {
            faces.column(Vec2::new(x, z), 0.04, 5, 0.0, 2.3);
        }
    }
    faces.cone(Vec2::ZERO, 2.1, 8, 2.25, 2.9);
    faces.block(Vec2::ZERO, Vec2::new(1.3, 0.6), 0.0, 0.8);
    for index in 0..28 {
        let at = Vec2::new(
            0.36 * ((index % 7) as f32 - 3.0),
            0.3 * ((index / 7) as f32 - 1.5),
        );
        let top = 0.86 + 0.15 * unit(index, 41);
        faces.block(at, Vec2::new(0.15, 0.12), 0.8, top);
    }
    faces.mesh()
}

fn wheel(faces: &mut Faces, at: Vec3, radius: f32) {
    let out = Vec3::Z * at.z.signum();
    faces.bar(at - 0.18 * out, at, radius, 14);
    faces.bar(at, at + 0.03 * out, 0.55 * radius, 8);
}

fn car() -> Mesh {
    let mut faces = Faces::default();
    let hull = |half: Vec2, cut: f32| {
        [
            Vec2::new(-half.x, -half.y + cut),
            Vec2::new(-half.x + cut, -half.y),
            Vec2::new(half.x - cut, -half.y),
            Vec2::new(half.x, -half.y + cut),
            Vec2::new(half.x, half.y - cut),
            Vec2::new(half.x - cut, half.y),
            Vec2::new(-half.x + cut, half.y),
            Vec2::new(-half.x, half.y - cut),
        ]
    };
    faces.prism(&hull(Vec2::new(2.2, 0.9), 0.25), 0.3, 0.85);
    faces.prism(
        &hull(Vec2::new(1.3, 0.8), 0.2).map(|corner| corner - Vec2::new(0.2, 0.0)),
        0.85,
        1.4,
    );
    for x in [-1.35, 1.35] {
        for z in [-0.9, 0.9] {
            wheel(&mut faces, Vec3::new(x, 0.33, z), 0.33);
        }
    }
    for z in [-0.65, 0.65] {
        faces.block(Vec2::new(2.2, z), Vec2::new(0.04, 0.16), 0.6, 0.75);
        faces.block(Vec2::new(-2.2, z), Vec2::new(0.04, 0.16), 0.6, 0.75);
        faces.block(Vec2::new(0.75, 1.5 * z), Vec2::new(0.08, 0.1), 0.95, 1.08);
    }
    faces.mesh()
}

fn bus() -> Mesh {
    let mut faces = Faces::default();
    faces.block(Vec2::ZERO, Vec2::new(5.8, 1.25), 0.35, 3.1);
    for window in 0..9 {
        let x = 1.2 * (window as f32 - 4.0);
        for z in [-1.26, 1.26] {
            faces.block(Vec2::new(x, z), Vec2::new(0.52, 0.02), 1.5, 2.6);
        }
    }
    for x in [-3.6, 3.4, 4.3] {
        for z in [-1.25, 1.25] {
            wheel(&mut faces, Vec3::new(x, 0.48, z), 0.48);
        }
    }
    faces.block(Vec2::new(-2.0, 0.0), Vec2::new(1.2, 0.8), 3.1, 3.35);
    faces.mesh()
}

fn air_unit() -> Mesh {
    let mut faces = Faces::default();
    faces.block(Vec2::ZERO, Vec2::new(1.6, 0.9), 0.2, 1.5);
    for x in [-0.8, 0.8] {
        faces.column(Vec2::new(x, 0.0), 0.65, 16, 1.5, 1.6);
        for blade in 0..6 {
            let angle = TAU * blade as f32 / 6.0;
            let at = |angle: f32, out: f32, y: f32| {
                let flat = Vec2::new(x, 0.0) + out * Vec2::from_angle(angle);
                Vec3::new(flat.x, y, flat.y)
            };
            faces.sheet(&[
                at(angle, 0.1, 1.63),
                at(angle, 0.6, 1.63),
                at(angle + 0.5, 0.6, 1.72),
                at(angle + 0.5, 0.1, 1.72),
            ]);
        }
    }
    for index in 0..12 {
        let at = Vec2::new(0.26 * (index as f32 - 5.5), 0.92);
        faces.block(at, Vec2::new(0.09, 0.02), 0.4, 1.3);
    }
    faces.mesh()
}

/// A water tank on legs with rings around it.
fn tank() -> Mesh {
    let mut faces = Faces::default();
    for corner in 0..4 {
        let foot = 1.3 * Vec2::from_angle(FRAC_PI_2 * (corner as f32 + 0.5));
        faces.column(foot, 0.1, 5, 0.0, 2.4);
    }
    faces.column(Vec2::ZERO, 1.7, 20, 2.4, 5.4);
    for ring in 0..4 {
        let bottom = 2.7 + 0.7 * ring as f32;
        faces.column(Vec2::ZERO, 1.74, 20, bottom, bottom + 0.07);
    }
    faces.cone(Vec2::ZERO, 1.85, 20, 5.4, 6.5);
    faces.mesh()
}

/// A lattice mast on three legs.
fn mast() -> Mesh {
    let mut faces = Faces::default();
    let levels = 10;
    let at = |leg: i32, level: i32| {
        let part = level as f32 / levels as f32;
        let out = 0.7 * (1.0 - 0.85 * part);
        let flat = out * Vec2::from_angle(TAU * leg as f32 / 3.0);
        Vec3::new(flat.x, 9.0 * part, flat.y)
    };
    for leg in 0..3 {
        faces.bar(at(leg, 0), at(leg, levels), 0.05, 5);
        for level in 0..levels {
            faces.bar(at(leg, level), at(leg + 1, level + 1), 0.025, 3);
            faces.bar(at(leg, level), at(leg + 1, level), 0.025, 3);
        }
    }
    faces.bar(Vec3::Y * 9.0, Vec3::Y * 11.0, 0.03, 4);
    faces.mesh()
}

/// A bowl on a post.
fn dish() -> Mesh {
    let mut faces = Faces::default();
    faces.column(Vec2::ZERO, 0.08, 8, 0.0, 1.2);
    let (rings, around) = (5, 16);
    let tilt = Quat::from_rotation_x(0.9);
    let at = |ring: u32, slice: u32| {
        let out = ring as f32 / rings as f32;
        let flat = out * Vec2::from_angle(TAU * slice as f32 / around as f32);
        Vec3::Y * 1.5 + tilt * Vec3::new(flat.x, 0.4 * out * out, flat.y)
    };
    for ring in 0..rings {
        for slice in 0..around {
            let (a, b) = (at(ring, slice), at(ring, slice + 1));
            let (c, d) = (at(ring + 1, slice + 1), at(ring + 1, slice));
            if ring == 0 {
                faces.sheet(&[a, c, d]);
            } else {
                faces.sheet(&[a, b, c, d]);
            }
        }
    }
    let focus = Vec3::Y * 1.5 + tilt * Vec3::Y * 0.7;
    for slice in [0, 5, 11] {
        faces.bar(at(rings, slice), focus, 0.02, 4);
    }
    faces.mesh()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_triangles_are_very_different() {
        let kinds = [
            park_kinds(),
            pavement_kinds(),
            vehicle_kinds(),
            roof_kinds(),
        ];
        let mut counts = Vec::new();
        let mut sizes = Vec::new();
        for (mesh, _) in kinds.into_iter().flatten() {
            counts.push(shapes::triangles(&mesh));
            let corners = shapes::corners(&mesh);
            let (low, high) = corners
                .iter()
                .flatten()
                .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), at| {
                    (low.min(*at), high.max(*at))
                });
            assert!(low.is_finite() && low.y > -0.1, "it stands: {low}");
            sizes.push((high - low).max_element());
        }
        counts.sort_unstable();
        sizes.sort_by(f32::total_cmp);
        assert!(
            counts[0] < 100 && counts[counts.len() - 1] > 1_500,
            "{counts:?}"
        );
        assert!(sizes[0] < 1.2 && sizes[sizes.len() - 1] > 9.0, "{sizes:?}");
    }
}
