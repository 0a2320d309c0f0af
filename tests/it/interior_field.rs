//! The directed distance field of the shipped WGSL against the CPU's, bit for bit.

use core::num::NonZero;
use std::sync::Arc;

use bevy::{
    math::{DAffine3, DVec3},
    render::renderer::{RenderDevice, RenderQueue},
};
use bevy_skyline::{
    interior::{
        FieldDevice, FieldOrigin, InteriorCulling, InteriorGpu, InteriorGpuError, InteriorLevel,
        InteriorMode, InteriorTransparent, Model, Part, Progress, Stage, Surface, Verdict, cull,
        cull_on,
        field::Field,
        gpu::INTERIOR_FIELD_WGSL,
        lattice::{Lattice, UNITS},
        overlap::Snapped,
    },
    offline::Offline,
};

use crate::occlusion_cases::Random;

/// A device of its own.
pub struct Gpu {
    _offline: Offline,
    device: wgpu::Device,
    queue: wgpu::Queue,
}

impl Gpu {
    /// `None`, with the reason printed, where this machine has no device at all.
    pub fn new() -> Option<Self> {
        let offline = crate::device()?;
        let world = offline.app.world();
        let device = world.resource::<RenderDevice>().wgpu_device().clone();
        let queue: &wgpu::Queue = world.resource::<RenderQueue>();
        let queue = queue.clone();
        Some(Self {
            _offline: offline,
            device,
            queue,
        })
    }

    pub fn interior(&self) -> InteriorGpu {
        InteriorGpu::new(self.device.clone(), self.queue.clone())
    }
}

/// So many points along each axis.
fn lattice(size: [u32; 3]) -> Lattice {
    Lattice {
        origin: DVec3::ZERO,
        spacing: 1.0,
        size,
        words: size[0].div_ceil(64) as usize,
    }
}

type Soup = Vec<(Snapped, bool)>;

/// A triangle as snapping gives them: at least two spacings from the lattice's ends.
struct Dice<'a> {
    random: &'a mut Random,
    size: [u32; 3],
}

impl Dice<'_> {
    fn below(&mut self, n: i32) -> i32 {
        self.random.below(n as u64) as i32
    }

    /// Anywhere.
    fn corner(&mut self) -> [i32; 3] {
        self.size
            .map(|size| 2 * UNITS + self.below((size as i32 - 5) * UNITS + 1))
    }

    /// At most so far away, in each axis.
    fn near(&mut self, corner: [i32; 3], by: i32) -> [i32; 3] {
        let [x, y, z] = corner.map(|at| at + self.below(2 * by + 1) - by);
        self.inside([x, y, z])
    }

    fn inside(&self, corner: [i32; 3]) -> [i32; 3] {
        core::array::from_fn(|axis| {
            corner[axis].clamp(2 * UNITS, (self.size[axis] as i32 - 3) * UNITS)
        })
    }

    /// Onto points, or where the boxes around steps begin and end.
    fn on_planes(&mut self, corner: [i32; 3]) -> [i32; 3] {
        let off = [-16, 0, 16, 128][self.below(4) as usize];
        let corner = corner.map(|at| (at + UNITS / 2).div_euclid(UNITS) * UNITS + off);
        self.inside(corner)
    }

    fn triangle(&mut self) -> [[i32; 3]; 3] {
        let a = self.corner();
        match self.below(12) {
            0 => [a, a, a],
            1 => {
                let b = self.near(a, 3 * UNITS);
                [a, b, a]
            }
            // On one line.
            2 => {
                let by: [i32; 3] = core::array::from_fn(|_| self.below(201) - 100);
                let on = |times: i32| core::array::from_fn(|axis| a[axis] + times * by[axis]);
                let [b, c] = [on(1), on(3)];
                if self.inside(c) == c && self.inside(b) == b {
                    [a, b, c]
                } else {
                    [a, a, a]
                }
            }
            // A sliver.
            3 => {
                let b = self.corner();
                let c = self.near(b, 1);
                [a, b, c]
            }
            // In a plane across an axis.
            4 => {
                let axis = self.below(3) as usize;
                let mut all = [a, self.near(a, 5 * UNITS), self.near(a, 5 * UNITS)];
                let at = self.on_planes(a)[axis];
                for corner in &mut all {
                    corner[axis] = at;
                }
                all
            }
            5 => {
                let all = [a, self.near(a, 4 * UNITS), self.near(a, 4 * UNITS)];
                all.map(|corner| self.on_planes(corner))
            }
            // From one end to the other.
            6 => [a, self.corner(), self.corner()],
            7 | 8 => [a, self.near(a, 3 * UNITS), self.near(a, 3 * UNITS)],
            _ => [a, self.near(a, UNITS), self.near(a, UNITS)],
        }
    }
}

