//! What a user attaches and owns for terrain shadows: [`TerrainShadow`] on a terrain, [`ExactLight`] on a light.

pub mod light;
pub mod plan;
pub mod tiles;

use bevy::{math::DVec3, prelude::*};

use crate::terrain::Terrain;

/// The most strips of a light's disc.
pub const MOST_STRIPS: u32 = 16;

/// Gives a terrain the shadows it casts on itself: for each of its lights a map of how much of the light every
/// sample of the height field sees (P5b).
///
/// The map darkens the terrain's direct diffuse and specular light, as far as the terrain goes. It is made
/// when the light or the heights change, a time slice a frame, and appears when it is complete; while both
/// stand still nothing runs. Where the light is a directional one with shadow maps, the terrain is also drawn
/// into Bevy's cascades, so that ordinary meshes stand in its shadow.
///
/// Lights are Bevy's own `DirectionalLight`, `PointLight` and `SpotLight` entities.
///
/// Removing the component frees everything it used on the GPU.
///
/// ```
/// # mod headless { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/doc_app.rs")); }
/// # let mut app = headless::app();
/// use bevy::prelude::*;
/// use bevy_skyline::prelude::*;
///
/// # let world = app.world_mut();
/// # let field = HeightField::from_fn(UVec2::splat(9), 10.0, (0.0, 9.0), |x, _| x as f32).expect("a field");
/// # let field = world.resource_mut::<Assets<HeightField>>().add(field);
/// let ground = world.spawn((Terrain::new(field), TerrainShadow::default())).id();
/// // Whose shadow: every light that has shadow maps.
/// world.spawn(DirectionalLight { shadow_maps_enabled: true, ..default() });
///
/// // It may take a quarter of a millisecond a frame, and appears so much later after the sun has moved.
/// let mut shadow = world.get_mut::<TerrainShadow>(ground).expect("just spawned");
/// shadow.slice_ms = 0.25;
/// # app.update();
/// // Here there is no GPU to make it with, and it says so.
/// let effects = app.world().resource::<Effects>();
/// assert!(matches!(effects.terrain_shadow(), EffectState::Unsupported(_)));
/// ```
#[derive(Component, Reflect, Clone, Debug, PartialEq)]
#[reflect(Component, Default, Clone, Debug, PartialEq)]
#[require(Terrain)]
pub struct TerrainShadow {
    /// How visibility is found.
    pub method: ShadowMethod,
    /// Which lights cast the terrain's shadow.
    pub lights: ShadowedLights,
    /// Into how many upright strips a light's disc is cut where its size makes a penumbra; each has a ray of
    /// its own. 1 takes the horizon for level across the disc; 0 leaves all shadows hard. range: 0..=16, default: 1
    pub penumbra_strips: u32,
    /// How long a terrain's maps may be worked on in one frame. default: 2, units: ms
    pub slice_ms: f32,
    /// Whether meshes receive the terrain's shadow by way of Bevy's cascades. default: true
    pub on_meshes: bool,
}

impl Default for TerrainShadow {
    fn default() -> Self {
        Self {
            method: ShadowMethod::default(),
            lights: ShadowedLights::default(),
            penumbra_strips: 1,
            slice_ms: 2.0,
            on_meshes: true,
        }
    }
}

/// How it is found out whether a sample sees a light. `docs/terrain_shadow.md` has the measured table.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum ShadowMethod {
    /// A ray from each sample to the light, every cell on its way tested (P5b). Exact.
    PerTexel,
    /// The same rays with the same answers, skipping what the pyramid of maxima lies safely below.
    #[default]
    MaxMip,
    /// Directional lights only: parallel lines are followed away from the light, each carrying the height of
    /// its shadow along. The same time whatever the light's elevation, a few operations a sample, and off by
    /// up to half a cell. Other lights fall back to [`MaxMip`](Self::MaxMip).
    Sweep,
}

/// Which lights cast a terrain's shadow.
#[derive(Reflect, Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub enum ShadowedLights {
    /// Those whose `shadow_maps_enabled` is set.
    #[default]
    ShadowMaps,
    /// All that shine on it.
    All,
}

/// Where a light is in double precision, for shadows that its `Transform` is too coarse for: a sun on the
/// horizon, whose elevation `f32` rotations know only to about 10⁻⁷ rad, or a light very far away.
///
/// Put on the entity of the light; the transform still shades. Directions are to the light.
///
/// ```
/// # use bevy::math::DVec3;
/// # use bevy::prelude::*;
/// # use bevy_skyline::prelude::*;
/// // A sun in the direction of +X.
/// let elevation = 0.3_f64;
/// let to_sun = DVec3::new(elevation.cos(), elevation.sin(), 0.0);
/// let place = Transform::default().looking_to(-to_sun.as_vec3(), Vec3::Y);
/// # let mut world = World::new();
/// let sun = world.spawn((DirectionalLight::default(), place, ExactLight::Direction(to_sun))).id();
///
/// let Some(ExactLight::Direction(exact)) = world.get::<ExactLight>(sun) else { unreachable!() };
/// assert_eq!(exact.y, elevation.sin());
/// // A rotation in `f32` does not know it so well.
/// assert!((f64::from(place.back().y) - exact.y).abs() > 1e-10);
/// ```
#[derive(Component, Reflect, Clone, Copy, Debug, PartialEq)]
#[reflect(Component, Clone, Debug, PartialEq)]
pub enum ExactLight {
    /// Direction to a directional light, of any length, in the world.
    Direction(DVec3),
    /// Position of a point or spot light, in the world. units: m
    Position(DVec3),
}

pub(crate) fn register(app: &mut App) {
    app.register_type::<TerrainShadow>()
        .register_type::<ShadowMethod>()
        .register_type::<ShadowedLights>()
        .register_type::<ExactLight>();
}
