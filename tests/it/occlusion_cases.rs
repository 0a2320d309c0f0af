//! What occlusion tests are tried on: the named hard cases, and random views.

use core::f32::consts::{FRAC_PI_2, PI};

use bevy::{
    math::{Affine3A, Mat3A, Vec3A},
    prelude::*,
};
use bevy_skyline::{
    culling::volume::{LocalBox, Proxy, SweptTriangle},
    occlusion::{DepthSampling, depth::ReducedDepth, verdict::Verdict},
};

/// Numbers that look random.
pub struct Random(pub u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    }

    pub fn below(&mut self, n: u64) -> u64 {
        self.bits() % n
    }

    /// From `low` to `high`.
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// From `low` to `high`, all magnitudes alike.
    fn scale(&mut self, low: f64, high: f64) -> f32 {
        self.within(low.ln(), high.ln()).exp() as f32
    }

    fn vec3(&mut self) -> Vec3 {
        let mut one = || self.within(-1.0, 1.0) as f32;
        Vec3::new(one(), one(), one())
    }
}

/// What is tested.
#[derive(Clone, Debug)]
pub struct Case {
    pub world: Affine3A,
    pub volume: LocalBox,
    pub turned: Option<LocalBox>,
    pub proxy: Option<Proxy>,
}

/// A case, what it is tested against, and what it must come to.
pub struct HardCase {
    pub name: &'static str,
    pub depth: ReducedDepth,
    pub case: Case,
    pub expected: Verdict,
}

const VIEWPORT: UVec2 = UVec2::new(64, 48);
const BLOCK: DepthSampling = DepthSampling::Conservative { block: 4 };
const NEAR: f32 = 0.1;

/// 90° high, 4:3, looking along −Z.
pub fn lens(near: f32) -> Mat4 {
    Mat4::perspective_infinite_reverse_rh(FRAC_PI_2, 4.0 / 3.0, near)
}

/// One unit a pixel, (0, 0) in the middle; depth 0.9 at z = −10, 0 at −100.
pub fn flat_lens() -> Mat4 {
    Mat4::orthographic_rh(-32.0, 32.0, -24.0, 24.0, 100.0, 0.0)
}

pub fn reduced(
    clip: Mat4,
    viewport: UVec2,
    sampling: DepthSampling,
    pixels: &[f32],
) -> ReducedDepth {
    ReducedDepth::from_pixels(clip, viewport, sampling, pixels).expect("sizes fit")
}

/// The same depth everywhere.
pub fn filled(clip: Mat4, depth: f32) -> ReducedDepth {
    let pixels = [depth; (VIEWPORT.x * VIEWPORT.y) as usize];
    reduced(clip, VIEWPORT, BLOCK, &pixels)
}

/// The same depth everywhere but at one pixel, through which infinity is seen.
fn holed(clip: Mat4, depth: f32, hole: UVec2) -> ReducedDepth {
    let mut pixels = [depth; (VIEWPORT.x * VIEWPORT.y) as usize];
    pixels[(hole.y * VIEWPORT.x + hole.x) as usize] = 0.0;
    reduced(clip, VIEWPORT, BLOCK, &pixels)
}

pub fn local_box(centre: Vec3, half: Vec3) -> LocalBox {
    LocalBox {
        centre,
        axes: [Vec3::X * half.x, Vec3::Y * half.y, Vec3::Z * half.z],
    }
}

pub fn placed(world: Affine3A, volume: LocalBox) -> Case {
    Case {
        world,
        volume,
        turned: None,
        proxy: None,
    }
}

fn with_turned(case: Case, centre: Vec3, half: f32) -> Case {
    let turn = Quat::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), 0.7);
    let axes = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| turn * axis * half);
    Case {
        turned: Some(LocalBox { centre, axes }),
        ..case
    }
}

pub fn boxed(x: f32, y: f32, z: f32, half: f32) -> Case {
    let volume = local_box(Vec3::new(x, y, z), Vec3::splat(half));
    placed(Affine3A::IDENTITY, volume)
}

fn with_proxy(case: Case, corners: [Vec3; 3], radius: f32) -> Case {
    let triangle = SweptTriangle { corners, radius };
    Case {
        proxy: Some(Proxy {
            triangles: vec![triangle],
        }),
        ..case
    }
}