/// Triangles of all kinds, some of them twice, and twice the other way round.
fn soup(random: &mut Random, size: [u32; 3], count: usize, one_sided: bool) -> Soup {
    let mut dice = Dice { random, size };
    let mut soup: Soup = Vec::new();
    while soup.len() < count {
        let [a, b, c] = dice.triangle();
        let is_two_sided = !one_sided || dice.below(3) == 0;
        soup.push((Snapped::new([a, b, c]), is_two_sided));
        match dice.below(8) {
            0 => soup.push((Snapped::new([b, c, a]), is_two_sided)),
            1 => soup.push((Snapped::new([a, c, b]), is_two_sided)),
            _ => {}
        }
    }
    soup
}

/// Steps with something in the way, of all.
fn blocked(field: &Field, lattice: &Lattice, is_one_sided: bool) -> (usize, usize) {
    let [x, y, z] = lattice.size;
    let mut count = (0, 0);
    for point in (0..z).flat_map(|z| (0..y).flat_map(move |y| (0..x).map(move |x| [x, y, z]))) {
        for axis in 0..3 {
            count.0 += usize::from(field.is_blocked_up(lattice, point, axis));
            count.1 += 1;
            if is_one_sided {
                count.0 += usize::from(field.is_blocked_down(lattice, point, axis));
                count.1 += 1;
            }
        }
    }
    count
}

/// Asserts that both make the same of triangles; whether they block anything.
fn agree(gpu: &InteriorGpu, lattice: &Lattice, soup: &Soup, is_one_sided: bool) -> bool {
    let there = gpu
        .field(lattice, soup, is_one_sided)
        .expect("the device works");
    let here = Field::of(lattice, soup.iter().copied(), is_one_sided);
    assert!(
        there == here,
        "{:?}, one-sided: {is_one_sided}, {} triangles: {:?}",
        lattice.size,
        soup.len(),
        &soup[..soup.len().min(4)]
    );
    here != Field::of(lattice, [], is_one_sided)
}

const SIZES: [[u32; 3]; 7] = [
    [6, 6, 6],
    [7, 33, 12],
    [33, 20, 9],
    [64, 40, 5],
    [65, 31, 32],
    [96, 6, 70],
    [130, 17, 66],
];

#[test]
fn the_bits_are_the_cpus() {
    let Some(gpu) = Gpu::new() else { return };
    let interior = gpu.interior();
    let random = &mut Random(1);
    for size in SIZES {
        let lattice = lattice(size);
        for is_one_sided in [false, true] {
            for count in [1, 3, 10, 400] {
                let soup = soup(random, size, count, is_one_sided);
                let is_any = agree(&interior, &lattice, &soup, is_one_sided);
                assert!(is_any || count < 10, "nothing compared");
            }
        }
    }
}

