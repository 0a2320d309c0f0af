//! The hard cases of terrain, one scene each: what every pass and its twin are held against.

use std::f32::consts::PI;

use bevy::{
    math::{Affine3A, DAffine3, DMat3, Mat4, Quat, UVec2, Vec3, Vec4},
    transform::components::Transform,
};
use bevy_skyline::terrain::{
    HeightField, HeightSamples,
    view_rays::{ViewInputs, ViewRays},
};

/// One camera before one terrain.
pub struct Scene {
    /// Named after what is hard in it.
    pub name: &'static str,
    pub field: HeightField,
    /// The terrain's entity.
    pub world_from_local: Transform,
    /// The camera's entity.
    pub camera: Transform,
    /// Reverse-Z, as Bevy's own projections give it.
    pub clip_from_view: Mat4,
    pub size_px: UVec2,
}

impl Scene {
    /// The terrain's grid space (cells, stored heights) from the camera's space.
    pub fn grid_from_view(&self) -> DAffine3 {
        let world_from_local = as_f64(self.world_from_local.compute_affine());
        let world_from_view = as_f64(self.camera.compute_affine());
        self.field.grid_from_local() * world_from_local.inverse() * world_from_view
    }

    pub fn inputs(&self, max_error_px: f32) -> ViewInputs {
        let (highest, lowest) = self.field.pyramid().top();
        ViewInputs {
            clip_from_view: self.clip_from_view,
            grid_from_view: self.grid_from_view(),
            size_px: self.size_px,
            cells: self.field.cells(),
            height_range: (lowest, highest),
            whole_heights: matches!(self.field.samples(), HeightSamples::U16(_)),
            max_error_px,
        }
    }

    /// The rays of the picture. Every scene has some.
    pub fn rays(&self) -> ViewRays {
        ViewRays::new(&self.inputs(0.0)).unwrap_or_else(|| panic!("{} has no rays", self.name))
    }

    /// Middles of all pixels.
    pub fn pixels(&self) -> impl Iterator<Item = bevy::math::Vec2> + use<> {
        let size = self.size_px;
        (0..size.y).flat_map(move |y| (0..size.x).map(move |x| UVec2::new(x, y).as_vec2() + 0.5))
    }

    fn world_from_local(mut self, transform: Transform) -> Self {
        self.camera = transform * self.camera;
        self.world_from_local = transform;
        self
    }

    pub fn size(mut self, width: u32, height: u32) -> Self {
        self.size_px = UVec2::new(width, height);
        self
    }

    pub fn projection(mut self, clip_from_view: Mat4) -> Self {
        self.clip_from_view = clip_from_view;
        self
    }
}

/// An entity's transform in `f64`: the numbers are the same, what is made of them is not rounded.
pub fn as_f64(a: Affine3A) -> DAffine3 {
    DAffine3 {
        matrix3: DMat3::from_cols(
            Vec3::from(a.matrix3.x_axis).as_dvec3(),
            Vec3::from(a.matrix3.y_axis).as_dvec3(),
            Vec3::from(a.matrix3.z_axis).as_dvec3(),
        ),
        translation: Vec3::from(a.translation).as_dvec3(),
    }
}

pub fn perspective(fov_deg: f32, aspect: f32, near: f32) -> Mat4 {
    Mat4::perspective_infinite_reverse_rh(fov_deg.to_radians(), aspect, near)
}

/// As Bevy's `OrthographicProjection`: near and far exchanged.
pub fn orthographic(width: f32, height: f32, near: f32, far: f32) -> Mat4 {
    let (x, y) = (0.5 * width, 0.5 * height);
    Mat4::orthographic_rh(-x, x, -y, y, far, near)
}

/// A perspective whose axis does not meet the middle of the picture, by `shift` in NDC.
pub fn off_centre(clip_from_view: Mat4, shift: (f32, f32)) -> Mat4 {
    let mut shifted = clip_from_view;
    shifted.z_axis += Vec4::new(shift.0, shift.1, 0.0, 0.0);
    shifted
}