/// A box over columns `x` and rows `y` of pixels of [`flat_lens`], at z = −50.
pub fn over_pixels(x: [f32; 2], y: [f32; 2]) -> Case {
    let min = Vec3::new(x[0] - 32.0, 24.0 - y[1], -51.0);
    let max = Vec3::new(x[1] - 32.0, 24.0 - y[0], -49.0);
    let volume = local_box(0.5 * (min + max), 0.5 * (max - min));
    placed(Affine3A::IDENTITY, volume)
}

/// Every case by name.
#[rustfmt::skip]
pub fn hard_cases() -> Vec<HardCase> {
    use Verdict::{Hidden, Outside, Visible};
    let mut all = Vec::new();
    let mut case = |name, depth: &ReducedDepth, case, expected| {
        all.push(HardCase {
            name,
            depth: depth.clone(),
            case,
            expected,
        });
    };
    // 10 m away.
    let wall = filled(lens(NEAR), NEAR / 10.0);

    case("behind a wall", &wall, boxed(0.0, 0.0, -20.0, 1.0), Hidden);
    case("before a wall", &wall, boxed(0.0, 0.0, -5.0, 1.0), Visible);
    case("in a wall", &wall, boxed(0.0, 0.0, -10.0, 1.0), Visible);
    case("touching a wall from behind", &wall, boxed(0.0, 0.0, -11.0, 1.0), Visible);
    case("just behind a wall", &wall, boxed(0.0, 0.0, -11.001, 1.0), Hidden);
    case("before the sky", &filled(lens(NEAR), 0.0), boxed(0.0, 0.0, -1e6, 1.0), Visible);
    case("behind the near plane's own depth", &filled(lens(NEAR), 1.0), boxed(0.0, 0.0, -2.0, 1.0), Hidden);

    case("behind the camera", &wall, boxed(0.0, 0.0, 20.0, 1.0), Outside);
    case("large, behind the camera", &wall, boxed(0.0, 0.0, 1e6, 9e5), Outside);
    case("around the camera", &wall, boxed(0.0, 0.0, 0.0, 2.0), Visible);
    case("a corner at the eye", &wall, boxed(1.0, 1.0, -1.0, 1.0), Visible);
    // A rasteriser may move it onto the one row there is.
    let line = reduced(flat_lens(), UVec2::new(4, 1), DepthSampling::Conservative { block: 1 }, &[1.0; 4]);
    let beside = |y| boxed(0.0, y, 0.0, 1.0);
    case("at the near plane, a hair beside the view", &line, beside(25.01), Visible);
    case("at the near plane, beside the view", &line, beside(26.0), Outside);
    case("cut by the near plane", &wall, boxed(0.0, 0.0, -0.1, 0.05), Visible);
    case("touching the near plane", &wall, boxed(0.0, 0.0, -0.2, 0.1), Visible);
    case("before the near plane", &wall, boxed(0.0, 0.0, -0.05, 0.01), Outside);
    case("beside the camera, through its plane", &wall, boxed(100.0, 0.0, 0.0, 5.0), Outside);
    case("left of the view", &wall, boxed(-100.0, 0.0, -20.0, 1.0), Outside);
    case("right of the view", &wall, boxed(100.0, 0.0, -20.0, 1.0), Outside);
    case("above the view", &wall, boxed(0.0, 100.0, -20.0, 1.0), Outside);
    case("below the view", &wall, boxed(0.0, -100.0, -20.0, 1.0), Outside);
    case("across the view's side", &wall, boxed(27.0, 0.0, -20.0, 2.0), Hidden);
    case("larger than the screen", &wall, boxed(0.0, 0.0, -2e4, 1.5e4), Hidden);
    for hole in [UVec2::ZERO, UVec2::new(63, 47), UVec2::new(31, 20)] {
        let holed = holed(lens(NEAR), 0.01, hole);
        case("larger than the screen with a hole", &holed, boxed(0.0, 0.0, -2e4, 1.5e4), Visible);
    }

    let at = Vec3::new(1.0, 2.0, -20.0);
    let flat = |axes| placed(Affine3A::IDENTITY, LocalBox { centre: at, axes });
    let [x, y, o] = [Vec3::X, Vec3::Y, Vec3::ZERO];
    case("a point", &wall, flat([o, o, o]), Hidden);
    case("a segment", &wall, flat([x, o, o]), Hidden);
    case("a quad", &wall, flat([x, o, y]), Hidden);
    case("a point before the wall", &wall, boxed(0.0, 0.0, -5.0, 0.0), Visible);
    case("a point at the eye, before the near plane", &wall, boxed(0.0, 0.0, 0.0, 0.0), Outside);

    let hidden = boxed(0.0, 0.0, -20.0, 1.0);
    let behind = local_box(Vec3::ZERO, Vec3::ONE);
    let back = Vec3A::new(0.0, 0.0, -20.0);
    let moved = |matrix3, translation| {
        let world = Affine3A {
            matrix3,
            translation,
        };
        placed(world, behind)
    };
    let eye = Mat3A::IDENTITY;
    case("no rotation", &wall, moved(eye, back), Hidden);
    case("a matrix of zeros", &wall, moved(Mat3A::ZERO, back), Hidden);
    case("flattened", &wall, moved(Mat3A::from_diagonal(Vec3::new(1.0, 0.0, 1.0)), back), Hidden);
    case("mirrored", &wall, moved(Mat3A::from_diagonal(Vec3::new(-1.0, 1.0, 1.0)), back), Hidden);
    case("turned inside out", &wall, moved(-eye, back), Hidden);
    case("mirrored, before the wall", &wall, moved(-eye, 0.25 * back), Visible);
    case("scaled to nothing visible", &wall, moved(1e-30 * eye, back), Hidden);
    for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut volume = behind;
        volume.centre.y = wrong;
        case("a centre that is no number", &wall, placed(Affine3A::from_translation(back.into()), volume), Visible);
        let mut volume = behind;
        volume.axes[1].z = wrong;
        case("an axis that is no number", &wall, placed(Affine3A::from_translation(back.into()), volume), Visible);
        case("a translation that is no number", &wall, moved(eye, Vec3A::new(wrong, 0.0, -20.0)), Visible);
        let mut matrix = eye;
        matrix.y_axis.x = wrong;
        case("a matrix that is no number", &wall, moved(matrix, back), Visible);
        // Nothing else is multiplied by this column.
        case("a useless column that is no number", &wall, placed(Affine3A { matrix3: matrix, translation: back }, LocalBox::default()), Visible);
        let mut clip = lens(NEAR);
        clip.x_axis.x = wrong;
        case("a camera that is no number", &filled(clip, 0.01), hidden.clone(), Visible);
        let mut depth = wall.clone();
        depth.texels[6 * 16 + 8] = wrong;
        for level in 1..depth.levels.len() {
            let place = depth.levels[level];
            let at = place.first + (6 >> level) * place.size.x + (8 >> level);
            depth.texels[at as usize] = wrong;
        }
        case("a depth that is no number", &depth, hidden.clone(), Visible);
        let corner = Vec3::new(wrong, 0.0, -20.0);
        case("a proxy that is no number", &wall, with_proxy(boxed(0.0, 0.0, -5.0, 1.0), [corner, o, o], 0.0), Visible);
        case("a radius that is no number", &wall, with_proxy(boxed(0.0, 0.0, -5.0, 1.0), [Vec3::NEG_Z * 20.0; 3], wrong), Visible);
    }
    case("overflow on the way", &wall, placed(Affine3A::from_scale(Vec3::splat(1e30)), boxed(0.0, 0.0, -1e30, 1e29).volume), Visible);
    case("larger than is calculated with", &wall, boxed(0.0, 0.0, -1e19, 1.0), Visible);
    let mut broken = wall.clone();
    broken.texels.pop();
    case("depth that lacks a texel", &broken, hidden.clone(), Visible);
    case("no depth", &ReducedDepth::default(), hidden.clone(), Visible);

    // Depth 0.9 is 10 m away.
    let flat = filled(flat_lens(), 0.9);
    case("orthographic, behind", &flat, boxed(0.0, 0.0, -50.0, 1.0), Hidden);
    case("orthographic, before", &flat, boxed(0.0, 0.0, -5.0, 1.0), Visible);
    case("orthographic, beside", &flat, boxed(40.0, 0.0, -50.0, 1.0), Outside);
    case("orthographic, before the near plane", &flat, boxed(0.0, 0.0, 5.0, 1.0), Outside);
    case("orthographic, beyond the far plane", &flat, boxed(0.0, 0.0, -110.0, 1.0), Outside);
    case("orthographic, through the far plane", &flat, boxed(0.0, 0.0, -100.0, 1.0), Hidden);
    let hole = |x, y| holed(flat_lens(), 0.9, UVec2::new(x, y));
    let on_border = || over_pixels([8.0, 16.0], [8.0, 16.0]);
    let within = || over_pixels([8.1, 15.9], [8.1, 15.9]);
    for (x, y) in [(7, 10), (16, 10), (10, 7), (10, 16), (4, 4), (19, 19)] {
        case("on a border of blocks, a hole beyond it", &hole(x, y), on_border(), Visible);
        case("short of a border of blocks, a hole beyond it", &hole(x, y), within(), Hidden);
    }
    case("on a border of blocks", &hole(20, 20), on_border(), Hidden);
    case("one pixel, a hole there", &hole(21, 22), over_pixels([21.1, 21.9], [22.1, 22.9]), Visible);
    case("one pixel, a hole in its block", &hole(20, 23), over_pixels([21.1, 21.9], [22.1, 22.9]), Visible);
    case("one pixel, a hole in the next block", &hole(24, 22), over_pixels([21.1, 21.9], [22.1, 22.9]), Hidden);
    case("the last pixel, a hole there", &hole(63, 47), over_pixels([63.1, 63.9], [47.1, 47.9]), Visible);
    case("just beyond the last pixel", &hole(63, 47), over_pixels([64.1, 64.9], [20.0, 21.0]), Outside);

    let shifted = Mat4::from_translation(Vec3::new(0.5, -0.25, 0.0)) * lens(NEAR);
    case("off-centre, behind", &filled(shifted, 0.01), boxed(0.0, 0.0, -20.0, 1.0), Hidden);
    case("off-centre, outside on its narrow side", &filled(shifted, 0.01), boxed(20.0, 0.0, -20.0, 1.0), Outside);
    case("off-centre, inside on its wide side", &filled(shifted, 0.01), boxed(-30.0, 0.0, -20.0, 1.0), Hidden);
    let mut oblique = lens(NEAR);
    oblique.x_axis.z = 0.01;
    case("oblique, behind", &filled(oblique, 0.05), boxed(0.0, 0.0, -20.0, 1.0), Hidden);
    case("oblique, before", &filled(oblique, 0.004), boxed(0.0, 0.0, -20.0, 1.0), Visible);
    let far = Mat4::perspective_rh(FRAC_PI_2, 4.0 / 3.0, 100.0, NEAR);
    case("finite far, behind", &filled(far, 0.05), boxed(0.0, 0.0, -20.0, 1.0), Hidden);
    case("finite far, before the sky", &filled(far, 0.0), boxed(0.0, 0.0, -20.0, 1.0), Visible);
    case("finite far, beyond it", &filled(far, 0.0), boxed(0.0, 0.0, -110.0, 1.0), Outside);

    let fine = filled(lens(1e-4), 1e-4 / 9e6);
    case("10,000 km away, behind", &fine, boxed(0.0, 0.0, -1e7, 10.0), Hidden);
    case("10,000 km away, before", &fine, boxed(0.0, 0.0, -8.9e6, 10.0), Visible);
    case("a near plane of 0.1 mm", &filled(lens(1e-4), 0.5), boxed(0.0, 0.0, -1e-3, 1e-4), Hidden);
    let remote = Vec3::new(1e7, -1e7, 1e7);
    let far_off = filled(lens(NEAR) * Mat4::from_translation(-remote), NEAR / 100.0);
    let there = |z| placed(Affine3A::from_translation(remote + Vec3::Z * z), behind);
    case("at 10,000 km from the origin, behind", &far_off, there(-2000.0), Hidden);
    case("at 10,000 km from the origin, before", &far_off, there(-50.0), Visible);
    case("at 10,000 km from the origin, within its rounding", &far_off, there(-102.0), Visible);
    case("at 10,000 km from the origin, behind the camera", &far_off, there(2000.0), Outside);

    let samples = DepthSampling::Strided { x: 8, y: 8 };
    let sparse = reduced(flat_lens(), VIEWPORT, samples, &[0.1; 64 * 48]);
    case("strided, no sample inside", &sparse, over_pixels([9.1, 15.9], [9.1, 15.9]), Hidden);
    case("strided, no row of samples inside", &sparse, over_pixels([9.1, 30.0], [9.1, 15.9]), Hidden);
    case("strided, a sample inside", &sparse, over_pixels([9.0, 16.5], [9.0, 16.5]), Visible);
    let near_samples = reduced(flat_lens(), VIEWPORT, samples, &[0.9; 64 * 48]);
    case("strided, behind its samples", &near_samples, over_pixels([9.0, 30.0], [9.0, 30.0]), Hidden);

    let tiny = |depth| reduced(lens(NEAR), UVec2::ONE, BLOCK, &[depth]);
    case("one pixel of screen, behind", &tiny(0.01), boxed(0.0, 0.0, -20.0, 1.0), Hidden);
    case("one pixel of screen, before", &tiny(0.004), boxed(0.0, 0.0, -20.0, 1.0), Visible);
    let odd = UVec2::new(61, 47);
    let mut pixels = [0.01; 61 * 47];
    let whole = reduced(lens(NEAR), odd, BLOCK, &pixels);
    case("blocks cut by the viewport", &whole, boxed(0.0, 0.0, -2e4, 1.5e4), Hidden);
    pixels[61 * 47 - 1] = 0.0;
    let last = reduced(lens(NEAR), odd, BLOCK, &pixels);
    case("blocks cut by the viewport, a hole in the last", &last, boxed(0.0, 0.0, -2e4, 1.5e4), Visible);
    let fine = DepthSampling::Conservative { block: 1 };
    let every = reduced(lens(NEAR), odd, fine, &pixels);
    case("every pixel a block, a hole in the last", &every, boxed(0.0, 0.0, -2e4, 1.5e4), Visible);
    case("every pixel a block, no hole before it", &every, boxed(0.0, 0.0, -20.0, 5.0), Hidden);

    // Seen through a hole in its block, which the middle of the box is not behind.
    let gap = hole(16, 12);
    let seen = over_pixels([16.0, 48.0], [12.0, 36.0]);
    let middle = [Vec3::new(0.0, 0.0, -50.0), Vec3::new(3.0, 0.0, -50.0), Vec3::new(0.0, 3.0, -50.0)];
    case("a box behind a hole", &gap, seen.clone(), Visible);
    let nan = Vec3::new(f32::NAN, 0.0, -50.0);
    case("its turned box is not behind it", &gap, with_turned(seen.clone(), middle[0], 8.0), Hidden);
    case("its turned box reaches there", &gap, with_turned(seen.clone(), middle[0], 16.0), Visible);
    case("its turned box is beside the view", &gap, with_turned(seen.clone(), Vec3::X * 90.0, 8.0), Outside);
    case("its turned box is not finite", &gap, with_turned(seen.clone(), nan, 8.0), Visible);
    case("a turned box around the camera", &wall, with_turned(boxed(0.0, 0.0, -20.0, 1.0), Vec3::ZERO, 30.0), Hidden);
    case("its proxy is not behind it", &gap, with_proxy(seen.clone(), middle, 1.0), Hidden);
    case("its proxy reaches there", &gap, with_proxy(seen.clone(), middle, 13.0), Visible);
    case("its proxy is a point", &gap, with_proxy(seen.clone(), [middle[0]; 3], 0.0), Hidden);
    case("its proxy is before the wall", &gap, with_proxy(seen.clone(), middle, 45.0), Visible);
    case("its proxy is empty", &gap, Case { proxy: Some(Proxy::default()), ..seen }, Visible);
    let round = boxed(0.0, 0.0, 0.0, 30.0);
    let behind_eye = [Vec3::Z * 20.0, Vec3::Z * 25.0, Vec3::new(5.0, 0.0, 20.0)];
    case("a proxy behind the camera", &wall, with_proxy(round.clone(), behind_eye, 1.0), Outside);
    case("a proxy that reaches the camera", &wall, with_proxy(round.clone(), behind_eye, 21.0), Visible);
    let mut two = with_proxy(round, behind_eye, 1.0);
    if let Some(proxy) = &mut two.proxy {
        proxy.triangles.push(SweptTriangle {
            corners: [Vec3::NEG_Z * 20.0; 3],
            radius: 1.0,
        });
    }
    case("a proxy partly behind the camera, else hidden", &wall, two, Hidden);
    all
}