/// One at a time, so that no triangle's bits hide what another's lack.
#[test]
fn the_bits_of_each_triangle_are_the_cpus() {
    let Some(gpu) = Gpu::new() else { return };
    let random = &mut Random(2);
    let size = [40, 37, 35];
    let lattice = lattice(size);
    let interior = gpu.interior();
    let mut count = 0;
    for _ in 0..150 {
        let soup = soup(random, size, 1, true);
        count += usize::from(agree(&interior, &lattice, &soup, true));
    }
    assert!(count > 75, "only {count} triangles block anything");
}

/// Up to the largest coordinates there are, in two axes at a time. In all three, the bits of the lattice would take
/// 24 GiB: see `pieces_of_the_hugest_triangles_are_exact`.
#[test]
fn the_bits_of_huge_triangles_are_the_cpus() {
    let Some(gpu) = Gpu::new() else { return };
    let interior = gpu.interior();
    let random = &mut Random(3);
    for thin in 0..3 {
        let mut size = [4096; 3];
        size[thin] = 7;
        let lattice = lattice(size);
        let most = size.map(|size| (size as i32 - 3) * UNITS);
        let [least, x, y] = [[2 * UNITS; 3], [most[0], 2 * UNITS, most[2]], most];
        let mut soup = vec![
            (Snapped::new([least, x, y]), true),
            (Snapped::new([least, y, y]), true),
        ];
        let mut dice = Dice { random, size };
        for _ in 0..2 {
            let corners = core::array::from_fn(|_| dice.corner());
            soup.push((Snapped::new(corners), true));
        }
        assert!(agree(&interior, &lattice, &soup, false), "nothing compared");
    }
}

/// The least memory that does: one layer at a time.
fn one_layer(interior: &InteriorGpu, lattice: &Lattice) -> InteriorGpu {
    let refused = interior
        .clone()
        .with_memory(0)
        .field(lattice, &Vec::new(), true);
    let Err(InteriorGpuError::Memory { needs, allowed: 0 }) = refused else {
        panic!("no memory is not enough: {refused:?}");
    };
    let almost = interior.clone().with_memory(needs - 1);
    assert!(almost.field(lattice, &Vec::new(), true).is_err());
    interior.clone().with_memory(needs)
}

#[test]
fn slabs_do_not_show() {
    let Some(gpu) = Gpu::new() else { return };
    let interior = gpu.interior();
    let size = [70, 30, 23];
    let lattice = lattice(size);
    let soup = soup(&mut Random(4), size, 300, true);
    let layer = one_layer(&interior, &lattice);
    let whole = interior.field(&lattice, &soup, true);
    assert!(agree(&interior, &lattice, &soup, true));
    assert_eq!(layer.field(&lattice, &soup, true), whole);
    // More pieces than a submission has, and so more than one.
    let many: Soup = soup.iter().copied().cycle().take(60_000).collect();
    assert_eq!(interior.field(&lattice, &many, true), whole);
}

/// The comparisons above fail if one side is another.
#[test]
fn a_perturbed_side_is_told_apart() {
    let Some(gpu) = Gpu::new() else { return };
    let interior = gpu.interior();
    let size = [40, 30, 20];
    let lattice = lattice(size);
    let at = |x: i32| {
        let all = [[x, 600, 600], [x, 2600, 600], [x, 600, 2600]];
        vec![(Snapped::new(all), false)]
    };
    // The seal of a step ends 16 units beyond its point: one unit farther, it is free.
    let end = 10 * UNITS + 16;
    let there = |soup: &Soup| interior.field(&lattice, soup, true).expect("it works");
    let here = |soup: &Soup| Field::of(&lattice, soup.iter().copied(), true);
    for x in [end, end + 1] {
        assert_eq!(there(&at(x)), here(&at(x)));
    }
    assert_ne!(there(&at(end + 1)), here(&at(end)));
    // The other way round, other steps are free.
    let turned: Soup = at(end)
        .iter()
        .map(|(triangle, sided)| {
            let [a, b, c] = triangle.corners;
            (Snapped::new([a, c, b]), *sided)
        })
        .collect();
    assert_eq!(there(&turned), here(&turned));
    assert_ne!(there(&turned), here(&at(end)));
    // As two-sided, neither is.
    let both: Soup = at(end).iter().map(|(t, _)| (*t, true)).collect();
    assert_eq!(there(&both), here(&both));
    assert_ne!(there(&both), here(&turned));
    let (some, all) = blocked(&there(&both), &lattice, true);
    assert!(0 < some && some < all, "{some} of {all}");
}