/// From `eye` to `target`; -Z is up where the camera looks straight up or down.
pub fn look(eye: [f32; 3], target: [f32; 3]) -> Transform {
    let (eye, target) = (Vec3::from(eye), Vec3::from(target));
    let vertical = eye.x == target.x && eye.z == target.z;
    let up = if vertical { Vec3::NEG_Z } else { Vec3::Y };
    Transform::from_translation(eye).looking_at(target, up)
}

pub fn scene(name: &'static str, field: HeightField, camera: Transform) -> Scene {
    Scene {
        name,
        field,
        world_from_local: Transform::IDENTITY,
        camera,
        clip_from_view: perspective(60.0, 4.0 / 3.0, 0.1),
        size_px: UVec2::new(64, 48),
    }
}

/// A number from 0 to 1 that looks random.
fn noise(i: u32, j: u32) -> f32 {
    let mut x = (i.wrapping_mul(0x9e37_79b9) ^ j.wrapping_mul(0x85eb_ca6b)).wrapping_add(1);
    x ^= x >> 16;
    x = x.wrapping_mul(0x21f0_aaad);
    x ^= x >> 15;
    x = x.wrapping_mul(0x735a_2d97);
    (x ^ (x >> 15)) as f32 / u32::MAX as f32
}

/// Between 0 and 1: two waves and a little roughness.
fn hill(i: u32, j: u32) -> f32 {
    let (x, z) = (i as f32, j as f32);
    0.45 + 0.25 * (x * 0.13).sin() + 0.2 * (z * 0.09 + 0.5).cos() + 0.1 * noise(i, j)
}

/// Codes from 0 to `top_m`.
pub fn hills(width: u32, height: u32, texel_m: f32, top_m: f32) -> HeightField {
    let size = UVec2::new(width, height);
    HeightField::from_fn(size, texel_m, (0.0, top_m), |i, j| top_m * hill(i, j)).expect("a field")
}

pub fn floats(width: u32, height: u32, texel_m: f32, h: impl Fn(u32, u32) -> f32) -> HeightField {
    let samples = (0..height).flat_map(|j| (0..width).map(move |i| (i, j)));
    let samples = samples.map(|(i, j)| h(i, j)).collect();
    HeightField::from_f32(UVec2::new(width, height), texel_m, samples).expect("a field")
}

pub fn codes(
    width: u32,
    height: u32,
    texel_m: f32,
    top_m: f32,
    h: impl Fn(u32, u32) -> u16,
) -> HeightField {
    let samples = (0..height).flat_map(|j| (0..width).map(move |i| (i, j)));
    let samples = samples.map(|(i, j)| h(i, j)).collect();
    HeightField::from_u16(UVec2::new(width, height), texel_m, (0.0, top_m), samples)
        .expect("a field")
}

/// Height of sample (i, j), as the nearest `f32`.
fn sample_m(field: &HeightField, i: u32, j: u32) -> f32 {
    field.sample_m(i, j) as f32
}

/// Every hard case. Names are unique.
pub fn scenes() -> Vec<Scene> {
    let mut scenes = Vec::new();
    cameras(&mut scenes);
    aligned_rays(&mut scenes);
    grounds(&mut scenes);
    shapes(&mut scenes);
    scales(&mut scenes);
    projections(&mut scenes);
    transforms(&mut scenes);
    scenes
}

