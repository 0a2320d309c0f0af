//! What a user attaches and owns to show a terrain: [`Terrain`] on an entity, its [`HeightField`] asset,
//! [`TerrainRayCasting`] on a camera, and [`TerrainQuery`] to ask the same surface from the CPU.

mod height_field;
mod loader;
mod pyramid;
mod query;
pub mod view_rays;

use bevy::{camera::visibility::Visibility, prelude::*};

pub use height_field::{
    Changed as HeightFieldChanged, HeightField, HeightFieldError, HeightSamples,
};
pub use loader::{
    HeightFieldLoadError, HeightFieldLoader, HeightFieldNote, HeightFieldPlugin,
    HeightFieldSettings, VoidHandling, decode_height_field, read_height_field,
};
pub use pyramid::{MinMaxPyramid, PyramidNodes};
pub use query::{HeightFieldHit, HeightFieldHitF64, HitSide, TerrainHit, TerrainQuery};

/// Shows a height field as terrain, ray cast through the subdivided bounding boxes of P1.
///
/// The surface is the bilinear interpolation of the field's samples. Sample (0, 0) lies at the entity's
/// origin, columns go along its +X, rows along its +Z, heights along its +Y; any [`Transform`] may be put on
/// it. The ground is solid: at the field's border walls go straight down from the surface without end. It is
/// one-sided: from inside the ground nothing of it is seen.
///
/// Removing the component frees everything it used on the GPU.
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let mut fields = app.world_mut().resource_mut::<Assets<HeightField>>();
/// // Or `asset_server.load("alps.png")`.
/// let hill = HeightField::from_fn(UVec2::splat(65), 10.0, (0.0, 100.0), |x, z| {
///     100.0 - (x as f32 - 32.0).hypot(z as f32 - 32.0)
/// })?;
/// let field = fields.add(hill);
/// let place = Transform::from_xyz(-320.0, 0.0, -320.0);
/// app.world_mut().spawn((Terrain::new(field), place));
///
/// // What is drawn is what answers.
/// app.add_systems(Update, |ground: TerrainQuery| {
///     let (_, height) = ground.height_at(Vec2::ZERO).expect("there is ground");
///     assert!((height - 100.0).abs() < 0.01);
/// });
/// # app.update();
/// # app.update();
/// # Ok::<(), bevy_skyline::terrain::HeightFieldError>(())
/// ```
#[derive(Component, Reflect, Clone, Debug, Default)]
#[reflect(Component, Default, Clone, Debug)]
#[require(Transform, Visibility)]
pub struct Terrain {
    /// The heights.
    pub height_field: Handle<HeightField>,
    /// How its surface looks.
    pub look: TerrainLook,
}

impl Terrain {
    /// A terrain coloured by height.
    pub fn new(height_field: Handle<HeightField>) -> Self {
        Self {
            height_field,
            look: TerrainLook::default(),
        }
    }

    /// The same with another look.
    pub fn with_look(mut self, look: TerrainLook) -> Self {
        self.look = look;
        self
    }
}

/// How a terrain's surface reflects light; the terms of Bevy's `StandardMaterial`.
#[derive(Reflect, Clone, Debug, PartialEq)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub struct TerrainLook {
    /// Where the colour comes from.
    pub colour: TerrainColour,
    /// 0 mirror … 1 matt. default: 0.95
    pub perceptual_roughness: f32,
    /// 0 dielectric … 1 metal. default: 0
    pub metallic: f32,
    /// Specular reflection of dielectrics; 0.5 is 4 %. default: 0.2
    pub reflectance: f32,
}

impl Default for TerrainLook {
    fn default() -> Self {
        Self {
            colour: TerrainColour::default(),
            perceptual_roughness: 0.95,
            metallic: 0.0,
            reflectance: 0.2,
        }
    }
}

/// Where a terrain's colour comes from.
#[derive(Reflect, Clone, Debug, PartialEq)]
#[reflect(Default, Clone, Debug, PartialEq)]
pub enum TerrainColour {
    /// Four bands by height, blended into one another: dark green, light green, brown, white in the paper
    /// (P5b).
    Bands {
        /// From the lowest band to the highest.
        colours: [Color; 4],
        /// Where the first three bands end, as a share of the field's height range.
        edges: [f32; 3],
        /// Over how much each edge is blended, as a share of the height range.
        blend: f32,
    },
    /// One colour.
    Uniform(Color),
    /// An image laid over the whole field, its top left corner on sample (0, 0).
    Albedo(Handle<Image>),
}

impl Default for TerrainColour {
    fn default() -> Self {
        Self::Bands {
            colours: [
                Color::srgb(0.13, 0.29, 0.12),
                Color::srgb(0.38, 0.51, 0.22),
                Color::srgb(0.42, 0.34, 0.25),
                Color::srgb(0.95, 0.95, 0.97),
            ],
            edges: [0.18, 0.45, 0.78],
            blend: 0.16,
        }
    }
}

/// How a camera casts its rays through terrain. Cameras without it use the default.
///
/// Every traversal gives the same picture; they differ in cost. `docs/terrain.md` has the measured table.
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// # let target = headless::target();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let world = app.world_mut();
/// // A camera for a photograph: the exact surface, whatever it costs.
/// let casting = TerrainRayCasting { max_error_px: 0.0, ..default() };
/// let camera = world.spawn((Camera3d::default(), Msaa::Off, target, casting)).id();
/// # app.update();
///
/// // Without a `FrameBudget` on the camera nothing moves the setting.
/// let casting = app.world().get::<TerrainRayCasting>(camera);
/// assert_eq!(casting.map(|casting| casting.max_error_px), Some(0.0));
/// ```
#[derive(Component, Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
pub struct TerrainRayCasting {
    /// How rays skip empty space.
    pub traversal: Traversal,
    /// Side of the smallest box, in cells; rounded down to a power of two, from 4 to the field's own size.
    /// The square of it is P1's τ. default: 64
    pub box_texels: u32,
    /// How far the picture may be from the exact surface, measured along the ground's own up axis on the
    /// screen. 0 = exact. default: 0.5, units: px
    pub max_error_px: f32,
}

impl Default for TerrainRayCasting {
    fn default() -> Self {
        Self {
            traversal: Traversal::default(),
            box_texels: 64,
            max_error_px: 0.5,
        }
    }
}

/// How rays skip empty space.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum Traversal {
    /// Every cell on the ray's way is tested (P1's B). Always exact.
    PerTexel,
    /// Each ray walks the pyramid of maxima by itself, from the root down (P1's C).
    MaxMip,
    /// Rays start at the nearest bounding box and then test every cell (P1's A).
    Boxes,
    /// Boxes for each tile of rays, then one beam for the tile, then the pyramid from where the beam ended
    /// (what P1 leaves for later).
    #[default]
    Hybrid,
}

pub(crate) fn register(app: &mut App) {
    if !app.is_plugin_added::<HeightFieldPlugin>() {
        app.add_plugins(HeightFieldPlugin);
    }
    app.register_type::<Terrain>()
        .register_type::<TerrainLook>()
        .register_type::<TerrainColour>()
        .register_type::<TerrainRayCasting>()
        .register_type::<Traversal>();
}