/// What the slab of the test below is in the shader.
const FIRST_LAYER: i32 = 2011;
const LAYERS: i32 = 4;
const ROWS: i32 = 4096;
const WORDS: i32 = 128;

/// A triangle from end to end of the largest lattice, and 256 points around one of its own.
fn hugest_piece(random: &mut Random) -> (Snapped, [i32; 3]) {
    const MOST: i32 = (4096 - 3) * UNITS;
    let mut below = |n: i32| random.below(n as u64) as i32;
    // Near either end.
    let mut end = || {
        let from = below(1000);
        if below(2) == 0 {
            2 * UNITS + from
        } else {
            MOST - from
        }
    };
    let mut corners: [[i32; 3]; 3] = core::array::from_fn(|_| core::array::from_fn(|_| end()));
    corners[0][2] = 2 * UNITS + below(1000);
    corners[1][2] = MOST - below(1000);
    let turn = below(3) as usize;
    let [a, b, c] = corners.map(|corner| corner.map(f64::from));
    // Where it is cut by a plane in the layers: on one line between two of its edges.
    let level = f64::from((FIRST_LAYER + 1) * UNITS + below(2 * UNITS));
    let cut = |from: [f64; 3], to: [f64; 3]| {
        let by = (level - from[2]) / (to[2] - from[2]);
        core::array::from_fn::<_, 3, _>(|axis| from[axis] + by * (to[axis] - from[axis]))
    };
    let (p, q) = (cut(a, b), if c[2] > level { cut(a, c) } else { cut(c, b) });
    let by = f64::from(below(1001)) / 1000.0;
    let mut first = core::array::from_fn(|axis| {
        let at = p[axis] + by * (q[axis] - p[axis]);
        (at as i32 / UNITS - 3 - below(2)).clamp(0, 4095 - 8)
    });
    first[2] = FIRST_LAYER;
    corners.rotate_left(turn);
    (Snapped::new(corners), first)
}

/// With the largest coordinates in all three axes: every step of pieces of such triangles, by the exact test of each
/// one's box alone. And the same with a shader that is perturbed by one unit, which must be told apart.
#[test]
fn pieces_of_the_hugest_triangles_are_exact() {
    let Some(gpu) = Gpu::new() else { return };
    let random = &mut Random(9);
    let direction = LAYERS * ROWS * WORDS;
    let mut pieces: Vec<[i32; 16]> = Vec::new();
    let mut expected = vec![0u32; 3 * direction as usize];
    for _ in 0..400 {
        let (triangle, first) = hugest_piece(random);
        let last = [first[0] + 7, first[1] + 7, first[2] + LAYERS - 1];
        let words = [&triangle.corners.concat()[..], &first, &last, &[1]].concat();
        pieces.push(words.try_into().expect("16 words"));
        for number in 0..256 {
            let point = [
                first[0] + (number & 7),
                first[1] + (number >> 3 & 7),
                first[2] + (number >> 6),
            ];
            for axis in 0..3 {
                let (mut centre, mut half) = (point.map(|at| at * UNITS), [16; 3]);
                centre[axis] += UNITS / 2;
                half[axis] += UNITS / 2;
                if triangle.overlaps(centre, half) {
                    let row = (point[2] - FIRST_LAYER) * ROWS + point[1];
                    let word = axis as i32 * direction + row * WORDS + point[0] / 32;
                    expected[word as usize] |= 1 << (point[0] % 32);
                }
            }
        }
    }
    let set: u32 = expected.iter().map(|word| word.count_ones()).sum();
    assert!(set > 10_000, "only {set} steps are blocked");
    let slab = [WORDS, ROWS, FIRST_LAYER, direction, 0, 0, 0, 0];
    let found = |source: &str| -> Vec<u32> {
        dispatch(
            &gpu,
            source,
            ("interior_field", 0),
            &[
                (wgpu::BufferUsages::UNIFORM, bytemuck::cast_slice(&slab)),
                (wgpu::BufferUsages::STORAGE, bytemuck::cast_slice(&pieces)),
            ],
            expected.len(),
            pieces.len(),
        )
    };
    assert!(found(INTERIOR_FIELD_WGSL) == expected);
    for (constant, other) in [
        ("const SEAL: i32 = 16;", "const SEAL: i32 = 15;"),
        (
            "const HALF_ALONG: i32 = 144;",
            "const HALF_ALONG: i32 = 145;",
        ),
    ] {
        let perturbed = INTERIOR_FIELD_WGSL.replace(constant, other);
        assert_ne!(perturbed, INTERIOR_FIELD_WGSL);
        assert!(found(&perturbed) != expected, "{other}");
    }
}