/// Above, on, under and inside the ground, inside and outside the footprint.
fn cameras(scenes: &mut Vec<Scene>) {
    let field = || hills(129, 97, 10.0, 400.0);
    let ground = |i, j| sample_m(&field(), i, j);
    scenes.push(scene(
        "above",
        field(),
        look([640.0, 900.0, 1500.0], [640.0, 150.0, 480.0]),
    ));
    scenes.push(
        scene(
            "above_odd_size",
            field(),
            look([640.0, 600.0, 480.0], [100.0, 100.0, 90.0]),
        )
        .size(61, 37),
    );
    let y = ground(64, 48);
    scenes.push(scene(
        "low_to_the_horizon",
        field(),
        look([640.0, y + 2.0, 480.0], [0.0, y + 2.0, 0.0]),
    ));
    scenes.push(
        scene(
            "on_a_sample",
            field(),
            look([640.0, y, 480.0], [700.0, y + 3.0, 400.0]),
        )
        .projection(perspective(60.0, 4.0 / 3.0, 0.02)),
    );
    // A sample of whole metres, so that the camera's f32 position is exactly on the surface.
    let exact = || floats(65, 65, 2.0, |i, j| (20.0 * hill(i, j)).round());
    let y = sample_m(&exact(), 32, 32);
    let on = [64.0, y, 64.0];
    scenes.push(
        scene(
            "orthographic_starting_on_a_sample",
            exact(),
            look(on, [64.0, y, 0.0]),
        )
        .size(63, 47)
        .projection(orthographic(63.0, 47.0, 0.0, 500.0)),
    );
    scenes.push(
        scene(
            "orthographic_down_from_a_sample",
            exact(),
            look(on, [64.0, y - 1.0, 64.0]),
        )
        .size(61, 37)
        .projection(orthographic(30.0, 18.0, 0.0, 500.0)),
    );
    // The middle ray starts on a sample exactly, rises, and comes down in the same cell.
    let twisted = floats(9, 9, 1.0, |i, j| (i * j) as f32);
    scenes.push(
        scene(
            "orthographic_from_a_sample_over_a_saddle",
            twisted,
            look([4.0, 16.0, 4.0], [5.0, 24.5, 5.0]),
        )
        .size(61, 37)
        .projection(orthographic(0.61, 0.37, 0.0, 100.0)),
    );
    let y = ground(64, 48);
    scenes.push(scene(
        "inside_the_ground",
        field(),
        look([640.0, y - 3.0, 480.0], [900.0, y + 40.0, 300.0]),
    ));
    scenes.push(scene(
        "deep_inside_looking_up",
        field(),
        look([640.0, -50.0, 480.0], [640.0, 300.0, 485.0]),
    ));
    scenes.push(scene(
        "straight_up_from_under",
        field(),
        look([640.0, -500.0, 480.0], [640.0, 0.0, 480.0]),
    ));
    scenes.push(scene(
        "inside_looking_down",
        field(),
        look([640.0, y - 30.0, 480.0], [650.0, -500.0, 480.0]),
    ));
    // In the last cell, coming out into the air there, on the way out of the footprint.
    let slope = || codes(65, 65, 10.0, 655.35, |i, _| 30_000 - 400 * i as u16);
    let y = sample_m(&slope(), 64, 0);
    scenes.push(scene(
        "inside_the_last_cell_looking_out",
        slope(),
        look([636.0, y + 0.5, 320.0], [660.0, y + 6.0, 320.0]),
    ));
    scenes.push(scene(
        "inside_near_a_corner_looking_out",
        slope(),
        look([634.0, y + 1.2, 6.0], [660.0, y + 8.0, -20.0]),
    ));
    scenes.push(scene(
        "walls_from_outside",
        field(),
        look([-600.0, 250.0, 1500.0], [600.0, 0.0, 480.0]),
    ));
    scenes.push(scene(
        "walls_from_below_the_lowest",
        field(),
        look([640.0, -300.0, 1400.0], [640.0, 100.0, 500.0]),
    ));
    scenes.push(scene(
        "corner_from_outside",
        field(),
        look([-40.0, 200.0, -40.0], [50.0, 180.0, 45.0]),
    ));
    // The ground rises along the border: outside it, its level is above the rays.
    let ramp = || codes(65, 129, 10.0, 655.35, |_, j| 10_000 + 250 * j as u16);
    scenes.push(scene(
        "along_the_border_leaving",
        ramp(),
        look([625.0, 160.0, 20.0], [645.0, 150.0, 220.0]),
    ));
    scenes.push(
        scene(
            "on_the_border",
            ramp(),
            look([640.0, 300.0, 20.0], [640.0, 300.0, 220.0]),
        )
        .size(61, 37),
    );
    scenes.push(scene(
        "past_it",
        field(),
        look([-100.0, 200.0, -100.0], [1400.0, 250.0, -60.0]),
    ));
}

