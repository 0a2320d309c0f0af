//! Verdicts of occlusion culling on the CPU and of the shipped WGSL against each other and against
//! `reference::occlusion`.

use bevy::{
    asset::AssetServer,
    prelude::*,
    render::{
        RenderApp,
        render_resource::*,
        renderer::{RenderDevice, RenderQueue},
    },
};
use bevy_skyline::{
    culling::volume::LocalBox,
    occlusion::{
        DepthSampling,
        depth::{GpuOcclusionView, ReducedDepth, layout, texel_count},
        verdict::{DepthTest, Verdict},
    },
    offline::Offline,
    reference::occlusion::{Judgement, OcclusionTally, OcclusionTwin},
    render_graph::occludee_verdicts::{
        GpuOccludee, GpuSweptTriangle, OCCLUDEES_PER_GROUP, layout as bindings, pipeline,
    },
};

use crate::{
    allocations,
    occlusion_cases::{Case, Random, hard_cases, random_view},
};

/// The shipped pass, ready to be dispatched.
pub struct Gpu {
    offline: Offline,
    pipeline: CachedComputePipelineId,
}

impl Gpu {
    /// `None`, with the reason printed, where this machine has no device at all.
    pub fn new() -> Option<Self> {
        let mut offline = crate::device()?;
        let descriptor = pipeline(offline.app.world().resource::<AssetServer>());
        let render_app = offline.app.sub_app(RenderApp);
        let cache = render_app.world().resource::<PipelineCache>();
        let pipeline = cache.queue_compute_pipeline(descriptor);
        let is_ready = |offline: &Offline| {
            let render_app = offline.app.sub_app(RenderApp);
            let cache = render_app.world().resource::<PipelineCache>();
            cache.get_compute_pipeline(pipeline).is_some()
        };
        for _ in 0..1000 {
            if is_ready(&offline) {
                return Some(Self { offline, pipeline });
            }
            offline.step();
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        panic!("the pipeline was not compiled; see the log");
    }

    pub fn verdicts(&self, depth: &ReducedDepth, cases: &[Case]) -> Vec<Verdict> {
        let world = self.offline.app.sub_app(RenderApp).world();
        let device = world.resource::<RenderDevice>();
        let queue = world.resource::<RenderQueue>();
        let cache = world.resource::<PipelineCache>();
        let mut triangles: Vec<GpuSweptTriangle> = Vec::new();
        let mut occludees = Vec::new();
        for case in cases {
            let first = triangles.len() as u32;
            if let Some(proxy) = &case.proxy {
                triangles.extend(proxy.triangles.iter().map(GpuSweptTriangle::from));
            }
            let range = first..triangles.len() as u32;
            occludees.push(GpuOccludee::new(
                &case.world,
                &case.volume,
                case.turned.as_ref(),
                range,
            ));
        }
        triangles.push(GpuSweptTriangle::default());
        let mut texels = depth.texels.clone();
        texels.push(0.0);
        let storage = |contents: &[u8]| {
            device.create_buffer_with_data(&BufferInitDescriptor {
                label: None,
                contents,
                usage: BufferUsages::STORAGE,
            })
        };
        let view = storage(bytemuck::bytes_of(&GpuOcclusionView::from(depth)));
        let texels = storage(bytemuck::cast_slice(&texels));
        let triangles = storage(bytemuck::cast_slice(&triangles));
        let list = storage(bytemuck::cast_slice(&occludees));
        let size = 4 * cases.len() as u64;
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
            &cache.get_bind_group_layout(&bindings()),
            &BindGroupEntries::sequential((
                view.as_entire_binding(),
                texels.as_entire_binding(),
                triangles.as_entire_binding(),
                list.as_entire_binding(),
                out.as_entire_binding(),
            )),
        );
        let mut encoder = device.create_command_encoder(&default());
        {
            let mut pass = encoder.begin_compute_pass(&default());
            let pipeline = cache.get_compute_pipeline(self.pipeline).expect("ready");
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &group, &[]);
            let groups = (cases.len() as u32).div_ceil(OCCLUDEES_PER_GROUP);
            pass.dispatch_workgroups(groups, 1, 1);
        }
        encoder.copy_buffer_to_buffer(&out, 0, &back, 0, size);
        queue.submit([encoder.finish()]);
        back.slice(..)
            .map_async(MapMode::Read, |result| result.expect("mapped"));
        device
            .poll(PollType::wait_indefinitely())
            .expect("the device works");
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(&back.slice(..).get_mapped_range());
        assert_eq!(words.len(), cases.len());
        words.into_iter().map(Verdict::from_gpu).collect()
    }
}