/// What the shader's wide numbers give, next to what i64 gives: the functions are those of the shipped WGSL.
const WIDE_TEST: &str = "
@group(1) @binding(0) var<storage, read> operands: array<array<u32, 14>>;
@group(1) @binding(1) var<storage, read_write> results: array<array<u32, 46>>;

@compute @workgroup_size(64)
fn wide_test(@builtin(global_invocation_id) id: vec3<u32>) {
    let at = id.x;
    if at >= arrayLength(&operands) {
        return;
    }
    let o = operands[at];
    let a = Wide3(vec3(o[0], o[1], o[2]), vec3(o[3], o[4], o[5]));
    let b = Wide3(vec3(o[6], o[7], o[8]), vec3(o[9], o[10], o[11]));
    let p = bitcast<vec3<i32>>(a.low);
    let q = bitcast<vec3<i32>>(b.low);
    var wides = array(
        wide_sum(a, b), wide_difference(a, b), wide_product(p, q), wide_multiple(a, q), wide_size(a), wide(p),
    );
    for (var i = 0u; i < 6u; i++) {
        for (var j = 0u; j < 3u; j++) {
            results[at][6u * i + 2u * j] = wides[i].low[j];
            results[at][6u * i + 2u * j + 1u] = wides[i].high[j];
        }
    }
    let floor = floor_spacings(a);
    let negative = is_negative(a);
    for (var j = 0u; j < 3u; j++) {
        results[at][36u + j] = bitcast<u32>(floor[j]);
        results[at][39u + j] = select(0u, 1u, negative[j]);
    }
    let one = total(a);
    results[at][42] = one.x;
    results[at][43] = one.y;
    let other = vec2(b.low.x, b.high.x);
    results[at][44] = select(0u, 1u, is_at_most(vec2(a.low.x, a.high.x), other));
    let spacings = in_spacings(other);
    results[at][45] = spacings.x ^ spacings.y;
}
";