/// Rays exactly along axes, borders, through samples.
fn aligned_rays(scenes: &mut Vec<Scene>) {
    let field = || hills(65, 65, 8.0, 200.0);
    scenes.push(scene(
        "straight_down",
        field(),
        look([256.0, 700.0, 256.0], [256.0, 0.0, 256.0]),
    ));
    scenes.push(
        scene(
            "straight_down_odd_size",
            field(),
            look([252.0, 700.0, 252.0], [252.0, 0.0, 252.0]),
        )
        .size(61, 37),
    );
    // Columns of pixels exactly on cell borders, rows too.
    scenes.push(
        scene(
            "orthographic_down_on_borders",
            field(),
            look([256.0, 700.0, 256.0], [256.0, 0.0, 256.0]),
        )
        .size(65, 49)
        .projection(orthographic(520.0, 392.0, 0.0, 2000.0)),
    );
    for (name, eye, target) in [
        ("along_plus_x", [-100.0, 90.0, 252.0], [600.0, 90.0, 252.0]),
        ("along_minus_x", [600.0, 90.0, 252.0], [-100.0, 90.0, 252.0]),
        ("along_plus_z", [252.0, 90.0, -100.0], [252.0, 90.0, 600.0]),
        (
            "along_a_cell_border",
            [256.0, 90.0, 600.0],
            [256.0, 90.0, 0.0],
        ),
        (
            "along_a_cell_border_down",
            [-20.0, 300.0, 248.0],
            [500.0, 20.0, 248.0],
        ),
        (
            "along_a_diagonal",
            [-16.0, 120.0, -16.0],
            [512.0, 60.0, 512.0],
        ),
    ] {
        scenes.push(scene(name, field(), look(eye, target)).size(61, 37));
    }
    scenes.push(
        scene(
            "orthographic_along_x",
            field(),
            look([-100.0, 90.0, 256.0], [600.0, 90.0, 256.0]),
        )
        .size(65, 49)
        .projection(orthographic(520.0, 196.0, 0.0, 3000.0)),
    );
    let (i, j) = (40, 21);
    let sample = [8.0 * i as f32, sample_m(&field(), i, j), 8.0 * j as f32];
    scenes.push(
        scene(
            "through_a_sample",
            field(),
            look([0.0, 400.0, 500.0], sample),
        )
        .size(61, 37),
    );
}