/// A camera, a depth buffer with holes, and objects around its depth.
pub fn random_view(random: &mut Random, count: usize) -> (ReducedDepth, Vec<Case>) {
    let viewport = UVec2::new(1 + random.below(80) as u32, 1 + random.below(80) as u32);
    let aspect = viewport.x as f32 / viewport.y as f32;
    let near = random.scale(1e-4, 1.0);
    let far = random.scale(10.0, 1e6);
    let fov = random.within(0.2, 2.5) as f32;
    let distance = random.scale(2.0, 5e3).min(0.5 * far);
    let height = random.scale(1.0, 1e3);
    let kind = random.below(6);
    let lens = match kind {
        0 => Mat4::orthographic_rh(
            -height * aspect,
            height * aspect,
            -height,
            height,
            far,
            near,
        ),
        1 => Mat4::perspective_rh(fov, aspect, far, near),
        2 => {
            let shift = Vec3::new(random.within(-1.0, 1.0) as f32, 0.3, 0.0);
            Mat4::from_translation(shift) * Mat4::perspective_infinite_reverse_rh(fov, aspect, near)
        }
        _ => Mat4::perspective_infinite_reverse_rh(fov, aspect, near),
    };
    // A quarter of all cameras are far out, where rounding is coarse.
    let out = if random.below(4) == 0 { 1e6 } else { 100.0 };
    let place = random.vec3() * random.scale(1e-2, out);
    let turn = Quat::from_axis_angle(
        random.vec3().normalize_or(Vec3::Y),
        random.within(0.0, 6.0) as f32,
    );
    let world_from_view = Mat4::from_rotation_translation(turn, place);
    let clip = lens * world_from_view.inverse();
    let depth_at = |d: f32| {
        let clip = lens * Vec4::new(0.0, 0.0, -d, 1.0);
        (clip.z / clip.w).clamp(0.0, 1.0)
    };
    let mut pixels: Vec<f32> = (0..viewport.x * viewport.y)
        .map(|_| depth_at(distance * random.within(0.9, 1.0) as f32))
        .collect();
    for _ in 0..random.below(4) {
        let hole = random.below(pixels.len() as u64) as usize;
        pixels[hole] = 0.0;
    }
    let sampling = match random.below(4) {
        0 => DepthSampling::Strided {
            x: 1 + random.below(8) as u32,
            y: 1 + random.below(8) as u32,
        },
        _ => DepthSampling::Conservative {
            block: 1 + random.below(8) as u32,
        },
    };
    let depth = reduced(clip, viewport, sampling, &pixels);
    let cases = (0..count)
        .map(|_| random_case(random, world_from_view, distance, kind == 0, height, fov))
        .collect();
    (depth, cases)
}

