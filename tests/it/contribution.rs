//! Areas of contribution culling on the CPU and of the shipped WGSL against each other and against
//! `reference::contribution`.

use core::f32::consts::FRAC_PI_2;

use bevy::{
    asset::AssetServer,
    math::{Affine3A, Mat3A, Vec3A},
    prelude::*,
    render::{
        RenderApp,
        render_resource::*,
        renderer::{RenderDevice, RenderQueue},
    },
};
use bevy_skyline::{
    contribution::area::AreaView,
    culling::volume::LocalBox,
    occlusion::{
        DepthSampling,
        depth::ReducedDepth,
        verdict::{DepthTest, Verdict},
    },
    offline::Offline,
    reference::contribution::{AreaTally, AreaTwin},
    render_graph::{
        contribution::{GpuAreaView, SLOTS_PER_GROUP, areas_layout, areas_pipeline},
        occludee_verdicts::GpuOccludee,
    },
};

use crate::{
    allocations,
    occlusion_cases::{Case, Random, hard_cases, random_view},
};

/// A camera and what is measured in it.
pub struct View {
    pub clip: Mat4,
    pub viewport: Vec2,
    pub cases: Vec<(Affine3A, LocalBox)>,
}

impl View {
    pub fn on_cpu(&self) -> Vec<f32> {
        let view = AreaView::new(self.clip, self.viewport);
        let area = |(world, volume): &(Affine3A, LocalBox)| view.area_px2(world, volume);
        self.cases.iter().map(area).collect()
    }

    fn compare(&self, tally: &mut AreaTally) {
        let twin = AreaTwin::new(self.clip, self.viewport);
        for ((world, volume), area) in self.cases.iter().zip(self.on_cpu()) {
            let areas = twin.areas(world, volume);
            // The polygon's own rounding in f64.
            assert!(
                areas.hull <= areas.rectangle * (1.0 + 1e-9) + 1e-9
                    || areas.rectangle.is_infinite(),
                "{areas:?}"
            );
            tally.add(areas, area);
        }
    }
}

/// The shipped pass, ready to be dispatched.
pub struct Gpu {
    offline: Offline,
    pipeline: CachedComputePipelineId,
}