/// Shapes of ground that are hard on roots and bounds.
fn grounds(scenes: &mut Vec<Scene>) {
    // A ridge whose sides fall by one part in a million.
    let ridge = || floats(129, 33, 1.0, |i, _| -1e-6 * (i as f32 - 64.0).abs());
    let graze = |y: f32, drop: f32| {
        Transform::from_xyz(-8.0, y, 16.0)
            .with_rotation(Quat::from_rotation_y(-PI / 2.0) * Quat::from_rotation_x(-drop))
    };
    scenes.push(
        scene("grazing_a_ridge", ridge(), graze(0.0, 1e-6))
            .projection(orthographic(30.0, 2e-4, 0.0, 1000.0))
            .size(32, 48),
    );
    scenes.push(
        scene("ridge_in_perspective", ridge(), graze(2e-5, 1e-6))
            .projection(perspective(0.01, 1.0, 0.01)),
    );
    let sharp = || floats(129, 33, 1.0, |i, _| 10.0 - (i as f32 - 64.0).abs());
    scenes.push(scene(
        "over_a_sharp_ridge",
        sharp(),
        look([-30.0, 10.5, 16.0], [64.0, 10.0, 16.0]),
    ));
    let flat = || floats(65, 65, 4.0, |_, _| 12.5);
    scenes.push(scene(
        "flat",
        flat(),
        look([-20.0, 40.0, -30.0], [128.0, 12.0, 128.0]),
    ));
    scenes.push(
        scene(
            "flat_from_its_own_height",
            flat(),
            look([128.0, 12.5, 128.0], [0.0, 12.5, 0.0]),
        )
        .size(61, 37),
    );
    let zero = HeightField::from_u16(UVec2::new(33, 33), 4.0, (7.0, 7.0), vec![0; 33 * 33]);
    scenes.push(scene(
        "flat_without_a_range",
        zero.expect("a field"),
        look([64.0, 9.0, 140.0], [64.0, 7.0, 0.0]),
    ));
    let spike = || {
        codes(65, 65, 4.0, 100.0, |i, j| {
            if (i, j) == (31, 33) { 65535 } else { 0 }
        })
    };
    scenes.push(scene(
        "one_sample_spike",
        spike(),
        look([20.0, 60.0, 250.0], [124.0, 40.0, 132.0]),
    ));
    scenes.push(
        scene(
            "spike_from_above",
            spike(),
            look([124.0, 300.0, 132.0], [124.0, 0.0, 132.0]),
        )
        .size(61, 37),
    );
    let pit = codes(65, 65, 4.0, 100.0, |i, j| {
        if (i, j) == (31, 33) { 0 } else { 65535 }
    });
    scenes.push(scene(
        "one_sample_pit",
        pit,
        look([90.0, 180.0, 160.0], [124.0, 80.0, 132.0]),
    ));
    let cliffs = || {
        codes(65, 65, 4.0, 500.0, |i, j| {
            if noise(i / 3, j / 3) < 0.5 { 0 } else { 65535 }
        })
    };
    scenes.push(scene(
        "full_range_cliffs",
        cliffs(),
        look([130.0, 700.0, 330.0], [130.0, 200.0, 130.0]),
    ));
    scenes.push(scene(
        "among_full_range_cliffs",
        cliffs(),
        look([130.0, 250.0, 130.0], [20.0, 240.0, 60.0]),
    ));
    let jagged = || codes(65, 65, 4.0, 500.0, |i, j| (65535.0 * noise(i, j)) as u16);
    scenes.push(scene(
        "noise",
        jagged(),
        look([130.0, 700.0, 330.0], [130.0, 200.0, 130.0]),
    ));
    scenes.push(scene(
        "inside_noise",
        jagged(),
        look([130.0, 250.0, 130.0], [20.0, 240.0, 60.0]),
    ));
    // One saddle a cell, a steep one.
    let saddles = codes(
        65,
        65,
        4.0,
        100.0,
        |i, j| if (i + j) % 2 == 0 { 0 } else { 65535 },
    );
    scenes.push(scene(
        "saddles",
        saddles,
        look([-40.0, 60.0, 10.0], [130.0, 50.0, 130.0]),
    ));
    let negative = floats(97, 65, 5.0, |i, j| -300.0 + 120.0 * hill(i, j));
    scenes.push(scene(
        "negative_heights",
        negative,
        look([240.0, -100.0, 400.0], [240.0, -260.0, 160.0]),
    ));
    // Heights far from zero lose bits relative to the camera.
    let high = floats(97, 65, 5.0, |i, j| 800_000.0 + 120.0 * hill(i, j));
    scenes.push(scene(
        "heights_far_from_zero",
        high,
        look([240.0, 800_250.0, 400.0], [240.0, 800_040.0, 160.0]),
    ));
}