/// The same in i64.
fn wide_twin(a: [i64; 3], b: [i64; 3]) -> [u32; 46] {
    let (p, q) = (a.map(|a| a as i32), b.map(|b| b as i32));
    let each = |f: &dyn Fn(usize) -> i64| -> [i64; 3] { core::array::from_fn(f) };
    let wides = [
        each(&|i| a[i].wrapping_add(b[i])),
        each(&|i| a[i].wrapping_sub(b[i])),
        each(&|i| i64::from(p[i]) * i64::from(q[i])),
        each(&|i| a[i].wrapping_mul(i64::from(q[i]))),
        each(&|i| a[i].wrapping_abs()),
        each(&|i| i64::from(p[i])),
    ];
    let mut all = Vec::new();
    for wide in wides.into_iter().flatten() {
        all.extend([wide as u32, (wide >> 32) as u32]);
    }
    all.extend(a.map(|a| a.div_euclid(256).clamp(-1 << 30, 1 << 30) as u32));
    all.extend(a.map(|a| u32::from(a < 0)));
    let total = a[0].wrapping_add(a[1]).wrapping_add(a[2]);
    all.extend([total as u32, (total >> 32) as u32]);
    all.push(u32::from(a[0] as u64 <= b[0] as u64));
    let spacings = b[0].wrapping_mul(256);
    all.push(spacings as u32 ^ (spacings >> 32) as u32);
    all.try_into().expect("46 words")
}

/// Runs an entry point over so many invocations, with buffers at bindings from 0 on and, at the next, one of zeros of
/// so many words, which comes back.
fn dispatch(
    gpu: &Gpu,
    source: &str,
    (entry_point, group): (&str, u32),
    inputs: &[(wgpu::BufferUsages, &[u8])],
    words: usize,
    invocations: usize,
) -> Vec<u32> {
    use wgpu::BufferUsages;

    let (device, queue) = (&gpu.device, &gpu.queue);
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: None,
        source: wgpu::ShaderSource::Wgsl(source.into()),
    });
    let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: None,
        layout: None,
        module: &module,
        entry_point: Some(entry_point),
        compilation_options: Default::default(),
        cache: None,
    });
    let buffer = |size, usage| {
        device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size,
            usage,
            mapped_at_creation: false,
        })
    };
    let size = 4 * words as u64;
    let mut buffers: Vec<_> = inputs
        .iter()
        .map(|(usage, bytes)| {
            let buffer = buffer(bytes.len() as u64, *usage | BufferUsages::COPY_DST);
            queue.write_buffer(&buffer, 0, bytes);
            buffer
        })
        .collect();
    let out = buffer(size, BufferUsages::STORAGE | BufferUsages::COPY_SRC);
    let back = buffer(size, BufferUsages::MAP_READ | BufferUsages::COPY_DST);
    buffers.push(out.clone());
    let entries: Vec<_> = buffers
        .iter()
        .zip(0..)
        .map(|(buffer, binding)| wgpu::BindGroupEntry {
            binding,
            resource: buffer.as_entire_binding(),
        })
        .collect();
    let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(group),
        entries: &entries,
    });
    let mut encoder = device.create_command_encoder(&Default::default());
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(group, &bindings, &[]);
        pass.dispatch_workgroups(invocations.div_ceil(64) as u32, 1, 1);
    }
    encoder.copy_buffer_to_buffer(&out, 0, &back, 0, size);
    queue.submit([encoder.finish()]);
    back.slice(..)
        .map_async(wgpu::MapMode::Read, |result| result.expect("mapped"));
    device
        .poll(wgpu::PollType::wait_indefinitely())
        .expect("the device works");
    bytemuck::pod_collect_to_vec(&back.slice(..).get_mapped_range())
}

/// Runs the test's entry point beside the shipped one.
fn wide_results(gpu: &Gpu, operands: &[[i64; 6]]) -> Vec<[u32; 46]> {
    let words: Vec<[u32; 14]> = operands
        .iter()
        .map(|all| {
            let (low, high) = (all.map(|v| v as u32), all.map(|v| (v >> 32) as u32));
            let parts = [&low[..3], &high[..3], &low[3..], &high[3..], &[0, 0]].concat();
            parts.try_into().expect("14 words")
        })
        .collect();
    let found = dispatch(
        gpu,
        &format!("{INTERIOR_FIELD_WGSL}{WIDE_TEST}"),
        ("wide_test", 1),
        &[(wgpu::BufferUsages::STORAGE, bytemuck::cast_slice(&words))],
        46 * operands.len(),
        operands.len(),
    );
    found.as_chunks().0.to_vec()
}

