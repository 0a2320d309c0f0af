// What every terrain pass shares: the spaces, the view of one terrain, and the height field's data.
//
// Spaces
//   grid   x and z count cells, y counts height units (codes of 16-bit fields, metres of float ones).
//          Everything is relative to an anchor, a whole cell near the camera or the sample a shadow ray
//          starts at, so that what is near keeps all its bits. Whole numbers convert to `f32` exactly.
//   t      metres of view-space depth (distance along -Z) beyond `t_base`. A pixel's ray is
//          `ray_origin + t * ray_direction`, both linear in the pixel's offset from the viewport's centre.
//   node   level k >= 1, (i, j): the cells [i 2^k, (i+1) 2^k) x [j 2^k, (j+1) 2^k) and every sample on
//          their corners, shared borders included. Level 0 is the cells themselves, which are not stored.
#define_import_path bevy_skyline::types

/// One height field and its pyramid. Mirrors `GpuField`.
struct Field {
    /// Cells along x and z.
    cells: vec2<i32>,
    /// Levels stored in the pyramid; level `levels` is one node.
    levels: u32,
    /// Of each level: where it starts in the pyramid, and its nodes along x and z.
    level: array<vec4<u32>, 32>,
};

/// One terrain as one camera sees it. Mirrors `GpuTerrainView`.
struct TerrainView {
    /// Ray of the viewport's centre at t = 0, and its change per pixel to the right and down. units: grid
    origin: vec3<f32>,
    /// View depth at t = 0. units: m
    t_base: f32,
    origin_dx: vec3<f32>,
    /// Nothing is seen beyond this t: the camera's far plane. units: m
    t_far: f32,
    origin_dy: vec3<f32>,
    /// A node whose height range is at most `2 (lod_a + lod_b t)` may stand for its surface. units: grid
    lod_a: f32,
    direction: vec3<f32>,
    lod_b: f32,
    direction_dx: vec3<f32>,
    /// Highest and lowest sample, relative to the anchor. units: grid
    y_max: f32,
    direction_dy: vec3<f32>,
    y_min: f32,
    /// NDC depth = (x + y t) / (z + w t).
    depth: vec4<f32>,
    /// Half extents of a pixel-wide beam at t: `beam_a + beam_b t`, for one pixel's half width. units: grid
    beam_a: vec3<f32>,
    /// Height of the anchor. units: grid
    anchor_y: f32,
    beam_b: vec3<f32>,
    /// The picture may be off by so much; 0 = exact. units: px
    max_error_px: f32,
    /// Half extents that rounding alone can add to any beam. units: grid
    beam_slack: vec3<f32>,
    /// Largest magnitude of a height in this view; scales the guard bands. units: grid
    y_magnitude: f32,
    /// Whole cell that grid space is measured from here.
    anchor: vec2<i32>,
    /// Pixels of the viewport.
    size_px: vec2<u32>,
    /// `FLAG_*`
    flags: u32,
    /// Index of this terrain among those of the view, from 1.
    terrain_id: u32,
    /// `TRAVERSAL_*`
    traversal: u32,
    /// Level of the smallest box, log2 of its cells a side.
    box_level: u32,
    /// Side of a tile of `tile_start` and `box_entry`. units: px
    tile_px: u32,
    /// A node whose bottom covers fewer pixels than this is not divided. units: px^2
    box_area_px: f32,
    /// Boxes the list holds.
    box_capacity: u32,
    /// Cells a pixel spans at t: `pixel_a + pixel_b t`.
    pixel_a: f32,
    pixel_b: f32,
    /// Clip space from grid space.
    clip_from_grid: mat4x4<f32>,
    /// View depth minus `t_base` of a grid point: dot(xyz, p) + w. units: m
    depth_from_grid: vec4<f32>,
    /// Planes of the view, inward normals: dot(xyz, p) + w >= 0 inside. The sixth is unused.
    frustum: array<vec4<f32>, 6>,
    /// Upper left corner of the viewport in the camera's textures. units: px
    viewport_px: vec2<u32>,
};

/// No ray of this view starts inside the ground.
const FLAG_STARTS_IN_AIR: u32 = 1u;
/// Rays may enter the footprint from outside, so the walls below the lowest sample can be seen.
const FLAG_BASEMENT: u32 = 2u;
/// First terrain of the view: there is no hit yet to be nearer than.
const FLAG_FIRST: u32 = 4u;
/// Grid space is mirrored against view space, so that faces wind the other way.
const FLAG_MIRRORED: u32 = 8u;

const TRAVERSAL_PER_TEXEL: u32 = 0u;
const TRAVERSAL_MAX_MIP: u32 = 1u;
const TRAVERSAL_BOXES: u32 = 2u;
const TRAVERSAL_HYBRID: u32 = 3u;

/// Later than anything; products with any direction stay finite.
const T_NEVER: f32 = 1e18;
/// Half the distance from 1 to the next `f32`.
const UNIT_ROUNDOFF: f32 = 5.9604645e-8;