/// Fields of all proportions.
fn shapes(scenes: &mut Vec<Scene>) {
    let patch = || {
        codes(2, 2, 10.0, 10.0, |i, j| {
            [[0, 65535], [60000, 1000]][j as usize][i as usize]
        })
    };
    scenes.push(scene(
        "two_by_two",
        patch(),
        look([-6.0, 14.0, 22.0], [5.0, 3.0, 5.0]),
    ));
    scenes.push(scene(
        "two_by_two_inside",
        patch(),
        look([5.0, 4.0, 5.0], [20.0, 6.0, 9.0]),
    ));
    scenes.push(scene(
        "one_cell_wide",
        hills(2, 97, 4.0, 60.0),
        look([30.0, 90.0, 420.0], [2.0, 30.0, 190.0]),
    ));
    scenes.push(scene(
        "one_cell_deep",
        hills(97, 2, 4.0, 60.0),
        look([-30.0, 60.0, 40.0], [190.0, 20.0, 2.0]),
    ));
    scenes.push(
        scene(
            "within_one_cell_wide",
            hills(2, 97, 4.0, 60.0),
            look([2.0, 50.0, 300.0], [2.0, 30.0, 0.0]),
        )
        .size(61, 37),
    );
    scenes.push(scene(
        "not_a_power_of_two",
        hills(131, 77, 4.0, 120.0),
        look([500.0, 160.0, 300.0], [100.0, 30.0, 100.0]),
    ));
    scenes.push(scene(
        "one_past_a_power_of_two",
        hills(66, 34, 4.0, 60.0),
        look([-30.0, 70.0, -40.0], [200.0, 20.0, 100.0]),
    ));
}

/// Large and small worlds, and far ones.
fn scales(scenes: &mut Vec<Scene>) {
    let far = Vec3::new(1e7, 3000.0, -1e7);
    scenes.push(Scene {
        world_from_local: Transform::from_translation(far),
        camera: look(
            (far + Vec3::new(500.0, 600.0, 1100.0)).to_array(),
            (far + Vec3::new(500.0, 100.0, 400.0)).to_array(),
        ),
        ..scene(
            "ten_thousand_kilometres_from_the_origin",
            hills(129, 97, 10.0, 400.0),
            Transform::IDENTITY,
        )
    });
    scenes.push(
        scene(
            "millimetre_texels",
            hills(129, 97, 0.001, 0.04),
            look([0.06, 0.08, 0.14], [0.06, 0.01, 0.04]),
        )
        .projection(perspective(60.0, 4.0 / 3.0, 0.001)),
    );
    scenes.push(scene(
        "ten_kilometre_texels",
        hills(129, 97, 10_000.0, 9000.0),
        look([600e3, 60e3, 1200e3], [640e3, 0.0, 400e3]),
    ));
    scenes.push(scene(
        "man_on_ten_kilometre_texels",
        hills(129, 97, 10_000.0, 9000.0),
        look([645e3, 9002.0, 485e3], [0.0, 4000.0, 0.0]),
    ));
    scenes.push(
        scene(
            "telephoto",
            hills(129, 97, 10.0, 400.0),
            look([60_000.0, 30_000.0, 90_000.0], [640.0, 180.0, 480.0]),
        )
        .projection(perspective(0.02, 4.0 / 3.0, 0.1)),
    );
    scenes.push(
        scene(
            "telephoto_along_the_ground",
            hills(129, 97, 10.0, 400.0),
            look([100_000.0, 260.0, 500.0], [640.0, 250.0, 480.0]),
        )
        .projection(perspective(0.02, 4.0 / 3.0, 0.1)),
    );
    scenes.push(
        scene(
            "large_field",
            hills(1025, 769, 30.0, 3000.0),
            look([300.0, 2600.0, 300.0], [25_000.0, 800.0, 18_000.0]),
        )
        .size(96, 64),
    );
}