#[test]
fn wide_numbers_are_i64() {
    let Some(gpu) = Gpu::new() else { return };
    const EXTREMES: [i64; 24] = [
        0,
        1,
        -1,
        255,
        256,
        -256,
        -257,
        0xffff,
        0x1_0000,
        i32::MAX as i64,
        i32::MIN as i64,
        0xffff_ffff,
        0x1_0000_0000,
        -0x1_0000_0000,
        -0x1_0000_0001,
        (1 << 38) - 1,
        1 << 38,
        -(1 << 38) - 1,
        1 << 41,
        -(1 << 41),
        (1 << 62) + 12345,
        -(1 << 62),
        i64::MAX,
        i64::MIN,
    ];
    let mut operands = Vec::new();
    for (i, a) in EXTREMES.iter().enumerate() {
        for b in EXTREMES {
            let next = EXTREMES[(i + 7) % EXTREMES.len()];
            operands.push([*a, b, next, b, *a, b]);
        }
    }
    let random = &mut Random(5);
    for _ in 0..20_000 {
        // Of all magnitudes.
        operands.push(core::array::from_fn(|_| {
            let bits = (random.below(1 << 32) << 32 | random.below(1 << 32)) as i64;
            bits >> random.below(64)
        }));
    }
    let found = wide_results(&gpu, &operands);
    assert_eq!(found.len(), operands.len());
    for ([a, b, c, d, e, f], found) in operands.iter().zip(&found) {
        let expected = wide_twin([*a, *b, *c], [*d, *e, *f]);
        assert_eq!(*found, expected, "{a:x} {b:x} {c:x}, {d:x} {e:x} {f:x}");
    }
    // One bit of an operand is told apart.
    let [a, b, c, d, e, f] = operands[700];
    assert_ne!(found[700], wide_twin([a ^ 1, b, c], [d, e, f]));
}

fn tetrahedra(random: &mut Random, count: usize, within: f32, side: f32) -> Surface {
    let mut surface = Surface::default();
    for _ in 0..count {
        let mut one = || random.within(-1.0, 1.0) as f32;
        let at: [f32; 3] = core::array::from_fn(|_| one() * within);
        let first = surface.positions.len() as u32;
        for _ in 0..4 {
            surface.positions.push(at.map(|at| at + one() * side));
        }
        let faces = [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]];
        surface
            .triangles
            .extend(faces.map(|face| face.map(|corner| corner + first)));
    }
    surface
}

/// A hull around much and beneath some, mirrored, transparent or two-sided.
fn model(random: &mut Random) -> Model {
    let hull = Surface {
        positions: (0..8u32)
            .map(|i| core::array::from_fn(|axis| (i >> axis & 1) as f32 * 2.4 - 1.2))
            .collect(),
        triangles: [
            [0, 4, 6, 2],
            [1, 3, 7, 5],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 2, 3, 1],
            [4, 5, 7, 6],
        ]
        .iter()
        .flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]])
        .collect(),
    };
    let inner = Arc::new(tetrahedra(random, 300, 0.9, 0.08));
    let part = |node, surface: &Arc<Surface>| Part {
        node,
        surface: surface.clone(),
        model_from_local: DAffine3::IDENTITY,
        is_transparent: false,
        is_two_sided: false,
    };
    Model {
        parts: vec![
            part(0, &Arc::new(hull)),
            part(1, &inner),
            Part {
                model_from_local: DAffine3::from_scale(DVec3::new(-0.7, 1.1, 0.9)),
                ..part(2, &inner)
            },
            Part {
                is_two_sided: true,
                model_from_local: DAffine3::from_scale(DVec3::splat(0.5)),
                ..part(3, &inner)
            },
            Part {
                is_transparent: true,
                model_from_local: DAffine3::from_scale(DVec3::splat(1.6)),
                ..part(4, &inner)
            },
        ],
    }
}

