// Highest and lowest sample of every node, one level a dispatch, bottom-up; only under the edited rectangle.
// A node's samples include those it shares with its right and lower neighbours, or its box would not be a
// bound; as level 1 takes all nine samples of its 2 x 2 cells, the levels above are plain maxima and minima.
//
// In:  `heights` for level 1, the level below for the others. Out: `pyramid`, (max << 16 | min) of 16-bit
// fields, vec2(max, min) of float ones.
// P1 section 3.1; Tevs, Ihrke and Seidel 2008.

struct Level {
    /// First node to write, and how many.
    first: vec2<i32>,
    count: vec2<i32>,
    /// Samples of the field (level 1) or nodes of the level below.
    size_in: vec2<i32>,
    offset_in: u32,
    offset_out: u32,
    /// Nodes a row of this level.
    width_out: i32,
    level: u32,
};

@group(0) @binding(0) var<uniform> level: Level;
#ifdef HEIGHT_F32
@group(0) @binding(1) var heights: texture_2d<f32>;
@group(0) @binding(2) var<storage, read_write> pyramid: array<vec2<f32>>;
#else
@group(0) @binding(1) var heights: texture_2d<u32>;
@group(0) @binding(2) var<storage, read_write> pyramid: array<u32>;
#endif

#ifdef HEIGHT_F32
fn load(at: vec2<i32>) -> vec2<f32> {
    if level.level == 1u {
        return vec2(textureLoad(heights, at, 0).x);
    }
    return pyramid[level.offset_in + u32(at.y * level.size_in.x + at.x)];
}

fn join(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    return vec2(max(a.x, b.x), min(a.y, b.y));
}
#else
fn load(at: vec2<i32>) -> vec2<u32> {
    if level.level == 1u {
        return vec2(textureLoad(heights, at, 0).x);
    }
    let packed = pyramid[level.offset_in + u32(at.y * level.size_in.x + at.x)];
    return vec2(packed >> 16u, packed & 0xffffu);
}

fn join(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    return vec2(max(a.x, b.x), min(a.y, b.y));
}
#endif

@compute @workgroup_size(8, 8, 1)
fn height_mips(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(vec2<i32>(id.xy) >= level.count) {
        return;
    }
    let node = level.first + vec2<i32>(id.xy);
    let first = 2 * node;
    let last = min(first + select(1, 2, level.level == 1u), level.size_in - 1);
    var range = load(first);
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            range = join(range, load(vec2(x, y)));
        }
    }
    let index = level.offset_out + u32(node.y * level.width_out + node.x);
#ifdef HEIGHT_F32
    pyramid[index] = range;
#else
    pyramid[index] = (range.x << 16u) | range.y;
#endif
}