pub fn case_verdict(test: &DepthTest, case: &Case) -> Verdict {
    let (turned, proxy) = (case.turned.as_ref(), case.proxy.as_ref());
    test.verdict(&case.world, &case.volume, turned, proxy)
}

pub fn case_judgement(twin: &OcclusionTwin, case: &Case) -> Judgement {
    let (turned, proxy) = (case.turned.as_ref(), case.proxy.as_ref());
    twin.judge(&case.world, &case.volume, turned, proxy)
}

fn on_cpu(depth: &ReducedDepth, cases: &[Case]) -> Vec<Verdict> {
    let test = DepthTest::new(depth);
    let one = |case: &Case| case_verdict(&test, case);
    cases.iter().map(one).collect()
}

fn judge(depth: &ReducedDepth, cases: &[Case]) -> Vec<Judgement> {
    let twin = OcclusionTwin::new(depth);
    let one = |case: &Case| case_judgement(&twin, case);
    cases.iter().map(one).collect()
}

#[test]
fn hard_cases_come_out_right_on_the_twin_and_the_cpu() {
    let cases = hard_cases();
    assert!(cases.len() > 60);
    let mut wrong = Vec::new();
    for hard in &cases {
        let judgement = case_judgement(&OcclusionTwin::new(&hard.depth), &hard.case);
        let found = case_verdict(&DepthTest::new(&hard.depth), &hard.case);
        if found != hard.expected || !judgement.allows(hard.expected) {
            wrong.push((hard.name, hard.expected, found, judgement));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn hard_cases_come_out_right_on_the_gpu() {
    let Some(gpu) = Gpu::new() else { return };
    let mut wrong = Vec::new();
    for hard in hard_cases() {
        let found = gpu.verdicts(&hard.depth, std::slice::from_ref(&hard.case));
        if found != [hard.expected] {
            wrong.push((hard.name, hard.expected, found));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// The vertices of what `case` encloses, as Bevy transforms them and a rasteriser may place them: all that is within
/// the viewport must lie behind a pixel's depth if a test removed it.
fn drawn_pixels_hidden(
    depth: &ReducedDepth,
    case: &Case,
    verdict: Verdict,
    random: &mut Random,
) -> usize {
    let mut looked_at = 0;
    let world_from_local = Mat4::from(case.world);
    for k in 0..16 {
        // Corners, and points in between.
        let share = |random: &mut Random, bit: usize| match k {
            0..8 if k >> bit & 1 == 1 => 1.0,
            0..8 => -1.0,
            _ => random.within(-1.0, 1.0) as f32,
        };
        let mut local = case.volume.centre;
        for (bit, axis) in case.volume.axes.iter().enumerate() {
            local += *axis * share(random, bit);
        }
        // What is drawn lies in both boxes.
        let is_in = |turned: &LocalBox| {
            let axes = turned.axes.iter();
            let mut along =
                axes.map(|axis| (local - turned.centre).dot(*axis) / axis.length_squared());
            along.all(|share| share.abs() <= 1.0)
        };
        if !case.turned.as_ref().is_none_or(is_in) {
            continue;
        }
        let world = world_from_local * local.extend(1.0);
        let clip = depth.clip_from_world * world.truncate().extend(1.0);
        if clip.w <= 0.0 || clip.z < 0.0 || clip.z > clip.w {
            continue;
        }
        let ndc = clip.truncate() / clip.w;
        let px = (Vec2::new(ndc.x, -ndc.y) * 0.5 + 0.5) * depth.viewport;
        for snap in [-0.5, 0.0, 0.5] {
            let px = (px + snap / 256.0).floor();
            if px.min_element() < 0.0 || px.cmpge(depth.viewport).any() {
                continue;
            }
            let px = px.as_uvec2();
            let at = px / depth.block;
            if depth.strided && at * depth.block != px {
                continue;
            }
            looked_at += 1;
            assert_eq!(
                verdict,
                Verdict::Hidden,
                "{case:?} is not outside: {clip} at {px} of {}, {:?}",
                depth.viewport,
                depth.clip_from_world
            );
            let texel = depth.texels[(at.y * depth.levels[0].size.x + at.x) as usize];
            assert!(
                ndc.z < texel,
                "{case:?} shows at {px}: {} >= {texel}",
                ndc.z
            );
        }
    }
    looked_at
}

#[test]
fn random_verdicts_agree_and_remove_nothing_visible() {
    let gpu = Gpu::new();
    let mut random = Random(1);
    let mut tally = OcclusionTally::default();
    let (mut differing, mut compared, mut drawn) = (0, 0, 0);
    for _ in 0..512 {
        let (depth, cases) = random_view(&mut random, 256);
        let cpu = on_cpu(&depth, &cases);
        for (judgement, verdict) in judge(&depth, &cases).into_iter().zip(&cpu) {
            tally.add(judgement, *verdict);
        }
        for (case, verdict) in cases.iter().zip(&cpu) {
            // Vertices of a mesh with a proxy lie in the swept triangles, not all over the box.
            if *verdict != Verdict::Visible && case.proxy.is_none() {
                drawn += drawn_pixels_hidden(&depth, case, *verdict, &mut random);
            }
        }
        if let Some(gpu) = &gpu {
            let found = gpu.verdicts(&depth, &cases);
            for ((case, cpu), gpu) in cases.iter().zip(&cpu).zip(&found) {
                compared += 1;
                if cpu != gpu && differing < 5 {
                    println!("CPU {cpu:?}, GPU {gpu:?}: {case:?} in {depth:?}");
                }
                differing += usize::from(cpu != gpu);
            }
        }
    }
    println!(
        "decided {:?} (visible, hidden, outside), in the band {}, wrongly removed {} + {}, missed {}; CPU != GPU \
         {differing} of {compared}; vertices looked at {drawn}",
        tally.decided, tally.in_band, tally.removed_visible, tally.removed_in_band, tally.missed
    );
    tally.outcome(0.05).unwrap();
    assert!(tally.decided.iter().all(|count| *count > 5000));
    assert!(drawn > 10_000);
    assert_eq!(differing, 0);
    assert!(gpu.is_none() || compared >= 100_000);
}

#[test]
fn wrong_verdicts_are_found() {
    let mut random = Random(2);
    let mut tallies: [OcclusionTally; 5] = default();
    for _ in 0..64 {
        let (depth, cases) = random_view(&mut random, 64);
        for judgement in judge(&depth, &cases) {
            let answers = [
                judgement.tested,
                judgement.drawn,
                // Nothing is allowed for rounding.
                judgement.exact,
                Verdict::Visible,
                Verdict::Hidden,
            ];
            for (tally, verdict) in tallies.iter_mut().zip(answers) {
                tally.add(judgement, verdict);
            }
        }
    }
    let [tested, drawn, exact, visible, hidden] = tallies;
    assert!(tested.outcome(0.05).is_ok() && drawn.outcome(0.05).is_ok());
    assert!(exact.removed_in_band > 0 && exact.removed_visible == 0 && exact.missed == 0);
    assert!(visible.missed > 0 && visible.removed_visible == 0);
    assert!(hidden.removed_visible > 0 && hidden.missed > 0);
    for wrong in [exact, visible, hidden] {
        let reason = wrong.outcome(1.0).unwrap_err();
        assert!(reason.contains("are wrong"), "{reason}");
    }
    let reason = OcclusionTally::default().outcome(1.0).unwrap_err();
    assert!(reason.contains("nothing was compared"), "{reason}");
}

#[test]
fn a_gpu_that_sees_other_depth_is_found() {
    let Some(gpu) = Gpu::new() else { return };
    let mut random = Random(3);
    let mut differing = 0;
    for _ in 0..8 {
        let (depth, cases) = random_view(&mut random, 128);
        let mut other = depth.clone();
        for texel in &mut other.texels {
            *texel *= 0.5;
        }
        let pairs = on_cpu(&depth, &cases)
            .into_iter()
            .zip(gpu.verdicts(&other, &cases));
        differing += pairs.filter(|(cpu, gpu)| cpu != gpu).count();
    }
    assert!(differing > 0);
}

#[test]
fn levels_halve_down_to_one_texel() {
    for (width, height) in [(1, 1), (2, 1), (61, 47), (1280, 720), (16_384, 16_384)] {
        for block in [1, 3, 4, 64] {
            let viewport = UVec2::new(width, height);
            let levels = layout(viewport, UVec2::splat(block));
            assert!(levels.len() <= 16);
            assert_eq!(levels[0].first, 0);
            assert_eq!(levels[0].size.x, width.div_ceil(block));
            assert_eq!(levels.last().map(|level| level.size), Some(UVec2::ONE));
            for pair in levels.windows(2) {
                assert_eq!(pair[1].size, (pair[0].size + 1) / 2);
                let texels = pair[0].size.x * pair[0].size.y;
                assert_eq!(pair[1].first, pair[0].first + texels);
            }
            let last = levels[levels.len() - 1];
            assert_eq!(texel_count(&levels), last.first as usize + 1);
        }
    }
}

#[test]
fn reduction_takes_the_farthest_of_every_pixel() {
    let mut random = Random(4);
    for k in 0..200 {
        let viewport = UVec2::new(1 + random.below(40) as u32, 1 + random.below(40) as u32);
        let pixels: Vec<f32> = (0..viewport.x * viewport.y)
            .map(|_| random.within(0.0, 1.0) as f32)
            .collect();
        let sampling = if k % 2 == 0 {
            DepthSampling::Conservative {
                block: 1 + random.below(7) as u32,
            }
        } else {
            DepthSampling::Strided {
                x: 1 + random.below(7) as u32,
                y: 1 + random.below(7) as u32,
            }
        };
        let depth = ReducedDepth::from_pixels(Mat4::IDENTITY, viewport, sampling, &pixels).unwrap();
        assert!(depth.is_consistent());
        for (number, level) in depth.levels.iter().enumerate() {
            for j in 0..level.size.y {
                for i in 0..level.size.x {
                    let scale = depth.block * (1 << number);
                    let low = UVec2::new(i, j) * scale;
                    let high = (low + scale).min(viewport);
                    let mut farthest = 1.0f32;
                    for y in low.y..high.y {
                        for x in low.x..high.x {
                            let sampled = x % depth.block.x == 0 && y % depth.block.y == 0;
                            if sampled || !depth.strided {
                                farthest = farthest.min(pixels[(y * viewport.x + x) as usize]);
                            }
                        }
                    }
                    let texel = depth.texels[(level.first + j * level.size.x + i) as usize];
                    assert_eq!(texel, farthest);
                }
            }
        }
    }
    let size = UVec2::new(3, 2);
    let sampling = DepthSampling::default();
    assert!(ReducedDepth::from_pixels(Mat4::IDENTITY, size, sampling, &[0.0; 5]).is_err());
    assert!(ReducedDepth::from_pixels(Mat4::IDENTITY, UVec2::ZERO, sampling, &[]).is_err());
}

#[test]
fn a_test_allocates_nothing() {
    let (depth, cases) = random_view(&mut Random(5), 256);
    let test = DepthTest::new(&depth);
    let mut hidden = 0;
    let allocations = allocations::count(|| {
        for case in &cases {
            let verdict = case_verdict(&test, case);
            hidden += usize::from(verdict == Verdict::Hidden);
        }
    });
    assert!(hidden > 0);
    assert_eq!(allocations, 0);
}