#[test]
fn verdicts_are_the_same_wherever_the_field_was_made() {
    let Some(gpu) = Gpu::new() else { return };
    let interior = gpu.interior();
    let model = model(&mut Random(6));
    let threads = NonZero::new(3).expect("three");
    for settings in [
        InteriorCulling::default(),
        InteriorCulling {
            mode: InteriorMode::Sampled,
            transparent: InteriorTransparent::Closed,
            ..Default::default()
        },
        InteriorCulling {
            level: InteriorLevel::Node,
            grid: bevy_skyline::interior::InteriorGrid::Resolution(41),
            faces: bevy_skyline::interior::InteriorFaces::TwoSided,
            ..Default::default()
        },
    ] {
        let progress = Progress::default();
        let here = cull(&model, &settings, threads, &progress).expect("it can be culled");
        assert_eq!(here.field_origin, FieldOrigin::Cpu);
        let verdicts = |device| {
            let found = cull_on(device, &model, &settings, threads, &progress);
            let found = found.expect("it can be culled");
            assert_eq!(found.parts, here.parts);
            assert_eq!(found.outside_points, here.outside_points);
            found.field_origin
        };
        assert_eq!(verdicts(FieldDevice::Gpu(&interior)), FieldOrigin::Gpu);
        let small = one_layer(&interior, &here.lattice);
        assert_eq!(verdicts(FieldDevice::Gpu(&small)), FieldOrigin::Gpu);
        // What the GPU cannot do, the CPU does.
        let none = interior.clone().with_memory(0);
        assert!(matches!(
            verdicts(FieldDevice::Gpu(&none)),
            FieldOrigin::Fallback(InteriorGpuError::Memory { .. })
        ));
        if settings == InteriorCulling::default() {
            assert!(
                here.parts
                    .iter()
                    .any(|verdict| matches!(verdict, Verdict::Partly(_))),
                "nothing compared"
            );
        }
    }
}

#[test]
fn a_culling_on_the_gpu_can_be_stopped() {
    let Some(gpu) = Gpu::new() else { return };
    let interior = gpu.interior();
    // So much that it takes seconds, in many slabs.
    let mut model = model(&mut Random(7));
    let parts = model.parts.clone();
    for _ in 0..40 {
        model.parts.extend(parts.iter().cloned());
    }
    let settings = InteriorCulling {
        grid: bevy_skyline::interior::InteriorGrid::Resolution(400),
        ..Default::default()
    };
    let threads = NonZero::<usize>::MIN;
    let (lattice, _) =
        bevy_skyline::interior::distance_field(&model, &settings, threads, &Progress::default())
            .expect("it can be made");
    let small = one_layer(&interior, &lattice);
    let progress = Progress::default();
    let stopped = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !matches!(progress.now(), (Stage::Field, done) if done > 0.0) {
                std::thread::yield_now();
            }
            progress.cancel();
        });
        cull_on(
            FieldDevice::Gpu(&small),
            &model,
            &settings,
            threads,
            &progress,
        )
    });
    assert_eq!(progress.now().0, Stage::Field);
    assert!(matches!(
        stopped,
        Err(bevy_skyline::interior::InteriorError::Cancelled)
    ));
}

#[test]
fn a_device_that_is_lost_is_an_error() {
    let Some(gpu) = Gpu::new() else { return };
    let interior = gpu.interior();
    let size = [40, 30, 20];
    let lattice = lattice(size);
    let soup = soup(&mut Random(8), size, 100, false);
    assert!(agree(&interior, &lattice, &soup, false));
    gpu.device.destroy();
    let lost = interior.field(&lattice, &soup, false);
    assert!(
        matches!(
            lost,
            Err(InteriorGpuError::NoAnswer | InteriorGpuError::Device(_))
        ),
        "{lost:?}"
    );
}