fn random_case(
    random: &mut Random,
    world_from_view: Mat4,
    distance: f32,
    is_flat: bool,
    height: f32,
    fov: f32,
) -> Case {
    let d = distance
        * if random.below(8) == 0 {
            random.within(-1.0, 1.0) as f32
        } else {
            random.scale(0.5, 5.0)
        };
    let reach = if is_flat {
        height
    } else {
        d.abs() * (0.5 * fov).tan()
    };
    let aside = random.vec3() * 1.3 * reach;
    let place = world_from_view.transform_point3(Vec3::new(aside.x, aside.y, -d));
    let size = random.scale(1e-3, 0.7) * reach.max(0.01 * distance);
    let axis = random.vec3().normalize_or(Vec3::X);
    let turn = Quat::from_axis_angle(axis, random.within(0.0, f64::from(2.0 * PI)) as f32);
    let mut scale = Vec3::ONE + 0.5 * random.vec3();
    if random.below(4) == 0 {
        scale.x = -scale.x;
    }
    let world = Affine3A::from_scale_rotation_translation(scale, turn, place);
    let mut half = (random.vec3() + 0.5).abs() * size;
    if random.below(8) == 0 {
        half[random.below(3) as usize] = 0.0;
    }
    let volume = local_box(random.vec3() * size, half);
    let proxy = (random.below(8) == 0).then(|| Proxy {
        triangles: (0..1 + random.below(6))
            .map(|_| SweptTriangle {
                corners: core::array::from_fn(|_| volume.centre + random.vec3() * half),
                radius: random.within(0.0, 0.3) as f32 * size,
            })
            .collect(),
    });
    let turned = (random.below(4) == 0).then(|| {
        let turn = Mat3::from_quat(Quat::from_axis_angle(axis, random.scale(0.1, 3.0)));
        let half = half * (random.vec3() + 1.5);
        LocalBox {
            centre: volume.centre + 0.3 * random.vec3() * half,
            axes: [0, 1, 2].map(|i| turn.col(i) * half[i]),
        }
    });
    Case {
        world,
        volume,
        turned,
        proxy,
    }
}
