// Shadows of a directional light by sweeping away from it: along parallel lines, one a sample across, the height of
// the shadow is carried along. What is highest so far casts it, and it falls by the light's slope a step.
//
// Line k meets column n of the sweep at row k + n m, rounded to the nearest sample alike for all lines, so that
// every sample belongs to exactly one of them. Whether that sample is lit is told at the line, up to half a cell
// beside it, by the line's own height: a plane that faces the light has no acne.
//
// With a disc two shadows are carried, of its lower and its upper edge: a sample between the two sees a part of
// it, told exactly where both are cast by the same edge.
//
// In: `sweep`, which lines. Out: `visibility`, cleared to 0 before.
// Linear in the samples, as Timonen and Westerholm 2010, with a fixed elevation in place of all of them.

#import bevy_skyline::height_field::{field, sample_height}
#import bevy_skyline::light_rays::{cap_area, light, map_byte}

/// Mirrors `GpuSweep`.
struct Sweep {
    /// First line, and how many lines this dispatch has.
    first: i32,
    count: u32,
    /// Whether columns of the sweep are columns of the field (1) or rows (0).
    along_x: u32,
    /// 1: from the first column on, 0: from the last one back.
    forward: u32,
    /// Rows a line moves on with each column.
    m: f32,
    /// What the shadow of the disc's middle, lower and upper edge falls by with each column. units: grid
    drop: f32,
    drop_low: f32,
    drop_high: f32,
};

@group(1) @binding(1) var<uniform> sweep: Sweep;
@group(1) @binding(2) var<storage, read_write> visibility: array<atomic<u32>>;

fn at_of(column: i32, row: i32) -> vec2<i32> {
    return select(vec2(row, column), vec2(column, row), sweep.along_x == 1u);
}

/// What casts the shadow: its height, and at which step it stood.
struct Edge {
    height: f32,
    step: i32,
};

/// Height of an edge's shadow at a step.
fn shadow_of(edge: Edge, step: i32, drop: f32) -> f32 {
    return edge.height - f32(step - edge.step) * drop;
}

@compute @workgroup_size(64, 1, 1)
fn shadow_sweep(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sweep.count {
        return;
    }
    let line = sweep.first + i32(id.x);
    let size = field.cells + 1;
    let columns = select(size.y, size.x, sweep.along_x == 1u);
    let rows = select(size.x, size.y, sweep.along_x == 1u);
    // The steps at which the line is over the field, give or take one.
    var first = 0;
    var last = columns - 1;
    if abs(sweep.m) > 1e-6 {
        let a = (-1.0 - f32(line)) / sweep.m;
        let b = (f32(rows) - f32(line)) / sweep.m;
        first = max(first, i32(floor(min(a, b))) - 1);
        last = min(last, i32(ceil(max(a, b))) + 1);
    }
    let base = light.y_max;
    var middle = Edge(-1e9, first);
    var low = Edge(-1e9, first);
    var high = Edge(-1e9, first);
    for (var n = first; n <= last; n++) {
        let offset = f32(n) * sweep.m;
        let whole = floor(offset + 0.5);
        let beside = offset - whole;
        let row = line + i32(whole);
        if row < 0 || row >= rows {
            continue;
        }
        let column = select(columns - 1 - n, n, sweep.forward == 1u);
        let other = clamp(row + select(-1, 1, beside >= 0.0), 0, rows - 1);
        let here = sample_height(at_of(column, row), base);
        let height = mix(here, sample_height(at_of(column, other), base), abs(beside));
        var share = 0u;
        if light.strips == 0u {
            if height >= shadow_of(middle, n, sweep.drop) {
                share = 255u;
                middle = Edge(height, n);
            }
        } else {
            let shadow_low = shadow_of(low, n, sweep.drop_low);
            let shadow_high = shadow_of(high, n, sweep.drop_high);
            if height >= shadow_low {
                share = 255u;
                low = Edge(height, n);
            } else if height > shadow_high {
                let level = 1.0 - 2.0 * (height - shadow_high) / max(shadow_low - shadow_high, 1e-30);
                let part = cap_area(abs(level), -1.0, 1.0) / 3.14159265;
                share = u32(round(255.0 * select(1.0 - part, part, level >= 0.0)));
            }
            if height >= shadow_high {
                high = Edge(height, n);
            }
        }
        if share > 0u {
            let byte = map_byte(vec2<u32>(at_of(column, row)));
            atomicOr(&visibility[byte / 4u], share << (8u * (byte % 4u)));
        }
    }
}