impl Gpu {
    /// `None`, with the reason printed, where this machine has no device at all.
    pub fn new() -> Option<Self> {
        let mut offline = crate::device()?;
        let descriptor = areas_pipeline(offline.app.world().resource::<AssetServer>());
        let render_app = offline.app.sub_app(RenderApp);
        let cache = render_app.world().resource::<PipelineCache>();
        let pipeline = cache.queue_compute_pipeline(descriptor);
        for _ in 0..1000 {
            let render_app = offline.app.sub_app(RenderApp);
            let cache = render_app.world().resource::<PipelineCache>();
            if cache.get_compute_pipeline(pipeline).is_some() {
                return Some(Self { offline, pipeline });
            }
            offline.step();
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        panic!("the pipeline was not compiled; see the log");
    }

    pub fn areas(&self, view: &View) -> Vec<f32> {
        let world = self.offline.app.sub_app(RenderApp).world();
        let device = world.resource::<RenderDevice>();
        let queue = world.resource::<RenderQueue>();
        let cache = world.resource::<PipelineCache>();
        let candidates: Vec<GpuOccludee> = view
            .cases
            .iter()
            .map(|(world, volume)| GpuOccludee::new(world, volume, None, 0..0))
            .collect();
        let storage = |contents: &[u8]| {
            device.create_buffer_with_data(&BufferInitDescriptor {
                label: None,
                contents,
                usage: BufferUsages::STORAGE,
            })
        };
        let area_view = AreaView::new(view.clip, view.viewport);
        let uniform = GpuAreaView::new(&area_view, (0.0, 0.0), false);
        let uniform = storage(bytemuck::bytes_of(&uniform));
        let list = storage(bytemuck::cast_slice(&candidates));
        let size = 4 * candidates.len() as u64;
        let buffer = |usage| {
            device.create_buffer(&BufferDescriptor {
                label: None,
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        let out = buffer(BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let back = buffer(BufferUsages::MAP_READ | BufferUsages::COPY_DST);
        let group = device.create_bind_group(
            None,
            &cache.get_bind_group_layout(&areas_layout()),
            &BindGroupEntries::sequential((
                uniform.as_entire_binding(),
                list.as_entire_binding(),
                out.as_entire_binding(),
            )),
        );
        let mut encoder = device.create_command_encoder(&default());
        {
            let mut pass = encoder.begin_compute_pass(&default());
            pass.set_pipeline(cache.get_compute_pipeline(self.pipeline).expect("ready"));
            pass.set_bind_group(0, &group, &[]);
            let groups = (candidates.len() as u32).div_ceil(SLOTS_PER_GROUP);
            pass.dispatch_workgroups(groups, 1, 1);
        }
        encoder.copy_buffer_to_buffer(&out, 0, &back, 0, size);
        queue.submit([encoder.finish()]);
        back.slice(..)
            .map_async(MapMode::Read, |result| result.expect("mapped"));
        device
            .poll(PollType::wait_indefinitely())
            .expect("the device works");
        let areas: Vec<f32> = bytemuck::pod_collect_to_vec(&back.slice(..).get_mapped_range());
        assert_eq!(areas.len(), candidates.len());
        areas
    }
}

const NEAR: f32 = 0.1;
/// 90° high, 4:3.
const VIEWPORT: Vec2 = Vec2::new(64.0, 48.0);
const WHOLE: f64 = 64.0 * 48.0;

fn lens(near: f32) -> Mat4 {
    Mat4::perspective_infinite_reverse_rh(FRAC_PI_2, 4.0 / 3.0, near)
}

pub fn boxed(centre: Vec3, half: Vec3) -> LocalBox {
    LocalBox {
        centre,
        axes: [Vec3::X * half.x, Vec3::Y * half.y, Vec3::Z * half.z],
    }
}

/// A named case and the area it must come to, to a thousandth. units: px²
pub struct Hard {
    pub name: &'static str,
    pub view: View,
    pub expected: f64,
}

#[rustfmt::skip]
pub fn hard() -> Vec<Hard> {
    let mut all = Vec::new();
    let mut case = |name, clip, viewport, world, volume, expected| {
        let cases = vec![(world, volume)];
        all.push(Hard { name, view: View { clip, viewport, cases }, expected });
    };
    let see = lens(NEAR);
    let at = |x: f32, y: f32, z: f32, half: f32| boxed(Vec3::new(x, y, z), Vec3::splat(half));
    let here = Affine3A::IDENTITY;
    // A metre 1 m away is 24 px. A cube's nearest side makes the rectangle.
    case("before the camera", see, VIEWPORT, here, at(0.0, 0.0, -11.0, 1.0), 4.8 * 4.8);
    case("around the camera", see, VIEWPORT, here, at(0.0, 0.0, 0.0, 2.0), WHOLE);
// The near plane cuts it from 0.1 of its half beyond the middle to the border: 0.5375 of the width, 0.55 of the height.
    case("the camera inside, at a corner of the box", see, VIEWPORT, here, at(0.99, 0.99, -0.8, 1.0), WHOLE * 0.5375 * 0.55);
    case("large, the camera inside", see, VIEWPORT, here, at(0.0, 0.0, -999.0, 1000.0), WHOLE);
    case("a corner at the eye", see, VIEWPORT, here, at(1.0, 1.0, -1.0, 1.0), WHOLE * 0.25);
    case("behind", see, VIEWPORT, here, at(0.0, 0.0, 20.0, 1.0), 0.0);
    case("large, behind", see, VIEWPORT, here, at(0.0, 0.0, 1e6, 9e5), 0.0);
    case("before the near plane", see, VIEWPORT, here, at(0.0, 0.0, -0.05, 0.01), 0.0);
    // From z = −0.15 to the near plane at −0.1: there 240 px a metre.
    case("cut by the near plane", see, VIEWPORT, here, at(0.0, 0.0, -0.1, 0.05), 24.0 * 24.0);
    case("touching the near plane", see, VIEWPORT, here, at(0.0, 0.0, -0.2, 0.1), 48.0 * 48.0);
    case("beside the camera, through its plane", see, VIEWPORT, here, at(100.0, 0.0, 0.0, 5.0), 0.0);
    // Its far corners at z = −5 are 95/5 × 24 px beside the middle; nearer ones farther.
    case("beside, above and behind", see, VIEWPORT, here, at(100.0, 100.0, 10.0, 15.0), 0.0);
    case("left of the view", see, VIEWPORT, here, at(-100.0, 0.0, -20.0, 1.0), 0.0);
    case("above the view", see, VIEWPORT, here, at(0.0, 100.0, -20.0, 1.0), 0.0);
    // 31..33 px from the middle at z = −24, half a pixel a side more at −23.5.
    let across = boxed(Vec3::new(32.0, 0.0, -24.0), Vec3::new(1.0, 1.0, 0.0));
    case("straddling the viewport's border", see, VIEWPORT, here, across, 1.0 * 2.0);
    let corner = boxed(Vec3::new(32.0, 24.0, -24.0), Vec3::new(1.0, 1.0, 0.0));
    case("straddling the viewport's corner", see, VIEWPORT, here, corner, 1.0);

    let flat = |axes| LocalBox { centre: Vec3::new(1.0, 2.0, -24.0), axes };
    let [x, y, o] = [Vec3::X, Vec3::Y, Vec3::ZERO];
    case("a point", see, VIEWPORT, here, flat([o, o, o]), 0.0);
    case("a segment", see, VIEWPORT, here, flat([x, o, o]), 0.0);
    case("a quad", see, VIEWPORT, here, flat([x, o, y]), 4.0);
    case("axes all alike", see, VIEWPORT, here, flat([x, x, x]), 0.0);
    case("a slanted segment", see, VIEWPORT, here, flat([x + y, o, o]), 4.0);
    let matrix = |matrix3| Affine3A { matrix3, translation: Vec3A::new(0.0, 0.0, -24.0) };
    let unit = boxed(o, Vec3::new(1.0, 1.0, 0.0));
    case("a matrix of zeros", see, VIEWPORT, matrix(Mat3A::ZERO), unit, 0.0);
    case("mirrored", see, VIEWPORT, matrix(Mat3A::from_diagonal(Vec3::new(-1.0, 1.0, 1.0))), unit, 4.0);
    case("flattened", see, VIEWPORT, matrix(Mat3A::from_diagonal(Vec3::new(1.0, 0.0, 1.0))), unit, 0.0);
    case("scaled to nothing visible", see, VIEWPORT, matrix(1e-30 * Mat3A::IDENTITY), unit, 0.0);

    for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut centre = unit;
        centre.centre.y = wrong;
        case("a centre that is no number", see, VIEWPORT, here, centre, f64::INFINITY);
        let mut axis = unit;
        axis.axes[2].z = wrong;
        case("an axis that is no number", see, VIEWPORT, here, axis, f64::INFINITY);
        let moved = Affine3A::from_translation(Vec3::new(wrong, 0.0, -20.0));
        case("a place that is no number", see, VIEWPORT, moved, unit, f64::INFINITY);
        let mut turned = Mat3A::IDENTITY;
        turned.y_axis.x = wrong;
        case("a matrix that is no number", see, VIEWPORT, matrix(turned), unit, f64::INFINITY);
        // Nothing else is multiplied by this column.
        case("a useless column that is no number", see, VIEWPORT, matrix(turned), LocalBox::default(), f64::INFINITY);
        let mut clip = see;
        clip.x_axis.x = wrong;
        case("a camera that is no number", clip, VIEWPORT, here, unit, f64::INFINITY);
        case("a viewport that is no number", see, Vec2::new(64.0, wrong), here, unit, f64::INFINITY);
    }
    case("a viewport of negative size", see, Vec2::new(64.0, -1.0), here, unit, f64::INFINITY);
    case("overflow on the way", see, VIEWPORT, Affine3A::from_scale(Vec3::splat(1e30)), at(0.0, 0.0, -1e30, 1e29), f64::INFINITY);
    case("larger than is calculated with", see, VIEWPORT, here, at(0.0, 0.0, -1e19, 1.0), f64::INFINITY);

    // 24 px a metre and metre's distance; nothing but its guard is left.
    case("10,000 km away", see, VIEWPORT, here, at(0.0, 0.0, -1e7, 10.0), (24.0 * 20.0 / 1e7_f64).powi(2));
    case("10,000 km away and as large", see, VIEWPORT, here, boxed(Vec3::NEG_Z * 1e7, Vec3::new(1e6, 1e6, 0.0)), 4.8 * 4.8);
    let remote = Vec3::new(1e7, -1e7, 1e7);
    let far_off = see * Mat4::from_translation(-remote);
    let there = Affine3A::from_translation(remote + Vec3::NEG_Z * 2400.0);
    // Not to a thousandth: coordinates are off by metres there.
    case("10,000 km from the origin", far_off, VIEWPORT, there, boxed(o, Vec3::new(1e3, 1e3, 0.0)), f64::NAN);
    case("10,000 km from the origin, behind", far_off, VIEWPORT, Affine3A::from_translation(remote + Vec3::Z * 2400.0), boxed(o, Vec3::splat(100.0)), 0.0);
    case("10,000 km from the origin, around the camera", far_off, VIEWPORT, Affine3A::from_translation(remote), boxed(o, Vec3::splat(100.0)), WHOLE);

    let ortho = Mat4::orthographic_rh(-32.0, 32.0, -24.0, 24.0, 100.0, 0.0);
    case("orthographic", ortho, VIEWPORT, here, at(5.0, 5.0, -50.0, 2.0), 16.0);
    case("orthographic, cut by the near plane", ortho, VIEWPORT, here, at(5.0, 5.0, 0.0, 2.0), 16.0);
    case("orthographic, behind", ortho, VIEWPORT, here, at(5.0, 5.0, 3.0, 2.0), 0.0);
    case("orthographic, beside", ortho, VIEWPORT, here, at(40.0, 0.0, -50.0, 1.0), 0.0);
    let finite = Mat4::perspective_rh(FRAC_PI_2, 4.0 / 3.0, 100.0, NEAR);
    case("finite far", finite, VIEWPORT, here, at(0.0, 0.0, -11.0, 1.0), 4.8 * 4.8);
    case("finite far, cut by the near plane", finite, VIEWPORT, here, at(0.0, 0.0, -0.1, 0.05), 24.0 * 24.0);
    case("finite far, behind", finite, VIEWPORT, here, at(0.0, 0.0, 20.0, 1.0), 0.0);
    let shifted = Mat4::from_translation(Vec3::new(0.5, -0.25, 0.0)) * see;
    case("off-centre", shifted, VIEWPORT, here, at(0.0, 0.0, -11.0, 1.0), 4.8 * 4.8);
    case("off-centre, outside on its narrow side", shifted, VIEWPORT, here, at(20.0, 0.0, -20.0, 1.0), 0.0);
    case("one pixel of screen", see, Vec2::ONE, here, at(0.0, 0.0, -1e3, 999.0), 1.0);
    case("one pixel of screen, a little of it", see, Vec2::ONE, here, boxed(Vec3::NEG_Z * 10.0, Vec3::new(1.0, 1.0, 0.0)), 0.1 * 0.075);
    case("no screen", see, Vec2::ZERO, here, at(0.0, 0.0, -11.0, 1.0), 0.0);
    all
}

#[test]
fn hard_areas_come_out_right_on_the_twin_and_the_cpu() {
    let cases = hard();
    assert!(cases.len() > 60);
    let mut wrong = Vec::new();
    for Hard {
        name,
        view,
        expected,
    } in &cases
    {
        let (world, volume) = &view.cases[0];
        let areas = AreaTwin::new(view.clip, view.viewport).areas(world, volume);
        let found = view.on_cpu()[0];
        let is_near = |area: f64, share: f64| {
            expected.is_nan()
                || area == *expected
                || (area - expected).abs() <= share * (expected + 1.0)
        };
        let found_is_near = is_near(found.into(), 1e-2);
        if !areas.allows(found) || !is_near(areas.rectangle, 1e-6) || !found_is_near {
            wrong.push((name, expected, found, areas));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Boxes with corners on, just before and just behind the near plane, and around the eye.
fn adversarial(random: &mut Random, count: usize) -> View {
    let near = 10f32.powf(random.within(-4.0, 0.0) as f32);
    let size = |random: &mut Random| 1.0 + random.below(2000) as f32;
    let viewport = Vec2::new(size(random), size(random));
    let aspect = viewport.x / viewport.y;
    let fov = random.within(0.2, 2.5) as f32;
    let flat = random.below(4) == 0;
    let lens = match random.below(3) {
        _ if flat => Mat4::orthographic_rh(-aspect, aspect, -1.0, 1.0, 1e3, near),
        0 => Mat4::perspective_rh(fov, aspect, 1e3, near),
        _ => Mat4::perspective_infinite_reverse_rh(fov, aspect, near),
    };
    let out = 10f64.powf(random.within(-2.0, 4.0));
    let place = Vec3::from_array(core::array::from_fn(|_| random.within(-out, out) as f32));
    let turn = Quat::from_rotation_y(random.within(0.0, 6.0) as f32);
    let world_from_view = Mat4::from_rotation_translation(turn, place);
    let nudges = [-1e-3, -1e-6, 0.0, 1e-6, 1e-3];
    let cases = (0..count)
        .map(|_| {
            let half = near * 10f32.powf(random.within(-2.0, 4.0) as f32);
            // The nearest or the farthest corner at the near plane, or its middle.
            let way = [-1.0, 0.0, 1.0][random.below(3) as usize];
            let nudge = nudges[random.below(5) as usize];
            let z = -near * (1.0 + nudge) + way * half;
            let mut aside = || random.within(-2.0, 2.0) as f32 * half;
            let centre = Vec3::new(aside(), aside(), z);
            let turned = match random.below(2) {
                0 => Quat::IDENTITY,
                _ => Quat::from_euler(
                    EulerRot::XYZ,
                    random.within(0.0, 6.0) as f32,
                    random.within(0.0, 6.0) as f32,
                    0.0,
                ),
            };
            let view_from_local = Mat4::from_rotation_translation(turned, centre)
                * Mat4::from_scale(Vec3::splat(half));
            let world = Affine3A::from_mat4(world_from_view * view_from_local);
            let half = Vec3::from_array(core::array::from_fn(|_| random.below(4) as f32 / 3.0));
            (world, boxed(Vec3::ZERO, half))
        })
        .collect();
    View {
        clip: lens * world_from_view.inverse(),
        viewport,
        cases,
    }
}

fn random(random: &mut Random, count: usize) -> View {
    let (depth, cases) = random_view(random, count);
    let of = |case: Case| (case.world, case.volume);
    View {
        clip: depth.clip_from_world,
        viewport: depth.viewport,
        cases: cases.into_iter().map(of).collect(),
    }
}

fn views(seed: u64) -> impl Iterator<Item = View> {
    let mut numbers = Random(seed);
    (0..800).map(move |k| match k % 2 {
        0 => random(&mut numbers, 256),
        _ => adversarial(&mut numbers, 256),
    })
}

#[test]
fn areas_are_never_too_small_nor_needlessly_large() {
    let (mut far, mut near) = (AreaTally::default(), AreaTally::default());
    let mut nothing = 0;
    for (k, view) in views(11).enumerate() {
        view.compare(if k % 2 == 0 { &mut far } else { &mut near });
        nothing += view.on_cpu().iter().filter(|area| **area == 0.0).count();
    }
    for (name, tally) in [("random", &far), ("adversarial", &near)] {
        println!(
            "{name}: tight {}, wide {}, infinite {}; wrong {}, of which {} too small",
            tally.tight,
            tally.wide,
            tally.unknown,
            tally.wrong.len(),
            tally.too_small
        );
    }
    println!("nothing in view {nothing}");
    far.outcome(0.2).unwrap();
    // Where the near plane cuts a box, its w are not much more than what they may be off by.
    near.outcome(0.6).unwrap();
    assert!(far.tight + near.tight + far.wide + near.wide > 200_000);
    assert!(nothing > 1000);
}

#[test]
fn areas_of_the_gpu_are_the_cpus() {
    let Some(gpu) = Gpu::new() else { return };
    let hard_views = hard().into_iter().map(|hard| hard.view);
    let occlusions = hard_cases().into_iter().map(|hard| View {
        clip: hard.depth.clip_from_world,
        viewport: hard.depth.viewport,
        cases: vec![(hard.case.world, hard.case.volume)],
    });
    let mut tally = AreaTally::default();
    let (mut compared, mut areas_differ, mut differing) = (0, 0, Vec::new());
    for view in hard_views.chain(occlusions).chain(views(12)) {
        let twin = AreaTwin::new(view.clip, view.viewport);
        for ((case, cpu), gpu) in view.cases.iter().zip(view.on_cpu()).zip(gpu.areas(&view)) {
            compared += 1;
            // A driver may round otherwise, never beyond what the twin allows.
            areas_differ += usize::from(cpu.min(f32::MAX) != gpu);
            let area = if gpu == f32::MAX { f32::INFINITY } else { gpu };
            tally.add(twin.areas(&case.0, &case.1), area);
            for threshold in [0.25, 1.0, 4.0, 16.0, 64.0, 256.0, 1024.0] {
                if (cpu < threshold) != (gpu < threshold) {
                    differing.push((*case, cpu, gpu, threshold));
                }
            }
        }
    }
    println!(
        "verdicts that differ: {} of {compared} at each of 7 thresholds; areas that differ: {areas_differ}",
        differing.len()
    );
    tally.outcome(0.6).unwrap();
    assert!(compared > 200_000);
    assert!(differing.is_empty(), "the first: {:?}", differing[0]);
}

#[test]
fn wrong_areas_are_found() {
    let mut tallies: [AreaTally; 4] = default();
    let mut numbers = Random(14);
    for _ in 0..16 {
        let view = random(&mut numbers, 64);
        let twin = AreaTwin::new(view.clip, view.viewport);
        for (world, volume) in &view.cases {
            let areas = twin.areas(world, volume);
            // Rounded down, the hull's, half as much again, nothing.
            let below = (areas.rectangle as f32).next_down();
            let answers = [below, areas.hull as f32, 1.5 * areas.most as f32, 0.0];
            for (tally, answer) in tallies.iter_mut().zip(answers) {
                tally.add(areas, answer);
            }
        }
    }
    for (k, tally) in tallies.iter().enumerate() {
        let reason = tally.outcome(1.0).unwrap_err();
        assert!(reason.contains("are wrong"), "{k}: {reason}");
        assert_eq!(tally.too_small > 0, k != 2, "{k}");
    }
    let reason = AreaTally::default().outcome(1.0).unwrap_err();
    assert!(reason.contains("nothing was compared"), "{reason}");
}

#[test]
fn nothing_of_a_box_shows_just_where_it_is_hidden() {
    let mut numbers = Random(16);
    let (mut found, mut nothing) = ([0, 0, 0], 0);
    for _ in 0..128 {
        let (depth, cases) = random_view(&mut numbers, 128);
        let test = DepthTest::new(&depth);
        for Case { world, volume, .. } in &cases {
            let share = test.visible_share(world, volume);
            assert!((0.0..=1.0).contains(&share), "{share}");
            // A strided test knows nothing of what lies between its samples.
            if depth.strided {
                continue;
            }
            let verdict = test.verdict(world, volume, None, None);
            // The other way round the share may be more: its texels may reach beyond the box.
            if share == 0.0 {
                assert_eq!(verdict, Verdict::Hidden);
            }
            found[verdict as usize] += 1;
            nothing += usize::from(share == 0.0);
        }
    }
    assert!(nothing > 500, "{nothing}");
    assert!(found.iter().all(|count| *count > 500), "{found:?}");
}

#[test]
fn half_a_box_shows_beside_a_wall() {
    let size = UVec2::new(64, 48);
    for (side, block) in [(0.5f32, 1), (8.0, 1), (8.0, 4)] {
        // The left half is nearer than the box.
        let pixels: Vec<f32> = (0..size.x * size.y)
            .map(|i| if i % size.x < 32 { 0.05 } else { 0.0 })
            .collect();
        let sampling = DepthSampling::Conservative { block };
        let depth = ReducedDepth::from_pixels(lens(NEAR), size, sampling, &pixels).expect("fits");
        let volume = boxed(Vec3::NEG_Z * 24.0, Vec3::new(side, side, 0.0));
        let share = DepthTest::new(&depth).visible_share(&Affine3A::IDENTITY, &volume);
        // A texel at each border, and one where the sides meet.
        assert!((0.5..=0.7).contains(&share), "{side} {block}: {share}");
    }
}

#[test]
fn a_measure_allocates_nothing() {
    let view = random(&mut Random(15), 256);
    let measure = AreaView::new(view.clip, view.viewport);
    let mut sum = 0.0;
    let allocations = allocations::count(|| {
        for (world, volume) in &view.cases {
            sum += measure.area_px2(world, volume);
        }
    });
    assert!(sum > 0.0);
    assert_eq!(allocations, 0);
}