/// Every kind of projection.
fn projections(scenes: &mut Vec<Scene>) {
    let field = || hills(129, 97, 10.0, 400.0);
    let camera = look([1400.0, 900.0, 1500.0], [640.0, 150.0, 480.0]);
    let size = (1200.0, 900.0);
    scenes.push(
        scene("orthographic", field(), camera)
            .projection(orthographic(size.0, size.1, 0.0, 4000.0)),
    );
    scenes.push(
        scene("orthographic_cut_by_near_and_far", field(), camera)
            .projection(orthographic(size.0, size.1, 1300.0, 1500.0)),
    );
    scenes.push(
        scene(
            "orthographic_starting_behind_the_camera",
            field(),
            look([640.0, 200.0, 480.0], [600.0, 150.0, 300.0]),
        )
        .projection(orthographic(900.0, 675.0, -2000.0, 2000.0)),
    );
    scenes.push(
        scene(
            "orthographic_inside_the_ground",
            field(),
            look([640.0, 100.0, 480.0], [600.0, 130.0, 300.0]),
        )
        .projection(orthographic(900.0, 675.0, 0.0, 2000.0)),
    );
    let wide = perspective(60.0, 4.0 / 3.0, 0.1);
    scenes.push(scene("off_centre", field(), camera).projection(off_centre(wide, (0.4, -0.7))));
    scenes.push(
        scene("far_off_centre", field(), camera)
            .projection(off_centre(perspective(20.0, 1.0, 1.0), (2.0, 1.0))),
    );
    // A far plane that is not infinite.
    let finite = Mat4::perspective_rh(60f32.to_radians(), 4.0 / 3.0, 1200.0, 1.0);
    scenes.push(scene("finite_far_plane", field(), camera).projection(finite));
    scenes.push(
        scene("near_plane_in_the_ground", field(), camera).projection(perspective(
            60.0,
            4.0 / 3.0,
            1300.0,
        )),
    );
    scenes.push(
        scene(
            "very_wide",
            field(),
            look([640.0, 420.0, 480.0], [600.0, 300.0, 300.0]),
        )
        .projection(perspective(160.0, 1.5, 0.1)),
    );
}

/// Terrains that do not lie as they were made.
fn transforms(scenes: &mut Vec<Scene>) {
    let field = || hills(97, 65, 10.0, 300.0);
    let seen = |name| {
        scene(
            name,
            field(),
            look([900.0, 500.0, 900.0], [400.0, 100.0, 300.0]),
        )
    };
    let turned = Quat::from_euler(bevy::math::EulerRot::YXZ, 0.7, 0.4, -0.3);
    let here = Vec3::new(-3000.0, 120.0, 800.0);
    scenes.push(
        seen("translated_and_rotated")
            .world_from_local(Transform::from_translation(here).with_rotation(turned)),
    );
    scenes.push(
        seen("upside_down").world_from_local(Transform::from_rotation(Quat::from_rotation_z(PI))),
    );
    // The camera stays rigid; only the terrain is stretched.
    let scaled = |name, scale: Vec3| {
        let transform = Transform::from_translation(here)
            .with_rotation(turned)
            .with_scale(scale);
        let eye = transform.transform_point(Vec3::new(900.0, 500.0, 900.0));
        let target = transform.transform_point(Vec3::new(400.0, 100.0, 300.0));
        Scene {
            world_from_local: transform,
            camera: Transform::from_translation(eye)
                .looking_at(target, transform.rotation * Vec3::Y),
            ..scene(name, field(), Transform::IDENTITY)
        }
    };
    scenes.push(scaled("stretched", Vec3::new(2.0, 0.4, 0.7)));
    scenes.push(scaled("stretched_a_hundredfold", Vec3::new(10.0, 1.0, 0.1)));
    scenes.push(scaled("mirrored_in_x", Vec3::new(-1.0, 1.0, 1.0)));
    scenes.push(scaled("mirrored_in_y", Vec3::new(1.0, -1.0, 1.0)));
    scenes.push(scaled("mirrored_and_stretched", Vec3::new(1.5, 2.0, -0.5)));
}

#[test]
fn scenes_have_names_of_their_own_and_rays() {
    let scenes = scenes();
    let names: std::collections::HashSet<_> = scenes.iter().map(|scene| scene.name).collect();
    assert_eq!(names.len(), scenes.len());
    for scene in &scenes {
        let rays = scene.rays();
        assert_eq!(rays.cells, scene.field.cells().as_ivec2(), "{}", scene.name);
        assert_eq!(
            scene.pixels().count() as u32,
            scene.size_px.x * scene.size_px.y
        );
    }
}
