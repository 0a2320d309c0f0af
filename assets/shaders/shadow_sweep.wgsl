// Shadows of a directional light by sweeping away from it: along parallel lines, one a sample across, the height of
// the shadow is carried along. What is highest so far casts it, and it falls by the light's slope a step.
//
// Line k meets column n of the sweep at row k + n m, between samples whose heights are blended. A sample lies between
// two lines, and so does its ray all the way: the shadow over it is blended from theirs. On a plane that is exact,
// so one that faces the light has no acne; elsewhere what is off is the ground's unevenness from one line to the next.
// An invocation follows both lines of its samples. Between columns a line crosses a row of samples, at most one as
// |m| <= 1, where the ground has an edge too.
//
// With a disc two shadows are carried, of its lower and its upper edge. A sample between the two sees a part of it,
// by the slope of whichever casts them and stands higher over it.
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

/// What casts the shadows of two lines: its height, and at which step it stood.
struct Edges {
    height: vec2<f32>,
    step: vec2<f32>,
};

/// Height of their shadow at a step.
fn shadow_of(edges: Edges, step: f32, drop: f32) -> vec2<f32> {
    return edges.height - (step - edges.step) * drop;
}

/// The slope at which the edges are seen from a height at a later step.
fn slope_of(edges: Edges, height: f32, step: f32) -> vec2<f32> {
    return (edges.height - height) / max(step - edges.step, vec2(0.25));
}

/// The edges after a step at which the ground may have risen above their shadow.
fn raised(edges: Edges, heights: vec2<f32>, step: f32, drop: f32) -> Edges {
    let above = heights >= shadow_of(edges, step, drop);
    return Edges(select(edges.height, heights, above), select(edges.step, vec2(step), above));
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
        first = i32(clamp(floor(min(a, b)) - 1.0, 0.0, f32(columns)));
        last = i32(clamp(ceil(max(a, b)) + 1.0, -1.0, f32(columns - 1)));
    }
    let base = light.y_max;
    let none = Edges(vec2(-1e9), vec2(f32(first)));
#ifdef PENUMBRA
    var low = none;
    var high = none;
#else
    var middle = none;
#endif
    var before = vec3(-1e9);
    var floor_before = 0.0;
    for (var n = first; n <= last; n++) {
        let offset = f32(n) * sweep.m;
        let whole = floor(offset);
        let beside = offset - whole;
        // The lines are at rows + beside and one more; the sample is the one between them.
        let row = line + i32(whole);
        let at_line = beside == 0.0;
        let sample = select(row + 1, row, at_line);
        if row < -1 || sample >= rows {
            continue;
        }
        let column = select(columns - 1 - n, n, sweep.forward == 1u);
        let h0 = sample_height(at_of(column, clamp(row, 0, rows - 1)), base);
        let h1 = sample_height(at_of(column, clamp(row + 1, 0, rows - 1)), base);
        let h2 = sample_height(at_of(column, clamp(row + 2, 0, rows - 1)), base);
        let height = select(h1, h0, at_line);
        let heights = mix(vec2(h0, h1), vec2(h1, h2), beside);
        let between = select(1.0 - beside, 0.0, at_line);
        let step = f32(n);
        if before.x > -1e9 && whole != floor_before {
            // Both lines have crossed a row since the last column.
            let up = whole > floor_before;
            let crossed = select(floor_before, whole, up);
            let at = clamp((crossed - (offset - sweep.m)) / sweep.m, 0.0, 1.0);
            let row_heights = mix(select(before.xy, before.yz, up), select(vec2(h1, h2), vec2(h0, h1), up), at);
            let crossing = step - 1.0 + at;
#ifdef PENUMBRA
            low = raised(low, row_heights, crossing, sweep.drop_low);
            high = raised(high, row_heights, crossing, sweep.drop_high);
#else
            middle = raised(middle, row_heights, crossing, sweep.drop);
#endif
        }
        before = vec3(h0, h1, h2);
        floor_before = whole;
        var share = 0u;
#ifdef PENUMBRA
        let low_shadow = shadow_of(low, step, sweep.drop_low);
        let high_shadow = shadow_of(high, step, sweep.drop_high);
        let shadow_low = mix(low_shadow.x, low_shadow.y, between);
        let shadow_high = mix(high_shadow.x, high_shadow.y, between);
        if height >= shadow_low {
            share = 255u;
        } else if height > shadow_high {
            // The higher of the two is the horizon.
            let slopes = max(slope_of(low, height, step), slope_of(high, height, step));
            let span = max(sweep.drop_high - sweep.drop_low, 1e-30);
            let level = clamp(2.0 * (mix(slopes.x, slopes.y, between) - sweep.drop_low) / span - 1.0, -1.0, 1.0);
            let part = cap_area(abs(level), -1.0, 1.0) / 3.14159265;
            share = u32(round(255.0 * select(1.0 - part, part, level >= 0.0)));
        }
        low = raised(low, heights, step, sweep.drop_low);
        high = raised(high, heights, step, sweep.drop_high);
#else
        let shadow = shadow_of(middle, step, sweep.drop);
        if height >= mix(shadow.x, shadow.y, between) {
            share = 255u;
        }
        middle = raised(middle, heights, step, sweep.drop);
#endif
        if sample < 0 {
            continue;
        }
        if share > 0u {
            let byte = map_byte(vec2<u32>(at_of(column, sample)));
            atomicOr(&visibility[byte / 4u], share << (8u * (byte % 4u)));
        }
    }
}
